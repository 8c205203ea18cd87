"""Jump point search and A* with the exact goal field: costs equal those of A* on every problem, and
expansions and looks equal those of slow searches, cell by cell, written from the definitions.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count, product
from typing import NamedTuple

import numpy as np
import pytest
from helpers import reference
from helpers.examples import examples
from helpers.grids import serpentine
from helpers.reference import Cell
from helpers.specs import MOVEMENTS
from hypothesis import given
from hypothesis import strategies as st

from mapdata import PRESETS, MapGenerator, Maze, Movement, astar, check_path, generate, search_batch
from mapdata.arrays import Bytes, Ints
from mapdata.generators.maps import Maps
from mapdata.search.api import (
    BatchResult,
    solve_by_goal_fields,
    solve_by_jump_points,
    solve_by_landmarks,
)
from mapdata.search.jump_points import find_free_neighbours, jump_costs
from mapdata.search.kernels import search_memory
from mapdata.search.lattice import (
    INFINITY,
    UNIT,
    UNSEEN,
    WALL,
    cell_at,
    in_cells,
    move_rule,
)

EIGHT = MOVEMENTS[1:]
eight_moves = pytest.mark.parametrize(
    "movement", EIGHT, ids=["8", "8-one", "8-cutting", "8-cutting-one"]
)


class Problem(NamedTuple):
    """A map with two free cells."""

    grid: Bytes
    start: Cell
    goal: Cell


def solve_by_three_landmarks(
    grids: Bytes, starts: Ints, goals: Ints, movement: Movement
) -> tuple[BatchResult, Ints]:
    """Solve problems by A* with three landmarks, with the arguments of the other solvers."""
    return solve_by_landmarks(grids, starts, goals, movement, 3)


SOLVERS = (solve_by_jump_points, solve_by_goal_fields, solve_by_three_landmarks)

SHAPES = [(1, 1), (1, 30), (30, 1), (2, 2), (2, 9), (5, 8), (12, 12), (16, 9), (20, 20)]

WORD_SHAPES = [(3, 62), (63, 4), (5, 63), (64, 6), (9, 64), (65, 7), (4, 65), (127, 3), (5, 128)]
"""Shapes whose lines fill a word or two of bits, or all but some."""

FAMILIES: list[MapGenerator] = [
    Maze((15, 17)),
    Maze((16, 16), corridor=2, reopened=0.1),
    PRESETS["dungeon"],
    PRESETS["cave"],
    PRESETS["noise"],
]
"""Perfect mazes, mazes with loops, rooms, caves and scattered cells."""

BESIDE_OBSTACLE = "beside an obstacle"


def draw_free_cell(source: np.random.Generator, grid: Bytes, where: str) -> Cell:
    """Draw a free cell, anywhere or with an obstacle among its neighbours if there is such one."""
    free = np.argwhere(grid == 0)
    if where == BESIDE_OBSTACLE:
        occupied = np.pad(grid, 1, constant_values=1)
        crowded = [
            cell for cell in free if occupied[cell[0] : cell[0] + 3, cell[1] : cell[1] + 3].any()
        ]
        free = np.array(crowded) if crowded else free
    row, column = free[source.integers(len(free))].tolist()
    return row, column


def scattered(source: np.random.Generator, shape: tuple[int, int], share: float) -> Bytes:
    """Return a grid with this share of occupied cells, at least one of them free."""
    grid = (source.random(shape) < share).astype(np.uint8)
    grid[tuple(source.integers(0, shape))] = 0
    return grid


@st.composite
def problems(draw: st.DrawFn) -> Problem:
    """Draw a map of any shape or family, with start and goal, which may be equal."""
    source = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    family = draw(st.sampled_from(["scattered", "serpentine", *range(len(FAMILIES))]))
    if family == "scattered":
        shape = draw(st.sampled_from(SHAPES + WORD_SHAPES))
        grid = scattered(source, shape, draw(st.sampled_from([0.0, 0.05, 0.2, 0.4, 0.6])))
    elif family == "serpentine":
        grid = serpentine(11, 16, source)
    else:
        grid = generate(FAMILIES[family], int(source.integers(2**31)), range(1)).occupancy[0]
    where = draw(st.sampled_from(["anywhere", BESIDE_OBSTACLE]))
    start = draw_free_cell(source, grid, where)
    goal = start if draw(st.integers(0, 19)) == 0 else draw_free_cell(source, grid, where)
    return Problem(grid, start, goal)


# --- slow jump point search, from the definitions of the papers -----------------------------------


def weigh(cost: reference.Pair) -> int:
    """Order costs where a diagonal move costs sqrt(2), which decides what is pruned."""
    return reference.weigh(cost, Movement(8))


def step_from(cell: Cell, direction: Cell) -> Cell:
    """Return the neighbour of a cell in a direction (rows, columns)."""
    return cell[0] + direction[0], cell[1] + direction[1]


def direction_between(start: Cell, end: Cell) -> Cell:
    """Return the direction from one cell to another one in the same line."""
    return int(np.sign(end[0] - start[0])), int(np.sign(end[1] - start[1]))


def detour(
    grid: reference.Grid, start: Cell, end: Cell, middle: Cell, movement: Movement
) -> int | None:
    """Return the cost of the cheapest path around ``middle`` that stays beside it, if there is one.

    It has at most two moves: longer ones prune nothing.
    """
    costs = []
    for first, first_cost in reference.neighbours(grid, start, movement):
        if first == middle:
            continue
        if first == end:
            costs.append(weigh(first_cost))
        if max(abs(first[0] - middle[0]), abs(first[1] - middle[1])) <= 1:
            for second, second_cost in reference.neighbours(grid, first, movement):
                if second == end:
                    costs.append(weigh(reference.add(first_cost, second_cost)))
    return min(costs, default=None)


def unpruned(
    grid: reference.Grid, previous: Cell, cell: Cell, movement: Movement
) -> Iterator[Cell]:
    """Yield the neighbours that are reached from ``previous`` best by way of ``cell``.

    A neighbour is pruned if a path around the cell is cheaper, or after a straight move as cheap.
    """
    moves = dict(reference.neighbours(grid, previous, movement))
    is_straight = moves[cell][0] == 1
    for neighbour, cost in reference.neighbours(grid, cell, movement):
        if neighbour == previous:
            continue
        around = detour(grid, previous, neighbour, cell, movement)
        through = weigh(reference.add(moves[cell], cost))
        if around is None or through < around or (through == around and not is_straight):
            yield neighbour


RAYS = 8
"""Number of expansions that try a ray to the goal."""


class Jump(NamedTuple):
    """A cell that a scan found, the direction of the last move to it, and the cost of the scan."""

    target: Cell
    direction: Cell
    cost: reference.Pair


@dataclass
class SlowJumps:
    """Jump point search in plain Python, which counts the cells that it passes."""

    grid: reference.Grid
    goal: Cell
    movement: Movement
    looks: int = 1

    def can_step(self, cell: Cell, direction: Cell) -> bool:
        """Return whether the move from a cell is legal; it is a look if it is."""
        neighbours = dict(reference.neighbours(self.grid, cell, self.movement))
        is_legal = step_from(cell, direction) in neighbours
        self.looks += is_legal
        return is_legal

    def has_forced_neighbour(self, previous: Cell, cell: Cell) -> bool:
        """Return whether obstacles leave more neighbours unpruned than on an empty map."""
        direction = direction_between(previous, cell)
        natural = {step_from(cell, direction)}
        if all(direction):
            natural |= {step_from(cell, (direction[0], 0)), step_from(cell, (0, direction[1]))}
        return not set(unpruned(self.grid, previous, cell, self.movement)) <= natural

    def scan(self, cell: Cell, direction: Cell) -> Iterator[Jump]:
        """Yield the jump points in a direction, of diagonal scans those of their straight parts."""
        straight, diagonal = 0, 0
        while self.can_step(cell, direction):
            previous = cell
            cell = step_from(cell, direction)
            straight += not all(direction)
            diagonal += all(direction)
            if cell == self.goal or self.has_forced_neighbour(previous, cell):
                yield Jump(cell, direction, (straight, diagonal))
                return
            if all(direction):
                for part in reference.STRAIGHT:
                    if part in ((direction[0], 0), (0, direction[1])):
                        for jump in self.scan(cell, part):
                            yield jump._replace(cost=reference.add(jump.cost, (0, diagonal)))

    def sees_goal(self, cell: Cell) -> bool:
        """Return whether diagonal moves and then straight ones lead to the goal."""
        while cell != self.goal:
            rows, columns = self.goal[0] - cell[0], self.goal[1] - cell[1]
            direction = int(np.sign(rows)), int(np.sign(columns))
            if not self.can_step(cell, direction):
                return False
            cell = step_from(cell, direction)
        return True


def slow_jump_point_search(problem: Problem, movement: Movement) -> tuple[int, int, int]:
    """Return the cost, weighed, or -1; the number of expansions; and the number of looks."""
    grid = problem.grid.tolist()
    start, goal = problem.start, problem.goal
    search = SlowJumps(grid, goal, movement)
    numbers = {start: 0}  # in the order in which cells were found
    frontier = [(0, 0, start)]
    costs: dict[Cell, reference.Pair] = {start: (0, 0)}
    directions: dict[Cell, Cell] = {}
    expanded: set[Cell] = set()
    while frontier:
        cell = heapq.heappop(frontier)[2]
        if cell in expanded:
            continue
        expanded.add(cell)
        if cell == goal:
            return reference.weigh(costs[goal], movement), len(expanded), search.looks
        if len(expanded) <= RAYS and search.sees_goal(cell):
            cost = reference.add(costs[cell], reference.heuristic(cell, goal, movement))
            return reference.weigh(cost, movement), len(expanded) + 1, search.looks
        neighbours = {cell for cell, _ in reference.neighbours(grid, cell, movement)}
        if cell != start:
            row_step, column_step = directions[cell]
            before = step_from(cell, (-row_step, -column_step))
            neighbours &= set(unpruned(grid, before, cell, movement))
        for direction in (*reference.STRAIGHT, *reference.DIAGONAL):
            if step_from(cell, direction) not in neighbours:
                continue
            for jump in search.scan(cell, direction):
                cost = reference.add(costs[cell], jump.cost)
                weight = reference.weigh(cost, movement)
                target = jump.target
                if target in costs and reference.weigh(costs[target], movement) <= weight:
                    continue
                costs[target] = cost
                directions[target] = jump.direction
                number = numbers.setdefault(target, len(numbers))
                to_goal = reference.weigh(reference.heuristic(target, goal, movement), movement)
                heapq.heappush(frontier, (weight + to_goal, -number, target))
    return -1, len(expanded), search.looks


# --- tests --------------------------------------------------------------------------------------


def assert_optimal(grid: Bytes, starts: Ints, goals: Ints, movement: Movement) -> None:
    """Check costs and paths of both searches on one map against A*'s."""
    expected = search_batch("astar", grid, starts, goals, movement)
    jumps, looks = solve_by_jump_points(grid, starts, goals, movement)
    fields, _ = solve_by_goal_fields(grid, starts, goals, movement)
    np.testing.assert_array_equal(jumps.cost, expected.cost)
    np.testing.assert_array_equal(fields.cost, expected.cost)
    assert (jumps.iterations <= looks).all()
    for paths in (jumps, fields):
        for k, cost in enumerate(expected.cost.tolist()):
            path = paths.cells[paths.offsets[k] : paths.offsets[k + 1]]
            if cost < 0:
                assert len(path) == 0
                continue
            assert check_path(grid, path, movement) == cost
            assert path[0].tolist() == starts[k].tolist()
            assert path[-1].tolist() == goals[k].tolist()


