"""A sampler that learns where a roadmap needs its vertices: a heat map over cells, taught by LEGO's
bottlenecks.

Kumar, Mandalika, Choudhury, Srinivasa, "LEGO: Leveraging Experience in Roadmap Generation for
Sampling-Based Planning", IROS 2019. `models/cvae.py` has the published sampler. All have `sample`,
and learn from the batches of a data module and a bank of experience:

    from models.lego_sampler import load
    from models.roadmap import between, halton

    sampler = load("models/weights/lego_heatmap.pt")
    points = sampler.sample(grid, start, goal, 25)  # (25, 2) points in free cells
    roadmap = between(grid, start, goal, np.concatenate([halton(grid, 25), points]))

The command that made each of the weights that ship is in scripts/train_lego_sampler.py.
"""

from __future__ import annotations

import math
from os import PathLike

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from torch import Tensor, nn

from mapdata.arrays import Bytes, Floats, Ints
from mapdata.jit import kernel
from models.cvae import CVAE, LocalCVAE
from models.layers import Trunk, bfloat16, padded
from models.sampler import (
    CHANNELS,
    Sampler,
    cell_numbers,
    encode,
    restore_plane,
    tensors,
    transform_plane,
    transform_points,
)
from models.saved import load_model

VIEWS = (0, 3, 4, 7, 1, 2, 5, 6)
"""Symmetries of a map in the order in which a heat map adds them, as `transform_plane` numbers
them.
"""


def load(file: str | PathLike[str]) -> Sampler:
    """Return the sampler that `Sampler.save` wrote, ready to sample; nothing in the file is run.

    Raises:
        FileNotFoundError: no such file.
        ValueError: it holds no sampler.
    """
    return load_model(file, Heatmap, CVAE, LocalCVAE)


class Heatmap(Sampler):
    """Predicts each cell's share of the targets, and as a help which cells lie on shortest paths.

    Args:
        targets: "lego" or "shortest_path".
        widths: channels at strides 2, 4 and 8.
        passes: exchanges between strides 4 and 8.
        learning_rate: the highest.
        help_weight: weight of the second prediction's loss.
        temperature: 1 draws cells by their shares; 0 takes always the likeliest, which solves more
            problems.
        spacing: cells around a sample within which further ones are less likely.
        views: 1 to 8 symmetries of the map, whose mean the shares are; each costs as much as the
            first.
        experience: folder of banks.
    """

    def __init__(
        self,
        targets: str = "lego",
        widths: tuple[int, int, int] = (32, 48, 64),
        passes: int = 3,
        learning_rate: float = 0.003,
        help_weight: float = 4.0,
        temperature: float = 0.0,
        spacing: float = 1.25,
        views: int = 4,
        experience: str = "runs/experience",
    ) -> None:
        """Make the network."""
        super().__init__(targets, learning_rate, experience)
        self.save_hyperparameters()
        self.trunk = Trunk(CHANNELS, 2, widths, passes)
        nn.init.normal_(self.trunk.head.weight, std=0.02)

    def forward(self, occupied: Tensor, starts: Tensor, goals: Tensor) -> Tensor:
        """Return (B, 2, H, W) scores: their softmax over free cells is the shares; and of lying on
        a path.
        """
        rows, columns = occupied.shape[2:]
        scores: Tensor = self.trunk(encode(padded(occupied), starts, goals))[0][
            ..., :rows, :columns
        ]
        return scores.float()

    def loss(self, batch: dict[str, Tensor], points: Tensor, owners: Tensor) -> dict[str, Tensor]:
        """Return the cross entropy of the shares, over problems with a target, and of the second
        prediction.
        """
        scores = self(batch["map"], batch["start"], batch["goal"])
        occupied = batch["map"].flatten(1) != 0
        heat_map = scores[:, 0].flatten(1).masked_fill(occupied, -30).log_softmax(1)  # (B, H * W)
        each = -heat_map[owners, cell_numbers(points, batch["map"])]  # (M,)
        counts = torch.bincount(owners, minlength=len(heat_map)).clamp(min=1)
        heat = (
            (each / counts[owners]).sum() / (torch.bincount(owners) > 0).sum()
            if len(owners)
            else each.sum()
        )
        path = F.binary_cross_entropy_with_logits(
            scores[:, 1].flatten(1)[~occupied], batch["optimal_mask"].flatten(1)[~occupied].float()
        )
        return {"loss": heat + self.hparams["help_weight"] * path, "heat": heat, "path": path}

    def heat_map(self, grids: Bytes, starts: Ints, goals: Ints) -> Floats:
        """Return (B, H, W) shares of the cells, 0 in occupied ones."""
        occupied, *ends = tensors(self, grids, starts, goals)
        size, total = (
            torch.tensor(occupied.shape[2:], device=occupied.device),
            torch.zeros(grids.shape),
        )
        with torch.inference_mode(), bfloat16(self.device):
            for k, code in enumerate(VIEWS[: self.hparams["views"]]):
                cells = [
                    transform_points(each + 0.5, code, size).floor().long()
                    for each in ends[:: 1 - 2 * (k % 2)]
                ]
                transformed = transform_plane(occupied, code)
                scores = self(transformed, *cells)[:, 0].masked_fill(
                    transformed[:, 0] != 0, -torch.inf
                )
                heat_map = scores.flatten(1).double().softmax(1).view(scores.shape)
                total = total + restore_plane(heat_map, code).cpu()
        found: Floats = (total / self.hparams["views"]).contiguous().numpy()
        return found

    def draw(
        self, grids: Bytes, starts: Ints, goals: Ints, n: int, source: np.random.Generator
    ) -> Floats:
        """Return points in cells drawn without replacement, each uniform inside its cell."""
        heat_map = self.heat_map(grids, starts, goals)
        noise = self.hparams["temperature"] * source.gumbel(size=heat_map.shape)
        cells = select(heat_map, noise, n, self.hparams["spacing"])
        return cells + source.random(cells.shape)


@kernel
def select(heat_map: Floats, noise: Floats, n: int, spacing: float) -> Floats:
    """Return (B, n, 2) cells: always the one with the highest log share + noise, (B, H, W) each.

    A chosen cell makes its neighbours less likely, by exp(-(distance / spacing)^2 / 2), and is
    itself not taken again before all others are.
    """
    count, rows, columns = heat_map.shape
    chosen = np.empty((count, n, 2))
    reach = int(3 * spacing)
    for b in range(count):
        scores, taken = np.full((rows, columns), -np.inf), np.zeros((rows, columns), np.int64)
        for i in range(rows):
            for j in range(columns):
                if heat_map[b, i, j] > 0:
                    scores[i, j] = math.log(heat_map[b, i, j]) + noise[b, i, j]
        for k in range(n):
            row, column, most = 0, 0, 1 << 60
            for i in range(rows):
                for j in range(columns):
                    if scores[i, j] > -np.inf and (
                        taken[i, j] < most
                        or (taken[i, j] == most and scores[i, j] > scores[row, column])
                    ):
                        row, column, most = i, j, taken[i, j]
            chosen[b, k, 0], chosen[b, k, 1] = row, column
            taken[row, column] += 1
            for i in range(max(row - reach, 0), min(row + reach + 1, rows)):
                for j in range(max(column - reach, 0), min(column + reach + 1, columns)):
                    away = ((i - row) ** 2 + (j - column) ** 2) / (spacing * spacing)
                    if 0 < away < 9:
                        scores[i, j] += math.log(1 - math.exp(-away / 2))
    return chosen
