"""The optimizer of the models, Muon, and the schedule of its learning rate."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import Any

import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from torch import Tensor
from torch.optim.lr_scheduler import OneCycleLR


def one_cycle(optimizer: torch.optim.Optimizer, steps: float) -> dict[str, Any]:
    """Return an optimizer and its schedule, as Lightning's `configure_optimizers` returns them.

    The learning rate of the optimizer is the highest of the schedule. It is reached after 100
    steps, or after 15 % of a training of fewer than 667 steps, and then falls as a cosine.

    Args:
        optimizer: the optimizer.
        steps: number of steps of the training, as Lightning estimates it.
    """
    # With a largest share of 0.1, ten steps would have a warm-up of exactly one step, in which
    # OneCycleLR divides by 0.
    warm_up = min(100 / max(steps, 1), 0.15)
    max_rate = optimizer.param_groups[0]["lr"]
    schedule = OneCycleLR(
        optimizer,
        max_rate,
        total_steps=steps,  # type: ignore[arg-type]  # inf for a training without end: its error
        pct_start=warm_up,
        cycle_momentum=False,
    )
    return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


class Muon(torch.optim.Optimizer):
    """Muon for the weights of layers, Adam for their biases.

    Muon is by Jordan et al. 2024, https://kellerjordan.github.io/posts/muon; steps are as large as
    in Liu et al. 2025, arXiv 2502.16982.

    torch.optim.Muon (2.13) refuses the weights of convolutions, and torch 2.1 has no Muon. In the
    training of docs/tutorial.md the loss of the moves on validation maps is

        steps    Muon                    AdamW, at the best of three rates
        400      .34, .35 (two seeds)    .53, .53 (two seeds)
        800      .20                     .31
    """

    def __init__(self, parameters: Any, lr: float, weight_decay: float = 0.01) -> None:
        """Keep the arguments.

        Args:
            parameters: parameters or groups of them, as for all optimizers of torch.
            lr: learning rate.
            weight_decay: decay of the weights of layers, as in AdamW.
        """
        super().__init__(parameters, {"lr": lr, "weight_decay": weight_decay})

    @torch.no_grad()
    def step(self, closure: Any = None) -> Any:
        """Take a step with all parameters that have a gradient.

        Args:
            closure: a function that computes the loss and its gradients, as for all optimizers of
                torch; its loss is returned.
        """
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            rate = group["lr"]
            # Matrices of one shape are made orthogonal together, in a third of the time.
            matrices: dict[torch.Size, list[tuple[Tensor, Tensor]]] = defaultdict(list)
            for parameter in group["params"]:
                if parameter.grad is None:
                    continue
                direction = _momentum(parameter.grad, self.state[parameter])
                if parameter.ndim < 2:
                    parameter.sub_(direction, alpha=rate)
                else:
                    matrix = direction.flatten(1)  # (out, in * cells of the kernel)
                    matrices[matrix.shape].append((parameter, matrix))
            for shape, pairs in matrices.items():
                parameters, directions = zip(*pairs, strict=True)
                orthogonal = _orthogonal(torch.stack(directions))
                # With this size the elements of a step are as large as those of Adam.
                size = 0.2 * math.sqrt(max(shape)) * rate
                for parameter, direction in zip(parameters, orthogonal, strict=True):
                    parameter.mul_(1 - rate * group["weight_decay"])
                    parameter.sub_(direction.reshape_as(parameter), alpha=size)
        return loss


def _momentum(gradient: Tensor, state: dict[str, Any]) -> Tensor:
    """Return the direction of a step: Nesterov's momentum for matrices, Adam's step for vectors.

    Args:
        gradient: gradient of a parameter.
        state: what the optimizer keeps for the parameter from step to step; filled here.
    """
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
    """Return matrices with the singular vectors of ``x`` and all singular values near 1.

    The iteration is that of Newton and Schulz, with the coefficients of Jordan et al.

    Args:
        x: (B, rows, columns), matrices.
    """
    if x.shape[1] > x.shape[2]:
        # The products below are squares of the first side, so it should be the shorter one.
        return _orthogonal(x.mT).mT
    x = x / (torch.linalg.matrix_norm(x, keepdim=True) + 1e-7)
    # The momentum of weights without gradients fades to denormal numbers, which a processor
    # multiplies so slowly that a step took three times as long at the end of a training.
    x = F.hardshrink(x, 1e-12)
    for _ in range(5):
        square = x @ x.mT
        x = 3.4445 * x + (-4.7750 * square + 2.0315 * square @ square) @ x
    return x
