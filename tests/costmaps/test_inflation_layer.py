"""The inflation layer of Nav2, and its fit to drives."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest

from mapdata import Movement, search_batch, terrain_from_costs
from mapdata.costmaps import inflation_costs, site_of
from mapdata.costmaps import inflation_layer as layer
from mapdata.costmaps.drives import Drive
from mapdata.formats import RosMap

RESOLUTION = 0.1
RADIUS = 0.15


def hall() -> RosMap:
    """Return a hall of 4 x 6 m with two pillars, and a wall around it."""
    cells = np.zeros((40, 60), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    cells[14:26, 18:22] = cells[14:26, 38:42] = 100
    return RosMap(cells, RESOLUTION, (0.0, 0.0, 0.0))


def test_the_inflation_layer_follows_the_formula_of_nav2() -> None:
    """Cell by cell in plain Python, on a map with one obstacle; the cost is cut to an integer."""
    cells = np.zeros((15, 15), np.int8)
    cells[7, 7] = 100
    site = site_of(RosMap(cells, RESOLUTION, (0.0, 0.0, 0.0)), RADIUS)
    costs = inflation_costs(site, RADIUS, inflation_radius=0.45, cost_scaling_factor=5.0)
    for row, column in ((7, 9), (7, 10), (7, 11), (7, 12), (4, 7)):
        distance = RESOLUTION * max(abs(row - 7), abs(column - 7))
        cost = int(252 * math.exp(-5.0 * (distance - RADIUS))) if distance <= 0.45 else 0
        charge = 50 + 0.8 * cost
        assert costs[row, column] == pytest.approx(charge / 50)
    assert costs[7, 8] == 0  # the robot cannot be there


def test_without_scipy_the_message_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is needed for the distances of the inflation layer alone."""
    monkeypatch.setitem(sys.modules, "scipy.ndimage", None)
    with pytest.raises(ModuleNotFoundError, match=r"needs scipy, the extra \[examples\]"):
        inflation_costs(site_of(hall(), RADIUS), RADIUS, 0.5, 3.0)


def test_the_fit_explains_the_drives_of_a_layer(monkeypatch: pytest.MonkeyPatch) -> None:
    """On paths of a layer the excess of the one that was found is nearly 0."""
    monkeypatch.setattr(layer, "PARTS", 24)
    monkeypatch.setattr(layer, "RANDOM_TRIES", 20)
    monkeypatch.setattr(layer, "TRIES", 10)
    site = site_of(hall(), RADIUS)

    def path(costs: np.ndarray, start: tuple[int, int], goal: tuple[int, int]) -> np.ndarray:
        terrain = terrain_from_costs(np.where(site.grid, 1, costs), site.grid)
        return search_batch(
            "astar", site.grid, [start], [goal], Movement(8, True), terrain=terrain
        ).cells

    ends = [((5, 5), (34, 54)), ((34, 5), (5, 54)), ((20, 4), (20, 55)), ((5, 30), (34, 30))]
    truth = inflation_costs(site, RADIUS, 0.9, 2.0)
    drives = [Drive(0, path(truth, *pair)) for pair in ends]
    found = layer.fitted_inflation([site], drives, RADIUS, np.random.default_rng(0))
    costs = inflation_costs(site, RADIUS, *found)
    same = [np.isin(path(costs, *pair), path(truth, *pair)).all(axis=1).mean() for pair in ends]
    assert np.mean(same) > 0.9
