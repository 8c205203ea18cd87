"""A CNN that learns to plan from examples: maps with a start, a goal and a shortest path.

For every cell of a map it predicts the moves that lead to the goal, and how far the heuristic is
below the true cost. Following the most probable moves gives a path:

    import pytorch_lightning as pl
    from mapdata import MapDataModule
    from models.path_predictor import PathPredictor

    data = MapDataModule("data/maps", build="paper", batch_size=64)  # map, start, goal, path
    model = PathPredictor(connectivity=4)
    pl.Trainer(max_epochs=2).fit(model, data)
    sample = data.datasets["val"][0]
    path = model.predict_path(sample.map, sample.start, sample.goal)  # (k, 2) cells

A path labels its own cells alone, and in an open room it is one of very many that are equally
short. With the fields of ``TRAINING_FIELDS`` every cell knows all of its optimal moves, which
teaches more:

    data = MapDataModule(
        "data/maps", fields=TRAINING_FIELDS, problems="random", augment=True, batch_size=64
    )

So the weights that ship were made, with OMP_NUM_THREADS=1, by `python
scripts/train_path_predictor.py fit --weights models/weights/path_predictor.pt`: 7,000 steps of 39
maps of all families and 4 larger ones, 50 minutes of one core; then 1,000 steps, 10 minutes more,
with what scripts/refine_path_predictor.yaml adds. Those of other rules, path_predictor_cut.pt and
path_predictor_4.pt, are by its side (docs/planners.md).
`torch.export.export(model, (map, goal))` and ONNX take the network as it is.

This file reads from top to bottom: targets, what the network sees, network, loss, training,
prediction. The layers are in layers.py, the moves on a map in geometry.py, the optimizer in
optimizer.py, the training step and the files of weights in model.py; learned_planners.py searches
with predictions.
"""

from __future__ import annotations

import math
from collections import defaultdict

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor, nn

from mapdata import Movement, Sample
from mapdata.arrays import Bytes, Float32s, Ints
from mapdata.search import STEPS
from models.geometry import heuristic, legal_moves, offsets
from models.layers import Trunk, padded
from models.learned_planners import GuidedSearch, LearnedPlanner
from models.model import Tensors

TRAINING_FIELDS = ("map", "start", "goal", "optimal_moves", "heuristic_ratio")
"""The richer fields, which teach more than ``map, start, goal, path``."""

PRIOR = 3.0
"""How much less probable a move is, in log, for each cell of its detour, before any training."""

HALF_TURN = [2, 3, 0, 1, 6, 7, 4, 5]
"""What each move is after half a turn: N is S, E is W, NE is SW, and so on."""

# --- data: what each cell should predict --------------------------------------------------------


def targets_on_path(batch: Sample, movement: Movement) -> tuple[Tensor, Tensor]:
    """Return the targets that a path gives its own cells, as `targets` does."""
    cells = batch.path[:, :-1]  # (B, T - 1, 2)
    steps = batch.path.diff(dim=1)  # (B, T - 1, 2)
    # (moves, 2): N, E, S, W, then NE, SE, SW, NW; bit k of a target is move k
    moves = torch.tensor(STEPS[: movement.connectivity], device=cells.device)
    made = (steps[:, :, None] == moves).all(dim=3)  # (B, T - 1, moves), one-hot
    made[batch.path[:, 1:, 0] < 0] = False  # not into the padding: from (0, 0) to (-1, -1) is NW
    labelled = made.any(dim=2)  # (B, T - 1): all cells of a path but its goal
    # the true cost to the goal: of all steps that follow, each of which costs its own heuristic
    down, right = steps.unbind(2)  # (B, T - 1) both
    costs = heuristic(down, right, movement) * labelled  # (B, T - 1)
    to_go = costs.flip(1).cumsum(dim=1).flip(1)  # (B, T - 1)
    down, right = (cells - batch.goal[:, None]).unbind(2)  # (B, T - 1) both
    ratios = heuristic(down, right, movement) / to_go  # (B, T - 1)
    bits = 2 ** made.long().argmax(dim=2)  # (B, T - 1)
    problem, _ = labelled.nonzero(as_tuple=True)  # (n,), of the cells of all paths
    at = (problem, *cells[labelled].unbind(1))  # (n,) each: map, row and column of each of them
    optimal = torch.zeros_like(batch.map[:, 0], dtype=torch.long)  # (B, H, W)
    optimal[at] = bits[labelled]
    ratio = torch.zeros_like(optimal, dtype=torch.float)  # (B, H, W)
    ratio[at] = ratios[labelled]
    return optimal, ratio


