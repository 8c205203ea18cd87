"""The table of two ways from a network to a planner is made from a file of results."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from helpers.pages import DOCS

from mapdata import ProblemSet


@pytest.fixture
def tables(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return network_tables.py."""
    monkeypatch.syspath_prepend(str(DOCS))
    import network_tables

    return network_tables


def test_the_table_of_the_page_is_that_of_the_file(tables: ModuleType, tmp_path: Path) -> None:
    """Writing it again changes neither; its sets are those of the planners' tables."""
    (tmp_path / "howto").mkdir()
    names = ("network_results.json", "howto/planner.md")
    for name in names:
        shutil.copy(DOCS / name, tmp_path / name)
    tables.main(["--pages", "--folder", str(tmp_path)])
    for name in names:
        assert (tmp_path / name).read_text() == (DOCS / name).read_text(), name
    results = tables.Results.read(DOCS / "network_results.json")
    planners = tables.Results.read(DOCS / "planner_results.json")
    for name, drawn in results.sets.items():
        assert drawn["hard"] == planners.sets[name]["hard"]


@pytest.mark.slow
def test_costs_of_cells_are_low_about_the_shortest_path(tables: ModuleType) -> None:
    """Both networks give a cost to each cell, and lower ones to more than half of the cells of a
    shortest path.
    """
    problems = ProblemSet.sample("dungeon", 5, 4, movement=tables.MOVEMENT)
    for costs_of in (tables.costs_by_predictor, tables.costs_by_heat_map):
        costs = costs_of(problems.grids, problems.starts, problems.goals)
        assert costs.shape == problems.grids.shape
        assert costs.min() == 1
        for k in range(len(problems)):
            on_path = costs[k][tuple(problems.optimal.path(k).T)] == 1
            assert on_path.mean() > max(0.5, np.mean(costs[k] == 1))
