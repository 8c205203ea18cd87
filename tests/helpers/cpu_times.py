"""What tests cost: the CPU seconds of the dearest ones, for `pytest --cpu 20`.

The time that passes depends on what else the machine does, so that nobody could compare it.
"""

from __future__ import annotations

import os
from collections.abc import Generator

import pytest

NAME = "CPU seconds"


def cpu_seconds() -> float:
    """Return the CPU seconds of this process and of those of its children that have ended."""
    return sum(os.times()[:4])


class CpuTimes:
    """A plugin that measures each test with its fixtures and prints the dearest ones.

    Attributes:
        count: how many are printed.
    """

    def __init__(self, count: int) -> None:
        """Print so many."""
        self.count = count

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Generator[None, object, object]:
        """Measure the fixtures that a test is the first to use."""
        before = cpu_seconds()
        try:
            return (yield)
        finally:
            item.user_properties.append((NAME, cpu_seconds() - before))

    pytest_runtest_call = pytest_runtest_setup

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Print the dearest tests and the sum of all."""
        costs: dict[str, float] = {}
        for reports in terminalreporter.stats.values():
            for report in reports:
                if isinstance(report, pytest.TestReport) and report.when == "teardown":
                    costs[report.nodeid] = sum(
                        seconds
                        for name, seconds in report.user_properties
                        if name == NAME and isinstance(seconds, float)
                    )
        terminalreporter.section(f"{NAME}: {sum(costs.values()):.1f} for {len(costs)} tests")
        dearest = sorted(costs.items(), key=lambda item: -item[1])
        for test, seconds in dearest[: self.count]:
            terminalreporter.write_line(f"{seconds:8.2f} {test}")
