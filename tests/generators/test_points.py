"""Seed points of maps that have none: the largest component is scipy's, the draws those of
docs/format.md.
"""

from __future__ import annotations

import numpy as np
import pytest
from helpers import reference
from helpers.examples import examples
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy import ndimage

from mapdata import Maze
from mapdata.arrays import Bytes
from mapdata.generators import with_seed_points
from mapdata.generators.points import count_components, draw_points, largest_component

SETTINGS = examples(100)
GRIDS = arrays.arrays(
    np.uint8, st.tuples(st.integers(1, 12), st.integers(1, 12)), elements=st.integers(0, 1)
)
POINTS = 5


@SETTINGS
@given(GRIDS, st.booleans())
def test_largest_component(grid: Bytes, cut: bool) -> None:
    """The component is scipy's largest, of equals the one that holds the first cell in row-major
    order.
    """
    labels, count = ndimage.label(grid == 0, np.ones((3, 3)) if cut else None)
    cells = largest_component(grid, 2 if cut else 1)
    assert np.array_equal(cells, largest_component(grid, 2 if cut else 0))
    if count == 0:
        assert len(cells) == 0
        return
    sizes = np.bincount(labels.ravel())[1:]  # scipy numbers components in row-major order too
    assert np.array_equal(cells, np.flatnonzero(labels == 1 + int(np.argmax(sizes))))


@pytest.mark.slow  # numba compiles the kernel for each layout
@SETTINGS
@given(GRIDS, st.booleans())
def test_largest_component_of_any_layout(grid: Bytes, cut: bool) -> None:
    """In the order of Fortran, and of every other column, it is that of the contiguous grid."""
    diagonals = 2 if cut else 0
    cells = largest_component(grid, diagonals)
    assert np.array_equal(cells, largest_component(np.asfortranarray(grid), diagonals))
    assert np.array_equal(cells, largest_component(np.repeat(grid, 2, 1)[:, ::2], diagonals))


@SETTINGS
@given(GRIDS, st.booleans(), st.integers(1, 6))
def test_components_of_a_size_are_counted(grid: Bytes, cut: bool, min_cells: int) -> None:
    """Their number is that of scipy."""
    labels, _ = ndimage.label(grid == 0, np.ones((3, 3)) if cut else None)
    sizes = np.bincount(labels.ravel())[1:]
    assert count_components(grid, 2 if cut else 0, min_cells) == (sizes >= min_cells).sum()


@SETTINGS
@given(st.integers(0, 2**64 - 1), st.integers(0, 2**40), st.integers(1, 30), st.data())
def test_draws_equal_the_reference(seed: int, index: int, cells: int, data: st.DataObject) -> None:
    """Draw k of stream 5 is one of the cells left, in their order, as docs/format.md says."""
    count = data.draw(st.integers(0, cells))
    left, expected = list(range(100, 100 + cells)), []
    for k in range(count):
        word = reference.block(seed, index, 0, POINTS, k)[0]
        expected.append(left.pop(word * len(left) >> 32))
    found = draw_points(np.arange(100, 100 + cells), np.uint64(seed), np.uint64(index), count)
    assert found.tolist() == expected


def test_grids_of_a_family_are_integers() -> None:
    """numpy.zeros gives floats by default, and they cannot be packed into bits."""
    with pytest.raises(ValueError, match="grids: got float64, expected uint8"):
        with_seed_points(Maze((9, 9)), 0, np.arange(2), np.zeros((2, 9, 9)))  # type: ignore[arg-type]
