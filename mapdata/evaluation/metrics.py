"""Compare planners: the metrics of Neural A* and TransPath for anything that plans, in one table.

Neural A*: Yonetani et al., ICML 2021, https://arxiv.org/abs/2009.07476.
TransPath: Kirilenko et al., AAAI 2023, https://arxiv.org/abs/2212.11730.
"""

from __future__ import annotations

import inspect
import math
import time
import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
import pandas as pd

from mapdata.arrays import Bytes, Floats, Ints, summary
from mapdata.checks import check_choice, check_count
from mapdata.describe.intervals import confidence_intervals
from mapdata.limits import Cell
from mapdata.movement import Movement
from mapdata.problems.problem_set import ProblemSet
from mapdata.search.api import BatchResult, check_path
from mapdata.search.lattice import HARD
from mapdata.shards.workers import Advance, bar

METRICS = ("success", "opt", "cost_ratio", "expansion_ratio", "p_exp", "hmean")
"""Columns of the table that have an interval, from ``<name>_low`` to ``<name>_high``."""

TERRAIN_METRICS = (*METRICS, "regret")
"""The same for problems on terrain."""

TIMES = ("ms", "ms_batched")
"""Columns of the table that are times. They have an interval, too."""

_BATCH = 64
"""Number of problems in a call of ``plan_batch``."""


class Plan(NamedTuple):
    """The answer of a planner to a problem.

    Attributes:
        path: (k, 2) integer cells from start to goal, both included; (0, 2) without a path.
        expansions: number of cells that the planner expanded, the goal included.
        prepared: number of cells that it computed something of before the search: those of a field
            of costs to the goal, or all cells of a map that a network looks at.
        looks: number of different cells that the search visited to see which neighbours are free,
            the expanded ones included; None if it visited no others. Jump point search visits
            the cells that its scans pass.
    """

    path: npt.NDArray[np.integer[Any]]
    expansions: int
    prepared: int = 0
    looks: int | None = None

    def __repr__(self) -> str:
        return summary(self)


class Planner(Protocol):
    """Anything that plans a path on a grid.

    A planner takes terrain if its `plan_batch`, or its `plan` if it has no `plan_batch`, has a
    parameter ``terrain``: the costs of the cells, uint8 of the shape of the grid or grids, 0 where
    they are occupied. `evaluate` passes it by name, and only where problems have terrain.

    A planner for one rule of moves says so in an attribute ``movement``, a `Movement`: `evaluate`
    then refuses problems of another one.
    """

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


class Batched:
    """Base class of planners with `plan_batch`: it solves a single problem as a batch of one."""

    def plan(
        self: BatchPlanner,
        grid: npt.ArrayLike,
        start: npt.ArrayLike,
        goal: npt.ArrayLike,
        terrain: npt.ArrayLike | None = None,
    ) -> Plan:
        """Return the path from ``start`` to ``goal`` on ``grid``, (H, W).

        ``terrain``, (H, W), is for a `plan_batch` that takes it: the cost of each cell.
        """
        batch = np.asarray(grid)[None], np.array([start]), np.array([goal])
        terrain_argument: dict[str, Any] = {}
        if terrain is not None:
            terrain_argument["terrain"] = np.asarray(terrain)[None]
        return self.plan_batch(*batch, **terrain_argument)[0]


