"""The classical planners, as rows to compare a new one with."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mapdata.arrays import Bytes, Ints
from mapdata.evaluation.metrics import BatchPlanner, Cell, Plan
from mapdata.jit import Int, kernel
from mapdata.search.api import search_batch
from mapdata.search.lattice import STEPS, UNIT, rule_of
from mapdata.spec import Movement

MAX_ESTIMATE = 2**20
"""Largest ``weight * (H + W)`` of `BestFirst`: f fits into 64 bits."""

_FAR, _CLOSED, _WALL = np.int64(2**62), -1, -2


def classical(movement: Movement = Movement(8)) -> list[BatchPlanner]:
    """Return the planners that every comparison should show, for one movement.

    "limit" expands only the cells of an optimal path: no planner that walks from start to goal can do with less.

    >>> [planner.name for planner in classical()]  # doctest: +NORMALIZE_WHITESPACE
    ['BFS', 'Dijkstra', 'A*', 'weighted A* (1.5)', 'weighted A* (2)', 'greedy best-first', 'limit']
    """
    return [
        Search("BFS", movement, "bfs"),
        BestFirst("Dijkstra", movement, weight=0),
        Search("A*", movement, "astar"),
        BestFirst("weighted A* (1.5)", movement, weight=1.5),
        BestFirst("weighted A* (2)", movement, weight=2),
        BestFirst("greedy best-first", movement, weight=1, counts_way=False),
        Limit("limit", movement),
    ]


class Batched:
    """A planner with `plan_batch`, which solves one problem as a batch of one."""

    def plan(self: BatchPlanner, grid: Bytes, start: Cell, goal: Cell) -> Plan:
        """Return the path from ``start`` to ``goal`` on ``grid``, (H, W)."""
        return self.plan_batch(np.asarray(grid)[None], np.array([start]), np.array([goal]))[0]


@dataclass(frozen=True)
class Search(Batched):
    """mapdata's own search: ``planner`` is "bfs" (fewest moves) or "astar"."""

    name: str
    movement: Movement
    planner: str

    def plan_batch(self, grids: Bytes, starts: Ints, goals: Ints) -> list[Plan]:
        """Return a plan for each problem: grids (B, H, W), starts and goals (B, 2)."""
        found = search_batch(self.planner, grids, starts, goals, self.movement)
        return _plans(found.cells, found.offsets, found.iterations)


@dataclass(frozen=True)
class Limit(Batched):
    """The path of mapdata's A*, with only its cells expanded: what perfect guidance would reach."""

    name: str
    movement: Movement

    def plan_batch(self, grids: Bytes, starts: Ints, goals: Ints) -> list[Plan]:
        """Return a plan for each problem: grids (B, H, W), starts and goals (B, 2)."""
        found = search_batch("astar", grids, starts, goals, self.movement)
        return _plans(found.cells, found.offsets, np.diff(found.offsets))


@dataclass(frozen=True)
class BestFirst(Batched):
    """Best-first search by f = g + weight * h, or f = weight * h alone.

    The order is that of mapdata's A* (docs/format.md) with another f: least f, among equal f the most recently pushed;
    a cell is pushed again for a smaller g, and expanded once. The cost is at most ``max(weight, 1)`` times the optimal
    one (Pohl 1970; without re-expansion: Likhachev et al. 2003), unless the way so far does not count.

    Attributes:
        name: its name in the table.
        movement: how one moves; h is Manhattan, octile or Chebyshev as it says.
        weight: 0 is Dijkstra's search, 1 is A*, more is weighted A*; from 0.
        counts_way: False leaves g out: greedy best-first search.
    """

    name: str
    movement: Movement
    weight: float
    counts_way: bool = True

    def __post_init__(self) -> None:
        """Refuse a weight that is no weight."""
        if not 0 <= self.weight < float("inf"):
            raise ValueError(f"weight: got {self.weight}, expected a number from 0")

    def plan_batch(self, grids: Bytes, starts: Ints, goals: Ints) -> list[Plan]:
        """Return a plan for each problem: grids (B, H, W), starts and goals (B, 2).

        Raises:
            ValueError: other shapes or values, a start or goal outside its grid or on an occupied cell, a grid so large
                that with this weight f does not fit into 64 bits (1024 x 1024 cells with a weight of 512 do).
        """
        grids = np.ascontiguousarray(grids, np.uint8)
        ends = np.ascontiguousarray(np.stack([starts, goals]), np.int64)
        if grids.ndim != 3 or ends.shape != (2, len(grids), 2) or grids.max(initial=0) > 1:
            raise ValueError(
                f"got grids of {grids.shape} and {ends.shape[1:]} starts, expected (B, H, W) of 0 and 1 and (B, 2)"
            )
        if (ends < 0).any() or (ends >= grids.shape[1:]).any():
            raise ValueError(f"a start or goal is outside its map of {grids.shape[1]} x {grids.shape[2]} cells")
        if grids[np.arange(len(grids)), ends[..., 0], ends[..., 1]].any():
            raise ValueError("a start or goal is on an occupied cell")
        if self.weight * sum(grids.shape[1:]) > MAX_ESTIMATE:
            raise ValueError(f"grids of {grids.shape[1]} x {grids.shape[2]} cells are too large for {self}")
        diagonals, step = rule_of(self.movement)
        way, weight = int(self.counts_way), float(self.weight)
        return _plans(*_best_first(grids, ends[0], ends[1], diagonals, step, way, weight))


