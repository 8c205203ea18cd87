"""The page on costmaps: its tables are those of the file of results, and its drivers drive."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from mapdata.formats import RosMap

DOCS = Path(__file__).parents[2] / "docs"


def test_the_page_is_made_from_the_file_of_results(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Writing it again changes nothing; all seeds and tracks are in it."""
    monkeypatch.syspath_prepend(str(DOCS))
    import costmap_tables

    page = tmp_path / "costmap.md"
    shutil.copy(costmap_tables.PAGE, page)
    monkeypatch.setattr(costmap_tables, "PAGE", page)
    costmap_tables.main([])
    assert page.read_text() == (DOCS / "howto" / "costmap.md").read_text()
    results = json.loads(costmap_tables.RESULTS.read_text())
    names = {(row["driver"], row["drives"], row["seed"]) for row in results["drivers"]}
    assert len(names) == len(results["drivers"])
    assert len(names) == len(costmap_tables.NAV2_DRIVERS) * 2 * len(costmap_tables.SEEDS)
    named = [(row["driver"], row["drives"], row["seed"]) for row in results["named"]]
    assert named == [
        (*row, seed) for row in costmap_tables.NAMED_ROWS for seed in costmap_tables.NAMED_SEEDS
    ]
    assert [row["track"] for row in results["tracks"]] == list(costmap_tables.TRACKS)


@pytest.mark.slow
def test_each_driver_drives_on_free_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their poses lie where the robot can be, nearly always, and hidden costs have no regret."""
    monkeypatch.syspath_prepend(str(DOCS))
    import costmap_tables

    pixels = np.full((90, 120), 254, np.uint8)
    pixels[[0, -1]] = pixels[:, [0, -1]] = 0
    pixels[30:60, 40:80] = 0
    hall = RosMap((pixels == 0).astype(np.int8) * 100, 0.05, (0.0, 0.0, 0.0))
    for hidden, drive, minds_carpet in costmap_tables.DRIVERS.values():
        place = costmap_tables.Place(hall, hidden, minds_carpet)
        cells = place.ros_map.to_cells(drive(place, np.random.default_rng(1)))
        assert (place.grid[tuple(cells.T)] == 0).mean() > 0.9
        assert costmap_tables.mean_regrets(place, {"own": place.costs}, 0)["own"] < 0.5
