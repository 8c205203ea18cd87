"""Compare planners on named sets of problems, and write the tables of the documentation.

    python docs/planner_tables.py                           all planners on all sets: half an hour
    python docs/planner_tables.py --set dungeon-hard-1000   on this set; may be repeated
    python docs/planner_tables.py --set dungeon-hard-1000 --add my_module:planner
    python docs/planner_tables.py --no-network              the search without a network alone, and
                                                            what the networks add to it
    python docs/planner_tables.py --sample FILE             the sample of models/path_predictor.py
                                                            alone, with its weights in FILE
    python docs/planner_tables.py --pages                   the tables again, measuring nothing
    python docs/planner_tables.py --transfer                small networks of one family each,
                                                            and of all but one: an hour
    python docs/planner_tables.py --file FILE --weights FILE --baseline ROW    problems of others

Each set is a recipe: one problem on each map of seed 77, until so many are hard. All figures are
kept in docs/planner_results.json, set by set, so that a run that is stopped loses one set at most;
planner_results.py says what stands in it. The tables between the marks of docs/planners.md, and
those of --transfer in docs/which_problems.md, are made from it.

`--add` measures a planner of your own alone and puts its row beside the others. NAME of
MODULE:NAME is a planner, or a class or function that takes a `mapdata.Movement` and returns one.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
import time
import warnings
from collections.abc import Callable, Container, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytorch_lightning as pl
import torch
from planner_results import Results, this_run

from mapdata import MapDataModule, MapGenerator, MapSpec, Maze, Movement, ProblemSet, evaluate
from mapdata.arrays import Bytes
from mapdata.cli import load_problems, own_planner
from mapdata.evaluation import (
    TIMES,
    BatchPlanner,
    GuidedSearch,
    LandmarkAstar,
    Plan,
    Planner,
    classical,
)
from mapdata.limits import Cell
from mapdata.models import MovePredictor, NeuralAstar, PathPredictor, fast_precision
from mapdata.models.evaluate import SHIPPED, load_weights
from mapdata.models.pretrained.mixed_batches import MixedBatches
from mapdata.models.pretrained.path_predictor import TRAINING_FIELDS
from mapdata.movement import NEURAL_ASTAR
from mapdata.shards import write_output

DOCS = Path(__file__).parent
BATCH = 64
TIMED = 100
"""Number of problems of a set whose times are measured: a time needs fewer than an Hmean."""
PREPARED_COPIES = 2000
"""Number of searches on a map whose landmarks are placed once, when ms_prepared is measured."""
SEED = 77
LANDMARKS = "A* with 8 landmarks"
WEIGHTED = "weighted A* (2)"
GOAL_FIELD = "A* with the exact goal field"
JUMP_POINTS = "jump point search"
SEARCH = "path_predictor (search)"
NO_NETWORK = "guided search, no network"
SAMPLE = "sample path predictor"
UNTRAINED = "sample path predictor, untrained"
INEXACT = ("weighted", "greedy")
"""How the names of classical planners without optimal paths begin."""

WIDE_ROOMS = MapSpec(
    (256, 256), rooms=(60, 120), room_rows=(8, 30), room_columns=(8, 30), passage_width=(1, 4)
)
GENERATORS: dict[str, MapGenerator] = {
    **{name: MapGenerator.preset(name) for name in ("paper", "dungeon", "narrow", "maze")},
    "loops": Maze(corridor=2, reopened=0.1),
    **{name: MapGenerator.preset(name) for name in ("cave", "forest", "noise", "dungeon128")},
    "dungeon256": WIDE_ROOMS,
}
"""The generators by name, in the order of the tables."""

RULES = {
    "": Movement(8),
    "-cut": Movement(8, corner_cutting=True),
    "-4": Movement(4),
}
"""The rules of movement, by what the names of sets have of them."""


def set_of(generator: str, ending: str, hard: int) -> str:
    """Return the name of the set of so many hard problems of a generator under a rule."""
    # All problems of mazes are hard. And maze-hard is the name of a format, of a set of others.
    return f"mazes{ending}-{hard}" if generator == "maze" else f"{generator}{ending}-hard-{hard}"


def sets_of(ending: str) -> dict[str, tuple[str, str]]:
    """Return the sets of the tables under a rule: by name the generator and the rule."""
    # The sets of the first table have the most problems.
    counts = {
        name: 1000 if not ending or name in ("paper", "dungeon") else 300 for name in GENERATORS
    }
    return {set_of(name, ending, counts[name]): (name, ending) for name in GENERATORS}


SETS = {name: drawn for ending in RULES for name, drawn in sets_of(ending).items()}
"""The sets by name, in the order of the tables: the name of a generator, and that of a rule."""

FIRST_SETS = [name for name, (_, ending) in SETS.items() if not ending]
"""The sets of the first table of planners.md: 8 moves that cut no corner."""

TRANSFER_SETS = {
    family: set_of(family, "", 1000 if family == "dungeon" else 300)
    for family in ("dungeon", "maze", "cave", "forest", "noise")
}
"""The sets of the table of transfer, by their families."""

COLUMNS = {
    "ms": "ms alone",
    "ms_batched": "ms in batches",
    "prepared_ratio": "prepared",
    "look_ratio": "looks",
    "success": "success",
    "expansion_ratio": "expansions",
    "opt": "Opt",
    "cost_ratio": "cost",
    "p_exp": "Exp",
    "hmean": "Hmean",
}
"""Columns of the tables, and their headings."""

SHORT = ("ms_batched", "expansion_ratio", "opt", "p_exp", "hmean")
"""Columns of the tables of planners.md."""

TIME_INTERVALS = [f"{name}_{end}" for name in TIMES for end in ("low", "high")]
"""Columns of `evaluate` with the intervals of its own times, which the tables do not show."""

WITH_INTERVAL = ("expansion_ratio", "opt", "cost_ratio", "p_exp", "hmean")


# --- measuring ----------------------------------------------------------------------------------


def problems_of(name: str) -> ProblemSet:
    """Return a set of `SETS` or `TRANSFER_SETS`; its name ends with the number of hard problems."""
    generator, ending = drawn_from(name)
    _, _, hard = name.rpartition("-")
    return ProblemSet.sample(
        GENERATORS[generator], SEED, until_hard=int(hard), movement=RULES[ending]
    )


def drawn_from(name: str) -> tuple[str, str]:
    """Return the names of the generator and of the rule of a set."""
    families = {transfer_set: family for family, transfer_set in TRANSFER_SETS.items()}
    return SETS[name] if name in SETS else (families[name], "")


def hard_of(problems: ProblemSet) -> ProblemSet:
    """Return the hard problems alone."""
    hard = problems.hard
    return ProblemSet(
        problems.grids[hard], problems.starts[hard], problems.goals[hard], problems.movement
    )


class InBatches:
    """The answers of a planner to all problems of a set, which it gave in batches of 64.

    `evaluate` asks for one plan after another, which takes a network three times as long.
    """

    def __init__(self, planner: BatchPlanner, problems: ProblemSet) -> None:
        """Solve the problems."""
        self.name = planner.name
        self.plans: dict[tuple[bytes, Cell, Cell], Plan] = {}
        for first in range(0, len(problems), BATCH):
            batch = slice(first, first + BATCH)
            grids, starts, goals = (
                problems.grids[batch],
                problems.starts[batch],
                problems.goals[batch],
            )
            plans = planner.plan_batch(grids.copy(), starts.copy(), goals.copy())
            for grid, start, goal, plan in zip(grids, starts, goals, plans, strict=True):
                self.plans[grid.tobytes(), tuple(start.tolist()), tuple(goal.tolist())] = plan

    def plan(self, grid: Bytes, start: Cell, goal: Cell) -> Plan:
        """Return the answer to a problem of the set."""
        return self.plans[grid.tobytes(), start, goal]


def processor_ms(solve: Callable[[slice], object], batches: list[slice]) -> float:
    """Return the milliseconds of processor time a problem, after a first call that is not timed.

    On a machine that others use, too, time on the clock says more about them.
    """
    solve(batches[0])
    began = time.process_time()
    for batch in batches:
        solve(batch)
    seconds = time.process_time() - began
    count: int = sum(batch.stop - batch.start for batch in batches)
    return 1000 * seconds / count


def times_of(planner: Planner, problems: ProblemSet) -> dict[str, float]:
    """Return the columns ms and ms_batched of `evaluate`, and ms_prepared, as processor time."""

    def solve_one(batch: slice) -> Plan:
        start, goal = (
            tuple(cells[batch.start].tolist()) for cells in (problems.starts, problems.goals)
        )
        return planner.plan(problems.grids[batch.start].copy(), start, goal)

    def solve_batch(batch: slice) -> list[Plan]:
        assert isinstance(planner, BatchPlanner)
        grids, starts, goals = problems.grids[batch], problems.starts[batch], problems.goals[batch]
        return planner.plan_batch(grids.copy(), starts.copy(), goals.copy())

    def solve_prepared(batch: slice) -> list[Plan]:
        """Solve the same problem many times on one map, whose landmarks are placed once."""
        assert isinstance(planner, LandmarkAstar)
        copies = np.full(PREPARED_COPIES, batch.start)
        grid, starts, goals = problems.grids[batch.start], problems.starts, problems.goals
        return planner.plan_batch(grid.copy(), starts[copies], goals[copies])

    count = min(TIMED, len(problems))
    alone = [slice(k, k + 1) for k in range(count)]
    batches = [slice(k, min(k + BATCH, count)) for k in range(0, count, BATCH)]
    is_batched = isinstance(planner, BatchPlanner)
    ms = processor_ms(solve_one, alone)
    ms_batched = processor_ms(solve_batch, batches) if is_batched else math.nan
    ms_prepared = math.nan
    if isinstance(planner, LandmarkAstar):
        # The copies take one preparation and as many searches.
        ms_prepared = processor_ms(solve_prepared, alone) / PREPARED_COPIES
    return {"ms": ms, "ms_batched": ms_batched, "ms_prepared": ms_prepared}


def measured(
    planners: Sequence[Planner],
    problems: ProblemSet,
    subset: str = "hard",
    baseline: str | None = None,
) -> pd.DataFrame:
    """Return the rows of `evaluate` for all problems, with times of the first `TIMED` alone."""
    answers = [
        InBatches(planner, problems) if isinstance(planner, BatchPlanner) else planner
        for planner in planners
    ]
    has_row = NO_NETWORK in [planner.name for planner in planners]
    table = evaluate(
        answers, problems, baseline=baseline, difference_from=NO_NETWORK if has_row else None
    )
    table = table[table["subset"] == subset].set_index("planner")
    for planner in planners:
        for column, ms in times_of(planner, problems).items():
            table.loc[planner.name, column] = ms
    # These are intervals of other times than those above.
    return table.reset_index().drop(columns=TIME_INTERVALS)


def add(
    results: Results,
    name: str,
    table: pd.DataFrame,
    run: dict[str, Any],
    only: Sequence[str] | None = None,
    **more: Any,
) -> None:
    """Add the rows of a table of `measured`, and the differences of those that are not classical.

    Args:
        results: the results.
        name: of the set.
        table: of `measured`.
        run: what the results say of the command and the machine.
        only: the planners whose rows are added; None for all.
        more: columns that are added to all rows.
    """
    if "opt_difference" in table:
        names = [planner.name for planner in classical(NEURAL_ASTAR)]  # those of any rule
        is_classical = table["planner"].isin(names)
        results.add_differences(name, table[~is_classical], run)
        table = table.drop(columns=[column for column in table if "_difference" in str(column)])
    if only is not None:
        table = table[table["planner"].isin(only)]
    results.add_rows(name, table, run, **more)


def measure(
    results: Results,
    name: str,
    planners: Sequence[Planner],
    command: str,
    only: Sequence[str] | None = None,
) -> None:
    """Measure planners on the hard problems of a set, and add them to the results, as `add`."""
    problems = problems_of(name)
    generator = json.loads(GENERATORS[drawn_from(name)[0]].to_json())
    results.add_set(
        name, problems, seed=SEED, until_hard=int(problems.hard.sum()), generator=generator
    )
    table = measured(planners, hard_of(problems))
    add(results, name, table, this_run(command), only)


def all_planners(movement: Movement) -> list[Planner]:
    """Return the classical planners and the search with the pretrained weights for a movement."""
    model = PathPredictor.pretrained(SHIPPED[movement])
    return [*classical(movement), GuidedSearch(SEARCH, movement, model.predict)]


def guided_planners(movement: Movement) -> list[Planner]:
    """Return the search without a network and with the pretrained weights for a movement."""
    return [one for one in all_planners(movement) if one.name in (NO_NETWORK, SEARCH)]


def measure_sample(
    results: Results, path: Path, file: str, names: Sequence[str], command: str
) -> None:
    """Measure the sample path predictor, which moves as the sets of the first table do.

    Untrained it is the same search, with the same trust, without a network.
    """
    model = MovePredictor.load_from_checkpoint(file, map_location="cpu")
    movement = RULES[""]
    without = [one for one in classical(movement) if one.name == NO_NETWORK]
    planners = [*without, MovePredictor().planner(UNTRAINED), model.planner(SAMPLE)]
    for name in names:
        measure(results, name, planners, command, [UNTRAINED, SAMPLE])
        results.write(path)


def measure_file(
    results: Results,
    file: str,
    weights: Sequence[str],
    baseline: str | None,
    command: str,
    only: Sequence[str] | None = None,
) -> None:
    """Measure all problems of a foreign file, with given networks beside the classical planners.

    With ``only``, the rows of these planners alone are measured.
    """
    problems = load_problems([file], None, 0 if file.endswith(".npz") else None, None)
    name = Path(file).name
    rows: list[Planner] = list(classical(problems.movement))
    for path in weights:
        model = load_weights(path)
        if isinstance(model, NeuralAstar):
            rows.append(model)
        else:
            rows.append(GuidedSearch(SEARCH, model.movement, model.predict))
    if only is not None:
        rows = [one for one in rows if one.name in (*only, baseline)]
    results.add_set(name, problems, description=problems.description.replace(file, name))
    table = measured(rows, problems, "all", baseline)
    add(results, name, table, this_run(command), only, baseline=baseline)


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


def trainings() -> dict[str, list[str]]:
    """Return the families of each training of the table of transfer."""
    families = {name: [name] for name in ("paper", *TRANSFER_SETS)}
    families["all five"] = list(TRANSFER_SETS)
    families["all but maze"] = [name for name in TRANSFER_SETS if name != "maze"]
    families["all but cave"] = [name for name in TRANSFER_SETS if name != "cave"]
    return families


def transfer(results: Results, path: Path, steps: int, command: str) -> None:
    """Train networks on a family each, on all, and on all but one, and measure them on all sets,
    beside the same search without a network.
    """
    without = [one for one in classical() if one.name == NO_NETWORK]
    for training, names in trainings().items():
        model = trained_on(names, steps)
        search = GuidedSearch(trained_name(training), model.movement, model.predict)
        for name in TRANSFER_SETS.values():
            measure(results, name, [*without, search], command, [search.name])
        results.write(path)


def trained_name(training: str) -> str:
    """Return the planner's name in the results of a training of the table of transfer."""
    return f"small network trained on {training}"


