"""The export of training problems: what is written is what a dataset serves."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.builds import Built
from helpers.examples import slow
from helpers.grids import random_grids
from helpers.reference import add, reference_distances
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from torch.utils.data import Subset

from mapdata import (
    MapDataset,
    MapGenerator,
    MapSpec,
    Maze,
    Movement,
    OnlineMapDataset,
    ProblemSet,
    Random,
    Route,
    build,
)
from mapdata.arrays import Array, Bytes
from mapdata.export import PROBLEM_FORMATS, export_problems, verify_export
from mapdata.export.growing_array import GrowingArray
from mapdata.export.layouts import LAYOUTS, Columns
from mapdata.export.parquet import ParquetWriter
from mapdata.export.problem_formats import FORMATS
from mapdata.export.sources import Part
from mapdata.export.writers import ArrayWriter
from mapdata.formats import Collection, ForeignMap, import_maps, is_shortest_answer
from mapdata.problems.sources import plain_text
from mapdata.shards import DatasetNotFoundError

MAZE = Maze((15, 15))
SPLIT_COUNTS = {"train": 12, "val": 12, "test": 12}


@pytest.fixture(scope="module")
def root(built: Built) -> str:
    """Return a small dataset of mazes."""
    return str(built(MAZE, maps=60))


def about(folder: Path) -> dict[str, Any]:
    """Return what ``export.json`` says."""
    values: dict[str, Any] = json.loads((folder / "export.json").read_text())
    return values


def path_of(folder: Path, i: int) -> Array:
    """Return path i of a folder of arrays."""
    offsets = np.load(folder / "path_offsets.npy")
    cells: Array = np.load(folder / "path_cells.npy", mmap_mode="r")
    return cells[offsets[i] : offsets[i + 1]]


def test_arrays_of_a_dataset_are_its_samples(root: str, tmp_path: Path) -> None:
    """Every split, every problem, every field."""
    fields = ("map", "start", "goal", "path", "cost", "optimal_moves")
    export_problems(root, tmp_path / "out", fields=fields)
    for split in SPLIT_COUNTS:
        dataset = MapDataset(root, split, fields)
        folder = tmp_path / "out" / split
        stored = {name: np.load(folder / f"{name}.npy") for name in fields if name != "path"}
        for i, sample in enumerate(dataset):
            for name, rows in stored.items():
                np.testing.assert_array_equal(rows[i], getattr(sample, name).numpy())
            np.testing.assert_array_equal(path_of(folder, i), sample.path.numpy())
        assert {len(rows) for rows in stored.values()} == {len(dataset)}
        assert all(
            rows.dtype == getattr(sample, name).numpy().dtype for name, rows in stored.items()
        )


def test_a_recipe_needs_no_stored_dataset(tmp_path: Path) -> None:
    """The problems are those of `OnlineMapDataset`."""
    export_problems(
        MAZE, tmp_path / "out", count=12, split="val", problems=Random(distance=(5, None)), seed=3
    )
    dataset = OnlineMapDataset(MAZE, 3, 12, "val", problems=Random(distance=(5, None)))
    np.testing.assert_array_equal(
        np.load(tmp_path / "out/val/map.npy"), np.stack([sample.map for sample in dataset])
    )
    np.testing.assert_array_equal(path_of(tmp_path / "out/val", 7), dataset[7].path)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["export.json", "val"]


def test_a_recipe_without_a_count_has_a_problem_on_each_of_its_maps(tmp_path: Path) -> None:
    """The splits hold as many maps as a built dataset would."""
    recipe = {"spec": MAZE.to_dict(), "maps": 50}
    export_problems(recipe, tmp_path / "out", problems="random", fields=("map",))
    counts = about(tmp_path / "out")["problems"]
    build(tmp_path / "built", MAZE, maps=50, workers=1)
    for split, count in counts.items():
        assert count == len(MapDataset(tmp_path / "built", split, problems="random"))
    assert sum(counts.values()) == 50


def test_several_problems_on_each_map_are_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Their number is in ``export.json`` unless it is 1; the bar shows the maps that were tried."""
    recipe = {"spec": MAZE.to_dict(), "maps": 50}
    written = {}
    for per_map in (1, 3):
        out = tmp_path / str(per_map)
        problems = {"random": {"per_map": per_map}}
        notes = export_problems(
            recipe, out, split="val", problems=problems, fields=("map_index",), progress=True
        )
        assert not any("different maps" in note for note in notes)  # none is used too often
        assert " maps tried" in capsys.readouterr().err
        text = "random" if per_map == 1 else '{"random": {"per_map": 3}}'
        assert about(out)["options"]["problems"] == text
        written[per_map] = np.load(out / "val/map_index.npy")
    np.testing.assert_array_equal(written[3], np.repeat(written[1], 3))


