"""Shortest paths on grids: BFS, A*, distance fields and the path check.

Arguments are checked here; `mapdata.search.kernels` does the work, in the exact order that the
format fixes (docs/format.md).
"""

from __future__ import annotations

import threading
from operator import index
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from mapdata.arrays import Array, Bytes, Float32s, Floats, Ints, summary
from mapdata.checks import check_choice
from mapdata.movement import Movement
from mapdata.search.kernels import (
    first_bad_cell,
    narrow,
    solve_all,
    solve_one,
    write_field,
)
from mapdata.search.lattice import (
    ASTAR,
    BFS,
    MAX_CELLS,
    Rule,
    Weights,
    rule_of,
)

SEARCHES = {"bfs": BFS, "astar": ASTAR}
"""The searches of labels and datasets, by name; so begin names of stored arrays and of columns."""

KEPT_BYTES = 5 * 2**28
"""Scratch memory that a thread keeps from one call to the next, at most.

To fault in new pages takes longer than most searches. What is kept is address space, 1.25 GiB at
most; only pages that searches touched take memory, mostly less than a quarter. A call that needs
more (8-connected, on over 9.7 M cells) takes it for itself and gives it back.
"""

Cell: TypeAlias = "tuple[int, int] | Ints"

_UINT8 = np.dtype(np.uint8)  # comparing with the class itself takes twice as long


class SearchResult(NamedTuple):
    """What a search found.

    Attributes:
        path: (k, 2) int64, cells from start to goal, both included; (0, 2) when there is none.
        cost: cost of the path, in cells (BFS: in moves); -1.0 when there is none.
        iterations: number of expanded cells, the goal included.
    """

    path: Ints
    cost: float
    iterations: int

    def __repr__(self) -> str:
        return summary(self)


def bfs(
    grid: ArrayLike, start: object, goal: object, movement: Movement = Movement()
) -> SearchResult:
    """Return the path with the fewest moves that breadth-first search finds.

    Cells are first in, first out; neighbours come in the order N, E, S, W, NE, SE, SW, NW.

    Args:
        grid: (H, W) of 0 free and 1 occupied, or bool; at most ``MAX_CELLS`` cells.
        start: (row, col), a free cell.
        goal: (row, col), a free cell.
        movement: how one moves. BFS counts moves, so under 8-connectivity ``cost`` is hops.

    Raises:
        ValueError: a grid that is not 2-D or holds other values, a start or goal outside it or on
            an occupied cell.

    Source: arXiv 2110.13242, section 4.
    """
    return _search(BFS, grid, start, goal, movement)


def astar(
    grid: ArrayLike, start: object, goal: object, movement: Movement = Movement()
) -> SearchResult:
    """Return a shortest path by A*.

    It expands the cell of least f, among equal f the most recently pushed one; a cell's parent
    changes only for a smaller g. The heuristic is Manhattan (4), octile (8) or Chebyshev (8,
    diagonal cost 1). Arguments and errors are those of `bfs`.

    Source: Hart, Nilsson, Raphael 1968, https://doi.org/10.1109/TSSC.1968.300136; arXiv 2110.13242,
    section 4.

    >>> found = astar([[0, 1, 0], [0, 0, 0]], (0, 0), (0, 2))
    >>> found
    SearchResult(path=int64 (5, 2), cost=4.0, iterations=5)
    >>> found.path.tolist()
    [[0, 0], [1, 0], [1, 1], [1, 2], [0, 2]]
    """
    return _search(ASTAR, grid, start, goal, movement)


class BatchResult(NamedTuple):
    """What a batch of B searches found; path k is ``cells[offsets[k]:offsets[k + 1]]``.

    Attributes:
        cells: (M, 2) int64, all paths one after another; a problem without a path has none.
        offsets: (B + 1,) int64.
        cost: (B,) float64, -1 without a path.
        iterations: (B,) int64.
    """

    cells: Ints
    offsets: Ints
    cost: Floats
    iterations: Ints

    def __repr__(self) -> str:
        return summary(self)


