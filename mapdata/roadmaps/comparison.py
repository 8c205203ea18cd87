"""Samplers of roadmaps in one table: how often their roadmaps have a path, and how long it is.

The table of docs/samplers.md is made so:

    from mapdata import Movement, ProblemSet
    from mapdata.models import Heatmap
    from mapdata.roadmaps import compare, contenders, to_text

    rows = contenders({"lego_heatmap": Heatmap.pretrained()})
    problems = ProblemSet.sample("dungeon", seed=77, maps=1000, movement=Movement(8))
    print(to_text(compare(rows, problems)))
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
import pandas as pd

from mapdata.arrays import Bytes, Flags, Floats, Ints
from mapdata.evaluation import confidence_intervals, with_interval
from mapdata.plotting import PALETTE
from mapdata.problems import HARD, ProblemSet
from mapdata.roadmaps.roadmap import (
    NO_ROADMAPS_ON_TERRAIN,
    SAMPLERS,
    MapSampler,
    halton,
    path_lengths,
    uniform,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIZES = (24, 50, 100)
"""Numbers of vertices of a roadmap, without start and goal."""

DENSE = 2000
"""Number of vertices of the roadmap whose paths the lengths are compared with."""

DENSE_SEED = 10_000_019
"""First seed of the dense roadmaps, far from those of all samplers, which begin at 0."""

METRICS = ("success", "length_ratio")
"""Columns of the table that have an interval, from ``<name>_low`` to ``<name>_high``."""

BATCH = 50
"""Number of problems that a sampler gets at once."""

Contender = Callable[[Bytes, Ints, Ints, int, Sequence[int]], Floats]
"""A row of the table, which samples all vertices of roadmaps.

