"""One shard: a contiguous range of maps with their labels in one HDF5 file. The layout is written
down in
docs/format.md.

Writing goes through RAM and an atomic rename: a name that exists is complete. `reader.py` opens
what was written.
"""

from __future__ import annotations

import itertools
import os
import socket
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import numpy.typing as npt
from h5py import h5a, h5s, h5t

from mapdata._version import __version__
from mapdata.generators.generator import Generator, identity
from mapdata.generators.maps import Maps
from mapdata.search.labels import Labels, SearchLabels
from mapdata.shards.content import content_hash
from mapdata.spec import FORMAT_VERSIONS, Movement, canonical_json

Array = npt.NDArray[Any]


class ShardError(ValueError):
    """A file that is not a sound shard; the message names the file and what is wrong with it."""


def check_version(found: object, where: str = "", error: type[ValueError] = ShardError) -> None:
    """Raise ``error`` for a version of the format that is not known; its message names both
    versions.
    """
    if found not in FORMAT_VERSIONS:
        known = " and ".join(map(str, FORMAT_VERSIONS))
        raise error(f"{where}format version {found}, this mapdata {__version__} reads {known}")


class Field(NamedTuple):
    """One dataset of a shard: its name and type, and the attributes that explain it to whoever
    opens the file.
    """

    name: str
    dtype: str
    rank: int
    description: str
    units: str
    encoding: str


_CELL = "cells, (row, col), origin upper left"
_PAIRS = (
    "pairs i < j of a map in row-major order "
    "(the condensed form of scipy.spatial.distance.squareform)"
)
_MOVES = (
    "packed, lowest bits first: 2 bits a move under 4-connectivity, else 4; "
    "0..7 = N E S W NE SE SW NW"
)
FIELDS = (
    Field(
        "maps",
        "u1",
        3,
        "occupancy",
        "1 occupied, 0 free",
        "bits: column c is bit c % 8 of byte c // 8 of its row",
    ),
    Field("split", "u1", 1, "split of each map", "code", "0 train, 1 val, 2 test"),
    Field("passage_width", "<i2", 1, "width of the passages of each map", "cells", "-1 unknown"),
    Field("room_offsets", "<i8", 1, "first room of each map", "rooms", "N + 1 offsets"),
    Field(
        "pair_offsets",
        "<i8",
        1,
        "first pair of rooms of each map",
        "pairs",
        f"N + 1 offsets; {_PAIRS}",
    ),
    Field("seeds", "<i2", 2, "seed point of each room", _CELL, "a row a room"),
    Field(
        "sizes",
        "<i2",
        2,
        "rows and columns of each room as drawn",
        "cells",
        "a row a room; -1 unknown",
    ),
    Field(
        "directions",
        "i1",
        2,
        "legs at A and B of each passage",
        "code",
        "1 horizontal, 0 vertical, -1 no passage",
    ),
    *(
        field
        for search, what in (("bfs", "breadth-first search"), ("astar", "A*"))
        for field in (
            Field(
                f"{search}_offsets",
                "<i8",
                1,
                f"first move of each segment by {what}",
                "moves",
                "S + 1 offsets",
            ),
            Field(
                f"{search}_moves",
                "u1",
                1,
                f"moves from room q to room q + 1 by {what}",
                "code",
                _MOVES,
            ),
            Field(
                f"{search}_iterations",
                "<i4",
                1,
                f"iterations of {what}, a segment",
                "cells taken",
                "plain",
            ),
            Field(
                f"{search}_straight",
                "<i4",
                1,
                f"straight moves of {what}",
                "moves",
                f"{_PAIRS}; -1 no path",
            ),
        )
    ),
    Field(
        "astar_diagonal",
        "<i4",
        1,
        "diagonal moves of A*, a pair",
        "moves",
        f"{_PAIRS}; empty under 4-connectivity",
    ),
)
"""All datasets of a shard, in the order of the file. Under BFS "straight" counts all moves."""