def evaluate(
    planners: Sequence[Planner],
    problems: ProblemSet,
    *,
    baseline: str | None = None,
    difference_from: str | None = None,
    bootstrap: int = 1000,
    seed: int = 0,
    progress: bool = False,
) -> pd.DataFrame:
    """Return the table of ``planners`` on ``problems``.

    Each planner has two rows: all problems, and the hard ones. L is the cost of a path and E the
    number of expansions. L* and E* are those of mapdata's A* (docs/format.md fixes its order) under
    the same movement; with ``baseline``, E* is that of another planner. A planner succeeds if its
    path leads from the start to the goal and `check_path` accepts it. Columns:

    - ``planner``; ``subset``, "all" or "hard" (hardness at least ``HARD``); ``n``, the number of
      problems in it.
    - ``success``: share of problems solved.
    - ``opt``: share of problems solved with L = L* (Neural A*'s Opt). Costs are compared exactly,
      and any path of this cost counts.
    - ``cost_ratio``: mean L / L* over the solved problems (TransPath), NaN if none is solved.
    - ``expansion_ratio``: mean E / E* (TransPath), over all problems, including the expansions of
      failures.
    - ``p_exp``: mean max(0, 1 - E / E*) (Neural A*'s Exp), over all problems.
    - ``hmean``: harmonic mean of ``opt`` and ``p_exp`` (Neural A*'s Hmean), 0 if both are 0.
    - ``regret``, on terrain only: mean L / L* - 1 over the solved problems.
    - ``prepared_ratio`` and ``look_ratio``: mean of `Plan.prepared` / E* and of `Plan.looks` / E*,
      over all problems. No other column counts these cells: the three ratios show what a planner
      does instead of expansions.
    - ``<name>_low``, ``<name>_high`` of the six (on terrain, seven) metrics: 95 % percentile
      interval over resampled problems, with the same resamples for all planners.
    - ``<name>_difference``, only with ``difference_from``: each of the six metrics minus that of
      the planner of this name, and the ends of its interval, ``<name>_difference_low`` and
      ``<name>_difference_high``. The resamples are the same for both (paired bootstrap).
    - ``ms``: milliseconds of a call of `plan`, which solves one problem: the median over problems.
    - ``ms_batched``: milliseconds a problem in calls of `plan_batch` with 64 problems: the median
      over calls, of all problems in both rows; NaN for a planner without it.
    - ``ms_low``, ``ms_high``, ``ms_batched_low``, ``ms_batched_high``: 95 % intervals of the two
      medians, from the ranks of the measured times. They are the smallest and the largest time
      where there are eight or fewer.

    Times are processor time of this process (`time.process_time`), the sum over its threads. So
    other programs on the machine hardly change them. They leave out what a planner only waits for,
    such as a GPU or another process. The first call of each planner is not timed. All columns but
    those of ``ms_batched`` are of `plan`.

    On terrain, L is the cost on the true terrain. A `Planner` that takes terrain receives it; any
    other one plans on the grid alone, as if all free cells cost the same. Nearly all problems on
    terrain are hard, so that its two rows are nearly the same. `score_paths` scores paths that were
    planned on predicted costs.

    A subset without problems has n = 0 and NaN elsewhere.

    Args:
        planners: the planners to compare, with different names;
            `mapdata.evaluation.planners.classical` returns the usual ones.
        problems: the problems to solve.
        baseline: name of the planner whose expansions are E*.
        difference_from: name of the planner whose metrics are subtracted from those of all
            planners. From "guided search, no network" of `classical`, the differences are what a
            network adds to its search.
        bootstrap: number of resamples.
        seed: of the resamples.
        progress: show a progress bar. It counts a problem once for each planner, and again for
            each planner with `plan_batch`.

    Raises:
        TypeError: ``problems`` are no `ProblemSet`; one of the planners has no ``name`` or no
            ``plan``; the answer of a planner is no `Plan`.
        ValueError: no planner, two of one name, none of the name ``baseline`` or
            ``difference_from``, no problem, no resample, a ``plan_batch`` with too few plans, or a
            planner whose attribute ``movement`` is another `Movement` than that of the problems.
        Exception: whatever a planner raises.

    Warns:
        UserWarning: none of the paths of a planner solves its problem (the message says why the
            first does not); or paths of its ``plan_batch`` cost something else than those of its
            ``plan``.
    """
    if not isinstance(problems, ProblemSet):
        raise TypeError(
            f"problems: got {type(problems).__name__}, expected a ProblemSet: "
            "mapdata.formats.read_problems(file) reads one, and ProblemSet.read(root) takes those "
            "of a dataset"
        )
    if hasattr(planners, "plan"):
        raise TypeError("planners: got one planner, expected a list of planners")
    for planner in planners:
        _check_planner(planner, problems.movement)
    names = [planner.name for planner in planners]
    if not names or len(set(names)) < len(names):
        raise ValueError(f"planners: got the names {names}, expected at least one and each once")
    if not len(problems):
        raise ValueError("problems: got none, expected at least one")
    check_count("bootstrap", bootstrap)
    if baseline is not None:
        check_choice("baseline", baseline, names)
    if difference_from is not None:
        check_choice("difference_from", difference_from, names)
    batch_planner_count = sum(isinstance(planner, BatchPlanner) for planner in planners)
    total = (len(planners) + batch_planner_count) * len(problems)
    with bar(progress, total, unit=" problems") as advance:
        runs = []
        for planner in planners:
            runs.append(_run(planner, problems, advance))
            _warn_of_paths(planner.name, runs[-1])
    reference_expansions: Floats | Ints = problems.optimal.iterations
    if baseline is not None:
        reference_expansions = runs[names.index(baseline)].expansions
    return _table(names, runs, problems, reference_expansions, bootstrap, seed, difference_from)


