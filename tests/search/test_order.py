"""`search_order`: its cells come in the order in which slow reference searches expand them, and it
finds what the fast searches find.
"""

from __future__ import annotations

import math
import re
from typing import Any, NamedTuple

import numpy as np
import pytest
from helpers import reference
from helpers.examples import examples
from helpers.reference import Cell
from helpers.specs import movements
from hypothesis import given
from hypothesis import strategies as st

from mapdata import Movement, astar, bfs, distance_field, search_order
from mapdata.arrays import Bytes
from mapdata.evaluation.planners import BestFirst


class Problem(NamedTuple):
    """Terrain with two free cells; without costs, all its free cells are 1."""

    terrain: Bytes
    start: Cell
    goal: Cell

    @property
    def grid(self) -> Bytes:
        """Return the grid without costs."""
        return np.asarray(self.terrain == 0, np.uint8)


@st.composite
def problems(draw: st.DrawFn, max_cost: int = 1) -> Problem:
    """Draw a map with any share of occupied cells, and costs up to ``max_cost``."""
    source = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shape = draw(st.tuples(st.integers(1, 12), st.integers(1, 12)))
    terrain = source.integers(1, max_cost + 1, shape).astype(np.uint8)
    is_occupied = source.random(shape) < draw(st.sampled_from([0.0, 0.1, 0.3, 0.5]))
    start, goal = (tuple(cell) for cell in source.integers(0, shape, size=(2, 2)).tolist())
    is_occupied[start] = False
    is_occupied[goal] = False
    terrain[is_occupied] = 0
    return Problem(terrain, start, goal)


def numbered(expanded: list[Cell], shape: tuple[int, ...]) -> Any:
    """Return the number of the expansion of each cell, (H, W), -1 elsewhere."""
    order = np.full(shape, -1)
    for number, cell in enumerate(expanded):
        order[cell] = number
    return order


@movements
@examples(50)
@given(problem=problems())
def test_bfs_expands_in_the_order_of_the_reference(movement: Movement, problem: Problem) -> None:
    """Every cell has the number that it has there, and all others have -1."""
    expanded: list[Cell] = []
    reference.reference_bfs(
        problem.grid.tolist(), problem.start, problem.goal, movement, expanded=expanded
    )
    found = search_order(problem.grid, problem.start, problem.goal, movement, "bfs")
    np.testing.assert_array_equal(found.order, numbered(expanded, problem.grid.shape))


@pytest.mark.parametrize("max_cost", [None, 3, 255])
@movements
@examples(50)
@given(data=st.data())
def test_astar_expands_in_the_order_of_the_reference(
    movement: Movement, max_cost: int | None, data: st.DataObject
) -> None:
    """On grids and on terrain, every cell has the number that it has there."""
    problem = data.draw(problems(max_cost or 1))
    terrain = problem.terrain if max_cost else None
    expanded: list[Cell] = []
    reference.reference_astar(
        problem.grid.tolist(),
        problem.start,
        problem.goal,
        movement,
        terrain.tolist() if terrain is not None else None,
        expanded=expanded,
    )
    found = search_order(problem.grid, problem.start, problem.goal, movement, terrain=terrain)
    assert found.order.dtype == np.int32
    np.testing.assert_array_equal(found.order, numbered(expanded, problem.grid.shape))


@pytest.mark.parametrize("search", [bfs, astar])
@movements
@examples(50)
@given(problem=problems(9))
def test_it_finds_what_the_fast_search_finds(
    movement: Movement, search: Any, problem: Problem
) -> None:
    """Path, cost and iterations are equal, and iterations are the largest number plus one."""
    arguments = problem.grid, problem.start, problem.goal, movement
    found = search_order(*arguments, search.__name__, terrain=problem.terrain)
    expected = search(*arguments, terrain=problem.terrain)
    np.testing.assert_array_equal(found.path, expected.path)
    assert (found.cost, found.iterations) == (expected.cost, expected.iterations)
    assert found.order.max() + 1 == expected.iterations


