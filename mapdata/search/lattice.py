"""The lattice that searches run on: the padded grid, its moves, exact costs, the heuristic.

A grid is a flat array with a wall around it, so that no step needs a bounds check: cell (row, col)
of a map with W columns stands at ``(row + 1) * (W + 2) + col + 1``.

Costs are integers in fixed point. A cost of s straight and d diagonal steps is ``s * UNIT + d *
DIAGONAL``, where DIAGONAL is sqrt(2) * UNIT rounded, so sums are exact, in any order. Two such
costs below `LONGEST` compare as the real numbers s + d * sqrt(2) do: a test tries every difference
in d that they can have. A kernel that meets a longer path raises an error; a grid of 4096 x 4096
cells can have one, of 8 million cells at most, but only if it is drawn for it. (s, d) can be read
back from a cost: modulo UNIT it is d * DIAGONAL, and DIAGONAL, being odd, has an inverse modulo
UNIT, a power of two.

The legal moves, the heuristic and hardness are defined here. The corner rule is written five times
more, each for a reason that is given there: `flood`, `first_bad_cell` and `shortest_costs` in
kernels.py, on tensors `legal_moves` in models/geometry.py, and in models/learned_planners.py, whose
search works on rows and columns to be read without this module; tests hold all six together.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from mapdata.arrays import Bytes, Floats, Ints
from mapdata.jit import Int, inlined, kernel
from mapdata.movement import STEPS, Movement

MAX_CELLS = 2**24
"""Largest number of cells of a grid: 4096 x 4096."""

LONGEST = 2**21
"""Cost, in cells, that a path must stay below: up to here costs order paths exactly, and fit int64.

A* under 4-connectivity and BFS count moves, and have no such bound.
"""

UNIT_BITS = 41

UNIT = 1 << UNIT_BITS
"""The cost of a straight step."""

DIAGONAL = 3109888511975
"""sqrt(2) * UNIT, rounded; an odd integer."""

_DIAGONAL_INVERSE = pow(DIAGONAL, -1, UNIT)

WALL = np.uint8(255)
"""An occupied cell, or one of the wall around the grid. Differs from UNSEEN in the lowest bit."""

UNSEEN = np.uint8(254)
"""A free cell that the search has not reached."""

ROOT = np.uint8(253)
"""Where a breadth-first search began."""

CLOSED = np.uint8(8)
"""The bit that A* adds to a cell's move, 0 to 7, when it expands the cell."""

FAR = np.int64((LONGEST + 4) * UNIT)
"""The cost of a cell that is not reached: more than any path costs that is not refused."""

Weights: TypeAlias = tuple[Int, float]
"""Which search, as kernels take it: the weights in f = g_weight * g + h_weight * h.

A plain tuple, like `Rule`: a NamedTuple costs 2 us a call from Python, a third of a short search.
"""

ASTAR: Weights = (1, 1.0)

BFS: Weights = (-1, 0.0)
"""Breadth-first search. It has no f: the numbers only tell it from the others."""

Rule: TypeAlias = tuple[Int, Int]
"""How one moves, as kernels take it: ``diagonals`` and ``step`` of a `Lattice`."""


def rule_of(movement: Movement) -> Rule:
    """Return ``movement`` as kernels take it."""
    if not isinstance(movement, Movement):
        raise ValueError(f"movement: got {movement!r}, expected a Movement")
    if movement.connectivity == 4:
        return 0, UNIT
    diagonals = 2 if movement.corner_cutting else 1
    step = UNIT if movement.diagonal_cost == 1 else DIAGONAL
    return diagonals, step


class Lattice(NamedTuple):
    """The padded cells of one map size, and how one moves on them.

    Attributes:
        stride: cells from a row to the next one.
        cells: number of cells, those of the wall included.
        offsets: (4,) or (8,) int64, what each move adds to a cell.
        diagonals: 0 none, 1 only beside two free cells, 2 unrestricted.
        step: cost of a diagonal move, in 1 / UNIT.
    """

    stride: Int
    cells: Int
    offsets: Ints
    diagonals: Int
    step: Int


def plain_lattice(shape: tuple[Int, Int], rule: Rule) -> Lattice:
    """Return the lattice of maps of ``shape`` (rows, columns)."""
    diagonals, step = rule
    stride = shape[1] + 2
    offsets = np.empty(8 if diagonals else 4, np.int64)
    for move in range(len(offsets)):
        offsets[move] = STEPS[move, 0] * stride + STEPS[move, 1]
    return Lattice(stride, (shape[0] + 2) * stride, offsets, diagonals, step)


lattice_of = kernel(plain_lattice)
"""The same for kernels; `plain_lattice` needs no compiling."""


@inlined
def cell_at(row: Int, column: Int, lattice: Lattice) -> Int:
    """Return the padded cell of (row, column)."""
    return (row + 1) * lattice.stride + column + 1


