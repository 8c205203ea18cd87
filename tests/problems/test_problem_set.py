"""Problems: they are the reference's, the same from a spec and from a dataset, with terrain and
without it, and what has no answer is refused.
"""

from __future__ import annotations

import fcntl
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from helpers import reference
from helpers.set_files import read_arrays, write_arrays

from mapdata import (
    MapGenerator,
    MapSpec,
    OnlineMapDataset,
    ProblemSet,
    Random,
    Route,
    Terrain,
    astar,
    build,
    generate,
)
from mapdata.arrays import Bytes
from mapdata.movement import Movement
from mapdata.problems import HARD

DUNGEON = MapSpec.preset("dungeon")
CUTTING = Movement(8, corner_cutting=True)

SMALL_ROOMS = MapSpec(
    map_size=(20, 31),
    rooms=(2, 5),
    room_rows=(2, 7),
    room_columns=(2, 7),
    passage_width=(1, 2),
)
TINY = MapSpec(
    map_size=(9, 7),
    rooms=(2, 3),
    room_rows=(1, 3),
    room_columns=(1, 3),
    passage_width=(1, 1),
)
"""Maps on many of which no two cells are 10 apart."""

ROUGH_ROOMS = Terrain(costs=(3, 8, 60), scale=2, over=SMALL_ROOMS)
HILLS = Terrain(map_size=(9, 14))

FAR = Random(distance=(10, None))
NARROW = Random(distance=(6, 12), hardness=(1.05, 2), length=(None, 11))
"""Conditions that the first draw on a map rarely meets."""
STEEP = Random(distance=(20, 60), hardness=(1.1, 9), length=(5, 12))
"""The same of maps on hills."""


def assert_same(one: ProblemSet, other: ProblemSet) -> None:
    """Compare maps, ends and movement of two sets of problems."""
    assert one.movement == other.movement
    np.testing.assert_array_equal(one.grids, other.grids)
    np.testing.assert_array_equal(costs_of(one), costs_of(other))
    np.testing.assert_array_equal(one.starts, other.starts)
    np.testing.assert_array_equal(one.goals, other.goals)


def costs_of(problems: ProblemSet) -> Bytes:
    """Return the cost of each cell, which is 1 on free cells without terrain."""
    return 1 - problems.grids if problems.terrain is None else problems.terrain


def chosen(problems: ProblemSet, which: slice | list[int]) -> ProblemSet:
    """Return some problems of a set."""
    return ProblemSet(
        problems.grids[which],
        problems.starts[which],
        problems.goals[which],
        problems.movement,
        terrain=None if problems.terrain is None else problems.terrain[which],
    )


@pytest.mark.parametrize("movement", [Movement(), Movement(8), CUTTING], ids=["4", "8", "cutting"])
@pytest.mark.parametrize(
    ("generator", "conditions"),
    [(SMALL_ROOMS, FAR), (SMALL_ROOMS, NARROW), (TINY, FAR), (TINY, NARROW), (HILLS, STEEP)],
    ids=["dungeon", "dungeon redrawn", "tiny", "tiny redrawn", "hills"],
)
def test_the_sample_is_the_references(
    generator: MapGenerator, conditions: Random, movement: Movement
) -> None:
    """Start, goal, cost, and which maps are left out, where one draw on a map is enough and where
    many are tried.
    """
    seed = 3
    maps = generate(generator, seed, range(12))
    grids = maps.occupancy
    terrains = [None] * 12 if maps.terrain is None else maps.terrain.tolist()
    drawn: dict[int, reference.ReferenceProblem] = {}
    redrawn = 0
    for index, terrain in enumerate(terrains):
        arguments = grids[index].tolist(), seed, index, conditions, movement
        problem = reference_problem(*arguments, draws=1000, terrain=terrain)
        if problem is not None:
            drawn[index] = problem
            redrawn += reference_problem(*arguments, draws=1, terrain=terrain) is None
    if generator != TINY and conditions != FAR:
        assert redrawn > 0
    if generator == TINY:
        assert 0 < len(drawn) < 12

    found = ProblemSet.sample(generator, seed, 12, problems=conditions, movement=movement)
    np.testing.assert_array_equal(found.grids, grids[list(drawn)])
    costs = 1 - grids if maps.terrain is None else maps.terrain
    np.testing.assert_array_equal(costs_of(found), costs[list(drawn)])
    assert found.starts.tolist() == [list(problem.start) for problem in drawn.values()]
    assert found.goals.tolist() == [list(problem.goal) for problem in drawn.values()]
    assert found.optimal.cost.tolist() == [
        reference.as_float(problem.cost, movement, terrains[index])
        for index, problem in drawn.items()
    ]


