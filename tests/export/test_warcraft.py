"""The export of the Warcraft layout, and of maps with terrain in general."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.weighted import shortest_path

from mapdata import (
    Maze,
    Movement,
    OnlineMapDataset,
    Terrain,
    build,
)
from mapdata.export import PROBLEM_FORMATS, export_problems
from mapdata.export.layouts import LAYOUTS
from mapdata.formats import export
from mapdata.formats.registry import functions_by_format

MOVEMENT = Movement(8, corner_cutting=True, diagonal_cost=1.0)
CORNERS = Terrain((6, 7), (8, 12, 53, 77, 92), obstacles=0.0, corners=True, movement=MOVEMENT)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an export of 8 problems a split."""
    folder = tmp_path_factory.mktemp("warcraft") / "set"
    export_problems(CORNERS, folder, format="warcraft", count=8)
    return folder


@pytest.mark.parametrize(
    ("start", "goal"),
    [((1, 0), (5, 6)), ((0, 1), (5, 6)), ((0, 0), (4, 6)), ((0, 0), (5, 5)), ((5, 6), (0, 0))],
)
def test_a_problem_with_one_end_in_another_cell_is_refused(
    start: tuple[int, int], goal: tuple[int, int]
) -> None:
    """Both ends count, and both of their coordinates."""
    check = LAYOUTS["warcraft"].check
    assert check is not None
    columns = {
        "terrain": np.ones((2, 1, 6, 7), np.uint8),
        "start": np.array([(0, 0), (0, 0)]),
        "goal": np.array([(5, 6), (5, 6)]),
    }
    check(columns, MOVEMENT)
    columns["start"][1] = start
    columns["goal"][1] = goal
    with pytest.raises(ValueError, match=re.escape(f"a problem from {start} to {goal}")):
        check(columns, MOVEMENT)


def loaded(folder: Path, split: str) -> tuple[Any, Any, Any]:
    """Return pictures, weights and paths of a split, as every loader opens them."""
    names = ("maps", "vertex_weights", "shortest_paths")
    pictures, weights, paths = (np.load(folder / f"{split}_{name}.npy") for name in names)
    return pictures, weights, paths


def test_files_hold_what_a_dataset_serves(folder: Path) -> None:
    """Pictures have their channels last; a weight is a tenth of the cost."""
    for split in ("train", "val", "test"):
        pictures, weights, paths = loaded(folder, split)
        fields = ("image", "terrain", "path_mask")
        dataset = OnlineMapDataset(CORNERS, 0, 8, split, fields, movement=MOVEMENT)
        assert (pictures.dtype, weights.dtype, paths.dtype) == (np.uint8, np.float32, np.uint8)
        assert pictures.shape == (8, 48, 56, 3)
        for i, sample in enumerate(dataset):
            np.testing.assert_array_equal(pictures[i], sample.image.numpy().transpose(1, 2, 0))
            np.testing.assert_array_equal(np.rint(weights[i] * 10), sample.terrain[0])
            np.testing.assert_array_equal(paths[i], sample.path_mask[0])
    values = json.loads((folder / "export.json").read_text())
    assert values["files"]["train_vertex_weights.npy"]["shape"] == [8, 6, 7]
    assert values["problems"] == {"train": 8, "val": 8, "test": 8}


def test_paths_are_shortest_by_the_rule_of_the_set(folder: Path) -> None:
    """The sum of the weights of a path's cells is that of a Dijkstra of the test."""
    for split in ("train", "val", "test"):
        _, weights, paths = loaded(folder, split)
        for weight, path in zip(weights, paths, strict=True):
            costs = np.rint(weight * 10).astype(np.int64)
            vertex_sum, _ = shortest_path(costs, (0, 0), (5, 6))
            assert costs[path == 1].sum() == vertex_sum
            assert path[0, 0] == path[5, 6] == 1


@pytest.mark.parametrize(
    ("generator", "options", "message"),
    [
        (
            Terrain((6, 7), obstacles=0.2, corners=True, movement=MOVEMENT),
            {},
            "warcraft: got maps with occupied cells, whose weight 0 would be the cheapest",
        ),
        (
            Terrain((6, 7), obstacles=0.0, movement=MOVEMENT),
            {},
            r"but its loaders take all problems to lead from \(0, 0\) to \(5, 6\)",
        ),
        (CORNERS, {"problems": "random"}, r"to lead from \(0, 0\) to \(5, 6\)"),
        (CORNERS, {"augment": True}, r"to lead from \(0, 0\) to \(5, 6\)"),
        (CORNERS, {"movement": Movement(4)}, r"warcraft: got Movement\(connectivity=4"),
        (CORNERS, {"movement": Movement(8)}, "the rule of its loaders"),
        (CORNERS, {"search": "bfs"}, "warcraft holds cheapest paths, got 'bfs', expected 'astar'"),
        (Maze((7, 7)), {}, "got maps without terrain, expected costs of cells"),
    ],
)
def test_problems_that_the_layout_cannot_hold_are_refused(
    generator: Any, options: dict[str, Any], message: str, tmp_path: Path
) -> None:
    """The message says what was got and what was expected; nothing remains."""
    with pytest.raises(ValueError, match=message) as refusal:
        export_problems(generator, tmp_path / "out", format="warcraft", count=30, **options)
    assert "\n" not in str(refusal.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "format_name",
    sorted({*PROBLEM_FORMATS, *functions_by_format("write")} - {"arrays", "parquet", "warcraft"}),
)
def test_formats_without_costs_refuse_terrain(format_name: str, tmp_path: Path) -> None:
    """Their loaders would take all cells to cost the same."""
    build(tmp_path / "data", CORNERS, maps=3, workers=1)
    target = tmp_path / f"out{'.npz' if format_name == 'planning-datasets' else ''}"
    message = f"{format_name} has no costs of cells"
    if format_name in PROBLEM_FORMATS:
        with pytest.raises(ValueError, match=message):
            export_problems(str(tmp_path / "data"), target, format=format_name)
    else:
        with pytest.raises(ValueError, match=message):
            export(tmp_path / "data", target, format_name)
    assert not target.exists()


@pytest.mark.parametrize("format_name", ["arrays", "parquet"])
def test_arrays_and_parquet_hold_terrain_and_pictures(format_name: str, tmp_path: Path) -> None:
    """Like any field."""
    generator = Terrain((6, 7), movement=Movement(8))
    fields = ("terrain", "image", "start", "goal", "cost")
    if format_name == "parquet":
        pytest.importorskip("pyarrow")
    export_problems(generator, tmp_path / "out", format=format_name, count=5, fields=fields)
    dataset = OnlineMapDataset(generator, 0, 5, "val", fields)
    terrain = np.stack([sample.terrain.numpy() for sample in dataset])
    images = np.stack([sample.image.numpy() for sample in dataset])
    if format_name == "arrays":
        stored_terrain = np.load(tmp_path / "out/val/terrain.npy")
        stored_images = np.load(tmp_path / "out/val/image.npy")
    else:
        from pyarrow import parquet

        table = parquet.read_table(tmp_path / "out/data/validation-00000-of-00001.parquet")
        stored_terrain = np.array(table["terrain"].to_pylist())[:, None]
        stored_images = np.array(table["image"].to_pylist())
    np.testing.assert_array_equal(stored_terrain, terrain)
    np.testing.assert_array_equal(stored_images, images)
