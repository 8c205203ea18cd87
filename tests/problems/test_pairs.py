"""Pairs of seed points and their paths by A*, on maps with terrain and without it."""

from __future__ import annotations

from itertools import combinations

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


@pytest.mark.parametrize("only_route", [False, True])
def test_a_pair_without_a_path_gives_way_to_the_next_one(only_route: bool) -> None:
    """From the drawn pair on, pairs are tried in their order, and then from the first one on."""
    source = np.random.default_rng(4)
    grids = (source.random((COUNT, 9, 9)) < 0.45).astype(np.uint8)
    cells = np.stack([source.permutation(81)[:5] for _ in range(COUNT)])
    seed_points = np.stack(np.divmod(cells, 9), axis=-1)
    first, served = (
        solve_pairs(
            MapStack(grids, None),
            seed_points,
            np.full(COUNT, 5),
            np.uint64(5),
            2,
            np.arange(COUNT),
            only_route,
            keep_unsolvable,
            ASTAR,
            move_rule(Movement(4)),
        )[0]
        for keep_unsolvable in (True, False)
    )
    pairs = [(i, i + 1) for i in range(4)] if only_route else list(combinations(range(5), 2))
    skipped = set()
    for b in range(COUNT):
        ends = [(*seed_points[b, i].tolist(), *seed_points[b, j].tolist()) for i, j in pairs]
        number = ends.index(tuple(first[b].tolist()))
        has_path = [
            not (grids[b][one[:2]] or grids[b][one[2:]])
            and len(astar(grids[b], one[:2], one[2:], Movement(4)).path) > 0
            for one in ends
        ]
        tried = [*range(number, len(ends)), *range(number)]
        found = [k for k in tried if has_path[k]]
        skipped.add(tried.index(found[0]) if found else -1)
        assert tuple(served[b].tolist()) == (ends[found[0]] if found else (-1, -1, -1, -1))
    assert skipped > {-1, 0, 1}
