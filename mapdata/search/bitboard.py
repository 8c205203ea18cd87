"""Breadth-first search of 4-connected maps, 64 cells at a time.

In a set of cells, a row of the map is one word or several, with column c in bit c % 64 of word
c // 64. A level of the search, all cells equally far from where it began, is such a set. The
next level is the current one shifted by one cell in the four directions, less what was seen
before.

`search_around` gives all moves that lead nearer to a goal. `bit_search` gives the paths of the
queue on maps of one word a row. Its order, first in, first out, seems lost in a set of bits, but it
is not. Within a level, cells stand in the order of their paths, compared move by move (N < E < S <
W), because a cell's parent is the first of its neighbours and neighbours are seen in the order of
moves. So the path that the queue finds is the first of all shortest ones, which a descent from the
start through the levels around the goal meets; and the cells expanded before the goal are all
nearer ones, and those of its level whose path comes first, a set that can be carried along the
path.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Ints, Words
from mapdata.generators.maps import WORD
from mapdata.jit import Int, inlined, kernel
from mapdata.search.kernels import Scratch, shortest_costs
from mapdata.search.lattice import FAR, Lattice, cell_at, load

MAX_SIDE = 64
"""Most rows and columns of a map that `bit_search` searches."""

_EDGE = 3
"""Empty rows above and below: a level reads two beyond what the one before it wrote, and clears a
third.
"""

_LEVEL = MAX_SIDE + 2 * _EDGE
"""Words of a level."""

_LEVELS = MAX_SIDE * MAX_SIDE + 2
"""Most levels of a search."""

_NONE = np.uint64(0)
_ONE = np.uint64(1)
_LAST = np.uint64(63)
_ALL = ~np.uint64(0)
_TWO = np.uint64(2)
_PAIRS = np.uint64(0x5555555555555555)
_FOURS = np.uint64(0x3333333333333333)
_EIGHTS = np.uint64(0x0F0F0F0F0F0F0F0F)
_BYTES = np.uint64(0x0101010101010101)

_BYTE = 8
"""Bits of a byte."""

_EIGHT_CELLS = np.unpackbits(np.arange(256, dtype=np.uint8), bitorder="little").view(np.uint64)
"""The bits of each byte, 0 to 255, as eight bytes in a word."""


class Board(NamedTuple):
    """What a search of a map by bits finds; cell (row, 0) is bit 0 of word ``(row + 3) * stride``.

    Attributes:
        stride: words of a row.
        carry: all ones where rows have several words, between which bits are carried, else 0.
        free: (words,) the free cells.
        reached: (words,) those of them that the search reaches.
        digit: (words,) those of them whose level has digit 1, the second lowest in binary.
    """

    stride: Int
    carry: np.uint64
    free: Words
    reached: Words
    digit: Words


@kernel
def search_around(
    grid: Bytes, row: Int, column: Int, costs_too: bool, lattice: Lattice, buffers: Scratch
) -> None:
    """Write to ``came`` which moves lead to (row, column) by shortest paths, as bit sets.

    With ``costs_too``, their costs go to ``g``, as from `shortest_costs`; else what ``g`` holds is
    not defined. Moves alone are found by bits on 4-connected maps, where that is faster: not on
    narrow ones, since `_write_moves` writes eight cells at a time, nor in mazes.
    """
    by_bits = lattice.diagonals == 0 and not costs_too and grid.shape[1] >= _BYTE
    if by_bits and grid[row, column] == 0:
        board = board_of(grid)
        if search_board(row, column, 5 * sum(grid.shape) // 4, board):
            _write_moves(row + column, board, lattice, grid.shape, buffers.came)
            return
    load(grid, buffers.came)
    source = np.full(1, cell_at(row, column, lattice))
    shortest_costs(source, FAR, lattice, buffers)


@inlined
def word_at(row: Int, column: Int, stride: Int) -> Int:
    """Return which word of a board holds a cell."""
    return (row + _EDGE) * stride + column // WORD


@inlined
def bit_at(column: Int) -> Int:
    """Return the bit of a cell in its word."""
    return _ONE << np.uint64(column % WORD)


@kernel
def nth_cell(words: Words, stride: Int, number: Int) -> tuple[Int, Int]:
    """Return cell ``number``, from 0, of a set in row-major order, which has more than so many.

    Args:
        words: (words,) the set, a field of a `Board`.
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
    return k // stride - _EDGE, column


