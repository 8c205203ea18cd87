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
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
import pytorch_lightning as pl
import torch
from scipy.sparse.csgraph import dijkstra

from mapdata import MapDataModule, MapSpec, Problems, inflate
from models.common import load_model, random_symmetry
from models.cvae import CVAE
from models.experience import (
    KINDS,
    Bank,
    FixedProblems,
    Mining,
    bottlenecks,
    mine,
    near_optimal_paths,
)
from models.lego_sampler import FIELDS, Heatmap, Sampler, encode, select
from models.roadmap import build_roadmap, free_at, halton, radius, sees
from models.sampler_table import (
    RoadmapSuccess,
    compare,
    contenders,
    plot_success,
    to_text,
)

ROOT = Path(__file__).parents[2]
WEIGHTS = sorted(
    [*ROOT.glob("models/weights/lego_*.pt"), *ROOT.glob("models/weights/shortest_path_*.pt")]
)
DUNGEON = MapSpec.preset("dungeon")
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
    sizes: dict[str, Any] = (
        {"width": 16, "code": 8} if kind is CVAE else {"widths": (8, 8, 8), "passes": 1}
    )
    return kind(**(sizes | arguments)).eval()


def data(problems: int = 40, **arguments: Any) -> FixedProblems:
    """Return a data module of online maps."""
    recipe = json.dumps({"spec": DUNGEON.to_dict(), "seed": 902, "maps": math.ceil(problems / 0.8)})
    given: dict[str, Any] = {
        "batch_size": 8,
        "fields": FIELDS,
        "problems": "random",
        "movement": (8, False, 2**0.5),
    }
    return FixedProblems(None, build=recipe, **(given | arguments))


def doors() -> npt.NDArray[np.uint8]:
    """Return a map of two rooms; of the two doors between them one is nearer to the middle."""
    grid = np.ones((40, 40), np.uint8)
    grid[4:36, 4:18] = grid[4:36, 22:36] = 0
    grid[17, 18:22] = grid[30, 18:22] = 0
    return grid


# --- experience ---------------------------------------------------------------------------------


def test_bottlenecks_lie_in_the_door() -> None:
    """What a sparse roadmap cannot avoid: where it sees no way through the wall, only the path's
    points in the door.
    """
    grid, start, goal = doors(), np.array([10, 6]), np.array([10, 33])
    for seed in range(5):
        path = near_optimal_paths(grid, start, goal, Mining(), seed)[0]
        sparse = np.array([[8.5, 10.5], [20.5, 12.5], [10.5, 28.5], [25.5, 30.5]])
        found = bottlenecks(grid, path, sparse, 50, 10.0)
        assert len(found)
        assert ((found[:, 1] > 17) & (found[:, 1] < 23)).any()
        assert len(found) < len(path) - 2
        through = np.concatenate(
            [sparse, [[17.5, 17.5], [17.5, 22.5]]]
        )  # a dear way round: nothing is bought
        assert len(bottlenecks(grid, path, through, 50, 10.0)) == 0
        assert plain_bottlenecks(grid, path, through) == set()


def test_bottlenecks_join_start_and_goal() -> None:
    """The sparse roadmap with nothing but its bottlenecks has a path: that is what they are for."""
    problems = drawn()
    for k in range(len(problems)):
        grid, ends = problems.grids[k], (problems.starts[k], problems.goals[k])
        path = near_optimal_paths(grid, *ends, Mining(), k)[0]
        sparse = halton(grid, 12, k)
        needed = bottlenecks(grid, path, sparse, 24, 10.0)
        roadmap = build_roadmap(
            grid, np.concatenate([path[[0, -1]], needed, sparse]), radius(24, grid.shape)
        )
        assert math.isfinite(roadmap.shortest_path()[0])