# --- tables -------------------------------------------------------------------------------------


def markdown(rows: Sequence[Sequence[str]]) -> str:
    """Return a table whose first row is its head."""
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|---" * len(rows[0]) + "|", *lines[1:]])


def cell(number: float | None, digits: int = 3) -> str:
    """Return a number of a table, or a dash where there is none."""
    return "-" if number is None else f"{number:.{digits}f}"


def is_main_row(planner: str) -> bool:
    """Return whether a row is of the tables of sets, not of that of transfer."""
    return not planner.startswith(trained_name(""))


def with_half_width(row: dict[str, Any], metric: str) -> str:
    """Return a metric of a row, followed by half the width of its interval where it has one."""
    low, high = row[f"{metric}_low"], row[f"{metric}_high"]
    if low is None:
        return cell(row[metric])
    return f"{cell(row[metric])} ±{(high - low) / 2:.3f}"


def table_of(
    results: Results,
    name: str,
    columns: Sequence[str] = tuple(COLUMNS),
    left_out: Container[str] = (),
) -> str:
    """Return the table of a set, without the rows of some planners."""
    rows = [["planner", *(COLUMNS[column] for column in columns)]]
    for planner, row in results.rows_of(name).items():
        if is_main_row(planner) and planner not in left_out:
            cells = [
                with_half_width(row, column) if column in WITH_INTERVAL else cell(row[column])
                for column in columns
            ]
            rows.append([planner, *cells])
    return markdown(rows)


