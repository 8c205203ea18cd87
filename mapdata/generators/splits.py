"""The split of each map, drawn from stream 2 of docs/format.md; imported maps are drawn alike."""

from __future__ import annotations

from functools import cache

import numpy as np

from mapdata.arrays import Bytes, Ints, Words
from mapdata.checks import check_fractions, check_seed
from mapdata.generators.generator import MapGenerator
from mapdata.jit import kernel
from mapdata.limits import SPLITS
from mapdata.rng import SPLIT, block, threshold


@cache
def split_thresholds(splits: tuple[float, ...]) -> Words:
    """Return two numbers: a 32-bit word below the first is train, else below the second is val.

    Raises:
        ValueError: not three fractions that add up to 1.
    """
    train, val, _ = check_fractions(splits)
    return np.array([threshold(train), threshold(train + val)], np.uint64)


@kernel
def draw_splits(seed: np.uint64, indices: Ints, thresholds: Words) -> Bytes:
    """Return the splits of maps ``indices``, (N,): 0 train, 1 val, 2 test.

    ``thresholds`` are those of `split_thresholds`.
    """
    codes = np.empty(len(indices), np.uint8)
    for k in range(len(indices)):
        word, _, _, _ = block(seed, np.uint64(indices[k]), 0, SPLIT, 0)
        codes[k] = int(word >= thresholds[0]) + int(word >= thresholds[1])
    return codes


def maps_of_split(generator: MapGenerator, seed: int, split: str, count: int) -> Ints:
    """Return the numbers of the first ``count`` maps of (generator, seed) that belong to a split.

    Raises:
        ValueError: the generator has no maps in this split.
    """
    code = SPLITS.index(split)
    thresholds = split_thresholds(generator.splits)
    word_limits = [0, *thresholds.tolist(), 2**32]
    if word_limits[code] == word_limits[code + 1]:  # No word means this split.
        raise ValueError(f"split: the spec gives no map to {split!r} (splits {generator.splits})")
    key = np.uint64(check_seed(seed))
    chunk_size = max(count, 4096)
    members = np.empty(0, np.int64)
    start = 0
    while len(members) < count:
        indices = np.arange(start, start + chunk_size)
        codes = draw_splits(key, indices, thresholds)
        members = np.concatenate([members, indices[codes == code]])
        start += chunk_size
    return members[:count]
