"""Shortest paths on grids: BFS, A*, distance fields and the path check.

This module checks the arguments and turns them into the form of the kernels. The kernels of
`mapdata.search.solving` do the work, in the exact order that the format fixes (docs/format.md).
"""

from __future__ import annotations

import threading
from operator import index
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from mapdata.arrays import Array, Bytes, Float32s, Floats, Ints, summary
from mapdata.checks import check_choice
from mapdata.hints import hint_on_values
from mapdata.limits import MAX_CELL_COST
from mapdata.movement import Movement, check_movement
from mapdata.search.ground import TOO_LONG, as_ground
from mapdata.search.jump_points import jump_to_goals
from mapdata.search.kernels import (
    Scratch,
    copy_to_bytes,
    first_bad_cell,
    plain_scratch_view,
    scratch_bytes,
)
from mapdata.search.landmarks import solve_with_landmarks
from mapdata.search.lattice import (
    ASTAR,
    BFS,
    MAX_CELLS,
    MAX_PATH_COST,
    UNIT,
    CostWeights,
    Lattice,
    MoveRule,
    diagonal_moves,
    move_rule,
    plain_lattice,
)
from mapdata.search.solving import (
    Solved,
    follow_goal_fields,
    solve_problem,
    solve_problems,
    write_field,
)
from mapdata.search.terrain import costs_from_sums, terrain_path_cost

SEARCHES = {"bfs": BFS, "astar": ASTAR}
"""The searches of labels and datasets, by name. Names of stored arrays and columns begin so."""

MAX_KEPT_BYTES = 5 * 2**28
"""Largest scratch memory that a thread keeps from one call to the next: 1.25 GiB.

Faulting in new pages takes longer than most searches. What is kept is address space: only pages
that searches touched take memory, mostly less than a quarter. A call that needs more, under
8-connectivity on over 9.7 M cells, allocates memory for itself and frees it.
"""

Cell: TypeAlias = "tuple[int, int] | Ints"

_UINT8 = np.dtype(np.uint8)
"""Comparing a dtype with this takes half the time of comparing it with the class `numpy.uint8`."""


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
    grid_stack, start_cells, goal_cells = _as_problems(grids, starts, goals)
    terrains = None if terrain is None else _as_terrain_stack(terrain, grid_stack)
    if weights == BFS:
        terrains = None
    if weights == (1, 1.0):
        weights = ASTAR
    solved = _solve(
        grid_stack, terrains, start_cells, goal_cells, movement, allow_occupied_ends, weights
    )
    _check_all_solved(solved, grid_stack, start_cells, goal_cells)
    return _as_batch_result(solved, terrains, movement)


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
    """Solve B problems by jump point search (`mapdata.search.jump_points`).

    The arguments are those of `search_batch`.

    Returns:
        The paths, with the jump points that were taken from the frontier as expansions; and the
        number of cells that the scans passed, (B,), the start included.

    Raises:
        ValueError: what `search_batch` refuses; a movement without diagonal moves.
    """
    check_jump_points(movement)
    rule = move_rule(movement)
    grid_stack, start_cells, goal_cells = _as_problems(grids, starts, goals)
    solved, looks = jump_to_goals(
        grid_stack, start_cells, goal_cells, *_lattice_and_scratch(grid_stack, rule)
    )
    _check_all_solved(solved, grid_stack, start_cells, goal_cells)
    return _as_batch_result(solved, None, movement), looks


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
    rule = move_rule(movement)
    grid_stack, start_cells, goal_cells = _as_problems(grids, starts, goals)
    terrains = None if terrain is None else _as_terrain_stack(terrain, grid_stack)
    maps, cell_costs = as_ground(grid_stack, terrains)
    lattice, scratch = _lattice_and_scratch(grid_stack, rule)
    solved = follow_goal_fields(maps, cell_costs, start_cells, goal_cells, lattice, scratch)
    _check_all_solved(solved, grid_stack, start_cells, goal_cells)
    paths = _as_batch_result(solved, terrains, movement)
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
    rule = move_rule(movement)
    grid_stack, start_cells, goal_cells = _as_problems(grids, starts, goals)
    solved, prepared = solve_with_landmarks(
        grid_stack, start_cells, goal_cells, landmarks, *_lattice_and_scratch(grid_stack, rule)
    )
    _check_all_solved(solved, grid_stack, start_cells, goal_cells)
    return _as_batch_result(solved, None, movement), prepared


