"""The kernels of sampling.py for terrain: the same draws, on maps whose cells have costs."""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.jit import Int, kernel
from mapdata.problems.sampling import pair_of_number
from mapdata.problems.sources import Bands
from mapdata.rng import PROBLEM, block, bounded
from mapdata.search.kernels import (
    Scratch,
    count_moves,
    new_scratch,
    with_capacity,
    write_cells,
)
from mapdata.search.lattice import (
    ASTAR,
    Lattice,
    MoveRule,
    cell_at,
    count_path_cells,
    lattice_of,
    position,
)
from mapdata.search.terrain import (
    PaddedTerrain,
    cost_in_cells,
    load_terrain,
    shortest_terrain_costs,
    terrain_astar,
    terrain_heuristic,
)


@kernel
def sample_terrain_problems(
    terrains: Bytes,
    goals: Ints | None,
    seed: np.uint64,
    epoch: Int,
    indices: Ints,
    draws: tuple[Int, Int],
    min_distance: float,
    bands: Bands | None,
    rule: MoveRule,
) -> tuple[Ints, Ints, Ints, Ints, Int, Int]:
    """Sample a problem on each terrain: a goal, then one of the starts that are far enough from it.

    The draws are those of `sample_problems`, and docs/format.md, section 6, fixes them. A search
    around the goal gives the costs of all starts. So a problem outside of the bands of distance and
    hardness is dropped without a search for its path.

    If ``min_distance`` is 1 and ``bands`` is None, `sample_problems` on the grid without costs
    samples the same problems in less time, because no move costs less than 1.

    Args:
        terrains: (B, H, W).
        goals: (B, 2) cells; None if goals are drawn, too.
        seed: sampling seed.
        epoch: pass over the data.
        indices: (B,) number of each problem.
        draws: number of the first draw that is tried on each map, and of the first one that is not.
        min_distance: smallest cost of a path from start to goal, at least 1, so that the goal is no
            start.
        bands: as `Random.bands`; None if ``min_distance`` is the only condition.
        rule: as `move_rule` returns it.

    Returns:
        The start and the goal of each problem (B, 4), -1 if none was found; the cells (M, 2) of
        their paths by A* and the offsets (B + 1,) in there, and the expansions (B,), all empty or 0
        if ``bands`` is None; the first problem whose terrain has a cost that is too high to be
        exact, and this doubled cost. They are B and 0 if all costs are exact; otherwise the
        problems from that one on are not sampled.
    """
    lattice = lattice_of(terrains.shape[1:], rule)
    scratch = new_scratch(ASTAR, lattice)
    cell_costs = np.zeros(lattice.cells, np.uint8)
    count = len(terrains)
    ends = np.full((count, 4), -1)
    offsets = np.zeros(count + 1, np.int64)
    expansions = np.zeros(count, np.int64)
    cells = np.empty((64 * count + 64, 2), np.int64)
    starts = np.empty(lattice.cells, np.int64)
    for b in range(count):
        used = offsets[b]
        offsets[b + 1] = used
        padded = load_terrain(terrains[b], lattice, cell_costs, scratch.came_from)
        free_cells = np.flatnonzero(cell_costs)
        if len(free_cells) < 2:
            continue
        for draw in range(*draws):
            goal_random, start_random, _, _ = block(
                seed, np.uint64(indices[b]), epoch, PROBLEM, draw
            )
            if goals is None:
                goal = free_cells[bounded(goal_random, 0, len(free_cells) - 1)]
            else:
                if goals[b, 0] < 0 or terrains[b, goals[b, 0], goals[b, 1]] == 0:
                    break
                goal = cell_at(goals[b, 0], goals[b, 1], lattice)
            high_cost = shortest_terrain_costs(np.full(1, goal), padded, lattice, scratch)
            if high_cost:
                return ends, cells[:used], offsets, expansions, b, high_cost
            start_count = 0
            for cell in free_cells:
                if cost_in_cells(scratch.g[cell], padded) >= min_distance:
                    starts[start_count] = cell
                    start_count += 1
            if start_count:
                # All starts are equally probable, numbered in row-major order.
                start = starts[bounded(start_random, 0, start_count - 1)]
                length = 0
                if bands is not None:
                    load_terrain(terrains[b], lattice, cell_costs, scratch.came_from)
                    length, expansions[b] = _search_within(
                        bands, start, goal, padded, lattice, scratch
                    )
                if length >= 0:
                    ends[b, 0], ends[b, 1] = position(start, lattice)
                    ends[b, 2], ends[b, 3] = position(goal, lattice)
                    cells = with_capacity(cells, used, length)
                    write_cells(scratch.came_from, goal, lattice, cells[used : used + length])
                    offsets[b + 1] = used + length
                    break
            elif goals is not None:
                break  # The only goal has no start.
    return ends, cells[: offsets[count]], offsets, expansions, count, np.int64(0)


