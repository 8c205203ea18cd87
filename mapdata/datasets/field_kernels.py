"""The kernels of `mapdata.datasets.fields`: each fills one or more fields for a whole batch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Float32s, Ints, UInt32s
from mapdata.jit import Int, kernel
from mapdata.search.bitboard import search_around
from mapdata.search.kernels import cost_at, scratch, shortest_costs
from mapdata.search.lattice import (
    ASTAR,
    FAR,
    Lattice,
    Rule,
    cell_at,
    cells_of,
    heuristic,
    in_cells,
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
def pad_paths(cells: Ints, offsets: Ints, padded: Ints) -> None:
    """Write paths to ``padded``, (B, capacity, 2), with -1 behind their cells."""
    for b in range(len(padded)):
        first = offsets[b]
        count = offsets[b + 1] - first
        for k in range(padded.shape[1]):
            padded[b, k, 0] = cells[first + k, 0] if k < count else PADDING
            padded[b, k, 1] = cells[first + k, 1] if k < count else PADDING


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
    buffers = scratch(ASTAR, lattice)
    moves = buffers.came
    costs_too = len(cost_to_go) + len(heuristic_ratio) > 0
    for b in range(len(grids)):
        goal_row = goals[b, 0]
        goal_column = goals[b, 1]
        search_around(grids[b], goal_row, goal_column, costs_too, lattice, buffers)
        if len(optimal_moves):
            for row in range(rows):
                first = np.uint64(cell_at(row, 0, lattice))
                for column in range(columns):
                    optimal_moves[b, 0, row, column] = moves[first + np.uint64(column)]
        for row in range(rows if costs_too else 0):
            for column in range(columns):
                value = cost_at(cell_at(row, column, lattice), buffers)
                if len(cost_to_go):
                    cost_to_go[b, 0, row, column] = value
                if len(heuristic_ratio):
                    least = in_cells(heuristic(row - goal_row, column - goal_column, lattice))
                    heuristic_ratio[b, 0, row, column] = least / value if value > 0 else 1.0 + value
        if len(optimal_mask):
            optimal_mask[b] = 0
            start = cell_at(starts[b, 0], starts[b, 1], lattice)
            if moves[start] or start == cell_at(goal_row, goal_column, lattice):
                _follow(start, moves, lattice, buffers.pushed, optimal_mask[b, 0])


@kernel
def _follow(start: Int, moves: Bytes, lattice: Lattice, stack: UInt32s, mask: Bytes) -> None:
    """Mark all cells that optimal ``moves`` lead to from ``start``."""
    stack[0] = start
    mask[position(start, lattice)] = 1
    size = 1
    while size:
        size -= 1
        cell = np.int64(stack[size])
        for move in range(len(lattice.offsets)):
            if moves[cell] >> move & 1:
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
    around_start = scratch(ASTAR, lattice)
    around_goal = scratch(ASTAR, lattice)
    around_path = scratch(ASTAR, lattice)
    out = np.zeros((count, 1, rows, columns), np.float32)
    for b in range(count):
        path = cells_of(cells[ends[b] : ends[b + 1]], lattice)
        if len(path) == 0:
            continue
        search_around(grids[b], starts[b, 0], starts[b, 1], True, lattice, around_start)
        search_around(grids[b], goals[b, 0], goals[b, 1], True, lattice, around_goal)
        load(grids[b], around_path.came)
        shortest_costs(path, FAR, lattice, around_path)
        best = cost_at(path[0], around_goal)
        for row in range(rows):
            for column in range(columns):
                cell = cell_at(row, column, lattice)
                from_start = cost_at(cell, around_start)
                if from_start >= 0:
                    through = from_start + cost_at(cell, around_goal)
                    through += cost_at(cell, around_path)
                    ratio = best / through if through > 0 else 1.0
                    if ratio >= PROBABLE:
                        out[b, 0, row, column] = ratio
    return out


@kernel
def fill_room_matrices(grids: Bytes, seed_points: Ints, rule: Rule) -> Float32s:
    """Return (B, R, R) float32 of costs between seed points, -1 no connection, -2 padding."""
    lattice = lattice_of(grids.shape[1:], rule)
    buffers = scratch(ASTAR, lattice)
    most = seed_points.shape[1]
    out = np.full((len(grids), most, most), -2, np.float32)
    for b in range(len(grids)):
        for i in range(most):
            if seed_points[b, i, 0] < 0:
                break
            row = seed_points[b, i, 0]
            column = seed_points[b, i, 1]
            search_around(grids[b], row, column, True, lattice, buffers)
            for j in range(most):
                if seed_points[b, j, 0] < 0:
                    break
                cell = cell_at(seed_points[b, j, 0], seed_points[b, j, 1], lattice)
                out[b, i, j] = cost_at(cell, buffers)
            out[b, i, i] = 0  # on an occupied cell, too
    return out
