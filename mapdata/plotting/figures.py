"""Figures of a whole dataset, and the choice of figures of ``mapdata show``."""

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
    matrices_are_equal,
    new_axes,
    plot_grid_of_map,
    plot_map,
    plot_matrix,
    plot_path,
)
from mapdata.plotting.search_figures import plot_both_searches
from mapdata.search.api import SEARCHES
from mapdata.shards.locations import Locations
from mapdata.shards.root import Root

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def pick_examples(statistics: DatasetStatistics) -> dict[str, int]:
    """Return numbers of example maps by caption, chosen as for the paper's Figure 2.

    They are, in this order:

    - up to four connected maps, with few to many rooms;
    - a map that is not connected: some rooms do not reach each other;
    - a redundant map: all rooms reach each other though a passage was not drawn, since other
      passages or overlapping rooms replace it;
    - a map with the maximal number of rooms (nine in the paper);
    - the map with the hardest segment.

    Each is the first such map of the dataset that is not an example already, and is left out if
    there is none. If all maps have the same number of rooms, as in many imported datasets, five
    maps from easy to hard replace the first group.
    """
    examples: dict[str, int] = {}

    def add_first(caption: str, is_candidate: Flags) -> None:
        """Add the first candidate that is not an example yet; ``is_candidate`` is (N,)."""
        is_new = is_candidate & ~np.isin(statistics.index, list(examples.values()))
        if caption not in examples and is_new.any():
            examples[caption] = int(statistics.index[is_new.argmax()])

    room_counts = np.unique(statistics.rooms)
    max_rooms = int(statistics.rooms.max(initial=0))
    smaller_counts = room_counts[:-1]
    if len(smaller_counts):
        for rooms in np.quantile(smaller_counts, np.linspace(0, 1, 4), method="nearest"):
            caption = counted(int(rooms), statistics.noun)
            add_first(caption, statistics.all_connected & (statistics.rooms == rooms))
    add_first("not connected", ~statistics.all_connected)
    add_first("redundant", statistics.redundant)
    add_first(counted(max_rooms, statistics.noun), statistics.rooms == max_rooms)
    if len(room_counts) == 1:
        quantiles = (0.1, 0.3, 0.5, 0.7, 0.9)
        for hardness in np.quantile(statistics.hardest, quantiles, method="nearest"):
            add_first(f"hardness {hardness:.2f}", statistics.hardest == hardness)
    max_hardness = statistics.hardest.max(initial=0)
    if max_hardness > 1:
        add_first(f"hardness {max_hardness:.2f}", statistics.hardest == max_hardness)
    return examples


def plot_gallery(
    statistics: DatasetStatistics,
    axes: Sequence[Axes] | None = None,
    *,
    paper_colours: bool = False,
) -> list[Axes]:
    """Draw the examples of `pick_examples` with their seeds: the paper's Figure 2.

    Args:
        statistics: what `dataset_statistics` returns.
        axes: where to draw, at least one for each example; default a new figure. Axes without an
            example are switched off.
        paper_colours: free black, occupied white.
    """
    examples = pick_examples(statistics)
    if axes is None:
        count = max(len(examples), 1)
        columns = min(count, 4)
        rows = math.ceil(count / columns)
        map_rows, map_columns = statistics.root.map_size
        aspect = min(map_rows / map_columns, 3)
        axes = new_axes(rows, columns, (2.6 * columns, 2.85 * rows * aspect + 0.5))
    for ax, (caption, index) in zip(axes, examples.items(), strict=False):
        labels, i = statistics.root.locate(index)
        plot_grid_of_map(labels, i, ax, paper_colours)
        seed_points = labels.maps.seed_points[i, : labels.maps.rooms[i]]
        ax.plot(seed_points[:, 1], seed_points[:, 0], "o", color=COLOURS["seed"], mec="white", ms=6)
        ax.set(xlabel="", ylabel="", xticks=[], yticks=[])
        ax.set_title(f"{caption}\nmap{index}", fontsize="medium")
    for ax in axes[len(examples) :]:
        ax.set_axis_off()
    return list(axes)