def reference_problem(
    grid: reference.Grid,
    seed: int,
    index: int,
    conditions: Random,
    movement: Movement,
    draws: int,
    terrain: reference.Grid | None = None,
) -> reference.ReferenceProblem | None:
    """Return the reference's problem in epoch 0, which is that of a set of problems."""
    return reference.reference_problem(
        grid, seed, index, 0, conditions.bands, movement, draws=draws, terrain=terrain
    )


def test_a_sample_makes_as_many_draws_as_are_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each further draw finds problems on maps that are left out without it."""
    grids = generate(TINY, 3, range(8)).occupancy.tolist()
    sizes = []
    for draws in (2, 3, 4):
        monkeypatch.setattr("mapdata.problems.problem_set.DRAWS_OF_SETS", draws)
        expected = []
        for index, grid in enumerate(grids):
            drawn = reference_problem(grid, 3, index, NARROW, Movement(), draws=draws)
            if drawn is not None:
                expected.append(list(drawn.start))
        found = ProblemSet.sample(TINY, 3, 8, problems=NARROW, movement=Movement())
        assert found.starts.tolist() == expected
        sizes.append(len(expected))
    assert sizes[0] < sizes[1] < sizes[2]


def test_the_first_problems_do_not_depend_on_how_many() -> None:
    """A longer sample begins with the shorter one, over the border of a chunk (256 maps); another
    seed gives others.
    """
    longer = ProblemSet.sample(DUNGEON, 1, 270, movement=Movement(8))
    shorter = ProblemSet.sample(DUNGEON, 1, 258, movement=Movement(8))
    assert len(shorter) == 258
    assert_same(shorter, chosen(longer, slice(258)))
    others = ProblemSet.sample(DUNGEON, 2, 258, movement=Movement(8))
    assert not np.array_equal(others.grids, shorter.grids)
    assert not np.array_equal(others.starts, shorter.starts)
    assert not np.array_equal(others.goals, shorter.goals)


def test_until_hard_stops_at_the_last_hard_problem() -> None:
    """Exactly so many hard problems, the last of them at the end; ``maps`` is then a limit.

    Every map of this preset has a problem, so that the set has as many maps as problems.
    """
    problems = ProblemSet.sample(DUNGEON, 4, until_hard=20, movement=Movement(8))
    maps = len(problems)
    assert problems.hard.sum() == 20
    assert problems.hard[-1]
    assert_same(problems, ProblemSet.sample(DUNGEON, 4, maps, movement=Movement(8)))
    assert_same(problems, ProblemSet.sample(DUNGEON, 4, maps, until_hard=20, movement=Movement(8)))
    with pytest.raises(ValueError, match="until_hard: got 20, found only 19"):
        ProblemSet.sample(DUNGEON, 4, maps - 1, until_hard=20, movement=Movement(8))


def test_a_sample_of_hard_problems_alone() -> None:
    """By the condition on hardness: no other is among them."""
    problems = ProblemSet.sample(
        DUNGEON, 4, 60, problems=Random(hardness=(HARD, None)), movement=Movement(8)
    )
    assert problems.hard.all()


def test_hardness_is_cost_over_heuristic() -> None:
    """By hand: around a wall, straight on, and diagonally past it."""
    grid = np.zeros((4, 4), np.uint8)
    grid[0, 1] = 1
    grids = np.stack([grid, grid, grid])
    starts = np.array([(0, 0), (0, 0), (3, 0)])
    goals = np.array([(0, 2), (3, 3), (3, 2)])
    manhattan = ProblemSet(grids, starts, goals, Movement())
    assert manhattan.hardness.tolist() == [4 / 2, 6 / 6, 2 / 2]
    assert manhattan.hard.tolist() == [True, False, False]

    octile = ProblemSet(grids, starts, goals, Movement(8))
    root = 2**0.5
    costs = [4, 2 + 2 * root, 2]
    heuristics = [2, 3 * root, 2]
    np.testing.assert_allclose(octile.hardness, np.divide(costs, heuristics), rtol=1e-12)


@pytest.mark.parametrize(
    ("generator", "some"), [(DUNGEON, range(1, 20)), (HILLS, range(16, 21))], ids=["grids", "hills"]
)
def test_hardness_of_sampled_problems(generator: MapGenerator, some: range) -> None:
    """The cost is the reference's and that of a search of one map, the heuristic the reference's:
    on terrain, that of a map whose cells all have the smallest cost. Nearly all hills are hard.
    """
    movement = Movement(8)
    problems = ProblemSet.sample(generator, 8, 20, movement=Movement(8))
    for k, grid in enumerate(problems.grids):
        terrain = None if problems.terrain is None else problems.terrain[k]
        costs = None if terrain is None else terrain.tolist()
        start = tuple(problems.starts[k].tolist())
        goal = tuple(problems.goals[k].tolist())
        truth = reference.reference_astar(grid.tolist(), start, goal, movement, costs)
        factor = 1 if terrain is None else 2 * int(terrain[terrain > 0].min())
        lower_bound = reference.heuristic(start, goal, movement, factor)
        hardness = truth.cost / reference.as_float(lower_bound, movement, costs)
        assert problems.optimal.cost[k] == truth.cost
        assert problems.optimal.iterations[k] == truth.iterations
        assert astar(grid, start, goal, movement, terrain=terrain).cost == truth.cost
        assert problems.hardness[k] == pytest.approx(hardness, rel=1e-12)
        assert problems.hard[k] == (hardness >= HARD)
    assert problems.hard.sum() in some


@pytest.mark.parametrize("generator", [DUNGEON, HILLS], ids=["grids", "hills"])
def test_a_dataset_gives_the_problems_of_its_spec(generator: MapGenerator, tmp_path: Path) -> None:
    """On the test split of a root stand the problems that its spec and seed give on these maps."""
    build(tmp_path, generator, maps=120, seed=9, shard_size=50, workers=1)
    every = ProblemSet.sample(generator, 9, 120, movement=Movement(8))
    assert len(every) == 120  # problem k is on map k
    test = [k for k in range(120) if reference.reference_split(generator, 9, k) == 2]
    train = [k for k in range(120) if reference.reference_split(generator, 9, k) == 0]
    assert len(test) > 3
    assert len(train) > 60
    assert_same(ProblemSet.read(tmp_path, movement=Movement(8)), chosen(every, test))
    assert_same(ProblemSet.read(tmp_path, 2, movement=Movement(8)), chosen(every, test[:2]))
    assert_same(
        ProblemSet.read(str(tmp_path), split="train", movement=Movement(8)), chosen(every, train)
    )
    others = ProblemSet.read(tmp_path, seed=1, movement=Movement(8))
    np.testing.assert_array_equal(others.grids, every.grids[test])
    assert not np.array_equal(others.starts, every.starts[test])
    with pytest.raises(ValueError, match="split"):
        ProblemSet.read(tmp_path, split="validation", movement=Movement(8))


def test_a_split_without_maps_is_named(tmp_path: Path) -> None:
    """With the number of maps of each split: the conditions are not to blame."""
    build(tmp_path, replace(TINY, splits=(1.0, 0.0, 0.0)), maps=3, workers=1)
    message = r"split: got 'test', which has 0 maps in .* \(train 3, val 0, test 0\)"
    with pytest.raises(ValueError, match=message):
        ProblemSet.read(tmp_path, movement=Movement(8))


def test_the_arrays_cannot_be_written() -> None:
    """They are copies: neither the caller's arrays nor a planner changes the problems."""
    grids = np.zeros((1, 2, 3), np.uint8)
    terrain = np.full((1, 2, 3), 5, np.uint8)
    starts = np.array([[0, 0]])
    goals = np.array([[1, 2]])
    problems = ProblemSet(grids, starts, goals, Movement(), terrain=terrain)
    for own in (grids, terrain, starts, goals):
        own[:] = 1
    assert problems.terrain is not None
    assert not problems.grids.any()
    assert (problems.terrain == 5).all()
    assert problems.starts.tolist() == [[0, 0]]
    assert problems.goals.tolist() == [[1, 2]]
    for array in (problems.grids, problems.terrain, problems.starts, problems.goals):
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 0


