"""Compare planners: the metrics of Neural A* and TransPath for anything that plans, in one table.

Neural A*: Yonetani et al., ICML 2021, https://arxiv.org/abs/2009.07476.
TransPath: Kirilenko et al., AAAI 2023, https://arxiv.org/abs/2212.11730.
"""

from __future__ import annotations

import inspect
import math
import sys
import time
import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
import pandas as pd

from mapdata.arrays import Bytes, Floats, Ints, summary
from mapdata.checks import check_choice, check_count, check_number, check_seed
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
        order: (H, W) int32, the number of the expansion of each cell, -1 for cells that were not
            expanded, for `mapdata.plotting.plot_search`; None if the planner does not say.
    """

    path: npt.NDArray[np.integer[Any]]
    expansions: int
    prepared: int = 0
    looks: int | None = None
    order: npt.NDArray[np.integer[Any]] | None = None

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
    - ``refused``: number of paths that are refused; the other failures are problems for which the
      planner found no path. ``first_refused``: the number of the first of these problems and why
      its path is refused, as text; empty if there is none.
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
    such as a GPU or another process. All columns but those of ``ms_batched`` are of `plan`.

    At first each planner, in their order, solves the first problem, and with `plan_batch` the first
    64. These calls are not timed, since they may compile kernels and fill caches, and they show
    errors of a planner before the long work begins.

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
        progress: show a progress bar after the first calls. It counts a problem once for each
            planner, and again for each planner with `plan_batch`.

    Raises:
        TypeError: ``problems`` are no `ProblemSet`; ``planners`` is no list; one of them has no
            ``name``, or one that is no text, or no ``plan``; the answer of a planner is no `Plan`,
            or that of its ``plan_batch`` no list.
        ValueError: no planner, two of one name, none of the name ``baseline`` or
            ``difference_from``, a ``baseline`` that expands no cell, no problem, no resample, a
            ``plan_batch`` with too few plans, a number of cells that is negative or no number, or a
            planner whose attribute ``movement`` is another `Movement` than that of the problems.
        Exception: whatever a planner raises, with a note that names the planner and the problem.

    Warns:
        UserWarning: none of the paths of a planner solves its problem (the message says why the
            first does not); or paths of its ``plan_batch`` cost something else than those of its
            ``plan``.
    """
    _check_problems(problems)
    if hasattr(planners, "plan"):
        raise TypeError("planners: got one planner, expected a list of planners")
    if not isinstance(planners, Iterable):
        raise TypeError(f"planners: got {type(planners).__name__}, expected a list of planners")
    planners = list(planners)
    if not planners:
        raise ValueError("planners: got none, expected at least one")
    for planner in planners:
        _check_planner(planner, problems.movement)
    names = [planner.name for planner in planners]
    repeated_names = [name for name in dict.fromkeys(names) if names.count(name) > 1]
    if repeated_names:
        raise ValueError(
            f"planners: several are named {', '.join(repeated_names)}, expected different names"
        )
    check_count("bootstrap", bootstrap)
    check_seed(seed)
    if baseline is not None:
        check_choice("baseline", baseline, names)
    if difference_from is not None:
        check_choice("difference_from", difference_from, names)
    batch_planner_count = sum(isinstance(planner, BatchPlanner) for planner in planners)
    total = (len(planners) + batch_planner_count) * len(problems)
    for planner in planners:
        _call_untimed(planner, problems)
    with bar(progress, total, unit=" problems") as advance:
        runs = []
        for planner in planners:
            runs.append(_run(planner, problems, advance))
            _warn_of_paths(planner.name, runs[-1])
    reference_expansions: Floats | Ints = problems.optimal.iterations
    if baseline is not None:
        reference_expansions = runs[names.index(baseline)].expansions
        if not reference_expansions.all():
            k = int(np.argmin(reference_expansions))
            raise ValueError(
                f"baseline: {baseline} expanded no cell on problem {k}, expected at least one on "
                "each problem; choose another baseline"
            )
    return _table(names, runs, problems, reference_expansions, bootstrap, seed, difference_from)


def _check_problems(problems: ProblemSet) -> None:
    """Refuse what is no problem set, and a set without problems."""
    if not isinstance(problems, ProblemSet):
        raise TypeError(
            f"problems: got {type(problems).__name__}, expected a ProblemSet: "
            "mapdata.formats.read_problems(file) reads one, and ProblemSet.read(root) takes those "
            "of a dataset"
        )
    if not len(problems):
        raise ValueError("problems: got none, expected at least one")