@kernel
def board_of(grid: Bytes) -> Board:
    """Return the board of a map, for searches."""
    rows, columns = grid.shape
    stride = 1
    carry = _NONE
    if columns > WORD:
        # At least one bit of a row belongs to no cell: it keeps what is carried from row to row.
        stride = columns // WORD + 1
        carry = _ALL
    sets = np.zeros((3, (rows + 2 * _EDGE) * stride), np.uint64)
    flat = grid.reshape(-1)
    for row in range(rows):
        for first in range(0, columns, WORD):
            cell = np.uint64(row * columns + first)
            word = _NONE
            for k in range(min(WORD, columns - first)):
                bit = np.uint64(k)
                word |= np.uint64(flat[cell + bit] ^ np.uint8(1)) << bit
            sets[0, word_at(row, first, stride)] = word
    return Board(stride, carry, sets[0], sets[1], sets[2])


@kernel
def search_board(row: Int, column: Int, most: Int, board: Board) -> Int:
    """Search level by level: ``reached`` becomes what is within ``most`` - 1 moves of a cell.

    Returns whether no further cell can be reached. Callers choose ``most`` so that they can turn to
    `shortest_costs` in a maze: a level takes its time however few cells it has. With 5/4 of H + W
    levels that is about 1 goal of 1,000 on preset `paper`.
    """
    stride = board.stride
    unseen = board.free.copy()
    digit = board.digit
    digit.fill(0)
    levels = np.zeros((2, len(unseen)), np.uint64)
    here = levels[0]
    new = levels[1]
    low = word_at(row, column, stride)
    high = low
    here[low] = bit_at(column)
    unseen[low] ^= here[low]
    for level in range(1, most):
        low, high = _next_level(here, new, unseen, low, high, stride, board.carry)
        if low > high:
            break
        if level & 2:
            for k in range(low, high + 1):
                digit[np.uint64(k)] |= new[np.uint64(k)]
        here, new = new, here
    for k in range(len(unseen)):
        board.reached[k] = board.free[k] ^ unseen[k]
    return low > high


@kernel
def is_direct(start: tuple[Int, Int], goal: tuple[Int, Int], lattice: Lattice, free: Words) -> Int:
    """Return whether a path no longer than on an empty map is found, where a row is one word.

    All such paths are followed at once, row by row from the western end. Of diagonal moves only
    those are tried that cut no corner, and as few as the heuristic counts: under other rules some
    paths are missed, and none is found wrongly.
    """
    if start[1] > goal[1]:
        start, goal = goal, start
    rows = goal[0] - start[0]
    is_steep = lattice.diagonals and abs(rows) > goal[1] - start[1]
    word = word_at(start[0], 0, 1)
    last = word_at(goal[0], 0, 1)
    here = bit_at(start[1])
    while True:
        row = free[word]
        if not is_steep:
            here |= row & ~(row + here)  # and eastward: a sum carries through free cells
        if word == last:
            return (here & bit_at(goal[1])) != 0
        word += np.sign(rows)
        here &= free[word]
        if lattice.diagonals:
            aslant = (here << _ONE) & row & free[word]
            here = aslant | here if is_steep else aslant


