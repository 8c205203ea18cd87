"""Points and cells of a map in metres."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from mapdata.arrays import Floats


def to_metres(
    *,
    points: ArrayLike | None = None,
    cells: ArrayLike | None = None,
    rows: int,
    resolution: float,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Floats:
    """Return points or the middles of cells of a map, (row, col), as (x, y) in metres.

    Both are counted in cells from the upper left corner of the map, but a point is continuous: the
    middle of cell (r, c) is the point (r + 0.5, c + 0.5). So exactly one of both is given, by name.

    Args:
        points: (..., 2), such as taut lines, waypoints and samples of roadmaps.
        cells: (..., 2) integers, such as paths, starts and goals.
        rows: number of rows of the map.
        resolution: metres per cell.
        origin: (x, y, yaw) of the lower left corner of the map, in metres and radians, as in the
            .yaml file of a ROS map.

    Returns:
        (..., 2) float64. For yaw 0, x grows with the column, and y from the last row to the first.

    Raises:
        ValueError: points and cells, or neither; another shape of them; cells that are not
            integers, or padding of -1; an origin without yaw.

    >>> to_metres(points=[[2, 0], [0.5, 0.5]], rows=2, resolution=0.1)
    array([[0.  , 0.  ],
           [0.05, 0.15]])
    >>> to_metres(cells=[0, 0], rows=2, resolution=0.1)
    array([0.05, 0.15])
    """
    if (points is None) == (cells is None):
        raise ValueError(
            f"points and cells: got {'neither' if points is None else 'both'}, expected one: "
            "cells=[(r, c)] is the middle of a cell, points=[(r + 0.5, c + 0.5)]"
        )
    if points is not None:
        name, from_corner = "points", np.asarray(points, np.float64)
    else:
        if np.asarray(cells).dtype.kind not in "iu":
            raise ValueError(
                f"cells: got numbers of {np.asarray(cells).dtype}, expected integers; points= "
                "takes others"
            )
        if (np.asarray(cells) == -1).any():
            raise ValueError(
                "cells: got -1, the padding of paths in batches, expected cells: "
                "path[path[:, 0] >= 0] leaves it out"
            )
        name, from_corner = "cells", np.asarray(cells) + 0.5
    if from_corner.shape[-1:] != (2,):
        raise ValueError(
            f"{name}: got shape {from_corner.shape}, expected (..., 2): row and column"
        )
    if np.shape(origin) != (3,):
        raise ValueError(
            f"origin: got {origin!r}, expected (x, y, yaw) of the lower left corner of the map"
        )
    right = from_corner[..., 1] * resolution
    up = (rows - from_corner[..., 0]) * resolution
    x, y, yaw = origin
    # The map is rotated about its lower left corner by yaw.
    east = right * math.cos(yaw) - up * math.sin(yaw)
    north = right * math.sin(yaw) + up * math.cos(yaw)
    return np.stack((x + east, y + north), axis=-1)
