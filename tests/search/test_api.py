"""BFS, A*, distance fields and the path check: equal to the reference and to scipy, on maps with
terrain and without it, and bad input named.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from random import Random
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
import pytest
from helpers import reference
from helpers.examples import Some, examples, slow
from helpers.grids import scipy_distances, serpentine
from helpers.reference import Cell, Pair
from helpers.specs import movements
from hypothesis import given
from hypothesis import strategies as st

from mapdata import SearchResult, astar, bfs, check_path, distance_field, terrain_from_costs
from mapdata.arrays import Bytes
from mapdata.evaluation import BatchPlanner, GoalFieldAstar, JumpPointSearch, LandmarkAstar
from mapdata.evaluation.planners import BestFirst, Search
from mapdata.movement import Movement
from mapdata.problems.sampling import sample_problems
from mapdata.search import search_batch
from mapdata.search.ground import TOO_LONG
from mapdata.search.lattice import move_rule
from mapdata.search.map_stack import MapStack

OCTILE = Movement(8)
CUTTING = Movement(8, corner_cutting=True)
planners = pytest.mark.parametrize(
    ("search", "truth"),
    [(bfs, reference.reference_bfs), (astar, reference.reference_astar)],
    ids=["bfs", "astar"],
)
Planner: TypeAlias = Callable[..., SearchResult]
Truth: TypeAlias = Callable[..., reference.ReferenceResult]
Array: TypeAlias = npt.NDArray[Any]

SHAPES = [
    (1, 1),
    (1, 2),
    (1, 17),
    (17, 1),
    (1, 130),
    (130, 1),
    (2, 2),
    (5, 8),
    (8, 5),
    (9, 9),
    (12, 21),
    (16, 16),
    (20, 20),
    (6, 70),
    (70, 6),
    (3, 64),
    (3, 65),
    (4, 129),
]
"""Single cells, rows and columns, and rows about the ends of words of 64 bits."""


COSTS = [(1,), (255,), (1, 2), (8, 12, 53, 77, 92), tuple(range(1, 11)), tuple(range(1, 256))]
"""Costs of the cells of terrain: with many ties, with few, and with the largest and the smallest.
"""


class Problem(NamedTuple):
    """A map with two free cells. It has terrain if its cells have costs."""

    grid: Bytes
    start: Cell
    goal: Cell
    terrain: Bytes | None

    def for_reference(self) -> tuple[list[list[int]], list[list[int]] | None]:
        """Return grid and terrain as the reference takes them."""
        return self.grid.tolist(), None if self.terrain is None else self.terrain.tolist()


def terrain_on(grid: Bytes, costs: Sequence[int] | None, source: np.random.Generator) -> Any:
    """Return terrain with the obstacles of a grid; None for no costs."""
    return None if costs is None else np.where(grid, 0, source.choice(costs, grid.shape))


@st.composite
def problems(draw: st.DrawFn) -> Problem:
    """Draw a grid of any kind: all free, scattered, a serpentine, all occupied except the ends; and
    its terrain or none.
    """
    height, width = draw(
        st.sampled_from(SHAPES) | st.tuples(st.integers(1, 12), st.integers(1, 12))
    )
    source = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    pattern = draw(st.sampled_from([0.0, 0.1, 0.2, 0.3, 0.35, 0.4, 0.45, 0.6, 1.0, "serpentine"]))
    if isinstance(pattern, float):
        grid = (source.random((height, width)) < pattern).astype(np.uint8)
    else:
        grid = serpentine(height, width, source)
    (row, column), (other_row, other_column) = source.integers(
        0, (height, width), size=(2, 2)
    ).tolist()
    anywhere = ((row, column), (other_row, other_column))
    down = ((0, 0), (height - 1, width - 1))
    up = ((height - 1, 0), (0, width - 1))
    start, goal = draw(st.sampled_from([anywhere, down, up]))
    grid[start] = 0
    grid[goal] = 0
    costs = draw(st.none() | st.sampled_from(COSTS))
    return Problem(grid, start, goal, terrain_on(grid, costs, source))


def assert_same(solution: SearchResult, expected: reference.ReferenceResult) -> None:
    """Compare path, cost and iterations, their types included."""
    assert solution.path.dtype == np.int64
    assert solution.path.shape == (len(expected.path), 2)
    assert [tuple(cell) for cell in solution.path.tolist()] == expected.path
    assert solution.cost == expected.cost
    assert solution.iterations == expected.iterations
    assert type(solution.cost) is float
    assert type(solution.iterations) is int


# --- equal to the reference ---------------------------------------------------------------------


@planners
@movements
@examples(400)
@given(problem=problems())
def test_search_equals_the_reference(
    search: Planner, truth: Truth, movement: Movement, problem: Problem
) -> None:
    """Path, cost and iterations are the reference's, cell by cell, on any map."""
    _, start, goal, terrain = problem
    grid, costs = problem.for_reference()
    solution = search(problem.grid, start, goal, movement, terrain=terrain)
    assert_same(solution, truth(grid, start, goal, movement, costs))


@planners
@movements
@pytest.mark.parametrize("density", [slow(0.02), 0.3])
def test_search_equals_the_reference_far_away(
    some: Some, search: Planner, truth: Truth, movement: Movement, density: float
) -> None:
    """Hundreds of diagonal moves: a rounded root of 2 or a sum of floats would put cells in another
    order.
    """
    grid = (np.random.default_rng(2).random((181, 257)) < density).astype(np.uint8)
    for start, goal in (((3, 5), (180, 250)), ((178, 2), (0, 256)))[: some(2)]:
        grid[start] = 0
        grid[goal] = 0
        solution = search(grid, start, goal, movement)
        expected = truth(grid.tolist(), start, goal, movement)
        assert_same(solution, expected)


