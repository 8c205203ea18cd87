"""Seed points of maps that have none of their own (stream 5 of docs/format.md)."""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.generators.generator import Generator
from mapdata.generators.maps import Maps, pack
from mapdata.generators.splits import draw_splits, split_thresholds
from mapdata.jit import Int, kernel
from mapdata.rng import POINTS, block, bounded

_CANDIDATES = 8
"""Cells that are drawn for each seed point, of which the one farthest from the others is taken."""


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
    owner = np.zeros(rows * columns, np.int32)  # number of the component of a cell, from 1
    stack = np.empty(rows * columns, np.int64)
    best = 0
    most = 0
    number = 0
    for first in range(rows * columns):
        if grid[first // columns, first % columns] != 0 or owner[first] != 0:
            continue
        # Flood a new component from its first cell.
        number += 1
        owner[first] = number
        stack[0] = first
        height = 1
        size = 0
        while height:
            height -= 1
            size += 1
            row = stack[height] // columns
            column = stack[height] % columns
            for down in range(-1, 2):
                for right in range(-1, 2):
                    if down != 0 and right != 0 and diagonals != 2:  # 2: no corner rule
                        continue
                    r = row + down
                    c = column + right
                    if r < 0 or r >= rows or c < 0 or c >= columns or grid[r, c] != 0:
                        continue
                    cell = r * columns + c
                    if owner[cell] == 0:
                        owner[cell] = number
                        stack[height] = cell
                        height += 1
        if size > most:
            best = number
            most = size
    cells = np.empty(most, np.int64)
    k = 0
    for cell in range(rows * columns):
        if most and owner[cell] == best:  # without a free cell, best is 0, as all owners are
            cells[k] = cell
            k += 1
    return cells


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
    # Squared distance of each cell to the nearest point so far.
    gaps = np.full(len(cells), np.int64(2**62))
    for k in range(count):
        best = np.int64(-1)
        for j in range(_CANDIDATES // 4):
            for word in block(seed, index, 0, POINTS, _CANDIDATES // 4 * k + j):
                cell = bounded(word, 0, len(cells) - 1)
                if best < 0 or gaps[cell] > gaps[best]:
                    best = cell
        # If all candidates are points already: the next cell that is none.
        while gaps[best] == 0:
            best = (best + 1) % len(cells)
        points[k] = cells[best]
        for cell in range(len(cells)):
            rows = cells[cell] // columns - points[k] // columns
            aside = cells[cell] % columns - points[k] % columns
            gaps[cell] = min(gaps[cell], rows * rows + aside * aside)
    return points
