"""MapSpec and Movement: Table 1, presets, JSON, identity, and nonsense refused by name."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections import UserDict, UserList
from random import Random
from typing import Any

import numpy as np
import pytest
from helpers.examples import examples
from helpers.specs import MOVEMENTS, specs
from hypothesis import given
from hypothesis import strategies as st

from mapdata import MapSpec, identity
from mapdata.checks import items_of, plain_values
from mapdata.limits import MAX_ROOMS, MAX_SIDE
from mapdata.movement import Movement

SETTINGS = examples(200)


# --- defaults and presets -----------------------------------------------------------------------


def test_defaults_are_table_1() -> None:
    """The default spec is the paper's Table 1, with the text's ten percent."""
    assert dataclasses.asdict(MapSpec()) == {
        "map_size": (64, 64),
        "rooms": (2, 9),
        "room_rows": (14, 33),
        "room_columns": (14, 33),
        "passage_width": (7, 15),
        "skip_probability": 0.1,
        "resolution": 0.1,
        "movement": {"connectivity": 4, "corner_cutting": False, "diagonal_cost": math.sqrt(2)},
        "splits": (0.8, 0.1, 0.1),
    }


PRESETS = {
    "paper": MapSpec(),
    "narrow": MapSpec(passage_width=(1, 3)),
    "dungeon": MapSpec(
        rooms=(8, 16), room_rows=(6, 14), room_columns=(6, 14), passage_width=(1, 3)
    ),
    "dungeon128": MapSpec(
        map_size=(128, 128),
        rooms=(16, 40),
        room_rows=(8, 20),
        room_columns=(8, 20),
        passage_width=(2, 4),
    ),
}


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_what_the_design_says(name: str) -> None:
    """Each preset has the design's numbers."""
    assert MapSpec.preset(name) == PRESETS[name]


def test_an_unknown_preset_names_the_known_ones() -> None:
    """The message holds what was asked for and what there is."""
    with pytest.raises(ValueError, match="papers") as error:
        MapSpec.preset("papers")
    assert all(name in str(error.value).replace("papers", "") for name in PRESETS)


def test_limits_themselves_are_allowed() -> None:
    """The largest side and the most rooms are valid, and so is the smallest map."""
    assert MAX_SIDE == 4096
    assert MAX_ROOMS == 255
    MapSpec(map_size=(MAX_SIDE, MAX_SIDE), rooms=(2, MAX_ROOMS))
    MapSpec(
        map_size=(1, 1), rooms=(2, 2), room_rows=(1, 1), room_columns=(1, 1), passage_width=(1, 1)
    )


# --- JSON and identity --------------------------------------------------------------------------


@SETTINGS
@given(specs())
def test_json_round_trip(generator: MapSpec) -> None:
    """A spec comes back from its JSON equal, with the same JSON and the same identity."""
    again = MapSpec.from_json(generator.to_json())
    assert again == generator
    assert hash(again) == hash(generator)
    assert again.to_json() == generator.to_json()
    assert identity(again, 3) == identity(generator, 3)


@SETTINGS
@given(specs(), st.randoms(use_true_random=False))
def test_key_order_does_not_matter(generator: MapSpec, random: Random) -> None:
    """JSON with its keys shuffled is the same spec with the same identity."""

    def shuffle(value: object) -> object:
        """Shuffle the keys of every object in it."""
        if not isinstance(value, dict):
            return value
        items = [(key, shuffle(inner)) for key, inner in value.items()]
        random.shuffle(items)
        return dict(items)

    again = MapSpec.from_json(json.dumps(shuffle(json.loads(generator.to_json())), indent=3))
    assert again == generator
    assert identity(again, 0) == identity(generator, 0)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (MapSpec(skip_probability=0), MapSpec(skip_probability=0.0)),
        (MapSpec(resolution=1), MapSpec(resolution=1.0)),
        (MapSpec(splits=(1, 0, 0)), MapSpec(splits=(1.0, 0.0, 0.0))),
        (
            MapSpec(movement=Movement(8, diagonal_cost=1)),
            MapSpec(movement=Movement(8, diagonal_cost=1.0)),
        ),
        (MapSpec(), MapSpec.preset("paper")),
    ],
    ids=["probability", "resolution", "splits", "diagonal", "preset"],
)
def test_equal_specs_have_one_identity(one: MapSpec, other: MapSpec) -> None:
    """Whole numbers written as int or float are one spec: one text, one identity."""
    assert one == other
    assert one.to_json() == other.to_json()
    assert identity(one, 5) == identity(other, 5)