@kernel
def _search_within(
    bands: Bands,
    start: Int,
    goal: Int,
    padded: PaddedTerrain,
    lattice: Lattice,
    scratch: Scratch,
) -> tuple[Int, Int]:
    """Search the path of a problem, unless its cost alone shows that it does not fit.

    Args:
        bands: the limits of cost, of hardness and of the number of cells, both included.
        start: padded cell, from which a path leads to the goal.
        goal: padded cell.
        padded: the terrain.
        lattice: of the map.
        scratch: with the map loaded in ``came_from``, and the costs to the goal in ``g``.

    Returns:
        The number of cells of the path, and the expansions; (-1, 0) if it is outside of a band.
    """
    distances, ratios, lengths = bands
    start_row, start_column = position(start, lattice)
    goal_row, goal_column = position(goal, lattice)
    lower_bound = cost_in_cells(
        terrain_heuristic(start_row - goal_row, start_column - goal_column, padded, lattice), padded
    )
    cost = cost_in_cells(scratch.g[start], padded)
    if cost > distances[1]:
        return -1, 0
    if not ratios[0] <= cost / lower_bound <= ratios[1]:
        return -1, 0
    # All costs are exact, as the search around the goal has shown, so that A* finds no high cost.
    expansions, _, _ = terrain_astar(start, goal, padded, lattice, scratch)
    straight, diagonal = count_moves(scratch.came_from, start, goal, lattice)
    length = count_path_cells(straight, diagonal)
    return (length, expansions) if lengths[0] <= length <= lengths[1] else (-1, 0)


@kernel
def solve_terrain_pairs(
    terrains: Bytes,
    seed_points: Ints,
    rooms: Ints,
    seed: np.uint64,
    epoch: Int,
    indices: Ints,
    only_route: Int,
    keep_unsolvable: Int,
    rule: MoveRule,
) -> tuple[Ints, Ints, Ints, Ints, Int, Int]:
    """Sample a pair of seed points on each terrain and search its path by A*.

    The pairs are those of `solve_pairs`: whether a pair has a path does not depend on costs.

    Args:
        terrains: (B, H, W).
        seed_points: (B, R, 2) cells.
        rooms: (B,) number of seed points.
        seed: sampling seed.
        epoch: pass over the data.
        indices: (B,) number of each problem.
        only_route: whether the pairs are those of the route, (q, q + 1), instead of all i < j.
        keep_unsolvable: whether pairs without a path are kept.
        rule: as `move_rule` returns it.

    Returns:
        The same as `sample_terrain_problems`.
    """
    count = len(terrains)
    lattice = lattice_of(terrains.shape[1:], rule)
    scratch = new_scratch(ASTAR, lattice)
    cell_costs = np.zeros(lattice.cells, np.uint8)
    ends = np.full((count, 4), -1)
    offsets = np.zeros(count + 1, np.int64)
    expansions = np.zeros(count, np.int64)
    cells = np.empty((64 * count + 64, 2), np.int64)
    for b in range(count):
        n = rooms[b]
        used = offsets[b]
        offsets[b + 1] = used
        pairs = n - 1 if only_route else n * (n - 1) // 2
        random, _, _, _ = block(seed, np.uint64(indices[b]), epoch, PROBLEM, 0)
        first_pair = bounded(random, 0, pairs - 1)
        for attempt in range(pairs):
            i, j = pair_of_number((first_pair + attempt) % pairs, n, only_route)
            start = cell_at(seed_points[b, i, 0], seed_points[b, i, 1], lattice)
            goal = cell_at(seed_points[b, j, 0], seed_points[b, j, 1], lattice)
            if start == goal:
                continue
            padded = load_terrain(terrains[b], lattice, cell_costs, scratch.came_from)
            expansions[b] = 0
            length = 0
            if cell_costs[start] and cell_costs[goal]:
                expansions[b], _, high_cost = terrain_astar(start, goal, padded, lattice, scratch)
                if high_cost:
                    return ends, cells[:used], offsets, expansions, b, high_cost
                straight, diagonal = count_moves(scratch.came_from, start, goal, lattice)
                length = count_path_cells(straight, diagonal)
            if length or keep_unsolvable:
                ends[b, 0], ends[b, 1] = position(start, lattice)
                ends[b, 2], ends[b, 3] = position(goal, lattice)
                cells = with_capacity(cells, used, length)
                write_cells(scratch.came_from, goal, lattice, cells[used : used + length])
                offsets[b + 1] = used + length
                break
    return ends, cells[: offsets[count]], offsets, expansions, count, np.int64(0)
