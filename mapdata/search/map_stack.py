"""The record of several maps that Python functions pass on: grids and their terrain together.

It knows whether there is terrain, so that its callers need not ask. Its verbs inflate the maps,
solve problems on them, say what paths cost, and refuse costs that are too high to be exact.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Flags, Floats, Ints
from mapdata.generators.maps import Maps, unpacked
from mapdata.movement import Movement
from mapdata.search.arguments import problem_complaint
from mapdata.search.footprint import inflate_all, occupies_cells, without_occupied
from mapdata.search.ground import as_ground, costs_of_sums, high_cost_complaint, sum_steps
from mapdata.search.kept_memory import kept_search_memory
from mapdata.search.lattice import ASTAR, BFS, CostWeights, diagonal_moves, move_rule
from mapdata.search.solving import Solved, solve_problems
from mapdata.search.terrain import min_cell_costs


def _by_problem(row: int) -> str:
    """Return how an error on problem ``row`` of a batch begins."""
    return f"problem {row}: "


class MapStack(NamedTuple):
    """B maps, all with terrain or all without.

    Attributes:
        grids: (B, H, W) uint8, 1 occupied.
        terrain: (B, H, W) uint8, the cost of each cell, 0 exactly on the occupied cells; None for
            maps whose free cells all cost the same.
    """

    grids: Bytes
    terrain: Bytes | None

    @staticmethod
    def joined(parts: Sequence[MapStack]) -> MapStack:
        """Return the maps of all parts, one part after another."""
        terrains = [part.terrain for part in parts if part.terrain is not None]
        return MapStack(
            np.concatenate([part.grids for part in parts]),
            np.concatenate(terrains) if terrains else None,
        )

    @staticmethod
    def of(maps: Maps, rows: Ints | slice) -> MapStack:
        """Return some of the maps of a batch that was generated or read."""
        terrain = None if maps.terrain is None else maps.terrain[rows]
        return MapStack(unpacked(maps.packed[rows], maps.columns), terrain)

    @property
    def has_terrain(self) -> bool:
        """Whether the maps have terrain."""
        return self.terrain is not None

    def select(self, rows: Flags | Ints | slice) -> MapStack:
        """Return the maps that ``rows`` selects."""
        return MapStack(self.grids[rows], None if self.terrain is None else self.terrain[rows])

    def grid_and_terrain(self, row: int) -> tuple[Bytes, Bytes | None]:
        """Return the grid and the terrain of one map, each (H, W)."""
        return self.grids[row], None if self.terrain is None else self.terrain[row]

    def overwrite(self, rows: Ints, others: MapStack, rows_of_others: Ints) -> None:
        """Replace map ``rows[k]`` by map ``rows_of_others[k]`` of others, in these arrays."""
        self.grids[rows] = others.grids[rows_of_others]
        if self.terrain is not None and others.terrain is not None:
            self.terrain[rows] = others.terrain[rows_of_others]

    def with_grids(self, grids: Bytes) -> MapStack:
        """Return these maps after inflation, which made ``grids``, (B, H, W), of their grids."""
        if self.terrain is None or grids is self.grids:
            return MapStack(grids, self.terrain)
        return MapStack(grids, without_occupied(self.terrain, grids))

    def inflated(self, min_clearance: int) -> MapStack:
        """Return the maps after inflation, as `inflate_all` does it; without any, these maps."""
        if not occupies_cells(min_clearance):  # The kernel takes seconds to compile.
            return self
        grids = self.grids.copy()
        inflate_all(grids, min_clearance)
        return self.with_grids(grids)

    @property
    def ground(self) -> tuple[Bytes, Bytes | None]:
        """The maps as kernels take them, from `as_ground`."""
        return as_ground(self.grids, self.terrain)

    @property
    def content(self) -> Bytes:
        """(B, H, W) uint8, what the maps are known by: the terrain, or without it the grids."""
        return self.grids if self.terrain is None else self.terrain

    @property
    def cell_costs(self) -> Bytes:
        """(B, H, W) uint8, the terrain; on maps without it each free cell costs 1."""
        return self.grids ^ np.uint8(1) if self.terrain is None else self.terrain

    @property
    def min_cell_costs(self) -> Ints | None:
        """(B,) int64, the smallest cost of a free cell of each map; None without terrain."""
        return None if self.terrain is None else min_cell_costs(self.terrain)

    # --- problems ---

    def seen_by(self, weights: CostWeights) -> MapStack:
        """Return these maps as a search sees them: BFS counts moves, whatever the cells cost."""
        return MapStack(self.grids, None) if weights == BFS else self

    def solve(
        self,
        starts: Ints,
        goals: Ints,
        movement: Movement,
        weights: CostWeights = ASTAR,
        *,
        allow_occupied_ends: bool = False,
        error_prefix: Callable[[int], str] = _by_problem,
    ) -> Solved:
        """Search a path for each of B problems.

        Args:
            starts: (B, 2) cells.
            goals: (B, 2) cells.
            movement: which moves are legal.
            weights: which search. BFS is for maps without terrain, as from `seen_by`. On terrain,
                the weighted heuristic may not exceed `MAX_PATH_COST` / 2.
            allow_occupied_ends: whether a start or goal may be occupied. Such a problem has no
                path, and no cell is expanded.
            error_prefix: returns how an error on a problem begins, such as "map 7: ".

        Returns:
            The paths of all problems, problem b on map b, or on the only map.

        Raises:
            ValueError: a start or goal outside of its map or on an occupied cell, a grid that holds
                other numbers than 0 and 1, or a cost that is too high to be exact.
        """
        rule = move_rule(movement)
        maps, cell_costs = self.ground
        # All searches on terrain serve any movement.
        diagonals = diagonal_moves(rule) if cell_costs is None else None
        solved = solve_problems(
            maps,
            cell_costs,
            starts,
            goals,
            int(allow_occupied_ends),
            weights,
            diagonals,
            *kept_search_memory(self.grids.shape[1:], rule),
        )
        self.check_solved(solved, starts, goals, error_prefix)
        return solved

    def costs_of(self, solved: Solved, movement: Movement) -> Floats:
        """Return the costs (B,) in cells of paths that were found on these maps, -1 without one."""
        return costs_of_sums(solved.sums, movement, are_doubled=self.has_terrain)

    def costs_of_paths(self, cells: Ints, offsets: Ints, movement: Movement) -> Floats:
        """Return the costs (B,) in cells of paths on these B maps, -1 for an empty path.

        Args:
            cells: (M, 2) cells of the paths, one path after another; all moves are legal.
            offsets: (B + 1,) where each path begins in there, and where the last one ends.
            movement: says what a diagonal move costs.
        """
        sums = sum_steps(self.terrain, cells, offsets)
        return costs_of_sums(sums, movement, are_doubled=self.has_terrain)

    def check_solved(
        self,
        solved: Solved,
        starts: Ints,
        goals: Ints,
        error_prefix: Callable[[int], str] = _by_problem,
    ) -> None:
        """Check that a kernel solved all problems on these maps.

        Raises:
            ValueError: it refused one, for the reasons of `solve`.
        """
        self.check_exact(solved.done, solved.high_cost, error_prefix)
        if solved.done < len(starts):
            k = solved.done
            complaint = problem_complaint(self.grids[k % len(self.grids)], starts[k], goals[k])
            raise ValueError(error_prefix(k) + complaint)

    def check_exact(self, row: int, high_cost: int, error_prefix: Callable[[int], str]) -> None:
        """Refuse a map with a cost that is too high to be exact.

        Args:
            row: number of the map, as kernels return it.
            high_cost: the cost, as kernels return it; 0 if all costs are exact.
            error_prefix: as for `solve`; it is called for an error alone.

        Raises:
            ValueError: such a cost.
        """
        if high_cost:
            raise ValueError(error_prefix(row) + high_cost_complaint(high_cost))
