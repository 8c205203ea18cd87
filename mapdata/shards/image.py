"""The bytes of a shard file: written by h5py, read back by the patterns of its bytes."""

from __future__ import annotations

import io
from typing import Any

import h5py
import numpy as np

from mapdata.arrays import Array
from mapdata.search.labels import Labels
from mapdata.shards.arrays import DATASETS, encode
from mapdata.shards.content import content_hash
from mapdata.shards.errors import REPAIRS, ShardError
from mapdata.shards.hdf5 import (
    ChecksumError,
    check_metadata,
    member_counts,
    read_dataset,
    read_root,
)
from mapdata.shards.header import ATTRIBUTES, Header, _attributes

TESTED_H5PY = ("3.15", "3.16")
"""The oldest and the newest h5py whose files were read back; docs/promises.md has a table."""

_MAX_TEXT = 4070
"""Largest text attribute, in bytes: with its header it has 4,096, the most that the heap takes."""


def shard_image(labels: Labels, header: Header) -> tuple[bytes, str]:
    """Return the bytes of a shard file and its content hash.

    Raises:
        ShardError: what HDF5 wrote does not read back as what it was given.
    """
    content = content_hash(labels)
    attributes = _attributes(header, content)
    encoded = encode(labels)
    arrays = {
        field.name: np.ascontiguousarray(encoded[field.name], field.dtype) for field in DATASETS
    }
    # Not HDF5's own files in memory: before 2.0 their bytes have checksums of another state.
    buffer = io.BytesIO()
    # Aligned data can be used in place: numba assumes that arrays are aligned.
    with h5py.File(
        buffer,
        "w",
        libver=("v110", "v110"),
        alignment_threshold=1,
        alignment_interval=64,
        track_order=False,  # whatever h5py is configured to do
    ) as file:
        for name, value in attributes.items():
            _write_attribute(file, name, value)
        for field in DATASETS:
            dataset = file.create_dataset(field.name, data=arrays[field.name], track_order=False)
            for name in ("description", "units", "encoding"):
                _write_attribute(dataset, name, getattr(field, name))
    image = buffer.getvalue()
    _check_image(image, attributes, arrays)
    return image, content


def _check_image(image: bytes, attributes: dict[str, Any], arrays: dict[str, Array]) -> None:
    """Refuse the bytes of a file that does not hold these attributes and arrays."""
    try:
        found, found_arrays = read_image(memoryview(image))
        same = found == attributes and all(
            np.array_equal(found_arrays[name], arrays[name]) for name in arrays
        )
    except ValueError:
        same = False
    if same:
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
        ShardError: a dataset is missing or not plain, or another HDF5 program wrote the file.
        ValueError: the bytes are not those of a shard.
    """
    try:
        attributes, addresses = read_root(image)
    except ValueError as error:
        if is_undamaged(image):
            raise ShardError(foreign(image, error)) from None
        raise
    arrays = {}
    for field in DATASETS:
        if field.name not in addresses:
            raise ShardError(f"dataset {field.name!r} is missing, or is a link to somewhere else")
        try:
            arrays[field.name] = read_dataset(image, addresses[field.name], field.dtype, field.rank)
        except ValueError as error:
            why: object = (
                f"dataset {field.name!r} is not plain contiguous data of type {field.dtype} and "
                f"rank {field.rank} inside the file ({error})"
            )
            if is_undamaged(image):
                why = foreign(image, why)
            raise ShardError(why) from None
    return attributes, arrays


def foreign(image: memoryview, why: object) -> str:
    """Return what is said of a sound HDF5 file that mapdata did not write, which ``why`` tells."""
    # the superblock has a mark for this; h5py does not read such a file either
    if bytes(image[:9]).endswith(b"\n\x03") and image[11]:
        return f"another HDF5 program has it open for writing, or did not close it; {REPAIRS}"
    return (
        f"written by another HDF5 program ({why}); mapdata reads only shards that it wrote; h5py "
        f"can still read this file; {REPAIRS}"
    )


def is_undamaged(image: memoryview) -> bool:
    """Return whether no checksum in the bytes of an HDF5 file tells damage.

    Only the structures of a shard are known: of the file of another program the first few tell.
    """
    try:
        check_metadata(image, [field.name for field in DATASETS])
    except ChecksumError:
        return False
    except ValueError:  # sound until it differs from a shard
        return True
    return True


def is_as_written(image: memoryview) -> bool:
    """Return whether a file has the datasets and attributes of a shard, and no others."""
    try:
        read_image(image)
        return member_counts(image) == (len(ATTRIBUTES), len(DATASETS))
    except ValueError:
        return False


def _write_attribute(owner: h5py.File | h5py.Dataset, name: str, value: object) -> None:
    """Write an attribute, text as a string of fixed length.

    HDF5 keeps strings of variable length in a heap without checksums, where one flipped bit can
    make it loop for ever; those of fixed length lie in metadata that have checksums.
    """
    if not isinstance(value, str):
        kind = "<f8" if isinstance(value, float) else "<i8"
        owner.attrs[name] = np.array(value, kind)
        return
    data = value.encode()
    size = max(len(data), 1)  # HDF5 has no strings of length 0
    owner.attrs.create(name, data, dtype=h5py.string_dtype("utf-8", size))
