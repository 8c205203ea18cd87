"""Figures of a whole dataset, and what ``mapdata show`` draws."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from mapdata.arrays import Floats
from mapdata.plotting.plot import (
    COLOURS,
    new_axes,
    plot_grid,
    plot_map,
    plot_matrix,
    plot_path,
    same_matrices,
)
from mapdata.shards.root import Places, Root
from mapdata.shards.statistics import DatasetStatistics, dataset_statistics, histogram
from mapdata.spec import check_choice

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from mapdata.search.labels import Labels

LOGARITHMIC = ("hardness of a segment",)
"""Distributions with a peak and a long tail: drawn with a logarithmic count."""

_NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")


def pick_examples(of: DatasetStatistics) -> dict[str, int]:
    """Return examples as the paper's Figure 2 has them: a caption and the number of a map each.

    They are maps with few to many rooms, one that is not connected (some rooms do not reach each
    other), one that is redundant (all rooms reach each other though a passage was not drawn: others
    or overlapping rooms stand in), one with the most rooms (nine in the paper) and the one with the
    hardest segment. Each is the first such map of the dataset that is not shown yet; a kind that
    does not occur is left out. Where all maps have equally many rooms, as many imported ones, they
    go from easy to hard instead.
    """
    kinds = np.unique(of.rooms)
    most = int(kinds[-1]) if len(kinds) else 0
    few = (
        kinds[:-1][np.unique(np.linspace(0, len(kinds) - 2, 4).round().astype(int))]
        if len(kinds) > 1
        else []
    )
    wanted: list[tuple[str, npt.NDArray[np.bool_]]] = [
        *((_in_words(int(n), of.rooms_known), of.all_connected & (of.rooms == n)) for n in few),
        ("not connected", ~of.all_connected),
        ("redundant", of.redundant),
        (_in_words(most, of.rooms_known), of.rooms == most),
    ]
    if len(kinds) == 1:
        marks = np.quantile(of.hardest, (0.1, 0.3, 0.5, 0.7, 0.9), method="nearest").tolist()
        wanted += [(f"hardness {mark:.2f}", of.hardest == mark) for mark in marks]
    if len(of) and of.hardest.max() > 1:
        wanted.append((f"hardness {of.hardest.max():.2f}", of.hardest == of.hardest.max()))
    examples: dict[str, int] = {}
    for caption, which in wanted:
        for index in of.index[which].tolist() if caption not in examples else ():
            if index not in examples.values():
                examples[caption] = index
                break
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
    columns = min(4, len(examples)) or 1
    rows = -(-len(examples) // columns) or 1
    high, wide = of.root.map_size
    size = (2.6 * columns, 2.85 * rows * high / wide + 0.5)
    axes = new_axes(rows, columns, size) if axes is None else list(axes)
    for ax in axes[len(examples) :]:
        ax.set_axis_off()
    for ax, (caption, index) in zip(axes, examples.items(), strict=False):
        labels, i = of.root.map(index)
        plot_grid(labels.maps.occupancy[i], ax, paper_colours=paper_colours)
        seed_points = labels.maps.seed_points[i, : labels.maps.rooms[i]]
        ax.plot(seed_points[:, 1], seed_points[:, 0], "o", color=COLOURS["seed"], mec="white", ms=6)
        ax.set(xlabel="", ylabel="", xticks=[], yticks=[])
        ax.set_title(f"{caption}\nmap{index}", fontsize="medium")
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
    return list(axes)


def plot_distribution(name: str, values: Floats, ax: Axes) -> None:
    """Draw one of `DatasetStatistics.distributions`: its histogram, the mean as a dashed line."""
    from matplotlib.ticker import MaxNLocator

    edges, counts = histogram(values)
    style: dict[str, Any] = {"color": COLOURS["astar"], "edgecolor": "white", "linewidth": 0.5}
    ax.bar(edges[:-1], counts, np.diff(edges), align="edge", **style)
    if (values == np.rint(values)).all():
        ax.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    counted = "segments" if "segment" in name else "maps"
    if name in LOGARITHMIC:
        ax.set_yscale("log")
        counted += " (log)"
    ax.set(xlabel=name, ylabel=counted)
    if len(values):
        mean = values.mean()
        ax.axvline(mean, color="0.4", linewidth=1, linestyle="--")
        title = f"mean {mean:.4g}, median {np.median(values):.4g}, n = {len(values):,}"
        ax.set_title(title, fontsize="medium")


def plot_figure(
    root: Places,
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
        axes = _plot_one_map(kind, *Root.open(root).map(index), paper_colours)
    else:
        of = dataset_statistics(root, progress=progress)
        if kind == "gallery":
            axes = plot_gallery(of, paper_colours=paper_colours)
        else:
            axes = plot_distributions(of)
    return figure_of(axes[0])


def _plot_one_map(kind: str, labels: Labels, i: int, paper_colours: bool) -> list[Axes]:
    if kind == "map":
        axes = new_axes(size=(6, _height(labels, 5.4) + 1.1))
        plot_map(labels, i, axes[0], paper_colours=paper_colours)
        return axes
    if kind == "path":
        legend = 0.13 * min(int(labels.maps.rooms[i]), 16)
        axes = new_axes(1, 2, (11, _height(labels, 4.8) + 1.1 + legend))
        plot_path(labels, i, "bfs", axes[0], paper_colours=paper_colours)
        plot_path(labels, i, "astar", axes[1], paper_colours=paper_colours)
        return axes
    if same_matrices(labels, i):
        axes = new_axes(size=(6, 5.8))
        plot_matrix(labels, i, axes=axes[0])
    else:
        axes = new_axes(1, 2, (12, 5.8))
        plot_matrix(labels, i, "bfs", axes[0])
        plot_matrix(labels, i, "astar", axes[1])
    return axes


FIGURES = ("map", "gallery", "path", "matrix", "distributions")
"""What ``mapdata show --figure`` draws."""

OF_ONE_MAP = ("map", "path", "matrix")
"""Those of `FIGURES` that show the map ``--index``."""

WITH_GRID = ("map", "path", "gallery")
"""Those of `FIGURES` that show a grid, which ``--paper-colours`` turns over."""


def _height(labels: Labels, width: float) -> float:
    """Return the height of a picture of a map of this width, in inches."""
    rows, columns = labels.maps.occupancy.shape[1:]
    return float(min(max(width * rows / columns, 1.2), 3 * width))


def figure_of(axes: Axes) -> Figure:
    """Return the figure that axes are part of."""
    from matplotlib.figure import Figure

    figure = axes.figure
    assert isinstance(figure, Figure)
    return figure


def _in_words(number: int, rooms: bool) -> str:
    word = _NUMBERS[number] if number < len(_NUMBERS) else str(number)
    noun = "room" if rooms else "seed point"
    return f"{word} {noun}" if number == 1 else f"{word} {noun}s"