@movements
@examples(50)
@given(problem=problems())
def test_the_heuristic_of_astar_as_a_function_gives_the_same_order(
    movement: Movement, problem: Problem
) -> None:
    """Though the function returns floats, equal f stay equal."""

    def heuristic(row: int, column: int) -> float:
        rows, columns = abs(row - problem.goal[0]), abs(column - problem.goal[1])
        if movement.connectivity == 4:
            return rows + columns
        return abs(rows - columns) + min(rows, columns) * movement.diagonal_cost

    arguments = problem.grid, problem.start, problem.goal, movement
    found = search_order(*arguments, heuristic=heuristic)
    expected = search_order(*arguments)
    np.testing.assert_array_equal(found.order, expected.order)
    np.testing.assert_array_equal(found.path, expected.path)
    assert found.cost == expected.cost


@pytest.mark.parametrize("weight", [0, 1.25, 3])
@movements
@examples(20)
@given(problem=problems())
def test_a_weight_expands_as_many_cells_as_weighted_astar(
    movement: Movement, weight: float, problem: Problem
) -> None:
    """The planner of the tables has the same path and the same number of expansions."""
    found = search_order(problem.grid, problem.start, problem.goal, movement, weight=weight)
    planner = BestFirst("weighted", movement, weight=weight)
    expected = planner.plan(problem.grid, problem.start, problem.goal)
    np.testing.assert_array_equal(found.path, expected.path)
    assert found.iterations == expected.expansions


@movements
@examples(50)
@given(problem=problems(9))
def test_the_exact_cost_to_the_goal_expands_one_path(movement: Movement, problem: Problem) -> None:
    """Nothing else is expanded, and without a path only the start."""
    arguments = problem.grid, problem.start, problem.goal, movement
    field = distance_field(problem.grid, problem.goal, movement, terrain=problem.terrain)
    found = search_order(*arguments, terrain=problem.terrain, heuristic=field)
    expected = astar(*arguments, terrain=problem.terrain)
    assert found.cost == pytest.approx(expected.cost)
    assert found.iterations == max(len(found.path), 1)


def test_an_inconsistent_heuristic_may_miss_the_shortest_path() -> None:
    """A cell that was expanded is not expanded again, as in weighted A*."""
    heuristic = np.zeros((2, 4))
    heuristic[0, 1] = 10  # on the short way
    found = search_order(np.zeros((2, 4)), (0, 0), (0, 3), heuristic=heuristic)
    assert found.cost == 5
    assert found.order[0, 1] == -1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"search": "dijkstra"}, "search: got 'dijkstra', expected one of bfs, astar"),
        ({"search": "bfs", "weight": 2}, "heuristic and weight: do nothing for BFS"),
        ({"search": "bfs", "heuristic": np.zeros((2, 3))}, "do nothing for BFS"),
        ({"weight": -1}, "weight: got -1.0, expected a number of at least 0"),
        ({"weight": math.inf}, "weight: got inf, expected"),
        ({"heuristic": np.zeros((3, 2))}, "heuristic: got shape (3, 2), expected (2, 3)"),
        ({"heuristic": np.full((2, 3), -2)}, "heuristic: got -2.0 at (0, 0), expected a cost"),
        ({"heuristic": lambda row, column: math.nan}, "heuristic: got nan at (0, 0)"),
        ({"heuristic": lambda row, column: "a"}, "heuristic: could not convert string to float"),
        ({"heuristic": lambda row, column: np.zeros(1)}, "heuristic: the function returned shape"),
        ({"heuristic": "zero"}, "heuristic: could not convert string to float: 'zero'; expected"),
        ({"heuristic": np.full((2, 3), 1e308)}, "heuristic: got 1e+308 at (0, 0) and the weight 1"),
        ({"weight": 1e308}, "heuristic: got 3.0 at (0, 0) and the weight 1e+308, expected a small"),
        ({"start": (5, 5)}, "start: (5, 5) is outside the map"),
        ({"terrain": np.zeros((2, 3), int)}, "terrain: got 0 at (0, 0)"),
    ],
)
def test_what_it_refuses(arguments: dict[str, Any], message: str) -> None:
    """The message names the argument, what it got and what it expected."""
    problem: dict[str, Any] = {"grid": np.zeros((2, 3)), "start": (0, 0), "goal": (1, 2)}
    with pytest.raises(ValueError, match=re.escape(message)):
        search_order(**(problem | arguments))
