"""Pairs of seed points: which pair of a map is a problem, and its path."""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.jit import Int, kernel
from mapdata.rng import PROBLEM, block, bounded
from mapdata.search.ground import EXACT, load_map
from mapdata.search.kernels import Scratch, search_memory, with_capacity, write_cells
from mapdata.search.lattice import (
    CostWeights,
    Lattice,
    MoveRule,
    cell_at,
    diagonal_moves,
    position,
)
from mapdata.search.map_stack import MapStack
from mapdata.search.solving import Solved, search_loaded


def solve_pairs(
    maps: MapStack,
    seed_points: Ints,
    rooms: Ints,
    seed: np.uint64,
    epoch: int,
    indices: Ints,
    only_route: int,
    keep_unsolvable: int,
    weights: CostWeights,
    rule: MoveRule,
) -> tuple[Ints, Solved]:
    """Sample a pair of seed points on each map and search its path.

    If a pair has no path, the next one is tried, until all pairs of the map have been tried.
    Whether a pair has a path does not depend on costs.

    Args:
        maps: B maps, without terrain for BFS.
        seed_points: (B, R, 2) cells.
        rooms: (B,) number of seed points.
        seed: sampling seed.
        epoch: pass over the data.
        indices: (B,) number of each problem.
        only_route: whether the pairs are those of the route, (q, q + 1), instead of all i < j.
        keep_unsolvable: whether pairs without a path are kept.
        weights: BFS or ASTAR.
        rule: as `move_rule` returns it.

    Returns:
        The start and the goal of each problem (B, 4), -1 if no pair fits; and their paths. If a
        cost is too high to be exact, the problems from that one on are not sampled.
    """
    diagonals = diagonal_moves(rule) if maps.terrain is None else None
    ends, solved = _solve_pairs(
        *maps.ground,
        seed_points,
        rooms,
        seed,
        epoch,
        indices,
        only_route,
        keep_unsolvable,
        weights,
        diagonals,
        *search_memory(maps.grids.shape[1:], rule),
    )
    return ends, solved


@kernel
def _solve_pairs(
    maps: Bytes,
    cell_costs: Bytes | None,
    seed_points: Ints,
    rooms: Ints,
    seed: np.uint64,
    epoch: Int,
    indices: Ints,
    only_route: Int,
    keep_unsolvable: Int,
    weights: CostWeights,
    diagonals: Int | None,
    lattice: Lattice,
    scratch: Scratch,
) -> tuple[Ints, Solved]:
    """Do the work of `solve_pairs`; ``maps`` and ``cell_costs`` are from `MapStack.ground`.

    ``diagonals`` are those of the rule, from `diagonal_moves`; None on terrain.
    """
    count = len(maps)
    ends = np.full((count, 4), -1)
    sums = np.zeros((count, 2), np.int64)
    sums[:, 0] = -1
    offsets = np.zeros(count + 1, np.int64)
    expansions = np.zeros(count, np.int64)
    cells = np.empty((64 * count + 64, 2), np.int64)
    for b in range(count):
        n = rooms[b]
        used = offsets[b]
        offsets[b + 1] = used
        pairs = n - 1 if only_route else n * (n - 1) // 2
        if pairs < 1:
            continue
        random, _, _, _ = block(seed, np.uint64(indices[b]), epoch, PROBLEM, 0)
        first_pair = bounded(random, 0, pairs - 1)
        for attempt in range(pairs):
            i, j = pair_of_number((first_pair + attempt) % pairs, n, only_route)
            start = cell_at(seed_points[b, i, 0], seed_points[b, i, 1], lattice)
            goal = cell_at(seed_points[b, j, 0], seed_points[b, j, 1], lattice)
            if start == goal:
                continue
            _, ground = load_map(maps[b], cell_costs, lattice, scratch.came_from)
            found = search_loaded(
                start, goal, weights, diagonals, cell_costs, ground, lattice, scratch
            )
            if found.high_cost:
                return ends, Solved(cells, sums, expansions, offsets, b, found.high_cost)
            expansions[b] = found.expansions
            if found.length or keep_unsolvable:
                ends[b, 0], ends[b, 1] = position(start, lattice)
                ends[b, 2], ends[b, 3] = position(goal, lattice)
                sums[b, 0] = found.straight_sum
                sums[b, 1] = found.diagonal_sum
                cells = with_capacity(cells, used, found.length)
                write_cells(scratch.came_from, goal, found.length, lattice, cells, used)
                offsets[b + 1] = used + found.length
                break
    return ends, Solved(cells[: offsets[count]], sums, expansions, offsets, count, EXACT)


@kernel
def pair_of_number(number: Int, points: Int, only_route: Int) -> tuple[Int, Int]:
    """Return the seed points (i, j) of pair ``number`` of a map with so many points.

    The pairs are those of the route, or all i < j in row-major order.
    """
    if only_route:
        return number, number + 1
    i = 0
    number_in_row = number
    pairs_in_row = points - 1  # row i has the pairs with j from i + 1 to points - 1
    while number_in_row >= pairs_in_row:
        number_in_row -= pairs_in_row
        pairs_in_row -= 1
        i += 1
    return i, i + 1 + number_in_row
