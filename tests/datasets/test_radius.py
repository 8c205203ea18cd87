"""A robot of a radius: every field is that of the map inflated by hand and solved anew."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from helpers import reference, samples
from helpers.grids import squared_half_cells
from helpers.reference import Cell
from helpers.specs import MOVEMENTS
from torch.utils.data import DataLoader

from mapdata import (
    MapDataModule,
    MapDataset,
    Movement,
    OnlineMapDataset,
    Pairs,
    Problems,
    Random,
    Route,
    Sample,
    astar,
    bfs,
    build,
    check_path,
    clearance,
    distance_field,
    generate,
)
from mapdata.search import STEPS, SearchResult

Array = npt.NDArray[Any]

SPECS = {"square": samples.SPEC, "wide": samples.WIDE}
RADII = ("0.05", "0.1", "0.15")
"""Metres on cells of 0.1 m: no cell, those beside obstacles, a corridor of three cells is left."""

MAPS, SEED = 40, 5
SEARCHES = {"bfs": bfs, "astar": astar}
PROBLEM = 1
"""The stream of what is sampled, as docs/format.md numbers it."""


@pytest.fixture(scope="module")
def roots(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Datasets of 40 maps in three shards."""
    folder = tmp_path_factory.mktemp("radius")
    return {
        name: samples.build_small(folder / name, spec, maps=MAPS, seed=SEED)
        for name, spec in SPECS.items()
    }


@cache
def inflated(name: str, index: int, radius: str) -> Array:
    """Return a map on which a robot moves: each free cell is compared with every obstacle."""
    grid = generate(SPECS[name], SEED, [index]).occupancy[0]
    needed = math.ceil((2 * Fraction(radius) / Fraction("0.1")) ** 2)
    return np.where(squared_half_cells(grid) < needed, 1, grid).astype(np.uint8)


def number_of(sample: Sample, name: str) -> int:
    """Return which map of a dataset a sample is of, by its seed points."""
    points = samples.cells_of(sample.seed_points)
    for index, maps in enumerate(generate(SPECS[name], SEED, range(MAPS)).seed_points.tolist()):
        if [tuple(point) for point in maps if point[0] >= 0] == points:
            return index
    raise AssertionError(f"no map with seed points {points}")


def costs_to(grid: Array, cell: Cell, movement: Movement) -> Array:
    """Return the cost from every cell to one, -1 where there is no way, or no room for the goal."""
    if grid[cell]:
        return np.full(grid.shape, -1, np.float32)
    return distance_field(grid, cell, movement)


def solved(grid: Array, start: Cell, goal: Cell, search: str, movement: Movement) -> SearchResult:
    """Return what a search finds; an end where the robot has no room is none for it."""
    if grid[start] or grid[goal]:
        return SearchResult(np.empty((0, 2), np.int64), -1.0, 0)
    return SEARCHES[search](grid, start, goal, movement)


def moves_to_goal(grid: Array, costs: Array, movement: Movement) -> Array:
    """Return, per cell, the bits of the legal moves that lower the cost by their own."""
    bits = np.zeros(grid.shape, np.uint8)
    for row, column in np.argwhere(costs > 0).tolist():
        for bit, (down, right) in enumerate(STEPS[: movement.connectivity].tolist()):
            try:
                step = check_path(grid, [(row, column), (row + down, column + right)], movement)
            except ValueError:
                continue
            if np.isclose(costs[row + down, column + right] + step, costs[row, column]):
                bits[row, column] |= 1 << bit
    return bits


def probabilities(path: Array, costs: Array, grid: Array, movement: Movement) -> Array:
    """Return TransPath's map of a path: L / (d(start, n) + d(n, goal) + d(n, path))."""
    if len(path) == 0:
        return np.zeros(grid.shape)
    fields = [costs_to(grid, tuple(cell), movement) for cell in path]
    through = fields[0] + costs + np.min(fields, axis=0)
    ratio = np.where(through > 0, costs[tuple(path[0])] / np.maximum(through, 1e-9), 1.0)
    return np.where((costs >= 0) & (ratio >= 0.95), ratio, 0)


