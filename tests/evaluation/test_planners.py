"""The classical planners: the reference's search with another f, scipy's costs and Pohl's bound, on
maps with terrain and without it; and bad input refused.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
from helpers import reference
from helpers.examples import Some
from helpers.grids import scipy_distances
from helpers.reference import Cell

from mapdata import (
    MapSpec,
    Maze,
    Plan,
    ProblemSet,
    astar,
    bfs,
    check_path,
    distance_field,
    evaluate,
)
from mapdata.arrays import Bytes
from mapdata.evaluation import BatchPlanner, GoalFieldAstar, JumpPointSearch, Planner, classical
from mapdata.evaluation.planners import BestFirst, Limit, Search, VanillaAstar
from mapdata.movement import NEURAL_ASTAR, Movement

MOVEMENTS = [
    Movement(),
    Movement(8),
    Movement(8, corner_cutting=True),
    Movement(8, diagonal_cost=1),
]
movements = pytest.mark.parametrize("movement", MOVEMENTS, ids=["4", "8", "8-cutting", "8-one"])
on_any_map = pytest.mark.parametrize("has_terrain", [False, True], ids=["uniform", "terrain"])
WEIGHTS = [(0, True), (1, True), (1.1, True), (1.5, True), (3, True), (1, False)]
EXACT_WEIGHTS = [(0, True), (1, True), (1.25, True), (3, True), (1, False)]
"""Of terrain, on which rounded multiples of h often decide otherwise than exact ones."""


class Problem(NamedTuple):
    """A map with two free cells, and its terrain or None."""

    grid: Bytes
    start: Cell
    goal: Cell
    terrain: Bytes | None

    def plan(self, planner: BestFirst | GoalFieldAstar) -> Plan:
        """Return the plan of a planner."""
        return planner.plan(self.grid, self.start, self.goal, terrain=self.terrain)

    def cost_of(self, path: npt.NDArray[np.integer[Any]], movement: Movement) -> float:
        """Return the cost of a path, -1 without one."""
        return check_path(self.grid, path, movement, terrain=self.terrain) if len(path) else -1.0


def scattered(count: int, seed: int, has_terrain: bool) -> Iterator[Problem]:
    """Yield scattered maps of any shape with two free cells, connected or not."""
    source = np.random.default_rng(seed)
    for _ in range(count):
        shape = source.integers(1, 24, size=2)
        grid = (source.random(shape) < source.uniform(0, 0.5)).astype(np.uint8)
        (row, column), (goal_row, goal_column) = source.integers(0, shape, size=(2, 2)).tolist()
        grid[row, column] = 0
        grid[goal_row, goal_column] = 0
        costs = source.choice([(1, 2, 5), (3, 8, 12), (7, 100, 255)]).astype(np.uint8)
        terrain = np.where(grid, np.uint8(0), source.choice(costs, shape))
        yield Problem(
            grid, (row, column), (goal_row, goal_column), terrain if has_terrain else None
        )


def reference_best_first(
    problem: Problem, movement: Movement, weight: float, uses_path_cost: bool
) -> Plan:
    """Pop the least f = g + weight * h, among equal f the most recently pushed: exact fractions,
    plain Python.
    """
    grid, start, goal, terrain = problem
    rows = grid.tolist()
    costs_of_cells = None
    factor = 1
    if terrain is not None:
        costs_of_cells = terrain.tolist()
        factor = 2 * int(terrain[terrain > 0].min())

    def f(cost: reference.Pair, cell: Cell) -> Fraction:
        heuristic = reference.weigh(reference.heuristic(cell, goal, movement, factor), movement)
        way = reference.weigh(cost, movement) if uses_path_cost else 0
        return way + Fraction(weight) * heuristic

    frontier = [(f((0, 0), start), 0, start)]
    costs = {start: (0, 0)}
    parents = {start: start}
    taken: set[Cell] = set()
    pushes = 0
    while frontier:
        cell = heapq.heappop(frontier)[2]
        if cell in taken:
            continue
        taken.add(cell)
        if cell == goal:
            path = reference.trace(parents, goal)
            return Plan(np.array(path, np.int64), len(taken))
        for neighbour, step in reference.neighbours(rows, cell, movement, costs_of_cells):
            cost = reference.add(costs[cell], step)
            if neighbour in costs:
                known = reference.weigh(costs[neighbour], movement)
                if reference.weigh(cost, movement) >= known:
                    continue
            costs[neighbour] = cost
            parents[neighbour] = cell
            if neighbour not in taken:  # else it only has a shorter way from now on
                pushes += 1
                heapq.heappush(frontier, (f(cost, neighbour), -pushes, neighbour))
    return Plan(np.empty((0, 2), np.int64), len(taken))


def assert_same(plan: Plan, expected: Plan) -> None:
    """Compare paths and expansions."""
    assert plan.path.ndim == 2
    assert plan.path.shape[1] == 2
    np.testing.assert_array_equal(plan.path, expected.path)
    assert plan.expansions == expected.expansions
    assert type(plan.expansions) is int
    assert type(plan.prepared) is int
    assert type(plan.looks) in (int, type(None))


def ends_of(problems: ProblemSet) -> list[tuple[Cell, Cell]]:
    """Return start and goal of each problem."""
    ends = zip(problems.starts.tolist(), problems.goals.tolist(), strict=True)
    return [
        ((row, column), (goal_row, goal_column)) for (row, column), (goal_row, goal_column) in ends
    ]


def plan_all(planner: BatchPlanner, problems: ProblemSet) -> Sequence[Plan]:
    """Return the plans of all problems, found in one call."""
    return planner.plan_batch(problems.grids, problems.starts, problems.goals)


@movements
@pytest.mark.parametrize(
    ("weight", "uses_path_cost", "has_terrain"),
    [
        *((*weight, False) for weight in WEIGHTS),
        *((*weight, True) for weight in EXACT_WEIGHTS),
    ],
)
def test_best_first_equals_the_reference(
    movement: Movement, weight: float, uses_path_cost: bool, has_terrain: bool
) -> None:
    """Path and expansions, cell by cell: Dijkstra, A*, weighted A* and greedy search, with and
    without a path.
    """
    planner = BestFirst("it", movement, weight, uses_path_cost)
    solved = 0
    for problem in scattered(40, 1, has_terrain):
        expected = reference_best_first(problem, movement, weight, uses_path_cost)
        assert_same(problem.plan(planner), expected)
        solved += len(expected.path) > 0
    assert 0 < solved < 40


@movements
def test_best_first_search_with_weight_one_is_astar(movement: Movement) -> None:
    """With f = g + h it expands the same cells as the A* of the format."""
    problems = ProblemSet.sample(MapSpec.preset("dungeon"), 5, 100, movement=movement)
    generic = plan_all(BestFirst("A*", movement, 1), problems)
    own = plan_all(Search("A*", movement, "astar"), problems)
    for plan, expected in zip(generic, own, strict=True):
        assert_same(plan, expected)


@on_any_map
@movements
def test_dijkstras_costs_are_scipys(movement: Movement, has_terrain: bool) -> None:
    """The cost of Dijkstra's path is the shortest distance on scipy's graph; no path where scipy
    finds none.
    """
    planner = BestFirst("Dijkstra", movement, 0)
    for problem in scattered(60, 2, has_terrain):
        cost = problem.cost_of(problem.plan(planner).path, movement)
        distances = scipy_distances(problem.grid, [problem.goal], movement, problem.terrain)[0]
        assert cost == pytest.approx(distances[problem.start], rel=1e-12)


@movements
@pytest.mark.parametrize("preset", ["dungeon", "tiles"])
@pytest.mark.parametrize("weight", [0, 0.5, 1, 2, 5])
def test_weighted_costs_are_bounded(movement: Movement, preset: str, weight: float) -> None:
    """The cost is at most max(1, weight) times the optimal one."""
    problems = ProblemSet.sample(preset, 6, 100, movement=movement)
    planner = BestFirst("weighted", movement, weight)
    plans = planner.plan_batch(
        problems.grids, problems.starts, problems.goals, terrain=problems.terrain
    )
    terrains = [None] * 100 if problems.terrain is None else problems.terrain
    costs = [
        check_path(grid, plan.path, movement, terrain=terrain)
        for grid, plan, terrain in zip(problems.grids, plans, terrains, strict=True)
    ]
    ratios = costs / problems.optimal.cost
    assert ratios.max() <= max(1, weight) + 1e-12
    assert (ratios.max() > 1) == (weight > 1)


@movements
def test_classical_planners_solve_problems_alone_and_in_batches(
    some: Some, movement: Movement
) -> None:
    """BFS and A* are mapdata's, the limit is A*'s path with its cells counted; alone and batched
    answer the same.
    """
    problems = ProblemSet.sample(MapSpec(), 7, some(30), movement=movement)
    ends = ends_of(problems)
    rows = {planner.name: planner for planner in classical(movement)}
    jump_points = ["jump point search"] if movement.connectivity == 8 else []
    assert list(rows) == [
        "BFS",
        "Dijkstra",
        "A*",
        "weighted A* (1.1)",
        "weighted A* (1.25)",
        "weighted A* (1.5)",
        "weighted A* (2)",
        "weighted A* (3)",
        "greedy best-first",
        "guided search, no network",
        *jump_points,
        "A* with 8 landmarks",
        "A* with the exact goal field",
        "limit",
    ]
    for planner in rows.values():
        assert isinstance(planner, BatchPlanner)
        batch = plan_all(planner, problems)
        for grid, (start, goal), expected in zip(problems.grids, ends, batch, strict=True):
            assert_same(planner.plan(grid, start, goal), expected)
    for grid, (start, goal) in zip(problems.grids, ends, strict=True):
        by_bfs = bfs(grid, start, goal, movement)
        by_astar = astar(grid, start, goal, movement)
        assert_same(rows["BFS"].plan(grid, start, goal), Plan(by_bfs.path, by_bfs.iterations))
        assert_same(rows["A*"].plan(grid, start, goal), Plan(by_astar.path, by_astar.iterations))
        assert_same(rows["limit"].plan(grid, start, goal), Plan(by_astar.path, len(by_astar.path)))
        assert rows["A*"].plan(grid, start, goal)[2:] == (0, None, None)
        assert rows["limit"].plan(grid, start, goal).prepared == by_astar.iterations


def last_optimal_moves(problem: Problem, movement: Movement) -> list[list[int]]:
    """Return the path by the last optimal move of each cell in the order of `STEPS`, which is the
    cell that A* would push last; no cell without a path.
    """
    grid, start, goal, terrain = problem
    costs_of_cells = None if terrain is None else terrain.tolist()
    moves = reference.reference_moves(grid.tolist(), goal, movement, costs_of_cells)
    if start != goal and not moves[start]:
        return []
    path = [list(start)]
    while path[-1] != list(goal):
        row, column = path[-1]
        move = int(moves[row, column]).bit_length() - 1
        down, right = (reference.STRAIGHT + reference.DIAGONAL)[move]
        path.append([row + down, column + right])
    return path


@on_any_map
@movements
def test_the_search_with_the_goal_field_prepares_all_cells_that_reach_the_goal(
    movement: Movement, has_terrain: bool
) -> None:
    """It expands the cells of its path, none where there is no path, and takes the last optimal
    move.
    """
    planner = GoalFieldAstar("exact", movement)
    for problem in scattered(30, 4, has_terrain):
        grid, start, goal, terrain = problem
        plan = problem.plan(planner)
        field = distance_field(grid, goal, movement, terrain=terrain)
        assert plan.prepared == (field >= 0).sum()
        assert plan.looks is None
        assert plan.expansions == len(plan.path)
        assert plan.path.tolist() == last_optimal_moves(problem, movement)
        cost = problem.cost_of(plan.path, movement)
        assert cost == astar(grid, start, goal, movement, terrain=terrain).cost


def test_jump_point_search_counts_its_looks() -> None:
    """On an empty map a ray from the start passes the cells of the path; behind a wall it fails,
    and scans pass rows and columns.
    """
    planner = JumpPointSearch("jumps", Movement(8))
    straight = planner.plan(np.zeros((1, 9), np.uint8), (0, 2), (0, 6))
    assert (straight.expansions, straight.prepared, straight.looks) == (2, 0, 5)
    assert straight.path.tolist() == [[0, 2], [0, 3], [0, 4], [0, 5], [0, 6]]
    turned = planner.plan(np.zeros((5, 5), np.uint8), (0, 0), (2, 4))
    assert (turned.expansions, turned.looks, len(turned.path)) == (2, 5, 5)
    assert turned.path.tolist() == [[0, 0], [1, 1], [2, 2], [2, 3], [2, 4]]
    wall = np.zeros((2, 5), np.uint8)
    wall[0, 1:4] = 1
    around = planner.plan(wall, (0, 0), (0, 4))
    # Expanded are the start, (1, 0) and (1, 4), beside the ends of the wall, and the goal. Scans
    # pass (1, 0), and then (1, 1) to (1, 4); the ray of (1, 4) passes the goal.
    assert (around.expansions, around.looks) == (4, 7)
    assert around.path.tolist() == [[0, 0], [1, 0], [1, 1], [1, 2], [1, 3], [1, 4], [0, 4]]


def test_jump_point_search_with_four_moves_is_refused() -> None:
    """The message names what there is for four moves."""
    with pytest.raises(
        ValueError, match=r"got 4 moves, expected 8 .* JPS4 \(Baum 2025, arXiv 2501"
    ):
        JumpPointSearch("jumps", Movement())


def test_no_path_and_start_is_goal() -> None:
    """A wall between gives an empty path after all cells of the start's side; start = goal is one
    cell.
    """
    grid = np.zeros((5, 9), np.uint8)
    grid[:, 6] = 1
    for planner in classical():
        nothing = planner.plan(grid, (2, 2), (2, 8))
        assert nothing.path.shape == (0, 2)
        if isinstance(planner, JumpPointSearch):
            # No obstacle ends, so that no cell but the start is a jump point. The ray to the goal
            # passes the three cells before the wall, too.
            assert (nothing.expansions, nothing.looks) == (1, 5 * 6 + 3)
        elif isinstance(planner, GoalFieldAstar):
            assert (nothing.expansions, nothing.prepared) == (0, 5 * 2)
        elif isinstance(planner, Limit):
            assert (nothing.expansions, nothing.prepared) == (0, 5 * 6)
        else:
            assert nothing.expansions == 5 * 6
        alone = planner.plan(grid, (2, 2), (2, 2))
        assert alone.path.tolist() == [[2, 2]]
        assert alone.expansions == 1


def test_a_large_grid_works_and_a_too_large_one_is_refused() -> None:
    """On the largest maps costs fit into 64 bits; where a weighted one would not, the grid is
    refused.
    """
    grid = np.zeros((1024, 1024), np.uint8)
    grid[1::2] = 1
    grid[np.arange(1, 1024, 2), np.where(np.arange(512) % 2, 0, 1023)] = 0
    start = (0, 0)
    goal = (1022, 1023)
    found = BestFirst("weighted", Movement(8), 5).plan(grid, start, goal)
    optimal = astar(grid, start, goal, Movement(8))  # there is one way only
    assert check_path(grid, found.path, Movement(8)) == optimal.cost
    with pytest.raises(ValueError, match="too large"):
        BestFirst("weighted", Movement(), 2).plan(np.zeros((1, 2**20), np.uint8), (0, 0), (0, 1))


@pytest.mark.parametrize("weight", [-1, float("nan"), float("inf")])
def test_weights_below_zero_or_not_finite_are_refused(weight: float) -> None:
    """The message names the weight."""
    with pytest.raises(ValueError, match="weight"):
        BestFirst("weighted", Movement(), weight)


@pytest.mark.parametrize(
    "ask",
    [classical, lambda movement: ProblemSet.sample("dungeon", movement=movement)],
    ids=["planners", "problems"],
)
def test_a_number_is_no_movement(ask: Callable[[Any], object]) -> None:
    """The error names what is expected."""
    with pytest.raises(ValueError, match=r"got 8, expected a Movement, such as Movement\(8\)"):
        ask(8)


@pytest.mark.parametrize(
    ("grid", "start", "goal", "why"),
    [
        ([[0, 0]], (0, 0), (0, 2), "outside"),
        ([[0, 0]], (-1, 0), (0, 1), "outside"),
        ([[0, 1]], (0, 0), (0, 1), "occupied"),
        ([[0, 2, 0]], (0, 0), (0, 2), "the value 2"),
        ([[[0, 0]]], (0, 0), (0, 1), "expected"),
    ],
)
@pytest.mark.parametrize("planner", classical(), ids=lambda planner: planner.name)
def test_bad_problems_are_refused(
    planner: Planner, grid: npt.ArrayLike, start: Cell, goal: Cell, why: str
) -> None:
    """A cell outside the map or in a wall, other grid values and another rank raise an error, and
    never crash a kernel.
    """
    with pytest.raises(ValueError, match=why):
        planner.plan(np.array(grid, np.uint8), start, goal)


def test_the_astar_of_neural_astar() -> None:
    """It expands as many cells as VanillaAstar of neural-astar 473edbb counts on the same mazes."""
    movement = Movement(8, corner_cutting=True, diagonal_cost=1)
    (planner,) = (one for one in classical(movement) if one.name == "A* of Neural A*")
    counted = [380, 259, 43, 329, 258, 335, 18, 205, 115, 227, 281, 97]
    drawn = ProblemSet.sample(Maze((32, 32)), 3, len(counted), movement=movement)
    table = evaluate([planner], drawn, bootstrap=1)
    assert table["opt"].tolist() == [1, 1]
    mean = np.mean(counted / drawn.optimal.iterations)
    assert table["expansion_ratio"][0] == pytest.approx(mean, rel=1e-12)
    ends = ends_of(drawn)
    plans = [planner.plan(grid, *ends[k]) for k, grid in enumerate(drawn.grids)]
    assert [plan.expansions for plan in plans] == counted


def test_the_astar_of_neural_astar_pushes_no_cell_again_for_an_equal_cost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In the open a cell has many shortest paths; one push for each of them would take for ever."""
    (planner,) = (row for row in classical(NEURAL_ASTAR) if row.name == "A* of Neural A*")
    assert isinstance(planner, VanillaAstar)
    pushed: list[tuple[float, Cell]] = []

    def push(heap: list[tuple[float, Cell]], entry: tuple[float, Cell]) -> None:
        pushed.append(entry)
        heap.append(entry)
        heap.sort()

    monkeypatch.setattr("mapdata.evaluation.planners.heapq.heappush", push)
    grid = np.zeros((9, 9), np.uint8)
    grid[4, :8] = 1
    plan = planner.plan(grid, (0, 0), (8, 0))
    assert len(plan.path) == 17
    assert len(pushed) == len(set(pushed))
