"""Serving maps to torch: datasets, the data module, and the fields of a sample."""

from mapdata.datasets.datamodule import MapDataModule
from mapdata.datasets.dataset import MapDataset
from mapdata.datasets.fields import FIELDS, Batch
from mapdata.datasets.online import OnlineMapDataset
from mapdata.datasets.sample import Sample, row
from mapdata.datasets.sampler import EpochSampler, LateLoader

__all__ = [
    "FIELDS",
    "Batch",
    "EpochSampler",
    "LateLoader",
    "MapDataModule",
    "MapDataset",
    "OnlineMapDataset",
    "Sample",
    "row",
]
