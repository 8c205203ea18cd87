"""A robot of a radius: every field is that of the map inflated by hand and solved anew."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from functools import cache
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from helpers import reference, samples
from helpers.examples import Some, slow
from helpers.grids import squared_half_cells
from helpers.reference import Cell
from helpers.specs import MOVEMENTS
from torch.utils.data import DataLoader

from mapdata import (
    MapDataModule,
    MapDataset,
    MapGenerator,
    Movement,
    OnlineMapDataset,
    Pairs,
    ProblemSet,
    Random,
    Route,
    Sample,
    astar,
    bfs,
    clearance,
    distance_field,
    generate,
)
from mapdata.search import SearchResult

Array = npt.NDArray[Any]

SPECS: dict[str, MapGenerator] = {
    "square": samples.SPEC,
    "wide": samples.WIDE,
    "rough": samples.ROUGH,
}

INFLATED_FIELDS = tuple(name for name in samples.ALL_FIELDS if name not in ("waypoints", "image"))
"""The fields of the inflated map. Waypoints keep the radius from the map that is not inflated, and
images show that map: tests/datasets/test_waypoints.py and test_tiles.py.
"""

RADII = ("0.05", "0.1", "0.15")
"""Metres on cells of 0.1 m: no cell, those beside obstacles, a corridor of three cells is left."""

MAPS = 40
SEED = 5
RESOLUTION = "0.1"
"""Metres a cell of all specs."""

SEARCHES = {"bfs": bfs, "astar": astar}
PROBLEM = 1
"""The stream of what is sampled, as docs/format.md numbers it."""


@pytest.fixture(scope="module")
def roots(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Datasets of 40 maps in three shards."""
    folder = tmp_path_factory.mktemp("radius")
    return {
        name: samples.build_small(folder / name, generator, maps=MAPS, seed=SEED)
        for name, generator in SPECS.items()
    }


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A dataset with enough maps that a robot has a batch of routes on the validation split."""
    folder = tmp_path_factory.mktemp("many")
    return samples.build_small(folder, maps=200, seed=SEED, shard_size=100)


@cache
def inflated(name: str, index: int, radius: str) -> Array:
    """Return a map on which a robot moves: each free cell is compared with every obstacle."""
    grid = generate(SPECS[name], SEED, [index]).occupancy[0]
    half_cells = 2 * Fraction(radius) / Fraction(RESOLUTION)
    too_near = squared_half_cells(grid) < math.ceil(half_cells**2)
    return np.where(too_near, 1, grid).astype(np.uint8)


def inflated_terrain(name: str, index: int, radius: str) -> Array | None:
    """Return the terrain of that map; None if it has none."""
    terrain = generate(SPECS[name], SEED, [index]).terrain
    return None if terrain is None else np.where(inflated(name, index, radius), 0, terrain[0])


@cache
def seed_points_of(name: str) -> list[list[Cell]]:
    """Return the seed points of each map, without padding."""
    maps = generate(SPECS[name], SEED, range(MAPS))
    return [
        [(row, column) for row, column in points[:rooms].tolist()]
        for points, rooms in zip(maps.seed_points, maps.rooms, strict=True)
    ]


def number_of(sample: Sample, name: str) -> int:
    """Return which map of a dataset a sample is of, by its seed points."""
    return seed_points_of(name).index(samples.cells_of(sample.seed_points))


def ends_of(sample: Sample) -> tuple[Cell, Cell]:
    """Return start and goal of a sample."""
    return samples.cell_of(sample.start), samples.cell_of(sample.goal)


def costs_to(grid: Array, cell: Cell, movement: Movement, terrain: Array | None = None) -> Array:
    """Return the cost from every cell to one, -1 where there is no way, or no room for the goal."""
    if grid[cell]:
        return np.full(grid.shape, -1, np.float32)
    return distance_field(grid, cell, movement, terrain=terrain)


def solved(
    grid: Array,
    start: Cell,
    goal: Cell,
    search: str,
    movement: Movement,
    terrain: Array | None = None,
) -> SearchResult:
    """Return what a search finds; an end where the robot has no room is none for it."""
    if grid[start] or grid[goal]:
        return SearchResult(np.empty((0, 2), np.int64), -1.0, 0)
    return SEARCHES[search](grid, start, goal, movement, terrain=terrain)


def moves_to_goal(grid: Array, goal: Cell, movement: Movement, terrain: Array | None) -> Array:
    """Return, per cell, the bits of the moves that begin a shortest path."""
    if grid[goal]:
        return np.zeros(grid.shape, np.uint8)
    costs = None if terrain is None else terrain.tolist()
    return reference.reference_moves(grid.tolist(), goal, movement, costs)


def probabilities(
    path: Array, costs: Array, grid: Array, movement: Movement, terrain: Array | None
) -> Array:
    """Return TransPath's map of a path: L / (d(start, n) + d(n, goal) + d(n, path))."""
    if len(path) == 0:
        return np.zeros(grid.shape)
    fields = [costs_to(grid, tuple(cell), movement, terrain) for cell in path]
    through = fields[0] + costs + np.min(fields, axis=0)
    ratio = np.where(through > 0, costs[tuple(path[0])] / np.maximum(through, 1e-9), 1.0)
    return np.where((costs >= 0) & (ratio >= 0.95), ratio, 0)


