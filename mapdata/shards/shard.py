"""One shard: a contiguous range of maps with their labels in one HDF5 file.

docs/format.md describes the layout. A file is made in memory, written under a temporary name and
renamed, so a name that exists is complete. `reader.py` opens what was written.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np

from mapdata._version import __version__
from mapdata.arrays import Array, Bytes, Flags, Ints
from mapdata.generators.generator import Generator, identity
from mapdata.generators.maps import Maps
from mapdata.hashing import canonical_json
from mapdata.limits import FORMAT_VERSIONS, Size, least_version
from mapdata.movement import Movement
from mapdata.search.api import SEARCHES
from mapdata.search.labels import Labels, SearchLabels
from mapdata.shards.content import content_hash
from mapdata.shards.hdf5 import (
    ChecksumError,
    check_metadata,
    member_counts,
    read_dataset,
    read_root,
)
from mapdata.shards.temporary import sweep_temporaries, take_lock, temporary_path

StrPath = str | os.PathLike[str]

Span = tuple[int, int]
"""(start, stop) of the maps of a shard."""


TESTED_H5PY = ("3.15", "3.16")
"""The oldest and the newest h5py whose files were read back; docs/promises.md has a table."""

_MAX_TEXT = 4070
"""Largest text attribute, in bytes: with its header it has 4,096, the most that the heap takes."""

REPAIRS = "'mapdata verify' with --repair makes it again where there is a recipe"
"""The end of messages about a shard that is not what it should be: what to do."""


class ShardError(ValueError):
    """A file that is not a sound shard; the message names the file and what is wrong with it."""


def check_version(found: object, where: str = "", error: type[ValueError] = ShardError) -> None:
    """Raise ``error``, which names both versions, for a format version that is not known."""
    if found not in FORMAT_VERSIONS:
        known = " and ".join(map(str, FORMAT_VERSIONS))
        raise error(f"{where}format version {found}, this mapdata {__version__} reads {known}")


class Field(NamedTuple):
    """One HDF5 dataset of a shard, with the attributes that explain it in the file."""

    name: str
    dtype: str
    rank: int
    description: str
    units: str
    encoding: str


_CELL = "cells, (row, col), origin upper left"
_OR_UNKNOWN = "a row a room; -1 unknown"
_BITS = "bits: column c is bit c % 8 of byte c // 8 of its row"
_LEGS = "1 horizontal, 0 vertical, -1 no passage"
_PAIRS = (
    "pairs i < j of a map in row-major order "
    "(the condensed form of scipy.spatial.distance.squareform)"
)
_MOVES = (
    "packed, lowest bits first: 2 bits a move under 4-connectivity, else 4; "
    "0..7 = N E S W NE SE SW NW"
)


def _search_fields(search: str, name: str) -> tuple[Field, ...]:
    """Return the datasets that hold what one search found; ``name`` is its name in words."""
    offsets = f"first move of each segment by {name}"
    moves = f"moves from room q to room q + 1 by {name}"
    iterations = f"iterations of {name}, a segment"
    straight = f"straight moves of {name}"
    return (
        Field(f"{search}_offsets", "<i8", 1, offsets, "moves", "S + 1 offsets"),
        Field(f"{search}_moves", "u1", 1, moves, "code", _MOVES),
        Field(f"{search}_iterations", "<i4", 1, iterations, "cells taken", "plain"),
        Field(f"{search}_straight", "<i4", 1, straight, "moves", f"{_PAIRS}; -1 no path"),
    )


_DIAGONAL = f"{_PAIRS}; empty under 4-connectivity"
_PAIR_OFFSETS = f"N + 1 offsets; {_PAIRS}"

FIELDS = (
    Field("maps", "u1", 3, "occupancy", "1 occupied, 0 free", _BITS),
    Field("split", "u1", 1, "split of each map", "code", "0 train, 1 val, 2 test"),
    Field("passage_width", "<i2", 1, "width of the passages of each map", "cells", "-1 unknown"),
    Field("room_offsets", "<i8", 1, "first room of each map", "rooms", "N + 1 offsets"),
    Field("pair_offsets", "<i8", 1, "first pair of rooms of each map", "pairs", _PAIR_OFFSETS),
    Field("seeds", "<i2", 2, "seed point of each room", _CELL, "a row a room"),
    Field("sizes", "<i2", 2, "rows and columns of each room as drawn", "cells", _OR_UNKNOWN),
    Field("directions", "i1", 2, "legs at A and B of each passage", "code", _LEGS),
    *_search_fields("bfs", "breadth-first search"),
    *_search_fields("astar", "A*"),
    Field("astar_diagonal", "<i4", 1, "diagonal moves of A*, a pair", "moves", _DIAGONAL),
)
"""All datasets of a shard, in the order of the file. Under BFS "straight" counts all moves."""


ATTRIBUTES = (
    "format",
    "format_version",
    "library_version",
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
"""All attributes of the root group of a shard; `Origin.stated` gives their values."""


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
    map_size: Size
    movement: Movement
    resolution: float

    @property
    def identity(self) -> str | None:
        """The identity of the dataset; None for imported maps: they are what their hash says."""
        if self.spec is None or self.seed is None:
            return None
        return identity(self.spec, self.seed)

    @property
    def format_version(self) -> int:
        """The version of the format that the dataset is written in."""
        return least_version(self.map_size) if self.spec is None else self.spec.format_version

    def stated(self, content: str, **own: int) -> dict[str, Any]:
        """Return what a manifest states, and in other words the root attributes of a shard.

        ``content`` is the content hash, ``own`` what only one of the two has.
        """
        return {
            "format": "mapdata",
            "format_version": self.format_version,
            "library_version": __version__,
            "identity": self.identity,
            "content_hash": content,
            "spec": self.spec.to_dict() if self.spec else None,
            "seed": self.seed,
            **own,
            "map_size": self.map_size,
            "movement": asdict(self.movement),
            "resolution": self.resolution,
        }

    def origin(self) -> dict[str, Any]:
        """Return these values by name, without those that a subclass adds."""
        return {field.name: getattr(self, field.name) for field in fields(Origin)}


_SHARD_NAME = re.compile(r"maps-\d{12,}-\d{12,}\.h5")


def is_shard_name(name: str) -> bool:
    """Return whether shards have such names; a manifest's other names are never opened."""
    return _SHARD_NAME.fullmatch(name) is not None


