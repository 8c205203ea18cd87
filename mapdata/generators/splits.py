"""Which split a map belongs to: a draw of stream 2 of docs/format.md, imported maps included."""

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
    """Return the two integers below which a 32-bit word means train, and train or val.

    Raises:
        ValueError: not three fractions that add up to 1.
    """
    train, val, _ = check_fractions(splits)
    return np.array([threshold(train), threshold(train + val)], np.uint64)


@kernel
def draw_splits(seed: np.uint64, indices: Ints, thresholds: Words) -> Bytes:
    """Return (N,) the codes of the splits of maps ``indices``."""
    codes = np.empty(len(indices), np.uint8)
    for k in range(len(indices)):
        word, _, _, _ = block(seed, np.uint64(indices[k]), 0, SPLIT, 0)
        codes[k] = int(word >= thresholds[0]) + int(word >= thresholds[1])
    return codes


def maps_of_split(spec: MapGenerator, seed: int, split: str, count: int) -> Ints:
    """Return the indices of the first ``count`` maps of (spec, seed) that belong to ``split``."""
    code = SPLITS.index(split)
    thresholds = split_thresholds(spec.splits)
    bounds = [0, *thresholds.tolist(), 2**32]
    if bounds[code] == bounds[code + 1]:
        raise ValueError(f"split: the spec gives no map to {split!r} (splits {spec.splits})")
    key = np.uint64(check_seed(seed))
    found = np.empty(0, np.int64)
    indices = np.arange(max(count, 4096))
    while len(found) < count:
        codes = draw_splits(key, indices, thresholds)
        found = np.concatenate([found, indices[codes == code]])
        indices += len(indices)
    return found[:count]