@movements
@examples(200)
@given(problem=problems())
def test_distance_field_equals_the_reference(movement: Movement, problem: Problem) -> None:
    """Every cell holds its exact cost, rounded to float32 once; -1 where the goal cannot be
    reached.
    """
    grid, costs = problem.for_reference()
    field = distance_field(problem.grid, problem.goal, movement, terrain=problem.terrain)
    expected = reference.reference_field(grid, problem.goal, movement, costs)
    assert field.dtype == np.float32
    np.testing.assert_array_equal(field, expected)


@movements
@examples(200)
@given(problem=problems())
def test_costs_equal_scipys_dijkstra(movement: Movement, problem: Problem) -> None:
    """A*'s cost, the distance field, and (on hops) the BFS cost are the shortest there are."""
    grid, start, goal, terrain = problem
    distances = scipy_distances(grid, [goal], movement, terrain)[0]
    cost = astar(grid, start, goal, movement, terrain=terrain).cost
    assert cost == pytest.approx(distances[start], rel=1e-12)
    field = distance_field(grid, goal, movement, terrain=terrain)
    np.testing.assert_allclose(field, distances, rtol=1e-6)
    if terrain is None and (movement.connectivity == 4 or movement.diagonal_cost == 1):
        assert bfs(grid, start, goal, movement).cost == distances[start]


pairs = st.tuples(st.integers(0, 2**21), st.integers(0, 2**21))


@examples(500)
@given(first=pairs, second=pairs)
def test_the_reference_orders_costs_exactly(first: Pair, second: Pair) -> None:
    """Its integers order a + b sqrt 2 and c + d sqrt 2 as the squares of a - c and (d - b) sqrt 2,
    with their signs, do.
    """
    a, b = first
    c, d = second
    straight = a - c
    diagonal = d - b
    is_less = straight * abs(straight) < 2 * diagonal * abs(diagonal)
    assert (reference.weigh(first, OCTILE) < reference.weigh(second, OCTILE)) == is_less


# --- what a result is ---------------------------------------------------------------------------


@planners
@movements
def test_no_path_is_an_empty_path(search: Planner, truth: Truth, movement: Movement) -> None:
    """A wall between start and goal gives (0, 2), cost -1 and all cells that the start reaches; no
    exception.
    """
    grid = np.zeros((5, 70), dtype=np.uint8)
    grid[:, 66] = 1
    solution = search(grid, (2, 3), (4, 69), movement)
    assert solution.path.shape == (0, 2)
    assert solution.cost == -1
    assert solution.iterations == 5 * 66
    assert_same(solution, truth(grid.tolist(), (2, 3), (4, 69), movement))


@planners
@movements
def test_start_is_goal(search: Planner, truth: Truth, movement: Movement) -> None:
    """One cell, cost 0, one cell taken."""
    for grid in (np.zeros((1, 1)), np.zeros((4, 6))):
        solution = search(grid, (0, 0), (0, 0), movement)
        assert_same(solution, truth(grid.tolist(), (0, 0), (0, 0), movement))
        assert solution.path.tolist() == [[0, 0]]
        assert solution.cost == 0
        assert solution.iterations == 1


def test_movement_defaults_to_four_neighbours() -> None:
    """Without a movement all four functions use 4-connectivity."""
    grid = np.zeros((3, 3), dtype=np.uint8)
    assert bfs(grid, (0, 0), (2, 2)).cost == 4
    assert astar(grid, (0, 0), (2, 2)).cost == 4
    assert distance_field(grid, (0, 0))[2, 2] == 4
    assert check_path(grid, [(0, 0), (0, 1)]) == 1.0
    with pytest.raises(ValueError, match="1"):
        check_path(grid, [(0, 0), (1, 1)])


def test_the_order_by_hand() -> None:
    """On an empty 3 x 3 map BFS runs E before S, and A* goes on from the cell it pushed last."""
    grid = np.zeros((3, 3), dtype=np.uint8)
    by_bfs = bfs(grid, (0, 0), (2, 2))
    by_astar = astar(grid, (0, 0), (2, 2))
    assert by_bfs.path.tolist() == [[0, 0], [0, 1], [0, 2], [1, 2], [2, 2]]
    assert by_bfs.iterations == 9
    assert by_astar.path.tolist() == [[0, 0], [1, 0], [2, 0], [2, 1], [2, 2]]
    assert by_astar.iterations == 5


def test_bfs_counts_moves_and_astar_costs() -> None:
    """One diagonal move is 1 for BFS and the root of 2 for A* and for the check."""
    grid = np.zeros((4, 6), dtype=np.uint8)
    by_bfs = bfs(grid, (0, 0), (3, 5), OCTILE)
    by_astar = astar(grid, (0, 0), (3, 5), OCTILE)
    cost = 2 + 3 * 2**0.5
    assert by_bfs.cost == 5
    assert by_astar.cost == cost
    assert check_path(grid, by_bfs.path, OCTILE) == cost


@pytest.mark.parametrize("shape", [(1, 2**21), slow((2**21, 1))])
def test_the_largest_grid_works(shape: tuple[int, int]) -> None:
    """A corridor of the limit's two million cells is walked from end to end."""
    grid = np.zeros(shape, dtype=np.uint8)
    end = (shape[0] - 1, shape[1] - 1)
    for search in (bfs, astar):
        solution = search(grid, (0, 0), end)
        assert solution.cost == 2**21 - 1
        assert solution.iterations == 2**21
        assert len(solution.path) == 2**21
    assert distance_field(grid, (0, 0))[end] == 2**21 - 1


