"""Figures of one map: axes in, axes out. matplotlib is imported when one is drawn.

What models do on a map is in `mapdata.plotting.plot_models`, figures of a dataset are in
`mapdata.plotting.figures`. Axes that are made here have the look of `STYLE` and sit in a figure
with ``layout="constrained"``, which makes room for titles and legends. For your own axes beside
others, make the figure that way, too, within ``matplotlib.rc_context(STYLE)``.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

    from mapdata.search.labels import Labels
from mapdata.arrays import Array
from mapdata.checks import check_choice

# Okabe and Ito's colours, which colour-blind readers can tell apart.
COLOURS = {"bfs": "#D55E00", "astar": "#0072B2", "seed": "#009E73"}
NAMES = {"bfs": "BFS", "astar": "A*"}
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = "osD^v<>PXph"

STYLE: dict[Any, str] = {
    "axes.edgecolor": "0.5",
    "axes.labelsize": "small",
    "xtick.labelsize": "small",
    "ytick.labelsize": "small",
}
"""rcParams of the figures that are made here."""

_LISTED = 16
"""Most segments that a legend names."""

_NUMBERED = 16
"""Most rooms of a connection matrix whose costs are written into it."""

_LANE = 1.6
"""Points between paths that are drawn side by side; a cell has about 6 in a figure of one map."""


def plot_grid(
    occupancy: ArrayLike, axes: Axes | None = None, *, paper_colours: bool = False
) -> Axes:
    """Draw a grid: free white and occupied black, or as the paper's Figure 2 the other way round.

    Args:
        occupancy: (H, W), 0 free and 1 occupied.
        axes: where to draw; a new figure without.
        paper_colours: free black, occupied white.
    """
    axes = axes or new_axes()[0]
    cmap = "gray" if paper_colours else "gray_r"
    top = 1.0 if paper_colours else 1.25  # a grey black, on which dark lines are seen
    axes.imshow(np.asarray(occupancy), cmap=cmap, vmin=0, vmax=top, interpolation="nearest")
    axes.set(xlabel="column", ylabel="row")
    return axes


def plot_map(
    labels: Labels, i: int, axes: Axes | None = None, *, paper_colours: bool = False
) -> Axes:
    """Draw map ``i`` of a batch, its routes and numbered seed points: the paper's Figure 1.

    Args:
        labels: labelled maps.
        i: which map of the batch.
        axes: where to draw; a new figure without.
        paper_colours: free black, occupied white.
    """
    maps = labels.maps
    axes = plot_grid(maps.occupancy[i], axes, paper_colours=paper_colours)
    for search, lane in (("bfs", -1), ("astar", 1)):
        label = f"{NAMES[search]}, {labels.iterations(search, i).sum():,} iterations"
        for path in labels.route(search, i):
            plot_cells(axes, path, COLOURS[search], label, lane=lane)
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
    """Draw the route of one search on map ``i`` of a batch: the paper's Figure 3.

    The legend names the moves and iterations of the first 16 segments.

    Args:
        labels: labelled maps.
        i: which map of the batch.
        search: "astar" or "bfs".
        axes: where to draw; a new figure without.
        paper_colours: free black, occupied white.
    """
    axes = plot_grid(labels.maps.occupancy[i], axes, paper_colours=paper_colours)
    iterations = labels.iterations(search, i)
    route = labels.route(search, i)
    styles = ("-", (0, (4, 1.5)), (0, (1, 1)))
    for q, (path, count) in enumerate(zip(route, iterations, strict=True)):
        moves = f"{len(path) - 1} moves" if len(path) else "no path"
        label = f"{q + 1} to {q + 2}: {moves}, {count:,} iterations"
        # Neighbouring segments often share cells, so they take three lanes in turn.
        plot_cells(axes, path, PALETTE[q % 6], label, styles[q // 6 % len(styles)], q % 3 - 1)
    _plot_seed_points(axes, labels, i)
    axes.set_title(
        f"map{labels.maps.index[i]}, {NAMES[search]}: {iterations.sum():,} iterations in all"
    )
    if route:
        _legend_below(axes, axes.lines[:_LISTED], ncols=1 if len(route) <= 5 else 2)
    return axes


def plot_matrix(labels: Labels, i: int, search: str = "astar", axes: Axes | None = None) -> Axes:
    """Draw the connection matrix of map ``i`` of a batch: the paper's Figure 4.

    Pairs without a path are hatched.

    Args:
        labels: labelled maps.
        i: which map of the batch.
        search: "astar" or "bfs"; the title names both where their matrices are equal.
        axes: where to draw; a new figure without.
    """
    axes = axes or new_axes()[0]
    matrix = labels.matrix(search, i)
    n = len(matrix)
    top = max(matrix.max(), 1.0)
    costs = np.ma.masked_less(matrix, 0)
    numbers = (0.5, n + 0.5, n + 0.5, 0.5)  # of rooms, the first of which is 1
    image = axes.imshow(costs, cmap="cividis", vmin=0, vmax=top, extent=numbers)
    axes.locator_params(integer=True, min_n_ticks=1)
    axes.figure.colorbar(
        image, ax=axes, label="moves" if search == "bfs" else "cost, cells", shrink=0.8
    )
    for (row, column), value in np.ndenumerate(matrix):
        if value >= 0 and n <= _NUMBERED:
            ink = "black" if value > 0.55 * top else "white"
            axes.text(
                column + 1,
                row + 1,
                f"{value:.4g}",
                color=ink,
                ha="center",
                va="center",
                fontsize=9 if n <= 10 else 6,
            )
    word = _points(labels, i).removesuffix("s")
    axes.set(xlabel=word, ylabel=word)
    name = "BFS and A*" if same_matrices(labels, i) else NAMES[search]
    axes.set_title(f"map{labels.maps.index[i]}: connection matrix by {name}")
    if (matrix < 0).any():
        # masked pairs let the background of the axes through
        axes.patch.set(edgecolor="0.6", hatch="////", label="no connection")
        _legend_below(axes, [axes.patch])
    return axes


def same_matrices(labels: Labels, i: int) -> bool:
    """Return whether both searches gave map ``i`` the same matrix, as where all moves cost 1."""
    return np.array_equal(labels.matrix("bfs", i), labels.matrix("astar", i))


def plot_planners(table: pd.DataFrame, axes: Axes | None = None, *, subset: str = "hard") -> Axes:
    """Draw cost ratio against expansion ratio, a mark a planner: left and low is good.

    Bars are 95 % intervals.

    Args:
        table: what `evaluate` returns.
        axes: where to draw; a new figure without.
        subset: "hard" or "all".
    """
    check_choice("subset", subset, ("hard", "all"))
    axes = axes or new_axes()[0]
    rows = table[table["subset"] == subset]
    for row, colour, marker in zip(rows.to_dict("records"), cycle(PALETTE), cycle(MARKERS)):
        x = row["expansion_ratio"]
        y = row["cost_ratio"]
        axes.hlines(y, row["expansion_ratio_low"], row["expansion_ratio_high"], colour, linewidth=1)
        axes.vlines(x, row["cost_ratio_low"], row["cost_ratio_high"], colour, linewidth=1)
        axes.plot(x, y, marker, color=colour, fillstyle="none", mew=2, ms=9, label=row["planner"])
    axes.set_xscale("log", base=2)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set(
        xlabel="expansions / expansions of A* (mean)",
        ylabel="cost / optimal cost (mean of the solved)",
        title=f"{subset} problems: {rows['n'].max()}",
    )
    axes.grid(alpha=0.3)
    _legend_below(axes, ncols=3)
    return axes


def plot_cells(
    axes: Axes,
    path: Array,
    colour: str,
    label: str,
    style: Any = "-",
    lane: int = 0,
) -> None:
    """Draw a path with arrow heads from its start to its goal.

    Args:
        axes: where to draw.
        path: (k, 2) cells (row, col).
        colour: of line and arrows.
        label: its words in a legend.
        style: of the line, as matplotlib has them.
        lane: paths that share cells lie side by side in lanes -1, 0, 1. The data of the line stay
            the cells; only the picture is shifted.
    """
    from matplotlib.transforms import offset_copy

    from mapdata.plotting.arrows import ArrowHeads

    # Down and to the right, so that horizontal and vertical stretches part alike.
    shift = _LANE * lane
    figure: Any = axes.figure  # the stubs know of no part of a figure here
    aside = offset_copy(axes.transData, figure, shift, -shift, "points")
    rows, columns = path.T
    axes.plot(
        columns, rows, color=colour, transform=aside, linestyle=style, linewidth=2.2, label=label
    )
    axes.add_collection(ArrowHeads(path[:, ::-1], aside, colour), autolim=False)


def _plot_seed_points(axes: Axes, labels: Labels, i: int) -> None:
    """Mark the seeds of map ``i`` with their numbers."""
    seed_points = labels.maps.seed_points[i, : labels.maps.rooms[i]]
    for number, (row, column) in enumerate(seed_points, 1):
        mark(axes, str(number), row, column)


def mark(axes: Axes, text: str, row: float, column: float) -> None:
    """Put ``text`` on a cell of ``axes``: on a disc, the goal G on a square."""
    disc = {
        "boxstyle": "square" if text == "G" else "circle",
        "facecolor": COLOURS["seed"],
        "edgecolor": "white",
    }
    axes.text(column, row, text, color="white", ha="center", va="center", fontsize=7, bbox=disc)


def head(axes: Axes, title: str) -> None:
    """Put the legend over the axes and the title over it, inside a figure of any layout."""
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
    axes.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, 0),
        borderaxespad=4.0816,  # the height of the axis label and its ticks, in font sizes
        ncols=ncols,
        frameon=False,
        fontsize="small",
    )


def _points(labels: Labels, i: int) -> str:
    """Return what the seeds of map ``i`` stand for: imported maps have no rooms."""
    maps = labels.maps
    known = maps.passage_width[i] >= 0 or (maps.sizes[i] >= 0).any()
    return "rooms" if known else "seed points"


def new_axes(rows: int = 1, columns: int = 1, size: tuple[float, float] = (6, 6.5)) -> list[Axes]:
    """Return the axes of a new figure of this size in inches, in the look of `STYLE`."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        figure = Figure(figsize=size, layout="constrained")
        return list(figure.subplots(rows, columns, squeeze=False).flat)
