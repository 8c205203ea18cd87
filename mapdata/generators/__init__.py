"""Families of maps, each a `MapGenerator` in its own file; presets, recipes, and the `Maps`."""

from mapdata.generators import caves, forests, mazes, random_walls, rooms, terrain
from mapdata.generators.caves import Cave
from mapdata.generators.forests import Forest
from mapdata.generators.generator import GENERATORS, PRESETS, MapGenerator, identity, register
from mapdata.generators.maps import WORD, Maps, pack
from mapdata.generators.mazes import Maze
from mapdata.generators.points import draw_points, largest_component, with_seed_points
from mapdata.generators.random_walls import RandomWalls
from mapdata.generators.recipe import Recipe, RecipeLike, as_recipe, generate
from mapdata.generators.rooms import MapSpec
from mapdata.generators.splits import SplitMaps, draw_splits, maps_of_split, split_thresholds
from mapdata.generators.stored_families import UnknownFamily
from mapdata.generators.terrain import Terrain

register(MapSpec, rooms.PRESETS)
register(Maze, mazes.PRESETS)
register(Cave, caves.PRESETS)
register(Forest, forests.PRESETS)
register(RandomWalls, random_walls.PRESETS)
register(Terrain, terrain.PRESETS)

__all__ = [
    "GENERATORS",
    "PRESETS",
    "WORD",
    "Cave",
    "Forest",
    "MapGenerator",
    "MapSpec",
    "Maps",
    "Maze",
    "RandomWalls",
    "Recipe",
    "RecipeLike",
    "SplitMaps",
    "Terrain",
    "UnknownFamily",
    "as_recipe",
    "draw_points",
    "draw_splits",
    "generate",
    "identity",
    "largest_component",
    "maps_of_split",
    "pack",
    "register",
    "split_thresholds",
    "with_seed_points",
]