def test_the_arrays_have_one_type() -> None:
    """Whatever integers are given."""
    grids = np.zeros((1, 2, 3), np.int64)
    starts = np.array([[0, 0]], np.int8)
    goals = np.array([[1, 2]], np.int32)
    problems = ProblemSet(
        grids,  # type: ignore[arg-type]
        starts,  # type: ignore[arg-type]
        goals,  # type: ignore[arg-type]
        Movement(),
        terrain=grids + 1,  # type: ignore[arg-type]
    )
    assert problems.terrain is not None
    assert problems.grids.dtype == problems.terrain.dtype == np.uint8
    assert problems.starts.dtype == np.int64
    assert problems.goals.dtype == np.int64


@pytest.mark.parametrize(
    ("grids", "starts", "goals", "why"),
    [
        ([[[0, 1, 0]]], [(0, 0)], [(0, 2)], "problem 0 has no path"),
        ([[[0, 0]]] * 2, [(0, 0), (0, 1)], [(0, 1), (0, 1)], "problem 1 starts at its goal"),
        ([[0, 0]], [(0, 0)], [(0, 1)], "expected \\(N, H, W\\)"),
        ([[[0, 0]]], [(0, 0), (0, 1)], [(0, 1), (0, 1)], "equal numbers"),
        ([[[0, 0]]], [(0, 0)], [(0, 2)], "goal: .* is outside"),
        ([[[0, 3]]], [(0, 0)], [(0, 1)], "grid: got the value 3"),
        ([[[0, 0]]], [(0, 0)], [(0, 0.5)], "goals: .*expected .*integer cells"),
    ],
)
def test_what_cannot_be_evaluated_is_refused(
    grids: npt.ArrayLike, starts: npt.ArrayLike, goals: npt.ArrayLike, why: str
) -> None:
    """No path, nothing to do, arrays that do not fit, bad values: named when the problems are
    made.
    """
    with pytest.raises(ValueError, match=why):
        ProblemSet(np.array(grids), np.array(starts), np.array(goals), Movement())


