"""Taut lines: free by an exact oracle, as short as their homotopy class allows, evenly divided."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
from helpers import taut_reference
from helpers.examples import Some, slow
from helpers.grids import random_grids, serpentine

from mapdata import (
    Movement,
    astar,
    bfs,
    generate,
    inflate,
    lines_are_free,
    pull_taut,
)
from mapdata.generators import PRESETS, Cave, Forest, MapGenerator, MapSpec, Maze
from mapdata.search.free_lines import CELL, MAX_TAUT_SIDE
from mapdata.search.taut import NO_PATH, path_waypoints, robot_of, write_waypoints

Grid = npt.NDArray[np.uint8]
Line = npt.NDArray[np.float64]

MOVEMENTS = (Movement(8), Movement(8, corner_cutting=True), Movement(4))


class Problem(NamedTuple):
    """A path that A* or BFS found on a map."""

    grid: Grid
    path: npt.NDArray[np.int64]
    movement: Movement


def middle_of(cell: Any) -> taut_reference.Point:
    """Return the middle of a cell as exact fractions."""
    return (Fraction(2 * int(cell[0]) + 1, 2), Fraction(2 * int(cell[1]) + 1, 2))


def length_of(line: Any) -> float:
    """Return the length of a line of points."""
    return sum(math.dist(before, after) for before, after in pairwise(np.asarray(line).tolist()))


def free_cells(grid: Grid, source: np.random.Generator) -> tuple[Any, Any]:
    """Return two free cells of a map, drawn at random."""
    start, goal = source.choice(np.argwhere(grid == 0), 2)
    return start, goal


def small_maps(source: np.random.Generator) -> list[Grid]:
    """Return maps of all families with 16 x 16 cells, and random ones."""
    families: list[MapGenerator] = [
        Cave(map_size=(16, 16)),
        Forest(map_size=(16, 16)),
        Maze(map_size=(17, 17)),
    ]
    maps = [grid for family in families for grid in generate(family, 3, range(5)).occupancy]
    maps += [(source.random((14, 16)) < share).astype(np.uint8) for share in (0.1, 0.2, 0.3) * 5]
    maps += [serpentine(12, 15, source) for _ in range(3)]
    return maps


@pytest.fixture(scope="module")
def problems() -> list[Problem]:
    """Paths on small maps, by both searches and under all movements."""
    source = np.random.default_rng(7)
    drawn = []
    for grid in small_maps(source):
        for movement in MOVEMENTS:
            for search in (astar, bfs):
                start, goal = free_cells(grid, source)
                path = search(grid, start, goal, movement).path
                if len(path):
                    drawn.append(Problem(grid, path, movement))
    assert len(drawn) > 100
    return drawn


def test_taut_lines_are_free(problems: list[Problem]) -> None:
    """By the exact oracle; only paths that cut corners touch points where obstacles touch."""
    for grid, path, movement in problems[::3]:
        line = pull_taut(grid, path)
        for start, end in pairwise(taut_reference.in_fractions(line)):
            assert taut_reference.is_free_segment(grid, start, end, movement.corner_cutting)


def test_taut_lines_join_the_middles_of_start_and_goal(problems: list[Problem]) -> None:
    """And a path of one cell is one point."""
    for grid, path, _ in problems:
        line = pull_taut(grid, path)
        np.testing.assert_array_equal(line[0], path[0] + 0.5)
        np.testing.assert_array_equal(line[-1], path[-1] + 0.5)
        assert len(line) >= 2 or len(path) == 1
    assert pull_taut([[0]], [(0, 0)]).tolist() == [[0.5, 0.5]]


def test_taut_lines_bend_around_corners_of_obstacles(problems: list[Problem]) -> None:
    """So they cannot be shortened: the cell on the inner side of each bend is occupied."""
    bends = 0
    for grid, path, _ in problems:
        line = pull_taut(grid, path)
        for before, bend, after in zip(line, line[1:], line[2:], strict=False):
            assert (bend == np.round(bend)).all()
            towards = (before - bend) / math.dist(before, bend)
            away = (after - bend) / math.dist(after, bend)
            inside = np.floor(bend + 1e-3 * (towards + away)).astype(int)
            assert abs(towards[0] * away[1] - towards[1] * away[0]) > 1e-9
            assert grid[tuple(inside)] == 1
            bends += 1
    assert bends > 100


def test_taut_lines_pass_obstacles_on_the_sides_of_their_paths(problems: list[Problem]) -> None:
    """Together, line and path go around no occupied cell."""
    for grid, path, _ in problems:
        line = pull_taut(grid, path)
        loop = [*line.tolist(), *(path[::-1] + 0.5).tolist()]
        for cell in np.argwhere(grid):
            assert taut_reference.winding_number(loop, (cell + 0.5).tolist()) == 0


def test_a_walk_with_detours_is_pulled_to_the_same_line_as_its_reduction(some: Some) -> None:
    """A random walk on a tree of corridors has one taut line: that of its ends' shortest path."""
    source = np.random.default_rng(11)
    grid = generate(Maze(map_size=(17, 17)), 5, [0]).occupancy[0]
    for _ in range(some(40)):
        walk = [tuple(source.choice(np.argwhere(grid == 0)).tolist())]
        while len(walk) < 150:
            step = [(-1, 0), (0, 1), (1, 0), (0, -1)][source.integers(4)]
            cell = (walk[-1][0] + step[0], walk[-1][1] + step[1])
            if not taut_reference.is_occupied(grid, *cell):
                walk.append(cell)
        shortest = astar(grid, walk[0], walk[-1]).path
        for radius in (0, 0.3, 0.5):
            expected = pull_taut(grid, shortest, radius)
            np.testing.assert_array_equal(pull_taut(grid, walk, radius), expected)


