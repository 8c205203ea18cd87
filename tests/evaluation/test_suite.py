"""The frozen suites: their problems never change, and the families held out are what they say."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from mapdata import PRESETS
from mapdata.arrays import Bytes
from mapdata.evaluation import SUITE_MOVEMENT, SUITES
from mapdata.evaluation.held_out import SHAPES, HeldOut
from mapdata.evaluation.suite import Part
from mapdata.generators import generate

PARTS = {part.name: part for part in SUITES["carry-over-1"]}


def drawn(shape: str, side: int = 64, count: int = 20) -> Bytes:
    """Return maps of a shape, (count, side, side)."""
    return generate(HeldOut((side, side), shape=shape), 5, range(count)).occupancy


def components(grid: Bytes) -> Iterator[Bytes]:
    """Yield the cells of each connected obstacle of a grid, as masks."""
    labels, count = ndimage.label(grid, np.ones((3, 3)))
    for label in range(1, count + 1):
        yield labels == label


def test_a_suite_has_five_families_in_and_five_out_of_two_depths() -> None:
    """And terrain apart."""
    families = {
        group: {part.name.partition("-")[0] for part in PARTS.values() if part.group == group}
        for group in ("in", "out", "terrain")
    }
    assert families["in"] == {"dungeon", "maze", "cave", "forest", "noise"}
    assert families["out"] == set(SHAPES)
    assert families["terrain"] == {"terrain"}
    names = {f"{family}-{side}" for of in families.values() for family in of for side in (64, 128)}
    assert set(PARTS) == names


def test_no_preset_is_a_family_that_is_held_out() -> None:
    """What has no preset, no training takes unawares."""
    assert not any(isinstance(generator, HeldOut) for generator in PRESETS.values())


@pytest.mark.parametrize("name", PARTS)
def test_the_problems_of_a_part_are_the_frozen_ones(name: str) -> None:
    """Two hundred problems, each on a map of its own; off terrain all of them are hard."""
    part = PARTS[name]
    problems = part.problem_set()  # which compares the hash
    assert len(problems) == problems.map_count == 200
    assert problems.movement == SUITE_MOVEMENT
    assert problems.map_size == part.generator.map_size
    assert problems.has_terrain == (part.group == "terrain")
    if part.group == "terrain":
        assert np.diff(problems.optimal.offsets).min() >= 25
    else:
        assert problems.hard.all()


def test_the_seed_of_a_part_follows_from_its_name() -> None:
    """So that nobody chose it: the first 64 bits of the SHA-256 of suite and part."""
    for part in PARTS.values():
        digits = hashlib.sha256(f"carry-over-1 {part.name}".encode()).hexdigest()
        assert f"{part.seed:016x}" == digits[:16]


def test_other_problems_than_the_frozen_ones_are_refused() -> None:
    """The message says what was drawn and what was expected."""
    part: Part = replace(PARTS["cave-64"], seed=1)
    with pytest.raises(ValueError, match=f"cave-64: got problems .*, expected {part.content_hash}"):
        part.problem_set()


@pytest.mark.parametrize("shape", ["floors", "rings"])
def test_all_free_cells_of_floors_and_rings_are_connected(shape: str) -> None:
    """No wall ends at a door, and each ring has a gap."""
    for grid in [*drawn(shape), *drawn(shape, 128, 5)]:
        _, count = ndimage.label(grid == 0)
        assert count == 1


def test_shelves_are_boxes_of_one_depth() -> None:
    """No shelf is hollow."""
    for grid in drawn("shelves"):
        depths = set()
        for shelf in components(grid):
            rows, columns = np.nonzero(shelf)
            height, width = np.ptp(rows) + 1, np.ptp(columns) + 1
            assert shelf.sum() == height * width
            depths.add(height)
        assert len(depths) == 1


def test_bars_are_thin() -> None:
    """Where no two of them meet, a bar has one cell in each row, or one in each column."""
    thin = 0
    for grid in drawn("bars"):
        for bar in components(grid):
            rows, columns = np.nonzero(bar)
            thin += bar.sum() == max(np.ptp(rows), np.ptp(columns)) + 1
    assert thin > 20


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"shape": "bar"}, "shape: got 'bar', expected .*did you mean bars"),
        ({"map_size": (31, 64)}, r"map_size: got \(31, 64\), expected at least 32 x 32"),
    ],
)
def test_other_shapes_and_small_maps_are_refused(options: dict[str, object], message: str) -> None:
    """The message says what is known."""
    with pytest.raises(ValueError, match=message):
        HeldOut(**options)  # type: ignore[arg-type]
