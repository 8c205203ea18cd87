"""What the sample models share: their layers, their optimizer and its rate, and fast predictions on
a processor.
"""

from __future__ import annotations

import contextlib
import math
from typing import Any

import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from torch import Tensor, nn


class Residual(nn.Module):
    """x + two 3 x 3 convolutions, the second of which begins at zero; no norm, so that all map
    sizes are alike.
    """

    def __init__(self, width: int, dilation: int = 1) -> None:
        """Make both convolutions; the second sees ``dilation`` times as far."""
        super().__init__()
        self.first = nn.Conv2d(width, width, 3, padding=1)
        self.second = nn.Conv2d(width, width, 3, padding=dilation, dilation=dilation)
        nn.init.kaiming_normal_(self.first.weight, nonlinearity="relu")
        nn.init.zeros_(self.second.weight)

    def forward(self, x: Tensor) -> Tensor:
        """Return (B, width, H, W) for the same."""
        out: Tensor = x + self.second(F.relu(self.first(F.relu(x))))
        return out


class Pass(nn.Module):
    """One exchange between two resolutions: near at stride 4, and far at stride 8."""

    def __init__(self, width: int, deep: int) -> None:
        """Take ``width`` channels at stride 4 and ``deep`` ones at stride 8."""
        super().__init__()
        self.local = Residual(width)
        self.down = nn.Conv2d(width, deep, 2, stride=2)
        self.far = Residual(deep, dilation=2)
        self.up = nn.Conv2d(deep, 4 * width, 1)

    def forward(self, fine: Tensor, coarse: Tensor | None) -> tuple[Tensor, Tensor]:
        """Return both states: (B, width, H/4, W/4) and (B, deep, H/8, W/8)."""
        fine = self.local(fine)
        below = self.down(F.relu(fine))
        coarse = self.far(below if coarse is None else below + coarse)
        return fine + F.pixel_shuffle(self.up(F.relu(coarse)), 2), coarse


STRIDE = 8
"""`Trunk` takes maps whose sides are multiples of this."""


def padded(occupied: Tensor) -> Tensor:
    """Return maps (B, 1, H, W), 0 free, with occupied cells below and to the right, up to the next
    multiple of 8.
    """
    return F.pad(
        occupied, (0, -occupied.shape[3] % STRIDE, 0, -occupied.shape[2] % STRIDE), value=1
    )


