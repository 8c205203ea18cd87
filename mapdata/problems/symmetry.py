"""The symmetries of a map, 8 of a square and 4 of a rectangle, and what they do to cells."""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.jit import Int, kernel
from mapdata.rng import AUGMENTATION, block, bounded


@kernel
def sample_symmetries(seed: np.uint64, epoch: Int, indices: Ints, square: Int) -> Ints:
    """Return (B,) codes of symmetries, drawn anew each epoch.

    Bit 0 flips rows, bit 1 flips columns, bit 2 (only of square maps) transposes after that.
    """
    codes = np.empty(len(indices), np.int64)
    for b in range(len(indices)):
        word, _, _, _ = block(seed, np.uint64(indices[b]), epoch, AUGMENTATION, 0)
        codes[b] = bounded(word, 0, 7 if square else 3)
    return codes


@kernel
def transform_grids(grids: Bytes, codes: Ints) -> Bytes:
    """Return the grids (B, H, W) after their symmetries."""
    transformed = np.empty_like(grids)
    rows, columns = grids.shape[1:]
    for b in range(len(grids)):
        for row in range(rows):
            for column in range(columns):
                to = transform_cell(row, column, rows, columns, codes[b])
                transformed[b, to[0], to[1]] = grids[b, row, column]
    return transformed


@kernel
def transform_cells(cells: Ints, codes: Ints, rows: Int, columns: Int) -> Ints:
    """Return cells (M, 2) after their symmetries, (M,); (-1, -1) stays what it is."""
    transformed = np.empty_like(cells)
    for k in range(len(cells)):
        row, column = cells[k]
        if row >= 0:
            row, column = transform_cell(row, column, rows, columns, codes[k])
        transformed[k, 0] = row
        transformed[k, 1] = column
    return transformed


@kernel
def transform_cell(row: Int, column: Int, rows: Int, columns: Int, code: Int) -> tuple[Int, Int]:
    """Return one cell after a symmetry."""
    if code & 1:
        row = rows - 1 - row
    if code & 2:
        column = columns - 1 - column
    return (column, row) if code & 4 else (row, column)
