"""The table of planners: metrics by hand, cheats found out, intervals, the classical rows near
their known values.
"""

from __future__ import annotations

import json
import math
import runpy
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
import torch
from helpers.examples import slow
from helpers.reference import Cell
from scipy import stats

from mapdata import MapSpec, Plan, ProblemSet, astar, build, check_path, evaluate, search_batch
from mapdata.evaluation import TIMES, Planner, classical, runs, score_paths, to_text
from mapdata.evaluation.metrics import METRICS, median_interval
from mapdata.evaluation.planners import BestFirst
from mapdata.models.evaluate import evaluate_planners
from mapdata.movement import Movement
from mapdata.plotting import plot_planners

DUNGEON = MapSpec.preset("dungeon")
Grid = npt.NDArray[np.uint8]
Cells = npt.NDArray[np.int64]


@dataclass
class Scripted:
    """A planner that answers the k-th problem of `three` with the k-th plan."""

    plans: Sequence[tuple[Sequence[tuple[float, float]], int]]
    name: str = "scripted"

    def plan(self, grid: Grid, start: Cell, goal: Cell) -> Plan:
        """Know a problem by its goal."""
        path, expansions = self.plans[GOALS.index(goal)]
        return Plan(np.array(path).reshape(-1, 2), expansions)


@dataclass
class Functional:
    """A planner that is a function."""

    function: Callable[[Grid, Cell, Cell], Plan]
    name: str = "functional"

    def plan(self, grid: Grid, start: Cell, goal: Cell) -> Plan:
        """Call it."""
        return self.function(grid, start, goal)


GOALS = [(0, 2), (0, 3), (3, 0)]
DETOUR = [(0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2)]
DOWN = [(0, 0), (1, 0), (2, 0), (3, 0)]


def three(movement: Movement = Movement()) -> ProblemSet:
    """Return three problems from (0, 0): around a wall (L* 4, E* 5, hard), along the top (6, 7),
    down (3, 4).
    """
    grids = np.zeros((3, 4, 4), np.uint8)
    grids[0, 0, 1] = 1
    grids[1, :3, 1] = 1
    starts = [(0, 0), (3, 1), (0, 0)]
    return ProblemSet(grids, np.array(starts), np.array(GOALS), movement)


def row(table: pd.DataFrame, planner: str, subset: str) -> dict[str, Any]:
    """Return one row of a table."""
    (found,) = table[(table["planner"] == planner) & (table["subset"] == subset)].to_dict("records")
    return {str(name): value for name, value in found.items()}


def test_the_metrics_by_hand() -> None:
    """One detour with twice the expansions, one optimal path with half of them, one failure after
    one cell.
    """
    problems = three()
    assert problems.optimal.cost.tolist() == [4, 5, 3]
    assert problems.optimal.iterations.tolist() == [5, 6, 4]
    best = [(3, 1), (3, 2), (2, 2), (2, 3), (1, 3), (0, 3)]
    planner = Scripted([(DETOUR, 10), (best, 3), ([(0, 0), (3, 0)], 1)])
    every, hard = (
        row(evaluate([planner], problems), "scripted", subset) for subset in ("all", "hard")
    )
    expected = {
        "n": 3,
        "success": 2 / 3,
        "opt": 1 / 3,
        "cost_ratio": (6 / 4 + 1) / 2,
        "expansion_ratio": (2 + 0.5 + 0.25) / 3,
        "p_exp": (0 + 0.5 + 0.75) / 3,
        "hmean": 2 / (3 + 3 / 1.25),
    }
    assert {name: every[name] for name in expected} == pytest.approx(expected, rel=1e-12)
    expected = {
        "n": 1,
        "success": 1,
        "opt": 0,
        "cost_ratio": 1.5,
        "expansion_ratio": 2,
        "p_exp": 0,
        "hmean": 0,
    }
    assert {name: hard[name] for name in expected} == expected


def test_prepared_cells_and_looks_are_shown_beside_expansions() -> None:
    """They are divided by A*'s expansions, and change no metric; without a number of its own a
    planner's looks are its expansions.
    """
    problems = three()
    prepared = {(0, 2): 10, (0, 3): 3, (3, 0): 0}
    looks = {(0, 2): 15, (0, 3): 9, (3, 0): None}
    working = Functional(
        lambda grid, start, goal: Plan(np.empty((0, 2), int), 2, prepared[goal], looks[goal]),
        "working",
    )
    plain = Functional(lambda grid, start, goal: Plan(np.empty((0, 2), int), 2), "plain")
    table = evaluate([working, plain], problems, bootstrap=5)
    counted = row(table, "working", "all")
    assert counted["prepared_ratio"] == pytest.approx((10 / 5 + 3 / 6) / 3, rel=1e-12)
    assert counted["look_ratio"] == pytest.approx((15 / 5 + 9 / 6 + 2 / 4) / 3, rel=1e-12)
    hard = row(table, "working", "hard")
    assert (hard["prepared_ratio"], hard["look_ratio"]) == (2, 3)
    uncounted = row(table, "plain", "all")
    assert uncounted["prepared_ratio"] == 0
    assert uncounted["look_ratio"] == uncounted["expansion_ratio"]
    for name in ("expansion_ratio", "p_exp", "hmean"):
        assert counted[name] == uncounted[name]
    halved = evaluate([working, plain], problems, baseline="plain", bootstrap=5)
    assert row(halved, "working", "hard")["prepared_ratio"] == 10 / 2
    assert "2.000      3.000" in to_text(table)


