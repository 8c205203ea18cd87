"""The classical planners, to compare a new planner with."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mapdata.arrays import Bytes, Ints
from mapdata.evaluation.metrics import BatchPlanner, Plan, Planner
from mapdata.limits import Cell
from mapdata.movement import NEURAL_ASTAR, STEPS, Movement
from mapdata.search.api import BatchResult, astar, search_batch, solve_batch

MAX_ESTIMATE = 2**20
"""Maximal ``weight * (H + W)`` of `BestFirst`, so that f fits into 64 bits."""


def classical(movement: Movement = Movement(8)) -> list[Planner]:
    """Return the planners that every comparison should show, for one movement.

    "limit" expands only the cells of an optimal path. No planner that searches from start to goal
    can do with fewer. If the movement is that of Neural A*, the A* of its repository is added.

    >>> [planner.name for planner in classical()]  # doctest: +NORMALIZE_WHITESPACE
    ['BFS', 'Dijkstra', 'A*', 'weighted A* (1.1)', 'weighted A* (1.25)', 'weighted A* (1.5)',
     'weighted A* (2)', 'weighted A* (3)', 'greedy best-first', 'limit']
    """
    planners: list[Planner] = [
        Search("BFS", movement, "bfs"),
        BestFirst("Dijkstra", movement, weight=0),
        Search("A*", movement, "astar"),
        *(BestFirst(f"weighted A* ({w})", movement, weight=w) for w in (1.1, 1.25, 1.5, 2, 3)),
        BestFirst("greedy best-first", movement, weight=1, uses_path_cost=False),
        Limit("limit", movement),
    ]
    if movement == NEURAL_ASTAR:
        planners.append(VanillaAstar())
    return planners


class Batched:
    """Base class of planners with `plan_batch`: it solves a single problem as a batch of one."""

    def plan(self: BatchPlanner, grid: ArrayLike, start: ArrayLike, goal: ArrayLike) -> Plan:
        """Return the path from ``start`` to ``goal`` on ``grid``, (H, W)."""
        return self.plan_batch(np.asarray(grid)[None], np.array([start]), np.array([goal]))[0]


@dataclass(frozen=True)
class Search(Batched):
    """mapdata's own search: ``search`` is "bfs" (fewest moves) or "astar"."""

    name: str
    movement: Movement
    search: str

    def plan_batch(self, grids: Bytes, starts: Ints, goals: Ints) -> list[Plan]:
        """Return a plan for each problem: grids (B, H, W), starts and goals (B, 2)."""
        return _plans(search_batch(self.search, grids, starts, goals, self.movement))


@dataclass(frozen=True)
class Limit(Batched):
    """The path of mapdata's A*, with only its cells expanded: what perfect guidance would reach."""

    name: str
    movement: Movement

    def plan_batch(self, grids: Bytes, starts: Ints, goals: Ints) -> list[Plan]:
        """Return a plan for each problem: grids (B, H, W), starts and goals (B, 2)."""
        paths = search_batch("astar", grids, starts, goals, self.movement)
        cells_per_path = np.diff(paths.offsets)
        return _plans(paths._replace(iterations=cells_per_path))


@dataclass(frozen=True)
class VanillaAstar:
    """The A* that Neural A* is compared with in its paper; its movement is ``NEURAL_ASTAR``.

    It expands the cell with the smallest g + h, where h is the Chebyshev distance plus a thousandth
    of the Euclidean distance; among equal cells the first in reading order.

    Source: VanillaAstar of https://github.com/omron-sinicx/neural-astar, in floats of 64 bits.
    """

    name: str = "A* of Neural A*"

    def plan(self, grid: Bytes, start: Cell, goal: Cell) -> Plan:
        """Return the path from ``start`` to ``goal`` on ``grid``, (H, W)."""
        free_cells = set(map(tuple, np.argwhere(np.asarray(grid) == 0).tolist()))
        cost_from_start = {start: 0}
        expanded = set[Cell]()
        heap = [(0.0, start)]
        while heap and goal not in expanded:
            _, cell = heapq.heappop(heap)
            expanded.add(cell)
            for row_step, column_step in STEPS.tolist():
                neighbour = (cell[0] + row_step, cell[1] + column_step)
                g = cost_from_start[cell] + 1
                if neighbour in free_cells and g < cost_from_start.get(neighbour, math.inf):
                    cost_from_start[neighbour] = g
                    rows = abs(neighbour[0] - goal[0])
                    columns = abs(neighbour[1] - goal[1])
                    f = g + max(rows, columns) + 0.001 * math.hypot(rows, columns)
                    heapq.heappush(heap, (f, neighbour))
        return Plan(astar(grid, start, goal, NEURAL_ASTAR).path, len(expanded))


@dataclass(frozen=True)
class BestFirst(Batched):
    """Best-first search by f = g + weight * h, or f = weight * h alone.

    The order is that of mapdata's A* (docs/format.md) with another f: the smallest f first, and
    among equal f the most recently pushed cell. A cell is pushed again when a smaller g is found,
    but expanded once. A smaller g that is found after its expansion still changes the cell's
    parent, which makes the path shorter.

    The cost is at most ``max(weight, 1)`` times the optimal cost (Pohl 1970; without re-expansion:
    Likhachev et al. 2003). There is no such bound without g.

    Attributes:
        name: its name in the table.
        movement: the allowed moves, which decide whether h is the Manhattan, octile or Chebyshev
            distance.
        weight: at least 0; 0 is Dijkstra's search, 1 is A*, above 1 is weighted A*.
        uses_path_cost: whether g, the cost from the start, is part of f; False is greedy
            best-first search.
    """

    name: str
    movement: Movement
    weight: float
    uses_path_cost: bool = True

    def __post_init__(self) -> None:
        """Check the weight.

        Raises:
            ValueError: it is negative, infinite or NaN.
        """
        if not 0 <= self.weight < math.inf:
            raise ValueError(f"weight: got {self.weight}, expected a number from 0")

    def plan_batch(self, grids: Bytes, starts: Ints, goals: Ints) -> list[Plan]:
        """Return a plan for each problem: grids (B, H, W), starts and goals (B, 2).

        Raises:
            ValueError: what `search_batch` refuses; a grid so large that with this weight f does
                not fit into 64 bits (it does for 1024 x 1024 cells with a weight of 512).
        """
        rows_and_columns = np.shape(grids)[1:]
        if self.weight * sum(rows_and_columns) > MAX_ESTIMATE:
            raise ValueError(f"grids of shape {np.shape(grids)} are too large for {self}")
        weights_of_g_and_h = (int(self.uses_path_cost), float(self.weight))
        return _plans(solve_batch(weights_of_g_and_h, grids, starts, goals, self.movement))


def _plans(paths: BatchResult) -> list[Plan]:
    """Return the paths of a batch of searches, each as a plan."""
    return [
        Plan(paths.cells[paths.offsets[k] : paths.offsets[k + 1]], expansions)
        for k, expansions in enumerate(paths.iterations.tolist())
    ]
