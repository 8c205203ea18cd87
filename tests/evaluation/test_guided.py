"""The planners that follow predictions: each equals a slow search, whatever is predicted."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch
from helpers.grids import scipy_distances
from helpers.reference import Cell, neighbours

from mapdata import Forest, Movement, ProblemSet, Terrain, check_path, evaluate
from mapdata.arrays import Bytes, Float32s, Floats, Ints
from mapdata.evaluation import CostPlanner, GuidedSearch, classical, prior
from mapdata.search import STEPS

MOVEMENTS = [
    Movement(),
    Movement(8),
    Movement(8, corner_cutting=True),
    Movement(8, diagonal_cost=1),
]


@dataclass
class FixedPredictor:
    """A predictor with fixed predictions, which do not depend on the problems."""

    movement: Movement
    scores: Float32s
    costs: Float32s

    def __call__(
        self, grids: Bytes, goals: Ints, terrain: Bytes | None = None
    ) -> tuple[Float32s, Float32s]:
        """Return the predictions."""
        return self.scores, self.costs


def search_by(
    predictor: FixedPredictor, trust: float = 0.15, takes_terrain: bool = True
) -> GuidedSearch:
    """Return the search by fixed predictions."""
    return GuidedSearch("search", predictor.movement, predictor, trust, takes_terrain)


def random_predictor(problems: ProblemSet, seed: int) -> FixedPredictor:
    """Return a predictor with random predictions for these problems."""
    rng = np.random.default_rng(seed)
    moves = problems.movement.connectivity
    count, rows, columns = problems.grids.shape
    scores = rng.normal(0, 2, (count, moves, rows, columns)).astype(np.float32)
    costs = rng.uniform(0, 30, (count, rows, columns)).astype(np.float32)
    return FixedPredictor(problems.movement, scores, costs)


def slow_search(
    grid: Bytes,
    scores: Float32s,
    costs: Float32s,
    start: Cell,
    goal: Cell,
    movement: Movement,
    trust: float,
    terrain: Bytes | None = None,
) -> tuple[list[Cell], list[Cell]]:
    """Return path and expanded cells by the formulas in the docstring of `GuidedSearch`.

    Here ``trust`` is the penalty of a move whose odds squared are 2 on this map.
    """
    cell_costs = (np.ones_like(grid) if terrain is None else terrain).tolist()
    moves = [tuple(move) for move in STEPS[: movement.connectivity].tolist()]
    parents: dict[Cell, Cell] = {}
    lengths = {start: 0.0}
    path_costs = {start: 0.0}
    frontier = [(0.0, 0, start)]
    expanded: dict[Cell, None] = {}  # in their order
    pushes = 0
    while goal not in expanded:
        cell = heapq.heappop(frontier)[2]
        if cell in expanded:
            continue
        expanded[cell] = None
        legal = []
        for neighbour, (_, diagonal_moves) in neighbours(grid.tolist(), cell, movement):
            move = moves.index((neighbour[0] - cell[0], neighbour[1] - cell[1]))
            mean_cost = (cell_costs[cell[0]][cell[1]] + cell_costs[neighbour[0]][neighbour[1]]) / 2
            length = mean_cost * (movement.diagonal_cost if diagonal_moves else 1.0)
            legal.append((neighbour, length, float(scores[move, cell[0], cell[1]])))
        best_score = max(score for _, _, score in legal)
        for neighbour, length, score in legal:
            if lengths[cell] + length < lengths.get(neighbour, math.inf):
                lengths[neighbour] = lengths[cell] + length
                parents[neighbour] = cell
            odds = math.exp(min(best_score - score, 10))
            path_cost = path_costs[cell] + length + trust * (odds**2 - 1)
            if neighbour not in expanded and path_cost < path_costs.get(neighbour, math.inf):
                path_costs[neighbour] = path_cost
                pushes += 1
                f = path_cost + float(costs[neighbour]) - 0.001 * lengths[neighbour]
                heapq.heappush(frontier, (f, -pushes, neighbour))
    path = [goal]
    while path[-1] != start:
        path.append(parents[path[-1]])
    return path[::-1], list(expanded)


@pytest.mark.parametrize("all_tie", [False, True])
@pytest.mark.parametrize("trust", [0.0, 0.4, 5.0])
@pytest.mark.parametrize("movement", MOVEMENTS)
def test_the_search_is_the_slow_one(movement: Movement, trust: float, all_tie: bool) -> None:
    """Both have the same paths and expand the same cells in the same order, for random predictions,
    and for equal ones, where only the order among cells of equal f decides.
    """
    problems = ProblemSet.sample(Forest((12, 14)), 1, 30, movement=movement)
    model = random_predictor(problems, 2)
    if all_tie:
        model.scores.fill(0)
        model.costs.fill(1)
    plans = search_by(model, trust).plan_batch(problems.grids, problems.starts, problems.goals)
    for k, plan in enumerate(plans):
        start = tuple(problems.starts[k].tolist())
        goal = tuple(problems.goals[k].tolist())
        arguments = (problems.grids[k], model.scores[k], model.costs[k], start, goal, movement)
        # ``trust`` is a penalty on maps of 64 x 64; the mean side of these maps, 12 x 14, is 13.
        path, expanded = slow_search(*arguments, trust * 64 / 13)
        assert plan.path.tolist() == [list(cell) for cell in path]
        assert plan.expansions == len(expanded)
        assert plan.order is not None
        numbers = [plan.order[cell] for cell in expanded]
        assert numbers == list(range(len(expanded)))
        assert np.count_nonzero(plan.order >= 0) == len(expanded)


@pytest.mark.parametrize("trust", [0.0, 0.4])
@pytest.mark.parametrize("movement", MOVEMENTS)
def test_the_search_on_terrain_is_the_slow_one(movement: Movement, trust: float) -> None:
    """A move costs the mean of its two cells times its length, and penalties are in units of the
    mean cost of the free cells. The paths are valid.
    """
    problems = ProblemSet.sample(Terrain((12, 14), costs=(1, 3, 50)), 1, 30, movement=movement)
    assert problems.terrain is not None
    model = random_predictor(problems, 2)
    model.costs *= 10
    plans = search_by(model, trust).plan_batch(
        problems.grids, problems.starts, problems.goals, problems.terrain
    )
    for k, plan in enumerate(plans):
        start = tuple(problems.starts[k].tolist())
        goal = tuple(problems.goals[k].tolist())
        terrain = problems.terrain[k]
        check_path(problems.grids[k], plan.path, movement, terrain=terrain)
        arguments = (problems.grids[k], model.scores[k], model.costs[k], start, goal, movement)
        unit = terrain[terrain > 0].mean()
        path, expanded = slow_search(*arguments, trust * unit * 64 / 13, terrain)
        assert plan.path.tolist() == [list(cell) for cell in path]
        assert plan.expansions == len(expanded)


def all_plans(planner: GuidedSearch, problems: ProblemSet, terrain: Any) -> list[Any]:
    """Return path and number of expansions of each problem, on some terrain."""
    plans = planner.plan_batch(problems.grids, problems.starts, problems.goals, terrain)
    return [(plan.path.tolist(), plan.expansions) for plan in plans]


@pytest.mark.parametrize("trust", [0.4, math.inf])
def test_terrain_of_ones_changes_no_plan(trust: float) -> None:
    """Cells that all cost 1 are those of a map without terrain, and other costs change plans."""
    problems = ProblemSet.sample(Forest((12, 14)), 1, 30, movement=Movement(8))
    planner = search_by(random_predictor(problems, 2), trust)
    ones = (problems.grids == 0).astype(np.uint8)
    without_terrain = all_plans(planner, problems, None)
    assert all_plans(planner, problems, ones) == without_terrain
    costs = np.random.default_rng(3).integers(1, 100, ones.shape).astype(np.uint8) * ones
    assert all_plans(planner, problems, costs) != without_terrain


def test_a_model_without_terrain_plans_as_if_all_free_cells_cost_1() -> None:
    """Its predictions are in cells, so that they do not fit to other costs."""
    problems = ProblemSet.sample(Terrain((12, 14)), 1, 10, movement=Movement(8))
    planner = search_by(random_predictor(problems, 2), takes_terrain=False)
    assert all_plans(planner, problems, problems.terrain) == all_plans(planner, problems, None)


def test_the_problems_must_have_the_movement_of_the_model() -> None:
    """Also where the model is behind a planner."""
    problems = ProblemSet.sample("dungeon", maps=1, problems="random")
    planner = search_by(random_predictor(problems, 0))
    evaluate([planner], problems, bootstrap=1)
    others = ProblemSet.sample("dungeon", maps=1, problems="random", movement=Movement(8))
    with pytest.raises(ValueError, match=r"search is for Movement\(connectivity=4"):
        evaluate([planner], others, bootstrap=1)


def test_terrain_that_does_not_fit_the_grids_is_refused() -> None:
    """Terrain is 0 exactly on the occupied cells."""
    problems = ProblemSet.sample(Terrain((12, 14)), 1, 3, movement=Movement(8))
    assert problems.terrain is not None
    planner = search_by(random_predictor(problems, 2))
    with pytest.raises(ValueError, match=r"terrain: got .* expected 0 on occupied cells"):
        all_plans(planner, problems, np.maximum(problems.terrain, 1))
    with pytest.raises(ValueError, match="terrain: got shape"):
        all_plans(planner, problems, problems.terrain[:, 1:])
    with pytest.raises(
        ValueError, match="terrain: got the value 256, expected integers from 0 to 255"
    ):
        all_plans(planner, problems, np.where(problems.terrain > 0, 256, 0))
    with pytest.raises(ValueError, match="terrain: got dtype float64, expected integers"):
        all_plans(planner, problems, problems.terrain / 2)


@pytest.mark.parametrize("cut", [(1, 8, 12, 14), (5, 4, 12, 14), (5, 8, 11, 14), (5, 8, 12, 1)])
def test_predictions_of_another_shape_are_refused(cut: tuple[int, ...]) -> None:
    """The compiled search would read past the end of arrays that are too small."""
    problems = ProblemSet.sample(Forest((12, 14)), 1, 5, movement=Movement(8))
    model = random_predictor(problems, 3)
    count, moves, rows, columns = cut
    problem_arrays = problems.grids, problems.starts, problems.goals
    wrong = replace(model, scores=model.scores[:count, :moves, :rows, :columns])
    with pytest.raises(ValueError, match=r"predict gave shapes .* expected .*5, 8, 12, 14"):
        search_by(wrong).plan_batch(*problem_arrays)
    scores: Any = model.scores  # and no costs to go
    one_array = GuidedSearch("search", Movement(8), lambda grids, goals: scores)
    with pytest.raises(ValueError, match="search: predict gave 5 arrays, expected two"):
        one_array.plan_batch(*problem_arrays)
    wrong = replace(model, costs=model.costs[:, 1:])
    with pytest.raises(ValueError, match="search: predict gave shapes"):
        search_by(wrong).plan_batch(*problem_arrays)


@pytest.mark.filterwarnings("ignore:.*all scores that predict gave are NaN")
@pytest.mark.parametrize("share", [0.3, 1.0])
@pytest.mark.parametrize("number", [-np.inf, np.inf, np.nan])
def test_there_is_a_path_whatever_is_predicted(number: float, share: float) -> None:
    """A path is found even if some or all of the predicted scores and costs are not finite."""
    problems = ProblemSet.sample(Forest((12, 14)), 1, 100, movement=Movement(8))
    model = random_predictor(problems, 3)
    rng = np.random.default_rng(4)
    for array in (model.scores, model.costs):
        array[rng.random(array.shape) < share] = number
    for trust in (0.4, math.inf):
        plans = search_by(model, trust).plan_batch(problems.grids, problems.starts, problems.goals)
        for k, plan in enumerate(plans):
            check_path(problems.grids[k], plan.path, problems.movement)
            assert plan.path[0].tolist() == problems.starts[k].tolist()
            assert plan.path[-1].tolist() == problems.goals[k].tolist()


def test_a_network_that_diverged_is_named() -> None:
    """Its scores are all NaN, and its row would pass for one of a network that learnt nothing."""
    problems = ProblemSet.sample(Forest((12, 14)), 1, 2, movement=Movement(8))
    model = random_predictor(problems, 3)
    model.scores.fill(np.nan)
    with pytest.warns(UserWarning, match="search: all scores that predict gave are NaN"):
        search_by(model).plan_batch(problems.grids, problems.starts, problems.goals)


@pytest.mark.parametrize("trust", [-0.1, math.nan, "x"])
def test_a_trust_that_is_no_weight_is_refused(trust: Any) -> None:
    """Below 0, no number, and no text."""
    with pytest.raises(ValueError, match="trust: got "):
        GuidedSearch("search", Movement(8), prior, trust)


@pytest.mark.parametrize("planner", [GuidedSearch, CostPlanner])
def test_the_movement_comes_before_the_function(planner: Any) -> None:
    """As in all planners; the other order is refused when the planner is made."""
    with pytest.raises(ValueError, match="expected a Movement"):
        planner("search", prior, Movement(8))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_tensors_are_predictions(dtype: torch.dtype) -> None:
    """A network's output plans as the same numbers in arrays, of any float dtype."""
    problems = ProblemSet.sample(Forest((12, 14)), 1, 5, movement=Movement(8))
    model = random_predictor(problems, 2)
    tensors = torch.from_numpy(model.scores).to(dtype), torch.from_numpy(model.costs).to(dtype)
    planner = GuidedSearch("search", Movement(8), lambda grids, goals: tensors)
    assert all_plans(planner, problems, None) == all_plans(search_by(model), problems, None)


