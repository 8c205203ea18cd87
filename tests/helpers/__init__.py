"""What tests share: slow references, files written by hand, hostile ones, a browser."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parents[1]


def run_helper(name: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run ``helpers.<name>`` in a new process, which may crash, or whose memory is measured."""
    command = [sys.executable, "-m", f"helpers.{name}", *arguments]
    path = os.pathsep.join((str(TESTS), os.environ.get("PYTHONPATH", "")))
    variables = {**os.environ, **environment, "PYTHONPATH": path}
    return subprocess.run(command, env=variables, capture_output=True, text=True, check=False)
