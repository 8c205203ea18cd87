"""Costmaps from drives: reading of drives, the fit, Nav2's formulas, files for map_server."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mapdata import check_path, search_batch, terrain_from_costs
from mapdata.arrays import Bytes, Floats, Ints
from mapdata.formats.ros import RosMap, read_map
from mapdata.models import CostPredictor, fit_costmap
from mapdata.models.costmap import (
    MAX_OCCUPANCY,
    MOVEMENT,
    Costmap,
    cells_of_drive,
    clearance_plane,
    inflation_costs,
    read_drives,
    site_of,
)
from mapdata.search import clearance

RESOLUTION = 0.1
RADIUS = 0.15


def office(origin: tuple[float, float, float] = (-3.0, 2.0, 0.0)) -> RosMap:
    """Return a hall of 4 x 6 m with three pillars, and a wall around it."""
    cells = np.zeros((40, 60), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    for column in (14, 30, 46):
        cells[16:24, column : column + 4] = 100
    return RosMap(cells, RESOLUTION, origin)


def hidden_terrain(site_grid: Bytes, obstacles: Bytes) -> Bytes:
    """Return the costs of a driver who keeps .6 m from walls."""
    costs = 1 + 6 * np.abs(np.minimum(clearance(obstacles) * RESOLUTION, 1.5) - 0.6)
    terrain: Bytes = terrain_from_costs(np.where(site_grid, 1, costs)[None], site_grid[None])[0]
    return terrain


def problems(grid: Bytes, count: int, seed: int) -> list[tuple[Ints, Ints]]:
    """Return pairs of free cells, (1, 2) each, at least 25 cells apart."""
    rng = np.random.default_rng(seed)
    free = np.argwhere(grid == 0)
    pairs: list[tuple[Ints, Ints]] = []
    while len(pairs) < count:
        start, goal = free[rng.integers(len(free), size=2)]
        if abs(start - goal).max() >= 25:
            pairs.append((start[None], goal[None]))
    return pairs


def path_on(grid: Bytes, terrain: Bytes, ends: tuple[Ints, Ints]) -> Ints:
    """Return the cheapest path between two cells."""
    return search_batch("astar", grid[None], *ends, MOVEMENT, terrain=terrain[None]).cells


def drives_on(ros_map: RosMap, count: int) -> pd.DataFrame:
    """Return drives of the driver of `hidden_terrain`."""
    site = site_of(ros_map, RADIUS)
    terrain = hidden_terrain(site.grid, ros_map.grid())
    tables = []
    for number, ends in enumerate(problems(site.grid, count, 1)):
        poses = ros_map.to_metres(cells=path_on(site.grid, terrain, ends))
        tables.append(pd.DataFrame({"x": poses[:, 0], "y": poses[:, 1], "drive": number}))
    return pd.concat(tables)


@pytest.fixture(scope="module")
def costmap() -> Costmap:
    """Return a quick fit."""
    return fit_costmap(office(), drives_on(office(), 8), robot_radius=RADIUS, starts=2, steps=60)


# --- drives -------------------------------------------------------------------------------------


def test_drives_are_told_apart_by_numbers_or_gaps(tmp_path: Path) -> None:
    """A column ``drive`` decides; without it a gap of more than a metre does."""
    poses = [[0, 0], [0.5, 0], [1.2, 0], [3, 0], [3, 0.9]]
    table = pd.DataFrame(poses, columns=["x", "y"])
    assert [len(drive) for drive in read_drives(table)] == [3, 2]
    table.assign(drive=["b", "b", "a", "a", "b"]).to_csv(tmp_path / "drives.csv", index=False)
    by_name = read_drives(tmp_path / "drives.csv")
    assert [drive.tolist() for drive in by_name] == [
        [[0, 0], [0.5, 0], [3, 0.9]],
        [[1.2, 0], [3, 0]],
    ]


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (pd.DataFrame({"x": [1.0], "z": [1.0]}), "got the columns x, z, expected x and y"),
        (pd.DataFrame({"x": [1.0, math.nan], "y": [1.0, 1.0]}), r"row 1 has \[nan, 1.0\]"),
    ],
    ids=["column", "nan"],
)
def test_bad_tables_are_refused(table: pd.DataFrame, message: str) -> None:
    """The message names the column or the row."""
    with pytest.raises(ValueError, match=message):
        read_drives(table)


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.0])
def test_poses_are_snapped_to_the_cells_of_map_server(yaw: float) -> None:
    """Cells equal those of `RosMap.to_cells`, on maps that are turned as well."""
    ros_map = office((-3.0, 2.0, yaw))
    cells = np.stack([np.full(20, 8), np.arange(10, 30)], axis=1)
    (part,), dropped = cells_of_drive(ros_map.to_metres(cells=cells), ros_map, ros_map.grid())
    np.testing.assert_array_equal(part, cells)
    assert set(dropped.values()) == {0}


def test_what_is_dropped_is_counted() -> None:
    """A drive through a pillar falls into two parts; poses outside and short rests go."""
    ros_map = office()
    row = ros_map.to_metres(cells=np.array([[18, 2], [18, 28]]))  # through the first pillar
    outside = np.array([[50.0, 50.0]])
    parts, dropped = cells_of_drive(np.concatenate([row, outside]), ros_map, ros_map.grid())
    assert [part.tolist() for part in parts] == [
        [[18, column] for column in range(2, 14)],
        [[18, column] for column in range(18, 29)],
    ]
    assert dropped == {
        "poses outside of the map": 1,
        "cells that are not free": 4,
        "cells in parts that are too short": 0,
    }
    short = ros_map.to_metres(cells=np.array([[18, 11], [18, 16]]))
    parts, dropped = cells_of_drive(short, ros_map, ros_map.grid())
    assert (parts, dropped["cells in parts that are too short"]) == ([], 3)


def test_lines_between_poses_are_moves() -> None:
    """Joined cells are neighbours, and begin and end at those of the poses."""
    rng = np.random.default_rng(2)
    ros_map = RosMap(np.zeros((50, 70), np.int8), RESOLUTION, (0.0, 0.0, 0.0))
    cells = rng.integers(0, 50, (12, 2))
    (part,), _ = cells_of_drive(ros_map.to_metres(cells=cells), ros_map, ros_map.grid())
    assert set(np.abs(np.diff(part, axis=0)).max(axis=1).tolist()) == {1}
    visited = list(map(tuple, part.tolist()))
    assert visited[0] == tuple(cells[0])
    assert visited[-1] == tuple(cells[-1])
    assert {tuple(cell) for cell in cells.tolist()} <= set(visited)


# --- the fit ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_learnt_costs_are_those_of_the_driver(costmap: Costmap) -> None:
    """On new problems paths cost at most a tenth of the regret of shortest paths more than the
    cheapest ones; held-back drives are nearest to the learnt costs.
    """
    grid = costmap.grids[0]
    truth = hidden_terrain(grid, office().grid())
    learnt = terrain_from_costs(np.where(grid, 1, costmap.costs[0])[None], grid[None])[0]
    regrets: dict[str, list[float]] = {"learnt": [], "shortest": []}
    for ends in problems(grid, 25, 2):
        best = check_path(grid, path_on(grid, truth, ends), MOVEMENT, terrain=truth)
        for name, terrain in (("learnt", learnt), ("shortest", np.where(grid, 0, 1))):
            path = path_on(grid, terrain.astype(np.uint8), ends)
            regrets[name].append(check_path(grid, path, MOVEMENT, terrain=truth) / best - 1)
    assert np.mean(regrets["learnt"]) < 0.1 * np.mean(regrets["shortest"])
    distance = costmap.comparison.set_index("costs")["distance"]
    assert distance["learnt costs"] < distance["shortest path"]
    assert costmap.drives == 6
    assert set(costmap.dropped.values()) == {0}


def test_costs_begin_at_one_on_free_cells(costmap: Costmap) -> None:
    """Occupied cells have 0; another map of the same kind gets the same costs."""
    costs, grid = costmap.costs[0], costmap.grids[0]
    assert costs[grid == 0].min() == 1
    assert not costs[grid == 1].any()
    np.testing.assert_array_equal(costmap.predict(site_of(office(), RADIUS)), costs)


def test_the_curve_has_the_driven_cells_and_a_range(costmap: Costmap) -> None:
    """Costs lie in the range of the starts; its smallest one is where the driver drives."""
    curve = costmap.curve
    assert curve is not None
    assert (curve["low"] <= curve["cost"]).all()
    assert (curve["cost"] <= curve["high"]).all()
    driven = curve[curve["driven"] >= 20]
    cheapest = driven["clearance"].to_numpy()[driven["cost"].to_numpy().argmin()]
    assert abs(cheapest - 0.6) < 0.11
    axes = costmap.plot()
    assert len(axes.get_lines()) == 2
    assert "obstacle" in axes.get_xlabel()


@pytest.mark.slow
def test_the_fit_is_repeatable() -> None:
    """The same seed gives the same costs, and leaves the caller's random numbers alone."""
    import torch

    drives = drives_on(office(), 4)
    torch.manual_seed(3)
    expected = torch.rand(2)
    torch.manual_seed(3)
    one, again = (
        fit_costmap(office(), drives, robot_radius=RADIUS, starts=1, steps=5) for _ in range(2)
    )
    np.testing.assert_array_equal(one.costs[0], again.costs[0])
    assert torch.equal(torch.rand(2), expected)


