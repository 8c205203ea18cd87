"""Files of weights: damaged files are refused, and a file is written as a whole or not at all."""

from __future__ import annotations

import re
import resource
import textwrap
from pathlib import Path

import pytest
import torch
from helpers.pages import DOCS
from helpers.training import trainer

from mapdata import MapDataModule, Movement
from mapdata.models.pretrained.cost_predictor import CostPredictor
from mapdata.models.pretrained.model import load_model
from mapdata.models.pretrained.path_predictor import PathPredictor


def test_a_flipped_bit_of_weights_is_refused(tmp_path: Path) -> None:
    """The hash in the file tells; safetensors itself has no checksum."""
    file = tmp_path / "weights.safetensors"
    PathPredictor(widths=(8, 8, 8), passes=1).save(file)
    sound = file.read_bytes()
    load_model(file, PathPredictor)
    for position in range(len(sound) // 4, len(sound), len(sound) // 20):
        flipped = bytearray(sound)
        flipped[position] ^= 64
        file.write_bytes(flipped)
        with pytest.raises(ValueError, match=r"holds no saved PathPredictor .*hash does not fit"):
            load_model(file, PathPredictor)


def test_other_arguments_do_not_fit_the_hash(tmp_path: Path) -> None:
    """So that a flipped bit in a number of the header is found, too."""
    file = tmp_path / "weights.safetensors"
    PathPredictor(widths=(8, 8, 8), passes=1, ratio_weight=5.0).save(file)
    sound = file.read_bytes()
    changed = sound.replace(b'\\"ratio_weight\\": 5.0', b'\\"ratio_weight\\": 4.0')
    assert changed != sound
    file.write_bytes(changed)
    with pytest.raises(ValueError, match="its hash does not fit"):
        load_model(file, PathPredictor)


def test_a_file_of_an_earlier_version_is_refused_with_the_way_to_convert_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The page has it, and it gives the same weights."""
    model = PathPredictor(widths=(8, 8, 8), passes=1)
    weights = {name: weight.half() for name, weight in model.state_dict().items()}
    arguments = {**model.hparams, "widths": [8, 8, 8]}
    checkpoint = {"class": "PathPredictor", "arguments": arguments, "weights": weights}
    torch.save(checkpoint, tmp_path / "old.pt")
    with pytest.raises(ValueError, match=r"old\.pt: .*before 0\.4\.0 .*docs/pretrained\.md"):
        load_model(tmp_path / "old.pt", PathPredictor)
    page = (DOCS / "pretrained.md").read_text(encoding="utf-8")
    (lines,) = re.findall(r"## Files of earlier versions\n.*?\n\n((?: {4}.*\n)+)", page, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(textwrap.dedent(lines))
    converted = load_model(tmp_path / "new.safetensors", PathPredictor)
    for name, weight in weights.items():
        assert torch.equal(converted.state_dict()[name].half(), weight)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*does not have many workers which may be a bottleneck")
@pytest.mark.filterwarnings("ignore:.*isinstance.treespec, LeafSpec.* is deprecated")
def test_a_model_is_not_trained_on_another_movement_than_its_own() -> None:
    """It would learn moves that it does not make, and nothing would say so."""
    one_step = trainer(fast_dev_run=True)
    for model in (PathPredictor(widths=(8, 8, 8), passes=1), CostPredictor(width=2)):
        data = MapDataModule(None, build="maze15", problems="random", movement=Movement())
        with pytest.raises(
            ValueError, match=r"movement: the model is for .*ty=8.* data for .*ty=4"
        ):
            one_step.fit(model, data)
    model = PathPredictor(connectivity=4, widths=(8, 8, 8), passes=1)
    one_step.fit(model, MapDataModule(None, build="maze15", problems="random"))


def test_saving_replaces_the_whole_file_or_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where saving fails, the file still holds the weights that were saved before."""
    file = tmp_path / "weights.pt"
    model = PathPredictor(widths=(8, 8, 8), passes=1)
    model.save(file)
    sound = file.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            model.save(file)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert file.read_bytes() == sound
    assert [path.name for path in tmp_path.iterdir()] == ["weights.pt"]
