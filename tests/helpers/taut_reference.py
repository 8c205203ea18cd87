"""Slow, obviously right geometry: which lines are free, and how short the shortest one is.

A grid is an array of 0 free and 1 occupied; a point is ``(row, col)`` in cells, of whole numbers or
fractions, and the map covers 0 to H and 0 to W.

`mapdata` is used in one place: `lines_are_free` tests the many segments of a visibility graph. It
is itself compared with `is_free_segment` and `squared_distance`.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from mapdata import lines_are_free

Point: TypeAlias = "tuple[Fraction, Fraction]"
Grid: TypeAlias = "npt.NDArray[np.uint8]"


def in_fractions(line: npt.NDArray[np.float64]) -> list[Point]:
    """Return the points of a line as exact fractions."""
    return [(Fraction(row), Fraction(column)) for row, column in line.tolist()]


def is_occupied(grid: Grid, row: int, column: int) -> bool:
    """Return whether a cell is occupied or outside the map."""
    rows, columns = grid.shape
    return not (0 <= row < rows and 0 <= column < columns) or bool(grid[row, column])


def _numbers_around(coordinate: Fraction) -> list[int]:
    """Return the numbers of the rows, or columns, of cells that contain a coordinate."""
    number = math.floor(coordinate)
    return [number - 1, number] if coordinate == number else [number]


def is_free_point(grid: Grid, point: Point, corner_cutting: bool) -> bool:
    """Return whether a point is outside the union of all occupied cells, or on its boundary.

    It is on the boundary if not all of the cells that contain it are occupied. Without
    ``corner_cutting`` it must not be where exactly two occupied cells meet diagonally.
    """
    rows = _numbers_around(point[0])
    columns = _numbers_around(point[1])
    occupied = [[is_occupied(grid, row, column) for column in columns] for row in rows]
    if all(all(cells) for cells in occupied):
        return False
    is_pinched = occupied in ([[True, False], [False, True]], [[False, True], [True, False]])
    return corner_cutting or not is_pinched


def _crossings(start: Fraction, end: Fraction) -> Iterator[Fraction]:
    """Yield where, from 0 to 1, a coordinate that goes from start to end is a whole number."""
    for number in range(math.ceil(min(start, end)), math.floor(max(start, end)) + 1):
        if start != end:
            yield (number - start) / (end - start)


def is_free_segment(grid: Grid, start: Point, end: Point, corner_cutting: bool) -> bool:
    """Return whether all points of a segment are free.

    Between two crossings of sides of cells all points are in the same cells, so one of them stands
    for all.
    """
    shares = {Fraction(0), Fraction(1)}
    for axis in range(2):
        shares.update(_crossings(Fraction(start[axis]), Fraction(end[axis])))
    ordered = sorted(shares)
    ordered += [(before + after) / 2 for before, after in pairwise(ordered)]
    for share in ordered:
        row = start[0] + share * (end[0] - start[0])
        column = start[1] + share * (end[1] - start[1])
        if not is_free_point(grid, (row, column), corner_cutting):
            return False
    return True


def _squared_distance_to_cell(point: Point, row: int, column: int) -> Fraction:
    """Return the squared distance of a point from a cell."""
    down = max(row - point[0], point[0] - (row + 1), Fraction(0))
    across = max(column - point[1], point[1] - (column + 1), Fraction(0))
    return down * down + across * across


def squared_distance(grid: Grid, start: Point, end: Point) -> Fraction:
    """Return the smallest squared distance of a segment from the occupied cells and the outside.

    The distance to a cell is a convex function along the segment. It is smallest at an end, where
    the segment crosses the extension of a side, or at the foot of a corner. The outside is the ring
    of cells around the map.
    """
    rows, columns = grid.shape
    rise, run = end[0] - start[0], end[1] - start[1]
    squared_length = rise * rise + run * run
    smallest = Fraction(10**9)
    for row in range(-1, rows + 1):
        for column in range(-1, columns + 1):
            if not is_occupied(grid, row, column):
                continue
            shares = {Fraction(0), Fraction(1)}
            for side in (row, row + 1):
                shares.update({Fraction(side - start[0]) / rise} if rise else ())
            for side in (column, column + 1):
                shares.update({Fraction(side - start[1]) / run} if run else ())
            for corner_row in (row, row + 1):
                for corner_column in (column, column + 1):
                    along = (corner_row - start[0]) * rise + (corner_column - start[1]) * run
                    shares.update({Fraction(along) / squared_length} if squared_length else ())
            for share in shares:
                if 0 <= share <= 1:
                    point = (start[0] + share * rise, start[1] + share * run)
                    smallest = min(smallest, _squared_distance_to_cell(point, row, column))
    return smallest


def obstacle_corners(grid: Grid) -> list[tuple[int, int]]:
    """Return the corners of obstacles around which a line can bend: exactly one cell is occupied,
    or two that touch diagonally.
    """
    rows, columns = grid.shape
    corners = []
    for row in range(rows + 1):
        for column in range(columns + 1):
            north_west = is_occupied(grid, row - 1, column - 1)
            north_east = is_occupied(grid, row - 1, column)
            south_west = is_occupied(grid, row, column - 1)
            south_east = is_occupied(grid, row, column)
            count = north_west + north_east + south_west + south_east
            if count == 1 or (count == 2 and north_west == south_east):
                corners.append((row, column))
    return corners


def shortest_length(grid: Grid, start: Any, goal: Any, corner_cutting: bool) -> float:
    """Return the length of the shortest free line between two points, by a visibility graph.

    It is infinite if there is none.
    """
    points = [start, goal, *obstacle_corners(grid)]
    distances = [math.inf] * len(points)
    distances[0] = 0.0
    done: set[int] = set()
    queue = [(0.0, 0)]
    while queue:
        distance, number = heapq.heappop(queue)
        if number == 1:
            return distance
        if number in done:
            continue
        done.add(number)
        for other, point in enumerate(points):
            if other in done:
                continue
            longer = distance + math.dist(points[number], point)
            if longer < distances[other] and is_free_segment(
                grid, points[number], point, corner_cutting
            ):
                distances[other] = longer
                heapq.heappush(queue, (longer, other))
    return math.inf


def shortest_line_of_disc(grid: Grid, start: Any, goal: Any, radius: float) -> Any:
    """Return a line (n, 2) between the middles of two cells that is nearly the shortest of a disc.

    The line may bend at the corners of a polygon with 32 edges around each corner of an obstacle.
    It adds less than .4 % to the length of an arc. Where the disc fits exactly, the line may also
    bend at the corners of an octagon that touches the disc on the axes.

    Args:
        grid: (H, W) of 0 free and 1 occupied.
        start: cell (row, col).
        goal: cell (row, col), to which the disc can move.
        radius: of the disc, in cells, a multiple of 1/256.
    """
    angles = (np.arange(32) + 0.5) * math.pi / 16
    # Two units of the 1/256 cell to which `lines_are_free` rounds points keep its edges free.
    distance = (radius + 2 / 256) / math.cos(math.pi / 32)
    polygon = distance * np.stack((np.sin(angles), np.cos(angles)), axis=1)
    side = math.ceil(256 * radius * math.tan(math.pi / 8)) / 256
    quarter = np.array([[radius, side], [side, radius]])
    octagon = np.concatenate([quarter * signs for signs in ([1, 1], [1, -1], [-1, 1], [-1, -1])])
    arc = np.concatenate((polygon, octagon))
    ends = np.array([start, goal]) + 0.5
    corners = np.array(obstacle_corners(grid), float).reshape(-1, 2)
    bends = (corners[:, None] + arc).reshape(-1, 2)
    is_free = lines_are_free(
        np.broadcast_to(grid, (len(bends), *grid.shape)), bends[:, None], radius
    )
    points = np.concatenate((ends, bends[is_free]))
    first, second = np.triu_indices(len(points), 1)
    pairs = np.stack((points[first], points[second]), axis=1)
    is_free = lines_are_free(np.broadcast_to(grid, (len(pairs), *grid.shape)), pairs, radius)
    lengths = np.linalg.norm(pairs[:, 0] - pairs[:, 1], axis=1)
    graph = coo_array(
        (lengths[is_free], (first[is_free], second[is_free])), (len(points), len(points))
    )
    _, before = dijkstra(graph, directed=False, indices=0, return_predecessors=True)
    chain = [1]
    while chain[-1] != 0:
        chain.append(before[chain[-1]])
    return points[chain[::-1]]


def winding_number(loop: Sequence[Any], point: Any) -> int:
    """Return how often a closed line of points goes around a point that is not on it."""
    winding = 0
    for before, after in pairwise([*loop, loop[0]]):
        # Whether the point is left or right of the line from ``before`` to ``after``.
        turn = (after[0] - before[0]) * (point[1] - before[1]) - (after[1] - before[1]) * (
            point[0] - before[0]
        )
        if before[0] <= point[0] < after[0] and turn > 0:
            winding += 1
        if after[0] <= point[0] < before[0] and turn < 0:
            winding -= 1
    return winding
