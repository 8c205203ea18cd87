"""The search kernels: BFS, two A*, shortest costs, on flat grids with a wall around them.

The order is part of the data (docs/format.md): BFS is first in, first out; A* pops the least f, among equal f the
most recently pushed; neighbours come as N, E, S, W, NE, SE, SW, NW; a cell's parent changes only for a smaller g.

Inside, a grid is a flat array with a wall around it, so that no step needs a bounds check: cell (row, col) of a map
with W columns stands at ``(row + 1) * (W + 2) + col + 1``.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from mapdata.arrays import Bytes, Ints, UInt32s
from mapdata.jit import Int, inlined, kernel
from mapdata.search.lattice import (
    _COLUMN_PART,
    _ONE,
    _ROW_PART,
    ASTAR,
    BFS,
    CLOSED,
    FAR,
    ROOT,
    STEPS,
    UNIT,
    UNIT_BITS,
    UNSEEN,
    WALL,
    estimate,
    load,
    parts,
)

# --- kernels: one search on a padded grid ---------------------------------------------------------------------------


@kernel
def flood(came: Bytes, queue: UInt32s, stride: Int, start: Int, targets: Ints, diagonals: Int) -> Int:
    """Breadth-first search from ``start`` until all ``targets`` (if any) are seen; return how many cells are in
    ``queue``.

    ``came`` holds WALL and UNSEEN; seen cells get the code of the move that led there. The order of ``queue`` is the
    order in which cells are taken; the last level may be longer than the search for one target needs.
    """
    p, head, tail, level = np.uint64(stride), np.uint64(0), _ONE, 0
    queue[0] = start
    came[start] = ROOT
    while head < tail:
        end = tail
        while head < end:
            c = np.uint64(queue[head])
            head += _ONE
            tail = _see(came, queue, tail, c - p, 0)
            tail = _see(came, queue, tail, c + _ONE, 1)
            tail = _see(came, queue, tail, c + p, 2)
            tail = _see(came, queue, tail, c - _ONE, 3)
            if diagonals:
                n, e = came[c - p] != WALL, came[c + _ONE] != WALL
                s, w = came[c + p] != WALL, came[c - _ONE] != WALL
                cut = diagonals == 2
                if cut or (n and e):
                    tail = _see(came, queue, tail, c - p + _ONE, 4)
                if cut or (s and e):
                    tail = _see(came, queue, tail, c + p + _ONE, 5)
                if cut or (s and w):
                    tail = _see(came, queue, tail, c + p - _ONE, 6)
                if cut or (n and w):
                    tail = _see(came, queue, tail, c - p - _ONE, 7)
        level += 1
        if level & 7 == 0 and len(targets) and _all_seen(came, targets):
            break
    return np.int64(tail)


@inlined
def _see(came: Bytes, queue: UInt32s, tail: np.uint64, cell: np.uint64, move: Int) -> np.uint64:
    """Append ``cell`` to the queue if it is unseen. Without a branch: the store is always made, the tail moves or
    not.
    """
    before = came[cell]
    fresh = before == UNSEEN
    queue[tail] = cell
    came[cell] = np.uint8(move) if fresh else before
    return tail + np.uint64(fresh)


@inlined
def _all_seen(came: Bytes, targets: Ints) -> Int:
    for target in targets:  # noqa: SIM110  (numba has no all() over a generator)
        if came[target] == UNSEEN:
            return False
    return True


@kernel
def expansions_until(queue: UInt32s, count: Int, goal: Int) -> Int:
    """Return the number of cells that a search takes from ``queue`` up to and including ``goal``, or ``count``."""
    for k in range(count):
        if queue[np.uint64(k)] == goal:
            return k + 1
    return count


@kernel
def astar_manhattan(
    came: Bytes, g: Ints, cell: UInt32s, below: UInt32s, stride: Int, start: Int, goal: Int
) -> tuple[Int, Int]:
    """A* with 4-connected moves and the Manhattan heuristic; return (iterations, pushes).

    A step changes f by 0 or 2, so two stacks replace the heap, and taking from the top of the nearer one is exactly the
    order of the format. Both stacks are lists through one log of pushes, ``cell[1:]`` and ``below``, where 0 ends a
    list. ``came`` holds WALL and UNSEEN, then the move that led to a cell, with CLOSED once it is taken; ``g`` needs
    no content.
    """
    p, target = np.uint32(stride), np.uint32(goal)
    goal_row = target // p
    goal_column = target - goal_row * p
    near, far, pushes, expanded = np.uint32(1), np.uint32(0), np.uint32(2), 0
    cell[1], below[1] = start, 0
    came[start], g[start] = 0, 0
    while True:
        if near == 0:
            if far == 0:
                return expanded, np.int64(pushes)
            near, far = far, near
        c = cell[np.uint64(near)]
        near = below[np.uint64(near)]
        if came[np.uint64(c)] & CLOSED:
            continue
        came[np.uint64(c)] |= CLOSED
        expanded += 1
        if c == target:
            return expanded, np.int64(pushes)
        longer = g[np.uint64(c)] + 1
        row = c // p
        column = c - row * p
        for move in range(4):
            if move == 0:
                to, closer = np.uint64(c - p), row > goal_row
            elif move == 1:
                to, closer = np.uint64(c + np.uint32(1)), column < goal_column
            elif move == 2:
                to, closer = np.uint64(c + p), row < goal_row
            else:
                to, closer = np.uint64(c - np.uint32(1)), column > goal_column
            before = came[to]
            if before == UNSEEN or (before < CLOSED and g[to] > longer):
                came[to], g[to] = move, longer
                cell[np.uint64(pushes)] = to
                below[np.uint64(pushes)] = near if closer else far
                near, far = (pushes, far) if closer else (near, pushes)
                pushes += np.uint32(1)


@kernel
def wipe(came: Bytes, cell: UInt32s, pushes: Int) -> None:
    """Make ``came`` fresh again after an A*."""
    for k in range(1, pushes):
        came[np.uint64(cell[np.uint64(k)])] = UNSEEN


@kernel
def astar_heap(
    came: Bytes,
    g: Ints,
    cell: UInt32s,
    f: Ints,
    heap: UInt32s,
    offsets: Ints,
    stride: Int,
    start: Int,
    goal: Int,
    diagonals: Int,
    step: Int,
) -> tuple[Int, Int]:
    """A* with 8-connected moves; return (iterations, pushes).

    A binary heap of push numbers, the least f on top and among equal f the latest push. ``cell[1:]`` and ``f`` are
    the log of pushes; ``came`` and ``g`` are as in `astar_manhattan`.
    """
    goal_row, goal_column = goal // stride, goal % stride
    came[start], g[start] = 0, 0
    cell[1], f[1], heap[0] = start, 0, 1
    pushes, size, expanded = 2, 1, 0
    while size:
        c = np.int64(cell[heap[0]])
        size -= 1
        last = np.int64(heap[size])
        key, at, child = f[last], 0, 1
        while child < size:  # the last entry goes to the top and down to its place
            best = np.int64(heap[child])
            if child + 1 < size:
                other = np.int64(heap[child + 1])
                if f[other] < f[best] or (f[other] == f[best] and other > best):
                    best, child = other, child + 1
            if key < f[best] or (key == f[best] and last > best):
                break
            heap[at] = best
            at, child = child, 2 * child + 1
        heap[at] = last
        if came[c] & CLOSED:
            continue
        came[c] |= CLOSED
        cost = g[c]
        expanded += 1
        if c == goal:
            break
        for move in range(8):
            to = c + offsets[move]
            if came[to] == WALL:
                continue
            if move >= 4 and diagonals == 1:
                side = c + offsets[_ROW_PART[move]], c + offsets[_COLUMN_PART[move]]
                if came[side[0]] == WALL or came[side[1]] == WALL:
                    continue
            longer = cost + (UNIT if move < 4 else step)
            before = came[to]
            if before == UNSEEN or (before < CLOSED and g[to] > longer):
                came[to], g[to] = move, longer
                key = longer + estimate(to // stride - goal_row, to % stride - goal_column, diagonals, step)
                cell[pushes], f[pushes] = to, key
                at = size
                while at and f[heap[(at - 1) >> 1]] >= key:  # up past entries of equal f: this is the latest push
                    heap[at] = heap[(at - 1) >> 1]
                    at = (at - 1) >> 1
                heap[at] = pushes
                pushes += 1
                size += 1
    return expanded, pushes


@kernel
def count_moves(came: Bytes, offsets: Ints, start: Int, goal: Int) -> tuple[Int, Int]:
    """Return how many straight and diagonal moves led from ``start`` to ``goal``."""
    straight: Int = 0
    diagonal: Int = 0
    c = goal
    while c != start:
        move = np.uint64(came[np.uint64(c)] & np.uint8(7))
        straight += move < 4
        diagonal += move >= 4
        c -= offsets[move]
    return straight, diagonal


@kernel
def write_moves(came: Bytes, offsets: Ints, start: Int, goal: Int, moves: Bytes, end: Int) -> None:
    """Write the moves that led from ``start`` to ``goal`` so that the last one stands before ``moves[end]``."""
    c = goal
    while c != start:
        move = np.uint64(came[np.uint64(c)] & np.uint8(7))
        end -= 1
        moves[end] = move
        c -= offsets[move]


@kernel
def write_cells(came: Bytes, offsets: Ints, stride: Int, start: Int, goal: Int, count: Int, path: Ints) -> None:
    """Write the ``count`` moves from ``start`` to ``goal`` as the cells of ``path``, (count + 1, 2)."""
    c = goal
    for k in range(count, -1, -1):
        path[k, 0], path[k, 1] = c // stride - 1, c % stride - 1
        if k:
            c -= offsets[np.uint64(came[np.uint64(c)] & np.uint8(7))]


@kernel
def with_capacity(moves: Bytes, used: Int, more: Int) -> Bytes:
    """Return ``moves``, or a larger copy of the ``used`` ones with room for ``more``."""
    if used + more <= len(moves):
        return moves
    larger = np.empty(2 * (used + more), np.uint8)
    larger[:used] = moves[:used]
    return larger


# --- kernels: whole grids -------------------------------------------------------------------------------------------

Scratch = tuple[Bytes, Ints, UInt32s, UInt32s, Ints]


@kernel
def scratch(cells: Int, search: Int, diagonals: Int) -> Scratch:
    """Return (came, g, cell, below, f) for searches on ``cells`` padded cells; what is not needed is empty."""
    # A cell is pushed at most once for each neighbour (on the two stacks: once for each), so the logs cannot overflow.
    pushes = cells if search == BFS else 2 * cells if diagonals == 0 else 8 * cells
    return (
        np.full(cells, WALL),
        np.empty(cells if search == ASTAR else 0, np.int64),
        np.empty(pushes + 2, np.uint32),
        np.empty(pushes + 2 if search == ASTAR else 0, np.uint32),
        np.empty(pushes + 2 if search == ASTAR and diagonals else 0, np.int64),
    )


@kernel
def find(
    stride: Int, start: Int, goal: Int, search: Int, diagonals: Int, step: Int, offsets: Ints, buffers: Scratch
) -> tuple[Int, Int, Int, Int]:
    """Search one problem on a grid that is loaded; return straight and diagonal moves or (-1, 0), iterations,
    pushes.
    """
    came, g, cell, below, f = buffers
    pushes = 0
    if search == BFS:
        target = np.empty(1, np.int64)
        target[0] = goal
        expanded = expansions_until(cell, flood(came, cell, stride, start, target, diagonals), goal)
    elif diagonals == 0:
        expanded, pushes = astar_manhattan(came, g, cell, below, stride, start, goal)
        if came[goal] != UNSEEN:
            return g[goal], 0, expanded, pushes
    else:
        expanded, pushes = astar_heap(came, g, cell, f, below, offsets, stride, start, goal, diagonals, step)
    if came[goal] == UNSEEN:
        return -1, 0, expanded, pushes
    straight, diagonal = count_moves(came, offsets, start, goal)
    return straight, diagonal, expanded, pushes


@kernel
def solve_one(
    grid: Bytes,
    start_row: Int,
    start_column: Int,
    goal_row: Int,
    goal_column: Int,
    search: Int,
    diagonals: Int,
    step: Int,
) -> tuple[Ints, Int, Int, Int]:
    """Search one problem; return its path, straight and diagonal moves, and iterations (0 when the problem is bad)."""
    stride = grid.shape[1] + 2
    cells = (grid.shape[0] + 2) * stride
    buffers = scratch(cells, search, diagonals)
    if not load(grid, buffers[0]) or grid[start_row, start_column] or grid[goal_row, goal_column]:
        return np.empty((0, 2), np.int64), -1, 0, 0
    offsets = STEPS[:, 0] * stride + STEPS[:, 1]
    start, goal = (start_row + 1) * stride + start_column + 1, (goal_row + 1) * stride + goal_column + 1
    straight, diagonal, expanded, _ = find(stride, start, goal, search, diagonals, step, offsets, buffers)
    path = np.empty((straight + diagonal + 1, 2), np.int64)
    if len(path):
        write_cells(buffers[0], offsets, stride, start, goal, straight + diagonal, path)
    return path, straight, diagonal, expanded


@kernel
def solve_all(
    grids: Bytes, starts: Ints, goals: Ints, search: Int, diagonals: Int, step: Int
) -> tuple[Ints, Ints, Int]:
    """Search each problem k from ``starts[k]`` to ``goals[k]`` on ``grids[k]`` (or on the one grid).

    Returns:
        cells (M, 2), all paths one after another; found (B, 4): straight and diagonal moves or (-1, 0), iterations,
        and the end of the path in ``cells``; the number of problems solved before one was found bad.
    """
    stride = grids.shape[2] + 2
    cells = (grids.shape[1] + 2) * stride
    offsets = STEPS[:, 0] * stride + STEPS[:, 1]
    buffers = scratch(cells, search, diagonals)
    came, cell = buffers[0], buffers[2]
    found = np.empty((len(starts), 4), np.int64)
    path = np.empty((64 * len(starts) + 64, 2), np.int64)
    used = 0
    for k in range(len(starts)):
        grid = grids[k if len(grids) > 1 else 0]
        stale = k == 0 or len(grids) > 1 or search == BFS
        if stale and not load(grid, came):
            return path, found, k
        if grid[starts[k, 0], starts[k, 1]] or grid[goals[k, 0], goals[k, 1]]:
            return path, found, k
        start = (starts[k, 0] + 1) * stride + starts[k, 1] + 1
        goal = (goals[k, 0] + 1) * stride + goals[k, 1] + 1
        straight, diagonal, expanded, pushes = find(stride, start, goal, search, diagonals, step, offsets, buffers)
        count = straight + diagonal
        if used + count + 1 > len(path):
            longer = np.empty((2 * (used + count + 1), 2), np.int64)
            longer[:used] = path[:used]
            path = longer
        if count >= 0:
            write_cells(came, offsets, stride, start, goal, count, path[used : used + count + 1])
        used += count + 1
        found[k, 0], found[k, 1], found[k, 2], found[k, 3] = straight, diagonal, expanded, used
        if search == ASTAR:
            wipe(came, cell, pushes)
    return path[:used], found, len(starts)


@kernel
def write_field(grid: Bytes, row: Int, column: Int, diagonals: Int, step: Int, out: npt.NDArray[np.float32]) -> Int:
    """Write the cost from every cell to (row, column) into ``out``, -1 where there is none; return whether grid is
    0/1.
    """
    rows, columns = grid.shape
    stride = columns + 2
    cells = (rows + 2) * stride
    offsets = STEPS[:, 0] * stride + STEPS[:, 1]
    goal = (row + 1) * stride + column + 1
    came, costs = np.full(cells, WALL), np.empty(cells, np.int64)
    good = load(grid, came)
    out[:, :] = -1
    if good and not grid[row, column]:
        log = log_size(cells, diagonals, step)
        queue, below = np.empty(log, np.uint32), np.empty(log, np.uint32)
        for k in range(shortest_costs(came, costs, queue, below, offsets, goal, diagonals, step)):
            cell = np.int64(queue[k])
            straight, diagonal = parts(costs[cell])
            out[cell // stride - 1, cell % stride - 1] = straight + diagonal * math.sqrt(2.0)
    return good


@kernel
def log_size(cells: Int, diagonals: Int, step: Int) -> Int:
    """Return how long the logs of `shortest_costs` must be."""
    return 8 * cells + 2 if diagonals and step != UNIT else cells + 1


@kernel
def shortest_costs(
    came: Bytes, costs: Ints, queue: UInt32s, below: UInt32s, offsets: Ints, source: Int, diagonals: Int, step: Int
) -> Int:
    """Write the cost of the shortest path from ``source`` to every cell into ``costs``, FAR where there is none.

    ``came`` is as `load` leaves it; ``queue`` and ``below`` are `log_size` long. Returns how many cells are reached;
    they stand in ``queue``, each once.
    """
    costs[:] = FAR
    if diagonals and step != UNIT:
        costs[source] = 0
        queue[1] = source
        return bucket_search(came, costs, queue, below, offsets, 1, diagonals, step)
    costs[source] = 0
    count = flood(came, queue, offsets[2], source, np.empty(0, np.int64), diagonals)
    for k in range(1, count):
        cell = np.int64(queue[k])
        costs[cell] = costs[cell - offsets[came[cell]]] + UNIT
    return count


@kernel
def bucket_search(
    came: Bytes, costs: Ints, cell: UInt32s, below: UInt32s, offsets: Ints, sources: Int, diagonals: Int, step: Int
) -> Int:
    """Write costs from the nearest of the sources ``cell[1:sources + 1]``, whose cost is 0 already.

    Buckets one UNIT wide, the shortest step (Dinitz 1978): what lies in the nearest bucket cannot become cheaper,
    whatever the order, and a step of sqrt(2) reaches at most two buckets ahead, so that three lists through one log
    replace a heap.
    """
    heads = np.zeros(3, np.int64)  # entry 0 ends a list
    heads[0] = sources
    for k in range(1, sources + 1):
        below[k] = k - 1
    pushes, bucket, waiting = sources + 1, 0, sources
    while waiting:
        entry = heads[bucket % 3]
        if entry == 0:
            bucket += 1
            continue
        heads[bucket % 3] = below[entry]
        waiting -= 1
        c = np.int64(cell[entry])
        cost = costs[c]
        if cost >> UNIT_BITS != bucket:
            continue
        for move in range(8 if diagonals else 4):
            to = c + offsets[move]
            if came[to] == WALL:
                continue
            longer = cost + (UNIT if move < 4 else step)
            if longer >= costs[to]:
                continue
            if move >= 4 and diagonals == 1:
                side = c + offsets[_ROW_PART[move]], c + offsets[_COLUMN_PART[move]]
                if came[side[0]] == WALL or came[side[1]] == WALL:
                    continue
            costs[to] = longer
            ahead = (longer >> UNIT_BITS) % 3
            cell[pushes], below[pushes], heads[ahead] = to, heads[ahead], pushes
            pushes += 1
            waiting += 1
    count = 0
    for k in range(len(costs)):
        if costs[k] != FAR:
            cell[count] = k
            count += 1
    return count
