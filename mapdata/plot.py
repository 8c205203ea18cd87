"""Figures: axes in, axes out. matplotlib is imported when one is drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy.typing as npt

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from mapdata.labels import Labels

# Okabe and Ito's colours, which colour-blind readers can tell apart.
COLOURS = {"bfs": "#D55E00", "astar": "#0072B2", "seed": "#009E73"}
NAMES = {"bfs": "BFS", "astar": "A*"}
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = "osD^v<>PXph"


def plot_grid(occupancy: npt.ArrayLike, axes: Axes | None = None, *, paper_colours: bool = False) -> Axes:
    """Draw a grid: free white and occupied black, or the other way round as the paper's Figure 2 does.

    Args:
        occupancy: (H, W), 0 free and 1 occupied.
        axes: where to draw; a new figure without.
        paper_colours: free black, occupied white.
    """
    axes = axes or _new_axes()
    axes.imshow(occupancy, cmap="gray" if paper_colours else "gray_r", vmin=0, vmax=1.25, interpolation="nearest")
    axes.set(xlabel="column", ylabel="row")
    return axes


def plot_map(labels: Labels, i: int, axes: Axes | None = None, *, paper_colours: bool = False) -> Axes:
    """Draw map ``i`` of a batch with the routes of both planners and its numbered seeds: the paper's Figure 1.

    Args:
        labels: labelled maps.
        i: which map of the batch.
        axes: where to draw; a new figure without.
        paper_colours: free black, occupied white.
    """
    maps = labels.maps
    axes = plot_grid(maps.occupancy[i], axes, paper_colours=paper_colours)
    for planner, width in (("bfs", 3.5), ("astar", 1.5)):
        steps = int(labels.iterations(planner, i).sum())
        label = f"{NAMES[planner]}, {steps} iterations"
        for path in labels.route(planner, i):
            axes.plot(path[:, 1], path[:, 0], color=COLOURS[planner], label=label, linewidth=width)
            label = "_"
    seeds = maps.seeds[i, : maps.rooms[i]]
    axes.scatter(seeds[:, 1], seeds[:, 0], s=90, clip_on=False, color=COLOURS["seed"], edgecolor="white", zorder=3)
    for number, (row, column) in enumerate(seeds.tolist(), 1):
        axes.annotate(str(number), (column, row), color="white", ha="center", va="center", fontsize=7, zorder=4)
    state = "all connected" if labels.all_connected[i] else "not all connected"
    axes.set_title(f"map{maps.index[i]}: {len(seeds)} rooms, {state}")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2, frameon=False)
    return axes


def plot_planners(table: pd.DataFrame, axes: Axes | None = None, *, subset: str = "hard") -> Axes:
    """Draw cost ratio against expansion ratio, a mark a planner with its 95 % intervals: left and low is good.

    Args:
        table: what `evaluate` returns.
        axes: where to draw; a new figure without.
        subset: "hard" or "all".
    """
    axes = axes or _new_axes()
    rows = table[table["subset"] == subset]
    for k, row in enumerate(rows.to_dict("records")):
        colour, x, y = PALETTE[k % len(PALETTE)], row["expansion_ratio"], row["cost_ratio"]
        axes.plot([row["expansion_ratio_low"], row["expansion_ratio_high"]], [y, y], color=colour, linewidth=1)
        axes.plot([x, x], [row["cost_ratio_low"], row["cost_ratio_high"]], color=colour, linewidth=1)
        marker, label = MARKERS[k % len(MARKERS)], row["planner"]
        axes.plot(x, y, marker, color=colour, markersize=9, markeredgewidth=2, markerfacecolor="none", label=label)
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


def _new_axes() -> Axes:
    from matplotlib.figure import Figure

    return Figure(figsize=(6, 6.5), layout="constrained").add_subplot()
