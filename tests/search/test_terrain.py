"""What holds on terrain alone: exact costs and their bound, optimal moves, and what is refused.

That searches on terrain are those of the reference and of scipy is tested with those on grids, in
test_api.py and test_labels.py.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from math import isqrt, sqrt
from types import SimpleNamespace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
import pytest
from helpers import reference
from helpers.grids import scipy_distances
from helpers.reference import Cell
from helpers.specs import MOVEMENTS, movements

from mapdata import Terrain, astar, bfs, check_path, distance_field, generate
from mapdata.arrays import Bytes, Floats
from mapdata.generators.maps import Maps, pack
from mapdata.jit import kernel
from mapdata.movement import Movement
from mapdata.search import hardness, inflate, inflate_terrain, label, search_batch
from mapdata.search.api import solve_batch
from mapdata.search.ground import as_ground, load_terrain, terrain_heuristic
from mapdata.search.kernels import search_memory
from mapdata.search.lattice import (
    ASTAR,
    DIAGONAL,
    MAX_PATH_COST,
    UNIT,
    MoveRule,
    lattice_of,
    move_rule,
)
from mapdata.search.solving import solve_problems
from mapdata.search.terrain import min_cell_costs, shortest_terrain_costs

Array: TypeAlias = npt.NDArray[Any]

OCTILE = Movement(8)
CUTTING = Movement(8, corner_cutting=True)

VALUES = [
    (1,),
    (255,),
    (1, 2),
    (8, 12, 53, 77, 92),
    tuple(range(1, 11)),
    tuple(range(1, 256)),
]
"""Sets of cell costs: with many ties, with few, and with the largest and the smallest cost."""


class Problem(NamedTuple):
    """Terrain with two free cells."""

    terrain: Bytes
    start: Cell
    goal: Cell

    @property
    def grid(self) -> Bytes:
        """Return the grid without costs."""
        grid: Bytes = (self.terrain == 0).astype(np.uint8)
        return grid


def random_problem(
    source: np.random.Generator,
    shape: tuple[int, int],
    values: tuple[int, ...],
    occupied_share: float,
) -> Problem:
    """Draw terrain with these cell costs, and two free cells of it."""
    terrain = source.choice(np.array(values, np.uint8), shape)
    occupied = source.random(shape) < occupied_share
    start, goal = (tuple(cell) for cell in source.integers(0, shape, size=(2, 2)).tolist())
    occupied[start] = False
    occupied[goal] = False
    terrain[occupied] = 0
    return Problem(terrain, start, goal)


def optimal_moves(terrain: Bytes, goal: Cell, movement: Movement) -> Bytes:
    """Return the optimal moves of every cell as bit sets, (H, W) uint8."""
    lattice, scratch = search_memory(terrain.shape, move_rule(movement))
    padded = load_terrain(terrain, lattice, np.zeros(lattice.cells, np.uint8), scratch.came_from)
    cell = (goal[0] + 1) * lattice.stride + goal[1] + 1
    assert shortest_terrain_costs(np.array([cell]), padded, lattice, scratch) == 0
    rows = terrain.shape[0] + 2
    return scratch.came_from.reshape(rows, lattice.stride)[1:-1, 1:-1]


# --- equal to the reference ---------------------------------------------------------------------


@movements
@pytest.mark.parametrize("count", [12, pytest.param(2000, marks=pytest.mark.soak)])
def test_optimal_moves_equal_the_reference(count: int, movement: Movement) -> None:
    """All of each cell, and with them the path, its cost and the expansions of A*."""
    source = np.random.default_rng(6)
    for number in range(count):
        problem = random_problem(
            source, (16, 17), VALUES[number % len(VALUES)], (0.0, 0.1, 0.3)[number % 3]
        )
        terrain, start, goal = problem
        grid = problem.grid.tolist()
        solution = astar(problem.grid, start, goal, movement, terrain=terrain)
        expected = reference.reference_astar(grid, start, goal, movement, terrain.tolist())
        assert [tuple(cell) for cell in solution.path.tolist()] == expected.path
        assert solution[1:] == expected[1:]
        np.testing.assert_array_equal(
            optimal_moves(terrain, goal, movement),
            reference.reference_moves(grid, goal, movement, terrain.tolist()),
        )


@pytest.mark.parametrize("goal", [(20, 79), (59, 79)], ids=["solvable", "unsolvable"])
def test_astar_equals_the_reference_where_many_open_cells_have_nearly_the_same_f(
    goal: Cell,
) -> None:
    """One cell of cost 255 makes the buckets of the open list wide, so that hundreds of pushes lie
    in one of them and its heap has to grow.
    """
    terrain = np.random.default_rng(4).integers(1, 3, (60, 80)).astype(np.uint8)
    terrain[0, 79] = 255
    terrain[57:, 76] = 0
    terrain[57, 76:] = 0
    grid = (terrain == 0).astype(np.uint8)
    start = (30, 0)
    solution = astar(grid, start, goal, CUTTING, terrain=terrain)
    expected = reference.reference_astar(grid.tolist(), start, goal, CUTTING, terrain.tolist())
    assert [tuple(cell) for cell in solution.path.tolist()] == expected.path
    assert solution[1:] == expected[1:]


# --- terrain of ones ----------------------------------------------------------------------------


@movements
def test_terrain_of_ones_changes_nothing(movement: Movement) -> None:
    """Even in a search of thousands of expansions, all cells come in the same order."""
    grid = (np.random.default_rng(1).random((150, 170)) < 0.3).astype(np.uint8)
    grid[0, 0] = grid[149, 169] = 0
    with_terrain = astar(grid, (0, 0), (149, 169), movement, terrain=1 - grid)
    without = astar(grid, (0, 0), (149, 169), movement)
    assert with_terrain.path.tolist() == without.path.tolist()
    assert with_terrain[1:] == without[1:]
    field = distance_field(grid, (149, 169), movement, terrain=1 - grid)
    np.testing.assert_array_equal(field, distance_field(grid, (149, 169), movement))


# --- equal to scipy and scikit-image ------------------------------------------------------------

Oracle: TypeAlias = Callable[[Bytes, Cell, Movement], Floats]


def scipy_field(terrain: Bytes, goal: Cell, movement: Movement) -> Floats:
    """Return the costs to ``goal`` by scipy's Dijkstra, -1 where there is no path."""
    costs: Floats = scipy_distances(terrain == 0, [goal], movement, terrain)[0]
    return costs


