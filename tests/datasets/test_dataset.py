"""Datasets: stored problems are those of the labels, drawn ones meet their conditions, and workers
change nothing; on maps with terrain and without it.
"""

from __future__ import annotations

import copy
import math
import pickle
import random
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
import torch
from helpers import hostile, reference, samples
from helpers.builds import SOUND_SEED, SOUND_SPEC, publish
from helpers.examples import slow
from helpers.figures import assert_lines, drawn, figure_of
from helpers.imported import imported
from helpers.specs import MOVEMENTS
from scipy import stats
from torch.utils.data import ConcatDataset, DataLoader, Dataset, Subset, random_split

from mapdata import (
    DatasetNotFoundError,
    Labels,
    MapDataset,
    MapGenerator,
    Maps,
    MapSpec,
    Movement,
    OnlineMapDataset,
    Pairs,
    ProblemSet,
    ProblemSetDataset,
    Random,
    Route,
    Sample,
    ShardError,
    apply_symmetry,
    generate,
    inflate,
    label,
)
from mapdata.datasets.arguments import FieldFunction
from mapdata.datasets.problem_dataset import ProblemDataset, keep_freed_memory
from mapdata.formats import Collection, ForeignMap, import_maps
from mapdata.plotting import COLOURS
from mapdata.shards import MANIFEST, Manifest, read_manifest

Array = npt.NDArray[Any]
SPECS: dict[str, MapGenerator] = {
    "square": samples.SPEC,
    "rough": samples.ROUGH,
    "wide": samples.WIDE,
}
SEARCHES = reference.SEARCHES
SPLITS = ("train", "val", "test")
STORED: dict[str, type[Route] | type[Pairs]] = {"route": Route, "pairs": Pairs}
MAPS, SEED = 60, 5


