"""Fields of maps with terrain equal the slow reference and scipy, and on ones those without it."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import pytest
import torch
from helpers import reference, samples
from helpers.grids import scipy_distances
from helpers.reference import Cell
from helpers.specs import movements
from torch.utils.data import DataLoader

from mapdata import (
    MapDataModule,
    MapDataset,
    Maze,
    Movement,
    OnlineMapDataset,
    Pairs,
    ProblemSet,
    ProblemSetDataset,
    Random,
    Route,
    Sample,
    Terrain,
    build,
    generate,
    inflate_terrain,
)
from mapdata.arrays import Ints
from mapdata.datasets import FIELDS, Batch, Waypoints
from mapdata.datasets.fields import Rooms
from mapdata.generators.maps import Maps

Array = npt.NDArray[Any]

ALL_FIELDS = tuple(name for name in FIELDS if name != "waypoints")
"""Taut lines do not exist on terrain."""

HILLS = Terrain((9, 11), costs=(2, 3, 8, 91), obstacles=0.2, seed_points=4)
SQUARE = Terrain((9, 9), costs=(1, 2, 5), obstacles=0.1, seed_points=3)
SEED = 4
COUNT = 6

SEARCHES: dict[str, Any] = {
    "bfs": reference.reference_bfs,
    "astar": reference.reference_astar,
}
searches = pytest.mark.parametrize("search", ["bfs", "astar"])


def cell_of(cell: torch.Tensor) -> Cell:
    """Return a cell as two integers."""
    return samples.cell_of(cell)


# --- every field of served samples, against the reference ----------------------------------------


def assert_fields_fit(sample: Sample, movement: Movement, search: str) -> None:
    """Compare all fields of a sample with those that follow from its terrain, start and goal."""
    terrain = sample.terrain[0].tolist()
    grid = sample.map[0].tolist()
    start, goal = cell_of(sample.start), cell_of(sample.goal)
    shape = tuple(sample.map.shape[1:])
    assert torch.equal(sample.map, (sample.terrain == 0).to(torch.uint8))
    assert torch.equal(sample.free, 1 - sample.map)
    optimal = reference.reference_astar(grid, start, goal, movement, terrain)
    path = optimal if search == "astar" else reference.reference_bfs(grid, start, goal, movement)
    assert samples.cells_of(sample.path) == path.path
    assert sample.length == len(path.path)
    assert sample.cost == np.float32(path.cost)
    assert sample.iterations == path.iterations
    factor = 2 * min(cost for row in terrain for cost in row if cost > 0)
    bound = reference.heuristic(start, goal, movement, factor)
    lower_bound = reference.as_float(bound, movement, terrain)
    assert sample.hardness == np.float32(optimal.cost / lower_bound)
    field = reference.reference_field(grid, goal, movement, terrain)
    np.testing.assert_array_equal(sample.cost_to_go[0], field)
    moves = reference.reference_moves(grid, goal, movement, terrain)
    np.testing.assert_array_equal(sample.optimal_moves[0], moves)
    exact_to_goal = reference.reference_distances(grid, goal, movement, terrain)
    exact_from_start = reference.reference_distances(grid, start, movement, terrain)
    ratio = np.zeros(shape, np.float32)
    is_optimal = np.zeros(shape, np.uint8)
    best = reference.weigh(exact_to_goal[start], movement)
    for cell, cost in exact_to_goal.items():
        least = reference.as_float(
            reference.heuristic(cell, goal, movement, factor), movement, terrain
        )
        ratio[cell] = 1 if cell == goal else least / reference.as_float(cost, movement, terrain)
        through = reference.add(exact_from_start[cell], cost)
        is_optimal[cell] = reference.weigh(through, movement) == best
    np.testing.assert_array_equal(sample.heuristic_ratio[0], ratio)
    np.testing.assert_array_equal(sample.optimal_mask[0], is_optimal)
    for name, cells in (
        ("path_mask", path.path),
        ("start_mask", [start]),
        ("goal_mask", [goal]),
    ):
        mask = np.zeros(shape, np.uint8)
        mask[tuple(np.transpose(cells))] = 1
        np.testing.assert_array_equal(getattr(sample, name)[0], mask, err_msg=name)
    assert_probabilities_fit(sample, optimal.path, movement)
    assert_matrix_fits(sample, movement, search)


def assert_probabilities_fit(sample: Sample, path: list[Cell], movement: Movement) -> None:
    """Compare the path probability with its formula on scipy's distances."""
    terrain = np.asarray(sample.terrain[0])
    distances = scipy_distances(terrain == 0, [path[0], path[-1], *path], movement, terrain)
    detours = distances[0] + distances[1] + distances[2:].min(axis=0)
    ratio = distances[1][path[0]] / detours
    is_reached = (terrain > 0) & (distances[0] >= 0)
    expected = np.where(is_reached & (ratio >= 0.95), ratio, 0)
    # On the threshold rounding may decide.
    is_clear = ~(is_reached & (abs(ratio - 0.95) < 1e-9))
    np.testing.assert_allclose(
        np.asarray(sample.path_probability[0])[is_clear], expected[is_clear], rtol=1e-6
    )


