"""The programs of docs/recipes.md run, as far as their packages are installed."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import pages
from helpers.pages import DOCS, ROOT

from mapdata import build
from mapdata.cli import main

PAGE = (DOCS / "recipes.md").read_text(encoding="utf-8")
BLOCKS = pages.blocks(DOCS / "recipes.md")
PROGRAMS = {
    package: next(
        block.text
        for block in BLOCKS
        if re.search(rf"^(import|from) {package}\b", block.text, re.MULTILINE)
    )
    for package in ("hydra", "accelerate", "skorch", "numpy")
}


def test_each_python_block_is_a_program_that_is_run() -> None:
    """No block of the page is left out, and the shell's line makes the dataset of this test."""
    texts = [block.text for block in BLOCKS if block.language == "python"]
    assert texts == list(PROGRAMS.values())
    assert [block.text for block in BLOCKS if block.language == "sh"] == [
        "mapdata build data/dungeon --preset dungeon --maps 500\n"
    ]


def test_a_configuration_can_name_a_field_function(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The line of the page gives the data module the function itself."""
    instantiate = pytest.importorskip("hydra.utils").instantiate
    create = pytest.importorskip("omegaconf").OmegaConf.create
    page = (DOCS / "recipes.md").read_text(encoding="utf-8")
    (line,) = re.findall(r"`(fields: \[.*get_method.*\])`", page)
    (tmp_path / "my_fields.py").write_text(
        "def steps_to_wall(batch):\n    return batch.map\n", encoding="utf-8"
    )
    monkeypatch.syspath_prepend(tmp_path)
    data = instantiate(create({"_target_": "mapdata.MapDataModule", **create(line)}))
    assert data.serving.names == ("map", "goal_mask", "steps_to_wall")
    assert data.serving.fields[2].__module__ == "my_fields"


@pytest.mark.slow
@pytest.mark.parametrize("package", PROGRAMS)
def test_the_program_runs(package: str, tmp_path: Path) -> None:
    """In a process of its own, in a folder with the dataset and the configuration of the page."""
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"needs pip install {package}")
    build(tmp_path / "data" / "dungeon", "dungeon", maps=500)
    if package == "numpy":  # the program of kept fields
        (command,) = re.findall(r"^    (mapdata export .*)$", PAGE, re.MULTILINE)
        _, _, source, target, *flags = command.split()
        main(["export", str(tmp_path / source), str(tmp_path / target), *flags])
    (configuration,) = (block.text for block in BLOCKS if block.language == "yaml")
    (tmp_path / "conf").mkdir()
    (tmp_path / "conf" / "config.yaml").write_text(configuration, encoding="utf-8")
    (tmp_path / "train.py").write_text(PROGRAMS[package], encoding="utf-8")
    options = ["data.batch_size=64", "data.movement.connectivity=4"] if package == "hydra" else []
    process = subprocess.run(
        [sys.executable, "train.py", *options],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    assert package != "hydra" or "1 epoch of 7 steps" in process.stdout
