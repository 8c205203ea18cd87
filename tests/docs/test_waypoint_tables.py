"""The tables of docs/howto/waypoints.md are made from the file beside the script that measures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture
def tables(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The script of the tables."""
    monkeypatch.syspath_prepend(str(DOCS))
    import waypoint_tables

    return waypoint_tables


@pytest.fixture(scope="module")
def results() -> Any:
    """The file of results."""
    return json.loads((DOCS / "waypoint_results.json").read_text())


def test_the_page_shows_the_rows_of_the_file(tables: Any, results: Any) -> None:
    """Both tables are those that `write_page` would write, of the weights that ship."""
    page = (DOCS / "howto" / "waypoints.md").read_text()
    assert tables.family_table(results["families"]) in page
    assert tables.planner_table(results["planners"]) in page
    assert results["weights"] == tables.weights_hash()


def test_waypoints_never_collide(tables: Any, results: Any) -> None:
    """In the file, and on some problems that are measured now."""
    rows = [*results["families"], tables.measure_family("dungeon", 50)]
    assert [row["maps"] for row in rows[:-1]] == list(tables.PRESETS)
    for row in rows:
        assert row["waypoints"] == 0
        assert row["cells"] < row["taut"]


@pytest.mark.slow
def test_planners_come_in_this_order(tables: Any, results: Any) -> None:
    """The ruler collides most often and predicted waypoints never: in the file, and now."""
    for rows in (results["planners"], tables.measure_planners(20)):
        ruler, band, predicted, label = (row["collide"] for row in rows)
        assert 0.4 < ruler < 0.9
        assert 0.05 < band < ruler
        assert predicted == label == 0


def test_an_elastic_band_leaves_a_wall_and_keeps_its_ends(tables: Any) -> None:
    """It stays where it is without obstacles, and is free beside one that it touched."""
    straight = np.stack([np.full(32, 8.5), np.linspace(2.5, 13.5, 32)], axis=1)[None]
    grids = np.zeros((1, 16, 16), np.uint8)
    np.testing.assert_allclose(tables.elastic_bands(grids, straight), straight, atol=1e-9)
    grids[0, 8:10, 8] = 1
    assert not tables.lines_are_free(grids, straight).any()
    band = tables.elastic_bands(grids, straight)
    assert tables.lines_are_free(grids, band).all()
    np.testing.assert_array_equal(band[:, [0, -1]], straight[:, [0, -1]])


def test_distances_are_those_to_the_nearest_obstacle(tables: Any) -> None:
    """Half a cell beside a wall or the border, below 0 inside, and linear between the middles."""
    grids = np.zeros((1, 5, 7), np.uint8)
    grids[0, 2, 3] = 1
    distances = tables.signed_distances(grids)
    assert distances[0, 2].tolist() == [0.5, 1.5, 0.5, -0.5, 0.5, 1.5, 0.5]
    points = np.array([[[2.5, 1.5], [2.5, 2.0], [2.5, 3.0]]])
    np.testing.assert_allclose(tables.interpolated(distances, points), [[1.5, 1.0, 0.0]])
