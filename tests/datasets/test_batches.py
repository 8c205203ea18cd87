"""Shards in a store: many with few descriptors, and replaced, grown or gone while somebody
reads.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import pickle
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import IO, Any

import h5py
import numpy as np
import pytest
import torch
from helpers import samples
from helpers.builds import publish
from helpers.imported import collection
from torch.utils.data import DataLoader

from mapdata import MapDataset, MapSpec, Route, ShardError, build
from mapdata._version import __version__
from mapdata.datasets.batches import BatchReader
from mapdata.datasets.stored_arrays import ARRAYS
from mapdata.formats import import_maps
from mapdata.shards import MANIFEST, Root, open_shard, read_manifest, write_file
from mapdata.shards.arrays import Shard

FIELDS = ("map", "start", "goal", "length", "iterations", "connection_matrix")
TINY = MapSpec((8, 8), (2, 4), (2, 5), (2, 5), passage_width=(1, 2), skip_probability=0.3)
LINUX = pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="/proc is Linux's")


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """120 maps in 120 shards."""
    folder = tmp_path_factory.mktemp("store") / "many"
    build(folder, TINY, maps=120, seed=3, shard_size=1)
    return folder


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same maps in one shard."""
    folder = tmp_path_factory.mktemp("store") / "one"
    build(folder, TINY, maps=120, seed=3, shard_size=120)
    return folder


# --- many shards --------------------------------------------------------------------------------


@contextlib.contextmanager
def few_descriptors(more: int) -> Iterator[None]:
    """Let this process open so many files more."""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (len(os.listdir("/proc/self/fd")) + more, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


@pytest.mark.slow
@LINUX
def test_many_shards_with_few_descriptors(root: Path, one: Path) -> None:
    """An epoch in random order over 120 shards, with room for 12 more open files, is that of one
    shard.
    """
    expected = MapDataset(one, fields=FIELDS)
    order = np.random.default_rng(0).permutation(len(expected))
    before = len(os.listdir("/proc/self/fd"))
    with few_descriptors(12):
        dataset = MapDataset(root, fields=FIELDS)
        for k in range(0, len(order), 50):
            samples.assert_same(dataset[order[k : k + 50]], expected[order[k : k + 50]])
        taken: list[int] = []
        with contextlib.suppress(OSError):
            while True:
                taken.append(os.open(root / MANIFEST, os.O_RDONLY))
        for descriptor in taken:
            os.close(descriptor)
    assert len(taken) < 60, "the limit was no limit"
    assert len(os.listdir("/proc/self/fd")) == before


@pytest.mark.slow
@LINUX
def test_a_forked_worker_reads_and_unmaps_for_itself_alone(root: Path) -> None:
    """Workers that end take no mapping away from the process that they were forked from."""
    dataset = MapDataset(root, fields=FIELDS)
    expected = dataset[:]
    with few_descriptors(40):
        loader = DataLoader(dataset, len(dataset), num_workers=2, multiprocessing_context="fork")
        samples.assert_same(next(iter(loader)), expected)
    samples.assert_same(dataset[:], expected)


@pytest.mark.slow
def test_threads_that_open_at_once(root: Path) -> None:
    """A shard that two threads open is mapped once: no thread reads what another one unmapped."""
    dataset = MapDataset(root, fields=FIELDS)
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda _: dataset[:], range(8)))
    for batch in found[1:]:
        samples.assert_same(batch, found[0])


class Slow(dict[int, Shard]):
    """Another thread has its turn as soon as a shard is in here."""

    def setdefault(self, k: int, shard: Any = None) -> Any:
        """Wait for that thread."""
        first = super().setdefault(k, shard)
        time.sleep(0.2)
        return first


def test_a_shard_is_open_once_its_addresses_are_there(root: Path) -> None:
    """A thread that comes before that would read memory that nobody owns."""
    dataset = MapDataset(root, fields=FIELDS)
    expected = MapDataset(root, fields=FIELDS)[:4]
    dataset.reader._open = Slow()
    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(dataset.__getitem__, slice(0, 4))
        while not dataset.reader._open:
            time.sleep(0.01)
        samples.assert_same(dataset[:4], expected)
        samples.assert_same(first.result(), expected)