# --- no network -----------------------------------------------------------------------------------


@pytest.mark.parametrize("movement", MOVEMENTS)
def test_the_prior_is_a_planner_that_sees_no_obstacle(movement: Movement) -> None:
    """Costs to go are scipy's costs on an empty map. The score of a move is -3 times what it costs
    more than the best way there, and exactly 0 for the moves that cost nothing more.
    """
    shape = (7, 9)
    goals = np.array([(0, 0), (3, 4), (6, 2)])
    scores, costs_to_go = prior(np.zeros((3, *shape)), goals, movement)
    for k, goal in enumerate(goals.tolist()):
        # On a larger map, whose middle is the map of the prior, each cell has all neighbours.
        empty = np.zeros((9, 11), np.uint8)
        (around,) = scipy_distances(empty, [(goal[0] + 1, goal[1] + 1)], movement)
        here = around[1:-1, 1:-1]
        assert costs_to_go[k] == pytest.approx(here, rel=1e-6)
        for move, (down, right) in enumerate(STEPS[: movement.connectivity].tolist()):
            there = around[1 + down : 8 + down, 1 + right : 10 + right]
            length = movement.diagonal_cost if down and right else 1.0
            detour = length + there - here
            assert scores[k, move] == pytest.approx(-3 * detour, rel=1e-5, abs=1e-5)
            assert ((scores[k, move] == 0) == (detour < 1e-9)).all()


