"""The planners of a model: a walk and a search by its predictions, and how well they validate."""

from __future__ import annotations

import math
import warnings
from typing import Protocol

import numpy as np
import pandas as pd

from mapdata import Movement, ProblemSet, Sample, evaluate, evaluation
from mapdata.arrays import Bytes, Flags, Float32s, Ints
from mapdata.evaluation import Batched, Planner
from mapdata.search import search_batch

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
        takes_terrain: whether ``predict`` takes terrain.
    """

    movement: Movement
    takes_terrain: bool

    def predict(
        self, grids: Bytes, goals: Ints, terrain: Bytes | None = None
    ) -> tuple[Float32s, Float32s]:
        """Return scores of the moves (B, moves, H, W) and costs to go (B, H, W), in cells."""


def planners(model: Predictor) -> list[evaluation.GuidedSearch]:
    """Return the planners of a model, as rows for `mapdata.evaluate`: a walk and a search."""
    return [
        evaluation.GuidedSearch(
            f"path_predictor ({name})",
            model.movement,
            model.predict,
            trust,
            takes_terrain=model.takes_terrain,
        )
        for name, trust in (("walk", math.inf), ("search", evaluation.GuidedSearch.trust))
    ]


def GuidedSearch(  # noqa: N802  (it was a class)
    name: str, model: Predictor, trust: float = 0.15
) -> evaluation.GuidedSearch:
    """Return a `mapdata.evaluation.GuidedSearch` by a model. Deprecated: build that one."""
    warnings.warn(
        "mapdata.models.GuidedSearch(name, model, trust) is deprecated and will go in 0.5.0: use "
        "mapdata.evaluation.GuidedSearch(name, model.movement, model.predict, trust, "
        "takes_terrain=model.takes_terrain)",
        FutureWarning,
        stacklevel=2,
    )
    return evaluation.GuidedSearch(
        name, model.movement, model.predict, trust, takes_terrain=model.takes_terrain
    )
