"""docs/howto/robot.md plans without torch and mapdata, and as they would."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers import pages
from helpers.pages import DOCS, ROOT
from PIL import Image

from mapdata import Forest, Movement, ProblemSet, astar, check_path, inflate
from mapdata.formats import read_any
from mapdata.models.pretrained.path_predictor import PathPredictor

PAGE = DOCS / "howto" / "robot.md"
MISSING = [name for name in ("onnxruntime", "onnxscript") if not importlib.util.find_spec(name)]
BLOCKS = [block.text for block in pages.blocks(PAGE)]
FIRST = next(k for k, text in enumerate(BLOCKS) if "import onnxruntime" in text)
WITHOUT = "import sys\nsys.modules.update(dict.fromkeys(('torch', 'mapdata', 'models')))\n"
"""From here on an import of these fails."""

MOVEMENT = Movement(8)

pytestmark = pytest.mark.skipif(bool(MISSING), reason=f"needs pip install {' '.join(MISSING)}")


def run(*blocks: str) -> str:
    """Run blocks in a process of their own; return what they print."""
    code = "\n".join(("import warnings; warnings.simplefilter('ignore')", *blocks))
    found = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert found.returncode == 0, found.stderr
    return found.stdout


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """The names of the page, run from a fresh folder, which stays the working folder.

    The export has a process of its own, since what it leaves behind in torch stays there. So have
    the robot's blocks, without torch; then they run here, for the tests to call their functions.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("robot"))
        run(*BLOCKS[:FIRST])
        printed = run(WITHOUT, *BLOCKS[FIRST:])
        assert "expansions with the network" in printed
        assert Path("plan.png").read_bytes().startswith(b"\x89PNG")
        names: dict[str, Any] = {"__name__": PAGE.stem}
        for text in BLOCKS[FIRST:]:
            exec(compile(text, str(PAGE), "exec", dont_inherit=True), names)
        yield names


def test_the_plan_is_that_of_torch(robot: dict[str, Any]) -> None:
    """The exported network says what torch's says, and its path is legal, from end to end."""
    model = PathPredictor.pretrained()
    blocked = robot["blocked"]
    with torch.no_grad():
        scores, ratios = model(torch.from_numpy(blocked)[None, None], torch.tensor([robot["goal"]]))
    np.testing.assert_allclose(robot["scores"], scores.numpy(), rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(robot["ratios"], ratios.numpy(), rtol=1e-3, atol=1e-3)
    ends = robot["start"], robot["goal"]
    path, _ = robot["search"](blocked, *ends, scores[0].numpy(), ratios[0].numpy())
    assert path == robot["path"]
    assert (path[0], path[-1]) == ends
    check_path(blocked, path, MOVEMENT)


@pytest.mark.parametrize("shape", [(8, 8), (45, 69), (130, 70)])
def test_maps_of_any_size(robot: dict[str, Any], shape: tuple[int, int]) -> None:
    """Several maps at once, of sides that are no multiples of 16."""
    model = PathPredictor.pretrained()
    source = np.random.default_rng(0)
    blocked = (source.random((3, 1, *shape)) < 0.2).astype(np.uint8)
    goals = source.integers(8, size=(3, 2))
    found = robot["network"].run(["scores", "ratios"], {"blocked": blocked, "goals": goals})
    with torch.no_grad():
        expected = model(torch.from_numpy(blocked), torch.from_numpy(goals))
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(ours, theirs.numpy(), rtol=1e-3, atol=1e-3)


def test_without_the_network_it_is_a_star(robot: dict[str, Any]) -> None:
    """Paths are legal and optimal; predictions that are noise still give legal ones."""
    problems = ProblemSet.sample(Forest((24, 32)), seed=1, maps=20, movement=MOVEMENT)
    source = np.random.default_rng(0)
    for grid, start, goal in zip(problems.grids, problems.starts, problems.goals, strict=True):
        walled = np.pad(grid, 1, constant_values=1)
        ends = tuple((start + 1).tolist()), tuple((goal + 1).tolist())
        noise = source.normal(size=(8, *walled.shape)), source.random(walled.shape)
        path, _ = robot["search"](walled, *ends, *noise)
        assert (path[0], path[-1]) == ends
        check_path(walled, path, MOVEMENT)
        nothing = np.zeros((8, *walled.shape)), np.ones(walled.shape)
        path, _ = robot["search"](walled, *ends, *nothing)
        assert (path[0], path[-1]) == ends
        optimal = astar(grid, start, goal, MOVEMENT).cost
        assert check_path(walled, path, MOVEMENT) == pytest.approx(optimal)
    nowhere = robot["search"](np.ones((9, 9)), (4, 4), (2, 2), np.zeros((8, 9, 9)), np.ones((9, 9)))
    assert nowhere == ([], 1)


@pytest.mark.parametrize(("negate", "free_thresh"), [(0, 0.196), (0, 0.25), (1, 0.196)])
@pytest.mark.parametrize("pixels", [1, 3])
def test_the_map_is_that_of_mapdata(
    robot: dict[str, Any], negate: int, free_thresh: float, pixels: int
) -> None:
    """Thresholds, unknown cells, the radius, wider cells and metres, with an origin elsewhere."""
    shades = np.random.default_rng(1).choice([0, 205, 254], size=(62, 80), p=[0.01, 0.02, 0.97])
    shades[:, :1] = shades[:, -1:] = shades[:1] = shades[-1:] = 0
    Image.fromarray((255 - shades if negate else shades).astype(np.uint8)).save("other.pgm")
    Path("other.yaml").write_text(
        f"image: other.pgm\nresolution: 0.05\norigin: [-3.1, 2.4, 0.0]\nnegate: {negate}\n"
        f"occupied_thresh: 0.65\nfree_thresh: {free_thresh}\n"
    )
    grid = read_any("other.yaml", unknown="occupied").maps[0].grid
    blocked, *place = robot["read_map"](Path("other.yaml"), 0.1, pixels)
    assert place == pytest.approx([0.05 * pixels, -3.1, 2.4])
    # which cell each row and column of pixels is in: cells are counted from the lower left corner
    rows = len(blocked) - 1 - np.arange(len(grid))[::-1] // pixels
    columns = np.arange(grid.shape[1]) // pixels
    # blocked where a disc has no room, and free where a disc about its square has room
    for radius, compare in ((2, np.greater_equal), (1.6 * np.sqrt(2), np.less_equal)):
        truth = np.zeros_like(blocked)
        np.maximum.at(truth, np.ix_(rows, columns), inflate(grid, radius))
        assert compare(blocked, truth).all()
    assert (blocked == 0).any()
    names = {
        **robot,
        "blocked": blocked,
        **dict(zip(("resolution", "x0", "y0"), place, strict=True)),
    }
    to_cell = type(robot["to_cell"])(robot["to_cell"].__code__, names)
    for row, column in np.argwhere(blocked[np.ix_(rows, columns)] == 0)[::40]:
        x = -3.1 + 0.05 * (column + 0.5)
        y = 2.4 + 0.05 * (len(grid) - row - 0.5)
        assert to_cell(x, y) == (rows[row], columns[column])
    for outside in ((-3.2, 4.0), (-2.0, 2.3), (1.0, 4.0), (-2.0, 6.0)):
        with pytest.raises(AssertionError, match="no room"):
            to_cell(*outside)