def assert_matrix_fits(sample: Sample, movement: Movement, search: str) -> None:
    """Compare the connection matrix with the reference's costs, or for BFS with its moves."""
    terrain = sample.terrain[0].tolist()
    grid = sample.map[0].tolist()
    points = samples.cells_of(sample.seed_points)
    for i, first in enumerate(points):
        for j, second in enumerate(points):
            expected = -1.0
            if i == j:
                expected = 0.0
            elif terrain[first[0]][first[1]] and terrain[second[0]][second[1]]:
                arguments = (grid, first, second, movement)
                if search == "bfs":
                    expected = reference.reference_bfs(*arguments).cost
                else:
                    expected = reference.reference_astar(*arguments, terrain).cost
            assert sample.connection_matrix[i, j] == np.float32(expected)
    assert (sample.connection_matrix[len(points) :] == -2).all()


@searches
@movements
@pytest.mark.parametrize("problems", ["route", "pairs", "random"])
def test_all_fields_on_terrain_equal_the_reference(
    movement: Movement, search: str, problems: str
) -> None:
    """And the terrain is that of the generated maps."""
    dataset = OnlineMapDataset(
        HILLS, SEED, COUNT, fields=ALL_FIELDS, problems=problems, search=search, movement=movement
    )
    drawn = generate(HILLS, SEED, range(COUNT))
    assert drawn.terrain is not None
    for k in range(0, COUNT, 2):
        sample = dataset[k]
        np.testing.assert_array_equal(sample.terrain[0], drawn.terrain[k])
        assert_fields_fit(sample, movement, search)


@searches
@movements
def test_all_fields_for_a_robot_are_those_of_the_inflated_terrain(
    movement: Movement, search: str
) -> None:
    """Inflated cells cost 0; the smallest cost of the heuristic is that of the cells left."""
    dataset = OnlineMapDataset(
        WIDE_HALLS,
        SEED,
        COUNT,
        fields=ALL_FIELDS,
        problems=Random(distance=(6, None)),
        search=search,
        movement=movement,
        radius=0.1,
    )
    drawn = generate(WIDE_HALLS, SEED, range(COUNT))
    assert drawn.terrain is not None
    for k in range(3):
        sample = dataset[k]
        inflated = inflate_terrain(drawn.terrain[k], 0.1 / WIDE_HALLS.resolution)
        assert (inflated == 0).sum() > (drawn.terrain[k] == 0).sum()
        np.testing.assert_array_equal(sample.terrain[0], inflated)
        assert_fields_fit(sample, movement, search)


@dataclass(frozen=True)
class Halls(Terrain):
    """Terrain with few obstacles, in which the cheapest cells lie beside the border."""

    name: ClassVar[str] = "halls"

    def draw(self, seed: int, indices: Ints) -> Maps:
        """Return the maps."""
        maps = super().draw(seed, indices)
        assert maps.terrain is not None
        border = np.ones(self.map_size, np.bool_)
        border[1:-1, 1:-1] = False
        return replace(
            maps, terrain=np.where(border & (maps.terrain > 0), np.uint8(1), maps.terrain)
        )


