"""The kernels that sample problems anew each epoch.

A problem is a function of (sampling seed, epoch, index), never of the state of a worker.
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
    build_board,
    count_bits,
    flood_board,
    has_direct_path,
    nth_cell,
    word_at,
)
from mapdata.search.kernels import (
    Scratch,
    new_scratch,
    shortest_costs,
    solve_loaded,
    with_capacity,
    write_cells,
)
from mapdata.search.lattice import (
    ASTAR,
    CORNER_CUTTING,
    INFINITY,
    NO_DIAGONALS,
    UNIT,
    CostWeights,
    Lattice,
    MoveRule,
    cell_at,
    count_path_cells,
    heuristic,
    in_cells,
    lattice_of,
    load,
    position,
    split_cost,
)


@kernel
def sample_problems(
    grids: Bytes,
    goals: Ints | None,
    seed: np.uint64,
    epoch: Int,
    indices: Ints,
    draws: tuple[Int, Int],
    min_distance: float,
    bands: Bands | None,
    rule: MoveRule,
) -> tuple[Ints, Ints, Ints, Ints]:
    """Sample a problem on each grid: a goal, then one of the starts that are far enough from it.

    docs/format.md, section 6, fixes the draws. If there are further conditions, goal and start are
    drawn until their path fulfils them, since searching one path is much faster than searching the
    paths of all starts.

    Args:
        grids: (B, H, W).
        goals: (B, 2) cells; None if goals are drawn, too.
        seed: sampling seed.
        epoch: pass over the data.
        indices: (B,) number of each problem.
        draws: number of the first draw that is tried on each grid, and of the first one that is
            not.
        min_distance: smallest cost of a path from start to goal, at least 1, so that the goal is no
            start.
        bands: as `Random.bands`; None if ``min_distance`` is the only condition. Then numba
            compiles no search for a path.
        rule: as `move_rule` returns it.

    Returns:
        The start and the goal of each problem (B, 4), -1 if none was found; then the paths and
        their expansions as from `solve_pairs`, all empty if ``bands`` is None.
    """
    lattice = lattice_of(grids.shape[1:], rule)
    scratch = new_scratch(ASTAR, lattice)
    count = len(grids)
    ends = np.full((count, 4), -1)
    offsets = np.zeros(count + 1, np.int64)
    expansions = np.zeros(count, np.int64)
    cells = np.empty((64 * count + 64, 2), np.int64)
    for b in range(count):
        used = offsets[b]
        offsets[b + 1] = used
        board = build_board(grids[b])
        free_cells = count_bits(board.free, 0, len(board.free))
        if free_cells < 2:
            continue
        for draw in range(*draws):
            goal_random, start_random, _, _ = block(
                seed, np.uint64(indices[b]), epoch, PROBLEM, draw
            )
            if goals is None:
                number = bounded(goal_random, 0, free_cells - 1)
                goal = nth_cell(board.free, board.stride, number)
            else:
                goal = (goals[b, 0], goals[b, 1])
                if goal[0] < 0 or grids[b, goal[0], goal[1]]:
                    break
            goal_cell = cell_at(goal[0], goal[1], lattice)
            goal_word = word_at(goal[0], goal[1], board.stride)
            goal_bit = bit_at(goal[1])
            if min_distance == 1 and board.reached[goal_word] & goal_bit:
                # An earlier draw has found the cells that are connected to this goal. All but the
                # goal itself are starts.
                board.reached[goal_word] ^= goal_bit
            else:
                _reach_starts(grids[b], goal, goal_cell, min_distance, lattice, scratch, board)
            start_count = count_bits(board.reached, 0, len(board.free))
            if start_count:
                # All starts are equally probable, numbered in row-major order.
                number = bounded(start_random, 0, start_count - 1)
                start = nth_cell(board.reached, board.stride, number)
                length = 0
                if bands is not None:
                    length, expansions[b] = _search_within(
                        bands, grids[b], start, goal, goal_cell, lattice, scratch, board
                    )
                if length >= 0:
                    ends[b, 0], ends[b, 1] = start
                    ends[b, 2], ends[b, 3] = goal
                    cells = with_capacity(cells, used, length)
                    write_cells(scratch.came_from, goal_cell, lattice, cells[used : used + length])
                    offsets[b + 1] = used + length
                    break
            elif goals is not None:
                break  # The only goal has no start.
            # There was no start, or one whose path does not fit. The next draw has another goal, of
            # which this goal may be the start.
            board.reached[goal_word] |= goal_bit
    return ends, cells[: offsets[count]], offsets, expansions


@kernel
def _reach_starts(
    grid: Bytes,
    goal: tuple[Int, Int],
    goal_cell: Int,
    min_distance: float,
    lattice: Lattice,
    scratch: Scratch,
    board: Board,
) -> None:
    """Make ``board.reached`` the cells whose shortest path to ``goal`` is long enough.

    Args:
        grid: (H, W).
        goal: (row, column).
        goal_cell: the same as a padded cell.
        min_distance: smallest cost of such a path, in cells.
        lattice: of the map.
        scratch: memory for `shortest_costs`.
        board: of the map.
    """
    row, column = goal
    max_levels: Int = 5 * sum(grid.shape) // 4
    max_cost: Int = INFINITY
    # Bits show which cells can reach the goal, under diagonal moves, too: a diagonal move that cuts
    # no corner has two free cells beside it, so that straight moves lead to the same cell.
    if lattice.diagonals != CORNER_CUTTING and flood_board(row, column, max_levels, board):
        connected = board.reached.copy()
        near_levels = math.ceil(min(min_distance, max_levels))
        all_are_near = flood_board(row, column, near_levels, board)
        for k in range(len(connected)):
            board.reached[k] ^= connected[k]
        # A path with diagonal moves may cost less than its level. So cells that are far enough by
        # their level need not be by their cost; but there may be no such cells.
        if all_are_near or lattice.diagonals == NO_DIAGONALS or min_distance == 1:
            return
        max_cost = math.ceil(min_distance)
    else:
        board.reached.fill(0)
    load(grid, scratch.came_from)
    shortest_costs(np.full(1, goal_cell), max_cost, lattice, scratch)
    optimal_moves = scratch.came_from
    optimal_moves[goal_cell] = 1  # The goal has no moves, but its cost is known, as theirs is.
    for cell in range(lattice.cells):
        if optimal_moves[cell]:
            row, column = position(cell, lattice)
            word = word_at(row, column, board.stride)
            board.reached[word] |= bit_at(column)
            if in_cells(scratch.g[cell]) < min_distance:
                board.reached[word] ^= bit_at(column)


@kernel
def _search_within(
    bands: Bands,
    grid: Bytes,
    start: tuple[Int, Int],
    goal: tuple[Int, Int],
    goal_cell: Int,
    lattice: Lattice,
    scratch: Scratch,
    board: Board,
) -> tuple[Int, Int]:
    """Search the path of a problem, unless it is clear without a search that it does not fit.

    Args:
        bands: the limits of cost, of hardness and of the number of cells, both included.
        grid: (H, W).
        start: (row, column), a cell from which a path leads to the goal.
        goal: (row, column).
        goal_cell: the same as a padded cell.
        lattice: of the map.
        scratch: memory of the search.
        board: of the map.

    Returns:
        The number of cells of the path, and the expansions; (-1, 0) if it is outside of a band.
    """
    distances, ratios, lengths = bands
    lower_bound = heuristic(start[0] - goal[0], start[1] - goal[1], lattice)
    min_cost: float = in_cells(lower_bound)
    min_moves = sum(split_cost(lower_bound))
    if min_cost > distances[1] or min_moves >= lengths[1]:
        return -1, 0
    # Most starts are too easy, which is faster to see without a search.
    is_narrow = board.stride == 1
    if ratios[0] > 1 and is_narrow and has_direct_path(start, goal, lattice, board.free):
        return -1, 0
    load(grid, scratch.came_from)
    start_cell = cell_at(start[0], start[1], lattice)
    straight, diagonal, expansions, _ = solve_loaded(start_cell, goal_cell, ASTAR, lattice, scratch)
    length = count_path_cells(straight, diagonal)
    cost: float = in_cells(straight * UNIT + diagonal * lattice.diagonal_cost)
    fits = (
        cost <= distances[1]
        and ratios[0] <= cost / min_cost <= ratios[1]
        and lengths[0] <= length <= lengths[1]
    )
    return (length, expansions) if fits else (-1, 0)


@kernel
def solve_pairs(
    grids: Bytes,
    seed_points: Ints,
    rooms: Ints,
    seed: np.uint64,
    epoch: Int,
    indices: Ints,
    only_route: Int,
    keep_unsolvable: Int,
    weights: CostWeights,
    rule: MoveRule,
) -> tuple[Ints, Ints, Ints, Ints]:
    """Sample a pair of seed points on each grid and search its path.

    If a pair has no path, the next one is tried, until all pairs of the map have been tried.

    Args:
        grids: (B, H, W).
        seed_points: (B, R, 2) cells.
        rooms: (B,) number of seed points.
        seed: sampling seed.
        epoch: pass over the data.
        indices: (B,) number of each problem.
        only_route: whether the pairs are those of the route, (q, q + 1), instead of all i < j.
        keep_unsolvable: whether pairs without a path are kept.
        weights: BFS or ASTAR.
        rule: as `move_rule` returns it.

    Returns:
        The start and the goal of each problem (B, 4), -1 if no pair fits; the cells (M, 2) of the
        paths and their offsets (B + 1,) in there; the expansions (B,).
    """
    count = len(grids)
    lattice = lattice_of(grids.shape[1:], rule)
    scratch = new_scratch(weights, lattice)
    ends = np.full((count, 4), -1)
    offsets = np.zeros(count + 1, np.int64)
    expansions = np.zeros(count, np.int64)
    cells = np.empty((64 * count + 64, 2), np.int64)
    for b in range(count):
        n = rooms[b]
        used = offsets[b]
        offsets[b + 1] = used
        pairs = n - 1 if only_route else n * (n - 1) // 2
        random, _, _, _ = block(seed, np.uint64(indices[b]), epoch, PROBLEM, 0)
        first_pair = bounded(random, 0, pairs - 1)
        for attempt in range(pairs):
            i, j = pair_of_number((first_pair + attempt) % pairs, n, only_route)
            start = cell_at(seed_points[b, i, 0], seed_points[b, i, 1], lattice)
            goal = cell_at(seed_points[b, j, 0], seed_points[b, j, 1], lattice)
            if start == goal:
                continue
            load(grids[b], scratch.came_from)
            straight, diagonal, expansions[b], _ = solve_loaded(
                start, goal, weights, lattice, scratch
            )
            length = count_path_cells(straight, diagonal)
            if length or keep_unsolvable:
                ends[b, 0], ends[b, 1] = position(start, lattice)
                ends[b, 2], ends[b, 3] = position(goal, lattice)
                cells = with_capacity(cells, used, length)
                write_cells(scratch.came_from, goal, lattice, cells[used : used + length])
                offsets[b + 1] = used + length
                break
    return ends, cells[: offsets[count]], offsets, expansions


@kernel
def pair_of_number(number: Int, points: Int, only_route: Int) -> tuple[Int, Int]:
    """Return the seed points (i, j) of pair ``number`` of a map with so many points.

    The pairs are those of the route, or all i < j in row-major order.
    """
    if only_route:
        return number, number + 1
    i = 0
    number_in_row = number
    pairs_in_row = points - 1  # row i has the pairs with j from i + 1 to points - 1
    while number_in_row >= pairs_in_row:
        number_in_row -= pairs_in_row
        pairs_in_row -= 1
        i += 1
    return i, i + 1 + number_in_row
