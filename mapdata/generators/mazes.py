"""Mazes by a random depth-first search: J. Buck, "Mazes for Programmers", 2015, chapter 5."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from mapdata.arrays import Bytes
from mapdata.checks import check_count, check_probability
from mapdata.generators.points import Scattered, check_seed_points
from mapdata.jit import Int, kernel
from mapdata.limits import MAX_ROOMS, Range
from mapdata.movement import STEPS
from mapdata.rng import MAP, block, bounded, threshold


@dataclass(frozen=True)
class Maze(Scattered):
    """A distribution of perfect mazes, where one way joins any two cells, or of less perfect ones.

    Attributes:
        map_size: (rows, columns) of a map; what its lattice leaves is wall, below and to the right.
        corridor, wall: widths, in cells.
        reopened: probability that a wall of the perfect maze is opened.
        seed_points: how many seed points a map has, from 2 to as many as the lattice has cells.
    """

    name: ClassVar[str] = "maze"
    description: ClassVar[str] = "mazes made by a random depth-first search"
    corridor: int = 1
    wall: int = 1
    reopened: float = 0.0
    seed_points: int = 5

    def __post_init__(self) -> None:
        """Check the values, ValueError if one is out of its limits."""
        super().__post_init__()
        self._convert(check_count, "corridor", "wall")
        self._convert(check_probability, "reopened")
        pitch = self.corridor + self.wall
        cells = math.prod((side - self.wall) // pitch for side in self.map_size)
        most = min(cells, MAX_ROOMS)
        self._convert(partial(check_seed_points, most=most), "seed_points")

    def draw_grid(self, grid: Bytes, seed: np.uint64, index: np.uint64) -> None:
        """Fill ``grid``, (H, W), with map ``index``."""
        grid[:] = 1
        _carve(grid, seed, index, (self.corridor, self.wall), threshold(self.reopened))


PRESETS = {"maze": Maze()}


@kernel
def _carve(grid: Bytes, seed: np.uint64, index: np.uint64, widths: Range, reopen: Int) -> None:
    """Free the corridors of an occupied ``grid``; blocks of stream MAP are numbered as drawn."""
    corridor, wall = widths
    tall = (grid.shape[0] - wall) // (corridor + wall)
    wide = (grid.shape[1] - wall) // (corridor + wall)
    seen = np.zeros((tall, wide), np.uint8)
    stack = np.zeros(tall * wide, np.int64)  # cells on the way from the first one to this one
    unseen = np.empty(4, np.int64)
    depth = 0
    number = 0
    while depth >= 0:
        row, column = divmod(stack[depth], wide)
        seen[row, column] = 1
        _free(grid, row, column, 0, 0, widths)
        count = 0
        for move in range(4):
            r = row + STEPS[move, 0]
            c = column + STEPS[move, 1]
            if 0 <= r < tall and 0 <= c < wide and seen[r, c] == 0:
                unseen[count] = move
                count += 1
        if count == 0:  # a dead end: one step back; at the first cell there is none
            depth -= 1
            continue
        # go to a random unseen neighbour, through the wall between
        word, _, _, _ = block(seed, index, 0, MAP, number)
        number += 1
        down, right = STEPS[unseen[bounded(word, 0, count - 1)]]
        depth += 1
        stack[depth] = (row + down) * wide + column + right
        _free(grid, row + min(down, 0), column + min(right, 0), abs(down), abs(right), widths)
    # Each wall once, open already or not: that to the right of a cell, then that below it.
    for k in range(2 * tall * wide if reopen else 0):
        row, column = divmod(k // 2, wide)
        below = k % 2
        inside = row + below < tall and column + 1 - below < wide
        if inside and block(seed, index, 0, MAP, number + k)[0] < reopen:
            _free(grid, row, column, below, 1 - below, widths)


@kernel
def _free(grid: Bytes, row: Int, column: Int, down: Int, right: Int, widths: Range) -> None:
    """Free a cell, or the wall that it owns: below (``down`` 1) or to the right (``right`` 1)."""
    corridor, wall = widths
    top = wall + row * (corridor + wall) + down * corridor
    left = wall + column * (corridor + wall) + right * corridor
    for r in range(top, top + (wall if down else corridor)):
        for c in range(left, left + (wall if right else corridor)):
            grid[r, c] = 0
