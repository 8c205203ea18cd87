"""Dungeon-like 2D grid maps with shortest paths and room-to-room distances, for planners that learn by example.

The public names stand here, one a line, and are imported on first use: ``import mapdata`` loads neither torch nor
numba.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mapdata.build import build as build
    from mapdata.damage import repair as repair
    from mapdata.damage import verify as verify
    from mapdata.datamodule import MapDataModule as MapDataModule
    from mapdata.dataset import MapDataset as MapDataset
    from mapdata.dungeon import Maps as Maps
    from mapdata.dungeon import generate as generate
    from mapdata.evaluate import Plan as Plan
    from mapdata.evaluate import evaluate as evaluate
    from mapdata.guard import read_shard as read_shard
    from mapdata.labels import Labels as Labels
    from mapdata.labels import label as label
    from mapdata.manifest import DatasetNotFoundError as DatasetNotFoundError
    from mapdata.online import OnlineMapDataset as OnlineMapDataset
    from mapdata.problems import Problems as Problems
    from mapdata.sample import Sample as Sample
    from mapdata.search import SearchResult as SearchResult
    from mapdata.search import astar as astar
    from mapdata.search import bfs as bfs
    from mapdata.search import check_path as check_path
    from mapdata.search import distance_field as distance_field
    from mapdata.search import search_batch as search_batch
    from mapdata.shard import ShardError as ShardError
    from mapdata.spec import MapSpec as MapSpec
    from mapdata.spec import Movement as Movement
    from mapdata.spec import identity as identity

__version__ = "0.1.0"

_HOME = {
    "build": "build",
    "repair": "damage",
    "verify": "damage",
    "MapDataset": "dataset",
    "OnlineMapDataset": "online",
    "MapDataModule": "datamodule",
    "Maps": "dungeon",
    "generate": "dungeon",
    "Plan": "evaluate",
    "evaluate": "evaluate",
    "Labels": "labels",
    "label": "labels",
    "DatasetNotFoundError": "manifest",
    "Problems": "problems",
    "Sample": "sample",
    "SearchResult": "search",
    "astar": "search",
    "bfs": "search",
    "check_path": "search",
    "distance_field": "search",
    "search_batch": "search",
    "ShardError": "shard",
    "read_shard": "guard",
    "MapSpec": "spec",
    "Movement": "spec",
    "identity": "spec",
}

__all__ = [*_HOME, "__version__"]  # noqa: PLE0604  (a list of names)


def __getattr__(name: str) -> object:
    """Import a public name on first use."""
    if name not in _HOME:
        raise AttributeError(f"module 'mapdata' has no attribute {name!r}")
    value = getattr(import_module(f"mapdata.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(__all__)
