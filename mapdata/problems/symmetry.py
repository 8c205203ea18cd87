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
    """Return the grids (B, H, W) after their symmetries; only square ones may be transposed."""
    transformed = np.empty_like(grids)
    rows, columns = grids.shape[1:]
    for b in range(len(grids)):
        cells = grids[b].reshape(-1)
        out = transformed[b].reshape(-1)
        for line in range(rows):
            # A row, or a column where these change places (of square maps), becomes a row.
            if codes[b] & 4:
                first = line
                step = columns
                row, column = transform_cell(0, line, rows, columns, codes[b])
            else:
                first = line * columns
                step = 1
                row, column = transform_cell(line, 0, rows, columns, codes[b])
            to = row * columns + column
            # Forwards or backwards: two loops, each with vector instructions.
            if column == 0:
                for k in range(columns):
                    out[np.uint64(to + k)] = cells[np.uint64(first + k * step)]
            else:
                for k in range(columns):
                    out[np.uint64(to - k)] = cells[np.uint64(first + k * step)]
    return transformed


@kernel
def transform_cells(cells: Ints, codes: Ints, rows: Int, columns: Int) -> Ints:
    """Return cells (M, 2) after their symmetries, (M,); (-1, -1) stays what it is."""
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
    """Return one cell after a symmetry."""
    if code & 1:
        row = rows - 1 - row
    if code & 2:
        column = columns - 1 - column
    return (column, row) if code & 4 else (row, column)
