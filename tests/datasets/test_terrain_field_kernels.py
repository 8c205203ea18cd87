"""Fields on terrain: equal to the slow reference, and on ones to the fields without terrain."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from helpers import reference
from helpers.reference import Cell
from helpers.specs import movements

from mapdata import Movement
from mapdata.arrays import Bytes, Ints
from mapdata.datasets.field_kernels import (
    GoalFields,
    fill_goal_fields,
    fill_room_matrices,
    path_probabilities,
)
from mapdata.search import search_batch
from mapdata.search.ground import as_ground
from mapdata.search.kernels import search_memory
from mapdata.search.lattice import move_rule

COUNT = 6


class Problems(NamedTuple):
    """Maps with costs, and a problem on each; start and goal of the last one are the same cell."""

    terrains: Bytes
    starts: Ints
    goals: Ints

    @property
    def grids(self) -> Bytes:
        """Return the maps without costs."""
        grids: Bytes = (self.terrains == 0).astype(np.uint8)
        return grids

    @property
    def ground(self) -> tuple[Bytes, Bytes | None]:
        """Return the maps with costs, and memory for their costs, as kernels take them."""
        return as_ground(self.grids, self.terrains)

    def cells(self, k: int) -> tuple[Cell, Cell]:
        """Return start and goal of problem k."""
        start = self.starts[k].tolist()
        goal = self.goals[k].tolist()
        return (start[0], start[1]), (goal[0], goal[1])


def random_problems(values: list[int]) -> Problems:
    """Draw problems on maps of these costs, a quarter of whose cells are occupied."""
    source = np.random.default_rng(11)
    terrains = source.choice(np.array(values, np.uint8), (COUNT, 9, 11))
    starts, goals = source.integers(0, (9, 11), size=(2, COUNT, 2))
    goals[-1] = starts[-1]
    occupied = source.random(terrains.shape) < 0.25
    for ends in (starts, goals):
        occupied[np.arange(COUNT), ends[:, 0], ends[:, 1]] = False
    terrains[occupied] = 0
    return Problems(terrains, starts, goals)


def empty_fields() -> GoalFields:
    """Return fields to be filled."""
    shape = (COUNT, 1, 9, 11)
    return GoalFields(
        np.empty(shape, np.float32),
        np.empty(shape, np.uint8),
        np.empty(shape, np.float32),
        np.empty(shape, np.uint8),
    )


def exact_costs(problems: Problems, k: int, cell: Cell, movement: Movement) -> dict[Cell, Any]:
    """Return the exact, doubled costs of all cells to ``cell`` by the reference."""
    terrain = problems.terrains[k].tolist()
    return reference.reference_distances(problems.grids[k].tolist(), cell, movement, terrain)


@movements
@pytest.mark.parametrize("values", [[1, 2], [3, 8, 91, 255]])
def test_goal_fields_on_terrain_equal_the_reference(movement: Movement, values: list[int]) -> None:
    """Cost to go, optimal moves, the ratio to the heuristic, and the cells of all optimal paths."""
    problems = random_problems(values)
    fields = empty_fields()
    refused = fill_goal_fields(
        *problems.ground,
        problems.starts,
        problems.goals,
        *search_memory(problems.grids.shape[1:], move_rule(movement)),
        fields,
    )
    assert refused == (COUNT, 0)
    for k in range(COUNT):
        start, goal = problems.cells(k)
        grid = problems.grids[k].tolist()
        terrain = problems.terrains[k].tolist()
        field = reference.reference_field(grid, goal, movement, terrain)
        np.testing.assert_array_equal(fields.cost_to_go[k, 0], field)
        np.testing.assert_array_equal(
            fields.optimal_moves[k, 0], reference.reference_moves(grid, goal, movement, terrain)
        )
        to_goal = exact_costs(problems, k, goal, movement)
        from_start = exact_costs(problems, k, start, movement)
        factor = 2 * int(problems.terrains[k][problems.terrains[k] > 0].min())
        for cell in np.ndindex(9, 11):
            ratio = 0.0
            is_optimal = False
            if cell in to_goal:
                cost = reference.as_float(to_goal[cell], movement, terrain)
                bound = reference.heuristic(cell, goal, movement, factor)
                ratio = reference.as_float(bound, movement, terrain) / cost if cost else 1.0
            if cell in to_goal and cell in from_start:
                through = reference.add(from_start[cell], to_goal[cell])
                is_optimal = reference.weigh(through, movement) == reference.weigh(
                    to_goal[start], movement
                )
            assert fields.heuristic_ratio[k, 0][cell] == np.float32(ratio)
            assert fields.optimal_mask[k, 0][cell] == is_optimal


@movements
def test_path_probabilities_on_terrain_follow_their_formula(movement: Movement) -> None:
    """L / (d(start, n) + d(n, goal) + d(n, path)) from the reference's costs, 0 below 0.95."""
    problems = random_problems([1, 2, 30])
    paths = search_batch(
        "astar", *problems._replace(terrains=problems.grids), movement, terrain=problems.terrains
    )
    ends = problems.starts, problems.goals
    probabilities, *refused = path_probabilities(
        *problems.ground,
        *ends,
        paths.cells,
        paths.offsets,
        *search_memory(problems.grids.shape[1:], move_rule(movement)),
    )
    assert refused == [COUNT, 0]
    for k in range(COUNT):
        start, goal = problems.cells(k)
        path = paths.cells[paths.offsets[k] : paths.offsets[k + 1]].tolist()
        expected = np.zeros((9, 11))
        if path:
            terrain = problems.terrains[k].tolist()

            def costs(cell: Cell, k: int = k, terrain: Any = terrain) -> dict[Cell, float]:
                exact = exact_costs(problems, k, cell, movement)
                return {
                    near: reference.as_float(cost, movement, terrain)
                    for near, cost in exact.items()
                }

            from_start, to_goal = costs(start), costs(goal)
            to_path_cells = [costs((row, column)) for row, column in path]
            for cell, cost in from_start.items():
                to_path = min(table[cell] for table in to_path_cells)
                detour_cost = cost + to_goal[cell] + to_path
                expected[cell] = to_goal[start] / detour_cost if detour_cost else 1.0
            expected[expected < 0.95] = 0
        np.testing.assert_array_equal(probabilities[k, 0], expected.astype(np.float32))