def _plans(cells: Ints, offsets: Ints, expansions: Ints) -> list[Plan]:
    """Return plan k with the path ``cells[offsets[k]:offsets[k + 1]]``."""
    bounds = offsets.tolist()
    return [
        Plan(cells[begin:end], expanded)
        for begin, end, expanded in zip(bounds[:-1], bounds[1:], expansions.tolist(), strict=True)
    ]


@kernel
def _best_first(
    grids: npt.NDArray[np.uint8], starts: Ints, goals: Ints, diagonals: Int, step: Int, way: Int, weight: float
) -> tuple[Ints, Ints, Ints]:
    """Search each problem; return all paths one after another (M, 2), their offsets (B + 1,) and the cells taken (B,).

    f is ``way * g + weight * h``, in units of 1 / UNIT. A grid lies in a flat array with a wall around it, as in
    search.py. ``g`` holds _WALL, _FAR, then the cost of the way to a cell, and _CLOSED once that is taken.
    """
    count, rows, columns = grids.shape
    stride = columns + 2
    g, parent = np.full((rows + 2) * stride, _WALL), np.empty((rows + 2) * stride, np.int64)
    corner = step if diagonals else 2 * UNIT  # what a diagonal of the heuristic costs
    path, offsets, expanded = np.empty((1024, 2), np.int64), np.zeros(count + 1, np.int64), np.zeros(count, np.int64)
    for k in range(count):
        for row in range(rows):
            for column in range(columns):
                g[(row + 1) * stride + column + 1] = _WALL if grids[k, row, column] else _FAR
        start = (starts[k, 0] + 1) * stride + starts[k, 1] + 1
        goal = (goals[k, 0] + 1) * stride + goals[k, 1] + 1
        g[start], parent[start] = 0, start
        heap, pushes = [(np.int64(0), 0, start)], 0
        while heap:
            _, _, c = heapq.heappop(heap)
            cost = g[c]
            if cost == _CLOSED:
                continue
            g[c] = _CLOSED
            expanded[k] += 1
            if c == goal:
                break
            for move in range(8 if diagonals else 4):
                down, right = STEPS[move, 0] * stride, STEPS[move, 1]
                if move >= 4 and diagonals == 1 and (g[c + down] == _WALL or g[c + right] == _WALL):
                    continue
                to, longer = c + down + right, cost + (UNIT if move < 4 else step)
                if longer < g[to]:
                    g[to], parent[to] = longer, c
                    high, wide = abs(to // stride - goal // stride), abs(to % stride - goal % stride)
                    h = abs(high - wide) * UNIT + min(high, wide) * corner
                    pushes += 1
                    heapq.heappush(heap, (way * longer + np.int64(weight * h), -pushes, to))
        length = 0
        if g[goal] == _CLOSED:
            length, c = 1, goal
            while c != start:
                length, c = length + 1, parent[c]
        end = offsets[k] + length
        if end > len(path):
            larger = np.empty((2 * end, 2), np.int64)
            larger[: offsets[k]] = path[: offsets[k]]
            path = larger
        c = goal
        for at in range(end - 1, offsets[k] - 1, -1):
            path[at, 0], path[at, 1] = c // stride - 1, c % stride - 1
            c = parent[c]
        offsets[k + 1] = end
    return path[: offsets[count]], offsets, expanded
