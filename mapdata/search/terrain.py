"""Searches on terrain, where every cell has a cost of its own: best first, and around a goal.

`mapdata.search.ground` explains their costs. They stay apart from the searches of grids
(`mapdata.search.kernels`), because one loop for both takes more time: the heap search on terrain
1.12 to 1.22 times as long, and searches of grids as if they were terrain of ones 1.6 to 5.5 times.
"""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Bytes, Ints, UInt32s
from mapdata.jit import Int, inlined, kernel
from mapdata.movement import STEPS, Movement
from mapdata.search.ground import EXACT, MAX_COST, PaddedTerrain, terrain_heuristic
from mapdata.search.kernels import Scratch, insert_in_heap, remove_heap_top
from mapdata.search.lattice import (
    CLOSED,
    CORNER_CUTTING,
    INFINITY,
    UNSEEN,
    WALL,
    Lattice,
    is_legal,
    position,
)

_ONE = np.uint64(1)

_MOVE = np.uint8(7)
"""The bits of ``came_from`` that hold the move."""

_OCCUPIED_COST = np.int64(-(2**62))
"""Stands for the cost of an occupied cell: no cost is smaller, or one move away from it."""

_RING_BUCKETS = 512
"""Buckets of `shortest_terrain_costs` and `terrain_astar`.

In `shortest_terrain_costs` the most expensive move, of 721.2, passes at most 361 buckets of width
2.
"""

_F_BITS = 20
"""Binary places of f in `terrain_best_first` where costs are whole numbers, below 2**34."""

_MIN_HEAP_CAPACITY = 256
"""Entries of the heap of `terrain_astar` before it grows."""


@kernel
def shortest_terrain_costs(
    sources: Ints, padded: PaddedTerrain, lattice: Lattice, scratch: Scratch
) -> Int:
    """Write the least costs from every cell to the nearest source, and the optimal moves.

    This is Dijkstra's search with a ring of buckets instead of a heap (Dial 1969,
    https://doi.org/10.1145/363269.363610). A bucket is no wider than the cheapest move, so every
    move leads out of its bucket, and no cell of the nearest bucket can become cheaper, whatever the
    order within the bucket (Dinitz 1978). So when a cell of it is expanded, all nearer cells have
    their final costs, and those of its neighbours show which moves are optimal.

    A bucket is a stack of pushes, linked through the log of `Scratch`. A cell is pushed again when
    it becomes cheaper. Its older push is dropped, because it lies in a bucket behind the one in
    which the cell was expanded.

    Args:
        sources: (n,) padded cells; those that are occupied are ignored.
        padded: the terrain.
        lattice: of the map.
        scratch: memory of the search. Afterwards ``g`` (cells,) holds doubled costs,
            `INFINITY` without a path and a negative number on occupied cells;
            ``came_from`` (cells,) holds bit sets, in which bit k is set if move k begins an optimal
            path from the cell to a source.

    Returns:
        0, or the least cost of a cell that is too high to be exact; then the search stopped there.
    """
    cell_costs = padded.cell_costs
    optimal_moves = scratch.came_from
    costs = scratch.g
    pushed = scratch.pushed
    links = scratch.links
    straight_unit = padded.straight_unit
    diagonal_unit = padded.diagonal_unit
    bucket_bits = 0
    while 2 << bucket_bits <= 2 * padded.min_cell_cost * straight_unit:
        bucket_bits += 1
    ring_mask = np.uint64(_RING_BUCKETS - 1)
    bucket_tops = np.zeros(_RING_BUCKETS, np.uint32)
    for k in range(lattice.cells):
        costs[k] = INFINITY if cell_costs[k] else _OCCUPIED_COST
        optimal_moves[k] = 0
    # Push 0 does not exist, so that a link of 0 ends a stack.
    pushes = _ONE
    for source in sources:
        if costs[source] == INFINITY:
            costs[source] = 0
            pushed[pushes] = source
            links[pushes] = bucket_tops[0]
            bucket_tops[0] = pushes
            pushes += _ONE
    stride = np.uint64(lattice.stride)
    may_cut = lattice.diagonals == CORNER_CUTTING
    bucket = 0
    empty_buckets = 0
    while empty_buckets < _RING_BUCKETS:
        slot = np.uint64(bucket) & ring_mask
        top = np.uint64(bucket_tops[slot])
        empty_buckets = 0 if top else empty_buckets + 1
        bucket_tops[slot] = 0
        while top:
            cell = np.uint64(pushed[top])
            top = np.uint64(links[top])
            cost = costs[cell]
            if cost >> bucket_bits != bucket:
                continue  # The cell was pushed again with a smaller cost, and has been expanded.
            if cost >= MAX_COST:
                return cost
            cell_cost = np.int64(cell_costs[cell])
            moves: Int = 0
            straight_neighbours = (cell - stride, cell + _ONE, cell + stride, cell - _ONE)
            for move, neighbour in enumerate(straight_neighbours):
                move_cost = (cell_cost + np.int64(cell_costs[neighbour])) * straight_unit
                old_cost = costs[neighbour]
                new_cost = cost + move_cost
                moves |= np.int64(old_cost + move_cost == cost) << move
                if new_cost < old_cost:
                    costs[neighbour] = new_cost
                    pushed[pushes] = neighbour
                    neighbour_slot = np.uint64(new_cost >> bucket_bits) & ring_mask
                    links[pushes] = bucket_tops[neighbour_slot]
                    bucket_tops[neighbour_slot] = pushes
                    pushes += _ONE
            if lattice.diagonals:
                # This copy of the corner rule of `is_legal` has no branches.
                north_free = may_cut | (cell_costs[cell - stride] != 0)
                east_free = may_cut | (cell_costs[cell + _ONE] != 0)
                south_free = may_cut | (cell_costs[cell + stride] != 0)
                west_free = may_cut | (cell_costs[cell - _ONE] != 0)
                for move, neighbour, is_allowed in (
                    (4, cell - stride + _ONE, north_free & east_free),
                    (5, cell + stride + _ONE, south_free & east_free),
                    (6, cell + stride - _ONE, south_free & west_free),
                    (7, cell - stride - _ONE, north_free & west_free),
                ):
                    move_cost = (cell_cost + np.int64(cell_costs[neighbour])) * diagonal_unit
                    old_cost = costs[neighbour]
                    new_cost = cost + move_cost
                    moves |= np.int64(is_allowed & (old_cost + move_cost == cost)) << move
                    if is_allowed & (new_cost < old_cost):
                        costs[neighbour] = new_cost
                        pushed[pushes] = neighbour
                        neighbour_slot = np.uint64(new_cost >> bucket_bits) & ring_mask
                        links[pushes] = bucket_tops[neighbour_slot]
                        bucket_tops[neighbour_slot] = pushes
                        pushes += _ONE
            optimal_moves[cell] = moves
        bucket += 1
    return EXACT


