"""The optimizer of the sample models, Muon, and its learning rate over a training."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import Any

import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from torch import Tensor
from torch.optim.lr_scheduler import OneCycleLR


def one_cycle(optimizer: torch.optim.Optimizer, steps: float) -> dict[str, Any]:
    """Return an optimizer and its rate over ``steps``, as `configure_optimizers` may.

    The optimizer's own rate is the highest: reached after 100 steps, then it falls as a cosine.
    """
    warm_up = min(100 / max(steps, 1), 0.15)  # not 0.1: OneCycleLR cannot rise for exactly one step
    highest = optimizer.param_groups[0]["lr"]
    schedule = OneCycleLR(
        optimizer,
        highest,
        total_steps=steps,  # type: ignore[arg-type]  # endless training is its own error
        pct_start=warm_up,
        cycle_momentum=False,
    )
    return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


class Muon(torch.optim.Optimizer):
    """Muon for the weights of layers, Adam for their biases (Jordan et al. 2024).

    https://kellerjordan.github.io/posts/muon; the size of a step as in Liu et al. 2025, arXiv
    2502.16982. torch.optim.Muon (2.13) refuses convolutions, and torch 2.1 has none. After 400
    steps of the training of docs/tutorial.md the loss of the moves, on maps not seen, is .34 and
    .35 with this (two seeds), .53 twice with torch's AdamW at the best of three rates; after 800
    steps it is .20 and .31.
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
            rate = group["lr"]
            matrices: dict[torch.Size, list[tuple[Tensor, Tensor]]] = defaultdict(list)
            for parameter in group["params"]:
                if parameter.grad is None:
                    continue
                update = _momentum(parameter.grad, self.state[parameter])
                if parameter.ndim < 2:
                    parameter.sub_(update, alpha=rate)
                else:
                    matrix = update.flatten(1)  # (out, in * kernel cells)
                    matrices[matrix.shape].append((parameter, matrix))
            for shape, found in matrices.items():
                # those of one shape together take a third of the time
                near = _orthogonal(torch.stack([matrix for _, matrix in found]))
                size = 0.2 * math.sqrt(max(shape)) * rate  # steps as large as Adam's
                for (parameter, _), update in zip(found, near, strict=True):
                    parameter.mul_(1 - rate * group["weight_decay"])
                    parameter.sub_(update.reshape_as(parameter), alpha=size)
        return loss


def _momentum(gradient: Tensor, state: dict[str, Any]) -> Tensor:
    """Return the direction of a step: Nesterov's momentum for matrices, Adam's for vectors."""
    if not state:
        state["step"] = 0
        state["mean"] = torch.zeros_like(gradient)
        if gradient.ndim < 2:
            state["square"] = torch.zeros_like(gradient)
    state["step"] += 1
    mean: Tensor = state["mean"]
    if gradient.ndim >= 2:
        mean.lerp_(gradient, 0.05)
        return gradient.lerp(mean, 0.95)
    mean.lerp_(gradient, 0.1)
    state["square"].lerp_(gradient**2, 0.02)
    unbiased: Tensor = mean / (1 - 0.9 ** state["step"])
    square: Tensor = state["square"] / (1 - 0.98 ** state["step"])
    return unbiased / (square.sqrt() + 1e-8)


def _orthogonal(x: Tensor) -> Tensor:
    """Return matrices (B, rows, columns) with all singular values near 1, by Newton-Schulz."""
    if x.shape[1] > x.shape[2]:
        return _orthogonal(x.mT).mT  # the products below are of the shorter side
    x = x / (torch.linalg.matrix_norm(x, keepdim=True) + 1e-7)
    # The momentum of weights that never change fades to the smallest numbers there are, with which
    # a processor multiplies so slowly that a step took three times as long in the end.
    x = F.hardshrink(x, 1e-12)
    for _ in range(5):
        square = x @ x.mT
        x = 3.4445 * x + (-4.7750 * square + 2.0315 * square @ square) @ x
    return x