@pytest.fixture(scope="module")
def roots(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Datasets of 60 maps in four shards."""
    folder = tmp_path_factory.mktemp("dataset")
    return {
        name: samples.build_small(folder / name, generator, maps=MAPS, seed=SEED)
        for name, generator in SPECS.items()
    }


@pytest.fixture(scope="module")
def root(roots: dict[str, str]) -> str:
    """The dataset of square maps."""
    return roots["square"]


@cache
def labels_of(name: str, seed: int = SEED) -> Labels:
    """Return the labels that a dataset holds."""
    return label(generate(SPECS[name], seed, range(MAPS)))


def costs_of(maps: Maps) -> Array:
    """Return the costs of all cells, (N, H, W): without terrain, 1 on free cells."""
    return 1 - maps.occupancy if maps.terrain is None else maps.terrain


class Problem(NamedTuple):
    """A stored problem: a map and two of its rooms."""

    map: int
    first: int
    second: int


def problems_of(
    labels: Labels, problems: str, split: str | None, unsolvable: bool = False
) -> list[Problem]:
    """Return the problems of the design: segments or all pairs, without those of length 0, or
    without a path.
    """
    found = []
    for i in range(len(labels.maps)):
        if split is not None and labels.maps.split[i] != SPLITS.index(split):
            continue
        n, matrix = int(labels.maps.rooms[i]), labels.matrix("astar", i)
        pairs = (
            [(q, q + 1) for q in range(n - 1)]
            if problems == "route"
            else np.argwhere(np.triu(np.ones((n, n)), 1)).tolist()
        )
        for a, b in pairs:
            if matrix[a, b] > 0 or (unsolvable and matrix[a, b] < 0):
                found.append(Problem(i, int(a), int(b)))
    return found


# --- stored problems ----------------------------------------------------------------------------


@pytest.mark.parametrize("unsolvable", [False, True])
@pytest.mark.parametrize("search", ["bfs", "astar"])
@pytest.mark.parametrize("problems", STORED)
@pytest.mark.parametrize("name", SPECS)
def test_stored_problems(
    roots: dict[str, str], name: str, problems: str, search: str, unsolvable: bool
) -> None:
    """Map, start, goal, path, cost and iterations are the labels', in order, for each split and for
    all; so are the costs between rooms.
    """
    labels = labels_of(name)
    movement = SPECS[name].movement
    fields = (
        "map",
        "terrain",
        "start",
        "goal",
        "path",
        "cost",
        "iterations",
        "length",
        "connection_matrix",
    )
    for split in (None, *SPLITS):
        truth = problems_of(labels, problems, split, unsolvable)
        dataset = MapDataset(
            roots[name], split, fields, problems=STORED[problems](unsolvable), search=search
        )
        assert len(dataset) == len(truth) > 5
        for one, sample in _pairs(truth, dataset):
            grid = labels.maps.occupancy[one.map]
            start, goal = (
                tuple(labels.maps.seed_points[one.map, room].tolist())
                for room in (one.first, one.second)
            )
            costs = costs_of(labels.maps)[one.map]
            np.testing.assert_array_equal(sample.map[0], grid)
            np.testing.assert_array_equal(sample.terrain[0], costs)
            assert (samples.cell_of(sample.start), samples.cell_of(sample.goal)) == (start, goal)
            matrix = labels.matrix(search, one.map).astype(np.float32)
            assert sample.cost == matrix[one.first, one.second]
            rooms = len(matrix)
            np.testing.assert_array_equal(sample.connection_matrix[:rooms, :rooms], matrix)
            path = samples.cells_of(sample.path)
            assert len(path) == sample.length
            if problems == "route":
                assert path == [
                    tuple(cell) for cell in labels.segment(search, one.map, one.first).tolist()
                ]
                assert sample.iterations == labels.iterations(search, one.map)[one.first]
            else:
                found = SEARCHES[search](grid.tolist(), start, goal, movement, costs.tolist())
                assert (path, int(sample.iterations)) == (found.path, found.iterations)


def _pairs(truth: list[Problem], dataset: MapDataset) -> Iterator[tuple[Problem, Sample]]:
    """Yield each third problem with its sample."""
    for k in range(0, len(truth), 3):
        yield truth[k], dataset[k]


def test_unsolvable_problems_occur(root: str) -> None:
    """What `unsolvable` adds has no path: no cells, cost -1, hardness -1."""
    every = MapDataset(
        root, fields=("cost", "path", "length", "hardness"), problems=Route(unsolvable=True)
    )[:]
    without = every.length == 0
    assert 0 < without.sum() == len(every.cost) - len(MapDataset(root))
    assert (every.path[without] == -1).all()
    assert set(every.cost[without].tolist()) == set(every.hardness[without].tolist()) == {-1.0}
    assert (every.cost[~without] > 0).all()


def test_splits_share_no_map_and_cover_all(root: str) -> None:
    """Each map is in one split, whatever the problems."""
    items = {split: set(MapDataset(root, split).table()["item"]) for split in SPLITS}
    assert sum(map(len, items.values())) == MAPS
    assert set.union(*items.values()) == set(range(MAPS))
    for problems in ("route", "pairs", "random"):
        lengths = [len(MapDataset(root, split, problems=problems)) for split in SPLITS]
        assert min(lengths) > 0
        assert sum(lengths) == len(MapDataset(root, problems=problems))


@pytest.mark.parametrize("movement", MOVEMENTS)
@pytest.mark.parametrize("search", ["bfs", "astar"])
@pytest.mark.parametrize("name", SPECS)
def test_another_movement_is_solved_on_the_fly(
    roots: dict[str, str], name: str, search: str, movement: Movement
) -> None:
    """Paths, costs, matrices under any movement are the reference's, on the same problems."""
    fields = (
        "map",
        "terrain",
        "start",
        "goal",
        "path",
        "cost",
        "iterations",
        "connection_matrix",
        "seed_points",
    )
    dataset = MapDataset(roots[name], "val", fields, search=search, movement=movement)
    assert dataset.movement == movement
    for k in range(0, len(dataset), 4):
        sample = dataset[k]
        grid = samples.grid_of(sample.map)
        costs = sample.terrain[0].tolist()
        start, goal = samples.cell_of(sample.start), samples.cell_of(sample.goal)
        found = SEARCHES[search](grid, start, goal, movement, costs)
        assert samples.cells_of(sample.path) == found.path
        assert (sample.cost, int(sample.iterations)) == (np.float32(found.cost), found.iterations)
        seed_points = samples.cells_of(sample.seed_points)
        matrix = reference.reference_matrix(
            SEARCHES[search], grid, seed_points, movement, costs
        ).astype(np.float32)
        np.testing.assert_array_equal(
            sample.connection_matrix[: len(seed_points), : len(seed_points)], matrix
        )


def test_the_stored_movement_may_be_named(root: str) -> None:
    """Asking for what is stored changes nothing."""
    samples.assert_same(MapDataset(root, movement=Movement())[:9], MapDataset(root)[:9])


def test_several_roots(tmp_path: Path, root: str) -> None:
    """One dataset over all of them, in order; they must have one map size and one movement."""
    other = samples.build_small(
        tmp_path / "other", replace(samples.SPEC, rooms=(6, 7)), maps=20, seed=9
    )
    both = MapDataset([root, tmp_path / "other"], fields=("map", "path", "seed_points"))
    first, second = (
        MapDataset(each, fields=("map", "path", "seed_points")) for each in (root, other)
    )
    assert len(both) == len(first) + len(second)
    assert both[0].seed_points.shape == (7, 2)
    for k in (0, len(first) - 1):
        samples.assert_same(both[k], first[k], without=("seed_points",))
    for k in (0, len(second) - 1):
        samples.assert_same(both[len(first) + k], second[k])
    mixed = both[[len(first) - 1, len(first)]]
    assert torch.equal(mixed.map[0], first[-1].map)
    assert torch.equal(mixed.map[1], second[0].map)
    assert len(both.table()) == MAPS + 20
    wide = samples.build_small(tmp_path / "wide", samples.WIDE, maps=2)
    diagonal = samples.build_small(
        tmp_path / "diagonal", replace(samples.SPEC, movement=Movement(8)), maps=2
    )
    with pytest.raises(ValueError, match=r"root: .*wide has map_size \(9, 70\), .* has \(20, 20\)"):
        MapDataset([root, wide])
    with pytest.raises(ValueError, match=r"root: .*diagonal has movement"):
        MapDataset([root, diagonal])


# --- indices ------------------------------------------------------------------------------------


@pytest.mark.parametrize("online", [False, True])
def test_indices_are_those_of_a_sequence(root: str, online: bool) -> None:
    """Numbers from either end, slices, lists, arrays, tensors; anything else is refused."""
    dataset: MapDataset | OnlineMapDataset
    dataset = OnlineMapDataset(samples.SPEC, length=50) if online else MapDataset(root)
    n = len(dataset)
    one = dataset[3]
    for i in (np.int64(3), torch.tensor(3), np.array(3), 3 - n):
        samples.assert_same(dataset[i], one)
    samples.assert_same(dataset[-1], dataset[n - 1])
    for i in (n, -n - 1, 10**12):
        with pytest.raises(IndexError, match=f"{i} is out of range for {n} problems"):
            dataset[i]
    batch = dataset[[4, 1, -2]]
    assert isinstance(batch, Sample)
    for k, i in enumerate((4, 1, n - 2)):
        assert torch.equal(batch.map[k], dataset[i].map)
        assert torch.equal(batch.goal[k], dataset[i].goal)
    for indices in ((4, 1, -2), np.array([4, 1, n - 2], np.int32), torch.tensor([4, 1, -2])):
        samples.assert_same(dataset[indices], batch)
    samples.assert_same(dataset[2:9], dataset[list(range(2, 9))])
    samples.assert_same(dataset[-3:], dataset[[n - 3, n - 2, n - 1]])
    samples.assert_same(dataset[9:1:-3], dataset[[9, 6, 3]])
    with pytest.raises(IndexError):
        dataset[[0, -n - 1]]
    for bad in ("3", 2.0, None, [1.5], True, np.True_):
        with pytest.raises(TypeError):
            dataset[bad]


@pytest.mark.parametrize("as_mask", [np.array, list, torch.tensor])
def test_a_mask_selects_problems_as_in_a_problem_set(
    root: str, as_mask: Callable[..., Any]
) -> None:
    """The places where it is true, as numpy names them; perhaps none."""
    dataset = MapDataset(root)
    mask = np.arange(len(dataset)) % 7 == 2
    samples.assert_same(dataset[as_mask(mask)], dataset[np.flatnonzero(mask)])
    assert len(dataset[as_mask(np.zeros(len(dataset), bool))].map) == 0


TWELVE: dict[str, Callable[[], Any]] = {
    "problem set": lambda: ProblemSet.sample("maze15", 0, 12, movement=Movement(4)),
    "its dataset": lambda: ProblemSetDataset(TWELVE["problem set"]()),
    "online": lambda: OnlineMapDataset("maze15", length=12),
}
"""What holds twelve problems."""


@pytest.mark.parametrize("mask", [np.ones(11, bool), [True] * 13, np.ones((12, 1), bool), [False]])
@pytest.mark.parametrize("kind", TWELVE)
def test_a_mask_of_another_shape_is_refused(kind: str, mask: Any) -> None:
    """By datasets and problem sets in the same words."""
    with pytest.raises(IndexError, match=r"^indices: got a mask of shape .*, expected \(12,\)"):
        TWELVE[kind]()[mask]


def test_a_mask_selects_what_is_plotted(root: str) -> None:
    """As a list of the same problems; another length is refused."""
    dataset = MapDataset(root)
    mask = np.arange(len(dataset)) == 3
    assert len(dataset.plot(mask).figure.axes) == len(dataset.plot([3]).figure.axes)
    with pytest.raises(IndexError, match="got a mask of shape"):
        dataset.plot(mask[1:])


@pytest.mark.parametrize("online", [False, True])
def test_epochs_are_in_the_index(root: str, online: bool) -> None:
    """`index + epoch * len` is problem `index`, with what is drawn anew drawn for that epoch."""
    fields = ("problem", "map", "start", "goal")
    dataset: MapDataset | OnlineMapDataset
    if online:
        dataset = OnlineMapDataset(samples.SPEC, 5, 40, fields=fields)
    else:
        dataset = MapDataset(root, fields=fields, problems="random")
    n = len(dataset)
    epochs = [dataset.__getitems__([k + epoch * n for k in range(n)]).batch for epoch in (0, 1, 2)]
    samples.assert_same(epochs[0], dataset[:])
    for later in epochs[1:]:
        assert later.problem.tolist() == list(range(n))
        same = (later.start == epochs[0].start).all(dim=1) & (later.goal == epochs[0].goal).all(
            dim=1
        )
        assert same.float().mean() < 0.7  # a map of two rooms has one segment
    stored = MapDataset(root, fields=fields)
    samples.assert_same(stored.__getitems__([3 + 7 * len(stored)]).batch, stored[3:4])


# --- map_index and symmetry ---------------------------------------------------------------------

RARE = {
    "square": Random(distance=(22, None)),
    "wide": Random(distance=(22, None)),
    "rough": Random(distance=(400, None)),
}
"""Problems that many of the small maps do not have, so that other maps are served instead."""


def assert_served_by_number(batch: Sample, costs: Array) -> None:
    """Check that the maps of a batch are those that `map_index` names, after `symmetry`.

    Args:
        batch: with the fields ``map``, ``terrain``, ``map_index`` and ``symmetry``.
        costs: (N, H, W), those of all maps of the dataset, as `costs_of` returns them.
    """
    served = torch.from_numpy(costs)[batch.map_index][:, None]
    assert torch.equal(apply_symmetry(served, batch.symmetry), batch.terrain)
    assert torch.equal(batch.terrain == 0, batch.map == 1)


@pytest.mark.parametrize("split", [None, *SPLITS])
@pytest.mark.parametrize("problems", ["route", "rare", Pairs(unsolvable=True), "random"], ids=str)
@pytest.mark.parametrize("name", SPECS)
def test_map_index_is_the_number_of_the_served_map_in_all_splits(
    roots: dict[str, str], name: str, problems: str | Pairs, split: str | None
) -> None:
    """It is that of `generate` and `read_shard`, for substitutes, online and mirrored maps, too."""
    how: dict[str, Any] = {
        "fields": ("map", "terrain", "seed_points", "problem", "map_index", "symmetry"),
        "problems": RARE[name] if problems == "rare" else problems,
        "augment": split in (None, "train"),
    }
    stored = MapDataset(roots[name], split, **how)
    maps = labels_of(name).maps
    splits = {0, 1, 2} if split is None else {SPLITS.index(split)}
    for epoch in (0, 1):
        batch = stored.__getitems__(np.arange(len(stored)) + epoch * len(stored)).batch
        assert_served_by_number(batch, costs_of(maps))
        is_plain = batch.symmetry == 0
        own_points = torch.from_numpy(maps.seed_points)[batch.map_index]
        assert torch.equal(batch.seed_points[is_plain], own_points[is_plain])
        assert set(maps.split[batch.map_index].tolist()) == splits
    if problems == "rare":
        own = np.flatnonzero(np.isin(maps.split, [*splits]))
        assert (batch.map_index.numpy() != own).sum() > len(own) / 10
    online = OnlineMapDataset(SPECS[name], SEED, 12, split, **how)[:]
    assert_served_by_number(online, costs_of(generate(SPECS[name], SEED, range(1000))))


def test_map_index_stays_under_filters_and_a_radius(root: str) -> None:
    """Problems are left out, and the maps of the others keep their numbers."""
    fields = ("map", "terrain", "map_index", "symmetry")
    maps = labels_of("square").maps
    filtered = MapDataset(root, "train", fields).filter(rooms=(4, 9))
    assert 0 < len(filtered) < len(MapDataset(root, "train"))
    assert_served_by_number(filtered[:], costs_of(maps))
    robot = MapDataset(root, "train", fields, radius=0.1)
    inflated = [inflate(grid, 0.1 / SPECS["square"].resolution) for grid in maps.occupancy]
    assert_served_by_number(robot[:], 1 - np.stack(inflated))


def test_map_index_counts_the_maps_of_several_roots_one_root_after_another(
    roots: dict[str, str],
) -> None:
    """As the tables do: map i of the second root has the number of maps of the first, plus i."""
    fields = ("map", "terrain", "map_index", "symmetry")
    costs = costs_of(labels_of("square").maps)
    for problems in ("route", "random"):
        dataset = MapDataset([roots["square"]] * 2, "val", fields, problems=problems)
        batch = dataset[:]
        assert_served_by_number(batch, np.concatenate([costs, costs]))
        assert set(batch.map_index.tolist()) == set(dataset.table()["item"])
    assert batch.map_index.max() >= MAPS


# --- random problems ----------------------------------------------------------------------------


@pytest.mark.parametrize("movement", MOVEMENTS)
@pytest.mark.parametrize("online", [False, True])
@pytest.mark.parametrize("name", ["square", "rough"])
def test_random_problems(
    roots: dict[str, str], name: str, online: bool, movement: Movement
) -> None:
    """Start and goal are free, differ and are connected; one problem a map; conditions hold."""
    fields = ("map", "terrain", "start", "goal", "path", "cost", "hardness")
    for conditions in (
        Random(),
        Random((12, 20)),
        Random(hardness=(1.05, 1.3)),
        Random(length=(None, 9)),
    ):
        arguments: dict[str, Any] = {"fields": fields, "problems": conditions, "movement": movement}
        dataset: MapDataset | OnlineMapDataset
        if online:
            dataset = OnlineMapDataset(SPECS[name], SEED, MAPS, "train", **arguments)
        else:
            dataset = MapDataset(roots[name], "train", **arguments)
            assert len(dataset) == (labels_of(name).maps.split == 0).sum()
        for k in range(0, len(dataset), 5):
            sample = dataset[k]
            grid = samples.grid_of(sample.map)
            costs = sample.terrain[0].tolist()
            start, goal = samples.cell_of(sample.start), samples.cell_of(sample.goal)
            assert reference.is_free(grid, start)
            assert start != goal
            best = reference.reference_distances(grid, start, movement, costs)[goal]
            assert sample.cost == np.float32(reference.as_float(best, movement, costs))
            assert (
                samples.cells_of(sample.path)
                == reference.reference_astar(grid, start, goal, movement, costs).path
            )
            found = np.array(
                [[sample.cost], [sample.hardness], [len(samples.cells_of(sample.path))]]
            )
            bands = np.array(conditions.bands, np.float32)
            assert ((found >= bands[:, :1]) & (found <= bands[:, 1:])).all()


def test_random_problems_depend_on_seed_epoch_and_number_alone(root: str) -> None:
    """Equal whatever was asked before, in any batch, with any state of any generator; else
    different.
    """

    def starts(sampling_seed: int, epoch: int, split: str | None = None) -> torch.Tensor:
        dataset = MapDataset(
            root, split, ("start", "goal"), problems="random", sampling_seed=sampling_seed
        )
        random.seed(len(dataset) + epoch)
        np.random.seed(epoch)  # noqa: NPY002  (what others may do)
        torch.manual_seed(epoch)
        last = dataset.__getitems__([len(dataset) - 1]).batch
        assert torch.equal(last.start[0], dataset[-1].start)
        batch = dataset.__getitems__([k + epoch * len(dataset) for k in range(len(dataset))]).batch
        return torch.cat((batch.start, batch.goal), dim=1)

    first = starts(0, 0)
    assert torch.equal(starts(0, 0), first)
    for other in (starts(1, 0), starts(0, 1), starts(2**64 - 1, 0), starts(0, 2**20)):
        assert (other == first).all(dim=1).float().mean() < 0.1


@pytest.mark.slow
def test_random_problems_are_uniform() -> None:
    """Over many epochs on one open map, start and goal fall on each cell equally often."""
    generator = MapSpec((4, 5), (2, 2), (4, 4), (5, 5), passage_width=(1, 1))
    open_map = next(i for i in range(99) if not generate(generator, 0, [i]).occupancy.any())
    dataset = OnlineMapDataset(
        generator, 0, open_map + 1, fields=("start", "goal"), problems="random"
    )
    ends = [dataset.__getitems__([open_map + epoch * len(dataset)]).batch for epoch in range(4000)]
    for name in ("start", "goal"):
        cells = torch.cat([getattr(end, name) for end in ends])
        counts = np.bincount(cells[:, 0] * 5 + cells[:, 1], minlength=20)
        assert stats.chisquare(counts).pvalue > 1e-3


def test_conditions_that_no_map_meets(root: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """An error that names the conditions, instead of a search without end."""
    monkeypatch.setattr("mapdata.problems.substitutes.MAX_CELLS", 10**6)
    for dataset in (
        MapDataset(root, problems=Random(distance=(220, None))),
        OnlineMapDataset(samples.SPEC, problems=Random(distance=(220, None))),
    ):
        asked_for = r'problems: got {"random": {"distance": \[220.0, null\]}}: none on'
        with pytest.raises(ValueError, match=asked_for):
            dataset[0]


def test_maps_without_a_problem_are_replaced(root: str) -> None:
    """A condition that few maps meet: every sample meets it all the same, and others stay what they
    were.
    """
    for conditions in (Random(distance=(22, None)), Random(hardness=(1.7, None))):
        dataset = MapDataset(root, fields=("cost", "hardness", "map"), problems=conditions)
        batch = dataset[:]
        own = (
            batch.map.flatten(1) == torch.from_numpy(labels_of("square").maps.occupancy).flatten(1)
        ).all(dim=1)
        assert 0 < own.sum() < MAPS
        assert (batch.cost >= conditions.bands[0][0]).all()
        assert (batch.hardness >= conditions.bands[1][0]).all()
        samples.assert_same(
            dataset[7], dataset[[3, 7]]._make(value[1] for value in dataset[[3, 7]])
        )


# --- symmetries ---------------------------------------------------------------------------------

AUGMENTATION = 3
"""The stream of symmetries, as docs/format.md numbers it."""

GRID_FIELDS = (
    "map",
    "free",
    "terrain",
    "path_mask",
    "start_mask",
    "goal_mask",
    "optimal_mask",
    "cost_to_go",
    "heuristic_ratio",
    "path_probability",
    "clearance",
)
CELL_FIELDS = ("start", "goal", "path", "seed_points")
UNTURNED_FIELDS = (
    "length",
    "cost",
    "hardness",
    "iterations",
    "connection_matrix",
    "problem",
    "map_index",
)


def turned_grid(grid: Array, code: int) -> Array:
    """Return an array (H, W) after a symmetry: bits of the code flip, flip and transpose."""
    grid = np.flipud(grid) if code & 1 else grid
    grid = np.fliplr(grid) if code & 2 else grid
    return grid.T if code & 4 else grid


def turned_cells(cells: Array, code: int, shape: tuple[int, ...]) -> Array:
    """Return where cells (..., 2) are after a symmetry: where a turned grid has their numbers."""
    numbers = np.arange(np.prod(shape)).reshape(shape)
    turned = turned_grid(numbers, code)
    new_cells = np.empty((turned.size, 2), np.int64)
    new_cells[turned.ravel()] = np.argwhere(turned >= 0)
    is_padding = cells[..., :1] < 0
    return np.where(is_padding, cells, new_cells[numbers[cells[..., 0], cells[..., 1]]])


def turned_points(points: Array, code: int, shape: tuple[int, ...]) -> Array:
    """Return where points (..., 2) between cells are after a symmetry."""
    rows, columns = points[..., 0], points[..., 1]
    if code & 1:
        rows = shape[0] - rows
    if code & 2:
        columns = shape[1] - columns
    turned = np.stack((columns, rows) if code & 4 else (rows, columns), axis=-1)
    is_padding = points[..., :1] < 0
    return np.where(is_padding, points, turned)


def turned_moves(bits: Array, code: int) -> Array:
    """Return bit sets of moves (H, W) after a symmetry, which turns the directions, too."""
    compass = np.full((3, 3), -1)
    for move, (down, right) in enumerate(reference.STRAIGHT + reference.DIAGONAL):
        compass[1 + down, 1 + right] = move
    turned_compass = turned_grid(compass, code)
    turned = turned_grid(bits, code)
    moves = np.zeros_like(turned)
    for move in range(8):
        (new_move,) = compass[turned_compass == move]
        moves |= (turned >> move & 1) * np.uint8(1 << int(new_move))
    return moves


CUTTING = Movement(8, corner_cutting=True)
AUGMENTED: dict[str, tuple[str, dict[str, Any]]] = {
    "stored paths": ("square", {}),
    "stored paths with diagonals": ("wide", {"search": "bfs"}),
    "pairs": ("square", {"problems": Pairs(unsolvable=True)}),
    "another movement": ("square", {"movement": CUTTING, "search": "bfs"}),
    "a stricter movement": ("wide", {"movement": Movement(4), "problems": "pairs"}),
    "a robot": ("square", {"radius": 0.1, "problems": "pairs"}),
    "random problems": ("square", {"problems": "random", "movement": Movement(8)}),
    "random problems of a robot": ("wide", {"problems": Random((3, None)), "radius": 0.1}),
    "online": ("square", {"movement": CUTTING}),
    "online random problems": ("wide", {"problems": "random", "movement": Movement(8, True, 1)}),
    "a robot on terrain": ("rough", {"problems": "pairs", "radius": 0.1}),
    "random problems on terrain": ("rough", {"problems": "random", "movement": Movement(8)}),
}
"""Maps and arguments for each way in which a sample is made."""


QUICK_AUGMENTED = (
    "another movement",
    "random problems of a robot",
    "random problems on terrain",
)
"""Cases that README's test command tries; the others are slow."""


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=() if case in QUICK_AUGMENTED else pytest.mark.slow)
        for case in AUGMENTED
    ],
)
def test_an_augmented_sample_is_a_symmetry_of_the_plain_one(
    roots: dict[str, str], case: str
) -> None:
    """All fields are those of the same problem without `augment`, turned by numpy; the symmetry is
    drawn for the problem's number and the epoch.
    """
    name, arguments = AUGMENTED[case]
    fields = samples.TERRAIN_FIELDS if name == "rough" else samples.ALL_FIELDS
    how: dict[str, Any] = {"fields": fields, "sampling_seed": 11, **arguments}
    plain, augmented = (
        OnlineMapDataset(SPECS[name], SEED, 60, "train", augment=augment, **how)
        if case.startswith("online")
        else MapDataset(roots[name], "train", augment=augment, **how)
        for augment in (False, True)
    )
    shape = SPECS[name].map_size
    last_code = 7 if shape[0] == shape[1] else 3
    codes = set()
    for epoch in (0, 1):
        indices = np.arange(len(plain)) + epoch * len(plain)
        before, after = (each.__getitems__(indices).batch for each in (plain, augmented))
        for k, number in enumerate(before.problem.tolist()):
            word = reference.block(11, number, epoch, AUGMENTATION, 0)[0]
            code = reference.bounded(word, 0, last_code)
            codes.add(code)
            sample, turned = (
                {field: value[k].numpy() for field, value in zip(batch._fields, batch, strict=True)}
                for batch in (before, after)
            )
            for field in GRID_FIELDS:
                expected = turned_grid(sample[field][0], code)
                np.testing.assert_array_equal(turned[field][0], expected, field)
            for field in CELL_FIELDS:
                expected = turned_cells(sample[field], code, shape)
                np.testing.assert_array_equal(turned[field], expected, field)
            for field in UNTURNED_FIELDS:
                np.testing.assert_array_equal(turned[field], sample[field], field)
            assert (sample["symmetry"], turned["symmetry"]) == (0, code)
            expected = turned_moves(sample["optimal_moves"][0], code)
            np.testing.assert_array_equal(turned["optimal_moves"][0], expected)
            if "waypoints" in fields:
                expected = turned_points(sample["waypoints"], code, shape)
                np.testing.assert_array_equal(turned["waypoints"], expected)
            for field in ("image", "maze_image"):
                for channel, turned_channel in zip(sample[field], turned[field], strict=True):
                    np.testing.assert_array_equal(turned_channel, turned_grid(channel, code))
    assert codes == set(range(last_code + 1))
    checked = {*GRID_FIELDS, *CELL_FIELDS, *UNTURNED_FIELDS}
    others = {"optimal_moves", "waypoints", "image", "maze_image", "symmetry"}
    assert checked | others == {*samples.ALL_FIELDS}


