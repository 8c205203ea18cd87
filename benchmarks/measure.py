"""What the benchmarks share: timing side by side, and one markdown table with the machine and the versions on top."""

from __future__ import annotations

import os
import platform
import statistics
import time
from collections.abc import Callable, Iterable, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple

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


def interleaved(
    contestants: Mapping[str, Callable[[], object]], rounds: int, after: Callable[[], object] = lambda: None
) -> dict[str, list[float]]:
    """Return the seconds that a call of each contestant took, one value a round.

    Each is called twice to warm up. Then the contestants take turns, so that what else the machine does meets all of
    them. ``after`` is called after each timing, to clean up.
    """
    calls = {}
    for name, function in contestants.items():
        function()  # compiles
        after()
        calls[name] = max(1, round(AT_LEAST / seconds(function)))
        after()
    times: dict[str, list[float]] = {name: [] for name in contestants}
    for name in [*contestants] * rounds:
        times[name].append(seconds(contestants[name], calls[name]))
        after()
    return times


def seconds(function: Callable[[], object], calls: int = 1) -> float:
    """Return the seconds that one of ``calls`` calls took."""
    began = time.perf_counter()
    for _ in range(calls):
        function()
    return (time.perf_counter() - began) / calls


def median_ratio(slow: list[float], fast: list[float]) -> float:
    """Return how many times ``fast`` is faster: the median over the rounds."""
    return statistics.median(a / b for a, b in zip(slow, fast, strict=True))


def each(times: list[float], count: int) -> str:
    """Return the median of ``times`` for one of ``count`` pieces of work, with its unit."""
    value = statistics.median(times) / count
    if value >= 1:
        return f"{value:.3g} s"
    return f"{value * 1e3:.3g} ms" if value >= 1e-3 else f"{value * 1e6:.3g} us"


def print_table(title: str, rows: Iterable[Row], *, packages: Iterable[str], notes: Iterable[str]) -> None:
    """Print the table, with versions and machine on top."""
    print(f"# {title}\n")
    for fact in (versions(packages), machine(), *notes):
        print(f"- {fact}")
    lines = [[*Row._fields], *([*row] for row in rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(Row._fields))]
    lines.insert(1, ["-" * width for width in widths])
    print()
    for cells in lines:
        print("| " + " | ".join(text.ljust(width) for text, width in zip(cells, widths, strict=True)) + " |")


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
        models = [line.split(":", 1)[1].strip() for line in cpuinfo.read_text().splitlines() if "model name" in line]
        name = models[0] if models else name
    load = f", load {os.getloadavg()[0]:.1f} at the end" if hasattr(os, "getloadavg") else ""
    return f"{name}, {os.cpu_count()} cores, {platform.system()} {platform.release()}{load}"
