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
"""Number of problems in a call of ``plan_batch``."""


class Plan(NamedTuple):
    """The answer of a planner to a problem.

    Attributes:
        path: (k, 2) integer cells from start to goal, both included; (0, 2) without a path.
        expansions: number of cells that the planner expanded, the goal included.
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
    """A planner that also solves many problems in one call."""

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

    Each planner has two rows: all problems, and the hard ones. L is the cost of a path and E the
    number of expansions. L* and E* are those of mapdata's A* (docs/format.md fixes its order) under
    the same movement; with ``baseline``, E* is that of another planner. A planner succeeds if its
    path leads from the start to the goal and `check_path` accepts it. Columns:

    - ``planner``; ``subset``, "all" or "hard" (hardness at least ``HARD``); ``n``, the number of
      problems in it.
    - ``success``: share of problems solved.
    - ``opt``: share of problems solved with L = L* (Neural A*'s Opt).
    - ``cost_ratio``: mean L / L* over the solved problems (TransPath), NaN if none is solved.
    - ``expansion_ratio``: mean E / E* (TransPath), over all problems, including the expansions of
      failures.
    - ``p_exp``: mean max(0, 1 - E / E*) (Neural A*'s Exp), over all problems.
    - ``hmean``: harmonic mean of ``opt`` and ``p_exp`` (Neural A*'s Hmean), 0 if both are 0.
    - ``<name>_low``, ``<name>_high`` of these six: 95 % percentile interval over resampled
      problems, with the same resamples for all planners.
    - ``ms``: mean milliseconds of a call of `plan`, which solves one problem.
    - ``ms_batched``: mean milliseconds a problem in calls of `plan_batch` with 64 problems; NaN for
      a planner without it. It is of all problems in both rows.

    The first call of each planner is not timed. All columns but ``ms_batched`` are of `plan`.

    A subset without problems has n = 0 and NaN elsewhere.

    Args:
        planners: the planners to compare, with different names;
            `mapdata.evaluation.planners.classical` returns the usual ones.
        problems: the problems to solve.
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
    reference_expansions: Floats | Ints = problems.optimal.iterations
    if baseline is not None:
        reference_expansions = runs[names.index(baseline)].expansions
    outcomes = np.stack([_outcomes(run, problems, reference_expansions) for run in runs], axis=1)
    rows = []
    for subset, mask in (("all", np.ones(len(problems), bool)), ("hard", problems.hard)):
        metrics, lows, highs = confidence_intervals(outcomes[mask], _metrics, bootstrap, seed)
        for k, run in enumerate(runs):
            row: dict[str, object] = {"planner": names[k], "subset": subset, "n": mask.sum()}
            for m, name in enumerate(METRICS):
                row[name] = metrics[k, m]
            row["ms"] = run.ms[mask].mean() if mask.any() else np.nan
            row["ms_batched"] = run.ms_batched
            for m, name in enumerate(METRICS):
                row[f"{name}_low"] = lows[k, m]
                row[f"{name}_high"] = highs[k, m]
            rows.append(row)
    return pd.DataFrame(rows)


def confidence_intervals(
    outcomes: Floats, metrics: Callable[[Floats], Floats], bootstrap: int = 1000, seed: int = 0
) -> Floats:
    """Return metrics of mean outcomes, with 95 % percentile intervals over resampled problems.

    Args:
        outcomes: (n, ..., C), C outcomes of n problems, perhaps with axes between for planners.
        metrics: function that computes M metrics (..., M) from mean outcomes (..., C); NaN where
            a metric is undefined.
        bootstrap: number of resamples, which consist of the same problems for all planners.
        seed: of the resamples.

    Returns:
        (3, ..., M): the metrics, the lower and the upper end of their intervals; NaN when n is 0.
    """
    n = len(outcomes)
    of_all_problems = metrics(outcomes.sum(axis=0) / max(n, 1))
    if n == 0:
        return np.full((3, *of_all_problems.shape), np.nan)
    generator = np.random.default_rng(seed)
    sums = np.empty((bootstrap, *outcomes.shape[1:]))
    for k in range(bootstrap):
        # The sum over a resample weights each problem by how often it is drawn. So the outcomes
        # need not be copied for each resample.
        times_drawn = np.bincount(generator.integers(n, size=n), minlength=n)
        sums[k] = np.tensordot(times_drawn, outcomes, 1)
    resampled = pd.DataFrame(metrics(sums / n).reshape(bootstrap, -1))
    ends = resampled.quantile([0.025, 0.975]).to_numpy()  # pandas leaves NaN out
    return np.concatenate([of_all_problems[None], ends.reshape(2, *of_all_problems.shape)])


def to_text(table: pd.DataFrame) -> str:
    """Return a table of `evaluate` as text: a block of all problems, and a block of the hard ones.

    Each metric is followed by half the width of its interval.
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
    """Return a metric of each row as text, followed by half the width of its interval."""
    half_width = (rows[f"{metric}_high"] - rows[f"{metric}_low"]) / 2
    return rows[metric].map("{:.3f}".format) + half_width.map(" ±{:.3f}".format)


