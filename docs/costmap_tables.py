"""Measure costmaps that are learnt from drives, and write the results of docs/howto/costmap.md.

    python docs/costmap_tables.py --named            the drivers on generated maps
    python docs/costmap_tables.py --nav2 NAV2        the drivers on maps of Nav2
    python docs/costmap_tables.py --tracks TRACKS    the race lines
    python docs/costmap_tables.py                    the page again, measuring nothing

Each of the three replaces its part of docs/costmap_results.json. NAV2 is a clone of
https://github.com/ros-navigation/navigation2, for its maps. TRACKS is a clone of
https://github.com/f1tenth/f1tenth_racetracks, for race lines that nobody here wrote. All three
together take half an hour on one core.

Drivers are programs. Each has hidden costs and drives the cheapest paths under them, on one map.
The costs learnt from its drives are tried on several: the regret is how much dearer the planned
paths are than the cheapest ones, under the hidden costs.

The maps of `NAMED_MAPS` and the seeds of `NAMED_SEEDS` were written down before the fit was
changed, and nothing was measured on them before it was finished. Choices were made on the maps of
Nav2 with seed 100; the page has seeds 0 to 2 of them.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import torch
from planner_tables import filled, markdown

from mapdata import Movement, check_path, generate, search_batch, terrain_from_costs
from mapdata.arrays import Bytes, Float32s, Floats, Ints
from mapdata.costmaps import Costmap, fit_costmap, inflation_costs, site_of
from mapdata.formats import RosMap
from mapdata.formats.ros import read_map
from mapdata.generators.points import largest_component
from mapdata.search import clearance, inflate
from mapdata.search.lattice import CORNER_CUTTING
from mapdata.shards import write_output

DOCS = Path(__file__).parent
RESULTS = DOCS / "costmap_results.json"
PAGE = DOCS / "howto" / "costmap.md"

MOVEMENT = Movement(8, corner_cutting=True)  # that of fit_costmap
ROBOT_RADIUS = 0.2
TRAINING_MAP = "nav2_bringup/maps/depot.yaml"
TEST_MAPS = {
    "depot": TRAINING_MAP,
    "tb3_sandbox": "nav2_bringup/maps/tb3_sandbox.yaml",
    "warehouse": "nav2_bringup/maps/warehouse.yaml",
    "smoothers_world": "tools/smoother_benchmarking/maps/smoothers_world.yaml",
}
"""The maps, by their places in the repository."""

NAMED_MAPS_SEED = 20261128
NAMED_MAPS = {
    "dungeon 0": ("dungeon", 0, 0.5),
    "dungeon 1": ("dungeon", 1, 0.5),
    "paper 2": ("paper", 2, 0.25),
    "cave 3": ("cave", 3, 0.25),
    "forest 4": ("forest", 4, 0.25),
}
"""Generated maps: a preset, the number of a map of seed `NAMED_MAPS_SEED`, and the metres of one of
its cells. Drivers drive on the first one.
"""

RESOLUTION = 0.05
"""Metres of a cell of a robot's map, to which generated maps are refined."""

NAMED_SEEDS = range(40, 45)
STUDENT = 2.776
"""The quantile .975 of Student's t with four degrees of freedom, for five seeds."""

NAMED_ROWS = (
    ("keeps .6 m, sloppy", 20),
    ("an inflation layer, sloppy", 20),
    ("keeps .6 m from walls", 5),
    ("an inflation layer", 5),
    ("keeps .6 m from walls", 20),
    ("an inflation layer", 20),
    ("smooth lines", 20),
    ("lag", 20),
    ("drift", 20),
)
"""Drivers and numbers of drives on the generated maps. The last three drive in a way that no costs
of cells have, whose noise is not that of the fit.
"""

TRACKS = ("Austin", "Catalunya", "Monza", "Silverstone", "Zandvoort")
"""The race tracks."""

TEST_PROBLEMS = 60
MIN_METRES = 3.0
"""Start and goal of a drive are at least so far apart, along one axis."""

SEEDS = range(3)
DRIVES = (5, 20)

Hidden = Callable[[Floats], Floats]
"""Hidden cost of a clearance in metres."""


def lane(metres: Floats) -> Floats:
    """Return costs of a driver who keeps .6 m from walls: nearer and farther cells cost more."""
    return 1 + 6 * np.abs(np.minimum(metres, 1.5) - 0.6)


