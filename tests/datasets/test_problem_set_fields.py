"""A problem stays as it is: no field changes when its set is stored, copied, divided or exported.

Whatever the maps: each problem has its own, all share one, or some share some; with and without
terrain.
"""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers.examples import ARE_ALL
from helpers.grids import scipy_distances
from helpers.samples import ALL_FIELDS, assert_same

from mapdata import (
    MapDataset,
    Movement,
    OnlineMapDataset,
    ProblemSet,
    ProblemSetDataset,
    Random,
    Sample,
    Tiles,
    build,
    evaluate,
)
from mapdata.datasets.fields import FIELDS
from mapdata.datasets.sample import row
from mapdata.evaluation import score_paths
from mapdata.evaluation.planners import classical
from mapdata.export import export_problems, verify_export
from mapdata.formats import read_problems
from mapdata.generators import Terrain

MOVEMENT = Movement(8, corner_cutting=True, diagonal_cost=1)
COUNT = 6
SIDE = 7
ROWS = {"own maps": [0, 1, 2, 3, 4, 5], "one map": [0] * COUNT, "some shared": [1, 0, 1, 2, 0, 1]}
"""The map of each problem, by the name of a set."""


@cache
def problem_set(kind: str, *, terrain: bool, movement: Movement = MOVEMENT) -> ProblemSet:
    """Return problems on random maps, from corner to corner and between other free cells."""
    random = np.random.default_rng(5)
    # Pictures of tiles have textures of their own for each cost, so the default run has few.
    levels = np.arange(1, 255) if ARE_ALL else np.array([1, 2, 9, 254])
    costs = random.choice(levels.astype(np.uint8), (COUNT, SIDE, SIDE))
    costs[:, 1:-1, 1:-1] *= random.random((COUNT, SIDE - 2, SIDE - 2)) < 0.7
    costs = costs[ROWS[kind]]
    starts = np.stack([np.zeros(COUNT, np.int64), np.arange(COUNT)], axis=1)
    grids = (costs == 0).astype(np.uint8)
    return ProblemSet(grids, starts, SIDE - 1 - starts, movement, kind, costs if terrain else None)


def fields_of(problems: ProblemSet) -> tuple[str, ...]:
    """Return the names of all fields that the maps have."""
    assert set(ALL_FIELDS) == set(FIELDS)
    return tuple(name for name in FIELDS if name != "waypoints" or not problems.has_terrain)


def all_fields(problems: ProblemSet, **options: Any) -> Sample:
    """Return all fields of all problems; paths are padded alike in all sets."""
    dataset = ProblemSetDataset(problems, fields_of(problems), max_length=SIDE * SIDE, **options)
    return dataset[:]


def rows_of(batch: Sample, rows: list[int]) -> Sample:
    """Return some rows of a batch."""
    return type(batch)(*(tensor[rows] for tensor in batch))


def through_a_file(problems: ProblemSet, folder: Path) -> ProblemSet:
    """Return a set after it was saved and loaded, as `read_problems` does it."""
    problems.save(folder / "set.npz")
    return read_problems(folder / "set.npz")


COPIES: dict[str, Callable[[ProblemSet, Path], ProblemSet]] = {
    "saved": through_a_file,
    "saved twice": lambda s, folder: through_a_file(through_a_file(s, folder), folder),
    "pickled": lambda s, _: pickle.loads(pickle.dumps(s)),
    "copied": lambda s, _: copy.copy(s),
    "copied deeply": lambda s, _: copy.deepcopy(s),
    "sliced": lambda s, _: s[:],
    "rebuilt": lambda s, _: ProblemSet(
        s.grids, s.starts, s.goals, s.movement, s.description, s.terrain
    ),
}

sets = pytest.mark.parametrize("kind", ROWS)
maps = pytest.mark.parametrize("terrain", [False, True], ids=["uniform", "terrain"])


@sets
@maps
@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
def test_a_copy_has_the_same_fields(
    kind: str,
    copied: Callable[[ProblemSet, Path], ProblemSet],
    tmp_path: Path,
    *,
    terrain: bool,
) -> None:
    """Each field of each problem, turned and reflected alike, and the hash of the set."""
    problems = problem_set(kind, terrain=terrain)
    other = copied(problems, tmp_path)
    for options in ({}, {"augment": True, "search": "bfs"}):
        assert_same(all_fields(other, **options), all_fields(problems, **options))
    assert other.content_hash == problems.content_hash
    assert (other.description, other.movement) == (problems.description, problems.movement)


