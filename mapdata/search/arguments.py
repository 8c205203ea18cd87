"""The checks of what users pass to searches: grids, terrain, cells and whole problems.

Each function here returns an argument in the form that kernels expect, or raises a ValueError that
says what was found, what was expected and what to change.
"""

from __future__ import annotations

from operator import index
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from mapdata.arrays import Array, Bytes, Ints
from mapdata.hints import hint_on_values
from mapdata.limits import MAX_CELL_COST
from mapdata.search.kernels import copy_to_bytes
from mapdata.search.lattice import MAX_CELLS

Cell: TypeAlias = "tuple[int, int] | Ints"

_UINT8 = np.dtype(np.uint8)
"""Comparing a dtype with this takes half the time of comparing it with the class `numpy.uint8`."""

# --- maps ---------------------------------------------------------------------------------------


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


def as_optional_terrain(terrain: ArrayLike | None, grid: Bytes) -> Bytes | None:
    """Return terrain as `as_terrain` does, in the shape of ``grid``; None where there is none.

    Terrain (H, W) fits ``grid``, (1, H, W), too.

    Raises:
        ValueError: what `as_terrain` refuses.
    """
    if terrain is None:
        return None
    if grid.ndim == 3 and np.ndim(terrain) == 2:
        terrain = np.asarray(terrain)[None]
    return as_terrain(terrain, grid)


# --- cells and problems ----------------------------------------------------------------------


def as_cell(name: str, cell: Any, grid: Bytes) -> tuple[int, int]:
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


def as_cells(name: str, cells: ArrayLike) -> Ints:
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


def as_problems(grids: ArrayLike, starts: ArrayLike, goals: ArrayLike) -> tuple[Bytes, Ints, Ints]:
    """Return B problems as the kernels expect them: (B or 1, H, W), (B, 2) and (B, 2).

    Raises:
        ValueError: a grid that `as_grid` refuses, other cells than (B, 2), or unequal numbers.
    """
    array = np.asarray(grids)
    grid_stack = as_grid(array if array.ndim == 3 else array[None], 3)
    start_cells = as_cells("starts", starts)
    goal_cells = as_cells("goals", goals)
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
    """Return B problems as `as_problems` does, for kernels that do not check them.

    Raises:
        ValueError: what `search_batch` refuses.
    """
    grid_stack, start_cells, goal_cells = as_problems(grids, starts, goals)
    if grid_stack.max(initial=0) > 1:
        raise ValueError(values_complaint(grid_stack))
    are_free = np.ones(len(start_cells), bool)
    map_numbers = np.arange(len(start_cells)) % len(grid_stack)  # all are 0 on a shared map
    for cells in (start_cells, goal_cells):
        is_inside = np.all((cells >= 0) & (cells < grid_stack.shape[1:]), axis=1)
        row, column = np.where(is_inside[:, None], cells, 0).T
        are_free &= is_inside & (grid_stack[map_numbers, row, column] == 0)
    if not are_free.all():
        k = int(are_free.argmin())
        complaint = problem_complaint(grid_stack[map_numbers[k]], start_cells[k], goal_cells[k])
        raise ValueError(f"problem {k}: {complaint}")
    return grid_stack, start_cells, goal_cells


# --- sentences ----------------------------------------------------------------------------------


def problem_complaint(grid: Bytes, start: Cell, goal: Cell) -> str:
    """Return why a problem is refused: for the grid, for the start, or else for the goal."""
    if np.any(grid > 1):
        return values_complaint(grid)
    name, cell = ("start", start) if why_not_free(grid, start) else ("goal", goal)
    return f"{name}: {why_not_free(grid, cell)}{nearest_free_cell(grid, cell)}"


def nearest_free_cell(grid: Bytes, cell: Cell) -> str:
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


def _size(grid: Array) -> str:
    """Return the size of a grid, or of each grid of a stack, as text."""
    return f"{grid.shape[-2]} x {grid.shape[-1]}"
