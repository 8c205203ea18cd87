"""The geometry of grid maps on tensors: distances, heuristics, legal moves, cells of points."""

from __future__ import annotations

import math

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from numpy.typing import ArrayLike
from torch import Tensor

from mapdata import Movement
from mapdata.arrays import Bytes, Ints
from mapdata.search import STEPS


def offsets(cells: Tensor, shape: torch.Size) -> tuple[Tensor, Tensor]:
    """Return the distances of all rows and columns from cells, (B, H, 1) and (B, 1, W).

    Args:
        cells: (B, 2), row and column.
        shape: (H, W).

    Returns:
        How far each row lies below the cell, and each column to its right; negative above and to
        the left.
    """
    rows, columns = shape
    down = torch.arange(rows, device=cells.device) - cells[:, :1]  # (B, H)
    right = torch.arange(columns, device=cells.device) - cells[:, 1:]  # (B, W)
    return down[:, :, None].float(), right[:, None, :].float()


def heuristic(down: Tensor, right: Tensor, movement: Movement) -> Tensor:
    """Return the cost on an empty map: the Manhattan, octile or Chebyshev distance, in cells.

    Args:
        down: rows between two cells, of any shape and sign.
        right: columns between the cells; both are broadcast.
        movement: how one moves.
    """
    down = down.abs()
    right = right.abs()
    if movement.connectivity == 4:
        return down + right
    return (down - right).abs() + movement.diagonal_cost * torch.minimum(down, right)


def legal_moves(occupied: Tensor, movement: Movement) -> Tensor:
    """Return which moves are legal from each cell, (B, moves, H, W) bool.

    This is the rule of `mapdata.search.lattice.is_legal`, for all cells at once, on the device of
    the map.

    Args:
        occupied: (B, 1, H, W), 0 free and anything else occupied.
        movement: how one moves.
    """
    # A border of occupied cells, so that no move leaves the map.
    free = F.pad(occupied[:, 0] == 0, (1, 1, 1, 1))  # (B, H + 2, W + 2)
    legal = []
    for down, right in STEPS[: movement.connectivity].tolist():
        # A plane that is rolled against the move has at each cell the value of its neighbour.
        is_legal = free.roll((-down, -right), (1, 2))
        is_diagonal = down != 0 and right != 0
        if is_diagonal and not movement.corner_cutting:
            is_legal = is_legal & free.roll(-down, 1) & free.roll(-right, 2)
        legal.append(is_legal[:, 1:-1, 1:-1])
    return torch.stack(legal, dim=1)


def min_and_mean_costs(terrain: Tensor) -> tuple[Tensor, Tensor]:
    """Return the smallest and the mean cost of the free cells of each map, (B, 1, 1) both, float.

    Args:
        terrain: (B, 1, H, W), the cost of each cell, 0 on occupied cells; some cell is free.
    """
    costs = terrain[:, 0].float()  # (B, H, W)
    is_free = costs > 0
    min_costs = torch.where(is_free, costs, math.inf).amin(dim=(1, 2), keepdim=True)
    free_counts = is_free.sum(dim=(1, 2), keepdim=True)  # (B, 1, 1)
    return min_costs, costs.sum(dim=(1, 2), keepdim=True) / free_counts


def cell_numbers(points: Tensor, occupied: Tensor) -> Tensor:
    """Return the number of the cell in which each point lies, row * columns + column, (M,).

    Points outside the map count as points in its nearest cell.

    Args:
        points: (M, 2), row and column; the cells themselves may be given, too.
        occupied: (B, 1, H, W), maps of the size in question.
    """
    rows, columns = occupied.shape[2:]
    row, column = points.floor().long().unbind(1)  # (M,) both
    return row.clamp(0, rows - 1) * columns + column.clamp(0, columns - 1)


def check_problems(
    maps: ArrayLike, starts: ArrayLike, goals: ArrayLike
) -> tuple[Bytes, Ints, Ints]:
    """Return one problem or B problems as new arrays.

    Args:
        maps: (H, W) or (B, H, W), 0 free and 1 occupied, of any dtype.
        starts: (2,) or (B, 2), cells.
        goals: (2,) or (B, 2), cells.

    Returns:
        Maps (B, H, W) of 0 and 1, starts (B, 2) and goals (B, 2).

    Raises:
        ValueError: a map with other values than 0 and 1 or without a free cell; a start or goal
            outside its map, on an occupied cell, or not of integers.
    """
    cells = np.asarray(maps)
    is_occupied = cells == 1
    is_neither = ~is_occupied & (cells != 0)
    if is_neither.any():
        value = cells[is_neither][0]
        raise ValueError(f"map: got the value {value}, expected 0 free and 1 occupied only")
    grids = is_occupied.astype(np.uint8).reshape(-1, *cells.shape[-2:])
    if len(grids) > 1 and np.size(starts) == 2:  # such as a picture (H, W, 3)
        raise ValueError(f"map: got shape {cells.shape}, expected one map (H, W) for one start")
    if grids.all(axis=(1, 2)).any():
        raise ValueError(
            f"map: got one of {grids.shape[1:]} without a free cell; 0 is free and 1 is occupied"
        )
    return grids, _checked_ends("start", starts, grids), _checked_ends("goal", goals, grids)


def _checked_ends(name: str, ends: ArrayLike, grids: Bytes) -> Ints:
    """Return starts or goals as a new array (B, 2), after checking that their cells are free."""
    cells = np.atleast_2d(ends)
    if cells.dtype.kind not in "iu":
        raise ValueError(f"{name}: got {ends!r}, expected whole numbers")
    cells = cells.astype(np.int64)
    if cells.shape != (len(grids), 2):
        raise ValueError(f"{name}: got shape {cells.shape}, expected {(len(grids), 2)}")
    row, column = cells.T  # (B,) both
    rows, columns = grids.shape[1:]
    is_inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)  # (B,)
    inside_cells = np.where(is_inside, (row, column), 0)  # (2, B), where the map can be looked up
    is_free = is_inside & (grids[(np.arange(len(grids)), *inside_cells)] == 0)  # (B,)
    if not is_free.all():
        k = is_free.argmin()
        place = (
            "on an occupied cell (0 is free, 1 is occupied)"
            if is_inside[k]
            else f"outside the map of {rows} x {columns} cells"
        )
        raise ValueError(f"{name}: {tuple(cells[k].tolist())} is {place}")
    return cells
