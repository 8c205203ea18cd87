"""Problems exist under the movement and for the robot that are served, whatever is stored.

Truth comes from scipy: shortest paths on its graphs, and maps inflated by its dilation.
"""

from __future__ import annotations

import pickle
import shutil
from dataclasses import replace
from functools import cache
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
from helpers import reference, samples
from helpers.grids import scipy_distances
from helpers.reference import Cell
from helpers.specs import MOVEMENTS, movements
from scipy import ndimage

from mapdata import (
    MapDataModule,
    MapDataset,
    MapSpec,
    Movement,
    OnlineMapDataset,
    Pairs,
    Random,
    Route,
    ShardError,
    generate,
)
from mapdata.formats import Collection, ForeignMap, import_maps

Array = npt.NDArray[Any]

RESOLUTION = 0.1
"""Metres a cell."""

SIZE = (14, 70)
FIRST_COLUMN = 53
"""All columns before are occupied: what is drawn lies on both sides of the 64 of a machine word."""

SEED_POINTS = 6
SPLITS = ("train", "val", "test")

STORED = {
    "4": Movement(),
    "8": Movement(8),
    "8-cutting": Movement(8, corner_cutting=True),
}
RADII = (0.0, 0.1)
"""Metres: the second takes away the cells that touch an obstacle."""

FIELDS = ("map", "start", "goal", "path", "length", "cost", "problem")


def noise(source: np.random.Generator) -> Array:
    """Return free cells, many of which touch at a corner only."""
    is_free = source.random(SIZE) < 0.55
    is_free[:, :FIRST_COLUMN] = False
    return is_free


def wide_diagonals(source: np.random.Generator) -> Array:
    """Return corridors that a robot of one cell follows by diagonal moves only."""
    line = np.zeros(SIZE, np.bool_)
    for _ in range(4):
        row, column = source.integers(1, 9, 2)
        steps = np.arange(source.integers(2, 6))
        line[row + steps, FIRST_COLUMN + column + steps] = True
    return np.asarray(ndimage.binary_dilation(line, np.ones((3, 3))))


class StoredMap(NamedTuple):
    """One map of the datasets, 0 free and 1 occupied; its seed points, some of them twice."""

    grid: Array
    points: list[Cell]
    split: int


def stored_maps(count: int = 14) -> list[StoredMap]:
    """Return maps whose connected components depend on the movement and the radius."""
    source = np.random.default_rng(3)
    maps = []
    for number in range(count):
        draw = wide_diagonals if number % 2 else noise
        grid = 1 - draw(source).astype(np.uint8)
        # Where a robot has room, so that a radius leaves problems.
        free = np.argwhere(inflated(grid, 0.1 if number % 2 else 0.0) == 0)
        points = free[source.integers(0, len(free), SEED_POINTS)].tolist()
        maps.append(StoredMap(grid, [(row, column) for row, column in points], number % 3))
    return maps