def targets(batch: Sample, movement: Movement) -> tuple[Tensor, Tensor]:
    """Return what each cell should predict, (B, H, W) both; cells without a target have no move.

    - optimal moves, a bit set: bit k says that move k starts a shortest path to the goal.
    - the heuristic ratio in [0, 1]: heuristic over true cost to the goal.
    """
    if "optimal_moves" in batch._fields:
        return batch.optimal_moves[:, 0].long(), batch.heuristic_ratio[:, 0]
    return targets_on_path(batch, movement)


# --- what the network sees ----------------------------------------------------------------------


def encode(occupied: Tensor, goals: Tensor, movement: Movement) -> tuple[Tensor, Tensor]:
    """Return what the network sees, (B, 8, H, W), and the detours of the moves, (B, moves, H, W).

    A move's detour is its cost plus the change of the heuristic: 0 for the moves that are optimal
    on an empty map. Scores start from it, so that only what walls change is left to learn.

    Args:
        occupied: (B, 1, H, W), 0 free and anything else occupied.
        goals: (B, 2), cells.
        movement: how one moves.
    """
    down, right = offsets(goals, occupied.shape[2:])  # from the goal: (B, H, 1) and (B, 1, W)
    least = heuristic(down, right, movement)  # (B, H, W)
    detours = []
    for row, column in STEPS[: movement.connectivity].tolist():
        cost = movement.diagonal_cost if row and column else 1.0
        detours.append(cost + heuristic(down + row, right + column, movement) - least)
    free = (occupied[:, 0] == 0).float()
    at_goal = (least == 0).float()
    # finer ones, near the goal's row, its column and its diagonals
    fine = [(each / 4).clamp(-1, 1) for each in (down, right, down.abs() - right.abs())]
    # divisors bring all planes to a size of about 1
    planes = torch.broadcast_tensors(free, at_goal, least / 64, down / 32, right / 32, *fine)
    return torch.stack(planes, dim=1), torch.stack(detours, dim=1)


# --- network, loss and training -----------------------------------------------------------------


