"""The taut line of a path: the shortest line of its homotopy class, and points along it.

All coordinates in this module are whole numbers of 1/256 cell, (row, col) from the upper left
corner of the map, so every test is exact. The middle of cell (0, 0) is (128, 128).

A line is free if it does not enter the inside of the union of the occupied cells and the outside of
the map. It may touch that union, but it cannot pass between two cells that share a side. It may
touch a point where two occupied cells meet diagonally only where corners may be cut. For a robot
with a radius a line is free if each of its points is at least that far from every occupied cell and
from the border.

The free space is cut into trapezoids by horizontal scan lines. A path visits a sequence of
trapezoids, and two consecutive ones share a piece of a scan line, a portal. The trapezoids are
convex, so the shortest line through all portals is the shortest line of the homotopy class. It is
found with the funnel algorithm of Lee and Preparata, 1984,
https://doi.org/10.1002/net.3230140304, and bends only at corners of obstacles.

For a robot every occupied cell is enlarged by an octagon around the robot's disc. The octagon has
two sides along each axis and four diagonal ones, so the corners of enlarged cells are whole
numbers, too. A bend of such a line that the disc does not need is removed afterwards.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mapdata.arrays import Bytes, Flags, Float32s, Floats, Ints
from mapdata.checks import check_count, check_number
from mapdata.jit import Int, inlined, kernel
from mapdata.movement import Movement
from mapdata.search.api import check_path
from mapdata.search.arguments import as_grid, values_complaint
from mapdata.search.footprint import without_clearance

CELL = 256
"""The side of a cell."""

MIDDLE = CELL // 2
"""The middle of a cell, from its upper or left side."""

MAX_TAUT_SIDE = 2**16
"""Largest number of rows or columns: up to here cross products fit int64, and float32 is exact."""

_STEPS_PER_SEGMENT = 128
"""Exact points divide a segment in multiples of 1/128 of its length.

All corners and middles of cells are multiples of 128, so these points lie on the segment.
"""

NO_PATH = -1
"""The status of a problem without a path."""

NOT_FREE = -2
"""The status of a problem for which no line was proved free."""

_BLOCKED = -1
"""What replaces a count where an octagon has no room on the path."""

_FAR = 2**40
"""Farther away than any obstacle."""

_ATTEMPTS = 3
"""A line is pulled for the roomy octagon, then for the snug one, and at last not at all."""


class Octagon(NamedTuple):
    """An octagon around the disc of a robot, symmetric about both axes and both diagonals.

    Attributes:
        reach: half of its width and of its height.
        side: half of the length of its four sides along the axes; at most ``reach``.
        scan_lines: (L,) int64, ascending: rows within a cell on which corners of enlarged cells
            lie.
    """

    reach: Int
    side: Int
    scan_lines: Ints


class Robot(NamedTuple):
    """A disc as kernels take it.

    Attributes:
        squared_radius: squared distance that it needs from each obstacle.
        roomy: an octagon that is larger than the disc by 1 everywhere. A point of a line for it may
            be rounded.
        snug: an octagon that touches the disc on the axes. It passes corridors that are as wide as
            the disc.
    """

    squared_radius: Int
    roomy: Octagon
    snug: Octagon


def robot_of(radius: float, resolution: float = 1.0) -> Robot:
    """Return a disc as kernels take it.

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
    squared = math.ceil((CELL * cells) ** 2 * (1 - 3e-7))
    exact_reach = _root_rounded_up(squared)
    margin = 1 if squared else 0
    # The distance of a diagonal side from the middle is (reach + side) / sqrt(2).
    diagonal_sum = _root_rounded_up(2 * (exact_reach + margin) ** 2)
    octagons = []
    for reach in (exact_reach + margin, exact_reach):
        side = min(diagonal_sum - reach, reach)
        rows = {distance % CELL for distance in (reach, -reach, side, -side)}
        octagons.append(Octagon(reach, side, np.array(sorted(rows), np.int64)))
    return Robot(squared, *octagons)


def _root_rounded_up(square: int) -> int:
    """Return the smallest whole number whose square is at least ``square``."""
    root = math.isqrt(square)
    return root if root * root == square else root + 1


def pull_taut(grid: ArrayLike, path: ArrayLike, radius_cells: float = 0) -> Floats:
    """Return the shortest line of a path's homotopy class: the path as a string, pulled taut.

    The line passes all obstacles on the sides on which the path passes them. It bends only at
    corners of obstacles, and it is proved free by exact tests. It may run along walls. It passes
    between two diagonally touching occupied cells only where the path does.

    With a radius, the middle of a disc moves on the line, and stays at least that far away from
    every obstacle and from the border. Around a corner the line follows an octagon instead of an
    arc, which adds at most 5.5 % to the length of the arc. Where the octagon, unlike the disc, has
    no room, the line follows the cells of the path. In both cases it has no bend that the disc can
    pass straight without changing the side on which it passes an obstacle. A path and its reverse
    have the same line.

    Args:
        grid: (H, W) of 0 free and 1 occupied, or bool; at most 65,536 rows and columns.
        path: (k, 2) cells (row, col) of an 8- or 4-connected path, k at least 1.
        radius_cells: radius of the robot, in cells. Above 0 the path must be one for
            `mapdata.inflate` of the grid that cuts no corners.

    Returns:
        (n, 2) float64 points (row, col) in cells, multiples of 1/256: start, bends and goal. The
        middle of cell (r, c) is (r + 0.5, c + 0.5). A path of one cell has one point.

    Raises:
        ValueError: what `mapdata.check_path` refuses; a grid that is too large.

    Source: Lee and Preparata, "Euclidean shortest paths in the presence of rectilinear barriers",
    1984, https://doi.org/10.1002/net.3230140304.

    >>> pull_taut([[0, 0, 0], [0, 1, 1], [0, 0, 0]], [(0, 2), (0, 1), (0, 0), (1, 0), (2, 1)])
    array([[0.5, 2.5],
           [1. , 1. ],
           [2. , 1. ],
           [2.5, 1.5]])
    """
    cells = as_grid(grid, 2)
    _check_size(cells)
    robot = robot_of(radius_cells)
    free_for_robot = without_clearance(cells, radius_cells) if radius_cells else cells
    check_path(free_for_robot, path, Movement(8, corner_cutting=not radius_cells))
    own_path = np.array(np.asarray(path), np.int64)  # contiguous and writable, for the kernel
    line, is_free = (_line_of_robot if radius_cells else _taut_line)(cells, own_path, robot)
    if not is_free:
        raise RuntimeError(
            f"no free line along the path for a radius of {radius_cells} cells: please report this"
        )
    return line / CELL


