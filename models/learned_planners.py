"""Planners that follow predicted moves: a walk, and a best-first search; rows for `mapdata.evaluate`."""

from __future__ import annotations

import heapq
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from mapdata.arrays import Bytes, Float32s, Ints
from mapdata.evaluation import Batched, BatchPlanner, Plan
from mapdata.jit import Int, kernel
from mapdata.search import STEPS, search_batch
from mapdata.spec import Movement


class Predictor(Protocol):
    """What predicts moves, such as `path_predictor.PathPredictor`."""

    movement: Movement

    def predict(self, grids: Bytes, goals: Ints) -> tuple[Float32s, Float32s]:
        """Return log probabilities (B, moves, H, W), up to a constant a cell, and heuristic ratios (B, H, W).

        Args:
            grids: (B, H, W), 0 free and 1 occupied.
            goals: (B, 2), cells.
        """


def planners(model: Predictor) -> list[BatchPlanner]:
    """Return the planners of a model, as rows for `mapdata.evaluate`."""
    return [
        LearnedPlanner("path_predictor (walk)", model, fallback=False),
        LearnedPlanner("path_predictor (walk, else A*)", model),
        GuidedSearch("path_predictor (search)", model),
    ]


@dataclass(frozen=True, eq=False)
class _Follower(Batched, ABC):
    """What follows a model: predicts a batch, then plans each of its problems.

    Attributes:
        name: its name in the table.
        model: what predicts the moves.
    """

    name: str
    model: Predictor

    def plan_batch(self, grids: Bytes, starts: Ints, goals: Ints) -> list[Plan]:
        """Return a plan for each problem: grids (B, H, W), starts and goals (B, 2).

        Raises:
            ValueError: a start or goal outside its map or on an occupied cell.
        """
        grids, starts, goals = _problems(grids, starts, goals)
        scores, ratios = self.model.predict(grids, goals)
        plans = [self._follow(*each) for each in zip(grids, scores, ratios, starts, goals, strict=True)]
        return self._mended(plans, grids, starts, goals)

    @abstractmethod
    def _follow(self, grid: Bytes, scores: Float32s, ratios: Float32s, start: Ints, goal: Ints) -> Plan:
        """Return the plan for one problem, with an empty path where there is none."""

    def _mended(self, plans: list[Plan], grids: Bytes, starts: Ints, goals: Ints) -> list[Plan]:
        """Return the plans, those without a path replaced where the planner has another way."""
        return plans

    @property
    def _rule(self) -> tuple[int, float]:
        """How one moves, as the kernels want it."""
        return int(self.model.movement.corner_cutting), self.model.movement.diagonal_cost


@dataclass(frozen=True, eq=False)
class LearnedPlanner(_Follower):
    """Follows the most probable legal move to a cell not yet visited, until the goal.

    Every cell of the walk is one expansion: each is taken once, and its neighbours are looked at, as in a search. The
    path is the shortest one over the moves that were looked at.

    Attributes:
        fallback: where a walk ends in a cell without unvisited neighbours, mapdata's A* begins anew from the start, and
            its expansions add to those of the walk; False gives up.
    """

    fallback: bool = True

    def _follow(self, grid: Bytes, scores: Float32s, ratios: Float32s, start: Ints, goal: Ints) -> Plan:
        return Plan(*_walk(grid, scores, start, goal, *self._rule))

    def _mended(self, plans: list[Plan], grids: Bytes, starts: Ints, goals: Ints) -> list[Plan]:
        stuck = [k for k, plan in enumerate(plans) if len(plan.path) == 0]
        if stuck and self.fallback:
            found = search_batch("astar", grids[stuck], starts[stuck], goals[stuck], self.model.movement)
            for n, k in enumerate(stuck):
                path = found.cells[found.offsets[n] : found.offsets[n + 1]]
                plans[k] = Plan(path, plans[k].expansions + int(found.iterations[n]))
        return plans


@dataclass(frozen=True, eq=False)
class GuidedSearch(_Follower):
    """Best-first search by the cost so far, the predicted cost to go, and how improbable the moves so far were.

    f = g + ``trust`` * (sum over the moves of log P(best move) - log P(move)) + h / ratio. A cell is expanded once; it
    finds a path where there is one, and needs no fallback. The path is the shortest one over the moves that were looked
    at.

    Attributes:
        trust: cells that a factor e of probability is worth.
    """

    trust: float = 2.0

    def _follow(self, grid: Bytes, scores: Float32s, ratios: Float32s, start: Ints, goal: Ints) -> Plan:
        return Plan(*_search(grid, scores, ratios, start, goal, *self._rule, self.trust))


def _problems(grids: Bytes, starts: Ints, goals: Ints) -> tuple[Bytes, Ints, Ints]:
    """Return the problems as the kernels want them.

    Raises:
        ValueError: a start or goal outside its map or on an occupied cell.
    """
    grids = np.array(grids, np.uint8)
    starts, goals = np.array(starts, np.int64), np.array(goals, np.int64)
    for ends in (starts, goals):
        outside = (ends < 0).any() or (ends >= grids.shape[1:]).any()
        if outside or grids[np.arange(len(grids)), ends[:, 0], ends[:, 1]].any():
            raise ValueError("a start or goal is outside its map or on an occupied cell")
    return grids, starts, goals


