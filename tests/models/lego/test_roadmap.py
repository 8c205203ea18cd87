"""Roadmaps: segments against exact fractions, edges and paths against plain Python, samplers
against their rules.
"""

from __future__ import annotations

import itertools
import math
from fractions import Fraction

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import dijkstra
from scipy.stats import kstest

from mapdata import MapSpec, Problems
from models.lego.roadmap import (
    SAMPLERS,
    between,
    bridge,
    build_roadmap,
    corners,
    free_at,
    gaussian,
    halton,
    medial_axis,
    path_lengths,
    radius,
    sees,
    uniform,
)

DUNGEON = Problems.sample(MapSpec.preset("dungeon"), seed=3, maps=12)
Grid = npt.NDArray[np.uint8]
Point = tuple[Fraction, Fraction]


def touches(start: Point, end: Point, cell: tuple[int, int]) -> bool:
    """Return whether a segment meets a closed cell: what is left of it after each of the four sides
    cut it.
    """
    low, high = Fraction(0), Fraction(1)
    for axis in range(2):
        step = end[axis] - start[axis]
        for bound, sign in ((cell[axis], 1), (cell[axis] + 1, -1)):
            gap, rate = (
                sign * (start[axis] - bound),
                sign * step,
            )  # inside where gap + t * rate >= 0
            if rate == 0:
                if gap < 0:
                    return False
            elif rate > 0:
                low = max(low, -gap / rate)
            else:
                high = min(high, -gap / rate)
    return low <= high


places = (
    st.integers(0, 7 * 8 - 1).filter(lambda k: k % 8).map(lambda k: Fraction(k, 8))
)  # not on the border of a cell
points = st.tuples(places, places)


@settings(max_examples=400)
@given(points, points, st.integers(0, 2**49 - 1))
def test_segments_meet_exactly_the_cells_they_touch(start: Point, end: Point, bits: int) -> None:
    """Every cell that a segment meets, corners included, decides; both ways alike."""
    grid = np.array([bits >> k & 1 for k in range(49)], np.uint8).reshape(7, 7)
    free = not any(touches(start, end, (int(i), int(j))) for i, j in np.argwhere(grid))
    ends = np.array([start, end], np.float64)
    assert sees(grid, ends, ends[::-1].copy()).tolist() == [free, free]


def test_segments_at_borders_and_corners() -> None:
    """A diagonal between two occupied cells is closed; a segment along a border belongs to the
    cells below it.
    """
    first = np.array([[0.5, 0.5]])
    second = np.array([[1.5, 1.5]])
    assert not sees(np.array([[0, 1], [1, 0]], np.uint8), first, second)[0]
    assert not sees(np.array([[0, 1], [0, 0]], np.uint8), first, second)[0]
    wall = np.array([[0, 0, 0], [0, 1, 0], [0, 0, 0]], np.uint8)
    first = np.array([[1.0, 0.5], [2.0, 0.5], [2.5, 0.5]])
    second = np.array([[1.0, 2.5], [2.0, 2.5], [0.5, 0.5]])
    assert sees(wall, first, second).tolist() == [False, True, True]


def plain_edges(grid: Grid, places: npt.NDArray[np.float64], reach: float) -> set[tuple[int, int]]:
    """Return the edges of a roadmap the obvious way: every pair, looked at in a thousand places."""
    edges = set()
    for a, b in itertools.combinations(range(len(places)), 2):
        along = places[a] + np.linspace(0, 1, 1000)[:, None] * (places[b] - places[a])
        if math.dist(places[a], places[b]) <= reach and free_at(grid, along).all():
            edges.add((a, b))
    return edges


@pytest.mark.parametrize("reach", [3.0, 12.5, 100.0])
@pytest.mark.parametrize("shape", [(64, 64), (20, 50)])
def test_edges_are_those_of_all_pairs(shape: tuple[int, int], reach: float) -> None:
    """Buckets forget no pair; walking finds every wall that looking closely finds, and a few
    corners more.
    """
    spec = MapSpec(
        shape, rooms=(4, 9), room_rows=(5, 12), room_columns=(5, 12), passage_width=(1, 3)
    )
    drawn = Problems.sample(spec, seed=5, maps=2)
    for grid in drawn.grids:
        roadmap = build_roadmap(grid, uniform(grid, 60, seed=2), reach)
        found, plain = (
            set(map(tuple, roadmap.edges.tolist())),
            plain_edges(grid, roadmap.points, reach),
        )
        assert found <= plain
        assert len(plain - found) <= 2 + 0.01 * len(plain)
        assert len(roadmap.edges) == len(found)
        first, second = roadmap.edges.T
        far = np.linalg.norm(roadmap.points[first] - roadmap.points[second], axis=1)
        np.testing.assert_allclose(roadmap.lengths, far)