def short_table(results: Results, name: str) -> str:
    """Return the table of a set for planners.md: of the classical rows only the best ones."""
    rows = results.rows_of(name)
    inexact = [planner for planner in rows if planner.startswith(INEXACT)]
    best = max(inexact, key=lambda planner: float(rows[planner]["hmean"]), default=None)
    left_out = {"BFS", "Dijkstra", "A*", "limit", *inexact} - {best}
    return table_of(results, name, SHORT, left_out)


def zero_shot_name(map_name: str, size: int, ending: str) -> str:
    """Return the name of the set of problems on windows of a map, which zero_shot.py draws."""
    return f"{map_name}-{size}{ending}-windows"


def summary(results: Results, names: Iterable[str]) -> str:
    """Return a table of one row for each set: what paths cost, and how long planners take."""
    rows = [
        [
            "set",
            "A* ms",
            "JPS ms",
            "goal field ms",
            "8 landmarks ms",
            "and their preparation",
            "weighted A* ms",
            "weighted A* cost ratio",
            "no network cost ratio",
            "no network Opt",
            "network ms",
            "network cost ratio",
            "network Opt",
        ]
    ]
    for name in names:
        planners = results.rows_of(name)
        if SEARCH not in planners or LANDMARKS not in planners:
            continue
        search, weighted, landmarks = (planners[row] for row in (SEARCH, WEIGHTED, LANDMARKS))
        without = planners.get(NO_NETWORK)
        jump_ms = planners[JUMP_POINTS]["ms_batched"] if JUMP_POINTS in planners else None
        rows.append(
            [
                name,
                cell(planners["A*"]["ms_batched"]),
                cell(jump_ms),
                cell(planners[GOAL_FIELD]["ms_batched"]),
                cell(landmarks["ms_prepared"]),
                cell(landmarks["ms_batched"] - landmarks["ms_prepared"]),
                cell(weighted["ms_batched"]),
                cell(weighted["cost_ratio"]),
                cell(without["cost_ratio"] if without else None),
                with_half_width(without, "opt") if without else "-",
                cell(search["ms_batched"], 1),
                cell(search["cost_ratio"]),
                with_half_width(search, "opt"),
            ]
        )
    return markdown(rows)


