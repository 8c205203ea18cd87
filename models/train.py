r"""Train a model: python -m mapdata.models.train NAME fit --weights FILE.

NAME is one of

    path_predictor          the planner of docs/planners.md
    refine_path_predictor   the last 1,000 steps of its training, which begin with --start_from
    lego_sampler            the sampler of docs/samplers.md
    cost_predictor          the model of docs/costs.md, which predicts costs from images

The default arguments are in pretrained/configs/NAME.yaml. Each of them is also a flag:

    python -m mapdata.models.train path_predictor fit --help

These command lines need jsonargparse, the extra [train] (docs/install.md).
Checkpoints and metrics.csv are written below runs/. In a checkout scripts/train_path_predictor.py
and scripts/train_lego_sampler.py take the same arguments after --product, without the name.

Path predictors
---------------
A checkpoint is written after every validation and every three minutes. An interrupted run can be
resumed from it. The progress bar shows val_opt and val_hmean. These are the metrics of the tables
(Opt and Hmean), for the hard validation problems of 10 cells or more.
These flags can follow fit:

    --ckpt_path FILE
        Resume an interrupted run from a checkpoint. A finished run cannot be continued, because
        its learning rate has reached its final value. Start a new run from its weights with
        --start_from.
    --trainer.accelerator gpu --trainer.precision bf16-mixed
        Train on a GPU.
    --trainer.precision 32-true
        Train in 32 bits. The default is the faster precision on this processor
        (`mapdata.models.fast_precision`).
    --model.connectivity 4
        Train on 4-connected movement. The data get the movement of the model.
    --data mapdata.MapDataModule --data.root ROOT ...
        Train on a dataset on disk, such as imported maps. The fields are map, start, goal and path;
        --data.fields selects others.
    --model NeuralAstar
        Train another model. Also set the learning rate, the movement and the fields, because those
        of the YAML file are for the path predictor; docs/reference/models.md has the command.

Models of costs
---------------
Paths are planned on predicted costs. The progress bar shows val_regret, their cost on the true
terrain relative to the optimal cost, minus 1, and val_opt, the share of optimal paths.

Samplers
--------
The pretrained weights were made by these commands. The heat maps learned from six families of maps:

    T="python -m mapdata.models.train lego_sampler"
    for family in dungeon narrow cave forest noise; do
        mapdata build data/$family --preset $family --maps 2500 --seed 4001
    done
    mapdata build data/loops --maps 2500 --seed 4001 \
        --recipe '{"spec": {"generator": "maze", "corridor": 2, "reopened": 0.1}}'
    ROOTS="[data/dungeon,data/narrow,data/loops,data/cave,data/forest,data/noise]"
    $T fit --weights lego_heatmap.safetensors --data.build null --data.root "$ROOTS"
    $T fit --weights shortest_path_heatmap.safetensors --data.build null --data.root "$ROOTS" \
        --model.targets shortest_path
    $T fit --weights lego_cvae.safetensors --model CVAE --model.learning_rate 1e-3 \
        --data.build '{"seed": 4001, "maps": 6250, "spec": {"rooms": [8, 16],
            "room_rows": [6, 14], "room_columns": [6, 14], "passage_width": [1, 3]}}' \
        --data.batch_size 24 --data.fields "[map,start,goal,problem]" \
        --trainer.gradient_clip_val null --trainer.max_steps 60000 \
        --trainer.val_check_interval 5000 --trainer.limit_val_batches 2

Another --model keeps the arguments that both models have, such as the learning rate of the heat
map. So the command of the CVAE sets its own learning rate.

Before the first step, experience (LEGO's training data) is computed and stored in the folder
--data.experience, by default runs/experience. The next training on the same maps reads it from
there. Computing it takes 10 minutes of one core for the six families. A training step of a heat map
takes 0.14 s of one core, so 7,000 steps take 16 minutes, or 10 minutes of two cores. A step of a
CVAE takes 0.07 s.

Training on paths alone needs no experience:

    $T fit --model.targets path --data.experience null --data.fields "[map,start,goal,path]"
"""

from __future__ import annotations

from mapdata.interrupts import exit_on_interrupt

if __name__ == "__main__":
    exit_on_interrupt()  # before the imports, which take seconds

import inspect
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import astuple, replace
from importlib.util import find_spec
from pathlib import Path

import pytorch_lightning as pl
from lightning_fabric.utilities.exceptions import MisconfigurationException
from pytorch_lightning.cli import ArgsType, LightningArgumentParser, LightningCLI

from mapdata import MapDataModule
from mapdata.cli import print_all_letters
from mapdata.interrupts import stoppable

from . import neural_astar  # noqa: F401  (registers the class, so that --model finds it by its name)
from .pretrained.command_line import run_named_command
from .pretrained.cost_predictor import CostPredictor
from .pretrained.learned_planners import LearnedPlanner
from .pretrained.model import Model, fast_precision

CONFIGS = Path(__file__).parent / "pretrained" / "configs"
"""The folder of the files of arguments."""

