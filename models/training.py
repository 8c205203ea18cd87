"""What the training scripts share: a command line that writes weights, and mixed batches."""

from __future__ import annotations

from pathlib import Path

import pytorch_lightning as pl
from pytorch_lightning.cli import ArgsType, LightningArgumentParser, LightningCLI
from pytorch_lightning.utilities import CombinedLoader
from torch.utils.data import DataLoader

from mapdata import MapDataModule, Sample
from mapdata.interrupts import stoppable
from models.model import Model, fast_precision


class TrainingCli(LightningCLI):
    """LightningCLI with ``--weights`` and ``--start_from``, files of a `models.model.Model`."""

    def __init__(self, model: type[Model], config: Path, arguments: ArgsType) -> None:
        """Run the command line: a subclass of ``model`` on any data, by default as a file says."""
        with stoppable("stopped; fit --ckpt_path FILE goes on from a checkpoint"):
            super().__init__(
                model,
                pl.LightningDataModule,
                subclass_mode_model=True,
                subclass_mode_data=True,
                parser_kwargs={"fit": {"default_config_files": [str(config)]}},
                save_config_kwargs={"overwrite": True},
                trainer_defaults={"precision": fast_precision()},
                args=arguments,
            )

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        """Add the flags."""
        parser.add_argument(
            "--start_from",
            type=str | None,
            help="file of weights to begin with, of the same network or one with fewer layers "
            "(path predictors that ship have --model.refinements 1)",
        )
        parser.add_argument(
            "--weights",
            type=str | None,
            help="file for the weights after the last step",
        )

    def before_instantiate_classes(self) -> None:
        """Refuse a file that could not be written after the training."""
        file = self.config[self.subcommand].weights
        if file is not None and (Path(file).is_dir() or not Path(file).parent.is_dir()):
            raise SystemExit(f"weights: got {file}, expected a file in a folder that exists")

    def instantiate_classes(self) -> None:
        """Begin with the weights of ``--start_from``, whatever is to be done."""
        super().instantiate_classes()
        file = self.config[self.subcommand].start_from
        if file is not None:
            # layers that the file lacks, such as refinements, keep what they begin with
            weights = self.model.state_dict() | self.model.load(file).state_dict()
            self.model.load_state_dict(weights)

    def before_fit(self) -> None:
        """Let limits of 1 be one batch.

        The command line makes them 1.0, which Lightning takes for all batches: 10,000 of online
        maps. All of them are null.
        """
        for limit in ("limit_train_batches", "limit_val_batches"):
            if self.config.fit.trainer[limit] == 1:
                setattr(self.trainer, limit, 1)

    def after_fit(self) -> None:
        """Write the weights."""
        file = self.config.fit.weights
        if file is not None and self.trainer.is_global_zero:
            self.model.save(file)


class MixedBatches(pl.LightningDataModule):
    """Several data modules at once: a training step gets a list with a batch of each.

    Validation sees them one after another. What loggers say of the data is of the last part: all
    parts are in the config.yaml beside it.
    """

    def __init__(self, parts: list[MapDataModule]) -> None:
        """Keep the parts."""
        super().__init__()
        self.parts = parts

    def prepare_data(self) -> None:
        """Build what is missing."""
        for part in self.parts:
            part.prepare_data()

    def setup(self, stage: str | None = None) -> None:
        """Open the datasets."""
        for part in self.parts:
            part.trainer = self.trainer
            part.setup(stage)

    def train_dataloader(self) -> CombinedLoader:
        """Return what yields lists of batches, until the first part ends."""
        return CombinedLoader([part.train_dataloader() for part in self.parts], "min_size")

    def val_dataloader(self) -> list[DataLoader[Sample]]:
        """Return a loader a part."""
        return [part.val_dataloader() for part in self.parts]
