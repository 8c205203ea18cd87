"""The tables of the pretrained costs on docs/costs.md are made from the file beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture
def tables(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The script of the tables."""
    monkeypatch.syspath_prepend(str(DOCS))
    import light_tables

    return light_tables


@pytest.fixture(scope="module")
def results() -> Any:
    """The file of results."""
    return json.loads((DOCS / "light_results.json").read_text())


def test_the_page_shows_the_rows_of_the_file(tables: Any, results: Any) -> None:
    """Both tables are those that `write_page` would write."""
    page = (DOCS / "costs.md").read_text()
    assert tables.light_table(results["rows"]) in page
    assert tables.texture_table(results["rows"]) in page


def test_the_figures_are_those_of_the_weights_that_ship(tables: Any, results: Any) -> None:
    """Other weights, maps or changes have to be measured anew."""
    assert results["weights"] == tables.weights_hash()
    assert {row["change"] for row in results["rows"]} == set(tables.CHANGES)
    hashes = {row["set"] for row in results["rows"] if row["seed"] == tables.TEST_SEEDS[0]}
    assert hashes == {tables.problems_of(tables.TEST_SEEDS[0], tables.MAPS).content_hash}


def test_light_of_the_training_is_borne(tables: Any, results: Any) -> None:
    """At least 98 % of the paths are optimal, on each test set."""
    for change in list(tables.CHANGES)[:9]:
        rows = [row for row in results["rows"] if row["change"] == change and row["textures"] == 0]
        assert len(rows) >= len(tables.TEST_SEEDS)
        assert min(row["opt"] for row in rows) >= 0.98