@sets
@maps
@pytest.mark.parametrize("is_saved", [False, True])
def test_a_problem_of_a_subset_has_the_same_fields(
    kind: str, tmp_path: Path, *, terrain: bool, is_saved: bool
) -> None:
    """Its number, that of its map, its picture and its symmetry among them; in every epoch."""
    problems = problem_set(kind, terrain=terrain)
    rows = [4, 1, 5, 1]
    subset = problems[rows]
    if is_saved:
        subset = through_a_file(subset, tmp_path)
    for options in ({}, {"augment": True, "search": "bfs"}):
        whole = all_fields(problems, **options)
        assert_same(all_fields(subset, **options), rows_of(whole, rows))
    fields = ("symmetry", "image", "problem", "map_index")
    later = ProblemSetDataset(subset, fields, augment=True)[[0 + 3 * 4, 2 + 3 * 4]]
    whole_later = ProblemSetDataset(problems, fields, augment=True)[[4 + 3 * COUNT, 5 + 3 * COUNT]]
    assert_same(later, whole_later)


# --- exports -------------------------------------------------------------------------------------


@sets
@maps
def test_arrays_hold_the_fields_of_the_set(kind: str, tmp_path: Path, *, terrain: bool) -> None:
    """All of them, for subsets too."""
    problems = problem_set(kind, terrain=terrain)[[4, 0, 1]]
    fields = fields_of(problems)
    target = tmp_path / "out"
    notes = export_problems(problems, target, fields=fields, max_length=SIDE * SIDE, split="train")
    served = all_fields(problems)
    assert notes[0] == f"problems: {kind}"
    for name in fields:
        stored = np.load(target / "train" / f"{name}.npy")
        assert stored.dtype == getattr(served, name).numpy().dtype
        np.testing.assert_array_equal(stored, getattr(served, name))
    assert verify_export(target) == []


@sets
@maps
def test_parquet_holds_the_fields_of_the_set(kind: str, tmp_path: Path, *, terrain: bool) -> None:
    """A row for each problem; of a saved set, too."""
    parquet = pytest.importorskip("pyarrow.parquet")
    problems = problem_set(kind, terrain=terrain)
    problems.save(tmp_path / "set.npz")
    export_problems(
        tmp_path / "set.npz", tmp_path / "out", format="parquet", fields=fields_of(problems)
    )
    table = parquet.read_table(tmp_path / "out/data/test-00000-of-00001.parquet").to_pydict()
    served = all_fields(problems)
    assert list(table) == list(fields_of(problems))
    for k in range(COUNT):
        sample = row(served, k)
        for name, column in table.items():
            field = getattr(sample, name).numpy()
            if name == "path":
                field = field[field[:, 0] >= 0]
            np.testing.assert_array_equal(np.array(column[k], field.dtype), np.squeeze(field))


def test_a_warcraft_export_reads_back_as_the_same_problems(tmp_path: Path) -> None:
    """Every field: the picture that the files hold is that of the problems that are read."""
    tiles = ProblemSet.sample("tiles", seed=3, maps=COUNT, movement=MOVEMENT, problems="route")
    export_problems(tiles, tmp_path / "out", format="warcraft")
    again = read_problems(tmp_path / "out")
    fields = fields_of(tiles)
    served = ProblemSetDataset(tiles, fields)[:]
    assert_same(ProblemSetDataset(again, fields)[:], served)
    assert again.content_hash == tiles.content_hash
    pictures = np.load(tmp_path / "out/test_maps.npy")
    np.testing.assert_array_equal(pictures, served.image.permute(0, 2, 3, 1))


@sets
def test_a_transpath_export_reads_back_as_the_same_problems(kind: str, tmp_path: Path) -> None:
    """Every field, by the rule of the layout."""
    problems = problem_set(kind, terrain=False, movement=Movement(8, corner_cutting=True))
    export_problems(problems, tmp_path / "out", format="transpath")
    again = read_problems(tmp_path / "out")
    assert_same(all_fields(again), all_fields(problems))


def test_what_does_not_fit_a_set_is_refused(tmp_path: Path) -> None:
    """By the name of the argument."""
    problems = problem_set("own maps", terrain=False)
    cases: list[tuple[dict[str, Any], str]] = [
        ({"problems": "random"}, "problems: a problem set has its own"),
        ({"seed": 3}, "seed: a problem set has its own"),
        ({"radius": 0.3}, "radius: a problem set has its own"),
        ({"movement": Movement(4)}, "movement: got .*, expected that of the problem set"),
        ({"augment": True}, "augment: changes training problems only"),
        ({"count": 7}, "count: got 7, but the problem set has 6 problems"),
        ({"format": "gppn"}, "gppn: is one file of all splits"),
        ({"format": "hrm"}, "hrm: .* 4-connected"),
    ]
    for options, reason in cases:
        with pytest.raises(ValueError, match=reason):
            export_problems(problems, tmp_path / "out", **options)
    with pytest.raises(ValueError, match="got a problem set without problems"):
        export_problems(problems[[]], tmp_path / "out")
    export_problems(problems, tmp_path / "out", count=2, fields=("map",))
    assert len(np.load(tmp_path / "out/test/map.npy")) == 2


