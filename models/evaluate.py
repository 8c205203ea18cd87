"""Compare planners or samplers in one table: python -m mapdata.models.evaluate NAME.

NAME is one of

    planners    classical planners, and planners that use a network
    samplers    samplers of roadmaps (they need scipy)

For example:

    python -m mapdata.models.evaluate planners --preset dungeon --maps 600 --seed 77
    python -m mapdata.models.evaluate samplers --preset dungeon --maps 1000 --seed 77
    python -m mapdata.models.evaluate planners --help

In a checkout scripts/evaluate_planners.py and scripts/evaluate_sampler.py take the same arguments,
without the name.

The planners include pretrained path predictors for 4-connected movement, and for 8-connected
movement whose diagonal moves cost sqrt(2), with and without --corner-cutting. For another movement,
name your own weights with --weights.

The samplers include the pretrained ones, those of pretrained/weights whose names begin with lego or
shortest_path. A roadmap has n vertices in all. Half of them are Halton points, except in the rows
halton and uniform, and in the rows whose names end in _alone.
"""

from __future__ import annotations

from mapdata.interrupts import exit_on_interrupt

if __name__ == "__main__":
    exit_on_interrupt()  # before the imports, which take seconds

import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import torch
from matplotlib.figure import Figure

from mapdata import PRESETS, evaluation
from mapdata.checks import printable
from mapdata.cli import (
    check_outputs,
    compare_planners,
    load_problems,
    run_parsed,
    write_table,
)
from mapdata.movement import Movement
from mapdata.plotting import write_figure

from .neural_astar import NeuralAstar
from .pretrained.command_line import run_named_command
from .pretrained.learned_planners import planners
from .pretrained.model import WEIGHTS, load_model
from .pretrained.path_predictor import PathPredictor

if TYPE_CHECKING:
    from .pretrained.lego.sampler import Sampler

SHIPPED = {Movement(8): "eight", Movement(8, corner_cutting=True): "cut", Movement(4): "four"}
"""The names of the pretrained path predictors, by their movement."""

PLOTTED = ("halton", "bridge", "corners_alone", "lego_cvae", "lego_heatmap", "lego_heatmap_alone")
"""Samplers in the figure; the table has all of them."""


def evaluate_planners(
    root: list[str],
    *,
    preset: str | None = None,
    seed: int | None = None,
    maps: int | None = None,
    until_hard: int | None = None,
    connectivity: Literal[4, 8] = 8,
    corner_cutting: bool = False,
    diagonal_cost: float = math.sqrt(2),
    baseline: str | None = None,
    save: str | None = None,
    csv: str | None = None,
    json: str | None = None,
    figure: str | None = None,
    weights: str | None = None,
) -> None:
    """Compare planners on one problem per map, or on the problems of a file, in one thread.

    Examples:
      python -m mapdata.models.evaluate planners --preset dungeon --maps 600 --seed 77
      python -m mapdata.models.evaluate planners data/maps --csv planners.csv
      python -m mapdata.models.evaluate planners arena.map.scen
      python -m mapdata.models.evaluate planners --preset tiles --corner-cutting --diagonal-cost 1

    Args:
        root: in place of --preset: datasets, whose test split is used; or a file with problems: a
            MovingAI .scen, an .npz of planning-datasets or of a tile-based set, a
            _vertex_weights.npy of a Warcraft set, or a file that --save wrote
        preset: a preset that 'mapdata list' describes, such as terrain or tiles, or a recipe, as a
            file or JSON text (default: dungeon)
        seed: 64-bit seed of maps and problems (default: that of the recipe, or 77); for datasets,
            of their problems (default: that of the dataset); for planning-datasets, of the starts
        maps: number of maps (default: that of the recipe, or 600; of a dataset, all); for a .scen,
            the largest number of its problems, evenly spread over the file (default: all)
        until_hard: stop after the map with which there are this many hard problems
        connectivity: 4-connected or 8-connected movement
        corner_cutting: allow diagonal moves beside occupied cells
        diagonal_cost: cost of a diagonal move: 1 or sqrt(2)
        baseline: name of the row whose expansions count as 1 (default: mapdata's A*)
        save: write the problems to an .npz file, which can be given as ROOT later
        csv: write the table to a CSV file
        json: write the table to a JSON file, as a list of rows
        figure: draw cost ratio against expansions on the hard problems to this file
        weights: file of a path predictor or Neural A* (default: the pretrained one)
    """
    check_outputs(save, csv, json, figure)
    movement = Movement(connectivity, corner_cutting, diagonal_cost)
    is_preset = preset is None or preset in PRESETS
    if not root and maps is None and until_hard is None and is_preset:
        maps = 600
    problems = load_problems(root, preset, seed, maps, until_hard=until_hard, movement=movement)
    if save is not None:
        problems.save(save)
    rows = evaluation.classical(problems.movement, terrain=problems.terrain is not None)
    model: PathPredictor | NeuralAstar | None = None
    if weights is not None:
        model = load_weights(weights)
        if model.movement != problems.movement:
            raise ValueError(
                f"weights: {weights} are for {model.movement}, the problems for {problems.movement}"
            )
    elif problems.movement in SHIPPED:
        model = PathPredictor.pretrained(SHIPPED[problems.movement])
    learned: list[evaluation.Planner] = []
    if isinstance(model, PathPredictor):
        learned += planners(model)
    elif model is not None:
        learned.append(model)
    # Classical planners run in one thread, and times count all threads: a second one that waits
    # for work would be counted, too.
    thread_count = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        compare_planners(
            [*rows, *learned],
            problems,
            own=[planner.name for planner in learned],
            baseline=baseline,
            csv=csv,
            json=json,
            figure=figure,
        )
    finally:
        torch.set_num_threads(thread_count)