def test_costs_to_go_of_the_prior_are_in_mean_costs_on_terrain() -> None:
    """The mean is over the free cells alone."""
    terrain = np.array([[[2, 4, 0], [6, 0, 8]]], np.uint8)
    scores, costs_to_go = prior(terrain == 0, [(0, 0)], Movement(), terrain)
    scores_without, costs_without = prior(terrain == 0, [(0, 0)], Movement())
    assert (costs_to_go == 5 * costs_without).all()
    assert (scores == scores_without).all()


@pytest.mark.parametrize("movement", MOVEMENTS)
def test_the_row_without_a_network_is_the_slow_search_by_the_prior(movement: Movement) -> None:
    """It stands in `classical`, and plans by the formulas of `GuidedSearch` alone."""
    (row,) = [one for one in classical(movement) if one.name == "guided search, no network"]
    problems = ProblemSet.sample(Forest((12, 14)), 1, 30, movement=movement)
    scores, costs_to_go = prior(problems.grids, problems.goals, movement)
    for k in range(len(problems)):
        start = tuple(problems.starts[k].tolist())
        goal = tuple(problems.goals[k].tolist())
        plan = row.plan(problems.grids[k], start, goal)
        ends = start, goal, movement
        path, expanded = slow_search(
            problems.grids[k], scores[k], costs_to_go[k], *ends, 0.15 * 64 / 13
        )
        assert plan.path.tolist() == [list(cell) for cell in path]
        assert plan.expansions == len(expanded)