def test_a_condition_that_no_map_meets_ends_an_export(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is left of it."""
    monkeypatch.setattr("mapdata.problems.substitutes.MAX_CELLS", 0)
    with pytest.raises(ValueError, match="20 maps were tried for problem 0 of epoch 0"):
        export_problems(MAZE, tmp_path / "out", count=40, problems=Random(length=(225, None)))
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_missing_is_no_recipe(tmp_path: Path) -> None:
    """Files of problems are a source, too, so that its name is all that the error knows."""
    with pytest.raises(ValueError, match=r"^problems\.npz: no such file or folder$"):
        export_problems("problems.npz", tmp_path / "out")


def test_a_dataset_that_is_open_is_no_source(tmp_path: Path) -> None:
    """The export opens one of its own, with the fields of the format."""
    dataset = OnlineMapDataset("maze15", length=5, split="train")
    with pytest.raises(TypeError, match="source: got an object of type OnlineMapDataset, expected"):
        export_problems(dataset, tmp_path / "out")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="source: got an object of type Subset, expected"):
        export_problems(Subset(dataset, [1, 2]), tmp_path / "out")  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["hrm", slow("maze-hard")])
def test_notes_count_the_mazes_that_are_their_own_solution(name: str, tmp_path: Path) -> None:
    """Start and goal are neighbours; a band of lengths leaves these problems out."""
    notes = export_problems("maze15", tmp_path / "all", format=name, count=200)
    found = [note for note in notes if "the solved maze equals the question" in note]
    ends = ("start", "goal")
    dataset = OnlineMapDataset("maze15", length=200, split="train", fields=ends, problems="random")
    start, goal = dataset[:]
    neighbours = int(((start - goal).abs().sum(dim=1) == 1).sum())
    assert neighbours > 0
    assert found[0].startswith(f"train: in {neighbours} of 200 problems S and G are neighbours")
    longer = {"random": {"length": [3, None]}}
    notes = export_problems("maze15", tmp_path / "long", format=name, count=200, problems=longer)
    assert not [note for note in notes if "neighbours" in note]
    problem_set = ProblemSet.sample("maze15", maps=300, problems="random")
    notes = export_problems(problem_set, tmp_path / "set", format=name)
    found = [note for note in notes if "neighbours" in note]
    assert found[0].endswith("so the solved maze equals the question")  # nothing is drawn


def test_a_note_names_a_folder_that_a_preset_hides(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A dataset in the working folder that is named as a preset is not what is exported."""
    build(tmp_path / "maze15", MAZE, maps=20, seed=3, workers=1)
    monkeypatch.chdir(tmp_path)
    hidden = export_problems("maze15", "preset", count=2, split="train")
    stored = export_problems("./maze15", "stored", count=2, split="train")
    assert [note for note in hidden if note.startswith("source: ")] == [
        "source: maze15 is the preset; ./maze15 is the dataset in the folder of this name, which "
        "was not read"
    ]
    assert not any(note.startswith("source: ") for note in stored)


def test_more_random_problems_than_maps_are_those_of_later_epochs(
    root: str, tmp_path: Path
) -> None:
    """Problem ``i + epoch * len(dataset)``, as loaders draw it."""
    dataset = MapDataset(root, "val", ("map", "start"), problems="random")
    count = 2 * len(dataset) + 1
    notes = export_problems(
        root,
        tmp_path / "out",
        split="val",
        count=count,
        problems="random",
        fields=dataset[0]._fields,
    )
    starts = np.load(tmp_path / "out/val/start.npy")
    for i in range(count):
        np.testing.assert_array_equal(starts[i], dataset.__getitems__([i])[0].start)
    assert not np.array_equal(starts[: len(dataset)], starts[len(dataset) : 2 * len(dataset)])
    assert "maps are used again" in notes[-1]


def test_notes_count_the_problems_whose_maps_are_also_in_train(tmp_path: Path) -> None:
    """Perfect mazes of 7 x 7 cells have only 14 different maps, and those of 15 x 15 cells many."""
    notes = export_problems(Maze((7, 7)), tmp_path / "small", count=10, fields=("map",))
    maps = {
        split: [grid.tobytes() for grid in np.load(tmp_path / "small" / split / "map.npy")]
        for split in SPLIT_COUNTS
    }
    for split in ("val", "test"):
        copies = sum(grid in maps["train"] for grid in maps[split])
        assert copies > 0
        assert (
            f"{split}: {copies} of 10 problems are on maps that are also in train, so a model saw "
            "these maps in training; --distinct leaves them out"
        ) in notes
    for format_name in ("arrays", "maze-hard"):
        notes = export_problems(MAZE, tmp_path / format_name, format=format_name, count=10)
        assert not [note for note in notes if "also in train" in note]


@pytest.mark.slow
def test_an_export_says_what_its_problems_are_worth(tmp_path: Path) -> None:
    """Of the problems that it wrote; a path is one of several answers where mazes are no trees."""
    rooms = MapSpec((20, 20), (2, 5), (4, 9), (4, 9))
    notes = export_problems(rooms, tmp_path / "rooms", count=30, problems="random")
    statistics = OnlineMapDataset(rooms, 0, 30, "train", problems="random").problem_statistics()
    values = about(tmp_path / "rooms")
    assert values["problem_statistics"]["train"] == json.loads(json.dumps(statistics.to_dict()))
    assert values["maps"] == dict.fromkeys(SPLIT_COUNTS, 30)
    assert f"train: {statistics.target_text()}" in notes
    assert "optimal_mask and optimal_moves" in statistics.target_text()
    notes = export_problems(rooms, tmp_path / "costs", count=5, fields=("map", "cost_to_go"))
    assert not [note for note in notes if "one shortest path" in note]
    notes = export_problems(MAZE, tmp_path / "mazes", format="maze-hard", count=5)
    assert not [note for note in notes if "one shortest path" in note]
    assert about(tmp_path / "mazes")["problem_statistics"]["val"]["single_path"][0] == 1


def test_a_note_says_that_random_problems_are_on_few_maps(root: str, tmp_path: Path) -> None:
    """Counted by ``map_index``, which is only written if it is asked for."""
    far = Random(length=(75, None))
    dataset = MapDataset(root, "train", ("map_index",), problems=far)
    _, counts = np.unique(dataset[:].map_index, return_counts=True)
    assert len(counts) < 0.9 * len(dataset)
    for fields in (("start",), ("start", "map_index")):
        folder = tmp_path / "-".join(fields)
        notes = export_problems(root, folder, split="train", problems=far, fields=fields)
        (note,) = (note for note in notes if "different maps" in note)
        assert note.startswith(
            f"train: these {len(dataset)} problems are on {len(counts)} different maps of "
            f"{len(dataset)}, up to {counts.max()} on one map"
        )
        assert about(folder)["maps"] == {"train": len(counts)}
        assert sorted(file.stem for file in (folder / "train").iterdir()) == sorted(fields)
    # As many problems as wanted on all maps, and a few of them, are not few maps.
    for count in (5, 200):
        notes = export_problems(root, tmp_path / str(count), count=count, problems="random")
        assert not [note for note in notes if "different maps" in note]


@pytest.mark.parametrize("name", ["hrm", "maze-hard"])
def test_mazes_as_text_are_square(name: str, tmp_path: Path) -> None:
    """Their rows follow one another without a mark, so that a length alone gives the sides."""
    with pytest.raises(
        ValueError, match=f"{name}: got maps of 7 x 9 cells .* expected square maps"
    ):
        export_problems(Maze((7, 9)), tmp_path / "out", format=name, count=2)


def test_copies_in_val_and_test_alone_need_no_note(tmp_path: Path) -> None:
    """A model saw only the maps of train in training."""
    first, second = random_grids(2, 12, 12)
    maps = [ForeignMap("a", first, 0), ForeignMap("b", second, 1), ForeignMap("c", second, 2)]
    import_maps(tmp_path / "maps", Collection(maps), seed_points=3)
    notes = export_problems(tmp_path / "maps", tmp_path / "out", fields=("map",))
    assert not [note for note in notes if "also in" in note]


def test_maps_of_terrain_are_copies_only_if_their_costs_are_equal(tmp_path: Path) -> None:
    """No cell of the preset tiles is occupied, so all its maps have the same occupied cells."""
    fields = ("map", "terrain")
    for name in (fields, fields[:1]):
        notes = export_problems("tiles", tmp_path / "-".join(name), count=10, fields=name)
        assert not [note for note in notes if "also in train" in note]


def test_a_note_says_which_problems_were_written(tmp_path: Path) -> None:
    """The formats have different defaults, with equal counts otherwise."""
    cases: tuple[tuple[dict[str, Any], str], ...] = (
        ({}, "problems: route, the default of arrays"),
        ({"format": "maze-hard"}, "problems: random, the default of maze-hard"),
        ({"problems": "pairs"}, "problems: pairs"),
        ({"problems": Random(length=(2, None))}, 'problems: {"random": {"length": [2.0, null]}}'),
    )
    for number, (arguments, note) in enumerate(cases):
        target = tmp_path / str(number)
        assert export_problems(MAZE, target, split="val", count=2, **arguments)[0] == note


def test_max_length_pads_paths_and_bounds_random_ones(root: str, tmp_path: Path) -> None:
    """Of mazes of 15 x 15 cells, most paths are longer than 20 cells."""
    export_problems(root, tmp_path / "out", problems="random", split="train", max_length=20)
    paths = np.load(tmp_path / "out/train/path.npy")
    assert paths.shape[1:] == (20, 2)
    lengths = (paths[:, :, 0] >= 0).sum(axis=1)
    assert lengths.min() >= 1
    with pytest.raises(ValueError, match="does not fit into 20"):
        export_problems(root, tmp_path / "routes", split="train", max_length=20)
    assert not (tmp_path / "routes").exists()


@pytest.mark.parametrize(("band", "written"), [((8, 60), [8, 20]), ((8, 15), [8, 15])])
def test_max_length_beside_a_band_keeps_the_smaller_bound(
    band: tuple[int, int], written: list[int], root: str, tmp_path: Path
) -> None:
    """Random problems are drawn no longer than either says, and no shorter than the band."""
    problems = Random(length=band)
    export_problems(root, tmp_path / "out", problems=problems, split="train", max_length=20)
    lengths = (np.load(tmp_path / "out/train/path.npy")[:, :, 0] >= 0).sum(axis=1)
    assert lengths.min() >= 8
    assert lengths.max() <= written[1]
    shortest, longest = written
    stated = about(tmp_path / "out")["options"]["problems"]
    assert stated == plain_text(Random(length=(shortest, longest)))


def test_only_the_training_split_is_augmented(tmp_path: Path) -> None:
    """As in `MapDataModule`."""
    export_problems(MAZE, tmp_path / "plain", count=40, fields=("map",))
    export_problems(MAZE, tmp_path / "augmented", count=40, fields=("map",), augment=True)
    is_equal = {
        split: np.array_equal(
            np.load(tmp_path / f"plain/{split}/map.npy"),
            np.load(tmp_path / f"augmented/{split}/map.npy"),
        )
        for split in SPLIT_COUNTS
    }
    assert is_equal == {"train": False, "val": True, "test": True}


def test_the_folder_says_what_it_holds(root: str, tmp_path: Path) -> None:
    """Dtype, shape and checksum of each file; recipe, options and content hash."""
    export_problems(root, tmp_path / "out", movement=Movement(8), radius=0.0)
    values = about(tmp_path / "out")
    for name, entry in values["files"].items():
        array = np.load(tmp_path / "out" / name)
        assert [*array.shape] == entry["shape"]
        assert array.dtype == entry["dtype"]
        assert hashlib.sha256(array.tobytes()).hexdigest() == entry["sha256"]
    assert values["options"]["movement"]["connectivity"] == 8
    recipe = values["origin"]["datasets"][0]["recipe"]
    assert MapGenerator.from_dict(recipe["spec"]) == MAZE
    export_problems(root, tmp_path / "again", movement=Movement(8))
    assert about(tmp_path / "again")["content_hash"] == values["content_hash"]
    export_problems(root, tmp_path / "other", movement=Movement(8, corner_cutting=True))
    assert about(tmp_path / "other")["content_hash"] != values["content_hash"]


# --- layouts --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def exports(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with one export for each layout of maps without terrain, and for
    maze-hard.
    """
    folder = tmp_path_factory.mktemp("layouts")
    layouts = [name for name, layout in LAYOUTS.items() if not layout.has_terrain]
    for name in (*layouts, "maze-hard"):
        export_problems(MAZE, folder / name, format=name, count=12)
    return folder


def costs_to(goal: Array, grid: Array, moves: Array) -> Array:
    """Return the cost from every cell to ``goal`` by scipy; diagonals cost sqrt 2, corners may be
    cut.
    """
    numbers = np.arange(grid.size).reshape(grid.shape)
    edges: list[tuple[int, int, float]] = []
    for row, column in np.argwhere(grid == 0):
        for move in moves:
            to = np.array([row, column]) + move
            if (to >= 0).all() and (to < grid.shape).all() and grid[tuple(to)] == 0:
                edges.append((numbers[row, column], numbers[tuple(to)], float(np.hypot(*move))))
    begins, ends, lengths = zip(*edges, strict=True)
    graph = csr_matrix((lengths, (ends, begins)), (grid.size, grid.size))
    costs: Array = dijkstra(graph, indices=numbers[tuple(goal)]).reshape(grid.shape)
    return costs


EIGHT_MOVES = np.array([(-1, 0), (0, 1), (1, 0), (0, -1), (-1, 1), (1, 1), (1, -1), (-1, -1)])


def test_transpath_folders_read_as_its_loader_reads_them(exports: Path) -> None:
    """Its GridData opens maps, starts, goals and one of focal, cf and abs, entry by entry."""
    for split in ("train", "val", "test"):
        folder = exports / "transpath" / split
        names = ("maps", "starts", "goals", "focal", "cf", "abs")
        arrays = {name: np.load(folder / f"{name}.npy", mmap_mode="c") for name in names}
        assert {array.shape for array in arrays.values()} == {(12, 1, 15, 15)}
        # The loader compares focal values with zeros of their own type, in 32 bits.
        assert arrays["focal"].dtype == np.float32
        for k in range(3):
            goal = np.argwhere(arrays["goals"][k, 0])[0]
            truth = costs_to(goal, arrays["maps"][k, 0], EIGHT_MOVES)
            truth[np.isinf(truth)] = -1
            np.testing.assert_allclose(arrays["abs"][k, 0], truth, rtol=1e-6)
            start = np.argwhere(arrays["starts"][k, 0])[0]
            assert arrays["focal"][k, 0, start[0], start[1]] == pytest.approx(1)


def test_transpath_folders_are_the_same_for_both_searches(tmp_path: Path) -> None:
    """On diagonals BFS finds paths that cost more than the best, and no label is of them."""
    files = []
    for search in ("astar", "bfs"):
        out = tmp_path / search
        export_problems("cave", out, format="transpath", count=4, search=search)
        files.append({path.name: path.read_bytes() for path in (out / "train").glob("*.npy")})
    assert len(files[0]) == 6
    assert files[0] == files[1]


def test_gppn_archives_read_as_its_loader_reads_them(exports: Path) -> None:
    """Its MazeDataset takes arr_0, arr_3 and arr_6, and the two arrays behind each."""
    moves = np.array([(-1, 0), (0, 1), (0, -1), (1, 0)])  # N, E, W, S
    with np.load(exports / "gppn/gppn.npz") as archive:
        assert archive.files == [f"arr_{k}" for k in range(9)]
        for first in (0, 3, 6):
            mazes, goals, policies = (archive[f"arr_{first + k}"] for k in range(3))
            assert (mazes.shape, goals.shape) == ((12, 15, 15), (12, 1, 15, 15))
            assert policies.shape == (12, 4, 1, 15, 15)
            goal = np.argwhere(goals[0, 0])[0]
            costs = costs_to(goal, 1 - mazes[0], moves)
            for row, column in np.argwhere(np.isfinite(costs) & (costs > 0)):
                for action, move in enumerate(moves):
                    to = costs[tuple(np.array([row, column]) + move)]
                    is_optimal = to == costs[row, column] - 1
                    assert policies[0, action, 0, row, column] == is_optimal


def test_gppn_has_eight_actions_for_eight_moves(tmp_path: Path) -> None:
    """The mechanism "moore" orders them N, E, W, S, NE, NW, SE, SW."""
    movement = Movement(8, corner_cutting=True, diagonal_cost=1)
    export_problems(MAZE, tmp_path / "out", format="gppn", count=4, movement=movement)
    with np.load(tmp_path / "out/gppn.npz") as archive:
        policies, goals = archive["arr_2"], archive["arr_1"]
    assert policies.shape == (4, 8, 1, 15, 15)
    row, column = np.argwhere(goals[0, 0])[0]
    moves = [(-1, 0), (0, 1), (0, -1), (1, 0), (-1, 1), (-1, -1), (1, 1), (1, -1)]
    mazes = np.load(tmp_path / "out/gppn.npz")["arr_0"]
    for action, (rows, columns) in enumerate(moves):
        neighbour = (row - rows, column - columns)
        if all(0 <= k < 15 for k in neighbour) and mazes[(0, *neighbour)]:
            assert policies[(0, action, 0, *neighbour)] == 1, "the goal is one move away"


def test_vin_archives_read_as_its_loader_reads_them(exports: Path) -> None:
    """Its GridworldData takes four arrays for training and four for the test, a row a move."""
    moves = [(-1, 0), (1, 0), (0, 1), (0, -1), (-1, 1), (-1, -1), (1, 1), (1, -1)]
    with np.load(exports / "vin/vin.npz") as archive:
        assert archive.files == [f"arr_{k}" for k in range(8)]
        for first in (0, 4):
            images, rows, columns, labels = (archive[f"arr_{first + k}"] for k in range(4))
            assert images.shape[1:] == (2, 15, 15)
            assert len(images) == len(rows) == len(columns) == len(labels)
            assert [int(rows[0]), int(columns[0]), int(labels[0])]  # the loader calls int()
            ends_of_paths = 0
            for k in range(len(images)):
                goal = np.argwhere(images[k, 1] == 10)[0]
                to = np.array([rows[k], columns[k]]) + moves[labels[k]]
                assert images[(k, 0, *to)] == 0
                if np.array_equal(to, goal):
                    ends_of_paths += 1
                else:
                    assert [rows[k + 1], columns[k + 1]] == [*to], "the next row goes on from there"
            assert ends_of_paths == 12


def test_hrm_folders_read_as_its_loader_reads_them(exports: Path) -> None:
    """Its PuzzleDataset wants dataset.json and five arrays a split; labels are right answers."""
    characters = np.frombuffer(b"\0# SGo", np.uint8)
    for split in ("train", "test"):
        folder = exports / "hrm" / split
        metadata = json.loads((folder / "dataset.json").read_text())
        assert (metadata["seq_len"], metadata["vocab_size"]) == (225, 6)
        assert metadata["total_groups"] == metadata["total_puzzles"] == 12
        inputs, labels = (np.load(folder / f"all__{name}.npy") for name in ("inputs", "labels"))
        assert inputs.shape == labels.shape == (12, 225)
        for question, answer in zip(characters[inputs], characters[labels], strict=True):
            texts = (row.tobytes().decode() for row in (question, answer))
            assert is_shortest_answer(*texts)
        for name in ("puzzle_indices", "group_indices"):
            np.testing.assert_array_equal(np.load(folder / f"all__{name}.npy"), np.arange(13))
        assert not np.load(folder / "all__puzzle_identifiers.npy").any()


def test_mazes_as_text_are_those_of_hrm(exports: Path) -> None:
    """A line for each problem, with the same mazes and answers."""
    characters = np.frombuffer(b"\0# SGo", np.uint8)
    header, *lines = (exports / "maze-hard/train.csv").read_text().splitlines()
    assert header == "source,question,answer,rating"
    inputs = np.load(exports / "hrm/train/all__inputs.npy")
    for k, line in enumerate(lines):
        source, question, answer, rating = line.split(",")
        assert source == f"problem{k}"
        assert question == characters[inputs[k]].tobytes().decode()
        assert is_shortest_answer(question, answer)
        assert int(rating) == answer.count("o") + 1
    assert len(lines) == 12


def test_a_band_of_lengths_makes_hard_mazes(tmp_path: Path) -> None:
    """One problem a maze, each with at least 30 moves."""
    export_problems(
        MAZE,
        tmp_path / "out",
        format="maze-hard",
        problems=Random(length=(31, None)),
        count=20,
        split="train",
    )
    lines = (tmp_path / "out/train.csv").read_text().splitlines()[1:]
    assert min(int(line.rpartition(",")[2]) for line in lines) >= 30
    assert len({line.split(",")[1].replace("S", " ").replace("G", " ") for line in lines}) == 20


@pytest.mark.parametrize("format", ["maze-hard", "hrm"])
@pytest.mark.parametrize("augment", [False, True])
def test_labels_of_mazes_follow_the_rule_of_the_set(
    tmp_path: Path,
    format: str,  # noqa: A002
    augment: bool,
) -> None:
    """Also under symmetries, which would turn a path of this rule into one of another."""
    loops = Maze((9, 9), reopened=0.6)
    problems = Random(length=(5, None))
    out = tmp_path / "out"
    export_problems(
        loops, out, format=format, problems=problems, count=40, split="train", augment=augment
    )
    if format == "hrm":
        tokens = [np.load(out / f"train/all__{name}.npy") for name in ("inputs", "labels")]
        texts = np.frombuffer(b"\0# SGo", np.uint8)[tokens].reshape(2, 40, 9, 9)
    else:
        lines = (out / "train.csv").read_text().splitlines()[1:]
        columns = ["".join(line.split(",")[1:3]) for line in lines]
        codes = np.frombuffer("".join(columns).encode(), np.uint8)
        texts = codes.reshape(40, 2, 9, 9).swapaxes(0, 1)
    has_several = 0
    for question, answer in zip(*texts, strict=True):
        grid = (question == ord("#")).astype(int).tolist()
        ((row, column),) = np.argwhere(question == ord("S")).tolist()
        ((goal_row, goal_column),) = np.argwhere(question == ord("G")).tolist()
        goal = (goal_row, goal_column)
        # The reference follows, from the start, the first optimal move of down, left, right, up.
        costs = reference_distances(grid, goal, Movement(4))
        cell = (row, column)
        marked = set()
        while cell != goal:
            row, column = cell
            steps = [(row + 1, column), (row, column - 1), (row, column + 1), (row - 1, column)]
            optimal = [step for step in steps if costs.get(step) == add(costs[cell], (-1, 0))]
            has_several += len(optimal) > 1
            cell = optimal[0]
            marked.add(cell)
        assert {tuple(place) for place in np.argwhere(answer == ord("o")).tolist()} == marked - {
            goal
        }
    assert has_several > 10


@pytest.mark.parametrize("format", ["maze-hard", "hrm"])
def test_labels_of_mazes_are_of_no_search(tmp_path: Path, format: str) -> None:  # noqa: A002
    """A search that would change nothing is refused."""
    with pytest.raises(ValueError, match=rf"search: got 'bfs', but {format} has the labels"):
        export_problems(MAZE, tmp_path / "out", format=format, search="bfs")
    assert not (tmp_path / "out").exists()


# --- Parquet --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_parquet_rows_are_problems(root: str, tmp_path: Path) -> None:
    """As Hugging Face ``datasets`` opens them, with the Hub's names of the splits."""
    datasets = pytest.importorskip("datasets")
    fields = ("map", "start", "goal", "path", "cost", "optimal_moves")
    export_problems(root, tmp_path / "out", format="parquet", fields=fields, licence="cc-by-4.0")
    loaded = datasets.load_dataset(str(tmp_path / "out"), cache_dir=str(tmp_path / "cache"))
    assert set(loaded) == {"train", "validation", "test"}
    assert loaded["train"].features["map"] == datasets.Array2D((15, 15), "uint8")
    dataset = MapDataset(root, "validation"[:3], fields)
    rows = loaded["validation"].with_format("numpy")
    assert len(rows) == len(dataset)
    for row, sample in zip(rows, dataset, strict=True):
        np.testing.assert_array_equal(row["map"], sample.map[0])
        np.testing.assert_array_equal(row["optimal_moves"], sample.optimal_moves[0])
        np.testing.assert_array_equal(row["path"], sample.path)
        np.testing.assert_array_equal(row["start"], sample.start)
        assert row["cost"] == sample.cost.item()
    card = (tmp_path / "out/README.md").read_text()
    assert "# Give the path of this folder, or OWNER/out once it is on the Hub." in card
    assert '\nlicense: "cc-by-4.0"\n---\n' in card
    counts = about(tmp_path / "out")["maps"]
    assert f"| validation | {len(dataset)} | {counts['val']} |" in card
    assert "| cells on any shortest path / path | 1.00 (1.00 to 1.00) |" in card
    assert "All measured problems have one shortest path: " in card


def test_large_sets_are_several_files(
    root: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Named and numbered as the Hub expects."""
    monkeypatch.setattr("mapdata.export.parquet._MAX_FILE_CELLS", 15 * 15 * 10)
    parquet = pytest.importorskip("pyarrow.parquet")
    export_problems(MAZE, tmp_path / "out", format="parquet", split="train", count=25)
    names = sorted(path.name for path in (tmp_path / "out/data").iterdir())
    assert names == [f"train-0000{k}-of-00003.parquet" for k in range(3)]
    rows = [parquet.read_table(tmp_path / "out/data" / name).num_rows for name in names]
    assert rows == [10, 10, 5]


# --- failures -------------------------------------------------------------------------------------


@pytest.mark.parametrize("format_name", PROBLEM_FORMATS)
def test_an_interrupted_export_leaves_nothing(
    format_name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither the target nor a temporary folder."""
    batches = Part.batches

    def interrupted(part: Part, max_batch: int) -> Iterator[Columns]:
        yield next(batches(part, max_batch))
        raise KeyboardInterrupt

    monkeypatch.setattr(Part, "batches", interrupted)
    source = "tiles" if format_name == "warcraft" else MAZE
    with pytest.raises(KeyboardInterrupt):
        export_problems(source, tmp_path / "out", format=format_name, count=12)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"format": "parket"}, "format: got 'parket'.*did you mean parquet"),
        ({"format": "gppn", "fields": ("map",)}, "gppn has its own fields"),
        ({"fields": ("mapp",)}, "fields: got 'mapp'"),
        ({"fields": (len,)}, "expected names of fields: map, free"),
        ({"fields": ("prompt",)}, "fields: got 'prompt', expected names of fields: map, free"),
        ({"format": "parquet", "fields": ("gaol",)}, "expected names.*did you mean goal"),
        ({"format": "parquet", "max_length": 9}, "only arrays have rows to pad"),
        ({"licence": "mit"}, "arrays has no card"),
        ({"format": "vin", "split": "val"}, "vin has no place for 'val'"),
        ({"format": "gppn", "split": "val"}, "one file of all splits"),
        ({"split": "dev"}, "split: got 'dev'"),
        ({"count": 0}, "count: got 0"),
        ({"count": 10**6}, "count: got 1000000, but the split 'train' has"),
        ({"count": 10**9}, "expected at most 100000000 problems"),
        ({"seed": 1}, "seed: a built dataset has its own"),
        ({"max_length": 9, "fields": ("map",)}, "expected 'path' among the fields"),
        ({"max_length": 226}, "max_length: got 226, but a map has only 225 cells"),
        ({"format": "hrm", "problems": Route(unsolvable=True)}, "hrm needs a path of each problem"),
        ({"format": "parquet", "licence": "not a word"}, "expected a word of the Hub"),
        ({"augment": "no"}, "augment: got 'no'"),
        ({"format": "hrm", "movement": Movement(8)}, "expected square maps and 4-connected"),
    ],
)
def test_what_would_do_nothing_is_refused(
    root: str, tmp_path: Path, arguments: dict[str, Any], message: str
) -> None:
    """By name, before anything is written."""
    with pytest.raises(ValueError, match=message):
        export_problems(root, tmp_path / "out", **arguments)
    assert os.listdir(tmp_path) == []


