"""A CNN that predicts paths: for every cell, the moves that start a shortest path to the goal.

One path as a target is ill-posed: between two cells of a room there are 10^5 equally good ones. The
set of optimal moves of each cell is unique, and gives some 2,000 labelled cells a map. Following
the most probable moves is a path.

    from mapdata import MapSpec, Movement
    from mapdata.evaluation import evaluate
    from mapdata.problems import Problems
    from models.learned_planners import planners
    from models.path_predictor import PathPredictor

    model = PathPredictor.load("models/weights/path_predictor.pt")
    problems = Problems.sample(MapSpec.preset("dungeon"), seed=77, maps=600)
    path = model.predict_path(problems.grids[0], problems.starts[0], problems.goals[0])  # (k, 2)
    cells print(evaluate(planners(model), problems))

`python scripts/train_path_predictor.py fit --weights models/weights/path_predictor.pt` made the
weights that ship, with OMP_NUM_THREADS=1: 7,500 steps of 40 maps, 20 minutes of one core of an AMD
EPYC. On two cores it
takes 13: a step takes 0.10 s instead of 0.15 s.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from os import PathLike
from typing import Any

import numpy as np
import numpy.typing as npt
import pytorch_lightning as pl
import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from pytorch_lightning.utilities import CombinedLoader
from torch import Tensor, nn
from torch.utils.data import DataLoader

from mapdata.arrays import Bytes, Float32s, Ints
from mapdata.datasets import MapDataModule, Sample
from mapdata.search import STEPS, heuristics
from mapdata.spec import Movement
from models.layers import Muon, Trunk, bfloat16, padded, scheduled
from models.learned_planners import LearnedPlanner
from models.saved import load_model, save_model

FIELDS = ("map", "start", "goal", "optimal_moves", "heuristic_ratio")
"""What a data module must serve."""


# --- what the network sees ----------------------------------------------------------------------


@lru_cache(maxsize=16)
def _surroundings(rows: int, columns: int, movement: Movement) -> Tensor:
    """Return what lies about a goal in the middle, ((2 rows - 1) * (2 columns - 1), 8 + moves), a
    line a cell.

    Of each cell: a place for the map, the goal, six planes, and the detour of each move: its cost
    plus the
    change of the heuristic, 0 for the moves that would be optimal on an empty map.
    """
    goal = np.array([rows - 1, columns - 1])
    cells = np.moveaxis(
        np.indices((2 * rows - 1, 2 * columns - 1)), 0, -1
    )  # (2 rows - 1, 2 columns - 1, 2)
    down, right = torch.from_numpy(cells - goal).float().unbind(-1)
    least = heuristics(cells, goal, movement)
    here = torch.from_numpy(least).float()
    near, side = (
        [torch.clamp(each / 4, -1, 1) for each in (down, right)],
        (down.abs() - right.abs()) / 4,
    )
    planes = [torch.zeros_like(here), (here == 0).float()]
    planes += [here / 64, down / 32, right / 32, *near, side.clamp(-1, 1)]
    steps = STEPS[: movement.connectivity]
    # a move's own cost is the heuristic from (0, 0) to where it leads
    through = heuristics(cells[:, :, None] + steps, goal, movement) + heuristics(
        steps, [0, 0], movement
    )
    detour = torch.from_numpy(through - least[..., None]).float()
    return torch.cat([torch.stack(planes, dim=-1), detour], dim=-1).flatten(0, 1)


def encode(occupied: Tensor, goals: Tensor, movement: Movement) -> tuple[Tensor, Tensor]:
    """Return what the network sees, (B, 8, H, W), and the detour of each move, (B, moves, H, W).

    Args:
        occupied: (B, 1, H, W), 0 free and anything else occupied.
        goals: (B, 2), cells.
        movement: how one moves; it has 4 or 8 moves.
    """
    rows, columns = occupied.shape[2:]
    lines = _surroundings(rows, columns, movement).to(occupied.device)
    # a map with its goal at (i, j) is the window of the surroundings that begins at (rows - 1 - i,
    # columns - 1 - j)
    corner = torch.tensor([rows - 1, columns - 1]) - goals.cpu()  # (B, 2)
    row = (torch.arange(rows) + corner[:, :1])[:, :, None]  # (B, H, 1)
    column = (torch.arange(columns) + corner[:, 1:])[:, None]  # (B, 1, W)
    seen = F.embedding(
        (row * (2 * columns - 1) + column).to(occupied.device), lines
    )  # (B, H, W, 8 + moves)
    seen[..., 0] = occupied[:, 0] == 0
    seen = seen.permute(0, 3, 1, 2)  # channels last
    return seen[:, :8], seen[:, 8:]


def legal_moves(occupied: Tensor, movement: Movement) -> Tensor:
    """Return (B, moves, H, W) bool: the moves that ``movement`` allows from each cell; occupied is
    (B, 1, H, W).

    The rule of `mapdata.search.is_legal` once more, for all cells at once on the device.
    """
    rows, columns = occupied.shape[2:]
    free = F.pad(occupied[:, 0] == 0, (1, 1, 1, 1))

    def neighbour(row: int, column: int) -> Tensor:
        return free[:, 1 + row : 1 + row + rows, 1 + column : 1 + column + columns]

    legal = []
    for row, column in STEPS[: movement.connectivity].tolist():
        beside = row and column and not movement.corner_cutting
        sides = neighbour(row, 0) & neighbour(0, column) if beside else True
        legal.append(neighbour(row, column) & sides)
    return torch.stack(legal, dim=1)


# --- what is learnt, and how --------------------------------------------------------------------


class PathPredictor(pl.LightningModule):
    """Predicts optimal moves and the heuristic ratio of every cell, given map and goal.

    A batch has the ``FIELDS``; a list of batches, of several map sizes even, is one step.

    Args:
        connectivity: 4 or 8 moves.
        corner_cutting: whether diagonal moves pass beside occupied cells.
        diagonal_cost: of a diagonal move, sqrt(2) or 1.
        widths: channels at strides 2, 4 and 8.
        passes: exchanges between strides 4 and 8: how far information travels.
        learning_rate: the highest; it rises over 100 steps and falls as a cosine until the last
            step.
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
        """Return scores of the moves, (B, moves, H, W), and predicted heuristic ratios, (B, H, W)
        in [0, 1].

        Args:
            occupied: (B, 1, H, W), 0 free and anything else occupied; any H and W.
            goals: (B, 2), cells.
        """
        rows, columns = occupied.shape[2:]
        seen, detour = encode(padded(occupied), goals, self.movement)
        out = self.network(seen)[0][..., :rows, :columns].float()
        scores = torch.sub(out[:, :-1], detour[..., :rows, :columns], alpha=3)
        return scores, torch.sigmoid(out[:, -1])

    def training_step(self, batch: Sample | Sequence[Sample], batch_idx: int) -> Tensor:
        """Return the loss of one step."""
        values = self.losses(batch)
        self.log_dict({f"train_{name}": value for name, value in values.items()}, prog_bar=True)
        return values["loss"]

    def validation_step(
        self, batch: Sample | Sequence[Sample], batch_idx: int, dataloader_idx: int = 0
    ) -> None:
        """Log the losses."""
        values = {f"val_{name}": value for name, value in self.losses(batch).items()}
        self.log_dict(values, batch_size=1 if isinstance(batch, list) else len(batch[0]))

    def losses(self, batch: Sample | Sequence[Sample]) -> dict[str, Tensor]:
        """Return the loss, that of the moves alone, and the share of cells whose most probable move
        is optimal.
        """
        sums = [
            self._sums(each) for each in _by_size([batch] if isinstance(batch, Sample) else batch)
        ]
        loss, weight, error, right, cells = torch.stack(sums).sum(dim=0)
        moves = loss / weight
        return {
            "loss": moves + self.hparams["ratio_weight"] * error / cells,
            "moves": moves,
            "accuracy": right / cells,
        }

    def _sums(self, batch: dict[str, Tensor]) -> Tensor:
        """Return sums over the cells with an optimal move: loss, its weight, squared error, right
        answers, cells.
        """
        scores, ratios = self(batch["map"], batch["goal"])
        optimal = batch["optimal_moves"][:, 0]  # (B, H, W), bit sets
        cells = optimal.nonzero(as_tuple=True)  # n of them
        optimal, ratio = optimal[cells], batch["heuristic_ratio"][:, 0][cells]
        scores = scores.permute(0, 2, 3, 1)[cells]  # (n, moves)
        legal = legal_moves(batch["map"], self.movement).permute(0, 2, 3, 1)[cells]
        bits = 2 ** torch.arange(scores.shape[1], device=scores.device)
        good = (optimal[:, None] & bits) != 0
        scores = scores.masked_fill(~legal, -math.inf)
        loss = scores.logsumexp(1) - scores.masked_fill(~good, -math.inf).logsumexp(
            1
        )  # -log P(any optimal move)
        weight = 1 + self.hparams["detour_weight"] * (ratio < 0.98)
        error = (ratios[cells] - ratio) ** 2
        right = good.gather(1, scores.argmax(1, keepdim=True))
        count = torch.tensor(float(len(ratio)), device=scores.device)
        return torch.stack(
            [(loss * weight).sum(), weight.sum(), error.sum(), right.float().sum(), count]
        )

    def configure_optimizers(self) -> Any:
        """Return Muon with a rate that rises, then falls as a cosine."""
        optimizer = Muon(self.parameters(), self.hparams["learning_rate"])
        return scheduled(optimizer, float(self.trainer.estimated_stepping_batches))

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

    def predict(self, grids: Bytes, goals: Ints) -> tuple[Float32s, Float32s]:
        """Return log probabilities (B, moves, H, W), up to a constant a cell, and heuristic ratios
        (B, H, W).

        Args:
            grids: (B, H, W), 0 free and 1 occupied.
            goals: (B, 2), cells.
        """
        occupied = torch.from_numpy(np.array(grids, np.uint8))[:, None].to(self.device)
        with torch.inference_mode(), bfloat16(self.device):
            scores, ratios = self(occupied, torch.as_tensor(np.array(goals, np.int64)))
        return scores.cpu().contiguous().numpy(), ratios.cpu().numpy()

    def predict_path(self, map: npt.ArrayLike, start: npt.ArrayLike, goal: npt.ArrayLike) -> Ints:
        """Return the predicted path, (k, 2) cells from start to goal; (0, 2) where the moves do not
        lead there.

        Args:
            map: (H, W) or (1, H, W), 0 free and 1 occupied.
            start: its cell.
            goal: its cell.
        """
        grid = np.asarray(map, np.uint8).reshape(np.shape(map)[-2:])
        ends = np.array([start, goal], np.int64)
        plan = LearnedPlanner("walk", self, fallback=False).plan_batch(
            grid[None], ends[:1], ends[1:]
        )[0]
        return np.asarray(plan.path, np.int64)


