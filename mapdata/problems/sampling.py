"""The kernels that sample random problems anew each epoch.

A problem is a function of (sampling seed, epoch, index), never of the state of a worker.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.generators.maps import WORD
from mapdata.jit import Int, inlined, kernel
from mapdata.problems.sources import OPEN, Bands
from mapdata.rng import PROBLEM, block, bounded
from mapdata.search.bitboard import (
    ALL_BITS,
    Board,
    bit_at,
    build_board,
    count_bits,
    flood_board,
    flood_within,
    has_cell,
    nth_cell,
    word_at,
)
from mapdata.search.ground import (
    EXACT,
    PaddedTerrain,
    cost_in_cells,
    load_terrain,
    terrain_heuristic,
)
from mapdata.search.jump_points import find_free_neighbours, jump_costs
from mapdata.search.kernels import (
    Scratch,
    count_moves,
    search_memory,
    shortest_costs,
)
from mapdata.search.lattice import (
    CORNER_CUTTING,
    INFINITY,
    MAX_PATH_COST,
    NO_CORNER_CUTTING,
    NO_DIAGONALS,
    UNIT,
    Lattice,
    MoveRule,
    cell_at,
    count_path_cells,
    heuristic,
    in_cells,
    load,
    only,
    position,
    split_cost,
)
from mapdata.search.map_stack import MapStack
from mapdata.search.terrain import shortest_terrain_costs, terrain_astar

_LOWEST_BITS_TO_TOP_BYTE = np.uint64(0x0102040810204080)


def sample_problems(
    maps: MapStack,
    goals: Ints | None,
    seed: np.uint64,
    epoch: int,
    indices: Ints,
    attempts: tuple[int, int],
    min_distance: float,
    bands: Bands | None,
    rule: MoveRule,
) -> tuple[Ints, int, int]:
    """Sample a problem on each map: a goal, then one of the starts that fit all conditions.

    docs/format.md, section 6, fixes the draws. One flood around the goal gives the costs of all
    cells, and with them their hardness. On maps without terrain the cost also gives the number of
    cells of a path, so that no path is searched. On terrain, paths of the least cost may differ in
    their number of cells, so A* searches the path of the start that was drawn; if it has too few or
    too many cells, the next attempt draws goal and start anew.

    Args:
        maps: B maps.
        goals: (B, 2) cells; None if goals are drawn, too.
        seed: sampling seed.
        epoch: pass over the data.
        indices: (B,) number of each problem.
        attempts: number of the first attempt on each map, and of the first one that is not made.
        min_distance: smallest cost of a path from start to goal, at least 1, so that the goal is no
            start.
        bands: as `Random.bands`; None if ``min_distance`` is the only condition. If that is 1, too,
            leave out the terrain: no move costs less than 1, so the problems are the same.
        rule: as `move_rule` returns it.

    Returns:
        The start and the goal of each problem (B, 4), -1 if none was found; the first problem whose
        map has a cost that is too high to be exact, and this cost, as kernels return it. They are B
        and 0 if all costs are exact; otherwise the problems from that one on are not sampled.
    """
    size = maps.grids.shape[1:]
    lattice, scratch = search_memory(size, rule)
    map_arrays, cell_costs = maps.ground
    if maps.terrain is not None:
        method = _Method(cell_costs=cell_costs)
    elif bands is None:
        method = _Method(far_distance=min_distance)
    else:
        limits = _level_limits(5 * sum(size) // 4, bands, rule)
        has_diagonals = rule[0] != NO_DIAGONALS
        neighbours = np.zeros(lattice.cells, np.uint8) if has_diagonals else None
        method = _Method(limits=limits, neighbours=neighbours)
    ends = np.full((len(indices), 4), -1)
    row, high_cost = _sample(
        map_arrays,
        goals,
        seed,
        epoch,
        indices,
        attempts,
        ((min_distance, math.inf), OPEN, OPEN) if bands is None else bands,
        *method,
        lattice,
        scratch,
        ends,
    )
    return ends, row, high_cost


class _Method(NamedTuple):
    """How the starts of a goal are found: one of four methods, by what is not None.

    numba leaves out the kernels that would use an argument of None, which take seconds to compile.

    | what is given | kernel | for which problems |
    |---|---|---|
    | far_distance | `_mark_far_starts` | of maps without terrain, with no other condition |
    | limits | `_mark_starts_by_bits` | under 4 neighbours |
    | limits and neighbours | `_mark_starts_by_jumps` | under 8 neighbours |
    | cell_costs | `_mark_terrain_starts` | on terrain |

    Attributes:
        far_distance: the smallest cost of a path.
        limits: from `_level_limits`. Under 8 neighbours all starts meet them, and other cells.
        neighbours: (cells,) zeros, memory for `find_free_neighbours`.
        cell_costs: (cells,) zeros, memory for the costs of terrain.
    """

    far_distance: float | None = None
    limits: Ints | None = None
    neighbours: Bytes | None = None
    cell_costs: Bytes | None = None


@kernel
def _sample(
    maps: Bytes,
    goals: Ints | None,
    seed: np.uint64,
    epoch: Int,
    indices: Ints,
    attempts: tuple[Int, Int],
    bands: Bands,
    far_distance: float | None,
    limits: Ints | None,
    neighbours: Bytes | None,
    cell_costs: Bytes | None,
    lattice: Lattice,
    scratch: Scratch,
    ends: Ints,
) -> tuple[Int, Int]:
    """Do the work of `sample_problems`, whose arguments and results these are.

    ``maps``, (B, H, W), are grids or terrain. `_Method` describes the four arguments that follow
    the bands. Starts and goals are written to ``ends`` (B, 4), where -1 stands already.
    """
    count = len(maps)
    lengths = bands[2]
    has_lengths = lengths[0] > 2 or lengths[1] < np.inf
    for b in range(count):
        if cell_costs is None:
            board = build_board(maps[b])
        else:
            board = build_board(_occupied(maps[b]))
            padded = load_terrain(maps[b], lattice, cell_costs, scratch.came_from)
        if neighbours is not None:
            load(maps[b], scratch.came_from)
            find_free_neighbours(scratch.came_from, lattice, neighbours)
        free_cells = count_bits(board.free, 0, len(board.free))
        if free_cells < 2:
            continue
        if goals is not None:
            goal = (goals[b, 0], goals[b, 1])
            if goal[0] < 0 or not has_cell(board.free, board.stride, goal):
                continue
        for attempt in range(*attempts):
            goal_random, start_random, _, _ = block(
                seed, np.uint64(indices[b]), epoch, PROBLEM, attempt
            )
            if goals is None:
                number = bounded(goal_random, 0, free_cells - 1)
                goal = nth_cell(board.free, board.stride, number)
            # All attempts for a goal that is given have the same starts.
            if goals is None or attempt == attempts[0]:
                high_cost = EXACT
                if far_distance is not None:
                    high_cost = _mark_far_starts(
                        maps[b], goal, far_distance, lattice, scratch, board
                    )
                if limits is not None:
                    if neighbours is None:
                        high_cost = _mark_starts_by_bits(
                            maps[b], goal, bands, limits, lattice, scratch, board
                        )
                    else:
                        high_cost = _mark_starts_by_jumps(
                            maps[b], goal, bands, limits, neighbours, lattice, scratch, board
                        )
                if cell_costs is not None:
                    high_cost = _mark_terrain_starts(goal, bands, padded, lattice, scratch, board)
                if high_cost:
                    return b, high_cost
            start_count = count_bits(board.reached, 0, len(board.free))
            if start_count == 0:
                if goals is not None:
                    break
                continue
            # All starts are equally probable, numbered in row-major order.
            number = bounded(start_random, 0, start_count - 1)
            start = nth_cell(board.reached, board.stride, number)
            if cell_costs is not None and has_lengths:
                load_terrain(maps[b], lattice, cell_costs, scratch.came_from)
                length = _terrain_path_length(start, goal, padded, lattice, scratch)
                if not lengths[0] <= length <= lengths[1]:
                    continue
            ends[b, 0], ends[b, 1] = start
            ends[b, 2], ends[b, 3] = goal
            break
    return count, EXACT


@kernel
def _occupied(terrain: Bytes) -> Bytes:
    """Return the grid, (H, W), that is occupied where ``terrain`` is."""
    grid = np.empty(terrain.shape, np.uint8)
    for row in range(terrain.shape[0]):
        for column in range(terrain.shape[1]):
            grid[row, column] = terrain[row, column] == 0
    return grid


@kernel
def _mark_far_starts(
    grid: Bytes,
    goal: tuple[Int, Int],
    min_distance: float,
    lattice: Lattice,
    scratch: Scratch,
    board: Board,
) -> Int:
    """Make ``board.reached`` the cells whose shortest path to ``goal`` is long enough.

    Args:
        grid: (H, W).
        goal: (row, column).
        min_distance: smallest cost of such a path, in cells.
        lattice: of the map.
        scratch: memory for `shortest_costs`.
        board: of the map.

    Returns:
        EXACT, or TOO_LONG, as `shortest_costs`.
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
            return EXACT
        max_cost = math.ceil(min_distance)
    else:
        board.reached.fill(0)
    load(grid, scratch.came_from)
    goal_cell = cell_at(row, column, lattice)
    high_cost = shortest_costs(only(goal_cell), max_cost, lattice, scratch)
    if high_cost:
        return high_cost
    optimal_moves = scratch.came_from
    optimal_moves[goal_cell] = 1  # The goal has no moves, but its cost is known, as theirs is.
    for cell in range(lattice.cells):
        if optimal_moves[cell]:
            row, column = position(cell, lattice)
            word = word_at(row, column, board.stride)
            board.reached[word] |= bit_at(column)
            if in_cells(scratch.g[cell]) < min_distance:
                board.reached[word] ^= bit_at(column)
    return EXACT


