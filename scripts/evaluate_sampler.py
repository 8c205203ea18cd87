"""Compare samplers of roadmaps in one table.

    python scripts/evaluate_sampler.py --preset dungeon --maps 1000 --seed 77

The trained samplers in models/weights are among the samplers: lego_*.pt and shortest_path_*.pt.
Roadmaps have n vertices in all. Half of them are Halton's, except in the rows halton and uniform,
and in those whose names end in _alone.
"""

from mapdata.interrupts import exit_on_interrupt

if __name__ == "__main__":
    exit_on_interrupt()  # before the imports, which take seconds

from pathlib import Path

from matplotlib.figure import Figure

from mapdata import PRESETS, Movement
from mapdata.cli import check_outputs, load_problems, run_parsed, write_table
from models.lego.comparison import SIZES, compare, contenders, plot_success, to_text
from models.lego.cvae import CVAE
from models.lego.sampler import Heatmap, Sampler
from models.model import WEIGHTS, load_model

PLOTTED = ("halton", "bridge", "corners_alone", "lego_cvae", "lego_heatmap", "lego_heatmap_alone")
"""Rows in the figure; the table has all rows."""


def evaluate_command(
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
) -> None:
    """Compare samplers of roadmaps on one problem a map: of new maps, or of a dataset's test split.

    Examples:
      python scripts/evaluate_sampler.py --preset dungeon --maps 1000 --seed 77
      python scripts/evaluate_sampler.py data/maps --sizes 24 50

    Args:
        root: datasets, in place of --preset and --seed
        preset: paper, narrow, dungeon, dungeon128, maze, cave, forest or noise, or a recipe, as a
            file or JSON text (default: dungeon)
        seed: 64-bit seed of maps and problems (default: 77, or the recipe's)
        maps: how many maps (default: 1000, or the recipe's; of a dataset, all)
        sizes: numbers of vertices (default: 24 50 100)
        csv: write the table to a file
        json: write the table as a list of rows
        figure: draw success against the number of vertices
        weights: folder of the trained samplers (default: those that ship)
    """
    check_outputs(csv, json, figure)
    if weights is not None and not Path(weights).is_dir():
        raise ValueError(f"weights: there is no folder {weights}")
    rows = contenders(learned_samplers(Path(weights or WEIGHTS)))
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
        canvas.savefig(figure, dpi=150)


def learned_samplers(folder: Path) -> dict[str, Sampler]:
    """Return the samplers whose weights are in a folder, by the names of their files."""
    files = sorted([*folder.glob("lego_*.pt"), *folder.glob("shortest_path_*.pt")])
    return {file.stem: load_model(file, Heatmap, CVAE) for file in files}


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code."""
    run_parsed(evaluate_command, arguments, root=[])


if __name__ == "__main__":
    main()
