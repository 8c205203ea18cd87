"""The eight symmetries of a square map, of planes, points and cells on it."""

from __future__ import annotations

import torch
from torch import Tensor


def transform_plane(plane: Tensor, code: int) -> Tensor:
    """Return (..., H, W) after a symmetry.

    Bit 0 of its code flips rows, bit 1 flips columns, bit 2 transposes at last.
    """
    if code & 1:
        plane = plane.flip(-2)
    if code & 2:
        plane = plane.flip(-1)
    return plane.transpose(-2, -1) if code & 4 else plane


def restore_plane(plane: Tensor, code: int) -> Tensor:
    """Return the plane of which `transform_plane` made this one."""
    if code & 4:
        plane = plane.transpose(-2, -1)
    return transform_plane(plane, code & 3)


def transform_points(points: Tensor, code: int, shape: torch.Size) -> Tensor:
    """Return points (M, 2) after a symmetry of their map, whose shape was (..., H, W).

    Cell (r, c) covers [r, r + 1) x [c, c + 1), so that a flip takes row to H - row.
    """
    row, column = points.unbind(1)  # (M,) both
    if code & 1:
        row = shape[-2] - row
    if code & 2:
        column = shape[-1] - column
    return torch.stack([column, row] if code & 4 else [row, column], dim=1)


def transform_cells(cells: Tensor, code: int, shape: torch.Size) -> Tensor:
    """Return cells (M, 2) after a symmetry, which moves their centres."""
    return transform_points(cells + 0.5, code, shape).floor().long()


def random_symmetry(fields: dict[str, Tensor], points: Tensor) -> tuple[dict[str, Tensor], Tensor]:
    """Return a batch and its points after a symmetry; start and goal may change places, too."""
    code = int(torch.randint(8, ()))
    shape = fields["map"].shape
    start = transform_cells(fields["start"], code, shape)
    goal = transform_cells(fields["goal"], code, shape)
    if torch.rand(()) < 0.5:
        start, goal = goal, start
    changed = {"start": start, "goal": goal}
    for name in ("map", "optimal_mask"):
        if name in fields:
            changed[name] = transform_plane(fields[name], code)
    return changed, transform_points(points, code, shape)
