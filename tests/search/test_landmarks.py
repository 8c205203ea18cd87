"""A* with landmarks: it equals a slow search in plain Python, cell by cell and count by count."""

from __future__ import annotations

import heapq
from itertools import count

import numpy as np
import pytest
from helpers import reference
from helpers.reference import Cell
from helpers.specs import movements
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse.csgraph import dijkstra

from mapdata import Movement, astar, check_path, search_batch
from mapdata.arrays import Bytes
from mapdata.evaluation import LandmarkAstar
from mapdata.search.api import solve_by_landmarks

Costs = dict[Cell, reference.Pair]


def scattered(source: np.random.Generator, shape: tuple[int, int], share: float) -> Bytes:
    """Return a grid whose cells are occupied independently, with at least one free cell."""
    grid = (source.random(shape) < share).astype(np.uint8)
    grid[tuple(source.integers(0, shape))] = 0
    return grid


def reference_landmarks(grid: Bytes, landmarks: int, movement: Movement) -> tuple[list[Costs], int]:
    """Return the costs from each landmark, and the number of cells that all floods visit."""
    cells = grid.tolist()
    components: list[Costs] = []
    for row, column in np.argwhere(grid == 0).tolist():
        cell = (row, column)
        if not any(cell in component for component in components):
            components.append(reference.reference_distances(cells, cell, movement))
    largest = max(components, key=len)  # of equal ones the first

    def farthest(costs: dict[Cell, int]) -> Cell:
        return min(costs, key=lambda cell: (-costs[cell], cell))

    weighed = {cell: reference.weigh(cost, movement) for cell, cost in largest.items()}
    landmark = farthest(weighed)
    nearest = dict.fromkeys(largest, 1 << 200)
    fields: list[Costs] = []
    for _ in range(min(landmarks, len(largest))):
        field = reference.reference_distances(cells, landmark, movement)
        fields.append(field)
        for cell, cost in field.items():
            nearest[cell] = min(nearest[cell], reference.weigh(cost, movement))
        landmark = farthest(nearest)
    return fields, sum(map(len, components)) + (len(fields) + 1) * len(largest)


def reference_search(
    grid: Bytes, start: Cell, goal: Cell, fields: list[Costs], movement: Movement
) -> tuple[list[Cell], int]:
    """Return the path and the number of expansions of A* with landmarks."""

    def bound(cell: Cell) -> int:
        bounds = [reference.weigh(reference.heuristic(cell, goal, movement), movement)]
        for field in fields:
            if goal in field and cell in field:
                from_landmark = reference.weigh(field[cell], movement)
                bounds.append(abs(from_landmark - reference.weigh(field[goal], movement)))
        return max(bounds)

    costs: dict[Cell, reference.Pair] = {start: (0, 0)}
    parents: dict[Cell, Cell] = {start: start}
    closed: set[Cell] = set()
    pushes = count(1)
    frontier = [(0, 0, start)]
    while frontier:
        cell = heapq.heappop(frontier)[2]
        if cell in closed:
            continue
        closed.add(cell)
        if cell == goal:
            return reference.trace(parents, goal), len(closed)
        for neighbour, step in reference.neighbours(grid.tolist(), cell, movement):
            cost = reference.add(costs[cell], step)
            weight = reference.weigh(cost, movement)
            known = costs.get(neighbour)
            if known is not None and reference.weigh(known, movement) <= weight:
                continue
            costs[neighbour] = cost
            parents[neighbour] = cell
            heapq.heappush(frontier, (weight + bound(neighbour), -next(pushes), neighbour))
    return [], len(closed)