@pytest.mark.slow
def test_taut_lines_are_nearly_as_short_as_a_visibility_graph() -> None:
    """Never shorter, and longer only where the path takes another side of an obstacle."""
    source = np.random.default_rng(3)
    ratios = []
    for _ in range(25):
        grid = (source.random((9, 11)) < 0.12).astype(np.uint8)
        start, goal = free_cells(grid, source)
        path = astar(grid, start, goal, Movement(8)).path
        if len(path) > 4:
            shortest = taut_reference.shortest_length(
                grid,
                (
                    Fraction(int(start[0])) + Fraction(1, 2),
                    Fraction(int(start[1])) + Fraction(1, 2),
                ),
                middle_of(goal),
                corner_cutting=False,
            )
            ratios.append(length_of(pull_taut(grid, path)) / shortest)
    assert len(ratios) > 10
    assert min(ratios) > 1 - 1e-12
    assert np.mean(ratios) < 1.01
    assert np.mean(np.array(ratios) < 1 + 1e-12) > 0.6


@pytest.mark.filterwarnings("ignore:radius_cells. a robot .* is within one cell")
@pytest.mark.parametrize("radius", [slow(0.3), 0.5, slow(0.7071), 1.2, slow(1.5)])
def test_lines_for_a_robot_keep_its_distance(radius: float) -> None:
    """By the exact oracle; they are not longer than the path, and mostly shorter."""
    source = np.random.default_rng(5)
    shorter = 0
    maps = [*generate(Cave(map_size=(18, 18)), 2, range(3)).occupancy]
    maps += [(source.random((16, 18)) < 0.04).astype(np.uint8) for _ in range(3)]
    for grid in maps:
        inflated = inflate(grid, radius)
        if (inflated == 0).sum() < 10:
            continue
        start, goal = free_cells(inflated, source)
        path = astar(inflated, start, goal, Movement(8)).path
        if len(path) < 3:
            continue
        line = pull_taut(grid, path, radius)
        for before, after in pairwise(taut_reference.in_fractions(line)):
            assert taut_reference.is_free_segment(grid, before, after, True)
            squared = taut_reference.squared_distance(grid, before, after)
            assert float(squared) >= radius**2 * (1 - 3e-7)
        assert length_of(line) <= length_of(path) + 1e-9
        shorter += length_of(line) < length_of(path) - 1e-9
    assert shorter >= 1


