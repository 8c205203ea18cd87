"""Measure the first rows of the frozen suite: python docs/suite_tables.py.

They are the classical planners that `mapdata.evaluation.evaluate_suite` adds, and the pretrained
path predictor. This takes some minutes on one core; with ``--add MODULE:NAME`` one planner more is
measured, and the rows that are there stay.

The rows go to docs/suite_results.json: ``rows`` has the columns of `evaluate_suite`, null where
there is no figure, and ``runs`` says which commands measured them, how many seconds of processor
time that took, and on which machine. The tables go to docs/suite.md. With ``--pages`` the tables
are made again, and nothing is measured.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import pandas as pd
import torch
from planner_results import plain, this_run
from planner_tables import DOCS, filled, markdown, words_of

from mapdata.cli.evaluate import own_planner
from mapdata.evaluation import SUITE_MOVEMENT, Planner, evaluate_suite, suite_summary
from mapdata.models import PathPredictor, planners
from mapdata.shards import write_output

SUITE = "carry-over-1"
NO_NETWORK = "guided search, no network"
LEFT_OUT = ("A*", NO_NETWORK)
"""Rows whose differences say nothing: the first has 1 everywhere, the second 0."""


def measured(own: list[Planner], command: str) -> dict[str, Any]:
    """Return the file of results for some planners, beside the classical ones."""
    began = time.process_time()
    table = evaluate_suite(own, SUITE, progress=True)
    run = this_run(command) | {"seconds": round(time.process_time() - began)}
    rows = [
        {"run": 0} | {str(column): plain(value) for column, value in row.items()}
        for row in table.to_dict("records")
    ]
    return {"format_version": 1, "suite": SUITE, "runs": [run], "rows": rows}


def joined(results: dict[str, Any], added: dict[str, Any], names: list[str]) -> dict[str, Any]:
    """Return results with the rows of some planners of others, in place of older ones."""
    run = len(results["runs"])
    rows = [row for row in results["rows"] if row["planner"] not in names]
    new = [row | {"run": run} for row in added["rows"] if row["planner"] in names]
    return results | {"runs": results["runs"] + added["runs"], "rows": rows + new}


def write(results: dict[str, Any], path: Path) -> None:
    """Write the file of results, with a line for each run and row, so that changes are readable."""
    runs, rows = (",\n".join(map(json.dumps, results[name])) for name in ("runs", "rows"))
    text = (
        f'{{"format_version": 1,\n"suite": "{results["suite"]}",\n'
        f'"runs": [\n{runs}\n],\n"rows": [\n{rows}\n]}}\n'
    )
    write_output(path, text.encode())


def signed(row: dict[str, Any], metric: str) -> str:
    """Return a difference with the ends of its interval, or a dash where there is none."""
    value, low, high = (row[f"{metric}_difference{end}"] for end in ("", "_low", "_high"))
    return "-" if pd.isna(value) else f"{value:+.3f} [{low:+.3f}, {high:+.3f}]"


def number(row: dict[str, Any], metric: str) -> str:
    """Return a figure with half the width of its interval, or a dash where there is none."""
    value, low, high = (row[f"{metric}{end}"] for end in ("", "_low", "_high"))
    return "-" if pd.isna(value) else f"{value:.3f} ±{(high - low) / 2:.3f}"


def summary_table(summary: pd.DataFrame, group: str) -> str:
    """Return the means of a group: a line for each size and planner."""
    rows = [["size", "planner", "Opt", "difference", "cost", "expansions", "difference"]]
    for row in summary[summary["group"] == group].to_dict("records"):
        named = {str(column): value for column, value in row.items()}
        differs = row["planner"] not in LEFT_OUT
        rows.append(
            [
                str(row["side"]),
                row["planner"],
                number(named, "opt"),
                signed(named, "opt") if differs else "",
                number(named, "cost_ratio"),
                number(named, "expansion_ratio"),
                signed(named, "expansion_ratio") if differs else "",
            ]
        )
    return markdown(rows)


def parts_table(table: pd.DataFrame, planner: str) -> str:
    """Return the parts of a planner: what it adds to the search without a network on each."""
    rows = [["part", "no network: Opt", "expansions", "Opt: difference", "expansions: difference"]]
    without = {row["part"]: row for row in rows_of(table, NO_NETWORK)}
    for row in rows_of(table, planner):
        base = without[row["part"]]
        rows.append(
            [
                f"{row['part']} ({row['group']})",
                number(base, "opt"),
                number(base, "expansion_ratio"),
                signed(row, "opt"),
                signed(row, "expansion_ratio"),
            ]
        )
    return markdown(rows)


def rows_of(table: pd.DataFrame, planner: str) -> list[dict[str, Any]]:
    """Return the rows of a planner."""
    rows = table[table["planner"] == planner].to_dict("records")
    return [{str(column): value for column, value in row.items()} for row in rows]


def write_page(results: dict[str, Any], folder: Path) -> None:
    """Write the tables into the page."""
    table = pd.DataFrame(results["rows"])
    summary = suite_summary(table)
    tables = {f"suite-{group}": summary_table(summary, group) for group in ("in", "out", "terrain")}
    tables["suite-parts"] = parts_table(table, "path_predictor (search)")
    page = folder / "suite.md"
    write_output(page, filled(page.read_text(encoding="utf-8"), tables).encode())


def main(arguments: list[str] | None = None) -> None:
    """Measure what the command line says, and write the results and the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--add", metavar="MODULE:NAME", help="measure this planner alone")
    parser.add_argument("--pages", action="store_true", help="measure nothing")
    parser.add_argument("--folder", type=Path, default=DOCS, help="of results and pages")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    path = options.folder / "suite_results.json"
    words = words_of(sys.argv[1:] if arguments is None else arguments)
    command = " ".join(["python docs/suite_tables.py", *words])
    if not options.pages:
        if options.add is None:
            results = measured([planners(PathPredictor.pretrained())[1]], command)
        else:
            planner = own_planner(options.add, "--add")(SUITE_MOVEMENT)
            kept = json.loads(path.read_text(encoding="utf-8"))
            results = joined(kept, measured([planner], command), [planner.name])
        write(results, path)
    write_page(json.loads(path.read_text(encoding="utf-8")), options.folder)


if __name__ == "__main__":
    main()
