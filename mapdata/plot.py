"""Figures: axes in, axes out. matplotlib is imported when one is drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy.typing as npt

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from mapdata.labels import Labels

# Okabe and Ito's colours, which colour-blind readers can tell apart.
COLOURS = {"bfs": "#D55E00", "astar": "#0072B2", "seed": "#009E73"}
NAMES = {"bfs": "BFS", "astar": "A*"}


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


def _new_axes() -> Axes:
    from matplotlib.figure import Figure

    return Figure(figsize=(6, 6.5), layout="constrained").add_subplot()
