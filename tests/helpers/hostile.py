"""Hostile shards, each a sound one with one fault, which `mapdata.shards.open_shard` must refuse.

Each check of the reader has a fault here, and as a rule only one. Nothing here imports mapdata,
since a hostile file comes from elsewhere. The fault is in a dataset, in a root attribute, or in the
bytes of the file. Each is a function, or a line, that is named after what is wrong; all of a kind
are in one dict, by these names: `ELSEWHERE`, `DATASETS`, `ATTRIBUTES`, `BYTES`. The sound shard is
8-connected and holds maps 0 to 3 of seed 3, of 20 x 70 cells; that of the dataset ``terrain`` has
terrain.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import h5py
import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[Any]


class Contents(NamedTuple):
    """What a shard holds: its root attributes, its datasets, and its bytes."""

    attributes: dict[str, Any]
    arrays: dict[str, Array]
    image: bytes


def read_contents(path: Path) -> Contents:
    """Read a sound shard."""
    with h5py.File(path, "r") as file:
        attributes = dict(file.attrs)
        arrays = {name: file[name][()] for name in file}
    return Contents(attributes, arrays, path.read_bytes())


Member: TypeAlias = Callable[[h5py.File, str, Array, Path], None]
"""Writes one dataset: (file, name, sound values, a file outside that it may point to)."""


def write(
    path: Path,
    sound: Contents,
    outside: Path,
    members: Mapping[str, Member] = {},
    attributes: Mapping[str, Any] = {},
) -> None:
    """Write a shard with other members and attributes; an attribute of None is left out."""
    with h5py.File(
        path, "w", libver=("v110", "v110"), alignment_threshold=1, alignment_interval=64
    ) as file:
        _write_attributes(file, sound, attributes)
        for name, array in sound.arrays.items():
            if name in members:
                members[name](file, name, array, outside)
            else:
                file.create_dataset(name, data=array)


class VariableText(str):
    """Text of variable length, which HDF5 keeps in its heap, whatever the sound shard does."""

    __slots__ = ()


def _write_attributes(file: h5py.File, sound: Contents, attributes: Mapping[str, Any] = {}) -> None:
    # h5py reads text of fixed length as bytes: then other text is written so, too
    is_fixed = isinstance(sound.attributes["format"], bytes)
    for name, value in {**sound.attributes, **attributes}.items():
        if value is None:
            continue
        if isinstance(value, VariableText):
            file.attrs[name] = str.__str__(value)
        elif is_fixed and isinstance(value, (str, bytes)):
            data = value.encode() if isinstance(value, str) else value
            kind = h5py.string_dtype("utf-8", max(len(data), 1))
            file.attrs.create(name, data, dtype=kind)
        else:
            file.attrs[name] = value


# --- datasets that lie elsewhere ----------------------------------------------------------------

ELSEWHERE: dict[str, Member] = {}
"""Members that read as sound data from the file outside, which a reader must not even open."""


def elsewhere(member: Member) -> Member:
    """Add a member to `ELSEWHERE`."""
    ELSEWHERE[_name_of(member)] = member
    return member


def _name_of(function: Callable[..., object]) -> str:
    return function.__name__.replace("_", "-")


@elsewhere
def external_storage(file: h5py.File, name: str, array: Array, outside: Path) -> None:
    """A dataset of this file whose data are the bytes of another one."""
    place = (str(outside), 0, h5py.h5f.UNLIMITED)
    file.create_dataset(name, array.shape, array.dtype, external=[place])


@elsewhere
def external_link(file: h5py.File, name: str, _: Array, outside: Path) -> None:
    """A link to the dataset of the same name in another file."""
    file[name] = h5py.ExternalLink(str(outside), f"/{name}")


@elsewhere
def virtual(file: h5py.File, name: str, array: Array, outside: Path) -> None:
    """A virtual dataset, which HDF5 puts together from those of another file."""
    layout = h5py.VirtualLayout(array.shape, array.dtype)
    layout[...] = h5py.VirtualSource(str(outside), name, array.shape)
    file.create_virtual_dataset(name, layout)


# --- datasets that are not plain ----------------------------------------------------------------


class DatasetFault(NamedTuple):
    """A fault of one dataset.

    Attributes:
        dataset: which dataset.
        says: what the message must say after the dataset's name, as a regular expression.
        member: writes the hostile dataset.
        blamed: the dataset that the message names where it is not the hostile one.
    """

    dataset: str
    says: str
    member: Member
    blamed: str = ""


DATASETS: dict[str, DatasetFault] = {}
"""Faults of one dataset."""

PLAIN = "not plain contiguous data"
GROW = "does not hold offsets"


Writer: TypeAlias = Callable[[h5py.File, str, Array], None]
"""Writes one dataset: (file, name, sound values)."""


def stored(dataset: str, says: str) -> Callable[[Writer], Writer]:
    """Add a fault of how a dataset is stored: a function that writes the sound values otherwise."""

    def register(write_dataset: Writer) -> Writer:
        def member(file: h5py.File, name: str, array: Array, _: Path) -> None:
            write_dataset(file, name, array)

        DATASETS[_name_of(write_dataset)] = DatasetFault(dataset, says, member)
        return write_dataset

    return register


@stored("maps", "is a link")
def soft_link(file: h5py.File, name: str, array: Array) -> None:
    """A link to sound data in this very file."""
    file["hidden"] = array
    file[name] = h5py.SoftLink("/hidden")


@stored("maps", PLAIN)
def group(file: h5py.File, name: str, _: Array) -> None:
    """A group."""
    file.create_group(name)


@stored("astar_diagonal", "is missing")
def missing(_: h5py.File, __: str, ___: Array) -> None:
    """Nothing."""


@stored("maps", PLAIN)
def chunked(file: h5py.File, name: str, array: Array) -> None:
    """Data in chunks, anywhere in the file."""
    file.create_dataset(name, data=array, chunks=True)


@stored("split", PLAIN)
def compact(file: h5py.File, name: str, array: Array) -> None:
    """Data inside the header of the dataset."""
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_layout(h5py.h5d.COMPACT)
    kind = h5py.h5t.py_create(array.dtype)
    space = h5py.h5s.create_simple(array.shape)
    dataset = h5py.h5d.create(file.id, name.encode(), kind, space, properties)
    dataset.write(h5py.h5s.ALL, h5py.h5s.ALL, array)


@stored("maps", "cannot reshape")
def huge(file: h5py.File, name: str, array: Array) -> None:
    """A billion maps, and no data."""
    file.create_dataset(name, (10**9, *array.shape[1:]), array.dtype)


@stored("maps", PLAIN)
def huge_gzip(file: h5py.File, name: str, array: Array) -> None:
    """A billion maps, which compress to nothing: a bomb."""
    file.create_dataset(name, (10**9, *array.shape[1:]), array.dtype, compression="gzip")


@stored("split", "and rank 1 ")
def scalar(file: h5py.File, name: str, array: Array) -> None:
    """One number instead of an array."""
    file[name] = array.flat[0]


@stored("bfs_moves", "not plain contiguous data of type u1")
def vlen(file: h5py.File, name: str, array: Array) -> None:
    """Arrays of variable length, whose values lie in HDF5's heap."""
    dataset = file.create_dataset(name, array.shape, h5py.vlen_dtype("u1"))
    dataset[0] = np.zeros(4, np.uint8)


