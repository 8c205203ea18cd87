"""Clearance and inflation: equal to brute force and to scipy, exact where a disc just touches."""

from __future__ import annotations

import math
import re
import warnings
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from helpers.examples import examples, slow
from helpers.families import UNIFORM
from helpers.grids import squared_half_cells
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy import ndimage

from mapdata import clearance, generate, inflate, inflate_terrain, pull_taut
from mapdata.search.footprint import min_squared_clearance

Grid = npt.NDArray[np.uint8]

GRIDS = arrays.arrays(np.uint8, arrays.array_shapes(min_dims=2, max_dims=2, max_side=20)).map(
    lambda noise: (noise < 40).astype(np.uint8)
)


@examples(200)
@given(GRIDS)
def test_clearance_equals_brute_force(grid: Grid) -> None:
    """On any map, to the last bit of a float32."""
    expected = np.sqrt(squared_half_cells(grid)) / 2
    np.testing.assert_array_equal(clearance(grid), expected.astype(np.float32))


@pytest.mark.parametrize(
    "name", [name if name in ("rooms", "cave") else slow(name) for name in UNIFORM]
)
def test_clearance_agrees_with_scipy(name: str) -> None:
    """With its exact distance transform between the corners of cells, nine times as many.

    Each cell becomes 3 x 3 of them. The nearest of an obstacle lies half a fine cell inside its
    edge, or a corner: at most 0.71 / 3 of a cell beyond the nearest point.
    """
    for grid in generate(UNIFORM[name], 5, range(20)).occupancy:
        walled = np.kron(np.pad(grid, 1, constant_values=1), np.ones((3, 3)))
        fine = ndimage.distance_transform_edt(walled == 0)[4:-4:3, 4:-4:3] / 3
        excess = fine - clearance(grid)
        assert (excess[grid == 0] > 0).all()
        assert excess.max() <= math.sqrt(0.5) / 3 + 1e-6
        assert (clearance(grid)[grid == 1] == 0).all()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:radius_cells. a robot .* is within one cell")
@examples(200)
@given(GRIDS, st.fractions(0, 6, max_denominator=20))
def test_a_disc_may_touch_and_not_overlap(grid: Grid, radius: Fraction) -> None:
    """Compared exactly, as fractions: occupied where the squared clearance is below (2 r)^2."""
    min_squared = math.ceil((2 * radius) ** 2)
    inside = squared_half_cells(grid) < min_squared
    np.testing.assert_array_equal(inflate(grid, float(radius)), (inside | (grid == 1)).astype(int))


def test_metres_over_resolution_count_as_meant() -> None:
    """0.15 m at 0.1 m a cell is 1.5 cells, although the quotient of the floats is less."""
    assert 0.15 / 0.1 < 1.5 < 0.1 * 15.000000000000002
    corridor = np.ones((5, 9), np.uint8)
    corridor[1:4] = 0
    for radius in (1.5, 0.15 / 0.1, 0.1 * 15.000000000000002):
        assert inflate(corridor, radius)[2, 1:-1].sum() == 0
        assert inflate(corridor, radius)[[1, 3]].all()
    assert inflate(corridor, 1.501).all()
    assert inflate(corridor, 999_999).all()


@pytest.mark.parametrize("resolution", [0.05, 0.1, 1.0])
def test_a_radius_that_was_a_float32_counts_as_meant(resolution: float) -> None:
    """As a tensor's item() is: for all whole and half cells up to 99."""
    hall = np.zeros((1, 200), np.uint8)
    for half_cells in range(1, 200):
        radius = half_cells / 2 * resolution
        exact = min_squared_clearance(half_cells / 2)
        assert exact == half_cells**2
        assert min_squared_clearance(radius, resolution) == exact
        assert min_squared_clearance(float(np.float32(radius)), resolution) == exact
        assert min_squared_clearance(half_cells / 2 * 1.001) > exact
    assert inflate(hall, 0.5).sum() == 0
    assert inflate(hall, 0.501).all()


def test_inflating_leaves_the_grid_alone() -> None:
    """Radius 0 is a copy; lists, bools and floats are grids, too."""
    grid = np.array([[0, 1, 0]], np.uint8)
    unchanged = inflate(grid, 0)
    unchanged[:] = 7
    assert grid.tolist() == [[0, 1, 0]]
    assert inflate([[False, True]], 0.5).tolist() == [[0, 1]]
    assert clearance(np.zeros((1, 1), np.float32)).tolist() == [[0.5]]
    assert inflate(np.zeros((1, 1)), 0.51).tolist() == [[1]]


@pytest.mark.parametrize("radius", [0.3, 0.499, np.float32(1e-9), Fraction(1, 3)])
def test_a_radius_in_metres_is_warned_of(radius: float) -> None:
    """It occupies no cell; a robot that just fits into a cell is meant so, and so is none."""
    grid = np.eye(5, dtype=np.uint8)
    with pytest.warns(UserWarning, match="is within one cell, so the map does not change") as said:
        assert np.array_equal(inflate(grid, radius), grid)
    assert said[0].filename == __file__
    with pytest.warns(UserWarning, match="is within one cell") as said:
        inflate_terrain(1 - grid, radius)
    assert said[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for fitting in (0, 0.5, float(np.float32(0.45) / np.float32(0.9)), 0.6):
            inflate(grid, fitting)
        pull_taut(np.zeros((5, 5), np.uint8), [(1, 1), (2, 1), (2, 2)], radius)  # keeps a distance


def test_long_grids_are_exact() -> None:
    """Gaps of more cells than the root of what an integer of 32 bits holds."""
    hall = np.zeros((50_000, 4), np.uint8)
    hall[70, 1] = 1
    assert np.array_equal(clearance(hall), clearance(hall.T).T)
    assert clearance(hall).max() == 1.5
    assert np.array_equal(inflate(hall, 1.5), inflate(hall.T, 1.5).T)


@pytest.mark.parametrize("resolution", [1e-10, 1e-200, 1e-320])
def test_a_radius_of_too_many_cells_is_named(resolution: float) -> None:
    """In cells it is as large as the resolution is small."""
    with pytest.raises(ValueError, match=r"radius: got 1, .*below 1,000,000 cells"):
        min_squared_clearance(1, resolution)


@pytest.mark.parametrize("radius", [-1, math.nan, math.inf, 1e6, 1e200, "wide", True, None])
def test_a_bad_radius_is_named(radius: object) -> None:
    """With what was expected."""
    with pytest.raises(ValueError, match="radius_cells: got " + re.escape(repr(radius))):
        inflate([[0]], radius)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "grid", [[[2]], [0, 1], [[[0]]], [[]], [["a"]], np.array([[0, 255]], np.uint8), [[-1, 0]]]
)
def test_a_bad_grid_is_named(grid: Any) -> None:
    """As by the searches."""
    with pytest.raises(ValueError, match="grid: got"):
        clearance(grid)
    with pytest.raises(ValueError, match="grid: got"):
        inflate(grid, 1)