def skimage_field(terrain: Bytes, goal: Cell, movement: Movement) -> Floats:
    """Return the costs to ``goal`` by scikit-image, which cuts corners, -1 without a path.

    MCP_Geometric has our rule for 4 moves and for diagonals of sqrt(2). MCP adds up the cells of a
    path, whatever its moves, so that for diagonals of 1 half of both ends is too much.
    """
    graph = pytest.importorskip("skimage.graph")
    weights = np.where(terrain > 0, terrain, np.inf)
    is_diagonal_one = movement.diagonal_cost == 1
    search_class = graph.MCP if is_diagonal_one else graph.MCP_Geometric
    costs, _ = search_class(weights, fully_connected=movement.connectivity == 8).find_costs([goal])
    if is_diagonal_one:
        costs = costs - (terrain[goal] + terrain.astype(float)) / 2
    return np.where(np.isfinite(costs) & (terrain > 0), costs, -1)


def compare_with(oracle: Oracle, movement: Movement, count: int, size: int) -> None:
    """Compare the costs of ``count`` maps with those of an oracle.

    Whole costs are equal. Others differ by the rounding of the oracle's sums; that ties are judged
    exactly is what the comparison with the reference shows.
    """
    source = np.random.default_rng(5)
    for number in range(count):
        values = VALUES[number % len(VALUES)]
        occupied_share = (0.0, 0.1, 0.3)[number % 3]
        terrain, _, goal = random_problem(source, (size, size + 3), values, occupied_share)
        field = distance_field(terrain == 0, goal, movement, terrain=terrain)
        expected = oracle(terrain, goal, movement)
        if movement.connectivity == 4 or movement.diagonal_cost == 1:
            np.testing.assert_array_equal(field, expected)
        else:
            np.testing.assert_allclose(field, expected, rtol=1e-7)


