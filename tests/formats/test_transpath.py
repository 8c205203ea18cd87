"""TransPath's folders of .npy files: maps and problems are read, nothing else is taken for one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.grids import scipy_distances
from helpers.wild import cli

from mapdata import ProblemSetDataset, read_shard
from mapdata.arrays import Array, Bytes
from mapdata.formats import FormatError, read_any, read_problems
from mapdata.formats.registry import recognise
from mapdata.formats.transpath import read
from mapdata.limits import SPLITS
from mapdata.movement import Movement
from mapdata.shards import read_manifest

SAMPLES = {"train": 7, "val": 3, "test": 4}


def one_hot(cells: Array, shape: tuple[int, ...]) -> Array:
    """Return masks (N, 1, H, W), bool, that are True in one cell each, (N, 2)."""
    masks = np.zeros(shape, bool)
    masks[np.arange(len(cells)), 0, cells[:, 0], cells[:, 1]] = True
    return masks


def write_samples(folder: Path, grids: Bytes, starts: Array, goals: Array) -> None:
    """Write the six files of a split as their loader opens them, labels without a meaning."""
    folder.mkdir(parents=True)
    maps = grids[:, None]
    labels = np.random.default_rng(1).random(maps.shape)
    np.save(folder / "maps.npy", maps.astype(np.float32))
    np.save(folder / "starts.npy", one_hot(starts, maps.shape))
    np.save(folder / "goals.npy", one_hot(goals, maps.shape))
    for name in ("focal", "cf", "abs"):
        np.save(folder / f"{name}.npy", labels)


@pytest.fixture
def samples(tmp_path: Path) -> dict[str, tuple[Bytes, Array, Array]]:
    """Write three splits below ``TransPath_data``; return grids, starts and goals of each."""
    written = {}
    random = np.random.default_rng(0)
    for split, count in SAMPLES.items():
        grids = (random.random((count, 12, 12)) < 0.3).astype(np.uint8)
        starts, goals = random.integers(0, 12, (2, count, 2))
        for cells in (starts, goals):
            grids[np.arange(count), cells[:, 0], cells[:, 1]] = 0
        write_samples(tmp_path / "TransPath_data" / split, grids, starts, goals)
        written[split] = (grids, starts, goals)
    return written


def test_maps_splits_goals_and_starts_are_read(
    samples: dict[str, tuple[Bytes, Array, Array]],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Each sample gives a map, whose first two seed points are the goal and the start."""
    folder = tmp_path / "TransPath_data"
    assert recognise(folder) == "transpath"
    collection = read_any(folder)
    assert collection.left_out == []
    assert len(collection.maps) == 14
    for split, (grids, starts, goals) in samples.items():
        of_split = [sample for sample in collection.maps if sample.split == SPLITS.index(split)]
        assert [sample.name for sample in of_split] == [
            f"{folder / split / 'maps.npy'}: {number}" for number in range(len(grids))
        ]
        for sample, grid, start, goal in zip(of_split, grids, starts, goals, strict=True):
            assert np.array_equal(sample.grid, grid)
            assert sample.seed_points.tolist() == [goal.tolist(), start.tolist()]
    code, out, _ = cli(capsys, "import", folder, tmp_path / "maps", "--seed-points", 2)
    assert code == 0
    assert "labels (focal, cf, abs) are left out" in out
    manifest = read_manifest(tmp_path / "maps")
    assert (manifest.maps, manifest.movement) == (14, Movement(8, corner_cutting=True))
    (entry,) = manifest.shards
    maps = read_shard(tmp_path / "maps" / entry.name).maps
    ends = [
        (goal, start)
        for _, starts, goals in samples.values()
        for goal, start in zip(goals, starts, strict=True)
    ]
    assert sorted(maps.seed_points[:, :2].tolist()) == sorted(np.array(ends).tolist())