def test_shortest_paths_are_those_of_scipy() -> None:
    """Our search, with prices or without, costs what scipy's on a dense matrix costs; its path has
    that cost.
    """
    source = np.random.default_rng(0)
    for k, grid in enumerate(DUNGEON.grids):
        roadmap = between(grid, DUNGEON.starts[k], DUNGEON.goals[k], halton(grid, 150, seed=k))
        n = len(roadmap.points)
        for prices in (
            np.ones(n),
            1 + 9 * source.random(n),
            np.where(source.random(n) < 0.3, np.inf, 1.0),
        ):
            prices[:2] = 1
            dense = np.zeros((n, n))
            for (a, b), far in zip(
                roadmap.edges, plain_lengths(roadmap.points, roadmap.edges), strict=True
            ):
                price = max(prices[a], prices[b])
                dense[a, b] = dense[b, a] = far * price if np.isfinite(price) else 0
            truth = dijkstra(dense, indices=0)[1]
            cost, path = roadmap.priced_path(prices)
            assert cost == pytest.approx(truth)
            assert sum(dense[a, b] for a, b in itertools.pairwise(path)) == pytest.approx(
                truth if len(path) else 0
            )
            assert len(path) == 0 or path[[0, -1]].tolist() == [0, 1]
            if (prices == 1).all():
                length, vertices = roadmap.shortest_path()
                assert length == pytest.approx(truth)
                assert len(vertices) == 0 or vertices[[0, -1]].tolist() == [0, 1]


def plain_lengths(places: npt.NDArray[np.float64], edges: npt.NDArray[np.int64]) -> list[float]:
    """Return the length of each edge."""
    return [math.dist(places[a], places[b]) for a, b in edges]


def test_dense_roadmaps_solve_what_grids_solve() -> None:
    """2,000 vertices find every path, none longer than the 8-connected one needs, plus a little."""
    some = halton(DUNGEON.grids[0], 2000, 1)
    assert len(np.unique(some, axis=0)) == 2000
    dense = np.stack([halton(grid, 2000, 1) for grid in DUNGEON.grids])
    lengths = path_lengths(DUNGEON.grids, DUNGEON.starts, DUNGEON.goals, dense)
    assert (lengths < DUNGEON.optimal.cost * 1.06 + 1).all()
    straight = np.linalg.norm(DUNGEON.starts - DUNGEON.goals, axis=1)
    assert (lengths >= straight - 1e-9).all()


@pytest.mark.parametrize("name", SAMPLERS)
def test_samplers_give_free_points(name: str) -> None:
    """Exactly n, all free, the same for a seed and others for another; on a map of a single cell,
    too.
    """
    grid = DUNGEON.grids[0]
    for n in (1, 7, 300):
        found = SAMPLERS[name](grid, n, 4)
        assert found.shape == (n, 2)
        assert free_at(grid, found).all()
        assert np.array_equal(found, SAMPLERS[name](grid, n, 4))
        assert not np.array_equal(found, SAMPLERS[name](grid, n, 5))
    lonely = np.ones((9, 17), np.uint8)
    lonely[8, 16] = 0
    for cells in (lonely, np.zeros((1, 1), np.uint8)):
        assert free_at(cells, SAMPLERS[name](cells, 20, 0)).all()
    with pytest.raises(ValueError, match="n: got 0, expected an integer of at least 1"):
        SAMPLERS[name](grid, 0, 0)
    with pytest.raises(ValueError, match="without a free cell"):
        SAMPLERS[name](np.ones((5, 5)), 3, 0)


