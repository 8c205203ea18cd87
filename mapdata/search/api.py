"""Shortest paths on grids: BFS, A*, distance fields and the path check.

`mapdata.search.arguments` checks the arguments and turns them into the form of the kernels. The
kernels of `mapdata.search.solving` do the work, in the exact order that the format fixes
(docs/format.md).
"""

from __future__ import annotations

from operator import index
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mapdata.arrays import Bytes, Float32s, Floats, Ints, summary
from mapdata.checks import check_choice
from mapdata.movement import Movement, check_movement
from mapdata.search.arguments import (
    as_cell,
    as_cells,
    as_grid,
    as_optional_terrain,
    as_problems,
    nearest_free_cell,
    problem_complaint,
    values_complaint,
    why_not_free,
)
from mapdata.search.bit_jumps import empty_bit_map, jump_memory, jump_to_goals
from mapdata.search.ground import as_ground, high_cost_complaint
from mapdata.search.kept_memory import kept_memory, kept_search_memory
from mapdata.search.kernels import first_bad_cell
from mapdata.search.landmarks import solve_with_landmarks
from mapdata.search.lattice import ASTAR, BFS, CostWeights, diagonal_moves, move_rule
from mapdata.search.map_stack import MapStack
from mapdata.search.solving import Solved, follow_goal_fields, solve_problem, write_field
from mapdata.search.terrain import terrain_path_cost

SEARCHES = {"bfs": BFS, "astar": ASTAR}
"""The searches of labels and datasets, by name. Names of stored arrays and columns begin so."""


class SearchResult(NamedTuple):
    """The path that a search found, and its cost.

    Attributes:
        path: (k, 2) int64, cells from start to goal, both included; (0, 2) when there is none.
        cost: cost of the path, in cells (BFS: in moves); -1.0 when there is none.
        iterations: number of expanded cells, those that the search takes from its frontier, with
            the goal.
    """

    path: Ints
    cost: float
    iterations: int

    def __repr__(self) -> str:
        return summary(self)


def bfs(
    grid: ArrayLike,
    start: object,
    goal: object,
    movement: Movement = Movement(),
    *,
    terrain: ArrayLike | None = None,
) -> SearchResult:
    """Return the path with the fewest moves that breadth-first search finds.

    The frontier is first in, first out. Neighbours come in the order N, E, S, W, NE, SE, SW, NW.

    Args:
        grid: (H, W) of 0 free and 1 occupied, or bool; at most ``MAX_CELLS`` cells.
        start: (row, col), a free cell.
        goal: (row, col), a free cell.
        movement: which moves are legal. BFS counts moves, so under 8-connectivity a diagonal move
            costs 1, too.
        terrain: (H, W) of integers, 0 on the occupied cells of ``grid`` and 1 to 255, the cost of a
            cell, on the others. It does not change what BFS finds, since BFS counts moves.

    Raises:
        ValueError: a grid that is not 2-D or holds other numbers, a start or goal outside it or on
            an occupied cell; terrain that does not fit the grid.

    Source: arXiv 2110.13242, section 4.
    """
    return _search(BFS, grid, start, goal, movement, terrain)


