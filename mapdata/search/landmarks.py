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
from mapdata.jit import Int, inlined, kernel
from mapdata.search.ground import EXACT, TOO_LONG
from mapdata.search.kernels import (
    Scratch,
    best_first_heap,
    count_moves,
    flood,
    shortest_costs,
    with_capacity,
    write_cells,
)
from mapdata.search.lattice import (
    INFINITY,
    UNSEEN,
    WALL,
    Lattice,
    cell_or_wall,
    count_path_cells,
    load,
    only,
)
from mapdata.search.solving import Solved


@inlined
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


@inlined
def landmark_costs(
    grid: Bytes, count: Int, lattice: Lattice, scratch: Scratch
) -> tuple[Ints, Int, Int]:
    """Place landmarks on a grid (H, W), and return the costs between them and all cells.

    Args:
        grid: with a free cell, of zeros and ones.
        count: the largest number of landmarks; a component with fewer cells gets one per cell.
        lattice: of the map.
        scratch: for the searches; it need not be loaded.

    Returns:
        Costs (landmarks, cells) in 1 / UNIT, INFINITY without a path and -1 in walls; the number of
        cells that the floods visited to place them, all floods together; and EXACT, or TOO_LONG
        where a path is too long for exact costs.
    """
    costs = np.empty((count, lattice.cells), np.int64)
    load(grid, scratch.came_from)
    first_cell, component_size, free_cells = _largest_component(lattice, scratch)
    load(grid, scratch.came_from)
    if shortest_costs(only(first_cell), INFINITY, lattice, scratch):
        return costs[:0], free_cells, TOO_LONG
    # The first landmark is the cell that is farthest from the first one of the component. Each
    # later landmark is farthest from the landmarks before it.
    landmark = _farthest(scratch.g, lattice)
    nearest = np.empty(lattice.cells, np.int64)
    for k in range(lattice.cells):
        nearest[k] = INFINITY
    placed = 0
    while placed < min(count, component_size):
        load(grid, scratch.came_from)
        if shortest_costs(only(landmark), INFINITY, lattice, scratch):
            return costs[:0], free_cells, TOO_LONG
        for k in range(lattice.cells):
            costs[placed, k] = scratch.g[k]
            nearest[k] = min(nearest[k], scratch.g[k])
        placed += 1
        landmark = _farthest(nearest, lattice)
    # The components take all free cells. Then there is a flood from the first cell of the largest
    # one, and a flood from each landmark.
    visited = free_cells + (placed + 1) * component_size
    return costs[:placed], visited, EXACT


@kernel
def solve_with_landmarks(
    grids: Bytes, starts: Ints, goals: Ints, landmarks: Int, lattice: Lattice, scratch: Scratch
) -> tuple[Solved, Ints]:
    """Search problem b from ``starts[b]`` to ``goals[b]`` on ``grids[b]`` by A* with landmarks.

    Args:
        grids: (B, H, W), or (1, H, W) for a map that all problems share.
        starts: (B, 2) cells.
        goals: (B, 2) cells.
        landmarks: the largest number of landmarks on a map.
        lattice: of the maps.
        scratch: memory of the searches.

    Returns:
        The paths; and the numbers of cells, (B,), that floods visited to place the landmarks of
        each problem: on a map that all problems share, 0 after the first problem.
    """
    count = len(starts)
    shape = grids.shape[1:]
    came_from = scratch.came_from
    sums = np.empty((count, 2), np.int64)
    expansions = np.empty(count, np.int64)
    prepared = np.empty(count, np.int64)
    offsets = np.empty(count + 1, np.int64)
    cells = np.empty((64 * count + 64, 2), np.int64)
    costs = np.empty((0, 0), np.int64)
    offsets[0] = 0
    used = 0
    done = 0
    high_cost = EXACT
    for b in range(count):
        grid = grids[b if len(grids) > 1 else 0]
        is_valid = load(grid, came_from)
        start = cell_or_wall(starts[b, 0], starts[b, 1], *shape)
        goal = cell_or_wall(goals[b, 0], goals[b, 1], *shape)
        if not is_valid or came_from[start] == WALL or came_from[goal] == WALL:
            break
        prepared[b] = 0
        if b == 0 or len(grids) > 1:
            costs, prepared[b], high_cost = landmark_costs(grid, landmarks, lattice, scratch)
            if high_cost:
                break
            load(grid, came_from)
        # All landmarks lie in one component, so one stands for all.  Without a path to both ends
        # they say nothing.
        usable = costs
        if len(costs) and (costs[0, start] == INFINITY or costs[0, goal] == INFINITY):
            usable = costs[:0]
        expansions[b], _, high_cost = best_first_heap(
            start, goal, (1, 1.0), usable, lattice, scratch
        )
        if high_cost:
            break
        straight, diagonal = count_moves(came_from, start, goal, lattice)
        sums[b, 0] = straight
        sums[b, 1] = diagonal
        length = count_path_cells(straight, diagonal)
        cells = with_capacity(cells, used, length)
        write_cells(came_from, goal, length, lattice, cells, used)
        used += length
        offsets[b + 1] = used
        done += 1
    return Solved(cells[:used], sums, expansions, offsets, done, high_cost), prepared
