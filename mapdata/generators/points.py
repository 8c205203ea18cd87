"""Seed points: random free cells of maps that have no rooms (stream 5 of docs/format.md)."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.checks import check_count
from mapdata.generators.generator import MapGenerator
from mapdata.generators.maps import Maps, pack
from mapdata.generators.splits import draw_splits, split_thresholds
from mapdata.jit import Int, inlined, kernel
from mapdata.limits import MAX_ROOMS
from mapdata.rng import POINTS, block, bounded

_BLOCKS_PER_POINT = 2
"""Blocks of random words for each seed point: 8 words draw 8 candidates."""


def check_seed_points(name: str, count: object, max_count: int = MAX_ROOMS) -> int:
    """Return a number of seed points as an int.

    Raises:
        ValueError: not an integer from 2 to ``max_count``.
    """
    points = check_count(name, count, 2)
    if points > max_count:
        raise ValueError(f"{name}: got {points}, expected at most {max_count} here")
    return points


class Scattered(MapGenerator):
    """A family of maps without rooms: a subclass draws the grids, and seed points are scattered.

    A subclass has the field ``seed_points`` and implements `draw_grid`.
    """

    seed_points: int

    @property
    def max_seed_points(self) -> int:
        """The largest number of seed points of a map."""
        return self.seed_points

    @abstractmethod
    def draw_grid(self, grid: Bytes, seed: np.uint64, index: np.uint64) -> None:
        """Draw map ``index`` into ``grid``, (H, W) of zeros: 0 free and 1 occupied."""

    def draw(self, seed: int, indices: Ints) -> Maps:
        """Return the maps ``indices``, (N,) int64."""
        grids = np.zeros((len(indices), *self.map_size), np.uint8)
        for grid, index in zip(grids, indices, strict=True):
            self.draw_grid(grid, np.uint64(seed), np.uint64(index))
        return with_seed_points(self, seed, indices, grids)


def with_seed_points(generator: MapGenerator, seed: int, indices: Ints, grids: Bytes) -> Maps:
    """Return grids as maps of (generator, seed), with seed points far apart.

    The seed points are different free cells of the largest component of a map, up to
    ``generator.max_seed_points`` of them.

    Args:
        generator: the generator.
        seed: 64-bit seed.
        indices: (N,) int64, number of each map.
        grids: (N, H, W) uint8, 0 free and 1 occupied.

    Raises:
        ValueError: the grids do not have the size of the generator's maps, or are no integers.
    """
    maps = _maps_of_grids(generator, seed, indices, grids)
    key = np.uint64(seed)
    for k, grid in enumerate(grids):
        # Straight steps are legal under every movement, so they join the seed points under each.
        cells = largest_component(grid, 0)
        points = spread_points(
            cells, maps.columns, key, np.uint64(indices[k]), generator.max_seed_points
        )
        rows, columns = np.divmod(points, maps.columns)
        maps.rooms[k] = len(points)
        maps.seed_points[k, : len(points), 0] = rows
        maps.seed_points[k, : len(points), 1] = columns
    return maps


def with_corner_points(generator: MapGenerator, seed: int, indices: Ints, grids: Bytes) -> Maps:
    """Return grids as maps of (generator, seed) with two seed points: opposite corners.

    They are the upper left and the lower right corner, which have to be free. A map of a single
    cell has one seed point.

    Args:
        generator: the generator.
        seed: 64-bit seed.
        indices: (N,) int64, number of each map.
        grids: (N, H, W) uint8, 0 free and 1 occupied.

    Raises:
        ValueError: the grids do not have the size of the generator's maps, or are no integers.
    """
    maps = _maps_of_grids(generator, seed, indices, grids)
    rows, columns = generator.map_size
    corners = [(0, 0), (rows - 1, columns - 1)][: rows * columns]
    maps.rooms[:] = len(corners)
    maps.seed_points[:, : len(corners)] = corners
    return maps


def _maps_of_grids(generator: MapGenerator, seed: int, indices: Ints, grids: Bytes) -> Maps:
    """Return grids as maps of (generator, seed), still without seed points."""
    if grids.shape != (len(indices), *generator.map_size):
        raise ValueError(
            f"grids: got shape {grids.shape}, expected {len(indices)} maps of {generator.map_size}"
        )
    if grids.dtype.kind not in "bui":
        raise ValueError(f"grids: got {grids.dtype}, expected uint8, 0 free and 1 occupied")
    maps = Maps.empty(generator.movement, generator.map_size, indices, generator.max_seed_points)
    maps.packed[:] = pack(grids)
    maps.split[:] = draw_splits(np.uint64(seed), indices, split_thresholds(generator.splits))
    return maps


@kernel
def largest_component(grid: Bytes, diagonals: Int) -> Ints:
    """Return the free cells of the largest connected component of a grid.

    Args:
        grid: (H, W), 0 free.
        diagonals: 0 without diagonal moves, 1 with those between two free cells, 2 with all
            diagonal moves. 0 and 1 give the same components, since two straight moves lead around
            a diagonal one between free cells.

    Returns:
        The numbers row * W + column of the cells, in ascending order. Of equally large components
        the one whose first cell comes first is chosen.
    """
    _, columns = grid.shape
    run_rows, run_starts, run_ends, roots, sizes = _connected_runs(grid, diagonals)
    run_count = len(roots)
    largest = 0
    for run in range(run_count):
        if sizes[run] > sizes[largest]:
            largest = run
    cells = np.empty(sizes[largest] if run_count > 0 else 0, np.int64)
    cell_count = 0
    for run in range(run_count):
        if roots[run] == largest:
            for column in range(run_starts[run], run_ends[run]):
                cells[cell_count] = run_rows[run] * columns + column
                cell_count += 1
    return cells


@kernel
def count_components(grid: Bytes, diagonals: Int, min_cells: Int) -> Int:
    """Return how many connected components of free cells have at least ``min_cells`` cells.

    Args:
        grid: (H, W), 0 free.
        diagonals: as for `largest_component`.
        min_cells: at least 1.
    """
    _, _, _, _, sizes = _connected_runs(grid, diagonals)
    count = 0
    for size in sizes:
        if size >= min_cells:
            count += 1
    return count


@kernel
def _connected_runs(grid: Bytes, diagonals: Int) -> tuple[Ints, Ints, Ints, Ints, Ints]:
    """Return the runs of free cells of a grid, and which of them are connected.

    A run is a longest row of adjacent free cells. The cells of a run are connected, so that
    components are found by joining the few runs that touch.

    Args:
        grid: (H, W), 0 free.
        diagonals: as for `largest_component`.

    Returns:
        Five arrays (K,) of the K runs in reading order: the row of each run, its first column, the
        column after its last one, the root of its component, which is the component's earliest run,
        and the number of cells of the component if the run is a root, else 0.
    """
    rows, columns = grid.shape
    # Diagonal moves between occupied cells also join runs that meet at a corner only.
    reach = 1 if diagonals == 2 else 0
    max_runs = rows * ((columns + 1) // 2)
    run_rows = np.empty(max_runs, np.int64)
    run_starts = np.empty(max_runs, np.int64)
    run_ends = np.empty(max_runs, np.int64)
    # A forest of runs: each points to itself, or to an earlier run of its component.
    parents = np.empty(max_runs, np.int64)
    run_count = 0
    row_above = 0  # the first run of the row above
    for row in range(rows):
        above = row_above
        row_above = run_count
        column = 0
        while column < columns:
            if grid[row, column] != 0:
                column += 1
                continue
            start = column
            while column < columns and grid[row, column] == 0:
                column += 1
            run_rows[run_count] = row
            run_starts[run_count] = start
            run_ends[run_count] = column
            parents[run_count] = run_count
            # Runs of the row above that end left of this one cannot touch later ones either.
            while above < row_above and run_ends[above] + reach <= start:
                above += 1
            touching = above
            while touching < row_above and run_starts[touching] < column + reach:
                root_above = _root(parents, touching)
                root = _root(parents, run_count)
                parents[max(root, root_above)] = min(root, root_above)
                touching += 1
            run_count += 1
    # The root of a component is its earliest run, which holds its first cell.
    sizes = np.zeros(run_count, np.int64)
    for run in range(run_count):
        parents[run] = parents[parents[run]]  # Earlier runs already point to their roots.
        sizes[parents[run]] += run_ends[run] - run_starts[run]
    return run_rows, run_starts, run_ends, parents[:run_count], sizes


@inlined
def _root(parents: Ints, run: Int) -> Int:
    """Return the root of the component of a run, and shorten the way to it."""
    while parents[run] != run:
        parents[run] = parents[parents[run]]
        run = parents[run]
    return run


@kernel
def draw_points(cells: Ints, seed: np.uint64, index: np.uint64, count: Int) -> Ints:
    """Return ``count`` different cells of ``cells``, each drawn uniformly from the remaining ones.

    The remaining cells keep their order, so that draw k depends on the earlier draws alone.
    """
    remaining = list(cells)
    points = np.empty(count, np.int64)
    for k in range(count):
        word, _, _, _ = block(seed, index, 0, POINTS, k)
        points[k] = remaining.pop(bounded(word, 0, len(remaining) - 1))
    return points


@kernel
def spread_points(cells: Ints, columns: Int, seed: np.uint64, index: np.uint64, count: Int) -> Ints:
    """Return up to ``count`` different cells of ``cells`` that lie far apart.

    Mitchell's best-candidate sampling: for each point 8 candidates are drawn uniformly, and the
    candidate whose nearest earlier point is farthest away is taken (the first drawn, if several are
    equally far). Mitchell, "Spectrally optimal sampling for distribution ray tracing", SIGGRAPH
    1991, section 4.

    Args:
        cells: the numbers row * ``columns`` + column of the cells.
        columns: columns of the map.
        seed: 64-bit seed.
        index: number of the map.
        count: number of points; fewer are returned if there are fewer cells.
    """
    count = min(count, len(cells))
    points = np.empty(count, np.int64)
    for k in range(count):
        best = np.int64(-1)
        max_distance = np.int64(-1)
        for j in range(_BLOCKS_PER_POINT):
            for word in block(seed, index, 0, POINTS, _BLOCKS_PER_POINT * k + j):
                candidate = bounded(word, 0, len(cells) - 1)
                distance = _squared_distance(cells[candidate], points[:k], columns)
                if distance > max_distance:
                    best = candidate
                    max_distance = distance
        # If all candidates are points already, the next cell that is not a point is taken.
        while _squared_distance(cells[best], points[:k], columns) == 0:
            best = (best + 1) % len(cells)
        points[k] = cells[best]
    return points


@kernel
def _squared_distance(cell: Int, points: Ints, columns: Int) -> Int:
    """Return the squared distance from a cell to the nearest of ``points``; 2**62 without any."""
    min_distance = np.int64(2**62)
    for point in points:
        rows_apart = cell // columns - point // columns
        columns_apart = cell % columns - point % columns
        min_distance = min(min_distance, rows_apart**2 + columns_apart**2)
    return min_distance
