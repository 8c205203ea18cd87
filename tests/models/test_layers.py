"""The layers: maps of any size, and layers that are added to trained ones."""

from __future__ import annotations

import torch
from torch import nn

from models.layers import STRIDE, Residual, Trunk, padded


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
