"""What the tests of serving share: a small dataset on disk, and samples compared value by value."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import torch

from mapdata import MapGenerator, MapSpec, Movement, Sample, Terrain, build
from mapdata.datasets import FIELDS

PADDING = -1
"""What fills a path beyond its cells."""

SPEC = MapSpec(
    (20, 20),
    (2, 5),
    (2, 8),
    (2, 8),
    passage_width=(1, 2),
    skip_probability=0.3,
    splits=(0.6, 0.2, 0.2),
)
"""Small square maps, a tenth of their segments without a path."""

WIDE = MapSpec(
    (9, 70),
    (2, 5),
    (2, 4),
    (3, 12),
    passage_width=(1, 2),
    skip_probability=0.2,
    movement=Movement(8),
)
"""More columns than a machine word, stored with diagonals."""

ROUGH = Terrain(costs=(2, 3, 8, 91), scale=3, over=SPEC)
"""The same maps as those of `SPEC`, with costs."""

ALL_FIELDS: tuple[str, ...] = tuple(FIELDS)
"""The names of all fields."""

TERRAIN_FIELDS = tuple(name for name in ALL_FIELDS if name != "waypoints")
"""The names of all fields that maps with terrain have: these have no taut lines."""


def build_small(
    root: Path,
    generator: MapGenerator = SPEC,
    *,
    maps: int = 60,
    seed: int = 5,
    shard_size: int = 16,
) -> str:
    """Build a dataset of several shards and return its root."""
    build(root, generator, maps=maps, seed=seed, shard_size=shard_size, workers=1)
    return str(root)


def assert_same(found: Sample, expected: Sample, without: Iterable[str] = ()) -> None:
    """Compare two samples or batches: their fields, types, shapes and values."""
    assert found._fields == expected._fields
    for name, value, truth in zip(found._fields, found, expected, strict=True):
        if name not in without:
            assert value.dtype == truth.dtype, name
            assert value.shape == truth.shape, name
            assert torch.equal(value, truth), name


def assert_all_same(found: Sequence[Sample], expected: Sequence[Sample]) -> None:
    """Compare two passes batch by batch."""
    assert len(found) == len(expected)
    for batch, truth in zip(found, expected, strict=True):
        assert_same(batch, truth)


def cells_of(path: torch.Tensor) -> list[tuple[int, int]]:
    """Return the cells of one path without padding."""
    assert path.dtype == torch.int64
    kept = path[(path != PADDING).all(dim=1)]
    assert torch.equal(kept, path[: len(kept)])  # padding comes last
    assert (path[len(kept) :] == PADDING).all()
    return [(int(row), int(column)) for row, column in kept]


def grid_of(occupancy: torch.Tensor) -> list[list[int]]:
    """Return one map, (1, H, W), as a reference grid."""
    grid = np.asarray(occupancy)
    assert grid.ndim == 3
    assert set(np.unique(grid).tolist()) <= {0, 1}
    rows: list[list[int]] = grid[0].astype(int).tolist()
    return rows


def cell_of(cell: torch.Tensor) -> tuple[int, int]:
    """Return one cell, (2,)."""
    row, column = cell.tolist()
    return row, column
