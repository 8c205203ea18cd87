"""The table of what problems are worth is made from a file of results."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest
from helpers.pages import DOCS

from mapdata import MapDataset, Movement, build
from mapdata.generators import PRESETS


@pytest.fixture
def tables(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return problem_tables.py."""
    monkeypatch.syspath_prepend(str(DOCS))
    import problem_tables

    return problem_tables


def test_the_tables_of_the_page_are_those_of_the_file(tables: ModuleType) -> None:
    """docs/which_problems.md shows what docs/problem_results.json says of all presets."""
    rows = tables.read(DOCS / "problem_results.json")
    assert [(row["preset"], row["source"], row["connectivity"]) for row in rows] == [
        (preset, source, connectivity)
        for preset in PRESETS
        for source in ("route", "random")
        for connectivity in (4, 8)
    ]
    page = (DOCS / "which_problems.md").read_text(encoding="utf-8")
    assert [figure for figure in tables.FIGURES if tables.table_of(rows, figure) not in page] == []
    # The page says so of the sample and of the intervals.
    for row in rows:
        is_large = row["preset"] == "dungeon128"
        assert row["sample"] == (305 if is_large else min(1000, row["problems"]))
        for name in ("no_detour", "hard", "single_path"):
            share, low, high = row[name] or (0, 0, 0)
            assert max(share - low, high - share) < (0.065 if is_large else 0.035)


def test_rows_are_the_statistics_of_built_datasets(tables: ModuleType, tmp_path: Path) -> None:
    """Of both sources under both movements; the file holds them as they are."""
    rows = tables.rows_of("maze15", maps=30, sample=20)
    tables.write(rows, tmp_path / "rows.json")
    assert tables.read(tmp_path / "rows.json") == rows
    build(tmp_path / "maps", "maze15", maps=30, seed=0)
    dataset = MapDataset(tmp_path / "maps", problems="random", movement=Movement(8))
    statistics = dataset.problem_statistics(20).to_dict()
    assert {name: rows[3][name] for name in statistics} == statistics
    assert tables.table_of(rows, "single_path").splitlines()[2:] == [
        "| `maze15` | 100% | 100% | 100% | 100% |"
    ]