@movements
def test_room_matrices_on_terrain_hold_the_costs_between_seed_points(movement: Movement) -> None:
    """-1 without a path, 0 on the diagonal, -2 beyond the rooms of a map."""
    problems = random_problems([1, 2, 30])
    seed_points = np.full((COUNT, 4, 2), -1)
    seed_points[:, 0] = problems.starts
    seed_points[:, 1] = problems.goals
    seed_points[:3, 2] = problems.goals[::-1][:3]
    matrices, *refused = fill_room_matrices(
        *problems.ground, seed_points, *search_memory(problems.grids.shape[1:], move_rule(movement))
    )
    assert refused == [COUNT, 0]
    for k in range(COUNT):
        terrain = problems.terrains[k].tolist()
        rooms = 3 if k < 3 else 2
        expected = np.full((4, 4), -2.0)
        for i, cell in enumerate(seed_points[k, :rooms].tolist()):
            exact = exact_costs(problems, k, (cell[0], cell[1]), movement)
            for j, (row, column) in enumerate(seed_points[k, :rooms].tolist()):
                expected[i, j] = -1
                if terrain[cell[0]][cell[1]] and (row, column) in exact:
                    expected[i, j] = reference.as_float(exact[row, column], movement, terrain)
            expected[i, i] = 0
        np.testing.assert_array_equal(matrices[k], expected.astype(np.float32))


@movements
def test_fields_on_terrain_of_ones_are_those_without_terrain(movement: Movement) -> None:
    """The same bytes of all fields."""
    problems = random_problems([1])
    memory = search_memory(problems.grids.shape[1:], move_rule(movement))
    on_ones, without = empty_fields(), empty_fields()
    ends = problems.starts, problems.goals
    fill_goal_fields(*problems.ground, *ends, *memory, on_ones)
    fill_goal_fields(problems.grids, None, *ends, *memory, without)
    for name in GoalFields._fields:
        assert getattr(on_ones, name).tobytes() == getattr(without, name).tobytes()
    paths = search_batch("astar", problems.grids, *ends, movement)
    probabilities, *_ = path_probabilities(
        *problems.ground, *ends, paths.cells, paths.offsets, *memory
    )
    expected_probabilities, *_ = path_probabilities(
        problems.grids, None, *ends, paths.cells, paths.offsets, *memory
    )
    assert probabilities.tobytes() == expected_probabilities.tobytes()
    seed_points = np.stack((problems.starts, problems.goals), axis=1)
    matrices, *_ = fill_room_matrices(*problems.ground, seed_points, *memory)
    expected_matrices, *_ = fill_room_matrices(problems.grids, None, seed_points, *memory)
    assert matrices.tobytes() == expected_matrices.tobytes()


def test_a_map_whose_costs_are_too_high_is_reported() -> None:
    """By each kernel, with its number and cost."""
    terrains = np.full((2, 1, 4200), 255, np.uint8)
    terrains[0] = 1
    starts = np.array([[0, 0], [0, 0]])
    goals = np.array([[0, 5], [0, 5]])
    memory = search_memory(terrains.shape[1:], move_rule(Movement(8)))
    empty = np.empty((0, 1, 1, 4200), np.float32)
    cost_to_go = np.empty((2, 1, 1, 4200), np.float32)
    no_bytes = empty.astype(np.uint8)
    fields = GoalFields(cost_to_go, no_bytes, empty, no_bytes)
    ground = as_ground((terrains == 0).astype(np.uint8), terrains)
    number, high_cost = fill_goal_fields(*ground, starts, goals, *memory, fields)
    assert number == 1
    assert high_cost >= 2**62
    cells = np.tile(np.stack((np.zeros(6, int), np.arange(6)), axis=1), (2, 1))
    offsets = np.array([0, 6, 12])
    _, *refused = path_probabilities(*ground, starts, goals, cells, offsets, *memory)
    assert refused[0] == 1
    assert refused[1] >= 2**62
    _, *refused = fill_room_matrices(*ground, np.stack((starts, goals), axis=1), *memory)
    assert refused[0] == 1
    assert refused[1] >= 2**62
