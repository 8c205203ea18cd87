"""Problems that are sampled anew each epoch: functions of (sampling seed, epoch, index), never of worker state."""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.jit import Int, inlined, kernel
from mapdata.problems.sources import Bands
from mapdata.rng import PROBLEM, block, bounded
from mapdata.search.kernels import scratch, shortest_costs
from mapdata.search.lattice import COSTS, FAR, cell_at, heuristic, in_cells, lattice_of, load, parts, position

_ATTEMPTS = 32
"""Goals tried on one map before it is given up."""


@kernel
def sample_problems(
    grids: Bytes, seed: np.uint64, epoch: Int, indices: Ints, bands: Bands, diagonals: Int, step: Int
) -> Ints:
    """Sample a problem on each grid (docs/format.md, section 6): a goal, then one of the starts that fit it.

    The goal comes first so that the costs to it, which the conditions need, are those that fields of the goal need.

    Args:
        grids: (B, H, W).
        seed: sampling seed.
        epoch: pass over the data.
        indices: (B,) number of each problem.
        bands: as `Random.bands`; a tuple, which numba keeps in registers.
        diagonals: as `rule_of` gives it.
        step: likewise.

    Returns:
        (B, 6): start, goal, straight and diagonal steps of a shortest path (all count as straight where they cost
        the same); -1 where the map has no such problem.
    """
    rows, columns = grids.shape[1], grids.shape[2]
    lattice = lattice_of((rows, columns), (diagonals, step))
    buffers = scratch(COSTS, lattice)
    costs = buffers.g
    starts = np.empty(rows * columns, np.int64)
    sampled = np.full((len(grids), 6), -1)
    for b in range(len(grids)):
        free: Int = 0
        for row in range(rows):
            for column in range(columns):
                free += grids[b, row, column] == 0
        for attempt in range(_ATTEMPTS if free > 1 else 0):
            w0, w1, _w2, _w3 = block(seed, np.uint64(indices[b]), epoch, PROBLEM, attempt)
            goal_row, goal_column = _free_cell(grids[b], bounded(w0, 0, free - 1))
            goal = cell_at(goal_row, goal_column, lattice)
            load(grids[b], buffers.came)
            shortest_costs(goal, lattice, buffers)
            fitting = 0
            for row in range(rows):
                for column in range(columns):
                    cell = cell_at(row, column, lattice)
                    if costs[cell] == FAR or cell == goal:
                        continue
                    least = heuristic(row - goal_row, column - goal_column, lattice)
                    if _is_within(bands, costs[cell], least):
                        starts[fitting] = cell
                        fitting += 1
            if fitting:
                start = starts[bounded(w1, 0, fitting - 1)]
                sampled[b, 0], sampled[b, 1] = position(start, lattice)
                sampled[b, 2], sampled[b, 3] = goal_row, goal_column
                sampled[b, 4], sampled[b, 5] = parts(costs[start])
                break
    return sampled


@kernel
def _free_cell(grid: Bytes, number: Int) -> tuple[Int, Int]:
    """Return the ``number``-th free cell of a grid in row-major order."""
    left = number
    for row in range(grid.shape[0]):
        for column in range(grid.shape[1]):
            if grid[row, column] == 0:
                if left == 0:
                    return row, column
                left -= 1
    return -1, -1


@inlined
def _is_within(bands: Bands, cost: Int, least: Int) -> bool:
    """Return whether a problem of this cost and heuristic meets the conditions."""
    straight, diagonal = parts(cost)
    length: int = straight + diagonal + 1
    distance: float = in_cells(cost)
    hardness: float = distance / in_cells(least)
    distances, ratios, lengths = bands
    return (
        distances[0] <= distance <= distances[1]
        and ratios[0] <= hardness <= ratios[1]
        and lengths[0] <= length <= lengths[1]
    )


@kernel
def sample_numbers(seed: np.uint64, epoch: Int, indices: Ints, counts: Ints) -> Ints:
    """Return (B,) a number below ``counts[b]`` for each problem: which of so many pairs of seed points it is."""
    numbers = np.empty(len(indices), np.int64)
    for b in range(len(indices)):
        w0, _w1, _w2, _w3 = block(seed, np.uint64(indices[b]), epoch, PROBLEM, 0)
        numbers[b] = bounded(w0, 0, counts[b] - 1)
    return numbers