def test_another_planner_may_be_the_baseline() -> None:
    """Expansions are divided by those of the named planner, problem by problem."""
    problems = three()
    halves = Scripted([([], 5), ([], 6), ([], 8)], "halves")
    ones = Scripted([([], 5), ([], 3), ([], 16)], "ones")
    table = evaluate([halves, ones], problems, baseline="halves")
    assert row(table, "halves", "all")["expansion_ratio"] == 1
    row_of_planner = row(table, "ones", "all")
    assert row_of_planner["expansion_ratio"] == pytest.approx((1 + 0.5 + 2) / 3)
    assert row_of_planner["p_exp"] == pytest.approx(0.5 / 3)
    assert row_of_planner["hmean"] == 0
    with pytest.raises(ValueError, match="baseline: got 'half', expected one of halves, ones"):
        evaluate([halves, ones], problems, baseline="half")


CHEATS: dict[str, list[tuple[float, float]]] = {
    "through a wall": [(0, 0), (0, 1), (0, 2)],
    "a jump": [(0, 0), (0, 2)],
    "a cut corner": [(0, 0), (1, 1), (0, 2)],
    "from (0, 0) to (1, 2), expected from (0, 0) to (0, 2)": [(0, 0), (1, 0), (1, 1), (1, 2)],
    "from (1, 0) to (0, 2), expected": [(1, 0), (1, 1), (1, 2), (0, 2)],
    "from (0, 2) to (0, 0), expected": [(0, 2), (1, 2), (1, 1), (1, 0), (0, 0)],
    "leaves the map": [(0, 0), (-1, 0), (-1, 1), (-1, 2), (0, 2)],
    "between cells": [(0, 0), (1, 0), (1, 0.5), (1, 1), (1, 2), (0, 2)],
    "stands still": [(0, 0), (0, 0), (1, 0), (1, 1), (1, 2), (0, 2)],
    "nothing": [],
}


@pytest.mark.parametrize("cheat", CHEATS)
@pytest.mark.parametrize("movement", [Movement(), Movement(8)], ids=["4", "8"])
def test_invalid_paths_count_as_failures(cheat: str, movement: Movement) -> None:
    """They have success 0, are not optimal and have no cost, but their expansions count.

    A warning has the first path's fault.
    """
    path = CHEATS[cheat]
    problems = three(movement)
    one_problem = ProblemSet(problems.grids[:1], problems.starts[:1], problems.goals[:1], movement)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        table = evaluate([Scripted([(path, 1)])], one_problem, bootstrap=5)
    row_of_planner = row(table, "scripted", "all")
    (said,) = [str(warning.message) for warning in caught] if path else [""]
    start = "scripted: none of its paths solves its problem; the first is that of problem 0: "
    assert said.startswith(start if path else "")
    assert all(warning.filename == __file__ for warning in caught)
    if cheat.startswith("from"):
        assert cheat in said
    assert (
        row_of_planner["success"],
        row_of_planner["opt"],
        row_of_planner["expansion_ratio"],
    ) == (
        0,
        0,
        1 / one_problem.optimal.iterations[0],
    )
    assert np.isnan(row_of_planner["cost_ratio"])


@pytest.mark.filterwarnings("ignore:.*none of its paths solves its problem")
def test_a_path_of_another_rank_fails() -> None:
    """An array that is no list of cells is no path."""
    problems = three()
    for path in (np.array(3), np.zeros((1, 2, 2), np.int64), np.zeros(4, np.int64)):
        planner = Functional(lambda grid, start, goal, path=path: Plan(path, 1))  # type: ignore[misc]
        assert row(evaluate([planner], problems, bootstrap=5), "functional", "all")["success"] == 0


@pytest.mark.parametrize(
    "movement", [slow(Movement()), Movement(8), slow(Movement(8, corner_cutting=True))]
)
def test_the_row_of_astar_is_exact(movement: Movement) -> None:
    """A* is compared with itself, so its metrics and both ends of their intervals are 1, 1, 1, 1,
    0, 0.
    """
    table = evaluate(
        classical(movement), ProblemSet.sample(DUNGEON, 3, 80, movement=movement), bootstrap=20
    )
    for subset in ("all", "hard"):
        row_of_planner = row(table, "A*", subset)
        for suffix in ("", "_low", "_high"):
            assert [row_of_planner[name + suffix] for name in METRICS] == [1, 1, 1, 1, 0, 0]
        for planner in ("Dijkstra", "A* with the exact goal field", "limit"):
            assert row(table, planner, subset)["opt"] == 1
        if movement.connectivity == 8:
            assert row(table, "jump point search", subset)["opt"] == 1
        for planner, bound in (("weighted A* (1.5)", 1.5), ("weighted A* (2)", 2)):
            assert 1 <= row(table, planner, subset)["cost_ratio_high"] <= bound
    assert table["success"].eq(1).all()