def mask_of(cells: Any, like: Array) -> Array:
    """Return a mask that is 1 at these cells, as large as a map."""
    mask = np.zeros_like(like)
    for row, column in np.asarray(cells).tolist():
        mask[row, column] = 1
    return mask


def connections(
    points: list[Cell],
    grid: Array,
    search: str,
    movement: Movement,
    size: int,
    terrain: Array | None,
) -> Array:
    """Return the costs between all seed points, -1 without a path and -2 as padding."""
    matrix = np.full((size, size), -2.0)
    for i, one in enumerate(points):
        for j, other in enumerate(points):
            matrix[i, j] = solved(grid, one, other, search, movement, terrain).cost
        matrix[i, i] = 0
    return matrix


def assert_true(
    sample: Sample, grid: Array, search: str, movement: Movement, terrain: Array | None = None
) -> None:
    """Compare every field with what public functions find on ``grid`` and its terrain."""
    start, goal = ends_of(sample)
    points = samples.cells_of(sample.seed_points)
    found = solved(grid, start, goal, search, movement, terrain)
    best_path, best, _ = solved(grid, start, goal, "astar", movement, terrain)
    solvable = best >= 0
    costs = costs_to(grid, goal, movement, terrain)
    around_start = costs_to(grid, start, movement, terrain)
    min_cost = 1 if terrain is None else terrain[terrain > 0].min(initial=255)
    on_empty = min_cost * distance_field(np.zeros_like(grid), goal, movement)
    on_best = (costs >= 0) & np.isclose(around_start + costs, best)
    ratio = np.where(costs > 0, on_empty / np.maximum(costs, 1), costs == 0)
    size = len(sample.connection_matrix)
    layers = {
        "map": grid,
        "free": 1 - grid,
        "terrain": 1 - grid if terrain is None else terrain,
        "path_mask": mask_of(found.path, grid),
        "start_mask": mask_of([start], grid),
        "goal_mask": mask_of([goal], grid),
        "optimal_mask": on_best & solvable,
        "cost_to_go": costs,
        "optimal_moves": moves_to_goal(grid, goal, movement, terrain),
        "heuristic_ratio": ratio,
        "path_probability": probabilities(best_path, costs, grid, movement, terrain),
        "clearance": clearance(grid),
    }
    picture = np.repeat(255 * (1 - grid[None].astype(int)), 3, axis=0)
    picture[(slice(None), *goal)] = (0, 255, 0)
    picture[(slice(None), *start)] = (255, 0, 0)
    numbers = {
        "maze_image": picture,
        "length": len(found.path),
        "cost": found.cost,
        "hardness": best / on_empty[start] if solvable else -1,
        "iterations": found.iterations,
        "connection_matrix": connections(points, grid, search, movement, size, terrain),
    }
    assert samples.cells_of(sample.path) == [tuple(cell) for cell in found.path.tolist()]
    expected = {name: layer[None] for name, layer in layers.items()} | numbers
    for name, truth in expected.items():
        value = np.asarray(getattr(sample, name), float)
        assert value.shape == np.shape(truth), name
        np.testing.assert_allclose(value, truth, rtol=1e-5, err_msg=name)
    assert sample.symmetry == 0
    others = {"start", "goal", "path", "seed_points", "problem", "map_index", "symmetry"}
    assert {*expected, *others} == {*INFLATED_FIELDS}


