"""Conditional variational autoencoders as samplers: LEGO's as published, and one whose condition
stays in its place.

Kumar, Mandalika, Choudhury, Srinivasa, "LEGO: Leveraging Experience in Roadmap Generation for
Sampling-Based Planning", IROS 2019.

- `CVAE`: as published. A latent of 2 numbers and a condition become a point; the condition is here
  a convolutional code of map, start and goal, of any map size, where the original has 10 x 10
  cells.
- `LocalCVAE`: the same with a condition that stays where it is: latent and code become a query that
  the features of the cells answer, so that its points lie in cells instead of between them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from torch import Tensor, nn

from mapdata.arrays import Bytes, Floats, Ints
from models.layers import Trunk, padded
from models.roadmap import free_at, uniform
from models.sampler import CHANNELS, Sampler, cell_numbers, encode, tensors

POINTS = 6
"""Points of each problem in a step of `LocalCVAE`."""


def _layers(inputs: int, width: int, outputs: int, dropout: float) -> nn.Sequential:
    """Return the published encoder or decoder: two hidden layers with ReLU and dropout."""
    hidden = [nn.Linear(inputs, width), nn.ReLU(), nn.Dropout(dropout)]
    hidden += [nn.Linear(width, width), nn.ReLU(), nn.Dropout(dropout)]
    return nn.Sequential(*hidden, nn.Linear(width, outputs))


def _latent(code: Tensor) -> tuple[Tensor, Tensor]:
    """Return a draw of the latent (..., z), and how far its distribution is from the prior,
    (...).
    """
    mean, log_variance = code.float().chunk(2, dim=-1)
    latent = mean + torch.randn_like(mean) * (log_variance / 2).exp()
    return latent, (log_variance.exp() + mean**2 - 1 - log_variance).sum(-1) / 2


def _until_free(
    draw: Callable[[int], Floats],
    grids: Bytes,
    n: int,
    source: np.random.Generator,
    rounds: int = 8,
) -> Floats:
    """Return (B, n, 2): the first n free ones of the points (B, k, 2) that ``draw(k)`` gives; what
    lacks is uniform.
    """
    found: list[list[Floats]] = [[] for _ in grids]
    for _ in range(rounds):
        for grid, points, kept in zip(grids, draw(2 * n), found, strict=True):
            kept.append(points[free_at(grid, points)])
        if min(sum(map(len, kept)) for kept in found) >= n:
            break
    more = [uniform(grid, n, int(source.integers(2**31))) for grid in grids]
    return np.stack(
        [np.concatenate([*kept, rest])[:n] for kept, rest in zip(found, more, strict=True)]
    )


class CVAE(Sampler):
    """LEGO's conditional variational autoencoder: a point of the unit square from a latent and a
    condition.

    Published: two hidden layers of 512 with ReLU and dropout 0.5 on both sides, a latent of 2,
    squared error plus 2e-4
    of the divergence, Adam with 1e-4 for up to 600,000 steps of 256 points; the learning rate here
    is higher, since the steps are far fewer.

    Args:
        targets: "lego" or "shortest_path".
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
        self.encoder = _layers(2 + code + 4, width, 2 * latent, dropout)
        self.decoder = _layers(latent + code + 4, width, 2, dropout)

    def forward(self, occupied: Tensor, starts: Tensor, goals: Tensor) -> Tensor:
        """Return the condition of each problem, (B, code + 4)."""
        seen = F.pixel_unshuffle(encode(padded(occupied), starts, goals), 2)
        ends = torch.cat([starts, goals], dim=1) / torch.tensor(occupied.shape[2:]).repeat(2).to(
            starts.device
        )
        return torch.cat([self.condition(seen).float(), ends], dim=1)

    def loss(self, batch: dict[str, Tensor], points: Tensor, owners: Tensor) -> dict[str, Tensor]:
        """Return the squared error and the divergence."""
        condition = self(batch["map"], batch["start"], batch["goal"])[owners]
        unit = points / torch.tensor(batch["map"].shape[2:], device=points.device)
        latent, divergence = _latent(self.encoder(torch.cat([unit, condition], dim=1)))
        error = ((self.decoder(torch.cat([latent, condition], dim=1)).float() - unit) ** 2).mean(
            dim=1
        )
        error, apart = (each.sum() / max(len(points), 1) for each in (error, divergence))
        return {
            "loss": error + self.hparams["divergence_weight"] * apart,
            "error": error,
            "divergence": apart,
        }

    def draw(
        self, grids: Bytes, starts: Ints, goals: Ints, n: int, source: np.random.Generator
    ) -> Floats:
        """Return points that lie in free cells, of as many as it takes."""
        condition = self(*tensors(self, grids, starts, goals))

        def points(count: int) -> Floats:
            latents = source.standard_normal((len(grids), count, self.hparams["latent"])).astype(
                np.float32
            )
            each = condition[:, None].expand(-1, count, -1)
            unit = self.decoder(
                torch.cat([torch.as_tensor(latents, device=each.device), each], dim=2)
            )
            found: Floats = unit.double().cpu().numpy() * grids.shape[1:]
            return found

        return _until_free(points, grids, n, source)

    def optimizer(self) -> torch.optim.Optimizer:
        """Return Adam, as published."""
        return torch.optim.Adam(self.parameters(), self.learning_rate)


