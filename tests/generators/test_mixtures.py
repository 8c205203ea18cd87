"""Mixtures: each map is that of a part, drawn as docs/format.md says."""

from __future__ import annotations

import json
import re
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.examples import examples
from helpers.families import forget
from helpers.reference import block, threshold
from hypothesis import given
from hypothesis import strategies as st

from mapdata import (
    PRESETS,
    Cave,
    MapGenerator,
    MapSpec,
    Maze,
    Mixture,
    Movement,
    Terrain,
    build,
    generate,
    label,
    read_shard,
    verify,
)
from mapdata.generators import UnknownFamily, as_recipe
from mapdata.generators.recipe import is_same_map
from mapdata.generators.stored_families import stored_generator
from mapdata.shards import read_manifest

DOCS = Path(__file__).parents[2] / "docs"

SMALL = Mixture(
    parts=(MapSpec((12, 15), (2, 4), (2, 5), (2, 5), (1, 2)), Maze((12, 15)), Cave((12, 15))),
    shares=(0.5, 0.3, 0.2),
)
"""Parts with different numbers of seed points, two of them without rooms."""


def reference_part(mixture: Mixture, seed: int, index: int) -> int:
    """Return the number of the part that draws a map, from 0, as docs/format.md states it."""
    shares = mixture.shares or [1 / len(mixture.parts)] * len(mixture.parts)
    word, _, _, _ = block(seed, index, 0, 10, 0)
    ends = [threshold(total) for total in accumulate(shares[:-1])] + [2**32]
    return next(part for part, end in enumerate(ends) if word < end)


@examples(60)
@given(
    st.sampled_from(
        [SMALL, Mixture(parts=SMALL.parts), Mixture(parts=SMALL.parts, shares=(0, 1, 0))]
    ),
    st.integers(0, 2**64 - 1),
    st.lists(st.integers(0, 2**63 - 1), min_size=1, max_size=6),
)
def test_a_map_is_that_of_its_part(mixture: Mixture, seed: int, indices: list[int]) -> None:
    """Of the same seed and number, with its split, seed points, rooms and passages."""
    maps = generate(mixture, seed, indices)
    for k, index in enumerate(indices):
        part = mixture.parts[reference_part(mixture, seed, index)]
        of_part = generate(part, seed, [index])
        assert is_same_map(maps, k, of_part, 0)
        assert maps.split[k] == of_part.split[0]
        rooms = maps.rooms[k]
        assert (maps.seed_points[k, rooms:] == -1).all()
    assert mixture.part_numbers(seed, np.array(indices)).tolist() == [
        reference_part(mixture, seed, index) for index in indices
    ]


