"""Forests: discs and boxes at random places, up to a density, down to single occupied cells.

Random obstacles of a given density are the oldest benchmark of grid planners: Sturtevant,
"Benchmarks for grid-based pathfinding", 2012, https://doi.org/10.1109/TCIAIG.2012.2197681,
and the forests of Bhardwaj, Choudhury, Scherer, "Learning heuristic search via imitation",
CoRL 2017, https://arxiv.org/abs/1707.03034, section 5.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from mapdata.arrays import Bytes
from mapdata.checks import check_integers, check_number, check_range, items_of
from mapdata.generators.points import Scattered, check_seed_points
from mapdata.jit import kernel
from mapdata.limits import Range
from mapdata.rng import MAP, block, bounded

_MAX_COVER = 0.5
"""Largest share of occupied cells. With more, few cells are connected, and drawing takes long."""


@dataclass(frozen=True)
class Forest(Scattered):
    """Obstacles at random places, each a disc or a box with equal probability.

    Attributes:
        map_size: (rows, columns) of a map.
        cover: (lowest, highest) share of occupied cells. The share of a map is drawn uniformly, and
            obstacles are added until they cover it. The last obstacle is not cut, so a large one
            may cover more.
        sizes: (lowest, highest) diameter of a disc and side of a box, in cells; (1, 1) is noise.
        seed_points: number of seed points of a map; fewer if its largest component has fewer cells.
    """

    name: ClassVar[str] = "forest"
    description: ClassVar[str] = "discs and boxes at random places"
    cover: tuple[float, float] = (0.1, 0.4)
    sizes: Range = (2, 9)
    seed_points: int = 5

    def __post_init__(self) -> None:
        """Check the values."""
        super().__post_init__()
        cover = tuple(check_number("cover", share) for share in items_of(self.cover))
        if len(cover) != 2 or not 0 <= cover[0] <= cover[1] <= _MAX_COVER:
            raise ValueError(
                f"cover: got {self.cover!r}, expected (lowest, highest), 0 to {_MAX_COVER}"
            )
        object.__setattr__(self, "cover", cover)
        self._convert(check_integers, "sizes")
        check_range("sizes", self.sizes, 1, min(self.map_size), ", the shorter side of the map")
        self._convert(check_seed_points, "seed_points")

    def draw_grid(self, grid: Bytes, seed: np.uint64, index: np.uint64) -> None:
        """Draw map ``index`` into a free ``grid``, (H, W)."""
        rows, columns = self.map_size
        min_cells = round(self.cover[0] * rows * columns)
        max_cells = round(self.cover[1] * rows * columns)
        _place_obstacles(grid, seed, index, (min_cells, max_cells), self.sizes)


PRESETS = {
    "forest": Forest(),
    "noise": Forest(sizes=(1, 1)),
}


@kernel
def _place_obstacles(
    grid: Bytes, seed: np.uint64, index: np.uint64, cell_counts: Range, sizes: Range
) -> None:
    """Add obstacles to a free grid until enough cells are occupied.

    Block 0 of stream MAP draws the number of cells to occupy. Each later block draws an obstacle:
    its middle, height, width and shape.

    Args:
        grid: (H, W) of zeros.
        seed: 64-bit seed.
        index: number of the map.
        cell_counts: lowest and highest number of cells to occupy.
        sizes: lowest and highest diameter or side of an obstacle, in cells.
    """
    rows, columns = grid.shape
    word, _, _, _ = block(seed, index, 0, MAP, 0)
    cells_to_occupy = bounded(word, cell_counts[0], cell_counts[1])
    block_number = 0
    while cells_to_occupy > 0:
        block_number += 1
        middle_word, height_word, width_word, shape_word = block(seed, index, 0, MAP, block_number)
        middle = bounded(middle_word, 0, rows * columns - 1)
        height = bounded(height_word, sizes[0], sizes[1])
        width = bounded(width_word, sizes[0], sizes[1])
        is_disc = bounded(shape_word, 0, 1)
        if is_disc:
            width = height
        top = middle // columns - height // 2
        left = middle % columns - width // 2
        for row in range(max(top, 0), min(top + height, rows)):
            for column in range(max(left, 0), min(left + width, columns)):
                # A cell belongs to a disc if its centre lies within the radius:
                #   down**2 + right**2 <= (height / 2)**2,
                # here with all lengths doubled, which makes them whole numbers.
                down = 2 * (row - top) + 1 - height
                right = 2 * (column - left) + 1 - width
                is_inside = not is_disc or down * down + right * right <= height * height
                if is_inside and grid[row, column] == 0:
                    grid[row, column] = 1
                    cells_to_occupy -= 1
    grid[rows // 2, columns // 2] = 0  # Every map needs a free cell for its seed points.
