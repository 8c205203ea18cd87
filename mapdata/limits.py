"""Limits of the format: versions, sizes, splits, types of cells; names of fields and formats."""

from __future__ import annotations

FORMAT_VERSIONS = (1, 2, 3)
"""Versions of the bytes that are read and written: draws, labels and shard layout (docs/format.md).

Version 2 is for datasets that version 1 cannot describe: maps of another generator than Algorithm
1, and maps with sides over 1,024 cells. Version 3 is for maps with terrain. All other datasets are
written in version 1.
"""

TERRAIN_VERSION = 3
"""The version of the format whose maps have terrain."""

MAX_SIDE = 4096
"""Largest number of rows or columns of a map."""

MIN_RESOLUTION, MAX_RESOLUTION = 1e-9, 1e9
"""Smallest and largest metres per cell. Products of other numbers with lengths would overflow."""

MAX_ROOMS = 255
"""Largest number of rooms of a map."""

MAX_CELL_COST = 255
"""Largest cost of a cell of terrain; the smallest is 1."""

SPLITS = ("train", "val", "test")
"""Names of the splits, in the order of their codes 0, 1, 2."""

PROBLEM_FORMATS = (
    "arrays",
    "parquet",
    "maze-hard",
    "transpath",
    "gppn",
    "vin",
    "hrm",
    "warcraft",
)
"""What `export_problems` writes: three formats of its own, and all of `LAYOUTS`.

The names stand here, because the help of the command line needs them, and importing
`mapdata.export` imports torch, which takes seconds.
"""

Range = tuple[int, int]
"""(lowest, highest), both included."""

MAPS_AND_MASKS = (
    "map",
    "free",
    "terrain",
    "image",
    "maze_image",
    "path_mask",
    "start_mask",
    "goal_mask",
    "optimal_mask",
)
"""The uint8 fields of samples that networks take as numbers.

``optimal_moves`` is not among them, because it is a bit set.
"""

Cell = tuple[int, int]
"""(row, col), origin upper left."""

Size = tuple[int, int]
"""(rows, columns) of a map."""


_MAX_SIDE_OF_VERSION_1 = 1024


def min_version(map_size: Size) -> int:
    """Return the lowest version of the format that can describe maps of this size."""
    rows, columns = map_size
    return 1 if max(rows, columns) <= _MAX_SIDE_OF_VERSION_1 else 2
