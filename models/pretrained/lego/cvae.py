"""A conditional variational autoencoder as a sampler: LEGO's, as published.

Kumar, Mandalika, Choudhury, Srinivasa, "LEGO: Leveraging Experience in Roadmap Generation for
Sampling-Based Planning", IROS 2019.

The decoder makes a point of a latent, two numbers, and a condition. In the original the condition
holds the 10 x 10 cells of a coarse map. Here it is a convolutional code of map, start and goal, so
that maps may have any size.

Targets, training and files are those of `mapdata.models.pretrained.lego.sampler.Sampler`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from numpy.random import Generator
from torch import Tensor, nn

from mapdata.arrays import Bytes, Floats, Ints
from mapdata.checks import check_count
from mapdata.roadmaps import free_at, uniform

from ..layers import padded
from ..model import Tensors
from .sampler import Sampler, encode

MAX_ROUNDS = 8
"""How often `CVAE` draws points before uniform ones take the place of those that are not free."""

DIVERGENCE_WEIGHT = 4e-4
"""Weight of the divergence from the prior, in the loss."""


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
    """Return points or cells (..., 2) of maps (B, 1, H, W) as fractions of the map's sides."""
    return points / torch.tensor(occupied.shape[2:], device=points.device)


def draw_latent(code: Tensor) -> tuple[Tensor, Tensor]:
    """Return a draw (..., z) and its divergence (...) from the prior, a standard normal.

    The divergence is that of Kullback and Leibler, the sum over z of (exp(v) + m^2 - 1 - v) / 2 for
    a mean m and a log variance v.

    Args:
        code: (..., 2 z), means, then log variances.
    """
    mean, log_variance = code.float().chunk(2, dim=-1)  # (..., z) both
    noise = torch.randn_like(mean)
    latent = mean + noise * (log_variance / 2).exp()
    terms = log_variance.exp() + mean**2 - 1 - log_variance
    return latent, terms.sum(dim=-1) / 2


class CVAE(Sampler):
    """LEGO's conditional variational autoencoder: a point from a latent and a condition.

    What was published, in Model-LEGO.ipynb of https://github.com/personalrobotics/lego:

    - two hidden layers of 512 with ReLU in encoder and decoder; a dropout of 0.5 stands in the code
      but is never switched on
    - a latent of 2 numbers
    - a loss of the squared error plus 2e-4 times the sum over the latent of exp(v) + m^2 - 1 - v,
      for means m and log variances v; this is twice the divergence, so its weight is 4e-4 here
    - Adam with a learning rate of 1e-4 for 600,000 steps of 256 points; the rate is higher here
      because there are far fewer steps

    Args:
        targets: one of ``mapdata.models.pretrained.lego.sampler.TARGETS``.
        latent: number of elements of the latent.
        width: channels of the hidden layers.
        code: number of elements of the convolutional code of map, start and goal.
        learning_rate: the highest of the schedule.
    """

    optimizer_class = torch.optim.Adam  # the published optimizer

    PRETRAINED: ClassVar[Mapping[str, str]] = {"lego": "lego_cvae.safetensors"}

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
        self._check_learning_rate()
        for name, count in (("latent", latent), ("width", width), ("code", code)):
            check_count(name, count)
        layers = []
        for inputs, outputs, stride in ((4 * 14, 32, 1), (32, 48, 2), (48, 64, 2)):
            layers += [nn.Conv2d(inputs, outputs, 3, stride, padding=1), nn.ReLU()]
        # The pool makes 8 x 8 cells of a map of any size.
        layers += [nn.AdaptiveAvgPool2d(8), nn.Conv2d(64, 32, 1), nn.Flatten()]
        layers += [nn.Linear(32 * 8 * 8, code), nn.ReLU()]
        self.condition = nn.Sequential(*layers)
        self.encoder = hidden_layers(2 + code + 4, width, 2 * latent)
        self.decoder = hidden_layers(latent + code + 4, width, 2)

    def forward(self, occupied: Tensor, starts: Tensor, goals: Tensor) -> Tensor:
        """Return the condition of each problem, (B, code + 4): its code and its ends in [0, 1].

        Args:
            occupied: (B, 1, H, W), 0 free and anything else occupied; any H and W.
            starts: (B, 2), cells.
            goals: (B, 2), cells.
        """
        planes = encode(padded(occupied), starts, goals)  # (B, 14, H, W), up to 15 cells more
        code = self.condition(F.pixel_unshuffle(planes, 2)).float()  # (B, code)
        ends = to_unit(torch.stack([starts, goals], dim=1), occupied)  # (B, 2, 2)
        return torch.cat([code, ends.flatten(1)], dim=1)

    def loss(self, batch: Tensors, points: Tensor, owners: Tensor) -> Tensors:
        """Return the loss, and its parts, the squared error and the divergence.

        Arguments are those of `Sampler.loss`.
        """
        conditions = self(batch["map"], batch["start"], batch["goal"])[owners]  # (M, code + 4)
        unit = to_unit(points, batch["map"])  # (M, 2)
        code = self.encoder(torch.cat([unit, conditions], dim=1))  # (M, 2 z)
        latent, divergences = draw_latent(code)  # (M, z) and (M,)
        decoded = self.decoder(torch.cat([latent, conditions], dim=1))  # (M, 2)
        count = max(len(points), 1)  # in a batch without targets the loss is 0 and not NaN
        error = ((decoded.float() - unit) ** 2).mean(dim=1).sum() / count
        divergence = divergences.sum() / count
        loss = error + DIVERGENCE_WEIGHT * divergence
        return {"loss": loss, "error": error, "divergence": divergence}

    def draw(self, grids: Bytes, starts: Ints, goals: Ints, n: int, rng: Generator) -> Floats:
        """Return (B, n, 2): the first n points that are free; uniform points where there are fewer.

        In each round every problem gets 2 n points, until all problems have n free ones.
        """
        conditions = self(*self.tensors(grids[:, None], starts, goals))  # (B, code + 4)
        conditions = conditions[:, None].expand(-1, 2 * n, -1)  # (B, 2 n, code + 4)
        samples = [np.empty((0, 2)) for _ in grids]
        for _ in range(MAX_ROUNDS):
            prior = rng.standard_normal((len(grids), 2 * n, self.hparams["latent"]))
            (latents,) = self.tensors(prior.astype(np.float32))  # (B, 2 n, z)
            unit = self.decoder(torch.cat([latents, conditions], dim=2))  # (B, 2 n, 2)
            # numpy has no bfloat16, which the decoder may have given.
            points = unit.double().cpu().numpy() * grids.shape[1:]  # (B, 2 n, 2)
            for b, grid in enumerate(grids):
                is_free = free_at(grid, points[b])
                samples[b] = np.concatenate([samples[b], points[b][is_free]])
            if min(map(len, samples)) >= n:
                break
        for b, grid in enumerate(grids):
            uniform_points = uniform(grid, n, int(rng.integers(2**31)))
            samples[b] = np.concatenate([samples[b], uniform_points])[:n]
        return np.stack(samples)
