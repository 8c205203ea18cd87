"""How much a test tries: by default a part of its examples and none of its slow cases.

`.ci/run` tries all.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, TypeAlias

import pytest
from hypothesis import settings

ARE_ALL = os.environ.get("MAPDATA_ALL_EXAMPLES") == "1"
"""Whether all examples are tried. Tests that try more of them are marked as slow then, so that
`pytest -m slow` runs them.
"""

Some: TypeAlias = Callable[[int], int]
"""The type of the fixture `some`."""

FEWEST = 10
"""Number of examples that a property test tries at least."""


def examples(count: int, base: settings | None = None) -> settings:
    """Return hypothesis settings of so many examples, or by default of a tenth of them.

    Args:
        count: number of examples in the full run.
        base: settings that stay otherwise.
    """
    few = max(count // 10, min(count, FEWEST))
    return settings(base, max_examples=count if ARE_ALL else few)


def some(count: int) -> int:
    """Return how many of so many maps, draws or cells a test tries: a fifth by default, rounded up.

    Tests get this function as the fixture `some`, by which `.ci/run` knows them.
    """
    return count if ARE_ALL else -(-count // 5)


def slow(*values: Any) -> Any:
    """Return a case of a parametrized test that the default run leaves out."""
    return pytest.param(*values, marks=pytest.mark.slow)
