"""Files of weights: damaged files are refused, and a file is written as a whole or not at all."""

from __future__ import annotations

import resource
import zipfile
from pathlib import Path

import pytest
from helpers.training import trainer

from mapdata import MapDataModule, Movement
from mapdata.models.pretrained.cost_predictor import CostPredictor
from mapdata.models.pretrained.model import load_model
from mapdata.models.pretrained.path_predictor import PathPredictor


def test_a_flipped_bit_of_weights_is_refused(tmp_path: Path) -> None:
    """The checksums of the archive tell; torch does not compare them."""
    file = tmp_path / "weights.pt"
    PathPredictor(widths=(8, 8, 8), passes=1).save(file)
    sound = file.read_bytes()
    load_model(file, PathPredictor)
    for position in range(len(sound) // 4, len(sound) // 2, len(sound) // 40):
        flipped = bytearray(sound)
        flipped[position] ^= 64
        file.write_bytes(flipped)
        with pytest.raises(ValueError, match=r"weights\.pt: holds no saved PathPredictor"):
            load_model(file, PathPredictor)


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


def test_an_entry_marked_as_a_folder_is_refused(tmp_path: Path) -> None:
    """One bit of the archive's directory says so; torch then skips the bytes of the entry, and
    serves whatever its memory holds as weights.
    """
    file = tmp_path / "weights.pt"
    PathPredictor(widths=(8, 8, 8), passes=1).save(file)
    marked = bytearray(file.read_bytes())
    # The directory is at the end of the archive; its record of the first weights:
    record = marked.rindex(b"PK\x01\x02", 0, marked.rindex(b"/data/0"))
    marked[record + 38] ^= 0x10  # the attribute of MS-DOS for a folder
    file.write_bytes(marked)
    with zipfile.ZipFile(file) as archive:
        assert archive.testzip() is None
    with pytest.raises(ValueError, match=r"weights\.pt: holds no saved .*entries have attributes"):
        load_model(file, PathPredictor)


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
