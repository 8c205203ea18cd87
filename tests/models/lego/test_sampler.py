"""Samplers that learn, and their bank: targets against plain searches, free samples, tiny runs, the
weights.
"""

from __future__ import annotations

import itertools
import json
import math
import runpy
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
import pytorch_lightning as pl
import torch
from scipy.sparse.csgraph import dijkstra

from mapdata import MapDataModule, MapSpec, Problems, inflate
from models.lego.comparison import (
    DENSE,
    RoadmapSuccess,
    compare,
    contenders,
    plot_success,
    to_text,
)
from models.lego.cvae import CVAE
from models.lego.experience import (
    KINDS,
    Bank,
    FixedProblems,
    Mining,
    bottlenecks,
    mine,
    near_optimal_paths,
)
from models.lego.roadmap import build_roadmap, free_at, halton, radius, sees
from models.lego.sampler import TRAINING_FIELDS, Heatmap, Sampler, encode, select
from models.model import load_model
from models.symmetries import random_symmetry

ROOT = Path(__file__).parents[2]
WEIGHTS = sorted(
    [*ROOT.glob("models/weights/lego_*.pt"), *ROOT.glob("models/weights/shortest_path_*.pt")]
)
DUNGEON = MapSpec.preset("dungeon")
Points: TypeAlias = npt.NDArray[np.float64]
QUICK = Mining(dense=400, sizes=(24,))

pytestmark = pytest.mark.filterwarnings(
    "ignore:The '.*dataloader' does not have many workers",
    "ignore:.*LeafSpec",
    "ignore:.*TF32",
    "ignore:Checkpoint directory",
)


def load(file: str | Path) -> Sampler:
    """Return the sampler in a file, of whichever kind."""
    return load_model(file, Heatmap, CVAE)


@cache
def drawn(maps: int = 12) -> Problems:
    """Return problems that no training has seen."""
    return Problems.sample(DUNGEON, seed=2718, maps=maps)


def small(kind: type[Any], **arguments: Any) -> Any:
    """Return a small untrained sampler."""
    torch.manual_seed(0)
    sizes: dict[str, Any] = {"widths": (8, 8, 8), "passes": 1}
    if kind is CVAE:
        sizes = {"width": 16, "code": 8}
    return kind(**{**sizes, **arguments}).eval()


def data(problems: int = 40, **arguments: Any) -> FixedProblems:
    """Return a data module of online maps with so many problems for training."""
    maps = math.ceil(problems / 0.8)
    recipe = json.dumps({"spec": DUNGEON.to_dict(), "seed": 902, "maps": maps})
    given: dict[str, Any] = {
        "batch_size": 8,
        "fields": TRAINING_FIELDS,
        "problems": "random",
        "movement": (8, False, 2**0.5),
    }
    return FixedProblems(None, build=recipe, **{**given, **arguments})


def trainer(folder: Path, **arguments: Any) -> pl.Trainer:
    """Return a Trainer of 60 steps on the CPU that says nothing."""
    return pl.Trainer(
        default_root_dir=folder,
        accelerator="cpu",
        max_steps=60,
        limit_val_batches=1,
        enable_progress_bar=False,
        enable_model_summary=False,
        logger=False,
        **arguments,
    )


def doors() -> npt.NDArray[np.uint8]:
    """Return a map of two rooms; of the two doors between them one is nearer to the middle."""
    grid = np.ones((40, 40), np.uint8)
    grid[4:36, 4:18] = 0
    grid[4:36, 22:36] = 0
    grid[17, 18:22] = 0
    grid[30, 18:22] = 0
    return grid


def first_path(problems: Problems, k: int) -> Points:
    """Return the shortest path that is mined for a problem, both ends included."""
    grid = problems.grids[k]
    return near_optimal_paths(grid, problems.starts[k], problems.goals[k], Mining(), k)[0]


def length_of(path: Points) -> float:
    """Return the length of a path."""
    return sum(math.dist(one, other) for one, other in itertools.pairwise(path))


# --- experience ---------------------------------------------------------------------------------


