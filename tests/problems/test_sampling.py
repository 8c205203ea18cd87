"""Random problems: those of the reference under any conditions, uniform, and the same for ever."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from helpers import reference
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy import stats

from mapdata import Generator, Movement, OnlineMapDataset, Problems, Random, astar, bfs, generate
from mapdata.arrays import Bytes, Ints
from mapdata.problems.sampling import sample_problems
from mapdata.search import rule_of

MOVEMENTS = [
    Movement(),
    Movement(8),
    Movement(8, corner_cutting=True),
    Movement(8, diagonal_cost=1),
]


def sample(grids: Bytes, seed: int, epoch: int, conditions: Random, movement: Movement) -> Ints:
    """Sample a problem on each of the grids 0, 1, ...; return start, goal and cost, (B, 6).

    The cost is that of a shortest path, straight and diagonal steps; where these cost the same, all
    count as straight. Without a problem all is -1.
    """
    indices = np.arange(len(grids))
    ends, *_ = sample_problems(
        grids, np.uint64(seed), epoch, indices, (0, 32), *conditions.conditions, rule_of(movement)
    )
    found = np.full((len(grids), 6), -1)
    found[:, :4] = ends
    for k in np.flatnonzero(ends[:, 0] >= 0):
        moves = np.diff(astar(grids[k], ends[k, :2], ends[k, 2:], movement).path, axis=0)
        diagonal = 0 if movement.diagonal_cost == 1 else np.abs(moves).sum() - len(moves)
        found[k, 4:] = len(moves) - diagonal, diagonal
    return found


lowest = st.integers(0, 8) | st.floats(0, 8) | st.none()
highest = st.integers(9, 14) | st.floats(8, 14) | st.none()
bands = st.none() | st.tuples(lowest, highest)
ratios = st.none() | st.tuples(st.floats(1, 1.2), st.floats(1.2, 3) | st.none())


@given(
    grids=arrays.arrays(
        np.uint8,
        st.tuples(st.just(2), st.integers(1, 7), st.integers(1, 7)),
        elements=st.integers(0, 1),
    ),
    seed=st.integers(0, 2**64 - 1),
    epoch=st.integers(0, 2**32 - 1),
    conditions=st.builds(Random, bands, ratios, bands),
    movement=st.sampled_from(MOVEMENTS),
)
def test_the_kernel_is_the_reference(
    grids: Bytes, seed: int, epoch: int, conditions: Random, movement: Movement
) -> None:
    """Start, goal and cost on any map under any conditions, or none where there is none."""
    equals_the_reference(grids, seed, epoch, conditions, movement)


@pytest.mark.parametrize("movement", MOVEMENTS)
@pytest.mark.parametrize("columns", [63, 64, 65, 128, 130])
def test_wide_maps(columns: int, movement: Movement) -> None:
    """Rows of more cells than a word has bits."""
    grids = (np.random.default_rng(columns).random((6, 4, columns)) < 0.2).astype(np.uint8)
    for conditions in (
        Random(),
        Random(distance=(10, None)),
        Random(distance=(2.5, 9.5)),
        Random(hardness=(1.1, None)),
    ):
        equals_the_reference(grids, 3, 1, conditions, movement)


def equals_the_reference(
    grids: Bytes, seed: int, epoch: int, conditions: Random, movement: Movement
) -> None:
    """Compare the problem of each grid with that of the slow reference."""
    for index, found in enumerate(sample(grids, seed, epoch, conditions, movement).tolist()):
        truth = reference.reference_problem(
            grids[index].tolist(), seed, index, epoch, conditions.bands, movement
        )
        if truth is None:
            assert found == [-1] * 6
            continue
        assert (tuple(found[:2]), tuple(found[2:4])) == (truth.start, truth.goal)
        steps = truth.cost if movement.diagonal_cost != 1 else (sum(truth.cost), 0)
        assert tuple(found[4:]) == steps


GOLDEN = {
    ("paper", 4, Random()): "9f6ffd0bc25bc786f98aacaf305456caa7f92eab07f6f7622f02aa961602f4ce",
    (
        "paper",
        8,
        Random(hardness=(1.05, None)),
    ): "e71971c86a10c7bf15a54dcfbd89fd2e338e33af72760efbea7bfb6b14bff80a",
    (
        "dungeon",
        4,
        Random(distance=(10, None)),
    ): "ed931c5202fe215c9d958c3d0740e31e5dfa64a7d92c93ff80171fb0e72e4c10",
    (
        "dungeon",
        8,
        Random((20, 40), (1.05, 2), (0, 38)),
    ): "885964757c80a51143b0bdec714219ec9aff8857a091c62f78f0c8b73921b857",
    (
        "dungeon128",
        8,
        Random(distance=(10, None)),
    ): "1f4a3c7b7c8a5fb842da29dd55620c9cf5bcff2b99f31d16fa0a7618bffc8053",
}
"""SHA-256 of start, goal and cost on the maps 0 to 49 of seed 77, in epoch 3."""


@pytest.mark.parametrize("case", GOLDEN, ids=str)
def test_the_problems_stay_what_they_are(case: tuple[str, int, Random]) -> None:
    """On every machine, in every version."""
    preset, connectivity, conditions = case
    grids = generate(Generator.preset(preset), 77, range(50)).occupancy
    found = sample(grids, 77, 3, conditions, Movement(connectivity))
    assert hashlib.sha256(found.astype("<i8").tobytes()).hexdigest() == GOLDEN[case]


@pytest.mark.parametrize("movement", MOVEMENTS[:2], ids=["4", "8"])
def test_goals_are_uniform(movement: Movement) -> None:
    """On a map in two halves each free cell is the goal equally often, and each start of a goal
    equally often.
    """
    grid = np.zeros((5, 6), np.uint8)
    grid[:, 3] = 1
    grids = np.repeat(grid[None], 20_000, axis=0)
    found = sample(grids, 1, 0, Random(), movement)
    goals = found[:, 2] * 6 + found[:, 3]
    counts = np.bincount(goals, minlength=30)[grid.ravel() == 0]
    assert counts.sum() == len(grids)
    assert stats.chisquare(counts).pvalue > 1e-3
    starts = (found[:, 0] * 6 + found[:, 1])[goals == 0]
    left = [cell for cell in range(1, 30) if cell % 6 < 3]
    assert stats.chisquare(np.bincount(starts, minlength=30)[left]).pvalue > 1e-3


def test_training_and_evaluation_ask_the_same() -> None:
    """A dataset in epoch 0 has the problems of a set of problems with its seed, map by map."""
    spec, conditions, movement = (
        Generator.preset("dungeon"),
        Random(distance=(10, None)),
        Movement(8),
    )
    fields = ("map", "start", "goal")
    online = OnlineMapDataset(
        spec, 5, 30, None, fields, problems=conditions, movement=movement, sampling_seed=5
    )[:]
    problems = Problems.sample(spec, 5, 30, movement=movement)
    np.testing.assert_array_equal(online.map[:, 0], problems.grids)
    np.testing.assert_array_equal(online.start, problems.starts)
    np.testing.assert_array_equal(online.goal, problems.goals)


@pytest.mark.parametrize("search", ["astar", "bfs"])
@pytest.mark.parametrize("movement", MOVEMENTS)
def test_paths_found_while_sampling_are_those_of_a_search(movement: Movement, search: str) -> None:
    """Conditions need them; a rare one also takes maps in place of those without a problem."""
    served = OnlineMapDataset(
        Generator.preset("paper"),
        5,
        60,
        fields=("map", "start", "goal", "path", "cost", "iterations", "hardness"),
        problems=Random(hardness=(1.3, None), length=(None, 90)),
        movement=movement,
        search=search,
    )[:]
    for k in range(60):
        grid, start, goal = served.map[k, 0].numpy(), served.start[k], served.goal[k]
        one = {"astar": astar, "bfs": bfs}[search](grid, start, goal, movement)
        cells = served.path[k][served.path[k, :, 0] >= 0]
        np.testing.assert_array_equal(cells, one.path)
        assert served.iterations[k] == one.iterations
        assert served.cost[k] == np.float32(one.cost)
        assert served.hardness[k] >= 1.3
        assert len(astar(grid, start, goal, movement).path) <= 90


def test_a_substitute_has_draws_of_its_own() -> None:
    """Bands that few problems meet are found on other maps, also where maps are alike: all mazes
    have as many free cells in as many places.
    """
    near = OnlineMapDataset(
        Generator.preset("maze"),
        length=40,
        fields=("start", "goal", "cost"),
        problems=Random(distance=(None, 3)),
    )[:]
    assert (near.cost <= 3).all()
    assert len(np.unique(near.goal, axis=0)) > 30
