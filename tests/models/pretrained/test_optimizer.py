"""The optimizer: steps are compared with torch's linear algebra and Adam; the learning rate."""

from __future__ import annotations

import math

import pytest
import torch
from torch import nn

from mapdata.models.pretrained.optimizer import Muon, _orthogonal, one_cycle


@pytest.mark.parametrize("shape", [(8, 20), (20, 8), (6, 3, 3, 3), (4, 16, 3, 3)])
def test_a_step_of_muon_is_near_orthogonal(shape: tuple[int, ...]) -> None:
    """If the gradient of a matrix is U S V^T, its first step is U V^T, up to a factor near 1 for
    each pair of singular vectors.
    """
    torch.manual_seed(0)
    matrices = [nn.Parameter(torch.zeros(shape)) for _ in range(3)]
    optimizer = Muon(matrices, lr=1.0, weight_decay=0.0)
    for matrix in matrices:
        matrix.grad = torch.randn(shape)
    optimizer.step()
    for matrix in matrices:
        assert matrix.grad is not None
        u, _, v = torch.linalg.svd(matrix.grad.flatten(1), full_matrices=False)
        scale = 0.2 * math.sqrt(max(matrix.flatten(1).shape))
        factors = torch.diagonal(u.T @ (-matrix.detach().flatten(1) / scale) @ v.T)
        assert factors.min() > 0.6
        assert factors.max() < 1.3
        singular = torch.linalg.svdvals(matrix.detach().flatten(1)) / scale
        torch.testing.assert_close(
            singular.sort().values, factors.sort().values, atol=1e-3, rtol=1e-3
        )


def test_vectors_take_steps_of_adam() -> None:
    """The steps are those of torch's Adam with betas (0.9, 0.98) and without weight decay."""
    torch.manual_seed(0)
    ours = nn.Parameter(torch.zeros(5))
    theirs = nn.Parameter(torch.zeros(5))
    optimizers = [Muon([ours], lr=0.1), torch.optim.Adam([theirs], lr=0.1, betas=(0.9, 0.98))]
    for _ in range(4):
        gradient = torch.randn(5)
        ours.grad = gradient.clone()
        theirs.grad = gradient.clone()
        for optimizer in optimizers:
            optimizer.step()
    torch.testing.assert_close(ours, theirs)


@pytest.mark.parametrize("steps", [10, 50, 4000])
def test_the_rate_rises_and_falls(steps: int) -> None:
    """It rises from near 0 to the highest in 100 steps, or in 15 % of a short training, and then
    falls to 0.
    """
    optimizer = torch.optim.SGD([nn.Parameter(torch.zeros(1))], lr=0.5)
    schedule = one_cycle(optimizer, steps)["lr_scheduler"]["scheduler"]
    rates = []
    for _ in range(steps):
        rates.append(optimizer.param_groups[0]["lr"])
        optimizer.step()
        schedule.step()
    top = rates.index(max(rates))
    assert steps == 10 or rates[0] < 0.11
    assert 0.48 < rates[top] <= 0.5
    assert top <= min(100, 0.15 * steps)
    assert rates[top:] == sorted(rates[top:], reverse=True)
    assert rates[-1] < 1e-5


def test_the_smallest_numbers_change_no_step() -> None:
    """Denormal numbers in the momentum count as 0, since processors are slow with them."""
    torch.manual_seed(0)
    faded = torch.randn(2, 8, 12)
    faded[:, 3] *= 1e-40
    assert (faded[:, 3] != 0).any()
    with_zeros = faded.clone()
    with_zeros[:, 3] = 0
    assert torch.equal(_orthogonal(faded), _orthogonal(with_zeros))
