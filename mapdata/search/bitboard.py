"""Breadth-first search of small maps, 64 cells at a time.

A row of a map is one word, with column c in bit c, and a level of the search, all cells equally far
from where it began, is one word a row. The next level is the current one shifted by one cell in the
four directions, less the cells seen before.

The order of a first-in-first-out queue seems lost in a set of bits, but it is not. Within a level,
cells stand in the order of their paths, compared move by move (N < E < S < W), because a cell's
parent is the first of its neighbours and neighbours are seen in the order of moves. So the path
that the queue finds is the first of all shortest ones, which a descent from the start through the
levels around the goal meets; and the cells expanded before the goal are all nearer ones, and those
of its level whose path comes first, a set that can be carried along the path.
"""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Bytes, Ints, Words
from mapdata.jit import Int, inlined, kernel
from mapdata.search.kernels import with_capacity

MAX_SIDE = 64
"""Most rows and columns of a map that is searched here."""

_EDGE = 3
"""Empty rows above and below a level: a level reads two beyond what the one before it wrote."""

_LEVEL = MAX_SIDE + 2 * _EDGE
"""Words of a level."""

_LEVELS = MAX_SIDE * MAX_SIDE + 2
"""Most levels of a search."""

_ONE = np.uint64(1)
_ALL = ~np.uint64(0)
_PAIRS = np.uint64(0x5555555555555555)
_FOURS = np.uint64(0x3333333333333333)
_EIGHTS = np.uint64(0x0F0F0F0F0F0F0F0F)
_BYTES = np.uint64(0x0101010101010101)


@kernel
def bit_scratch(needed: bool) -> Words:
    """Return room for the levels of two searches, (2, words), touched only as far as they are used.

    The words are those of level 0, then of level 1, and so on.
    """
    return np.empty((2, _LEVELS * _LEVEL if needed else 0), np.uint64)


@kernel
def bit_labels(
    words: Words,
    columns: Int,
    seed_points: Ints,
    levels: Words,
    table: Ints,
    costs: Ints,
    moves: Bytes,
    used: Int,
) -> tuple[Bytes, Int]:
    """Label one map by BFS as `labels._bfs_labels` does; 4-connected, at most 64 x 64 cells.

    Args:
        words: (H, 1) packed map.
        columns: W.
        seed_points: (n, 2) seed points.
        levels: what `bit_scratch` gave.
        table: (n - 1, 2), filled with number of moves and iterations of each segment.
        costs: (pairs, 2), filled with moves between seeds and 0, or (-1, 0).
        moves: the moves of all segments so far, ``used`` of them.
        used: how many.

    Returns:
        ``moves``, perhaps a larger copy, and how many are used.
    """
    n = len(seed_points)
    pair = 0
    nearer = 0  # cells nearer than the next seed
    length = np.int64(-1)  # moves from the seed before, where a segment starts; -1 without a path
    unseen = np.zeros(_LEVEL, np.uint64)
    before = np.empty((2, _LEVEL), np.uint64)
    for s in range(n):
        # Flood around seed s until all later seeds are seen, and the seed before it. The levels
        # around that one are kept in the other half: `_trace` needs both.
        level = levels[s & 1]
        at = 0
        depth = 0
        pending = n - 1 - s
        for r in range(len(words)):
            unseen[r + _EDGE] = ~words[r, 0] & (_ALL >> np.uint64(MAX_SIDE - columns))
        free = count_bits(unseen, 0, _LEVEL)
        low = seed_points[s, 0] + _EDGE
        high = low
        # Level 0 is the seed alone; the rows about it are read by the next level.
        for r in range(low - _EDGE, low + _EDGE + 1):
            level[r] = 0
        level[low] = _ONE << np.uint64(seed_points[s, 1])
        unseen[low] &= ~level[low]
        for k in range(pending):
            costs[pair + k, 0] = -1
            costs[pair + k, 1] = 0
        while True:
            # A later seed that is not unseen any more, but was at the last level, is in this one.
            for k in range(n - 1 - s):
                row = seed_points[s + 1 + k, 0] + _EDGE
                column = np.uint64(seed_points[s + 1 + k, 1])
                if costs[pair + k, 0] < 0 and (unseen[row] >> column) & _ONE == 0:
                    costs[pair + k, 0] = depth
                    pending -= 1
                    if k == 0:  # the next seed, where a segment ends
                        seen = free - count_bits(unseen, 0, _LEVEL)
                        nearer = seen - count_bits(level, at + low, at + high + 1)
            if pending == 0 and depth >= length:  # `_trace` needs ``length`` levels
                break
            here = level[at : at + _LEVEL]
            new = level[at + _LEVEL : at + 2 * _LEVEL]
            low, high = _next_level(here, new, unseen, low, high)
            if low > high:  # nothing new: all that can be reached is seen
                break
            depth += 1
            at += _LEVEL
        if length >= 0:
            moves = with_capacity(moves, used, length)
            around_start = levels[1 - (s & 1)]
            table[s - 1, 0] = length
            table[s - 1, 1] += _trace(
                level, around_start, seed_points[s - 1], length, before, moves, used
            )
            used += length
        if s + 1 < n:
            length = costs[pair, 0]
            # The expansions known so far: with a path, those of its level are added by `_trace`.
            table[s, 0] = 0
            table[s, 1] = nearer + 1
            if length < 0:
                table[s, 1] = free - count_bits(unseen, 0, _LEVEL)
            pair += n - 1 - s
    return moves, used


