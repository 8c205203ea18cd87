"""The kernels of `mapdata.datasets.fields`: each fills one or more fields for a whole batch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Float32s, Ints, UInt32s
from mapdata.jit import Int, inlined, kernel
from mapdata.search.kernels import Scratch, bucket_search, scratch, shortest_costs
from mapdata.search.lattice import (
    COSTS,
    FAR,
    UNIT,
    Lattice,
    Rule,
    cell_at,
    heuristic,
    in_cells,
    is_legal,
    lattice_of,
    load,
    position,
)

PADDING = -1
"""What fills the rows of ``path`` beyond a path's own cells."""

PROBABLE = 0.95
"""TransPath's threshold of the path probability."""


class GoalFields(NamedTuple):
    """The fields that one search around the goal gives, (B, 1, H, W) each, or empty."""

    cost_to_go: Float32s
    optimal_moves: Bytes
    heuristic_ratio: Float32s
    optimal_mask: Bytes


@kernel
def pad_paths(cells: Ints, offsets: Ints, capacity: Int) -> Ints:
    """Return paths as (B, capacity, 2), padded with -1."""
    out = np.empty((len(offsets) - 1, capacity, 2), np.int64)
    for b in range(len(out)):
        first = offsets[b]
        count = offsets[b + 1] - first
        for k in range(count):
            out[b, k, 0] = cells[first + k, 0]
            out[b, k, 1] = cells[first + k, 1]
        for k in range(count, capacity):
            out[b, k, 0] = out[b, k, 1] = PADDING
    return out


@kernel
def mask_paths(cells: Ints, offsets: Ints, rows: Int, columns: Int) -> Bytes:
    """Return (B, H, W) uint8, 1 on the cells of each path."""
    mask = np.zeros((len(offsets) - 1, rows, columns), np.uint8)
    for b in range(len(mask)):
        for k in range(offsets[b], offsets[b + 1]):
            mask[b, cells[k, 0], cells[k, 1]] = 1
    return mask


@kernel
def count_steps(cells: Ints, offsets: Ints) -> tuple[Ints, Ints]:
    """Return straight and diagonal steps of each path, (-1, 0) for an empty one."""
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
    grids: Bytes, starts: Ints, goals: Ints, rule: Rule, fields: GoalFields
) -> None:
    """Fill those of the fields that are not empty, from one search a problem."""
    cost_to_go, optimal_moves, heuristic_ratio, optimal_mask = fields
    _, rows, columns = grids.shape
    lattice = lattice_of((rows, columns), rule)
    buffers = scratch(COSTS, lattice)
    came = buffers.came
    costs = buffers.g
    for b in range(len(grids)):
        goal_row = goals[b, 0]
        goal_column = goals[b, 1]
        load(grids[b], came)
        shortest_costs(cell_at(goal_row, goal_column, lattice), lattice, buffers)
        for row in range(rows):
            for column in range(columns):
                cell = cell_at(row, column, lattice)
                cost = costs[cell]
                if len(cost_to_go) or len(heuristic_ratio):
                    value = in_cells(cost) if cost != FAR else -1.0
                    if len(cost_to_go):
                        cost_to_go[b, 0, row, column] = value
                    if len(heuristic_ratio):
                        least = in_cells(heuristic(row - goal_row, column - goal_column, lattice))
                        heuristic_ratio[b, 0, row, column] = (
                            least / value if value > 0 else 1.0 + value
                        )
                if len(optimal_moves):
                    moves = _moves_from(costs, came, cell, lattice) if cost != FAR else 0
                    optimal_moves[b, 0, row, column] = moves
        if len(optimal_mask):
            optimal_mask[b] = 0
            start = cell_at(starts[b, 0], starts[b, 1], lattice)
            if costs[start] != FAR:
                _follow(start, costs, came, lattice, buffers.pushed, optimal_mask[b, 0])


