"""The classical planners, as rows to compare a new one with."""

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
"""Largest ``weight * (H + W)`` of `BestFirst`: f fits into 64 bits."""


def classical(movement: Movement = Movement(8)) -> list[Planner]:
    """Return the planners that every comparison should show, for one movement.

    "limit" expands only the cells of an optimal path: no planner that walks from start to goal can
    do with less. Where one moves as Neural A* does, the A* that it is compared with is there, too.

    >>> [planner.name for planner in classical()]  # doctest: +NORMALIZE_WHITESPACE
    ['BFS', 'Dijkstra', 'A*', 'weighted A* (1.1)', 'weighted A* (1.25)', 'weighted A* (1.5)',
     'weighted A* (2)', 'weighted A* (3)', 'greedy best-first', 'limit']
    """
    planners: list[Planner] = [
        Search("BFS", movement, "bfs"),
        BestFirst("Dijkstra", movement, weight=0),
        Search("A*", movement, "astar"),
        *(BestFirst(f"weighted A* ({w})", movement, weight=w) for w in (1.1, 1.25, 1.5, 2, 3)),
        BestFirst("greedy best-first", movement, weight=1, counts_way=False),
        Limit("limit", movement),
    ]
    if movement == NEURAL_ASTAR:
        planners.append(VanillaAstar())
    return planners


class Batched:
    """A planner with `plan_batch`, which solves one problem as a batch of one."""

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
        found = search_batch("astar", grids, starts, goals, self.movement)
        return _plans(found._replace(iterations=np.diff(found.offsets)))


@dataclass(frozen=True)
class VanillaAstar:
    """The A* whose expansions Neural A* counts as 1; it moves as ``NEURAL_ASTAR`` says.

    It expands the cell of the least g + h, where h is the Chebyshev distance and a thousandth of
    the Euclidean one; among equals the first in reading order.

    Source: VanillaAstar of https://github.com/omron-sinicx/neural-astar, in floats of 64 bits.
    """

    name: str = "A* of Neural A*"

    def plan(self, grid: Bytes, start: Cell, goal: Cell) -> Plan:
        """Return the path from ``start`` to ``goal`` on ``grid``, (H, W)."""
        free = set(map(tuple, np.argwhere(np.asarray(grid) == 0).tolist()))
        way = {start: 0}
        expanded = set[Cell]()
        heap = [(0.0, start)]
        while heap and goal not in expanded:
            _, cell = heapq.heappop(heap)
            expanded.add(cell)
            for row, column in STEPS.tolist():
                to = (cell[0] + row, cell[1] + column)
                g = way[cell] + 1
                if to in free and g < way.get(to, math.inf):
                    way[to] = g
                    down = abs(to[0] - goal[0])
                    right = abs(to[1] - goal[1])
                    f = g + max(down, right) + 0.001 * math.hypot(down, right)
                    heapq.heappush(heap, (f, to))
        return Plan(astar(grid, start, goal, NEURAL_ASTAR).path, len(expanded))


@dataclass(frozen=True)
class BestFirst(Batched):
    """Best-first search by f = g + weight * h, or f = weight * h alone.

    The order is that of mapdata's A* (docs/format.md) with another f: least f, among equal f the
    most recently pushed. A cell is pushed again for a smaller g, and expanded once; a smaller g
    that is found later still gives it another parent, and so the path is shorter.

    The cost is at most ``max(weight, 1)`` times the optimal one (Pohl 1970; without re-expansion:
    Likhachev et al. 2003), unless the way so far does not count.

    Attributes:
        name: its name in the table.
        movement: how one moves; h is Manhattan, octile or Chebyshev as it says.
        weight: 0 is Dijkstra's search, 1 is A*, more is weighted A*; from 0.
        counts_way: False leaves g, the cost of the way so far, out: greedy best-first search.
    """

    name: str
    movement: Movement
    weight: float
    counts_way: bool = True

    def __post_init__(self) -> None:
        """Refuse a weight that is no weight."""
        if not 0 <= self.weight < math.inf:
            raise ValueError(f"weight: got {self.weight}, expected a number from 0")

    def plan_batch(self, grids: Bytes, starts: Ints, goals: Ints) -> list[Plan]:
        """Return a plan for each problem: grids (B, H, W), starts and goals (B, 2).

        Raises:
            ValueError: what `search_batch` refuses; a grid so large that with this weight f does
                not fit into 64 bits (1024 x 1024 cells with a weight of 512 do).
        """
        if self.weight * sum(np.shape(grids)[1:]) > MAX_ESTIMATE:
            raise ValueError(f"grids of shape {np.shape(grids)} are too large for {self}")
        weights = (int(self.counts_way), float(self.weight))
        return _plans(solve_batch(weights, grids, starts, goals, self.movement))


def _plans(found: BatchResult) -> list[Plan]:
    """Return what a batch of searches found, a plan for each."""
    return [
        Plan(found.cells[found.offsets[k] : found.offsets[k + 1]], count)
        for k, count in enumerate(found.iterations.tolist())
    ]
