"""Samplers of roadmaps in one table: how often their roadmaps have a path, and how long it is.

from mapdata import MapSpec, Problems
from models.lego.sampler import Heatmap
from models.lego.comparison import compare, contenders, to_text

rows = contenders({"lego_heatmap": Heatmap.load("models/weights/lego_heatmap.pt")})
problems = Problems.sample(MapSpec.preset("dungeon"), seed=77, maps=1000)
print(to_text(compare(rows, problems)))
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from pytorch_lightning import Callback, LightningModule, Trainer

from mapdata.arrays import Bytes, Flags, Floats, Ints
from mapdata.evaluation import confidence_intervals, with_interval
from mapdata.plotting import PALETTE
from mapdata.problems import HARD, Problems
from models.lego.roadmap import SAMPLERS, Points, halton, path_lengths, uniform
from models.lego.sampler import Sampler

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIZES = (24, 50, 100)
"""Vertices of a roadmap, without start and goal."""

DENSE = 2000
"""Vertices of the roadmap whose paths the lengths are compared with."""

METRICS = ("success", "length_ratio")
"""Columns of the table that have an interval, from ``<name>_low`` to ``<name>_high``."""

BATCH = 50
"""Problems that a sampler gets at once."""

Contender = Callable[[Bytes, Ints, Ints, int, Sequence[int]], Floats]
"""All vertices of roadmaps: of grids (B, H, W), starts and goals (B, 2), n and B seeds, (B, n, 2)
points in free cells."""


def contenders(learned: Mapping[str, Sampler]) -> dict[str, Contender]:
    """Return the rows of the table: the samplers that learn nothing, then the learned ones.

    Each but Halton's and uniform points has two: under its name together with as many of Halton's,
    as in LEGO, and as ``<name>_alone``.
    """
    sources: dict[str, Sampler | Points] = {**SAMPLERS, **learned}
    rows: dict[str, Contender] = {}
    for name, source in sources.items():
        if source in (halton, uniform):
            rows[name] = partial(alone, source)
        else:
            rows[name] = partial(half_halton, source)
            rows[f"{name}_alone"] = partial(alone, source)
    return rows


def alone(
    source: Sampler | Points, grids: Bytes, starts: Ints, goals: Ints, n: int, seeds: Sequence[int]
) -> Floats:
    """Return what a `Contender` does: the points of one sampler."""
    if isinstance(source, Sampler):
        return source.sample_batch(grids, starts, goals, n, seeds[0])
    return np.stack([source(grid, n, seed) for grid, seed in zip(grids, seeds, strict=True)])


def half_halton(
    source: Sampler | Points, grids: Bytes, starts: Ints, goals: Ints, n: int, seeds: Sequence[int]
) -> Floats:
    """Return what a `Contender` does: half of the points are Halton's, in front."""
    spread = alone(halton, grids, starts, goals, n - n // 2, seeds)
    return np.concatenate([spread, alone(source, grids, starts, goals, n // 2, seeds)], axis=1)


class RoadmapSuccess(Callback):
    """Logs ``val_success``: the share of problems that roadmaps of 50 vertices solve.

    The roadmaps are those of the table, by `half_halton`.
    """

    def on_validation_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, *_: int
    ) -> None:
        """Build the roadmaps of one batch."""
        assert isinstance(pl_module, Sampler)
        fields = (batch.map[:, 0], batch.start, batch.goal)
        grids, starts, goals = (field.cpu().numpy() for field in fields)
        points = half_halton(pl_module, grids, starts, goals, 50, range(len(grids)))
        solved = np.isfinite(path_lengths(grids, starts, goals, points))
        pl_module.log("val_success", solved.mean(), batch_size=len(grids), prog_bar=True)


# --- the table ----------------------------------------------------------------------------------


def compare(
    rows: Mapping[str, Contender],
    problems: Problems,
    sizes: Sequence[int] = SIZES,
    *,
    bootstrap: int = 1000,
    seed: int = 0,
) -> pd.DataFrame:
    """Return the table: for each size two rows a sampler, all problems and the hard ones.

    Columns: ``sampler``; ``subset``, "all" or "hard" (hardness of the grid problem at least
    ``HARD``); ``n``, vertices of the roadmap; ``problems``, how many are in the subset;
    ``success``, the share whose roadmap joins start and goal; ``length_ratio``, the mean over those
    of the path's length to that on a Halton roadmap of ``DENSE`` vertices (a problem that has none
    there is left out), NaN where there is none; of both ``<name>_low``, ``<name>_high``, a 95 %
    percentile interval over resampled problems, the same resamples for all; ``ms``, milliseconds a
    problem to sample.

    Args:
        rows: the samplers, by name.
        problems: on what.
        sizes: vertices of a roadmap, at least 2.
        bootstrap: number of resamples.
        seed: of the resamples.

    Raises:
        ValueError: no sampler, problem, size or resample, or a size below 2.
    """
    if not rows or not len(problems) or not sizes or min(sizes) < 2 or bootstrap < 1:
        raise ValueError(
            "expected at least one sampler, problem and resample, and sizes of 2 or more"
        )
    # seeds of their own: no sampler is compared with a roadmap that holds its points
    dense, _ = _lengths(partial(alone, halton), problems, DENSE, 10_000_019)
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
    found = confidence_intervals(np.stack(outcomes, axis=1), _metrics, bootstrap, seed)
    table = pd.DataFrame(entries)
    for ending, values in zip(("", "_low", "_high"), found, strict=True):
        table[[f"{metric}{ending}" for metric in METRICS]] = values
    return table


def _lengths(
    contender: Contender, problems: Problems, n: int, first_seed: int = 0
) -> tuple[Floats, float]:
    """Return path lengths (N,), inf without a path, and the milliseconds a problem to sample."""
    found = []
    seconds = 0.0
    seeds = range(first_seed, first_seed + len(problems))
    for k in range(0, len(problems), BATCH):
        part = slice(k, k + BATCH)
        given = problems.grids[part], problems.starts[part], problems.goals[part]
        began = time.perf_counter()
        points = contender(*given, n, seeds[part])
        seconds += time.perf_counter() - began
        found.append(path_lengths(*given, points))
    return np.concatenate(found), 1000 * seconds / len(problems)


def _outcomes(lengths: Floats, dense: Floats, subset: Flags) -> Floats:
    """Return (N, 4): in the subset, solved, solved on both roadmaps, the ratio of lengths or 0."""
    solved = subset & np.isfinite(lengths)
    both = solved & np.isfinite(dense)
    ratios = np.divide(lengths, dense, out=np.zeros_like(lengths), where=both)
    return np.column_stack([subset, solved, both, ratios])


def _metrics(means: Floats) -> Floats:
    """Return success and length ratio (..., 2) of mean outcomes (..., 4)."""
    subset, solved, both, ratios = np.moveaxis(means, -1, 0)
    with np.errstate(invalid="ignore"):
        return np.stack([solved / subset, ratios / both], axis=-1)


def to_text(table: pd.DataFrame) -> str:
    """Return the table for a terminal: a block a subset, a line a sampler."""
    blocks = []
    for subset, rows in table.groupby("subset", sort=False):
        text = {metric: with_interval(rows, metric) for metric in METRICS}
        shown = rows.assign(**text).pivot(index="sampler", columns="n", values=[*METRICS])
        lines = shown.loc[rows["sampler"].unique()].to_string()
        which = f", hardness at least {HARD}" if subset == "hard" else ""
        blocks.append(f"{subset}: {rows['problems'].iloc[0]} problems{which}\n{lines}")
    return "\n\n".join(blocks)


# --- figures ------------------------------------------------------------------------------------


def plot_success(table: pd.DataFrame, axes: Axes, subset: str = "hard") -> Axes:
    """Draw success against the number of vertices, a line a sampler, with its interval."""
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
