"""The lattice: cells, legal moves, the heuristic and hardness equal those of plain Python."""

from __future__ import annotations

from decimal import Decimal, localcontext
from math import isqrt
from random import Random

import numpy as np
import pytest
from helpers import reference

from mapdata.movement import STEPS, Movement
from mapdata.search.lattice import (
    DIAGONAL,
    MAX_PATH_COST,
    UNIT,
    WALL,
    cell_at,
    count_path_cells,
    hardness,
    heuristic,
    heuristics,
    in_cells,
    is_legal,
    lattice_of,
    load,
    move_rule,
    position,
)

MOVEMENTS = [
    pytest.param(Movement(), id="4"),
    pytest.param(Movement(8), id="8"),
    pytest.param(Movement(8, corner_cutting=True), id="8-cutting"),
    pytest.param(Movement(8, diagonal_cost=1), id="8-one"),
    pytest.param(Movement(8, corner_cutting=True, diagonal_cost=1), id="8-cutting-one"),
]


def test_a_movement_of_another_type_is_refused() -> None:
    """Such as the number of its neighbours."""
    with pytest.raises(ValueError, match="movement: got 8, expected a Movement"):
        move_rule(8)  # type: ignore[arg-type]


@pytest.mark.parametrize("movement", MOVEMENTS)
def test_legal_moves_equal_the_reference(movement: Movement) -> None:
    """From every free cell exactly the moves to its neighbours are legal; from an occupied one none
    is asked for.
    """
    grid = (np.random.default_rng(1).random((9, 13)) < 0.4).astype(np.uint8)
    lattice = lattice_of(grid.shape, move_rule(movement))
    came_from = np.full(lattice.cells, WALL)
    assert load(grid, came_from)
    assert len(lattice.offsets) == movement.connectivity
    for row, column in np.argwhere(grid == 0).tolist():
        cell = cell_at(row, column, lattice)
        assert position(cell, lattice) == (row, column)
        legal = [
            move for move in range(len(lattice.offsets)) if is_legal(came_from, cell, move, lattice)
        ]
        expected = [
            cell for cell, _ in reference.neighbours(grid.tolist(), (row, column), movement)
        ]
        assert [(row + STEPS[move, 0], column + STEPS[move, 1]) for move in legal] == expected
        assert [position(cell + lattice.offsets[move], lattice) for move in legal] == expected


@pytest.mark.parametrize("movement", MOVEMENTS)
def test_the_heuristic_equals_the_reference(movement: Movement) -> None:
    """In fixed point and as floats, of one pair of cells and of arrays."""
    ends = np.random.default_rng(2).integers(0, 1000, (2, 5, 7, 2))
    lattice = lattice_of((1000, 1000), move_rule(movement))
    costs = heuristics(ends[0], ends[1], movement)
    assert costs.shape == (5, 7)
    for at in np.ndindex(5, 7):
        pair = reference.heuristic(tuple(ends[0][at]), tuple(ends[1][at]), movement)
        rows, columns = (ends[0][at] - ends[1][at]).tolist()
        assert costs[at] == reference.as_float(pair, movement)
        assert in_cells(heuristic(rows, columns, lattice)) == costs[at]


def test_hardness() -> None:
    """Exactly 1 on straight paths, whatever the rounding, and from a cell to itself; -1 without a
    path.
    """
    movement = Movement(8)
    goals = np.array([[k, k // 3] for k in range(300)])
    starts = np.zeros_like(goals)
    lower_bounds = heuristics(starts, goals, movement)
    assert lower_bounds[0] == 0
    assert (hardness(lower_bounds, starts, goals, movement) == 1).all()
    assert (hardness(2 * lower_bounds, starts, goals, movement)[1:] == 2).all()
    assert (hardness(-np.ones(300), starts, goals, movement) == -1).all()


def test_a_path_has_one_cell_more_than_moves() -> None:
    """A missing path, which kernels report as -1 straight moves, has no cells."""
    assert count_path_cells(0, 0) == 1
    assert count_path_cells(3, 2) == 6
    assert count_path_cells(-1, 0) == 0


def test_the_order_of_moves() -> None:
    """North, east, south, west, then north-east and on with the sun."""
    assert STEPS.tolist() == [[-1, 0], [0, 1], [1, 0], [0, -1], [-1, 1], [1, 1], [1, -1], [-1, -1]]


def test_costs_order_paths_exactly() -> None:
    """Of any two paths below the bound, the closest ones included, the shorter one costs less."""
    draw = Random(0)
    pairs = [(draw.randrange(MAX_PATH_COST), draw.randrange(MAX_PATH_COST)) for _ in range(2000)]
    straight, diagonal = 1, 1
    while straight < MAX_PATH_COST:  # the convergents of the root of 2: where two paths are closest
        pairs.append((straight, diagonal))
        straight, diagonal = straight + 2 * diagonal, straight + diagonal
    with localcontext() as context:
        context.prec = 50
        root = Decimal(2).sqrt()
        for straight, diagonal in pairs:
            exact = straight - diagonal * root
            assert (straight * UNIT > diagonal * DIAGONAL) == (exact > 0), (straight, diagonal)
    assert DIAGONAL % 2 == 1  # so that a pair can be read back from its sum


@pytest.mark.slow
def test_costs_order_all_paths_exactly() -> None:
    """Whatever two paths below the bound differ by in diagonal moves, d: d * sqrt(2) lies between
    the same whole numbers as it does in fixed point, so that no difference in straight moves turns
    the other way.
    """
    for diagonal in range(1, isqrt(MAX_PATH_COST * MAX_PATH_COST // 2) + 1):
        below = isqrt(2 * diagonal * diagonal)
        assert below * UNIT < diagonal * DIAGONAL < (below + 1) * UNIT
