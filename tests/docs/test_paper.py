"""What code and pages cite of the paper is there: its sections, tables, figures and lines."""

from __future__ import annotations

import re
from pathlib import Path

from helpers.pages import DOCS, ROOT

SECTIONS = {"1", "2", "3", "4", "5"}
"""Introduction, Map Generation Algorithm, Dataset of 2D Maps, Characterization, Conclusions."""

LINES = 28
"""The lines of Algorithm 1, by the numbers that the paper's text gives them."""

PLACES = [
    path
    for folder in ("mapdata", "models", "scripts", "docs", "tests", "benchmarks")
    for path in sorted((ROOT / folder).rglob("*"))
    if path.suffix in (".py", ".md") and path != Path(__file__)
]


def test_no_section_is_cited_that_does_not_exist() -> None:
    """The sections have Arabic numbers and no subsections."""
    cited = 0
    for path in PLACES:
        text = " ".join(path.read_text(encoding="utf-8").split())
        assert not re.search(r"\b[Ss]ections? (I|II|III|IV|V)\b|\bIII-[A-Z]\b", text), path
        for found in re.findall(r"2110\.13242,? sections? ([\d., and]+)", text):
            numbers = re.findall(r"[\d.]*\d", found)
            assert set(numbers) <= SECTIONS, (path, found)
            cited += len(numbers)
    assert cited > 4


def test_cited_figures_and_tables_exist() -> None:
    """Four figures and one table."""
    for path in PLACES:
        text = path.read_text(encoding="utf-8")
        assert set(re.findall(r"the paper's Figure (\d+)", text)) <= set("1234"), path
        assert set(re.findall(r"\bTable (\d+) of the paper", text)) <= {"1"}, path


def test_the_lines_of_the_algorithm_follow_each_other() -> None:
    """The page names each line of Algorithm 1, and none that is not there."""
    page = (DOCS / "paper.md").read_text(encoding="utf-8")
    table = page.split("The lines of Algorithm 1")[1].split("\n## ")[0]
    named: set[int] = set()
    for cell in re.findall(r"^\| ([\d, -]+) \|", table, re.MULTILINE):
        for part in cell.split(", "):
            first, _, last = part.partition("-")
            named |= set(range(int(first), int(last or first) + 1))
    assert named - {21} == set(range(1, LINES + 1)) - {21}
    code = (ROOT / "mapdata" / "generators" / "rooms.py").read_text(encoding="utf-8")
    for line in re.findall(r"\b[Ll]ines? (\d+)", code):
        assert int(line) <= LINES


def test_what_was_decided_is_not_sold_as_the_papers() -> None:
    """Before the tables of decisions and slips, no resolution in metres and no neighbourhood."""
    says = (DOCS / "paper.md").read_text(encoding="utf-8").split("## What the paper leaves open")[0]
    for ours in (" 0.1 ", "metre", "neighbour", "-connected", "Manhattan"):
        assert ours not in says, ours
