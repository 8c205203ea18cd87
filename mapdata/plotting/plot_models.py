"""Figures of a sample, of a prediction with a shortest path, and of a roadmap.

Each function draws on axes and returns them, as in `mapdata.plotting.plot`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mapdata.arrays import Array, Ints
from mapdata.limits import MAPS_AND_MASKS
from mapdata.movement import Movement
from mapdata.plotting.plot import (
    COLOURS,
    mark,
    new_axes,
    panel_size,
    plot_cells,
    plot_ends,
    plot_grid,
    put_header,
    shade_cells,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

_COLLISION_COLOUR = "#E69F00"

MAX_SAMPLES = 9
"""Largest number of samples that one figure shows."""


def plot_sample(sample: tuple[Any, ...], axes: Axes | None = None) -> Axes:
    """Draw a sample of a dataset, or the first 9 of a batch.

    The figure shows the map, start S, goal G, path and waypoints, as far as the sample has these
    fields, and its first dense field, such as ``cost_to_go``, as a shade; without one the costs of
    ``terrain``, unless all cells cost the same. All samples of a batch have one scale. Free cells
    without a value, which cannot reach the goal, are grey. Masks are not drawn.

    ``plot_sample(dataset[:9]).figure.savefig("batch.png")`` writes a picture.

    Args:
        sample: what ``dataset[i]`` or a loader returns, a NamedTuple of tensors; with the field
            ``map`` or ``free``.
        axes: where to draw a single sample; default a new figure. A batch needs a new figure.

    Returns:
        The axes; for a batch those of its first sample.

    Raises:
        ValueError: no map, no sample, or axes for a batch.
    """
    if not hasattr(sample, "_asdict"):
        raise ValueError(f"sample: got a {type(sample).__name__}, expected one without transform=")
    fields = {name: np.asarray(tensor.cpu()) for name, tensor in sample._asdict().items()}
    grid = None
    if "map" in fields:
        grid = fields["map"]
    elif "free" in fields:
        grid = 1 - fields["free"]
    is_batch = grid is not None and grid.ndim == 4
    if grid is not None and len(grid) == 0:
        raise ValueError("sample: got a batch without problems, expected at least one")
    if grid is None or (is_batch and axes is not None):
        raise ValueError(
            f"sample: got {sample}, expected one sample, or more without axes, with a map"
        )
    shade_name = _shade_name(fields, grid)
    if not is_batch:
        axes = axes or new_axes()[0]
        limits = _shade_limits(shade_name, fields, grid)
        image = _plot_problem(fields, grid[0], shade_name, limits, axes)
        if image is not None:
            scale_axes = axes.inset_axes((1.03, 0, 0.05, 1))  # as high as the map
            axes.figure.colorbar(image, cax=scale_axes, label=shade_name)
        return axes
    count = min(len(grid), MAX_SAMPLES)
    shown = {name: field[:count] for name, field in fields.items()}
    limits = _shade_limits(shade_name, shown, grid[:count])
    columns = math.ceil(math.sqrt(count))
    rows = math.ceil(count / columns)
    width, height = panel_size(grid.shape[-2:], 3.3, (0.9, 0.9))
    all_axes = new_axes(rows, columns, (width * columns, height * rows))
    for k in range(count):
        one = {name: field[k] for name, field in shown.items()}
        image = _plot_problem(one, grid[k, 0], shade_name, limits, all_axes[k])
    for unused in all_axes[count:]:
        unused.set_axis_off()
    if image is not None:
        parent_axes: Any = all_axes  # one scale at the right of all maps
        all_axes[0].figure.colorbar(image, ax=parent_axes, label=shade_name, aspect=40)
    return all_axes[0]


def _shade_name(fields: dict[str, Array], grid: Array) -> str | None:
    """Return the name of the field of a sample or batch that is drawn as a shade, if any."""
    dense_names = [name for name, field in fields.items() if _is_dense(name, field, grid)]
    if not dense_names and "terrain" in fields and fields["terrain"].max() > 1:
        dense_names = ["terrain"]
    return dense_names[0] if dense_names else None


def _has_no_value(name: str, field: Array) -> Array:
    """Return the cells where a dense field has no value, such as those without a path."""
    # A ratio of 0 says that the cell cannot reach the goal.
    return field <= 0 if name == "heuristic_ratio" else field < 0


def _shade_limits(
    name: str | None, fields: dict[str, Array], grid: Array
) -> tuple[float, float] | None:
    """Return the lowest and the highest number of the scale of a dense field.

    None if no field is drawn, or if no free cell has a value.
    """
    if name is None:
        return None
    values = fields[name][(grid == 0) & ~_has_no_value(name, fields[name])]
    if len(values) == 0:
        return None
    if name == "heuristic_ratio":
        # Most ratios are nearly 1, so a scale from 0 on would make all of them equally dark.
        return float(values.min(initial=0.9)), 1.0
    return 0.0, float(values.max())


def _plot_problem(
    fields: dict[str, Array],
    grid: Array,
    shade_name: str | None,
    limits: tuple[float, float] | None,
    axes: Axes,
) -> AxesImage | None:
    """Draw one sample, and return the image of its dense field.

    Args:
        fields: of the sample, by name.
        grid: (H, W), 0 free and 1 occupied.
        shade_name: the field that is drawn as a shade, if any.
        limits: the lowest and the highest number of its scale.
        axes: where to draw.
    """
    plot_grid(grid, axes)
    image = None
    if shade_name is not None:
        numbers = fields[shade_name][0]
        no_value = _has_no_value(shade_name, numbers)
        image = shade_cells(axes, numbers, (grid == 1) | no_value)
        if limits is not None:
            image.set_clim(*limits)
        unreachable = (grid == 0) & no_value
        if unreachable.any():
            # On white they would look like the lowest values.
            greys = np.ma.masked_where(~unreachable, np.full(grid.shape, 0.7))
            axes.imshow(greys, "gray", vmin=0, vmax=1, interpolation="nearest")
    title_parts = []
    if "path" in fields:
        path = _without_padding(fields["path"], "path")
        plot_cells(axes, path, COLOURS["astar"], "path")
        title_parts.append(f"{len(path)} cells" if len(path) else "no path")
    if "waypoints" in fields and (fields["waypoints"] >= 0).all():
        # In the picture, whole numbers are the middles of cells.
        rows, columns = fields["waypoints"].T - 0.5
        axes.plot(columns, rows, color=COLOURS["seed"], marker=".", label="waypoints")
    for name in ("cost", "hardness"):
        if name in fields:
            title_parts.append(f"{name} {float(fields[name]):.4g}")
    for name, letter in (("start", "S"), ("goal", "G")):
        if name in fields:
            mark(axes, letter, *fields[name])
    axes.set_title(", ".join(title_parts))
    return image


def plot_prediction(
    occupancy: ArrayLike,
    predicted: ArrayLike,
    truth: ArrayLike | None = None,
    axes: Axes | None = None,
    *,
    scores: ArrayLike | None = None,
    movement: Movement = Movement(8),
) -> Axes:
    """Draw a predicted path beside a shortest one, and crosses on predicted cells in walls.

    The legend has the cost of each path, in cells, as if all free cells cost the same. For a
    predicted path with a move to a cell that is no neighbour it has the number of its cells.

    Args:
        occupancy: (H, W), 0 free and 1 occupied.
        predicted: (k, 2) cells (row, col) of the predicted path, (0, 2) without a path; rows of -1,
            padding, are left out.
        truth: (m, 2) cells of a shortest path, in the same form; without it, only the predicted
            path is drawn.
        axes: where to draw; default a new figure.
        scores: (H, W), scores of the model for each cell, drawn as a shade; high is dark.
        movement: what a diagonal move costs.

    Raises:
        ValueError: ``predicted`` or ``truth`` has another shape.
    """
    grid = np.asarray(occupancy)
    axes = plot_grid(grid, axes)
    if scores is not None:
        axes.imshow(scores, cmap="Purples", alpha=0.6 * (grid == 0), interpolation="nearest")
    path = _without_padding(predicted, "predicted")
    shortest = path[:0]
    if truth is not None:
        shortest = _without_padding(truth, "truth")
        label = _path_label("shortest", shortest, movement)
        plot_cells(axes, shortest, COLOURS["astar"], label, lane=-1)
    # Beside a shortest path, the predicted one is moved aside, so that both can be seen.
    lane = 0 if truth is None else 1
    label = _path_label("predicted", path, movement)
    plot_cells(axes, path, COLOURS["predicted"], label, lane=lane)
    is_inside = ((path >= 0) & (path < grid.shape)).all(axis=1)
    inside = path[is_inside]
    collisions = inside[grid[inside[:, 0], inside[:, 1]] == 1]
    if len(collisions):
        axes.plot(
            collisions[:, 1],
            collisions[:, 0],
            "x",
            color=_COLLISION_COLOUR,
            ms=7,
            mew=2,
            label=f"{len(collisions)} in walls",
        )
    path_with_ends = shortest if len(shortest) else path
    if len(path_with_ends):
        plot_ends(path_with_ends[0], path_with_ends[-1], axes)
    put_header(axes, "predicted path" if truth is None else "predicted and shortest path")
    return axes


def plot_roadmap(
    occupancy: ArrayLike,
    vertices: ArrayLike,
    edges: ArrayLike,
    axes: Axes | None = None,
    *,
    path: ArrayLike | None = None,
) -> Axes:
    """Draw a roadmap: its vertices, which are samples of free space, and the edges between them.

    Args:
        occupancy: (H, W), 0 free and 1 occupied.
        vertices: (n, 2) points (row, col); the centres of cells have whole numbers.
        edges: (m, 2) integers, numbers of the two vertices of each edge.
        axes: where to draw; default a new figure.
        path: (k, 2) points (row, col) of a path on the roadmap, from start to goal.
    """
    from matplotlib.collections import LineCollection

    axes = plot_grid(occupancy, axes)
    points = np.asarray(vertices, np.float64).reshape(-1, 2)
    vertex_pairs = np.asarray(edges, np.int64).reshape(-1, 2)
    lines = points[vertex_pairs][..., ::-1]  # (m, 2, 2): two points (x, y) of each edge
    label = f"{len(vertex_pairs):,} edges"
    axes.add_collection(LineCollection(list(lines), colors="0.65", linewidths=1, label=label))
    label = f"{len(points):,} samples"
    axes.scatter(points[:, 1], points[:, 0], s=16, color=COLOURS["sample"], label=label, zorder=3)
    if path is not None:
        on_path = np.asarray(path, np.float64).reshape(-1, 2)
        plot_cells(axes, on_path, COLOURS["astar"], "path")
        if len(on_path):
            plot_ends(on_path[0], on_path[-1], axes)
    put_header(axes, "roadmap")
    return axes


def _is_dense(name: str, field: Array, grid: Array) -> bool:
    """Return whether a field has a number for each cell; masks and sets of moves do not count."""
    return field.shape == grid.shape and name not in (*MAPS_AND_MASKS, "optimal_moves")


def _path_label(name: str, path: Ints, movement: Movement) -> str:
    """Return the text of a path, (k, 2), in a legend."""
    if len(path) == 0:
        return f"{name}: no path"
    steps = np.abs(np.diff(path, axis=0))
    if (steps.max(axis=1) != 1).any():
        return f"{name}, {len(path)} cells"
    diagonal_moves = int((steps.min(axis=1) == 1).sum())
    cost = len(steps) + diagonal_moves * (movement.diagonal_cost - 1)
    return f"{name}, cost {cost:.5g}"


def _without_padding(path: ArrayLike, name: str) -> Ints:
    """Return the cells of a path, (k, 2), without the rows of -1 at its end.

    Raises:
        ValueError: another shape; the message begins with ``name``.
    """
    cells = np.asarray(path, np.int64)
    if cells.size == 0:
        return np.empty((0, 2), np.int64)
    if cells.ndim != 2 or cells.shape[1] != 2:
        raise ValueError(
            f"{name}: got shape {cells.shape}, expected the cells (k, 2) of one path, such as "
            "path(k) of the result of search_batch"
        )
    is_padding = (cells == -1).all(axis=1)
    return np.asarray(cells[~is_padding])
