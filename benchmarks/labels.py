"""Labels on one core beside naive Python, and how they grow: python -m benchmarks labels.

Run as a file, it prints the table of `paths` too.

Everything is measured in one run. The naive implementation (naive.py) gives the same labels, which
is checked first.
"""

from __future__ import annotations

import math
import statistics
from dataclasses import replace
from functools import partial
from itertools import pairwise

import mapdata
from benchmarks import naive
from benchmarks.measure import Row, each, interleaved, median_ratio, to_text
from benchmarks.paths import problems_of, table_1
from mapdata import MapSpec, Movement, generate, label

PACKAGES = ("mapdata-torch", "numpy", "numba")
SIZES, ROOMS = (64, 128, 256, 512), (9, 32)
DIFFERENT = 1000
"""Maps of a batch that are all different."""


def label_rows(count: int, rounds: int) -> list[Row]:
    """Return the rows of all labels, and of each stage, beside the naive implementation."""
    generator = MapSpec.preset("paper")
    # Both sides do the same maps; ours so often that a batch is as large as the one of different
    # maps below.
    indices = [*range(count)] * math.ceil(DIFFERENT / count)
    maps = generate(generator, 0, range(count))
    bad = {i: found for i in range(count) if (found := naive.differences(label(maps), i))}
    if bad:
        raise SystemExit(f"mapdata and naive.py differ on maps {bad}: nothing was measured")
    drawings = [naive.drawing_of(maps, i) for i in range(count)]
    work = [(maps.occupancy[i], naive.seed_points_of(maps, i)) for i in range(count)]
    for each_map in work:
        if repr(naive.careful_label(*each_map)) != repr(naive.label(*each_map)):
            raise SystemExit("naive.label and careful_label differ: nothing was measured")
    segments, pairs = (problems_of(maps, every_pair=every) for every in (False, True))
    times = interleaved(
        {
            "all": lambda: label(generate(generator, 0, indices)),
            "naive all": lambda: [
                naive.label(naive.carve(drawings[i]), work[i][1]) for i in range(count)
            ],
            "careful all": lambda: [
                naive.careful_label(naive.carve(drawings[i]), work[i][1]) for i in range(count)
            ],
            "different": lambda: label(generate(generator, 0, range(DIFFERENT))),
            "draw": lambda: generate(generator, 0, indices),
            "naive draw": lambda: [naive.carve(drawing) for drawing in drawings],
            "bfs": lambda: mapdata.search_batch(
                "bfs", segments.grids, segments.starts, segments.goals
            ),
            "naive bfs": lambda: [naive.bfs_route(*each_map) for each_map in work],
            "fields": lambda: [
                mapdata.distance_field(grid, seed)
                for grid, seed_points in work
                for seed in seed_points
            ],
            "naive fields": lambda: [naive.bfs_matrix(*each_map) for each_map in work],
            "astar": lambda: mapdata.search_batch(
                "astar", segments.grids, segments.starts, segments.goals
            ),
            "naive astar": lambda: [naive.astar_route(*each_map) for each_map in work],
            "pairs": lambda: mapdata.search_batch("astar", pairs.grids, pairs.starts, pairs.goals),
            "naive pairs": lambda: [naive.astar_matrix(*each_map) for each_map in work],
        },
        rounds,
    )
    shared = [
        sum(parts)
        for parts in zip(
            *(times[f"naive {name}"] for name in ("draw", "fields", "pairs")), strict=True
        )
    ]

    def row(
        work: str, name: str, batch: int, other: list[float], note: str, target: str = ""
    ) -> Row:
        ratio = median_ratio(other, times[name]) * batch / count
        return Row(
            work, each(times[name], batch), each(other, count), f"{ratio:,.0f}x", target, note
        )

    many = len(indices)
    return [
        row(
            "all labels, per map",
            "all",
            many,
            times["naive all"],
            "naive.py: equal on all maps; no draws",
            "700x",
        ),
        row("the same", "all", many, shared, "naive.py, had it shared searches as label does"),
        row(
            "the same",
            "all",
            many,
            times["careful all"],
            "careful_label of naive.py: flat lists, shared searches",
        ),
        Row("the same, all maps different", each(times["different"], DIFFERENT)),
        row("draw and carve, per map", "draw", many, times["naive draw"], "naive.py: no draws"),
        row(
            "BFS between consecutive rooms, per map",
            "bfs",
            count,
            times["naive bfs"],
            "naive.py; search_batch",
        ),
        row(
            "BFS from every room, per map",
            "fields",
            count,
            times["naive fields"],
            "naive.py; distance_field a room",
        ),
        row(
            "A* between consecutive rooms, per map",
            "astar",
            count,
            times["naive astar"],
            "naive.py; search_batch",
        ),
        row(
            "A* between all rooms, per map",
            "pairs",
            count,
            times["naive pairs"],
            "naive.py; search_batch",
        ),
    ]