def test_the_table_has_two_rows_for_each_planner() -> None:
    """Two rows a planner, planners in their order; without plan_batch there is no time in
    batches.
    """
    planners: list[Planner] = [*classical(Movement()), Scripted([(DETOUR, 1), ([], 1), ([], 1)])]
    table = evaluate(planners, three(), bootstrap=10)
    assert table["planner"].tolist() == [planner.name for planner in planners] * 2
    assert table["subset"].tolist() == ["all"] * len(planners) + ["hard"] * len(planners)
    columns = ["planner", "subset", "n", *METRICS]
    columns += ["refused", "first_refused", "prepared_ratio", "look_ratio", "ms", "ms_batched"]
    assert table.columns.tolist() == columns + [
        f"{name}_{end}" for name in (*METRICS, *TIMES) for end in ("low", "high")
    ]
    assert (table["ms"] > 0).all()
    assert table["ms_batched"].isna().tolist() == ([False] * (len(planners) - 1) + [True]) * 2
    text = to_text(table)
    assert "all: 3 problems" in text
    assert "hard: 1 problems, hardness at least 1.05" in text
    assert max(map(len, text.splitlines())) < 170
    assert "nan" not in text


def test_a_table_may_be_printed_with_few_columns() -> None:
    """The planner comes first; a column that does not exist is refused by its name."""
    table = evaluate(classical(Movement()), three(), bootstrap=5)
    heading = to_text(table, ["opt", "ms"]).splitlines()[1]
    assert heading.split() == ["planner", "opt", "ms"]
    with pytest.raises(ValueError, match=r"columns: got 'ops', expected one of .* mean opt\?"):
        to_text(table, ["ops"])


@pytest.mark.filterwarnings("ignore:.*none of its paths solves its problem")
def test_refused_paths_are_counted_and_the_first_has_its_reason() -> None:
    """Problems without a path do not count, and each subset has its own first one."""
    planner = Scripted([([], 1), ([(3, 1), (3, 3)], 1), ([(0, 0), (1, 0)], 1)])
    table = evaluate([planner], three(), bootstrap=5)
    every, hard = (row(table, "scripted", subset) for subset in ("all", "hard"))
    reason = "problem 1: move 0, from (3, 1) to (3, 3), leads to no neighbour"
    assert (every["refused"], every["first_refused"]) == (2, reason)
    assert (hard["refused"], hard["first_refused"]) == (0, "")


def test_only_planners_without_any_path_are_warned_of(recwarn: pytest.WarningsRecorder) -> None:
    """Some failures are what a table is for."""
    evaluate([Scripted([([(0, 0), (0, 2)], 1), ([], 1), (DOWN, 1)])], three(), bootstrap=5)
    assert not recwarn.list


@dataclass
class Batched(Scripted):
    """A planner that answers batches with plans of their own."""

    batch: Sequence[tuple[Sequence[tuple[float, float]], int]] = ()

    def plan_batch(self, grids: Grid, starts: Cells, goals: Cells) -> list[Plan]:
        """Return the plans in their order."""
        return [Plan(np.array(path).reshape(-1, 2), number) for path, number in self.batch]