@pytest.mark.parametrize("count", [100, pytest.param(3334, marks=pytest.mark.soak)])
@pytest.mark.parametrize(
    "movement",
    [m for m in MOVEMENTS if m.connectivity == 4 or m.corner_cutting],
    ids=["4", "8-cutting", "8-cutting-one"],
)
def test_costs_equal_those_of_scikit_image(movement: Movement, count: int) -> None:
    """Where corners may be cut, or no move is diagonal."""
    pytest.importorskip("skimage.graph")
    compare_with(skimage_field, movement, count, 21)


@pytest.mark.soak
@movements
def test_costs_of_ten_thousand_maps_equal_those_of_scipy(movement: Movement) -> None:
    """2,000 maps for each movement."""
    compare_with(scipy_field, movement, 2000, 32)


# --- batches ------------------------------------------------------------------------------------


def test_a_batch_may_allow_occupied_ends_of_terrain() -> None:
    """There is no path, and no cell is expanded; the problem after it is solved as usual."""
    terrain = np.array([[3, 0, 3], [3, 3, 3]], np.uint8)
    ends = [(0, 0), (0, 0)], [(0, 1), (1, 0)]
    solutions = solve_batch(ASTAR, terrain == 0, *ends, OCTILE, True, terrain=terrain)
    assert solutions.cost.tolist() == [-1.0, 3.0]
    assert solutions.iterations.tolist() == [0, 2]
    assert solutions.offsets.tolist() == [0, 0, 2]


@pytest.mark.parametrize("dtype", [np.uint8, np.int64])
def test_a_batch_without_problems_is_solved_on_terrain(dtype: type[np.integer[Any]]) -> None:
    """There is no map either, and so no terrain to load."""
    grids = np.zeros((0, 3, 4), np.uint8)
    no_cells = np.zeros((0, 2), np.int64)
    solutions = search_batch("astar", grids, no_cells, no_cells, terrain=grids.astype(dtype))
    assert solutions.offsets.tolist() == [0]
    assert len(solutions.cells) == len(solutions.cost) == len(solutions.iterations) == 0


@pytest.mark.parametrize("has_terrain", [False, True])
def test_the_kernel_reads_no_map_without_problems(has_terrain: bool) -> None:
    """As Python, where an index out of bounds is an error."""
    grids = np.zeros((0, 3, 4), np.uint8)
    no_cells = np.zeros((0, 2), np.int64)
    ground = as_ground(grids, grids if has_terrain else None)
    scratch = SimpleNamespace(came_from=np.empty(0, np.uint8))
    compiled: Any = solve_problems
    solved = compiled.py_func(
        *ground, no_cells, no_cells, 0, ASTAR, None, move_rule(OCTILE), scratch
    )
    assert (solved.done, solved.high_cost) == (0, 0)


# --- costs that are too high --------------------------------------------------------------------

STRIP = np.full((1, 9000), 255, np.uint8)
"""A corridor whose costs pass the bound: a move costs 255, so 4,112 moves cost 1,048,560."""

FREE_STRIP = np.zeros_like(STRIP)


def test_costs_below_the_bound_are_exact() -> None:
    """The last cell before the bound is served, from both searches."""
    cost = 255.0 * 4112
    assert 2 * cost < MAX_PATH_COST <= 2 * (cost + 255)
    assert astar(FREE_STRIP, (0, 0), (0, 4112), OCTILE, terrain=STRIP).cost == cost
    short = STRIP[:, :4113]
    assert distance_field(short == 0, (0, 0), OCTILE, terrain=short)[0, 4112] == cost


def test_a_cost_at_the_bound_is_refused() -> None:
    """It is refused rather than served as unreachable, and the message names the cost."""
    message = r"terrain: a path costs 1,048,815, and costs are exact only below 1,048,576"
    with pytest.raises(ValueError, match=message):
        astar(FREE_STRIP, (0, 0), (0, 4113), OCTILE, terrain=STRIP)
    long = STRIP[:, :4114]
    with pytest.raises(ValueError, match=message):
        distance_field(long == 0, (0, 0), OCTILE, terrain=long)
    with pytest.raises(ValueError, match=f"problem 1: {message}"):
        search_batch(
            "astar", FREE_STRIP, [(0, 0), (0, 0)], [(0, 3), (0, 4113)], OCTILE, terrain=STRIP
        )