@pytest.mark.slow
@movements
def test_a_map_of_4096_cells_a_side(movement: Movement) -> None:
    """Around a wall on the largest map: the cost is that of the corner which the path must take."""
    grid = np.zeros((4096, 4096), dtype=np.uint8)
    grid[1:, 2048] = 1
    start, goal = (4095, 2040), (4095, 2056)
    solution = astar(grid, start, goal, movement)
    assert solution.cost == check_path(grid, solution.path, movement)
    # Up to row 0 and down again, over sixteen columns. The corner rule allows no diagonal moves
    # into the wall's column and out of it.
    diagonal = 0
    if movement.connectivity == 8:
        diagonal = 16 if movement.corner_cutting else 14
    straight = 2 * 4095 + 16 - 2 * diagonal
    assert solution.cost == straight + diagonal * movement.diagonal_cost
    if movement == Movement():
        assert bfs(grid, start, goal).cost == solution.cost
        assert distance_field(grid, goal)[start] == solution.cost


def long_corridor() -> Bytes:
    """Return a map, (2051, 2051), with one corridor of 2.1 million cells from top to bottom."""
    grid = np.zeros((2051, 2051), dtype=np.uint8)
    grid[1::2] = 1
    grid[np.arange(1, 2051, 2), np.where(np.arange(1025) % 2, 0, 2050)] = 0
    return grid


@pytest.mark.slow
def test_a_path_too_long_for_exact_costs_is_refused() -> None:
    """Found where moves are counted, else an error says so."""
    grid = long_corridor()
    ends = ((0, 0), (2050, 0))
    moves = 1026 * 2050 + 1025 * 2
    assert moves > 2**21
    assert astar(grid, *ends).cost == moves
    assert bfs(grid, *ends, OCTILE).cost == moves
    assert check_path(grid, astar(grid, *ends).path, OCTILE) == moves
    for movement in (OCTILE, Movement(8, corner_cutting=True, diagonal_cost=1)):
        with pytest.raises(ValueError, match="paths of 2097152 cells or more"):
            astar(grid, *ends, movement)
        with pytest.raises(ValueError, match="paths of 2097152 cells or more"):
            distance_field(grid, ends[0], movement)
    with pytest.raises(ValueError, match="paths of 2097152 cells or more"):
        BestFirst("weighted", OCTILE, 1.5).plan(grid, *ends)
    # Four rows less are ten moves within the bound.
    assert moves - 4 * 2052 == 2**21 - 10
    assert astar(grid, (8, 0), ends[1], OCTILE).cost == moves - 4 * 2052
    assert distance_field(grid, (8, 0), OCTILE)[ends[1]] == moves - 4 * 2052


@pytest.mark.slow
@pytest.mark.parametrize("movement", [OCTILE, Movement(8, corner_cutting=True)])
@pytest.mark.parametrize(
    "planner_class",
    [
        lambda movement: Search("A*", movement, "astar"),
        lambda movement: BestFirst("weighted", movement, 1.5),
        lambda movement: JumpPointSearch("jump points", movement),
        lambda movement: LandmarkAstar("landmarks", movement),
        lambda movement: GoalFieldAstar("goal field", movement),
    ],
)
def test_every_planner_names_the_problem_whose_path_is_too_long(
    planner_class: Callable[[Movement], BatchPlanner], movement: Movement
) -> None:
    """By the protocol of costs on terrain that are too high."""
    grid = long_corridor()
    starts, goals = np.array([[0, 0], [0, 0]]), np.array([[0, 9], [2050, 0]])
    with pytest.raises(ValueError, match=r"problem [01]: the grid has paths of 2097152 cells or"):
        planner_class(movement).plan_batch(grid, starts, goals)


@pytest.mark.slow
@pytest.mark.parametrize("movement", [Movement(), OCTILE, Movement(8, corner_cutting=True)])
@pytest.mark.parametrize(
    "conditions",
    [((1, np.inf), None), ((2**21 + 9, np.inf), None), ((1, np.inf), (1.05, np.inf))],
)
def test_sampling_names_the_map_whose_paths_are_too_long(
    conditions: tuple[tuple[float, float], tuple[float, float] | None], movement: Movement
) -> None:
    """As for terrain: the map, and a cost, which is the constant of grids."""
    distances, hardness = conditions
    bands = None if hardness is None else (distances, hardness, (2, np.inf))
    maps = MapStack(long_corridor()[None], None)
    _ends, row, high_cost = sample_problems(
        maps,
        np.array([[0, 0]]),
        np.uint64(1),
        0,
        np.zeros(1, np.int64),
        (0, 1),
        distances[0],
        bands,
        move_rule(movement),
    )
    assert (row, int(high_cost)) == (0, int(TOO_LONG))
    with pytest.raises(ValueError, match="map 7: the grid has paths of 2097152 cells"):
        maps.check_exact(row, high_cost, lambda row: f"map {row + 7}: ")


# --- the path check -----------------------------------------------------------------------------


@movements
@examples(200)
@given(problem=problems())
def test_check_path_accepts_found_paths(movement: Movement, problem: Problem) -> None:
    """What BFS and A* find is a path, and its cost is theirs (BFS's own count where all moves cost
    1).
    """
    grid, start, goal, terrain = problem
    _, costs = problem.for_reference()
    counts_moves = movement.connectivity == 4 or movement.diagonal_cost == 1
    for search in (bfs, astar):
        solution = search(grid, start, goal, movement, terrain=terrain)
        if not len(solution.path):
            continue
        cells = [(int(row), int(column)) for row, column in solution.path]
        cost = check_path(grid, solution.path, movement, terrain=terrain)
        assert cost == reference.path_cost(cells, movement, costs)
        assert type(cost) is float
        if search is astar or (terrain is None and counts_moves):
            assert cost == solution.cost


