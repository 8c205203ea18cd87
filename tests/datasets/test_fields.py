"""Every field of a sample equals slow plain Python, on maps of any size, with terrain and without
it, for all movements and both planners.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
import torch
from helpers import reference, samples
from helpers.grids import scipy_distances, serpentine
from helpers.reference import Cell
from helpers.specs import movements

from mapdata import (
    Labels,
    MapDataset,
    MapGenerator,
    Movement,
    OnlineMapDataset,
    Sample,
    generate,
    label,
)
from mapdata.arrays import Bytes
from mapdata.datasets import FIELDS, Batch
from mapdata.datasets.fields import Rooms, room_matrices
from mapdata.problems.drawing import Paths
from mapdata.search.map_stack import MapStack

Array = npt.NDArray[Any]
planners = pytest.mark.parametrize("search", ["bfs", "astar"])
COSTS = (2, 3, 8, 91, 255)
"""Costs of the cells of terrain."""

on_any_map = pytest.mark.parametrize("costs", [(), COSTS], ids=["uniform", "terrain"])
searches_on_any_map = pytest.mark.parametrize(
    ("search", "costs"),
    [("bfs", ()), ("astar", COSTS), ("astar", ()), ("bfs", COSTS)],
    ids=["bfs-uniform", "astar-terrain", "astar-uniform", "bfs-terrain"],
)

SEARCHES = reference.SEARCHES
SHAPES = [(1, 1), (1, 9), (9, 1), (2, 2), (13, 13), (11, 17), (4, 70), (3, 129)]
DENSITIES = (0.0, 0.1, 0.2, 0.3, 0.45, 1.0)


class Problem(NamedTuple):
    """A map with two free cells, and its terrain or None."""

    grid: Bytes
    start: Cell
    goal: Cell
    terrain: Bytes | None = None

    @property
    def rows(self) -> list[list[int]]:
        """The grid as the reference wants it."""
        rows: list[list[int]] = self.grid.tolist()
        return rows

    @property
    def costs(self) -> list[list[int]] | None:
        """The terrain as the reference wants it."""
        return None if self.terrain is None else self.terrain.tolist()

    def lower_bound(self, cell: Cell, movement: Movement) -> float:
        """Return the heuristic of a cell: the cost to the goal on a map of the cheapest cells."""
        factor = 1 if self.terrain is None else 2 * int(self.terrain[self.terrain > 0].min())
        bound = reference.heuristic(cell, self.goal, movement, factor)
        return reference.as_float(bound, movement, self.costs)

    def costs_from(self, cell: Cell, movement: Movement) -> dict[Cell, reference.Pair]:
        """Return the exact costs between a cell and all that it is connected to."""
        return reference.reference_distances(self.rows, cell, movement, self.costs)

    def solved(self, search: str, movement: Movement) -> reference.ReferenceResult:
        """Return what a search finds."""
        return SEARCHES[search](self.rows, self.start, self.goal, movement, self.costs)


@cache
def problems_of(shape: tuple[int, int], costs: tuple[int, ...] = ()) -> list[Problem]:
    """Return problems of one size: scattered, a serpentine, walled in, and one whose start is its
    goal. With costs, their free cells have terrain.
    """
    source = np.random.default_rng(shape)
    grids = [(source.random(shape) < density).astype(np.uint8) for density in DENSITIES]
    grids += [serpentine(*shape, source), grids[1].copy()]
    problems = []
    for k, grid in enumerate(grids):
        start, goal = [
            (int(row), int(column)) for row, column in source.integers(0, shape, size=(2, 2))
        ]
        goal = start if k == len(grids) - 1 else goal
        grid[start] = grid[goal] = 0
        terrain = None
        if costs:
            terrain = np.where(grid, 0, source.choice(costs, shape)).astype(np.uint8)
        problems.append(Problem(grid, start, goal, terrain))
    return problems


def batch_of(problems: list[Problem], movement: Movement, search: str = "astar") -> Batch:
    """Return the batch of these problems, with the paths of the reference."""
    found = [one.solved(search, movement) for one in problems]
    cells = np.array([cell for result in found for cell in result.path], np.int64).reshape(-1, 2)
    offsets = np.concatenate(([0], np.cumsum([len(result.path) for result in found])))
    paths = Paths(cells, offsets, np.array([result.iterations for result in found]))

    def no_rooms() -> Rooms:
        raise AssertionError("nobody asked for rooms")

    grids = np.stack([one.grid for one in problems])
    terrains = [one.terrain for one in problems if one.terrain is not None]

    def stored_maps() -> MapStack:
        assert terrains, "nothing but pictures needs the stored maps without terrain"
        return MapStack(grids, np.stack(terrains))

    return Batch(
        movement=movement,
        search=search,
        grids=grids,
        starts=np.array([one.start for one in problems]),
        goals=np.array([one.goal for one in problems]),
        problems=np.arange(len(problems)),
        compute_map_indices=lambda: 3 * np.arange(len(problems)),
        compute_paths=lambda name: paths if name == search else None,
        compute_rooms=no_rooms,
        compute_map_numbers=lambda: np.arange(len(problems)),
        compute_stored_maps=stored_maps,
        has_terrain=bool(terrains),
        symmetries=np.zeros(len(problems), np.int64),
        requested_fields=tuple(FIELDS),
    )


# --- around the goal ----------------------------------------------------------------------------


@on_any_map
@movements
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_fields_around_the_goal(
    shape: tuple[int, int], movement: Movement, costs: tuple[int, ...]
) -> None:
    """`cost_to_go`, `heuristic_ratio`, `optimal_mask` and `optimal_moves`, cell by cell."""
    problems = problems_of(shape, costs)
    batch = batch_of(problems, movement)
    for k, problem in enumerate(problems):
        field = np.full(shape, -1, np.float32)
        ratio = np.zeros(shape, np.float32)
        for cell, pair in problem.costs_from(problem.goal, movement).items():
            cost = reference.as_float(pair, movement, problem.costs)
            field[cell] = cost
            ratio[cell] = problem.lower_bound(cell, movement) / cost if cost else 1
        np.testing.assert_array_equal(FIELDS["cost_to_go"](batch)[k, 0], field)
        np.testing.assert_allclose(FIELDS["heuristic_ratio"](batch)[k, 0], ratio, rtol=1e-6)
        np.testing.assert_array_equal(
            FIELDS["optimal_mask"](batch)[k, 0], optimal_cells(problem, movement)
        )
        np.testing.assert_array_equal(
            FIELDS["optimal_moves"](batch)[k, 0],
            reference.reference_moves(problem.rows, problem.goal, movement, problem.costs),
        )


def optimal_cells(problem: Problem, movement: Movement) -> Array:
    """Mark all cells n with d(start, n) + d(n, goal) = d(start, goal), exactly."""
    mask = np.zeros(problem.grid.shape, np.uint8)
    from_start = problem.costs_from(problem.start, movement)
    to_goal = problem.costs_from(problem.goal, movement)
    if problem.start in to_goal:
        best = reference.weigh(to_goal[problem.start], movement)
        for cell, cost in to_goal.items():
            mask[cell] = reference.weigh(reference.add(cost, from_start[cell]), movement) == best
    return mask


@movements
def test_only_what_is_asked_for_is_computed(movement: Movement) -> None:
    """Each of the four fields alone is what it is among the others."""
    problems = problems_of((11, 17))
    together = batch_of(problems, movement)
    for name in ("cost_to_go", "optimal_moves", "heuristic_ratio", "optimal_mask"):
        alone = batch_of(problems, movement)
        alone.requested_fields = (name,)
        np.testing.assert_array_equal(FIELDS[name](alone), FIELDS[name](together))
        assert sum(part.size > 0 for part in alone.goal_fields) == 1


@movements
def test_following_optimal_moves_leads_to_the_goal(movement: Movement) -> None:
    """Any of the moves, from any cell that the goal can be reached from, costs what the field
    says.
    """
    problem = problems_of((13, 13))[3]
    moves = FIELDS["optimal_moves"](batch_of([problem], movement))[0, 0]
    to_goal = reference.reference_field(problem.rows, problem.goal, movement)
    source = np.random.default_rng(0)
    steps = reference.STRAIGHT + reference.DIAGONAL
    for row, column in np.argwhere(to_goal > 0).tolist():
        path = [(row, column)]
        while path[-1] != problem.goal:
            choices = [step for bit, step in enumerate(steps) if moves[path[-1]] >> bit & 1]
            down, right = choices[source.integers(len(choices))]
            path.append((path[-1][0] + down, path[-1][1] + right))
        assert reference.first_bad_step(problem.rows, path, movement) is None
        assert reference.path_cost(path, movement) == pytest.approx(to_goal[row, column], rel=1e-6)


# --- of the path --------------------------------------------------------------------------------


@searches_on_any_map
@movements
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_fields_of_the_path(
    shape: tuple[int, int], movement: Movement, search: str, costs: tuple[int, ...]
) -> None:
    """`path`, `length`, `cost`, `hardness`, `iterations` and the masks."""
    problems = problems_of(shape, costs)
    batch = batch_of(problems, movement, search)
    others = {"connection_matrix", "seed_points", "image", *(["waypoints"] if costs else [])}
    found = {name: FIELDS[name](batch) for name in FIELDS if name not in others}
    assert found["path"].shape[1] % 16 == 0
    assert found["path"].shape[1] - 16 < max(found["length"]) <= found["path"].shape[1]
    for k, problem in enumerate(problems):
        truth = problem.solved(search, movement)
        assert samples.cells_of(torch.from_numpy(found["path"][k])) == truth.path
        assert found["length"][k] == len(truth.path)
        assert found["cost"][k] == np.float32(truth.cost)
        assert found["iterations"][k] == truth.iterations
        assert found["hardness"][k] == pytest.approx(hardness_of(problem, movement), rel=1e-6)
        for name, cells in (
            ("path_mask", truth.path),
            ("start_mask", [problem.start]),
            ("goal_mask", [problem.goal]),
        ):
            mask = np.zeros(shape, np.uint8)
            for cell in cells:
                mask[cell] = 1
            np.testing.assert_array_equal(found[name][k, 0], mask, err_msg=name)
        np.testing.assert_array_equal(found["map"][k, 0], problem.grid)
        np.testing.assert_array_equal(found["free"][k, 0], 1 - problem.grid)
        cell_costs = 1 - problem.grid if problem.terrain is None else problem.terrain
        np.testing.assert_array_equal(found["terrain"][k, 0], cell_costs)
        assert (*found["start"][k], *found["goal"][k]) == (*problem.start, *problem.goal)
        assert found["problem"][k] == k
        assert found["map_index"][k] == 3 * k
        assert found["symmetry"][k] == 0


def hardness_of(problem: Problem, movement: Movement) -> float:
    """Return optimal cost over heuristic, whichever planner is served: 1 when start = goal, -1
    without a path.
    """
    best = problem.costs_from(problem.goal, movement).get(problem.start)
    least = problem.lower_bound(problem.start, movement)
    if best is None or least == 0:
        return -1.0 if best is None else 1.0
    return reference.as_float(best, movement, problem.costs) / least


@searches_on_any_map
@movements
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_path_probability(
    shape: tuple[int, int], movement: Movement, search: str, costs: tuple[int, ...]
) -> None:
    """TransPath's map from scipy's distances: L / (d(start, n) + d(n, goal) + d(n, path)), below
    0.95 set to 0. The path is that of A*, whichever search is served.
    """
    problems = problems_of(shape, costs)
    found = FIELDS["path_probability"](batch_of(problems, movement, search))
    for k, problem in enumerate(problems):
        path = problem.solved("astar", movement).path
        expected = np.zeros(shape)
        near = np.zeros(shape, np.bool_)
        if path:
            distances = scipy_distances(
                problem.grid, [problem.start, problem.goal, *path], movement, problem.terrain
            )
            through = distances[0] + distances[1] + distances[2:].min(axis=0)
            best = distances[1][problem.start]
            ratio = np.where(through > 0, best / np.where(through > 0, through, 1), 1.0)
            reached = distances[0] >= 0
            near = reached & (
                abs(ratio - 0.95) < 1e-9
            )  # on the threshold, where rounding may decide
            expected = np.where(reached & (ratio >= 0.95), ratio, 0)
        np.testing.assert_allclose(found[k, 0][~near], expected[~near], rtol=1e-6)
        assert set(found[k, 0][near].tolist()) <= {0, np.float32(0.95)}


def test_the_threshold_of_path_probability_is_included() -> None:
    """A detour of 1 in 19: 19 / 20 is kept, as TransPath keeps it."""
    grid = np.zeros((2, 20), np.uint8)
    found = FIELDS["path_probability"](batch_of([Problem(grid, (0, 0), (0, 19))], Movement()))[0, 0]
    assert found[0].tolist() == [1.0] * 20
    assert found[1].tolist() == [0.0] * 20  # 19 / (21 + 1)
    grid = np.zeros((2, 58), np.uint8)
    found = FIELDS["path_probability"](batch_of([Problem(grid, (0, 0), (0, 57))], Movement()))[0, 0]
    assert set(found[1].tolist()) == {np.float32(57 / 60).item()}


def test_max_length() -> None:
    """A fixed number of rows; a path that does not fit is an error that names the argument."""
    problem = problems_of((1, 9))[0]
    batch = batch_of([problem], Movement())
    length = abs(problem.start[1] - problem.goal[1]) + 1
    for room in (length, 33):
        batch.max_length = room
        path = FIELDS["path"](batch)
        assert path.shape == (1, room, 2)
        assert len(samples.cells_of(torch.from_numpy(path[0]))) == length
    batch.max_length = length - 1
    with pytest.raises(
        ValueError, match=f"max_length: a path of {length} cells does not fit into {length - 1}"
    ):
        FIELDS["path"](batch)


# --- of the rooms -------------------------------------------------------------------------------


@movements
@pytest.mark.parametrize(
    ("search", "generator"),
    [(search, generator) for generator in (samples.SPEC, samples.ROUGH) for search in SEARCHES],
    ids=["bfs-uniform", "astar-uniform", "bfs-terrain", "astar-terrain"],
)
def test_room_matrices_equal_the_reference(
    generator: MapGenerator, movement: Movement, search: str
) -> None:
    """Searched on the fly: every entry, -1 no connection, -2 padding."""
    maps = generate(generator, 2, range(12))
    stack = MapStack(maps.occupancy, maps.terrain)
    found = room_matrices(search, maps.index, stack, maps.seed_points, movement)
    for k in range(len(maps)):
        n = int(maps.rooms[k])
        seed_points = [(int(row), int(column)) for row, column in maps.seed_points[k, :n]]
        truth = reference.reference_matrix(
            SEARCHES[search],
            maps.occupancy[k].tolist(),
            seed_points,
            movement,
            None if maps.terrain is None else maps.terrain[k].tolist(),
        )
        np.testing.assert_array_equal(found[k, :n, :n], truth.astype(np.float32))
        assert (found[k, n:] == -2).all()
        assert (found[k, :, n:] == -2).all()


# --- of a dataset -------------------------------------------------------------------------------


def cells_seen(sample: Sample) -> torch.Tensor:
    """Count free cells: a field of one's own, from the batch so far."""
    assert sample._fields == ("free", "start")
    count: torch.Tensor = sample.free.sum(dim=(1, 2, 3))
    return count


