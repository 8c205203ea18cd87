"""Compare planners in one table.

python scripts/evaluate_planners.py --preset dungeon --maps 600 --seed 77
python scripts/evaluate_planners.py ROOT

The path predictors that ship are among the planners: there are weights for 4 moves, and for 8
moves whose diagonals cost sqrt(2), with and without --corner-cutting. For another movement, name
weights of your own with --weights.
"""

from mapdata.interrupts import exit_on_interrupt

if __name__ == "__main__":
    exit_on_interrupt()  # before the imports, which take seconds

import math
from typing import Literal

from matplotlib.figure import Figure

from mapdata import PRESETS
from mapdata.cli import check_outputs, load_problems, run_parsed, write_table
from mapdata.evaluation import classical, evaluate, to_text
from mapdata.movement import Movement
from mapdata.plotting import plot_planners
from models.learned_planners import planners
from models.model import WEIGHTS, load_model
from models.neural_astar import NeuralAstar
from models.path_predictor import PathPredictor

SHIPPED = {
    Movement(4): WEIGHTS / "path_predictor_4.pt",
    Movement(8): WEIGHTS / "path_predictor.pt",
    Movement(8, corner_cutting=True): WEIGHTS / "path_predictor_cut.pt",
}


def evaluate_command(
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
    """Compare planners on one problem a map, or on problems that others made.

    Examples:
      python scripts/evaluate_planners.py --preset dungeon --maps 600 --seed 77
      python scripts/evaluate_planners.py data/maps --csv planners.csv
      python scripts/evaluate_planners.py arena.map.scen

    Args:
        root: in place of --preset: datasets, of which the test split is taken; or a file, which is
            a MovingAI .scen, an .npz of planning-datasets, or one of --save
        preset: paper, narrow, dungeon, dungeon128, maze, cave, forest or noise, or a recipe, as a
            file or JSON text (default: dungeon)
        seed: 64-bit seed of maps and problems (default: 77, or the recipe's), or of the starts of
            planning-datasets
        maps: how many maps (default: 600, or the recipe's; of a dataset, all), or at most how many
            problems of a .scen, evenly spread over it (default: all)
        until_hard: stop at the map with this many hard problems
        connectivity: moves
        corner_cutting: diagonal moves beside occupied cells too
        diagonal_cost: of diagonal moves: 1 or sqrt 2
        baseline: name of the row whose expansions count as 1 (default: mapdata's A*)
        save: write the problems to an .npz, which takes the place of a dataset another time
        csv: write the table to a file
        json: write the table as a list of rows
        figure: draw cost ratio against expansions on the hard problems
        weights: file of a path predictor or Neural A* (default: the one that ships)
    """
    check_outputs(save, csv, json, figure)
    movement = Movement(connectivity, corner_cutting, diagonal_cost)
    is_preset = preset is None or preset in PRESETS
    if not root and maps is None and until_hard is None and is_preset:
        maps = 600
    problems = load_problems(root, preset, seed, maps, until_hard=until_hard, movement=movement)
    if save is not None:
        problems.save(save)
    rows = classical(problems.movement)
    file = weights or SHIPPED.get(problems.movement)
    if file is not None:
        model = load_model(file, PathPredictor, NeuralAstar)
        if model.movement != problems.movement:
            raise ValueError(
                f"weights: {file} are for {model.movement}, the problems for {problems.movement}"
            )
        if isinstance(model, PathPredictor):
            rows += planners(model)
        elif isinstance(model, NeuralAstar):
            rows.append(model)
    table = evaluate(rows, problems, baseline=baseline)
    print(f"{problems.description}; {problems.movement}; set {problems.content_hash[:12]}\n")
    print(to_text(table))
    write_table(table, csv, json)
    if figure is not None:
        canvas = Figure(figsize=(7, 6), layout="constrained")
        subset = "hard" if problems.hard.any() else "all"
        plot_planners(table, canvas.add_subplot(), subset=subset)
        canvas.savefig(figure, dpi=150)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code."""
    run_parsed(evaluate_command, arguments, root=[])


if __name__ == "__main__":
    main()
