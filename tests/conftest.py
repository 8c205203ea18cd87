"""What holds for every test: one thread of torch, in subprocesses too, no judgement by the clock,
and kernels and bytecode that one of two processes makes for both.
"""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Generator
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from _pytest.doctest import DoctestModule
from helpers.cpu_times import CpuTimes
from helpers.examples import ARE_ALL, FEWEST, Some, some
from helpers.selection import mark_further_combinations
from hypothesis import HealthCheck, settings

if TYPE_CHECKING:
    from helpers.builds import Built

    from mapdata import MapGenerator

# Read when torch and BLAS are first imported: many threads on few cores make tiny networks a
# hundred times slower.
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["MKL_NUM_THREADS"] = "1"

# What is compiled from Python, and the tests with the asserts that pytest writes anew, are kept as
# pytest keeps its own cache, also where the environment asks Python not to write them (as in many
# containers): making them takes half of the time in which the tests are read.
sys.dont_write_bytecode = False

# Python's collector of cyclic garbage would look at all modules and tests again and again while
# they are read, which takes a fifth of that time.
gc.disable()

# The default run optimizes kernels less, so that compiling takes a quarter less. They have a cache
# folder of their own, since numba does not tell them from those that users run. `.ci/run` sets
# NUMBA_OPT=3, numba's own default.
if not ARE_ALL and "NUMBA_OPT" not in os.environ:
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    os.environ["NUMBA_OPT"] = "1"
    os.environ["NUMBA_CACHE_DIR"] = str(caches / "mapdata-tests")

# The same examples on every machine, however busy it is.
settings.register_profile(
    "mapdata",
    derandomize=True,
    deadline=None,
    database=None,
    max_examples=100 if ARE_ALL else FEWEST,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("mapdata")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that prints what tests cost."""
    parser.addoption("--cpu", type=int, metavar="N", help="print the CPU seconds of the N dearest")


def pytest_configure(config: pytest.Config) -> None:
    """Measure CPU seconds, if they are asked for, and share kernels with the rest of the run."""
    if count := config.getoption("--cpu"):
        config.pluginmanager.register(CpuTimes(count))
    if folder := folder_of_locks(config):
        from helpers.kernels import share_compiling

        share_compiling(folder)


def folder_of_locks(config: pytest.Config) -> Path | None:
    """Return where the processes of a run wait for each other; None if there is only one."""
    is_one_of_several = "PYTEST_XDIST_WORKER" in os.environ
    if is_one_of_several and config.cache and sys.platform != "win32":  # which has no such locks
        return config.cache.mkdir("locks")
    return None


@pytest.hookimpl(wrapper=True)
def pytest_collect_file() -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
    """Look for doctests in `mapdata/` only: those of the tests would take a second to not find."""
    collectors = yield
    return [one for one in collectors if not isinstance(one, DoctestModule)]


@pytest.hookimpl(tryfirst=True)  # before pytest chooses the tests by their marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark as slow what the default run leaves out: tests with all their examples, and combinations
    of parameters whose values other cases have.
    """
    if ARE_ALL:
        for item in items:
            if tries_examples(item):
                item.add_marker("slow")
    mark_further_combinations(items)


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Read each file in one of several processes first; the others then find its bytecode."""
    folder = folder_of_locks(collector.config)
    if folder is None or not isinstance(collector, pytest.Module):
        return (yield)
    from helpers.locks import lock

    with lock(folder / f"{collector.nodeid.replace('/', '.')}.lock"):
        return (yield)


def pytest_collection_finish() -> None:
    """Collect garbage from now on, but not among the modules and tests that are there."""
    gc.freeze()
    gc.enable()


def tries_examples(item: pytest.Item) -> bool:
    """Return whether a test tries more examples in `.ci/run` than by default."""
    is_property = getattr(getattr(item, "obj", None), "is_hypothesis_test", False)
    return is_property or "some" in getattr(item, "fixturenames", ())


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    """Give the function that builds a dataset, once a run; tests that change it take a copy."""
    from mapdata import build

    @cache
    def built_once(
        generator: MapGenerator | str, *, maps: int, seed: int = 0, shard_size: int = 1000
    ) -> Path:
        root = tmp_path_factory.mktemp("built") / "maps"
        build(root, generator, maps=maps, seed=seed, shard_size=shard_size, workers=1)
        return root

    return built_once


@pytest.fixture(scope="session", name="some")
def _some() -> Some:
    """Give the function that says how many of its examples a test tries."""
    return some