@lru_cache(maxsize=64)
def _level_limits(max_levels: Int, bands: Bands, rule: MoveRule) -> Ints:
    """Return the limits, for `flood_within`, that starts within ``bands`` meet.

    A level of `flood_within` is a number of straight moves. Under 4 neighbours it is the cost of
    its cells, and the distance on an empty map is their heuristic. So the cells that meet the
    limits are the starts.

    A diagonal move takes the place of two straight ones if it cuts no corner. So under 8 neighbours
    the cost of a cell is less than its level by no more than a factor, and so is the heuristic less
    than the distance on an empty map. There the limits are wider: all starts meet them.

    They are cached, because all batches of a dataset have the same.

    Args:
        max_levels: number of levels.
        bands: as `Random.bands`.
        rule: as `move_rule` returns it. With corner cutting the limits are of no use.
    """
    distances, ratios, lengths = bands
    least_cost = 1.0  # of a straight move, if diagonal moves take its place
    least_moves = 1.0
    diagonals, diagonal_cost = rule
    if diagonals != NO_DIAGONALS:
        least_cost = 0.7071 if diagonal_cost > UNIT else 0.5  # sqrt(2) / 2, rounded down
        least_moves = 0.5
    limits = np.zeros((max_levels, 2), np.int64)
    for level in range(1, max_levels):
        limits[level, 0] = 1
        if (
            level < distances[0]
            or least_cost * level > distances[1]
            or level + 1 < lengths[0]
            or least_moves * level + 1 > lengths[1]
        ):
            continue
        # Rounding moves the quotients below by less than 1, and the loops correct that.
        least = max(math.floor(min(least_cost * level / ratios[1], level)) - 1, 1)
        while least <= level and least_cost * level / least > ratios[1]:
            least += 1
        most = level
        if ratios[0] > 1:
            most = min(math.floor(level / (least_cost * ratios[0])) + 1, level)
            while most > 0 and level / (least_cost * most) < ratios[0]:
                most -= 1
        limits[level, 0] = least
        limits[level, 1] = most
    return limits


