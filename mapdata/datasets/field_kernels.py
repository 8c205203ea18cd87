"""The kernels of `mapdata.datasets.fields`: each fills one or more fields for a whole batch.

`count_shortest_paths` counts what the fields of all shortest paths hold.

Kernels that search return, last, the number of the first map with a cost that is too high to be
exact, and this doubled cost; both are the number of maps and 0 if all costs are exact. With a high
cost, what has been filled is to be thrown away.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Float32s, Floats, Ints, UInt32s
from mapdata.jit import Int, inlined, kernel
from mapdata.movement import STEPS
from mapdata.search.bitboard import write_optimal_moves
from mapdata.search.ground import (
    EXACT,
    PaddedTerrain,
    cost_in_cells,
    heuristic_on,
    load_map,
    load_terrain,
    unit_of,
)
from mapdata.search.jump_points import find_free_neighbours, jump_costs
from mapdata.search.kernels import Scratch
from mapdata.search.lattice import (
    CORNER_CUTTING,
    INFINITY,
    UNIT,
    WALL,
    Lattice,
    cell_at,
    cells_of,
    is_legal,
    load,
    only,
    position,
)
from mapdata.search.solving import shortest_costs_on
from mapdata.search.terrain import shortest_terrain_costs

PADDING = -1
"""Fills the rows of ``path`` behind the cells of a path."""

PROBABLE = 0.95
"""TransPath's threshold of the path probability."""

NO_ROOM = -2

_ONE = np.uint64(1)

MANY_PATHS = 10
"""`count_shortest_paths` stops counting here. An open room has more paths than fit int64."""


class GoalFields(NamedTuple):
    """The fields that one search around the goal gives; those that nobody asked for are empty.

    Attributes:
        cost_to_go: (B, 1, H, W) float32, cost to the goal in cells.
        optimal_moves: (B, 1, H, W) uint8, bit sets of the moves that begin a shortest path.
        heuristic_ratio: (B, 1, H, W) float32, the heuristic divided by the cost.
        optimal_mask: (B, 1, H, W) uint8, 1 on the cells of all shortest paths.
    """

    cost_to_go: Float32s
    optimal_moves: Bytes
    heuristic_ratio: Float32s
    optimal_mask: Bytes


@kernel
def pad_paths(cells: Ints, offsets: Ints, padded: Ints) -> None:
    """Write paths, one after another in ``cells``, to rows of equal length.

    Args:
        cells: (M, 2) cells.
        offsets: (B + 1,) where each path begins in there.
        padded: (B, L, 2), to be filled with the first L cells of each path, then with PADDING.
    """
    for b in range(len(padded)):
        first = offsets[b]
        length = offsets[b + 1] - first
        for k in range(padded.shape[1]):
            padded[b, k, 0] = cells[first + k, 0] if k < length else PADDING
            padded[b, k, 1] = cells[first + k, 1] if k < length else PADDING


@kernel
def mask_paths(cells: Ints, offsets: Ints, rows: Int, columns: Int) -> Bytes:
    """Return (B, rows, columns) uint8, 1 on the cells of each path.

    ``cells`` (M, 2) and ``offsets`` (B + 1,) are the paths, as in `pad_paths`.
    """
    mask = np.zeros((len(offsets) - 1, rows, columns), np.uint8)
    for b in range(len(mask)):
        for k in range(offsets[b], offsets[b + 1]):
            mask[b, cells[k, 0], cells[k, 1]] = 1
    return mask


@kernel
def _search_around(
    goal: tuple[Int, Int],
    map_: Bytes,
    needs_costs: bool,
    cell_costs: Bytes | None,
    lattice: Lattice,
    scratch: Scratch,
) -> tuple[PaddedTerrain | None, Int]:
    """Find which moves of a map (H, W) begin shortest paths to ``goal`` (row, col), and the costs.

    On grids the costs may be left out, as `write_optimal_moves` explains. Returns the ground; and
    EXACT, or as `shortest_costs_on` what is too high to be exact.
    """
    if cell_costs is None:
        return None, write_optimal_moves(map_, goal[0], goal[1], needs_costs, lattice, scratch)
    ground = load_terrain(map_, lattice, cell_costs, scratch.came_from)
    source = only(cell_at(goal[0], goal[1], lattice))
    return ground, shortest_terrain_costs(source, ground, lattice, scratch)