def _warn_of_paths(name: str, run: _Run) -> None:
    """Warn the caller of a public function of paths that make a row say little."""
    if run.first_fault and np.isnan(run.costs).all():
        warnings.warn(
            f"{name}: none of its paths solves its problem; the first is {run.first_fault}. A path "
            "is cells (row, col) from start to goal",
            stacklevel=3,
        )
    if run.other_costs_batched:
        warnings.warn(
            f"{name}: {run.other_costs_batched} of {len(run.costs)} paths of plan_batch cost "
            "something else than those of plan, from which all columns but ms_batched are",
            stacklevel=3,
        )


def _check_planner(planner: Planner, movement: Movement) -> None:
    """Refuse what is no planner, and a planner for another rule of moves than the problems have.

    Diagonal moves are illegal where four moves are allowed, so that such a planner would fail on
    nearly all problems, and its row would not say why.
    """
    if isinstance(planner, type):
        raise TypeError(f"planners: got the class {planner.__name__}, expected an object of it")
    for attribute in ("name", "plan"):
        if not hasattr(planner, attribute):
            raise TypeError(
                f"planners: got a {type(planner).__name__}, which has no {attribute!r}: expected "
                "planners, as mapdata.evaluation.classical() returns them, or "
                "mapdata.models.planners(model) for a path predictor"
            )
    planner_movement = getattr(planner, "movement", None)
    if isinstance(planner_movement, Movement) and planner_movement != movement:
        raise ValueError(
            f"planners: {planner.name} is for {planner_movement}, the problems for {movement}: "
            "give the movement of the planner to ProblemSet.sample or MapDataset as movement="
        )


def score_paths(
    problems: ProblemSet,
    paths: BatchResult | Sequence[npt.ArrayLike],
    *,
    name: str = "paths",
    bootstrap: int = 1000,
    seed: int = 0,
) -> pd.DataFrame:
    """Return the rows of `evaluate` for paths that are already planned.

    This is how costs that a model predicts from an image are scored: search on the predicted
    terrain, and score the paths on the true one. The rows can be joined with those of `evaluate` on
    the same problems by `pandas.concat`; with the same ``seed`` the resamples are the same.

    Args:
        problems: the problems.
        paths: what `mapdata.search_batch` returned for the problems, whose expansions count; or a
            path for each problem, (k, 2) cells or empty, whose columns of expansions are NaN.
        name: name of the rows.
        bootstrap: number of resamples.
        seed: of the resamples.

    Raises:
        ValueError: no problem, no resample, or another number of paths than of problems.

    Warns:
        UserWarning: none of the paths solves its problem.

    >>> import numpy as np
    >>> from mapdata import Movement, search_batch
    >>> movement = Movement(8, corner_cutting=True, diagonal_cost=1)
    >>> problems = ProblemSet.sample("tiles", maps=20, movement=movement, problems="route")
    >>> ends = problems.starts, problems.goals
    >>> predicted = np.full_like(problems.terrain, 50)  # a model that knows the mean cost alone
    >>> paths = search_batch("astar", problems.grids, *ends, movement, terrain=predicted)
    >>> bool(score_paths(problems, paths).regret[0] > 0.2)
    True
    """
    if not len(problems):
        raise ValueError("problems: got none, expected at least one")
    check_count("bootstrap", bootstrap)
    expansions = np.full(len(problems), np.nan)
    if isinstance(paths, BatchResult):
        expansions = paths.iterations.astype(np.float64)
        paths = paths.paths()
    if len(paths) != len(problems):
        raise ValueError(f"paths: got {len(paths)}, expected one for each of {len(problems)}")
    costs = np.empty(len(problems))
    first_fault = ""
    for k, path in enumerate(paths):
        costs[k], fault = _cost(path, problems, k)
        first_fault = first_fault or fault
    unknown = np.full(len(problems), np.nan)
    run = _Run(costs, first_fault, expansions, unknown, unknown, unknown, np.empty(0), 0)
    _warn_of_paths(name, run)
    return _table([name], [run], problems, problems.optimal.iterations, bootstrap, seed)


