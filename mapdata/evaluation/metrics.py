"""Compare planners: the metrics of Neural A* and TransPath for anything that plans, in one table.

Neural A*: Yonetani et al., ICML 2021, https://arxiv.org/abs/2009.07476.
TransPath: Kirilenko et al., AAAI 2023, https://arxiv.org/abs/2212.11730.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
import pandas as pd

from mapdata.arrays import Bytes, Floats, Ints, summary
from mapdata.checks import check_choice, check_count
from mapdata.limits import Cell
from mapdata.problems.problem_set import ProblemSet
from mapdata.search.api import check_path
from mapdata.search.lattice import HARD

METRICS = ("success", "opt", "cost_ratio", "expansion_ratio", "p_exp", "hmean")
"""Columns of the table that have an interval, from ``<name>_low`` to ``<name>_high``."""

_BATCH = 64
"""Problems that ``plan_batch`` gets at a time."""


class Plan(NamedTuple):
    """What a planner answers.

    Attributes:
        path: (k, 2) integer cells from start to goal, both included; (0, 2) when it found none.
        expansions: number of cells that it expanded, the goal included.
    """

    path: npt.NDArray[np.integer[Any]]
    expansions: int

    def __repr__(self) -> str:
        return summary(self)


class Planner(Protocol):
    """Anything that plans a path on a grid."""

    @property
    def name(self) -> str:
        """Its name in the table."""

    def plan(self, grid: Bytes, start: Cell, goal: Cell) -> Plan:
        """Return a path on ``grid``, (H, W) of 0 free and 1 occupied."""


@runtime_checkable
class BatchPlanner(Planner, Protocol):
    """A planner that takes many problems in one call too."""

    def plan_batch(self, grids: Bytes, starts: Ints, goals: Ints) -> list[Plan]:
        """Return a plan for each of the B problems: grids (B, H, W), starts and goals (B, 2)."""


def evaluate(
    planners: Sequence[Planner],
    problems: ProblemSet,
    *,
    baseline: str | None = None,
    bootstrap: int = 1000,
    seed: int = 0,
) -> pd.DataFrame:
    """Return the table of ``planners`` on ``problems``.

    Two rows a planner: all problems, and the hard ones. L is the cost of a path, E the number of
    expansions, L* and E* are those of mapdata's A* (docs/format.md fixes its order) under the same
    movement; with ``baseline``, E* is that of another row. A planner succeeds where its path starts
    and ends as asked and `check_path` accepts it. Columns:

    - ``planner``; ``subset``, "all" or "hard" (hardness at least ``HARD``); ``n``, the number of
      problems in it.
    - ``success``: share of problems solved.
    - ``opt``: share of problems solved with L = L* (Neural A*'s Opt).
    - ``cost_ratio``: mean L / L* over the problems solved (TransPath), NaN where none is.
    - ``expansion_ratio``: mean E / E* (TransPath), over all problems: what a failure expanded
      counts.
    - ``p_exp``: mean max(0, 1 - E / E*) (Neural A*'s Exp), likewise.
    - ``hmean``: harmonic mean of ``opt`` and ``p_exp`` (Neural A*'s Hmean), 0 where both are 0.
    - ``<name>_low``, ``<name>_high`` of these six: 95 % percentile interval over resampled
      problems, the same resamples for all planners.
    - ``ms``: milliseconds a problem, one at a time; ``ms_batched``: in batches of 64 over all
      problems, for a planner that has `plan_batch`, else NaN. The first call of each is not timed.
      All other columns are of `plan`.

    A subset without problems has n = 0 and NaN elsewhere.

    Args:
        planners: what to compare; `mapdata.evaluation.planners.classical` gives the usual rows.
        problems: on what.
        baseline: name of the planner whose expansions are E*.
        bootstrap: number of resamples.
        seed: of the resamples.

    Raises:
        ValueError: no planner, two of one name, none of the name ``baseline``, no problem, no
            resample, or a ``plan_batch`` with too few plans.
        Exception: whatever a planner raises.
    """
    names = [planner.name for planner in planners]
    if not names or len(set(names)) < len(names):
        raise ValueError(f"planners: got the names {names}, expected at least one and each once")
    if not len(problems):
        raise ValueError("problems: got none, expected at least one")
    check_count("bootstrap", bootstrap)
    if baseline is not None:
        check_choice("baseline", baseline, names)
    runs = [_run(planner, problems) for planner in planners]
    reference = (
        problems.optimal.iterations if baseline is None else runs[names.index(baseline)].expansions
    )
    outcomes = np.stack([_outcomes(run, problems, reference) for run in runs], axis=1)
    rows = []
    for subset, mask in (("all", np.ones(len(problems), bool)), ("hard", problems.hard)):
        values, lows, highs = confidence_intervals(outcomes[mask], _metrics, bootstrap, seed)
        for k, run in enumerate(runs):
            row = {
                "planner": names[k],
                "subset": subset,
                "n": mask.sum(),
                **dict(zip(METRICS, values[k], strict=True)),
                "ms": run.ms[mask].mean() if mask.any() else np.nan,
                "ms_batched": run.ms_batched,
            }
            for m, metric in enumerate(METRICS):
                row[f"{metric}_low"] = lows[k, m]
                row[f"{metric}_high"] = highs[k, m]
            rows.append(row)
    return pd.DataFrame(rows)


def confidence_intervals(
    outcomes: Floats, metrics: Callable[[Floats], Floats], bootstrap: int = 1000, seed: int = 0
) -> Floats:
    """Return metrics of mean outcomes, with 95 % percentile intervals over resampled problems.

    Args:
        outcomes: (n, ..., C) what is averaged over n problems, of any number of contestants.
        metrics: makes metrics (..., M) of means (..., C), NaN where one is undefined.
        bootstrap: number of resamples, the same problems for all contestants.
        seed: of the resamples.

    Returns:
        (3, ..., M): the metrics, the lower and the upper end of their intervals; NaN when n is 0.
    """
    n = len(outcomes)
    values = metrics(outcomes.sum(axis=0) / max(n, 1))
    if n == 0:
        return np.full((3, *values.shape), np.nan)
    source = np.random.default_rng(seed)
    sums = np.empty((bootstrap, *outcomes.shape[1:]))
    for k in range(bootstrap):
        # How often each problem is in the resample times its outcomes: no copy of them is made.
        times_drawn = np.bincount(source.integers(n, size=n), minlength=n)
        sums[k] = np.tensordot(times_drawn, outcomes, 1)
    resampled = pd.DataFrame(metrics(sums / n).reshape(bootstrap, -1))
    ends = resampled.quantile([0.025, 0.975]).to_numpy()  # leaves NaN out
    return np.concatenate([values[None], ends.reshape(2, *values.shape)])


def to_text(table: pd.DataFrame) -> str:
    """Return a table of `evaluate`, with all of its columns, as text.

    Each metric stands with half its interval's width; the problems of each subset, all or the hard
    ones, are a block of their own.
    """
    blocks = []
    for subset, rows in table.groupby("subset", sort=False):
        text = pd.DataFrame({"planner": rows["planner"]})
        for metric in METRICS:
            text[metric] = with_interval(rows, metric)
        for name in ("ms", "ms_batched"):
            text[name] = rows[name].map("{:.3f}".format)
        heading = f"{subset}: {rows['n'].iloc[0]} problems"
        if subset == "hard":
            heading += f", hardness at least {HARD}"
        blocks.append(f"{heading}\n{text.to_string(index=False)}")
    return "\n\n".join(blocks)


def with_interval(rows: pd.DataFrame, metric: str) -> pd.Series[str]:
    """Return a metric as text, with half its interval's width."""
    half = (rows[f"{metric}_high"] - rows[f"{metric}_low"]) / 2
    return rows[metric].map("{:.3f}".format) + half.map(" ±{:.3f}".format)


class _Run(NamedTuple):
    """What a planner achieved.

    Attributes:
        costs: (N,) L of each problem, NaN in a failure.
        expansions: (N,) E.
        ms: (N,) milliseconds.
        ms_batched: milliseconds a problem in batches, NaN without `plan_batch`.
    """

    costs: Floats
    expansions: Floats
    ms: Floats
    ms_batched: float


def _run(planner: Planner, problems: ProblemSet) -> _Run:
    """Plan and check every problem."""
    costs, expansions, ms = np.empty((3, len(problems)))
    for k in (0, *range(len(problems))):  # the first twice: kernels compile and caches fill
        start = tuple(problems.starts[k].tolist())
        goal = tuple(problems.goals[k].tolist())
        grid = problems.grids[k].copy()  # a planner may write to it
        began = time.perf_counter()
        plan = planner.plan(grid, start, goal)
        ms[k] = 1000 * (time.perf_counter() - began)
        costs[k] = _cost(plan, problems, k)
        expansions[k] = plan.expansions
    ms_batched = _batched(planner, problems) if isinstance(planner, BatchPlanner) else np.nan
    return _Run(costs, expansions, ms, ms_batched)


def _outcomes(run: _Run, problems: ProblemSet, reference: Floats | Ints) -> Floats:
    """Return what is averaged of each problem, (N, 5), with ``reference`` (N,) for E*.

    Success and opt, 0 or 1; L / L*, 0 in a failure; E / E*; max(0, 1 - E / E*).
    """
    optimal = problems.optimal.cost
    ratio = run.expansions / reference
    cost_ratio = np.nan_to_num(run.costs / optimal)
    saved = np.maximum(0, 1 - ratio)
    return np.column_stack([cost_ratio > 0, run.costs == optimal, cost_ratio, ratio, saved])


def _batched(planner: BatchPlanner, problems: ProblemSet) -> float:
    """Return the milliseconds a problem in batches."""
    seconds = []
    for first in (0, *range(0, len(problems), _BATCH)):
        batch = slice(first, first + _BATCH)
        grids = problems.grids[batch].copy()
        starts = problems.starts[batch].copy()
        goals = problems.goals[batch].copy()
        began = time.perf_counter()
        plans = planner.plan_batch(grids, starts, goals)
        seconds.append(time.perf_counter() - began)
        if len(plans) != len(starts):
            raise ValueError(
                f"{planner.name}: plan_batch gave {len(plans)} plans for {len(starts)} problems"
            )
    return 1000 * sum(seconds[1:]) / len(problems)  # without the first call, as in `_run`


def _cost(plan: Plan, problems: ProblemSet, k: int) -> float:
    """Return the cost of a plan's path, NaN if it does not solve problem k."""
    path = np.asarray(plan.path)
    try:
        cost = check_path(problems.grids[k], path, problems.movement)
    except ValueError:
        return np.nan
    ends = problems.starts[k], problems.goals[k]
    return cost if np.array_equal(path[[0, -1]], ends) else np.nan


def _metrics(means: Floats) -> Floats:
    """Return the metrics (..., 6) of mean outcomes (..., 5)."""
    success, opt, cost, expansions, saved = np.moveaxis(means, -1, 0)
    with np.errstate(invalid="ignore"):  # 0 / 0: no problem was solved
        cost_ratio = cost / success
        hmean = np.where(opt + saved > 0, 2 * opt * saved / (opt + saved), 0.0)
    return np.stack([success, opt, cost_ratio, expansions, saved, hmean], axis=-1)
