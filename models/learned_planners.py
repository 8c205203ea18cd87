"""Planners that follow predicted moves: a walk and a best-first search, as rows of `evaluate`."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pandas as pd

from mapdata import Movement, ProblemSet, Sample, evaluate
from mapdata.arrays import Bytes, Flags, Float32s, Int8s, Ints
from mapdata.checks import check_number
from mapdata.evaluation import Batched, BatchPlanner, Plan, Planner
from mapdata.jit import Int, kernel
from mapdata.search import STEPS, as_terrain, search_batch

from .geometry import check_problems
from .model import Model

MIN_COST = 10.0
"""Least cost of a validation problem that counts, in cells, as in `ProblemSet.sample`."""


class LearnedPlanner(Batched, Model):
    """A model for one movement, whose planner is scored on validation batches."""

    movement: Movement

    def on_validation_epoch_start(self) -> None:
        """Forget the scores of the epoch before."""
        # A row of the table of `evaluate` for each validation batch: that of its hard problems.
        self.batch_scores: list[pd.Series] = []

    def score(self, planner: Planner, batch: Sample) -> None:
        """Plan the hard problems of a batch; `on_validation_epoch_end` logs how well that went.

        They are those that count in the tables: hard, and with a path of at least ``MIN_COST``.
        """
        grids = batch.map[:, 0].byte().cpu().numpy()
        starts = batch.start.cpu().numpy()
        goals = batch.goal.cpu().numpy()
        terrain = None
        if "terrain" in batch._fields:
            terrain = batch.terrain[:, 0].byte().cpu().numpy()
        paths = search_batch("astar", grids, starts, goals, self.movement, terrain=terrain)

        def problems_of(rows: Flags) -> ProblemSet:
            """Return the problems of these rows of the batch, (B,)."""
            terrain_of_rows = None if terrain is None else terrain[rows]
            arrays = grids[rows], starts[rows], goals[rows]
            return ProblemSet(*arrays, self.movement, terrain=terrain_of_rows)

        is_long = paths.cost >= MIN_COST  # the cost is -1 without a path
        is_hard = np.zeros(len(grids), bool)
        if is_long.any():
            is_hard[is_long] = problems_of(is_long).hard
        if is_hard.any():
            self.batch_scores.append(evaluate([planner], problems_of(is_hard), bootstrap=1).iloc[0])

    def on_validation_epoch_end(self) -> None:
        """Log Opt and Hmean of the planner on the hard problems, for the progress bar."""
        if self.batch_scores:
            rows = pd.DataFrame(self.batch_scores)
            opt, exp = np.average(rows[["opt", "p_exp"]], axis=0, weights=rows["n"])
            hmean = 2 * opt * exp / max(opt + exp, 1e-9)
            self.log_dict({"val_opt": opt, "val_hmean": hmean}, prog_bar=True)


class Predictor(Protocol):
    """A model that predicts moves and costs to go, as `mapdata.models.PathPredictor` does.

    Attributes:
        movement: the rule of moves.
        takes_terrain: whether the model plans on terrain. Otherwise `GuidedSearch` never gives it
            terrain.
    """

    movement: Movement
    takes_terrain: bool

    def predict(
        self, grids: Bytes, goals: Ints, terrain: Bytes | None = None
    ) -> tuple[Float32s, Float32s]:
        """Return scores of the moves (B, moves, H, W) and costs to go (B, H, W), in cells.

        A score is the log probability that the move is optimal, up to a constant for each cell. On
        terrain, (B, H, W), a cost to go is a cost on the terrain.
        """


def planners(model: Predictor) -> list[BatchPlanner]:
    """Return the planners of a model, as rows for `mapdata.evaluate`."""
    return [
        GuidedSearch("path_predictor (walk)", model, trust=math.inf),
        GuidedSearch("path_predictor (search)", model),
    ]


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

    A model that does not take terrain plans as if all free cells cost 1.

    Attributes:
        name: name of its row in the table.
        model: the model that predicts moves and costs to go.
        trust: penalty of a move whose odds squared are 2 on a map of 64 x 64, in cells of the mean
            cost.
    """

    name: str
    model: Predictor
    trust: float = 0.15

    @property
    def movement(self) -> Movement:
        """The movement of the model, which the problems must have."""
        return self.model.movement

    def __post_init__(self) -> None:
        """Check the trust, which may be infinite."""
        if not check_number("trust", self.trust) >= 0:  # this form also refuses NaN
            raise ValueError(f"trust: got {self.trust}, expected a number of at least 0")

    def plan_batch(
        self, grids: Bytes, starts: Ints, goals: Ints, terrain: Bytes | None = None
    ) -> list[Plan]:
        """Return a plan for each problem: grids and terrain (B, H, W), starts and goals (B, 2).

        Raises:
            ValueError: a start or goal outside its map or on an occupied cell; terrain that does
                not fit the grids; predictions of other shapes than `Predictor` says.
        """
        grids, starts, goals = check_problems(grids, starts, goals)
        if terrain is not None and self.model.takes_terrain:
            cell_costs = np.asarray(terrain)
            # A single problem may have a single map, (H, W), as in `check_problems`.
            terrain = as_terrain(cell_costs.reshape(-1, *cell_costs.shape[-2:]), grids)
            scores, costs_to_go = self.model.predict(grids, goals, terrain)
        else:
            terrain = (grids == 0).astype(np.uint8)
            scores, costs_to_go = self.model.predict(grids, goals)
        movement = self.model.movement
        # Compiled code does not check bounds: it would read past the end of smaller arrays.
        shapes = scores.shape, costs_to_go.shape
        expected = (len(grids), movement.connectivity, *grids.shape[1:]), grids.shape
        if shapes != expected:
            raise ValueError(f"{self.name}: predict gave shapes {shapes}, expected {expected}")
        moves = STEPS[: movement.connectivity]
        side = sum(grids.shape[1:]) / 2
        mean_costs = terrain.mean(axis=(1, 2), where=terrain > 0)  # (B,)
        penalties = self.trust * mean_costs * 64 / side  # (B,)
        plans = []
        for k in range(len(grids)):
            path, expansions = _search(
                terrain[k],
                scores[k],
                costs_to_go[k],
                starts[k],
                goals[k],
                penalties[k],
                moves,
                movement.diagonal_cost,
                movement.corner_cutting,
            )
            plans.append(Plan(path, expansions, prepared=grids[0].size))
        return plans


