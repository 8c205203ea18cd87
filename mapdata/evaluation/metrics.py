"""Compare planners: the metrics of Neural A* and TransPath for anything that plans, in one table.

Neural A*: Yonetani et al., ICML 2021, https://arxiv.org/abs/2009.07476.
TransPath: Kirilenko et al., AAAI 2023, https://arxiv.org/abs/2212.11730.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
import pandas as pd

from mapdata.arrays import Flags, Floats, Ints
from mapdata.checks import check_choice, check_count, check_seed
from mapdata.describe.intervals import confidence_intervals
from mapdata.evaluation.plan import BatchPlanner, Planner
from mapdata.evaluation.runs import (
    Run,
    call_untimed,
    cell_count,
    cost_of_path,
    first_refusal,
    run_planner,
)
from mapdata.movement import Movement
from mapdata.problems.problem_set import ProblemSet
from mapdata.search.api import BatchResult
from mapdata.search.lattice import HARD
from mapdata.shards.workers import bar

METRICS = ("success", "opt", "cost_ratio", "expansion_ratio", "p_exp", "hmean")
"""Columns of the table that have an interval, from ``<name>_low`` to ``<name>_high``."""

TERRAIN_METRICS = (*METRICS, "regret")
"""The same for problems on terrain."""

TIMES = ("ms", "ms_batched")
"""Columns of the table that are times. They have an interval, too."""


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
        call_untimed(planner, problems)
    with bar(progress, total, unit=" problems") as advance:
        runs = []
        for planner in planners:
            runs.append(run_planner(planner, problems, advance))
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


def _warn_of_paths(name: str, run: Run) -> None:
    """Warn the caller of a public function of paths that make a row say little."""
    if run.refusals and np.isnan(run.costs).all():
        warnings.warn(
            f"{name}: none of its paths solves its problem; the first is that of "
            f"{first_refusal(run.refusals)}. A path is cells (row, col) from start to goal",
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
        expansions = np.array([cell_count("paths: iterations", count) for count in counts])
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
        costs[k], reason = cost_of_path(path, problems, k)
        if reason:
            refusals[k] = reason
    unknown = np.full(len(problems), np.nan)
    run = Run(costs, refusals, expansions, unknown, unknown, unknown, np.empty(0), 0)
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


def _table(
    names: Sequence[str],
    runs: Sequence[Run],
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
        with_regret = np.concatenate([intervals, regret], axis=-1)
        for k, run in enumerate(runs):
            intervals_of_row = {name: with_regret[:, k, m] for m, name in enumerate(metric_names)}
            intervals_of_row["ms"] = median_interval(run.ms[mask])
            intervals_of_row["ms_batched"] = median_interval(run.ms_batched)
            rows.append(_Row(names[k], subset, mask, run, reference_expansions, intervals_of_row))
    columns: list[_Column] = [
        ("planner", lambda row: row.planner),
        ("subset", lambda row: row.subset),
        ("n", lambda row: row.mask.sum()),
        *(_interval_column(name, "") for name in metric_names),
        ("refused", lambda row: len(row.refusals)),
        ("first_refused", lambda row: first_refusal(row.refusals)),
        ("prepared_ratio", lambda row: row.mean_ratio(row.run.prepared)),
        ("look_ratio", lambda row: row.mean_ratio(row.run.looks)),
        *(_interval_column(name, "") for name in TIMES),
        *(
            _interval_column(name, end)
            for name in (*metric_names, *TIMES)
            for end in ("_low", "_high")
        ),
    ]
    return pd.DataFrame({name: [value_of(row) for row in rows] for name, value_of in columns})


class _Row(NamedTuple):
    """What a row of the table is computed from.

    Attributes:
        planner: name of the planner.
        subset: name of the subset of the problems.
        mask: (N,) whether each problem is in the subset.
        run: the measurements of the planner on all problems.
        reference_expansions: (N,) E*.
        intervals: (3,) of each metric and time in the subset: its value, and the lower and the
            upper end of its interval.
    """

    planner: str
    subset: str
    mask: Flags
    run: Run
    reference_expansions: Floats | Ints
    intervals: Mapping[str, Floats]

    @property
    def refusals(self) -> dict[int, str]:
        """Why paths are refused, by the number of their problem."""
        return {k: reason for k, reason in self.run.refusals.items() if self.mask[k]}

    def mean_ratio(self, counts: Floats) -> float:
        """Return the mean of ``counts``, (N,) numbers of cells, over E*; NaN without problems."""
        if not self.mask.any():
            return float("nan")
        return float((counts[self.mask] / self.reference_expansions[self.mask]).mean())


_Column: TypeAlias = tuple[str, Callable[[_Row], object]]
"""The name of a column of the table, and the function that returns its value in a row."""


def _interval_column(name: str, end: str) -> _Column:
    """Return the column of a metric or time (end ""), or of an end of its interval."""
    place = ("", "_low", "_high").index(end)
    return name + end, lambda row: row.intervals[name][place]


def _outcomes(run: Run, problems: ProblemSet, reference_expansions: Floats | Ints) -> Floats:
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