def median_interval(values: Floats) -> Floats:
    """Return the median of values, and the lower and the upper end of its 95 % interval, (3,).

    The ends are the values of ranks n / 2 - 0.98 sqrt(n) and 1 + n / 2 + 0.98 sqrt(n), rounded
    (Conover, Practical Nonparametric Statistics, section 3.2: half of all values lie below the true
    median, so the number of measured values below it is binomial). No distribution of the values is
    assumed. All three are NaN without values.
    """
    n = len(values)
    if n == 0:
        return np.full(3, np.nan)
    ascending = np.sort(values)
    half_width = 0.98 * np.sqrt(n)
    low_rank = max(round(n / 2 - half_width), 1)
    high_rank = min(round(1 + n / 2 + half_width), n)
    return np.array([np.median(values), ascending[low_rank - 1], ascending[high_rank - 1]])


def to_text(table: pd.DataFrame) -> str:
    """Return a table of `evaluate` as text: a block of all problems, and a block of the hard ones.

    Each metric and time is followed by half the width of its interval. The second block is left out
    if all problems are hard, because it would repeat the first one.
    """
    blocks = []
    all_are_hard = table["subset"].nunique() == 2 and table["n"].nunique() == 1
    if all_are_hard:
        table = table[table["subset"] == "all"]
    for subset, rows in table.groupby("subset", sort=False):
        text = pd.DataFrame({"planner": rows["planner"]})
        for metric in METRICS:
            text[metric] = with_interval(rows, metric)
        if "regret" in rows:
            text["regret"] = with_interval(rows, "regret", decimals=5)
        for name in ("prepared_ratio", "look_ratio"):
            text[name] = rows[name].map("{:.3f}".format)
        for name in TIMES:
            text[name] = with_interval(rows, name)
        heading = f"{subset}: {rows['n'].iloc[0]} problems"
        if subset == "hard" or all_are_hard:
            heading += f", hardness at least {HARD}"
        blocks.append(f"{heading}\n{text.to_string(index=False)}")
    return "\n\n".join(blocks)


def with_interval(rows: pd.DataFrame, metric: str, decimals: int = 3) -> pd.Series[str]:
    """Return a metric of each row as text, followed by half the width of its interval."""
    half_width = (rows[f"{metric}_high"] - rows[f"{metric}_low"]) / 2
    number = f"{{:.{decimals}f}}"
    return rows[metric].map(number.format) + half_width.map(f" ±{number}".format)


class _Run(NamedTuple):
    """The measurements of a planner on N problems.

    Attributes:
        costs: (N,) costs L of the paths, NaN for failures.
        first_fault: why the first path that does not solve its problem does not; empty if there is
            none.
        expansions: (N,) numbers of expansions E.
        prepared: (N,) numbers of prepared cells.
        looks: (N,) numbers of visited cells.
        ms: (N,) milliseconds that `plan` took.
        ms_batched: (K,) milliseconds a problem of K calls of `plan_batch`; (0,) without it.
        other_costs_batched: number of paths of `plan_batch` that cost something else than those of
            `plan`.
    """

    costs: Floats
    first_fault: str
    expansions: Floats
    prepared: Floats
    looks: Floats
    ms: Floats
    ms_batched: Floats
    other_costs_batched: int


