"""A small generator of each family, and a family in a module that a process may know or not."""

from __future__ import annotations

import sys
from pathlib import Path

from mapdata import (
    Cave,
    Forest,
    MapGenerator,
    MapSpec,
    Maze,
    Mixture,
    Movement,
    RandomWalls,
    Terrain,
)
from mapdata.generators.generator import GENERATORS, _presets, register_installed
from mapdata.generators.stored_families import _cached_generator

KNOWN = ", ".join(GENERATORS)
"""The families of mapdata as messages list them."""

HALVES: tuple[float, float, float] = (0.5, 0.25, 0.25)
SMALL: dict[str, MapGenerator] = {
    generator.name: generator
    for generator in (
        MapSpec(
            (20, 70),
            (2, 5),
            (2, 8),
            (3, 12),
            (1, 2),
            skip_probability=0.5,
            movement=Movement(8, corner_cutting=True, diagonal_cost=1),
        ),
        Maze((20, 31), corridor=2, reopened=0.1, seed_points=4, splits=HALVES),
        Cave((20, 31), occupied=0.4, steps=3, seed_points=4, splits=HALVES),
        Forest((20, 31), cover=(0.2, 0.3), sizes=(1, 5), seed_points=4, splits=HALVES),
        RandomWalls((20, 31), occupied=(0.2, 0.4), seed_points=4, splits=HALVES),
        Terrain((20, 31), seed_points=4, movement=Movement(8), splits=HALVES),
    )
}
SMALL["mixture"] = Mixture(
    parts=(SMALL["cave"], SMALL["forest"], SMALL["random_walls"]), shares=(0.5, 0.3, 0.2)
)
"""A generator of small maps of each family. tests/shards/test_builder.py has the hashes of their
maps, and fails until a new family is among them.
"""

UNIFORM = {name: generator for name, generator in SMALL.items() if not generator.has_terrain}
"""Those whose free cells all cost the same."""

PILLARS = """
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from mapdata.generators import MapGenerator, register, with_seed_points
from mapdata.checks import check_integers


@dataclass(frozen=True)
class Pillars(MapGenerator):
    name: ClassVar[str] = "pillars"
    description: ClassVar[str] = "halls with pillars"

    map_size: tuple[int, int] = (9, 12)
    side: int = 1
    gaps: tuple[int, int] = (2, 3)

    def __post_init__(self):
        super().__post_init__()
        self._convert(check_integers, "gaps")

    @property
    def max_seed_points(self):
        return 6

    def draw(self, seed, indices):
        grids = np.zeros((len(indices), *self.map_size), np.uint8)
        for grid, index in zip(grids, indices):
            grid[1 + index % 2 :: self.side + self.gaps[0], 1 + index % 3 :: 1 + self.gaps[1]] = 1
        maps = with_seed_points(self, seed, indices, grids)
        maps.rooms[:] = 4  # fewer than the family may have
        maps.seed_points[:, 4:] = -1
        return maps


register(Pillars, {"columns": Pillars()})
"""
"""The text of the module ``pillars``."""


def write_module(folder: Path, text: str = PILLARS) -> None:
    """Write ``pillars.py``, as a user does."""
    (folder / "pillars.py").write_text(text, encoding="utf-8")


def forget(family: str, *presets: str) -> None:
    """Make a family and its module unknown again, as they are to another process."""
    GENERATORS.pop(family, None)
    for preset in presets:
        _presets.pop(preset, None)
    sys.modules.pop(family, None)
    _cached_generator.cache_clear()
    register_installed.cache_clear()
