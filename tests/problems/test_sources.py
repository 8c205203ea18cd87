"""Problem sources: names, objects, dicts and JSON text are one, and bad ones are refused by
name.
"""

from __future__ import annotations

import math
from collections import UserDict, UserList
from typing import Any

import pytest

from mapdata import Pairs, Random, Route
from mapdata.problems import Source
from mapdata.problems.sources import plain_text, problem_source

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
