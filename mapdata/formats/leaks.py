"""Copies of maps: a planner that was trained on a map is not tested on it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapdata.arrays import Array, Bytes, Ints
from mapdata.describe.statistics import count_repeats, digests_of
from mapdata.formats.collection import ForeignMap
from mapdata.limits import SPLITS


class Separated(NamedTuple):
    """Maps whose copies were counted.

    Attributes:
        kept: the numbers of the maps that are left.
        distinct: how many different maps are left, by split, and in "all".
        symmetric: the same, where the symmetric images of a map count as one.
    """

    kept: Ints
    distinct: dict[str, int]
    symmetric: dict[str, int]


def separate(maps: list[ForeignMap], splits: Bytes, drop: bool, notes: list[str]) -> Separated:
    """Count the copies of maps, and those that stand in two splits, exactly and up to symmetry.

    Args:
        maps: all of one size, in their order.
        splits: (N,) their splits.
        drop: leave out the copies in the earlier splits, so that the test split stays whole.
        notes: gets a line that says how many stand in two splits, where there are several.
    """
    digests = [digests_of(foreign_map.grid[None]) for foreign_map in maps]
    exact, symmetric = map(np.concatenate, zip(*digests, strict=True))
    # the number of each kind of map, and the last split that has one of it
    _, kinds = np.unique(symmetric, return_inverse=True)
    last = np.zeros_like(splits)
    np.maximum.at(last, kinds, splits)
    kept = np.flatnonzero(splits == last[kinds])
    copies = len(maps) - len(kept)
    if copies:
        same = count_repeats(exact, splits).across
        similar = count_repeats(symmetric, splits).across
        counts = [f"{same[a, b]} of {b} in {a} ({similar[a, b]} up to symmetry)" for a, b in same]
        done = "left out" if drop else "kept, --drop-leaks leaves them out"
        notes.append(
            f"maps in two splits: {', '.join(counts)}; {copies} copies in the earlier ones are "
            f"{done}"
        )
    elif len(np.unique(splits)) > 1:
        notes.append("no map stands in two splits, exactly or up to symmetry")
    if not drop:
        kept = np.arange(len(maps))
    return Separated(
        kept, _distinct(exact[kept], splits[kept]), _distinct(symmetric[kept], splits[kept])
    )


def _distinct(digests: Array, splits: Bytes) -> dict[str, int]:
    """Return how many different digests, (N,), there are in each split and in all."""
    counts = {split: len(np.unique(digests[splits == k])) for k, split in enumerate(SPLITS)}
    return {"all": len(np.unique(digests)), **counts}
