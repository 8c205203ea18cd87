"""A model that remembers what it saw, and the Trainer for the tests of the data module."""

from __future__ import annotations

from typing import Any, NamedTuple

import pytorch_lightning as pl
import torch
import torchmetrics

from mapdata import MapDataModule, Sample

FIELDS = ("map", "start", "goal", "problem")


class Seen(NamedTuple):
    """One training batch: its epoch, its problems, their starts, the dtype and sum of its maps."""

    epoch: int
    problems: tuple[int, ...]
    starts: tuple[int, ...]
    dtype: torch.dtype
    occupied: int


class Model(pl.LightningModule):
    """Sees batches, learns next to nothing.

    Args:
        size: number of weights.
        estimate: read ``trainer.estimated_stepping_batches`` when the optimizer is made, as
            schedulers do.
        noise: draw global random numbers, as dropout does.
    """

    def __init__(self, size: int = 2, estimate: bool = False, noise: bool = False) -> None:
        """Make the one layer, and remember nothing yet."""
        super().__init__()
        self.save_hyperparameters()
        self.layer = torch.nn.Linear(size, 1)
        self.size = size
        self.estimate = estimate
        self.noise = noise
        self.seen: list[Seen] = []
        self.others: dict[str, list[int]] = {"val": [], "test": [], "predict": []}
        self.mean = torchmetrics.MeanMetric()
        self.means: list[float] = []

    def training_step(self, batch: Sample, _: int) -> torch.Tensor:
        """Remember a batch."""
        problems = tuple(batch.problem.tolist())
        starts = tuple(batch.start.flatten().tolist())
        occupied = int(batch.map.sum())
        self.seen.append(Seen(self.current_epoch, problems, starts, batch.map.dtype, occupied))
        if self.noise:
            torch.rand(self.current_epoch + 3)
        loss: torch.Tensor = self.layer(torch.zeros(1, self.size)).sum()
        return loss

    def validation_step(self, batch: Sample, _: int) -> None:
        """Remember the problems, and their mean in a metric of torchmetrics."""
        self._see("val", batch)

    def test_step(self, batch: Sample, batch_idx: int) -> None:
        """Remember the problems."""
        self._see("test", batch)

    def predict_step(self, batch: Sample, _: int) -> torch.Tensor:
        """Remember the problems, and give them back."""
        self._see("predict", batch)
        problems: torch.Tensor = batch.problem
        return problems

    def _see(self, stage: str, batch: Sample) -> None:
        self.others[stage] += batch.problem.tolist()
        self.mean.update(batch.problem.float())
        self.mean.update(batch.map.flatten(1).sum(dim=1))

    def on_validation_epoch_end(self) -> None:
        """Keep the metric's value, over all ranks."""
        self.means.append(float(self.mean.compute()))
        self.mean.reset()

    on_test_epoch_end = on_validation_epoch_end

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Ask how long the training will be, if asked to."""
        if self.estimate:
            assert self.trainer.estimated_stepping_batches > 0
        return torch.optim.SGD(self.parameters(), 1e-9)


def trainer(**arguments: Any) -> pl.Trainer:
    """Return a Trainer on the CPU that writes nothing."""
    quiet: dict[str, Any] = {
        "accelerator": "cpu",
        "logger": False,
        "enable_progress_bar": False,
        "enable_model_summary": False,
        "enable_checkpointing": False,
        "max_epochs": 2,
    }
    return pl.Trainer(**{**quiet, **arguments})


def module(root: str | None, **arguments: Any) -> MapDataModule:
    """Return a data module of small batches with the fields that `Model` needs."""
    return MapDataModule(root, **{"batch_size": 8, "fields": FIELDS, **arguments})
