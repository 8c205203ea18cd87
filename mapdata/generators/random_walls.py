"""Random walls: each cell is occupied with one probability, which is drawn for each map.

Lehnert et al., "Beyond A*: better planning with transformers via search dynamics bootstrapping",
2024, https://arxiv.org/abs/2402.14083, draw their mazes this way, with 30 to 50 % of walls.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from mapdata.arrays import Bytes
from mapdata.checks import check_number, items_of
from mapdata.generators.caves import draw_noise
from mapdata.generators.points import Scattered, check_seed_points
from mapdata.jit import kernel
from mapdata.limits import Range
from mapdata.rng import MAP, block, bounded

_MAX_PROBABILITY = 0.9
"""With more walls, small maps would often have no free cell, and drawing would take long."""


@dataclass(frozen=True)
class RandomWalls(Scattered):
    """Cells that are occupied independently of each other, all of a map with one probability.

    Attributes:
        map_size: (rows, columns) of a map.
        occupied: (lowest, highest) probability that a cell is occupied. That of a map is drawn
            uniformly.
        seed_points: number of seed points of a map; fewer if its largest component has fewer cells.
    """

    name: ClassVar[str] = "random_walls"
    description: ClassVar[str] = "each cell occupied at random"
    occupied: tuple[float, float] = (0.3, 0.5)
    seed_points: int = 5

    def __post_init__(self) -> None:
        """Check the values."""
        super().__post_init__()
        occupied = tuple(check_number("occupied", share) for share in items_of(self.occupied))
        if len(occupied) != 2 or not 0 <= occupied[0] <= occupied[1] <= _MAX_PROBABILITY:
            raise ValueError(
                f"occupied: got {self.occupied!r}, expected (lowest, highest), 0 to "
                f"{_MAX_PROBABILITY}"
            )
        object.__setattr__(self, "occupied", occupied)
        self._convert(check_seed_points, "seed_points")

    def draw_grid(self, grid: Bytes, seed: np.uint64, index: np.uint64) -> None:
        """Draw map ``index`` into ``grid``, (H, W)."""
        lowest, highest = self.occupied
        _draw_walls(grid, seed, index, (round(lowest * 2**16), round(highest * 2**16)))


PRESETS = {"noise30": RandomWalls((30, 30))}


@kernel
def _draw_walls(grid: Bytes, seed: np.uint64, index: np.uint64, thresholds: Range) -> None:
    """Fill ``grid`` with noise, and again until a cell is free.

    Args:
        grid: (H, W), filled with 0 free and 1 occupied.
        seed: 64-bit seed.
        index: number of the map.
        thresholds: lowest and highest threshold. Each draw has one between them, and a cell is
            occupied if its 16 random bits are below it.
    """
    block_number = 0
    while True:
        word, _, _, _ = block(seed, index, 0, MAP, block_number)
        threshold = bounded(word, thresholds[0], thresholds[1])
        block_number = draw_noise(grid, seed, index, block_number + 1, threshold)
        for cell in grid.flat:
            if cell == 0:
                return
