"""How many examples property tests try: a fifth by default, and all of them in `.ci/run`."""

from __future__ import annotations

import os

from hypothesis import settings

ARE_ALL = os.environ.get("MAPDATA_ALL_EXAMPLES") == "1"
"""Whether all examples are tried. Property tests are marked as slow then, so that `pytest -m slow`
runs them.
"""

FEWEST = 10
"""Number of examples that a property test tries at least."""


def examples(count: int, base: settings | None = None) -> settings:
    """Return hypothesis settings of so many examples, or by default of a fifth of them.

    Args:
        count: number of examples in the full run.
        base: settings that stay otherwise.
    """
    few = max(count // 5, min(count, FEWEST))
    return settings(base, max_examples=count if ARE_ALL else few)
