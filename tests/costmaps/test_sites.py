"""Maps as the fit sees them, and paths in windows of them."""

from __future__ import annotations

import numpy as np
import pytest

from mapdata import check_path, search_batch
from mapdata.costmaps import site_of
from mapdata.costmaps.drives import Drive
from mapdata.costmaps.sites import MARGIN, MOVEMENT, clearance_plane, windows_of
from mapdata.formats import RosMap
from mapdata.search import clearance

RESOLUTION = 0.1


def test_the_default_plane_is_the_clearance_in_metres() -> None:
    """Up to two metres."""
    grid = np.zeros((60, 60), np.uint8)
    plane = clearance_plane(grid, RESOLUTION)
    np.testing.assert_allclose(plane[0], np.minimum(clearance(grid) * RESOLUTION, 2))


def test_windows_show_the_map_around_parts() -> None:
    """Planes and obstacles are those of the map, and outside of it there are obstacles."""
    rng = np.random.default_rng(2)
    cells = np.where(rng.random((30, 40)) < 0.1, 100, 0).astype(np.int8)
    site = site_of(RosMap(cells, RESOLUTION, (0.0, 0.0, 0.0)), 0.05)
    parts = [
        Drive(0, np.array([[3, 4], [4, 5], [4, 6]])),
        Drive(0, np.array([[25, 35], [24, 36], [23, 36], [22, 36]])),
    ]
    windows = windows_of([site], parts)
    padded = np.pad(site.grid, 50, constant_values=1)
    planes = np.pad(site.planes[0], 50)
    height, width = windows.grids.shape[1:]
    for b, part in enumerate(parts):
        top, left = part.cells.min(axis=0) - MARGIN + 50
        own = (slice(top, top + height), slice(left, left + width))
        np.testing.assert_array_equal(windows.grids[b], padded[own])
        np.testing.assert_array_equal(windows.planes[b, 0], planes[own])
    numbers, offsets = windows.driven.cells[:, 0], windows.driven.offsets
    assert (numbers.tolist(), offsets.tolist()) == ([0, 0, 0, 1, 1, 1, 1], [0, 3, 7])


def test_weights_add_up_to_the_cost_of_a_path() -> None:
    """As `check_path` counts it, on any terrain, for each of several paths."""
    rng = np.random.default_rng(5)
    cells = np.zeros((30, 40), np.int8)
    site = site_of(RosMap(cells, RESOLUTION, (0.0, 0.0, 0.0)), 0.05)
    terrain = rng.integers(1, 255, (30, 40)).astype(np.uint8)
    ends = np.array([[2, 3], [27, 30], [15, 35]]), np.array([[20, 38], [4, 4], [15, 1]])
    found = search_batch("astar", site.grid, *ends, MOVEMENT, terrain=terrain)
    windows = windows_of([site], [Drive(0, path) for path in found.paths()])
    paths = windows.driven
    for b, path in enumerate(found.paths()):
        own = paths.cells[:, 0] == b
        cost = paths.weights[own] @ terrain[tuple(path.T)]
        wanted = check_path(site.grid, path, MOVEMENT, terrain=terrain)
        assert cost == pytest.approx(wanted, rel=1e-5)
