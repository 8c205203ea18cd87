"""Maps that problems are drawn on are the same, whether they are stored or made anew."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from helpers.samples import SPEC, build_small

from mapdata import Movement, Random, generate
from mapdata.datasets.batches import BatchReader
from mapdata.datasets.map_sources import StoredMapSource


def test_stored_maps_have_as_many_seed_points_as_they_were_made_with(tmp_path: Path) -> None:
    """The rows that pad the fewer seed points of a map are none."""
    reader = BatchReader(build_small(tmp_path / "maps", maps=10), None, Random(), 0.0)
    source = StoredMapSource(reader, Movement(), 0.0, 0)
    given = source.given_maps(np.arange(10), with_seed_points=True)
    made = generate(SPEC, 5, range(10))
    assert given.seed_point_counts is not None
    assert given.seed_point_counts.tolist() == made.rooms.tolist()
    assert len(set(made.rooms.tolist())) > 1