def astar(
    grid: ArrayLike,
    start: object,
    goal: object,
    movement: Movement = Movement(),
    *,
    terrain: ArrayLike | None = None,
) -> SearchResult:
    """Return a shortest path by A*, or with ``terrain`` a path of the least cost.

    It expands the cell of the smallest f, among equal f the most recently pushed one. A cell's
    parent changes only for a smaller g. The heuristic is the Manhattan distance under
    4-connectivity, the octile distance under 8-connectivity, and the Chebyshev distance under
    8-connectivity with a diagonal cost of 1. Arguments and errors are those of `bfs`.

    With ``terrain``, a move costs the mean of its two cells times its length, as in scikit-image's
    MCP_Geometric, and the heuristic is multiplied by the smallest cost of a free cell. Costs are
    exact. Where diagonals cost sqrt(2), a map is refused if its search meets a cost of 1,048,576
    or more. For a robot with a radius, pass the map that `inflate_terrain` returns.

    Source: Hart, Nilsson, Raphael 1968, https://doi.org/10.1109/TSSC.1968.300136; arXiv 2110.13242,
    section 4.

    >>> solution = astar([[0, 1, 0], [0, 0, 0]], (0, 0), (0, 2))
    >>> solution
    SearchResult(path=int64 (5, 2), cost=4.0, iterations=5)
    >>> solution.path.tolist()
    [[0, 0], [1, 0], [1, 1], [1, 2], [0, 2]]

    >>> astar([[0, 0, 0], [0, 0, 0]], (0, 0), (0, 2), terrain=[[1, 9, 1], [1, 1, 1]]).path.tolist()
    [[0, 0], [1, 0], [1, 1], [1, 2], [0, 2]]
    """
    return _search(ASTAR, grid, start, goal, movement, terrain)


class BatchResult(NamedTuple):
    """The paths that a batch of B searches found, and their costs.

    Attributes:
        cells: (M, 2) int64, the cells of all paths one after another.
        offsets: (B + 1,) int64; path k is ``cells[offsets[k]:offsets[k + 1]]``, which is empty if
            problem k has no path.
        cost: (B,) float64, -1 without a path.
        iterations: (B,) int64, number of expanded cells.
    """

    cells: Ints
    offsets: Ints
    cost: Floats
    iterations: Ints

    def __repr__(self) -> str:
        return summary(self)

    def path(self, k: int) -> Ints:
        """Return path k, (n, 2) cells from start to goal; (0, 2) without a path.

        Raises:
            IndexError: there is no problem k.
            TypeError: k is no integer, such as a slice.
        """
        count = len(self.cost)
        try:
            k = index(k)
        except TypeError:
            raise TypeError(
                f"path {k!r}: expected the number of a problem; paths() returns the paths of all"
            ) from None
        if not -count <= k < count:
            raise IndexError(f"path {k} is out of range for {count} problems")
        k %= count
        return self.cells[self.offsets[k] : self.offsets[k + 1]]

    def paths(self) -> list[Ints]:
        """Return the B paths, each as `path` does."""
        return [self.path(k) for k in range(len(self.cost))]

    def masks(self, shape: tuple[int, ...]) -> Bytes:
        """Return the cells of the paths as masks, (B, H, W) uint8: 1 on the cells of path k.

        Args:
            shape: (H, W) of the maps; of (B, H, W), such as ``grids.shape``, the last two count.

        Raises:
            ValueError: another shape, or a cell lies outside a map of this shape.

        >>> search_batch("bfs", [[0, 1], [0, 0]], [(0, 0)], [(1, 1)]).masks((2, 2))
        array([[[1, 0],
                [1, 1]]], dtype=uint8)
        """
        try:
            rows, columns = (index(side) for side in tuple(shape)[-2:])
            is_size = min(rows, columns) > 0
        except (TypeError, ValueError):  # no sequence of integers, or a single one
            is_size = False
        if not is_size:
            raise ValueError(f"shape: got {shape!r}, expected (H, W) or (B, H, W) of the maps")
        if len(self.cells) and (self.cells >= (rows, columns)).any():
            raise ValueError(
                f"shape: got {rows} x {columns} cells, but a path has the cell "
                f"{tuple(self.cells[(self.cells >= (rows, columns)).any(axis=1)][0].tolist())}"
            )
        masks = np.zeros((len(self.cost), rows, columns), np.uint8)
        owners = np.repeat(np.arange(len(self.cost)), np.diff(self.offsets))
        masks[owners, self.cells[:, 0], self.cells[:, 1]] = 1
        return masks


