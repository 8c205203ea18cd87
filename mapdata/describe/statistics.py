"""Statistics of a dataset, computed in one pass over its shards."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, combinations

import numpy as np

from mapdata.arrays import Array, Bytes, Flags, Floats, Ints
from mapdata.generators.maps import Maps
from mapdata.limits import SPLITS
from mapdata.search.api import SEARCHES
from mapdata.search.ground import costs_of_sums
from mapdata.search.labels import Labels, label
from mapdata.search.lattice import hardness
from mapdata.search.map_stack import MapStack
from mapdata.search.terrain import min_cell_costs
from mapdata.shards.locations import Locations
from mapdata.shards.root import Root

_CELLS_AT_ONCE = 2**22
"""Cells that are unpacked to bytes at a time, so that memory does not grow with the shard size."""

_DIGEST_BYTES = 16
"""Size of the hash of a map: among 10**9 different maps, two collide with probability 1e-21."""

_DIGEST_DTYPE = f"S{_DIGEST_BYTES}"
"""The dtype of hashes, which numpy compares as texts."""

_MAX_BINS = 30
"""Bins of a histogram; whole numbers, which are centred in their bins, may need one more."""


@dataclass(frozen=True, eq=False)
class Repeats:
    """Numbers of maps that equal another map.

    Attributes:
        inside: for each split, the number of maps that equal an earlier map of that split.
        across: for each pair of splits (a, b), the number of maps of b that equal a map of a.
    """

    inside: dict[str, int]
    across: dict[tuple[str, str], int]


@dataclass(frozen=True, eq=False)
class DatasetStatistics:
    """Statistics of N maps with S route segments.

    Attributes:
        root: the dataset.
        index: (N,) int64, number of each map.
        rooms: (N,) int64, number of rooms, or of seed points if the rooms are not known.
        free: (N,) float64, share of free cells.
        split: (N,) uint8, 0 train, 1 val, 2 test.
        all_connected: (N,) bool, paths exist between all rooms.
        redundant: (N,) bool, `all_connected` although a passage was not drawn.
        hardest: (N,) float64, largest hardness of the map's segments; 0 where none has a path.
        lengths: (S,) int64, cells of the A* path of each segment, 0 without a path.
        costs: (S,) float64, optimal cost of each segment, -1 without a path.
        hardness: (S,) float64, optimal cost over heuristic, -1 without a path.
        iterations: of "bfs" and "astar", (S,) int64.
        rooms_known: whether the maps have rooms and passages, not only seed points.
        cell_counts: (256,) int64, number of cells of each cost on terrain, that of the occupied
            cells first; None for maps without terrain.
        digests: two arrays (N,) of 16 bytes: the hash of each map, and the smallest of the hashes
            of its symmetric images; None without ``repeats=True``.
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
    costs: Floats
    hardness: Floats
    iterations: dict[str, Ints]
    rooms_known: bool
    cell_counts: Ints | None
    digests: tuple[Array, Array] | None

    def __repr__(self) -> str:
        return f"DatasetStatistics({len(self)} maps, {len(self.lengths)} segments, {self.root!r})"

    def __len__(self) -> int:
        """Return N, the number of maps."""
        return len(self.index)

    @property
    def noun(self) -> str:
        """What the seed points of these maps are called: "room" or "seed point"."""
        return "room" if self.rooms_known else "seed point"

    @property
    def symmetries(self) -> int:
        """Number of symmetries of a map of this size, the identity included."""
        rows, columns = self.root.map_size
        return 8 if rows == columns else 4

    @cached_property
    def repeats(self) -> tuple[Repeats, Repeats]:
        """Numbers of repeated maps: exactly equal ones, and those that are equal up to symmetry.

        Raises:
            ValueError: the statistics were computed without ``repeats=True``.
        """
        if self.digests is None:
            raise ValueError("repeats: not counted; use dataset_statistics(root, repeats=True)")
        exact_digests, symmetric_digests = self.digests
        exact = count_repeats(exact_digests, self.split)
        symmetric = count_repeats(symmetric_digests, self.split)
        return exact, symmetric

    def distributions(self) -> dict[str, Floats]:
        """Return the samples of the distributions in card, report and figures, by title.

        Segments without a path are left out.
        """
        has_path = self.lengths > 0
        samples = {
            f"{self.noun}s a map": self.rooms.astype(np.float64),
            "free share of a map": self.free,
            "path length of a segment, cells": self.lengths[has_path].astype(np.float64),
            "hardness of a segment": self.hardness[has_path],
        }
        if self.cell_counts is not None:
            samples["cost of a segment"] = self.costs[has_path]
        return samples


