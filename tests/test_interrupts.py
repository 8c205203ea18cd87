"""Ctrl-C at chosen moments of real processes: one line, exit code 130, no traceback."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.examples import slow
from helpers.pages import ROOT

from mapdata.interrupts import STOPPED

SITE = """
import signal, sys

# A background job of a shell, such as a CI's, ignores Ctrl-C unless it asks for it.
signal.signal(signal.SIGINT, signal.default_int_handler)

def press():
    signal.raise_signal(signal.SIGINT)

class AtImport:
    done = False

    def find_spec(self, name, path=None, target=None):
        if name == {module!r} and not self.done:
            self.done = True
            {action}

def as_another_error():
    try:
        press()
    except KeyboardInterrupt:
        raise ImportError("core failed to import") from None

sys.meta_path.insert(0, AtImport())
"""
"""What Python runs before the program: Ctrl-C is pressed when a module is imported."""


def pressed(
    folder: Path, site: str, program: list[str], arguments: list[str]
) -> subprocess.CompletedProcess[str]:
    """Run a program behind a file of Python."""
    (folder / "sitecustomize.py").write_text(site, encoding="utf-8")
    paths = [str(folder), os.environ.get("PYTHONPATH", str(ROOT))]
    return subprocess.run(
        [sys.executable, *program, *arguments],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
        timeout=300,
    )


def assert_stopped(done: subprocess.CompletedProcess[str], message: str = STOPPED) -> None:
    """Check the exit code and the one line on stderr."""
    assert done.stderr == f"mapdata: {message}\n"
    assert done.returncode == 130


COMMAND = ["-m", "mapdata"]
BUILD = ["build", "maps", "--maps", "1"]


def console_script() -> list[str]:
    """Return the program that an installation makes of the entry point."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    entry = re.search(r'^mapdata = "([\w.]+):(\w+)"$', text, re.MULTILINE)
    assert entry is not None
    return ["-c", f"from {entry[1]} import {entry[2]}; {entry[2]}()"]


@pytest.mark.parametrize(
    ("module", "program", "arguments"),
    [
        ("argparse", COMMAND, BUILD),
        slow("argparse", console_script(), BUILD),
        ("numba.core.config", COMMAND, BUILD),
        slow("argparse", ["scripts/build_shards.py"], []),
        pytest.param("matplotlib", ["scripts/evaluate_planners.py"], [], marks=pytest.mark.slow),
        pytest.param("matplotlib", ["scripts/evaluate_sampler.py"], [], marks=pytest.mark.slow),
        pytest.param(
            "pytorch_lightning",
            ["scripts/train_lego_sampler.py"],
            ["--product", "fit"],
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "pytorch_lightning",
            ["scripts/train_path_predictor.py"],
            [],
            marks=pytest.mark.slow,
        ),
        slow("pytorch_lightning", ["-m", "mapdata.models.train"], ["path_predictor", "fit"]),
        pytest.param(
            "matplotlib", ["-m", "mapdata.models.evaluate"], ["planners"], marks=pytest.mark.slow
        ),
    ],
)
def test_ctrl_c_during_an_import_ends_with_one_line(
    module: str, program: list[str], arguments: list[str], tmp_path: Path
) -> None:
    """Before the parser and in the middle of numba, of the command and of every script."""
    program = [str(ROOT / name) if name.endswith(".py") else name for name in program]
    assert_stopped(
        pressed(tmp_path, SITE.format(module=module, action="press()"), program, arguments)
    )


def test_ctrl_c_that_became_another_error_ends_with_one_line(tmp_path: Path) -> None:
    """Compiled modules turn the interrupt of an import into an ImportError."""
    site = SITE.format(module="mapdata.generators", action="as_another_error()")
    assert_stopped(pressed(tmp_path, site, COMMAND, BUILD))


AT_EXIT = """
import atexit, signal

signal.signal(signal.SIGINT, signal.default_int_handler)
atexit.register(signal.raise_signal, signal.SIGINT)  # registered first, it runs last
"""


@pytest.mark.slow
def test_ctrl_c_while_python_shuts_down_changes_nothing(tmp_path: Path) -> None:
    """The work is done: the exit code is that of the command."""
    done = pressed(tmp_path, AT_EXIT, COMMAND, ["--version"])
    assert done.stderr == ""
    assert done.returncode == 0


@pytest.mark.slow
def test_ignored_ctrl_c_stays_ignored(tmp_path: Path) -> None:
    """A background job of a shell goes on when Ctrl-C is pressed for another one."""
    site = SITE.format(module="argparse", action="press()")
    site += "signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
    done = pressed(tmp_path, site, COMMAND, ["--version"])
    assert done.stderr == ""
    assert done.returncode == 0


AS_LIGHTNING_DOES = """
import signal, sys
from mapdata.interrupts import exit_on_interrupt, stoppable

exit_on_interrupt()
with stoppable("stopped; go on"):
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGINT, before)
        sys.exit(1)
"""


def test_an_exit_that_ctrl_c_caused_is_one_of_ctrl_c(tmp_path: Path) -> None:
    """Lightning catches Ctrl-C, ignores it meanwhile, and exits with code 1: the line and 130 all
    the same.
    """
    site = "import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
    assert_stopped(pressed(tmp_path, site, ["-c", AS_LIGHTNING_DOES], []), "stopped; go on")


TWICE = """
import signal
from mapdata.interrupts import exit_on_interrupt, stoppable

exit_on_interrupt()
with stoppable():
    try:
        signal.raise_signal(signal.SIGINT)
    finally:
        print("cleaning up", flush=True)
        signal.raise_signal(signal.SIGINT)
        print("cleaned up", flush=True)
"""


def test_a_second_ctrl_c_does_not_wait_for_the_cleaning_up(tmp_path: Path) -> None:
    """The first one lets a command remove what it has begun; still there is one line."""
    site = "import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
    done = pressed(tmp_path, site, ["-c", TWICE], [])
    assert_stopped(done)
    assert done.stdout == "cleaning up\n"
