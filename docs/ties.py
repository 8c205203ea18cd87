"""Measure how many shortest paths the problems of benchmarks have: python docs/ties.py [FILE].

FILE is an .npz of planning-datasets, such as mazes_032_moore_c8.npz. Where the package
reasoning-gym is installed, the problems of its task shortest_path are measured, too, and its own
code scores the paths of A*. docs/howto/maze_hard.md has the rows.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from maze_hard import count_shortest_paths, print_table

from mapdata import Movement, ProblemSet, astar, distance_field
from mapdata.arrays import Ints
from mapdata.formats import read_problems
from mapdata.formats.maze_questions import MOVES
from mapdata.search import STEPS

COLUMNS = (
    "benchmark",
    "problems",
    "one shortest path",
    "median number",
    "A*'s path is the label",
    "mean score of A*'s paths",
)
WORDS = {step: name for name, step in MOVES.items()}


def row(name: str, counts: list[int], exact: str = "-", score: str = "-") -> tuple[str, ...]:
    """Return the row of a benchmark, from the number of shortest paths of each problem."""
    single = np.mean([count == 1 for count in counts])
    return name, f"{len(counts):,}", f"{single:.1%}", f"{np.median(counts):,.0f}", exact, score


def row_of_planning_datasets(problems: ProblemSet) -> tuple[str, ...]:
    """Return the row of problems with 8 moves of cost 1 that may cut corners."""
    steps = [(down, right) for down, right in STEPS.tolist()]
    counts = [
        count_shortest_paths(distance_field(grid, goal, problems.movement), start, steps)
        for grid, start, goal in zip(problems.grids, problems.starts, problems.goals, strict=True)
    ]
    return row("planning-datasets, test", counts)


def words_of(path: Ints) -> str:
    """Return the moves of a path in words, as the task shortest_path wants them."""
    return " ".join(WORDS[down, right] for down, right in np.diff(path, axis=0).tolist())


def row_of_shortest_path(task: Any, entries: Iterable[dict[str, Any]]) -> tuple[str, ...]:
    """Return the row of entries of reasoning-gym's task shortest_path that have a path.

    Args:
        task: has ``score_answer(answer, entry)``.
        entries: each has the answer, and as ``metadata["matrix"]`` the rows of cells: ``*`` start,
            ``#`` goal, ``O`` free and ``X`` blocked.
    """
    counts, exact, scores = [], [], []
    for entry in entries:
        cells = np.array(entry["metadata"]["matrix"])
        (start,), (goal,) = (np.argwhere(cells == letter) for letter in "*#")
        grid = (cells == "X").astype(np.uint8)
        path = astar(grid, start, goal, Movement(4)).path
        if len(path):
            counts.append(count_shortest_paths(distance_field(grid, goal), start))
            exact.append(words_of(path) == entry["answer"])
            scores.append(task.score_answer(words_of(path), entry))
    name = "reasoning-gym, shortest_path"
    return row(name, counts, f"{np.mean(exact):.1%}", f"{np.mean(scores):.3f}")


def main(arguments: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("file", nargs="?", type=Path, metavar="FILE", help="of planning-datasets")
    parser.add_argument("--count", type=int, default=1000, help="of the task's problems")
    options = parser.parse_args(arguments)
    rows = []
    if find_spec("reasoning_gym"):
        task = import_module("reasoning_gym").create_dataset(
            "shortest_path", size=options.count, seed=0
        )
        rows.append(row_of_shortest_path(task, (task[k] for k in range(options.count))))
    if options.file is not None:
        rows.append(row_of_planning_datasets(read_problems(options.file)))
    print_table(COLUMNS, rows)


if __name__ == "__main__":
    main()