NO_JSONARGPARSE = (
    "the command lines of trainings need jsonargparse, the extra [train]: "
    'pip install "jsonargparse[signatures]<5"'
)
"""What an install without the extra is told."""


@contextmanager
def refusals_in_one_line() -> Iterator[None]:
    """Exit with the message of what Lightning or a model refuses, without a traceback."""
    try:
        yield
    except MisconfigurationException as error:
        raise SystemExit(" ".join(str(error).split())) from None


class TrainingCli(LightningCLI):
    """LightningCLI with ``--weights`` and ``--start_from``, files of a `Model`."""

    def __init__(self, model: type[Model], configs: Sequence[str], arguments: ArgsType) -> None:
        """Run the command line.

        Args:
            model: the class of which --model names a subclass.
            configs: names of the files in `CONFIGS` with the default arguments of ``fit``.
            arguments: the arguments; None takes those of the process.

        Raises:
            SystemExit: jsonargparse is missing, or what Lightning or the model refuses.
        """
        print_all_letters()
        if find_spec("jsonargparse") is None:
            raise SystemExit(NO_JSONARGPARSE)
        files = [str(CONFIGS / name) for name in configs]
        with (
            stoppable("stopped; fit --ckpt_path FILE continues from a checkpoint"),
            refusals_in_one_line(),
        ):
            super().__init__(
                model,
                pl.LightningDataModule,
                subclass_mode_model=True,
                subclass_mode_data=True,
                parser_kwargs={"fit": {"default_config_files": files}},
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
            "(pretrained path predictors have --model.refinements 1)",
        )
        parser.add_argument(
            "--weights",
            type=str | None,
            help="file to which the weights are written after the last step",
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
        """Make a limit of 1 mean one batch, and silence a warning that is not true.

        The command line turns 1 into 1.0, which Lightning takes for all batches: 10,000 batches of
        online maps. A limit of null means all batches.
        """
        # `Model` lowers log_every_n_steps for short epochs, after Lightning has looked at it.
        message = "The number of training batches .* is smaller than the logging interval"
        warnings.filterwarnings("ignore", message)
        for limit in ("limit_train_batches", "limit_val_batches"):
            if self.config.fit.trainer[limit] == 1:
                setattr(self.trainer, limit, 1)

    def after_fit(self) -> None:
        """Write the weights."""
        file = self.config.fit.weights
        if file is not None and self.trainer.is_global_zero:
            self.model.save(file)
            print(f"wrote {file}")


class PlannerCli(TrainingCli):
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


def check_data_flags(arguments: ArgsType) -> None:
    """Refuse flags of `MapDataModule` without ``--data``: the default data are another class.

    Raises:
        SystemExit: the message names the class to ask for.
    """
    words = sys.argv[1:] if arguments is None else arguments
    if not isinstance(words, list):
        return
    flags = [word.partition("=")[0] for word in words if word.startswith("-")]
    if {"--data", "-c", "--config"} & set(flags):
        return
    for name in inspect.signature(MapDataModule).parameters:
        if f"--data.{name}" in flags:
            raise SystemExit(
                f"--data.{name}: is a flag of mapdata.MapDataModule, but the default data mix "
                f"several sets of maps; say --data mapdata.MapDataModule --data.{name} ..."
            )


def train_path_predictor(arguments: ArgsType = None) -> None:
    """Run the command line of planners; None takes the arguments of the process."""
    check_data_flags(arguments)
    # LearnedPlanner is abstract: --model takes one of its subclasses.
    PlannerCli(LearnedPlanner, ["path_predictor.yaml"], arguments)  # type: ignore[type-abstract]


def refine_path_predictor(arguments: ArgsType = None) -> None:
    """Run the command line of planners, with a second file of arguments after the first."""
    check_data_flags(arguments)
    files = ["path_predictor.yaml", "refine_path_predictor.yaml"]
    PlannerCli(LearnedPlanner, files, arguments)  # type: ignore[type-abstract]


def train_lego_sampler(arguments: ArgsType = None) -> None:
    """Run the command line of samplers; None takes the arguments of the process.

    Raises:
        ModuleNotFoundError: scipy is not installed.
    """
    from .pretrained.lego import cvae  # noqa: F401  (registers the class, so that --model finds it)
    from .pretrained.lego.sampler import Sampler

    # Sampler is abstract: --model takes one of its subclasses.
    TrainingCli(Sampler, ["lego_sampler.yaml"], arguments)  # type: ignore[type-abstract]


def train_cost_predictor(arguments: ArgsType = None) -> None:
    """Run the command line of models of costs; None takes the arguments of the process."""
    TrainingCli(CostPredictor, ["cost_predictor.yaml"], arguments)


COMMANDS = {
    "path_predictor": train_path_predictor,
    "refine_path_predictor": refine_path_predictor,
    "lego_sampler": train_lego_sampler,
    "cost_predictor": train_cost_predictor,
}
"""What each name trains."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command line."""
    run_named_command("python -m mapdata.models.train", COMMANDS, __doc__, arguments)


if __name__ == "__main__":
    main()
