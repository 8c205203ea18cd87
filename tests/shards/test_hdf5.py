"""The strict reader of a shard's bytes beside h5py: what h5py writes for shards, and no more."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from helpers import hostile
from helpers.builds import SOUND_SEED, SOUND_SPEC
from helpers.examples import Some
from helpers.pages import ROOT
from helpers.specs import Noted, movements

from mapdata import (
    MapDataset,
    MapGenerator,
    Movement,
    ShardError,
    build,
    generate,
    label,
    read_shard,
)
from mapdata.formats import Collection, ForeignMap, import_maps
from mapdata.generators import PRESETS
from mapdata.hashing import sha256_hex
from mapdata.shards import content_hash, open_shard
from mapdata.shards.arrays import DATASETS, decode
from mapdata.shards.hdf5 import read_dataset, read_root
from mapdata.shards.header import Header
from mapdata.shards.image import TESTED_H5PY, check_metadata, shard_image

DATA = Path(__file__).parents[1] / "data"
KEPT = sorted(DATA.glob("*/maps-*.h5"))


def assert_reads_as_h5py(path: Path) -> None:
    """Every attribute of the root and every dataset: names, types, shapes, values."""
    image = memoryview(path.read_bytes())
    check_metadata(image)
    attributes, addresses = read_root(image)
    with h5py.File(path, "r") as file:
        assert set(attributes) == set(file.attrs)
        for name, value in file.attrs.items():
            plain = value.decode() if isinstance(value, bytes) else np.asarray(value).tolist()
            expected = tuple(plain) if isinstance(plain, list) else plain
            assert type(attributes[name]) is type(expected)
            assert attributes[name] == expected
        assert set(addresses) == set(file)
        for field in DATASETS:
            array = read_dataset(image, addresses[field.name], field.dtype, field.rank)
            np.testing.assert_array_equal(array, file[field.name][()], strict=True)


@pytest.mark.parametrize("path", KEPT, ids=lambda path: f"{path.parent.name}-{path.name[5:17]}")
def test_kept_shards_read_as_by_h5py(path: Path) -> None:
    """Shards of all format versions, of h5py 3.9 over HDF5 1.12 and of 3.16 over 2.0."""
    assert_reads_as_h5py(path)


@movements
@pytest.mark.parametrize("name", sorted(PRESETS))
def test_built_shards_read_as_by_h5py(name: str, movement: Movement, tmp_path: Path) -> None:
    """All presets, all rules of moving."""
    values = PRESETS[name].to_dict()
    for part in (values, *values.get("parts", ())):  # a mixture moves as its parts do
        part["movement"] = asdict(movement)
    generator = MapGenerator.from_dict(values)
    manifest = build(tmp_path, generator, maps=2)
    assert_reads_as_h5py(tmp_path / manifest.shards[0].name)


def test_imported_shards_read_as_by_h5py(tmp_path: Path) -> None:
    """Imported maps have no recipe, and texts of no letters."""
    maps = [ForeignMap("free", np.zeros((5, 7), np.uint8))]
    import_maps(tmp_path / "root", Collection(maps), seed_points=2)
    (path,) = (tmp_path / "root").glob("*.h5")
    assert_reads_as_h5py(path)


def header_of(generator: MapGenerator, maps: int) -> Header:
    """Return the header of the first maps of a spec."""
    return Header(
        generator=generator,
        seed=SOUND_SEED,
        start=0,
        stop=maps,
        map_size=generator.map_size,
        movement=generator.movement,
        resolution=generator.resolution,
    )


def image_of(generator: MapGenerator, maps: int) -> bytes:
    """Return the bytes of a shard."""
    labels = label(generate(generator, SOUND_SEED, range(maps)))
    return shard_image(labels, header_of(generator, maps))[0]


def test_a_shard_of_no_maps_reads_as_by_h5py(tmp_path: Path) -> None:
    """Datasets without values have no place in the file."""
    path = tmp_path / "shard.h5"
    path.write_bytes(image_of(SOUND_SPEC, 0))
    assert_reads_as_h5py(path)
    assert len(read_shard(path).maps) == 0


@pytest.mark.parametrize("letters", [0, 100, 400, 1000, 2000, 3000, 3700])
def test_long_specs_read_as_by_h5py(letters: int, tmp_path: Path) -> None:
    """HDF5 keeps attributes in one block, or in blocks that grow, in up to five rows."""
    path = tmp_path / "shard.h5"
    path.write_bytes(image_of(Noted((8, 8), note="x" * letters), 1))
    assert_reads_as_h5py(path)


def test_a_spec_that_is_too_long_is_refused_when_it_is_written() -> None:
    """HDF5 keeps texts of over 4,000 letters in another way; no version of it is to blame."""
    with pytest.raises(ShardError, match=r"^spec: its JSON has 4329 bytes, expected at most 4070"):
        image_of(Noted((8, 8), note="x" * 4100), 1)


def test_what_is_written_is_read_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """An HDF5 that lays out files in another way, or writes other values, is named at once."""
    true_file = h5py.File
    true_create = h5py.h5d.create

    def file(*arguments: Any, **options: Any) -> h5py.File:
        options["libver"] = ("earliest", "v110")
        return true_file(*arguments, **options)

    def create(group: Any, name: bytes, kind: Any, *arguments: Any, **options: Any) -> Any:
        kind = h5py.h5t.py_create(np.dtype("<f8")) if name == b"sizes" else kind
        return true_create(group, name, kind, *arguments, **options)

    for name, fault in (("File", file), ("h5d.create", create)):
        with monkeypatch.context() as patch:
            patch.setattr(f"h5py.{name}", fault)
            with pytest.raises(
                ShardError, match=r"HDF5 .* \(h5py .*\) wrote another file"
            ) as caught:
                image_of(SOUND_SPEC, 1)
            oldest, newest = TESTED_H5PY
            assert f"was tested with h5py {oldest} to {newest}: install one" in str(caught.value)
            assert "4,000" not in str(caught.value)
    assert image_of(SOUND_SPEC, 1)


def test_a_build_with_an_h5py_that_writes_other_files_goes_on_with_a_tested_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What it leaves says that no map is there yet, and does not look like a dataset of none."""
    root = tmp_path / "maps"
    with monkeypatch.context() as patch:
        patch.setattr("h5py.File", partial(h5py.File, fs_strategy="page"))
        with pytest.raises(ShardError, match="Nothing was written"):
            build(root, SOUND_SPEC, maps=2, workers=1)
    assert sorted(path.name for path in root.iterdir()) == [".lock", "manifest.json"]
    with pytest.raises(ValueError, match="holds none of its 2 maps yet"):
        MapDataset(root)
    build(root, SOUND_SPEC, maps=2, workers=1)
    assert len(MapDataset(root, problems="random")) == 2


