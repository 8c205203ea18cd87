"""The sample path predictor: targets and loss are compared with plain loops, plans are checked."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch

from mapdata import (
    Cave,
    Movement,
    OnlineMapDataset,
    ProblemSet,
    Sample,
    build,
    check_path,
    evaluate,
)
from mapdata.evaluation import prior
from mapdata.models import path_predictor
from mapdata.models.path_predictor import (
    FIELDS,
    MOVEMENT,
    MovePredictor,
    is_legal,
    is_optimal,
    main,
)
from mapdata.search import STEPS

pytestmark = pytest.mark.filterwarnings(
    "ignore:The '.*dataloader' does not have many workers", "ignore:.*LeafSpec", "ignore:.*TF32"
)
SMALL = Cave((20, 26))
"""Maps whose sides are no multiples of 4 both."""


def batch_of(count: int) -> Sample:
    """Return problems on small maps, with all targets."""
    return OnlineMapDataset(SMALL, 5, count, fields=FIELDS, problems="random", movement=MOVEMENT)[:]


def model_of(seed: int) -> MovePredictor:
    """Return a predictor whose last layer is random, so that it predicts anything."""
    torch.manual_seed(seed)
    model = MovePredictor()
    torch.nn.init.normal_(next(reversed(list(model.network.parameters()))), std=0.5)
    return model.eval()


def test_bits_are_moves() -> None:
    """Bit k is move k, as numpy unpacks it."""
    moves = batch_of(3).optimal_moves
    expected = np.unpackbits(moves.numpy(), axis=1, bitorder="little")
    assert np.array_equal(is_optimal(moves).numpy(), expected)


def test_legal_moves_are_those_of_check_path() -> None:
    """From every free cell, to its eight neighbours, also beyond the border."""
    maps = batch_of(2).map
    legal = is_legal(maps).numpy()
    for problem, row, column in np.argwhere(maps[:, 0].numpy() == 0):
        grid = maps[problem, 0].numpy()
        for move, (down, right) in enumerate(STEPS):
            path = [(row, column), (row + down, column + right)]
            assert legal[problem, move, row, column] == is_path(grid, path)


def is_path(grid: npt.NDArray[np.uint8], path: list[tuple[int, int]]) -> bool:
    """Return whether `check_path` takes a path."""
    try:
        check_path(grid, path, MOVEMENT)
    except ValueError:
        return False
    return True


@pytest.mark.parametrize("movement", [Movement(4), Movement(8, corner_cutting=True)])
def test_the_movement_can_be_changed(movement: Movement, monkeypatch: pytest.MonkeyPatch) -> None:
    """By its constant alone: every optimal move is legal, and the planner solves all problems."""
    monkeypatch.setattr(path_predictor, "MOVEMENT", movement)
    monkeypatch.setattr(path_predictor, "MOVES", STEPS[: movement.connectivity])
    batch = OnlineMapDataset(SMALL, 5, 3, fields=FIELDS, problems="random", movement=movement)[:]
    assert not (is_optimal(batch.optimal_moves) & ~is_legal(batch.map)).any()
    problems = ProblemSet.sample(SMALL, seed=8, maps=5, movement=movement)
    table = evaluate([model_of(2).planner()], problems, bootstrap=1)
    assert (table["success"] == 1).all()
    assert (table["refused"] == 0).all()


def test_predictions_are_those_of_evaluation_mode() -> None:
    """Also while it trains, which goes on: batch norm takes its running statistics."""
    batch = batch_of(2)
    grids, goals = batch.map[:, 0].numpy(), batch.goal.numpy()
    model = model_of(1)
    expected, _ = model.predict(grids, goals)
    found, _ = model.train().predict(grids, goals)
    np.testing.assert_array_equal(found, expected)
    assert model.training


def test_it_begins_with_the_scores_of_an_empty_map() -> None:
    """On maps of any size: the last layer is 0."""
    batch = batch_of(3)
    grids, goals = batch.map[:, 0].numpy(), batch.goal.numpy()
    scores, costs_to_go = MovePredictor().eval().predict(grids, goals)
    expected_scores, expected_costs = prior(grids, goals, MOVEMENT)
    assert scores.shape == (3, 8, 20, 26)
    np.testing.assert_array_equal(scores, expected_scores)
    np.testing.assert_array_equal(costs_to_go, expected_costs)


def test_the_loss_is_that_of_a_loop_over_the_cells() -> None:
    """Of the legal moves of each cell that has a way to the goal."""
    batch = batch_of(2)
    model = model_of(1)
    with torch.no_grad():
        scores, _ = model(batch.map, batch.goal)
        loss = float(model.loss(batch))
    losses = []
    for problem, row, column in np.argwhere(batch.optimal_moves[:, 0].numpy() > 0):
        grid = batch.map[problem, 0].numpy()
        moves = int(batch.optimal_moves[problem, 0, row, column])
        right = every = 0.0
        for move, (down, across) in enumerate(STEPS):
            if is_path(grid, [(row, column), (row + down, column + across)]):
                power = math.exp(float(scores[problem, move, row, column]))
                every += power
                right += power * (moves >> move & 1)
        losses.append(-math.log(right / every))
    assert loss == pytest.approx(np.mean(losses), rel=1e-4)


def test_it_learns_a_batch() -> None:
    """Ten small steps on the same problems lower their loss in the end."""
    batch = batch_of(4)
    torch.manual_seed(0)
    model = MovePredictor()
    optimizer = torch.optim.AdamW(model.parameters(), 1e-3)
    losses = []
    for _ in range(10):
        loss = model.loss(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < losses[0]


def test_whatever_it_predicts_paths_are_found() -> None:
    """Its planner solves every problem that has a path."""
    problems = ProblemSet.sample(SMALL, seed=8, maps=10, movement=MOVEMENT)
    table = evaluate([model_of(2).planner()], problems, bootstrap=1)
    assert (table["success"] == 1).all()
    assert (table["refused"] == 0).all()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_the_program_trains_compares_and_keeps_its_weights(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """On any dataset; the weights predict the same again."""
    monkeypatch.chdir(tmp_path)
    build("maps", SMALL, maps=60, seed=3)
    # torch's schedule of 30 steps, a 30th of which are one step, divides by 0.
    main(["maps", "--steps", "30", "--problems", "5", "--weights", "moves.ckpt"])
    table = capsys.readouterr().out
    assert "guided search, no network" in table
    assert "untrained" in table
    assert "learned" in table
    model = MovePredictor.load_from_checkpoint("moves.ckpt").eval()
    grids, goals = batch_of(2).map[:, 0].numpy(), batch_of(2).goal.numpy()
    scores, _ = model.predict(grids, goals)
    assert not np.array_equal(scores, prior(grids, goals, Movement(8))[0])
