"""Measure costs that are learned from images: python docs/image_tables.py FILE [--only TEXT].

Each row of the table trains a `mapdata.models.CostPredictor` on images and shortest paths and
scores it on 1,000 new maps of seed 77. FILE collects the rows as JSON and grows: a row that it
already has is not measured again, so that the command can be stopped and run again. At the end the
table is written into docs/costs.md. All rows take one core about three hours.
"""

from __future__ import annotations

import argparse
import json
import logging
import time
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytorch_lightning as pl
import torch
from torch.utils.data import DataLoader

from mapdata import (
    MapGenerator,
    OnlineMapDataset,
    ProblemSet,
    ProblemSetDataset,
    Sample,
    Terrain,
    Tiles,
    search_batch,
)
from mapdata.arrays import Bytes
from mapdata.evaluation import score_paths
from mapdata.models import CostPredictor
from mapdata.models.pretrained.cost_predictor import TRAINING_FIELDS
from mapdata.search import BatchResult
from mapdata.shards import write_output

PAGE = Path(__file__).parent / "costs.md"
BEGIN, END = "<!-- table -->", "<!-- end -->"
"""The marks around the table in the page."""

TEST_SEED = 77
TEST_MAPS = 1000
TEST_TEXTURES = 1
"""The seed of textures that no training has seen; those of the training have seed 0."""

NOISE = 8
"""Standard deviation of the noise of all images, in grey levels."""


@dataclass(frozen=True)
class Family:
    """Maps of a row.

    Attributes:
        generator: draws the maps.
        problems: the problems on them.
        batch_size: maps of a training step.
        steps: of a training.
    """

    generator: MapGenerator
    problems: str
    batch_size: int
    steps: int


def _tiles(side: int) -> Terrain:
    """Return the preset ``tiles`` with maps of another size."""
    preset = Terrain.preset("tiles")
    return Terrain(
        (side, side),
        costs=preset.costs,
        scale=preset.scale,
        obstacles=0.0,
        corners=True,
        movement=preset.movement,
    )


FAMILIES = {
    "tiles 12": Family(_tiles(12), "route", 16, 7500),
    "tiles 18": Family(_tiles(18), "route", 16, 2700),
    "tiles 24": Family(_tiles(24), "route", 16, 2700),
    "tiles 30": Family(_tiles(30), "route", 16, 2700),
    "terrain 64": Family(Terrain.preset("terrain"), "random", 8, 1200),
}
"""The maps by the names of the table: ``tiles`` of several sizes, and ``terrain``."""

TRAINING_SIZES = (10_000, 1_000)
NETWORK = "normalised tiles"
"""What the network of new rows sees. Rows of "raw tiles" are of an earlier network, which saw the
tiles as they are and was trained for a fixed time; a new row takes the place of such a row.
"""

SEEDS = (0, 1, 2)
"""The seeds of the trainings by paths."""

MORE_SEEDS = (3, 4, 5, 6, 7, 8, 9)
"""Further seeds of the trainings on 10,000 maps of ``terrain``, the hardest ones."""


def training_batches(family: Family, maps: int, seed: int) -> DataLoader[Sample]:
    """Return the batches of an epoch: new maps of a family with their images and paths."""
    data = OnlineMapDataset(
        family.generator,
        seed=1000 + seed,
        length=maps,
        split=None,
        fields=(*TRAINING_FIELDS, Tiles(alike=True, noise=NOISE)),
        problems=family.problems,
    )
    return DataLoader(data, family.batch_size, shuffle=True, drop_last=True)


