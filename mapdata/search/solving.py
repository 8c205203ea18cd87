"""Many problems on maps with or without terrain: one loop for both (`mapdata.search.ground`).

The searches themselves are in `mapdata.search.kernels` for maps whose free cells all cost the same,
and in `mapdata.search.terrain` for terrain, because each is faster alone.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Float32s, Ints
from mapdata.jit import Int, inlined, kernel
from mapdata.search.ground import (
    EXACT,
    cost_in_cells,
    load_map,
    sums_of_cost,
    unit_of,
)
from mapdata.search.kernels import (
    Scratch,
    astar_manhattan,
    best_first_buckets,
    best_first_heap,
    count_moves,
    expansions_until,
    flood,
    scratch_view,
    shortest_costs,
    wipe,
    with_capacity,
    write_cells,
)
from mapdata.search.lattice import (
    BFS,
    INFINITY,
    WALL,
    CostWeights,
    Lattice,
    MoveRule,
    cell_at,
    cell_or_wall,
    count_path_cells,
    lattice_of,
    load,
    only,
    position,
)
from mapdata.search.terrain import (
    shortest_terrain_costs,
    sums_of_path,
    terrain_astar,
    terrain_best_first,
)


class Solved(NamedTuple):
    """The paths of B problems, as far as a kernel came.

    Attributes:
        cells: (M, 2) int64, the cells of all paths, one after another.
        sums: (B, 2) int64, (-1, 0) without a path: the numbers of straight and of diagonal moves,
            or on terrain the sums S and D of the doubled costs (`mapdata.search.ground`). Where
            moves of both kinds cost the same, all may count as straight.
        expansions: (B,) int64; 0 where an end is occupied.
        offsets: (B + 1,) int64, where each path begins in ``cells``, and where the last one ends.
        done: number of problems that are solved, less than B if the next one is refused. What the
            arrays hold from that one on has no meaning.
        high_cost: why it is refused: the doubled cost on its terrain that is too high to be exact,
            or TOO_LONG on a grid; 0 if an end is outside or occupied, or its grid holds other
            numbers than 0 and 1.
    """

    cells: Ints
    sums: Ints
    expansions: Ints
    offsets: Ints
    done: Int
    high_cost: Int


class Found(NamedTuple):
    """What one search found.

    Attributes:
        length: number of cells of the path, 0 without one.
        straight_sum: first of the sums of `Solved`.
        diagonal_sum: second of the sums of `Solved`.
        expansions: number of expansions, 0 if an end is occupied.
        pushes: number of pushes plus 1, as `wipe` takes it.
        high_cost: as in `Solved`, for this search, which stopped there; or 0.
    """

    length: Int
    straight_sum: Int
    diagonal_sum: Int
    expansions: Int
    pushes: Int
    high_cost: Int


# --- one problem --------------------------------------------------------------------------------


@inlined
def shortest_costs_on(
    sources: Ints,
    cell_costs: Bytes | None,
    ground: Any,
    lattice: Lattice,
    scratch: Scratch,
) -> Int:
    """Write the costs of all cells to the nearest source and their optimal moves.

    Those are as from `shortest_costs`, and on terrain as from `shortest_terrain_costs`.

    Args:
        sources: (n,) padded cells.
        cell_costs: as `load_map` takes it, an argument of the kernel, for numba to know it.
        ground: of the map: `PaddedTerrain`, or None if ``cell_costs`` is.
        lattice: of the map.
        scratch: with the map loaded in ``came_from``; terrain has to be loaded only once.

    Returns:
        EXACT; or TOO_LONG or the doubled cost on terrain that is too high to be exact, at which the
        search stopped.
    """
    if cell_costs is None:
        return shortest_costs(sources, INFINITY, lattice, scratch)
    return shortest_terrain_costs(sources, ground, lattice, scratch)


@inlined
def search_loaded(
    start: Int,
    goal: Int,
    weights: CostWeights,
    diagonals: Int | None,
    cell_costs: Bytes | None,
    ground: Any,
    lattice: Lattice,
    scratch: Scratch,
) -> Found:
    """Search a path between two padded cells of a map that is loaded.

    Since this is a part of kernels, ``weights``, ``diagonals`` and ``cell_costs`` have to be
    arguments of the kernel, or None, for numba to know them.

    Args:
        start: padded cell.
        goal: padded cell.
        weights: which search; on terrain not BFS, which counts moves. numba compiles the searches
            of its type alone.
        diagonals: those of the lattice, from `diagonal_moves`.
        cell_costs: as `load_map` takes it.
        ground: of the map: `PaddedTerrain`, or None if ``cell_costs`` is.
        lattice: of the map.
        scratch: with the map loaded in ``came_from``.
    """
    came_from = scratch.came_from
    expansions: Int = 0
    pushes: Int = 1
    high_cost = EXACT
    straight: Int = -1
    diagonal: Int = 0
    if came_from[start] != WALL and came_from[goal] != WALL:
        if cell_costs is None:
            if weights is None:
                if diagonals is None:
                    expansions, pushes = astar_manhattan(start, goal, lattice, scratch)
                else:
                    expansions, pushes, high_cost = best_first_buckets(
                        start, goal, lattice, scratch
                    )
            elif weights == BFS:
                queue_length = flood(start, only(goal), lattice, scratch)
                expansions = expansions_until(scratch.pushed, queue_length, goal)
            else:
                no_landmarks = np.empty((0, 0), np.int64)
                expansions, pushes, high_cost = best_first_heap(
                    start, goal, weights, no_landmarks, lattice, scratch
                )
        elif weights is None:
            expansions, pushes, high_cost = terrain_astar(start, goal, ground, lattice, scratch)
        else:
            expansions, pushes, high_cost = terrain_best_first(
                start, goal, weights, ground, lattice, scratch
            )
        straight, diagonal = count_moves(came_from, start, goal, lattice)
    length = count_path_cells(straight, diagonal)
    if cell_costs is None:
        if weights is not None and weights == BFS:
            straight += diagonal  # BFS weighs no moves, so all of them count as straight.
            diagonal = 0
    elif length:
        straight, diagonal = sums_of_path(came_from, start, goal, ground, lattice)
    return Found(length, straight, diagonal, expansions, pushes, high_cost)


# --- many problems ------------------------------------------------------------------------------


@kernel
def solve_problems(
    maps: Bytes,
    cell_costs: Bytes | None,
    starts: Ints,
    goals: Ints,
    allow_occupied_ends: Int,
    weights: CostWeights,
    diagonals: Int | None,
    lattice: Lattice,
    scratch: Scratch,
) -> Solved:
    """Search problem b from ``starts[b]`` to ``goals[b]`` on ``maps[b]``, for B problems.

    Args:
        maps: (B, H, W) grids or terrain, or (1, H, W) for a map that all problems share.
        cell_costs: (cells,) zeros for terrain; None for grids.
        starts: (B, 2) cells.
        goals: (B, 2) cells.
        allow_occupied_ends: 1 if starts and goals may be occupied: such a problem has no path, and
            no cell is expanded. Otherwise 0.
        weights: which search; on terrain not BFS.
        diagonals: those of the lattice, from `diagonal_moves`; None on terrain.
        lattice: of the maps.
        scratch: memory of the search.
    """
    count = len(starts)
    shape = maps.shape[1:]
    came_from = scratch.came_from
    sums = np.empty((count, 2), np.int64)
    expansions = np.empty(count, np.int64)
    offsets = np.empty(count + 1, np.int64)
    cells = np.empty((64 * count + 64, 2), np.int64)
    offsets[0] = 0
    used = 0
    done = 0
    high_cost = EXACT
    is_bfs = False
    if weights is not None:
        is_bfs = weights == BFS
    for b in range(count):
        # On a shared map, A* wipes what it wrote. BFS touches most of a map, so that copying it
        # anew costs less.
        if b == 0 or len(maps) > 1 or is_bfs:
            map_ = maps[b if len(maps) > 1 else 0]
            is_valid, ground = load_map(map_, cell_costs, lattice, came_from)
            if not is_valid:
                break
        start = cell_or_wall(starts[b, 0], starts[b, 1], *shape)
        goal = cell_or_wall(goals[b, 0], goals[b, 1], *shape)
        are_free = came_from[start] != WALL and came_from[goal] != WALL
        if not are_free and (not allow_occupied_ends or start == 0 or goal == 0):
            break
        found = search_loaded(start, goal, weights, diagonals, cell_costs, ground, lattice, scratch)
        high_cost = found.high_cost
        if high_cost:
            break
        sums[b, 0] = found.straight_sum
        sums[b, 1] = found.diagonal_sum
        expansions[b] = found.expansions
        cells = with_capacity(cells, used, found.length)
        write_cells(came_from, goal, found.length, lattice, cells, used)
        used += found.length
        offsets[b + 1] = used
        if len(maps) == 1 and not is_bfs:
            wipe(scratch, found.pushes)
        done += 1
    return Solved(cells[:used], sums, expansions, offsets, done, high_cost)


@kernel
def solve_problem(
    grid: Bytes,
    start_row: Int,
    start_column: Int,
    goal_row: Int,
    goal_column: Int,
    weights: CostWeights,
    diagonals: Int | None,
    rule: MoveRule,
    memory: Bytes,
) -> tuple[Ints, Int, Int, Int, Int]:
    """Search one problem on ``grid`` (H, W), with ``memory`` for its `Scratch`.

    ``diagonals`` are those of the rule, from `diagonal_moves`.

    Returns:
        The cells of the path, (k, 2) int64; straight and diagonal moves, (-1, 0) without a path;
        expansions, 0 if an end is occupied or ``grid`` holds other numbers than 0 and 1; and the
        cost that is too high to be exact, as in `Found`.
    """
    lattice = lattice_of(grid.shape, rule)
    scratch = scratch_view(memory, lattice)
    is_valid = load(grid, scratch.came_from)
    if not is_valid or grid[start_row, start_column] or grid[goal_row, goal_column]:
        return np.empty((0, 2), np.int64), -1, 0, 0, EXACT
    start = cell_at(start_row, start_column, lattice)
    goal = cell_at(goal_row, goal_column, lattice)
    found = search_loaded(start, goal, weights, diagonals, None, None, lattice, scratch)
    path = np.empty((found.length, 2), np.int64)
    write_cells(scratch.came_from, goal, found.length, lattice, path, 0)
    return path, found.straight_sum, found.diagonal_sum, found.expansions, found.high_cost


@inlined
def _append_trace(
    optimal_moves: Bytes, start: Int, goal: Int, lattice: Lattice, cells: Ints, used: Int
) -> tuple[Ints, Int]:
    """Append the path by the last optimal move of each cell, from ``start`` to ``goal``.

    Args:
        optimal_moves: (cells,) bit sets, as `shortest_costs_on` writes them.
        start: padded cell, from which a path leads to the goal.
        goal: padded cell.
        lattice: of the map.
        cells: (capacity, 2) cells of the paths so far.
        used: number of these cells.

    Returns:
        ``cells``, moved to a larger array where it was full, and the new number of cells.
    """
    cell = start
    while True:
        if used == len(cells):  # Without this test, the calls take a third of the time.
            cells = with_capacity(cells, used, 1)
        cells[used, 0], cells[used, 1] = position(cell, lattice)
        used += 1
        if cell == goal:
            return cells, used
        move = len(lattice.offsets) - 1
        while (optimal_moves[np.uint64(cell)] >> move) & 1 == 0:
            move -= 1
        cell += lattice.offsets[move]


@kernel
def follow_goal_fields(
    maps: Bytes,
    cell_costs: Bytes | None,
    starts: Ints,
    goals: Ints,
    lattice: Lattice,
    scratch: Scratch,
) -> Solved:
    """Search problem b by A* whose heuristic is the exact cost to ``goals[b]``, for B problems.

    With this heuristic f is equal on all cells of shortest paths and larger on all others. Among
    equal f A* expands the cell that was pushed last. So it expands the cells of a single path: from
    each of them it takes the last optimal move, in the order of `STEPS`.

    Args:
        maps: (B, H, W) grids or terrain, or (1, H, W) for a map that all problems share.
        cell_costs: (cells,) zeros for terrain; None for grids.
        starts: (B, 2) cells.
        goals: (B, 2) cells.
        lattice: of the maps.
        scratch: memory of `shortest_costs_on`.

    Returns:
        The paths. In place of ``expansions`` there are the numbers of free cells from which a path
        leads to the goal.
    """
    count = len(starts)
    shape = maps.shape[1:]
    came_from = scratch.came_from
    sums = np.empty((count, 2), np.int64)
    field_sizes = np.empty(count, np.int64)
    offsets = np.empty(count + 1, np.int64)
    cells = np.empty((64 * count + 64, 2), np.int64)
    offsets[0] = 0
    used = 0
    done = 0
    high_cost = EXACT
    for b in range(count):
        map_ = maps[b if len(maps) > 1 else 0]
        is_valid, ground = load_map(map_, cell_costs, lattice, came_from)
        start = cell_or_wall(starts[b, 0], starts[b, 1], *shape)
        goal = cell_or_wall(goals[b, 0], goals[b, 1], *shape)
        if not is_valid or came_from[start] == WALL or came_from[goal] == WALL:
            break
        high_cost = shortest_costs_on(only(goal), cell_costs, ground, lattice, scratch)
        if high_cost:
            break
        field_size = 0
        for k in range(lattice.cells):
            cost = scratch.g[np.uint64(k)]
            field_size += (cost >= 0) & (cost < INFINITY)
        field_sizes[b] = field_size
        sums[b, 0] = -1
        sums[b, 1] = 0
        if scratch.g[start] < INFINITY:
            sums[b, 0], sums[b, 1] = sums_of_cost(scratch.g[start], ground)
            # After the search ``came_from`` holds the optimal moves.
            cells, used = _append_trace(came_from, start, goal, lattice, cells, used)
        offsets[b + 1] = used
        done += 1
    return Solved(cells[:used], sums, field_sizes, offsets, done, high_cost)


@kernel
def write_field(
    map_: Bytes,
    cell_costs: Bytes | None,
    row: Int,
    column: Int,
    rule: MoveRule,
    memory: Bytes,
    field: Float32s,
) -> tuple[Int, Int]:
    """Write the cost from every cell to (row, column) into ``field``, -1 where there is no path.

    Args:
        map_: (H, W) grid or terrain.
        cell_costs: (cells,) zeros for terrain; None for a grid.
        row: of the goal.
        column: of the goal.
        rule: which moves are legal.
        memory: for the `Scratch` of the search.
        field: (H, W), to be filled with costs in cells.

    Returns:
        Whether all cells of a grid are 0 or 1; and the doubled cost that is too high to be exact,
        or 0. If one of them refuses the map, nothing is written.
    """
    lattice = lattice_of(map_.shape, rule)
    scratch = scratch_view(memory, lattice)
    is_valid, ground = load_map(map_, cell_costs, lattice, scratch.came_from)
    if not is_valid:
        return False, EXACT
    goal = only(cell_at(row, column, lattice))
    high_cost = shortest_costs_on(goal, cell_costs, ground, lattice, scratch)
    if high_cost:
        return True, high_cost
    unit = unit_of(ground)
    for i in range(map_.shape[0]):
        for j in range(map_.shape[1]):
            field[i, j] = cost_in_cells(scratch.g[cell_at(i, j, lattice)], unit)
    return True, EXACT
