"""Opening a shard without trust: no damaged byte is served. Hostile files are in test_shard.py."""

from __future__ import annotations

import hashlib
import os
import random
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch

from mapdata import MapDataset, MapSpec, Movement, ShardError, build, read_shard
from mapdata.datasets import FIELDS
from mapdata.formats import Collection, ForeignMap, import_maps
from mapdata.shards import Root, open_shard
from mapdata.shards.reader import map_file

SPEC = MapSpec(
    map_size=(20, 24),
    rooms=(2, 4),
    room_rows=(4, 9),
    room_columns=(4, 9),
    passage_width=(1, 3),
    movement=Movement(8),
)


def test_a_system_that_maps_no_more_says_so(tmp_path: Path) -> None:
    """The system's own error, with what it was about."""
    (tmp_path / "file").write_bytes(b"data")
    with open(tmp_path / "file", "rb") as file:
        assert map_file(file.fileno(), 4).tobytes() == b"data"
        with pytest.raises(OSError, match="cannot map a shard"):
            map_file(file.fileno(), 2**62)


def served(root: Path) -> list[torch.Tensor]:
    """All fields of all problems, by both searches."""
    found: list[torch.Tensor] = []
    for search in ("bfs", "astar"):
        for problems in ("route", "pairs"):
            dataset = MapDataset(root, None, tuple(FIELDS), problems=problems, search=search)
            found += dataset[:]
    return found


@pytest.mark.slow
def test_no_flipped_bit_is_served(tmp_path: Path) -> None:
    """One bit in each array of a shard, and many anywhere: an error, or the data as they were."""
    manifest = build(tmp_path, SPEC, maps=6, seed=3)
    path = tmp_path / manifest.shards[0].name
    sound = served(tmp_path)
    image = path.read_bytes()
    draws = random.Random(4)
    with h5py.File(path, "r") as file:
        places = [
            array.id.get_offset() + draws.randrange(array.nbytes)
            for array in file.values()
            if array.nbytes
        ]
        arrays = len(places)
    places += [draws.randrange(len(image)) for _ in range(60)]
    refused = 0
    for place in places:
        damaged = bytearray(image)
        damaged[place] ^= 1 << draws.randrange(8)
        path.write_bytes(damaged)
        try:
            found = served(tmp_path)
        except ShardError:
            refused += 1
            continue
        assert all(torch.equal(one, other) for one, other in zip(found, sound, strict=True))
    assert refused >= arrays  # whatever is flipped in an array is found


def test_the_same_maps_in_other_bytes_are_served(tmp_path: Path) -> None:
    """Another file hash, of bytes between the arrays, and the same content hash."""
    manifest = build(tmp_path, SPEC, maps=6, seed=3)
    path = tmp_path / manifest.shards[0].name
    sound = served(tmp_path)
    image = bytearray(path.read_bytes())
    with h5py.File(path, "r") as file:
        end = file["split"].id.get_offset() + file["split"].nbytes
    assert end % 64  # arrays begin at multiples of 64
    image[end] ^= 1
    path.write_bytes(image)
    assert all(torch.equal(one, other) for one, other in zip(served(tmp_path), sound, strict=True))


def test_read_shard_checks_the_content(tmp_path: Path) -> None:
    """There is no manifest to compare with, but the file states its content hash."""
    manifest = build(tmp_path, SPEC, maps=6, seed=3)
    path = tmp_path / manifest.shards[0].name
    image = bytearray(path.read_bytes())
    with h5py.File(path, "r") as file:
        image[file["maps"].id.get_offset()] ^= 1
    path.write_bytes(image)
    open_shard(path)
    with pytest.raises(ShardError, match="content hash does not fit"):
        read_shard(path)


def test_a_file_is_hashed_once_a_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Several datasets of one root hash its shards once; a file that changed is hashed again."""
    (entry,) = build(tmp_path, SPEC, maps=6, seed=3).shards
    hashed: list[int] = []
    true_hash = hashlib.sha256

    def count(data: bytes) -> object:
        hashed.append(len(data))
        return true_hash(data)

    monkeypatch.setattr(hashlib, "sha256", count)
    for _ in range(3):
        Root.open(tmp_path).open_shard(0)
        assert hashed.count(entry.bytes) == 1
    os.utime(tmp_path / entry.name, ns=(1, 1))
    Root.open(tmp_path).open_shard(0)
    assert hashed.count(entry.bytes) == 2


def test_a_shard_under_the_name_of_another_is_refused(tmp_path: Path) -> None:
    """There is no manifest to compare with, but the name says which maps are asked for."""
    manifest = build(tmp_path, SPEC, maps=6, seed=3, shard_size=3)
    first, second = (tmp_path / entry.name for entry in manifest.shards)
    image = first.read_bytes()
    second.write_bytes(image)
    for opened in (open_shard, read_shard):
        with pytest.raises(ShardError, match=f"other maps than its name says.* {first.name}"):
            opened(second)
    copy = tmp_path / "copy.h5"  # a name that says nothing
    copy.write_bytes(image)
    assert read_shard(copy).maps.index.tolist() == [0, 1, 2]


def test_a_header_of_imported_maps_is_not_read_from_damaged_bytes(tmp_path: Path) -> None:
    """Neither a spec nor the content hash covers their resolution, but a checksum of HDF5 does."""
    (made,) = import_maps(
        tmp_path, Collection([ForeignMap("free", np.zeros((5, 7), np.uint8))]), resolution=0.25
    )
    path = tmp_path / made.manifest.shards[0].name
    image = path.read_bytes()
    text = np.float64(0.25).tobytes()
    assert image.count(text) == 1
    path.write_bytes(image.replace(text, np.float64(0.5).tobytes()))
    with pytest.raises(ShardError, match="incorrect metadata checksum"):
        open_shard(path)


def test_a_shard_of_another_size_names_the_remedy(tmp_path: Path) -> None:
    """A dataset whose shard was cut short or rebuilt says what to do."""
    manifest = build(tmp_path, SPEC, maps=6, seed=3)
    path = tmp_path / manifest.shards[0].name
    image = path.read_bytes()
    build(tmp_path / "other", replace(SPEC, map_size=(70, 24)), maps=6, seed=3)
    other = (tmp_path / "other" / path.name).read_bytes()
    for changed in (image[:-1], other):
        path.write_bytes(changed)
        with pytest.raises(ShardError) as caught:
            MapDataset(tmp_path)[0]
        assert str(caught.value) == (
            f"{path}: has {len(changed)} bytes, the manifest says {len(image)}: damaged, or not "
            "the file that the manifest lists; 'mapdata verify' with --repair makes it again where "
            "there is a recipe"
        )


def test_what_changes_in_place_is_found_when_it_is_opened_again(tmp_path: Path) -> None:
    """Who has the file open reads the changed bytes; whoever opens it next is told."""
    manifest = build(tmp_path, SPEC, maps=6, seed=3)
    path = tmp_path / manifest.shards[0].name
    shard = Root.open(tmp_path).open_shard(0)
    with h5py.File(path, "r") as file:
        place = file["maps"].id.get_offset()
    before = int(shard.arrays["maps"][0, 0, 0])
    with open(path, "r+b") as file:
        file.seek(place)
        file.write(bytes([before ^ 1]))
    assert shard.arrays["maps"][0, 0, 0] == before ^ 1  # docs/promises.md: not promised otherwise
    with pytest.raises(ShardError, match="content hash does not fit"):
        Root.open(tmp_path).open_shard(0)
