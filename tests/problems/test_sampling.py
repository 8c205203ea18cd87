"""Random problems: those of the reference under any conditions, uniform, and the same for ever; on
maps with terrain and without it.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from helpers import reference
from helpers.examples import examples, slow
from helpers.reference import Cell
from helpers.samples import assert_same, cells_of
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy import stats

from mapdata import (
    MapDataset,
    MapGenerator,
    Movement,
    OnlineMapDataset,
    ProblemSet,
    Random,
    astar,
    bfs,
    build,
    generate,
    inflate,
)
from mapdata.arrays import Bytes, Ints
from mapdata.movement import NEURAL_ASTAR
from mapdata.problems.sampling import sample_problems
from mapdata.search.lattice import move_rule
from mapdata.search.map_stack import MapStack

MOVEMENTS = [
    Movement(),
    Movement(8),
    Movement(8, corner_cutting=True),
    Movement(8, diagonal_cost=1),
]


DRAWS = (0, 32)
"""The draws that a dataset tries on a map: the first, and one past the last."""

NO_PROBLEM = -1
"""What start, goal and cost of a map without a problem are filled with."""


def ends_on(
    maps: MapStack,
    seed: int,
    epoch: int,
    conditions: Random,
    movement: Movement,
    goals: Ints | None = None,
) -> Ints:
    """Sample a problem on each of the maps 0, 1, ...; return start and goal, (B, 4), or -1."""
    count = len(maps.grids)
    ends, row, high_cost = sample_problems(
        maps,
        goals,
        np.uint64(seed),
        epoch,
        np.arange(count),
        DRAWS,
        *conditions.conditions,
        move_rule(movement),
    )
    assert (row, high_cost) == (count, 0)
    return ends


def sample(grids: Bytes, seed: int, epoch: int, conditions: Random, movement: Movement) -> Ints:
    """Sample a problem on each of the grids 0, 1, ...; return start, goal and cost, (B, 6).

    The cost is that of a shortest path, straight and diagonal steps; where these cost the same, all
    count as straight. Without a problem all is -1.
    """
    ends = ends_on(MapStack(grids, None), seed, epoch, conditions, movement)
    sampled = np.full((len(grids), 6), NO_PROBLEM)
    for k, (row, column, goal_row, goal_column) in enumerate(ends.tolist()):
        sampled[k, :4] = ends[k]
        if row != NO_PROBLEM:
            path = astar(grids[k], (row, column), (goal_row, goal_column), movement).path
            sampled[k, 4:] = steps_of(path, movement)
    return sampled


def steps_of(path: Ints, movement: Movement) -> tuple[int, int]:
    """Count the straight and the diagonal steps of a path; all as straight if they cost the
    same.
    """
    steps = np.diff(path, axis=0)
    if movement.diagonal_cost == 1:
        return len(steps), 0
    diagonal = int((steps != 0).all(axis=1).sum())
    return len(steps) - diagonal, diagonal


def assert_equals_the_reference(
    maps: MapStack,
    seed: int,
    epoch: int,
    conditions: Random,
    movement: Movement,
    goals: Ints | None = None,
) -> int:
    """Compare the problem of each map with that of the slow reference; return how many have one."""
    ends = ends_on(maps, seed, epoch, conditions, movement, goals).tolist()
    with_problem = 0
    for index, grid in enumerate(maps.grids):
        only_goal = None
        if goals is not None:
            goal = goals[index].tolist()
            only_goal = (goal[0], goal[1])
        truth = reference.reference_problem(
            grid.tolist(),
            seed,
            index,
            epoch,
            conditions.bands,
            movement,
            only_goal=only_goal,
            terrain=None if maps.terrain is None else maps.terrain[index].tolist(),
        )
        expected = [NO_PROBLEM] * 4 if truth is None else [*truth.start, *truth.goal]
        assert ends[index] == expected
        with_problem += truth is not None
    return with_problem


lowest = st.integers(0, 8) | st.floats(0, 8) | st.none()
highest = st.integers(9, 14) | st.floats(8, 14) | st.none()
bands = st.none() | st.tuples(lowest, highest)
ratios = st.none() | st.tuples(st.floats(1, 1.2), st.floats(1.2, 3) | st.none())
small_grids = arrays.arrays(
    np.uint8,
    st.tuples(st.just(2), st.integers(1, 7), st.integers(1, 7)),
    elements=st.integers(0, 1),
)


def terrain_on(grids: Bytes, costs: range, seed: int) -> Bytes:
    """Return terrain with the obstacles of grids."""
    drawn = np.random.default_rng(seed).choice(costs, grids.shape)
    return np.where(grids, 0, drawn).astype(np.uint8)


@pytest.mark.parametrize("costs", [None, range(1, 4), range(1, 256)], ids=str)
@examples(200)
@given(
    grids=small_grids,
    seed=st.integers(0, 2**64 - 1),
    epoch=st.integers(0, 2**32 - 1),
    conditions=st.builds(Random, bands, ratios, bands),
    movement=st.sampled_from(MOVEMENTS),
    has_goals=st.booleans(),
)
def test_the_kernel_is_the_reference(
    costs: range | None,
    grids: Bytes,
    seed: int,
    epoch: int,
    conditions: Random,
    movement: Movement,
    has_goals: bool,
) -> None:
    """Start and goal on any map under any conditions, or none where there is none; the goal is any
    cell, or the last one.
    """
    goals = None
    if has_goals:
        last = np.array(grids.shape[1:]) - 1
        goals = np.tile(last, (len(grids), 1))
    maps = MapStack(grids, None if costs is None else terrain_on(grids, costs, seed))
    assert_equals_the_reference(maps, seed, epoch, conditions, movement, goals)


@pytest.mark.parametrize("movement", MOVEMENTS)
@pytest.mark.parametrize("columns", [63, 64, 65, 128, 130])
def test_wide_maps(columns: int, movement: Movement) -> None:
    """Rows that fill a word of 64 bits, or more than one, or almost."""
    noise = np.random.default_rng(columns).random((6, 4, columns))
    grids = (noise < 0.2).astype(np.uint8)
    for conditions in (
        Random(),
        Random(distance=(10, None)),
        Random(distance=(2.5, 9.5)),
        Random(hardness=(1.1, None)),
    ):
        with_problem = assert_equals_the_reference(
            MapStack(grids, None), 3, 1, conditions, movement
        )
        assert with_problem > 0


GOLDEN = [
    (
        "paper",
        4,
        Random(),
        "9f6ffd0bc25bc786f98aacaf305456caa7f92eab07f6f7622f02aa961602f4ce",
    ),
    (
        "paper",
        8,
        Random(hardness=(1.05, None)),
        "ab56577457b504b75a5c065c868f2334e3f0704cef6715bd4a9e7906da1ae64c",
    ),
    (
        "dungeon",
        4,
        Random(distance=(10, None)),
        "ed931c5202fe215c9d958c3d0740e31e5dfa64a7d92c93ff80171fb0e72e4c10",
    ),
    (
        "dungeon",
        8,
        Random(distance=(20, 40), hardness=(1.05, 2), length=(0, 38)),
        "ca7e921cdd101994e0e361b2ff3f516b114c6c451d62d04d5be5322193556180",
    ),
    (
        "dungeon128",
        8,
        Random(distance=(10, None)),
        "1f4a3c7b7c8a5fb842da29dd55620c9cf5bcff2b99f31d16fa0a7618bffc8053",
    ),
]
"""SHA-256 of start, goal and cost on the maps 0 to 49 of seed 77, in epoch 3."""


@pytest.mark.parametrize(
    ("preset", "connectivity", "conditions", "golden"),
    GOLDEN,
    ids=[f"{preset}-{connectivity}" for preset, connectivity, *_ in GOLDEN],
)
def test_the_problems_stay_what_they_are(
    preset: str, connectivity: int, conditions: Random, golden: str
) -> None:
    """On every machine, in every version."""
    grids = generate(MapGenerator.preset(preset), 77, range(50)).occupancy
    sampled = sample(grids, 77, 3, conditions, Movement(connectivity))
    assert hashlib.sha256(sampled.astype("<i8").tobytes()).hexdigest() == golden


@pytest.mark.slow
@pytest.mark.parametrize("movement", [slow(MOVEMENTS[0]), MOVEMENTS[1]])
def test_goals_are_uniform(movement: Movement) -> None:
    """On a map in two halves each free cell is the goal equally often, and of a goal's half each
    other cell the start: by chi-square tests.
    """
    grid = np.zeros((5, 6), np.uint8)
    grid[:, 3] = 1
    numbers = np.arange(grid.size).reshape(grid.shape)
    free = numbers[grid == 0]
    grids = np.repeat(grid[None], 20_000, axis=0)
    sampled = sample(grids, 1, 0, Random(), movement)
    starts = numbers[sampled[:, 0], sampled[:, 1]]
    goals = numbers[sampled[:, 2], sampled[:, 3]]
    assert set(goals.tolist()) == set(free.tolist())
    goal_counts = np.bincount(goals, minlength=grid.size)[free]
    assert stats.chisquare(goal_counts).pvalue > 1e-3

    corner = numbers[0, 0]
    left = numbers[:, :3]
    to_corner = starts[goals == corner]
    expected_starts = left[left != corner]
    assert set(to_corner.tolist()) == set(expected_starts.tolist())
    start_counts = np.bincount(to_corner, minlength=grid.size)[expected_starts]
    assert stats.chisquare(start_counts).pvalue > 1e-3


BANDS = [
    Random(distance=(3, 5)),
    Random(hardness=(1.2, None)),
    Random(length=(4, 6)),
    Random(distance=(2.5, None), hardness=(1, 1.5)),
    Random(distance=(2, 7), hardness=(1.05, 2.5), length=(3, 7)),
]

WINDING = np.array(
    [
        [0, 0, 0, 1, 0, 0],
        [0, 1, 0, 0, 0, 1],
        [0, 0, 1, 0, 1, 0],
        [1, 0, 0, 0, 0, 0],
        [0, 0, 1, 1, 1, 0],
        [0, 1, 0, 0, 0, 0],
    ],
    np.uint8,
)
"""A map with cells that only diagonal moves connect, and without a free corner in some places."""

Pair = tuple[Cell, Cell]


def assert_frequencies(
    probabilities: dict[Pair, float],
    grid: Bytes,
    conditions: Random,
    movement: Movement,
    terrain: Bytes | None = None,
    goal: Cell | None = None,
) -> None:
    """Compare how often each (goal, start) is drawn with its probability, by a chi-square test.

    The probabilities need not have the sum 1. Without any, no problem may be found.
    """
    count = 6000
    one_map = MapStack(grid[None], None if terrain is None else terrain[None])
    ends, *_ = sample_problems(
        one_map.select(np.zeros(count, np.int64)),
        None if goal is None else np.tile(goal, (count, 1)),
        np.uint64(5),
        0,
        np.arange(count),
        (0, 200),
        *conditions.conditions,
        move_rule(movement),
    )
    drawn = Counter(((row, column), (r, c)) for r, c, row, column in ends.tolist())
    if not probabilities:
        assert (ends == NO_PROBLEM).all()
        return
    assert set(drawn) <= set(probabilities)
    expected = count * np.array(list(probabilities.values())) / sum(probabilities.values())
    observed = [drawn[pair] for pair in probabilities]
    if len(expected) > 1:
        assert stats.chisquare(observed, expected).pvalue > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("radius", [0, 1])
@pytest.mark.parametrize("movement", [*MOVEMENTS, NEURAL_ASTAR], ids=str)
def test_frequencies_are_those_of_the_stated_distribution(movement: Movement, radius: int) -> None:
    """Each goal that has a start within the bands is equally probable, and so is each of these
    starts. All are enumerated, on a map of 6 x 6 cells and on one that is inflated.
    """
    grid = WINDING
    if radius:
        grid = np.zeros((6, 6), np.uint8)
        grid[2, 2] = 1
        grid = inflate(grid, 1)  # an L of 7 cells, since the edge of a map is an obstacle
    cells = [(row, column) for row, column in np.argwhere(grid == 0).tolist()]
    costs = {goal: reference.reference_distances(grid.tolist(), goal, movement) for goal in cells}
    for conditions in BANDS:
        starts = {}
        for goal in cells:
            within = reference.starts_within(
                grid.tolist(), goal, costs[goal], conditions.bands, movement
            )
            if within:
                starts[goal] = within
        probabilities = {
            (goal, start): 1 / len(within) for goal, within in starts.items() for start in within
        }
        assert probabilities or radius
        assert_frequencies(probabilities, grid, conditions, movement)
        goal, within = next(iter(starts.items()), (cells[0], []))
        to_goal = {(goal, start): 1.0 for start in within}
        assert_frequencies(to_goal, grid, conditions, movement, goal=goal)


class Around(NamedTuple):
    """A map, its terrain or None, and a goal."""

    grid: Bytes
    terrain: Bytes | None
    goal: Cell


SLOPE = np.array([[1, 5, 3], [2, 0, 7]], np.uint8)


@pytest.mark.parametrize(
    "around",
    [Around(WINDING, None, (3, 2)), Around((SLOPE == 0).astype(np.uint8), SLOPE, (0, 0))],
    ids=["uniform", "terrain"],
)
@pytest.mark.parametrize("movement", [*MOVEMENTS, NEURAL_ASTAR], ids=str)
def test_both_ends_of_a_band_are_included(around: Around, movement: Movement) -> None:
    """Bands that end at the value of a start, or at the next float: that start is in, or out."""
    goal = around.goal
    grid = around.grid.tolist()
    terrain = None if around.terrain is None else around.terrain.tolist()
    factor = 1 if around.terrain is None else 2 * int(around.terrain[around.terrain > 0].min())
    costs = reference.reference_distances(grid, goal, movement, terrain)
    values: dict[str, set[float]] = {"distance": set(), "hardness": set()}
    for start, cost in costs.items():
        if start != goal:
            distance = reference.as_float(cost, movement, terrain)
            lower_bound = reference.heuristic(start, goal, movement, factor)
            bound = reference.as_float(lower_bound, movement, terrain)
            values["distance"].add(distance)
            values["hardness"].add(distance / bound)
    count = 300  # of each start about 10
    maps = MapStack(around.grid[None], None if around.terrain is None else around.terrain[None])
    for name, ends in values.items():
        for end in sorted(ends):
            above = float(np.nextafter(end, np.inf))
            below = float(np.nextafter(end, 0))
            for band in ((end, None), (above, None), (None, end), (None, below)):
                bands: dict[str, Any] = {name: band}
                conditions = Random(**bands)
                sampled, *_ = sample_problems(
                    maps.select(np.zeros(count, np.int64)),
                    np.tile(goal, (count, 1)),
                    np.uint64(3),
                    0,
                    np.arange(count),
                    (0, 1),
                    *conditions.conditions,
                    move_rule(movement),
                )
                drawn = {(row, column) for row, column in sampled[:, :2].tolist()}
                within = reference.starts_within(
                    grid, goal, costs, conditions.bands, movement, terrain
                )
                assert drawn == (set(within) or {(NO_PROBLEM, NO_PROBLEM)}), band


@pytest.mark.slow
@pytest.mark.parametrize("movement", [*map(slow, MOVEMENTS), NEURAL_ASTAR], ids=str)
def test_frequencies_on_terrain_are_those_of_the_stated_distribution(movement: Movement) -> None:
    """There, a band of length refuses a problem after its goal and start are drawn."""
    terrain = np.array([[3, 9, 1, 0], [1, 0, 4, 2], [2, 7, 7, 1], [0, 1, 5, 1]], np.uint8)
    grid = (terrain == 0).astype(np.uint8)
    slow = (grid.tolist(), terrain.tolist())
    cells = [(row, column) for row, column in np.argwhere(grid == 0).tolist()]
    costs = {
        goal: reference.reference_distances(slow[0], goal, movement, slow[1]) for goal in cells
    }
    lengths = {}
    for goal in cells:
        for start in costs[goal]:
            result = reference.reference_astar(slow[0], start, goal, movement, slow[1])
            lengths[goal, start] = len(result.path)
    for conditions in (
        Random(distance=(6, 14)),
        Random(hardness=(1.5, 4)),
        Random(length=(3, 4)),
        Random(distance=(4, None), hardness=(1, 3), length=(None, 3)),
        Random(distance=(4, 20), hardness=(1.2, 8), length=(3, 5)),
    ):
        lowest, highest = conditions.bands[2]
        probabilities = {}
        for goal in cells:
            within = reference.starts_within(
                slow[0], goal, costs[goal], conditions.bands, movement, slow[1]
            )
            for start in within:
                if lowest <= lengths[goal, start] <= highest:
                    probabilities[goal, start] = 1 / len(within)
        assert probabilities, conditions
        assert_frequencies(probabilities, grid, conditions, movement, terrain=terrain)
        goal = next(iter(probabilities))[0]
        to_goal = {pair: 1.0 for pair in probabilities if pair[0] == goal}
        assert_frequencies(to_goal, grid, conditions, movement, terrain=terrain, goal=goal)


@pytest.mark.parametrize("conditions", [Random(), Random(distance=(1, None))])
def test_without_conditions_the_problems_on_terrain_are_those_of_its_grid(
    conditions: Random,
) -> None:
    """No move costs less than 1, so all connected cells are far enough."""
    grids = (np.random.default_rng(5).random((20, 9, 10)) < 0.3).astype(np.uint8)
    terrain = terrain_on(grids, range(1, 256), 5)
    on_terrain, on_grids = (
        ends_on(MapStack(grids, costs), 4, 3, conditions, Movement(8)) for costs in (terrain, None)
    )
    np.testing.assert_array_equal(on_terrain, on_grids)


def test_a_terrain_whose_costs_are_too_high_is_reported() -> None:
    """With its number and cost, so that the caller can name the map; earlier problems are there."""
    terrains = np.full((3, 1, 5000), 255, np.uint8)
    terrains[0] = 3
    ends, row, high_cost = sample_problems(
        MapStack(np.zeros_like(terrains), terrains),
        None,
        np.uint64(1),
        3,
        np.arange(3),
        DRAWS,
        *Random((2, None)).conditions,
        move_rule(Movement(8)),
    )
    assert (ends[0] >= 0).all()
    assert (ends[1:] == NO_PROBLEM).all()
    assert row == 1
    assert high_cost >= 2**62


@pytest.mark.parametrize("to_first", [False, True])
def test_training_and_evaluation_ask_the_same(to_first: bool, tmp_path: Path) -> None:
    """Datasets in epoch 0 have the problems of a set of problems with their seed, map by map."""
    generator = MapGenerator.preset("dungeon")
    conditions = Random(distance=(10, None), to_first_seed_point=to_first)
    movement = Movement(8)
    build(tmp_path, generator, maps=30, seed=5)
    how: dict[str, Any] = {
        "fields": ("map", "start", "goal", "seed_points"),
        "problems": conditions,
        "movement": movement,
        "sampling_seed": 5,
    }
    online = OnlineMapDataset(generator, 5, 30, **how)[:]
    stored = MapDataset(tmp_path, **how)[:]
    assert_same(online, stored)
    problems = ProblemSet.sample(generator, 5, 30, problems=conditions, movement=movement)
    np.testing.assert_array_equal(online.map[:, 0], problems.grids)
    np.testing.assert_array_equal(online.start, problems.starts)
    np.testing.assert_array_equal(online.goal, problems.goals)
    at_first = (online.goal == online.seed_points[:, 0]).all(dim=1)
    if to_first:
        assert at_first.all()
    else:
        assert not at_first.all()


def test_without_a_free_first_seed_point_a_map_gives_way() -> None:
    """An inflated map may have none; of the others the goal is the first seed point."""
    generator = MapGenerator.preset("narrow")
    conditions = Random(to_first_seed_point=True)
    served = OnlineMapDataset(
        generator, 3, 200, fields=("map", "goal", "seed_points"), problems=conditions, radius=0.6
    )
    sample = served[:]
    np.testing.assert_array_equal(sample.goal, sample.seed_points[:, 0])
    rows, columns = sample.goal.unbind(1)
    occupied = sample.map[torch.arange(200), 0, rows, columns]
    assert not occupied.any()
    alone = ProblemSet.sample(
        generator, 3, 200, problems=conditions, radius=0.6, movement=Movement(8)
    )
    assert len(alone) < 200


@pytest.mark.parametrize("search", ["astar", "bfs"])
@pytest.mark.parametrize("movement", MOVEMENTS)
def test_paths_found_while_sampling_are_those_of_a_search(movement: Movement, search: str) -> None:
    """Conditions need them; a rare one also takes maps in place of those without a problem."""
    generator = MapGenerator.preset("paper")
    served = OnlineMapDataset(
        generator,
        5,
        60,
        fields=("map", "start", "goal", "path", "cost", "iterations", "hardness"),
        problems=Random(hardness=(2.1, None), length=(None, 90)),
        movement=movement,
        search=search,
    )[:]
    assert (served.hardness >= 2.1).all()
    searches = {"astar": astar, "bfs": bfs}
    for k in range(60):
        grid = served.map[k, 0].numpy()
        start = served.start[k]
        goal = served.goal[k]
        expected = searches[search](grid, start, goal, movement)
        assert cells_of(served.path[k]) == [tuple(cell) for cell in expected.path.tolist()]
        assert served.iterations[k] == expected.iterations
        assert served.cost[k] == np.float32(expected.cost)
        shortest = astar(grid, start, goal, movement)
        assert len(shortest.path) <= 90
    own_maps = generate(generator, 5, range(60)).occupancy
    in_place = (served.map[:, 0].numpy() == own_maps).all(axis=(1, 2))
    assert 0 < in_place.sum() < 60


def test_a_substitute_has_draws_of_its_own() -> None:
    """Bands that few problems meet are found on other maps, also where maps are alike: all mazes
    have as many free cells in as many places.
    """
    near = OnlineMapDataset(
        MapGenerator.preset("maze"),
        length=40,
        fields=("start", "goal", "cost"),
        problems=Random(distance=(None, 3)),
    )[:]
    assert (near.cost <= 3).all()
    different_goals = np.unique(near.goal, axis=0)
    assert len(different_goals) > 30
