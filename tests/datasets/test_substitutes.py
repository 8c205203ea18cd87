"""Maps in place of those without a problem: those that docs/format.md names, and an end."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from functools import partial
from itertools import count, islice
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers import reference
from helpers.samples import SPEC, assert_all_same, assert_same, build_small
from scipy import stats
from torch.utils.data import DataLoader

from mapdata import (
    Forest,
    MapDataModule,
    MapDataset,
    OnlineMapDataset,
    ProblemSet,
    Random,
    Terrain,
    build,
    generate,
)
from mapdata.datasets import batch_sources
from mapdata.datasets.batch_sources import MissingProblems
from mapdata.datasets.problem_dataset import ProblemDataset
from mapdata.formats import Collection, ForeignMap, import_maps
from mapdata.limits import SPLITS
from mapdata.problems.substitutes import may_have_high_costs

WALLS = Forest((9, 8), cover=(0.3, 0.5), sizes=(1, 1), splits=(0.5, 0.2, 0.3))
"""Small maps, of which one in three has a path of `RARE`."""

RARE = (16, None)
"""A band of lengths."""

SEED, SAMPLING_SEED = 3, 11

FIELDS = ("map", "map_index", "start", "goal", "path", "length")

SUBSTITUTE = 8
"""The stream of docs/format.md."""

Served = tuple[int, tuple[int, int], tuple[int, int]]
"""Number of the map, start and goal."""


def served_by_the_text(
    dataset: ProblemDataset,
    index: int,
    epoch: int,
    map_at: Callable[[int], int],
    substitute: Callable[[int], int],
) -> Served:
    """Return what docs/format.md, section 6, says of a problem.

    Args:
        dataset: says how many problems there are, of which kind.
        index: number of the problem.
        epoch: pass over the data.
        map_at: returns the number of the map at a place of the split.
        substitute: returns the place of substitute u.
    """
    problems = dataset.serving.problems
    assert isinstance(problems, Random)
    for u in count():
        number = map_at(index // problems.per_map if u == 0 else substitute(u))
        problem = reference.reference_problem(
            generate(WALLS, SEED, [number]).occupancy[0].tolist(),
            SAMPLING_SEED,
            index + u * len(dataset),
            epoch,
            problems.bands,
            dataset.movement,
        )
        if problem is not None:
            return number, problem.start, problem.goal
    raise AssertionError


def served(dataset: ProblemDataset, index: int, epoch: int) -> Served:
    """Return what a dataset serves."""
    batch = dataset.__getitems__([index + epoch * len(dataset)]).batch
    start, goal = batch.start[0].tolist(), batch.goal[0].tolist()
    return int(batch.map_index[0]), (start[0], start[1]), (goal[0], goal[1])


def maps_of(split: str | None, number: int) -> list[int]:
    """Return the first maps of a split of `WALLS`, by the reference."""
    members = (
        i
        for i in count()
        if split is None or reference.reference_split(WALLS, SEED, i) == SPLITS.index(split)
    )
    return list(islice(members, number))


def online(length: int, split: str | None = None, per_map: int = 1) -> OnlineMapDataset:
    """Return a dataset whose problems are rare."""
    problems = Random(length=RARE, per_map=per_map)
    return OnlineMapDataset(
        WALLS, SEED, length, split, FIELDS, problems=problems, sampling_seed=SAMPLING_SEED
    )


@pytest.mark.parametrize(("split", "length", "per_map"), [(None, 5, 1), ("val", 5, 3)])
def test_online_substitutes_are_those_of_the_format(
    split: str | None, length: int, per_map: int
) -> None:
    """Substitute u of problem i of n own maps is at the place n + (u - 1) * length + i."""
    dataset = online(length, split, per_map)
    numbers = maps_of(split, 60 * length)
    own_maps = -(-length // per_map)
    replaced = 0
    for epoch in (0, 5):
        for index in range(length):
            expected = served_by_the_text(
                dataset,
                index,
                epoch,
                numbers.__getitem__,
                lambda u, index=index: own_maps + (u - 1) * length + index,  # type: ignore[misc]
            )
            assert served(dataset, index, epoch) == expected
            replaced += expected[0] != numbers[index // per_map]
    assert replaced > length / 2  # in two epochs


@pytest.mark.parametrize("per_map", [1, 2])
def test_stored_substitutes_are_those_of_the_format(tmp_path: Path, per_map: int) -> None:
    """They are drawn from the whole split, by stream 8."""
    build(tmp_path, WALLS, maps=20, seed=SEED, shard_size=8, workers=1)
    problems = Random(length=RARE, per_map=per_map)
    dataset = MapDataset(tmp_path, "train", FIELDS, problems=problems, sampling_seed=SAMPLING_SEED)
    numbers = [i for i in maps_of("train", 20) if i < 20]
    assert len(dataset) == per_map * len(numbers)
    for epoch in (0, 5):

        def substitute(u: int) -> int:
            w0, w1, _, _ = reference.block(SAMPLING_SEED, index, epoch, SUBSTITUTE, u)  # noqa: B023
            return (w0 * 2**32 + w1) * len(numbers) >> 64

        for index in range(0, len(dataset), 2 * per_map):
            expected = served_by_the_text(dataset, index, epoch, numbers.__getitem__, substitute)
            assert served(dataset, index, epoch) == expected


def test_a_map_gets_32_attempts() -> None:
    """Map 586 has its first problem at attempt 32, and map 159 at attempt 33, which is not made."""
    dataset = online(600)
    for index, has_problem in ((586, True), (159, False)):
        expected = served_by_the_text(
            dataset,
            index,
            0,
            lambda place: place,
            lambda u, index=index: u * 600 + index,  # type: ignore[misc]
        )
        assert (expected[0] == index) == has_problem
        assert served(dataset, index, 0) == expected


def test_no_map_is_served_twice_online() -> None:
    """200 problems of a rare band are on 200 maps; with several a map, on no map more of them."""
    for split in (None, "test"):
        numbers = online(200, split)[:].map_index.tolist()
        assert len(set(numbers)) == 200
    own_maps = set(maps_of("test", 50))
    problems_on = Counter(online(200, "test", per_map=4)[:].map_index.tolist())
    assert all(number in own_maps or problems_on[number] == 1 for number in problems_on)
    assert 1 < max(problems_on.values()) <= 4


def test_a_problem_depends_on_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor on the order, the batch, how many maps are tried at once, or where an epoch goes on."""
    whole = online(60)[:]
    again = online(60)
    rest = again.__getitems__(range(40, 60)).batch  # as after a restart within the epoch
    order = torch.randperm(60, generator=torch.Generator().manual_seed(1))
    shuffled = again[order.tolist()]
    single = [again[i] for i in range(0, 60, 7)]
    monkeypatch.setattr("mapdata.datasets.batch_sources.CELLS_AT_ONCE", 72 * 5)
    in_parts = online(60)[:]
    monkeypatch.setattr(
        "mapdata.datasets.batch_sources.limit_of_tries", lambda *_: 400
    )  # one is sought alone
    alone = online(60)[:]  # one is sought alone
    for name in ("map", "map_index", "start", "goal", "length"):
        expected = getattr(whole, name)
        assert torch.equal(getattr(rest, name), expected[40:])
        assert torch.equal(getattr(shuffled, name), expected[order])
        assert torch.equal(torch.stack([getattr(one, name) for one in single]), expected[::7])
        assert torch.equal(getattr(in_parts, name), expected)
        assert torch.equal(getattr(alone, name), expected)


