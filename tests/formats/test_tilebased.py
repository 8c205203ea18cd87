"""The layout of tilebased_navigation_datasets: files by its description, and damaged ones."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from helpers.weighted import draw_costs, shortest_path, tile_arrays
from helpers.wild import cli

from mapdata import Movement, read_shard
from mapdata.formats import FormatError, import_maps, read_any, read_problems
from mapdata.formats.registry import recognise
from mapdata.shards import read_manifest

SPLITS = {"train": 3, "val": 1, "test": 2}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a small set."""
    random = np.random.default_rng(6)
    folder = tmp_path / "tiles"
    folder.mkdir()
    for split, count in SPLITS.items():
        costs = draw_costs(random, count, 6, 7)
        np.savez(folder / f"{split}.npz", **tile_arrays(random, costs))  # type: ignore[arg-type]
    return folder


def test_terrain_problems_and_least_costs_are_those_of_the_files(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every pair of target and source is a pair of seed points, with the cost of a Dijkstra of the
    test.
    """
    assert recognise(folder) == "tilebased"
    code, out, _ = cli(capsys, "import", folder, tmp_path / "data")
    assert code == 0
    assert "pictures and expanded cells are left out" in out
    assert "labels compared with the source: 6 maps\n" in out
    assert "disagree" not in out
    manifest = read_manifest(tmp_path / "data")
    assert manifest.movement == Movement(8, corner_cutting=True, diagonal_cost=1.0)
    labels = read_shard(tmp_path / "data" / manifest.shards[0].name)
    maps = labels.maps
    assert maps.terrain is not None
    assert maps.split.tolist() == [0, 0, 0, 1, 2, 2]
    k = 0
    for split in SPLITS:
        with np.load(folder / f"{split}.npz") as file:
            arrays = dict(file)
        for number, weights in enumerate(arrays["costs"]):
            costs = np.rint(weights * 10).astype(np.int64)
            np.testing.assert_array_equal(maps.terrain[k], costs)
            points = maps.seed_points[k, : maps.rooms[k]].tolist()
            assert points[0] == arrays["targets"][number, 0].tolist()
            matrix = labels.matrix("astar", k)
            for target, source in np.ndindex(2, 3):
                goal = arrays["targets"][number, target].tolist()
                start = arrays["sources"][number, target, source].tolist()
                vertex_sum, _ = shortest_path(costs, tuple(start), tuple(goal))
                ends = int(costs[tuple(start)]) + int(costs[tuple(goal)])
                cost = matrix[points.index(start), points.index(goal)]
                assert cost == vertex_sum - ends / 2
            k += 1


def test_a_longer_path_is_counted(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A map disagrees if any of its paths is no shortest one."""
    with np.load(folder / "train.npz") as file:
        arrays = dict(file)
    arrays["paths"][1, 0, 2] = 1
    np.savez(folder / "train.npz", **arrays)
    _, out, _ = cli(capsys, "import", folder / "train.npz", tmp_path / "data")
    assert "labels compared with the source: 3 maps\n  path: 1 disagree" in out
    assert "splits:               train 3, val 0, test 0" in out


FAULTS = {
    "costs": (np.zeros((3, 6)), "'costs': has shape (3, 6), expected (N, H, W)"),
    "targets": (np.zeros((3, 1, 2)), "'targets': has shape (3, 1, 2), expected (3, 2, 2)"),
    "sources": (np.zeros((3, 2, 2)), "'sources': has shape (3, 2, 2), expected (3, T, S, 2)"),
    "paths": (np.zeros((3, 2, 3, 6, 6)), "'paths': has shape (3, 2, 3, 6, 6), expected (3, 2, 3"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_an_array_of_another_shape_is_refused(
    name: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In a folder the file is left out in one line; by itself it is refused."""
    array, message = FAULTS[name]
    with np.load(folder / "train.npz") as file:
        np.savez(folder / "train.npz", **{**file, name: array})
    code, out, err = cli(capsys, "import", folder, tmp_path / "data")
    assert code == 0
    assert "splits:               train 0, val 1, test 2" in out
    assert [message in line for line in err.splitlines() if line.startswith("left")] == [True]
    with pytest.raises(FormatError, match=re.escape(message)):
        read_any(folder / "train.npz")


def test_paths_in_fortran_order_belong_to_their_problems(folder: Path, tmp_path: Path) -> None:
    """The first axis varies fastest there, and paths lie along three axes."""
    with np.load(folder / "train.npz") as file:
        arrays = {name: np.asarray(array, order="F") for name, array in file.items()}
    np.savez(folder / "train.npz", **arrays)  # type: ignore[arg-type]
    (dataset,) = import_maps(tmp_path / "data", read_any(folder / "train.npz"))
    assert (dataset.checked, dataset.disagreements) == (3, {})
    arrays["paths"][:, 1, 2], arrays["paths"][:, 0, 0] = (
        arrays["paths"][:, 0, 0].copy(),
        arrays["paths"][:, 1, 2].copy(),
    )
    np.savez(folder / "train.npz", **arrays)  # type: ignore[arg-type]
    (exchanged,) = import_maps(tmp_path / "exchanged", read_any(folder / "train.npz"))
    assert exchanged.disagreements == {"path": 3}


def test_a_map_with_one_cell_gets_more_seed_points(tmp_path: Path) -> None:
    """Its only source is its target, so the import draws the other seed points."""
    costs = draw_costs(np.random.default_rng(3), 2, 5, 6)
    arrays = tile_arrays(np.random.default_rng(3), costs, targets=1, sources=1)
    arrays["targets"][0, 0] = arrays["sources"][0, 0, 0] = 2
    arrays["paths"][0] = 0
    arrays["paths"][0, 0, 0, 2, 2] = 1
    np.savez(tmp_path / "train.npz", **arrays)  # type: ignore[arg-type]
    collection = read_any(tmp_path / "train.npz")
    one, two = collection.maps
    assert (one.seed_points.tolist(), one.rooms_known, two.rooms_known) == ([[2, 2]], False, True)
    (dataset,) = import_maps(tmp_path / "data", collection, seed_points=4)
    maps = read_shard(dataset.root / dataset.manifest.shards[0].name).maps
    assert maps.rooms.tolist() == [4, 2]
    assert maps.seed_points[0, 0].tolist() == [2, 2]


def test_problems_to_compare_planners_on_are_those_of_a_split(folder: Path) -> None:
    """From each source to its target, but not from a cell to itself."""
    with np.load(folder / "test.npz") as file:
        arrays = dict(file)
    arrays["sources"][0, 1, 2] = arrays["targets"][0, 1]
    np.savez(folder / "test.npz", **arrays)
    problems = read_problems(folder)
    expected = []
    for number, target, source in np.ndindex(2, 2, 3):
        start = tuple(arrays["sources"][number, target, source].tolist())
        goal = tuple(arrays["targets"][number, target].tolist())
        costs = np.rint(arrays["costs"][number] * 10).astype(np.int64)
        if start != goal:
            vertex_sum, _ = shortest_path(costs, start, goal)
            cost = vertex_sum - int(costs[start] + costs[goal]) / 2
            expected.append((start, goal, cost))
    found = zip(problems.starts, problems.goals, problems.optimal.cost, strict=True)
    assert [(tuple(start), tuple(goal), cost) for start, goal, cost in found] == expected
    assert len(read_problems(folder, split="train", count=5)) == 5
    assert len(read_problems(folder / "val.npz")) <= 6
