"""Problems that are sampled anew each epoch.

They are functions of (sampling seed, epoch, index), never of the state of a worker.
"""

from __future__ import annotations

import math

import numpy as np

from mapdata.arrays import Bytes, Ints, Words
from mapdata.jit import Int, kernel
from mapdata.problems.sources import Bands
from mapdata.rng import PROBLEM, block, bounded
from mapdata.search.bitboard import (
    Board,
    bit_at,
    board_of,
    count_bits,
    nth_cell,
    search_board,
    word_at,
)
from mapdata.search.kernels import (
    Scratch,
    find,
    scratch,
    shortest_costs,
    wipe,
    with_capacity,
    write_cells,
)
from mapdata.search.lattice import (
    ASTAR,
    BFS,
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
    position,
)

_OPEN = (0.0, math.inf)
"""The limits of a band that leaves both sides open."""

_ATTEMPTS = 32
"""Problems tried on one map before it is given up."""


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
    """Sample a problem on each grid: a goal, then one of the starts that are far enough from it.

    docs/format.md, section 6, fixes the draws. Starts are tried one by one under the other
    conditions, since a search of one path is much faster than one of all.

    Args:
        grids: (B, H, W).
        seed: sampling seed.
        epoch: pass over the data.
        indices: (B,) number of each problem.
        bands: as `Random.bands`; a tuple, which numba keeps in registers.
        diagonals: as `rule_of` gives it.
        step: likewise.

    Returns:
        (B, 4): start and goal, -1 where no such problem was found.
    """
    lattice = lattice_of(grids.shape[1:], (diagonals, step))
    buffers = scratch(ASTAR, lattice)
    distances, ratios, lengths = bands
    nearest = max(distances[0], 1.0)  # from 1 on: not the goal itself
    any_start = distances[1] == math.inf and ratios == _OPEN and lengths == _OPEN
    sampled = np.full((len(grids), 4), -1)
    for b in range(len(grids)):
        board = board_of(grids[b])
        free = count_bits(board.free, 0, len(board.free))
        if free < 2:
            continue
        for attempt in range(_ATTEMPTS):
            w0, w1, _, _ = block(seed, np.uint64(indices[b]), epoch, PROBLEM, attempt)
            goal = nth_cell(board.free, board.stride, bounded(w0, 0, free - 1))
            word = word_at(goal[0], goal[1], board.stride)
            bit = bit_at(goal[1])
            if nearest == 1 and board.reached[word] & bit:
                board.reached[word] ^= bit  # its starts are those of the goal before, and that one
            else:
                _keep_starts(grids[b], goal, nearest, lattice, buffers, board)
            starts = count_bits(board.reached, 0, len(board.free))
            if starts:
                # A uniform one: they count in row-major order.
                start = nth_cell(board.reached, board.stride, bounded(w1, 0, starts - 1))
                if any_start or _is_within(bands, grids[b], start, goal, lattice, buffers, board):
                    sampled[b, 0], sampled[b, 1] = start
                    sampled[b, 2], sampled[b, 3] = goal
                    break
            board.reached[word] |= bit
            # No start, or one that does not fit: another goal.
    return sampled


@kernel
def _keep_starts(
    grid: Bytes,
    goal: tuple[Int, Int],
    nearest: float,
    lattice: Lattice,
    buffers: Scratch,
    board: Board,
) -> None:
    """Make ``reached`` the cells whose shortest path to ``goal`` costs at least ``nearest``."""
    row, column = goal
    levels: Int = 5 * sum(grid.shape) // 4
    most: Int = FAR
    # Which cells reach the goal is found by bits, under diagonal moves, too, since one between two
    # free cells leads nowhere else.
    if lattice.diagonals < 2 and search_board(row, column, levels, board):
        connected = board.reached.copy()
        all_near = search_board(row, column, math.ceil(min(nearest, levels)), board)
        for k in range(len(connected)):
            board.reached[k] ^= connected[k]
        if all_near or lattice.diagonals == 0 or nearest == 1:
            return
        most = math.ceil(min(nearest, float(FAR)))
    else:
        board.reached.fill(0)
    load(grid, buffers.came)
    source = np.empty(1, np.int64)
    source[0] = cell_at(row, column, lattice)
    shortest_costs(source, most, lattice, buffers)
    buffers.came[source[0]] = 1  # the goal alone has no moves
    for k in range(grid.shape[0]):
        for j in range(grid.shape[1]):
            cell = cell_at(k, j, lattice)
            if buffers.came[cell]:  # reached, at a known cost
                word = word_at(k, j, board.stride)
                board.reached[word] |= bit_at(j)
                if in_cells(buffers.g[cell]) < nearest:
                    board.reached[word] ^= bit_at(j)


@kernel
def _is_within(
    bands: Bands,
    grid: Bytes,
    start: tuple[Int, Int],
    goal: tuple[Int, Int],
    lattice: Lattice,
    buffers: Scratch,
    board: Board,
) -> bool:
    """Return whether the problem from ``start`` to ``goal`` meets the conditions."""
    distances, ratios, lengths = bands
    least: float = in_cells(heuristic(start[0] - goal[0], start[1] - goal[1], lattice))
    if least > distances[1]:
        return False
    # Most starts are too easy, which shows faster without a search.
    if ratios[0] > 1 and board.stride == 1 and _is_direct(start, goal, lattice, board.free):
        return False
    load(grid, buffers.came)
    first = cell_at(start[0], start[1], lattice)
    last = cell_at(goal[0], goal[1], lattice)
    straight, diagonal, _, _ = find(first, last, ASTAR, lattice, buffers)
    distance: float = in_cells(straight * UNIT + diagonal * lattice.step)
    return (
        distance <= distances[1]
        and ratios[0] <= distance / least <= ratios[1]
        and lengths[0] <= straight + diagonal + 1 <= lengths[1]
    )


@kernel
def _is_direct(start: tuple[Int, Int], goal: tuple[Int, Int], lattice: Lattice, free: Words) -> Int:
    """Return whether a path that is as long as on an empty map is found, where a row is one word.

    All such paths are followed at once, row by row from the western end. Of diagonal moves only
    those are tried that cut no corner, and as few as the heuristic counts.
    """
    if start[1] > goal[1]:
        start, goal = goal, start
    rows = goal[0] - start[0]
    is_steep = lattice.diagonals and abs(rows) > goal[1] - start[1]
    word = word_at(start[0], 0, 1)
    last = word_at(goal[0], 0, 1)
    here = bit_at(start[1])
    while True:
        row = free[word]
        if not is_steep:
            here |= row & ~(row + here)  # and eastward: a sum carries through free cells
        if word == last:
            return (here & bit_at(goal[1])) != 0
        word += np.sign(rows)
        here &= free[word]
        if lattice.diagonals:
            aslant = (here << np.uint64(1)) & row & free[word]
            here = aslant | here if is_steep else aslant


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
