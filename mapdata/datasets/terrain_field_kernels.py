"""The kernels of field_kernels.py for terrain: fields of a batch of maps whose cells have costs.

All of them that search return, last, the number of the first map with a cost that is too high to be
exact, and this doubled cost; both are the number of maps and 0 if all costs are exact. With a high
cost, what has been filled is to be thrown away.
"""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Bytes, Float32s, Ints
from mapdata.datasets.field_kernels import (
    NO_ROOM,
    PROBABLE,
    GoalFields,
    mark_optimal_cells,
    ratio_of,
)
from mapdata.jit import Int, kernel
from mapdata.search.kernels import new_scratch
from mapdata.search.lattice import ASTAR, MoveRule, cell_at, cells_of, lattice_of
from mapdata.search.terrain import (
    cost_in_cells,
    load_terrain,
    shortest_terrain_costs,
    terrain_heuristic,
)


@kernel
def sum_terrain_steps(terrains: Bytes, cells: Ints, offsets: Ints) -> Ints:
    """Return the sums S and D (B, 2) of the doubled cost of each path, (-1, 0) for an empty one.

    Args:
        terrains: (B, H, W).
        cells: (M, 2), the cells of all paths, one after another.
        offsets: (B + 1,) where each path begins in there.
    """
    sums = np.zeros((len(terrains), 2), np.int64)
    for b in range(len(terrains)):
        if offsets[b + 1] == offsets[b]:
            sums[b, 0] = -1
        for k in range(offsets[b] + 1, offsets[b + 1]):
            cost = np.int64(terrains[b, cells[k, 0], cells[k, 1]])
            cost += np.int64(terrains[b, cells[k - 1, 0], cells[k - 1, 1]])
            is_diagonal = cells[k, 0] != cells[k - 1, 0] and cells[k, 1] != cells[k - 1, 1]
            sums[b, 1 if is_diagonal else 0] += cost
    return sums


@kernel
def fill_terrain_goal_fields(
    terrains: Bytes, starts: Ints, goals: Ints, rule: MoveRule, fields: GoalFields
) -> tuple[Int, Int]:
    """Fill those of the fields that are not empty, by one search from the goal of each problem.

    Args:
        terrains: (B, H, W).
        starts: (B, 2) cells.
        goals: (B, 2) cells.
        rule: as `move_rule` returns it.
        fields: to be filled.
    """
    cost_to_go, optimal_moves, heuristic_ratio, optimal_mask = fields
    count, rows, columns = terrains.shape
    lattice = lattice_of((rows, columns), rule)
    scratch = new_scratch(ASTAR, lattice)
    cell_costs = np.zeros(lattice.cells, np.uint8)
    moves = scratch.came_from
    for b in range(count):
        goal = cell_at(goals[b, 0], goals[b, 1], lattice)
        padded = load_terrain(terrains[b], lattice, cell_costs, scratch.came_from)
        high_cost = shortest_terrain_costs(np.full(1, goal), padded, lattice, scratch)
        if high_cost:
            return b, high_cost
        for row in range(rows):
            for column in range(columns):
                cell = cell_at(row, column, lattice)
                if len(optimal_moves):
                    optimal_moves[b, 0, row, column] = moves[cell]
                if len(cost_to_go) + len(heuristic_ratio):
                    cost = cost_in_cells(scratch.g[cell], padded)
                    if len(cost_to_go):
                        cost_to_go[b, 0, row, column] = cost
                    if len(heuristic_ratio):
                        lower_bound = terrain_heuristic(
                            row - goals[b, 0], column - goals[b, 1], padded, lattice
                        )
                        ratio = ratio_of(cost_in_cells(lower_bound, padded), cost)
                        heuristic_ratio[b, 0, row, column] = ratio
        if len(optimal_mask):
            optimal_mask[b] = 0
            start = cell_at(starts[b, 0], starts[b, 1], lattice)
            if moves[start] or start == goal:
                mark_optimal_cells(start, moves, lattice, scratch.pushed, optimal_mask[b, 0])
    return count, np.int64(0)


