"""Maps for a robot with a radius: the clearance of each cell, and inflated obstacles."""

from __future__ import annotations

import math
import warnings

import numpy as np
from numpy.typing import ArrayLike

from mapdata.arrays import Bytes, Float32s, Int32s
from mapdata.checks import check_number
from mapdata.jit import Int, inlined, kernel
from mapdata.search.arguments import as_grid, as_terrain, values_complaint


def clearance(grid: ArrayLike) -> Float32s:
    """Return the distance from the middle of each cell to the nearest obstacle, in cells.

    Obstacles are all points of occupied cells and the border of the map. The distance is exact, and
    0 on occupied cells.

    Args:
        grid: (H, W) of 0 free and 1 occupied, or bool.

    Returns:
        (H, W) float32. Multiplied by the resolution, it is in metres.

    Raises:
        ValueError: a grid that is not 2-D or holds other numbers.

    >>> clearance([[0, 0, 0], [0, 0, 1], [0, 0, 0]])
    array([[0.5, 0.5, 0.5],
           [0.5, 0.5, 0. ],
           [0.5, 0.5, 0.5]], dtype=float32)
    """
    distances: Float32s = clearances(_binary_grid(grid)[None])[0]
    return distances


def inflate(grid: ArrayLike, radius_cells: float) -> Bytes:
    """Return the map on which the middle of a disc-shaped robot moves: its configuration space.

    A cell is occupied if it is in ``grid``, or if its `clearance` is less than ``radius_cells``. So
    the robot may touch obstacles and the border, but not overlap them.

    Args:
        grid: (H, W) of 0 free and 1 occupied, or bool.
        radius_cells: radius of the robot, in cells: that in metres over the resolution. Rounding
            errors of floats do not matter: 0.15 / 0.1, which is less than 1.5, counts as 1.5.

    Returns:
        (H, W) uint8, 0 free and 1 occupied.

    Raises:
        ValueError: a grid that `clearance` refuses, or a radius that is not from 0 to 1,000,000.

    Warns:
        UserWarning: a radius between 0 and half a cell, which occupies no further cell: it may be
            in metres.

    Source: Lozano-Pérez, "Spatial planning: a configuration space approach", 1983,
    https://doi.org/10.1109/TC.1983.1676196.

    >>> inflate([[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]], 1.5)
    array([[1, 1, 1, 1],
           [1, 0, 0, 1],
           [1, 1, 1, 1]], dtype=uint8)
    """
    inflated = without_clearance(grid, radius_cells)
    _warn_of_no_change(radius_cells)
    return inflated


def without_clearance(grid: ArrayLike, radius_cells: float) -> Bytes:
    """Return what `inflate` returns, without a warning."""
    inflated = _binary_grid(grid).copy()
    inflate_all(inflated[None], min_squared_clearance(radius_cells, name="radius_cells"))
    return inflated


def _warn_of_no_change(radius_cells: float) -> None:
    """Warn the caller of a public function that a radius is above 0 and too small."""
    # Rounding errors do not matter: 0.35 / 0.7 as float32 counts as half a cell.
    if 0 < radius_cells < 0.5 * (1 - 1e-6):
        warnings.warn(
            f"radius_cells: a robot with a radius of {float(radius_cells):g} cells is within one "
            "cell, so the map does not change; a radius in metres is to be divided by the "
            "resolution",
            stacklevel=3,
        )


def inflate_terrain(terrain: ArrayLike, radius_cells: float) -> Bytes:
    """Return the terrain on which the middle of a disc-shaped robot moves.

    Cells that `inflate` occupies become 0; the others keep their costs. A search takes the smallest
    cost for its heuristic from this map.

    Args:
        terrain: (H, W) of integers, 0 on occupied cells and 1 to 255, the cost of a cell, on free
            ones.
        radius_cells: radius of the robot, in cells.

    Returns:
        (H, W) uint8.

    Raises:
        ValueError: terrain of another dtype or with other numbers, or a radius that `inflate`
            refuses.

    >>> inflate_terrain([[5, 5, 5, 5], [5, 1, 2, 5], [5, 5, 5, 5]], 1.5)
    array([[0, 0, 0, 0],
           [0, 1, 2, 0],
           [0, 0, 0, 0]], dtype=uint8)
    """
    grid = without_clearance(np.asarray(terrain) == 0, radius_cells)
    _warn_of_no_change(radius_cells)
    return as_terrain(np.where(grid, 0, terrain), grid)


def without_occupied(terrain: Bytes, grids: Bytes) -> Bytes:
    """Return terrain (B, H, W) that is 0 on the occupied cells of ``grids``, (B, H, W), too."""
    return np.where(grids, np.uint8(0), terrain)


def _binary_grid(grid: ArrayLike) -> Bytes:
    """Return ``grid`` (H, W) as uint8.

    Raises:
        ValueError: the grid is not 2-D, or holds other numbers than 0 and 1.
    """
    cells = as_grid(grid, 2)
    if cells.max() > 1:
        raise ValueError(values_complaint(cells))
    return cells


