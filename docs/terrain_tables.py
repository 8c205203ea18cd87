"""Measure a network on known terrain: python docs/terrain_tables.py FILE [--weights WEIGHTS].

A `mapdata.models.PathPredictor` that sees the costs of the cells is trained on terrain of 64 x 64
cells, and compared with classical planners on new maps: of the preset ``terrain``, and of families
that it was not trained on. The training takes one core about eight minutes. WEIGHTS is the file of
its weights: they are loaded from there if it exists, and written to it otherwise.

FILE is written as JSON, in the form that docs/planner_results.py describes. At the end the table is
printed as Markdown, as docs/planners.md shows it.
"""

from __future__ import annotations

import argparse
import logging
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytorch_lightning as pl
import torch
from planner_results import Results, this_run

from mapdata import (
    Cave,
    MapDataModule,
    Movement,
    ProblemSet,
    Random,
    Recipe,
    Terrain,
    evaluate,
)
from mapdata.evaluation import TIMES, GuidedSearch, Planner, classical
from mapdata.models import MixedBatches, PathPredictor, fast_precision
from mapdata.models.pretrained.path_predictor import TRAINING_FIELDS

MOVEMENT = Movement(8)

TRAINING_FAMILIES = (
    Terrain(),  # the preset: hills of 8 cells, costs 1 to 10 in equal shares
    Terrain(scale=4, shares=(0.19, 0.17, 0.15, 0.13, 0.11, 0.09, 0.07, 0.05, 0.03, 0.01)),
    Terrain(scale=16, shares=(0.01, 0.03, 0.05, 0.07, 0.09, 0.11, 0.13, 0.15, 0.17, 0.19)),
    # Costs that fall and rise with the height make valleys, in which cheap ways wind.
    Terrain(costs=(9, 7, 5, 3, 1, 2, 4, 6, 8, 10)),
    Terrain(costs=(1, 3, 5, 7, 9, 10, 8, 6, 4, 2), scale=6, obstacles=0),
    Terrain(scale=3, obstacles=0.3),
)
"""The families of the training; a step takes four maps of each."""

MAPS_PER_FAMILY = 4
STEPS = 2900
TRAINING_SEED = 5001
"""The seed of the maps of the first family; the next families have the next numbers."""

TEST_FAMILIES = {
    "terrain": Terrain.preset("terrain"),
    "patches": Terrain(costs=(1, 3, 10), scale=12, obstacles=0),
    "cave": Terrain(over=Cave()),
    "powers": Terrain(costs=(1, 2, 4, 8, 16, 32, 64, 128)),
}
"""The families of the table. The last three were not trained on: few levels without obstacles,
caves, and a wider range of costs.
"""

TEST_SEED = 77
TEST_MAPS = 300
MIN_PATH_CELLS = 25
"""The shortest paths of the test problems have at least this many cells."""

TRUSTS = (0.15, 0.02)
"""The values of `GuidedSearch.trust` in the table; the first one is the default."""

LEFT_OUT = (
    "BFS",
    "Dijkstra",
    "weighted A* (1.1)",
    "weighted A* (1.25)",
    "greedy best-first",
    "limit",
)
"""Planners that are in the file and not in the table."""

TIMED = 100
"""Number of problems that the times are means of."""

BATCH = 50
"""Problems of a batch whose time is measured."""


def train() -> PathPredictor:
    """Return a network that is trained on `TRAINING_FAMILIES`."""
    pl.seed_everything(1, verbose=False)
    parts = [
        MapDataModule(
            None,
            build=Recipe(family, TRAINING_SEED + k, maps=1_000_000),
            batch_size=MAPS_PER_FAMILY,
            fields=("terrain", *TRAINING_FIELDS),
            problems="random",
            movement=MOVEMENT,
            augment=True,
        )
        for k, family in enumerate(TRAINING_FAMILIES)
    ]
    model = PathPredictor(terrain=True)
    trainer = pl.Trainer(
        accelerator="cpu",
        max_steps=STEPS,
        precision=fast_precision(),
        gradient_clip_val=1.0,
        limit_val_batches=0,
        logger=False,
        enable_checkpointing=False,
        enable_model_summary=False,
    )
    trainer.fit(model, MixedBatches(parts))
    return model.eval()


