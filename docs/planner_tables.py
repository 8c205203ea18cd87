"""Measure docs/planner_tables.md: python docs/planner_tables.py [--transfer FILE].

Each set of problems is a recipe: one problem on each map of seed 77, until so many are hard. The
page has one table a set; docs/planners.md speaks of them. Up to an hour of one core.

With --transfer it measures networks trained on one family each instead, tested on all of them, and
writes their Hmean to a file as JSON.
"""

from __future__ import annotations

import argparse
import json
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytorch_lightning as pl
import torch
from torch import Tensor

from mapdata import MapDataModule, MapGenerator, MapSpec, Maze, Movement, ProblemSet, evaluate
from mapdata.evaluation import classical, with_interval
from mapdata.models.geometry import heuristic, offsets
from mapdata.models.learned_planners import GuidedSearch, planners
from mapdata.models.mixed_batches import MixedBatches
from mapdata.models.model import fast_precision
from mapdata.models.path_predictor import TRAINING_FIELDS, PathPredictor

DOCS = Path(__file__).parent
SEED = 77

WIDE_ROOMS = MapSpec(
    (256, 256), rooms=(60, 120), room_rows=(8, 30), room_columns=(8, 30), passage_width=(1, 4)
)
GENERATORS: dict[str, tuple[MapGenerator, int]] = {
    "paper": (MapGenerator.preset("paper"), 1000),
    "dungeon": (MapGenerator.preset("dungeon"), 1000),
    "narrow": (MapGenerator.preset("narrow"), 300),
    "maze": (MapGenerator.preset("maze"), 300),
    "loops": (Maze(corridor=2, reopened=0.1), 300),
    "cave": (MapGenerator.preset("cave"), 300),
    "forest": (MapGenerator.preset("forest"), 300),
    "noise": (MapGenerator.preset("noise"), 300),
    "dungeon128": (MapGenerator.preset("dungeon128"), 300),
    "dungeon256": (WIDE_ROOMS, 300),
}
"""The generators by name, each with the number of hard problems that are compared."""

RULES = {
    "": (Movement(8), "eight"),
    "-cut": (Movement(8, corner_cutting=True), "cut"),
    "-4": (Movement(4), "four"),
}
"""The rules of movement, by what the names of sets have of them, and the names of their weights."""

FAMILIES = ("dungeon", "maze", "cave", "forest", "noise")
"""Of the table of transfer."""

COLUMNS = {
    "opt": "Opt",
    "cost_ratio": "cost",
    "expansion_ratio": "expansions",
    "hmean": "Hmean",
}

FOLLOWED = (
    "as it ships",
    "none followed",
    "none followed, trust 0.4",
    "untrained",
    "untrained, none followed",
    "cells to the goal",
    "starts to the goal",
)
"""Columns of the table of what is followed."""


def problems_of(name: str, movement: Movement) -> ProblemSet:
    """Return the set of problems of a generator under a movement."""
    generator, hard = GENERATORS[name]
    return ProblemSet.sample(generator, SEED, until_hard=hard, movement=movement)


def hard_of(problems: ProblemSet) -> ProblemSet:
    """Return the hard ones alone."""
    hard = problems.hard
    return ProblemSet(
        problems.grids[hard], problems.starts[hard], problems.goals[hard], problems.movement
    )


class OneCell(PathPredictor):
    """A path predictor that follows no moves: a cost to go is what the network says of its cell."""

    def costs_to_go(
        self, occupied: Tensor, goals: Tensor, scores: Tensor, ratios: Tensor
    ) -> Tensor:
        """Return the heuristic over its predicted ratio, (B, H, W)."""
        least = heuristic(*offsets(goals, ratios.shape[1:]), self.movement)
        return least / ratios.clamp(min=0.05)


def with_and_without_moves(shipped: PathPredictor) -> list[GuidedSearch]:
    """Return the search as it ships, without following moves, and with a network of no training.

    Trust 0.4 was the best on other seeds before moves were followed, 0.15 is since.
    """
    torch.manual_seed(0)
    untrained = PathPredictor(**shipped.hparams)
    one_cell = {}
    for model in (shipped, untrained):
        one_cell[model] = OneCell(**model.hparams)
        one_cell[model].load_state_dict(model.state_dict())
    return [
        GuidedSearch("search", shipped),
        GuidedSearch("search", one_cell[shipped].eval()),
        GuidedSearch("search", one_cell[shipped], trust=0.4),
        GuidedSearch("search", untrained.eval()),
        GuidedSearch("search", one_cell[untrained].eval()),
    ]


def followed_to_the_goal(model: PathPredictor, problems: ProblemSet) -> list[str]:
    """Return the shares of free cells and of starts from which 32 moves reach the goal."""
    cells = []
    starts = []
    for k in range(0, len(problems), 16):
        grids, goals = problems.grids[k : k + 16], problems.goals[k : k + 16]
        scores = torch.from_numpy(model.predict(grids, goals)[0])
        occupied, ends = model.tensors(grids[:, None], goals)
        # the cost to go at the end of the moves is twice as much in one, but 0 at the goal in both
        once, twice = (
            model.costs_to_go(occupied, ends, scores, torch.full(grids.shape, ratio))
            for ratio in (1.0, 0.5)
        )
        reached = (once == twice).numpy()
        cells.append(reached[grids == 0])
        begins = problems.starts[k : k + 16]
        starts.append(reached[np.arange(len(begins)), begins[:, 0], begins[:, 1]])
    return [f"{np.concatenate(each).mean():.2f}" for each in (cells, starts)]