@dataclass(frozen=True)
class Origin:
    """What all shards of a dataset say.

    Attributes:
        spec: the spec that the maps were drawn from, None for imported maps.
        seed: the seed they were drawn with, None for imported maps.
        map_size: (rows, columns).
        movement: how the stored paths move.
        resolution: metres per cell.
    """

    spec: Generator | None
    seed: int | None
    map_size: tuple[int, int]
    movement: Movement
    resolution: float

    @property
    def identity(self) -> str | None:
        """The identity of the dataset; None for imported maps, which are what their content hash
        says.
        """
        return None if self.spec is None or self.seed is None else identity(self.spec, self.seed)

    @property
    def format_version(self) -> int:
        """The version of the format that the dataset is written in."""
        return 1 if self.spec is None else self.spec.format_version

    def origin(self) -> dict[str, Any]:
        """Return these values by name, without those that a subclass adds."""
        return {field.name: getattr(self, field.name) for field in fields(Origin)}


@dataclass(frozen=True)
class Header(Origin):
    """What the root attributes of a shard say.

    Attributes:
        start, stop: the maps are start <= i < stop.
    """

    start: int
    stop: int


class Shard(NamedTuple):
    """A checked shard: its header and its arrays, views of one memory mapping."""

    path: Path
    header: Header
    content_hash: str
    arrays: Mapping[str, Array]

    def __repr__(self) -> str:
        return f"Shard({self.path}, {self.header}, content_hash={self.content_hash})"


def shard_image(labels: Labels, header: Header) -> tuple[bytes, str]:
    """Return the bytes of a shard file and its content hash."""
    content = content_hash(labels)
    arrays = encode(labels)
    file = h5py.File(
        f"{id(arrays)}.h5",  # in RAM only, but HDF5 wants one name for each file that is open
        "w",
        driver="core",
        backing_store=False,
        libver=("v110", "v110"),
        alignment_threshold=1,
        alignment_interval=64,
    )
    with file:
        for name, value in _attributes(header, content).items():
            _write_attribute(file, name, value)
        for field in FIELDS:
            dataset = file.create_dataset(
                field.name, data=np.ascontiguousarray(arrays[field.name], field.dtype)
            )
            for name in ("description", "units", "encoding"):
                _write_attribute(dataset, name, getattr(field, name))
        file.flush()
        return file.id.get_file_image(), content


def encode(labels: Labels) -> dict[str, Array]:
    """Return labelled maps as the arrays of a shard."""
    maps = labels.maps
    used = np.arange(maps.seed_points.shape[1]) < maps.rooms[:, None]
    arrays: dict[str, Array] = {
        "maps": maps.packed.astype("<u8", copy=False).view(np.uint8),
        "split": maps.split,
        "passage_width": maps.passage_width,
        "room_offsets": maps.segment_offsets + np.arange(len(maps) + 1),
        "pair_offsets": maps.pair_offsets,
        "seeds": maps.seed_points[used],
        "sizes": maps.sizes[used],
        "directions": maps.directions[used[:, 1:]],
    }
    for name, search in (("bfs", labels.bfs), ("astar", labels.astar)):
        arrays[f"{name}_offsets"] = search.offsets
        arrays[f"{name}_moves"] = pack_moves(search.moves, bits_of(maps.movement))
        arrays[f"{name}_iterations"] = search.iterations
        arrays[f"{name}_straight"] = search.costs[:, 0]
    diagonals = maps.movement.connectivity == 8
    arrays["astar_diagonal"] = labels.astar.costs[:, 1] if diagonals else np.empty(0, np.int32)
    return arrays


