"""Train a planner: python scripts/train_path_predictor.py fit --weights FILE.

All arguments are in scripts/train_path_predictor.yaml, and each is a flag too (fit --help).
Checkpoints and metrics.csv lie under runs/path_predictor: a checkpoint after every validation, and
one every three minutes, so that an interrupted run goes on. The bar shows val_opt and val_hmean,
what the search reaches on the validation problems.
More flags after fit:

    --ckpt_path FILE             go on from a checkpoint of an interrupted run
    --trainer.accelerator gpu --trainer.precision bf16-mixed    the same on a GPU
    --trainer.precision 32-true  in 32 bits; else `models.model.fast_precision` says which is fast
    --model.connectivity 4       the moves; the data follows
    --data mapdata.MapDataModule --data.root ROOT ...    on a dataset, such as imported maps;
        its fields are map, start, goal, path, unless --data.fields asks for richer ones
    --model NeuralAstar          another model: its rate, moves and fields are to be named, too,
        since those of the file stay; docs/planners.md has the command
"""

from __future__ import annotations

from mapdata.interrupts import exit_on_interrupt

if __name__ == "__main__":
    exit_on_interrupt()  # before the imports, which take seconds

from dataclasses import astuple, replace
from pathlib import Path

from pytorch_lightning.cli import ArgsType

import models.neural_astar  # noqa: F401  (so that --model knows it by its name)
from mapdata import MapDataModule
from models.learned_planners import LearnedPlanner
from models.training import TrainingCli

CONFIG = Path(__file__).with_suffix(".yaml")


class Cli(TrainingCli):
    """Its flags; the data moves as the model does."""

    def instantiate_classes(self) -> None:
        """Let the data move as the model does, and refuse data that was told otherwise.

        Data modules of another class are taken as they are.
        """
        super().instantiate_classes()
        movement = self.model.movement
        for part in getattr(self.datamodule, "parts", [self.datamodule]):
            if not isinstance(part, MapDataModule):
                continue
            given = part.serving.movement
            if given not in (None, movement):
                raise SystemExit(f"movement: got {given} for the data, {movement} for the model")
            part.serving = replace(part.serving, movement=movement)
            part.hparams["movement"] = astuple(movement)


def main(arguments: ArgsType = None) -> None:
    """Run the command line."""
    Cli(LearnedPlanner, CONFIG, arguments)  # type: ignore[type-abstract]  # a subclass is asked for


if __name__ == "__main__":
    main()
