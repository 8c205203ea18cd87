"""Seed points of maps that have none of their own: cells drawn among given ones (stream 5 of docs/format.md)."""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.jit import Int, kernel
from mapdata.rng import IMPORT, block, bounded


@kernel
def largest_component(grid: Bytes, diagonals: Int) -> Ints:
    """Return the free cells of the largest component of ``grid``, (H, W), as row * W + column in row-major order; of
    equally large ones that which holds the first cell.

    ``diagonals`` is as in `kernels.rule_of`; diagonal steps beside two free cells join nothing that
    straight ones do not.
    """
    rows, columns = grid.shape
    owner = np.zeros(rows * columns, np.int32)
    stack = np.empty(rows * columns, np.int64)
    best, most, number = 0, 0, 0
    for first in range(rows * columns):
        if grid[first // columns, first % columns] != 0 or owner[first] != 0:
            continue
        number += 1
        owner[first], stack[0] = number, first
        height, size = 1, 0
        while height:
            height -= 1
            size += 1
            row, column = stack[height] // columns, stack[height] % columns
            for down in range(-1, 2):
                for right in range(-1, 2):
                    r, c = row + down, column + right
                    if down != 0 and right != 0 and diagonals != 2:
                        continue
                    if 0 <= r < rows and 0 <= c < columns and grid[r, c] == 0 and owner[r * columns + c] == 0:
                        owner[r * columns + c], stack[height] = number, r * columns + c
                        height += 1
        if size > most:
            best, most = number, size
    cells, k = np.empty(most, np.int64), 0
    for cell in range(rows * columns):
        if most and owner[cell] == best:
            cells[k] = cell
            k += 1
    return cells


@kernel
def draw_points(cells: Ints, seed: np.uint64, index: np.uint64, count: Int) -> Ints:
    """Return ``count`` of ``cells``, none twice: draw k is one of those left, in their order."""
    left, drawn = cells.copy(), np.empty(count, np.int64)
    for k in range(count):
        w0, _w1, _w2, _w3 = block(seed, index, 0, IMPORT, k)
        j = bounded(w0, 0, len(cells) - 1 - k)
        drawn[k] = left[j]
        for m in range(j, len(cells) - 1 - k):
            left[m] = left[m + 1]
    return drawn
