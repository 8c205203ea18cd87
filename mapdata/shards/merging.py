"""Several builders on one root: the lock, merging manifests, and removing what is replaced."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from mapdata.shards.errors import ShardError
from mapdata.shards.files import (
    is_locked,
    naming,
    remove_if_abandoned,
    take_lock,
    temporary_path,
    write_file,
)
from mapdata.shards.header import Header, is_shard_name, limits_of
from mapdata.shards.manifest import MANIFEST, Entry, Manifest, entry_of, path_in, read_manifest
from mapdata.shards.reader import open_shard, sound_labels

if sys.platform != "win32":
    import fcntl

LOCK = ".lock"

_FILE_NAMES = r"(maps-\d{12,}-\d{12,}\.h5|manifest\.json|import\.json|README\.md|recipe\.json)"
"""Regular expression of the names of files that a root may hold."""

_TEMPORARY_NAMES = rf"\.{_FILE_NAMES}\b.+\.tmp"
"""Regular expression of the names under which `write_file`, old or new, writes these files."""


def is_known(name: str) -> bool:
    """Return whether ``name`` is that of a file which mapdata writes into a root."""
    return re.fullmatch(rf"{_FILE_NAMES}|{_TEMPORARY_NAMES}|\{LOCK}", name) is not None


def check_names(folder: Path, is_allowed: Callable[[str], bool] = is_known) -> None:
    """Refuse a folder without a manifest that holds a file of another program.

    Args:
        folder: an existing folder or not.
        is_allowed: returns whether a file of a name may be in the folder.

    Raises:
        ValueError: the message names such a file.
    """
    if folder.is_dir() and not (folder / MANIFEST).exists():
        for path in folder.iterdir():
            if not is_allowed(path.name):
                raise ValueError(
                    f"root: {folder} holds something else ({path.name!r}), expected an empty folder"
                )


@contextmanager
def locked(root: Path, wait: bool) -> Iterator[bool]:
    """Hold the lock of a root; yield whether this process holds it.

    If another process holds the lock, wait for it, or yield False without ``wait``. A file system
    without locks yields True. Two merges at the same time may then lose entries of the manifest,
    but no shards: the last builder lists them again, or the next build if that one is killed.

    Raises:
        ShardError: the file with the name of the lock is not a plain file.
    """
    path = path_in(root, LOCK)
    if sys.platform == "win32":
        yield True
        return
    # The file may have been replaced since it was checked. These flags make opening a link fail,
    # and opening a pipe return at once.
    flags = os.O_WRONLY | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
    with open(os.open(path, flags, 0o666), "ab") as file:
        try:
            yield take_lock(file, wait)
        finally:
            # Closing the file is not enough: a process that was forked meanwhile shares the lock.
            with suppress(OSError):
                fcntl.flock(file, fcntl.LOCK_UN)


@contextmanager
def announced(root: Path) -> Iterator[None]:
    """Show other processes that this one adds shards to a root, until the block ends.

    The sign is a temporary file of the manifest that stays locked. So a killed process shows
    nothing, and the next one removes the file.

    Raises:
        OSError: the disk is full or may not be written to.
    """
    path = temporary_path(root / MANIFEST)
    with naming(root / MANIFEST, unfinished=path), open(path, "xb") as file:
        try:
            take_lock(file, wait=True)
            if path.exists():
                yield
                return
        finally:
            path.unlink(missing_ok=True)
    # Another process removed the file before it was locked.
    with announced(root):
        yield


def is_growing(root: Path) -> bool:
    """Return whether a living process adds shards to a root.

    Where there are no locks, nobody can tell, and this returns False.
    """
    return any(
        re.fullmatch(_TEMPORARY_NAMES, path.name) and path.is_file() and is_locked(path)
        for path in root.glob(".*.tmp")
    )


def merge(root: Path, mine: Manifest, *, wait: bool = True, follow_links: bool = False) -> Manifest:
    """Write the union of the manifest ``mine`` and the manifest on disk, and return it.

    Shards that were replaced by shards with more maps are removed. While another builder merges,
    wait for it, or do nothing and return ``mine`` without ``wait``. If ``follow_links``, a manifest
    on disk that is a link out of ``root`` is read; the link is replaced by a file.

    Raises:
        ValueError: the manifest on disk is of another dataset.
    """
    if follow_links and (root / LOCK).is_symlink():  # of a copy whose files are all links
        (root / LOCK).unlink(missing_ok=True)
    with locked(root, wait) as has_lock:
        return merge_locked(root, mine, follow_links) if has_lock else mine


def merge_locked(root: Path, mine: Manifest, follow_links: bool = False) -> Manifest:
    """Do the work of `merge`; the caller holds the lock."""
    theirs = read_manifest(root, follow_links) if (root / MANIFEST).exists() else mine
    merged = union(mine, theirs)
    write_file(root / MANIFEST, merged.to_json().encode())
    sweep(root, merged)
    return merged


def union(mine: Manifest, theirs: Manifest) -> Manifest:
    """Return a manifest that lists the shards of two manifests of the same dataset.

    Of two shards that start at the same map the longer one is listed; of two entries for the same
    shard, that of ``mine``.

    Raises:
        ValueError: the manifests are of different datasets.
    """
    if (mine.identity, mine.shard_size) != (theirs.identity, theirs.shard_size):
        raise ValueError("another dataset appeared under the same root while this one was built")
    entries = sorted((*theirs.shards, *mine.shards), key=lambda entry: entry.limits)
    # A dict keeps the last entry for each start: the longest, and of equally long ones mine, since
    # sorting keeps their order.
    entry_by_start = {entry.start: entry for entry in entries}
    max_maps = max(mine.maps, theirs.maps)
    return replace(mine, maps=max_maps, shards=tuple(entry_by_start.values()))


def sweep(root: Path, manifest: Manifest) -> None:
    """Remove temporary files of dead builders, and shards that were replaced by longer ones."""
    for path in root.glob(".*.tmp"):
        if re.fullmatch(_TEMPORARY_NAMES, path.name) and path.is_file():
            remove_if_abandoned(path)
    stop_by_start = {entry.start: entry.stop for entry in manifest.shards}
    for path in root.glob("maps-*.h5"):
        if is_shard_name(path.name):
            start, stop = limits_of(path)
            is_replaced = start in stop_by_start and stop < stop_by_start[start]
            if is_replaced:
                path.unlink(missing_ok=True)


def load_shard(root: Path, header: Header, follow_links: bool = False) -> Entry | None:
    """Return the entry of the shard of ``header`` if its file exists and is sound, else None."""
    try:
        return checked_entry(root, header, follow_links)
    except (OSError, ShardError):
        return None


def checked_entry(root: Path, header: Header, follow_links: bool = False) -> Entry:
    """Return the entry of the shard of ``header``, whose file is not listed in a manifest.

    Since no file hash is known, everything that an HDF5 library reads of the file is checked: the
    metadata by their checksums, the maps and labels by the content hash.

    Args:
        root: folder of the dataset.
        header: of the shard.
        follow_links: read a link that leads out of the folder.

    Raises:
        FileNotFoundError: there is no such file.
        OSError: the file may not be read.
        ShardError: the file is damaged, or holds other maps.
    """
    path = path_in(root, header.file_name, follow_links)
    shard = open_shard(path)
    labels = sound_labels(shard)
    if shard.header != header:
        raise ShardError(f"{path}: holds maps of another dataset")
    return entry_of(header, shard.content_hash, labels, path.read_bytes())
