"""Keeping maps: shards, their manifest and content hash, building, checking and repairing them."""

from mapdata.shards.builder import build
from mapdata.shards.content import content_hash
from mapdata.shards.corruption import repair, verify
from mapdata.shards.errors import DatasetNotFoundError, ShardError
from mapdata.shards.files import write_file, write_output
from mapdata.shards.locations import Locations
from mapdata.shards.manifest import MANIFEST, PROVENANCE, Manifest, read_manifest
from mapdata.shards.reader import open_shard, read_shard
from mapdata.shards.root import Root

__all__ = [
    "MANIFEST",
    "PROVENANCE",
    "DatasetNotFoundError",
    "Locations",
    "Manifest",
    "Root",
    "ShardError",
    "build",
    "content_hash",
    "open_shard",
    "read_manifest",
    "read_shard",
    "repair",
    "verify",
    "write_file",
    "write_output",
]
