"""What all training scripts need: a command line that writes weights, and mixed batches."""

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
        """Run the command line.

        Args:
            model: the class of which --model names a subclass.
            config: file with the default arguments of ``fit``.
            arguments: the arguments; None takes those of the process.
        """
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
        """Add ``--start_from`` and ``--weights``."""
        parser.add_argument(
            "--start_from",
            type=str | None,
            help="file of weights to begin with, of the same network or of one with fewer layers "
            "(path predictors that ship have --model.refinements 1)",
        )
        parser.add_argument(
            "--weights",
            type=str | None,
            help="file for the weights after the last step",
        )

    def before_instantiate_classes(self) -> None:
        """Refuse a file for the weights that could not be written after hours of training."""
        file = self.config[self.subcommand].weights
        if file is not None and (Path(file).is_dir() or not Path(file).parent.is_dir()):
            raise SystemExit(f"weights: got {file}, expected a file in a folder that exists")

    def instantiate_classes(self) -> None:
        """Load the weights of ``--start_from``, for training and validation alike."""
        super().instantiate_classes()
        file = self.config[self.subcommand].start_from
        if file is not None:
            # Layers that the file lacks, such as refinements, keep their initial weights.
            weights = self.model.state_dict() | self.model.load(file).state_dict()
            self.model.load_state_dict(weights)

    def before_fit(self) -> None:
        """Make a limit of 1 mean one batch.

        The command line turns 1 into 1.0, which Lightning takes for all batches: 10,000 batches of
        online maps. A limit of null means all batches.
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
