"""The geometry of grid maps on tensors: distances, heuristics, legal moves, cells of points."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from numpy.typing import ArrayLike
from scipy.ndimage import map_coordinates
from torch import Tensor

from mapdata import Movement
from mapdata.arrays import Bytes, Ints
from mapdata.search import STEPS


def offsets(cells: Tensor, shape: torch.Size) -> tuple[Tensor, Tensor]:
    """Return how far each row and each column is from cells (B, 2): (B, H, 1) and (B, 1, W)."""
    rows, columns = shape
    down = torch.arange(rows, device=cells.device) - cells[:, :1]  # (B, H)
    right = torch.arange(columns, device=cells.device) - cells[:, 1:]  # (B, W)
    return down[:, :, None].float(), right[:, None, :].float()


def heuristic(down: Tensor, right: Tensor, movement: Movement) -> Tensor:
    """Return the cost of going so far on an empty map: Manhattan, octile or Chebyshev distance."""
    down = down.abs()
    right = right.abs()
    if movement.connectivity == 4:
        return down + right
    return (down - right).abs() + movement.diagonal_cost * torch.minimum(down, right)


def legal_moves(occupied: Tensor, movement: Movement) -> Tensor:
    """Return (B, moves, H, W) bool: which moves are allowed from each cell of (B, 1, H, W).

    The rule of `mapdata.search.is_legal` once more, for all cells at once on the device.
    """
    free = F.pad(occupied[:, 0] == 0, (1, 1, 1, 1))  # (B, H + 2, W + 2), a wall around the map
    legal = []
    for row, column in STEPS[: movement.connectivity].tolist():
        # rolled, so that each cell has what its neighbour is; over the border come walls
        allowed = free.roll((-row, -column), (1, 2))
        if row and column and not movement.corner_cutting:  # diagonal: both sides must be free
            allowed = allowed & free.roll(-row, 1) & free.roll(-column, 2)
        legal.append(allowed[:, 1:-1, 1:-1])
    return torch.stack(legal, dim=1)


def cell_numbers(points: Tensor, occupied: Tensor) -> Tensor:
    """Return the number row * columns + column of each point's cell, (M,), of maps (B, 1, H, W)."""
    rows, columns = occupied.shape[2:]
    row, column = points.floor().long().unbind(1)  # (M,) both
    return row.clamp(0, rows - 1) * columns + column.clamp(0, columns - 1)


def check_problems(
    maps: ArrayLike, starts: ArrayLike, goals: ArrayLike
) -> tuple[Bytes, Ints, Ints]:
    """Return one problem or B of them as new arrays: (B, H, W) of 0 and 1, starts, goals (B, 2).

    Raises:
        ValueError: a map without a free cell, a start or goal outside its map or on an occupied
            cell, or not of integers.
    """
    cells = np.asarray(maps)
    grids = (cells != 0).astype(np.uint8).reshape(-1, *cells.shape[-2:])
    if grids.all(axis=(1, 2)).any():
        raise ValueError(f"map: got one of {grids.shape[1:]} without a free cell")
    ends = []
    for name, given in (("start", starts), ("goal", goals)):
        end = np.atleast_2d(given)
        if end.dtype.kind not in "iu":
            raise ValueError(f"{name}: got {given!r}, expected whole numbers")
        end = end.astype(np.int64)
        # of order 0, the value of a cell itself; outside the map all is occupied
        occupied = map_coordinates(grids, [np.arange(len(grids)), *end.T], order=0, cval=1)  # (B,)
        if occupied.any():
            raise ValueError(
                f"{name}: got {end[occupied.argmax()].tolist()}, outside its map or on an occupied "
                f"cell, expected a free cell of a map of {grids.shape[1:]}"
            )
        ends.append(end)
    return grids, ends[0], ends[1]