def test_other_paths_of_plan_batch_are_warned_of() -> None:
    """The table shows those of `plan` only, beside the time of `plan_batch`."""
    plans: list[tuple[Sequence[tuple[float, float]], int]] = [(DETOUR, 5), ([], 1), (DOWN, 4)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        evaluate([Batched(plans, "same", batch=plans)], three(), bootstrap=5)
    with pytest.warns(UserWarning, match="turned: 2 of 3 paths of plan_batch cost") as said:
        evaluate([Batched(plans, "turned", batch=plans[::-1])], three(), bootstrap=5)
    assert said[0].filename == __file__
    with pytest.raises(TypeError, match="turned: plan returned str"):
        evaluate([Functional(lambda *_: "path", "turned")], three())  # type: ignore[arg-type]


COUNTS = {
    -1: "got -1, expected a number of cells, 0 or more",
    math.nan: "got nan, expected a number of cells, 0 or more",
    math.inf: "got inf, expected a number of cells, 0 or more",
    "5": "got '5', expected a number",
    3j: "got 3j, expected a number",
    True: "got True, expected a number",
}


@pytest.mark.parametrize("field", ["expansions", "prepared", "looks"])
@pytest.mark.parametrize("count", COUNTS)
def test_impossible_numbers_of_cells_are_refused(field: str, count: object) -> None:
    """They would make ratios that no planner can have."""
    numbers: dict[str, Any] = {"expansions": 4, field: count}
    plan = Plan(np.array(DOWN), **numbers)
    with pytest.raises(ValueError, match=f"^functional: {field}: {COUNTS[count]}"):
        evaluate([Functional(lambda *_: plan)], three())


@pytest.mark.parametrize(
    ("count", "found"),
    [
        (None, "None"),
        ([4], r"\[4\]"),
        (np.array([4, 5]), r"an array of shape \(2,\)"),
        (torch.tensor([4]), r"an array of shape \(1,\)"),
    ],
    ids=["None", "list", "array", "tensor"],
)
def test_expansions_that_are_no_number_are_refused(count: Any, found: str) -> None:
    """The message says what was found instead."""
    with pytest.raises(ValueError, match=f"functional: expansions: got {found}, expected a number"):
        evaluate([Functional(lambda *_: Plan(np.array(DOWN), count))], three())


@pytest.mark.parametrize("count", [np.int32(4), np.array(4), torch.tensor(4), 4.0])
def test_expansions_may_be_numbers_of_other_libraries(count: Any) -> None:
    """A search may count in an array or a tensor."""
    planner = Functional(lambda *_: Plan(np.array(DOWN), count))
    table = evaluate([planner], three()[[2]], bootstrap=5)
    assert row(table, "functional", "all")["expansion_ratio"] == 1


def no_path(*problem: object) -> Plan:
    """Return that there is no path."""
    return Plan(np.empty((0, 2), int), 1)


BATCH_ANSWERS: dict[str, Callable[..., Any]] = {
    "generator": lambda *problems: (plan for plan in [no_path()]),
    "NoneType": lambda *problems: None,
    "ndarray": lambda *problems: np.zeros(3),
    "dict": lambda *problems: {0: 1, 1: 2, 2: 3},
    "str": lambda *problems: "abc",
    "Plan": lambda *problems: Plan(np.array(DOWN), 4),
    "BatchResult": lambda *problems: search_batch("astar", *problems),
}


@pytest.mark.parametrize("kind", BATCH_ANSWERS)
def test_a_plan_batch_that_returns_no_list_is_refused(kind: str) -> None:
    """The message names the type, also of a tuple that is not one of plans."""
    planner: Any = Scripted([(DETOUR, 1), ([], 1), ([], 1)], "own")
    planner.plan_batch = BATCH_ANSWERS[kind]
    with pytest.raises(TypeError, match=f"own: plan_batch returned {kind}, expected a list of "):
        evaluate([planner], three())


def test_a_list_of_plan_batch_holds_plans() -> None:
    """The message says which method is meant."""
    planner: Any = Scripted([(DETOUR, 1), ([], 1), ([], 1)], "own")
    planner.plan_batch = lambda *problems: [None, None, None]
    with pytest.raises(TypeError, match=r"plan_batch returned NoneType in its list, expected a "):
        evaluate([planner], three())


PATHS: dict[str, Any] = {
    "got None, expected cells, or an empty array where there is no path": None,
    "got shape () of <U3, expected (n, 2) integer cells (row, col)": "abc",
    "got shape (1, 2) of float64, expected (n, 2) integer cells (row, col)": [[math.nan, 1.0]],
    "got shape (1, 2) of complex128, expected (n, 2) integer cells (row, col)": [[1j, 1]],
    "got list, expected an array of cells: ": [[1, 2], [3]],
    "got Tensor, expected an array of cells: ": torch.ones(2, 2, requires_grad=True),
}


@pytest.mark.filterwarnings("ignore:.*none of its paths solves its problem")
@pytest.mark.parametrize("reason", PATHS)
def test_what_is_no_path_is_refused_with_a_reason(reason: str) -> None:
    """Such a planner fails; it does not end the comparison."""
    planner = Functional(lambda *_: Plan(PATHS[reason], 1))
    found = row(evaluate([planner], three(), bootstrap=5), "functional", "all")
    assert found["refused"] == 3
    assert found["first_refused"].startswith(f"problem 0: {reason}")


def test_every_planner_solves_a_problem_before_the_first_solves_all() -> None:
    """So an error of the last one does not come after the work of all others."""
    calls = []

    def count(grid: Grid, start: Cell, goal: Cell) -> Plan:
        calls.append(goal)
        return Plan(np.empty((0, 2), int), 1)

    with pytest.raises(TypeError, match="last: plan returned str"):
        evaluate([Functional(count), Functional(lambda *_: "path", "last")], three())  # type: ignore[arg-type]
    assert calls == GOALS[:1]


@pytest.mark.parametrize(
    ("planners", "message"),
    [
        (None, "planners: got NoneType, expected a list of planners"),
        ([SimpleNamespace(name=None, plan=no_path)], "the name of a SimpleNamespace is None"),
        ([SimpleNamespace(name=["a"], plan=no_path)], r"name of a SimpleNamespace is \['a'\]"),
        ([SimpleNamespace(name="own", plan=3)], "planners: own: plan is no method"),
        (
            [SimpleNamespace(name="own", plan=no_path, plan_batch=3)],
            "planners: own: plan_batch is no method",
        ),
    ],
    ids=["None", "no name", "a list as name", "no method", "no method for batches"],
)
def test_what_is_no_planner_is_refused(planners: Any, message: str) -> None:
    """The message says what was found."""
    with pytest.raises(TypeError, match=message):
        evaluate(planners, three())


def test_a_baseline_expands_cells() -> None:
    """No number can be divided by 0 expansions."""
    planner = Functional(lambda *_: Plan(np.empty((0, 2), int), 0))
    with pytest.raises(ValueError, match="baseline: functional expanded no cell on problem 0"):
        evaluate([planner], three(), baseline="functional")


@pytest.mark.parametrize("seed", [-1, 2.5, None])
def test_a_seed_of_resamples_is_an_unsigned_integer(seed: Any) -> None:
    """The messages of numpy do not name the argument."""
    planner = Scripted([(DETOUR, 1), ([], 1), ([], 1)])
    with pytest.raises(ValueError, match=f"seed: got {seed}, expected"):
        evaluate([planner], three(), seed=seed)


@pytest.mark.parametrize(
    ("iterations", "message"),
    [
        ([4, -5, 4], "paths: iterations: got -5, expected a number of cells, 0 or more"),
        ([4, math.nan, 4], "paths: iterations: got nan, expected a number of cells"),
        (["a", "b", "c"], "paths: iterations: got .*'a'.*, expected a number"),
        ([4, 5], r"paths: got iterations of shape \(2,\) for 3 paths"),
    ],
    ids=["negative", "NaN", "text", "too few"],
)
def test_scores_refuse_impossible_expansions(iterations: list[Any], message: str) -> None:
    """As `evaluate` does."""
    problems = three()
    paths = search_batch("astar", problems.grids, problems.starts, problems.goals, Movement())
    with pytest.raises(ValueError, match=message):
        score_paths(problems, paths._replace(iterations=np.array(iterations)), bootstrap=5)


@pytest.mark.parametrize("paths", [None, 3, "abc", {0: [], 1: [], 2: []}, iter([[], [], []])])
def test_scores_refuse_what_is_no_list_of_paths(paths: Any) -> None:
    """The message says what was found."""
    with pytest.raises(TypeError, match=rf"paths: got {type(paths).__name__}, expected what"):
        score_paths(three(), paths)


def test_scores_refuse_what_is_no_problem_set() -> None:
    """As `evaluate` does."""
    with pytest.raises(TypeError, match="problems: got str, expected a ProblemSet"):
        score_paths("dungeon.npz", [])  # type: ignore[arg-type]


def test_what_is_no_list_of_planners_is_refused() -> None:
    """A class, and a planner alone, as the command line takes them."""
    with pytest.raises(TypeError, match="planners: got the class Scripted, expected an object"):
        evaluate([Scripted], three())  # type: ignore[list-item]
    with pytest.raises(TypeError, match="planners: got one planner, expected a list"):
        evaluate(Scripted([]), three())  # type: ignore[arg-type]


def test_scores_of_paths_none_of_which_is_right_are_warned_of() -> None:
    """For example with starts and goals exchanged."""
    problems = three()
    paths = search_batch("astar", problems.grids, problems.goals, problems.starts, Movement())
    message = r"paths: none of its paths solves .* 0: it leads from \(0, 2\) to \(0, 0\), expected"
    with pytest.warns(UserWarning, match=message) as said:
        score_paths(problems, paths, bootstrap=5)
    assert said[0].filename == __file__


def test_a_table_of_hard_problems_alone_is_printed_once() -> None:
    """The second block would repeat the first one."""
    problems = three()
    text = to_text(evaluate(classical(Movement()), problems[problems.hard], bootstrap=5))
    assert text.startswith("all: 1 problems, hardness at least 1.05\n")
    assert "hard: " not in text


@dataclass
class Timed:
    """A planner that takes a given processor time for each call, on a clock of the test."""

    clock: list[float]
    single_ms: dict[Cell, float]
    batch_ms: list[float]
    name: str = "timed"

    def plan(self, grid: Grid, start: Cell, goal: Cell) -> Plan:
        """Take the time of this goal."""
        self.clock[0] += self.single_ms[goal] / 1000
        return Plan(np.empty((0, 2), int), 1)

    def plan_batch(self, grids: Grid, starts: Cells, goals: Cells) -> list[Plan]:
        """Take the next of the times."""
        self.clock[0] += self.batch_ms.pop(0) / 1000
        return [Plan(np.empty((0, 2), int), 1)] * len(grids)


def test_times_are_medians_of_processor_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first call is not counted, and one slow call changes the upper end alone."""
    clock = [0.0]
    # No other clock is there to be read.
    monkeypatch.setattr(runs, "time", SimpleNamespace(process_time=lambda: clock[0]))
    problems = three()
    single_ms = dict(zip(GOALS, (2.0, 900.0, 4.0), strict=True))
    table = evaluate([Timed(clock, single_ms, [70, 9])], problems, bootstrap=5)
    every = row(table, "timed", "all")
    assert [every[name] for name in ("ms_low", "ms", "ms_high")] == pytest.approx([2, 4, 900])
    assert [every[f"ms_batched{end}"] for end in ("_low", "", "_high")] == pytest.approx([3] * 3)
    hard = row(table, "timed", "hard")  # the first problem alone
    assert [hard[name] for name in ("ms_low", "ms", "ms_high")] == pytest.approx([2] * 3)
    assert hard["ms_batched"] == pytest.approx(3)
    assert "4.000 ±449.000" in to_text(table)


@pytest.mark.parametrize("n", [6, 9, 25, 101, 1000])
def test_the_interval_of_a_median_covers_it_in_19_of_20_samples(n: int) -> None:
    """By the exact probability of scipy: the interval covers the median of the distribution if
    the number of values below it is at least the lower rank, and less than the upper one.
    """
    values = (
        np.random.default_rng(n).permutation(n).astype(np.float64) + 1
    )  # each value is its rank
    median, low_rank, high_rank = median_interval(values)
    assert median == (n + 1) / 2
    below = stats.binom(n, 0.5)
    assert 0.93 < below.cdf(high_rank - 1) - below.cdf(low_rank - 1) < 0.975


def test_a_subset_without_problems_has_nan() -> None:
    """Its row has n = 0."""
    easy = ProblemSet(
        np.zeros((1, 4, 4), np.uint8), np.array([[0, 0]]), np.array([[3, 0]]), Movement()
    )
    table = evaluate(classical(Movement()), easy, bootstrap=5)
    row_of_planner = row(table, "A*", "hard")
    assert row_of_planner["n"] == 0
    assert all(np.isnan(row_of_planner[name]) for name in (*METRICS, "opt_low", "hmean_high", "ms"))
    assert plot_planners(table, subset="hard").get_title() == "hard problems: 0"


def test_a_progress_bar_counts_the_problems_of_each_planner(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Planners with `plan_batch` solve each problem twice."""
    problems = three(Movement(8))
    evaluate(classical(Movement(8))[:4], problems, bootstrap=5)
    assert capsys.readouterr().err == ""
    evaluate(classical(Movement(8))[:4], problems, bootstrap=5, progress=True)
    assert "24/24" in capsys.readouterr().err


def test_a_file_in_place_of_problems_is_refused() -> None:
    """The error names the function that reads it."""
    with pytest.raises(TypeError, match=r"got str, expected a ProblemSet: .*read_problems"):
        evaluate(classical(Movement(8)), "arena.map.scen")  # type: ignore[arg-type]


def test_a_planner_for_another_movement_is_refused() -> None:
    """Its diagonal moves would be illegal, and its row would say that it hardly ever succeeds."""
    (search,) = [planner for planner in classical(Movement(8)) if planner.name == "A*"]
    message = r"planners: A\* is for Movement\(connectivity=8, .*, the problems for .*ty=4.*--conn"
    with pytest.raises(ValueError, match=message):
        evaluate([search], three())


def test_a_model_in_place_of_its_planners_is_refused() -> None:
    """The error names the function that returns them."""
    with pytest.raises(TypeError, match=r"got a SimpleNamespace, which has no 'plan': .* planners"):
        evaluate([SimpleNamespace(name="model")], three())


@pytest.mark.slow
def test_the_interval_of_a_share_is_close_to_the_normal_interval() -> None:
    """For a share the percentile interval is close to the normal one, and the same with the same
    seed.
    """
    problems = ProblemSet.sample(MapSpec(), 2, 400, movement=Movement(8))
    wrong = {tuple(problems.goals[k]) for k in range(0, 400, 4)}

    def plan(grid: Grid, start: Cell, goal: Cell) -> Plan:
        found = astar(grid, start, goal, Movement(8))
        return Plan(found.path[:-1] if goal in wrong else found.path, found.iterations)

    planner = Functional(plan)
    found, again, other = (
        row(evaluate([planner], problems, seed=seed), "functional", "all") for seed in (0, 0, 1)
    )
    share = found["success"]
    half = 1.96 * (share * (1 - share) / 400) ** 0.5
    assert 0.6 < share <= 0.75
    assert found["success_low"] == pytest.approx(share - half, abs=0.008)
    assert found["success_high"] == pytest.approx(share + half, abs=0.008)
    timeless = [name for name in found if not name.startswith("ms")]
    assert [found[name] for name in timeless] == [again[name] for name in timeless]
    assert (
        found["success_low"] != other["success_low"]
        or found["success_high"] != other["success_high"]
    )


@pytest.mark.filterwarnings("ignore:.*none of its paths solves its problem")
def test_planners_get_their_own_copy_of_a_grid() -> None:
    """A planner that writes to its grid does not affect others, and an error of a planner is
    raised.
    """

    def paint(grid: Grid, start: Cell, goal: Cell) -> Plan:
        grid[:] = 0
        return Plan(np.array([start, goal]), 1)

    table = evaluate([Functional(paint, "painter"), *classical(Movement())], three(), bootstrap=5)
    assert row(table, "painter", "all")["success"] == 0
    assert row(table, "A*", "all")["success"] == 1

    def fail(grid: Grid, start: Cell, goal: Cell) -> Plan:
        raise ZeroDivisionError("out of paint")

    with pytest.raises(ZeroDivisionError, match="out of paint"):
        evaluate([Functional(fail)], three())


def test_bad_arguments_are_refused() -> None:
    """Refused are no planner, a name twice, no resample and a batch with too few plans."""
    planners = classical(Movement())
    with pytest.raises(ValueError, match="planners"):
        evaluate([], three())
    with pytest.raises(ValueError, match=r"several are named A\*, expected different names"):
        evaluate([planners[2], planners[2]], three())

    def plan(grid: Grid, start: Cell, goal: Cell) -> Plan:
        raise AssertionError("refused before any planner runs")

    for bootstrap in (0, 10.0):
        with pytest.raises(ValueError, match=f"bootstrap: got {bootstrap}, expected an integer"):
            evaluate([Functional(plan)], three(), bootstrap=bootstrap)  # type: ignore[arg-type]

    class Lazy(Scripted):
        def plan_batch(self, grids: Grid, starts: Cells, goals: Cells) -> list[Plan]:
            return []

    with pytest.raises(ValueError, match="lazy: plan_batch gave 0 plans for 3 problems"):
        evaluate([Lazy([(DETOUR, 1), ([], 1), ([], 1)], "lazy")], three())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("movement", "greedy", "weighted", "limit"),
    [(Movement(8), 0.44, 0.53, 0.827), (Movement(8, corner_cutting=True), 0.38, 0.49, 0.829)],
    ids=["8", "cutting"],
)
def test_the_classical_planners_have_their_known_metrics(
    movement: Movement, greedy: float, weighted: float, limit: float
) -> None:
    """Hmean on hard problems of "dungeon", as a prototype with another A* order measured it on
    other maps.
    """
    table = evaluate(
        classical(movement), ProblemSet.sample(DUNGEON, 77, 600, movement=movement), bootstrap=10
    )
    for planner, expected in (
        ("greedy best-first", greedy),
        ("weighted A* (2)", weighted),
        ("limit", limit),
    ):
        assert row(table, planner, "hard")["hmean"] == pytest.approx(expected, abs=0.03)