def min_squared_clearance(radius: float, resolution: float = 1.0, name: str = "radius") -> int:
    """Return the clearance that a robot needs, squared, in squared half cells.

    Squared clearances are whole numbers of squared half cells. A radius may differ in the last bits
    from the number that the user means, as 0.15 / 0.1 does, or as a float32 does that is read from
    a tensor. So a needed clearance that is larger than a whole number by no more than such an error
    counts as that number.

    Args:
        radius: of the robot.
        resolution: size of a cell, in the same unit.
        name: what errors call the radius.

    Raises:
        ValueError: a radius that is not from 0 to 1,000,000 cells.
    """
    radius_in_cells = check_number(name, radius) / resolution
    # Below this bound the square fits into an integer of 64 bits.
    if not 0 <= radius_in_cells < 1e6:
        raise ValueError(
            f"{name}: got {radius}, expected a number of at least 0, below 1,000,000 cells"
        )
    # The relative error of a float32 is up to 6e-8, and that of its square twice as much.
    tolerance = 3e-7
    return math.ceil((2 * radius_in_cells) ** 2 * (1 - tolerance))


@kernel
def clearances(grids: Bytes) -> Float32s:
    """Return the clearance of each cell of each map, (B, H, W) float32, in cells."""
    distances = np.empty(grids.shape, np.float32)
    squared = np.empty(grids.shape[1:], np.int32)
    for b in range(len(grids)):
        _fill_squared_clearances(grids[b], squared)
        for row in range(grids.shape[1]):
            for column in range(grids.shape[2]):
                distances[b, row, column] = math.sqrt(squared[row, column]) / 2
    return distances


def occupies_cells(min_clearance: int) -> bool:
    """Return whether inflation by this clearance, from `min_squared_clearance`, changes any map.

    The clearance of a free cell is at least half a cell, which is 1.
    """
    return min_clearance > 1


@kernel
def inflate_all(grids: Bytes, min_squared: Int) -> None:
    """Occupy the cells of each map, (B, H, W), whose clearance is too small.

    ``min_squared`` is the smallest clearance that suffices, as `min_squared_clearance` returns it.
    """
    if min_squared <= 1:
        return  # The clearance of a free cell is at least half a cell.
    squared = np.empty(grids.shape[1:], np.int32)
    for b in range(len(grids)):
        _fill_squared_clearances(grids[b], squared)
        for row in range(grids.shape[1]):
            for column in range(grids.shape[2]):
                if squared[row, column] < min_squared:
                    grids[b, row, column] = 1


@kernel
def _fill_squared_clearances(grid: Bytes, squared: Int32s) -> None:
    """Write the squared clearance of each cell of a map, in squared half cells.

    A cell that is k cells away in the same row or column begins 2 k - 1 half cells from the middle
    of a cell. First the clearance within each column alone is computed, by a pass down and a pass
    up. The clearance in the plane is then the minimum over the columns of the map. These are the
    two phases of Rosenfeld and Pfaltz 1968 and of Saito and Toriwaki 1994, section 3,
    https://doi.org/10.1016/0031-3203(94)90133-3.

    Args:
        grid: (H, W).
        squared: (H, W), to be filled.
    """
    rows, columns = grid.shape
    # The clearance of each cell of the row above, from obstacles above it; 0 for the border.
    clearance_above = np.zeros(columns, np.int32)
    for row in range(rows):
        for column in range(columns):
            distance = 0 if grid[row, column] else _next_distance(clearance_above[column])
            squared[row, column] = distance
            clearance_above[column] = distance
    clearance_below = np.zeros(columns, np.int32)
    for row in range(rows - 1, -1, -1):
        for column in range(columns):
            from_below = _next_distance(clearance_below[column])
            # The border to the left or right is at most ``columns`` half cells away, so a larger
            # distance does not matter, and its square might overflow.
            distance = min(squared[row, column], from_below, columns)
            squared[row, column] = distance * distance
            clearance_below[column] = distance
    # The squared clearances of a row within its columns. On either side zeros stand for the border,
    # as many as the farthest column that is looked at.
    padded_row = np.zeros(3 * columns, np.int32)
    for row in range(rows):
        row_squared = squared[row]
        max_squared = np.int32(0)
        for column in range(columns):
            padded_row[columns + column] = row_squared[column]
            max_squared = max(max_squared, row_squared[column])
        column_distance = 1
        # Farther columns cannot reduce any clearance: the distance to the column is too large.
        while (2 * column_distance - 1) ** 2 < max_squared:
            squared_horizontal = np.int32((2 * column_distance - 1) ** 2)
            max_squared = np.int32(0)
            for column in range(columns):
                left = padded_row[columns + column - column_distance]
                right = padded_row[columns + column + column_distance]
                through_column = squared_horizontal + min(left, right)
                row_squared[column] = min(row_squared[column], through_column)
                max_squared = max(max_squared, row_squared[column])
            column_distance += 1


@inlined
def _next_distance(distance: Int) -> Int:
    """Return the clearance of a free cell within its column, from that of its neighbour.

    It is two half cells more, or one half cell beside an obstacle, whose clearance is 0.
    """
    return distance + np.int32(2) if distance else np.int32(1)
