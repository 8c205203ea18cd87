"""Copies of maps in two splits: a planner must not be tested on maps that it was trained on."""

from __future__ import annotations

from math import prod
from typing import NamedTuple

import numpy as np

from mapdata.arrays import Array, Bytes, Ints
from mapdata.describe.statistics import count_repeats, digests_of
from mapdata.formats.collection import ForeignMap
from mapdata.limits import SPLITS

_HASHED_CELLS = 2**20
"""Number of cells that are hashed in one call, which holds for all symmetric images as bytes."""


class Separated(NamedTuple):
    """The maps that are kept, and how many of them differ.

    Attributes:
        kept: (K,) numbers of the kept maps.
        distinct: number of different kept maps, by split and in "all".
        symmetric: number of kept maps that differ by more than a symmetry, by split and in "all".
    """

    kept: Ints
    distinct: dict[str, int]
    symmetric: dict[str, int]


def separate(maps: list[ForeignMap], splits: Bytes, drop: bool, notes: list[str]) -> Separated:
    """Count the copies of maps across splits, exact ones and those up to symmetry.

    Args:
        maps: all of one size, in their order.
        splits: (N,) their splits.
        drop: leave out the copies in the earlier splits, so that the test split stays whole.
        notes: if there are several splits, a line is added that says how many maps stand in two.
    """
    # Many small maps at a time, since a call takes as long for one of them as for a hundred.
    step = max(1, _HASHED_CELLS // prod(maps[0].shape))
    digest_pairs = [_digests(maps[first : first + step]) for first in range(0, len(maps), step)]
    exact = np.concatenate([exact for exact, _ in digest_pairs])
    symmetric = np.concatenate([symmetric for _, symmetric in digest_pairs])
    # Maps that are equal up to symmetry form a group; the copies in its last split are kept.
    _, groups = np.unique(symmetric, return_inverse=True)
    last_splits = np.zeros_like(splits)
    np.maximum.at(last_splits, groups, splits)
    kept = np.flatnonzero(splits == last_splits[groups])
    copies = len(maps) - len(kept)
    if copies:
        exact_counts = count_repeats(exact, splits).across
        symmetric_counts = count_repeats(symmetric, splits).across
        counts = ", ".join(
            f"{count} of {later} in {earlier} ({symmetric_counts[earlier, later]} up to symmetry)"
            for (earlier, later), count in exact_counts.items()
        )
        outcome = "left out" if drop else "kept, --drop-leaks leaves them out"
        notes.append(
            f"maps in two splits: {counts}; {copies} copies in the earlier ones are {outcome}"
        )
    elif len(np.unique(splits)) > 1:
        notes.append("no map stands in two splits, exactly or up to symmetry")
    if not drop:
        kept = np.arange(len(maps))
    return Separated(
        kept,
        _count_distinct(exact[kept], splits[kept]),
        _count_distinct(symmetric[kept], splits[kept]),
    )


def _digests(maps: list[ForeignMap]) -> tuple[list[bytes], list[bytes]]:
    """Return the hash of each map, and that of its symmetric images.

    Maps of terrain are copies only if their costs are equal too.
    """
    terrains = [foreign_map.terrain for foreign_map in maps if foreign_map.terrain is not None]
    if terrains:
        return digests_of(np.stack(terrains), is_terrain=True)
    return digests_of(np.stack([foreign_map.grid for foreign_map in maps]))


def _count_distinct(digests: Array, splits: Bytes) -> dict[str, int]:
    """Return the number of different digests, (N,), in each split and in "all"."""
    counts = {name: len(np.unique(digests[splits == code])) for code, name in enumerate(SPLITS)}
    return {"all": len(np.unique(digests)), **counts}