def what_is_followed(model: PathPredictor, problems: ProblemSet) -> list[str]:
    """Return the row of a set: `FOLLOWED`."""
    hmeans = [
        evaluate([search], problems, bootstrap=1)["hmean"].iloc[0]
        for search in with_and_without_moves(model)
    ]
    return [*map("{:.3f}".format, hmeans), *followed_to_the_goal(model, problems)]


def markdown(rows: list[list[str]]) -> str:
    """Return a table whose first row is its head."""
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|---" * len(rows[0]) + "|", *lines[1:]])


def milliseconds(value: float) -> str:
    """Return a time, or a dash for what a planner cannot do."""
    return "-" if pd.isna(value) else f"{value:.3f}"


def page_of_sets() -> str:
    """Return the tables of all sets, a summary first."""
    summary = {}
    followed = [["set", *FOLLOWED]]
    sections = []
    for ending, (movement, weights) in RULES.items():
        model = PathPredictor.pretrained(weights)
        for generator in GENERATORS:
            problems = problems_of(generator, movement)
            table = evaluate([*classical(movement), *planners(model)], hard_of(problems))
            table = table[table["subset"] == "hard"]
            name = f"{generator}{ending}-hard-{GENERATORS[generator][1]}"
            print(f"{name}: {problems.content_hash[:12]}", flush=True)
            rows = [["planner", "success", *COLUMNS.values(), "ms alone", "ms in batches"]]
            measures = pd.DataFrame({metric: with_interval(table, metric) for metric in COLUMNS})
            for k, row in enumerate(table.to_dict("records")):
                measured = measures.iloc[k]
                times = [milliseconds(row["ms"]), milliseconds(row["ms_batched"])]
                rows.append([row["planner"], f"{row['success']:.3f}", *measured, *times])
            sections.append(
                f"## {name}\n\n{len(problems)} problems, {problems.hard.sum()} of them hard, set "
                f"`{problems.content_hash[:12]}`; {problems.description}.\n\n{markdown(rows)}\n"
            )
            summary[name] = table.set_index("planner")["hmean"].map("{:.2f}".format)
            if not ending:
                followed.append([name, *what_is_followed(model, hard_of(problems))])
    hmeans = pd.DataFrame(summary)
    rows = [["set", *hmeans.index]]
    for name in hmeans.columns:
        rows.append([name, *hmeans[name]])
    head = (
        "# All planners on all sets\n\n"
        "Made by `python docs/planner_tables.py`; [Planners compared](planners.md) says what the\n"
        "columns are. Hard problems alone; ± is half the width of the 95 % interval. Times are of\n"
        "one thread of a shared machine: compare those of one table;\n"
        "[Benchmarks](benchmarks.md#planners) has those of an idle one.\n\n"
        "## Hmean\n\n"
    )
    moves = (
        "\n\n## What is followed\n\n"
        "Hmean of the search, 8-connected, with costs to go from the end of the 32 most probable\n"
        "moves of each cell (`PathPredictor.costs_to_go`), and with those that the network says\n"
        "of the cell itself, where none are followed; both with the shipped weights and with a\n"
        "network without training. Trust is 0.15, chosen with moves followed, or 0.4, chosen\n"
        "without, both on problems of other seeds. Last, the shares of free cells and of starts\n"
        "from which the 32 moves of the shipped network reach the goal.\n\n"
    )
    return head + markdown(rows) + moves + markdown(followed) + "\n\n" + "\n".join(sections)


def trained_on(names: list[str], steps: int) -> PathPredictor:
    """Return a small network after so many steps of 24 maps of these families."""
    pl.seed_everything(1)
    parts = []
    for name in names:
        recipe = {
            "seed": 2000,
            "maps": 4_000_000,
            "spec": json.loads(MapGenerator.preset(name).to_json()),
        }
        parts.append(
            MapDataModule(
                None,
                build=json.dumps(recipe),
                fields=TRAINING_FIELDS,
                problems="random",
                augment=True,
                movement=(8, False, 2**0.5),
                batch_size=24 // len(names),
            )
        )
    model = PathPredictor(widths=(32, 48, 48), passes=3)
    trainer = pl.Trainer(
        accelerator="cpu",
        precision=fast_precision(),
        max_steps=steps,
        gradient_clip_val=1.0,
        limit_val_batches=0,
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    trainer.fit(model, MixedBatches(parts))
    return model.eval()


def transfer(steps: int) -> dict[str, dict[str, float]]:
    """Return Hmean of networks trained on a family each, on all, and on all but one."""
    movement = Movement(8)
    trainings = {name: [name] for name in FAMILIES}
    trainings["all five"] = list(FAMILIES)
    trainings["all but maze"] = [name for name in FAMILIES if name != "maze"]
    trainings["all but cave"] = [name for name in FAMILIES if name != "cave"]
    sets = {name: hard_of(problems_of(name, movement)) for name in FAMILIES}
    found: dict[str, dict[str, float]] = {}
    for training, names in trainings.items():
        model = trained_on(names, steps)
        found[training] = {}
        for name, problems in sets.items():
            table = evaluate([GuidedSearch("search", model)], problems, bootstrap=1)
            found[training][name] = round(float(table["hmean"].iloc[0]), 3)
        print(training, found[training], flush=True)
    return found


def main() -> None:
    """Measure, and write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--transfer", help="file for the table of transfer")
    parser.add_argument("--steps", type=int, default=2000, help="of each of its trainings")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    if given.transfer:
        Path(given.transfer).write_text(json.dumps(transfer(given.steps), indent=1) + "\n")
    else:
        (DOCS / "planner_tables.md").write_text(page_of_sets(), encoding="utf-8")


if __name__ == "__main__":
    main()
