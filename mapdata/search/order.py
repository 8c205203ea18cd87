"""The order in which a search expands the cells of a map: to draw it, teach it and learn from it.

The searches behind `bfs` and `astar` are compiled and record nothing, so that they are fast. Here
they are written once more, in plain Python that a student can read and change. This takes 60 to
100 times as long: about 1 ms on a map of 64 x 64 cells. Tests compare the two.
"""

from __future__ import annotations

import heapq
import math
from collections import deque
from collections.abc import Callable, Iterator
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from mapdata.arrays import Bytes, Floats, Int32s, Ints, summary
from mapdata.checks import check_choice, check_number
from mapdata.movement import STEPS, Movement
from mapdata.search.api import SEARCHES, astar, bfs, check_path
from mapdata.search.arguments import as_grid, as_optional_terrain
from mapdata.search.lattice import DIAGONAL, UNIT, UNIT_BITS, heuristics
from mapdata.search.map_stack import MapStack

Heuristic: TypeAlias = "ArrayLike | Callable[[int, int], float]"
"""Estimated costs to the goal: an array (H, W), or a function of the row and column of a cell."""

_Cell: TypeAlias = tuple[int, int]

_Estimate: TypeAlias = Callable[[_Cell], "int | None"]
"""The estimated cost from a cell to the goal, doubled and in 1 / UNIT; None for "never expand"."""

_ROUNDED_BITS = UNIT_BITS + 1 - 24
"""How many bits f loses where h is a float: sums that differ by less than 2**-24 cells are equal.

Two paths below `MAX_PATH_COST` differ by more, unless they cost the same.
"""


class SearchOrder(NamedTuple):
    """What a search expanded, and the path that it found.

    Attributes:
        order: (H, W) int32, the number of the expansion of each cell, from 0 on; -1 for cells that
            were not expanded.
        path: (k, 2) int64, cells from start to goal, both included; (0, 2) when there is none.
        cost: cost of the path, in cells (BFS: in moves); -1.0 when there is none.
        iterations: number of expanded cells, which is ``order.max() + 1``.
    """

    order: Int32s
    path: Ints
    cost: float
    iterations: int

    def __repr__(self) -> str:
        return summary(self)


def search_order(
    grid: ArrayLike,
    start: tuple[int, int] | Ints,
    goal: tuple[int, int] | Ints,
    movement: Movement = Movement(),
    search: str = "astar",
    *,
    terrain: ArrayLike | None = None,
    heuristic: Heuristic | None = None,
    weight: float = 1,
) -> SearchOrder:
    """Search a path, and return the order in which the search expanded the cells of the map.

    Path, cost and iterations are those of `bfs` or `astar`, which are 60 to 100 times as fast.
    With a heuristic or weight of your own, A* expands the cell of the smallest ``g + weight * h``,
    of equal ones the most recently pushed one, and no cell twice. Then its path is a shortest one
    if ``weight * h`` is consistent, and may be longer if not.

    Args:
        grid: (H, W) of 0 free and 1 occupied, or bool.
        start: (row, col), a free cell.
        goal: (row, col), a free cell.
        movement: which moves are legal.
        search: "astar" or "bfs".
        terrain: (H, W) of integers, 0 on the occupied cells of ``grid`` and 1 to 255, the cost of a
            cell, on the others.
        heuristic: h, the estimated cost to the goal in cells: an array (H, W), or a function that
            takes the row and the column of a free cell. A cell whose h is infinite, or -1 as in
            `distance_field`, has no path to the goal and is not expanded. Default: the heuristic of
            `astar`.
        weight: of h, at least 0.

    Raises:
        ValueError: what `bfs` and `astar` refuse; a heuristic of another shape, or with NaN or
            another negative number than -1 on a free cell, or so large that ``weight * h`` is no
            float; a heuristic or weight for BFS.

    >>> found = search_order([[0, 1, 0], [0, 0, 0]], (0, 0), (0, 2))
    >>> found.order
    array([[ 0, -1,  4],
           [ 1,  2,  3]], dtype=int32)
    >>> found.path.tolist()
    [[0, 0], [1, 0], [1, 1], [1, 2], [0, 2]]

    Without a heuristic, A* is Dijkstra's algorithm:

    >>> search_order([[0, 0, 0]] * 3, (1, 0), (1, 2)).iterations
    3
    >>> search_order([[0, 0, 0]] * 3, (1, 0), (1, 2), heuristic=lambda row, col: 0).iterations
    5
    """
    check_choice("search", search, SEARCHES)
    weight = check_number("weight", weight)
    if not 0 <= weight < math.inf:
        raise ValueError(f"weight: got {weight}, expected a number of at least 0")
    is_plain = heuristic is None and weight == 1
    if search == "bfs" and not is_plain:
        raise ValueError("heuristic and weight: do nothing for BFS, expected search='astar'")
    # This checks the arguments, too.
    found = (bfs if search == "bfs" else astar)(grid, start, goal, movement, terrain=terrain)
    occupancy = as_grid(grid, 2)
    # On terrain of ones, A* expands the same cells in the same order as without terrain.
    cell_costs = MapStack(occupancy, as_optional_terrain(terrain, occupancy)).cell_costs
    ends = (int(start[0]), int(start[1])), (int(goal[0]), int(goal[1]))
    if search == "bfs":
        expanded = _expand_by_bfs(cell_costs, *ends, movement)
    elif is_plain:
        estimate = _estimate_of_astar(cell_costs, ends[1], movement)
        expanded, _ = _expand_by_astar(cell_costs, *ends, movement, estimate)
    else:
        h = _as_estimates(heuristic, cell_costs, ends[1], movement)
        estimate = _weighted_estimate(h, weight)
        expanded, path = _expand_by_astar(cell_costs, *ends, movement, estimate, _ROUNDED_BITS)
    order = np.full(occupancy.shape, -1, np.int32)
    rows, columns = np.array(expanded).T
    order[rows, columns] = np.arange(len(expanded))
    if is_plain:
        return SearchOrder(order, *found)
    cells = np.array(path, np.int64).reshape(-1, 2)
    cost = check_path(grid, cells, movement, terrain=terrain) if path else -1.0
    return SearchOrder(order, cells, cost, len(expanded))


