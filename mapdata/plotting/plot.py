"""Figures of one map: axes in, axes out. matplotlib is imported when one is drawn. What models do
on a map is in
`mapdata.plotting.plot_models`, figures of a dataset are in `mapdata.plotting.figures`.

Axes that are made here sit in a figure with ``layout="constrained"``, which makes room for titles
and legends; for your own axes beside others, make the figure that way, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

    from mapdata.search.labels import Labels

# Okabe and Ito's colours, which colour-blind readers can tell apart.
COLOURS = {"bfs": "#D55E00", "astar": "#0072B2", "seed": "#009E73"}
NAMES = {"bfs": "BFS", "astar": "A*"}
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = "osD^v<>PXph"

_LISTED = 16
_NUMBERED = 16


def plot_grid(
    occupancy: npt.ArrayLike, axes: Axes | None = None, *, paper_colours: bool = False
) -> Axes:
    """Draw a grid: free white and occupied black, or the other way round as the paper's Figure 2
    does.

    Args:
        occupancy: (H, W), 0 free and 1 occupied.
        axes: where to draw; a new figure without.
        paper_colours: free black, occupied white.
    """
    axes = axes or _new_axes()
    cmap, top = (
        ("gray", 1.0) if paper_colours else ("gray_r", 1.25)
    )  # a grey black, on which dark lines are seen
    axes.imshow(occupancy, cmap=cmap, vmin=0, vmax=top, interpolation="nearest")
    axes.set(xlabel="column", ylabel="row")
    return axes


def plot_map(
    labels: Labels, i: int, axes: Axes | None = None, *, paper_colours: bool = False
) -> Axes:
    """Draw map ``i`` of a batch with the routes of both planners and its numbered seeds: the
    paper's Figure 1.

    Args:
        labels: labelled maps.
        i: which map of the batch.
        axes: where to draw; a new figure without.
        paper_colours: free black, occupied white.
    """
    maps = labels.maps
    axes = plot_grid(maps.occupancy[i], axes, paper_colours=paper_colours)
    for search, width in (("bfs", 3.5), ("astar", 1.5)):
        steps = int(labels.iterations(search, i).sum())
        label = f"{NAMES[search]}, {steps:,} iterations"
        for path in labels.route(search, i):
            axes.plot(path[:, 1], path[:, 0], color=COLOURS[search], label=label, linewidth=width)
            label = "_"
    _plot_seed_points(axes, labels, i)
    state = "all connected" if labels.all_connected[i] else "not all connected"
    head(axes, f"map{maps.index[i]}: {maps.rooms[i]} {_points(labels, i)}, {state}")
    return axes


def plot_path(
    labels: Labels,
    i: int,
    search: str = "astar",
    axes: Axes | None = None,
    *,
    paper_colours: bool = False,
) -> Axes:
    """Draw the route of one planner on map ``i`` of a batch, each segment with its moves and
    iterations: the paper's Figure 3.

    Args:
        labels: labelled maps.
        i: which map of the batch.
        search: "astar" or "bfs".
        axes: where to draw; a new figure without.
        paper_colours: free black, occupied white.
    """
    axes = plot_grid(labels.maps.occupancy[i], axes, paper_colours=paper_colours)
    iterations, route = labels.iterations(search, i), labels.route(search, i)
    styles = ("-", (0, (4, 1.5)), (0, (1, 1)))
    for q, (path, count) in enumerate(zip(route, iterations.tolist(), strict=True)):
        moves = f"{len(path) - 1} moves" if len(path) else "no path"
        label = f"{q + 1} to {q + 2}: {moves}, {count:,} iterations"
        if q == _LISTED - 1 and len(route) > _LISTED:
            label = f"... and {len(route) - q} more"
        axes.plot(
            path[:, 1],
            path[:, 0],
            color=PALETTE[q % 6],
            linestyle=styles[q // 6 % len(styles)],
            linewidth=4.5
            - 2.5 * q / max(len(route) - 1, 1),  # what lies below is wider, so that it is seen
            label=label if q < _LISTED else "_",
        )
    _plot_seed_points(axes, labels, i)
    axes.set_title(
        f"map{labels.maps.index[i]}, {NAMES[search]}: {iterations.sum():,} iterations in all"
    )
    if route:
        _legend_below(axes, ncols=1 + (len(route) > 5))
    return axes


def plot_matrix(labels: Labels, i: int, search: str = "astar", axes: Axes | None = None) -> Axes:
    """Draw the connection matrix of map ``i`` of a batch, pairs without a path hatched: the paper's
    Figure 4.

    Args:
        labels: labelled maps.
        i: which map of the batch.
        search: "astar" or "bfs".
        axes: where to draw; a new figure without.
    """
    from matplotlib.patches import Patch, Rectangle

    axes = axes or _new_axes()
    matrix = labels.matrix(search, i)
    n, top = len(matrix), max(float(matrix.max()), 1.0)
    image = axes.imshow(np.ma.masked_less(matrix, 0), cmap="cividis", vmin=0, vmax=top)
    axes.figure.colorbar(
        image, ax=axes, label="moves" if search == "bfs" else "cost, cells", shrink=0.8
    )
    for row, column in np.argwhere(matrix < 0).tolist():
        corner = (column - 0.5, row - 0.5)
        axes.add_patch(
            Rectangle(corner, 1, 1, facecolor="white", edgecolor="0.6", hatch="////", linewidth=0.0)
        )
    if n <= _NUMBERED:
        for row, column in np.argwhere(matrix >= 0).tolist():
            value = matrix[row, column]
            ink = "black" if value > 0.55 * top else "white"
            axes.text(
                column,
                row,
                f"{value:.4g}",
                ha="center",
                va="center",
                color=ink,
                fontsize=9 if n <= 10 else 6,
            )
    step = 1 if n <= 20 else -(-n // 12)
    places = np.arange(0, n, step)
    word = _points(labels, i).removesuffix("s")
    axes.set(xticks=places, yticks=places, xlabel=word, ylabel=word)
    axes.set_xticklabels([str(k + 1) for k in places])
    axes.set_yticklabels([str(k + 1) for k in places])
    axes.set_title(f"map{labels.maps.index[i]}: connection matrix by {NAMES[search]}")
    if (matrix < 0).any():
        _legend_below(
            axes,
            handles=[
                Patch(facecolor="white", edgecolor="0.6", hatch="////", label="no connection")
            ],
        )
    return axes


def plot_planners(table: pd.DataFrame, axes: Axes | None = None, *, subset: str = "hard") -> Axes:
    """Draw cost ratio against expansion ratio, a mark a planner with its 95 % intervals: left and
    low is good.

    Args:
        table: what `evaluate` returns.
        axes: where to draw; a new figure without.
        subset: "hard" or "all".
    """
    axes = axes or _new_axes()
    rows = table[table["subset"] == subset]
    for k, row in enumerate(rows.to_dict("records")):
        colour, x, y = PALETTE[k % len(PALETTE)], row["expansion_ratio"], row["cost_ratio"]
        axes.plot(
            [row["expansion_ratio_low"], row["expansion_ratio_high"]],
            [y, y],
            color=colour,
            linewidth=1,
        )
        axes.plot(
            [x, x], [row["cost_ratio_low"], row["cost_ratio_high"]], color=colour, linewidth=1
        )
        marker, label = MARKERS[k % len(MARKERS)], row["planner"]
        axes.plot(
            x,
            y,
            marker,
            color=colour,
            markersize=9,
            markeredgewidth=2,
            markerfacecolor="none",
            label=label,
        )
    axes.set_xscale("log", base=2)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set(
        xlabel="expansions / expansions of A* (mean)",
        ylabel="cost / optimal cost (mean of the solved)",
        title=f"{subset} problems: {rows['n'].max()}",
    )
    axes.grid(alpha=0.3)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=3, frameon=False)
    return axes


def _plot_seed_points(axes: Axes, labels: Labels, i: int) -> None:
    """Mark the seeds of map ``i`` with their numbers."""
    seed_points = labels.maps.seed_points[i, : labels.maps.rooms[i]]
    for number, (row, column) in enumerate(seed_points.tolist(), 1):
        mark(axes, str(number), row, column)


def mark(axes: Axes, text: str, row: float, column: float) -> None:
    """Put a disc with ``text`` on a cell of ``axes``."""
    axes.scatter(
        column, row, s=110, clip_on=False, color=COLOURS["seed"], edgecolor="white", zorder=4
    )
    axes.text(
        column, row, text, color="white", ha="center", va="center_baseline", fontsize=7, zorder=5
    )


def head(axes: Axes, title: str) -> None:
    """Put the legend over the axes and the title over it: both stay inside a figure of any
    layout.
    """
    if not axes.get_legend_handles_labels()[0]:  # a map with one seed point has no path
        axes.set_title(title)
        return
    axes.legend(
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        ncols=3,
        frameon=False,
        fontsize="small",
        borderaxespad=0.1,
        columnspacing=1.2,
    )
    axes.set_title(title, pad=22)


def _legend_below(axes: Axes, handles: Sequence[Artist] | None = None, ncols: int = 1) -> None:
    """Put the legend under the axis label, whatever the size of the axes."""
    from matplotlib.transforms import offset_copy

    axes.legend(
        handles=axes.get_legend_handles_labels()[0] if handles is None else handles,
        loc="upper center",
        bbox_to_anchor=(0.5, 0),
        bbox_transform=offset_copy(
            axes.transAxes, fig=axes.get_figure(root=True), y=-34, units="points"
        ),
        borderaxespad=0.0,
        ncols=ncols,
        frameon=False,
        fontsize="small",
    )


def _points(labels: Labels, i: int) -> str:
    """Return what the seeds of map ``i`` stand for: imported maps have seed points without
    rooms.
    """
    maps = labels.maps
    known = bool(maps.passage_width[i] >= 0 or (maps.sizes[i] >= 0).any())
    return "rooms" if known else "seed points"


def _new_axes() -> Axes:
    from matplotlib.figure import Figure

    return Figure(figsize=(6, 6.5), layout="constrained").add_subplot()