def assert_problem_is_solved(problem: Problem, movement: Movement) -> None:
    """Check one problem as `assert_optimal` does."""
    grid, start, goal = problem
    assert_optimal(grid, np.array([start]), np.array([goal]), movement)


@eight_moves
@examples(150)
@given(problem=problems())
def test_costs_equal_those_of_astar(movement: Movement, problem: Problem) -> None:
    """The paths are full and legal, too."""
    assert_problem_is_solved(problem, movement)


@eight_moves
@examples(15)
@given(problem=problems())
def test_costs_equal_those_of_the_slow_reference(movement: Movement, problem: Problem) -> None:
    """Which knows nothing of the package."""
    grid, start, goal = problem
    expected = reference.reference_astar(grid.tolist(), start, goal, movement)
    for solve in SOLVERS:
        paths, _ = solve(grid[None], np.array([start]), np.array([goal]), movement)
        assert paths.cost.tolist() == [expected.cost]


@eight_moves
def test_expansions_and_looks_equal_those_of_the_definition(movement: Movement) -> None:
    """Neighbours are pruned by comparing paths around a cell, not by a list of patterns."""
    source = np.random.default_rng(8)
    for shape, share in product([(1, 9), (4, 4), (7, 9)], [0.1, 0.3, 0.5]):
        for _ in range(12):
            grid = scattered(source, shape, share)
            start, goal = (draw_free_cell(source, grid, "anywhere") for _ in range(2))
            paths, looks = solve_by_jump_points(
                grid[None], np.array([start]), np.array([goal]), movement
            )
            cost, expansions, passed = slow_jump_point_search(Problem(grid, start, goal), movement)
            assert (paths.iterations[0], looks[0]) == (expansions, passed)
            assert (cost < 0) == (paths.cost[0] < 0)


