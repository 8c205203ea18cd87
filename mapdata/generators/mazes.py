"""Mazes: corridors of one width between walls of one width, every two cells joined by exactly one way, or by more.

A random depth-first search of a lattice of corridor cells ("recursive backtracker") opens a wall each time it reaches
a new cell, so that the open walls are a spanning tree: a perfect maze. Then each wall that is left may be reopened,
which makes loops. Source: J. Buck, "Mazes for Programmers", 2015, chapter 5.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.generators.generator import Generator
from mapdata.generators.maps import Maps, pack
from mapdata.generators.points import draw_points
from mapdata.generators.splits import draw_splits, split_thresholds
from mapdata.jit import Int, kernel
from mapdata.rng import MAP, block, bounded, threshold
from mapdata.spec import MAX_ROOMS, Movement, Range, check_count, check_number


@dataclass(frozen=True)
class Maze(Generator):
    """A distribution of mazes.

    Attributes:
        map_size: (rows, columns) of a map, in cells; what the lattice leaves at the lower and right edge is wall.
        corridor: width of the corridors, in cells.
        wall: width of the walls, in cells.
        reopened: probability that a wall of the perfect maze is opened; 0 leaves one way between any two cells.
        seed_points: how many seed points a map has, 2 to ``MAX_ROOMS``: free cells, uniform, none twice.
        resolution: metres per cell.
        movement: how paths move.
        splits: fractions of maps in train, val and test; they add up to 1.

    Raises:
        ValueError: a value outside these limits, or a map too small for the seed points.
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
        object.__setattr__(self, "reopened", check_number("reopened", self.reopened))
        if not 0 <= self.reopened <= 1:
            raise ValueError(f"reopened: got {self.reopened}, expected a probability in [0, 1]")
        if self.seed_points > MAX_ROOMS:
            raise ValueError(f"seed_points: got {self.seed_points}, expected at most {MAX_ROOMS}")
        tall, wide = ((side - self.wall) // (self.corridor + self.wall) for side in self.map_size)
        if min(tall, wide) < 1 or tall * wide * self.corridor**2 < self.seed_points:
            raise ValueError(f"map_size: {self.map_size} is too small for a maze with {self.seed_points} seed points")

    @property
    def most_seed_points(self) -> int:
        """How many seed points every map has."""
        return self.seed_points

    def draw(self, seed: int, indices: Ints) -> Maps:
        """Return the maps ``indices``, (N,) int64."""
        maps = Maps.empty(self.movement, self.map_size, indices, self.seed_points)
        grids = np.ones((len(indices), *self.map_size), np.uint8)
        key = np.uint64(seed)
        reopen = np.uint64(threshold(self.reopened))
        for k, grid in enumerate(grids):
            index = np.uint64(indices[k])
            _carve_maze(grid, key, index, self.corridor, self.wall, reopen)
            free = np.flatnonzero(grid.reshape(-1) == 0)
            points = draw_points(free, key, index, self.seed_points)
            maps.seed_points[k] = np.stack(np.divmod(points, maps.columns), axis=1)
        maps.packed[:] = pack(grids)
        maps.rooms[:] = self.seed_points
        maps.split[:] = draw_splits(key, indices, split_thresholds(self.splits))
        return maps


PRESETS: dict[str, Generator] = {"maze": Maze()}


_DOWN = np.array([-1, 0, 1, 0])
_RIGHT = np.array([0, 1, 0, -1])


@kernel
def _carve_maze(grid: Bytes, seed: np.uint64, index: np.uint64, corridor: Int, wall: Int, reopen: np.uint64) -> None:
    """Free the corridors of an occupied ``grid``, (H, W). Blocks of stream MAP are numbered as they are drawn."""
    tall = (grid.shape[0] - wall) // (corridor + wall)
    wide = (grid.shape[1] - wall) // (corridor + wall)
    stack = np.empty((tall * wide, 2), np.int64)
    fresh = np.empty(4, np.int64)
    seen = np.zeros((tall, wide), np.uint8)
    row: Int = 0
    column: Int = 0
    depth, number = 0, 0
    while True:
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
            move = int(fresh[bounded(word, 0, count - 1)])
            stack[depth, 0] = row
            stack[depth, 1] = column
            depth += 1
            # the wall between two cells is the one below or right of the first of them
            r, c = row + min(_DOWN[move], 0), column + min(_RIGHT[move], 0)
            _free(grid, r, c, abs(_DOWN[move]), abs(_RIGHT[move]), corridor, wall)
            row += _DOWN[move]
            column += _RIGHT[move]
        elif depth:
            depth -= 1
            row = stack[depth, 0]
            column = stack[depth, 1]
        else:
            break
    for row in range(tall if reopen else 0):
        for column in range(wide):
            for down in range(2):
                right = 1 - down
                if row + down < tall and column + right < wide:
                    word, _, _, _ = block(seed, index, 0, MAP, number)
                    number += 1
                    if word < reopen:
                        _free(grid, row, column, down, right, corridor, wall)


@kernel
def _free(grid: Bytes, row: Int, column: Int, down: Int, right: Int, corridor: Int, wall: Int) -> None:
    """Free a cell of the lattice, or the wall below it (``down`` 1) or right of it (``right`` 1)."""
    top = wall + row * (corridor + wall) + down * corridor
    left = wall + column * (corridor + wall) + right * corridor
    for r in range(top, top + (wall if down else corridor)):
        for c in range(left, left + (wall if right else corridor)):
            grid[r, c] = 0
