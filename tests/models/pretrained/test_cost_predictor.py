"""The model that reads costs from images: its loss, its search, and that paths alone teach it."""

from __future__ import annotations

from dataclasses import astuple
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from mapdata import Movement, OnlineMapDataset, Sample, Terrain, Tiles, check_path, search_batch
from mapdata.arrays import Bytes, Floats
from mapdata.models import CostPredictor
from mapdata.models.pretrained.cost_predictor import (
    TRAINING_FIELDS,
    centred,
    path_weights,
    random_parts,
)

TILES = Movement(8, corner_cutting=True, diagonal_cost=1)

MOVEMENTS = [Movement(4), Movement(8), Movement(8, corner_cutting=True), TILES]


def problems(count: int, seed: int, *, movement: Movement = TILES) -> OnlineMapDataset:
    """Return problems from corner to corner of maps whose costs differ in their textures alone."""
    family = Terrain(
        (12, 12), costs=(8, 12, 53, 77, 92), obstacles=0.0, corners=True, movement=movement
    )
    fields = (*TRAINING_FIELDS, Tiles(alike=True))
    return OnlineMapDataset(family, seed=seed, length=count, fields=fields)


def batch(count: int, seed: int = 0, *, movement: Movement = TILES) -> Sample:
    """Return `problems` as one batch."""
    samples: Sample = next(iter(DataLoader(problems(count, seed, movement=movement), count)))
    return samples


class TrueCosts(CostPredictor):
    """A model that has learned everything: it is handed the true terrain, times a factor."""

    def __init__(self, terrain: torch.Tensor, movement: Movement) -> None:
        """Keep the terrain, (B, 1, H, W)."""
        super().__init__(*astuple(movement))
        self.costs = torch.nn.Parameter(terrain[:, 0].float())

    def forward(self, image: torch.Tensor, occupied: torch.Tensor) -> torch.Tensor:
        """Return the costs that were given."""
        return self.costs


@pytest.mark.parametrize("movement", MOVEMENTS, ids=str)
def test_weights_times_costs_are_the_costs_of_paths(movement: Movement) -> None:
    """The sum over the cells is what `check_path` says, for two paths on each map."""
    generator = np.random.default_rng(3)
    terrain = generator.integers(1, 256, (6, 9, 7)).astype(np.uint8)
    terrain[generator.random(terrain.shape) < 0.15] = 0
    terrain[:, 0, 0] = terrain[:, -1, -1] = 4
    grids = (terrain == 0).astype(np.uint8)
    maps = np.repeat(np.arange(6), 2)
    starts = np.tile([[0, 0], [8, 6]], (6, 1))
    goals = np.tile([[8, 6], [0, 0]], (6, 1))
    found = search_batch("astar", grids[maps], starts, goals, movement)
    weights = path_weights(found.cells, found.offsets, grids, movement, maps)
    solved = 0
    for k in range(6):
        expected = 0.0
        for path in np.split(found.cells, found.offsets[1:-1])[2 * k : 2 * k + 2]:
            if len(path):
                expected += check_path(grids[k], path, movement, terrain=terrain[k])
                solved += 1
        assert (weights[k].astype(np.float64) * terrain[k]).sum() == pytest.approx(expected)
    assert solved > 4


def test_parts_are_runs_of_their_path() -> None:
    """The whole path comes first, then ``count`` parts of at least three cells; none of short
    paths, and nothing where there is no path.
    """
    paths = np.full((4, 16, 2), -1)
    for k, length in enumerate((9, 3, 1, 0)):
        paths[k, :length] = np.stack((np.arange(length), 2 * np.arange(length)), axis=1) + k
    numbers, parts = random_parts(paths, count=50)
    assert numbers.tolist() == [0] * 51 + [1]
    assert len(parts[0]) == 9
    assert len(parts[51]) == 3
    lengths = set()
    for part in parts[:51]:
        first = part[0, 0]
        np.testing.assert_array_equal(part, paths[0, first : first + len(part)])
        lengths.add(len(part))
    assert min(lengths) == 3
    assert len(lengths) > 3


