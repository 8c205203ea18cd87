"""A* with landmarks: its heuristic knows the exact costs from a few cells of the map.

For a landmark L and costs d, the triangle inequality gives ``d(cell, goal) >= |d(L, cell) - d(L,
goal)|``. The heuristic is the largest of these bounds and the distance on an empty map, so paths
are optimal and no cell is expanded twice.

Landmarks are chosen from the map alone. They lie in the largest connected component of the free
cells, each as far as possible from those before it (Goldberg and Harrelson, "Computing the shortest
path: A* search meets graph theory", SODA 2005: "farthest" landmarks). In other components the
heuristic is that of A*.
"""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.jit import Int, kernel
from mapdata.movement import STEPS
from mapdata.search.ground import EXACT, is_usable_end
from mapdata.search.kernels import (
    Scratch,
    count_moves,
    flood,
    insert_in_heap,
    remove_heap_top,
    scratch_view,
    shortest_costs,
    with_capacity,
    write_cells,
)
from mapdata.search.lattice import (
    CLOSED,
    INFINITY,
    UNIT,
    UNSEEN,
    WALL,
    Lattice,
    MoveRule,
    cell_at,
    count_path_cells,
    heuristic,
    is_legal,
    lattice_of,
    load,
    position,
)
from mapdata.search.solving import Solved


@kernel
def _largest_component(lattice: Lattice, scratch: Scratch) -> tuple[Int, Int, Int]:
    """Find the largest component of a map that is loaded; of equal ones that which comes first.

    Afterwards the map has to be loaded again.

    Returns:
        The first cell of the component, 0 without a free cell; the number of its cells; the number
        of all free cells.
    """
    no_targets = np.empty(0, np.int64)
    first_cell: Int = 0
    largest: Int = 0
    free_cells: Int = 0
    for k in range(lattice.cells):
        if scratch.came_from[k] == UNSEEN:
            size = flood(k, no_targets, lattice, scratch)
            free_cells += size
            if size > largest:
                largest = size
                first_cell = k
    return first_cell, largest, free_cells


@kernel
def _farthest(costs: Ints, lattice: Lattice) -> Int:
    """Return the first cell of the largest finite cost; costs (cells,) as from `shortest_costs`."""
    farthest: Int = 0
    largest: Int = -1
    for k in range(lattice.cells):
        if largest < costs[k] < INFINITY:
            largest = costs[k]
            farthest = k
    return farthest


@kernel
def landmark_costs(grid: Bytes, count: Int, lattice: Lattice, scratch: Scratch) -> tuple[Ints, Int]:
    """Place landmarks on a grid (H, W), and return the costs between them and all cells.

    Args:
        grid: with a free cell, of zeros and ones.
        count: the largest number of landmarks; a component with fewer cells gets one per cell.
        lattice: of the map.
        scratch: for the searches; it need not be loaded.

    Returns:
        Costs (landmarks, cells) in 1 / UNIT, INFINITY without a path and -1 in walls; and the
        number of cells that the floods visited to place them, all floods together.

    Raises:
        ValueError: a path is too long for exact costs.
    """
    costs = np.empty((count, lattice.cells), np.int64)
    load(grid, scratch.came_from)
    first_cell, component_size, free_cells = _largest_component(lattice, scratch)
    load(grid, scratch.came_from)
    shortest_costs(np.full(1, first_cell), INFINITY, lattice, scratch)
    # The first landmark is the cell that is farthest from the first one of the component. Each
    # later landmark is farthest from the landmarks before it.
    landmark = _farthest(scratch.g, lattice)
    nearest = np.full(lattice.cells, INFINITY)
    placed = 0
    while placed < min(count, component_size):
        load(grid, scratch.came_from)
        shortest_costs(np.full(1, landmark), INFINITY, lattice, scratch)
        for k in range(lattice.cells):
            costs[placed, k] = scratch.g[k]
            nearest[k] = min(nearest[k], scratch.g[k])
        placed += 1
        landmark = _farthest(nearest, lattice)
    # The components take all free cells. Then there is a flood from the first cell of the largest
    # one, and a flood from each landmark.
    visited = free_cells + (placed + 1) * component_size
    return costs[:placed], visited


@kernel
def _landmark_bound(cell: Int, goal: Int, costs: Ints) -> Int:
    """Return the largest bound of landmarks on the cost from ``cell`` to ``goal``, or 0."""
    bound: Int = 0
    for k in range(len(costs)):
        bound = max(bound, abs(costs[k, cell] - costs[k, goal]))
    return bound


