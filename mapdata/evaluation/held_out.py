"""Families of maps for tests alone: they have no preset, so that no training takes them unawares.

Their obstacles are built in other ways than those of `mapdata.generators`: shelves, slanted walls,
bug traps, floors of rooms, and rings. All draws are integers of `mapdata.rng`, so that every
machine draws the same maps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from mapdata.arrays import Bytes
from mapdata.checks import check_choice
from mapdata.generators.points import Scattered
from mapdata.rng import MAP, block, bounded

Draw = Callable[[int, int], int]
"""Returns the next random integer from the first number to the second, both included."""


@dataclass(frozen=True)
class HeldOut(Scattered):
    """Maps of one of five shapes, which no preset has.

    Attributes:
        map_size: (rows, columns) of a map, at least 32 each.
        shape: "shelves", "bars", "traps", "floors" or "rings".
        seed_points: number of seed points of a map; fewer if its largest component has fewer cells.

    Raises:
        ValueError: another shape, or smaller maps.

    >>> from mapdata.generators import generate
    >>> generate(HeldOut(shape="traps"), 0, range(3)).occupancy.shape
    (3, 64, 64)
    """

    name: ClassVar[str] = "held_out"
    description: ClassVar[str] = "maps for tests alone"
    shape: str = "shelves"
    seed_points: int = 5

    def __post_init__(self) -> None:
        """Check the values."""
        super().__post_init__()
        check_choice("shape", self.shape, SHAPES)
        if min(self.map_size) < 32:
            raise ValueError(f"map_size: got {self.map_size}, expected at least 32 x 32")

    def draw_grid(self, grid: Bytes, seed: np.uint64, index: np.uint64) -> None:
        """Draw map ``index`` into a free ``grid``, (H, W)."""
        numbers = iter(range(2**24))  # of the blocks of random words

        def draw(low: int, high: int) -> int:
            word, _, _, _ = block(seed, index, 0, MAP, next(numbers))
            return int(bounded(word, low, high))

        SHAPES[self.shape](grid, draw)


def _draw_shelves(grid: Bytes, draw: Draw) -> None:
    """Occupy rows of shelves, as in a warehouse.

    The depth and length of shelves and the width of aisles are those of the map. An eighth of the
    shelves is missing, and an eighth also fills the aisle on its right.
    """
    rows, columns = grid.shape
    depth, length, aisle = draw(1, 3), draw(5, 14), draw(1, 3)
    for top in range(aisle, rows - depth, depth + aisle):
        for left in range(aisle, columns - length, length + aisle):
            state = draw(1, 8)
            if state == 1:
                continue
            filled = length + aisle if state == 2 else length
            grid[top : top + depth, left : left + filled] = 1


def _draw_bars(grid: Bytes, draw: Draw) -> None:
    """Occupy thin straight walls of any direction, up to 28 cells long."""
    rows, columns = grid.shape
    for _ in range(rows * columns // draw(100, 250)):
        row, column = draw(0, rows - 1), draw(0, columns - 1)
        down, right = draw(-20, 20), draw(-20, 20)
        steps = max(abs(down), abs(right), 1)
        for step in range(steps + 1):
            # Halves are rounded towards greater numbers.
            wall_row = row + (2 * down * step + steps) // (2 * steps)
            wall_column = column + (2 * right * step + steps) // (2 * steps)
            if 0 <= wall_row < rows and 0 <= wall_column < columns:
                grid[wall_row, wall_column] = 1


def _draw_traps(grid: Bytes, draw: Draw) -> None:
    """Occupy the walls of boxes that are open on one side."""
    rows, columns = grid.shape
    for _ in range(rows * columns // draw(200, 500)):
        height, width = draw(7, 20), draw(7, 20)
        top, left = draw(0, rows - height), draw(0, columns - width)
        _outline(grid[top : top + height, left : left + width])
        box = grid[top : top + height, left : left + width]
        sides = (box[0, 1:-1], box[-1, 1:-1], box[1:-1, 0], box[1:-1, -1])
        sides[draw(0, 3)][:] = 0


def _draw_floors(grid: Bytes, draw: Draw) -> None:
    """Divide the map by walls with one or two doors, and each part again, down to rooms."""
    rows, columns = grid.shape
    areas = [(0, rows, 0, columns)]
    while areas:
        top, bottom, left, right = areas.pop()
        is_across = bottom - top >= right - left  # the wall runs from left to right
        first, last = (top, bottom) if is_across else (left, right)
        if last - first < draw(9, 18):
            continue
        # Walls are on odd rows and columns, and doors on even ones, so that no wall ends at a door.
        wall = 2 * draw(first // 2 + 1, (last - 1) // 2 - 2) + 1
        if is_across:
            grid[wall, left:right] = 1
            areas += [(top, wall, left, right), (wall + 1, bottom, left, right)]
        else:
            grid[top:bottom, wall] = 1
            areas += [(top, bottom, left, wall), (top, bottom, wall + 1, right)]
        begin, end = (left, right) if is_across else (top, bottom)
        for _ in range(draw(1, 2)):
            door = 2 * draw((begin + 1) // 2, (end - 1) // 2)
            grid[(wall, door) if is_across else (door, wall)] = 0


def _draw_rings(grid: Bytes, draw: Draw) -> None:
    """Occupy square rings within rings, each with one gap."""
    rows, columns = grid.shape
    side, pitch = draw(16, 32), draw(2, 4)
    for top in range(0, rows - side + 1, side):
        for left in range(0, columns - side + 1, side):
            for depth in range(1, side // 2 - 1, pitch):
                ring = grid[top + depth : top + side - depth, left + depth : left + side - depth]
                _outline(ring)
                place = draw(1, len(ring) - 2)
                ends = ((0, place), (-1, place), (place, 0), (place, -1))
                ring[ends[draw(0, 3)]] = 0


def _outline(box: Bytes) -> None:
    """Occupy the outermost cells of a box, (H, W)."""
    box[[0, -1]] = 1
    box[:, [0, -1]] = 1


SHAPES = {
    "shelves": _draw_shelves,
    "bars": _draw_bars,
    "traps": _draw_traps,
    "floors": _draw_floors,
    "rings": _draw_rings,
}
"""The functions that draw into a free grid, (H, W), by the names of the shapes."""