def _table(
    names: Sequence[str],
    runs: Sequence[_Run],
    problems: ProblemSet,
    reference_expansions: Floats | Ints,
    bootstrap: int,
    seed: int,
    difference_from: str | None = None,
) -> pd.DataFrame:
    """Return the table of `evaluate` for the measurements of each planner.

    ``reference_expansions``, (N,), are E*.
    """
    outcomes = np.stack([_outcomes(run, problems, reference_expansions) for run in runs], axis=1)
    metric_names = list(METRICS)
    metrics_of = _metrics
    if difference_from is not None:
        other = names.index(difference_from)
        metric_names += [f"{name}_difference" for name in METRICS]

        def metrics_of(means: Floats) -> Floats:
            """Return the six metrics of all planners, and how far they are from those of one."""
            metrics = _metrics(means)
            return np.concatenate([metrics, metrics - metrics[..., [other], :]], axis=-1)

    if problems.has_terrain:
        metric_names.append("regret")
    rows = []
    for subset, mask in (("all", np.ones(len(problems), bool)), ("hard", problems.hard)):
        intervals = confidence_intervals(outcomes[mask], metrics_of, bootstrap, seed)
        regret = intervals[..., [METRICS.index("cost_ratio")]] - 1
        metrics, lows, highs = np.concatenate([intervals, regret], axis=-1)
        for k, run in enumerate(runs):
            row: dict[str, object] = {"planner": names[k], "subset": subset, "n": mask.sum()}
            for m, name in enumerate(metric_names):
                row[name] = metrics[k, m]
            for name, counts in (("prepared_ratio", run.prepared), ("look_ratio", run.looks)):
                ratios = counts[mask] / reference_expansions[mask]
                row[name] = ratios.mean() if mask.any() else np.nan
            times = {"ms": median_interval(run.ms[mask])}
            times["ms_batched"] = median_interval(run.ms_batched)
            for name, (median, _, _) in times.items():
                row[name] = median
            for m, name in enumerate(metric_names):
                row[f"{name}_low"] = lows[k, m]
                row[f"{name}_high"] = highs[k, m]
            for name, (_, low, high) in times.items():
                row[f"{name}_low"] = low
                row[f"{name}_high"] = high
            rows.append(row)
    return pd.DataFrame(rows)


def _takes_terrain(planner: Planner) -> bool:
    """Return whether a planner takes terrain, as `Planner` defines it."""
    method = planner.plan_batch if isinstance(planner, BatchPlanner) else planner.plan
    return "terrain" in inspect.signature(method).parameters


def _terrain_argument(planner: Planner, terrain: Bytes | None) -> dict[str, Any]:
    """Return terrain as an argument by name; none if there is none or it is not to be passed."""
    if terrain is None or not _takes_terrain(planner):
        return {}
    return {"terrain": terrain}


def _run(planner: Planner, problems: ProblemSet, advance: Advance) -> _Run:
    """Solve all problems with a planner, check its paths and measure its times.

    ``advance`` is called with numbers of solved problems.
    """
    costs = np.empty(len(problems))
    expansions = np.empty(len(problems))
    prepared = np.empty(len(problems))
    looks = np.empty(len(problems))
    ms = np.empty(len(problems))
    first_fault = ""
    # The first problem is solved twice, and the second time counts: the first call may compile
    # kernels and fill caches.
    for repetition, k in enumerate((0, *range(len(problems)))):
        start = tuple(problems.starts[k].tolist())
        goal = tuple(problems.goals[k].tolist())
        grid, terrain = _map_of(problems, k)  # copies, since a planner may write to them
        arguments = _terrain_argument(planner, terrain)
        began = time.process_time()
        plan = planner.plan(grid, start, goal, **arguments)
        ms[k] = 1000 * (time.process_time() - began)
        _check_plan(planner, plan)
        costs[k], fault = _cost(plan.path, problems, k)
        first_fault = first_fault or fault
        expansions[k] = plan.expansions
        prepared[k] = plan.prepared
        looks[k] = plan.expansions if plan.looks is None else plan.looks
        if repetition > 0:
            advance(1)
    ms_batched = np.empty(0)
    other_costs_batched = 0
    if isinstance(planner, BatchPlanner):
        ms_batched, batched_costs = _run_batched(planner, problems, advance)
        is_other_cost = ~np.isclose(batched_costs, costs, equal_nan=True)
        other_costs_batched = int(is_other_cost.sum())
    return _Run(
        costs, first_fault, expansions, prepared, looks, ms, ms_batched, other_costs_batched
    )


def _check_plan(planner: Planner, plan: object) -> None:
    """Check that a planner answered with a `Plan`, or with an object that has its fields.

    Raises:
        TypeError: it did not.
        ValueError: a number of cells is negative or not finite.
    """
    if not all(hasattr(plan, name) for name in Plan._fields):
        raise TypeError(
            f"{planner.name}: plan returned {type(plan).__name__}, expected a mapdata.Plan(path, "
            "expansions)"
        )
    for name in ("expansions", "prepared", "looks"):
        count = getattr(plan, name)
        if name == "looks" and count is None:
            continue
        if not 0 <= count < math.inf:
            raise ValueError(
                f"{planner.name}: {name}: got {count}, expected a number of cells, 0 or more"
            )


