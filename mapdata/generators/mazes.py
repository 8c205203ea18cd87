"""Mazes by a random depth-first search, the "recursive backtracker".

J. Buck, "Mazes for Programmers", 2015, chapter 5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.generators.generator import Generator
from mapdata.generators.maps import Maps
from mapdata.generators.points import with_seed_points
from mapdata.jit import Int, kernel
from mapdata.rng import MAP, block, bounded, threshold
from mapdata.spec import MAX_ROOMS, Movement, Range, check_count, check_probability


@dataclass(frozen=True)
class Maze(Generator):
    """A distribution of mazes.

    They are perfect mazes, where one way joins any two cells, or such with some walls reopened.

    Attributes:
        map_size: (rows, columns) of a map, in cells; what the lattice leaves at the lower and right
            edge is wall.
        corridor: width of the corridors, in cells.
        wall: width of the walls, in cells.
        reopened: probability that a wall of the perfect maze is opened; 0 leaves one way between
            any two cells.
        seed_points: how many seed points a map has, from 2 to as many as the lattice has cells.

    Raises:
        ValueError: a value outside these limits.
    """

    name: ClassVar[str] = "maze"
    description: ClassVar[str] = "mazes made by a random depth-first search"
    map_size: Range = (64, 64)
    corridor: int = 1
    wall: int = 1
    reopened: float = 0.0
    seed_points: int = 5
    resolution: float = 0.1
    movement: Movement = field(default_factory=Movement)
    splits: tuple[float, float, float] = (0.8, 0.1, 0.1)

    def __post_init__(self) -> None:
        """Check the values."""
        super().__post_init__()
        for name, least in (("corridor", 1), ("wall", 1), ("seed_points", 2)):
            object.__setattr__(self, name, check_count(name, getattr(self, name), least))
        object.__setattr__(self, "reopened", check_probability("reopened", self.reopened))
        pitch = self.corridor + self.wall
        cells = math.prod((side - self.wall) // pitch for side in self.map_size)
        most = min(cells, MAX_ROOMS)
        if self.seed_points > most:
            raise ValueError(
                f"seed_points: got {self.seed_points}, expected at most {most} in such a maze"
            )

    @property
    def most_seed_points(self) -> int:
        """How many seed points every map has."""
        return self.seed_points

    def draw(self, seed: int, indices: Ints) -> Maps:
        """Return the maps ``indices``, (N,) int64."""
        grids = np.ones((len(indices), *self.map_size), np.uint8)
        key = np.uint64(seed)
        reopen = threshold(self.reopened)
        for grid, index in zip(grids, indices, strict=True):
            _carve_maze(grid, key, np.uint64(index), self.corridor, self.wall, reopen)
        return with_seed_points(self, seed, indices, grids)


PRESETS: dict[str, Generator] = {"maze": Maze()}

_DOWN = np.array([-1, 0, 1, 0])
"""Rows that the moves N, E, S, W lead down."""

_RIGHT = np.array([0, 1, 0, -1])
"""Columns that they lead to the right."""


@kernel
def _carve_maze(
    grid: Bytes, seed: np.uint64, index: np.uint64, corridor: Int, wall: Int, reopen: Int
) -> None:
    """Free the corridors of an occupied ``grid``, (H, W).

    The maze is a lattice of ``tall`` x ``wide`` cells with a wall between any two; ``_free`` opens
    them on the grid. Blocks of stream MAP are numbered as they are drawn.
    """
    tall = (grid.shape[0] - wall) // (corridor + wall)
    wide = (grid.shape[1] - wall) // (corridor + wall)
    seen = np.zeros((tall, wide), np.uint8)
    moves = np.zeros(tall * wide, np.int64)  # that led from the first cell to this one: the stack
    unseen = np.empty(4, np.int64)
    row: Int = 0
    column: Int = 0
    depth = 0
    number = 0
    while depth >= 0:
        seen[row, column] = 1
        _free(grid, row, column, 0, 0, corridor, wall)
        count = 0
        for move in range(4):
            r = row + _DOWN[move]
            c = column + _RIGHT[move]
            if 0 <= r < tall and 0 <= c < wide and seen[r, c] == 0:
                unseen[count] = move
                count += 1
        if count:
            # Go to a random unseen neighbour, through the wall between.
            word, _, _, _ = block(seed, index, 0, MAP, number)
            number += 1
            chosen: Int = unseen[bounded(word, 0, count - 1)]
            moves[depth] = chosen
            depth += 1
            down = _DOWN[chosen]
            right = _RIGHT[chosen]
            # A wall belongs to the cell above it or to the left of it.
            upper = row + min(down, 0)
            left = column + min(right, 0)
            _free(grid, upper, left, abs(down), abs(right), corridor, wall)
        else:
            # A dead end: one step back. At the first cell there is none, and the loop ends.
            depth -= 1
            down = -_DOWN[moves[depth]]
            right = -_RIGHT[moves[depth]]
        row += down
        column += right
    if reopen == 0:
        return
    # Each wall once, open already or not: that to the right of a cell, then that below it.
    for k in range(2 * tall * wide):
        row = k // 2 // wide
        column = k // 2 % wide
        below = k % 2
        beside = 1 - below
        if row + below < tall and column + beside < wide:
            word, _, _, _ = block(seed, index, 0, MAP, number + k)
            if word < reopen:
                _free(grid, row, column, below, beside, corridor, wall)


@kernel
def _free(
    grid: Bytes, row: Int, column: Int, down: Int, right: Int, corridor: Int, wall: Int
) -> None:
    """Free a cell of the lattice, or its wall below (``down`` 1) or to the right (``right`` 1)."""
    top = wall + row * (corridor + wall) + down * corridor
    left = wall + column * (corridor + wall) + right * corridor
    bottom = top + (wall if down else corridor)
    end = left + (wall if right else corridor)
    for r in range(top, bottom):
        for c in range(left, end):
            grid[r, c] = 0