def with_ends(row: dict[str, Any] | None, metric: str, digits: int = 3) -> str:
    """Return a difference of a row with the ends of its interval, or a dash without a row."""
    if row is None:
        return "-"
    ends = [f"{row[f'{metric}_difference{end}']:+.{digits}f}" for end in ("", "_low", "_high")]
    return f"{ends[0]} [{ends[1]}, {ends[2]}]"


def table_of_differences(results: Results, names: Iterable[str]) -> str:
    """Return a table of one row for each set: the search with and without a network."""
    rows = [
        [
            "set",
            "no network Opt",
            "network Opt",
            "Opt: difference",
            "no network expansions",
            "network expansions",
            "expansions: difference",
        ]
    ]
    for name in names:
        difference = results.difference_of(name, SEARCH)
        planners = results.rows_of(name)
        if difference is None or not {SEARCH, NO_NETWORK} <= set(planners):
            continue
        row = [name]
        for metric in ("opt", "expansion_ratio"):
            row += [cell(planners[one][metric]) for one in (NO_NETWORK, SEARCH)]
            row.append(with_ends(difference, metric))
        rows.append(row)
    return markdown(rows)


def table_of_sample(results: Results) -> str:
    """Return the sample path predictor beside others that use its search, set by set."""
    planners = (NO_NETWORK, UNTRAINED, SAMPLE, SEARCH)
    heads = [
        f"{one} {metric}"
        for metric in ("Opt", "expansions")
        for one in ("no network", "untrained", "sample", "pretrained")
    ]
    rows = [["set", *heads]]
    for name in FIRST_SETS:
        by_planner = results.rows_of(name)
        if {*planners} <= {*by_planner}:
            cells = [
                with_half_width(by_planner[planner], metric)
                for metric in ("opt", "expansion_ratio")
                for planner in planners
            ]
            rows.append([name, *cells])
    return markdown(rows)