def test_one_folder_or_its_maps_file_is_read(
    samples: dict[str, tuple[Bytes, Array, Array]], tmp_path: Path
) -> None:
    """The folder need not be named after a split; a file of starts is refused."""
    folder = tmp_path / "TransPath_data" / "val"
    for source in (folder, folder / "maps.npy"):
        assert recognise(source) == "transpath"
        collection = read_any(source)
        assert [sample.split for sample in collection.maps] == [None] * 3
        assert np.array_equal([sample.grid for sample in collection.maps], samples["val"][0])
    for name in ("starts.npy", "cf.npy"):
        with pytest.raises(FormatError, match=rf"{name}: expected maps\.npy"):
            read_any(folder / name)


def test_maps_without_starts_and_goals_are_images(tmp_path: Path) -> None:
    """Any stack of grids may be in a file maps.npy."""
    np.save(tmp_path / "maps.npy", np.zeros((2, 1, 6, 6)))
    np.save(tmp_path / "starts.npy", np.zeros((2, 1, 6, 6)))
    assert recognise(tmp_path) == "images"


def test_samples_with_bad_ends_are_left_out(tmp_path: Path) -> None:
    """Bad ends are a start on an occupied cell, two goals or no goal; if the start is the goal,
    there is one seed point.
    """
    grids = np.zeros((6, 5, 5), np.uint8)
    grids[1, 2, 2] = 1
    starts = np.full((6, 2), 2)
    goals = np.zeros((6, 2), int)
    goals[5] = 2
    write_samples(tmp_path / "train", grids, starts, goals)
    masks = np.load(tmp_path / "train" / "goals.npy")
    masks[2, 0, 4, 4] = True
    masks[3] = False
    np.save(tmp_path / "train" / "goals.npy", masks)
    collection = read(tmp_path)
    assert [sample.name[-1] for sample in collection.maps] == ["0", "4", "5"]
    assert collection.maps[-1].seed_points.tolist() == [[2, 2]]
    assert collection.left_out == [
        (
            f"{tmp_path / 'train' / 'maps.npy'}: 1 and 2 others",
            "its start or its goal is not one free cell",
        )
    ]


MOVEMENT = Movement(8, corner_cutting=True)


def write_problems(folder: Path, count: int, seed: int) -> tuple[Bytes, Array, Array]:
    """Write samples with a path from start to goal; return grids, starts and goals."""
    random = np.random.default_rng(seed)
    grids = np.empty((count, 12, 12), np.uint8)
    starts = np.empty((count, 2), np.int64)
    goals = np.empty((count, 2), np.int64)
    number = 0
    while number < count:
        grid = (random.random((12, 12)) < 0.4).astype(np.uint8)
        start, goal = random.choice(np.argwhere(grid == 0), 2, replace=False)
        (distances,) = scipy_distances(grid, [(int(goal[0]), int(goal[1]))], MOVEMENT)
        if distances[tuple(start)] > 0:
            grids[number], starts[number], goals[number] = grid, start, goal
            number += 1
    write_samples(folder, grids, starts, goals)
    return grids, starts, goals


def test_problems_of_the_test_split_are_read(tmp_path: Path) -> None:
    """Or those of another split; their costs are scipy's, and a dataset serves them."""
    folder = tmp_path / "TransPath_data"
    written = {
        split: write_problems(folder / split, count, count) for split, count in SAMPLES.items()
    }
    options: dict[str, dict[str, Any]] = {"test": {}, "train": {"split": "train"}}
    for split, split_options in options.items():
        grids, starts, goals = written[split]
        problems = read_problems(folder, **split_options)
        assert np.array_equal(problems.grids, grids)
        assert np.array_equal(problems.starts, starts)
        assert np.array_equal(problems.goals, goals)
        assert problems.movement == MOVEMENT
        assert problems.description == f"{len(grids)} problems of {folder / split}"
        batch = ProblemSetDataset(problems, ("start_mask", "goal_mask", "cost_to_go", "cost"))[:]
        assert np.array_equal(batch.start_mask, np.load(folder / split / "starts.npy"))
        assert np.array_equal(batch.goal_mask, np.load(folder / split / "goals.npy"))
        for k, (grid, goal) in enumerate(zip(grids, goals, strict=True)):
            (distances,) = scipy_distances(grid, [(int(goal[0]), int(goal[1]))], MOVEMENT)
            np.testing.assert_allclose(batch.cost_to_go[k, 0], distances, rtol=1e-6)
            assert float(batch.cost[k]) == pytest.approx(distances[tuple(starts[k])], rel=1e-6)
    for source in (folder / "val", folder / "val" / "maps.npy"):
        assert np.array_equal(read_problems(source).grids, written["val"][0])