WIDE_HALLS = Halls((14, 13), costs=(3, 4, 9), obstacles=0.02, seed_points=3)


@movements
@pytest.mark.parametrize("radius", [0.0, 0.1])
def test_symmetries_move_the_terrain_with_all_other_fields(
    movement: Movement, radius: float
) -> None:
    """Each sample is one symmetry of the plain one, and its fields fit its terrain."""
    options: dict[str, Any] = {
        "fields": ALL_FIELDS,
        "movement": movement,
        "radius": radius,
        "problems": "random",
    }
    plain = OnlineMapDataset(SQUARE, SEED, COUNT, **options)[:]
    dataset = OnlineMapDataset(SQUARE, SEED, COUNT, augment=True, **options)
    batch = dataset[:]
    codes = dataset._batch(np.arange(COUNT), 0).symmetries
    assert len(set(codes.tolist())) > 2
    for k, code in enumerate(codes.tolist()):
        sample = samples_row(batch, k)
        for name in ("terrain", "map", "start_mask", "goal_mask", "clearance"):
            expected = transformed(np.asarray(getattr(plain, name)[k, 0]), code)
            np.testing.assert_array_equal(getattr(sample, name)[0], expected, err_msg=name)
        np.testing.assert_array_equal(batch.connection_matrix[k], plain.connection_matrix[k])
        if k < 3:
            assert_symmetric_fields_fit(sample, movement)


def assert_symmetric_fields_fit(sample: Sample, movement: Movement) -> None:
    """Compare the fields that do not depend on the order of moves with the reference."""
    terrain = sample.terrain[0].tolist()
    grid = sample.map[0].tolist()
    path = samples.cells_of(sample.path)
    cost = reference.path_cost(path, movement, terrain)
    assert reference.first_bad_step(grid, path, movement) is None
    assert (path[0], path[-1]) == (cell_of(sample.start), cell_of(sample.goal))
    assert sample.cost == pytest.approx(cost, rel=1e-6)
    field = reference.reference_field(grid, path[-1], movement, terrain)
    np.testing.assert_array_equal(sample.cost_to_go[0], field)
    assert sample.cost == field[path[0]]
    assert_matrix_fits(sample, movement, "astar")


def samples_row(batch: Sample, k: int) -> Sample:
    """Return sample k of a batch."""
    sample: Sample = batch._make(tensor[k] for tensor in batch)
    return sample


def transformed(grid: Array, code: int) -> Array:
    """Return a grid after a symmetry: rows reversed, columns reversed, transposed."""
    if code & 1:
        grid = grid[::-1]
    if code & 2:
        grid = grid[:, ::-1]
    return grid.T if code & 4 else grid


# --- random problems ------------------------------------------------------------------------------


BANDS = [
    Random(),
    Random(distance=(30, None)),
    Random(distance=(10, 60), hardness=(1.5, 4)),
    Random(length=(5, 9)),
    Random(distance=(5, None), to_first_seed_point=True),
]


