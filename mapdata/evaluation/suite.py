"""Frozen suites of problems: maps of families that networks may be trained on, and of others.

A suite never changes. Its parts are drawn from a generator and a seed, and checked by their hashes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

import numpy as np
import pandas as pd

from mapdata.checks import check_choice
from mapdata.evaluation.guided import CostPlanner, GuidedSearch
from mapdata.evaluation.held_out import SHAPES, HeldOut
from mapdata.evaluation.metrics import METRICS, evaluate, with_interval
from mapdata.evaluation.plan import Planner
from mapdata.evaluation.planners import (
    BestFirst,
    GoalFieldAstar,
    JumpPointSearch,
    LandmarkAstar,
    Limit,
    Search,
    VanillaAstar,
    classical,
)
from mapdata.generators.generator import PRESETS, MapGenerator
from mapdata.movement import Movement
from mapdata.problems.problem_set import ProblemSet
from mapdata.problems.sources import Random

SUITE_MOVEMENT = Movement(8)
"""The rule of moves of all suites: 8 moves, no cut corners, diagonal moves of sqrt 2."""

_PROBLEMS = 200
"""Number of problems of a part, each on a map of its own."""

_HARD_PROBLEMS = Random(hardness=(1.05, None), distance=(10, None))
"""The straight way is blocked."""

_LONG_PROBLEMS = Random(length=(25, None))
"""On terrain, where hardness says nothing."""

NO_NETWORK = "guided search, no network"
"""The row that the differences of a suite are from."""

FIRST_ROWS = (
    "A*",
    "weighted A* (1.25)",
    "weighted A* (2)",
    "A* with 8 landmarks",
    NO_NETWORK,
    "limit",
    "A* on mean cost",
)
"""The classical planners that are compared with, as far as they take the maps."""

COUNTED = (
    Search,
    BestFirst,
    JumpPointSearch,
    LandmarkAstar,
    GoalFieldAstar,
    Limit,
    VanillaAstar,
    GuidedSearch,
    CostPlanner,
)
"""The planners whose expansions mapdata counts itself. Those of any other class are its own word,
and a class that inherits from one of these may count otherwise.
"""

_OF_COUNTS = ("expansion_ratio", "p_exp", "hmean")
"""The metrics that need the number of expansions."""

PART_COLUMNS = ("success", "opt", "cost_ratio", "expansion_ratio", "ms")
SUMMARY_COLUMNS = ("opt", "opt_difference", "expansion_ratio", "expansion_ratio_difference")
"""The columns that are printed, of a part and of the mean of several."""

Group = Literal["in", "out", "terrain"]


@dataclass(frozen=True)
class Part:
    """The problems of a suite on maps of one family and size.

    Attributes:
        name: the family and the side of its maps, such as "cave-64".
        group: "in" for families that networks may be trained on, "out" for those that no network
            may be trained or tuned on, "terrain" for maps whose free cells have costs.
        generator: draws the maps.
        problems: draws start and goal.
        seed: of maps and problems.
        content_hash: that of the problems, `ProblemSet.content_hash`.
    """

    name: str
    group: Group
    generator: MapGenerator
    problems: Random
    seed: int
    content_hash: str

    def problem_set(self) -> ProblemSet:
        """Draw the problems, which takes a second or less.

        Raises:
            ValueError: they are others than the frozen ones.
        """
        drawn = ProblemSet.sample(
            self.generator, self.seed, _PROBLEMS, movement=SUITE_MOVEMENT, problems=self.problems
        )
        if drawn.content_hash != self.content_hash:
            raise ValueError(
                f"{self.name}: got problems with the hash {drawn.content_hash}, expected "
                f"{self.content_hash}; figures on other problems cannot be compared, so take the "
                "version of mapdata that others used, and please report it"
            )
        return drawn


def _carry_over_1() -> tuple[Part, ...]:
    """Return the parts of "carry-over-1"."""
    hashes = {
        "dungeon-64": "80e34bfc2b1c66c0e4b29fe3490d724c1508f7cd9f2da23ec4608f4d298f5f80",
        "dungeon-128": "c99f7e5002845e09213776921c7a81986b8fa432eea526fad37fc89249ec418a",
        "maze-64": "97b2300be687ec04dc8147eaf505c695c5f2d23bdfce4e84d5794f8d1dc625ae",
        "maze-128": "f988d7e1edf262fcebdeb217ee5f72b3ac6dd59281599ade1927b0d79d84c24a",
        "cave-64": "3d6004e14fb5c0ede2bd3f1cabdbfc4a3d4c5c4929ae452ec3cebbb2ebea5d5a",
        "cave-128": "35f96296a3c94e43da7761f297bb347f94596eb6fe3156d33a42ad385c3430de",
        "forest-64": "3627e87e60c7c19d9b0fffa3331edb81cc26a1791b7c283fabf42e017237cd32",
        "forest-128": "20d0c20558cfcaf38017704a4c84bad9a1aa9058bd3f6b10cb862a6ae2321698",
        "noise-64": "a2b979487bf8f23af7f76a4695ffff6f5a04d1cf6937ff28c3bc29ac91f48984",
        "noise-128": "e69c6cc2e6ca4e305a1d83364bdae2658d7acf6a26476854d5463095fd2ba14a",
        "shelves-64": "104e9ae304d244c01be81530088426e46ca336f023945c36513f6872335ae732",
        "shelves-128": "acfe8cc182362ea1cc5532221827ad97e9a808cee453aee957d025ff05dee2f7",
        "bars-64": "6b238df1326188e12ecad95d09c3126d472e87f61c17cab1de53473d551bd9d2",
        "bars-128": "25104e8d9e8cb5a54cb5625fee57a398ed9fc8215e69243d9be140e6af54fa48",
        "traps-64": "1b2d21355a4fe795208cbfa963c47446d409728ea989ffd8d44f5734642f060d",
        "traps-128": "3c1504e26d01ff2f72db9cc7fa58f0644631b55d3988a14b2ee43677d5fa7aad",
        "floors-64": "ce57e45104042fda3a9aece3ae4f7343a312e30d7e055801d906b3e4ffd9f6a0",
        "floors-128": "f7d512f0f226b15b7bd701f3122907d344d0a3b23fb11007b506a6c0d68aa3f5",
        "rings-64": "7a8d77c059f6e6eceacfc7eb9af280e53e2f190bfcbac1f6159e15c0dbaf88de",
        "rings-128": "b710298478804460a48e2c93656cdc78026d0ba6ccfb37b43a93197e279766da",
        "terrain-64": "eb9d209ffef2abcb1694239f192427e344a2e8796b814464cf5a4b260104afbf",
        "terrain-128": "95940e60e20af5fcbe69dbb395a55eba1931433f0681064b0e66a9307ddce5cd",
    }
    families: list[tuple[str, Group, MapGenerator, MapGenerator]] = [
        ("dungeon", "in", PRESETS["dungeon"], PRESETS["dungeon128"])
    ]
    for preset in ("maze", "cave", "forest", "noise"):
        families.append((preset, "in", PRESETS[preset], _larger(PRESETS[preset])))
    for shape in SHAPES:
        held_out = HeldOut(shape=shape)
        families.append((shape, "out", held_out, _larger(held_out)))
    families.append(("terrain", "terrain", PRESETS["terrain"], _larger(PRESETS["terrain"])))
    parts = []
    for family, group, *generators in families:
        for generator in generators:
            name = f"{family}-{generator.map_size[0]}"
            problems = _LONG_PROBLEMS if group == "terrain" else _HARD_PROBLEMS
            seed = _seed_of("carry-over-1", name)
            parts.append(Part(name, group, generator, problems, seed, hashes[name]))
    return tuple(parts)


def _larger(generator: MapGenerator) -> MapGenerator:
    """Return the generator of maps of 128 x 128 cells."""
    return replace(generator, map_size=(128, 128))


def _seed_of(suite: str, part: str) -> int:
    """Return the seed of a part. It follows from the names, so that nobody chose it."""
    digest = hashlib.sha256(f"{suite} {part}".encode()).digest()
    return int.from_bytes(digest[:8], "big")


SUITES: Mapping[str, tuple[Part, ...]] = MappingProxyType({"carry-over-1": _carry_over_1()})
"""The parts of each suite, by its name."""


def evaluate_suite(
    planners: Sequence[Planner],
    name: str = "carry-over-1",
    *,
    parts: Sequence[str] | None = None,
    full: bool = False,
    bootstrap: int = 1000,
    seed: int = 0,
    progress: bool = False,
) -> pd.DataFrame:
    """Return the table of planners on the parts of a suite, beside the classical planners.

    A row is a planner on a part. Its columns are ``part``, ``group`` ("in", "out" or "terrain"),
    ``side`` (rows, and columns, of the maps), ``content_hash`` of the problems, and those of
    `evaluate` for all problems of the part, with the differences from "guided search, no network".

    Expansions are counted by the searches of mapdata alone: a network gives scores of moves to
    `GuidedSearch` or costs of cells to `CostPlanner`. A planner of another class reports its own
    number of expansions, which cannot be checked. So its columns of expansions, prepared cells and
    looks are NaN, and its row has success, optimal paths, costs and times.

    Args:
        planners: those to compare, for `SUITE_MOVEMENT`; none gives the classical rows alone.
        name: of the suite, one of `SUITES`.
        parts: names of its parts; all by default.
        full: compare with all planners of `classical` instead of a few.
        bootstrap: number of resamples of the intervals.
        seed: of the resamples.
        progress: show a progress bar for each part.

    Raises:
        TypeError, ValueError: no such suite or part; a part whose problems are others than the
            frozen ones; what `evaluate` refuses.
        Exception: whatever a planner raises.
    """
    check_choice("name", name, SUITES)
    of_suite = {part.name: part for part in SUITES[name]}
    for part_name in parts or ():
        check_choice("parts", part_name, of_suite)
    tables = []
    for part in [of_suite[part_name] for part_name in parts or of_suite]:
        problems = part.problem_set()
        others = [
            planner
            for planner in classical(SUITE_MOVEMENT, terrain=problems.has_terrain)
            if full or planner.name in FIRST_ROWS
        ]
        rows = [*planners, *others]
        table = evaluate(
            rows,
            problems,
            difference_from=NO_NETWORK,
            bootstrap=bootstrap,
            seed=seed,
            progress=progress,
        )
        table = table[table["subset"] == "all"].drop(columns="subset")
        table = without_unchecked_counts(table, rows)
        table.insert(0, "part", part.name)
        table.insert(1, "group", part.group)
        table.insert(2, "side", problems.map_size[0])
        table.insert(3, "content_hash", part.content_hash)
        tables.append(table)
    return pd.concat(tables, ignore_index=True)


def without_unchecked_counts(table: pd.DataFrame, planners: Sequence[Planner]) -> pd.DataFrame:
    """Return a table of `evaluate` without the counts that only a planner itself vouches for.

    They are NaN in the rows of planners whose class is none of `COUNTED`.

    Args:
        table: what `evaluate` returns.
        planners: those of its rows.
    """
    unchecked = [planner.name for planner in planners if type(planner) not in COUNTED]
    columns = [
        column
        for column in table.columns
        if column.startswith(_OF_COUNTS) or column in ("prepared_ratio", "look_ratio")
    ]
    checked = table.copy()
    checked[columns] = checked[columns].astype(float)
    checked.loc[checked["planner"].isin(unchecked), columns] = np.nan
    return checked


def suite_summary(table: pd.DataFrame) -> pd.DataFrame:
    """Return the means over the families of each group and size, from a table of `evaluate_suite`.

    A row is a planner on a group and size. Its columns are ``group``, ``side``, ``families`` (how
    many the mean is over), ``planner``, the metrics of `evaluate`, their differences from "guided
    search, no network", and the ends of their 95 % intervals.

    The parts are independent, so an end of an interval is as far from the mean of K families as the
    root of the sum of the squared distances in the parts, divided by K (MOVER: Zou and Donner,
    Statistics in Medicine 27, 2008).
    """
    metrics = [*METRICS, *(f"{metric}_difference" for metric in METRICS)]
    rows = []
    for (group, side, planner), of_group in table.groupby(["group", "side", "planner"], sort=False):
        row = {"group": group, "side": side, "families": len(of_group), "planner": planner}
        for metric in metrics:
            values = of_group[metric]
            mean = values.mean(skipna=False)
            below = np.sqrt(((values - of_group[f"{metric}_low"]) ** 2).sum()) / len(values)
            above = np.sqrt(((of_group[f"{metric}_high"] - values) ** 2).sum()) / len(values)
            row[metric] = mean
            row[f"{metric}_low"] = mean - below
            row[f"{metric}_high"] = mean + above
        rows.append(row)
    return pd.DataFrame(rows)


def suite_to_text(table: pd.DataFrame) -> str:
    """Return a table of `evaluate_suite` as text: a block for each part, and then the summary.

    Each figure is followed by half the width of its interval, and is "-" where it is not known.
    """
    blocks = []
    for part, rows in table.groupby("part", sort=False):
        first = rows.iloc[0]
        heading = f"{part} ({first['group']}): {first['n']} problems, set {first.content_hash[:12]}"
        blocks.append(f"{heading}\n{_text_of(rows, PART_COLUMNS)}")
    for (group, side), rows in suite_summary(table).groupby(["group", "side"], sort=False):
        count = rows["families"].iloc[0]
        families = f"mean of {count} families" if count > 1 else "one family"
        heading = f"{group}, {side} x {side} cells: {families}"
        heading += f"; differences from {NO_NETWORK!r}"
        blocks.append(f"{heading}\n{_text_of(rows, SUMMARY_COLUMNS)}")
    return "\n\n".join(blocks)


def _text_of(rows: pd.DataFrame, columns: Sequence[str]) -> str:
    """Return some columns of rows as text, each with half the width of its interval."""
    text = pd.DataFrame({"planner": rows["planner"]})
    for column in columns:
        text[column] = with_interval(rows, column)
    return text.to_string(index=False)
