"""Writes shards that are wrong in one way each: what `mapdata.shards.reader.open_shard` must
refuse.

Nothing here imports mapdata, since a hostile file comes from elsewhere. Each file is a sound shard
but for one fault: in a dataset, in a root attribute, or in the bytes of the file.
"""

from __future__ import annotations

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
        return Contents(
            dict(file.attrs), {name: file[name][()] for name in file}, path.read_bytes()
        )


Member: TypeAlias = Callable[[h5py.File, str, Array, Path], None]
"""Writes one dataset: (file, name, sound values, a file outside that it may point to)."""


def write(
    path: Path,
    sound: Contents,
    outside: Path,
    members: Mapping[str, Member] = {},
    attributes: Mapping[str, Any] = {},
) -> None:
    """Write a shard whose named members and attributes are replaced; an attribute of None is left
    out.
    """
    with h5py.File(
        path, "w", libver=("v110", "v110"), alignment_threshold=1, alignment_interval=64
    ) as file:
        _write_attributes(file, sound, attributes)
        for name, array in sound.arrays.items():
            members.get(name, _plain)(file, name, array, outside)


class VariableText(str):
    """Text of variable length, which HDF5 keeps in its heap, whatever the sound shard does."""

    __slots__ = ()


def _write_attributes(file: h5py.File, sound: Contents, attributes: Mapping[str, Any] = {}) -> None:
    fixed = isinstance(
        sound.attributes["format"], bytes
    )  # text of fixed length, as the sound shard has it
    for name, value in (sound.attributes | dict(attributes)).items():
        if fixed and isinstance(value, (str, bytes)) and not isinstance(value, VariableText):
            data = value.encode() if isinstance(value, str) else value
            file.attrs.create(name, data, dtype=h5py.string_dtype("utf-8", max(len(data), 1)))
        elif value is not None:
            file.attrs[name] = str.__str__(value) if isinstance(value, VariableText) else value


def _plain(file: h5py.File, name: str, array: Array, _: Path) -> None:
    file.create_dataset(name, data=array)


# --- datasets that lie elsewhere ----------------------------------------------------------------


def _external_storage(file: h5py.File, name: str, array: Array, outside: Path) -> None:
    file.create_dataset(
        name, array.shape, array.dtype, external=[(str(outside), 0, h5py.h5f.UNLIMITED)]
    )


def _external_link(file: h5py.File, name: str, _: Array, outside: Path) -> None:
    file[name] = h5py.ExternalLink(str(outside), f"/{name}")


def _soft_link_to_external_link(file: h5py.File, name: str, _: Array, outside: Path) -> None:
    file["door"] = h5py.ExternalLink(str(outside), "/")
    file[name] = h5py.SoftLink(f"/door/{name}")


def _virtual(file: h5py.File, name: str, array: Array, outside: Path) -> None:
    layout = h5py.VirtualLayout(array.shape, array.dtype)
    layout[...] = h5py.VirtualSource(str(outside), name, array.shape)
    file.create_virtual_dataset(name, layout)


ELSEWHERE: dict[str, Member] = {
    "external-storage": _external_storage,
    "external-link": _external_link,
    "soft-link-to-external-link": _soft_link_to_external_link,
    "virtual": _virtual,
}
"""Members that read as sound data from the file outside, which the guard must not even open."""


# --- datasets that are not plain ----------------------------------------------------------------


def _soft_link(file: h5py.File, name: str, array: Array, _: Path) -> None:
    file["hidden"] = array
    file[name] = h5py.SoftLink("/hidden")


def _dangling_soft_link(file: h5py.File, name: str, _: Array, __: Path) -> None:
    file[name] = h5py.SoftLink("/nowhere")


def _soft_link_loop(file: h5py.File, name: str, _: Array, __: Path) -> None:
    file["loop"] = h5py.SoftLink(f"/{name}")
    file[name] = h5py.SoftLink("/loop")


def _virtual_of_itself(file: h5py.File, name: str, array: Array, _: Path) -> None:
    layout = h5py.VirtualLayout(array.shape, array.dtype)
    layout[...] = h5py.VirtualSource(".", name, array.shape)
    file.create_virtual_dataset(name, layout)