def test_a_sample_without_problems_is_refused() -> None:
    """None of the maps is large enough, or their number is below 1."""
    with pytest.raises(ValueError, match="maps: got 0"):
        ProblemSet.sample(DUNGEON, 0, 0, movement=Movement(8))
    with pytest.raises(ValueError, match="until_hard: got -1"):
        ProblemSet.sample(DUNGEON, 0, until_hard=-1, movement=Movement(8))
    too_small = replace(TINY, map_size=(5, 5))
    why = r'got {"random": {"distance": \[10.0, null\]}}: none on one map after another; 3 maps '
    with pytest.raises(ValueError, match=why):
        ProblemSet.sample(too_small, 0, 3, movement=Movement(8))


def test_several_problems_on_each_map_are_the_references(tmp_path: Path) -> None:
    """Problem j of k on map m has the index k m + j; of a dataset, m is the number of the map."""
    problems = Random(distance=(6, None), per_map=3)
    build(tmp_path, TINY, maps=8, seed=3, workers=1)
    for found, maps in (
        (ProblemSet.sample(TINY, 3, 8, problems=problems, movement=Movement()), range(8)),
        (
            ProblemSet.read(tmp_path, split="train", problems=problems, movement=Movement()),
            [m for m in range(8) if reference.reference_split(TINY, 3, m) == 0],
        ),
    ):
        ends = []
        for m in maps:
            grid = reference.reference_map(TINY, 3, m).occupancy
            for j in range(3):
                drawn = reference_problem(grid, 3, 3 * m + j, problems, Movement(), draws=1000)
                if drawn is not None:
                    ends.append((*drawn.start, *drawn.goal))
        assert 0 < len(ends) <= 3 * len(maps)
        assert np.hstack((found.starts, found.goals)).tolist() == [list(end) for end in ends]