@pytest.mark.parametrize("radius", [0.001, 0.05, 0.5, 0.7071, 1, 1.5, 7.3, 100])
def test_octagons_contain_the_disc(radius: float) -> None:
    """The snug one touches it on the axes, the roomy one is larger by 1/256 cell everywhere."""
    robot = robot_of(radius)
    exact = radius * CELL * (1 - 2e-7)
    for octagon, margin in ((robot.roomy, 1), (robot.snug, 0)):
        assert exact + margin <= octagon.reach < exact + margin + 1.001
        assert octagon.side <= octagon.reach
    assert robot.roomy.reach + robot.roomy.side >= math.sqrt(2) * (exact + 1) - 1e-9 or (
        robot.roomy.side == robot.roomy.reach
    )
    # A bend around the octagon is longer than around the disc by 5.5 % and what rounding adds.
    half_side = math.sqrt(2) * math.tan(math.pi / 8)
    assert robot.snug.side <= math.tan(math.pi / 8) * exact + 2 * half_side + 4


def test_a_robot_as_wide_as_a_corridor_follows_its_middle() -> None:
    """It touches both walls, and goes around the corner on its octagon."""
    grid = np.ones((9, 9), np.uint8)
    grid[1:4, 1:] = 0
    grid[1:, 1:4] = 0
    path = astar(inflate(grid, 1.5), (7, 2), (2, 7), Movement(8)).path
    bend = 4 - robot_of(1.5).snug.side / CELL
    line = pull_taut(grid, path, 1.5)
    np.testing.assert_array_equal(line, [[7.5, 2.5], [bend, 2.5], [2.5, bend], [2.5, 7.5]])


def is_same_side(grid: Grid, line: Line, other: Line) -> bool:
    """Return whether two lines with the same ends pass all obstacles on the same sides."""
    loop = [*line.tolist(), *other.tolist()[-2:0:-1]]
    middles = np.argwhere(grid == 1) + 0.5
    return all(taut_reference.winding_number(loop, middle) == 0 for middle in middles.tolist())


@pytest.mark.parametrize("radius", [0.5, 1.5, 2.5])
def test_lines_on_empty_maps_are_straight(some: Some, radius: float) -> None:
    """Also beside the border, where the robot fits exactly, and for paths with detours."""
    source = np.random.default_rng(12)
    grid = np.zeros((8, 9), np.uint8)
    inflated = inflate(grid, radius)
    for _ in range(some(40)):
        corner, start, goal = (free_cells(inflated, source)[0] for _ in range(3))
        path = astar(inflated, start, corner, Movement(8)).path.tolist()
        path += astar(inflated, corner, goal, Movement(8)).path.tolist()[1:]
        ends = np.array([start, goal]) + 0.5
        expected = ends if (start != goal).any() else ends[:1]
        np.testing.assert_array_equal(pull_taut(grid, path, radius), expected)


@pytest.mark.parametrize("width", [1, 3, 5])
def test_lines_in_corridors_are_as_short_as_the_corridors_allow(width: int) -> None:
    """A robot as wide as a corridor has one way through it, straight on."""
    grid = np.ones((width + 2, 20), np.uint8)
    grid[1:-1, 1:-1] = 0
    middle = 1 + width // 2
    corridors = [(grid, (middle, middle), (middle, 19 - middle))]
    corridors.append((np.ascontiguousarray(grid.T), (middle, middle), (19 - middle, middle)))
    for corridor, start, goal in corridors:
        path = astar(inflate(corridor, width / 2), start, goal, Movement(8)).path
        line = pull_taut(corridor, path, width / 2)
        np.testing.assert_array_equal(line, np.array([start, goal]) + 0.5)


SMALL_FAMILIES: tuple[MapGenerator, ...] = (
    MapSpec((24, 24), rooms=(3, 5), room_rows=(6, 12), room_columns=(6, 12), passage_width=(1, 5)),
    Cave((24, 24), occupied=0.4),
    Forest((24, 24), cover=(0.1, 0.2)),
    Forest((24, 24), cover=(0.02, 0.06), sizes=(1, 1)),
    Maze((25, 25), corridor=5, reopened=0.5),
)