def plot_distributions(
    statistics: DatasetStatistics, axes: Sequence[Axes] | None = None
) -> list[Axes]:
    """Draw the distributions of rooms, free share, path length and hardness.

    Args:
        statistics: what `dataset_statistics` returns.
        axes: where to draw, four of them; default a new figure.
    """
    axes = new_axes(2, 2, (9, 6)) if axes is None else list(axes)
    for ax, (name, values) in zip(axes, statistics.distributions().items(), strict=False):
        plot_distribution(name, values, ax)
    return axes


def plot_distribution(name: str, values: Floats, ax: Axes) -> None:
    """Draw a histogram of `DatasetStatistics.distributions`, with the mean as a dashed line.

    Args:
        name: of the distribution, the label of the x axis.
        values: (n,), one for each map or segment.
        ax: where to draw.
    """
    edges = bin_edges(values).tolist()
    ax.hist(values, edges, color=COLOURS["astar"], edgecolor="white", linewidth=0.5)
    are_whole_numbers = (values == np.rint(values)).all()
    if are_whole_numbers:
        ax.locator_params(axis="x", integer=True, min_n_ticks=1)
    y_label = "segments" if "segment" in name else "maps"
    if name.startswith("hardness"):  # its long tail is only seen on a logarithmic axis
        ax.set_yscale("log")
        y_label += " (log)"
    ax.set(xlabel=name, ylabel=y_label)
    if len(values):
        mean = values.mean()
        ax.axvline(mean, color="0.4", linewidth=1, linestyle="--")
        title = f"mean {mean:.4g}, median {np.median(values):.4g}, n = {len(values):,}"
        ax.set_title(title, fontsize="medium")


def plot_figure(
    root: Locations,
    figure: str,
    *,
    index: int = 0,
    paper_colours: bool = False,
    follow_links: bool = False,
    progress: bool = False,
) -> Figure:
    """Return one of the `FIGURES` of a dataset, which ``mapdata show`` writes.

    Args:
        root: folder or URL of the dataset, or several.
        figure: "map", "gallery", "path", "matrix", "search" or "distributions".
        index: number of the map, for figures of a single map.
        paper_colours: free black, occupied white, in figures that show a grid.
        follow_links: read files that are links out of their folder.
        progress: show a progress bar where all maps are read.

    Raises:
        ValueError: no such figure, or no such map.
    """
    check_choice("figure", figure, FIGURES)
    if figure in SINGLE_MAP_FIGURES:
        labels, i = Root.open(root, follow_links=follow_links).locate(index)
    else:
        statistics = dataset_statistics(root, follow_links=follow_links, progress=progress)
    if figure == "gallery":
        axes = plot_gallery(statistics, paper_colours=paper_colours)
    elif figure == "distributions":
        axes = plot_distributions(statistics)
    elif figure == "map":
        axes = [plot_map(labels, i, paper_colours=paper_colours)]
    elif figure == "path":
        rows, columns = labels.maps.occupancy.shape[1:]
        axes = new_axes(1, 2, (11, 5.5 * min(rows / columns, 1) + 2.5))
        for search, ax in zip(SEARCHES, axes, strict=True):
            plot_path(labels, i, search, ax, paper_colours=paper_colours)
    elif figure == "search":
        axes = plot_both_searches(labels, i)
    else:
        searches = ("astar",) if matrices_are_equal(labels, i) else SEARCHES
        axes = new_axes(1, len(searches), (6 * len(searches), 5.8))
        for search, ax in zip(searches, axes, strict=True):
            plot_matrix(labels, i, search, ax)
    return parent_figure(axes[0])


FIGURES = ("map", "gallery", "path", "matrix", "search", "distributions")
"""The choices of ``mapdata show --figure``."""

SINGLE_MAP_FIGURES = ("map", "path", "matrix", "search")
"""The figures of a single map, which ``--index`` selects."""

WITH_PAPER_COLOURS = ("map", "path", "gallery")
"""The figures whose colours ``--paper-colours`` swaps."""


def parent_figure(axes: Axes) -> Figure:
    """Return the figure that contains ``axes``."""
    return cast("Figure", axes.figure)
