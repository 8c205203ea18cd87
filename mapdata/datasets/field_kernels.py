"""The kernels of `mapdata.datasets.fields`: each fills one or more fields for a whole batch."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from mapdata.arrays import Bytes, Float32s, Ints
from mapdata.jit import Int, kernel
from mapdata.search.kernels import bucket_search, log_size, shortest_costs
from mapdata.search.lattice import FAR, STEPS, UNIT, WALL, estimate, load, parts

PADDING = -1
"""What fills the rows of ``path`` beyond a path's own cells."""

PROBABLE = 0.95
"""TransPath's threshold of the path probability."""


@kernel
def pad_paths(cells: Ints, offsets: Ints, capacity: Int) -> Ints:
    """Return paths as (B, room, 2), padded with -1."""
    out = np.empty((len(offsets) - 1, capacity, 2), np.int64)
    for b in range(len(out)):
        first, count = offsets[b], offsets[b + 1] - offsets[b]
        for k in range(count):
            out[b, k, 0], out[b, k, 1] = cells[first + k, 0], cells[first + k, 1]
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
    straight, diagonal = np.full(len(offsets) - 1, -1), np.zeros(len(offsets) - 1, np.int64)
    for b in range(len(straight)):
        if offsets[b + 1] > offsets[b]:
            straight[b] = 0
        for k in range(offsets[b] + 1, offsets[b + 1]):
            both = cells[k, 0] != cells[k - 1, 0] and cells[k, 1] != cells[k - 1, 1]
            diagonal[b] += both
            straight[b] += not both
    return straight, diagonal


@kernel
def hardness_of(costs: npt.NDArray[np.float64], starts: Ints, goals: Ints, diagonals: Int, step: Int) -> Float32s:
    """Return (B,) float32, cost over heuristic; 1 when start = goal, -1 where the cost is."""
    out = np.empty(len(costs), np.float32)
    for b in range(len(costs)):
        straight, diagonal = parts(estimate(starts[b, 0] - goals[b, 0], starts[b, 1] - goals[b, 1], diagonals, step))
        least = straight + diagonal * math.sqrt(2.0)
        out[b] = -1.0 if costs[b] < 0 else 1.0 if least == 0 else costs[b] / least
    return out


@kernel
def fill_goal_fields(
    grids: Bytes,
    starts: Ints,
    goals: Ints,
    diagonals: Int,
    step: Int,
    cost_to_go: Float32s,
    optimal_moves: Bytes,
    heuristic_ratio: Float32s,
    optimal_mask: Bytes,
) -> None:
    """Fill those of the four fields that are not empty, (B, 1, H, W) each, from one search a problem."""
    count, rows, columns = grids.shape
    stride = columns + 2
    cells = (rows + 2) * stride
    offsets = STEPS[:, 0] * stride + STEPS[:, 1]
    came, costs, log = np.full(cells, WALL), np.empty(cells, np.int64), log_size(cells, diagonals, step)
    queue, below = np.empty(log, np.uint32), np.empty(log, np.uint32)
    for b in range(count):
        goal = (goals[b, 0] + 1) * stride + goals[b, 1] + 1
        load(grids[b], came)
        shortest_costs(came, costs, queue, below, offsets, goal, diagonals, step)
        for row in range(rows):
            for column in range(columns):
                cell = (row + 1) * stride + column + 1
                cost = costs[cell]
                if len(cost_to_go) or len(heuristic_ratio):
                    value = _in_cells(cost) if cost != FAR else -1.0
                    if len(cost_to_go):
                        cost_to_go[b, 0, row, column] = value
                    if len(heuristic_ratio):
                        least = _in_cells(estimate(row - goals[b, 0], column - goals[b, 1], diagonals, step))
                        heuristic_ratio[b, 0, row, column] = least / value if value > 0 else 1.0 + value
                if len(optimal_moves):
                    found = np.uint8(0)
                    if cost != FAR:
                        for move in range(4):
                            found |= np.uint8(costs[cell + offsets[move]] + UNIT == cost) << np.uint8(move)
                        if diagonals:
                            for move in range(4, 8):
                                if costs[cell + offsets[move]] + step == cost and (
                                    diagonals == 2
                                    or (
                                        came[cell + (-stride if move in (4, 7) else stride)] != WALL
                                        and came[cell + (1 if move in (4, 5) else -1)] != WALL
                                    )
                                ):
                                    found |= np.uint8(1) << np.uint8(move)
                    optimal_moves[b, 0, row, column] = found
        if len(optimal_mask):
            optimal_mask[b] = 0
            cell = (starts[b, 0] + 1) * stride + starts[b, 1] + 1
            if costs[cell] != FAR:
                _follow(costs, came, offsets, cell, diagonals, step, queue, optimal_mask[b, 0])


@kernel
def _in_cells(cost: Int) -> Int:
    straight, diagonal = parts(cost)
    return straight + diagonal * math.sqrt(2.0)


