"""Problems that are sampled anew each epoch.

They are functions of (sampling seed, epoch, index), never of the state of a worker.
"""

from __future__ import annotations

import math

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.jit import Int, inlined, kernel
from mapdata.problems.sources import Bands, Random
from mapdata.rng import PROBLEM, block, bounded
from mapdata.search.bitboard import (
    Board,
    bit_at,
    board_of,
    count_bits,
    nth_cell,
    search_around,
    search_board,
    word_at,
)
from mapdata.search.kernels import Scratch, find, scratch, wipe, with_capacity, write_cells
from mapdata.search.lattice import (
    ASTAR,
    BFS,
    Lattice,
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
    diagonals: Int,
    step: Int,
) -> Ints:
    """Sample a problem on each grid: a goal, then one of the starts that fit it.

    docs/format.md, section 6, fixes the draws. The goal comes first so that one search around it
    tells which starts there are.

    Args:
        grids: (B, H, W).
        seed: sampling seed.
        epoch: pass over the data.
        indices: (B,) number of each problem.
        bands: as `Random.bands`; a tuple, which numba keeps in registers.
        diagonals: as `rule_of` gives it.
        step: likewise.

    Returns:
        (B, 4): start and goal, -1 where the map has no such problem.
    """
    lattice = lattice_of(grids.shape[1:], (diagonals, step))
    buffers = scratch(ASTAR, lattice)
    sampled = np.full((len(grids), 4), -1)
    for b in range(len(grids)):
        board = board_of(grids[b])
        free = count_bits(board.free, 0, len(board.free))
        if free < 2:
            continue
        for attempt in range(_ATTEMPTS):
            w0, w1, _, _ = block(seed, np.uint64(indices[b]), epoch, PROBLEM, attempt)
            goal = nth_cell(board.free, board.stride, bounded(w0, 0, free - 1))
            # A uniform start among those that fit: they count in row-major order.
            _keep_fitting(grids[b], goal, bands, lattice, buffers, board)
            fitting = count_bits(board.reached, 0, len(board.free))
            if fitting:
                number = bounded(w1, 0, fitting - 1)
                sampled[b, 0], sampled[b, 1] = nth_cell(board.reached, board.stride, number)
                sampled[b, 2], sampled[b, 3] = goal
                break
            # Nothing fits this goal: another one.
    return sampled


@kernel
def _keep_fitting(
    grid: Bytes,
    goal: tuple[Int, Int],
    bands: Bands,
    lattice: Lattice,
    buffers: Scratch,
    board: Board,
) -> None:
    """Make ``reached`` the cells from which a problem to ``goal`` meets the conditions."""
    row, column = goal
    distances, ratios, lengths = bands
    nearest = max(distances[0], lengths[0] - 1, 1.0)  # from 1 on: not the goal itself
    farthest = min(distances[1], lengths[1] - 1)
    # Straight moves alone are found by bits, level by level. They tell which cells reach the goal
    # under diagonal moves, too, since one between two free cells leads nowhere else.
    straight = lattice.diagonals == 0 and ratios == _OPEN[1]
    if straight or (lattice.diagonals < 2 and bands == _OPEN):
        levels = min(farthest + 1, float(sum(grid.shape)))
        if search_board(row, column, int(levels), board) or levels > farthest:
            near_enough = board.reached.copy()
            search_board(row, column, math.ceil(min(nearest, levels)), board)
            for k in range(len(near_enough)):
                board.reached[k] = near_enough[k] & ~board.reached[k]
            return
    search_around(grid, row, column, True, lattice, buffers)
    board.reached.fill(0)
    for k in range(grid.shape[0]):
        for j in range(grid.shape[1]):
            cell = cell_at(k, j, lattice)
            # The goal has no moves, nor has a cell that it cannot be reached from.
            if buffers.came[cell]:
                least = heuristic(k - row, j - column, lattice)
                if _is_within(bands, buffers.g[cell], least):
                    board.reached[word_at(k, j, board.stride)] |= bit_at(j)


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
                cells = with_capacity(cells, used, length)
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
