"""How many maps are tried, and which stored maps are drawn: section 6 of docs/format.md."""

from __future__ import annotations

from math import ceil

import numpy as np
import pytest
from helpers import reference
from scipy import stats

from mapdata import Pairs, Random, Route
from mapdata.problems.sources import Source
from mapdata.problems.substitutes import draw_substitutes, limit_of_tries


@pytest.mark.parametrize(
    ("problems", "map_size", "maps"),
    [
        (Random(), (64, 64), ceil(4e8 / (32 * 64 * 64))),
        (Random(per_map=5), (30, 50), ceil(4e8 / (32 * 30 * 50))),
        (Random(to_first_seed_point=True), (64, 64), ceil(4e8 / (64 * 64))),
        (Route(), (128, 64), ceil(4e8 / (128 * 64))),
        (Pairs(), (100, 400), 10_000),
        (Random(), (1024, 1024), 20),
        (Random(), (1, 1), 100_000),
    ],
)
def test_so_many_maps_are_tried(problems: Source, map_size: tuple[int, int], maps: int) -> None:
    """The goals on them have 4 * 10^8 cells; but neither few nor very many maps are tried."""
    assert limit_of_tries(problems, map_size, 32) == maps


def test_stored_substitutes_are_drawn_from_all_maps() -> None:
    """By words 0 and 1 of stream 8, and evenly, over problems, epochs and numbers alike."""
    for map_count in (7, 2**32 - 1):
        indices = np.array([0, 3, 2**40])
        numbers = np.array([1, 9, 99_999])
        drawn = draw_substitutes(np.uint64(5), indices, 6, numbers, map_count)
        for index, number, place in zip(indices, numbers, drawn, strict=True):
            w0, w1, _, _ = reference.block(5, int(index), 6, 8, int(number))
            assert place == (w0 * 2**32 + w1) * map_count >> 64
    one = np.ones(9000, np.int64)
    several = np.arange(9000)
    counts = [
        np.bincount(draw_substitutes(np.uint64(5), several, 0, one, 90)),
        np.bincount(draw_substitutes(np.uint64(5), one, 0, several + 1, 90)),
    ]
    assert min(stats.chisquare(count).pvalue for count in counts) > 1e-3
