"""The command ``mapdata``, and the functions that the scripts share with it."""

from mapdata.cli.app import build_main, main
from mapdata.cli.common import complain, print_all_letters, run_parsed
from mapdata.cli.evaluate import compare_planners, own_planner
from mapdata.cli.problems import check_outputs, load_problems, write_table

__all__ = [
    "build_main",
    "check_outputs",
    "compare_planners",
    "complain",
    "load_problems",
    "main",
    "own_planner",
    "print_all_letters",
    "run_parsed",
    "write_table",
]