def test_maps_that_are_tried_at_once_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first that has a problem is served, and none behind the last that may be tried."""
    rare = Random(length=(22, None))

    def dataset() -> OnlineMapDataset:
        return OnlineMapDataset(WALLS, SEED, 30, fields=FIELDS, problems=rare)

    at_once = dataset()[:]
    with monkeypatch.context() as patch:
        patch.setattr(MissingProblems, "substitutes_at_once", lambda *_: 1)
        assert_same(dataset()[:], at_once)
    substitutes = (at_once.map_index - torch.arange(30)) // 30
    last = int(substitutes.argmax())
    most = int(substitutes.max())
    assert most > 30  # some maps were tried at once
    for maps in (most + 1, most):
        monkeypatch.setattr(
            "mapdata.datasets.batch_sources.limit_of_tries", lambda *_, maps=maps: maps
        )
        if maps == most:
            with pytest.raises(ValueError, match=f"; {most} maps were tried for problem {last} "):
                dataset()[last]
        else:
            assert dataset()[last].map_index == at_once.map_index[last]


@pytest.mark.slow
@pytest.mark.parametrize("split", [None, "val"])
def test_workers_find_the_same_substitutes(split: str | None) -> None:
    """Each of them draws the splits of maps far behind by itself."""
    loaders = [DataLoader(online(90, split), 16, num_workers=workers) for workers in (0, 2)]
    alone, together = ([*loader] for loader in loaders)
    assert_all_same(together, alone)


def test_stored_substitutes_are_spread_over_the_maps_that_have_a_problem(tmp_path: Path) -> None:
    """Each of them replaces as many others, also the one that follows many without a problem."""
    wall = np.ones((6, 6), np.uint8)
    wall[3, 3:5] = 0
    open_map = np.zeros((6, 6), np.uint8)
    grids = [wall] * 15 + [open_map] * 5 + [wall] * 15 + [open_map] * 5
    import_maps(tmp_path, Collection([ForeignMap(f"{k}", grid) for k, grid in enumerate(grids)]))
    far = Random(distance=(5, None))
    dataset = MapDataset(tmp_path, fields=("map_index",), problems=far)
    replacing: Counter[int] = Counter()
    for epoch in range(20):
        batch = dataset.__getitems__(np.arange(40) + epoch * 40).batch
        is_own = batch.map_index == torch.arange(40)
        assert is_own.tolist() == [not grid.any() for grid in grids]
        replacing.update(batch.map_index[~is_own].tolist())
    assert sum(replacing.values()) == 20 * 30
    assert stats.chisquare([replacing[k] for k in (*range(15, 20), *range(35, 40))]).pvalue > 1e-3


# --- the end ------------------------------------------------------------------------------------


def test_the_end_names_the_band_and_the_maps(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same in every batch: it is counted for each problem by itself."""
    monkeypatch.setattr("mapdata.problems.substitutes.MAX_CELLS", 32 * 72 * 30 - 1)
    problems = Random(length=(45, None))
    dataset = OnlineMapDataset(
        WALLS, SEED, 10, fields=FIELDS, problems=problems, sampling_seed=SAMPLING_SEED
    )
    says = (
        'problems: got {"random": {"length": [45.0, null]}}: none on one map after another; '
        "30 maps were tried for problem 4 of epoch 0; take wider conditions"
    )
    for indices in ([4], [4, 7, 2]):
        with pytest.raises(ValueError, match="none on") as error:
            dataset[indices]
        assert str(error.value) == says


