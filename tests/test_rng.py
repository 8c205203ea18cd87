"""The generator: published vectors, the layout of key and counter, and draws that are what they
claim to be.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from typing import SupportsInt

import numpy as np
import pytest
from helpers import reference
from helpers.examples import examples
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from mapdata import rng

WORD = 2**32 - 1
SETTINGS = examples(300)
words = st.integers(0, WORD)


def philox(counter: tuple[int, ...], key: tuple[int, ...]) -> tuple[int, ...]:
    """Call the kernel with plain integers."""
    kernel: Callable[..., Iterable[SupportsInt]] = rng.philox4x32
    return tuple(int(word) for word in kernel(*(np.uint64(value) for value in (*counter, *key))))


def block(seed: int, index: int, epoch: int, stream: int, number: int) -> tuple[int, ...]:
    """Call the kernel with plain integers."""
    kernel: Callable[..., Iterable[SupportsInt]] = (
        rng.block
    )  # whatever its annotations, numba takes unsigned integers
    return tuple(
        int(word)
        for word in kernel(*(np.uint64(value) for value in (seed, index, epoch, stream, number)))
    )


def bounded(word: int, low: int, high: int) -> int:
    """Call the kernel with plain integers."""
    kernel: Callable[..., SupportsInt] = rng.bounded
    return int(kernel(np.uint64(word), low, high))


# Random123, examples/kat_vectors, philox4x32 with 10 rounds.
KNOWN_ANSWERS = [
    (
        "00000000 00000000 00000000 00000000",
        "00000000 00000000",
        "6627e8d5 e169c58d bc57ac4c 9b00dbd8",
    ),
    (
        "ffffffff ffffffff ffffffff ffffffff",
        "ffffffff ffffffff",
        "408f276d 41c83b0e a20bc7c6 6d5451fd",
    ),
    (
        "243f6a88 85a308d3 13198a2e 03707344",
        "a4093822 299f31d0",
        "d16cfe09 94fdcceb 5001e420 24126ea1",
    ),
]


def numbers(text: str) -> tuple[int, ...]:
    """Read words written in hexadecimal."""
    return tuple(int(word, 16) for word in text.split())


@pytest.mark.parametrize(("counter", "key", "expected"), KNOWN_ANSWERS, ids=["zeros", "ones", "pi"])
def test_philox_gives_the_published_answers(counter: str, key: str, expected: str) -> None:
    """Random123's known-answer vectors hold, for the kernel and for the reference that the other
    tests trust.
    """
    assert philox(numbers(counter), numbers(key)) == numbers(expected)
    assert reference.philox4x32(numbers(counter), numbers(key)) == numbers(expected)


@SETTINGS
@given(st.tuples(words, words, words, words), st.tuples(words, words))
def test_philox_equals_the_reference(counter: tuple[int, ...], key: tuple[int, ...]) -> None:
    """Any counter under any key gives the reference's four words."""
    assert philox(counter, key) == reference.philox4x32(counter, key)


@SETTINGS
@given(
    st.integers(0, 2**64 - 1),
    st.integers(0, 2**63 - 1),
    words,
    st.integers(0, 4),
    st.integers(0, 2**24 - 1),
)
def test_block_lays_out_key_and_counter(
    seed: int, index: int, epoch: int, stream: int, number: int
) -> None:
    """Key = the seed's halves, counter = (index low, index high, epoch, stream and number)."""
    assert block(seed, index, epoch, stream, number) == reference.block(
        seed, index, epoch, stream, number
    )


def test_streams_are_numbered_as_the_format_says() -> None:
    """The streams of section 5 are part of the format."""
    assert (rng.MAP, rng.PROBLEM, rng.SPLIT, rng.AUGMENTATION, rng.ORDER) == (0, 1, 2, 3, 4)
    assert (rng.POINTS, rng.TERRAIN, rng.IMAGE, rng.SUBSTITUTE) == (5, 6, 7, 8)


def test_every_coordinate_gives_other_words() -> None:
    """Seeds, indices (low and high half of each), epochs, streams and numbers never share a block,
    nor even a word.
    """
    halves = [0, 1, 2**31, 2**32 - 1, 2**32, 2**63 - 1]
    small = [0, 1, 255]
    seeds = [*halves, 2**64 - 1]
    coordinates = list(itertools.product(seeds, halves, [0, 1, WORD], range(5), small))
    blocks = {block(*coordinate) for coordinate in coordinates}
    assert len(blocks) == len(coordinates)
    for column in range(4):
        distinct_words = {words[column] for words in blocks}
        assert len(distinct_words) > 0.999 * len(coordinates)


@pytest.mark.parametrize(
    ("low", "high"), [(0, 0), (0, 1), (2, 9), (14, 33), (7, 15), (0, 63), (5, 5), (0, WORD)]
)
def test_bounded_reaches_both_ends(low: int, high: int) -> None:
    """The least and the greatest word give the ends of the range."""
    assert (bounded(0, low, high), bounded(WORD, low, high)) == (low, high)


@SETTINGS
@given(words, st.integers(0, 2**20), st.integers(0, 2**20))
def test_bounded_equals_multiply_high(word: int, low: int, span: int) -> None:
    """A bounded draw is low + (word * choices) / 2**32, rounded down, and stays inside."""
    value = bounded(word, low, low + span)
    assert value == reference.bounded(word, low, low + span)
    assert low <= value <= low + span


def test_bounded_draws_are_uniform() -> None:
    """Chi-square over the twenty room sides of Table 1, for each of a block's four words."""
    draws = np.array(
        [[bounded(word, 14, 33) for word in block(7, index, 0, 0, 1)] for index in range(10_000)]
    )
    for column in draws.T:
        counts = np.bincount(column - 14, minlength=20)
        assert len(counts) == 20
        assert stats.chisquare(counts).pvalue > 1e-4


@pytest.mark.parametrize("axis", range(5), ids=["seed", "index", "epoch", "stream", "number"])
def test_bytes_are_uniform_along_every_coordinate(axis: int) -> None:
    """Counting one coordinate up gives uniform bytes, so that neighbouring maps, rooms and epochs
    look unrelated.
    """
    coordinates = np.zeros((4096 if axis != 3 else 256, 5), dtype=np.int64)
    coordinates[:, axis] = np.arange(len(coordinates))
    drawn = np.array([block(*map(int, row)) for row in coordinates], dtype="<u4")
    assert stats.chisquare(np.bincount(drawn.view(np.uint8).ravel(), minlength=256)).pvalue > 1e-4
