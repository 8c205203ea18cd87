"""Problem sources: names, objects, dicts and JSON text are one, and bad ones are refused by
name.
"""

from __future__ import annotations

import math
from collections import UserDict, UserList
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from torch.utils.data import DataLoader

from mapdata import (
    MapDataset,
    MapSpec,
    Movement,
    OnlineMapDataset,
    Pairs,
    ProblemSet,
    Random,
    Route,
    build,
)
from mapdata.datasets import EpochSampler
from mapdata.problems.sources import Source, check_possible, plain_text, problem_source
from mapdata.search.api import search_batch
from mapdata.search.lattice import hardness

TINY = MapSpec((9, 7), (2, 3), (1, 3), (1, 3), passage_width=(1, 1))

SAME: list[tuple[Any, Source, str]] = [
    ("route", Route(), "route"),
    ("pairs", Pairs(), "pairs"),
    ("random", Random(), "random"),
    (Random(), Random(), "random"),
    ({"random": {}}, Random(), "random"),
    ({"pairs": {"unsolvable": True}}, Pairs(unsolvable=True), '{"pairs": {"unsolvable": true}}'),
    ('{"route": {"unsolvable": false}}', Route(), "route"),
    (
        '{"random": {"distance": [10, null], "length": [null, 40]}}',
        Random(distance=(10.0, math.inf), length=(0, 40)),
        '{"random": {"distance": [10.0, null], "length": [0.0, 40.0]}}',
    ),
    (
        Random(hardness=(-math.inf, 1.5)),
        Random(hardness=(0, 1.5)),
        '{"random": {"hardness": [0.0, 1.5]}}',
    ),
    (
        {"random": {"distance": [5, None], "to_first_seed_point": True}},
        Random(distance=(5, None), to_first_seed_point=True),
        '{"random": {"distance": [5.0, null], "to_first_seed_point": true}}',
    ),
    ({"random": {"per_map": 4}}, Random(per_map=4), '{"random": {"per_map": 4}}'),
    ({"random": {"per_map": 1}}, Random(), "random"),
    (  # as a configuration of another library says it
        UserDict({"random": UserDict({"distance": UserList([10, None])})}),
        Random(distance=(10, None)),
        '{"random": {"distance": [10.0, null]}}',
    ),
]


@pytest.mark.parametrize(("value", "source", "text"), SAME)
def test_what_a_source_is_written_as(value: Any, source: Source, text: str) -> None:
    """All ways to say one source give it, and its plain text gives it again."""
    assert problem_source(value) == source
    assert plain_text(source) == text
    assert problem_source(text) == source


def test_bands_are_brought_to_floats() -> None:
    """Open sides are 0 and infinity."""
    source = Random(UserList([10, None]), length=[2, 5])  # type: ignore[arg-type]
    assert (type(source.distance), type(source.length)) == (tuple, tuple)
    assert source.distance == (10.0, math.inf)
    assert source.bands == ((10, math.inf), (0, math.inf), (2, 5))
    assert hash(source) == hash(Random((10.0, None), None, (2.0, 5.0)))


def test_a_reversed_band_says_so() -> None:
    """With both of its numbers, as they were given."""
    message = r"distance: got \(20, 10\), whose lowest number 20 is above its highest 10; expected"
    with pytest.raises(ValueError, match=message):
        Random(distance=(20, 10))


@pytest.mark.parametrize(
    "band",
    [
        10,
        (5,),
        (5, 4),
        (1, 2, 3),
        (math.nan, 4),
        (4, math.nan),
        (math.inf, None),
        (-3, -2),
        "12",
        b"12",
    ],
)
@pytest.mark.parametrize("name", ["distance", "hardness", "length"])
def test_bad_bands_are_refused_by_name(name: str, band: Any) -> None:
    """Not two numbers, or not in order."""
    with pytest.raises(ValueError, match=rf"{name}: got .*[,;] expected \(lowest, highest\)"):
        Random(**{name: band})


@pytest.mark.parametrize(
    ("value", "says"),
    [
        ("hard", r"hard ones are Random\(hardness=\(1.05, None\)\), as text"),
        ("rooms", "problems: got 'rooms', expected one of route, pairs, random"),
        ("rout", "; did you mean route?"),
        ({"randm": {}}, "; did you mean random?"),
        ("{}", "problems: got '{}', expected one of"),
        ("{random}", "Expecting property name"),
        (None, "problems: got None"),
        ({"route": {}, "pairs": {}}, "problems: got {'route'"),
        ({"rooms": {}}, "problems: got {'rooms'"),
        ({"random": None}, "problems: random: got None"),
        (
            {"random": {"min_distance": 10}},
            "unknown key: min_distance; known are distance, hardness, length",
        ),
        ({"random": {"distance": ["3", None]}}, "distance: got '3', expected a number"),
        ('{"route": {"unsolvable": "false"}}', "unsolvable: got 'false', expected True or False"),
        ({"pairs": {"unsolvable": 1}}, "unsolvable: got 1, expected True or False"),
        (
            {"random": {"to_first_seed_point": "false"}},
            "to_first_seed_point: got 'false', expected True or False",
        ),
        ({"random": {"per_map": 0}}, "per_map: got 0, expected an integer of at least 1"),
        ({"random": {"per_map": 2.5}}, "per_map: got 2.5, expected an integer"),
        ({"route": {"per_map": 4}}, "problems: route: unknown key: per_map"),
    ],
)
def test_bad_sources_are_refused(value: Any, says: str) -> None:
    """The message holds what was got and what is known."""
    with pytest.raises(ValueError, match=says):
        problem_source(value)


