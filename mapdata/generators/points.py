"""Seed points of maps that have none of their own (stream 5 of docs/format.md)."""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.generators.generator import Generator
from mapdata.generators.maps import Maps, pack
from mapdata.generators.splits import draw_splits, split_thresholds
from mapdata.jit import Int, kernel
from mapdata.rng import POINTS, block, bounded
from mapdata.spec import MAX_ROOMS, check_count

_EARLIER = np.array([(0, -1), (-1, 0), (-1, -1), (-1, 1)])
"""Neighbours W, N, NW, NE of a cell as (row, col): those that come before it."""

_CANDIDATES = 8
"""Cells that are drawn for each seed point, of which the one farthest from the others is taken."""


def check_seed_points(name: str, count: object, most: int = MAX_ROOMS) -> int:
    """Return how many seed points a map has, as an int; ValueError unless 2 to ``most``."""
    points = check_count(name, count, 2)
    if points > most:
        raise ValueError(f"{name}: got {points}, expected at most {most} here")
    return points


def with_seed_points(spec: Generator, seed: int, indices: Ints, grids: Bytes) -> Maps:
    """Return grids (N, H, W) as the maps ``indices`` of (spec, seed), with seed points.

    `spread_points` draws them among the free cells of the largest component, far apart, none twice:
    ``spec.most_seed_points`` of them.
    """
    most = spec.most_seed_points
    maps = Maps.empty(spec.movement, spec.map_size, indices, most)
    key = np.uint64(seed)
    for k, grid in enumerate(grids):
        cells = largest_component(grid, 0)  # by straight steps, which every movement has
        points = spread_points(cells, maps.columns, key, np.uint64(indices[k]), most)
        maps.rooms[k] = len(points)
        maps.seed_points[k, : len(points)] = np.stack(np.divmod(points, maps.columns), axis=1)
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
    # Union-find: of a free cell an earlier one of its component; the first one has itself.
    owner = np.empty(rows * columns, np.int64)
    earlier = 4 if diagonals == 2 else 2  # 2: diagonal moves without a corner rule
    for row in range(rows):
        for column in range(columns):
            if grid[row, column] != 0:
                continue
            cell = row * columns + column
            owner[cell] = cell
            for down, right in _EARLIER[:earlier]:
                r = row + down
                c = column + right
                if r >= 0 and 0 <= c < columns and grid[r, c] == 0:
                    _join(owner, cell, r * columns + c)
    sizes = np.zeros(rows * columns, np.int64)
    for cell in range(rows * columns):
        if grid[cell // columns, cell % columns] == 0:
            # Its owner comes earlier and therefore has the first cell as its own already.
            owner[cell] = owner[owner[cell]]
            sizes[owner[cell]] += 1
    best = np.argmax(sizes)  # the first of equal ones
    cells = np.empty(sizes[best], np.int64)
    k = 0
    for cell in range(rows * columns):
        if grid[cell // columns, cell % columns] == 0 and owner[cell] == best:
            cells[k] = cell
            k += 1
    return cells


@kernel
def _join(owner: Ints, one: Int, other: Int) -> None:
    """Make two components one, whose owner is the earlier of their first cells."""
    while owner[one] != one:
        one = owner[one]
    while owner[other] != other:
        owner[other] = owner[owner[other]]  # halves the way for those who come after
        other = owner[other]
    owner[max(one, other)] = min(one, other)


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
