"""Searching by words of 64 cells: the moves to a goal are the reference's, on maps of any size.

That its labels are the reference's is in test_labels.py.
"""

from __future__ import annotations

from dataclasses import replace
from random import Random

import numpy as np
import pytest
from helpers import reference
from helpers.examples import examples
from helpers.grids import serpentine
from helpers.reference import Cell
from helpers.specs import MOVEMENTS, SIDES, movements
from hypothesis import given
from hypothesis import strategies as st

from mapdata import MapSpec, Movement, generate, label
from mapdata.arrays import Bytes
from mapdata.generators.maps import pack
from mapdata.search.bitboard import (
    build_board,
    count_bits,
    flood_within,
    nth_cell,
    write_optimal_moves,
)
from mapdata.search.kernels import search_memory
from mapdata.search.lattice import move_rule

WORDS = [(7, 63), (7, 64), (7, 65), (6, 127), (6, 128), (6, 129), (5, 200), (200, 5), (66, 66)]
"""Rows of one word and of several, that they fill and that they do not."""


def test_bits_are_counted() -> None:
    """As Python counts them: in each word alone, and in several from one to another."""
    source = Random(1)
    words = [0, 1, 2**64 - 1, 2**63]
    words += [source.getrandbits(64) for _ in range(100)]
    expected = [bin(word).count("1") for word in words]
    array = np.array(words, np.uint64)
    counts = [count_bits(array, k, k + 1) for k in range(len(words))]
    assert counts == expected
    assert count_bits(array, 1, len(words)) == sum(expected[1:])
    assert count_bits(array, 3, 9) == sum(expected[3:9])


def test_one_column_of_wall_more_changes_no_label() -> None:
    """Maps of 64 columns are searched by bits, those of 65 cell by cell: the same paths, iterations
    and costs, in the same order.
    """
    maps = generate(MapSpec.preset("dungeon"), 9, range(40))
    assert maps.columns == 64
    walled = np.pad(maps.occupancy, ((0, 0), (0, 0), (0, 1)), constant_values=1)
    wider = replace(maps, columns=65, packed=pack(walled))
    by_bits = label(maps).bfs
    by_cells = label(wider).bfs
    for name in ("moves", "offsets", "iterations", "costs"):
        actual = getattr(by_bits, name)
        expected = getattr(by_cells, name)
        np.testing.assert_array_equal(actual, expected, err_msg=name)


def assert_moves_are_the_references(grid: Bytes, goal: Cell, movement: Movement) -> None:
    """Compare the moves to a goal with the reference: without costs, when they may be found by
    bits, and with costs, when they are not.
    """
    expected = reference.reference_moves(grid.tolist(), goal, movement)
    for needs_costs in (False, True):
        lattice, scratch = search_memory(grid.shape, move_rule(movement))
        write_optimal_moves(grid, *goal, needs_costs, lattice, scratch)
        with_border = scratch.came_from.reshape(-1, lattice.stride)
        moves = with_border[1:-1, 1:-1]
        np.testing.assert_array_equal(moves, expected)


def scattered(
    shape: tuple[int, int], density: float, goal: Cell, source: np.random.Generator
) -> Bytes:
    """Return a grid of which this share is occupied at random, but not the goal."""
    grid = (source.random(shape) < density).astype(np.uint8)
    grid[goal] = 0
    return grid


@movements
@pytest.mark.parametrize("shape", WORDS, ids=str)
def test_rows_of_several_words(shape: tuple[int, int], movement: Movement) -> None:
    """From the corners and the ends of words, on empty and scattered maps."""
    source = np.random.default_rng(shape)
    rows, columns = shape
    last = (rows - 1, columns - 1)
    end_of_word = (last[0] // 2, min(63, last[1]))
    for goal, density in (((0, 0), 0.0), (last, 0.15), (end_of_word, 0.35)):
        grid = scattered(shape, density, goal, source)
        assert_moves_are_the_references(grid, goal, movement)


@examples(40)
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
    if turned:
        shape = shape[::-1]
    source = np.random.default_rng(seed)
    goal = (int(source.integers(shape[0])), int(source.integers(shape[1])))
    grid = scattered(shape, density, goal, source)
    assert_moves_are_the_references(grid, goal, movement)


@movements
@pytest.mark.parametrize("shape", [(21, 9), (9, 70)], ids=str)
def test_long_corridors(shape: tuple[int, int], movement: Movement) -> None:
    """Where few cells are equally far from the goal, the search by bits gives up: after 5/4 of
    H + W levels, which the corridor is longer than.
    """
    goal = (0, 0)
    grid = serpentine(*shape, np.random.default_rng(1))
    moves = reference.reference_distances(grid.tolist(), goal, Movement())
    farthest = max(straight for straight, _ in moves.values())
    assert farthest > 5 / 4 * sum(shape)
    assert_moves_are_the_references(grid, goal, movement)


@examples(60)
@given(
    shape=st.tuples(st.integers(1, 7), SIDES | st.sampled_from([127, 128, 200])),
    turned=st.booleans(),
    density=st.sampled_from([0.0, 0.1, 0.3]),
    seed=st.integers(0, 2**32),
    levels=st.integers(2, 40) | st.just(600),
)
def test_a_flood_keeps_the_cells_within_the_limits_of_their_level(
    shape: tuple[int, int], turned: bool, density: float, seed: int, levels: int
) -> None:
    """Limits at random, open ones and empty ones, on maps whose rows take one word or several."""
    if turned:
        shape = shape[::-1]
    source = np.random.default_rng(seed)
    row, column = (int(source.integers(side)) for side in shape)
    grid = scattered(shape, density, (row, column), source)
    limits = np.sort(source.integers(0, 12, (levels, 2)), axis=1)
    numbers = np.arange(levels)
    kind = source.integers(0, 4, levels)
    limits[kind == 0] = (1, 10_000)
    limits[kind == 1] = (1, 0)
    limits[kind == 2, 1] = numbers[kind == 2]
    board = build_board(grid)
    board = board._replace(carry=np.uint64(board.carry))
    is_complete = flood_within(row, column, limits, board)
    costs = reference.reference_distances(grid.tolist(), (row, column), Movement())
    kept = set()
    for cell, (level, _) in costs.items():
        distance = abs(cell[0] - row) + abs(cell[1] - column)
        if 0 < level < levels and limits[level, 0] <= distance <= limits[level, 1]:
            kept.add(cell)
    reached = {
        nth_cell(board.reached, board.stride, number)
        for number in range(count_bits(board.reached, 0, len(board.reached)))
    }
    assert reached == kept
    assert is_complete == (max(level for level, _ in costs.values()) < levels - 1)