@kernel
def fill_goal_fields(
    maps: Bytes,
    cell_costs: Bytes | None,
    starts: Ints,
    goals: Ints,
    lattice: Lattice,
    scratch: Scratch,
    fields: GoalFields,
) -> tuple[Int, Int]:
    """Fill those of the fields that are not empty, by one search from the goal of each problem.

    On grids with diagonal moves, `fill_goal_fields_by_jumps` does the same in half the time.

    Args:
        maps: (B, H, W) grids or terrain.
        cell_costs: as from `as_ground`.
        starts: (B, 2) cells.
        goals: (B, 2) cells.
        lattice: of the maps.
        scratch: memory of the searches.
        fields: to be filled.
    """
    cost_to_go, optimal_moves, heuristic_ratio, optimal_mask = fields
    count, rows, columns = maps.shape
    moves = scratch.came_from
    needs_costs = len(cost_to_go) + len(heuristic_ratio) > 0
    for b in range(count):
        goal = (goals[b, 0], goals[b, 1])
        ground, high_cost = _search_around(goal, maps[b], needs_costs, cell_costs, lattice, scratch)
        if high_cost:
            return b, high_cost
        if len(optimal_moves):
            for row in range(rows):
                first = np.uint64(cell_at(row, 0, lattice))
                for column in range(columns):
                    optimal_moves[b, 0, row, column] = moves[first + np.uint64(column)]
        if needs_costs:
            _write_goal_costs(b, goal, ground, lattice, scratch, cost_to_go, heuristic_ratio)
        if len(optimal_mask):
            optimal_mask[b] = 0
            start = cell_at(starts[b, 0], starts[b, 1], lattice)
            if moves[start] or start == cell_at(goal[0], goal[1], lattice):
                _mark_optimal_cells(start, moves, lattice, scratch.pushed, optimal_mask[b, 0])
    return count, EXACT


@kernel
def fill_goal_fields_by_jumps(
    maps: Bytes,
    starts: Ints,
    goals: Ints,
    lattice: Lattice,
    scratch: Scratch,
    fields: GoalFields,
) -> tuple[Int, Int]:
    """Do what `fill_goal_fields` does, on grids with diagonal moves.

    `jump_costs` finds the costs of all cells in a fraction of the time in which the search of
    `fill_goal_fields` finds their costs and moves. The moves then follow from the costs: a move
    begins a shortest path if the costs of its two cells differ by what it costs. Costs are exact,
    so this is a comparison for equality.
    """
    cost_to_go, optimal_moves, heuristic_ratio, optimal_mask = fields
    neighbours = np.zeros(lattice.cells, np.uint8)
    for b in range(len(maps)):
        start = cell_at(starts[b, 0], starts[b, 1], lattice)
        goal = cell_at(goals[b, 0], goals[b, 1], lattice)
        load(maps[b], scratch.came_from)
        if scratch.came_from[goal] == WALL:
            for k in range(lattice.cells):
                scratch.g[np.uint64(k)] = INFINITY
        else:
            find_free_neighbours(scratch.came_from, lattice, neighbours)
            high_cost = jump_costs(goal, INFINITY, neighbours, lattice, scratch)
            if high_cost:
                return b, high_cost
        if len(optimal_moves):
            _write_moves_by_cost(scratch.g, lattice, optimal_moves[b, 0])
        if len(cost_to_go) or len(heuristic_ratio):
            goal_cell = (goals[b, 0], goals[b, 1])
            _write_goal_costs(b, goal_cell, None, lattice, scratch, cost_to_go, heuristic_ratio)
        if len(optimal_mask):
            optimal_mask[b] = 0
            if scratch.g[start] < INFINITY:  # Without a path the mask is 0 everywhere.
                load(maps[b], scratch.came_from)
                _mark_cells_by_cost(start, scratch, lattice, optimal_mask[b, 0])
    return len(maps), EXACT