def wide(metres: Floats) -> Floats:
    """Return costs of a driver who keeps away from walls, as an inflation layer says."""
    return 1 + 4 * np.exp(-(metres - ROBOT_RADIUS) / 0.3)


class Place:
    """A map with the hidden costs of a driver.

    Attributes:
        ros_map: the map.
        grid: (H, W), where the middle of the robot can be.
        costs: (H, W) hidden costs, 1 where occupied.
        terrain: (H, W) the same as a search takes them.
        ends: (n, 2) cells of the largest connected component.
    """

    def __init__(self, ros_map: RosMap, hidden: Hidden, carpet: bool = False) -> None:
        """Compute the costs; ``carpet`` makes a third of the floor three times as dear."""
        self.ros_map = ros_map
        obstacles = self.ros_map.grid("occupied")
        self.grid = inflate(obstacles, ROBOT_RADIUS / self.ros_map.resolution)
        metres = clearance(obstacles).astype(np.float64) * self.ros_map.resolution
        self.costs = np.where(self.grid, 1.0, hidden(metres))
        if carpet:
            self.costs = np.where(_patches(self.grid.shape), 3 * self.costs, self.costs)
        self.terrain = terrain_from_costs(self.costs[None], self.grid[None])[0]
        indices = largest_component(self.grid, CORNER_CUTTING)
        self.ends = np.stack(np.unravel_index(indices, self.grid.shape), axis=1)

    def draw_ends(self, rng: np.random.Generator) -> tuple[Ints, Ints]:
        """Return a start and a goal that are not close to each other, (1, 2) each."""
        while True:
            start, goal = self.ends[rng.integers(len(self.ends), size=2)]
            if np.abs(start - goal).max() * self.ros_map.resolution >= MIN_METRES:
                return start[None], goal[None]

    def path(self, start: Ints, goal: Ints, terrain: Bytes) -> Ints:
        """Return the cheapest path, (k, 2), between two cells, (1, 2) each."""
        found = search_batch("astar", self.grid[None], start, goal, MOVEMENT, terrain=terrain[None])
        return found.cells


def named_map(name: str) -> RosMap:
    """Return a map of `NAMED_MAPS` at the resolution of a robot's map, with a wall around it."""
    preset, index, metres = NAMED_MAPS[name]
    grid = generate(preset, seed=NAMED_MAPS_SEED, indices=[index]).occupancy[0]
    factor = round(metres / RESOLUTION)
    fine = np.kron(grid, np.ones((factor, factor), np.uint8))
    return RosMap(100 * np.pad(fine, 1, constant_values=1).astype(np.int8), RESOLUTION, (0, 0, 0))


