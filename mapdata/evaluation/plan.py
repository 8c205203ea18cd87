"""What a planner is, and what it answers to a problem: `Planner` and `Plan`."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from mapdata.arrays import Bytes, Ints, summary
from mapdata.limits import Cell


class Plan(NamedTuple):
    """The answer of a planner to a problem.

    Attributes:
        path: (k, 2) integer cells from start to goal, both included; (0, 2) without a path.
        expansions: number of cells that the planner expanded, the goal included.
        prepared: number of cells that it computed something of before the search: those of a field
            of costs to the goal, or all cells of a map that a network looks at.
        looks: number of different cells that the search visited to see which neighbours are free,
            the expanded ones included; None if it visited no others. Jump point search counts
            the cells that its scans pass, each as often as one passes it.
        order: (H, W) int32, the number of the expansion of each cell, -1 for cells that were not
            expanded, for `mapdata.plotting.plot_search`; None if the planner does not say.
    """

    path: npt.NDArray[np.integer[Any]]
    expansions: int
    prepared: int = 0
    looks: int | None = None
    order: npt.NDArray[np.integer[Any]] | None = None

    def __repr__(self) -> str:
        return summary(self)


class Planner(Protocol):
    """Anything that plans a path on a grid.

    A planner takes terrain if its `plan_batch`, or its `plan` if it has no `plan_batch`, has a
    parameter ``terrain``: the costs of the cells, uint8 of the shape of the grid or grids, 0 where
    they are occupied. `evaluate` passes it by name, and only where problems have terrain.

    A planner for one rule of moves says so in an attribute ``movement``, a `Movement`: `evaluate`
    then refuses problems of another one.
    """

    @property
    def name(self) -> str:
        """Its name in the table."""

    def plan(self, grid: Bytes, start: Cell, goal: Cell) -> Plan:
        """Return a path on ``grid``, (H, W) of 0 free and 1 occupied."""


@runtime_checkable
class BatchPlanner(Planner, Protocol):
    """A planner that also solves many problems in one call."""

    def plan_batch(self, grids: Bytes, starts: Ints, goals: Ints) -> list[Plan]:
        """Return a plan for each of the B problems: grids (B, H, W), starts and goals (B, 2)."""


class Batched:
    """Base class of planners with `plan_batch`: it solves a single problem as a batch of one."""

    def plan(
        self: BatchPlanner,
        grid: npt.ArrayLike,
        start: npt.ArrayLike,
        goal: npt.ArrayLike,
        terrain: npt.ArrayLike | None = None,
    ) -> Plan:
        """Return the path from ``start`` to ``goal`` on ``grid``, (H, W).

        ``terrain``, (H, W), is for a `plan_batch` that takes it: the cost of each cell.
        """
        batch = np.asarray(grid)[None], np.array([start]), np.array([goal])
        terrain_argument: dict[str, Any] = {}
        if terrain is not None:
            terrain_argument["terrain"] = np.asarray(terrain)[None]
        return self.plan_batch(*batch, **terrain_argument)[0]
