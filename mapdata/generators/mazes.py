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
    """Mazes: perfect, with exactly one way between two cells, or with some walls opened again.

    Attributes:
        map_size: (rows, columns) of a map. Rows and columns that are too few for another corridor
            are wall, below and on the right.
        corridor: width of the corridors, in cells.
        wall: width of the walls, in cells.
        reopened: probability that a wall of the perfect maze is opened.
        seed_points: number of seed points of a map, from 2 to the number of junctions: the squares
            of ``corridor`` x ``corridor`` cells that the corridors join.
    """

    name: ClassVar[str] = "maze"
    description: ClassVar[str] = "mazes made by a random depth-first search"
    corridor: int = 1
    wall: int = 1
    reopened: float = 0.0
    seed_points: int = 5

    def __post_init__(self) -> None:
        """Check the values."""
        super().__post_init__()
        self._convert(check_count, "corridor", "wall")
        self._convert(check_probability, "reopened")
        pitch = self.corridor + self.wall
        junction_count = math.prod((side - self.wall) // pitch for side in self.map_size)
        max_count = min(junction_count, MAX_ROOMS)
        if junction_count < 2:
            raise ValueError(
                f"map_size: got {self.map_size}, expected a maze of at least 2 junctions: each has "
                f"a corridor of {self.corridor} and a wall of {self.wall} cells"
            )
        self._convert(partial(check_seed_points, max_count=max_count), "seed_points")

    def draw_grid(self, grid: Bytes, seed: np.uint64, index: np.uint64) -> None:
        """Draw map ``index`` into ``grid``, (H, W)."""
        grid[:] = 1
        _carve_maze(grid, seed, index, (self.corridor, self.wall), threshold(self.reopened))


PRESETS = {"maze": Maze(), "maze15": Maze((15, 15)), "maze30": Maze((30, 30))}


@kernel
def _carve_maze(
    grid: Bytes, seed: np.uint64, index: np.uint64, widths: Range, reopen_threshold: Int
) -> None:
    """Free the corridors of a maze in an occupied grid.

    A maze is a lattice of junctions, some of whose neighbours are joined. Blocks of stream MAP are
    numbered in the order in which they are drawn.

    Args:
        grid: (H, W) of ones.
        seed: 64-bit seed.
        index: number of the map.
        widths: width of the corridors and of the walls, in cells.
        reopen_threshold: a wall is opened if its 32-bit word is below this number.
    """
    corridor, wall = widths
    rows = (grid.shape[0] - wall) // (corridor + wall)
    columns = (grid.shape[1] - wall) // (corridor + wall)

    # A depth-first search from the junction at the upper left joins all junctions.
    visited = np.zeros((rows, columns), np.uint8)
    stack = np.zeros(rows * columns, np.int64)  # the junctions from the first to the current one
    depth = 0
    unvisited_moves = np.empty(4, np.int64)
    block_number = 0
    while depth >= 0:
        row, column = divmod(stack[depth], columns)
        visited[row, column] = 1
        _free(grid, row, column, 0, 0, widths)
        move_count = 0
        for move in range(4):
            next_row = row + STEPS[move, 0]
            next_column = column + STEPS[move, 1]
            is_inside = 0 <= next_row < rows and 0 <= next_column < columns
            if is_inside and visited[next_row, next_column] == 0:
                unvisited_moves[move_count] = move
                move_count += 1
        if move_count == 0:
            depth -= 1  # A dead end: the search goes back, and ends at the first junction.
            continue
        word, _, _, _ = block(seed, index, 0, MAP, block_number)
        block_number += 1
        down, right = STEPS[unvisited_moves[bounded(word, 0, move_count - 1)]]
        depth += 1
        stack[depth] = (row + down) * columns + column + right
        # A wall belongs to the junction above it or on its left, which may be the new one.
        _free(grid, row + min(down, 0), column + min(right, 0), abs(down), abs(right), widths)

    # Each wall may be opened: of every junction the wall on its right, then the wall below it.
    if reopen_threshold == 0:
        return
    for k in range(2 * rows * columns):
        row, column = divmod(k // 2, columns)
        down = k % 2
        right = 1 - down
        is_inner_wall = row + down < rows and column + right < columns
        if is_inner_wall:
            word, _, _, _ = block(seed, index, 0, MAP, block_number + k)
            if word < reopen_threshold:
                _free(grid, row, column, down, right, widths)


@kernel
def _free(grid: Bytes, row: Int, column: Int, down: Int, right: Int, widths: Range) -> None:
    """Free a junction of the lattice, or the wall below it or on its right.

    Args:
        grid: (H, W).
        row: row of the junction in the lattice.
        column: column of the junction in the lattice.
        down: 1 for the wall below, else 0.
        right: 1 for the wall on the right, else 0.
        widths: width of the corridors and of the walls, in cells.
    """
    corridor, wall = widths
    top = wall + row * (corridor + wall) + down * corridor
    left = wall + column * (corridor + wall) + right * corridor
    height = wall if down else corridor
    width = wall if right else corridor
    for cell_row in range(top, top + height):
        for cell_column in range(left, left + width):
            grid[cell_row, cell_column] = 0
