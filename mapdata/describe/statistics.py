"""Statistics of a dataset: one pass over its shards for the card, the report and the figures."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, combinations

import numpy as np

from mapdata.arrays import Array, Bytes, Flags, Floats, Ints
from mapdata.generators.maps import Maps, unpacked
from mapdata.limits import SPLITS
from mapdata.search.api import SEARCHES
from mapdata.search.labels import Labels, label
from mapdata.search.lattice import hardness
from mapdata.shards.root import Places, Root

_CELLS_AT_ONCE = 2**22
"""Cells that are unpacked at once, to a byte each: memory stays flat for shards of any size."""

_DIGEST = 16
"""Bytes of the hash of a map: among 10**9 different maps two collide with probability 1e-21."""

_DIGESTS = f"S{_DIGEST}"
"""The dtype of hashes: numpy compares each as a whole."""

_BINS = 30
"""Bins of a histogram; one more where whole numbers are in the middle of theirs."""


@dataclass(frozen=True, eq=False)
class Repeats:
    """How often a map occurs again, under one notion of "the same".

    Attributes:
        inside: per split, the maps that equal an earlier map of that split.
        across: per pair of splits (a, b), the maps of b that equal a map of a.
    """

    inside: dict[str, int]
    across: dict[tuple[str, str], int]


@dataclass(frozen=True, eq=False)
class DatasetStatistics:
    """What N maps with S route segments are like.

    Attributes:
        root: the dataset.
        index: (N,) int64, number of each map.
        rooms: (N,) int64, rooms, or seed points where rooms are not known.
        free: (N,) float64, share of free cells.
        split: (N,) uint8, 0 train, 1 val, 2 test.
        all_connected: (N,) bool, paths exist between all rooms.
        redundant: (N,) bool, `all_connected` though a passage was not drawn.
        hardest: (N,) float64, largest hardness of the map's segments; 0 where none has a path.
        lengths: (S,) int64, cells of the A* path of each segment, 0 without a path.
        hardness: (S,) float64, optimal cost over heuristic, -1 without a path.
        iterations: of "bfs" and "astar", (S,) int64.
        rooms_known: the maps have rooms and passages, not only seed points.
        digests: (N,) and (N,) bytes of length 16: hash of the map, and the least hash of its
            symmetric images; None if they were not asked for.
    """

    root: Root
    index: Ints
    rooms: Ints
    free: Floats
    split: Bytes
    all_connected: Flags
    redundant: Flags
    hardest: Floats
    lengths: Ints
    hardness: Floats
    iterations: dict[str, Ints]
    rooms_known: bool
    digests: tuple[Array, Array] | None

    def __repr__(self) -> str:
        return f"DatasetStatistics({len(self)} maps, {len(self.lengths)} segments, {self.root!r})"

    def __len__(self) -> int:
        """Return N, the number of maps."""
        return len(self.index)

    @property
    def noun(self) -> str:
        """What a seed point is on these maps, in words."""
        return "room" if self.rooms_known else "seed point"

    @property
    def symmetries(self) -> int:
        """How many symmetries a map of this size has."""
        rows, columns = self.root.map_size
        return 8 if rows == columns else 4

    @cached_property
    def repeats(self) -> tuple[Repeats, Repeats]:
        """Repeated maps: exactly the same, and the same up to the symmetries.

        Raises:
            ValueError: the statistics were made without ``repeats=True``.
        """
        if self.digests is None:
            raise ValueError("repeats: not counted; use dataset_statistics(root, repeats=True)")
        exact, symmetric = (count_repeats(digests, self.split) for digests in self.digests)
        return exact, symmetric

    def distributions(self) -> dict[str, Floats]:
        """Return the values of each distribution that is shown; segments are those with a path."""
        found = self.lengths > 0
        return {
            f"{self.noun}s a map": self.rooms.astype(np.float64),
            "free share of a map": self.free,
            "path length of a segment, cells": self.lengths[found].astype(np.float64),
            "hardness of a segment": self.hardness[found],
        }


def dataset_statistics(
    root: Places, *, repeats: bool = False, progress: bool = False
) -> DatasetStatistics:
    """Look at all finished maps of a dataset once.

    Args:
        root: folder or URL of the dataset, or several.
        repeats: hash all maps, too, so that `DatasetStatistics.repeats` can be counted.
        progress: show a progress bar.

    Raises:
        DatasetNotFoundError: there is no dataset under ``root``.
        ShardError: a shard is missing or damaged.
    """
    opened = Root.open(root)
    # the columns of a dataset without maps have their types too
    nothing = label(Maps.empty(opened.movement, opened.map_size, np.arange(0), 2))
    batches = chain([nothing], opened.labels(progress=progress))
    parts = [_columns(labels, repeats) for labels in batches]
    table = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    rooms_known = bool(table.pop("rooms_known").any())
    digests = (table.pop("exact"), table.pop("symmetric"))
    iterations = {search: table.pop(search) for search in SEARCHES}
    return DatasetStatistics(
        root=opened,
        iterations=iterations,
        rooms_known=rooms_known,
        digests=digests if repeats else None,
        **table,
    )


def bin_edges(values: Floats) -> Floats:
    """Return the edges (k + 1,) of a histogram of ``values`` with up to 31 bins.

    Whole numbers have bins of one or more whole numbers, each number in the middle of its own.

    >>> bin_edges(np.array([2.0, 3.0, 3.0]))
    array([1.5, 2.5, 3.5])
    """
    if len(values) and (values == np.rint(values)).all():
        low = values.min()
        high = values.max()
        width = max(1, math.ceil((high - low + 1) / _BINS))
        return np.arange(low, high + width + 0.5, width) - 0.5
    return np.histogram_bin_edges(values, _BINS)


def _columns(labels: Labels, hashes: bool) -> dict[str, Array]:
    """Return what a shard adds to each array of a `DatasetStatistics`."""
    maps = labels.maps
    passages = maps.rooms - 1
    # arrays are padded to the most rooms of the shard: which rows are passages
    used = np.arange(maps.directions.shape[1]) < passages[:, None]
    starts = maps.seed_points[:, :-1][used]
    goals = maps.seed_points[:, 1:][used]
    straight, diagonal = labels.astar.costs[maps.segment_pairs].T
    costs = straight + diagonal * maps.movement.diagonal_cost
    hard = hardness(costs, starts, goals, maps.movement)
    hardest = np.zeros(len(maps))
    owners = np.repeat(np.arange(len(maps)), passages)
    np.maximum.at(hardest, owners, hard)
    rooms_known = (maps.sizes >= 0).any() or (maps.passage_width >= 0).any()
    skipped = (~maps.connected & used).any(axis=1)
    return {
        "index": maps.index,
        "rooms": maps.rooms,
        "split": maps.split,
        "all_connected": labels.all_connected,
        "redundant": labels.all_connected & skipped & rooms_known,
        "hardest": hardest,
        "lengths": np.where(labels.reachable, np.diff(labels.astar.offsets) + 1, 0),
        "hardness": hard,
        "bfs": labels.bfs.iterations,
        "astar": labels.astar.iterations,
        "rooms_known": np.array([rooms_known]),
        **_grid_columns(maps, hashes),
    }


def _grid_columns(maps: Maps, hashes: bool) -> dict[str, Array]:
    """Return the free share of each map and its two digests; those only with ``hashes``."""
    count, rows, _ = maps.packed.shape
    step = max(1, _CELLS_AT_ONCE // (rows * maps.columns))
    free = []
    exact = []
    symmetric = []
    for packed in np.split(maps.packed, range(step, count, step)):
        grids = unpacked(packed, maps.columns)
        free.append(1 - grids.mean(axis=(1, 2)))
        if hashes:
            own, least = digests_of(grids)
            exact += own
            symmetric += least
    return {
        "free": np.concatenate(free),
        "exact": np.array(exact, _DIGESTS),
        "symmetric": np.array(symmetric, _DIGESTS),
    }


def digests_of(grids: Bytes) -> tuple[list[bytes], list[bytes]]:
    """Return two digests of each of (N, H, W) grids: its own, and the least of its symmetries."""
    digests = [_digests(image) for image in _images(grids)]
    return digests[0], list(map(min, zip(*digests, strict=True)))


def _images(grids: Bytes) -> list[Bytes]:
    """Return the symmetric images of (N, H, W) grids, the grids first: 8 of square ones, else 4."""
    bases = [grids]
    if grids.shape[1] == grids.shape[2]:
        bases.append(grids.swapaxes(1, 2))
    return [np.flip(base, axes) for base in bases for axes in ((), 1, 2, (1, 2))]


def _digests(grids: Bytes) -> list[bytes]:
    """Return a hash of each grid, (N, H, W)."""
    packed = np.packbits(grids, axis=2)
    return [hashlib.blake2b(row.tobytes(), digest_size=_DIGEST).digest() for row in packed]


def count_repeats(digests: Array, split: Bytes) -> Repeats:
    """Count equal digests, (N,), inside each split and between each two."""
    # equal digests get equal numbers, which compare faster
    _, kinds = np.unique(digests, return_inverse=True)
    kinds_of = {name: kinds[split == code] for code, name in enumerate(SPLITS)}
    inside = {name: len(own) - len(np.unique(own)) for name, own in kinds_of.items()}
    across = {
        (a, b): int(np.isin(kinds_of[b], kinds_of[a]).sum()) for a, b in combinations(SPLITS, 2)
    }
    return Repeats(inside, across)