def dataset_statistics(
    root: Locations,
    *,
    repeats: bool = False,
    follow_links: bool = False,
    progress: bool = False,
) -> DatasetStatistics:
    """Return the statistics of all finished maps of a dataset.

    Args:
        root: folder or URL of the dataset, or several.
        repeats: also hash all maps, which `DatasetStatistics.repeats` needs.
        follow_links: read files that are links out of their folder.
        progress: show a progress bar.

    Raises:
        DatasetNotFoundError: there is no dataset under ``root``.
        ShardError: a shard is missing or damaged.
    """
    opened = Root.open(root, follow_links=follow_links)
    # The arrays of no maps come first, so that an empty dataset has arrays of the right types.
    no_maps = label(Maps.empty(opened.movement, opened.map_size, np.arange(0), 2))
    batches = chain([no_maps], opened.labels(progress=progress))
    columns_of_shards = [_shard_columns(labels, repeats) for labels in batches]
    columns = {
        name: np.concatenate([shard_columns[name] for shard_columns in columns_of_shards])
        for name in columns_of_shards[0]
    }
    return DatasetStatistics(
        root=opened,
        index=columns["index"],
        rooms=columns["rooms"],
        free=columns["free"],
        split=columns["split"],
        all_connected=columns["all_connected"],
        redundant=columns["redundant"],
        hardest=columns["hardest"],
        lengths=columns["lengths"],
        costs=columns["costs"],
        hardness=columns["hardness"],
        iterations={search: columns[search] for search in SEARCHES},
        rooms_known=bool(columns["rooms_known"].any()),
        cell_counts=columns["cell_counts"].sum(axis=0) if opened.has_terrain else None,
        digests=(columns["exact"], columns["symmetric"]) if repeats else None,
    )


def bin_edges(values: Floats) -> Floats:
    """Return the edges (k + 1,) of a histogram of ``values`` with up to 31 bins.

    If all values are whole numbers, a bin holds one whole number, or several if there are many.
    The edges are halfway between whole numbers.

    >>> bin_edges(np.array([2.0, 3.0, 3.0]))
    array([1.5, 2.5, 3.5])
    """
    are_whole = len(values) > 0 and (values == np.rint(values)).all()
    if not are_whole:
        return np.histogram_bin_edges(values, _MAX_BINS)
    low = values.min()
    high = values.max()
    width = max(1, math.ceil((high - low + 1) / _MAX_BINS))
    return np.arange(low, high + width + 0.5, width) - 0.5


def _shard_columns(labels: Labels, hash_maps: bool) -> dict[str, Array]:
    """Return the part of a shard in each array of a `DatasetStatistics`, by name.

    The arrays of hashes, "exact" and "symmetric", are empty without ``hash_maps``.
    """
    maps = labels.maps
    passages = maps.rooms - 1
    # The rows of a map are padded to the largest number of rooms of the shard.
    is_passage = np.arange(maps.directions.shape[1]) < passages[:, None]
    starts = maps.seed_points[:, :-1][is_passage]
    goals = maps.seed_points[:, 1:][is_passage]
    map_of_segment = np.repeat(np.arange(len(maps)), passages)
    segment_costs = labels.astar.costs[maps.segment_pairs]
    min_costs = None if maps.terrain is None else min_cell_costs(maps.terrain)[map_of_segment]
    costs = costs_of_sums(segment_costs, maps.movement, are_doubled=min_costs is not None)
    segment_hardness = hardness(costs, starts, goals, maps.movement, min_costs)
    max_hardness = np.zeros(len(maps))
    np.maximum.at(max_hardness, map_of_segment, segment_hardness)
    rooms_known = (maps.sizes >= 0).any() or (maps.passage_width >= 0).any()
    lacks_passage = (~maps.connected & is_passage).any(axis=1)
    return {
        "index": maps.index,
        "rooms": maps.rooms,
        "split": maps.split,
        "all_connected": labels.all_connected,
        "redundant": labels.all_connected & lacks_passage & rooms_known,
        "hardest": max_hardness,
        "lengths": np.where(labels.reachable, np.diff(labels.astar.offsets) + 1, 0),
        "costs": costs,
        "hardness": segment_hardness,
        "bfs": labels.bfs.iterations,
        "astar": labels.astar.iterations,
        "rooms_known": np.array([rooms_known]),
        **_grid_columns(maps, hash_maps),
    }


