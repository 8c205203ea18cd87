"""Shards: round trips change nothing, bytes are one, faults are named, nothing escapes."""

from __future__ import annotations

import ctypes
import gc
import os
import re
import struct
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from random import Random
from typing import NamedTuple

import h5py
import numpy as np
import pytest
from helpers import hostile
from helpers.builds import SOUND_SEED as SEED
from helpers.builds import SOUND_SPEC as SPEC
from helpers.builds import SOUND_TERRAIN, unprivileged_folder
from helpers.examples import Some, examples
from helpers.specs import MOVEMENTS, SIDES, movements, specs
from helpers.terrain_maps import imported_header, labelled_terrain
from hypothesis import given
from hypothesis import strategies as st

from mapdata import Labels, MapGenerator, MapSpec, ShardError, generate, label, read_shard
from mapdata.movement import Movement
from mapdata.shards import content_hash, open_shard, write_file
from mapdata.shards.arrays import (
    DATASETS,
    TERRAIN_DATASETS,
    StoredDataset,
    bits_per_move,
    decode,
    pack_moves,
    unpack_moves,
)
from mapdata.shards.header import Header
from mapdata.shards.image import shard_image

SETTINGS = examples(60)
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="inotify and /proc are Linux's")


def header_of(
    generator: MapGenerator, seed: int, start: int, stop: int, *, imported: bool = False
) -> Header:
    """Return the header of maps start <= i < stop."""
    return Header(
        generator=None if imported else generator,
        seed=None if imported else seed,
        start=start,
        stop=stop,
        map_size=generator.map_size,
        movement=generator.movement,
        resolution=generator.resolution,
    )


def assert_same_labels(found: Labels, expected: Labels) -> None:
    """Compare all values and types; padding may end with the largest map of the shard."""
    most = int(expected.maps.rooms.max(initial=2))
    for name in ("movement", "columns"):
        assert getattr(found.maps, name) == getattr(expected.maps, name)
    for name in (
        "index",
        "packed",
        "occupancy",
        "terrain",
        "rooms",
        "passage_width",
        "seed_points",
        "sizes",
        "directions",
        "split",
    ):
        value = getattr(found.maps, name)
        truth = getattr(expected.maps, name)
        if name in ("seed_points", "sizes", "directions"):
            truth = truth[:, : most - (name == "directions")]
        np.testing.assert_array_equal(value, truth, err_msg=name, strict=True)
    for search in ("bfs", "astar"):
        for name in ("moves", "offsets", "iterations", "costs"):
            value = getattr(found.by_search(search), name)
            truth = getattr(expected.by_search(search), name)
            np.testing.assert_array_equal(value, truth, err_msg=f"{search} {name}", strict=True)


class Sound(NamedTuple):
    """A sound shard: its file, its labels and what bare h5py reads of it."""

    path: Path
    labels: Labels
    contents: hostile.Contents


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Sound:
    """Three maps of 20 x 70 cells, 8-connected."""
    return written(SPEC, tmp_path_factory.mktemp("sound"))


@pytest.fixture(scope="module")
def sound_terrain(tmp_path_factory: pytest.TempPathFactory) -> Sound:
    """Three maps like them with terrain."""
    return written(SOUND_TERRAIN, tmp_path_factory.mktemp("sound"))


def written(generator: MapGenerator, folder: Path) -> Sound:
    """Write a sound shard of three maps."""
    path = folder / "maps-000000000000-000000000003.h5"
    labels = label(generate(generator, SEED, range(3)))
    path.write_bytes(shard_image(labels, header_of(generator, SEED, 0, 3))[0])
    return Sound(path, labels, hostile.read_contents(path))


# --- round trip ---------------------------------------------------------------------------------


@st.composite
def uniform(draw: st.DrawFn) -> tuple[Labels, Header]:
    """Draw maps of rooms, imported or not."""
    generator, seed = draw(specs()), draw(st.integers(0, 2**64 - 1))
    start = draw(st.integers(0, 2**40))
    stop = start + draw(st.integers(1, 4))
    header = header_of(generator, seed, start, stop, imported=draw(st.booleans()))
    return label(generate(generator, seed, range(start, stop))), header


@st.composite
def terrain(draw: st.DrawFn) -> tuple[Labels, Header]:
    """Draw imported maps of random costs, where some pairs have no path."""
    seed, size = draw(st.integers(0, 2**32)), (draw(SIDES), draw(SIDES))
    labels = labelled_terrain(seed, size, draw(st.integers(1, 4)), draw(st.sampled_from(MOVEMENTS)))
    return labels, imported_header(labels.maps)