class Trunk(nn.Module):
    """Features of every cell, from near and far; it knows no map size.

    Its first and last convolutions are at half the resolution, which takes half the time.
    """

    def __init__(
        self, inputs: int, outputs: int, widths: tuple[int, int, int], passes: int
    ) -> None:
        """Take the channels of a cell before and after, the widths at strides 2, 4 and 8, and how
        far it looks.
        """
        super().__init__()
        shallow, width, deep = widths
        self.stem = nn.Sequential(nn.Conv2d(4 * inputs, shallow, 3, padding=1), Residual(shallow))
        self.down = nn.Conv2d(shallow, width, 2, stride=2)
        self.passes = nn.ModuleList(Pass(width, deep) for _ in range(passes))
        self.end = Residual(width)
        self.up = nn.Conv2d(width, 4 * shallow, 1)
        self.join = nn.Conv2d(2 * shallow, shallow, 3, padding=1)
        self.head = nn.Conv2d(shallow, 4 * outputs, 1)
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Return (B, outputs, H, W) and a code (B, deep) for (B, inputs, H, W), H and W multiples
        of ``STRIDE``.
        """
        skip = F.relu(self.stem(F.pixel_unshuffle(seen, 2)))  # (B, shallow, H/2, W/2)
        fine: Tensor = self.down(skip)  # (B, width, H/4, W/4)
        coarse: Tensor | None = None
        for each in self.passes:
            fine, coarse = each(fine, coarse)  # coarse: (B, deep, H/8, W/8)
        up = F.pixel_shuffle(F.relu(self.up(F.relu(self.end(fine)))), 2)  # (B, shallow, H/2, W/2)
        joined = F.relu(self.join(torch.cat([up, skip], dim=1)))
        code = fine.new_zeros(len(fine), 0) if coarse is None else coarse.amax(dim=(2, 3))
        return F.pixel_shuffle(self.head(joined), 2), code


def bfloat16(device: torch.device) -> contextlib.AbstractContextManager[Any]:
    """Return the context that halves the time of a prediction where the processor multiplies
    bfloat16.
    """
    abilities: dict[str, Any] = getattr(torch.cpu, "get_capabilities", dict)()
    fast = abilities.get("avx512_bf16") or abilities.get("amx_bf16")
    return (
        torch.autocast("cpu", torch.bfloat16)
        if device.type == "cpu" and fast
        else contextlib.nullcontext()
    )


def scheduled(optimizer: torch.optim.Optimizer, steps: float) -> dict[str, Any]:
    """Return what `configure_optimizers` may: the rate rises over 100 steps, or a tenth, then falls
    as a cosine to 0.

    Args:
        optimizer: whose rate is the highest.
        steps: of the whole training, `trainer.estimated_stepping_batches`.
    """

    def rate(step: int) -> float:
        return min(1.0, (step + 1) / min(100, 0.1 * steps)) * (
            0.5 + 0.5 * math.cos(math.pi * min(1.0, step / steps))
        )

    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, rate)
    return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


class Muon(torch.optim.Optimizer):
    """Momentum whose matrices are brought near the closest orthogonal one (Jordan et al. 2024),
    Adam for the vectors.

    On this network a step is worth about two of AdamW's. https://kellerjordan.github.io/posts/muon
    """

    def __init__(self, parameters: Any, lr: float, weight_decay: float = 0.01) -> None:
        """Take what any optimizer takes."""
        super().__init__(parameters, {"lr": lr, "weight_decay": weight_decay})

    @torch.no_grad()
    def step(self, closure: Any = None) -> Any:
        """Change all parameters once."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            matrices: dict[torch.Size, list[tuple[Tensor, Tensor]]] = {}
            for parameter in group["params"]:
                if parameter.grad is None:
                    continue
                update = _momentum(parameter.grad, self.state[parameter])
                if parameter.ndim < 2:
                    parameter.sub_(update, alpha=group["lr"])
                else:  # (out, in * 3 * 3), the longer side last
                    flat = update.flatten(1)
                    wide = flat.T if flat.shape[0] > flat.shape[1] else flat
                    matrices.setdefault(wide.shape, []).append((parameter, wide))
            for shape, found in matrices.items():  # those of one shape at once: three times as fast
                near = _orthogonal(torch.stack([wide for _, wide in found]))
                for (parameter, _), x in zip(found, near, strict=True):
                    transformed = x.T if len(parameter) > parameter[0].numel() else x
                    parameter.mul_(1 - group["lr"] * group["weight_decay"])
                    parameter.sub_(
                        transformed.reshape(parameter.shape),
                        alpha=0.2 * group["lr"] * math.sqrt(shape[1]),
                    )
        return loss


def _momentum(slope: Tensor, state: dict[str, Any]) -> Tensor:
    """Return the direction of a step: Nesterov's momentum for matrices, Adam's for vectors."""
    if not state:
        state.update(step=0, mean=torch.zeros_like(slope), square=torch.zeros_like(slope))
    state["step"] += 1
    if slope.ndim >= 2:
        state["mean"].lerp_(slope, 0.05)
        return slope.lerp(state["mean"], 0.95)
    state["mean"].lerp_(slope, 0.1)
    state["square"].lerp_(slope * slope, 0.02)
    mean: Tensor = state["mean"] / (1 - 0.9 ** state["step"])
    square: Tensor = state["square"] / (1 - 0.98 ** state["step"])
    return mean / (square.sqrt() + 1e-8)


def _orthogonal(x: Tensor) -> Tensor:
    """Return matrices (B, rows, columns) with all singular values near 1; a Newton-Schulz
    iteration.
    """
    x = x / (torch.linalg.matrix_norm(x, keepdim=True) + 1e-7)
    for _ in range(5):
        square = x @ x.mT
        x = 3.4445 * x + (-4.7750 * square + 2.0315 * square @ square) @ x
    return x