@pytest.mark.parametrize("kind", ["stored", "augmented", "random", "online", "set", "terrain"])
def test_path_probability_is_that_of_astar_whatever_search_is_served(
    roots: dict[str, str], kind: str
) -> None:
    """It is the same for both searches, and at least 0.95 on the whole path of A*."""
    datasets: list[ProblemDataset] = []
    for search in ("astar", "bfs"):
        fields = ("path", "path_probability")
        movement = Movement(8)
        options: dict[str, Any] = {"search": search, "augment": kind == "augmented"}
        if kind == "set":
            problem_set = ProblemSet.sample("cave", seed=3, maps=12, movement=movement)
            datasets.append(ProblemSetDataset(problem_set, fields, **options))
        elif kind in ("online", "terrain"):
            preset = {"online": "narrow", "terrain": "tiles"}[kind]
            options["movement"] = movement
            datasets.append(OnlineMapDataset(preset, 7, 12, None, fields, **options))
        else:
            options["problems"] = "random" if kind == "random" else "route"
            datasets.append(MapDataset(roots["wide"], "train", fields, **options))
    count = min(len(datasets[0]), 40)
    by_astar, by_bfs = (dataset[:count] for dataset in datasets)
    assert not torch.equal(by_astar.path, by_bfs.path)
    assert torch.equal(by_astar.path_probability, by_bfs.path_probability)
    problem, step = (by_astar.path[:, :, 0] >= 0).nonzero(as_tuple=True)
    rows, columns = by_astar.path[problem, step].T
    assert by_astar.path_probability[problem, 0, rows, columns].min() >= 0.95


