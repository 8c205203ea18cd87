"""Small programs of the pages do what the text beside them says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import pages
from helpers.pages import DOCS
from helpers.specs import MOVEMENTS
from helpers.training import trainer
from pytorch_lightning import LightningModule
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from torch import Tensor, nn, optim

from mapdata import MapDataModule, Movement, distance_field
from mapdata.datasets import Sample


def program(page: str, name: str) -> Any:
    """Return what the one block of a page that has ``name`` defines by this name."""
    (block,) = [block for block in pages.blocks(DOCS / page) if f" {name}(" in block.text]
    session: dict[str, Any] = {"__name__": page}
    exec(block.text, session)
    return session[name]


@pytest.mark.parametrize("movement", MOVEMENTS)
def test_paths_in_the_graph_of_a_map_cost_what_they_cost_on_the_map(movement: Movement) -> None:
    """By scipy, from every cell to every other one; on maps with obstacles that touch corners."""
    graph_of = program("howto/coming_from.md", "graph_of")
    grid = (np.random.default_rng(4).random((7, 9)) < 0.35).astype(np.uint8)
    edges, costs = (part.numpy() for part in graph_of(grid, movement))
    cells = np.argwhere(grid == 0)
    graph = csr_matrix((costs, edges), (len(cells), len(cells)))
    found = dijkstra(graph)
    for goal, cell in enumerate(cells):
        field = distance_field(grid, cell, movement)[grid == 0]
        expected = np.where(field < 0, np.inf, field)
        np.testing.assert_allclose(found[:, goal], expected, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.filterwarnings(
    "ignore:The '.*dataloader' does not have many workers", "ignore:.*LeafSpec"
)
def test_the_curriculum_makes_training_problems_harder(tmp_path: Path) -> None:
    """In each epoch the least hardness is at least what the callback says."""
    least: dict[int, list[float]] = {}

    class Model(LightningModule):
        def __init__(self) -> None:
            super().__init__()
            self.layer = nn.Linear(1, 1)

        def training_step(self, batch: Sample) -> Tensor:
            least.setdefault(self.current_epoch, []).append(float(batch.hardness.min()))
            loss: Tensor = self.layer(batch.hardness[:, None]).mean()
            return loss

        def validation_step(self, batch: Sample) -> None:
            """Look at nothing: Lightning warns without it."""

        def configure_optimizers(self) -> optim.Optimizer:
            return optim.SGD(self.parameters(), 0.1)

    curriculum = program("problems.md", "Curriculum")
    data = MapDataModule(
        str(tmp_path / "maps"),
        build={"spec": "dungeon", "maps": 60, "seed": 0},
        problems="random",
        fields=("map", "start", "goal", "hardness"),
        movement=Movement(8),
        batch_size=16,
    )
    training = trainer(max_epochs=3, reload_dataloaders_every_n_epochs=1, callbacks=[curriculum()])
    training.fit(Model(), data)
    found = [min(least[epoch]) for epoch in range(3)]
    assert found[0] < 1.05 <= found[1] < 1.3
    assert found[2] >= 1.1
