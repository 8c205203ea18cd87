"""A small dataset that all formats export."""

from __future__ import annotations

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
