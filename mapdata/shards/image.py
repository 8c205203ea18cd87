"""The bytes of a shard file: writing them with h5py, and reading them back without it."""

from __future__ import annotations

import io
from functools import cache
from typing import Any

import h5py
import numpy as np

from mapdata.arrays import Array
from mapdata.limits import TERRAIN_VERSION
from mapdata.search.labels import Labels
from mapdata.shards.arrays import datasets_of, encode
from mapdata.shards.content import content_hash
from mapdata.shards.errors import NOT_AS_WRITTEN, ShardError
from mapdata.shards.hdf5 import read_dataset, read_root
from mapdata.shards.header import ATTRIBUTES, Header, shard_attributes

TESTED_H5PY = ("3.15", "3.16")
"""The oldest and the newest h5py whose files were read back; docs/promises.md has a table."""

_MAX_TEXT = 4070
"""Largest text attribute, in bytes; with its header it has 4,096, the limit of a heap's objects."""


def shard_image(labels: Labels, header: Header) -> tuple[bytes, str]:
    """Return the bytes of a shard file and its content hash.

    Raises:
        ShardError: reading the bytes that HDF5 wrote gives other attributes or arrays.
        ValueError: the header says that the maps have terrain, and they have none, or the reverse;
            a path on terrain costs more than a shard can hold.
    """
    if header.has_terrain != (labels.maps.terrain is not None):
        raise ValueError(
            f"has_terrain: got {header.has_terrain} for maps "
            f"{'without' if labels.maps.terrain is None else 'with'} terrain"
        )
    datasets = datasets_of(header.has_terrain)
    encoded = encode(labels)
    arrays = {
        stored.name: np.ascontiguousarray(encoded[stored.name], stored.dtype) for stored in datasets
    }
    content = content_hash(labels)
    attributes = shard_attributes(header, content)
    # HDF5 can keep files in memory itself, but before version 2.0 it returned their bytes with
    # outdated checksums.
    buffer = io.BytesIO()
    with h5py.File(
        buffer,
        "w",
        libver=("v110", "v110"),
        # Arrays are used in place, and numba assumes that they are aligned.
        alignment_threshold=1,
        alignment_interval=64,
        track_order=False,  # overrides the configuration of h5py
    ) as file:
        for name, value in attributes.items():
            _write_attribute(file.id, name, value)
        for stored in datasets:
            dataset = _write_dataset(file.id, stored.name, arrays[stored.name])
            for name in ("description", "units", "encoding"):
                _write_attribute(dataset, name, getattr(stored, name))
    image = buffer.getvalue()
    _check_image(image, attributes, arrays)
    return image, content


def _check_image(image: bytes, attributes: dict[str, Any], arrays: dict[str, Array]) -> None:
    """Refuse the bytes of a shard file if they do not hold these attributes and arrays.

    Raises:
        ShardError: the message says what to do.
    """
    try:
        read_attributes, read_arrays = read_image(memoryview(image))
        is_as_written = read_attributes == attributes and all(
            np.array_equal(read_arrays[name], arrays[name]) for name in arrays
        )
    except ValueError:
        is_as_written = False
    if is_as_written:
        return
    size = len(attributes["spec"].encode())
    if size > _MAX_TEXT:
        raise ShardError(
            f"spec: its JSON has {size} bytes, expected at most {_MAX_TEXT}: HDF5 stores longer "
            "texts in another way"
        )
    oldest, newest = TESTED_H5PY
    raise ShardError(
        f"HDF5 {h5py.version.hdf5_version} (h5py {h5py.__version__}) wrote another file than it "
        f"was asked to; mapdata was tested with h5py {oldest} to {newest}: install one of those "
        f"(pip install 'h5py=={newest}.*') and run the same command again. Nothing was written, "
        "and datasets that exist stay readable"
    )


def read_image(image: memoryview) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return the root attributes and the arrays in the bytes of a shard file.

    Raises:
        ShardError: a dataset is missing, not contiguous or of another version of the format.
        ValueError: the bytes are not those of a shard.
    """
    attributes, addresses = read_root(image)
    arrays = {}
    version = attributes.get("format_version")
    has_terrain = version == TERRAIN_VERSION
    if "terrain" in addresses and not has_terrain:
        # Without this, costs of terrain would be read as numbers of moves.
        raise ShardError(f"format version {version}, but it has a dataset 'terrain' of version 3")
    for stored in datasets_of(has_terrain):
        name = stored.name
        if name not in addresses:
            raise ShardError(f"dataset {name!r} is missing, or is a link to somewhere else")
        try:
            arrays[name] = read_dataset(image, addresses[name], stored.dtype, stored.rank)
        except ValueError as error:
            raise ShardError(
                f"dataset {name!r} is not plain contiguous data of type {stored.dtype} and rank "
                f"{stored.rank} inside the file ({error}): {NOT_AS_WRITTEN}"
            ) from None
    return attributes, arrays


def check_metadata(image: memoryview) -> None:
    """Let HDF5 compare the checksums that it stores with the metadata of a shard.

    It compares that of each structure as it reads it. So what passes reads the same with any HDF5
    library. Here HDF5 opens no other bytes than those that `read_image` accepts: of the names that
    it ignores, none is opened.

    Raises:
        OSError, RuntimeError, or one of `UNSOUND`: h5py's errors; the metadata are damaged.
    """
    attributes, arrays = read_image(image)
    with h5py.File(io.BytesIO(image), "r") as file:
        for name in attributes.keys() & ATTRIBUTES:
            file.attrs.get_id(name)
        for name in arrays:
            h5py.h5o.open(file.id, name.encode())


# A shard has 63 attributes. h5py's low-level functions write them and the datasets in two thirds of
# the time of ``attrs.create`` and ``create_dataset``, and the bytes are the same.


def _write_attribute(owner: h5py.h5f.FileID | h5py.h5d.DatasetID, name: str, value: object) -> None:
    """Write an attribute; a text becomes a string of fixed length.

    HDF5 stores strings of variable length in a heap without checksums, where one flipped bit can
    make it loop forever. Strings of fixed length are stored in metadata with checksums.
    """
    if isinstance(value, str):
        text = value.encode()
        size = max(len(text), 1)  # HDF5 has no strings of length 0.
        data = np.array(text, f"S{size}")
        stored_type = _text_type(size)
    else:
        data = np.array(value, "<f8" if isinstance(value, float) else "<i8")
        stored_type = h5py.h5t.py_create(data.dtype)
    space = h5py.h5s.create_simple(data.shape) if data.ndim else h5py.h5s.create(h5py.h5s.SCALAR)
    attribute = h5py.h5a.create(owner, name.encode(), stored_type, space)
    attribute.write(data, mtype=stored_type)


@cache
def _text_type(size: int) -> h5py.h5t.TypeID:
    """Return HDF5's type of texts of a number of bytes in UTF-8."""
    return h5py.h5t.py_create(h5py.string_dtype("utf-8", size), logical=True)


def _write_dataset(file: h5py.h5f.FileID, name: str, array: Array) -> h5py.h5d.DatasetID:
    """Write an array as a contiguous dataset and return it."""
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_obj_track_times(False)  # The same arrays give the same bytes at any time.
    stored_type = h5py.h5t.py_create(array.dtype)
    space = h5py.h5s.create_simple(array.shape)
    dataset = h5py.h5d.create(file, name.encode(), stored_type, space, dcpl=properties)
    dataset.write(h5py.h5s.ALL, h5py.h5s.ALL, array)
    return dataset
