"""Maps as the fit sees them, windows of them around parts of drives, and paths in the windows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from mapdata.arrays import Bytes, Float32s, Floats, Ints, offsets_of
from mapdata.costmaps.drives import Drive
from mapdata.formats import RosMap
from mapdata.movement import Movement
from mapdata.search import clearance, inflate, search_batch, terrain_from_costs

MOVEMENT = Movement(8, corner_cutting=True)
"""Drives may pass corners of the inflated map, since inflation keeps the robot clear of obstacles.
"""

MAX_CLEARANCE = 2.0
"""Clearances above it count as it, in metres: no driver minds a wall that is farther away."""

MARGIN = 12
"""Number of cells around a part in which training looks for cheaper paths."""

Planes: TypeAlias = Callable[[Bytes, float], npt.ArrayLike]
"""A function from a grid (H, W), 0 free and 1 occupied, and its resolution in metres per cell, to
planes (P, H, W).
"""


def clearance_plane(grid: Bytes, resolution: float) -> Float32s:
    """Return one plane, (1, H, W): the distance to the nearest obstacle, in metres, at most 2."""
    metres: Float32s = np.minimum(clearance(grid) * resolution, MAX_CLEARANCE)[None]
    return metres


@dataclass(frozen=True, eq=False)
class Site:
    """A map as the fit sees it.

    Attributes:
        ros_map: the map.
        grid: (H, W), where the middle of the robot can be.
        planes: (P, H, W) float32, as the function of the user returned them.
    """

    ros_map: RosMap
    grid: Bytes
    planes: Float32s

    @cached_property
    def obstacle_distance(self) -> Floats:
        """The distance from the middle of a cell to that of the nearest occupied one, in metres.

        Raises:
            ModuleNotFoundError: scipy is missing.
        """
        try:
            from scipy.ndimage import distance_transform_edt
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(
                "fit_costmap needs scipy, the extra [examples]: pip install scipy", name="scipy"
            ) from error
        cells = distance_transform_edt(self.ros_map.grid("occupied") == 0)
        return np.asarray(cells, np.float64) * self.ros_map.resolution


def site_of(ros_map: RosMap, robot_radius: float, planes: Planes = clearance_plane) -> Site:
    """Return a map with its planes.

    Raises:
        ValueError: the planes have another shape, or numbers that are not finite.
    """
    obstacles = ros_map.grid("occupied")
    grid = inflate(obstacles, robot_radius / ros_map.resolution)
    stack = np.asarray(planes(obstacles, ros_map.resolution), np.float32)
    if stack.ndim != 3 or stack.shape[1:] != grid.shape or not len(stack):
        raise ValueError(
            f"planes: got shape {stack.shape}, expected (P, {grid.shape[0]}, {grid.shape[1]})"
        )
    if not np.isfinite(stack).all():
        raise ValueError("planes: got numbers that are not finite")
    return Site(ros_map, grid, stack)


class Paths(NamedTuple):
    """Paths in windows, one in each.

    Attributes:
        cells: (M, 3), the cells of all paths one after another: number of the window, row, column.
        offsets: (B + 1,), where each path begins, and where the last one ends.
    """

    cells: Ints
    offsets: Ints

    @property
    def weights(self) -> Float32s:
        """How often the cost of each cell counts, (M,).

        A move costs the mean of its two cells times its length.
        """
        steps = np.diff(self.cells, axis=0)
        lengths = np.where(np.abs(steps[:, 1:]).sum(axis=1) == 2, MOVEMENT.diagonal_cost, 1.0)
        halves = np.where(steps[:, 0] == 0, lengths, 0) / 2
        return (np.append(halves, 0) + np.insert(halves, 0, 0)).astype(np.float32)


class Windows(NamedTuple):
    """Parts of drives in windows of their maps, all of one size.

    Attributes:
        planes: (B, P, h, w) float32.
        grids: (B, h, w), occupied outside of the map.
        driven: the parts.
    """

    planes: Float32s
    grids: Bytes
    driven: Paths

    def planned(self, costs: Floats | Float32s) -> Paths:
        """Return the cheapest paths between the ends of the parts, under costs (B, h, w)."""
        terrain = terrain_from_costs(np.where(self.grids, 1, costs), self.grids)
        cells, offsets = self.driven
        starts, goals = cells[offsets[:-1], 1:], cells[offsets[1:] - 1, 1:]
        found = search_batch("astar", self.grids, starts, goals, MOVEMENT, terrain=terrain)
        numbers = np.repeat(np.arange(len(starts)), np.diff(found.offsets))
        return Paths(np.column_stack([numbers, found.cells]), found.offsets)


def windows_of(sites: list[Site], parts: list[Drive]) -> Windows:
    """Return parts of drives with the cells around them."""
    lows = [part.cells.min(axis=0) - MARGIN for part in parts]
    extents = [
        part.cells.max(axis=0) + MARGIN + 1 - low for part, low in zip(parts, lows, strict=True)
    ]
    height, width = np.max(extents, axis=0).tolist()
    planes = np.zeros((len(parts), len(sites[0].planes), height, width), np.float32)
    grids = np.ones((len(parts), height, width), np.uint8)
    for b, (part, low) in enumerate(zip(parts, lows, strict=True)):
        site = sites[part.map]
        top, left = np.maximum(low, 0).tolist()
        rows = slice(top, min(low[0] + height, site.grid.shape[0]))
        columns = slice(left, min(low[1] + width, site.grid.shape[1]))
        own_rows = slice(rows.start - low[0], rows.stop - low[0])
        own_columns = slice(columns.start - low[1], columns.stop - low[1])
        planes[b, :, own_rows, own_columns] = site.planes[:, rows, columns]
        grids[b, own_rows, own_columns] = site.grid[rows, columns]
    counts = np.array([len(part.cells) for part in parts])
    cells = np.concatenate([part.cells - low for part, low in zip(parts, lows, strict=True)])
    numbers = np.repeat(np.arange(len(parts)), counts)
    return Windows(planes, grids, Paths(np.column_stack([numbers, cells]), offsets_of(counts)))
