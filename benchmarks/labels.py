"""Labels on one core beside naive Python and pyastar2d, and how they grow: python benchmarks/labels.py [--quick].

Everything is measured in one run. The naive implementation (naive.py) gives the same labels, which is checked first;
pyastar2d (pip install -e ".[bench]") must find paths of the same length, and is left out where it is absent.
"""

from __future__ import annotations

import argparse
import math
import statistics
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import combinations, pairwise
from typing import TypeAlias

import naive
import numpy as np
import numpy.typing as npt
from measure import Row, each, interleaved, median_ratio, print_table

import mapdata
from mapdata import MapSpec, generate, label

Ints: TypeAlias = npt.NDArray[np.int64]
Path: TypeAlias = npt.NDArray[np.int64] | npt.NDArray[np.int32] | None

PACKAGES = ("mapdata", "numpy", "numba", "pyastar2d")
SIZES, ROOMS = (64, 128, 256, 512), (9, 32)
DIFFERENT = 1000
"""Maps of a batch that are all different."""


@dataclass(frozen=True)
class Problems:
    """P path problems, each with a grid of its own: (P, H, W) uint8, and (P, 2) start and goal cells."""

    grids: npt.NDArray[np.uint8]
    starts: Ints
    goals: Ints

    def __len__(self) -> int:
        """Return the number of problems."""
        return len(self.starts)

    def one_by_one(self, solve: Callable[[int, naive.Cell, naive.Cell], Path]) -> list[Path]:
        """Return what ``solve(k, start, goal)`` gives for each problem."""
        ends = zip(self.starts.tolist(), self.goals.tolist(), strict=True)
        return [solve(k, (start[0], start[1]), (goal[0], goal[1])) for k, (start, goal) in enumerate(ends)]


def problems_of(maps: mapdata.Maps, *, every_pair: bool) -> Problems:
    """Return the problems of a batch: between consecutive seeds, or between every pair of seeds of a map."""
    owners, starts, goals = [], [], []
    for i in range(len(maps)):
        seeds = naive.seeds_of(maps, i)
        for start, goal in combinations(seeds, 2) if every_pair else pairwise(seeds):
            owners.append(i)
            starts.append(start)
            goals.append(goal)
    return Problems(maps.occupancy[np.array(owners)], np.array(starts), np.array(goals))


def label_rows(count: int, rounds: int) -> list[Row]:
    """Return the rows of all labels, and of each stage, beside the naive implementation."""
    spec = MapSpec.preset("paper")
    # Both sides do the same maps; ours so often that a batch is as large as the one of different maps below.
    indices = [*range(count)] * math.ceil(DIFFERENT / count)
    maps = generate(spec, 0, range(count))
    bad = {i: found for i in range(count) if (found := naive.differences(label(maps), i))}
    if bad:
        raise SystemExit(f"mapdata and naive.py differ on maps {bad}: nothing was measured")
    drawings = [naive.drawing_of(maps, i) for i in range(count)]
    work = [(maps.occupancy[i], naive.seeds_of(maps, i)) for i in range(count)]
    segments, pairs = (problems_of(maps, every_pair=every) for every in (False, True))
    times = interleaved(
        {
            "all": lambda: label(generate(spec, 0, indices)),
            "naive all": lambda: [naive.label(naive.carve(drawings[i]), work[i][1]) for i in range(count)],
            "different": lambda: label(generate(spec, 0, range(DIFFERENT))),
            "draw": lambda: generate(spec, 0, indices),
            "naive draw": lambda: [naive.carve(drawing) for drawing in drawings],
            "bfs": lambda: mapdata.search_batch("bfs", segments.grids, segments.starts, segments.goals),
            "naive bfs": lambda: [naive.bfs_route(*each_map) for each_map in work],
            "fields": lambda: [mapdata.distance_field(grid, seed) for grid, seeds in work for seed in seeds],
            "naive fields": lambda: [naive.bfs_matrix(*each_map) for each_map in work],
            "astar": lambda: mapdata.search_batch("astar", segments.grids, segments.starts, segments.goals),
            "naive astar": lambda: [naive.astar_route(*each_map) for each_map in work],
            "pairs": lambda: mapdata.search_batch("astar", pairs.grids, pairs.starts, pairs.goals),
            "naive pairs": lambda: [naive.astar_matrix(*each_map) for each_map in work],
        },
        rounds,
    )
    shared = [
        sum(parts) for parts in zip(*(times[f"naive {name}"] for name in ("draw", "fields", "pairs")), strict=True)
    ]

    def row(work: str, name: str, batch: int, other: list[float], note: str, target: str = "") -> Row:
        ratio = median_ratio(other, times[name]) * batch / count
        return Row(work, each(times[name], batch), each(other, count), f"{ratio:,.0f}x", target, note)

    many = len(indices)
    return [
        row("all labels, a map", "all", many, times["naive all"], "naive.py: equal on all maps; no draws", "700x"),
        row("the same", "all", many, shared, "naive.py, had it shared searches as label does"),
        Row("the same, all maps different", each(times["different"], DIFFERENT)),
        row("draw and carve, a map", "draw", many, times["naive draw"], "naive.py: no draws"),
        row("BFS between consecutive rooms, a map", "bfs", count, times["naive bfs"], "naive.py; search_batch"),
        row("BFS from every room, a map", "fields", count, times["naive fields"], "naive.py; distance_field a room"),
        row("A* between consecutive rooms, a map", "astar", count, times["naive astar"], "naive.py; search_batch"),
        row("A* between all rooms, a map", "pairs", count, times["naive pairs"], "naive.py; search_batch"),
    ]