def search_batch(
    search: str,
    grids: ArrayLike,
    starts: ArrayLike,
    goals: ArrayLike,
    movement: Movement = Movement(),
    *,
    terrain: ArrayLike | None = None,
) -> BatchResult:
    """Solve B problems as `bfs` or `astar` would, without the cost of a Python call for each.

    Args:
        search: "bfs" or "astar".
        grids: (B, H, W), or one (H, W) that all problems share; 0 free, 1 occupied.
        starts: (B, 2) cells.
        goals: (B, 2) cells.
        movement: which moves are legal.
        terrain: costs of the cells, of the shape of ``grids``; `terrain_from_costs` makes it of
            floats.

    Raises:
        ValueError: a problem that `bfs` refuses, with the number of the first such problem; arrays
            that do not fit together.
    """
    if not isinstance(search, str):
        raise TypeError(f'search: got {type(search).__name__}, expected "bfs" or "astar"')
    check_choice("search", search, SEARCHES)
    return solve_batch(SEARCHES[search], grids, starts, goals, movement, terrain=terrain)


def solve_batch(
    weights: CostWeights,
    grids: ArrayLike,
    starts: ArrayLike,
    goals: ArrayLike,
    movement: Movement,
    allow_occupied_ends: bool = False,
    terrain: ArrayLike | None = None,
) -> BatchResult:
    """Solve B problems by the search with these weights; otherwise as `search_batch`.

    With ``allow_occupied_ends``, a start or goal may be occupied: such a problem has no path, and
    no cell is expanded. On terrain, the weighted heuristic may not exceed `MAX_PATH_COST` / 2.
    """
    maps, start_cells, goal_cells = _as_problems(grids, starts, goals, terrain)
    maps = maps.seen_by(weights)
    if weights == (1, 1.0):
        weights = ASTAR
    solved = maps.solve(
        start_cells, goal_cells, movement, weights, allow_occupied_ends=allow_occupied_ends
    )
    return _as_batch_result(maps, solved, movement)


def check_jump_points(movement: Movement) -> None:
    """Check that there is a jump point search for ``movement``.

    Raises:
        ValueError: it has no diagonal moves.
    """
    check_movement(movement)
    if movement.connectivity == 4:
        raise ValueError(
            "movement: got 4 moves, expected 8 for jump point search; for 4 moves there is JPS4 "
            "(Baum 2025, arXiv 2501.14816), which mapdata does not have"
        )


def solve_by_jump_points(
    grids: ArrayLike, starts: ArrayLike, goals: ArrayLike, movement: Movement
) -> tuple[BatchResult, Ints]:
    """Solve B problems by jump point search (`mapdata.search.bit_jumps`).

    The arguments are those of `search_batch`. A grid that all problems share is read once.

    Returns:
        The paths, with the start, the jump points that were taken from the frontier, and the goal
        as expansions; and the number of cells that scans and rays to the goal passed, (B,), each as
        often as one passed it, and the start.

    Raises:
        ValueError: what `search_batch` refuses; a movement without diagonal moves.
    """
    check_jump_points(movement)
    maps, start_cells, goal_cells = _as_problems(grids, starts, goals)
    shape = maps.grids.shape[1:]
    lattice, scratch = kept_search_memory(shape, move_rule(movement))
    solved, looks = jump_to_goals(
        maps.grids,
        start_cells,
        goal_cells,
        empty_bit_map(shape),
        lattice,
        jump_memory(shape, scratch),
    )
    maps.check_solved(solved, start_cells, goal_cells)
    return _as_batch_result(maps, solved, movement), looks


def solve_by_goal_fields(
    grids: ArrayLike,
    starts: ArrayLike,
    goals: ArrayLike,
    movement: Movement,
    terrain: ArrayLike | None = None,
) -> tuple[BatchResult, Ints]:
    """Solve B problems by A* whose heuristic is the exact cost to the goal.

    The arguments are those of `search_batch`.

    Returns:
        The paths, with the number of their cells as expansions, which is 0 where there is no path,
        since the start has no cost to the goal then; and the number of cells whose cost to the
        goal was computed, (B,).

    Raises:
        ValueError: what `search_batch` or `distance_field` refuses.
    """
    maps, start_cells, goal_cells = _as_problems(grids, starts, goals, terrain)
    lattice, scratch = kept_search_memory(maps.grids.shape[1:], move_rule(movement))
    solved = follow_goal_fields(*maps.ground, start_cells, goal_cells, lattice, scratch)
    maps.check_solved(solved, start_cells, goal_cells)
    paths = _as_batch_result(maps, solved, movement)
    return paths._replace(iterations=np.diff(solved.offsets)), solved.expansions