@pytest.fixture(scope="module")
def roots(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Datasets of the same maps in three shards, with labels under each stored movement."""
    folder = tmp_path_factory.mktemp("served")
    for name, movement in STORED.items():
        import_to(folder / name, stored_maps(), movement)
    return {name: str(folder / name) for name in STORED}


def import_to(root: Path, maps: list[StoredMap], movement: Movement) -> None:
    """Make a dataset of some maps, with labels under a movement."""
    foreign = [
        ForeignMap(
            f"map {number}",
            grid,
            split=split,
            seed_points=np.array(points),
            rooms_known=True,
        )
        for number, (grid, points, split) in enumerate(maps)
    ]
    import_maps(root, Collection(foreign), movement=movement, resolution=RESOLUTION, shard_size=5)


def inflated(grid: Array, radius: float) -> Array:
    """Return a map on which a robot moves: cells within the radius of an obstacle are occupied.

    The edge of a cell is half a cell nearer than its middle, in rows as in columns.
    """
    reach = 2
    away = np.maximum(np.abs(np.arange(-reach, reach + 1)) - 0.5, 0)
    is_too_near = away[:, None] ** 2 + away**2 < (radius / RESOLUTION) ** 2
    is_too_near[reach, reach] = True
    walled = np.pad(grid, reach, constant_values=1)
    dilated = np.asarray(ndimage.binary_dilation(walled, is_too_near))
    return dilated[reach:-reach, reach:-reach].astype(np.uint8)


class TrueMap(NamedTuple):
    """One map as it is served, its seed points and the costs between them, -1 without a path."""

    grid: Array
    points: list[Cell]
    costs: Array


def true_map(grid: Array, points: list[Cell], movement: Movement, radius: float) -> TrueMap:
    """Return a map as it is served for a robot, with the costs that scipy finds."""
    served = inflated(grid, radius)
    distances = scipy_distances(served, points, movement)
    costs = np.array([[field[point] for point in points] for field in distances])
    # From a cell to itself scipy says 0, on an occupied cell, too.
    has_no_room = [served[point] == 1 for point in points]
    costs[has_no_room] = -1
    return TrueMap(served, points, costs)


@cache
def true_maps(movement: Movement, radius: float, search: str = "astar") -> list[TrueMap]:
    """Return all maps of the datasets as they are served; BFS counts moves."""
    if search == "bfs" and movement.connectivity == 8:
        movement = replace(movement, diagonal_cost=1)
    return [true_map(grid, points, movement, radius) for grid, points, _ in stored_maps()]


class Problem(NamedTuple):
    """A map of `true_maps` and two of its seed points."""

    number: int
    first: int
    second: int


def true_problems(source: Route | Pairs, maps: list[TrueMap]) -> list[Problem]:
    """Return the problems of a source on some maps, in their order."""
    problems = []
    for number, (_, points, costs) in enumerate(maps):
        seeds = range(len(points))
        for first, second in (
            pairwise(seeds) if isinstance(source, Route) else combinations(seeds, 2)
        ):
            leads_away = points[first] != points[second]
            if leads_away and (costs[first, second] > 0 or source.unsolvable):
                problems.append(Problem(number, first, second))
    return problems


def numbered_problems(source: Route | Pairs, stored: Movement, served: Movement) -> list[Problem]:
    """Return the problems in the order of the field `problem`.

    They are those of the stored movement; where the served one alone cuts corners they are all.
    """
    if served.corner_cutting and not stored.corner_cutting:
        source = replace(source, unsolvable=True)
    return true_problems(source, true_maps(stored, 0.0))


SOURCES: list[Route | Pairs] = [Route(), Route(unsolvable=True), Pairs(), Pairs(unsolvable=True)]


@pytest.mark.parametrize("radius", RADII)
@pytest.mark.parametrize("stored", STORED)
@movements
def test_problems_are_those_of_the_served_movement(
    roots: dict[str, str], stored: str, movement: Movement, radius: float
) -> None:
    """Exactly the problems that have a path are served, or all where that is asked for."""
    for source in SOURCES:
        for search in ("astar", "bfs"):
            maps = true_maps(movement, radius, search)
            truth = true_problems(source, maps)
            dataset = MapDataset(
                roots[stored],
                fields=FIELDS,
                problems=source,
                search=search,
                movement=movement,
                radius=radius,
            )
            assert len(dataset) == len(truth) > 5
            batch = dataset[:]
            grids = np.array([maps[problem.number].grid for problem in truth])
            np.testing.assert_array_equal(batch.map[:, 0], grids)
            starts = [maps[number].points[first] for number, first, _ in truth]
            goals = [maps[number].points[second] for number, _, second in truth]
            costs = [maps[number].costs[first, second] for number, first, second in truth]
            assert batch.start.tolist() == [list(cell) for cell in starts]
            assert batch.goal.tolist() == [list(cell) for cell in goals]
            np.testing.assert_allclose(batch.cost, costs, rtol=1e-6)
            assert ((batch.length > 0) == (batch.cost > 0)).all()
            numbered = numbered_problems(source, STORED[stored], movement)
            assert [numbered[number] for number in batch.problem.tolist()] == truth
            for k in range(0, len(truth), 7):
                path = samples.cells_of(batch.path[k])
                assert len(path) == batch.length[k]
                if path:
                    assert (path[0], path[-1]) == (starts[k], goals[k])
                    assert reference.first_bad_step(grids[k].tolist(), path, movement) is None


@pytest.mark.parametrize("radius", RADII)
def test_corner_cutting_makes_a_difference_on_these_maps(radius: float) -> None:
    """Otherwise the test above would compare equal sets of problems."""
    for source in (Route(), Pairs()):
        without, with_cutting = (
            set(true_problems(source, true_maps(movement, radius)))
            for movement in (Movement(8), Movement(8, corner_cutting=True))
        )
        assert without < with_cutting
        assert set(true_problems(source, true_maps(Movement(), radius))) == without
        assert len(with_cutting - without) > 4


ROOMS = MapSpec((16, 16), (5, 7), (1, 5), (1, 5), passage_width=(1, 2), skip_probability=0.7)


@movements
@pytest.mark.parametrize("radius", RADII)
def test_online_problems_are_those_of_the_served_movement(
    movement: Movement, radius: float
) -> None:
    """A map that has a problem with a path gives one; another map takes the place of the others."""
    count = 16
    drawn = generate(ROOMS, 5, range(count))
    points_of_maps = [
        [(row, column) for row, column in points[:rooms].tolist()]
        for points, rooms in zip(drawn.seed_points, drawn.rooms, strict=True)
    ]
    maps = [
        true_map(grid, points, movement, radius)
        for grid, points in zip(drawn.occupancy, points_of_maps, strict=True)
    ]
    for source in SOURCES:
        dataset = OnlineMapDataset(
            ROOMS, 5, count, fields=FIELDS, problems=source, movement=movement, radius=radius
        )
        batch = dataset[:]
        assert (batch.cost > 0).all() or source.unsolvable
        problems = true_problems(source, maps)
        for number, (grid, points, costs) in enumerate(maps):
            true_costs = {
                (points[problem.first], points[problem.second]): costs[problem[1:]]
                for problem in problems
                if problem.number == number
            }
            if true_costs:
                ends = (samples.cell_of(batch.start[number]), samples.cell_of(batch.goal[number]))
                np.testing.assert_array_equal(batch.map[number, 0], grid)
                assert float(batch.cost[number]) == pytest.approx(true_costs[ends], rel=1e-6)
            else:
                assert not np.array_equal(batch.map[number, 0], grid)


@movements
@pytest.mark.parametrize("radius", RADII)
def test_random_problems_have_a_path_under_the_served_movement(
    roots: dict[str, str], movement: Movement, radius: float
) -> None:
    """Start and goal are free cells of the served map, and the cost is that of scipy's path."""
    dataset = MapDataset(
        roots["4"], fields=FIELDS, problems=Random(), movement=movement, radius=radius
    )
    for sample in dataset:
        start, goal = samples.cell_of(sample.start), samples.cell_of(sample.goal)
        distances = scipy_distances(np.asarray(sample.map[0]), [start], movement)
        assert float(sample.cost) == pytest.approx(distances[0][goal], rel=1e-6)
        assert sample.cost > 0


CUTTING = Movement(8, corner_cutting=True)


def test_the_number_of_a_problem_leads_to_it(roots: dict[str, str]) -> None:
    """In the dataset that keeps problems without a path; filters and a radius change no number."""
    fields = ("problem", "start", "goal", "seed_points")
    for radius in RADII:
        dataset = MapDataset(roots["4"], fields=fields, movement=CUTTING, radius=radius)
        every = MapDataset(roots["4"], fields=fields, problems=Route(unsolvable=True))
        for view in (dataset, dataset.filter(rooms=(4, 6))):
            assert 5 < len(view) < len(every)
            samples.assert_same(view[:], every[view[:].problem])


@pytest.mark.parametrize("radius", RADII)
def test_splits_and_roots_add_up(roots: dict[str, str], tmp_path: Path, radius: float) -> None:
    """Each split has its own problems, and those of a second root come after those of the first."""
    how: dict[str, Any] = {
        "fields": ("map", "start", "goal"),
        "movement": CUTTING,
        "radius": radius,
    }
    whole = MapDataset(roots["4"], problems="pairs", **how)
    splits = [MapDataset(roots["4"], split, problems="pairs", **how) for split in SPLITS]
    assert sum(map(len, splits)) == len(whole)
    in_split = [stored.split for stored in stored_maps()]
    maps = true_maps(CUTTING, radius)
    for code, dataset in enumerate(splits):
        truth = [
            problem for problem in true_problems(Pairs(), maps) if in_split[problem.number] == code
        ]
        assert len(dataset) == len(truth) > 5
        grids = [maps[problem.number].grid for problem in truth]
        np.testing.assert_array_equal(dataset[:].map[:, 0], grids)

    other = tmp_path / "other"
    import_to(other, stored_maps(4)[::-1], Movement())
    second = MapDataset(other, problems="pairs", **how)
    both = MapDataset([roots["4"], f"file://{other}"], problems="pairs", **how)
    assert len(both) == len(whole) + len(second)
    samples.assert_same(both[: len(whole)], whole[:])
    samples.assert_same(both[len(whole) :], second[:])


def test_views_copies_and_modules_serve_the_same_problems(roots: dict[str, str]) -> None:
    """A pickled dataset, as workers started by spawn get it; a filtered one; that of a module."""
    how: dict[str, Any] = {"fields": FIELDS, "movement": CUTTING}
    dataset = MapDataset(roots["8"], "train", augment=True, **how)
    assert len(dataset) > len(MapDataset(roots["8"], "train"))
    again = pickle.loads(pickle.dumps(dataset))
    samples.assert_same(again[:], dataset[:])
    plain = MapDataset(roots["8"], "train", **how)
    lengths = plain[:].length
    median = int(lengths.median())
    view = plain.filter(path_length=(None, median))
    assert 0 < len(view) < len(plain)
    samples.assert_same(view[:], plain[np.flatnonzero(lengths <= median)])
    samples.assert_same(pickle.loads(pickle.dumps(view))[:], view[:])
    samples.assert_same(plain.filter(reachable=True)[:], plain[:])
    module = MapDataModule(roots["8"], batch_size=len(dataset), augment=True, **how)
    (batch,) = module.train_dataloader()
    order = batch.problem.argsort()
    by_number = batch._make(field[order] for field in batch)
    samples.assert_same(by_number, dataset[:])


@pytest.mark.parametrize("served", MOVEMENTS, ids=str)
@pytest.mark.parametrize("stored", STORED)
def test_shards_are_opened_only_where_corners_are_treated_otherwise(
    roots: dict[str, str], tmp_path: Path, stored: str, served: Movement
) -> None:
    """Stored labels say which problems have a path under any other movement, at no cost."""
    root = tmp_path / "maps"
    shutil.copytree(roots[stored], root)
    for shard in root.glob("*.h5"):
        shard.write_bytes(b"")
    stored_labels_decide: list[Route | Random] = [Route(unsolvable=True), Random()]
    if served.corner_cutting == STORED[stored].corner_cutting:
        stored_labels_decide.append(Route())
    else:
        with pytest.raises(ShardError):
            MapDataset(root, movement=served)
    for source in stored_labels_decide:
        whole = MapDataset(roots[stored], movement=served, problems=source)
        assert len(MapDataset(root, movement=served, problems=source)) == len(whole) > 0
