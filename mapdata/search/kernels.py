"""The search kernels: BFS, two A*, shortest costs, on flat grids with a wall around them.

The order is part of the data (docs/format.md): BFS is first in, first out; A* pops the least f,
among equal f the most recently pushed; neighbours come as N, E, S, W, NE, SE, SW, NW; a cell's
parent changes only for a smaller g.

Inside, a grid is a flat array with a wall around it, and cells are numbers
(`mapdata.search.lattice`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Float32s, Ints, UInt32s
from mapdata.jit import Int, inlined, kernel
from mapdata.search.lattice import (
    ASTAR,
    BFS,
    CLOSED,
    COSTS,
    FAR,
    ROOT,
    STEPS,
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
    is_legal,
    lattice_of,
    load,
    position,
)

_ONE = np.uint64(1)


class Scratch(NamedTuple):
    """What searches write to, one after another.

    Kernels take its arrays by name: to unpack it counts references of all five.

    Attributes:
        came: (cells,) WALL, UNSEEN, or the move that led to a cell, with CLOSED once that is
            expanded.
        g: (cells,) cost of the best path to a cell so far.
        pushed: (pushes,) cells, in the order in which they were pushed.
        links: (pushes,) a heap of pushes, or lists of them: the next push of each.
        f: (pushes,) priorities of the pushes in the heap; empty where a search has none.
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
    p = np.uint64(lattice.stride)
    head = np.uint64(0)
    tail = _ONE
    level = 0
    queue[0] = start
    came[start] = ROOT
    while head < tail:
        end = tail
        while head < end:  # one level
            c = np.uint64(queue[head])
            head += _ONE
            tail = _see(came, queue, tail, c - p, 0)
            tail = _see(came, queue, tail, c + _ONE, 1)
            tail = _see(came, queue, tail, c + p, 2)
            tail = _see(came, queue, tail, c - _ONE, 3)
            if lattice.diagonals:
                # The corner rule of `is_legal`, with each neighbour read once: a third of the time.
                n, e = came[c - p] != WALL, came[c + _ONE] != WALL
                s, w = came[c + p] != WALL, came[c - _ONE] != WALL
                cut = lattice.diagonals == 2
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
    """Append ``cell`` if it is unseen. Without a branch: it is always stored, the tail moves or
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
    """Return how many of the ``count`` cells of ``queue`` are expanded until ``goal`` is, or
    all.
    """
    for k in range(count):
        if queue[np.uint64(k)] == goal:
            return k + 1
    return count


@inlined
def astar_manhattan(start: Int, goal: Int, lattice: Lattice, buffers: Scratch) -> tuple[Int, Int]:
    """A* with 4-connected moves and the Manhattan heuristic; return (iterations, pushes).

    A step changes f by 0 or 2, so two stacks replace the heap, and taking from the top of the
    nearer one is exactly the order of the format. Both stacks are lists through ``pushed[1:]``,
    where link 0 ends a list. ``came`` holds WALL and UNSEEN, then the move that led to a cell, with
    CLOSED once it is expanded; ``g``, in moves, needs no content.
    """
    came = buffers.came
    g = buffers.g
    pushed = buffers.pushed
    links = buffers.links
    p = np.uint32(lattice.stride)
    target = np.uint32(goal)
    goal_row = target // p
    goal_column = target - goal_row * p
    near = np.uint32(1)
    far = np.uint32(0)
    pushes = np.uint32(2)
    expanded = 0
    pushed[1] = start
    links[1] = 0
    came[start] = 0
    g[start] = 0
    while True:
        if near == 0:
            if far == 0:
                return expanded, np.int64(pushes)
            near, far = far, near
        c = pushed[np.uint64(near)]
        near = links[np.uint64(near)]
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
                pushed[np.uint64(pushes)] = to
                links[np.uint64(pushes)] = near if closer else far
                near, far = (pushes, far) if closer else (near, pushes)
                pushes += np.uint32(1)


@inlined
def wipe(buffers: Scratch, pushes: Int) -> None:
    """Make ``came`` fresh again after an A*."""
    came = buffers.came
    pushed = buffers.pushed
    for k in range(1, pushes):
        came[np.uint64(pushed[np.uint64(k)])] = UNSEEN


@kernel
def astar_heap(
    start: Int, goal: Int, search: Weights, lattice: Lattice, buffers: Scratch
) -> tuple[Int, Int]:
    """A* with any moves and weights; return (iterations, pushes).

    A binary heap with the least f on top, and among equal f the latest push. ``links`` holds the
    numbers of the pushes in the heap, ``f`` their priorities; ``came`` and ``g`` are as in
    `astar_manhattan`, costs in 1 / UNIT.
    """
    came = buffers.came
    g = buffers.g
    pushed = buffers.pushed
    heap = buffers.links
    f = buffers.f
    way, weight = search
    goal_row, goal_column = position(goal, lattice)
    came[start] = 0
    g[start] = 0
    pushed[1] = start
    f[0] = 0
    heap[0] = 1
    pushes = 2
    size = 1
    expanded = 0
    while size:
        c = np.int64(pushed[heap[0]])
        size -= 1
        # The last entry goes to the top and down to its place.
        last = heap[size]
        key = f[size]
        at = 0
        child = 1
        while child < size:
            other = child + 1
            if other < size and (
                f[other] < f[child] or (f[other] == f[child] and heap[other] > heap[child])
            ):
                child = other
            if key < f[child] or (key == f[child] and last > heap[child]):
                break
            f[at] = f[child]
            heap[at] = heap[child]
            at = child
            child = 2 * child + 1
        f[at] = key
        heap[at] = last
        if came[c] & CLOSED:  # it was pushed again with a smaller g, and expanded then
            continue
        came[c] |= CLOSED
        cost = g[c]
        expanded += 1
        if c == goal:
            break
        row, column = position(c, lattice)
        for move in range(len(lattice.offsets)):
            if not is_legal(came, c, move, lattice):
                continue
            to = c + lattice.offsets[move]
            longer = cost + (UNIT if move < 4 else lattice.step)
            before = came[to]
            if before == UNSEEN or (before < CLOSED and g[to] > longer):
                came[to] = move
                g[to] = longer
                h = heuristic(
                    row + STEPS[move, 0] - goal_row, column + STEPS[move, 1] - goal_column, lattice
                )
                # A float would round the h of long distances: the weight of A* keeps it exact.
                key = way * longer + (h if weight == 1 else np.int64(weight * h))
                pushed[pushes] = to
                at = size
                while at and f[(at - 1) >> 1] >= key:  # up past equal f: this is the latest push
                    f[at] = f[(at - 1) >> 1]
                    heap[at] = heap[(at - 1) >> 1]
                    at = (at - 1) >> 1
                f[at] = key
                heap[at] = pushes
                pushes += 1
                size += 1
    return expanded, pushes


@kernel
def count_moves(came: Bytes, start: Int, goal: Int, lattice: Lattice) -> tuple[Int, Int]:
    """Return how many straight and diagonal moves led from ``start`` to ``goal``."""
    straight: Int = 0
    diagonal: Int = 0
    c = goal
    while c != start:
        move = np.uint64(came[np.uint64(c)] & np.uint8(7))
        if move < 4:
            straight += 1
        else:
            diagonal += 1
        c -= lattice.offsets[move]
    return straight, diagonal


@kernel
def write_moves(
    came: Bytes, start: Int, goal: Int, lattice: Lattice, moves: Bytes, end: Int
) -> None:
    """Write the moves that led from ``start`` to ``goal`` so that the last one stands before
    ``moves[end]``.
    """
    c = goal
    while c != start:
        move = np.uint64(came[np.uint64(c)] & np.uint8(7))
        end -= 1
        moves[end] = move
        c -= lattice.offsets[move]


@kernel
def write_cells(came: Bytes, goal: Int, lattice: Lattice, path: Ints) -> None:
    """Write the cells of a path that ends at ``goal``, as many as ``path`` (k, 2) holds."""
    c = goal
    for k in range(len(path) - 1, -1, -1):
        path[k, 0], path[k, 1] = position(c, lattice)
        if k:
            c -= lattice.offsets[np.uint64(came[np.uint64(c)] & np.uint8(7))]


@kernel
def with_capacity(moves: Bytes, used: Int, more: Int) -> Bytes:
    """Return ``moves``, or a larger copy of the ``used`` ones with room for ``more``."""
    if used + more <= len(moves):
        return moves
    larger = np.empty(2 * (used + more), np.uint8)
    larger[:used] = moves[:used]
    return larger


# --- kernels: whole grids -----------------------------------------------------------------------


@kernel
def scratch(search: Weights, lattice: Lattice) -> Scratch:
    """Return what `find` writes to, or `shortest_costs` if ``search`` is COSTS."""
    cells = lattice.cells
    # A cell is pushed at most once for each neighbour, so that the logs cannot overflow.
    pushes = len(lattice.offsets) * cells + 2
    keys = 0
    if search == BFS or (search == COSTS and lattice.step == UNIT):
        pushes = cells + 2
    elif search == ASTAR and lattice.diagonals == 0:
        pushes = 2 * cells + 2  # once on each stack
    elif search != COSTS:
        keys = pushes
    return Scratch(
        np.full(cells, WALL),
        np.empty(cells, np.int64),
        np.empty(pushes, np.uint32),
        np.empty(pushes, np.uint32),
        np.empty(keys, np.int64),
    )


@kernel
def find(
    start: Int, goal: Int, search: Weights, lattice: Lattice, buffers: Scratch
) -> tuple[Int, Int, Int, Int]:
    """Search one problem on a grid that is loaded.

    Returns straight and diagonal moves or (-1, 0), iterations, pushes. BFS, which does not weigh
    moves, counts all as straight.
    """
    came = buffers.came
    pushes = 0
    if search == BFS:
        target = np.empty(1, np.int64)
        target[0] = goal
        count = flood(start, target, lattice, buffers)
        expanded = expansions_until(buffers.pushed, count, goal)
    elif search == ASTAR and lattice.diagonals == 0:
        expanded, pushes = astar_manhattan(start, goal, lattice, buffers)
        if came[goal] != UNSEEN:
            return buffers.g[goal], 0, expanded, pushes
    else:
        expanded, pushes = astar_heap(start, goal, search, lattice, buffers)
    if came[goal] == UNSEEN:
        return -1, 0, expanded, pushes
    straight, diagonal = count_moves(came, start, goal, lattice)
    if search == BFS:
        return straight + diagonal, 0, expanded, pushes
    return straight, diagonal, expanded, pushes


@kernel
def solve_one(
    grid: Bytes,
    start_row: Int,
    start_column: Int,
    goal_row: Int,
    goal_column: Int,
    search: Weights,
    rule: Rule,
) -> tuple[Ints, Int, Int, Int]:
    """Search one problem; return its path, straight and diagonal moves, and iterations (0 when the
    problem is bad).
    """
    lattice = lattice_of(grid.shape, rule)
    buffers = scratch(search, lattice)
    bad = not load(grid, buffers.came)
    if bad or grid[start_row, start_column] or grid[goal_row, goal_column]:
        return np.empty((0, 2), np.int64), -1, 0, 0
    start = cell_at(start_row, start_column, lattice)
    goal = cell_at(goal_row, goal_column, lattice)
    straight, diagonal, expanded, _ = find(start, goal, search, lattice, buffers)
    path = np.empty((straight + diagonal + 1, 2), np.int64)
    write_cells(buffers.came, goal, lattice, path)
    return path, straight, diagonal, expanded


@kernel
def solve_all(
    grids: Bytes, starts: Ints, goals: Ints, search: Weights, rule: Rule
) -> tuple[Ints, Ints, Int]:
    """Search each problem k from ``starts[k]`` to ``goals[k]`` on ``grids[k]`` (or on the one
    grid).

    Returns:
        cells (M, 2), all paths one after another; found (B, 4): straight and diagonal moves or (-1,
        0), iterations, and the end of the path in ``cells``; the number of problems solved before
        one was found bad.
    """
    lattice = lattice_of(grids.shape[1:], rule)
    buffers = scratch(search, lattice)
    found = np.empty((len(starts), 4), np.int64)
    path = np.empty((64 * len(starts) + 64, 2), np.int64)
    used = 0
    for k in range(len(starts)):
        grid = grids[k if len(grids) > 1 else 0]
        stale = k == 0 or len(grids) > 1 or search == BFS
        if stale and not load(grid, buffers.came):
            return path, found, k
        if grid[starts[k, 0], starts[k, 1]] or grid[goals[k, 0], goals[k, 1]]:
            return path, found, k
        start = cell_at(starts[k, 0], starts[k, 1], lattice)
        goal = cell_at(goals[k, 0], goals[k, 1], lattice)
        straight, diagonal, expanded, pushes = find(start, goal, search, lattice, buffers)
        end = used + straight + diagonal + 1
        if end > len(path):
            longer = np.empty((2 * end, 2), np.int64)
            longer[:used] = path[:used]
            path = longer
        write_cells(buffers.came, goal, lattice, path[used:end])
        used = end
        found[k, 0], found[k, 1], found[k, 2], found[k, 3] = straight, diagonal, expanded, used
        if search != BFS:
            wipe(buffers, pushes)
    return path[:used], found, len(starts)


@kernel
def first_bad_cell(grid: Bytes, path: Ints, rule: Rule) -> tuple[Int, Int]:
    """Return the first k whose cell is not free, or not one move from cell k - 1, or -1 when all is
    well, and how many moves are diagonal. The first is -2 when ``grid`` is not of 0 and 1.
    """
    lattice = lattice_of(grid.shape, rule)
    came = np.full(lattice.cells, WALL)
    if not load(grid, came):
        return -2, 0
    diagonal = 0
    for k in range(len(path)):
        row, column = path[k]
        if not (0 <= row < grid.shape[0] and 0 <= column < grid.shape[1]) or grid[row, column]:
            return k, diagonal
        if k == 0:
            continue
        good = False
        for move in range(len(lattice.offsets)):
            if row - path[k - 1, 0] == STEPS[move, 0] and column - path[k - 1, 1] == STEPS[move, 1]:
                good = is_legal(
                    came, cell_at(path[k - 1, 0], path[k - 1, 1], lattice), move, lattice
                )
                diagonal += move >= 4
        if not good:
            return k, diagonal
    return -1, diagonal


@kernel
def write_field(grid: Bytes, row: Int, column: Int, rule: Rule, out: Float32s) -> Int:
    """Write the cost from every cell to (row, column) into ``out``, -1 where there is none; return
    whether grid is 0/1.
    """
    lattice = lattice_of(grid.shape, rule)
    buffers = scratch(COSTS, lattice)
    good = load(grid, buffers.came)
    out[:, :] = -1
    if good and not grid[row, column]:
        for k in range(shortest_costs(cell_at(row, column, lattice), lattice, buffers)):
            cell = np.int64(buffers.pushed[k])
            out[position(cell, lattice)] = in_cells(buffers.g[cell])
    return good


@kernel
def shortest_costs(source: Int, lattice: Lattice, buffers: Scratch) -> Int:
    """Write the cost of the shortest path from ``source`` to every cell into ``g``, FAR where there
    is none.

    ``came`` is as `load` leaves it; the buffers are `scratch` of COSTS. Returns how many cells are
    reached; they stand in ``pushed``, each once.
    """
    came = buffers.came
    costs = buffers.g
    queue = buffers.pushed
    costs[:] = FAR
    costs[source] = 0
    if lattice.step != UNIT:
        queue[1] = source
        return bucket_search(1, lattice, buffers)
    count = flood(source, np.empty(0, np.int64), lattice, buffers)
    for k in range(1, count):
        cell = np.int64(queue[k])
        costs[cell] = costs[cell - lattice.offsets[came[cell]]] + UNIT
    return count


@kernel
def bucket_search(sources: Int, lattice: Lattice, buffers: Scratch) -> Int:
    """Write costs from the nearest of the sources ``pushed[1:sources + 1]``, whose ``g`` is 0
    already.

    Buckets one UNIT wide, the shortest step (Dinitz 1978): what lies in the nearest bucket cannot
    become cheaper, whatever the order, and a step of sqrt(2) reaches at most two buckets ahead, so
    that three lists through one log replace a heap. Returns as `shortest_costs` does.
    """
    came = buffers.came
    costs = buffers.g
    pushed = buffers.pushed
    links = buffers.links
    heads = np.zeros(3, np.int64)  # entry 0 ends a list
    heads[0] = sources
    for k in range(1, sources + 1):
        links[k] = k - 1
    pushes = sources + 1
    bucket = 0
    waiting = sources
    while waiting:
        entry = heads[bucket % 3]
        if entry == 0:
            bucket += 1
            continue
        heads[bucket % 3] = links[entry]
        waiting -= 1
        c = np.int64(pushed[entry])
        cost = costs[c]
        if cost >> UNIT_BITS != bucket:  # it was pushed again with a smaller cost
            continue
        for move in range(len(lattice.offsets)):
            if not is_legal(came, c, move, lattice):
                continue
            to = c + lattice.offsets[move]
            longer = cost + (UNIT if move < 4 else lattice.step)
            if longer < costs[to]:
                costs[to] = longer
                ahead = (longer >> UNIT_BITS) % 3
                pushed[pushes] = to
                links[pushes] = heads[ahead]
                heads[ahead] = pushes
                pushes += 1
                waiting += 1
    # The log is over: what was reached takes its place.
    count = 0
    for k in range(len(costs)):
        if costs[k] != FAR:
            pushed[count] = k
            count += 1
    return count