@pytest.mark.parametrize("radius", [slow(0.5), slow(1.5), 2.5])
def test_lines_for_a_robot_are_nearly_as_short_as_a_visibility_graph(radius: float) -> None:
    """Longer by the octagon alone, where the line and the graph's pass obstacles alike."""
    source = np.random.default_rng(21)
    ratios = []
    for family in SMALL_FAMILIES:
        for grid in generate(family, 8, range(4)).occupancy:
            inflated = inflate(grid, radius)
            if (inflated == 0).sum() < 20:
                continue
            start, goal = free_cells(inflated, source)
            path = astar(inflated, start, goal, Movement(8)).path
            if len(path) < 4:
                continue
            line = pull_taut(grid, path, radius)
            shortest = taut_reference.shortest_line_of_disc(grid, start, goal, radius)
            if is_same_side(grid, line, shortest):
                ratios.append(length_of(line) / length_of(shortest))
    assert len(ratios) >= 8
    assert min(ratios) > 1 - 0.004
    assert max(ratios) < 1.055
    assert np.mean(ratios) < 1.01


@pytest.mark.filterwarnings("ignore:radius_cells. a robot .* is within one cell")
@pytest.mark.parametrize("radius", [slow(0.3), 0.5, slow(1.5), 2.5])
def test_a_line_for_a_robot_is_never_longer_than_a_free_straight_line(
    some: Some, radius: float
) -> None:
    """Of the same homotopy class; and no bend can be left out."""
    source = np.random.default_rng(31)
    compared = 0
    for name in ("paper", "narrow", "cave", "forest", "noise"):
        for grid in generate(PRESETS[name], 5, range(some(20))).occupancy:
            inflated = inflate(grid, radius)
            if (inflated == 0).sum() < 2:
                continue
            start, goal = free_cells(inflated, source)
            path = astar(inflated, start, goal, Movement(8)).path
            if len(path) < 2:
                continue
            line = pull_taut(grid, path, radius)
            straight = np.array([start, goal]) + 0.5
            chords = [(line, straight)]
            chords += [(line[k : k + 3], line[k : k + 3 : 2]) for k in range(len(line) - 2)]
            for part, chord in chords:
                if lines_are_free([grid], [chord], radius)[0] and is_same_side(grid, part, chord):
                    assert length_of(part) <= length_of(chord) * (1 + 1e-12)
                    compared += 1
    assert compared >= some(10)


TOUCHING_RADII = [
    pytest.param(math.hypot(rows, columns), id=f"{rows}-{columns}")
    for rows, columns in ((0.5, 0.5), (1.5, 0.5), (1.5, 1.5), (2.5, 1.5), (2.0, 1.0))
]
"""Radii of robots that touch the corner of a cell from the middle, or a corner, of another cell."""


@pytest.mark.parametrize("radius", [0, 0.5, *TOUCHING_RADII])
def test_a_path_and_its_reverse_have_the_same_line(some: Some, radius: float) -> None:
    """Also where the octagon has no room, and the line follows the cells of the path."""
    source = np.random.default_rng(5)
    for _ in range(some(12)):
        grid = np.zeros((20, 24), np.uint8)
        for _ in range(4):
            row, column = source.integers(20), source.integers(24)
            rows, columns = (2, 9) if source.random() < 0.5 else (9, 2)
            grid[row : row + rows, column : column + columns] = 1
        inflated = inflate(grid, radius)
        ends = [free_cells(inflated, source) for _ in range(3)]
        paths = [astar(inflated, *cells, Movement(8)).path for cells in ends]
        for path in filter(len, paths):
            line = pull_taut(grid, path, radius)
            np.testing.assert_array_equal(pull_taut(grid, path[::-1], radius), line[::-1])


def test_a_line_that_follows_the_cells_is_pulled_from_both_ends() -> None:
    """Around one wall, from either end, as short as from the better one: 16.81 cells, not 17.81."""
    grid = np.zeros((17, 25), np.uint8)
    grid[1:3, 7:] = 1
    path = [(5, 5), (6, 5), *((7 + k, 6 + k) for k in range(5)), *((11, c) for c in range(11, 21))]
    radius = math.hypot(2.5, 1.5)
    lines = [pull_taut(grid, way, radius) for way in (path, path[::-1])]
    assert lines_are_free([grid], [lines[0]], radius).all()
    assert [length_of(line) for line in lines] == pytest.approx([16.81, 16.81], abs=0.01)


