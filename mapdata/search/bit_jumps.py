"""Jump point search on bits: its scans pass up to 62 cells at a time.

The pruning is that of `mapdata.search.jump_points`, and so is the proof that every cell is reached
at its least cost. Three things make it fast:

- **Words in place of cells.** A map is kept as bits, once by rows and once by columns, so that
  straight scans of both kinds read words. The word of the scan and those of the two rows beside it
  tell where the scan is blocked and where an obstacle beside it ends.
- **Diagonal scans push the straight jump points that they see**, and not the cells from which they
  see them. Such a cell would only be expanded to find the same jump points again. Where corners may
  be cut, the end of a diagonal scan at a cell in which another turn is forced is pushed as well.
- **A ray to the goal.** From the cells that are expanded first, diagonal moves and then straight
  ones are tried that lead to the goal. If they are legal, the search ends: the cell has the
  smallest f of all, and the path by the ray has this cost.

Nodes are numbered in the order in which they are found, and a cell is a node if the node whose
number is noted for it lies there (Briggs and Torczon 1993). So nothing is reset for the next
search, and many problems on one map do not look at the cells that they do not reach.

Sources: Harabor and Grastien, "Improving jump point search", ICAPS 2014, for blocks of bits and for
diagonal scans ("JPS (B + P)"); Briggs and Torczon, "An efficient representation for sparse sets",
1993.

The map of bits, the scans and the search are one file, because each scan relies on how the bits
lie, and the search on where a scan ends.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Ints, UInt32s, Words
from mapdata.generators.maps import WORD
from mapdata.jit import Int, count_high_zeros, count_low_zeros, inlined, kernel
from mapdata.movement import STEPS
from mapdata.search.ground import EXACT, TOO_LONG
from mapdata.search.jump_points import KEPT_MOVES, KEPT_MOVES_CUTTING_CORNERS, NO_MOVE
from mapdata.search.kernels import (
    LOWEST_MOVE,
    Scratch,
    insert_in_heap,
    remove_heap_top,
    with_capacity,
)
from mapdata.search.lattice import (
    CORNER_CUTTING,
    MAX_PATH_COST,
    UNIT,
    Lattice,
    count_path_cells,
    is_binary,
    octile,
    split_cost,
)
from mapdata.search.solving import Solved

_RAYS = 8
"""Number of expansions that try a ray to the goal. Later ones rarely see it."""

_MARGIN = 2
"""Empty lines of bits before the map: a scan towards lower bits begins 63 bits before its cell, and
reads the line before that, too.
"""

_ONE = np.uint64(1)
_THREE = np.uint64(3)
_SIX = np.uint64(6)
_SEVEN = np.uint64(7)

_WORD_BITS = np.uint64(6)
"""The logarithm of 64, the number of bits in a word, to the base 2."""

_CELLS_AROUND = 9
"""Number of cells of a square of three by three."""

_LAST_BIT = np.uint64(63)
_HIGHEST = np.uint64(1 << 63)
_ONES = np.uint64(0x0101010101010101)
_GATHER = np.uint64(0x0102040810204080)
"""The product of eight bytes, each 0 or 1, with this number has them as the bits of its top byte
(Hacker's Delight, section 7-3).
"""

_COST, _PLACE, _PARENT, _MOVE = range(4)
"""The numbers of a node: its cost; its cell, row * columns + column; the node from which it was
reached; and the move by which, with `_EXPANDED` once it has been expanded.
"""

_DIAGONALS = 240
"""The set of all diagonal moves; bit k stands for move k."""

_STRAIGHTS = 15
"""The set of all straight moves."""

_EXPANDED = 16
"""The bit that marks a node as expanded."""


class BitMap(NamedTuple):
    """The free cells of a map as bits, by rows and by columns.

    Bit k is bit k % 64 of word k // 64. Behind each line and around the lines there are zeros, so
    that no scan leaves the map.

    Attributes:
        words: (n,) uint64, the rows and then the columns.
        row_pitch: number of bits from a cell to the one below it, among the rows.
        column_pitch: number of bits from a cell to the one on its right, among the columns.
        first_by_rows: the bit of cell (0, 0) among the rows.
        first_by_columns: the bit of cell (0, 0) among the columns.
    """

    words: Words
    row_pitch: Int
    column_pitch: Int
    first_by_rows: Int
    first_by_columns: Int


def empty_bit_map(shape: tuple[int, int]) -> BitMap:
    """Return a map of ``shape`` (rows, columns) without free cells."""
    rows, columns = shape
    row_pitch = (columns // WORD + 1) * WORD
    column_pitch = (rows // WORD + 1) * WORD
    # One empty line follows the lines of the map, and two words the columns.
    first_column_line = (rows + _MARGIN + 1) * row_pitch
    bits = first_column_line + (columns + _MARGIN + 1) * column_pitch
    return BitMap(
        np.zeros(bits // WORD + 2, np.uint64),
        row_pitch,
        column_pitch,
        _MARGIN * row_pitch,
        first_column_line + _MARGIN * column_pitch,
    )


class JumpMemory(NamedTuple):
    """The memory that a search writes to. It needs no content.

    Attributes:
        nodes: (cells, 4) int64, `_COST`, `_PLACE`, `_PARENT` and `_MOVE` of each node.
        slots: (cells or more,) the number of the node at each cell that is a node.
        heap: (n or more,) nodes, as `insert_in_heap` takes them.
        f: (n,) the priorities of the entries of the heap.
    """

    nodes: Ints
    slots: UInt32s
    heap: UInt32s
    f: Ints


def jump_memory(shape: tuple[int, int], scratch: Scratch) -> JumpMemory:
    """Return memory for maps of ``shape``, in a scratch with room for eight pushes a cell.

    Half of the priorities is left for the heap: those of more than 4 entries a cell.
    """
    numbers = 4 * shape[0] * shape[1]
    return JumpMemory(
        scratch.f[:numbers].reshape(-1, 4), scratch.links, scratch.pushed, scratch.f[numbers:]
    )


def _moves_after(kept_moves: Bytes) -> Bytes:
    """Return which moves follow a move, by the nine cells around the end of the move.

    Args:
        kept_moves: (9 * 256,) the same by sets of free neighbours, as `KEPT_MOVES`.

    Returns:
        (9 * 512,) sets of moves, for each last move and each set of free cells: bit 3 i + j stands
        for the cell in row i and column j of the three by three cells.
    """
    places = (1, 5, 7, 3, 2, 8, 6, 0)  # where each move leads, from N to NW
    cells = np.arange(512)
    neighbours = np.zeros(512, np.int64)
    for move, place in enumerate(places):
        neighbours |= ((cells >> place) & 1) << move
    return kept_moves.reshape(9, 256)[:, neighbours].reshape(-1)


_MOVES_AFTER = _moves_after(KEPT_MOVES)
_MOVES_AFTER_CUTTING_CORNERS = _moves_after(KEPT_MOVES_CUTTING_CORNERS)


# --- the map as bits ----------------------------------------------------------------------------


@inlined
def load_bits(grid: Bytes, bits: BitMap, block: Words) -> Int:
    """Write the free cells of ``grid`` (H, W) into the words of ``bits``.

    Args:
        grid: (H, W), 1 occupied.
        bits: of its shape.
        block: (64,) room for 64 x 64 cells.

    Returns:
        Whether all cells of the grid are 0 or 1.
    """
    rows, columns = grid.shape
    words = bits.words
    flat = grid.reshape(-1)
    row_words = bits.row_pitch // WORD
    column_words = bits.column_pitch // WORD
    first_row_word = bits.first_by_rows // WORD
    first_column_word = bits.first_by_columns // WORD
    for first_column in range(0, columns, WORD):
        width = min(WORD, columns - first_column)
        for first_row in range(0, rows, WORD):
            height = min(WORD, rows - first_row)
            for r in range(WORD):
                block[r] = 0
            for r in range(height):
                first = np.uint64((first_row + r) * columns + first_column)
                word = np.uint64(0)
                for k in range(0, width - 7, 8):
                    i = first + np.uint64(k)
                    eight = _eight_bytes(flat, i)
                    gathered = ((eight ^ _ONES) * _GATHER) >> np.uint64(56)
                    word |= gathered << np.uint64(k)
                for k in range(width & ~7, width):
                    cell = np.uint64(flat[first + np.uint64(k)])
                    word |= (cell ^ _ONE) << np.uint64(k)
                block[r] = word
                words[first_row_word + (first_row + r) * row_words + first_column // WORD] = word
            _transpose(block)
            for k in range(width):
                words[first_column_word + (first_column + k) * column_words + first_row // WORD] = (
                    block[k]
                )
    return is_binary(grid)


@inlined
def _eight_bytes(flat: Bytes, i: np.uint64) -> Int:
    """Return the bytes ``flat[i:i + 8]`` as a word; the compiler makes one load of it."""
    low = np.uint64(flat[i]) | np.uint64(flat[i + np.uint64(1)]) << np.uint64(8)
    low |= np.uint64(flat[i + np.uint64(2)]) << np.uint64(16)
    low |= np.uint64(flat[i + np.uint64(3)]) << np.uint64(24)
    high = np.uint64(flat[i + np.uint64(4)]) | np.uint64(flat[i + np.uint64(5)]) << np.uint64(8)
    high |= np.uint64(flat[i + np.uint64(6)]) << np.uint64(16)
    high |= np.uint64(flat[i + np.uint64(7)]) << np.uint64(24)
    return low | high << np.uint64(32)


@inlined
def _transpose(block: Words) -> None:
    """Exchange bit j of word i and bit i of word j, for all i and j below 64.

    Halves, then quarters, and so on, of the block change places (Hacker's Delight, section 7-3).
    """
    width = 32
    mask = np.uint64(0x00000000FFFFFFFF)
    while width:
        shift = np.uint64(width)
        for first in range(0, WORD, 2 * width):
            for k in range(first, first + width):
                i = np.uint64(k)
                changed = ((block[i] >> shift) ^ block[i + shift]) & mask
                block[i + shift] ^= changed
                block[i] ^= changed << shift
        width >>= 1
        mask ^= mask << np.uint64(width)


@inlined
def _window(words: Words, word: np.uint64, shift: np.uint64) -> Int:
    """Return the 64 bits that begin ``shift`` bits (0 to 63) after the beginning of a word."""
    # A shift by 64 is not defined, so the upper part is shifted in two steps.
    return (words[word] >> shift) | ((words[word + _ONE] << _ONE) << (_LAST_BIT - shift))


@inlined
def _is_free(words: Words, bit: Int) -> Int:
    """Return 1 if a bit is set, else 0."""
    b = np.uint64(bit)
    return (words[b >> _WORD_BITS] >> (b & _LAST_BIT)) & _ONE


@kernel
def _free_around(words: Words, bit: Int, pitch: Int) -> Int:
    """Return which cells are free of the three by three around a bit.

    Bit 3 * i + j of the result is the cell in row i and column j. `_moves_after` counts so, too.
    """
    first = np.uint64(bit - 1)  # the three columns begin one to the left
    word = first >> _WORD_BITS
    shift = first & _LAST_BIT
    line = np.uint64(pitch) >> _WORD_BITS  # words from a line to the next one
    above = _window(words, word - line, shift) & _SEVEN
    here = _window(words, word, shift) & _SEVEN
    below = _window(words, word + line, shift) & _SEVEN
    return above | here << _THREE | below << _SIX


# --- scans --------------------------------------------------------------------------------------


@kernel
def _scan_up(words: Words, bit: Int, pitch: Int, goal: Int, lead: np.uint64) -> Int:
    """Scan a line from ``bit`` towards higher bits.

    A turn is forced where an obstacle in a line beside the scan ends. If corners may be cut, the
    turn begins beside the last cell of the obstacle, otherwise one cell later.

    Args:
        words: of a `BitMap`.
        bit: where the scan begins.
        pitch: bits between neighbours in lines beside each other.
        goal: the bit of the goal.
        lead: 1 if corners may be cut, else 0.

    Returns:
        The number of cells to the next jump point or to the goal; or if an obstacle comes first,
        minus the number of cells before it.
    """
    to_goal = np.uint64(goal - bit)  # A huge number if the goal is behind.
    line = np.uint64(pitch) >> _WORD_BITS
    at = np.uint64(bit)
    passed = np.uint64(0)
    step = _LAST_BIT - lead
    while True:
        word = at >> _WORD_BITS
        shift = at & _LAST_BIT
        here = _window(words, word, shift)
        above = _window(words, word - line, shift)
        below = _window(words, word + line, shift)
        ends = ((~above << _ONE) & above) | ((~below << _ONE) & below)
        stops = ((ends >> lead) | ~here) & ~_ONE
        if stops:
            place = count_low_zeros(stops)
            length = passed + place
            if to_goal <= length:
                return np.int64(to_goal)
            if (here >> place) & _ONE:
                return np.int64(length)
            return 1 - np.int64(length)
        at += step
        passed += step


@kernel
def _scan_down(words: Words, bit: Int, pitch: Int, goal: Int, lead: np.uint64) -> Int:
    """Scan a line from ``bit`` towards lower bits; otherwise as `_scan_up`."""
    to_goal = np.uint64(bit - goal)
    line = np.uint64(pitch) >> _WORD_BITS
    at = np.uint64(bit) - _LAST_BIT
    passed = np.uint64(0)
    step = _LAST_BIT - lead
    while True:
        word = at >> _WORD_BITS
        shift = at & _LAST_BIT
        here = _window(words, word, shift)
        above = _window(words, word - line, shift)
        below = _window(words, word + line, shift)
        ends = ((~above >> _ONE) & above) | ((~below >> _ONE) & below)
        stops = ((ends << lead) | ~here) & ~_HIGHEST
        if stops:
            place = count_high_zeros(stops)
            length = passed + place
            if to_goal <= length:
                return np.int64(to_goal)
            if (here << place) & _HIGHEST:
                return np.int64(length)
            return 1 - np.int64(length)
        at -= step
        passed += step


@kernel
def _free_run(words: Words, bit: Int, step: Int, length: Int) -> Int:
    """Return how many of ``length`` cells are free before the first that is not.

    The first of them is beside ``bit``, and ``step`` (1 or -1) leads from each to the next.
    """
    run: Int = 0
    while run < length:
        at = np.uint64(bit + 1 + run) if step > 0 else np.uint64(bit - 64 - run)
        blocked = ~_window(words, at >> _WORD_BITS, at & _LAST_BIT)
        if blocked:
            run += np.int64(count_low_zeros(blocked) if step > 0 else count_high_zeros(blocked))
            break
        run += WORD
    return min(run, length)


@kernel
def _follow_ray(
    rows: Int,
    columns: Int,
    by_rows: Int,
    by_columns: Int,
    row_pitch: Int,
    column_pitch: Int,
    words: Words,
    may_cut: np.uint64,
) -> Int:
    """Return how many cells of a ray are free: diagonal moves and then straight ones.

    Args:
        rows: from the cell to the goal.
        columns: from the cell to the goal.
        by_rows: the bit of the cell among the rows.
        by_columns: its bit among the columns.
        row_pitch: as in `BitMap`.
        column_pitch: as in `BitMap`.
        words: of a `BitMap`.
        may_cut: 1 if corners may be cut, else 0.

    Returns:
        The number of cells before the first illegal move; to the goal it is the larger one of
        ``rows`` and ``columns``, without signs.
    """
    row_step = row_pitch if rows > 0 else -row_pitch
    column_step = 1 if columns > 0 else -1
    diagonals = min(abs(rows), abs(columns))
    bit = by_rows
    # A corner that may be cut counts as free.
    for k in range(diagonals):
        corners = _is_free(words, bit + row_step) & _is_free(words, bit + column_step)
        bit += row_step + column_step
        if _is_free(words, bit) & (corners | may_cut) == 0:
            return k
    if abs(columns) > diagonals:
        return diagonals + _free_run(words, bit, column_step, abs(columns) - diagonals)
    # Among the columns a row is a step of one bit.
    down = 1 if rows > 0 else -1
    bit = by_columns + diagonals * (column_step * column_pitch + down)
    return diagonals + _free_run(words, bit, down, abs(rows) - diagonals)


@inlined
def _are_free(
    start: tuple[Int, Int], goal: tuple[Int, Int], shape: tuple[Int, Int], bits: BitMap
) -> Int:
    """Return whether two cells (row, column) are inside of a map of ``shape``, and free."""
    words = bits.words
    are_free = True
    for row, column in (start, goal):
        is_inside = 0 <= row < shape[0] and 0 <= column < shape[1]
        bit = bits.first_by_rows + row * bits.row_pitch + column
        are_free = are_free and is_inside and _is_free(words, bit) == _ONE
    return are_free


# --- the search ---------------------------------------------------------------------------------


@kernel
def _drop_stale(
    goal: tuple[Int, Int],
    heap_size: Int,
    map_columns: Int,
    diagonal_cost: Int,
    nodes: Ints,
    heap: UInt32s,
    f: Ints,
) -> Int:
    """Remove the entries of the heap whose nodes were pushed again, or expanded.

    Returns:
        The number of entries that are left: at most one for each cell.
    """
    kept = 0
    for k in range(heap_size):
        node = heap[k]
        place = nodes[node, _PLACE]
        row = place // map_columns
        column = place - row * map_columns
        h = octile(row - goal[0], column - goal[1], diagonal_cost)
        is_open = nodes[node, _MOVE] & _EXPANDED == 0
        if is_open and f[k] == nodes[node, _COST] + h:
            insert_in_heap(heap, f, kept, node, f[k])
            kept += 1
    return kept


@inlined
def _search(
    start: tuple[Int, Int],
    goal: tuple[Int, Int],
    shape: tuple[Int, Int],
    bits: BitMap,
    may_cut: Int,
    diagonal_cost: Int,
    memory: JumpMemory,
) -> tuple[Int, Int, Int, Int, Int]:
    """Run jump point search from ``start`` to ``goal``, free cells (row, column).

    Args:
        start: (row, column).
        goal: (row, column).
        shape: (rows, columns) of the map.
        bits: the map.
        may_cut: whether corners may be cut.
        diagonal_cost: cost of a diagonal move.
        memory: of maps of this shape.

    Returns:
        The cost of the path, -1 without one; the node before the goal; the numbers of expansions
        and of looks, as `jump_to_goals` counts them; and EXACT, or TOO_LONG where the search
        stopped at a path that is too long for exact costs.
    """
    words = bits.words
    row_pitch = bits.row_pitch
    column_pitch = bits.column_pitch
    first_by_rows = bits.first_by_rows
    first_by_columns = bits.first_by_columns
    nodes = memory.nodes
    slots = memory.slots
    heap = memory.heap
    f = memory.f
    map_columns = shape[1]
    lead = np.uint64(may_cut)
    moves_after = _MOVES_AFTER
    if may_cut:
        moves_after = _MOVES_AFTER_CUTTING_CORNERS
    goal_row = goal[0]
    goal_column = goal[1]
    goal_by_rows = first_by_rows + goal_row * row_pitch + goal_column
    goal_by_columns = first_by_columns + goal_column * column_pitch + goal_row
    goal_place = goal_row * map_columns + goal_column
    start_place = start[0] * map_columns + start[1]
    nodes[0, _COST] = 0
    nodes[0, _PLACE] = start_place
    nodes[0, _PARENT] = 0
    nodes[0, _MOVE] = NO_MOVE
    slots[start_place] = 0
    heap[0] = 0
    f[0] = 0  # The start is alone in the heap, so its priority does not matter.
    heap_size = 1
    count: Int = 1
    # An expansion pushes at most one cell for each of four straight scans, and for each of four
    # diagonal ones two cells a step and one at its end.
    max_pushes = 8 * min(shape[0], shape[1]) + 8
    expansions = 0
    looks = 1
    goal_cost = np.int64(-1)
    last_node = np.int64(0)
    high_cost = EXACT
    while heap_size:
        node = np.int64(heap[0])
        heap_size -= 1
        remove_heap_top(heap, f, heap_size)
        i = np.uint64(node)
        arrival = nodes[i, _MOVE]
        # The cell was pushed again with a smaller f and expanded then.
        if arrival & _EXPANDED:
            continue
        nodes[i, _MOVE] = arrival | _EXPANDED
        expansions += 1
        cost = nodes[i, _COST]
        if cost >= MAX_PATH_COST * UNIT:
            high_cost = TOO_LONG
            break
        place = nodes[i, _PLACE]
        if place == goal_place:
            goal_cost = cost
            last_node = nodes[i, _PARENT]
            break
        if heap_size + max_pushes > len(f):
            heap_size = _drop_stale(goal, heap_size, map_columns, diagonal_cost, nodes, heap, f)
        row = np.int64(np.uint32(place) // np.uint32(map_columns))
        column = place - row * map_columns
        bit = first_by_rows + row * row_pitch + column
        if expansions <= _RAYS:
            rows = goal_row - row
            columns = goal_column - column
            by_columns = first_by_columns + column * column_pitch + row
            length = _follow_ray(
                rows, columns, bit, by_columns, row_pitch, column_pitch, words, lead
            )
            looks += length
            if length == max(abs(rows), abs(columns)):
                goal_cost = cost + octile(rows, columns, diagonal_cost)
                last_node = node
                expansions += 1
                break
        moves = np.int64(
            moves_after[np.uint64(arrival << _CELLS_AROUND) | _free_around(words, bit, row_pitch)]
        )
        # A straight move is one scan from the cell. A diagonal move goes on cell by cell, and scans
        # from each of them along the straight moves that may follow it.
        while moves:
            move = np.int64(LOWEST_MOVE[np.uint64(moves)])
            moves &= moves - 1
            scans_left = np.int64(1) << move
            moves_here = np.int64(0)  # after a diagonal move; none after a straight one
            scan_row = row
            scan_column = column
            scan_cost = cost
            while True:
                if move >= 4:
                    scan_row += STEPS[np.uint64(move), 0]
                    scan_column += STEPS[np.uint64(move), 1]
                    scan_cost += diagonal_cost
                    looks += 1
                    bit = first_by_rows + scan_row * row_pitch + scan_column
                    moves_here = np.int64(
                        moves_after[
                            np.uint64(move << _CELLS_AROUND) | _free_around(words, bit, row_pitch)
                        ]
                    )
                    # Where corners may be cut, other diagonal moves are forced beside obstacles.
                    if bit == goal_by_rows or moves_here & (_DIAGONALS ^ (1 << move)):
                        # The diagonal move itself stands for pushing this cell, and it ends here.
                        scans_left = np.int64(1) << move
                        moves_here = np.int64(0)
                    else:
                        scans_left = moves_here & _STRAIGHTS
                while scans_left:
                    scan = np.int64(LOWEST_MOVE[np.uint64(scans_left)])
                    scans_left &= scans_left - 1
                    length = np.int64(0)  # of the scan; 0 where the cell itself is pushed
                    if scan < 4:
                        if scan & 1:
                            pitch = row_pitch
                            bit = first_by_rows + scan_row * row_pitch + scan_column
                            goal_bit = goal_by_rows
                        else:
                            pitch = column_pitch
                            bit = first_by_columns + scan_column * column_pitch + scan_row
                            goal_bit = goal_by_columns
                        if 1 <= scan <= 2:  # east or south
                            length = _scan_up(words, bit, pitch, goal_bit, lead)
                        else:
                            length = _scan_down(words, bit, pitch, goal_bit, lead)
                        looks += abs(length)
                        if length <= 0:
                            continue  # there is no jump point
                    target_row = scan_row + length * STEPS[np.uint64(scan), 0]
                    target_column = scan_column + length * STEPS[np.uint64(scan), 1]
                    target_cost = scan_cost + length * UNIT
                    place = target_row * map_columns + target_column
                    slot = np.int64(slots[np.uint64(place)])
                    k = np.uint64(slot)
                    if slot < count and nodes[k, _PLACE] == place:
                        # The heuristic is consistent, so that no cheaper path to an expanded node
                        # is met.
                        if nodes[k, _COST] <= target_cost:
                            continue
                    else:
                        slot = count
                        k = np.uint64(slot)
                        count += 1
                        slots[np.uint64(place)] = slot
                        nodes[k, _PLACE] = place
                    nodes[k, _COST] = target_cost
                    nodes[k, _PARENT] = node
                    nodes[k, _MOVE] = scan
                    h = octile(target_row - goal_row, target_column - goal_column, diagonal_cost)
                    insert_in_heap(heap, f, heap_size, slot, target_cost + h)
                    heap_size += 1
                if (moves_here >> move) & 1 == 0:
                    break
    return goal_cost, last_node, expansions, looks, high_cost


@inlined
def _write_path(
    goal: tuple[Int, Int], node: Int, map_columns: Int, nodes: Ints, path: Ints
) -> None:
    """Write the cells of the path to ``goal`` to ``path`` (k, 2), all k of them.

    Args:
        goal: (row, column) of the goal.
        node: the node before the goal, or the start.
        map_columns: number of columns of the map.
        nodes: of the search.
        path: to be filled.
    """
    row = goal[0]
    column = goal[1]
    i = np.uint64(len(path) - 1)
    path[i, 0] = row
    path[i, 1] = column
    while i:
        place = nodes[np.uint64(node), _PLACE]
        node = nodes[np.uint64(node), _PARENT]
        rows = np.int64(np.uint32(place) // np.uint32(map_columns)) - row
        columns = place - (row + rows) * map_columns - column
        row_step = min(1, max(-1, rows))
        column_step = min(1, max(-1, columns))
        # From each node to the next, diagonal moves come before straight ones. This way is back.
        diagonals = min(abs(rows), abs(columns))
        is_across = abs(columns) > diagonals
        for _ in range(max(abs(rows), abs(columns)) - diagonals):
            if is_across:
                column += column_step
            else:
                row += row_step
            i -= _ONE
            path[i, 0] = row
            path[i, 1] = column
        for _ in range(diagonals):
            row += row_step
            column += column_step
            i -= _ONE
            path[i, 0] = row
            path[i, 1] = column


@kernel
def jump_to_goals(
    grids: Bytes,
    starts: Ints,
    goals: Ints,
    bits: BitMap,
    lattice: Lattice,
    memory: JumpMemory,
) -> tuple[Solved, Ints]:
    """Run jump point search from ``starts[b]`` to ``goals[b]`` on ``grids[b]``, for B problems.

    Args:
        grids: (B, H, W), or (1, H, W) for a grid that all problems share.
        starts: (B, 2) cells.
        goals: (B, 2) cells.
        bits: of maps of this shape.
        lattice: of the maps, with diagonals.
        memory: for maps of this shape.

    Returns:
        The paths; and the numbers of looks, (B,). Expanded are the start and the jump points that
        are taken from the frontier, among equal f the one that was found last, and the goal. A look
        is a cell that a scan or a ray passes, counted as often as one passes it; the start is one,
        too.
    """
    may_cut = lattice.diagonals == CORNER_CUTTING
    shape = grids.shape[1:]
    count = len(starts)
    block = np.empty(WORD, np.uint64)
    moves = np.empty((count, 2), np.int64)
    expansions = np.empty(count, np.int64)
    looks = np.empty(count, np.int64)
    offsets = np.zeros(count + 1, np.int64)
    cells = np.empty((64 * count + 64, 2), np.int64)
    used = 0
    for b in range(count):
        is_valid = True
        if b == 0 or len(grids) > 1:
            is_valid = load_bits(grids[b], bits, block)
        start = (starts[b, 0], starts[b, 1])
        goal = (goals[b, 0], goals[b, 1])
        if not is_valid or not _are_free(start, goal, shape, bits):
            return Solved(cells, moves, expansions, offsets, b, EXACT), looks
        cost, last_node, expansions[b], looks[b], high_cost = _search(
            start, goal, shape, bits, may_cut, lattice.diagonal_cost, memory
        )
        if high_cost:
            return Solved(cells, moves, expansions, offsets, b, high_cost), looks
        straight: Int = -1
        diagonal: Int = 0
        if cost >= 0:
            straight, diagonal = split_cost(cost)
        moves[b, 0] = straight
        moves[b, 1] = diagonal
        length = count_path_cells(straight, diagonal)
        cells = with_capacity(cells, used, length)
        if length:
            _write_path(goal, last_node, shape[1], memory.nodes, cells[used : used + length])
        used += length
        offsets[b + 1] = used
    return Solved(cells[:used], moves, expansions, offsets, count, EXACT), looks