class MixedBatches(pl.LightningDataModule):
    """Several data modules at once: a training step gets a list with a batch of each; validation
    sees them in turn.
    """

    def __init__(self, parts: list[MapDataModule]) -> None:
        """Keep the parts."""
        super().__init__()
        self.parts = parts

    def prepare_data(self) -> None:
        """Build what is missing."""
        for part in self.parts:
            part.prepare_data()

    def setup(self, stage: str | None = None) -> None:
        """Open the datasets."""
        for part in self.parts:
            part.trainer = self.trainer
            part.setup(stage)

    def train_dataloader(self) -> CombinedLoader:
        """Return what yields lists of batches, until the first part ends."""
        return CombinedLoader([part.train_dataloader() for part in self.parts], "min_size")

    def val_dataloader(self) -> list[DataLoader[Sample]]:
        """Return a loader a part."""
        return [part.val_dataloader() for part in self.parts]


def _by_size(batches: Sequence[Sample]) -> list[dict[str, Tensor]]:
    """Return the batches with those of one map size joined."""
    groups: dict[torch.Size, list[dict[str, Tensor]]] = {}
    for batch in batches:
        fields = dict(zip(batch._fields, batch, strict=True))
        groups.setdefault(fields["map"].shape[2:], []).append(fields)
    names = ("map", "goal", "optimal_moves", "heuristic_ratio")
    return [
        {name: torch.cat([each[name] for each in group]) for name in names}
        for group in groups.values()
    ]