@kernel
def _moves_from(costs: Ints, came: Bytes, offsets: Ints, cell: Int, diagonals: Int, step: Int) -> Int:
    """Return the bit set of moves from ``cell`` that start a shortest path to where ``costs`` is 0."""
    found = 0
    for move in range(8 if diagonals else 4):
        if costs[cell + offsets[move]] + (UNIT if move < 4 else step) != costs[cell]:
            continue
        if move >= 4 and diagonals == 1:
            vertical, sideways = cell + offsets[0 if move in (4, 7) else 2], cell + offsets[1 if move in (4, 5) else 3]
            if came[vertical] == WALL or came[sideways] == WALL:
                continue
        found |= 1 << move
    return found


@kernel
def _follow(
    costs: Ints,
    came: Bytes,
    offsets: Ints,
    start: Int,
    diagonals: Int,
    step: Int,
    stack: npt.NDArray[np.uint32],
    mask: Bytes,
) -> None:
    """Mark all cells that optimal moves lead to from ``start``."""
    stride, size = offsets[2], 1
    stack[0] = start
    mask[start // stride - 1, start % stride - 1] = 1
    while size:
        size -= 1
        cell = np.int64(stack[size])
        moves = _moves_from(costs, came, offsets, cell, diagonals, step)
        for move in range(8):
            if moves >> move & 1:
                to = cell + offsets[move]
                if mask[to // stride - 1, to % stride - 1] == 0:
                    mask[to // stride - 1, to % stride - 1] = 1
                    stack[size] = to
                    size += 1


@kernel
def path_probabilities(
    grids: Bytes, starts: Ints, goals: Ints, cells: Ints, ends: Ints, diagonals: Int, step: Int
) -> Float32s:
    """Return (B, 1, H, W): L / (d(start, n) + d(n, goal) + d(n, path)) where it is at least 0.95, else 0."""
    count, rows, columns = grids.shape
    stride = columns + 2
    padded = (rows + 2) * stride
    offsets = STEPS[:, 0] * stride + STEPS[:, 1]
    came, costs, log = np.full(padded, WALL), np.empty((3, padded), np.int64), 8 * padded + 2
    queue, below = np.empty(log, np.uint32), np.empty(log, np.uint32)
    out = np.zeros((count, 1, rows, columns), np.float32)
    for b in range(count):
        if ends[b] == ends[b + 1]:
            continue
        load(grids[b], came)
        costs[:] = FAR
        for k, cell in enumerate((starts[b], goals[b])):
            queue[1] = (cell[0] + 1) * stride + cell[1] + 1
            costs[k, queue[1]] = 0
            bucket_search(came, costs[k], queue, below, offsets, 1, diagonals, step)
        for k in range(ends[b], ends[b + 1]):
            queue[1 + k - ends[b]] = (cells[k, 0] + 1) * stride + cells[k, 1] + 1
            costs[2, queue[1 + k - ends[b]]] = 0
        bucket_search(came, costs[2], queue, below, offsets, ends[b + 1] - ends[b], diagonals, step)
        best = _in_cells(costs[1, (starts[b, 0] + 1) * stride + starts[b, 1] + 1])
        for row in range(rows):
            for column in range(columns):
                at = (row + 1) * stride + column + 1
                if costs[0, at] != FAR:
                    through = _in_cells(costs[0, at]) + _in_cells(costs[1, at]) + _in_cells(costs[2, at])
                    ratio = best / through if through > 0 else 1.0
                    if ratio >= PROBABLE:
                        out[b, 0, row, column] = ratio
    return out


@kernel
def fill_room_matrices(grids: Bytes, seed_points: Ints, diagonals: Int, step: Int) -> Float32s:
    """Return (B, R, R) float32 of costs between centres, -1 no connection, -2 padding."""
    count, rows, columns = grids.shape
    stride = columns + 2
    cells = (rows + 2) * stride
    offsets = STEPS[:, 0] * stride + STEPS[:, 1]
    came, costs, log = np.full(cells, WALL), np.empty(cells, np.int64), log_size(cells, diagonals, step)
    queue, below = np.empty(log, np.uint32), np.empty(log, np.uint32)
    most = seed_points.shape[1]
    out = np.full((count, most, most), -2, np.float32)
    for b in range(count):
        for i in range(most):
            if seed_points[b, i, 0] < 0:
                break
            load(grids[b], came)
            source = (seed_points[b, i, 0] + 1) * stride + seed_points[b, i, 1] + 1
            shortest_costs(came, costs, queue, below, offsets, source, diagonals, step)
            for j in range(most):
                if seed_points[b, j, 0] < 0:
                    break
                cost = costs[(seed_points[b, j, 0] + 1) * stride + seed_points[b, j, 1] + 1]
                out[b, i, j] = -1 if cost == FAR else _in_cells(cost)
    return out