# --- datasets of other types --------------------------------------------------------------------


def typed(name: str, dataset: str, expected: str, dtype: npt.DTypeLike) -> None:
    """Add a fault: a dataset of the sound shape, all zeros, whose type is not the expected one."""

    def member(file: h5py.File, name: str, array: Array, _: Path) -> None:
        file.create_dataset(name, data=np.zeros(array.shape, dtype))

    DATASETS[name] = DatasetFault(dataset, f"not plain contiguous data of type {expected}", member)


typed("float-of-equal-size", "bfs_offsets", "<i8", "f8")
typed("big-endian", "seeds", "<i2", ">i2")
typed("unsigned", "directions", "i1", "u1")
typed("wide", "bfs_iterations", "<i4", "<i8")
typed("opaque", "maps", "u1", h5py.opaque_dtype("V1"))
typed("signed-terrain", "terrain", "u1", "i1")


# --- datasets of other values -------------------------------------------------------------------

Change: TypeAlias = Callable[[Array], Array]
"""Returns hostile values; its argument is a copy of the sound ones."""


def valued(dataset: str, says: str, blamed: str = "") -> Callable[[Change], Change]:
    """Add a fault of a dataset's values."""

    def register(change: Change) -> Change:
        def member(file: h5py.File, name: str, array: Array, _: Path) -> None:
            file.create_dataset(name, data=change(array.copy()))

        DATASETS[_name_of(change)] = DatasetFault(dataset, says, member, blamed)
        return change

    return register