def _as_problems(grids: ArrayLike, starts: ArrayLike, goals: ArrayLike) -> tuple[Bytes, Ints, Ints]:
    """Return B problems as the kernels expect them: (B or 1, H, W), (B, 2) and (B, 2).

    Raises:
        ValueError: a grid that `as_grid` refuses, other cells than (B, 2), or unequal numbers.
    """
    array = np.asarray(grids)
    grid_stack = as_grid(array if array.ndim == 3 else array[None], 3)
    start_cells = _as_cells("starts", starts)
    goal_cells = _as_cells("goals", goals)
    count = len(start_cells)
    if len(goal_cells) != count or (array.ndim == 3 and len(grid_stack) != count):
        raise ValueError(
            f"got {len(grid_stack)} grids, {count} starts and {len(goal_cells)} goals, expected "
            "equal numbers"
        )
    return grid_stack, start_cells, goal_cells


def as_checked_problems(
    grids: ArrayLike, starts: ArrayLike, goals: ArrayLike
) -> tuple[Bytes, Ints, Ints]:
    """Return B problems as `_as_problems` does, for kernels that do not check them.

    Raises:
        ValueError: what `search_batch` refuses.
    """
    grid_stack, start_cells, goal_cells = _as_problems(grids, starts, goals)
    if grid_stack.max(initial=0) > 1:
        raise ValueError(values_complaint(grid_stack))
    are_free = np.ones(len(start_cells), bool)
    for cells in (start_cells, goal_cells):
        is_inside = np.all((cells >= 0) & (cells < grid_stack.shape[1:]), axis=1)
        row, column = np.where(is_inside[:, None], cells, 0).T
        map_numbers = np.arange(len(cells)) % len(grid_stack)  # all are 0 on a shared map
        are_free &= is_inside & (grid_stack[map_numbers, row, column] == 0)
    if not are_free.all():
        _check_all_done(int(are_free.argmin()), grid_stack, start_cells, goal_cells)
    return grid_stack, start_cells, goal_cells


def _solve(
    grids: Bytes,
    terrains: Bytes | None,
    starts: Ints,
    goals: Ints,
    movement: Movement,
    allow_occupied_ends: bool,
    weights: CostWeights,
) -> Solved:
    """Solve problems whose arguments are checked, on terrain if there is any."""
    rule = move_rule(movement)
    maps, cell_costs = as_ground(grids, terrains)
    # All searches on terrain serve any movement.
    diagonals = diagonal_moves(rule) if terrains is None else None
    return solve_problems(
        maps,
        cell_costs,
        starts,
        goals,
        int(allow_occupied_ends),
        weights,
        diagonals,
        *_lattice_and_scratch(maps, rule),
    )


def _as_batch_result(solved: Solved, terrains: Bytes | None, movement: Movement) -> BatchResult:
    """Return what a kernel found as a public result."""
    costs_of = _costs_of_moves if terrains is None else costs_from_sums
    costs = costs_of(solved.sums, movement)
    return BatchResult(solved.cells, solved.offsets, costs, solved.expansions)


def _check_all_solved(solved: Solved, grids: Bytes, starts: Ints, goals: Ints) -> None:
    """Check that a kernel solved all problems.

    Raises:
        ValueError: it refused one; the message has its number and the reason.
    """
    if solved.high_cost:
        raise ValueError(f"problem {solved.done}: {high_cost_complaint(solved.high_cost)}")
    _check_all_done(solved.done, grids, starts, goals)


def _check_all_done(done: int, grids: Bytes, starts: Ints, goals: Ints) -> None:
    """Check that a kernel refused no grid, start or goal after ``done`` problems.

    Raises:
        ValueError: it refused one; the message has its number and the reason.
    """
    if done < len(starts):
        grid = grids[min(done, len(grids) - 1)]
        complaint = _problem_complaint(grid, starts[done], goals[done])
        raise ValueError(f"problem {done}: {complaint}")


def _costs_of_moves(moves: Ints, movement: Movement) -> Floats:
    """Return the costs (B,) of paths with (B, 2) straight and diagonal moves; -1 for (-1, 0)."""
    straight, diagonal = moves.T
    return np.where(straight < 0, -1.0, straight + diagonal * movement.diagonal_cost)


def _as_terrain_stack(terrain: ArrayLike, grids: Bytes) -> Bytes:
    """Return terrain, (H, W) or (B, H, W), as the kernels expect it, in the shape of ``grids``.

    Raises:
        ValueError: what `as_terrain` refuses.
    """
    array = np.asarray(terrain)
    return as_terrain(array if array.ndim == 3 else array[None], grids)


