"""Keeping maps: shards, their manifest and content hash, building, checking and repairing them."""

from mapdata.shards.builder import build
from mapdata.shards.corruption import repair, verify
from mapdata.shards.dataset_card import card
from mapdata.shards.manifest import DatasetNotFoundError, Manifest
from mapdata.shards.reader import read_shard
from mapdata.shards.recipe import Recipe
from mapdata.shards.root import Root
from mapdata.shards.shard import ShardError, write_file
from mapdata.shards.statistics import DatasetStatistics, dataset_statistics

__all__ = [
    "DatasetNotFoundError",
    "DatasetStatistics",
    "Manifest",
    "Recipe",
    "Root",
    "ShardError",
    "build",
    "card",
    "dataset_statistics",
    "read_shard",
    "repair",
    "verify",
    "write_file",
]
