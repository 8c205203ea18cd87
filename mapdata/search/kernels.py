"""The search kernels: BFS, three forms of A*, and the shortest costs from one cell to all.

The order in which they expand cells is part of the data format (docs/format.md). BFS is first in,
first out. A* expands the cell of the smallest f, and among equal f the most recently pushed one.
Neighbours come in the order N, E, S, W, NE, SE, SW, NW. A cell's parent changes only for a smaller
g.

A grid is a flat array with a wall around it, and a cell is its index in that array
(`mapdata.search.lattice`). A search keeps one byte for each cell, in ``came_from``: WALL, UNSEEN,
ROOT, or the move from 0 to 7 that led to the cell, from which its parent follows. A* sets the bit
CLOSED, 8, when it expands the cell. So ``came_from[cell] < CLOSED`` means that the cell is in the
open list.

Two habits of these kernels look odd and are for speed:

- Hot loops index by unsigned integers. numba lets a signed index count from the end, as Python
  does, and tests its sign at each access. Constants like _ONE exist because uint64 and int64
  together would give float64.
- A push is written to a log that is never shortened, and links between its entries form the stacks,
  buckets and heaps. A push is the index of an entry in that log. No entry moves or changes when its
  cell gets a smaller g: the cell is pushed again, and the older entry is dropped when it is popped.
  The log also lists which cells a search has touched, so `wipe` makes a grid ready for the next
  search without a pass over all of it.

The memory that searches write to, `Scratch`, has room for the largest possible number of pushes: up
to 137 bytes a cell. Only what a search touches becomes memory of the process, mostly 10 to 40 bytes
for each cell that it expands and 1 for each cell of the grid.

All of this is one file, because the searches share the log, the links and the bits of
``came_from``.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Ints, UInt32s
from mapdata.jit import Int, inlined, kernel
from mapdata.movement import STEPS
from mapdata.search.ground import EXACT, TOO_LONG
from mapdata.search.lattice import (
    CLOSED,
    CORNER_CUTTING,
    INFINITY,
    MAX_PATH_COST,
    NO_CORNER_CUTTING,
    NO_DIAGONALS,
    ROOT,
    UNIT,
    UNIT_BITS,
    UNSEEN,
    WALL,
    Lattice,
    MoveRule,
    heuristic,
    is_binary,
    is_legal,
    plain_lattice,
    position,
)

_ZERO = np.uint64(0)
_ONE = np.uint64(1)

_MOVE = np.uint8(7)
"""The bits of ``came_from`` that hold the move."""

_BUCKET_BITS = UNIT_BITS - 6
"""A bucket of `best_first_buckets` covers an interval of f 1/64 of a straight move wide."""

_BUCKETS = 256
"""The buckets together cover 4 straight moves, more than f grows by at once, which is 2 sqrt(2)."""

LOWEST_MOVE = np.array([0] + [(k & -k).bit_length() - 1 for k in range(1, 256)], np.uint8)
"""(256,) the lowest move of each set of moves that is not empty; bit k stands for move k."""


class Scratch(NamedTuple):
    """The memory that searches write to, one after another.

    Kernels read its arrays by name, because unpacking it would count references of all five.

    Attributes:
        came_from: (cells,) uint8: WALL, UNSEEN, ROOT, or the move that led to a cell.
        g: (cells,) cost of the best path to a cell so far; valid where ``came_from`` holds a move.
        pushed: (pushes,) the log: padded cells, in the order in which they were pushed.
        links: (pushes,) for each push the next one of its list; or a heap of pushes.
        f: (pushes,) priorities of the pushes, or of those in the heap; empty if there is no f.
    """

    came_from: Bytes
    g: Ints
    pushed: UInt32s
    links: UInt32s
    f: Ints


# --- kernels: one search on a padded grid -------------------------------------------------------


@kernel
def flood(start: Int, targets: Ints, lattice: Lattice, scratch: Scratch) -> Int:
    """Run breadth-first search from ``start`` until all ``targets``, if any, are seen.

    Args:
        start: padded cell.
        targets: (n,) padded cells; without any, all cells that can be reached are seen.
        lattice: of the map.
        scratch: with the map loaded in ``came_from``.

    Returns:
        How many cells are in ``scratch.pushed``, in the order in which they are expanded. There may
        be cells of a few more levels than the targets demand.
    """
    came_from = scratch.came_from
    queue = scratch.pushed
    stride = np.uint64(lattice.stride)
    head = _ZERO
    tail = _ONE
    level = 0
    queue[0] = start
    came_from[start] = ROOT
    while head < tail:
        # Level by level, so that targets are looked for between levels and not at each cell.
        level_end = tail
        while head < level_end:
            cell = np.uint64(queue[head])
            head += _ONE
            tail = _enqueue(came_from, queue, tail, cell - stride, 0)
            tail = _enqueue(came_from, queue, tail, cell + _ONE, 1)
            tail = _enqueue(came_from, queue, tail, cell + stride, 2)
            tail = _enqueue(came_from, queue, tail, cell - _ONE, 3)
            if lattice.diagonals:
                # This copy of the corner rule of `is_legal` reads each neighbour once, which takes
                # a third of the time.
                north_free = came_from[cell - stride] != WALL
                east_free = came_from[cell + _ONE] != WALL
                south_free = came_from[cell + stride] != WALL
                west_free = came_from[cell - _ONE] != WALL
                may_cut = lattice.diagonals == CORNER_CUTTING
                if may_cut or (north_free and east_free):
                    tail = _enqueue(came_from, queue, tail, cell - stride + _ONE, 4)
                if may_cut or (south_free and east_free):
                    tail = _enqueue(came_from, queue, tail, cell + stride + _ONE, 5)
                if may_cut or (south_free and west_free):
                    tail = _enqueue(came_from, queue, tail, cell + stride - _ONE, 6)
                if may_cut or (north_free and west_free):
                    tail = _enqueue(came_from, queue, tail, cell - stride - _ONE, 7)
        level += 1
        # Targets are looked for after every eighth level: a few levels too many cost less than to
        # look after each.
        if level & 7 == 0 and len(targets) and _all_seen(came_from, targets):
            break
    return np.int64(tail)


@inlined
def _enqueue(
    came_from: Bytes, queue: UInt32s, tail: np.uint64, cell: np.uint64, move: Int
) -> np.uint64:
    """Append ``cell`` to the queue if it is unseen; return the new tail.

    There is no branch, which the processor would often predict wrongly: the cell is always stored,
    and the next one overwrites it unless the tail moves on.
    """
    state = came_from[cell]
    is_unseen = state == UNSEEN
    queue[tail] = cell
    came_from[cell] = np.uint8(move) if is_unseen else state
    return tail + (_ONE if is_unseen else _ZERO)


@inlined
def _all_seen(came_from: Bytes, targets: Ints) -> Int:
    """Return whether the search has seen all ``targets`` (n,), padded cells."""
    for target in targets:  # noqa: SIM110  (numba has no all() over a generator)
        if came_from[target] == UNSEEN:
            return False
    return True


@kernel
def expansions_until(queue: UInt32s, count: Int, goal: Int) -> Int:
    """Return how many of the first ``count`` cells in ``queue`` BFS expands to find ``goal``.

    That is the goal's position in the queue, counted from 1, or ``count`` if it is not there.
    """
    for k in range(count):
        if queue[np.uint64(k)] == goal:
            return k + 1
    return count


@kernel
def astar_manhattan(start: Int, goal: Int, lattice: Lattice, scratch: Scratch) -> tuple[Int, Int]:
    """Run A* with 4-connected moves and the Manhattan heuristic.

    Two stacks are the open list, and no heap is needed. A move adds 1 to g and changes h by 1, so f
    either stays as it is, after a move closer to the goal, or grows by 2, after a move away from
    it. While cells of one f are expanded, the open list holds only that f, in the ``near`` stack,
    and f + 2, in the ``far`` stack. Once the near stack is empty, the far stack takes its place.
    Within one f the top of the stack is the latest push, so the order is exactly that of a heap
    which prefers the latest push among equal f.

    Both stacks are lists through the log: ``near_top`` and ``far_top`` are pushes, and ``links``
    leads from a push to the one below it. Push 0 does not exist, so a link of 0 ends a list. ``g``
    counts moves and needs no content before the search.

    Args:
        start: padded cell, free.
        goal: padded cell, free.
        lattice: of the map, without diagonals.
        scratch: with the map loaded in ``came_from``.

    Returns:
        The number of expansions, and the number of pushes plus 1, as `wipe` takes it.
    """
    came_from = scratch.came_from
    g = scratch.g
    pushed = scratch.pushed
    links = scratch.links
    # Every cell fits into 32 bits, whose division is faster than that of 64 bits.
    stride = np.uint32(lattice.stride)
    target = np.uint32(goal)
    goal_row = target // stride
    goal_column = target - goal_row * stride
    near_top = np.uint32(1)
    far_top = np.uint32(0)
    pushes = np.uint32(2)
    expansions = 0
    pushed[1] = start
    links[1] = 0
    came_from[start] = 0  # Any move will do: a path is traced back only as far as its start.
    g[start] = 0
    while True:
        if near_top == 0:
            if far_top == 0:
                return expansions, np.int64(pushes)
            near_top = far_top
            far_top = np.uint32(0)
        cell = pushed[near_top]
        near_top = links[near_top]
        # A closed cell was pushed again with a smaller f and expanded then.
        if came_from[cell] & CLOSED:
            continue
        came_from[cell] |= CLOSED
        expansions += 1
        if cell == target:
            return expansions, np.int64(pushes)
        tentative_g = g[cell] + 1
        row = cell // stride
        column = cell - row * stride
        for move in range(4):
            if move == 0:
                neighbour = cell - stride
                is_closer = row > goal_row
            elif move == 1:
                neighbour = cell + np.uint32(1)
                is_closer = column < goal_column
            elif move == 2:
                neighbour = cell + stride
                is_closer = row < goal_row
            else:
                neighbour = cell - np.uint32(1)
                is_closer = column > goal_column
            state = came_from[neighbour]
            if state == UNSEEN or (state < CLOSED and g[neighbour] > tentative_g):
                came_from[neighbour] = move
                g[neighbour] = tentative_g
                pushed[pushes] = neighbour
                if is_closer:
                    links[pushes] = near_top
                    near_top = pushes
                else:
                    links[pushes] = far_top
                    far_top = pushes
                pushes += np.uint32(1)


@inlined
def wipe(scratch: Scratch, pushes: Int) -> None:
    """Make ``came_from`` fresh again after an A*, whose log lists every cell that it changed.

    ``pushes`` is the second number that the search returned: one past the last entry of the log.
    """
    came_from = scratch.came_from
    pushed = scratch.pushed
    for k in range(1, pushes):
        came_from[np.uint64(pushed[np.uint64(k)])] = UNSEEN


@kernel
def best_first_buckets(
    start: Int, goal: Int, lattice: Lattice, scratch: Scratch
) -> tuple[Int, Int, Int]:
    """Run A* with diagonal moves: the open list is a ring of buckets.

    With an admissible and consistent heuristic f never falls along a path, so no heap is needed, as
    in `astar_manhattan`. A move adds one of few numbers to f: 0, 2 - sqrt(2), 2 sqrt(2) - 2,
    sqrt(2), 2 or 2 sqrt(2); where diagonals cost 1, it adds 0, 1 or 2. So a push goes

    - on top of the current stack, which holds the pushes whose f is being expanded, if it has that
      f: being the latest push, it is the next to be expanded;
    - else on top of the bucket of its f. A bucket is a stack of pushes in a narrow interval of f,
      so narrow that such a push never belongs to the interval that is being expanded.

    Once the current stack is empty, the pushes of the smallest f in the next bucket become it, in
    their order. Mostly they are the whole bucket, since few values of f are closer to each other
    than an interval is wide.

    Stacks are lists through the log, as in `astar_manhattan`. ``g`` and ``f`` are in 1 / UNIT.

    Which moves lead to a push is found without branches, which the processor would often predict
    wrongly: most neighbours are not pushed.

    Args:
        start: padded cell, free.
        goal: padded cell, free.
        lattice: of the map, with diagonals.
        scratch: with the map loaded in ``came_from``.

    Returns:
        The number of expansions; the number of pushes plus 1, as `wipe` takes it; and EXACT, or
        TOO_LONG where the search stopped at a path that is too long for exact costs.
    """
    came_from = scratch.came_from
    g = scratch.g
    pushed = scratch.pushed
    links = scratch.links
    f = scratch.f
    goal_row, goal_column = position(goal, lattice)
    row, column = position(start, lattice)
    current_f = heuristic(row - goal_row, column - goal_column, lattice)
    bucket = np.uint8(current_f >> _BUCKET_BITS)  # Arithmetic with 8 bits goes around the ring.
    bucket_tops = np.zeros(_BUCKETS, np.uint32)
    came_from[start] = 0  # Any move will do: a path is traced back only as far as its start.
    g[start] = 0
    pushed[1] = start
    links[1] = 0
    current_top = np.uint32(1)
    pushes = np.uint32(2)
    expansions = 0
    stride = np.uint64(lattice.stride)
    may_cut = lattice.diagonals == CORNER_CUTTING
    while True:
        if current_top == 0:
            empty_buckets = 0
            while empty_buckets < _BUCKETS and bucket_tops[bucket] == 0:
                bucket = np.uint8(bucket + 1)
                empty_buckets += 1
            if empty_buckets == _BUCKETS:
                break
            current_top, bucket_tops[bucket], current_f = _split_bucket(
                bucket_tops[bucket], links, f
            )
        cell = np.uint64(pushed[np.uint64(current_top)])
        current_top = links[np.uint64(current_top)]
        # A closed cell was pushed again with a smaller f and expanded then.
        if came_from[cell] & CLOSED:
            continue
        came_from[cell] |= CLOSED
        expansions += 1
        if cell == goal:
            break
        cost = g[cell]
        if cost >= MAX_PATH_COST * UNIT:
            return expansions, np.int64(pushes), TOO_LONG
        row, column = position(np.int64(cell), lattice)
        straight_g = cost + UNIT
        diagonal_g = cost + lattice.diagonal_cost
        # This copy of the corner rule of `is_legal` has no branches.
        north_free = may_cut | (came_from[cell - stride] != WALL)
        east_free = may_cut | (came_from[cell + _ONE] != WALL)
        south_free = may_cut | (came_from[cell + stride] != WALL)
        west_free = may_cut | (came_from[cell - _ONE] != WALL)
        moves = np.uint64(0)
        for bit, neighbour, tentative_g, is_allowed in (
            (0, cell - stride, straight_g, True),
            (1, cell + _ONE, straight_g, True),
            (2, cell + stride, straight_g, True),
            (3, cell - _ONE, straight_g, True),
            (4, cell - stride + _ONE, diagonal_g, north_free & east_free),
            (5, cell + stride + _ONE, diagonal_g, south_free & east_free),
            (6, cell + stride - _ONE, diagonal_g, south_free & west_free),
            (7, cell - stride - _ONE, diagonal_g, north_free & west_free),
        ):
            state = came_from[neighbour]
            # A closed cell has its final g already, because the heuristic is consistent.
            is_cheaper = (state == UNSEEN) | ((state < CLOSED) & (g[neighbour] > tentative_g))
            moves |= np.uint64(is_allowed & is_cheaper) << np.uint64(bit)
        while moves:
            move = np.uint64(LOWEST_MOVE[moves])
            moves &= moves - _ONE
            neighbour = cell + np.uint64(lattice.offsets[move])
            tentative_g = straight_g if move < np.uint64(4) else diagonal_g
            rows_to_goal = row + STEPS[move, 0] - goal_row
            columns_to_goal = column + STEPS[move, 1] - goal_column
            neighbour_f = tentative_g + heuristic(rows_to_goal, columns_to_goal, lattice)
            came_from[neighbour] = move
            g[neighbour] = tentative_g
            push = np.uint64(pushes)
            pushed[push] = neighbour
            if neighbour_f == current_f:
                links[push] = current_top
                current_top = pushes
            else:
                f[push] = neighbour_f
                neighbour_bucket = np.uint8(neighbour_f >> _BUCKET_BITS)
                links[push] = bucket_tops[neighbour_bucket]
                bucket_tops[neighbour_bucket] = pushes
            pushes += np.uint32(1)
    return expansions, np.int64(pushes), EXACT


@kernel
def best_first_heap(
    start: Int,
    goal: Int,
    weights: tuple[Int, float],
    landmark_costs: Ints,
    lattice: Lattice,
    scratch: Scratch,
) -> tuple[Int, Int, Int]:
    """Run best-first search with any moves and weights: the open list is a binary heap.

    With weights f may fall along a path, so the buckets of `best_first_buckets` do not serve. The
    heap is the textbook's: ``links`` holds its pushes, and ``f`` their priorities. ``g`` is in 1 /
    UNIT.

    Args:
        start: padded cell, free.
        goal: padded cell, free.
        weights: of g and h in f; not BFS.
        landmark_costs: (landmarks, cells), costs between cells and landmarks that both ends reach,
            of which h is the largest bound (`mapdata.search.landmarks`); without any, h is the
            distance on an empty map. That is no None, so that the kernel is compiled only once.
        lattice: of the map.
        scratch: with the map loaded in ``came_from``.

    Returns:
        The number of expansions; the number of pushes plus 1, as `wipe` takes it; and EXACT, or
        TOO_LONG where the search stopped at a path that is too long for exact costs.
    """
    came_from = scratch.came_from
    g = scratch.g
    pushed = scratch.pushed
    heap = scratch.links
    f = scratch.f
    g_weight, h_weight = weights
    goal_row, goal_column = position(goal, lattice)
    came_from[start] = 0  # Any move will do: a path is traced back only as far as its start.
    g[start] = 0
    pushed[1] = start
    heap[0] = 1
    f[0] = 0  # The start is alone in the heap, so its priority does not matter.
    heap_size = 1
    pushes = np.uint32(2)
    expansions = 0
    while heap_size:
        cell = pushed[np.uint64(heap[0])]
        heap_size -= 1
        remove_heap_top(heap, f, heap_size)
        # A closed cell was pushed again with a smaller f and expanded then.
        if came_from[cell] & CLOSED:
            continue
        came_from[cell] |= CLOSED
        expansions += 1
        if cell == goal:
            break
        cost = g[cell]
        if cost >= MAX_PATH_COST * UNIT:
            return expansions, np.int64(pushes), TOO_LONG
        row, column = position(cell, lattice)
        for move in range(len(lattice.offsets)):
            neighbour = np.uint64(cell + lattice.offsets[move])
            tentative_g = cost + (UNIT if move < 4 else lattice.diagonal_cost)
            state = came_from[neighbour]
            # Most neighbours fail this test, so that corners are looked at for few of them.
            if state == WALL or (state != UNSEEN and g[neighbour] <= tentative_g):
                continue
            if not is_legal(came_from, cell, move, lattice):
                continue
            if state != UNSEEN and state >= CLOSED:
                # The cell was expanded before a shorter path to it was found, which happens under
                # weights other than those of A*. It takes the shorter path and is not expanded
                # again.
                came_from[neighbour] = move | CLOSED
                g[neighbour] = tentative_g
                continue
            rows_to_goal = row + STEPS[move, 0] - goal_row
            columns_to_goal = column + STEPS[move, 1] - goal_column
            h = heuristic(rows_to_goal, columns_to_goal, lattice)
            for k in range(len(landmark_costs)):
                # The triangle inequality.
                h = max(h, abs(landmark_costs[k, neighbour] - landmark_costs[k, goal]))
            if h_weight != 1:  # Multiplied by the float 1.0, a large h would be rounded.
                h = np.int64(h_weight * h)
            came_from[neighbour] = move
            g[neighbour] = tentative_g
            pushed[pushes] = neighbour
            insert_in_heap(heap, f, heap_size, pushes, g_weight * tentative_g + h)
            heap_size += 1
            pushes += np.uint32(1)
    return expansions, np.int64(pushes), EXACT


@inlined
def _split_bucket(top: Int, links: UInt32s, f: Ints) -> tuple[Int, Int, Int]:
    """Split the stack below push ``top`` into the pushes of the smallest f and all others.

    Both stacks keep the order of the pushes. Returns the top of each, 0 if it is empty, and the
    smallest f.
    """
    # Moving the pushes to other stacks reverses their order, so the stack is reversed first.
    min_f = f[top]
    reversed_top = np.uint32(0)
    while top:
        next_push = links[top]
        min_f = min(min_f, f[top])
        links[top] = reversed_top
        reversed_top = top
        top = next_push
    min_f_top = np.uint32(0)
    larger_f_top = np.uint32(0)
    while reversed_top:
        next_push = links[reversed_top]
        if f[reversed_top] == min_f:
            links[reversed_top] = min_f_top
            min_f_top = reversed_top
        else:
            links[reversed_top] = larger_f_top
            larger_f_top = reversed_top
        reversed_top = next_push
    return min_f_top, larger_f_top, min_f


@inlined
def remove_heap_top(heap: UInt32s, f: Ints, size: Int) -> None:
    """Remove the top of a heap, in which ``size`` entries are left.

    The last entry moves to the top and sinks to its position. An entry belongs above another one if
    its f is smaller, or if f is equal and its push is later.
    """
    end = np.uint64(size)
    last_push = heap[end]
    last_f = f[end]
    hole = _ZERO
    child = _ONE
    while child < end:
        right = child + _ONE
        if right < end and (
            f[right] < f[child] or (f[right] == f[child] and heap[right] > heap[child])
        ):
            child = right
        if last_f < f[child] or (last_f == f[child] and last_push > heap[child]):
            break
        f[hole] = f[child]
        heap[hole] = heap[child]
        hole = child
        child = (child << _ONE) + _ONE
    f[hole] = last_f
    heap[hole] = last_push


@inlined
def insert_in_heap(heap: UInt32s, f: Ints, size: Int, push: Int, push_f: Int) -> None:
    """Insert ``push`` into a heap of ``size`` entries, in the order of `remove_heap_top`."""
    hole = np.uint64(size)
    while hole:
        parent = (hole - _ONE) >> _ONE
        if f[parent] < push_f or (f[parent] == push_f and heap[parent] > push):
            break
        f[hole] = f[parent]
        heap[hole] = heap[parent]
        hole = parent
    f[hole] = push_f
    heap[hole] = push


@kernel
def count_moves(came_from: Bytes, start: Int, goal: Int, lattice: Lattice) -> tuple[Int, Int]:
    """Return how many straight and diagonal moves led from ``start`` to ``goal``.

    Without a path, that is (-1, 0).
    """
    if came_from[goal] == UNSEEN:
        return -1, 0
    straight: Int = 0
    diagonal: Int = 0
    cell = goal
    while cell != start:
        move = np.uint64(came_from[np.uint64(cell)] & _MOVE)
        if move < 4:
            straight += 1
        else:
            diagonal += 1
        cell -= lattice.offsets[move]
    return straight, diagonal


@kernel
def write_moves(
    came_from: Bytes, goal: Int, length: Int, lattice: Lattice, moves: Bytes, used: Int
) -> None:
    """Write the ``length`` moves of a path that ends at ``goal`` to ``moves[used:]``."""
    cell = goal
    for k in range(used + length - 1, used - 1, -1):
        move = np.uint64(came_from[np.uint64(cell)] & _MOVE)
        moves[k] = move
        cell -= lattice.offsets[move]


@kernel
def write_cells(
    came_from: Bytes, goal: Int, length: Int, lattice: Lattice, cells: Ints, used: Int
) -> None:
    """Write the ``length`` cells of a path that ends at ``goal`` to ``cells[used:]``, (n, 2)."""
    cell = goal
    for k in range(used + length - 1, used - 1, -1):
        cells[k, 0], cells[k, 1] = position(cell, lattice)
        if k > used:
            cell -= lattice.offsets[np.uint64(came_from[np.uint64(cell)] & _MOVE)]


@kernel
def with_capacity(cells: Ints, used: Int, extra: Int) -> Ints:
    """Return ``cells`` (n, 2) if it has room for ``extra`` rows after the first ``used`` ones.

    Otherwise return a larger array that begins with a copy of the used rows.
    """
    if used + extra <= len(cells):
        return cells
    larger = np.empty((2 * (used + extra), 2), np.int64)
    for k in range(used):
        # Assigning whole rows would compile numba's error message about shapes, for two seconds.
        larger[k, 0] = cells[k, 0]
        larger[k, 1] = cells[k, 1]
    return larger


# --- kernels: whole grids -----------------------------------------------------------------------


def plain_scratch_view(memory: Bytes, lattice: Lattice) -> Scratch:
    """Return a `Scratch` in ``memory`` with room for as many pushes as fit, without compiling.

    Nothing is written yet: `load` fills ``came_from``, and the other arrays need no content.
    """
    cells = lattice.cells
    # Each cell takes 1 byte in ``came_from`` and 8 in ``g``, each push 4 bytes in ``pushed``, 4 in
    # ``links`` and 8 in ``f``.
    pushes = (len(memory) - 9 * cells) // 16
    # The widest items come first, so that all are aligned.
    uint32s_begin = 8 * (cells + pushes)
    bytes_begin = uint32s_begin + 8 * pushes
    int64s = memory[:uint32s_begin].view(np.int64)
    uint32s = memory[uint32s_begin:bytes_begin].view(np.uint32)
    return Scratch(
        memory[bytes_begin : bytes_begin + cells],
        int64s[:cells],
        uint32s[:pushes],
        uint32s[pushes:],
        int64s[cells:],
    )


scratch_view = kernel(plain_scratch_view)
"""`plain_scratch_view` as a kernel, for the kernels that solve one problem."""


def scratch_bytes(max_pushes_per_cell: Int, cells: Int) -> Int:
    """Return how many bytes a `Scratch` takes in which each cell is pushed up to so many times.

    `plain_scratch_view` explains the sizes. The last 32 bytes are for two more pushes: the start,
    and push 0, which does not exist.
    """
    return (9 + 16 * max_pushes_per_cell) * cells + 32


def search_memory(shape: tuple[Int, Int], rule: MoveRule) -> tuple[Lattice, Scratch]:
    """Return the lattice of maps of ``shape`` (rows, columns), and new memory for any search on it.

    Kernels for many problems take both from Python, because a kernel that makes them takes half a
    second more to compile. The memory is one block, because malloc would give some of several
    blocks back to the system after each call.
    """
    lattice = plain_lattice(shape, rule)
    # A search pushes a cell at most once from each neighbour.
    size = scratch_bytes(len(lattice.offsets), lattice.cells)
    return lattice, plain_scratch_view(np.empty(size, np.uint8), lattice)


@kernel
def copy_to_bytes(numbers: Any, out: Bytes) -> Int:
    """Copy flat ``numbers``, integers or floats, into ``out``; return whether all are 0 or 1."""
    are_binary = True
    for k in range(len(numbers)):
        number = numbers[np.uint64(k)]
        out[np.uint64(k)] = number != 0
        # Bitwise operators need no branch, so that the compiler can use vector instructions.
        are_binary &= (number == 0) | (number == 1)
    return are_binary


@kernel
def first_bad_cell(grid: Bytes, path: Ints, diagonals: Int) -> tuple[Int, Int]:
    """Return the first cell where ``path`` breaks the rules, and how many moves are diagonal.

    Args:
        grid: (H, W).
        path: (k, 2) cells.
        diagonals: which diagonal moves are legal, as in `Lattice`.

    Returns:
        The smallest index of a cell that is not free, or that no legal move reaches from the cell
        before; -1 if the whole path is legal; -2 if ``grid`` holds other numbers than 0 and 1.
        Then the number of diagonal moves before that cell.
    """
    diagonal_moves = 0
    if not is_binary(grid):
        return -2, 0
    for k in range(len(path)):
        row = path[k, 0]
        column = path[k, 1]
        is_inside = 0 <= row < grid.shape[0] and 0 <= column < grid.shape[1]
        if not is_inside or grid[row, column]:
            return k, diagonal_moves
        if k == 0:
            continue
        previous_row = path[k - 1, 0]
        previous_column = path[k - 1, 1]
        row_distance = abs(row - previous_row)
        column_distance = abs(column - previous_column)
        if max(row_distance, column_distance) != 1:
            return k, diagonal_moves
        if row_distance and column_distance:
            diagonal_moves += 1
            # This copy of the rule of `is_legal` works on the grid itself: loading the grid would
            # take most of the time.
            cuts_corner = grid[previous_row, column] or grid[row, previous_column]
            if diagonals == NO_DIAGONALS or (diagonals == NO_CORNER_CUTTING and cuts_corner):
                return k, diagonal_moves
    return -1, diagonal_moves


@kernel
def shortest_costs(sources: Ints, max_cost: Int, lattice: Lattice, scratch: Scratch) -> Int:
    """Write the costs of shortest paths from every cell to the nearest source, and their moves.

    This is Dijkstra's search with buckets one UNIT wide instead of a heap (Dinitz 1978). A move
    costs at least UNIT, so it leads out of its bucket, and no cell of the nearest bucket can become
    cheaper, whatever the order within the bucket. So when a cell of it is expanded, all nearer
    cells have their final costs, and those of its neighbours show which moves are optimal.

    A move is handled without branches, which the processor would often predict wrongly. A
    neighbour's cost is always stored and the neighbour always pushed, and the next push overwrites
    it unless its cost became smaller. A wall has the cost -1, which no cost is below.

    Args:
        sources: (n,) padded cells; those that are occupied are ignored.
        max_cost: the cost, in cells, at which the search stops; INFINITY for a search of all cells.
            Cells from this cost on have no moves, and perhaps too high a cost.
        lattice: of the map.
        scratch: with the map loaded in ``came_from``. Afterwards ``g`` (cells,) holds costs in 1 /
            UNIT, INFINITY without a path and -1 in walls; ``came_from`` (cells,) holds bit sets, in
            which bit k is set if move k begins a shortest path from the cell to a source.

    Returns:
        EXACT, or TOO_LONG where the search stopped at a path that is too long for exact costs.
    """
    optimal_moves = scratch.came_from
    costs = scratch.g
    # The cells of the current bucket, and those pushed for later ones. There is room for both,
    # because each neighbour pushes a cell at most once.
    bucket_cells = scratch.pushed
    later_cells = scratch.links
    for k in range(lattice.cells):
        costs[k] = INFINITY if optimal_moves[k] == UNSEEN else -1
        optimal_moves[k] = 0
    bucket_size = _ZERO
    for source in sources:
        if costs[source] == INFINITY:  # The source is free, and no repetition of an earlier one.
            bucket_cells[bucket_size] = source
            bucket_size += _ONE
            costs[source] = 0
    stride = np.uint64(lattice.stride)
    may_cut = lattice.diagonals == CORNER_CUTTING
    bucket = 0
    while bucket_size and bucket < max_cost:
        if bucket >= MAX_PATH_COST:
            return TOO_LONG
        later_size = _ZERO
        while bucket_size:
            bucket_size -= _ONE
            cell = np.uint64(bucket_cells[bucket_size])
            cost = costs[cell]
            buckets_ahead = (cost >> UNIT_BITS) - bucket
            if buckets_ahead:
                # Either a diagonal move led to the bucket after the next one, so that the cell
                # waits; or the cell was pushed again with a smaller cost and has been expanded.
                later_cells[later_size] = cell
                later_size += _ONE if buckets_ahead > 0 else _ZERO
                continue
            moves: Int = 0
            new_cost = cost + UNIT
            straight_neighbours = (cell - stride, cell + _ONE, cell + stride, cell - _ONE)
            for move, neighbour in enumerate(straight_neighbours):
                old_cost = costs[neighbour]
                moves |= np.int64(old_cost + UNIT == cost) << move
                costs[neighbour] = min(new_cost, old_cost)
                later_cells[later_size] = neighbour
                later_size += _ONE if new_cost < old_cost else _ZERO
            if lattice.diagonals:
                # This copy of the corner rule of `is_legal` has no branches.
                north_free = may_cut | (costs[cell - stride] >= 0)
                east_free = may_cut | (costs[cell + _ONE] >= 0)
                south_free = may_cut | (costs[cell + stride] >= 0)
                west_free = may_cut | (costs[cell - _ONE] >= 0)
                new_cost = cost + lattice.diagonal_cost
                for move, neighbour, is_allowed in (
                    (4, cell - stride + _ONE, north_free & east_free),
                    (5, cell + stride + _ONE, south_free & east_free),
                    (6, cell + stride - _ONE, south_free & west_free),
                    (7, cell - stride - _ONE, north_free & west_free),
                ):
                    old_cost = costs[neighbour]
                    is_optimal = is_allowed & (old_cost + lattice.diagonal_cost == cost)
                    moves |= np.int64(is_optimal) << move
                    is_cheaper = is_allowed & (new_cost < old_cost)
                    costs[neighbour] = new_cost if is_cheaper else old_cost
                    later_cells[later_size] = neighbour
                    later_size += _ONE if is_cheaper else _ZERO
            optimal_moves[cell] = moves
        bucket_cells, later_cells = later_cells, bucket_cells
        bucket_size = later_size
        bucket += 1
    return EXACT