def test_problems_may_share_a_map() -> None:
    """As in the classical planners; the function that predicts gets the map once for each."""
    grid = ProblemSet.sample(Forest((12, 14)), 1, 1, movement=Movement(8)).grids[0]
    free_cells = np.argwhere(grid == 0)
    starts, goals = free_cells[:3], free_cells[-3:]
    terrain = np.where(grid, 0, 3).astype(np.uint8)
    uniform = partial(prior, movement=Movement(8))
    for planner in (
        GuidedSearch("search", Movement(8), uniform, takes_terrain=True),
        CostPlanner("costs", Movement(8), predict_ones),
    ):
        one_by_one = [planner.plan(grid, starts[k], goals[k]) for k in range(3)]
        for cell_costs in (None, terrain):
            together = planner.plan_batch(grid, starts, goals, cell_costs)
            for plan, expected in zip(together, one_by_one, strict=True):
                assert plan.path.tolist() == expected.path.tolist()


# --- costs of cells -------------------------------------------------------------------------------


def predict_ones(grids: Bytes, starts: Ints, goals: Ints) -> Floats:
    """Return equal costs."""
    return np.ones(grids.shape)


@pytest.mark.parametrize("movement", MOVEMENTS)
def test_a_star_on_equal_costs_is_a_star(movement: Movement) -> None:
    """The paths and the expansions, whatever the costs are."""
    problems = ProblemSet.sample(Forest((12, 14)), 1, 30, movement=movement)
    planner = CostPlanner("costs", movement, lambda grids, starts, goals: 0.3 * (1 - grids))
    plans = planner.plan_batch(problems.grids, problems.starts, problems.goals)
    expected = problems.optimal
    for k, plan in enumerate(plans):
        assert check_path(problems.grids[k], plan.path, movement) == expected.cost[k]
        assert plan.expansions == expected.iterations[k]
        assert plan.prepared == 12 * 14