@movements
@examples(300)
@given(problem=problems(), source=st.randoms(use_true_random=False))
def test_check_path_agrees_with_the_reference(
    movement: Movement, problem: Problem, source: Random
) -> None:
    """A path with one or two cells moved by a little is refused, naming its first bad step, exactly
    when it is bad.
    """
    grid, start, goal, terrain = problem
    _, costs = problem.for_reference()
    walk = bfs(grid, start, goal, CUTTING).path.tolist() or [start]
    cells = [(row, column) for row, column in walk]
    for _ in range(source.randrange(3)):
        position = source.randrange(len(cells))
        row, column = cells[position]
        cells[position] = (row + source.randint(-1, 1), column + source.randint(-1, 1))
    bad = reference.first_bad_step(grid.tolist(), cells, movement)
    if bad is None:
        cost = check_path(grid, np.array(cells), movement, terrain=terrain)
        assert cost == reference.path_cost(cells, movement, costs)
        return
    with pytest.raises(ValueError, match=named(cells[bad])):
        check_path(grid, np.array(cells), movement, terrain=terrain)


def named(cell: Sequence[float]) -> str:
    """Return a pattern for a cell in a message, such as (3, 4) or [3 4]."""
    return r"(?<![\d-])" + r"\D+?".join(re.escape(str(value)) for value in cell) + r"(?!\d)"


WALLED = np.array(
    [[0, 0, 0, 0, 0], [0, 1, 0, 0, 0], [0, 0, 0, 1, 0], [0, 0, 0, 0, 0]], dtype=np.uint8
)
BAD_PATHS = [
    pytest.param([(0, 0), (-1, 0), (9, 9)], Movement(), (-1, 0), id="off the grid, above"),
    pytest.param([(0, 0), (0, -1), (9, 9)], Movement(), (0, -1), id="off the grid, left"),
    pytest.param([(3, 0), (4, 0), (9, 9)], Movement(), (4, 0), id="off the grid, below"),
    pytest.param([(0, 4), (0, 5), (9, 9)], Movement(), (0, 5), id="off the grid, right"),
    pytest.param([(7, 8), (0, 0)], Movement(), (7, 8), id="starts off the grid"),
    pytest.param([(1, 1), (1, 2)], Movement(), (1, 1), id="starts in a wall"),
    pytest.param([(1, 0), (1, 1), (1, 2)], Movement(), (1, 1), id="through a wall"),
    pytest.param([(0, 0), (0, 1), (0, 3), (9, 9)], Movement(), (0, 3), id="a jump"),
    pytest.param([(0, 0), (0, 1), (3, 1), (9, 9)], CUTTING, (3, 1), id="a jump down"),
    pytest.param([(0, 0), (0, 1), (0, 1), (9, 9)], Movement(), (0, 1), id="a repeated cell"),
    pytest.param([(0, 0), (0, 0)], CUTTING, (0, 0), id="a repeated start"),
    pytest.param([(0, 3), (1, 4), (9, 9)], Movement(), (1, 4), id="a diagonal under 4"),
    pytest.param([(0, 2), (0, 1), (1, 0), (9, 9)], OCTILE, (1, 0), id="a cut corner"),
    pytest.param([(1, 2), (2, 1), (9, 9)], OCTILE, (2, 1), id="a cut corner, the other side"),
    pytest.param([(2, 4), (1, 3), (9, 9)], OCTILE, (1, 3), id="a cut corner upwards"),
    pytest.param([(0, 0), (1, 1)], CUTTING, (1, 1), id="a diagonal into a wall"),
    pytest.param([(0, 0), (2**40, 0)], Movement(), (2**40, 0), id="far off the grid"),
]


@pytest.mark.parametrize(("path", "movement", "bad"), BAD_PATHS)
def test_check_path_names_the_first_bad_step(
    path: list[Cell], movement: Movement, bad: Cell
) -> None:
    """The message is one line that names the first bad cell, and not a later one."""
    with pytest.raises(ValueError, match=named(bad)) as error:
        check_path(WALLED, np.array(path), movement)
    assert "\n" not in str(error.value)
    assert not re.search(named((9, 9)), str(error.value))


@pytest.mark.parametrize(
    ("path", "movement", "reason"),
    [
        ([(0, 1), (0, 1)], Movement(), "(0, 1) to (0, 1), stays on its cell"),
        ([(0, 1), (0, 3)], CUTTING, "(0, 1) to (0, 3), leads to no neighbour"),
        ([(0, 1), (2, 2)], CUTTING, "(0, 1) to (2, 2), leads to no neighbour"),
        (
            [(0, 3), (1, 4)],
            Movement(),
            "(0, 3) to (1, 4), is diagonal (a Movement with connectivity=8 allows it)",
        ),
        (
            [(0, 1), (1, 0)],
            OCTILE,
            "(0, 1) to (1, 0), cuts a corner (a Movement with corner_cutting=True allows it)",
        ),
    ],
    ids=["no move", "a jump", "a knight's move", "a diagonal", "a corner"],
)
def test_check_path_says_why_a_move_is_not_legal(
    path: list[Cell], movement: Movement, reason: str
) -> None:
    """And which movement allows it, if one does."""
    with pytest.raises(ValueError, match=f"^path: move 0, from {re.escape(reason)}$"):
        check_path(WALLED, path, movement)