@movements
@pytest.mark.parametrize("problems", BANDS, ids=str)
def test_random_problems_on_terrain_are_those_of_the_reference(
    movement: Movement, problems: Random
) -> None:
    """The draws of the format, with distances and hardness in the costs of the terrain."""
    dataset = OnlineMapDataset(
        HILLS,
        SEED,
        COUNT,
        fields=("start", "goal", "cost", "hardness", "length", "terrain"),
        problems=problems,
        movement=movement,
        sampling_seed=12,
    )
    drawn = generate(HILLS, SEED, range(COUNT))
    assert drawn.terrain is not None
    served = 0
    for epoch in (0, 3):
        for k in range(COUNT):
            (sample,) = dataset.__getitems__([k + epoch * COUNT])
            grid, terrain = drawn.occupancy[k].tolist(), drawn.terrain[k].tolist()
            only_goal = None
            if problems.to_first_seed_point:
                row, column = drawn.seed_points[k, 0].tolist()
                only_goal = (row, column)
            minimum, bands = problems.conditions
            expected = reference.reference_problem(
                grid,
                12,
                k,
                epoch,
                bands or ((minimum, np.inf), (0, np.inf), (0, np.inf)),
                movement,
                only_goal=only_goal,
                terrain=terrain,
            )
            if expected is None:  # another map takes its place
                assert not np.array_equal(sample.terrain[0], drawn.terrain[k])
                continue
            served += 1
            assert (cell_of(sample.start), cell_of(sample.goal)) == expected[:2]
            cost = reference.as_float(expected.cost, movement, terrain)
            assert sample.cost == np.float32(cost)
    assert served > COUNT


@pytest.mark.parametrize("is_stored", [False, True])
def test_a_substitute_is_served_with_its_own_terrain_and_rooms(
    is_stored: bool, tmp_path: Path
) -> None:
    """Not with those of the map that it replaces."""
    options: dict[str, Any] = {
        "fields": ("map_index", "map", "terrain", "seed_points"),
        "problems": Random(distance=(300, None)),
    }
    if is_stored:
        build(tmp_path, HILLS, maps=6, seed=SEED, workers=1)
        batch = MapDataset(tmp_path, **options)[:]
    else:
        batch = OnlineMapDataset(HILLS, SEED, 6, **options)[:]
    is_substitute = batch.map_index != torch.arange(6)
    assert 0 < is_substitute.sum() < 6
    own = generate(HILLS, SEED, batch.map_index.tolist())
    np.testing.assert_array_equal(batch.map[:, 0], own.occupancy)
    np.testing.assert_array_equal(batch.terrain[:, 0], own.terrain)
    np.testing.assert_array_equal(batch.seed_points, own.seed_points)


# --- terrain of ones ------------------------------------------------------------------------------


@dataclass(frozen=True)
class WithoutCosts(Terrain):
    """The maps of `Terrain` without their terrain."""

    name: ClassVar[str] = "without_costs"

    @property
    def has_terrain(self) -> bool:
        """The costs are dropped."""
        return False

    def draw(self, seed: int, indices: Ints) -> Maps:
        """Return the maps."""
        return replace(super().draw(seed, indices), terrain=None)


@searches
@movements
@pytest.mark.parametrize(
    "problems", [Route(), Pairs(), Random(), Random(distance=(6, 30), hardness=(1, 1.6))], ids=str
)
def test_terrain_of_ones_gives_the_fields_without_terrain(
    movement: Movement, search: str, problems: Any
) -> None:
    """All of them bit for bit, with the same problems, paths and iterations."""
    for radius in (0.0, 0.1):
        batches = [
            OnlineMapDataset(
                family((16, 17), costs=(1,), obstacles=0.06, seed_points=4),
                SEED,
                12,
                fields=ALL_FIELDS,
                problems=problems,
                search=search,
                movement=movement,
                radius=radius,
                augment=True,
            )[:]
            for family in (Terrain, WithoutCosts)
        ]
        samples.assert_same(*batches)


# --- batches --------------------------------------------------------------------------------------


def test_a_batch_without_problems_has_all_fields() -> None:
    """Their dtypes are those of other batches, and so are their shapes but for the first axis."""
    online = OnlineMapDataset(SQUARE, seed=SEED, length=COUNT, fields=ALL_FIELDS, augment=True)
    for empty, others in zip(online[0:0], online[:1], strict=True):
        assert len(empty) == 0
        assert empty.dtype == others.dtype
        assert empty.ndim == others.ndim


