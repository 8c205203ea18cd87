"""Seed points of maps that have none of their own (stream 5 of docs/format.md)."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.checks import check_count
from mapdata.generators.generator import MapGenerator
from mapdata.generators.maps import Maps, pack
from mapdata.generators.splits import draw_splits, split_thresholds
from mapdata.jit import Int, kernel
from mapdata.limits import MAX_ROOMS
from mapdata.movement import STEPS
from mapdata.rng import POINTS, block, bounded

_CANDIDATES = 8
"""Cells that are drawn for each seed point, of which the one farthest from the others is taken."""


def check_seed_points(name: str, count: object, most: int = MAX_ROOMS) -> int:
    """Return how many seed points a map has, as an int; ValueError unless 2 to ``most``."""
    points = check_count(name, count, 2)
    if points > most:
        raise ValueError(f"{name}: got {points}, expected at most {most} here")
    return points


class Scattered(MapGenerator):
    """A family that draws grids, on which at most ``seed_points`` seed points are then scattered.

    A subclass has that field and says how one grid is drawn.
    """

    seed_points: int

    @property
    def most_seed_points(self) -> int:
        """How many seed points a map has at most."""
        return self.seed_points

    @abstractmethod
    def draw_grid(self, grid: Bytes, seed: np.uint64, index: np.uint64) -> None:
        """Fill ``grid``, (H, W) of zeros, with 0 free and 1 occupied: map ``index``."""

    def draw(self, seed: int, indices: Ints) -> Maps:
        """Return the maps ``indices``, (N,) int64."""
        grids = np.zeros((len(indices), *self.map_size), np.uint8)
        for grid, index in zip(grids, indices, strict=True):
            self.draw_grid(grid, np.uint64(seed), np.uint64(index))
        return with_seed_points(self, seed, indices, grids)


def with_seed_points(spec: MapGenerator, seed: int, indices: Ints, grids: Bytes) -> Maps:
    """Return grids (N, H, W) as the maps ``indices`` of (spec, seed), with seed points.

    `spread_points` draws them among the free cells of the largest component, far apart, none twice:
    ``spec.most_seed_points`` of them.

    Raises:
        ValueError: maps of another size than the spec's.
    """
    if grids.shape != (len(indices), *spec.map_size):
        raise ValueError(
            f"grids: got shape {grids.shape}, expected {len(indices)} maps of {spec.map_size}"
        )
    most = spec.most_seed_points
    maps = Maps.empty(spec.movement, spec.map_size, indices, most)
    key = np.uint64(seed)
    for k, grid in enumerate(grids):
        cells = largest_component(grid, 0)  # by straight steps, which every movement has
        points = spread_points(cells, maps.columns, key, np.uint64(indices[k]), most)
        maps.rooms[k] = len(points)
        maps.seed_points[k, : len(points)] = np.column_stack(np.divmod(points, maps.columns))
    maps.packed[:] = pack(grids)
    maps.split[:] = draw_splits(key, indices, split_thresholds(spec.splits))
    return maps


@kernel
def largest_component(grid: Bytes, diagonals: Int) -> Ints:
    """Return the free cells of the largest component of ``grid``, (H, W).

    They are row * W + column, in row-major order; of equally large components it is that which
    holds the first cell. ``diagonals`` is as in a `Lattice` of mapdata/search; diagonal steps
    beside two free cells join nothing that straight ones do not.
    """
    rows, columns = grid.shape
    steps = STEPS if diagonals == 2 else STEPS[:4]  # 2: diagonal moves without a corner rule
    # 0 free and 1 occupied; then the number of each component, from 2 on.
    marks = np.ascontiguousarray(grid).astype(np.int64)
    flat = marks.reshape(-1)
    queue = np.empty(rows * columns, np.int64)
    number = 1
    best = 0  # no cell has this number afterwards
    most = 0
    for first in range(rows * columns):
        if flat[first] != 0:
            continue
        # Breadth-first search from the first cell of a component: the queue comes to hold all.
        number += 1
        flat[first] = number
        queue[0] = first
        found = 1
        done = 0
        while done < found:
            row, column = divmod(queue[done], columns)
            done += 1
            for down, right in steps:
                r = row + down
                c = column + right
                if 0 <= r < rows and 0 <= c < columns and marks[r, c] == 0:
                    marks[r, c] = number
                    queue[found] = r * columns + c
                    found += 1
        if found > most:
            best = number
            most = found
    return np.flatnonzero(flat == best)


@kernel
def draw_points(cells: Ints, seed: np.uint64, index: np.uint64, count: Int) -> Ints:
    """Return ``count`` of ``cells``, none twice: draw k is one of those left, in their order."""
    left = list(cells)
    drawn = np.empty(count, np.int64)
    for k in range(count):
        word, _, _, _ = block(seed, index, 0, POINTS, k)
        drawn[k] = left.pop(bounded(word, 0, len(left) - 1))
    return drawn


@kernel
def spread_points(cells: Ints, columns: Int, seed: np.uint64, index: np.uint64, count: Int) -> Ints:
    """Return up to ``count`` of ``cells``, none twice, that lie far apart.

    Mitchell's best candidates: each point is the one of 8 cells drawn uniformly whose nearest
    earlier point is farthest away (of equally far ones the first drawn). Mitchell, "Spectrally
    optimal sampling for distribution ray tracing", SIGGRAPH 1991, section 4.
    """
    count = min(count, len(cells))
    points = np.empty(count, np.int64)
    for k in range(count):
        best = np.int64(-1)
        widest = np.int64(-1)
        for j in range(_CANDIDATES // 4):
            for word in block(seed, index, 0, POINTS, _CANDIDATES // 4 * k + j):
                place = bounded(word, 0, len(cells) - 1)
                gap = _gap(cells[place], points[:k], columns)
                if gap > widest:
                    best = place
                    widest = gap
        # If all candidates are points already: the next cell that is none.
        while _gap(cells[best], points[:k], columns) == 0:
            best = (best + 1) % len(cells)
        points[k] = cells[best]
    return points


@kernel
def _gap(cell: Int, points: Ints, columns: Int) -> Int:
    """Return the squared distance of a cell to the nearest of ``points``; without any, 2**62."""
    least = np.int64(2**62)
    for point in points:
        rows = cell // columns - point // columns
        aside = cell % columns - point % columns
        least = min(least, rows * rows + aside * aside)
    return least
