"""Compare samplers of roadmaps in one table: python scripts/evaluate_sampler.py --preset dungeon
--maps 1000 --seed 77.

The trained samplers in models/weights come along: lego_*.pt and shortest_path_*.pt. Roadmaps have n
vertices in all; of Gaussian, bridge and learned ones half are Halton's.
"""

from pathlib import Path

from matplotlib.figure import Figure

from mapdata.cli import (
    Parser,
    add_problem_arguments,
    check_outputs,
    given_problems,
    run,
    write_table,
)
from models.common import load_model
from models.cvae import CVAE, LocalCVAE
from models.lego_sampler import Heatmap, Sampler
from models.sampler_table import SIZES, compare, contenders, plot_roadmaps, plot_success, to_text

WEIGHTS = Path(__file__).parent.parent / "models" / "weights"
PICTURED = ("halton", "bridge", "lego_cvae", "lego_heatmap")


def evaluate_command(
    root: list[str],
    preset: str | None,
    seed: int | None,
    maps: int | None,
    sizes: list[int],
    csv: str | None,
    json: str | None,
    figure: str | None,
    pictures: str | None,
    weights: str | None,
) -> None:
    """Compare samplers of roadmaps on one problem a map: maps made on the spot, or the test split
    of a dataset.
    """
    check_outputs(csv, json, figure, pictures)
    if weights is not None and not Path(weights).is_dir():
        raise ValueError(f"weights: there is no folder {weights}")
    rows = contenders(learned_samplers(Path(weights or WEIGHTS)))
    maps = 1000 if not root and maps is None else maps
    problems = given_problems(root, preset, seed, maps)
    table = compare(rows, problems, sorted(set(sizes)))
    print(
        f"{problems.description}; a cell's centre is its coordinate + 0.5; hardness by "
        f"{problems.movement}\n"
    )
    print(to_text(table))
    write_table(table, csv, json)
    if figure is not None:
        canvas = Figure(figsize=(7, 6), layout="constrained")
        plot_success(table, canvas.add_subplot(), "hard" if problems.hard.any() else "all")
        canvas.savefig(figure, dpi=150)
    if pictures is not None:
        shown = {name: rows[name] for name in PICTURED if name in rows}
        canvas = Figure(figsize=(5 * len(shown), 15), layout="constrained")
        plot_roadmaps(shown, problems, 50, canvas)
        canvas.savefig(pictures, dpi=90)


def learned_samplers(folder: Path) -> dict[str, Sampler]:
    """Return the samplers whose weights are in a folder, by the names of their files."""
    files = sorted([*folder.glob("lego_*.pt"), *folder.glob("shortest_path_*.pt")])
    return {file.stem: load_model(file, Heatmap, CVAE, LocalCVAE) for file in files}


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code."""
    parser = Parser(description=evaluate_command.__doc__)
    add_problem_arguments(parser, maps=1000)
    parser.add_argument(
        "--sizes",
        metavar="N",
        type=int,
        nargs="+",
        default=list(SIZES),
        help="vertices (default: 24 50 100)",
    )
    parser.add_argument(
        "--figure", metavar="FILE", help="draw success against the number of vertices"
    )
    parser.add_argument(
        "--pictures", metavar="FILE", help="draw roadmaps of 50 vertices with their samples"
    )
    parser.add_argument(
        "--weights", metavar="FOLDER", help="of the trained samplers (default: those that ship)"
    )
    run(evaluate_command, **vars(parser.parse_args(arguments)))


if __name__ == "__main__":
    main()
