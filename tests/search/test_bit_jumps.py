"""The bits of maps, and the memory of jump point search on them. Its paths are in
test_jump_points.py.
"""

from __future__ import annotations

import numpy as np
import pytest
from helpers.grids import scipy_distances
from helpers.specs import MOVEMENTS

from mapdata import Movement, search_batch
from mapdata.arrays import Bytes
from mapdata.search.api import solve_by_jump_points
from mapdata.search.bit_jumps import (
    BitMap,
    JumpMemory,
    empty_bit_map,
    jump_memory,
    jump_to_goals,
    load_bits,
)
from mapdata.search.kernels import search_memory
from mapdata.search.lattice import move_rule

SIDES = (1, 2, 7, 8, 63, 64, 65, 72, 127, 128, 129)

eight_moves = pytest.mark.parametrize(
    "movement", MOVEMENTS[1:], ids=["8", "8-one", "8-cutting", "8-cutting-one"]
)


def scattered(source: np.random.Generator, shape: tuple[int, int], share: float) -> Bytes:
    """Return a grid with this share of occupied cells."""
    return (source.random(shape) < share).astype(np.uint8)


def lines_of(bits: BitMap, first: int, pitch: int, lines: int) -> Bytes:
    """Return the ``lines`` of bits from bit ``first`` on, with all bits before the next line."""
    flat = np.unpackbits(bits.words.view(np.uint8), bitorder="little")
    return flat[first : first + lines * pitch].reshape(lines, pitch)


@pytest.mark.parametrize("rows", SIDES)
@pytest.mark.parametrize("columns", SIDES)
def test_the_bits_are_the_free_cells_by_rows_and_by_columns(rows: int, columns: int) -> None:
    """Of the second of two maps, so that nothing of the first is left; all other bits are 0."""
    source = np.random.default_rng(rows + 1000 * columns)
    bits = empty_bit_map((rows, columns))
    for share in (0.2, 0.7):
        grid = scattered(source, (rows, columns), share)
        assert load_bits(grid, bits, np.empty(64, np.uint64))
    by_rows = lines_of(bits, bits.first_by_rows, bits.row_pitch, rows)
    by_columns = lines_of(bits, bits.first_by_columns, bits.column_pitch, columns)
    np.testing.assert_array_equal(by_rows[:, :columns], 1 - grid)
    np.testing.assert_array_equal(by_columns[:, :rows], 1 - grid.T)
    assert sum(int(word).bit_count() for word in bits.words) == 2 * (grid == 0).sum()
    # Scans read one line before the map and one behind it, and up to 63 bits more.
    assert bits.row_pitch > columns
    assert bits.column_pitch > rows


@pytest.mark.parametrize("cell", [(0, 0), (3, 70), (8, 71)])
def test_another_number_than_0_and_1_is_seen(cell: tuple[int, int]) -> None:
    """In the eight cells of a byte, and behind them."""
    grid = np.zeros((9, 72), np.uint8)
    bits = empty_bit_map(grid.shape)
    block = np.empty(64, np.uint64)
    assert load_bits(grid, bits, block)
    grid[cell] = 2
    assert not load_bits(grid, bits, block)


@eight_moves
@pytest.mark.parametrize("side", [62, 63, 64, 65, 66, 126, 127, 128, 129])
def test_costs_around_the_width_of_a_word_equal_scipys(movement: Movement, side: int) -> None:
    """On wide and on high maps, from a cell to all others."""
    source = np.random.default_rng(side)
    for shape, share in (((6, side), 0.25), ((side, 5), 0.1), ((3, side), 0.03)):
        grid = scattered(source, shape, share)
        free = np.argwhere(grid == 0)
        goal = tuple(free[source.integers(len(free))].tolist())
        costs = scipy_distances(grid, [goal], movement)[0]
        paths, _ = solve_by_jump_points(grid, free, np.tile(goal, (len(free), 1)), movement)
        np.testing.assert_allclose(paths.cost, costs[tuple(free.T)], rtol=1e-12)


def memory_of(grid: Bytes, movement: Movement) -> JumpMemory:
    """Return memory for maps of the shape of ``grid``."""
    _, scratch = search_memory(grid.shape, move_rule(movement))
    return jump_memory(grid.shape, scratch)


@eight_moves
def test_what_the_heap_drops_changes_nothing(movement: Movement) -> None:
    """With room for the pushes of one expansion alone, stale entries are dropped at each of them.

    The memory behind this room is there, so that a heap which grows beyond it does no harm.
    """
    source = np.random.default_rng(7)
    for _ in range(20):
        grid = scattered(source, (20, 23), 0.3)
        free = np.argwhere(grid == 0)
        starts, goals = free[source.integers(len(free), size=(2, 30))]
        lattice, _ = search_memory(grid.shape, move_rule(movement))
        bits = empty_bit_map(grid.shape)
        memory = memory_of(grid, movement)
        narrow = memory._replace(f=memory.f[: 8 * min(grid.shape) + 8])
        found = [
            jump_to_goals(grid[None], starts, goals, bits, lattice, room)
            for room in (memory, narrow)
        ]
        (wide_paths, wide_looks), (narrow_paths, narrow_looks) = found
        np.testing.assert_array_equal(wide_paths.cells, narrow_paths.cells)
        np.testing.assert_array_equal(wide_paths.expansions, narrow_paths.expansions)
        np.testing.assert_array_equal(wide_looks, narrow_looks)


def test_the_memory_suffices_for_all_cells_and_an_expansion() -> None:
    """After stale entries are dropped, there is at most one for each cell."""
    for shape in [(1, 1), (1, 50), (2, 3), (40, 30)]:
        memory = memory_of(np.zeros(shape, np.uint8), Movement(8))
        cells = shape[0] * shape[1]
        assert len(memory.nodes) == cells
        assert len(memory.slots) >= cells
        assert len(memory.heap) >= len(memory.f) >= cells + 8 * min(shape) + 8


@eight_moves
def test_what_is_in_the_memory_does_not_matter(movement: Movement) -> None:
    """Numbers of earlier searches, on other maps, are not mistaken for nodes."""
    source = np.random.default_rng(11)
    grids = np.stack([scattered(source, (9, 70), 0.3) for _ in range(40)])
    grids[:, 0, 0] = grids[:, 8, 69] = 0
    starts = np.zeros((40, 2), np.int64)
    goals = np.full((40, 2), (8, 69))
    together, looks = solve_by_jump_points(grids, starts, goals, movement)
    np.testing.assert_array_equal(
        together.cost, search_batch("astar", grids, starts, goals, movement).cost
    )
    for fill in (0, 1, 255):
        lattice, scratch = search_memory(grids.shape[1:], move_rule(movement))
        for array in scratch:
            array.view(np.uint8)[:] = fill
        memory = jump_memory(grids.shape[1:], scratch)
        bits = empty_bit_map(grids.shape[1:])
        again, looks_again = jump_to_goals(grids, starts, goals, bits, lattice, memory)
        np.testing.assert_array_equal(again.cells, together.cells)
        np.testing.assert_array_equal(again.expansions, together.iterations)
        np.testing.assert_array_equal(looks_again, looks)