class LocalCVAE(Sampler):
    """A conditional variational autoencoder whose decoder asks the cells: a query of latent and
    code, a key a cell.

    A point becomes a cell by the cell that holds it, its likelihood is the softmax of query times
    keys over free cells, and it is drawn uniformly inside its cell.

    Args:
        targets: "lego" or "shortest_path".
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
        self.encoder = _layers(2 + keys + widths[2], width, 2 * latent, 0.0)
        self.decoder = _layers(latent + widths[2], width, keys, 0.0)

    def forward(self, occupied: Tensor, starts: Tensor, goals: Tensor) -> tuple[Tensor, Tensor]:
        """Return keys of the cells, (B, H * W, keys), and a code of each problem."""
        rows, columns = occupied.shape[2:]
        keys, code = self.trunk(encode(padded(occupied), starts, goals))
        return keys[..., :rows, :columns].flatten(2).transpose(1, 2), code

    def loss(self, batch: dict[str, Tensor], points: Tensor, owners: Tensor) -> dict[str, Tensor]:
        """Return the cross entropy of the cells and the divergence, for some points of each problem
        that has any.
        """
        counts = torch.bincount(owners, minlength=len(batch["map"]))
        some = (counts > 0).nonzero()[:, 0]  # S problems
        chosen = torch.rand(len(some), POINTS, device=points.device) * counts[some, None]
        points = points[(counts.cumsum(0) - counts)[some, None] + chosen.long()]  # (S, POINTS, 2)
        keys, code = self(*(batch[name][some] for name in ("map", "start", "goal")))
        occupied = batch["map"][some]
        cells = cell_numbers(points.flatten(0, 1), occupied).view(len(some), POINTS)
        near = keys.gather(1, cells[..., None].expand(-1, -1, keys.shape[2]))
        unit = points / torch.tensor(occupied.shape[2:], device=points.device)
        codes = code[:, None].expand(-1, POINTS, -1)
        latent, divergence = _latent(self.encoder(torch.cat([unit, near, codes], dim=2)))
        query = self.decoder(torch.cat([latent.to(code.dtype), codes], dim=2))
        scores = (query @ keys.transpose(1, 2)).float()  # (S, POINTS, H * W)
        scores = scores.masked_fill(occupied.flatten(2) != 0, -30)
        error, apart = (
            F.cross_entropy(scores.flatten(0, 1), cells.flatten(), reduction="sum"),
            divergence.sum(),
        )
        count = max(cells.numel(), 1)
        error, apart = error / count, apart / count
        return {
            "loss": error + self.hparams["divergence_weight"] * apart,
            "error": error,
            "divergence": apart,
        }

    def draw(
        self, grids: Bytes, starts: Ints, goals: Ints, n: int, source: np.random.Generator
    ) -> Floats:
        """Return points, each of a latent of its own."""
        occupied, *ends = tensors(self, grids, starts, goals)
        keys, code = self(occupied, *ends)
        latents = torch.as_tensor(
            source.standard_normal((len(grids), n, self.hparams["latent"])), device=code.device
        )
        query = self.decoder(
            torch.cat([latents.to(code.dtype), code[:, None].expand(-1, n, -1)], dim=2)
        )
        scores = torch.einsum("bnk,bck->bnc", query, keys).double()
        likely = scores.masked_fill(occupied.flatten(1)[:, None] != 0, -torch.inf).cpu().numpy()
        cells = (likely + source.gumbel(size=likely.shape)).argmax(axis=2)
        return np.stack(np.divmod(cells, grids.shape[2]), axis=2) + source.random(
            (len(grids), n, 2)
        )