@kernel
def landmark_astar(start: Int, goal: Int, costs: Ints, lattice: Lattice, scratch: Scratch) -> Int:
    """Run A* between two free padded cells; the heuristic knows ``costs`` of `landmark_costs`.

    The order is that of mapdata's A* (docs/format.md) with another heuristic: the smallest f first,
    and among equal f the most recently pushed cell. The heuristic is consistent, so the cost of an
    expanded cell is final.

    Args:
        start: padded cell, free.
        goal: padded cell, free.
        costs: (landmarks, cells).
        lattice: of the map.
        scratch: with the map loaded in ``came_from``.

    Returns:
        The number of expansions.
    """
    came_from = scratch.came_from
    g = scratch.g
    pushed = scratch.pushed
    heap = scratch.links
    f = scratch.f
    goal_row, goal_column = position(goal, lattice)
    # All landmarks lie in one component, so one stands for all.  Without a path to both ends they
    # say nothing.
    if len(costs) and (costs[0, start] == INFINITY or costs[0, goal] == INFINITY):
        costs = costs[:0]
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
        row, column = position(cell, lattice)
        for move in range(len(lattice.offsets)):
            neighbour = np.uint64(cell + lattice.offsets[move])
            tentative_g = g[cell] + (UNIT if move < 4 else lattice.diagonal_cost)
            state = came_from[neighbour]
            if state == WALL or (state != UNSEEN and g[neighbour] <= tentative_g):
                continue
            if not is_legal(came_from, cell, move, lattice):
                continue
            rows_to_goal = row + STEPS[move, 0] - goal_row
            columns_to_goal = column + STEPS[move, 1] - goal_column
            empty_map_bound = heuristic(rows_to_goal, columns_to_goal, lattice)
            h = max(empty_map_bound, _landmark_bound(neighbour, goal, costs))
            came_from[neighbour] = move
            g[neighbour] = tentative_g
            pushed[pushes] = neighbour
            insert_in_heap(heap, f, heap_size, pushes, tentative_g + h)
            heap_size += 1
            pushes += np.uint32(1)
    return expansions


@kernel
def solve_with_landmarks(
    grids: Bytes, starts: Ints, goals: Ints, landmarks: Int, rule: MoveRule, memory: Bytes
) -> tuple[Solved, Ints]:
    """Search problem b from ``starts[b]`` to ``goals[b]`` on ``grids[b]`` by `landmark_astar`.

    Args:
        grids: (B, H, W), or (1, H, W) for a map that all problems share.
        starts: (B, 2) cells.
        goals: (B, 2) cells.
        landmarks: the largest number of landmarks on a map.
        rule: which moves are legal.
        memory: for the `Scratch` of the searches.

    Returns:
        The paths; and the numbers of cells, (B,), that floods visited to place the landmarks of
        each problem: on a map that all problems share, 0 after the first problem.
    """
    count = len(starts)
    lattice = lattice_of(grids.shape[1:], rule)
    scratch = scratch_view(memory, lattice)
    sums = np.empty((count, 2), np.int64)
    expansions = np.empty(count, np.int64)
    prepared = np.zeros(count, np.int64)
    offsets = np.zeros(count + 1, np.int64)
    cells = np.empty((64 * count + 64, 2), np.int64)
    costs = np.empty((0, 0), np.int64)
    used = 0
    for b in range(count):
        grid = grids[b if len(grids) > 1 else 0]
        is_valid = load(grid, scratch.came_from)
        if (
            not is_valid
            or not is_usable_end(starts[b], grids.shape[1:], 0, lattice, scratch.came_from)
            or not is_usable_end(goals[b], grids.shape[1:], 0, lattice, scratch.came_from)
        ):
            return Solved(cells, sums, expansions, offsets, b, EXACT), prepared
        if b == 0 or len(grids) > 1:
            costs, prepared[b] = landmark_costs(grid, landmarks, lattice, scratch)
            load(grid, scratch.came_from)
        start = cell_at(starts[b, 0], starts[b, 1], lattice)
        goal = cell_at(goals[b, 0], goals[b, 1], lattice)
        expansions[b] = landmark_astar(start, goal, costs, lattice, scratch)
        straight, diagonal = count_moves(scratch.came_from, start, goal, lattice)
        sums[b, 0] = straight
        sums[b, 1] = diagonal
        length = count_path_cells(straight, diagonal)
        cells = with_capacity(cells, used, length)
        write_cells(scratch.came_from, goal, lattice, cells[used : used + length])
        used += length
        offsets[b + 1] = used
    return Solved(cells[:used], sums, expansions, offsets, count, EXACT), prepared