def test_halton_is_even_and_uniform_is_uniform() -> None:
    """On an empty map: both axes are uniform, and Halton's points are farther apart than random
    ones.
    """
    empty = np.zeros((40, 80), np.uint8)
    for sampler in (halton, uniform):
        found = sampler(empty, 4000, 1)
        for axis, side in enumerate(empty.shape):
            assert kstest(found[:, axis] / side, "uniform").pvalue > 1e-3
    for seed in range(5):
        assert nearest(halton(empty, 200, seed)).min() > nearest(uniform(empty, 200, seed)).min()


def nearest(places: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return how far each point's nearest neighbour is."""
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    return np.asarray(apart.min(axis=1))


def test_gaussian_and_bridge_go_where_they_should() -> None:
    """Near walls, and into the passage, more often than uniform points do."""
    grid = np.ones((40, 40), np.uint8)
    grid[5:35, 3:15] = grid[5:35, 25:37] = 0
    grid[20, 15:25] = 0

    def in_passage(found: npt.NDArray[np.float64]) -> float:
        return float(((found[:, 1] > 15) & (found[:, 1] < 25)).mean())

    def near_wall(found: npt.NDArray[np.float64]) -> float:
        around = found[:, None] + np.array([[2, 0], [-2, 0], [0, 2], [0, -2]])
        return float((~free_at(grid, around.reshape(-1, 2))).reshape(-1, 4).any(axis=1).mean())

    plain = uniform(grid, 2000, 0)
    assert in_passage(bridge(grid, 2000, 0)) > 5 * in_passage(plain)
    assert near_wall(gaussian(grid, 2000, 0)) > 1.5 * near_wall(plain)


def test_corners_are_those_of_the_obstacles() -> None:
    """All four of a box in the middle, then those of an edge; on an empty map, Halton's points."""
    grid = np.zeros((20, 30), np.uint8)
    grid[8:12, 10:20] = 1
    grid[0:3, 25:30] = 1  # one convex corner: the others are at the border
    expected = {(7, 9), (7, 20), (12, 9), (12, 20), (3, 24)}
    for seed in range(5):
        found = corners(grid, 5, seed)
        assert set(map(tuple, np.floor(found).astype(int).tolist())) == expected
        two = np.floor(corners(grid, 2, seed))  # farthest first: never on the same side of the box
        assert np.linalg.norm(two[0] - two[1]) > 10
        assert len(np.unique(corners(grid, 9, seed), axis=0)) == 9
    empty = np.zeros((9, 9))
    assert np.array_equal(corners(empty, 4, 2), halton(empty, 4, 3))


def test_the_medial_axis_runs_in_the_middle() -> None:
    """Of a corridor of 7 cells; no cell of it beside the walls."""
    grid = np.ones((21, 60), np.uint8)
    grid[7:14, 5:55] = 0
    found = np.floor(medial_axis(grid, 40, 1)).astype(int)
    inside = found[(found[:, 1] >= 10) & (found[:, 1] < 50)]
    assert len(inside) > 20
    assert (inside[:, 0] == 10).all()


def test_the_radius() -> None:
    """1.5 sqrt(log n / n) of the side."""
    assert radius(50, (64, 64)) == pytest.approx(1.5 * math.sqrt(math.log(50) / 50) * 64)
    assert radius(50, (32, 128)) == pytest.approx(radius(50, (64, 64)))
    assert radius(1, (64, 64)) == radius(3, (64, 64))


def test_what_is_refused() -> None:
    """A point in a wall or outside, a reach of nothing, a grid of no cells."""
    grid = np.array([[0, 1]], np.uint8)
    for wrong in ([0.5, 1.5], [0.5, -0.1], [1.0, 0.5]):
        with pytest.raises(ValueError, match=r"points: got .*expected points in free cells"):
            build_roadmap(grid, [wrong], 1.0)
    with pytest.raises(ValueError, match="reach: got 0"):
        build_roadmap(grid, [[0.5, 0.5]], 0)
    with pytest.raises(ValueError, match="grid: got shape"):
        build_roadmap(np.zeros(3), [[0.5, 0.5]], 1)
    for walls in (np.full((9, 9), 0.9), np.full((9, 9), 256)):
        with pytest.raises(ValueError, match="points: got"):
            build_roadmap(walls, [[1.5, 1.5], [7.5, 7.5]], 99)
    with pytest.raises(ValueError, match="points: got"):
        between(grid, (0, 1), (0, 0), [[0.5, 0.5]])