def test_check_path_allows_what_the_movement_allows() -> None:
    """The same corner is free to cut with corner cutting, and a diagonal beside no wall without
    it.
    """
    assert check_path(WALLED, [(0, 2), (0, 1), (1, 0)], CUTTING) == 1 + 2**0.5
    assert check_path(WALLED, [(0, 3), (1, 4)], OCTILE) == 2**0.5
    assert check_path(WALLED, [(0, 3), (1, 4)], Movement(8, diagonal_cost=1)) == 1.0
    assert check_path(WALLED, [(3, 3)], OCTILE) == 0.0


NO_PATHS: dict[str, Any] = {
    "empty": np.empty((0, 2), dtype=np.int64),
    "empty list": [],
    "1-D": [0, 1],
    "one column": [[0], [1]],
    "three columns": [[0, 0, 0], [0, 1, 0]],
    "3-D": [[[0, 0]]],
    "halves": [[0, 0], [0, 0.5]],
    "NaN": [[0, np.nan]],
}


@pytest.mark.parametrize("path", NO_PATHS.values(), ids=NO_PATHS)
def test_check_path_refuses_what_is_no_path(path: npt.ArrayLike) -> None:
    """An empty path, another shape and broken cells are ValueErrors that speak of the path."""
    with pytest.raises(ValueError, match="path") as error:
        check_path(WALLED, path)
    assert "\n" not in str(error.value)


# --- grids and cells at the door ----------------------------------------------------------------


def read_only(grid: Array) -> Array:
    """Return a copy that cannot be written."""
    copy = grid.copy()
    copy.setflags(write=False)
    return copy


FLAVOURS: dict[str, Callable[[Array], Any]] = {
    "bool": lambda grid: grid.astype(np.bool_),
    "int64": lambda grid: grid.astype(np.int64),
    "int8": lambda grid: grid.astype(np.int8),
    "float": lambda grid: grid.astype(np.float64),
    "float32": lambda grid: grid.astype(np.float32),
    "big-endian": lambda grid: grid.astype(">i4"),
    "Fortran": np.asfortranarray,
    "sliced": lambda grid: np.repeat(np.repeat(grid, 2, axis=0), 3, axis=1)[::2, ::3],
    "reversed": lambda grid: grid[::-1, ::-1].copy()[::-1, ::-1],
    "transposed": lambda grid: grid.T.copy().T,
    "read-only": read_only,
    "read-only bool": lambda grid: read_only(grid.astype(np.bool_)),
    "nested list": lambda grid: grid.tolist(),
}


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_any_array_of_zeros_and_ones_is_a_grid(flavour: str) -> None:
    """The answers do not depend on dtype, order, strides or writability, and the caller's grid is
    left as it was.
    """
    base = (np.random.default_rng(5).random((13, 71)) < 0.2).astype(np.uint8)
    start = (0, 0)
    goal = (12, 70)
    base[start] = 0
    base[goal] = 0
    grid = FLAVOURS[flavour](base.copy())
    for search in (bfs, astar):
        solution = search(grid, start, goal, OCTILE)
        expected = search(base, start, goal, OCTILE)
        assert expected.cost > 0
        np.testing.assert_array_equal(solution.path, expected.path)
        assert solution.cost == expected.cost
        assert solution.iterations == expected.iterations
        assert check_path(grid, solution.path, OCTILE) == check_path(base, expected.path, OCTILE)
    distances = distance_field(base, start, OCTILE)
    np.testing.assert_array_equal(distance_field(grid, start, OCTILE), distances)
    np.testing.assert_array_equal(np.array(grid), base)


@pytest.mark.parametrize(
    "cell_type", [list, tuple, np.array, lambda cell: np.array(cell, dtype=np.uint8)]
)
def test_cells_may_be_any_pair_of_integers(cell_type: Callable[[Cell], Any]) -> None:
    """Lists, tuples and arrays of any integer type are cells."""
    grid = np.zeros((3, 4), dtype=np.uint8)
    assert bfs(grid, cell_type((0, 1)), cell_type((2, 3))).cost == 4.0
    assert astar(grid, cell_type((0, 1)), cell_type((2, 3))).cost == 4.0
    assert distance_field(grid, cell_type((0, 1)))[2, 3] == 4.0


DOORS: dict[str, Callable[[Any], Any]] = {
    "bfs": lambda grid: bfs(grid, (0, 0), (0, 0)),
    "astar": lambda grid: astar(grid, (0, 0), (0, 0)),
    "distance_field": lambda grid: distance_field(grid, (0, 0)),
    "check_path": lambda grid: check_path(grid, np.zeros((1, 2), dtype=np.int64)),
}
BAD_GRIDS = [
    pytest.param(np.zeros(5), "5|1-?D", id="1-D"),
    pytest.param(np.zeros((2, 3, 4)), "2, 3, 4|3-?D", id="3-D"),
    pytest.param(np.array(0), r"\(\)|0-?D", id="0-D"),
    pytest.param(Path("map.pgm"), "got a PosixPath, expected an array of 0 free", id="a path"),
    pytest.param(np.array([[0, 2]]), "2", id="a two"),
    pytest.param(np.array([[0, -1]]), "-1", id="minus one"),
    pytest.param(np.array([[0, 255]], dtype=np.uint8), "255", id="an image"),
    pytest.param(np.array([[0, 256]]), "256", id="256, which is 0 as a byte"),
    pytest.param(np.array([[0, 0.5]]), r"0\.5", id="a half"),
    pytest.param(np.array([[0, np.nan]]), "(?i)nan", id="NaN"),
    pytest.param(np.zeros((0, 5)), "0", id="no rows"),
    pytest.param(np.zeros((5, 0)), "0", id="no columns"),
    pytest.param([[0, 0], [0]], "", id="ragged"),
    pytest.param([["a", "b"]], "", id="text"),
    pytest.param(np.array([[0, 1, 7, -5, 2]]), r"\b7\b", id="the first of three"),
    pytest.param(
        np.array([[0, 1, 7, -5, 2]], np.float32), r"\b7\.0", id="the first of three floats"
    ),
    pytest.param(np.array([[0, 0], [2, 0]], np.uint8), r"\b2\b", id="a two alone"),
    pytest.param(np.zeros((1, 2**24 + 1), dtype=np.uint8), "16777216", id="beyond the limit"),
]


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize(("grid", "value"), BAD_GRIDS)
def test_a_bad_grid_is_refused(door: str, grid: object, value: str) -> None:
    """Another rank, other values, no cells or too many: one line that speaks of the grid and says
    what was found.
    """
    with pytest.raises(ValueError, match="grid") as error:
        DOORS[door](grid)
    assert re.search(value, str(error.value))
    assert "\n" not in str(error.value)


