"""The lattice that searches run on: padded cells, legal moves, exact costs and the heuristic.

A grid is stored as a flat array with a wall around it, so that no move needs a bounds check. In a
map with W columns, cell (row, col) has the index ``(row + 1) * (W + 2) + col + 1`` in that array;
this index is called its padded cell.

Costs are integers in fixed point. A path of s straight and d diagonal moves costs ``s * UNIT + d *
DIAGONAL``, where DIAGONAL is sqrt(2) * UNIT rounded, so sums are exact in any order. Two such costs
below `MAX_PATH_COST` cells compare as the real numbers s + d * sqrt(2) do: a test tries every
difference in d that they can have. A kernel that meets a longer path raises an error. A grid of
4096 x 4096 cells can have such a path, of 8 million cells at most, but only if it is drawn for that
purpose. The counts (s, d) can be read back from a cost: modulo UNIT, the cost is d * DIAGONAL, and
DIAGONAL, being odd, has an inverse modulo UNIT, which is a power of two.

A `Movement` takes two forms on its way into the kernels. Public functions turn it into a `MoveRule`
once, by `move_rule`. The rule and the size of a map make the `Lattice`. Kernels for many problems
get it from Python (`mapdata.search.kernels.search_memory`). A kernel for one problem makes it by
`lattice_of`, because passing it takes as long as a part of a short search. All kernels below these
take the lattice alone.

The legal moves, the heuristic and hardness are defined here. The corner rule is written again where
a loop needs it in another form, and each copy states its reason: `flood`, `first_bad_cell`,
`best_first_buckets` and `shortest_costs` in kernels.py; `shortest_terrain_costs` in terrain.py; the
table of kept moves in jump_points.py; the ray to the goal in bit_jumps.py; the moves by costs in
datasets/field_kernels.py; on tensors, `legal_moves` in models/pretrained/geometry.py; and order.py
and predicted_moves.py, whose searches work on rows and columns so that they can be read without
this module. Tests compare all of them with the slow reference.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from mapdata.arrays import Bytes, Floats, Ints
from mapdata.jit import Int, inlined, kernel
from mapdata.movement import STEPS, Movement, check_movement

MAX_CELLS = 2**24
"""Largest number of cells of a grid: 4096 x 4096."""

MAX_PATH_COST = 2**21
"""Cost, in cells, that a path must stay below.

Up to this bound costs order paths exactly and fit int64. A* under 4-connectivity and BFS count
moves and have no such bound.
"""

UNIT_BITS = 41

UNIT = 1 << UNIT_BITS
"""The cost of a straight move."""

DIAGONAL = 3109888511975
"""sqrt(2) * UNIT, rounded; an odd integer."""

_DIAGONAL_INVERSE = pow(DIAGONAL, -1, UNIT)

WALL = np.uint8(255)
"""State of an occupied cell or of the wall around the grid: UNSEEN with the lowest bit set."""

UNSEEN = np.uint8(254)
"""State of a free cell that the search has not reached."""

ROOT = np.uint8(253)
"""State of the cell where a breadth-first search began."""

CLOSED = np.uint8(8)
"""The bit that A* adds to a cell's state, a move from 0 to 7, when it expands the cell."""

_MAX_MOVE_COST = 722
"""A diagonal move between two cells of cost 255 has the doubled cost 510 * sqrt(2) = 721.2."""

INFINITY = np.int64((MAX_PATH_COST + _MAX_MOVE_COST) * UNIT)
"""The cost of a cell that no path reaches: more than any path costs that is not refused.

On terrain, a cell behind the bound still gets a smaller cost, because only cells before the bound
are expanded. So it is not mistaken for a cell without a path.
"""

NO_DIAGONALS = 0
"""Value of ``diagonals`` under 4-connectivity."""

NO_CORNER_CUTTING = 1
"""Value of ``diagonals`` where a diagonal move needs both orthogonal neighbours to be free."""

CORNER_CUTTING = 2
"""Value of ``diagonals`` where diagonal moves may pass between or beside occupied cells."""

CostWeights: TypeAlias = tuple[Int, float] | None
"""The weights (g_weight, h_weight) of a best-first search: f = g_weight * g + h_weight * h.

Like `MoveRule` it is a plain tuple: to pass a NamedTuple from Python to a kernel costs 2 us a call,
a third of a short search.
"""

ASTAR: CostWeights = None
"""Stands for A*, whose weights are both 1.

None has a type of its own, so numba leaves all other searches out of a kernel that is called with
it. To compile them takes seconds, and most callers need none of them.
"""

BFS: CostWeights = (-1, 0.0)
"""Stands for breadth-first search, which has no f; kernels only compare it with other weights."""

MoveRule: TypeAlias = tuple[Int, Int]
"""A `Movement` as kernels take it: (diagonals, diagonal_cost), two fields of a `Lattice`."""