def test_a_near_goal_on_a_map_with_high_costs_is_not_refused() -> None:
    """Only costs that a search meets matter."""
    assert astar(FREE_STRIP, (0, 4000), (0, 4003), OCTILE, terrain=STRIP).cost == 765.0


@kernel
def heuristic_of(columns: int, terrain: Bytes, rule: MoveRule) -> int:
    """Return the doubled heuristic of a way of ``columns`` columns."""
    lattice = lattice_of(terrain.shape, rule)
    values = np.zeros(lattice.cells, np.uint8)
    padded = load_terrain(terrain, lattice, values, values.copy())
    heuristic: int = terrain_heuristic(1, columns, padded, lattice)
    return heuristic


@pytest.mark.parametrize("value", [1, 200, 255])
def test_a_heuristic_beyond_the_bound_does_not_overflow(value: int) -> None:
    """From the bound on it is the bound; before, it is what unbounded integers give."""
    terrain = np.full((1, 1), value, np.uint8)
    last_exact = MAX_PATH_COST // (2 * value)
    for columns in (1, last_exact - 1, last_exact + 1, 2 * last_exact, 4 * last_exact, 2**24):
        exact = 2 * value * ((columns - 1) * UNIT + DIAGONAL)
        heuristic = heuristic_of(columns, terrain, move_rule(OCTILE))
        assert heuristic == min(exact, MAX_PATH_COST * UNIT)


def test_a_goal_beyond_the_bound_and_a_wall_has_no_path() -> None:
    """All cells before the wall are expanded, and no cost is too high."""
    walled = STRIP.copy()
    walled[0, 5] = 0
    solution = astar(walled == 0, (0, 0), (0, 8999), OCTILE, terrain=walled)
    assert (solution.cost, solution.iterations) == (-1.0, 5)


def test_whole_costs_have_no_bound() -> None:
    """With 4 moves, and with diagonals of 1."""
    for movement in (Movement(), Movement(8, diagonal_cost=1)):
        solution = astar(FREE_STRIP, (0, 0), (0, 8999), movement, terrain=STRIP)
        assert solution.cost == 255.0 * 8999
        field = distance_field(FREE_STRIP, (0, 0), movement, terrain=STRIP)
        assert field[0, 8999] == np.float32(255 * 8999)


