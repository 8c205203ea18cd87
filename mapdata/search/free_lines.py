"""Is a line free? Exact tests of its segments against the occupied cells of a map.

All coordinates in this module are whole numbers of 1/256 cell, (row, col) from the upper left
corner of the map, so every test is exact. The middle of cell (0, 0) is (128, 128).

A line is free if it does not enter the inside of the union of the occupied cells and the outside of
the map. It may touch that union, but it cannot pass between two cells that share a side. It may
touch a point where two occupied cells meet diagonally only where corners may be cut. For a robot
with a radius a line is free if each of its points is at least that far from every occupied cell and
from the border.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from mapdata.arrays import Bytes, Flags, Ints
from mapdata.checks import check_number
from mapdata.jit import Int, inlined, kernel
from mapdata.search.arguments import as_grid, values_complaint

CELL = 256
"""The side of a cell."""

MIDDLE = CELL // 2
"""The middle of a cell, from its upper or left side."""

MAX_TAUT_SIDE = 2**16
"""Largest number of rows or columns: up to here cross products fit int64, and float32 is exact."""


def lines_are_free(
    grids: ArrayLike, lines: ArrayLike, radius_cells: float = 0, *, corner_cutting: bool = False
) -> Flags:
    """Return whether lines of points collide with no obstacle, for instance those of a model.

    A line is free as in `mapdata.pull_taut`: no point of its segments is inside the union of the
    occupied cells and the outside of the map, or nearer to it than ``radius_cells``.

    Args:
        grids: (B, H, W) of 0 free and 1 occupied, or bool; also (B, 1, H, W), as datasets serve the
            field ``map``.
        lines: (B, T, 2) points (row, col) in cells, T at least 1; they are rounded to 1/256. A line
            with a number that is not finite collides.
        radius_cells: radius of the robot, in cells.
        corner_cutting: whether a line may touch a point where two occupied cells meet diagonally.

    Returns:
        (B,) bool.

    Raises:
        ValueError: grids that hold other values or are too large; lines of another shape.

    >>> grid = [[0, 0, 0], [0, 1, 1], [0, 0, 0]]
    >>> lines_are_free([grid, grid], [[[0.5, 0.5], [2.5, 0.5]], [[0.5, 0.5], [2.5, 1.5]]])
    array([ True, False])
    """
    maps = np.asarray(grids)
    has_channel = maps.ndim == 4 and maps.shape[1] == 1
    cells = as_grid(maps[:, 0] if has_channel else maps, 3)
    if cells.size and cells.max() > 1:
        raise ValueError(values_complaint(cells))
    points = np.asarray(lines, np.float64)
    is_batch = points.ndim == 3 and points.shape[1] > 0 and points.shape[2] == 2
    if not is_batch or len(points) != len(cells):
        raise ValueError(
            f"lines: got shape {points.shape} for {len(cells)} grids, expected ({len(cells)}, T, 2)"
        )
    check_size(cells)
    # A point outside the map stays outside where it is moved closer to it. So a point that is not
    # finite, such as those of a network that diverged, may stand outside, too.
    inside_or_near = np.clip(np.nan_to_num(points, nan=-1.0), -1, MAX_TAUT_SIDE + 1)
    rounded = np.rint(inside_or_near * CELL).astype(np.int64)
    return _lines_are_free(cells, rounded, squared_radius_of(radius_cells), corner_cutting)


def check_size(grid: Bytes) -> None:
    """Raise ValueError for a grid (..., H, W) on which cross products would not fit int64."""
    rows, columns = grid.shape[-2:]
    if max(rows, columns) > MAX_TAUT_SIDE:
        raise ValueError(
            f"grid: got {rows} x {columns} cells, expected at most {MAX_TAUT_SIDE:,} rows and "
            "columns"
        )


def squared_radius_of(radius: float, resolution: float = 1.0) -> int:
    """Return the squared distance from obstacles that a disc needs, in (1/256 cell)**2.

    Like `mapdata.inflate`, it takes 0.15 / 0.1 and a float32 of 1.5 for 1.5.

    Args:
        radius: at least 0, below ``MAX_TAUT_SIDE`` cells.
        resolution: length of the side of a cell, in the unit of the radius.

    Raises:
        ValueError: a radius that is out of range.
    """
    cells = check_number("radius_cells", radius) / resolution
    if not 0 <= cells < MAX_TAUT_SIDE:
        raise ValueError(
            f"radius_cells: got {radius}, expected a number of at least 0, below "
            f"{MAX_TAUT_SIDE:,} cells"
        )
    return math.ceil((CELL * cells) ** 2 * (1 - 3e-7))


# --- kernels ------------------------------------------------------------------------------------


@inlined
def is_occupied(grid: Bytes, row: Int, column: Int) -> Int:
    """Return whether a cell is occupied or outside the map."""
    rows, columns = grid.shape
    is_outside = row < 0 or row >= rows or column < 0 or column >= columns
    return is_outside or grid[row, column] != 0


@inlined
def rounded_up(dividend: Int, divisor: Int) -> Int:
    """Return the quotient, rounded up; the divisor is above 0."""
    return -((-dividend) // divisor)


@kernel
def _is_pinched(grid: Bytes, row: Int, column: Int) -> Int:
    """Return whether exactly two cells at a corner of cells are occupied, and they face each other.

    The corner is the upper left one of cell (row, column).
    """
    north_west = is_occupied(grid, row - 1, column - 1)
    north_east = is_occupied(grid, row - 1, column)
    south_west = is_occupied(grid, row, column - 1)
    south_east = is_occupied(grid, row, column)
    return north_west == south_east and north_east == south_west and north_west != north_east


@kernel
def _is_free_point(grid: Bytes, row: Int, column: Int, corner_cutting: Int) -> Int:
    """Return whether a point, as a segment without length, is free for a point robot."""
    lower = row // CELL
    upper = lower - 1 if row % CELL == 0 else lower
    right = column // CELL
    left = right - 1 if column % CELL == 0 else right
    if (
        is_occupied(grid, upper, left)
        and is_occupied(grid, upper, right)
        and is_occupied(grid, lower, left)
        and is_occupied(grid, lower, right)
    ):
        return False
    is_corner = upper != lower and left != right
    return corner_cutting or not is_corner or not _is_pinched(grid, lower, right)


@kernel
def _is_free_horizontally(grid: Bytes, row: Int, left: Int, right: Int, corner_cutting: Int) -> Int:
    """Return whether a horizontal segment with a length is free for a point robot."""
    lower = row // CELL
    is_between_rows = row % CELL == 0
    upper = lower - 1 if is_between_rows else lower
    for column in range(left // CELL, rounded_up(right, CELL)):
        if is_occupied(grid, upper, column) and is_occupied(grid, lower, column):
            return False
    if is_between_rows and not corner_cutting:
        for column in range(rounded_up(left, CELL), right // CELL + 1):
            if _is_pinched(grid, lower, column):
                return False
    return True


@kernel
def _is_free_between_columns(
    grid: Bytes, top: Int, bottom: Int, column: Int, corner_cutting: Int
) -> Int:
    """Return whether a vertical segment on the left side of cells of ``column`` is free."""
    for row in range(top // CELL, rounded_up(bottom, CELL)):
        if is_occupied(grid, row, column - 1) and is_occupied(grid, row, column):
            return False
    if not corner_cutting:
        for row in range(rounded_up(top, CELL), bottom // CELL + 1):
            if _is_pinched(grid, row, column):
                return False
    return True


@kernel
def is_free_segment(
    grid: Bytes, row0: Int, column0: Int, row1: Int, column1: Int, corner_cutting: Int
) -> Int:
    """Return whether a segment is free for a point robot.

    Args:
        grid: (H, W) uint8, 1 occupied.
        row0: row of the first end, in 1/256 cell.
        column0: column of the first end.
        row1: row of the second end.
        column1: column of the second end.
        corner_cutting: whether the segment may touch a point where two occupied cells meet
            diagonally.
    """
    rows, columns = grid.shape
    left = min(column0, column1)
    right = max(column0, column1)
    if row0 == row1 and column0 == column1:
        return _is_free_point(grid, row0, column0, corner_cutting)
    if min(row0, row1) < 0 or max(row0, row1) > rows * CELL or left < 0 or right > columns * CELL:
        return False
    if row0 == row1:
        return _is_free_horizontally(grid, row0, left, right, corner_cutting)
    if row0 < row1:
        top, bottom, column_at_top, run = row0, row1, column0, column1 - column0
    else:
        top, bottom, column_at_top, run = row1, row0, column1, column0 - column1
    if run == 0 and left % CELL == 0:
        return _is_free_between_columns(grid, top, bottom, left // CELL, corner_cutting)
    # In the rows of one row of cells, the segment passes columns from ``start`` to ``end``. These
    # are multiplied by its height, so that they are whole numbers.
    height = bottom - top
    scaled_cell = height * CELL
    start = column_at_top * height
    for row in range(top // CELL, rounded_up(bottom, CELL)):
        upper = max(top, row * CELL)
        lower = min(bottom, (row + 1) * CELL)
        end = start + (lower - upper) * run
        first = min(start, end) // scaled_cell
        last = rounded_up(max(start, end), scaled_cell) - 1
        for column in range(first, last + 1):
            if is_occupied(grid, row, column):
                return False
        if not corner_cutting:
            starts_at_corner = upper == row * CELL and start % scaled_cell == 0
            if starts_at_corner and _is_pinched(grid, row, start // scaled_cell):
                return False
            ends_at_corner = lower == (row + 1) * CELL and end % scaled_cell == 0
            if ends_at_corner and _is_pinched(grid, row + 1, end // scaled_cell):
                return False
        start = end
    return True


_LOW_BITS = np.uint64(2**32 - 1)
_HALF_WORD = np.uint64(32)


@inlined
def _product(a: Int, b: Int) -> tuple[Int, Int]:
    """Return the product of two whole numbers from 0 to 2**63 - 1: its high and low 64 bits."""
    a_low = np.uint64(a) & _LOW_BITS
    a_high = np.uint64(a) >> _HALF_WORD
    b_low = np.uint64(b) & _LOW_BITS
    b_high = np.uint64(b) >> _HALF_WORD
    low = a_low * b_low
    first = a_high * b_low + (low >> _HALF_WORD)
    second = a_low * b_high + (first & _LOW_BITS)
    high = a_high * b_high + (first >> _HALF_WORD) + (second >> _HALF_WORD)
    return high, (second << _HALF_WORD) | (low & _LOW_BITS)


@kernel
def _is_far_from_corner(row: Int, column: Int, rise: Int, run: Int, squared_radius: Int) -> Int:
    """Return whether a point has at least the radius as distance to the inside of a segment.

    It has, too, where its foot on the line through the segment is not between the ends.

    Args:
        row: of the point, counted from the first end of the segment.
        column: of the point, counted from there, too.
        rise: row of the second end, counted from the first one.
        run: column of the second end, counted from the first one.
        squared_radius: the smallest squared distance.
    """
    squared_length = rise * rise + run * run
    along = row * rise + column * run
    if along <= 0 or along >= squared_length:
        return True
    # The distance is cross / length; squares of cross products need up to 98 bits.
    cross = abs(row * run - column * rise)
    cross_high, cross_low = _product(cross, cross)
    bound_high, bound_low = _product(squared_radius, squared_length)
    return cross_high > bound_high or (cross_high == bound_high and cross_low >= bound_low)


@kernel
def has_room(
    grid: Bytes, row0: Int, column0: Int, row1: Int, column1: Int, squared_radius: Int
) -> Int:
    """Return whether a segment keeps its distance from all occupied cells and from the border.

    A segment that crosses an occupied cell is for `is_free_segment` to find: between two of the
    cell's corners it can be far from all of them.

    Args:
        grid: (H, W) uint8, 1 occupied.
        row0: row of the first end, in 1/256 cell.
        column0: column of the first end.
        row1: row of the second end.
        column1: column of the second end.
        squared_radius: the smallest squared distance, in (1/256 cell)**2.
    """
    rows, columns = grid.shape
    top = min(row0, row1)
    bottom = max(row0, row1)
    left = min(column0, column1)
    right = max(column0, column1)
    room = min(top, left, rows * CELL - bottom, columns * CELL - right)
    if room < 0 or room * room < squared_radius:
        return False
    radius = math.ceil(math.sqrt(squared_radius)) + 1
    rise = row1 - row0
    run = column1 - column0
    for row in range(max(0, (top - radius) // CELL), min(rows, (bottom + radius) // CELL + 1)):
        for column in range(
            max(0, (left - radius) // CELL), min(columns, (right + radius) // CELL + 1)
        ):
            if grid[row, column] == 0:
                continue
            upper = row * CELL
            lower = upper + CELL
            west = column * CELL
            east = west + CELL
            for end_row, end_column in ((row0, column0), (row1, column1)):
                down = max(upper - end_row, end_row - lower, 0)
                across = max(west - end_column, end_column - east, 0)
                if down * down + across * across < squared_radius:
                    return False
            for corner_row in (upper, lower):
                for corner_column in (west, east):
                    if not _is_far_from_corner(
                        corner_row - row0, corner_column - column0, rise, run, squared_radius
                    ):
                        return False
    return True


@kernel
def are_free(
    grid: Bytes, points: Ints, first: Int, parts: Int, squared_radius: Int, corner_cutting: Int
) -> Int:
    """Return whether the ``parts`` segments between points from row ``first`` on are free."""
    for k in range(first, first + parts):
        row0 = points[k, 0]
        column0 = points[k, 1]
        row1 = points[k + 1, 0]
        column1 = points[k + 1, 1]
        if not is_free_segment(grid, row0, column0, row1, column1, corner_cutting):
            return False
        if squared_radius and not has_room(grid, row0, column0, row1, column1, squared_radius):
            return False
    return True


@kernel
def _lines_are_free(grids: Bytes, lines: Ints, squared_radius: Int, corner_cutting: Int) -> Flags:
    """Return for each line (T, 2) of (B, T, 2) whether it is free on its grid."""
    count = lines.shape[1]
    is_free = np.empty(len(lines), np.bool_)
    for b in range(len(lines)):
        # A line of one point is a segment without length.
        line = lines[b] if count > 1 else np.concatenate((lines[b], lines[b]))
        is_free[b] = are_free(grids[b], line, 0, len(line) - 1, squared_radius, corner_cutting)
    return is_free