@kernel
def _write_moves(
    goal: Int, board: Board, lattice: Lattice, shape: tuple[Int, Int], came: Bytes
) -> None:
    """Write which moves lead nearer to a goal whose row and column add up to ``goal``.

    A neighbour's level is one more or one less. Digit 0 is as on a chessboard, and digit 1 tells
    the two apart: from 10 to 01 it changes, from 11 to 10 it does not.
    """
    digit = board.digit
    reached = board.reached
    carry = board.carry
    stride = np.uint64(board.stride)
    for row in range(shape[0]):
        # Even columns have the even bits, in whichever word.
        odd = _PAIRS if (row + goal) % 2 else ~_PAIRS
        for first in range(0, shape[1], WORD):
            i = np.uint64(word_at(row, first, board.stride))
            # What digit 1 of a neighbour is where that is farther away: nearer ones differ.
            farther = digit[i] ^ odd
            north = reached[i] & reached[i - stride] & (digit[i - stride] ^ farther)
            south = reached[i] & reached[i + stride] & (digit[i + stride] ^ farther)
            east = reached[i] & _eastern(reached, i, carry) & (_eastern(digit, i, carry) ^ farther)
            west = reached[i] & _western(reached, i, carry) & (_western(digit, i, carry) ^ farther)
            cell = np.uint64(cell_at(row, first, lattice))
            # Eight cells at a time, which may go beyond the row: the next one is written later.
            for k in range(0, min(WORD, shape[1] - first), _BYTE):
                shift = np.uint64(k)
                low = _eight_cells(north >> shift) | (_eight_cells(east >> shift) << _ONE)
                high = _eight_cells(south >> shift) | (_eight_cells(west >> shift) << _ONE)
                eight = low | (high << _TWO)
                for j in range(_BYTE):  # becomes one store
                    came[cell + np.uint64(k + j)] = np.uint8(eight >> np.uint64(_BYTE * j))


@inlined
def _eight_cells(word: np.uint64) -> Int:
    """Return the lowest eight bits as eight bytes in a word."""
    return _EIGHT_CELLS[word & np.uint64(255)]


def bit_search(
    packed: Words,
    columns: int,
    rooms: Ints,
    seed_points: Ints,
    segments: Ints,
    pairs: Ints,
    table: Ints,
    costs: Ints,
    moves: Bytes,
) -> int:
    """Label every map by BFS: packed maps, (N, H, 1), without diagonals, of at most 64 x 64 cells.

    ``seed_points`` are (N, most rooms, 2), all free cells. The other arguments and the result are
    those of `labels._flood_maps`.
    """
    cells_of_a_row = _ALL >> np.uint64(WORD - columns)
    rows = seed_points[:, :, 0] + _EDGE
    bits = _ONE << (seed_points[:, :, 1] % WORD).astype(np.uint64)  # those beyond the rooms are -1
    # The words of level 0, then of level 1, and so on; touched only as far as they are used.
    levels = np.empty((2, _LEVELS * _LEVEL), np.uint64)
    free = np.zeros(_LEVEL, np.uint64)
    unseen = np.empty(_LEVEL, np.uint64)
    before = np.empty((2, _LEVEL), np.uint64)
    used: int = _search_maps(
        packed,
        cells_of_a_row,
        rooms,
        rows,
        bits,
        segments,
        pairs,
        levels,
        free,
        unseen,
        before,
        table,
        costs,
        moves,
    )
    return used


