"""Searching by words of 64 cells; that its labels are the reference's is in test_labels.py."""

from __future__ import annotations

from dataclasses import replace
from random import Random

import numpy as np

from mapdata import MapSpec, generate, label
from mapdata.generators import pack
from mapdata.search.bitboard import count_bits


def test_bits_are_counted() -> None:
    """As Python counts them."""
    words = [0, 1, 2**64 - 1, 2**63, *(Random(1).getrandbits(64) for _ in range(100))]
    assert count_bits(np.array(words, np.uint64), 1, len(words)) == sum(
        bin(word).count("1") for word in words
    )


def test_one_column_of_wall_more_changes_no_label() -> None:
    """Maps of 65 columns are searched cell by cell: the same paths, iterations and costs, in the
    same order.
    """
    maps = generate(MapSpec.preset("dungeon"), 9, range(40))
    wider = pack(np.pad(maps.occupancy, ((0, 0), (0, 0), (0, 1)), constant_values=1))
    narrow, wide = label(maps).bfs, label(replace(maps, columns=65, packed=wider)).bfs
    for name in ("moves", "offsets", "iterations", "costs"):
        np.testing.assert_array_equal(getattr(narrow, name), getattr(wide, name), err_msg=name)
