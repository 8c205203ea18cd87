"""The classical planners, to compare a new planner with."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.checks import check_count
from mapdata.evaluation.guided import GuidedSearch, prior
from mapdata.evaluation.plan import Batched, Plan, Planner
from mapdata.limits import Cell
from mapdata.movement import NEURAL_ASTAR, STEPS, Movement, check_movement
from mapdata.search.api import (
    BatchResult,
    astar,
    check_jump_points,
    search_batch,
    solve_batch,
    solve_by_goal_fields,
    solve_by_jump_points,
    solve_by_landmarks,
)
from mapdata.search.terrain import min_cell_costs

MAX_ESTIMATE = 2**20
"""Maximal ``weight * (H + W)`` of `BestFirst`, so that f fits into 64 bits."""


def classical(movement: Movement = Movement(8), *, terrain: bool = False) -> list[Planner]:
    """Return the planners that every comparison should show, for one movement.

    "guided search, no network" is `GuidedSearch` by `prior`. A network that guides this search is
    worth what it adds to this row, in optimal paths and in expansions.

    "limit" expands only the cells of an optimal path. No planner that expands all cells of its path
    can do with fewer. Jump point search does, since it passes over cells; it is left out under
    4-connectivity. If the movement is that of Neural A*, the A* of its repository is added.

    Args:
        movement: the rule of moves.
        terrain: whether the problems have terrain. Then jump point search, A* with landmarks and
            the A* of Neural A* are left out, since they do not take terrain, and "A* on mean cost"
            is added. It plans as if all free cells cost the same.

    >>> [planner.name for planner in classical()]  # doctest: +NORMALIZE_WHITESPACE
    ['BFS', 'Dijkstra', 'A*', 'weighted A* (1.1)', 'weighted A* (1.25)', 'weighted A* (1.5)',
     'weighted A* (2)', 'weighted A* (3)', 'greedy best-first', 'guided search, no network',
     'jump point search', 'A* with 8 landmarks', 'A* with the exact goal field', 'limit']
    """
    check_movement(movement)
    planners: list[Planner] = [
        Search("BFS", movement, "bfs"),
        BestFirst("Dijkstra", movement, weight=0),
        Search("A*", movement, "astar"),
        *(BestFirst(f"weighted A* ({w})", movement, weight=w) for w in (1.1, 1.25, 1.5, 2, 3)),
        BestFirst("greedy best-first", movement, weight=1, uses_path_cost=False),
        GuidedSearch(
            "guided search, no network",
            movement,
            partial(prior, movement=movement),
            takes_terrain=True,
        ),
    ]
    if movement.connectivity == 8 and not terrain:
        planners.append(JumpPointSearch("jump point search", movement))
    if not terrain:
        planners.append(LandmarkAstar("A* with 8 landmarks", movement))
    planners.append(GoalFieldAstar("A* with the exact goal field", movement))
    planners.append(Limit("limit", movement))
    if terrain:
        planners.append(Search("A* on mean cost", movement, "astar", uses_terrain=False))
    elif movement == NEURAL_ASTAR:
        planners.append(VanillaAstar())
    return planners


@dataclass(frozen=True)
class Search(Batched):
    """mapdata's own search: ``search`` is "bfs" (fewest moves) or "astar".

    Without ``uses_terrain`` it searches on terrain as if all free cells cost the same.
    """

    name: str
    movement: Movement
    search: str
    uses_terrain: bool = True

    def plan_batch(
        self, grids: Bytes, starts: Ints, goals: Ints, terrain: Bytes | None = None
    ) -> list[Plan]:
        """Return a plan for each problem: grids and terrain (B, H, W), starts and goals (B, 2)."""
        if not self.uses_terrain:
            terrain = None
        return _plans(
            search_batch(self.search, grids, starts, goals, self.movement, terrain=terrain)
        )


@dataclass(frozen=True)
class JumpPointSearch(Batched):
    """Jump point search: it finds optimal paths and expands few cells, with no preparation.

    It serves grids whose free cells all cost the same, and refuses terrain. Its expansions are the
    start, the jump points that it takes from the frontier, among equal f the one that was found
    last, and the goal. Diagonal scans find straight jump points and are no jump points themselves.
    From the first eight expansions it also tries a ray to the goal, diagonal moves and then
    straight ones, and is done if that is free. Its looks are the cells that its scans and rays
    pass, each as often as one passes it, often more than A* expands.

    Source: Harabor and Grastien, AAAI 2011, with cut corners; SoCS 2012, without; ICAPS 2014,
    "JPS (B + P)", for scans by bits and what diagonal scans find.

    Attributes:
        name: its name in the table.
        movement: 8-connected. Under 4-connectivity there is JPS4 (Baum 2025, arXiv 2501.14816).
    """

    name: str
    movement: Movement

    def __post_init__(self) -> None:
        """Check the movement.

        Raises:
            ValueError: it is 4-connected.
        """
        check_jump_points(self.movement)

    def plan_batch(
        self, grids: Bytes, starts: Ints, goals: Ints, terrain: Bytes | None = None
    ) -> list[Plan]:
        """Return a plan for each problem: grids (B, H, W), starts and goals (B, 2).

        A single grid (H, W), which all problems share, is read once.

        Raises:
            ValueError: there is terrain; what `search_batch` refuses.
        """
        if terrain is not None:
            raise ValueError(
                f"{self.name}: got terrain, but jump point search needs free cells of equal cost; "
                "leave it out, as classical(movement, terrain=True) does"
            )
        paths, looks = solve_by_jump_points(grids, starts, goals, self.movement)
        return _plans(paths, looks=looks)


@dataclass(frozen=True)
class LandmarkAstar(Batched):
    """A* whose heuristic knows the exact costs from a few cells of the map, the landmarks.

    Its paths are optimal. Landmarks are chosen from the map alone, so one preparation serves all
    problems of a map: `plan_batch` prepares each grid of (B, H, W), but prepares a single grid
    (H, W), which all problems share, only once. Its prepared cells are those that the floods visit,
    all floods together: one that finds the largest component, one that finds its farthest cell, and
    one from each landmark.

    Source: Goldberg and Harrelson, SODA 2005, "ALT" with farthest landmarks, without its lower
    bounds in two directions; costs here are the same in both directions.

    Attributes:
        name: its name in the table.
        movement: the rule of moves.
        landmarks: the largest number of landmarks on a map, at least 1.
    """

    name: str
    movement: Movement
    landmarks: int = 8

    def __post_init__(self) -> None:
        """Check the number of landmarks.

        Raises:
            ValueError: it is no integer, or below 1.
        """
        check_count("landmarks", self.landmarks)

    def plan_batch(
        self, grids: Bytes, starts: Ints, goals: Ints, terrain: Bytes | None = None
    ) -> list[Plan]:
        """Return a plan for each problem: grids (B, H, W), starts and goals (B, 2).

        Raises:
            ValueError: there is terrain; what `search_batch` refuses.
        """
        if terrain is not None:
            raise ValueError(
                f"{self.name}: got terrain, but its landmarks know costs of free cells that all "
                "cost the same; leave it out, as classical(movement, terrain=True) does"
            )
        paths, prepared = solve_by_landmarks(grids, starts, goals, self.movement, self.landmarks)
        return _plans(paths, prepared)


@dataclass(frozen=True)
class GoalFieldAstar(Batched):
    """A* whose heuristic is the exact cost to the goal, which is computed for each problem.

    It expands the cells of its path alone. The cells of the field, all free cells that reach the
    goal, are its prepared cells. Where there is no path, no cell is expanded.
    """

    name: str
    movement: Movement

    def plan_batch(
        self, grids: Bytes, starts: Ints, goals: Ints, terrain: Bytes | None = None
    ) -> list[Plan]:
        """Return a plan for each problem: grids and terrain (B, H, W), starts and goals (B, 2)."""
        paths, field_sizes = solve_by_goal_fields(
            grids, starts, goals, self.movement, terrain=terrain
        )
        return _plans(paths, field_sizes)


@dataclass(frozen=True)
class Limit(Batched):
    """The path of mapdata's A*, with only its cells expanded: what perfect guidance would reach.

    The cells that A* expanded to find the path are its prepared cells.
    """

    name: str
    movement: Movement

    def plan_batch(
        self, grids: Bytes, starts: Ints, goals: Ints, terrain: Bytes | None = None
    ) -> list[Plan]:
        """Return a plan for each problem: grids and terrain (B, H, W), starts and goals (B, 2)."""
        paths = search_batch("astar", grids, starts, goals, self.movement, terrain=terrain)
        cells_per_path = np.diff(paths.offsets)
        return _plans(paths._replace(iterations=cells_per_path), paths.iterations)


@dataclass(frozen=True)
class VanillaAstar:
    """The A* that Neural A* is compared with in its paper; its movement is ``NEURAL_ASTAR``.

    It expands the cell with the smallest g + h, where h is the Chebyshev distance plus a thousandth
    of the Euclidean distance; among equal cells the first in reading order.

    Source: VanillaAstar of https://github.com/omron-sinicx/neural-astar, in floats of 64 bits.
    """

    name: str = "A* of Neural A*"

    def plan(self, grid: Bytes, start: Cell, goal: Cell) -> Plan:
        """Return the path from ``start`` to ``goal`` on ``grid``, (H, W)."""
        free_cells = set(map(tuple, np.argwhere(np.asarray(grid) == 0).tolist()))
        cost_from_start = {start: 0}
        expanded = set[Cell]()
        heap = [(0.0, start)]
        while heap and goal not in expanded:
            _, cell = heapq.heappop(heap)
            expanded.add(cell)
            for row_step, column_step in STEPS.tolist():
                neighbour = (cell[0] + row_step, cell[1] + column_step)
                g = cost_from_start[cell] + 1
                if neighbour in free_cells and g < cost_from_start.get(neighbour, math.inf):
                    cost_from_start[neighbour] = g
                    rows = abs(neighbour[0] - goal[0])
                    columns = abs(neighbour[1] - goal[1])
                    f = g + max(rows, columns) + 0.001 * math.hypot(rows, columns)
                    heapq.heappush(heap, (f, neighbour))
        return Plan(astar(grid, start, goal, NEURAL_ASTAR).path, len(expanded))


@dataclass(frozen=True)
class BestFirst(Batched):
    """Best-first search by f = g + weight * h, or f = weight * h alone.

    The order is that of mapdata's A* (docs/format.md) with another f: the smallest f first, and
    among equal f the most recently pushed cell. A cell is pushed again when a smaller g is found,
    but expanded once. A smaller g that is found after its expansion still changes the cell's
    parent, which makes the path shorter. On terrain h is that of mapdata's A* on terrain.

    The cost is at most ``max(weight, 1)`` times the optimal cost (Pohl 1970; without re-expansion:
    Likhachev et al. 2003). There is no such bound without g.

    Attributes:
        name: its name in the table.
        movement: the allowed moves, which decide whether h is the Manhattan, octile or Chebyshev
            distance.
        weight: at least 0; 0 is Dijkstra's search, 1 is A*, above 1 is weighted A*.
        uses_path_cost: whether g, the cost from the start, is part of f; False is greedy
            best-first search.
    """

    name: str
    movement: Movement
    weight: float
    uses_path_cost: bool = True

    def __post_init__(self) -> None:
        """Check the weight.

        Raises:
            ValueError: it is negative, infinite or NaN.
        """
        if not 0 <= self.weight < math.inf:
            raise ValueError(f"weight: got {self.weight}, expected a number from 0")

    def plan_batch(
        self, grids: Bytes, starts: Ints, goals: Ints, terrain: Bytes | None = None
    ) -> list[Plan]:
        """Return a plan for each problem: grids and terrain (B, H, W), starts and goals (B, 2).

        Raises:
            ValueError: what `search_batch` refuses; a grid so large that with this weight f does
                not fit into 64 bits (it does for 1024 x 1024 cells with a weight of 512; on
                terrain with a weight of 256, divided by the smallest cost of a free cell).
        """
        cost_per_move = 1
        if terrain is not None:
            # The heuristic on terrain multiplies by the smallest cost, and counts half units.
            costs = np.asarray(terrain).astype(np.uint8)  # `solve_batch` refuses other numbers
            cost_per_move = 2 * int(min_cell_costs(costs).max(initial=1))
        rows_and_columns = np.shape(grids)[1:]
        if self.weight * cost_per_move * sum(rows_and_columns) > MAX_ESTIMATE:
            raise ValueError(f"grids of shape {np.shape(grids)} are too large for {self}")
        weights_of_g_and_h = (int(self.uses_path_cost), float(self.weight))
        return _plans(
            solve_batch(weights_of_g_and_h, grids, starts, goals, self.movement, terrain=terrain)
        )


def _plans(
    paths: BatchResult, prepared: Ints | None = None, looks: Ints | None = None
) -> list[Plan]:
    """Return the paths of a batch of searches, each as a plan.

    Args:
        paths: of B problems.
        prepared: (B,), how many cells were prepared; None for no cells.
        looks: (B,), how many cells were visited; None if only the expanded ones were.
    """
    expansions = paths.iterations.tolist()
    count = len(expansions)
    prepared_counts = [0] * count if prepared is None else prepared.tolist()
    look_counts = [None] * count if looks is None else looks.tolist()
    return [
        Plan(paths.cells[first:end], expanded, prepared_count, look_count)
        for (first, end), expanded, prepared_count, look_count in zip(
            pairwise(paths.offsets.tolist()), expansions, prepared_counts, look_counts, strict=True
        )
    ]
