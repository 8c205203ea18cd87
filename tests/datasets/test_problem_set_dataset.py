"""`ProblemSetDataset`: a set of problems as torch samples, compared with the set and with scipy."""

from __future__ import annotations

import pickle
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from helpers import samples
from helpers.grids import scipy_distances
from torch.utils.data import DataLoader

from mapdata import (
    Movement,
    ProblemSet,
    ProblemSetDataset,
    Sample,
    apply_symmetry,
    search_batch,
)
from mapdata.arrays import Bytes
from mapdata.datasets import DatasetInfo, EpochSampler, FieldInfo
from mapdata.datasets.arguments import FieldFunction
from mapdata.formats import read_problems

MOVEMENTS = [Movement(4), Movement(8), Movement(8, corner_cutting=True, diagonal_cost=1)]
SHAPE = (14, 19)
on_any_map = pytest.mark.parametrize("terrain", [False, True], ids=["uniform", "terrain"])


@cache
def problem_set(movement: Movement, count: int = 40, *, terrain: bool = False) -> ProblemSet:
    """Return solvable problems on maps of scattered walls, whose ends scipy connects."""
    random = np.random.default_rng(count)
    grids: list[Bytes] = []
    starts: list[list[int]] = []
    goals: list[list[int]] = []
    while len(grids) < count:
        grid = (random.random(SHAPE) < 0.3).astype(np.uint8)
        start, goal = random.choice(np.argwhere(grid == 0), 2, replace=False).tolist()
        if scipy_distances(grid, [tuple(start)], movement)[0][tuple(goal)] > 0:
            grids.append(grid)
            starts.append(start)
            goals.append(goal)
    costs = np.where(grids, 0, random.choice([2, 3, 8, 91], np.shape(grids))).astype(np.uint8)
    return ProblemSet(
        np.stack(grids),
        np.array(starts),
        np.array(goals),
        movement,
        terrain=costs if terrain else None,
    )


def shared_set(count: int, side: int = 64) -> ProblemSet:
    """Return problems that share a single empty map."""
    grids = np.broadcast_to(np.zeros((side, side), np.uint8), (count, side, side))
    cells = np.stack(np.divmod(np.arange(count), side), axis=1)
    return ProblemSet(grids, cells, side - 1 - cells, Movement(8))


def half(sample: Sample) -> torch.Tensor:
    """Return a field of one's own."""
    halved: torch.Tensor = sample.cost / 2
    return halved


@on_any_map
@pytest.mark.parametrize("movement", MOVEMENTS, ids=str)
def test_samples_are_the_problems_of_the_set(movement: Movement, terrain: bool) -> None:
    """Sample i has map, start, goal, path, cost and expansions of problem i, in any order."""
    problems = problem_set(movement, terrain=terrain)
    costs = 1 - problems.grids if problems.terrain is None else problems.terrain
    fields = (
        "map",
        "terrain",
        "start",
        "goal",
        "path",
        "length",
        "cost",
        "hardness",
        "iterations",
        "problem",
    )
    dataset = ProblemSetDataset(problems, fields)
    assert len(dataset) == len(problems) == 40
    optimal = problems.optimal
    for i in (0, 7, 39, -1):
        number = i % 40
        sample = dataset[i]
        assert np.array_equal(sample.map[0], problems.grids[i])
        assert np.array_equal(sample.terrain[0], costs[i])
        assert np.array_equal(sample.start, problems.starts[i])
        assert np.array_equal(sample.goal, problems.goals[i])
        first, end = optimal.offsets[number : number + 2]
        assert np.array_equal(sample.path, optimal.cells[first:end])
        assert sample.length == end - first
        assert sample.cost == np.float32(optimal.cost[i])
        assert sample.hardness == np.float32(problems.hardness[i])
        assert sample.iterations == optimal.iterations[i]
        assert sample.problem == number
    for order in (slice(3, 30, 2), [5, 39, 5, 0], torch.tensor([8, 2])):
        numbers = np.arange(40)[order]
        batch = dataset[order]
        assert batch.problem.tolist() == numbers.tolist()
        assert np.array_equal(batch.map[:, 0], problems.grids[numbers])
        assert np.array_equal(batch.cost, optimal.cost[numbers].astype(np.float32))
        assert np.array_equal(batch.length, np.diff(optimal.offsets)[numbers])
        for row, number in enumerate(numbers):
            path = dataset[int(number)].path
            assert samples.cells_of(batch.path[row]) == samples.cells_of(path)