def test_bottlenecks_lie_in_the_door() -> None:
    """What a sparse roadmap cannot avoid: where it sees no way through the wall, only the path's
    points in the door.
    """
    grid = doors()
    start = np.array([10, 6])
    goal = np.array([10, 33])
    in_the_rooms = np.array([[8.5, 10.5], [20.5, 12.5], [10.5, 28.5], [25.5, 30.5]])
    in_the_door = np.array([[17.5, 17.5], [17.5, 22.5]])
    for seed in range(5):
        path = near_optimal_paths(grid, start, goal, Mining(), seed)[0]
        found = bottlenecks(grid, path, in_the_rooms, 50, 10.0)
        columns = found[:, 1]
        assert ((columns > 17) & (columns < 23)).any()
        assert len(found) < len(path) - 2
        # A dear way round: nothing is bought.
        with_the_door = np.concatenate([in_the_rooms, in_the_door])
        assert len(bottlenecks(grid, path, with_the_door, 50, 10.0)) == 0
        kept, _ = plain_bottlenecks(grid, path, with_the_door)
        assert kept == set()


def test_bottlenecks_join_start_and_goal() -> None:
    """The sparse roadmap with nothing but its bottlenecks has a path: that is what they are for."""
    problems = drawn()
    joined_before = 0
    for k, grid in enumerate(problems.grids):
        reach = radius(24, grid.shape)
        path = first_path(problems, k)
        sparse = halton(grid, 12, k)
        ends = path[[0, -1]]
        needed = bottlenecks(grid, path, sparse, 24, 10.0)
        with_them = build_roadmap(grid, np.concatenate([ends, needed, sparse]), reach)
        assert math.isfinite(with_them.shortest_path()[0])
        without = build_roadmap(grid, np.concatenate([ends, sparse]), reach)
        joined_before += math.isfinite(without.shortest_path()[0])
    assert joined_before < len(problems)


def plain_bottlenecks(
    grid: npt.NDArray[np.uint8], path: Points, sparse: Points
) -> tuple[set[tuple[float, float]], float]:
    """Return the inner points of the path that LEGO's code keeps: edge by edge, on a matrix; and
    the last factor, by which edges at the path were dearer.
    """
    places = np.concatenate([path, sparse])
    weights = np.zeros((len(places), len(places)))
    for a, b in build_roadmap(grid, places, radius(50, grid.shape)).edges:
        weights[a, b] = math.dist(places[a], places[b])
        weights[b, a] = weights[a, b]
    goal = len(path) - 1
    factor = 10.0
    while True:
        dear = weights.copy()
        dear[: len(path)] *= factor
        dear[len(path) :, : len(path)] *= factor
        costs, before = dijkstra(dear, indices=0, return_predecessors=True)
        if costs[goal] >= 10 * length_of(path):
            break
        factor *= 1.2
    kept = set()
    vertex = before[goal]
    while vertex > 0:
        if vertex < len(path):
            row, column = places[vertex].tolist()
            kept.add((row, column))
        vertex = before[vertex]
    return kept, factor


def test_bottlenecks_are_those_of_the_published_code() -> None:
    """Edges of start and goal are dear too, and the last factor decides, which is above 10."""
    problems = drawn()
    for k, grid in enumerate(problems.grids):
        path = first_path(problems, k)
        sparse = halton(grid, 25, k)
        found = bottlenecks(grid, path, sparse, 50, 10.0)
        kept, factor = plain_bottlenecks(grid, path, sparse)
        assert {(row, column) for row, column in found.tolist()} == kept
        assert factor > 10


def test_near_optimal_paths() -> None:
    """Valid, the first the shortest, all within the slack; the adversary finds the other door if it
    is near.
    """
    grid = doors()
    start = np.array([22, 6])
    goal = np.array([22, 33])
    tight = Mining(slack=1.0, attempts=20)
    loose = Mining(slack=2.0, attempts=20)
    used = set()
    for seed in range(6):
        assert len(near_optimal_paths(grid, start, goal, tight, seed)) == 1
        paths = near_optimal_paths(grid, start, goal, loose, seed)
        lengths = [length_of(path) for path in paths]
        assert lengths[0] == min(lengths)
        assert max(lengths) <= 2 * lengths[0]
        for path in paths:
            assert path[0].tolist() == [22.5, 6.5]
            assert path[-1].tolist() == [22.5, 33.5]
            assert sees(grid, path[:-1], path[1:]).all()
            in_wall = path[(path[:, 1] > 18) & (path[:, 1] < 22)]
            used.add("far door" if (in_wall[:, 0] > 25).any() else "near door")
    assert used == {"near door", "far door"}