def _grid_columns(maps: Maps, hash_maps: bool) -> dict[str, Array]:
    """Return the free share of each map, its two digests with ``hash_maps``, and counts of cells.

    "cell_counts" is an array (1, 256) with the number of cells of each cost; 0 without terrain.
    """
    count, rows, _ = maps.packed.shape
    maps_at_once = max(1, _CELLS_AT_ONCE // (rows * maps.columns))
    free = []
    exact_digests = []
    symmetric_digests = []
    cell_counts = np.zeros((1, 256), np.int64)
    # Without maps there is one empty batch, so that there are shares to concatenate.
    for first in range(0, max(count, 1), maps_at_once):
        batch = slice(first, first + maps_at_once)
        stack = MapStack.of(maps, batch)
        free.append(1 - stack.grids.mean(axis=(1, 2)))
        if stack.has_terrain:
            cell_counts[0] += np.bincount(stack.content.reshape(-1), minlength=256)
        if hash_maps:
            exact, symmetric = digests_of(stack.content, is_terrain=stack.has_terrain)
            exact_digests += exact
            symmetric_digests += symmetric
    return {
        "cell_counts": cell_counts,
        "free": np.concatenate(free),
        "exact": np.array(exact_digests, _DIGEST_DTYPE),
        "symmetric": np.array(symmetric_digests, _DIGEST_DTYPE),
    }


def digests_of(grids: Bytes, *, is_terrain: bool = False) -> tuple[list[bytes], list[bytes]]:
    """Return two hashes of each of N grids, (N, H, W).

    Args:
        grids: of 0 and 1, or terrain.
        is_terrain: whether they are terrain.

    Returns:
        The hash of each grid, and the smallest of the hashes of its symmetric images, which is
        equal for grids that are equal up to symmetry.
    """
    digests_of_images = [
        hash_grids(image, is_terrain=is_terrain) for image in _symmetric_images(grids)
    ]
    exact = digests_of_images[0]
    symmetric = [min(digests) for digests in zip(*digests_of_images, strict=True)]
    return exact, symmetric


def _symmetric_images(grids: Bytes) -> list[Bytes]:
    """Return the images of grids, (N, H, W), under all symmetries, beginning with the identity.

    Square grids have 8 symmetries, and others have 4.
    """
    orientations = [grids]
    rows, columns = grids.shape[1:]
    if rows == columns:
        orientations.append(grids.swapaxes(1, 2))
    images = []
    for oriented in orientations:
        images += [oriented, np.flip(oriented, 1), np.flip(oriented, 2), np.flip(oriented, (1, 2))]
    return images


def hash_grids(grids: Bytes, *, is_terrain: bool = False) -> list[bytes]:
    """Return a hash of each of N grids, (N, H, W), of 0 and 1 or of terrain."""
    hashed = grids if is_terrain else np.packbits(grids, axis=2)
    return [hashlib.blake2b(grid.tobytes(), digest_size=_DIGEST_BYTES).digest() for grid in hashed]


def count_repeats(digests: Array, split: Bytes) -> Repeats:
    """Return the numbers of maps that equal another map inside a split and across splits.

    Args:
        digests: (N,) hashes of the maps.
        split: (N,) split of each map as a code, 0 to 2.
    """
    # Equal digests get the same number, since numbers compare faster.
    _, numbers = np.unique(digests, return_inverse=True)
    numbers_by_split = {name: numbers[split == code] for code, name in enumerate(SPLITS)}
    inside = {
        name: len(split_numbers) - len(np.unique(split_numbers))
        for name, split_numbers in numbers_by_split.items()
    }
    across = {}
    for first, second in combinations(SPLITS, 2):
        is_repeated = np.isin(numbers_by_split[second], numbers_by_split[first])
        across[first, second] = int(is_repeated.sum())
    return Repeats(inside, across)