def search_batch(
    search: str,
    grids: ArrayLike,
    starts: ArrayLike,
    goals: ArrayLike,
    movement: Movement = Movement(),
) -> BatchResult:
    """Solve B problems as `bfs` or `astar` would, without the cost of a Python call for each.

    Args:
        search: "bfs" or "astar".
        grids: (B, H, W), or one (H, W) that all problems share; 0 free, 1 occupied.
        starts: (B, 2) cells.
        goals: (B, 2) cells.
        movement: how one moves.

    Raises:
        ValueError: what `bfs` refuses, with the number of the first bad problem; arrays that do not
            fit together.
    """
    check_choice("search", search, SEARCHES)
    return solve_batch(SEARCHES[search], grids, starts, goals, movement)


def solve_batch(
    search: Weights,
    grids: ArrayLike,
    starts: ArrayLike,
    goals: ArrayLike,
    movement: Movement,
    most: int = 0,
) -> BatchResult:
    """Solve B problems by any ``search``; else as `search_batch`.

    Where ``most`` is 1, an end may be occupied: there is no path, and no cell is expanded.
    """
    array = np.asarray(grids)
    stack = as_grid(array if array.ndim == 3 else array[None], 3)
    begins = _whole("starts", starts)
    ends = _whole("goals", goals)
    count = len(begins)
    if len(ends) != count or (array.ndim == 3 and len(stack) != count):
        raise ValueError(
            f"got {len(stack)} grids, {count} starts and {len(ends)} goals, expected equal numbers"
        )
    rule = rule_of(movement)
    path, found, solved = solve_all(
        stack, begins, ends, most, search, rule, _scratch_memory(stack, rule)
    )
    if solved < count:
        grid = stack[min(solved, len(stack) - 1)]
        raise ValueError(f"problem {solved}: {_complaint(grid, begins[solved], ends[solved])}")
    straight, diagonal, iterations, bounds = found.T
    costs = straight + diagonal * movement.diagonal_cost
    offsets = np.concatenate(([0], bounds))
    return BatchResult(path, offsets, costs, iterations.copy())


def distance_field(grid: ArrayLike, goal: object, movement: Movement = Movement()) -> Float32s:
    """Return the cost of the shortest path from every cell to ``goal``.

    Returns:
        (H, W) float32, in cells; -1 where there is no path.

    Raises:
        ValueError: what `bfs` refuses, and a path of 2,097,152 cells or more.

    >>> distance_field([[0, 1, 0], [0, 0, 0]], (0, 0))
    array([[ 0., -1.,  4.],
           [ 1.,  2.,  3.]], dtype=float32)
    """
    array = as_grid(grid, 2)
    row, column = _cell("goal", goal, array)
    out = np.empty(array.shape, np.float32)
    rule = rule_of(movement)
    if not write_field(array, row, column, rule, _scratch_memory(array, rule), out):
        raise ValueError(values_complaint(array))
    if array[row, column]:
        raise ValueError(f"goal: {row, column} is on an occupied cell")
    return out


def check_path(grid: ArrayLike, path: ArrayLike, movement: Movement = Movement()) -> float:
    """Return the cost of ``path`` on ``grid``, in cells.

    Args:
        grid: (H, W) of 0 free and 1 occupied, or bool.
        path: (k, 2) cells, k at least 1.
        movement: the rule that every step must obey.

    Raises:
        ValueError: the path is empty or not (k, 2); a cell is outside or occupied; a step is not
            legal. Names the first such cell or step.

    >>> check_path([[0, 0], [1, 0]], [(0, 0), (0, 1), (1, 1)])
    2.0
    """
    array = as_grid(grid, 2)
    cells = _whole("path", path)
    if len(cells) == 0:
        raise ValueError("path: got no cell, expected at least one")
    bad, diagonal = first_bad_cell(array, cells, rule_of(movement)[0])
    if bad == -1:
        straight = len(cells) - 1 - diagonal
        return float(straight + diagonal * movement.diagonal_cost)
    if bad == -2:
        raise ValueError(values_complaint(array))
    why = why_not_free(array, cells[bad])
    if why:
        raise ValueError(f"path: cell {bad}, {why}")
    steps = f"from {tuple(cells[bad - 1].tolist())} to {tuple(cells[bad].tolist())}"
    raise ValueError(f"path: step {bad - 1}, {steps}, is not a move of {movement}")


def _search(
    search: Weights, grid: ArrayLike, start: object, goal: object, movement: Movement
) -> SearchResult:
    array = as_grid(grid, 2)
    begin = _cell("start", start, array)
    end = _cell("goal", goal, array)
    rule = rule_of(movement)
    path, straight, diagonal, iterations = solve_one(
        array, *begin, *end, search, rule, _scratch_memory(array, rule)
    )
    if iterations == 0:  # every search expands its start
        raise ValueError(_complaint(array, begin, end))
    cost = straight + diagonal * movement.diagonal_cost
    return SearchResult(path, cost, iterations)