@kernel
def _search(
    terrain: Bytes,
    scores: Float32s,
    costs_to_go: Float32s,
    start: Ints,
    goal: Ints,
    penalty: float,
    moves: Ints,
    diagonal_cost: float,
    corner_cutting: bool,
) -> tuple[Ints, Int]:
    """Return the path of one problem, (k, 2) cells, and the number of expanded cells.

    Args:
        terrain: (H, W), the cost of each cell, 0 on occupied cells; 1 on all free cells of a map
            without terrain.
        scores: (moves, H, W), log probabilities, up to a constant for each cell.
        costs_to_go: (H, W), in cells.
        start: (2,), a free cell.
        goal: (2,), a free cell.
        penalty: penalty of a move whose odds squared are 2, in cells; infinite for a walk.
        moves: (4, 2) or (8, 2), rows and columns that each move goes; the last four of eight are
            the diagonal ones.
        diagonal_cost: length of a diagonal move, in cells.
        corner_cutting: whether a diagonal move may pass beside occupied cells.
    """
    rows, columns = terrain.shape
    lengths = np.full((rows, columns), np.inf)
    costs = np.full((rows, columns), np.inf)
    move_to = np.full((rows, columns), -1, np.int8)  # the move that leads to a cell from its parent
    expanded = np.zeros((rows, columns), np.bool_)
    legal = np.zeros(len(moves), np.bool_)
    lengths[start[0], start[1]] = 0.0
    costs[start[0], start[1]] = 0.0
    # Entries are (priority, tie-break, row, column); the smallest entry is popped first.
    frontier = [(0.0, 0.0, start[0], start[1])]
    pushes = 0
    expansions = 0
    while frontier:
        _, _, row, column = heapq.heappop(frontier)
        if expanded[row, column]:
            continue
        expanded[row, column] = True
        expansions += 1
        if row == goal[0] and column == goal[1]:
            break

        best_score = -np.inf
        for move in range(len(moves)):
            next_row = row + moves[move, 0]
            next_column = column + moves[move, 1]
            is_inside = 0 <= next_row < rows and 0 <= next_column < columns
            legal[move] = is_inside and terrain[next_row, next_column] != 0
            if legal[move] and move >= 4 and not corner_cutting:
                legal[move] = terrain[next_row, column] != 0 and terrain[row, next_column] != 0
            if legal[move]:
                best_score = max(best_score, scores[move, row, column])

        length = lengths[row, column]
        cost = costs[row, column]
        cell_cost = float(terrain[row, column])
        for move in range(len(moves)):
            if not legal[move]:
                continue
            next_row = row + moves[move, 0]
            next_column = column + moves[move, 1]
            mean_cost = (cell_cost + float(terrain[next_row, next_column])) / 2
            move_cost = mean_cost * (diagonal_cost if move >= 4 else 1.0)
            # A shorter path replaces the parent of an expanded cell, too, as in the classical
            # planners. Lengths only fall, and a cell's length always exceeds its parent's, so
            # parents never form a cycle.
            next_length = length + move_cost
            if next_length < lengths[next_row, next_column]:
                lengths[next_row, next_column] = next_length
                move_to[next_row, next_column] = move
            if expanded[next_row, next_column]:
                continue

            log_odds = best_score - scores[move, row, column]
            if penalty == np.inf:
                # Depth first: neighbours of the last expanded cell come before all other cells.
                heapq.heappush(frontier, (float(-expansions), log_odds, next_row, next_column))
                continue
            # Odds squared are at most e^20: no path is as long, and with larger numbers floats
            # would have no digits left for lengths. The bound is the first argument of min, which
            # returns it for log odds of NaN, too.
            odds_squared_minus_1 = math.expm1(min(20.0, 2 * log_odds))
            next_cost = cost + move_cost + penalty * odds_squared_minus_1
            if next_cost < costs[next_row, next_column]:
                costs[next_row, next_column] = next_cost
                to_go = costs_to_go[next_row, next_column]
                f = next_cost + to_go - 0.001 * lengths[next_row, next_column]
                pushes += 1
                heapq.heappush(frontier, (f, float(-pushes), next_row, next_column))
    return _trace(move_to, moves, start, goal), expansions


@kernel
def _trace(move_to: Int8s, moves: Ints, start: Ints, goal: Ints) -> Ints:
    """Return the path from start to goal, (k, 2) cells, or (0, 2) where the goal was not reached.

    Args:
        move_to: (H, W), the move that leads to a cell from its parent, or -1 without a parent.
        moves: (moves, 2), rows and columns that each move goes.
        start: (2,), a cell without a parent.
        goal: (2,), a cell.
    """
    row, column = goal
    is_start = row == start[0] and column == start[1]
    if move_to[row, column] == -1 and not is_start:
        return np.empty((0, 2), np.int64)
    # Parents lead from the goal to the start, so the array is filled from its end.
    cells = np.empty((move_to.size, 2), np.int64)  # no path has more cells than the map
    first = len(cells) - 1
    cells[first] = goal
    while row != start[0] or column != start[1]:
        move = move_to[row, column]
        row -= moves[move, 0]
        column -= moves[move, 1]
        first -= 1
        cells[first, 0] = row
        cells[first, 1] = column
    return cells[first:].copy()