@eight_moves
def test_the_goal_field_leads_astar_along_its_path_alone(movement: Movement) -> None:
    """The path is that of A* with the exact cost to the goal as its heuristic, in plain Python."""
    source = np.random.default_rng(9)
    for _ in range(30):
        grid = scattered(source, (8, 9), 0.25)
        start, goal = (draw_free_cell(source, grid, "anywhere") for _ in range(2))
        paths, field_sizes = solve_by_goal_fields(
            grid[None], np.array([start]), np.array([goal]), movement
        )
        field = reference.reference_distances(grid.tolist(), goal, movement)
        assert field_sizes.tolist() == [len(field)]
        expected: list[Cell] = []
        if start in field:
            frontier = [(0, 0, start)]
            costs: dict[Cell, reference.Pair] = {start: (0, 0)}
            pushes = count(1)
            while not expected or expected[-1] != goal:
                cell = heapq.heappop(frontier)[2]
                expected.append(cell)
                for neighbour, move_cost in reference.neighbours(grid.tolist(), cell, movement):
                    cost = reference.add(costs[cell], move_cost)
                    weight = reference.weigh(cost, movement)
                    known = costs.get(neighbour)
                    if known is not None and reference.weigh(known, movement) <= weight:
                        continue
                    costs[neighbour] = cost
                    f = weight + reference.weigh(field[neighbour], movement)
                    heapq.heappush(frontier, (f, -next(pushes), neighbour))
        assert [tuple(cell) for cell in paths.cells.tolist()] == expected
        assert paths.iterations.tolist() == [len(expected)]