def test_of_two_threads_the_first_ones_mapping_stays(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another thread opens a shard while this one does: its addresses may be in use already."""
    reader = BatchReader(root, None, Route(), 0)
    opened: list[Shard] = []
    open_of_root = Root.open_shard

    def meanwhile(self: Root, k: int) -> Shard:
        monkeypatch.setattr(Root, "open_shard", open_of_root)
        opened.append(reader.open(k))
        return open_of_root(self, k)

    monkeypatch.setattr(Root, "open_shard", meanwhile)
    assert reader.open(0) is opened[0] is reader.open(0)
    arrays = [opened[0].arrays[name] for name in ARRAYS if name != "terrain"]
    addresses = [array.__array_interface__["data"][0] for array in arrays]
    assert reader._addresses[0].tolist() == [*addresses, 0]  # there is no terrain


# --- replaced while somebody reads --------------------------------------------------------------

REPLACE = """
import os, sys, time
root, *versions = sys.argv[1:]
for k in range(200):
    folder = versions[k % len(versions)]
    for name in sorted(os.listdir(folder)):
        with open(os.path.join(folder, name), "rb") as file:
            data = file.read()
        with open(os.path.join(root, ".new"), "wb") as file:
            file.write(data)
        os.replace(os.path.join(root, ".new"), os.path.join(root, name))
        time.sleep(0.0005)
sys.stdin.read()
"""
"""Replaces all files of a root by those of the versions in turn, as fast as a builder would, and
faster. Ends when its input does, so that a reader on a busy machine has its turns too.
"""
READINGS = 10


@contextlib.contextmanager
def replacing(root: Path, *versions: Path) -> Iterator[Iterator[int]]:
    """Run `REPLACE` in another process; it must end well. Yield turns to read, `READINGS` or more,
    until it ends.
    """
    command = [sys.executable, "-c", REPLACE, str(root), *map(str, versions)]
    child = subprocess.Popen(command, stdin=subprocess.PIPE)
    assert child.stdin is not None

    def turns(input_of_child: IO[bytes]) -> Iterator[int]:
        for turn in itertools.count(1):
            if child.poll() is not None:
                return
            yield turn
            if turn == READINGS:
                input_of_child.close()

    try:
        yield turns(child.stdin)
        assert child.wait() == 0
    finally:
        child.kill()
        child.wait()


@pytest.mark.slow
def test_shards_replaced_by_the_same_maps_disturb_nobody(tmp_path: Path) -> None:
    """Repaired, or written by another version: each reading of all, by a reader old or new, is
    right.
    """
    first, second, root = (tmp_path / name for name in ("first", "second", "root"))
    build(first, TINY, maps=40, seed=3, shard_size=8)
    with (
        pytest.MonkeyPatch.context() as patch
    ):  # a version as long as ours: the shards keep their size
        patch.setattr("mapdata.shards.header.__version__", "9" * len(__version__))
        other = build(second, TINY, maps=40, seed=3, shard_size=8)
    assert {entry.sha256 for entry in other.shards}.isdisjoint(
        entry.sha256 for entry in read_manifest(first).shards
    )
    shutil.copytree(first, root)
    held = MapDataset(root, fields=FIELDS)
    expected = held[:]
    with replacing(root, second, first) as turns:
        for _ in turns:
            samples.assert_same(MapDataset(root, fields=FIELDS)[:], expected)
            samples.assert_same(held[:], expected)


@pytest.mark.slow
def test_a_reader_sees_old_or_new_and_never_a_mix(tmp_path: Path) -> None:
    """Another dataset takes the place file by file: a reading is all old, all new, or refused by
    name.
    """
    versions = [tmp_path / "first", tmp_path / "second"]
    for seed, folder in enumerate(versions):
        build(folder, TINY, maps=40, seed=seed, shard_size=8)
    truths = [MapDataset(folder, fields=FIELDS)[:] for folder in versions]
    root = tmp_path / "root"
    shutil.copytree(versions[0], root)
    held = MapDataset(root, fields=FIELDS)
    samples.assert_same(held[:], truths[0])
    seen = {"old": 0, "new": 0, "refused": 0}
    with replacing(root, versions[1], versions[0]) as turns:
        for _ in turns:
            samples.assert_same(held[:], truths[0])
            try:
                found = MapDataset(root, fields=FIELDS)[:]
            except ShardError as error:
                seen["refused" if "the manifest says" in str(error) else str(error)] += 1
                continue
            new = (
                torch.equal(found.start, truths[1].start)
                if len(found.start) == len(truths[1].start)
                else False
            )
            samples.assert_same(found, truths[new])
            seen["new" if new else "old"] += 1
    assert seen["old"] + seen["new"] + seen["refused"] >= READINGS
    samples.assert_same(MapDataset(root, fields=FIELDS)[:], truths[0])


def test_a_dataset_that_grows_disturbs_no_reader(tmp_path: Path) -> None:
    """The short last shard goes when a larger one takes its place; who had not opened it yet reads
    the new one.
    """
    root = tmp_path / "root"
    build(root, TINY, maps=20, seed=3, shard_size=8)
    fresh = {
        problems: MapDataset(root, "train", FIELDS, problems=problems)
        for problems in ("route", "pairs", "random")
    }
    expected = {
        problems: MapDataset(root, "train", FIELDS, problems=problems)[:] for problems in fresh
    }
    table = MapDataset(root).table()
    whole = MapDataset(root)
    last = read_manifest(root).shards[-1].name
    build(root, TINY, maps=30, seed=3, shard_size=8)
    assert not (root / last).exists()
    for problems, dataset in fresh.items():
        samples.assert_same(dataset[:], expected[problems])
    assert whole.table().equals(table)
    assert len(MapDataset(root)) > len(whole)


def test_a_pickled_dataset_is_not_opened_as_another(tmp_path: Path) -> None:
    """A worker that starts after the dataset grew would give other problems the same numbers: it
    says so instead.
    """
    root = tmp_path / "root"
    build(root, TINY, maps=20, seed=3, shard_size=8)
    data = pickle.dumps(MapDataset(root))
    pickle.loads(data)
    build(root, TINY, maps=30, seed=3, shard_size=8)
    with pytest.raises(ValueError, match="other maps than when this dataset was opened"):
        pickle.loads(data)


def test_a_shard_of_other_maps_is_refused(tmp_path: Path) -> None:
    """The right name, range and size, sound in itself, but not the maps that the manifest
    states.
    """
    roots = [tmp_path / "first", tmp_path / "second"]
    for seed, folder in enumerate(roots):
        build(folder, TINY, maps=8, seed=seed, shard_size=8)
    entry = read_manifest(roots[0]).shards[0]
    dataset = MapDataset(roots[0])
    image = (roots[1] / entry.name).read_bytes()
    write_file(roots[0] / entry.name, image)
    if len(image) == entry.bytes:
        with pytest.raises(ShardError, match="holds other maps than the manifest says"):
            dataset[0]
    else:
        with pytest.raises(ShardError, match="the manifest says"):
            dataset[0]


@pytest.mark.parametrize("place_in_byte", range(8))
def test_a_seed_in_a_wall_is_named(place_in_byte: int, tmp_path: Path) -> None:
    """A map whose cells say otherwise than its labels: the shard and the map are named, wherever
    the bit of the cell is in its byte.
    """
    root = tmp_path / "root"
    build(root, "paper", maps=10, seed=3)
    path = next(root.glob("*.h5"))
    shard = open_shard(path)
    maps, columns = shard.arrays["maps"], shard.arrays["seeds"][:, 1]
    seed = int(np.flatnonzero(columns % 8 == place_in_byte)[0])
    map_number = int(np.searchsorted(shard.arrays["room_offsets"], seed, side="right")) - 1
    changed = maps.copy()
    row, column = shard.arrays["seeds"][seed].tolist()
    changed[map_number, row, column // 8] |= 1 << place_in_byte
    publish(root, path.name, path.read_bytes().replace(maps.tobytes(), changed.tobytes()))
    message = rf"maps-\d+-\d+\.h5: a seed point of map {map_number} is on an occupied cell"
    with pytest.raises(ShardError, match=message):
        MapDataset(root, problems="pairs")[0]


@pytest.mark.parametrize("turned", [False, True], ids=["below", "right"])
def test_a_path_one_cell_beyond_the_map_is_refused(turned: bool, tmp_path: Path) -> None:
    """It goes round the wall by the wrong side, and arrives."""
    grid = np.array([[0, 0, 0], [0, 0, 0], [0, 1, 0]], np.uint8)
    seed_points = np.array([(2, 0), (2, 2)])
    # N E E S and S E E N, two bits each, the first in the lowest
    moves, wrong = 0b10_01_01_00, 0b00_01_01_10
    if turned:  # W S S E and E S S W
        grid, seed_points = grid.T.copy(), seed_points[:, ::-1].copy()
        moves, wrong = 0b01_10_10_11, 0b11_10_10_01
    root = tmp_path / "maps"
    import_maps(root, collection(grid, seed_points=seed_points, rooms_known=True))
    path = next(root.glob("*.h5"))
    image = bytearray(path.read_bytes())
    assert open_shard(path).arrays["bfs_moves"].tolist() == [moves]
    assert len(MapDataset(root, fields=("path",), search="bfs")[0].path) == 5
    with h5py.File(path) as file:
        image[file["bfs_moves"].id.get_offset()] = wrong
    publish(root, path.name, bytes(image))
    with pytest.raises(ShardError, match="a stored path of map 0 is damaged"):
        MapDataset(root, fields=("path",), search="bfs")[0]
