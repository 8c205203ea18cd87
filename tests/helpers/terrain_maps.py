"""Maps of terrain that no generator drew, as an import has them, and their shards."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mapdata import Maps, Movement
from mapdata.generators.maps import pack
from mapdata.search.labels import Labels, label
from mapdata.shards.header import Header


def random_terrain_maps(
    seed: int,
    size: tuple[int, int],
    count: int,
    movement: Movement,
    *,
    max_cost: int = 255,
    start: int = 0,
) -> Maps:
    """Return ``count`` maps of random costs, with obstacles that leave some rooms without a path.

    Each map has one to five seed points.
    """
    random = np.random.default_rng(seed)
    terrain = random.integers(1, max_cost + 1, (count, *size), np.uint8)
    terrain[random.random(terrain.shape) < 0.35] = 0
    maps = Maps.empty(movement, size, np.arange(start, start + count), 5)
    for k, grid in enumerate(terrain):
        grid[random.integers(size[0]), random.integers(size[1])] = max_cost
        free_cells = np.argwhere(grid)
        rooms = random.integers(1, 6)
        maps.rooms[k] = rooms
        maps.seed_points[k, :rooms] = random.choice(free_cells, rooms)
        maps.split[k] = random.integers(3)
    return replace(maps, packed=pack((terrain == 0).astype(np.uint8)), terrain=terrain)


def imported_header(maps: Maps) -> Header:
    """Return the header of a shard of these maps, as an import writes it."""
    return Header(
        generator=None,
        seed=None,
        map_size=(maps.packed.shape[1], maps.columns),
        movement=maps.movement,
        resolution=0.5,
        has_terrain=maps.terrain is not None,
        start=int(maps.index[0]),
        stop=int(maps.index[-1]) + 1,
    )


def labelled_terrain(seed: int, size: tuple[int, int], count: int, movement: Movement) -> Labels:
    """Return `random_terrain_maps` with their labels."""
    return label(random_terrain_maps(seed, size, count, movement))