def test_augmentation_is_drawn_anew_each_epoch(root: str) -> None:
    """A function of (sampling seed, epoch, index), for stored and drawn problems alike."""
    for problems in ("route", "random"):

        def maps(sampling_seed: int, epoch: int, problems: str = problems) -> torch.Tensor:
            dataset = MapDataset(
                root,
                "train",
                ("map",),
                problems=problems,
                augment=True,
                sampling_seed=sampling_seed,
            )
            maps: torch.Tensor = dataset.__getitems__(
                [k + epoch * len(dataset) for k in range(len(dataset))]
            ).batch.map
            return maps

        first = maps(0, 0)
        assert torch.equal(maps(0, 0), first)
        for other in (maps(1, 0), maps(0, 1)):
            assert (other == first).flatten(1).all(dim=1).float().mean() < 0.4


# --- views and tables ---------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["square", "rough"])
def test_filters_keep_what_meets_all_conditions(roots: dict[str, str], name: str) -> None:
    """Each condition against the labels; a problem is the same in the view."""
    labels = labels_of(name)
    fields = ("problem", "map", "goal", "length", "hardness")
    dataset = MapDataset(roots[name], fields=fields, problems=Route(unsolvable=True))
    truth = problems_of(labels, "route", None, unsolvable=True)
    every = dataset[:]
    kept: dict[str, tuple[dict[str, Any], list[bool]]] = {
        "rooms": ({"rooms": (3, 4)}, [3 <= labels.maps.rooms[one.map] <= 4 for one in truth]),
        "path_length": (
            {"path_length": (5, 12)},
            [5 <= length <= 12 for length in every.length.tolist()],
        ),
        "reachable": ({"reachable": False}, [length == 0 for length in every.length.tolist()]),
        "all_connected": (
            {"all_connected": True},
            [bool(labels.all_connected[one.map]) for one in truth],
        ),
        "hardness": (
            {"hardness": (1.1, 9.0)},
            [1.1 <= value <= 9 for value in every.hardness.tolist()],
        ),
    }
    for conditions, keep in kept.values():
        view = dataset.filter(**conditions)
        assert isinstance(view, MapDataset)
        assert 0 < len(view) == sum(keep) < len(dataset)
        batch = view[:]
        chosen = torch.tensor(keep)
        for field in fields:  # a problem keeps its number, and with it what is drawn for it
            assert torch.equal(getattr(batch, field), getattr(every, field)[chosen]), field
        samples.assert_same(view[-1], view[len(view) - 1])
    both = dataset.filter(rooms=(3, 4)).filter(path_length=(5, 12))
    assert len(both) == len(dataset.filter(rooms=(3, 4), path_length=(5, 12)))
    assert len(both) == sum(
        a and b for a, b in zip(kept["rooms"][1], kept["path_length"][1], strict=True)
    )
    assert len(dataset) == len(truth)  # a view leaves the dataset as it is


def test_the_ends_of_a_range_are_in_it(root: str) -> None:
    """Of the hardness, too, which is float32; None leaves a side open."""
    dataset = MapDataset(root, fields=("length", "hardness"), movement=Movement(4))
    for name, values in (("path_length", dataset[:].length), ("hardness", dataset[:].hardness)):
        for value in values.unique().numpy():
            end = float(str(value))  # as one writes it: 1.2, and not the nearest float32
            for band, expected in (
                ((end, end), values == value),
                ((end, None), values >= value),
                ((None, end), values <= value),
            ):
                view = dataset.filter(**{name: band})  # type: ignore[arg-type]
                assert len(view) == int(expected.sum()), (name, band)


def test_a_list_that_changes_afterwards_changes_no_view(root: str) -> None:
    """A view that workers make again is the same."""
    rooms: Any = [2, 3]
    view = MapDataset(root).filter(rooms=rooms)
    rooms[1] = 9
    again = pickle.loads(pickle.dumps(view))
    assert len(again) == len(view) < len(MapDataset(root))


def test_filters_remember_how_they_were_made(root: str) -> None:
    """`filters` and the repr tell; a view survives pickling with its conditions."""
    view = MapDataset(root, "train").filter(rooms=(3, 5)).filter(hardness=(1.05, 4.0))
    assert view.filters == ({"rooms": (3, 5)}, {"hardness": (1.05, 4.0)})
    assert ".filter(rooms=(3.0, 5.0)).filter(hardness=(1.05, 4.0))" in repr(view)
    assert f"{len(view)} problems" in repr(view)
    assert MapDataset(root).filters == ()
    again = pickle.loads(pickle.dumps(view))
    assert (len(again), again.filters, again.split) == (len(view), view.filters, "train")
    samples.assert_same(again[:], view[:])
    assert len(view.filter(rooms=(99, 99))) == 0
    assert list(DataLoader(view.filter(rooms=(99, 99)), 4)) == []


def test_a_table_of_several_roots_numbers_maps_once(root: str) -> None:
    """One after another, as everywhere."""
    table = MapDataset([root, root]).table()
    assert table["item"].tolist() == list(range(2 * MAPS))
    assert table["label"].is_unique


def test_the_table_has_a_row_for_each_map(roots: dict[str, str]) -> None:
    """A row a map with every item that the paper lists, under its names."""
    for name, root in roots.items():
        labels = labels_of(name)
        maps = labels.maps
        table = MapDataset(root).table()
        assert len(table) == MAPS
        for i in range(MAPS):
            row, n = table.iloc[i], int(maps.rooms[i])
            assert (row["item"], row["label"], row["split"]) == (
                i,
                f"map{i}",
                SPLITS[maps.split[i]],
            )
            assert (row["resolution"], row["passage size"]) == (0.1, maps.passage_width[i])
            for k, side in enumerate(("rows", "columns")):
                assert row[f"seed {side}"] == maps.seed_points[i, :n, k].tolist()
                assert row[f"size {side}"] == maps.sizes[i, :n, k].tolist()
            assert row["direction for passages"] == maps.directions[i, : n - 1].flatten().tolist()
            assert row["connected"] == [bool(one) for one in maps.connected[i, : n - 1]]
            for search in ("bfs", "astar"):
                path = joined(labels.route(search, i))
                assert (
                    list(zip(row[f"{search} row path"], row[f"{search} column path"], strict=True))
                    == path
                )
                segments = labels.iterations(search, i).tolist()
                assert row[f"{search} segment iterations"] == segments
                assert row[f"{search} iterations"] == sum(segments)
                assert row[f"{search} connection matrix"] == labels.matrix(search, i).tolist()
            first, last = maps.segment_offsets[i : i + 2]
            assert row["reachable"] == labels.reachable[first:last].tolist()
        val = MapDataset(root, "val").table()
        assert set(val["split"]) == {"val"}
        assert val["item"].tolist() == np.flatnonzero(maps.split == 1).tolist()


