"""Writing files whole or not at all: temporary names, locks, and what dead writers left.

What is being written has a hidden name beside its target's, and gets the target's name when it is
complete. The hidden name says whose it is: ``.maps.npz.0123456789abcdef.mapdata.tmp``. Its writer
holds a lock until the end. A writer that is killed loses the lock and leaves the file, so whoever
writes into the same folder next can tell it from what a living writer is about to finish.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO
from uuid import uuid4

if sys.platform != "win32":
    import fcntl

StrPath = str | os.PathLike[str]


def write_file(path: Path, data: bytes) -> None:
    """Write ``data`` so that ``path`` is either what it was or complete, through a power cut too.

    Whatever else the name stood for, such as a link, is replaced.

    Raises:
        OSError: the disk is full or not writable; nothing is left behind under any name.
    """
    temporary = temporary_path(path)
    try:
        with open(temporary, "xb") as file:
            take_lock(file)  # it tells those who sweep that the writer lives
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except FileNotFoundError:
        if not path.parent.is_dir():
            raise
        # it was swept while it had no lock: just made, just closed, or where there are no locks
        write_file(path, data)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.errno and error.filename is None:
            # what fails while bytes are written, as on a full disk, does not say where
            raise OSError(error.errno, error.strerror, str(path)) from None
        raise
    sync_folder(path.parent)


def write_output(path: StrPath, data: bytes) -> None:
    """Write ``data`` to what a user names: a file at once, a link followed, a device or pipe as is.

    What writers left beside the file that were killed is removed.

    Raises:
        OSError: as `write_file`.
    """
    target = Path(path)
    if target.exists() and not target.is_file():
        target.write_bytes(data)
    else:
        target = Path(os.path.realpath(path))
        sweep_temporaries(target.parent)
        write_file(target, data)


def sync_folder(folder: Path) -> None:
    """Make renames in ``folder`` durable: without this, a power cut may undo them."""
    if os.name == "nt":
        return  # Windows cannot open a folder, and needs no such call
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def make_folder(folder: Path) -> None:
    """Make a folder, and those that it lies in, unless it is there.

    Raises:
        OSError: it cannot be made; the message names it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise type(error)(f"{folder}: this folder cannot be made ({error.strerror})") from None


def file_size(path: Path) -> int | None:
    """Return the size of a file in bytes, None if there is none."""
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return None


_ENDING = ".mapdata.tmp"

_NAME = re.compile(rf"\..+\.[0-9a-f]{{16}}{re.escape(_ENDING)}", re.DOTALL)
"""The names that `temporary_path` gives."""

_FOLDER_LOCK = "lock"
"""The file of a temporary folder that its writer locks: not all file systems lock folders."""

_A_DAY = 86_400
"""Seconds after which a temporary file counts as left behind where there are no locks."""


def temporary_path(target: Path) -> Path:
    """Return a new path beside ``target``, to write what shall replace it."""
    return target.with_name(f".{target.name}.{uuid4().hex[:16]}{_ENDING}")


@contextmanager
def temporary_folder(target: Path) -> Iterator[Path]:
    """Make a folder beside ``target`` to write in; remove it with all that it still holds.

    Raises:
        OSError: it cannot be made.
    """
    folder = temporary_path(target)
    folder.mkdir()
    try:
        lock = folder / _FOLDER_LOCK
        with open(lock, "xb") as file:
            take_lock(file, wait=True)  # it tells those who sweep that the writer lives
            if lock.exists():
                yield folder
                return
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    # it was swept while it had no lock
    with temporary_folder(target) as folder:
        yield folder


def take_lock(file: IO[bytes], wait: bool = False) -> bool:
    """Lock an open file until it is closed; without ``wait``, return False if another one holds it.

    Where there are no locks (Windows, some file systems) return True.
    """
    if sys.platform != "win32":
        try:
            fcntl.flock(file, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:
            pass  # this file system has no locks
    return True


def sweep_temporaries(folder: Path) -> None:
    """Remove from ``folder`` the temporary files and folders of mapdata whose writers are dead."""
    with suppress(OSError):  # a folder that is not there, or that may not be listed
        for path in [Path(entry) for entry in os.scandir(folder) if _NAME.fullmatch(entry.name)]:
            remove_if_left(path)


def remove_if_left(path: Path) -> None:
    """Remove a temporary file or folder if its writer has died: it holds a lock while it lives.

    Process numbers and host names would not tell: those of two containers may be equal. Where there
    are no locks, the age tells. Links and pipes are left alone, and so is what cannot be removed.
    """
    if path.is_symlink() or not (path.is_file() or path.is_dir()):
        return
    lock = path / _FOLDER_LOCK if path.is_dir() else path
    # others sweep too, and it may be another user's
    with suppress(OSError), ExitStack() as stack:
        had_no_lock = False
        with suppress(PermissionError, FileNotFoundError):
            first = stack.enter_context(open(lock, "r+b"))
            second = stack.enter_context(open(lock, "r+b"))
            if not take_lock(first):
                return
            # refused where locks work here: nobody but us holds this one
            had_no_lock = not take_lock(second)
        if had_no_lock or time.time() - path.stat().st_mtime > _A_DAY:
            # while the lock is held: its writer may be about to take it
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()
