"""Splits: a draw of stream 2 against the fractions, as docs/format.md has it."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import reference

from mapdata import MapSpec
from mapdata.generators.splits import SplitMaps, draw_splits, maps_of_split, split_thresholds

SEED = 2**63 + 5
SPEC = MapSpec(splits=(0.5, 0.3, 0.2))


def code_of(index: int) -> int:
    """Return the split of a map, from the words of the page."""
    word = reference.block(SEED, index, 0, reference.SPLIT, 0)[0]
    return sum(word >= reference.threshold(limit) for limit in (0.5, 0.8))


def test_splits_are_those_of_the_page() -> None:
    """Whatever the indices, 64 bits included."""
    indices = [*range(200), 2**40, 2**62]
    found = draw_splits(np.uint64(SEED), np.array(indices), split_thresholds(SPEC.splits))
    assert found.tolist() == [code_of(index) for index in indices]


@pytest.mark.parametrize(("split", "code"), [("train", 0), ("val", 1), ("test", 2)])
def test_the_first_maps_of_a_split(split: str, code: int) -> None:
    """In order, none left out."""
    found = maps_of_split(SPEC, SEED, split, 20)
    assert found.tolist() == [index for index in range(1000) if code_of(index) == code][:20]


def test_a_split_without_maps_is_refused() -> None:
    """It would be looked for without end."""
    with pytest.raises(ValueError, match="the spec gives no map to 'val'"):
        maps_of_split(MapSpec(splits=(1.0, 0.0, 0.0)), 0, "val", 1)


@pytest.mark.parametrize(
    "splits", [(0.7, 0.3, 1 - 0.7 - 0.3), (0.9, 0.1, 1e-10)], ids=["rounding", "below 2**-32"]
)
def test_a_share_that_no_draw_hits_is_no_split(splits: tuple[float, float, float]) -> None:
    """What is left by rounding, or less than one in 2**32."""
    with pytest.raises(ValueError, match="the spec gives no map to 'test'"):
        maps_of_split(MapSpec(splits=splits), 0, "test", 1)


@pytest.mark.parametrize("split", ["train", "val", "test"])
def test_maps_far_behind_are_those_of_the_list(split: str) -> None:
    """In any order, whatever was asked for before, across the pieces in which they are drawn."""
    expected = maps_of_split(SPEC, SEED, split, 300_000)
    maps = SplitMaps(SPEC, SEED, split)
    for places in ([5, 299_999, 0, 5], [70_000, 1], list(range(290, 310)), []):
        array = np.array(places, np.int64)
        assert maps.at(array).tolist() == expected[array].tolist()
    with pytest.raises(ValueError, match="split: the spec gives no map to 'val'"):
        SplitMaps(MapSpec(splits=(1.0, 0.0, 0.0)), 0, "val")