def _group(file: h5py.File, name: str, _: Array, __: Path) -> None:
    file.create_group(name)


def _root_again(file: h5py.File, name: str, _: Array, __: Path) -> None:
    file[name] = file["/"]


def _named_type(file: h5py.File, name: str, array: Array, _: Path) -> None:
    file[name] = array.dtype


def _missing(_: h5py.File, __: str, ___: Array, ____: Path) -> None:
    pass


def _stored(**storage: object) -> Member:
    """Return a member of sound values stored otherwise."""

    def member(file: h5py.File, name: str, array: Array, _: Path) -> None:
        file.create_dataset(name, data=array, **storage)

    return member


def _compact(file: h5py.File, name: str, array: Array, _: Path) -> None:
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_layout(h5py.h5d.COMPACT)
    kind = h5py.h5t.py_create(array.dtype)
    space = h5py.h5s.create_simple(array.shape)
    dataset = h5py.h5d.create(file.id, name.encode(), kind, space, properties)
    dataset.write(h5py.h5s.ALL, h5py.h5s.ALL, array)


def _never_written(file: h5py.File, name: str, array: Array, _: Path) -> None:
    file.create_dataset(name, array.shape, array.dtype)


def _huge(**storage: object) -> Member:
    """Return a member that declares 10**9 rows and holds none."""

    def member(file: h5py.File, name: str, array: Array, _: Path) -> None:
        file.create_dataset(name, (10**9, *array.shape[1:]), array.dtype, **storage)

    return member


def _scalar(file: h5py.File, name: str, array: Array, _: Path) -> None:
    file[name] = array.flat[0]


def _null(file: h5py.File, name: str, array: Array, _: Path) -> None:
    file[name] = h5py.Empty(array.dtype)


def _typed(dtype: npt.DTypeLike) -> Member:
    """Return a member of the sound shape and another type."""

    def member(file: h5py.File, name: str, array: Array, _: Path) -> None:
        file.create_dataset(name, data=np.zeros(array.shape, dtype))

    return member


def _ragged(dtype: object, value: object) -> Member:
    """Return a member of a type whose values lie in HDF5's heap."""

    def member(file: h5py.File, name: str, array: Array, _: Path) -> None:
        dataset = file.create_dataset(name, array.shape, dtype)
        dataset[(0,) * array.ndim] = value

    return member


def _changed(change: Callable[[Array], Array]) -> Member:
    """Return a member of other values."""

    def member(file: h5py.File, name: str, array: Array, _: Path) -> None:
        file.create_dataset(name, data=change(array.copy()).astype(array.dtype))

    return member


def _ends(*values: int) -> Callable[[Array], Array]:
    """Return a change that puts ``values`` into the middle of offsets, whose first and last entries
    stay.
    """

    def change(array: Array) -> Array:
        array[1 : 1 + len(values)] = values
        return array

    return change


def _at(place: int, value: int) -> Callable[[Array], Array]:
    def change(array: Array) -> Array:
        array[place] = value
        return array

    return change


def _one_later(array: Array) -> Array:
    return _at(1, array[1] + 1)(array)


WRAPPING = (2**62, 2**63 - 1, -(2**63), -(2**62), 0)
"""Offsets that leave the data, and whose differences are not negative, since those of int64 wrap
round.
"""

PLAIN = "not plain contiguous data"
GROW = "does not hold offsets"


class DatasetFault(NamedTuple):
    """What is wrong with which dataset, and what the message must say after its name (a regular
    expression).
    """

    dataset: str
    says: str
    member: Member
    blamed: str = ""
    """The dataset that the message names, where it is not the one that was changed."""


