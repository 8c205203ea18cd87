"""Planners that follow predictions: a search by scores of moves, and A* on costs of cells.

What predicts is a function of the caller, mostly one that asks a network (docs/howto/planner.md).
`prior` is one that asks none: what a network is worth is what it adds to that.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from mapdata.arrays import Bytes, Float32s, Ints
from mapdata.checks import check_number
from mapdata.evaluation.plan import Batched, Plan
from mapdata.movement import STEPS, Movement, check_movement
from mapdata.search.api import search_batch
from mapdata.search.arguments import (
    as_checked_problems,
    as_optional_terrain,
    terrain_from_costs,
)
from mapdata.search.map_stack import MapStack
from mapdata.search.predicted_moves import follow_predictions

PRIOR = 3.0
"""How much the score of a move falls for each cell of its detour in `prior`."""


def prior(
    grids: ArrayLike, goals: ArrayLike, movement: Movement, terrain: ArrayLike | None = None
) -> tuple[Float32s, Float32s]:
    """Return predictions for `GuidedSearch` that need no network: those of an empty map.

    The score of a move is -3 times its detour on an empty map: 0 for the moves that lead straight
    to the goal. The cost to go is that on an empty map: the Manhattan, octile or Chebyshev
    distance. A network that adds its output to these scores begins as a planner.

    Args:
        grids: (B, H, W); only their shape counts.
        goals: (B, 2) cells.
        movement: the rule of moves.
        terrain: (B, H, W), the cost of each cell, 0 on occupied cells. Then the cost to go is
            multiplied by the mean cost of the free cells.

    Returns:
        Scores of the moves (B, moves, H, W), in the order N, E, S, W, NE, SE, SW, NW, and costs to
        go (B, H, W), in cells.

    >>> scores, costs_to_go = prior([[[0, 0, 0]]], [(0, 2)], Movement(4))
    >>> costs_to_go
    array([[[2., 1., 0.]]], dtype=float32)
    >>> scores[0, :, 0, 0].tolist()  # N, E, S, W
    [-6.0, 0.0, -6.0, -6.0]
    """
    check_movement(movement)
    _, height, width = np.shape(grids)
    row, column = np.asarray(goals).T
    down = np.arange(height)[None, :, None] - row[:, None, None]  # (B, H, 1)
    right = np.arange(width)[None, None, :] - column[:, None, None]  # (B, 1, W)
    here = _moves_on_an_empty_map(down, right, movement)
    gains = []
    for rows, columns in STEPS[: movement.connectivity].tolist():
        # Moves are counted, not costs, so that a move without a detour has the score 0 exactly.
        saved = here - _moves_on_an_empty_map(down + rows, right + columns, movement)
        is_diagonal = rows != 0 and columns != 0
        saved[int(is_diagonal)] -= 1  # the move itself
        gains.append(saved[0] + saved[1] * movement.diagonal_cost)  # 0, or less for a detour
    scores = PRIOR * np.stack(gains, axis=1)
    costs_to_go = here[0] + here[1] * movement.diagonal_cost
    if terrain is not None:
        costs = np.asarray(terrain)
        costs_to_go = costs_to_go * costs.mean(axis=(1, 2), where=costs > 0, keepdims=True)
    return scores.astype(np.float32), costs_to_go.astype(np.float32)


def _moves_on_an_empty_map(down: Ints, right: Ints, movement: Movement) -> Ints:
    """Return how many straight and diagonal moves lead so far down and right, (2, B, H, W)."""
    down, right = np.broadcast_arrays(np.abs(down), np.abs(right))
    diagonal = np.minimum(down, right) if movement.connectivity == 8 else np.zeros_like(down)
    return np.stack([down + right - 2 * diagonal, diagonal])


@dataclass(frozen=True, eq=False)
class GuidedSearch(Batched):
    """Best-first search in which improbable moves are dear.

    The cell of the least f is expanded next:

        f       = cost + to_go - 0.001 * length
        cost    = sum over the moves of a path to the cell of (move + penalty)
        penalty = trust * mean * 64 / side * (odds ** 2 - 1)
        odds    = min(P(most probable legal move) / P(move), e ** 10)

        f, cost, penalty    in cells; ``cost`` is the least of all paths that the search has seen
        move                length of the move, in cells: 1, or the movement's ``diagonal_cost``;
                            on terrain times the mean of the costs of its two cells
        to_go               predicted cost from the cell to the goal, in cells
        length              length of the path that the search has to the cell, in cells; on terrain
                            its cost
        mean                mean cost of the free cells of the map; 1 without terrain
        side                mean of the rows and columns of the map, in cells
        odds                without unit; 1 for the most probable move
        trust               in cells

    - Odds are squared because either of two moves that are nearly as probable may be optimal, while
      a move that is four times less probable hardly ever is.
    - Penalties shrink with the side because paths on larger maps have more moves that are nearly as
      good as the best one.
    - Of cells with nearly equal f, ``0.001 * length`` prefers the one that is farther on its way.
      Of cells with equal f, the one that was pushed last comes first.

    Each cell is expanded at most once, and a path is found wherever there is one. A cell that is
    reached by a shorter path later takes that path as its own, even after it was expanded, so that
    the path in the plan may be shorter than the one whose cost led to the goal.

    With infinite trust the search becomes a walk, a depth-first search: from the cell that was
    expanded last it makes the most probable move to a cell that was not expanded yet, and it goes
    back where there is none.

    Attributes:
        name: name of its row in the table.
        movement: the rule of moves, which the problems must have.
        predict: a function of grids (B, H, W) and goals (B, 2), mostly one that asks a network. It
            returns scores of the moves (B, moves, H, W), in the order of `mapdata.search.STEPS`,
            and costs to go (B, H, W), in cells, as arrays or as tensors of the CPU. A score is the
            log probability that the move is optimal, up to a constant for each cell. `prior` has
            both for a network that predicts one of them.
        trust: penalty of a move whose odds squared are 2 on a map of 64 x 64, in cells of the mean
            cost.
        takes_terrain: whether ``predict`` has a parameter ``terrain``, the costs of the cells,
            (B, H, W), and returns costs to go on it. Otherwise the search plans as if all free
            cells cost 1.
    """

    name: str
    movement: Movement
    predict: Callable[..., tuple[ArrayLike, ArrayLike]] = field(repr=False)
    trust: float = 0.15
    takes_terrain: bool = False

    def __post_init__(self) -> None:
        """Check the movement and the trust, which may be infinite."""
        check_movement(self.movement)
        if not check_number("trust", self.trust) >= 0:  # this form also refuses NaN
            raise ValueError(f"trust: got {self.trust}, expected a number of at least 0")

    def plan_batch(
        self, grids: Bytes, starts: Ints, goals: Ints, terrain: Bytes | None = None
    ) -> list[Plan]:
        """Return a plan for each problem: grids and terrain (B, H, W), starts and goals (B, 2).

        Raises:
            ValueError: what `search_batch` refuses; predictions of other shapes than ``predict``
                should have.

        Warns:
            UserWarning: all scores are NaN. There is a path, even so.
        """
        grids, starts, goals, costs = _problems_of(grids, starts, goals, terrain)
        if costs is not None and self.takes_terrain:
            predictions = self.predict(grids, goals, terrain=costs)
        else:
            costs = 1 - grids
            predictions = self.predict(grids, goals)
        parts = tuple(predictions)
        if len(parts) != 2:
            raise ValueError(
                f"{self.name}: predict gave {len(parts)} arrays, expected two, scores of the "
                "moves and costs to go"
            )
        scores, costs_to_go = (np.ascontiguousarray(part, np.float32) for part in parts)
        # Compiled code does not check bounds: it would read past the end of smaller arrays.
        shapes = scores.shape, costs_to_go.shape
        expected = (len(grids), self.movement.connectivity, *grids.shape[1:]), grids.shape
        if shapes != expected:
            raise ValueError(f"{self.name}: predict gave shapes {shapes}, expected {expected}")
        if np.isnan(scores).all():
            warnings.warn(
                f"{self.name}: all scores that predict gave are NaN, as those of a network whose "
                "training diverged",
                stacklevel=2,
            )
        moves = STEPS[: self.movement.connectivity]
        side = sum(grids.shape[1:]) / 2
        mean_costs = costs.mean(axis=(1, 2), where=costs > 0)  # (B,)
        penalties = self.trust * mean_costs * 64 / side  # (B,)
        plans = []
        for k in range(len(grids)):
            path, expansions, order = follow_predictions(
                costs[k],
                scores[k],
                costs_to_go[k],
                starts[k],
                goals[k],
                penalties[k],
                moves,
                self.movement.diagonal_cost,
                self.movement.corner_cutting,
            )
            plans.append(Plan(path.copy(), expansions, prepared=grids[0].size, order=order))
        return plans


@dataclass(frozen=True, eq=False)
class CostPlanner(Batched):
    """A* on predicted costs of the cells, such as heat maps, costmaps and guidance maps.

    It finds a path wherever there is one, and the cheapest one by the predicted costs, after
    `terrain_from_costs` has rounded them to 255 levels. Only their ratios count: where all free
    cells cost the same, it is A*.

    Attributes:
        name: name of its row in the table.
        movement: the rule of moves, which the problems must have.
        predict: a function of grids (B, H, W), starts (B, 2) and goals (B, 2), mostly one that
            asks a network. It returns the costs of the cells, (B, H, W), at least 0 and finite on
            free cells, as an array or as a tensor of the CPU.
        takes_terrain: whether ``predict`` has a parameter ``terrain``, the costs of the cells,
            (B, H, W).
    """

    name: str
    movement: Movement
    predict: Callable[..., ArrayLike] = field(repr=False)
    takes_terrain: bool = False

    def __post_init__(self) -> None:
        """Check the movement."""
        check_movement(self.movement)

    def plan_batch(
        self, grids: Bytes, starts: Ints, goals: Ints, terrain: Bytes | None = None
    ) -> list[Plan]:
        """Return a plan for each problem: grids and terrain (B, H, W), starts and goals (B, 2).

        Raises:
            ValueError: what `search_batch` and `terrain_from_costs` refuse; costs of another shape
                than that of the grids.
        """
        grids, starts, goals, costs = _problems_of(grids, starts, goals, terrain)
        problems = (grids, starts, goals)
        if costs is not None and self.takes_terrain:
            predicted = self.predict(*problems, terrain=costs)
        else:
            predicted = self.predict(*problems)
        if np.shape(predicted) != grids.shape:
            raise ValueError(
                f"{self.name}: predict gave shape {tuple(np.shape(predicted))}, expected "
                f"{grids.shape}"
            )
        paths = search_batch(
            "astar", *problems, self.movement, terrain=terrain_from_costs(predicted, grids)
        )
        return [
            Plan(path, expansions, prepared=grids[0].size)
            for path, expansions in zip(paths.paths(), paths.iterations.tolist(), strict=True)
        ]


def _problems_of(
    grids: Bytes, starts: Ints, goals: Ints, terrain: Bytes | None
) -> tuple[Bytes, Ints, Ints, Bytes | None]:
    """Return checked problems with a map each: (B, H, W), (B, 2), (B, 2), and terrain (B, H, W).

    A single map (H, W), which all problems share, is repeated, since functions that predict take a
    map for each problem.
    """
    grids, starts, goals = as_checked_problems(grids, starts, goals)
    maps = MapStack(grids, as_optional_terrain(terrain, grids))
    if len(grids) != len(starts):
        maps = maps.select(np.zeros(len(starts), np.int64))
    return maps.grids, starts, goals, maps.terrain
