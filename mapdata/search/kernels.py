"""The search kernels: BFS, two A*, and shortest costs from one cell to all.

How they order the cells is part of the data (docs/format.md): BFS is first in, first out; A* pops
the least f, among equal f the most recently pushed; neighbours come as N, E, S, W, NE, SE, SW, NW;
a cell's parent changes only for a smaller g.

A grid is a flat array with a wall around it, and a cell is its place in there
(`mapdata.search.lattice`). A search keeps one byte a cell, in ``came``: WALL, UNSEEN, ROOT, or the
move that led to the cell, 0 to 7, which gives its parent; A* adds CLOSED, 8, when it expands the
cell. So ``came[cell] < CLOSED`` means that the cell is in the open list.

Two habits of these kernels look odd and are for speed:

- Hot loops index by unsigned integers. numba lets a signed index count from the end, as Python
  does, and tests its sign at each access. (uint64 with int64 would give float64, hence constants
  like _ONE.)
- A push is written to a log that is never shortened, and links between its entries make the stacks,
  buckets and heaps. No entry moves or is changed when its cell gets a smaller g: the cell is pushed
  again, and the older entry is dropped when it is popped. The log also says which cells a search
  has touched, so `wipe` makes a grid ready for the next search without a pass over all of it.

What searches write to, `Scratch`, has room for the most pushes that there can be: up to 137 bytes a
cell. Only what a search touches becomes memory of the process, mostly 10 to 40 bytes for each cell
that it expands and 1 for each cell of the grid.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Float32s, Ints, UInt32s
from mapdata.jit import Int, inlined, kernel
from mapdata.movement import STEPS
from mapdata.search.lattice import (
    ASTAR,
    BFS,
    CLOSED,
    FAR,
    LONGEST,
    ROOT,
    UNIT,
    UNIT_BITS,
    UNSEEN,
    WALL,
    Lattice,
    Rule,
    Weights,
    cell_at,
    heuristic,
    in_cells,
    is_binary,
    is_legal,
    lattice_of,
    load,
    position,
)

_ZERO = np.uint64(0)
_ONE = np.uint64(1)
_MOVE = np.uint8(7)
"""The bits of ``came`` that hold the move."""

_SLICE_BITS = UNIT_BITS - 6
"""A bucket of `best_first` is a slice of f, 1/64 of a straight move wide."""

_SLICES = 256
"""So many buckets cover 4 straight moves: more than f grows by at once, 2 sqrt(2)."""

_TOO_LONG = (
    f"the grid has paths of {LONGEST} cells or more, for which costs are not exact: expected a "
    "coarser grid, or a search that counts moves (A* under 4-connectivity, BFS)"
)


class Scratch(NamedTuple):
    """What searches write to, one after another.

    Kernels take its arrays by name: to unpack it counts references of all five.

    Attributes:
        came: (cells,) uint8: WALL, UNSEEN, or the move that led to a cell.
        g: (cells,) cost of the best path to a cell so far; valid where ``came`` holds a move.
        pushed: (pushes,) the log: cells, in the order in which they were pushed.
        links: (pushes,) a heap of pushes, or for each push the next one of its list.
        f: (pushes,) priorities of the pushes, or of those in the heap; empty where a search needs
            none.
    """

    came: Bytes
    g: Ints
    pushed: UInt32s
    links: UInt32s
    f: Ints


# --- kernels: one search on a padded grid -------------------------------------------------------


@kernel
def flood(start: Int, targets: Ints, lattice: Lattice, buffers: Scratch) -> Int:
    """Breadth-first search from ``start`` until all ``targets`` (if any) are seen.

    Returns how many cells are in ``pushed``, in the order in which they are expanded; the last
    level may be longer than the search for one target needs.
    """
    came = buffers.came
    queue = buffers.pushed
    stride = np.uint64(lattice.stride)
    head = _ZERO
    tail = _ONE
    level = 0
    queue[0] = start
    came[start] = ROOT
    while head < tail:
        # Level by level, so that targets are looked for between levels and not at each cell.
        level_end = tail
        while head < level_end:
            cell = np.uint64(queue[head])
            head += _ONE
            tail = _enqueue(came, queue, tail, cell - stride, 0)
            tail = _enqueue(came, queue, tail, cell + _ONE, 1)
            tail = _enqueue(came, queue, tail, cell + stride, 2)
            tail = _enqueue(came, queue, tail, cell - _ONE, 3)
            if lattice.diagonals:
                # The corner rule of `is_legal`, with each neighbour read once: a third of the time.
                north = came[cell - stride] != WALL
                east = came[cell + _ONE] != WALL
                south = came[cell + stride] != WALL
                west = came[cell - _ONE] != WALL
                cut = lattice.diagonals == 2
                if cut or (north and east):
                    tail = _enqueue(came, queue, tail, cell - stride + _ONE, 4)
                if cut or (south and east):
                    tail = _enqueue(came, queue, tail, cell + stride + _ONE, 5)
                if cut or (south and west):
                    tail = _enqueue(came, queue, tail, cell + stride - _ONE, 6)
                if cut or (north and west):
                    tail = _enqueue(came, queue, tail, cell - stride - _ONE, 7)
        level += 1
        # After every eighth level only: a few levels too many cost less than to look each time.
        if level & 7 == 0 and len(targets) and _all_seen(came, targets):
            break
    return np.int64(tail)


@inlined
def _enqueue(came: Bytes, queue: UInt32s, tail: np.uint64, cell: np.uint64, move: Int) -> np.uint64:
    """Append ``cell`` to the queue if it is unseen; return the new tail.

    Without a branch, which the processor would often guess wrong: the cell is always stored, and
    the next one overwrites it unless the tail moves on.
    """
    before = came[cell]
    unseen = before == UNSEEN
    queue[tail] = cell
    came[cell] = np.uint8(move) if unseen else before
    return tail + (_ONE if unseen else _ZERO)


@inlined
def _all_seen(came: Bytes, targets: Ints) -> Int:
    for target in targets:  # noqa: SIM110  (numba has no all() over a generator)
        if came[target] == UNSEEN:
            return False
    return True


@kernel
def expansions_until(queue: UInt32s, count: Int, goal: Int) -> Int:
    """Return how many of the ``count`` cells in ``queue`` are expanded up to ``goal``, or all."""
    for k in range(count):
        if queue[np.uint64(k)] == goal:
            return k + 1
    return count


@kernel
def astar_manhattan(start: Int, goal: Int, lattice: Lattice, buffers: Scratch) -> tuple[Int, Int]:
    """A* with 4-connected moves and the Manhattan heuristic; return (iterations, pushes).

    Two stacks are the open list, and no heap is needed. A step adds 1 to g and changes h by 1, so f
    stays as it is (a step closer to the goal) or grows by 2 (a step away). While cells of one f are
    expanded, the open list holds only that f (``near``) and f + 2 (``far``); once ``near`` is
    empty, ``far`` takes its place. Within one f the top of the stack is the latest push, so the
    order is exactly that of a heap which prefers the latest push among equal f.

    Both stacks are lists through the log: ``near`` and ``far`` are the numbers of their top pushes,
    ``links`` leads from a push to the one below it. Push 0 does not exist, so that a link of 0 ends
    a list. ``g`` counts moves and needs no content before.
    """
    came = buffers.came
    g = buffers.g
    pushed = buffers.pushed
    links = buffers.links
    # 32 bits hold every cell, and are divided faster than 64.
    stride = np.uint32(lattice.stride)
    target = np.uint32(goal)
    goal_row = target // stride
    goal_column = target - goal_row * stride
    near = np.uint32(1)
    far = np.uint32(0)
    pushes = np.uint32(2)
    expansions = 0
    pushed[1] = start
    links[1] = 0
    came[start] = 0  # any move: a path is traced back only as far as its start
    g[start] = 0
    while True:
        if near == 0:
            if far == 0:
                return expansions, np.int64(pushes)
            near = far
            far = np.uint32(0)
        cell = pushed[near]
        near = links[near]
        # It was pushed again with a smaller g, and so a smaller f, and expanded then.
        if came[cell] & CLOSED:
            continue
        came[cell] |= CLOSED
        expansions += 1
        if cell == target:
            return expansions, np.int64(pushes)
        tentative = g[cell] + 1
        row = cell // stride
        column = cell - row * stride
        for move in range(4):
            if move == 0:
                to = cell - stride
                closer = row > goal_row
            elif move == 1:
                to = cell + np.uint32(1)
                closer = column < goal_column
            elif move == 2:
                to = cell + stride
                closer = row < goal_row
            else:
                to = cell - np.uint32(1)
                closer = column > goal_column
            before = came[to]
            if before == UNSEEN or (before < CLOSED and g[to] > tentative):
                came[to] = move
                g[to] = tentative
                pushed[pushes] = to
                if closer:
                    links[pushes] = near
                    near = pushes
                else:
                    links[pushes] = far
                    far = pushes
                pushes += np.uint32(1)


@inlined
def wipe(buffers: Scratch, pushes: Int) -> None:
    """Make ``came`` fresh again after an A*: every cell that it changed is in the log."""
    came = buffers.came
    pushed = buffers.pushed
    for k in range(1, pushes):
        came[np.uint64(pushed[np.uint64(k)])] = UNSEEN


@kernel
def best_first(
    start: Int, goal: Int, search: Weights, lattice: Lattice, buffers: Scratch
) -> tuple[Int, Int]:
    """A* with any moves and weights; return (iterations, pushes). ``g`` is in 1 / UNIT.

    With weights, f may fall, and the open list is the textbook's binary heap: ``links``, of the
    numbers of pushes, and ``f``, their priorities.

    Without, f never falls, and as in `astar_manhattan` no heap is needed. A move adds one of few
    values to f: 0, 2 - sqrt(2), 2 sqrt(2) - 2, sqrt(2), 2 or 2 sqrt(2); where diagonals cost 1, 0,
    1 or 2. So a push goes

    - on top of ``near``, the stack of pushes whose f is being expanded, if it has that f: being the
      latest, it is the next to be expanded;
    - else on top of the bucket of its f, one of a ring. A bucket is the stack of a slice of f, thin
      enough that such a push never belongs to the slice that is being expanded.

    Once ``near`` is empty, those of the least f in the nearest bucket become it, in their order.
    Mostly they are the whole bucket, since few values of f are closer than a slice is wide.
    """
    came = buffers.came
    g = buffers.g
    pushed = buffers.pushed
    links = buffers.links
    f = buffers.f
    g_weight, h_weight = search
    goal_row, goal_column = position(goal, lattice)
    row, column = position(start, lattice)
    least = heuristic(row - goal_row, column - goal_column, lattice)  # the f of ``near``
    slot = np.uint8(least >> _SLICE_BITS)  # the bucket of that f: 8 bits go around the ring
    buckets = np.zeros(_SLICES, np.uint32)
    size = 0  # of the heap
    came[start] = 0  # any move: a path is traced back only as far as its start
    g[start] = 0
    pushed[1] = start
    links[1] = 0
    near = np.uint32(1)
    pushes = np.uint32(2)
    expansions = 0
    while True:
        if near:
            cell = pushed[near]
            near = links[near]
        elif search != ASTAR:
            if size == 0:
                break
            cell = pushed[np.uint64(links[0])]
            size -= 1
            _remove_top(links, f, size)
        else:
            empty = 0
            while empty < _SLICES and buckets[slot] == 0:
                slot = np.uint8(slot + 1)
                empty += 1
            if empty == _SLICES:
                break
            near, buckets[slot], least = _split(buckets[slot], links, f)
            continue
        # It was pushed again with a smaller g, and so a smaller f, and expanded then.
        if came[cell] & CLOSED:
            continue
        came[cell] |= CLOSED
        expansions += 1
        if cell == goal:
            break
        cost = g[cell]
        if cost >= LONGEST * UNIT:
            raise ValueError(_TOO_LONG)
        row, column = position(cell, lattice)
        for move in range(len(lattice.offsets)):
            to = np.uint64(cell + lattice.offsets[move])
            tentative = cost + (UNIT if move < 4 else lattice.step)
            before = came[to]
            # First what most neighbours fail: only the corners of the others need a look.
            if before == WALL or (before != UNSEEN and g[to] <= tentative):
                continue
            if not is_legal(came, cell, move, lattice):
                continue
            if before != UNSEEN and before >= CLOSED:
                # Expanded before a shorter way to it was found, which happens under other weights
                # than those of A*: it takes the shorter way, and is not expanded again.
                came[to] = move | CLOSED
                g[to] = tentative
                continue
            rows = row + STEPS[move, 0] - goal_row
            columns = column + STEPS[move, 1] - goal_column
            h = heuristic(rows, columns, lattice)
            came[to] = move
            g[to] = tentative
            pushed[pushes] = to
            if search != ASTAR:
                if h_weight != 1:  # a float would round large h
                    h = np.int64(h_weight * h)
                _insert(links, f, size, pushes, g_weight * tentative + h)
                size += 1
            elif tentative + h == least:
                links[pushes] = near
                near = pushes
            else:
                f[pushes] = tentative + h
                ahead = np.uint8((tentative + h) >> _SLICE_BITS)
                links[pushes] = buckets[ahead]
                buckets[ahead] = pushes
            pushes += np.uint32(1)
    return expansions, np.int64(pushes)


@inlined
def _split(top: Int, links: UInt32s, f: Ints) -> tuple[Int, Int, Int]:
    """Split the stack below push ``top`` into pushes of the least f and others, both in order.

    Returns the top of each, 0 if it is empty, and the least f.
    """
    # Turned upside down first, so that moving push by push restores the order.
    least = f[top]
    bottom = np.uint32(0)
    while top:
        below = links[top]
        least = min(least, f[top])
        links[top] = bottom
        bottom = top
        top = below
    near = np.uint32(0)
    rest = np.uint32(0)
    while bottom:
        above = links[bottom]
        if f[bottom] == least:
            links[bottom] = near
            near = bottom
        else:
            links[bottom] = rest
            rest = bottom
        bottom = above
    return near, rest, least


@inlined
def _remove_top(heap: UInt32s, f: Ints, size: Int) -> None:
    """Remove the top of a heap, in which ``size`` entries are left.

    The last entry goes to the top and sinks to its place. An entry is above another if its f is
    less, or equal and its push later.
    """
    last = heap[size]
    key = f[size]
    at = 0
    child = 1
    while child < size:
        right = child + 1
        if right < size and (
            f[right] < f[child] or (f[right] == f[child] and heap[right] > heap[child])
        ):
            child = right
        if key < f[child] or (key == f[child] and last > heap[child]):
            break
        f[at] = f[child]
        heap[at] = heap[child]
        at = child
        child = 2 * child + 1
    f[at] = key
    heap[at] = last


@inlined
def _insert(heap: UInt32s, f: Ints, size: Int, push: Int, key: Int) -> None:
    """Insert the latest ``push`` into a heap of ``size`` entries: it rises past equal f, too."""
    at = size
    while at:
        above = (at - 1) >> 1
        if f[above] < key:
            break
        f[at] = f[above]
        heap[at] = heap[above]
        at = above
    f[at] = key
    heap[at] = push


@kernel
def count_moves(came: Bytes, start: Int, goal: Int, lattice: Lattice) -> tuple[Int, Int]:
    """Return how many straight and diagonal moves led from ``start`` to ``goal``, or (-1, 0)."""
    if came[goal] == UNSEEN:
        return -1, 0
    straight: Int = 0
    diagonal: Int = 0
    cell = goal
    while cell != start:
        move = np.uint64(came[np.uint64(cell)] & _MOVE)
        if move < 4:
            straight += 1
        else:
            diagonal += 1
        cell -= lattice.offsets[move]
    return straight, diagonal


@kernel
def write_moves(
    came: Bytes, goal: Int, length: Int, lattice: Lattice, moves: Bytes, used: Int
) -> None:
    """Write the ``length`` moves of a path that ends at ``goal`` to ``moves[used:]``."""
    cell = goal
    for k in range(used + length - 1, used - 1, -1):
        move = np.uint64(came[np.uint64(cell)] & _MOVE)
        moves[k] = move
        cell -= lattice.offsets[move]


@kernel
def write_cells(came: Bytes, goal: Int, lattice: Lattice, path: Ints) -> None:
    """Write the cells of a path that ends at ``goal``, as many as ``path`` (k, 2) holds."""
    cell = goal
    for k in range(len(path) - 1, -1, -1):
        path[k, 0], path[k, 1] = position(cell, lattice)
        if k:
            cell -= lattice.offsets[np.uint64(came[np.uint64(cell)] & _MOVE)]


@kernel
def with_capacity(cells: Ints, used: Int, more: Int) -> Ints:
    """Return ``cells`` (n, 2), or a larger copy of the ``used`` ones with room for ``more``."""
    if used + more <= len(cells):
        return cells
    larger = np.empty((2 * (used + more), 2), np.int64)
    for k in range(used):
        # To assign whole rows would compile numba's error message about shapes, for two seconds.
        larger[k, 0] = cells[k, 0]
        larger[k, 1] = cells[k, 1]
    return larger


# --- kernels: whole grids -----------------------------------------------------------------------


def plain_scratch_in(memory: Bytes, lattice: Lattice) -> Scratch:
    """Return what searches write to, in ``memory``: with room for as many pushes as fit in.

    Nothing is written yet: `load` makes ``came`` ready, and the rest needs no content.
    """
    cells = lattice.cells
    pushes = (len(memory) - 9 * cells) // 16
    # The widest items come first, so that all are aligned.
    lists = 8 * (cells + pushes)
    came = lists + 8 * pushes
    wide = memory[:lists].view(np.int64)
    narrow = memory[lists:came].view(np.uint32)
    return Scratch(
        memory[came : came + cells], wide[:cells], narrow[:pushes], narrow[pushes:], wide[cells:]
    )


scratch_in = kernel(plain_scratch_in)
"""The same for kernels; `plain_scratch_in` needs no compiling."""


@kernel
def scratch(search: Weights, lattice: Lattice) -> Scratch:
    """Return what `find` writes to; for `shortest_costs`, that of ASTAR.

    It is one block: of several, malloc would give some back to the system after each call.
    """
    # A cell is pushed at most once for each neighbour; 32 bytes are for the start, and for the
    # entry 0 that does not exist.
    pushes = 1 if search == BFS else len(lattice.offsets)
    return scratch_in(np.empty((9 + 16 * pushes) * lattice.cells + 32, np.uint8), lattice)


def plain_scratch(lattice: Lattice) -> Scratch:
    """Return what any search writes to, as `scratch` does, without compiling."""
    pushes = len(lattice.offsets)
    return plain_scratch_in(np.empty((9 + 16 * pushes) * lattice.cells + 32, np.uint8), lattice)


@kernel
def find(
    start: Int, goal: Int, search: Weights, lattice: Lattice, buffers: Scratch
) -> tuple[Int, Int, Int, Int]:
    """Search one problem on a grid that is loaded.

    Returns straight and diagonal moves or (-1, 0), iterations, pushes. BFS, which does not weigh
    moves, counts all as straight. No cell is expanded if an end is occupied.
    """
    if buffers.came[start] == WALL or buffers.came[goal] == WALL:
        return -1, 0, 0, 1  # nothing is pushed beside the entry 0
    pushes = np.int64(0)
    if search == BFS:
        count = flood(start, np.full(1, goal), lattice, buffers)
        expansions = expansions_until(buffers.pushed, count, goal)
    elif search == ASTAR and lattice.diagonals == 0:
        expansions, pushes = astar_manhattan(start, goal, lattice, buffers)
    else:
        expansions, pushes = best_first(start, goal, search, lattice, buffers)
    straight, diagonal = count_moves(buffers.came, start, goal, lattice)
    if search == BFS:
        return straight + diagonal, 0, expansions, pushes
    return straight, diagonal, expansions, pushes


@kernel
def solve_one(
    grid: Bytes,
    start_row: Int,
    start_column: Int,
    goal_row: Int,
    goal_column: Int,
    search: Weights,
    rule: Rule,
    memory: Bytes,
) -> tuple[Ints, Int, Int, Int]:
    """Search one problem; return its path, straight and diagonal moves, and iterations.

    The iterations are 0 if ``grid`` holds other values than 0 and 1, or if an end is occupied.
    """
    lattice = lattice_of(grid.shape, rule)
    buffers = scratch_in(memory, lattice)
    bad = not load(grid, buffers.came)
    if bad or grid[start_row, start_column] or grid[goal_row, goal_column]:
        return np.empty((0, 2), np.int64), -1, 0, 0
    start = cell_at(start_row, start_column, lattice)
    goal = cell_at(goal_row, goal_column, lattice)
    straight, diagonal, expansions, _ = find(start, goal, search, lattice, buffers)
    path = np.empty((straight + diagonal + 1, 2), np.int64)
    write_cells(buffers.came, goal, lattice, path)
    return path, straight, diagonal, expansions


@kernel
def solve_all(
    grids: Bytes, starts: Ints, goals: Ints, most: Int, search: Weights, rule: Rule, memory: Bytes
) -> tuple[Ints, Ints, Int]:
    """Search each problem k from ``starts[k]`` to ``goals[k]`` on ``grids[k]``, or on the one grid.

    Returns:
        cells (M, 2), all paths one after another; found (B, 4): straight and diagonal moves or (-1,
        0), iterations, and the end of the path in ``cells``; the number of problems solved before
        one was found bad: an end outside or of a value above ``most``, other values than 0 and 1.
    """
    lattice = lattice_of(grids.shape[1:], rule)
    buffers = scratch_in(memory, lattice)
    found = np.empty((len(starts), 4), np.int64)
    path = np.empty((64 * len(starts) + 64, 2), np.int64)
    used = 0
    for k in range(len(starts)):
        grid = grids[k if len(grids) > 1 else 0]
        # A* wipes what it wrote. BFS touches most of a grid, and copying it anew costs less.
        stale = k == 0 or len(grids) > 1 or search == BFS
        if stale and not load(grid, buffers.came):
            return path, found, k
        if not (is_inside(grid, starts[k], most) and is_inside(grid, goals[k], most)):
            return path, found, k
        start = cell_at(starts[k, 0], starts[k, 1], lattice)
        goal = cell_at(goals[k, 0], goals[k, 1], lattice)
        straight, diagonal, expansions, pushes = find(start, goal, search, lattice, buffers)
        length = straight + diagonal + 1  # no path: -1 + 0 + 1 cells
        path = with_capacity(path, used, length)
        write_cells(buffers.came, goal, lattice, path[used : used + length])
        used += length
        found[k, 0] = straight
        found[k, 1] = diagonal
        found[k, 2] = expansions
        found[k, 3] = used
        if search != BFS:
            wipe(buffers, pushes)
    return path[:used], found, len(starts)


@inlined
def is_inside(grid: Bytes, cell: Ints, most: Int) -> Int:
    """Return whether ``cell`` (row, col) is inside ``grid``, with a value of at most ``most``."""
    row = cell[0]  # to unpack an array takes long to compile
    column = cell[1]
    return 0 <= row < grid.shape[0] and 0 <= column < grid.shape[1] and grid[row, column] <= most


@kernel
def narrow(values: Any, out: Bytes) -> Int:
    """Copy flat ``values``, integers or floats, into ``out``; return whether all are 0 or 1."""
    good = True
    for k in range(len(values)):
        value = values[np.uint64(k)]
        out[np.uint64(k)] = value != 0
        good &= (value == 0) | (value == 1)  # without a branch: by vector instructions
    return good


@kernel
def first_bad_cell(grid: Bytes, path: Ints, diagonals: Int) -> tuple[Int, Int]:
    """Return where ``path`` breaks the rule, and how many of its moves are diagonal.

    The first is the least k whose cell is not free or not one move from cell k - 1; -1 when all is
    well; -2 when ``grid`` is not of 0 and 1.
    """
    diagonal = 0
    if not is_binary(grid):
        return -2, 0
    for k in range(len(path)):
        if not is_inside(grid, path[k], 0):
            return k, diagonal
        if k == 0:
            continue
        row = path[k, 0]
        column = path[k, 1]
        row_before = path[k - 1, 0]
        column_before = path[k - 1, 1]
        rows = abs(row - row_before)
        columns = abs(column - column_before)
        if max(rows, columns) != 1:
            return k, diagonal
        if rows and columns:
            diagonal += 1
            # The rule of `is_legal` on the grid itself: to load it would take most of the time.
            cuts = grid[row_before, column] or grid[row, column_before]
            if diagonals == 0 or (diagonals == 1 and cuts):
                return k, diagonal
    return -1, diagonal


@kernel
def write_field(
    grid: Bytes, row: Int, column: Int, rule: Rule, memory: Bytes, out: Float32s
) -> Int:
    """Write the cost from every cell to (row, column) into ``out``, -1 where there is no path.

    Returns whether ``grid`` is of 0 and 1.
    """
    lattice = lattice_of(grid.shape, rule)
    buffers = scratch_in(memory, lattice)
    if not load(grid, buffers.came):
        return False
    source = np.full(1, cell_at(row, column, lattice))
    shortest_costs(source, FAR, lattice, buffers)
    for k in range(grid.shape[0]):
        for j in range(grid.shape[1]):
            out[k, j] = cost_at(cell_at(k, j, lattice), buffers)
    return True


@inlined
def cost_at(cell: Int, buffers: Scratch) -> float:
    """Return what `shortest_costs` found for a cell, in cells; -1 without a path."""
    cost = buffers.g[cell]
    return in_cells(cost) if 0 <= cost < FAR else -1.0


@kernel
def shortest_costs(sources: Ints, most: Int, lattice: Lattice, buffers: Scratch) -> None:
    """Write the costs of shortest paths from every cell to the nearest source, and their moves.

    ``came`` is as `load` leaves it. The costs go to ``g``, FAR without a path and -1 in walls; the
    moves that start a shortest path go to ``came``, as bit sets. The search stops at the cost
    ``most``, in cells (FAR: never): cells from there on have no moves, and perhaps too high a cost.

    Dijkstra's search with buckets one UNIT wide instead of a heap (Dinitz 1978). A step costs at
    least UNIT, so it leads out of its bucket, and what lies in the nearest bucket cannot become
    cheaper, whatever the order within. So once a cell of it is expanded, all nearer cells have
    their costs, and the moves that lead to them tell which are optimal.

    Its steps go without branches, which the processor would often guess wrong: a neighbour's cost
    is always stored and the neighbour always pushed, and the next push overwrites it unless it was
    cheaper this way. A wall costs -1, so that nothing is.
    """
    came = buffers.came
    costs = buffers.g
    # The cells of a bucket, and those pushed meanwhile: each neighbour pushes a cell at most once.
    here = buffers.pushed
    ahead = buffers.links
    for k in range(lattice.cells):
        costs[k] = FAR if came[k] == UNSEEN else -1
        came[k] = 0
    waiting = _ZERO
    for source in sources:
        if costs[source] == FAR:  # not in a wall
            here[waiting] = source
            waiting += _ONE
            costs[source] = 0
    stride = np.uint64(lattice.stride)
    cut = lattice.diagonals == 2
    bucket = 0
    while waiting and bucket < most:
        if bucket >= LONGEST:
            raise ValueError(_TOO_LONG)
        pushed = _ZERO
        while waiting:
            waiting -= _ONE
            cell = np.uint64(here[waiting])
            cost = costs[cell]
            distance = (cost >> UNIT_BITS) - bucket
            if distance:
                # A step of sqrt(2) may end two buckets ahead; or the cell was pushed again with a
                # smaller cost, and has been expanded.
                ahead[pushed] = cell
                pushed += _ONE if distance > 0 else _ZERO
                continue
            moves: Int = 0
            there = cost + UNIT
            for move, to in enumerate((cell - stride, cell + _ONE, cell + stride, cell - _ONE)):
                before = costs[to]
                moves |= np.int64(before + UNIT == cost) << move
                costs[to] = min(there, before)
                ahead[pushed] = to
                pushed += _ONE if there < before else _ZERO
            if lattice.diagonals:
                # The corner rule of `is_legal`, without its branches.
                north = cut | (costs[cell - stride] >= 0)
                east = cut | (costs[cell + _ONE] >= 0)
                south = cut | (costs[cell + stride] >= 0)
                west = cut | (costs[cell - _ONE] >= 0)
                there = cost + lattice.step
                for move, to, legal in (
                    (4, cell - stride + _ONE, north & east),
                    (5, cell + stride + _ONE, south & east),
                    (6, cell + stride - _ONE, south & west),
                    (7, cell - stride - _ONE, north & west),
                ):
                    before = costs[to]
                    moves |= np.int64(legal & (before + lattice.step == cost)) << move
                    cheaper = legal & (there < before)
                    costs[to] = there if cheaper else before
                    ahead[pushed] = to
                    pushed += _ONE if cheaper else _ZERO
            came[cell] = moves
        here, ahead = ahead, here
        waiting = pushed
        bucket += 1