DATASETS: dict[str, DatasetFault] = {
    "soft-link": DatasetFault("maps", "is a link", _soft_link),
    "dangling-soft-link": DatasetFault("maps", "is a link|is missing", _dangling_soft_link),
    "soft-link-loop": DatasetFault("maps", "is a link|is missing", _soft_link_loop),
    "virtual-of-itself": DatasetFault("maps", PLAIN, _virtual_of_itself),
    "group": DatasetFault("maps", "is not a dataset", _group),
    "root-again": DatasetFault("maps", "is not a dataset", _root_again),
    "named-type": DatasetFault("maps", "is not a dataset", _named_type),
    "missing": DatasetFault("astar_diagonal", "is missing", _missing),
    "chunked": DatasetFault("maps", PLAIN, _stored(chunks=True)),
    "gzip": DatasetFault("maps", PLAIN, _stored(compression="gzip")),
    "lzf": DatasetFault("bfs_moves", PLAIN, _stored(compression="lzf")),
    "shuffle": DatasetFault("seeds", PLAIN, _stored(shuffle=True)),
    "fletcher32": DatasetFault("maps", PLAIN, _stored(fletcher32=True)),
    "scale-offset": DatasetFault("seeds", PLAIN, _stored(scaleoffset=0)),
    "compact": DatasetFault("split", PLAIN, _compact),
    "never-written": DatasetFault("maps", "reaches outside the file", _never_written),
    "huge": DatasetFault("maps", "reaches outside the file", _huge()),
    "huge-chunked": DatasetFault("maps", PLAIN, _huge(chunks=True)),
    "huge-gzip": DatasetFault("maps", PLAIN, _huge(compression="gzip")),
    "float": DatasetFault("maps", "not of type u1", _typed("f4")),
    "float-of-equal-size": DatasetFault("bfs_offsets", "not of type <i8", _typed("f8")),
    "big-endian": DatasetFault("seeds", "not of type <i2", _typed(">i2")),
    "big-endian-offsets": DatasetFault("astar_offsets", "not of type <i8", _typed(">i8")),
    "bool": DatasetFault("maps", "not of type u1", _typed("?")),
    "signed": DatasetFault("split", "not of type u1", _typed("i1")),
    "unsigned": DatasetFault("directions", "not of type i1", _typed("u1")),
    "wide": DatasetFault("bfs_iterations", "not of type <i4", _typed("<i8")),
    "narrow": DatasetFault("room_offsets", "not of type <i8", _typed("<i4")),
    "compound": DatasetFault("seeds", "not of type <i2", _typed([("row", "<i2"), ("col", "<i2")])),
    "complex": DatasetFault("bfs_offsets", "not of type <i8", _typed("c8")),
    "fixed-string": DatasetFault("maps", "not of type u1", _typed("S1")),
    "opaque": DatasetFault("maps", "not of type u1", _typed(h5py.opaque_dtype("V1"))),
    "enumeration": DatasetFault(
        "split", "not of type u1", _typed(h5py.enum_dtype({"train": 0}, "u1"))
    ),
    "reference": DatasetFault(
        "bfs_offsets", "not of type <i8", _ragged(h5py.ref_dtype, h5py.Reference())
    ),
    "vlen": DatasetFault(
        "bfs_moves", "not of type u1", _ragged(h5py.vlen_dtype("u1"), np.zeros(4, np.uint8))
    ),
    "vlen-string": DatasetFault(
        "bfs_moves", "not of type u1", _ragged(h5py.string_dtype(), "moves")
    ),
    "flat": DatasetFault("maps", "has 1 dimensions", _changed(np.ravel)),
    "deep": DatasetFault("seeds", "has 3 dimensions", _changed(lambda array: array[None])),
    "scalar": DatasetFault("split", "has 0 dimensions", _scalar),
    "null": DatasetFault("split", "has 0 dimensions", _null),
    "a-map-more": DatasetFault(
        "maps", "has shape", _changed(lambda array: np.concatenate((array, array[:1])))
    ),
    "a-row-less": DatasetFault("maps", "has shape", _changed(lambda array: array[:, 1:])),
    "a-byte-less": DatasetFault("maps", "has shape", _changed(lambda array: array[:, :, 1:])),
    "no-maps": DatasetFault("maps", "has shape", _changed(lambda array: array[:0])),
    "a-split-less": DatasetFault("split", "has shape", _changed(lambda array: array[1:])),
    "a-seed-less": DatasetFault("seeds", "has shape", _changed(lambda array: array[1:])),
    "seeds-of-three": DatasetFault(
        "seeds", "has shape", _changed(lambda array: np.repeat(array, 2, axis=1)[:, :3])
    ),
    "a-size-more": DatasetFault(
        "sizes", "has shape", _changed(lambda array: np.concatenate((array, array)))
    ),
    "a-direction-less": DatasetFault("directions", "has shape", _changed(lambda array: array[1:])),
    "an-iteration-less": DatasetFault(
        "astar_iterations", "has shape", _changed(lambda array: array[1:])
    ),
    "a-cost-less": DatasetFault("astar_straight", "has shape", _changed(lambda array: array[1:])),
    "a-move-less": DatasetFault("bfs_moves", "has shape", _changed(lambda array: array[1:])),
    "diagonals-of-none": DatasetFault(
        "astar_diagonal", "has shape", _changed(lambda array: np.zeros(len(array) + 1))
    ),
    "no-offsets": DatasetFault("bfs_offsets", "has shape", _changed(lambda array: array[:0])),
    "no-rooms": DatasetFault("room_offsets", "has shape", _changed(lambda array: array[:0])),
    "offsets-not-from-0": DatasetFault("bfs_offsets", GROW, _changed(_at(0, 1))),
    "negative-offsets": DatasetFault("bfs_offsets", GROW, _changed(_at(0, -1))),
    "decreasing-offsets": DatasetFault("astar_offsets", GROW, _changed(_ends(40, 30))),
    "offsets-beyond-the-end": DatasetFault("astar_offsets", GROW, _changed(_at(1, 2**40))),
    "wrapping-offsets": DatasetFault("astar_offsets", GROW, _changed(_ends(*WRAPPING))),
    "last-offset-beyond": DatasetFault("bfs_moves", "has shape", _changed(lambda array: array[:0])),
    "last-offset-huge": DatasetFault(
        "bfs_offsets", "has shape", _changed(_at(-1, 2**62)), "bfs_moves"
    ),
    "last-offset-negative": DatasetFault(
        "bfs_offsets", "has shape", _changed(_at(-1, -1)), "bfs_moves"
    ),
    "rooms-not-from-0": DatasetFault("room_offsets", GROW, _changed(_at(0, 1))),
    "rooms-decreasing": DatasetFault("room_offsets", GROW, _changed(_ends(2, 1))),
    "rooms-of-none": DatasetFault("room_offsets", "disagree", _changed(_at(1, 0))),
    "rooms-moved": DatasetFault("room_offsets", "disagree", _changed(_one_later)),
    "pairs-decreasing": DatasetFault("pair_offsets", GROW, _changed(_ends(5, 1))),
    "pairs-moved": DatasetFault("pair_offsets", "disagree", _changed(_one_later)),
    "seed-row-negative": DatasetFault("seeds", "cells outside the map", _changed(_at(-1, -1))),
    "seed-beyond": DatasetFault("seeds", "cells outside the map", _changed(_at(0, 32767))),
    "seeds-transposed": DatasetFault(
        "seeds", "cells outside the map", _changed(lambda array: array[:, ::-1])
    ),
}
"""Faults of one dataset; the message must name it. The shard is 8-connected and has 3 maps of 20 x
70 cells.
"""


