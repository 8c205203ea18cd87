"""What a sample can hold: one function a field, each for a whole batch. All are listed in `FIELDS`.

A new field is one function here: it takes a `Batch` and returns an array whose first axis is the batch.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from mapdata.jit import Int, kernel
from mapdata.sample import PADDING, PATH_STEP
from mapdata.search import (
    FAR,
    STEPS,
    UNIT,
    WALL,
    bucket_search,
    estimate,
    load,
    log_size,
    parts,
    rule_of,
    search_batch,
    shortest_costs,
)
from mapdata.spec import Movement

Ints = npt.NDArray[np.int64]
Bytes = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float32]


class Paths(NamedTuple):
    """The paths of a batch: path b is ``cells[offsets[b]:offsets[b + 1]]``, empty where there is none."""

    cells: Ints
    offsets: Ints
    iterations: Ints


class Rooms(NamedTuple):
    """The rooms of a batch: (B, R, R) float32 connection matrices and (B, R, 2) int64 centres."""

    matrix: Floats
    centres: Ints


class GoalFields(NamedTuple):
    """The fields that one search around the goal gives, (B, 1, H, W) each, or empty."""

    cost_to_go: Floats
    optimal_moves: Bytes
    heuristic_ratio: Floats
    optimal_mask: Bytes


@dataclass
class Batch:
    """B problems, before any field is made of them. What only some fields need is found when it is first asked for.

    Attributes:
        movement: how paths move.
        planner: "bfs" or "astar", which found the paths.
        grids: (B, H, W) uint8 occupancy.
        starts: (B, 2) int64.
        goals: (B, 2) int64.
        problems: (B,) int64, numbers in the dataset.
        find_paths: gives the paths.
        find_rooms: gives connection matrices and centres.
        wanted: names of the fields that will be asked for.
        max_length: cells that ``path`` has room for; None for what the batch needs.
    """

    movement: Movement
    planner: str
    grids: Bytes
    starts: Ints
    goals: Ints
    problems: Ints
    find_paths: Callable[[], Paths]
    find_rooms: Callable[[], Rooms]
    wanted: frozenset[str]
    max_length: int | None = None

    def __len__(self) -> int:
        """Return B."""
        return len(self.starts)

    @cached_property
    def paths(self) -> Paths:
        """The paths, read or searched."""
        return self.find_paths()

    @cached_property
    def rooms(self) -> Rooms:
        """The rooms of the maps."""
        return self.find_rooms()

    @cached_property
    def costs(self) -> npt.NDArray[np.float64]:
        """(B,) cost of the paths, -1 without one; BFS counts moves."""
        straight, diagonal = _count_steps(self.paths.cells, self.paths.offsets)
        step = 1.0 if self.planner == "bfs" else self.movement.diagonal_cost
        return straight + diagonal * step

    @cached_property
    def goal_fields(self) -> GoalFields:
        """The fields that come from the search around the goal; those that were not asked for are empty."""
        shape, none = (len(self), 1, *self.grids.shape[1:]), (0, 1, 1, 1)
        fields = GoalFields(
            *(
                np.empty(shape if name in self.wanted else none, np.uint8 if name.startswith("optimal") else np.float32)
                for name in GoalFields._fields
            )
        )
        _goal_fields(self.grids, self.starts, self.goals, *rule_of(self.movement), *fields)
        return fields


def map_(batch: Batch) -> Bytes:
    """``map``: (B, 1, H, W) uint8, occupancy, 1 occupied."""
    return batch.grids[:, None]


def free(batch: Batch) -> Bytes:
    """``free``: (B, 1, H, W) uint8, 1 free: the other polarity."""
    return batch.grids[:, None] ^ np.uint8(1)


def start(batch: Batch) -> Ints:
    """``start``: (B, 2) int64, cell."""
    return batch.starts


def goal(batch: Batch) -> Ints:
    """``goal``: (B, 2) int64, cell."""
    return batch.goals


def path(batch: Batch) -> Ints:
    """``path``: (B, T, 2) int64, cells from start to goal, padded with -1; T a multiple of 16, or ``max_length``."""
    cells, offsets, _ = batch.paths
    longest = int(np.diff(offsets).max(initial=0))
    room = -(-longest // PATH_STEP) * PATH_STEP if batch.max_length is None else batch.max_length
    if longest > room:
        raise ValueError(f"max_length: a path of {longest} cells does not fit into {room}")
    return _pad(cells, offsets, room)


def length(batch: Batch) -> Ints:
    """``length``: (B,) int64, number of cells of the path, 0 without one."""
    return np.diff(batch.paths.offsets)


def cost(batch: Batch) -> Floats:
    """``cost``: (B,) float32, cost of the path in cells (BFS: moves), -1 without one."""
    return batch.costs.astype(np.float32)


def hardness(batch: Batch) -> Floats:
    """``hardness``: (B,) float32, optimal cost over heuristic; 1 when start = goal, -1 without a path."""
    best = batch.costs
    if batch.planner == "bfs" and batch.movement.connectivity == 8:  # BFS counts moves, which are not its costs
        best = search_batch("astar", batch.grids, batch.starts, batch.goals, batch.movement).cost
    return _hardness(best, batch.starts, batch.goals, *rule_of(batch.movement))


def iterations(batch: Batch) -> Ints:
    """``iterations``: (B,) int64, cells that the planner took from its frontier."""
    return batch.paths.iterations


def path_mask(batch: Batch) -> Bytes:
    """``path_mask``: (B, 1, H, W) uint8, 1 on the cells of the path (Neural A*'s ``opt_trajs``, but with the goal)."""
    return _mask(batch.paths.cells, batch.paths.offsets, batch.grids.shape[1], batch.grids.shape[2])[:, None]


def start_mask(batch: Batch) -> Bytes:
    """``start_mask``: (B, 1, H, W) uint8, 1 on the start."""
    return _points(batch.starts, batch.grids)


def goal_mask(batch: Batch) -> Bytes:
    """``goal_mask``: (B, 1, H, W) uint8, 1 on the goal."""
    return _points(batch.goals, batch.grids)


def optimal_mask(batch: Batch) -> Bytes:
    """``optimal_mask``: (B, 1, H, W) uint8, 1 on all cells of all shortest paths; 0 everywhere without a path."""
    return batch.goal_fields.optimal_mask


def cost_to_go(batch: Batch) -> Floats:
    """``cost_to_go``: (B, 1, H, W) float32, cost of the shortest path to the goal in cells, -1 unreachable."""
    return batch.goal_fields.cost_to_go


def optimal_moves(batch: Batch) -> Bytes:
    """``optimal_moves``: (B, 1, H, W) uint8, bit k set where move k (`search.STEPS`) starts a shortest path to the
    goal.

    0 at the goal, in walls and where the goal cannot be reached.
    """
    return batch.goal_fields.optimal_moves


def heuristic_ratio(batch: Batch) -> Floats:
    """``heuristic_ratio``: (B, 1, H, W) float32, heuristic over cost to go: 1 at the goal, 0 where unreachable.

    TransPath's correction factor "CF" (Kirilenko et al., AAAI 2023, https://arxiv.org/abs/2212.11730).
    """
    return batch.goal_fields.heuristic_ratio


def path_probability(batch: Batch) -> Floats:
    """``path_probability``: (B, 1, H, W) float32, L / (d(start, n) + d(n, goal) + d(n, path)), below 0.95 set to 0.

    TransPath's path probability map "PPM" (https://arxiv.org/abs/2212.11730); 0 everywhere without a path.
    """
    cells, offsets, _ = batch.paths
    return _path_probability(batch.grids, batch.starts, batch.goals, cells, offsets, *rule_of(batch.movement))


def connection_matrix(batch: Batch) -> Floats:
    """``connection_matrix``: (B, R, R) float32, costs between rooms; -1 no connection, -2 padding."""
    return batch.rooms.matrix


def room_centres(batch: Batch) -> Ints:
    """``room_centres``: (B, R, 2) int64, seed cells of the rooms, padded with -1."""
    return batch.rooms.centres


def problem(batch: Batch) -> Ints:
    """``problem``: (B,) int64, the problem's number in the dataset."""
    return batch.problems


_PROBABLE = 0.95
"""TransPath's threshold of the path probability."""

Field = Callable[[Batch], npt.NDArray[np.generic]]

FIELDS: dict[str, Field] = {
    field.__name__.rstrip("_"): field
    for field in (
        map_,
        free,
        start,
        goal,
        path,
        length,
        cost,
        hardness,
        iterations,
        path_mask,
        start_mask,
        goal_mask,
        optimal_mask,
        cost_to_go,
        optimal_moves,
        heuristic_ratio,
        path_probability,
        connection_matrix,
        room_centres,
        problem,
    )
}
"""All fields by name."""


def _points(cells: Ints, grids: Bytes) -> Bytes:
    mask = np.zeros((len(grids), 1, *grids.shape[1:]), np.uint8)
    mask[(np.arange(len(cells)), 0, *cells.T)] = 1
    return mask


@kernel
def _pad(cells: Ints, offsets: Ints, room: Int) -> Ints:
    out = np.empty((len(offsets) - 1, room, 2), np.int64)
    for b in range(len(out)):
        first, count = offsets[b], offsets[b + 1] - offsets[b]
        for k in range(count):
            out[b, k, 0], out[b, k, 1] = cells[first + k, 0], cells[first + k, 1]
        for k in range(count, room):
            out[b, k, 0] = out[b, k, 1] = PADDING
    return out


@kernel
def _mask(cells: Ints, offsets: Ints, rows: Int, columns: Int) -> Bytes:
    mask = np.zeros((len(offsets) - 1, rows, columns), np.uint8)
    for b in range(len(mask)):
        for k in range(offsets[b], offsets[b + 1]):
            mask[b, cells[k, 0], cells[k, 1]] = 1
    return mask


@kernel
def _count_steps(cells: Ints, offsets: Ints) -> tuple[Ints, Ints]:
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
def _hardness(costs: npt.NDArray[np.float64], starts: Ints, goals: Ints, diagonals: Int, step: Int) -> Floats:
    out = np.empty(len(costs), np.float32)
    for b in range(len(costs)):
        straight, diagonal = parts(estimate(starts[b, 0] - goals[b, 0], starts[b, 1] - goals[b, 1], diagonals, step))
        least = straight + diagonal * math.sqrt(2.0)
        out[b] = -1.0 if costs[b] < 0 else 1.0 if least == 0 else costs[b] / least
    return out


@kernel
def _goal_fields(
    grids: Bytes,
    starts: Ints,
    goals: Ints,
    diagonals: Int,
    step: Int,
    cost_to_go: Floats,
    optimal_moves: Bytes,
    heuristic_ratio: Floats,
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
def _path_probability(
    grids: Bytes, starts: Ints, goals: Ints, cells: Ints, ends: Ints, diagonals: Int, step: Int
) -> Floats:
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
                    if ratio >= _PROBABLE:
                        out[b, 0, row, column] = ratio
    return out


def room_matrices(planner: str, grids: Bytes, centres: Ints, movement: Movement) -> Floats:
    """Return connection matrices (B, R, R) float32 between ``centres`` (B, R, 2), found by searching each grid.

    -1 no connection, -2 where a centre is (-1, -1). "bfs" counts moves.
    """
    diagonals, step = rule_of(movement)
    return _room_matrices(grids, centres, diagonals, UNIT if planner == "bfs" else step)


@kernel
def _room_matrices(grids: Bytes, centres: Ints, diagonals: Int, step: Int) -> Floats:
    count, rows, columns = grids.shape
    stride = columns + 2
    cells = (rows + 2) * stride
    offsets = STEPS[:, 0] * stride + STEPS[:, 1]
    came, costs, log = np.full(cells, WALL), np.empty(cells, np.int64), log_size(cells, diagonals, step)
    queue, below = np.empty(log, np.uint32), np.empty(log, np.uint32)
    most = centres.shape[1]
    out = np.full((count, most, most), -2, np.float32)
    for b in range(count):
        for i in range(most):
            if centres[b, i, 0] < 0:
                break
            load(grids[b], came)
            source = (centres[b, i, 0] + 1) * stride + centres[b, i, 1] + 1
            shortest_costs(came, costs, queue, below, offsets, source, diagonals, step)
            for j in range(most):
                if centres[b, j, 0] < 0:
                    break
                cost = costs[(centres[b, j, 0] + 1) * stride + centres[b, j, 1] + 1]
                out[b, i, j] = -1 if cost == FAR else _in_cells(cost)
    return out