def test_the_tested_versions_are_those_that_the_project_names() -> None:
    """The lowest that pip may choose, and the pinned one."""
    allowed = re.findall(r'"h5py>=(\d+\.\d+)"', (ROOT / "pyproject.toml").read_text("utf-8"))
    pinned = re.findall(r"^h5py==(\d+\.\d+)", (ROOT / "constraints.txt").read_text("utf-8"), re.M)
    assert (*allowed, *pinned) == TESTED_H5PY


@pytest.fixture
def sound(tmp_path: Path) -> Path:
    """A shard of three maps."""
    path = tmp_path / "sound.h5"
    path.write_bytes(image_of(SOUND_SPEC, 3))
    return path


def test_other_names_are_ignored(sound: Path, tmp_path: Path) -> None:
    """As docs/format.md asks of readers: datasets, groups, links and attributes of any kind."""
    contents = hostile.read_contents(sound)
    path = tmp_path / "shard.h5"
    more = {"by": hostile.VariableText("somebody"), "long": "x" * 10**5, "table": np.zeros((2, 2))}

    def members(file: h5py.File, name: str, array: hostile.Array, outside: Path) -> None:
        file[name] = array
        file.create_dataset("chunks", data=array, chunks=True)
        file.create_group("group")
        file["elsewhere"] = h5py.ExternalLink(str(outside), "/maps")

    hostile.write(path, contents, sound, {"split": members}, more)
    assert content_hash(read_shard(path)) == content_hash(read_shard(sound))


