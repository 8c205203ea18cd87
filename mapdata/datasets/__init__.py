"""Maps and problems as torch samples: datasets, the data module, and the fields of a sample.

`MapDataModule` is imported on first use. Its base class comes from Lightning, which takes longer to
import than torch and all else together. Neither a plain loop nor a loader worker needs it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mapdata.datasets.arguments import (
    DEFAULT_FIELDS,
    FieldFunction,
    MovementLike,
    Transform,
)
from mapdata.datasets.dataset import MapDataset
from mapdata.datasets.fields import FIELDS, Batch
from mapdata.datasets.info import DatasetInfo, FieldInfo
from mapdata.datasets.maze_image import MazeImage
from mapdata.datasets.online import OnlineMapDataset
from mapdata.datasets.problem_set_dataset import ProblemSetDataset
from mapdata.datasets.sample import Sample, row
from mapdata.datasets.sampler import EpochSampler, LateLoader
from mapdata.datasets.symmetry import apply_symmetry
from mapdata.datasets.text import maze_text
from mapdata.datasets.tiles import Tiles
from mapdata.datasets.waypoints import Waypoints
from mapdata.problems.drawing import DRAWS

if TYPE_CHECKING:
    from mapdata.datasets.datamodule import MapDataModule

__all__ = [
    "DEFAULT_FIELDS",
    "DRAWS",
    "FIELDS",
    "Batch",
    "DatasetInfo",
    "EpochSampler",
    "FieldFunction",
    "FieldInfo",
    "LateLoader",
    "MapDataModule",
    "MapDataset",
    "MazeImage",
    "MovementLike",
    "OnlineMapDataset",
    "ProblemSetDataset",
    "Sample",
    "Tiles",
    "Transform",
    "Waypoints",
    "apply_symmetry",
    "maze_text",
    "row",
]


def __getattr__(name: str) -> object:
    """Import `MapDataModule`, and Lightning with it, on first use."""
    if name != "MapDataModule":
        raise AttributeError(f"module 'mapdata.datasets' has no attribute {name!r}")
    from mapdata.datasets.datamodule import MapDataModule

    globals()[name] = MapDataModule
    return MapDataModule