@valued("maps", "and rank 3 ")
def flat(array: Array) -> Array:
    """All values in one row."""
    return array.ravel()


def longer(dataset: str) -> None:
    """Add a fault: a dataset whose first entry stands there twice."""

    def member(file: h5py.File, name: str, array: Array, _: Path) -> None:
        file.create_dataset(name, data=np.concatenate((array[:1], array)))

    DATASETS[f"longer-{dataset}"] = DatasetFault(dataset, "has shape", member)


for longer_dataset in (
    "maps",
    "split",
    "passage_width",
    "room_offsets",
    "pair_offsets",
    "seeds",
    "sizes",
    "directions",
    "astar_iterations",
    "astar_straight",
    "astar_diagonal",
    "bfs_moves",
):
    longer(longer_dataset)


@valued("maps", "has shape")
def a_byte_less(array: Array) -> Array:
    """Rows without their first byte."""
    return array[:, :, 1:]


@valued("bfs_offsets", "has shape")
def no_offsets(array: Array) -> Array:
    """No offsets, so no last one either."""
    return array[:0]


@valued("maps", "and 'seeds'")
def all_walls(array: Array) -> Array:
    """Maps whose seed points are occupied, where no search can begin."""
    return np.full_like(array, 255)


@valued("bfs_offsets", GROW)
def offsets_not_from_0(array: Array) -> Array:
    """Moves before the first segment."""
    array[0] = 1
    return array


@valued("astar_offsets", GROW)
def decreasing_offsets(array: Array) -> Array:
    """A segment that ends before it begins."""
    array[1:3] = (40, 30)
    return array


@valued("astar_offsets", GROW)
def wrapping_offsets(array: Array) -> Array:
    """Offsets outside the data, whose differences are not negative, since int64 wraps round."""
    array[1:6] = (2**62, 2**63 - 1, -(2**63), -(2**62), 0)
    return array


@valued("bfs_offsets", "has shape", blamed="bfs_moves")
def last_offset_huge(array: Array) -> Array:
    """More moves than any file holds; the message names the moves."""
    array[-1] = 2**62
    return array


@valued("room_offsets", "disagree")
def rooms_of_none(array: Array) -> Array:
    """A map without rooms."""
    array[1] = 0
    return array


@valued("pair_offsets", "disagree")
def pairs_moved(array: Array) -> Array:
    """A pair of the second map counted to the first."""
    array[1] += 1
    return array


@valued("seeds", "cells outside the map")
def seed_row_negative(array: Array) -> Array:
    """A seed point above the map."""
    array[-1] = -1
    return array


@valued("seeds", "cells outside the map")
def seed_beyond(array: Array) -> Array:
    """A seed point far below the map."""
    array[0] = 32767
    return array


