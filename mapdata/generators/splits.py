"""The split of each map, drawn from stream 2 of docs/format.md; imported maps are drawn alike."""

from __future__ import annotations

from functools import cache

import numpy as np

from mapdata.arrays import Bytes, Flags, Ints, Words
from mapdata.checks import check_fractions, check_seed
from mapdata.generators.generator import MapGenerator
from mapdata.jit import kernel
from mapdata.limits import SPLITS
from mapdata.rng import SPLIT, block, threshold

_BLOCK = 512
"""Maps of a block, of which `SplitMaps` keeps how many belong to the split."""

_MAPS_AT_ONCE = 512 * _BLOCK
"""Maps whose splits `SplitMaps` draws at once."""


@cache
def split_thresholds(splits: tuple[float, ...]) -> Words:
    """Return two numbers: a 32-bit word below the first is train, else below the second is val.

    Raises:
        ValueError: not three fractions that add up to 1.
    """
    train, val, _ = check_fractions(splits)
    return np.array([threshold(train), threshold(train + val)], np.uint64)


def draw_splits(seed: np.uint64, indices: Ints, thresholds: Words) -> Bytes:
    """Return the splits of maps ``indices``, (N,): 0 train, 1 val, 2 test.

    ``thresholds`` are those of `split_thresholds`.
    """
    codes = np.empty(len(indices), np.uint8)
    _fill_splits(seed, indices, thresholds, codes)
    return codes


@kernel
def _fill_splits(seed: np.uint64, indices: Ints, thresholds: Words, codes: Bytes) -> None:
    """Do the work of `draw_splits`, whose result is written to ``codes`` (N,)."""
    for k in range(len(indices)):
        word, _, _, _ = block(seed, np.uint64(indices[k]), 0, SPLIT, 0)
        codes[k] = np.uint8(word >= thresholds[0]) + np.uint8(word >= thresholds[1])


def maps_of_split(generator: MapGenerator, seed: int, split: str, count: int) -> Ints:
    """Return the numbers of the first ``count`` maps of (generator, seed) that belong to a split.

    Raises:
        ValueError: the generator has no maps in this split.
    """
    code = SPLITS.index(split)
    thresholds = split_thresholds(generator.splits)
    _check_split(generator, split)
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


class SplitMaps:
    """The numbers of all maps of (generator, seed) that belong to a split, in ascending order.

    The maps are drawn as far as they are asked for. Only how many of each block of maps belong to
    the split is kept, eight bytes for 512 maps, so that maps far behind take little memory.
    """

    def __init__(self, generator: MapGenerator, seed: int, split: str) -> None:
        """Keep what the maps are drawn from; none is drawn yet.

        Raises:
            ValueError: the generator has no maps in this split.
        """
        _check_split(generator, split)
        self._code = SPLITS.index(split)
        self._thresholds = split_thresholds(generator.splits)
        self._key = np.uint64(check_seed(seed))
        # How many maps of the split there are before block k, and, at last, in all blocks.
        self._offsets = np.zeros(1, np.int64)

    def at(self, places: Ints) -> Ints:
        """Return the maps at ``places`` among those of the split, both (N,) and from 0 on."""
        if len(places) == 0:
            return places
        offsets = self._up_to(int(places.max()))
        blocks = np.searchsorted(offsets, places, side="right") - 1
        ranks = places - offsets[blocks]  # among the members of the block
        numbers = blocks[:, None] * _BLOCK + np.arange(_BLOCK)
        is_member = self._members(numbers.reshape(-1)).reshape(numbers.shape)
        is_sought = is_member & (is_member.cumsum(axis=1) == ranks[:, None] + 1)
        found: Ints = numbers[is_sought]
        return found

    def _up_to(self, place: int) -> Ints:
        """Return the offsets of so many blocks that map ``place`` of the split is in one of them.

        Another thread may draw the same blocks at once, and will find the same numbers.
        """
        offsets = self._offsets
        count = int(offsets[-1])
        first = (len(offsets) - 1) * _BLOCK
        parts = [offsets]
        while count <= place:
            is_member = self._members(np.arange(first, first + _MAPS_AT_ONCE))
            parts.append(count + is_member.reshape(-1, _BLOCK).sum(axis=1).cumsum())
            count = int(parts[-1][-1])
            first += _MAPS_AT_ONCE
        if len(parts) > 1:
            offsets = np.concatenate(parts)
            self._offsets = offsets
        return offsets

    def _members(self, numbers: Ints) -> Flags:
        """Return whether maps belong to the split, (N,) bool."""
        is_member: Flags = draw_splits(self._key, numbers, self._thresholds) == self._code
        return is_member


def _check_split(generator: MapGenerator, split: str) -> None:
    """Refuse a split without maps.

    Raises:
        ValueError: no random word means this split.
    """
    code = SPLITS.index(split)
    word_limits = [0, *split_thresholds(generator.splits).tolist(), 2**32]
    if word_limits[code] == word_limits[code + 1]:
        raise ValueError(f"split: the spec gives no map to {split!r} (splits {generator.splits})")
