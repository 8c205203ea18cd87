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

_MOST_COVER = 0.5
"""At most half of a map is asked for: beyond it no way leads anywhere, and draws run out."""


@dataclass(frozen=True)
class Forest(Scattered):
    """A distribution of obstacles at random places: discs and boxes, as many of each.

    Attributes:
        map_size: (rows, columns) of a map.
        cover: (least, most) share of the cells that obstacles cover at least; that of a map is
            uniform. The obstacle that reaches it is whole, and may go far beyond if it is large.
        sizes: (least, most) diameter of a disc and side of a box, in cells; (1, 1) is noise.
        seed_points: how many seed points a map has where its largest component has as many cells.
    """

    name: ClassVar[str] = "forest"
    description: ClassVar[str] = "discs and boxes at random places"
    cover: tuple[float, float] = (0.1, 0.4)
    sizes: Range = (2, 9)
    seed_points: int = 5

    def __post_init__(self) -> None:
        """Check the values, ValueError if one is out of its limits."""
        super().__post_init__()
        cover = tuple(check_number("cover", share) for share in items_of(self.cover))
        if len(cover) != 2 or not 0 <= cover[0] <= cover[1] <= _MOST_COVER:
            raise ValueError(
                f"cover: got {self.cover!r}, expected (least, most), 0 to {_MOST_COVER}"
            )
        object.__setattr__(self, "cover", cover)
        self._convert(check_integers, "sizes")
        check_range("sizes", self.sizes, 1, min(self.map_size), ", the shorter side of the map")
        self._convert(check_seed_points, "seed_points")

    def draw_grid(self, grid: Bytes, seed: np.uint64, index: np.uint64) -> None:
        """Occupy cells of a free ``grid``, (H, W): map ``index``."""
        rows, columns = self.map_size
        least, most = (round(share * rows * columns) for share in self.cover)
        _plant(grid, seed, index, (least, most), self.sizes)


PRESETS = {
    "forest": Forest(),
    "noise": Forest(sizes=(1, 1)),
}


@kernel
def _plant(grid: Bytes, seed: np.uint64, index: np.uint64, cover: Range, sizes: Range) -> None:
    """Occupy cells of a free ``grid``, (H, W), until as many are occupied as block 0 says.

    Blocks 1, 2, ... of stream MAP are the obstacles: where, how tall, how wide, and which shape.
    """
    rows, columns = grid.shape
    word, _, _, _ = block(seed, index, 0, MAP, 0)
    missing = bounded(word, cover[0], cover[1])
    number = 0
    while missing > 0:
        number += 1
        place, first, second, shape = block(seed, index, 0, MAP, number)
        middle = bounded(place, 0, rows * columns - 1)
        tall = bounded(first, sizes[0], sizes[1])
        wide = bounded(second, sizes[0], sizes[1])
        disc = bounded(shape, 0, 1)
        if disc:
            wide = tall
        top = middle // columns - tall // 2
        left = middle % columns - wide // 2
        for row in range(max(top, 0), min(top + tall, rows)):
            for column in range(max(left, 0), min(left + wide, columns)):
                # Twice the way from the middle of the disc to that of the cell, in whole numbers.
                down = 2 * (row - top) + 1 - tall
                right = 2 * (column - left) + 1 - wide
                inside = not disc or down * down + right * right <= tall * tall
                if inside and grid[row, column] == 0:
                    grid[row, column] = 1
                    missing -= 1
    grid[rows // 2, columns // 2] = 0  # so that every map has a cell to stand on