From grids (B, H, W), starts and goals (B, 2), n and B seeds to (B, n, 2) points in free cells.
"""


@runtime_checkable
class LearnedSampler(Protocol):
    """What `contenders` takes: anything with this method, such as a sampler of `mapdata.models`."""

    def sample_batch(
        self, grids: Bytes, starts: Ints, goals: Ints, n: int, seed: int = 0
    ) -> Floats:
        """Return (B, n, 2) points (row, column) in free cells.

        Args:
            grids: (B, H, W), 0 free and 1 occupied.
            starts: (B, 2), cells.
            goals: (B, 2), cells.
            n: number of points for each problem.
            seed: seed of all draws.
        """


def contenders(learned: Mapping[str, LearnedSampler]) -> dict[str, Contender]:
    """Return the rows of the table: the samplers that learn nothing, then the learned ones.

    Halton's points and uniform points have one row. Other samplers have two: in the row of its name
    half of the points are Halton's, as in LEGO, and in ``<name>_alone`` all points are its own.
    """
    samplers: dict[str, LearnedSampler | MapSampler] = {**SAMPLERS, **learned}
    rows: dict[str, Contender] = {}
    for name, sampler in samplers.items():
        if sampler in (halton, uniform):
            rows[name] = partial(sample_alone, sampler)
        else:
            rows[name] = partial(sample_half_halton, sampler)
            rows[f"{name}_alone"] = partial(sample_alone, sampler)
    return rows


def sample_alone(
    sampler: LearnedSampler | MapSampler,
    grids: Bytes,
    starts: Ints,
    goals: Ints,
    n: int,
    seeds: Sequence[int],
) -> Floats:
    """Return (B, n, 2) points of one sampler; without the first argument this is a `Contender`."""
    if isinstance(sampler, LearnedSampler):
        return sampler.sample_batch(grids, starts, goals, n, seeds[0])
    return np.stack([sampler(grid, n, seed) for grid, seed in zip(grids, seeds, strict=True)])


def sample_half_halton(
    sampler: LearnedSampler | MapSampler,
    grids: Bytes,
    starts: Ints,
    goals: Ints,
    n: int,
    seeds: Sequence[int],
) -> Floats:
    """Return (B, n, 2): Halton's points, then n // 2 points of a sampler.

    Without the first argument this is a `Contender`.
    """
    first = sample_alone(halton, grids, starts, goals, n - n // 2, seeds)
    second = sample_alone(sampler, grids, starts, goals, n // 2, seeds)
    return np.concatenate([first, second], axis=1)


# --- the table ----------------------------------------------------------------------------------


def compare(
    rows: Mapping[str, Contender],
    problems: ProblemSet,
    sizes: Sequence[int] = SIZES,
    *,
    bootstrap: int = 1000,
    seed: int = 0,
) -> pd.DataFrame:
    """Return the table: for each size and sampler a row for all problems and one for the hard ones.

    Columns:

    - ``sampler``: its name.
    - ``subset``: "all" or "hard"; in a hard problem the hardness on the grid is at least ``HARD``.
    - ``n``: number of vertices of the roadmap, without start and goal.
    - ``problems``: number of problems in the subset.
    - ``success``: share of the problems whose roadmap joins start and goal.
    - ``length_ratio``: length of the path over its length on a Halton roadmap of ``DENSE``
      vertices, the mean over the problems that have a path on both; NaN without such problems.
    - ``<name>_low``, ``<name>_high`` of both: a 95 % percentile interval over resampled problems;
      all rows have the same resamples.
    - ``ms``: processor time of this process to sample the points of a problem, in milliseconds: the
      median over batches of the time of a batch over its number of problems.

    Args:
        rows: the samplers, by name.
        problems: the problems that the roadmaps are to solve.
        sizes: numbers of vertices of a roadmap, at least 2.
        bootstrap: number of resamples.
        seed: seed of the resamples.

    Raises:
        ValueError: no sampler, problem, size or resample, a size below 2, or problems on terrain.
    """
    if problems.terrain is not None:
        raise ValueError(NO_ROADMAPS_ON_TERRAIN)
    if not rows or not len(problems) or not sizes or min(sizes) < 2 or bootstrap < 1:
        raise ValueError(
            "expected at least one sampler, problem and resample, and sizes of 2 or more"
        )
    # With seeds of their own, since no sampler should be compared with a roadmap of its points.
    dense, _ = _lengths(partial(sample_alone, halton), problems, DENSE, DENSE_SEED)
    subsets = {"all": np.ones(len(problems), bool), "hard": problems.hard}
    entries = []
    outcomes = []
    for n in sizes:
        for name, contender in rows.items():
            lengths, ms = _lengths(contender, problems, n)
            for subset, mask in subsets.items():
                row = {"sampler": name, "subset": subset, "n": n, "problems": mask.sum(), "ms": ms}
                entries.append(row)
                outcomes.append(_outcomes(lengths, dense, mask))
    estimates, lows, highs = confidence_intervals(
        np.stack(outcomes, axis=1), _metrics, bootstrap, seed
    )
    table = pd.DataFrame(entries)
    for ending, metrics in (("", estimates), ("_low", lows), ("_high", highs)):
        table[[f"{metric}{ending}" for metric in METRICS]] = metrics
    return table


def _lengths(
    contender: Contender, problems: ProblemSet, n: int, first_seed: int = 0
) -> tuple[Floats, float]:
    """Return path lengths (N,), inf without a path, and milliseconds of sampling a problem."""
    lengths = []
    ms = []
    seeds = range(first_seed, first_seed + len(problems))
    for k in range(0, len(problems), BATCH):
        batch = slice(k, k + BATCH)
        grids = problems.grids[batch]
        starts = problems.starts[batch]
        goals = problems.goals[batch]
        started = time.process_time()
        points = contender(grids, starts, goals, n, seeds[batch])
        ms.append(1000 * (time.process_time() - started) / len(starts))
        lengths.append(path_lengths(grids, starts, goals, points))
    return np.concatenate(lengths), float(np.median(ms))


def _outcomes(lengths: Floats, dense: Floats, subset: Flags) -> Floats:
    """Return what `_metrics` needs of each problem, (N, 4), 0 for problems outside the subset.

    Columns: in the subset; solved; solved on the dense roadmap, too; the ratio of both lengths.
    """
    solved = subset & np.isfinite(lengths)
    both = solved & np.isfinite(dense)
    ratios = np.divide(lengths, dense, out=np.zeros_like(lengths), where=both)
    return np.column_stack([subset, solved, both, ratios])


def _metrics(means: Floats) -> Floats:
    """Return success and length ratio (..., 2) of the means of `_outcomes`, (..., 4)."""
    subset, solved, both, ratios = np.moveaxis(means, -1, 0)
    with np.errstate(invalid="ignore"):  # 0 / 0 is NaN where a resample has no such problem
        return np.stack([solved / subset, ratios / both], axis=-1)


def to_text(table: pd.DataFrame) -> str:
    """Return the table for a terminal: a block for each subset, a line for each sampler."""
    blocks = []
    for subset, rows in table.groupby("subset", sort=False):
        text = {metric: with_interval(rows, metric) for metric in METRICS}
        by_size = rows.assign(**text).pivot(index="sampler", columns="n", values=[*METRICS])
        # A pivot sorts its rows by name; they should keep the order of the table.
        lines = by_size.loc[rows["sampler"].unique()].to_string()
        condition = f", hardness at least {HARD}" if subset == "hard" else ""
        blocks.append(f"{subset}: {rows['problems'].iloc[0]} problems{condition}\n{lines}")
    return "\n\n".join(blocks)


# --- figures ------------------------------------------------------------------------------------


def plot_success(table: pd.DataFrame, axes: Axes, subset: str = "hard") -> Axes:
    """Draw success against the number of vertices: for each sampler a line with its intervals."""
    names = table["sampler"].unique()
    rows = table[table["subset"] == subset].pivot(index="n", columns="sampler")
    success = rows["success"][names]
    below = success - rows["success_low"][names]
    above = rows["success_high"][names] - success
    success.plot(
        ax=axes,
        yerr=np.stack([below.T, above.T], axis=1).clip(min=0),
        color=[*PALETTE],
        marker="o",
        xlabel="vertices of the roadmap",
        ylabel="share of problems solved",
        title=f"{subset} problems",
        xticks=[*rows.index],
        grid=True,
    )
    return axes
