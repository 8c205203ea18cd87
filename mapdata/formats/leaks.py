"""Maps that stand in two splits: a planner that was trained on a map is not tested on it."""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.formats.collection import ForeignMap
from mapdata.shards.statistics import count_repeats, digests_of


def separate(maps: list[ForeignMap], splits: Bytes, drop: bool, notes: list[str]) -> Ints:
    """Count the maps that stand in two splits, exactly and up to symmetry.

    Args:
        maps: all of one size, in their order.
        splits: (N,) their splits.
        drop: leave out the copies in the earlier splits, so that the test split stays whole.
        notes: gets a line that says how many there are.

    Returns:
        The numbers of the maps that are left.
    """
    digests = [digests_of(one.grid[None]) for one in maps]
    exact, symmetric = map(np.concatenate, zip(*digests, strict=True))
    # the number of each kind of map, and the last split that has one of it
    _, kinds = np.unique(symmetric, return_inverse=True)
    last = np.zeros_like(splits)
    np.maximum.at(last, kinds, splits)
    kept = np.flatnonzero(splits == last[kinds])
    copies = len(maps) - len(kept)
    if copies == 0:
        notes.append("no map stands in two splits, exactly or up to symmetry")
        return kept
    same = count_repeats(exact, splits).across
    similar = count_repeats(symmetric, splits).across
    counts = [f"{same[a, b]} of {b} in {a} ({similar[a, b]} up to symmetry)" for a, b in same]
    done = "left out" if drop else "kept, --drop-leaks leaves them out"
    notes.append(
        f"maps in two splits: {', '.join(counts)}; {copies} copies in the earlier ones are {done}"
    )
    return kept if drop else np.arange(len(maps))
