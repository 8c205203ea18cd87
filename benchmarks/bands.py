"""How many goals a map gets where problems are rare: python -m benchmarks bands.

A random problem with conditions is drawn goal by goal. With more goals, fewer maps are left without
a problem, and those that are left cost more. The table shows both, beside the number that is used.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.measure import Row, to_text
from mapdata import Forest, Movement, Random, generate
from mapdata.datasets import DRAWS
from mapdata.problems import sample_problems
from mapdata.search import MapStack, move_rule

PACKAGES = ("mapdata-torch", "numpy", "numba")
GOALS = (4, DRAWS)
WALLS = "random walls 30 x 30"
CASES: tuple[tuple[str, int, dict[str, Any]], ...] = (
    ("paper", 4, {"hardness": (1.05, None)}),
    ("paper", 8, {"distance": (100, None)}),
    ("dungeon", 8, {"hardness": (1.05, None)}),
    ("cave", 8, {"distance": (100, None)}),
    ("noise", 8, {"hardness": (1.5, None)}),
    (WALLS, 4, {"length": (61, None)}),
    (WALLS, 4, {"length": (110, None)}),
)


def cpu_seconds(function: Callable[[], Any]) -> tuple[float, Any]:
    """Return the CPU time of the second of two calls, since the first compiles, and its result."""
    function()
    began = time.process_time()
    result = function()
    return time.process_time() - began, result


def case_rows(
    maps: str, connectivity: int, bands: dict[str, Any], count: int, rounds: int
) -> list[Row]:
    """Return a row for each number of goals, on ``count`` maps."""
    family: Any = Forest((30, 30), cover=(0.3, 0.5), sizes=(1, 1)) if maps == WALLS else maps
    map_seconds, generated = cpu_seconds(lambda: generate(family, 5, range(count)))
    grids = np.ascontiguousarray(generated.occupancy)
    conditions = Random(**bands).conditions
    rule = move_rule(Movement(connectivity))
    seconds = dict.fromkeys(GOALS, np.inf)
    found = dict.fromkeys(GOALS, 0)
    for _ in range(rounds):
        for goals in GOALS:
            began = time.process_time()
            ends, *_ = sample_problems(
                MapStack(grids, None),
                None,
                np.uint64(1),
                0,
                np.arange(count),
                (0, goals),
                *conditions,
                rule,
            )
            seconds[goals] = min(seconds[goals], time.process_time() - began)
            found[goals] = int((ends[:, 0] >= 0).sum())
    name, (lowest, _) = next(iter(bands.items()))
    fewest = min((seconds[k] + map_seconds) / max(found[k], 1) for k in GOALS)
    rows = []
    for goals in GOALS:
        problem_seconds = (seconds[goals] + map_seconds) / max(found[goals], 1)
        rows.append(
            Row(
                f"{maps}, {connectivity} moves, {name} >= {lowest}: {goals} goals",
                f"{problem_seconds * 1e6:.0f} us a problem",
                ratio=f"{problem_seconds / fewest:.2f} of the least",
                note=f"{1 - found[goals] / count:.1%} of maps without"
                + (", as datasets have it" if goals == DRAWS else ""),
            )
        )
    return rows


def table(quick: bool, folder: str | None = None) -> str:
    """Return the table in markdown; ``quick`` takes fewer maps, and ``folder`` is not used."""
    count = 100 if quick else 400
    rows: list[Row] = []
    for maps, connectivity, bands in CASES:
        # Few problems are found under the rarest conditions, on maps that take little time.
        rows += case_rows(
            maps, connectivity, bands, count * (10 if maps == WALLS else 1), 1 if quick else 3
        )
    return to_text(
        "Goals a map gets, under conditions",
        rows,
        packages=PACKAGES,
        notes=(
            "CPU time of a problem, with the maps that it takes and those without a problem.",
            f"A map gets {DRAWS} goals: fewest maps are left without a problem, common conditions "
            "cost the same, and rare ones at most a few times what fewer goals cost.",
        ),
    )