# --- root attributes ----------------------------------------------------------------------------


class AttributeFault(NamedTuple):
    """Other values of some attributes (None: missing), and what the message must say (a regular
    expression).
    """

    says: str
    values: dict[str, Any]


def _text(length: int) -> str:
    return '"' + "x" * length + '"'


REQUIRED = (
    "format",
    "format_version",
    "identity",
    "content_hash",
    "spec",
    "seed",
    "start",
    "stop",
    "map_size",
    "movement",
    "resolution",
)
"""Root attributes without which a file is no shard."""

ODD = "not a sound shard|attribute"
"""What is said of an attribute of another type or shape, or whose text cannot be read."""

MOVES_8 = '{"connectivity":8,"corner_cutting":false,"diagonal_cost":1.4142135623730951}'

ATTRIBUTES: dict[str, AttributeFault] = {
    **{
        f"no-{name}": AttributeFault(
            "format" if name == "format" else f"attribute.*'{name}'", {name: None}
        )
        for name in REQUIRED
    },
    "another-format": AttributeFault("not a mapdata shard", {"format": "mapdata2"}),
    "format-a-number": AttributeFault("not a mapdata shard|attribute", {"format": 1}),
    "format-a-list": AttributeFault(
        "not a mapdata shard|attribute", {"format": ["mapdata", "mapdata"]}
    ),
    "format-empty": AttributeFault("not a mapdata shard|attribute", {"format": h5py.Empty("S1")}),
    "newer-version": AttributeFault(
        r"format version 3, this mapdata [\d.]+ reads 1 and 2", {"format_version": 3}
    ),
    "version-2": AttributeFault(
        "format version 2, but its spec is of version 1", {"format_version": 2}
    ),
    "much-newer-version": AttributeFault(
        r"format version 4294967296, .* reads 1", {"format_version": 2**32}
    ),
    "version-0": AttributeFault(r"format version 0, .* reads 1", {"format_version": 0}),
    "version-a-text": AttributeFault(ODD, {"format_version": "one"}),
    "version-a-list": AttributeFault(ODD, {"format_version": [1, 1]}),
    "version-nan": AttributeFault(ODD, {"format_version": np.nan}),
    "version-infinite": AttributeFault(ODD, {"format_version": np.inf}),
    "version-empty": AttributeFault(ODD, {"format_version": h5py.Empty("i8")}),
    "start-negative": AttributeFault("maps -3 to 0", {"start": -3, "stop": 0}),
    "stop-before-start": AttributeFault("maps 3 to 0", {"start": 3, "stop": 0}),
    "stop-beyond": AttributeFault("has shape", {"stop": 4}),
    "stop-short": AttributeFault("has shape", {"stop": 2}),
    "stop-huge": AttributeFault("has shape", {"stop": 2**63 - 1}),
    "start-a-text": AttributeFault(ODD, {"start": "zero"}),
    "start-infinite": AttributeFault(ODD, {"start": -np.inf}),
    "stop-a-table": AttributeFault(ODD, {"stop": np.zeros((2, 2))}),
    "size-of-one": AttributeFault(ODD, {"map_size": [20]}),
    "size-of-three": AttributeFault(ODD, {"map_size": [20, 70, 1]}),
    "size-a-number": AttributeFault(ODD, {"map_size": 20}),
    "size-a-text": AttributeFault(f"{ODD}|has shape", {"map_size": "99"}),
    "size-0": AttributeFault("0 x 70 cells|map_size", {"map_size": [0, 70]}),
    "size-negative": AttributeFault("20 x -70 cells|map_size", {"map_size": [20, -70]}),
    "size-transposed": AttributeFault("has shape|map_size", {"map_size": [70, 20]}),
    "size-beyond": AttributeFault("has shape|map_size", {"map_size": [20, 129]}),
    "size-huge": AttributeFault("has shape|map_size", {"map_size": [2**62, 2**62]}),
    "movement-no-json": AttributeFault(ODD, {"movement": "4"}),
    "movement-half-json": AttributeFault(ODD, {"movement": MOVES_8[:-1]}),
    "movement-a-list": AttributeFault(ODD, {"movement": "[4]"}),
    "movement-a-number": AttributeFault(ODD, {"movement": 4}),
    "movement-of-6": AttributeFault("connectivity", {"movement": MOVES_8.replace("8", "6")}),
    "movement-unknown": AttributeFault("speed", {"movement": '{"speed":1}'}),
    "movement-deep": AttributeFault(ODD, {"movement": "[" * 100_000}),
    "another-movement": AttributeFault(
        "has shape|movement", {"movement": MOVES_8.replace("8", "4", 1)}
    ),
    "spec-no-json": AttributeFault("not JSON", {"spec": "paper"}),
    "spec-a-list": AttributeFault("expected an object", {"spec": "[]"}),
    "spec-a-number": AttributeFault(ODD, {"spec": 7}),
    "spec-many": AttributeFault(ODD, {"spec": ["{}", "{}"]}),
    "spec-unknown": AttributeFault("unknown wings", {"spec": '{"wings":2}'}),
    "spec-huge": AttributeFault("an attribute .* over 64 KiB", {"spec": _text(10**6)}),
    "spec-deep": AttributeFault(ODD, {"spec": "[" * 100_000}),
    "spec-nan": AttributeFault("resolution", {"spec": '{"resolution":NaN}'}),
    "spec-overflow": AttributeFault(ODD, {"spec": '{"resolution":1' + "0" * 400 + "}"}),
    "another-spec": AttributeFault("identity", {"spec": "{}"}),
    "another-seed": AttributeFault("identity", {"seed": "4"}),
    "no-seed-at-all": AttributeFault("identity", {"seed": ""}),
    "seed-a-word": AttributeFault(ODD, {"seed": "three"}),
    "seed-negative": AttributeFault("seed: got -3", {"seed": "-3"}),
    "seed-long": AttributeFault(ODD, {"seed": "9" * 10_000}),
    "another-identity": AttributeFault("identity", {"identity": "0" * 64}),
    "identity-a-number": AttributeFault("identity", {"identity": 5}),
    "resolution-a-text": AttributeFault(ODD, {"resolution": "fine"}),
    "resolution-a-list": AttributeFault(ODD, {"resolution": [0.1, 0.1]}),
    "size-not-the-specs": AttributeFault("map_size", {"map_size": [20, 69]}),
    "movement-not-the-specs": AttributeFault(
        "movement", {"movement": MOVES_8.replace("false", "true")}
    ),
    "resolution-not-the-specs": AttributeFault("resolution", {"resolution": 0.2}),
    "resolution-nan": AttributeFault("resolution", {"resolution": np.nan}),
    "content-hash-a-number": AttributeFault("content_hash", {"content_hash": 5}),
}
"""Faults of the root attributes. The shard is that of `DATASETS`, maps 0 to 3 of seed 3."""