def test_identity_differs_by_seed_and_by_every_field() -> None:
    """A SHA-256 in hexadecimal that nothing shares: each field and the seed are in it."""
    table = MapSpec()
    changed = [
        dataclasses.replace(table, map_size=(64, 65)),
        dataclasses.replace(table, map_size=(65, 64)),
        dataclasses.replace(table, rooms=(2, 8)),
        dataclasses.replace(table, rooms=(3, 9)),
        dataclasses.replace(table, room_rows=(14, 32)),
        dataclasses.replace(table, room_columns=(14, 32)),
        dataclasses.replace(table, passage_width=(7, 14)),
        dataclasses.replace(table, skip_probability=0.1000001),
        dataclasses.replace(table, resolution=0.2),
        dataclasses.replace(table, splits=(0.7, 0.2, 0.1)),
        *(dataclasses.replace(table, movement=movement) for movement in MOVEMENTS[1:]),
    ]
    seed_points = [0, 1, 2**32, 2**64 - 1]
    found = [identity(table, seed) for seed in seed_points] + [
        identity(generator, 0) for generator in changed
    ]
    assert len(set(found)) == len(found)
    assert all(re.fullmatch("[0-9a-f]{64}", text) for text in found)


@pytest.mark.parametrize("seed", [-1, 2**64])
def test_identity_refuses_a_seed_beyond_64_bits(seed: int) -> None:
    """A seed that would be cut to 64 bits would share another's maps."""
    with pytest.raises(ValueError, match="seed"):
        identity(MapSpec(), seed)


@pytest.mark.parametrize(
    ("text", "culprit"),
    [
        ('{"map_sise": [64, 64]}', "map_sise"),
        ('{"movement": {"conectivity": 4}}', "conectivity"),
        ('{"rooms": [9, 2]}', "rooms"),
        ('{"rooms": 5}', "rooms"),
        ('{"movement": 5}', "movement"),
    ],
)
def test_json_that_is_no_spec_names_the_culprit(text: str, culprit: str) -> None:
    """An unknown key or a bad value in JSON is a ValueError that names it."""
    with pytest.raises(ValueError, match=culprit):
        MapSpec.from_json(text)


@pytest.mark.parametrize("text", ["", "rooms", "[64, 64]", "3", "null"])
def test_json_that_is_no_object_is_refused(text: str) -> None:
    """Text that is not a JSON object is a ValueError."""
    with pytest.raises(ValueError, match=r".+"):
        MapSpec.from_json(text)


# --- nonsense -----------------------------------------------------------------------------------

NAN = math.nan
BAD: list[tuple[str, object]] = [
    *(
        ("map_size", value)
        for value in [(0, 64), (64, 0), (-64, 64), (MAX_SIDE + 1, 64), (64, MAX_SIDE + 1)]
    ),
    *(
        ("map_size", value)
        for value in [(64,), (64, 64, 64), 64, None, (64.5, 64), (True, True), ("64", "64")]
    ),
    *(
        ("rooms", value)
        for value in [(1, 9), (0, 9), (-2, 9), (9, 2), (2, MAX_ROOMS + 1), (2,), (2, 3, 4), 5, None]
    ),
    *(("rooms", value) for value in [(2.5, 9), (True, 9), (2, True), (NAN, 9), ("2", "9")]),
    *(
        ("room_rows", value)
        for value in [(0, 33), (-1, 33), (33, 14), (14, 65), (14, 33.5), (True, 33)]
    ),
    *(
        ("room_columns", value)
        for value in [(0, 33), (-1, 33), (33, 14), (14, 65), (14, 33.5), (True, 33)]
    ),
    *(
        ("passage_width", value)
        for value in [(0, 15), (-1, 15), (15, 7), (7, 65), (7.5, 15), (True, 15)]
    ),
    *(("skip_probability", value) for value in [-0.1, 1.1, NAN, math.inf, "0.1", None, True]),
    *(("resolution", value) for value in [0.0, -0.1, NAN, math.inf, "0.1", None, True]),
    *(
        ("splits", value)
        for value in [(0.8, 0.1, 0.2), (0.5, 0.1, 0.1), (1.2, -0.1, -0.1), (NAN, 0.5, 0.5)]
    ),
    *(
        ("splits", value)
        for value in [(0.9, 0.1), (0.7, 0.1, 0.1, 0.1), 1.0, None, (True, False, False)]
    ),
    *(("movement", value) for value in [4, None, "4"]),
]