@inlined
def cells_of(points: Ints, lattice: Lattice) -> Ints:
    """Return the padded cells of points (n, 2)."""
    cells = np.empty(len(points), np.int64)
    for k in range(len(points)):
        cells[k] = cell_at(points[k, 0], points[k, 1], lattice)
    return cells


@inlined
def position(cell: Int, lattice: Lattice) -> tuple[Int, Int]:
    """Return (row, column) of a padded cell."""
    # 32 bits hold every cell, and are divided faster than 64.
    row = np.int64(np.uint32(cell) // np.uint32(lattice.stride))
    return row - 1, cell - row * lattice.stride - 1


_ROW_PART = np.array([0, 1, 2, 3, 0, 2, 2, 0])
"""The vertical half of each diagonal move: N of NE, S of SE, and so on."""

_COLUMN_PART = np.array([0, 1, 2, 3, 1, 1, 3, 3])
"""The horizontal half."""


@inlined
def is_legal(came: Bytes, cell: Int, move: Int, lattice: Lattice) -> Int:
    """Tell whether ``move`` leads from ``cell`` to a free one and cuts no forbidden corner."""
    if came[cell + lattice.offsets[move]] == WALL:
        return False
    if move < 4 or lattice.diagonals == 2:
        return True
    beside = came[cell + lattice.offsets[_ROW_PART[move]]]
    return beside != WALL and came[cell + lattice.offsets[_COLUMN_PART[move]]] != WALL


@inlined
def heuristic(rows: Int, columns: Int, lattice: Lattice) -> Int:
    """Return the cost of (rows, columns) on an empty map: Manhattan, octile or Chebyshev."""
    rows = abs(rows)
    columns = abs(columns)
    if lattice.diagonals == 0:
        return (rows + columns) * UNIT
    return abs(rows - columns) * UNIT + min(rows, columns) * lattice.step


@kernel
def _heuristics(gaps: Ints, rule: Rule) -> Floats:
    lattice = lattice_of((0, 0), rule)
    found = np.empty(len(gaps))
    for k in range(len(gaps)):
        found[k] = in_cells(heuristic(gaps[k, 0], gaps[k, 1], lattice))
    return found


def heuristics(starts: ArrayLike, goals: ArrayLike, movement: Movement) -> Floats:
    """Return the heuristic from ``starts`` to ``goals``, (..., 2), as (...) float64 in cells."""
    # A new array of one dtype and layout: the kernel is compiled once.
    gaps = np.subtract(starts, goals, dtype=np.int64, order="C")
    return _heuristics(gaps.reshape(-1, 2), rule_of(movement)).reshape(gaps.shape[:-1])


HARD = 1.05
"""Hardness from which on a problem is hard."""


def hardness(costs: Floats, starts: Ints, goals: Ints, movement: Movement) -> Floats:
    """Return optimal ``costs`` (n,) over the heuristic.

    1 from a cell to itself, -1 where the cost is -1; exactly 1, not 1 - 1e-16, where a shortest
    path is as long as on an empty map.
    """
    least = heuristics(starts, goals, movement)
    ratio = np.where(least > 0, costs / np.maximum(least, 1), 1.0)
    return np.where(costs < 0, -1.0, ratio)


@inlined
def is_binary(grid: Bytes) -> Int:
    """Return whether all of ``grid`` is 0 or 1."""
    seen = np.uint8(0)
    for value in grid.flat:
        # One byte wide, which numba would widen to eight: so a vector instruction does 64 at once.
        seen = np.uint8(seen | value)
    return seen <= 1


@kernel
def load(grid: Bytes, came: Bytes) -> Int:
    """Copy ``grid`` into the padded ``came`` as UNSEEN and WALL, with the wall around it.

    Returns whether all of it is 0 or 1.
    """
    rows, columns = grid.shape
    stride = columns + 2
    for k in range(stride):
        came[k] = WALL
        came[(rows + 1) * stride + k] = WALL
    for row in range(rows):
        first = np.uint64((row + 1) * stride + 1)
        came[first - np.uint64(1)] = WALL
        for k in range(columns):
            column = np.uint64(k)
            came[first + column] = UNSEEN | grid[row, column]  # 1: WALL
        came[first + np.uint64(columns)] = WALL
    return is_binary(grid)


@kernel
def parts(cost: Int) -> tuple[Int, Int]:
    """Return the straight and diagonal steps of a cost ``s * UNIT + d * DIAGONAL``."""
    low_bits = np.uint64(UNIT - 1)
    rest = np.uint64(cost) & low_bits  # d * DIAGONAL modulo UNIT
    diagonal = np.int64((rest * np.uint64(_DIAGONAL_INVERSE)) & low_bits)
    straight = (cost - diagonal * DIAGONAL) >> UNIT_BITS
    return straight, diagonal


@kernel
def in_cells(cost: Int) -> Int:
    """Return a cost as a float: ``s + d * sqrt(2)``."""
    straight, diagonal = parts(cost)
    return straight + diagonal * math.sqrt(2.0)
