"""What carries over: its tables, the search with a penalty as a planner, and that trainings run."""

from __future__ import annotations

import json
import shutil
from functools import partial
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from helpers.pages import DOCS

from mapdata import ProblemSet, astar, evaluate
from mapdata.arrays import Bytes, Float32s, Ints
from mapdata.evaluation import SUITES, GuidedSearch, classical, prior


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return carry_over.py."""
    monkeypatch.syspath_prepend(str(DOCS))
    import carry_over

    return carry_over


def test_the_tables_of_the_page_are_those_of_the_file(script: ModuleType, tmp_path: Path) -> None:
    """Writing them again changes neither the page nor the file."""
    names = ("carry_over_results.json", "which_problems.md")
    for name in names:
        shutil.copy(DOCS / name, tmp_path / name)
    script.main(["--pages", "--folder", str(tmp_path)])
    for name in names:
        assert (tmp_path / name).read_text() == (DOCS / name).read_text(), name


def test_the_problems_are_those_of_the_other_tables_of_the_page(script: ModuleType) -> None:
    """So that the rows stand beside each other: the hashes agree."""
    ours = json.loads((DOCS / "carry_over_results.json").read_text())["untrained"]["sets"]
    others = json.loads((DOCS / "training_results.json").read_text())["sets"]
    hashes = {name: of_set["hash"] for name, of_set in ours.items()}
    parts = {part.name: part.content_hash for part in SUITES["carry-over-1"]}
    expected = parts | {name: of_set["hash"] for name, of_set in others.items()}
    assert set(others) < set(hashes)
    common = set(hashes) & set(expected)
    assert {name: expected[name] for name in common} == {name: hashes[name] for name in common}


def test_scores_that_are_equal_leave_a_star_as_it_is(script: ModuleType) -> None:
    """No move is less probable than another, so none has a penalty; every path is shortest."""

    def equal(grids: Bytes, goals: Ints) -> tuple[Float32s, Float32s]:
        scores = np.zeros((len(grids), 8, *grids.shape[1:]), np.float32)
        return scores, np.zeros(grids.shape, np.float32)

    problems = ProblemSet.sample("cave", 3, 10, movement=script.MOVEMENT)
    table = evaluate([script.PenaltySearch("equal", equal, 1000.0)], problems, bootstrap=2)
    assert table["opt"].tolist() == [1, 1]
    plain = script.searches.without_network(problems)[:, 1]
    assert table["expansion_ratio"][0] == pytest.approx(
        (plain / problems.optimal.iterations).mean()
    )


def test_a_penalty_puts_off_moves_that_are_less_probable(script: ModuleType) -> None:
    """The moves of a shortest path are the most probable ones: only its cells are expanded."""
    problems = ProblemSet.sample("dungeon", 3, 5, movement=script.MOVEMENT)
    for k in range(len(problems)):
        grid, start, goal = (
            array[k] for array in (problems.grids, problems.starts, problems.goals)
        )
        path = astar(grid, start, goal, script.MOVEMENT).path
        scores = np.zeros((1, 8, *grid.shape), np.float32)
        for cell, step in zip(path[:-1], np.diff(path, axis=0), strict=True):
            move = int((step == script.searches.STEPS).all(axis=1).argmax())
            scores[0, move, cell[0], cell[1]] = 1  # e times as probable as the others
        search = script.PenaltySearch("path", lambda *_: (scores, None), 1000.0)  # noqa: B023
        plan = search.plan(grid, tuple(start), tuple(goal))
        np.testing.assert_array_equal(plan.path, path)
        assert plan.expansions == len(path)


def test_goal_planes_begin_at_the_prior(script: ModuleType) -> None:
    """An untrained network is the guided search without a network, on maps of any size."""
    problems = ProblemSet.sample("dungeon", 3, 8, movement=script.MOVEMENT)
    grids, goals = problems.grids[:, :50, :41].copy(), np.full((8, 2), 20)
    scores, costs_to_go = script.Network("goal").eval().predict(grids, goals)
    expected = prior(grids, goals, script.MOVEMENT)
    np.testing.assert_allclose(scores.numpy(), expected[0], atol=1e-4)
    np.testing.assert_array_equal(costs_to_go, expected[1])


def test_the_loss_is_the_surprise_at_an_optimal_move(script: ModuleType) -> None:
    """Of four legal moves with equal scores two are optimal: log 2. Illegal ones do not count."""
    maps = torch.ones(1, 3, 3, dtype=torch.uint8)
    maps[0, 1] = maps[0, :, 1] = 0  # a cross: N, E, S and W are legal from its middle
    optimal = torch.zeros(1, 3, 3, dtype=torch.uint8)
    optimal[0, 1, 1] = 0b0011
    loss = script.loss_of(torch.zeros(1, 8, 3, 3), maps, optimal)
    assert float(loss) == pytest.approx(np.log(2), abs=1e-6)


@pytest.mark.slow
def test_the_trainings_run_and_continue(
    script: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """With few problems and steps, also on a robot's map; a second call adds what is missing."""
    small = {
        "VALIDATION_PROBLEMS": 4,
        "TEST_PROBLEMS": 4,
        "TEST_SETS": {"`cave`, hard": ("cave", script.searches.HARD)},
    }
    for name, value in small.items():
        monkeypatch.setattr(script.searches, name, value)
    monkeypatch.setattr(script, "WINDOWS", 3)
    monkeypatch.setattr(script, "SUITES", {"carry-over-1": SUITES["carry-over-1"][:0]})
    rows = ["." * 80] * 20 + ["." * 35 + "@" * 20 + "." * 25] * 40 + ["." * 80] * 20
    (tmp_path / "maps").mkdir()
    text = "\n".join(["type octile", "height 80", "width 80", "map", *rows])
    (tmp_path / "maps" / "hall.map").write_text(text + "\n")
    arguments = ["--problems", "20", "--steps", "3", "--maps", str(tmp_path / "maps")]
    arguments += ["--folder", str(tmp_path), "--weights", str(tmp_path / "weights")]
    script.main([*arguments, "--cell", "paper-raw", "--seed", "0"])
    script.main([*arguments, "--cell", "paper-raw", "--cell", "many-goal", "--seed", "0"])
    results = json.loads((tmp_path / "carry_over_results.json").read_text())["trained"]
    assert results["steps"] == 3
    assert list(results["sets"]) == ["`cave`, hard", "hall"]
    for of_set in results["sets"].values():
        rows_of_set = {row["planner"]: row for row in of_set["rows"]}
        assert list(rows_of_set) == [script.NO_NETWORK, "paper-raw-0", "many-goal-0"]
        assert rows_of_set[script.NO_NETWORK]["opt_difference"] == 0
        row = rows_of_set["paper-raw-0"]
        low, high = row["opt_difference_low"], row["opt_difference_high"]
        assert low <= row["opt_difference"] <= high
    # Weights of other numbers of steps, and cells that were not asked for, stay out.
    script.main([*arguments, "--cell", "many-goal", "--seed", "0", "--steps", "2"])
    results = json.loads((tmp_path / "carry_over_results.json").read_text())["trained"]
    assert results["steps"] == 2
    for of_set in results["sets"].values():
        planners = [row["planner"] for row in of_set["rows"]]
        assert planners == [script.NO_NETWORK, "many-goal-0"]
    for steps in (2, 3):
        assert (tmp_path / "weights" / f"{steps}-steps" / "many-goal-0.pt").exists()


def test_the_guided_search_without_a_network_is_one_row(script: ModuleType) -> None:
    """The walk by the prior is another one: it follows the moves, whatever a path costs."""
    walk = GuidedSearch("walk", script.MOVEMENT, partial(prior, movement=script.MOVEMENT), np.inf)
    (search,) = [one for one in classical(script.MOVEMENT) if one.name == script.NO_NETWORK]
    problems = ProblemSet.sample("cave", 3, 40, movement=script.MOVEMENT)
    table = evaluate([walk, search], problems, bootstrap=2)
    opt = table[table["subset"] == "all"]["opt"].tolist()
    assert opt[0] < opt[1]
