"""Roadmaps: segments are compared with exact fractions, edges and paths with plain Python and
scipy, samplers with their definitions.
"""

from __future__ import annotations

import itertools
import math
from fractions import Fraction
from functools import cache

import numpy as np
import numpy.typing as npt
import pytest
from helpers.examples import examples, slow
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse.csgraph import dijkstra
from scipy.stats import kstest

from mapdata import MapSpec, Movement, ProblemSet
from mapdata.roadmaps import (
    SAMPLERS,
    bridge,
    build_roadmap,
    connection_radius,
    corners,
    free_at,
    gaussian,
    halton,
    medial_axis,
    path_lengths,
    roadmap_between,
    segments_are_free,
    uniform,
)

Grid = npt.NDArray[np.uint8]
Point = tuple[Fraction, Fraction]


@cache
def dungeon() -> ProblemSet:
    """Return problems on maps with long detours."""
    return ProblemSet.sample(MapSpec.preset("dungeon"), seed=3, maps=12, movement=Movement(8))


def touches(start: Point, end: Point, cell: tuple[int, int]) -> bool:
    """Return whether a segment meets a closed cell.

    The segment is start + t * (end - start) with 0 <= t <= 1. Each side of the cell cuts off a part
    of it; the segment meets the cell if something remains.
    """
    low = Fraction(0)
    high = Fraction(1)
    for axis in range(2):
        step = end[axis] - start[axis]
        for bound, sign in ((cell[axis], 1), (cell[axis] + 1, -1)):
            # The segment is on the inner side of this bound where gap + t * rate >= 0.
            gap = sign * (start[axis] - bound)
            rate = sign * step
            if rate == 0:
                if gap < 0:
                    return False
            elif rate > 0:
                low = max(low, -gap / rate)
            else:
                high = min(high, -gap / rate)
    return low <= high


# Eighths of a cell, but not the borders of cells, on a map of 7 x 7.
coordinates = st.integers(0, 7 * 8 - 1).filter(lambda k: k % 8).map(lambda k: Fraction(k, 8))
points = st.tuples(coordinates, coordinates)


@examples(400)
@given(points, points, st.integers(0, 2**49 - 1))
def test_segments_meet_exactly_the_cells_they_touch(start: Point, end: Point, bits: int) -> None:
    """A segment is free if and only if no cell that it meets, in a corner even, is occupied.

    The direction of the segment does not matter.
    """
    grid = np.array([bits >> k & 1 for k in range(49)], np.uint8).reshape(7, 7)
    free = not any(touches(start, end, (int(i), int(j))) for i, j in np.argwhere(grid))
    ends = np.array([start, end], np.float64)
    assert segments_are_free(grid, ends, ends[::-1].copy()).tolist() == [free, free]


def test_segments_at_borders_and_corners() -> None:
    """A segment through a corner of an occupied cell is not free, and a segment along a border
    meets the cells below the border.
    """
    starts = np.array([[0.5, 0.5]])
    ends = np.array([[1.5, 1.5]])
    assert not segments_are_free(np.array([[0, 1], [1, 0]], np.uint8), starts, ends)[0]
    assert not segments_are_free(np.array([[0, 1], [0, 0]], np.uint8), starts, ends)[0]
    wall = np.array([[0, 0, 0], [0, 1, 0], [0, 0, 0]], np.uint8)
    starts = np.array([[1.0, 0.5], [2.0, 0.5], [2.5, 0.5]])
    ends = np.array([[1.0, 2.5], [2.0, 2.5], [0.5, 0.5]])
    assert segments_are_free(wall, starts, ends).tolist() == [False, True, True]


def plain_edges(
    grid: Grid, vertices: npt.NDArray[np.float64], max_length: float
) -> set[tuple[int, int]]:
    """Return the edges of a roadmap by testing a thousand points between the vertices of each
    pair.
    """
    edges = set()
    for a, b in itertools.combinations(range(len(vertices)), 2):
        along = vertices[a] + np.linspace(0, 1, 1000)[:, None] * (vertices[b] - vertices[a])
        is_near = math.dist(vertices[a], vertices[b]) <= max_length
        if is_near and free_at(grid, along).all():
            edges.add((a, b))
    return edges


