"""The random numbers of mapdata: philox4x32-10, counter-based, the same on every machine.

Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011, https://doi.org/10.1145/2063384.2063405.

A draw is a pure function of (seed, index, epoch, stream, number). There is no state to share, save
or advance, so any worker can generate any map in any order. Nothing here uses floating point or
numpy's generators, whose methods are not promised to stay the same between versions.
"""

from __future__ import annotations

import numpy as np

from mapdata.jit import Int, inlined, kernel

(
    MAP,
    PROBLEM,
    SPLIT,
    AUGMENTATION,
    ORDER,
    POINTS,
    TERRAIN,
    IMAGE,
    SUBSTITUTE,
    JITTER,
    MIXTURE,
) = range(11)
"""The streams: the purposes of draws. Equal indices of two streams give unrelated numbers."""

# The multipliers of a counter, and the constants that the key grows by in each round, are M and W
# in the paper.
_M0 = np.uint64(0xD2511F53)
_M1 = np.uint64(0xCD9E8D57)
_W0 = np.uint64(0x9E3779B9)
_W1 = np.uint64(0xBB67AE85)
_LOW_32_BITS = np.uint64(0xFFFFFFFF)
_32_BITS = np.uint64(32)
_STREAM_SHIFT = np.uint64(24)

Words = tuple[np.uint64, np.uint64, np.uint64, np.uint64]


@inlined
def philox4x32(
    c0: np.uint64, c1: np.uint64, c2: np.uint64, c3: np.uint64, k0: np.uint64, k1: np.uint64
) -> Words:
    """Return the four words of philox4x32-10 for a counter (c0, ..., c3) and a key (k0, k1).

    All words are uint64 below 2**32, so that the product of two is exact. The names of counter,
    key and products are those of the paper.
    """
    for _ in range(10):
        p0 = c0 * _M0
        p1 = c2 * _M1
        c0 = (p1 >> _32_BITS) ^ c1 ^ k0
        c2 = (p0 >> _32_BITS) ^ c3 ^ k1
        c1 = p1 & _LOW_32_BITS
        c3 = p0 & _LOW_32_BITS
        k0 = (k0 + _W0) & _LOW_32_BITS
        k1 = (k1 + _W1) & _LOW_32_BITS
    return c0, c1, c2, c3


@kernel
def block(seed: np.uint64, index: np.uint64, epoch: Int, stream: Int, number: Int) -> Words:
    """Return four random 32-bit words.

    Args:
        seed: key, 64 bits.
        index: number of the map or problem that the words are for, 64 bits.
        epoch: pass over the data, 32 bits; 0 for everything that is stored.
        stream: a stream of those above, below 256.
        number: which block of this index, below 2**24.
    """
    stream_and_number = (np.uint64(stream) << _STREAM_SHIFT) | np.uint64(number)
    return philox4x32(
        np.uint64(index) & _LOW_32_BITS,
        np.uint64(index) >> _32_BITS,
        np.uint64(epoch) & _LOW_32_BITS,
        stream_and_number,
        np.uint64(seed) & _LOW_32_BITS,
        np.uint64(seed) >> _32_BITS,
    )


@kernel
def bounded(word: np.uint64, low: Int, high: Int) -> Int:
    """Return an integer in [low, high], both included, from a random 32-bit word.

    The word divided by 2**32 is a fraction of the range, which a multiplication and a shift turn
    into an integer. The probability of each integer is right to within 2**-32.
    """
    count = np.uint64(high - low + 1)
    return low + np.int64((word * count) >> _32_BITS)


def threshold(probability: float) -> int:
    """Return the integer such that a random 32-bit word is below it with this probability."""
    return round(probability * 2**32)