def test_the_symmetries_of_a_map_move_its_taut_lines() -> None:
    """Turned and mirrored maps have turned and mirrored lines."""
    source = np.random.default_rng(9)
    for grid in random_grids(6, 14, 17):
        start, goal = free_cells(grid, source)
        path = astar(grid, start, goal, Movement(8)).path
        if len(path) == 0:
            continue
        for radius in (0, 0.4):
            line = pull_taut(grid, path, radius)
            transposed = pull_taut(grid.T, path[:, ::-1], radius)
            np.testing.assert_array_equal(transposed, line[:, ::-1])
            flipped = pull_taut(grid[::-1], path * [-1, 1] + [len(grid) - 1, 0], radius)
            np.testing.assert_array_equal(flipped, line * [-1, 1] + [len(grid), 0])


def serve(
    problems: list[Problem], count: int, radius: float = 0
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int64]]:
    """Return the waypoints of each problem, (B, count, 2), and the statuses."""
    waypoints = np.empty((len(problems), count, 2), np.float32)
    statuses = np.empty(len(problems), np.int64)
    for number, (grid, path, movement) in enumerate(problems):
        offsets = np.array([0, len(path)])
        statuses[number] = write_waypoints(
            grid[None],
            np.ascontiguousarray(path),
            offsets,
            robot_of(radius),
            movement.corner_cutting,
            waypoints[number : number + 1],
        )[0]
    return waypoints, statuses


@pytest.mark.parametrize("count", [2, 8, 32, 128])
def test_waypoints_contain_all_bends(count: int, problems: list[Problem]) -> None:
    """In order; where they do not fit, all waypoints are -1 and the status says how many."""
    waypoints, statuses = serve(problems, count)
    refused = 0
    for (grid, path, _), points, bends in zip(problems, waypoints, statuses, strict=True):
        line = pull_taut(grid, path)
        assert bends == max(len(line) - 2, 0)
        if bends > count - 2:
            assert (points == -1).all()
            refused += 1
            continue
        rows = {tuple(point): row for row, point in reversed([*enumerate(points.tolist())])}
        order = [rows[tuple(point)] for point in line.tolist()]
        assert order == sorted(order)
        assert -1e-9 <= length_of(points) - length_of(line) <= 1e-3 * len(points)
    assert refused > 0 or count > 30


def test_waypoints_are_free_and_multiples_of_a_256th(problems: list[Problem]) -> None:
    """The oracle tests the points that are served."""
    waypoints, statuses = serve(problems[::4], 32)
    for (grid, _, movement), points, bends in zip(problems[::4], waypoints, statuses, strict=True):
        if bends > 30:
            continue
        np.testing.assert_array_equal(points * CELL, np.round(points * CELL))
        for start, end in pairwise(taut_reference.in_fractions(points.astype(float))):
            assert taut_reference.is_free_segment(grid, start, end, movement.corner_cutting)


def test_points_beside_corners_that_a_line_touches_are_not_rounded_into_obstacles() -> None:
    """A line from (0.5, 0.5) to (2.5, 6.5) touches corners at (1, 2) and (2, 5)."""
    grid = np.zeros((3, 7), np.uint8)
    grid[1, 1] = grid[2, 4] = 1
    path = np.array([(0, 0), (0, 1), (0, 2), (1, 3), (1, 4), (1, 5), (2, 6)])
    np.testing.assert_array_equal(pull_taut(grid, path), [[0.5, 0.5], [2.5, 6.5]])
    collisions = 0
    for count in range(3, 60):
        points = serve([Problem(grid, path, Movement(8))], count)[0].astype(float)
        assert lines_are_free([grid], points).all()
        share = np.linspace(0, 1, count)[:, None]
        rounded = np.rint((0.5 + share * [2, 6]) * CELL) / CELL
        collisions += not lines_are_free([grid], [rounded])[0]
        assert np.abs(points[0] - rounded).max() <= 6 / 128
    assert collisions > 10