@pytest.mark.parametrize("movement", MOVEMENTS, ids=str)
def test_the_true_costs_have_no_loss(movement: Movement) -> None:
    """The loss is zero for the true costs, up to rounding, and positive for equal costs."""
    samples = batch(20, movement=movement)
    # The largest cost is 255, so that the search sees the same numbers.
    scaled = (samples.terrain.float() * 255 / 92).round()
    right = TrueCosts(scaled, movement).path_loss(samples)
    assert abs(right.item()) < 1e-3
    # The reverse order of costs is wrong under every movement. With equal costs and 4 moves nearly
    # all paths between two cells are shortest ones.
    reversed_costs = 256 - scaled
    wrong = TrueCosts(reversed_costs, movement).path_loss(samples)
    assert wrong.item() > 30


def test_the_gradient_lowers_given_paths_and_raises_found_ones() -> None:
    """A cell of the given path alone has a positive gradient, and one of the other path alone a
    negative one, so that a step against the gradient makes the given path cheaper.
    """
    samples = batch(20)
    model = TrueCosts(torch.ones_like(samples.terrain, dtype=torch.float), TILES)
    model.hparams["parts"] = 0
    model.path_loss(samples).backward()
    assert model.costs.grad is not None
    found = search_batch(
        "astar",
        samples.map[:, 0].numpy(),
        samples.start.numpy(),
        samples.goal.numpy(),
        TILES,
        terrain=np.full((20, 12, 12), 255, np.uint8),
    )
    differing = 0
    for k, found_path in enumerate(np.split(found.cells, found.offsets[1:-1])):
        given = {tuple(cell) for cell in samples.path[k].tolist() if cell[0] >= 0}
        other = {tuple(cell) for cell in found_path.tolist()}
        gradient = model.costs.grad[k]
        assert all(gradient[cell] > 0 for cell in given - other)
        assert all(gradient[cell] < 0 for cell in other - given)
        untouched = torch.ones(12, 12, dtype=torch.bool)
        for cell in given | other:
            untouched[cell] = False
        assert (gradient[untouched] == 0).all()
        differing += len(given - other)
    assert differing > 50


def test_costs_have_one_scale_on_every_map() -> None:
    """The geometric mean over free cells is about 1, and occupied cells do not count."""
    torch.manual_seed(0)
    model = CostPredictor()
    image = torch.randint(0, 256, (3, 3, 40, 64), dtype=torch.uint8)
    occupied = (torch.rand(3, 1, 5, 8) < 0.3).byte()
    costs = model(image, occupied).detach() - 0.01
    for k in range(3):
        free = occupied[k, 0] == 0
        assert float(costs[k][free].log().mean()) == pytest.approx(0, abs=1e-3)
    assert float(centred(torch.full((3, 5, 8), 7.0), occupied).abs().max()) < 1e-5


def test_images_of_another_size_are_refused() -> None:
    """The message names both shapes."""
    model = CostPredictor()
    with pytest.raises(
        ValueError, match=r"images: got shape \(1, 3, 16, 24\), expected \(1, 3, 24"
    ):
        model.predict(np.zeros((1, 3, 16, 24), np.uint8), np.zeros((1, 3, 2), np.uint8))


def planned_regret(model: CostPredictor, samples: Sample) -> float:
    """Return the mean regret of searching on the predicted terrain, by `check_path`."""
    grids: Bytes = samples.map[:, 0].numpy()
    ends = samples.start.numpy(), samples.goal.numpy()
    terrain = model.predict(samples.image.numpy(), grids)
    truth = samples.terrain[:, 0].numpy()
    found = search_batch("astar", grids, *ends, TILES, terrain=terrain)
    optimal = search_batch("astar", grids, *ends, TILES, terrain=truth)
    paths = np.split(found.cells, found.offsets[1:-1])
    costs = [
        check_path(grid, path, TILES, terrain=costs)
        for grid, path, costs in zip(grids, paths, truth, strict=True)
    ]
    return float(np.mean(costs / optimal.cost - 1))


