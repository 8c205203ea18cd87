"""What a dataset is like: one pass over its shards for the card, the report and the figures."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from mapdata.arrays import Bytes, Flags, Floats, Ints
from mapdata.generators.maps import Maps
from mapdata.search.labels import Labels, label
from mapdata.search.lattice import hardness
from mapdata.shards.root import Places, Root
from mapdata.spec import SPLITS

_CELLS_AT_ONCE = 2**22
_DIGEST = 16


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
            images.
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
        """Repeated maps: exactly the same, and the same up to the symmetries."""
        if self.digests is None:
            raise ValueError("repeats: not counted; use dataset_statistics(root, repeats=True)")
        exact, symmetric = (_repeats(digests, self.split) for digests in self.digests)
        return exact, symmetric

    def distributions(self) -> dict[str, Floats]:
        """Return the values of each distribution that is shown, those of a segment only where it
        has a path.
        """
        found = self.lengths > 0
        return {
            "rooms a map" if self.rooms_known else "seed points a map": self.rooms.astype(
                np.float64
            ),
            "free share of a map": self.free,
            "path length of a segment, cells": self.lengths[found].astype(np.float64),
            "hardness of a segment": self.hardness[found],
        }


def dataset_statistics(root: Places, *, repeats: bool = False) -> DatasetStatistics:
    """Look at all finished maps of a dataset once.

    Args:
        root: folder or URL of the dataset, or several.
        repeats: hash all maps, too, so that `DatasetStatistics.repeats` can be counted.

    Raises:
        DatasetNotFoundError: there is no dataset under ``root``.
        ShardError: a shard is missing or damaged.
    """
    opened = Root.open(root)
    parts = [_columns(labels, repeats) for labels in opened.labels()]
    if not parts:  # the columns of no map have their types too
        nothing = label(Maps.empty(opened.movement, opened.map_size, np.arange(0), 2))
        parts = [_columns(nothing, repeats)]
    table = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    known = bool(table.pop("known").any())
    digests = (table.pop("exact"), table.pop("symmetric"))
    iterations = {name: table.pop(name) for name in ("bfs", "astar")}
    return DatasetStatistics(
        root=opened,
        iterations=iterations,
        rooms_known=known,
        digests=digests if repeats else None,
        **table,
    )


def histogram(values: Floats, bins: int = 30) -> tuple[Floats, Ints]:
    """Return edges (k + 1,) and counts (k,) of ``values``: a bin an integer where those are few,
    else ``bins``.

    >>> histogram(np.array([2.0, 3.0, 3.0]))
    (array([1.5, 2.5, 3.5]), array([1, 2]))
    """
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    if bool((values == np.rint(values)).all()):
        width = max(1, math.ceil((high - low + 1) / bins))
        edges = np.arange(low, high + width + 0.5, width) - 0.5
    else:
        edges = np.linspace(low, high if high > low else low + 1, bins + 1)
    counts, _ = np.histogram(values, edges)
    return edges, counts.astype(np.int64)


def _columns(labels: Labels, hashes: bool) -> dict[str, npt.NDArray[Any]]:
    """Return what a shard adds to each array of a `DatasetStatistics`."""
    maps, movement = labels.maps, labels.maps.movement
    used = np.arange(maps.directions.shape[1]) < (maps.rooms - 1)[:, None]
    starts, goals = maps.seed_points[:, :-1][used], maps.seed_points[:, 1:][used]
    steps = np.diff(labels.astar.offsets)
    diagonal = np.diff(_diagonal_moves(labels))
    costs = steps - diagonal + diagonal * movement.diagonal_cost
    costs[~labels.reachable] = -1
    hard = hardness(costs, starts, goals, movement)
    hardest = np.zeros(len(maps))
    np.maximum.at(hardest, np.repeat(np.arange(len(maps)), maps.rooms - 1), hard)
    known = bool((maps.sizes >= 0).any() or (maps.passage_width >= 0).any())
    free, exact, symmetric = _grid_columns(labels, hashes)
    return {
        "index": maps.index,
        "rooms": maps.rooms,
        "free": free,
        "split": maps.split,
        "all_connected": labels.all_connected,
        "redundant": labels.all_connected & (~maps.connected & used).any(axis=1) & known,
        "hardest": hardest,
        "lengths": np.where(labels.reachable, steps + 1, 0),
        "hardness": hard,
        "bfs": labels.bfs.iterations,
        "astar": labels.astar.iterations,
        "known": np.array([known]),
        "exact": exact,
        "symmetric": symmetric,
    }


def _diagonal_moves(labels: Labels) -> Ints:
    """Return (S + 1,) int64, diagonal moves of A* before each segment."""
    return np.concatenate(([0], np.cumsum(labels.astar.moves >= 4)))[labels.astar.offsets]


def _grid_columns(labels: Labels, hashes: bool) -> tuple[Floats, Bytes, Bytes]:
    """Return the free share of each map and its two digests."""
    maps = labels.maps
    count, rows, columns = len(maps), maps.packed.shape[1], maps.columns
    free = np.empty(count)
    digests = np.empty((2, count, _DIGEST if hashes else 0), np.uint8)
    step = max(1, _CELLS_AT_ONCE // (rows * columns))
    octets = maps.packed.astype("<u8", copy=False).view(np.uint8)
    for first in range(0, count, step):
        part = slice(first, first + step)
        grids = np.unpackbits(octets[part], axis=2, count=columns, bitorder="little")
        free[part] = 1 - grids.mean(axis=(1, 2))
        if hashes:
            images = [_digest(image) for image in _images(grids)]
            digests[0, part] = images[0]
            keys = np.stack(images, axis=1).view(f"S{_DIGEST}")[..., 0]
            digests[1, part] = np.sort(keys, axis=1)[:, :1].copy().view(np.uint8)
    return free, digests[0], digests[1]


def _images(grids: Bytes) -> Iterator[Bytes]:
    """Yield the symmetric images of (N, H, W) grids, the grids first: 8 of square ones, else 4."""
    square = grids.shape[1] == grids.shape[2]
    for image in (grids, grids.swapaxes(1, 2)) if square else (grids,):
        for flipped in (image, image[:, ::-1]):
            yield flipped
            yield flipped[:, :, ::-1]


def _digest(grids: Bytes) -> Bytes:
    """Return (N, 16) uint8, a hash of each grid."""
    packed = np.ascontiguousarray(np.packbits(grids, axis=2)).reshape(len(grids), -1)
    found = b"".join(hashlib.blake2b(row, digest_size=_DIGEST).digest() for row in packed)  # type: ignore[arg-type]
    return np.frombuffer(found, np.uint8).reshape(len(grids), _DIGEST)


def _repeats(digests: Bytes, split: Bytes) -> Repeats:
    keys = (
        np.ascontiguousarray(digests).view(f"S{_DIGEST}")[:, 0]
        if len(digests)
        else np.empty(0, "S1")
    )
    _, kind = np.unique(keys, return_inverse=True)
    kinds = {name: kind[split == code] for code, name in enumerate(SPLITS)}
    pairs = [(a, b) for k, a in enumerate(SPLITS) for b in SPLITS[k + 1 :]]
    return Repeats(
        inside={name: len(found) - len(np.unique(found)) for name, found in kinds.items()},
        across={(a, b): int(np.isin(kinds[b], kinds[a]).sum()) for a, b in pairs},
    )
