"""What a sample can hold: one function a field, each for a whole batch. All are listed in `FIELDS`.

A new field is one function here: it takes a `Batch` and returns an array whose first axis is the
batch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mapdata.arrays import Array, Bytes, Float32s, Floats, Ints, offsets_of, summary
from mapdata.datasets.field_kernels import (
    GoalFields,
    count_steps,
    fill_goal_fields,
    fill_room_matrices,
    mask_paths,
    pad_paths,
    path_probabilities,
)
from mapdata.datasets.sample import rows_of_path
from mapdata.movement import Movement
from mapdata.search.api import SEARCHES, solve_batch
from mapdata.search.footprint import clearances
from mapdata.search.lattice import UNIT, move_rule
from mapdata.search.lattice import hardness as hardness_of


class Paths(NamedTuple):
    """The paths of a batch: path b is ``cells[offsets[b]:offsets[b + 1]]``.

    It is empty where there is none.
    """

    cells: Ints
    offsets: Ints
    iterations: Ints

    def replaced(self, rows: Ints, others: Paths) -> Paths:
        """Return these paths with ``others`` in their place in some rows."""
        parts = np.split(self.cells, self.offsets[1:-1])
        for row, cells in zip(rows, np.split(others.cells, others.offsets[1:-1]), strict=True):
            parts[row] = cells
        self.iterations[rows] = others.iterations
        return Paths(np.concatenate(parts), offsets_of([*map(len, parts)]), self.iterations)


class Rooms(NamedTuple):
    """The rooms of a batch.

    Attributes:
        matrix: (B, R, R) float32 connection matrices.
        seed_points: (B, R, 2) int64 cells.
    """

    matrix: Float32s
    seed_points: Ints


@dataclass
class Batch:
    """B problems, before any field is made of them.

    What only some fields need is found when it is first asked for.

    Attributes:
        movement: how paths move.
        search: "bfs" or "astar", which found the paths.
        grids: (B, H, W) uint8 occupancy.
        starts: (B, 2) int64.
        goals: (B, 2) int64.
        problems: (B,) int64, numbers in the dataset.
        find_rooms: gives connection matrices and seed points.
        wanted: names of the fields that will be asked for.
        max_length: how many cells ``path`` holds; None for what the batch needs.
        find_paths: gives the paths; None to search them.
    """

    movement: Movement
    search: str
    grids: Bytes
    starts: Ints
    goals: Ints
    problems: Ints
    find_rooms: Callable[[], Rooms]
    wanted: tuple[str, ...]
    max_length: int | None = None
    find_paths: Callable[[], Paths] | None = None

    __repr__ = summary

    @cached_property
    def paths(self) -> Paths:
        """The paths, read or searched."""
        if self.find_paths:
            return self.find_paths()
        search = SEARCHES[self.search]
        # where the robot has no room on the start or the goal, there is no path
        found = solve_batch(search, self.grids, self.starts, self.goals, self.movement, True)
        return Paths(found.cells, found.offsets, found.iterations)

    @cached_property
    def rooms(self) -> Rooms:
        """The rooms of the maps."""
        return self.find_rooms()

    @cached_property
    def costs(self) -> Floats:
        """(B,) cost of the paths, -1 without one; BFS counts moves."""
        straight, diagonal = count_steps(self.paths.cells, self.paths.offsets)
        step = 1.0 if self.search == "bfs" else self.movement.diagonal_cost
        return straight + diagonal * step

    @cached_property
    def goal_fields(self) -> GoalFields:
        """The fields that come from the search around the goal, empty if not asked for."""
        arrays = []
        for name in GoalFields._fields:
            count = len(self.grids) if name in self.wanted else 0
            dtype = np.uint8 if name.startswith("optimal") else np.float32
            arrays.append(np.empty((count, 1, *self.grids.shape[1:]), dtype))
        fields = GoalFields(*arrays)
        fill_goal_fields(self.grids, self.starts, self.goals, move_rule(self.movement), fields)
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
    """``path``: (B, T, 2) int64, cells from start to goal, padded with -1.

    T is a multiple of 16, or ``max_length``.
    """
    cells, offsets, _ = batch.paths
    longest = np.diff(offsets).max(initial=0)
    rows = rows_of_path(longest, batch.max_length)
    padded = np.empty((len(batch.grids), rows, 2), np.int64)
    pad_paths(cells, offsets, padded)
    return padded


def length(batch: Batch) -> Ints:
    """``length``: (B,) int64, number of cells of the path, 0 without one."""
    return np.diff(batch.paths.offsets)


def cost(batch: Batch) -> Float32s:
    """``cost``: (B,) float32, cost of the path in cells (BFS: moves), -1 without one."""
    return batch.costs.astype(np.float32)


def hardness(batch: Batch) -> Float32s:
    """``hardness``: (B,) float32, optimal cost over heuristic.

    1 when start = goal, -1 without a path.
    """
    best = batch.costs
    # BFS counts moves, which are not its costs
    if batch.search == "bfs" and batch.movement.connectivity == 8:
        best = replace(batch, search="astar", find_paths=None).costs
    return hardness_of(best, batch.starts, batch.goals, batch.movement).astype(np.float32)


def iterations(batch: Batch) -> Ints:
    """``iterations``: (B,) int64, cells that the search expanded."""
    return batch.paths.iterations


def path_mask(batch: Batch) -> Bytes:
    """``path_mask``: (B, 1, H, W) uint8, 1 on the cells of the path.

    Neural A*'s ``opt_trajs``, but with the goal.
    """
    cells, offsets, _ = batch.paths
    return mask_paths(cells, offsets, *batch.grids.shape[1:])[:, None]


def start_mask(batch: Batch) -> Bytes:
    """``start_mask``: (B, 1, H, W) uint8, 1 on the start."""
    return _points(batch.starts, batch.grids)


def goal_mask(batch: Batch) -> Bytes:
    """``goal_mask``: (B, 1, H, W) uint8, 1 on the goal."""
    return _points(batch.goals, batch.grids)


def optimal_mask(batch: Batch) -> Bytes:
    """``optimal_mask``: (B, 1, H, W) uint8, 1 on all cells of all shortest paths.

    0 everywhere without a path.
    """
    return batch.goal_fields.optimal_mask


def cost_to_go(batch: Batch) -> Float32s:
    """``cost_to_go``: (B, 1, H, W) float32, cost of the shortest path to the goal.

    In cells; -1 where the goal cannot be reached.
    """
    return batch.goal_fields.cost_to_go


def optimal_moves(batch: Batch) -> Bytes:
    """``optimal_moves``: (B, 1, H, W) uint8, the moves that start a shortest path.

    Bit k stands for move k.

    Move k is `mapdata.search.STEPS[k]`. 0 at the goal, in walls and where the goal cannot be
    reached.
    """
    return batch.goal_fields.optimal_moves


def heuristic_ratio(batch: Batch) -> Float32s:
    """``heuristic_ratio``: (B, 1, H, W) float32, heuristic over cost to go.

    1 at the goal, 0 where it cannot be reached.

    TransPath's correction factor "CF" (Kirilenko et al., AAAI 2023, https://arxiv.org/abs/2212.11730).
    """
    return batch.goal_fields.heuristic_ratio


def clearance(batch: Batch) -> Float32s:
    """``clearance``: (B, 1, H, W) float32, as `mapdata.clearance`, in cells."""
    return clearances(batch.grids)[:, None]


def path_probability(batch: Batch) -> Float32s:
    """``path_probability``: (B, 1, H, W) float32, how near a shortest path passes.

    L / (d(start, n) + d(n, goal) + d(n, path)) for the path's cost L, set to 0 below 0.95.

    TransPath's path probability map "PPM" (https://arxiv.org/abs/2212.11730); 0 everywhere without
    a path.
    """
    cells, offsets, _ = batch.paths
    return path_probabilities(
        batch.grids, batch.starts, batch.goals, cells, offsets, move_rule(batch.movement)
    )


def connection_matrix(batch: Batch) -> Float32s:
    """``connection_matrix``: (B, R, R) float32, costs between rooms.

    -1 no connection, -2 padding.
    """
    return batch.rooms.matrix


def seed_points(batch: Batch) -> Ints:
    """``seed_points``: (B, R, 2) int64, seed cells of the rooms, padded with -1."""
    return batch.rooms.seed_points


def problem(batch: Batch) -> Ints:
    """``problem``: (B,) int64, the problem's number in the dataset, filters and radius aside.

    Numbers count the problems that have a path under the stored movement, or with
    ``unsolvable=True`` all. They count all, too, where the served movement cuts corners and the
    stored one does not.
    """
    return batch.problems


Field = Callable[[Batch], Array]

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
        clearance,
        connection_matrix,
        seed_points,
        problem,
    )
}
"""All fields by name."""


def _points(cells: Ints, grids: Bytes) -> Bytes:
    mask = np.zeros((len(grids), 1, *grids.shape[1:]), np.uint8)
    mask[(np.arange(len(cells)), 0, *cells.T)] = 1
    return mask


def room_matrices(search: str, grids: Bytes, seed_points: Ints, movement: Movement) -> Float32s:
    """Return connection matrices (B, R, R) float32 between ``seed_points`` (B, R, 2).

    -1 no connection, -2 where a seed point is (-1, -1). "bfs" counts moves.
    """
    diagonals, step = move_rule(movement)
    return fill_room_matrices(grids, seed_points, (diagonals, UNIT if search == "bfs" else step))
