"""Measure TransPath's published weights beside ours: python docs/transpath.py CHECKOUT.

CHECKOUT is a copy of https://github.com/AIRI-Institute/TransPath (Kirilenko et al., AAAI 2023,
arXiv 2212.11730) with its weights and its nine maps of 64 x 64 cells. The rule is TransPath's: 8
moves, which may cut corners. On each map hard problems are drawn as zero_shot.py draws them. The
networks and searches of TransPath are those of the checkout, called as its example.ipynb calls
them; its expansions and paths are counted and checked as all others are.

The rows go to docs/planner_results.json.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

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
)
from torch import Tensor
from zero_shot import hard_problems

from mapdata import Plan, ProblemSet
from mapdata.arrays import Bytes
from mapdata.limits import Cell

NAME = "transpath-maps-cut"


@dataclass(frozen=True)
class TransPath:
    """A network of TransPath, and its search in torch.

    Attributes:
        name: its name in the table.
        network: it predicts a map in [-1, 1] of the occupied cells and the goal, or both ends.
        search: TransPath's `DifferentiableDiagAstar`.
        sees_start: whether the network sees the start, too.
    """

    name: str
    network: Any
    search: Any
    sees_start: bool

    def plan(self, grid: Bytes, start: Cell, goal: Cell) -> Plan:
        """Return the path from ``start`` to ``goal`` on ``grid``, (H, W)."""
        occupied = torch.from_numpy(grid.astype(np.float32))[None, None]
        starts, goals = one_hot(occupied, start), one_hot(occupied, goal)
        ends = starts + goals if self.sees_start else goals
        with torch.inference_mode():
            predicted = (self.network(torch.cat([occupied, ends], dim=1)) + 1) / 2
            answer = self.search(predicted, starts, goals, 1 - occupied)
        # The path is a mask; along it the cost from the start grows.
        cells = answer.paths[0, 0].nonzero()
        order = answer.g[0, 0][cells[:, 0], cells[:, 1]].argsort()
        return Plan(cells[order].numpy(), int(answer.histories.sum()), prepared=grid.size)


def one_hot(like: Tensor, cell: Cell) -> Tensor:
    """Return zeros of the shape of ``like``, (1, 1, H, W), with a 1 at a cell."""
    plane = torch.zeros_like(like)
    plane[0, 0, cell[0], cell[1]] = 1
    return plane


def published(checkout: Path) -> list[TransPath]:
    """Return TransPath's planners: weighted A* with correction factors, and focal searches."""
    sys.path.insert(0, str(checkout))
    sys.modules.setdefault("wandb", ModuleType("wandb"))  # imported there, and not used
    networks = importlib.import_module("models.autoencoder")
    searches = importlib.import_module("modules.planners")
    planners = []
    for name, mode, weights, options in (
        ("TransPath: weighted A*, correction factor", "k", "cf", {}),
        ("TransPath: focal search (2), path probability", "f", "focal", {}),
        ("TransPath: focal search (100), path probability", "f", "focal", {"f_w": 100}),
    ):
        network = networks.Autoencoder(mode=mode)
        network.load_state_dict(torch.load(checkout / "weights" / f"{weights}.pth"))
        search = searches.DifferentiableDiagAstar(mode=mode, **options)
        planners.append(TransPath(name, network.eval(), search.eval(), mode == "f"))
    return planners


def maps_of(checkout: Path) -> list[Bytes]:
    """Return the maps of the checkout, (64, 64) each, 0 free and 1 occupied."""
    maps = []
    for path in sorted((checkout / "maps").glob("*_f.xml")):
        grid = ElementTree.parse(path).getroot().find("map/grid")
        assert grid is not None
        rows = [str(row.text).split() for row in grid]
        maps.append((np.array(rows) == "1").astype(np.uint8))
    return maps


def problems_of(maps: list[Bytes], hard: int) -> ProblemSet:
    """Return hard problems on each map."""
    movement = RULES["-cut"]
    parts = [hard_problems("TransPath", grid, movement, len(grid), hard) for grid in maps]
    found = [part for part in parts if part is not None]
    return ProblemSet(
        np.concatenate([part.grids for part in found]),
        np.concatenate([part.starts for part in found]),
        np.concatenate([part.goals for part in found]),
        movement,
        f"{hard} on each of the {len(maps)} maps of TransPath's repository",
    )


def main(arguments: list[str] | None = None) -> None:
    """Measure TransPath's weights beside ours, and write the results and the pages."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("checkout", type=Path, help="of TransPath's repository")
    parser.add_argument("--hard", type=int, default=20, help="hard problems on a map")
    parser.add_argument("--no-network", action="store_true", help="measure this row alone")
    parser.add_argument("--folder", type=Path, default=DOCS, help="of results and pages")
    options = parser.parse_args(arguments)
    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    results = Results.read(options.folder / "planner_results.json")
    run = this_run(" ".join(["python docs/transpath.py", *words_of(arguments or sys.argv[1:])]))
    problems = problems_of(maps_of(options.checkout), options.hard)
    if options.no_network:
        table = measured(guided_planners(problems.movement), problems)
    else:
        planners = [*all_planners(problems.movement), *published(options.checkout)]
        table = measured(planners, problems)
    results.add_set(NAME, problems)
    add(results, NAME, table, run, [NO_NETWORK] if options.no_network else None)
    results.write(options.folder / "planner_results.json")
    print(table_of(results, NAME))
    write_pages(results, options.folder)


if __name__ == "__main__":
    main()
