"""The default run tries each value of each parameter, and no test loses a case of its own."""

from __future__ import annotations

import itertools

from helpers.selection import each_choice

ROWS = 5
COLUMNS = 3
COMBINATIONS = list(itertools.product(range(ROWS), range(COLUMNS)))


def test_as_many_combinations_as_the_longest_parameter_has_values() -> None:
    """Together they have each value of both."""
    cases = [frozenset({("row", str(i)), ("column", str(j))}) for i, j in COMBINATIONS]
    chosen = [COMBINATIONS[k] for k in each_choice(cases)]
    assert {i for i, _ in chosen} == set(range(ROWS))
    assert {j for _, j in chosen} == set(range(COLUMNS))
    assert len(chosen) == ROWS


def test_all_values_of_a_single_parameter_are_tried() -> None:
    """Nothing else would try them."""
    cases = [frozenset({("row", str(i))}) for i in range(ROWS)]
    assert each_choice(cases) == list(range(ROWS))
