"""Files of weighted grids as other repositories have them, with paths by a slow Dijkstra.

Nothing here imports `mapdata`. The rule is that of the Warcraft sets: moves to the 8 neighbours,
and a path costs the sum of the weights of its cells.
"""

from __future__ import annotations

import heapq
import itertools
from pathlib import Path
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

Bytes: TypeAlias = npt.NDArray[np.uint8]
Ints: TypeAlias = npt.NDArray[np.int64]
Cell: TypeAlias = tuple[int, int]

LEVELS = (8, 12, 53, 77, 92)
"""The weights of the Warcraft sets, in tenths."""


def draw_costs(random: np.random.Generator, count: int, rows: int, columns: int) -> Ints:
    """Return ``count`` maps of costs, (N, H, W), each cell on its own."""
    return random.choice(np.array(LEVELS, np.int64), (count, rows, columns))


def shortest_path(costs: Ints, start: Cell, goal: Cell) -> tuple[int, Bytes]:
    """Return the sum of the costs along a shortest path, and its cells, (H, W) of 0 and 1."""
    rows, columns = costs.shape
    sums = {start: int(costs[start])}
    came_from: dict[Cell, Cell] = {}
    queue = [(sums[start], start)]
    while queue:
        cost, (row, column) = heapq.heappop(queue)
        if cost > sums[row, column]:
            continue
        for down, right in itertools.product((-1, 0, 1), repeat=2):
            neighbour = (row + down, column + right)
            if not (0 <= neighbour[0] < rows and 0 <= neighbour[1] < columns):
                continue
            new_cost = cost + int(costs[neighbour])
            if new_cost < sums.get(neighbour, 2**62):
                sums[neighbour] = new_cost
                came_from[neighbour] = (row, column)
                heapq.heappush(queue, (new_cost, neighbour))
    marks = np.zeros((rows, columns), np.uint8)
    cell = goal
    marks[cell] = 1
    while cell != start:
        cell = came_from[cell]
        marks[cell] = 1
    return sums[goal], marks


def corner_paths(costs: Ints) -> Bytes:
    """Return a shortest path from corner to corner of each map, (N, H, W) of 0 and 1."""
    _, rows, columns = costs.shape
    goal = (rows - 1, columns - 1)
    return np.stack([shortest_path(grid, (0, 0), goal)[1] for grid in costs])


def write_warcraft(
    folder: Path, costs_by_split: dict[str, Ints], dtype: str = "float16", pixels: int = 2
) -> Path:
    """Write the three files of each split; the pictures are black."""
    folder.mkdir(parents=True, exist_ok=True)
    for split, costs in costs_by_split.items():
        count, rows, columns = costs.shape
        pictures = np.zeros((count, pixels * rows, pixels * columns, 3), np.uint8)
        np.save(folder / f"{split}_maps.npy", pictures)
        np.save(folder / f"{split}_vertex_weights.npy", (costs / 10).astype(dtype))
        np.save(folder / f"{split}_shortest_paths.npy", corner_paths(costs))
    return folder


def tile_arrays(
    random: np.random.Generator, costs: Ints, targets: int = 2, sources: int = 3
) -> dict[str, npt.NDArray[np.generic]]:
    """Return the arrays of a file of tilebased_navigation_datasets, with pictures of 1 pixel."""
    count, rows, columns = costs.shape
    sizes = np.array([rows, columns])
    target_cells = random.integers(0, sizes, (count, targets, 2))
    source_cells = random.integers(0, sizes, (count, targets, sources, 2))
    paths = np.zeros((count, targets, sources, rows, columns), np.float32)
    for number, target, source in np.ndindex(count, targets, sources):
        start = tuple(source_cells[number, target, source].tolist())
        goal = tuple(target_cells[number, target].tolist())
        _, paths[number, target, source] = shortest_path(costs[number], start, goal)
    return {
        "maps": np.zeros((count, rows, columns, 3), np.uint8),
        "costs": (costs / 10).astype(np.float32),
        "targets": target_cells,
        "sources": source_cells,
        "paths": paths,
        "exp_nodes": paths,
    }
