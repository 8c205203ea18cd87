"""`MixedBatches`: batches of several data modules in one training step."""

from __future__ import annotations

import pytorch_lightning as pl
from pytorch_lightning.utilities import CombinedLoader
from torch.utils.data import DataLoader

from mapdata import MapDataModule, Sample


class MixedBatches(pl.LightningDataModule):
    """Several data modules at once: a training step gets a list with one batch of each.

    Validation takes them one after another. Loggers get the hyperparameters of the last part only;
    the config.yaml beside their files has those of all parts.

    Args:
        parts: the data modules.
    """

    def __init__(self, parts: list[MapDataModule]) -> None:
        """Keep the data modules."""
        super().__init__()
        self.parts = parts

    def prepare_data(self) -> None:
        """Build the datasets that are missing."""
        for part in self.parts:
            part.prepare_data()

    def setup(self, stage: str | None = None) -> None:
        """Open the datasets."""
        for part in self.parts:
            part.trainer = self.trainer
            part.setup(stage)

    def train_dataloader(self) -> CombinedLoader:
        """Return a loader of lists of batches, which ends with the shortest part."""
        return CombinedLoader([part.train_dataloader() for part in self.parts], "min_size")

    def val_dataloader(self) -> list[DataLoader[Sample]]:
        """Return a loader for each part."""
        return [part.val_dataloader() for part in self.parts]
