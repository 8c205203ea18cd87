"""The lattice that searches run on: a padded grid, its moves, the corner rule, exact costs, the heuristic.

A grid is a flat array with a wall around it, so that no step needs a bounds check: cell (row, col) of a map with W
columns stands at ``(row + 1) * (W + 2) + col + 1``.
"""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Bytes
from mapdata.jit import Int, inlined, kernel
from mapdata.spec import Movement

MAX_CELLS = 2**21
"""Largest number of cells of a grid. Up to here the fixed-point costs below order all paths exactly."""

UNIT_BITS = 41

UNIT = 1 << UNIT_BITS

DIAGONAL = 3109888511975
"""sqrt(2) * UNIT, an odd integer. A cost of s straight and d diagonal steps is ``s * UNIT + d * DIAGONAL``: sums are
exact, and two costs compare as ``s + d * sqrt(2)`` does, since those differ by at least 1 / (2 sqrt(2) d) and the
error is below d / 2**42. DIAGONAL being odd, (s, d) can be read back from the sum."""

_DIAGONAL_INVERSE = pow(DIAGONAL, -1, UNIT)

BFS, ASTAR = 0, 1
"""Codes of the planners."""

STEPS = np.array([(-1, 0), (0, 1), (1, 0), (0, -1), (-1, 1), (1, 1), (1, -1), (-1, -1)], np.int64)
"""(8, 2): the moves N, E, S, W, NE, SE, SW, NW as (row, col); the number of a move is its code everywhere."""

WALL, UNSEEN, ROOT = np.uint8(255), np.uint8(254), np.uint8(253)

CLOSED = np.uint8(8)

FAR = np.int64(2**62)

_ONE = np.uint64(1)


def rule_of(movement: Movement) -> tuple[int, int]:
    """Return ``movement`` as the kernels want it: ``diagonals`` and ``step``.

    ``diagonals``: 0 none, 1 only beside two free cells, 2 unrestricted. ``step``: cost of a diagonal step, in 1 / UNIT.
    """
    if not isinstance(movement, Movement):
        raise ValueError(f"movement: got {movement!r}, expected a Movement")
    diagonals = 0 if movement.connectivity == 4 else 2 if movement.corner_cutting else 1
    return diagonals, UNIT if movement.diagonal_cost == 1 else DIAGONAL


@inlined
def estimate(rows: Int, columns: Int, diagonals: Int, step: Int) -> Int:
    """Return the cost of the shortest path on an empty grid: Manhattan, octile, or Chebyshev when step is UNIT."""
    rows, columns = abs(rows), abs(columns)
    if diagonals == 0:
        return (rows + columns) * UNIT
    return abs(rows - columns) * UNIT + min(rows, columns) * step


_ROW_PART = np.array([0, 1, 2, 3, 0, 2, 2, 0])

_COLUMN_PART = np.array([0, 1, 2, 3, 1, 1, 3, 3])


@kernel
def load(grid: Bytes, came: Bytes) -> Int:
    """Copy ``grid`` into the padded ``came`` as UNSEEN and WALL; return whether all of it is 0 or 1."""
    rows, columns = grid.shape
    flat, seen = grid.reshape(-1), np.uint8(0)
    for k in range(len(flat)):  # a loop of its own: both become vector instructions
        seen |= flat[np.uint64(k)]
    for row in range(rows):
        base, first = np.uint64((row + 1) * (columns + 2) + 1), np.uint64(row * columns)
        for column in range(columns):
            came[base + np.uint64(column)] = UNSEEN | flat[first + np.uint64(column)]
    return seen <= 1


@kernel
def parts(cost: Int) -> tuple[Int, Int]:
    """Return the straight and diagonal steps of a cost ``s * UNIT + d * DIAGONAL``."""
    low = np.uint64(UNIT - 1)
    diagonal = np.int64(((np.uint64(cost) & low) * np.uint64(_DIAGONAL_INVERSE)) & low)
    return (cost - diagonal * DIAGONAL) >> UNIT_BITS, diagonal