def solve_by_landmarks(
    grids: ArrayLike, starts: ArrayLike, goals: ArrayLike, movement: Movement, landmarks: int
) -> tuple[BatchResult, Ints]:
    """Solve B problems by A* with landmarks (`mapdata.search.landmarks`).

    The arguments are those of `search_batch`, and the largest number of landmarks on a map.

    Returns:
        The paths; and the numbers of cells, (B,), that floods visited to place the landmarks of
        each problem. On one map (H, W) that all problems share, landmarks are placed once, for the
        first problem.

    Raises:
        ValueError: what `search_batch` refuses; a path that is too long for exact costs.
    """
    maps, start_cells, goal_cells = _as_problems(grids, starts, goals)
    lattice, scratch = kept_search_memory(maps.grids.shape[1:], move_rule(movement))
    solved, prepared = solve_with_landmarks(
        maps.grids, start_cells, goal_cells, landmarks, lattice, scratch
    )
    maps.check_solved(solved, start_cells, goal_cells)
    return _as_batch_result(maps, solved, movement), prepared


def _as_problems(
    grids: ArrayLike, starts: ArrayLike, goals: ArrayLike, terrain: ArrayLike | None = None
) -> tuple[MapStack, Ints, Ints]:
    """Return the arguments of `search_batch` as kernels expect them: B maps or one, (B, 2), (B, 2).

    Raises:
        ValueError: what `as_problems` or `as_terrain` refuses.
    """
    grid_stack, start_cells, goal_cells = as_problems(grids, starts, goals)
    maps = MapStack(grid_stack, as_optional_terrain(terrain, grid_stack))
    return maps, start_cells, goal_cells


def _as_batch_result(maps: MapStack, solved: Solved, movement: Movement) -> BatchResult:
    """Return what a kernel found as a public result."""
    return BatchResult(
        solved.cells, solved.offsets, maps.costs_of(solved, movement), solved.expansions
    )


def distance_field(
    grid: ArrayLike,
    goal: object,
    movement: Movement = Movement(),
    *,
    terrain: ArrayLike | None = None,
) -> Float32s:
    """Return the cost of the shortest path from every cell to ``goal``.

    Args:
        grid: (H, W) of 0 free and 1 occupied, or bool.
        goal: (row, col), a free cell.
        movement: which moves are legal.
        terrain: (H, W) costs of the cells, as `astar` takes them.

    Returns:
        (H, W) float32, in cells; -1 where there is no path.

    Raises:
        ValueError: a grid, goal or terrain that `astar` refuses, or a path of 2,097,152 cells or
            more.

    >>> distance_field([[0, 1, 0], [0, 0, 0]], (0, 0))
    array([[ 0., -1.,  4.],
           [ 1.,  2.,  3.]], dtype=float32)
    """
    array = as_grid(grid, 2)
    row, column = as_cell("goal", goal, array)
    costs = as_optional_terrain(terrain, array)
    field = np.empty(array.shape, np.float32)
    rule = move_rule(movement)
    map_, cell_costs = as_ground(array, costs)
    is_valid, high_cost = write_field(
        map_, cell_costs, row, column, rule, kept_memory(array.shape, rule), field
    )
    if not is_valid:
        raise ValueError(values_complaint(array))
    if array[row, column]:
        hint = nearest_free_cell(array, (row, column))
        raise ValueError(f"goal: {row, column} is on an occupied cell{hint}")
    if high_cost:
        raise ValueError(high_cost_complaint(high_cost))
    return field


