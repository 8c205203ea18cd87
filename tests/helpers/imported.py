"""Maps that somebody else drew, as a collection and as a dataset."""

from __future__ import annotations

from pathlib import Path

from helpers.samples import SPEC
from mapdata import Movement, generate
from mapdata.arrays import Bytes
from mapdata.formats import Collection, ForeignMap, import_maps

NASTY = "</script><img src=x onerror=alert(1)> | **bold** [a](b) `code`\n# head"
"""A name of a map that would like to be HTML, a table of Markdown and code."""


def collection(*grids: Bytes, **fields: object) -> Collection:
    """Return grids as a format would."""
    return Collection([ForeignMap(f"g{k}", grid, **fields) for k, grid in enumerate(grids)])  # type: ignore[arg-type]


def imported(root: Path) -> Path:
    """Import a few maps: one twice in two splits, one turned over."""
    grids = generate(SPEC, 5, range(6)).occupancy
    grids[4] = grids[0]
    grids[5] = grids[1][::-1]
    splits = (0, 0, 1, 2, 2, 1)
    maps = [
        ForeignMap(f"{NASTY} {k}", grid, split=code)
        for k, (grid, code) in enumerate(zip(grids, splits, strict=True))
    ]
    import_maps(root, Collection(maps, movement=Movement(8)), seed_points=3)
    return root