@on_any_map
@pytest.mark.parametrize("movement", MOVEMENTS, ids=str)
def test_costs_are_those_of_scipy(movement: Movement, terrain: bool) -> None:
    """The costs of the paths, of all cells to the goal, and between the two seed points."""
    problems = problem_set(movement, terrain=terrain)
    fields = ("cost", "cost_to_go", "seed_points", "connection_matrix", "optimal_mask")
    batch = ProblemSetDataset(problems, fields)[:]
    for k in range(len(problems)):
        start = tuple(problems.starts[k].tolist())
        goal = tuple(problems.goals[k].tolist())
        costs = None if problems.terrain is None else problems.terrain[k]
        from_start, to_goal = scipy_distances(problems.grids[k], [start, goal], movement, costs)
        assert float(batch.cost[k]) == pytest.approx(to_goal[start], rel=1e-6)
        np.testing.assert_allclose(batch.cost_to_go[k, 0], to_goal, rtol=1e-6)
        on_shortest_path = abs(from_start + to_goal - to_goal[start]) < 1e-6
        assert np.array_equal(batch.optimal_mask[k, 0].bool(), on_shortest_path & (to_goal >= 0))
        assert batch.seed_points[k].tolist() == [list(start), list(goal)]
        expected = [[0, to_goal[start]], [to_goal[start], 0]]
        np.testing.assert_allclose(batch.connection_matrix[k], expected, rtol=1e-6)


@on_any_map
@pytest.mark.parametrize("movement", MOVEMENTS, ids=str)
def test_bfs_is_searched_on_the_fly(movement: Movement, terrain: bool) -> None:
    """Paths, moves and expansions are those of `search_batch`, whatever cells cost."""
    problems = problem_set(movement, terrain=terrain)
    batch = ProblemSetDataset(problems, ("path", "iterations", "cost"), search="bfs")[:]
    solved = search_batch("bfs", problems.grids, problems.starts, problems.goals, movement)
    assert np.array_equal(batch.iterations, solved.iterations)
    assert np.array_equal(batch.cost, np.diff(solved.offsets) - 1)
    for k, path in enumerate(np.split(solved.cells, solved.offsets[1:-1])):
        assert np.array_equal(samples.cells_of(batch.path[k]), path)


def test_all_fields_and_options_are_those_of_other_datasets() -> None:
    """Types, fixed lengths, functions and transforms work as for maps on disk."""
    problems = problem_set(Movement(8))
    fields: tuple[str | FieldFunction, ...] = (*samples.ALL_FIELDS, half)
    dataset = ProblemSetDataset(problems, fields, dtype="float32", max_length=99)
    batch = dataset[2:7]
    assert batch._fields == (*samples.ALL_FIELDS, "half")
    assert batch.map.dtype == batch.path_mask.dtype == torch.float32
    assert batch.path.shape == (5, 99, 2)
    assert torch.equal(batch.half, batch.cost / 2)
    assert torch.equal(batch.free, 1 - batch.map)
    (halves,) = DataLoader(ProblemSetDataset(problems, ("cost",), transform=half), 40)
    assert np.allclose(halves, problems.optimal.cost / 2)
    with pytest.raises(ValueError, match="does not fit into 2"):
        ProblemSetDataset(problems, max_length=2)[:]
    with pytest.raises(IndexError, match="index 40 is out of range for 40 problems"):
        dataset[40]


