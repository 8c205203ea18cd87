"""The field ``waypoints``: stored, online and augmented samples have their paths' taut lines."""

from __future__ import annotations

import pickle
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import torch
from helpers import samples, taut_reference
from helpers.examples import Some
from torch.utils.data import DataLoader

from mapdata import (
    MapDataModule,
    MapDataset,
    Movement,
    OnlineMapDataset,
    Route,
    Waypoints,
    pull_taut,
)
from mapdata.datasets import Batch
from mapdata.datasets.fields import Rooms
from mapdata.problems.drawing import Paths
from mapdata.search import path_waypoints
from mapdata.search.map_stack import MapStack

RADIUS = 0.09
"""Metres; cells of 0.1 m beside obstacles are left out."""

RESOLUTION = 0.1
SEED = 6
MAPS = 24
FIELDS = ("map", "start", "goal", "path", "waypoints")


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A dataset of 24 maps."""
    folder = tmp_path_factory.mktemp("waypoints")
    return samples.build_small(folder / "maps", samples.SPEC, maps=MAPS, seed=SEED)


def check_sample(sample: Any, obstacles: Any, radius: float = 0) -> None:
    """Assert that the waypoints of a sample are those of its path.

    Args:
        sample: with `FIELDS`.
        obstacles: (H, W), the map that is not inflated.
        radius: of the robot, in cells.
    """
    points = sample.waypoints.numpy()
    assert points.dtype == np.float32
    bends = pull_taut(obstacles, sample.path, radius)
    assert {tuple(point) for point in bends} <= {tuple(point) for point in points.tolist()}
    np.testing.assert_array_equal(points[0], sample.start + 0.5)
    np.testing.assert_array_equal(points[-1], sample.goal + 0.5)
    fractions = [(Fraction(row), Fraction(column)) for row, column in points.tolist()]
    segments = [*pairwise(fractions)]
    for before, after in segments:
        assert taut_reference.is_free_segment(obstacles, before, after, corner_cutting=False)
    for before, after in segments[:: 10 if radius else 100]:  # the oracle visits all cells
        squared = taut_reference.squared_distance(obstacles, before, after)
        assert float(squared) >= radius**2 * (1 - 3e-7)


@pytest.mark.parametrize(
    "movement", [Movement(8), pytest.param(Movement(4), marks=pytest.mark.slow)]
)
def test_stored_online_and_augmented_problems_have_taut_lines(
    some: Some, root: str, movement: Movement
) -> None:
    """Under a movement that is stored, and under one that is not."""
    datasets = (
        MapDataset(root, fields=FIELDS, movement=movement),
        MapDataset(root, fields=FIELDS, movement=movement, problems="pairs", search="bfs"),
        MapDataset(root, fields=FIELDS, movement=movement, augment=True),
        OnlineMapDataset(samples.SPEC, SEED, MAPS, fields=FIELDS, movement=movement),
        OnlineMapDataset(
            samples.SPEC, SEED, MAPS, fields=FIELDS, movement=movement, problems="random"
        ),
    )
    for dataset in datasets:
        assert dataset[:8].waypoints.shape == (8, 32, 2)
        for index in range(some(8)):
            sample = dataset[index]
            check_sample(sample, sample.map[0].numpy())


@pytest.mark.parametrize("family", ["dungeon", "noise", "forest"])
@pytest.mark.parametrize("movement", [Movement(4), Movement(8), Movement(8, corner_cutting=True)])
def test_paths_of_planners_have_the_points_of_the_field(family: str, movement: Movement) -> None:
    """`path_waypoints` of the path that a dataset serves are the waypoints that it serves."""
    fields = ("map", "path", Waypoints(48, fill=True))
    samples_of_family = OnlineMapDataset(
        family, SEED, 40, fields=fields, movement=movement, problems="random"
    )[:]
    refused = 0
    for grids, padded, expected in zip(*samples_of_family, strict=True):
        path = padded[padded[:, 0] >= 0]
        cuts_corners = movement.corner_cutting
        if expected[0, 0] < 0:
            bends = len(pull_taut(grids[0], path)) - 2
            with pytest.raises(ValueError, match=f"count: got 48 points for a line of {bends} ben"):
                path_waypoints(grids[0], path, 48, corner_cutting=cuts_corners)
            refused += 1
            continue
        points = path_waypoints(grids[0], path, 48, corner_cutting=cuts_corners)
        np.testing.assert_array_equal(points, expected)
    assert refused < 20


@pytest.mark.slow
@pytest.mark.parametrize("augment", [False, True])
def test_lines_for_a_robot_avoid_the_obstacles_of_the_map_that_is_not_inflated(
    root: str, augment: bool
) -> None:
    """They keep the radius from them, where the inflated map has room for shorter ones."""
    options: dict[str, Any] = {"fields": FIELDS, "movement": Movement(8), "augment": augment}
    for name, dataset, point_robot in (
        (
            "stored",
            MapDataset(root, radius=RADIUS, problems="random", **options),
            MapDataset(root, problems="random", **options),
        ),
        (
            "online",
            OnlineMapDataset(samples.SPEC, SEED, MAPS, radius=RADIUS, problems="random", **options),
            OnlineMapDataset(samples.SPEC, SEED, MAPS, problems="random", **options),
        ),
    ):
        checked = 0
        for index in range(3):
            sample = dataset[index]
            obstacles = point_robot[index].map[0].numpy()
            if not (sample.map[0].numpy() >= obstacles).all():
                continue  # a map without room for the robot was replaced by another one
            check_sample(sample, obstacles, RADIUS / RESOLUTION)
            checked += 1
        assert checked >= 2, name


def test_the_number_of_points_is_that_of_the_field(root: str) -> None:
    """`Waypoints` stands among the names, under the name ``waypoints``, for workers, too."""
    fields = ("path", Waypoints(7))
    dataset = pickle.loads(pickle.dumps(MapDataset(root, "train", fields=fields)))
    assert dataset[0]._fields == ("path", "waypoints")
    assert dataset[:5].waypoints.shape == (5, 7, 2)
    batch = next(iter(DataLoader(dataset, 4)))
    assert torch.equal(batch.waypoints, dataset[:4].waypoints)
    assert OnlineMapDataset("paper", length=3, fields=fields)[:].waypoints.shape == (3, 7, 2)
    module = MapDataModule(root, fields=fields, batch_size=4)
    module.setup("fit")
    assert module.datasets["train"][0].waypoints.shape == (7, 2)


def test_lines_with_more_bends_than_fit_are_refused_filled_or_left_out() -> None:
    """An error names the first such problem and what to do; a filter leaves them out."""
    mazes = OnlineMapDataset("maze", length=6, fields=("path", "waypoints"))
    message = (
        r"waypoints: problem \d has a line of \d+ bends, expected at most 30 for 32 points: "
        r"take Waypoints\(\d+\), Waypoints\(32, fill=True\), "
        r"or MapDataset.filter\(bends=\(0, 30\)\)"
    )
    with pytest.raises(ValueError, match=message):
        mazes[:]
    filled = OnlineMapDataset("maze", length=6, fields=("map", "path", Waypoints(32, fill=True)))[:]
    is_filled = (filled.waypoints == -1).all(dim=(1, 2))
    for k in range(6):
        path = filled.path[k][filled.path[k][:, 0] >= 0]
        bends = len(pull_taut(filled.map[k, 0], path)) - 2
        assert is_filled[k] == (bends > 30)
    assert is_filled.any()


def test_a_line_with_all_but_one_of_its_points_is_refused() -> None:
    """Start, bends and goal need a point each: T - 2 bends fit into T points, T - 1 do not."""
    mazes = OnlineMapDataset("maze", length=1, fields=("map", "path"))
    bends = len(pull_taut(mazes[0].map[0], mazes[0].path)) - 2
    fitting = OnlineMapDataset("maze", length=1, fields=(Waypoints(bends + 2),))
    assert fitting[:].waypoints.min() >= 0
    too_few = OnlineMapDataset("maze", length=1, fields=(Waypoints(bends + 1),))
    with pytest.raises(ValueError, match=f"{bends} bends, expected at most {bends - 1} for"):
        too_few[:]


def test_a_filter_limits_the_number_of_bends(root: str) -> None:
    """So that all lines that it leaves fit."""
    dataset = MapDataset(root, problems="pairs", fields=("map", "path", Waypoints(130)))
    bends = [len(pull_taut(sample.map[0], sample.path)) - 2 for sample in dataset]
    few = MapDataset(root, problems="pairs", fields=(Waypoints(4),)).filter(bends=(0, 2))
    assert len(few) == sum(count <= 2 for count in bends) < len(dataset)
    assert few[:].waypoints.min() >= 0
    assert len(dataset.filter(bends=(1, 3))) == sum(1 <= count <= 3 for count in bends)


def test_problems_without_a_path_have_points_of_minus_one() -> None:
    """As ``path`` has, without an error."""
    spec = samples.SPEC
    dataset = OnlineMapDataset(
        spec, 1, 40, problems=Route(unsolvable=True), fields=("length", "waypoints")
    )
    batch = dataset[:]
    without_path = batch.length == 0
    assert without_path.any()
    assert (batch.waypoints[without_path] == -1).all()
    assert (batch.waypoints[~without_path] >= 0).all()


def test_a_robot_that_cuts_corners_may_have_no_free_line() -> None:
    """The error says why, and ``fill`` serves the others."""
    options: dict[str, Any] = {
        "length": 40,
        "problems": "random",
        "movement": Movement(8, corner_cutting=True),
        "radius": 0.03,
    }
    with pytest.raises(ValueError, match=r"has no free line for a radius of 0.3 cells, expected"):
        OnlineMapDataset("cave", fields=("waypoints",), **options)[:]
    batch = OnlineMapDataset("cave", fields=(Waypoints(fill=True),), **options)[:]
    is_filled = (batch.waypoints == -1).all(dim=(1, 2))
    assert 0 < is_filled.sum() < 40


def test_a_path_through_a_wall_is_named() -> None:
    """As damaged data may have it, although its hashes fit."""

    def no_rooms() -> Rooms:
        raise AssertionError("no field needs the rooms")

    wall = np.array([[[0, 1, 0]]], np.uint8)
    path = np.array([(0, 0), (0, 1), (0, 2)])
    batch = Batch(
        movement=Movement(8),
        search="astar",
        grids=wall,
        starts=path[:1],
        goals=path[2:],
        problems=np.array([17]),
        compute_map_indices=lambda: np.array([5]),
        compute_rooms=no_rooms,
        compute_map_numbers=lambda: np.array([5]),
        compute_stored_maps=lambda: MapStack(wall, None),
        symmetries=np.zeros(1, np.int64),
        requested_fields=("waypoints",),
        compute_paths=lambda _: Paths(path, np.array([0, 3]), np.array([3])),
    )
    with pytest.raises(ValueError, match="problem 17 has a stored path through occupied cells"):
        Waypoints()(batch)
    assert (Waypoints(fill=True)(batch) == -1).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"count": 1}, "count: got 1, expected an integer of at least 2"),
        ({"count": 2.5}, "count: got 2.5, expected an integer"),
        ({"fill": 1}, "fill: got 1, expected True or False"),
    ],
)
def test_waypoints_refuse_what_is_no_option(arguments: Any, message: str) -> None:
    """With the name of the option."""
    with pytest.raises(ValueError, match=message):
        Waypoints(**arguments)
