"""Train a planner: python scripts/train_path_predictor.py fit --weights FILE.

All arguments are in scripts/train_path_predictor.yaml, and all of them are flags, too (fit --help).
Checkpoints and metrics.csv are written to runs/path_predictor. There is a checkpoint after every
validation and every three minutes, from which an interrupted run can be resumed. The progress bar
shows val_opt and val_hmean, the metrics of the search on the validation problems.

Further flags after fit:

    --ckpt_path FILE
        Resume an interrupted run from a checkpoint.
    --trainer.accelerator gpu --trainer.precision bf16-mixed
        Train on a GPU.
    --trainer.precision 32-true
        Train in 32 bits. The default is the precision that is faster on this processor
        (`models.model.fast_precision`).
    --model.connectivity 4
        Move in four directions. The data follow the model.
    --data mapdata.MapDataModule --data.root ROOT ...
        Train on a dataset on disk, such as imported maps. Its fields are map, start, goal and path,
        unless --data.fields asks for richer ones.
    --model NeuralAstar
        Train another model. Learning rate, moves and fields must be given, too, because those of
        the YAML file are for the path predictor; docs/planners.md has the command.
"""

from __future__ import annotations

from mapdata.interrupts import exit_on_interrupt

if __name__ == "__main__":
    exit_on_interrupt()  # before the imports, which take seconds

from dataclasses import astuple, replace
from pathlib import Path

from pytorch_lightning.cli import ArgsType

import models.neural_astar  # noqa: F401  (registers the class, so that --model finds it by its name)
from mapdata import MapDataModule
from models.learned_planners import LearnedPlanner
from models.training import TrainingCli

CONFIG = Path(__file__).with_suffix(".yaml")


class Cli(TrainingCli):
    """The command line of path predictors, whose data move as the model does."""

    def instantiate_classes(self) -> None:
        """Give the data the movement of the model, or refuse data with another movement.

        Data modules of classes other than `MapDataModule` are left as they are.
        """
        super().instantiate_classes()
        movement = self.model.movement
        for part in getattr(self.datamodule, "parts", [self.datamodule]):
            if not isinstance(part, MapDataModule):
                continue
            part_movement = part.serving.movement
            if part_movement not in (None, movement):
                raise SystemExit(
                    f"movement: got {part_movement} for the data, {movement} for the model"
                )
            part.serving = replace(part.serving, movement=movement)
            part.hparams["movement"] = astuple(movement)


def main(arguments: ArgsType = None) -> None:
    """Run the command line."""
    # LearnedPlanner is abstract: --model takes one of its subclasses.
    Cli(LearnedPlanner, CONFIG, arguments)  # type: ignore[type-abstract]


if __name__ == "__main__":
    main()
