"""Searches around a goal: costs and optimal moves are those of the reference, on maps of any size.

The fields made of them are in tests/datasets/test_fields.py.
"""

from __future__ import annotations

import numpy as np
import pytest
from helpers import reference
from helpers.grids import random_grids, serpentine
from helpers.reference import Cell
from helpers.specs import MOVEMENTS, SIDES, movements
from hypothesis import given, settings
from hypothesis import strategies as st

from mapdata import Movement
from mapdata.arrays import Bytes, Float32s
from mapdata.search import rule_of
from mapdata.search.bitboard import board_of, search_board
from mapdata.search.goals import fill_goal_fields, goal_fields
from mapdata.search.lattice import lattice_of

WORDS = [(7, 63), (7, 64), (7, 65), (6, 127), (6, 128), (6, 129), (5, 200), (200, 5), (66, 66)]
"""Rows of one word and of several, that they fill and that they do not."""


def around(grid: Bytes, goal: Cell, movement: Movement, *wanted: str) -> tuple[Bytes, Float32s]:
    """Return the optimal moves and the costs to go, those of them that are wanted."""
    fields = goal_fields((1, *grid.shape), wanted)
    goals = np.array([goal])
    fill_goal_fields(grid[None], goals, goals, rule_of(movement), fields)
    return fields.optimal_moves, fields.cost_to_go


def compare(grid: Bytes, goal: Cell, movement: Movement) -> None:
    """Compare with the reference; the moves twice, since alone they are found by bits."""
    rows = grid.tolist()
    moves = reference.reference_moves(rows, goal, movement)
    alone, _ = around(grid, goal, movement, "optimal_moves")
    np.testing.assert_array_equal(alone[0, 0], moves)
    both, costs = around(grid, goal, movement, "optimal_moves", "cost_to_go")
    np.testing.assert_array_equal(both[0, 0], moves)
    field = reference.reference_field(rows, goal, movement)
    np.testing.assert_array_equal(costs[0, 0], field)


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
    """Where the search by bits gives up."""
    source = np.random.default_rng(1)
    for shape in ((21, 9), (9, 70)):
        grid = serpentine(*shape, source)
        compare(grid, (0, 0), movement)


def test_the_search_by_bits_gives_up_on_long_corridors_alone() -> None:
    """Else it is not what the other tests compare."""
    for grid in (*random_grids(3), np.zeros((70, 130), np.uint8)):
        moves = np.empty(10_000, np.uint8)
        lattice = lattice_of(grid.shape, rule_of(Movement()))
        assert search_board(grid, 0, 0, board_of(grid.shape), lattice, moves)
    grid = serpentine(64, 64, np.random.default_rng(1))
    lattice = lattice_of(grid.shape, rule_of(Movement()))
    assert not search_board(grid, 0, 0, board_of(grid.shape), lattice, moves)
