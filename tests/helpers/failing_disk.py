"""A disk that fails at the n-th call, as SQLite's tests have it.

What counts are the calls of open, write, fsync, rename and mkdir that Python code makes on the
files below one folder. What C libraries write is not seen: tests limit that by ``RLIMIT_FSIZE``.
"""

from __future__ import annotations

import builtins
import errno
import io
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

_open, _os_open = io.open, os.open


class FailingDisk:
    """Counts the calls on files below a folder, and lets one of them fail.

    Attributes:
        calls: the names of the calls so far, such as "open" and "write".
        failed: the call that failed, as its name and file; None if none did yet.
    """

    def __init__(self, folder: Path, number: int, *, lasting: bool) -> None:
        """Fail at the call of this number, counted from 0.

        Args:
            folder: only files below it count.
            number: of the call that fails.
            lasting: whether all later calls that write fail, too, as on a disk that stays full.
        """
        self.folder = os.path.realpath(folder)
        self.number = number
        self.lasting = lasting
        self.calls: list[str] = []
        self.failed: tuple[str, str] | None = None

    def watches(self, file: object) -> bool:
        """Return whether a file, as a path or a descriptor, is below the folder."""
        return self.path_of(file) is not None

    def path_of(self, file: object) -> str | None:
        """Return the path of a file below the folder, None for all other files."""
        if isinstance(file, int):
            try:
                path = os.readlink(f"/proc/self/fd/{file}")
            except OSError:
                return None
        elif isinstance(file, (str, bytes, os.PathLike)):
            path = os.path.abspath(os.fsdecode(file))
        else:
            return None
        is_below = path == self.folder or path.startswith(self.folder + os.sep)
        return path if is_below else None

    def step(self, call: str, path: str, *names: object, writes: bool = True) -> None:
        """Count a call, and fail if it is its turn.

        Args:
            call: its name.
            path: of the file.
            *names: the file names that the system's error would have; it has none for a write.
            writes: whether it needs room on the disk. A full disk can be read.
        """
        number = len(self.calls)
        self.calls.append(call)
        if number == self.number or (self.lasting and writes and self.failed is not None):
            self.failed = self.failed or (call, path)
            code = errno.ENOSPC if writes else errno.EIO
            if len(names) == 2:
                raise OSError(code, os.strerror(code), names[0], None, names[1])
            raise OSError(code, os.strerror(code), *names)


class _FailingFile(io.FileIO):
    """A file whose writes count; the one that fails leaves half of its bytes on the disk."""

    def __init__(self, disk: FailingDisk, file: Any, mode: str, *arguments: Any) -> None:
        """Open the file."""
        super().__init__(file, mode, *arguments)
        self._disk = disk
        self._path = disk.path_of(file) or ""

    def write(self, content: Any, /) -> int:
        """Write all, or a half."""
        view = memoryview(content).cast("B")
        try:
            self._disk.step("write", self._path)
        except OSError:
            super().write(view[: len(view) // 2])
            raise
        return super().write(view)


def _opener(disk: FailingDisk) -> Callable[..., Any]:
    """Return what replaces ``open``."""

    def failing_open(
        file: Any,
        mode: str = "r",
        buffering: int = -1,
        encoding: str | None = None,
        errors: str | None = None,
        newline: str | None = None,
        closefd: bool = True,
        opener: Any = None,
    ) -> Any:
        path = disk.path_of(file)
        writes = not set(mode).isdisjoint("wax+")
        if path is not None and not isinstance(file, int):
            disk.step("open", path, file, writes=writes)
        if path is None or not writes:
            return _open(file, mode, buffering, encoding, errors, newline, closefd, opener)
        raw = _FailingFile(disk, file, mode.replace("b", "").replace("t", ""), closefd, opener)
        if buffering == 0:
            return raw
        # A small buffer: then a file of some kilobytes takes several writes, as a large one does.
        stream = io.BufferedRandom(raw, 1024) if "+" in mode else io.BufferedWriter(raw, 1024)
        if "b" in mode:
            return stream
        return io.TextIOWrapper(stream, encoding or "utf-8", errors, newline)

    return failing_open


@contextmanager
def failing_disk(folder: Path, number: int, *, lasting: bool = False) -> Iterator[FailingDisk]:
    """Let the call of this number fail within the block; arguments are those of `FailingDisk`."""
    disk = FailingDisk(folder, number, lasting=lasting)

    def failing_os_open(path: Any, flags: int, *arguments: Any, **options: Any) -> int:
        watched = None if options.get("dir_fd") is not None else disk.path_of(path)
        if watched is not None:
            disk.step("open", watched, path, writes=bool(flags & os.O_CREAT))
        return _os_open(path, flags, *arguments, **options)

    def on_descriptor(true_function: Callable[..., Any]) -> Callable[..., Any]:
        def call(descriptor: int) -> Any:
            path = disk.path_of(descriptor)
            if path is not None:
                disk.step("fsync", path)
            return true_function(descriptor)

        return call

    def on_paths(name: str, true_function: Callable[..., Any], count: int) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            path = disk.path_of(arguments[0])
            if path is not None:
                disk.step(name, path, *arguments[:count])
            return true_function(*arguments, **options)

        return call

    failing_open = _opener(disk)
    with ExitStack() as stack:
        for module, name, function in (
            (builtins, "open", failing_open),
            (io, "open", failing_open),
            (os, "open", failing_os_open),
            (os, "fsync", on_descriptor(os.fsync)),
            (os, "mkdir", on_paths("mkdir", os.mkdir, 1)),
            (os, "rename", on_paths("rename", os.rename, 2)),
            (os, "replace", on_paths("rename", os.replace, 2)),
        ):
            stack.enter_context(patch.object(module, name, function))
        yield disk
