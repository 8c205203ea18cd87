"""What holds for sets of problems on terrain alone.

That they are sampled, saved and copied like others is tested with these, in test_problem_set.py and
test_set_file.py.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from mapdata import PRESETS, ProblemSet, Random, Terrain
from mapdata.movement import Movement


def test_hardness_on_terrain_is_the_cost_over_the_cheapest_empty_map() -> None:
    """By hand: a straight path, one over a hill, and a map whose cheapest cell costs 3."""
    terrain = np.array([[2, 9, 2, 2], [2, 2, 2, 2]], np.uint8)
    terrains = np.stack([terrain, terrain, 2 * terrain - 1])
    starts = np.array([(1, 0), (0, 0), (1, 0)])
    goals = np.array([(1, 3), (0, 2), (1, 2)])
    problems = ProblemSet(terrains == 0, starts, goals, Movement(), terrain=terrains)
    assert problems.optimal.cost.tolist() == [6, 8, 6]
    assert problems.hardness.tolist() == [6 / 6, 8 / 4, 6 / 6]
    assert problems.hard.tolist() == [False, True, False]


def test_the_problems_of_tiles_lead_from_corner_to_corner() -> None:
    """The task of the Warcraft sets: the upper left and the lower right corner of each map."""
    movement = PRESETS["tiles"].movement
    problems = ProblemSet.sample("tiles", 0, 5, problems="route", movement=movement)
    assert problems.starts.tolist() == [[0, 0]] * 5
    assert problems.goals.tolist() == [[11, 11]] * 5


@pytest.mark.parametrize(("source", "where"), [("route", "map 0"), ("random", "problem 0")])
def test_costs_that_are_too_high_are_refused(source: str, where: str) -> None:
    """Routes are searched as they are drawn, random problems without conditions when all are."""
    long_maze = replace(PRESETS["maze"], map_size=(511, 511))
    generator = Terrain(over=long_maze, costs=(255,))
    with pytest.raises(ValueError, match=f"{where}: terrain: a path costs .*, and costs are"):
        ProblemSet.sample(generator, 0, 1, problems=source, movement=Movement(8))


def test_sampled_sets_on_terrain_have_golden_hashes() -> None:
    """Sets that planners are compared on stay the same in all later versions."""
    tiles = ProblemSet.sample("tiles", 0, 20, problems="route", movement=PRESETS["tiles"].movement)
    golden = "07e5f016997f3a5e3195f54b29c218eb24b1bde8481e2445cd612eaf70301fff"
    assert tiles.content_hash == golden
    conditions = Random(distance=(20, 150), length=(10, None))
    random = ProblemSet.sample("terrain", 0, 20, problems=conditions, movement=Movement(8))
    golden = "f44c2ed71dca6f7d320d9f27898c45ecd9b346cda51f6067333cf9fb19a51a8f"
    assert random.content_hash == golden


@pytest.mark.parametrize(
    ("terrain", "reason"),
    [
        ([[1, 9, 0]], r"got shape \(1, 3\), expected \(1, 1, 3\)"),
        ([[[1, 9, 3]]], r"got 3 at \(0, 0, 2\), which is occupied in the grid"),
        ([[[1, 265, 0]]], "got the value 265"),
    ],
    ids=["another shape", "other obstacles", "other numbers"],
)
def test_terrain_that_does_not_fit_the_grids_is_refused(
    terrain: npt.ArrayLike, reason: str
) -> None:
    """By the cell and the number that do not fit."""
    ends = np.array([[0, 0]]), np.array([[0, 1]])
    with pytest.raises(ValueError, match=f"terrain: {reason}"):
        ProblemSet(np.array([[[0, 0, 1]]]), *ends, Movement(8), terrain=np.array(terrain))


def test_maps_that_differ_in_their_costs_alone_are_different() -> None:
    """Though all problems share one grid."""
    grids = np.broadcast_to(np.zeros((4, 8), np.uint8), (3, 4, 8))
    terrain = grids + np.array([4, 5, 4], np.uint8)[:, None, None]
    starts = np.array([[0, 0], [0, 0], [3, 0]])
    goals = starts + np.array([0, 5])
    problems = ProblemSet(grids, starts, goals, Movement(), terrain=terrain)
    assert problems.map_indices.tolist() == [0, 1, 0]
    assert problems.optimal.cost.tolist() == [20, 25, 20]