def search_terrains(
    terrains: Bytes,
    starts: Ints,
    goals: Ints,
    movement: Movement,
    allow_occupied_ends: bool,
    weights: CostWeights = ASTAR,
) -> tuple[BatchResult, int, int]:
    """Solve problems on terrain that is known to fit its grids.

    Args:
        terrains: (B, H, W), or (1, H, W) for terrain that all problems share.
        starts: (B, 2) cells.
        goals: (B, 2) cells.
        movement: which moves are legal.
        allow_occupied_ends: whether a start or goal may be occupied, as in `solve_batch`.
        weights: which search; not BFS.

    Returns:
        The paths; the number of problems that are solved, less than B if the next one is refused;
        and why it is refused: 0 if an end is outside or occupied, otherwise the doubled cost that
        is too high to be exact.
    """
    solved = _solve(terrains, terrains, starts, goals, movement, allow_occupied_ends, weights)
    return _as_batch_result(solved, terrains, movement), solved.done, solved.high_cost


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
    row, column = _as_cell("goal", goal, array)
    costs = None if terrain is None else as_terrain(terrain, array)
    field = np.empty(array.shape, np.float32)
    rule = move_rule(movement)
    map_, cell_costs = as_ground(array, costs)
    is_valid, high_cost = write_field(
        map_, cell_costs, row, column, rule, _scratch_memory(array, rule), field
    )
    if not is_valid:
        raise ValueError(values_complaint(array))
    if array[row, column]:
        hint = _nearest_free_cell(array, (row, column))
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
    cells = _as_cells("path", path)
    if len(cells) == 0:
        raise ValueError("path: got no cell, expected at least one")
    diagonals, _ = move_rule(movement)
    costs = None if terrain is None else as_terrain(terrain, array)
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
    start_cell = _as_cell("start", start, array)
    goal_cell = _as_cell("goal", goal, array)
    rule = move_rule(movement)
    if terrain is not None:
        costs = as_terrain(terrain, array)
        if weights is ASTAR:
            return _search_on_terrain(costs, array, start_cell, goal_cell, movement)
    path, straight, diagonal, expansions, high_cost = solve_problem(
        array,
        *start_cell,
        *goal_cell,
        weights,
        diagonal_moves(rule),
        rule,
        _scratch_memory(array, rule),
    )
    if high_cost:
        raise ValueError(high_cost_complaint(high_cost))
    # Every search expands its start, so 0 says that the kernel refused the problem.
    if expansions == 0:
        raise ValueError(_problem_complaint(array, start_cell, goal_cell))
    cost = straight + diagonal * movement.diagonal_cost if len(path) else -1.0
    return SearchResult(path, cost, expansions)


def _search_on_terrain(
    terrain: Bytes,
    grid: Bytes,
    start: tuple[int, int],
    goal: tuple[int, int],
    movement: Movement,
) -> SearchResult:
    """Solve one problem, whose ends are inside the map, by A* on ``terrain`` (H, W)."""
    solved = _solve(
        grid[None], terrain[None], np.array([start]), np.array([goal]), movement, False, ASTAR
    )
    if solved.high_cost:
        raise ValueError(high_cost_complaint(solved.high_cost))
    if solved.done == 0:
        raise ValueError(_problem_complaint(grid, start, goal))
    straight_sum, diagonal_sum = solved.sums[0].tolist()
    cost = (straight_sum + diagonal_sum * movement.diagonal_cost) / 2 if len(solved.cells) else -1.0
    return SearchResult(solved.cells, cost, int(solved.expansions[0]))


class _ThreadScratch(threading.local):
    """Scratch memory of each thread. Kernels run without the GIL, so threads cannot share it.

    Attributes:
        memory: the memory.
        shape: rows and columns of the maps of the last call for many problems.
        rule: rule of that call.
        parts: the lattice of that call, and ``memory`` as its scratch. To make them takes as long
            as to solve a few problems.
    """

    memory = np.empty(0, np.uint8)
    shape: tuple[int, ...] = ()
    rule: MoveRule = (0, 0)
    parts: tuple[Lattice, Scratch] | None = None


_thread_scratch = _ThreadScratch()