def test_no_path_is_mined_where_none_is() -> None:
    """A wall between start and goal gives an empty list."""
    grid = np.array([[0, 1, 0]], np.uint8)
    assert near_optimal_paths(grid, np.array([0, 0]), np.array([0, 2]), Mining(), 0) == []


def test_the_bank(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Mined once and read again; its rows are those of the problems, whatever the workers; other
    mining, other file.
    """
    module = data(30)
    module.setup("fit")
    dataset = module.datasets["train"]
    bank = Bank.of(dataset, tmp_path, QUICK, workers=0)
    with monkeypatch.context() as patch:
        patch.setattr("models.lego.experience.mine", None)  # mining again would fail
        again = Bank.of(dataset, tmp_path, QUICK, workers=0)
    assert bank.identity == again.identity
    assert len(list(tmp_path.iterdir())) == 1
    other = Bank.of(dataset, tmp_path, Mining(dense=300, sizes=(24,)), workers=0)
    assert bank.identity != other.identity
    assert len(list(tmp_path.iterdir())) == 2

    for number in (0, 7, 29):
        sample = dataset[number]
        grid = sample.map[0].numpy()
        truth = mine(grid, sample.start.numpy(), sample.goal.numpy(), QUICK, number)
        for kind, points in zip(KINDS, truth, strict=True):
            found, counts = again.targets(kind, [number])
            assert counts.tolist() == [len(points)]
            np.testing.assert_allclose(found, points, atol=1e-5)
            assert free_at(grid, found).all()

    for kind in KINDS:
        points, counts = again.targets(kind, [7, 3, 7])
        assert counts.sum() > 0
        of_seven, of_three, of_seven_again = np.split(points, counts.cumsum()[:-1])
        assert np.array_equal(of_seven, again.targets(kind, [7])[0])
        assert np.array_equal(of_three, again.targets(kind, [3])[0])
        assert np.array_equal(of_seven_again, of_seven)


@pytest.mark.soak
def test_workers_change_nothing(tmp_path: Path) -> None:
    """Two threads mine what one mines."""
    module = data(230)
    module.setup("fit")
    dataset = module.datasets["train"]
    one = Bank.of(dataset, tmp_path / "one", QUICK, workers=1)
    two = Bank.of(dataset, tmp_path / "two", QUICK, workers=2)
    assert one.identity == two.identity
    (file_of_one,) = (tmp_path / "one").iterdir()
    (file_of_two,) = (tmp_path / "two").iterdir()
    assert file_of_one.read_bytes() == file_of_two.read_bytes()


def test_the_bank_knows_its_problems(tmp_path: Path) -> None:
    """Another problem under a number it knows, an unknown number, an unknown kind, a broken
    file.
    """
    module = data(10)
    module.setup("fit")
    dataset = module.datasets["train"]
    bank = Bank.of(dataset, tmp_path, QUICK, workers=0)
    ends = torch.cat([dataset[3].start, dataset[3].goal])[None]
    assert bank.targets("lego", [3], ends)[1].shape == (1,)
    for numbers, others in (([10], None), ([-1], None), ([4], ends)):
        with pytest.raises(ValueError, match="is not in the bank, or another one"):
            bank.targets("lego", numbers, others)
    with pytest.raises(ValueError, match="kind: got 'leg', expected one of lego, shortest_path"):
        bank.targets("leg", [3])
    (file,) = tmp_path.iterdir()
    replace(bank, identity="another").write(file)
    for _ in range(2):
        with pytest.raises(ValueError, match=r"no bank of experience .*remove it"):
            Bank.of(dataset, tmp_path, QUICK, workers=0)
        file.write_bytes(b"nothing")
    plain = data(10, fields=("map", "start", "goal"))
    plain.setup("fit")
    with pytest.raises(ValueError, match="the dataset has no problem, which a bank needs"):
        Bank.of(plain.datasets["train"], tmp_path, QUICK, workers=0)


def starts_of_two_epochs(module: MapDataModule) -> list[dict[int, list[int]]]:
    """Return the start of each training problem, by its number in the order of the epoch."""
    loader = module.train_dataloader()
    epochs = []
    for _ in range(2):
        starts = {}
        for batch in loader:
            for number, start in zip(batch.problem.tolist(), batch.start.tolist(), strict=True):
                starts[number] = start
        epochs.append(starts)
    return epochs


def test_fixed_problems_stay() -> None:
    """Every epoch has the same problems in another order; a plain data module draws others."""
    fixed = data(20)
    arguments = dict(fixed.hparams)
    plain = MapDataModule(**arguments)
    first, second = starts_of_two_epochs(fixed)
    plain_first, plain_second = starts_of_two_epochs(plain)
    assert first == second
    assert list(first) != list(second)
    assert sorted(first) == list(range(20))
    assert plain_first == first
    assert plain_second != first
    assert list(plain_first) != list(plain_second)
    assert sorted(plain_first) == sorted(plain_second) == sorted(first)


# --- samplers -----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [Heatmap, CVAE])
@pytest.mark.parametrize("shape", [(64, 64), (37, 50), (5, 3)])
def test_samples_are_free(kind: type[Sampler], shape: tuple[int, int]) -> None:
    """Any map size, more samples than cells even: exactly n, all in free cells, a function of the
    seed.
    """
    model = small(kind)
    grid = (np.random.default_rng(0).random(shape) < 0.5).astype(np.uint8)
    free = np.argwhere(grid == 0)
    ends = (free[0], free[-1])
    for n in (1, 12, 60):
        found = model.sample(grid, *ends, n, seed=3)
        assert found.shape == (n, 2)
        assert free_at(grid, found).all()
        with_channel = model.sample(grid[None], *ends, n, seed=3)
        assert np.array_equal(found, with_channel)
        of_an_image = model.sample(255 * grid, *ends, n, seed=3)
        assert np.array_equal(found, of_an_image)
        other_seed = model.sample(grid, *ends, n, seed=4)
        assert not np.array_equal(found, other_seed)


@pytest.mark.parametrize("kind", [Heatmap, CVAE])
def test_what_is_refused(kind: type[Any]) -> None:
    """A map without free space, a start or goal in a wall or outside, no sample, a
    robot that does not fit, a resolution that is none.
    """
    model = small(kind)
    grid = np.zeros((16, 16), np.uint8)
    grid[4] = 1
    with pytest.raises(ValueError, match="n: got 0, expected an integer of at least 1"):
        model.sample(grid, (0, 0), (9, 9), 0)
    with pytest.raises(ValueError, match=r"start: got \[0, 0\]"):
        model.sample(grid, (0, 0), (9, 9), 5, radius=0.6)  # at the border
    with pytest.raises(ValueError, match=r"resolution: got 0.0, expected metres per cell above 0"):
        model.sample(grid, (0, 0), (9, 9), 5, resolution=0.0)
    with pytest.raises(ValueError, match="radius: got -1"):
        model.sample(grid, (0, 0), (9, 9), 5, radius=-1)
    with pytest.raises(ValueError, match="without a free cell"):
        model.sample(np.ones((16, 16)), (0, 0), (9, 9), 5)
    for wrong in ((4, 3), (-1, 0), (0, 16)):
        with pytest.raises(
            ValueError, match=r"start: got .*expected a free cell of a map of \(16, 16\)"
        ):
            model.sample(grid, wrong, (9, 9), 5)
        with pytest.raises(ValueError, match="goal: got"):
            model.sample(grid, (0, 0), wrong, 5)
    with pytest.raises(ValueError, match="targets: got 'paths'"):
        kind(targets="paths")


@pytest.mark.parametrize("kind", [Heatmap, CVAE])
def test_samples_in_metres(kind: type[Sampler]) -> None:
    """The same points, x to the right and y upwards from the lower left corner, as in ROS; a radius
    is one of metres.
    """
    model = small(kind)
    grid = np.zeros((20, 30), np.uint8)
    grid[5:9, 4:20] = 1
    start, goal = (2, 2), (17, 25)
    cells = model.sample(grid, start, goal, 40, radius=1.5)
    assert free_at(inflate(grid, 1.5), cells).all()
    # 0.15 / 0.1 is not quite 1.5
    found = model.sample(grid, start, goal, 40, radius=0.15, resolution=0.1, origin=(-3.0, 7.0))
    assert found.shape == (40, 2)
    from_left_edge = found[:, 0] + 3.0
    from_lower_edge = found[:, 1] - 7.0
    height = 2.0  # 20 rows
    np.testing.assert_allclose(from_left_edge, cells[:, 1] / 10)
    np.testing.assert_allclose(from_lower_edge, height - cells[:, 0] / 10)


def test_padding_changes_nothing() -> None:
    """A map that was walled in to a multiple of 16 has the same shares, seen one way."""
    model = small(Heatmap, views=1)
    assert isinstance(model, Heatmap)
    grid = (np.random.default_rng(1).random((21, 30)) < 0.4).astype(np.uint8)
    free = np.argwhere(grid == 0)
    start = free[:1]
    goal = free[-1:]
    walled = np.pad(grid, ((0, 11), (0, 2)), constant_values=1)
    shares = model.heat_map(grid[None], start, goal)[0]
    of_walled = model.heat_map(walled[None], start, goal)[0]
    np.testing.assert_allclose(shares, of_walled[:21, :30], rtol=1e-3)
    assert shares.sum() == pytest.approx(1)
    assert (shares[grid != 0] == 0).all()


def test_choosing_cells() -> None:
    """Without noise: the likeliest first, then those it has not made unlikely; every cell once
    before any twice. With noise of Gumbel's distribution: each as often as its share says.
    """
    cells = [3, 4, 15]
    shares = np.zeros((1, 1, 20))
    shares[0, 0, cells] = [0.5, 0.3, 0.2]
    none = np.zeros_like(shares)

    def columns(n: int, spacing: float) -> list[float]:
        chosen: list[float] = select(shares, none, n, spacing)[0, :, 1].tolist()
        return chosen

    assert columns(3, spacing=1.5) == [3, 15, 4]
    assert columns(3, spacing=0.1) == [3, 4, 15]
    seven = columns(7, spacing=1.5)
    assert sorted(seven[:3]) == cells
    assert sorted(seven[3:6]) == cells

    source = np.random.default_rng(0)
    many = np.repeat(shares, 4000, axis=0)
    noise = source.gumbel(size=many.shape)
    first = select(many, noise, 1, 1.0)[:, 0, 1]
    frequencies = [(first == cell).mean() for cell in cells]
    np.testing.assert_allclose(frequencies, [0.5, 0.3, 0.2], atol=0.03)


def test_symmetries_move_everything_along() -> None:
    """Points, ends and masks stay on the cells they were on, under all the symmetries and swaps
    that turn up.
    """
    problems = drawn()
    starts = torch.tensor(problems.starts)
    goals = torch.tensor(problems.goals)
    grids = torch.tensor(problems.grids)[:, None]
    maps = torch.arange(len(grids))
    marks = torch.zeros_like(grids)
    for rows, columns in (starts.T, goals.T):
        marks[maps, 0, rows, columns] = 1
    fields = {"map": grids, "optimal_mask": marks, "start": starts, "goal": goals}
    occupied = grids.sum(dim=(1, 2, 3))
    torch.manual_seed(0)
    kinds = set()
    for _ in range(300):
        turned, points = random_symmetry(fields, starts + 0.25)
        for name in ("start", "goal"):
            rows, columns = turned[name].T
            assert (turned["optimal_mask"][maps, 0, rows, columns] == 1).all()
            assert (turned["map"][maps, 0, rows, columns] == 0).all()
        assert torch.equal(turned["map"].sum(dim=(1, 2, 3)), occupied)
        cells = points.floor().long()
        swapped = not torch.equal(cells, turned["start"])
        if swapped:
            assert torch.equal(cells, turned["goal"])
        kinds.add((swapped, tuple(turned["start"][0].tolist())))
    assert len(kinds) == 16


def test_what_the_networks_see() -> None:
    """Each end once, distances from both, no detour on the straight line between them."""
    start = (2, 1)
    goal = (2, 10)
    seen = encode(torch.zeros(1, 1, 9, 12), torch.tensor([start]), torch.tensor([goal]))[0]
    assert seen.shape == (14, 9, 12)
    for layer, end in ((seen[1], start), (seen[7], goal)):
        assert layer.nonzero().tolist() == [list(end)]
        assert layer.sum() == 1
    detour = seen[13]
    np.testing.assert_allclose(detour[2, 1:11], 0, atol=1e-6)
    assert (detour[5] > 0).all()
    assert seen[2, 5, 3] == pytest.approx(3 / 32)
    assert seen[6, 2, 4] == pytest.approx(3 / 64)


@pytest.mark.parametrize("kind", [Heatmap, CVAE])
@pytest.mark.slow
def test_a_tiny_run(kind: type[Sampler], tmp_path: Path) -> None:
    """It learns from a data module's batches and a bank; what it saves is the same model again."""
    pl.seed_everything(0)
    module = data(40)
    model = small(kind, learning_rate=0.02)
    module.setup("fit")
    model.bank = Bank.of(module.datasets["train"], tmp_path, QUICK, workers=0)
    before = mean_loss(model.eval(), module)
    run = trainer(tmp_path, max_epochs=-1, callbacks=[RoadmapSuccess()])
    run.fit(model.train(), module)
    assert 0 <= float(run.callback_metrics["val_success"]) <= 1
    after = mean_loss(model.eval(), module)
    assert after < 0.97 * before

    file = tmp_path / "weights.pt"
    model.save(file)
    saved = torch.load(file, weights_only=True)
    again = load(file)
    assert saved["class"] == kind.__name__
    assert type(again) is kind
    assert again.targets == "lego"
    for one, other in zip(model.parameters(), again.parameters(), strict=True):
        assert torch.allclose(one, other, rtol=1e-3, atol=1e-6)
    again.save(file)  # the first time rounded to 16 bits; from now on nothing changes
    problem = (drawn().grids[0], drawn().starts[0], drawn().goals[0])
    assert np.array_equal(again.sample(*problem, 9), load(file).sample(*problem, 9))


def test_other_weights_are_refused(tmp_path: Path) -> None:
    """A file of torch's that holds no sampler."""
    file = tmp_path / "other.pt"
    torch.save({"weights": {}}, file)
    with pytest.raises(ValueError, match="holds no saved Heatmap or CVAE"):
        load(file)


def test_learns_from_map_start_goal_path(tmp_path: Path) -> None:
    """The default fields of a data module are enough: samples of other maps lie near the paths."""
    pl.seed_everything(0)
    module = MapDataModule(None, build="paper", batch_size=16)
    model = small(Heatmap, targets="path", learning_rate=0.02)
    batch = next(iter(module.val_dataloader()))
    assert batch._fields == ("map", "start", "goal", "path")

    def share_on_paths() -> float:
        """Return how many of five samples a problem lie in cells of its path."""
        grids = batch.map[:, 0].numpy()
        points = model.sample_batch(grids, batch.start.numpy(), batch.goal.numpy(), 5)
        on_path = []
        for cells, path in zip(np.floor(points).astype(int), batch.path, strict=True):
            of_path = path.tolist()
            on_path += [cell in of_path for cell in cells.tolist()]
        return float(np.mean(on_path))

    before = share_on_paths()
    trainer(tmp_path, enable_checkpointing=False).fit(model.train(), module)
    model.eval()
    assert share_on_paths() > before + 0.1


def mean_loss(model: Sampler, module: FixedProblems) -> float:
    """Return the loss of a model on all problems of training."""
    assert model.bank is not None
    torch.manual_seed(1)
    losses = []
    for batch in torch.utils.data.DataLoader(module.datasets["train"], 20):
        points, counts = model.bank.targets("lego", batch.problem)
        owners = torch.arange(len(counts)).repeat_interleave(torch.as_tensor(counts))
        targets = torch.as_tensor(points, dtype=torch.float32)
        with torch.no_grad():
            loss = model.loss(batch._asdict(), targets, owners)["loss"]
        losses.append(float(loss))
    return float(np.mean(losses))


def test_a_batch_without_targets() -> None:
    """Problems so easy that nothing is needed give a loss all the same, and no NaN."""
    module = data(4)
    module.setup("fit")
    fields = module.datasets["train"][0:4]._asdict()
    loss = small(Heatmap).loss(fields, torch.empty(0, 2), torch.empty(0, dtype=torch.int64))
    assert math.isfinite(loss["loss"].item())


# --- the table ----------------------------------------------------------------------------------


def shortest(grid: npt.NDArray[np.uint8], problems: Problems, k: int, points: Points) -> float:
    """Return the length of the shortest path of problem k on a roadmap of these points."""
    ends = [problems.starts[k] + 0.5, problems.goals[k] + 0.5]
    reach = radius(len(points), grid.shape)
    return build_roadmap(grid, np.concatenate([ends, points]), reach).shortest_path()[0]


@pytest.mark.slow
def test_the_table() -> None:
    """Success and lengths are those of plain roadmaps, and the interval holds the value."""
    problems = drawn(40)
    rows = contenders({"untrained": small(Heatmap)})
    both = ["gaussian", "bridge", "corners", "medial_axis", "untrained"]
    assert set(rows) == {"halton", "uniform", *both, *(f"{name}_alone" for name in both)}
    table = compare(rows, problems, [24, 50], bootstrap=50)
    sizes = 2
    subsets = 2
    assert len(table) == len(rows) * sizes * subsets
    assert set(table["problems"]) == {40, int(problems.hard.sum())}
    assert (table["length_ratio"].isna() == (table["success"] == 0)).all()
    solved_some = table[table["success"] > 0]
    for metric in ("success", "length_ratio"):
        assert (solved_some[f"{metric}_low"] <= solved_some[metric]).all()
        assert (solved_some[f"{metric}_high"] >= solved_some[metric]).all()
    assert "hard: " in to_text(table)

    lengths = []
    dense_lengths = []
    for k, grid in enumerate(problems.grids):
        lengths.append(shortest(grid, problems, k, halton(grid, 24, k)))
        # docstring of `compare`: a Halton roadmap of its own seeds
        dense = halton(grid, DENSE, 10_000_019 + k)
        dense_lengths.append(shortest(grid, problems, k, dense))
    is_solved = np.isfinite(lengths)
    both_solved = is_solved & np.isfinite(dense_lengths)
    ratios = np.divide(lengths, dense_lengths, where=both_solved, out=np.zeros(40))[both_solved]
    of_halton = table[table["sampler"] == "halton"]
    row = of_halton[(of_halton["subset"] == "all") & (of_halton["n"] == 24)].iloc[0]
    assert row["success"] == pytest.approx(is_solved.mean())
    assert row["length_ratio"] == pytest.approx(ratios.mean())


def test_a_perfect_sampler_is_perfect() -> None:
    """One that samples the shortest path itself solves all problems, and as short as it gets."""
    problems = drawn()

    def perfect(*given: Any) -> Points:
        """Return the inner points of each path, the last of them as often as n asks for."""
        n = given[3]
        found = np.empty((len(problems), n, 2))
        for k in range(len(problems)):
            inner = first_path(problems, k)[1:-1]
            found[k] = inner[np.minimum(np.arange(n), len(inner) - 1)]
        return found

    table = compare({"perfect": perfect, "halton": contenders({})["halton"]}, problems, [100])
    of_all = table[table["subset"] == "all"].set_index("sampler")
    assert of_all.success["perfect"] == 1
    assert of_all.success_low["perfect"] == 1
    assert of_all.length_ratio["perfect"] == pytest.approx(1, abs=0.01)
    assert of_all.length_ratio["perfect"] < of_all.length_ratio["halton"]


def test_a_roadmap_of_one_vertex_is_refused() -> None:
    """Sizes count both ends."""
    with pytest.raises(ValueError, match="sizes of 2 or more"):
        compare(contenders({}), drawn(), [1])


def test_every_row_has_n_free_points() -> None:
    """Odd sizes too; half of the learned rows are the same Halton points as in every other row."""
    problems = drawn()
    given = (problems.grids, problems.starts, problems.goals)
    rows = contenders({"untrained": small(CVAE)})
    for n in (2, 25):
        own = n // 2
        spread = n - own
        points = {name: row(*given, n, range(12)) for name, row in rows.items()}
        for found in points.values():
            assert found.shape == (12, n, 2)
            for grid, each in zip(problems.grids, found, strict=True):
                assert free_at(grid, each).all()
        for name in ("gaussian", "bridge", "corners", "medial_axis", "untrained"):
            assert np.array_equal(points[name][:, :spread], points["halton"][:, :spread])
            alone = rows[f"{name}_alone"](*given, own, range(12))
            assert np.array_equal(points[name][:, spread:], alone)


def test_the_figure() -> None:
    """Success against n, a line a sampler, with its interval: no bar goes beyond what it states."""
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    rows = contenders({})
    table = compare(rows, drawn(), [10, 20], bootstrap=50)
    axes = plot_success(table, Figure().add_subplot(), "all")
    assert len(axes.lines) == len(rows) == 10
    shown = table[table["subset"] == "all"].pivot(index="n", columns="sampler")
    bars = [each for each in axes.collections if isinstance(each, LineCollection)]
    for name, bar in zip(table["sampler"].unique(), bars, strict=True):
        ends = np.array([segment[:, 1] for segment in bar.get_segments()])
        success = shown["success"][name]
        assert np.allclose(ends[:, 0], np.minimum(shown["success_low"][name], success))
        assert np.allclose(ends[:, 1], np.maximum(shown["success_high"][name], success))


# --- scripts and weights ------------------------------------------------------------------------


@pytest.fixture
def main(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Callable[[str], Callable[[list[str]], None]]:
    """Return what gives a script's main function, which is to write into a folder of its own."""
    monkeypatch.chdir(tmp_path)

    def of(name: str) -> Callable[[list[str]], None]:
        found: Callable[[list[str]], None] = runpy.run_path(str(ROOT / "scripts" / name))["main"]
        return found

    return of


def test_evaluate_script(
    main: Callable[[str], Callable[[list[str]], None]], tmp_path: Path
) -> None:
    """The JSON rows, the same as CSV, and the figure."""
    small(Heatmap).save(tmp_path / "lego_heatmap.pt")
    script = main("evaluate_sampler.py")
    small_run = "--preset dungeon --maps 6 --seed 5 --sizes 24 --weights ."
    outputs = "--json rows.json --csv rows.csv --figure success.png"
    script([*small_run.split(), *outputs.split()])
    table = pd.read_json("rows.json")
    samplers = set(table["sampler"])
    assert {"sampler", "subset", "n", "success", "length_ratio"} <= set(table)
    assert {"halton", "corners_alone", "lego_heatmap", "lego_heatmap_alone"} <= samplers
    pd.testing.assert_frame_equal(pd.read_csv("rows.csv"), table, check_dtype=False)
    assert (tmp_path / "success.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        ("--json none/rows.json", "there is no folder none"),
        ("--weights none", "weights: there is no folder none"),
        ("--preset caves", "preset: got 'caves', expected one of paper"),
        ("--sizes 1", "sizes of 2 or more"),
    ],
)
def test_evaluate_script_refuses(
    main: Callable[[str], Callable[[list[str]], None]],
    wrong: str,
    why: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """What cannot be done is one line and exit code 2."""
    with pytest.raises(SystemExit) as stopped:
        main("evaluate_sampler.py")(["--maps", "2", *wrong.split()])
    assert stopped.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert why in line


@pytest.mark.soak
@pytest.mark.filterwarnings("ignore")
def test_training_script(main: Callable[[str], Callable[[list[str]], None]]) -> None:
    """Its file of arguments works for every sampler; the bank is mined once; the weights load."""
    recipe = json.dumps({"spec": DUNGEON.to_dict(), "seed": 903, "maps": 50})
    short = {
        "max_steps": 4,
        "val_check_interval": 2,
        "limit_val_batches": 1,
        "precision": 32,
        "log_every_n_steps": 1,
    }
    flags = [f"--trainer.{name}={value}" for name, value in short.items()]
    flags += [f"--data.build={recipe}", "--data.batch_size=8"]
    for kind, targets in (("Heatmap", "lego"), ("CVAE", "shortest_path")):
        script = main("train_lego_sampler.py")
        file = f"{kind}.pt"
        model = [f"--model={kind}", f"--model.targets={targets}"]
        script(["fit", f"--weights={file}", *flags, *model])
        assert type(load(file)).__name__ == kind
        assert load(file).targets == targets
    assert len(list(Path("runs/experience").iterdir())) == 1


def test_the_weights_are_there() -> None:
    """Three at least, a few MB in all, and they load safely."""
    names = {"lego_cvae", "lego_heatmap", "shortest_path_heatmap"}
    assert names <= {file.stem for file in WEIGHTS}
    assert sum(file.stat().st_size for file in WEIGHTS) < 6_000_000
    for file in WEIGHTS:
        assert file.stem.startswith(load(file).targets)


@pytest.mark.soak
def test_the_weights_that_ship() -> None:
    """They reach what the table of the README says, on problems not seen."""
    rows = contenders({file.stem: load(file) for file in WEIGHTS})
    table = compare(rows, drawn(600), bootstrap=1)
    success = table.set_index(["sampler", "subset", "n"])["success"]
    assert success["lego_heatmap", "all", 50] > success["shortest_path_heatmap", "all", 50]
    assert success["lego_heatmap", "all", 50] > success["halton", "all", 100]
    assert success["lego_heatmap", "all", 24] > 0.86
    assert success["lego_heatmap", "hard", 50] > 0.94
