r"""Train a sampler of roadmaps: python scripts/train_lego_sampler.py fit --weights FILE.

The weights that ship, in models/weights, were made by these commands. The heat maps learned from
six families of maps:

    S=scripts/train_lego_sampler.py
    for family in dungeon narrow cave forest noise; do
        mapdata build data/$family --preset $family --maps 2500 --seed 4001
    done
    mapdata build data/loops --maps 2500 --seed 4001 \
        --recipe '{"spec": {"generator": "maze", "corridor": 2, "reopened": 0.1}}'
    ROOTS="[data/dungeon,data/narrow,data/loops,data/cave,data/forest,data/noise]"
    python $S fit --weights lego_heatmap.pt --data.build null --data.root "$ROOTS"
    python $S fit --weights shortest_path_heatmap.pt --data.build null --data.root "$ROOTS" \
        --model.targets shortest_path
    python $S fit --weights lego_cvae.pt --model CVAE --model.learning_rate 1e-3 \
        --data.build '{"seed": 4001, "maps": 6250, "spec": {"rooms": [8, 16],
            "room_rows": [6, 14], "room_columns": [6, 14], "passage_width": [1, 3]}}' \
        --data.batch_size 24 --data.fields "[map,start,goal,problem]" \
        --trainer.gradient_clip_val null --trainer.max_steps 60000 \
        --trainer.val_check_interval 5000 --trainer.limit_val_batches 2

All arguments are in scripts/train_lego_sampler.yaml, and all of them are flags, too (fit --help).
Another --model keeps the arguments that both models have, such as the learning rate of the heat
map; so the command of the CVAE names its own.

Before the first step a bank of experience is mined into the folder --data.experience, by default
runs/experience, and the next training on the same maps reads it from there. Mining takes 10 minutes
of one core for the six families. A training step of a heat map takes 0.14 s of one core, so 7,000
steps take 16 minutes, or 10 minutes of two cores; a step of a CVAE takes 0.07 s. Checkpoints and
metrics.csv are written to runs/lego_sampler.

Training on paths alone needs no bank:

    python $S fit --model.targets path --data.experience null --data.fields "[map,start,goal,path]"
"""

from __future__ import annotations

from mapdata.interrupts import exit_on_interrupt

if __name__ == "__main__":
    exit_on_interrupt()  # before the imports, which take seconds

from pathlib import Path

from pytorch_lightning.cli import ArgsType

import models.lego.cvae  # noqa: F401  (registers the class, so that --model finds CVAE by its name)
from models.lego.sampler import Sampler
from models.training import TrainingCli

CONFIG = Path(__file__).with_suffix(".yaml")


def main(arguments: ArgsType = None) -> None:
    """Run the command line."""
    # Sampler is abstract: --model takes one of its subclasses.
    TrainingCli(Sampler, CONFIG, arguments)  # type: ignore[type-abstract]


if __name__ == "__main__":
    main()
