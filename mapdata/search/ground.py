"""The ground of a search: what a move costs, on terrain and on maps without it.

A kernel takes its maps as one array, of grids or of terrain, and ``cell_costs``: memory for the
costs of terrain, None for grids. `load_map` returns the ground: a `PaddedTerrain`, or None where
all free cells cost the same. numba compiles a version of a kernel for each of the two types, and
leaves out the branches of the other one. So one kernel serves both kinds of maps, and grids wait
for no code that reads terrain.

Terrain is a map (H, W) of uint8: 0 is an occupied cell, 1 to 255 is the cost of a free cell. A move
costs the mean of its two cells times its length. This is the rule of scikit-image's MCP_Geometric.
It is symmetric, so that the costs from a cell are also the costs to it.

On terrain, costs inside of kernels are doubled: the sum of the two cells replaces their mean, so
that no fraction is left. A path whose straight moves have the sum S of cell costs, and whose
diagonal moves have the sum D, has the doubled cost S + D * sqrt(2), which is stored as the integer
``S * UNIT + D * DIAGONAL``. `mapdata.search.lattice` explains these numbers. Its proof needs only
that S and D are whole numbers, so it holds here for doubled costs below `MAX_PATH_COST`. Mazes of
128 x 128 cells with costs up to 255 stay below half of this bound. A search that finds a least cost
at or above the bound says so, and its caller refuses the map.

Where diagonal moves do not exist or cost 1, all doubled costs are whole numbers. The kernels then
count them in units of 1, for which neither the bound nor an overflow of int64 is in reach.

On terrain of ones every cost is twice that of a map without terrain. So A* expands the same cells
in the same order, and returns the same paths.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Floats, Ints
from mapdata.jit import Int, inlined, kernel
from mapdata.movement import Movement
from mapdata.search.lattice import (
    DIAGONAL,
    INFINITY,
    MAX_PATH_COST,
    NO_DIAGONALS,
    UNIT,
    UNSEEN,
    WALL,
    Lattice,
    cell_at,
    heuristic,
    in_cells,
    load,
    split_cost,
)

EXACT = np.int64(0)
"""Stands for a cost that is too high to be exact where there is none; 0 is never too high."""

TOO_LONG = np.int64(-1)
"""Stands for the cost of a path on a grid that is too long for exact costs.

