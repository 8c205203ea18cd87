"""Many builders on one root: the lock, merging manifests, adopting shards, sweeping."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from mapdata.shards.errors import ShardError
from mapdata.shards.files import remove_if_left, take_lock, write_file
from mapdata.shards.header import Header, is_shard_name, limits_of
from mapdata.shards.manifest import MANIFEST, Entry, Manifest, entry_of, path_in, read_manifest
from mapdata.shards.reader import open_shard, sound_labels

if sys.platform != "win32":
    import fcntl

LOCK = ".lock"

_OURS = r"(maps-\d{12,}-\d{12,}\.h5|manifest\.json|import\.json|README\.md|recipe\.json)"
"""Names of files that a root may hold, as a regular expression."""

_TEMPORARY = rf"\.{_OURS}\b.+\.tmp"
"""Names under which `write_file` writes them, and under which earlier versions did."""


def is_known(name: str) -> bool:
    """Return whether a file of a root may have this name: a builder or `mapdata info` gave it."""
    return re.fullmatch(rf"{_OURS}|{_TEMPORARY}|\{LOCK}", name) is not None


def check_names(folder: Path, is_ours: Callable[[str], bool] = is_known) -> None:
    """Refuse a folder without a manifest that holds a file which is not ours.

    Raises:
        ValueError: the message names one.
    """
    if folder.is_dir() and not (folder / MANIFEST).exists():
        for path in folder.iterdir():
            if not is_ours(path.name):
                raise ValueError(
                    f"root: {folder} holds something else ({path.name!r}), expected an empty folder"
                )


@contextmanager
def locked(root: Path, wait: bool) -> Iterator[bool]:
    """Hold the lock of a root and yield True; without ``wait``, yield False if another holds it.

    Where there are no locks it yields True: two merges at once may then lose entries, never shards.
    The last builder lists those again, or, if it is killed, the next build does.

    Raises:
        ShardError: what has the name of the lock is not a plain file.
    """
    path = path_in(root, LOCK)
    if sys.platform == "win32":
        yield True
        return
    # it may have become a link or a pipe since: neither is followed or waited for
    flags = os.O_WRONLY | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
    with open(os.open(path, flags, 0o666), "ab") as file:
        try:
            yield take_lock(file, wait)
        finally:
            # closing the file is not enough: a process forked meanwhile would keep the lock
            with suppress(OSError):
                fcntl.flock(file, fcntl.LOCK_UN)


def merge(root: Path, mine: Manifest, *, wait: bool = True) -> Manifest:
    """Write the union of ``mine`` and the manifest on disk, and return it.

    Shards that larger ones replaced are removed. While another builder merges, wait for it; without
    ``wait``, do nothing and return ``mine``.

    Raises:
        ValueError: the manifest on disk is of another dataset.
    """
    with locked(root, wait) as is_free:
        return merge_locked(root, mine) if is_free else mine


def merge_locked(root: Path, mine: Manifest) -> Manifest:
    """Do what `merge` does; the caller holds the lock."""
    theirs = read_manifest(root) if (root / MANIFEST).exists() else mine
    both = union(mine, theirs)
    write_file(root / MANIFEST, both.to_json().encode())
    sweep(root, both)
    return both


def union(mine: Manifest, theirs: Manifest) -> Manifest:
    """Return a manifest of all shards of two; of the same maps, those of the larger dataset.

    Raises:
        ValueError: they are of two datasets.
    """
    if (mine.identity, mine.shard_size) != (theirs.identity, theirs.shard_size):
        raise ValueError("another dataset appeared under the same root while this one was built")
    entries = sorted((*theirs.shards, *mine.shards), key=lambda entry: entry.limits)
    # of those that start together the last one stays: the longest, and of equal ones mine
    shards = {entry.start: entry for entry in entries}
    return replace(mine, maps=max(mine.maps, theirs.maps), shards=tuple(shards.values()))


def sweep(root: Path, manifest: Manifest) -> None:
    """Remove what dead builders left: temporary files, and shards that larger ones replaced."""
    for path in root.glob(".*.tmp"):
        if re.fullmatch(_TEMPORARY, path.name) and path.is_file():
            remove_if_left(path)
    stops = dict(entry.limits for entry in manifest.shards)
    for path in root.glob("maps-*.h5"):
        if is_shard_name(path.name):
            start, stop = limits_of(path)
            if stop < stops.get(start, 0):
                path.unlink(missing_ok=True)


def load_shard(root: Path, header: Header) -> Entry | None:
    """Return the entry of the shard of ``header`` if the file of its name is sound, else None."""
    try:
        return checked_entry(root, header)
    except (OSError, ShardError):  # gone, not to be read, or damaged
        return None


def checked_entry(root: Path, header: Header) -> Entry:
    """Return the entry of the shard of ``header``, whose file no manifest lists.

    All that any HDF5 library reads of it is compared: the metadata with their checksums, the maps
    and labels with the content hash.

    Raises:
        FileNotFoundError: there is no such file.
        OSError: it may not be read.
        ShardError: it is damaged, or holds other maps.
    """
    path = path_in(root, header.file_name)
    shard = open_shard(path)
    labels = sound_labels(shard)
    if shard.header != header:
        raise ShardError(f"{path}: holds maps of another dataset")
    return entry_of(header, shard.content_hash, labels, path.read_bytes())