def _warn_of_paths(name: str, run: _Run) -> None:
    """Warn the caller of a public function of paths that make a row say little."""
    if run.refusals and np.isnan(run.costs).all():
        warnings.warn(
            f"{name}: none of its paths solves its problem; the first is that of "
            f"{_first_refusal(run.refusals)}. A path is cells (row, col) from start to goal",
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
    if not isinstance(planner.name, str):
        raise TypeError(
            f"planners: the name of a {type(planner).__name__} is {planner.name!r}, expected text"
        )
    for method in ("plan", "plan_batch"):
        if not callable(getattr(planner, method, evaluate)):
            raise TypeError(f"planners: {planner.name}: {method} is no method")
    planner_movement = getattr(planner, "movement", None)
    if isinstance(planner_movement, Movement) and planner_movement != movement:
        raise ValueError(
            f"planners: {planner.name} is for {planner_movement}, the problems for {movement}: "
            "give the movement of the planner to ProblemSet.sample or MapDataset as movement=, or "
            "to a command by --connectivity, --corner-cutting and --diagonal-cost"
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
        TypeError: ``problems`` are no `ProblemSet`, ``paths`` no list of paths, ``name`` no text.
        ValueError: no problem, no resample, another number of paths than of problems, or a number
            of expansions that is negative or no number.

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
    _check_problems(problems)
    if not isinstance(name, str):
        raise TypeError(f"name: got {name!r}, expected text")
    check_count("bootstrap", bootstrap)
    check_seed(seed)
    expansions = np.full(len(problems), np.nan)
    if isinstance(paths, BatchResult):
        counts = paths.iterations
        paths = paths.paths()
        if np.shape(counts) != (len(paths),):
            raise ValueError(
                f"paths: got iterations of shape {np.shape(counts)} for {len(paths)} paths, "
                "expected one number for each"
            )
        expansions = np.array([_cell_count("paths: iterations", count) for count in counts])
    if not hasattr(paths, "__len__") or isinstance(paths, (str, Mapping)):
        raise TypeError(
            f"paths: got {type(paths).__name__}, expected what search_batch returns or a list of "
            "paths"
        )
    if len(paths) != len(problems):
        raise ValueError(f"paths: got {len(paths)}, expected one for each of {len(problems)}")
    costs = np.empty(len(problems))
    refusals = {}
    for k, path in enumerate(paths):
        costs[k], reason = _cost(path, problems, k)
        if reason:
            refusals[k] = reason
    unknown = np.full(len(problems), np.nan)
    run = _Run(costs, refusals, expansions, unknown, unknown, unknown, np.empty(0), 0)
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


def to_text(table: pd.DataFrame, columns: Sequence[str] | None = None) -> str:
    """Return a table of `evaluate` as text: a block of all problems, and a block of the hard ones.

    Each metric and time is followed by half the width of its interval. The second block is left out
    if all problems are hard, because it would repeat the first one.

    Args:
        table: what `evaluate` returns.
        columns: names of the columns beside that of the planner, of those of a number for each
            planner; all by default.

    Raises:
        ValueError: there is no such column.
    """
    blocks = []
    metrics = TERRAIN_METRICS if "regret" in table else METRICS
    known_columns = (*metrics, "prepared_ratio", "look_ratio", *TIMES)
    for name in columns or ():
        check_choice("columns", name, known_columns)
    all_are_hard = table["subset"].nunique() == 2 and table["n"].nunique() == 1
    if all_are_hard:
        table = table[table["subset"] == "all"]
    for subset, rows in table.groupby("subset", sort=False):
        text = pd.DataFrame({"planner": rows["planner"]})
        for name in columns or known_columns:
            if name in ("prepared_ratio", "look_ratio"):
                text[name] = rows[name].map("{:.3f}".format)
            else:
                text[name] = with_interval(rows, name, decimals=5 if name == "regret" else 3)
        heading = f"{subset}: {rows['n'].iloc[0]} problems"
        if subset == "hard" or all_are_hard:
            heading += f", hardness at least {HARD}"
        blocks.append(f"{heading}\n{text.to_string(index=False)}")
    return "\n\n".join(blocks)


def with_interval(rows: pd.DataFrame, metric: str, decimals: int = 3) -> pd.Series[str]:
    """Return a metric of each row as text, followed by half the width of its interval; or "-"."""
    half_width = (rows[f"{metric}_high"] - rows[f"{metric}_low"]) / 2
    number = f"{{:.{decimals}f}}"
    text = rows[metric].map(number.format) + half_width.map(f" ±{number}".format)
    return text.where(rows[metric].notna(), "-")


class _Run(NamedTuple):
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
            refusals = {number: run.refusals[number] for number in run.refusals if mask[number]}
            row["refused"] = len(refusals)
            row["first_refused"] = _first_refusal(refusals)
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


def _call_untimed(planner: Planner, problems: ProblemSet) -> None:
    """Solve the first problem with a planner, and the first batch with its `plan_batch`."""
    _timed_plan(planner, problems, 0)
    if isinstance(planner, BatchPlanner):
        _timed_batch(planner, problems, 0)


def _run(planner: Planner, problems: ProblemSet, advance: Advance) -> _Run:
    """Solve all problems with a planner, check its paths and measure its times.

    ``advance`` is called with numbers of solved problems.
    """
    costs = np.empty(len(problems))
    refusals = {}
    expansions = np.empty(len(problems))
    prepared = np.empty(len(problems))
    looks = np.empty(len(problems))
    ms = np.empty(len(problems))
    for k in range(len(problems)):
        plan, ms[k] = _timed_plan(planner, problems, k)
        costs[k], reason = _cost(plan.path, problems, k)
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
    return _Run(costs, refusals, expansions, prepared, looks, ms, ms_batched, other_costs_batched)


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
            _cell_count(f"{planner.name}: {name}", count)


def _cell_count(name: str, count: object) -> float:
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
    """
    ms = []
    costs = np.empty(len(problems))
    for first in range(0, len(problems), _BATCH):
        plans, batch_ms = _timed_batch(planner, problems, first)
        ms.append(batch_ms / len(plans))
        for k, plan in enumerate(plans, start=first):
            costs[k], _ = _cost(plan.path, problems, k)
        advance(len(plans))
    return np.array(ms), costs


def _map_of(problems: ProblemSet, k: int) -> tuple[Bytes, Bytes | None]:
    """Return copies of the grid and the terrain of problem ``k``, each (H, W)."""
    grids, terrains = problems.maps_of([k])
    return grids[0], None if terrains is None else terrains[0]


def _cost(path: npt.ArrayLike | None, problems: ProblemSet, k: int) -> tuple[float, str]:
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


def _first_refusal(refusals: Mapping[int, str]) -> str:
    """Return the number of the first problem whose path is refused, and why; "" without one."""
    for number, reason in refusals.items():
        return f"problem {number}: {reason}"
    return ""


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