CASES: list[tuple[str, str, str, Movement | None]] = [
    *(("square", radius, "astar", None) for radius in RADII),
    *(("wide", "0.1", search, None) for search in SEARCHES),
    *(("square", "0.1", "bfs", movement) for movement in MOVEMENTS),
    *(("rough", "0.1", search, None) for search in SEARCHES),
]
"""Maps, radius, search and movement, for each way of being solved anew."""

QUICK_CASES = (CASES[3], CASES[-3], CASES[-1])
"""One of each kind: another search, another movement, and terrain."""


@pytest.mark.parametrize("problems", [Route, Pairs])
@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=() if case in QUICK_CASES else pytest.mark.slow, id=str(case))
        for case in CASES
    ],
)
def test_stored_problems_are_solved_anew(
    some: Some,
    roots: dict[str, str],
    case: tuple[str, str, str, Movement | None],
    problems: type[Route | Pairs],
) -> None:
    """Problems without a path are kept under `unsolvable`, else left out; all fields agree."""
    name, radius, search, movement = case
    how: dict[str, Any] = {
        "search": search,
        "movement": movement,
        "fields": INFLATED_FIELDS,
    }
    with_unsolvable = problems(unsolvable=True)
    plain = MapDataset(roots[name], problems=with_unsolvable, **how)
    every = MapDataset(roots[name], problems=with_unsolvable, radius=float(radius), **how)
    solvable = MapDataset(roots[name], problems=problems(), radius=float(radius), **how)
    assert len(every) == len(plain)
    batch = every[:]
    has_path = batch.length > 0
    assert len(solvable) == has_path.sum()
    for attribute in ("map", "start", "goal", "path", "cost_to_go", "connection_matrix"):
        kept = getattr(batch, attribute)[has_path]
        assert getattr(solvable[:], attribute).equal(kept), attribute
    if radius != "0.05":
        no_room = 0
        for one in every:
            start, goal = ends_of(one)
            no_room += bool(one.map[0][start] or one.map[0][goal])
        assert 5 < len(solvable) < len(every)
        assert 5 < no_room < len(every) - len(solvable)
    for k in range(0, len(every), len(every) // some(24)):
        for attribute in ("start", "goal", "seed_points"):
            assert getattr(every[k], attribute).equal(getattr(plain[k], attribute))
        number = number_of(plain[k], name)
        grid = inflated(name, number, radius)
        terrain = inflated_terrain(name, number, radius)
        assert_true(every[k], grid, search, every.movement, terrain)


@pytest.mark.parametrize("movement", [slow(Movement()), Movement(8)], ids=["4", "8"])
@pytest.mark.parametrize("online", [slow(False), True])
def test_random_problems_are_sampled_on_the_inflated_map(
    some: Some, roots: dict[str, str], online: bool, movement: Movement
) -> None:
    """Those of the reference there, on the next map where it has none; the same as `ProblemSet`."""
    problems = Random(distance=(4, None))
    how: dict[str, Any] = {"problems": problems, "movement": movement, "radius": 0.1}
    served: dict[str, Any] = {**how, "sampling_seed": SEED, "fields": INFLATED_FIELDS}
    dataset: MapDataset | OnlineMapDataset
    if online:
        dataset = OnlineMapDataset(samples.SPEC, SEED, MAPS, **served)
    else:
        dataset = MapDataset(roots["square"], **served)
    maps = []
    for k in range(len(dataset)):
        grid = inflated("square", k, "0.1")
        truth = reference.reference_problem(grid.tolist(), SEED, k, 0, problems.bands, movement)
        if truth is None:
            assert not np.array_equal(dataset[k].map[0], grid)
            continue
        maps.append(k)
        assert ends_of(dataset[k]) == (truth.start, truth.goal)
        if k % (MAPS // some(8)) == 0:
            assert_true(dataset[k], grid, "astar", movement)
    assert MAPS / 2 < len(maps) < MAPS

    batch = dataset[maps]
    sampled = ProblemSet.sample(samples.SPEC, SEED, MAPS, **how)
    assert sampled.description.endswith(", inflated by 1 cells")
    assert_problems_are(sampled, batch)
    in_test = [reference.reference_split(samples.SPEC, SEED, k) == 2 for k in maps]
    assert any(in_test)
    read = ProblemSet.read(roots["square"], seed=SEED, **how)
    assert_problems_are(read, dataset[[k for k, test in zip(maps, in_test, strict=True) if test]])


def assert_problems_are(problems: ProblemSet, batch: Sample) -> None:
    """Compare a set of problems with what a dataset serves."""
    np.testing.assert_array_equal(problems.grids, batch.map[:, 0])
    np.testing.assert_array_equal(problems.starts, batch.start)
    np.testing.assert_array_equal(problems.goals, batch.goal)


@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize("problems", [Route(), Pairs(), Route(True), Pairs(True)], ids=str)
def test_online_pairs_are_the_first_that_fit(problems: Route | Pairs, search: str) -> None:
    """Pairs of seed points in turn, from a drawn one on, until one has a path for the robot; a map
    where none has gives way to another.
    """
    movement = Movement(8)
    sampling_seed = 9
    dataset = OnlineMapDataset(
        samples.SPEC,
        SEED,
        MAPS,
        None,
        INFLATED_FIELDS,
        problems=problems,
        search=search,
        movement=movement,
        sampling_seed=sampling_seed,
        radius=0.1,
    )

    def fits(grid: Array, start: Cell, goal: Cell) -> bool:
        if start == goal:
            return False
        return problems.unsolvable or solved(grid, start, goal, search, movement).cost > 0

    served = 0
    for k, points in enumerate(seed_points_of("square")):
        grid = inflated("square", k, "0.1")
        pairs = list(pairwise(points) if isinstance(problems, Route) else combinations(points, 2))
        word = reference.block(sampling_seed, k, 0, PROBLEM, 0)[0]
        first = reference.bounded(word, 0, len(pairs) - 1)
        in_turn = pairs[first:] + pairs[:first]
        fitting = [pair for pair in in_turn if fits(grid, *pair)]
        sample = dataset[k]
        if not fitting:
            assert samples.cells_of(sample.seed_points) != points
            continue
        served += 1
        assert ends_of(sample) == fitting[0]
        if served % 3 == 1:
            assert_true(sample, grid, search, movement)
    if problems.unsolvable:
        assert served > MAPS / 2
    else:
        assert 5 < served < MAPS


@pytest.mark.parametrize("problems", [slow("route"), "pairs", slow("random")])
def test_workers_and_modules_serve_the_same(many: str, problems: str) -> None:
    """By workers, after pickling, filtered, by a data module, on disk and online."""
    how: dict[str, Any] = {"problems": problems, "radius": 0.1, "fields": INFLATED_FIELDS}
    dataset = MapDataset(many, "val", **how)
    assert len(dataset) > 8  # more than a batch
    batches = [dataset[k : k + 8] for k in range(0, len(dataset), 8)]
    by_workers = DataLoader(dataset, 8, num_workers=2)
    samples.assert_all_same(list(by_workers), batches)
    pickled = pickle.loads(pickle.dumps(dataset))
    samples.assert_same(pickled[:], dataset[:])
    module = MapDataModule(many, batch_size=8, **how)
    assert module.hparams["radius"] == 0.1
    samples.assert_all_same(list(module.val_dataloader()), batches)
    if problems != "random":  # those are not stored, and not filtered
        lengths = dataset[:].length
        all_pass = dataset.filter(path_length=(2, 999))
        samples.assert_same(all_pass[:], dataset[:])
        most = int(lengths.median())
        short = dataset.filter(path_length=(2, most))
        assert 0 < len(short) < len(dataset)
        samples.assert_same(short[:], dataset[np.flatnonzero(lengths <= most)])

    online = OnlineMapDataset(samples.SPEC, SEED, 12, "train", augment=True, **how)
    recipe = {"spec": samples.SPEC.to_dict(), "seed": SEED, "maps": 20}
    online_module = MapDataModule(None, build=recipe, batch_size=12, augment=True, **how)
    (first,) = online_module.train_dataloader()
    samples.assert_same(first, online[first.problem])


def test_the_radius_is_in_metres(tmp_path: Path) -> None:
    """0.15 m at 0.1 m a cell and 0.3 m at 0.2 m are 1.5 cells; roots must agree on it."""
    fine = samples.build_small(tmp_path / "fine", maps=9)
    coarse_spec = replace(samples.SPEC, resolution=0.2)
    coarse = samples.build_small(tmp_path / "coarse", coarse_spec, maps=9)
    robot = MapDataset(coarse, problems="random", radius=0.3)
    same_robot = MapDataset(fine, problems="random", radius=0.15)
    wider_robot = MapDataset(fine, problems="random", radius=0.1501)
    assert robot[:].map.equal(same_robot[:].map)
    assert not robot[:].map.equal(wider_robot[:].map)
    assert ", radius=0.3)" in repr(robot)
    assert "radius=" not in repr(MapDataset(fine))

    both = [fine, coarse]
    without_radius = MapDataset(both, problems="random")
    assert len(without_radius) == 18
    with pytest.raises(ValueError, match=r"have resolutions 0\.. and 0\..; take those of one"):
        MapDataset(both, radius=0.1)


DOORS: dict[str, Callable[[str, Any], object]] = {
    "stored": lambda root, radius: MapDataset(root, radius=radius),
    "online": lambda root, radius: OnlineMapDataset(samples.SPEC, radius=radius),
    "module": lambda root, radius: MapDataModule(root, radius=radius),
    "sample": lambda root, radius: ProblemSet.sample(
        samples.SPEC, 0, 5, radius=radius, movement=Movement(8)
    ),
    "read": lambda root, radius: ProblemSet.read(root, radius=radius, movement=Movement(8)),
}
"""All that take a radius."""


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("radius", [-0.1, float("nan"), float("inf"), "wide", True])
def test_a_bad_radius_is_named(roots: dict[str, str], radius: Any, door: str) -> None:
    """With its value."""
    with pytest.raises(ValueError, match=f"radius: got {radius!r}"):
        DOORS[door](roots["square"], radius)


def test_a_robot_that_fits_nowhere(roots: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Problems with a path are none, which the messages say, and unsolvable ones have no path."""
    monkeypatch.setattr("mapdata.problems.substitutes.MAX_CELLS", 10**5)
    root = roots["square"]
    message = (
        r"radius: got 5 m, with which none of the \d+ problems of .* has a path; take a smaller"
    )
    for split in (None, "val"):
        with pytest.raises(ValueError, match=message):
            MapDataset(root, split, radius=5)
    with pytest.raises(ValueError, match=message):
        MapDataModule(root, radius=5).train_dataloader()
    every = MapDataset(root, problems=Pairs(True), radius=5, fields=INFLATED_FIELDS)[:]
    assert (every.map == 1).all()
    assert (every.cost == -1).all()
    assert (every.hardness == -1).all()
    assert (every.cost_to_go == -1).all()
    assert (every.path == samples.PADDING).all()
    assert (every.length == 0).all()
    assert (every.iterations == 0).all()
    assert (every.optimal_moves == 0).all()
    assert (every.optimal_mask == 0).all()
    wider = "take wider conditions, or a smaller radius than 5 m"
    for dataset, remedy in (
        (MapDataset(root, problems="random", radius=5), wider),
        (OnlineMapDataset(samples.SPEC, problems="random", radius=5), wider),
        (OnlineMapDataset(samples.SPEC, radius=5), "take other maps, or a smaller radius than 5 m"),
    ):
        with pytest.raises(ValueError, match=f"none on one map after another; .* {remedy}"):
            dataset[0]
    with pytest.raises(ValueError, match=f"none on one map after another; 5 maps .* {wider}"):
        ProblemSet.sample(samples.SPEC, 0, 5, radius=5, movement=Movement(8))


def test_without_a_radius_no_map_is_inflated(
    roots: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernel that would change nothing is never called, and so never compiled."""

    def refuse(*_: object) -> None:
        raise AssertionError("a map was inflated")

    for module in ("datasets.stored_arrays", "search.map_stack"):
        monkeypatch.setattr(f"mapdata.{module}.inflate_all", refuse)
    for radius in (0.0, 0.05):  # any free cell has room for half a cell of 0.1 m
        assert MapDataset(roots["square"], radius=radius)[:].map.any()
        assert OnlineMapDataset(samples.SPEC, SEED, 3, radius=radius)[:].map.any()
        assert (
            len(
                ProblemSet.sample(
                    samples.SPEC, SEED, 3, problems=Random(), radius=radius, movement=Movement(8)
                )
            )
            == 3
        )
    with pytest.raises(AssertionError, match="inflated"):
        MapDataset(roots["square"], problems="random", radius=0.1)[:]