@pytest.mark.slow
def test_planes_of_ones_own_and_several_maps() -> None:
    """Maps of other sizes are fitted together; there is no curve of one's own planes."""
    wide = RosMap(np.pad(office().cells, ((0, 0), (0, 20))), RESOLUTION, (0.0, 0.0, 0.0))

    def planes(grid: Bytes, resolution: float) -> Floats:
        return np.stack([clearance(grid) * resolution, np.zeros(grid.shape)]).astype(np.float64)

    costmap = fit_costmap(
        [office(), wide],
        [drives_on(office(), 2), drives_on(wide, 2)],
        robot_radius=RADIUS,
        planes=planes,
        starts=1,
        steps=3,
    )
    assert [costs.shape for costs in costmap.costs] == [(40, 60), (40, 80)]
    assert costmap.curve is None
    with pytest.raises(ValueError, match="there is no curve"):
        costmap.plot()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"drives": []}, "got 0, expected one for each of 1 maps"),
        ({"drives": pd.DataFrame({"x": [90.0], "y": [90.0]})}, "got 0 on free cells"),
        ({"planes": lambda grid, resolution: grid}, r"planes: got shape \(40, 60\)"),
        ({"planes": lambda grid, resolution: np.full((1, 40, 60), np.nan)}, "not finite"),
        ({"starts": 0}, "starts: got 0"),
        ({"steps": 0}, "steps: got 0"),
    ],
    ids=["files", "outside", "shape", "nan", "starts", "steps"],
)
def test_bad_arguments_are_refused(changes: dict[str, object], message: str) -> None:
    """The message says what was expected."""
    arguments = {"drives": drives_on(office(), 2), "robot_radius": RADIUS, **changes}
    with pytest.raises(ValueError, match=message):
        fit_costmap(office(), **arguments)  # type: ignore[arg-type]


