"""The labels of `mapdata` as one writes them in an afternoon: numpy slices, a deque for BFS, a heap
for A*.

The yardstick of benchmarks/labels.py. It gives the same paths, iterations and matrices as
`mapdata.label`, cell by
cell, and is neither tuned nor slowed down: the route is searched segment by segment, the BFS matrix
takes one search from each seed, the A* matrix one for each pair of seeds. `careful_label` gives
the same with the care of who knows what Python is slow at.
"""

from __future__ import annotations

import heapq
from collections import deque
from itertools import combinations, pairwise
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    import mapdata
    from mapdata import Maps

Cell: TypeAlias = tuple[int, int]
Grid: TypeAlias = npt.NDArray[np.uint8]
Matrix: TypeAlias = npt.NDArray[np.float64]

NEIGHBOURS = ((-1, 0), (0, 1), (1, 0), (0, -1))


class Drawing(NamedTuple):
    """What was drawn to make one map: Algorithm 1 before anything is carved.

    ``seed_points`` and ``sizes`` are (row, col) and (rows, columns) a room; ``horizontal_first`` is
    a passage's fair coin, or None where no passage is.
    """

    map_size: tuple[int, int]
    seed_points: list[Cell]
    sizes: list[tuple[int, int]]
    width: int
    horizontal_first: list[bool | None]


class Found(NamedTuple):
    """A path (empty when there is none) and how many cells were taken from the frontier."""

    path: list[Cell]
    iterations: int


class Labels(NamedTuple):
    """Routes, segment by segment, and connection matrices of one map."""

    bfs_route: list[Found]
    bfs_matrix: Matrix
    astar_route: list[Found]
    astar_matrix: Matrix


def carve(drawing: Drawing) -> Grid:
    """Return the grid of a drawing: 1 occupied, 0 free."""
    grid = np.ones(drawing.map_size, np.uint8)
    width, half = drawing.width, drawing.width // 2
    for (row, column), (rows, columns) in zip(drawing.seed_points, drawing.sizes, strict=True):
        top, left = row - rows // 2, column - columns // 2
        grid[max(top, 0) : top + rows, max(left, 0) : left + columns] = 0
    for (a, b), horizontal_first in zip(
        pairwise(drawing.seed_points), drawing.horizontal_first, strict=True
    ):
        if horizontal_first is None:
            continue
        row, column = (a[0], b[1]) if horizontal_first else (b[0], a[1])
        top, left = row - half, column - half
        grid[max(top, 0) : top + width, min(a[1], b[1]) : max(a[1], b[1]) + 1] = 0
        grid[min(a[0], b[0]) : max(a[0], b[0]) + 1, max(left, 0) : left + width] = 0
        grid[max(top, 0) : top + width, max(left, 0) : left + width] = 0
    return grid


def label(grid: Grid, seed_points: list[Cell]) -> Labels:
    """Return all labels of one map."""
    return Labels(
        bfs_route=bfs_route(grid, seed_points),
        bfs_matrix=bfs_matrix(grid, seed_points),
        astar_route=astar_route(grid, seed_points),
        astar_matrix=astar_matrix(grid, seed_points),
    )


def bfs_route(grid: Grid, seed_points: list[Cell]) -> list[Found]:
    """Search the segments between consecutive seeds."""
    return [bfs(grid, start, goal) for start, goal in pairwise(seed_points)]


def astar_route(grid: Grid, seed_points: list[Cell]) -> list[Found]:
    """Search the segments between consecutive seeds."""
    return [astar(grid, start, goal) for start, goal in pairwise(seed_points)]


def bfs_matrix(grid: Grid, seed_points: list[Cell]) -> Matrix:
    """Return the path cost between all seeds, -1 without a path: one search from each seed."""
    rows = [distances(grid, seed) for seed in seed_points]
    return np.array([[row.get(seed, -1) for seed in seed_points] for row in rows], np.float64)


def astar_matrix(grid: Grid, seed_points: list[Cell]) -> Matrix:
    """Return the path cost between all seeds, -1 without a path: one search for each pair."""
    matrix = np.zeros((len(seed_points), len(seed_points)))
    for i, j in combinations(range(len(seed_points)), 2):
        matrix[i, j] = matrix[j, i] = len(astar(grid, seed_points[i], seed_points[j]).path) - 1
    return matrix