# --- pictures ------------------------------------------------------------------------------------


def test_a_map_has_one_picture_wherever_it_is_served(tmp_path: Path) -> None:
    """Online, under two roots at once, in a set and in its subset, whatever its number is."""
    generator = Terrain((6, 6), costs=(8, 12, 53), obstacles=0.1, seed_points=3)
    fields: Any = ("terrain", Tiles(noise=9))
    online = OnlineMapDataset(generator, 3, 12, fields=fields, problems="random")[:]
    pictures = {
        terrain.numpy().tobytes(): image
        for terrain, image in zip(online.terrain, online.image, strict=True)
    }
    assert len(pictures) == 12
    assert len({image.numpy().tobytes() for image in pictures.values()}) == 12
    build(tmp_path / "a", generator, maps=5, seed=3)
    build(tmp_path / "b", generator, maps=12, seed=3)
    problems = ProblemSet.sample(
        generator, 3, 12, movement=Movement(8), problems=Random(distance=(1, None))
    )
    served = [
        MapDataset([tmp_path / "b", tmp_path / "a"], None, fields, problems="random")[:],
        ProblemSetDataset(problems, fields)[:],
        ProblemSetDataset(problems[::-2], fields)[:],
    ]
    for batch in served:
        assert len(batch.image) >= 6
        for terrain, image in zip(batch.terrain, batch.image, strict=True):
            assert torch.equal(image, pictures[terrain.numpy().tobytes()])


def test_a_map_that_is_stored_reflected_has_a_picture_of_its_own() -> None:
    """The reflection of the picture belongs to the reflection that ``augment`` draws."""
    problems = problem_set("one map", terrain=True)
    assert problems.terrain is not None
    reflected = ProblemSet(
        problems.grids[:, ::-1],
        abs(problems.starts - np.array([SIDE - 1, 0])),
        abs(problems.goals - np.array([SIDE - 1, 0])),
        MOVEMENT,
        terrain=problems.terrain[:, ::-1],
    )
    image, other = (ProblemSetDataset(s, ("image",))[0].image for s in (problems, reflected))
    assert not torch.equal(other, image.flip(1))


# --- rooms and empty sets ------------------------------------------------------------------------


@sets
@maps
def test_the_connection_matrix_is_that_of_scipy(kind: str, *, terrain: bool) -> None:
    """The costs between start and goal, on terrain those of its cells."""
    problems = problem_set(kind, terrain=terrain, movement=Movement(8))
    matrices = ProblemSetDataset(problems, ("connection_matrix",))[:].connection_matrix
    for k in range(COUNT):
        start, goal = (tuple(cells[k].tolist()) for cells in (problems.starts, problems.goals))
        costs = None if problems.terrain is None else problems.terrain[k]
        (to_goal,) = scipy_distances(problems.grids[k], [goal], Movement(8), costs)
        expected = [[0, to_goal[start]], [to_goal[start], 0]]
        np.testing.assert_allclose(matrices[k], expected, rtol=1e-6)


@maps
def test_an_empty_set_has_empty_fields(tmp_path: Path, *, terrain: bool) -> None:
    """Of the shapes and dtypes of others; what cannot be without a problem says so."""
    problems = problem_set("own maps", terrain=terrain)
    empty = through_a_file(problems[[]], tmp_path)
    for options in ({}, {"augment": True}, {"search": "bfs"}):
        fields, others = (all_fields(s, **options) for s in (empty, problems))
        for name in fields._fields:
            field, other = getattr(fields, name), getattr(others, name)
            assert (field.shape, field.dtype) == ((0, *other.shape[1:]), other.dtype)
    assert ProblemSetDataset(empty).info.problem_counts == {"all": 0}
    assert (len(empty[:]), empty.map_count, empty.hardness.shape) == (0, 0, (0,))
    assert empty.content_hash == problems[[]].content_hash
    dataset = ProblemSetDataset(empty)
    with pytest.raises(ValueError, match="problems: got none, expected at least one"):
        evaluate(classical(MOVEMENT), empty)
    with pytest.raises(ValueError, match="problems: got none, expected at least one"):
        score_paths(empty, [])
    with pytest.raises(IndexError, match="index 0 is out of range for 0 problems"):
        dataset.plot()
    with pytest.raises(ValueError, match="got a batch without problems"):
        ProblemSetDataset(problems).plot([])
