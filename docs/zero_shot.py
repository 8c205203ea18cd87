"""Measure the included planners on maps of games and robots: python docs/zero_shot.py FOLDER.

FOLDER has maps of the MovingAI benchmark (.map) and of ROS (.yaml beside its picture); no network
saw any of them. Each map is cut into windows of 64 x 64 cells at random places. A window gives one
problem: a random free cell is the goal, and a random cell that reaches it and is at least 10 cells
away the start. Hard problems are collected until there are 300 of a map. Robots' maps are brought
to cells of 0.2 m first, where a cell is occupied if any of its parts is, or unknown.

The rows go to docs/planner_results.json, and the tables of the pages are made from it. With
``--add MODULE:NAME`` it is a planner of your own that is measured, and with ``--no-network`` the
search without a network, as in planner_tables.py.
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
    NO_NETWORK,
    RULES,
    add,
    all_planners,
    guided_planners,
    measured,
    table_of,
    words_of,
    write_pages,
    zero_shot_name,
)

from mapdata import Movement, ProblemSet
from mapdata.arrays import Bytes
from mapdata.cli import own_planner
from mapdata.formats import read_any
from mapdata.search import distance_field

RESOLUTION = 0.2
"""Metres per cell of the robots' maps."""

MIN_COST = 10.0
"""Least cost of a problem, in cells, as in `ProblemSet.sample`."""

MAX_WINDOWS = 20_000
"""Number of windows of a map after which the problems that were found are all."""


def grids_of(folder: Path) -> dict[str, Bytes]:
    """Return the maps of a folder and its subfolders by name: (H, W), 0 free and 1 occupied."""
    grids = {}
    for path in sorted(folder.rglob("*")):
        if path.suffix == ".map":
            grids[path.stem] = read_any(path).maps[0].grid
        elif path.suffix == ".yaml":
            maps = read_any(path, unknown="occupied", resolution=RESOLUTION, resample="any").maps
            grids[path.stem] = maps[0].grid
    return grids


def random_window(grid: Bytes, size: int, rng: np.random.Generator) -> Bytes:
    """Return a window of size x size cells, or of all cells along a side that is shorter."""
    corner = [int(rng.integers(max(side - size, 0) + 1)) for side in grid.shape]
    return grid[corner[0] : corner[0] + size, corner[1] : corner[1] + size]


def hard_problems(
    name: str, grid: Bytes, movement: Movement, size: int, count: int
) -> ProblemSet | None:
    """Return hard problems on windows of a map, at most ``count``; None where there is none."""
    rng = np.random.default_rng(0)
    windows, starts, goals = [], [], []
    for _ in range(MAX_WINDOWS):
        window = random_window(grid, size, rng)
        free = np.argwhere(window == 0)
        if not len(free):
            continue
        goal = rng.choice(free)
        far = np.argwhere(distance_field(window, goal, movement) >= MIN_COST)
        if not len(far):
            continue
        start = rng.choice(far)
        problem = ProblemSet(window[None], start[None], goal[None], movement)
        if problem.hard[0]:
            windows.append(window)
            starts.append(start)
            goals.append(goal)
        if len(windows) == count:
            break
    if not windows:
        return None
    description = f"windows of {windows[0].shape[0]} x {windows[0].shape[1]} cells of {name}"
    return ProblemSet(np.array(windows), np.array(starts), np.array(goals), movement, description)


def main(arguments: list[str] | None = None) -> None:
    """Measure what the command line says, and write the results and the pages."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("maps", type=Path, metavar="FOLDER", help="of .map and .yaml files")
    parser.add_argument("--size", type=int, default=64, help="rows and columns of a window")
    parser.add_argument("--hard", type=int, default=300, help="hard problems of a map")
    parser.add_argument("--corner-cutting", action="store_true", help="TransPath's rule")
    parser.add_argument(
        "--add",
        action="append",
        default=[],
        metavar="MODULE:NAME",
        help="measure this planner alone; may be repeated",
    )
    parser.add_argument("--no-network", action="store_true", help="measure this row alone")
    parser.add_argument("--folder", type=Path, default=DOCS, help="of results and pages")
    options = parser.parse_args(arguments)
    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    path = options.folder / "planner_results.json"
    results = Results.read(path)
    run = this_run(" ".join(["python docs/zero_shot.py", *words_of(arguments or sys.argv[1:])]))
    own = [own_planner(reference, "--add") for reference in options.add]
    ending = "-cut" if options.corner_cutting else ""
    movement = RULES[ending]
    rows = [make(movement) for make in own] or all_planners(movement)
    if options.no_network:
        rows = guided_planners(movement)
    for map_name, grid in grids_of(options.maps).items():
        problems = hard_problems(map_name, grid, movement, options.size, options.hard)
        if problems is None:
            print(f"{map_name}: no hard problem in {MAX_WINDOWS:,} windows\n")
            continue
        name = zero_shot_name(map_name, options.size, ending)
        results.add_set(name, problems)
        add(
            results,
            name,
            measured(rows, problems),
            run,
            [NO_NETWORK] if options.no_network else None,
        )
        results.write(path)
        print(f"{name}\n\n{table_of(results, name)}\n", flush=True)
    write_pages(results, options.folder)


if __name__ == "__main__":
    main()
