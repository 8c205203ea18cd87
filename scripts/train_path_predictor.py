"""Train the path predictor: python scripts/train_path_predictor.py fit --weights FILE.

All arguments are in scripts/train_path_predictor.yaml, and each is a flag too (fit --help).
Checkpoints, metrics.csv and figures of predictions lie under runs/path_predictor: one of each for
every validation, and a checkpoint every three minutes, so that an interrupted run goes on. The bar
is of all steps; it shows val_opt and val_hmean, what the search reaches on the validation problems.
More flags after fit:

    --ckpt_path FILE             go on from a checkpoint
    --trainer.accelerator gpu    the same on a GPU
    --model.connectivity 4       the moves; the data follows
    --data mapdata.MapDataModule --data.root ROOT ...    on a dataset, such as imported maps;
        its fields are map, start, goal, path, unless --data.fields asks for richer ones
"""

from __future__ import annotations

from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from pytorch_lightning import Callback, LightningDataModule, LightningModule, Trainer
from pytorch_lightning.cli import ArgsType

from mapdata import astar
from mapdata.datasets import Sample, row
from mapdata.plotting import plot_prediction
from models.path_predictor import PathPredictor
from models.training import RunBar, TrainingCli

CONFIG = Path(__file__).with_suffix(".yaml")


class Figures(Callback):
    """Draws the model's answers to the first validation problems, each epoch."""

    def on_validation_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write ``predictions-<step>.png`` into the folder of the logs."""
        assert isinstance(pl_module, PathPredictor)
        if trainer.log_dir is None or not trainer.is_global_zero:
            return
        loaders: Any = trainer.val_dataloaders
        if not isinstance(loaders, list):
            loaders = [loaders]
        batches = [next(iter(loader)) for loader in loaders]
        samples = [row(batch, k) for batch in batches for k in range(len(batch.map))[:2]]
        canvas = Figure(figsize=(5 * len(samples), 5), layout="constrained")
        places = canvas.subplots(1, len(samples), squeeze=False)[0]
        for axes, sample in zip(places, samples, strict=True):
            draw(pl_module, sample, axes)
        folder = Path(trainer.log_dir)
        folder.mkdir(parents=True, exist_ok=True)
        canvas.savefig(folder / f"predictions-{trainer.global_step:06d}.png", dpi=80)


def draw(model: PathPredictor, sample: Sample, axes: Axes) -> None:
    """Draw the predicted path over a shortest one; shades are predicted heuristic ratios."""
    grid = sample.map.cpu().numpy().astype("uint8")  # (1, H, W)
    start = sample.start.cpu().numpy()
    goal = sample.goal.cpu().numpy()
    truth = astar(grid[0], start, goal, model.movement).path
    predicted = model.predict_path(grid, start, goal)
    _, ratios = model.predict(grid, goal[None])  # (1, H, W)
    plot_prediction(grid[0], predicted, truth, axes, scores=ratios[0])


class Cli(TrainingCli):
    """Its flags; the data moves as the model does."""

    def instantiate_classes(self) -> None:
        """Let the data move as the model does, and refuse data that was told otherwise."""
        super().instantiate_classes()
        movement = self.model.movement
        for part in getattr(self.datamodule, "parts", [self.datamodule]):
            given = part.serving.movement
            if given not in (None, movement):
                raise SystemExit(f"movement: got {given} for the data, {movement} for the model")
            part.serving = replace(part.serving, movement=movement)
            part.hparams["movement"] = astuple(movement)


def main(arguments: ArgsType = None) -> None:
    """Run the command line."""
    Cli(
        PathPredictor,
        LightningDataModule,
        subclass_mode_data=True,
        parser_kwargs={"fit": {"default_config_files": [str(CONFIG)]}},
        trainer_defaults={"callbacks": [Figures(), RunBar()]},
        save_config_kwargs={"overwrite": True},
        args=arguments,
    )


if __name__ == "__main__":
    main()
