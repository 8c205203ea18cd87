"""Which cases of a test the default run tries: each value of each parameter, not each combination.

Combinatorial testing calls this each-choice coverage. A test with five movements and six maps has
30 cases, of which the default run tries six. The others are slow: `.ci/run` tries them all.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from typing import TypeAlias

import pytest

Case: TypeAlias = frozenset[tuple[str, ...]]
"""What a case is made of: the names of parameters that vary together, and which row of theirs."""


def each_choice(cases: Sequence[Case]) -> list[int]:
    """Return the places of a few cases, in order, that have together the parts of all."""
    missing = frozenset().union(*cases)
    uses: Counter[tuple[str, ...]] = Counter()
    chosen = []
    while missing:
        # The case with the most parts that are missing, and among those the one whose parts were
        # used least.
        best = max(
            range(len(cases)),
            key=lambda k: (len(missing & cases[k]), -sum(uses[part] for part in cases[k])),
        )
        chosen.append(best)
        missing -= cases[best]
        uses.update(cases[best])
    return sorted(chosen)


def parts(item: pytest.Function) -> Case:
    """Return the parts of a parametrized test: one of each `parametrize`, one of each fixture."""
    values = dict(item.callspec.params)
    found = set()
    for mark in item.iter_markers("parametrize"):
        names = mark.args[0]
        if isinstance(names, str):
            names = [name.strip() for name in names.split(",")]
        # All cases share the objects of the rows, which may have no hash.
        found.add((*names, *(str(id(values.pop(name))) for name in names)))
    found |= {(name, str(id(value))) for name, value in values.items()}
    return frozenset(found)


def mark_further_combinations(items: Iterable[pytest.Item]) -> None:
    """Mark as slow the cases of which each part is in another case of the default run."""
    tests: dict[tuple[object, str], list[pytest.Function]] = defaultdict(list)
    for item in items:
        is_slow = any(item.get_closest_marker(name) for name in ("slow", "soak"))
        if isinstance(item, pytest.Function) and hasattr(item, "callspec") and not is_slow:
            tests[item.parent, item.originalname].append(item)
    for cases in tests.values():
        chosen = each_choice([parts(case) for case in cases])
        for k in set(range(len(cases))) - set(chosen):
            cases[k].add_marker("slow")
