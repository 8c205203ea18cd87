"""The layers take maps of any size, and layers can be added to a trained network."""

from __future__ import annotations

import torch
from torch import nn

from mapdata.models.pretrained.layers import STRIDE, Residual, Trunk, padded


def test_a_trunk_takes_any_multiple_of_its_stride() -> None:
    """The features have as many rows and columns as the padded map."""
    trunk = Trunk(3, 5, (4, 6, 8), passes=1)
    for rows, columns in ((1, 1), (8, 16), (9, 23)):
        maps = padded(torch.zeros(2, 1, rows, columns, dtype=torch.uint8))
        height, width = maps.shape[2:]
        assert (height % STRIDE, width % STRIDE) == (0, 0)
        assert maps.sum() == 2 * (height * width - rows * columns)
        features = trunk(maps.float().expand(-1, 3, -1, -1))
        assert features.shape == (2, 5, height, width)


def test_refinements_add_their_layers_alone_and_take_part() -> None:
    """The weights of a network without refinements fit all other layers. A refinement whose last
    convolution is zero does not change the features, and any other refinement does.
    """
    torch.manual_seed(0)
    plain = Trunk(3, 5, (4, 6, 8), passes=1)
    refined = Trunk(3, 5, (4, 6, 8), passes=1, refinements=2)
    missing, unexpected = refined.load_state_dict(plain.state_dict(), strict=False)
    assert unexpected == []
    assert {name.rsplit(".", 2)[0] for name in missing} == {"refine.0", "refine.1"}
    planes = torch.randn(2, 3, 16, 32)
    blocks = [block for block in refined.refine if isinstance(block, Residual)]
    for block in blocks:
        for parameter in block.second.parameters():
            nn.init.zeros_(parameter)
    assert torch.equal(refined(planes), plain(planes))
    for block in blocks:
        before = refined(planes)
        nn.init.normal_(block.second.weight)
        assert not torch.allclose(refined(planes), before)