def check_path(
    grid: ArrayLike,
    path: ArrayLike,
    movement: Movement = Movement(),
    *,
    terrain: ArrayLike | None = None,
) -> float:
    """Return the cost of ``path`` on ``grid``, in cells.

    Args:
        grid: (H, W) of 0 free and 1 occupied, or bool.
        path: (k, 2) cells, k at least 1.
        movement: which moves are legal.
        terrain: (H, W) costs of the cells, as `astar` takes them.

    Raises:
        ValueError: the path is empty or not (k, 2); a cell is outside or occupied; a step is not
            legal. The message names the first such cell or step. Also terrain that does not fit
            the grid.

    >>> check_path([[0, 0], [1, 0]], [(0, 0), (0, 1), (1, 1)])
    2.0
    >>> check_path([[0, 0], [1, 0]], [(0, 0), (0, 1), (1, 1)], terrain=[[1, 3], [0, 4]])
    5.5
    """
    array = as_grid(grid, 2)
    cells = as_cells("path", path)
    if len(cells) == 0:
        raise ValueError("path: got no cell, expected at least one")
    diagonals, _ = move_rule(movement)
    costs = as_optional_terrain(terrain, array)
    bad_cell, diagonal = first_bad_cell(array, cells, diagonals)
    if bad_cell == -1 and costs is not None:
        return terrain_path_cost(costs, cells, movement)
    if bad_cell == -1:
        straight = len(cells) - 1 - diagonal
        return float(straight + diagonal * movement.diagonal_cost)
    if bad_cell == -2:
        raise ValueError(values_complaint(array))
    reason = why_not_free(array, cells[bad_cell])
    if reason:
        raise ValueError(f"path: cell {bad_cell}, {reason}")
    raise ValueError(f"path: move {bad_cell - 1}, {_why_no_move(cells[bad_cell - 1 :], movement)}")


def _why_no_move(cells: Ints, movement: Movement) -> str:
    """Return why there is no legal move from the first of ``cells``, (n, 2), to the second.

    Both are free cells.
    """
    start, end = (tuple(cell) for cell in cells[:2].tolist())
    step = f"from {start} to {end},"
    distance = np.abs(cells[1] - cells[0]).max()
    if distance == 0:
        return f"{step} stays on its cell"
    if distance > 1:
        return f"{step} leads to no neighbour"
    if movement.connectivity == 4:
        return f"{step} is diagonal (a Movement with connectivity=8 allows it)"
    return f"{step} cuts a corner (a Movement with corner_cutting=True allows it)"


def _search(
    weights: CostWeights,
    grid: ArrayLike,
    start: object,
    goal: object,
    movement: Movement,
    terrain: ArrayLike | None,
) -> SearchResult:
    """Check the arguments of `bfs` and `astar`, and search by these weights."""
    array = as_grid(grid, 2)
    start_cell = as_cell("start", start, array)
    goal_cell = as_cell("goal", goal, array)
    rule = move_rule(movement)
    costs = as_optional_terrain(terrain, array)
    if costs is None or weights is not ASTAR:  # BFS counts moves, whatever the cells cost.
        units_per_cell = 1
        path, straight, diagonal, expansions, high_cost = solve_problem(
            array,
            *start_cell,
            *goal_cell,
            weights,
            diagonal_moves(rule),
            rule,
            kept_memory(array.shape, rule),
        )
        if high_cost:
            raise ValueError(high_cost_complaint(high_cost))
        # Every search expands its start, so 0 says that the kernel refused the problem.
        if expansions == 0:
            raise ValueError(problem_complaint(array, start_cell, goal_cell))
    else:
        units_per_cell = 2  # Sums of costs on terrain are doubled.
        ends = np.array([start_cell]), np.array([goal_cell])
        maps = MapStack(array[None], costs[None])
        solved = maps.solve(*ends, movement, error_prefix=lambda _: "")
        path, expansions = solved.cells, int(solved.expansions[0])
        straight, diagonal = solved.sums[0].tolist()
    moves_cost = straight + diagonal * movement.diagonal_cost
    return SearchResult(path, moves_cost / units_per_cell if len(path) else -1.0, expansions)
