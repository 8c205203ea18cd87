"""The dataset card of exported problems, with the front matter of the Hugging Face Hub."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

from mapdata.checks import printable
from mapdata.datasets.fields import FIELDS
from mapdata.describe.dataset_card import escaped, front_matter, movement_text
from mapdata.describe.problem_statistics import ProblemStatistics
from mapdata.export.parquet import HUB_SPLITS
from mapdata.movement import Movement


def problem_card(
    name: str,
    about: dict[str, Any],
    fields: Sequence[str],
    statistics: Mapping[str, ProblemStatistics],
    licence: str | None,
) -> str:
    """Return the card of exported problems as Markdown.

    Args:
        name: of the folder.
        about: what ``export.json`` says.
        fields: the columns.
        statistics: of the problems of each split.
        licence: identifier of the Hub; None leaves it out.
    """
    title = printable(" ".join(name.split()))
    counts: dict[str, int] = about["problems"]
    total = sum(counts.values())
    data_files = [
        {"split": HUB_SPLITS[split], "path": f"data/{HUB_SPLITS[split]}-*.parquet"}
        for split in counts
    ]
    properties: dict[str, object] = {
        "configs": [{"config_name": "default", "data_files": data_files}]
    }
    if licence is not None:
        properties["license"] = licence
    lines = [front_matter(title, total, **properties), f"# {escaped(title)}", ""]
    lines += [
        f"{total:,} path-planning problems on grid maps, made by mapdata {about['mapdata']}. A row "
        "is a problem.",
        "",
        "| split | problems | different maps |",
        "|---|---|---|",
        *(
            f"| {HUB_SPLITS[split]} | {count:,} | {about['maps'][split]:,} |"
            for split, count in counts.items()
        ),
        "",
        "## Columns",
        "",
        "Cells are (row, col) from the upper left; 1 is occupied, 0 is free. Shapes are those of a "
        "row, where H and W are the rows and columns of a map.",
        "",
        "| column | meaning |",
        "|---|---|",
        *(f"| {field} | {_meaning(field)} |" for field in fields),
        "",
        *_statistics_lines(statistics),
        "## Use it",
        "",
        "```python",
        "from datasets import load_dataset",
        "",
        f"# Give the path of this folder, or OWNER/{title} once it is on the Hub.",
        f'problems = load_dataset({name!r}, split="{HUB_SPLITS[next(iter(counts))]}")',
        'problems = problems.with_format("torch")',
        "```",
        "",
        "## Where they come from",
        "",
        f"Content hash {about['content_hash']}.",
        "",
        "```json",
        json.dumps({"origin": about["origin"], "options": about["options"]}, indent=1),
        "```",
        "",
        "## Licence",
        "",
        "None is stated, so others may not copy the problems." if licence is None else licence,
        "",
        *_limit_lines(about),
    ]
    return "\n".join(lines) + "\n"


def _statistics_lines(statistics: Mapping[str, ProblemStatistics]) -> list[str]:
    """Return the section on what the problems are worth, a column for each split."""
    columns = [dict(of_split.rows()) for of_split in statistics.values()]
    first = next(iter(statistics.values()))
    return [
        "## What the problems are worth",
        "",
        first.target_text(),
        "",
        f"| | {' | '.join(HUB_SPLITS[split] for split in statistics)} |",
        "|---" * (len(columns) + 1) + "|",
        *(f"| {name} | {' | '.join(column[name] for column in columns)} |" for name in columns[0]),
        "",
    ]


def _limit_lines(about: dict[str, Any]) -> list[str]:
    """Return the section on what the problems do not cover."""
    options = about["options"]
    movement = Movement(**options["movement"])
    lines = [
        "- Paths are shortest under one rule of movement, and perhaps not under another one. The "
        f"rule is {movement_text(movement)}.",
        "- Obstacles do not move, and all cells are known.",
    ]
    if options["search"] == "bfs":
        lines.append("- Shortest means the fewest moves here, not the least cost.")
    if "recipe" in about["origin"]:
        lines.append("- The maps were drawn by a program; none is the map of a real place.")
    if not options["distinct"]:
        lines.append("- Copies of maps were not left out, and a copy may be in another split.")
    return ["## Known limits", "", *lines]


def _meaning(field: str) -> str:
    """Return the first sentence of a field's docstring, without its name, with the shape of a row.

    A row has neither the batch axis B nor the channel axis of 1, as `table_of` writes it.
    """
    if field == "path":
        return "(length, 2) int32, cells from start to goal, both included"
    text = (FIELDS[field].__doc__ or "").partition("\n")[0]
    _, _, meaning = text.partition(": ")
    meaning = re.sub(r"^\(B,\) ", "", meaning)  # a number
    meaning = re.sub(r"^\(B, (?:1, )?(.*?)\) ", r"(\1) ", meaning)
    return meaning.replace("(2) ", "(2,) ").replace("|", "\\|")
