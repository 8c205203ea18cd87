"""What holds for every test: one thread of torch, in subprocesses too, and no judgement by the
clock.
"""

from __future__ import annotations

import os

import pytest
from helpers.examples import ARE_ALL
from hypothesis import HealthCheck, settings

# Read when torch and BLAS are first imported: many threads on few cores make tiny networks a
# hundred times slower.
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["MKL_NUM_THREADS"] = "1"

# The same examples on every machine, however busy it is.
settings.register_profile(
    "mapdata",
    derandomize=True,
    deadline=None,
    database=None,
    max_examples=100 if ARE_ALL else 20,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("mapdata")


@pytest.hookimpl(tryfirst=True)  # before pytest chooses the tests by their marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark property tests as slow where they try all examples."""
    for item in items:
        function = getattr(item, "obj", None)
        if ARE_ALL and getattr(function, "is_hypothesis_test", False):
            item.add_marker("slow")