@pytest.mark.parametrize("shards", [uniform(), terrain()], ids=["uniform", "terrain"])
@SETTINGS
@given(st.data())
def test_round_trip(shards: st.SearchStrategy[tuple[Labels, Header]], data: st.DataObject) -> None:
    """What is written is read back equal, for all movements and sizes, imported or not."""
    labels, header = data.draw(shards)
    image, content = shard_image(labels, header)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shard.h5"
        path.write_bytes(image)
        shard = open_shard(path, len(image))
        assert (shard.path, shard.header, shard.content_hash) == (path, header, content)
        assert shard.header.identity == header.identity
        assert (header.identity is None) == (header.generator is None)
        assert_same_labels(decode(shard), labels)
        assert_same_labels(read_shard(str(path)), labels)
        assert content_hash(decode(shard)) == content == content_hash(labels)


@movements
def test_a_shard_of_no_maps(movement: Movement, tmp_path: Path) -> None:
    """A zero-length dataset is valid, and never mapped."""
    labels = label(generate(MapSpec(movement=movement), 0, []))
    write_file(
        tmp_path / "none.h5", shard_image(labels, header_of(MapSpec(movement=movement), 0, 5, 5))[0]
    )
    found = read_shard(tmp_path / "none.h5")
    assert len(found.maps) == 0
    assert_same_labels(found, labels)


