"""`apply_symmetry` equals numpy's flips and transposition of each sample."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from mapdata import apply_symmetry


def turned(plane: np.ndarray, code: int) -> np.ndarray:
    """Return a plane (..., H, W) after a symmetry: bits of the code flip, flip and transpose."""
    plane = np.flip(plane, -2) if code & 1 else plane
    plane = np.flip(plane, -1) if code & 2 else plane
    return np.swapaxes(plane, -2, -1) if code & 4 else plane


@pytest.mark.parametrize("dtype", ["uint8", "int64", "float32", "bool"])
@pytest.mark.parametrize("shape", [(5, 5), (1, 5, 5), (2, 3, 6, 6), (1, 4, 7), (3, 2, 4, 7)])
def test_each_sample_is_turned_by_its_own_symmetry(shape: tuple[int, ...], dtype: str) -> None:
    """With and without channels, as tensor and as array, in a batch and alone."""
    codes = torch.arange(8 if shape[-1] == shape[-2] else 4).flip(0)
    values = np.random.default_rng(0).integers(0, 200, (len(codes), *shape)).astype(dtype)
    expected = np.stack([turned(*pair) for pair in zip(values, codes.tolist(), strict=True)])
    for form in (values, torch.from_numpy(values)):
        moved = apply_symmetry(form, codes)
        assert moved.dtype == torch.from_numpy(values).dtype
        np.testing.assert_array_equal(moved, expected)
    np.testing.assert_array_equal(apply_symmetry(values[1], codes[1]), expected[1])


def test_shapes_that_do_not_fit_are_refused() -> None:
    """A symmetry for each sample, and no transposition of values that are not square."""
    codes = torch.tensor([0, 4])
    with pytest.raises(ValueError, match=r"values: got shape \(3, 5, 5\), expected \(B, \.\.\., H"):
        apply_symmetry(torch.zeros(3, 5, 5), codes)
    with pytest.raises(ValueError, match=r"values: got shape \(2, 5\), expected"):
        apply_symmetry(torch.zeros(2, 5), codes)
    with pytest.raises(ValueError, match="values: got 5 x 6 cells, expected as many rows as"):
        apply_symmetry(torch.zeros(2, 1, 5, 6), codes)
