"""What the benchmarks share: timing side by side, and one markdown table with the machine and the
versions on top.
"""

from __future__ import annotations

import os
import platform
import re
import statistics
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

AT_LEAST = 0.05
"""Seconds that one timing takes at least: short calls are repeated until they fill it."""


class Row(NamedTuple):
    """A line of the table; every value carries its unit."""

    work: str
    mapdata: str = ""
    other: str = ""
    ratio: str = ""
    target: str = ""
    note: str = ""

    @property
    def is_missed(self) -> bool:
        """Whether the target is missed: a lowest ratio or rate, or a limit of anything else."""
        if not self.target:
            return False
        wanted, unit = quantities(self.target)[0]
        found = [
            value
            for value, its_unit in quantities(self.ratio if unit == "x" else self.mapdata)
            if its_unit == unit
        ]
        is_limit = unit not in ("x", "samples/s") or self.work.startswith("growth")
        if not found:  # a peer that is not installed
            return False
        return max(found) > wanted if is_limit else min(found) < wanted


SECONDS = {"us": 1e-6, "ms": 1e-3, "s": 1.0}


def quantities(text: str) -> list[tuple[float, str]]:
    """Return the values of a cell with their units, times in seconds."""
    found = re.findall(r"(-?[\d.,]*\d) ?(x|us|ms|s|samples/s|bytes|MB)(?![\w/])", text)
    return [
        (float(number.replace(",", "")) * SECONDS.get(unit, 1.0), "s" if unit in SECONDS else unit)
        for number, unit in found
    ]


class Peer(NamedTuple):
    """Somebody else's code that a table stands beside.

    Attributes:
        name: as the rows call it.
        package: what pip calls it.
        module: what Python calls it.
        command: the call that is timed.
    """

    name: str
    package: str
    module: str
    command: str

    @property
    def absence(self) -> str:
        """Why it is skipped; empty if it is there."""
        return absence(self.module)

    def load(self) -> Any:
        """Return its module."""
        return import_module(self.module)


@cache
def absence(module: str) -> str:
    """Return why ``module`` cannot be used, empty if it can."""
    try:
        import_module(module)
    except ModuleNotFoundError as error:
        return (
            "not installed"
            if error.name and module.startswith(error.name)
            else f"does not import: {error}"
        )
    except ImportError as error:
        return f"does not import: {error}"
    return ""


def interleaved(
    contestants: Mapping[str, Callable[[], object]],
    rounds: int,
    after: Callable[[], object] = lambda: None,
    clock: Callable[[], float] = time.process_time,
) -> dict[str, list[float]]:
    """Return the seconds that a call of each contestant took, one value a round.

    Each is called twice to warm up. Then the contestants take turns, so that what else the machine
    does meets all of them. ``after`` is called after each timing, to clean up. ``clock`` is that of
    `seconds`.
    """
    calls = {}
    for name, function in contestants.items():
        function()  # compiles
        after()
        calls[name] = max(1, round(AT_LEAST / max(seconds(function, clock=clock), 1e-9)))
        after()
    times: dict[str, list[float]] = {name: [] for name in contestants}
    for name in [*contestants] * rounds:
        times[name].append(seconds(contestants[name], calls[name], clock))
        after()
    return times


def seconds(
    function: Callable[[], object],
    calls: int = 1,
    clock: Callable[[], float] = time.process_time,
) -> float:
    """Return the seconds that one of ``calls`` calls took.

    They are CPU seconds of all threads of this process, which other programs on the machine do not
    lengthen. What waits for disks or other processes needs `time.perf_counter` as its ``clock``.
    """
    began = clock()
    for _ in range(calls):
        function()
    return (clock() - began) / calls


def median_ratio(slow: list[float], fast: list[float]) -> float:
    """Return how many times ``fast`` is faster: the median over the rounds."""
    return statistics.median(a / b for a, b in zip(slow, fast, strict=True))


def each(times: list[float], count: int) -> str:
    """Return the median of ``times`` for one of ``count`` pieces of work, with its unit."""
    value = statistics.median(times) / count
    if value >= 1:
        return f"{value:.3g} s"
    return f"{value * 1e3:.3g} ms" if value >= 1e-3 else f"{value * 1e6:.3g} us"


def to_text(
    title: str,
    rows: Iterable[Row],
    *,
    packages: Sequence[str],
    notes: Iterable[str],
    peers: Sequence[Peer] = (),
) -> str:
    """Return the table in markdown; the versions, the machine and the peers' commands follow it."""
    found = versions([*packages, *(peer.package for peer in peers if peer.package not in packages)])
    commands = [
        f"{peer.name}: {f'skipped, {why}' if (why := peer.absence) else f'`{peer.command}`'}"
        for peer in peers
    ]
    text = [f"## {title}", ""]
    marked = (
        row._replace(target=f"{row.target}, missed") if row.is_missed else row for row in rows
    )
    text.append(to_markdown([[*Row._fields], *([*row] for row in marked)]))
    text += ["", *(f"- {fact}" for fact in (found, machine(), *notes, *commands))]
    return "\n".join(text) + "\n"


def to_markdown(lines: Sequence[Sequence[str]]) -> str:
    """Return a table in markdown with columns of even width; the first of ``lines`` is its head."""
    widths = [max(len(cell) for cell in column) for column in zip(*lines, strict=True)]
    head, *rows = lines
    return "\n".join(
        f"| {' | '.join(cell.ljust(width) for cell, width in zip(cells, widths, strict=True))} |"
        for cells in (head, ["-" * width for width in widths], *rows)
    )


def versions(packages: Iterable[str]) -> str:
    """Return the versions of Python and of ``packages``."""
    found = [f"Python {platform.python_version()}"]
    for name in packages:
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            found.append(f"{name} not installed")
    return ", ".join(found)


def machine() -> str:
    """Return processor, cores, system, and how busy the machine is."""
    name = platform.processor() or platform.machine()
    if (cpuinfo := Path("/proc/cpuinfo")).exists():
        models = [
            line.split(":", 1)[1].strip()
            for line in cpuinfo.read_text().splitlines()
            if "model name" in line
        ]
        name = models[0] if models else name
    load = f", load {os.getloadavg()[0]:.1f} at the end" if hasattr(os, "getloadavg") else ""
    return f"{name}, {os.cpu_count()} cores, {platform.system()} {platform.release()}{load}"
