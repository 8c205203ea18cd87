"""Random walls: equal to a slow reference, independent cells, and no cell that is always free."""

from __future__ import annotations

import re

import numpy as np
import pytest
from helpers.examples import examples
from helpers.reference_families import reference_random_walls
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from mapdata import MapGenerator, RandomWalls, generate


@st.composite
def random_walls(draw: st.DrawFn) -> RandomWalls:
    """Any random walls of up to 20 cells a side, down to a single cell."""
    size = draw(st.tuples(st.integers(1, 20), st.integers(1, 20)))
    occupied = sorted(draw(st.tuples(*2 * [st.floats(0, 0.9)])))
    return RandomWalls(size, (occupied[0], occupied[1]))


@examples(100)
@given(random_walls(), st.integers(0, 2**64 - 1), st.integers(0, 2**63 - 1))
def test_any_random_walls_equal_the_reference(
    generator: RandomWalls, seed: int, index: int
) -> None:
    """For all sizes and densities; the seed points are free."""
    maps = generate(generator, seed, [index])
    assert maps.occupancy[0].tolist() == reference_random_walls(generator, seed, index)
    points = maps.seed_points[0, : maps.rooms[0]]
    assert len(points) > 0
    assert (maps.occupancy[0][tuple(points.T)] == 0).all()


def test_the_share_of_walls_is_that_of_independent_cells() -> None:
    """By a test of Kolmogorov and Smirnov; the middle cell is a wall as often as the others."""
    grids = generate(MapGenerator.preset("noise30"), 3, range(3000)).occupancy
    source = np.random.default_rng(0)
    expected = source.binomial(900, source.uniform(0.3, 0.5, 200_000))
    assert stats.ks_2samp(grids.sum(axis=(1, 2), dtype=int), expected).pvalue > 0.01
    shares = grids.mean(axis=0)
    assert shares[15, 15] == pytest.approx(0.4, abs=0.05)
    assert shares.min() > 0.35
    assert shares.max() < 0.45


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ({"occupied": (0.5, 0.3)}, "occupied: got (0.5, 0.3), expected (lowest, highest), 0 to"),
        ({"occupied": (0.3, 1.0)}, "occupied: got (0.3, 1.0)"),
        ({"occupied": 0.4}, "occupied"),
        ({"seed_points": 1}, "seed_points: got 1"),
    ],
)
def test_bad_values_are_refused(values: dict[str, object], why: str) -> None:
    """The message names the value, and what was expected."""
    with pytest.raises(ValueError, match=re.escape(why)):
        RandomWalls(**values)  # type: ignore[arg-type]