class _Run(NamedTuple):
    """The measurements of a planner on N problems.

    Attributes:
        costs: (N,) costs L of the paths, NaN for failures.
        expansions: (N,) numbers of expansions E.
        ms: (N,) milliseconds that `plan` took.
        ms_batched: mean milliseconds a problem in batches, NaN without `plan_batch`.
    """

    costs: Floats
    expansions: Floats
    ms: Floats
    ms_batched: float


def _run(planner: Planner, problems: ProblemSet) -> _Run:
    """Solve all problems with a planner, check its paths and measure its times."""
    costs = np.empty(len(problems))
    expansions = np.empty(len(problems))
    ms = np.empty(len(problems))
    # The first problem is solved twice, and the second time counts: the first call may compile
    # kernels and fill caches.
    for k in (0, *range(len(problems))):
        start = tuple(problems.starts[k].tolist())
        goal = tuple(problems.goals[k].tolist())
        grid = problems.grids[k].copy()  # a planner may write to it
        began = time.perf_counter()
        plan = planner.plan(grid, start, goal)
        ms[k] = 1000 * (time.perf_counter() - began)
        costs[k] = _cost(plan, problems, k)
        expansions[k] = plan.expansions
    ms_batched = np.nan
    if isinstance(planner, BatchPlanner):
        ms_batched = _mean_batched_ms(planner, problems)
    return _Run(costs, expansions, ms, ms_batched)


def _outcomes(run: _Run, problems: ProblemSet, reference_expansions: Floats | Ints) -> Floats:
    """Return five outcomes of each problem, (N, 5), whose means the metrics need.

    They are: whether it is solved, whether its path is optimal, L / L* (0 for failures), E / E* and
    max(0, 1 - E / E*).

    Args:
        run: the measurements of a planner.
        problems: the problems.
        reference_expansions: (N,) E*.
    """
    optimal_costs = problems.optimal.cost
    is_solved = ~np.isnan(run.costs)
    is_optimal = run.costs == optimal_costs
    cost_ratio = np.where(is_solved, run.costs / optimal_costs, 0.0)
    expansion_ratio = run.expansions / reference_expansions
    saved = np.maximum(0, 1 - expansion_ratio)
    return np.column_stack([is_solved, is_optimal, cost_ratio, expansion_ratio, saved])


def _mean_batched_ms(planner: BatchPlanner, problems: ProblemSet) -> float:
    """Return the mean milliseconds a problem of ``plan_batch``.

    Raises:
        ValueError: it returns another number of plans than it got problems.
    """
    seconds = []
    # The first batch is solved twice, and the second time counts, as in `_run`.
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
    return 1000 * sum(seconds[1:]) / len(problems)


def _cost(plan: Plan, problems: ProblemSet, k: int) -> float:
    """Return the cost of a plan's path, NaN if it does not solve problem ``k``."""
    path = np.asarray(plan.path)
    try:
        cost = check_path(problems.grids[k], path, problems.movement)
    except ValueError:
        return np.nan
    joins_start_and_goal = np.array_equal(path[0], problems.starts[k]) and np.array_equal(
        path[-1], problems.goals[k]
    )
    return cost if joins_start_and_goal else np.nan


def _metrics(means: Floats) -> Floats:
    """Return the six `METRICS` (..., 6) of mean outcomes (..., 5), those of `_outcomes`."""
    success, opt, cost_ratio_or_0, expansion_ratio, saved = np.moveaxis(means, -1, 0)
    with np.errstate(invalid="ignore"):
        # The mean over all problems, where failures count 0, becomes that over the solved ones:
        # 0 / 0 = NaN if none is solved.
        cost_ratio = cost_ratio_or_0 / success
        harmonic_mean = 2 * opt * saved / (opt + saved)
    hmean = np.where(opt + saved > 0, harmonic_mean, 0.0)
    return np.stack([success, opt, cost_ratio, expansion_ratio, saved, hmean], axis=-1)
