"""The layers of the models: a network whose features of a cell depend on cells near and far.

`Trunk` works at several strides, as a U-Net does: a feature at stride 4 stands for 4 x 4 cells, so
that a convolution there sees four times as far as on the cells themselves.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from torch import Tensor, nn

from mapdata.checks import check_count, items_of

STRIDE = 16
"""The coarsest stride; `Trunk` takes maps whose sides are multiples of it."""


class Residual(nn.Module):
    """A residual block: its input plus the output of two 3 x 3 convolutions.

    It has no normalization, so that no statistic depends on the size of the map.
    """

    def __init__(self, width: int, dilation: int = 1) -> None:
        """Make both convolutions.

        Args:
            width: channels in and out.
            dilation: dilation of the second convolution.
        """
        super().__init__()
        self.first = nn.Conv2d(width, width, 3, padding=1)
        self.second = nn.Conv2d(width, width, 3, padding=dilation, dilation=dilation)
        nn.init.kaiming_normal_(self.first.weight, nonlinearity="relu")
        # With these weights the block is the identity plus a bias, from which deep networks train
        # well.
        nn.init.zeros_(self.second.weight)

    def forward(self, x: Tensor) -> Tensor:
        """Return features (B, width, H, W) for features of the same shape."""
        inner = F.relu(self.first(F.relu(x)))
        output: Tensor = x + self.second(inner)
        return output


class Pass(nn.Module):
    """One pass of information from the finest stride to the coarsest one and back."""

    def __init__(self, widths: Sequence[int], dilation: int = 1) -> None:
        """Make the layers of this stride and, recursively, of the coarser ones.

        Args:
            widths: channels at each stride, the finest first.
            dilation: dilation of the residual block at the finest stride.
        """
        super().__init__()
        width, *deeper = widths
        self.local = Residual(width, dilation)
        self.deeper: Pass | None = None
        if deeper:
            self.down = nn.Conv2d(width, deeper[0], 2, stride=2)
            self.deeper = Pass(deeper, dilation=2)
            self.up = nn.Conv2d(deeper[0], 4 * width, 1)

    def forward(self, states: list[Tensor]) -> list[Tensor]:
        """Return the features of all strides, for features of the same shapes.

        Args:
            states: features at each stride, the finest first: (B, width, H, W), then (B, next
                width, H/2, W/2) and so on.
        """
        fine, *coarser = states
        fine = self.local(fine)
        if self.deeper is None:
            return [fine]
        coarser[0] = self.down(F.relu(fine)) + coarser[0]
        coarser = self.deeper(coarser)
        up = self.up(F.relu(coarser[0]))  # (B, 4 width, H/2, W/2)
        return [fine + F.pixel_shuffle(up, 2), *coarser]


class Trunk(nn.Module):
    """A network from planes of a map to features of every cell, for maps of any `padded` size."""

    def __init__(
        self, inputs: int, outputs: int, widths: Sequence[int], passes: int, refinements: int = 0
    ) -> None:
        """Make the layers.

        Args:
            inputs: channels in.
            outputs: channels out.
            widths: channels at strides 2, 4, 8 and 16; the last two may be left out.
            passes: number of `Pass` modules.
            refinements: number of `Residual` blocks at stride 2 after them.

        Raises:
            ValueError: numbers that do not fit, by the names above.
        """
        super().__init__()
        if not 2 <= len(items_of(widths)) <= 4:
            raise ValueError(f"widths: got {widths!r}, expected 2 to 4 numbers of channels")
        for channels in widths:
            check_count("widths", channels)
        check_count("passes", passes, minimum=0)
        check_count("refinements", refinements, minimum=0)
        shallow, width = widths[:2]
        self.coarser = len(widths) - 2
        # The first and the last convolution work on blocks of 2 x 2 cells, which halves the time.
        self.stem = nn.Sequential(nn.Conv2d(4 * inputs, shallow, 3, padding=1), Residual(shallow))
        self.down = nn.Conv2d(shallow, width, 2, stride=2)
        self.passes = nn.ModuleList(Pass(widths[1:]) for _ in range(passes))
        self.end = Residual(width)
        self.up = nn.Conv2d(width, 4 * shallow, 1)
        self.join = nn.Conv2d(2 * shallow, shallow, 3, padding=1)
        self.refine = nn.Sequential(*(Residual(shallow) for _ in range(refinements)))
        self.head = nn.Conv2d(shallow, 4 * outputs, 1)
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, planes: Tensor) -> Tensor:
        """Return features (B, outputs, H, W).

        Args:
            planes: (B, inputs, H, W), H and W multiples of ``STRIDE``.
        """
        skip = F.relu(self.stem(F.pixel_unshuffle(planes, 2)))  # (B, shallow, H/2, W/2)
        # The features of the coarser strides are 0 before the first pass; () broadcasts.
        states = [self.down(skip)] + [planes.new_zeros(())] * self.coarser
        for exchange in self.passes:
            states = exchange(states)
        up = self.up(F.relu(self.end(states[0])))  # (B, 4 shallow, H/4, W/4)
        up = F.pixel_shuffle(F.relu(up), 2)  # (B, shallow, H/2, W/2)
        fine = self.refine(self.join(torch.cat([up, skip], dim=1)))  # (B, shallow, H/2, W/2)
        return F.pixel_shuffle(self.head(F.relu(fine)), 2)  # (B, outputs, H, W)


def padded(maps: Tensor, value: int = 1) -> Tensor:
    """Return maps (B, 1, H, W) with cells added below and to the right.

    Afterwards H and W are multiples of `STRIDE`.

    Args:
        maps: (B, 1, H, W).
        value: value of the added cells; they are to be occupied.
    """
    below = -maps.shape[2] % STRIDE
    right = -maps.shape[3] % STRIDE
    return F.pad(maps, (0, right, 0, below), value=value)
