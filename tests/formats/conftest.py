"""Small datasets that formats export."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from helpers.builds import Built

from mapdata import MapSpec

SPEC = MapSpec(
    (20, 70),
    (3, 6),
    (3, 9),
    (3, 14),
    passage_width=(1, 2),
    skip_probability=0.4,
    splits=(0.5, 0.25, 0.25),
)


@pytest.fixture(scope="session")
def root(built: Built) -> Path:
    """24 maps of 20 x 70 cells in two shards, some segments without a path."""
    return built(SPEC, maps=24, seed=5, shard_size=16)


@pytest.fixture(scope="session")
def square(built: Built) -> Path:
    """24 maps of 20 x 20 cells in two shards, for formats of square maps."""
    return built(replace(SPEC, map_size=(20, 20)), maps=24, seed=5, shard_size=16)