@valued("terrain", "and 'seeds'")
def no_free_cell(array: Array) -> Array:
    """Terrain that is occupied everywhere, so that no seed point is free."""
    return np.zeros_like(array)


for fault_of_maps in (
    "soft-link",
    "group",
    "chunked",
    "huge",
    "huge-gzip",
    "flat",
    "longer-maps",
    "a-byte-less",
):
    DATASETS[f"{fault_of_maps}-terrain"] = DATASETS[fault_of_maps]._replace(dataset="terrain")


# --- root attributes ----------------------------------------------------------------------------


class AttributeFault(NamedTuple):
    """A fault of root attributes.

    Attributes:
        says: what the message must say, as a regular expression.
        values: the hostile attributes by name; None is missing.
    """

    says: str
    values: dict[str, Any]


ATTRIBUTES: dict[str, AttributeFault] = {}
"""Faults of the root attributes."""


def attribute(fault: str, says: str, **values: Any) -> None:
    """Add a fault of root attributes."""
    ATTRIBUTES[fault] = AttributeFault(says, values)


# what is said of an attribute of another type or shape, or whose text cannot be read
ODD = "not a sound shard|attribute"

attribute("no-format", "format", format=None)
attribute("no-seed", "attribute.*'seed'", seed=None)


# the format and its version
attribute("another-format", "not a mapdata shard", format="mapdata2")
attribute("format-a-number", "not a mapdata shard|attribute", format=1)
attribute("newer-version", r"format version 4, this mapdata [\d.]+ reads 1 to 3", format_version=4)
attribute("version-2", "format version 2, but its spec is of version 1", format_version=2)
attribute("version-0", "format version 0, .* reads 1", format_version=0)
attribute("version-a-text", ODD, format_version="one")
attribute("version-nan", ODD, format_version=np.nan)

# the range of maps
attribute("start-negative", "maps -3 to 0", start=-3, stop=0)
attribute("stop-before-start", "maps 3 to 0", start=3, stop=0)
attribute("stop-beyond", "has shape", stop=4)
attribute("stop-huge", "has shape", stop=2**63 - 1)
attribute("start-a-text", ODD, start="zero")

# the size of a map
attribute("size-of-one", ODD, map_size=[20])
attribute("size-a-text", f"{ODD}|has shape", map_size="99")
attribute("size-0", "0 x 70 cells|map_size", map_size=[0, 70])
attribute("size-transposed", "has shape|map_size", map_size=[70, 20])
attribute("size-huge", "has shape|map_size", map_size=[2**62, 2**62])

# the movement
MOVES_8 = '{"connectivity":8,"corner_cutting":false,"diagonal_cost":1.4142135623730951}'
attribute("movement-half-json", ODD, movement=MOVES_8[:-1])
attribute("movement-a-list", ODD, movement="[4]")
attribute("movement-of-6", "connectivity", movement=MOVES_8.replace("8", "6"))
attribute("movement-unknown", "speed", movement='{"speed":1}')
attribute("movement-deep", ODD, movement="[" * 100_000)
attribute("another-movement", "has shape|movement", movement=MOVES_8.replace("8", "4", 1))

# the spec
attribute("spec-no-json", "not JSON", spec="paper")
attribute("spec-a-list", "expected an object", spec="[]")
attribute("spec-unknown", "unknown key: wings", spec='{"wings":2}')
attribute("spec-huge", "attribute 'spec'", spec='"' + "x" * 10**6 + '"')
attribute("spec-nan", "resolution", spec='{"resolution":NaN}')
attribute("spec-overflow", ODD, spec='{"resolution":1' + "0" * 400 + "}")
attribute("another-spec", "identity", spec="{}")

# the seed and the identity
attribute("another-seed", "identity", seed="4")
attribute("seed-a-word", ODD, seed="three")
attribute("seed-negative", "seed: got -3", seed="-3")
attribute("seed-long", ODD, seed="9" * 10_000)
attribute("another-identity", "identity", identity="0" * 64)

