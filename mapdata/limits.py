"""What the format allows: versions, sizes, splits, types of cells; which fields are binary."""

from __future__ import annotations

FORMAT_VERSIONS = (1, 2)
"""Versions of the bytes that are read and written: draws, labels and shard layout (docs/format.md).

Version 2 says what version 1 cannot: maps of another generator than Algorithm 1, and sides over
1,024. All else stays version 1.
"""

MAX_SIDE = 4096
"""Largest number of rows or columns of a map."""

MAX_ROOMS = 255
"""Largest number of rooms of a map."""

SPLITS = ("train", "val", "test")
"""Names of the splits, in the order of their codes 0, 1, 2."""

Range = tuple[int, int]
"""(lowest, highest), both included."""

MAPS_AND_MASKS = ("map", "free", "path_mask", "start_mask", "goal_mask", "optimal_mask")
"""The fields of samples that hold zeros and ones, which networks take as numbers.

``optimal_moves`` is not among them, because it is a bit set.
"""

Cell = tuple[int, int]
"""(row, col), origin upper left."""

Size = tuple[int, int]
"""(rows, columns) of a map."""


def least_version(map_size: Size) -> int:
    """Return the least version of the format that can say a map size."""
    return 1 if max(map_size) <= 1024 else 2
