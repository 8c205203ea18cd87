"""Opening a shard without trust: no damaged byte is served. Hostile files are in test_shard.py."""

from __future__ import annotations

import hashlib
import os
import random
from pathlib import Path

import h5py
import pytest
import torch

from mapdata import MapDataset, MapSpec, Movement, ShardError, build, read_shard
from mapdata.datasets import FIELDS
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
