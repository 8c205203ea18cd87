"""Room for a robot: how far each cell lies from the nearest obstacle, and maps for a disc."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from mapdata.arrays import Bytes, Float32s, Int32s
from mapdata.checks import check_number
from mapdata.jit import Int, inlined, kernel
from mapdata.search.api import as_grid, values_complaint


def clearance(grid: ArrayLike) -> Float32s:
    """Return the distance from the middle of each cell to the nearest obstacle.

    That is the nearest point of an occupied cell or of the border of the map, in cells: exact, and
    0 on occupied cells.

    Args:
        grid: (H, W) of 0 free and 1 occupied, or bool.

    Returns:
        (H, W) float32; times the resolution, it is in metres.

    Raises:
        ValueError: a grid that is not 2-D or holds other values.

    >>> clearance([[0, 0, 0], [0, 0, 1], [0, 0, 0]])
    array([[0.5, 0.5, 0.5],
           [0.5, 0.5, 0. ],
           [0.5, 0.5, 0.5]], dtype=float32)
    """
    found: Float32s = clearances(_binary(grid)[None])[0]
    return found


def inflate(grid: ArrayLike, radius: float) -> Bytes:
    """Return the map on which the middle of a disc moves: its configuration space.

    A cell is occupied where ``grid`` is, or where its `clearance` is less than ``radius``: the
    robot may touch an obstacle and the border, but not overlap them.

    Args:
        grid: (H, W) of 0 free and 1 occupied, or bool.
        radius: of the robot, in cells; 0.15 / 0.1 counts as 1.5.

    Returns:
        (H, W) uint8, 0 free and 1 occupied.

    Raises:
        ValueError: what `clearance` refuses, or a radius that is not from 0 to 1,000,000.

    Source: Lozano-Pérez, "Spatial planning: a configuration space approach", 1983,
    https://doi.org/10.1109/TC.1983.1676196.

    >>> inflate([[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]], 1.5)
    array([[1, 1, 1, 1],
           [1, 0, 0, 1],
           [1, 1, 1, 1]], dtype=uint8)
    """
    inflated = _binary(grid).copy()
    inflate_all(inflated[None], least_squared(radius))
    return inflated


def _binary(grid: ArrayLike) -> Bytes:
    cells = as_grid(grid, 2)
    if cells.max() > 1:
        raise ValueError(values_complaint(cells))
    return cells


def least_squared(radius: float, resolution: float = 1.0) -> int:
    """Return the clearance that a robot needs, in half cells, squared: a whole number.

    Clearances squared are whole numbers of squared half cells, so a radius that is off by the last
    bits of a float, as 0.15 / 0.1 is, or of a float32, as a tensor's item is, has to be taken for
    the number that it stands for.

    Args:
        radius: of the robot.
        resolution: what a cell measures, in the same unit.

    Raises:
        ValueError: a radius that is not from 0 to 1,000,000 cells.
    """
    cells = check_number("radius", radius) / resolution
    if not 0 <= cells < 1e6:  # whose square is a whole number of 64 bits
        raise ValueError(
            f"radius: got {radius}, expected a number of at least 0, below 1,000,000 cells"
        )
    # float32 numbers are off by 6e-8 of themselves, their squares by twice that
    return math.ceil((2 * cells) ** 2 * (1 - 3e-7))


@kernel
def clearances(grids: Bytes) -> Float32s:
    """Return the clearance of each cell of each map, (B, H, W)."""
    out = np.empty(grids.shape, np.float32)
    squared = np.empty(grids.shape[1:], np.int32)
    for b in range(len(grids)):
        _fill_squared(grids[b], squared)
        for row in range(grids.shape[1]):
            for column in range(grids.shape[2]):
                out[b, row, column] = math.sqrt(squared[row, column]) / 2
    return out


@kernel
def inflate_all(grids: Bytes, least: Int) -> None:
    """Occupy the cells of each map, (B, H, W), whose clearance is below `least_squared`."""
    if least <= 1:
        return  # any free cell has room for half a cell
    squared = np.empty(grids.shape[1:], np.int32)
    for b in range(len(grids)):
        _fill_squared(grids[b], squared)
        for row in range(grids.shape[1]):
            for column in range(grids.shape[2]):
                if squared[row, column] < least:
                    grids[b, row, column] = 1


@kernel
def _fill_squared(grid: Bytes, squared: Int32s) -> None:
    """Write the squared clearance of each cell of a map, (H, W), in half cells.

    In half cells a cell k steps away begins 2 k - 1 from the middle of this one. So first comes the
    gap in each column alone, by a pass down and one up, then the best of a row of such gaps: the
    two passes of Rosenfeld and Pfaltz 1968 and of Saito and Toriwaki 1994, section 3,
    https://doi.org/10.1016/0031-3203(94)90133-3.
    """
    rows, columns = grid.shape
    above = np.zeros(columns, np.int32)  # the border is an obstacle
    for row in range(rows):
        for column in range(columns):
            gap = 0 if grid[row, column] else _next(above[column])
            squared[row, column] = gap
            above[column] = gap
    below = np.zeros(columns, np.int32)
    for row in range(rows - 1, -1, -1):
        for column in range(columns):
            # no gap that is larger than a row can be the nearest, and its square has its limits
            gap = min(squared[row, column], _next(below[column]), columns)
            squared[row, column] = gap * gap
            below[column] = gap
    # The gaps of a row between two borders, as wide as any step away from one of its cells.
    line = np.zeros(3 * columns, np.int32)
    for row in range(rows):
        best = squared[row]
        farthest = np.int32(0)
        for column in range(columns):
            line[columns + column] = best[column]
            farthest = max(farthest, best[column])
        away = 1
        # Farther columns cannot be nearer: their part of the way alone is longer.
        while (2 * away - 1) ** 2 < farthest:
            aside = np.int32((2 * away - 1) ** 2)
            farthest = np.int32(0)
            for column in range(columns):
                left = line[columns + column - away]
                right = line[columns + column + away]
                best[column] = min(best[column], aside + min(left, right))
                farthest = max(farthest, best[column])
            away += 1


@inlined
def _next(gap: Int) -> Int:
    """Return the gap of a free cell whose neighbour has ``gap``: two half cells more."""
    return gap + np.int32(2) if gap else np.int32(1)