def tables_of_transfer(results: Results) -> dict[str, str]:
    """Return what networks that were trained on some families add, on the sets of all families.

    One table has the share of optimal paths, the other the expansions. The first row of each is
    that of no network; the others are differences from it on the same problems.
    """
    tables = {}
    for metric, words in (("opt", "optimal"), ("expansion_ratio", "expansions")):
        without = [results.rows_of(name).get(NO_NETWORK) for name in TRANSFER_SETS.values()]
        rows = [
            ["trained on", *TRANSFER_SETS],
            [f"no network: {words}", *(cell(row[metric] if row else None, 2) for row in without)],
        ]
        for training in trainings():
            differences = [
                results.difference_of(name, trained_name(training))
                for name in TRANSFER_SETS.values()
            ]
            rows.append([training, *(with_ends(row, metric, 2) for row in differences)])
        tables[f"transfer-{metric}"] = markdown(rows)
    return tables


def filled(page: str, tables: dict[str, str]) -> str:
    """Return a page with its tables anew: each stands between two comments that name it."""
    for name, table in tables.items():
        mark = re.escape(f"<!-- table {name} -->")
        page = re.sub(
            f"({mark}\n).*?(<!-- end -->)",
            lambda match: f"{match[1]}\n{table}\n\n{match[2]}",  # noqa: B023
            page,
            flags=re.DOTALL,
        )
    return page