def test_a_sample_ends_after_maps_without_a_problem(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The error says how many; a bar counts them. A split is tried whole."""
    monkeypatch.setattr("mapdata.problems.substitutes.MAX_CELLS", 0)
    long = Random(length=(63, None))
    with pytest.raises(ValueError, match="; 32 maps were tried, from the maps with identity"):
        ProblemSet.sample(TINY, 3, 90, problems=long, movement=Movement(), progress=True)
    assert "/90" in capsys.readouterr().err
    # One problem is enough, however late the next one comes.
    seldom = ProblemSet.sample(TINY, 3, 90, problems=Random((6, None)), movement=Movement())
    assert 0 < len(seldom) < 90


def test_a_sample_in_vain_tries_no_map_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    """After M maps, which docs/format.md defines, there is an error."""
    cells_of_a_map = 9 * 7
    monkeypatch.setattr("mapdata.problems.substitutes.MAX_CELLS", 32 * 1000 * cells_of_a_map)
    with pytest.raises(ValueError, match="; 32 maps were tried, from the maps with identity"):
        ProblemSet.sample(TINY, 3, 90, problems=Random(length=(63, None)), movement=Movement())


@pytest.mark.parametrize("movement", [Movement(), CUTTING], ids=["4", "cutting"])
@pytest.mark.parametrize("generator", [DUNGEON, HILLS], ids=["grids", "hills"])
def test_a_saved_set_is_the_same(
    generator: MapGenerator, movement: Movement, tmp_path: Path
) -> None:
    """To the last array, with movement and words; its bytes and hash are those of the problems."""
    problems = ProblemSet.sample(generator, 77, 20, movement=movement)
    path = tmp_path / "set.npz"
    problems.save(path)
    again = ProblemSet.load(path)
    assert_same(again, problems)
    assert again.description == problems.description
    assert again.content_hash == problems.content_hash
    saved_again = tmp_path / "other"
    again.save(saved_again)
    assert saved_again.read_bytes() == path.read_bytes()


def test_a_set_may_unpack_to_200_times_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What `save` writes is read, also where a small limit stands for many maps: then it does not
    compress. Others are refused with a way out.
    """
    monkeypatch.setattr("mapdata.problems.set_file._MAX_UNPACKED", 2**16)
    count = 50
    grids = np.zeros((count, 120, 120), np.uint8)
    grids[np.arange(count), 119, np.arange(count)] = 1  # different maps
    starts = np.stack([np.arange(count), np.zeros(count, np.int64)], axis=1)
    problems = ProblemSet(grids, starts, starts + 5, Movement())
    path = tmp_path / "set.npz"
    problems.save(path)
    assert path.stat().st_size > grids.nbytes
    assert_same(ProblemSet.load(path), problems)
    write_arrays(path, read_arrays(path), compress=True)
    size = grids.nbytes + 2 * starts.nbytes
    limit = max(2**16, 200 * path.stat().st_size)
    assert size > limit
    says = rf"unpack to {size} bytes, expected at most {limit}: .* anew from its arrays"
    with pytest.raises(ValueError, match=says):
        ProblemSet.load(path)
    walls = ProblemSet.sample(DUNGEON, 77, 20, movement=Movement(8))  # some 30 times its file
    walls.save(path)
    assert walls.grids.nbytes > 10 * path.stat().st_size
    assert_same(ProblemSet.load(path), walls)
    monkeypatch.setattr("mapdata.problems.set_file.MAX_BYTES", 2**16)
    with pytest.raises(ValueError, match="expected at most 65536: "):
        ProblemSet.load(path)
    walls.save(path)
    assert walls.grids.nbytes < path.stat().st_size
    assert_same(ProblemSet.load(path), walls)


def test_a_full_disk_leaves_the_set_that_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing half-written under the name, and no other file."""
    path = tmp_path / "set.npz"
    problems = ProblemSet.sample(DUNGEON, 77, 5, movement=Movement(8))
    problems.save(path)

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        ProblemSet.sample(DUNGEON, 77, 20, movement=Movement(8)).save(path)
    assert_same(ProblemSet.load(path), problems)
    assert list(tmp_path.iterdir()) == [path]


def test_a_save_removes_what_a_killed_one_left(tmp_path: Path) -> None:
    """In the same folder, of a set of any name; what a living writer has locked stays."""
    problems = ProblemSet.sample(DUNGEON, 77, 5, movement=Movement(8))
    left = tmp_path / ".set.npz.0123456789abcdef.mapdata.tmp"
    living = tmp_path / ".set.npz.fedcba9876543210.mapdata.tmp"
    left.write_bytes(b"half")
    with open(living, "wb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        problems.save(tmp_path / "other.npz")
    assert set(tmp_path.iterdir()) == {living, tmp_path / "other.npz"}


def test_the_hash_tells_sets_apart() -> None:
    """By maps, costs, ends and movement; not by words. One is golden."""
    grid = np.array([[0, 0, 0], [0, 1, 0]])
    problems = ProblemSet(grid[None], np.array([[0, 0]]), np.array([[1, 2]]), Movement())
    golden = "1bf9f5c51756f669d05ec4ffbeb97619ba32f691e8c76b05aa62cc8bbf2c8ad1"
    assert problems.content_hash == golden
    assert replace(problems, description="others").content_hash == golden
    others = [
        replace(problems, starts=np.array([[1, 0]])),
        replace(problems, goals=np.array([[0, 2]])),
        replace(problems, grids=np.zeros((1, 2, 3), int)),
        replace(problems, movement=Movement(8)),
        replace(problems, terrain=1 - grid[None]),
        replace(problems, terrain=2 - 2 * grid[None]),
    ]
    hashes = {golden, *(other.content_hash for other in others)}
    assert len(hashes) == 7


NO_SETS: dict[str, dict[str, Any]] = {
    "another archive": {"grids": np.zeros((1, 2, 2))},
    "words of another kind": {"about": np.array("[]"), "grids": 1, "starts": 1, "goals": 1},
    "broken JSON": {"about": np.array("{"), "grids": 1, "starts": 1, "goals": 1},
    "a pickle": {"about": np.array({"a": 1}, object)},
}


@pytest.mark.parametrize("arrays", NO_SETS.values(), ids=NO_SETS)
def test_what_is_no_saved_set_is_refused(arrays: dict[str, Any], tmp_path: Path) -> None:
    """By name: another archive, other words, pickles."""
    path = tmp_path / "set.npz"
    np.savez(path, **arrays)
    with pytest.raises(ValueError, match=r"set\.npz: holds no saved problems"):
        ProblemSet.load(path)


def test_problems_that_cannot_be_are_refused_by_the_name_of_their_file(tmp_path: Path) -> None:
    """As where others wrote 255 for 1."""
    path = tmp_path / "set.npz"
    ProblemSet.sample(MapSpec(), 0, 3, movement=Movement(8)).save(path)
    arrays = read_arrays(path)
    write_arrays(path, arrays | {"grids": arrays["grids"] * 255})
    with pytest.raises(ValueError, match=r"set\.npz: .*grid: got"):
        ProblemSet.load(path)


def test_what_is_no_archive_is_refused(tmp_path: Path) -> None:
    """By name: text, and no file at all."""
    path = tmp_path / "set.npz"
    for text in ("text", ""):
        path.write_text(text)
        with pytest.raises(ValueError, match=r"set\.npz: holds no saved problems"):
            ProblemSet.load(path)
    with pytest.raises(FileNotFoundError):
        ProblemSet.load(tmp_path / "none.npz")


def test_the_movement_of_a_sample_is_that_of_its_maps(tmp_path: Path) -> None:
    """Unless another one is named; a set of arrays has no default."""
    generator = MapSpec(movement=Movement(8))
    own, named = (ProblemSet.sample(generator, 3, 5, movement=m) for m in (None, Movement(8)))
    assert own.movement == named.movement == Movement(8)
    assert own.content_hash == named.content_hash
    build(tmp_path / "maps", generator, maps=60)
    assert ProblemSet.read(tmp_path / "maps").movement == Movement(8)
    assert ProblemSet.read(tmp_path / "maps", movement=Movement(4)).movement == Movement(4)
    with pytest.raises(TypeError, match="movement"):
        ProblemSet(own.grids, own.starts, own.goals)  # type: ignore[call-arg]


def test_problems_of_no_source_are_refused() -> None:
    """Another name, and problems that have no path."""
    with pytest.raises(ValueError, match="problems: got 'rout', expected one of route, pairs"):
        ProblemSet.sample(DUNGEON, 0, 3, problems="rout", movement=Movement(8))
    with pytest.raises(
        ValueError, match=r"got Route\(unsolvable=True\), expected unsolvable=False"
    ):
        ProblemSet.sample(DUNGEON, 0, 3, problems=Route(unsolvable=True), movement=Movement(8))


@pytest.mark.parametrize("problems", ["route", "pairs"])
@pytest.mark.parametrize("generator", [SMALL_ROOMS, ROUGH_ROOMS], ids=["grids", "terrain"])
def test_problems_between_seed_points_are_those_that_an_online_dataset_serves_first(
    problems: str, generator: MapGenerator
) -> None:
    """On every map, under the movement and radius of the call."""
    movement = Movement(8)
    options: dict[str, Any] = {"problems": problems, "movement": movement, "radius": 0.07}
    dataset = OnlineMapDataset(
        generator, 5, 90, fields=("terrain", "start", "goal"), sampling_seed=5, **options
    )
    samples = dataset[:]
    sampled = ProblemSet.sample(generator, 5, 90, **options)
    assert "inflated by" in sampled.description
    served = {
        (costs.numpy().tobytes(), tuple(start.tolist()), tuple(goal.tolist()))
        for costs, start, goal in zip(
            samples.terrain[:, 0], samples.start, samples.goal, strict=True
        )
    }
    assert len(sampled) > 10
    for costs, start, goal in zip(costs_of(sampled), sampled.starts, sampled.goals, strict=True):
        assert (costs.tobytes(), tuple(start.tolist()), tuple(goal.tolist())) in served