def starts_as_array(sample: Sample) -> Array:
    """Return a numpy array, which is welcome too."""
    doubled: Array = sample.start.numpy() * 2
    return doubled


B, H, W, R = 13, 9, 70, 5
TABLE: dict[str, tuple[tuple[int, ...], torch.dtype]] = {
    "map": ((B, 1, H, W), torch.uint8),
    "free": ((B, 1, H, W), torch.uint8),
    "terrain": ((B, 1, H, W), torch.uint8),
    "start": ((B, 2), torch.int64),
    "goal": ((B, 2), torch.int64),
    "length": ((B,), torch.int64),
    "cost": ((B,), torch.float32),
    "hardness": ((B,), torch.float32),
    "iterations": ((B,), torch.int64),
    "path_mask": ((B, 1, H, W), torch.uint8),
    "start_mask": ((B, 1, H, W), torch.uint8),
    "goal_mask": ((B, 1, H, W), torch.uint8),
    "optimal_mask": ((B, 1, H, W), torch.uint8),
    "cost_to_go": ((B, 1, H, W), torch.float32),
    "optimal_moves": ((B, 1, H, W), torch.uint8),
    "heuristic_ratio": ((B, 1, H, W), torch.float32),
    "path_probability": ((B, 1, H, W), torch.float32),
    "clearance": ((B, 1, H, W), torch.float32),
    "connection_matrix": ((B, R, R), torch.float32),
    "seed_points": ((B, R, 2), torch.int64),
    "problem": ((B,), torch.int64),
    "map_index": ((B,), torch.int64),
    "symmetry": ((B,), torch.int64),
    "waypoints": ((B, 32, 2), torch.float32),
    "image": ((B, 3, 8 * H, 8 * W), torch.uint8),
    "maze_image": ((B, 3, H, W), torch.uint8),
}
"""The design's table; `path` is apart."""


