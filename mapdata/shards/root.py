"""A dataset where it lies: its shards one after another, and one map of it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from mapdata.search.labels import Labels
from mapdata.shards.manifest import Manifest, read_manifest
from mapdata.shards.reader import open_shard
from mapdata.shards.shard import ShardError, decode


def shards(root: Path, manifest: Manifest) -> Iterator[Labels]:
    """Yield the maps of each finished shard."""
    for entry in manifest.shards:
        try:
            yield decode(open_shard(root / entry.name, entry.bytes))
        except FileNotFoundError:
            raise ShardError(f"{root / entry.name}: missing; 'mapdata verify {root}' tells what else is") from None


def read_map(root: str | os.PathLike[str], index: int) -> tuple[Labels, int]:
    """Return the shard that holds map ``index``, and the place of the map in it.

    Raises:
        ValueError: the dataset has no such map.
    """
    manifest = read_manifest(Path(root))
    entry = next((entry for entry in manifest.shards if entry.start <= index < entry.stop), None)
    if entry is None:
        raise ValueError(f"index: got {index}, {root} holds maps 0 to {manifest.maps - 1}")
    return decode(open_shard(Path(root) / entry.name, entry.bytes)), index - entry.start