def _with_wall(cell_costs: Bytes) -> list[list[int]]:
    """Return the costs as lists, with a row and a column of occupied cells behind the last ones.

    Since Python counts the index -1 from the end, this wall also stands before the first ones.
    """
    lists: list[list[int]] = np.pad(cell_costs, (0, 1)).tolist()
    return lists


def _neighbours(
    cell_costs: list[list[int]], cell: _Cell, movement: Movement
) -> Iterator[tuple[_Cell, int]]:
    """Yield the cells that a legal move leads to, and its doubled cost in 1 / UNIT.

    They come in the order N, E, S, W, NE, SE, SW, NW.
    """
    row, column = cell
    cell_cost = cell_costs[row][column]
    diagonal_unit = UNIT if movement.diagonal_cost == 1 else DIAGONAL
    for down, right in STEPS[: movement.connectivity].tolist():
        neighbour_cost = cell_costs[row + down][column + right]
        is_diagonal = bool(down and right)
        if is_diagonal and not movement.corner_cutting:
            is_legal = cell_costs[row + down][column] and cell_costs[row][column + right]
        else:
            is_legal = True
        if neighbour_cost and is_legal:
            unit = diagonal_unit if is_diagonal else UNIT
            yield (row + down, column + right), (cell_cost + neighbour_cost) * unit


def _expand_by_bfs(cell_costs: Bytes, start: _Cell, goal: _Cell, movement: Movement) -> list[_Cell]:
    """Return the cells that breadth-first search expands, in their order."""
    costs = _with_wall(cell_costs)
    frontier = deque([start])
    seen = {start}
    expanded: list[_Cell] = []
    while frontier:
        cell = frontier.popleft()
        expanded.append(cell)
        if cell == goal:
            break
        for neighbour, _ in _neighbours(costs, cell, movement):
            if neighbour not in seen:
                seen.add(neighbour)
                frontier.append(neighbour)
    return expanded


