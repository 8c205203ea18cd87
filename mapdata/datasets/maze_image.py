"""The field ``maze_image``: a problem, and its path, as a picture of black and white cells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.checks import check_count, check_flag

OCCUPIED_COLOUR, FREE_COLOUR = (0, 0, 0), (255, 255, 255)
START_COLOUR, GOAL_COLOUR, PATH_COLOUR = (255, 0, 0), (0, 255, 0), (0, 0, 255)
"""The colours of the cells in ``maze_image``: red, green, blue."""

MAX_PIXELS_PER_CELL = 32


class DrawnBatch(Protocol):
    """What `MazeImage` needs of a `Batch`, which describes it."""

    @property
    def grids(self) -> Bytes:
        """(B, H, W) uint8, as served."""

    @property
    def starts(self) -> Ints:
        """(B, 2) int64."""

    @property
    def goals(self) -> Ints:
        """(B, 2) int64."""

    @property
    def paths(self) -> tuple[Ints, Ints, Ints]:
        """The cells of all paths, where each of them begins, and their iterations."""


@dataclass(frozen=True)
class MazeImage:
    """The field ``maze_image``, with cells of several pixels or with the path.

    It stands among the names in ``fields=``: ``fields=("map", MazeImage(path=True))``.

    Attributes:
        pixels: k, pixels on a side of a cell, 1 to 32.
        path: True draws the cells of the served path between start and goal in blue.
    """

    pixels: int = 1
    path: bool = False

    __name__: ClassVar[str] = "maze_image"

    def __post_init__(self) -> None:
        """Check the values."""
        pixels = check_count("pixels", self.pixels, minimum=1)
        if pixels > MAX_PIXELS_PER_CELL:
            raise ValueError(f"pixels: got {pixels}, expected at most {MAX_PIXELS_PER_CELL}")
        object.__setattr__(self, "pixels", pixels)
        check_flag("path", self.path)

    def __call__(self, batch: DrawnBatch) -> Bytes:
        """Return the pictures, (B, 3, k * H, k * W) uint8."""
        colours = np.array((FREE_COLOUR, OCCUPIED_COLOUR), np.uint8)
        # The channels come last until the end, so that a cell is assigned its colour.
        pictures = colours[batch.grids]
        maps = np.arange(len(pictures))
        if self.path:
            cells, offsets, _ = batch.paths
            rows, columns = cells.T
            pictures[np.repeat(maps, np.diff(offsets)), rows, columns] = PATH_COLOUR
        pictures[maps, batch.goals[:, 0], batch.goals[:, 1]] = GOAL_COLOUR
        pictures[maps, batch.starts[:, 0], batch.starts[:, 1]] = START_COLOUR
        channels_first = pictures.transpose(0, 3, 1, 2)
        return channels_first.repeat(self.pixels, axis=2).repeat(self.pixels, axis=3)
