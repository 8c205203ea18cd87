"""The field ``image``: pictures of maps equal a slow reference, and tell costs apart."""

from __future__ import annotations

import hashlib
import pickle
from dataclasses import dataclass, field
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from helpers import samples
from helpers.examples import slow
from helpers.reference_tiles import (
    reference_jittered,
    reference_key,
    reference_picture,
    reference_texture,
)
from torch import nn

from mapdata import (
    Forest,
    MapDataModule,
    MapDataset,
    MazeImage,
    OnlineMapDataset,
    Random,
    Recipe,
    Terrain,
    Tiles,
    Waypoints,
    build,
    generate,
)
from mapdata.arrays import Bytes, Ints
from mapdata.datasets.tiles import (
    TEXTURES,
    draw_textures,
    draw_tiles,
    map_keys,
    sample_jitters,
)

TILES_COSTS = (8, 12, 53, 77, 92)
"""The costs of the preset ``tiles``."""

KEY = np.array([9], np.uint64)
"""The key of one picture."""

ONE_TO_TEN = tuple(range(1, 11))

SQUARE = Terrain((6, 6), costs=TILES_COSTS, obstacles=0.2, seed_points=3)
WIDE = Terrain((5, 8), costs=ONE_TO_TEN, obstacles=0.2, seed_points=3)
TWO_ENDS = Terrain((6, 6), costs=TILES_COSTS, obstacles=0.0, corners=True)
"""Its problems are the same in all epochs."""


@dataclass
class StoredBatch:
    """A batch of stored maps."""

    stored_terrain: Bytes | None
    stored_grids: Bytes
    symmetries: Ints
    problems: Ints = field(default_factory=lambda: np.arange(2))
    sampling_seed: int = 0
    epoch: int = 0


def batch_of(generator: Terrain, code: int = 0) -> StoredBatch:
    """Return two maps, the first after no symmetry and the second after ``code``."""
    terrain = generate(generator, 0, [0, 1]).terrain
    assert terrain is not None
    return StoredBatch(terrain, (terrain == 0).astype(np.uint8), np.array([0, code]))


def transformed(array: Any, code: int) -> Any:
    """Return an array after a symmetry of its last two axes, by numpy."""
    if code & 1:
        array = np.flip(array, -2)
    if code & 2:
        array = np.flip(array, -1)
    return np.swapaxes(array, -1, -2) if code & 4 else array


# --- drawing -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pixels", "alike", "noise", "seed"),
    [
        slow(8, False, 0, 0),
        slow(8, True, 13, 7),
        (5, False, 64, 2**63 + 5),
        slow(11, True, 1, 2**64 - 1),
    ],
)
def test_pictures_equal_the_reference(pixels: int, alike: bool, noise: int, seed: int) -> None:
    """Each pixel, for all 11 patterns in the lowest digit and some in the others."""
    terrain = np.array([[0, 1, 5, 12, 77, 2, 4], [255, 8, 3, 92, 10, 250, 6]], np.uint8)
    keys = np.array([1, 2**63 + 3], np.uint64)
    pictures = draw_tiles(np.stack([terrain, terrain]), keys, pixels, alike, noise, seed)
    assert pictures.dtype == np.uint8
    expected = reference_picture(terrain.tolist(), 2**63 + 3, pixels, alike, noise, seed)
    np.testing.assert_array_equal(pictures[1], expected)
    assert not np.array_equal(pictures[0], pictures[1])


def test_the_key_of_a_picture_is_a_hash_of_the_map() -> None:
    """Of its costs and its size: the same cells in rows of another length are another map."""
    terrain = np.arange(12, dtype=np.uint8).reshape(1, 3, 4)
    for shaped in (terrain, terrain.reshape(1, 4, 3), terrain.reshape(1, 2, 6), terrain[:, ::-1]):
        (key,) = map_keys(shaped).tolist()
        assert key == reference_key(shaped[0].tolist())
    # By hand, in a shell: printf '\1\0\0\0\2\0\0\0\1\0' | sha256sum | cut -c 1-16
    (key,) = map_keys(np.array([[[1, 0]]], np.uint8)).tolist()
    assert key.to_bytes(8, "little").hex() == "e1853cf638fff838"
    assert map_keys(terrain[:0]).shape == (0,)