def decode(shard: Shard) -> Labels:
    """Return the labelled maps of a shard."""
    arrays, header = shard.arrays, shard.header
    rooms = np.diff(arrays["room_offsets"])
    most = int(rooms.max(initial=2))
    used = np.arange(most) < rooms[:, None]

    def padded(name: str, mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
        table = np.full((*mask.shape, 2), -1, np.int64)
        table[mask] = arrays[name]
        return table

    maps = Maps(
        movement=header.movement,
        columns=header.map_size[1],
        index=np.arange(header.start, header.stop),
        packed=np.array(arrays["maps"]).view("<u8"),
        rooms=rooms,
        passage_width=arrays["passage_width"].astype(np.int64),
        seed_points=padded("seeds", used),
        sizes=padded("sizes", used),
        directions=padded("directions", used[:, 1:]),
        split=np.array(arrays["split"]),
    )
    diagonal = {"bfs": 0, "astar": arrays["astar_diagonal"] if len(arrays["astar_diagonal"]) else 0}
    bfs, astar = (
        SearchLabels(
            moves=unpack_moves(
                arrays[f"{name}_moves"],
                int(arrays[f"{name}_offsets"][-1]),
                bits_of(header.movement),
            ),
            offsets=np.array(arrays[f"{name}_offsets"]),
            iterations=arrays[f"{name}_iterations"].astype(np.int64),
            costs=np.stack(
                np.broadcast_arrays(arrays[f"{name}_straight"], diagonal[name]), axis=-1
            ).astype(np.int64),
        )
        for name in ("bfs", "astar")
    )
    return Labels(maps, bfs, astar)


def bits_of(movement: Movement) -> int:
    """Return how many bits a stored move takes."""
    return 2 if movement.connectivity == 4 else 4


def pack_moves(moves: npt.NDArray[np.uint8], bits: int) -> npt.NDArray[np.uint8]:
    """Pack moves, the first one in the lowest bits of a byte."""
    each = 8 // bits
    padded = np.zeros(-(-len(moves) // each) * each, np.uint8)
    padded[: len(moves)] = moves
    packed = np.zeros(len(padded) // each, np.uint8)
    for k in range(each):
        packed |= padded[k::each] << np.uint8(bits * k)
    return packed


def unpack_moves(packed: npt.NDArray[np.uint8], count: int, bits: int) -> npt.NDArray[np.uint8]:
    """Undo `pack_moves`."""
    shifts = np.arange(0, 8, bits, dtype=np.uint8)
    return np.ascontiguousarray(
        ((packed[:, None] >> shifts) & np.uint8(2**bits - 1)).reshape(-1)[:count]
    )


_written = itertools.count()
"""Numbers the temporary names of this process, so that two writers of one name never share a file.
"""


def write_file(path: Path, data: bytes) -> None:
    """Write ``data`` so that ``path`` is either what it was or complete, through a power cut too.

    Raises:
        OSError: the disk is full or not writable; nothing is left behind under any name.
    """
    temporary = path.with_name(
        f".{path.name}-{next(_written)}.{socket.gethostname()}.{os.getpid()}.tmp"
    )
    try:
        with open(temporary, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Make renames in ``folder`` durable; Windows cannot, and needs no such call."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _attributes(header: Header, content: str) -> dict[str, object]:
    """Return the root attributes of a shard."""
    return {
        "format": "mapdata",
        "format_version": header.format_version,
        "library_version": __version__,
        "identity": header.identity or "",
        "content_hash": content,
        "spec": header.spec.to_json() if header.spec else "",
        "seed": "" if header.seed is None else str(header.seed),
        "start": header.start,
        "stop": header.stop,
        "map_size": np.array(header.map_size, "<i8"),
        "movement": canonical_json(asdict(header.movement)),
        "resolution": header.resolution,
    }


def _write_attribute(owner: h5py.File | h5py.Dataset, name: str, value: object) -> None:
    """Write an attribute; text as a string of fixed length, which lies in metadata that have
    checksums.

    HDF5 keeps strings of variable length in a heap without any, where one flipped bit can make it
    loop for ever.
    """
    if isinstance(value, str):
        data = value.encode()
        kind = h5t.py_create(h5py.string_dtype("utf-8", max(len(data), 1)), logical=True)
        attribute = h5a.create(owner.id, name.encode(), kind, h5s.create(h5s.SCALAR))
        attribute.write(np.array(data, f"S{max(len(data), 1)}"), mtype=kind)
    else:
        owner.attrs[name] = value
