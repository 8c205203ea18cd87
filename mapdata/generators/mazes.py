"""Mazes by a random depth-first search ("recursive backtracker"): J. Buck, "Mazes for Programmers",
2015, chapter 5.
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
    """A distribution of mazes: perfect ones, where one way joins any two cells, or with some walls
    reopened.

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
        cells = math.prod(
            (side - self.wall) // (self.corridor + self.wall) for side in self.map_size
        )
        if self.seed_points > min(cells, MAX_ROOMS):
            raise ValueError(
                f"seed_points: got {self.seed_points}, expected at most {min(cells, MAX_ROOMS)} "
                "in such a maze"
            )

    @property
    def most_seed_points(self) -> int:
        """How many seed points every map has."""
        return self.seed_points

    def draw(self, seed: int, indices: Ints) -> Maps:
        """Return the maps ``indices``, (N,) int64."""
        grids = np.ones((len(indices), *self.map_size), np.uint8)
        for grid, index in zip(grids, indices, strict=True):
            _carve_maze(
                grid,
                np.uint64(seed),
                np.uint64(index),
                self.corridor,
                self.wall,
                threshold(self.reopened),
            )
        return with_seed_points(self, seed, indices, grids)


PRESETS: dict[str, Generator] = {"maze": Maze()}
_DOWN = np.array([-1, 0, 1, 0])
_RIGHT = np.array([0, 1, 0, -1])


@kernel
def _carve_maze(
    grid: Bytes, seed: np.uint64, index: np.uint64, corridor: Int, wall: Int, reopen: Int
) -> None:
    """Free the corridors of an occupied ``grid``, (H, W). Blocks of stream MAP are numbered as they
    are drawn.
    """
    tall = (grid.shape[0] - wall) // (corridor + wall)
    wide = (grid.shape[1] - wall) // (corridor + wall)
    seen = np.zeros((tall, wide), np.uint8)
    moves = np.zeros(tall * wide, np.int64)  # that led from the first cell to this one
    fresh = np.empty(4, np.int64)
    row, column, depth, number = 0, 0, 0, 0
    while depth >= 0:
        seen[row, column] = 1
        _free(grid, row, column, 0, 0, corridor, wall)
        count = 0
        for move in range(4):
            r, c = row + _DOWN[move], column + _RIGHT[move]
            if 0 <= r < tall and 0 <= c < wide and seen[r, c] == 0:
                fresh[count] = move
                count += 1
        if count:
            word, _, _, _ = block(seed, index, 0, MAP, number)
            number += 1
            moves[depth] = fresh[bounded(word, 0, count - 1)]
            down, right = _DOWN[moves[depth]], _RIGHT[moves[depth]]
            _free(
                grid,
                row + min(down, 0),
                column + min(right, 0),
                abs(down),
                abs(right),
                corridor,
                wall,
            )
            depth += 1
        else:  # a dead end: one step back
            depth -= 1
            down, right = -_DOWN[moves[depth]], -_RIGHT[moves[depth]]
        row, column = row + down, column + right
    for k in range(
        2 * tall * wide if reopen else 0
    ):  # each wall once: right of a cell, then below it
        row, column, down = k // 2 // wide, k // 2 % wide, k % 2
        if row + down < tall and column + 1 - down < wide:
            word, _, _, _ = block(seed, index, 0, MAP, number + k)
            if word < reopen:
                _free(grid, row, column, down, 1 - down, corridor, wall)


@kernel
def _free(
    grid: Bytes, row: Int, column: Int, down: Int, right: Int, corridor: Int, wall: Int
) -> None:
    """Free a cell of the lattice, or the wall below it (``down`` 1) or right of it (``right``
    1).
    """
    top = wall + row * (corridor + wall) + down * corridor
    left = wall + column * (corridor + wall) + right * corridor
    for r in range(top, top + (wall if down else corridor)):
        for c in range(left, left + (wall if right else corridor)):
            grid[r, c] = 0