@movements
@given(st.integers(0, 2**32 - 1), st.integers(1, 9))
def test_it_equals_the_search_in_plain_python(
    movement: Movement, seed: int, landmarks: int
) -> None:
    """Paths, expansions and prepared cells, on maps with several components and few free cells."""
    source = np.random.default_rng(seed)
    rows, columns = source.integers(1, 11, size=2).tolist()
    grid = scattered(source, (rows, columns), source.uniform(0, 0.6))
    free = np.argwhere(grid == 0)
    start, goal = (tuple(cell) for cell in free[source.integers(0, len(free), size=2)].tolist())
    fields, prepared = reference_landmarks(grid, landmarks, movement)
    path, expansions = reference_search(grid, start, goal, fields, movement)
    plan = LandmarkAstar("landmarks", movement, landmarks).plan(grid, start, goal)
    assert [tuple(cell) for cell in plan.path.tolist()] == path
    assert plan.expansions == expansions
    assert plan.prepared == prepared
    assert plan.looks is None


@movements
def test_costs_are_optimal_for_all_pairs_of_a_shared_map(movement: Movement) -> None:
    """Costs equal those of A*, no search expands more cells than the map has, and the map is
    prepared once.
    """
    grid = scattered(np.random.default_rng(3), (9, 11), 0.3)
    free = np.argwhere(grid == 0)
    starts = np.repeat(free, len(free), axis=0)
    goals = np.tile(free, (len(free), 1))
    paths, prepared = solve_by_landmarks(grid, starts, goals, movement, 8)
    by_astar = search_batch("astar", grid, starts, goals, movement)
    np.testing.assert_array_equal(paths.cost, by_astar.cost)
    for k in range(0, len(starts), 13):
        if paths.cost[k] >= 0:
            assert check_path(grid, paths.path(k), movement) == paths.cost[k]
        alone, _ = solve_by_landmarks(grid[None], starts[k : k + 1], goals[k : k + 1], movement, 8)
        assert alone.iterations[0] == paths.iterations[k]
    assert prepared[0] > 0
    assert not prepared[1:].any()


def test_costs_equal_those_of_scipy() -> None:
    """Dijkstra's search of scipy on the 4-connected graph of a map."""
    grid = scattered(np.random.default_rng(8), (20, 20), 0.3)
    numbers = np.arange(400).reshape(20, 20)
    graph = np.zeros((400, 400))
    for one, other in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        both_free = (grid[one] == 0) & (grid[other] == 0)
        graph[numbers[one][both_free], numbers[other][both_free]] = 1
    free = np.argwhere(grid == 0)
    goals = np.broadcast_to(free[0], free.shape)
    paths, _ = solve_by_landmarks(grid, free, goals, Movement(4), 8)
    expected = dijkstra(graph, directed=False, indices=numbers[tuple(free[0])])[numbers[grid == 0]]
    np.testing.assert_array_equal(paths.cost, np.where(np.isinf(expected), -1, expected))


def test_landmarks_lie_in_the_largest_component() -> None:
    """In a smaller one the search is that of A*: a landmark that does not reach the goal says
    nothing.
    """
    grid = np.zeros((12, 12), np.uint8)
    grid[4] = 1
    movement = Movement(8)
    planner = LandmarkAstar("landmarks", movement)
    small, large = planner.plan(grid, (0, 0), (3, 9)), planner.plan(grid, (5, 0), (9, 11))
    assert small.expansions == astar(grid, (0, 0), (3, 9), movement).iterations
    assert small.prepared == large.prepared == 11 * 12 + 9 * 7 * 12


@pytest.mark.parametrize("landmarks", [0, -1, 1.5])
def test_a_wrong_number_of_landmarks_is_refused(landmarks: float) -> None:
    """The message names it."""
    with pytest.raises(ValueError, match="landmarks: got"):
        LandmarkAstar("landmarks", Movement(8), landmarks)  # type: ignore[arg-type]


def test_terrain_is_refused() -> None:
    """The message says how to leave the planner out."""
    ones = np.ones((1, 3, 3), np.uint8)
    ends = np.array([[0, 0]]), np.array([[2, 2]])
    with pytest.raises(ValueError, match=r"got terrain.*classical\(movement, terrain=True\)"):
        LandmarkAstar("landmarks", Movement(8)).plan_batch(ones - 1, *ends, terrain=ones)
