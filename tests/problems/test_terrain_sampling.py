"""Random problems on terrain: those of the reference under any conditions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers import reference
from helpers.examples import examples
from helpers.specs import movements
from hypothesis import given
from hypothesis import strategies as st

from mapdata import Movement, Random, astar
from mapdata.arrays import Bytes, Ints
from mapdata.problems.pairs import solve_pairs
from mapdata.problems.sampling import sample_problems
from mapdata.search.lattice import ASTAR, move_rule
from mapdata.search.map_stack import MapStack

DRAWS = (0, 32)
"""The draws that a dataset tries on a map: the first, and one past the last."""

CONDITIONS = [
    Random(),
    Random(distance=(30, None)),
    Random(distance=(20, 60)),
    Random(hardness=(1.3, 2.5)),
    Random(length=(6, 9)),
    Random(distance=(10.5, 90), hardness=(1, 3), length=(4, 12)),
    Random(distance=(1e6, None)),
]
"""Conditions that most problems meet, some, or none."""


def sample(
    terrains: Bytes,
    seed: int,
    conditions: Random,
    movement: Movement,
    goals: Ints | None = None,
) -> Any:
    """Sample a problem on each terrain in epoch 3."""
    return sample_problems(
        MapStack((terrains == 0).astype(np.uint8), terrains),
        goals,
        np.uint64(seed),
        3,
        np.arange(len(terrains)),
        DRAWS,
        *conditions.conditions,
        move_rule(movement),
    )


def random_terrains(seed: int, shape: tuple[int, int], count: int) -> Bytes:
    """Draw terrains with different costs and shares of occupied cells; some have no free cell."""
    source = np.random.default_rng(seed)
    terrains = np.zeros((count, *shape), np.uint8)
    for terrain in terrains:
        values = [np.array([1, 2, 3]), np.array([8, 12, 53]), np.arange(1, 256)][
            source.integers(0, 3)
        ]
        terrain[:] = source.choice(values, shape)
        terrain[source.random(shape) < source.choice([0.0, 0.2, 0.5, 1.0])] = 0
    return terrains


def assert_equals_the_reference(
    terrains: Bytes,
    seed: int,
    conditions: Random,
    movement: Movement,
    goals: Ints | None = None,
) -> None:
    """Compare each problem with that of the slow reference."""
    ends, refused, high_cost = sample(terrains, seed, conditions, movement, goals)
    assert (refused, high_cost) == (len(terrains), 0)
    for index, terrain in enumerate(terrains):
        truth = None
        grid = (terrain == 0).astype(np.uint8)
        if terrain.any():
            only_goal = None if goals is None else (int(goals[index, 0]), int(goals[index, 1]))
            truth = reference.reference_problem(
                grid.tolist(),
                seed,
                index,
                3,
                conditions.bands,
                movement,
                only_goal=only_goal,
                terrain=terrain.tolist(),
            )
        if truth is None:
            assert ends[index].tolist() == [-1, -1, -1, -1]
        else:
            assert ends[index].tolist() == [*truth.start, *truth.goal]


@movements
@examples(25)
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.sampled_from([(1, 1), (1, 9), (5, 4), (7, 8)]),
    conditions=st.sampled_from(CONDITIONS),
)
def test_problems_on_terrain_are_those_of_the_reference(
    movement: Movement, seed: int, shape: tuple[int, int], conditions: Random
) -> None:
    """Under every movement and any conditions, on maps without a problem, too."""
    assert_equals_the_reference(random_terrains(seed, shape, 3), seed, conditions, movement)


@movements
@examples(15)
@given(seed=st.integers(0, 2**32 - 1), conditions=st.sampled_from(CONDITIONS))
def test_problems_on_terrain_with_fixed_goals_are_those_of_the_reference(
    movement: Movement, seed: int, conditions: Random
) -> None:
    """On free and on occupied goals."""
    terrains = random_terrains(seed, (6, 7), 3)
    goals = np.random.default_rng(seed).integers(0, (6, 7), size=(3, 2))
    assert_equals_the_reference(terrains, seed, conditions, movement, goals)


@movements
def test_problems_on_terrain_of_ones_are_those_without_terrain(movement: Movement) -> None:
    """The same starts and goals, under conditions on distance and hardness; on terrain, that on
    length is tested after the draw.
    """
    grids = (np.random.default_rng(2).random((20, 25, 30)) < 0.3).astype(np.uint8)
    conditions = Random(distance=(8, 40), hardness=(1.02, 3))
    with_terrain = sample(1 - grids, 9, conditions, movement)
    without = sample_problems(
        MapStack(grids, None),
        None,
        np.uint64(9),
        3,
        np.arange(20),
        DRAWS,
        *conditions.conditions,
        move_rule(movement),
    )
    assert (without[0] >= 0).any()
    for ours, expected in zip(with_terrain, without, strict=False):
        np.testing.assert_array_equal(ours, expected)


def test_both_ends_of_a_band_on_terrain_are_included() -> None:
    """Bands that end at the value of a start, or at the next float: that start is in, or out."""
    terrain = np.array([[1, 5, 3], [2, 0, 7]], np.uint8)
    grid = (terrain == 0).astype(np.uint8).tolist()
    goal = (0, 0)
    movement = Movement()
    count = 100  # of each start about 20
    costs = reference.reference_distances(grid, goal, movement, terrain.tolist())
    for cost in costs.values():
        end = reference.as_float(cost, movement, terrain.tolist())
        if end == 0:
            continue
        above = float(np.nextafter(end, np.inf))
        below = float(np.nextafter(end, 0))
        for band in ((end, None), (above, None), (None, end), (None, below)):
            conditions = Random(distance=band)
            terrains = np.repeat(terrain[None], count, axis=0)
            ends, *_ = sample(terrains, 3, conditions, movement, np.tile(goal, (count, 1)))
            drawn = {(row, column) for row, column in ends[:, :2].tolist()}
            within = reference.starts_within(
                grid, goal, costs, conditions.bands, movement, terrain.tolist()
            )
            assert drawn == (set(within) or {(-1, -1)}), band


def test_a_terrain_whose_costs_are_too_high_is_reported() -> None:
    """With its number and cost, so that the caller can name the map; earlier problems are there."""
    terrains = np.full((3, 1, 5000), 255, np.uint8)
    terrains[0] = 3
    ends, refused, high_cost = sample(terrains, 1, Random((2, None)), Movement(8))
    assert (ends[0] >= 0).all()
    assert (ends[1:] == -1).all()
    assert refused == 1
    assert high_cost >= 2**62


@pytest.mark.parametrize("conditions", [Random(), Random(distance=(1, None))])
def test_without_conditions_the_sampler_of_grids_gives_the_problems_of_terrain(
    conditions: Random,
) -> None:
    """No move costs less than 1, so all connected cells are far enough."""
    terrains = random_terrains(5, (9, 10), 20)
    ends, *_ = sample(terrains, 4, conditions, Movement(8))
    expected, *_ = sample_problems(
        MapStack((terrains == 0).astype(np.uint8), None),
        None,
        np.uint64(4),
        3,
        np.arange(20),
        DRAWS,
        *conditions.conditions,
        move_rule(Movement(8)),
    )
    np.testing.assert_array_equal(ends, expected)


@movements
@pytest.mark.parametrize("only_route", [False, True])
@pytest.mark.parametrize("keep_unsolvable", [False, True])
def test_pairs_on_terrain_are_those_of_grids_with_paths_by_astar(
    movement: Movement, only_route: bool, keep_unsolvable: bool
) -> None:
    """Costs change the path of a pair, not whether it has one; seed points may be occupied."""
    terrains = random_terrains(3, (11, 12), 20)
    grids = (terrains == 0).astype(np.uint8)
    seed_points = np.random.default_rng(4).integers(0, (11, 12), size=(20, 4, 2))
    rooms = np.tile([2, 3, 4, 4], 5)
    arguments = (
        seed_points,
        rooms,
        np.uint64(5),
        2,
        np.arange(20),
        only_route,
        keep_unsolvable,
    )
    rule = move_rule(movement)
    ends, solved = solve_pairs(MapStack(grids, terrains), *arguments, ASTAR, rule)
    assert (solved.done, solved.high_cost) == (20, 0)
    ends_without_terrain, without_terrain = solve_pairs(
        MapStack(grids, None), *arguments, ASTAR, rule
    )
    np.testing.assert_array_equal(ends, ends_without_terrain)
    ends_on_ones, on_ones = solve_pairs(MapStack(grids, 1 - grids), *arguments, ASTAR, rule)
    np.testing.assert_array_equal(ends_on_ones, ends_without_terrain)
    np.testing.assert_array_equal(on_ones.cells, without_terrain.cells)
    np.testing.assert_array_equal(on_ones.offsets, without_terrain.offsets)
    np.testing.assert_array_equal(on_ones.expansions, without_terrain.expansions)
    has_path = without_terrain.sums[:, :1] >= 0
    np.testing.assert_array_equal(
        on_ones.sums, np.where(has_path, 2 * without_terrain.sums, without_terrain.sums)
    )
    cells, _, expansions, offsets, *_ = solved
    assert (np.diff(offsets) > 0).any()
    for b in range(20):
        path = cells[offsets[b] : offsets[b + 1]]
        start = (int(ends[b, 0]), int(ends[b, 1]))
        goal = (int(ends[b, 2]), int(ends[b, 3]))
        if ends[b, 0] >= 0 and not grids[b][start] and not grids[b][goal]:
            solution = astar(grids[b], start, goal, movement, terrain=terrains[b])
            np.testing.assert_array_equal(path, solution.path)
            assert expansions[b] == solution.iterations
        else:
            assert len(path) == 0