def test_a_batch_keeps_the_stored_maps_beside_the_served_ones() -> None:
    """Numbers, grids and terrain before augmentation and inflation, and the symmetries."""
    dataset = OnlineMapDataset(
        SQUARE, SEED, 30, "train", problems="random", augment=True, radius=0.1
    )
    batch = dataset._batch(np.arange(12), 0)
    assert batch.map_numbers.max() > 11  # those of other splits are left out
    drawn = generate(SQUARE, SEED, batch.map_numbers)
    assert (drawn.split == 0).all()
    np.testing.assert_array_equal(batch.stored_terrain, drawn.terrain)
    np.testing.assert_array_equal(batch.stored_grids, drawn.occupancy)
    assert batch.terrain is not None
    assert batch.stored_terrain is not None
    for k, code in enumerate(batch.symmetries.tolist()):
        inflated = inflate_terrain(batch.stored_terrain[k], 0.1 / SQUARE.resolution)
        np.testing.assert_array_equal(batch.terrain[k], transformed(inflated, code))
    plain = OnlineMapDataset(SQUARE, SEED, 30)._batch(np.arange(3), 0)
    assert plain.symmetries.tolist() == [0, 0, 0]
    assert plain.map_numbers.tolist() == [0, 1, 2]
    np.testing.assert_array_equal(plain.terrain, plain.stored_terrain)


def test_fields_of_maps_without_terrain_read_no_stored_maps() -> None:
    """Not even the field terrain, which is 1 on free cells then."""

    def refuse() -> Any:
        raise AssertionError("these fields need no stored maps")

    grids = np.array([[[0, 1], [0, 0]]], np.uint8)
    batch = Batch(
        movement=Movement(8),
        search="astar",
        grids=grids,
        starts=np.array([[0, 0]]),
        goals=np.array([[1, 1]]),
        problems=np.array([0]),
        compute_map_indices=lambda: np.array([0]),
        compute_rooms=lambda: Rooms(np.zeros((1, 1, 1), np.float32), np.zeros((1, 1, 2), np.int64)),
        compute_map_numbers=refuse,
        compute_stored_maps=refuse,
        symmetries=np.zeros(1, np.int64),
        requested_fields=tuple(FIELDS),
    )
    for name, compute in FIELDS.items():
        if name != "image":  # A picture is that of the stored map.
            compute(batch)
    assert batch.terrain is None
    assert batch.stored_terrain is None
    assert FIELDS["terrain"](batch).tolist() == [[[[1, 0], [1, 1]]]]


def test_the_dtype_of_maps_and_masks_holds_for_terrain_with_unchanged_values() -> None:
    """In a dataset, and in a data module."""
    fields = ("terrain", "goal_mask", "optimal_moves")
    plain = OnlineMapDataset(HILLS, SEED, 8, fields=fields)[:]
    cast = OnlineMapDataset(HILLS, SEED, 8, fields=fields, dtype="float32")[:]
    assert plain.terrain.dtype == torch.uint8
    assert cast.terrain.dtype == torch.float32
    assert cast.optimal_moves.dtype == torch.uint8
    assert torch.equal(cast.terrain, plain.terrain.float())
    assert plain.terrain.max() == 91
    assert OnlineMapDataset(HILLS, SEED, 8, fields=("terrain",), dtype="bfloat16")[0][0].dtype == (
        torch.bfloat16
    )
    module = MapDataModule(None, build=HILLS, batch_size=8, fields=fields, dtype="float16")
    batch = next(iter(module.train_dataloader()))
    assert batch.terrain.dtype == torch.float16
    assert batch.terrain.max() == 91