@eight_moves
def test_all_pairs_of_a_shared_grid_are_solved(movement: Movement) -> None:
    """Each search leaves the grid as the next one needs it."""
    grid = scattered(np.random.default_rng(3), (5, 6), 0.3)
    free = np.argwhere(grid == 0)
    starts = np.repeat(free, len(free), axis=0)
    goals = np.tile(free, (len(free), 1))
    assert_optimal(grid, starts, goals, movement)
    paths, _ = solve_by_jump_points(grid, starts, goals, movement)
    alone = [
        solve_by_jump_points(grid, starts[k : k + 1], goals[k : k + 1], movement)[0]
        for k in range(0, len(starts), 7)
    ]
    np.testing.assert_array_equal(
        paths.iterations[::7], np.concatenate([path.iterations for path in alone])
    )


def test_bad_problems_are_refused_by_number() -> None:
    """An end outside or on an occupied cell, and numbers other than 0 and 1."""
    grids = np.zeros((2, 3, 3), np.uint8)
    grids[1, 1, 1] = 1
    starts = np.array([[0, 0], [0, 0]])
    for solve in SOLVERS:
        with pytest.raises(ValueError, match=r"problem 1: goal: \(1, 1\) is on an occupied cell"):
            solve(grids, starts, np.array([[1, 1], [1, 1]]), Movement(8))
        with pytest.raises(ValueError, match=r"problem 0: goal: \(3, 1\) is outside"):
            solve(grids, starts, np.array([[3, 1], [1, 1]]), Movement(8))
        with pytest.raises(ValueError, match="problem 1: grid: got the value 2"):
            solve(grids * 2, starts, starts, Movement(8))
        with pytest.raises(ValueError, match="2 grids, 1 starts and 1 goals"):
            solve(grids, starts[:1], starts[:1], Movement(8))


