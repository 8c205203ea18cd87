"""Planners that follow predicted moves, a walk and a best-first search: rows of `evaluate`."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np

from mapdata.arrays import Bytes, Float32s, Floats, Ints
from mapdata.evaluation import Batched, BatchPlanner, Plan
from mapdata.jit import Int, kernel
from mapdata.search import (
    WALL,
    Lattice,
    Rule,
    cell_at,
    count_moves,
    heuristic,
    in_cells,
    is_legal,
    lattice_of,
    load,
    position,
    rule_of,
    search_batch,
    write_cells,
)
from models.common import check_problems
from models.path_predictor import PathPredictor


def planners(model: PathPredictor) -> list[BatchPlanner]:
    """Return the planners of a model, as rows for `mapdata.evaluate`."""
    return [
        LearnedPlanner("path_predictor (walk)", model, fallback=False),
        LearnedPlanner("path_predictor (walk, else A*)", model),
        GuidedSearch("path_predictor (search)", model),
    ]


@dataclass(frozen=True, eq=False)
class LearnedPlanner(Batched):
    """Follows the most probable legal move to a cell not yet visited, until the goal.

    Every cell of the walk is one expansion, as in a search: its neighbours are looked at, and take
    it as their parent where that is a shorter way. The path is that of the parents.

    Attributes:
        name: its name in the table.
        model: what predicts the moves.
        fallback: where a walk ends in a cell without unvisited neighbours, mapdata's A* begins anew
            from the start, and its expansions add to those of the walk; False gives up.
    """

    name: str
    model: PathPredictor
    fallback: bool = True

    def plan_batch(self, grids: Bytes, starts: Ints, goals: Ints) -> list[Plan]:
        """Return a plan for each problem: grids (B, H, W), starts and goals (B, 2).

        Raises:
            ValueError: a start or goal outside its map or on an occupied cell.
        """
        grids, starts, goals = check_problems(grids, starts, goals)
        scores, _ = self.model.predict(grids, goals)
        movement = self.model.movement
        rule = rule_of(movement)
        plans = []
        for each in zip(grids, scores, starts, goals, strict=True):
            plans.append(Plan(*_walk(*each, rule)))
        stuck = [k for k, plan in enumerate(plans) if len(plan.path) == 0]
        if stuck and self.fallback:
            found = search_batch("astar", grids[stuck], starts[stuck], goals[stuck], movement)
            for n, k in enumerate(stuck):
                path = found.cells[found.offsets[n] : found.offsets[n + 1]]
                plans[k] = Plan(path, plans[k].expansions + int(found.iterations[n]))
        return plans


@dataclass(frozen=True, eq=False)
class GuidedSearch(Batched):
    """Best-first search by the cost so far, the predicted cost to go, and improbable moves.

    f = g + ``trust`` * (sum over the moves of log P(best move) - log P(move)) + h / ratio. A cell
    is expanded once; it finds a path where there is one, and needs no fallback. A cell that is
    looked at again takes the shorter way as its own, and the path is that of the parents.

    Attributes:
        name: its name in the table.
        model: what predicts moves and ratios.
        trust: cells that a factor e of probability is worth.
    """

    name: str
    model: PathPredictor
    trust: float = 2.0

    def plan_batch(self, grids: Bytes, starts: Ints, goals: Ints) -> list[Plan]:
        """Return a plan for each problem, as `LearnedPlanner.plan_batch` does."""
        grids, starts, goals = check_problems(grids, starts, goals)
        scores, ratios = self.model.predict(grids, goals)
        rule = rule_of(self.model.movement)
        plans = []
        for each in zip(grids, scores, ratios, starts, goals, strict=True):
            plans.append(Plan(*_search(*each, rule, self.trust)))
        return plans


@kernel
def _search(
    grid: Bytes,
    scores: Float32s,
    ratios: Float32s,
    start: Ints,
    goal: Ints,
    rule: Rule,
    trust: float,
) -> tuple[Ints, Int]:
    """Return the path (k, 2) of one problem, and how many cells were expanded."""
    lattice, came, way = _begin(grid, start, rule)
    first = cell_at(start[0], start[1], lattice)
    last = cell_at(goal[0], goal[1], lattice)
    # the cost of the best way so far and of its improbable moves; -inf once a cell is expanded
    best = way.copy()
    heap = [(0.0, 0, first)]
    pushes = 0
    expansions = 0
    while heap:
        _, _, cell = heapq.heappop(heap)
        so_far = best[cell]
        if so_far == -np.inf:
            continue
        best[cell] = -np.inf
        expansions += 1
        if cell == last:
            break
        row, column = position(cell, lattice)
        top = -np.inf
        for move in range(len(lattice.offsets)):
            if is_legal(came, cell, move, lattice):
                top = max(top, scores[move, row, column])
        for move in range(len(lattice.offsets)):
            if not is_legal(came, cell, move, lattice):
                continue
            to = cell + lattice.offsets[move]
            step = _rewire(came, way, cell, move, lattice)
            cost = so_far + step + trust * (top - scores[move, row, column])
            if cost < best[to]:
                best[to] = cost
                i, j = position(to, lattice)
                least = in_cells(heuristic(i - goal[0], j - goal[1], lattice))
                pushes += 1
                to_go = least / max(ratios[i, j], 0.05)  # a ratio near 0 would say nothing
                f = cost + to_go - 0.001 * way[to]  # among equals the farthest first
                heapq.heappush(heap, (f, -pushes, to))
    return _path(came, first, last, lattice), expansions


@kernel
def _walk(grid: Bytes, scores: Float32s, start: Ints, goal: Ints, rule: Rule) -> tuple[Ints, Int]:
    """Return the path (k, 2), (0, 2) where the walk gets stuck, and how many cells it expanded."""
    lattice, came, way = _begin(grid, start, rule)
    first = cell_at(start[0], start[1], lattice)
    last = cell_at(goal[0], goal[1], lattice)
    expanded = np.zeros(lattice.cells, np.bool_)
    cell = first
    expansions = 0
    while True:
        expanded[cell] = True
        expansions += 1
        if cell == last:
            return _path(came, first, last, lattice), expansions
        row, column = position(cell, lattice)
        most_probable = -1
        best = np.float32(-np.inf)
        for move in range(len(lattice.offsets)):
            if not is_legal(came, cell, move, lattice):
                continue
            to = cell + lattice.offsets[move]
            _rewire(came, way, cell, move, lattice)
            if not expanded[to] and scores[move, row, column] > best:
                most_probable = to
                best = scores[move, row, column]
        if most_probable < 0:
            return np.empty((0, 2), np.int64), expansions
        cell = most_probable


@kernel
def _begin(grid: Bytes, start: Ints, rule: Rule) -> tuple[Lattice, Bytes, Floats]:
    """Return the lattice and, of its cells, the moves that led there and the costs of the ways.

    No cell but the start is reached: the others have the code WALL or UNSEEN, and the cost inf.
    """
    lattice = lattice_of(grid.shape, rule)
    came = np.full(lattice.cells, WALL)
    load(grid, came)
    way = np.full(lattice.cells, np.inf)
    first = cell_at(start[0], start[1], lattice)
    came[first] = 0  # any move: a path is traced back only as far as its start
    way[first] = 0.0
    return lattice, came, way


@kernel
def _rewire(came: Bytes, way: Floats, cell: Int, move: Int, lattice: Lattice) -> float:
    """Let a move from ``cell`` lead to its end if that is a shorter way; return the move's cost.

    A cell that was expanded already takes the shorter way, too, without being expanded again, as in
    the classical planners. Ways only become shorter, and a cell's is longer than its parent's, so
    parents never go round in a circle.
    """
    to = cell + lattice.offsets[move]
    step: float = 1.0 if move < 4 else in_cells(lattice.step)
    if way[cell] + step < way[to]:
        way[to] = way[cell] + step
        came[to] = move
    return step


@kernel
def _path(came: Bytes, start: Int, goal: Int, lattice: Lattice) -> Ints:
    """Return the way from ``start`` to ``goal``, (k, 2) cells; (0, 2) if none is known."""
    straight, diagonal = count_moves(came, start, goal, lattice)  # -1 and 0 if none is known
    path = np.empty((straight + diagonal + 1, 2), np.int64)
    write_cells(came, goal, lattice, path)
    return path