@kernel
def terrain_path_probabilities(
    terrains: Bytes, starts: Ints, goals: Ints, cells: Ints, offsets: Ints, rule: MoveRule
) -> tuple[Float32s, Int, Int]:
    """Return TransPath's path probability maps, (B, 1, H, W) float32, as `path_probabilities` does.

    Args:
        terrains: (B, H, W).
        starts: (B, 2) cells.
        goals: (B, 2) cells.
        cells: (M, 2), the cells of all paths, one after another.
        offsets: (B + 1,) where each path begins in there.
        rule: as `move_rule` returns it.
    """
    count, rows, columns = terrains.shape
    lattice = lattice_of((rows, columns), rule)
    scratch = new_scratch(ASTAR, lattice)
    cell_costs = np.zeros(lattice.cells, np.uint8)
    from_start = np.empty(lattice.cells)
    to_goal = np.empty(lattice.cells)
    probabilities = np.zeros((count, 1, rows, columns), np.float32)
    for b in range(count):
        path = cells_of(cells[offsets[b] : offsets[b + 1]], lattice)
        if len(path) == 0:
            continue
        padded = load_terrain(terrains[b], lattice, cell_costs, scratch.came_from)
        high_cost = shortest_terrain_costs(path[:1], padded, lattice, scratch)
        if high_cost:
            return probabilities, b, high_cost
        for cell in range(lattice.cells):
            from_start[cell] = cost_in_cells(scratch.g[cell], padded)
        high_cost = shortest_terrain_costs(path[-1:], padded, lattice, scratch)
        if high_cost:
            return probabilities, b, high_cost
        for cell in range(lattice.cells):
            to_goal[cell] = cost_in_cells(scratch.g[cell], padded)
        # No cell is farther from the path than from its start, so no cost is too high.
        shortest_terrain_costs(path, padded, lattice, scratch)
        path_cost = to_goal[path[0]]
        for row in range(rows):
            for column in range(columns):
                cell = cell_at(row, column, lattice)
                if from_start[cell] < 0:
                    continue
                to_path = cost_in_cells(scratch.g[cell], padded)
                detour_cost = from_start[cell] + to_goal[cell] + to_path
                # The sum is 0 only if the path is a single cell.
                probability = path_cost / detour_cost if detour_cost > 0 else 1.0
                if probability >= PROBABLE:
                    probabilities[b, 0, row, column] = probability
    return probabilities, count, np.int64(0)


@kernel
def fill_terrain_room_matrices(
    terrains: Bytes, seed_points: Ints, rule: MoveRule
) -> tuple[Float32s, Int, Int]:
    """Return (B, R, R) float32 of costs between seed points.

    It is 0 on the diagonal, -1 where there is no connection, and -2 beyond the rooms of a map.

    Args:
        terrains: (B, H, W).
        seed_points: (B, R, 2) cells, -1 beyond the rooms of a map.
        rule: as `move_rule` returns it.
    """
    count = len(terrains)
    lattice = lattice_of(terrains.shape[1:], rule)
    scratch = new_scratch(ASTAR, lattice)
    cell_costs = np.zeros(lattice.cells, np.uint8)
    max_rooms = seed_points.shape[1]
    matrices = np.full((count, max_rooms, max_rooms), NO_ROOM, np.float32)
    for b in range(count):
        padded = load_terrain(terrains[b], lattice, cell_costs, scratch.came_from)
        rooms = 0
        while rooms < max_rooms and seed_points[b, rooms, 0] >= 0:
            rooms += 1
        cells = cells_of(seed_points[b, :rooms], lattice)
        for i in range(rooms):
            high_cost = shortest_terrain_costs(cells[i : i + 1], padded, lattice, scratch)
            if high_cost:
                return matrices, b, high_cost
            for j in range(rooms):
                # -1 stands for a missing path as well as for no connection.
                matrices[b, i, j] = cost_in_cells(scratch.g[cells[j]], padded)
            # The robot may have no room on a seed point, whose cost would then be -1.
            matrices[b, i, i] = 0
    return matrices, count, np.int64(0)