# --- bytes --------------------------------------------------------------------------------------

SIGNATURE = b"\x89HDF\r\n\x1a\n"

BYTES: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    "empty": ("empty file", lambda _: b""),
    "one-byte": ("not a sound shard", lambda _: b"\x89"),
    "text": ("not a sound shard", lambda _: b"item,label,seed rows\n0,map0,3\n" * 500),
    "zeros": ("not a sound shard", lambda image: bytes(len(image))),
    "signature-only": ("not a sound shard", lambda image: SIGNATURE + bytes(len(image) - 8)),
    "header-only": ("not a sound shard", lambda image: image[:48] + bytes(len(image) - 48)),
    "picture": ("not a sound shard", lambda image: b"\x89PNG\r\n\x1a\n" + image[8:]),
    "first-half-twice": ("not a", lambda image: image[: len(image) // 2] * 2),
}
"""Files that are no HDF5, or half of one: (what the message must say, how the sound bytes are
changed).
"""


def write_beyond_the_end(path: Path, sound: Contents) -> None:
    """Write a shard whose dataset ``maps`` declares a gigabyte that lies past the end of the file.

    HDF5 itself believes the file: its old superblock has no checksum, and says that the file is as
    long as it is.
    """
    with h5py.File(path, "w", libver=("earliest", "v110")) as file:
        _write_attributes(file, sound)
        for name, array in sound.arrays.items():
            if name != "maps":
                file.create_dataset(name, data=array)
        properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
        properties.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
        space = h5py.h5s.create_simple((10**9 // 320, 20, 16))
        h5py.h5d.create(file.id, b"maps", h5py.h5t.STD_U8LE, space, properties)
        file.flush()
        end = file["maps"].id.get_offset()
    with open(path, "r+b") as raw:
        raw.truncate(end + 1)
        raw.seek(40)  # the address of the end of the file, in a superblock of version 0
        raw.write((end + 1).to_bytes(8, "little"))