@pytest.mark.parametrize("max_length", [slow(3.0), 12.5, slow(100.0)])
@pytest.mark.parametrize("shape", [(64, 64), (20, 50)])
def test_edges_are_those_of_all_pairs(shape: tuple[int, int], max_length: float) -> None:
    """The roadmap has the edges that a test of points along each pair of vertices accepts, except
    for the few that pass so close to a corner that no such point lies in the occupied cell.
    """
    generator = MapSpec(
        shape, rooms=(4, 9), room_rows=(5, 12), room_columns=(5, 12), passage_width=(1, 3)
    )
    problems = ProblemSet.sample(generator, seed=5, maps=2, movement=Movement(8))
    for grid in problems.grids:
        roadmap = build_roadmap(grid, uniform(grid, 60, seed=2), max_length)
        edges = set(map(tuple, roadmap.edges.tolist()))
        expected = plain_edges(grid, roadmap.points, max_length)
        assert edges <= expected
        assert len(expected - edges) <= 2 + 0.01 * len(expected)
        assert len(roadmap.edges) == len(edges)
        starts, ends = roadmap.edges.T
        lengths = np.linalg.norm(roadmap.points[starts] - roadmap.points[ends], axis=1)
        np.testing.assert_allclose(roadmap.lengths, lengths)


def test_shortest_paths_are_those_of_scipy() -> None:
    """The cost of a path, with prices or without, is that of scipy's search on a dense matrix, and
    the edges of the path have that cost.
    """
    rng = np.random.default_rng(0)
    problems = dungeon()
    for k, grid in enumerate(problems.grids):
        samples = halton(grid, 150, seed=k)
        roadmap = roadmap_between(grid, problems.starts[k], problems.goals[k], samples)
        n = len(roadmap.points)
        no_prices = np.ones(n)
        random_prices = 1 + 9 * rng.random(n)
        closed_vertices = np.where(rng.random(n) < 0.3, np.inf, 1.0)
        for prices in (no_prices, random_prices, closed_vertices):
            prices[:2] = 1  # start and goal
            dense = np.zeros((n, n))  # 0 is no edge
            lengths = plain_lengths(roadmap.points, roadmap.edges)
            for (a, b), length in zip(roadmap.edges, lengths, strict=True):
                price = max(prices[a], prices[b])
                if np.isfinite(price):
                    dense[a, b] = length * price
                    dense[b, a] = length * price
            expected = dijkstra(dense, indices=0)[1]
            cost, path = roadmap.priced_path(prices)
            assert cost == pytest.approx(expected)
            if np.isfinite(expected):
                path_cost = sum(dense[a, b] for a, b in itertools.pairwise(path))
                assert path_cost == pytest.approx(expected)
                assert path[[0, -1]].tolist() == [0, 1]
            else:
                assert len(path) == 0
            if (prices == 1).all():
                length, vertices = roadmap.shortest_path()
                assert length == pytest.approx(expected)
                assert vertices.tolist() == path.tolist()


def plain_lengths(vertices: npt.NDArray[np.float64], edges: npt.NDArray[np.int64]) -> list[float]:
    """Return the length of each edge."""
    return [math.dist(vertices[a], vertices[b]) for a, b in edges]


def test_dense_roadmaps_solve_what_grids_solve() -> None:
    """Roadmaps of 2,000 vertices have a path for every problem, hardly longer than the 8-connected
    path on the grid, and never shorter than the straight line.
    """
    problems = dungeon()
    samples = halton(problems.grids[0], 2000, 1)
    assert len(np.unique(samples, axis=0)) == 2000
    dense = np.stack([halton(grid, 2000, 1) for grid in problems.grids])
    lengths = path_lengths(problems.grids, problems.starts, problems.goals, dense)
    assert (lengths < problems.optimal.cost * 1.06 + 1).all()
    straight = np.linalg.norm(problems.starts - problems.goals, axis=1)
    assert (lengths >= straight - 1e-9).all()


@pytest.mark.parametrize("name", SAMPLERS)
def test_samplers_give_free_points(name: str) -> None:
    """A sampler gives exactly n points in free cells, which the seed determines; also on maps with
    a single free cell.
    """
    sampler = SAMPLERS[name]
    grid = dungeon().grids[0]
    for n in (1, 7, 300):
        samples = sampler(grid, n, 4)
        assert samples.shape == (n, 2)
        assert free_at(grid, samples).all()
        assert np.array_equal(samples, sampler(grid, n, 4))
        assert not np.array_equal(samples, sampler(grid, n, 5))
    single_free_cell = np.ones((9, 17), np.uint8)
    single_free_cell[8, 16] = 0
    for cells in (single_free_cell, np.zeros((1, 1), np.uint8)):
        assert free_at(cells, sampler(cells, 20, 0)).all()
    with pytest.raises(ValueError, match="n: got 0, expected an integer of at least 1"):
        sampler(grid, 0, 0)
    with pytest.raises(ValueError, match="without a free cell"):
        sampler(np.ones((5, 5)), 3, 0)