def fit(model: CostPredictor, steps: int) -> CostPredictor:
    """Train on 16 maps a step."""
    torch.manual_seed(1)
    optimizer = torch.optim.Adam(model.parameters(), 0.01)
    loader = DataLoader(problems(16 * steps, 5), batch_size=16)
    for samples in loader:
        loss = model.losses(samples)["loss"]
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return model


@pytest.mark.slow
@pytest.mark.parametrize(
    ("loss", "highest"),
    [("paths", 0.10), pytest.param("terrain", 0.10, marks=pytest.mark.slow)],
)
def test_the_model_learns_costs(loss: str, highest: float) -> None:
    """After a short training the regret on new maps is far below that of equal costs, 46 %."""
    torch.manual_seed(0)
    samples = batch(100, seed=9)
    model = CostPredictor(loss=loss)  # type: ignore[arg-type]
    assert planned_regret(model, samples) > 0.25
    assert planned_regret(fit(model, 150), samples) < highest


def test_the_loss_of_neural_astar_has_a_gradient() -> None:
    """Cells that are expanded beside the path push their costs up."""
    torch.manual_seed(0)
    model = CostPredictor(loss="expansions")
    loss = model.losses(batch(4))["loss"]
    assert 0 < loss.item() < 1
    loss.backward()
    assert all(float(p.grad.abs().sum()) > 0 for p in model.parameters() if p.grad is not None)


@pytest.mark.parametrize("loss", ["paths", "terrain", "expansions"])
def test_a_batch_without_any_path_has_a_loss(
    loss: Literal["paths", "terrain", "expansions"],
) -> None:
    """It is 0 for losses of paths, and its gradient is finite; neither is NaN logged."""
    samples = batch(4)
    alone = samples._replace(path=torch.full_like(samples.path, -1))
    model = CostPredictor(loss=loss)
    value = model.losses(alone)["loss"]
    value.backward()
    assert all(p.grad is None or p.grad.isfinite().all() for p in model.parameters())
    if loss == "terrain":
        assert value == model.losses(samples)["loss"] > 0
        walls = alone._replace(map=torch.ones_like(alone.map))
        value = model.losses(walls)["loss"]
    assert value == 0


def test_problems_without_a_path_do_not_count_for_expansions() -> None:
    """The loss of a batch is that of its problems that have one."""
    samples = batch(4)
    paths = samples.path.clone()
    paths[1] = -1
    kept = [0, 2, 3]
    model = CostPredictor(loss="expansions")
    found = model.losses(samples._replace(path=paths))["loss"].item()
    rows = samples._replace(**{name: field[kept] for name, field in samples._asdict().items()})
    assert found == pytest.approx(model.losses(rows)["loss"].item(), rel=1e-5)