def test_a_path_that_turns_at_every_row_of_a_large_map() -> None:
    """The log of pushes and the path grow as needed."""
    grid = serpentine(401, 300, np.random.default_rng(5))
    start, goal = (0, 150), (400, 150)
    for movement in EIGHT:
        assert_problem_is_solved(Problem(grid, start, goal), movement)
        solution = astar(grid, start, goal, movement)
        paths, _ = solve_by_jump_points(grid, np.array([start]), np.array([goal]), movement)
        assert 10 * paths.iterations[0] < solution.iterations


@pytest.mark.soak
@eight_moves
def test_costs_of_ten_thousand_maps_equal_those_of_astar(movement: Movement) -> None:
    """2,000 maps of each family and 4,000 scattered ones, under each movement, with 8 problems on
    each map of a family.
    """
    source = np.random.default_rng(43)
    for family in FAMILIES:
        maps: Maps = generate(family, 43, range(2000))
        for grid in maps.occupancy:
            free = np.argwhere(grid == 0)
            starts, goals = free[source.integers(len(free), size=(2, 8))]
            assert_optimal(grid, starts, goals, movement)
    for k in range(4000):
        grid = scattered(source, SHAPES[k % len(SHAPES)], source.uniform(0, 0.6))
        free = np.argwhere(grid == 0)
        starts, goals = free[source.integers(len(free), size=(2, 8))]
        assert_optimal(grid, starts, goals, movement)


def costs_by_jumps(problem: Problem, movement: Movement, max_cost: int) -> dict[Cell, int]:
    """Return the costs of all cells to the goal by `jump_costs`, in 1 / UNIT, without INFINITY."""
    shape = problem.grid.shape
    lattice, scratch = search_memory(shape, move_rule(movement))
    walled = np.pad(problem.grid, 1, constant_values=1).reshape(-1)
    scratch.came_from[:] = np.where(walled, WALL, UNSEEN)
    neighbours = np.zeros(lattice.cells, np.uint8)
    find_free_neighbours(scratch.came_from, lattice, neighbours)
    goal = cell_at(*problem.goal, lattice)
    jump_costs(goal, max_cost, neighbours, lattice, scratch)
    costs = scratch.g.reshape(-1, lattice.stride)[1:-1, 1:-1]
    return {cell: cost for cell, cost in np.ndenumerate(costs.tolist()) if cost < INFINITY}


@eight_moves
@given(problem=problems())
@examples(12)
def test_costs_of_all_cells_equal_those_of_a_slow_search(
    movement: Movement, problem: Problem
) -> None:
    """A search that stops early finds all costs below its end, and no cost below it is wrong."""
    slow = reference.reference_distances(problem.grid.tolist(), problem.goal, movement)
    expected = {cell: reference.as_float(cost, movement) for cell, cost in slow.items()}
    costs = costs_by_jumps(problem, movement, int(INFINITY))
    assert {cell: in_cells(cost) for cell, cost in costs.items()} == expected
    for end in (0, 1, 9):
        costs = costs_by_jumps(problem, movement, end)
        below_end = {cell: in_cells(cost) for cell, cost in costs.items() if cost < end * UNIT}
        assert below_end == {cell: cost for cell, cost in expected.items() if cost < end}