@movements
@pytest.mark.parametrize("shared", [False, True], ids=["own grids", "one grid"])
@pytest.mark.parametrize(
    ("search", "costs"), [("bfs", None), ("astar", None), ("astar", (1, 2, 9)), ("bfs", (1, 99))]
)
def test_a_batch_is_its_problems(
    search: str, costs: tuple[int, ...] | None, shared: bool, movement: Movement
) -> None:
    """Each as the reference solves it, whatever the others of the batch left behind."""
    count = 12
    source = np.random.default_rng(5)
    maps = (source.random((1 if shared else count, 9, 11)) < 0.35).astype(np.uint8)
    maps[:, 0, 1] = 1  # (0, 0) becomes a corner that nothing leads out of
    maps[:, 1, :2] = 1
    maps[:, 0, 0] = 0
    terrains = terrain_on(maps, costs, source)
    grids = [maps[0 if shared else k] for k in range(count)]
    not_in_the_corner = [np.argwhere(grid == 0)[1:] for grid in grids]
    starts = np.array([source.choice(cells) for cells in not_in_the_corner])
    goals = np.array([source.choice(cells) for cells in not_in_the_corner])
    starts[3] = (0, 0)
    batch = search_batch(
        search,
        maps[0] if shared else maps,
        starts,
        goals,
        movement,
        terrain=terrains[0] if shared and costs else terrains,
    )
    assert len(batch.offsets) == count + 1
    assert batch.offsets[0] == 0
    assert batch.offsets[-1] == len(batch.cells)
    for k in range(count):
        start = tuple(starts[k].tolist())
        goal = tuple(goals[k].tolist())
        expected = reference.SEARCHES[search](
            grids[k].tolist(),
            start,
            goal,
            movement,
            terrains[0 if shared else k].tolist() if costs else None,
        )
        path = batch.path(k)
        assert [tuple(cell) for cell in path.tolist()] == expected.path
        assert batch.cost[k] == expected.cost
        assert batch.iterations[k] == expected.iterations
    assert batch.cost[3] == -1
    assert [path.tolist() for path in batch.paths()] == [batch.path(k).tolist() for k in range(12)]
    masks = batch.masks(maps.shape)
    assert masks.dtype == np.uint8
    assert masks.shape == (count, 9, 11)
    for mask, path in zip(masks, batch.paths(), strict=True):
        expected_mask = np.zeros((9, 11))
        for cell in path.tolist():
            expected_mask[tuple(cell)] = 1
        np.testing.assert_array_equal(mask, expected_mask)


def test_paths_of_a_batch_outside_its_problems_or_maps() -> None:
    """Numbers count from the end, too; a batch of no problem has no path and no mask."""
    grids = np.zeros((2, 3, 4), np.uint8)
    batch = search_batch("astar", grids, [(0, 0), (2, 0)], [(0, 3), (0, 0)])
    assert batch.path(-1).tolist() == [[2, 0], [1, 0], [0, 0]]
    for k in (2, -3):
        with pytest.raises(IndexError, match=f"path {k} is out of range for 2 problems"):
            batch.path(k)
    message = r"shape: got 3 x 3 cells, but a path has the cell \(0, 3\)"
    with pytest.raises(ValueError, match=message):
        batch.masks((3, 3))
    empty = search_batch("astar", grids[0], np.empty((0, 2), int), np.empty((0, 2), int))
    assert (empty.paths(), empty.masks((3, 4)).shape) == ([], (0, 3, 4))
    assert len(empty) == 4  # the four arrays, as they were


@pytest.mark.parametrize("k", [1.0, slice(None), "0", None, (0, 1)])
def test_a_path_is_asked_for_by_its_number(k: Any) -> None:
    """The error names what gives several paths."""
    batch = search_batch("astar", np.zeros((1, 3, 4), np.uint8), [(0, 0)], [(0, 3)])
    with pytest.raises(TypeError, match=r"expected the number of a problem; paths\(\) returns"):
        batch.path(k)


@pytest.mark.parametrize("shape", [(4,), 4, (), (3.0, 4.0), (0, 4), (-3, 4), None, "34"])
def test_masks_have_the_shape_of_maps(shape: Any) -> None:
    """A shape of one number, of other numbers than whole ones, or none at all is refused."""
    batch = search_batch("astar", np.zeros((1, 3, 4), np.uint8), [(0, 0)], [(0, 3)])
    with pytest.raises(ValueError, match=r"^shape: got .*, expected \(H, W\) or \(B, H, W\)"):
        batch.masks(shape)


