"""What the error of a search in vain says: the nearest values to the bands that were seen.

The goals that were tried are drawn again, and the values of all their starts are compared with the
bands. That takes about as long as the search itself, so it is done for the error alone.
"""

from __future__ import annotations

import math

import numpy as np

from mapdata.arrays import Bytes, Flags, Floats, Ints
from mapdata.jit import Int, kernel
from mapdata.movement import Movement
from mapdata.problems.sampling import sample_problems
from mapdata.problems.sources import Bands, Random
from mapdata.rng import PROBLEM, block, bounded
from mapdata.search.api import search_terrains
from mapdata.search.kernels import new_scratch, shortest_costs
from mapdata.search.lattice import (
    ASTAR,
    INFINITY,
    MoveRule,
    cell_at,
    heuristic,
    in_cells,
    lattice_of,
    load,
    move_rule,
    position,
    split_cost,
)
from mapdata.search.terrain import (
    cost_in_cells,
    load_terrain,
    shortest_terrain_costs,
    terrain_heuristic,
)

NAMES = ("distance", "hardness", "length")
"""The quantities that a band limits, in the order of `Random.bands`."""

BELOW, WITHIN, ABOVE = range(3)
"""Columns of the values that were seen: the largest one below a band, whether any is in it (1 or
-inf), and the smallest one above it.
"""


def nothing_seen() -> Floats:
    """Return the values (3, 3) of no start at all: a row for each of `NAMES`."""
    return np.tile([-math.inf, -math.inf, math.inf], (len(NAMES), 1))


def see_values(
    seen: Floats,
    grids: Bytes,
    terrain: Bytes | None,
    goals: Ints | None,
    seed: int,
    epoch: int,
    indices: Ints,
    draws: tuple[int, int],
    problems: Random,
    movement: Movement,
) -> None:
    """Add to ``seen`` the values of all starts of all goals that were tried on B maps.

    The length of a path on terrain is that of A*'s path. So only the starts that were drawn inside
    the other bands have one.

    Args:
        seen: (3, 3) values, as `nothing_seen` returns them.
        grids: (B, H, W).
        terrain: (B, H, W), or None.
        goals: (B, 2) cells; None if goals are drawn, too.
        seed: sampling seed.
        epoch: pass over the data.
        indices: (B,) number of each problem.
        draws: number of the first draw that was tried on each map, and of the first one that was
            not.
        problems: whose bands the values are compared with.
        movement: of the paths.
    """
    key = np.uint64(seed)
    rule = move_rule(movement)
    bands = np.array(problems.bands)
    if terrain is None:
        see_starts(seen, grids, goals, key, epoch, indices, draws, bands, rule)
        return
    if problems.length is None or problems.distance is not None or problems.hardness is not None:
        see_terrain_starts(seen, terrain, goals, key, epoch, indices, draws, bands, rule)
    if problems.length is None:
        return
    distances, ratios, _ = problems.bands
    open_bands: Bands = (distances, ratios, (0.0, math.inf))
    min_distance = max(distances[0], 1.0)
    for draw in range(*draws):
        one_draw = (draw, draw + 1)
        ends, _, _ = sample_problems(
            grids, terrain, goals, key, epoch, indices, one_draw, min_distance, open_bands, rule
        )
        rows = np.flatnonzero(ends[:, 0] >= 0)
        starts = np.ascontiguousarray(ends[rows, :2])
        ends_of_paths = np.ascontiguousarray(ends[rows, 2:])
        solved, _, _ = search_terrains(
            terrain[rows], starts, ends_of_paths, movement, allow_occupied_ends=False
        )
        for length in np.diff(solved.offsets).tolist():
            see_value(seen[2], bands[2], float(length))