@kernel
def _write_moves_by_cost(costs: Ints, lattice: Lattice, optimal_moves: Bytes) -> None:
    """Write the bit sets of the moves that begin shortest paths to ``optimal_moves`` (H, W).

    ``costs`` (cells,) are those to the goal, INFINITY on occupied cells and without a path.
    """
    rows, columns = optimal_moves.shape
    stride = np.uint64(lattice.stride)
    may_cut = lattice.diagonals == CORNER_CUTTING
    for row in range(rows):
        first = np.uint64(cell_at(row, 0, lattice))
        for column in range(columns):
            cell = first + np.uint64(column)
            cost = costs[cell]
            north = costs[cell - stride]
            east = costs[cell + _ONE]
            south = costs[cell + stride]
            west = costs[cell - _ONE]
            # This copy of the corner rule of `is_legal` has no branches, and sees from the costs
            # which cells are free: a free neighbour of a cell with a path has a path, too.
            north_free = may_cut | (north < INFINITY)
            east_free = may_cut | (east < INFINITY)
            south_free = may_cut | (south < INFINITY)
            west_free = may_cut | (west < INFINITY)
            straight = cost - UNIT
            diagonal = cost - lattice.diagonal_cost
            moves = np.int64(north == straight)
            moves |= np.int64(east == straight) << 1
            moves |= np.int64(south == straight) << 2
            moves |= np.int64(west == straight) << 3
            north_east = (costs[cell - stride + _ONE] == diagonal) & north_free & east_free
            south_east = (costs[cell + stride + _ONE] == diagonal) & south_free & east_free
            south_west = (costs[cell + stride - _ONE] == diagonal) & south_free & west_free
            north_west = (costs[cell - stride - _ONE] == diagonal) & north_free & west_free
            moves |= np.int64(north_east) << 4
            moves |= np.int64(south_east) << 5
            moves |= np.int64(south_west) << 6
            moves |= np.int64(north_west) << 7
            optimal_moves[row, column] = moves


@kernel
def _mark_cells_by_cost(start: Int, scratch: Scratch, lattice: Lattice, mask: Bytes) -> None:
    """Mark all cells of all shortest paths from ``start``, as `_mark_optimal_cells`.

    Args:
        start: padded cell.
        scratch: with the costs to the goal in ``g`` and the map loaded in ``came_from``.
        lattice: of the map.
        mask: (H, W), to be set to 1 on those cells.
    """
    costs = scratch.g
    stack = scratch.pushed
    stack[0] = start
    mask[position(start, lattice)] = 1
    stack_size = 1
    while stack_size:
        stack_size -= 1
        cell = np.int64(stack[stack_size])
        for move in range(len(lattice.offsets)):
            neighbour = cell + lattice.offsets[move]
            move_cost = UNIT if move < 4 else lattice.diagonal_cost
            if costs[neighbour] + move_cost != costs[cell]:
                continue
            if mask[position(neighbour, lattice)] or not is_legal(
                scratch.came_from, cell, move, lattice
            ):
                continue
            mask[position(neighbour, lattice)] = 1
            stack[stack_size] = neighbour
            stack_size += 1


@kernel
def _write_goal_costs(
    b: Int,
    goal: tuple[Int, Int],
    ground: PaddedTerrain | None,
    lattice: Lattice,
    scratch: Scratch,
    cost_to_go: Float32s,
    heuristic_ratio: Float32s,
) -> None:
    """Write the costs that a search around the goal of problem b left, and the ratios to them.

    One of the two fields of `GoalFields` may be empty.
    """
    _, _, rows, columns = cost_to_go.shape if len(cost_to_go) else heuristic_ratio.shape
    unit = unit_of(ground)
    for row in range(rows):
        for column in range(columns):
            cost = cost_in_cells(scratch.g[cell_at(row, column, lattice)], unit)
            if len(cost_to_go):
                cost_to_go[b, 0, row, column] = cost
            if len(heuristic_ratio):
                lower_bound = heuristic_on(row - goal[0], column - goal[1], ground, lattice)
                ratio = _ratio_of(cost_in_cells(lower_bound, unit), cost)
                heuristic_ratio[b, 0, row, column] = ratio


@inlined
def _ratio_of(lower_bound: float, cost: float) -> float:
    """Return the heuristic divided by the cost: 1 at the goal, 0 where there is no path."""
    if cost > 0:
        return lower_bound / cost
    return 1.0 if cost == 0 else 0.0


