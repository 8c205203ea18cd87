"""The moves on a grid: `Movement`, which says which are legal, and the table of their steps."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mapdata.checks import check_flag, check_number

# Kernels use this table, so their cache must change when the table does. A hash of all sources with
# the word @kernel in them names the cache, and this comment makes the file one of these.
STEPS = np.array([(-1, 0), (0, 1), (1, 0), (0, -1), (-1, 1), (1, 1), (1, -1), (-1, -1)], np.int64)
"""(8, 2) int64: the moves N, E, S, W, NE, SE, SW, NW as (row, col); a move's index is its code."""


@dataclass(frozen=True)
class Movement:
    """Which moves are legal on a grid, and what a diagonal move costs; a straight one costs 1.

    Attributes:
        connectivity: 4 (north, east, south, west) or 8 (diagonals too). The paper does not say
            which of them it uses.
        corner_cutting: True lets a diagonal move pass between or beside occupied cells; False
            requires that both orthogonal neighbours are free. Only with connectivity 8.
        diagonal_cost: sqrt(2), or 1 to reproduce data that count moves. Only with connectivity 8.

    Raises:
        ValueError: an argument has another value, or has no effect under connectivity 4.
    """

    connectivity: int = 4
    corner_cutting: bool = False
    diagonal_cost: float = math.sqrt(2)

    def __post_init__(self) -> None:
        """Check the arguments and replace approximations of 1.0, sqrt(2), 4 and 8 by these."""
        if self.connectivity not in (4, 8):
            raise ValueError(f"connectivity: got {self.connectivity!r}, expected 4 or 8")
        check_flag("corner_cutting", self.corner_cutting)
        cost = check_number("diagonal_cost", self.diagonal_cost)
        if math.isclose(cost, 1.0, rel_tol=1e-6):
            exact_cost = 1.0
        elif math.isclose(cost, math.sqrt(2), rel_tol=1e-6):
            exact_cost = math.sqrt(2)
        else:
            raise ValueError(f"diagonal_cost: got {cost!r}, expected 1 or sqrt(2) = {math.sqrt(2)}")
        object.__setattr__(self, "diagonal_cost", exact_cost)
        # The float 4.0 equals 4 and has passed the check, but it would be stored as "4.0".
        object.__setattr__(self, "connectivity", int(self.connectivity))
        if self.connectivity == 4 and (self.corner_cutting or exact_cost == 1):
            raise ValueError(
                "connectivity 4 has no diagonal moves: corner_cutting and diagonal_cost would do "
                "nothing"
            )


NEURAL_ASTAR = Movement(8, corner_cutting=True, diagonal_cost=1)
"""The movement of Neural A*: eight neighbours, corners may be cut, and every move costs 1."""


def check_movement(movement: object) -> None:
    """Raise a ValueError if ``movement`` is not a `Movement`."""
    if not isinstance(movement, Movement):
        raise ValueError(f"movement: got {movement!r}, expected a Movement, such as Movement(8)")
