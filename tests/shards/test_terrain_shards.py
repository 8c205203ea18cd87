"""Shards of format version 3: maps whose cells have costs, and labels in half units."""

from __future__ import annotations

import re
import shutil
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from helpers import hostile
from helpers.builds import Built, publish, restated
from helpers.families import PILLARS, forget
from helpers.terrain_maps import imported_header, labelled_terrain, random_terrain_maps

from mapdata import (
    Cave,
    MapDataset,
    MapGenerator,
    MapSpec,
    Movement,
    ShardError,
    Terrain,
    build,
    generate,
    identity,
    label,
    read_shard,
    repair,
    verify,
)
from mapdata.arrays import Ints
from mapdata.describe import card
from mapdata.generators import Maps, UnknownFamily, register, with_seed_points
from mapdata.search.labels import Labels
from mapdata.shards import MANIFEST, Manifest, Root, content_hash, open_shard, read_manifest
from mapdata.shards.arrays import encode
from mapdata.shards.header import Header
from mapdata.shards.image import shard_image

GENERATOR = Terrain((20, 70), seed_points=4, obstacles=0.2, movement=Movement(8))
"""Drawn maps of terrain."""

PLAIN = MapSpec((20, 70), (2, 5), (2, 8), (3, 12), passage_width=(1, 2), movement=Movement(8))
"""Maps of the same size and movement without terrain."""

SEED = 7
MAPS = 7
SHARD_SIZE = 4


def written(path: Path, labels: Labels, header: Header | None = None) -> Path:
    """Write a shard of imported maps; return its path."""
    image, _ = shard_image(labels, header or imported_header(labels.maps))
    path.write_bytes(image)
    return path


@pytest.fixture(scope="module")
def finished(built: Built) -> Path:
    """Seven maps in two shards; tests leave them as they were."""
    return built(GENERATOR, maps=MAPS, seed=SEED, shard_size=SHARD_SIZE)


@pytest.fixture
def copied(finished: Path, tmp_path: Path) -> Path:
    """Give a copy of the dataset to damage."""
    shutil.copytree(finished, tmp_path / "maps")
    return tmp_path / "maps"


def first_shard(root: Path) -> Path:
    """Return the file of the maps 0 to 3."""
    return root / "maps-000000000000-000000000004.h5"


# --- round trips --------------------------------------------------------------------------------


def test_terrain_of_ones_is_of_version_3(tmp_path: Path) -> None:
    """The version follows from the header; the labels are those without terrain, but doubled."""
    plain = label(generate(replace(PLAIN, skip_probability=0.5), 0, range(3)))
    assert (plain.astar.costs < 0).any()
    ones = (1 - plain.maps.occupancy).astype(np.uint8)
    labels = label(replace(plain.maps, terrain=ones))
    path = written(tmp_path / "shard.h5", labels)
    shard = open_shard(path)
    assert shard.header.format_version == 3
    assert shard.header.has_terrain
    np.testing.assert_array_equal(
        shard.arrays["astar_straight"],
        np.where(plain.astar.costs[:, 0] < 0, -1, 2 * plain.astar.costs[:, 0]),
    )
    for i in range(3):
        np.testing.assert_array_equal(labels.matrix("astar", i), plain.matrix("astar", i))
    assert content_hash(labels) != content_hash(plain)


def test_a_header_must_say_whether_maps_have_terrain() -> None:
    """In either direction, a header that does not fit the maps is refused before it is written."""
    labels = labelled_terrain(0, (5, 6), 2, Movement())
    header = imported_header(labels.maps)
    with pytest.raises(ValueError, match="has_terrain: got False for maps with terrain"):
        shard_image(labels, replace(header, has_terrain=False))
    plain = label(replace(labels.maps, terrain=None))
    with pytest.raises(ValueError, match="has_terrain: got True for maps without terrain"):
        shard_image(plain, header)