def move_rule(movement: Movement) -> MoveRule:
    """Return ``movement`` as kernels take it.

    Raises:
        ValueError: ``movement`` is not a `Movement`.
    """
    check_movement(movement)
    if movement.connectivity == 4:
        return NO_DIAGONALS, UNIT
    diagonals = CORNER_CUTTING if movement.corner_cutting else NO_CORNER_CUTTING
    diagonal_cost = UNIT if movement.diagonal_cost == 1 else DIAGONAL
    return diagonals, diagonal_cost


def diagonal_moves(rule: MoveRule) -> int | None:
    """Return the first number of a rule, or None under 4 neighbours.

    With None, numba leaves the search for maps with diagonal moves out of a kernel.
    """
    diagonals, _ = rule
    return None if diagonals == NO_DIAGONALS else diagonals


class Lattice(NamedTuple):
    """The padded cells of one map size and the moves between them.

    Attributes:
        stride: difference between a cell and the one below it: columns of the map plus 2.
        cells: number of padded cells, those of the wall included.
        offsets: (4,) or (8,) int64, what each move adds to a padded cell, in the order of `STEPS`.
        diagonals: `NO_DIAGONALS`, `NO_CORNER_CUTTING` or `CORNER_CUTTING`.
        diagonal_cost: cost of a diagonal move, in 1 / UNIT.
    """

    stride: Int
    cells: Int
    offsets: Ints
    diagonals: Int
    diagonal_cost: Int


def plain_lattice(shape: tuple[Int, Int], rule: MoveRule) -> Lattice:
    """Return the lattice of maps of ``shape`` (rows, columns), without compiling a kernel."""
    diagonals, diagonal_cost = rule
    rows, columns = shape
    stride = columns + 2
    offsets = np.empty(8 if diagonals else 4, np.int64)
    for move in range(len(offsets)):
        offsets[move] = STEPS[move, 0] * stride + STEPS[move, 1]
    return Lattice(stride, (rows + 2) * stride, offsets, diagonals, diagonal_cost)


lattice_of = kernel(plain_lattice)
"""`plain_lattice` as a kernel, for the kernels that Python calls."""


@inlined
def cell_at(row: Int, column: Int, lattice: Lattice) -> Int:
    """Return the padded cell of (row, column)."""
    return (row + 1) * lattice.stride + column + 1


@kernel
def cell_or_wall(row: Int, column: Int, rows: Int, columns: Int) -> Int:
    """Return the padded cell of (row, column), or cell 0, which is a wall, if it is not inside.

    The map has so many ``rows`` and ``columns``.
    """
    if 0 <= row < rows and 0 <= column < columns:
        return (row + 1) * (columns + 2) + column + 1  # as `cell_at` computes it
    return 0


@inlined
def only(cell: Int) -> Ints:
    """Return one padded cell as an array (1,), which compiles in less time than `np.full`."""
    cells = np.empty(1, np.int64)
    cells[0] = cell
    return cells


@inlined
def cells_of(points: Ints, lattice: Lattice) -> Ints:
    """Return the padded cells (n,) of the points (row, column), an array (n, 2)."""
    cells = np.empty(len(points), np.int64)
    for k in range(len(points)):
        cells[k] = cell_at(points[k, 0], points[k, 1], lattice)
    return cells


