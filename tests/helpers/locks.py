"""Locks between processes."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def lock(path: Path) -> Iterator[None]:
    """Hold a lock between processes. The file is made if it is not there, and stays."""
    with open(path, "w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)  # closing the file gives it back
        yield
