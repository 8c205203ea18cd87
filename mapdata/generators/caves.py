"""Caves by a cellular automaton: https://doi.org/10.1145/1814256.1814266, section 3.

Johnson, Yannakakis, Togelius, "Cellular automata for real-time generation of infinite cave levels",
PCG 2010.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from mapdata.arrays import Bytes
from mapdata.checks import check_count, check_probability
from mapdata.generators.points import Scattered, check_seed_points
from mapdata.jit import Int, kernel
from mapdata.rng import MAP, block

_MAJORITY = 5
"""Of a cell and its eight neighbours; cells beyond the border count as occupied."""

_HALF_BITS = np.uint64(16)
_HALF_MASK = np.uint64(0xFFFF)


@dataclass(frozen=True)
class Cave(Scattered):
    """A distribution of caves: random cells that take the side of most of their neighbours.

    Attributes:
        map_size: (rows, columns) of a map.
        occupied: probability that a cell is occupied at first.
        steps: how often all cells change at once; 0 leaves noise.
        seed_points: how many seed points a map has where its largest component has as many cells.
    """

    name: ClassVar[str] = "cave"
    description: ClassVar[str] = "caves made by a cellular automaton"
    occupied: float = 0.45
    steps: int = 4
    seed_points: int = 5

    def __post_init__(self) -> None:
        """Check the values, ValueError if one is out of its limits."""
        super().__post_init__()
        self._convert(check_probability, "occupied")
        self._convert(partial(check_count, minimum=0), "steps")
        self._convert(check_seed_points, "seed_points")

    def draw_grid(self, grid: Bytes, seed: np.uint64, index: np.uint64) -> None:
        """Fill ``grid``, (H, W), with map ``index``."""
        _erode(grid, seed, index, round(self.occupied * 2**16), self.steps)


PRESETS = {"cave": Cave()}


@kernel
def _erode(grid: Bytes, seed: np.uint64, index: np.uint64, limit: Int, steps: Int) -> None:
    """Fill ``grid``, (H, W), with noise, then let every cell follow its neighbours ``steps`` times.

    A block of stream MAP gives eight cells, in row-major order: two halves of each of its words,
    the lower one first, which occupy a cell where they are below ``limit``.
    """
    rows, columns = grid.shape
    noise = grid.reshape(-1)
    cell = 0
    for number in range((rows * columns + 7) // 8):
        for word in block(seed, index, 0, MAP, number):
            for half in (word & _HALF_MASK, word >> _HALF_BITS):
                if cell < rows * columns:
                    noise[cell] = half < limit
                cell += 1
    # The occupied cells of three columns, with a column and a row of wall on either side.
    three = np.full((rows + 2, columns), 3, np.uint8)
    for _ in range(steps):
        for row in range(rows):
            for column in range(columns):
                left = grid[row, column - 1] if column > 0 else 1
                right = grid[row, column + 1] if column < columns - 1 else 1
                three[row + 1, column] = left + grid[row, column] + right
        for row in range(rows):
            for column in range(columns):
                count = three[row, column] + three[row + 1, column] + three[row + 2, column]
                grid[row, column] = count >= _MAJORITY
    grid[rows // 2, columns // 2] = 0  # so that every map has a cell to stand on