@pytest.mark.slow
def test_all_costs_can_be_drawn() -> None:
    """The bank grows from some costs to all 256, whose textures equal the reference."""
    terrain = np.arange(256, dtype=np.uint8).reshape(1, 16, 16)
    few = terrain[:, :1] // 4
    first = draw_tiles(few, KEY, 4, False, 0, seed=11)
    draw_tiles(terrain, KEY, 4, False, 0, seed=11)
    np.testing.assert_array_equal(draw_tiles(few, KEY, 4, False, 0, seed=11), first)
    textures = draw_textures(209, 4, False, 11)
    for texture in (0, TEXTURES - 1):
        expected = reference_texture(209, texture, 4, False, 11)
        np.testing.assert_array_equal(textures[texture].reshape(3, -1), expected)


def test_pictures_do_not_change() -> None:
    """A hash of pictures, which are the same on every machine and in every version.

    The pictures of `reference_picture` with the keys of `reference_key` have the same hash.
    """
    digest = hashlib.sha256()
    for options in (Tiles(), Tiles(pixels=12, alike=True, noise=20, seed=5)):
        for generator in (SQUARE, WIDE):
            terrain = np.resize(np.array([0, 1, 8, 53, 255], np.uint8), (2, *generator.map_size))
            batch = StoredBatch(terrain, terrain, np.array([0, 3]))
            digest.update(options(batch).tobytes())
    assert digest.hexdigest() == "3b2852a52810dfdd8b5a516036c8df7ddc0b806e9e4808e295b81298afeaff14"


@pytest.mark.parametrize("code", range(8))
@pytest.mark.parametrize("options", [Tiles(), Tiles(9, alike=True, noise=30)])
def test_the_picture_moves_with_the_map(options: Tiles, code: int) -> None:
    """The picture of a map after a symmetry is the picture after the symmetry, with its noise."""
    for generator in (SQUARE, WIDE):
        if generator is WIDE and code & 4:
            continue  # Only square maps can be transposed.
        pictures = options(batch_of(generator))
        moved = options(batch_of(generator, code))
        np.testing.assert_array_equal(moved[0], pictures[0])
        np.testing.assert_array_equal(moved[1], transformed(pictures[1], code))