def plain_bottlenecks(
    grid: npt.NDArray[np.uint8], path: npt.NDArray[np.float64], sparse: npt.NDArray[np.float64]
) -> set[tuple[float, float]]:
    """Return the inner points of the path that LEGO's code keeps: edge by edge, on a matrix."""
    places = np.concatenate([path, sparse])
    weights = np.zeros((len(places), len(places)))
    for a, b in build_roadmap(grid, places, radius(50, grid.shape)).edges:
        weights[a, b] = weights[b, a] = math.dist(places[a], places[b])
    length = sum(math.dist(a, b) for a, b in itertools.pairwise(path))
    factor = 10.0
    while True:
        dear = weights.copy()
        dear[: len(path)] *= factor
        dear[len(path) :, : len(path)] *= factor
        costs, before = dijkstra(dear, indices=0, return_predecessors=True)
        if costs[len(path) - 1] >= 10 * length:
            break
        factor *= 1.2
    kept = set()
    vertex = before[len(path) - 1]
    while vertex > 0:
        if vertex < len(path):
            kept.add(tuple(places[vertex].tolist()))
        vertex = before[vertex]
    return kept


def test_bottlenecks_are_those_of_the_published_code() -> None:
    """Edges of start and goal are dear too, and the last factor decides; some differ from 10."""
    problems = drawn()
    for k in range(len(problems)):
        grid, ends = problems.grids[k], (problems.starts[k], problems.goals[k])
        path = near_optimal_paths(grid, *ends, Mining(), k)[0]
        sparse = halton(grid, 25, k)
        found = bottlenecks(grid, path, sparse, 50, 10.0)
        assert set(map(tuple, found.tolist())) == plain_bottlenecks(grid, path, sparse)


def test_near_optimal_paths() -> None:
    """Valid, the first the shortest, all within the slack; the adversary finds the other door if it
    is near.
    """
    grid, start, goal = doors(), np.array([22, 6]), np.array([22, 33])
    tight, loose = (Mining(slack=slack, attempts=20) for slack in (1.0, 2.0))
    used = set()
    for seed in range(6):
        paths = near_optimal_paths(grid, start, goal, loose, seed)
        lengths = [np.linalg.norm(np.diff(path, axis=0), axis=1).sum() for path in paths]
        assert lengths[0] == min(lengths)
        assert max(lengths) <= 2 * lengths[0]
        for path in paths:
            assert sees(grid, path[:-1], path[1:]).all()
            assert path[[0, -1]].tolist() == [[22.5, 6.5], [22.5, 33.5]]
            used.add(bool((path[(path[:, 1] > 18) & (path[:, 1] < 22), 0] > 25).any()))
        assert len(near_optimal_paths(grid, start, goal, tight, seed)) == 1
    assert used == {False, True}
    assert (
        near_optimal_paths(
            np.array([[0, 1, 0]], np.uint8), np.array([0, 0]), np.array([0, 2]), Mining(), 0
        )
        == []
    )


def test_the_bank(tmp_path: Path) -> None:
    """Mined once and read again; its rows are those of the problems, whatever the workers; other
    mining, other file.
    """
    module = data(30)
    module.setup("fit")
    dataset = module.datasets["train"]
    bank = Bank.of(dataset, tmp_path, QUICK, workers=0)
    again = Bank.of(dataset, tmp_path, QUICK, workers=0)
    assert bank.identity == again.identity
    assert len(list(tmp_path.iterdir())) == 1
    assert (
        bank.identity
        != Bank.of(dataset, tmp_path, Mining(dense=300, sizes=(24,)), workers=0).identity
    )
    for number in (0, 7, 29):
        sample = dataset[number]
        truth = mine(
            sample.map[0].numpy(), sample.start.numpy(), sample.goal.numpy(), QUICK, number
        )
        for kind, points in zip(KINDS, truth, strict=True):
            found, counts = again.targets(kind, [number])
            assert counts.tolist() == [len(points)]
            np.testing.assert_allclose(found, points, atol=1e-5)
            assert free_at(sample.map[0], found).all()
    both, counts = bank.targets("lego", [7, 3, 7])
    assert counts[0] == counts[2]
    assert np.array_equal(both[: counts[0]], both[counts[:2].sum() :])