def train(family: Family, maps: int, loss: str, seed: int) -> tuple[CostPredictor, dict[str, Any]]:
    """Return a model that is trained on new maps of a family, and what the training took."""
    pl.seed_everything(seed, verbose=False)
    loader = training_batches(family, maps, seed)
    movement = family.generator.movement
    # "whole paths" is the loss of "paths" without parts of them.
    arguments: dict[str, Any] = {"parts": 0} if loss == "whole paths" else {"loss": loss}
    model = CostPredictor(
        movement.connectivity, movement.corner_cutting, movement.diagonal_cost, **arguments
    )
    trainer = pl.Trainer(
        accelerator="cpu",
        max_epochs=-1,
        max_steps=family.steps,
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    began = time.process_time()
    trainer.fit(model, loader)
    seconds = time.process_time() - began
    return model.eval(), {"seconds": round(seconds), "steps": family.steps}


def problems_of(family: Family) -> ProblemSet:
    """Return the problems that all models of a family are scored on."""
    return ProblemSet.sample(
        family.generator,
        seed=TEST_SEED,
        maps=TEST_MAPS,
        movement=family.generator.movement,
        problems=family.problems,
    )


def predicted_terrain(model: CostPredictor, problems: ProblemSet, textures: int) -> Bytes:
    """Return the terrain that a model sees in the images of problems, (N, H, W)."""
    image = Tiles(alike=True, noise=NOISE, seed=textures)
    dataset = ProblemSetDataset(problems, fields=("map", image))
    terrain = [
        model.predict(batch.image.numpy(), batch.map[:, 0].numpy())
        for batch in DataLoader(dataset, batch_size=20)
    ]
    return np.concatenate(terrain)


def searched(problems: ProblemSet, terrain: Bytes | None) -> BatchResult:
    """Return the shortest paths of problems under some costs; None for equal costs."""
    ends = problems.starts, problems.goals
    return search_batch("astar", problems.grids, *ends, problems.movement, terrain=terrain)


def scores(problems: ProblemSet, terrain: Bytes | None) -> dict[str, float]:
    """Return regret and share of optimal paths, with intervals, of searching on ``terrain``."""
    row = score_paths(problems, searched(problems, terrain)).iloc[0]
    names = ("regret", "regret_low", "regret_high", "opt", "opt_low", "opt_high")
    return {name: float(row[name]) for name in names}


def measure(name: str, maps: int, loss: str, seed: int) -> dict[str, Any]:
    """Return one row of the file."""
    family = FAMILIES[name]
    problems = problems_of(family)
    row: dict[str, Any] = {
        "maps": name,
        "set": problems.content_hash,
        "generator": family.generator.to_dict(),
        "training_maps": maps,
        "loss": loss,
        "seed": seed,
        "movement": asdict(problems.movement),
        "noise": NOISE,
    }
    if loss == "none":
        return {**row, **scores(problems, None)}
    model, effort = train(family, maps, loss, seed)
    seen = scores(problems, predicted_terrain(model, problems, textures=0))
    new = scores(problems, predicted_terrain(model, problems, TEST_TEXTURES))
    of_new_textures = {f"new_textures_{key}": score for key, score in new.items()}
    parameters = sum(weight.numel() for weight in model.parameters())
    row |= {"network": NETWORK, "parameters": parameters}
    return {**row, **effort, **seen, **of_new_textures}


def key_of(row: dict[str, Any]) -> tuple[str, int, str, int]:
    """Return the maps, their number, the loss and the seed of a row, as `plan` names them."""
    return row["maps"], row["training_maps"], row["loss"], row["seed"]


def plan() -> list[tuple[str, int, str, int]]:
    """Return the rows to measure, those that matter most first: (maps, number, loss, seed)."""
    rows: list[tuple[str, int, str, int]] = [(name, 0, "none", 0) for name in FAMILIES]
    for seed in SEEDS:
        rows += [(name, maps, "paths", seed) for name in FAMILIES for maps in TRAINING_SIZES]
        if seed == 0:
            rows += [(name, 10_000, "terrain", seed) for name in FAMILIES]
            rows += [("tiles 12", 10_000, "expansions", seed)]
        rows += [("tiles 12", maps, "whole paths", seed) for maps in TRAINING_SIZES]
    rows += [("terrain 64", 10_000, "paths", seed) for seed in MORE_SEEDS]
    return rows


TAUGHT_BY = {
    "none": "nothing: all cells cost the same",
    "paths": "paths",
    "whole paths": "paths, without parts of them",
    "terrain": "the true costs",
    "expansions": "paths, by the loss of Neural A*",
}
"""How the table calls each loss."""


def place(row: dict[str, Any]) -> tuple[int, ...]:
    """Return what orders the rows of the table: maps, loss, number of maps, newer network first."""
    return (
        list(FAMILIES).index(row["maps"]),
        list(TAUGHT_BY).index(row["loss"]),
        -row["training_maps"],
        int(row.get("network", NETWORK) != NETWORK),
    )


def table(rows: list[dict[str, Any]]) -> str:
    """Return the rows as a Markdown table, the seeds of a training as one row of means."""
    ordered: list[dict[str, Any]] = sorted(rows, key=place)
    frame = pd.DataFrame(ordered)
    lines = [
        "| maps | taught by | training maps | network of | optimal | regret "
        "| new textures: optimal | regret |",
        "|---|---|---|---|---|---|---|---|",
    ]
    frame["network"] = frame["network"].fillna("")
    names = ["maps", "loss", "training_maps", "network"]
    for (maps, loss, count, network), group in frame.groupby(names, sort=False):
        cells = [str(maps), TAUGHT_BY[str(loss)], f"{count:,}" if count else "", str(network)]
        for name, digits in (
            ("opt", 1),
            ("regret", 3),
            ("new_textures_opt", 1),
            ("new_textures_regret", 2),
        ):
            if name not in group or group[name].isna().all():
                cells.append("")
                continue
            percent = 100 * group[name]
            text = f"{percent.mean():.{digits}f} %"
            if len(group) > 1:
                text += f" ({percent.min():.{digits}f} to {percent.max():.{digits}f})"
            cells.append(text)
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def write_page(rows: list[dict[str, Any]], page: Path = PAGE) -> None:
    """Write the table of the rows into the page, between its two marks."""
    before, rest = page.read_text().split(BEGIN)
    _, after = rest.split(END)
    write_output(page, f"{before}{BEGIN}\n\n{table(rows)}\n\n{END}{after}".encode())


def main() -> None:
    """Measure the rows that the file lacks, and write the table into the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--only", default="", help="measure the maps whose name holds this text")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    logging.getLogger("pytorch_lightning").setLevel(logging.ERROR)
    warnings.filterwarnings("ignore", module="pytorch_lightning")
    rows: list[dict[str, Any]] = []
    if arguments.file.exists():
        rows = json.loads(arguments.file.read_text())
    measured = {key_of(row) for row in rows if row.get("network", NETWORK) == NETWORK}
    for key in plan():
        if key in measured or arguments.only not in key[0]:
            continue
        rows = [row for row in rows if key_of(row) != key]
        rows.append(measure(*key))
        write_output(arguments.file, f"{json.dumps(rows, indent=1)}\n".encode())
        shown = {k: v for k, v in rows[-1].items() if k not in ("generator", "movement", "set")}
        print(json.dumps(shown), flush=True)
    write_page(rows)


if __name__ == "__main__":
    main()
