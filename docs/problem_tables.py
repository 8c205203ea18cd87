"""Measure what the problems of the presets are worth: python docs/problem_tables.py.

Of each preset 1,000 maps are built in a temporary folder, and `MapDataset.problem_statistics`
measures their route problems and their random ones, with 4 and with 8 moves. It takes some minutes
on one core.

The figures are written to docs/problem_results.json: ``rows`` has one object for each preset,
source of problems and movement, with the entries of `ProblemStatistics.to_dict`, in which
[value, low, high] is a number with its 95 % interval; ``run`` says which command measured them, and
when. The tables are printed as Markdown, as docs/which_problems.md shows them. With ``--page`` they
are printed from the file, and nothing is measured.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from planner_results import this_run

from mapdata import MapDataset, Movement, build
from mapdata.generators import PRESETS

FILE = Path(__file__).parent / "problem_results.json"
SEED = 0
MAPS = 1000
SAMPLE = 1000
SOURCES = ("route", "random")
CONNECTIVITIES = (4, 8)

Row = dict[str, Any]


def rows_of(preset: str, maps: int = MAPS, sample: int = SAMPLE) -> list[Row]:
    """Return a row for each source of problems and movement of a preset."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / preset
        build(root, preset, maps=maps, seed=SEED)
        for source in SOURCES:
            for connectivity in CONNECTIVITIES:
                dataset = MapDataset(root, problems=source, movement=Movement(connectivity))
                statistics = dataset.problem_statistics(sample)
                row = {"preset": preset, "source": source, "connectivity": connectivity}
                rows.append(row | statistics.to_dict())
    return rows


FIGURES = {
    "hard": "{:.0%}",
    "single_path": "{:.0%}",
    "expansions": "{:.1f}",
}
"""The figures of the page, each with the form of its numbers. Each has a table of its own."""


def table_of(rows: list[Row], figure: str) -> str:
    """Return one of `FIGURES` as a Markdown table, with a line for each preset."""
    cells: dict[str, list[str]] = {}
    for row in rows:
        # On terrain a problem is neither hard nor easy: nearly every cost is above the heuristic.
        text = "-" if row[figure] is None else FIGURES[figure].format(row[figure][0])
        cells.setdefault(row["preset"], []).append(text)
    titles = [f"`{source}`, {moves} moves" for source in SOURCES for moves in CONNECTIVITIES]
    lines = ["| preset | " + " | ".join(titles) + " |", "|---" + "|--:" * len(titles) + "|"]
    lines += [f"| `{preset}` | {' | '.join(texts)} |" for preset, texts in cells.items()]
    return "\n".join(lines)


def write(rows: list[Row], path: Path) -> None:
    """Write the file of results, with a line for each row, so that changes are easy to read."""
    run = json.dumps(this_run("python docs/problem_tables.py"))
    lines = ",\n".join(map(json.dumps, rows))
    text = f'{{"format_version": 1,\n"run": {run},\n"rows": [\n{lines}\n]}}\n'
    path.write_text(text, encoding="utf-8")


def read(path: Path) -> list[Row]:
    """Return the rows of a file of results."""
    rows: list[Row] = json.loads(path.read_text(encoding="utf-8"))["rows"]
    return rows


def main() -> None:
    """Measure all presets, write the file and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", action="store_true", help="print the tables of the file alone")
    if not parser.parse_args().page:
        write([row for preset in PRESETS for row in rows_of(preset)], FILE)
    rows = read(FILE)
    for figure in FIGURES:
        print(f"{figure}\n\n{table_of(rows, figure)}\n")


if __name__ == "__main__":
    main()