def _expand_by_astar(
    cell_costs: Bytes,
    start: _Cell,
    goal: _Cell,
    movement: Movement,
    estimate: _Estimate,
    rounded_bits: int = 0,
) -> tuple[list[_Cell], list[_Cell]]:
    """Return the cells that A* expands, in their order, and those of its path, if there is one.

    The costs g are whole numbers, and so exact. f = g + h is, too, but for ``rounded_bits``.
    """
    costs = _with_wall(cell_costs)
    half = (1 << rounded_bits) >> 1
    g = {start: 0}
    parents = {start: start}
    frontier = [(0, 0, start)]  # The start is alone, so its f does not matter.
    pushes = 0
    expanded: dict[_Cell, None] = {}  # in their order
    while frontier:
        _, _, cell = heapq.heappop(frontier)
        if cell in expanded:
            continue  # It was pushed again with a smaller f, and expanded then.
        expanded[cell] = None
        if cell == goal:
            break
        for neighbour, move_cost in _neighbours(costs, cell, movement):
            new_g = g[cell] + move_cost
            if neighbour in g and g[neighbour] <= new_g:
                continue
            h = estimate(neighbour)
            if h is None:
                continue
            g[neighbour] = new_g
            parents[neighbour] = cell
            if neighbour not in expanded:
                pushes += 1
                f = (new_g + h + half) >> rounded_bits
                # Among equal f the latest push is the smallest entry.
                heapq.heappush(frontier, (f, -pushes, neighbour))
    path = []
    if goal in expanded:
        path = [goal]
        while path[-1] != start:
            path.append(parents[path[-1]])
    return list(expanded), path[::-1]


def _estimate_of_astar(cell_costs: Bytes, goal: _Cell, movement: Movement) -> _Estimate:
    """Return the heuristic of `astar`: the cost where all cells cost as little as the cheapest."""
    doubled_min_cost = 2 * int(cell_costs[cell_costs > 0].min())
    diagonal_unit = UNIT if movement.diagonal_cost == 1 else DIAGONAL

    def estimate(cell: _Cell) -> int:
        rows = abs(cell[0] - goal[0])
        columns = abs(cell[1] - goal[1])
        if movement.connectivity == 4:
            return (rows + columns) * UNIT * doubled_min_cost
        straight = abs(rows - columns) * UNIT
        diagonal = min(rows, columns) * diagonal_unit
        return (straight + diagonal) * doubled_min_cost

    return estimate


def _weighted_estimate(h: Floats, weight: float) -> _Estimate:
    """Return the estimate ``weight * h``, for h (H, W) in cells; infinite ones are left out.

    Raises:
        ValueError: a finite h is so large that the estimate is no float.
    """
    doubled = np.full(h.shape, np.inf)
    has_path = np.isfinite(h)
    with np.errstate(over="ignore", invalid="ignore"):
        doubled[has_path] = 2 * weight * h[has_path] * UNIT
    is_too_large = has_path & ~np.isfinite(doubled)
    if is_too_large.any():
        cell = tuple(np.argwhere(is_too_large)[0].tolist())
        raise ValueError(
            f"heuristic: got {h[cell]} at {cell} and the weight {weight}, expected a smaller cost, "
            "or infinite or -1 where no path leads to the goal"
        )
    lists = doubled.tolist()

    def estimate(cell: _Cell) -> int | None:
        row, column = cell
        units = lists[row][column]
        return None if units == math.inf else int(units)

    return estimate


def _as_estimates(
    heuristic: Heuristic | None, cell_costs: Bytes, goal: _Cell, movement: Movement
) -> Floats:
    """Return h as (H, W) float64 in cells, infinite where no path leads to the goal."""
    free_cells = np.argwhere(cell_costs > 0)
    rows, columns = free_cells.T
    estimates = np.full(cell_costs.shape, np.inf)
    if heuristic is None:
        min_cost = int(cell_costs[rows, columns].min())
        estimates[rows, columns] = heuristics(free_cells, goal, movement, min_cost)
    elif callable(heuristic):
        values = _as_floats([heuristic(row, column) for row, column in free_cells.tolist()])
        if values.shape != rows.shape:
            raise ValueError(
                f"heuristic: the function returned shape {values.shape[1:]}, expected a number"
            )
        estimates[rows, columns] = values
    else:
        array = _as_floats(heuristic)
        if array.shape != cell_costs.shape:
            raise ValueError(
                f"heuristic: got shape {array.shape}, expected {cell_costs.shape}, that of the "
                "grid, or a function of row and column"
            )
        estimates[rows, columns] = array[rows, columns]
    estimates[estimates == -1] = np.inf
    is_refused = ~(estimates >= 0)  # NaN, too
    if is_refused.any():
        cell = tuple(np.argwhere(is_refused)[0].tolist())
        raise ValueError(
            f"heuristic: got {estimates[cell]} at {cell}, expected a cost of at least 0 on each "
            "free cell, infinite or -1 where no path leads to the goal"
        )
    return estimates


def _as_floats(values: ArrayLike) -> Floats:
    """Return the numbers of a heuristic as float64.

    Raises:
        ValueError: they are no numbers.
    """
    try:
        return np.asarray(values, np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"heuristic: {error}; expected numbers (H, W), or a function that returns one"
        ) from None