@pytest.mark.slow
def test_workers_change_nothing(tmp_path: Path) -> None:
    """Two threads mine what one mines."""
    module = data(230)
    module.setup("fit")
    banks = [
        Bank.of(module.datasets["train"], tmp_path / str(workers), QUICK, workers)
        for workers in (1, 2)
    ]
    files = [next((tmp_path / name).iterdir()).read_bytes() for name in ("1", "2")]
    assert banks[0].identity == banks[1].identity
    assert files[0] == files[1]


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


def test_fixed_problems_stay() -> None:
    """Every epoch has the same problems in another order; a plain data module draws others."""
    seen: dict[bool, list[dict[int, list[int]]]] = {}
    for fixed in (True, False):
        module: MapDataModule = data(20)
        if not fixed:
            module = MapDataModule(None, **{k: v for k, v in module.hparams.items() if k != "root"})
        loader = module.train_dataloader()
        epochs = [
            [row for batch in loader for row in zip(batch.problem, batch.start, strict=True)]
            for _ in range(2)
        ]
        orders = [[int(number) for number, _ in epoch] for epoch in epochs]
        assert orders[0] != orders[1]
        assert sorted(orders[0]) == sorted(orders[1])
        seen[fixed] = [{int(number): start.tolist() for number, start in epoch} for epoch in epochs]
    assert seen[True][0] == seen[True][1] == seen[False][0]
    assert seen[False][0] != seen[False][1]


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
    for n in (1, 12, 60):
        found = model.sample(grid, free[0], free[-1], n, seed=3)
        assert found.shape == (n, 2)
        assert free_at(grid, found).all()
        assert np.array_equal(found, model.sample(grid[None], free[0], free[-1], n, seed=3))
        assert np.array_equal(found, model.sample(255 * grid, free[0], free[-1], n, seed=3))
        assert not np.array_equal(found, model.sample(grid, free[0], free[-1], n, seed=4))


@pytest.mark.parametrize("kind", [Heatmap, CVAE])
def test_what_is_refused(kind: type[Any]) -> None:
    """A map without free space, a start or goal in a wall or outside, no sample, a
    robot that does not fit, a resolution that is none.
    """
    model, grid = small(kind), np.zeros((16, 16), np.uint8)
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
    found = model.sample(
        grid, start, goal, 40, radius=0.15, resolution=0.1, origin=(-3.0, 7.0)
    )  # 0.15 / 0.1 is not quite 1.5
    assert found.shape == (40, 2)
    right = found[:, 0] + 3.0  # metres from the left edge
    above = found[:, 1] - 7.0  # metres from the lower edge, of 20 rows
    np.testing.assert_allclose(right, cells[:, 1] / 10)
    np.testing.assert_allclose(above, 2.0 - cells[:, 0] / 10)


def test_padding_changes_nothing() -> None:
    """A map that was walled in to a multiple of 16 has the same shares, seen one way."""
    model = small(Heatmap, views=1)
    assert isinstance(model, Heatmap)
    grid = (np.random.default_rng(1).random((21, 30)) < 0.4).astype(np.uint8)
    ends = np.argwhere(grid == 0)[[0, -1]]
    walled = np.pad(grid, ((0, 11), (0, 2)), constant_values=1)
    shares = [model.heat_map(each[None], ends[:1], ends[1:])[0] for each in (grid, walled)]
    np.testing.assert_allclose(shares[0], shares[1][:21, :30], rtol=1e-3)
    assert shares[0].sum() == pytest.approx(1)
    assert (shares[0][grid != 0] == 0).all()