@kernel
def _mark_optimal_cells(
    start: Int, moves: Bytes, lattice: Lattice, stack: UInt32s, mask: Bytes
) -> None:
    """Mark all cells of all shortest paths from ``start`` to a goal.

    Args:
        start: padded cell.
        moves: (cells,) bit sets of the moves that begin shortest paths to the goal.
        lattice: of the map.
        stack: memory for all cells.
        mask: (H, W), to be set to 1 on those cells.
    """
    stack[0] = start
    mask[position(start, lattice)] = 1
    stack_size = 1
    while stack_size:
        stack_size -= 1
        cell = np.int64(stack[stack_size])
        for move in range(len(lattice.offsets)):
            if moves[cell] >> move & 1:
                neighbour = cell + lattice.offsets[move]
                if mask[position(neighbour, lattice)] == 0:
                    mask[position(neighbour, lattice)] = 1
                    stack[stack_size] = neighbour
                    stack_size += 1


@kernel
def count_shortest_paths(optimal_moves: Bytes, optimal_mask: Bytes, starts: Ints) -> Ints:
    """Return the number of shortest paths (B,) of each problem: 0 without a path, at most 10.

    Terrain has no free cell of cost 0, so every optimal move lowers the cost to the goal, and the
    optimal moves form a graph without cycles. A cell is counted when all cells before it are.

    Args:
        optimal_moves: (B, 1, H, W), bit sets of the moves that begin a shortest path.
        optimal_mask: (B, 1, H, W), 1 on the cells of all shortest paths.
        starts: (B, 2) cells.
    """
    count, _, rows, columns = optimal_moves.shape
    counts = np.zeros(count, np.int64)
    # Of each cell: the moves that lead to it from cells that are not counted yet, and the number of
    # shortest paths from the start to it.
    moves_to = np.zeros((rows, columns), np.uint8)
    paths_to = np.zeros((rows, columns), np.uint8)
    stack = np.empty(rows * columns, np.uint32)
    for b in range(count):
        for row in range(rows):
            for column in range(columns):
                if optimal_mask[b, 0, row, column]:
                    paths_to[row, column] = 0
                    for move in range(8):
                        if optimal_moves[b, 0, row, column] >> move & 1:
                            moves_to[row + STEPS[move, 0], column + STEPS[move, 1]] += 1
        if optimal_mask[b, 0, starts[b, 0], starts[b, 1]] == 0:
            continue
        paths_to[starts[b, 0], starts[b, 1]] = 1
        stack[0] = starts[b, 0] * columns + starts[b, 1]
        stack_size = 1
        while stack_size:
            stack_size -= 1
            row = np.int64(stack[stack_size]) // columns
            column = np.int64(stack[stack_size]) % columns
            # The goal is the only cell without a move, and so the last one.
            counts[b] = paths_to[row, column]
            for move in range(8):
                if optimal_moves[b, 0, row, column] >> move & 1:
                    next_row = row + STEPS[move, 0]
                    next_column = column + STEPS[move, 1]
                    paths = np.int64(paths_to[next_row, next_column]) + counts[b]
                    paths_to[next_row, next_column] = min(paths, MANY_PATHS)
                    moves_to[next_row, next_column] -= 1
                    if moves_to[next_row, next_column] == 0:
                        stack[stack_size] = next_row * columns + next_column
                        stack_size += 1
    return counts