def test_halton_is_even_and_uniform_is_uniform() -> None:
    """On an empty map both coordinates of both samplers are uniformly distributed, and the two
    nearest of Halton's points are farther apart than those of uniform points.
    """
    empty = np.zeros((40, 80), np.uint8)
    for sampler in (halton, uniform):
        samples = sampler(empty, 4000, 1)
        for axis, side in enumerate(empty.shape):
            assert kstest(samples[:, axis] / side, "uniform").pvalue > 1e-3
    for seed in range(5):
        assert min_distance(halton(empty, 200, seed)) > min_distance(uniform(empty, 200, seed))


def min_distance(points: npt.NDArray[np.float64]) -> float:
    """Return the distance between the two nearest points."""
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.fill_diagonal(distances, np.inf)
    return float(distances.min())


def test_gaussian_and_bridge_go_where_they_should() -> None:
    """More points of the Gaussian sampler lie near walls than uniform points, and more points of
    the bridge test lie in the passage.
    """
    grid = np.ones((40, 40), np.uint8)
    grid[5:35, 3:15] = grid[5:35, 25:37] = 0
    grid[20, 15:25] = 0

    def share_in_passage(samples: npt.NDArray[np.float64]) -> float:
        return float(((samples[:, 1] > 15) & (samples[:, 1] < 25)).mean())

    def share_near_wall(samples: npt.NDArray[np.float64]) -> float:
        around = samples[:, None] + np.array([[2, 0], [-2, 0], [0, 2], [0, -2]])  # (n, 4, 2)
        is_wall = ~free_at(grid, around.reshape(-1, 2)).reshape(-1, 4)
        return float(is_wall.any(axis=1).mean())

    uniform_samples = uniform(grid, 2000, 0)
    assert share_in_passage(bridge(grid, 2000, 0)) > 5 * share_in_passage(uniform_samples)
    assert share_near_wall(gaussian(grid, 2000, 0)) > 1.5 * share_near_wall(uniform_samples)


def test_corners_are_those_of_the_obstacles() -> None:
    """The sampler takes the free cells at all convex corners, each once before others follow; on
    an empty map it gives Halton's points.
    """
    grid = np.zeros((20, 30), np.uint8)
    grid[8:12, 10:20] = 1
    grid[0:3, 25:30] = 1  # has one convex corner, since the others are at the border
    expected = {(7, 9), (7, 20), (12, 9), (12, 20), (3, 24)}
    for seed in range(5):
        cells = np.floor(corners(grid, 5, seed)).astype(int)
        assert set(map(tuple, cells.tolist())) == expected
        # In farthest-point order the first two are never on the same side of the box.
        first, second = np.floor(corners(grid, 2, seed))
        assert np.linalg.norm(first - second) > 10
        assert len(np.unique(corners(grid, 9, seed), axis=0)) == 9
    empty = np.zeros((9, 9))
    assert np.array_equal(corners(empty, 4, 2), halton(empty, 4, 3))


def test_the_medial_axis_runs_in_the_middle() -> None:
    """In a corridor that is 7 cells wide, points away from its ends lie in the middle row."""
    grid = np.ones((21, 60), np.uint8)
    grid[7:14, 5:55] = 0
    cells = np.floor(medial_axis(grid, 40, 1)).astype(int)
    rows, columns = cells.T
    away_from_ends = (columns >= 10) & (columns < 50)
    assert away_from_ends.sum() > 20
    assert (rows[away_from_ends] == 10).all()


def test_the_connection_radius() -> None:
    """It is 1.5 sqrt(log n / n) of the side of a square map, or of a square with the same area."""
    square = connection_radius(50, (64, 64))
    assert square == pytest.approx(1.5 * math.sqrt(math.log(50) / 50) * 64)
    assert connection_radius(50, (32, 128)) == pytest.approx(square)
    assert connection_radius(1, (64, 64)) == connection_radius(3, (64, 64))


def test_points_in_walls_and_lengths_of_0_are_refused() -> None:
    """So are points outside the map and grids that are no arrays of rows and columns."""
    grid = np.array([[0, 1]], np.uint8)
    for wrong in ([0.5, 1.5], [0.5, -0.1], [1.0, 0.5]):
        with pytest.raises(ValueError, match=r"points: got .*expected points in free cells"):
            build_roadmap(grid, [wrong], 1.0)
    with pytest.raises(ValueError, match="max_length: got 0"):
        build_roadmap(grid, [[0.5, 0.5]], 0)
    with pytest.raises(ValueError, match="grid: got shape"):
        build_roadmap(np.zeros(3), [[0.5, 0.5]], 1)
    for walls in (np.full((9, 9), 0.9), np.full((9, 9), 256)):
        with pytest.raises(ValueError, match="points: got"):
            build_roadmap(walls, [[1.5, 1.5], [7.5, 7.5]], 99)
    with pytest.raises(ValueError, match="points: got"):
        roadmap_between(grid, (0, 1), (0, 0), [[0.5, 0.5]])
