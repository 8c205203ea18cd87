"""Pairs of seed points and their paths by A*, on maps with terrain and without it."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.specs import movements

from mapdata import Movement, astar
from mapdata.problems.pairs import solve_pairs
from mapdata.search.ground import costs_of_sums
from mapdata.search.lattice import ASTAR, move_rule
from mapdata.search.map_stack import MapStack

COUNT = 20


@movements
@pytest.mark.parametrize("only_route", [False, True])
@pytest.mark.parametrize("keep_unsolvable", [False, True])
def test_pairs_are_solved_by_astar(
    movement: Movement, only_route: bool, keep_unsolvable: bool
) -> None:
    """Costs change the path of a pair, not which pair is drawn; seed points may be occupied."""
    source = np.random.default_rng(3)
    terrains = source.integers(1, 256, (COUNT, 11, 12)).astype(np.uint8)
    terrains[source.random(terrains.shape) < 0.4] = 0
    terrains[0] = 0
    grids = (terrains == 0).astype(np.uint8)
    seed_points = source.integers(0, (11, 12), size=(COUNT, 4, 2))
    rooms = np.tile([2, 3, 4, 4], COUNT // 4)
    drawn = []
    for maps in (MapStack(grids, None), MapStack(grids, terrains)):
        ends, solved = solve_pairs(
            maps,
            seed_points,
            rooms,
            np.uint64(5),
            2,
            np.arange(COUNT),
            only_route,
            keep_unsolvable,
            ASTAR,
            move_rule(movement),
        )
        drawn.append(ends)
        assert (solved.done, solved.high_cost) == (COUNT, 0)
        assert (np.diff(solved.offsets) > 0).any()
        costs = costs_of_sums(solved.sums, movement, are_doubled=maps.terrain is not None)
        for b in range(COUNT):
            path = solved.cells[solved.offsets[b] : solved.offsets[b + 1]]
            start = (int(ends[b, 0]), int(ends[b, 1]))
            goal = (int(ends[b, 2]), int(ends[b, 3]))
            if ends[b, 0] < 0 or grids[b][start] or grids[b][goal]:
                assert (len(path), costs[b]) == (0, -1)
                continue
            terrain = None if maps.terrain is None else terrains[b]
            expected = astar(grids[b], start, goal, movement, terrain=terrain)
            np.testing.assert_array_equal(path, expected.path)
            assert (costs[b], solved.expansions[b]) == expected[1:]
    np.testing.assert_array_equal(drawn[0], drawn[1])
