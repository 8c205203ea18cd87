"""The options that both datasets and the data module share."""

from __future__ import annotations

from dataclasses import fields
from inspect import Parameter, signature
from typing import Any, get_type_hints

import pytest
import torch
from helpers import samples

from mapdata import MapDataModule, MapDataset, Movement, OnlineMapDataset, Random
from mapdata.datasets.arguments import Serving
from mapdata.problems.sources import problem_source

CONSTRUCTORS: tuple[Any, ...] = (MapDataset, OnlineMapDataset, MapDataModule)

OPTIONS = {
    "fields": ("map", "start", "goal", "path", "problem"),
    "problems": Random(distance=(3, None)),
    "search": "bfs",
    "movement": Movement(8),
    "augment": True,
    "sampling_seed": 7,
    "max_length": 300,
    "dtype": torch.float64,
    "transform": tuple,
    "radius": 0.04,
}
"""A value other than the default for each option."""


@pytest.mark.parametrize("constructor", CONSTRUCTORS)
def test_every_constructor_shows_the_options_with_their_defaults_and_types(
    constructor: Any,
) -> None:
    """An option that one of them lacks, or has with another default, is one that surprises."""
    parameters = signature(constructor).parameters
    hints = get_type_hints(constructor.__init__)
    declared = get_type_hints(Serving)
    for option in fields(Serving):
        parameter = parameters[option.name]
        default = parameter.default
        if option.name == "problems":
            default = problem_source(default)
        else:
            assert parameter.kind is Parameter.KEYWORD_ONLY or option.name == "fields"
            # Constructors take a movement as plain values, too.
            hint = hints[option.name]
            assert hint == declared[option.name] or option.name == "movement", option.name
        assert default == option.default, option.name


@pytest.mark.parametrize("constructor", CONSTRUCTORS)
def test_every_option_arrives(constructor: Any, tmp_path: Any) -> None:
    """Each option is passed on by its own name."""
    source = samples.SPEC if constructor is OnlineMapDataset else str(tmp_path)
    if constructor is MapDataset:
        samples.build_small(tmp_path, maps=4)
    assert vars(constructor(source, **OPTIONS).serving) == OPTIONS
    assert list(OPTIONS) == [option.name for option in fields(Serving)]


@pytest.mark.parametrize("constructor", CONSTRUCTORS)
@pytest.mark.parametrize("movement", [{"connectivity": 8}, (8, False, 2**0.5), [8]], ids=str)
def test_a_movement_may_be_plain_values(constructor: Any, movement: Any, tmp_path: Any) -> None:
    """As configurations and checkpoints have it; others are refused by name."""
    source = samples.SPEC if constructor is OnlineMapDataset else str(tmp_path)
    if constructor is MapDataset:
        samples.build_small(tmp_path, maps=4)
    dataset = constructor(source, movement=movement)
    assert dataset.serving.movement == Movement(8)
    assert constructor is MapDataModule or dataset.movement == Movement(8)
    for wrong, message in (
        ({"connectivty": 8}, "movement: unknown key: connectivty.*did you mean connectivity"),
        ({"connectivity": 6}, "connectivity: got 6, expected 4 or 8"),
        ("8", "movement: got '8', expected a Movement, or a mapping such as"),
        ((), r"movement: got \(\), expected a Movement"),
        ((8, False, 1, 0), r"movement: got \(8, False, 1, 0\), expected a Movement"),
    ):
        with pytest.raises(ValueError, match=message):
            constructor(source, movement=wrong)


def test_options_are_passed_by_name_alone() -> None:
    """A position could be mistaken."""
    with pytest.raises(TypeError, match="positional"):
        Serving(("map",))  # type: ignore[call-arg]
