"""Maps with or without terrain as one record: how it solves problems, and how it names them."""

from __future__ import annotations

import numpy as np
import pytest

from mapdata import Movement, check_path
from mapdata.search.lattice import ASTAR, BFS
from mapdata.search.map_stack import MapStack

TERRAIN = np.array([[[1, 9, 1], [1, 1, 1]], [[1, 2, 1], [200, 255, 200]]], np.uint8)
STARTS = np.array([[0, 0], [0, 0]])
GOALS = np.array([[0, 2], [0, 2]])


@pytest.mark.parametrize("has_terrain", [False, True])
def test_costs_of_what_it_solves_are_those_of_the_paths(has_terrain: bool) -> None:
    """By the path check, whether the costs come from the search or from the cells."""
    maps = MapStack((TERRAIN == 0).astype(np.uint8), TERRAIN if has_terrain else None)
    solved = maps.solve(STARTS, GOALS, Movement(8))
    expected = [
        check_path(
            maps.grids[b],
            solved.cells[solved.offsets[b] : solved.offsets[b + 1]],
            Movement(8),
            terrain=TERRAIN[b] if has_terrain else None,
        )
        for b in range(2)
    ]
    assert maps.costs_of(solved, Movement(8)).tolist() == expected
    of_paths = maps.costs_of_paths(solved.cells, solved.offsets, Movement(8))
    assert of_paths.tolist() == expected


def test_bfs_sees_no_terrain() -> None:
    """It counts moves. A* sees what is there."""
    maps = MapStack((TERRAIN == 0).astype(np.uint8), TERRAIN)
    assert maps.seen_by(BFS).terrain is None
    assert maps.seen_by(ASTAR) is maps


def test_an_error_names_the_problem_as_the_caller_does() -> None:
    """By its place in the batch, unless the caller says otherwise."""
    maps = MapStack(np.array([[[0, 0]], [[0, 1]]], np.uint8), None)
    ends = np.array([[0, 0], [0, 1]]), np.array([[0, 1], [0, 0]])
    with pytest.raises(ValueError, match=r"^problem 1: start: \(0, 1\) is on an occupied cell"):
        maps.solve(*ends, Movement())
    with pytest.raises(ValueError, match=r"^map 8: start: \(0, 1\) is on an occupied cell"):
        maps.solve(*ends, Movement(), error_prefix=lambda row: f"map {row + 7}: ")
