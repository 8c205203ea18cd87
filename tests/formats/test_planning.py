"""planning-datasets: neural-astar's loader, written down once more, reads what we write."""

from __future__ import annotations

import math
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from helpers.examples import slow
from helpers.wild import GRIDS, SETTINGS, Bytes, cli, lengths, npy, npz
from hypothesis import given
from hypothesis import strategies as st

from mapdata import MapDataModule, MapDataset, ProblemSet, Random
from mapdata.evaluation import classical, evaluate
from mapdata.formats import FormatError, export, import_maps, read_problems
from mapdata.formats.planning import negative_distances, policy, read, start_candidates
from mapdata.formats.registry import recognise
from mapdata.movement import NEURAL_ASTAR, Movement
from mapdata.shards import read_manifest

Floats = npt.NDArray[np.float32]
MOVES = ((-1, 0), (0, 1), (0, -1), (1, 0), (-1, 1), (-1, -1), (1, 1), (1, -1))


class Loader:
    """What the dataset class of neural-astar (src/neural_astar/utils/data.py, 2023) does."""

    def __init__(self, path: Path, split: str) -> None:
        """Open one split; every array becomes float32."""
        first = {"train": 0, "valid": 4, "test": 8}[split]
        with np.load(path) as file:
            self.maps, self.goals, self.policies, self.distances = (
                file[f"arr_{first + k}"].astype(np.float32) for k in range(4)
            )

    def item(
        self, k: int, interval: int, random: np.random.Generator
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Return map, start, goal and path of map k; the start is from one of three intervals."""
        values = self.distances[k].ravel()
        inside = values[values > values.min()]
        bounds = np.percentile(inside, 100.0 * (1 - np.array([0.55, 0.70, 0.85, 1.0])))
        candidates = np.flatnonzero((values >= bounds[interval + 1]) & (values <= bounds[interval]))
        start = np.zeros_like(self.distances[k])
        start.ravel()[random.choice(candidates)] = 1
        return self.maps[k][None], start, self.goals[k], self.follow(k, start)

    def follow(self, k: int, start: Floats) -> Floats:
        """Follow the policy from the start to the goal, which is not marked; no cell twice."""
        path = np.zeros_like(start)
        at, goal = (tuple(np.argwhere(one)[0].tolist()) for one in (start, self.goals[k]))
        while at != goal:
            path[at] = 1
            action = int(np.argmax(self.policies[k][:, at[0], at[1], at[2]]))
            at = (at[0], at[1] + MOVES[action][0], at[2] + MOVES[action][1])
            assert path[at] == 0
            assert self.maps[k][at[1:]] == 1
        return path


def test_the_loader_reads_what_we_write(root: Path, tmp_path: Path) -> None:
    """On every map the loader draws starts of every interval, and its path has as many cells as the
    distance says.
    """
    export(root, tmp_path / "maps.npz", "planning-datasets")
    assert recognise(tmp_path / "maps.npz") == "planning-datasets"
    random = np.random.default_rng(0)
    total = 0
    for split in ("train", "valid", "test"):
        loader = Loader(tmp_path / "maps.npz", split)
        assert loader.maps.shape[1:] == (20, 70)
        assert loader.policies.shape == (len(loader.maps), 8, 1, 20, 70)
        assert (loader.policies.sum(axis=1) == 1).all()
        total += len(loader.maps)
        for k in range(len(loader.maps)):
            for interval in range(3):
                free, start, goal, path = loader.item(k, interval, random)
                assert free.shape == start.shape == goal.shape == path.shape == (1, 20, 70)
                assert path.sum() == -loader.distances[k][start == 1][0]
    assert total == 24


def test_problems_are_one_start_of_each_interval_on_each_test_map(
    root: Path, tmp_path: Path
) -> None:
    """The goals are those of the file."""
    path = tmp_path / "maps.npz"
    export(root, path, "planning-datasets")
    loader = Loader(path, "test")
    problems = read_problems(path, seed=1)
    assert problems.movement == NEURAL_ASTAR
    assert len(problems) == 3 * len(loader.maps) > 3
    for n in range(len(problems)):
        k, interval = divmod(n, 3)
        assert np.array_equal(problems.grids[n], 1 - loader.maps[k])
        assert loader.goals[k][0][tuple(problems.goals[n])] == 1
        values = loader.distances[k].ravel()
        inside = values[values > values.min()]
        bounds = np.percentile(inside, 100.0 * (1 - np.array([0.55, 0.70, 0.85, 1.0])))
        value = loader.distances[k][0][tuple(problems.starts[n])]
        assert bounds[interval + 1] <= value <= bounds[interval]
        assert problems.optimal.cost[n] == -value
    assert read_problems(path, seed=1).content_hash == problems.content_hash
    assert read_problems(path).content_hash != problems.content_hash
    with pytest.raises(ValueError, match="count: does nothing for format planning-datasets"):
        read_problems(path, count=1)
    for seed in (-1, 2**64):
        with pytest.raises(ValueError, match=f"seed: got {seed}"):
            read_problems(path, seed=seed)


@pytest.mark.slow
def test_starts_are_uniform_over_the_cells_of_an_interval(tmp_path: Path) -> None:
    """On a free map, 300 seeds draw every cell of the farthest interval."""
    np.savez(tmp_path / "maps.npz", **sound(1, 8, 8))  # type: ignore[arg-type]
    starts = [read_problems(tmp_path / "maps.npz", seed=seed).starts[2] for seed in range(300)]
    cells, times = np.unique(starts, axis=0, return_counts=True)
    assert len(cells) == 13  # a distance of 6: the loader takes the least value, -7, for no path
    assert times.min() > 5


@SETTINGS
@given(GRIDS, st.data())
def test_distances_and_policy_against_scipy(grid: Bytes, data: st.DataObject) -> None:
    """Distances are minus scipy's number of moves, and each action leads one move nearer to the
    goal.
    """
    free = np.argwhere(grid == 0).tolist()
    if not free:
        return
    goal = data.draw(st.sampled_from(free))
    values = negative_distances(grid, goal)
    truth = lengths(grid, (goal[0], goal[1]), cut=True, diagonal=1.0)
    assert np.array_equal(values, np.where(np.isfinite(truth), -truth, -grid.size))
    actions = policy(values)
    assert (actions.sum(axis=0) == 1).all()
    for row, column in free:
        if 0 < truth[row, column] < math.inf:
            down, right = MOVES[int(np.argmax(actions[:, row, column]))]
            assert truth[row + down, column + right] == truth[row, column] - 1


def test_maps_without_starts_are_left_out() -> None:
    """On two free cells the loader would fail, and on one free cell the start would be the goal."""
    assert not start_candidates(negative_distances(np.array([[0, 1, 1]], np.uint8), (0, 0)))
    assert not start_candidates(negative_distances(np.array([[0, 0, 1]], np.uint8), (0, 0)))
    assert start_candidates(negative_distances(np.zeros((8, 8), np.uint8), (0, 0)))


def sound(count: int = 2, rows: int = 4, columns: int = 4) -> dict[str, npt.NDArray[np.generic]]:
    """Return the arrays of a file as published: float64, all free, goal upper left."""
    arrays: dict[str, npt.NDArray[np.generic]] = {}
    for code in range(3):
        goals = np.zeros((count, 1, rows, columns))
        goals[:, 0, 0, 0] = 1
        distances = -np.maximum(*np.mgrid[:rows, :columns]).astype(float)
        arrays[f"arr_{4 * code}"] = np.ones((count, rows, columns))
        arrays[f"arr_{4 * code + 1}"] = goals
        arrays[f"arr_{4 * code + 2}"] = np.zeros((count, 8, 1, rows, columns))
        arrays[f"arr_{4 * code + 3}"] = np.tile(distances, (count, 1, 1, 1))
    return arrays


def test_published_files_are_read(tmp_path: Path) -> None:
    """Arrays are float64, wrong distances are counted, maps with bad goals are left out, and a
    split may be missing.
    """
    arrays = sound()
    arrays["arr_0"][0, 3, 3] = 0
    arrays["arr_3"][0, 0, 3, 3] = -16
    arrays["arr_7"][1, 0, 2, 2] = -9
    arrays["arr_9"][1] = 0
    np.savez_compressed(tmp_path / "a.npz", **arrays)  # type: ignore[arg-type]
    collection = read(tmp_path / "a.npz")
    assert len(collection.maps) == 5
    assert collection.maps[0].grid.tolist() == [[0] * 4] * 3 + [[0, 0, 0, 1]]
    assert [foreign_map.split for foreign_map in collection.maps] == [0, 0, 1, 1, 2]
    assert collection.notes == ["distances of 4 of 5 maps are what our search finds"]
    assert [why for _, why in collection.left_out] == ["its goal is not one free cell"]
    four = {name: arrays[name] for name in ("arr_0", "arr_1", "arr_2", "arr_3")}
    np.savez(tmp_path / "b.npz", **four)  # type: ignore[arg-type]
    (dataset,) = import_maps(tmp_path / "back", read(tmp_path / "b.npz"))
    assert dataset.manifest.maps == 2


@pytest.mark.parametrize("movement", [slow(None), Movement(8)])
def test_published_mazes_serve_training_and_evaluation(
    movement: Movement | None, tmp_path: Path
) -> None:
    """An imported .npz gives batches of every split, and a table in which A* is optimal."""
    arrays = sound(12, 9, 9)
    for code in range(3):
        arrays[f"arr_{4 * code}"][:, 1::2, ::2] = (
            0  # bars with gaps: the stated distances are wrong, and counted so
        )
    np.savez(tmp_path / "mazes.npz", **arrays)  # type: ignore[arg-type]
    collection = read(tmp_path / "mazes.npz")
    import_maps(tmp_path / "mazes", collection, seed_points=4)
    loaders = MapDataModule(
        tmp_path / "mazes", movement=movement, batch_size=8, fields=("map", "goal", "optimal_moves")
    )
    for loader in (loaders.train_dataloader(), loaders.val_dataloader(), loaders.test_dataloader()):
        batches = list(loader)
        assert sum(len(batch[0]) for batch in batches) == 12 * 3
        assert batches[0][2].shape == (8, 1, 9, 9)
    to_goal = Random(to_first_seed_point=True)
    problems = MapDataset(tmp_path / "mazes", fields=("map", "goal"), problems=to_goal)[:]
    np.testing.assert_array_equal(
        problems.goal, [foreign_map.seed_points[0] for foreign_map in collection.maps]
    )
    rule = movement or NEURAL_ASTAR
    table = evaluate(
        classical(rule),
        ProblemSet.read(tmp_path / "mazes", problems=Random(), movement=rule),
        bootstrap=10,
    )
    best = table[(table["planner"] == "A*") & (table["subset"] == "all")].iloc[0]
    assert (best["n"], best["success"], best["opt"]) == (12, 1.0, 1.0)


def test_all_files_below_a_folder_become_one_dataset(tmp_path: Path) -> None:
    """Files of another layout are left out with a reason."""
    arrays = sound()
    for name in ("forest", "mazes"):
        np.savez(tmp_path / f"{name}.npz", **arrays)  # type: ignore[arg-type]
    assert recognise(tmp_path) == "planning-datasets"
    del arrays["arr_3"]
    np.savez(tmp_path / "bad.npz", **arrays)  # type: ignore[arg-type]
    collection = read(tmp_path)
    assert [foreign_map.name for foreign_map in collection.maps][5:7] == [
        f"{tmp_path / 'forest.npz'}: test 1",
        f"{tmp_path / 'mazes.npz'}: train 0",
    ]
    assert [(Path(name).name, why[:23]) for name, why in collection.left_out] == [
        ("bad.npz", "holds no array 'arr_3',")
    ]
    assert collection.notes == ["distances of 12 of 12 maps are what our search finds"]


def four_actions(count: int, rows: int, columns: int) -> dict[str, npt.NDArray[np.generic]]:
    """Return the arrays of a file without diagonals, as iA* publishes them: a bar with one gap."""
    arrays = sound(count, rows, columns)
    for code in range(3):
        arrays[f"arr_{4 * code}"][:, 1, :-1] = 0
        grid = 1 - arrays[f"arr_{4 * code}"][0].astype(np.uint8)
        graph = manhattan(grid, (0, 0))
        arrays[f"arr_{4 * code + 2}"] = np.zeros((count, 4, 1, rows, columns))
        distances = np.where(np.isfinite(graph), -graph, -grid.size)
        arrays[f"arr_{4 * code + 3}"] = np.tile(distances, (count, 1, 1, 1))
    return arrays


def manhattan(grid: Bytes, goal: tuple[int, int]) -> npt.NDArray[np.float64]:
    """Return the moves from every cell to ``goal`` without diagonals, inf without a path."""
    distances = np.full(grid.shape, np.inf)
    distances[goal] = 0
    for _ in range(grid.size):
        padded = np.pad(distances, 1, constant_values=np.inf)
        nearest = np.min(
            [padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]], axis=0
        )
        distances = np.where(grid == 1, np.inf, np.minimum(distances, nearest + 1))
    return distances


def test_policies_of_four_actions_have_no_diagonals(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Maps, distances and problems are 4-connected, unless a flag asks for another movement."""
    path = tmp_path / "news.npz"
    np.savez(path, **four_actions(2, 6, 7))  # type: ignore[arg-type]
    collection = read(path)
    assert collection.movement == Movement(4)
    assert collection.notes == ["distances of 6 of 6 maps are what our search finds"]
    assert cli(capsys, "import", path, tmp_path / "maps")[0] == 0
    assert read_manifest(tmp_path / "maps").movement == Movement(4)
    assert cli(capsys, "import", path, tmp_path / "eight", "--connectivity", 8)[0] == 0
    assert read_manifest(tmp_path / "eight").movement == Movement(8)
    problems = read_problems(path)
    assert problems.movement == Movement(4)
    lengths = manhattan(problems.grids[0], (0, 0))
    assert problems.optimal.cost.tolist() == [lengths[tuple(start)] for start in problems.starts]


def test_files_of_four_and_of_eight_actions_are_not_mixed(tmp_path: Path) -> None:
    """A dataset has the movement of its first file, and files of the other movement are
    left out.
    """
    np.savez(tmp_path / "a.npz", **sound(2, 6, 7))  # type: ignore[arg-type]
    np.savez(tmp_path / "b.npz", **four_actions(2, 6, 7))  # type: ignore[arg-type]
    collection = read(tmp_path)
    assert (len(collection.maps), collection.movement) == (6, NEURAL_ASTAR)
    assert collection.left_out == [
        (
            str(tmp_path / "b.npz"),
            "has 4 actions, the files before it 8: import it by itself",
        )
    ]


def test_a_distance_field_of_each_map_is_left_out(tmp_path: Path) -> None:
    """Files of five arrays a split, as iA* publishes them, give the maps of the first
    four arrays.
    """
    arrays = sound(3, 5, 6)
    fields: dict[str, npt.NDArray[np.generic]] = {}
    for code in range(3):
        for k in range(4):
            fields[f"arr_{5 * code + k}"] = arrays[f"arr_{4 * code + k}"]
        fields[f"arr_{5 * code + 4}"] = np.full((3, 5, 6), 7.5)
    np.savez(tmp_path / "plain.npz", **arrays)  # type: ignore[arg-type]
    np.savez(tmp_path / "fields.npz", **fields)  # type: ignore[arg-type]
    assert recognise(tmp_path / "fields.npz") == "planning-datasets"
    collection = read(tmp_path / "fields.npz")
    assert collection.notes == [
        "a distance field of each map (arr_4, arr_9, arr_14) is left out",
        "distances of 9 of 9 maps are what our search finds",
    ]
    plain = read(tmp_path / "plain.npz")
    for ours, theirs in zip(collection.maps, plain.maps, strict=True):
        assert np.array_equal(ours.grid, theirs.grid)
        assert ours.split == theirs.split
    assert (
        read_problems(tmp_path / "fields.npz").content_hash
        == read_problems(tmp_path / "plain.npz").content_hash
    )
    fields["arr_9"] = np.full((3, 5, 5), 7.5)
    np.savez(tmp_path / "bad.npz", **fields)  # type: ignore[arg-type]
    with pytest.raises(FormatError, match="arr_9 has shape"):
        read(tmp_path / "bad.npz")


def test_other_layouts_are_refused_with_the_name_of_the_array(tmp_path: Path) -> None:
    """The layouts are three arrays a split, orientations, and other numbers of actions."""
    arrays = sound(2, 5, 6)
    three = [arrays[f"arr_{4 * code + k}"] for code in range(3) for k in range(3)]
    np.savez(tmp_path / "three.npz", *three)
    with pytest.raises(FormatError, match="9 arrays, three a split as gated-path-planning"):
        read(tmp_path / "three.npz")
    for shape in ((2, 3, 4, 5, 6), (2, 16, 1, 5, 6), (3, 8, 1, 5, 6), (2, 8, 5, 6)):
        arrays["arr_2"] = np.zeros(shape)
        np.savez(tmp_path / "a.npz", **arrays)  # type: ignore[arg-type]
        with pytest.raises(FormatError, match=r"arr_2 has shape .*, expected .2, 8, 1, 5, 6."):
            read(tmp_path / "a.npz")
    arrays["arr_2"] = np.zeros((2, 8, 1, 5, 6))
    arrays["arr_6"] = np.zeros((2, 4, 1, 5, 6))
    np.savez(tmp_path / "a.npz", **arrays)  # type: ignore[arg-type]
    with pytest.raises(FormatError, match=r"arr_6 has shape .*, expected .2, 8, 1, 5, 6."):
        read(tmp_path / "a.npz")


def test_a_damaged_file_gives_no_map(tmp_path: Path) -> None:
    """The whole file is checked, up to the last number of the last array, before a map is used."""
    np.savez(tmp_path / "good.npz", **sound())  # type: ignore[arg-type]
    arrays = sound()
    arrays["arr_8"][-1, -1, -1] = 2
    np.savez(tmp_path / "bad.npz", **arrays)  # type: ignore[arg-type]
    collection = read(tmp_path)
    assert len(collection.maps) == 6
    assert [(Path(name).name, why) for name, why in collection.left_out] == [
        ("bad.npz", "array 'arr_8': map 1: holds values from 1.0 to 2.0, expected 0 to 1")
    ]


def test_a_note_counts_distances_to_another_cell_than_the_goal(tmp_path: Path) -> None:
    """In a published file goals and distances are of two different splits."""
    arrays = sound()
    arrays["arr_3"] = arrays["arr_3"][..., ::-1]
    np.savez(tmp_path / "a.npz", **arrays)  # type: ignore[arg-type]
    collection = read(tmp_path / "a.npz")
    assert collection.notes == [
        "distances of 4 of 6 maps are what our search finds",
        "distances of 2 maps lead to another cell than the goal of their map, which is kept",
    ]
    assert {tuple(foreign_map.seed_points[0].tolist()) for foreign_map in collection.maps} == {
        (0, 0)
    }


def test_many_bad_goals_are_one_line(tmp_path: Path) -> None:
    """The maps of a split with a bad goal are left out in one line, however many there are."""
    arrays = sound(5)
    arrays["arr_1"][1:4] = 0
    arrays["arr_5"][2] = 1
    np.savez(tmp_path / "a.npz", **arrays)  # type: ignore[arg-type]
    collection = read(tmp_path / "a.npz")
    assert len(collection.maps) == 11
    assert collection.left_out == [
        (f"{tmp_path / 'a.npz'}: train 1 and 2 others", "its goal is not one free cell"),
        (f"{tmp_path / 'a.npz'}: val 2", "its goal is not one free cell"),
    ]


def test_a_refused_export_writes_nothing(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Refused are another ending, an existing target and an option of another format."""
    for arguments in (
        (tmp_path / "x", "--format", "planning-datasets"),
        (tmp_path / "x.npz", "--format", "planning-datasets", "--ros.image", "png"),
    ):
        assert cli(capsys, "export", root, *arguments)[0] == 2
    (tmp_path / "x.npz").write_text("mine")
    code, _, err = cli(capsys, "export", root, tmp_path / "x.npz", "--format", "planning-datasets")
    assert code == 2
    assert "exists already" in err
    assert [path.name for path in tmp_path.iterdir()] == ["x.npz"]


def test_a_bad_number_far_inside_takes_no_memory(tmp_path: Path) -> None:
    """Maps are unpacked one at a time, and none is kept before all are checked."""
    maps = np.zeros((1024, 64, 64), np.uint8)
    maps[-1, -1, -1] = 2
    goals = npy((1024, 1, 64, 64), bytes(maps.size))
    policies = npy((1024, 8, 1, 64, 64), b"")
    path = npz(tmp_path / "a.npz", arr_0=npy(maps.shape, maps.tobytes()), arr_1=goals)
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("arr_2.npy", policies)
        archive.writestr("arr_3.npy", goals)
    tracemalloc.start()
    with pytest.raises(FormatError, match=r"arr_0.*: map 1023: holds values from 0 to 2"):
        read(path)
    assert tracemalloc.get_traced_memory()[1] < 2e6
    tracemalloc.stop()