@SETTINGS
@given(st.lists(st.integers(0, 7), max_size=40), st.sampled_from(MOVEMENTS))
def test_moves_pack_and_unpack(codes: list[int], movement: Movement) -> None:
    """Move k is in the bits from k * bits on, spare bits are 0; unpacking undoes packing."""
    moves = np.array([code % movement.connectivity for code in codes], np.uint8)
    bits = bits_per_move(movement)
    packed = pack_moves(moves, bits)
    value = sum(int(move) << bits * k for k, move in enumerate(moves))
    assert packed.tobytes() == value.to_bytes(-(-len(moves) * bits // 8), "little")
    np.testing.assert_array_equal(unpack_moves(packed, len(moves), bits), moves, strict=True)


# --- the bytes ----------------------------------------------------------------------------------


def test_the_image_is_deterministic(sound: Sound, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same labels give the same bytes, also when threads make many images at once, and
    whatever h5py is told to do by default.
    """
    header = header_of(SPEC, SEED, 0, 3)
    image = sound.contents.image
    assert shard_image(label(generate(SPEC, SEED, range(3))), header)[0] == image
    monkeypatch.setattr(h5py.get_config(), "track_order", True)
    assert shard_image(sound.labels, header)[0] == image
    with ThreadPoolExecutor(4) as pool:
        images = list(pool.map(lambda _: shard_image(sound.labels, header)[0], range(16)))
    assert all(other == image for other in images)


@pytest.mark.parametrize("fields", [DATASETS, TERRAIN_DATASETS], ids=["uniform", "terrain"])
def test_every_dataset_explains_itself(
    fields: Sequence[StoredDataset], sound: Sound, sound_terrain: Sound
) -> None:
    """A shard holds its datasets and no other, each with its description, units and encoding; the
    costs of terrain are told from numbers of moves.
    """
    changed = [field.name for field in TERRAIN_DATASETS if field not in DATASETS]
    assert changed == ["terrain", "astar_straight", "astar_diagonal"]
    assert all(
        "half units" in field.units for field in TERRAIN_DATASETS if field.name in changed[1:]
    )
    path = sound.path if fields is DATASETS else sound_terrain.path
    with h5py.File(path, "r") as file:
        assert sorted(file) == sorted(field.name for field in fields)
        for field in fields:
            stated = {name: getattr(field, name) for name in ("description", "units", "encoding")}
            attributes = file[field.name].attrs.items()
            assert {
                name: v.decode() if isinstance(v, bytes) else v for name, v in attributes
            } == stated


def test_arrays_are_aligned_read_only_views(sound: Sound, sound_terrain: Sound) -> None:
    """Each array lies at a multiple of 64 bytes in one mapping that nobody can write to."""
    for shard, fields in ((sound, DATASETS), (sound_terrain, TERRAIN_DATASETS)):
        arrays = open_shard(shard.path).arrays
        assert list(arrays) == [field.name for field in fields]
        places = [array.ctypes.data for array in arrays.values()]
        assert all(place % 64 == 0 for place in places)
        assert max(places) - min(places) < len(shard.contents.image)
        assert not any(array.flags.writeable for array in arrays.values())


@pytest.mark.slow
@LINUX
def test_opening_leaks_nothing(sound: Sound) -> None:
    """A shard holds a mapping and no descriptor, and gives the memory back, of shards that were
    refused too.
    """

    def mappings() -> int:
        return Path("/proc/self/maps").read_text().count(str(sound.path))

    gc.collect()
    before = len(os.listdir("/proc/self/fd"))
    shards = [open_shard(sound.path) for _ in range(20)]
    assert (len(os.listdir("/proc/self/fd")), mappings()) == (before, 20)
    kept = shards[3].arrays["seeds"][1:]
    truth = kept.copy()
    del shards
    assert mappings() == 1, "one array that looks at a shard keeps its mapping"
    np.testing.assert_array_equal(kept, truth)
    del kept
    with pytest.raises(ShardError):
        open_shard(sound.path, 1)
    assert (len(os.listdir("/proc/self/fd")), mappings()) == (before, 0)


def test_a_mapping_outlives_its_file(sound: Sound, tmp_path: Path) -> None:
    """A reader sees the old shard until the end when another takes its name, or when it is
    removed.
    """
    path = tmp_path / "shard.h5"
    write_file(path, sound.contents.image)
    shard = open_shard(path)
    write_file(path, shard_image(label(generate(SPEC, 4, range(3))), header_of(SPEC, 4, 0, 3))[0])
    assert_same_labels(decode(shard), sound.labels)
    path.unlink()
    assert_same_labels(decode(shard), sound.labels)


# --- writing files ------------------------------------------------------------------------------


def test_write_file_replaces(tmp_path: Path) -> None:
    """The last content stands, and nothing else is left."""
    for data in (b"first", b"", b"second" * 1000):
        write_file(tmp_path / "name", data)
        assert (tmp_path / "name").read_bytes() == data
    assert os.listdir(tmp_path) == ["name"]


@pytest.mark.parametrize("step", ["fsync", "replace"])
def test_a_failed_write_leaves_nothing(
    step: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """When a step fails, the old content stands under the name and no temporary is left."""

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    write_file(tmp_path / "name", b"old")
    monkeypatch.setattr(os, step, fail)
    with pytest.raises(OSError, match=f"No space left on device: '{tmp_path / 'name'}'"):
        write_file(tmp_path / "name", b"new")
    assert os.listdir(tmp_path) == ["name"]
    assert (tmp_path / "name").read_bytes() == b"old"


def test_two_writers_of_one_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A thread that writes the same name meanwhile takes nothing away, and neither file is torn."""
    true_fsync = os.fsync
    waiting = [b"other"]

    def fsync(descriptor: int) -> None:
        true_fsync(descriptor)
        if waiting:
            write_file(tmp_path / "name", waiting.pop())

    monkeypatch.setattr(os, "fsync", fsync)
    write_file(tmp_path / "name", b"one")
    assert (tmp_path / "name").read_bytes() == b"one"
    assert os.listdir(tmp_path) == ["name"]


FULL_DISK = """
import resource, sys
from pathlib import Path
from mapdata.shards import write_file
resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
try:
    write_file(Path(sys.argv[1]), bytes(1_000_000))
except OSError as error:
    print(type(error).__name__, error.errno)
"""


@pytest.mark.slow
def test_a_full_disk_leaves_nothing(tmp_path: Path) -> None:
    """A real failing write (RLIMIT_FSIZE): an OSError, and no file under any name."""
    command = [sys.executable, "-c", FULL_DISK, str(tmp_path / "shard.h5")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("OSError")
    assert os.listdir(tmp_path) == []


def test_a_read_only_folder_is_a_permission_error() -> None:
    """The message names the place; nothing is left."""
    with unprivileged_folder() as folder:
        with pytest.raises(PermissionError, match=re.escape(str(folder))):
            write_file(folder / "shard.h5", b"data")
        assert os.listdir(folder) == []


# --- hostile shards -----------------------------------------------------------------------------


def refused(path: Path, says: str, size: int | None = None) -> None:
    """Check that a file is refused with a message that names it and says this."""
    with pytest.raises(ShardError) as caught:
        open_shard(path, size)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    assert re.search(says, message), message


def test_the_generator_writes_sound_shards_too(sound: Sound, tmp_path: Path) -> None:
    """Without a fault the generator's file is taken, so that each fault alone is what is
    refused.
    """
    hostile.write(tmp_path / "shard.h5", sound.contents, sound.path)
    assert_same_labels(read_shard(tmp_path / "shard.h5"), sound.labels)


@pytest.mark.parametrize("name", hostile.DATASETS)
def test_hostile_datasets_are_refused(
    name: str, sound: Sound, sound_terrain: Sound, tmp_path: Path
) -> None:
    """One dataset that is not plain, has another type or shape, or values that lead out of the
    arrays.
    """
    fault = hostile.DATASETS[name]
    shard = sound_terrain if fault.dataset == "terrain" else sound
    hostile.write(tmp_path / "shard.h5", shard.contents, shard.path, {fault.dataset: fault.member})
    refused(tmp_path / "shard.h5", f"'{fault.blamed or fault.dataset}'.*(?:{fault.says})")


@pytest.mark.parametrize("name", hostile.ATTRIBUTES)
def test_hostile_attributes_are_refused(name: str, sound: Sound, tmp_path: Path) -> None:
    """A root attribute that is missing, of another type, or lies."""
    fault = hostile.ATTRIBUTES[name]
    hostile.write(tmp_path / "shard.h5", sound.contents, sound.path, attributes=fault.values)
    refused(tmp_path / "shard.h5", fault.says)


@pytest.mark.parametrize("name", hostile.BYTES)
def test_files_that_are_no_shards_are_refused(name: str, sound: Sound, tmp_path: Path) -> None:
    """Empty, text, half a file."""
    says, change = hostile.BYTES[name]
    (tmp_path / "shard.h5").write_bytes(change(sound.contents.image))
    refused(tmp_path / "shard.h5", says)


def test_data_beyond_the_end_are_refused(sound: Sound, tmp_path: Path) -> None:
    """An array that begins inside the file, or far behind it; at a multiple of 64 bytes."""
    for address in (len(sound.contents.image) // 64 * 64 - 64, 2**62, 2**64 - 64):
        hostile.write_moved(tmp_path / "shard.h5", sound.contents, address)
        refused(tmp_path / "shard.h5", r"'maps'.*cannot reshape")


def test_data_that_are_not_aligned_are_refused(sound: Sound, tmp_path: Path) -> None:
    """Kernels read words where arrays begin."""
    for address in (129, 132, 136, 160):
        hostile.write_moved(tmp_path / "shard.h5", sound.contents, address)
        refused(tmp_path / "shard.h5", r"'maps'.*not plain contiguous data")


class Opens:
    """Counts how often a file is opened, by anybody: inotify, since HDF5 opens in C, where Python
    sees nothing.
    """

    IN_OPEN = 0x20
    IN_NONBLOCK = 0o4000

    def __init__(self, path: Path) -> None:
        """Watch ``path``."""
        libc = ctypes.CDLL(None, use_errno=True)
        self.descriptor = libc.inotify_init1(self.IN_NONBLOCK)
        assert libc.inotify_add_watch(self.descriptor, os.fsencode(path), self.IN_OPEN) > 0

    def count(self) -> int:
        """Return the number of opens since the last call (equal ones in a row count once)."""
        try:
            return len(os.read(self.descriptor, 65536)) // struct.calcsize("iIII")
        except BlockingIOError:
            return 0

    def close(self) -> None:
        """Stop watching."""
        os.close(self.descriptor)


@LINUX
@pytest.mark.parametrize("dataset", ["maps", "split", "astar_diagonal", "terrain"])
@pytest.mark.parametrize("name", hostile.ELSEWHERE)
def test_nothing_outside_is_opened(
    name: str, dataset: str, sound: Sound, sound_terrain: Sound, tmp_path: Path
) -> None:
    """A dataset in another file is refused without touching that file, which plain h5py opens and
    reads.
    """
    contents = (sound_terrain if dataset == "terrain" else sound).contents
    target = tmp_path / "target.h5"
    target.write_bytes(contents.image)
    hostile.write(tmp_path / "shard.h5", contents, target, {dataset: hostile.ELSEWHERE[name]})
    opens = Opens(target)
    try:
        refused(
            tmp_path / "shard.h5",
            f"'{dataset}'.*(?:is a link|not plain contiguous data|is missing)",
        )
        assert opens.count() == 0
        with h5py.File(tmp_path / "shard.h5", "r") as file:
            file[dataset][()]
        assert opens.count() > 0, "the watch sees nothing"
    finally:
        opens.close()


@pytest.mark.parametrize("name", hostile.ELSEWHERE)
def test_targets_that_do_not_exist_make_no_difference(
    name: str, sound: Sound, tmp_path: Path
) -> None:
    """The refusal is the same when the file elsewhere does not exist."""
    hostile.write(
        tmp_path / "shard.h5",
        sound.contents,
        tmp_path / "none.h5",
        {"maps": hostile.ELSEWHERE[name]},
    )
    refused(tmp_path / "shard.h5", "'maps'.*(?:is a link|not plain contiguous data|is missing)")
    assert sorted(os.listdir(tmp_path)) == ["shard.h5"]


def test_no_text_lies_in_the_unchecked_heap(sound: Sound) -> None:
    """All metadata have checksums. HDF5's global heap has none, and one flipped bit in it can make
    HDF5 loop for ever, of those who read shards with h5py.
    """
    assert b"GCOL" not in sound.contents.image


def test_text_of_variable_length_is_refused_unread(sound: Sound, tmp_path: Path) -> None:
    """Reading it would walk the heap of a file that nobody has checked yet."""
    values = {"format": hostile.VariableText("mapdata")}
    hostile.write(tmp_path / "shard.h5", sound.contents, sound.path, attributes=values)
    refused(tmp_path / "shard.h5", "not a mapdata shard|attribute")


# --- damage -------------------------------------------------------------------------------------


def test_truncation_is_refused(sound: Sound, tmp_path: Path) -> None:
    """Cut at every place: the header, the datasets, the last byte."""
    image = sound.contents.image
    path = tmp_path / "shard.h5"
    for length in [*range(1, len(image), len(image) // 60), len(image) - 1]:
        path.write_bytes(image[:length])
        refused(path, "not a sound shard")
        refused(path, f"has {length} bytes, the manifest says {len(image)}", len(image))


def test_another_size_than_the_manifests_is_refused(sound: Sound, tmp_path: Path) -> None:
    """What is appended does not disturb HDF5, but us, with a manifest or without."""
    path = tmp_path / "shard.h5"
    path.write_bytes(sound.contents.image + b"more")
    size = len(sound.contents.image)
    refused(path, f"has {size + 4} bytes, the manifest says {size}", size)
    refused(path, f"has {size + 4} bytes, its superblock says {size}")


def test_a_file_replaced_while_it_is_opened(
    sound: Sound, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Header and arrays never come from two files: all is read from the one that was mapped."""
    path = tmp_path / "shard.h5"
    path.write_bytes(sound.contents.image)
    labels = label(generate(SPEC, 5, range(3)))
    image = shard_image(labels, header_of(SPEC, 5, 0, 3))[0]

    true_fstat = os.fstat

    def fstat(descriptor: int) -> os.stat_result:
        write_file(path, image)  # after the file was opened, and before it is mapped
        return true_fstat(descriptor)

    monkeypatch.setattr(os, "fstat", fstat)
    shard = open_shard(path)
    assert shard.header == header_of(SPEC, SEED, 0, 3)
    assert_same_labels(decode(shard), sound.labels)
    assert_same_labels(read_shard(path), labels)


def heap(image: bytes) -> range:
    """Return where HDF5's global heap lies, in which a flipped bit can hang HDF5; nowhere once text
    is fixed.
    """
    first = image.find(b"GCOL")
    return (
        range(first, first + int.from_bytes(image[first + 8 : first + 16], "little"))
        if first >= 0
        else range(0)
    )


def flip_bits(sound: Sound, path: Path, flips: list[tuple[int, int]]) -> int:
    """Flip one bit at a time: the shard is refused, or read with the same header. Return how often
    it was read.
    """
    image = sound.contents.image
    header = header_of(SPEC, SEED, 0, 3)
    taken = 0
    for place, bit in flips:
        if place in heap(image):
            continue
        damaged = bytearray(image)
        damaged[place] ^= 1 << bit
        path.write_bytes(damaged)
        try:
            shard = open_shard(path)
        except ShardError:
            continue
        assert shard.header == header
        decode(shard)
        taken += 1
    return taken


def test_a_flipped_bit_is_refused_or_harmless(some: Some, sound: Sound, tmp_path: Path) -> None:
    """No flipped bit brings another error than ShardError, another header, or a crash."""
    random = Random(5)
    size = len(sound.contents.image)
    flips = [(random.randrange(size), random.randrange(8)) for _ in range(some(400))]
    taken = flip_bits(sound, tmp_path / "shard.h5", flips)
    assert 0 < taken < len(flips)


@pytest.mark.soak
@pytest.mark.skipif("config.getoption('-m') != 'slow'", reason="minutes long: run with -m slow")
def test_a_flipped_bit_in_every_byte_is_refused_or_harmless(sound: Sound, tmp_path: Path) -> None:
    """As above, one bit of every byte of the file."""
    random = Random(6)
    flips = [(place, random.randrange(8)) for place in range(len(sound.contents.image))]
    flip_bits(sound, tmp_path / "shard.h5", flips)


def test_a_missing_file_is_not_found(tmp_path: Path) -> None:
    """The error is the system's own, and names the file."""
    with pytest.raises(FileNotFoundError, match=r"none\.h5"):
        open_shard(tmp_path / "none.h5")