@pytest.mark.parametrize(
    ("problems", "radius", "says"),
    [
        (Random(distance=(390, None)), 0.0, r"20 tries were .* epoch 0; take wider conditions$"),
        (Random(hardness=(40, None)), 0.0, "take wider conditions$"),
        (Random((None, 3), (1.5, None)), 0.0, "take wider conditions$"),
        (Random(), 5.0, "take wider conditions, or a smaller radius than 5 m$"),
        (Random(to_first_seed_point=True), 5.0, "or a smaller radius than 5 m$"),
    ],
)
def test_a_stored_dataset_has_the_same_end(
    problems: Random, radius: float, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though its maps are tried again and again, and whatever the fault is."""
    root = build_small(tmp_path / "maps", maps=10)
    monkeypatch.setattr("mapdata.problems.substitutes.MAX_CELLS", 0)
    with pytest.raises(ValueError, match=says):
        MapDataset(root, problems=problems, radius=radius)[3]


@pytest.mark.parametrize("problems", [Random(distance=(9999, None)), Random(length=(72, None))])
def test_terrain_has_the_same_end(problems: Random, monkeypatch: pytest.MonkeyPatch) -> None:
    """By its costs, and by the lengths of its paths."""
    monkeypatch.setattr("mapdata.problems.substitutes.MAX_CELLS", 0)
    dataset = OnlineMapDataset(Terrain((8, 9), scale=4), 0, 5, problems=problems)
    with pytest.raises(ValueError, match="; 20 maps were tried for problem 2 of epoch 0; take"):
        dataset[2]


def test_many_maps_of_terrain_are_tried_at_once() -> None:
    """Small ones, on which no cost is too high; one after another they would take minutes."""
    missing = MissingProblems(np.array([True]), max_tries=10_000)
    missing.tried[:] = 800
    assert missing.substitutes_at_once(np.array([0]), max_maps=2**15) == 100
    assert not may_have_high_costs((5, 6))
    assert may_have_high_costs((80, 80))


# --- no silence ---------------------------------------------------------------------------------


@pytest.fixture
def _new_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Be a process that has not said yet that problems are rare."""
    monkeypatch.setitem(batch_sources._process, "said_rare", False)


@pytest.mark.usefixtures("_new_process")
def test_a_batch_of_rare_problems_says_so_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """After half of the maps that a search in vain may take; not where a bar shows more."""
    rare = Random(length=(22, None))

    def dataset() -> OnlineMapDataset:
        return OnlineMapDataset(WALLS, SEED, 30, problems=rare)

    dataset()[:]
    assert capsys.readouterr().err == ""
    monkeypatch.setattr("mapdata.problems.substitutes.MAX_CELLS", 32 * 72 * 200)
    with_bar = dataset()
    with_bar.report_tried = lambda maps: maps
    with_bar[:]
    assert capsys.readouterr().err == ""
    for _ in range(2):
        dataset()[:]
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith('rare problems: {"random": {"length": [22.0, null]}}: ')
    assert "of 30 problems of a batch still to find; wider conditions are faster" in line


def test_a_set_of_rare_problems_says_so_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Unless a bar shows more."""
    monkeypatch.setattr("mapdata.problems.substitutes.MAX_CELLS", 0)
    build(tmp_path, WALLS, maps=100, seed=SEED, workers=1)
    rare = Random(length=(22, None))
    draws: tuple[Callable[..., ProblemSet], ...] = (
        partial(ProblemSet.sample, WALLS, SEED, 50),
        partial(ProblemSet.read, tmp_path, split="train"),
    )
    for progress in (False, True):
        for draw in draws:
            draw(problems=rare, progress=progress)
            said = capsys.readouterr().err
            assert said.count("rare problems: ") == (not progress)
            assert ("maps; progress=True shows a bar" in said) == (not progress)


# --- several problems a map ---------------------------------------------------------------------


def test_problems_of_one_map_are_counted(tmp_path: Path) -> None:
    """Problem i is on map i // k; the other entries of a dataset fit."""
    root = build_small(tmp_path / "maps", maps=12)
    fields = ("map_index", "problem", "start", "goal")
    one = MapDataset(root, "train", fields, problems="random")
    four = MapDataset(root, "train", fields, problems=Random(per_map=4))
    assert len(four) == 4 * len(one)
    assert four.info.map_counts == one.info.map_counts
    assert four.info.problem_counts == {"train": len(four)}
    assert torch.equal(four[:].map_index, one[:].map_index.repeat_interleave(4))
    statistics = four.problem_statistics()
    assert (statistics.maps, statistics.most_on_one_map) == (len(one), 4)
    assert statistics.replaced is not None
    assert statistics.replaced.value == 0
    assert four[:].problem.tolist() == list(range(len(four)))
    assert len(torch.unique(torch.cat((four[:].start, four[:].goal), 1), dim=0)) > 2 * len(one)
    assert_same(MapDataset(root, "train", fields, problems=Random(per_map=1))[:], one[:])
    made = OnlineMapDataset(SPEC, 5, 10, fields=fields, problems=Random(per_map=4))
    assert made[:].map_index.tolist() == [0, 0, 0, 0, 1, 1, 1, 1, 2, 2]
    assert sum(made.info.map_counts.values()) == 3
    assert sum(made.info.problem_counts.values()) == 10
    assert made.info.recipes[0] is not None
    assert made.info.recipes[0].maps == 3
    by_default = OnlineMapDataset({"spec": "paper", "maps": 7}, problems=Random(per_map=4))
    assert len(by_default) == 28


def test_the_data_module_serves_several_problems_a_map() -> None:
    """Also where the maps are made online, from plain JSON."""
    module = MapDataModule(
        None, build={"spec": "paper", "maps": 50}, problems={"random": {"per_map": 3}}
    )
    module.setup("fit")
    assert [len(module.datasets[split]) for split in ("train", "val")] == [120, 15]
    assert json.loads(module.hparams["problems"]) == {"random": {"per_map": 3}}
