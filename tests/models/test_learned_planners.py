"""The search that follows predictions: that of a slow one in Python, whatever is predicted."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers.reference import Cell, neighbours

from mapdata import Forest, Movement, ProblemSet, check_path
from mapdata.arrays import Bytes, Float32s, Ints
from mapdata.search import STEPS
from models.learned_planners import GuidedSearch

MOVEMENTS = [
    Movement(),
    Movement(8),
    Movement(8, corner_cutting=True),
    Movement(8, diagonal_cost=1),
]


@dataclass
class Answers:
    """A predictor that gives the same answers to all problems."""

    movement: Movement
    scores: Float32s
    costs: Float32s

    def predict(self, grids: Bytes, goals: Ints) -> tuple[Float32s, Float32s]:
        """Return the answers."""
        return self.scores, self.costs


def answers(problems: ProblemSet, seed: int) -> Answers:
    """Return random answers to all problems."""
    source = np.random.default_rng(seed)
    moves = problems.movement.connectivity
    count, rows, columns = problems.grids.shape
    scores = source.normal(0, 2, (count, moves, rows, columns)).astype(np.float32)
    costs = source.uniform(0, 30, (count, rows, columns)).astype(np.float32)
    return Answers(problems.movement, scores, costs)


def searched_by_the_book(
    grid: Bytes,
    scores: Float32s,
    costs: Float32s,
    start: Cell,
    goal: Cell,
    movement: Movement,
    trust: float,
) -> tuple[list[Cell], int]:
    """Return the path and the number of expansions, as the docstring of `GuidedSearch` says."""
    moves = [tuple(move) for move in STEPS[: movement.connectivity].tolist()]
    parent: dict[Cell, Cell] = {}
    way = {start: 0.0}  # of the path by parents
    cost = {start: 0.0}  # of the way and its improbable moves
    frontier = [(0.0, 0, start)]
    expanded: set[Cell] = set()
    pushes = 0
    while goal not in expanded:
        cell = heapq.heappop(frontier)[2]
        if cell in expanded:
            continue
        expanded.add(cell)
        legal = []
        for to, step in neighbours(grid.tolist(), cell, movement):
            move = moves.index((to[0] - cell[0], to[1] - cell[1]))
            length = movement.diagonal_cost if step[1] else 1.0
            legal.append((to, length, float(scores[move, cell[0], cell[1]])))
        best = max(score for _, _, score in legal)
        for to, length, score in legal:
            if way[cell] + length < way.get(to, math.inf):
                way[to] = way[cell] + length
                parent[to] = cell
            odds = math.exp(min(best - score, 10))
            so_far = cost[cell] + length + trust * (odds**2 - 1)
            if to not in expanded and so_far < cost.get(to, math.inf):
                cost[to] = so_far
                pushes += 1
                f = so_far + float(costs[to]) - 0.001 * way[to]
                heapq.heappush(frontier, (f, -pushes, to))
    path = [goal]
    while path[-1] != start:
        path.append(parent[path[-1]])
    return path[::-1], len(expanded)


@pytest.mark.parametrize("all_tie", [False, True])
@pytest.mark.parametrize("trust", [0.0, 0.4, 5.0])
@pytest.mark.parametrize("movement", MOVEMENTS)
def test_the_search_is_the_slow_one(movement: Movement, trust: float, all_tie: bool) -> None:
    """The same path and as many expansions, for random answers and for those that decide nothing,
    where the order among equals is all.
    """
    problems = ProblemSet.sample(Forest((12, 14)), 1, 30, movement=movement)
    model = answers(problems, 2)
    if all_tie:
        model.scores.fill(0)
        model.costs.fill(1)
    plans = GuidedSearch("search", model, trust).plan_batch(
        problems.grids, problems.starts, problems.goals
    )
    for k, plan in enumerate(plans):
        start = tuple(problems.starts[k].tolist())
        goal = tuple(problems.goals[k].tolist())
        given = problems.grids[k], model.scores[k], model.costs[k], start, goal, movement
        # trust is what a move costs on 64 x 64 cells; these maps have 12 x 14, a mean side of 13
        path, expansions = searched_by_the_book(*given, trust * 64 / 13)
        assert plan.path.tolist() == [list(cell) for cell in path]
        assert plan.expansions == expansions


@pytest.mark.parametrize("cut", [(1, 8, 12, 14), (5, 4, 12, 14), (5, 8, 11, 14), (5, 8, 12, 1)])
def test_predictions_of_another_shape_are_refused(cut: tuple[int, ...]) -> None:
    """Compiled code would read past their end."""
    problems = ProblemSet.sample(Forest((12, 14)), 1, 5)
    model = answers(problems, 3)
    count, moves, rows, columns = cut
    asked = problems.grids, problems.starts, problems.goals
    wrong = replace(model, scores=model.scores[:count, :moves, :rows, :columns])
    with pytest.raises(ValueError, match=r"predict gave shapes .* expected .*5, 8, 12, 14"):
        GuidedSearch("search", wrong).plan_batch(*asked)
    wrong = replace(model, costs=model.costs[:, 1:])
    with pytest.raises(ValueError, match="search: predict gave shapes"):
        GuidedSearch("search", wrong).plan_batch(*asked)


@pytest.mark.parametrize("share", [0.3, 1.0])
@pytest.mark.parametrize("value", [-np.inf, np.inf, np.nan])
def test_there_is_a_path_whatever_is_predicted(value: float, share: float) -> None:
    """Some or all scores, and as many costs, are no finite numbers."""
    problems = ProblemSet.sample(Forest((12, 14)), 1, 100)
    model = answers(problems, 3)
    source = np.random.default_rng(4)
    for array in (model.scores, model.costs):
        array[source.random(array.shape) < share] = value
    for trust in (0.4, math.inf):
        plans = GuidedSearch("search", model, trust).plan_batch(
            problems.grids, problems.starts, problems.goals
        )
        for k, plan in enumerate(plans):
            check_path(problems.grids[k], plan.path, problems.movement)
            assert plan.path[0].tolist() == problems.starts[k].tolist()
            assert plan.path[-1].tolist() == problems.goals[k].tolist()
