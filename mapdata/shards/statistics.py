"""Statistics of a dataset: one pass over its shards for the card, the report and the figures."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from mapdata.arrays import Bytes, Flags, Floats, Ints
from mapdata.generators.maps import Maps
from mapdata.search.labels import Labels, label
from mapdata.search.lattice import hardness
from mapdata.shards.root import Places, Root
from mapdata.shards.shard import SEARCHES, Array
from mapdata.spec import SPLITS

_CELLS_AT_ONCE = 2**22
"""Cells that are unpacked at once, to a byte each: memory stays flat for shards of any size."""

_DIGEST = 16
"""Bytes of the hash of a map: among 10**9 different maps two collide with probability 1e-21."""


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
        digests: (N, 16) and (N, 16) uint8: hash of the map, and the least hash of its symmetric
            images; None if they were not asked for.
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
    digests: tuple[Bytes, Bytes] | None

    def __repr__(self) -> str:
        return f"DatasetStatistics({len(self)} maps, {len(self.lengths)} segments, {self.root!r})"

    def __len__(self) -> int:
        """Return N, the number of maps."""
        return len(self.index)

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
        exact, symmetric = (_repeats(digests, self.split) for digests in self.digests)
        return exact, symmetric

    def distributions(self) -> dict[str, Floats]:
        """Return the values of each distribution that is shown; segments are those with a path."""
        found = self.lengths > 0
        rooms = "rooms a map" if self.rooms_known else "seed points a map"
        return {
            rooms: self.rooms.astype(np.float64),
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
    parts = [_columns(labels, repeats) for labels in opened.labels(progress=progress)]
    if not parts:
        # the columns of a dataset without maps have their types too
        nothing = label(Maps.empty(opened.movement, opened.map_size, np.arange(0), 2))
        parts = [_columns(nothing, repeats)]
    table = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    rooms_known = bool(table.pop("rooms_known").any())
    exact = table.pop("exact")
    symmetric = table.pop("symmetric")
    iterations = {search: table.pop(search) for search in SEARCHES}
    return DatasetStatistics(
        root=opened,
        iterations=iterations,
        rooms_known=rooms_known,
        digests=(exact, symmetric) if repeats else None,
        **table,
    )


def histogram(values: Floats, bins: int = 30) -> tuple[Floats, Ints]:
    """Return edges (k + 1,) and counts (k,) of ``values``, in at most ``bins`` bins.

    Whole numbers have bins of one or more whole numbers, each number in the middle of its own.

    >>> histogram(np.array([2.0, 3.0, 3.0]))
    (array([1.5, 2.5, 3.5]), array([1, 2]))
    """
    low = float(values.min()) if len(values) else 0.0
    high = float(values.max()) if len(values) else 1.0
    if bool((values == np.rint(values)).all()):
        width = max(1, math.ceil((high - low + 1) / bins))
        edges = np.arange(low, high + width + 0.5, width) - 0.5
    else:
        if high == low:
            high = low + 1  # bins need a width
        edges = np.linspace(low, high, bins + 1)
    counts, _ = np.histogram(values, edges)
    return edges, counts.astype(np.int64)


def _columns(labels: Labels, hashes: bool) -> dict[str, Array]:
    """Return what a shard adds to each array of a `DatasetStatistics`."""
    maps = labels.maps
    movement = maps.movement
    passages = maps.rooms - 1
    # arrays are padded to the most rooms of the shard: which rows are passages
    used = np.arange(maps.directions.shape[1]) < passages[:, None]
    starts = maps.seed_points[:, :-1][used]
    goals = maps.seed_points[:, 1:][used]
    steps = np.diff(labels.astar.offsets)
    diagonal = _diagonal_moves(labels)
    costs = steps - diagonal + diagonal * movement.diagonal_cost
    costs[~labels.reachable] = -1
    hard = hardness(costs, starts, goals, movement)
    hardest = np.zeros(len(maps))
    owners = np.repeat(np.arange(len(maps)), passages)
    np.maximum.at(hardest, owners, hard)
    rooms_known = bool((maps.sizes >= 0).any() or (maps.passage_width >= 0).any())
    skipped = (~maps.connected & used).any(axis=1)
    free, exact, symmetric = _grid_columns(labels, hashes)
    return {
        "index": maps.index,
        "rooms": maps.rooms,
        "free": free,
        "split": maps.split,
        "all_connected": labels.all_connected,
        "redundant": labels.all_connected & skipped & rooms_known,
        "hardest": hardest,
        "lengths": np.where(labels.reachable, steps + 1, 0),
        "hardness": hard,
        "bfs": labels.bfs.iterations,
        "astar": labels.astar.iterations,
        "rooms_known": np.array([rooms_known]),
        "exact": exact,
        "symmetric": symmetric,
    }


def _diagonal_moves(labels: Labels) -> Ints:
    """Return (S,) int64, the diagonal moves of A* on each segment."""
    is_diagonal = labels.astar.moves >= 4  # 0..7 = N E S W NE SE SW NW
    before = np.concatenate(([0], np.cumsum(is_diagonal)))
    return np.diff(before[labels.astar.offsets])


def _grid_columns(labels: Labels, hashes: bool) -> tuple[Floats, Bytes, Bytes]:
    """Return the free share of each map and its two digests; those only with ``hashes``."""
    maps = labels.maps
    count, rows, _ = maps.packed.shape
    free = np.empty(count)
    exact = np.zeros((count, _DIGEST), np.uint8)
    symmetric = exact.copy()
    step = max(1, _CELLS_AT_ONCE // (rows * maps.columns))
    octets = maps.packed.astype("<u8", copy=False).view(np.uint8)
    for first in range(0, count, step):
        part = slice(first, first + step)
        grids = np.unpackbits(octets[part], axis=2, count=maps.columns, bitorder="little")
        free[part] = 1 - grids.mean(axis=(1, 2))
        if hashes:
            images = [_digest(image) for image in _images(grids)]
            exact[part] = images[0]
            symmetric[part] = _least(images)
    return free, exact, symmetric


def _least(digests: list[Bytes]) -> Bytes:
    """Return the least digest of each map, (N, 16), from those of its images, each (N, 16)."""
    # one string of 16 bytes for each digest: numpy then compares whole digests
    keys = np.stack(digests, axis=1).view(f"S{_DIGEST}")[..., 0]
    least = np.sort(keys, axis=1)[:, :1]
    return least.copy().view(np.uint8)


def _images(grids: Bytes) -> Iterator[Bytes]:
    """Yield the symmetric images of (N, H, W) grids, the grids first: 8 of square ones, else 4."""
    bases = [grids]
    if grids.shape[1] == grids.shape[2]:
        bases.append(grids.swapaxes(1, 2))
    for base in bases:
        for flipped in (base, base[:, ::-1]):
            yield flipped
            yield flipped[:, :, ::-1]


def _digest(grids: Bytes) -> Bytes:
    """Return (N, 16) uint8, a hash of each grid."""
    packed = np.ascontiguousarray(np.packbits(grids, axis=2)).reshape(len(grids), -1)
    digests = [hashlib.blake2b(row.data, digest_size=_DIGEST).digest() for row in packed]
    return np.frombuffer(b"".join(digests), np.uint8).reshape(len(grids), _DIGEST)


def _repeats(digests: Bytes, split: Bytes) -> Repeats:
    """Count equal digests, (N, 16), inside each split and between each two."""
    # one string of 16 bytes for each digest: numpy then compares whole digests
    keys = digests.view(f"S{_DIGEST}")[:, 0]
    # equal digests get equal numbers, which compare faster
    _, kinds = np.unique(keys, return_inverse=True)
    kinds_of = {name: kinds[split == code] for code, name in enumerate(SPLITS)}
    inside = {name: len(found) - len(np.unique(found)) for name, found in kinds_of.items()}
    across = {
        (a, b): int(np.isin(kinds_of[b], kinds_of[a]).sum()) for a, b in combinations(SPLITS, 2)
    }
    return Repeats(inside, across)
