"""Every field of small datasets, to compare compiled kernels with the Python that they are.

``NUMBA_DISABLE_JIT=1 python served_fields.py FILE`` writes them to an .npz file, in plain Python.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from mapdata import MapGenerator, MapSpec, Movement, OnlineMapDataset, Random, Terrain
from mapdata.arrays import Array
from mapdata.datasets import FIELDS

ROOMS = MapSpec((12, 14), (2, 4), (2, 5), (2, 6), passage_width=(1, 2))
OCTILE = Movement(8)

DATASETS: dict[str, tuple[MapGenerator, dict[str, Any]]] = {
    "four moves": (ROOMS, {"problems": "route"}),
    "robot": (
        replace(ROOMS, movement=OCTILE),
        {"problems": Random(distance=(3, None)), "augment": True, "radius": 0.05},
    ),
    "bfs": (
        replace(ROOMS, movement=Movement(8, True, 1.0)),
        {"problems": "pairs", "search": "bfs"},
    ),
    "terrain": (Terrain((10, 12), movement=OCTILE), {"problems": "random", "augment": True}),
}
"""Generators and the arguments of their datasets, by a name."""


def served_fields() -> Iterator[tuple[str, Array]]:
    """Yield the name of each dataset and field, and the field of its first six problems."""
    for name, (generator, arguments) in DATASETS.items():
        # A taut line is defined only where all cells cost the same.
        fields = [f for f in FIELDS if f != "waypoints" or not generator.has_terrain]
        batch = OnlineMapDataset(generator, seed=3, length=6, fields=fields, **arguments)[:]
        for field in batch._fields:
            yield f"{name}: {field}", np.asarray(getattr(batch, field))


if __name__ == "__main__":
    np.savez(sys.argv[1], **dict(served_fields()))  # type: ignore[arg-type]
