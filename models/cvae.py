"""Conditional variational autoencoders as samplers: LEGO's as published, and a local one.

Kumar, Mandalika, Choudhury, Srinivasa, "LEGO: Leveraging Experience in Roadmap Generation for
Sampling-Based Planning", IROS 2019.

- `CVAE`: as published. A latent of 2 numbers and a condition become a point; the condition is here
  a convolutional code of map, start and goal, of any map size, where the original has 10 x 10
  cells.
- `LocalCVAE`: the same with a condition that stays where it is: latent and code become a query that
  the features of the cells answer, so that its points lie in cells instead of between them.

Their targets, training and files are those of `models.lego_sampler.Sampler`.
"""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from torch import Tensor, nn

from mapdata.arrays import Bytes, Floats, Ints
from models.common import Trunk, padded
from models.lego_sampler import CHANNELS, Sampler, cell_numbers, encode
from models.roadmap import free_at, uniform

POINTS = 6
"""Points of each problem in a step of `LocalCVAE`."""

ROUNDS = 8
"""How often `CVAE` draws until its points are free."""


def hidden_layers(inputs: int, width: int, outputs: int, dropout: float) -> nn.Sequential:
    """Return the published encoder or decoder: two hidden layers with ReLU and dropout."""
    return nn.Sequential(
        nn.Linear(inputs, width),
        nn.ReLU(),
        nn.Dropout(dropout),
        nn.Linear(width, width),
        nn.ReLU(),
        nn.Dropout(dropout),
        nn.Linear(width, outputs),
    )


def draw_latent(code: Tensor) -> tuple[Tensor, Tensor]:
    """Return a draw (..., z) and the divergence (...) from the prior, of mean and log variance."""
    mean, log_variance = code.float().chunk(2, dim=-1)  # (..., z) both
    latent = mean + torch.randn_like(mean) * (log_variance / 2).exp()
    divergence = (log_variance.exp() + mean**2 - 1 - log_variance).sum(dim=-1) / 2
    return latent, divergence