def _scratch_memory(grid: Bytes, rule: MoveRule) -> Bytes:
    """Return scratch memory for any search on ``grid``, which the thread's next call overwrites."""
    rows, columns = grid.shape[-2:]
    diagonals, _ = rule
    max_pushes_per_cell = 8 if diagonals else 4
    size = scratch_bytes(max_pushes_per_cell, (rows + 2) * (columns + 2))
    memory = _thread_scratch.memory
    if size > len(memory):
        memory = np.empty(size, np.uint8)
        if size <= MAX_KEPT_BYTES:
            _thread_scratch.memory = memory
            _thread_scratch.parts = None  # They are of the old memory, which would be kept, too.
    return memory


def _lattice_and_scratch(maps: Bytes, rule: MoveRule) -> tuple[Lattice, Scratch]:
    """Return the lattice of ``maps`` (B, H, W), and `_scratch_memory` for any search on it."""
    kept = _thread_scratch
    shape = maps.shape[1:]
    if kept.parts is not None and kept.shape == shape and kept.rule == rule:
        return kept.parts
    memory = _scratch_memory(maps, rule)
    lattice = plain_lattice(shape, rule)
    parts = lattice, plain_scratch_view(memory, lattice)
    if memory is kept.memory:
        kept.shape, kept.rule, kept.parts = shape, rule, parts
    return parts


def as_grid(grid: ArrayLike, rank: int) -> Bytes:
    """Return ``grid`` as the kernels expect it: writable, contiguous uint8 with ``rank`` axes.

    That its numbers are 0 and 1 is checked only if it has another dtype; kernels check the rest.

    Raises:
        ValueError: another rank, an empty axis, too many cells, or a dtype that is not numeric.
    """
    try:
        array = np.asarray(grid)
    except ValueError as error:
        raise ValueError(f"grid: {error}") from None
    shape = array.shape
    if array.dtype == object and not shape:
        hint = "; ros_map.grid(unknown=...) makes one" if hasattr(grid, "grid") else ""
        raise ValueError(
            f"grid: got a {type(grid).__name__}, expected an array of 0 free and 1 occupied{hint}"
        )
    if len(shape) != rank or shape[-2] == 0 or shape[-1] == 0:
        raise ValueError(
            f"grid: got shape {shape}, expected {'(H, W)' if rank == 2 else '(B, H, W)'} not empty"
            f"{hint_on_values(array) if array.dtype.kind in 'US' else ''}"
        )
    if shape[-2] * shape[-1] > MAX_CELLS:
        raise ValueError(f"grid: got {_size(array)} cells, expected at most {MAX_CELLS} in all")
    if array.dtype != _UINT8:
        array = _as_bytes(array)
    if not array.flags.carray:
        array = np.array(array, order="C")
    return array


def as_terrain(terrain: ArrayLike, grid: Bytes) -> Bytes:
    """Return ``terrain`` as the kernels expect it: writable, contiguous uint8.

    Args:
        terrain: integers from 0 to 255, of the shape of ``grid``.
        grid: of 0 and 1, which must be 1 exactly where ``terrain`` is 0.

    Raises:
        ValueError: another shape, dtype or number; terrain and grid disagree on a cell.
    """
    try:
        array = np.asarray(terrain)
    except ValueError as error:
        raise ValueError(f"terrain: {error}") from None
    if array.shape != grid.shape:
        raise ValueError(
            f"terrain: got shape {array.shape}, expected {grid.shape}, that of the grid"
        )
    if array.dtype != _UINT8:
        if array.dtype.kind not in "iu":
            raise ValueError(
                f"terrain: got dtype {array.dtype}, expected integers from 0 to 255: "
                "mapdata.terrain_from_costs(costs, grids) makes them of other costs"
            )
        is_outside = (array < 0) | (array > MAX_CELL_COST)
        if is_outside.any():
            number = array[is_outside][0]
            raise ValueError(
                f"terrain: got the value {number}, expected integers from 0 to 255: "
                "mapdata.terrain_from_costs(costs, grids) makes them of other costs"
            )
        array = array.astype(np.uint8)
    disagreements = (array == 0) != grid
    if disagreements.any():
        if grid.max() > 1:
            raise ValueError(values_complaint(grid))
        cell = tuple(np.argwhere(disagreements)[0].tolist())
        state = "occupied" if grid[cell] else "free"
        raise ValueError(
            f"terrain: got {array[cell]} at {cell}, which is {state} in the grid; expected 0 on "
            "occupied cells and 1 to 255 on free ones"
        )
    return array if array.flags.carray else np.array(array, order="C")


