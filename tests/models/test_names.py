"""The names of `mapdata.models`: there is one import name, and each public name is there."""

from __future__ import annotations

import ast
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from mapdata import models
from mapdata.evaluation import GuidedSearch
from mapdata.models import (
    CVAE,
    CostPredictor,
    Heatmap,
    Model,
    NeuralAstar,
    PathPredictor,
    evaluate,
    train,
)
from mapdata.models.pretrained.model import WEIGHTS

FOLDER = Path(models.__file__).parent


@pytest.mark.parametrize("name", ["models", "models.train", "models.pretrained.lego.sampler"])
def test_the_folder_has_one_import_name(
    name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """With the folder around it on the path it could be imported a second time, as other classes;
    the error names the right import.
    """
    (tmp_path / "models").symlink_to(FOLDER, target_is_directory=True)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ImportError, match=r"models: this folder is imported as mapdata\.models"):
        import_module(name)
    assert not [module for module in sys.modules if module.split(".")[0] == "models"]


def test_the_public_names_are_those_of_type_checkers() -> None:
    """What is imported on first use is what the block for type checkers imports."""
    tree = ast.parse((FOLDER / "__init__.py").read_text(encoding="utf-8"))
    imported = {
        alias.name: node.module
        for block in tree.body
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert imported == models._MODULES
    assert models.__all__ == sorted(imported)
    for name, module in imported.items():
        member = getattr(models, name)
        assert member is getattr(import_module(f"mapdata.models.{module}"), name)
        assert member.__doc__, name
    with pytest.raises(AttributeError, match="has no attribute 'Planner'"):
        models.Planner  # noqa: B018


@pytest.mark.parametrize("name", ["Costmap", "fit_costmap"])
def test_names_of_costmaps_are_there_for_one_more_version(name: str) -> None:
    """In both of their former places, with a warning that names the new one."""
    from mapdata import costmaps
    from mapdata.models import costmap

    for place in (models, costmap):
        with pytest.warns(
            FutureWarning, match=rf"gone in 0\.5\.0: it is now mapdata\.costmaps\.{name}$"
        ):
            assert getattr(place, name) is getattr(costmaps, name)
    assert name not in models.__all__


def test_importing_the_models_loads_no_torch() -> None:
    """Nor numba or Lightning: the names are imported on first use."""
    program = """
import sys
import mapdata.models
assert not {"torch", "numba", "pytorch_lightning", "numpy"} & set(sys.modules)
"""
    subprocess.run([sys.executable, "-c", program], check=True)


def test_each_file_of_weights_has_a_name() -> None:
    """And each name has a file."""
    models = (PathPredictor, CostPredictor, Heatmap, CVAE)
    files = [file for model in models for file in model.PRETRAINED.values()]
    assert sorted(files) == sorted(file.name for file in WEIGHTS.iterdir())


@pytest.mark.parametrize(
    ("name", "connectivity", "corner_cutting"),
    [(None, 8, False), ("eight", 8, False), ("cut", 8, True), ("four", 4, False)],
)
def test_a_pretrained_planner_is_loaded_by_name(
    name: str | None,
    connectivity: int,
    corner_cutting: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In any folder; the name says how it moves, and it does not train further by itself."""
    monkeypatch.chdir(tmp_path)
    model = PathPredictor.pretrained(name)
    assert model.movement.connectivity == connectivity
    assert model.movement.corner_cutting == corner_cutting
    assert not model.training


def test_a_pretrained_sampler_is_loaded_by_name() -> None:
    """The name is that of its targets."""
    for name in Heatmap.PRETRAINED:
        assert Heatmap.pretrained(name).targets == name
    assert Heatmap.pretrained().targets == CVAE.pretrained().targets == "lego"


@pytest.mark.parametrize(
    ("model", "name", "error"),
    [
        (PathPredictor, "fuor", "got 'fuor', expected one of eight, cut, four; did you mean four?"),
        (PathPredictor, "8", "got '8', expected one of eight, cut, four; did you mean eight?"),
        (PathPredictor, 4, "got 4, expected one of eight, cut, four; did you mean four?"),
        (CostPredictor, "8", "CostPredictor.pretrained: got '8', expected one of tiles"),
        (Heatmap, "eight", "Heatmap.pretrained: got 'eight', expected one of lego, shortest_path"),
        (NeuralAstar, None, "NeuralAstar: no weights of it ship"),
    ],
)
def test_an_unknown_name_of_weights_is_refused(
    model: type[Model], name: str | None, error: str
) -> None:
    """In one line, with the names that there are."""
    with pytest.raises(ValueError, match=r"pretrained|ship") as raised:
        model.pretrained(name)
    assert error in str(raised.value)
    assert "\n" not in str(raised.value)


def test_only_samplers_need_scipy(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without it their command is one line that names the extra."""
    for file in FOLDER.rglob("*.py"):
        assert "import scipy" not in file.read_text(encoding="utf-8")
        assert "from scipy" not in file.read_text(encoding="utf-8")
    for name in [name for name in sys.modules if name.startswith("mapdata.roadmaps")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delattr("mapdata.roadmaps", raising=False)
    monkeypatch.setitem(sys.modules, "scipy", None)
    with pytest.raises(SystemExit) as exited:
        evaluate.main(["samplers", "--maps", "2"])
    assert exited.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("roadmaps need scipy, the extra [examples]: pip install scipy")


@pytest.mark.parametrize("name", [name for name in train.COMMANDS if name != "lego_sampler"])
def test_trainings_without_jsonargparse_name_the_extra(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever installs mapdata for its data does without it."""
    monkeypatch.setitem(sys.modules, "jsonargparse", None)
    with pytest.raises(SystemExit, match=r"need jsonargparse, the extra \[train\]: pip install "):
        train.main([name, "fit"])


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        ([], 2, "python -m mapdata.models.evaluate planners --help"),
        (["--help"], 0, "python -m mapdata.models.evaluate planners --help"),
        (["planer"], 2, "expected one of planners, samplers; did you mean planners?"),
    ],
)
def test_the_command_says_what_it_can_run(
    arguments: list[str], code: int, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a name it prints its help, and of an unknown name one line."""
    with pytest.raises(SystemExit) as exited:
        evaluate.main(arguments)
    assert exited.value.code == code
    printed = capsys.readouterr()
    assert text in printed.out + printed.err


def test_the_old_name_of_the_guided_search_warns() -> None:
    """It still makes the planner of a model, and names its replacement."""
    model = PathPredictor(widths=(8, 8), passes=1, terrain=True)
    with pytest.warns(
        FutureWarning, match=r"use mapdata\.evaluation\.GuidedSearch\(name, model\.m"
    ):
        planner = models.GuidedSearch("old", model, 0.3)
    assert isinstance(planner, GuidedSearch)
    assert planner.predict == model.predict
    assert (planner.name, planner.movement, planner.trust) == ("old", model.movement, 0.3)
    assert planner.takes_terrain