def assert_true(sample: Sample, grid: Array, search: str, movement: Movement) -> None:
    """Compare every field with what public functions find on ``grid``."""
    start = samples.cell_of(sample.start)
    goal = samples.cell_of(sample.goal)
    found = solved(grid, start, goal, search, movement)
    best = solved(grid, start, goal, "astar", movement).cost
    costs = costs_to(grid, goal, movement)
    around_start = costs_to(grid, start, movement)
    empty = distance_field(np.zeros_like(grid), goal, movement)
    masks: dict[str, Any] = {"path_mask": found.path, "start_mask": [start], "goal_mask": [goal]}
    for name, cells in masks.items():
        mask = np.zeros_like(grid)
        mask[tuple(np.reshape(cells, (-1, 2)).T)] = 1
        np.testing.assert_array_equal(getattr(sample, name)[0], mask, err_msg=name)
    on_best = (costs >= 0) & np.isclose(around_start + costs, best)
    points = samples.cells_of(sample.seed_points)
    matrix = np.full(sample.connection_matrix.shape, -2.0)
    for i, one in enumerate(points):
        for j, other in enumerate(points):
            matrix[i, j] = solved(grid, one, other, search, movement).cost if i != j else 0
    expected = {
        "map": grid[None],
        "free": 1 - grid[None],
        "length": len(found.path),
        "cost": found.cost,
        "hardness": best / empty[start] if best >= 0 else -1,
        "iterations": found.iterations,
        "optimal_mask": on_best[None] & (best >= 0),
        "cost_to_go": costs[None],
        "optimal_moves": moves_to_goal(grid, costs, movement)[None],
        "heuristic_ratio": np.where(costs > 0, empty / np.maximum(costs, 1), costs == 0)[None],
        "path_probability": probabilities(found.path, costs, grid, movement)[None],
        "clearance": clearance(grid)[None],
        "connection_matrix": matrix,
    }
    assert samples.cells_of(sample.path) == [tuple(cell) for cell in found.path.tolist()]
    for name, value in expected.items():
        np.testing.assert_allclose(
            np.asarray(getattr(sample, name), float), value, rtol=1e-5, err_msg=name
        )


CASES: list[tuple[str, str, str, Movement | None]] = [
    *(("square", radius, "astar", None) for radius in RADII),
    *(("wide", "0.1", search, None) for search in SEARCHES),
    *(("square", "0.1", "bfs", movement) for movement in MOVEMENTS),
]
"""Maps, radius, search and movement, for each way of being solved anew."""