def test_a_dataset_of_a_mixture_has_exact_labels(tmp_path: Path) -> None:
    """Built, verified and served like that of any family, also where rooms are missing."""
    build(tmp_path / "maps", SMALL, maps=25, seed=4, shard_size=10)
    assert verify(tmp_path / "maps") == []
    assert read_manifest(tmp_path / "maps").generator == SMALL
    part_numbers = SMALL.part_numbers(4, np.arange(25))
    assert set(part_numbers) == {0, 1, 2}
    labels = [read_shard(file) for file in sorted((tmp_path / "maps").glob("*.h5"))]
    for i, part_number in enumerate(part_numbers):
        of_part = label(generate(SMALL.parts[part_number], 4, [i]))
        of_mixture = labels[i // 10]
        for search in ("bfs", "astar"):
            np.testing.assert_array_equal(
                of_mixture.matrix(search, i % 10), of_part.matrix(search, 0)
            )
            np.testing.assert_array_equal(
                of_mixture.iterations(search, i % 10), of_part.iterations(search, 0)
            )


@pytest.mark.parametrize("mixture", [SMALL, PRESETS["mixed"], Terrain(over=SMALL)])
def test_a_mixture_survives_json(mixture: MapGenerator) -> None:
    """Recipes, shards and manifests state its parts as nested objects."""
    text = mixture.to_json()
    assert MapGenerator.from_json(text) == mixture
    assert stored_generator(text) == mixture
    assert hash(mixture) == hash(stored_generator(text))


def test_parts_may_be_names_of_presets_in_json() -> None:
    """As wherever JSON states a generator."""
    spec = {"generator": "mixture", "parts": ["paper", {"generator": "cave", "steps": 2}]}
    mixture = as_recipe({"spec": spec}).generator
    assert mixture == Mixture(parts=(MapSpec(), Cave(steps=2)))
    assert mixture.description == (
        "a mixture of maps of several families: maps drawn by Algorithm 1 of arXiv 2110.13242; "
        "caves made by a cellular automaton"
    )


def test_a_stored_mixture_with_an_unknown_part_can_be_read() -> None:
    """Also under terrain. It keeps its JSON, and refuses to draw maps."""
    values = SMALL.to_dict()
    values["parts"][1] = {**values["parts"][1], "generator": "shelves"}
    for stored in (values, {"generator": "terrain", "costs": [1, 2], "over": values}):
        generator = stored_generator(json.dumps(stored))
        assert any(isinstance(part, UnknownFamily) for part in generator.inner_generators)
        assert '"shelves"' in generator.to_json()
        with pytest.raises(ValueError, match="the family 'shelves' is not known here"):
            generator.draw(0, np.arange(20))
    forget("shelves")


def test_the_preset_has_the_families_that_a_suite_has_in() -> None:
    """So what is trained on `mixed` may be measured on families that it has not seen."""
    mixed = PRESETS["mixed"]
    assert isinstance(mixed, Mixture)
    names = ("dungeon", "maze", "cave", "forest", "noise")
    assert mixed.parts == tuple(PRESETS[name] for name in names)
    counts = np.bincount(mixed.part_numbers(0, np.arange(50_000)))
    assert (abs(counts - 10_000) < 5 * (50_000 * 0.2 * 0.8) ** 0.5).all()


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ({}, "parts: got (), expected at least two generators"),
        ({"parts": (Cave(),)}, "expected at least two generators"),
        ({"parts": Cave()}, "expected at least two generators"),
        ({"parts": (Cave(), "maze")}, "parts: got 'maze', expected a MapGenerator, such as Cave()"),
        ({"parts": (Cave(), Terrain())}, "expected generators without terrain; Terrain(over=Mix"),
        ({"parts": (Cave(), SMALL)}, "parts: got a mixture in a mixture, expected its parts"),
        ({"parts": (Cave(), Maze((9, 9)))}, "got the map_size (64, 64) and (9, 9), expected the"),
        ({"parts": (Cave(), Maze(movement=Movement(8)))}, "parts: got the movement Movement"),
        ({"parts": (Cave(), Maze()), "shares": (1,)}, "shares: got (1,), expected 2 fractions"),
        ({"parts": (Cave(), Maze()), "shares": 0.5}, "shares: got 0.5, expected 2 fractions"),
        (
            {"parts": (Cave(), Maze()), "map_size": (9, 9)},
            "map_size: got (9, 9), but `parts` decides on it and has (64, 64); leave it out",
        ),
    ],
)
def test_bad_values_are_refused(values: dict[str, Any], why: str) -> None:
    """The message names the parameter, and what was expected."""
    with pytest.raises(ValueError, match=re.escape(why)):
        Mixture(**values)


def test_a_mixture_in_itself_is_refused_at_any_depth() -> None:
    """Even where it lies too deep for Python's recursion, and with terrain between."""
    values: dict[str, Any] = {"generator": "cave"}
    for _ in range(2500):
        values = {"generator": "terrain", "over": {"generator": "mixture", "parts": [values]}}
    for nested, family in ((values, "terrain"), (values["over"], "mixture")):
        with pytest.raises(ValueError, match=f"got the family '{family}' in itself"):
            MapGenerator.from_dict(nested)
