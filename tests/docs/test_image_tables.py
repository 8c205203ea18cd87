"""The table of docs/costs.md is made from the file of results beside it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mapdata import ProblemSet
from mapdata.models import CostPredictor

DOCS = Path(__file__).parents[2] / "docs"


def test_the_page_shows_the_rows_of_the_file(monkeypatch: pytest.MonkeyPatch) -> None:
    """What `write_page` would write is what the page holds."""
    monkeypatch.syspath_prepend(str(DOCS))
    import image_tables

    rows = json.loads((DOCS / "image_results.json").read_text())
    page = (DOCS / "costs.md").read_text()
    assert image_tables.table(rows) in page


def test_a_row_names_its_problems(monkeypatch: pytest.MonkeyPatch) -> None:
    """The hash of the smallest maps is that of the problems that the script samples now."""
    monkeypatch.syspath_prepend(str(DOCS))
    import image_tables

    rows = json.loads((DOCS / "image_results.json").read_text())
    problems: ProblemSet = image_tables.problems_of(image_tables.FAMILIES["tiles 12"])
    hashes = {row["set"] for row in rows if row["maps"] == "tiles 12"}
    assert hashes == {problems.content_hash}


def test_rows_name_their_network(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows of the network of today have the number of its weights, and earlier ones another."""
    monkeypatch.syspath_prepend(str(DOCS))
    import image_tables

    rows = json.loads((DOCS / "image_results.json").read_text())
    parameters = sum(weight.numel() for weight in CostPredictor().parameters())
    trained = [row for row in rows if row["loss"] != "none"]
    current = [row["network"] == image_tables.NETWORK for row in trained]
    assert any(current)
    assert current == [row["parameters"] == parameters for row in trained]
