"""What all command lines share: a flag that is given twice loses no value silently, and a pipe that
its reader has closed ends the command without a word.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from contextlib import suppress

import pytest

from mapdata.cli.app import VERBS, build_command, verb_parser
from mapdata.cli.common import Command, parser_of
from mapdata.models.evaluate import evaluate_planners, evaluate_samplers

SCRIPTS: dict[str, Command] = {
    "build_shards": build_command,
    "evaluate_planners": evaluate_planners,
    "evaluate_sampler": evaluate_samplers,
}
"""The functions behind the scripts whose parser is that of mapdata."""


def parser_named(name: str) -> argparse.ArgumentParser:
    """Return the parser of a verb or script."""
    return verb_parser(name) if name in VERBS else parser_of(SCRIPTS[name], name, root=[])


@pytest.mark.parametrize("name", [*VERBS, *SCRIPTS])
def test_a_flag_of_one_value_is_refused_where_it_is_given_twice(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Argparse takes the last value; every flag either keeps all of its values or says so."""
    parser = parser_named(name)
    dropped = []
    for flag, action in parser._option_string_actions.items():
        takes_no_value = action.nargs == 0
        keeps_all = type(action).__name__ in ("_AppendAction", "_ExtendAction")
        if takes_no_value or keeps_all:
            continue
        with suppress(SystemExit):
            parser.parse_args([flag, "1", f"{flag}=2"])
        if f"{flag}: given twice, expected once" not in capsys.readouterr().err:
            dropped.append(flag)
    assert not dropped


def test_both_names_of_a_flag_are_one_flag(capsys: pytest.CaptureFixture[str]) -> None:
    """Also where the value follows without a space."""
    with pytest.raises(SystemExit):
        verb_parser("show").parse_args(["data/maps", "-oa.png", "--output", "b.png"])
    assert "--output: given twice" in capsys.readouterr().err


def test_names_after_two_dashes_are_no_flags() -> None:
    """So a folder may be named as a flag is."""
    arguments = verb_parser("verify").parse_args(["--", "--import", "--import"])
    assert arguments.root == ["--import", "--import"]


def test_numbers_and_names_that_are_given_twice_are_kept() -> None:
    """Lists of numbers and of planners, and imported modules."""
    sizes = parser_named("evaluate_sampler").parse_args(["--sizes", "24", "50", "--sizes", "100"])
    assert sizes.sizes == [24, 50, 100]
    twice = ["--planner", "m:A", "dungeon", "--planner=m:B", "--import", "a", "--import", "b"]
    arguments = verb_parser("evaluate").parse_args(twice)
    assert arguments.planner == ["m:A", "m:B"]
    assert arguments.problems == ["dungeon"]
    assert arguments.modules == ["a", "b"]


def test_a_pipe_that_is_closed_ends_the_command_without_a_word() -> None:
    """As in `mapdata list | head -1`: the shell's code for it, and no traceback."""
    read_end, write_end = os.pipe()
    os.close(read_end)
    command = [sys.executable, "-m", "mapdata", "list"]
    buffered = {
        **os.environ,
        "PYTHONUNBUFFERED": "",
    }  # as in a shell: Python writes at its exit, too
    done = subprocess.run(
        command, stdout=write_end, stderr=subprocess.PIPE, env=buffered, check=False
    )
    os.close(write_end)
    assert (done.returncode, done.stderr) == (141, b"")
