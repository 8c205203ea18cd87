"""Planners that follow predicted moves, a walk and a best-first search: rows of `evaluate`."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pandas as pd

from mapdata import Movement, Problems, Sample, evaluate
from mapdata.arrays import Bytes, Float32s, Ints
from mapdata.evaluation import Batched, BatchPlanner, Plan, Planner
from mapdata.jit import Int, kernel
from mapdata.search import (
    WALL,
    Rule,
    cell_at,
    count_moves,
    in_cells,
    is_legal,
    lattice_of,
    load,
    position,
    rule_of,
    search_batch,
    write_cells,
)
from models.geometry import check_problems
from models.model import Model


class LearnedPlanner(Batched, Model):
    """A model for one movement, whose planner is scored on validation batches."""

    movement: Movement

    def on_validation_epoch_start(self) -> None:
        """Begin without a validation batch."""
        # the row of `evaluate` for each of them
        self.validated: list[pd.Series] = []

    def score(self, planner: Planner, batch: Sample) -> None:
        """Plan the problems of a batch: `on_validation_epoch_end` logs the results."""
        grids = batch.map[:, 0].byte().cpu().numpy()
        starts = batch.start.cpu().numpy()
        goals = batch.goal.cpu().numpy()
        # where there is a path, of more than one cell
        asked = search_batch("astar", grids, starts, goals, self.movement).cost > 0
        if asked.any():
            problems = Problems(grids[asked], starts[asked], goals[asked], self.movement)
            self.validated.append(evaluate([planner], problems, bootstrap=1).iloc[0])

    def on_validation_epoch_end(self) -> None:
        """Log Opt and Hmean of the planner on all validation problems, for the progress bar."""
        if self.validated:
            rows = pd.DataFrame(self.validated)
            opt, exp = np.average(rows[["opt", "p_exp"]], axis=0, weights=rows["n"])
            hmean = 2 * opt * exp / max(opt + exp, 1e-9)
            self.log_dict({"val_opt": opt, "val_hmean": hmean}, prog_bar=True)


class Predictor(Protocol):
    """What predicts moves and costs to go, such as `models.path_predictor.PathPredictor`."""

    movement: Movement

    def predict(self, grids: Bytes, goals: Ints) -> tuple[Float32s, Float32s]:
        """Return scores of the moves (B, moves, H, W) and costs to go (B, H, W), in cells."""


def planners(model: Predictor) -> list[BatchPlanner]:
    """Return the planners of a model, as rows for `mapdata.evaluate`."""
    return [
        GuidedSearch("path_predictor (walk)", model, trust=math.inf),
        GuidedSearch("path_predictor (search)", model),
    ]


@dataclass(frozen=True, eq=False)
class GuidedSearch(Batched):
    """Best-first search by the cost so far, the predicted cost to go, and improbable moves.

    f = g + ``trust`` * 64 / side * (sum over the moves of odds squared - 1) + predicted cost to go,
    where side is the mean of a map's sides, since longer ways have more moves that are nearly as
    good, and the odds of a move are P(best legal move) / P(move), at most e^10. They are squared,
    since of two moves that are nearly as probable either may be optimal, while one of four times
    less hardly ever is. Of nearly equal f the cell of the longer way is first (f is less by 0.001
    of it), then the one that was pushed last. A cell is expanded once; it finds a path where there
    is one. A cell that is looked at again takes the shorter way as its own, and the path is that of
    the parents.

    Infinite trust makes it a walk, a depth-first search: from the cell that was expanded last it
    takes the most probable move to an unexpanded one, and goes back where there is none.

    Attributes:
        name: its name in the table.
        model: what predicts moves and costs to go.
        trust: cost, in cells, of a move whose odds squared are 2, on a map of 64 x 64.
    """

    name: str
    model: Predictor
    trust: float = 0.15

    def plan_batch(self, grids: Bytes, starts: Ints, goals: Ints) -> list[Plan]:
        """Return a plan for each problem: grids (B, H, W), starts and goals (B, 2).

        Raises:
            ValueError: a start or goal outside its map or on an occupied cell, or predictions of
                other shapes than `Predictor` says.
        """
        grids, starts, goals = check_problems(grids, starts, goals)
        scores, costs = self.model.predict(grids, goals)
        # the search is compiled, and reads past the end of smaller arrays without a word
        found = scores.shape, costs.shape
        expected = (len(grids), self.model.movement.connectivity, *grids.shape[1:]), grids.shape
        if found != expected:
            raise ValueError(f"{self.name}: predict gave shapes {found}, expected {expected}")
        rule = rule_of(self.model.movement)
        trust = self.trust * 128 / sum(grids.shape[1:])
        problems = zip(grids, scores, costs, starts, goals, strict=True)
        return [Plan(*_search(*each, rule, trust)) for each in problems]


@kernel
def _search(
    grid: Bytes,
    scores: Float32s,
    costs: Float32s,
    start: Ints,
    goal: Ints,
    rule: Rule,
    trust: float,
) -> tuple[Ints, Int]:
    """Return the path (k, 2) of one problem, and how many cells were expanded."""
    lattice = lattice_of(grid.shape, rule)
    # of each cell the move that led there, WALL or UNSEEN, and the cost of the way
    came = np.full(lattice.cells, WALL)
    load(grid, came)
    way = np.full(lattice.cells, np.inf)
    first = cell_at(start[0], start[1], lattice)
    last = cell_at(goal[0], goal[1], lattice)
    came[first] = 0  # any move: a path is traced back only as far as its start
    way[first] = 0.0
    # the cost of the best way so far and of its improbable moves; -inf once a cell is expanded
    best = way.copy()
    heap = [(0.0, 0.0, first)]
    pushes = 0
    expansions = 0
    while heap:
        _, _, cell = heapq.heappop(heap)
        so_far = best[cell]
        if so_far == -np.inf:
            continue
        best[cell] = -np.inf
        expansions += 1
        if cell == last:
            break
        row, column = position(cell, lattice)
        top = -np.inf
        for move in range(len(lattice.offsets)):
            if is_legal(came, cell, move, lattice):
                top = max(top, scores[move, row, column])
        for move in range(len(lattice.offsets)):
            if not is_legal(came, cell, move, lattice):
                continue
            to = cell + lattice.offsets[move]
            step = 1.0 if move < 4 else in_cells(lattice.step)
            # A cell that was expanded already takes the shorter way, too, without being expanded
            # again, as in the classical planners. Ways only become shorter, and a cell's is longer
            # than its parent's, so parents never go round in a circle.
            if way[cell] + step < way[to]:
                way[to] = way[cell] + step
                came[to] = move
            if best[to] == -np.inf:
                continue
            loss = top - scores[move, row, column]
            if trust == np.inf:
                heapq.heappush(heap, (float(-expansions), loss, to))  # depth first
                continue
            # Odds squared - 1, at most e^20: no path costs as much, and larger numbers would have
            # no digits left for steps. It comes first, so that it takes the place of nan, too.
            cost = so_far + step + trust * math.expm1(min(20.0, 2 * loss))
            if cost < best[to]:
                best[to] = cost
                pushes += 1
                to_go = costs[position(to, lattice)]
                f = cost + to_go - 0.001 * way[to]  # among equals the farthest first
                heapq.heappush(heap, (f, float(-pushes), to))
    straight, diagonal = count_moves(came, first, last, lattice)  # -1 and 0 without a path
    path = np.empty((straight + diagonal + 1, 2), np.int64)
    write_cells(came, last, lattice, path)
    return path, expansions