def movement_rows(rounds: int) -> list[Row]:
    """Return the rows of harder maps, under both connectivities, and of very many rooms."""
    halls = MapSpec(
        map_size=(256, 256),
        rooms=(200, 200),
        room_rows=(8, 20),
        room_columns=(8, 20),
        passage_width=(2, 4),
    )
    # the spec, how many maps, and the limits of time, 4-connected and 8-connected
    cases = {
        "preset paper": (MapSpec.preset("paper"), 200, "", ""),
        "preset dungeon": (MapSpec.preset("dungeon"), 100, "", ""),
        "preset dungeon128": (MapSpec.preset("dungeon128"), 10, "", "12 ms"),
        "256 x 256, 200 rooms": (halls, 1, "50 ms", "0.3 s"),
    }
    works = {}
    counts = {}
    limits = {}
    for case, (generator, count, limit_4, limit_8) in cases.items():
        for movement, limit in ((Movement(4), limit_4), (Movement(8), limit_8)):
            name = f"{case}, {movement.connectivity}-connected"
            works[name] = partial(_draw_and_label, replace(generator, movement=movement), count)
            counts[name] = count
            limits[name] = limit
    times = interleaved(works, rounds)
    rows = []
    for name, count in counts.items():
        time = each(times[name], count)
        rows.append(Row(f"all labels, {name}, per map", time, target=limits[name]))
    return rows


def growth_rows(work: float, rounds: int) -> list[Row]:
    """Return the rows of growing maps: rooms and passages as large a share of the side as in Table
    1.

    Args:
        work: how many cells times sources a batch has, about.
        rounds: how often each is timed.
    """
    works = {}
    counts = {}
    for size in SIZES:
        for rooms in ROOMS:
            count = max(4, round(work / (size * size * rooms)))
            counts[size, rooms] = count
            generator = table_1(size, (rooms, rooms))
            works[f"{size} {rooms}"] = partial(_draw_and_label, generator, count)
    times = interleaved(works, rounds)
    rows = []
    cost = {
        (size, rooms): statistics.median(times[f"{size} {rooms}"]) / count
        for (size, rooms), count in counts.items()
    }
    few, many = ROOMS
    for small, large in pairwise(SIZES):
        growth = " and ".join(f"{cost[large, rooms] / cost[small, rooms]:.1f}x" for rooms in ROOMS)
        rows.append(
            Row(
                f"growth, side {small} to {large}",
                ratio=growth,
                note=f"{few} and {many} rooms; 4x the cells",
            )
        )
    growth = ", ".join(f"{cost[size, many] / cost[size, few]:.1f}x" for size in SIZES)
    pairs = many * (many - 1) / (few * (few - 1))
    note = (
        f"sides {', '.join(map(str, SIZES))}; {many / few:.1f}x the rooms, {pairs:.1f}x the pairs "
        "for A*, and more free cells"
    )
    return [
        *rows,
        Row(f"growth, {few} to {many} rooms", ratio=growth, note=note),
    ]


def _draw_and_label(generator: MapSpec, count: int) -> object:
    return label(generate(generator, 0, range(count)))


def table(quick: bool, parent: str | None = None) -> str:
    """Measure, and return the table; nothing is written."""
    rounds = 3 if quick else 9
    rows = [
        *label_rows(10 if quick else 40, rounds),
        *movement_rows(rounds),
        *growth_rows(5e6 if quick else 2e8, rounds),
    ]
    notes = (
        f"{rounds} repeats",
        "preset paper (64 x 64), 4-connected, unless a row names another",
    )
    return to_text("Labels on one core", rows, packages=PACKAGES, notes=notes)
