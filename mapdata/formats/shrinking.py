"""Smaller maps: cells that cover several old ones, and a note on the free cells that this costs.

A wall may be thinner than a cell of the smaller map. If such a cell were occupied only where most
of it is, rooms would be joined through walls that have vanished. So a cell is occupied if any part
of it is, unless the user asks for the mean.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mapdata.arrays import Array, Bytes, Flags
from mapdata.formats.files import percent
from mapdata.generators.points import count_components
from mapdata.limits import Size
from mapdata.npy import FormatError

MIN_CELLS = 16
"""Components of fewer free cells are not counted: they are specks."""

_LARGE_LOSS = 0.2
"""Share of lost free cells above which a note says what to do."""


def any_occupied(grid: Bytes, size: Size) -> Bytes:
    """Return a grid of another size, in which a cell is occupied if any part of it is.

    Args:
        grid: (H, W) uint8, 0 free and 1 occupied.
        size: (rows, columns) of the new grid.

    Returns:
        (rows, columns) uint8.
    """
    is_occupied: Flags = grid != 0
    for axis, new_length in enumerate(size):
        old_length = grid.shape[axis]
        edges = np.arange(new_length + 1) * old_length  # in units of 1 / new_length old cells
        first = edges[:-1] // new_length
        after_last = -(-edges[1:] // new_length)  # rounded up
        zeros = np.zeros_like(is_occupied.take([0], axis), np.int32)
        counts = np.cumsum(is_occupied, axis, dtype=np.int32)
        before: Array = np.concatenate((zeros, counts), axis)  # occupied cells before each cell
        is_occupied = before.take(after_last, axis) > before.take(first, axis)
    return is_occupied.astype(np.uint8)


@dataclass
class FreeSpace:
    """The free cells of maps before and after they were made smaller.

    Attributes:
        components_before: number of connected components of at least `MIN_CELLS` free cells.
        components_after: the same afterwards.
        free_before: number of free cells.
        free_after: the same afterwards, in cells of the size that they had before.
    """

    components_before: int = 0
    components_after: int = 0
    free_before: float = 0.0
    free_after: float = 0.0

    def add(self, before: Bytes, after: Iterable[Bytes], cell_area: float = 1.0) -> None:
        """Count the free cells of a map.

        Args:
            before: (H, W) uint8, 0 free and 1 occupied.
            after: the maps that were made of it, each like ``before``.
            cell_area: area of a cell of ``after``, in cells of ``before``.
        """
        self.components_before += _components(before)
        self.free_before += np.count_nonzero(before == 0)
        for grid in after:
            self.components_after += _components(grid)
            self.free_after += cell_area * np.count_nonzero(grid == 0)

    def notes(self, action: str, advice: str) -> list[str]:
        """Return a note on what was done to the maps, or nothing if no map had free cells.

        Args:
            action: what was done.
            advice: what to do if much of the free area is lost.
        """
        if self.free_before == 0:
            return []
        lost = 1 - self.free_after / self.free_before
        change = f"{percent(lost)} of the free area was lost"
        if lost < 0:
            change = f"{percent(-lost)} of free area was added"
        if lost > _LARGE_LOSS:
            change += f"; {advice}"
        return [
            f"{action}: components of at least {MIN_CELLS} free cells: {self.components_before:,} "
            f"before, {self.components_after:,} after; {change}"
        ]


def check_free(before: Bytes, after: Bytes, advice: str) -> None:
    """Check that a smaller map has a free cell, if the map had one before.

    Args:
        before: (H, W) uint8, 0 free and 1 occupied.
        after: the smaller map.
        advice: what to do otherwise.

    Raises:
        FormatError: all cells are occupied.
    """
    if after.all() and not before.all():
        rows, columns = after.shape
        raise FormatError(f"no free cell is left of {rows} x {columns} cells: {advice}")


def _components(grid: Bytes) -> int:
    """Return the number of components of at least `MIN_CELLS` free cells, 4-connected."""
    return int(count_components(np.ascontiguousarray(grid), 0, MIN_CELLS))
