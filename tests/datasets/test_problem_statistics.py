"""What problems are worth: equal to all shortest paths that networkx lists, one after another."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import networkx as nx  # type: ignore[import-untyped]
import numpy as np
import pytest
from helpers import reference, samples
from helpers.reference import Cell
from helpers.specs import movements

from mapdata import (
    Forest,
    MapDataset,
    Movement,
    OnlineMapDataset,
    Pairs,
    ProblemSet,
    ProblemSetDataset,
    Random,
    Route,
    Terrain,
    build,
)
from mapdata.datasets.problem_statistics import measure, sample_size, spread_numbers
from mapdata.describe import ProblemStatistics

NOISE = Forest((6, 7), cover=(0.1, 0.5), sizes=(1, 1), seed_points=3)
HILLS = Terrain((6, 6), costs=(1, 2), scale=2, obstacles=0.2, seed_points=3)
FIELDS = ("map", "terrain", "start", "goal", "map_index")

Dataset = MapDataset | OnlineMapDataset | ProblemSetDataset


class Truth(NamedTuple):
    """What is true of a problem that has a path."""

    no_detour: bool
    hard: bool
    paths: int
    cells_ratio: float
    expansion_ratio: float


def truth_of(sample: Any, movement: Movement, has_terrain: bool) -> Truth | None:
    """Return what all shortest paths of a problem say; None without a path."""
    grid = samples.grid_of(sample.map)
    terrain = sample.terrain[0].tolist() if has_terrain else None
    start, goal = samples.cell_of(sample.start), samples.cell_of(sample.goal)
    found = reference.reference_astar(grid, start, goal, movement, terrain)
    if not (found.path and reference.is_free(grid, start) and reference.is_free(grid, goal)):
        return None
    graph = nx.DiGraph()
    graph.add_node(start)
    for row in range(len(grid)):
        for column in range(len(grid[0])):
            if reference.is_free(grid, (row, column)):
                for cell, step in reference.neighbours(grid, (row, column), movement, terrain):
                    graph.add_edge((row, column), cell, cost=reference.weigh(step, movement))
    paths: list[list[Cell]] = list(nx.all_shortest_paths(graph, start, goal, "cost"))
    cells = {cell for path in paths for cell in path}
    straight, diagonal = reference.heuristic(start, goal, movement)
    lower_bound = straight + diagonal * movement.diagonal_cost
    return Truth(
        no_detour=math.isclose(found.cost, lower_bound, rel_tol=1e-9, abs_tol=1e-9),
        hard=found.cost >= 1.05 * lower_bound - 1e-9 and start != goal,
        paths=len(paths),
        cells_ratio=len(cells) / len(found.path),
        expansion_ratio=found.iterations / len(found.path),
    )


def assert_true(statistics: ProblemStatistics, dataset: Dataset) -> list[Truth]:
    """Compare statistics of all problems of a dataset, which serves `FIELDS`, with the truth."""
    found = [truth_of(sample, dataset.movement, dataset.has_terrain) for sample in dataset]
    truths = [truth for truth in found if truth is not None]
    assert statistics.problems == statistics.sample == len(dataset)
    assert statistics.without_path == len(found) - len(truths)
    shares = {
        "single_path": [truth.paths == 1 for truth in truths],
        "few_paths": [2 <= truth.paths <= 9 for truth in truths],
        "many_paths": [truth.paths >= 10 for truth in truths],
    }
    if dataset.has_terrain:
        assert statistics.no_detour is statistics.hard is None
    else:
        shares["no_detour"] = [truth.no_detour for truth in truths]
        shares["hard"] = [truth.hard for truth in truths]
    for name, flags in shares.items():
        assert getattr(statistics, name).value == pytest.approx(np.mean(flags)), name
    cells_ratio = np.mean([truth.cells_ratio for truth in truths])
    assert statistics.optimal_cells.value == pytest.approx(cells_ratio)
    expansion_ratio = np.mean([truth.expansion_ratio for truth in truths])
    assert statistics.expansions.value == pytest.approx(expansion_ratio)
    return truths


@movements
@pytest.mark.parametrize("generator", [NOISE, HILLS], ids=["noise", "hills"])
def test_random_problems(movement: Movement, generator: Any) -> None:
    """Under every movement, on maps with and without terrain."""
    dataset = OnlineMapDataset(
        generator, 1, 40, fields=FIELDS, problems=Random(distance=(2, None)), movement=movement
    )
    truths = assert_true(dataset.problem_statistics(), dataset)
    assert {min(truth.paths, 10) for truth in truths} >= {1, 2, 3}


def test_open_maps_have_more_paths_than_are_counted() -> None:
    """1287 shortest paths between the corners, which is 7 in 8 bits, and all cells are on one."""
    corners = np.array([[0, 0]]), np.array([[5, 8]])
    problems = ProblemSet(np.zeros((1, 6, 9), np.uint8), *corners, Movement())
    dataset = ProblemSetDataset(problems, FIELDS)
    (truth,) = assert_true(dataset.problem_statistics(), dataset)
    assert truth == Truth(True, False, 1287, 54 / 14, truth.expansion_ratio)


def test_small_detours_are_no_hard_problems_and_not_straight_either() -> None:
    """A detour of 2 cells is 5 % of 40 cells, 4.9 % of 41, and 0.8 % of 250."""
    grid = np.zeros((2, 251), np.uint8)
    grid[0, 1] = 1
    goals = np.array([(0, 40), (0, 41), (0, 250), (1, 40)])
    starts = np.array([(0, 0), (0, 0), (0, 0), (1, 0)])
    problems = ProblemSet(np.broadcast_to(grid, (4, 2, 251)), starts, goals, Movement())
    statistics = ProblemSetDataset(problems).problem_statistics()
    assert statistics.no_detour is not None
    assert statistics.hard is not None
    assert (statistics.no_detour.value, statistics.hard.value) == (1 / 4, 1 / 4)
    assert (statistics.maps, statistics.most_on_one_map) == (1, 4)


@pytest.mark.parametrize("generator", [NOISE, HILLS], ids=["noise", "hills"])
@pytest.mark.parametrize("search", ["astar", "bfs"])
def test_stored_problems_with_a_radius_and_without_a_path(
    tmp_path: Path, generator: Any, search: str
) -> None:
    """Shortest paths are those of least cost, whatever search is served."""
    # On maps of 6 x 6 cells the robot has room on few cells.
    generator = replace(generator, map_size=(9, 9))
    build(tmp_path / "maps", generator, maps=40, seed=2, workers=1)
    dataset = MapDataset(
        tmp_path / "maps",
        "train",
        FIELDS,
        problems=Pairs(unsolvable=True),
        search=search,
        movement=Movement(8),
        radius=0.6 * generator.resolution,
    )
    statistics = dataset.problem_statistics()
    assert_true(statistics, dataset)
    assert 0 < statistics.without_path < statistics.sample
    assert statistics.replaced is None
    hard = MapDataset(tmp_path / "maps", fields=FIELDS).filter(hardness=(1.05, None))
    assert_true(hard.problem_statistics(), hard)
    assert ".filter(hardness=(1.05, inf))" in hard.problem_statistics().served


def test_a_start_at_its_goal_has_one_path_of_one_cell(tmp_path: Path) -> None:
    """Its hardness is 1, and nothing is divided by the heuristic 0."""
    build(tmp_path / "maps", NOISE, maps=20, workers=1)
    dataset = MapDataset(tmp_path / "maps", fields=FIELDS)
    load = dataset.batch_of

    def at_the_goal(indices: Any, epoch: int) -> Any:
        batch = load(indices, epoch)
        batch.starts, batch.compute_paths = batch.goals, lambda _: None
        return batch

    dataset.batch_of = at_the_goal  # type: ignore[method-assign]
    statistics = dataset.problem_statistics()
    assert statistics.no_detour is not None
    assert statistics.no_detour.value == statistics.single_path.value == 1
    assert statistics.optimal_cells.value == statistics.expansions.value == 1
    assert statistics.target_text().startswith("All measured problems have one shortest path")
    assert_true(statistics, dataset)


def test_maps_are_counted_by_what_they_hold(tmp_path: Path) -> None:
    """Equal maps are one map, and turned ones are equal up to symmetry."""
    corner = np.zeros((3, 4, 4), np.uint8)
    corner[:, 0, 0] = 1
    corner[2] = corner[0, ::-1]
    ends = np.tile([[1, 1]], (3, 1)), np.tile([[2, 2]], (3, 1))
    statistics = ProblemSetDataset(ProblemSet(corner, *ends, Movement())).problem_statistics()
    assert (statistics.maps, statistics.maps_up_to_symmetry) == (2, 1)
    assert statistics.most_on_one_map == 2
    root = samples.build_small(tmp_path / "maps")
    # With this radius all cells are occupied, but the maps are different.
    dataset = MapDataset(root, fields=FIELDS, problems=Pairs(unsolvable=True), radius=5)
    statistics = dataset.problem_statistics(10**6)
    assert statistics.without_path == len(dataset)
    _, counts = np.unique(dataset[:].map_index, return_counts=True)
    assert (statistics.maps, statistics.most_on_one_map) == (len(counts), counts.max())
    costs = np.where(corner == 1, 0, np.array([2, 2, 3])[:, None, None]).astype(np.uint8)
    costs[1, 3, 3] = 7
    terrain = ProblemSet(corner, *ends, Movement(), terrain=costs)
    statistics = ProblemSetDataset(terrain).problem_statistics()
    assert (statistics.maps, statistics.maps_up_to_symmetry) == (3, 3)


@pytest.mark.parametrize("split", [None, "train"])
@pytest.mark.parametrize("is_online", [True, False])
def test_problems_on_another_map_than_their_own_are_counted(
    tmp_path: Path, split: str | None, is_online: bool
) -> None:
    """By ``map_index``: that of problem i, and that of the i-th map of the split."""
    source = Random(length=(12, None))
    if is_online:
        dataset: Any = OnlineMapDataset(NOISE, 3, 30, split, FIELDS, problems=source)
        own: Any = OnlineMapDataset(NOISE, 3, 30, split, FIELDS, problems="random")
    else:
        build(tmp_path / "maps", NOISE, maps=30, seed=3, workers=1)
        dataset = MapDataset(tmp_path / "maps", split, FIELDS, problems=source)
        own = MapDataset(tmp_path / "maps", split, FIELDS, problems="random")
    assert own.problem_statistics().replaced.value == 0
    is_replaced = dataset[:].map_index != own[:].map_index
    assert 0 < is_replaced.sum() < len(dataset)
    replaced = dataset.problem_statistics().replaced
    assert replaced.value == pytest.approx(is_replaced.float().mean().item())


def test_a_dataset_without_problems_is_unknown(tmp_path: Path) -> None:
    """And one problem has a value, whose interval says that it is little."""
    root = samples.build_small(tmp_path / "maps", maps=3)
    empty = MapDataset(root, "val")
    assert len(empty) == 0
    statistics = empty.problem_statistics()
    assert (statistics.problems, statistics.maps, statistics.most_on_one_map) == (0, 0, 0)
    assert math.isnan(statistics.single_path.value)
    assert statistics.to_dict()["hard"] == [None, None, None]
    assert "unknown" in repr(statistics)
    one = MapDataset(root, fields=FIELDS).problem_statistics(1)
    assert one.sample == one.maps == 1
    assert one.optimal_cells.low == one.optimal_cells.value == one.optimal_cells.high
    for dataset, sample in ((empty, 0), (empty, -1)):
        with pytest.raises(ValueError, match="sample"):
            dataset.problem_statistics(sample)


def test_the_sample_is_spread_over_the_dataset_and_hits_no_period() -> None:
    """One number of each part, all numbers of a small dataset, and all remainders alike."""
    for count in (0, 1, 7, 10, 11, 300, 44_490, 10**9):
        numbers = spread_numbers(count, 10)
        assert len(numbers) == len(set(numbers.tolist())) == min(count, 10)
        bounds = [k * count // max(len(numbers), 1) for k in range(len(numbers) + 1)]
        assert all(numbers >= bounds[:-1])
        assert all(numbers < bounds[1:])
    for period in (2, 3, 4, 5, 10):
        remainders = np.bincount(spread_numbers(30_000, 300) % period, minlength=period)
        assert remainders.min() > 0.8 * 300 / period
    assert sample_size(10**5, 64 * 64) == 10**5
    assert sample_size(300, 64 * 80) == 292
    assert (sample_size(300, 4096**2), sample_size(3, 4096**2)) == (10, 3)


def test_a_sample_is_measured_on_the_problems_that_it_names() -> None:
    """The statistics of 7 of 40 problems are those of a set of these 7, in batches of any size."""
    dataset = OnlineMapDataset(NOISE, 5, 40, fields=FIELDS, problems="random")
    numbers = spread_numbers(40, 7)
    batch = dataset[numbers]
    grids = batch.map[:, 0].numpy()
    problems = ProblemSet(grids, batch.start.numpy(), batch.goal.numpy(), Movement())
    expected = ProblemSetDataset(problems).problem_statistics().to_dict()
    found = dataset.problem_statistics(7).to_dict()
    different = {"served", "problems", "replaced"}
    assert {name: found[name] for name in found if name not in different} == {
        name: expected[name] for name in expected if name not in different
    }


def test_problems_beyond_an_epoch_are_those_of_the_next_one() -> None:
    """As an export counts them."""
    dataset = OnlineMapDataset(NOISE, 5, 20, fields=FIELDS, problems="random")
    batches = [dataset.__getitems__([i])[0] for i in range(50)]
    truths = [truth_of(sample, dataset.movement, False) for sample in batches]
    statistics = measure(dataset, numbers=np.arange(50))
    assert statistics.sample == 50
    ratios = [truth.cells_ratio for truth in truths if truth is not None]
    assert statistics.optimal_cells.value == pytest.approx(np.mean(ratios))


def test_statistics_are_text_and_json(tmp_path: Path) -> None:
    """A line for each statistic, and plain values."""
    root = samples.build_small(tmp_path / "maps")
    dataset = MapDataset(root, "train", problems=Route(), radius=0.05)
    statistics = dataset.problem_statistics(20)
    text = repr(statistics)
    assert "split train; radius 0.05 m" in text
    assert f"20 of {len(dataset)}" in text
    values = json.loads(json.dumps(statistics.to_dict()))
    assert values["single_path"] == [round(number, 6) for number in statistics.single_path]
    assert values["replaced"] is None
    assert dataset.problem_statistics(20) == statistics
