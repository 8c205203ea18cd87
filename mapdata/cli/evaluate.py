"""The verb ``evaluate``, and the comparison that it shares with the scripts of models and pages."""

from __future__ import annotations

import inspect
import math
import re
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
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

SHORT_TABLE = (
    "A*",
    "weighted A* (2)",
    "guided search, no network",
    "A* with the exact goal field",
    "limit",
    "A* on mean cost",
)
"""The classical planners that `mapdata evaluate` shows without ``--full``, as far as they exist."""

SHORT_COLUMNS = ("success", "opt", "cost_ratio", "expansion_ratio", "ms")
"""The columns that it prints without ``--full``."""


def evaluate_command(
    problems: list[str],
    *,
    suite: str | None = None,
    planner: list[str] | None = None,
    full: bool = False,
    seed: int | None = None,
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
      mapdata evaluate dungeon --seed 4711 --planner ada:Planner --planner bob:Planner
      mapdata evaluate data/site --split train --per-map 100 --radius 0.3
      mapdata evaluate --suite carry-over-1 --planner my_module:MyPlanner --json mine.json

    Args:
        problems: a file that ProblemSet.save wrote, or problems of others as .scen, .npz or .npy;
            or datasets, of whose test splits each map gives a random problem; or a preset that
            'mapdata list' describes, of which new maps give one each; with --suite, names of its
            parts (default: all)
        suite: a frozen suite, carry-over-1, whose tables can be compared with those of others; see
            docs/suite.md
        planner: MODULE:NAME of your own planner; may be repeated. The module may be a file in the
            working folder. NAME is a planner, or a class or function that returns one; it gets a
            mapdata.Movement if it takes an argument
        full: show all classical planners and all columns, in place of the few to compare with first
        seed: 64-bit seed of the maps and problems of a preset (default: 77), or of the problems on
            a dataset (default: that of the dataset); a test set that nobody knows has another one
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
    from mapdata.evaluation import SUITE_MOVEMENT, classical, evaluate_suite, suite_to_text
    from mapdata.generators import PRESETS
    from mapdata.problems.problem_set import DEFAULT_PROBLEMS

    for file in (json, figure):
        if file is not None:
            output_path(file)  # refuses it before the work
    if figure is not None:
        check_picture_ending(figure)
    movement = Movement(connectivity, corner_cutting, diagonal_cost)
    own = [own_planner(reference, "--planner") for reference in planner or ()]
    if suite is not None:
        chosen = {
            "--seed": seed,
            "--maps": maps,
            "--per-map": per_map != 1,
            "--split": split,
            "--radius": radius,
            "--connectivity, --corner-cutting, --diagonal-cost": movement != SUITE_MOVEMENT,
            "--figure": figure,
        }
        for flag, value in chosen.items():
            if value:
                raise ValueError(f"{flag}: has no effect on a suite, leave it out")
        with _errors_of(own):
            rows = [make_planner(movement) for make_planner in own]
            table = evaluate_suite(rows, suite, parts=problems, full=full, progress=True)
        print(suite_to_text(table))
        write_table(table, None, json)
        return
    if not problems:
        raise ValueError("expected PROBLEMS: a file, datasets, a preset, or --suite NAME")
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
    problem_set = load_problems(root, preset, seed, maps, movement=movement, **options)
    movement = problem_set.movement
    others = classical(movement, terrain=problem_set.terrain is not None)
    shown = others if full else [row for row in others if row.name in SHORT_TABLE]
    with _errors_of(own):
        # One's own planners come first, so that their errors do.
        own_rows = [make_planner(movement) for make_planner in own]
        compare_planners(
            [*own_rows, *shown],
            problem_set,
            own=[row.name for row in own_rows],
            columns=None if full else SHORT_COLUMNS,
            json=json,
            figure=figure,
        )
    if not full:
        print(f"\n--full shows {len(others) - len(shown)} more classical planners, and all columns")


@contextmanager
def _errors_of(own: Sequence[object]) -> Iterator[None]:
    """Say in one line what the code of a user raised, below the lines where it did.

    Args:
        own: the planners of a user; without any, errors stay as they are.
    """
    try:
        yield
    except (Exception, SystemExit) as error:  # the code of a user may raise anything
        if not own:
            raise
        frames = _frames_outside_mapdata(error)
        notes = "".join(f" ({note})" for note in getattr(error, "__notes__", ()))
        if frames:  # It shows where in the user's own code the error was raised.
            print(frames, end="", file=sys.stderr)
            raise ValueError(f"{type(error).__name__}: {error}{notes}") from error
        # A TypeError is of what the user's code is or returned, and a note names the planner.
        if isinstance(error, TypeError) or notes:
            raise ValueError(f"{error}{notes}") from error
        raise


def compare_planners(
    planners: Sequence[Planner],
    problems: ProblemSet,
    *,
    own: Sequence[str] = (),
    columns: Sequence[str] | None = None,
    baseline: str | None = None,
    csv: str | None = None,
    json: str | None = None,
    figure: str | None = None,
) -> None:
    """Print the table of `mapdata.evaluate`, and write it to files.

    Args:
        planners: the rows.
        problems: the problems.
        own: names of the rows to look at: the figure shows them in colour, and below the table
            there is a line for each of them, which says how many paths were refused, and why.
        columns: those to print, as in `mapdata.evaluation.to_text`; the files have all.
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
    from mapdata.evaluation.suite import COUNTED

    with warnings.catch_warnings():
        for name in own:  # The line below the table says it, and how many paths were refused.
            warnings.filterwarnings("ignore", f"{re.escape(name)}: none of its paths solves")
        table = evaluate(planners, problems, baseline=baseline, progress=True)
    print(f"{problems.description}; {problems.movement}; set {problems.content_hash[:12]}\n")
    print(to_text(table, columns))
    own_rows = table[table["planner"].isin(own) & (table["subset"] == "all")].to_dict("records")
    if own_rows:
        print()
    for row in own_rows:
        print(f"{row['planner']}: {_outcome(row)}")
    unchecked = [row.name for row in planners if row.name in own and type(row) not in COUNTED]
    if unchecked:
        print(f"the expansions of {', '.join(unchecked)} are what the planner states, unchecked")
    write_table(table, csv, json)
    if figure is not None:
        from mapdata.plotting import plot_planners, write_figure

        subset = "hard" if problems.hard.any() else "all"
        axes = plot_planners(table, subset=subset, own=own)
        write_figure(axes.figure, figure)  # type: ignore[arg-type]


def _outcome(row: Mapping[Any, Any]) -> str:
    """Return what became of the paths of a planner, from its row of all problems, as text."""
    count = row["n"]
    solved = round(row["success"] * count)
    missing = count - solved - row["refused"]
    parts = []
    if row["refused"]:
        parts.append(
            f"{row['refused']} of {count} paths refused, the first of {row['first_refused']}"
        )
    if missing:
        parts.append(f"no path for {missing} of {count} problems")
    if parts:
        return "; ".join(parts)
    return "its only problem solved" if count == 1 else f"all {count} problems solved"


def _frames_outside_mapdata(error: BaseException) -> str:
    """Return the part of a traceback from the first function that is not of mapdata, as text.

    It is empty if mapdata itself raised the error.
    """
    frame = error.__traceback__
    while frame is not None:
        module = str(frame.tb_frame.f_globals.get("__name__"))
        if module.partition(".")[0] != "mapdata":
            break
        frame = frame.tb_next
    return "".join(traceback.format_tb(frame))


def own_planner(reference: str, flag: str) -> Callable[[Movement], Planner]:
    """Return a function that gives the planner of MODULE:NAME for a movement.

    Args:
        reference: MODULE:NAME; the module may be a file in the working folder. NAME is a planner,
            or a class or function that returns one. It gets the movement if it takes an argument.
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
        planner = named
        if makes_planner and callable(named):
            try:
                signature = inspect.signature(named)
                arguments = (movement,) if signature.parameters else ()
                signature.bind(*arguments)
            except (TypeError, ValueError) as error:
                raise ValueError(
                    f"{flag}: {reference} makes no planner: {error}; expected a planner, or a "
                    "class or function that returns one and gets nothing or a mapdata.Movement"
                ) from error
            planner = named(*arguments)
        if not (hasattr(planner, "plan") and isinstance(getattr(planner, "name", None), str)):
            raise ValueError(
                f"{flag}: {reference} is no planner: expected an object with a text 'name' and a "
                f"method 'plan(grid, start, goal)', got {type(planner).__name__}"
            )
        return planner  # type: ignore[no-any-return]

    return planner_for