def test_augmentation_moves_all_fields_alike() -> None:
    """In each epoch other symmetries are drawn; costs stay, and paths connect start and goal."""
    problems = problem_set(Movement(8))
    fields = ("map", "start", "goal", "path", "cost", "path_mask", "problem", "symmetry")
    plain = ProblemSetDataset(problems, fields)
    dataset = ProblemSetDataset(problems, fields, augment=True, sampling_seed=3)
    changed = []
    for epoch in range(3):
        batch = dataset[np.arange(40) + epoch * 40]
        assert torch.equal(batch.cost, plain[:].cost)
        assert torch.equal(apply_symmetry(plain[:].map, batch.symmetry), batch.map)
        assert batch.problem.tolist() == list(range(40))
        solved = search_batch(
            "astar", batch.map[:, 0].numpy(), batch.start, batch.goal, Movement(8)
        )
        np.testing.assert_allclose(batch.cost, solved.cost, rtol=1e-6)
        for k in range(40):
            path = samples.cells_of(batch.path[k])
            assert list(path[0]) == batch.start[k].tolist()
            assert list(path[-1]) == batch.goal[k].tolist()
            assert batch.path_mask[k, 0].nonzero().tolist() == sorted(map(list, path))
        changed.append((batch.map != plain[:].map).any(dim=(1, 2, 3)))
    assert 20 < sum(changed).count_nonzero() <= 40
    assert not torch.equal(changed[0], changed[1])
    again = ProblemSetDataset(problems, fields, augment=True, sampling_seed=3)
    samples.assert_same(again[np.arange(40) + 80], batch)


def test_map_index_is_the_number_of_the_grid() -> None:
    """That of the problem, or the same one for all problems that share a grid."""
    dataset = ProblemSetDataset(problem_set(Movement(8)), ("problem", "map_index"))
    batch = dataset[[5, 2, 5]]
    assert batch.map_index.tolist() == [5, 2, 5]
    batch.map_index[:] = 0
    assert batch.problem.tolist() == [5, 2, 5]  # another tensor
    shared = ProblemSetDataset(shared_set(4), ("map_index",))
    assert shared[:].map_index.tolist() == [0, 0, 0, 0]


def test_an_epoch_sampler_serves_every_problem_once() -> None:
    """The order is a permutation, another one in each epoch."""
    dataset = ProblemSetDataset(problem_set(Movement(8)), ("problem",))
    loader = DataLoader(dataset, 16, sampler=EpochSampler(dataset, 16, sampling_seed=1))
    epochs = [torch.cat([batch.problem for batch in loader]).tolist() for _ in range(2)]
    assert epochs[0] != epochs[1]
    assert [sorted(numbers) for numbers in epochs] == [list(range(40))] * 2


def test_info_counts_maps_and_problems_of_the_set() -> None:
    """A set has no splits, roots or resolution; problems that share a map count it once."""
    problems = problem_set(Movement(8))
    info = ProblemSetDataset(problems, ("map", "path", "cost")).info
    assert info == DatasetInfo(
        roots=(),
        recipes=(None,),
        identities=(None,),
        content_hashes=(problems.content_hash,),
        map_counts={"all": 40},
        problem_counts={"all": 40},
        map_size=SHAPE,
        resolution=None,
        movement=Movement(8),
        has_terrain=False,
        fields={
            "map": FieldInfo((1, *SHAPE), torch.uint8),
            "path": FieldInfo((None, 2), torch.int64),
            "cost": FieldInfo((), torch.float32),
        },
    )
    assert ProblemSetDataset(shared_set(50)).info.map_counts == {"all": 1}
    grids = problems.grids[[0, 1, 0]]
    repeated = ProblemSet(grids, problems.starts[[0, 1, 0]], problems.goals[[0, 1, 0]], Movement(8))
    assert ProblemSetDataset(repeated).info.map_counts == {"all": 2}


def test_a_set_can_be_drawn_and_printed() -> None:
    """The picture has the problem's map, and the text the description of the set."""
    problems = problem_set(Movement(8))
    dataset = ProblemSetDataset(problems, ("cost",))
    axes = dataset.plot(3)
    assert np.array_equal(np.asarray(axes.images[0].get_array()), problems.grids[3])
    assert "'problems'): 40 problems, map_size=(14, 19), movement=" in repr(dataset)