def _line_of_robot(grid: Bytes, path: Ints, robot: Robot) -> tuple[Ints, int]:
    """Return the points (n, 2) of a robot's taut line, and whether they were proved free.

    A path and its reverse have the same line. `_taut_line` alone depends on the direction, because
    `_drop_bends` removes bends from the start on.
    """
    start, goal = path[0].tolist(), path[-1].tolist()
    is_backwards = start > goal or (start == goal and path.tolist() > path[::-1].tolist())
    if is_backwards:
        path = np.ascontiguousarray(path[::-1])
    line, is_free = _taut_line(grid, path, robot)
    # Without room for an octagon the line bends where the path does, at middles of cells. Then the
    # two directions may differ by several percent.
    has_bends = len(line) > 2
    if has_bends and all(row % CELL == column % CELL == MIDDLE for row, column in line.tolist()):
        other, other_is_free = _taut_line(grid, np.ascontiguousarray(path[::-1]), robot)
        if other_is_free and _length(other) < _length(line):
            line = other[::-1]
    return (line[::-1] if is_backwards else line), is_free


def _length(line: Ints) -> float:
    """Return the length of a line (n, 2), in the unit of its points."""
    return float(np.hypot(*np.diff(line, axis=0).T).sum())


def _check_size(grid: Bytes) -> None:
    """Raise ValueError for a grid (..., H, W) on which cross products would not fit int64."""
    rows, columns = grid.shape[-2:]
    if max(rows, columns) > MAX_TAUT_SIDE:
        raise ValueError(
            f"grid: got {rows} x {columns} cells, expected at most {MAX_TAUT_SIDE:,} rows and "
            "columns"
        )