@kernel
def _search_maps(
    packed: Words,
    cells_of_a_row: np.uint64,
    rooms: Ints,
    rows: Ints,
    bits: Words,
    segments: Ints,
    pairs: Ints,
    levels: Words,
    free: Words,
    unseen: Words,
    before: Words,
    table: Ints,
    costs: Ints,
    moves: Bytes,
) -> Int:
    """Do the work of `bit_search`.

    Args:
        packed: (N, H, 1) packed maps.
        cells_of_a_row: the bits of a word that are cells.
        rooms: (N,) number of rooms.
        rows: (N, most rooms) word of each seed point.
        bits: (N, most rooms) its bit in there.
        segments: as `bit_search` takes it, like ``pairs``, ``table``, ``costs`` and ``moves``.
        pairs: the first pair of each map.
        levels: (2, ...) room for the levels of two searches.
        free: (words,) zeros, with room for the free cells of a map between empty rows.
        unseen: (words,) room for those of them that a search has not reached.
        before: (2, words) room for `_trace`.
        table: (S, 2), filled with number of moves and iterations of each segment.
        costs: (P, 2), filled with moves between seeds and 0, or (-1, 0).
        moves: filled with the moves of all segments.

    Returns:
        The number of moves.
    """
    # A number that is handed on gets its final type at once: else the kernels that take it are
    # compiled twice.
    start = np.int64(0)
    end = np.int64(len(unseen))
    used = np.int64(0)
    for m in range(len(packed)):
        for r in range(packed.shape[1]):
            free[_EDGE + r] = ~packed[m, r, 0] & cells_of_a_row
        n = rooms[m]
        pair = pairs[m]
        segment = segments[m]
        count = count_bits(free, start, end)
        nearer = 0  # cells nearer than the next seed
        length = np.int64(-1)  # moves from the seed before, where a segment starts; -1 without path
        for s in range(n):
            # Flood around seed s until all later seeds are seen, and the seed before it. The levels
            # around that one are kept in the other half: `_trace` needs both.
            level = levels[s & 1]
            for r in range(end):
                unseen[r] = free[r]
            low = rows[m, s]
            high = low
            # Level 0 is the seed alone; the rows about it are read by the next level.
            for r in range(low - _EDGE, low + _EDGE + 1):
                level[r] = 0
            level[low] = bits[m, s]
            unseen[low] ^= bits[m, s]
            later = n - 1 - s
            for k in range(later):
                costs[pair + k, 0] = -1
                costs[pair + k, 1] = 0
            pending = later
            at = 0
            depth = 0
            while True:
                # A later seed that is not unseen any more, but was at the last level, is in this
                # one.
                for k in range(later):
                    seed = s + 1 + k
                    if costs[pair + k, 0] < 0 and unseen[rows[m, seed]] & bits[m, seed] == 0:
                        costs[pair + k, 0] = depth
                        pending -= 1
                        if k == 0:  # the next seed, where a segment ends
                            nearer = count - count_bits(unseen, start, end)
                            nearer -= count_bits(level, at + low, at + high + 1)
                if pending == 0 and depth >= length:  # `_trace` needs ``length`` levels
                    break
                # With unsigned indices into two views the compiler sees that nothing overlaps, and
                # takes several words at a time.
                here = level[at : at + _LEVEL]
                new = level[at + _LEVEL : at + 2 * _LEVEL]
                low -= 1
                high += 1
                for r in range(low, high + 1):
                    i = np.uint64(r)
                    around = (here[i] << _ONE) | (here[i] >> _ONE) | here[i - _ONE] | here[i + _ONE]
                    reached = around & unseen[i]
                    new[i] = reached
                    unseen[i] ^= reached
                # The level after this one reads two rows beyond it, and the buffer holds an older
                # level.
                new[low - 2] = 0
                new[low - 1] = 0
                new[high + 1] = 0
                new[high + 2] = 0
                while low <= high and new[low] == 0:
                    low += 1
                while low <= high and new[high] == 0:
                    high -= 1
                if low > high:  # nothing new: all that can be reached is seen
                    break
                depth += 1
                at += _LEVEL
            if length >= 0:
                table[segment - 1, 0] = length
                table[segment - 1, 1] += _trace(
                    level,
                    levels[1 - (s & 1)],
                    rows[m, s - 1],
                    bits[m, s - 1],
                    length,
                    before,
                    moves,
                    used,
                )
                used += length
            if later:
                length = costs[pair, 0]
                # The expansions known so far: with a path, those of its level are added by
                # `_trace`.
                table[segment, 0] = 0
                table[segment, 1] = nearer + 1
                if length < 0:
                    table[segment, 1] = count - count_bits(unseen, start, end)
                segment += 1
                pair += later
    return used


@inlined
def _next_level(
    here: Words, new: Words, unseen: Words, low: Int, high: Int, stride: Int, carry: np.uint64
) -> tuple[Int, Int]:
    """Write the level ``new`` that follows ``here``, whose cells lie in words ``low`` to ``high``.

    Returns the first and last word of the new level; the first is beyond the last if it is empty.
    """
    first = low - stride
    last = high + stride
    # With unsigned indices into two views the compiler sees that nothing overlaps, and takes
    # several words at a time.
    for k in range(first, last + 1):
        i = np.uint64(k)
        reached = _beside(here, i, np.uint64(stride), carry) & unseen[i]
        new[i] = reached
        unseen[i] ^= reached
    # The level after this one reads two rows beyond it, and the buffer holds an older level.
    for k in range(2 * stride):
        new[first - 1 - k] = 0
        new[last + 1 + k] = 0
    while first <= last and new[first] == 0:
        first += 1
    while first <= last and new[last] == 0:
        last -= 1
    return first, last


