"""`apply_symmetry` moves your own values with the maps that ``augment=True`` turns and mirrors."""

from __future__ import annotations

import torch
from torch import Tensor

from mapdata.arrays import Array

REVERSE_ROWS, REVERSE_COLUMNS, SWAP = 1, 2, 4
"""The bits of a code, in the order in which they act (`mapdata.problems.symmetry`)."""


def apply_symmetry(values: Tensor | Array, symmetry: Tensor) -> Tensor:
    """Return values of the cells of maps after the symmetries that ``augment`` drew for the maps.

    A field function needs it for values of the maps as they are stored, such as labels that it
    reads from a file (docs/howto/labels.md). Values that it computes from ``batch.map`` have moved
    already. Each value is moved to its new cell and not changed: directions are not turned.

    Args:
        values: (B, ..., H, W), such as (B, C, H, W); or the values of one sample, without B.
        symmetry: the field ``symmetry``, (B,); or that of one sample, ().

    Returns:
        A tensor with the shape of ``values``.

    Raises:
        ValueError: the shapes do not fit, or a symmetry swaps rows and columns of values whose
            last two dimensions differ.

    >>> values = torch.tensor([[[1, 2], [3, 4]]])  # (1, 2, 2)
    >>> apply_symmetry(values, torch.tensor([1])).tolist()  # code 1 reverses the rows
    [[[3, 4], [1, 2]]]
    """
    values = torch.as_tensor(values)
    batch_shape = tuple(symmetry.shape)
    shape = tuple(values.shape)
    if len(shape) < len(batch_shape) + 2 or shape[: len(batch_shape)] != batch_shape:
        raise ValueError(
            f"values: got shape {shape}, expected (B, ..., H, W) for symmetries of shape "
            f"{batch_shape}"
        )
    rows, columns = shape[-2:]
    if rows != columns and (symmetry & SWAP).any():
        raise ValueError(
            f"values: got {rows} x {columns} cells, expected as many rows as columns, since the "
            "map is square"
        )
    if not batch_shape:
        return _turned(values, int(symmetry)).contiguous()
    turned = torch.empty_like(values)
    for code in symmetry.unique().tolist():
        has_code = symmetry == code
        turned[has_code] = _turned(values[has_code], code)
    return turned


def _turned(values: Tensor, code: int) -> Tensor:
    """Return values (..., H, W) after one symmetry."""
    if code & REVERSE_ROWS:
        values = values.flip(-2)
    if code & REVERSE_COLUMNS:
        values = values.flip(-1)
    return values.mT if code & SWAP else values
