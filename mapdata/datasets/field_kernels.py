"""The kernels of `mapdata.datasets.fields`: each fills one or more fields for a whole batch.

`count_shortest_paths` counts what the fields of all shortest paths hold.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Float32s, Ints, UInt32s
from mapdata.jit import Int, inlined, kernel
from mapdata.movement import STEPS
from mapdata.search.bitboard import write_optimal_moves
from mapdata.search.kernels import Scratch, cost_at, new_scratch, shortest_costs
from mapdata.search.lattice import (
    ASTAR,
    INFINITY,
    Lattice,
    MoveRule,
    cell_at,
    cells_of,
    heuristic,
    in_cells,
    lattice_of,
    load,
    position,
)

PADDING = -1
"""Fills the rows of ``path`` behind the cells of a path."""

PROBABLE = 0.95
"""TransPath's threshold of the path probability."""

NO_ROOM = -2

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
def count_steps(cells: Ints, offsets: Ints) -> tuple[Ints, Ints]:
    """Return straight and diagonal steps (B,) of each path, (-1, 0) for an empty one.

    ``cells`` (M, 2) and ``offsets`` (B + 1,) are the paths, as in `pad_paths`.
    """
    straight = np.full(len(offsets) - 1, -1)
    diagonal = np.zeros(len(offsets) - 1, np.int64)
    for b in range(len(straight)):
        if offsets[b + 1] > offsets[b]:
            straight[b] = 0
        for k in range(offsets[b] + 1, offsets[b + 1]):
            if cells[k, 0] != cells[k - 1, 0] and cells[k, 1] != cells[k - 1, 1]:
                diagonal[b] += 1
            else:
                straight[b] += 1
    return straight, diagonal


@kernel
def fill_goal_fields(
    grids: Bytes, starts: Ints, goals: Ints, rule: MoveRule, fields: GoalFields
) -> None:
    """Fill those of the fields that are not empty, by one search from the goal of each problem.

    Args:
        grids: (B, H, W).
        starts: (B, 2) cells.
        goals: (B, 2) cells.
        rule: as `move_rule` returns it.
        fields: to be filled.
    """
    cost_to_go, optimal_moves, heuristic_ratio, optimal_mask = fields
    _, rows, columns = grids.shape
    lattice = lattice_of((rows, columns), rule)
    scratch = new_scratch(ASTAR, lattice)
    moves = scratch.came_from
    needs_costs = len(cost_to_go) + len(heuristic_ratio) > 0
    for b in range(len(grids)):
        goal_row = goals[b, 0]
        goal_column = goals[b, 1]
        write_optimal_moves(grids[b], goal_row, goal_column, needs_costs, lattice, scratch)
        if len(optimal_moves):
            for row in range(rows):
                first = np.uint64(cell_at(row, 0, lattice))
                for column in range(columns):
                    optimal_moves[b, 0, row, column] = moves[first + np.uint64(column)]
        if needs_costs:
            for row in range(rows):
                for column in range(columns):
                    cost = cost_at(cell_at(row, column, lattice), scratch)
                    if len(cost_to_go):
                        cost_to_go[b, 0, row, column] = cost
                    if len(heuristic_ratio):
                        lower_bound = in_cells(
                            heuristic(row - goal_row, column - goal_column, lattice)
                        )
                        heuristic_ratio[b, 0, row, column] = ratio_of(lower_bound, cost)
        if len(optimal_mask):
            optimal_mask[b] = 0
            start = cell_at(starts[b, 0], starts[b, 1], lattice)
            goal = cell_at(goal_row, goal_column, lattice)
            if moves[start] or start == goal:
                mark_optimal_cells(start, moves, lattice, scratch.pushed, optimal_mask[b, 0])


@inlined
def ratio_of(lower_bound: float, cost: float) -> float:
    """Return the heuristic divided by the cost: 1 at the goal, 0 where there is no path."""
    if cost > 0:
        return lower_bound / cost
    return 1.0 if cost == 0 else 0.0