class MapRange:
    """The maps start <= i < stop of a dataset."""

    start: int
    stop: int

    @property
    def limits(self) -> Span:
        """(start, stop)."""
        return self.start, self.stop

    @property
    def maps(self) -> int:
        """How many they are."""
        return self.stop - self.start

    @property
    def file_name(self) -> str:
        """The name of the shard that holds them."""
        return f"maps-{self.start:012d}-{self.stop:012d}.h5"


@dataclass(frozen=True, eq=False)
class Header(MapRange, Origin):
    """What the root attributes of a shard say.

    Two are equal if they say the same, be the family of maps known to one of them alone: its module
    may have been imported since, or a notebook may have made its class anew.

    Attributes:
        start, stop: the maps are start <= i < stop.
    """

    start: int
    stop: int

    def __eq__(self, other: object) -> bool:
        """Return whether the other one says the same."""
        if not isinstance(other, Header) or self._numbers != other._numbers:
            return False
        if self.spec is None or other.spec is None:
            return self.spec is other.spec
        return self.spec == other.spec or self.spec.to_json() == other.spec.to_json()

    def __hash__(self) -> int:
        return hash(self._numbers)

    @property
    def _numbers(self) -> tuple[object, ...]:
        """All but the spec."""
        return self.seed, self.map_size, self.movement, self.resolution, self.start, self.stop


class Shard(NamedTuple):
    """A checked shard: its header and its arrays, views of one memory mapping."""

    path: Path
    header: Header
    content_hash: str
    arrays: Mapping[str, Array]

    def __repr__(self) -> str:
        return f"Shard({self.path}, {self.header}, content_hash={self.content_hash})"


