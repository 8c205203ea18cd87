"""Searches on terrain, where every cell has a cost of its own: best first, and around a goal.

Terrain is a map (H, W) of uint8: 0 is an occupied cell, 1 to 255 is the cost of a free cell. A move
costs the mean of its two cells times its length. This is the rule of scikit-image's MCP_Geometric.
It is symmetric, so that the costs from a cell are also the costs to it.

Costs in this module are doubled: the sum of the two cells replaces their mean, so that no fraction
is left. A path whose straight moves have the sum S of cell costs, and whose diagonal moves have the
sum D, has the doubled cost S + D * sqrt(2), which is stored as the integer ``S * UNIT + D *
DIAGONAL``. `mapdata.search.lattice` explains these numbers. Its proof needs only that S and D are
whole numbers, so it holds here for doubled costs below `MAX_PATH_COST`. Mazes of 128 x 128 cells
with costs up to 255 stay below half of this bound. A search that finds a least cost at or above the
bound says so, and its caller refuses the map.

Where diagonal moves do not exist or cost 1, all doubled costs are whole numbers. The kernels then
count them in units of 1, for which neither the bound nor an overflow of int64 is in reach.

On terrain of ones every cost is twice that of a map without terrain. So A* expands the same cells
in the same order, and returns the same paths.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Float32s, Floats, Ints, UInt32s
from mapdata.jit import Int, inlined, kernel
from mapdata.movement import STEPS, Movement
from mapdata.search.kernels import (
    Scratch,
    count_moves,
    insert_in_heap,
    remove_heap_top,
    scratch_view,
    wipe,
    with_capacity,
    write_cells,
    write_moves,
)
from mapdata.search.lattice import (
    CLOSED,
    CORNER_CUTTING,
    DIAGONAL,
    MAX_PATH_COST,
    NO_DIAGONALS,
    UNIT,
    UNSEEN,
    WALL,
    CostWeights,
    Lattice,
    MoveRule,
    cell_at,
    count_path_cells,
    is_legal,
    lattice_of,
    position,
    split_cost,
)

_ONE = np.uint64(1)

_MOVE = np.uint8(7)
"""The bits of ``came_from`` that hold the move."""

MAX_COST = np.int64(MAX_PATH_COST * UNIT)
"""Doubled costs from here on are not exact where diagonal moves cost sqrt(2)."""

_MAX_MOVE_COST = 722
"""A diagonal move between two cells of cost 255 costs 510 * sqrt(2) = 721.2 doubled cells."""

INFINITY_ON_TERRAIN = np.int64((MAX_PATH_COST + _MAX_MOVE_COST) * UNIT)
"""The doubled cost of a cell that no path reaches.