def _outcomes(run: _Run, problems: ProblemSet, reference_expansions: Floats | Ints) -> Floats:
    """Return five outcomes of each problem, (N, 5), whose means the metrics need.

    They are: whether it is solved, whether its path is optimal, L / L* (0 for failures), E / E* and
    max(0, 1 - E / E*). ``reference_expansions`` (N,) are E*.
    """
    optimal_costs = problems.optimal.cost
    is_solved = ~np.isnan(run.costs)
    is_optimal = run.costs == optimal_costs
    cost_ratio = np.where(is_solved, run.costs / optimal_costs, 0.0)
    expansion_ratio = run.expansions / reference_expansions
    saved = np.maximum(0, 1 - expansion_ratio)
    return np.column_stack([is_solved, is_optimal, cost_ratio, expansion_ratio, saved])


def _run_batched(
    planner: BatchPlanner, problems: ProblemSet, advance: Advance
) -> tuple[Floats, Floats]:
    """Solve all problems in batches, and measure times as `_run` does.

    Returns:
        The milliseconds a problem of each call of ``plan_batch``, and the costs of the paths, (N,),
        NaN for failures.

    Raises:
        ValueError: it returns another number of plans than it got problems.
    """
    ms = []
    costs = np.empty(len(problems))
    # The first batch is solved twice, and the second time counts, as in `_run`.
    for repetition, first in enumerate((0, *range(0, len(problems), _BATCH))):
        batch = slice(first, first + _BATCH)
        grids, terrain = problems.maps_of(batch)
        starts = problems.starts[batch].copy()
        goals = problems.goals[batch].copy()
        arguments = _terrain_argument(planner, terrain)
        began = time.process_time()
        plans = planner.plan_batch(grids, starts, goals, **arguments)
        ms.append(1000 * (time.process_time() - began) / len(starts))
        if len(plans) != len(starts):
            raise ValueError(
                f"{planner.name}: plan_batch gave {len(plans)} plans for {len(starts)} problems"
            )
        for k, plan in enumerate(plans, start=first):
            _check_plan(planner, plan)
            costs[k], _ = _cost(plan.path, problems, k)
        if repetition > 0:
            advance(len(plans))
    return np.array(ms[1:]), costs


def _map_of(problems: ProblemSet, k: int) -> tuple[Bytes, Bytes | None]:
    """Return copies of the grid and the terrain of problem ``k``, each (H, W)."""
    grids, terrains = problems.maps_of([k])
    return grids[0], None if terrains is None else terrains[0]


def _cost(path: npt.ArrayLike, problems: ProblemSet, k: int) -> tuple[float, str]:
    """Return the cost of ``path`` and an empty text.

    If it does not solve problem ``k``, return NaN and the reason, which is empty for no path.
    """
    grid, terrain = _map_of(problems, k)
    try:
        cells = np.asarray(path)
        if cells.size == 0:
            return np.nan, ""
        cost = check_path(grid, cells, problems.movement, terrain=terrain)
    except ValueError as error:
        return np.nan, f"that of problem {k}: {error}"
    start, goal = problems.starts[k], problems.goals[k]
    if np.array_equal(cells[0], start) and np.array_equal(cells[-1], goal):
        return cost, ""
    first, last = tuple(cells[0].tolist()), tuple(cells[-1].tolist())
    return np.nan, (
        f"that of problem {k}: from {first} to {last}, expected from {tuple(start.tolist())} to "
        f"{tuple(goal.tolist())}"
    )


def _metrics(means: Floats) -> Floats:
    """Return the six `METRICS` (..., 6) of mean outcomes (..., 5), those of `_outcomes`."""
    success, opt, cost_ratio_or_0, expansion_ratio, saved = np.moveaxis(means, -1, 0)
    with np.errstate(invalid="ignore"):
        # The mean over all problems, where failures count 0, becomes that over the solved ones:
        # 0 / 0 = NaN if none is solved.
        cost_ratio = cost_ratio_or_0 / success
        harmonic_mean = 2 * opt * saved / (opt + saved)
    hmean = np.where(opt + saved == 0, 0.0, harmonic_mean)
    return np.stack([success, opt, cost_ratio, expansion_ratio, saved, hmean], axis=-1)