@kernel
def path_probabilities(
    maps: Bytes,
    cell_costs: Bytes | None,
    starts: Ints,
    goals: Ints,
    cells: Ints,
    offsets: Ints,
    lattice: Lattice,
    scratch: Scratch,
) -> tuple[Float32s, Int, Int]:
    """Return TransPath's path probability maps, (B, 1, H, W) float32.

    The probability of a cell n is L / (d(start, n) + d(n, goal) + d(n, path)), where L is the cost
    of the path and d that of a shortest path. Below 0.95 it is set to 0.

    Args:
        maps: (B, H, W) grids or terrain.
        cell_costs: as from `as_ground`.
        starts: (B, 2) cells.
        goals: (B, 2) cells.
        cells: (M, 2), the cells of all paths, one after another.
        offsets: (B + 1,) where each path begins in there.
        lattice: of the maps.
        scratch: memory of the searches.
    """
    count, rows, columns = maps.shape
    from_start = np.empty((rows, columns))
    to_goal = np.empty((rows, columns))
    to_path = np.empty((rows, columns))
    probabilities = np.zeros((count, 1, rows, columns), np.float32)
    for b in range(count):
        path = cells_of(cells[offsets[b] : offsets[b + 1]], lattice)
        if len(path) == 0:
            continue
        for sources, costs in ((path[:1], from_start), (path[-1:], to_goal)):
            _, ground = load_map(maps[b], cell_costs, lattice, scratch.came_from)
            high_cost = shortest_costs_on(sources, cell_costs, ground, lattice, scratch)
            if high_cost:
                return probabilities, b, high_cost
            _write_costs(ground, lattice, scratch, costs)
        # No cell is farther from the path than from its start, so no cost is too high.
        _, ground = load_map(maps[b], cell_costs, lattice, scratch.came_from)
        shortest_costs_on(path, cell_costs, ground, lattice, scratch)
        _write_costs(ground, lattice, scratch, to_path)
        path_cost = to_goal[starts[b, 0], starts[b, 1]]
        for row in range(rows):
            for column in range(columns):
                if from_start[row, column] < 0:
                    continue
                detour_cost = from_start[row, column] + to_goal[row, column] + to_path[row, column]
                # The sum is 0 only if the path is a single cell.
                probability = path_cost / detour_cost if detour_cost > 0 else 1.0
                if probability >= PROBABLE:
                    probabilities[b, 0, row, column] = probability
    return probabilities, count, EXACT


@kernel
def _write_costs(
    ground: PaddedTerrain | None, lattice: Lattice, scratch: Scratch, costs: Floats
) -> None:
    """Write the costs that a search left in ``scratch.g`` to ``costs`` (H, W), in cells."""
    unit = unit_of(ground)
    for row in range(costs.shape[0]):
        for column in range(costs.shape[1]):
            costs[row, column] = cost_in_cells(scratch.g[cell_at(row, column, lattice)], unit)


@kernel
def fill_room_matrices(
    maps: Bytes, cell_costs: Bytes | None, seed_points: Ints, lattice: Lattice, scratch: Scratch
) -> tuple[Float32s, Int, Int]:
    """Return the costs of shortest paths between the seed points of each map.

    Args:
        maps: (B, H, W) grids or terrain.
        cell_costs: (cells,) memory for the costs of terrain; None for grids.
        seed_points: (B, R, 2) cells, -1 beyond the rooms of a map.
        lattice: of the maps.
        scratch: memory of the searches.

    Returns:
        The costs, (B, R, R) float32: 0 on the diagonal, -1 where there is no path, and -2 beyond
        the rooms of a map; the first map that has a cost that is too high to be exact, or B; and
        this cost, as `shortest_costs_on` returns it, or EXACT.
    """
    count = len(maps)
    max_rooms = seed_points.shape[1]
    matrices = np.full((count, max_rooms, max_rooms), NO_ROOM, np.float32)
    for b in range(count):
        rooms = 0
        while rooms < max_rooms and seed_points[b, rooms, 0] >= 0:
            rooms += 1
        cells = cells_of(seed_points[b, :rooms], lattice)
        for i in range(rooms):
            # A search on a grid overwrites the loaded map with moves, so each one loads it again;
            # terrain stays. Maps of datasets hold 0 and 1 alone, so loading cannot fail.
            if i == 0 or cell_costs is None:
                _, ground = load_map(maps[b], cell_costs, lattice, scratch.came_from)
            high_cost = shortest_costs_on(cells[i : i + 1], cell_costs, ground, lattice, scratch)
            if high_cost:
                return matrices, b, high_cost
            unit = unit_of(ground)
            for j in range(rooms):
                matrices[b, i, j] = cost_in_cells(scratch.g[cells[j]], unit)  # -1 without a path
            # The robot may have no room on a seed point, whose cost would then be -1.
            matrices[b, i, i] = 0
    return matrices, count, EXACT
