"""How one moves on a grid: `Movement`, and the table of moves."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mapdata.checks import check_flag, check_number

# Kernels read this table, so it belongs to the sources that name their cache: those with the word
# @kernel in them.
STEPS = np.array([(-1, 0), (0, 1), (1, 0), (0, -1), (-1, 1), (1, 1), (1, -1), (-1, -1)], np.int64)
"""(8, 2): the moves N, E, S, W, NE, SE, SW, NW as (row, col); their numbers are their codes."""


@dataclass(frozen=True)
class Movement:
    """How one moves on a grid.

    Attributes:
        connectivity: 4 (north, east, south, west) or 8 (diagonals too); the paper names neither.
        corner_cutting: True lets a diagonal step pass between or beside occupied cells; False
            demands that both orthogonal neighbours are free. Only with 8.
        diagonal_cost: sqrt(2), or 1 to reproduce data that count moves. Only with 8.

    Raises:
        ValueError: a value that is not one of these, or one that would do nothing.
    """

    connectivity: int = 4
    corner_cutting: bool = False
    diagonal_cost: float = math.sqrt(2)

    def __post_init__(self) -> None:
        """Check the values and bring ``diagonal_cost`` to exactly 1.0 or sqrt(2)."""
        if self.connectivity not in (4, 8):
            raise ValueError(f"connectivity: got {self.connectivity!r}, expected 4 or 8")
        check_flag("corner_cutting", self.corner_cutting)
        cost = check_number("diagonal_cost", self.diagonal_cost)
        near = [exact for exact in (1.0, math.sqrt(2)) if math.isclose(cost, exact, rel_tol=1e-6)]
        if not near:
            raise ValueError(f"diagonal_cost: got {cost!r}, expected 1 or sqrt(2) = {math.sqrt(2)}")
        cost = near[0]
        object.__setattr__(self, "diagonal_cost", cost)
        object.__setattr__(self, "connectivity", int(self.connectivity))  # not 4.0, which equals 4
        if self.connectivity == 4 and (self.corner_cutting or cost == 1):
            raise ValueError(
                "connectivity 4 has no diagonal moves: corner_cutting and diagonal_cost would do "
                "nothing"
            )


NEURAL_ASTAR = Movement(8, corner_cutting=True, diagonal_cost=1)
"""How Neural A* moves: eight neighbours, corners may be cut, and every move costs 1."""