def write_pages(results: Results, folder: Path) -> None:
    """Write the tables of planners.md and which_problems.md of a folder."""
    windows = [name for name in results.sets if re.search(r"(?<!-cut)-windows$", name)]
    tables = {
        "summary": summary(results, [name for name in FIRST_SETS if name in results.sets]),
        "differences": table_of_differences(results, FIRST_SETS),
        "sample": table_of_sample(results),
        "zero-shot": summary(results, windows),
        "zero-shot-differences": table_of_differences(results, windows),
    }
    for name in results.sets:
        if name not in SETS:
            tables[name] = short_table(results, name)
    for name, its_tables in (
        ("planners.md", tables),
        ("which_problems.md", tables_of_transfer(results)),
    ):
        page = folder / name
        write_output(page, filled(page.read_text(encoding="utf-8"), its_tables).encode())


def words_of(arguments: Sequence[str]) -> list[str]:
    """Return arguments as the results have them: without --folder, and files by their names."""
    words = [*arguments]
    if "--folder" in words:
        place = words.index("--folder")
        del words[place : place + 2]
    return [Path(word).name if "/" in word else word for word in words]


def measure_what_is_asked(
    options: argparse.Namespace, results: Results, path: Path, command: str
) -> None:
    """Measure what the command line says, and add it to the results."""
    if options.transfer and options.no_network:
        for name in TRANSFER_SETS.values():
            without = [one for one in classical() if one.name == NO_NETWORK]
            measure(results, name, without, command)
    elif options.transfer:
        transfer(results, path, options.steps, command)
    elif options.sample:
        measure_sample(results, path, options.sample, options.sets or FIRST_SETS, command)
    elif options.file:
        only = [NO_NETWORK] if options.no_network else None
        measure_file(results, options.file, options.weights, options.baseline, command, only)
    else:
        own = [own_planner(reference, "--add") for reference in options.add]
        for name in options.sets or SETS:
            movement = RULES[SETS[name][1]]
            if options.no_network:
                measure(results, name, guided_planners(movement), command, [NO_NETWORK])
            else:
                rows = [make(movement) for make in own] or all_planners(movement)
                measure(results, name, rows, command)
            results.write(path)
            print(f"{name}\n\n{table_of(results, name)}\n", flush=True)


def main(arguments: list[str] | None = None) -> None:
    """Measure what the command line says, and write the results and the tables of the pages."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--set", action="append", choices=SETS, metavar="NAME", dest="sets")
    parser.add_argument(
        "--add",
        action="append",
        default=[],
        metavar="MODULE:NAME",
        help="measure this planner alone; may be repeated",
    )
    parser.add_argument("--no-network", action="store_true", help="measure this row alone")
    parser.add_argument("--sample", metavar="FILE", help="measure the sample with these weights")
    parser.add_argument("--pages", action="store_true", help="measure nothing")
    parser.add_argument("--transfer", action="store_true", help="the table of transfer")
    parser.add_argument("--steps", type=int, default=2000, help="of each of its trainings")
    parser.add_argument("--file", help="problems of others: a .scen, or an .npz")
    parser.add_argument("--weights", action="append", default=[], help="networks for --file")
    parser.add_argument("--baseline", help="row of --file whose expansions count as 1")
    parser.add_argument("--folder", type=Path, default=DOCS, help="of the results and the pages")
    options = parser.parse_args(arguments)
    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    path = options.folder / "planner_results.json"
    results = Results.read(path)
    command = " ".join(["python docs/planner_tables.py", *words_of(arguments or sys.argv[1:])])
    if not options.pages:
        measure_what_is_asked(options, results, path, command)
    results.write(path)
    write_pages(results, options.folder)


if __name__ == "__main__":
    main()
