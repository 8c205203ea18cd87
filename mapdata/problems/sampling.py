"""Problems that are sampled anew each epoch.

They are functions of (sampling seed, epoch, index), never of the state of a worker.
"""

from __future__ import annotations

import math

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.jit import Int, kernel
from mapdata.problems.sources import Bands
from mapdata.rng import PROBLEM, block, bounded
from mapdata.search.bitboard import (
    Board,
    bit_at,
    board_of,
    count_bits,
    is_direct,
    nth_cell,
    search_board,
    word_at,
)
from mapdata.search.kernels import (
    Scratch,
    find,
    scratch,
    shortest_costs,
    with_capacity,
    write_cells,
)
from mapdata.search.lattice import (
    ASTAR,
    FAR,
    UNIT,
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


@kernel
def sample_problems(
    grids: Bytes,
    goals: Ints | None,
    seed: np.uint64,
    epoch: Int,
    indices: Ints,
    draws: tuple[Int, Int],
    nearest: float,
    bands: Bands | None,
    rule: Rule,
) -> tuple[Ints, Ints, Ints, Ints]:
    """Sample a problem on each grid: a goal, then one of the starts that are far enough from it.

    docs/format.md, section 6, fixes the draws. Under the other conditions goal and start are drawn
    until their path fits, since to search one path is much faster than to search all starts.

    Args:
        grids: (B, H, W).
        goals: (B, 2) cells; None where they are drawn, too.
        seed: sampling seed.
        epoch: pass over the data.
        indices: (B,) number of each problem.
        draws: first and one past the last draw that is tried on each grid.
        nearest: least distance of a start, at least 1, so that the goal is no start.
        bands: as `Random.bands`; None where ``nearest`` is the only condition, so that numba
            leaves the search out.
        rule: as `rule_of` gives it.

    Returns:
        ends (B, 4): start and goal, -1 where no such problem was found; paths as from
        `solve_pairs`, all empty where the bands need no search of one.
    """
    lattice = lattice_of(grids.shape[1:], rule)
    buffers = scratch(ASTAR, lattice)
    count = len(grids)
    ends = np.full((count, 4), -1)
    offsets = np.zeros(count + 1, np.int64)
    iterations = np.zeros(count, np.int64)
    cells = np.empty((64 * count + 64, 2), np.int64)
    for b in range(count):
        used = offsets[b]
        offsets[b + 1] = used
        board = board_of(grids[b])
        free = count_bits(board.free, 0, len(board.free))
        if free < 2:
            continue
        for draw in range(*draws):
            w0, w1, _, _ = block(seed, np.uint64(indices[b]), epoch, PROBLEM, draw)
            if goals is None:
                goal = nth_cell(board.free, board.stride, bounded(w0, 0, free - 1))
            else:
                goal = (goals[b, 0], goals[b, 1])
                if goal[0] < 0 or grids[b, goal[0], goal[1]]:
                    break
            target = cell_at(goal[0], goal[1], lattice)
            word = word_at(goal[0], goal[1], board.stride)
            bit = bit_at(goal[1])
            if nearest == 1 and board.reached[word] & bit:
                board.reached[word] ^= bit  # connected to the goal before: all but itself
            else:
                _keep_starts(grids[b], goal, target, nearest, lattice, buffers, board)
            starts = count_bits(board.reached, 0, len(board.free))
            if starts:
                # A uniform one: they count in row-major order.
                start = nth_cell(board.reached, board.stride, bounded(w1, 0, starts - 1))
                length = 0
                if bands is not None:
                    length, iterations[b] = _search_within(
                        bands, grids[b], start, goal, target, lattice, buffers, board
                    )
                if length >= 0:
                    ends[b, 0], ends[b, 1] = start
                    ends[b, 2], ends[b, 3] = goal
                    cells = with_capacity(cells, used, length)
                    write_cells(buffers.came, target, lattice, cells[used : used + length])
                    offsets[b + 1] = used + length
                    break
            elif goals is not None:
                break  # there is no other goal
            # No start, or one that does not fit: another goal. This one may be its start.
            board.reached[word] |= bit
    return ends, cells[: offsets[count]], offsets, iterations


@kernel
def _keep_starts(
    grid: Bytes,
    goal: tuple[Int, Int],
    target: Int,
    nearest: float,
    lattice: Lattice,
    buffers: Scratch,
    board: Board,
) -> None:
    """Make ``reached`` the cells whose shortest path to ``goal`` costs at least ``nearest``."""
    row, column = goal
    levels: Int = 5 * sum(grid.shape) // 4
    most: Int = FAR
    # Which cells reach the goal is found by bits, under diagonal moves, too: one that cuts no
    # corner has two free cells beside it, so that straight moves lead there as well.
    if lattice.diagonals < 2 and search_board(row, column, levels, board):
        connected = board.reached.copy()
        all_near = search_board(row, column, math.ceil(min(nearest, levels)), board)
        for k in range(len(connected)):
            board.reached[k] ^= connected[k]
        if all_near or lattice.diagonals == 0 or nearest == 1:
            return
        most = math.ceil(nearest)
    else:
        board.reached.fill(0)
    load(grid, buffers.came)
    shortest_costs(np.full(1, target), most, lattice, buffers)
    buffers.came[target] = 1  # the goal alone has no moves
    for cell in range(lattice.cells):
        if buffers.came[cell]:  # reached, at a known cost
            row, column = position(cell, lattice)
            word = word_at(row, column, board.stride)
            board.reached[word] |= bit_at(column)
            if in_cells(buffers.g[cell]) < nearest:
                board.reached[word] ^= bit_at(column)


@kernel
def _search_within(
    bands: Bands,
    grid: Bytes,
    start: tuple[Int, Int],
    goal: tuple[Int, Int],
    target: Int,
    lattice: Lattice,
    buffers: Scratch,
    board: Board,
) -> tuple[Int, Int]:
    """Search the path of a problem; return its cells and iterations, (-1, 0) if it does not fit."""
    distances, ratios, lengths = bands
    least_cost = heuristic(start[0] - goal[0], start[1] - goal[1], lattice)
    least: float = in_cells(least_cost)
    if least > distances[1] or sum(parts(least_cost)) >= lengths[1]:
        return -1, 0
    # Most starts are too easy, which shows faster without a search.
    if ratios[0] > 1 and board.stride == 1 and is_direct(start, goal, lattice, board.free):
        return -1, 0
    load(grid, buffers.came)
    first = cell_at(start[0], start[1], lattice)
    straight, diagonal, iterations, _ = find(first, target, ASTAR, lattice, buffers)
    length = straight + diagonal + 1
    distance: float = in_cells(straight * UNIT + diagonal * lattice.step)
    fits = (
        distance <= distances[1]
        and ratios[0] <= distance / least <= ratios[1]
        and lengths[0] <= length <= lengths[1]
    )
    return (length, iterations) if fits else (-1, 0)


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
        for attempt in range(pairs):
            i, j = _pair((first + attempt) % pairs, n, route)
            start = cell_at(seed_points[b, i, 0], seed_points[b, i, 1], lattice)
            goal = cell_at(seed_points[b, j, 0], seed_points[b, j, 1], lattice)
            if start == goal:
                continue
            load(grids[b], buffers.came)
            straight, diagonal, iterations[b], _ = find(start, goal, search, lattice, buffers)
            length = straight + diagonal + 1  # no path: -1 + 0 + 1 cells
            if length or unsolvable:
                ends[b, 0], ends[b, 1] = position(start, lattice)
                ends[b, 2], ends[b, 3] = position(goal, lattice)
                cells = with_capacity(cells, used, length)
                write_cells(buffers.came, goal, lattice, cells[used : used + length])
                offsets[b + 1] = used + length
                break
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
