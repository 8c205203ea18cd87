"""The symmetries of a map, 8 of a square and 4 of a rectangle, and what they do to cells."""

from __future__ import annotations

from typing import Any

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.jit import Int, kernel
from mapdata.rng import AUGMENTATION, block, bounded
from mapdata.search.goals import GoalFields
from mapdata.search.lattice import STEPS


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
def transform_grids(grids: Any, codes: Ints) -> Any:
    """Return the grids (B, H, W) after their symmetries; of any type, the maps or their fields."""
    transformed = np.empty_like(grids)
    rows, columns = grids.shape[1:]
    for b in range(len(grids)):
        cells = grids[b].reshape(-1)
        out = transformed[b].reshape(-1)
        # In the transformed grid, too, a step to the right or down always leads equally far.
        first = _place(0, 0, rows, columns, codes[b])
        right = _place(0, 1, rows, columns, codes[b]) - first
        down = _place(1, 0, rows, columns, codes[b]) - first
        # So a row becomes a row, and a column one where they change places; forwards or backwards.
        lines = rows
        length = columns
        next_line = columns
        step = 1
        if codes[b] & 4:
            lines = columns
            length = rows
            next_line = 1
            step = columns
            right, down = down, right
        for line in range(lines):
            cell = line * next_line
            to = first + line * down
            if right == 1:
                for k in range(length):
                    out[np.uint64(to + k)] = cells[np.uint64(cell + k * step)]
            else:
                for k in range(length):
                    out[np.uint64(to - k)] = cells[np.uint64(cell + k * step)]
    return transformed


@kernel
def _place(row: Int, column: Int, rows: Int, columns: Int, code: Int) -> Int:
    """Return where a cell stands in the transformed grid, row by row."""
    to_row, to_column = transform_cell(row, column, rows, columns, code)
    return to_row * (rows if code & 4 else columns) + to_column


@kernel
def _transform_moves(moves: Bytes, codes: Ints) -> None:
    """Make the moves in bit sets, (B, H, W), those after the symmetries of their maps."""
    after = np.zeros((8, 256), np.uint8)
    for code in range(8):
        for move in range(8):
            # About the cell in the middle of 3 x 3 cells, moves are cells.
            row, column = transform_cell(1 + STEPS[move, 0], 1 + STEPS[move, 1], 3, 3, code)
            to = 0
            while STEPS[to, 0] != row - 1 or STEPS[to, 1] != column - 1:
                to += 1
            for bits in range(256):
                after[code, bits] |= (bits >> move & 1) << to
    for b in range(len(moves)):
        cells = moves[b].reshape(-1)
        for k in range(len(cells)):
            cells[np.uint64(k)] = after[codes[b], cells[np.uint64(k)]]


def transform_fields(fields: GoalFields, codes: Ints) -> GoalFields:
    """Return the fields of goals after the symmetries of their maps."""
    grids = (transform_grids(field[:, 0], codes)[:, None] for field in fields)
    transformed = GoalFields(*grids)
    _transform_moves(transformed.optimal_moves[:, 0], codes)
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
