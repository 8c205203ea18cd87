"""What costs are learnt by: a curve over clearance, or a network over planes of the user's own."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from mapdata.arrays import Floats, Ints
from mapdata.costmaps.sites import MAX_CLEARANCE

KNOT = 0.05
"""Distance between the knots of a curve, in metres: about that between the cells of a robot's map.
Knots twice as far apart cost up to 2.5 % of regret, because costs change within them.
"""

MIN_KNOWN = 10
"""A knot counts as driven from so many cells on. The curve's minimum is at such a knot."""

MAX_RATIO = 10.0
"""The dearest clearance costs at most so many times as much as the cheapest one. NavFn can tell
apart a ratio of 5.
"""

ROUGHNESS = 0.008
"""Weight of the squared changes of slope in the loss. Without it, the curve would be ragged where
few drives say anything.
"""

MAX_LOG_COST = 1.5
"""A network's dearest cell costs at most exp(3) = 20 times as much as its cheapest one."""


class Curve(nn.Module):
    """The logarithm of the cost of a cell, linear between knots of clearance.

    Costs fall up to the clearance that the driver likes best, and rise from there on. The curve is
    held as its steps from each knot to the next one. So this is a condition on their signs, and
    where nothing was learnt the curve goes on as it is at the edge.

    Args:
        driven: (K,), the number of driven cells nearest to each of `knots`.
    """

    def __init__(self, driven: Ints) -> None:
        """Begin with equal costs."""
        super().__init__()
        known = np.flatnonzero(driven >= min(MIN_KNOWN, driven.max()))
        self.first, self.last = int(known[0]), int(known[-1])
        self.steps = nn.Parameter(torch.zeros(len(driven) - 1))

    def forward(self, planes: Tensor) -> Tensor:
        """Return the logarithms of costs, (...), at clearances in metres, (..., 1)."""
        logs = torch.cat([torch.zeros(1), self.steps.cumsum(0)])
        position = ((planes[..., 0] - KNOT / 2) / KNOT).clamp(0, len(logs) - 1)
        left = position.long().clamp(max=len(logs) - 2)
        share = position - left
        return logs[left] * (1 - share) + logs[left + 1] * share

    def penalty(self) -> Tensor:
        """Return how rough the curve is, for the loss."""
        return ROUGHNESS * self.steps.diff().square().sum()

    @torch.no_grad()
    def constrain(self) -> None:
        """Give the curve one minimum, and bound its range."""
        steps = self.steps.numpy()
        logs = np.insert(np.cumsum(with_one_minimum(steps, self.first, self.last)), 0, 0)
        logs = np.minimum(logs - logs.min(), np.log(MAX_RATIO))
        self.steps.copy_(torch.from_numpy(np.diff(logs)))


def knots() -> Floats:
    """Return the clearances of a curve's knots, (K,) metres."""
    return np.arange(KNOT / 2, MAX_CLEARANCE, KNOT)


def nearest_knot(metres: Floats) -> Ints:
    """Return the numbers of the knots that are nearest to clearances."""
    return np.minimum(metres / KNOT, len(knots()) - 1).astype(np.int64)


def with_one_minimum(steps: Floats, first: int, last: int) -> Floats:
    """Return the nearest steps (K - 1,) of a curve that falls, and then rises.

    The distance is the sum of squares.

    Args:
        steps: of any curve, from each of K knots to the next one.
        first: the first knot at which the minimum may be.
        last: the last one.
    """
    # What is lost if the minimum is at each knot: steps up before it, and steps down after it.
    up = np.insert(np.cumsum(np.maximum(steps, 0) ** 2), 0, 0)
    down = np.append(np.cumsum(np.minimum(steps, 0)[::-1] ** 2)[::-1], 0)
    lowest = first + int((up + down)[first : last + 1].argmin())
    return np.concatenate([np.minimum(steps[:lowest], 0), np.maximum(steps[lowest:], 0)])


class PlaneNetwork(nn.Module):
    """The logarithm of the cost of a cell, by a network that looks at its own planes alone.

    Args:
        driven: (N, P), the planes of all driven cells.
    """

    def __init__(self, driven: Floats) -> None:
        """Draw the weights. The planes are brought to the order of 1."""
        super().__init__()
        self.centre: Tensor
        self.scale: Tensor
        deviation = driven.std(axis=0)
        scale = np.where(deviation > 0, deviation, 1.0)
        self.register_buffer("centre", torch.tensor(driven.mean(axis=0), dtype=torch.float32))
        self.register_buffer("scale", torch.tensor(scale, dtype=torch.float32))
        width = 24
        first = nn.Linear(driven.shape[1], width)
        # The bends of the first layer are spread over the range of the planes.
        nn.init.normal_(first.weight, std=2.0)
        nn.init.uniform_(first.bias, -2.0, 2.0)
        self.layers = nn.Sequential(
            first, nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 1)
        )

    def forward(self, planes: Tensor) -> Tensor:
        """Return the logarithms of costs, (...), of cells with planes (..., P).

        They are bounded. Otherwise a single dear cell, which every path has to cross, could
        outweigh the rest of a path, and all paths would cost nearly the same.
        """
        output = self.layers((planes - self.centre) / self.scale)[..., 0]
        bounded: Tensor = MAX_LOG_COST * torch.tanh(output / MAX_LOG_COST)
        return bounded

    def penalty(self) -> Tensor:
        """Return 0."""
        return torch.zeros(())

    def constrain(self) -> None:
        """Do nothing."""


Costs = Curve | PlaneNetwork
"""A model of costs."""
