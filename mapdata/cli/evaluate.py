"""The verb ``evaluate``, and the comparison that it shares with the scripts of models and pages."""

from __future__ import annotations

import math
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from mapdata.checks import did_you_mean
from mapdata.cli.common import check_picture_ending, import_named, output_path
from mapdata.cli.problems import load_problems, write_table
from mapdata.movement import Movement

if TYPE_CHECKING:
    from mapdata.evaluation import Planner
    from mapdata.problems import ProblemSet


def evaluate_command(
    problems: list[str],
    *,
    planner: str | None = None,
    maps: int | None = None,
    per_map: int = 1,
    split: Literal["train", "val", "test"] | None = None,
    radius: float = 0.0,
    connectivity: Literal[4, 8] = 8,
    corner_cutting: bool = False,
    diagonal_cost: float = math.sqrt(2),
    json: str | None = None,
    figure: str | None = None,
) -> None:
    """Compare planners on the same problems: the classical ones, and your own.

    Examples:
      mapdata evaluate dungeon
      mapdata evaluate data/maps --connectivity 4 --json planners.json
      mapdata evaluate arena.map.scen --figure planners.png
      mapdata evaluate dungeon.npz --planner my_module:MyPlanner
      mapdata evaluate data/site --split train --per-map 100 --radius 0.3

    Args:
        problems: a file that ProblemSet.save wrote, or problems of others as .scen, .npz or .npy;
            or datasets, of whose test splits each map gives a random problem; or a preset that
            'mapdata list' describes, of which new maps give one each
        planner: MODULE:NAME of your own planner; the module may be a file in the working folder.
            NAME is a planner, or a class or function that takes a mapdata.Movement and returns one
        maps: number of maps (default: 600 of a preset, all of a dataset); for a .scen, the largest
            number of its problems
        per_map: number of problems on each map of a dataset or preset
        split: the split of a dataset (default: test)
        radius: radius of the robot, in metres, on maps of a dataset or preset
        connectivity: 4-connected or 8-connected movement; a file has its own movement
        corner_cutting: allow diagonal moves beside occupied cells
        diagonal_cost: cost of a diagonal move: 1 or sqrt(2)
        json: write the table to a JSON file, as a list of rows
        figure: draw cost ratio against expansions to this file
    """
    from mapdata.evaluation import classical
    from mapdata.generators import PRESETS
    from mapdata.problems.problem_set import DEFAULT_PROBLEMS

    for file in (json, figure):
        if file is not None:
            output_path(file)  # refuses it before the work
    if figure is not None:
        check_picture_ending(figure)
    movement = Movement(connectivity, corner_cutting, diagonal_cost)
    own = None if planner is None else own_planner(planner, "--planner")
    root, preset = problems, None
    if len(problems) == 1 and not Path(problems[0]).exists():
        if problems[0] in PRESETS:
            root, preset = [], problems[0]
            maps = 600 if maps is None else maps
        elif hint := did_you_mean(problems[0], PRESETS):
            raise ValueError(f"{problems[0]}: there is no such file, dataset or preset{hint}")
    if root and len(root) == 1 and root[0] in PRESETS:
        print(
            f"note: {root[0]} is the dataset in the folder of this name, not the preset",
            file=sys.stderr,
        )
    if preset is not None and split is not None:
        raise ValueError(f"--split: the maps of the preset {preset} are new, leave it out")
    options: dict[str, Any] = {}
    if per_map != 1:
        options["problems"] = replace(DEFAULT_PROBLEMS, per_map=per_map)
    if split is not None:
        options["split"] = split
    if radius:
        options["radius"] = radius
    problem_set = load_problems(root, preset, None, maps, movement=movement, **options)
    rows = classical(problem_set.movement, terrain=problem_set.terrain is not None)
    if own is not None:
        rows.append(own(problem_set.movement))
    try:
        compare_planners(rows, problem_set, json=json, figure=figure)
    except (OSError, ValueError):  # which end the command with one line
        if own is not None:
            traceback.print_exc()  # It shows where in the user's own code the error was raised.
        raise


def compare_planners(
    planners: Sequence[Planner],
    problems: ProblemSet,
    *,
    baseline: str | None = None,
    csv: str | None = None,
    json: str | None = None,
    figure: str | None = None,
) -> None:
    """Print the table of `mapdata.evaluate`, and write it to files.

    Args:
        planners: the rows.
        problems: the problems.
        baseline: name of the row whose expansions count as 1; by default mapdata's A*.
        csv: file of the table, or None.
        json: file of the table as a list of rows, or None.
        figure: file of a picture that shows cost ratio against expansions, or None. It is of the
            hard problems if there are any.

    Raises:
        ValueError: what `mapdata.evaluate` refuses.
        OSError: a file cannot be written.
    """
    from mapdata.evaluation import evaluate, to_text

    table = evaluate(planners, problems, baseline=baseline, progress=True)
    print(f"{problems.description}; {problems.movement}; set {problems.content_hash[:12]}\n")
    print(to_text(table))
    write_table(table, csv, json)
    if figure is not None:
        from matplotlib.figure import Figure

        from mapdata.plotting import plot_planners, write_figure

        canvas = Figure(figsize=(7, 6), layout="constrained")
        subset = "hard" if problems.hard.any() else "all"
        plot_planners(table, canvas.add_subplot(), subset=subset)
        write_figure(canvas, figure)


def own_planner(reference: str, flag: str) -> Callable[[Movement], Planner]:
    """Return a function that gives the planner of MODULE:NAME for a movement.

    Args:
        reference: MODULE:NAME; the module may be a file in the working folder. NAME is a planner,
            or a class or function that takes a movement and returns one.
        flag: the flag that the reference was given for, for messages.

    Raises:
        ValueError: there is no such module or name. The returned function raises it if what it
            gets has no name or no method ``plan``.
    """
    module_name, separator, name = reference.partition(":")
    if not (separator and name.isidentifier()):
        raise ValueError(
            f"{flag}: got {reference!r}, expected MODULE:NAME, as in my_module:planner"
        )
    module = import_named(module_name, flag)
    if not hasattr(module, name):
        hint = did_you_mean(name, vars(module))
        raise ValueError(f"{flag}: the module {module_name!r} has no {name!r}{hint}")
    named = getattr(module, name)
    makes_planner = isinstance(named, type) or not hasattr(named, "plan")

    def planner_for(movement: Movement) -> Planner:
        planner = named(movement) if makes_planner and callable(named) else named
        if not (hasattr(planner, "plan") and isinstance(getattr(planner, "name", None), str)):
            raise ValueError(
                f"{flag}: {reference} is no planner: expected an object with a text 'name' and a "
                f"method 'plan(grid, start, goal)', got {type(planner).__name__}"
            )
        return planner  # type: ignore[no-any-return]

    return planner_for
