"""Figures of a whole dataset, and what ``mapdata show`` draws."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, cast

import numpy as np

from mapdata.arrays import Flags, Floats
from mapdata.checks import check_choice
from mapdata.describe.dataset_card import counted
from mapdata.describe.statistics import DatasetStatistics, bin_edges, dataset_statistics
from mapdata.plotting.plot import (
    COLOURS,
    new_axes,
    plot_grid,
    plot_map,
    plot_matrix,
    plot_path,
    same_matrices,
)
from mapdata.search.api import SEARCHES
from mapdata.shards.locations import Locations
from mapdata.shards.root import Root

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def pick_examples(of: DatasetStatistics) -> dict[str, int]:
    """Return examples as the paper's Figure 2 has them: a caption and the number of a map each.

    They are maps with few to many rooms, one that is not connected (some rooms do not reach each
    other), one that is redundant (all rooms reach each other though a passage was not drawn: others
    or overlapping rooms stand in), one with the most rooms (nine in the paper) and the one with the
    hardest segment. Each is the first such map of the dataset that is not shown yet; a kind that
    does not occur is left out. Where all maps have equally many rooms, as many imported ones, they
    go from easy to hard instead.
    """
    examples: dict[str, int] = {}

    def add(caption: str, which: Flags) -> None:
        """Take the first map of a kind that is not shown yet."""
        unseen = which & ~np.isin(of.index, list(examples.values()))
        if caption not in examples and unseen.any():
            examples[caption] = int(of.index[unseen.argmax()])

    *fewer, most = np.unique(of.rooms).tolist() or [0]
    if fewer:
        for n in np.quantile(fewer, np.linspace(0, 1, 4), method="nearest"):
            add(counted(int(n), of.noun), of.all_connected & (of.rooms == n))
    add("not connected", ~of.all_connected)
    add("redundant", of.redundant)
    add(counted(most, of.noun), of.rooms == most)
    if len(of) and not fewer:
        marks = np.quantile(of.hardest, (0.1, 0.3, 0.5, 0.7, 0.9), method="nearest")
        for mark in marks:
            add(f"hardness {mark:.2f}", of.hardest == mark)
    hardest = of.hardest.max(initial=0)
    if hardest > 1:
        add(f"hardness {hardest:.2f}", of.hardest == hardest)
    return examples


def plot_gallery(
    of: DatasetStatistics, axes: Sequence[Axes] | None = None, *, paper_colours: bool = False
) -> list[Axes]:
    """Draw the examples of `pick_examples` with their seeds: the paper's Figure 2.

    Args:
        of: what `dataset_statistics` returns.
        axes: where to draw, one an example; a new figure without. Those left over are switched off.
        paper_colours: free black, occupied white.
    """
    examples = pick_examples(of)
    if axes is None:
        count = max(len(examples), 1)
        columns = min(count, 4)
        rows = math.ceil(count / columns)
        high, wide = of.root.map_size
        axes = new_axes(rows, columns, (2.6 * columns, 2.85 * rows * min(high / wide, 3) + 0.5))
    for ax, (caption, index) in zip(axes, examples.items(), strict=False):
        labels, i = of.root.locate(index)
        plot_grid(labels.maps.occupancy[i], ax, paper_colours=paper_colours)
        seed_points = labels.maps.seed_points[i, : labels.maps.rooms[i]]
        ax.plot(seed_points[:, 1], seed_points[:, 0], "o", color=COLOURS["seed"], mec="white", ms=6)
        ax.set(xlabel="", ylabel="", xticks=[], yticks=[])
        ax.set_title(f"{caption}\nmap{index}", fontsize="medium")
    for ax in axes[len(examples) :]:
        ax.set_axis_off()
    return list(axes)


def plot_distributions(of: DatasetStatistics, axes: Sequence[Axes] | None = None) -> list[Axes]:
    """Draw the distributions of rooms, free share, path length and hardness.

    Args:
        of: what `dataset_statistics` returns.
        axes: where to draw, four of them; a new figure without.
    """
    axes = new_axes(2, 2, (9, 6)) if axes is None else list(axes)
    for ax, (name, values) in zip(axes, of.distributions().items(), strict=False):
        plot_distribution(name, values, ax)
    return axes


def plot_distribution(name: str, values: Floats, ax: Axes) -> None:
    """Draw one of `DatasetStatistics.distributions`: its histogram, the mean as a dashed line."""
    edges = bin_edges(values).tolist()
    ax.hist(values, edges, color=COLOURS["astar"], edgecolor="white", linewidth=0.5)
    if (values == np.rint(values)).all():
        ax.locator_params(axis="x", integer=True, min_n_ticks=1)
    counted = "segments" if "segment" in name else "maps"
    if name.startswith("hardness"):  # a peak and a long tail
        ax.set_yscale("log")
        counted += " (log)"
    ax.set(xlabel=name, ylabel=counted)
    if len(values):
        mean = values.mean()
        ax.axvline(mean, color="0.4", linewidth=1, linestyle="--")
        title = f"mean {mean:.4g}, median {np.median(values):.4g}, n = {len(values):,}"
        ax.set_title(title, fontsize="medium")


def plot_figure(
    root: Locations,
    kind: str,
    *,
    index: int = 0,
    paper_colours: bool = False,
    progress: bool = False,
) -> Figure:
    """Return one of `FIGURES` of a dataset: what ``mapdata show`` writes.

    Args:
        root: folder or URL of the dataset, or several.
        kind: "map", "gallery", "path", "matrix" or "distributions".
        index: number of the map, for those of one map.
        paper_colours: free black, occupied white, where a map is drawn.
        progress: show a progress bar where all maps are read.

    Raises:
        ValueError: no such figure, or no such map.
    """
    check_choice("figure", kind, FIGURES)
    if kind in OF_ONE_MAP:
        labels, i = Root.open(root).locate(index)
    else:
        of = dataset_statistics(root, progress=progress)
    if kind == "gallery":
        axes = plot_gallery(of, paper_colours=paper_colours)
    elif kind == "distributions":
        axes = plot_distributions(of)
    elif kind == "map":
        axes = [plot_map(labels, i, paper_colours=paper_colours)]
    elif kind == "path":
        axes = new_axes(1, 2, (11, 8))
        for search, ax in zip(SEARCHES, axes, strict=True):
            plot_path(labels, i, search, ax, paper_colours=paper_colours)
    else:
        searches = ("astar",) if same_matrices(labels, i) else SEARCHES
        axes = new_axes(1, len(searches), (6 * len(searches), 5.8))
        for search, ax in zip(searches, axes, strict=True):
            plot_matrix(labels, i, search, ax)
    return figure_of(axes[0])


FIGURES = ("map", "gallery", "path", "matrix", "distributions")
"""What ``mapdata show --figure`` draws."""

OF_ONE_MAP = ("map", "path", "matrix")
"""Those of `FIGURES` that show the map ``--index``."""

WITH_GRID = ("map", "path", "gallery")
"""Those of `FIGURES` that show a grid, which ``--paper-colours`` turns over."""


def figure_of(axes: Axes) -> Figure:
    """Return the figure that axes are part of."""
    return cast("Figure", axes.figure)