@kernel
def terrain_astar(
    start: Int, goal: Int, padded: PaddedTerrain, lattice: Lattice, scratch: Scratch
) -> tuple[Int, Int, Int]:
    """Run A* on terrain, in the order that the format fixes (docs/format.md).

    The open list is a ring of buckets, each of which covers an interval of f. A push goes

    - into a binary heap, which holds the pushes whose f is in the current bucket;
    - else on top of the stack of its bucket, linked through the log of `Scratch`.

    f never falls along a path, so once the heap is empty, the pushes of the next bucket become the
    heap. It mostly has few entries, and so is faster than one heap of the whole open list. The
    intervals are as narrow as they can be with a ring that covers the largest rise of f in a move.

    Args:
        start: padded cell, free.
        goal: padded cell, free.
        padded: the terrain.
        lattice: of the map.
        scratch: with the map loaded in ``came_from``. Afterwards ``g`` holds doubled costs.

    Returns:
        The number of expansions; the number of pushes plus 1, as `wipe` takes it; and 0, or the
        least cost of a cell that is too high to be exact, at which the search stopped.
    """
    cell_costs = padded.cell_costs
    came_from = scratch.came_from
    g = scratch.g
    pushed = scratch.pushed
    links = scratch.links
    f = scratch.f
    heap = np.empty(_MIN_HEAP_CAPACITY, np.uint32)
    heap_f = np.empty(_MIN_HEAP_CAPACITY, np.int64)
    # A move and the change of h, which is no larger, together raise f by at most this.
    max_rise = 4 * padded.max_cell_cost * padded.diagonal_unit
    bucket_bits = 0
    while max_rise >> bucket_bits >= _RING_BUCKETS - 1:
        bucket_bits += 1
    ring_mask = np.uint64(_RING_BUCKETS - 1)
    bucket_tops = np.zeros(_RING_BUCKETS, np.uint32)
    goal_row, goal_column = position(goal, lattice)
    row, column = position(start, lattice)
    h = terrain_heuristic(row - goal_row, column - goal_column, padded, lattice)
    # f is lowered by MAX_COST, which keeps its order: g and h may both be close to MAX_COST, and
    # their sum would overflow.
    bucket = (h - MAX_COST) >> bucket_bits
    came_from[start] = 0  # Any move will do: a path is traced back only as far as its start.
    g[start] = 0
    pushed[1] = start
    heap[0] = 1
    heap_f[0] = h - MAX_COST
    heap_size = 1
    pushes = np.uint32(2)
    expansions = 0
    while True:
        if heap_size == 0:
            empty_buckets = 0
            while empty_buckets < _RING_BUCKETS and bucket_tops[np.uint64(bucket) & ring_mask] == 0:
                bucket += 1
                empty_buckets += 1
            if empty_buckets == _RING_BUCKETS:
                break
            slot = np.uint64(bucket) & ring_mask
            push = bucket_tops[slot]
            bucket_tops[slot] = 0
            while push:
                # A closed cell was pushed again with a smaller f and expanded then.
                if not came_from[pushed[push]] & CLOSED:
                    heap, heap_f = _with_room(heap, heap_f, heap_size)
                    insert_in_heap(heap, heap_f, heap_size, push, f[push])
                    heap_size += 1
                push = links[push]
            continue
        cell = pushed[np.uint64(heap[0])]
        heap_size -= 1
        remove_heap_top(heap, heap_f, heap_size)
        if came_from[cell] & CLOSED:
            continue
        came_from[cell] |= CLOSED
        expansions += 1
        cost = g[cell]
        if cost >= MAX_COST:
            return expansions, np.int64(pushes), cost
        if cell == goal:
            break
        cell_cost = np.int64(cell_costs[cell])
        row, column = position(cell, lattice)
        for move in range(len(lattice.offsets)):
            neighbour = np.uint64(cell + lattice.offsets[move])
            state = came_from[neighbour]
            unit = padded.straight_unit if move < 4 else padded.diagonal_unit
            tentative_g = cost + (cell_cost + np.int64(cell_costs[neighbour])) * unit
            # Most neighbours fail this test, so that corners are looked at for few of them. Closed
            # cells always fail it, because the heuristic is consistent.
            if state == WALL or (state != UNSEEN and g[neighbour] <= tentative_g):
                continue
            if not is_legal(came_from, cell, move, lattice):
                continue
            rows_to_goal = row + STEPS[move, 0] - goal_row
            columns_to_goal = column + STEPS[move, 1] - goal_column
            h = terrain_heuristic(rows_to_goal, columns_to_goal, padded, lattice)
            neighbour_f = (tentative_g - MAX_COST) + h
            came_from[neighbour] = move
            g[neighbour] = tentative_g
            pushed[pushes] = neighbour
            if neighbour_f >> bucket_bits == bucket:
                heap, heap_f = _with_room(heap, heap_f, heap_size)
                insert_in_heap(heap, heap_f, heap_size, pushes, neighbour_f)
                heap_size += 1
            else:
                f[pushes] = neighbour_f
                slot = np.uint64(neighbour_f >> bucket_bits) & ring_mask
                links[pushes] = bucket_tops[slot]
                bucket_tops[slot] = pushes
            pushes += np.uint32(1)
    return expansions, np.int64(pushes), EXACT