def test_choosing_cells() -> None:
    """Without noise: the likeliest first, then those it has not made unlikely; every cell once
    before any twice.
    """
    shares = np.zeros((1, 1, 20))
    shares[0, 0, [3, 4, 15]] = 0.5, 0.3, 0.2
    none = np.zeros_like(shares)
    assert select(shares, none, 3, 1.5)[0, :, 1].tolist() == [3, 15, 4]
    assert select(shares, none, 3, 0.1)[0, :, 1].tolist() == [3, 4, 15]
    seven = select(shares, none, 7, 1.5)[0, :, 1]
    assert sorted(seven[:3]) == sorted(seven[3:6]) == [3, 4, 15]
    source = np.random.default_rng(0)
    many = np.repeat(shares, 4000, axis=0)
    first = select(many, source.gumbel(size=many.shape), 1, 1.0)[:, 0, 1]
    np.testing.assert_allclose(
        [(first == cell).mean() for cell in (3, 4, 15)], [0.5, 0.3, 0.2], atol=0.03
    )


def test_symmetries_move_everything_along() -> None:
    """Points, ends and masks stay on the cells they were on, under all the symmetries and swaps
    that turn up.
    """
    problems = drawn()
    grids, ends = (
        torch.from_numpy(problems.grids.copy())[:, None],
        [problems.starts.copy(), problems.goals.copy()],
    )
    marks = torch.zeros_like(grids)
    for cells in ends:
        marks[torch.arange(len(grids)), 0, cells[:, 0], cells[:, 1]] = 1
    fields = {
        "map": grids,
        "optimal_mask": marks,
        "start": torch.tensor(ends[0]),
        "goal": torch.tensor(ends[1]),
    }
    torch.manual_seed(0)
    kinds = set()
    for _ in range(300):
        turned, points = random_symmetry(fields, torch.tensor(ends[0]) + 0.25)
        for name in ("start", "goal"):
            row, column = turned[name].T
            assert (turned["optimal_mask"][torch.arange(len(grids)), 0, row, column] == 1).all()
        at = points.floor().long()
        swapped = bool((at != turned["start"]).any())
        assert torch.equal(at, turned["goal" if swapped else "start"])
        assert (turned["map"].sum(dim=(1, 2, 3)) == grids.sum(dim=(1, 2, 3))).all()
        kinds.add((swapped, tuple(turned["start"][0].tolist())))
    assert len(kinds) == 16


def test_what_the_networks_see() -> None:
    """Each end once, distances from both, no detour on the straight line between them."""
    seen = encode(torch.zeros(1, 1, 9, 12), torch.tensor([[2, 1]]), torch.tensor([[2, 10]]))[0]
    assert seen.shape == (14, 9, 12)
    assert [tuple(seen[k].nonzero()[0].tolist()) for k in (1, 7)] == [(2, 1), (2, 10)]
    assert seen[1].sum() == seen[7].sum() == 1
    np.testing.assert_allclose(seen[13, 2, 1:11], 0, atol=1e-6)
    assert (seen[13, 5] > 0).all()
    assert seen[2, 5, 3] == pytest.approx(3 / 32)
    assert seen[6, 2, 4] == pytest.approx(3 / 64)


@pytest.mark.parametrize("kind", [Heatmap, CVAE])
def test_a_tiny_run(kind: type[Sampler], tmp_path: Path) -> None:
    """It learns from a data module's batches and a bank; what it saves is the same model again."""
    pl.seed_everything(0)
    module, model = data(40), small(kind, learning_rate=0.02)
    module.setup("fit")
    model.bank = Bank.of(module.datasets["train"], tmp_path, QUICK, workers=0)
    before = _mean_loss(model.eval(), module)
    model.train()
    quiet: dict[str, Any] = {
        "enable_progress_bar": False,
        "enable_model_summary": False,
        "logger": False,
    }
    run = pl.Trainer(
        default_root_dir=tmp_path,
        accelerator="cpu",
        max_steps=60,
        max_epochs=-1,
        limit_val_batches=1,
        callbacks=[RoadmapSuccess()],
        **quiet,
    )
    run.fit(model, module)
    assert 0 <= float(run.callback_metrics["val_success"]) <= 1
    assert _mean_loss(model.eval(), module) < 0.97 * before
    model.save(tmp_path / "weights.pt")
    saved, again = (
        torch.load(tmp_path / "weights.pt", weights_only=True),
        load(tmp_path / "weights.pt"),
    )
    assert saved["class"] == kind.__name__
    assert type(again) is kind
    assert again.targets == "lego"
    problem = drawn().grids[0], drawn().starts[0], drawn().goals[0]
    again.save(tmp_path / "weights.pt")  # the first time rounds to 16 bits
    assert np.array_equal(
        again.sample(*problem, 9), load(tmp_path / "weights.pt").sample(*problem, 9)
    )
    for one, other in zip(model.parameters(), again.parameters(), strict=True):
        assert torch.allclose(one, other, rtol=1e-3, atol=1e-6)
    torch.save({"weights": {}}, tmp_path / "other.pt")
    with pytest.raises(ValueError, match="holds no saved Heatmap or CVAE"):
        load(tmp_path / "other.pt")


