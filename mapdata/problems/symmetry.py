"""The symmetries of maps: 8 of a square, 4 of a rectangle.

A symmetry is a code of three bits. Bit 0 reverses the order of the rows and bit 1 that of the
columns; bit 2 transposes afterwards, which only square maps allow.
"""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.jit import Int, kernel
from mapdata.rng import AUGMENTATION, block, bounded


@kernel
def sample_symmetries(seed: np.uint64, epoch: Int, indices: Ints, is_square: Int) -> Ints:
    """Return the code of a random symmetry for each of the problems ``indices``, (B,).

    They are drawn anew in each epoch.
    """
    codes = np.empty(len(indices), np.int64)
    max_code = 7 if is_square else 3
    for b in range(len(indices)):
        word, _, _, _ = block(seed, np.uint64(indices[b]), epoch, AUGMENTATION, 0)
        codes[b] = bounded(word, 0, max_code)
    return codes


@kernel
def transform_grids(grids: Bytes, codes: Ints) -> Bytes:
    """Return the grids, (B, H, W), after the symmetries ``codes``, (B,)."""
    transformed = np.empty_like(grids)
    rows, columns = grids.shape[1:]
    for b in range(len(grids)):
        cells = grids[b].reshape(-1)
        new_cells = transformed[b].reshape(-1)
        # Each line of the grid becomes a row: its rows, or under a transposition its columns, of
        # which a square map has as many.
        for line in range(rows):
            if codes[b] & 4:
                source = line
                step = columns
                new_row, new_column = transform_cell(0, line, rows, columns, codes[b])
            else:
                source = line * columns
                step = 1
                new_row, new_column = transform_cell(line, 0, rows, columns, codes[b])
            target = new_row * columns + new_column
            # The row is filled forwards or backwards, by two loops, since numba makes vector
            # instructions only where it knows the direction.
            if new_column == 0:
                for k in range(columns):
                    new_cells[np.uint64(target + k)] = cells[np.uint64(source + k * step)]
            else:
                for k in range(columns):
                    new_cells[np.uint64(target - k)] = cells[np.uint64(source + k * step)]
    return transformed


@kernel
def transform_cells(cells: Ints, codes: Ints, rows: Int, columns: Int) -> Ints:
    """Return cells, (M, 2), after the symmetries ``codes``, (M,); (-1, -1) stays the same."""
    transformed = np.empty_like(cells)
    for k in range(len(cells)):
        row = cells[k, 0]
        column = cells[k, 1]
        if row >= 0:
            row, column = transform_cell(row, column, rows, columns, codes[k])
        transformed[k, 0] = row
        transformed[k, 1] = column
    return transformed


@kernel
def transform_cell(row: Int, column: Int, rows: Int, columns: Int, code: Int) -> tuple[Int, Int]:
    """Return the (row, column) of a cell after a symmetry of a map of ``rows`` x ``columns``."""
    if code & 1:
        row = rows - 1 - row
    if code & 2:
        column = columns - 1 - column
    return (column, row) if code & 4 else (row, column)
