"""The page of maze-30x30-hard-1k is measured by a script, which is tried on a set of our own."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import networkx as nx  # type: ignore[import-untyped]
import numpy as np
import pytest
from helpers.pages import DOCS
from scipy.stats import ks_2samp

from mapdata import Maze, Random
from mapdata.export import export_problems


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return maze_hard.py."""
    monkeypatch.syspath_prepend(str(DOCS))
    import maze_hard

    return maze_hard


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sets of 12 + 12 problems: the arrays of HRM, and lines of a CSV with the same mazes."""
    folder = tmp_path_factory.mktemp("mazes")
    for name, layout in (("arrays", "hrm"), ("lines", "maze-hard")):
        loops = Maze((9, 9), reopened=0.6)
        problems = Random(length=(6, None))
        export_problems(loops, folder / name, format=layout, problems=problems, count=12)
    return folder


def test_both_forms_of_a_set_are_read_alike(script: ModuleType, folder: Path) -> None:
    """The set as it is published, and what the converter makes of it."""
    for split in script.SPLITS:
        arrays = script.read_mazes(folder / "arrays", split)
        lines = script.read_mazes(folder / "lines", split)
        for name in ("walls", "starts", "goals", "marks", "costs"):
            np.testing.assert_array_equal(getattr(arrays, name), getattr(lines, name))


def test_shortest_paths_are_counted_as_networkx_counts_them(
    script: ModuleType, folder: Path
) -> None:
    """By listing all of them; the labels are among them."""
    mazes = script.read_mazes(folder / "arrays", "test")
    counts = script.path_counts(mazes)
    for k, count in enumerate(counts):
        graph = nx.grid_2d_graph(9, 9)
        graph.remove_nodes_from([tuple(cell) for cell in np.argwhere(mazes.walls[k]).tolist()])
        start, goal = tuple(mazes.starts[k].tolist()), tuple(mazes.goals[k].tolist())
        paths = list(nx.all_shortest_paths(graph, start, goal))
        assert len(paths) == count
        marked = {tuple(cell) for cell in np.argwhere(mazes.marks[k]).tolist()}
        assert marked in [set(path[1:-1]) for path in paths]
        assert len(paths[0]) - 1 == mazes.moves[k]
    assert max(counts) > 1
    assert script.is_shortest(mazes.marks, mazes).all()
    marks = mazes.marks.copy()
    marks[0] = False
    assert script.is_shortest(marks, mazes).tolist() == [False] + 11 * [True]


def test_weights_are_the_starts_that_are_as_far(script: ModuleType, folder: Path) -> None:
    """Those from which networkx needs as many moves to the goal as the shortest path of the set."""
    mazes = script.read_mazes(folder / "arrays", "test")
    weights = script.weights_of_pairs(mazes)
    for k, weight in enumerate(weights):
        graph = nx.grid_2d_graph(9, 9)
        graph.remove_nodes_from([tuple(cell) for cell in np.argwhere(mazes.walls[k]).tolist()])
        moves = nx.single_source_shortest_path_length(graph, tuple(mazes.goals[k].tolist()))
        far = sum(each >= mazes.moves.min() for each in moves.values())
        assert weight == far / len(graph)


def test_the_weighted_distance_is_that_of_repeated_values(script: ModuleType) -> None:
    """A weight of 3 is a value three times, for scipy's statistic."""
    rng = np.random.default_rng(0)
    first, second = rng.integers(20, size=50), rng.integers(5, 25, size=40)
    weights = rng.integers(1, 4, size=40)
    found = script.weighted_distance(first, second, weights)
    assert found == pytest.approx(ks_2samp(first, np.repeat(second, weights)).statistic)


def test_the_tables_of_a_set_of_our_own(
    script: ModuleType, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its labels follow the rule; A* finds other paths, which are shortest, too."""
    script.main([str(folder / "lines"), "--beside", str(folder / "arrays")])
    printed = capsys.readouterr().out
    assert "| problems | 12 | 12 |" in printed
    assert "| labels of the rule down, left, right, up | 12 | 12 |" in printed
    assert "| the rule down, left, right, up | 100.0% | 100% |" in printed
    row = next(line for line in printed.splitlines() if line.startswith("| A* of mapdata"))
    assert row.endswith("| 100% |")
    assert "| 100.0% |" not in row
    assert "| 0.000 | 1 |" in printed  # the mazes of both folders are the same


def test_copies_are_found_up_to_symmetry(script: ModuleType, folder: Path) -> None:
    """A maze that is turned and mirrored is the same maze."""
    mazes = script.read_mazes(folder / "arrays", "train")
    grid = mazes.walls[0]
    keys = {script.canonical(np.rot90(each, k)) for each in (grid, grid.T) for k in range(4)}
    assert keys == {script.canonical(grid)}
    assert script.canonical(mazes.walls[1]) not in keys


def test_a_turned_label_is_rarely_the_label_of_the_turned_maze(
    script: ModuleType, folder: Path
) -> None:
    """By turning a maze and labelling it anew."""
    mazes = script.read_mazes(folder / "arrays", "train")
    shares = [script._relabelled_share(mazes, flip, turns) for flip in (0, 1) for turns in range(4)]
    assert shares[0] == 1
    assert min(shares) < 0.5