@kernel
def mark_optimal_cells(
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
    grids: Bytes, starts: Ints, goals: Ints, cells: Ints, offsets: Ints, rule: MoveRule
) -> Float32s:
    """Return TransPath's path probability maps, (B, 1, H, W) float32.

    The probability of a cell n is L / (d(start, n) + d(n, goal) + d(n, path)), where L is the cost
    of the path and d that of a shortest path. Below 0.95 it is set to 0.

    Args:
        grids: (B, H, W).
        starts: (B, 2) cells.
        goals: (B, 2) cells.
        cells: (M, 2), the cells of all paths, one after another.
        offsets: (B + 1,) where each path begins in there.
        rule: as `move_rule` returns it.
    """
    count, rows, columns = grids.shape
    lattice = lattice_of((rows, columns), rule)
    around_start = new_scratch(ASTAR, lattice)
    around_goal = new_scratch(ASTAR, lattice)
    around_path = new_scratch(ASTAR, lattice)
    probabilities = np.zeros((count, 1, rows, columns), np.float32)
    for b in range(count):
        path = cells_of(cells[offsets[b] : offsets[b + 1]], lattice)
        if len(path) == 0:
            continue
        write_optimal_moves(grids[b], starts[b, 0], starts[b, 1], True, lattice, around_start)
        write_optimal_moves(grids[b], goals[b, 0], goals[b, 1], True, lattice, around_goal)
        load(grids[b], around_path.came_from)
        shortest_costs(path, INFINITY, lattice, around_path)
        path_cost = cost_at(path[0], around_goal)
        for row in range(rows):
            for column in range(columns):
                cell = cell_at(row, column, lattice)
                probability = _path_probability(
                    path_cost, cell, around_start, around_goal, around_path
                )
                if probability >= PROBABLE:
                    probabilities[b, 0, row, column] = probability
    return probabilities


@inlined
def _path_probability(
    path_cost: float,
    cell: Int,
    around_start: Scratch,
    around_goal: Scratch,
    around_path: Scratch,
) -> float:
    """Return the probability of a padded cell, 0 if no path leads there; see `path_probabilities`.

    The last three arguments hold the costs from the start, from the goal and from the path.
    """
    from_start = cost_at(cell, around_start)
    if from_start < 0:
        return 0.0
    detour_cost = from_start + cost_at(cell, around_goal) + cost_at(cell, around_path)
    # The sum is 0 only if the path is a single cell.
    return path_cost / detour_cost if detour_cost > 0 else 1.0


@kernel
def fill_room_matrices(grids: Bytes, seed_points: Ints, rule: MoveRule) -> Float32s:
    """Return (B, R, R) float32 of costs between seed points.

    It is 0 on the diagonal, -1 where there is no connection, and -2 beyond the rooms of a map.

    Args:
        grids: (B, H, W).
        seed_points: (B, R, 2) cells, -1 beyond the rooms of a map.
        rule: as `move_rule` returns it.
    """
    lattice = lattice_of(grids.shape[1:], rule)
    scratch = new_scratch(ASTAR, lattice)
    max_rooms = seed_points.shape[1]
    matrices = np.full((len(grids), max_rooms, max_rooms), NO_ROOM, np.float32)
    for b in range(len(grids)):
        rooms = 0
        while rooms < max_rooms and seed_points[b, rooms, 0] >= 0:
            rooms += 1
        for i in range(rooms):
            row = seed_points[b, i, 0]
            column = seed_points[b, i, 1]
            write_optimal_moves(grids[b], row, column, True, lattice, scratch)
            for j in range(rooms):
                cell = cell_at(seed_points[b, j, 0], seed_points[b, j, 1], lattice)
                # `cost_at` is -1 without a path, which is the sign for no connection, too.
                matrices[b, i, j] = cost_at(cell, scratch)
            # The robot may have no room on a seed point, whose cost would then be -1.
            matrices[b, i, i] = 0
    return matrices
