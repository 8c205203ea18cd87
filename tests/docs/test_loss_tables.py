"""The table of losses on docs/costs.md, and the gradients of the losses that are compared there."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from mapdata import Sample
from mapdata.arrays import Float32s

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture
def tables(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The script of the table."""
    monkeypatch.syspath_prepend(str(DOCS))
    import loss_tables

    return loss_tables


@pytest.fixture(scope="module")
def rows() -> Any:
    """The rows of the file of results."""
    return json.loads((DOCS / "loss_results.json").read_text())


def test_the_page_shows_the_rows_of_the_file(tables: Any, rows: Any) -> None:
    """What `write_page` would write is what the page holds."""
    assert tables.table(rows) in (DOCS / "costs.md").read_text()


@pytest.mark.slow
def test_each_loss_has_the_same_trials_and_tests(tables: Any, rows: Any) -> None:
    """Four trials on one set, and the best of them with three seeds and both budgets on another."""
    for method in tables.OPTIONS:
        trials = [row for row in rows if row["method"] == method and row["role"] == "trial"]
        assert len({(row["option"], row["rate"]) for row in trials}) == len(trials) == 4
        assert {row["set"] for row in trials} == {tables.trial_problems().content_hash}
        best = tables.best_trial(rows, method)
        assert best["opt"] == max(row["opt"] for row in trials)
        tests = [row for row in rows if row["method"] == method and row["role"] == "test"]
        budgets = {(row["equal"], row["seed"]) for row in tests}
        assert len(budgets) == len(tests) == 2 * len(tables.SEEDS)
        assert {(row["option"], row["rate"]) for row in tests} == {(best["option"], best["rate"])}
        assert {row["set"] for row in tests} == {tables.problems_of(tables.FAMILY).content_hash}
        for row in tests:
            assert row["steps"] == tables.STEPS or row["equal"] == "seconds"
            assert abs(row["seconds"] - tables.SECONDS) < 1 or row["equal"] == "steps"


def batch_and_costs(tables: Any) -> tuple[Sample, torch.Tensor, Float32s]:
    """Return a batch, costs that a model might predict, and the true costs, (B, H, W)."""
    torch.manual_seed(0)
    batch = next(iter(tables.training_batches(tables.FAMILY, 16, seed=5)))
    generator = torch.Generator().manual_seed(0)
    costs = torch.rand(tables.SHAPE, generator=generator) + 0.1
    logarithms = np.log(batch.terrain[:, 0].numpy())
    truth = np.exp(logarithms - logarithms.mean(axis=(1, 2), keepdims=True))
    return batch, costs.requires_grad_(), truth


def masks(tables: Any, batch: Sample, costs: Any) -> Any:
    """Return the cells of the shortest paths of each map of a batch, one map after another."""
    problems = tables.problem_arrays(batch)
    found = [
        tables.path_masks(costs[k : k + 1], *(array[k : k + 1] for array in problems))
        for k in range(len(costs))
    ]
    return np.concatenate(found)


def test_spo_plus_has_the_gradient_of_its_paper(tables: Any) -> None:
    """Twice the paths of the teacher less those under 2 * predicted - true costs, for each map."""
    pytest.importorskip("pyepo")
    batch, costs, truth = batch_and_costs(tables)
    loss = tables.loss_of("SPO+", 0.5, seed=0)(lambda image, occupied: costs, batch)
    loss.backward()
    assert costs.grad is not None
    teacher = tables.teacher_masks(batch).numpy()
    found = teacher - costs.grad.numpy() * len(teacher) / 2
    np.testing.assert_allclose(found, np.round(found), atol=1e-5)
    searched = (2 * costs.detach().numpy() - 0.5 * truth).clip(min=0).astype(float)
    shortest = masks(tables, batch, searched)
    # Other paths may be as short: the search rounds costs to 1/255 of the largest one of the map.
    rounding = searched.max(axis=(1, 2)) / 255 * shortest.sum(axis=(1, 2))
    longer = (searched * (found - shortest)).sum(axis=(1, 2))
    assert (np.abs(longer) <= rounding).all()
    assert (np.abs(found - shortest).sum(axis=(1, 2)) == 0).mean() > 0.5
    assert loss.item() > 0


def test_fenchel_young_has_the_gradient_of_its_paper(tables: Any) -> None:
    """The paths of the teacher less those under perturbed costs; almost no noise, then much."""
    pytest.importorskip("pyepo")
    batch, costs, _ = batch_and_costs(tables)
    tables.loss_of("Fenchel-Young", 1e-6, seed=0)(lambda image, occupied: costs, batch).backward()
    teacher = tables.teacher_masks(batch).numpy()
    found = masks(tables, batch, costs.detach().numpy().astype(float))
    assert costs.grad is not None
    np.testing.assert_allclose(costs.grad, (teacher - found) / len(found), atol=1e-6)
    costs.grad = None
    tables.loss_of("Fenchel-Young", 1.0, seed=0)(lambda image, occupied: costs, batch).backward()
    assert costs.grad is not None
    assert not np.allclose(costs.grad, (teacher - found) / len(found))


@pytest.mark.slow
def test_a_training_ends_after_its_steps(tables: Any) -> None:
    """Its loss of paths falls on the maps of the training."""
    untrained, _ = tables.train("paths", 0, 0.01, 7, steps=1)
    trained, effort = tables.train("paths", 0, 0.01, 7, steps=20)
    assert effort["steps"] == 20
    batch = next(iter(tables.training_batches(tables.FAMILY, 64, seed=7)))
    assert trained.path_loss(batch) < untrained.path_loss(batch)
