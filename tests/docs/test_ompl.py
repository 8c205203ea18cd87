"""docs/howto/ompl.md runs with OMPL itself, on fewer problems, and its map is ours in metres."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import pages
from helpers.pages import DOCS, ROOT

PAGE = DOCS / "howto" / "ompl.md"

CHECKS = """
# a state is free where its cell is, and points of samplers are in the cells that they came from
state = information.allocState()
source = np.random.default_rng(0)
for row, column in source.integers(64, size=(200, 2)):
    (place,) = to_metres(np.array([[row, column]]) + source.uniform(0.1, 0.9, (1, 2)), 64)
    state[0], state[1] = place
    assert information.isValid(state) == (grid_of_forest[row, column] == 0), (row, column)
state[0], state[1] = X0 - 0.01, Y0 + 1
assert not information.isValid(state)
state[0], state[1] = X0 + 0.05, Y0 + 6.35  # the upper left corner
assert information.isValid(state) == (grid_of_forest[0, 0] == 0)

# the learned points come first, and the path joins the ends
assert prm.milestoneCount() >= 2
assert path.check()
found = [[state[0], state[1]] for state in path.getStates()]
np.testing.assert_allclose([found[0], found[-1]], ends)

# a wall is never passed, and what sees each other is joined
wall = np.zeros((64, 64), np.uint8)
wall[:, 30:33] = 1
apart, beside = np.array([[5, 5], [5, 60]]), np.array([[5, 5], [50, 20]])
states = to_metres(source.uniform(0, 1, (24, 2)) * [63, 29], 64)
assert not is_solved(wall, apart, states)
assert is_solved(wall, beside, states)
print("checked")
"""


def test_the_page_runs(tmp_path: Path) -> None:
    """In a process of its own: the bindings print what they leak when it ends."""
    pytest.importorskip("ompl")
    blocks = [block.text for block in pages.blocks(PAGE)]
    assert "MAPS = 50\n" in blocks[-1]
    few = blocks[-1].replace("MAPS = 50\n", "MAPS = 3\n")
    code = "\n".join((*blocks[:-1], "grid_of_forest = grid", few, CHECKS))
    run = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout.endswith("checked\n")
    assert run.stdout.count(" of 3\n") == 12
