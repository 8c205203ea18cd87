"""The Warcraft layout: files by its description are read, and damaged ones are refused."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from helpers.weighted import Ints, draw_costs, shortest_path, write_warcraft
from helpers.wild import Bytes, cli
from hypothesis import given
from hypothesis import strategies as st

from mapdata import MapDataset, Movement, read_shard
from mapdata.cli import load_problems
from mapdata.formats import FormatError, import_maps, read_any, read_problems
from mapdata.formats.registry import recognise
from mapdata.formats.weights import to_terrain
from mapdata.shards import read_manifest, verify

SPLITS = {"train": 4, "val": 2, "test": 3}


def costs_by_split(rows: int = 5, columns: int = 6) -> dict[str, Ints]:
    """Return the costs of a small set."""
    random = np.random.default_rng(4)
    return {split: draw_costs(random, count, rows, columns) for split, count in SPLITS.items()}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return the files of a small set, with weights in float16 as the published sets have them."""
    return write_warcraft(tmp_path / "warcraft", costs_by_split())


def test_terrain_splits_problems_and_least_costs_are_those_of_the_files(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Costs are compared with a Dijkstra of the test."""
    assert recognise(folder) == "warcraft"
    code, out, _ = cli(capsys, "import", folder, tmp_path / "data")
    assert code == 0
    assert "the pictures are left out" in out
    assert "labels compared with the source: 9 maps\n" in out
    assert "disagree" not in out
    manifest = read_manifest(tmp_path / "data")
    assert manifest.movement == Movement(8, corner_cutting=True, diagonal_cost=1.0)
    assert not verify(tmp_path / "data")
    labels = read_shard(tmp_path / "data" / manifest.shards[0].name)
    assert labels.maps.terrain is not None
    truth = costs_by_split()
    np.testing.assert_array_equal(labels.maps.terrain, np.concatenate(list(truth.values())))
    assert labels.maps.split.tolist() == [0] * 4 + [1] * 2 + [2] * 3
    for k, terrain in enumerate(labels.maps.terrain):
        assert labels.maps.seed_points[k].tolist() == [[0, 0], [4, 5]]
        vertex_sum, _ = shortest_path(terrain.astype(np.int64), (0, 0), (4, 5))
        ends = int(terrain[0, 0]) + int(terrain[4, 5])
        assert labels.matrix("astar", k)[0, 1] == vertex_sum - ends / 2
        path = labels.segment("astar", k, 0)
        assert terrain[path[:, 0], path[:, 1]].sum() == vertex_sum
    problem = MapDataset(tmp_path / "data", "test", ("start", "goal"))[0]
    assert (problem.start.tolist(), problem.goal.tolist()) == ([0, 0], [4, 5])


@pytest.mark.parametrize("dtype", ["float16", "float32", "float64"])
@pytest.mark.parametrize("cost", [1, 3, 92, 101, 255])
def test_weights_may_be_rounded_as_any_float_rounds_them(dtype: str, cost: int) -> None:
    """A tenth is no binary fraction, so no dtype holds 9.2; a float64 may have been a float16."""
    weights = np.full((1, 2), cost / 10, np.dtype(dtype))
    assert to_terrain(weights, 0.1, "a").tolist() == [[cost, cost]]
    assert to_terrain(weights.astype(np.float64), 0.1, "a").tolist() == [[cost, cost]]
    product = np.dtype(dtype).type(0.1) * np.full((1, 1), cost, np.dtype(dtype))
    assert to_terrain(product, 0.1, "a").tolist() == [[cost]]


@pytest.mark.parametrize("dtype", ["float16", "float32", "float64"])
def test_weights_are_rounded_by_no_more(dtype: str) -> None:
    """Floats just above 8 lie 8 eps apart, those below 4 eps, and 8 eps are tolerated."""
    for towards, accepted in ((np.inf, 1), (0, 2)):
        weight = np.full((1, 1), 8, np.dtype(dtype))
        for _ in range(accepted):
            weight = np.nextafter(weight, weight.dtype.type(towards))
            assert to_terrain(weight, 0.1, "a").tolist() == [[80]]
        weight = np.nextafter(weight, weight.dtype.type(towards))
        with pytest.raises(FormatError, match="expected a whole multiple"):
            to_terrain(weight, 0.1, "a")


def test_a_bad_weight_is_named_in_a_map_of_many_rows() -> None:
    """Large maps are converted a block of rows at a time."""
    weights = np.full((700, 600), 0.8, np.float32)
    assert (to_terrain(weights, 0.1, "a") == 8).all()
    weights[650, 7] = 0.85
    with pytest.raises(FormatError, match=re.escape("a: cell (650, 7) has weight 0.85")):
        to_terrain(weights, 0.1, "a")


def test_a_split_with_pictures_alone_is_named(folder: Path) -> None:
    """A download that has begun with the pictures is not left out in silence."""
    for name in ("vertex_weights", "shortest_paths"):
        (folder / f"train_{name}.npy").unlink()
    collection = read_any(folder)
    path = folder / "train_vertex_weights.npy"
    assert collection.left_out == [(str(path), "no such file")]
    assert {foreign_map.split for foreign_map in collection.maps} == {1, 2}


@given(st.integers(1, 255), st.sampled_from([0.1, 0.5, 1.0, 3.0, 1e-3]))
def test_every_multiple_of_a_unit_comes_back(cost: int, unit: float) -> None:
    """In float64, and as whole numbers where the unit is 1 or 3."""
    assert to_terrain(np.full((1, 1), cost * unit), unit, "a").tolist() == [[cost]]
    if unit >= 1:
        assert to_terrain(np.full((1, 1), int(cost * unit)), unit, "a").tolist() == [[cost]]


@pytest.mark.parametrize("weight", [0.0, -0.8, np.nan, np.inf, -np.inf, 0.85, 25.6, 1e30, 9.2002])
def test_a_weight_that_is_no_cost_is_refused(weight: float) -> None:
    """0 would be the cheapest cell there, and an occupied one here."""
    weights = np.full((2, 2), 0.8)
    weights[1, 0] = weight
    with pytest.raises(FormatError, match=re.escape("a: cell (1, 0) has weight")) as refusal:
        to_terrain(weights, 0.1, "a")
    assert "expected a whole multiple of the unit 0.1, from 0.1 to 25.5" in str(refusal.value)


def test_the_unit_is_an_option(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Weights that are whole multiples of it become smaller or larger costs."""
    weights = np.full((4, 5, 6), 12.0)
    np.save(folder / "train_vertex_weights.npy", weights)
    options = ("--format", "warcraft", "--warcraft.unit")
    code, _, err = cli(capsys, "import", folder, tmp_path / "data", *options, 4)
    assert code == 0
    assert "val_vertex_weights.npy: array" not in err
    assert err.count("expected a whole multiple of the unit 4, from 4 to 1020") == 2
    labels = read_shard(tmp_path / "data" / read_manifest(tmp_path / "data").shards[0].name)
    assert labels.maps.terrain is not None
    assert np.unique(labels.maps.terrain).tolist() == [3]
    for unit in (0, -1, "nan", "inf"):
        code, _, err = cli(capsys, "import", folder, tmp_path / "other", *options, unit)
        assert (code, "unit: got" in err) == (2, True)


def test_a_path_that_is_no_shortest_one_is_counted(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One path is longer, one is torn, one does not reach the goal, and one is another shortest."""
    weights = np.full((4, 5, 6), 0.8, np.float16)
    marks = np.zeros((4, 5, 6), np.uint8)
    diagonal = np.arange(5)
    marks[:, diagonal, diagonal + 1] = 1
    marks[:, 0, 0] = 1
    marks[0, 0, 3] = 1  # a cell more
    marks[1, 2, 3] = 0  # as cheap as a path, but torn
    marks[1, 0, 5] = 1
    marks[2, 4, 5] = 0
    np.save(folder / "train_vertex_weights.npy", weights)
    np.save(folder / "train_shortest_paths.npy", marks)
    source = folder / "train_vertex_weights.npy"
    code, out, _ = cli(capsys, "import", source, tmp_path / "data")
    assert code == 0
    assert "labels compared with the source: 4 maps\n  path: 3 disagree" in out


def test_copies_across_splits_are_counted_by_their_costs(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """All maps are free everywhere, so their occupancy says nothing."""
    _, out, _ = cli(capsys, "import", folder, tmp_path / "data")
    assert "no map stands in two splits" in out
    assert re.search(r"distinct maps: +9 of 9 \(9 up to symmetry\)", out)
    costs = costs_by_split()
    costs["test"][1] = costs["train"][2][::-1]
    write_warcraft(folder, costs)
    _, out, _ = cli(capsys, "import", folder, tmp_path / "copies", "--drop-leaks")
    assert "0 of test in train (1 up to symmetry)" in out
    assert read_manifest(tmp_path / "copies").maps == 8


def test_a_file_of_another_name_is_refused(folder: Path) -> None:
    """The name of the file says the split."""
    for name in ("train_maps.npy", "train_shortest_paths.npy"):
        with pytest.raises(FormatError, match="expected a folder, or its train_vertex_weights"):
            read_any(folder / name)
    for path in folder.iterdir():
        path.rename(folder / f"my_{path.name}")
    assert recognise(folder) == "warcraft"
    with pytest.raises(FormatError, match=r"no map can be used: .*; .*; "):
        read_any(folder)


def test_sets_of_several_sizes_are_datasets_of_their_own(tmp_path: Path) -> None:
    """As in the published archive, which has a folder for each size."""
    write_warcraft(tmp_path / "sets" / "5x6", costs_by_split())
    write_warcraft(tmp_path / "sets" / "4x4", costs_by_split(4, 4))
    datasets = import_maps(tmp_path / "data", read_any(tmp_path / "sets"))
    assert [dataset.root.name for dataset in datasets] == ["4x4", "5x6"]
    assert [dataset.manifest.maps for dataset in datasets] == [9, 9]


def test_maps_with_and_without_terrain_are_not_one_dataset(folder: Path, tmp_path: Path) -> None:
    """A dataset has terrain or it has none."""
    collection = read_any(folder)
    grid: Bytes = np.zeros((5, 6), np.uint8)
    np.save(tmp_path / "plain.npy", grid)
    collection.maps += read_any(tmp_path / "plain.npy").maps
    with pytest.raises(ValueError, match="9 of 10 maps have terrain: import them separately"):
        import_maps(tmp_path / "data", collection)


def test_tiles_of_a_map_keep_their_terrain(folder: Path, tmp_path: Path) -> None:
    """They are cut from the upper left; seed points are drawn."""
    datasets = import_maps(tmp_path / "data", read_any(folder), tile=(2, 3))
    labels = read_shard(tmp_path / "data" / datasets[0].manifest.shards[0].name)
    assert labels.maps.terrain is not None
    first = costs_by_split()["train"][0]
    np.testing.assert_array_equal(labels.maps.terrain[1], first[:2, 3:])
    np.testing.assert_array_equal(labels.maps.terrain[2], first[2:4, :3])


def test_problems_to_compare_planners_on_are_those_of_a_split(folder: Path) -> None:
    """Every k-th with a count; the optimal costs are those of a Dijkstra of the test."""
    costs = costs_by_split()
    for split, source in (("test", folder), ("train", folder / "train_vertex_weights.npy")):
        problems = read_problems(source)
        assert problems.terrain is not None
        np.testing.assert_array_equal(problems.terrain, costs[split])
        for k, grid in enumerate(costs[split]):
            vertex_sum, _ = shortest_path(grid, (0, 0), (4, 5))
            ends = int(grid[0, 0] + grid[4, 5])
            assert problems.optimal.cost[k] == vertex_sum - ends / 2
    selected = read_problems(folder, split="train", count=2)
    np.testing.assert_array_equal(selected.terrain, costs["train"][::2])
    for path in folder.glob("val_*"):
        path.unlink()
    with pytest.raises(FormatError, match=r"holds 0 files of the split 'val' among test_vertex"):
        read_problems(folder, split="val")


def test_the_commands_that_compare_planners_take_a_file_of_weights(folder: Path) -> None:
    """Its movement replaces the default of the flags."""
    file = str(folder / "test_vertex_weights.npy")
    problems = load_problems([file], None, None, 2, movement=Movement(8))
    assert len(problems) == 2
    assert problems.movement == Movement(8, corner_cutting=True, diagonal_cost=1.0)
    np.testing.assert_array_equal(problems.terrain, costs_by_split()["test"][::2])
