"""Arrow heads along a path, with equal distances on the page whatever the size of the map."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backend_bases import RendererBase
from matplotlib.collections import PathCollection
from matplotlib.path import Path
from matplotlib.transforms import Affine2D, IdentityTransform, Transform

from mapdata.arrays import Array, Floats

SPACING = 96.0
"""Distance along a path between arrow heads, in points: 16 cells in the figure of a 64 x 64 map."""

MIN_LENGTH = 60.0
"""Minimal length of a path with an arrow head, in points; its ends may bear marks of 14 points."""

MIN_DISTANCE = 48.0
"""Minimal straight distance between arrow heads, in points, since paths in mazes wind."""

_REACH = 12.0
"""An arrow head has the direction of the path between this many points before and behind it.

So an arrow on stairs points along their slope and not along a step.
"""

_HEAD = Path(9.5 * np.array([(0, 0.55), (-0.35, -0.55), (0.35, -0.55), (0, 0.55)]))
"""A triangle that points up, in points. It is narrow, so that its tip is recognised."""


class ArrowHeads(PathCollection):
    """The arrow heads of a path.

    Their number and positions are computed when the figure is drawn. So their distances on the page
    are the same for maps and axes of any size.
    """

    def __init__(self, path: Array, transform: Transform, colour: str) -> None:
        """Store the path; the arrow heads are placed when they are drawn.

        Args:
            path: (k, 2) points (x, y), in the coordinates of ``transform``.
            transform: from the coordinates of the path to pixels.
            colour: of the arrow heads.
        """
        super().__init__(
            [],
            sizes=[1.0],  # _HEAD is in points already
            facecolor=colour,
            edgecolor="white",
            linewidth=0.7,
            zorder=3,
            transform=IdentityTransform(),  # the size does not depend on the axes
            offsets=np.empty((0, 2)),
            offset_transform=transform,
        )
        self.set_in_layout(False)  # arrow heads lie inside the axes and need no room of their own
        self._path = path
        self._path_on_page: Floats = np.empty((0, 2))

    def draw(self, renderer: RendererBase) -> None:
        """Draw the arrow heads; they are placed again if the path has moved on the page."""
        figure: Any = self.figure  # matplotlib's type hints also allow None here
        pixels_per_point = figure.dpi / 72
        to_pixels = self.get_offset_transform()
        path_on_page = to_pixels.transform(self._path.astype(float)) / pixels_per_point
        if not np.array_equal(path_on_page, self._path_on_page):
            self._path_on_page = path_on_page
            positions, angles = place_heads(path_on_page)
            self.set_offsets(to_pixels.inverted().transform(pixels_per_point * positions))
            self.set_paths([Affine2D().rotate_deg(angle).transform_path(_HEAD) for angle in angles])
        super().draw(renderer)


def place_heads(path: Floats) -> tuple[Floats, Floats]:
    """Return the positions and directions of the arrow heads of a path.

    Args:
        path: (k, 2) points (x, y) on the page, y upwards, in points of 1/72 inch.

    Returns:
        (n, 2) positions on the path, and (n,) angles in degrees counterclockwise from "up".
    """
    step_lengths = np.hypot(*np.diff(path, axis=0).T)
    distance_from_start = np.concatenate(([0.0], np.cumsum(step_lengths)))
    length = distance_from_start[-1] if len(path) else 0.0
    if length < MIN_LENGTH:
        return np.empty((0, 2)), np.empty(0)
    count = max(round(length / SPACING), 1)
    distances = (np.arange(count) + 0.5) * length / count
    positions = _points_at(path, distance_from_start, distances)
    kept: list[int] = []
    for k in range(count):
        to_kept_heads = np.hypot(*(positions[kept] - positions[k]).T)
        if (to_kept_heads >= MIN_DISTANCE).all():
            kept.append(k)
    before = _points_at(path, distance_from_start, distances[kept] - _REACH)
    behind = _points_at(path, distance_from_start, distances[kept] + _REACH)
    direction = behind - before
    angles = np.degrees(np.arctan2(direction[:, 1], direction[:, 0])) - 90
    return positions[kept], angles


def _points_at(path: Floats, distance_from_start: Floats, distances: Floats) -> Floats:
    """Return the points of a path at ``distances`` from its start along it, (n, 2).

    Args:
        path: (k, 2) points.
        distance_from_start: (k,) of each point of the path, along it.
        distances: (n,); they are clipped to the length of the path.
    """
    x = np.interp(distances, distance_from_start, path[:, 0])
    y = np.interp(distances, distance_from_start, path[:, 1])
    return np.stack([x, y], axis=1)