# --- costs of any scale -------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.uint16, np.int64])
def test_terrain_of_costs_spans_its_range(dtype: Any) -> None:
    """The largest cost is 255, no free cell is 0, and occupied cells are, on each map by itself."""
    costs = np.array([[[0, 100, 210], [900, 400, 50]], [[1, 1, 1], [2, 2, 0]]]).astype(dtype)
    grids = np.array([[[0, 0, 0], [1, 0, 0]], [[1, 1, 1], [1, 1, 1]]], np.uint8)
    expected = [[[1, 64, 134], [0, 255, 32]], [[0, 0, 0], [0, 0, 0]]]
    assert terrain_from_costs(costs, grids).tolist() == expected
    assert terrain_from_costs(costs[0], grids[0]).tolist() == expected[0]


def test_terrain_of_costs_has_the_resolution_that_it_states() -> None:
    """Half of 1/255 of the largest cost, whatever the scale; and the paths are those of the
    reference on the rounded costs.
    """
    source = np.random.default_rng(4)
    grids = (source.random((5, 12, 12)) < 0.2).astype(np.uint8)
    grids[:, 0, 0] = grids[:, -1, -1] = 0
    for scale in (1e-12, 1, 1e30):
        costs = np.where(grids, np.nan, scale * source.uniform(0.01, 1, grids.shape))
        terrain = terrain_from_costs(costs, grids)
        largest = np.nanmax(costs, axis=(1, 2), keepdims=True)
        errors = np.abs(terrain * largest / 255 - costs)[grids == 0]
        assert errors.max() <= largest.max() / 510 * (1 + 1e-6)
        ends = np.zeros((5, 2), int), np.full((5, 2), 11)
        found = search_batch("astar", grids, *ends, OCTILE, terrain=terrain)
        for k in range(5):
            truth = reference.reference_astar(
                grids[k].tolist(), (0, 0), (11, 11), OCTILE, terrain[k].tolist()
            )
            assert [tuple(cell) for cell in found.path(k).tolist()] == truth.path
    assert (terrain_from_costs(np.zeros((2, 2)), np.zeros((2, 2))) == 1).all()


@pytest.mark.parametrize(
    ("dtype", "scale"),
    [
        (np.float16, 6e-8),  # the smallest positive number of the dtype
        (np.float16, 6e4),
        (np.float32, 1.4e-45),
        (np.float32, 7e-40),
        (np.float32, 3e38),
        (np.float64, 5e-324),
        (np.float64, 1e-310),
        (np.float64, 1.7e308),
        (np.longdouble, 1e-320),
    ],
)
def test_terrain_of_tiny_and_huge_costs_is_rounded_as_fractions_are(
    dtype: Any, scale: float
) -> None:
    """Python's fractions neither overflow nor underflow. No free cell becomes an occupied one."""
    shares = np.array([[1.0, 0.7, 0.31], [0.013, 0.5, 0.0]])
    costs = (shares * scale).astype(dtype)
    exact = [[Fraction(*cost.as_integer_ratio()) for cost in row] for row in costs]
    largest = max(max(row) for row in exact)
    expected = [[max(1, round(255 * cost / largest)) for cost in row] for row in exact]
    assert terrain_from_costs(costs, np.zeros((2, 3))).tolist() == expected


@pytest.mark.parametrize(
    ("costs", "message"),
    [
        ([[1.0, math.nan]], r"costs: got nan at \(0, 1\), expected a finite number of at least 0"),
        ([[1.0, -0.5]], r"costs: got -0.5 at \(0, 1\), expected"),
        ([[math.inf, 1.0]], r"costs: got inf at \(0, 0\), expected"),
        ([[1.0, 1j]], "costs: got dtype complex128, expected numbers"),
        ([[1.0, 1.0, 1.0]], r"costs: got shape \(1, 3\), expected \(1, 2\)"),
        (
            np.ones((1, 1, 1, 2)),
            r"costs: got shape \(1, 1, 1, 2\), expected \(H, W\) or \(B, H, W\)",
        ),
        (None, r"costs: got shape \(\), expected"),
    ],
)
def test_costs_that_are_none_are_refused(costs: Any, message: str) -> None:
    """By cell, where one cell is wrong."""
    with pytest.raises(ValueError, match=message):
        terrain_from_costs(costs, [[0, 0]])
    with pytest.raises(ValueError, match="grid: got the value 2"):
        terrain_from_costs([[1.0, 1.0]], [[0, 2]])


@pytest.mark.parametrize("costs", [[[0.5, 0.7]], [[300, 1]]])
@pytest.mark.parametrize(
    "search",
    [
        lambda terrain: search_batch("astar", [[0, 0]], [(0, 0)], [(0, 1)], terrain=terrain),
        lambda terrain: astar([[0, 0]], (0, 0), (0, 1), terrain=terrain),
    ],
    ids=["batch", "one"],
)
def test_terrain_of_other_costs_names_the_function_that_makes_it(
    search: Callable[[Any], Any], costs: Any
) -> None:
    """Searches are exact, so they do not round by themselves."""
    with pytest.raises(ValueError, match=r"mapdata.terrain_from_costs\(costs, grids\) makes"):
        search(costs)


ROUGH = 3 * (1 - WALLED)
"""Terrain with the obstacles of `WALLED`."""

on_any_map = pytest.mark.parametrize("terrain", [None, ROUGH], ids=["uniform", "terrain"])