def test_learns_from_map_start_goal_path(tmp_path: Path) -> None:
    """The default fields of a data module are enough: samples of other maps lie near the paths."""
    pl.seed_everything(0)
    module = MapDataModule(None, build="paper", batch_size=16)
    model = small(Heatmap, targets="path", learning_rate=0.02)
    batch = next(iter(module.val_dataloader()))
    assert batch._fields == ("map", "start", "goal", "path")
    on_path = [set(map(tuple, cells.tolist())) for cells in batch.path]

    def share() -> float:
        grids = batch.map[:, 0].numpy()
        points = model.sample_batch(grids, batch.start.numpy(), batch.goal.numpy(), 5)
        cells = np.floor(points).astype(int).tolist()
        found = [
            tuple(cell) in path for path, each in zip(on_path, cells, strict=True) for cell in each
        ]
        return float(np.mean(found))

    before = share()
    run = pl.Trainer(
        default_root_dir=tmp_path,
        accelerator="cpu",
        max_steps=60,
        limit_val_batches=1,
        enable_progress_bar=False,
        enable_model_summary=False,
        enable_checkpointing=False,
        logger=False,
    )
    run.fit(model.train(), module)
    model.eval()
    assert share() > before + 0.1


def _mean_loss(model: Sampler, module: FixedProblems) -> float:
    assert model.bank is not None
    losses = []
    torch.manual_seed(1)
    for batch in torch.utils.data.DataLoader(module.datasets["train"], 20):
        fields = dict(zip(batch._fields, batch, strict=True))
        points, counts = model.bank.targets("lego", batch.problem)
        owners = torch.arange(len(counts)).repeat_interleave(torch.as_tensor(counts))
        with torch.no_grad():
            losses.append(
                float(
                    model.loss(fields, torch.as_tensor(points, dtype=torch.float32), owners)["loss"]
                )
            )
    return float(np.mean(losses))


def test_a_batch_without_targets() -> None:
    """Problems so easy that nothing is needed give a loss all the same, and no NaN."""
    module = data(4)
    module.setup("fit")
    fields = module.datasets["train"][0:4]._asdict()
    loss = small(Heatmap).loss(fields, torch.empty(0, 2), torch.empty(0, dtype=torch.int64))
    assert math.isfinite(loss["loss"].item())


# --- the table ----------------------------------------------------------------------------------


def test_the_table() -> None:
    """Success and lengths are those of plain roadmaps; the interval holds the value; a perfect
    sampler is perfect.
    """
    problems = drawn(40)
    rows = contenders({"untrained": small(Heatmap)})
    both = ["gaussian", "bridge", "corners", "medial_axis", "untrained"]
    assert set(rows) == {"halton", "uniform", *both, *(f"{name}_alone" for name in both)}
    table = compare(rows, problems, [24, 50], bootstrap=50)
    assert len(table) == 12 * 2 * 2
    assert set(table["problems"]) == {40, int(problems.hard.sum())}
    assert (table["length_ratio"].isna() == (table["success"] == 0)).all()
    solved_some = table[table["success"] > 0]
    for metric in ("success", "length_ratio"):
        assert (solved_some[f"{metric}_low"] <= solved_some[metric]).all()
        assert (solved_some[f"{metric}_high"] >= solved_some[metric]).all()
    solved = 0
    for k, grid in enumerate(problems.grids):
        places = np.concatenate(
            [[problems.starts[k] + 0.5, problems.goals[k] + 0.5], halton(grid, 24, k)]
        )
        solved += math.isfinite(
            build_roadmap(grid, places, radius(24, grid.shape)).shortest_path()[0]
        )
    at = table[(table["sampler"] == "halton") & (table["subset"] == "all") & (table["n"] == 24)]
    assert float(at["success"].iloc[0]) == pytest.approx(solved / 40)
    assert "hard: " in to_text(table)
    with pytest.raises(ValueError, match="sizes of 2 or more"):
        compare(rows, problems, [1])


