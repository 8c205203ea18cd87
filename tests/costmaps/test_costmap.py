"""Costmaps from drives: the fit, its curve, and files for map_server."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mapdata import check_path, search_batch, terrain_from_costs
from mapdata.arrays import Bytes, Floats, Ints
from mapdata.costmaps import Costmap, fit_costmap, inflation_layer, site_of
from mapdata.costmaps.costmap import MAX_OCCUPANCY
from mapdata.costmaps.sites import MOVEMENT
from mapdata.formats import RosMap
from mapdata.formats.ros import read_map
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


@pytest.fixture(autouse=True, scope="module")
def quick_inflation_layer() -> Iterator[None]:
    """Try few inflation layers; they have tests of their own."""
    with pytest.MonkeyPatch.context() as patch:
        for name, number in {"PARTS": 16, "RANDOM_TRIES": 5, "TRIES": 5}.items():
            patch.setattr(inflation_layer, name, number)
        yield


@pytest.fixture(scope="module")
def costmap() -> Costmap:
    """Return a quick fit."""
    return fit_costmap(office(), drives_on(office(), 8), robot_radius=RADIUS, starts=2, steps=60)


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
    """Costs lie in the range of the starts; the smallest one is where the driver drives."""
    curve = costmap.curve
    assert curve is not None
    assert (curve["low"] <= curve["cost"]).all()
    assert (curve["cost"] <= curve["high"]).all()
    assert not curve["driven"][curve["clearance"] < RADIUS - 0.05].any()
    cheapest = curve["clearance"].iloc[curve["cost"].argmin()]
    assert abs(cheapest - 0.6) < 0.11
    axes = costmap.plot()
    assert len(axes.get_lines()) == 2
    assert "obstacle" in axes.get_xlabel()
    assert axes.get_title().endswith(f"{costmap.misjudgement:.1f}")


def test_the_curve_is_in_metres_and_costs_of_the_cheapest_clearance(costmap: Costmap) -> None:
    """A cell's cost is that of the curve at its clearance in metres, up to one factor."""
    curve = costmap.curve
    assert curve is not None
    assert curve["cost"].min() == pytest.approx(1)
    assert curve["clearance"].to_numpy() == pytest.approx(0.025 + 0.05 * np.arange(40))
    is_free = costmap.grids[0] == 0
    metres = clearance(office().grid())[is_free] * RESOLUTION
    at_cells = np.interp(metres, curve["clearance"], np.log(curve["cost"]))
    np.testing.assert_allclose(
        np.log(costmap.costs[0][is_free]), at_cells - at_cells.min(), atol=1e-4
    )


@pytest.mark.slow
def test_the_misjudgement_of_a_driver_is_found() -> None:
    """Drives under costs times exp(.5 * normal) give a factor near exp(.5), others one near 1."""
    site = site_of(office(), RADIUS)
    costs = 1 + 6 * np.abs(np.minimum(clearance(office().grid()) * RESOLUTION, 1.5) - 0.6)
    rng = np.random.default_rng(5)
    tables = []
    for number, ends in enumerate(problems(site.grid, 20, 3)):
        wrong = costs * np.exp(0.5 * rng.standard_normal(costs.shape))
        terrain = terrain_from_costs(np.where(site.grid, 1, wrong)[None], site.grid[None])[0]
        poses = office().to_metres(cells=path_on(site.grid, terrain, ends))
        tables.append(pd.DataFrame({"x": poses[:, 0], "y": poses[:, 1], "drive": number}))
    sloppy = fit_costmap(office(), pd.concat(tables), robot_radius=RADIUS, starts=1)
    clean = fit_costmap(office(), drives_on(office(), 8), robot_radius=RADIUS, starts=1)
    assert sloppy.misjudgement == pytest.approx(math.exp(0.5), rel=0.15)
    assert clean.misjudgement == pytest.approx(1, abs=0.15)


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
    assert costmap.misjudgement is None
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