def _patches(shape: tuple[int, ...]) -> npt.NDArray[np.bool_]:
    """Return which cells are carpet: a third of them, in squares of 20 cells."""
    rng = np.random.default_rng(7)
    squares = rng.random((shape[0] // 20 + 1, shape[1] // 20 + 1)) < 1 / 3
    return np.kron(squares, np.ones((20, 20), bool))[: shape[0], : shape[1]]


# --- drivers ------------------------------------------------------------------------------------


def clean_drive(place: Place, rng: np.random.Generator) -> Floats:
    """Return the poses of a cheapest path under the hidden costs, (k, 2) metres."""
    return place.ros_map.to_metres(cells=place.path(*place.draw_ends(rng), place.terrain))


def sloppy_drive(place: Place, rng: np.random.Generator) -> Floats:
    """Return a drive of one who misjudges each cell: its hidden cost times exp(.5 * normal)."""
    noise = np.exp(0.5 * rng.standard_normal(place.costs.shape))
    terrain = terrain_from_costs((place.costs * noise)[None], place.grid[None])[0]
    return place.ros_map.to_metres(cells=place.path(*place.draw_ends(rng), terrain))


def right_drive(place: Place, rng: np.random.Generator) -> Floats:
    """Return a drive of one who keeps .3 m right of the cheapest path, where there is room."""
    cells = place.path(*place.draw_ends(rng), place.terrain)
    return _beside(place, cells, np.full(len(cells), 0.3))


def drift_drive(place: Place, rng: np.random.Generator) -> Floats:
    """Return a drive of one who drifts to both sides of the cheapest path, where there is room.

    The distance from it has a deviation of .15 m, and is forgotten within 2 m.
    """
    cells = place.path(*place.draw_ends(rng), place.terrain)
    kept = math.exp(-place.ros_map.resolution / 2)
    metres = [0.0]
    for push in rng.standard_normal(len(cells) - 1).tolist():
        metres.append(kept * metres[-1] + 0.15 * math.sqrt(1 - kept**2) * push)
    return _beside(place, cells, np.array(metres))


def _beside(place: Place, cells: Ints, metres: Floats) -> Floats:
    """Return the poses of a path (k, 2), each moved right by metres (k,) where there is room."""
    ahead = np.asarray(np.gradient(_smoothed((cells + 0.5).astype(np.float64)), axis=0))
    length = np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    # Rows grow downwards, so right of (down, right) is (right, -down).
    rightwards = np.stack([ahead[:, 1], -ahead[:, 0]], axis=1) / length
    cells_aside = metres[:, None] / place.ros_map.resolution
    moved = np.rint(cells + rightwards * cells_aside).astype(np.int64)
    moved = np.clip(moved, 0, np.array(place.grid.shape) - 1)
    has_room = place.grid[tuple(moved.T)] == 0
    return place.ros_map.to_metres(cells=np.where(has_room[:, None], moved, cells))


def lag_drive(place: Place, rng: np.random.Generator) -> Floats:
    """Return a drive of one who follows the cheapest path late.

    Each pose is pulled towards the next cell of the path, and .4 m of the path pass until it is
    nearer by a factor of e. So the drive cuts corners, and ends before the goal.
    """
    poses = place.ros_map.to_metres(cells=place.path(*place.draw_ends(rng), place.terrain))
    followed = [poses[0]]
    for pose in poses[1:]:
        followed.append(followed[-1] + (pose - followed[-1]) * place.ros_map.resolution / 0.4)
    return np.stack(followed)


def smooth_drive(place: Place, rng: np.random.Generator) -> Floats:
    """Return a continuous, smooth line along a cheapest path."""
    cells = place.path(*place.draw_ends(rng), place.terrain)
    return place.ros_map.to_metres(points=_smoothed((cells + 0.5).astype(np.float64)))


def _smoothed(points: Floats) -> Floats:
    """Return points (k, 2), each the mean of those up to 4 before and after it."""
    sums = np.cumsum(np.concatenate([np.zeros((1, 2)), points]), axis=0)
    numbers = np.arange(len(points))
    first, last = np.maximum(numbers - 4, 0), np.minimum(numbers + 5, len(points))
    means: Floats = (sums[last] - sums[first]) / (last - first)[:, None]
    return means


Driver = tuple[Hidden, Callable[[Place, np.random.Generator], Floats], bool]

DRIVERS: dict[str, Driver] = {
    "keeps .6 m from walls": (lane, clean_drive, False),
    "an inflation layer": (wide, clean_drive, False),
    "keeps .6 m, sloppy": (lane, sloppy_drive, False),
    "an inflation layer, sloppy": (wide, sloppy_drive, False),
    "keeps right": (wide, right_drive, False),
    "avoids carpet": (wide, clean_drive, True),
    "smooth lines": (lane, smooth_drive, False),
    "lag": (lane, lag_drive, False),
    "drift": (lane, drift_drive, False),
}
"""Drivers: hidden costs of clearance, how they drive, and whether they mind carpet."""

NAV2_DRIVERS = (
    "keeps .6 m from walls",
    "an inflation layer",
    "keeps .6 m, sloppy",
    "keeps right",
    "avoids carpet",
    "smooth lines",
)
"""Drivers on the maps of Nav2."""

WITH_REGRET = ("keeps .6 m from walls", "an inflation layer", "keeps .6 m, sloppy", "avoids carpet")
"""Drivers whose hidden costs are costs of cells."""


def table_of_drives(drives: list[Floats]) -> pd.DataFrame:
    """Return drives as `fit_costmap` takes them."""
    parts = [
        pd.DataFrame({"x": poses[:, 0], "y": poses[:, 1], "drive": number})
        for number, poses in enumerate(drives)
    ]
    return pd.concat(parts, ignore_index=True)


# --- measuring ----------------------------------------------------------------------------------


def mean_regrets(place: Place, methods: dict[str, Float32s], seed: int) -> dict[str, float]:
    """Return how much dearer the paths of each method's costs (H, W) are than the cheapest ones.

    It is the mean over `TEST_PROBLEMS`, in percent, under the hidden costs.
    """
    rng = np.random.default_rng(1000 + seed)
    ends = [place.draw_ends(rng) for _ in range(TEST_PROBLEMS)]

    def costs_of(terrain: Bytes) -> Floats:
        paths = [place.path(*pair, terrain) for pair in ends]
        return np.array(
            [check_path(place.grid, path, MOVEMENT, terrain=place.terrain) for path in paths]
        )

    cheapest = costs_of(place.terrain)
    regrets = {}
    for name, costs in methods.items():
        terrain = terrain_from_costs(np.where(place.grid, 1, costs)[None], place.grid[None])[0]
        regrets[name] = 100 * float((costs_of(terrain) / cheapest - 1).mean())
    return regrets


def curve_error(costmap: Costmap, hidden: Hidden) -> float:
    """Return the largest relative error of the curve where at least 50 cells were driven, in %.

    The curve is scaled by the best single factor.
    """
    assert costmap.curve is not None
    known = costmap.curve[costmap.curve["driven"] >= 50]
    ratio = known["cost"].to_numpy() / hidden(known["clearance"].to_numpy())
    # With this factor the largest error upwards equals the largest one downwards.
    factor = 2 / (ratio.max() + ratio.min())
    return 100 * float(np.abs(ratio * factor - 1).max())


def measure_driver(
    maps: dict[str, RosMap], name: str, count: int, seed: int, has_regret: bool
) -> dict[str, Any]:
    """Return a row: a driver on the first map, a number of drives and a seed; the regret on all."""
    hidden, drive, minds_carpet = DRIVERS[name]
    place = Place(next(iter(maps.values())), hidden, minds_carpet)
    rng = np.random.default_rng(seed)
    drives = table_of_drives([drive(place, rng) for _ in range(count)])
    began = time.process_time()
    costmap = fit_costmap(place.ros_map, drives, robot_radius=ROBOT_RADIUS, seed=seed)
    row: dict[str, Any] = {
        "driver": name,
        "drives": count,
        "seed": seed,
        "seconds": time.process_time() - began,
        "comparison": costmap.comparison.set_index("costs").to_dict("index"),
        "inflation": costmap.inflation,
        "misjudgement": costmap.misjudgement,
    }
    if drive is not right_drive and not minds_carpet:
        row["curve_error"] = curve_error(costmap, hidden)
    if has_regret:
        row["regret"] = {}
        for test_name, ros_map in maps.items():
            test = Place(ros_map, hidden, minds_carpet)
            site = site_of(ros_map, ROBOT_RADIUS)
            methods = {
                "learnt costs": costmap.predict(site),
                "inflation layer": inflation_costs(site, ROBOT_RADIUS, *costmap.inflation),
                "shortest path": np.ones(test.grid.shape, np.float32),
            }
            row["regret"][test_name] = mean_regrets(test, methods, seed)
    return row


def measure_track(tracks: Path, name: str) -> dict[str, Any]:
    """Return a row: the race line of a track, in drives of a tenth of a lap."""
    ros_map = read_map(tracks / name / f"{name}_map.yaml")
    table = pd.read_csv(tracks / name / f"{name}_raceline.csv", sep=";", comment="#", header=None)
    poses = table[[1, 2]].to_numpy(np.float64)
    drives = table_of_drives(np.array_split(poses, 10))
    costmap = fit_costmap(ros_map, drives, robot_radius=ROBOT_RADIUS)
    return {
        "track": name,
        "comparison": costmap.comparison.set_index("costs").to_dict("index"),
        "dropped": costmap.dropped,
    }


# --- the page -----------------------------------------------------------------------------------

METHODS = ("learnt costs", "inflation layer", "shortest path")


def driver_table(rows: list[dict[str, Any]]) -> str:
    """Return the regrets of each driver that has them.

    A cell has the mean over seeds and maps, with its 95 % interval over five seeds or more, and the
    mean over seeds of the worst map.
    """
    lines = [["driver", "drives", *METHODS, "misjudges by", "largest error of the curve"]]
    for (name, count), group in _groups([row for row in rows if "regret" in row]):
        cells = []
        for method in METHODS:
            regrets = np.array([[of[method] for of in row["regret"].values()] for row in group])
            worst = regrets.mean(axis=0).max()  # of the map whose mean over seeds is largest
            cells.append(f"{_with_interval(regrets.mean(axis=1))}; {worst:.2f}")
        factor = np.mean([row["misjudgement"] for row in group])
        errors = [row["curve_error"] for row in group if "curve_error" in row]
        error = f"{np.mean(errors):.0f} %" if errors else "-"
        lines.append([name, str(count), *cells, f"{factor:.2f}", error])
    return markdown(lines)


def _with_interval(of_seeds: Floats) -> str:
    """Return a mean, with the interval of Student's t from five seeds on."""
    text = f"{of_seeds.mean():.2f}"
    if len(of_seeds) < 5:
        return text
    half = STUDENT * of_seeds.std(ddof=1) / math.sqrt(len(of_seeds))
    return f"{text} [{max(of_seeds.mean() - half, 0):.2f}, {of_seeds.mean() + half:.2f}]"


def distance_table(rows: list[dict[str, Any]], tracks: list[dict[str, Any]]) -> str:
    """Return how far held-back drives are from the planned paths."""
    lines = [["driver", "drives", *METHODS]]
    groups = [(name, str(count), group) for (name, count), group in _groups(rows)]
    groups += [("race lines of five tracks", "10 parts of a lap", tracks)] if tracks else []
    for name, count, group in groups:
        cells = []
        for method in METHODS:
            distance = np.mean([row["comparison"][method]["distance"] for row in group])
            within = np.mean([row["comparison"][method]["within"] for row in group])
            cells.append(f"{distance:.2f} cells, {100 * within:.0f} %")
        lines.append([name, count, *cells])
    return markdown(lines)


def _groups(
    rows: list[dict[str, Any]],
) -> list[tuple[tuple[str, int], list[dict[str, Any]]]]:
    """Return the rows of each driver and number of drives."""
    keys = dict.fromkeys((row["driver"], row["drives"]) for row in rows)
    return [(key, [row for row in rows if (row["driver"], row["drives"]) == key]) for key in keys]


def write_page(results: dict[str, list[dict[str, Any]]]) -> None:
    """Write the tables of docs/howto/costmap.md anew."""
    tables = {
        "named": driver_table(results["named"]),
        "regret": driver_table(results["drivers"]),
        "distance": distance_table(results["drivers"], results["tracks"]),
    }
    text = filled(PAGE.read_text(encoding="utf-8"), tables)
    write_output(PAGE, text.encode())


def main(arguments: list[str] | None = None) -> None:
    """Measure all rows, and write them and the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--named", action="store_true", help="measure on the generated maps")
    parser.add_argument("--nav2", type=Path, metavar="NAV2", help="measure on maps of this clone")
    parser.add_argument("--tracks", type=Path, metavar="TRACKS", help="measure race lines")
    parser.add_argument("--results", type=Path, default=RESULTS, help="the file of results")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    parts: dict[str, Iterator[dict[str, Any]]] = {}
    if options.named:
        maps = {name: named_map(name) for name in NAMED_MAPS}
        parts["named"] = (
            measure_driver(maps, name, count, seed, has_regret=True)
            for name, count in NAMED_ROWS
            for seed in NAMED_SEEDS
        )
    if options.nav2 is not None:
        of_nav2 = {name: read_map(options.nav2 / path) for name, path in TEST_MAPS.items()}
        parts["drivers"] = (
            measure_driver(of_nav2, name, count, seed, name in WITH_REGRET)
            for name in NAV2_DRIVERS
            for count in DRIVES
            for seed in SEEDS
        )
    if options.tracks is not None:
        parts["tracks"] = (measure_track(options.tracks, name) for name in TRACKS)
    for part, rows in parts.items():
        measured = []
        for row in rows:
            print(json.dumps(row), flush=True)
            measured.append(row)
        results = json.loads(options.results.read_text(encoding="utf-8"))
        results[part] = measured
        write_output(options.results, (json.dumps(results, indent=1) + "\n").encode())
    write_page(json.loads(options.results.read_text(encoding="utf-8")))


if __name__ == "__main__":
    main()
