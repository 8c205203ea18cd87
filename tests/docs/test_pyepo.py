"""The wrapper for PyEPO in docs/howto/coming_from.md finds cheapest paths, and its losses train."""

from __future__ import annotations

import re
import textwrap
from typing import Any

import numpy as np
import pytest
import torch
from helpers.pages import DOCS

from mapdata import Movement, OnlineMapDataset, search_batch, terrain_from_costs

RULE = Movement(8, corner_cutting=True, diagonal_cost=1)


def test_the_wrapper_finds_the_cheapest_cells() -> None:
    """On the problems of the notebook, by the costs of cells; SPO+ then has a gradient."""
    pytest.importorskip("pyepo")
    import pyepo

    page = (DOCS / "howto" / "coming_from.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^    from pyepo.*?(?=^\S)", page, re.MULTILINE | re.DOTALL)
    names: dict[str, Any] = {
        "np": np,
        "Movement": Movement,
        "search_batch": search_batch,
        "terrain_from_costs": terrain_from_costs,
    }
    exec(textwrap.dedent(block), names)
    model = names["GridModel"]()
    tiles = OnlineMapDataset("tiles", length=4, fields=("terrain", "path_mask"), movement=RULE)[:]
    costs = tiles.terrain[:, 0].numpy() * 0.1
    solutions, values = [], []
    for k in range(4):
        model.setObj(costs[k].ravel())
        solution, value = model.solve()
        solutions.append(solution.astype(np.float32))
        values.append([value])
        assert value == pytest.approx((costs[k] * tiles.path_mask[k, 0].numpy()).sum())
    predicted = torch.full((4, model.num_cost), 3.0, requires_grad=True)
    loss = pyepo.func.SPOPlus(model)(
        predicted,
        torch.tensor(costs.reshape(4, -1), dtype=torch.float32),
        torch.tensor(np.array(solutions)),
        torch.tensor(values, dtype=torch.float32),
    )
    loss.backward()
    assert loss.item() > 0
    assert predicted.grad is not None
    assert predicted.grad.abs().sum() > 0
