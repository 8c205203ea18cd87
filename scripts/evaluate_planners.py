"""Compare planners in one table: python scripts/evaluate_planners.py --preset dungeon --maps 600
--seed 77, or ROOT.

The trained path predictor comes along where it moves as asked: 8-connected without corner cutting,
unless --weights names others.
"""

import math
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
from mapdata.evaluation import BatchPlanner, Planner, classical, evaluate, to_text
from mapdata.plotting import plot_planners
from mapdata.spec import Movement

MODELS = Path(__file__).parent.parent / "models"
WEIGHTS = MODELS / "weights" / "path_predictor.pt"


def evaluate_command(
    root: list[str],
    preset: str | None,
    seed: int | None,
    maps: int | None,
    until_hard: int | None,
    connectivity: int,
    corner_cutting: bool,
    diagonal_cost: float,
    csv: str | None,
    json: str | None,
    figure: str | None,
    weights: str | None,
) -> None:
    """Compare planners on one problem a map: maps made on the spot, or the test split of a
    dataset.
    """
    check_outputs(csv, json, figure)
    movement = Movement(connectivity, corner_cutting, diagonal_cost)
    learned = learned_planners(weights, movement)
    maps = 600 if not root and maps is None and until_hard is None else maps
    problems = given_problems(root, preset, seed, maps, until_hard=until_hard, movement=movement)
    planners: list[Planner] = [*classical(movement), *learned]
    table = evaluate(planners, problems)
    print(f"{problems.description}; {movement}\n\n{to_text(table)}")
    write_table(table, csv, json)
    if figure is not None:
        canvas = Figure(figsize=(7, 6), layout="constrained")
        plot_planners(table, canvas.add_subplot(), subset="hard" if problems.hard.any() else "all")
        canvas.savefig(figure, dpi=150)


def learned_planners(weights: str | None, movement: Movement) -> list[BatchPlanner]:
    """Return the rows of the path predictor; none of the weights that ship if they are not there or
    move otherwise.
    """
    if weights is None and not (WEIGHTS.exists() and (MODELS / "path_predictor.py").exists()):
        return []
    if weights is not None and not Path(weights).is_file():
        raise ValueError(f"weights: there is no file {weights}")
    from models.learned_planners import planners
    from models.path_predictor import PathPredictor

    model = PathPredictor.load(weights or WEIGHTS)
    if model.movement == movement:
        return planners(model)
    if weights is not None:
        raise ValueError(
            f"weights: {weights} are for {model.movement}, the problems for {movement}"
        )
    return []


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code."""
    parser = Parser(description=evaluate_command.__doc__)
    add_problem_arguments(parser, maps=600)
    parser.add_argument(
        "--until-hard", metavar="K", type=int, help="stop at the map with the K-th hard problem"
    )
    parser.add_argument(
        "--connectivity", type=int, choices=(4, 8), default=8, help="moves (default: %(default)s)"
    )
    parser.add_argument(
        "--corner-cutting", action="store_true", help="diagonal moves beside occupied cells too"
    )
    parser.add_argument(
        "--diagonal-cost",
        metavar="D",
        type=float,
        default=math.sqrt(2),
        help="of diagonal moves: 1 or sqrt 2 (default)",
    )
    parser.add_argument(
        "--figure", metavar="FILE", help="draw cost ratio against expansions on the hard problems"
    )
    parser.add_argument(
        "--weights", metavar="FILE", help="of the path predictor (default: those that ship)"
    )
    run(evaluate_command, **vars(parser.parse_args(arguments)))


if __name__ == "__main__":
    main()