@inlined
def _next_level(here: Words, new: Words, unseen: Words, low: Int, high: Int) -> tuple[Int, Int]:
    """Write the level ``new`` that follows ``here``, whose cells lie in rows ``low`` to ``high``.

    Returns the first and last row of the new level; the first is beyond the last if it is empty.
    """
    # With unsigned indices into two views the compiler sees that nothing overlaps, and takes 8 rows
    # at a time.
    for row in range(low - 1, high + 2):
        r = np.uint64(row)
        reached = _beside(here, r) & unseen[r]
        new[r] = reached
        unseen[r] ^= reached
    # The level after this one reads two rows beyond it, and the buffer holds an older search.
    new[low - 3] = 0
    new[low - 2] = 0
    new[high + 2] = 0
    new[high + 3] = 0
    first = low - 1
    last = high + 1
    while first <= last and new[first] == 0:
        first += 1
    while first <= last and new[last] == 0:
        last -= 1
    return first, last


@inlined
def _beside(level: Words, row: np.uint64) -> Int:
    """Return the cells of a row that are one move away from a cell of ``level``."""
    east_and_west = (level[row] << _ONE) | (level[row] >> _ONE)
    return east_and_west | level[row - _ONE] | level[row + _ONE]


@kernel
def _trace(
    around_goal: Words,
    around_start: Words,
    start: Ints,
    length: Int,
    before: Words,
    moves: Bytes,
    used: Int,
) -> Int:
    """Write the ``length`` moves of the queue's path from ``start`` to the goal.

    Returns how many cells of the goal's level are expanded before it. ``before`` (2, words) is for
    two levels in turns: the cells of a level around the start that stand before the path's cell.
    """
    row = start[0] + _EDGE
    bit = _ONE << np.uint64(start[1])
    low = row
    high = row
    before[:, :] = 0
    for step in range(length):
        back = (length - step - 1) * _LEVEL
        ahead = (step + 1) * _LEVEL
        now = before[step & 1]
        then = before[1 - (step & 1)]
        first = min(low, row) - 1
        last = max(high, row) + 1
        level = around_start[ahead : ahead + _LEVEL]
        # The children of a cell that stands before the path's cell stand before the path's next.
        for r in range(first, last + 1):
            i = np.uint64(r)
            then[i] = _beside(now, i) & level[i]
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
        w = (w & _FOURS) + ((w >> np.uint64(2)) & _FOURS)  # each four
        w = (w + (w >> np.uint64(4))) & _EIGHTS  # each byte
        # modulo 2^64, the top byte of the product is the sum of all bytes
        total += np.int64((w * _BYTES) >> np.uint64(56))
    return total