@inlined
def _mark_starts_by_bits(
    grid: Bytes,
    goal: tuple[Int, Int],
    bands: Bands,
    limits: Ints,
    lattice: Lattice,
    scratch: Scratch,
    board: Board,
) -> Int:
    """Make ``board.reached`` the cells within all bands under 4 neighbours.

    Args:
        grid: (H, W).
        goal: (row, column).
        bands: as `Random.bands`.
        limits: from `_level_limits`.
        lattice: of the map.
        scratch: memory for `shortest_costs`.
        board: of the map.

    Returns:
        EXACT, or TOO_LONG, as `shortest_costs`.
    """
    # Bits are slow in mazes, which have many levels.
    if flood_within(goal[0], goal[1], limits, board):
        return EXACT
    load(grid, scratch.came_from)
    sources = only(cell_at(goal[0], goal[1], lattice))
    high_cost = shortest_costs(sources, _end_of_search(1.0, bands), lattice, scratch)
    if high_cost:
        return high_cost
    _mark_costs_within(grid.shape, goal, bands, lattice, scratch.g, board)
    return EXACT


@inlined
def _mark_starts_by_jumps(
    grid: Bytes,
    goal: tuple[Int, Int],
    bands: Bands,
    wide_limits: Ints,
    neighbours: Bytes,
    lattice: Lattice,
    scratch: Scratch,
    board: Board,
) -> Int:
    """Make ``board.reached`` the cells within all bands under 8 neighbours.

    Args:
        grid: (H, W).
        goal: (row, column).
        bands: as `Random.bands`.
        wide_limits: from `_level_limits`.
        neighbours: (cells,) from `find_free_neighbours`.
        lattice: of the map.
        scratch: memory for `jump_costs`.
        board: of the map.

    Returns:
        EXACT, or TOO_LONG, as `jump_costs`.
    """
    distances, _, lengths = bands
    # Bits may show that there is no start, in less time than the costs take. They seldom do unless
    # starts are far away.
    is_far = distances[0] > 1 or lengths[0] > 2
    if is_far and lattice.diagonals == NO_CORNER_CUTTING:
        is_complete = flood_within(goal[0], goal[1], wide_limits, board)
        if is_complete and count_bits(board.reached, 0, len(board.reached)) == 0:
            return EXACT
    goal_cell = cell_at(goal[0], goal[1], lattice)
    max_cost = _end_of_search(1.5, bands)
    high_cost = jump_costs(goal_cell, max_cost, neighbours, lattice, scratch)
    if high_cost:
        return high_cost
    _mark_costs_within(grid.shape, goal, bands, lattice, scratch.g, board)
    return EXACT


