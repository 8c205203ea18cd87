"""The trapezoids that a path visits, and the shortest line through them.

The free space is cut into trapezoids by horizontal scan lines. A path visits a sequence of
trapezoids, and two consecutive ones share a piece of a scan line, a portal. The trapezoids are
convex, so the shortest line through all portals is the shortest line of the homotopy class. It is
found with the funnel algorithm of Lee and Preparata, 1984,
https://doi.org/10.1002/net.3230140304, and bends only at corners of obstacles.

Coordinates are those of `mapdata.search.free_lines`.
"""

from __future__ import annotations

from typing import NamedTuple

from mapdata.arrays import Bytes, Ints
from mapdata.jit import Int, inlined, kernel
from mapdata.search.free_lines import CELL, MIDDLE, is_occupied, rounded_up

BLOCKED = -1
"""What replaces a count where an octagon has no room on the path."""

_FAR = 2**40
"""Farther away than any obstacle."""


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


# --- the trapezoids ----------------------------------------------------------------------------


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
    last_row = rounded_up(lower + octagon.reach, CELL) - 1
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
            if is_occupied(grid, row, column):
                side_at_upper = side_of_cell - _half_width(row, upper, octagon)
                side_at_lower = side_of_cell - _half_width(row, lower, octagon)
                nearest_upper = min(nearest_upper, side_at_upper)
                nearest_lower = min(nearest_lower, side_at_lower)


@kernel
def octagon_fits(grid: Bytes, cell_row: Int, cell_column: Int, octagon: Octagon) -> Int:
    """Return whether an octagon about the middle of a cell enters no obstacle; it may touch some.

    ``grid`` is (H, W) uint8, 1 occupied.
    """
    y = cell_row * CELL + MIDDLE
    x = cell_column * CELL + MIDDLE
    # In farther rows and columns no obstacle is near enough.
    cells_around = rounded_up(octagon.reach - MIDDLE, CELL)
    for row in range(cell_row - cells_around, cell_row + cells_around + 1):
        half_width = _half_width(row, y, octagon)
        for column in range(cell_column - cells_around, cell_column + cells_around + 1):
            distance = max(column * CELL - x, x - (column + 1) * CELL, 0)
            if distance < half_width and is_occupied(grid, row, column):
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
        The new number of trapezoids, or BLOCKED where the octagon has no room at the crossing.
    """
    if count > 0:
        if sleeve.entrances[count - 1] == line:
            # The path leaves the trapezoid where it entered it, so this was a detour.
            count -= 1
        elif _row_of_line(line, octagon) % CELL != MIDDLE:
            # A path moves along the middles of cells only, so it came straight to this line.
            left, right = _side(sleeve, count - 1, line)
            if not left <= crossing <= right:
                return BLOCKED
    if not _measure(grid, strip, column, octagon, sleeve, count):
        return BLOCKED
    left, right = _side(sleeve, count, line)
    if not left <= crossing <= right:
        return BLOCKED
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
def follow_path(grid: Bytes, path: Ints, octagon: Octagon, sleeve: Sleeve) -> Int:
    """Write the trapezoids that a path of cells visits; return their number, or BLOCKED.

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
            return BLOCKED
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
            if count == BLOCKED:
                return BLOCKED
            line += down
    return count


# --- the funnel --------------------------------------------------------------------------------


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


_LEFT, _APEX, _RIGHT, POINTS = range(4)


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
    funnel.bounds[POINTS] = 1


@kernel
def _add_point(row: Int, column: Int, side: Int, funnel: Funnel) -> None:
    """Move one end of the funnel, the left one (side 1) or the right one (-1), to a point.

    The point (row, column) is one of the next portal.
    """
    points, parents, chain, bounds = funnel
    point = bounds[POINTS]
    points[point, 0] = row
    points[point, 1] = column
    bounds[POINTS] = point + 1
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
def pull_through(path: Ints, octagon: Octagon, sleeve: Sleeve, count: Int, funnel: Funnel) -> None:
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
