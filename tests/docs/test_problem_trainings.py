"""The trainings of docs/which_problems.md: their table, their search, and that they run."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from helpers.pages import DOCS

from mapdata import Movement, ProblemSet, Random


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return problem_trainings.py."""
    monkeypatch.syspath_prepend(str(DOCS))
    import problem_trainings

    return problem_trainings


def test_the_tables_of_the_page_are_those_of_the_file(script: ModuleType) -> None:
    """docs/which_problems.md shows what docs/training_results.json says."""
    results = json.loads((DOCS / "training_results.json").read_text(encoding="utf-8"))
    assert all(
        list(of_set["rows"]) == [script.NO_NETWORK, *script.TRAININGS]
        for of_set in results["sets"].values()
    )
    page = (DOCS / "which_problems.md").read_text(encoding="utf-8")
    assert script.table_of(results, "optimal") in page
    assert script.table_of(results, "expansions") in page


def test_a_search_without_a_penalty_is_a_star(script: ModuleType) -> None:
    """Its paths are shortest. With perfect probabilities it expands little more than the path."""
    problems = ProblemSet.sample("cave", 3, 10, movement=Movement(8), problems=Random())
    plain = script.without_network(problems)
    assert (plain[:, 0] == 1).all()
    masks = np.zeros((10, 1, 64, 64), np.float32)
    for k in range(10):
        masks[k, 0][tuple(problems.optimal.path(k).T)] = 1
    guided = script.searched(problems, masks, 1000.0)
    lengths = np.diff(problems.optimal.offsets)
    assert (guided[:, 0] == 1).all()
    assert (guided[:, 1] == lengths).all()
    assert plain[:, 1].sum() > 2 * lengths.sum()


def test_a_network_that_expects_a_path_everywhere_leaves_a_star_as_it_is(
    script: ModuleType,
) -> None:
    """A probability above 1/2 has no penalty, for cells and for moves."""
    problems = ProblemSet.sample("cave", 3, 5, movement=Movement(8), problems=Random())
    plain = script.without_network(problems)
    for channels in (1, 8):
        everywhere = np.full((5, channels, 64, 64), 0.51, np.float32)
        np.testing.assert_array_equal(script.searched(problems, everywhere, 16.0), plain)
        nowhere = np.full((5, channels, 64, 64), 0.5, np.float32)
        nowhere[0, :, :32] = 0.51
        assert (script.searched(problems, nowhere, 1000.0)[0] != plain[0]).any()


@pytest.mark.slow
def test_the_trainings_run(
    script: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """With few problems and steps; a second call takes the networks that the first one kept."""
    small = {
        "TRAINING_PROBLEMS": 64,
        "TRAINING_STEPS": 3,
        "SEEDS": (0,),
        "VALIDATION_PROBLEMS": 4,
        "TEST_PROBLEMS": 4,
        "PENALTIES": (1.0, 4.0),
        "TEST_SETS": {"`cave`, hard": ("cave", script.HARD)},
        "DOCS": tmp_path,
    }
    for name, value in small.items():
        monkeypatch.setattr(script, name, value)
    script.main(["--weights", str(tmp_path / "weights")])
    first = (tmp_path / "training_results.json").read_text()
    assert len(list((tmp_path / "weights").iterdir())) == len(script.TRAININGS)
    script.main(["--weights", str(tmp_path / "weights")])
    assert (tmp_path / "training_results.json").read_text() == first
    said = capsys.readouterr().out
    assert script.table_of(json.loads(first), "optimal") in said
    assert script.table_of(json.loads(first), "expansions") in said