def terrain_from_costs(costs: ArrayLike, grids: ArrayLike) -> Bytes:
    """Return costs of any scale as terrain, which `astar` and `search_batch` take exactly.

    The costs of each map are divided by its largest one and multiplied by 255, then rounded to
    integers of at least 1. So the resolution of a map is 1/255 of its largest cost: a cost changes
    by at most half of that, except for costs below 1/510 of the largest one, which become 1. Paths
    do not depend on the scale. A cost on the terrain, times the largest cost of a free cell and
    over 255, is in the unit of ``costs``, up to this rounding.

    Args:
        costs: (H, W) or (B, H, W) numbers of at least 0, such as the predictions of a model. What
            occupied cells have does not count, not even NaN.
        grids: 0 free and 1 occupied, of the shape of ``costs``.

    Returns:
        uint8 of the same shape, 1 to 255 on free cells and 0 on occupied ones.

    Raises:
        ValueError: another shape or dtype; a free cell whose cost is negative, NaN or infinite.

    >>> terrain_from_costs([[0.2, 0.8, np.inf]], [[0, 0, 1]])
    array([[ 64, 255,   0]], dtype=uint8)
    """
    cell_costs = np.asarray(costs)
    if cell_costs.ndim not in (2, 3):
        raise ValueError(
            f"costs: got shape {cell_costs.shape}, expected (H, W) or (B, H, W), that of the grids"
        )
    rank = 3 if cell_costs.ndim == 3 else 2
    grid_stack = as_grid(grids, rank)
    if grid_stack.max(initial=0) > 1:
        raise ValueError(values_complaint(grid_stack))
    if cell_costs.shape != grid_stack.shape:
        raise ValueError(
            f"costs: got shape {cell_costs.shape}, expected {grid_stack.shape}, that of the grids"
        )
    if cell_costs.dtype.kind not in "iuf":
        raise ValueError(f"costs: got dtype {cell_costs.dtype}, expected numbers")
    is_free = grid_stack == 0
    is_refused = is_free & ~((cell_costs >= 0) & np.isfinite(cell_costs))
    if is_refused.any():
        cell = tuple(np.argwhere(is_refused)[0].tolist())
        raise ValueError(
            f"costs: got {cell_costs[cell]} at {cell}, expected a finite number of at least 0 on "
            "each free cell"
        )
    free_costs = np.where(is_free, cell_costs, 0).astype(np.result_type(cell_costs, np.float64))
    largest = free_costs.max(axis=(-2, -1), keepdims=True)
    # The shares are between 0 and 1 whatever the scale: 255 / largest would overflow where all
    # costs are tiny, and 255 * costs where they are huge.
    shares = free_costs / np.where(largest > 0, largest, 1)
    terrain: Bytes = np.clip(np.rint(MAX_CELL_COST * shares), 1, MAX_CELL_COST).astype(np.uint8)
    terrain[~is_free] = 0
    return terrain


def _as_bytes(array: Array) -> Bytes:
    """Return an array of bool, integers or floats, each 0 or 1, as uint8."""
    if array.dtype == np.bool_:
        return array.view(np.uint8)
    if array.dtype.kind not in "iuf":
        hint = hint_on_values(array)  # "" or "; it looks like ..."
        raise ValueError(
            f"grid: got dtype {array.dtype}, expected 0 free and 1 occupied, or bool{hint}"
        )
    # The kernel is compiled once for each of two dtypes, and for one memory layout.
    wide_dtype = np.int64 if array.dtype.kind in "iu" else np.float64
    numbers = np.require(array, wide_dtype, ["C", "A", "W"])
    narrow = np.empty(array.shape, np.uint8)
    if not copy_to_bytes(numbers.reshape(-1), narrow.reshape(-1)):
        raise ValueError(values_complaint(array))
    return narrow


def _as_cell(name: str, cell: Any, grid: Bytes) -> tuple[int, int]:
    """Return ``cell`` as two ints inside ``grid``; errors call it ``name``."""
    try:
        row, column = cell
        row = index(row)
        column = index(column)
    except (TypeError, ValueError):
        raise ValueError(
            f"{name}: got {cell!r}, expected a cell (row, col) of two integers"
        ) from None
    rows, columns = grid.shape
    if not (0 <= row < rows and 0 <= column < columns):
        raise ValueError(f"{name}: {row, column} is outside the map of {_size(grid)} cells")
    return row, column


