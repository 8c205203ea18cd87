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
from mapdata.search.ground import (
    PaddedTerrain,
    cost_in_cells,
    heuristic_on,
    is_usable_end,
    load_map,
    unit_of,
)
from mapdata.search.kernels import Scratch, search_memory
from mapdata.search.lattice import (
    UNSEEN,
    Lattice,
    cell_at,
    move_rule,
    position,
    split_cost,
)
from mapdata.search.map_stack import MapStack
from mapdata.search.solving import shortest_costs_on

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
    maps: MapStack,
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
        maps: B maps.
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
    is_length_alone = problems.distance is None and problems.hardness is None
    if maps.terrain is None or problems.length is None or not is_length_alone:
        lattice, scratch = search_memory(maps.grids.shape[1:], rule)
        see_starts(seen, *maps.ground, goals, key, epoch, indices, draws, bands, lattice, scratch)
    if maps.terrain is None or problems.length is None:
        return
    distances, ratios, _ = problems.bands
    open_bands: Bands = (distances, ratios, (0.0, math.inf))
    min_distance = max(distances[0], 1.0)
    for draw in range(*draws):
        one_draw = (draw, draw + 1)
        ends, _, _ = sample_problems(
            maps, goals, key, epoch, indices, one_draw, min_distance, open_bands, rule
        )
        rows = np.flatnonzero(ends[:, 0] >= 0)
        starts = np.ascontiguousarray(ends[rows, :2])
        ends_of_paths = np.ascontiguousarray(ends[rows, 2:])
        solved, _, _ = search_terrains(
            maps.terrain[rows], starts, ends_of_paths, movement, allow_occupied_ends=False
        )
        for length in np.diff(solved.offsets).tolist():
            see_value(seen[2], bands[2], float(length))


@kernel
def see_starts(
    seen: Floats,
    maps: Bytes,
    cell_costs: Bytes | None,
    goals: Ints | None,
    seed: np.uint64,
    epoch: Int,
    indices: Ints,
    draws: tuple[Int, Int],
    bands: Floats,
    lattice: Lattice,
    scratch: Scratch,
) -> None:
    """Do what `see_values` does, on terrain for distance and hardness alone.

    ``maps`` and ``cell_costs`` are from `MapStack.ground`; ``bands`` is (3, 2).
    """
    for b in range(len(maps)):
        load_map(maps[b], cell_costs, lattice, scratch.came_from)
        free_cells = np.flatnonzero(scratch.came_from == UNSEEN)
        if len(free_cells) < 2:
            continue
        for draw in range(*draws):
            _, ground = load_map(maps[b], cell_costs, lattice, scratch.came_from)
            if goals is None:
                word, _, _, _ = block(seed, np.uint64(indices[b]), epoch, PROBLEM, draw)
                goal = free_cells[bounded(word, 0, len(free_cells) - 1)]
            else:
                # An only goal has the same starts in each draw.
                if not is_usable_end(goals[b], maps.shape[1:], 0, lattice, scratch.came_from):
                    break
                if draw > draws[0]:
                    break
                goal = cell_at(goals[b, 0], goals[b, 1], lattice)
            # No cost is too high to be exact: the search in vain has computed them all.
            shortest_costs_on(np.full(1, goal), ground, lattice, scratch)
            _see_costs(seen, free_cells, goal, ground, bands, lattice, scratch)


@kernel
def _see_costs(
    seen: Floats,
    free_cells: Ints,
    goal: Int,
    ground: PaddedTerrain | None,
    bands: Floats,
    lattice: Lattice,
    scratch: Scratch,
) -> None:
    """Add to ``seen`` what a search around ``goal``, a padded cell, says of ``free_cells``."""
    row, column = position(goal, lattice)
    unit = unit_of(ground)
    for cell in free_cells:
        cost = cost_in_cells(scratch.g[cell], unit)
        if cost > 0:
            start_row, start_column = position(cell, lattice)
            lower_bound = heuristic_on(start_row - row, start_column - column, ground, lattice)
            see_value(seen[0], bands[0], cost)
            see_value(seen[1], bands[1], cost / cost_in_cells(lower_bound, unit))
            if ground is None:
                straight, diagonal = split_cost(scratch.g[cell])
                see_value(seen[2], bands[2], float(straight + diagonal + 1))


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