def test_mixed_training_stacks_terrain_of_both_kinds_of_maps() -> None:
    """Maps without terrain serve ones on their free cells."""
    fields = ("map", "terrain", "cost")
    uniform = OnlineMapDataset(Maze((9, 11)), SEED, 8, fields=fields)
    costly = OnlineMapDataset(HILLS, SEED, 8, fields=fields)
    (batch,) = DataLoader(torch.utils.data.ConcatDataset([uniform, costly]), batch_size=16)
    assert batch.terrain.shape == (16, 1, 9, 11)
    assert torch.equal(batch.terrain[:8], 1 - batch.map[:8])
    assert torch.equal(batch.terrain == 0, batch.map == 1)
    assert batch.terrain[8:].max() > 1


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize("field", ["waypoints", Waypoints(8)], ids=str)
def test_waypoints_on_terrain_are_refused_when_a_dataset_is_made(field: Any) -> None:
    """Since taut lines are shortest only where all free cells cost the same."""
    message = "fields: waypoints and bends: got maps with terrain, expected maps whose free cells"
    with pytest.raises(ValueError, match=message):
        OnlineMapDataset(HILLS, fields=("map", field))
    with pytest.raises(ValueError, match=message):
        ProblemSetDataset(problem_set(Movement()), fields=("map", field))
    data = MapDataModule(None, build=HILLS, fields=("map", field))
    with pytest.raises(ValueError, match=message):
        data.setup("fit")


@dataclass(frozen=True)
class Expensive(Terrain):
    """Long detours through cells of the highest cost, on maps from number 2 on."""

    name: ClassVar[str] = "expensive"

    def draw(self, seed: int, indices: Ints) -> Maps:
        """Return the maps."""
        terrain = np.ones((len(indices), *self.map_size), np.uint8)
        terrain[indices >= 2] = 255
        terrain[:, 1, :-1] = 0
        maps = super().draw(seed, indices)
        seed_points = np.broadcast_to([[0, 0], [2, 0]], (len(indices), 2, 2)).copy()
        occupancy = (terrain == 0).astype(np.uint8)
        return replace(
            with_occupancy(maps, occupancy),
            terrain=terrain,
            seed_points=seed_points,
            rooms=np.full(len(indices), 2),
        )


def with_occupancy(maps: Maps, occupancy: Array) -> Maps:
    """Return maps with other cells."""
    from mapdata.generators.maps import pack

    return replace(maps, packed=pack(occupancy))


@pytest.mark.parametrize(
    ("field", "problems"),
    [
        ("path", "route"),
        ("cost", "random"),
        ("start", Random(distance=(10, None))),
        ("start", Random(length=(3, None))),
        ("cost_to_go", "random"),
        ("connection_matrix", "random"),
    ],
)
def test_costs_that_are_too_high_are_refused_by_the_number_of_the_map(
    field: str, problems: Any
) -> None:
    """Rather than served inexactly."""
    generator = Expensive((3, 4000), seed_points=2, obstacles=0.0, movement=Movement(8))
    options: dict[str, Any] = {"fields": (field,), "problems": problems, "sampling_seed": 1}
    assert len(OnlineMapDataset(generator, 0, 4, **options)[:2][0]) == 2
    dataset = OnlineMapDataset(generator, 0, 4, **options)
    epochs = 20
    numbers = np.arange(4 * epochs)
    with pytest.raises(ValueError, match=r"map [23]: terrain: a path costs 1,\d\d\d,\d\d\d"):
        [dataset.__getitems__(batch) for batch in np.split(numbers, epochs)]
    one_cost = Movement(8, diagonal_cost=1)
    assert len(OnlineMapDataset(generator, 0, 4, movement=one_cost, **options)[:][0]) == 4


# --- shards ---------------------------------------------------------------------------------------

OVER_MAZE = Terrain(costs=(1, 7, 30), scale=3, over=Maze((17, 21), corridor=3))

FAMILIES: dict[str, Any] = {"terrain": "terrain", "tiles": "tiles", "over a maze": OVER_MAZE}

families = pytest.mark.parametrize(
    "name", ["terrain", "tiles", pytest.param("over a maze", marks=pytest.mark.slow)]
)
"""Each of `FAMILIES`; one of them is slow."""


