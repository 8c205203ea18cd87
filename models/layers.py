"""What the sample models share: two kinds of layers, their optimizer, and fast predictions on a processor."""

from __future__ import annotations

import contextlib
import math
from typing import Any

import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from torch import Tensor, nn


class Residual(nn.Module):
    """x + two 3 x 3 convolutions, the second of which begins at zero; no norm, so that all map sizes are alike."""

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


def bfloat16(device: torch.device) -> contextlib.AbstractContextManager[Any]:
    """Return the context that halves the time of a prediction where the processor multiplies bfloat16."""
    abilities: dict[str, Any] = getattr(torch.cpu, "get_capabilities", dict)()
    fast = abilities.get("avx512_bf16") or abilities.get("amx_bf16")
    return torch.autocast("cpu", torch.bfloat16) if device.type == "cpu" and fast else contextlib.nullcontext()


class Muon(torch.optim.Optimizer):
    """Momentum whose matrices are brought near the closest orthogonal one (Jordan et al. 2024), Adam for the vectors.

    On this network a step is worth about two of AdamW's. https://kellerjordan.github.io/posts/muon
    """

    def __init__(self, parameters: Any, lr: float, weight_decay: float = 0.01) -> None:  # noqa: ANN401
        """Take what any optimizer takes."""
        super().__init__(parameters, {"lr": lr, "weight_decay": weight_decay})

    @torch.no_grad()
    def step(self, closure: Any = None) -> Any:  # noqa: ANN401  (torch's own signature)
        """Change all parameters once."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            for parameter in group["params"]:
                if parameter.grad is not None:
                    _muon(parameter, parameter.grad, self.state[parameter], group["lr"], group["weight_decay"])
        return loss


def _muon(parameter: Tensor, slope: Tensor, state: dict[str, Any], rate: float, decay: float) -> None:
    if not state:
        state.update(step=0, mean=torch.zeros_like(parameter), square=torch.zeros_like(parameter))
    state["step"] += 1
    if parameter.ndim < 2:
        state["mean"].lerp_(slope, 0.1)
        state["square"].lerp_(slope * slope, 0.02)
        mean, square = state["mean"] / (1 - 0.9 ** state["step"]), state["square"] / (1 - 0.98 ** state["step"])
        parameter.sub_(mean / (square.sqrt() + 1e-8), alpha=rate)
        return
    state["mean"].lerp_(slope, 0.05)
    update = slope.lerp(state["mean"], 0.95).flatten(1)  # (out, in * 3 * 3)
    tall = update.shape[0] > update.shape[1]
    x = update.T if tall else update
    x = x / (x.norm() + 1e-7)
    for _ in range(5):  # a Newton-Schulz iteration: all singular values towards 1
        square = x @ x.T
        x = 3.4445 * x + (-4.7750 * square + 2.0315 * square @ square) @ x
    x = (x.T if tall else x).reshape(parameter.shape)
    parameter.mul_(1 - rate * decay).sub_(x, alpha=0.2 * rate * math.sqrt(max(update.shape)))