def test_every_row_has_n_free_points() -> None:
    """Odd sizes too; half of the learned rows are the same Halton points as in every other row."""
    problems = drawn()
    given = problems.grids, problems.starts, problems.goals
    rows = contenders({"untrained": small(CVAE)})
    for n in (2, 25):
        points = {name: row(*given, n, range(12)) for name, row in rows.items()}
        for found in points.values():
            assert found.shape == (12, n, 2)
            assert all(
                free_at(grid, each).all() for grid, each in zip(problems.grids, found, strict=True)
            )
        for name in ("gaussian", "bridge", "corners", "medial_axis", "untrained"):
            assert np.array_equal(points[name][:, : n - n // 2], points["halton"][:, : n - n // 2])
            own = rows[f"{name}_alone"](*given, n // 2, range(12))
            assert np.array_equal(points[name][:, n - n // 2 :], own)


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
    """The table, the JSON rows and the figure; what cannot be done is one line and exit code
    2.
    """
    small(Heatmap).save(tmp_path / "lego_heatmap.pt")
    script = main("evaluate_sampler.py")
    outputs = [
        "--json",
        "rows.json",
        "--csv",
        "rows.csv",
        "--figure",
        "success.png",
    ]
    script(
        [
            "--preset",
            "dungeon",
            "--maps",
            "6",
            "--seed",
            "5",
            "--sizes",
            "24",
            "--weights",
            ".",
            *outputs,
        ]
    )
    table = pd.read_json("rows.json")
    assert {"sampler", "subset", "n", "success", "length_ratio"} <= set(table)
    assert {"halton", "corners_alone", "lego_heatmap", "lego_heatmap_alone"} <= set(
        table["sampler"]
    )
    assert all((tmp_path / name).stat().st_size > 1000 for name in ("success.png", "rows.csv"))
    for wrong in (
        ["--json", "none/rows.json"],
        ["--weights", "none"],
        ["--preset", "caves"],
        ["--sizes", "1"],
    ):
        with pytest.raises(SystemExit) as stopped:
            script(["--maps", "2", *wrong])
        assert stopped.value.code == 2


@pytest.mark.slow
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
    for kind, targets in (("Heatmap", "lego"), ("CVAE", "shortest_path")):
        script, file = main("train_lego_sampler.py"), f"{kind}.pt"
        model = [f"--model={kind}", f"--model.targets={targets}"]
        script(
            [
                "fit",
                f"--weights={file}",
                f"--data.build={recipe}",
                "--data.batch_size=8",
                *flags,
                *model,
            ]
        )
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


@pytest.mark.slow
def test_the_weights_that_ship() -> None:
    """They reach what the table of the README says, on problems not seen."""
    table = compare(
        contenders({file.stem: load(file) for file in WEIGHTS}), drawn(600), bootstrap=1
    )
    of = table.set_index(["sampler", "subset", "n"])
    assert of.success["lego_heatmap", "all", 50] > of.success["shortest_path_heatmap", "all", 50]
    assert of.success["lego_heatmap", "all", 50] > of.success["halton", "all", 100]
    assert of.success["lego_heatmap", "all", 24] > 0.86
    assert of.success["lego_heatmap", "hard", 50] > 0.94