@kernel
def _search(
    grid: Bytes,
    scores: Float32s,
    ratios: Float32s,
    start: Ints,
    goal: Ints,
    corners: Int,
    diagonal: float,
    trust: float,
) -> tuple[Ints, Int]:
    """Return the path (k, 2) of one problem, and how many cells were expanded."""
    moves, rows, columns = scores.shape
    best = np.full((rows, columns), np.inf)  # g and what the improbable moves cost; -inf once a cell is expanded
    way = np.zeros((rows, columns))
    best[start[0], start[1]] = 0.0
    heap, pushes, expansions = [(0.0, 0, start[0] * columns + start[1])], 0, 0
    while heap:
        _, _, cell = heapq.heappop(heap)
        row, column = cell // columns, cell % columns
        so_far = best[row, column]
        if so_far == -np.inf:
            continue
        best[row, column] = -np.inf
        expansions += 1
        if row == goal[0] and column == goal[1]:
            break
        top, legal = -np.inf, 0
        for k in range(moves):
            i, j = row + STEPS[k, 0], column + STEPS[k, 1]
            if i < 0 or j < 0 or i >= rows or j >= columns or grid[i, j]:
                continue
            if k >= 4 and not corners and (grid[i, column] or grid[row, j]):
                continue
            legal |= 1 << k
            top = max(top, scores[k, row, column])
        for k in range(moves):
            i, j = row + STEPS[k, 0], column + STEPS[k, 1]
            if not legal >> k & 1 or best[i, j] == -np.inf:
                continue
            step = 1.0 if k < 4 else diagonal
            cost = so_far + step + trust * (top - scores[k, row, column])
            if cost < best[i, j]:
                best[i, j], way[i, j] = cost, way[row, column] + step
                high, wide = abs(i - goal[0]), abs(j - goal[1])
                least = max(high, wide) + (diagonal - 1) * min(high, wide) if moves == 8 else high + wide
                pushes += 1
                f = cost + least / max(ratios[i, j], 0.05) - 0.001 * way[i, j]  # among equals the farthest
                heapq.heappush(heap, (f, -pushes, i * columns + j))
    return _through(grid, best == -np.inf, start, goal, moves, corners, diagonal), expansions


@kernel
def _through(
    grid: Bytes, expanded: npt.NDArray[np.bool_], start: Ints, goal: Ints, moves: Int, corners: Int, diagonal: float
) -> Ints:
    """Return the shortest path over all moves that a search has looked at, (k, 2); (0, 2) where there is none.

    Those are the moves from and to expanded cells. Among them there may be a shorter path than the one that the
    search came by. Dijkstra's algorithm.
    """
    rows, columns = grid.shape
    costs, came = np.full((rows, columns), np.inf), np.full((rows, columns), -1)
    costs[start[0], start[1]] = 0.0
    heap = [(0.0, start[0] * columns + start[1])]
    while heap:
        cost, cell = heapq.heappop(heap)
        row, column = cell // columns, cell % columns
        if row == goal[0] and column == goal[1]:
            break
        if cost > costs[row, column]:
            continue
        for k in range(moves):
            i, j = row + STEPS[k, 0], column + STEPS[k, 1]
            if i < 0 or j < 0 or i >= rows or j >= columns or grid[i, j]:
                continue
            if not (expanded[row, column] or expanded[i, j]):
                continue
            if k >= 4 and not corners and (grid[i, column] or grid[row, j]):
                continue
            longer = cost + (1.0 if k < 4 else diagonal)
            if longer < costs[i, j] - 1e-9:
                costs[i, j], came[i, j] = longer, k
                heapq.heappush(heap, (longer, i * columns + j))
    path = np.empty((rows * columns, 2), np.int64)
    at, row, column = len(path), goal[0], goal[1]
    while costs[row, column] < np.inf:
        at -= 1
        path[at, 0], path[at, 1] = row, column
        k = came[row, column]
        if k < 0:
            break
        row, column = row - STEPS[k, 0], column - STEPS[k, 1]
    return path[at:].copy()


@kernel
def _walk(grid: Bytes, scores: Float32s, start: Ints, goal: Ints, corners: Int, diagonal: float) -> tuple[Ints, Int]:
    """Return the path (k, 2) of one problem, (0, 2) where the walk gets stuck, and how many cells were expanded."""
    moves, rows, columns = scores.shape
    expanded = np.zeros((rows, columns), np.bool_)
    row, column, move, expansions = start[0], start[1], 0, 0
    while move >= 0:
        expanded[row, column] = True
        expansions += 1
        move, best = -1, np.float32(-np.inf)
        if row == goal[0] and column == goal[1]:
            break
        for k in range(moves):
            i, j = row + STEPS[k, 0], column + STEPS[k, 1]
            if i < 0 or j < 0 or i >= rows or j >= columns or grid[i, j] or expanded[i, j]:
                continue
            if k >= 4 and not corners and (grid[i, column] or grid[row, j]):
                continue
            if scores[k, row, column] > best:
                move, best = k, scores[k, row, column]
        if move >= 0:
            row, column = row + STEPS[move, 0], column + STEPS[move, 1]
    return _through(grid, expanded, start, goal, moves, corners, diagonal), expansions
