"""Forests: equal to a slow reference, covered as they say, and noise at one end."""

from __future__ import annotations

import re

import numpy as np
import pytest
from helpers.examples import examples
from helpers.reference_families import reference_forest
from hypothesis import given
from hypothesis import strategies as st

from mapdata import Forest, MapGenerator, generate


@st.composite
def forests(draw: st.DrawFn) -> Forest:
    """Any forest of up to 20 cells a side."""
    size = draw(st.tuples(st.integers(1, 20), st.integers(1, 20)))
    cover = sorted(draw(st.tuples(*2 * [st.floats(0, 0.5)])))
    sizes = sorted(draw(st.tuples(*2 * [st.integers(1, min(size))])))
    return Forest(size, (cover[0], cover[1]), (sizes[0], sizes[1]))


@examples(100)
@given(forests(), st.integers(0, 2**64 - 1), st.integers(0, 2**63 - 1))
def test_any_forest_equals_the_reference(generator: Forest, seed: int, index: int) -> None:
    """For all sizes, densities and obstacles; the seed points are free."""
    maps = generate(generator, seed, [index])
    assert maps.occupancy[0].tolist() == reference_forest(generator, seed, index)
    points = maps.seed_points[0, : maps.rooms[0]]
    assert (maps.occupancy[0][tuple(points.T)] == 0).all()


@pytest.mark.slow
def test_cover_is_uniform_in_its_range() -> None:
    """Of noise exactly what was drawn, but for the middle cell; of larger obstacles a little more.

    The bounds are five standard deviations of the mean.
    """
    for name, beyond in (("noise", 0.0), ("forest", 0.01)):
        cover = generate(MapGenerator.preset(name), 3, range(1000)).occupancy.mean(axis=(1, 2))
        assert cover.mean() == pytest.approx(0.25 + beyond / 2, abs=5 * 0.3 / 12000**0.5 + beyond)
        assert 0.1 - 1 / 4096 <= cover.min() < 0.11
        assert 0.39 < cover.max() < 0.4 + 2 * beyond


def test_obstacles_are_discs_and_boxes() -> None:
    """Alone on a map an obstacle of 9 is a square of 81 cells, or the 69 whose middles it holds."""
    generator = Forest(cover=(1 / 4096, 1 / 4096), sizes=(9, 9))
    counts = generate(generator, 5, range(400)).occupancy.sum(axis=(1, 2), dtype=int)
    radius = np.arange(9) - 4
    disc = int((np.hypot(radius, radius[:, None]) <= 4.5).sum())
    inside = counts[counts >= disc - 1]  # others are clipped at the border
    assert {disc, 81} <= set(inside.tolist())
    share = (counts == 81).sum() / ((counts == 81) | (counts == disc)).sum()
    assert share == pytest.approx(0.5, abs=0.15)


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ({"cover": (0.3, 0.2)}, "cover: got (0.3, 0.2), expected (lowest, highest), 0 to 0.5"),
        ({"cover": (0.1, 0.6)}, "cover: got (0.1, 0.6)"),
        ({"cover": (0.1,)}, "cover: got (0.1,), expected"),
        ({"cover": "much"}, "cover"),
        ({"sizes": (0, 3)}, "sizes: got (0, 3), expected at least 1"),
        ({"map_size": (8, 64)}, "sizes: got (2, 9), expected at most 8, the shorter side"),
        ({"seed_points": 1}, "seed_points: got 1"),
    ],
)
def test_bad_values_are_refused(values: dict[str, object], why: str) -> None:
    """The message names the value, and what was expected."""
    with pytest.raises(ValueError, match=re.escape(why)):
        Forest(**values)  # type: ignore[arg-type]
