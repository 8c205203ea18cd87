"""Datasets of 2D grid maps with shortest paths for PyTorch: path planning by imitation learning.

The public names stand here and are imported on first use: ``import mapdata`` loads neither torch
nor numba.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from mapdata._version import __version__

if TYPE_CHECKING:
    from mapdata.datasets import MapDataModule as MapDataModule
    from mapdata.datasets import MapDataset as MapDataset
    from mapdata.datasets import MazeImage as MazeImage
    from mapdata.datasets import OnlineMapDataset as OnlineMapDataset
    from mapdata.datasets import ProblemSetDataset as ProblemSetDataset
    from mapdata.datasets import Sample as Sample
    from mapdata.datasets import Tiles as Tiles
    from mapdata.datasets import Waypoints as Waypoints
    from mapdata.datasets import apply_symmetry as apply_symmetry
    from mapdata.evaluation import Plan as Plan
    from mapdata.evaluation import evaluate as evaluate
    from mapdata.generators import PRESETS as PRESETS
    from mapdata.generators import Cave as Cave
    from mapdata.generators import Forest as Forest
    from mapdata.generators import MapGenerator as MapGenerator
    from mapdata.generators import Maps as Maps
    from mapdata.generators import MapSpec as MapSpec
    from mapdata.generators import Maze as Maze
    from mapdata.generators import Mixture as Mixture
    from mapdata.generators import RandomWalls as RandomWalls
    from mapdata.generators import Recipe as Recipe
    from mapdata.generators import Terrain as Terrain
    from mapdata.generators import generate as generate
    from mapdata.generators import identity as identity
    from mapdata.movement import Movement as Movement
    from mapdata.problems import Pairs as Pairs
    from mapdata.problems import ProblemSet as ProblemSet
    from mapdata.problems import Random as Random
    from mapdata.problems import Route as Route
    from mapdata.search import Labels as Labels
    from mapdata.search import SearchResult as SearchResult
    from mapdata.search import astar as astar
    from mapdata.search import bfs as bfs
    from mapdata.search import check_path as check_path
    from mapdata.search import clearance as clearance
    from mapdata.search import distance_field as distance_field
    from mapdata.search import inflate as inflate
    from mapdata.search import inflate_terrain as inflate_terrain
    from mapdata.search import label as label
    from mapdata.search import lines_are_free as lines_are_free
    from mapdata.search import pull_taut as pull_taut
    from mapdata.search import search_batch as search_batch
    from mapdata.search import search_order as search_order
    from mapdata.search import terrain_from_costs as terrain_from_costs
    from mapdata.search import to_metres as to_metres
    from mapdata.shards import DatasetNotFoundError as DatasetNotFoundError
    from mapdata.shards import ShardError as ShardError
    from mapdata.shards import build as build
    from mapdata.shards import read_shard as read_shard
    from mapdata.shards import repair as repair
    from mapdata.shards import verify as verify

_FACES = {
    "datasets": (
        "MapDataModule",
        "MapDataset",
        "MazeImage",
        "OnlineMapDataset",
        "ProblemSetDataset",
        "Sample",
        "Tiles",
        "Waypoints",
        "apply_symmetry",
    ),
    "evaluation": ("Plan", "evaluate"),
    "generators": (
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
        "Terrain",
        "generate",
        "identity",
    ),
    "problems": ("Pairs", "ProblemSet", "Random", "Route"),
    "search": (
        "Labels",
        "SearchResult",
        "astar",
        "bfs",
        "check_path",
        "clearance",
        "distance_field",
        "inflate",
        "inflate_terrain",
        "label",
        "lines_are_free",
        "pull_taut",
        "search_batch",
        "search_order",
        "terrain_from_costs",
        "to_metres",
    ),
    "shards": ("DatasetNotFoundError", "ShardError", "build", "read_shard", "repair", "verify"),
    "movement": ("Movement",),
}
"""Where each public name is imported from."""

_HOME = {name: face for face, names in _FACES.items() for name in names}

__all__ = [*_HOME, "__version__"]  # noqa: PLE0604  (a list of names)


_OTHER_NAMES = (
    "; the names of its folders are in docs/reference, such as mapdata.models.load_model and "
    "mapdata.formats.read_problems"
)


def __getattr__(name: str) -> object:
    """Import a public name on first use."""
    if name not in _HOME:
        hint = "" if name.startswith("_") else _OTHER_NAMES
        raise AttributeError(f"module 'mapdata' has no attribute {name!r}{hint}")
    value = getattr(import_module(f"mapdata.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(__all__)
