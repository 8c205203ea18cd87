"""Symmetries of maps."""

from __future__ import annotations

import numpy as np
import pytest

from mapdata.problems.symmetry import transform_grids


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (6, 5), (5, 70), (9, 9), (64, 64)], ids=str)
def test_grids_are_flipped_and_transposed_as_by_numpy(
    shape: tuple[int, int],
) -> None:
    """All codes at once; those that transpose on square maps alone."""
    codes = np.arange(8 if shape[0] == shape[1] else 4)
    grids = np.random.default_rng(0).integers(0, 200, (len(codes), *shape)).astype(np.uint8)
    found = transform_grids(grids, codes)
    assert found.dtype == np.uint8
    for code, grid in zip(codes.tolist(), grids, strict=True):
        expected = grid[::-1] if code & 1 else grid
        expected = expected[:, ::-1] if code & 2 else expected
        np.testing.assert_array_equal(found[code], expected.T if code & 4 else expected)
