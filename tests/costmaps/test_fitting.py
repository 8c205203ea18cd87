"""The fit: how much paths turn, and that the driver's noise is found."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mapdata.arrays import Ints, offsets_of
from mapdata.costmaps.fitting import PIECE, turns
from mapdata.costmaps.sites import Paths


def paths_of(*paths: Ints) -> Paths:
    """Return paths in windows of their own."""
    counts = [len(path) for path in paths]
    numbers = np.repeat(np.arange(len(paths)), counts)
    return Paths(np.column_stack([numbers, np.concatenate(paths)]), offsets_of(counts))


@pytest.mark.parametrize("slope", [0.0, 0.2, 0.41, 0.77, 1.0, -0.6])
def test_a_straight_line_in_cells_has_no_turns(slope: float) -> None:
    """In any direction, although its moves change their direction all the time."""
    columns = np.arange(60)
    line = np.stack([np.rint(slope * columns).astype(np.int64) + 50, columns], axis=1)
    extra, straight = turns(paths_of(line, line[::-1]))
    assert extra == pytest.approx(0, abs=1e-9)
    assert straight > 0


def test_turns_are_the_extra_length_of_pieces() -> None:
    """A path that goes four cells to the right and four down, and one that zigzags."""
    corner = np.array([(0, k) for k in range(5)] + [(k, 4) for k in range(1, 5)])
    zigzag = np.array([(k % 2, k) for k in range(9)])
    assert len(corner) == len(zigzag) == PIECE + 1
    assert turns(paths_of(corner)) == pytest.approx((8 - 4 * math.sqrt(2), 4 * math.sqrt(2)))
    assert turns(paths_of(zigzag)) == pytest.approx((8 * math.sqrt(2) - 8, 8))


def test_pieces_lie_within_one_path() -> None:
    """Short paths have none, and two paths add up."""
    short = np.array([(0, k) for k in range(PIECE)])
    zigzag = np.array([(k % 2, k) for k in range(20)])
    assert turns(paths_of(short, short + 1)) == (0, 0)
    both = turns(paths_of(zigzag, short, zigzag + 3))
    assert both == pytest.approx(tuple(2 * number for number in turns(paths_of(zigzag))))