A cell behind the bound still gets a smaller cost, because only cells before the bound are expanded.
So it is not mistaken for a cell without a path.
"""

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


class PaddedTerrain(NamedTuple):
    """The terrain of one map on its lattice, and the units of its costs.

    Attributes:
        cell_costs: (cells,) uint8, cost of each padded cell, 0 where it is occupied and in the wall
            around the map.
        min_cell_cost: smallest cost of a free cell of the map; 255 if no cell is free.
        max_cell_cost: largest cost of a cell of the map.
        straight_unit: doubled cost of a straight move, for each 1 in the sum of its two cells.
        diagonal_unit: doubled cost of a diagonal move, for each 1 in the sum of its two cells.
    """

    cell_costs: Bytes
    min_cell_cost: Int
    max_cell_cost: Int
    straight_unit: Int
    diagonal_unit: Int


@kernel
def load_terrain(
    terrain: Bytes, lattice: Lattice, cell_costs: Bytes, came_from: Bytes
) -> PaddedTerrain:
    """Copy ``terrain`` (H, W) onto the lattice.

    Args:
        terrain: (H, W) costs of cells, 0 where they are occupied.
        lattice: of the map.
        cell_costs: (cells,) to be filled with the costs. It is 0 in the wall around the map, where
            nothing is written.
        came_from: (cells,) to be filled with UNSEEN and WALL.
    """
    rows, columns = terrain.shape
    for k in range(lattice.cells):
        came_from[k] = WALL
    min_cell_cost: Int = 255
    max_cell_cost: Int = 0
    for row in range(rows):
        first = np.uint64(cell_at(row, 0, lattice))
        for k in range(columns):
            column = np.uint64(k)
            cell_cost = np.int64(terrain[row, column])
            cell_costs[first + column] = cell_cost
            came_from[first + column] = UNSEEN if cell_cost else WALL
            min_cell_cost = min(min_cell_cost, cell_cost if cell_cost else 255)
            max_cell_cost = max(max_cell_cost, cell_cost)
    if lattice.diagonal_cost == UNIT:
        return PaddedTerrain(cell_costs, min_cell_cost, max_cell_cost, np.int64(1), np.int64(1))
    return PaddedTerrain(
        cell_costs, min_cell_cost, max_cell_cost, np.int64(UNIT), np.int64(DIAGONAL)
    )


@inlined
def terrain_heuristic(rows: Int, columns: Int, padded: PaddedTerrain, lattice: Lattice) -> Int:
    """Return the doubled cost of a path by (rows, columns) on a free map of the smallest cost.

    No path costs less, and the heuristics of two neighbours differ by no more than a move between
    them costs, so A* expands no cell twice. The same holds for the limit `MAX_COST`, which keeps
    the sum g + h inside int64: a path that reaches it is refused anyway.
    """
    rows = abs(rows)
    columns = abs(columns)
    doubled_min_cost = 2 * padded.min_cell_cost
    if lattice.diagonals == NO_DIAGONALS:
        return (rows + columns) * doubled_min_cost * padded.straight_unit
    # Farther away, the product below could be too large for int64.
    if padded.straight_unit > 1 and max(rows, columns) * doubled_min_cost >= MAX_PATH_COST:
        return MAX_COST
    straight = abs(rows - columns) * padded.straight_unit
    diagonal = min(rows, columns) * padded.diagonal_unit
    return min(MAX_COST, (straight + diagonal) * doubled_min_cost)


@kernel
def split_terrain_cost(cost: Int, padded: PaddedTerrain) -> tuple[Int, Int]:
    """Return the sums S and D of a doubled cost; all of it is S where costs are whole numbers."""
    if padded.straight_unit == 1:
        return cost, np.int64(0)
    return split_cost(cost)


@kernel
def cost_in_cells(cost: Int, padded: PaddedTerrain) -> float:
    """Return a doubled cost as a cost in cells, -1 for occupied cells and those without a path."""
    if not 0 <= cost < INFINITY_ON_TERRAIN:
        return -1.0
    straight_sum, diagonal_sum = split_terrain_cost(cost, padded)
    cost_of_path: float = (straight_sum + diagonal_sum * math.sqrt(2.0)) / 2
    return cost_of_path


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
            `INFINITY_ON_TERRAIN` without a path and a negative number on occupied cells;
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
        costs[k] = INFINITY_ON_TERRAIN if cell_costs[k] else _OCCUPIED_COST
        optimal_moves[k] = 0
    # Push 0 does not exist, so that a link of 0 ends a stack.
    pushes = _ONE
    for source in sources:
        if costs[source] == INFINITY_ON_TERRAIN:
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
    return np.int64(0)


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
    return expansions, np.int64(pushes), np.int64(0)


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
    return expansions, np.int64(pushes), np.int64(0)


@kernel
def _sums_of_path(
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


@kernel
def solve_on_terrain(
    terrains: Bytes,
    starts: Ints,
    goals: Ints,
    allow_occupied_ends: Int,
    weights: CostWeights,
    rule: MoveRule,
    memory: Bytes,
) -> tuple[Ints, Ints, Ints, Ints, Int, Int]:
    """Search problem b from ``starts[b]`` to ``goals[b]`` on ``terrains[b]``, for B problems.

    Args:
        terrains: (B, H, W), or (1, H, W) for terrain that all problems share.
        starts: (B, 2) cells.
        goals: (B, 2) cells.
        allow_occupied_ends: 1 if starts and goals may be occupied: such a problem has no path, and
            no cell is expanded. Otherwise 0.
        weights: which search; not BFS, which counts moves.
        rule: which moves are legal.
        memory: for the `Scratch` of the search.

    Returns:
        The cells (M, 2) of all paths, one after another; (B, 2) sums S and D of the doubled costs,
        (-1, 0) without a path; (B,) expansions; (B + 1,) offsets of the paths in the cells; the
        number of problems solved, less than B if the next one is refused; and why it is refused: 0
        if an end is outside or occupied, otherwise the doubled cost that is too high to be exact.
    """
    count = len(starts)
    lattice = lattice_of(terrains.shape[1:], rule)
    scratch = scratch_view(memory, lattice)
    cell_costs = np.zeros(lattice.cells, np.uint8)
    sums = np.empty((count, 2), np.int64)
    expansions = np.empty(count, np.int64)
    offsets = np.zeros(count + 1, np.int64)
    cells = np.empty((64 * count + 64, 2), np.int64)
    used = 0
    for b in range(count):
        terrain = terrains[b if len(terrains) > 1 else 0]
        if b == 0 or len(terrains) > 1:  # Without problems there may be no terrain to load, either.
            padded = load_terrain(terrain, lattice, cell_costs, scratch.came_from)
        min_cost = 0 if allow_occupied_ends else 1
        if not _is_end(terrain, starts[b], min_cost) or not _is_end(terrain, goals[b], min_cost):
            return cells, sums, expansions, offsets, b, np.int64(0)
        start = cell_at(starts[b, 0], starts[b, 1], lattice)
        goal = cell_at(goals[b, 0], goals[b, 1], lattice)
        sums[b, 0] = -1
        sums[b, 1] = 0
        expansions[b] = 0
        offsets[b + 1] = used
        if cell_costs[start] == 0 or cell_costs[goal] == 0:
            continue
        if weights is None:  # A*: numba leaves out the other search.
            expansions[b], pushes, high_cost = terrain_astar(start, goal, padded, lattice, scratch)
        else:
            expansions[b], pushes, high_cost = terrain_best_first(
                start, goal, weights, padded, lattice, scratch
            )
        if high_cost:
            return cells, sums, expansions, offsets, b, high_cost
        straight, diagonal = count_moves(scratch.came_from, start, goal, lattice)
        length = count_path_cells(straight, diagonal)
        if length:
            sums[b, 0], sums[b, 1] = _sums_of_path(scratch.came_from, start, goal, padded, lattice)
        cells = with_capacity(cells, used, length)
        write_cells(scratch.came_from, goal, lattice, cells[used : used + length])
        used += length
        offsets[b + 1] = used
        wipe(scratch, pushes)
    return cells[:used], sums, expansions, offsets, count, np.int64(0)


@kernel
def follow_terrain_fields(
    terrains: Bytes, starts: Ints, goals: Ints, rule: MoveRule, memory: Bytes
) -> tuple[Ints, Ints, Ints, Ints, Int, Int]:
    """Search problem b by A* whose heuristic is the exact cost to ``goals[b]``, for B problems.

    It expands the cells of a single path, and from each of them takes the last optimal move, as
    `follow_goal_fields` explains.

    Args:
        terrains: (B, H, W), or (1, H, W) for terrain that all problems share.
        starts: (B, 2) cells.
        goals: (B, 2) cells.
        rule: which moves are legal.
        memory: for the `Scratch` of `shortest_terrain_costs`.

    Returns:
        The cells (M, 2) of all paths, one after another; (B, 2) sums S and D of the doubled costs,
        (-1, 0) without a path; (B,) numbers of free cells that reach the goal; (B + 1,) offsets of
        the paths in the cells; and two numbers as from `solve_on_terrain`.
    """
    count = len(starts)
    lattice = lattice_of(terrains.shape[1:], rule)
    scratch = scratch_view(memory, lattice)
    optimal_moves = scratch.came_from
    cell_costs = np.zeros(lattice.cells, np.uint8)
    sums = np.empty((count, 2), np.int64)
    field_sizes = np.empty(count, np.int64)
    offsets = np.zeros(count + 1, np.int64)
    cells = np.empty((64 * count + 64, 2), np.int64)
    used = 0
    for b in range(count):
        terrain = terrains[b if len(terrains) > 1 else 0]
        if not _is_end(terrain, starts[b], 1) or not _is_end(terrain, goals[b], 1):
            return cells, sums, field_sizes, offsets, b, np.int64(0)
        padded = load_terrain(terrain, lattice, cell_costs, scratch.came_from)
        start = cell_at(starts[b, 0], starts[b, 1], lattice)
        goal = cell_at(goals[b, 0], goals[b, 1], lattice)
        high_cost = shortest_terrain_costs(np.full(1, goal), padded, lattice, scratch)
        if high_cost:
            return cells, sums, field_sizes, offsets, b, high_cost
        field_size = 0
        for k in range(lattice.cells):
            cost = scratch.g[np.uint64(k)]
            field_size += (cost >= 0) & (cost < INFINITY_ON_TERRAIN)
        field_sizes[b] = field_size
        sums[b, 0] = -1
        sums[b, 1] = 0
        if scratch.g[start] < INFINITY_ON_TERRAIN:
            sums[b, 0], sums[b, 1] = split_terrain_cost(scratch.g[start], padded)
            cell = start
            cells = with_capacity(cells, used, 1)
            cells[used, 0], cells[used, 1] = position(cell, lattice)
            used += 1
            while cell != goal:
                move = len(lattice.offsets) - 1
                while (optimal_moves[np.uint64(cell)] >> move) & 1 == 0:
                    move -= 1
                cell += lattice.offsets[move]
                cells = with_capacity(cells, used, 1)
                cells[used, 0], cells[used, 1] = position(cell, lattice)
                used += 1
        offsets[b + 1] = used
    return cells[:used], sums, field_sizes, offsets, count, np.int64(0)


@kernel
def astar_labels_on_terrain(
    terrains: Bytes,
    rooms: Ints,
    cells: Ints,
    first_segments: Ints,
    first_pairs: Ints,
    lattice: Lattice,
    scratch: Scratch,
    segment_table: Ints,
    pair_sums: Ints,
    moves: Bytes,
    first: Int,
    used: Int,
) -> tuple[Int, Int, Int, Int]:
    """Label maps by A* on terrain, and check that their seed points are free cells.

    A* searches each segment. One search around a seed point gives the costs to the rooms after the
    next one: since sqrt(2) is irrational, only one pair of sums S and D has the least cost.

    Args:
        terrains: (N, H, W).
        rooms: (N,) number of rooms of each map.
        cells: (N, R) padded cells of the seed points; cell 0, a wall, for those outside of the map.
        first_segments: (N or more,) the first segment of each map, a row of ``segment_table``.
        first_pairs: (N or more,) the first pair of each map, a row of ``pair_sums``.
        lattice: of the maps.
        scratch: memory of the searches.
        segment_table: (S, 2), to be filled with the moves and expansions of each segment.
        pair_sums: (P, 2), to be filled with the sums S and D between the seed points of each pair,
            (-1, 0) without a path.
        moves: to be filled with the moves of all segments.
        first: the map to begin with; those before it are done.
        used: how many moves the maps before ``first`` have.

    Returns:
        The number of maps that are done; the number of their moves; and why the next map is not
        done: the room whose seed point is not a free cell, or -1; and the doubled cost that is too
        high to be exact, or 0. With -1 and 0, its moves do not fit into ``moves``.
    """
    no_cost = np.int64(0)
    cell_costs = np.zeros(lattice.cells, np.uint8)
    for m in range(first, len(terrains)):
        padded = load_terrain(terrains[m], lattice, cell_costs, scratch.came_from)
        for room in range(rooms[m]):
            if cell_costs[cells[m, room]] == 0:
                return m, used, room, no_cost
        used_before = used
        pair = first_pairs[m]
        for room in range(rooms[m] - 1):
            start = cells[m, room]
            goal = cells[m, room + 1]
            load_terrain(terrains[m], lattice, cell_costs, scratch.came_from)
            expansions, _, high_cost = terrain_astar(start, goal, padded, lattice, scratch)
            if high_cost:
                return m, used_before, -1, high_cost
            straight, diagonal = count_moves(scratch.came_from, start, goal, lattice)
            length = max(straight + diagonal, 0)
            segment_table[first_segments[m] + room, 0] = length
            segment_table[first_segments[m] + room, 1] = expansions
            if used + length > len(moves):
                return m, used_before, -1, no_cost
            write_moves(scratch.came_from, goal, length, lattice, moves, used)
            used += length
            pair_sums[pair, 0] = -1
            pair_sums[pair, 1] = 0
            if straight >= 0:
                pair_sums[pair, 0], pair_sums[pair, 1] = split_terrain_cost(scratch.g[goal], padded)
            pair += 1
            if room + 2 == rooms[m]:
                continue  # There is no later room than that of the segment.
            high_cost = shortest_terrain_costs(np.full(1, start), padded, lattice, scratch)
            if high_cost:
                return m, used_before, -1, high_cost
            for later_room in range(room + 2, rooms[m]):
                cost = scratch.g[cells[m, later_room]]
                pair_sums[pair, 0] = -1
                pair_sums[pair, 1] = 0
                if cost < INFINITY_ON_TERRAIN:
                    pair_sums[pair, 0], pair_sums[pair, 1] = split_terrain_cost(cost, padded)
                pair += 1
    return len(terrains), used, -1, no_cost


@inlined
def _is_end(terrain: Bytes, cell: Ints, min_cost: Int) -> Int:
    """Return whether ``cell`` (row, col) is inside ``terrain`` and costs at least ``min_cost``."""
    row = cell[0]  # Unpacking an array takes long to compile.
    column = cell[1]
    is_inside = 0 <= row < terrain.shape[0] and 0 <= column < terrain.shape[1]
    return is_inside and terrain[row, column] >= min_cost


@kernel
def write_terrain_field(
    terrain: Bytes, row: Int, column: Int, rule: MoveRule, memory: Bytes, field: Float32s
) -> Int:
    """Write the cost from every cell to (row, column) into ``field``, -1 where there is no path.

    Args:
        terrain: (H, W).
        row: of the goal.
        column: of the goal.
        rule: which moves are legal.
        memory: for the `Scratch` of the search.
        field: (H, W), to be filled with costs in cells.

    Returns:
        0, or the doubled cost that is too high to be exact; then nothing is written.
    """
    lattice = lattice_of(terrain.shape, rule)
    scratch = scratch_view(memory, lattice)
    cell_costs = np.zeros(lattice.cells, np.uint8)
    padded = load_terrain(terrain, lattice, cell_costs, scratch.came_from)
    high_cost = shortest_terrain_costs(
        np.full(1, cell_at(row, column, lattice)), padded, lattice, scratch
    )
    if high_cost:
        return high_cost
    for i in range(terrain.shape[0]):
        for j in range(terrain.shape[1]):
            field[i, j] = cost_in_cells(scratch.g[cell_at(i, j, lattice)], padded)
    return np.int64(0)


def min_cell_costs(terrain: Bytes) -> Ints:
    """Return the smallest cost of a free cell of each map, (...) int64 for terrain (..., H, W).

    ``terrain`` must be uint8. The cost is 256 for a map without a free cell.
    """
    # As unsigned bytes, 0 - 1 is 255, so occupied cells are never the smallest. This takes a
    # twentieth of the time of selecting the free cells.
    costs_less_one = terrain - np.uint8(1)
    min_costs: Ints = costs_less_one.min(axis=(-2, -1)).astype(np.int64) + 1
    return min_costs


def costs_from_sums(sums: Ints, movement: Movement) -> Floats:
    """Return the costs (n,) in cells of the sums S and D (n, 2), -1 where S is negative."""
    straight_sums, diagonal_sums = sums.T
    costs = (straight_sums + diagonal_sums * movement.diagonal_cost) / 2
    return np.where(straight_sums < 0, -1.0, costs)


def terrain_path_cost(terrain: Bytes, path: Ints, movement: Movement) -> float:
    """Return the cost in cells of a legal ``path`` (k, 2) on ``terrain`` (H, W)."""
    cell_costs = terrain[path[:, 0], path[:, 1]].astype(np.int64)
    move_sums = cell_costs[:-1] + cell_costs[1:]
    is_diagonal = np.all(path[:-1] != path[1:], axis=1)
    diagonal_sum = int(move_sums[is_diagonal].sum())
    straight_sum = int(move_sums.sum()) - diagonal_sum
    return float((straight_sum + diagonal_sum * movement.diagonal_cost) / 2)