def test_costs_up_to_the_dearest_move_behind_the_bound_are_ordered() -> None:
    """What `test_costs_order_all_paths_exactly` shows below the bound holds for the costs that a
    search compares before it refuses a map: up to 722 above the bound.
    """
    for diagonal in range(isqrt(MAX_PATH_COST**2 // 2), isqrt((MAX_PATH_COST + 722) ** 2 // 2) + 2):
        whole_part = isqrt(2 * diagonal * diagonal)
        assert whole_part * UNIT < diagonal * DIAGONAL < (whole_part + 1) * UNIT
    assert 2 * 255 * sqrt(2) < 722


# --- arguments ----------------------------------------------------------------------------------

BAD_TERRAIN: list[tuple[Any, str]] = [
    ([[1, 1]], "terrain: got shape (1, 2), expected (2, 2), that of the grid"),
    ([[1.0, 1.0], [1.0, 0.0]], "terrain: got dtype float64, expected integers from 0 to 255"),
    ([[1, 1], [-1, 0]], "terrain: got the value -1, expected integers from 0 to 255"),
    ([[1, 1], [256, 0]], "terrain: got the value 256, expected integers from 0 to 255"),
    ([[1, 1], [1, 1]], "terrain: got 1 at (1, 1), which is occupied in the grid"),
    ([[1, 0], [1, 0]], "terrain: got 0 at (0, 1), which is free in the grid"),
    ([[1], [1, 0]], "terrain: "),
]


@pytest.mark.parametrize(("terrain", "message"), BAD_TERRAIN)
def test_terrain_that_does_not_fit_the_grid_is_refused(terrain: Any, message: str) -> None:
    """By every function that takes it."""
    grid = [[0, 0], [0, 1]]
    calls: list[Callable[[], object]] = [
        lambda: astar(grid, (0, 0), (1, 0), terrain=terrain),
        lambda: bfs(grid, (0, 0), (1, 0), terrain=terrain),
        lambda: distance_field(grid, (0, 0), terrain=terrain),
        lambda: check_path(grid, [(0, 0), (1, 0)], terrain=terrain),
    ]
    for call in calls:
        with pytest.raises(ValueError, match=re.escape(message)):
            call()


def test_a_grid_with_other_numbers_is_refused_with_terrain() -> None:
    """The message is about the grid."""
    with pytest.raises(ValueError, match="grid: got the value 7"):
        astar(np.array([[0, 7]], np.uint8), (0, 0), (0, 0), terrain=[[1, 0]])


# --- the radius of a robot ----------------------------------------------------------------------


def test_terrain_is_inflated_like_its_grid() -> None:
    """Cells within the radius become 0, and the heuristic takes the smallest cost of the rest."""
    terrain = np.full((7, 9), 6, np.uint8)
    terrain[0, 0] = 1
    terrain[3, 4] = 0
    inflated = inflate_terrain(terrain, 1.5)
    np.testing.assert_array_equal(inflated == 0, inflate(terrain == 0, 1.5))
    assert set(inflated[inflated > 0].tolist()) == {6}
    solution = astar(inflated == 0, (1, 1), (1, 7), OCTILE, terrain=inflated)
    expected = reference.reference_astar(
        (inflated == 0).tolist(), (1, 1), (1, 7), OCTILE, inflated.tolist()
    )
    assert solution[1:] == expected[1:]


def test_the_smallest_costs_are_those_of_the_free_cells() -> None:
    """Occupied cells do not count; a map without a free cell has a cost that no cell has."""
    terrain = np.array([[[0, 7], [255, 9]], [[255, 255], [0, 0]], [[0, 0], [0, 0]]], np.uint8)
    assert min_cell_costs(terrain).tolist() == [7, 255, 256]
    assert min_cell_costs(terrain[0]) == 7


# --- hardness -----------------------------------------------------------------------------------


@movements
def test_hardness_is_exactly_one_where_the_path_costs_what_the_heuristic_says(
    movement: Movement,
) -> None:
    """Not 1 - 1e-16, whatever the smallest cost."""
    goals = np.argwhere(np.ones((9, 40)))[1:]
    starts = np.zeros_like(goals)
    for value in (1, 3, 7, 10, 77, 255):
        terrain = np.full((9, 40), value, np.uint8)
        costs = search_batch("astar", terrain == 0, starts, goals, movement, terrain=terrain).cost
        assert (hardness(costs, starts, goals, movement, value) == 1).all()


# --- labels -------------------------------------------------------------------------------------


def test_labels_refuse_terrain_that_does_not_fit() -> None:
    """Another number of maps, or a cell on which maps and terrain disagree."""
    maps = generate(Terrain((9, 11)), 4, range(12))
    terrain = maps.terrain
    assert terrain is not None
    with pytest.raises(ValueError, match="terrain: got 11 maps, expected 12"):
        label(replace(maps, terrain=terrain[1:]))
    with pytest.raises(ValueError, match=r"terrain: got 1 at \(\d+, "):
        label(replace(maps, terrain=np.ones_like(terrain)))


def test_labels_name_the_map_whose_costs_are_too_high() -> None:
    """Its number is that of the map, not its place in the batch."""
    maps = Maps.empty(OCTILE, (1, 4114), np.array([41, 57]), 2)
    maps.rooms[:] = 2
    maps.seed_points[:] = [[[0, 0], [0, 1]], [[0, 0], [0, 4113]]]
    terrain = np.full((2, 1, 4114), 255, np.uint8)
    terrain[0, 0, 1000] = 0  # so that no cost of map 41 is high
    maps.packed[:] = pack((terrain == 0).astype(np.uint8))
    with pytest.raises(ValueError, match="map 57: terrain: a path costs 1,048,815"):
        label(replace(maps, terrain=terrain))