def shard_image(labels: Labels, header: Header) -> tuple[bytes, str]:
    """Return the bytes of a shard file and its content hash.

    Raises:
        ShardError: what HDF5 wrote does not read back as what it was given.
    """
    content = content_hash(labels)
    attributes = _attributes(header, content)
    encoded = encode(labels)
    arrays = {
        field.name: np.ascontiguousarray(encoded[field.name], field.dtype) for field in FIELDS
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
        for field in FIELDS:
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
    for field in FIELDS:
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
        check_metadata(image, [field.name for field in FIELDS])
    except ChecksumError:
        return False
    except ValueError:  # sound until it differs from a shard
        return True
    return True


def is_as_written(image: memoryview) -> bool:
    """Return whether a file has the datasets and attributes of a shard, and no others."""
    try:
        read_image(image)
        return member_counts(image) == (len(ATTRIBUTES), len(FIELDS))
    except ValueError:
        return False


def encode(labels: Labels) -> dict[str, Array]:
    """Return labelled maps as the arrays of a shard."""
    maps = labels.maps
    # tables are padded to the most rooms of the batch; a file holds the rows of rooms alone
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
    for name in SEARCHES:
        search = labels.of(name)
        arrays |= {
            f"{name}_offsets": search.offsets,
            f"{name}_moves": pack_moves(search.moves, bits_of(maps.movement)),
            f"{name}_iterations": search.iterations,
            f"{name}_straight": search.costs[:, 0],
        }
    # BFS counts moves, so it needs no second number; nor does a search without diagonals
    diagonals = labels.astar.costs[:, 1]
    arrays["astar_diagonal"] = diagonals if maps.movement.connectivity == 8 else diagonals[:0]
    return arrays


def decode(shard: Shard) -> Labels:
    """Return the labelled maps of a shard."""
    arrays = shard.arrays
    header = shard.header
    rooms = np.diff(arrays["room_offsets"])
    most = rooms.max(initial=2)
    used = np.arange(most) < rooms[:, None]
    maps = Maps(
        movement=header.movement,
        columns=header.map_size[1],
        index=np.arange(header.start, header.stop),
        packed=np.array(arrays["maps"]).view("<u8"),
        rooms=rooms,
        passage_width=arrays["passage_width"].astype(np.int64),
        seed_points=_padded(arrays["seeds"], used),
        sizes=_padded(arrays["sizes"], used),
        directions=_padded(arrays["directions"], used[:, 1:]),
        split=np.array(arrays["split"]),
    )
    return Labels(maps, _search_labels(shard, "bfs"), _search_labels(shard, "astar"))


def _padded(rows: Array, used: Flags) -> Ints:
    """Return rows of two numbers where ``used``, (N, R), says; -1 elsewhere."""
    table = np.full((*used.shape, 2), -1, np.int64)
    table[used] = rows
    return table


def _search_labels(shard: Shard, search: str) -> SearchLabels:
    """Return what one search found on the maps of a shard."""
    arrays = shard.arrays
    movement = shard.header.movement
    offsets = np.array(arrays[f"{search}_offsets"])
    straight = arrays[f"{search}_straight"]
    costs = np.zeros((len(straight), 2), np.int64)
    costs[:, 0] = straight
    if search == "astar" and movement.connectivity == 8:
        costs[:, 1] = arrays["astar_diagonal"]
    return SearchLabels(
        moves=unpack_moves(arrays[f"{search}_moves"], offsets[-1], bits_of(movement)),
        offsets=offsets,
        iterations=arrays[f"{search}_iterations"].astype(np.int64),
        costs=costs,
    )


def bits_of(movement: Movement) -> int:
    """Return how many bits a stored move takes."""
    return 2 if movement.connectivity == 4 else 4


def pack_moves(moves: Bytes, bits: int) -> Bytes:
    """Pack moves, the first one in the lowest bits of a byte."""
    each = 8 // bits
    padded = np.pad(moves, (0, -len(moves) % each))
    packed = np.zeros(len(padded) // each, np.uint8)
    for k in range(each):
        packed |= padded[k::each] << bits * k
    return packed


def unpack_moves(packed: Bytes, count: int, bits: int) -> Bytes:
    """Undo `pack_moves` for ``count`` moves."""
    shifts = np.arange(0, 8, bits, dtype=np.uint8)
    moves: Bytes = (packed[:, None] >> shifts) & (2**bits - 1)
    return moves.reshape(-1)[:count]


def write_file(path: Path, data: bytes) -> None:
    """Write ``data`` so that ``path`` is either what it was or complete, through a power cut too.

    Whatever else the name stood for, such as a link, is replaced.

    Raises:
        OSError: the disk is full or not writable; nothing is left behind under any name.
    """
    temporary = temporary_path(path)
    try:
        with open(temporary, "xb") as file:
            take_lock(file)  # it tells those who sweep that the writer lives
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except FileNotFoundError:
        if not path.parent.is_dir():
            raise
        # it was swept while it had no lock: just made, just closed, or where there are no locks
        write_file(path, data)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.errno and error.filename is None:
            # what fails while bytes are written, as on a full disk, does not say where
            raise OSError(error.errno, error.strerror, str(path)) from None
        raise
    sync_folder(path.parent)


def write_output(path: StrPath, data: bytes) -> None:
    """Write ``data`` to what a user names: a file at once, a link followed, a device or pipe as is.

    What writers left beside the file that were killed is removed.

    Raises:
        OSError: as `write_file`.
    """
    target = Path(path)
    if target.exists() and not target.is_file():
        target.write_bytes(data)
    else:
        target = Path(os.path.realpath(path))
        sweep_temporaries(target.parent)
        write_file(target, data)


def sync_folder(folder: Path) -> None:
    """Make renames in ``folder`` durable: without this, a power cut may undo them."""
    if os.name == "nt":
        return  # Windows cannot open a folder, and needs no such call
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _attributes(header: Header, content: str) -> dict[str, Any]:
    """Return the root attributes of a shard: HDF5 has neither objects nor unsigned seeds."""
    values = header.stated(content, start=header.start, stop=header.stop)
    for name in ("spec", "movement", "seed"):
        if values[name] is not None:
            values[name] = canonical_json(values[name])
    return {name: "" if value is None else value for name, value in values.items()}


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
