"""A conditional variational autoencoder as a sampler: LEGO's, as published.

Kumar, Mandalika, Choudhury, Srinivasa, "LEGO: Leveraging Experience in Roadmap Generation for
Sampling-Based Planning", IROS 2019.

A latent of 2 numbers and a condition become a point. The condition is here a convolutional code of
map, start and goal, of any map size, where the original has the 10 x 10 cells of a coarse map.

Targets, training and files are those of `models.lego.sampler.Sampler`.
"""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from numpy.random import Generator
from torch import Tensor, nn

from mapdata.arrays import Bytes, Floats, Ints
from models.layers import padded
from models.lego.roadmap import free_at, uniform
from models.lego.sampler import Sampler, encode
from models.model import Tensors

ROUNDS = 8
"""How often `CVAE` draws until its points are free."""


DIVERGENCE_WEIGHT = 4e-4
"""Of the divergence from the prior, in the loss."""


def hidden_layers(inputs: int, width: int, outputs: int) -> nn.Sequential:
    """Return the published encoder or decoder: two hidden layers with ReLU."""
    return nn.Sequential(
        nn.Linear(inputs, width),
        nn.ReLU(),
        nn.Linear(width, width),
        nn.ReLU(),
        nn.Linear(width, outputs),
    )


def to_unit(points: Tensor, occupied: Tensor) -> Tensor:
    """Return points or cells (..., 2) of maps (B, 1, H, W) as parts of the map's sides."""
    return points / torch.tensor(occupied.shape[2:], device=points.device)


def draw_latent(code: Tensor) -> tuple[Tensor, Tensor]:
    """Return a draw (..., z) and the divergence (...) from the prior, of mean and log variance."""
    mean, log_variance = code.float().chunk(2, dim=-1)  # (..., z) both
    noise = torch.randn_like(mean)
    latent = mean + noise * (log_variance / 2).exp()
    terms = log_variance.exp() + mean**2 - 1 - log_variance
    return latent, terms.sum(dim=-1) / 2


class CVAE(Sampler):
    """LEGO's conditional variational autoencoder: a point from a latent and a condition.

    Published, by Model-LEGO.ipynb of https://github.com/personalrobotics/lego: two hidden layers of
    512 with ReLU on both sides, with a dropout of 0.5 that is never switched on; a latent of 2;
    squared error plus 2e-4 of exp(v) + m^2 - 1 - v, summed over latents of mean m and log variance
    v, which is twice the divergence, so that it has weight 4e-4 here; Adam with 1e-4 for 600,000
    steps of 256 points. The learning rate here is higher, since the steps are far fewer.

    Args:
        targets: one of ``TARGETS``.
        latent: its numbers.
        width: of the hidden layers.
        code: numbers of the convolutional code of map, start and goal.
        learning_rate: the highest.
    """

    optimizer_class = torch.optim.Adam  # as published

    def __init__(
        self,
        targets: str = "lego",
        latent: int = 2,
        width: int = 512,
        code: int = 128,
        learning_rate: float = 1e-3,
    ) -> None:
        """Make the networks."""
        super().__init__(targets)
        self.save_hyperparameters()
        layers = []
        for inputs, outputs, stride in ((4 * 14, 32, 1), (32, 48, 2), (48, 64, 2)):
            layers += [nn.Conv2d(inputs, outputs, 3, stride, padding=1), nn.ReLU()]
        layers += [nn.AdaptiveAvgPool2d(8), nn.Conv2d(64, 32, 1), nn.Flatten()]  # any map size
        layers += [nn.Linear(32 * 8 * 8, code), nn.ReLU()]
        self.condition = nn.Sequential(*layers)
        self.encoder = hidden_layers(2 + code + 4, width, 2 * latent)
        self.decoder = hidden_layers(latent + code + 4, width, 2)

    def forward(self, occupied: Tensor, starts: Tensor, goals: Tensor) -> Tensor:
        """Return the condition of each problem, (B, code + 4): its code and its ends in [0, 1]."""
        seen = encode(padded(occupied), starts, goals)
        code = self.condition(F.pixel_unshuffle(seen, 2)).float()  # (B, code)
        ends = to_unit(torch.stack([starts, goals], dim=1), occupied)  # (B, 2, 2)
        return torch.cat([code, ends.flatten(1)], dim=1)

    def loss(self, batch: Tensors, points: Tensor, owners: Tensor) -> Tensors:
        """Return the squared error and the divergence."""
        conditions = self(batch["map"], batch["start"], batch["goal"])[owners]  # (M, code + 4)
        unit = to_unit(points, batch["map"])  # (M, 2)
        code = self.encoder(torch.cat([unit, conditions], dim=1))  # (M, 2 z)
        latent, divergences = draw_latent(code)  # (M, z) and (M,)
        decoded = self.decoder(torch.cat([latent, conditions], dim=1))  # (M, 2)
        count = max(len(points), 1)  # a batch may have no point: no NaN
        error = ((decoded.float() - unit) ** 2).mean(dim=1).sum() / count
        divergence = divergences.sum() / count
        loss = error + DIVERGENCE_WEIGHT * divergence
        return {"loss": loss, "error": error, "divergence": divergence}

    def draw(self, grids: Bytes, starts: Ints, goals: Ints, n: int, source: Generator) -> Floats:
        """Return (B, n, 2): the first n points that are free; what lacks is uniform."""
        conditions = self(*self.tensors(grids[:, None], starts, goals))  # (B, code + 4)
        each = conditions[:, None].expand(-1, 2 * n, -1)  # (B, 2 n, code + 4)
        found = [np.empty((0, 2)) for _ in grids]
        for _ in range(ROUNDS):
            draws = source.standard_normal((len(grids), 2 * n, self.hparams["latent"]))
            (latents,) = self.tensors(draws.astype(np.float32))  # from the prior
            unit = self.decoder(torch.cat([latents, each], dim=2))  # (B, 2 n, 2)
            points = unit.double().cpu().numpy() * grids.shape[1:]  # numpy has no bfloat16
            for b, grid in enumerate(grids):
                free = points[b][free_at(grid, points[b])]
                found[b] = np.concatenate([found[b], free])
            if min(map(len, found)) >= n:
                break
        for b, grid in enumerate(grids):
            spare = uniform(grid, n, int(source.integers(2**31)))
            found[b] = np.concatenate([found[b], spare])[:n]
        return np.stack(found)
