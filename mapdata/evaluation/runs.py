"""The measurements of a planner: each problem is solved, its path checked, and its time taken."""

from __future__ import annotations

import inspect
import math
import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from mapdata.arrays import Bytes, Floats
from mapdata.checks import check_number
from mapdata.evaluation.plan import BatchPlanner, Plan, Planner
from mapdata.problems.problem_set import ProblemSet
from mapdata.search.api import check_path
from mapdata.search.map_stack import MapStack
from mapdata.shards.workers import Advance

_BATCH = 64
"""Number of problems in a call of ``plan_batch``."""


class Run(NamedTuple):
    """The measurements of a planner on N problems.

    Attributes:
        costs: (N,) costs L of the paths, NaN for failures.
        refusals: why paths are refused, by the number of their problem, in ascending order.
        expansions: (N,) numbers of expansions E.
        prepared: (N,) numbers of prepared cells.
        looks: (N,) numbers of visited cells.
        ms: (N,) milliseconds that `plan` took.
        ms_batched: (K,) milliseconds a problem of K calls of `plan_batch`; (0,) without it.
        other_costs_batched: number of paths of `plan_batch` that cost something else than those of
            `plan`.
    """

    costs: Floats
    refusals: Mapping[int, str]
    expansions: Floats
    prepared: Floats
    looks: Floats
    ms: Floats
    ms_batched: Floats
    other_costs_batched: int


def _takes_terrain(planner: Planner) -> bool:
    """Return whether a planner takes terrain, as `Planner` defines it."""
    method = planner.plan_batch if isinstance(planner, BatchPlanner) else planner.plan
    return "terrain" in inspect.signature(method).parameters


def _terrain_argument(planner: Planner, terrain: Bytes | None) -> dict[str, Any]:
    """Return terrain as an argument by name; none if there is none or it is not to be passed."""
    if terrain is None or not _takes_terrain(planner):
        return {}
    return {"terrain": terrain}


def call_untimed(planner: Planner, problems: ProblemSet) -> None:
    """Solve the first problem with a planner, and the first batch with its `plan_batch`."""
    _timed_plan(planner, problems, 0)
    if isinstance(planner, BatchPlanner):
        _timed_batch(planner, problems, 0)


def run_planner(planner: Planner, problems: ProblemSet, advance: Advance) -> Run:
    """Solve all problems with a planner, check its paths and measure its times.

    ``advance`` is called with numbers of solved problems.
    """
    costs, expansions, prepared, looks, ms = np.empty((5, len(problems)))
    refusals = {}
    for k in range(len(problems)):
        plan, ms[k] = _timed_plan(planner, problems, k)
        costs[k], reason = cost_of_path(plan.path, problems, k)
        if reason:
            refusals[k] = reason
        expansions[k] = plan.expansions
        prepared[k] = plan.prepared
        looks[k] = plan.expansions if plan.looks is None else plan.looks
        advance(1)
    ms_batched = np.empty(0)
    other_costs_batched = 0
    if isinstance(planner, BatchPlanner):
        ms_batched, batched_costs = _run_batched(planner, problems, advance)
        is_other_cost = ~np.isclose(batched_costs, costs, equal_nan=True)
        other_costs_batched = int(is_other_cost.sum())
    return Run(costs, refusals, expansions, prepared, looks, ms, ms_batched, other_costs_batched)


def _run_batched(
    planner: BatchPlanner, problems: ProblemSet, advance: Advance
) -> tuple[Floats, Floats]:
    """Solve all problems in batches, and measure times as `run_planner` does.

    Returns:
        The milliseconds a problem of each call of ``plan_batch``, and the costs of the paths, (N,),
        NaN for failures.
    """
    ms = []
    costs = np.empty(len(problems))
    for first in range(0, len(problems), _BATCH):
        plans, batch_ms = _timed_batch(planner, problems, first)
        ms.append(batch_ms / len(plans))
        for k, plan in enumerate(plans, start=first):
            costs[k], _ = cost_of_path(plan.path, problems, k)
        advance(len(plans))
    return np.array(ms), costs


def _map_of(problems: ProblemSet, k: int) -> tuple[Bytes, Bytes | None]:
    """Return copies of the grid and the terrain of problem ``k``, each (H, W)."""
    return MapStack(*problems.maps_of([k])).grid_and_terrain(0)