def planners_of(model: PathPredictor) -> list[Planner]:
    """Return the planners of the table."""
    learned = [
        GuidedSearch(
            f"path_predictor (search, trust {trust})",
            MOVEMENT,
            model.predict,
            trust,
            takes_terrain=True,
        )
        for trust in TRUSTS
    ]
    return [*classical(MOVEMENT, terrain=True), *learned]


def processor_ms(solve: Callable[..., Any], problems: ProblemSet, batch_size: int) -> float:
    """Return the processor time of a problem in milliseconds, in batches of a size.

    On a machine that others use, too, time on the clock says more about them.
    """
    assert problems.terrain is not None
    seconds = 0.0
    # The first call may compile kernels, so that it is made twice, and the second time counts.
    for first in (0, *range(0, TIMED, batch_size)):
        batch = slice(first, first + batch_size)
        grids, starts, goals = problems.grids[batch], problems.starts[batch], problems.goals[batch]
        began = time.process_time()
        solve(grids, starts, goals, terrain=problems.terrain[batch])
        call_seconds = time.process_time() - began
        seconds = seconds + call_seconds if first else call_seconds
    return 1000 * seconds / TIMED


def problems_of(name: str) -> ProblemSet:
    """Return the problems on one of `TEST_FAMILIES`."""
    return ProblemSet.sample(
        TEST_FAMILIES[name],
        TEST_SEED,
        TEST_MAPS,
        movement=MOVEMENT,
        problems=Random(length=(MIN_PATH_CELLS, None)),
    )


def measure(results: Results, planners: Sequence[Planner], command: str) -> None:
    """Add the sets of all families, and the rows of the planners on them, to results."""
    run = this_run(command)
    for name, family in TEST_FAMILIES.items():
        problems = problems_of(name)
        table = evaluate(planners, problems)
        table = table[table["subset"] == "all"].set_index("planner", drop=False)
        for planner in planners:
            solve = planner.plan_batch  # type: ignore[attr-defined]  # all of them have it
            table.loc[planner.name, "ms"] = processor_ms(solve, problems, 1)
            table.loc[planner.name, "ms_batched"] = processor_ms(solve, problems, BATCH)
        results.add_set(name, problems, seed=TEST_SEED, generator=family.to_dict())
        # These are intervals of other times than those above.
        intervals = [f"{column}_{end}" for column in TIMES for end in ("low", "high")]
        results.add_rows(name, table.drop(columns=intervals), run)


def table_of(results: Results) -> str:
    """Return cost and expansions of all sets, and the times on the first, as a Markdown table."""
    names = list(results.sets)
    titles = ["planner"]
    for name in names:
        titles += [f"{name}: cost", "expansions"]
    titles += [f"{names[0]}: ms", "ms in batches"]
    lines = ["| " + " | ".join(titles) + " |", "|---" * len(titles) + "|"]
    for planner, first_row in results.rows_of(names[0]).items():
        if planner in LEFT_OUT:
            continue
        cells = [planner]
        for name in names:
            row = results.rows_of(name)[planner]
            cells += [f"{row['cost_ratio']:.4f}", f"{row['expansion_ratio']:.3f}"]
        cells += [f"{first_row['ms']:.2f}", f"{first_row['ms_batched']:.2f}"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Train or load a network, write the file and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--weights", type=Path, help="file to load the weights from, or to write")
    parser.add_argument(
        "--no-network", action="store_true", help="measure the search without a network alone"
    )
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    logging.getLogger("pytorch_lightning").setLevel(logging.ERROR)
    warnings.filterwarnings("ignore", module="pytorch_lightning")
    command = "python docs/terrain_tables.py"
    if arguments.no_network:
        results = Results.read(arguments.file)
        rows = [
            one
            for one in classical(MOVEMENT, terrain=True)
            if one.name == "guided search, no network"
        ]
        measure(results, rows, f"{command} --no-network")
        results.write(arguments.file)
        print(table_of(results))
        return
    if arguments.weights is not None and arguments.weights.exists():
        model = PathPredictor.load(arguments.weights)
    else:
        began = time.process_time()
        model = train()
        print(f"trained in {(time.process_time() - began) / 60:.1f} minutes")
        if arguments.weights is not None:
            model.save(arguments.weights)
    results = Results()
    measure(results, planners_of(model), command)
    results.write(arguments.file)
    print(table_of(results))


if __name__ == "__main__":
    main()