class _Kept(threading.local):
    """What each thread keeps: kernels run without the GIL, so that threads cannot share it."""

    memory = np.empty(0, np.uint8)


_kept = _Kept()


def _scratch_memory(grid: Bytes, rule: Rule) -> Bytes:
    """Return room for any search on ``grid``, this thread's own until its next call."""
    rows, columns = grid.shape[-2:]
    # As `scratch` reckons: 9 bytes a cell of the lattice, and 16 for each of its 4 or 8 pushes.
    needed = (137 if rule[0] else 73) * (rows + 2) * (columns + 2) + 32
    memory = _kept.memory
    if needed > len(memory):
        memory = np.empty(needed, np.uint8)
        if needed <= KEPT_BYTES:
            _kept.memory = memory
    return memory


def as_grid(grid: ArrayLike, rank: int) -> Bytes:
    """Return ``grid`` as what the kernels are compiled for: writable, contiguous uint8."""
    try:
        array = np.asarray(grid)
    except ValueError as error:
        raise ValueError(f"grid: {error}") from None
    shape = array.shape
    if len(shape) != rank or shape[-2] == 0 or shape[-1] == 0:
        raise ValueError(
            f"grid: got shape {shape}, expected {'(H, W)' if rank == 2 else '(B, H, W)'} not empty"
        )
    if shape[-2] * shape[-1] > MAX_CELLS:
        raise ValueError(f"grid: got {_size(array)} cells, expected at most {MAX_CELLS} in all")
    if array.dtype != _UINT8:
        array = _as_bytes(array)
    if not array.flags.carray:
        array = np.array(array, order="C")
    return array


def _as_bytes(array: Array) -> Bytes:
    """Return an array of bool, integers or floats, each 0 or 1, as uint8."""
    if array.dtype == np.bool_:
        return array.view(np.uint8)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"grid: got dtype {array.dtype}, expected 0 free and 1 occupied, or bool")
    wide = np.int64 if array.dtype.kind in "iu" else np.float64
    # contiguous, aligned, writable: one flavour each
    values = np.require(array, wide, ["C", "A", "W"])
    narrowed = np.empty(array.shape, np.uint8)
    if not narrow(values.reshape(-1), narrowed.reshape(-1)):
        raise ValueError(values_complaint(array))
    return narrowed


def _cell(name: str, cell: Any, grid: Bytes) -> tuple[int, int]:
    """Return ``cell`` as two ints inside ``grid``."""
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


def _whole(name: str, cells: ArrayLike) -> Ints:
    """Return ``cells`` as what the kernels are compiled for: writable, contiguous (n, 2) int64."""
    array = np.asarray(cells)
    if array.size == 0 and array.ndim <= 2:
        return np.empty((0, 2), np.int64)
    if array.ndim != 2 or array.shape[1] != 2 or array.dtype.kind not in "iu":
        raise ValueError(
            f"{name}: got shape {array.shape} of {array.dtype}, expected (n, 2) integer cells "
            "(row, col)"
        )
    whole = array.astype(np.int64, copy=False)
    return whole if whole.flags.carray else whole.copy()


def _complaint(grid: Bytes, start: Cell, goal: Cell) -> str:
    """Return why a problem was refused."""
    if np.any(grid > 1):
        return values_complaint(grid)
    why = why_not_free(grid, start)
    return f"start: {why}" if why else f"goal: {why_not_free(grid, goal)}"


def why_not_free(grid: Bytes, cell: Cell) -> str:
    """Return why ``cell`` cannot be on a path, or nothing."""
    row, column = cell
    if not (0 <= row < grid.shape[0] and 0 <= column < grid.shape[1]):
        return f"({row}, {column}) is outside the map of {_size(grid)} cells"
    return f"({row}, {column}) is on an occupied cell" if grid[row, column] else ""


def values_complaint(grid: Array) -> str:
    """Return what is wrong with a grid that holds other values than 0 and 1."""
    other = grid[(grid != 0) & (grid != 1)][0]
    return f"grid: got the value {other}, expected 0 free and 1 occupied only"


def _size(grid: Array) -> str:
    return f"{grid.shape[-2]} x {grid.shape[-1]}"