# --- the script ---------------------------------------------------------------------------------

SCRIPT = Path(__file__).parents[2] / "scripts" / "evaluate_planners.py"


def run(*arguments: str) -> None:
    """Run the script in this process."""
    runpy.run_path(str(SCRIPT))["main"](list(arguments))


@pytest.mark.slow
def test_the_script_writes_a_list_of_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It writes JSON, CSV and a figure, prints the table, and a second run has the same numbers."""
    outputs = {name: tmp_path / f"out.{name}" for name in ("json", "csv", "png")}
    arguments = [
        "--preset",
        "dungeon",
        "--maps",
        "12",
        "--seed",
        "77",
        "--json",
        str(outputs["json"]),
    ]
    run(*arguments, "--csv", str(outputs["csv"]), "--figure", str(outputs["png"]))
    rows = json.loads(outputs["json"].read_text())
    assert isinstance(rows, list)
    for found in rows:
        assert isinstance(found["planner"], str)
        assert found["subset"] in ("all", "hard")
        assert {name: type(found[name]) for name in ("n", *METRICS, "ms")} == {
            "n": int,
            **dict.fromkeys((*METRICS, "ms"), float),
        }
    of_all = {found["planner"]: found["n"] for found in rows if found["subset"] == "all"}
    learned = {name for name in of_all if name.startswith("path_predictor")}
    assert learned
    assert set(of_all) - learned == {planner.name for planner in classical(Movement(8))}
    assert set(of_all.values()) == {12}
    table = pd.read_csv(outputs["csv"])
    assert table["planner"].tolist() == [found["planner"] for found in rows]
    np.testing.assert_allclose(table["hmean"], [found["hmean"] for found in rows], atol=1e-9)
    assert outputs["png"].read_bytes().startswith(b"\x89PNG")
    assert "greedy best-first" in capsys.readouterr().out
    run(*arguments)
    again = json.loads(outputs["json"].read_text())
    for one, other in zip(rows, again, strict=True):
        assert {name: one[name] for name in one if name[:2] != "ms"} == {
            name: other[name] for name in other if name[:2] != "ms"
        }


@pytest.mark.slow
def test_the_script_measures_in_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Times count all threads, also those that wait; afterwards torch has the threads as before."""
    seen = []
    monkeypatch.setattr(
        "mapdata.models.evaluate.compare_planners",
        lambda *_, **__: seen.append(torch.get_num_threads()),
    )
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        evaluate_planners([], preset="dungeon", maps=3)
        seen.append(torch.get_num_threads())
    finally:
        torch.set_num_threads(before)
    assert seen == [1, 2]


