"""The kernel that samples pairs of seed points on terrain, whose cells have costs."""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.jit import Int, kernel
from mapdata.problems.sampling import pair_of_number
from mapdata.rng import PROBLEM, block, bounded
from mapdata.search.kernels import count_moves, new_scratch, with_capacity, write_cells
from mapdata.search.lattice import (
    ASTAR,
    MoveRule,
    cell_at,
    count_path_cells,
    lattice_of,
    position,
)
from mapdata.search.terrain import load_terrain, terrain_astar


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
        The start and the goal of each problem, their paths and expansions, as from `solve_pairs`;
        the first problem whose terrain has a cost that is too high to be exact, and this doubled
        cost. They are B and 0 if all costs are exact; otherwise the problems from that one on are
        not sampled.
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