def lines_are_free(
    grids: ArrayLike, lines: ArrayLike, radius_cells: float = 0, *, corner_cutting: bool = False
) -> Flags:
    """Return whether lines of points collide with no obstacle, for instance those of a model.

    A line is free as in `pull_taut`: no point of its segments is inside the union of the occupied
    cells and the outside of the map, or nearer to it than ``radius_cells``.

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
    _check_size(cells)
    # A point outside the map stays outside where it is moved closer to it. So a point that is not
    # finite, such as those of a network that diverged, may stand outside, too.
    inside_or_near = np.clip(np.nan_to_num(points, nan=-1.0), -1, MAX_TAUT_SIDE + 1)
    rounded = np.rint(inside_or_near * CELL).astype(np.int64)
    return _lines_are_free(cells, rounded, robot_of(radius_cells).squared_radius, corner_cutting)


def path_waypoints(
    grid: ArrayLike, path: ArrayLike, count: int = 32, *, corner_cutting: bool = False
) -> Float32s:
    """Return points along the taut line of a path, as the field ``waypoints`` has them.

    All bends of the line are among the points, and the largest gap is as small as possible. All
    segments between the points are proved free.

    Args:
        grid: (H, W) of 0 free and 1 occupied, or bool; at most 65,536 rows and columns.
        path: (k, 2) cells (row, col) of an 8- or 4-connected path, k at least 1.
        count: T, the number of points, start and goal included; at least 2.
        corner_cutting: whether diagonal moves of the path may pass beside occupied cells.

    Returns:
        (T, 2) float32 points (row, col) in cells. The middle of cell (r, c) is (r + 0.5, c + 0.5).

    Raises:
        ValueError: what `mapdata.check_path` refuses; a grid that is too large; a line with more
            than T - 2 bends.

    >>> grid = [[0, 0, 0], [0, 1, 1], [0, 0, 0]]
    >>> path_waypoints(grid, [(0, 1), (0, 0), (1, 0), (2, 0), (2, 1)], count=4)
    array([[0.5, 1.5],
           [1. , 1. ],
           [2. , 1. ],
           [2.5, 1.5]], dtype=float32)
    """
    cells = as_grid(grid, 2)
    _check_size(cells)
    points_per_line = check_count("count", count, minimum=2)
    check_path(cells, path, Movement(8, corner_cutting=corner_cutting))
    own_path = np.array(np.asarray(path), np.int64)  # contiguous and writable, for the kernel
    points = np.empty((1, points_per_line, 2), np.float32)
    offsets = np.array([0, len(own_path)], np.int64)
    (bends,) = write_waypoints(
        cells[None], own_path, offsets, robot_of(0), corner_cutting, points
    ).tolist()
    if bends == NOT_FREE:
        raise RuntimeError("no free line along the path: please report this")
    if bends > points_per_line - 2:
        raise ValueError(
            f"count: got {count} points for a line of {bends} bends, expected at least {bends + 2}"
        )
    line: Float32s = points[0]
    return line


def to_metres(
    *,
    points: ArrayLike | None = None,
    cells: ArrayLike | None = None,
    rows: int,
    resolution: float,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Floats:
    """Return points or the middles of cells of a map, (row, col), as (x, y) in metres.

    Both are counted in cells from the upper left corner of the map, but a point is continuous: the
    middle of cell (r, c) is the point (r + 0.5, c + 0.5). So exactly one of both is given, by name.

    Args:
        points: (..., 2), such as taut lines, waypoints and samples of roadmaps.
        cells: (..., 2) integers, such as paths, starts and goals.
        rows: number of rows of the map.
        resolution: metres per cell.
        origin: (x, y, yaw) of the lower left corner of the map, in metres and radians, as in the
            .yaml file of a ROS map.

    Returns:
        (..., 2) float64. For yaw 0, x grows with the column, and y from the last row to the first.

    Raises:
        ValueError: points and cells, or neither; another shape of them; cells that are not
            integers, or padding of -1; an origin without yaw.

    >>> to_metres(points=[[2, 0], [0.5, 0.5]], rows=2, resolution=0.1)
    array([[0.  , 0.  ],
           [0.05, 0.15]])
    >>> to_metres(cells=[0, 0], rows=2, resolution=0.1)
    array([0.05, 0.15])
    """
    if (points is None) == (cells is None):
        raise ValueError(
            f"points and cells: got {'neither' if points is None else 'both'}, expected one: "
            "cells=[(r, c)] is the middle of a cell, points=[(r + 0.5, c + 0.5)]"
        )
    if points is not None:
        name, from_corner = "points", np.asarray(points, np.float64)
    else:
        if np.asarray(cells).dtype.kind not in "iu":
            raise ValueError(
                f"cells: got numbers of {np.asarray(cells).dtype}, expected integers; points= "
                "takes others"
            )
        if (np.asarray(cells) == -1).any():
            raise ValueError(
                "cells: got -1, the padding of paths in batches, expected cells: "
                "path[path[:, 0] >= 0] leaves it out"
            )
        name, from_corner = "cells", np.asarray(cells) + 0.5
    if from_corner.shape[-1:] != (2,):
        raise ValueError(
            f"{name}: got shape {from_corner.shape}, expected (..., 2): row and column"
        )
    if np.shape(origin) != (3,):
        raise ValueError(
            f"origin: got {origin!r}, expected (x, y, yaw) of the lower left corner of the map"
        )
    right = from_corner[..., 1] * resolution
    up = (rows - from_corner[..., 0]) * resolution
    x, y, yaw = origin
    # The map is rotated about its lower left corner by yaw.
    east = right * math.cos(yaw) - up * math.sin(yaw)
    north = right * math.sin(yaw) + up * math.cos(yaw)
    return np.stack((x + east, y + north), axis=-1)


# --- kernels: is a segment free? ----------------------------------------------------------------


@inlined
def _is_occupied(grid: Bytes, row: Int, column: Int) -> Int:
    """Return whether a cell is occupied or outside the map."""
    rows, columns = grid.shape
    is_outside = row < 0 or row >= rows or column < 0 or column >= columns
    return is_outside or grid[row, column] != 0


@inlined
def _rounded_up(dividend: Int, divisor: Int) -> Int:
    """Return the quotient, rounded up; the divisor is above 0."""
    return -((-dividend) // divisor)


@kernel
def _is_pinched(grid: Bytes, row: Int, column: Int) -> Int:
    """Return whether exactly two cells at a corner of cells are occupied, and they face each other.

    The corner is the upper left one of cell (row, column).
    """
    north_west = _is_occupied(grid, row - 1, column - 1)
    north_east = _is_occupied(grid, row - 1, column)
    south_west = _is_occupied(grid, row, column - 1)
    south_east = _is_occupied(grid, row, column)
    return north_west == south_east and north_east == south_west and north_west != north_east


@kernel
def _is_free_point(grid: Bytes, row: Int, column: Int, corner_cutting: Int) -> Int:
    """Return whether a point, as a segment without length, is free for a point robot."""
    lower = row // CELL
    upper = lower - 1 if row % CELL == 0 else lower
    right = column // CELL
    left = right - 1 if column % CELL == 0 else right
    if (
        _is_occupied(grid, upper, left)
        and _is_occupied(grid, upper, right)
        and _is_occupied(grid, lower, left)
        and _is_occupied(grid, lower, right)
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
    for column in range(left // CELL, _rounded_up(right, CELL)):
        if _is_occupied(grid, upper, column) and _is_occupied(grid, lower, column):
            return False
    if is_between_rows and not corner_cutting:
        for column in range(_rounded_up(left, CELL), right // CELL + 1):
            if _is_pinched(grid, lower, column):
                return False
    return True


@kernel
def _is_free_between_columns(
    grid: Bytes, top: Int, bottom: Int, column: Int, corner_cutting: Int
) -> Int:
    """Return whether a vertical segment on the left side of cells of ``column`` is free."""
    for row in range(top // CELL, _rounded_up(bottom, CELL)):
        if _is_occupied(grid, row, column - 1) and _is_occupied(grid, row, column):
            return False
    if not corner_cutting:
        for row in range(_rounded_up(top, CELL), bottom // CELL + 1):
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
    for row in range(top // CELL, _rounded_up(bottom, CELL)):
        upper = max(top, row * CELL)
        lower = min(bottom, (row + 1) * CELL)
        end = start + (lower - upper) * run
        first = min(start, end) // scaled_cell
        last = _rounded_up(max(start, end), scaled_cell) - 1
        for column in range(first, last + 1):
            if _is_occupied(grid, row, column):
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


# --- kernels: the trapezoids that a path visits --------------------------------------------------


class Sleeve(NamedTuple):
    """The trapezoids that a path visits, in order, without detours into dead ends.

    Strip k is the part of the map between scan lines k and k + 1, and a trapezoid is a part of a
    strip between two obstacles.

    Attributes:
        strips: (n,) strip of each trapezoid.
        entrances: (n,) scan line through which the path enters it; _NO_LINE if it starts there.
        upper: (n, 2) columns of the left and right end of its upper side.
        lower: (n, 2) columns of the left and right end of its lower side.
    """

    strips: Ints
    entrances: Ints
    upper: Ints
    lower: Ints


_NO_LINE = -_FAR
"""The entrance of the trapezoid in which a path starts."""


@inlined
def _row_of_line(line: Int, octagon: Octagon) -> Int:
    """Return the row of a scan line."""
    lines_per_cell = len(octagon.scan_lines)
    return line // lines_per_cell * CELL + octagon.scan_lines[line % lines_per_cell]


@inlined
def _half_width(row: Int, y: Int, octagon: Octagon) -> Int:
    """Return how far a cell of ``row``, enlarged by the octagon, extends beyond its sides at ``y``.

    At most `Octagon.reach` lies between ``y`` and the cell.
    """
    distance = max(row * CELL - y, y - (row + 1) * CELL, 0)
    return min(octagon.reach, octagon.reach + octagon.side - distance)


@kernel
def _nearest_obstacles(
    grid: Bytes, upper: Int, lower: Int, column: Int, step: Int, octagon: Octagon
) -> tuple[Int, Int]:
    """Return where the free part of a strip ends on its upper and on its lower side.

    Args:
        grid: (H, W) uint8, 1 occupied.
        upper: row of the scan line above the strip.
        lower: row of the scan line below it.
        column: a column of cells in which the strip is free.
        step: in which direction to search: -1 left, 1 right.
        octagon: around the robot.
    """
    first_row = (upper - octagon.reach) // CELL
    last_row = _rounded_up(lower + octagon.reach, CELL) - 1
    # Distances count from column 0 in the direction of the search, which may make them negative.
    nearest_upper = _FAR
    nearest_lower = _FAR
    while True:
        column += step
        side_of_cell = column * CELL if step > 0 else -(column + 1) * CELL
        # From here on, no obstacle extends beyond the nearest ones. The outside of the map is an
        # obstacle, so the search ends there.
        if side_of_cell - octagon.reach >= max(nearest_upper, nearest_lower):
            return step * nearest_upper, step * nearest_lower
        for row in range(first_row, last_row + 1):
            if _is_occupied(grid, row, column):
                side_at_upper = side_of_cell - _half_width(row, upper, octagon)
                side_at_lower = side_of_cell - _half_width(row, lower, octagon)
                nearest_upper = min(nearest_upper, side_at_upper)
                nearest_lower = min(nearest_lower, side_at_lower)


@kernel
def _fits(grid: Bytes, cell_row: Int, cell_column: Int, octagon: Octagon) -> Int:
    """Return whether an octagon about the middle of a cell enters no obstacle; it may touch some.

    ``grid`` is (H, W) uint8, 1 occupied.
    """
    y = cell_row * CELL + MIDDLE
    x = cell_column * CELL + MIDDLE
    # In farther rows and columns no obstacle is near enough.
    cells_around = _rounded_up(octagon.reach - MIDDLE, CELL)
    for row in range(cell_row - cells_around, cell_row + cells_around + 1):
        half_width = _half_width(row, y, octagon)
        for column in range(cell_column - cells_around, cell_column + cells_around + 1):
            distance = max(column * CELL - x, x - (column + 1) * CELL, 0)
            if distance < half_width and _is_occupied(grid, row, column):
                return False
    return True


@kernel
def _measure(grid: Bytes, strip: Int, column: Int, octagon: Octagon, sleeve: Sleeve, k: Int) -> Int:
    """Write the trapezoid of a strip at a column of cells into row k of the sleeve.

    Return whether it is one: it has no negative width.
    """
    upper = _row_of_line(strip, octagon)
    lower = _row_of_line(strip + 1, octagon)
    upper_left, lower_left = _nearest_obstacles(grid, upper, lower, column, -1, octagon)
    upper_right, lower_right = _nearest_obstacles(grid, upper, lower, column, 1, octagon)
    sleeve.strips[k] = strip
    sleeve.upper[k, 0] = upper_left
    sleeve.upper[k, 1] = upper_right
    sleeve.lower[k, 0] = lower_left
    sleeve.lower[k, 1] = lower_right
    return upper_left <= upper_right and lower_left <= lower_right


@inlined
def _side(sleeve: Sleeve, k: Int, line: Int) -> tuple[Int, Int]:
    """Return the left and right end of the side of trapezoid k that lies on a scan line."""
    if sleeve.strips[k] == line:
        return sleeve.upper[k, 0], sleeve.upper[k, 1]
    return sleeve.lower[k, 0], sleeve.lower[k, 1]


@kernel
def _cross_line(
    grid: Bytes,
    line: Int,
    strip: Int,
    crossing: Int,
    column: Int,
    octagon: Octagon,
    sleeve: Sleeve,
    count: Int,
) -> Int:
    """Extend the sleeve of a path that leaves a scan line for a strip.

    Args:
        grid: (H, W) uint8, 1 occupied.
        line: the scan line.
        strip: above or below the line.
        crossing: where the path leaves the line, in 1/256 cell.
        column: the column of cells of the path in the strip.
        octagon: around the robot.
        sleeve: to extend.
        count: number of its trapezoids.

    Returns:
        The new number of trapezoids, or _BLOCKED where the octagon has no room at the crossing.
    """
    if count > 0:
        if sleeve.entrances[count - 1] == line:
            # The path leaves the trapezoid where it entered it, so this was a detour.
            count -= 1
        elif _row_of_line(line, octagon) % CELL != MIDDLE:
            # A path moves along the middles of cells only, so it came straight to this line.
            left, right = _side(sleeve, count - 1, line)
            if not left <= crossing <= right:
                return _BLOCKED
    if not _measure(grid, strip, column, octagon, sleeve, count):
        return _BLOCKED
    left, right = _side(sleeve, count, line)
    if not left <= crossing <= right:
        return _BLOCKED
    is_back = (
        count > 0
        and sleeve.strips[count - 1] == strip
        and sleeve.upper[count - 1, 0] == sleeve.upper[count, 0]
    )
    if is_back:
        return count  # in the trapezoid from which the detour began
    sleeve.entrances[count] = line
    return count + 1


@kernel
def _follow(grid: Bytes, path: Ints, octagon: Octagon, sleeve: Sleeve) -> Int:
    """Write the trapezoids that a path of cells visits; return their number, or _BLOCKED.

    There is none where the path lies on one scan line.
    """
    lines_per_cell = len(octagon.scan_lines)
    lines_above_middle = 0
    lines_to_middle = 0
    for line in octagon.scan_lines:
        lines_above_middle += line < MIDDLE
        lines_to_middle += line <= MIDDLE
    count = 0
    if lines_above_middle == lines_to_middle:
        strip = path[0, 0] * lines_per_cell + lines_above_middle - 1
        if not _measure(grid, strip, path[0, 1], octagon, sleeve, 0):
            return _BLOCKED
        sleeve.entrances[0] = _NO_LINE
        count = 1
    for k in range(1, len(path)):
        row = path[k - 1, 0]
        down = path[k, 0] - row
        if down == 0:
            continue
        # The lines from the middle of a cell, included, to the middle of the next one, excluded.
        line = row * lines_per_cell + (lines_above_middle if down > 0 else lines_to_middle - 1)
        for _ in range(lines_per_cell):
            distance = abs(_row_of_line(line, octagon) - (row * CELL + MIDDLE))
            crossing = path[k - 1, 1] * CELL + MIDDLE + (path[k, 1] - path[k - 1, 1]) * distance
            column = path[k - 1, 1] if distance < MIDDLE else path[k, 1]
            strip = line if down > 0 else line - 1
            count = _cross_line(grid, line, strip, crossing, column, octagon, sleeve, count)
            if count == _BLOCKED:
                return _BLOCKED
            line += down
    return count


# --- kernels: the funnel -------------------------------------------------------------------------


class Funnel(NamedTuple):
    """The shortest lines from the start to both ends of a portal.

    They share the first part, up to the apex, and bend away from each other after it.

    Attributes:
        points: (P, 2) the start and the ends of all portals so far.
        parents: (P,) for each point the one before it on the shortest line from the start.
        chain: (2 P + 1,) numbers of points: from the left end of the portal back to the apex and
            from there to the right end.
        bounds: (4,) where the left end, the apex and the right end are in ``chain``, and the number
            of points.
    """

    points: Ints
    parents: Ints
    chain: Ints
    bounds: Ints


_LEFT, _APEX, _RIGHT, _POINTS = range(4)


@inlined
def _turn(points: Ints, first: Int, second: Int, third: Int) -> Int:
    """Return on which side of the line from the first to the second point the third one is.

    It is above 0 on the left, below 0 on the right, and 0 on the line.
    """
    row = points[first, 0]
    column = points[first, 1]
    return (points[second, 0] - row) * (points[third, 1] - column) - (
        points[second, 1] - column
    ) * (points[third, 0] - row)


@inlined
def _is_same(points: Ints, first: Int, second: Int) -> Int:
    """Return whether two points are at the same position."""
    return points[first, 0] == points[second, 0] and points[first, 1] == points[second, 1]


@inlined
def _is_behind(points: Ints, apex: Int, corner: Int, point: Int, side: Int) -> Int:
    """Return whether a straight line from the apex to a point of a later portal misses the funnel.

    Args:
        points: (P, 2) positions.
        apex: number of the apex.
        corner: number of the point next to it, on the other side of the funnel than ``point``.
        point: number of the point.
        side: of the funnel to which the point is added: 1 left, -1 right.
    """
    turn = side * _turn(points, apex, corner, point)
    rise = points[corner, 0] - points[apex, 0]
    run = points[corner, 1] - points[apex, 1]
    rise_beyond = points[point, 0] - points[corner, 0]
    run_beyond = points[point, 1] - points[corner, 1]
    is_beyond = rise * rise_beyond + run * run_beyond >= 0
    return turn < 0 or (turn == 0 and is_beyond)


@kernel
def _begin(row: Int, column: Int, funnel: Funnel) -> None:
    """Make the funnel that consists of the start."""
    middle = len(funnel.chain) // 2
    funnel.points[0, 0] = row
    funnel.points[0, 1] = column
    funnel.parents[0] = -1
    funnel.chain[middle] = 0
    funnel.bounds[_LEFT] = middle
    funnel.bounds[_APEX] = middle
    funnel.bounds[_RIGHT] = middle
    funnel.bounds[_POINTS] = 1


@kernel
def _add_point(row: Int, column: Int, side: Int, funnel: Funnel) -> None:
    """Move one end of the funnel, the left one (side 1) or the right one (-1), to a point.

    The point (row, column) is one of the next portal.
    """
    points, parents, chain, bounds = funnel
    point = bounds[_POINTS]
    points[point, 0] = row
    points[point, 1] = column
    bounds[_POINTS] = point + 1
    end = bounds[_LEFT] if side > 0 else bounds[_RIGHT]
    opposite_end = bounds[_RIGHT] if side > 0 else bounds[_LEFT]
    apex = bounds[_APEX]
    # Towards the apex and beyond it, positions in the chain change by ``side``.
    while end != apex and side * _turn(points, chain[end + side], chain[end], point) <= 0:
        end += side
    if end == apex and not _is_same(points, chain[apex], point):
        # Where the point is behind the opposite side of the funnel, the line bends around it.
        while apex != opposite_end and _is_behind(
            points, chain[apex], chain[apex + side], point, side
        ):
            apex += side
        end = apex
    parents[point] = chain[end]
    end -= side
    chain[end] = point
    bounds[_APEX] = apex
    if side > 0:
        bounds[_LEFT] = end
    else:
        bounds[_RIGHT] = end


@kernel
def _add_portal(row: Int, first: Int, last: Int, is_downwards: Int, funnel: Funnel) -> None:
    """Move the funnel to a portal: columns ``first`` to ``last`` of a scan line at ``row``."""
    # Who moves down, with columns growing to the east, has the east on the left.
    _add_point(row, last if is_downwards else first, 1, funnel)
    _add_point(row, first if is_downwards else last, -1, funnel)


@kernel
def _pull_through(path: Ints, octagon: Octagon, sleeve: Sleeve, count: Int, funnel: Funnel) -> None:
    """Write the shortest line through the sleeve of a path: from the last point back by parents."""
    last = len(path) - 1
    _begin(path[0, 0] * CELL + MIDDLE, path[0, 1] * CELL + MIDDLE, funnel)
    for k in range(count):
        line = sleeve.entrances[k]
        if line == _NO_LINE:
            continue
        row = _row_of_line(line, octagon)
        enters_downwards = sleeve.strips[k] == line
        left, right = _side(sleeve, k, line)
        if k > 0:
            leaves_downwards = sleeve.strips[k - 1] == line - 1
            left_before, right_before = _side(sleeve, k - 1, line)
            shared_left = max(left, left_before)
            shared_right = min(right, right_before)
            if enters_downwards == leaves_downwards and shared_left <= shared_right:
                left = shared_left
                right = shared_right
            else:
                # The line goes along the scan line from one trapezoid to the other.
                _add_portal(row, left_before, right_before, leaves_downwards, funnel)
        _add_portal(row, left, right, enters_downwards, funnel)
    goal_row = path[last, 0] * CELL + MIDDLE
    if count > 0:
        # A goal on a scan line may lie beside the last trapezoid.
        strip = sleeve.strips[count - 1]
        for line in (strip, strip + 1):
            if _row_of_line(line, octagon) == goal_row and sleeve.entrances[count - 1] != line:
                left, right = _side(sleeve, count - 1, line)
                _add_portal(goal_row, left, right, line > strip, funnel)
    _add_point(goal_row, path[last, 1] * CELL + MIDDLE, 1, funnel)


# --- kernels: the line and its points -------------------------------------------------------------


class Workspace(NamedTuple):
    """The memory that is used for one path after another.

    Attributes:
        sleeve: the trapezoids.
        funnel: the funnel in them.
        line: (P, 2) the start, the bends and the goal.
        spacings: (P,) float64, the distance between the points of each segment.
        parts: (P,) in how many parts the points divide each segment.
        points: (T, 2) the points that are served.
    """

    sleeve: Sleeve
    funnel: Funnel
    line: Ints
    spacings: Floats
    parts: Ints
    points: Ints


@kernel
def _workspace(longest_path: Int, points_per_line: Int, robot: Robot) -> Workspace:
    """Return memory for paths of up to ``longest_path`` cells."""
    lines_per_cell = max(len(robot.roomy.scan_lines), len(robot.snug.scan_lines))
    trapezoids = longest_path * lines_per_cell + 1
    points = 4 * trapezoids + 6
    return Workspace(
        Sleeve(
            np.empty(trapezoids, np.int64),
            np.empty(trapezoids, np.int64),
            np.empty((trapezoids, 2), np.int64),
            np.empty((trapezoids, 2), np.int64),
        ),
        Funnel(
            np.empty((points, 2), np.int64),
            np.empty(points, np.int64),
            np.empty(2 * points + 1, np.int64),
            np.empty(4, np.int64),
        ),
        np.empty((points, 2), np.int64),
        np.empty(points),
        np.empty(points, np.int64),
        np.empty((max(points_per_line, points), 2), np.int64),
    )


@inlined
def _append_to_line(row: Int, column: Int, line: Ints, count: Int) -> Int:
    """Append a point to a line that so far has ``count`` points; return their new number.

    The last point is replaced where the line does not bend there.
    """
    while count > 0:
        before = max(count - 2, 0)
        rise = line[count - 1, 0] - line[before, 0]
        run = line[count - 1, 1] - line[before, 1]
        next_rise = row - line[count - 1, 0]
        next_run = column - line[count - 1, 1]
        is_point_again = next_rise == 0 and next_run == 0
        is_straight = count > 1 and rise * next_run == run * next_rise
        if not (is_point_again or is_straight):
            break
        count -= 1
    line[count, 0] = row
    line[count, 1] = column
    return count + 1


@kernel
def _write_line(grid: Bytes, path: Ints, attempt: Int, robot: Robot, work: Workspace) -> Int:
    """Write the line of one attempt; return its number of points, or _BLOCKED.

    The last attempt is the path itself, without the cells at which it goes straight on.
    """
    line = work.line
    count = 0
    if attempt == _ATTEMPTS - 1:
        for k in range(len(path)):
            row = path[k, 0] * CELL + MIDDLE
            count = _append_to_line(row, path[k, 1] * CELL + MIDDLE, line, count)
        return count
    octagon = robot.roomy if attempt == 0 else robot.snug
    # The octagon may have no room at the start or the goal, although the disc has: no line of the
    # octagon's free space ends there. From such a start the sleeve leads back into that space,
    # which can be a detour.
    last = len(path) - 1
    if not _fits(grid, path[0, 0], path[0, 1], octagon):
        return _BLOCKED
    if not _fits(grid, path[last, 0], path[last, 1], octagon):
        return _BLOCKED
    trapezoids = _follow(grid, path, octagon, work.sleeve)
    if trapezoids == _BLOCKED:
        return _BLOCKED
    funnel = work.funnel
    _pull_through(path, octagon, work.sleeve, trapezoids, funnel)
    # The parents lead from the goal to the start, so the chain is turned around first.
    order = funnel.chain
    point = funnel.bounds[_POINTS] - 1
    position = len(order)
    while point >= 0:
        position -= 1
        order[position] = point
        point = funnel.parents[point]
    for k in range(position, len(order)):
        row = funnel.points[order[k], 0]
        count = _append_to_line(row, funnel.points[order[k], 1], line, count)
    return count


@kernel
def _divide(line: Ints, segments: Int, extra_points: Int, spacings: Floats, parts: Ints) -> None:
    """Divide the segments of a line into parts, so that the longest part is as short as possible.

    Args:
        line: the ends of the segments, in the first ``segments + 1`` rows.
        segments: number of them, at least 1.
        extra_points: how many points to add to those of the line.
        spacings: filled with the length of the parts of each segment.
        parts: filled with the number of parts of each segment.
    """
    for k in range(segments):
        rise = line[k + 1, 0] - line[k, 0]
        run = line[k + 1, 1] - line[k, 1]
        spacings[k] = math.sqrt(rise * rise + run * run)
        parts[k] = 1
    for _ in range(extra_points):
        widest = 0
        for k in range(1, segments):
            if spacings[k] > spacings[widest]:
                widest = k
        spacings[widest] *= parts[widest] / (parts[widest] + 1)
        parts[widest] += 1


@inlined
def _rounded_share(difference: Int, part: Int, parts: Int) -> Int:
    """Return ``part / parts`` of a difference; halves are rounded away from 0."""
    rounded = (2 * part * abs(difference) + parts) // (2 * parts)
    return rounded if difference > 0 else -rounded


@kernel
def _write_parts(
    line: Ints, segment: Int, parts: Int, is_exact: Int, points: Ints, first: Int
) -> None:
    """Write the points between the parts of a segment, and its two ends, from row ``first`` on.

    Each point is rounded by up to half a unit. The exact points of a line for a point robot, which
    lie on the segment, are those at multiples of 1/128 of its length.
    """
    for part in range(parts + 1):
        share = part
        shares = parts
        if is_exact:
            share = _rounded_share(_STEPS_PER_SEGMENT, part, parts)
            shares = _STEPS_PER_SEGMENT
        for axis in range(2):
            start = line[segment, axis]
            step = _rounded_share(line[segment + 1, axis] - start, share, shares)
            points[first + part, axis] = start + step


@kernel
def _are_free(
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
        is_free[b] = _are_free(grids[b], line, 0, len(line) - 1, squared_radius, corner_cutting)
    return is_free


@kernel
def _encloses_obstacle(grid: Bytes, line: Ints, first: Int, second: Int, third: Int) -> Int:
    """Return whether an occupied cell lies inside a triangle whose three sides are free.

    Args:
        grid: (H, W) uint8, 1 occupied.
        line: (P, 2) points in 1/256 cell.
        first: number of the first corner of the triangle in ``line``.
        second: number of the second corner.
        third: number of the third corner.
    """
    row0 = line[first, 0]
    row1 = line[second, 0]
    row2 = line[third, 0]
    column0 = line[first, 1]
    column1 = line[second, 1]
    column2 = line[third, 1]
    top = min(row0, row1, row2) // CELL
    bottom = max(row0, row1, row2) // CELL
    left = min(column0, column1, column2) // CELL
    right = max(column0, column1, column2) // CELL
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            if not _is_occupied(grid, row, column):
                continue
            # No side crosses the cell, so its middle stands for all of it.
            y = row * CELL + MIDDLE
            x = column * CELL + MIDDLE
            side0 = (row1 - row0) * (x - column0) - (column1 - column0) * (y - row0)
            side1 = (row2 - row1) * (x - column1) - (column2 - column1) * (y - row1)
            side2 = (row0 - row2) * (x - column2) - (column0 - column2) * (y - row2)
            if (side0 > 0 and side1 > 0 and side2 > 0) or (side0 < 0 and side1 < 0 and side2 < 0):
                return True
    return False


@kernel
def _drop_bends(
    grid: Bytes, line: Ints, count: Int, squared_radius: Int, corner_cutting: Int
) -> Int:
    """Remove the bends of a robot's line that the disc does not need; return the number of points.

    The octagon is larger than the disc, and the line along a path without room for an octagon bends
    where the path does. A bend goes if the straight line between its two neighbours is free, and if
    no obstacle lies between that line and the bend. So the line stays in its homotopy class.

    Args:
        grid: (H, W) uint8, 1 occupied.
        line: (P, 2) the start, the bends and the goal in 1/256 cell, changed in place.
        count: number of these points.
        squared_radius: squared distance that the straight line needs from each obstacle.
        corner_cutting: whether a line may touch a point where two occupied cells meet diagonally.
    """
    kept = 0
    for k in range(count):
        row = line[k, 0]
        column = line[k, 1]
        line[kept, 0] = row
        line[kept, 1] = column
        while kept >= 2:
            row0 = line[kept - 2, 0]
            column0 = line[kept - 2, 1]
            if (
                not is_free_segment(grid, row0, column0, row, column, corner_cutting)
                or not has_room(grid, row0, column0, row, column, squared_radius)
                or _encloses_obstacle(grid, line, kept - 2, kept - 1, kept)
            ):
                break
            kept -= 1
            line[kept, 0] = row
            line[kept, 1] = column
        kept += 1
    return kept


@kernel
def _write_free_points(
    grid: Bytes,
    count: Int,
    points_per_line: Int,
    squared_radius: Int,
    corner_cutting: Int,
    work: Workspace,
) -> Int:
    """Write points along a line, all of its own among them; return whether they are proved free.

    Args:
        grid: (H, W) uint8, 1 occupied.
        count: number of points of ``work.line``.
        points_per_line: how many points to write, at least ``count``.
        squared_radius: of the robot.
        corner_cutting: whether a line may pass between two cells that touch diagonally.
        work: the line, and the place of the points.
    """
    points = work.points
    if count == 1:
        for k in range(points_per_line):
            points[k, 0] = work.line[0, 0]
            points[k, 1] = work.line[0, 1]
        return _are_free(grid, points, 0, points_per_line - 1, squared_radius, corner_cutting)
    _divide(work.line, count - 1, points_per_line - count, work.spacings, work.parts)
    first = 0
    for segment in range(count - 1):
        parts = work.parts[segment]
        is_free = False
        # Where a segment touches obstacles between its ends, rounded points may be inside them.
        for is_exact in range(2):
            if not is_free:
                _write_parts(work.line, segment, parts, is_exact, points, first)
                is_free = _are_free(grid, points, first, parts, squared_radius, corner_cutting)
        if not is_free:
            return False
        first += parts
    return True


@kernel
def _write_points(
    grid: Bytes,
    path: Ints,
    robot: Robot,
    corner_cutting: Int,
    points_per_line: Int,
    work: Workspace,
) -> Int:
    """Write points along the best line that is free to ``work.points``.

    Args:
        grid: (H, W) uint8, 1 occupied.
        path: (k, 2) cells, at least one.
        robot: that moves.
        corner_cutting: whether a line may pass between two cells that touch diagonally.
        points_per_line: how many points to write; 0 for as many as the line has.
        work: memory, and the place of the points.

    Returns:
        The number of points of the line itself, start, bends and goal, or NOT_FREE. Where these
        are more than ``points_per_line``, no points are written.
    """
    for attempt in range(_ATTEMPTS):
        count = _write_line(grid, path, attempt, robot, work)
        if count == _BLOCKED:
            continue
        if robot.squared_radius:
            # Points between the ends of a segment are rounded, which takes less than the margin of
            # the roomy octagon. A line without such points needs no margin.
            squared_room = robot.roomy.reach**2 if points_per_line else robot.squared_radius
            count = _drop_bends(grid, work.line, count, squared_room, corner_cutting)
        if points_per_line and count > points_per_line:
            return count
        if _write_free_points(
            grid,
            count,
            max(points_per_line, count),
            robot.squared_radius,
            corner_cutting,
            work,
        ):
            return count
    return NOT_FREE


@kernel
def _taut_line(grid: Bytes, path: Ints, robot: Robot) -> tuple[Ints, Int]:
    """Return the points (n, 2) of the taut line of a path, and whether they were proved free."""
    work = _workspace(len(path), 0, robot)
    count = _write_points(grid, path, robot, True, 0, work)
    return work.points[: max(count, 0)], count != NOT_FREE


@kernel
def write_waypoints(
    grids: Bytes,
    cells: Ints,
    offsets: Ints,
    robot: Robot,
    corner_cutting: Int,
    waypoints: Float32s,
) -> Ints:
    """Write points along the taut line of each path, and prove that they are free.

    Args:
        grids: (B, H, W) uint8, 1 occupied, not inflated.
        cells: (M, 2) all paths, one after another.
        offsets: (B + 1,) where each path begins; an empty one stands for no path.
        robot: that moves.
        corner_cutting: whether a line may pass between two cells that touch diagonally.
        waypoints: (B, T, 2) float32, filled with points (row, col) in cells, T at least 2. All are
            -1 where no line is served.

    Returns:
        (B,) int64: number of bends of each line, NO_PATH or NOT_FREE. More than T - 2 bends do not
        fit, and no line is served.
    """
    points_per_line = waypoints.shape[1]
    longest_path = 0
    for b in range(len(grids)):
        longest_path = max(longest_path, offsets[b + 1] - offsets[b])
    work = _workspace(longest_path, points_per_line, robot)
    statuses = np.full(len(grids), NO_PATH)
    for b in range(len(grids)):
        path = cells[offsets[b] : offsets[b + 1]]
        if len(path):
            count = _write_points(grids[b], path, robot, corner_cutting, points_per_line, work)
            statuses[b] = NOT_FREE if count == NOT_FREE else max(count - 2, 0)
        is_served = 0 <= statuses[b] <= points_per_line - 2
        for k in range(points_per_line):
            for axis in range(2):
                waypoints[b, k, axis] = work.points[k, axis] / CELL if is_served else -1
    return statuses
