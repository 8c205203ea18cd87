"""Problems that are sampled anew each epoch.

They are functions of (sampling seed, epoch, index), never of the state of a worker.
"""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.jit import Int, inlined, kernel
from mapdata.problems.sources import Bands, Random
from mapdata.rng import PROBLEM, block, bounded
from mapdata.search.goals import (
    Around,
    GoalFields,
    around,
    count_to_goal,
    search_around,
    write_fields,
)
from mapdata.search.kernels import find, scratch, wipe, write_cells
from mapdata.search.lattice import (
    ASTAR,
    BFS,
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

_OPEN = Random().bands
"""No conditions."""

_ATTEMPTS = 32
"""Goals tried on one map before it is given up."""


@kernel
def sample_problems(
    grids: Bytes,
    seed: np.uint64,
    epoch: Int,
    indices: Ints,
    bands: Bands,
    rule: Rule,
    fields: GoalFields,
) -> Ints:
    """Sample a problem on each grid: a goal, then one of the starts that fit it.

    docs/format.md, section 6, fixes the draws. The goal comes first so that the search around it,
    which tells the starts, is the one that gives its fields.

    Args:
        grids: (B, H, W).
        seed: sampling seed.
        epoch: pass over the data.
        indices: (B,) number of each problem.
        bands: as `Random.bands`; a tuple, which numba keeps in registers.
        rule: as `rule_of` gives it.
        fields: those of them that are not empty are filled where a problem is found.

    Returns:
        (B, 6): start, goal, straight and diagonal steps of a shortest path (all count as straight
        where they cost the same); -1 where the map has no such problem.
    """
    found = around(grids.shape[1:], rule)
    weighed = bands != _OPEN or len(fields.cost_to_go) + len(fields.heuristic_ratio) > 0
    unfit = np.empty(grids.shape[1:], np.uint8)
    sampled = np.full((len(grids), 6), -1)
    for b in range(len(grids)):
        free = _count_free(grids[b])
        if free < 2:
            continue
        for attempt in range(_ATTEMPTS):
            w0, w1, _, _ = block(seed, np.uint64(indices[b]), epoch, PROBLEM, attempt)
            goal_row, goal_column = _free_cell(grids[b], bounded(w0, 0, free - 1))
            search_around(grids[b], goal_row, goal_column, weighed, found)
            # A uniform start among those that fit: they count in row-major order.
            _mark_unfit(bands, goal_row, goal_column, found, unfit)
            fitting = _count_free(unfit)
            if fitting:
                start_row, start_column = _free_cell(unfit, bounded(w1, 0, fitting - 1))
                start = cell_at(start_row, start_column, found.lattice)
                sampled[b, 0] = start_row
                sampled[b, 1] = start_column
                sampled[b, 2] = goal_row
                sampled[b, 3] = goal_column
                sampled[b, 4], sampled[b, 5] = count_to_goal(start, found)
                write_fields(b, sampled[b, :2], sampled[b, 2:4], found, fields)
                break
            # Nothing fits this goal: another one.
    return sampled


@kernel
def _count_free(grid: Bytes) -> Int:
    """Return how many cells of a grid are free."""
    count: Int = 0
    for row in range(grid.shape[0]):
        for column in range(grid.shape[1]):
            if grid[row, column] == 0:
                count += 1
    return count


@kernel
def _free_cell(grid: Bytes, number: Int) -> tuple[Int, Int]:
    """Return the ``number``-th free cell of a grid in row-major order."""
    left = number
    for row in range(grid.shape[0]):
        # Row by row first, which is fast: a count has no branches.
        free = _count_free(grid[row : row + 1])
        if left >= free:
            left -= free
            continue
        for column in range(grid.shape[1]):
            if grid[row, column] == 0:
                if left == 0:
                    return row, column
                left -= 1
    return -1, -1


@kernel
def _mark_unfit(bands: Bands, goal_row: Int, goal_column: Int, found: Around, unfit: Bytes) -> None:
    """Write 0 where a problem from there to the goal meets the conditions, else 1."""
    costs = found.costs
    moves = found.moves
    lattice = found.lattice
    for row in range(unfit.shape[0]):
        for column in range(unfit.shape[1]):
            cell = np.uint64(cell_at(row, column, lattice))
            # The goal has no moves, nor has a cell that it cannot be reached from.
            fits = moves[cell] != 0
            if bands != _OPEN and fits:
                least = heuristic(row - goal_row, column - goal_column, lattice)
                fits = _is_within(bands, costs[cell], least)
            unfit[row, column] = not fits


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
