"""The command ``mapdata``, and what the scripts take over from it."""

from mapdata.cli.app import build_main, main
from mapdata.cli.common import complain, run_parsed
from mapdata.cli.problems import check_outputs, given_problems, write_table

__all__ = [
    "build_main",
    "check_outputs",
    "complain",
    "given_problems",
    "main",
    "run_parsed",
    "write_table",
]