def test_has_terrain_of_drawn_maps_is_that_of_the_generator() -> None:
    """An argument that contradicts the generator has no effect; imported maps take the argument."""
    for generator in (GENERATOR, MapSpec()):
        for has_terrain in (False, True):
            manifest = Manifest(
                generator,
                0,
                generator.map_size,
                generator.movement,
                generator.resolution,
                5,
                5,
                has_terrain=has_terrain,
            )
            assert (
                manifest.has_terrain == generator.has_terrain == manifest.header(0, 5).has_terrain
            )
            assert manifest.format_version == generator.format_version
    for has_terrain, version in ((False, 1), (True, 3)):
        imported = Manifest(None, None, (9, 9), Movement(), 0.1, 5, 5, has_terrain=has_terrain)
        assert imported.format_version == imported.header(0, 5).format_version == version
    assert imported.header(0, 5) != replace(imported.header(0, 5), has_terrain=False)


def test_costs_that_do_not_fit_int32_are_refused() -> None:
    """The message names the map and the cost; the largest cost that fits is stored."""
    maps = random_terrain_maps(1, (6, 6), 5, Movement(8, diagonal_cost=1), start=40)
    labels = label(maps)
    map_numbers = np.repeat(maps.index, maps.rooms * (maps.rooms - 1) // 2)
    pair = len(map_numbers) * 3 // 4
    assert 40 < map_numbers[pair] < 44
    costs = labels.astar.costs.copy()
    costs[pair, 0] = 2**31 - 1
    high = replace(labels, astar=replace(labels.astar, costs=costs))
    assert encode(high)["astar_straight"].max() == 2**31 - 1
    costs[pair, 0] = 2**31
    with pytest.raises(
        ValueError, match=f"map {map_numbers[pair]}: terrain: a path costs 1,073,741,824, and"
    ):
        shard_image(high, imported_header(maps))


# --- datasets -----------------------------------------------------------------------------------


def test_a_built_dataset_holds_the_drawn_terrain(finished: Path) -> None:
    """Shards, manifest and identity are of version 3, and verify finds nothing."""
    manifest = read_manifest(finished)
    assert (manifest.format_version, manifest.has_terrain) == (3, True)
    assert manifest.identity == identity(GENERATOR, SEED)
    labels = label(generate(GENERATOR, SEED, range(MAPS)))
    assert manifest.content_hash == content_hash(labels)
    shards = list(Root.open(finished).labels())
    terrain = np.concatenate([shard.maps.terrain for shard in shards])
    np.testing.assert_array_equal(terrain, labels.maps.terrain)
    assert verify(finished) == []


def test_roots_with_and_without_terrain_are_no_dataset(finished: Path, tmp_path: Path) -> None:
    """Both are named, in either order."""
    plain = tmp_path / "plain"
    build(plain, Cave(GENERATOR.map_size, movement=GENERATOR.movement), maps=2, workers=1)
    message = re.escape(
        f"root: the maps of {finished} have terrain, those of {plain} have none; open them as "
        "datasets of their own"
    )
    for roots in ([finished, plain], [plain, finished]):
        with pytest.raises(ValueError, match=message):
            Root.open(roots)


# --- damage -------------------------------------------------------------------------------------


def disagreeing(labels: Labels, k: int) -> Labels:
    """Return labels whose map ``k`` has a cost on an occupied cell; its labels do not change."""
    terrain = labels.maps.terrain
    assert terrain is not None
    terrain = terrain.copy()
    row, column = np.argwhere(terrain[k] == 0)[0]
    terrain[k, row, column] = 9
    return replace(labels, maps=replace(labels.maps, terrain=terrain))


def test_terrain_that_disagrees_with_the_maps_is_found(copied: Path) -> None:
    """Although all hashes fit: the message names the map."""
    path = first_shard(copied)
    labels = disagreeing(read_shard(path), 2)
    header = open_shard(path).header
    image, content = shard_image(labels, header)
    publish(copied, path.name, image)
    manifest = read_manifest(copied)
    entries = (replace(manifest.shards[0], content_hash=content), *manifest.shards[1:])
    (copied / MANIFEST).write_text(replace(manifest, shards=entries).to_json(), encoding="utf-8")
    message = (
        f"{path}: map 2 is not occupied exactly where its terrain is 0 (datasets 'maps' and "
        "'terrain')"
    )
    assert verify(copied) == [message]
    with pytest.raises(ShardError, match=re.escape(message)):
        read_shard(path)
    # A map that is occupied where its terrain has a cost is found, and so is the reverse.
    free = read_shard(path.with_name("maps-000000000004-000000000007.h5"))
    assert free.maps.terrain is not None
    terrain = free.maps.terrain.copy()
    is_seed = np.zeros(terrain.shape[1:], np.bool_)
    is_seed[tuple(free.maps.seed_points[0].T)] = True
    terrain[0][tuple(np.argwhere((terrain[0] > 0) & ~is_seed)[0])] = 0
    lone = free.maps.index[0]
    opened = replace(free, maps=replace(free.maps, terrain=terrain))
    other = written(copied / "lone.h5", opened, replace(header, start=4, stop=7))
    with pytest.raises(ShardError, match=f"map {lone} is not occupied exactly"):
        read_shard(other)


def test_the_manifest_of_imported_maps_is_made_again(tmp_path: Path) -> None:
    """From the shards alone, whose version says that the maps have terrain."""
    labels = labelled_terrain(4, (9, 9), 3, Movement(8))
    header = imported_header(labels.maps)
    root = tmp_path / "maps"
    root.mkdir()
    written(root / header.file_name, labels)
    repair(root)
    manifest = read_manifest(root)
    assert (manifest.format_version, manifest.has_terrain, manifest.generator) == (3, True, None)
    assert manifest.content_hash == content_hash(labels)


# --- files that lie -----------------------------------------------------------------------------


def test_versions_that_do_not_fit_the_datasets_are_refused(tmp_path: Path) -> None:
    """Terrain in a shard of version 1 or 2, and a shard of version 3 without it."""
    generator = Terrain((20, 70), movement=Movement(8))
    terrain = label(generate(generator, 0, range(3)))
    plain = label(generate(PLAIN, 0, range(3)))
    imported = imported_header(terrain.maps)
    of_spec = replace(imported, generator=PLAIN, seed=0, resolution=PLAIN.resolution)
    of_terrain = replace(of_spec, generator=generator)
    cases = [
        (terrain, imported, 1, False, "format version 1, but it has a dataset 'terrain' of ver"),
        (terrain, imported, 2, False, "format version 2, but it has a dataset 'terrain' of ver"),
        (terrain, of_terrain, 2, False, "format version 2, but it has a dataset 'terrain' of v"),
        (terrain, imported, 3, True, "dataset 'terrain' is missing"),
        (terrain, of_terrain, 2, True, "format version 2, but its spec is of version 3"),
        (plain, replace(imported, has_terrain=False), 3, True, "dataset 'terrain' is missing"),
        (plain, of_spec, 3, True, "dataset 'terrain' is missing"),
    ]
    path = tmp_path / "shard.h5"
    for labels, header, version, without_terrain, message in cases:
        contents = hostile.read_contents(written(path, labels, header))
        hostile.write(tmp_path / "sound.h5", contents, path)
        open_shard(tmp_path / "sound.h5")
        if without_terrain:
            contents.arrays.pop("terrain", None)
        hostile.write(tmp_path / "lie.h5", contents, path, attributes={"format_version": version})
        with pytest.raises(ShardError, match=re.escape(message)):
            open_shard(tmp_path / "lie.h5")
    # Terrain that a version 1 spec cannot have, in a file that claims version 3.
    contents = hostile.read_contents(written(path, plain, of_spec))
    contents.arrays["terrain"] = (1 - plain.maps.occupancy).astype(np.uint8)
    hostile.write(tmp_path / "lie.h5", contents, path, attributes={"format_version": 3})
    with pytest.raises(ShardError, match="format version 3, but its spec is of version 1"):
        open_shard(tmp_path / "lie.h5")


def test_a_manifest_of_another_version_is_refused(copied: Path) -> None:
    """A manifest that says version 2 of a family whose maps have terrain is damaged."""
    text = (copied / MANIFEST).read_text(encoding="utf-8")
    (copied / MANIFEST).write_text(
        restated(text, lambda values: values.update(format_version=2)), encoding="utf-8"
    )
    with pytest.raises(ShardError, match=r"damaged \(its version, identity or content hash"):
        read_manifest(copied)


# --- a family that is not known -----------------------------------------------------------------

WEIGHTED = PILLARS.replace(
    """        return maps
""",
    """        from dataclasses import replace
        from mapdata.generators.maps import unpacked

        costs = np.arange(self.map_size[1], dtype=np.uint8) % 7 + 1
        return replace(maps, terrain=(1 - unpacked(maps.packed, maps.columns)) * costs)

    @property
    def has_terrain(self):
        return True
""",
)
"""The text of the module of a family whose maps have terrain."""


@pytest.fixture
def unknown(tmp_path: Path) -> Iterator[tuple[Path, MapGenerator]]:
    """Build a dataset of a family, and make the family unknown; give both."""
    (tmp_path / "pillars.py").write_text(WEIGHTED, encoding="utf-8")
    sys.path.insert(0, str(tmp_path))
    __import__("pillars")
    sys.path.remove(str(tmp_path))
    generator = MapGenerator.preset("columns")
    build(tmp_path / "maps", generator, maps=6, seed=3, shard_size=4, workers=1)
    forget("pillars", "columns")
    yield tmp_path / "maps", generator
    forget("pillars", "columns")


def test_an_unknown_family_with_terrain_is_read(unknown: tuple[Path, MapGenerator]) -> None:
    """The version of the format says that its maps have terrain, which its identity depends on."""
    root, generator = unknown
    manifest = read_manifest(root)
    assert isinstance(manifest.generator, UnknownFamily)
    assert manifest.generator.has_terrain
    assert manifest.format_version == 3
    assert manifest.identity == identity(generator, 3)
    shards = list(Root.open(root).labels())
    terrain = np.concatenate([shard.maps.terrain for shard in shards])
    assert set(np.unique(terrain)) == set(range(8))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert verify(root) == []


def test_terrain_over_an_unknown_family_is_read(tmp_path: Path) -> None:
    """It is verified, its card names the module, and damage is reported as beyond repair."""
    (tmp_path / "pillars.py").write_text(PILLARS, encoding="utf-8")
    sys.path.insert(0, str(tmp_path))
    __import__("pillars")
    sys.path.remove(str(tmp_path))
    generator = Terrain(over=MapGenerator.preset("columns"))
    root = tmp_path / "maps"
    build(root, generator, maps=6, seed=3, shard_size=4, workers=1)
    assert "--import pillars" in card(root)
    forget("pillars", "columns")
    manifest = read_manifest(root)
    assert (manifest.format_version, manifest.identity) == (3, identity(generator, 3))
    assert manifest.max_seed_points == 4
    assert MapDataset(root).info.recipes == (None,)
    with pytest.warns(UserWarning, match="'pillars' is not known here"):
        assert verify(root) == []
    assert "--import MODULE" in card(root)
    path = first_shard(root)
    path.write_bytes(path.read_bytes()[:-1])
    (fault,) = repair(root)
    assert "it cannot be made again: the family 'pillars' is not known here" in str(fault)


def test_the_known_family_reads_what_the_unknown_one_was(
    unknown: tuple[Path, MapGenerator],
) -> None:
    """Headers of both are equal, and those of the same family without terrain are not."""
    root, generator = unknown
    header = read_manifest(root).header(0, 4)
    assert header == replace(header, generator=generator)
    assert isinstance(header.generator, UnknownFamily)
    assert header != replace(header, generator=replace(header.generator, has_terrain=False))


# --- costs that are too high --------------------------------------------------------------------


@dataclass(frozen=True)
class Serpentines(MapGenerator):
    """Open maps of cost 1, some of which are one long corridor of cost 255 instead."""

    name: ClassVar[str] = "serpentines"
    description: ClassVar[str] = "open maps and corridors"

    corridors: tuple[int, ...] = ()

    @property
    def max_seed_points(self) -> int:
        """Enough that some lie far apart."""
        return 5

    @property
    def has_terrain(self) -> bool:
        """Each map has costs."""
        return True

    def draw(self, seed: int, indices: Ints) -> Maps:
        """Return maps, of which those of the numbers ``corridors`` are corridors."""
        rows, columns = self.map_size
        grids = np.zeros((len(indices), rows, columns), np.uint8)
        is_corridor = np.isin(indices, self.corridors)
        for k in np.flatnonzero(is_corridor):
            grids[k, 1::2] = 1
            grids[k, 1::4, -1] = 0
            grids[k, 3::4, 0] = 0
        terrain = np.where(is_corridor[:, None, None], 255, 1) * (1 - grids)
        maps = with_seed_points(self, seed, indices, grids)
        return replace(maps, terrain=terrain.astype(np.uint8))


@pytest.fixture
def _serpentines() -> Iterator[None]:
    """Register the family meanwhile."""
    register(Serpentines)
    yield
    forget("serpentines")


LONG = Serpentines((128, 128), movement=Movement(8), corridors=(8,))
"""The corridor of map 8 has 8,255 cells, whose costs add up to 2.1 million: twice what is exact."""


@pytest.mark.usefixtures("_serpentines")
def test_a_map_with_high_costs_does_not_stop_a_build(tmp_path: Path) -> None:
    """It has one free cell and no problems; the other maps are as they are drawn, random problems
    are on other maps, and the dataset can be verified, repaired and extended.
    """
    root = tmp_path / "maps"
    warning = r"^map 8: terrain: a path costs .* it is stored with a single free cell, and has no "
    with pytest.warns(UserWarning, match=warning):
        build(root, LONG, maps=10, seed=SEED, shard_size=4, workers=1)
    stored, drawn = Root.open(str(root)), generate(LONG, SEED, range(10))
    for k in range(10):
        labels, row = stored.locate(k)
        maps = labels.maps.selected(slice(row, row + 1))
        assert maps.terrain is not None
        assert ((maps.terrain == 0) == maps.occupancy).all()
        if k == 8:
            assert maps.occupancy.sum() == 128 * 128 - 1
            assert maps.rooms.tolist() == [1]
            assert maps.seed_points[0, 0].tolist() == drawn.seed_points[8, 0].tolist()
            assert maps.occupancy[(0, *maps.seed_points[0, 0])] == 0
        else:
            assert (maps.occupancy[0] == drawn.occupancy[k]).all()
            assert maps.rooms[0] == drawn.rooms[k]
    assert verify(root) == []
    shard = max(root.glob("maps-*.h5"))
    before = shard.read_bytes()
    shard.unlink()
    with pytest.warns(UserWarning, match=warning):
        assert repair(root) == []
    assert shard.read_bytes() == before
    with pytest.warns(UserWarning, match=warning):
        build(root, LONG, maps=12, seed=SEED, shard_size=4, workers=1)
    for split in ("train", "val", "test"):
        dataset = MapDataset(root, split, fields=("map_index", "cost"), problems="random")
        assert 8 not in dataset[:].map_index


@pytest.mark.usefixtures("_serpentines")
def test_a_build_goes_on_after_a_shard_of_high_costs_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """None of its maps is stored as drawn, so an earlier shard tells whether the family changed."""
    root = tmp_path / "maps"
    recipe = replace(LONG, corridors=(4, 5))
    with pytest.warns(UserWarning, match=r"^map [45]: terrain: a path costs"):
        build(root, recipe, maps=6, seed=SEED, shard_size=2, workers=1)

    def draw(family: Serpentines, seed: int, indices: Ints) -> Maps:
        maps = unchanged(family, seed, indices)
        assert maps.terrain is not None
        return replace(maps, terrain=maps.terrain + maps.terrain % 254)

    unchanged = Serpentines.draw
    monkeypatch.setattr(Serpentines, "draw", draw)
    with pytest.raises(ValueError, match="serpentines draws another map 2 than the stored one"):
        build(root, recipe, maps=7, seed=SEED, shard_size=2, workers=1)
    monkeypatch.undo()
    assert build(root, recipe, maps=7, seed=SEED, shard_size=2, workers=1).maps == 7


@pytest.mark.usefixtures("_serpentines")
def test_a_generator_of_high_costs_is_refused_before_the_build(tmp_path: Path) -> None:
    """Nothing is written."""
    often = replace(LONG, corridors=tuple(range(1, 8, 2)))
    message = (
        "^serpentines: 4 of the first 8 maps have costs that are too high: map 1: terrain: a path "
        "costs 1,.* or let diagonal moves cost 1$"
    )
    with pytest.raises(ValueError, match=message):
        build(tmp_path / "maps", often, maps=1000, seed=SEED)
    assert not (tmp_path / "maps").exists()
    build(tmp_path / "maps", replace(often, movement=Movement(8, diagonal_cost=1)), maps=2)
