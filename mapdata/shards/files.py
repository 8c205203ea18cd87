"""Atomic writing of files: temporary names, locks, and removing what killed writers left.

A file is written under a hidden name in the folder of its target, and renamed when it is complete.
The hidden name contains the name of the target: ``.maps.npz.0123456789abcdef.mapdata.tmp``. The
writer holds a lock on the file until then. A writer that is killed loses the lock and leaves the
file, so the next writer into the folder can tell it from the file of a living writer and remove it.
"""

from __future__ import annotations

import hashlib
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

from mapdata.npy import FormatError

if sys.platform != "win32":
    import fcntl

StrPath = str | os.PathLike[str]


def write_file(path: Path, content: bytes) -> None:
    """Write a file atomically: even after a power cut it has either its old or the new content.

    A link of this name is replaced, not followed.

    Raises:
        OSError: the disk is full or not writable. The error names ``path``; no temporary file
            remains.
    """
    temporary = temporary_path(path)
    with naming(path, unfinished=temporary):
        try:
            with open(temporary, "xb") as file:
                take_lock(file)  # shows other processes that the writer is alive
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
        except FileNotFoundError:
            if not path.parent.is_dir():
                raise
            # Another process removed the temporary file while it had no lock: just after it was
            # created, just after it was closed, or on a file system without locks.
            write_file(path, content)
        except BaseException:
            with suppress(OSError):  # The first error is the one to report.
                temporary.unlink(missing_ok=True)
            raise
        sync_folder(path.parent)


@contextmanager
def naming(target: Path, *, unfinished: Path) -> Iterator[None]:
    """Let each `OSError` of this block name a file that the user knows.

    An error of writing bytes, as on a full disk, names no file, and other errors may name a
    temporary file. Such errors name ``target`` instead. Errors of other files stay as they are.

    Args:
        target: the file or folder that the block writes.
        unfinished: its temporary path.
    """
    try:
        yield
    except OSError as error:
        if error.errno is None:  # It has a text of its own, such as that of a lost connection.
            raise
        name = target
        if error.filename is not None:
            failed = Path(os.fsdecode(error.filename))
            if not failed.is_relative_to(unfinished):
                raise
            inside = failed.relative_to(unfinished)
            name = target if inside == Path(_FOLDER_LOCK) else target / inside
        raise OSError(error.errno, error.strerror, str(name)) from None


def write_output(path: StrPath, content: bytes) -> None:
    """Write to a path that a user chose.

    A file is written atomically, a link is followed, and a device or pipe is written to directly.
    Temporary files of killed writers in the same folder are removed.

    Raises:
        OSError: as `write_file`.
    """
    target = Path(path)
    is_device = target.exists() and not target.is_file()
    if is_device:
        with naming(target, unfinished=target):
            target.write_bytes(content)
    else:
        target = Path(os.path.realpath(path))
        sweep_temporaries(target.parent)
        write_file(target, content)


def sync_folder(folder: Path) -> None:
    """Make renames in ``folder`` durable; without this, a power cut may undo them."""
    if os.name == "nt":
        return  # Windows cannot open folders, and does not need this.
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def make_folder(folder: Path) -> None:
    """Create a folder and its parents, unless they exist.

    Raises:
        OSError: it cannot be created; the message names it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise type(error)(f"{folder}: this folder cannot be made ({error.strerror})") from None


def leads_out(path: Path, folder: Path) -> bool:
    """Return whether ``path``, a name inside ``folder``, is a link that leads out of it."""
    # Most files are no links, and need no further look at the disk.
    if not path.is_symlink() and os.path.normpath(path.parent) == os.path.normpath(folder):
        return False
    # Unlike `Path.resolve`, `realpath` does not fail on links in a circle.
    return not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder))


def file_size(path: Path) -> int | None:
    """Return the size of a file in bytes, or None if there is no such file."""
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return None


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file as 64 hexadecimal digits; it is read a megabyte at a time."""
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(2**20):
            digest.update(block)
    return digest.hexdigest()


_TEMPORARY_SUFFIX = ".mapdata.tmp"

_TEMPORARY_NAME = re.compile(rf"\..+\.[0-9a-f]{{16}}{re.escape(_TEMPORARY_SUFFIX)}", re.DOTALL)
"""The names that `temporary_path` returns."""

_MAX_NAME_BYTES = 255
"""The longest name of a file on all common file systems, in bytes."""

_FOLDER_LOCK = "lock"
"""File in a temporary folder that its writer locks, since not all file systems lock folders."""

_MAX_AGE_WITHOUT_LOCKS = 86_400
"""Seconds (a day) after which a temporary file counts as abandoned where there are no locks."""


def temporary_path(target: Path) -> Path:
    """Return a new hidden path in the folder of ``target``, to write its new content to.

    A long name is cut, because a file system that takes the name of the target may not take a
    longer one.
    """
    end = f".{uuid4().hex[:16]}{_TEMPORARY_SUFFIX}"
    name = os.fsencode(target.name)[: _MAX_NAME_BYTES - len(end) - 1]
    # A letter of several bytes may have been cut in two.
    return target.with_name(f".{name.decode(errors='ignore') or 'output'}{end}")


