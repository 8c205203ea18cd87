"""Figures of a map: each function draws on axes and returns them.

Outputs of models are drawn in `mapdata.plotting.plot_models`, whole datasets in
`mapdata.plotting.figures`. Without axes, a function creates a figure with ``layout="constrained"``,
which makes room for titles and legends, in the look of `STYLE`. If you create the figure yourself,
use that layout within ``matplotlib.rc_context(STYLE)``.

matplotlib is imported when a figure is drawn, since its import is slow.
"""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mapdata.arrays import Array
from mapdata.shards.files import StrPath, write_output

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

    from mapdata.search.labels import Labels

COLOURS = {
    "bfs": "#D55E00",
    "astar": "#0072B2",
    "predicted": "#CC79A7",
    "seed": "#009E73",
    "sample": "#56B4E9",
}
"""What each colour means in all figures: the path of a search, the path that a model predicts, seed
points, start and goal, and the samples of a roadmap.

They are Okabe and Ito's colours, which colour-blind readers can tell apart.
"""

NAMES = {"bfs": "BFS", "astar": "A*"}
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = "osD^v<>PXph"

STYLE: dict[Any, str] = {
    "axes.edgecolor": "0.5",
    "axes.labelsize": "small",
    "axes.prop_cycle": f"cycler('color', {list(PALETTE)})",
    "xtick.labelsize": "small",
    "ytick.labelsize": "small",
}
"""The rcParams of figures that are created here."""

_SEGMENT_COLOURS = {"bfs": ("#D55E00", "#E69F00"), "astar": ("#0072B2", "#56B4E9")}
"""Alternating colours of the segments of a route: that of the search, and a lighter one."""

_MAX_LEGEND_SEGMENTS = 16
"""Maximal number of segments in a legend."""

_MAX_MATRIX_TEXTS = 16
"""Maximal number of rooms for which costs are written into the connection matrix."""

_LANE_WIDTH = 1.6
"""Points that a lane is shifted sideways; in a figure of one map of 64 x 64 a cell has about 6."""

_LINE_WIDTH = 2.2
"""Width of the line of a path, in points."""

_WIDTH_STEP = 0.8
"""Points by which lines differ in width if cells are too small for lanes side by side."""


def plot_grid(
    occupancy: ArrayLike,
    axes: Axes | None = None,
    *,
    paper_colours: bool = False,
    terrain: ArrayLike | None = None,
) -> Axes:
    """Draw a grid: free white and occupied black, or the opposite as in the paper's Figure 2.

    Args:
        occupancy: (H, W), 0 free and 1 occupied.
        axes: where to draw; default a new figure.
        paper_colours: free black, occupied white.
        terrain: (H, W), the cost of each cell, drawn as a shade of the free cells; high is dark.
    """
    axes = axes or new_axes(size=panel_size(np.shape(occupancy), 5.42, (0.58, 1.08)))[0]
    if paper_colours:
        colour_map = "gray"
        max_shade = 1.0
    else:
        colour_map = "gray_r"
        max_shade = 1.25  # occupied cells become dark grey, so that dark lines stay visible
    axes.imshow(
        np.asarray(occupancy), cmap=colour_map, vmin=0, vmax=max_shade, interpolation="nearest"
    )
    axes.set(xlabel="column", ylabel="row")
    if terrain is not None:
        shade_cells(axes, np.asarray(terrain), np.asarray(occupancy) == 1)
    return axes


def shade_cells(axes: Axes, numbers: Array, is_hidden: Array) -> AxesImage:
    """Draw numbers (H, W) of the cells of a grid as shades from 0 on, but not where ``is_hidden``.

    Lines stay visible on all shades.
    """
    shades = np.ma.masked_where(is_hidden, numbers)
    return axes.imshow(shades, "YlOrBr", alpha=0.6, vmin=0, interpolation="nearest")