# --- Nav2 ---------------------------------------------------------------------------------------


def test_the_inflation_layer_follows_the_formula_of_nav2() -> None:
    """Cell by cell in plain Python, on a map with one obstacle; the cost is cut to an integer."""
    cells = np.zeros((15, 15), np.int8)
    cells[7, 7] = 100
    site = site_of(RosMap(cells, RESOLUTION, (0.0, 0.0, 0.0)), RADIUS)
    costs = inflation_costs(site, RADIUS, inflation_radius=0.45, cost_scaling_factor=5.0)
    for row, column in ((7, 9), (7, 10), (7, 11), (7, 12), (4, 7)):
        distance = RESOLUTION * max(abs(row - 7), abs(column - 7))
        layer = int(252 * math.exp(-5.0 * (distance - RADIUS))) if distance <= 0.45 else 0
        charge = 50 + 0.8 * layer
        assert costs[row, column] == pytest.approx(charge / 50)
    assert costs[7, 8] == 0  # the robot cannot be there


def test_without_scipy_the_message_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is needed for the distances of the inflation layer alone."""
    monkeypatch.setitem(sys.modules, "scipy.ndimage", None)
    with pytest.raises(ModuleNotFoundError, match=r"needs scipy, the extra \[examples\]"):
        inflation_costs(site_of(office(), RADIUS), RADIUS, 0.5, 3.0)


def test_map_server_reads_the_costs_back(costmap: Costmap, tmp_path: Path) -> None:
    """Mode raw is the occupancy itself; NavFn's charge is 50 times the cost, up to a rounding,
    until it is clipped.
    """
    clipped = costmap.write(tmp_path / "new")
    found = read_map(tmp_path / "new" / "costmap.yaml")
    assert (found.mode, found.resolution) == ("raw", RESOLUTION)
    assert found.origin == office().origin
    is_free = costmap.grids[0] == 0
    assert (found.cells[~is_free] == 100).all()
    occupancy = found.cells[is_free].astype(np.float64)
    assert 0 <= occupancy.min() <= occupancy.max() <= MAX_OCCUPANCY
    charge = 50 + 0.8 * 2.54 * occupancy
    wanted = 50 * costmap.costs[0][is_free]
    is_clipped = occupancy == MAX_OCCUPANCY
    assert np.abs(charge - wanted)[~is_clipped].max() <= 0.8 * 2.54 / 2 + 1e-3
    assert (wanted[is_clipped] >= charge[is_clipped] - 1.02).all()
    most = 50 + 0.8 * 2.54 * (MAX_OCCUPANCY + 0.5)
    assert clipped == pytest.approx((wanted > most).mean(), abs=1e-3)


# --- planes of a CostPredictor ------------------------------------------------------------------


def test_a_predictor_reads_planes_of_any_size() -> None:
    """Each cell's cost depends on its own numbers alone."""
    model = CostPredictor(planes=2).eval()
    rng = np.random.default_rng(4)
    planes = rng.standard_normal((1, 2, 9, 14)).astype(np.float32)
    grids = np.zeros((1, 9, 14), np.uint8)
    terrain = model.predict(planes, grids)
    assert terrain.shape == (1, 9, 14)
    assert terrain.min() >= 1
    turned = model.predict(np.ascontiguousarray(planes[:, :, ::-1]), grids)
    np.testing.assert_array_equal(turned, terrain[:, ::-1])


@pytest.mark.parametrize(
    ("planes", "message"),
    [
        (np.zeros((1, 3, 9, 14)), r"expected \(1, 2, 9, 14\)"),
        (np.full((1, 2, 9, 14), np.nan), "got the value nan, expected finite numbers"),
    ],
    ids=["shape", "nan"],
)
def test_wrong_planes_are_refused(planes: Floats, message: str) -> None:
    """The message says what was expected."""
    with pytest.raises(ValueError, match=message):
        CostPredictor(planes=2).predict(planes, np.zeros((1, 9, 14), np.uint8))


def test_the_default_plane_is_the_clearance_in_metres() -> None:
    """Up to two metres."""
    grid = np.zeros((60, 60), np.uint8)
    plane = clearance_plane(grid, RESOLUTION)
    np.testing.assert_allclose(plane[0], np.minimum(clearance(grid) * RESOLUTION, 2))
