"""The yardstick of benchmarks/labels.py finds the same as `mapdata`, or its ratios would compare nothing. No timing."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mapdata import MapSpec, generate, label

sys.path.append(str(Path(__file__).parent.parent / "benchmarks"))  # the benchmarks are scripts, not a package

import naive

MAPS = 20


@pytest.mark.parametrize("preset", ["paper", "dungeon"])
def test_naive_labels_equal_ours(preset: str) -> None:
    """Cells of every path, iterations and both matrices, on easy maps and on hard ones."""
    labels = label(generate(MapSpec.preset(preset), 3, range(MAPS)))
    assert {i: naive.differences(labels, i) for i in range(MAPS)} == {i: [] for i in range(MAPS)}


def test_a_difference_is_seen() -> None:
    """The comparison itself is no rubber stamp."""
    labels = label(generate(MapSpec.preset("paper"), 3, [0]))
    bfs, astar = labels.bfs, labels.astar
    for name, broken in (
        ("bfs iterations", replace(labels, bfs=replace(bfs, iterations=bfs.iterations + 1))),
        ("bfs route", replace(labels, bfs=replace(bfs, moves=bfs.moves ^ np.uint8(1)))),
        ("astar matrix", replace(labels, astar=replace(astar, costs=astar.costs + 1))),
    ):
        assert naive.differences(broken, 0) == [name]


def test_no_path() -> None:
    """A wall between start and goal: one cell taken, no path, -1."""
    grid = np.array([[0, 1, 0]], np.uint8)
    assert naive.bfs(grid, (0, 0), (0, 2)) == naive.astar(grid, (0, 0), (0, 2)) == ([], 1)
    assert naive.bfs_matrix(grid, [(0, 0), (0, 2)]).tolist() == [[0, -1], [-1, 0]]
    assert naive.astar_matrix(grid, [(0, 0), (0, 2)]).tolist() == [[0, -1], [-1, 0]]
