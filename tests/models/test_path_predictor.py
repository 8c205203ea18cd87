"""The sample path predictor: targets and loss are compared with plain loops, plans are checked."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from mapdata import Cave, Movement, OnlineMapDataset, ProblemSet, Sample, build, evaluate
from mapdata.evaluation import GuidedSearch, prior
from mapdata.models.path_predictor import FIELDS, MOVEMENT, MovePredictor, is_optimal, main

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
    torch.nn.init.normal_(model.network.head.weight, std=0.5)
    return model.eval()


def test_bits_are_moves() -> None:
    """Bit k is move k, as numpy unpacks it."""
    moves = batch_of(3).optimal_moves
    expected = np.unpackbits(moves.numpy(), axis=1, bitorder="little")
    assert np.array_equal(is_optimal(moves).numpy(), expected)


def test_it_begins_near_the_scores_of_an_empty_map() -> None:
    """On maps of any size: the weights of the last layer are 0, and its biases below 0.21."""
    batch = batch_of(3)
    grids, goals = batch.map[:, 0].numpy(), batch.goal.numpy()
    scores, costs_to_go = MovePredictor().eval().predict(grids, goals)
    expected_scores, expected_costs = prior(grids, goals, MOVEMENT)
    assert np.abs(scores - expected_scores).max() < 0.21
    assert scores.shape == (3, 8, 20, 26)
    assert (costs_to_go >= expected_costs).all()  # obstacles make no way shorter


def test_the_loss_is_that_of_a_loop_over_the_cells() -> None:
    """With the weights of cells with a detour, and without cells that have no way to the goal."""
    batch = batch_of(2)
    model = model_of(1)
    with torch.no_grad():
        scores, ratios, _ = model(batch.map, batch.goal)
        loss = float(model.loss(batch))
    total = total_weight = 0.0
    for problem, row, column in np.argwhere(batch.optimal_moves[:, 0].numpy() > 0):
        moves = int(batch.optimal_moves[problem, 0, row, column])
        powers = [math.exp(float(score)) for score in scores[problem, :, row, column]]
        right = sum(power for k, power in enumerate(powers) if moves >> k & 1)
        ratio = float(batch.heuristic_ratio[problem, 0, row, column])
        error = float(ratios[problem, row, column]) - ratio
        weight = 3 if ratio < 0.98 else 1
        total += weight * (-math.log(right / sum(powers)) + 5 * error**2)
        total_weight += weight
    assert loss == pytest.approx(total / total_weight, rel=1e-4)


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
    planner = GuidedSearch("sample", MOVEMENT, model_of(2).predict)
    table = evaluate([planner], problems, bootstrap=1)
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
    main(["maps", "--steps", "2", "--weights", "moves.ckpt"])
    table = capsys.readouterr().out
    assert "guided search, no network" in table
    assert "sample " in table
    model = MovePredictor.load_from_checkpoint("moves.ckpt").eval()
    grids, goals = batch_of(2).map[:, 0].numpy(), batch_of(2).goal.numpy()
    scores, _ = model.predict(grids, goals)
    assert not np.array_equal(scores, prior(grids, goals, Movement(8))[0])
