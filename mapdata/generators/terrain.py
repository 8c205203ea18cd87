"""Terrain: maps whose free cells have costs, drawn as smooth noise that is cut into levels.

The noise is value noise: random numbers on a lattice, with smooth transitions between them. Cells
are ranked by it, so that each map has the same share of every level and of obstacles. All numbers
are integers, so that all machines draw the same maps. docs/format.md states each step.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import accumulate
from typing import Any, ClassVar

import numpy as np

from mapdata.arrays import Bytes, Int32s, Ints, UInt32s, Words
from mapdata.checks import check_count, check_flag, check_probability, check_shares_if_any, items_of
from mapdata.generators.generator import MapGenerator, default_of
from mapdata.generators.maps import Maps
from mapdata.generators.points import check_seed_points, with_corner_points, with_seed_points
from mapdata.jit import Int, kernel
from mapdata.limits import MAX_CELL_COST, MAX_SIDE
from mapdata.movement import Movement
from mapdata.rng import TERRAIN, block, bounded, threshold

_HEIGHTS, _OBSTACLES = 0, 2
"""The number of the first octave of each noise of a map; each noise has two octaves."""

_BLOCKS_PER_OCTAVE = np.int64(2**22)
"""Blocks of random words that are kept for each octave. The largest lattice, 4,097 x 4,097, needs
2,098,178 of them.
"""

_HALF_BITS = np.uint64(16)
_HALF_MASK = np.uint64(0xFFFF)
"""A random word of 32 bits has two halves of 16 bits, each of which is a number of the lattice."""

_WEIGHT_BITS = 16
"""Weights of interpolation are multiples of 2**-16."""

_NOISE_BITS = 12
"""The noise of a cell is below 2**12."""

_LAST = 2**_NOISE_BITS
"""The noise of cells that come after all others."""


_DECIDED_BY_OVER = ("obstacles", "seed_points", "corners")
"""The parameters of terrain that have no meaning for maps of another generator."""


def _check_costs(name: str, values: object) -> tuple[int, ...]:
    """Return ``values`` as the costs of 1 to 255 levels.

    Raises:
        ValueError: no costs, too many, or one that is not an integer from 1 to 255.
    """
    costs = tuple(check_count(name, cost) for cost in items_of(values))
    # No map has more levels than there are costs.
    if not 1 <= len(costs) <= MAX_CELL_COST or max(costs) > MAX_CELL_COST:
        raise ValueError(
            f"{name}: got {values!r}, expected 1 to {MAX_CELL_COST} costs, integers from 1 to "
            f"{MAX_CELL_COST}"
        )
    return costs


def _check_scale(name: str, value: object) -> int:
    """Return ``value`` as a number of cells, 1 to `MAX_SIDE`."""
    scale = check_count(name, value)
    if scale > MAX_SIDE:
        raise ValueError(f"{name}: got {scale}, expected at most {MAX_SIDE} cells")
    return scale


@dataclass(frozen=True)
class Terrain(MapGenerator):
    """Maps whose free cells have costs: hills and valleys in levels, with obstacles between them.

    Attributes:
        map_size: (rows, columns) of a map.
        costs: the costs of the levels, 1 to 255 each, from the lowest ground to the highest. They
            need not ascend.
        shares: the share of the free cells that each level covers, the same in every map up to
            rounding; () for equal shares.
        scale: size of hills, valleys and obstacles, in cells, 1 to ``MAX_SIDE``; 1 is noise.
        obstacles: share of occupied cells, the same in every map up to rounding. A map of obstacles
            alone has one free cell (with ``corners`` both corners).
        seed_points: number of seed points of a map; fewer if its largest component has fewer cells.
        corners: whether the seed points are the upper left and the lower right corner instead,
            which are always free. Obstacles may leave no path between them.
        over: the generator whose free cells get the costs; None for maps of terrain alone. Its maps
            stay as they are: it decides on map size, resolution, movement, splits, obstacles and
            seed points, so that these parameters have to be left out here.

    Raises:
        ValueError: a value outside these limits, or one that only ``over`` decides on.
    """

    name: ClassVar[str] = "terrain"
    generator_parameters: ClassVar[tuple[str, ...]] = ("over",)
    costs: tuple[int, ...] = tuple(range(1, 11))
    shares: tuple[float, ...] = ()
    scale: int = 8
    obstacles: float = 0.1
    seed_points: int = 5
    corners: bool = False
    over: MapGenerator | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        super().__post_init__()
        self._convert(_check_costs, "costs")
        self._convert(partial(check_shares_if_any, count=len(self.costs)), "shares")
        self._convert(_check_scale, "scale")
        self._convert(check_probability, "obstacles")
        self._convert(check_seed_points, "seed_points")
        check_flag("corners", self.corners)
        if self.over is not None:
            self._take_parameters_of(self.over)

    def _take_parameters_of(self, over: MapGenerator) -> None:
        """Check the generator ``over`` and take the parameters that it decides on.

        Raises:
            ValueError: it is no generator or has terrain itself, or a parameter that it decides on
                has a value of its own here.
        """
        if not isinstance(over, MapGenerator):
            raise ValueError(f"over: got {over!r}, expected a MapGenerator, such as Cave()")
        if over.has_terrain:
            raise ValueError(f"over: got {over!r}, expected a generator without terrain of its own")
        self._take_shared_parameters("over", over)
        for name in _DECIDED_BY_OVER:
            if getattr(self, name) != default_of(type(self), name):
                raise ValueError(
                    f"{name}: got {getattr(self, name)!r}, but the maps of `over` keep their own "
                    "obstacles and seed points; leave it out"
                )

    @property
    def description(self) -> str:  # type: ignore[override]  # depends on ``over``
        """What the maps are, as the dataset card says it."""
        if self.over is None:
            return "terrain whose cells have costs"
        return f"terrain with costs over {self.over.description}"

    @property
    def citation(self) -> str:  # type: ignore[override]  # depends on ``over``
        """The sentence that introduces the paper on the dataset card."""
        return MapGenerator.citation if self.over is None else self.over.citation

    @property
    def has_terrain(self) -> bool:
        """Terrain has terrain."""
        return True

    @property
    def max_seed_points(self) -> int:
        """The largest number of seed points of a map."""
        if self.over is not None:
            return self.over.max_seed_points
        return 2 if self.corners else self.seed_points

    def to_dict(self) -> dict[str, Any]:
        """Return the parameters as plain values for JSON, without those that `over` decides on.

        Those that every family has stay.
        """
        values = super().to_dict()
        if self.over is not None:
            for name in _DECIDED_BY_OVER:
                del values[name]
        return values

    def draw(self, seed: int, indices: Ints) -> Maps:
        """Return the maps ``indices``, (N,) int64."""
        key = np.uint64(seed)
        if self.over is None:
            occupancy = np.zeros((len(indices), *self.map_size), np.uint8)
            cell_count = self.map_size[0] * self.map_size[1]
            obstacle_cells = round(self.obstacles * cell_count)
            if obstacle_cells > 0:
                _place_obstacles(occupancy, key, indices, self.scale, obstacle_cells, self.corners)
            with_points = with_corner_points if self.corners else with_seed_points
            maps = with_points(self, seed, indices, occupancy)
        else:
            maps = self.over.draw(seed, indices)
            occupancy = maps.occupancy
        shares = self.shares or (1 / len(self.costs),) * len(self.costs)
        # The last limit takes all cells, although the sum of the shares may differ from 1 slightly.
        limits = [min(threshold(total), 2**32) for total in accumulate(shares[:-1])] + [2**32]
        terrain = np.empty_like(occupancy)
        _fill_levels(
            terrain,
            occupancy,
            key,
            indices,
            self.scale,
            np.array(self.costs, np.uint8),
            np.array(limits, np.uint64),
        )
        return replace(maps, terrain=terrain)


PRESETS = {
    "terrain": Terrain(movement=Movement(8)),
    "tiles": Terrain(
        (12, 12),
        costs=(8, 12, 53, 77, 92),
        scale=5,
        obstacles=0.0,
        corners=True,
        movement=Movement(8, corner_cutting=True, diagonal_cost=1.0),
    ),
}


@kernel
def _place_obstacles(
    occupancy: Bytes,
    seed: np.uint64,
    indices: Ints,
    scale: Int,
    obstacle_cells: Int,
    corners_free: bool,
) -> None:
    """Make the cells of each map occupied whose noise is the highest.

    Args:
        occupancy: (N, H, W), is filled with 0 free and 1 occupied.
        seed: 64-bit seed.
        indices: (N,), numbers of the maps.
        scale: size of the obstacles, in cells.
        obstacle_cells: number of cells to occupy; fewer if no other cell would be free.
        corners_free: whether the upper left and the lower right corner stay free. Otherwise any one
            cell stays free.
    """
    map_count, rows, columns = occupancy.shape
    cell_count = rows * columns
    noise = np.empty((rows, columns), np.uint32)
    flat_noise = noise.reshape(-1)
    min_free_cells = min(2, cell_count) if corners_free else 1
    occupied_by_rank = np.zeros(cell_count, np.uint8)
    occupied_by_rank[max(cell_count - obstacle_cells, min_free_cells) :] = 1
    next_ranks = np.empty(_LAST + 1, np.int32)
    for k in range(map_count):
        _fill_noise(noise, seed, np.uint64(indices[k]), _OBSTACLES, scale)
        if corners_free:
            # The other cells move up by one, so that the corners alone have the lowest noise.
            for cell in range(cell_count):
                flat_noise[cell] += np.uint32(1)
            flat_noise[0] = 0
            flat_noise[cell_count - 1] = 0
        _fill_by_rank(occupancy[k].reshape(-1), flat_noise, occupied_by_rank, next_ranks)


@kernel
def _fill_levels(
    terrain: Bytes,
    occupancy: Bytes,
    seed: np.uint64,
    indices: Ints,
    scale: Int,
    costs: Bytes,
    limits: Words,
) -> None:
    """Give the free cells of each map the costs of their levels, from the lowest noise on.

    Args:
        terrain: (N, H, W), is filled with the costs; 0 on occupied cells.
        occupancy: (N, H, W), 0 free and 1 occupied.
        seed: 64-bit seed.
        indices: (N,), numbers of the maps.
        scale: size of hills and valleys, in cells.
        costs: (L,), the cost of each level.
        limits: (L,), the share of the free cells that lie in a level or under it, times 2**32.
    """
    map_count, rows, columns = terrain.shape
    noise = np.empty((rows, columns), np.uint32)
    flat_noise = noise.reshape(-1)
    cost_by_rank = np.empty(rows * columns, np.uint8)
    next_ranks = np.empty(_LAST + 1, np.int32)
    for k in range(map_count):
        _fill_noise(noise, seed, np.uint64(indices[k]), _HEIGHTS, scale)
        is_occupied = occupancy[k].reshape(-1)
        occupied_cells = np.int64(0)
        for cell in range(rows * columns):
            occupied_cells += is_occupied[cell]
            flat_noise[cell] = np.uint32(_LAST) if is_occupied[cell] else flat_noise[cell]
        free_cells = rows * columns - occupied_cells
        level_start = np.int64(0)
        for level in range(len(costs)):
            # The limit is rounded to the nearest whole number of cells, halves up.
            level_end = (free_cells * np.int64(limits[level]) + 2**31) >> 32
            cost_by_rank[level_start:level_end] = costs[level]
            level_start = level_end
        cost_by_rank[free_cells:] = 0
        _fill_by_rank(terrain[k].reshape(-1), flat_noise, cost_by_rank, next_ranks)


@kernel
def _fill_noise(noise: UInt32s, seed: np.uint64, index: np.uint64, octave: Int, scale: Int) -> None:
    """Fill ``noise``, (H, W), with two octaves of value noise, whole numbers below 3,072.

    The second octave has half the spacing and half the weight of the first.

    Args:
        noise: (H, W), is filled.
        seed: 64-bit seed.
        index: number of the map.
        octave: number of the first octave.
        scale: spacing of the first octave, in cells.
    """
    noise[:] = 0
    _add_octave(noise, seed, index, octave, scale, np.uint32(2))
    _add_octave(noise, seed, index, octave + 1, (scale + 1) // 2, np.uint32(1))
    flat_noise = noise.reshape(-1)
    for cell in range(len(flat_noise)):
        flat_noise[cell] = np.uint32(flat_noise[cell] >> np.uint32(6))


@kernel
def _add_octave(
    noise: UInt32s, seed: np.uint64, index: np.uint64, octave: Int, spacing: Int, factor: np.uint32
) -> None:
    """Add ``factor`` times an octave of value noise, whole numbers below 2**16.

    The lattice is moved by a random number of rows and columns, so that its points are at no
    particular cells.

    Args:
        noise: (H, W), is added to.
        seed: 64-bit seed.
        index: number of the map.
        octave: number of the octave, which says where its random words are.
        spacing: distance between the points of the lattice, in cells.
        factor: what the octave is multiplied by.
    """
    rows, columns = noise.shape
    block_number = octave * _BLOCKS_PER_OCTAVE
    row_word, column_word, _, _ = block(seed, index, 0, TERRAIN, block_number)
    first_row = bounded(row_word, 0, spacing - 1)
    first_column = bounded(column_word, 0, spacing - 1)
    lattice_rows = (first_row + rows - 1) // spacing + 2
    lattice_columns = (first_column + columns - 1) // spacing + 2
    lattice_blocks = (lattice_rows * lattice_columns + 7) // 8
    lattice = np.empty(8 * lattice_blocks, np.uint16)
    point = 0
    for _ in range(lattice_blocks):
        block_number += 1
        for word in block(seed, index, 0, TERRAIN, block_number):
            lattice[point] = word & _HALF_MASK
            lattice[point + 1] = word >> _HALF_BITS
            point += 2
    # The smooth step 3 x**2 - 2 x**3 for x = step / spacing, times 2**16.
    weights = np.empty(spacing, np.uint32)
    for step in range(spacing):
        cubic = step * step * (3 * spacing - 2 * step)
        weights[step] = (cubic << _WEIGHT_BITS) // spacing**3
    # Interpolate between the columns of the lattice first: these rows are few.
    full_weight = np.uint32(2**_WEIGHT_BITS)  # the weights of two neighbours add up to this
    bits = np.uint32(_WEIGHT_BITS)
    stretched = np.empty((lattice_rows, columns), np.uint32)
    for lattice_row in range(lattice_rows):
        point = lattice_row * lattice_columns
        step = first_column
        for column in range(columns):
            left = np.uint32(lattice[point] * np.uint32(full_weight - weights[step]))
            right = np.uint32(lattice[point + 1] * weights[step])
            stretched[lattice_row, column] = np.uint32(left + right) >> bits
            step += 1
            if step == spacing:
                step = 0
                point += 1
    for row in range(rows):
        lattice_row, step = divmod(first_row + row, spacing)
        above = stretched[lattice_row]
        below = stretched[lattice_row + 1]
        weight_below = weights[step]
        weight_above = np.uint32(full_weight - weight_below)
        noise_row = noise[row]
        for column in range(columns):  # The compiler turns this loop into vector instructions.
            upper = np.uint32(above[column] * weight_above)
            lower = np.uint32(below[column] * weight_below)
            noise_row[column] += np.uint32(np.uint32(upper + lower) >> bits) * factor


@kernel
def _fill_by_rank(cells: Bytes, noise: UInt32s, number_by_rank: Bytes, next_ranks: Int32s) -> None:
    """Give each cell the number that belongs to its rank, by counting sort.

    Args:
        cells: (H * W,), is filled.
        noise: (H * W,), by which the cells are ranked from 0, equal ones in row-major order; at
            most `_LAST`.
        number_by_rank: (H * W,), the number of each rank.
        next_ranks: (`_LAST` + 1,), memory that is overwritten.
    """
    # Count how many cells have each noise.
    next_ranks[:] = 0
    for cell in range(len(cells)):
        next_ranks[np.int64(noise[cell])] += 1
    # Replace the counts by the rank of the first cell of each noise.
    cells_below = np.int32(0)
    for height in range(len(next_ranks)):
        cell_count = next_ranks[height]
        next_ranks[height] = cells_below
        cells_below += cell_count
    # Each cell takes the next rank of its noise.
    for cell in range(len(cells)):
        noise_of_cell = np.int64(noise[cell])
        rank = next_ranks[noise_of_cell]
        next_ranks[noise_of_cell] = rank + 1
        cells[cell] = number_by_rank[rank]
