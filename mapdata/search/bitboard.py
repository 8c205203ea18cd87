"""Breadth-first search of 4-connected maps on bit boards, 64 cells at a time.

A bit board is a set of cells. Each row of the map takes one word of 64 bits or several, and column
c is bit c % 64 of word c // 64 of its row. A level of the search, which is the set of all cells
equally far from where it began, is such a set. The next level is the current one shifted by one
cell in the four directions, without the cells that were seen before.

`write_optimal_moves` finds all moves that lead nearer to a goal. `bfs_labels_by_bits` finds the
paths that the queue of breadth-first search finds, on maps with one word a row. The order of the
queue, first in, first out, seems to be lost in a set of bits, but it can be recovered. Within a
level, the queue holds cells in the order of their paths, compared move by move (N < E < S < W),
because a cell's parent is the first of its neighbours in the queue and neighbours are seen in the
order of moves. Two things follow:

- The path that the queue finds is the first of all shortest paths in that order. A descent from the
  start through the levels around the goal finds it, if it takes the first move that leads nearer.
- The cells expanded before the goal are all cells of nearer levels, and those cells of the goal's
  level whose paths come first. That second set can be carried along the path.

Moves, labels and samples are computed from the same boards and levels, so they are one file.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Ints, Words
from mapdata.generators.maps import WORD
from mapdata.jit import Int, inlined, kernel
from mapdata.search.ground import EXACT
from mapdata.search.kernels import Scratch, shortest_costs
from mapdata.search.lattice import INFINITY, NO_DIAGONALS, Lattice, cell_at, load, only

MAX_SIDE = 64
"""Largest number of rows and of columns of a map that `bfs_labels_by_bits` accepts."""

_MARGIN = 3
"""Empty rows above and below the map. A level reads two rows beyond those that the level before it
wrote, and clears a third one.
"""

_LEVEL_WORDS = MAX_SIDE + 2 * _MARGIN
"""Words of a level whose rows take one word each."""

_MAX_LEVELS = MAX_SIDE * MAX_SIDE + 2
"""Largest number of levels of a search."""

_NO_BITS = np.uint64(0)
_ONE = np.uint64(1)
_TWO = np.uint64(2)
_TOP_BIT = np.uint64(63)
ALL_BITS = ~np.uint64(0)
_EVEN_BITS = np.uint64(0x5555555555555555)
_LOW_HALVES_OF_NIBBLES = np.uint64(0x3333333333333333)
_LOW_HALVES_OF_BYTES = np.uint64(0x0F0F0F0F0F0F0F0F)
_LOWEST_BITS_OF_BYTES = np.uint64(0x0101010101010101)

_BYTE = 8
"""Bits of a byte."""

_SPREAD_BITS = np.unpackbits(np.arange(256, dtype=np.uint8), bitorder="little").view(np.uint64)
"""(256,) for each byte, a word whose eight bytes are the byte's bits."""


class Board(NamedTuple):
    """A map as bits, and what a search of it finds.

    Each set below is an array (words,) with an empty margin of 3 rows above and below the map. Cell
    (row, 0) is bit 0 of word ``(row + 3) * stride``.

    Attributes:
        stride: words of a row.
        carry: all bits set if rows have several words, between which bits are carried; else 0.
        free: the free cells.
        reached: the cells that the search reaches.
        level_bit: the cells of ``reached`` whose level has bit 1 set, the second lowest one.
    """

    stride: Int
    carry: np.uint64
    free: Words
    reached: Words
    level_bit: Words