@kernel
def see_starts(
    seen: Floats,
    grids: Bytes,
    goals: Ints | None,
    seed: np.uint64,
    epoch: Int,
    indices: Ints,
    draws: tuple[Int, Int],
    bands: Floats,
    rule: MoveRule,
) -> None:
    """Do what `see_values` does, on maps without terrain; ``bands`` is (3, 2)."""
    lattice = lattice_of(grids.shape[1:], rule)
    scratch = new_scratch(ASTAR, lattice)
    for b in range(len(grids)):
        free_cells = np.flatnonzero(grids[b].reshape(-1) == 0)
        if len(free_cells) < 2:
            continue
        for draw in range(*draws):
            if goals is None:
                word, _, _, _ = block(seed, np.uint64(indices[b]), epoch, PROBLEM, draw)
                number = free_cells[bounded(word, 0, len(free_cells) - 1)]
                row = number // grids.shape[2]
                column = number % grids.shape[2]
            else:
                row = goals[b, 0]
                column = goals[b, 1]
                # An only goal has the same starts in each draw.
                if row < 0 or grids[b, row, column] or draw > draws[0]:
                    break
            load(grids[b], scratch.came_from)
            goal = cell_at(row, column, lattice)
            shortest_costs(np.full(1, goal), INFINITY, lattice, scratch)
            for cell in range(lattice.cells):
                cost = scratch.g[cell]
                if 0 < cost < INFINITY:
                    start_row, start_column = position(cell, lattice)
                    lower_bound = heuristic(start_row - row, start_column - column, lattice)
                    straight, diagonal = split_cost(cost)
                    see_value(seen[0], bands[0], in_cells(cost))
                    see_value(seen[1], bands[1], in_cells(cost) / in_cells(lower_bound))
                    see_value(seen[2], bands[2], float(straight + diagonal + 1))


@kernel
def see_terrain_starts(
    seen: Floats,
    terrains: Bytes,
    goals: Ints | None,
    seed: np.uint64,
    epoch: Int,
    indices: Ints,
    draws: tuple[Int, Int],
    bands: Floats,
    rule: MoveRule,
) -> None:
    """Do what `see_values` does for distance and hardness on terrain; ``bands`` is (3, 2)."""
    lattice = lattice_of(terrains.shape[1:], rule)
    scratch = new_scratch(ASTAR, lattice)
    cell_costs = np.zeros(lattice.cells, np.uint8)
    for b in range(len(terrains)):
        padded = load_terrain(terrains[b], lattice, cell_costs, scratch.came_from)
        free_cells = np.flatnonzero(cell_costs)
        if len(free_cells) < 2:
            continue
        for draw in range(*draws):
            if goals is None:
                word, _, _, _ = block(seed, np.uint64(indices[b]), epoch, PROBLEM, draw)
                goal = free_cells[bounded(word, 0, len(free_cells) - 1)]
            else:
                if goals[b, 0] < 0 or terrains[b, goals[b, 0], goals[b, 1]] == 0:
                    break
                # An only goal has the same starts in each draw.
                if draw > draws[0]:
                    break
                goal = cell_at(goals[b, 0], goals[b, 1], lattice)
            row, column = position(goal, lattice)
            # No cost is too high to be exact: the search in vain has computed them all.
            shortest_terrain_costs(np.full(1, goal), padded, lattice, scratch)
            for cell in free_cells:
                cost = cost_in_cells(scratch.g[cell], padded)
                if cost > 0:
                    start_row, start_column = position(cell, lattice)
                    lower_bound = cost_in_cells(
                        terrain_heuristic(start_row - row, start_column - column, padded, lattice),
                        padded,
                    )
                    see_value(seen[0], bands[0], cost)
                    see_value(seen[1], bands[1], cost / lower_bound)


@kernel
def see_value(seen: Floats, band: Floats, value: float) -> None:
    """Add a value to those that were seen of one quantity, (3,); its ``band`` is (2,)."""
    if value < band[0]:
        seen[BELOW] = max(seen[BELOW], value)
    elif value > band[1]:
        seen[ABOVE] = min(seen[ABOVE], value)
    else:
        seen[WITHIN] = 1


def nearest_text(seen: Floats, problems: Random) -> str:
    """Return the nearest values that were seen, as a clause of an error."""
    is_within: Flags = seen[:, WITHIN] > 0
    if not (is_within.any() or np.isfinite(seen).any()):
        return "no goal could be reached from another cell"
    clauses = []
    for k, name in enumerate(NAMES):
        if getattr(problems, name) is not None and not is_within[k]:
            below, _, above = seen[k].tolist()
            nearest = [value for value in (below, above) if math.isfinite(value)]
            if nearest:
                clauses.append(_nearest_values_text(name, nearest, is_below=below in nearest))
    return " and ".join(clauses) or "no start met all conditions at once"


def _nearest_values_text(name: str, nearest: list[float], *, is_below: bool) -> str:
    """Return the nearest values to a band in words: those on both sides, or that on one side."""
    numbers = " and ".join(f"{value:.6g}" for value in nearest)
    if name == "length":
        if len(nearest) == 2:
            return f"the nearest paths seen have {numbers} cells"
        return f"the {'longest' if is_below else 'shortest'} path seen has {numbers} cells"
    unit = "" if name == "hardness" else " cells"
    if len(nearest) == 2:
        return f"the nearest values of {name} seen are {numbers}{unit}"
    return f"the {'largest' if is_below else 'smallest'} {name} seen is {numbers}{unit}"
