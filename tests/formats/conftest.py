"""Small datasets that formats export."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from mapdata import MapSpec, build

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
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """24 maps of 20 x 70 cells in two shards, some segments without a path."""
    folder = tmp_path_factory.mktemp("formats") / "maps"
    build(folder, SPEC, maps=24, seed=5, shard_size=16)
    return folder


@pytest.fixture(scope="session")
def square(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """24 maps of 20 x 20 cells in two shards, for formats of square maps."""
    folder = tmp_path_factory.mktemp("formats") / "square"
    build(folder, replace(SPEC, map_size=(20, 20)), maps=24, seed=5, shard_size=16)
    return folder