def test_a_shared_map_is_kept_and_pickled_once() -> None:
    """A thousand problems on one map are far smaller than a thousand maps."""
    problems = shared_set(1000)
    dataset = ProblemSetDataset(problems)
    assert dataset.problem_set.grids is problems.grids
    assert problems.grids.strides[0] == 0
    paths = problems.optimal.cells.nbytes
    pickled = pickle.dumps(dataset)
    assert len(pickled) < 2 * paths < 1000 * 64 * 64
    copied = pickle.loads(pickled)
    assert copied.problem_set.grids.strides[0] == 0
    assert copied.problem_set.content_hash == problems.content_hash
    samples.assert_same(copied[:50], dataset[:50])


@pytest.mark.parametrize("is_shared", [False, True])
def test_a_pickled_set_is_the_same_and_cannot_be_written_to(is_shared: bool) -> None:
    """Its solutions travel with it, so that it is not solved again."""
    problems = shared_set(20) if is_shared else problem_set(Movement(8))
    copied = pickle.loads(pickle.dumps(problems))
    assert copied.content_hash == problems.content_hash
    assert "optimal" in vars(copied)
    assert np.array_equal(copied.optimal.cost, problems.optimal.cost)
    assert (copied.movement, copied.description) == (problems.movement, problems.description)
    for name in ("grids", "starts", "goals"):
        array: npt.NDArray[Any] = getattr(copied, name)
        assert array.shape == getattr(problems, name).shape
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


@pytest.mark.slow
@pytest.mark.parametrize("method", ["fork", pytest.param("spawn", marks=pytest.mark.slow)])
def test_workers_change_nothing(method: str) -> None:
    """Batches of workers are those of the process itself, from own and from shared maps."""
    for problems in (problem_set(Movement(8)), shared_set(30)):
        dataset = ProblemSetDataset(problems, (*samples.ALL_FIELDS, half), augment=True)
        loader = DataLoader(dataset, 16, num_workers=1, multiprocessing_context=method)
        samples.assert_all_same(list(loader), list(DataLoader(dataset, 16)))


def test_a_file_of_problems_is_served(tmp_path: Path) -> None:
    """The problems of a .scen, and of a saved set, reach the network with their own ends."""
    (tmp_path / "hall.map").write_text("type octile\nheight 3\nwidth 4\nmap\n....\n.@@.\n....\n")
    lines = ["0\thall.map\t4\t3\t0\t0\t3\t2\t5", "0\thall.map\t4\t3\t1\t0\t1\t2\t4"]
    (tmp_path / "hall.map.scen").write_text("\n".join(["version 1", *lines, ""]))
    problems = read_problems(tmp_path / "hall.map.scen")
    batch = ProblemSetDataset(problems, ("map", "start", "goal", "cost"))[:]
    assert batch.map[0, 0].tolist() == [[0, 0, 0, 0], [0, 1, 1, 0], [0, 0, 0, 0]]
    assert batch.start.tolist() == [[0, 0], [0, 1]]
    assert batch.goal.tolist() == [[2, 3], [2, 1]]
    assert batch.cost.tolist() == [5, 4]
    problems.save(tmp_path / "saved.npz")
    saved = ProblemSetDataset(
        read_problems(tmp_path / "saved.npz"), ("map", "start", "goal", "cost")
    )
    samples.assert_same(saved[:], batch)


def test_what_is_no_set_of_problems_is_refused() -> None:
    """The message names the function that reads one; options are checked as elsewhere."""
    path: Any = "hall.map.scen"
    with pytest.raises(ValueError, match=r"got 'hall\.map\.scen', expected a ProblemSet; .*read_p"):
        ProblemSetDataset(path)
    with pytest.raises(ValueError, match="fields: got 'maps', expected"):
        ProblemSetDataset(shared_set(2), ("maps",))
    with pytest.raises(ValueError, match="search: got 'dijkstra'"):
        ProblemSetDataset(shared_set(2), search="dijkstra")