class PathPredictor(LearnedPlanner):
    """Predicts optimal moves and the heuristic ratio of every cell, given map and goal.

    A batch has the fields ``map, start, goal, path`` or ``TRAINING_FIELDS``; its paths move as the
    model does. A list of batches, of several map sizes even, is one step.

    Args:
        connectivity: 4 or 8 moves.
        corner_cutting: whether diagonal moves pass beside occupied cells.
        diagonal_cost: of a diagonal move, sqrt(2) or 1.
        widths: channels at strides 2, 4, 8 and so on; 16 is the last.
        passes: exchanges between strides from 4 on: how far information travels.
        refinements: residual blocks at stride 2 after them: how well it decides where single cells
            matter, as in noise.
        learning_rate: the highest; it rises over 100 steps and falls until the last step.
        ratio_weight: weight of the heuristic ratio's squared error.
        detour_weight: how much more cells count where the heuristic is more than 2 % too low.
    """

    def __init__(
        self,
        connectivity: int = 8,
        corner_cutting: bool = False,
        diagonal_cost: float = math.sqrt(2),
        widths: tuple[int, ...] = (32, 48, 48),
        passes: int = 3,
        refinements: int = 0,
        learning_rate: float = 0.004,
        ratio_weight: float = 5.0,
        detour_weight: float = 2.0,
    ) -> None:
        """Make the network."""
        super().__init__()
        self.save_hyperparameters()
        self.movement = Movement(connectivity, corner_cutting, diagonal_cost)
        self.network = Trunk(8, connectivity + 1, widths, passes, refinements)
        nn.init.zeros_(self.network.head.weight)

    def forward(self, occupied: Tensor, goals: Tensor) -> tuple[Tensor, Tensor]:
        """Return scores of the moves (B, moves, H, W) and heuristic ratios (B, H, W) in [0, 1].

        Args:
            occupied: (B, 1, H, W), 0 free and anything else occupied; any H and W.
            goals: (B, 2), cells.
        """
        rows, columns = occupied.shape[2:]
        seen, detour = encode(padded(occupied), goals, self.movement)
        out = self.network(seen)  # (B, moves + 1, H, W) and up to 15 cells more
        out = out[..., :rows, :columns].float()
        # before it has learned anything, the most probable moves lead straight to the goal
        scores = out[:, :-1] - PRIOR * detour[..., :rows, :columns]
        return scores, torch.sigmoid(out[:, -1])

    def losses(self, batch: Sample | list[Sample]) -> Tensors:
        """Return ``loss``, its part for ``moves``, and ``accuracy``.

        Accuracy is the share of cells whose most probable legal move is optimal.
        """
        # maps of one size together: the network takes half the time for one large batch
        sizes: dict[torch.Size, list[list[Tensor]]] = defaultdict(list)
        for each in batch if isinstance(batch, list) else [batch]:
            optimal, ratio = targets(each, self.movement)  # (B, H, W) both
            sizes[each.map.shape[2:]].append([each.map, each.goal, optimal, ratio])
        cells = [
            self.cell_losses(*map(torch.cat, zip(*parts, strict=True))) for parts in sizes.values()
        ]
        move_loss, squared_error, right, weight = torch.cat(cells, dim=1)  # (n,) each
        moves = (weight * move_loss).sum() / weight.sum()
        loss = moves + self.hparams["ratio_weight"] * squared_error.mean()
        return {"loss": loss, "moves": moves, "accuracy": right.mean()}

    def cell_losses(
        self, occupied: Tensor, goals: Tensor, optimal: Tensor, ratio: Tensor
    ) -> Tensor:
        """Return (4, n) of the n cells that have a target, of `targets`.

        Loss of the moves, squared error of the ratio, 1 where the answer is right, weight.
        """
        scores, ratios = self(occupied, goals)  # (B, moves, H, W) and (B, H, W)
        scores = scores.masked_fill(~legal_moves(occupied, self.movement), -math.inf)
        cells = optimal.nonzero(as_tuple=True)  # the n cells that have a target
        scores = scores.permute(0, 2, 3, 1)[cells]  # (n, moves)
        ratio = ratio[cells]  # (n,)
        bits = 2 ** torch.arange(scores.shape[1], device=scores.device)  # (moves,)
        good = (optimal[cells][:, None] & bits) != 0  # (n, moves)
        # -log of the probability of making any of the optimal moves: ties need no decision
        good_scores = scores.masked_fill(~good, -math.inf)
        move_loss = scores.logsumexp(1) - good_scores.logsumexp(1)  # (n,)
        squared_error = (ratios[cells] - ratio) ** 2  # (n,)
        right = good.gather(1, scores.argmax(1, keepdim=True))[:, 0].float()  # (n,)
        weight = 1 + self.hparams["detour_weight"] * (ratio < 0.98)  # (n,)
        return torch.stack([move_loss, squared_error, right, weight])

    def validation_step(self, batch: Sample, batch_idx: int, dataloader_idx: int = 0) -> None:
        """Log the losses, and search: `on_validation_epoch_end` logs what comes of it."""
        values = {f"val_{name}": value for name, value in self.losses(batch).items()}
        self.log_dict(values, batch_size=len(batch.map))
        self.score(GuidedSearch("search", self), batch)

    # --- prediction -----------------------------------------------------------------------------

    def predict(self, grids: Bytes, goals: Ints) -> tuple[Float32s, Float32s]:
        """Return scores of the moves (B, moves, H, W) and the costs to go (B, H, W), in cells.

        A score is a log probability, up to a constant a cell. Scores and ratios are means over two
        views, the map and the map after half a turn, which takes twice the time: shorter paths for
        no more expansions. `costs_to_go` makes costs of the ratios.

        Args:
            grids: (B, H, W), 0 free and 1 occupied.
            goals: (B, 2), cells.
        """
        occupied, cells = self.tensors(np.not_equal(grids, 0)[:, None], goals)
        last = torch.tensor(occupied.shape[2:], device=self.device) - 1
        with self.inference():
            scores, ratios = self(occupied, cells)
            turned_scores, turned_ratios = self(occupied.flip(2, 3), last - cells)
            scores += turned_scores[:, HALF_TURN[: scores.shape[1]]].flip(2, 3)
            ratios += turned_ratios.flip(1, 2)
            costs = self.costs_to_go(occupied, cells, scores, ratios / 2)
        return (scores / 2).cpu().contiguous().numpy(), costs.cpu().numpy()

    def costs_to_go(
        self, occupied: Tensor, goals: Tensor, scores: Tensor, ratios: Tensor
    ) -> Tensor:
        """Return the predicted cost from each cell to the goal, (B, H, W), as an n-step return.

        That is what the 32 most probable moves from the cell cost, each the most probable of the
        cell that it starts from, and the cost to go that the network predicts where they end.
        Neighbours whose ways meet have nearly the same error, so that a search is not led astray by
        the difference. Ways are followed, never compared. No expansions are counted for it:
        docs/planners.md says what it is worth, and how often it reaches the goal.

        Sutton and Barto, Reinforcement Learning: An Introduction, 2nd edition, section 7.1.

        Args:
            occupied: (B, 1, H, W), 0 free and anything else occupied.
            goals: (B, 2), cells.
            scores: (B, moves, H, W).
            ratios: (B, H, W), of heuristic and cost to go; one below 0.05 counts as that.
        """
        least = heuristic(*offsets(goals, ratios.shape[1:]), self.movement)  # (B, H, W)
        # the goal has no moves, so that a way which reaches it ends there
        legal = legal_moves(occupied, self.movement) & (least > 0)[:, None]  # (B, moves, H, W)
        best, move = torch.where(legal, scores, -math.inf).max(dim=1)  # (B, H, W) both
        goes_on = best > -math.inf
        down, right = torch.tensor(STEPS[: scores.shape[1]], device=self.device).T  # (moves,) both
        cost = heuristic(down, right, self.movement)[move] * goes_on
        jump = (down * ratios.shape[2] + right)[move] * goes_on
        # the cell that the move leads to, numbered through all maps of the batch
        to = torch.arange(move.numel(), device=self.device).view_as(move) + jump
        for _ in range(5):  # of 1, 2, 4, 8 and 16 moves it makes twice as many
            cost = cost + cost.take(to)
            to = to.take(to)
        return cost + (least / ratios.clamp(min=0.05)).take(to)

    def predict_path(self, map: ArrayLike, start: ArrayLike, goal: ArrayLike) -> Ints:
        """Return the predicted path, (k, 2) cells; (0, 2) where there is none.

        From the start on, the most probable legal move to a cell that the walk has not been to;
        where it is stuck it goes on from the cell before. The path is the shortest way that the
        walk has seen.

        Args:
            map: (H, W) or (1, H, W), 0 free and 1 occupied.
            start: its cell.
            goal: its cell.

        Raises:
            ValueError: a start or goal outside the map or on an occupied cell.
        """
        walk = GuidedSearch("walk", self, trust=math.inf)
        return walk.plan(map, start, goal).path.astype(np.int64)
