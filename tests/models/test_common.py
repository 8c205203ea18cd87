"""What the sample models share: the optimizer, its rate, and sizes that the networks take."""

from __future__ import annotations

import math
import resource
from pathlib import Path

import pytest
import torch
from torch import nn

from models.common import (
    STRIDE,
    Muon,
    Residual,
    Trunk,
    _orthogonal,
    load_model,
    one_cycle,
    padded,
)
from models.path_predictor import PathPredictor


@pytest.mark.parametrize("shape", [(8, 20), (20, 8), (6, 3, 3, 3), (4, 16, 3, 3)])
def test_a_step_of_muon_is_near_orthogonal(shape: tuple[int, ...]) -> None:
    """The first step of each matrix is U V^T of its slope's U S V^T, up to a factor about 1 a
    direction.
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
    """As torch's Adam with betas (0.9, 0.98), which has no weight decay."""
    torch.manual_seed(0)
    ours, theirs = nn.Parameter(torch.zeros(5)), nn.Parameter(torch.zeros(5))
    optimizers = [Muon([ours], lr=0.1), torch.optim.Adam([theirs], lr=0.1, betas=(0.9, 0.98))]
    for _ in range(4):
        slope = torch.randn(5)
        ours.grad, theirs.grad = slope.clone(), slope.clone()
        for optimizer in optimizers:
            optimizer.step()
    torch.testing.assert_close(ours, theirs)


@pytest.mark.parametrize("steps", [10, 50, 4000])
def test_the_rate_rises_and_falls(steps: int) -> None:
    """From near 0 over 100 steps or 15 % to the highest, then to 0; 10 steps work, too."""
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


def test_a_trunk_takes_any_multiple_of_its_stride() -> None:
    """It gives as many cells as it gets."""
    trunk = Trunk(3, 5, (4, 6, 8), passes=1)
    for rows, columns in ((1, 1), (8, 16), (9, 23)):
        maps = padded(torch.zeros(2, 1, rows, columns, dtype=torch.uint8))
        high, wide = maps.shape[2:]
        assert (high % STRIDE, wide % STRIDE) == (0, 0)
        assert maps.sum() == 2 * (high * wide - rows * columns)
        cells = trunk(maps.float().expand(-1, 3, -1, -1))
        assert cells.shape == (2, 5, high, wide)


def test_refinements_add_their_layers_alone_and_take_part() -> None:
    """Weights without any fit all other layers. A block whose last convolution is zero changes
    nothing, any other one does.
    """
    torch.manual_seed(0)
    plain = Trunk(3, 5, (4, 6, 8), passes=1)
    refined = Trunk(3, 5, (4, 6, 8), passes=1, refinements=2)
    missing, unexpected = refined.load_state_dict(plain.state_dict(), strict=False)
    assert unexpected == []
    assert {name.rsplit(".", 2)[0] for name in missing} == {"refine.0", "refine.1"}
    seen = torch.randn(2, 3, 16, 32)
    blocks = [block for block in refined.refine if isinstance(block, Residual)]
    for block in blocks:
        for parameter in block.second.parameters():
            nn.init.zeros_(parameter)
    assert torch.equal(refined(seen), plain(seen))
    for block in blocks:
        before = refined(seen)
        nn.init.normal_(block.second.weight)
        assert not torch.allclose(refined(seen), before)


def test_the_smallest_numbers_change_no_step() -> None:
    """Momentum that faded away counts as none; processors are slow with such numbers."""
    torch.manual_seed(0)
    faded = torch.randn(2, 8, 12)
    faded[:, 3] *= 1e-40
    assert (faded[:, 3] != 0).any()
    gone = faded.clone()
    gone[:, 3] = 0
    assert torch.equal(_orthogonal(faded), _orthogonal(gone))


def test_a_flipped_bit_of_weights_is_refused(tmp_path: Path) -> None:
    """By the checksums of the file; torch compares none."""
    file = tmp_path / "weights.pt"
    PathPredictor(widths=(8, 8, 8), passes=1).save(file)
    sound = file.read_bytes()
    load_model(file, PathPredictor)
    for place in range(len(sound) // 4, len(sound) // 2, len(sound) // 40):
        flipped = bytearray(sound)
        flipped[place] ^= 64
        file.write_bytes(flipped)
        with pytest.raises(ValueError, match=r"weights\.pt: holds no saved PathPredictor"):
            load_model(file, PathPredictor)


def test_saving_replaces_the_whole_file_or_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where it fails, the weights of before are there."""
    file = tmp_path / "weights.pt"
    model = PathPredictor(widths=(8, 8, 8), passes=1)
    model.save(file)
    sound = file.read_bytes()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            model.save(file)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert file.read_bytes() == sound
    assert [each.name for each in tmp_path.iterdir()] == ["weights.pt"]