def load_weights(file: str) -> PathPredictor | NeuralAstar:
    """Return the model in a file of weights."""
    model = load_model(file, PathPredictor, NeuralAstar)
    assert isinstance(model, (PathPredictor, NeuralAstar))
    return model


def evaluate_samplers(
    root: list[str],
    *,
    preset: str | None = None,
    seed: int | None = None,
    maps: int | None = None,
    sizes: list[int] | None = None,
    csv: str | None = None,
    json: str | None = None,
    figure: str | None = None,
    weights: str | None = None,
    sample: str | None = None,
) -> None:
    """Compare samplers of roadmaps on one problem per map: new maps, or the test split of datasets.

    Examples:
      python -m mapdata.models.evaluate samplers --preset dungeon --maps 1000 --seed 77
      python -m mapdata.models.evaluate samplers data/maps --sizes 24 50

    Args:
        root: datasets, in place of --preset
        preset: a preset that 'mapdata list' describes, except terrain and tiles, or a recipe, as
            a file or JSON text (default: dungeon)
        seed: 64-bit seed of maps and problems (default: that of the recipe, or 77); for datasets,
            of their problems (default: that of the dataset)
        maps: number of maps (default: that of the recipe, or 1000; of a dataset, all)
        sizes: numbers of vertices of the roadmaps (default: 24 50 100)
        csv: write the table to a CSV file
        json: write the table to a JSON file, as a list of rows
        figure: draw success against the number of vertices to this file
        weights: folder of the trained samplers (default: the pretrained ones)
        sample: file of weights of models/lego_sampler.py, which adds two rows
    """
    from mapdata.roadmaps import SIZES, LearnedSampler, compare, contenders, plot_success, to_text

    check_outputs(csv, json, figure)
    if weights is not None and not Path(weights).is_dir():
        raise ValueError(f"weights: there is no folder {weights}")
    learned: dict[str, LearnedSampler] = dict(learned_samplers(Path(weights or WEIGHTS)))
    if sample is not None:
        from .lego_sampler import LegoSampler

        learned["sample"] = LegoSampler.load_from_checkpoint(sample, map_location="cpu").eval()
    rows = contenders(learned)
    if not root and maps is None and (preset is None or preset in PRESETS):
        maps = 1000
    problems = load_problems(root, preset, seed, maps, movement=Movement(8))
    table = compare(rows, problems, sorted(set(sizes or SIZES)))
    print(
        f"{problems.description}; a cell's centre is its coordinate + 0.5; hardness by "
        f"{problems.movement}\n"
    )
    print(to_text(table))
    write_table(table, csv, json)
    if figure is not None:
        canvas = Figure(figsize=(7, 6), layout="constrained")
        plotted = table[table["sampler"].isin(PLOTTED)]
        subset = "hard" if problems.hard.any() else "all"
        plot_success(plotted, canvas.add_subplot(), subset)
        write_figure(canvas, figure)


def learned_samplers(folder: Path) -> dict[str, Sampler]:
    """Return the samplers whose weights are in a folder, by the names of their files."""
    from .pretrained.lego.cvae import CVAE
    from .pretrained.lego.sampler import Heatmap

    files = sorted(
        [*folder.glob("lego_*.safetensors"), *folder.glob("shortest_path_*.safetensors")]
    )
    return {printable(file.stem): load_model(file, Heatmap, CVAE) for file in files}


COMMANDS = {
    "planners": partial(run_parsed, evaluate_planners, root=[]),
    "samplers": partial(run_parsed, evaluate_samplers, root=[]),
}
"""What each name compares."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code."""
    run_named_command("python -m mapdata.models.evaluate", COMMANDS, __doc__, arguments)


if __name__ == "__main__":
    main()