@pytest.mark.parametrize(("field", "value"), BAD, ids=[f"{field}={value}" for field, value in BAD])
def test_a_bad_value_is_refused_by_name(field: str, value: object) -> None:
    """Nonsense is a ValueError of one line that names the field."""
    arguments: dict[str, Any] = {field: value}
    with pytest.raises(ValueError, match=rf"\b{field}\b") as error:
        MapSpec(**arguments)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("field", "sizes"),
    [
        ("room_rows", {"map_size": (20, 64), "passage_width": (1, 3)}),
        ("room_columns", {"map_size": (64, 20), "passage_width": (1, 3)}),
        ("passage_width", {"map_size": (12, 12), "room_rows": (3, 5), "room_columns": (3, 5)}),
    ],
)
def test_what_is_larger_than_the_map_is_refused(field: str, sizes: dict[str, Any]) -> None:
    """Rooms are held against their own side of the map, passages against the map."""
    with pytest.raises(ValueError, match=rf"\b{field}\b"):
        MapSpec(**sizes)


@pytest.mark.parametrize(
    ("culprit", "arguments"),
    [
        ("connectivity", {"connectivity": 5}),
        ("connectivity", {"connectivity": 0}),
        ("connectivity", {"connectivity": True}),
        ("connectivity", {"connectivity": "8"}),
        ("diagonal_cost", {"connectivity": 8, "diagonal_cost": np.ones(2)}),
        ("corner_cutting", {"connectivity": 4, "corner_cutting": True}),
        ("corner_cutting", {"connectivity": 8, "corner_cutting": 2}),
        ("corner_cutting", {"connectivity": 8, "corner_cutting": "no"}),
        ("diagonal_cost", {"connectivity": 8, "diagonal_cost": 1.3}),
        ("diagonal_cost", {"connectivity": 8, "diagonal_cost": 0.0}),
        ("diagonal_cost", {"connectivity": 8, "diagonal_cost": NAN}),
        ("diagonal_cost", {"connectivity": 8, "diagonal_cost": True}),
    ],
)
def test_movement_refuses_nonsense_by_name(culprit: str, arguments: dict[str, Any]) -> None:
    """A Movement that cannot be, or an argument that would do nothing, is a ValueError that names
    it.
    """
    with pytest.raises(ValueError, match=culprit):
        Movement(**arguments)


def test_numpy_integers_become_plain_ones() -> None:
    """Equal specs have equal JSON."""
    for eight in (np.int64(8), 8.0):
        generator = MapSpec(movement=Movement(eight))  # type: ignore[arg-type]
        assert generator.to_json() == MapSpec(movement=Movement(8)).to_json()


@pytest.mark.parametrize("value", [MapSpec(), Movement()])
def test_frozen_and_hashable(value: MapSpec | Movement) -> None:
    """A spec cannot change under those who hold it, and serves as a key."""
    for field in dataclasses.fields(value):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(value, field.name, 1)
    assert {value: 1}[type(value)()] == 1


# --- configurations of other libraries ----------------------------------------------------------


@pytest.mark.parametrize("values", [(1, 2), [1, 2], UserList([1, 2]), range(1, 3)])
def test_every_sequence_has_items(values: Any) -> None:
    """Not tuples and lists alone: configurations have a class of their own."""
    assert items_of(values) == (1, 2)


def test_a_spec_takes_any_sequence() -> None:
    """And keeps tuples, so that equal specs have equal hashes."""
    sides: Any = UserList([40, 50])
    assert MapSpec(sides, rooms=(2, 3)) == MapSpec((40, 50), rooms=(2, 3))
    assert type(MapSpec(sides, rooms=(2, 3)).map_size) is tuple


@pytest.mark.parametrize("values", ["12", b"12", bytearray(b"12"), 12, None, {1: 2}, {1, 2}])
def test_text_and_other_values_have_no_items(values: Any) -> None:
    """Text is a sequence for Python, and bytes are even one of integers."""
    assert items_of(values) == ()
    with pytest.raises(ValueError, match=r"rooms: got .*, expected 2 integers"):
        MapSpec(rooms=values)


def test_plain_values_hold_no_class_of_a_configuration() -> None:
    """Mappings and sequences at every depth; all else stays."""
    values = UserDict({"a": UserList([1, UserDict({"b": None}), (2.5, "text")]), "c": UserList()})
    plain = plain_values(values)
    assert plain == {"a": [1, {"b": None}, [2.5, "text"]], "c": []}
    assert (type(plain), type(plain["a"]), type(plain["a"][1])) == (dict, list, dict)
    assert plain_values("paper") == "paper"
