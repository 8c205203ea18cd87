"""The layers of the sample models: a network that gives every cell features from near and far."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from torch import Tensor, nn

STRIDE = 16
"""`Trunk` takes maps whose sides are multiples of this."""


class Residual(nn.Module):
    """x + two 3 x 3 convolutions. Without a norm, so that no statistic depends on the map size."""

    def __init__(self, width: int, dilation: int = 1) -> None:
        """Make both convolutions; the second sees ``dilation`` times as far."""
        super().__init__()
        self.first = nn.Conv2d(width, width, 3, padding=1)
        self.second = nn.Conv2d(width, width, 3, padding=dilation, dilation=dilation)
        nn.init.kaiming_normal_(self.first.weight, nonlinearity="relu")
        nn.init.zeros_(self.second.weight)  # the block begins as the identity, but for a bias

    def forward(self, x: Tensor) -> Tensor:
        """Return (B, width, H, W) for the same."""
        inner = F.relu(self.first(F.relu(x)))
        out: Tensor = x + self.second(inner)
        return out


class Pass(nn.Module):
    """One pass down to the coarsest resolution and back; a convolution there reaches further."""

    def __init__(self, widths: Sequence[int], dilation: int = 1) -> None:
        """Take the channels at each stride, the finest first."""
        super().__init__()
        width, *deeper = widths
        self.local = Residual(width, dilation)
        self.deeper: Pass | None = None
        if deeper:
            self.down = nn.Conv2d(width, deeper[0], 2, stride=2)
            self.deeper = Pass(deeper, dilation=2)
            self.up = nn.Conv2d(deeper[0], 4 * width, 1)

    def forward(self, states: list[Tensor]) -> list[Tensor]:
        """Return the states of all strides: (B, width, H, W), then (B, next width, H/2, W/2)."""
        fine, *coarser = states
        fine = self.local(fine)
        if self.deeper is None:
            return [fine]
        coarser[0] = self.down(F.relu(fine)) + coarser[0]
        coarser = self.deeper(coarser)
        back = self.up(F.relu(coarser[0]))  # (B, 4 width, H/2, W/2)
        return [fine + F.pixel_shuffle(back, 2), *coarser]


class Trunk(nn.Module):
    """Features of every cell from near and far, for maps of any size once they are `padded`."""

    def __init__(
        self, inputs: int, outputs: int, widths: Sequence[int], passes: int, refinements: int = 0
    ) -> None:
        """Make the layers.

        Args:
            inputs: channels in.
            outputs: channels out.
            widths: channels at strides 2, 4, 8 and 16; the last two may be left out.
            passes: how many `Pass`.
            refinements: how many `Residual` at stride 2 follow them.
        """
        super().__init__()
        shallow, width = widths[:2]
        self.coarser = len(widths) - 2
        # the first and the last convolution work on blocks of 2 x 2 cells: half the time
        self.stem = nn.Sequential(nn.Conv2d(4 * inputs, shallow, 3, padding=1), Residual(shallow))
        self.down = nn.Conv2d(shallow, width, 2, stride=2)
        self.passes = nn.ModuleList(Pass(widths[1:]) for _ in range(passes))
        self.end = Residual(width)
        self.up = nn.Conv2d(width, 4 * shallow, 1)
        self.join = nn.Conv2d(2 * shallow, shallow, 3, padding=1)
        self.refine = nn.Sequential(*(Residual(shallow) for _ in range(refinements)))
        self.head = nn.Conv2d(shallow, 4 * outputs, 1)
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, seen: Tensor) -> Tensor:
        """Return features (B, outputs, H, W).

        Args:
            seen: (B, inputs, H, W), H and W multiples of ``STRIDE``.
        """
        skip = F.relu(self.stem(F.pixel_unshuffle(seen, 2)))  # (B, shallow, H/2, W/2)
        # the coarser strides begin with nothing
        states = [self.down(skip)] + [seen.new_zeros(())] * self.coarser
        for each in self.passes:
            states = each(states)
        up = self.up(F.relu(self.end(states[0])))  # (B, 4 shallow, H/4, W/4)
        up = F.pixel_shuffle(F.relu(up), 2)  # (B, shallow, H/2, W/2)
        fine = self.refine(self.join(torch.cat([up, skip], dim=1)))  # (B, shallow, H/2, W/2)
        return F.pixel_shuffle(self.head(F.relu(fine)), 2)  # (B, outputs, H, W)


def padded(occupied: Tensor) -> Tensor:
    """Return maps (B, 1, H, W) walled in below and to the right, up to a multiple of `STRIDE`."""
    below = -occupied.shape[2] % STRIDE
    right = -occupied.shape[3] % STRIDE
    return F.pad(occupied, (0, right, 0, below), value=1)