def test_a_table_has_the_columns_that_are_asked_for(root: str) -> None:
    """In their order, with the values of the whole table; also for a split without maps."""
    whole = MapDataset(root).table()
    for names in (
        ["rooms", "item"],
        ["astar iterations", "all connected", "split"],
        [*whole][::-1],
    ):
        table = MapDataset(root).table(columns=names)
        assert list(table) == names
        assert table.equals(whole[names])
    assert list(MapDataset(root).filter(rooms=(99, 99)).table(["item"])) == ["item"]
    with pytest.raises(ValueError, match="columns: got 'passage width', expected one of"):
        MapDataset(root).table(columns=["passage width"])
    with pytest.raises(ValueError, match="each name once"):
        MapDataset(root).table(columns=["item", "item"])


def joined(route: list[npt.NDArray[np.int64]]) -> list[tuple[int, ...]]:
    """Join segments into one path; the cell in which two of them meet stands once."""
    path: list[tuple[int, ...]] = []
    for segment in route:
        cells = [tuple(cell) for cell in segment.tolist()]
        path += cells[1:] if path and cells and path[-1] == cells[0] else cells
    return path


# --- online -------------------------------------------------------------------------------------


@pytest.mark.parametrize("split", [None, *SPLITS])
@pytest.mark.parametrize("name", SPECS)
def test_online_maps_are_those_of_the_shards(
    roots: dict[str, str], name: str, split: str | None
) -> None:
    """Sample i is of the i-th map (of the split), bit for bit, with a problem of it that is
    right.
    """
    labels = labels_of(name)
    numbers = [i for i in range(MAPS) if split is None or SPLITS[labels.maps.split[i]] == split]
    fields = (
        "terrain",
        "start",
        "goal",
        "path",
        "cost",
        "iterations",
        "connection_matrix",
        "seed_points",
    )
    for problems in STORED:
        online = OnlineMapDataset(SPECS[name], SEED, len(numbers), split, fields, problems=problems)
        own = 0
        for k, i in enumerate(numbers):
            valid = [one for one in problems_of(labels, problems, split) if one.map == i]
            sample = online[k]
            if not valid:
                continue
            own += 1
            n = int(labels.maps.rooms[i])
            np.testing.assert_array_equal(sample.terrain[0], costs_of(labels.maps)[i])
            np.testing.assert_array_equal(sample.seed_points[:n], labels.maps.seed_points[i, :n])
            np.testing.assert_array_equal(
                sample.connection_matrix[:n, :n], labels.matrix("astar", i).astype(np.float32)
            )
            seed_points = [tuple(seed) for seed in labels.maps.seed_points[i, :n].tolist()]
            start, goal = samples.cell_of(sample.start), samples.cell_of(sample.goal)
            matching = [
                one
                for one in valid
                if (seed_points[one.first], seed_points[one.second]) == (start, goal)
            ]
            assert matching
            assert sample.cost == np.float32(
                labels.matrix("astar", i)[matching[0].first, matching[0].second]
            )
            if problems == "route":
                assert samples.cells_of(sample.path) == [
                    tuple(cell) for cell in labels.segment("astar", i, matching[0].first).tolist()
                ]
                assert sample.iterations == labels.iterations("astar", i)[matching[0].first]
        assert own > len(numbers) / 2
    how: dict[str, Any] = {
        "fields": samples.TERRAIN_FIELDS if name == "rough" else samples.ALL_FIELDS,
        "problems": "random",
        "augment": split in (None, "train"),
        "radius": 0.1,
    }
    stored = MapDataset(roots[name], split, **how)
    random_online = OnlineMapDataset(SPECS[name], SEED, len(numbers), split, **how)
    own = stored[:].map_index == random_online[:].map_index  # of others, the substitutes differ
    assert own.sum() > len(numbers) / 2
    some = own.nonzero().flatten()[::5]
    samples.assert_same(stored[some], random_online[some])


def test_online_problems_change_with_the_epoch() -> None:
    """Over the epochs every segment of a map gets its turn."""
    labels = labels_of("square")
    online = OnlineMapDataset(samples.SPEC, SEED, MAPS, fields=("start", "goal"))
    segments: dict[int, set[Any]] = {}  # start and goal of each, by the number of the map
    for one in problems_of(labels, "route", None):
        seed_points = labels.maps.seed_points[one.map].tolist()
        ends = (tuple(seed_points[one.first]), tuple(seed_points[one.second]))
        segments.setdefault(one.map, set()).add(ends)
    maps = sorted(segments)[::7]
    assert max(len(segments[i]) for i in maps) > 2
    for i in maps:
        seen = set()
        for epoch in range(60):
            batch = online.__getitems__([i + epoch * MAPS]).batch
            seen.add((samples.cell_of(batch.start[0]), samples.cell_of(batch.goal[0])))
        assert seen == segments[i]


def test_online_without_a_single_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    """Maps of one cell have none: an error, not a search without end."""
    monkeypatch.setattr("mapdata.problems.substitutes.MAX_MAPS", 1000)
    generator = MapSpec((1, 1), (2, 3), (1, 1), (1, 1), passage_width=(1, 1))
    for problems in (Route(), Pairs(), Random()):
        with pytest.raises(ValueError, match=f"problems: got {problems.name}: none on"):
            OnlineMapDataset(generator, problems=problems)[0]


def test_online_unsolvable() -> None:
    """Pairs without a path stay when they are asked for."""
    generator = replace(samples.SPEC, skip_probability=0.9)
    batch = OnlineMapDataset(
        generator, 1, 60, fields=("length", "cost", "path"), problems=Route(unsolvable=True)
    )[:]
    assert 0 < (batch.length == 0).sum() < 60
    assert ((batch.cost == -1) == (batch.length == 0)).all()


# --- what is refused ----------------------------------------------------------------------------

REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "split": ({"split": "training"}, "split: got 'training', expected one of train, val, test"),
    "fields-name": (
        {"fields": ("map", "paths")},
        "fields: got 'paths', expected a function or one of map, free",
    ),
    "fields-text": ({"fields": "map"}, "fields: got 'map', expected a sequence"),
    "fields-none": ({"fields": ()}, r"fields: got \(\), expected a sequence"),
    "fields-twice": ({"fields": ("map", "goal", "map")}, "fields: .*each name once"),
    "fields-lambda": (
        {"fields": ("map", lambda sample: sample.map)},
        "fields: .*use 'def', not 'lambda'",
    ),
    "fields-number": (
        {"fields": ("map", 3)},
        "fields: got 3, expected a function or one",
    ),
    "problems": ({"problems": "all"}, "problems: got 'all', expected one of route, pairs, random"),
    "search": ({"search": "dijkstra"}, "search: got 'dijkstra', expected one of bfs, astar"),
    "movement": ({"movement": 8}, r"movement: got 8, .* such as {connectivity: 8}"),
    "unsolvable": (
        {"problems": {"random": {"unsolvable": True}}},
        "problems: random: unknown key: unsolvable; known are",
    ),
    "distance": (
        {"problems": '{"random": {"distance": [7, 5]}}'},
        r"distance: got \[7, 5\], whose lowest number 7 is above its highest 5; expected",
    ),
    "augment-val": ({"split": "val", "augment": True}, "augment: would change the split 'val'"),
    "augment-test": ({"split": "test", "augment": True}, "augment: would change the split 'test'"),
    "sampling_seed": ({"sampling_seed": -1}, "sampling_seed: got -1, expected 0 to"),
    "sampling_seed-text": ({"sampling_seed": "7"}, "seed: got '7', expected an integer"),
    "max_length": ({"max_length": 0}, "max_length: got 0, expected an integer of at least 1"),
    "max_length-float": ({"max_length": 96.0}, "max_length: got 96.0, expected an integer"),
    "max_length-text": ({"max_length": "96"}, "max_length: got '96', expected an integer"),
    "fields-generator": (
        {"fields": (name for name in ("map", "goal"))},
        "fields: got <generator .*expected a sequence",
    ),
    "augment": ({"augment": "false"}, "augment: got 'false', expected True or False"),
    "max_length-nothing": (
        {"max_length": 9, "fields": ("map",)},
        "max_length: .*'path' among the fields",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_arguments_name_themselves(root: str, case: str) -> None:
    """What was got and what was expected, by both datasets."""
    arguments, says = REFUSED[case]
    with pytest.raises(ValueError, match=says):
        MapDataset(root, **arguments)
    with pytest.raises(ValueError, match=says):
        OnlineMapDataset(samples.SPEC, **arguments)


def test_refused_arguments_of_one_dataset(root: str) -> None:
    """Those that only one of the two has."""
    with pytest.raises(ValueError, match="root: got an empty list"):
        MapDataset([])
    with pytest.raises(ValueError, match="length: got 0, expected an integer of at least 1"):
        OnlineMapDataset(samples.SPEC, length=0)
    with pytest.raises(ValueError, match=r"recipe: got 'papers', .*; did you mean paper\?"):
        OnlineMapDataset("papers")
    short = OnlineMapDataset(samples.SPEC, length=np.uint8(200), split="train")  # type: ignore[arg-type]
    assert len(short[150:].map) == 50
    with pytest.raises(ValueError, match="seed: got -3"):
        OnlineMapDataset(samples.SPEC, seed=-3)
    with pytest.raises(ValueError, match=r"split: the spec gives no map to 'val'"):
        OnlineMapDataset(replace(samples.SPEC, splits=(1.0, 0.0, 0.0)), split="val")
    with pytest.raises(ValueError, match="filter: random problems are not stored"):
        MapDataset(root, problems="random").filter(rooms=(2, 3))


@pytest.mark.parametrize(
    ("conditions", "says"),
    [
        ({}, "filter: got no condition, expected one of rooms, path_length"),
        ({"rooms": (1, 2, 3)}, r"rooms: got \(1, 2, 3\), expected \(lowest, highest\)"),
        ({"rooms": 3}, r"rooms: got 3, expected \(lowest, highest\)"),
        ({"rooms": (5, 3)}, r"rooms: got \(5, 3\), whose lowest number 5 is above its highest 3"),
        ({"path_length": "ab"}, "path_length: got 'ab'"),
        ({"hardness": (math.nan, 2)}, "hardness: got"),
        ({"reachable": "false"}, "reachable: got 'false', expected True or False"),
    ],
)
def test_conditions_of_a_filter_that_cannot_be_are_refused(
    root: str, conditions: dict[str, Any], says: str
) -> None:
    """The message names the condition and what it may be."""
    dataset = MapDataset(root)
    with pytest.raises(ValueError, match=says):
        dataset.filter(**conditions)


def test_a_missing_dataset_of_a_relative_path_says_where_it_was_sought(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program may have changed its working folder, as Hydra does on request."""
    monkeypatch.chdir(tmp_path)
    path = re.escape(str(tmp_path / "data" / "maps"))
    with pytest.raises(DatasetNotFoundError, match=rf"it does not exist \(that is {path}\)\. Make"):
        MapDataset("data/maps")


def test_a_missing_dataset_says_what_was_looked_for(tmp_path: Path) -> None:
    """The folder, what is not there, and the command and the argument that make one."""
    (tmp_path / "empty").mkdir()
    for folder, why in (
        (tmp_path / "nowhere", "it does not exist"),
        (tmp_path / "empty", "no manifest.json there"),
    ):
        with pytest.raises(DatasetNotFoundError) as error:
            MapDataset(folder)
        message = str(error.value)
        assert f"no dataset at {folder}: {why}" in message
        assert f"'mapdata build {folder}'" in message
        assert "build='paper'" in message
        assert isinstance(error.value, FileNotFoundError)


def test_a_worker_misses_a_dataset_as_its_parent_would(root: str, tmp_path: Path) -> None:
    """The same class, and the advice once."""
    shutil.copytree(root, tmp_path / "maps")
    dataset = MapDataset(tmp_path / "maps")
    shutil.rmtree(tmp_path / "maps")
    loader = DataLoader(dataset, 2, num_workers=1, multiprocessing_context="fork")
    with pytest.raises(DatasetNotFoundError) as error:
        next(iter(loader))
    assert str(error.value).count("Make one with 'mapdata build") == 1


def seven_numbers(batch: Sample) -> torch.Tensor:
    """Return a number of rows that has nothing to do with the batch."""
    del batch
    return torch.zeros(7)


def mean_cost(batch: Sample) -> torch.Tensor:
    """Return one number for the whole batch."""
    mean: torch.Tensor = batch.cost.mean()
    return mean


def nothing(batch: Sample) -> None:
    """Return nothing, as after a forgotten return."""


WRONG_FIELDS: dict[str, tuple[FieldFunction, str]] = {
    "other rows": (seven_numbers, r"seven_numbers returned a tensor of shape \(7,\)"),
    "a mean": (mean_cost, r"mean_cost returned a tensor of shape \(\)"),
    "nothing": (nothing, "nothing returned None"),
}


@pytest.mark.parametrize("case", WRONG_FIELDS)
def test_a_field_function_that_returns_no_row_for_each_problem_is_refused(
    root: str, case: str
) -> None:
    """The message names the function, what it returned and what is expected."""
    function, complaint = WRONG_FIELDS[case]
    dataset = MapDataset(root, fields=("cost", function))
    expected = "a batch of 32 problems, expected a tensor whose first dimension is 32"
    with pytest.raises(ValueError, match=f"fields: the function {complaint} for {expected}"):
        dataset[:32]


# --- processes ----------------------------------------------------------------------------------


def twice_the_start(sample: Sample) -> torch.Tensor:
    """Return a field of one's own that workers must find again."""
    start: torch.Tensor = sample.start
    return 2 * start


@pytest.mark.parametrize("kind", ["route", "random", "filtered", "online", "online-split"])
def test_datasets_pickle_as_their_arguments(root: str, kind: str) -> None:
    """Under 10 kB after use, however large; what comes back gives equal data."""
    fields: tuple[str | FieldFunction, ...] = (*samples.ALL_FIELDS, twice_the_start)
    dataset: MapDataset | OnlineMapDataset
    if kind.startswith("online"):
        split = "train" if kind == "online-split" else None
        dataset = OnlineMapDataset(
            samples.SPEC, 3, 100_000, split, fields, augment=True, sampling_seed=4
        )
    else:
        problems = "random" if kind == "random" else "route"
        dataset = MapDataset(
            root, "train", fields, problems=problems, augment=True, sampling_seed=4, max_length=200
        )
        dataset = dataset.filter(rooms=(3, 5)) if kind == "filtered" else dataset
    before = dataset[:40]
    data = pickle.dumps(dataset)
    assert len(data) < 10_000
    again = pickle.loads(data)
    assert len(again) == len(dataset)
    assert repr(again) == repr(dataset)
    samples.assert_same(again[:40], before)


def number_of_rooms(sample: Sample) -> int:
    """Return something that is no sample."""
    return int(sample.map.sum())


class Doubled(MapDataset):
    """A subclass with an argument and an attribute of its own."""

    def __init__(self, folder: str) -> None:
        """Open the training split."""
        super().__init__(folder, "train")
        self.factor = 2

    def __getitem__(self, index: Any) -> Any:
        return self.factor * index


def test_what_was_set_later_is_pickled(root: str) -> None:
    """Spawned workers serve what forked ones do: attributes and subclasses go with the dataset."""
    for dataset in (MapDataset(root), OnlineMapDataset(samples.SPEC, 3, 40, "train")):
        dataset.transform = number_of_rooms
        for again in (pickle.loads(pickle.dumps(dataset)), copy.deepcopy(dataset)):
            assert again[3] == dataset[3]
            assert isinstance(again[3], int)
    doubled = Doubled(root)
    doubled.factor = 5
    assert pickle.loads(pickle.dumps(doubled))[4] == 20
    view = doubled.filter(rooms=(3, 5))
    assert len(copy.copy(view)) == len(view) < len(doubled)


@pytest.mark.parametrize("field", [partial(number_of_rooms), torch.nn.Identity()])
def test_a_field_without_a_name_is_refused(root: str, field: Any) -> None:
    """As a lambda is."""
    with pytest.raises(ValueError, match="a function gives its name"):
        MapDataset(root, fields=("map", field))


few_cores = pytest.mark.filterwarnings("ignore:This DataLoader will create 3 worker:UserWarning")


@few_cores
@pytest.mark.parametrize(
    ("workers", "method"),
    [
        slow(1, "fork"),
        (3, "fork"),
        pytest.param(1, "spawn", marks=pytest.mark.slow),
        pytest.param(1, "forkserver", marks=pytest.mark.slow),
    ],
)
def test_workers_change_nothing(root: str, workers: int, method: str) -> None:
    """Batches from any number of workers, however they start, are those of the process itself."""
    dataset = MapDataset(
        root, "train", (*samples.ALL_FIELDS, twice_the_start), problems="random", augment=True
    )
    _ = dataset[0]  # opened before the workers start
    expected = list(DataLoader(dataset, 16))
    loader = DataLoader(dataset, 16, num_workers=workers, multiprocessing_context=method)
    samples.assert_all_same(list(loader), expected)


@pytest.mark.slow
@few_cores
def test_online_workers_change_nothing() -> None:
    """The same of maps made in the workers."""
    dataset = OnlineMapDataset(samples.SPEC, 5, 50, "train", augment=True)
    expected = list(DataLoader(dataset, 16))
    for workers in (1, 3):
        loader = DataLoader(dataset, 16, num_workers=workers, multiprocessing_context="fork")
        samples.assert_all_same(list(loader), expected)


# --- types and transforms -----------------------------------------------------------------------

INTEGERS = ("start", "goal", "path", "length", "iterations", "optimal_moves", "seed_points")
GRIDS = ("map", "free", "terrain", "path_mask", "start_mask", "goal_mask", "optimal_mask")


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.bfloat16, torch.bool])
@pytest.mark.parametrize("kind", ["stored", "online", "terrain"])
def test_dtype_is_that_of_maps_and_masks_alone(root: str, kind: str, dtype: torch.dtype) -> None:
    """Their values stay what they are; every other field, and what functions get, stays as it
    was.
    """

    def seen(sample: Sample) -> torch.Tensor:
        assert sample.map.dtype == torch.uint8
        occupied: torch.Tensor = sample.map.sum(dim=(1, 2, 3))
        return occupied

    names = samples.TERRAIN_FIELDS if kind == "terrain" else samples.ALL_FIELDS
    fields: tuple[str | FieldFunction, ...] = (*names, seen)
    dataset, plain = (
        MapDataset(root, "train", fields, dtype=one)
        if kind == "stored"
        else OnlineMapDataset(
            samples.ROUGH if kind == "terrain" else samples.SPEC, 3, 50, fields=fields, dtype=one
        )
        for one in (dtype, None)
    )
    cast = (*GRIDS, "image", "maze_image")
    for index in (3, slice(2, 9)):
        found, expected = dataset[index], plain[index]
        samples.assert_same(found, expected, without=cast)
        for name in cast:
            assert getattr(found, name).dtype == dtype
            assert torch.equal(getattr(found, name), getattr(expected, name).to(dtype))
    assert {getattr(found, name).dtype for name in INTEGERS} == {torch.int64, torch.uint8}


def test_a_dtype_may_be_its_name(root: str) -> None:
    """As configurations and command lines say it, and as torch prints it."""
    for name in ("float16", "torch.float16"):
        assert MapDataset(root, dtype=name)[:2].map.dtype == torch.float16
        assert OnlineMapDataset(samples.SPEC, length=3, dtype=name)[0].map.dtype == torch.float16


class Masked(NamedTuple):
    """What `masked` makes of a sample."""

    grids: torch.Tensor
    problem: int


