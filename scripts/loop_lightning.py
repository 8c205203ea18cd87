"""Lightning: maps and masks arrive as float32 on the device; build= makes a missing dataset."""

import pytorch_lightning as pl
import torch

from mapdata import MapDataModule, Sample


class Model(pl.LightningModule):
    def __init__(self) -> None:
        super().__init__()
        layers = torch.nn.Conv2d(2, 16, 5, padding=2), torch.nn.ReLU(), torch.nn.Conv2d(16, 1, 1)
        self.network = torch.nn.Sequential(*layers)

    def training_step(self, batch: Sample, _: int) -> torch.Tensor:
        predicted = self.network(torch.cat((batch.map, batch.goal_mask), dim=1))
        loss = torch.nn.functional.mse_loss(predicted, batch.heuristic_ratio)
        self.log("loss", loss, prog_bar=True, batch_size=len(batch.map))
        return loss

    validation_step = training_step

    def configure_optimizers(self) -> torch.optim.Optimizer:
        return torch.optim.Adam(self.parameters())


data = MapDataModule("data/maps", batch_size=64, fields=("map", "goal_mask", "heuristic_ratio"))
pl.Trainer(max_epochs=2).fit(Model(), data)