# resolution, and what the spec says too
attribute("resolution-a-text", ODD, resolution="fine")
attribute("size-not-the-specs", "map_size", map_size=[20, 69])
attribute("movement-not-the-specs", "movement", movement=MOVES_8.replace("false", "true"))
attribute("resolution-not-the-specs", "resolution", resolution=0.2)
attribute("resolution-nan", "resolution", resolution=np.nan)
attribute("content-hash-a-number", "content_hash", content_hash=5)


# --- bytes --------------------------------------------------------------------------------------

SIGNATURE = b"\x89HDF\r\n\x1a\n"

Rewrite: TypeAlias = Callable[[bytes], bytes]
"""Returns the bytes of a hostile file; its argument is those of the sound one."""

BYTES: dict[str, tuple[str, Rewrite]] = {}
"""Files that are no HDF5, or half of one: what the message must say, and what makes the bytes."""


def rewritten(says: str) -> Callable[[Rewrite], Rewrite]:
    """Add a fault of the bytes."""

    def register(rewrite: Rewrite) -> Rewrite:
        BYTES[_name_of(rewrite)] = (says, rewrite)
        return rewrite

    return register


@rewritten("empty file")
def empty(_: bytes) -> bytes:
    """Nothing."""
    return b""


@rewritten("not a sound shard")
def text(_: bytes) -> bytes:
    """A CSV."""
    return b"item,label,seed rows\n0,map0,3\n" * 500


@rewritten("not a sound shard")
def signature_only(image: bytes) -> bytes:
    """The signature of HDF5, then nothing but zeros."""
    return SIGNATURE + bytes(len(image) - 8)


@rewritten("not a")
def first_half_twice(image: bytes) -> bytes:
    """A file of the right length, without its second half."""
    return image[: len(image) // 2] * 2


def patched(fault: str, signature: bytes, at: int, value: bytes) -> None:
    """Add a fault of a structure: another value ``at`` bytes behind where its signature begins.

    HDF5 2.0 crashes on some of them, or hangs, once their checksums are computed anew.
    """

    def rewrite(image: bytes) -> bytes:
        begin = image.index(signature) + at
        return image[:begin] + value + image[begin + len(value) :]

    BYTES[fault] = ("not a sound shard|not plain contiguous data", rewrite)


FAR = b"\xf0" + b"\xff" * 7
"""An address far behind the end of any file, and below 2**64."""

patched("superblock-of-version-0", SIGNATURE, 8, b"\x00")
patched("another-end-of-file", SIGNATURE, 28, b"\x01")
patched("root-beyond", SIGNATURE, 36, FAR)
patched("root-of-version-1", b"OHDR", 4, b"\x01")
patched("heap-beyond", b"OHDR", 16, FAR)
patched("heap-with-filters", b"FRHP", 7, b"\x08")
patched("heap-of-many-rows", b"FRHP", 140, b"\xff\xff")
patched("heap-block-at-the-end-of-the-heap", b"FHDB", 13, b"\xff" * 4)
patched("tree-of-depth-1", b"BTHD", 12, b"\x01")
patched("tree-of-many-records", b"BTHD", 24, b"\xff\xff")
patched("leaf-beyond", b"BTHD", 16, FAR)


def write_moved(path: Path, sound: Contents, address: int) -> None:
    """Write a shard whose dataset ``maps`` lies elsewhere, as its header says."""
    with h5py.File(io.BytesIO(sound.image), "r") as file:
        layout = file["maps"].id.get_offset().to_bytes(8, "little")
    # followed by the size, it stands in no other place
    layout += sound.arrays["maps"].nbytes.to_bytes(8, "little")
    path.write_bytes(sound.image.replace(layout, address.to_bytes(8, "little") + layout[8:]))