@pytest.mark.parametrize("movement", MOVEMENTS)
def test_paths_are_the_cheapest_by_the_predicted_costs(movement: Movement) -> None:
    """As cheap as scipy's on costs that 255 levels hold exactly; tensors of the CPU are costs."""
    problems = ProblemSet.sample(Forest((12, 14)), 1, 10, movement=movement)
    costs = np.random.default_rng(5).integers(1, 255, problems.grids.shape)
    costs[:, 0, 0] = 255  # the largest of each map is one of 255 levels
    grids = problems.grids.copy()
    grids[:, 0, 0] = 0
    predicted = torch.from_numpy(costs / 100)
    planner = CostPlanner("costs", movement, lambda grids, starts, goals: predicted)
    plans = planner.plan_batch(grids, problems.starts, problems.goals)
    for k, plan in enumerate(plans):
        grid = grids[k]
        start, goal = problems.starts[k], problems.goals[k]
        assert (plan.path[[0, -1]] == (start, goal)).all()
        terrain = np.where(grid, 0, costs[k]).astype(np.uint8)
        cost = check_path(grid, plan.path, movement, terrain=terrain)
        (costs_from_start,) = scipy_distances(grid, [tuple(start)], movement, terrain)
        assert cost == pytest.approx(costs_from_start[tuple(goal)])


def test_costs_that_see_the_terrain() -> None:
    """The function gets it by name, and only if the planner says so."""
    problems = ProblemSet.sample(Terrain((12, 14)), 1, 10, movement=Movement(8))

    def predict(grids: Bytes, starts: Ints, goals: Ints, terrain: Bytes | None = None) -> Floats:
        return np.ones(grids.shape) if terrain is None else terrain.astype(np.float64)

    sees = CostPlanner("sees", Movement(8), predict, takes_terrain=True)
    blind = CostPlanner("blind", Movement(8), predict)
    table = evaluate([sees, blind], problems, bootstrap=1)
    opt = table.loc[table["subset"] == "all", "opt"].tolist()
    assert opt[0] == 1
    assert opt[1] < 0.5


@pytest.mark.parametrize(
    ("costs", "complaint"),
    [
        (np.ones((1, 3, 4)), r"planner: predict gave shape \(1, 3, 4\), expected \(1, 3, 3\)"),
        (
            torch.ones(1, 1, 3, 3),
            r"planner: predict gave shape \(1, 1, 3, 3\), expected \(1, 3, 3\)",
        ),
        (np.ones((3, 3)), r"planner: predict gave shape \(3, 3\), expected \(1, 3, 3\)"),
        (None, r"planner: predict gave shape \(\), expected \(1, 3, 3\)"),
        (np.full((1, 3, 3), np.nan), "expected a finite number of at least 0"),
    ],
)
def test_costs_that_are_none_are_refused(costs: Any, complaint: str) -> None:
    """Of another shape, such as those of a network with one channel, and NaN on a free cell."""
    planner = CostPlanner("planner", Movement(8), lambda grids, starts, goals: costs)
    with pytest.raises(ValueError, match=complaint):
        planner.plan(np.zeros((3, 3), np.uint8), (0, 0), (2, 2))