@inlined
def _moves_from(costs: Ints, came: Bytes, cell: Int, lattice: Lattice) -> Int:
    """Return the bit set of the moves from ``cell`` that start a shortest path to the goal."""
    found = np.uint8(0)
    # Straight moves need no rule, since walls are FAR: without a branch, a tenth faster.
    for move in range(4):
        shortest = costs[cell + lattice.offsets[move]] + UNIT == costs[cell]
        found |= np.uint8(shortest) << np.uint8(move)
    for move in range(4, len(lattice.offsets)):
        shortest = costs[cell + lattice.offsets[move]] + lattice.step == costs[cell]
        if shortest and is_legal(came, cell, move, lattice):
            found |= np.uint8(1) << np.uint8(move)
    return found


@kernel
def _follow(
    start: Int, costs: Ints, came: Bytes, lattice: Lattice, stack: UInt32s, mask: Bytes
) -> None:
    """Mark all cells that optimal moves lead to from ``start``."""
    stack[0] = start
    mask[position(start, lattice)] = 1
    size = 1
    while size:
        size -= 1
        cell = np.int64(stack[size])
        moves = _moves_from(costs, came, cell, lattice)
        for move in range(len(lattice.offsets)):
            if moves >> move & 1:
                to = cell + lattice.offsets[move]
                if mask[position(to, lattice)] == 0:
                    mask[position(to, lattice)] = 1
                    stack[size] = to
                    size += 1


@kernel
def path_probabilities(
    grids: Bytes, starts: Ints, goals: Ints, cells: Ints, ends: Ints, rule: Rule
) -> Float32s:
    """Return TransPath's path probability maps, (B, 1, H, W).

    L / (d(start, n) + d(n, goal) + d(n, path)) where it is at least 0.95, else 0.
    """
    count, rows, columns = grids.shape
    lattice = lattice_of((rows, columns), rule)
    buffers = scratch(COSTS, lattice)
    around_start = np.empty(lattice.cells, np.int64)
    around_goal = np.empty(lattice.cells, np.int64)
    around_path = buffers.g
    came = buffers.came
    pushed = buffers.pushed
    links = buffers.links
    out = np.zeros((count, 1, rows, columns), np.float32)
    for b in range(count):
        length = ends[b + 1] - ends[b]
        if length == 0:
            continue
        start = cell_at(starts[b, 0], starts[b, 1], lattice)
        goal = cell_at(goals[b, 0], goals[b, 1], lattice)
        for source, costs in ((start, around_start), (goal, around_goal)):
            load(grids[b], came)
            shortest_costs(source, lattice, Scratch(came, costs, pushed, links, buffers.f))
        around_path[:] = FAR
        for k in range(length):
            cell = cell_at(cells[ends[b] + k, 0], cells[ends[b] + k, 1], lattice)
            pushed[1 + k] = cell
            around_path[cell] = 0
        bucket_search(length, lattice, buffers)
        best = in_cells(around_goal[start])
        for row in range(rows):
            for column in range(columns):
                cell = cell_at(row, column, lattice)
                if around_start[cell] != FAR:
                    through = in_cells(around_start[cell]) + in_cells(around_goal[cell])
                    through += in_cells(around_path[cell])
                    ratio = best / through if through > 0 else 1.0
                    if ratio >= PROBABLE:
                        out[b, 0, row, column] = ratio
    return out


@kernel
def fill_room_matrices(grids: Bytes, seed_points: Ints, rule: Rule) -> Float32s:
    """Return (B, R, R) float32 of costs between seed points, -1 no connection, -2 padding."""
    lattice = lattice_of(grids.shape[1:], rule)
    buffers = scratch(COSTS, lattice)
    most = seed_points.shape[1]
    out = np.full((len(grids), most, most), -2, np.float32)
    for b in range(len(grids)):
        for i in range(most):
            if seed_points[b, i, 0] < 0:
                break
            load(grids[b], buffers.came)
            source = cell_at(seed_points[b, i, 0], seed_points[b, i, 1], lattice)
            shortest_costs(source, lattice, buffers)
            for j in range(most):
                if seed_points[b, j, 0] < 0:
                    break
                cost = buffers.g[cell_at(seed_points[b, j, 0], seed_points[b, j, 1], lattice)]
                out[b, i, j] = -1 if cost == FAR else in_cells(cost)
            out[b, i, i] = 0  # on an occupied cell, too
    return out