def masked(sample: Sample) -> Masked:
    """Return a type of one's own from one sample."""
    assert sample.map.ndim == 3
    return Masked(torch.cat((sample.map, sample.goal_mask)), int(sample.problem))


def without_walls(sample: Sample) -> Sample:
    """Return the sample on an empty map, its ragged path untouched."""
    assert sample.map.ndim == 3
    changed: Sample = sample._replace(map=sample.map * 0)
    return changed


def test_a_transform_gets_single_samples(root: str) -> None:
    """One index, a slice, a list, a DataLoader, views, subsets and joined datasets agree with the
    transform of each sample by hand.
    """
    fields = ("map", "goal_mask", "path", "problem")
    plain = MapDataset(root, "train", fields)
    dataset = MapDataset(root, "train", fields, transform=masked)
    by_hand = [masked(sample) for sample in plain]
    loaders: list[Dataset[Any]] = [
        dataset,
        Subset(dataset, range(len(dataset))),
        ConcatDataset([dataset]),
        pickle.loads(pickle.dumps(dataset)),
        dataset.filter(rooms=(2, 5)),
    ]
    for loaded in loaders:
        batches = list(DataLoader(loaded, 8))
        assert [type(batch) for batch in batches] == [Masked] * len(batches)
        grids = torch.cat([batch.grids for batch in batches])
        assert torch.equal(grids, torch.stack([one.grids for one in by_hand]))
        numbers = torch.cat([batch.problem for batch in batches])
        assert numbers.tolist() == [one.problem for one in by_hand]
    first, second = random_split(dataset, [10, len(dataset) - 10])
    parts = [batch.problem for part in (first, second) for batch in DataLoader(part, 8)]
    assert sorted(torch.cat(parts).tolist()) == [one.problem for one in by_hand]
    for index in (3, -1, np.int64(4)):
        assert torch.equal(dataset[index].grids, by_hand[index].grids)
    for several in (slice(2, 9), [4, 1], torch.tensor([5, 5])):
        expected = torch.stack([by_hand[int(k)].grids for k in np.arange(len(dataset))[several]])
        assert torch.equal(dataset[several].grids, expected)


@pytest.mark.parametrize("max_length", [None, 90])
def test_samples_that_a_transform_returns_are_padded(root: str, max_length: int | None) -> None:
    """A `Sample` with its ragged path is still stacked into a padded batch, in the type asked for;
    indices of later epochs are served, too.
    """
    arguments: dict[str, Any] = {"problems": "random", "augment": True, "max_length": max_length}
    plain = MapDataset(root, "train", **arguments)
    dataset = MapDataset(root, "train", **arguments, transform=without_walls, dtype=torch.float32)
    indices = [3, 1 + len(plain), 2 + 5 * len(plain)]
    for found, expected in (
        (dataset[2:9], plain[2:9]),
        (dataset[3], plain[3]),
        (dataset[indices], plain[indices]),
        (next(iter(DataLoader(dataset, 8))), plain[:8]),
    ):
        samples.assert_same(found, expected, without=("map",))
        assert torch.equal(found.map, torch.zeros(expected.map.shape))


@pytest.mark.parametrize("method", ["fork", pytest.param("spawn", marks=pytest.mark.slow)])
def test_workers_call_the_transform(root: str, method: str) -> None:
    """Batches of workers are those of the process itself, transformed."""
    fields = ("map", "goal_mask", "problem")
    datasets = [
        MapDataset(root, "train", fields, transform=masked),
        OnlineMapDataset(samples.SPEC, 3, 40, "train", fields, transform=masked),
    ]
    for dataset in datasets:
        loader = DataLoader(dataset, 16, num_workers=1, multiprocessing_context=method)
        for batch, expected in zip(loader, DataLoader(dataset, 16), strict=True):
            assert torch.equal(batch.grids, expected.grids)
            assert torch.equal(batch.problem, expected.problem)


def test_dtypes_and_transforms_that_cannot_be_are_refused(root: str) -> None:
    """No type of torch, or nothing that would change."""
    wrongs: tuple[Any, ...] = ("flaot32", "nn", float, 32)
    for wrong in wrongs:
        with pytest.raises(ValueError, match=f"dtype: got {wrong!r}, expected one of torch"):
            MapDataset(root, dtype=wrong)
    with pytest.raises(ValueError, match=r"expected one of map, free, .* among the"):
        OnlineMapDataset(samples.SPEC, fields=("start", "cost"), dtype=torch.float32)