@inlined
def _beside(level: Words, word: np.uint64, stride: np.uint64, carry: np.uint64) -> Int:
    """Return the cells of a word that are one move away from a cell of ``level``."""
    beside = _eastern(level, word, carry) | _western(level, word, carry)
    return beside | level[word - stride] | level[word + stride]


@inlined
def _eastern(cells: Words, word: np.uint64, carry: np.uint64) -> Int:
    """Return the cells of a word whose neighbour in the east is one of ``cells``."""
    return (cells[word] >> _ONE) | ((cells[word + _ONE] << _LAST) & carry)


@inlined
def _western(cells: Words, word: np.uint64, carry: np.uint64) -> Int:
    """Return the cells of a word whose neighbour in the west is one of ``cells``."""
    return (cells[word] << _ONE) | ((cells[word - _ONE] >> _LAST) & carry)


@kernel
def _trace(
    around_goal: Words,
    around_start: Words,
    row: Int,
    bit: np.uint64,
    length: Int,
    before: Words,
    moves: Bytes,
    used: Int,
) -> Int:
    """Write the ``length`` moves of the queue's path from a start to the goal to ``moves[used:]``.

    The start is ``bit`` of word ``row``. Returns how many cells of the goal's level are expanded
    before it. ``before`` (2, words) is for two levels in turns: the cells of a level around the
    start that stand before the path's cell.
    """
    low = row
    high = row
    for r in range(_LEVEL):
        before[0, r] = 0
        before[1, r] = 0
    for step in range(length):
        back = (length - step - 1) * _LEVEL
        now = before[step & 1]
        then = before[1 - (step & 1)]
        first = min(low, row) - 1
        last = max(high, row) + 1
        level = around_start[(step + 1) * _LEVEL : (step + 2) * _LEVEL]
        # The children of a cell that stands before the path's cell stand before the path's next.
        for r in range(first, last + 1):
            i = np.uint64(r)
            around = (now[i] << _ONE) | (now[i] >> _ONE) | now[i - _ONE] | now[i + _ONE]
            then[i] = around & level[i]
        then[first - 2] = 0
        then[first - 1] = 0
        then[last + 1] = 0
        then[last + 2] = 0
        # The path takes the first move that leads nearer to the goal. Its cell's neighbours by
        # earlier moves stand before the next cell, too.
        if around_goal[back + row - 1] & bit:
            move = 0
            row -= 1
        else:
            then[row - 1] |= level[row - 1] & bit
            if around_goal[back + row] & (bit << _ONE):
                move = 1
                bit <<= _ONE
            else:
                then[row] |= level[row] & (bit << _ONE)
                if around_goal[back + row + 1] & bit:
                    move = 2
                    row += 1
                else:
                    then[row + 1] |= level[row + 1] & bit
                    move = 3
                    bit >>= _ONE
        moves[used + step] = move
        low = first
        high = last
        while low < high and then[low] == 0:
            low += 1
        while low < high and then[high] == 0:
            high -= 1
        if then[low] == 0:  # the set is empty: the next rows are those about the path
            low = row
            high = row
    return count_bits(before[length & 1], low, high + 1)


@kernel
def count_bits(words: Words, first: Int, last: Int) -> Int:
    """Return the number of ones in ``words[first:last]`` (Hacker's Delight, section 5-1)."""
    total: Int = 0
    for k in range(first, last):
        w = words[k]
        w -= (w >> _ONE) & _PAIRS  # each two bits count their ones
        w = (w & _FOURS) + ((w >> _TWO) & _FOURS)  # each four
        w = (w + (w >> np.uint64(4))) & _EIGHTS  # each byte
        # modulo 2^64, the top byte of the product is the sum of all bytes
        total += np.int64((w * _BYTES) >> np.uint64(56))
    return total
