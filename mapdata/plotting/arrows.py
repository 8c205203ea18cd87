"""Arrow heads along a path, which are spaced on the page and not on the map."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backend_bases import RendererBase
from matplotlib.collections import PathCollection
from matplotlib.path import Path
from matplotlib.transforms import Affine2D, IdentityTransform, Transform

from mapdata.arrays import Array, Floats

SPACING = 96.0
"""Points from one arrow head of a path to the next: 16 cells of a figure of one map of 64 x 64."""

SHORTEST = 60.0
"""Points of the shortest path that bears an arrow head; its ends may bear marks of 14 points."""

CLOSEST = 48.0
"""Points between arrow heads of one path, as the crow flies: in mazes paths wind."""

_REACH = 12.0
"""Points before and behind an arrow head that its direction is taken from: of stairs, the slope."""

_HEAD = Path(9.5 * np.array([(0, 0.55), (-0.35, -0.55), (0.35, -0.55), (0, 0.55)]))
"""A triangle that points up, in points; narrow, since one with equal sides points three ways."""


class ArrowHeads(PathCollection):
    """The arrow heads of one path.

    How many there are and where they lie is decided when the figure is drawn. So they are equally
    far apart for maps of any size, in axes of any size.
    """

    def __init__(self, path: Array, transform: Transform, colour: str) -> None:
        """Keep the path.

        Args:
            path: (k, 2) points (x, y), in the coordinates of ``transform``.
            transform: from the coordinates of the path to pixels.
            colour: of the arrow heads.
        """
        super().__init__(
            [],
            sizes=[1.0],  # the paths are in points
            facecolor=colour,
            edgecolor="white",
            linewidth=0.7,
            zorder=3,
            transform=IdentityTransform(),  # they keep their size
            offsets=np.empty((0, 2)),
            offset_transform=transform,
        )
        self.set_in_layout(False)  # they lie inside the axes
        self._path = path
        self._page: Floats = np.empty((0, 2))

    def draw(self, renderer: RendererBase) -> None:
        """Place the arrow heads where the scale has changed, and draw them."""
        figure: Any = self.figure  # the stubs know of no part of a figure here
        scale = figure.dpi / 72
        page = self.get_offset_transform().transform(self._path.astype(float)) / scale
        if not np.array_equal(page, self._page):
            self._page = page
            middles, angles = heads(page)
            self.set_offsets(self.get_offset_transform().inverted().transform(scale * middles))
            self.set_paths([Affine2D().rotate_deg(a).transform_path(_HEAD) for a in angles])
        super().draw(renderer)


def heads(page: Floats) -> tuple[Floats, Floats]:
    """Return where the arrow heads of a path lie and how far they are turned.

    Args:
        page: (k, 2) points (x, y) of the path on the page, upwards, in points of 1/72 inch.

    Returns:
        (n, 2) middles on the path, and (n,) degrees counterclockwise from "up".
    """
    lengths = np.hypot(*np.diff(page, axis=0).T)
    along = np.concatenate(([0.0], np.cumsum(lengths)))
    total = along[-1] if len(page) else 0.0
    if total < SHORTEST:
        return np.empty((0, 2)), np.empty(0)
    count = max(round(total / SPACING), 1)
    middles = (np.arange(count) + 0.5) * total / count
    points = _at(page, along, middles)
    kept: list[int] = []
    for k in range(count):
        if all(np.hypot(*(points[k] - points[earlier])) >= CLOSEST for earlier in kept):
            kept.append(k)
    middles = middles[kept]
    direction = _at(page, along, middles + _REACH) - _at(page, along, middles - _REACH)
    angles = np.degrees(np.arctan2(direction[:, 1], direction[:, 0])) - 90
    return points[kept], angles


def _at(page: Floats, along: Floats, distances: Floats) -> Floats:
    """Return the points of a path at these distances from its start."""
    return np.stack([np.interp(distances, along, page[:, axis]) for axis in (0, 1)], axis=1)
