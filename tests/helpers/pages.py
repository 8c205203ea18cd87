"""Run the code blocks of a page, one after another, as a reader would."""

from __future__ import annotations

import json
import re
import runpy
import shlex
import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import NamedTuple

from helpers.families import forget
from mapdata.cli import main
from mapdata.generators.generator import GENERATORS

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"

SHORTER = {
    "README.md": ("SETS, STEPS = 8, 500", "SETS, STEPS = 2, 1"),
    "docs/loading.md": (
        "STEPS, PROBLEMS, WIDTH = 3000, 300, 64",
        "STEPS, PROBLEMS, WIDTH = 2, 4, 8",
    ),
}
"""Trainings of minutes, and what runs in their place: the line of a page that says how long."""


class Block(NamedTuple):
    """A fenced block: its language, its text with included files, and where it begins."""

    language: str
    text: str
    line: int


def blocks(page: Path) -> list[Block]:
    """Return the fenced blocks of a page."""
    text = page.read_text(encoding="utf-8")
    found = re.finditer(r"^```(\w*)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    return [Block(one[1], one[2], text.count("\n", 0, one.start()) + 2) for one in found]


def shortened(page: Path) -> list[Block]:
    """Return the blocks of a page, with fewer steps of training where `SHORTER` says so."""
    found = blocks(page)
    if page.is_relative_to(ROOT) and (lines := SHORTER.get(page.relative_to(ROOT).as_posix())):
        assert sum(block.text.count(lines[0]) for block in found) == 1, lines[0]
        found = [block._replace(text=block.text.replace(*lines)) for block in found]
    return found


def run(page: Path) -> list[str]:
    """Run all blocks of ``page`` in the working folder.

    Python runs in one session; lines of shell are run, JSON is parsed. A block of text after one of
    Python is what that prints. A block of Python that begins with the name of a file, as in
    ``# pillars.py``, is that file, which other blocks can import. Families that the page registers
    are unknown again afterwards.

    Returns:
        What each line of shell printed.

    Raises:
        AssertionError: a command fails, a text differs, or a language that nothing runs.
    """
    families = set(GENERATORS)
    path = sys.path.copy()
    try:
        sys.path.insert(0, str(Path.cwd()))
        return _run(page)
    finally:
        sys.path[:] = path
        for family in set(GENERATORS) - families:
            forget(family)


def _run(page: Path) -> list[str]:
    session: dict[str, object] = {"__name__": page.stem}
    shown: list[str] = []
    printed = ""
    for language, text, line in shortened(page):
        where = f"{page.relative_to(ROOT)}, line {line}"
        file = re.match(r"# (\w+\.py)\n", text)
        if language == "python" and file:
            Path(file[1]).write_text(text, encoding="utf-8")
        elif language == "python":
            output = StringIO()
            with redirect_stdout(output):
                # Behind so many empty lines, a traceback names the line of the page.
                source = "\n" * (line - 1) + text
                exec(compile(source, str(page), "exec", dont_inherit=True), session)
            printed = output.getvalue()
        elif language == "sh":
            shown += [shell(command, where) for command in text.splitlines()]
        elif language == "text":
            assert printed == text, where
        elif language == "json":
            json.loads(text)
        else:
            assert language == "bibtex", (
                f"{where}: nothing runs {language or 'a block without a language'}"
            )
    return shown


def shell(command: str, where: str) -> str:
    """Run one line of shell in this process; return what it printed.

    It is ``mapdata ...`` or ``python scripts/...``.
    """
    program, *arguments = shlex.split(command, comments=True)
    target = arguments.pop() if ">" in arguments else None
    arguments = [word for word in arguments if word != ">"]
    output = StringIO()
    with redirect_stdout(output):
        code = _exit_code(program, arguments, where)
    assert code in (None, 0), f"{where}: {command}: exit code {code}"
    if target is not None:
        Path(target).write_text(output.getvalue(), encoding="utf-8")
    return output.getvalue()


def _exit_code(program: str, arguments: list[str], where: str) -> object:
    assert program == "mapdata" or arguments[0].startswith("scripts/"), (
        f"{where}: nothing runs {program}"
    )
    before = sys.argv
    try:
        if program == "mapdata":
            main(arguments)
        else:
            sys.argv = [str(ROOT / arguments[0]), *arguments[1:]]
            runpy.run_path(sys.argv[0], run_name="__main__")
    except SystemExit as stop:
        return stop.code
    finally:
        sys.argv = before
    return None