@inlined
def position(cell: Int, lattice: Lattice) -> tuple[Int, Int]:
    """Return (row, column) of a padded cell."""
    # Every cell fits into 32 bits, whose division is faster than that of 64 bits.
    padded_row = np.int64(np.uint32(cell) // np.uint32(lattice.stride))
    return padded_row - 1, cell - padded_row * lattice.stride - 1


_ROW_PART = np.array([0, 1, 2, 3, 0, 2, 2, 0])
"""The vertical part of each diagonal move, as a straight move: N of NE, S of SE, and so on."""

_COLUMN_PART = np.array([0, 1, 2, 3, 1, 1, 3, 3])
"""The horizontal part of each diagonal move, as a straight move: E of NE, E of SE, and so on."""


@inlined
def is_legal(came_from: Bytes, cell: Int, move: Int, lattice: Lattice) -> Int:
    """Return whether ``move`` leads from ``cell`` to a free cell and cuts no forbidden corner.

    Args:
        came_from: (cells,) the states of the padded cells; only which ones are WALL matters.
        cell: padded cell.
        move: index into ``lattice.offsets``.
        lattice: of the map.
    """
    if came_from[cell + lattice.offsets[move]] == WALL:
        return False
    if move < 4 or lattice.diagonals == CORNER_CUTTING:
        return True
    vertical_neighbour = came_from[cell + lattice.offsets[_ROW_PART[move]]]
    if vertical_neighbour == WALL:
        return False
    return came_from[cell + lattice.offsets[_COLUMN_PART[move]]] != WALL


@inlined
def octile(rows: Int, columns: Int, diagonal_cost: Int) -> Int:
    """Return the cost of a move by (rows, columns) on an empty map with diagonal moves."""
    rows = abs(rows)
    columns = abs(columns)
    return abs(rows - columns) * UNIT + min(rows, columns) * diagonal_cost


@inlined
def heuristic(rows: Int, columns: Int, lattice: Lattice) -> Int:
    """Return the cost of a move by (rows, columns) on an empty map, in 1 / UNIT.

    This is the Manhattan distance without diagonals, the octile distance where they cost sqrt(2),
    and the Chebyshev distance where they cost 1.
    """
    rows = abs(rows)
    columns = abs(columns)
    if lattice.diagonals == NO_DIAGONALS:
        return (rows + columns) * UNIT
    return octile(rows, columns, lattice.diagonal_cost)


def heuristics(
    starts: ArrayLike, goals: ArrayLike, movement: Movement, min_costs: ArrayLike | None = None
) -> Floats:
    """Return the heuristic from ``starts`` to ``goals``, (..., 2), as (...) float64 in cells.

    On terrain, ``min_costs`` is the smallest cost of a free cell: an integer, or (...) of them.
    """
    distances: Ints = np.abs(np.subtract(starts, goals, dtype=np.int64))
    rows = distances[..., 0]
    columns = distances[..., 1]
    if movement.connectivity == 4:
        straight, diagonal = rows + columns, np.zeros_like(rows)
    elif movement.diagonal_cost == 1:
        straight, diagonal = np.maximum(rows, columns), np.zeros_like(rows)
    else:
        straight, diagonal = np.abs(rows - columns), np.minimum(rows, columns)
    if min_costs is not None:
        straight = np.multiply(min_costs, straight)
        diagonal = np.multiply(min_costs, diagonal)
    # The counts are multiplied first, so that the cost is rounded only as `in_cells` does.
    return np.asarray(straight + diagonal * math.sqrt(2.0))


HARD = 1.05
"""Smallest hardness of a problem that counts as hard."""


def hardness(
    costs: Floats,
    starts: Ints,
    goals: Ints,
    movement: Movement,
    min_costs: ArrayLike | None = None,
) -> Floats:
    """Return optimal ``costs`` (n,) divided by the heuristic.

    The hardness is 1 from a cell to itself and -1 where the cost is -1. It is exactly 1, not 1 -
    1e-16, where a shortest path is as long as on an empty map. On terrain that is a map whose cells
    all have the smallest cost of a free cell; ``min_costs`` is this cost, an integer or (n,) of
    them. Few paths on terrain are as cheap.
    """
    lower_bounds = heuristics(starts, goals, movement, min_costs)
    # The maximum only avoids a division by 0: between different cells the heuristic is at least 1.
    ratios = np.where(lower_bounds > 0, costs / np.maximum(lower_bounds, 1), 1.0)
    return np.where(costs < 0, -1.0, ratios)


@inlined
def is_binary(grid: Bytes) -> Int:
    """Return whether all cells of ``grid`` are 0 or 1."""
    union = np.uint8(0)
    for cell in grid.flat:
        # numba would widen the union to eight bytes. As one byte, the compiler can use a vector
        # instruction for 64 cells at once.
        union = np.uint8(union | cell)
    return union <= 1


@kernel
def load(grid: Bytes, came_from: Bytes) -> Int:
    """Copy ``grid`` (H, W) into the padded ``came_from`` as UNSEEN and WALL, with its wall.

    Returns whether all cells of ``grid`` are 0 or 1.
    """
    rows, columns = grid.shape
    stride = columns + 2
    for k in range((rows + 2) * stride):
        came_from[np.uint64(k)] = WALL
    union = np.uint8(0)
    for row in range(rows):
        first = np.uint64((row + 1) * stride + 1)
        for k in range(columns):
            column = np.uint64(k)
            cell = grid[row, column]
            # The lowest bit of UNSEEN is 0, and setting it gives WALL.
            came_from[first + column] = UNSEEN | cell
            union = np.uint8(union | cell)  # as in `is_binary`
    return union <= 1


@kernel
def split_cost(cost: Int) -> tuple[Int, Int]:
    """Return the numbers (s, d) of straight and diagonal moves that a cost is made of.

    The cost is ``s * UNIT + d * DIAGONAL``.
    """
    low_bits = np.uint64(UNIT - 1)
    diagonal_part = np.uint64(cost) & low_bits  # d * DIAGONAL modulo UNIT
    diagonal = np.int64((diagonal_part * np.uint64(_DIAGONAL_INVERSE)) & low_bits)
    straight = (cost - diagonal * DIAGONAL) >> UNIT_BITS
    return straight, diagonal


@kernel
def in_cells(cost: Int) -> Int:
    """Return a cost as a float: ``s + d * sqrt(2)``."""
    straight, diagonal = split_cost(cost)
    return straight + diagonal * math.sqrt(2.0)


@inlined
def count_path_cells(straight: Int, diagonal: Int) -> Int:
    """Return how many cells a path of so many moves has, both ends included.

    Kernels report a missing path as -1 straight moves; it has no cells.
    """
    return straight + diagonal + 1 if straight >= 0 else 0