def test_a_folder_that_holds_something_is_refused(root: str, tmp_path: Path) -> None:
    """An export never adds to what is there."""
    (tmp_path / "mine").write_text("kept")
    with pytest.raises(ValueError, match="exists already"):
        export_problems(root, tmp_path)
    assert (tmp_path / "mine").read_text() == "kept"


def test_a_link_is_refused_and_a_folder_that_appears_meanwhile_stays(
    root: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second of two exports to one target ends in one line and leaves the first one's files."""
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    with pytest.raises(ValueError, match="is a link"):
        export_problems(root, tmp_path / "link")
    batches = Part.batches

    def overtaken(part: Part, max_batch: int) -> Iterator[Columns]:
        (tmp_path / "out").mkdir(exist_ok=True)
        (tmp_path / "out/theirs").write_text("kept")
        yield from batches(part, max_batch)

    monkeypatch.setattr(Part, "batches", overtaken)
    with pytest.raises(ValueError, match="exists already"):
        export_problems(root, tmp_path / "out")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["theirs"]


def test_an_export_is_no_dataset(tmp_path: Path) -> None:
    """Such a folder has no manifest, but to build a dataset there would not help."""
    export_problems(MAZE, tmp_path / "out", split="val", count=2)
    message = "an export of training problems. datasets.load_dataset opens parquet"
    with pytest.raises(DatasetNotFoundError, match=message) as error:
        MapDataset(tmp_path / "out")
    assert "Make one" not in str(error.value)


def test_numbers_of_numpy_are_taken(root: str, tmp_path: Path) -> None:
    """They are plain numbers in ``export.json``."""
    export_problems(
        root,
        tmp_path / "out",
        problems="random",
        count=np.int64(2),  # type: ignore[arg-type]
        sampling_seed=np.int64(3),  # type: ignore[arg-type]
        radius=np.float32(0),  # type: ignore[arg-type]
    )
    values = about(tmp_path / "out")
    assert values["problems"] == dict.fromkeys(SPLIT_COUNTS, 2)
    assert values["options"]["sampling_seed"] == 3


def test_a_layout_with_many_rows_a_problem_takes_few_problems_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """VIN has a picture for each move of a path: memory would grow with the lengths of paths."""
    sizes = []
    batches = Part.batches

    def counted(part: Part, max_batch: int) -> Iterator[Columns]:
        for columns in batches(part, max_batch):
            sizes.append(len(columns["map"]))
            yield columns

    monkeypatch.setattr(Part, "batches", counted)
    export_problems(MAZE, tmp_path / "out", format="vin", count=70)
    assert sizes == [32, 32, 6] * 2


def test_a_growing_array_is_an_ordinary_npy_file(tmp_path: Path) -> None:
    """Whatever the number of blocks; memory maps work."""
    rng = np.random.default_rng(0)
    rows = rng.integers(0, 255, (1000, 3, 2), np.uint8)
    array = GrowingArray(tmp_path / "rows.npy", rows.dtype, (3, 2))
    for k in range(0, 1000, 7):
        array.append(rows[k : k + 7])
    array.close()
    np.testing.assert_array_equal(np.load(tmp_path / "rows.npy", mmap_mode="r"), rows)
    array = GrowingArray(tmp_path / "empty.npy", rows.dtype, (3, 2))
    with pytest.raises(ValueError, match="expected \\(3, 2\\)"):
        array.append(rows[:, :2])
    array.close()
    assert np.load(tmp_path / "empty.npy").shape == (0, 3, 2)


def test_writers_close_their_files(tmp_path: Path) -> None:
    """So that a failed export leaves no handle open."""
    writer = ArrayWriter(tmp_path, None)
    writer.write("train", {"map": np.zeros((2, 1, 4, 4), np.uint8)})
    writer.abort()
    assert np.load(tmp_path / "train/map.npy").shape == (0, 1, 4, 4)
    pytest.importorskip("pyarrow")
    parquet = ParquetWriter(tmp_path, {"train": 2}, (4, 4))
    parquet.write("train", {"map": np.zeros((2, 1, 4, 4), np.uint8)})
    parquet.abort()


def test_notes_count_the_copies_within_a_split(tmp_path: Path) -> None:
    """Of maps, not of problems: several problems of one map are no copies."""
    notes = export_problems(Maze((9, 9)), tmp_path / "few", count=60, fields=("map",))
    grids = [grid.tobytes() for grid in np.load(tmp_path / "few" / "train" / "map.npy")]
    maps = about(tmp_path / "few")["maps"]["train"]
    different = len(set(grids))
    assert different < maps
    assert (
        f"train: of its {maps} maps {different} differ, and the others are copies of them; "
        "--distinct leaves out the problems on copies"
    ) in notes
    notes = export_problems(MAZE, tmp_path / "many", problems="pairs", count=60, split="train")
    assert not [note for note in notes if "copies" in note]


def symmetric_key(grid: Bytes) -> bytes:
    """Return a key that all turned and reflected images of a grid share."""
    images = [np.rot90(image, turns) for image in (grid, grid.T) for turns in range(4)]
    keys: list[bytes] = [image.tobytes() for image in images]
    return min(keys)


@pytest.mark.parametrize("augment", [False, True])
def test_distinct_maps_differ_across_all_splits(tmp_path: Path, augment: bool) -> None:
    """Also turned and reflected; the count is that asked for, on further maps."""
    options: dict[str, Any] = {"fields": ("map", "start", "path"), "count": 30, "augment": augment}
    plain, distinct = tmp_path / "plain", tmp_path / "distinct"
    export_problems(Maze((9, 9)), plain, problems="random", **options)
    notes = export_problems(Maze((9, 9)), distinct, problems="random", distinct=True, **options)
    keys = {}
    for folder in (plain, distinct):
        grids = [np.load(folder / split / "map.npy")[:, 0] for split in SPLIT_COUNTS]
        assert [len(of_split) for of_split in grids] == [30, 30, 30]
        keys[folder] = [symmetric_key(grid) for of_split in grids for grid in of_split]
    assert len(set(keys[plain])) < 90
    assert len(set(keys[distinct])) == 90
    assert not [note for note in notes if "copies" in note or "also in" in note]
    assert (about(plain)["options"]["distinct"], about(distinct)["options"]["distinct"]) == (
        False,
        True,
    )
    assert verify_export(distinct) == []


def test_distinct_keeps_the_problems_that_are_no_copies(tmp_path: Path) -> None:
    """Of a built dataset those that are left, in their order, with all problems of their maps."""
    first, second = random_grids(2, 12, 12)
    grids = {"a": first, "b": second, "c": np.rot90(first).copy(), "d": second[::-1].copy()}
    maps = [ForeignMap(name, grid, 0) for name, grid in grids.items()]
    import_maps(tmp_path / "maps", Collection(maps), seed_points=3)
    fields = ("map_index", "start", "goal")
    export_problems(tmp_path / "maps", tmp_path / "all", fields=fields, problems="pairs")
    export_problems(
        tmp_path / "maps", tmp_path / "distinct", fields=fields, problems="pairs", distinct=True
    )
    numbers = np.load(tmp_path / "all/train/map_index.npy")
    is_first = numbers < 2
    assert 2 < is_first.sum() < len(numbers)
    for name in fields:
        every = np.load(tmp_path / "all/train" / f"{name}.npy")
        np.testing.assert_array_equal(
            np.load(tmp_path / "distinct/train" / f"{name}.npy"), every[is_first]
        )


def test_later_problems_of_a_dataset_take_the_places_of_copies(tmp_path: Path) -> None:
    """With a count; the dataset has enough maps that differ, and the first ones are equal."""
    first, second, third = random_grids(3, 12, 12)
    grids = {"a": first, "b": first[::-1].copy(), "c": second, "d": third}
    maps = [ForeignMap(name, grid, 0) for name, grid in grids.items()]
    import_maps(tmp_path / "maps", Collection(maps), seed_points=2)
    fields = ("map_index",)
    options: dict[str, Any] = {"fields": fields, "problems": "random", "split": "train"}
    export_problems(tmp_path / "maps", tmp_path / "out", **options, count=3, distinct=True)
    assert np.load(tmp_path / "out/train/map_index.npy").tolist() == [0, 2, 3]
    with pytest.raises(ValueError, match="train has only 3 problems on maps that differ"):
        export_problems(tmp_path / "maps", tmp_path / "no", **options, count=4, distinct=True)


def test_too_few_distinct_maps_are_an_error(tmp_path: Path) -> None:
    """Perfect mazes of 7 x 7 cells: 14 maps, of which symmetries leave 6."""
    with pytest.raises(ValueError, match="train has only 6 problems on maps that differ"):
        export_problems(Maze((7, 7)), tmp_path / "out", count=7, problems="random", distinct=True)
    assert not (tmp_path / "out").exists()
    flag: Any = "yes"
    with pytest.raises(ValueError, match="distinct: got 'yes', expected True or False"):
        export_problems(Maze((7, 7)), tmp_path / "out", distinct=flag)


def test_each_format_has_one_record() -> None:
    """In the order of the help, under its own name; layouts among them."""
    assert tuple(FORMATS) == PROBLEM_FORMATS
    assert all(record.name == name for name, record in FORMATS.items())
    assert set(LAYOUTS) < set(FORMATS)
