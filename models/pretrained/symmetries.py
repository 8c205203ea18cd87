"""The eight symmetries of a square map, for planes, points and cells on it.

The code of a symmetry has three bits: bit 0 flips rows, bit 1 flips columns, and bit 2 transposes
afterwards.
"""

from __future__ import annotations

import torch
from torch import Tensor


def transform_plane(plane: Tensor, code: int) -> Tensor:
    """Return a plane (..., H, W) after a symmetry; a transposition makes it (..., W, H)."""
    if code & 1:
        plane = plane.flip(-2)
    if code & 2:
        plane = plane.flip(-1)
    if code & 4:
        plane = plane.transpose(-2, -1)
    return plane


def restore_plane(plane: Tensor, code: int) -> Tensor:
    """Return the plane from which `transform_plane` made this plane."""
    if code & 4:
        plane = plane.transpose(-2, -1)
    # Flips are their own inverses, and their order does not matter.
    return transform_plane(plane, code & 3)


def transform_points(points: Tensor, code: int, shape: torch.Size) -> Tensor:
    """Return points after a symmetry of their map.

    Cell (r, c) covers [r, r + 1) x [c, c + 1), so that a flip takes row r to row H - r.

    Args:
        points: (M, 2), row and column.
        code: code of the symmetry.
        shape: (..., H, W), shape of the map before the symmetry.
    """
    row, column = points.unbind(1)  # (M,) both
    if code & 1:
        row = shape[-2] - row
    if code & 2:
        column = shape[-1] - column
    if code & 4:
        row, column = column, row
    return torch.stack([row, column], dim=1)


def transform_cells(cells: Tensor, code: int, shape: torch.Size) -> Tensor:
    """Return cells (M, 2) after a symmetry; other arguments are those of `transform_points`."""
    centres = cells + 0.5
    return transform_points(centres, code, shape).floor().long()


def random_symmetry(fields: dict[str, Tensor], points: Tensor) -> tuple[dict[str, Tensor], Tensor]:
    """Return a batch and its points after a random symmetry, with start and goal swapped or not.

    Args:
        fields: the fields of B problems by name; of the fields other than ``start`` and ``goal``,
            those of ``map`` and ``optimal_mask`` are returned and all others are left out.
        points: (M, 2), points on the maps of the batch.
    """
    code = int(torch.randint(8, ()))
    shape = fields["map"].shape
    start = transform_cells(fields["start"], code, shape)
    goal = transform_cells(fields["goal"], code, shape)
    if torch.rand(()) < 0.5:
        start, goal = goal, start
    transformed = {"start": start, "goal": goal}
    for name in ("map", "optimal_mask"):
        if name in fields:
            transformed[name] = transform_plane(fields[name], code)
    return transformed, transform_points(points, code, shape)