@pytest.mark.slow
def test_the_script_takes_a_dataset(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A root replaces preset and seed, and gives one problem on each map of its test split."""
    build(tmp_path / "maps", DUNGEON, maps=60, seed=9, shard_size=60, workers=1)
    run(str(tmp_path / "maps"), "--connectivity", "4", "--json", str(tmp_path / "out.json"))
    rows = json.loads((tmp_path / "out.json").read_text())
    assert rows[0]["n"] == len(ProblemSet.read(tmp_path / "maps", movement=Movement()))
    assert "connectivity=4" in capsys.readouterr().out


@pytest.mark.slow
def test_the_script_takes_files_of_problems(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A .scen and a saved set keep their own movement, and flags that would do nothing
    are refused.
    """
    text = "type octile\nheight 2\nwidth 9\nmap\n.........\n.........\n"
    (tmp_path / "a.map").write_text(text)
    scen = tmp_path / "a.scen"
    scen.write_text("version 1\n" + 2 * "0\ta.map\t9\t2\t0\t0\t7\t0\t7\n")
    saved = tmp_path / "set.npz"
    run(str(scen), "--maps", "1", "--save", str(saved), "--json", str(tmp_path / "out.json"))
    assert json.loads((tmp_path / "out.json").read_text())[0]["n"] == 1
    run(str(saved))
    lines = capsys.readouterr().out.splitlines()
    headings = [line for line in lines if line.startswith("1 of 2 problems of")]
    assert len(headings) == 2
    assert headings[0] == headings[1]
    for flags in (["--maps", "1"], ["--seed", "1"], ["--connectivity", "4"]):
        with pytest.raises(SystemExit):
            run(str(saved), *flags)


@pytest.mark.parametrize(
    "arguments",
    [
        ["--preset", "castle"],
        ["--maps", "0"],
        ["--connectivity", "4", "--corner-cutting"],
        ["--connectivity", "5"],
        ["no/such/dataset"],
        ["no/such/dataset", "--seed", "1"],
        ["--seed", "-1"],
        ["--maps", "2", "--json", "no/such/folder/out.json"],
        ["--until-hard", "5", "--maps", "1"],
        ["--maps", "2", "--baseline", "B*"],
        ["no/such/file.scen"],
        ["no/such/file.npz", "--until-hard", "5"],
    ],
    ids=" ".join,
)
def test_the_script_says_what_is_wrong_in_one_line(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """The exit code is 2, and there is no traceback."""
    with pytest.raises(SystemExit) as error:
        run(*arguments)
    captured = capsys.readouterr()
    assert (error.value.code, captured.out, captured.err.count("\n")) == (2, "", 1)
    assert captured.err.startswith("mapdata: ")


@pytest.mark.slow
def test_the_script_loads_weights_for_the_movement_of_the_problems(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """If corners may be cut, the predictor for that movement is compared without a flag."""
    cut = ProblemSet.sample(
        MapSpec.preset("dungeon"), 77, maps=4, movement=Movement(8, corner_cutting=True)
    )
    cut.save(tmp_path / "cut.npz")
    run(str(tmp_path / "cut.npz"))
    assert "path_predictor (search)" in capsys.readouterr().out


def test_differences_are_those_of_scipys_paired_bootstrap() -> None:
    """Metrics minus those of a named planner: 0 for this planner itself, and for another one with
    the interval of scipy, which resamples the problems of both together.
    """
    movement = Movement(8)
    problems = ProblemSet.sample(DUNGEON, 3, 80, movement=movement)
    weighted, greedy = BestFirst("mild", movement, 1.25), BestFirst("greedy", movement, 3)
    table = evaluate([weighted, greedy], problems, difference_from="mild")
    assert [row(table, "mild", "all")[f"{name}_difference"] for name in METRICS] == [0] * 6
    of_greedy = row(table, "greedy", "all")
    optimal = problems.optimal
    for metric, score in (
        (
            "opt",
            lambda plan, k: check_path(problems.grids[k], plan.path, movement) == optimal.cost[k],
        ),
        ("expansion_ratio", lambda plan, k: plan.expansions / optimal.iterations[k]),
    ):
        scores = [
            np.array([score(plan, k) for k, plan in enumerate(plans)], float)
            for plans in (
                planner.plan_batch(problems.grids, problems.starts, problems.goals)
                for planner in (greedy, weighted)
            )
        ]
        found = stats.bootstrap(
            scores,
            lambda first, second, axis: first.mean(axis) - second.mean(axis),
            paired=True,
            method="percentile",
            rng=np.random.default_rng(1),
        ).confidence_interval
        width = found.high - found.low
        assert of_greedy[f"{metric}_difference"] == pytest.approx(np.mean(scores[0] - scores[1]))
        for end, expected in zip(("low", "high"), found, strict=True):
            # Both are quantiles of random resamples.
            assert of_greedy[f"{metric}_difference_{end}"] == pytest.approx(
                expected, abs=0.1 * width
            )


def test_the_planner_of_differences_must_be_there() -> None:
    """The message lists the planners."""
    plan = Scripted([([], 1), ([], 1), ([], 1)])
    with pytest.raises(ValueError, match=r"difference_from: got 'A', expected .*scripted"):
        evaluate([plan], three(), difference_from="A")
