"""The field ``maze_image`` beside pictures that plain Python paints."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers import samples

from mapdata import (
    MapDataModule,
    MapDataset,
    MazeImage,
    Movement,
    OnlineMapDataset,
    ProblemSet,
    ProblemSetDataset,
)
from mapdata.arrays import Bytes
from mapdata.datasets import Sample

BLACK, WHITE, RED, GREEN, BLUE = (0, 0, 0), (255, 255, 255), (255, 0, 0), (0, 255, 0), (0, 0, 255)


def painted(sample: Sample, pixels: int, with_path: bool) -> Bytes:
    """Paint the cells of a problem one by one, then each cell as a square of pixels."""
    occupied = sample.map[0].numpy()
    rows, columns = occupied.shape
    colours = {
        (row, column): BLACK if occupied[row, column] else WHITE
        for row in range(rows)
        for column in range(columns)
    }
    if with_path:
        colours |= {tuple(cell): BLUE for cell in sample.path.tolist()}
    colours[tuple(sample.goal.tolist())] = GREEN
    colours[tuple(sample.start.tolist())] = RED
    picture = np.zeros((3, rows * pixels, columns * pixels), np.uint8)
    for y in range(rows * pixels):
        for x in range(columns * pixels):
            picture[:, y, x] = colours[y // pixels, x // pixels]
    return picture


SOURCES = ("stored", "augmented", "random", "radius", "online", "set", "terrain", "no path")


def dataset_of(source: str, root: str, field: Any) -> Any:
    """Return a dataset of each kind that serves the field."""
    fields = ("map", "start", "goal", "path", field)
    if source == "set":
        problems = ProblemSet.sample("cave", seed=3, maps=6, movement=Movement(8))
        return ProblemSetDataset(problems, fields)
    if source in ("online", "terrain"):
        preset = {"online": "maze15", "terrain": "tiles"}[source]
        return OnlineMapDataset(preset, 7, 6, None, fields)
    if source == "no path":
        return MapDataset(root, None, fields, problems={"pairs": {"unsolvable": True}})
    return MapDataset(
        root,
        "train",
        fields,
        problems="random" if source == "random" else "route",
        augment=source == "augmented",
        radius=0.1 if source == "radius" else 0.0,
    )


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A small dataset of 9 x 70 maps."""
    return samples.build_small(
        tmp_path_factory.mktemp("maze-image") / "maps", samples.WIDE, maps=20
    )


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize(("pixels", "with_path"), [(1, False), (1, True), (3, True)])
def test_pictures_are_those_of_plain_python(
    root: str, source: str, pixels: int, with_path: bool
) -> None:
    """Also turned, inflated by a radius, on terrain, and without a path."""
    dataset = dataset_of(source, root, MazeImage(pixels, path=with_path))
    for k in range(0, len(dataset), max(1, len(dataset) // 4)):
        sample = dataset[k]
        expected = painted(sample, pixels, with_path)
        np.testing.assert_array_equal(sample.maze_image.numpy(), expected)
    assert sample.maze_image.dtype == torch.uint8


def test_the_name_alone_is_a_pixel_a_cell_without_the_path(root: str) -> None:
    """So that the answer is not in the picture unless it is asked for."""
    named = MapDataset(root, "train", ("maze_image",))[:4].maze_image
    assert torch.equal(named, MapDataset(root, "train", (MazeImage(),))[:4].maze_image)
    blue = (named == torch.tensor(BLUE).reshape(1, 3, 1, 1)).all(dim=1)
    assert not blue.any()


def test_a_start_that_is_the_goal_is_red(root: str) -> None:
    """One of the two colours has to win; a picture always shows where a path begins."""
    batch = MapDataset(root, "train").batch_of(np.arange(3), epoch=0)
    rows, columns = batch.starts.T
    colours = MazeImage()(replace(batch, goals=batch.starts))[np.arange(3), :, rows, columns]
    assert (colours == RED).all()


def test_the_data_module_casts_it_on_the_device(root: str, tmp_path: Path) -> None:
    """As the other images; and options can be pickled for workers."""
    field = MazeImage(2, path=True)
    assert pickle.loads(pickle.dumps(field)) == field
    module = MapDataModule(root, fields=("map", field), batch_size=4, num_workers=0)
    batch = module.on_after_batch_transfer(next(iter(module.val_dataloader())), 0)
    assert batch.maze_image.dtype == torch.float32
    assert set(batch.maze_image.unique().tolist()) <= {0.0, 255.0}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pixels": 0}, "pixels: got 0"),
        ({"pixels": 33}, "pixels: got 33, expected at most 32"),
        ({"path": "yes"}, "path: got 'yes'"),
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, Any], message: str) -> None:
    """The message says what is expected."""
    with pytest.raises((TypeError, ValueError), match=message):
        MazeImage(**options)