@kernel
def write_optimal_moves(
    grid: Bytes, row: Int, column: Int, needs_costs: bool, lattice: Lattice, scratch: Scratch
) -> Int:
    """Write which moves begin shortest paths to (row, column), for every cell.

    Moves alone are found by bits on 4-connected maps, where that is faster. It is not faster in
    mazes, nor on narrow maps, since `_write_board_moves` writes eight cells at a time.

    Args:
        grid: (H, W).
        row: of the goal.
        column: of the goal.
        needs_costs: whether ``scratch.g`` becomes the costs of `shortest_costs`; if not, its
            content is undefined.
        lattice: of the map.
        scratch: whose ``came_from`` becomes bit sets of moves, as from `shortest_costs`.

    Returns:
        EXACT, or TOO_LONG, as `shortest_costs`.
    """
    uses_bits = lattice.diagonals == NO_DIAGONALS and not needs_costs and grid.shape[1] >= _BYTE
    if uses_bits and grid[row, column] == 0:
        board = build_board(grid)
        if flood_board(row, column, 5 * sum(grid.shape) // 4, board):
            _write_board_moves(row + column, board, lattice, grid.shape, scratch.came_from)
            return EXACT
    load(grid, scratch.came_from)
    source = only(cell_at(row, column, lattice))
    return shortest_costs(source, INFINITY, lattice, scratch)


@inlined
def word_at(row: Int, column: Int, stride: Int) -> Int:
    """Return the index of the word that holds a cell, on a board with ``stride`` words a row."""
    return (row + _MARGIN) * stride + column // WORD


@inlined
def bit_at(column: Int) -> Int:
    """Return a word in which only the bit of a cell in this column is set."""
    return _ONE << np.uint64(column % WORD)


@inlined
def has_cell(words: Words, stride: Int, cell: tuple[Int, Int]) -> Int:
    """Return whether a set, an array of a `Board`, has the cell (row, column)."""
    return words[word_at(cell[0], cell[1], stride)] & bit_at(cell[1]) != 0


@kernel
def nth_cell(words: Words, stride: Int, number: Int) -> tuple[Int, Int]:
    """Return (row, column) of cell ``number`` of a set, counted from 0 in row-major order.

    Args:
        words: (words,) the set, an array of a `Board`, with more than ``number`` cells.
        stride: words of a row.
        number: which cell.
    """
    k = 0
    while number >= count_bits(words, k, k + 1):
        number -= count_bits(words, k, k + 1)
        k += 1
    column = WORD * (k % stride)
    while number or words[k] & bit_at(column) == 0:
        if words[k] & bit_at(column):
            number -= 1
        column += 1
    return k // stride - _MARGIN, column


@kernel
def build_board(grid: Bytes) -> Board:
    """Return a map, (H, W), as a board whose free cells are set, ready for searches."""
    rows, columns = grid.shape
    stride = 1
    carry = _NO_BITS
    if columns > WORD:
        # At least one bit of each row belongs to no cell. It stops bits that are carried from the
        # end of a row to the next row.
        stride = columns // WORD + 1
        carry = ALL_BITS
    sets = np.zeros((3, (rows + 2 * _MARGIN) * stride), np.uint64)
    flat = grid.reshape(-1)
    for row in range(rows):
        for first_column in range(0, columns, WORD):
            first_cell = np.uint64(row * columns + first_column)
            word = _NO_BITS
            for k in range(min(WORD, columns - first_column)):
                bit = np.uint64(k)
                word |= np.uint64(flat[first_cell + bit] ^ np.uint8(1)) << bit
            sets[0, word_at(row, first_column, stride)] = word
    return Board(stride, carry, sets[0], sets[1], sets[2])


@kernel
def flood_board(row: Int, column: Int, max_levels: Int, board: Board) -> Int:
    """Search level by level from (row, column), at most ``max_levels`` levels with that cell's own.

    ``board.reached`` becomes the cells within ``max_levels`` - 1 moves, and ``board.level_bit`` one
    bit of their levels.

    A level takes the same time however few cells it has, so a maze, with its many small levels, is
    searched faster by `shortest_costs`. Callers choose ``max_levels`` such that they can turn to
    that. With 5/4 of H + W levels they do so for about 1 goal of 1,000 on preset `paper`.

    Returns:
        Whether no further cell can be reached.
    """
    stride = board.stride
    unseen = board.free.copy()
    level_bit = board.level_bit
    level_bit.fill(0)
    levels = np.zeros((2, len(unseen)), np.uint64)
    current = levels[0]
    following = levels[1]
    first_word = word_at(row, column, stride)
    last_word = first_word
    current[first_word] = bit_at(column)
    unseen[first_word] ^= current[first_word]
    for level in range(1, max_levels):
        first_word, last_word = _next_level(
            current, following, unseen, first_word, last_word, stride, board.carry
        )
        if first_word > last_word:
            break
        if level & 2:
            for k in range(first_word, last_word + 1):
                level_bit[np.uint64(k)] |= following[np.uint64(k)]
        current, following = following, current
    for k in range(len(unseen)):
        board.reached[k] = board.free[k] ^ unseen[k]
    return first_word > last_word


@kernel
def flood_within(row: Int, column: Int, limits: Ints, board: Board) -> Int:
    """Search level by level from (row, column), and keep the cells that are within ``limits``.

    ``board.reached`` becomes the cells whose distance on an empty map, rows plus columns to (row,
    column), is within the limits of their level. It is as exact as the limits are: under 4
    neighbours a level is a cost, and its limits follow from a range of hardness.

    Args:
        row: where the search begins.
        column: where the search begins.
        limits: (levels, 2) the smallest and the largest distance that is kept of each level. No
            cell of a level is kept whose smallest distance is above the largest one.
        board: of the map.

    Returns:
        Whether no further cell can be reached. If there are more levels than ``limits`` has,
        ``board.reached`` lacks their cells.
    """
    stride = board.stride
    unseen = board.free.copy()
    reached = board.reached
    for k in range(len(reached)):
        reached[k] = 0
    levels = np.zeros((2, len(unseen)), np.uint64)
    current = levels[0]
    following = levels[1]
    # For each word, how many rows it is away, and where in it ``column`` would be.
    rows_away = np.empty(len(unseen), np.int64)
    columns = np.empty(len(unseen), np.int64)
    for k in range(len(unseen)):
        rows_away[k] = abs(k // stride - _MARGIN - row)
        columns[k] = column - WORD * (k % stride)
    first_word = word_at(row, column, stride)
    last_word = first_word
    current[first_word] = bit_at(column)
    unseen[first_word] ^= current[first_word]
    for level in range(1, len(limits)):
        first_word, last_word = _next_level(
            current, following, unseen, first_word, last_word, stride, board.carry
        )
        if first_word > last_word:
            break
        least = limits[level, 0]
        most = limits[level, 1]
        if least <= most:
            for k in range(first_word, last_word + 1):
                i = np.uint64(k)
                kept = following[i] & _bits_within(columns[i], most - rows_away[i])
                if least > 1:  # A distance of 1 is the least that any cell has.
                    kept &= ~_bits_within(columns[i], least - 1 - rows_away[i])
                reached[i] |= kept
        current, following = following, current
    return first_word > last_word


@inlined
def _bits_within(column: Int, distance: Int) -> Int:
    """Return a word of the bits that are at most ``distance`` away from bit ``column``.

    ``column`` may lie outside of the word, and there are no such bits if ``distance`` is negative.
    """
    # Without branches, the compiler handles several words at once.
    low = max(column - distance, 0)
    high = min(column + distance, WORD - 1)
    from_low = ALL_BITS << np.uint64(low & 63)
    to_high = ALL_BITS >> np.uint64((WORD - 1 - high) & 63)
    return from_low & to_high if low <= high else _NO_BITS


@kernel
def _write_board_moves(
    goal_parity: Int, board: Board, lattice: Lattice, shape: tuple[Int, Int], came_from: Bytes
) -> None:
    """Write which moves lead nearer to a goal, after `flood_board` from there.

    The level of a neighbour is that of the cell plus or minus 1. Bit 0 of a level alternates as on
    a chessboard, so bit 1, which the board holds, tells the two neighbours apart. From an odd level
    to the next larger one, bit 1 changes (01 to 10), and to the next smaller one it does not (01 to
    00). From an even level it is the other way round.

    Args:
        goal_parity: sum of the goal's row and column, or any number of the same parity.
        board: with the cells that `flood_board` reached.
        lattice: of the map.
        shape: (rows, columns) of the map.
        came_from: (cells,) states, of which those of the map become bit sets of moves.
    """
    level_bit = board.level_bit
    reached = board.reached
    carry = board.carry
    stride = np.uint64(board.stride)
    for row in range(shape[0]):
        # Even columns have even bits, whichever the word. So the cells of odd levels are either the
        # even bits or the odd ones.
        odd_levels = _EVEN_BITS if (row + goal_parity) % 2 else ~_EVEN_BITS
        for first_column in range(0, shape[1], WORD):
            i = np.uint64(word_at(row, first_column, board.stride))
            # Bit 1 of the level of a neighbour that is farther away; of a nearer one it differs.
            farther = level_bit[i] ^ odd_levels
            here = reached[i]
            north = here & reached[i - stride] & (level_bit[i - stride] ^ farther)
            south = here & reached[i + stride] & (level_bit[i + stride] ^ farther)
            east_bit = _east_neighbours(level_bit, i, carry)
            east = here & _east_neighbours(reached, i, carry) & (east_bit ^ farther)
            west_bit = _west_neighbours(level_bit, i, carry)
            west = here & _west_neighbours(reached, i, carry) & (west_bit ^ farther)
            cell = np.uint64(cell_at(row, first_column, lattice))
            # Eight cells at a time. They may go beyond the row, since the next row comes later.
            for k in range(0, min(WORD, shape[1] - first_column), _BYTE):
                shift = np.uint64(k)
                # Eight bytes, of which each gets the moves of one cell: N is bit 0, E 1, S 2, W 3.
                north_east = _spread_bits(north >> shift) | (_spread_bits(east >> shift) << _ONE)
                south_west = _spread_bits(south >> shift) | (_spread_bits(west >> shift) << _ONE)
                moves = north_east | (south_west << _TWO)
                # The compiler turns this loop into the store of one word.
                for j in range(_BYTE):
                    came_from[cell + np.uint64(k + j)] = np.uint8(moves >> np.uint64(_BYTE * j))


@inlined
def _spread_bits(word: np.uint64) -> Int:
    """Return the lowest eight bits of a word as the eight bytes of another."""
    return _SPREAD_BITS[word & np.uint64(255)]


def bfs_labels_by_bits(
    packed: Words,
    columns: int,
    rooms: Ints,
    seed_points: Ints,
    first_segments: Ints,
    first_pairs: Ints,
    segment_table: Ints,
    pair_costs: Ints,
    moves: Bytes,
) -> int:
    """Label every map by BFS, as `labels.bfs_labels_by_queue` does, on maps of up to 64 x 64 cells.

    Args:
        packed: (N, H, 1) packed maps, without diagonal moves.
        columns: of each map, at most 64.
        rooms: (N,) number of rooms of each map.
        seed_points: (N, R, 2) cells, all free; -1 beyond the rooms of a map.
        first_segments: as `labels.bfs_labels_by_queue` takes it, like the arguments below.
        first_pairs: (N or more,).
        segment_table: (S, 2), to be filled.
        pair_costs: (P, 2), to be filled.
        moves: to be filled.

    Returns:
        The number of moves.
    """
    row_mask = ALL_BITS >> np.uint64(WORD - columns)
    seed_rows = seed_points[:, :, 0] + _MARGIN
    # Columns of -1, beyond the rooms, give bits that nothing reads.
    seed_bits = _ONE << (seed_points[:, :, 1] % WORD).astype(np.uint64)
    # Memory that is not used is not touched, so that it never becomes memory of the process.
    levels = np.empty((2, _MAX_LEVELS * _LEVEL_WORDS), np.uint64)
    free = np.zeros(_LEVEL_WORDS, np.uint64)
    unseen = np.empty(_LEVEL_WORDS, np.uint64)
    earlier = np.empty((2, _LEVEL_WORDS), np.uint64)
    used: int = _label_maps(
        packed,
        row_mask,
        rooms,
        seed_rows,
        seed_bits,
        first_segments,
        first_pairs,
        levels,
        free,
        unseen,
        earlier,
        segment_table,
        pair_costs,
        moves,
    )
    return used


@kernel
def _label_maps(
    packed: Words,
    row_mask: np.uint64,
    rooms: Ints,
    seed_rows: Ints,
    seed_bits: Words,
    first_segments: Ints,
    first_pairs: Ints,
    levels: Words,
    free: Words,
    unseen: Words,
    earlier: Words,
    segment_table: Ints,
    pair_costs: Ints,
    moves: Bytes,
) -> Int:
    """Do the work of `bfs_labels_by_bits`.

    Args:
        packed: (N, H, 1) packed maps.
        row_mask: a word in which the bits that are cells are set.
        rooms: (N,) number of rooms of each map.
        seed_rows: (N, R) index of the word of each seed point.
        seed_bits: (N, R) a word in which the bit of the seed point is set.
        first_segments: as `bfs_labels_by_bits` takes it, like ``first_pairs``, ``segment_table``,
            ``pair_costs`` and ``moves``.
        first_pairs: (N or more,).
        levels: (2, ...) room for the levels of two searches, level after level.
        free: (words,) zeros, with room for the free cells of a map between empty rows.
        unseen: (words,) room for those of them that a search has not reached.
        earlier: (2, words) room for `_trace_path`.
        segment_table: (S, 2), to be filled with number of moves and expansions of each segment.
        pair_costs: (P, 2), to be filled with moves between the seeds of each pair and 0, or (-1,
            0).
        moves: to be filled with the moves of all segments.

    Returns:
        The number of moves.
    """
    # A number that is passed to a kernel gets its final type at once. Otherwise the kernel would be
    # compiled twice.
    start_word = np.int64(0)
    end_word = np.int64(len(unseen))
    used = np.int64(0)
    for m in range(len(packed)):
        for r in range(packed.shape[1]):
            free[_MARGIN + r] = ~packed[m, r, 0] & row_mask
        n = rooms[m]
        pair = first_pairs[m]
        segment = first_segments[m]
        free_cells = count_bits(free, start_word, end_word)
        cells_nearer = 0  # cells that are nearer to seed s than seed s + 1 is
        path_length = np.int64(-1)  # moves from seed s - 1 to seed s; -1 without a path
        for s in range(n):
            # Flood around seed s until all later seeds are seen and seed s - 1, too. The levels
            # around seed s - 1 are kept in the other half: `_trace_path` needs both.
            level_words = levels[s & 1]
            for r in range(end_word):
                unseen[r] = free[r]
            low = seed_rows[m, s]
            high = low
            # Level 0 is the seed alone. The next level reads the rows around it.
            for r in range(low - _MARGIN, low + _MARGIN + 1):
                level_words[r] = 0
            level_words[low] = seed_bits[m, s]
            unseen[low] ^= seed_bits[m, s]
            later_seeds = n - 1 - s
            for k in range(later_seeds):
                pair_costs[pair + k, 0] = -1
                pair_costs[pair + k, 1] = 0
            unseen_seeds = later_seeds
            level = 0
            level_start = 0
            while True:
                # A later seed without a cost that is not unseen any more is in this level.
                for k in range(later_seeds):
                    seed = s + 1 + k
                    is_seen = unseen[seed_rows[m, seed]] & seed_bits[m, seed] == 0
                    if pair_costs[pair + k, 0] < 0 and is_seen:
                        pair_costs[pair + k, 0] = level
                        unseen_seeds -= 1
                        if k == 0:  # the next seed, where a segment ends
                            cells_nearer = free_cells - count_bits(unseen, start_word, end_word)
                            cells_nearer -= count_bits(
                                level_words, level_start + low, level_start + high + 1
                            )
                # `_trace_path` needs as many levels as the path has moves.
                if unseen_seeds == 0 and level >= path_length:
                    break
                next_start = level_start + _LEVEL_WORDS
                low, high = _next_narrow_level(
                    level_words[level_start:next_start],
                    level_words[next_start : next_start + _LEVEL_WORDS],
                    unseen,
                    low,
                    high,
                )
                if low > high:  # The level is empty: every cell that can be reached is seen.
                    break
                level += 1
                level_start = next_start
            if path_length >= 0:
                segment_table[segment - 1, 0] = path_length
                segment_table[segment - 1, 1] += _trace_path(
                    level_words,
                    levels[1 - (s & 1)],
                    seed_rows[m, s - 1],
                    seed_bits[m, s - 1],
                    path_length,
                    earlier,
                    moves,
                    used,
                )
                used += path_length
            if later_seeds:
                path_length = pair_costs[pair, 0]
                segment_table[segment, 0] = 0
                if path_length < 0:
                    reached_cells = free_cells - count_bits(unseen, start_word, end_word)
                    segment_table[segment, 1] = reached_cells
                else:
                    # The goal and all nearer cells; `_trace_path` adds those of the goal's level.
                    segment_table[segment, 1] = cells_nearer + 1
                segment += 1
                pair += later_seeds
    return used


@inlined
def _next_narrow_level(
    current: Words, following: Words, unseen: Words, low: Int, high: Int
) -> tuple[Int, Int]:
    """Write the level that follows ``current``, whose rows ``low`` to ``high`` have one word each.

    Arguments and returned rows are those of `_next_level`, which also carries bits between the
    words of a row.
    """
    low -= 1
    high += 1
    # With unsigned indices into two views the compiler sees that nothing overlaps, and handles
    # several words at a time.
    for r in range(low, high + 1):
        i = np.uint64(r)
        beside = (current[i] << _ONE) | (current[i] >> _ONE)
        reached = (beside | current[i - _ONE] | current[i + _ONE]) & unseen[i]
        following[i] = reached
        unseen[i] ^= reached
    # The level after this one reads two rows beyond it, and the buffer holds an older level.
    following[low - 2] = 0
    following[low - 1] = 0
    following[high + 1] = 0
    following[high + 2] = 0
    while low <= high and following[low] == 0:
        low += 1
    while low <= high and following[high] == 0:
        high -= 1
    return low, high


@inlined
def _next_level(
    current: Words,
    following: Words,
    unseen: Words,
    first_word: Int,
    last_word: Int,
    stride: Int,
    carry: np.uint64,
) -> tuple[Int, Int]:
    """Write the level that follows ``current``, and remove its cells from ``unseen``.

    Args:
        current: (words,) the level.
        following: (words,) filled with the next level.
        unseen: (words,) free cells that the search has not reached.
        first_word: the cells of ``current`` lie in the words from this one on ...
        last_word: ... to this one.
        stride: words of a row.
        carry: as in `Board`.

    Returns:
        The first and last word of the next level; the first is beyond the last if it is empty.
    """
    low = first_word - stride
    high = last_word + stride
    # With unsigned indices into two views the compiler sees that nothing overlaps, and handles
    # several words at a time.
    for k in range(low, high + 1):
        i = np.uint64(k)
        reached = _neighbours(current, i, np.uint64(stride), carry) & unseen[i]
        following[i] = reached
        unseen[i] ^= reached
    # The level after this one reads two rows beyond it, and the buffer holds an older level.
    for k in range(2 * stride):
        following[low - 1 - k] = 0
        following[high + 1 + k] = 0
    while low <= high and following[low] == 0:
        low += 1
    while low <= high and following[high] == 0:
        high -= 1
    return low, high


@inlined
def _neighbours(cells: Words, word: np.uint64, stride: np.uint64, carry: np.uint64) -> Int:
    """Return the cells of a word that have any neighbour in the set ``cells``."""
    beside = _east_neighbours(cells, word, carry) | _west_neighbours(cells, word, carry)
    return beside | cells[word - stride] | cells[word + stride]


@inlined
def _east_neighbours(cells: Words, word: np.uint64, carry: np.uint64) -> Int:
    """Return the cells of a word whose eastern neighbour is in the set ``cells``.

    Column c + 1 is the next higher bit; that of the top bit is the lowest bit of the next word.
    """
    return (cells[word] >> _ONE) | ((cells[word + _ONE] << _TOP_BIT) & carry)


@inlined
def _west_neighbours(cells: Words, word: np.uint64, carry: np.uint64) -> Int:
    """Return the cells of a word whose western neighbour is in the set ``cells``."""
    return (cells[word] << _ONE) | ((cells[word - _ONE] >> _TOP_BIT) & carry)


@inlined
def _trace_path(
    around_goal: Words,
    around_start: Words,
    row: Int,
    bit: np.uint64,
    length: Int,
    earlier: Words,
    moves: Bytes,
    used: Int,
) -> Int:
    """Write the moves of the path that the queue finds from a start to a goal.

    Args:
        around_goal: (levels * words,) the levels around the goal, at least ``length`` of them.
        around_start: (levels * words,) the levels around the start.
        row: index of the word of the start.
        bit: a word in which the bit of the start is set.
        length: number of moves of the path.
        earlier: (2, words) room for two sets of cells, in turns: those cells of a level around the
            start that stand before the path's own cell in the queue.
        moves: to be filled with the moves, from ``moves[used]`` on.
        used: number of moves that are there already.

    Returns:
        How many cells of the goal's level are expanded before the goal.
    """
    low = row
    high = row
    for r in range(_LEVEL_WORDS):
        earlier[0, r] = 0
        earlier[1, r] = 0
    for step in range(length):
        # The level around the goal that the path's next cell belongs to.
        goal_level_start = (length - step - 1) * _LEVEL_WORDS
        earlier_here = earlier[step & 1]
        earlier_next = earlier[1 - (step & 1)]
        first_row = min(low, row) - 1
        last_row = max(high, row) + 1
        next_level = around_start[(step + 1) * _LEVEL_WORDS : (step + 2) * _LEVEL_WORDS]
        # The children of a cell that stands before the path's cell stand before its next cell.
        for r in range(first_row, last_row + 1):
            i = np.uint64(r)
            beside = (earlier_here[i] << _ONE) | (earlier_here[i] >> _ONE)
            beside |= earlier_here[i - _ONE] | earlier_here[i + _ONE]
            earlier_next[i] = beside & next_level[i]
        earlier_next[first_row - 2] = 0
        earlier_next[first_row - 1] = 0
        earlier_next[last_row + 1] = 0
        earlier_next[last_row + 2] = 0
        # The path takes the first move that leads nearer to the goal. The neighbours of its cell by
        # earlier moves also stand before the next cell.
        if around_goal[goal_level_start + row - 1] & bit:
            move = 0
            row -= 1
        else:
            earlier_next[row - 1] |= next_level[row - 1] & bit
            if around_goal[goal_level_start + row] & (bit << _ONE):
                move = 1
                bit <<= _ONE
            else:
                earlier_next[row] |= next_level[row] & (bit << _ONE)
                if around_goal[goal_level_start + row + 1] & bit:
                    move = 2
                    row += 1
                else:
                    earlier_next[row + 1] |= next_level[row + 1] & bit
                    move = 3
                    bit >>= _ONE
        moves[used + step] = move
        low = first_row
        high = last_row
        while low < high and earlier_next[low] == 0:
            low += 1
        while low < high and earlier_next[high] == 0:
            high -= 1
        if earlier_next[low] == 0:  # The set is empty: the next rows are those around the path.
            low = row
            high = row
    return count_bits(earlier[length & 1], low, high + 1)


@kernel
def count_bits(words: Words, first: Int, end: Int) -> Int:
    """Return the number of ones in ``words[first:end]`` (Hacker's Delight, section 5-1)."""
    total: Int = 0
    for k in range(first, end):
        sums = words[k]
        # Each two bits become the number of their ones, then each four, then each eight.
        sums -= (sums >> _ONE) & _EVEN_BITS
        sums = (sums & _LOW_HALVES_OF_NIBBLES) + ((sums >> _TWO) & _LOW_HALVES_OF_NIBBLES)
        sums = (sums + (sums >> np.uint64(4))) & _LOW_HALVES_OF_BYTES
        # Modulo 2^64, the top byte of this product is the sum of all eight bytes.
        total += np.int64((sums * _LOWEST_BITS_OF_BYTES) >> np.uint64(56))
    return total