@on_any_map
@pytest.mark.parametrize("cell", [(-1, 0), (0, -1), (4, 0), (0, 5), (1, 1)], ids=str)
def test_a_bad_problem_of_a_batch_is_named(cell: Cell, terrain: Bytes | None) -> None:
    """By its number and its end; so is a batch that has not as many grids, starts and goals."""
    good = np.zeros((3, 2), np.int64)
    bad = good.copy()
    bad[1] = cell
    for copies in (1, [1, 1, 1]):
        grid = np.multiply.outer(copies, WALLED)
        own_terrain = None if terrain is None else np.multiply.outer(copies, terrain)
        for ends, name in (((bad, good), "start"), ((good, bad), "goal")):
            with pytest.raises(ValueError, match=f"problem 1: {name}: "):
                search_batch("astar", grid, *ends, terrain=own_terrain)
    for grids, count in (([WALLED] * 2, 3), ([WALLED] * 3, 2)):
        with pytest.raises(ValueError, match=f"got {len(grids)} grids, 3 starts and {count} goals"):
            search_batch("astar", grids, good, good[:count])


BAD_CELLS: list[tuple[float, ...]] = [
    (-1, 0),
    (0, -1),
    (4, 0),
    (0, 5),
    (2**40, 0),
    (1, 1),
    (0.5, 1.0),
    (np.nan, 0),
    (0,),
    (0, 0, 0),
    (),
]


@on_any_map
@pytest.mark.parametrize("cell", BAD_CELLS, ids=str)
@pytest.mark.parametrize("search", [bfs, astar])
@pytest.mark.parametrize("name", ["start", "goal"])
def test_a_bad_start_or_goal_is_named(
    name: str, search: Planner, cell: tuple[float, ...], terrain: Bytes | None
) -> None:
    """Outside, negative, occupied, broken, of another length: the message names which of the two,
    and its value.
    """
    ends = (cell, (0, 0)) if name == "start" else ((0, 0), cell)
    with pytest.raises(ValueError, match=rf"\b{name}\b") as error:
        search(WALLED, *ends, terrain=terrain)
    message = str(error.value)
    assert re.search(named(cell) if cell else r"\(\)|\[\]", message), message
    assert {"start", "goal"} & set(re.findall(r"\w+", message)) == {name}
    assert "\n" not in message


@on_any_map
@pytest.mark.parametrize("cell", BAD_CELLS, ids=str)
def test_a_bad_goal_of_a_field_is_named(cell: tuple[Any, ...], terrain: Bytes | None) -> None:
    """The distance field checks its goal as the planners do."""
    with pytest.raises(ValueError, match="goal") as error:
        distance_field(WALLED, cell, terrain=terrain)
    assert re.search(named(cell) if cell else r"\(\)|\[\]", str(error.value))


def test_an_occupied_end_names_the_nearest_free_cell() -> None:
    """Which cells `inflate` has occupied cannot be seen in the map of the user."""
    grid = np.ones((9, 9), np.uint8)
    with pytest.raises(ValueError, match=r"start: \(4, 4\) is on an occ.* map has no free cell$"):
        astar(grid, (4, 4), (0, 0))
    grid[1, 1] = grid[4, 7] = 0
    for cell, nearest in (((4, 4), (4, 7)), ((0, 0), (1, 1)), ((2, 3), (1, 1))):
        message = (
            rf"is on an occupied cell; the nearest free cell is \({nearest[0]}, {nearest[1]}\)"
        )
        with pytest.raises(ValueError, match=f"^goal: .*{message}$"):
            bfs(grid, (1, 1), cell)
        with pytest.raises(ValueError, match=f"^goal: .*{message}$"):
            distance_field(grid, cell)
        with pytest.raises(ValueError, match=f"^problem 0: start: .*{message}$"):
            search_batch("astar", grid[None], [cell], [(1, 1)])


def test_the_nearest_free_cell_of_large_maps_is_the_nearest() -> None:
    """Squares around the cell are searched first; a cell in a corner of one is not the nearest."""
    draws = np.random.default_rng(3)
    for size in ((40, 300), (200, 200)):
        for free in (1, 3, 60):
            grid = np.ones(size, np.uint8)
            free_cells = draws.integers(0, size, (free, 2))
            grid[tuple(free_cells.T)] = 0
            cell = tuple(np.argwhere(grid)[draws.integers(grid.sum())].tolist())
            with pytest.raises(ValueError, match="nearest free cell is") as said:
                astar(grid, cell, tuple(free_cells[0].tolist()))
            named = tuple(map(int, re.findall("[0-9]+", str(said.value).partition("; ")[2])))
            assert grid[named] == 0
            squared = ((free_cells - cell) ** 2).sum(axis=1)
            assert ((np.array(named) - cell) ** 2).sum() == squared.min()
    grid = np.ones((40, 40), np.uint8)
    grid[8, 8] = grid[0, 9] = 0  # the corner of the first square, and nearer beside it
    with pytest.raises(ValueError, match=r"nearest free cell is \(0, 9\)"):
        astar(grid, (0, 0), (8, 8))


def test_a_search_that_was_forgotten_is_named() -> None:
    """The maps stand in its place then."""
    grids = np.zeros((1, 3, 3), np.uint8)
    with pytest.raises(TypeError, match='search: got ndarray, expected "bfs" or "astar"'):
        search_batch(grids, [(0, 0)], [(2, 2)], Movement())  # type: ignore[arg-type]


@pytest.mark.parametrize("cell", [(-1, 0), (0, 5), (10**18, -(10**18))])
def test_an_end_outside_of_the_map_has_no_nearest_cell(cell: Cell) -> None:
    """Only the map's size helps there."""
    with pytest.raises(ValueError, match=r"start: .* is outside the map of 5 x 5 cells$"):
        search_batch("astar", np.zeros((1, 5, 5), np.uint8), [cell], [(0, 0)])
