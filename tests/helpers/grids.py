"""Grids that are hard to search, and the distances on them by scipy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse import csgraph

from helpers.reference import Cell
from mapdata import Movement
from mapdata.arrays import Bytes

Array: TypeAlias = npt.NDArray[Any]


def serpentine(height: int, width: int, source: np.random.Generator) -> npt.NDArray[np.uint8]:
    """Return rows of wall with one gap each: long detours, where A* changes its mind."""
    grid = np.zeros((height, width), dtype=np.uint8)
    grid[1::2] = 1
    grid[np.arange(1, height, 2), source.integers(0, width, size=height // 2)] = 0
    return grid


def random_grids(count: int, rows: int = 12, columns: int = 70) -> list[Bytes]:
    """Return grids with a third of the cells occupied."""
    noise = np.random.default_rng(0).random((count, rows, columns))
    return list((noise < 0.3).astype(np.uint8))


def squared_half_cells(grid: Bytes) -> npt.NDArray[np.int64]:
    """Return the squared clearance in half cells: every cell against every obstacle."""
    rows, columns = grid.shape
    found = np.zeros(grid.shape, np.int64)
    obstacles = np.argwhere(grid)
    for row, column in np.argwhere(grid == 0):
        gaps = [2 * int(side) + 1 for side in (row, column, rows - 1 - row, columns - 1 - column)]
        steps = np.maximum(0, 2 * np.abs(obstacles - (row, column)) - 1)
        to_obstacles = (steps**2).sum(axis=1).min(initial=min(gaps) ** 2)
        found[row, column] = to_obstacles
    return found


def scipy_distances(
    grid: Array, cells: Sequence[Cell], movement: Movement, terrain: Array | None = None
) -> npt.NDArray[np.float64]:
    """Return (n, H, W) distances from n cells, -1 unreachable, by scipy.

    The edges of one direction are those between the free cells of the grid and of a shifted copy.
    On terrain a move costs the mean of its two cells times its length.
    """
    weights = np.pad(np.ones(grid.shape) if terrain is None else terrain.astype(float), 1)
    height, width = grid.shape
    free = np.pad(grid == 0, 1)
    number = np.pad(np.arange(height * width).reshape(height, width), 1)

    def shifted(array: Array, down: int, right: int) -> Array:
        """Return, per cell, the array's value at its neighbour."""
        return array[1 + down : 1 + down + height, 1 + right : 1 + right + width]

    rows = []
    columns = []
    costs = []
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            diagonal = down != 0 and right != 0
            if (down, right) == (0, 0) or (movement.connectivity == 4 and diagonal):
                continue
            usable = shifted(free, 0, 0) & shifted(free, down, right)
            if diagonal and not movement.corner_cutting:
                usable = usable & shifted(free, down, 0) & shifted(free, 0, right)
            rows.append(shifted(number, 0, 0)[usable])
            columns.append(shifted(number, down, right)[usable])
            length = movement.diagonal_cost if diagonal else 1.0
            means = (shifted(weights, 0, 0) + shifted(weights, down, right)) / 2
            costs.append(means[usable] * length)
    edges = (np.concatenate(costs), (np.concatenate(rows), np.concatenate(columns)))
    graph = sparse.csr_array(edges, shape=(grid.size, grid.size))
    distances = csgraph.dijkstra(graph, indices=[row * width + column for row, column in cells])
    distances = distances.reshape(len(cells), height, width)
    return np.where(np.isinf(distances), -1.0, distances)