def cost_of_path(path: npt.ArrayLike | None, problems: ProblemSet, k: int) -> tuple[float, str]:
    """Return the cost of ``path`` and an empty text.

    If it does not solve problem ``k``, return NaN and the reason, which is empty for no path.
    """
    if path is None:
        return np.nan, "got None, expected cells, or an empty array where there is no path"
    try:
        cells = np.asarray(path)
    except (TypeError, ValueError, RuntimeError) as error:  # uneven lists, or tensors on a GPU
        return np.nan, f"got {type(path).__name__}, expected an array of cells: {error}"
    if cells.size == 0:
        return np.nan, ""
    grid, terrain = _map_of(problems, k)
    try:
        cost = check_path(grid, cells, problems.movement, terrain=terrain)
    except ValueError as error:
        return np.nan, str(error).removeprefix("path: ")
    start, goal = problems.starts[k], problems.goals[k]
    if np.array_equal(cells[0], start) and np.array_equal(cells[-1], goal):
        return cost, ""
    first, last = tuple(cells[0].tolist()), tuple(cells[-1].tolist())
    return np.nan, (
        f"it leads from {first} to {last}, expected from {tuple(start.tolist())} to "
        f"{tuple(goal.tolist())}"
    )


def _timed_plan(planner: Planner, problems: ProblemSet, k: int) -> tuple[Plan, float]:
    """Return the plan for problem ``k``, checked, and the milliseconds that it took."""
    start = tuple(problems.starts[k].tolist())
    goal = tuple(problems.goals[k].tolist())
    grid, terrain = _map_of(problems, k)  # copies, since a planner may write to them
    arguments = _terrain_argument(planner, terrain)
    began = time.process_time()
    try:
        plan = planner.plan(grid, start, goal, **arguments)
    except (Exception, SystemExit) as error:
        _add_note(error, f"planner {planner.name}, problem {k}")
        raise
    ms = 1000 * (time.process_time() - began)
    _check_plan(planner, "plan", plan)
    return plan, ms


def _add_note(error: BaseException, note: str) -> None:
    """Let the traceback of an error end with a note; Python 3.10 has no notes."""
    if sys.version_info >= (3, 11):
        error.add_note(note)


def _timed_batch(
    planner: BatchPlanner, problems: ProblemSet, first: int
) -> tuple[Sequence[Plan], float]:
    """Return the plans for a batch of problems from ``first`` on, checked, and its milliseconds.

    Raises:
        TypeError: ``plan_batch`` returns no list of plans.
        ValueError: it returns another number of plans than it got problems.
    """
    batch = slice(first, first + _BATCH)
    grids, terrain = problems.maps_of(batch)
    starts = problems.starts[batch].copy()
    goals = problems.goals[batch].copy()
    count = len(starts)
    arguments = _terrain_argument(planner, terrain)
    began = time.process_time()
    try:
        plans = planner.plan_batch(grids, starts, goals, **arguments)
    except (Exception, SystemExit) as error:
        _add_note(error, f"plan_batch of {planner.name}, problems {first} to {first + count - 1}")
        raise
    ms = 1000 * (time.process_time() - began)
    # A named tuple, such as one Plan or the BatchResult of search_batch, is a tuple, too.
    if not isinstance(plans, (list, tuple)) or hasattr(plans, "_fields"):
        raise TypeError(
            f"{planner.name}: plan_batch returned {type(plans).__name__}, expected a list of "
            "mapdata.Plan(path, expansions), one for each problem"
        )
    if len(plans) != count:
        raise ValueError(f"{planner.name}: plan_batch gave {len(plans)} plans for {count} problems")
    for plan in plans:
        _check_plan(planner, "plan_batch", plan)
    return plans, ms


def _check_plan(planner: Planner, method: str, plan: object) -> None:
    """Check that a planner answered with a `Plan`, or with an object that has its fields.

    Args:
        planner: whose answer it is.
        method: "plan" or "plan_batch", which returned it.
        plan: the answer.

    Raises:
        TypeError: it did not.
        ValueError: a number of cells is no number, negative or not finite.
    """
    if not all(hasattr(plan, name) for name in Plan._fields):
        part = "" if method == "plan" else " in its list"
        raise TypeError(
            f"{planner.name}: {method} returned {type(plan).__name__}{part}, expected a "
            "mapdata.Plan(path, expansions)"
        )
    for name in ("expansions", "prepared", "looks"):
        count = getattr(plan, name)
        if not (name == "looks" and count is None):
            cell_count(f"{planner.name}: {name}", count)


def cell_count(name: str, count: object) -> float:
    """Return a number of cells as a float.

    Raises:
        ValueError: it is no number, negative or not finite. The message begins with ``name``.
    """
    shape = tuple(getattr(count, "shape", ()))
    if shape:
        raise ValueError(f"{name}: got an array of shape {shape}, expected a number of cells")
    number = check_number(name, count)
    if not 0 <= number < math.inf:
        raise ValueError(f"{name}: got {count}, expected a number of cells, 0 or more")
    return number


def first_refusal(refusals: Mapping[int, str]) -> str:
    """Return the number of the first problem whose path is refused, and why; "" without one."""
    for number, reason in refusals.items():
        return f"problem {number}: {reason}"
    return ""