def _as_cells(name: str, cells: ArrayLike) -> Ints:
    """Return ``cells`` as the kernels expect them: writable, contiguous (n, 2) int64.

    Errors call them ``name``.
    """
    array = np.asarray(cells)
    if array.size == 0 and array.ndim <= 2:
        return np.empty((0, 2), np.int64)
    if array.ndim != 2 or array.shape[1] != 2 or array.dtype.kind not in "iu":
        raise ValueError(
            f"{name}: got shape {array.shape} of {array.dtype}, expected (n, 2) integer cells "
            "(row, col)"
        )
    int64s = array.astype(np.int64, copy=False)
    return int64s if int64s.flags.carray else int64s.copy()


def _problem_complaint(grid: Bytes, start: Cell, goal: Cell) -> str:
    """Return why a problem is refused: for the grid, for the start, or else for the goal."""
    if np.any(grid > 1):
        return values_complaint(grid)
    name, cell = ("start", start) if why_not_free(grid, start) else ("goal", goal)
    return f"{name}: {why_not_free(grid, cell)}{_nearest_free_cell(grid, cell)}"


def _nearest_free_cell(grid: Bytes, cell: Cell) -> str:
    """Return the end of an error message: which free cell is nearest to an occupied one.

    The user of a map that `inflate` has changed cannot see which cells it has occupied. The text is
    empty for a cell outside of the map.
    """
    row, column = cell
    if not (0 <= row < grid.shape[0] and 0 <= column < grid.shape[1]):
        return ""
    reach = 8
    while True:  # Most often it is close: a square around the cell is searched, then a larger one.
        top, left = max(row - reach, 0), max(column - reach, 0)
        square = grid[top : row + reach + 1, left : column + reach + 1]
        free_cells = np.argwhere(square == 0) + np.array((top, left))
        is_whole_map = square.shape == grid.shape
        if len(free_cells):
            squared_distances = ((free_cells - cell) ** 2).sum(axis=1)
            nearest = squared_distances.argmin()
            # Outside of the square a cell may be nearer than one in its corners.
            if is_whole_map or squared_distances[nearest] <= reach**2:
                nearest_row, nearest_column = free_cells[nearest].tolist()
                return f"; the nearest free cell is ({nearest_row}, {nearest_column})"
        elif is_whole_map:
            return "; the map has no free cell"
        reach *= 4


def why_not_free(grid: Bytes, cell: Cell) -> str:
    """Return why ``cell`` cannot be on a path, or an empty text if it can."""
    row, column = cell
    if not (0 <= row < grid.shape[0] and 0 <= column < grid.shape[1]):
        return f"({row}, {column}) is outside the map of {_size(grid)} cells"
    return f"({row}, {column}) is on an occupied cell" if grid[row, column] else ""


def values_complaint(grid: Array) -> str:
    """Return the error message for a grid that holds other numbers than 0 and 1."""
    first_bad_number = grid[(grid != 0) & (grid != 1)][0]
    return (
        f"grid: got the value {first_bad_number}, expected 0 free and 1 occupied only"
        f"{hint_on_values(grid)}"
    )


def high_cost_complaint(high_cost: int) -> str:
    """Return the error message for a cost that is not exact.

    Callers that know the number of the map put it before this message.

    Args:
        high_cost: as kernels return it: doubled and in 1 / UNIT on terrain, TOO_LONG on a grid.
    """
    if high_cost == TOO_LONG:
        return (
            f"the grid has paths of {MAX_PATH_COST} cells or more, for which costs are not exact: "
            "expected a coarser grid, or a search that counts moves (A* under 4-connectivity, BFS)"
        )
    return (
        f"terrain: a path costs {high_cost / (2 * UNIT):,.0f}, and costs are exact only below "
        f"{MAX_PATH_COST / 2:,.0f}: divide the terrain by a number, or let diagonal moves cost 1"
    )


def check_cost(map_numbers: Ints, row: int, high_cost: int) -> None:
    """Refuse a map whose costs are too high to be exact.

    Args:
        map_numbers: (B,) numbers of the maps of a batch.
        row: of the map in the batch, as kernels return it.
        high_cost: as kernels return it; 0 if all costs are exact.

    Raises:
        ValueError: such a cost; the message has the number of the map.
    """
    if high_cost:
        raise ValueError(f"map {map_numbers[row]}: {high_cost_complaint(high_cost)}")


def _size(grid: Array) -> str:
    """Return the size of a grid, or of each grid of a stack, as text."""
    return f"{grid.shape[-2]} x {grid.shape[-1]}"