def test_a_count_spreads_problems_over_the_folder(tmp_path: Path) -> None:
    """Every third of seven samples is read where three are wanted."""
    _, starts, _ = write_problems(tmp_path / "test", 7, seed=7)
    problems = read_problems(tmp_path, count=3)
    assert np.array_equal(problems.starts, starts[::3])
    assert problems.description == f"3 of 7 problems of {tmp_path / 'test'}, one in 3"
    with pytest.raises(ValueError, match="count: got 0"):
        read_problems(tmp_path, count=0)
    with pytest.raises(ValueError, match="split: got 'tset'"):
        read_problems(tmp_path, split="tset")


def test_problems_need_one_folder_of_the_split(tmp_path: Path) -> None:
    """The message lists the folders that there are."""
    write_problems(tmp_path / "train", 2, seed=1)
    write_problems(tmp_path / "val", 2, seed=2)
    with pytest.raises(FormatError, match=r"holds 0 folders .* split 'test' among train, val; exp"):
        read_problems(tmp_path)
    write_problems(tmp_path / "a" / "test", 2, seed=3)
    write_problems(tmp_path / "b" / "test", 2, seed=4)
    with pytest.raises(FormatError, match="holds 2 folders of samples of the split 'test'"):
        read_problems(tmp_path)
    assert len(read_problems(tmp_path, split="val")) == 2


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("no start", "sample 3: its start is not one free cell; remove the sample"),
        ("two goals", "sample 3: its goal is not one free cell"),
        ("half a goal", "sample 3: its goal is not one free cell"),
        ("occupied start", "sample 3: its start is not one free cell"),
        ("start at the goal", "sample 3: its start is its goal"),
        ("no path", "sample 3: no path leads from its start to its goal"),
    ],
)
def test_a_bad_sample_is_refused_by_its_number(fault: str, message: str, tmp_path: Path) -> None:
    """With or without a count; samples that a count leaves out are not looked at."""
    folder = tmp_path / "test"
    write_problems(folder, 6, seed=6)
    maps = np.load(folder / "maps.npy")
    starts = np.load(folder / "starts.npy").astype(np.float64)
    goals = np.load(folder / "goals.npy").astype(np.float64)
    if fault == "no start":
        starts[3] = 0
    elif fault == "two goals":
        goals[3, 0, [0, 1], 0] = 1
    elif fault == "half a goal":
        goals[3] /= 2
    elif fault == "occupied start":
        maps[3] = starts[3]
    elif fault == "start at the goal":
        starts[3] = goals[3]
    else:
        starts[3] = goals[3] = maps[3] = 0
        starts[3, 0, 0, 0] = goals[3, 0, 11, 11] = 1
        maps[3, 0, 6] = 1
    for name, array in (("maps", maps), ("starts", starts), ("goals", goals)):
        np.save(folder / f"{name}.npy", array)
    refused: list[dict[str, Any]] = [{}, {"count": 2}]  # the samples 0 to 5, or 0 and 3
    for options in refused:
        with pytest.raises(FormatError, match=rf"{tmp_path}/test/maps\.npy: {message}"):
            read_problems(tmp_path, **options)
    assert len(read_problems(tmp_path, count=3)) == 3  # the samples 0, 2 and 4