class CVAE(Sampler):
    """LEGO's conditional variational autoencoder: a point from a latent and a condition.

    Published: two hidden layers of 512 with ReLU and dropout 0.5 on both sides, a latent of 2,
    squared error plus 2e-4 of the divergence, Adam with 1e-4 for up to 600,000 steps of 256 points;
    the learning rate here is higher, since the steps are far fewer.

    Args:
        targets: one of ``TARGETS``.
        latent: its numbers.
        width: of the hidden layers.
        code: numbers of the convolutional code of map, start and goal.
        dropout: share of hidden units left out.
        divergence_weight: of the divergence from the prior.
        learning_rate: the highest.
        experience: folder of banks.
    """

    def __init__(
        self,
        targets: str = "lego",
        latent: int = 2,
        width: int = 512,
        code: int = 128,
        dropout: float = 0.5,
        divergence_weight: float = 2e-4,
        learning_rate: float = 1e-3,
        experience: str = "runs/experience",
    ) -> None:
        """Make the networks."""
        super().__init__(targets, learning_rate, experience)
        self.save_hyperparameters()
        self.condition = nn.Sequential(
            nn.Conv2d(4 * CHANNELS, 32, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(32, 48, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.Conv2d(48, 64, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.AdaptiveAvgPool2d(8),
            nn.Conv2d(64, 32, 1),
            nn.Flatten(),
            nn.Linear(32 * 64, code),
            nn.ReLU(),
        )
        self.encoder = hidden_layers(2 + code + 4, width, 2 * latent, dropout)
        self.decoder = hidden_layers(latent + code + 4, width, 2, dropout)

    def forward(self, occupied: Tensor, starts: Tensor, goals: Tensor) -> Tensor:
        """Return the condition of each problem, (B, code + 4): its code and its ends in [0, 1]."""
        seen = F.pixel_unshuffle(encode(padded(occupied), starts, goals), 2)  # (B, 56, H/2, W/2)
        size = torch.tensor(occupied.shape[2:], device=starts.device)
        code = self.condition(seen).float()  # (B, code)
        return torch.cat([code, starts / size, goals / size], dim=1)

    def loss(self, batch: dict[str, Tensor], points: Tensor, owners: Tensor) -> dict[str, Tensor]:
        """Return the squared error and the divergence."""
        conditions = self(batch["map"], batch["start"], batch["goal"])[owners]  # (M, code + 4)
        unit = points / torch.tensor(batch["map"].shape[2:], device=points.device)  # (M, 2)
        latent, divergence = draw_latent(self.encoder(torch.cat([unit, conditions], dim=1)))
        decoded = self.decoder(torch.cat([latent, conditions], dim=1)).float()  # (M, 2)
        count = max(len(points), 1)
        error = ((decoded - unit) ** 2).mean(dim=1).sum() / count
        apart = divergence.sum() / count
        loss = error + self.hparams["divergence_weight"] * apart
        return {"loss": loss, "error": error, "divergence": apart}

    def draw(
        self, grids: Bytes, starts: Ints, goals: Ints, n: int, source: np.random.Generator
    ) -> Floats:
        """Return (B, n, 2): the first n points that are free; what lacks is uniform."""
        conditions = self(*self.tensors(grids[:, None], starts, goals))  # (B, code + 4)
        each = conditions[:, None].expand(-1, 2 * n, -1)
        found: list[list[Floats]] = [[] for _ in grids]
        for _ in range(ROUNDS):
            latents = source.standard_normal((len(grids), 2 * n, self.hparams["latent"]))
            (latent,) = self.tensors(latents.astype(np.float32))  # (B, 2 n, z)
            unit = self.decoder(torch.cat([latent, each], dim=2))  # (B, 2 n, 2)
            # numpy has no bfloat16
            points = unit.double().cpu().numpy() * grids.shape[1:]
            for grid, drawn, kept in zip(grids, points, found, strict=True):
                kept.append(drawn[free_at(grid, drawn)])
            if min(sum(map(len, kept)) for kept in found) >= n:
                break
        for grid, kept in zip(grids, found, strict=True):
            kept.append(uniform(grid, n, int(source.integers(2**31))))
        return np.stack([np.concatenate(kept)[:n] for kept in found])

    def optimizer(self) -> torch.optim.Optimizer:
        """Return Adam, as published."""
        return torch.optim.Adam(self.parameters(), self.learning_rate)


class LocalCVAE(Sampler):
    """A conditional variational autoencoder whose decoder asks the cells.

    Latent and code become a query, each cell has a key. A point becomes a cell by the cell that
    holds it, its likelihood is the softmax of query times keys over free cells, and it is drawn
    uniformly inside its cell.

    Args:
        targets: one of ``TARGETS``.
        latent: its numbers.
        keys: numbers a key.
        widths, passes: as of `Heatmap`.
        width: of the hidden layers.
        divergence_weight: of the divergence from the prior.
        learning_rate: the highest.
        experience: folder of banks.
    """

    def __init__(
        self,
        targets: str = "lego",
        latent: int = 4,
        keys: int = 16,
        widths: tuple[int, int, int] = (32, 48, 64),
        passes: int = 3,
        width: int = 128,
        divergence_weight: float = 0.1,
        learning_rate: float = 0.006,
        experience: str = "runs/experience",
    ) -> None:
        """Make the networks."""
        super().__init__(targets, learning_rate, experience)
        self.save_hyperparameters()
        self.trunk = Trunk(CHANNELS, keys, widths, passes)
        nn.init.normal_(self.trunk.head.weight, std=0.02)
        self.encoder = hidden_layers(2 + keys + widths[2], width, 2 * latent, 0.0)
        self.decoder = hidden_layers(latent + widths[2], width, keys, 0.0)

    def forward(self, occupied: Tensor, starts: Tensor, goals: Tensor) -> tuple[Tensor, Tensor]:
        """Return keys of the cells (B, H * W, keys) and a code of each problem (B, widths[2])."""
        rows, columns = occupied.shape[2:]
        keys, code = self.trunk(encode(padded(occupied), starts, goals))
        return keys[..., :rows, :columns].flatten(2).transpose(1, 2), code

    def loss(self, batch: dict[str, Tensor], points: Tensor, owners: Tensor) -> dict[str, Tensor]:
        """Return the cross entropy of the cells and the divergence.

        For ``POINTS`` random points of each of the S problems that have any.
        """
        counts = torch.bincount(owners, minlength=len(batch["map"]))  # (B,)
        first = counts.cumsum(0) - counts  # (B,) each problem's first point
        some = counts.nonzero()[:, 0]  # (S,)
        chosen = (torch.rand(len(some), POINTS, device=points.device) * counts[some, None]).long()
        points = points[first[some, None] + chosen]  # (S, POINTS, 2)
        occupied = batch["map"][some]
        keys, code = self(occupied, batch["start"][some], batch["goal"][some])
        cells = cell_numbers(points.flatten(0, 1), occupied)  # (S * POINTS,)
        places = cells.view(len(some), POINTS, 1).expand(-1, -1, keys.shape[2])
        near = keys.gather(1, places)  # (S, POINTS, keys)
        unit = points / torch.tensor(occupied.shape[2:], device=points.device)
        codes = code[:, None].expand(-1, POINTS, -1)
        latent, divergence = draw_latent(self.encoder(torch.cat([unit, near, codes], dim=2)))
        query = self.decoder(torch.cat([latent.to(code.dtype), codes], dim=2))
        scores = (query @ keys.transpose(1, 2)).float()  # (S, POINTS, H * W)
        scores = scores.masked_fill(occupied.flatten(2) != 0, -30)
        count = max(len(cells), 1)
        error = F.cross_entropy(scores.flatten(0, 1), cells, reduction="sum") / count
        apart = divergence.sum() / count
        loss = error + self.hparams["divergence_weight"] * apart
        return {"loss": loss, "error": error, "divergence": apart}

    def draw(
        self, grids: Bytes, starts: Ints, goals: Ints, n: int, source: np.random.Generator
    ) -> Floats:
        """Return points, each of a latent of its own."""
        occupied, *ends = self.tensors(grids[:, None], starts, goals)
        keys, code = self(occupied, *ends)
        (latents,) = self.tensors(
            source.standard_normal((len(grids), n, self.hparams["latent"])).astype(np.float32)
        )
        codes = code[:, None].expand(-1, n, -1)
        query = self.decoder(torch.cat([latents.to(code.dtype), codes], dim=2))  # (B, n, keys)
        scores = (query @ keys.transpose(1, 2)).double()  # (B, n, H * W)
        scores = scores.masked_fill(occupied.flatten(2) != 0, -torch.inf)
        log_likely = scores.cpu().numpy()
        cells = (log_likely + source.gumbel(size=log_likely.shape)).argmax(axis=2)  # (B, n)
        corners = np.stack(np.divmod(cells, grids.shape[2]), axis=2)  # (B, n, 2)
        return corners + source.random(corners.shape)