@pytest.mark.parametrize("problems", [Route, Pairs])
@pytest.mark.parametrize("case", CASES, ids=str)
def test_stored_problems_are_solved_anew(
    roots: dict[str, str],
    case: tuple[str, str, str, Movement | None],
    problems: type[Route | Pairs],
) -> None:
    """Problems without a path are kept under `unsolvable`, else left out; all fields agree."""
    name, radius, search, movement = case
    how: dict[str, Any] = {"search": search, "movement": movement, "fields": samples.ALL_FIELDS}
    plain = MapDataset(roots[name], problems=problems(unsolvable=True), **how)
    every = MapDataset(roots[name], problems=problems(unsolvable=True), radius=float(radius), **how)
    solvable = MapDataset(roots[name], problems=problems(), radius=float(radius), **how)
    assert len(every) == len(plain)
    batch = every[:]
    if radius != "0.05":
        assert 5 < len(solvable) < len(every)
        for attribute in ("map", "start", "goal", "path", "cost_to_go", "connection_matrix"):
            kept = getattr(batch, attribute)[batch.length > 0]
            assert getattr(solvable[:], attribute).equal(kept), attribute
        blocked = [
            bool(one.map[0][tuple(one.start)] | one.map[0][tuple(one.goal)]) for one in every
        ]
        assert 5 < sum(blocked) < len(every) - len(solvable)
    for k in range(0, len(every), len(every) // 24):
        grid = inflated(name, number_of(plain[k], name), radius)
        for attribute in ("start", "goal", "seed_points"):
            assert getattr(every[k], attribute).equal(getattr(plain[k], attribute))
        assert_true(every[k], grid, search, every.movement)


@pytest.mark.parametrize("movement", [Movement(), Movement(8)], ids=["4", "8"])
@pytest.mark.parametrize("online", [False, True])
def test_random_problems_are_sampled_on_the_inflated_map(
    roots: dict[str, str], online: bool, movement: Movement
) -> None:
    """Those of the reference there, on the next map where it has none; the same as `Problems`."""
    problems = Random(distance=(4, None))
    how: dict[str, Any] = {"problems": problems, "movement": movement, "radius": 0.1}
    how["fields"] = samples.ALL_FIELDS
    dataset: Any = MapDataset(roots["square"], sampling_seed=SEED, **how)
    if online:
        dataset = OnlineMapDataset(samples.SPEC, SEED, MAPS, sampling_seed=SEED, **how)
    maps = []
    for k in range(len(dataset)):
        grid = inflated("square", k, "0.1")
        truth = reference.reference_problem(grid.tolist(), SEED, k, 0, problems.bands, movement)
        if truth is None:
            assert online or number_of(dataset[k], "square") != k
            continue
        maps.append(k)
        assert (samples.cell_of(dataset[k].start), samples.cell_of(dataset[k].goal)) == (
            truth.start,
            truth.goal,
        )
        if k % 5 == 0:
            assert_true(dataset[k], grid, "astar", movement)
    assert len(maps) > MAPS / 2
    found = Problems.sample(
        samples.SPEC, SEED, MAPS, problems=problems, movement=movement, radius=0.1
    )
    batch = dataset[maps]
    np.testing.assert_array_equal(found.grids, batch.map[:, 0])
    np.testing.assert_array_equal(found.starts, batch.start)
    np.testing.assert_array_equal(found.goals, batch.goal)
    assert found.description.endswith(", inflated by 1 cells")
    kept = [k for k in maps if generate(samples.SPEC, SEED, [k]).split[0] == 2]
    read = Problems.read(
        roots["square"], seed=SEED, problems=problems, movement=movement, radius=0.1
    )
    np.testing.assert_array_equal(read.grids, dataset[kept].map[:, 0])
    np.testing.assert_array_equal(read.starts, dataset[kept].start)


@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize("problems", [Route(), Pairs(), Route(True), Pairs(True)], ids=str)
def test_online_pairs_are_the_first_that_fit(problems: Route | Pairs, search: str) -> None:
    """Pairs of seed points in turn, from a drawn one on, until one has a path for the robot."""
    movement = Movement(8)
    dataset: Any = OnlineMapDataset(
        samples.SPEC,
        SEED,
        MAPS,
        None,
        samples.ALL_FIELDS,
        problems=problems,
        search=search,
        movement=movement,
        sampling_seed=9,
        radius=0.1,
    )
    for k, points in enumerate(generate(samples.SPEC, SEED, range(MAPS)).seed_points.tolist()):
        grid = inflated("square", k, "0.1")
        cells = [tuple(point) for point in points if point[0] >= 0]
        step = 1 if isinstance(problems, Route) else len(cells)
        pairs = [
            (one, other) for i, one in enumerate(cells) for other in cells[i + 1 : i + 1 + step]
        ]
        first = reference.block(9, k, 0, PROBLEM, 0)[0] * len(pairs) >> 32
        fitting = [
            (start, goal)
            for start, goal in pairs[first:] + pairs[:first]
            if start != goal
            and (problems.unsolvable or solved(grid, start, goal, search, movement).cost > 0)
        ]
        if fitting:
            sample = dataset[k]
            assert (samples.cell_of(sample.start), samples.cell_of(sample.goal)) == fitting[0]
            if k % 4 == 0:
                assert_true(sample, grid, search, movement)


def test_symmetries_come_after_inflation(roots: dict[str, str]) -> None:
    """An augmented sample is the plain one, turned as a whole."""
    fields = ("map", "start_mask", "goal_mask", "path_mask", "optimal_mask", "cost_to_go")
    for problems in ("route", "random"):
        how: dict[str, Any] = {"problems": problems, "radius": 0.1, "fields": fields}
        plain = MapDataset(roots["square"], "train", **how)
        augmented = MapDataset(roots["square"], "train", augment=True, **how)
        moved = 0
        for one, other in zip(plain, augmented, strict=True):
            layers = np.stack([np.asarray(value[0], float) for value in one])
            wanted = np.stack([np.asarray(value[0], float) for value in other])
            turned = [np.rot90(layers, k, (1, 2)) for k in range(4)]
            turned += [each[:, ::-1] for each in turned]
            assert any(np.array_equal(each, wanted) for each in turned)
            moved += not np.array_equal(layers, wanted)
        assert moved > len(plain) / 2


@pytest.mark.parametrize("problems", ["route", "pairs", "random"])
def test_workers_and_modules_serve_the_same(roots: dict[str, str], problems: str) -> None:
    """By workers, after pickling, filtered, by a data module, on disk and online."""
    how: dict[str, Any] = {"problems": problems, "radius": 0.1, "fields": samples.ALL_FIELDS}
    dataset = MapDataset(roots["square"], "val", **how)
    whole = [dataset[k : k + 8] for k in range(0, len(dataset), 8)]
    samples.assert_all_same(list(DataLoader(dataset, 8, num_workers=2)), whole)
    samples.assert_same(pickle.loads(pickle.dumps(dataset))[:], dataset[:])
    module = MapDataModule(roots["square"], batch_size=8, **how)
    assert module.hparams["radius"] == 0.1
    samples.assert_all_same(list(module.val_dataloader()), whole)
    if problems != "random":
        every = MapDataset(roots["square"], "val", **how).filter(path_length=(2, 999))
        assert len(every) == len(dataset)
    online = OnlineMapDataset(samples.SPEC, SEED, 12, "train", augment=True, **how)
    recipe = {"spec": samples.SPEC.to_dict(), "seed": SEED, "maps": 20}
    module = MapDataModule(None, build=recipe, batch_size=12, augment=True, **how)
    (first,) = list(module.train_dataloader())
    samples.assert_same(first, online[first.problem])


def test_the_radius_is_in_metres(tmp_path: Path) -> None:
    """0.15 m at 0.1 m a cell and 0.3 m at 0.2 m are 1.5 cells; roots must agree on it."""
    coarse = replace(samples.SPEC, resolution=0.2)
    fine = samples.build_small(tmp_path / "fine", maps=9)
    build(tmp_path / "coarse", coarse, maps=9, seed=5, workers=1)
    other = MapDataset(tmp_path / "coarse", problems="random", radius=0.3)
    assert other[:].map.equal(MapDataset(fine, problems="random", radius=0.15)[:].map)
    assert not other[:].map.equal(MapDataset(fine, problems="random", radius=0.1501)[:].map)
    assert ", radius=0.3)" in repr(other)
    assert "radius=" not in repr(MapDataset(fine))
    both = [fine, str(tmp_path / "coarse")]
    assert len(MapDataset(both, problems="random")) == 18
    with pytest.raises(ValueError, match=r"have resolutions 0\.. and 0\..; take those of one"):
        MapDataset(both, radius=0.1)


@pytest.mark.parametrize("radius", [-0.1, float("nan"), float("inf"), "wide", True])
def test_a_bad_radius_is_named(roots: dict[str, str], radius: Any) -> None:
    """By all that take one."""
    for make in (
        lambda: MapDataset(roots["square"], radius=radius),
        lambda: OnlineMapDataset(samples.SPEC, radius=radius),
        lambda: MapDataModule(roots["square"], radius=radius),
        lambda: Problems.sample(samples.SPEC, 0, 5, radius=radius),
        lambda: Problems.read(roots["square"], radius=radius),
    ):
        with pytest.raises(ValueError, match="radius: got"):
            make()


def test_a_robot_that_fits_nowhere(roots: dict[str, str]) -> None:
    """Nothing is left of routes, random problems are none, and the unsolvable ones have no path."""
    assert len(MapDataset(roots["square"], radius=5)) == 0
    every = MapDataset(roots["square"], problems=Pairs(True), radius=5, fields=samples.ALL_FIELDS)[
        :
    ]
    assert every.map.min() == 1
    assert set(every.cost.tolist()) == set(every.hardness.tolist()) == {-1.0}
    assert every.cost_to_go.max() == -1
    assert every.optimal_moves.max() == every.optimal_mask.max() == every.iterations.max() == 0
    for dataset in (
        MapDataset(roots["square"], problems="random", radius=5),
        OnlineMapDataset(samples.SPEC, problems="random", radius=5),
        OnlineMapDataset(samples.SPEC, radius=5),
    ):
        with pytest.raises(ValueError, match="none on one map after another"):
            dataset[0]
    with pytest.raises(ValueError, match="no map has a problem"):
        Problems.sample(samples.SPEC, 0, 5, radius=5)