def test_a_tile_depends_only_on_seed_key_cell_and_cost() -> None:
    """Changing the cost of a cell changes no other tile, even with noise."""
    terrain = np.full((1, 4, 5), 8, np.uint8)
    changed = terrain.copy()
    changed[0, 2, 3] = 12
    pictures, changed_pictures = (
        draw_tiles(costs, KEY, 8, True, 10, 0) for costs in (terrain, changed)
    )
    is_different = (pictures != changed_pictures).any(axis=(0, 1))
    rows, columns = np.nonzero(is_different)
    assert {*(rows // 8)} == {2}
    assert {*(columns // 8)} == {3}


@pytest.mark.slow
@pytest.mark.parametrize("noise", [1, 5, 15])
def test_noise_has_its_standard_deviation(noise: int) -> None:
    """And mean 0, a normal distribution, and no correlation of neighbours and channels."""
    terrain = np.full((20, 12, 12), 6, np.uint8)
    keys = np.arange(20, dtype=np.uint64)
    clean, noisy = (draw_tiles(terrain, keys, 8, True, n, 0).astype(float) for n in (0, noise))
    difference = noisy - clean
    assert noisy.min() > 0
    assert noisy.max() < 255
    rounding = 1 / 12
    expected = (noise**2 + rounding) ** 0.5
    assert difference.std() == pytest.approx(expected, rel=0.06)
    assert abs(difference.mean()) < 0.02 * noise
    kurtosis = (difference**4).mean() / difference.var() ** 2
    assert 2.6 < kurtosis < 3.1
    for neighbour in (np.roll(difference, 1, axis=axis) for axis in range(4)):
        assert abs((difference * neighbour).mean()) < 0.01 * difference.var()


# --- telling costs apart -------------------------------------------------------------------------


@cache
def textures_of(costs: tuple[int, ...], alike: bool) -> Bytes:
    """Return (costs, TEXTURES, 3, 8, 8) textures."""
    return np.stack([draw_textures(cost, 8, alike, 0) for cost in costs])


def halves(textures: Bytes, noise: int) -> tuple[npt.NDArray[np.float32], ...]:
    """Return the two halves of the textures of each cost, (N, 3, 8, 8), with noise."""
    source = np.random.default_rng(0)
    noisy = textures + np.rint(noise * source.standard_normal(textures.shape))
    first, second = np.split(np.clip(noisy, 0, 255).astype(np.float32), 2, axis=1)
    return first.reshape(-1, 3, 8, 8), second.reshape(-1, 3, 8, 8)


@pytest.mark.slow
def test_no_two_textures_of_a_map_are_equal() -> None:
    """A bank has 1,024 different textures for each cost, also where costs look alike."""
    for alike in (False, True):
        textures = textures_of(TILES_COSTS, alike).reshape(-1, 3 * 8 * 8)
        assert len(np.unique(textures, axis=0)) == len(TILES_COSTS) * TEXTURES


@pytest.mark.slow
def test_every_cost_has_a_colour_of_its_own() -> None:
    """Unless all costs look alike, mean colours are at least 8 grey levels apart."""
    means = np.array(
        [draw_textures(cost, 4, False, 0).mean(axis=(0, 2, 3), dtype=float) for cost in range(256)]
    )
    distances = abs(means[:, None] - means).max(axis=2)
    np.fill_diagonal(distances, np.inf)
    assert distances.min() > 7.5


@pytest.mark.slow
@pytest.mark.parametrize("costs", [(0, *TILES_COSTS), tuple(range(0, 256, 5))])
def test_alike_costs_have_exactly_the_same_colours(costs: tuple[int, ...]) -> None:
    """The 1,024 mean colours of a cost are those of every cost: they say nothing about it.

    So do the brightnesses of a texture: they are the same in another order.
    """
    textures = textures_of(costs, alike=True).astype(np.int64)
    assert textures.min() > 0
    assert textures.max() < 255
    sums = textures.sum(axis=(3, 4))
    for other in sums:
        np.testing.assert_array_equal(other, sums[0])
    # Red and green add up to twice the brightness and the yellow: take blue from half of them.
    red, green, blue = textures.transpose(2, 0, 1, 3, 4)
    brightness = (red + green + 2 * blue).reshape(*textures.shape[:2], 64)
    brightness.sort(axis=2)
    assert (brightness == brightness[:1]).all()


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0, 12, 60])
def test_mean_colours_of_alike_costs_are_at_chance(noise: int) -> None:
    """Nearest neighbours and class means of mean colour, also after clipped noise."""
    first, second = (
        half.mean(axis=(2, 3)) for half in halves(textures_of(TILES_COSTS, True), noise)
    )
    labels = np.repeat(np.arange(len(TILES_COSTS)), TEXTURES // 2)
    distances = ((second[:, None] - first) ** 2).sum(axis=2)
    neighbours = labels[np.argpartition(distances, 25, axis=1)[:, :25]]
    votes = (neighbours[:, :, None] == np.arange(len(TILES_COSTS))).sum(axis=1)
    class_means = first.reshape(len(TILES_COSTS), -1, 3).mean(axis=1)
    by_mean = ((second[:, None] - class_means) ** 2).sum(axis=2).argmin(axis=1)
    chance = 1 / len(TILES_COSTS)
    deviation = (chance * (1 - chance) / len(labels)) ** 0.5
    assert abs((votes.argmax(axis=1) == labels).mean() - chance) < 4 * deviation
    assert abs((by_mean == labels).mean() - chance) < 4 * deviation


def spectra(tiles: npt.NDArray[np.float32]) -> npt.NDArray[np.float64]:
    """Return (N, 190): logarithms of the power of each frequency but 0, and a one."""
    red, green, blue = tiles.transpose(1, 0, 2, 3)
    opponents = np.stack([red + green + blue, red - green, red + green - 2 * blue], axis=1)
    power = abs(np.fft.fft2(opponents)) ** 2
    return np.log(power.reshape(len(tiles), 3, -1)[:, :, 1:] + 100).reshape(len(tiles), -1)


@pytest.mark.parametrize("alike", [False, True])
def test_a_linear_classifier_of_half_the_textures_knows_the_other_half(alike: bool) -> None:
    """Least squares on the spectra of tiles of five costs: the textures cannot be memorised."""
    first, second = (spectra(half) for half in halves(textures_of(TILES_COSTS, alike), 0))
    mean, deviation = first.mean(axis=0), first.std(axis=0)
    first, second = ((half - mean) / deviation for half in (first, second))
    labels = np.repeat(np.arange(len(TILES_COSTS)), TEXTURES // 2)
    targets = np.eye(len(TILES_COSTS))[labels] - 1 / len(TILES_COSTS)
    weights = np.linalg.solve(first.T @ first + 10 * np.eye(first.shape[1]), first.T @ targets)
    assert ((second @ weights).argmax(axis=1) == labels).mean() > 0.99


@pytest.mark.slow
@pytest.mark.parametrize(("costs", "min_share"), [(TILES_COSTS, 0.99), ((0, *ONE_TO_TEN), 0.97)])
def test_a_small_network_of_half_the_textures_knows_the_other_half(
    costs: tuple[int, ...], min_share: float
) -> None:
    """Three convolutions learn alike costs under noise in seconds, whatever the symmetry."""
    torch.manual_seed(0)
    first, second = map(torch.from_numpy, halves(textures_of(costs, True), 12))
    labels = torch.arange(len(costs)).repeat_interleave(TEXTURES // 2)
    network = nn.Sequential(
        *(nn.Conv2d(3, 32, 3), nn.ReLU(), nn.Conv2d(32, 64, 3), nn.ReLU()),
        *(nn.Conv2d(64, 64, 3), nn.ReLU(), nn.AdaptiveAvgPool2d(1), nn.Flatten()),
        nn.Linear(64, len(costs)),
    )
    epochs = 12
    batches = len(first) // 64
    optimizer = torch.optim.AdamW(network.parameters())
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 8e-3, total_steps=epochs * batches)
    for _ in range(epochs):
        for rows in torch.randperm(len(first))[: 64 * batches].view(batches, 64):
            code = int(torch.randint(8, ()))
            tiles = torch.from_numpy(transformed(first[rows].numpy(), code).copy())
            loss = nn.functional.cross_entropy(network((tiles - 118) / 40), labels[rows])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    with torch.no_grad():
        predictions = network((second - 118) / 40).argmax(dim=1)
    assert (predictions == labels).float().mean() > min_share


# --- served samples ------------------------------------------------------------------------------


def test_stored_and_online_maps_have_the_same_pictures(tmp_path: Path) -> None:
    """Each map has its own picture, in whatever order it is read."""
    fields: Any = ("terrain", Tiles(noise=9), "problem")
    build(tmp_path / "maps", SQUARE, maps=12, seed=3)
    online = OnlineMapDataset(SQUARE, 3, 12, fields=fields)[:]
    assert online.image.shape == (12, 3, 48, 48)
    for split in ("train", "val", "test"):
        stored = MapDataset(tmp_path / "maps", split, fields)
        for sample in [stored[i] for i in range(len(stored))][::-1]:
            is_this = (online.terrain == sample.terrain).flatten(1).all(dim=1)
            assert is_this.sum() == 1
            assert torch.equal(online.image[is_this][0], sample.image)


def test_an_augmented_picture_is_that_of_the_augmented_map() -> None:
    """In every epoch; and cells keep their looks."""
    arguments: Any = {"recipe": SQUARE, "length": 16, "fields": ("image", "terrain")}
    plain = OnlineMapDataset(**arguments)[:]
    augmented = OnlineMapDataset(**arguments, augment=True)[:]
    codes = set()
    for i in range(16):
        fitting = [
            code
            for code in range(8)
            if np.array_equal(transformed(plain.terrain[i].numpy(), code), augmented.terrain[i])
        ]
        assert any(
            np.array_equal(transformed(plain.image[i].numpy(), code), augmented.image[i])
            for code in fitting
        )
        codes.update(fitting)
    assert len(codes) > 3


def test_maps_without_terrain_have_pictures() -> None:
    """Free cells look like cost 1, and a radius changes the map, but not its picture."""
    arguments: Any = {"recipe": Forest((16, 16)), "length": 5, "problems": Random()}
    arguments["fields"] = ("image", "map")
    plain = OnlineMapDataset(**arguments)[:]
    inflated = OnlineMapDataset(**arguments, radius=0.1)
    free = 1 - plain.map[:, 0].numpy()
    expected = draw_tiles(free, map_keys(free), 8, False, 0, 0)
    np.testing.assert_array_equal(plain.image, expected)
    sample = inflated[0]
    assert any(torch.equal(sample.image, image) for image in plain.image)
    assert not any(torch.equal(sample.map, grid) for grid in plain.map)


# --- jitter --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("pixels", "augment"), [slow(5, False), (8, True), slow(16, True)])
def test_jitter_equals_the_reference(pixels: int, augment: bool) -> None:
    """Each pixel, in epoch 3; the picture is turned first."""
    plain, jittered = (
        OnlineMapDataset(
            WIDE,
            length=6,
            fields=("problem", Tiles(pixels, noise=20, jitter=jitter)),
            augment=augment,
            sampling_seed=2**40 + 7,
        )
        for jitter in (False, True)
    )
    indices = [3 * 6 + k for k in (4, 0)]
    pictures = plain.__getitems__(indices).batch.image.tolist()
    found = jittered.__getitems__(indices).batch
    assert found.problem.tolist() == [4, 0]
    for k, problem in enumerate((4, 0)):
        expected = reference_jittered(pictures[k], 2**40 + 7, problem, 3, pixels)
        np.testing.assert_array_equal(found.image[k], expected)


def test_jitter_draws_its_whole_range() -> None:
    """Over many problems: contrast 1/2 to 3/2, light of 48 levels, slanted by 32, and a pixel."""
    jitters = sample_jitters(np.uint64(3), 0, np.arange(4000), 1)
    assert jitters.min(axis=0).tolist() == [128, -48, -32, -32, -1, -1]
    assert jitters.max(axis=0).tolist() == [384, 48, 32, 32, 1, 1]
    correlation = np.corrcoef(jitters.T) - np.eye(6)
    assert abs(correlation).max() < 0.07


def test_jitter_is_drawn_anew_in_each_epoch_and_pictures_are_not() -> None:
    """It is a function of (sampling seed, epoch, problem), and no field but the image changes."""

    def batch(jitter: bool, sampling_seed: int, epoch: int) -> Any:
        fields = ("problem", "terrain", "path", Tiles(jitter=jitter))
        dataset = OnlineMapDataset(TWO_ENDS, length=8, fields=fields, sampling_seed=sampling_seed)
        return dataset.__getitems__(range(8 * epoch, 8 * epoch + 8)).batch

    first = batch(True, 0, 0)
    samples.assert_same(batch(True, 0, 0), first)
    for other in (batch(True, 1, 0), batch(True, 0, 1)):
        assert not any(
            torch.equal(one, two) for one, two in zip(other.image, first.image, strict=True)
        )
        samples.assert_same(other._replace(image=first.image), first)
    plain = batch(False, 0, 0)
    for other in (batch(False, 1, 0), batch(False, 0, 1)):
        samples.assert_same(other, plain)


def test_stored_and_online_maps_have_the_same_jitter(tmp_path: Path) -> None:
    """The problems of a dataset have the same numbers in both."""
    build(tmp_path / "maps", SQUARE, maps=12, seed=3)
    options: dict[str, Any] = {
        "fields": ("problem", "map_index", Tiles(jitter=True)),
        "problems": Random(),
        "augment": True,
        "sampling_seed": 5,
    }
    stored = MapDataset(tmp_path / "maps", **options)
    online = OnlineMapDataset(SQUARE, 3, 12, **options)
    indices = range(24, 36)  # epoch 2
    samples.assert_same(stored.__getitems__(indices).batch, online.__getitems__(indices).batch)


@pytest.mark.slow
@pytest.mark.parametrize("workers", [0, 2])
def test_jitter_is_for_training_alone_and_resumes(workers: int) -> None:
    """Validation and test have the pictures of `Tiles` without it; workers change nothing."""

    def module(jitter: bool, workers: int) -> MapDataModule:
        fields = ("problem", Tiles(jitter=jitter))
        return MapDataModule(
            None,
            build=Recipe(TWO_ENDS, seed=1, maps=40),
            batch_size=8,
            fields=fields,
            num_workers=workers,
        )

    plain, jittered = module(False, workers), module(True, workers)
    validation = [data.val_dataloader() for data in (plain, jittered)]
    test = [data.test_dataloader() for data in (plain, jittered)]
    for loaders in (validation, test):
        for one, other in zip(*loaders, strict=True):
            samples.assert_same(one, other)
    alone = module(True, 0).train_dataloader()
    whole = [batch for _ in range(2) for batch in alone]
    loader: Any = jittered.train_dataloader()
    state = loader.state_dict()
    for done, batch in enumerate(loader):
        samples.assert_same(batch, whole[done])
        if done == 1:
            state = loader.state_dict()
    resumed: Any = module(True, workers).train_dataloader()
    resumed.load_state_dict(state)
    found = [batch for _ in range(2) for batch in resumed]
    samples.assert_all_same(found, whole[2:])


@pytest.mark.parametrize("split", ["val", "test"])
def test_jitter_of_other_splits_is_refused(split: str) -> None:
    """As `augment` is: what is measured has the pictures of the maps."""
    with pytest.raises(ValueError, match=f"jitter: would change the pictures of .* '{split}'"):
        OnlineMapDataset(SQUARE, split=split, fields=(Tiles(jitter=True),))


def test_a_dtype_leaves_the_levels_unchanged() -> None:
    """0 to 255, as floats: networks that want other numbers scale them."""
    arguments: Any = {"recipe": SQUARE, "length": 2, "fields": ("image",)}
    image = OnlineMapDataset(**arguments)[:].image
    converted = OnlineMapDataset(**arguments, dtype="float32")[:].image
    assert image.dtype == torch.uint8
    assert converted.dtype == torch.float32
    assert torch.equal(converted, image.float())


# --- options -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pixels": 3}, "pixels: got 3, expected 4 to 32"),
        ({"pixels": 33}, "pixels: got 33, expected 4 to 32"),
        ({"pixels": 7, "alike": True}, "pixels: got 7, expected 8 to 32 .* for alike=True"),
        ({"pixels": 8.0}, "pixels: got 8.0, expected an integer"),
        ({"alike": 1}, "alike: got 1, expected True or False"),
        ({"jitter": 1}, "jitter: got 1, expected True or False"),
        ({"noise": -1}, "noise: got -1, expected an integer of at least 0"),
        ({"noise": 65}, "noise: got 65, expected at most 64 grey levels"),
        ({"seed": -1}, "seed: got -1, expected 0 to"),
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, Any], message: str) -> None:
    """The message says what is expected."""
    with pytest.raises(ValueError, match=message):
        Tiles(**options)


@pytest.mark.parametrize(
    ("field_class", "name"), [(Tiles, "image"), (Waypoints, "waypoints"), (MazeImage, "maze_image")]
)
def test_a_class_of_fields_without_parentheses_is_refused(field_class: Any, name: str) -> None:
    """A class can be called, too, but it is no function of the batch."""
    with pytest.raises(ValueError, match=rf"fields: got the class .* or the name '{name}'"):
        OnlineMapDataset("tiles", fields=("map", field_class))


def test_options_are_plain_values_that_can_be_sent_to_workers() -> None:
    """Numbers of numpy become plain ones, and equal options are equal."""
    numbers: Any = (np.int64(9), np.uint8(3), np.uint64(4))
    options = Tiles(numbers[0], noise=numbers[1], seed=numbers[2])
    assert options == Tiles(9, noise=3, seed=4)
    assert {type(value) for value in (options.pixels, options.noise, options.seed)} == {int}
    assert pickle.loads(pickle.dumps(options)) == options


def test_each_option_changes_the_picture() -> None:
    """The same maps with other options have other pictures."""
    batch = batch_of(SQUARE)
    pictures = {
        Tiles(8, alike, noise, seed)(batch).tobytes()
        for alike, noise, seed in product((False, True), (0, 1, 2), (0, 1))
    }
    assert len(pictures) == 12