def plot_map(
    labels: Labels, i: int, axes: Axes | None = None, *, paper_colours: bool = False
) -> Axes:
    """Draw map ``i`` of a batch, its routes and numbered seed points: the paper's Figure 1.

    Args:
        labels: labelled maps.
        i: number of the map in the batch.
        axes: where to draw; default a new figure.
        paper_colours: free black, occupied white.
    """
    maps = labels.maps
    axes = plot_grid_of_map(labels, i, axes, paper_colours)
    for search, lane in (("bfs", -1), ("astar", 1)):
        label = f"{NAMES[search]}, {labels.iterations(search, i).sum():,} iterations"
        for path in labels.route(search, i):
            plot_cells(axes, path, COLOURS[search], label, lane=lane)
            label = "_"  # matplotlib omits it from the legend, where a search has one line
    _plot_seed_points(axes, labels, i)
    state = "all connected" if labels.all_connected[i] else "not all connected"
    put_header(axes, f"map{maps.index[i]}: {maps.rooms[i]} {seed_noun(labels, i)}s, {state}")
    return axes


def plot_path(
    labels: Labels,
    i: int,
    search: str = "astar",
    axes: Axes | None = None,
    *,
    paper_colours: bool = False,
    taut: bool = False,
) -> Axes:
    """Draw the route of one search on map ``i`` of a batch: the paper's Figure 3.

    Two shades of the search's colour alternate. The legend names the moves and iterations of the
    first 16 segments.

    Args:
        labels: labelled maps.
        i: number of the map in the batch.
        search: "astar" or "bfs".
        axes: where to draw; default a new figure.
        paper_colours: free black, occupied white.
        taut: draw the taut line of each segment (`mapdata.pull_taut`) instead of its cells.
    """
    # Its kernels import numba, which most figures do not need.
    from mapdata.search.taut import pull_taut

    axes = plot_grid_of_map(labels, i, axes, paper_colours)
    iterations = labels.iterations(search, i)
    route = labels.route(search, i)
    colours = _SEGMENT_COLOURS[search]
    styles = ("-", (0, (4, 1.5)), (0, (1, 1)))
    lanes = (-1, 0, 1)
    for segment, (path, count) in enumerate(zip(route, iterations, strict=True)):
        moves = f"{len(path) - 1} moves" if len(path) else "no path"
        label = f"{segment + 1} to {segment + 2}: {moves}, {count:,} iterations"
        colour = colours[segment % len(colours)]
        style = styles[segment // len(colours) % len(styles)]
        if taut and len(path):
            # In the picture, whole numbers are the middles of cells. A line in another lane would
            # cross the corners around which it bends.
            line = pull_taut(labels.maps.occupancy[i], path) - 0.5
            plot_cells(axes, line, colour, label, style)
        else:
            # Neighbouring segments often share cells, so they take different lanes.
            plot_cells(axes, path, colour, label, style, lanes[segment % len(lanes)])
    _plot_seed_points(axes, labels, i)
    axes.set_title(
        f"map{labels.maps.index[i]}, {NAMES[search]}: {iterations.sum():,} iterations in all"
    )
    if route:
        lines = axes.lines[:_MAX_LEGEND_SEGMENTS]
        _put_legend_below(axes, lines, ncols=1 if len(route) <= 5 else 2)
    return axes


def plot_matrix(labels: Labels, i: int, search: str = "astar", axes: Axes | None = None) -> Axes:
    """Draw the connection matrix of map ``i`` of a batch: the paper's Figure 4.

    Pairs without a path are hatched.

    Args:
        labels: labelled maps.
        i: number of the map in the batch.
        search: "astar" or "bfs"; the title names both where their matrices are equal.
        axes: where to draw; default a new figure.
    """
    axes = axes or new_axes()[0]
    matrix = labels.matrix(search, i)
    rooms = len(matrix)
    max_cost = max(matrix.max(), 1.0)
    costs = np.ma.masked_less(matrix, 0)
    # Rooms are numbered from 1, and each number is in the middle of its cells. The y axis points
    # down, as in a matrix.
    left, right, bottom, top = 0.5, rooms + 0.5, rooms + 0.5, 0.5
    image = axes.imshow(
        costs, cmap="cividis", vmin=0, vmax=max_cost, extent=(left, right, bottom, top)
    )
    axes.locator_params(integer=True, min_n_ticks=1)
    unit = "moves" if search == "bfs" else "cost, cells"
    axes.figure.colorbar(image, ax=axes, label=unit, shrink=0.8)
    if rooms <= _MAX_MATRIX_TEXTS:
        for (row, column), cost in np.ndenumerate(matrix):
            if cost < 0:
                continue  # no path
            is_bright = cost > 0.55 * max_cost
            axes.text(
                column + 1,
                row + 1,
                f"{cost:.4g}",
                color="black" if is_bright else "white",
                ha="center",
                va="center",
                fontsize=9 if rooms <= 10 else 6,
            )
    noun = seed_noun(labels, i)
    axes.set(xlabel=noun, ylabel=noun)
    name = "BFS and A*" if matrices_are_equal(labels, i) else NAMES[search]
    axes.set_title(f"map{labels.maps.index[i]}: connection matrix by {name}")
    if (matrix < 0).any():
        # Masked pairs are transparent and show the background of the axes.
        axes.patch.set(edgecolor="0.6", hatch="////", label="no connection")
        _put_legend_below(axes, [axes.patch])
    return axes


def matrices_are_equal(labels: Labels, i: int) -> bool:
    """Return whether the matrices of map ``i`` are equal, as they are if all moves cost 1."""
    return np.array_equal(labels.matrix("bfs", i), labels.matrix("astar", i))


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
        path: (k, 2) cells (row, col), or points between their middles.
        colour: of line and arrows.
        label: in a legend.
        style: a line style of matplotlib.
        lane: -1, 0 or 1; paths that share cells lie side by side in different lanes. The data of
            the line are the cells, only the drawing is shifted, by at most half a cell. Where this
            is too little to see both, lane -1 is wider and lane 1 narrower.
    """
    from matplotlib.transforms import offset_copy

    from mapdata.plotting.arrows import ArrowHeads

    # The shift is diagonal, so that horizontal and vertical parts are separated by the same amount.
    share = min(1.0, 0.5 * _cell_size(axes) / _LANE_WIDTH)
    shift = _LANE_WIDTH * lane * share
    figure: Any = axes.figure  # matplotlib's type hints also allow None here
    shifted = offset_copy(axes.transData, figure, shift, -shift, "points")
    rows, columns = path.T
    axes.plot(
        columns,
        rows,
        color=colour,
        transform=shifted,
        linestyle=style,
        linewidth=_LINE_WIDTH - _WIDTH_STEP * lane * (1 - share),
        label=label,
    )
    x_and_y = path[:, ::-1]
    axes.add_collection(ArrowHeads(x_and_y, shifted, colour), autolim=False)


def _cell_size(axes: Axes) -> float:
    """Return the size of a cell of a grid in points, nearly, since layouts follow later."""
    figure: Any = axes.figure  # matplotlib's type hints also allow None here
    pixels_per_point = figure.dpi / 72
    columns = abs(np.subtract(*axes.get_xlim()))
    rows = abs(np.subtract(*axes.get_ylim()))
    return float(min(axes.bbox.width / columns, axes.bbox.height / rows) / pixels_per_point)


def plot_grid_of_map(labels: Labels, i: int, axes: Axes | None, paper_colours: bool) -> Axes:
    """Draw the grid of map ``i``, and its terrain if it has any."""
    from mapdata.search.map_stack import MapStack

    grid, terrain = MapStack.of(labels.maps, np.array([i])).grid_and_terrain(0)
    return plot_grid(grid, axes, paper_colours=paper_colours, terrain=terrain)


def _plot_seed_points(axes: Axes, labels: Labels, i: int) -> None:
    """Mark the seed points of map ``i`` with their numbers, from 1."""
    seed_points = labels.maps.seed_points[i, : labels.maps.rooms[i]]
    for number, (row, column) in enumerate(seed_points, 1):
        mark(axes, str(number), row, column)


def plot_ends(start: ArrayLike, goal: ArrayLike, axes: Axes) -> Axes:
    """Mark the start with S on a disc and the goal with G on a square, as all figures do.

    Args:
        start: (2,), the cell (row, col).
        goal: (2,), the cell (row, col).
        axes: with a map, such as `plot_grid` returns.
    """
    for letter, cell in (("S", start), ("G", goal)):
        row, column = np.asarray(cell, np.float64)
        mark(axes, letter, row, column)
    return axes


def mark(axes: Axes, text: str, row: float, column: float) -> None:
    """Put ``text`` on a cell of ``axes``: the goal "G" on a square, other texts on a disc."""
    background = {
        "boxstyle": "square" if text == "G" else "circle",
        "facecolor": COLOURS["seed"],
        "edgecolor": "white",
    }
    axes.text(
        column, row, text, color="white", ha="center", va="center", fontsize=7, bbox=background
    )


def put_header(axes: Axes, title: str) -> None:
    """Put the legend above the axes, and the title above the legend, in a figure of any layout."""
    handles, _ = axes.get_legend_handles_labels()
    if not handles:  # a map with one seed point has no path, so there is no legend
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


def _put_legend_below(axes: Axes, handles: Sequence[Artist] | None = None, ncols: int = 1) -> None:
    """Put the legend below the label of the x axis, for axes of any size."""
    axes.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, 0),
        borderaxespad=4.0816,  # the height of the axis label and its ticks, in font sizes
        ncols=ncols,
        frameon=False,
        fontsize="small",
    )


def seed_noun(labels: Labels, i: int) -> str:
    """Return "room" if the seed points of map ``i`` are rooms, else "seed point"."""
    maps = labels.maps
    has_rooms = maps.passage_width[i] >= 0 or (maps.sizes[i] >= 0).any()
    return "room" if has_rooms else "seed point"


def write_figure(figure: Figure, path: StrPath) -> None:
    """Write a figure as a picture, in the file format that the ending of ``path`` names.

    The picture is drawn in memory. So an existing file is replaced as a whole, or stays as it is if
    the disk is full. Without an ending the format is PNG.

    Raises:
        ValueError: matplotlib knows no such format.
        OSError: the disk is full or may not be written to; the message names the file.
    """
    picture = BytesIO()
    picture_format = Path(path).suffix[1:] or "png"
    figure.savefig(picture, format=picture_format, dpi=150, bbox_inches="tight")
    write_output(path, picture.getvalue())


def panel_size(
    map_size: tuple[int, ...], side: float, room: tuple[float, float]
) -> tuple[float, float]:
    """Return the width and height of a figure of one map, in inches: it has the map's proportions.

    Args:
        map_size: (rows, cols) of the map.
        side: the longer side of the map in the figure, in inches. A narrow map still has a width of
            0.8 of it, so that title and legend fit, and a flat one a height of 0.1.
        room: width and height about the map, for labels and a title, in inches.
    """
    rows, columns = map_size
    inches_per_cell = side / max(rows, columns)
    width = max(columns * inches_per_cell, 0.8 * side)
    height = max(rows * inches_per_cell, 0.1 * side)
    return width + room[0], height + room[1]


def new_axes(rows: int = 1, columns: int = 1, size: tuple[float, float] = (6, 6.5)) -> list[Axes]:
    """Return the axes of a new figure in the look of `STYLE`, row by row.

    Args:
        rows: number of rows of axes.
        columns: number of columns of axes.
        size: (width, height) of the figure in inches.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        figure = Figure(figsize=size, layout="constrained")
        return list(figure.subplots(rows, columns, squeeze=False).flat)
