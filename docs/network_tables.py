"""Compare two ways from a network to a planner: python docs/network_tables.py FOLDER.

The same problems are planned by scores of moves (`GuidedSearch`) and by costs of cells
(`CostPlanner`). The first planner of costs asks the same network as the planner of moves,
`PathPredictor.pretrained()`: a cell costs 1 where the predicted way from the start over the cell to
the goal is hardly longer than the predicted shortest one, and 9 elsewhere. The second asks
`Heatmap.pretrained()`, which predicts how probable it is that a cell lies on a shortest path: a
cell costs 1 from .2 on, and 9 below. The thresholds and the 9 have the best Hmean on 60 hard
problems of dungeon and of cave, seed 31, among twelve choices for the first network and four for
the second.

The sets are three of docs/planner_results.json. FOLDER has the map of the last one, warehouse.yaml
of Nav2. The rows go to docs/network_results.json, and their table to docs/howto/planner.md. With
``--pages`` the table is made again, and nothing is measured.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path

import numpy as np
import torch
from planner_results import Results, this_run
from planner_tables import (
    DOCS,
    RULES,
    add,
    filled,
    guided_planners,
    hard_of,
    markdown,
    measured,
    problems_of,
    with_half_width,
    words_of,
    zero_shot_name,
)
from zero_shot import grids_of, hard_problems

from mapdata import ProblemSet
from mapdata.arrays import Bytes, Floats, Ints
from mapdata.evaluation import CostPlanner, Planner
from mapdata.models import Heatmap, PathPredictor
from mapdata.shards import write_output

FAMILIES = ("dungeon-hard-1000", "cave-hard-1000")
ROBOT_MAP = "warehouse"
MOVEMENT = RULES[""]


def costs_by_predictor(grids: Bytes, starts: Ints, goals: Ints) -> Floats:
    """Return costs of cells, (B, H, W), by the costs to go of the path predictor."""
    model = PathPredictor.pretrained()
    _, to_goal = model.predict(grids, goals)
    _, to_start = model.predict(grids, starts)
    problems = np.arange(len(grids))
    shortest = np.maximum(to_goal[(problems, *starts.T)], to_start[(problems, *goals.T)])  # (B,)
    is_near = to_goal + to_start <= 1.05 * shortest[:, None, None] + 0.5
    return np.where(is_near, 1.0, 9.0)


def costs_by_heat_map(grids: Bytes, starts: Ints, goals: Ints) -> Floats:
    """Return costs of cells, (B, H, W), by the probability that they lie on a shortest path."""
    model = Heatmap.pretrained()
    with model.inference():
        scores = model(*model.tensors(grids[:, None], starts, goals))[:, 1]
    return np.where(scores.sigmoid().float().numpy() >= 0.2, 1.0, 9.0)


def planners() -> list[Planner]:
    """Return the rows of the table."""
    return [
        *guided_planners(MOVEMENT),
        CostPlanner("costs by the path predictor", MOVEMENT, costs_by_predictor),
        CostPlanner("costs by the heat map", MOVEMENT, costs_by_heat_map),
    ]


def sets_of(folder: Path) -> dict[str, ProblemSet]:
    """Return the sets by name, hard problems alone."""
    sets = {name: hard_of(problems_of(name)) for name in FAMILIES}
    windows = hard_problems(ROBOT_MAP, grids_of(folder)[ROBOT_MAP], MOVEMENT, 64, 300)
    assert windows is not None
    return sets | {zero_shot_name(ROBOT_MAP, 64, ""): windows}


def table_of(results: Results) -> str:
    """Return the table of the page."""
    rows = [["planner", *(f"{name}: Opt | expansions" for name in results.sets)]]
    for planner in results.rows_of(next(iter(results.sets))):
        row = [planner]
        for name in results.sets:
            measured_row = results.rows_of(name)[planner]
            row.append(with_half_width(measured_row, "opt"))
            row.append(with_half_width(measured_row, "expansion_ratio"))
        rows.append(row)
    lines = markdown(rows).splitlines()
    lines[1] = "|---" * (1 + 2 * len(results.sets)) + "|"
    return "\n".join(lines)


def write_page(results: Results, folder: Path) -> None:
    """Write the table into the page."""
    page = folder / "howto" / "planner.md"
    text = filled(page.read_text(encoding="utf-8"), {"networks": table_of(results)})
    write_output(page, text.encode())


def main(arguments: list[str] | None = None) -> None:
    """Measure what the command line says, and write the results and the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("maps", type=Path, nargs="?", metavar="FOLDER", help="of warehouse.yaml")
    parser.add_argument("--pages", action="store_true", help="measure nothing")
    parser.add_argument("--folder", type=Path, default=DOCS, help="of results and pages")
    options = parser.parse_args(arguments)
    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    path = options.folder / "network_results.json"
    results = Results.read(path)
    run = this_run(
        " ".join(["python docs/network_tables.py", *words_of(arguments or sys.argv[1:])])
    )
    for name, problems in {} if options.pages else sets_of(options.maps).items():
        results.add_set(name, problems)
        add(results, name, measured(planners(), problems), run)
        results.write(path)
    write_page(results, options.folder)
    print(table_of(results))


if __name__ == "__main__":
    main()
