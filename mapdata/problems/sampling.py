"""Problems that are sampled anew each epoch.

They are functions of (sampling seed, epoch, index), never of the state of a worker.
"""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.jit import Int, inlined, kernel
from mapdata.problems.sources import Bands
from mapdata.rng import PROBLEM, block, bounded
from mapdata.search.kernels import find, scratch, shortest_costs, wipe, write_cells
from mapdata.search.lattice import (
    ASTAR,
    BFS,
    COSTS,
    FAR,
    Rule,
    Weights,
    cell_at,
    heuristic,
    in_cells,
    lattice_of,
    load,
    parts,
    position,
)

_ATTEMPTS = 32
"""Goals tried on one map before it is given up."""


@kernel
def sample_problems(
    grids: Bytes,
    seed: np.uint64,
    epoch: Int,
    indices: Ints,
    bands: Bands,
    diagonals: Int,
    step: Int,
) -> Ints:
    """Sample a problem on each grid: a goal, then one of the starts that fit it.

    docs/format.md, section 6, fixes the draws. The goal comes first so that the costs to it, which
    the conditions need, are those that fields of the goal need.

    Args:
        grids: (B, H, W).
        seed: sampling seed.
        epoch: pass over the data.
        indices: (B,) number of each problem.
        bands: as `Random.bands`; a tuple, which numba keeps in registers.
        diagonals: as `rule_of` gives it.
        step: likewise.

    Returns:
        (B, 6): start, goal, straight and diagonal steps of a shortest path (all count as straight
        where they cost the same); -1 where the map has no such problem.
    """
    rows, columns = grids.shape[1:]
    lattice = lattice_of((rows, columns), (diagonals, step))
    buffers = scratch(COSTS, lattice)
    costs = buffers.g
    starts = np.empty(rows * columns, np.int64)
    sampled = np.full((len(grids), 6), -1)
    for b in range(len(grids)):
        free: Int = 0
        for row in range(rows):
            for column in range(columns):
                if grids[b, row, column] == 0:
                    free += 1
        if free < 2:
            continue
        for attempt in range(_ATTEMPTS):
            w0, w1, _, _ = block(seed, np.uint64(indices[b]), epoch, PROBLEM, attempt)
            goal_row, goal_column = _free_cell(grids[b], bounded(w0, 0, free - 1))
            goal = cell_at(goal_row, goal_column, lattice)
            load(grids[b], buffers.came)
            shortest_costs(goal, lattice, buffers)
            # A uniform start among those that fit: they are listed in row-major order.
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
                sampled[b, 2] = goal_row
                sampled[b, 3] = goal_column
                sampled[b, 4], sampled[b, 5] = parts(costs[start])
                break
            # Nothing fits this goal: another one.
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
def solve_pairs(
    grids: Bytes,
    seed_points: Ints,
    rooms: Ints,
    seed: np.uint64,
    epoch: Int,
    indices: Ints,
    kind: tuple[Int, Int],
    search: Weights,
    rule: Rule,
) -> tuple[Ints, Ints, Ints, Ints]:
    """Sample a pair of seed points on each grid and search its path.

    A pair without a path gives way to the next one, until all pairs of the map have been tried.

    Args:
        grids: (B, H, W).
        seed_points: (B, R, 2) cells.
        rooms: (B,) number of seed points.
        seed: sampling seed.
        epoch: pass over the data.
        indices: (B,) number of each problem.
        kind: whether the pairs are those of the route, (q, q + 1), instead of all i < j; whether
            pairs without a path are kept.
        search: BFS or ASTAR.
        rule: as `rule_of` gives it.

    Returns:
        ends (B, 4): start and goal, or -1 where no pair fits; cells (M, 2) and offsets (B + 1,) of
        the paths; iterations (B,).
    """
    count = len(grids)
    route, unsolvable = kind
    lattice = lattice_of(grids.shape[1:], rule)
    buffers = scratch(search, lattice)
    ends = np.full((count, 4), -1)
    offsets = np.zeros(count + 1, np.int64)
    iterations = np.zeros(count, np.int64)
    cells = np.empty((64 * count + 64, 2), np.int64)
    for b in range(count):
        n = rooms[b]
        used = offsets[b]
        offsets[b + 1] = used
        pairs = n - 1 if route else n * (n - 1) // 2
        word, _, _, _ = block(seed, np.uint64(indices[b]), epoch, PROBLEM, 0)
        first = bounded(word, 0, pairs - 1)
        load(grids[b], buffers.came)
        for attempt in range(pairs):
            i, j = _pair((first + attempt) % pairs, n, route)
            start = cell_at(seed_points[b, i, 0], seed_points[b, i, 1], lattice)
            goal = cell_at(seed_points[b, j, 0], seed_points[b, j, 1], lattice)
            if start == goal:
                continue
            if search == BFS and attempt:  # A* wipes what it wrote, BFS does not
                load(grids[b], buffers.came)
            straight, diagonal, expansions, pushes = find(start, goal, search, lattice, buffers)
            length = straight + diagonal + 1  # no path: -1 + 0 + 1 cells
            if length or unsolvable:
                ends[b, 0], ends[b, 1] = position(start, lattice)
                ends[b, 2], ends[b, 3] = position(goal, lattice)
                if used + length > len(cells):
                    longer = np.empty((2 * (used + length), 2), np.int64)
                    longer[:used] = cells[:used]
                    cells = longer
                write_cells(buffers.came, goal, lattice, cells[used : used + length])
                offsets[b + 1] = used + length
                iterations[b] = expansions
                break
            if search == ASTAR:
                wipe(buffers, pushes)
    return ends, cells[: offsets[count]], offsets, iterations


@kernel
def _pair(number: Int, points: Int, route: Int) -> tuple[Int, Int]:
    """Return seed points i < j of pair ``number``: of the route, or of all in row-major order."""
    if route:
        return number, number + 1
    i = 0
    while number >= points - 1 - i:  # row i has the pairs with j from i + 1 to points - 1
        number -= points - 1 - i
        i += 1
    return i, i + 1 + number
