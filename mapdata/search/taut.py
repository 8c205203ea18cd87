"""The taut line of a path: the shortest line of its homotopy class, and points along it.

The line is pulled through the trapezoids that the path visits (`mapdata.search.sleeve`). Then exact
tests prove that it is free (`mapdata.search.free_lines`, which also explains the coordinates: whole
numbers of 1/256 cell).

For a robot every occupied cell is enlarged by an octagon around the robot's disc. The octagon has
two sides along each axis and four diagonal ones, so the corners of enlarged cells are whole
numbers, too. A bend of such a line that the disc does not need is removed afterwards.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mapdata.arrays import Bytes, Float32s, Floats, Ints
from mapdata.checks import check_count
from mapdata.jit import Int, inlined, kernel
from mapdata.movement import Movement
from mapdata.search.api import check_path
from mapdata.search.arguments import as_grid
from mapdata.search.footprint import without_clearance
from mapdata.search.free_lines import (
    CELL,
    MIDDLE,
    are_free,
    check_size,
    has_room,
    is_free_segment,
    is_occupied,
    squared_radius_of,
)
from mapdata.search.sleeve import (
    BLOCKED,
    POINTS,
    Funnel,
    Octagon,
    Sleeve,
    follow_path,
    octagon_fits,
    pull_through,
)

_STEPS_PER_SEGMENT = 128
"""Exact points divide a segment in multiples of 1/128 of its length.

All corners and middles of cells are multiples of 128, so these points lie on the segment.
"""

NO_PATH = -1
"""The status of a problem without a path."""

NOT_FREE = -2
"""The status of a problem for which no line was proved free."""

_ATTEMPTS = 3
"""A line is pulled for the roomy octagon, then for the snug one, and at last not at all."""


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

    Arguments and errors are those of `squared_radius_of`.
    """
    squared = squared_radius_of(radius, resolution)
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
    check_size(cells)
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
    check_size(cells)
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
    """Write the line of one attempt; return its number of points, or BLOCKED.

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
    if not octagon_fits(grid, path[0, 0], path[0, 1], octagon):
        return BLOCKED
    if not octagon_fits(grid, path[last, 0], path[last, 1], octagon):
        return BLOCKED
    trapezoids = follow_path(grid, path, octagon, work.sleeve)
    if trapezoids == BLOCKED:
        return BLOCKED
    funnel = work.funnel
    pull_through(path, octagon, work.sleeve, trapezoids, funnel)
    # The parents lead from the goal to the start, so the chain is turned around first.
    order = funnel.chain
    point = funnel.bounds[POINTS] - 1
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
            if not is_occupied(grid, row, column):
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
        return are_free(grid, points, 0, points_per_line - 1, squared_radius, corner_cutting)
    _divide(work.line, count - 1, points_per_line - count, work.spacings, work.parts)
    first = 0
    for segment in range(count - 1):
        parts = work.parts[segment]
        is_free = False
        # Where a segment touches obstacles between its ends, rounded points may be inside them.
        for is_exact in range(2):
            if not is_free:
                _write_parts(work.line, segment, parts, is_exact, points, first)
                is_free = are_free(grid, points, first, parts, squared_radius, corner_cutting)
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
        if count == BLOCKED:
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
