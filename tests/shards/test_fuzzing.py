"""The fuzzers of tests/helpers/fuzzing.py for a bounded number of cases: no crash, no hang, only
data or the error that is named. Longer by hand: `PYTHONPATH=tests python -m helpers.fuzzing shards
--seconds 600 --seed 1`.
"""

from __future__ import annotations

import sys

import pytest
from helpers import run_helper


@pytest.mark.skipif(sys.platform != "linux", reason="RLIMIT_AS and /proc")
@pytest.mark.slow
@pytest.mark.parametrize(("target", "cases"), [("shards", 300), ("formats", 300)])
def test_changed_files_are_read_or_refused(target: str, cases: int) -> None:
    """In a process of its own, so that a crash is seen."""
    done = run_helper("fuzzing", target, "--cases", str(cases))
    assert done.returncode == 0, done.stderr
    counts = {
        name: int(count)
        for name, count in (line.rsplit(": ", 1) for line in done.stdout.splitlines()[:-1])
    }
    assert sum(counts.values()) == cases
    assert any(name.endswith("read") for name in counts)
    assert any(name.endswith("refused") for name in counts)
