"""The frozen suites: their problems never change, and the families held out are what they say."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
import pytest
from helpers.examples import slow
from scipy import ndimage

from mapdata import PRESETS, Plan, astar, evaluate
from mapdata.arrays import Bytes
from mapdata.evaluation import (
    SUITE_MOVEMENT,
    SUITES,
    TIMES,
    CostPlanner,
    GuidedSearch,
    Part,
    Planner,
    classical,
    evaluate_suite,
    prior,
    suite_summary,
    suite_to_text,
)
from mapdata.evaluation.held_out import SHAPES, HeldOut
from mapdata.evaluation.metrics import METRICS
from mapdata.evaluation.suite import COUNTED, FIRST_ROWS, NO_NETWORK
from mapdata.generators import generate
from mapdata.limits import Cell

PARTS = {part.name: part for part in SUITES["carry-over-1"]}

FEW_PARTS = {"cave-64", "terrain-64", *(f"{shape}-64" for shape in SHAPES)}
"""Small maps of each family that only a suite has, one that others have, and terrain."""


def drawn(shape: str, side: int = 64, count: int = 20) -> Bytes:
    """Return maps of a shape, (count, side, side)."""
    return generate(HeldOut((side, side), shape=shape), 5, range(count)).occupancy


def components(grid: Bytes) -> Iterator[Bytes]:
    """Yield the cells of each connected obstacle of a grid, as masks."""
    labels, count = ndimage.label(grid, np.ones((3, 3)))
    for label in range(1, count + 1):
        yield labels == label


def test_a_suite_has_five_families_in_and_five_out_of_two_depths() -> None:
    """And terrain apart."""
    families = {
        group: {part.name.partition("-")[0] for part in PARTS.values() if part.group == group}
        for group in ("in", "out", "terrain")
    }
    assert families["in"] == {"dungeon", "maze", "cave", "forest", "noise"}
    assert families["out"] == set(SHAPES)
    assert families["terrain"] == {"terrain"}
    names = {f"{family}-{side}" for of in families.values() for family in of for side in (64, 128)}
    assert set(PARTS) == names


def test_no_preset_is_a_family_that_is_held_out() -> None:
    """What has no preset, no training takes unawares."""
    assert not any(isinstance(generator, HeldOut) for generator in PRESETS.values())


@pytest.mark.parametrize("name", [name if name in FEW_PARTS else slow(name) for name in PARTS])
def test_the_problems_of_a_part_are_the_frozen_ones(name: str) -> None:
    """Two hundred problems, each on a map of its own; off terrain all of them are hard."""
    part = PARTS[name]
    problems = part.problem_set()  # which compares the hash
    assert len(problems) == problems.map_count == 200
    assert problems.movement == SUITE_MOVEMENT
    assert problems.map_size == part.generator.map_size
    assert problems.has_terrain == (part.group == "terrain")
    if part.group == "terrain":
        assert np.diff(problems.optimal.offsets).min() >= 25
    else:
        assert problems.hard.all()


def test_the_seed_of_a_part_follows_from_its_name() -> None:
    """So that nobody chose it: the first 64 bits of the SHA-256 of suite and part."""
    for part in PARTS.values():
        digits = hashlib.sha256(f"carry-over-1 {part.name}".encode()).hexdigest()
        assert f"{part.seed:016x}" == digits[:16]


def test_other_problems_than_the_frozen_ones_are_refused() -> None:
    """The message says what was drawn and what was expected."""
    part: Part = replace(PARTS["cave-64"], seed=1)
    with pytest.raises(ValueError, match=f"cave-64: got problems .*, expected {part.content_hash}"):
        part.problem_set()


@pytest.mark.parametrize("shape", ["floors", "rings"])
def test_all_free_cells_of_floors_and_rings_are_connected(shape: str) -> None:
    """No wall ends at a door, and each ring has a gap."""
    for grid in [*drawn(shape), *drawn(shape, 128, 5)]:
        _, count = ndimage.label(grid == 0)
        assert count == 1


def test_shelves_are_boxes_of_one_depth() -> None:
    """No shelf is hollow."""
    for grid in drawn("shelves"):
        depths = set()
        for shelf in components(grid):
            rows, columns = np.nonzero(shelf)
            height, width = np.ptp(rows) + 1, np.ptp(columns) + 1
            assert shelf.sum() == height * width
            depths.add(height)
        assert len(depths) == 1


def test_bars_are_thin() -> None:
    """Where no two of them meet, a bar has one cell in each row, or one in each column."""
    thin = 0
    for grid in drawn("bars"):
        for bar in components(grid):
            rows, columns = np.nonzero(bar)
            thin += bar.sum() == max(np.ptp(rows), np.ptp(columns)) + 1
    assert thin > 20


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"shape": "bar"}, "shape: got 'bar', expected .*did you mean bars"),
        ({"map_size": (31, 64)}, r"map_size: got \(31, 64\), expected at least 32 x 32"),
    ],
)
def test_other_shapes_and_small_maps_are_refused(options: dict[str, object], message: str) -> None:
    """The message says what is known."""
    with pytest.raises(ValueError, match=message):
        HeldOut(**options)  # type: ignore[arg-type]


class OneExpansion:
    """A planner with a search of its own, which finds the path of A* and reports one expansion."""

    name = "says 1"

    def plan(self, grid: Bytes, start: Cell, goal: Cell) -> Plan:
        """Return a shortest path."""
        return Plan(astar(grid, start, goal, SUITE_MOVEMENT).path, 1)


@dataclass(frozen=True, eq=False)
class Inherits(CostPlanner):
    """A planner that may count as it likes: its class is not one of mapdata."""


def uniform_costs(grids: Bytes, *_: object) -> Bytes:
    """Return the same cost for all cells."""
    return np.ones_like(grids)


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    """Return the rows of four planners, and the classical ones, on a part."""
    own: list[Planner] = [
        OneExpansion(),
        GuidedSearch("by the prior", SUITE_MOVEMENT, partial(prior, movement=SUITE_MOVEMENT)),
        CostPlanner("by costs", SUITE_MOVEMENT, uniform_costs),
        Inherits("inherits", SUITE_MOVEMENT, uniform_costs),
    ]
    return evaluate_suite(own, parts=["bars-64"], bootstrap=50)


def row_of(table: pd.DataFrame, planner: str) -> dict[str, Any]:
    """Return the row of a planner, by the names of the columns."""
    (row,) = table[table["planner"] == planner].to_dict("records")
    return {str(name): value for name, value in row.items()}


def is_count(column: str) -> bool:
    """Return whether a column needs the number of expansions, or of other cells."""
    return column.startswith(("expansion", "p_exp", "hmean", "prepared", "look"))


@pytest.mark.parametrize("name", ["says 1", "inherits"])
def test_a_search_of_ones_own_has_no_counts(table: pd.DataFrame, name: str) -> None:
    """Its paths and times are measured; its number of expansions is only its own word."""
    row, of_astar = row_of(table, name), row_of(table, "A*")
    counts = [value for column, value in row.items() if is_count(column)]
    assert len(counts) == 2 + 3 * 6  # the metrics and their differences have intervals
    assert np.isnan(counts).all()
    checked = [f"{metric}{end}" for metric in METRICS[:3] for end in ("", "_low", "_high")]
    assert [row[column] for column in checked] == [of_astar[column] for column in checked]
    assert row["ms"] > 0


def test_a_network_that_hands_over_arrays_is_counted_by_mapdata(table: pd.DataFrame) -> None:
    """The prior is the row without a network, and equal costs are A*."""
    for own, same in (("by the prior", NO_NETWORK), ("by costs", "A*")):
        row, expected = row_of(table, own), row_of(table, same)
        figures = [
            name for name in row if not name.startswith((*TIMES, "planner", "prepared_ratio"))
        ]
        assert [row[name] for name in figures] == [expected[name] for name in figures]
        assert not np.isnan([row[name] for name in row if is_count(name)]).any()


def test_all_classical_planners_are_counted() -> None:
    """Otherwise their expansions would be missing."""
    for terrain in (False, True):
        assert {type(one) for one in classical(SUITE_MOVEMENT, terrain=terrain)} <= {*COUNTED}


def test_a_row_is_that_of_evaluate_on_the_problems_of_the_part(table: pd.DataFrame) -> None:
    """The suite adds where the problems are from, and takes one row for each planner."""
    part = PARTS["bars-64"]
    rows = [one for one in classical(SUITE_MOVEMENT) if one.name in ("A*", NO_NETWORK)]
    expected = evaluate(rows, part.problem_set(), bootstrap=50, difference_from=NO_NETWORK)
    expected = expected[expected["subset"] == "all"]
    names = [*METRICS, "opt_low", "expansion_ratio_high", "opt_difference", "n", "refused"]
    for planner in ("A*", NO_NETWORK):
        row, of_evaluate = row_of(table, planner), row_of(expected, planner)
        assert [row[name] for name in names] == [of_evaluate[name] for name in names]
        origin = [row[name] for name in ("part", "group", "side", "content_hash")]
        assert origin == ["bars-64", "out", 64, part.content_hash]


@pytest.mark.slow
def test_the_classical_rows_are_those_that_take_the_maps(table: pd.DataFrame) -> None:
    """On terrain there are no landmarks, and there is A* on mean cost."""
    rough = evaluate_suite([], parts=["terrain-64"], bootstrap=2)
    for rows, terrain in ((table[4:], False), (rough, True)):
        names = [planner.name for planner in classical(SUITE_MOVEMENT, terrain=terrain)]
        assert rows["planner"].tolist() == [name for name in names if name in FIRST_ROWS]


def test_the_summary_is_the_mean_of_the_families() -> None:
    """Half the width of its interval is the root of the summed squares, divided by the families:
    with K equal ones it falls with the root of K.
    """
    ends = {"": 0.0, "_low": -0.05, "_high": 0.1}
    names = [*METRICS, *(f"{metric}_difference" for metric in METRICS)]
    rows = []
    for part, value in (("a-64", 0.5), ("b-64", 0.6), ("c-64", 0.7), ("d-64", 0.8)):
        row: dict[str, object] = {"part": part, "group": "in", "side": 64, "planner": "mine"}
        row |= {f"{name}{end}": value + far for name in names for end, far in ends.items()}
        rows.append(row)
    (summary,) = suite_summary(pd.DataFrame(rows)).to_dict("records")
    assert summary["families"] == 4
    for name in names:
        got = [summary[f"{name}{end}"] for end in ends]
        assert got == pytest.approx([0.65, 0.65 - 0.05 / 2, 0.65 + 0.1 / 2])


def test_the_text_has_a_block_for_each_part_and_one_for_the_mean(table: pd.DataFrame) -> None:
    """It fits into a terminal of 100 letters, and shows no count that is not known."""
    text = suite_to_text(table)
    part, summary = text.split("\n\n")
    assert part.startswith(f"bars-64 (out): 200 problems, set {PARTS['bars-64'].content_hash[:12]}")
    assert summary.startswith("out, 64 x 64 cells: one family; differences from")
    assert max(map(len, text.splitlines())) <= 100
    (line,) = [line for line in part.splitlines() if "says 1" in line]
    assert line.split()[8] == "-"  # expansion_ratio


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": "carry-over"}, "name: got 'carry-over', expected .*carry-over-1"),
        ({"parts": ["bars-65"]}, "parts: got 'bars-65', expected .*did you mean bars-64"),
    ],
)
def test_an_unknown_suite_or_part_is_refused(arguments: dict[str, str], message: str) -> None:
    """Before anything is drawn."""
    with pytest.raises(ValueError, match=message):
        evaluate_suite([], **arguments)  # type: ignore[arg-type]