Kernels return it like a cost on terrain that is too high; its message needs no number.
"""

MAX_COST = np.int64(MAX_PATH_COST * UNIT)
"""Doubled costs from here on are not exact where diagonal moves cost sqrt(2)."""


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


@inlined
def load_map(
    map_: Bytes, cell_costs: Bytes | None, lattice: Lattice, came_from: Bytes
) -> tuple[Int, PaddedTerrain | None]:
    """Copy a grid or terrain (H, W) onto the lattice.

    Args:
        map_: a grid of 0 and 1, or terrain.
        cell_costs: None for a grid; for terrain as `load_terrain` takes it.
        lattice: of the map.
        came_from: (cells,) to be filled with UNSEEN and WALL.

    Returns:
        Whether all cells are numbers that a map may have; and the ground.
    """
    if cell_costs is None:
        return load(map_, came_from), None
    return True, load_terrain(map_, lattice, cell_costs, came_from)


def as_ground(grids: Bytes, terrains: Bytes | None) -> tuple[Bytes, Bytes | None]:
    """Return maps, (..., H, W), as kernels take them: as one array, and memory for their costs.

    The memory is (cells,) zeros on terrain, else None. ``terrains`` fit the ``grids``.
    """
    if terrains is None:
        return grids, None
    rows, columns = terrains.shape[-2:]
    return terrains, np.zeros((rows + 2) * (columns + 2), np.uint8)


@inlined
def heuristic_on(rows: Int, columns: Int, ground: PaddedTerrain | None, lattice: Lattice) -> Int:
    """Return the cost of a path by (rows, columns) on a map without occupied cells.

    On terrain, all its cells have the smallest cost of the terrain, and the cost is doubled. Since
    this is a part of kernels, ``ground`` has to be an argument of the kernel for numba to know it.
    """
    if ground is None:
        return heuristic(rows, columns, lattice)
    return terrain_heuristic(rows, columns, ground, lattice)


@kernel
def sums_of_cost(cost: Int, ground: PaddedTerrain | None) -> tuple[Int, Int]:
    """Return the numbers of straight and of diagonal moves that a cost is made of.

    On terrain, return the sums S and D of a doubled cost; all of it is S where costs are whole
    numbers.
    """
    if ground is None:
        return split_cost(cost)
    if ground.straight_unit == 1:
        return cost, np.int64(0)
    return split_cost(cost)


NOT_DOUBLED = np.int64(0)
"""The unit of costs on maps without terrain, see `unit_of`."""


@kernel
def unit_of(ground: PaddedTerrain | None) -> Int:
    """Return the unit of costs that `cost_in_cells` takes: NOT_DOUBLED, or that of the terrain."""
    if ground is None:
        return NOT_DOUBLED
    return ground.straight_unit


@kernel
def cost_in_cells(cost: Int, unit: Int) -> float:
    """Return a cost in cells, -1 for occupied cells and for those without a path.

    ``unit`` is from `unit_of`. A loop over cells passes this number and not the ground, because
    numba would count the references of its array at each call.
    """
    if not 0 <= cost < INFINITY:
        return -1.0
    doubled_cost: float = cost if unit == 1 else in_cells(cost)
    return doubled_cost / (1 if unit == NOT_DOUBLED else 2)


# --- costs in cells -----------------------------------------------------------------------------


@kernel
def sum_steps(terrains: Bytes | None, cells: Ints, offsets: Ints) -> Ints:
    """Return the sums (B, 2) over straight and over diagonal steps of each path.

    Without terrain these are the numbers of steps, on terrain the sums S and D of the doubled cost
    above. An empty path has (-1, 0).

    Args:
        terrains: (B, H, W), or None.
        cells: (M, 2) cells of the paths, one after another.
        offsets: (B + 1,) where each path begins in there.
    """
    sums = np.zeros((len(offsets) - 1, 2), np.int64)
    for b in range(len(sums)):
        if offsets[b + 1] == offsets[b]:
            sums[b, 0] = -1
        for k in range(offsets[b] + 1, offsets[b + 1]):
            is_diagonal = cells[k, 0] != cells[k - 1, 0] and cells[k, 1] != cells[k - 1, 1]
            cost = np.int64(1)
            if terrains is not None:
                cost = np.int64(terrains[b, cells[k, 0], cells[k, 1]])
                cost += np.int64(terrains[b, cells[k - 1, 0], cells[k - 1, 1]])
            sums[b, 1 if is_diagonal else 0] += cost
    return sums


def costs_of_sums(sums: Ints, movement: Movement, *, are_doubled: bool) -> Floats:
    """Return the costs (n,) in cells of sums (n, 2) over straight and over diagonal moves.

    Args:
        sums: as from `sum_steps`; (-1, 0) stands for no path, whose cost is -1.
        movement: says what a diagonal move costs.
        are_doubled: whether the sums are those of terrain, S and D, and not numbers of moves.
    """
    straight, diagonal = sums.T
    costs = straight + diagonal * movement.diagonal_cost
    if are_doubled:
        costs = costs / 2
    return np.where(straight < 0, -1.0, costs)


def high_cost_complaint(high_cost: int) -> str:
    """Return the error message for a cost that is not exact.

    Callers that know the number of the map put it before this message.

    Args:
        high_cost: as kernels return it: doubled and in 1 / UNIT on terrain, TOO_LONG on a grid.
    """
    if high_cost == TOO_LONG:
        return (
            f"the grid has paths of {MAX_PATH_COST} cells or more, for which costs are not exact: "
            "expected a coarser grid, or a search that counts moves (A* under 4-connectivity, BFS)"
        )
    return (
        f"terrain: a path costs {high_cost / (2 * UNIT):,.0f}, and costs are exact only below "
        f"{MAX_PATH_COST / 2:,.0f}: divide the terrain by a number, or let diagonal moves cost 1"
    )
