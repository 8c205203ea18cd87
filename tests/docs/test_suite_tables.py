"""The tables of the frozen suite are made from a file of results."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from types import ModuleType

import pytest
from helpers.pages import DOCS

from mapdata.evaluation import SUITES


@pytest.fixture
def tables(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return suite_tables.py."""
    monkeypatch.syspath_prepend(str(DOCS))
    import suite_tables

    return suite_tables


def test_the_tables_of_the_page_are_those_of_the_file(tables: ModuleType, tmp_path: Path) -> None:
    """Writing them again changes neither the page nor the file."""
    names = ("suite_results.json", "suite.md")
    for name in names:
        shutil.copy(DOCS / name, tmp_path / name)
    tables.main(["--pages", "--folder", str(tmp_path)])
    for name in names:
        assert (tmp_path / name).read_text() == (DOCS / name).read_text(), name


def test_the_rows_are_of_the_frozen_problems() -> None:
    """Each part has rows, and their hash is the one in `SUITES`."""
    rows = json.loads((DOCS / "suite_results.json").read_text())["rows"]
    hashes = {part.name: part.content_hash for part in SUITES["carry-over-1"]}
    assert {row["part"]: row["content_hash"] for row in rows} == hashes


def test_a_planner_is_added_in_place_of_its_older_rows(tables: ModuleType) -> None:
    """The rows of others stay, and each row names the run that measured it."""
    old = {"runs": ["first"], "rows": [{"planner": name, "run": 0} for name in ("A*", "mine")]}
    new = {"runs": ["second"], "rows": [{"planner": name, "run": 0} for name in ("A*", "mine")]}
    joined = tables.joined(old, new, ["mine"])
    assert joined["rows"] == [{"planner": "A*", "run": 0}, {"planner": "mine", "run": 1}]
    assert joined["runs"] == ["first", "second"]


def test_a_figure_that_is_not_known_is_a_dash(tables: ModuleType) -> None:
    """As the expansions of a planner with a search of its own."""
    unknown = {f"opt{end}": None for end in ("", "_low", "_high")}
    known = {"opt_difference": 0.1, "opt_difference_low": -0.2, "opt_difference_high": 0.3}
    assert tables.number(unknown, "opt") == "-"
    assert tables.signed(known, "opt") == "+0.100 [-0.200, +0.300]"
