"""Maps: one bit a cell, and back. What is drawn into them is in test_rooms.py and test_mazes.py."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from helpers.examples import examples
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from mapdata import Maps, Movement
from mapdata.arrays import Bytes
from mapdata.generators.maps import pack

SETTINGS = examples(100)


@SETTINGS
@given(
    arrays.arrays(
        np.uint8,
        st.tuples(st.just(2), st.integers(1, 4), st.integers(1, 130)),
        elements=st.integers(0, 1),
    )
)
def test_maps_are_packed_as_documented(grids: Bytes) -> None:
    """Bit k of word j is column 64 j + k; spare bits are 0."""
    packed = pack(grids)
    for m, row in np.ndindex(grids.shape[:2]):
        value = sum(int(word) << 64 * j for j, word in enumerate(packed[m, row]))
        assert value == sum(int(cell) << k for k, cell in enumerate(grids[m, row]))
    empty = Maps.empty(Movement(), (grids.shape[1], grids.shape[2]), np.arange(len(grids)), 2)
    assert np.array_equal(replace(empty, packed=packed).occupancy, grids)
