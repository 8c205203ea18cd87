"""The strict reader of HDF5 beside h5py on every kind of shard, and on files that were changed."""

from __future__ import annotations

import random
import time
from dataclasses import asdict
from pathlib import Path

import h5py
import numpy as np
import pytest
from helpers.specs import MOVEMENTS

from mapdata import Generator, MapSpec, Movement, build
from mapdata.formats import Collection, ForeignMap, import_maps
from mapdata.generators import PRESETS
from mapdata.shards.hdf5 import read_attribute, read_dataset, read_root

DATA = Path(__file__).parents[1] / "data"


def assert_reads_as_h5py(path: Path) -> None:
    """Every attribute of the root and every dataset: names, types, shapes, places, values."""
    data = memoryview(path.read_bytes())
    root = read_root(data)
    with h5py.File(path, "r") as file:
        assert set(root.links) == set(file)
        assert set(root.attributes) == set(file.attrs)
        for name, expected in file.attrs.items():
            found = read_attribute(root.attributes[name])
            assert found.dtype == file.attrs.get_id(name).dtype, name
            assert np.array_equal(found, np.asarray(expected, found.dtype)), name
        for name, dataset in file.items():
            address = root.links[name]
            assert address is not None
            place = read_dataset(data, address)
            array = dataset[()]
            assert (place.shape, place.size) == (array.shape, array.nbytes), name
            assert place.dtype is not None
            assert np.dtype(place.dtype) == array.dtype, name
            assert place.offset == dataset.id.get_offset(), name
            if place.offset is not None:
                end = place.offset + place.size
                assert data[place.offset : end] == array.tobytes(), name


@pytest.mark.parametrize(
    "path", sorted(DATA.glob("*/maps-*.h5")), ids=lambda path: path.parent.name
)
def test_kept_shards_read_as_by_h5py(path: Path) -> None:
    """Shards of all format versions, written by earlier releases."""
    assert_reads_as_h5py(path)


@pytest.mark.parametrize("name", sorted(PRESETS))
@pytest.mark.parametrize("movement", MOVEMENTS, ids=str)
def test_built_shards_read_as_by_h5py(name: str, movement: Movement, tmp_path: Path) -> None:
    """All presets, all rules of moving."""
    spec = Generator.from_dict({**PRESETS[name].to_dict(), "movement": asdict(movement)})
    build(tmp_path, spec, maps=3)
    for path in tmp_path.glob("*.h5"):
        assert_reads_as_h5py(path)


def test_imported_and_empty_arrays_read_as_by_h5py(tmp_path: Path) -> None:
    """Imported maps have no recipe; 4-connected ones no diagonal moves."""
    maps = [ForeignMap("free", np.zeros((5, 7), np.uint8))]
    import_maps(tmp_path / "root", Collection(maps), seed_points=2)
    (path,) = (tmp_path / "root").glob("*.h5")
    assert_reads_as_h5py(path)


def test_changed_files_are_read_or_refused_at_once(tmp_path: Path) -> None:
    """Whatever is written over the metadata: a value or ValueError, never a crash or a hang."""
    build(tmp_path, MapSpec(), maps=2)
    (path,) = tmp_path.glob("*.h5")
    image = path.read_bytes()
    draws = random.Random(7)
    longest = 0.0
    refused = 0
    for _ in range(3000):
        changed = bytearray(image)
        for _ in range(draws.choice((1, 1, 2, 8))):
            size = draws.choice((1, 1, 2, 4, 8))
            at = draws.randrange(len(image) - size)
            values = (0, 1, draws.getrandbits(8 * size), 2 ** (8 * size) - 1, at)
            value = draws.choice(values) % 2 ** (8 * size)
            changed[at : at + size] = value.to_bytes(size, "little")
        data = memoryview(changed)
        began = time.process_time()
        try:
            root = read_root(data)
            for message in root.attributes.values():
                read_attribute(message)
            for address in root.links.values():
                read_dataset(data, address or 0)
        except ValueError:
            refused += 1
        longest = max(longest, time.process_time() - began)
    assert 0 < refused < 3000
    assert longest < 1, "bounded loops take milliseconds"


@pytest.mark.parametrize("length", [0, 1, 47, 48, 500])
def test_a_short_file_is_refused(length: int, tmp_path: Path) -> None:
    """Where it ends makes no difference."""
    build(tmp_path, MapSpec(), maps=1)
    (path,) = tmp_path.glob("*.h5")
    with pytest.raises(ValueError, match=r"reach outside|superblock|no b"):
        read_root(memoryview(path.read_bytes()[:length]))
