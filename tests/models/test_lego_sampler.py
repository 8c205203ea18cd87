"""The sample sampler: targets and loss are compared with plain loops, points lie in free cells."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from mapdata import Cave, OnlineMapDataset, Sample, build
from mapdata.models.lego_sampler import (
    FIELDS,
    MOVEMENT,
    PROBLEMS,
    LegoSampler,
    at_corners,
    main,
    targets,
)
from mapdata.roadmaps import corners, free_at

pytestmark = pytest.mark.filterwarnings(
    "ignore:The '.*dataloader' does not have many workers", "ignore:.*LeafSpec", "ignore:.*TF32"
)
SMALL = Cave((20, 26))
"""Maps whose sides are no multiples of 4 both."""


def batch_of(count: int) -> Sample:
    """Return problems on small maps, with their targets."""
    return OnlineMapDataset(SMALL, 5, count, fields=FIELDS, problems=PROBLEMS, movement=MOVEMENT)[:]


def model_of(seed: int) -> LegoSampler:
    """Return an untrained sampler."""
    torch.manual_seed(seed)
    return LegoSampler().eval()


def test_corners_are_those_of_the_sampler_of_corners() -> None:
    """As many points of `mapdata.roadmaps.corners` as there are corners lie in all of them."""
    maps = batch_of(3).map
    for grid, found in zip(maps[:, 0].numpy(), at_corners(maps)[:, 0].numpy(), strict=True):
        cells = np.floor(corners(grid, int(found.sum()))).astype(int)
        assert {*map(tuple, cells)} == {*map(tuple, np.argwhere(found))}


def test_targets_are_those_of_a_walk_along_the_path() -> None:
    """Cells at a corner before and after which the moves of the path differ, and no others."""
    batch = batch_of(6)
    is_corner = at_corners(batch.map)[:, 0]
    count = 0
    for k, path in enumerate(batch.path.tolist()):
        cells = [cell for cell in path if cell[0] >= 0]
        expected = set()
        for before, (row, column), after in zip(cells, cells[1:], cells[2:], strict=False):
            move = row - before[0], column - before[1]
            next_move = after[0] - row, after[1] - column
            if move != next_move and is_corner[k, row, column]:
                expected.add((row, column))
        assert {*map(tuple, batch.targets[k, 0].nonzero().tolist())} == expected
        count += len(expected)
    assert count >= 3


def test_a_goal_in_the_first_cell_is_no_turn() -> None:
    """The padding after it looks like a move to the north-west."""
    maps = torch.zeros(1, 1, 4, 4, dtype=torch.uint8)
    maps[0, 0, 1, 1] = 1
    path = torch.tensor([[[2, 0], [1, 0], [0, 0], [-1, -1], [-1, -1]]])
    batch: Any = SimpleNamespace(map=maps, path=path)
    assert at_corners(maps)[0, 0, 0, 0]
    assert not targets(batch).any()


def test_the_loss_is_that_of_a_loop_over_the_problems() -> None:
    """Problems count equally, and those without a turn do not count."""
    batch = batch_of(6)
    batch.targets[0] = False
    model = model_of(1)
    with torch.no_grad():
        log_shares = model(batch.map, batch.start, batch.goal)
        loss = float(model.loss(batch))
    losses = []
    for shares, is_target in zip(log_shares, batch.targets[:, 0], strict=True):
        if is_target.any():
            losses.append(-float(shares[is_target].mean()))
    assert 1 < len(losses) < 6
    assert loss == pytest.approx(np.mean(losses), rel=1e-5)


def test_shares_sum_to_one_over_the_free_cells() -> None:
    """And occupied cells have none."""
    batch = batch_of(3)
    with torch.no_grad():
        shares = model_of(1)(batch.map, batch.start, batch.goal).exp()
    assert torch.allclose(shares.sum(dim=(1, 2)), torch.ones(3))
    assert not shares[batch.map[:, 0] == 1].any()


def test_it_learns_a_batch() -> None:
    """Ten small steps on the same problems lower their loss in the end."""
    batch = batch_of(4)
    model = model_of(0)
    optimizer = torch.optim.AdamW(model.parameters(), 1e-3)
    losses = []
    for _ in range(10):
        loss = model.loss(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < losses[0]


def test_points_lie_in_free_cells_the_most_needed_first() -> None:
    """The same seed draws the same points, and another one other points of the same cells."""
    batch = batch_of(3)
    grids, starts, goals = (each.numpy() for each in (batch.map[:, 0], batch.start, batch.goal))
    model = model_of(1)
    points = model.sample_batch(grids, starts, goals, 30)
    assert points.shape == (3, 30, 2)
    with torch.no_grad():
        largest = model(batch.map, batch.start, batch.goal).flatten(1).argmax(dim=1).tolist()
    for grid, of_problem, best in zip(grids, points, largest, strict=True):
        assert free_at(grid, of_problem).all()
        cells = np.floor(of_problem).astype(int)
        assert len({*map(tuple, cells)}) == 30
        assert tuple(cells[0]) == divmod(best, 26)
    assert np.array_equal(points, model.sample_batch(grids, starts, goals, 30))
    others = model.sample_batch(grids, starts, goals, 30, seed=1)
    assert not np.array_equal(points, others)
    assert np.array_equal(np.floor(points), np.floor(others))


def test_all_cells_are_taken_before_one_is_taken_again() -> None:
    """A map with fewer free cells than points."""
    grids = np.ones((1, 8, 8), np.uint8)
    grids[0, 2:4, 2:5] = 0
    points = model_of(1).sample_batch(grids, np.array([[2, 2]]), np.array([[3, 4]]), 9)
    assert free_at(grids[0], points[0]).all()
    assert len({*map(tuple, np.floor(points[0, :6]))}) == 6


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_the_program_trains_compares_and_keeps_its_weights(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """On any dataset; the weights sample again."""
    monkeypatch.chdir(tmp_path)
    build("maps", SMALL, maps=60, seed=3)
    # torch's schedule of 10 steps, a tenth of which are one step, divides by 0.
    main(["maps", "--steps", "10", "--problems", "5", "--weights", "sampler.ckpt"])
    table = capsys.readouterr().out
    assert all(name in table for name in ("halton", "uniform", "learned_alone"))
    model = LegoSampler.load_from_checkpoint("sampler.ckpt").eval()
    grids = np.zeros((1, 16, 16), np.uint8)
    assert model.sample_batch(grids, np.array([[0, 0]]), np.array([[9, 9]]), 5).shape == (1, 5, 2)