@pytest.fixture(scope="module")
def wide(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A dataset of 9 x 70 maps."""
    return samples.build_small(tmp_path_factory.mktemp("wide") / "maps", samples.WIDE, maps=20)


def test_every_field_is_in_the_table() -> None:
    """The table above says what shape and type each field has; of the path only the batch knows."""
    assert set(FIELDS) == {*TABLE, "path"}


@pytest.mark.parametrize("augment", [False, True])
@pytest.mark.parametrize("problems", ["route", "pairs", "random"])
@pytest.mark.parametrize("online", [False, True])
def test_shapes_and_types(wide: str, online: bool, problems: str, augment: bool) -> None:
    """A batch has exactly the fields asked for, in that order, with the shapes and types of the
    table.
    """
    fields = samples.ALL_FIELDS[::-1]
    dataset: MapDataset | OnlineMapDataset
    if online:
        dataset = OnlineMapDataset(
            samples.WIDE, 5, 20, fields=fields, problems=problems, augment=augment
        )
    else:
        dataset = MapDataset(wide, fields=fields, problems=problems, augment=augment)
    batch = dataset[3 : 3 + B]
    assert batch._fields == fields
    for name, (shape, dtype) in TABLE.items():
        value = getattr(batch, name)
        assert (tuple(value.shape), value.dtype, value.is_contiguous()) == (shape, dtype, True), (
            name
        )
    assert (batch.path.shape[0], batch.path.shape[2], batch.path.dtype) == (B, 2, torch.int64)
    assert batch.path.shape[1] % 16 == 0
    assert batch.path.shape[1] == -(-int(batch.length.max()) // 16) * 16
    one = dataset[4]
    for name, (shape, dtype) in TABLE.items():
        assert (tuple(getattr(one, name).shape), getattr(one, name).dtype) == (shape[1:], dtype), (
            name
        )
    assert one.path.shape == (int(one.length), 2)


@planners
def test_stored_matrices_and_centres(wide: str, search: str) -> None:
    """The stored connection matrix and seeds of each problem's map."""
    dataset = MapDataset(
        wide, fields=("problem", "connection_matrix", "seed_points"), search=search
    )
    labels = labels_of_wide()
    batch = dataset[:]
    for k, i in enumerate(map_of_each_problem(labels)):
        n = int(labels.maps.rooms[i])
        matrix = labels.matrix(search, i).astype(np.float32)
        np.testing.assert_array_equal(batch.connection_matrix[k, :n, :n], matrix)
        np.testing.assert_array_equal(batch.seed_points[k, :n], labels.maps.seed_points[i, :n])
        for padding in (batch.connection_matrix[k, n:], batch.connection_matrix[k, :, n:]):
            assert (padding == -2).all()
        assert (batch.seed_points[k, n:] == -1).all()


def labels_of_wide() -> Labels:
    """Return the labels that the dataset of wide maps holds."""
    return label(generate(samples.WIDE, 5, range(20)))


def map_of_each_problem(labels: Labels) -> list[int]:
    """Return the map of each solvable route problem of positive length, in order."""
    owners = []
    for i in range(len(labels.maps)):
        owners += [i for segment in labels.route("astar", i) if len(segment) > 1]
    return owners


def test_functions_are_fields(wide: str) -> None:
    """A function sees the batch so far and gives a field under its name; arrays and tensors are
    welcome.
    """
    fields = ("free", "start", cells_seen, "goal", starts_as_array)
    for dataset in (
        MapDataset(wide, fields=fields),
        OnlineMapDataset(samples.WIDE, 5, 20, fields=fields),
    ):
        batch = dataset[:7]
        assert batch._fields == ("free", "start", "cells_seen", "goal", "starts_as_array")
        assert torch.equal(batch.cells_seen, batch.free.flatten(1).sum(dim=1))
        assert torch.equal(batch.starts_as_array, batch.start * 2)
        samples.assert_same(dataset[3], next(iter(dataset.__getitems__([3]))))


def test_padding_is_as_short_as_it_can_be(wide: str) -> None:
    """Each batch has its own number of rows, a multiple of 16; with `max_length` all have the
    same.
    """
    dataset = MapDataset(wide, fields=("path", "length"))
    rows = {dataset[k : k + 1].path.shape[1] for k in range(len(dataset))}
    assert len(rows) > 1
    assert all(room % 16 == 0 for room in rows)
    fixed = MapDataset(wide, fields=("path", "length"), max_length=100)
    assert {fixed[k].path.shape for k in range(5)} == {(100, 2)}
    assert fixed[:5].path.shape == (5, 100, 2)
    for k in range(5):
        assert samples.cells_of(fixed[k].path) == samples.cells_of(dataset[k].path)
