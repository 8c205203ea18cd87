"""The lattice: the order of moves, and costs of integers that order paths as exact ones do."""

from __future__ import annotations

from decimal import Decimal, localcontext
from random import Random

from mapdata.search import MAX_CELLS, STEPS
from mapdata.search.lattice import DIAGONAL, UNIT


def test_the_order_of_moves() -> None:
    """North, east, south, west, then north-east and on with the sun."""
    assert STEPS.tolist() == [[-1, 0], [0, 1], [1, 0], [0, -1], [-1, 1], [1, 1], [1, -1], [-1, -1]]


def test_costs_order_paths_exactly() -> None:
    """Of any two paths on the largest grid, the closest ones included, the shorter one costs less."""
    draw = Random(0)
    pairs = [(draw.randrange(MAX_CELLS), draw.randrange(MAX_CELLS)) for _ in range(2000)]
    straight, diagonal = 1, 1
    while straight < MAX_CELLS:  # the convergents of the root of 2: where two paths are closest
        pairs.append((straight, diagonal))
        straight, diagonal = straight + 2 * diagonal, straight + diagonal
    with localcontext() as context:
        context.prec = 50
        root = Decimal(2).sqrt()
        for straight, diagonal in pairs:
            exact = straight - diagonal * root
            assert (straight * UNIT > diagonal * DIAGONAL) == (exact > 0), (straight, diagonal)
    assert DIAGONAL % 2 == 1  # so that a pair can be read back from its sum