def bfs(grid: Grid, start: Cell, goal: Cell) -> Found:
    """Breadth-first search: first in, first out, neighbours N, E, S, W."""
    rows, columns = grid.shape
    parents = {start: start}
    frontier = deque([start])
    iterations = 0
    while frontier:
        cell = frontier.popleft()
        iterations += 1
        if cell == goal:
            return Found(trace(parents, goal), iterations)
        for down, right in NEIGHBOURS:
            row, column = cell[0] + down, cell[1] + right
            if (
                0 <= row < rows
                and 0 <= column < columns
                and grid[row, column] == 0
                and (row, column) not in parents
            ):
                parents[row, column] = cell
                frontier.append((row, column))
    return Found([], iterations)


def distances(grid: Grid, start: Cell) -> dict[Cell, int]:
    """Return the number of moves to every cell that can be reached."""
    rows, columns = grid.shape
    moves = {start: 0}
    frontier = deque([start])
    while frontier:
        cell = frontier.popleft()
        for down, right in NEIGHBOURS:
            row, column = cell[0] + down, cell[1] + right
            if (
                0 <= row < rows
                and 0 <= column < columns
                and grid[row, column] == 0
                and (row, column) not in moves
            ):
                moves[row, column] = moves[cell] + 1
                frontier.append((row, column))
    return moves


def astar(grid: Grid, start: Cell, goal: Cell) -> Found:
    """A* with the Manhattan heuristic: pops the least f, among equal f the latest push."""
    rows, columns = grid.shape
    cost = {start: 0}
    parents = {start: start}
    closed: set[Cell] = set()
    frontier = [(0, 0, start)]
    pushes = 0
    while frontier:
        cell = heapq.heappop(frontier)[2]
        if cell in closed:
            continue
        closed.add(cell)
        if cell == goal:
            return Found(trace(parents, goal), len(closed))
        for down, right in NEIGHBOURS:
            row, column = cell[0] + down, cell[1] + right
            if not (0 <= row < rows and 0 <= column < columns and grid[row, column] == 0):
                continue
            new_cost = cost[cell] + 1
            if (row, column) not in cost or new_cost < cost[row, column]:
                cost[row, column] = new_cost
                parents[row, column] = cell
                pushes += 1
                estimate = new_cost + abs(row - goal[0]) + abs(column - goal[1])
                heapq.heappush(frontier, (estimate, -pushes, (row, column)))
    return Found([], len(closed))


def trace(parents: dict[Cell, Cell], goal: Cell) -> list[Cell]:
    """Follow the parents from the goal back to the start, which is its own parent."""
    path = [goal]
    while parents[path[-1]] != path[-1]:
        path.append(parents[path[-1]])
    return path[::-1]


# --- the same with care -------------------------------------------------------------------------


def careful_label(grid: Grid, seed_points: list[Cell]) -> Labels:
    """Return what `label` does, as who knows Python's costs writes it.

    Cells are numbers in a flat list with a wall around it, so that no step makes a tuple, indexes a
    numpy array or checks a bound; one search from each seed gives its row of the matrix, its
    segment and the iterations; the matrix of A* is that of BFS, since both are optimal.
    """
    stride = grid.shape[1] + 2
    walls = np.pad(grid, 1, constant_values=1).reshape(-1).tolist()
    cells = [(row + 1) * stride + column + 1 for row, column in seed_points]
    n = len(cells)
    matrix = np.zeros((n, n))
    bfs_segments = []
    for i in range(n - 1):
        order, parents, moves = careful_bfs(walls, stride, cells[i])
        for j in range(i + 1, n):
            matrix[i, j] = matrix[j, i] = moves[cells[j]]
        goal = cells[i + 1]
        found = moves[goal] >= 0
        path = careful_trace(parents, goal, stride) if found else []
        bfs_segments.append(Found(path, order.index(goal) + 1 if found else len(order)))
    astar_segments = [careful_astar(walls, stride, *ends) for ends in pairwise(cells)]
    return Labels(bfs_segments, matrix, astar_segments, matrix.copy())


