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
short. With the fields of ``FIELDS`` every cell knows all of its optimal moves, which teaches more:

    data = MapDataModule("data/maps", fields=FIELDS, problems="random", augment=True, batch_size=64)

So the weights that ship were made, with OMP_NUM_THREADS=1, by `python
scripts/train_path_predictor.py fit --weights models/weights/path_predictor.pt`: 7,500 steps of 40
maps, 20 minutes of one core. `torch.export.export(model, (map, goal))` and ONNX take it as it is.

This file reads from top to bottom: targets, what the network sees, loss, training, prediction. The
network's layers, the optimizer and the files of weights are in models/common.py; searches that a
prediction guides are in models/learned_planners.py.
"""

from __future__ import annotations

import math
from os import PathLike
from typing import Any

import numpy as np
import numpy.typing as npt
import pytorch_lightning as pl
import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from torch import Tensor, nn

from mapdata import Movement, Sample, check_path
from mapdata.arrays import Bytes, Float32s, Ints
from mapdata.search import STEPS
from models.common import Muon, Trunk, bfloat16, load_model, one_cycle, padded, save_model

FIELDS = ("map", "start", "goal", "optimal_moves", "heuristic_ratio")
"""The richer fields, which teach more than ``map, start, goal, path``."""

PRIOR = 3.0
"""How much less probable a move is, in log, for each cell of its detour, before any training."""

# --- data: a batch and its targets --------------------------------------------------------------


def targets(batch: Sample, movement: Movement) -> tuple[Tensor, Tensor]:
    """Return what each cell should predict, (B, H, W) both; cells without a target have no move.

    - optimal moves, a bit set: bit k says that move k starts a shortest path to the goal.
    - the heuristic ratio in [0, 1]: heuristic over true cost to the goal.
    """
    if "optimal_moves" not in batch._fields:
        return targets_on_path(batch, movement)
    return batch.optimal_moves[:, 0].long(), batch.heuristic_ratio[:, 0]


def targets_on_path(batch: Sample, movement: Movement) -> tuple[Tensor, Tensor]:
    """Return the targets that a path gives its own cells: the next move, and the ratio."""
    # (moves, 2): N, E, S, W, then NE, SE, SW, NW; bit k of a target is move k
    moves = torch.tensor(STEPS[: movement.connectivity], device=batch.path.device)
    steps = batch.path[:, 1:] - batch.path[:, :-1]  # (B, T - 1, 2)
    made = (steps[:, :, None] == moves).all(dim=3)  # (B, T - 1, moves), one-hot
    made &= batch.path[:, 1:, :1] >= 0  # not into the padding: from (0, 0) to (-1, -1) is NW
    # the true cost from each cell to the goal: that of the steps that follow, each of which costs
    # its own heuristic
    costs = (made * heuristic(moves[:, 0], moves[:, 1], movement)).sum(dim=2)  # (B, T - 1)
    to_go = costs.flip(1).cumsum(dim=1).flip(1)  # (B, T - 1)
    # the n cells of all paths, without their goals
    problem, k = made.any(dim=2).nonzero(as_tuple=True)  # (n,) both
    row, column = batch.path[problem, k].unbind(1)  # (n,) both
    down, right = (batch.path[problem, k] - batch.goal[problem]).unbind(1)  # (n,) both
    optimal = torch.zeros_like(batch.map[:, 0], dtype=torch.long)  # (B, H, W)
    optimal[problem, row, column] = 2 ** made[problem, k].long().argmax(dim=1)
    ratio = torch.zeros_like(batch.map[:, 0], dtype=torch.float)  # (B, H, W)
    ratio[problem, row, column] = heuristic(down, right, movement) / to_go[problem, k]
    return optimal, ratio


def heuristic(down: Tensor, right: Tensor, movement: Movement) -> Tensor:
    """Return the cost of going so far on an empty map: Manhattan, octile or Chebyshev distance."""
    down = down.abs().float()
    right = right.abs().float()
    if movement.connectivity == 4:
        return down + right
    return (down - right).abs() + movement.diagonal_cost * torch.minimum(down, right)


def neighbour(plane: Tensor, row: int, column: int) -> Tensor:
    """Return (B, H, W): of (B, H + 2, W + 2), the value beside each inner cell."""
    rows = plane.shape[1] - 2
    columns = plane.shape[2] - 2
    return plane[:, 1 + row : 1 + row + rows, 1 + column : 1 + column + columns]


def legal_moves(occupied: Tensor, movement: Movement) -> Tensor:
    """Return (B, moves, H, W) bool: which moves are allowed from each cell of (B, 1, H, W).

    The rule of `mapdata.search.is_legal` once more, for all cells at once on the device.
    """
    free = F.pad(occupied[:, 0] == 0, (1, 1, 1, 1))  # (B, H + 2, W + 2), a wall around the map
    legal = []
    for row, column in STEPS[: movement.connectivity].tolist():
        allowed = neighbour(free, row, column)
        if row and column and not movement.corner_cutting:  # diagonal: both sides must be free
            allowed = allowed & neighbour(free, row, 0) & neighbour(free, 0, column)
        legal.append(allowed)
    return torch.stack(legal, dim=1)


# --- what the network sees ----------------------------------------------------------------------


def encode(occupied: Tensor, goals: Tensor, movement: Movement) -> tuple[Tensor, Tensor]:
    """Return what the network sees of each cell, and the detour of each move.

    A move's detour is its cost plus the change of the heuristic: 0 for the moves that are optimal
    on an empty map. Scores start from it, so that only what walls change is left to learn.

    Args:
        occupied: (B, 1, H, W), 0 free and anything else occupied.
        goals: (B, 2), cells.
        movement: how one moves; it has 4 or 8 moves.

    Returns:
        (B, 8, H, W) and (B, moves, H, W), float32.
    """
    rows, columns = occupied.shape[2:]
    # one cell more on each side: a move from any cell leads to one whose heuristic is known
    down = torch.arange(-1, rows + 1, device=goals.device) - goals[:, :1]  # (B, H + 2)
    right = torch.arange(-1, columns + 1, device=goals.device) - goals[:, 1:]  # (B, W + 2)
    around = heuristic(down[:, :, None], right[:, None, :], movement)  # (B, H + 2, W + 2)
    least = neighbour(around, 0, 0)  # (B, H, W)
    detours = []
    for row, column in STEPS[: movement.connectivity].tolist():
        cost = movement.diagonal_cost if row and column else 1.0
        detours.append(cost + neighbour(around, row, column) - least)
    down = down[:, 1:-1, None].float()  # (B, H, 1)
    right = right[:, None, 1:-1].float()  # (B, 1, W)
    planes = [
        occupied[:, 0] == 0,  # free cells
        least == 0,  # the goal
        least / 64,  # divisors bring all planes to a size of about 1
        down / 32,
        right / 32,
        (down / 4).clamp(-1, 1),  # finer, near the goal's row and column
        (right / 4).clamp(-1, 1),
        ((down.abs() - right.abs()) / 4).clamp(-1, 1),  # and near its diagonals
    ]
    seen = torch.stack([plane.float().expand_as(least) for plane in planes], dim=1)
    return seen, torch.stack(detours, dim=1)


# --- network, loss and training -----------------------------------------------------------------


class PathPredictor(pl.LightningModule):
    """Predicts optimal moves and the heuristic ratio of every cell, given map and goal.

    A batch has the fields ``map, start, goal, path`` or ``FIELDS``; its paths move as the model
    does. A list of batches, of several map sizes even, is one step.

    Args:
        connectivity: 4 or 8 moves.
        corner_cutting: whether diagonal moves pass beside occupied cells.
        diagonal_cost: of a diagonal move, sqrt(2) or 1.
        widths: channels at strides 2, 4 and 8.
        passes: exchanges between strides 4 and 8: how far information travels.
        learning_rate: the highest; it rises over 100 steps and falls until the last step.
        ratio_weight: weight of the heuristic ratio's squared error.
        detour_weight: how much more cells count where the heuristic is more than 2 % too low.
    """

    def __init__(
        self,
        connectivity: int = 8,
        corner_cutting: bool = False,
        diagonal_cost: float = math.sqrt(2),
        widths: tuple[int, int, int] = (32, 48, 48),
        passes: int = 3,
        learning_rate: float = 0.004,
        ratio_weight: float = 5.0,
        detour_weight: float = 2.0,
    ) -> None:
        """Make the network."""
        super().__init__()
        self.save_hyperparameters()
        self.movement = Movement(connectivity, corner_cutting, diagonal_cost)
        self.network = Trunk(8, connectivity + 1, widths, passes)
        nn.init.zeros_(self.network.head.weight)

    def forward(self, occupied: Tensor, goals: Tensor) -> tuple[Tensor, Tensor]:
        """Return scores of the moves (B, moves, H, W) and heuristic ratios (B, H, W) in [0, 1].

        Args:
            occupied: (B, 1, H, W), 0 free and anything else occupied; any H and W.
            goals: (B, 2), cells.
        """
        rows, columns = occupied.shape[2:]
        seen, detour = encode(padded(occupied), goals, self.movement)
        out, _ = self.network(seen)  # (B, moves + 1, H, W) and up to 7 cells more
        out = out[..., :rows, :columns].float()
        # before it has learned anything, the most probable moves lead straight to the goal
        scores = out[:, :-1] - PRIOR * detour[..., :rows, :columns]
        return scores, torch.sigmoid(out[:, -1])

    def losses(self, batch: Sample | list[Sample]) -> dict[str, Tensor]:
        """Return ``loss``, its part for ``moves``, and ``accuracy``.

        Accuracy is the share of cells whose most probable legal move is optimal.
        """
        batches = batch if isinstance(batch, list) else [batch]
        sums = torch.stack([self._sums(each) for each in batches]).sum(dim=0)
        move_loss, weight, squared_error, right, cells = sums
        moves = move_loss / weight
        loss = moves + self.hparams["ratio_weight"] * squared_error / cells
        return {"loss": loss, "moves": moves, "accuracy": right / cells}

    def _sums(self, batch: Sample) -> Tensor:
        """Return (5,), sums over the cells with a target; those of several batches add up.

        Loss of the moves, its weight, squared error of the ratio, right answers, cells.
        """
        scores, ratios = self(batch.map, batch.goal)  # (B, moves, H, W) and (B, H, W)
        scores = scores.masked_fill(~legal_moves(batch.map, self.movement), -math.inf)
        optimal, ratio = targets(batch, self.movement)  # (B, H, W) both
        cells = optimal.nonzero(as_tuple=True)  # the n cells that have a target
        scores = scores.permute(0, 2, 3, 1)[cells]  # (n, moves)
        ratio = ratio[cells]  # (n,)
        bits = 2 ** torch.arange(scores.shape[1], device=scores.device)  # (moves,)
        good = (optimal[cells][:, None] & bits) != 0  # (n, moves)
        # -log of the probability of making any of the optimal moves: ties need no decision
        good_scores = scores.masked_fill(~good, -math.inf)
        loss = scores.logsumexp(1) - good_scores.logsumexp(1)  # (n,)
        weight = 1 + self.hparams["detour_weight"] * (ratio < 0.98)  # (n,)
        error = (ratios[cells] - ratio) ** 2  # (n,)
        right = good.gather(1, scores.argmax(1, keepdim=True))  # (n, 1)
        count = torch.ones_like(ratio)  # (n,)
        parts = [loss * weight, weight, error, right[:, 0].float(), count]
        return torch.stack(parts).sum(dim=1)

    def training_step(self, batch: Sample | list[Sample], batch_idx: int) -> Tensor:
        """Return the loss of one step."""
        values = self.losses(batch)
        self.log_dict({f"train_{name}": value for name, value in values.items()}, prog_bar=True)
        return values["loss"]

    def validation_step(self, batch: Sample, batch_idx: int, dataloader_idx: int = 0) -> None:
        """Log the losses."""
        values = {f"val_{name}": value for name, value in self.losses(batch).items()}
        self.log_dict(values, batch_size=len(batch.map))

    def configure_optimizers(self) -> Any:
        """Return Muon, since AdamW needs more steps here, and torch's OneCycleLR."""
        optimizer = Muon(self.parameters(), self.hparams["learning_rate"])
        return one_cycle(optimizer, self.trainer.estimated_stepping_batches)

    # --- prediction -----------------------------------------------------------------------------

    def predict(self, grids: Bytes, goals: Ints) -> tuple[Float32s, Float32s]:
        """Return scores of the moves (B, moves, H, W) and heuristic ratios (B, H, W).

        A score is a log probability, up to a constant a cell.

        Args:
            grids: (B, H, W), 0 free and 1 occupied.
            goals: (B, 2), cells.
        """
        occupied = torch.from_numpy(np.array(grids, np.uint8))[:, None].to(self.device)
        cells = torch.from_numpy(np.array(goals, np.int64)).to(self.device)
        with torch.inference_mode(), bfloat16(self.device):
            scores, ratios = self(occupied, cells)
        return scores.cpu().contiguous().numpy(), ratios.cpu().numpy()

    def predict_path(self, map: npt.ArrayLike, start: npt.ArrayLike, goal: npt.ArrayLike) -> Ints:
        """Return the predicted path, (k, 2) cells; (0, 2) where the moves do not lead to the goal.

        From the start on, the most probable legal move to a cell that is not on the path yet.

        Args:
            map: (H, W) or (1, H, W), 0 free and 1 occupied.
            start: its cell.
            goal: its cell.

        Raises:
            ValueError: a start or goal outside the map or on an occupied cell.
        """
        grid = np.asarray(map).astype(np.uint8).reshape(1, *np.shape(map)[-2:])  # (1, H, W)
        for end in (start, goal):
            # a path of one cell: refused unless it is a free cell of the map
            check_path(grid[0], np.asarray(end)[None], self.movement)
        scores = self.predict(grid, np.asarray(goal)[None])[0][0]  # (moves, H, W)
        legal = legal_moves(torch.from_numpy(grid)[:, None], self.movement)[0]  # (moves, H, W)
        last = tuple(np.asarray(goal).tolist())
        path = [tuple(np.asarray(start).tolist())]
        while path[-1] != last:
            row, column = path[-1]
            options = []
            for move, (down, right) in enumerate(STEPS[: len(scores)].tolist()):
                cell = (row + down, column + right)
                if legal[move, row, column] and cell not in path:
                    options.append((scores[move, row, column], cell))
            if not options:
                return np.empty((0, 2), np.int64)
            path.append(max(options)[1])
        return np.array(path)

    def save(self, file: str | PathLike[str]) -> None:
        """Write weights and arguments, as plain types and tensors."""
        save_model(self, file, torch.float32)

    @staticmethod
    def load(file: str | PathLike[str]) -> PathPredictor:
        """Return the model that `save` wrote, ready to plan.

        Raises:
            FileNotFoundError: no such file.
            ValueError: it holds no saved PathPredictor.
        """
        return load_model(file, PathPredictor)