@kernel
def terrain_best_first(
    start: Int,
    goal: Int,
    weights: tuple[Int, float],
    padded: PaddedTerrain,
    lattice: Lattice,
    scratch: Scratch,
) -> tuple[Int, Int, Int]:
    """Run best-first search with any weights on terrain: the open list is a binary heap.

    The order is that of `best_first_heap`: a cell that was expanded takes a cheaper path, too, but
    is not expanded again. So its descendants may have a larger ``g`` than their path costs.

    Args:
        start: padded cell, free.
        goal: padded cell, free.
        weights: of g and h in f; not BFS. The weighted h of no cell may exceed ``MAX_COST``.
        padded: the terrain.
        lattice: of the map.
        scratch: with the map loaded in ``came_from``.

    Returns:
        The same as `terrain_astar`.
    """
    cell_costs = padded.cell_costs
    came_from = scratch.came_from
    g = scratch.g
    pushed = scratch.pushed
    heap = scratch.links
    f = scratch.f
    g_weight, h_weight = weights
    # Where costs are whole numbers, f has binary places for the product of h and its weight.
    f_shift = _F_BITS if padded.straight_unit == 1 else 0
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
        cost = g[cell]
        if cost >= MAX_COST:
            return expansions, np.int64(pushes), cost
        if cell == goal:
            break
        cell_cost = np.int64(cell_costs[cell])
        row, column = position(cell, lattice)
        for move in range(len(lattice.offsets)):
            neighbour = np.uint64(cell + lattice.offsets[move])
            state = came_from[neighbour]
            unit = padded.straight_unit if move < 4 else padded.diagonal_unit
            tentative_g = cost + (cell_cost + np.int64(cell_costs[neighbour])) * unit
            if state == WALL or (state != UNSEEN and g[neighbour] <= tentative_g):
                continue
            if not is_legal(came_from, cell, move, lattice):
                continue
            g[neighbour] = tentative_g
            if state != UNSEEN and state >= CLOSED:
                came_from[neighbour] = move | CLOSED
                continue
            came_from[neighbour] = move
            rows_to_goal = row + STEPS[move, 0] - goal_row
            columns_to_goal = column + STEPS[move, 1] - goal_column
            h = terrain_heuristic(rows_to_goal, columns_to_goal, padded, lattice) << f_shift
            if h_weight != 1:  # Multiplied by the float 1.0, a large h would be rounded.
                h = np.int64(h_weight * h)
            # f is lowered by MAX_COST, so that the sum of g and h does not overflow.
            neighbour_f = (g_weight * (tentative_g << f_shift) - MAX_COST) + h
            pushed[pushes] = neighbour
            insert_in_heap(heap, f, heap_size, pushes, neighbour_f)
            heap_size += 1
            pushes += np.uint32(1)
    return expansions, np.int64(pushes), EXACT


