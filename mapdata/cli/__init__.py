"""The command ``mapdata``, and what the scripts take over from it."""

from mapdata.cli.app import build_main, main
from mapdata.cli.common import Parser, run
from mapdata.cli.problems import add_problem_arguments, check_outputs, given_problems, write_table

__all__ = [
    "Parser",
    "add_problem_arguments",
    "build_main",
    "check_outputs",
    "given_problems",
    "main",
    "run",
    "write_table",
]
