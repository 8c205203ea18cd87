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
"""Occupied cells, of a cell and its eight neighbours, from which on the cell becomes occupied."""

_HALF_BITS = np.uint64(16)
_HALF_MASK = np.uint64(0xFFFF)
"""A random word of 32 bits has two halves of 16 bits, each of which draws a cell."""


@dataclass(frozen=True)
class Cave(Scattered):
    """Caves: random cells, each of which then repeatedly becomes what most of its neighbours are.

    Attributes:
        map_size: (rows, columns) of a map.
        occupied: probability that a cell is occupied before the first step.
        steps: steps of the cellular automaton; 0 leaves noise.
        seed_points: number of seed points of a map; fewer if its largest component has fewer cells.
    """

    name: ClassVar[str] = "cave"
    description: ClassVar[str] = "caves made by a cellular automaton"
    occupied: float = 0.45
    steps: int = 4
    seed_points: int = 5

    def __post_init__(self) -> None:
        """Check the values."""
        super().__post_init__()
        self._convert(check_probability, "occupied")
        self._convert(partial(check_count, minimum=0), "steps")
        self._convert(check_seed_points, "seed_points")

    def draw_grid(self, grid: Bytes, seed: np.uint64, index: np.uint64) -> None:
        """Draw map ``index`` into ``grid``, (H, W)."""
        _draw_cave(grid, seed, index, round(self.occupied * 2**16), self.steps)


PRESETS = {"cave": Cave()}


@kernel
def _draw_cave(
    grid: Bytes, seed: np.uint64, index: np.uint64, noise_threshold: Int, steps: Int
) -> None:
    """Fill ``grid`` with noise, then run the cellular automaton.

    Args:
        grid: (H, W), filled with 0 free and 1 occupied.
        seed: 64-bit seed.
        index: number of the map.
        noise_threshold: a cell is occupied at first if its 16 random bits are below this number.
        steps: steps of the automaton.
    """
    rows, columns = grid.shape
    draw_noise(grid, seed, index, 0, noise_threshold)
    # The number of occupied cells among a cell and its left and right neighbours. Beyond the border
    # all cells are occupied, so there is a row of threes above the first row and below the last.
    row_counts = np.full((rows + 2, columns), 3, np.uint8)
    for _ in range(steps):
        for row in range(rows):
            for column in range(columns):
                left = grid[row, column - 1] if column > 0 else 1
                right = grid[row, column + 1] if column < columns - 1 else 1
                row_counts[row + 1, column] = left + grid[row, column] + right
        for row in range(rows):
            for column in range(columns):
                above = row_counts[row, column]
                beside = row_counts[row + 1, column]
                below = row_counts[row + 2, column]
                grid[row, column] = above + beside + below >= _MAJORITY
    grid[rows // 2, columns // 2] = 0  # Every map needs a free cell for its seed points.


@kernel
def draw_noise(
    grid: Bytes, seed: np.uint64, index: np.uint64, first_block: Int, threshold: Int
) -> Int:
    """Fill ``grid`` with noise; return the number of the first block of stream MAP that is unused.

    Args:
        grid: (H, W), filled with 0 free and 1 occupied.
        seed: 64-bit seed.
        index: number of the map.
        first_block: number of the first block to use.
        threshold: a cell is occupied if its 16 random bits are below this number.
    """
    # A block has four words, and so 16 bits for each of eight cells in row-major order; the lower
    # half of a word comes first.
    noise = grid.reshape(-1)
    unused_block = first_block + (len(noise) + 7) // 8
    cell = 0
    for block_number in range(first_block, unused_block):
        for word in block(seed, index, 0, MAP, block_number):
            for half in (word & _HALF_MASK, word >> _HALF_BITS):
                if cell < len(noise):
                    noise[cell] = half < threshold
                cell += 1
    return unused_block