def path_rows(count: int, rounds: int) -> list[Row]:
    """Return the rows of A* a path, called from Python, beside pyastar2d: on maps of Table 1, and of 4 times the
    side, where its O(cells) of setting up weigh more.
    """
    try:
        import pyastar2d
    except ImportError:
        pyastar2d = None
    contestants: dict[str, Callable[[], object]] = {}
    works = []
    for size in (64, 256):
        maps = generate(_table_1(size), 1, range(count * 64 // size))
        own = problems_of(maps, every_pair=False)
        # A batch on one grid: the same number of problems, between free cells of the first map.
        free = np.argwhere(maps.occupancy[0] == 0)
        drawn = np.random.default_rng(0).integers(len(free), size=(2, len(own)))
        one = Problems(np.broadcast_to(maps.occupancy[0], own.grids.shape), free[drawn[0]], free[drawn[1]])
        contestants |= {
            f"single {size}": partial(_one_by_one, own),
            f"batch {size}": partial(mapdata.search_batch, "astar", own.grids, own.starts, own.goals),
            f"one grid {size}": partial(mapdata.search_batch, "astar", one.grids[0], one.starts, one.goals),
        }
        if pyastar2d is not None:
            for name, problems in (("theirs", own), ("theirs on one", one)):
                theirs = _theirs(pyastar2d.astar_path, problems)
                _check_lengths(problems, theirs())
                contestants[f"{name} {size}"] = theirs
        works += [
            (f"A* a path, {size} x {size}, single calls", "single", "theirs", "15x", size, len(own)),
            (f"A* a path, {size} x {size}, one call, a grid each", "batch", "theirs", "80x", size, len(own)),
            (f"A* a path, {size} x {size}, one call, one grid", "one grid", "theirs on one", "80x", size, len(own)),
        ]
    times = interleaved(contestants, rounds)
    rows = []
    for work, name, other, target, size, problems_count in works:
        ours, value = times[f"{name} {size}"], each(times[f"{name} {size}"], problems_count)
        if f"{other} {size}" in times:
            theirs_times = times[f"{other} {size}"]
            ratio, note = median_ratio(theirs_times, ours), f"pyastar2d: equal lengths, {problems_count} paths"
            rows.append(Row(work, value, each(theirs_times, problems_count), f"{ratio:.1f}x", target, note))
        else:
            rows.append(Row(work, value, target=target, note="pyastar2d: not installed, skipped"))
    return rows


def _one_by_one(problems: Problems) -> list[Path]:
    return problems.one_by_one(lambda k, start, goal: mapdata.astar(problems.grids[k], start, goal).path)


def _theirs(astar_path: Callable[..., Path], problems: Problems) -> Callable[[], list[Path]]:
    """Return what solves ``problems`` one by one with pyastar2d, its weights made beforehand."""
    weights = np.where(problems.grids == 1, np.inf, 1).astype(np.float32)
    return lambda: problems.one_by_one(lambda k, start, goal: astar_path(weights[k], start, goal))


def _check_lengths(problems: Problems, theirs: list[Path]) -> None:
    """Stop if pyastar2d found paths of other lengths than `mapdata` did."""
    ours = np.diff(mapdata.search_batch("astar", problems.grids, problems.starts, problems.goals).offsets)
    lengths = np.array([0 if path is None else len(path) for path in theirs])
    if not np.array_equal(ours, lengths):
        k = int(np.flatnonzero(ours != lengths)[0])
        raise SystemExit(f"mapdata and pyastar2d differ: {ours[k]} and {lengths[k]} cells on problem {k}")


def growth_rows(work: float, rounds: int) -> list[Row]:
    """Return the rows of growing maps: rooms and tunnels as large a share of the side as in Table 1.

    Args:
        work: how many cells times sources a batch has, about.
        rounds: how often each is timed.
    """
    batches = [(size, rooms, max(4, round(work / (size * size * rooms)))) for size in SIZES for rooms in ROOMS]
    times = interleaved(
        {
            f"{size} {rooms}": partial(_draw_and_label, _table_1(size, (rooms, rooms)), count)
            for size, rooms, count in batches
        },
        rounds,
    )
    rows, cost = [], {}
    for size, rooms, count in batches:
        seconds = times[f"{size} {rooms}"]
        cost[size, rooms] = statistics.median(seconds) / count
        free = 1 - generate(_table_1(size, (rooms, rooms)), 0, range(count)).occupancy.mean()
        note = (
            f"{cost[size, rooms] * 1e9 / (size * size * rooms):.2f} ns a cell and source; {free:.0%} free; {count} maps"
        )
        rows.append(Row(f"all labels, {size} x {size}, {rooms} rooms, a map", each(seconds, count), note=note))
    few, many = ROOMS
    for small, large in pairwise(SIZES):
        growth = " and ".join(f"{cost[large, rooms] / cost[small, rooms]:.1f}x" for rooms in ROOMS)
        rows.append(Row(f"growth, side {small} to {large}", ratio=growth, target="4x", note=f"{few} and {many} rooms"))
    growth = ", ".join(f"{cost[size, many] / cost[size, few]:.1f}x" for size in SIZES)
    pairs = many * (many - 1) / (few * (few - 1))
    note = f"sides {', '.join(map(str, SIZES))}; {pairs:.1f}x the pairs for A*, and more free cells"
    return [*rows, Row(f"growth, {few} to {many} rooms", ratio=growth, target=f"{many / few:.1f}x", note=note)]


def _table_1(size: int, rooms: tuple[int, int] = (2, 9)) -> MapSpec:
    """Return Table 1 for maps of ``size`` x ``size``: rooms and tunnels as large a share of the side."""
    scale = size // 64
    sides = 14 * scale, 33 * scale
    width = 7 * scale, 15 * scale
    return MapSpec((size, size), rooms, room_rows=sides, room_columns=sides, passage_width=width)


def _draw_and_label(spec: MapSpec, count: int) -> object:
    return label(generate(spec, 0, range(count)))


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--quick", action="store_true", help="a small run: seconds instead of minutes, rough figures")
    quick = parser.parse_args().quick
    rounds = 3 if quick else 9
    rows = [
        *label_rows(10 if quick else 40, rounds),
        *path_rows(100 if quick else 400, rounds),
        *growth_rows(5e6 if quick else 2e8, rounds),
    ]
    notes = (
        f"medians of {rounds} repeats, the contestants taking turns; one thread; a ratio is the median of the repeats'",
        "preset paper (64 x 64, Table 1), 4-connected; targets are ratios, for growth what linear would be",
    )
    print_table("Labels on one core", rows, packages=PACKAGES, notes=notes)


if __name__ == "__main__":
    main()
