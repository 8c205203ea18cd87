"""Searching by words of 64 cells: the moves to a goal are the reference's, on maps of any size.

That its labels are the reference's is in test_labels.py.
"""

from __future__ import annotations

from dataclasses import replace
from random import Random

import numpy as np
import pytest
from helpers import reference
from helpers.grids import serpentine
from helpers.reference import Cell
from helpers.specs import MOVEMENTS, SIDES, movements
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as numpy_arrays

from mapdata import MapSpec, Movement, generate, label
from mapdata.arrays import Bytes
from mapdata.generators import pack
from mapdata.search import distance_field, lattice_of, rule_of
from mapdata.search.bitboard import board_of, count_bits, is_direct, search_around
from mapdata.search.kernels import scratch
from mapdata.search.lattice import ASTAR, heuristics

WORDS = [(7, 63), (7, 64), (7, 65), (6, 127), (6, 128), (6, 129), (5, 200), (200, 5), (66, 66)]
"""Rows of one word and of several, that they fill and that they do not."""


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


def compare(grid: Bytes, goal: Cell, movement: Movement) -> None:
    """Compare moves with the reference; twice, since alone they are found by bits."""
    expected = reference.reference_moves(grid.tolist(), goal, movement)
    lattice = lattice_of(grid.shape, rule_of(movement))
    for costs_too in (False, True):
        buffers = scratch(ASTAR, lattice)
        search_around(grid, *goal, costs_too, lattice, buffers)
        found = buffers.came.reshape(-1, lattice.stride)[1:-1, 1:-1]
        np.testing.assert_array_equal(found, expected)


@movements
@pytest.mark.parametrize("shape", WORDS, ids=str)
def test_rows_of_several_words(shape: tuple[int, int], movement: Movement) -> None:
    """From the corners and the ends of words, on empty and scattered maps."""
    source = np.random.default_rng(shape)
    last_row = shape[0] - 1
    last_column = shape[1] - 1
    goals = [(0, 0), (last_row, last_column), (last_row // 2, min(63, last_column))]
    for k, density in enumerate((0.0, 0.15, 0.35)):
        grid = (source.random(shape) < density).astype(np.uint8)
        grid[goals[k]] = 0
        compare(grid, goals[k], movement)


@settings(max_examples=40)
@given(
    shape=st.tuples(st.integers(1, 7), SIDES | st.sampled_from([127, 128, 200])),
    turned=st.booleans(),
    density=st.sampled_from([0.0, 0.1, 0.3, 0.45]),
    seed=st.integers(0, 2**32),
    movement=st.sampled_from(MOVEMENTS),
)
def test_maps_of_any_shape(
    shape: tuple[int, int], turned: bool, density: float, seed: int, movement: Movement
) -> None:
    """Scattered maps, and a goal anywhere."""
    source = np.random.default_rng(seed)
    shape = shape[::-1] if turned else shape
    grid = (source.random(shape) < density).astype(np.uint8)
    row, column = source.integers(0, shape).tolist()
    grid[row, column] = 0
    compare(grid, (row, column), movement)


@movements
def test_long_corridors(movement: Movement) -> None:
    """Where few cells are equally far from the goal, the search by bits gives up."""
    source = np.random.default_rng(1)
    for shape in ((21, 9), (9, 70)):
        grid = serpentine(*shape, source)
        compare(grid, (0, 0), movement)


@given(
    grid=numpy_arrays.arrays(
        np.uint8,
        st.tuples(st.integers(1, 9), st.integers(2, 9) | st.integers(63, 64)),
        elements=st.sampled_from([0, 0, 0, 1]),
    ),
    data=st.data(),
    movement=st.sampled_from([Movement(), Movement(8)]),
)
def test_easy_problems_are_known_without_a_search(
    grid: Bytes, data: st.DataObject, movement: Movement
) -> None:
    """Direct are the cells at no more than the heuristic's distance, and those alone."""
    free = np.argwhere(grid == 0)
    assume(len(free))
    row, column = data.draw(st.sampled_from(free.tolist()))
    lattice = lattice_of(grid.shape, rule_of(movement))
    words = board_of(grid).free
    found = [is_direct((r, c), (row, column), lattice, words) for r, c in free.tolist()]
    distances = distance_field(grid, (row, column), movement)[tuple(free.T)]
    least = heuristics(free, np.array([[row, column]]), movement)
    np.testing.assert_array_equal(found, (distances >= 0) & (distances <= least + 1e-3))


@given(
    grid=numpy_arrays.arrays(
        np.uint8, st.tuples(st.integers(1, 7), st.integers(1, 7)), elements=st.integers(0, 1)
    ),
    movement=st.sampled_from(
        [
            Movement(8, corner_cutting=True),
            Movement(8, diagonal_cost=1),
            Movement(8, corner_cutting=True, diagonal_cost=1),
        ]
    ),
)
def test_direct_paths_are_paths_under_other_rules(grid: Bytes, movement: Movement) -> None:
    """Some are missed, none is found wrongly."""
    free = np.argwhere(grid == 0)
    lattice = lattice_of(grid.shape, rule_of(movement))
    words = board_of(grid).free
    for row, column in free.tolist():
        found = [is_direct((r, c), (row, column), lattice, words) for r, c in free.tolist()]
        distances = distance_field(grid, (row, column), movement)[tuple(free.T)]
        least = heuristics(free, np.array([[row, column]]), movement)
        assert (distances[found] >= 0).all()
        assert (distances <= least + 1e-3)[found].all()