def test_no_library_opens_a_shard(sound: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither h5py nor what is below it is called where the hash of the file is known."""
    image = sound.read_bytes()

    def fail(*_: object, **__: object) -> None:
        raise AssertionError("h5py was called")

    for owner, name in ((h5py, "File"), (h5py.h5f, "open"), (h5py.h5d, "open"), (h5py.h5a, "open")):
        monkeypatch.setattr(owner, name, fail)
    assert len(decode(open_shard(sound, len(image), sha256_hex(image))).maps) == 3


def test_damaged_metadata_are_refused_or_harmless(some: Some, sound: Path, tmp_path: Path) -> None:
    """A flipped bit between the arrays: no other header, no other maps and labels."""
    image = sound.read_bytes()
    header = open_shard(sound).header
    content = content_hash(read_shard(sound))
    path = tmp_path / "shard.h5"
    places = places_of_metadata(image)[::23]
    tried = places[:: len(places) // some(len(places))]
    refused = 0
    for place in tried:
        damaged = bytearray(image)
        damaged[place] ^= 1 << place % 8
        path.write_bytes(damaged)
        try:
            labels = read_shard(path)
        except ShardError:
            refused += 1
            continue
        assert open_shard(path).header == header
        assert content_hash(labels) == content
    assert refused > len(tried) / 4


# --- checksums ----------------------------------------------------------------------------------


def contents(image: bytes) -> dict[str, Any]:
    """Return all that h5py reads of a shard: attributes and values."""
    read: dict[str, Any] = {}
    with h5py.File(BytesIO(image), "r") as file:
        for name, owner in {"/": file, **{name: file[name] for name in file}}.items():
            read[name] = {key: np.asarray(value).tolist() for key, value in owner.attrs.items()}
        for name in file:
            read[f"{name} values"] = (file[name].dtype, file[name][()].tolist())
    return read


def places_of_metadata(image: bytes) -> list[int]:
    """Return the numbers of all bytes outside the arrays."""
    is_metadata = np.ones(len(image), np.bool_)
    with h5py.File(BytesIO(image), "r") as file:
        for dataset in file.values():
            begin = dataset.id.get_offset() or 0
            is_metadata[begin : begin + dataset.nbytes] = False
    return np.flatnonzero(is_metadata).tolist()


@pytest.mark.slow
def test_metadata_that_pass_are_read_by_h5py(sound: Path) -> None:
    """A flipped bit that `open_shard` does not name changes nothing that h5py reads."""
    image = sound.read_bytes()
    expected = contents(image)
    passed = 0
    refused = 0
    for place in places_of_metadata(image)[::61]:
        damaged = bytearray(image)
        damaged[place] ^= 1 << place % 8
        sound.write_bytes(damaged)
        try:
            open_shard(sound)
        except ShardError:
            refused += 1
            continue
        assert contents(bytes(damaged)) == expected
        passed += 1
    assert refused > 100
    assert passed > 10  # such as bytes of no structure


def test_damage_that_h5py_names_is_refused(sound: Path) -> None:
    """Bytes that only h5py reads: the text that describes an array."""
    image = bytearray(sound.read_bytes())
    image[image.index(b"occupancy")] ^= 1
    with pytest.raises(KeyError, match="incorrect metadata checksum"):
        contents(bytes(image))
    sound.write_bytes(image)
    with pytest.raises(
        ShardError, match=r"incorrect metadata checksum.*mapdata verify' with --rep"
    ):
        open_shard(sound)


# --- other programs -----------------------------------------------------------------------------


def change(act: Callable[[h5py.File], object]) -> Callable[[Path], None]:
    """Return a change of a file in place."""

    def change_in_place(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            act(file)

    return change_in_place


def copy(**options: Any) -> Callable[[Path], None]:
    """Return a change that copies all objects into a new file, as h5copy and h5repack do."""

    def rewrite(path: Path) -> None:
        old = BytesIO(path.read_bytes())
        with h5py.File(old, "r") as source, h5py.File(path, "w", **options) as target:
            for name, value in source.attrs.items():
                target.attrs[name] = value
            for name in source:
                source.copy(name, target)

    return rewrite


def compress(path: Path) -> None:
    """Store the maps compressed, all else as it was."""
    contents = hostile.read_contents(path)

    def member(file: h5py.File, name: str, array: hostile.Array, _: Path) -> None:
        file.create_dataset(name, data=array, compression="gzip")

    hostile.write(path, contents, path, {"maps": member})


REWRITTEN: dict[str, Callable[[Path], None]] = {
    "attribute of a dataset": change(lambda file: file["maps"].attrs.update(by="somebody")),
    "copied": copy(),
    "copied, earliest": copy(libver="earliest"),
    "copied, latest": copy(libver="latest"),
    "user block": copy(userblock_size=512),
    "compressed": compress,
}


@pytest.mark.parametrize("how", REWRITTEN)
def test_files_of_other_programs_are_refused(how: str, sound: Path) -> None:
    """With what to do; h5py does read them, as the message says."""
    REWRITTEN[how](sound)
    assert "maps" in contents(sound.read_bytes())
    with pytest.raises(ShardError) as caught:
        open_shard(sound)
    assert str(caught.value).startswith(f"{sound}: ")
    assert str(caught.value).endswith(
        "): damaged, or written by another HDF5 program, whose files h5py reads and mapdata does "
        "not; 'mapdata verify' with --repair makes it again where there is a recipe"
    )


def test_an_attribute_of_the_root_is_named_by_the_size(sound: Path) -> None:
    """Readers ignore it, but the file is not the one of the manifest any more."""
    size = len(sound.read_bytes())
    change(lambda file: file.attrs.update(by="somebody"))(sound)
    open_shard(sound)
    with pytest.raises(ShardError, match=r"has \d+ bytes, the manifest says \d+: damaged, or not"):
        open_shard(sound, size)