@contextmanager
def temporary_folder(target: Path) -> Iterator[Path]:
    """Yield a new hidden folder next to ``target``, and remove it with its content at the end.

    Raises:
        OSError: it cannot be created.
    """
    folder = temporary_path(target)
    lock = folder / _FOLDER_LOCK
    with naming(target, unfinished=folder):
        folder.mkdir()
        try:
            with ExitStack() as stack:
                is_locked = False
                with suppress(FileNotFoundError):  # Another process may have removed the folder.
                    file = stack.enter_context(open(lock, "xb"))
                    take_lock(file, wait=True)  # shows other processes that the writer is alive
                    is_locked = lock.exists()
                if is_locked:
                    yield folder
                    return
        finally:
            with suppress(OSError):
                _remove_folder(folder)
    # Another process removed the folder before it was locked.
    with temporary_folder(target) as folder:
        yield folder


def _remove_folder(folder: Path) -> None:
    """Remove a temporary folder, last the file that says whether its writer lives.

    So the next writer can remove what is left if this process is killed meanwhile.

    Raises:
        OSError: something in it cannot be removed.
    """
    for entry in list(os.scandir(folder)):
        if entry.is_dir(follow_symlinks=False):
            shutil.rmtree(entry)
        elif entry.name != _FOLDER_LOCK:
            os.unlink(entry)
    (folder / _FOLDER_LOCK).unlink(missing_ok=True)
    folder.rmdir()


@contextmanager
def new_output(target: Path) -> Iterator[Path]:
    """Yield a path to write a file or folder at; it becomes ``target`` when the block succeeds.

    Temporary files that killed writers left in the folder of ``target`` are removed.

    Args:
        target: a new name, or an empty folder.

    Raises:
        FormatError: the target is a link or holds something, before the block or after it.
        OSError: the disk is full or may not be written to; the message names the target, or a file
            in it.
    """
    if target.name in ("", ".."):
        raise FormatError(f"{target}: expected the name of the file or folder to write")
    _check_unused(target)
    make_folder(target.parent)
    sweep_temporaries(target.parent)
    with temporary_folder(target) as folder:
        unfinished = folder / "output"
        with naming(target, unfinished=unfinished):
            yield unfinished
            _check_unused(target)  # another program may have written it meanwhile
            if target.is_dir():
                target.rmdir()  # it is empty; a file cannot replace a folder
            os.replace(unfinished, target)


def _check_unused(target: Path) -> None:
    """Refuse a link, and a target that holds something.

    Raises:
        FormatError: the message names the target.
    """
    if target.is_symlink():
        raise FormatError(f"{target}: is a link, expected a new name or an empty folder")
    is_empty = target.is_dir() and not any(target.iterdir())
    if target.exists() and not is_empty:
        raise FormatError(f"{target}: exists already, expected a new name or an empty folder")


def take_lock(file: IO[bytes], wait: bool = False) -> bool:
    """Lock an open file until it is closed, and return True.

    If the file is locked already, wait for the lock, or return False without ``wait``. Where there
    are no locks (Windows, some file systems), return True.
    """
    if sys.platform != "win32":
        try:
            fcntl.flock(file, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:
            pass  # This file system has no locks.
    return True


def is_locked(path: Path) -> bool:
    """Return whether a process has a lock on a file; False if there is no file, or are no locks."""
    with suppress(OSError), open(path, "rb") as file:
        return not take_lock(file)
    return False


def sweep_temporaries(folder: Path) -> None:
    """Remove from ``folder`` the temporary files and folders of mapdata whose writers are dead."""
    with suppress(OSError):  # The folder may not exist, or may not be listed.
        for entry in list(os.scandir(folder)):
            if _TEMPORARY_NAME.fullmatch(entry.name):
                remove_if_abandoned(Path(entry))


def remove_if_abandoned(path: Path) -> None:
    """Remove a temporary file or folder if its writer is dead, which is so if nobody locks it.

    Process numbers and host names would not do, since they may be equal in two containers. Where
    there are no locks, a file is removed if it is old. Links and pipes are not touched; a file that
    cannot be removed stays.
    """
    if path.is_symlink() or not (path.is_file() or path.is_dir()):
        return
    if path.is_dir():
        # An empty folder has no lock: its writer was killed just after creating it, or just before
        # removing it. A living writer that is about to lock it takes another folder.
        with suppress(OSError):  # It is not empty.
            path.rmdir()
            return
    lock = path / _FOLDER_LOCK if path.is_dir() else path
    # Another process may remove the file first, and the file may belong to another user.
    with suppress(OSError), ExitStack() as stack:
        is_abandoned = False
        with suppress(PermissionError, FileNotFoundError):
            first = stack.enter_context(open(lock, "r+b"))
            second = stack.enter_context(open(lock, "r+b"))
            if not take_lock(first):
                return
            # If locks work here, a second lock on the file is refused, so the first lock proves
            # that no other process had one.
            is_abandoned = not take_lock(second)
        if is_abandoned or time.time() - path.stat().st_mtime > _MAX_AGE_WITHOUT_LOCKS:
            # The lock is kept meanwhile: a writer that has just created the file may be about to
            # lock it.
            if path.is_dir():
                _remove_folder(path)
            else:
                path.unlink()
