"""Figures of a search: which cells it expanded, in which order, as a picture or an animation."""

from __future__ import annotations

import math
from collections.abc import Iterator
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mapdata.plotting.plot import (
    COLOURS,
    NAMES,
    new_axes,
    plot_cells,
    plot_ends,
    plot_grid,
    seed_noun,
)
from mapdata.search.api import SEARCHES
from mapdata.search.labels import Labels
from mapdata.search.map_stack import MapStack
from mapdata.search.order import SearchOrder, search_order
from mapdata.shards.files import StrPath, write_output

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from PIL.Image import Image

_MAX_FRAMES = 60
_FRAME_MS = 80
_LAST_FRAME_MS = 3000

_ORDER_LABEL = "expansion"


def plot_search(
    grid: ArrayLike,
    order: ArrayLike,
    path: ArrayLike = (),
    axes: Axes | None = None,
    *,
    last: int | None = None,
) -> Axes:
    """Draw which cells a search expanded, coloured by their order, and its path.

    Args:
        grid: (H, W), 0 free and 1 occupied.
        order: (H, W), the number of the expansion of each cell, -1 for cells that were not
            expanded, as from `search_order`.
        path: (k, 2) cells from start to goal; none is drawn by default.
        axes: where to draw; default a new figure, with a colour bar.
        last: number of the expansion at which the colours end; default that of the last cell. To
            compare searches, pass the number of the longest one.

    Raises:
        ValueError: ``order`` is no array of the shape of the grid.
    """
    is_tuple = isinstance(order, tuple)  # such as all that `search_order` returned
    numbers = np.asarray(() if is_tuple else order)
    if is_tuple or numbers.shape != np.shape(grid):
        got = type(order).__name__ if is_tuple else f"shape {numbers.shape}"
        raise ValueError(
            f"order: got {got}, expected {np.shape(grid)}, as in plot_search(grid, found.order, "
            "found.path) for found = search_order(...)"
        )
    is_new = axes is None
    axes = axes or new_axes()[0]
    plot_grid(grid, axes)
    image = axes.imshow(
        np.ma.masked_less(numbers, 0),
        cmap="viridis",
        vmin=0,
        vmax=max(numbers.max(initial=0) if last is None else last, 1),
        interpolation="nearest",
    )
    cells = np.asarray(path)
    if len(cells):
        plot_cells(axes, cells, COLOURS["bfs"], "path")
        plot_ends(cells[0], cells[-1], axes)
    axes.set_title(f"{(numbers >= 0).sum():,} expansions")
    if is_new:
        figure: Any = axes.figure  # matplotlib's type hints also allow None here
        figure.colorbar(image, ax=axes, label=_ORDER_LABEL, shrink=0.8)
    return axes


def plot_both_searches(labels: Labels, i: int) -> list[Axes]:
    """Draw BFS and A* beside each other, on the segment of a map for which A* expands most cells.

    Args:
        labels: labelled maps.
        i: number of the map in the batch.

    Raises:
        ValueError: the map has one seed point, so it has no segment.
    """
    segment = _longest_search(labels, i)
    return _plot_searches(labels, i, segment, _search_segment(labels, i, segment))


def write_search_animation(labels: Labels, i: int, path: StrPath) -> None:
    """Write the figure of `plot_both_searches` as a GIF, in which the cells appear in their order.

    It has at most 60 pictures, which take some seconds to draw.

    Args:
        labels: labelled maps.
        i: number of the map in the batch.
        path: file to write; an existing one is replaced as a whole.

    Raises:
        ValueError: the map has one seed point, so it has no segment.
        OSError: the disk is full or may not be written to; the message names the file.
    """
    first, *others = _frames(labels, i)
    animation = BytesIO()
    durations = [_FRAME_MS] * len(others) + [_LAST_FRAME_MS]
    first.save(animation, "GIF", save_all=True, append_images=others, duration=durations, loop=0)
    write_output(path, animation.getvalue())


def _frames(labels: Labels, i: int) -> Iterator[Image]:
    """Yield the pictures of the animation, the last of which is the whole figure."""
    from PIL import Image

    segment = _longest_search(labels, i)
    searched = _search_segment(labels, i, segment)
    axes = _plot_searches(labels, i, segment, searched)
    figure: Any = axes[0].figure  # matplotlib's type hints also allow None here
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # The layout is made once, which takes most of the time.
    most = max(found.iterations for found in searched)
    step = math.ceil(most / _MAX_FRAMES)
    for shown in [*range(step, most, step), most]:
        for search, found, ax in zip(SEARCHES, searched, axes, strict=True):
            ax.images[-1].set_data(np.ma.masked_outside(found.order, 0, shown - 1))
            ax.set_title(_count(search, min(shown, found.iterations)))
            for artist in (*ax.lines, *ax.collections):  # the path and its arrow heads
                artist.set_visible(shown >= found.iterations)
        picture = BytesIO()
        figure.savefig(picture, format="png", dpi=80)
        yield Image.open(picture).convert("RGB")


def _plot_searches(labels: Labels, i: int, segment: int, searched: list[SearchOrder]) -> list[Axes]:
    """Draw what BFS and A* did on a segment of map ``i``, with one colour bar."""
    maps = labels.maps
    rows, columns = maps.occupancy[i].shape
    most = max(found.iterations for found in searched)
    height = max(4.5 * min(rows / columns, 3) + 1, 3)
    axes = new_axes(1, len(searched), (11, height))
    for search, found, ax in zip(SEARCHES, searched, axes, strict=True):
        plot_search(maps.occupancy[i], found.order, found.path, ax, last=most - 1)
        if not len(found.path):
            plot_ends(maps.seed_points[i, segment], maps.seed_points[i, segment + 1], ax)
        ax.set_title(_count(search, found.iterations))
    figure: Any = axes[0].figure
    figure.colorbar(axes[0].images[-1], ax=axes, label=_ORDER_LABEL, shrink=0.8)
    ends = f"{seed_noun(labels, i)}s {segment + 1} to {segment + 2}"
    figure.suptitle(f"map{maps.index[i]}, {ends}", fontsize="large")
    return axes


def _count(search: str, iterations: int) -> str:
    """Return the title of the axes of a search."""
    return f"{NAMES[search]}: {iterations:,} iterations"


def _longest_search(labels: Labels, i: int) -> int:
    """Return the segment of a map for which A* expands most cells."""
    iterations = labels.iterations("astar", i)
    if not len(iterations):
        number = labels.maps.index[i]
        raise ValueError(f"map {number} has one seed point, so it has no path to search")
    return int(iterations.argmax())


def _search_segment(labels: Labels, i: int, segment: int) -> list[SearchOrder]:
    """Search a segment of map ``i`` again, by BFS and by A*."""
    maps = labels.maps
    start, goal = maps.seed_points[i, segment : segment + 2]
    grid, terrain = MapStack.of(maps, np.array([i])).grid_and_terrain(0)
    return [
        search_order(grid, start, goal, maps.movement, search, terrain=terrain)
        for search in SEARCHES
    ]
