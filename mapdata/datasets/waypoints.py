"""The field ``waypoints``: points along the taut lines of paths."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from mapdata.arrays import Bytes, Float32s, Ints
from mapdata.checks import check_count, check_flag
from mapdata.movement import Movement
from mapdata.search.taut import NOT_FREE, robot_of, write_waypoints

NO_TAUT_LINES = (
    "waypoints and bends: got maps with terrain, expected maps whose free cells all cost the same, "
    "since a taut line ignores costs; take the field 'path'"
)
"""The error for taut lines on terrain, where a straight line may cost more than a bent one."""


class LinedBatch(Protocol):
    """What `Waypoints` needs of a `Batch`, which describes it."""

    @property
    def movement(self) -> Movement:
        """Movement of the paths."""

    @property
    def problems(self) -> Ints:
        """(B,) int64."""

    @property
    def paths(self) -> tuple[Ints, Ints, Ints]:
        """The cells of all paths, where each of them begins, and their iterations."""

    @property
    def obstacles(self) -> Bytes:
        """(B, H, W) uint8, the maps before inflation."""

    @property
    def radius_cells(self) -> float:
        """Radius of the robot, in cells."""

    @property
    def has_terrain(self) -> bool:
        """Whether the maps have terrain."""


def divided_lines(batch: LinedBatch, count: int) -> tuple[Float32s, Ints]:
    """Return ``count`` points of each taut line, and the numbers of bends as `write_waypoints`.

    Raises:
        ValueError: the maps have terrain.
    """
    if batch.has_terrain:
        raise ValueError(NO_TAUT_LINES)
    points = np.empty((len(batch.problems), count, 2), np.float32)
    cells, offsets, _ = batch.paths
    robot = robot_of(batch.radius_cells)
    cuts_corners = batch.movement.corner_cutting
    bends = write_waypoints(batch.obstacles, cells, offsets, robot, cuts_corners, points)
    return points, bends


@dataclass(frozen=True)
class Waypoints:
    """The field ``waypoints``, with a number of points of your own.

    It stands among the names in ``fields=``: ``fields=("map", "start", "goal", Waypoints(64))``.

    The taut line of the served path (`mapdata.pull_taut`) is divided by ``count`` points. All its
    bends are among them, and the largest gap is as small as possible. All segments between the
    points are proved free for the radius of the robot.

    Attributes:
        count: T, the number of points, start and goal included; at least 2. A line of more than T -
            2 bends does not fit. Above 130, short lines may hold a point twice.
        fill: what a problem gets whose line does not fit, or is not free: False for an error that
            names it, True for points of -1, as without a path. Lines that are not free occur only
            for a robot with a radius whose movement cuts corners.
    """

    count: int = 32
    fill: bool = False

    __name__: ClassVar[str] = "waypoints"

    def __post_init__(self) -> None:
        """Check the values."""
        object.__setattr__(self, "count", check_count("count", self.count, minimum=2))
        check_flag("fill", self.fill)

    def __call__(self, batch: LinedBatch) -> Float32s:
        """Return the points, (B, T, 2) float32.

        Raises:
            ValueError: a line that does not fit or is not free, unless ``fill`` is set.
        """
        points, bends = divided_lines(batch, self.count)
        is_refused = (bends > self.count - 2) | (bends == NOT_FREE)
        if not self.fill and is_refused.any():
            refused = int(np.argmax(is_refused))
            problem = f"waypoints: problem {batch.problems[refused]}"
            if bends[refused] == NOT_FREE and batch.radius_cells == 0:
                raise ValueError(
                    f"{problem} has a stored path through occupied cells, expected an undamaged "
                    "dataset: 'mapdata verify' checks it"
                )
            if bends[refused] == NOT_FREE:
                raise ValueError(
                    f"{problem} has no free line for a radius of {batch.radius_cells:g} cells, "
                    "expected a movement that cuts no corners, or Waypoints(fill=True)"
                )
            raise ValueError(
                f"{problem} has a line of {bends[refused]} bends, expected at most "
                f"{self.count - 2} for {self.count} points: take Waypoints({bends[refused] + 2}), "
                f"Waypoints({self.count}, fill=True), or MapDataset.filter(bends=(0, "
                f"{self.count - 2}))"
            )
        return points
