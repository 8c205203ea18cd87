"""Caves: equal to a slow reference, and smooth where the automaton ran."""

from __future__ import annotations

import re

import numpy as np
import pytest
from helpers.examples import examples
from helpers.reference_families import reference_cave, reference_points
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from mapdata import Cave, generate


@examples(100)
@given(
    st.tuples(st.integers(1, 20), st.integers(1, 20)),
    st.sampled_from([0.0, 0.3, 0.45, 0.6, 1.0]),
    st.integers(0, 5),
    st.integers(0, 2**64 - 1),
    st.integers(0, 2**63 - 1),
)
def test_any_cave_equals_the_reference(
    size: tuple[int, int], occupied: float, steps: int, seed: int, index: int
) -> None:
    """Grid and seed points, for all sizes and densities; scipy knows the largest component."""
    maps = generate(Cave(size, occupied, steps, seed_points=4), seed, [index])
    grid = np.array(reference_cave(Cave(size, occupied, steps), seed, index))
    np.testing.assert_array_equal(maps.occupancy[0], grid)
    components, _ = ndimage.label(grid == 0)
    largest = np.bincount(components[components > 0]).argmax()
    cells = [(int(row), int(column)) for row, column in np.argwhere(components == largest)]
    points = reference_points(cells, seed, index, 4)
    assert maps.rooms[0] == len(points) == min(4, len(cells))
    assert maps.seed_points[0, : len(points)].tolist() == [list(cell) for cell in points]


def test_steps_make_walls_smooth() -> None:
    """As many cells as asked for are occupied at first; each step leaves fewer edges."""
    noise = generate(Cave(steps=0), 1, range(100)).occupancy
    assert noise.mean() == pytest.approx(0.45, abs=5 * (0.45 * 0.55 / noise.size) ** 0.5)
    edges = [
        np.abs(np.diff(generate(Cave(steps=steps), 1, range(20)).occupancy.astype(int))).sum()
        for steps in range(5)
    ]
    assert edges == sorted(edges, reverse=True)
    assert edges[4] < 0.3 * edges[0]


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ({"occupied": 1.5}, "occupied: got 1.5, expected a probability"),
        ({"steps": -1}, "steps: got -1, expected an integer of at least 0"),
        ({"seed_points": 1}, "seed_points: got 1"),
        ({"seed_points": 256}, "seed_points: got 256, expected at most 255"),
        ({"map_size": (0, 4)}, "map_size"),
    ],
)
def test_bad_values_are_refused(values: dict[str, object], why: str) -> None:
    """The message names the value, and what was expected."""
    with pytest.raises(ValueError, match=re.escape(why)):
        Cave(**values)  # type: ignore[arg-type]