EIGHT, FREE_EIGHT = Movement(8), Movement(8, corner_cutting=True, diagonal_cost=1)


@pytest.mark.parametrize("has_terrain", [False, True])
@pytest.mark.parametrize("movement", [Movement(), EIGHT, FREE_EIGHT])
def test_no_band_of_a_problem_is_refused(movement: Movement, has_terrain: bool) -> None:
    """Those of each problem on a snake and on an open map, be cells cheap or costly."""
    snake = np.array([[0, 0, 0], [1, 1, 0], [0, 0, 0], [0, 1, 1], [0, 0, 0]], np.uint8)
    grids = np.array([snake, np.zeros_like(snake)])
    for grid in grids:
        for free_cost in (1, 255) if has_terrain else (1,):
            free = np.argwhere(grid == 0)
            pairs = [(a, b) for a in free for b in free if (a != b).any()]
            starts, goals = (np.array(ends) for ends in zip(*pairs, strict=True))
            terrain = np.where(grid, 0, free_cost).astype(np.uint8) if has_terrain else None
            solved = search_batch("astar", grid, starts, goals, movement, terrain=terrain)
            cell_costs = None if terrain is None else np.full(len(pairs), free_cost)
            ratios = hardness(solved.cost, starts, goals, movement, cell_costs)
            lengths = np.diff(solved.offsets)
            for cost, ratio, length in zip(solved.cost, ratios, lengths, strict=True):
                exactly = Random((cost, cost), (ratio, ratio), (length, length))
                check_possible(exactly, grid.shape, movement, has_terrain=has_terrain)


@pytest.mark.parametrize(
    ("problems", "movement", "has_terrain", "says"),
    [
        (Random(hardness=(None, 0.99)), EIGHT, True, "hardness is 1 or more"),
        (Random(length=(None, 1)), EIGHT, True, "length is a whole number from 2 to 12"),
        (Random(length=(13, None)), EIGHT, True, "length is a whole number from 2 to 12"),
        (Random(length=(2.2, 2.8)), EIGHT, True, "length is a whole number from 2 to 12"),
        (Random(distance=(None, 0.9)), EIGHT, True, "a path of 2 to 12 cells is 1 to 3966.87"),
        (Random(distance=(3967, None)), EIGHT, True, "a path of 2 to 12 cells is 1 to 3966.87"),
        (Random((5, None), None, (3, 3)), EIGHT, False, "a path of 3 cells is 2 to 2.82843"),
        (Random((None, 3), None, (5, None)), EIGHT, False, "of 5 to 12 cells is 4 to 15.5563"),
        (Random((511, None), None, (3, 3)), Movement(), True, "a path of 3 cells is 2 to 510"),
        (
            Random((3, None), None, (3, 3)),
            FREE_EIGHT,
            False,
            "a path of 3 cells is 2, a whole number",
        ),
        (Random((4.2, 4.8)), Movement(), False, "2 to 12 cells is 1 to 11, a whole number"),
        (
            Random((None, 3), (4, None)),
            Movement(),
            False,
            "11, a whole number, and no less than the hardness",
        ),
        (Random(None, (2.1, None), (None, 3)), Movement(), False, "no less than the hardness"),
    ],
)
def test_bands_that_no_problem_meets_are_refused(
    problems: Random, movement: Movement, has_terrain: bool, says: str
) -> None:
    """Before any search."""
    with pytest.raises(ValueError, match=f"which no problem meets: .*{says}"):
        check_possible(problems, (3, 4), movement, has_terrain=has_terrain)


def test_all_that_draw_problems_refuse_such_bands(tmp_path: Path) -> None:
    """When they are opened, long before a search would end."""
    build(tmp_path, TINY, maps=4, seed=3, workers=1)
    far = Random(distance=(1e9, None))
    openings: tuple[Callable[[], object], ...] = (
        lambda: MapDataset(tmp_path, problems=far),
        lambda: OnlineMapDataset(TINY, problems=far),
        lambda: ProblemSet.sample(TINY, 0, 4, problems=far),
        lambda: ProblemSet.read(tmp_path, split="train", problems=far),
    )
    for open_them in openings:
        with pytest.raises(ValueError, match="which no problem meets"):
            open_them()


def test_numbers_that_64_bits_do_not_hold_are_refused() -> None:
    """Problems on a map, of a dataset, and in an order."""
    assert Random(per_map=10**6).per_map == 10**6
    with pytest.raises(ValueError, match="per_map: got 1000001, expected at most 1,000,000"):
        Random(per_map=10**6 + 1)
    huge = OnlineMapDataset(TINY, length=10**12, problems="random")
    assert len(next(iter(DataLoader(huge, 3))).map) == 3
    with pytest.raises(ValueError, match="length: got 1,000,000,000,001 problems, expected"):
        OnlineMapDataset(TINY, length=10**12 + 1)
    with pytest.raises(ValueError, match="dataset: got 1,000,000,000,000 problems, expected at"):
        EpochSampler(huge, 3, sampling_seed=0)
