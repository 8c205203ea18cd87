"""Breadth-first search of small maps, 64 cells at a time: a row of a map is one word, a level of
the search one word a row.

The order of a first-in-first-out queue seems lost in a set of bits, but it is not. Within a level,
cells stand in the order of their paths, compared move by move (N < E < S < W), because a cell's
parent is the first of its neighbours and neighbours are seen in the order of moves. So the path
that the queue finds is the first of all shortest ones, which a descent from the start through the
levels around the goal meets; and the cells taken before the goal are all nearer ones, and those of
its level whose path comes first, a set that can be carried along the path.
"""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Bytes, Ints, Words
from mapdata.jit import Int, kernel
from mapdata.search.kernels import with_capacity

MAX_SIDE = 64
"""Most rows and columns of a map that is searched here."""

_EDGE = 3
"""Empty rows above and below a level: a level reads two beyond what the one before it wrote."""

_LEVEL = MAX_SIDE + 2 * _EDGE
_LEVELS = MAX_SIDE * MAX_SIDE + 2
_ONE = np.uint64(1)


@kernel
def bit_scratch(needed: bool) -> Words:
    """Return room for the levels of two searches, (2, words), touched only as far as they are
    used.
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
    n, pair, nearer, need = len(seed_points), 0, 0, np.int64(-1)
    unseen, before = np.zeros(_LEVEL, np.uint64), np.empty((2, _LEVEL), np.uint64)
    for s in range(n):
        # Flood around s until all later seeds are seen, and the seed before it, where a segment
        # starts.
        level, at, depth, pending = levels[s & 1], 0, 0, n - 1 - s
        for r in range(len(words)):
            unseen[r + _EDGE] = ~words[r, 0] & (~np.uint64(0) >> np.uint64(MAX_SIDE - columns))
        free = count_bits(unseen, 0, _LEVEL)
        low = high = seed_points[s, 0] + _EDGE
        for r in range(low - _EDGE, low + _EDGE + 1):
            level[r] = 0
        level[low] = _ONE << np.uint64(seed_points[s, 1])
        unseen[low] &= ~level[low]
        for k in range(pending):
            costs[pair + k, 0], costs[pair + k, 1] = -1, 0
        while True:
            for k in range(n - 1 - s):
                row, column = (
                    seed_points[s + 1 + k, 0] + _EDGE,
                    np.uint64(seed_points[s + 1 + k, 1]),
                )
                if costs[pair + k, 0] < 0 and (unseen[row] >> column) & _ONE == 0:
                    costs[pair + k, 0] = depth
                    pending -= 1
                    if k == 0:
                        nearer = (
                            free
                            - count_bits(unseen, 0, _LEVEL)
                            - count_bits(level, at + low, at + high + 1)
                        )
            if pending == 0 and depth >= need:
                break
            # Two views and unsigned indices: so the compiler sees that nothing overlaps, and takes
            # 8 rows at a time.
            here, new = level[at : at + _LEVEL], level[at + _LEVEL : at + 2 * _LEVEL]
            new[low - 3] = new[low - 2] = new[high + 2] = new[high + 3] = 0
            for r in range(low - 1, high + 2):
                i = np.uint64(r)
                f = (
                    (here[i] << _ONE) | (here[i] >> _ONE) | here[i - _ONE] | here[i + _ONE]
                ) & unseen[i]
                new[i] = f
                unseen[i] ^= f
            low, high = low - 1, high + 1
            while low <= high and new[low] == 0:
                low += 1
            while low <= high and new[high] == 0:
                high -= 1
            if low > high:
                break
            depth += 1
            at += _LEVEL
        if need >= 0:
            moves = with_capacity(moves, used, need)
            table[s - 1, 0] = need
            table[s - 1, 1] += _trace(
                level, levels[1 - (s & 1)], seed_points[s - 1], need, before, moves, used
            )
            used += need
        if s + 1 < n:
            need = costs[pair, 0]
            table[s, 0], table[s, 1] = (
                0,
                nearer + 1 if need >= 0 else free - count_bits(unseen, 0, _LEVEL),
            )
            pair += n - 1 - s
    return moves, used


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
    """Write the ``length`` moves of the queue's path; return how many cells of the goal's level are
    taken before it.
    """
    row, bit = start[0] + _EDGE, _ONE << np.uint64(start[1])
    low = high = row
    before[:, :] = 0
    for step in range(length):
        back, ahead = (length - step - 1) * _LEVEL, (step + 1) * _LEVEL
        now, then = before[step & 1], before[1 - (step & 1)]
        first, last = min(low, row) - 1, max(high, row) + 1
        level = around_start[ahead : ahead + _LEVEL]
        for r in range(first, last + 1):
            k = np.uint64(r)
            then[k] = ((now[k] << _ONE) | (now[k] >> _ONE) | now[k - _ONE] | now[k + _ONE]) & level[
                k
            ]
        then[first - 2] = then[first - 1] = then[last + 1] = then[last + 2] = 0
        # Neighbours by an earlier move than the path's come before it, too.
        if around_goal[back + row - 1] & bit:
            move = 0
            row -= 1
        else:
            then[row - 1] |= around_start[ahead + row - 1] & bit
            if around_goal[back + row] & (bit << _ONE):
                move = 1
                bit <<= _ONE
            else:
                then[row] |= around_start[ahead + row] & (bit << _ONE)
                if around_goal[back + row + 1] & bit:
                    move = 2
                    row += 1
                else:
                    then[row + 1] |= around_start[ahead + row + 1] & bit
                    move = 3
                    bit >>= _ONE
        moves[used + step] = move
        low, high = first, last
        while low < high and then[low] == 0:
            low += 1
        while low < high and then[high] == 0:
            high -= 1
        if then[low] == 0:
            low = high = row
    return count_bits(before[length & 1], low, high + 1)


@kernel
def count_bits(words: Words, first: Int, last: Int) -> Int:
    """Return the number of ones in ``words[first:last]``."""
    total: Int = 0
    for k in range(first, last):
        w = words[k]
        w -= (w >> _ONE) & np.uint64(0x5555555555555555)
        w = (w & np.uint64(0x3333333333333333)) + (
            (w >> np.uint64(2)) & np.uint64(0x3333333333333333)
        )
        w = (w + (w >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
        total += np.int64((w * np.uint64(0x0101010101010101)) >> np.uint64(56))
    return total
