"""Files of problem sets: shared maps are stored once, damage is found, and old files are read."""

from __future__ import annotations

import copy
import json
import pickle
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.set_files import read_arrays, write_arrays, write_first_format

from mapdata import Movement, ProblemSet, ProblemSetDataset
from mapdata.arrays import Array
from mapdata.evaluation import score_paths
from mapdata.formats import read_problems

OLD_SETS = Path(__file__).parents[1] / "data" / "problem-sets-1"
"""Files that mapdata 0.2.0 wrote, and the content hashes that it computed."""

OLD_HASHES: dict[str, str] = json.loads((OLD_SETS / "hashes.json").read_text())


def walled(count: int, map_count: int, side: int = 24, *, terrain: bool = False) -> ProblemSet:
    """Return problems on a few maps, each used by several: problem i is on map ``i % map_count``.

    A wall with one gap, whose place is the number of the map, divides each map.
    """
    grids = np.zeros((count, side, side), np.uint8)
    grids[:, side // 2] = 1
    grids[np.arange(count), side // 2, np.arange(count) % map_count] = 0
    starts = np.stack([np.zeros(count, np.int64), np.arange(count) % side], axis=1)
    goals = side - 1 - starts
    costs = np.where(grids == 1, 0, 3 + np.arange(side, dtype=np.uint8))
    return ProblemSet(
        grids, starts, goals, Movement(8), "walls", costs.astype(np.uint8) if terrain else None
    )


def saved(problems: ProblemSet, folder: Path) -> Path:
    """Return the file of a set."""
    path = folder / "set.npz"
    problems.save(path)
    return path


# --- what is stored ------------------------------------------------------------------------------


@pytest.mark.parametrize("terrain", [False, True])
def test_each_different_map_is_stored_once(tmp_path: Path, *, terrain: bool) -> None:
    """In the file and in a pickle; numbers say who is on which map, and no picture is stored."""
    problems = walled(12, 3, terrain=terrain)
    path = saved(problems, tmp_path)
    maps = "terrain" if terrain else "grids"
    with np.load(path) as file:
        assert set(file) == {"about_format_2", maps, "starts", "goals", "map_indices"}
        assert file[maps].shape == (3, 24, 24)
        assert file["map_indices"].tolist() == [0, 1, 2] * 4
    assert len(pickle.dumps(problems)) < len(pickle.dumps(problems.grids)) + 8000
    own = problems[:3]
    with np.load(saved(own, tmp_path)) as file:
        assert set(file) == {"about_format_2", maps, "starts", "goals"}
    with np.load(saved(problems[[7, 4]], tmp_path)) as file:
        assert file[maps].shape == (1, 24, 24)
        assert file["map_indices"].tolist() == [1, 1]
        assert file["problem_numbers"].tolist() == [7, 4]


def uses(problems: ProblemSet, path: Path) -> list[Callable[[], object]]:
    """Return what can be done with a set, as functions without arguments."""
    return [
        lambda: problems.save(path),
        lambda: ProblemSet.load(path),
        lambda: ProblemSet.verify(path),
        lambda: pickle.loads(pickle.dumps(problems)),
        lambda: copy.deepcopy(problems),
        lambda: problems[1:],
        lambda: repr(problems[5:]),
        lambda: ProblemSetDataset(problems)[:8],
        lambda: score_paths(problems, problems.optimal, bootstrap=1),
        lambda: problems.hardness,
    ]


@pytest.mark.parametrize("map_count", [1, 2])
def test_maps_that_are_shared_take_the_memory_of_the_different_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, map_count: int
) -> None:
    """While a set is saved, loaded, copied, divided, served and scored."""
    count, side = 150, 128
    monkeypatch.setattr("mapdata.problems.problem_set._PART_CELLS", 2**17)
    monkeypatch.setattr("mapdata.datasets.problem_dataset.keep_freed_memory", lambda: None)
    path = tmp_path / "set.npz"
    # A small set comes first, because what is imported and compiled on first use takes memory.
    for use in uses(walled(10, map_count, 8), path):
        use()
    for use in uses(walled(count, map_count, side), path):
        tracemalloc.start()
        use()
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < count * side * side / 2
    assert path.stat().st_size < 50_000


@pytest.mark.parametrize("terrain", [False, True])
def test_a_shared_map_stays_shared(tmp_path: Path, *, terrain: bool) -> None:
    """Loaded, pickled and divided sets repeat the one map, also if it was given many times."""
    problems = walled(30, 1, terrain=terrain)
    copies = [
        problems,
        ProblemSet.load(saved(problems, tmp_path)),
        pickle.loads(pickle.dumps(problems)),
        copy.copy(problems),
        copy.deepcopy(problems),
        problems[3:9],
    ]
    for one in copies:
        assert one.grids.strides[0] == 0
        assert (one.grids if one.terrain is None else one.terrain).strides[0] == 0
        assert one.map_indices.tolist() == [0] * len(one)
        assert one.map_count == 1


def test_a_problem_on_several_maps_is_refused_by_its_number(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In whichever part it is searched."""
    monkeypatch.setattr("mapdata.problems.problem_set._PART_CELLS", 3 * 24 * 24)
    problems = walled(12, 2)
    starts = problems.starts.copy()
    starts[7] = 12, 5
    with pytest.raises(ValueError, match=r"^problem 7: start: \(12, 5\) is on an occupied cell"):
        ProblemSet(problems.grids, starts, problems.goals, Movement(8))
    whole = ProblemSet(problems.grids, problems.starts, problems.goals, Movement(8)).optimal
    for k, problem in enumerate(problems.optimal.offsets[:-1]):
        assert whole.offsets[k] == problem
    alone = [problems[[k]] for k in range(12)]
    for k, one in enumerate(alone):
        again = ProblemSet(one.grids, one.starts, one.goals, Movement(8)).optimal
        np.testing.assert_array_equal(again.cells, one.optimal.cells)
        assert again.cost[0] == whole.cost[k]
        assert again.iterations[0] == whole.iterations[k]


# --- formats -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", OLD_HASHES)
def test_files_of_the_first_format_are_read(name: str, tmp_path: Path) -> None:
    """With the same content hash; they are sound, and a map that is stored again is one map."""
    path = OLD_SETS / f"{name}.npz"
    problems = ProblemSet.load(path)
    assert problems.content_hash == OLD_HASHES[name]
    maps = {"own": [0, 1, 2, 3, 4, 5], "two": [0, 0, 0, 1], "one": [0, 0], "terrain": [0, 1, 2]}
    assert problems.map_indices.tolist() == maps[name]
    assert (problems.terrain is not None) == (name == "terrain")
    assert ProblemSet.verify(path) == []
    again = read_problems(saved(problems, tmp_path))
    assert again.content_hash == OLD_HASHES[name]
    assert again.description == problems.description
    assert again.movement == problems.movement


def test_a_newer_format_is_refused_by_name(tmp_path: Path) -> None:
    """As an older version refuses this one: its name is in the message."""
    path = saved(walled(4, 2), tmp_path)
    arrays = read_arrays(path)
    arrays["about_format_3"] = arrays.pop("about_format_2")
    np.savez(path, **arrays)  # type: ignore[arg-type]
    says = r"set\.npz: holds no saved problems \(has format 3, expected 1 to 2: install a newer"
    with pytest.raises(ValueError, match=says):
        ProblemSet.load(path)
    (fault,) = ProblemSet.verify(path)
    assert "has format 3" in fault


BAD_ARRAYS: dict[str, tuple[dict[str, Array], str]] = {
    "fewer numbers": ({"map_indices": np.zeros(3, np.int64)}, r"map_indices has shape \(3,\)"),
    "one map": ({"map_indices": np.zeros(4, np.int64)}, "holds 1 different numbers, expected 2"),
    "negative": ({"map_indices": np.array([-1, 0, -1, 0])}, "map_indices holds -1, expected no"),
    "parts of maps": (
        {"map_indices": np.array([0, 0.5, 0, 0.5])},
        "map_indices holds float64, expected int64",
    ),
    "flags of maps": (
        {"map_indices": np.array([False, True, False, True])},
        "map_indices holds bool, expected int64",
    ),
    "large numbers of maps": (
        {"map_indices": np.array([0, 2**64 - 1, 0, 2**64 - 1], np.uint64)},
        "map_indices holds uint64, expected int64",
    ),
    "equal maps": ({"grids": np.zeros((2, 24, 24), np.uint8)}, "two of its maps are equal"),
    "no map": ({"grids": np.zeros((0, 24, 24), np.uint8)}, "2 different numbers, expected 0"),
    "flat": ({"grids": np.zeros((24, 24), np.uint8)}, "have shapes"),
    "numbers of problems": (
        {"problem_numbers": np.zeros((4, 1), int)},
        "problem_numbers has shape",
    ),
    "negative numbers": (
        {"problem_numbers": np.array([0, 1, 2, -3])},
        "problem_numbers holds -3, expected no negative number",
    ),
    "equal numbers": (
        {"problem_numbers": np.array([4, 7, 5, 7])},
        "problem_numbers holds 7 for the different problems 1 and 3",
    ),
    "parts of problems": (
        {"problem_numbers": np.array([0.5, 1, 2, np.nan])},
        "problem_numbers holds float64, expected int64",
    ),
    "flags of problems": (
        {"problem_numbers": np.array([False, True, True, True])},
        "problem_numbers holds bool, expected int64",
    ),
    "parts of cells": ({"starts": np.full((4, 2), 0.5)}, "starts: got shape .* of float64"),
    "another array": ({"seed": np.zeros(4, np.int64)}, r"holds 'seed.npy' beside the arrays"),
    "maps and terrain": (
        {"terrain": np.ones((2, 24, 24), np.uint8)},
        r"holds 'grids.npy' beside the arrays",
    ),
}


BAD_TERRAIN: dict[str, tuple[dict[str, Array], str]] = {
    "high costs": ({"terrain": np.full((2, 24, 24), 300)}, "terrain: got the value 300"),
    "parts of costs": ({"terrain": np.full((2, 24, 24), 0.5)}, "terrain: got dtype float64"),
    "more terrain": (
        {"terrain": np.ones((3, 24, 24), np.uint8)},
        "map_indices holds 2 different numbers, expected 3",
    ),
    "flat terrain": ({"terrain": np.ones((2, 576), np.uint8)}, "have shapes"),
    "equal terrain": ({"terrain": np.ones((2, 24, 24), np.uint8)}, "two of its maps are equal"),
    "occupied ends": (
        {"terrain": np.arange(1152).reshape(2, 24, 24) % 23},
        "start: .* is on an occupied cell",
    ),
}


@pytest.mark.parametrize(
    ("terrain", "changes", "reason"),
    [
        *((False, *case) for case in BAD_ARRAYS.values()),
        *((True, *case) for case in BAD_TERRAIN.values()),
    ],
    ids=[*BAD_ARRAYS, *BAD_TERRAIN],
)
def test_arrays_that_do_not_fit_are_refused(
    changes: dict[str, Array], reason: str, tmp_path: Path, *, terrain: bool
) -> None:
    """By the name of the file, also where its hash fits."""
    path = saved(walled(4, 2, terrain=terrain), tmp_path)
    write_arrays(path, read_arrays(path) | changes)
    with pytest.raises(ValueError, match=rf"set\.npz: holds no saved problems \(.*{reason}"):
        ProblemSet.load(path)


def test_a_problem_may_be_in_a_set_twice(tmp_path: Path) -> None:
    """Under the same number, which is then no fault of the file."""
    problems = walled(4, 2)[[3, 0, 3]]
    assert ProblemSet.load(saved(problems, tmp_path)).problem_numbers.tolist() == [3, 0, 3]


def test_a_member_that_is_no_array_is_refused(tmp_path: Path) -> None:
    """Of a file of format 1, whose other members have checksums but no hash of them all."""
    path = tmp_path / "set.npz"
    write_first_format(path, walled(3, 2, 6))
    assert len(ProblemSet.load(path)) == 3
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("notes.txt", "mine")
    with pytest.raises(ValueError, match=r"holds 'notes.txt' beside the arrays of its format"):
        ProblemSet.load(path)


def test_a_set_that_another_program_wrote_is_refused(tmp_path: Path) -> None:
    """Its arrays may be sound, and a set can be built from them."""
    path = saved(walled(3, 2, 6), tmp_path)
    np.savez(path, **read_arrays(path))  # type: ignore[arg-type]
    says = r"its file hash does not fit: .*build a set that you trust anew from its arrays"
    with pytest.raises(ValueError, match=rf"set\.npz: holds no saved problems \({says}"):
        ProblemSet.load(path)


def test_the_limit_of_unpacking_counts_what_is_stored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One map for all problems is small; the same maps stored one by one are refused."""
    monkeypatch.setattr("mapdata.problems.set_file._MAX_UNPACKED", 2**14)
    problems = walled(300, 1, 64)
    path = saved(problems, tmp_path)
    assert len(ProblemSet.load(path)) == 300
    write_first_format(path, problems)
    with pytest.raises(ValueError, match=r"unpack to 1238400 bytes, expected at most"):
        ProblemSet.load(path)


# --- damage --------------------------------------------------------------------------------------


def flipped(content: bytes, bit: int) -> bytes:
    """Return bytes with one bit flipped."""
    changed = bytearray(content)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def check_verify(path: Path, step: int) -> None:
    """Check that `ProblemSet.verify` tells of each ``step``-th bit of a sound file in one line."""
    content = path.read_bytes()
    assert ProblemSet.verify(path) == []
    for bit in range(0, 8 * len(content), step):
        path.write_bytes(flipped(content, bit))
        faults = ProblemSet.verify(path)
        assert len(faults) == 1, bit
        assert faults[0].startswith(f"{path}: ")
        assert "\n" not in faults[0]


def test_verify_finds_flipped_bits(tmp_path: Path) -> None:
    """In all parts of the file: also those that no reader of zip archives looks at."""
    check_verify(saved(walled(3, 2, 6), tmp_path), 131)


@pytest.mark.slow
@pytest.mark.parametrize("terrain", [False, True])
def test_verify_finds_every_flipped_bit(tmp_path: Path, *, terrain: bool) -> None:
    """Without an exception."""
    check_verify(saved(walled(3, 2, 6, terrain=terrain), tmp_path), 1)


def contents(problems: ProblemSet) -> list[object]:
    """Return all that a file tells of a set, as values that can be compared."""
    arrays = (problems.starts, problems.goals, problems.map_indices, problems.problem_numbers)
    return [
        problems.grids.tobytes(),
        None if problems.terrain is None else problems.terrain.tobytes(),
        *(array.tolist() for array in arrays),
        problems.movement,
        problems.description,
    ]


def check_load(path: Path, step: int) -> None:
    """Check that `load` refuses a flip of each ``step``-th bit of a sound file, or is unchanged."""
    content = path.read_bytes()
    sound = contents(ProblemSet.load(path))
    refused = 0
    for bit in range(0, 8 * len(content), step):
        path.write_bytes(flipped(content, bit))
        try:
            loaded = ProblemSet.load(path)
        except ValueError:
            refused += 1
            continue
        assert contents(loaded) == sound, bit
    assert refused


SETS: dict[str, Callable[[], ProblemSet]] = {
    "own maps": lambda: walled(2, 2, 4),
    "shared maps": lambda: walled(3, 2, 4),
    "one map": lambda: walled(2, 1, 4),
    "subset": lambda: walled(4, 3, 4)[[2, 3]],
    "other order": lambda: walled(3, 3, 4)[[2, 0, 1]],
    "terrain": lambda: walled(3, 2, 4, terrain=True),
}
"""Small sets, each of which has other arrays in its file."""

FIRST_SETS = ("own maps", "shared maps", "one map", "terrain")
"""Those that are also written in format 1, which knows no numbers."""


@pytest.mark.parametrize("name", SETS)
def test_load_notices_flipped_bits(name: str, tmp_path: Path) -> None:
    """Also in the names of arrays that may be left out, which no checksum of a zip covers."""
    check_load(saved(SETS[name](), tmp_path), 331)


@pytest.mark.parametrize("name", ["map_indices", "problem_numbers"])
def test_an_array_with_a_damaged_name_does_not_pass_for_one_that_is_left_out(
    name: str, tmp_path: Path
) -> None:
    """Its name stands in the directory of the archive, after the arrays."""
    path = saved(SETS["other order"](), tmp_path)
    content = path.read_bytes()
    place = content.rindex(f"{name}.npy".encode()) + len(f"{name}.np")
    path.write_bytes(flipped(content, 8 * place))
    with pytest.raises(ValueError, match="its file hash does not fit"):
        ProblemSet.load(path)


@pytest.mark.parametrize("name", FIRST_SETS)
def test_load_notices_flipped_bits_in_format_1(name: str, tmp_path: Path) -> None:
    """Or they change nothing, such as the time of a member."""
    path = tmp_path / "set.npz"
    write_first_format(path, SETS[name]())
    check_load(path, 331)


@pytest.mark.slow
@pytest.mark.parametrize("name", SETS)
def test_load_notices_every_flipped_bit(name: str, tmp_path: Path) -> None:
    """Each of some 10,000 in a file."""
    check_load(saved(SETS[name](), tmp_path), 1)


@pytest.mark.slow
@pytest.mark.parametrize("name", FIRST_SETS)
def test_load_notices_every_flipped_bit_in_format_1(name: str, tmp_path: Path) -> None:
    """Or it changes nothing."""
    path = tmp_path / "set.npz"
    write_first_format(path, SETS[name]())
    check_load(path, 1)


def test_verify_finds_truncation_and_other_writers(tmp_path: Path) -> None:
    """What another program wrote has no hash; what lacks its end has none that fits."""
    path = saved(walled(3, 2, 6), tmp_path)
    content = path.read_bytes()
    for size in (0, 1, 100, len(content) - 1):
        path.write_bytes(content[:size])
        assert len(ProblemSet.verify(path)) == 1
    path.write_bytes(content + b"\0")
    assert len(ProblemSet.verify(path)) == 1
    path.write_bytes(content)
    np.savez(path, **read_arrays(path))  # type: ignore[arg-type]
    (fault,) = ProblemSet.verify(path)
    assert "its file hash does not fit" in fault
    with pytest.raises(FileNotFoundError):
        ProblemSet.verify(tmp_path / "none.npz")


def test_the_file_is_an_ordinary_archive(tmp_path: Path) -> None:
    """Zip programs test it without complaint."""
    with zipfile.ZipFile(saved(walled(3, 2, 6), tmp_path)) as archive:
        assert archive.testzip() is None
        assert archive.comment.startswith(b"mapdata sha256 ")


# --- subsets -------------------------------------------------------------------------------------

SELECTIONS: dict[str, Any] = {
    "slice": slice(2, 11, 3),
    "reversed": slice(None, None, -1),
    "list": [5, 0, 5, -1],
    "array": np.array([3, 9], np.int16),
    "mask": np.arange(12) % 5 == 1,
    "list of bools": [True, False] * 6,
    "none": [],
    "no mask": np.zeros(12, bool),
    "all": slice(None),
}


@pytest.mark.parametrize("indices", SELECTIONS.values(), ids=SELECTIONS)
@pytest.mark.parametrize("terrain", [False, True])
def test_a_subset_is_what_numpy_selects(indices: Any, *, terrain: bool) -> None:
    """Rows of all arrays, and the paths that the set has found already."""
    problems = walled(12, 3, terrain=terrain)
    subset = problems[indices]
    rows = np.arange(12)[indices]
    names = ["grids", "starts", "goals", "map_indices", "problem_numbers", "hardness", "hard"]
    for name in names + ["terrain"] * terrain:
        np.testing.assert_array_equal(getattr(subset, name), getattr(problems, name)[rows])
    assert (len(subset), subset.movement, subset.map_size) == (len(rows), Movement(8), (24, 24))
    for k, row in enumerate(rows):
        for paths, number in ((subset.optimal, k), (problems.optimal, row)):
            assert paths.cells[paths.offsets[number]].tolist() == problems.starts[row].tolist()
        assert subset.optimal.cost[k] == problems.optimal.cost[row]
    costs = subset.terrain
    rebuilt = ProblemSet(subset.grids, subset.starts, subset.goals, subset.movement, terrain=costs)
    assert subset.content_hash == rebuilt.content_hash
    for one, other in zip(subset.optimal, rebuilt.optimal, strict=True):
        np.testing.assert_array_equal(one, other)
    grids, terrains = problems.maps_of(indices)
    np.testing.assert_array_equal(grids, subset.grids)
    assert (terrains is not None) == terrain


def test_a_subset_of_a_subset_keeps_the_numbers_of_the_whole() -> None:
    """However often it is divided."""
    problems = walled(12, 3)
    assert problems[4:][[1, 6]].problem_numbers.tolist() == [5, 10]
    assert problems[4:][[1, 6]].map_indices.tolist() == [2, 1]


@pytest.mark.parametrize(
    ("indices", "error", "reason"),
    [
        (3, TypeError, r"got 3, expected a slice, .*; \[\[3\]\] is the set of this problem"),
        ([0.5], TypeError, r"got \[0\.5\], expected a slice"),
        ([[1, 2]], TypeError, "expected a slice"),
        ("ab", TypeError, "expected a slice"),
        ([12], IndexError, "index 12 is out of bounds"),
        ([-13], IndexError, "out of bounds"),
        (np.ones(11, bool), IndexError, r"got a mask of shape \(11,\), expected \(12,\)"),
        ([True] * 13, IndexError, r"got a mask of shape \(13,\), expected \(12,\)"),
        (np.ones((12, 1), bool), IndexError, r"got a mask of shape \(12, 1\), expected \(12,\)"),
        (True, TypeError, "got True, expected a slice"),
    ],
)
def test_what_selects_no_problems_is_refused(
    indices: Any, error: type[Exception], reason: str
) -> None:
    """An integer, which might mean a problem or a set; other numbers, and problems beyond."""
    with pytest.raises(error, match=reason):
        walled(12, 3)[indices]


ARRAYS: dict[str, Callable[[ProblemSet], Array]] = {
    "grids": lambda one: one.grids,
    "terrain": lambda one: np.asarray(one.terrain),
    "starts": lambda one: one.starts,
    "goals": lambda one: one.goals,
    "map_indices": lambda one: one.map_indices,
    "problem_numbers": lambda one: one.problem_numbers,
    "hardness": lambda one: one.hardness,
    "hard": lambda one: one.hard,
    "optimal.cells": lambda one: one.optimal.cells,
    "optimal.offsets": lambda one: one.optimal.offsets,
    "optimal.cost": lambda one: one.optimal.cost,
    "optimal.iterations": lambda one: one.optimal.iterations,
    "optimal.path": lambda one: one.optimal.path(0),
}
"""The arrays that a set hands out."""

COPIES: dict[str, Callable[[ProblemSet], ProblemSet]] = {
    "new": lambda problems: problems,
    "slice": lambda problems: problems[2:],
    "list": lambda problems: problems[[1]],
    "pickled": lambda problems: pickle.loads(pickle.dumps(problems)),
    "deep": copy.deepcopy,
}


@pytest.mark.parametrize("name", ARRAYS)
@pytest.mark.parametrize("kind", COPIES)
def test_no_array_of_a_set_can_be_written_to(kind: str, name: str) -> None:
    """Neither those that are made when they are first used, nor what scores are divided by."""
    problems = walled(12, 3, terrain=True)
    assert problems.hard.shape == problems.hardness.shape  # kept, and so copied with the set
    array = ARRAYS[name](COPIES[kind](problems))
    with pytest.raises(ValueError, match="read-only"):
        array[:] = 0


def test_repeated_maps_are_made_once() -> None:
    """And other attributes do not exist."""
    problems = walled(12, 3)
    assert problems.grids is problems.grids
    with pytest.raises(AttributeError, match="no attribute 'grid'"):
        _ = problems.grid  # type: ignore[attr-defined]
