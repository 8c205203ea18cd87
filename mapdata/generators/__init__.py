"""Families of maps, each a `MapGenerator` in its own file; presets, recipes, and the `Maps`."""

from typing import TYPE_CHECKING

from mapdata.aliases import former_names
from mapdata.generators import caves, forests, mazes, mixtures, random_walls, rooms, terrain
from mapdata.generators.caves import Cave
from mapdata.generators.forests import Forest
from mapdata.generators.generator import PRESETS, MapGenerator, identity, register
from mapdata.generators.maps import Maps
from mapdata.generators.mazes import Maze
from mapdata.generators.mixtures import Mixture
from mapdata.generators.points import with_seed_points
from mapdata.generators.random_walls import RandomWalls
from mapdata.generators.recipe import Recipe, RecipeLike, as_recipe, generate
from mapdata.generators.rooms import MapSpec
from mapdata.generators.stored_families import UnknownFamily
from mapdata.generators.terrain import Terrain

register(MapSpec, rooms.PRESETS)
register(Maze, mazes.PRESETS)
register(Cave, caves.PRESETS)
register(Forest, forests.PRESETS)
register(RandomWalls, random_walls.PRESETS)
register(Terrain, terrain.PRESETS)
register(Mixture, mixtures.PRESETS)

__all__ = [
    "PRESETS",
    "Cave",
    "Forest",
    "MapGenerator",
    "MapSpec",
    "Maps",
    "Maze",
    "Mixture",
    "RandomWalls",
    "Recipe",
    "RecipeLike",
    "Terrain",
    "UnknownFamily",
    "as_recipe",
    "generate",
    "identity",
    "register",
    "with_seed_points",
]

if not TYPE_CHECKING:
    __getattr__ = former_names(
        __name__,
        {
            "GENERATORS": "generator",
            "SplitMaps": "splits",
            "WORD": "maps",
            "draw_points": "points",
            "draw_splits": "splits",
            "largest_component": "points",
            "maps_of_split": "splits",
            "pack": "maps",
            "split_thresholds": "splits",
        },
    )