@inlined
def _end_of_search(max_move_cost: float, bands: Bands) -> Int:
    """Return a cost, in cells, from which on no cell is a start, or INFINITY.

    ``max_move_cost`` is at least the cost of a move.
    """
    distances, _, lengths = bands
    end = min(distances[1], (lengths[1] - 1) * max_move_cost)
    if end >= MAX_PATH_COST:
        return INFINITY
    return np.int64(max(math.floor(end) + 1, 0))


@kernel
def _mark_costs_within(
    shape: tuple[Int, Int],
    goal: tuple[Int, Int],
    bands: Bands,
    lattice: Lattice,
    costs: Ints,
    board: Board,
) -> None:
    """Make ``board.reached`` the cells whose ``costs`` to the goal, (cells,), are within all bands.

    The exact test of `_is_within` takes longer than the flood, if it is made for every cell. An
    approximate cost differs from the exact one by less than 1 part in 10^11, and so decides alone
    for all cells but those that are as close to an end of a band.
    """
    distances, ratios, lengths = bands
    slightly_less = 1 - 1e-11
    slightly_more = 1 + 1e-11
    # Here a cost is in 1 / UNIT, as in ``costs``.
    min_cost = UNIT * max(distances[0], 1.0)  # so that the goal is no start
    max_cost = UNIT * min(distances[1], MAX_PATH_COST + 1.0)  # a cell without a path has more
    min_ratio = ratios[0] if ratios[0] > 1 else 0.0  # none is below 1
    has_lengths = lengths[0] > 2 or lengths[1] < np.inf
    # What a diagonal move costs more than a straight one. Without diagonals it is as if it cost 2.
    extra_cost = 1.0 * (UNIT if lattice.diagonals == NO_DIAGONALS else lattice.diagonal_cost - UNIT)
    columns_away = np.empty(shape[1])
    for column in range(shape[1]):
        columns_away[column] = abs(column - goal[1])
    fits = np.zeros(WORD, np.uint8)
    eight_fits = fits.view(np.uint64)
    for row in range(shape[0]):
        rows = row - goal[0]
        rows_away = 1.0 * abs(rows)
        for first_column in range(0, shape[1], WORD):
            first_cell = np.uint64(cell_at(row, first_column, lattice))
            width = min(WORD, shape[1] - first_column)
            is_close = np.uint8(0)
            # Without branches, the compiler handles several cells at once.
            for k in range(width):
                i = np.uint64(k)
                cost = 1.0 * costs[first_cell + i]
                columns = columns_away[np.uint64(first_column) + i]
                bound = max(rows_away, columns) * UNIT + min(rows_away, columns) * extra_cost
                low = max(min_cost, min_ratio * bound)
                high = min(max_cost, ratios[1] * bound)
                is_in = (cost >= low * slightly_less) & (cost <= high * slightly_more)
                is_inside = (cost >= low * slightly_more) & (cost <= high * slightly_less)
                fits[i] = is_in
                is_close |= np.uint8(is_in ^ is_inside)
            word = np.uint64(0)
            for k in range(WORD // 8):
                # The top byte of this product is made of the lowest bits of all eight bytes.
                byte = (eight_fits[np.uint64(k)] * _LOWEST_BITS_TO_TOP_BYTE) >> np.uint64(56)
                word |= byte << np.uint64(8 * k)
            word &= ALL_BITS >> np.uint64(WORD - width)  # older cells may be left behind these
            if is_close or has_lengths:
                for k in range(width):
                    cost = costs[first_cell + np.uint64(k)]
                    columns = first_column + k - goal[1]
                    if word & bit_at(k) and not _is_within(cost, rows, columns, bands, lattice):
                        word ^= bit_at(k)
            board.reached[word_at(row, first_column, board.stride)] = word


@inlined
def _is_within(cost: Int, rows: Int, columns: Int, bands: Bands, lattice: Lattice) -> Int:
    """Return whether a start is within all bands.

    Args:
        cost: from start to goal, in 1 / UNIT.
        rows: how far the goal is away.
        columns: how far the goal is away.
        bands: as `Random.bands`.
        lattice: of the map.
    """
    distances, ratios, lengths = bands
    distance: float = in_cells(cost)
    hardness = distance / in_cells(heuristic(rows, columns, lattice))
    straight, diagonal = split_cost(cost)
    length = count_path_cells(straight, diagonal)
    return (
        distances[0] <= distance <= distances[1]
        and ratios[0] <= hardness <= ratios[1]
        and lengths[0] <= length <= lengths[1]
    )


@kernel
def _mark_terrain_starts(
    goal: tuple[Int, Int],
    bands: Bands,
    padded: PaddedTerrain,
    lattice: Lattice,
    scratch: Scratch,
    board: Board,
) -> Int:
    """Make ``board.reached`` the cells of terrain whose cost and hardness are within the bands.

    Args:
        goal: (row, column).
        bands: as `Random.bands`, of which that of length is not considered.
        padded: the terrain.
        lattice: of the map.
        scratch: memory for `shortest_terrain_costs`.
        board: of the map.

    Returns:
        0, or the least cost of a cell that is too high to be exact.
    """
    goal_cell = cell_at(goal[0], goal[1], lattice)
    high_cost = shortest_terrain_costs(only(goal_cell), padded, lattice, scratch)
    if high_cost:
        return high_cost
    distances, ratios, _ = bands
    min_distance = max(distances[0], 1.0)  # so that the goal is no start
    has_ratios = ratios[0] > 1 or ratios[1] < np.inf
    board.reached.fill(0)
    for cell in range(lattice.cells):
        cost = cost_in_cells(scratch.g[cell], padded.straight_unit)
        if cost < min_distance or cost > distances[1]:
            continue
        row, column = position(cell, lattice)
        if has_ratios:
            lower_bound = cost_in_cells(
                terrain_heuristic(row - goal[0], column - goal[1], padded, lattice),
                padded.straight_unit,
            )
            if not ratios[0] <= cost / lower_bound <= ratios[1]:
                continue
        board.reached[word_at(row, column, board.stride)] |= bit_at(column)
    return np.int64(0)


@kernel
def _terrain_path_length(
    start: tuple[Int, Int],
    goal: tuple[Int, Int],
    padded: PaddedTerrain,
    lattice: Lattice,
    scratch: Scratch,
) -> Int:
    """Return the number of cells of the path by A* between two connected cells.

    The map must be loaded in ``scratch.came_from``.
    """
    start_cell = cell_at(start[0], start[1], lattice)
    goal_cell = cell_at(goal[0], goal[1], lattice)
    # All costs are exact, as the search around the goal has shown, so that A* finds no high cost.
    terrain_astar(start_cell, goal_cell, padded, lattice, scratch)
    straight, diagonal = count_moves(scratch.came_from, start_cell, goal_cell, lattice)
    return count_path_cells(straight, diagonal)