class _Ratios(torch.nn.Module):
    """A layer that turns map and goal into ratios, for clients that call ``net(x)``."""

    def __init__(self) -> None:
        super().__init__()
        self.layer = torch.nn.Conv2d(2, 1, 3, padding=1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return ratios (B, 1, H, W) of maps and goals (B, 2, H, W)."""
        ratios: torch.Tensor = self.layer(x)
        return ratios


def pair(sample: Sample) -> tuple[torch.Tensor, torch.Tensor]:
    """Return (input, target), as many clients want their samples."""
    return torch.cat((sample.map, sample.goal_mask)), sample.heuristic_ratio


LEARNT = ("map", "goal_mask", "heuristic_ratio")


def test_a_plain_loader_feeds_a_network(root: str) -> None:
    """Three lines of torch, without a cast."""
    dataset = MapDataset(root, "train", LEARNT, dtype=torch.float32)
    net = _Ratios()
    for map_, goal, ratio in DataLoader(dataset, 64):
        torch.nn.functional.mse_loss(net(torch.cat((map_, goal), dim=1)), ratio).backward()
    assert net.layer.weight.grad is not None


def test_skorch_fits(root: str) -> None:
    """A NeuralNet takes the dataset as it is, with its own split and loaders."""
    skorch = pytest.importorskip("skorch")
    dataset = MapDataset(root, "train", LEARNT, dtype=torch.float32, transform=pair)
    net = skorch.NeuralNet(_Ratios, torch.nn.MSELoss, max_epochs=2, batch_size=32, verbose=0)
    net.fit(dataset, y=None)
    assert np.isfinite(net.history[:, "valid_loss"]).all()
    assert net.predict(dataset).shape == (len(dataset), 1, 20, 20)


def test_accelerate_trains(root: str) -> None:
    """A prepared loader gives whole batches of samples with names."""
    accelerate = pytest.importorskip("accelerate")
    accelerator = accelerate.Accelerator(cpu=True)
    net = _Ratios()
    dataset = MapDataset(root, "train", (*LEARNT, "path"), dtype=torch.float32)
    optimizer = torch.optim.SGD(net.parameters(), 0.1)
    net, optimizer, loader = accelerator.prepare(net, optimizer, DataLoader(dataset, 32))
    count = 0
    for batch in loader:
        inputs = torch.cat((batch.map, batch.goal_mask), dim=1)
        accelerator.backward((net(inputs) - batch.heuristic_ratio).square().mean())
        optimizer.step()
        count += len(batch.path)
    assert count == len(dataset)


# --- damaged and hostile files ------------------------------------------------------------------


def rewrite(manifest: Manifest, root: Path, **changes: Any) -> None:
    """Write the manifest with another first entry, its own hash sound."""
    entry = replace(manifest.shards[0], **changes)
    (root / MANIFEST).write_text(replace(manifest, shards=(entry, *manifest.shards[1:])).to_json())


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A root whose one shard is that of tests/helpers/hostile.py."""
    root = tmp_path_factory.mktemp("sound") / "maps"
    samples.build_small(root, SOUND_SPEC, maps=3, seed=SOUND_SEED, shard_size=3)
    return root


FAULTS: dict[str, hostile.Member] = {
    **{
        name: fault.member for name, fault in hostile.DATASETS.items() if fault.dataset != "terrain"
    },
    **hostile.ELSEWHERE,
}


@pytest.mark.parametrize("fault", FAULTS)
def test_hostile_shards_are_refused_at_first_touch(sound: Path, tmp_path: Path, fault: str) -> None:
    """Opening reads only the manifest; the first sample names the file."""
    root = tmp_path / "maps"
    shutil.copytree(sound, root)
    manifest = read_manifest(root)
    shard = root / manifest.shards[0].name
    contents = hostile.read_contents(shard)
    outside = tmp_path / "outside.h5"
    shutil.copy(shard, outside)
    name = hostile.DATASETS[fault].dataset if fault in hostile.DATASETS else "maps"
    hostile.write(shard, contents, outside, {name: FAULTS[fault]})
    rewrite(manifest, root, bytes=shard.stat().st_size)
    dataset = MapDataset(root)
    with pytest.raises(ShardError, match=re.escape(str(shard))):
        dataset[0]
    with pytest.raises(ShardError):
        dataset.table()


@pytest.mark.parametrize("kind", ["truncated", "swapped", "missing"])
def test_truncated_and_swapped_shards_are_refused(kind: str, root: str, tmp_path: Path) -> None:
    """A file of another size, and a sound file under another's name."""
    copy = tmp_path / kind
    shutil.copytree(root, copy)
    manifest = read_manifest(copy)
    first, second = (copy / entry.name for entry in manifest.shards[:2])
    if kind == "truncated":
        first.write_bytes(first.read_bytes()[:-1])
    elif kind == "swapped":
        shutil.copy(second, first)
        rewrite(manifest, copy, bytes=first.stat().st_size)
    else:
        first.unlink()
    dataset = MapDataset(copy)
    with pytest.raises((ShardError, FileNotFoundError), match=re.escape(str(first))):
        dataset[0]
    assert dataset[-1].map.shape == (1, 20, 20)  # the others are sound


@pytest.mark.parametrize(
    "name",
    ["../maps-000000000000-000000000016.h5", "/etc/passwd", "manifest.json", "a/maps-0-1.h5"],
)
def test_manifests_that_lead_elsewhere_are_refused(root: str, name: str, tmp_path: Path) -> None:
    """Names of shards are names of shards: no folder, no `..`."""
    copy = tmp_path / "maps"
    shutil.copytree(root, copy)
    rewrite(read_manifest(copy), copy, name=name)
    with pytest.raises(ShardError, match="is not the name of a shard"):
        MapDataset(copy)


def test_manifests_that_count_otherwise_are_refused(root: str, tmp_path: Path) -> None:
    """Counts that the shard does not hold are found when it is opened."""
    copy = tmp_path / "maps"
    shutil.copytree(root, copy)
    manifest = read_manifest(copy)
    counts = manifest.shards[0].counts
    rewrite(
        manifest,
        copy,
        counts={**counts, "train": {**counts["train"], "route": counts["train"]["route"] + 1}},
    )
    with pytest.raises(ShardError, match="the manifest says"):
        MapDataset(copy)[0]


@pytest.mark.parametrize("count", [-1, 10**15])
def test_manifests_that_cannot_be_are_refused(root: str, count: int, tmp_path: Path) -> None:
    """No memory is asked for by what a manifest claims."""
    copy = tmp_path / "maps"
    shutil.copytree(root, copy)
    manifest = read_manifest(copy)
    counts = manifest.shards[0].counts
    rewrite(manifest, copy, counts={**counts, "train": {**counts["train"], "route": count}})
    with pytest.raises(ShardError, match=str(count)):
        MapDataset(copy, "train")


def test_a_map_of_more_rooms_than_stated_is_refused(tmp_path: Path) -> None:
    """Matrices have room for as many as the manifest says: more would be written beyond them."""
    root = imported(tmp_path / "maps")
    manifest = read_manifest(root)
    entry = manifest.shards[0]
    few = replace(entry, counts={**entry.counts, "most_rooms": 1})
    (root / MANIFEST).write_text(replace(manifest, shards=(few,)).to_json())
    with pytest.raises(ShardError, match="more rooms than the manifest says"):
        MapDataset(root, fields=("connection_matrix",))[0]


@pytest.mark.parametrize("name", ["square", "wide"])
def test_damaged_paths_are_refused(roots: dict[str, str], name: str) -> None:
    """Moves of any value give a path inside the map from start to goal, or an error: nothing beyond
    the map is used.
    """
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "maps"
        shutil.copytree(roots[name], copy)
        manifest = read_manifest(copy)
        shard = copy / manifest.shards[0].name
        contents = hostile.read_contents(shard)
        source = np.random.default_rng(1)
        refused, messages = 0, set[str]()
        for trial in range(8):

            def member(file: Any, key: str, array: Array, _: Path, trial: int = trial) -> None:
                changed = array.copy()
                where = source.integers(0, len(array), size=(1, 5, len(array))[trial % 3])
                changed[where] = 0x77 if trial == 7 else source.integers(0, 256, size=len(where))
                file.create_dataset(key, data=changed)

            hostile.write(shard, contents, shard, {"astar_moves": member, "bfs_moves": member})
            publish(copy, shard.name, shard.read_bytes())
            for search in ("bfs", "astar"):
                dataset = MapDataset(
                    copy, fields=("path", "path_mask", "start", "goal"), search=search
                )
                for k in range(20):
                    try:
                        sample = dataset[k]
                    except ShardError as error:
                        messages.add(re.sub(r"map \d+", "map", str(error)))
                        refused += 1
                        continue
                    cells = samples.cells_of(sample.path)
                    assert cells[0] == samples.cell_of(sample.start)
                    assert cells[-1] == samples.cell_of(sample.goal)
                    assert all(0 <= row < dataset.map_size[0] for row, _ in cells)
                    assert all(0 <= column < dataset.map_size[1] for _, column in cells)
        assert refused > 20
        assert messages == {f"{shard}: a stored path of map is damaged"}


def test_all_connected_is_judged_by_the_movement_that_is_served(tmp_path: Path) -> None:
    """Two rooms that touch at a corner are apart, but for those who may cut it."""
    grid = np.ones((8, 8), np.uint8)
    grid[:4, :4] = 0
    grid[4:, 4:] = 0
    ends = np.array([[1, 1], [6, 6]])
    maps = [ForeignMap("corner", grid, split=0, seed_points=ends, rooms_known=True)]
    import_maps(tmp_path / "maps", Collection(maps))
    problems = Route(unsolvable=True)
    cutting = Movement(8, corner_cutting=True)
    for movement, connected in ((Movement(), False), (cutting, True)):
        dataset = MapDataset(tmp_path / "maps", problems=problems, movement=movement)
        assert len(dataset.filter(all_connected=connected)) == 1
        assert len(dataset.filter(all_connected=not connected)) == 0
        assert len(dataset.filter(reachable=connected)) == 1


def test_a_transform_of_no_samples_is_not_called(roots: dict[str, str]) -> None:
    """An empty selection is an empty batch, with a transform as without; others are refused."""
    root = next(iter(roots.values()))
    batch = MapDataset(root, transform=lambda sample: sample.map)[5:5]
    assert batch.start.shape == (0, 2)
    with pytest.raises(ValueError, match="transform: got 3, expected a function"):
        MapDataset(root, transform=3)  # type: ignore[arg-type]


def test_an_unfinished_dataset_says_so(roots: dict[str, str], tmp_path: Path) -> None:
    """It can be trained on, and its name tells."""
    root = tmp_path / "maps"
    shutil.copytree(next(iter(roots.values())), root)
    assert "not finished" not in repr(MapDataset(root))
    manifest = read_manifest(root)
    (root / MANIFEST).write_text(replace(manifest, maps=manifest.maps + 1).to_json())
    assert "not finished" in repr(MapDataset(root))


# --- pictures -----------------------------------------------------------------------------------


def assert_problem_is_drawn(axes: Any, problem: Sample) -> None:
    """Compare a picture with a map, its start and goal, and its path, cell by cell."""
    np.testing.assert_array_equal(np.asarray(axes.get_images()[0].get_array()), problem.map[0])
    assert_lines(drawn(axes, COLOURS["astar"]), [np.asarray(problem.path)])
    letters = {text.get_text(): text.get_position()[::-1] for text in axes.texts}
    assert letters == {
        "S": tuple(problem.start.tolist()),
        "G": tuple(problem.goal.tolist()),
    }


@pytest.mark.parametrize("fields", [("map", "start", "goal", "path"), ("goal", "cost_to_go")])
def test_plot_draws_map_start_goal_and_path(root: str, fields: tuple[str, ...]) -> None:
    """Whichever fields are served; a dense field is a shade over the map."""
    expected = MapDataset(root, "train")[5]
    dataset = MapDataset(root, "train", fields, transform=tuple)
    axes = dataset.plot(5)
    assert_problem_is_drawn(axes, expected)
    assert len(axes.get_images()) == 1 + ("cost_to_go" in fields)
    own_axes = figure_of(dataset.plot()).add_subplot()
    assert dataset.plot(-len(dataset) + 5, own_axes) is own_axes
    assert_problem_is_drawn(own_axes, expected)


def test_plot_draws_what_is_served(root: str) -> None:
    """After filters and symmetries, and problems that are made online."""
    view = MapDataset(root, "train", augment=True).filter(path_length=(6, 20))
    assert_problem_is_drawn(view.plot(3), view[3])
    online = OnlineMapDataset(samples.SPEC, 5, 20, problems="random")
    assert_problem_is_drawn(online.plot(2), online[2])


def test_plot_draws_several_problems_side_by_side(root: str) -> None:
    """In the order of their numbers as they are listed, 9 at most."""
    dataset = MapDataset(root)
    numbers = [7, 2, -1]
    panels = [axes for axes in figure_of(dataset.plot(numbers)).axes if axes.axison]
    assert len(panels) == 3
    for axes, number in zip(panels, numbers, strict=True):
        assert_problem_is_drawn(axes, dataset[number])
    assert sum(axes.axison for axes in figure_of(dataset.plot(range(12))).axes) == 9
    with pytest.raises(IndexError, match=f"index {len(dataset)} is out of range"):
        dataset.plot(len(dataset))


# --- copies -------------------------------------------------------------------------------------


def test_a_copy_shares_the_open_shards(root: str) -> None:
    """So does a view: neither reads a manifest or opens a shard again."""
    dataset = MapDataset(root, "train")
    copied = copy.copy(dataset)
    assert copied.reader is dataset.reader
    assert dataset.filter(rooms=(1, 9)).reader is dataset.reader
    samples.assert_same(copied[:], dataset[:])
    assert pickle.loads(pickle.dumps(dataset)).reader is not dataset.reader


class Named(MapDataset):
    """A dataset of a user, with one more attribute."""

    def __init__(self, root: str, name: str) -> None:
        """Keep the name."""
        super().__init__(root, "train", fields=("map",))
        self.name = name


def through_pickle(dataset: Named) -> Any:
    """Return what another process gets."""
    return pickle.loads(pickle.dumps(dataset))


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, through_pickle])
def test_copies_of_a_users_class_keep_its_attributes(root: str, copied: Any) -> None:
    """Views too."""
    dataset = copied(Named(root, "mine"))
    assert type(dataset) is Named
    view: Any = dataset.filter(rooms=(1, 3))
    assert (dataset.name, view.name) == ("mine", "mine")
    samples.assert_same(dataset[:5], MapDataset(root, "train", fields=("map",))[:5])


def test_memory_of_batches_is_kept_once_for_each_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """The block that raises malloc's threshold is allocated by the first dataset alone."""
    sizes = []
    keep_freed_memory.cache_clear()
    monkeypatch.setattr(np, "empty", lambda size, dtype: sizes.append((size, dtype)))
    keep_freed_memory()
    keep_freed_memory()
    assert sizes == [(31 * 2**20, np.uint8)]