def test_waypoints_divide_the_line_evenly(problems: list[Problem]) -> None:
    """A point less on any segment would make its gaps at least as wide as the widest one.

    Gaps within a segment differ by rounding, except on a few segments that touch obstacles.
    """
    waypoints, statuses = serve(problems, 32)
    differences = []
    for (grid, path, _), points, bends in zip(problems, waypoints, statuses, strict=True):
        if bends > 30 or len(path) < 2:
            continue
        gaps = np.hypot(*np.diff(points.astype(float), axis=0).T)
        line = pull_taut(grid, path)
        ends = [int(np.flatnonzero((points == bend).all(axis=1))[0]) for bend in line]
        lengths = np.hypot(*np.diff(line, axis=0).T)
        parts = np.diff(ends)
        widest = (lengths / parts).max()
        assert (lengths[parts > 1] / (parts[parts > 1] - 1) >= widest - 1e-9).all()
        segments = [gaps[first:last] for first, last in pairwise(ends)]
        differences += [segment.max() - segment.min() for segment in segments]
    assert len(differences) > 100
    assert np.mean(np.array(differences) <= 2 * math.sqrt(2) / CELL) > 0.8


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:radius_cells. a robot .* is within one cell")
def test_waypoints_for_a_robot_keep_its_distance() -> None:
    """By the exact oracle, although points between the bends are rounded."""
    source = np.random.default_rng(2)
    for radius in (0.4, 1.1):
        grid = (source.random((18, 20)) < 0.03).astype(np.uint8)
        inflated = inflate(grid, radius)
        start, goal = free_cells(inflated, source)
        path = astar(inflated, start, goal, Movement(8)).path
        waypoints, statuses = serve([Problem(grid, path, Movement(8))], 32, radius)
        assert statuses[0] >= 0
        for before, after in pairwise(taut_reference.in_fractions(waypoints[0].astype(float))):
            squared = taut_reference.squared_distance(grid, before, after)
            assert float(squared) >= radius**2 * (1 - 3e-7)


def test_problems_without_a_path_have_no_waypoints() -> None:
    """Their points are -1; a path of one cell has its middle T times."""
    problems = [
        Problem(np.zeros((3, 3), np.uint8), np.empty((0, 2), np.int64), Movement(8)),
        Problem(np.zeros((3, 3), np.uint8), np.array([(1, 2)]), Movement(8)),
    ]
    waypoints, statuses = serve(problems, 4)
    assert statuses.tolist() == [NO_PATH, 0]
    assert waypoints.tolist() == [[[-1, -1]] * 4, [[1.5, 2.5]] * 4]


def test_pulling_refuses_what_it_cannot_serve() -> None:
    """With the names of the arguments."""
    free = np.zeros((3, 4), np.uint8)
    with pytest.raises(ValueError, match=r"path: move 0, from \(0, 0\) to \(0, 2\), leads"):
        pull_taut(free, [(0, 0), (0, 2)])
    with pytest.raises(ValueError, match="path: got no cell"):
        pull_taut(free, [])
    with pytest.raises(ValueError, match=r"path: cell 0, \(0, 0\) is on an occupied cell"):
        pull_taut(free, [(0, 0), (0, 1)], radius_cells=1)
    with pytest.raises(ValueError, match="radius_cells: got -1, expected a number of at"):
        pull_taut(free, [(0, 0)], radius_cells=-1)
    with pytest.raises(ValueError, match="grid: got 1 x 65537 cells, expected at most 65,536"):
        pull_taut(np.zeros((1, MAX_TAUT_SIDE + 1), np.uint8), [(0, 0)])
    with pytest.raises(ValueError, match="grid: got 1 x 65537 cells, expected at most 65,536"):
        path_waypoints(np.zeros((1, MAX_TAUT_SIDE + 1), np.uint8), [(0, 0)])
    with pytest.raises(ValueError, match="count: got 1, expected"):
        path_waypoints(free, [(0, 0)], 1)
    with pytest.raises(ValueError, match=r"path: move 0, from \(0, 0\) to \(1, 1\)"):
        path_waypoints([[0, 1], [0, 0]], [(0, 0), (1, 1)])
