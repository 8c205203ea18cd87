"""The table of planners on known terrain is made from a file of results."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest
from helpers.pages import DOCS

from mapdata import Terrain
from mapdata.models import PathPredictor


@pytest.fixture
def tables(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return terrain_tables.py."""
    monkeypatch.syspath_prepend(str(DOCS))
    import terrain_tables

    return terrain_tables


def test_the_table_of_the_page_is_that_of_the_file(tables: ModuleType) -> None:
    """docs/planners.md shows what docs/terrain_results.json says."""
    results = tables.Results.read(DOCS / "terrain_results.json")
    assert list(results.sets) == list(tables.TEST_FAMILIES)
    assert tables.table_of(results) in (DOCS / "planners.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_sets_of_the_table_keep_their_problems(tables: ModuleType) -> None:
    """On terrain, a range of length is tested after the draw, as in the version that measured."""
    results = tables.Results.read(DOCS / "terrain_results.json")
    for name in tables.TEST_FAMILIES:
        assert tables.problems_of(name).content_hash == results.sets[name]["hash"]


@pytest.mark.slow
def test_a_network_is_measured_beside_the_classical_planners(
    tables: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """All planners of all families are in the file, with times; the table leaves some out."""
    families = {"hills": Terrain((16, 20)), "noise": Terrain((16, 20), scale=1)}
    monkeypatch.setattr(tables, "TEST_FAMILIES", families)
    monkeypatch.setattr(tables, "TEST_MAPS", 4)
    monkeypatch.setattr(tables, "MIN_PATH_CELLS", 8)
    monkeypatch.setattr(tables, "TIMED", 2)
    model = PathPredictor(widths=(8, 8, 8), passes=1, terrain=True)
    results = tables.Results()
    tables.measure(results, tables.planners_of(model), "a command")
    results.write(tmp_path / "rows.json")
    copy = tables.Results.read(tmp_path / "rows.json")
    names = [planner.name for planner in tables.planners_of(model)]
    for name in families:
        rows = copy.rows_of(name)
        assert list(rows) == names
        assert all(row["ms"] > 0 and row["ms_batched"] > 0 for row in rows.values())
        assert rows["A*"]["cost_ratio"] == rows["A*"]["expansion_ratio"] == 1
        assert rows["A* on mean cost"]["cost_ratio"] > 1
    lines = tables.table_of(copy).splitlines()
    assert len(lines) == 2 + len(names) - len(tables.LEFT_OUT)
    assert lines[0].startswith("| planner | hills: cost | expansions | noise: cost |")
