"""Maps in place of those without a problem: which ones, and how many before there is an error.

docs/format.md, section 6, has these rules.
"""

from __future__ import annotations

import math
import sys

import numpy as np

from mapdata.arrays import Ints
from mapdata.jit import Int, kernel
from mapdata.limits import Size
from mapdata.problems.sources import MAX_CELL_COST, Source
from mapdata.rng import SUBSTITUTE, block
from mapdata.search.lattice import MAX_PATH_COST

MAX_CELLS = 4 * 10**8
"""Cells of the maps of all goals that a problem is sought for in vain, before there is an error.

A goal on a map of H x W cells counts H * W. At 64 x 64 cells the search takes about 10 s then.
"""

MIN_MAPS = 20
"""A problem is sought on so many maps, however large they are."""

MAX_MAPS = 100_000
"""A problem is sought on no more maps than this, however small they are."""

RARE_SHARE = 2
"""A search that goes on is said to be long once it has failed on 1 / RARE_SHARE of the maps that a
search in vain may take: after some seconds.
"""


def limit_of_tries(problems: Source, map_size: Size, goals: int) -> int:
    """Return how many maps are tried for a problem before there is an error.

    Args:
        problems: the problem that is sought.
        map_size: (rows, columns) of all maps.
        goals: number of attempts on a map before it counts as having no problem, if each of them
            has another goal.
    """
    if not problems.goals_differ:
        goals = 1
    rows, columns = map_size
    maps = -(-MAX_CELLS // (goals * rows * columns))  # rounded up
    return min(max(maps, MIN_MAPS), MAX_MAPS)


def may_have_high_costs(map_size: Size) -> bool:
    """Return whether a path on terrain of this size may cost too much to be exact."""
    rows, columns = map_size
    most_cost = rows * columns * MAX_CELL_COST * math.sqrt(2)  # of a path through all cells
    return most_cost > MAX_PATH_COST / 2  # costs are doubled


@kernel
def draw_substitutes(
    seed: np.uint64, indices: Ints, epoch: Int, numbers: Ints, map_count: Int
) -> Ints:
    """Return the stored maps that take the place of maps without a problem, (B,).

    Args:
        seed: sampling seed.
        indices: (B,) number of each problem.
        epoch: pass over the data.
        numbers: (B,) which substitute of the problem it is, from 1 on.
        map_count: number of maps in the split, all of which are equally probable.
    """
    maps = np.empty(len(indices), np.int64)
    for k in range(len(indices)):
        w0, w1, _, _ = block(seed, np.uint64(indices[k]), epoch, SUBSTITUTE, numbers[k])
        # (word * n) >> 64 for the 64-bit word with the upper half w0 and the lower half w1. It is
        # computed in two halves, because the product has more than 64 bits.
        n = np.uint64(map_count)
        half = np.uint64(32)
        maps[k] = np.int64((w0 * n + ((w1 * n) >> half)) >> half)
    return maps


def say_rare(message: str) -> None:
    """Write on stderr that problems are rare, so that a long search is not silent."""
    # tqdm's own function for this leaves progress bars intact.
    from tqdm.auto import tqdm

    if sys.stderr:
        tqdm.write(f"rare problems: {message}", file=sys.stderr)