@pytest.fixture(scope="module")
def roots(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Datasets with terrain, in shards of 5 maps."""
    folder = tmp_path_factory.mktemp("terrain")
    for name, recipe in FAMILIES.items():
        build(folder / name, recipe, maps=12, seed=SEED, shard_size=5, workers=1)
    return {name: str(folder / name) for name in FAMILIES}


@movements
@families
@pytest.mark.parametrize("radius", [0.0, 0.1])
def test_shards_and_online_maps_serve_the_same_random_problems(
    roots: dict[str, str], name: str, movement: Movement, radius: float
) -> None:
    """All fields, bit for bit; maps without a problem are replaced by different ones."""
    for problems in (Random(), Random(distance=(9, 400), hardness=(1.1, None))):
        options: dict[str, Any] = {
            "fields": ALL_FIELDS,
            "problems": problems,
            "movement": movement,
            "radius": radius,
            "augment": True,
        }
        offline = MapDataset(roots[name], **options)._batch(np.arange(12), 1)
        online = OnlineMapDataset(FAMILIES[name], SEED, 12, **options)._batch(np.arange(12), 1)
        same = np.flatnonzero(offline.map_numbers == online.map_numbers)
        assert len(same) > 8
        for attribute in ("stored_terrain", "stored_grids", "symmetries"):
            np.testing.assert_array_equal(
                getattr(offline, attribute)[same], getattr(online, attribute)[same]
            )
        batches = [
            MapDataset(roots[name], **options)[same],
            OnlineMapDataset(FAMILIES[name], SEED, 12, **options)[same],
        ]
        samples.assert_same(*batches)


@searches
@movements
@families
def test_shards_and_online_maps_serve_the_same_routes(
    roots: dict[str, str], name: str, movement: Movement, search: str
) -> None:
    """The stored labels, or under another movement those solved anew, are those of the map."""
    options: dict[str, Any] = {"fields": ALL_FIELDS, "search": search}
    stored = MapDataset(roots[name], **options)
    anew = MapDataset(roots[name], movement=movement, problems="pairs", **options)
    assert stored.has_terrain
    assert stored.info.has_terrain
    for offline, source in ((stored, "route"), (anew, "pairs")):
        online = OnlineMapDataset(
            FAMILIES[name], SEED, 12, movement=offline.movement, problems=source, **options
        )
        numbers = offline._batch(np.arange(len(offline)), 0).map_numbers
        batch = offline[:]
        for k in range(0, 12, 3):
            sample = online[k]
            is_same = (batch.start == sample.start).all(1) & (batch.goal == sample.goal).all(1)
            (row,) = np.flatnonzero(is_same.numpy() & (numbers == k))
            samples.assert_same(offline[int(row)], sample, without=("problem",))


def test_stored_samples_on_terrain_equal_the_reference(roots: dict[str, str]) -> None:
    """With stored labels, after a filter, and from a pickled dataset."""
    dataset = MapDataset(roots["over a maze"], fields=ALL_FIELDS)
    assert dataset.filter(hardness=(None, None), path_length=(3, None), rooms=(2, 9))
    costs = dataset[:].hardness
    view = dataset.filter(hardness=(None, float(costs.median())))
    assert 0 < len(view) < len(dataset)
    samples.assert_same(pickle.loads(pickle.dumps(view))[:], view[:])
    for k in (0, len(view) // 2):
        assert_fields_fit(view[k], view.movement, "astar")
    with pytest.raises(ValueError, match="waypoints and bends: got maps with terrain"):
        dataset.filter(bends=(0, 3))
    with pytest.raises(ValueError, match="fields: waypoints and bends: got maps with terrain"):
        MapDataset(roots["tiles"], fields=("map", "waypoints"))


def test_a_robot_gets_the_inflated_terrain_of_stored_routes(roots: dict[str, str]) -> None:
    """Its routes are solved anew."""
    for search in SEARCHES:
        dataset = MapDataset(
            roots["over a maze"], fields=ALL_FIELDS, problems="pairs", search=search, radius=0.1
        )
        batch = dataset._batch(np.arange(len(dataset)), 0)
        assert batch.terrain is not None
        assert batch.stored_terrain is not None
        assert len(dataset) > 3
        for k in range(0, len(dataset), len(dataset) // 3):
            inflated = inflate_terrain(batch.stored_terrain[k], 1.0)
            np.testing.assert_array_equal(batch.terrain[k], inflated)
            assert_fields_fit(dataset[k], dataset.movement, search)


def test_roots_with_and_without_terrain_are_no_dataset(
    roots: dict[str, str], tmp_path: Path
) -> None:
    """Each is opened as a dataset of its own; the error says so."""
    maze = Maze((17, 21), corridor=3)
    build(tmp_path / "maze", maze, maps=4, seed=SEED, workers=1)
    fields = ("map", "terrain", "cost")
    with pytest.raises(ValueError, match=r"have terrain, .* open them as datasets of their own"):
        MapDataset([roots["over a maze"], str(tmp_path / "maze")], fields=fields)
    costly = MapDataset(roots["over a maze"], fields=fields)
    uniform = MapDataset(tmp_path / "maze", fields=fields)
    (batch,) = DataLoader(torch.utils.data.ConcatDataset([uniform, costly]), batch_size=1000)
    assert torch.equal(batch.terrain == 0, batch.map == 1)
    assert batch.terrain[: len(uniform)].max() == 1
    assert batch.terrain[len(uniform) :].max() == 30
    twice = MapDataset([roots["tiles"], roots["tiles"]], fields=fields)
    samples.assert_same(twice[:12], twice[12:])


@pytest.mark.slow
def test_a_data_module_serves_terrain(roots: dict[str, str]) -> None:
    """With the fields, the dtype and the plot of its dataset."""
    data = MapDataModule(
        roots["terrain"], fields=("terrain", "cost_to_go"), dtype="float32", batch_size=4
    )
    batch = next(iter(data.train_dataloader()))
    assert batch.terrain.shape == (4, 1, 64, 64)
    assert batch.terrain.dtype == torch.float32
    assert (batch.cost_to_go[batch.terrain == 0] == -1).all()
    *_, scale = data.plot().figure.axes  # the colour bar of all maps
    assert scale.get_ylabel() == "cost_to_go"


# --- problem sets ---------------------------------------------------------------------------------


@cache
def problem_set(movement: Movement) -> ProblemSet:
    """Return problems on hills."""
    dataset = OnlineMapDataset(HILLS, SEED, COUNT, problems="random", movement=movement)
    batch = dataset._batch(np.arange(COUNT), 0)
    return ProblemSet(
        batch.grids, batch.starts, batch.goals, movement=movement, terrain=batch.terrain
    )


@searches
@movements
def test_a_problem_set_serves_all_fields_of_its_terrain(movement: Movement, search: str) -> None:
    """The rooms are the start and the goal."""
    problems = problem_set(movement)
    assert problems.terrain is not None
    dataset = ProblemSetDataset(problems, ALL_FIELDS, search=search)
    for k in range(0, COUNT, 2):
        sample = dataset[k]
        np.testing.assert_array_equal(sample.terrain[0], problems.terrain[k])
        assert_fields_fit(sample, movement, search)
    batch = dataset._batch(np.array([4, 1]), 0)
    assert batch.map_numbers.tolist() == [4, 1]
    np.testing.assert_array_equal(batch.stored_terrain, problems.terrain[[4, 1]])
    augmented = ProblemSetDataset(problems, ALL_FIELDS, augment=True)
    for k in range(3):
        assert_symmetric_fields_fit(augmented[k], movement)


def test_problems_that_share_a_terrain_share_its_number() -> None:
    """As pictures of it must be the same."""
    terrain = np.array([[1, 2, 3], [1, 0, 9]], np.uint8)
    problems = ProblemSet(
        np.broadcast_to(terrain == 0, (3, 2, 3)),
        np.array([[0, 0], [0, 1], [1, 0]]),
        np.array([[0, 2], [1, 2], [1, 2]]),
        Movement(),
        terrain=np.broadcast_to(terrain, (3, 2, 3)),
    )
    batch = ProblemSetDataset(problems, ("terrain", "cost"))._batch(np.arange(3), 0)
    assert batch.map_numbers.tolist() == [0, 0, 0]
    np.testing.assert_array_equal(batch.stored_terrain, [terrain] * 3)
