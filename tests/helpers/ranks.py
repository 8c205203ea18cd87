"""Trains on two processes; each writes what it saw: python -m helpers.ranks ROOT OUT DEVICES."""

from __future__ import annotations

import json
import os
import sys
import warnings
from pathlib import Path

import torch
import torchmetrics
from pytorch_lightning.callbacks import ModelCheckpoint

from helpers.training import Model, module, trainer
from mapdata import Sample

BATCH = 4
MIDDLE = 3
"""The step at which the checkpoint is made that is gone on from."""


class Logging(Model):
    """Logs the mean of the numbers of the problems in several ways, and that of ones."""

    def __init__(self) -> None:
        """Make the metric that is logged."""
        super().__init__()
        self.mean_number = torchmetrics.MeanMetric()

    def validation_step(self, batch: Sample, batch_idx: int) -> None:
        """Log as docs/distributed.md does, and as it warns of."""
        super().validation_step(batch, batch_idx)
        numbers = batch.problem.float()
        self.mean_number.update(numbers)
        self.log("metric", self.mean_number)
        self.log("sum", numbers.sum(), reduce_fx="sum", sync_dist=True)
        self.log("count", float(len(numbers)), reduce_fx="sum", sync_dist=True)
        size = len(numbers)
        self.log("mean_of_ones", torch.ones(size).mean(), batch_size=size, sync_dist=True)


def main(root: str, out: Path, devices: int) -> None:
    """Fit, validate, test, predict; then go on from the middle of an epoch."""
    ranks = {"devices": devices, "strategy": "ddp" if devices > 1 else "auto"}
    model = Logging()
    every = ModelCheckpoint(out / "steps", "{step}", every_n_train_steps=MIDDLE, save_top_k=-1)
    run = trainer(callbacks=[every], enable_checkpointing=True, num_sanity_val_steps=0, **ranks)
    run.fit(model, datamodule=module(root, batch_size=BATCH))
    trained = model.others["val"]
    model.others["val"] = []
    (logged,) = run.validate(model, datamodule=module(root, batch_size=BATCH), verbose=False)
    run.test(model, datamodule=module(root, batch_size=BATCH), verbose=False)
    run.predict(model, datamodule=module(root, batch_size=BATCH), return_predictions=False)
    resumed = Model()
    again = trainer(num_sanity_val_steps=0, **ranks)
    again.fit(
        resumed,
        datamodule=module(root, batch_size=BATCH),
        ckpt_path=out / "steps" / f"step={MIDDLE}.ckpt",
    )
    result = {
        "seen": [(one.epoch, one.problems) for one in model.seen],
        "resumed": [(one.epoch, one.problems) for one in resumed.seen],
        "trained": trained,
        "others": model.others,
        "means": model.means,
        "logged": logged,
    }
    (out / f"rank{os.environ.get('LOCAL_RANK', '0')}.json").write_text(json.dumps(result))
    if devices > 1:
        # Lightning leaves the process group open, and the threads of gloo that are alive when the
        # interpreter ends abort the process now and then ("terminate called ...", in C++ alone).
        torch.distributed.barrier()
        torch.distributed.destroy_process_group()


if __name__ == "__main__":
    warnings.simplefilter("ignore")  # Lightning's advice on workers and on metrics of several ranks
    main(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]))
