"""Maps that stand in two splits: a planner that was trained on a map is not tested on it."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mapdata.arrays import Bytes, Ints
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
    drawn = draw_splits(np.uint64(seed), np.arange(len(maps)), split_thresholds(fractions))
    for k, one in enumerate(maps):
        if one.split is not None:
            drawn[k] = one.split
    splits = drawn.astype(np.int64)
    first, _ = _first_and_last([_digest(one.grid) for one in maps], splits)
    first_turned, last_turned = _first_and_last([_least(one.grid) for one in maps], splits)
    counts = []
    for code, name in enumerate(SPLITS):
        here = splits == code
        exact = np.count_nonzero(first[here] < code)
        turned = np.count_nonzero(first_turned[here] < code)
        if turned:
            total = np.count_nonzero(here)
            counts.append(f"{exact:,} of {total:,} {name} maps ({turned:,} up to symmetry)")
    if not counts:
        notes.append("no map stands in two splits, exactly or up to symmetry")
        return maps
    what = f"{' and '.join(counts)} stand in an earlier split, too"
    if not drop:
        notes.append(f"{what}: --drop-leaks leaves the copies there out")
        return maps
    kept = np.flatnonzero(splits == last_turned)
    notes.append(f"{what}: {len(maps) - len(kept):,} copies there are left out")
    # All keep their splits: were they drawn anew, other copies might be parted.
    return [replace(maps[k], cells=maps[k].grid, split=int(splits[k])) for k in kept]


def _first_and_last(digests: Sequence[str], splits: Ints) -> tuple[Ints, Ints]:
    """Return the first and the last split in which a map with the digest of each stands."""
    _, numbers = np.unique(np.array(digests), return_inverse=True)
    first = np.full(len(digests), len(SPLITS))
    last = np.zeros(len(digests), np.int64)
    np.minimum.at(first, numbers, splits)
    np.maximum.at(last, numbers, splits)
    return first[numbers], last[numbers]


def _digest(grid: Bytes) -> str:
    """Return the hash of a grid."""
    return hashlib.sha256(grid.tobytes()).hexdigest()


def _least(grid: Bytes) -> str:
    """Return the least hash of a grid and its mirror images, 8 of a square, 4 of a rectangle."""
    rows, columns = grid.shape
    count = 8 if rows == columns else 4
    images = transform_grids(np.repeat(grid[None], count, axis=0), np.arange(count))
    return min(map(_digest, images))
