"""Planners on the same problems, classical and learned: python -m benchmarks planners."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from benchmarks.measure import machine, versions

ROOT = Path(__file__).parent.parent
COMMAND = ("-m", "mapdata.models.evaluate", "planners")
PACKAGES = ("mapdata-torch", "numpy", "numba", "torch")


def table(quick: bool, parent: str | None = None) -> str:
    """Run the command that compares planners, and return what it printed; nothing is written.

    Raises:
        SystemExit: the command failed; with what it said.
    """
    arguments = ["--preset", "dungeon", "--seed", "77", "--maps", "50" if quick else "600"]
    process = subprocess.run(
        [sys.executable, *COMMAND, *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    if process.returncode:
        raise SystemExit(f"{COMMAND[1]} failed:\n{process.stderr}")
    facts = [
        f"- {fact}"
        for fact in (versions(PACKAGES), machine(), f"`python {' '.join((*COMMAND, *arguments))}`")
    ]
    return (
        "\n".join(["## Planners", "", "```text", process.stdout.rstrip(), "```", "", *facts]) + "\n"
    )
