"""Figures of a sample, of a prediction beside the truth, and of a roadmap.

Axes in, axes out, as in `mapdata.plotting.plot`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mapdata.arrays import Array, Ints
from mapdata.limits import MAPS_AND_MASKS
from mapdata.plotting.plot import COLOURS, head, mark, new_axes, plot_cells, plot_grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAX_SAMPLES = 9
"""Largest number of samples that one figure shows."""


def plot_sample(sample: tuple[Any, ...], axes: Axes | None = None) -> Axes:
    """Draw a sample of a dataset, or the first 9 of a batch.

    Its map, start S, goal G and path, as far as it has these fields, over a shade of its first
    dense field, such as ``cost_to_go``. Masks are not drawn.

    ``plot_sample(dataset[:9]).figure.savefig("batch.png")`` writes a picture.

    Args:
        sample: what ``dataset[i]`` or a loader gives, a NamedTuple of tensors; with the field
            ``map`` or ``free``.
        axes: where to draw one sample, not a batch; a new figure without.

    Returns:
        The axes, of a batch those of its first sample.

    Raises:
        ValueError: no map, no sample, or axes for a batch.
    """
    if not hasattr(sample, "_asdict"):
        raise ValueError(f"sample: got a {type(sample).__name__}, expected one without transform=")
    values = {name: np.asarray(value.cpu()) for name, value in sample._asdict().items()}
    grid = values["map"] if "map" in values else 1 - values["free"] if "free" in values else None
    if grid is None or not len(grid) or (axes and grid.ndim == 4):
        raise ValueError(
            f"sample: got {sample}, expected one sample, or more without axes, with a map"
        )
    if grid.ndim == 4:
        count = min(len(grid), MAX_SAMPLES)
        columns = math.ceil(math.sqrt(count))
        rows = math.ceil(count / columns)
        places = new_axes(rows, columns, (4.2 * columns, 4.2 * rows))
        for k in range(count):
            plot_sample(type(sample)(*(tensor[k] for tensor in sample)), places[k])
        for spare in places[count:]:
            spare.set_axis_off()
        return places[0]
    axes = plot_grid(grid[0], axes)
    dense = [name for name in values if _is_dense(name, values[name], grid)]
    for name in dense[:1]:
        shade = np.ma.masked_where((grid == 1) | (values[name] < 0), values[name])
        image = axes.imshow(shade[0], "YlOrBr", alpha=0.6, vmin=0, interpolation="nearest")
        axes.figure.colorbar(image, ax=axes, label=name, shrink=0.8)
    words = []
    if "path" in values:
        path = _cells(values["path"])
        plot_cells(axes, path, COLOURS["astar"], "path")
        words.append(f"{len(path)} cells" if len(path) else "no path")
    words += [
        f"{name} {float(values[name]):.4g}" for name in ("cost", "hardness") if name in values
    ]
    for name, letter in (("start", "S"), ("goal", "G")):
        if name in values:
            mark(axes, letter, *values[name])
    axes.set_title(", ".join(words))
    return axes


def plot_prediction(
    occupancy: ArrayLike,
    predicted: ArrayLike,
    truth: ArrayLike,
    axes: Axes | None = None,
    *,
    scores: ArrayLike | None = None,
) -> Axes:
    """Draw a predicted path over the true one, and a cross on each predicted cell that is occupied.

    Args:
        occupancy: (H, W), 0 free and 1 occupied.
        predicted: (k, 2) cells (row, col), (0, 2) for none; rows of -1, padding, are left out.
        truth: likewise.
        axes: where to draw; a new figure without.
        scores: (H, W), what the model says of each cell, drawn as a shade; from low to high.
    """
    grid = np.asarray(occupancy)
    axes = plot_grid(grid, axes)
    if scores is not None:
        axes.imshow(scores, cmap="Purples", alpha=0.6 * (grid == 0), interpolation="nearest")
    true = _cells(truth)
    found = _cells(predicted)
    plot_cells(axes, true, COLOURS["astar"], _in_words("true", true), lane=-1)
    plot_cells(axes, found, COLOURS["bfs"], _in_words("predicted", found), lane=1)
    inside = found[((found >= 0) & (found < grid.shape)).all(axis=1)]
    hit = inside[grid[tuple(inside.T)] == 1]
    if len(hit):
        label = f"{len(hit)} in occupied cells"
        axes.plot(hit[:, 1], hit[:, 0], "x", color="#CC79A7", ms=7, mew=2, label=label)
    ends = true if len(true) else found
    if len(ends):
        mark(axes, "S", *ends[0])
        mark(axes, "G", *ends[-1])
    head(axes, "predicted and true path")
    return axes


def plot_roadmap(
    occupancy: ArrayLike,
    vertices: ArrayLike,
    edges: ArrayLike,
    axes: Axes | None = None,
    *,
    path: ArrayLike | None = None,
) -> Axes:
    """Draw a roadmap: its samples and the edges between them.

    Args:
        occupancy: (H, W), 0 free and 1 occupied.
        vertices: (n, 2) samples (row, col), a cell's centre at whole numbers.
        edges: (m, 2) integers, numbers of the vertices that each edge joins.
        axes: where to draw; a new figure without.
        path: (k, 2) cells (row, col), a path found on the roadmap.
    """
    from matplotlib.collections import LineCollection

    axes = plot_grid(occupancy, axes)
    points = np.asarray(vertices, np.float64).reshape(-1, 2)
    joined = np.asarray(edges, np.int64).reshape(-1, 2)
    label = f"{len(joined):,} edges"
    axes.add_collection(
        LineCollection(list(points[joined][..., ::-1]), colors="#56B4E9", linewidths=1, label=label)
    )
    if path is not None:
        plot_cells(axes, np.asarray(path, np.float64).reshape(-1, 2), COLOURS["bfs"], "path")
    label = f"{len(points):,} samples"
    axes.scatter(points[:, 1], points[:, 0], s=16, color=COLOURS["astar"], label=label, zorder=3)
    head(axes, "roadmap")
    return axes


def _is_dense(name: str, field: Array, grid: Array) -> bool:
    """Return whether a field has a number for each cell: masks and bit sets of moves have not."""
    return field.shape == grid.shape and name not in (*MAPS_AND_MASKS, "optimal_moves")


def _in_words(name: str, path: Ints) -> str:
    return f"{name}, {len(path)} cells" if len(path) else f"{name}: no path"


def _cells(path: ArrayLike) -> Ints:
    """Return the cells of a path, (k, 2), without the rows of -1 that fill it up."""
    cells = np.asarray(path, np.int64).reshape(-1, 2)
    return np.asarray(cells[(cells != -1).any(axis=1)])
