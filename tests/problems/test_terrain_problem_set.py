"""Sets of problems on terrain: their costs and hardness, files, hashes and memory."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import reference
from helpers.set_files import read_arrays, write_arrays

from mapdata import PRESETS, ProblemSet, Random, Terrain, astar, build, generate
from mapdata.arrays import Bytes
from mapdata.movement import Movement
from mapdata.problems import HARD
from mapdata.search import inflate_terrain

MOVEMENTS = [
    Movement(),
    Movement(8),
    Movement(8, corner_cutting=True),
    Movement(8, corner_cutting=True, diagonal_cost=1),
]
movements = pytest.mark.parametrize("movement", MOVEMENTS, ids=["4", "8", "cutting", "one"])
SMALL = Terrain(map_size=(9, 14))


def test_the_costs_on_terrain_are_those_of_single_searches() -> None:
    """They are the costs of `astar` and of the slow reference, on each map and movement."""
    for movement in MOVEMENTS:
        problems = ProblemSet.sample(SMALL, 3, 6, movement=movement)
        assert problems.terrain is not None
        np.testing.assert_array_equal(problems.grids, problems.terrain == 0)
        for k, (grid, terrain) in enumerate(zip(problems.grids, problems.terrain, strict=True)):
            start, goal = tuple(problems.starts[k].tolist()), tuple(problems.goals[k].tolist())
            truth = reference.reference_astar(
                grid.tolist(), start, goal, movement, terrain=terrain.tolist()
            )
            assert problems.optimal.cost[k] == truth.cost
            assert problems.optimal.iterations[k] == truth.iterations
            assert astar(grid, start, goal, movement, terrain=terrain).cost == truth.cost


@movements
def test_the_problems_on_terrain_are_those_of_the_reference(movement: Movement) -> None:
    """Start and goal, also where conditions on cost, hardness and length demand many draws."""
    conditions = Random(distance=(20, 60), hardness=(1.1, 9), length=(5, 12))
    problems = ProblemSet.sample(SMALL, 7, 10, problems=conditions, movement=movement)
    terrains = generate(SMALL, 7, range(10)).terrain
    assert terrains is not None
    expected = []
    for index, terrain in enumerate(terrains):
        problem = reference.reference_problem(
            (terrain == 0).astype(int).tolist(),
            7,
            index,
            0,
            conditions.bands,
            movement,
            draws=1000,
            terrain=terrain.tolist(),
        )
        if problem is not None:
            expected.append((terrain.tolist(), problem.start, problem.goal))
    assert expected
    assert problems.terrain is not None
    assert [
        (terrain.tolist(), tuple(start.tolist()), tuple(goal.tolist()))
        for terrain, start, goal in zip(
            problems.terrain, problems.starts, problems.goals, strict=True
        )
    ] == expected


def test_terrain_of_ones_changes_nothing() -> None:
    """Costs, paths, expansions and hardness are those of the set without terrain."""
    plain = ProblemSet.sample("dungeon", 77, 20, movement=Movement(8))
    ones = replace(plain, terrain=1 - plain.grids)
    np.testing.assert_array_equal(ones.optimal.cells, plain.optimal.cells)
    np.testing.assert_array_equal(ones.optimal.cost, plain.optimal.cost)
    np.testing.assert_array_equal(ones.optimal.iterations, plain.optimal.iterations)
    np.testing.assert_array_equal(ones.hardness, plain.hardness)


def test_hardness_on_terrain_is_the_cost_over_the_cheapest_empty_map() -> None:
    """By hand: a straight path, one over a hill, and a map whose cheapest cell costs 3."""
    terrain = np.array([[2, 9, 2, 2], [2, 2, 2, 2]], np.uint8)
    terrains = np.stack([terrain, terrain, 2 * terrain - 1])
    starts = np.array([(1, 0), (0, 0), (1, 0)])
    goals = np.array([(1, 3), (0, 2), (1, 2)])
    problems = ProblemSet(terrains == 0, starts, goals, Movement(), terrain=terrains)
    assert problems.optimal.cost.tolist() == [6, 8, 6]
    assert problems.hardness.tolist() == [6 / 6, 8 / 4, 6 / 6]
    assert problems.hard.tolist() == [False, True, False]


def test_nearly_all_problems_on_terrain_are_hard() -> None:
    """So a set is chosen by the cost of its paths and by the number of their cells."""
    conditions = Random(distance=(30, 80), length=(10, None))
    problems = ProblemSet.sample("terrain", 1, 60, problems=conditions, movement=Movement(8))
    assert (problems.hardness >= HARD).mean() > 0.9
    lengths = np.diff(problems.optimal.offsets)
    assert lengths.min() >= 10
    assert problems.optimal.cost.min() >= 30
    assert problems.optimal.cost.max() <= 80
    stopped = ProblemSet.sample("terrain", 1, until_hard=5, movement=Movement(8))
    assert stopped.hard.sum() == 5
    assert stopped.hard[-1]


def test_a_radius_inflates_the_terrain() -> None:
    """Its free cells keep their costs, and the heuristic is that of the cells that remain."""
    generator = replace(SMALL, obstacles=0.02, resolution=1.0)
    problems = ProblemSet.sample(generator, 2, 8, movement=Movement(8), radius=0.7)
    assert problems.terrain is not None
    originals = generate(generator, 2, range(8)).terrain
    assert originals is not None
    inflated = {inflate_terrain(terrain, 0.7).tobytes() for terrain in originals}
    assert {terrain.tobytes() for terrain in problems.terrain} <= inflated
    assert "inflated by" in problems.description
    np.testing.assert_array_equal(problems.grids, problems.terrain == 0)


def test_problems_on_routes_of_terrain_join_seed_points() -> None:
    """Start and goal are consecutive seed points, or any two of them for pairs."""
    maps = generate(SMALL, 4, range(12))
    for source, max_gap in (("route", 1), ("pairs", 4)):
        problems = ProblemSet.sample(SMALL, 4, 12, problems=source, movement=Movement(8))
        assert problems.terrain is not None
        assert maps.terrain is not None
        gaps = set()
        for terrain, start, goal in zip(
            problems.terrain, problems.starts, problems.goals, strict=True
        ):
            (row,) = np.flatnonzero((maps.terrain == terrain).all(axis=(1, 2)))
            points = maps.seed_points[row].tolist()
            gaps.add(points.index(goal.tolist()) - points.index(start.tolist()))
        assert min(gaps) >= 1
        assert max(gaps) <= max_gap


def test_the_problems_of_tiles_lead_from_corner_to_corner() -> None:
    """The task of the Warcraft sets: the upper left and the lower right corner of each map."""
    movement = PRESETS["tiles"].movement
    problems = ProblemSet.sample("tiles", 0, 5, problems="route", movement=movement)
    assert problems.starts.tolist() == [[0, 0]] * 5
    assert problems.goals.tolist() == [[11, 11]] * 5


@pytest.mark.parametrize(("source", "where"), [("route", "map 0"), ("random", "problem 0")])
def test_costs_that_are_too_high_are_refused(source: str, where: str) -> None:
    """Routes are searched as they are drawn, random problems without conditions when all are."""
    long_maze = replace(PRESETS["maze"], map_size=(511, 511))
    generator = Terrain(over=long_maze, costs=(255,))
    with pytest.raises(ValueError, match=f"{where}: terrain: a path costs .*, and costs are"):
        ProblemSet.sample(generator, 0, 1, problems=source, movement=Movement(8))


def small_set() -> ProblemSet:
    """Return three problems on small terrain."""
    terrain = np.array([[1, 9, 3], [2, 0, 4]], np.uint8)
    terrains = np.stack([terrain, np.maximum(terrain, 1), terrain])
    starts = np.array([(0, 0), (0, 0), (1, 0)])
    goals = np.array([(1, 2), (1, 2), (0, 2)])
    return ProblemSet(as_grids(terrains), starts, goals, Movement(8), terrain=terrains)


def as_grids(terrains: Bytes) -> Bytes:
    """Return the grids of terrains."""
    grids: Bytes = (terrains == 0).astype(np.uint8)
    return grids


def test_the_hash_covers_the_terrain() -> None:
    """Another cost is another set; without terrain the hash is the one of before."""
    problems = small_set()
    assert problems.terrain is not None
    golden = "043a7cc8a4f6df6aadb537b295ee6c7f5054f2c2571f15324eec5f0e9323ffa3"
    assert problems.content_hash == golden
    doubled = replace(problems, terrain=2 * problems.terrain)
    plain = replace(problems, terrain=None)
    assert len({problems.content_hash, doubled.content_hash, plain.content_hash}) == 3
    assert replace(problems, description="others").content_hash == golden


def test_sampled_sets_on_terrain_have_golden_hashes() -> None:
    """Sets that planners are compared on stay the same in all later versions."""
    tiles = ProblemSet.sample("tiles", 0, 20, problems="route", movement=PRESETS["tiles"].movement)
    golden = "07e5f016997f3a5e3195f54b29c218eb24b1bde8481e2445cd612eaf70301fff"
    assert tiles.content_hash == golden
    conditions = Random(distance=(20, 150), length=(10, None))
    random = ProblemSet.sample("terrain", 0, 20, problems=conditions, movement=Movement(8))
    golden = "f44c2ed71dca6f7d320d9f27898c45ecd9b346cda51f6067333cf9fb19a51a8f"
    assert random.content_hash == golden


def test_a_saved_set_keeps_its_terrain(tmp_path: Path) -> None:
    """The file holds the terrain in place of the grids, which an older version does not read."""
    problems = small_set()
    path = tmp_path / "set.npz"
    problems.save(path)
    with np.load(path) as file:
        assert set(file) == {"about_format_2", "terrain", "starts", "goals", "map_indices"}
        assert len(file["terrain"]) == 2  # two of the three problems share a map
    loaded = ProblemSet.load(path)
    assert loaded.content_hash == problems.content_hash
    np.testing.assert_array_equal(loaded.terrain, problems.terrain)
    np.testing.assert_array_equal(loaded.grids, problems.grids)
    again = tmp_path / "again.npz"
    loaded.save(again)
    assert again.read_bytes() == path.read_bytes()


@pytest.mark.parametrize(
    ("terrain", "reason"),
    [
        (np.full((2, 2, 3), 300), "terrain: got the value 300"),
        (np.full((2, 2, 3), 0.5), "terrain: got dtype float64"),
        (np.ones((3, 2, 3), np.uint8), "map_indices holds 2 different numbers, expected 3"),
        (np.ones((2, 6), np.uint8), "have shapes"),
        (np.ones((2, 2, 3), np.uint8), "two of its maps are equal"),
        (np.arange(12).reshape(2, 2, 3), "start: .* is on an occupied cell"),
    ],
)
def test_a_file_of_bad_terrain_is_refused(terrain: Bytes, reason: str, tmp_path: Path) -> None:
    """By the name of the file."""
    path = tmp_path / "set.npz"
    small_set().save(path)
    write_arrays(path, read_arrays(path) | {"terrain": terrain})
    with pytest.raises(ValueError, match=rf"set\.npz: holds no saved problems \(.*{reason}"):
        ProblemSet.load(path)


def test_a_file_of_terrain_may_unpack_to_as_much_as_one_of_grids(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """64 MiB or 200 times the file; a set that is larger is saved uncompressed."""
    monkeypatch.setattr("mapdata.problems.set_file._MAX_UNPACKED", 2**16)
    terrain = np.full((50, 120, 120), 3, np.uint8)
    terrain[:, 0, 119] += np.arange(50, dtype=np.uint8)  # different maps
    starts = np.stack([np.arange(50), np.zeros(50, np.int64)], axis=1)
    problems = ProblemSet(as_grids(terrain), starts, starts + 5, Movement(), terrain=terrain)
    path = tmp_path / "set.npz"
    problems.save(path)
    assert ProblemSet.load(path).content_hash == problems.content_hash
    write_arrays(path, read_arrays(path), compress=True)
    with pytest.raises(ValueError, match="unpack to 721600 bytes, expected at most"):
        ProblemSet.load(path)


def test_terrain_that_does_not_fit_the_grids_is_refused() -> None:
    """Another shape, other obstacles, and other numbers."""
    problems = small_set()
    terrain = problems.terrain
    assert terrain is not None
    with pytest.raises(ValueError, match=r"terrain: got shape \(2, 3\), expected \(3, 2, 3\)"):
        replace(problems, terrain=terrain[0])
    with pytest.raises(ValueError, match=r"terrain: got 1 at .*, which is occupied in the grid"):
        replace(problems, terrain=np.maximum(terrain, 1))
    with pytest.raises(ValueError, match="terrain: got the value 265"):
        replace(problems, terrain=terrain.astype(int) + 256 * (terrain == 9))


def test_terrain_is_copied_and_cannot_be_written_to() -> None:
    """Neither by the caller nor by a planner; other integers become uint8."""
    terrain = np.full((1, 2, 3), 5)
    problems = ProblemSet(
        np.zeros((1, 2, 3), np.uint8),
        np.array([[0, 0]]),
        np.array([[1, 2]]),
        Movement(),
        terrain=terrain,
    )
    terrain[:] = 7
    assert problems.terrain is not None
    assert problems.terrain.dtype == np.uint8
    assert (problems.terrain == 5).all()
    with pytest.raises(ValueError, match="read-only"):
        problems.terrain[:] = 1


def test_terrain_that_all_problems_share_is_kept_once() -> None:
    """In memory and in a pickle; also where the problems share the grid alone."""
    terrain = np.full((60, 80), 4, np.uint8)
    count = 50
    shared = np.broadcast_to(terrain, (count, 60, 80))
    grids = np.broadcast_to(np.zeros((60, 80), np.uint8), shared.shape)
    starts = np.stack([np.arange(count), np.zeros(count, np.int64)], axis=1)
    problems = ProblemSet(grids, starts, starts + 5, Movement(), terrain=shared)
    assert problems.terrain is not None
    assert problems.terrain.strides[0] == 0
    assert problems.map_count == 1
    assert problems.hardness.tolist() == [1] * count
    image = pickle.dumps(problems)
    assert len(image) < 5 * terrain.size
    copy = pickle.loads(image)
    assert copy.terrain.strides[0] == 0
    assert copy.content_hash == problems.content_hash
    with pytest.raises(ValueError, match="read-only"):
        copy.terrain[:] = 1
    different = shared + np.arange(count, dtype=np.uint8)[:, None, None]
    mixed = replace(problems, terrain=different)
    assert mixed.map_count == count
    assert mixed.optimal.cost.tolist() == [10 * (4 + k) for k in range(count)]
    assert pickle.loads(pickle.dumps(mixed)).content_hash == mixed.content_hash


def test_a_stored_dataset_gives_the_problems_of_its_generator(tmp_path: Path) -> None:
    """On the maps of its test split, with their terrain and seed points."""
    build(tmp_path, SMALL, maps=90, seed=9, shard_size=40, workers=1)
    for source in ("route", Random(distance=(20, None), length=(6, None))):
        expected = ProblemSet.sample(SMALL, 9, 90, problems=source, movement=Movement(8))
        stored = ProblemSet.read(tmp_path, problems=source, movement=Movement(8))
        assert 3 < len(stored) < len(expected)
        assert stored.terrain is not None
        assert expected.terrain is not None
        of_generator = {
            (terrain.tobytes(), *start.tolist(), *goal.tolist())
            for terrain, start, goal in zip(
                expected.terrain, expected.starts, expected.goals, strict=True
            )
        }
        for terrain, start, goal in zip(stored.terrain, stored.starts, stored.goals, strict=True):
            assert (terrain.tobytes(), *start.tolist(), *goal.tolist()) in of_generator
        np.testing.assert_array_equal(stored.grids, stored.terrain == 0)
