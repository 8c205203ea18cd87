"""Terrain: maps whose free cells cost different amounts, drawn as smooth noise in levels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.checks import check_count, check_probability
from mapdata.generators.generator import MapGenerator
from mapdata.generators.maps import Maps
from mapdata.generators.points import check_seed_points, with_seed_points
from mapdata.jit import kernel
from mapdata.movement import Movement
from mapdata.rng import TERRAIN, block, bounded


@dataclass(frozen=True)
class Terrain(MapGenerator):
    """Maps whose free cells have costs.

    Attributes:
        map_size: (rows, columns) of a map.
        costs: the costs of the levels, 1 to 255 each, from the lowest ground to the highest.
        shares: the share of the free cells that each level covers; () for equal shares.
        scale: size of hills and valleys, in cells.
        obstacles: share of occupied cells.
        seed_points: number of seed points of a map; fewer if its largest component has fewer cells.
        corners: whether the seed points are the upper left and the lower right corner instead.
        over: the generator whose free cells get the costs; None for maps of terrain alone.
    """

    name: ClassVar[str] = "terrain"
    description: ClassVar[str] = "terrain whose cells have costs"
    costs: tuple[int, ...] = tuple(range(1, 11))
    shares: tuple[float, ...] = ()
    scale: int = 8
    obstacles: float = 0.1
    seed_points: int = 5
    corners: bool = False
    over: MapGenerator | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        super().__post_init__()
        self._convert(partial(check_count, minimum=1), "scale")
        self._convert(check_probability, "obstacles")
        self._convert(check_seed_points, "seed_points")

    @property
    def has_terrain(self) -> bool:
        """Terrain has terrain."""
        return True

    @property
    def max_seed_points(self) -> int:
        """The largest number of seed points of a map."""
        return 2 if self.corners else self.seed_points

    def draw(self, seed: int, indices: Ints) -> Maps:
        """Return the maps ``indices``, (N,) int64."""
        terrain = np.empty((len(indices), *self.map_size), np.uint8)
        costs = np.array(self.costs, np.uint8)
        for grid, index in zip(terrain, indices, strict=True):
            _draw_noise(grid, np.uint64(seed), np.uint64(index), costs, round(self.obstacles * 100))
        occupancy = (terrain == 0).astype(np.uint8)
        maps = with_seed_points(self, seed, indices, occupancy)
        return replace(maps, terrain=terrain)


PRESETS = {
    "terrain": Terrain(),
    "tiles": Terrain(
        (12, 12),
        costs=(8, 12, 53, 77, 92),
        obstacles=0.0,
        corners=True,
        movement=Movement(8, corner_cutting=True, diagonal_cost=1.0),
    ),
}


@kernel
def _draw_noise(
    terrain: Bytes, seed: np.uint64, index: np.uint64, costs: Bytes, obstacle_percent: int
) -> None:
    """Draw the cost of each cell on its own."""
    rows, columns = terrain.shape
    for row in range(rows):
        for column in range(columns):
            first, second, _, _ = block(seed, index, 0, TERRAIN, row * columns + column)
            cost = costs[bounded(first, 0, len(costs) - 1)]
            terrain[row, column] = 0 if bounded(second, 0, 99) < obstacle_percent else cost
