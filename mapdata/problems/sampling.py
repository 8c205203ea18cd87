"""Problems and symmetries that are drawn anew each epoch: functions of (order seed, epoch, number), never of worker
state.
"""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Bytes, Flags, Ints
from mapdata.jit import Int, kernel
from mapdata.rng import ORDER, PROBLEM, block, bounded
from mapdata.search.kernels import find, scratch, shortest_costs, wipe, write_cells
from mapdata.search.lattice import (
    ASTAR,
    BFS,
    COSTS,
    UNIT,
    Weights,
    cell_at,
    heuristic,
    in_cells,
    lattice_of,
    load,
    position,
)

_TRIES = 32
"""Start cells tried on one map before it is given up."""


@kernel
def sample_problems(
    grids: Bytes,
    seed: np.uint64,
    epoch: Int,
    indices: Ints,
    min_distance: float,
    min_hardness: float,
    diagonals: Int,
    step: Int,
    starts: Ints,
    goals: Ints,
    found: Flags,
) -> None:
    """Draw a start and a goal on each grid: a uniform free cell, then a uniform one of those that meet the conditions.

    Args:
        grids: (B, H, W).
        seed: order seed.
        epoch: pass over the data.
        indices: (B,) number of each problem.
        min_distance: least cost of the shortest path.
        min_hardness: least ratio of that cost to the heuristic.
        diagonals: as `rule_of` gives it.
        step: likewise.
        starts: (B, 2), filled.
        goals: (B, 2), filled.
        found: (B,), filled: False where no problem of the map meets the conditions.
    """
    rows, columns = grids.shape[1], grids.shape[2]
    lattice = lattice_of((rows, columns), (diagonals, step))
    buffers = scratch(COSTS, lattice)
    came, costs, queue, _, _ = buffers
    candidates = np.empty(lattice.cells, np.int64)
    for b in range(len(grids)):
        found[b], free = False, 0
        for row in range(rows):
            for column in range(columns):
                free += grids[b, row, column] == 0
        for attempt in range(_TRIES if free > 1 else 0):
            w0, w1, _w2, _w3 = block(seed, np.uint64(indices[b]), epoch, PROBLEM, attempt)
            start = _free_cell(grids[b], bounded(w0, 0, free - 1))
            load(grids[b], came)
            source = cell_at(start // columns, start % columns, lattice)
            count = shortest_costs(source, lattice, buffers)
            kept = 0
            for k in range(count):
                cell = np.int64(queue[k])
                if cell == source:
                    continue
                row, column = position(cell, lattice)
                least = heuristic(row - start // columns, column - start % columns, lattice)
                if in_cells(costs[cell]) >= min_distance and costs[cell] / UNIT >= min_hardness * (least / UNIT):
                    candidates[kept] = cell
                    kept += 1
            if kept:
                chosen = candidates[bounded(w1, 0, kept - 1)]
                starts[b, 0], starts[b, 1] = start // columns, start % columns
                goals[b, 0], goals[b, 1] = position(chosen, lattice)
                found[b] = True
                break


@kernel
def _free_cell(grid: Bytes, number: Int) -> Int:
    """Return the ``number``-th free cell of a grid, in row-major order, as row * columns + column."""
    left = number
    for row in range(grid.shape[0]):
        for column in range(grid.shape[1]):
            if grid[row, column] == 0:
                if left == 0:
                    return row * grid.shape[1] + column
                left -= 1
    return -1


@kernel
def solve_pairs(
    grids: Bytes,
    seed_points: Ints,
    rooms: Ints,
    seed: np.uint64,
    epoch: Int,
    indices: Ints,
    route: Int,
    unsolvable: Int,
    search: Weights,
    diagonals: Int,
    step: Int,
) -> tuple[Ints, Ints, Ints, Ints]:
    """Draw a pair of rooms on each grid and search its path; a pair without one gives way to the next, until all were
    tried.

    Args:
        grids: (B, H, W).
        seed_points: (B, R, 2) cells of the rooms.
        rooms: (B,) number of rooms.
        seed: order seed.
        epoch: pass over the data.
        indices: (B,) number of each problem.
        route: draw from the pairs (q, q + 1) instead of all i < j.
        unsolvable: keep pairs without a path.
        search: BFS or ASTAR.
        diagonals: as `rule_of` gives it.
        step: likewise.

    Returns:
        ends (B, 4): start and goal, or -1 where no pair fits; cells (M, 2) and offsets (B + 1,) of the paths;
        iterations (B,).
    """
    count = len(grids)
    lattice = lattice_of(grids.shape[1:], (diagonals, step))
    buffers = scratch(search, lattice)
    ends, ways, iterations = np.full((count, 4), -1), np.zeros(count + 1, np.int64), np.zeros(count, np.int64)
    cells = np.empty((64 * count + 64, 2), np.int64)
    for b in range(count):
        n, used = rooms[b], ways[b]
        ways[b + 1] = used
        pairs = n - 1 if route else n * (n - 1) // 2
        word, _, _, _ = block(seed, np.uint64(indices[b]), epoch, PROBLEM, 0)
        drawn = bounded(word, 0, pairs - 1)
        load(grids[b], buffers.came)
        for attempt in range(pairs):
            i, j = _pair((drawn + attempt) % pairs, n, route)
            start = cell_at(seed_points[b, i, 0], seed_points[b, i, 1], lattice)
            goal = cell_at(seed_points[b, j, 0], seed_points[b, j, 1], lattice)
            if start == goal:
                continue
            if search == BFS and attempt:
                load(grids[b], buffers.came)
            straight, diagonal, expanded, pushes = find(start, goal, search, lattice, buffers)
            length = straight + diagonal + 1
            if length or unsolvable:
                ends[b, 0], ends[b, 1], ends[b, 2], ends[b, 3] = (
                    seed_points[b, i, 0],
                    seed_points[b, i, 1],
                    seed_points[b, j, 0],
                    seed_points[b, j, 1],
                )
                if used + length > len(cells):
                    longer = np.empty((2 * (used + length), 2), np.int64)
                    longer[:used] = cells[:used]
                    cells = longer
                write_cells(buffers.came, goal, lattice, cells[used : used + length])
                ways[b + 1], iterations[b] = used + length, expanded
                break
            if search == ASTAR:
                wipe(buffers, pushes)
    return ends, cells[: ways[count]], ways, iterations


@kernel
def _pair(number: Int, rooms: Int, route: Int) -> tuple[Int, Int]:
    """Return rooms i < j of pair ``number``: (q, q + 1) with ``route``, else in row-major order."""
    if route:
        return number, number + 1
    i, k = 0, number
    while k >= rooms - 1 - i:
        k -= rooms - 1 - i
        i += 1
    return i, i + 1 + k


@kernel
def replace_paths(cells: Ints, ways: Ints, others: Ints, other_ways: Ints, where: Ints) -> tuple[Ints, Ints]:
    """Return paths with those numbered ``where`` (ascending) replaced by ``others``."""
    lengths = np.diff(ways)
    for k in range(len(where)):
        lengths[where[k]] = other_ways[k + 1] - other_ways[k]
    new_ways = np.zeros(len(ways), np.int64)
    for b in range(len(lengths)):
        new_ways[b + 1] = new_ways[b] + lengths[b]
    new = np.empty((new_ways[-1], 2), np.int64)
    k = 0
    for b in range(len(lengths)):
        source, first = cells, ways[b]
        if k < len(where) and where[k] == b:
            source, first = others, other_ways[k]
            k += 1
        for c in range(lengths[b]):
            new[new_ways[b] + c, 0], new[new_ways[b] + c, 1] = source[first + c, 0], source[first + c, 1]
    return new, new_ways


@kernel
def permutation(seed: np.uint64, epoch: Int, count: Int) -> Ints:
    """Return 0..count - 1 in the order of an epoch: Fisher and Yates with 64-bit draws of stream ORDER."""
    order = np.arange(count)
    for k in range(count - 1, 0, -1):
        w0, w1, _w2, _w3 = block(seed, np.uint64(k), epoch, ORDER, 0)
        # multiply-high of a 64-bit word, in two halves
        n = np.uint64(k + 1)
        j = (w0 * n + ((w1 * n) >> np.uint64(32))) >> np.uint64(32)
        order[k], order[np.int64(j)] = order[np.int64(j)], order[k]
    return order
