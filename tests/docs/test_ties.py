"""The table of ties counts shortest paths as networkx does, and asks the benchmark for scores."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import networkx as nx  # type: ignore[import-untyped]
import numpy as np
import pytest
from helpers.pages import DOCS

from mapdata import Movement, ProblemSet, Random


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return ties.py."""
    monkeypatch.syspath_prepend(str(DOCS))
    import ties

    return ties


@pytest.mark.slow
def test_paths_of_eight_moves_are_counted_as_networkx_counts_them(script: ModuleType) -> None:
    """All moves cost 1 and may cut corners, as in planning-datasets."""
    movement = Movement(8, corner_cutting=True, diagonal_cost=1)
    problems = ProblemSet.sample("noise30", 3, 5, movement=movement, problems=Random(length=(4, 8)))
    counts = []
    for grid, start, goal in zip(problems.grids, problems.starts, problems.goals, strict=True):
        cells = [tuple(cell) for cell in np.argwhere(grid == 0).tolist()]
        graph = nx.Graph()
        graph.add_nodes_from(cells)
        graph.add_edges_from(
            (one, other)
            for one in cells
            for other in cells
            if max(abs(one[0] - other[0]), abs(one[1] - other[1])) == 1
        )
        ends = tuple(start.tolist()), tuple(goal.tolist())
        counts.append(len(list(nx.all_shortest_paths(graph, *ends))))
    assert max(counts) > 1
    _, number, single, median, *_ = script.row_of_planning_datasets(problems)
    assert number == "5"
    assert single == f"{np.mean([count == 1 for count in counts]):.1%}"
    assert median == f"{np.median(counts):,.0f}"


class Task:
    """Scores 1 for the answer and 0.25 for all else."""

    def score_answer(self, answer: str, entry: dict[str, Any]) -> float:
        """Return the score."""
        return 1.0 if answer == entry["answer"] else 0.25


def test_the_benchmark_scores_the_paths_of_a_star(script: ModuleType) -> None:
    """An open square of 2 x 2 cells has two paths, a corridor one; a problem without a path is left
    out.
    """
    entries = [
        {"answer": "neither", "metadata": {"matrix": [["*", "O"], ["O", "#"]]}},
        {"answer": "right right", "metadata": {"matrix": [["*", "O", "#"]]}},
        {"answer": "infeasible", "metadata": {"matrix": [["*", "X", "#"]]}},
    ]
    found = script.row_of_shortest_path(Task(), entries)
    assert found[1:] == ("2", "50.0%", "2", "50.0%", "0.625")
