"""A dataset as exporters want it: its manifest, and its maps a shard at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from mapdata.search.labels import Labels
from mapdata.shards.manifest import Manifest, read_manifest
from mapdata.shards.reader import read_shard
from mapdata.shards.shard import ShardError


@dataclass(frozen=True)
class Stored:
    """A finished dataset.

    Attributes:
        root: its folder.
        manifest: what it says of itself.
        progress: show a progress bar a pass.
    """

    root: Path
    manifest: Manifest
    progress: bool = False

    @staticmethod
    def open(root: Path, *, progress: bool = False) -> Stored:
        """Return the dataset under ``root``.

        Raises:
            DatasetNotFoundError: there is none.
            ShardError: its manifest is damaged.
            ValueError: it is not finished.
        """
        manifest = read_manifest(root)
        if not manifest.complete:
            raise ValueError(f"root: {root} is not finished: run the command that makes it once more")
        return Stored(root, manifest, progress)

    def batches(self) -> Iterator[Labels]:
        """Yield the maps with their labels, a shard at a time, in order.

        Raises:
            ShardError: a shard is missing or damaged.
        """
        for entry in tqdm(self.manifest.shards, unit=" shards", leave=False, disable=not self.progress):
            try:
                yield read_shard(self.root / entry.name)
            except FileNotFoundError:
                raise ShardError(f"{self.root / entry.name}: missing") from None
