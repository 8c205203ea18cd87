"""The file of results behind the tables of planners, docs/planner_results.json.

The file is a JSON object with five entries:

    format_version    1
    sets              the sets of problems, by name
    rows              one object for each planner on a set
    differences       one object for each network on a set: what it adds to the search without one
    runs              the commands that measured the rows, and on which machine

A set has ``hash`` (`ProblemSet.content_hash`; equal hashes mean equal problems), ``problems`` and
``hard`` (how many there are), ``description``, ``movement``, and where it is drawn from a generator
``seed``, ``until_hard`` and ``generator``, the JSON of `MapGenerator.preset`.

A row has ``set``, ``run`` (an index into ``runs``) and the columns of `mapdata.evaluate`: planner,
subset ("hard" or "all"), n, the metrics with the ends of their 95 % intervals (``opt``,
``opt_low``, ``opt_high``), prepared_ratio, look_ratio, ms and ms_batched; null where there is none.
The times are processor time, in milliseconds a problem, of the first hundred problems. A* with
landmarks also has ms_prepared, the time on a map whose landmarks are placed already.
``baseline`` is the planner whose expansions count as 1, mapdata's A* where it is null.

A difference has ``set``, ``run``, ``planner``, and the columns ``opt_difference`` and
``expansion_ratio_difference`` of `mapdata.evaluate`, minus "guided search, no network", with the
ends of their intervals.

A run has ``command``, ``date``, ``machine``, ``threads`` and ``versions``. Figures of others and
figures that were not measured again have a run, too, whose ``source`` says where they are from.

    import json
    import pandas as pd
    rows = pd.DataFrame(json.load(open("docs/planner_results.json"))["rows"])
"""

from __future__ import annotations

import datetime
import importlib.metadata
import json
import os
import platform
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd
import torch

from mapdata import ProblemSet
from mapdata.shards import write_output

PACKAGES = ("mapdata-torch", "numpy", "numba", "torch")
"""Packages whose versions a run names."""

DIGITS = 6
"""Number of decimals of a figure in the file."""


@dataclass
class Results:
    """The sets, rows and runs of a file of results; the module says what they hold."""

    sets: dict[str, dict[str, Any]] = field(default_factory=dict)
    rows: list[dict[str, Any]] = field(default_factory=list)
    runs: list[dict[str, Any]] = field(default_factory=list)
    differences: list[dict[str, Any]] = field(default_factory=list)

    @classmethod
    def read(cls, path: Path) -> Results:
        """Return the results in a file, or none where there is no file."""
        if not path.exists():
            return cls()
        document = json.loads(path.read_text(encoding="utf-8"))
        version = document.pop("format_version")
        if version != 1:
            raise ValueError(f"{path}: got format_version {version}, expected 1")
        return cls(**document)

    def write(self, path: Path) -> None:
        """Write the file, a line for each set, row and run, so that changes are easy to read.

        An existing file is replaced as a whole: it may hold the results of days.
        """
        sets = ",\n".join(
            f"{json.dumps(name)}: {json.dumps(self.sets[name])}" for name in self.sets
        )
        rows = ",\n".join(map(json.dumps, self.rows))
        runs = ",\n".join(map(json.dumps, self.runs))
        differences = ",\n".join(map(json.dumps, self.differences))
        more = f',\n"differences": [\n{differences}\n]' if differences else ""
        text = (
            f'{{"format_version": 1,\n"sets": {{\n{sets}\n}},\n'
            f'"rows": [\n{rows}\n],\n"runs": [\n{runs}\n]{more}}}\n'
        )
        write_output(path, text.encode())

    def add_set(self, name: str, problems: ProblemSet, **recipe: Any) -> None:
        """Describe a set; the rows of other problems under this name are dropped."""
        content_hash = problems.content_hash
        if self.sets.get(name, {}).get("hash") != content_hash:
            self.rows = [row for row in self.rows if row["set"] != name]
            self.differences = [row for row in self.differences if row["set"] != name]
        self.sets[name] = {
            "hash": content_hash,
            "problems": len(problems),
            "hard": int(problems.hard.sum()),
            "description": problems.description,
            "movement": asdict(problems.movement),
            **recipe,
        }

    def add_rows(self, name: str, table: pd.DataFrame, run: dict[str, Any], **more: Any) -> None:
        """Add rows of a table of `evaluate` to a set, in place of older rows of these planners."""
        if run not in self.runs:
            self.runs.append(run)
        for measured in table.to_dict("records"):
            row = {"set": name, "run": self.runs.index(run)}
            row |= {str(column): plain(number) for column, number in measured.items()} | more
            self._put(row)
        self._forget_unused_runs()

    def add_differences(self, name: str, table: pd.DataFrame, run: dict[str, Any]) -> None:
        """Add the differences of the planners of a table of `evaluate`, in place of older ones."""
        if run not in self.runs:
            self.runs.append(run)
        columns = [
            f"{metric}_difference{end}"
            for metric in ("opt", "expansion_ratio")
            for end in ("", "_low", "_high")
        ]
        for measured in table.to_dict("records"):
            planner = measured["planner"]
            self.differences = [
                row for row in self.differences if (row["set"], row["planner"]) != (name, planner)
            ]
            row = {"set": name, "run": self.runs.index(run), "planner": planner}
            self.differences.append(row | {column: plain(measured[column]) for column in columns})
        self._forget_unused_runs()

    def difference_of(self, name: str, planner: str) -> dict[str, Any] | None:
        """Return the difference of a planner on a set, or None if it was not measured."""
        for row in self.differences:
            if (row["set"], row["planner"]) == (name, planner):
                return row
        return None

    def rows_of(self, name: str) -> dict[str, dict[str, Any]]:
        """Return the rows of a set by the names of the planners."""
        return {row["planner"]: row for row in self.rows if row["set"] == name}

    def _put(self, row: dict[str, Any]) -> None:
        """Add a row, or put it in the place of the row of the same set and planner."""
        for index, older in enumerate(self.rows):
            if (older["set"], older["planner"]) == (row["set"], row["planner"]):
                self.rows[index] = row
                return
        self.rows.append(row)

    def _forget_unused_runs(self) -> None:
        """Drop the runs that no row names, and number the others anew."""
        rows = [*self.rows, *self.differences]
        used = sorted({row["run"] for row in rows})
        self.runs = [self.runs[index] for index in used]
        for row in rows:
            row["run"] = used.index(row["run"])


def plain(number: Any) -> Any:
    """Return a figure of a table as JSON has it: rounded, and None for NaN."""
    if isinstance(number, str) or number is None:
        return number
    if float(number).is_integer():
        return int(number)
    return None if pd.isna(number) else round(float(number), DIGITS)


def this_run(command: str) -> dict[str, Any]:
    """Return what a row says of the command that measured it, and of this machine."""
    versions = {"python": platform.python_version()}
    versions |= {package: importlib.metadata.version(package) for package in PACKAGES}
    return {
        "command": command,
        "date": datetime.datetime.now(datetime.timezone.utc).date().isoformat(),
        "machine": f"{processor()}, {os.cpu_count()} cores, {platform.system()}",
        "threads": torch.get_num_threads(),
        "versions": versions,
    }


def processor() -> str:
    """Return the processor's name."""
    if Path("/proc/cpuinfo").exists():
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