def careful_bfs(
    walls: list[int], stride: int, start: int
) -> tuple[list[int], list[int], list[int]]:
    """Return the cells in the order of their expansion, and every cell's parent and moves."""
    moves = [-1] * len(walls)
    parents = [0] * len(walls)
    moves[start] = 0
    parents[start] = start
    order = [start]
    for cell in order:
        further = moves[cell] + 1
        for to in (cell - stride, cell + 1, cell + stride, cell - 1):
            if moves[to] < 0 and not walls[to]:
                moves[to] = further
                parents[to] = cell
                order.append(to)
    return order, parents, moves


def careful_astar(walls: list[int], stride: int, start: int, goal: int) -> Found:
    """A* as `astar`, on a flat list."""
    cost = [-1] * len(walls)
    parents = [0] * len(walls)
    closed = bytearray(len(walls))
    cost[start] = 0
    parents[start] = start
    goal_row, goal_column = divmod(goal, stride)
    frontier = [(0, 0, start)]
    pushes = 0
    iterations = 0
    while frontier:
        cell = heapq.heappop(frontier)[2]
        if closed[cell]:
            continue
        closed[cell] = 1
        iterations += 1
        if cell == goal:
            return Found(careful_trace(parents, goal, stride), iterations)
        new_cost = cost[cell] + 1
        for to in (cell - stride, cell + 1, cell + stride, cell - 1):
            if not walls[to] and (cost[to] < 0 or new_cost < cost[to]):
                cost[to] = new_cost
                parents[to] = cell
                pushes -= 1
                row, column = divmod(to, stride)
                estimate = new_cost + abs(row - goal_row) + abs(column - goal_column)
                heapq.heappush(frontier, (estimate, pushes, to))
    return Found([], iterations)


def careful_trace(parents: list[int], goal: int, stride: int) -> list[Cell]:
    """Return the cells (row, col) from the start, which is its own parent, to the goal."""
    path = [goal]
    while parents[path[-1]] != path[-1]:
        path.append(parents[path[-1]])
    return [(cell // stride - 1, cell % stride - 1) for cell in reversed(path)]


# --- beside mapdata -----------------------------------------------------------------------------


def drawing_of(maps: Maps, i: int) -> Drawing:
    """Return what `mapdata.generate` drew for map ``i`` of a batch, so that both sides work on the
    same map.
    """
    n = int(maps.rooms[i])
    coins = maps.directions[i, : n - 1, 0].tolist()
    return Drawing(
        map_size=(maps.packed.shape[1], maps.columns),
        seed_points=seed_points_of(maps, i),
        sizes=[(rows, columns) for rows, columns in maps.sizes[i, :n].tolist()],
        width=int(maps.passage_width[i]),
        horizontal_first=[None if coin < 0 else coin == 1 for coin in coins],
    )


def seed_points_of(maps: Maps, i: int) -> list[Cell]:
    """Return the seed points of map ``i`` of a batch."""
    return [(row, column) for row, column in maps.seed_points[i, : maps.rooms[i]].tolist()]


def differences(labels: mapdata.Labels, i: int) -> list[str]:
    """Return the names of what `mapdata` and this file find differently on map ``i`` of a batch:
    none, if all is well.
    """
    grid = carve(drawing_of(labels.maps, i))
    mine = label(grid, seed_points_of(labels.maps, i))
    found = [] if np.array_equal(grid, labels.maps.occupancy[i]) else ["occupancy"]
    for search, route, matrix in (
        ("bfs", mine.bfs_route, mine.bfs_matrix),
        ("astar", mine.astar_route, mine.astar_matrix),
    ):
        paths = [
            [(row, column) for row, column in path.tolist()] for path in labels.route(search, i)
        ]
        if [segment.path for segment in route] != paths:
            found.append(f"{search} route")
        if [segment.iterations for segment in route] != labels.iterations(search, i).tolist():
            found.append(f"{search} iterations")
        if not np.array_equal(matrix, labels.matrix(search, i)):
            found.append(f"{search} matrix")
    return found
