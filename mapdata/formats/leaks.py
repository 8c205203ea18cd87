"""Maps that stand in two splits: a planner that was trained on a map is not tested on it."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np

from mapdata.arrays import Bytes
from mapdata.formats.collection import ForeignMap
from mapdata.generators.splits import draw_splits, split_thresholds
from mapdata.problems.symmetry import transform_grids
from mapdata.spec import SPLITS


def separate(
    maps: list[ForeignMap],
    seed: int,
    fractions: tuple[float, float, float],
    drop: bool,
    notes: list[str],
) -> list[ForeignMap]:
    """Count the maps that stand in an earlier split too, exactly and up to symmetry.

    Args:
        maps: all of one size, in their order.
        seed: 64-bit seed of the splits that are drawn.
        fractions: of train, val and test, where they are drawn.
        drop: leave out the copies in the earlier splits, so that the test split stays whole.
        notes: gets a line that says how many there are.

    Returns:
        The maps that are left.
    """
    import pandas as pd

    splits = draw_splits(np.uint64(seed), np.arange(len(maps)), split_thresholds(fractions))
    for k, one in enumerate(maps):
        if one.split is not None:
            splits[k] = one.split
    hashes = [_hashes(one.grid) for one in maps]
    exact = pd.Series(splits).groupby([images[0] for images in hashes])
    turned = pd.Series(splits).groupby([min(images) for images in hashes])
    kept = np.flatnonzero(splits == turned.transform("max"))
    if len(kept) == len(maps):
        notes.append("no map stands in two splits, exactly or up to symmetry")
        return maps
    counts = []
    for code in (1, 2):
        here = splits == code
        same = np.count_nonzero(exact.transform("min")[here] < code)
        similar = np.count_nonzero(turned.transform("min")[here] < code)
        counts.append(f"{same} of {here.sum()} {SPLITS[code]} maps ({similar} up to symmetry)")
    done = "left out" if drop else "kept, --drop-leaks leaves them out"
    copies = f"{len(maps) - len(kept)} copies there are {done}"
    notes.append(f"{' and '.join(counts)} stand in an earlier split, too: {copies}")
    if not drop:
        return maps
    # All keep their splits: were they drawn anew, other copies might be parted.
    return [replace(maps[k], cells=maps[k].grid, split=int(splits[k])) for k in kept]


def _hashes(grid: Bytes) -> list[str]:
    """Return the hashes of a grid and of its mirror images, 8 of a square, 4 of a rectangle."""
    rows, columns = grid.shape
    count = 8 if rows == columns else 4
    images = transform_grids(np.repeat(grid[None], count, axis=0), np.arange(count))
    return [hashlib.sha256(image.tobytes()).hexdigest() for image in images]