def test_validation_of_a_batch_without_any_path_logs_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A mean over nothing would make the mean of all batches NaN."""
    logged: list[Any] = []
    model = CostPredictor()
    monkeypatch.setattr(model, "log_dict", lambda scores, **_: logged.append(scores))
    samples = batch(4)
    model.validation_step(samples._replace(goal=samples.start), 0)
    assert not logged
    model.validation_step(samples, 0)
    assert np.isfinite(logged[0]["val_regret"])


def test_an_unknown_loss_is_refused() -> None:
    """The message lists the losses."""
    with pytest.raises(ValueError, match=r"loss: got 'path'.*paths, terrain, expansions"):
        CostPredictor(loss="path")  # type: ignore[arg-type]


def test_weights_survive_a_file(tmp_path: Path) -> None:
    """A model that was saved predicts nearly the same terrain: its weights have 16 bits."""
    torch.manual_seed(0)
    model = CostPredictor(width=8, parts=2)
    model.save(tmp_path / "costs.pt")
    copy = CostPredictor.load(tmp_path / "costs.pt")
    samples = batch(3)
    arguments = samples.image.numpy(), samples.map[:, 0].numpy()
    difference = copy.predict(*arguments).astype(int) - model.predict(*arguments)
    assert copy.hparams["width"] == 8
    assert np.abs(difference).max() <= 2


@pytest.mark.parametrize("size", [(1, 1), (3, 5)])
def test_light_and_contrast_do_not_change_predictions(size: tuple[int, int]) -> None:
    """Of a network that nobody trained, too; and the picture itself stays as it was."""
    torch.manual_seed(0)
    model = CostPredictor()
    rows, columns = size
    image = 60 + 100 * torch.rand(2, 3, 8 * rows, 8 * columns)
    before = image.clone()
    costs = model.log_costs(image)
    assert torch.equal(image, before)
    lighter = model.log_costs(image + 90)
    with_contrast = model.log_costs(128 + 0.6 * (image - 128))
    spread = costs.std().item()
    torch.testing.assert_close(lighter, costs, rtol=0, atol=1e-3 * spread)
    torch.testing.assert_close(with_contrast, costs, rtol=0, atol=0.2 * spread)


@pytest.mark.slow
def test_colours_without_any_texture_are_learned() -> None:
    """Each cell has a single colour, one for each cost, in pictures of different brightness."""
    torch.manual_seed(0)
    colours = torch.tensor([[90, 60, 40], [60, 90, 40], [40, 60, 90], [90, 90, 40], [70, 70, 70]])

    def plain(count: int, seed: int) -> Sample:
        samples = batch(count, seed)
        kinds = torch.searchsorted(torch.tensor([8, 12, 53, 77, 92]), samples.terrain[:, 0])
        light = torch.randint(0, 140, (count, 1, 1, 1))
        cells = colours[kinds].permute(0, 3, 1, 2) + light  # (B, 3, H, W)
        image = cells.repeat_interleave(8, dim=2).repeat_interleave(8, dim=3)
        painted: Sample = samples._replace(image=image.byte())
        return painted

    model = CostPredictor()
    optimizer = torch.optim.Adam(model.parameters(), 0.01)
    for step in range(60):
        loss = model.losses(plain(16, 100 + step))["loss"]
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert planned_regret(model, plain(100, 9)) < 0.02


def test_the_weights_that_ship_find_nearly_optimal_paths() -> None:
    """On new maps, and the textures of the training; docs/costs.md has the figures."""
    samples = batch(200, seed=77)
    assert planned_regret(CostPredictor.pretrained(), samples) < 0.002


@pytest.mark.parametrize(("contrast", "light"), [(1.0, 40), (1.0, -40), (0.5, 0), (1.5, 0)])
def test_the_weights_that_ship_bear_another_light(contrast: float, light: int) -> None:
    """And light that falls from one side; docs/costs.md has the figures."""
    samples = batch(100, seed=78)
    levels = 128 + contrast * (samples.image.double() - 128) + light
    levels += torch.linspace(-20, 20, levels.shape[2])[:, None]
    changed = samples._replace(image=levels.round().clamp(0, 255).byte())
    assert planned_regret(CostPredictor.pretrained(), changed) < 0.002


def test_a_predictor_reads_planes_of_any_size() -> None:
    """Each cell's cost depends on its own numbers alone."""
    model = CostPredictor(planes=2).eval()
    rng = np.random.default_rng(4)
    planes = rng.standard_normal((1, 2, 9, 14)).astype(np.float32)
    grids = np.zeros((1, 9, 14), np.uint8)
    terrain = model.predict(planes, grids)
    assert terrain.shape == (1, 9, 14)
    assert terrain.min() >= 1
    turned = model.predict(np.ascontiguousarray(planes[:, :, ::-1]), grids)
    np.testing.assert_array_equal(turned, terrain[:, ::-1])


@pytest.mark.parametrize(
    ("planes", "message"),
    [
        (np.zeros((1, 3, 9, 14)), r"expected \(1, 2, 9, 14\)"),
        (np.full((1, 2, 9, 14), np.nan), "got the value nan, expected finite numbers"),
    ],
    ids=["shape", "nan"],
)
def test_wrong_planes_are_refused(planes: Floats, message: str) -> None:
    """The message says what was expected."""
    with pytest.raises(ValueError, match=message):
        CostPredictor(planes=2).predict(planes, np.zeros((1, 9, 14), np.uint8))