@kernel
def sums_of_path(
    came_from: Bytes, start: Int, goal: Int, padded: PaddedTerrain, lattice: Lattice
) -> tuple[Int, Int]:
    """Return the sums S and D of the path that leads from ``start`` to ``goal``, padded cells."""
    straight_sum: Int = 0
    diagonal_sum: Int = 0
    cell = goal
    while cell != start:
        move = np.uint64(came_from[np.uint64(cell)] & _MOVE)
        parent = cell - lattice.offsets[move]
        move_sum = np.int64(padded.cell_costs[cell]) + np.int64(padded.cell_costs[parent])
        if move < 4:
            straight_sum += move_sum
        else:
            diagonal_sum += move_sum
        cell = parent
    return straight_sum, diagonal_sum


@inlined
def _with_room(heap: UInt32s, heap_f: Ints, size: Int) -> tuple[UInt32s, Ints]:
    """Return a heap of ``size`` entries with room for one more, moved to larger arrays if full."""
    if size == len(heap):
        heap = np.concatenate((heap, np.empty_like(heap)))
        heap_f = np.concatenate((heap_f, np.empty_like(heap_f)))
    return heap, heap_f


def min_cell_costs(terrain: Bytes) -> Ints:
    """Return the smallest cost of a free cell of each map, (...) int64 for terrain (..., H, W).

    ``terrain`` must be uint8. The cost is 256 for a map without a free cell.
    """
    # As unsigned bytes, 0 - 1 is 255, so occupied cells are never the smallest. This takes a
    # twentieth of the time of selecting the free cells.
    costs_less_one = terrain - np.uint8(1)
    min_costs: Ints = costs_less_one.min(axis=(-2, -1)).astype(np.int64) + 1
    return min_costs


def terrain_path_cost(terrain: Bytes, path: Ints, movement: Movement) -> float:
    """Return the cost in cells of a legal ``path`` (k, 2) on ``terrain`` (H, W)."""
    cell_costs = terrain[path[:, 0], path[:, 1]].astype(np.int64)
    move_sums = cell_costs[:-1] + cell_costs[1:]
    is_diagonal = np.all(path[:-1] != path[1:], axis=1)
    diagonal_sum = int(move_sums[is_diagonal].sum())
    straight_sum = int(move_sums.sum()) - diagonal_sum
    return (straight_sum + diagonal_sum * movement.diagonal_cost) / 2
