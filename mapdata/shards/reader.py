"""Opening a shard without trusting it: all is checked once, then arrays are views of the file.

HDF5 is asked only where each array lies; the data are read through one memory mapping, never
through HDF5.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import math
import mmap
import os
import re
import stat
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from h5py import h5a, h5d, h5f, h5l, h5o, h5p, h5t

from mapdata.arrays import Bytes
from mapdata.generators.generator import Generator, identity
from mapdata.generators.maps import WORD
from mapdata.search.labels import Labels
from mapdata.shards.content import content_hash
from mapdata.shards.shard import (
    FIELDS,
    SEARCHES,
    Array,
    Field,
    Header,
    Shard,
    ShardError,
    StrPath,
    bits_of,
    check_version,
    decode,
)
from mapdata.spec import Movement


def read_shard(path: StrPath) -> Labels:
    """Return all maps of a shard file with their labels.

    Raises:
        FileNotFoundError: no such file.
        ShardError: a file that is not a sound shard, or whose content does not have the hash that
            it states.
    """
    shard = open_shard(path)
    _check_content(shard)
    return decode(shard)


def open_shard(path: StrPath, size: int | None = None, sha256: str | None = None) -> Shard:
    """Check a shard file and map it.

    Args:
        path: the file.
        size: how many bytes the manifest says it has.
        sha256: its file hash as the manifest says it, compared once a process. A file with another
            hash is read if its content is what it states: the same maps, written anew.

    Raises:
        FileNotFoundError: no such file.
        ShardError: a file that is not a sound shard. Nothing outside it is opened, whatever it
            links to.
        OSError: too many files are open or mapped.
    """
    path = Path(path)
    for _ in range(_ATTEMPTS):
        # before it is opened, since opening a pipe waits for its writer
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise ShardError(f"{path}: not a file")
        with open(path, "rb", buffering=0) as file:
            status = os.fstat(file.fileno())
            if size is not None and status.st_size != size:
                raise ShardError(f"{path}: has {status.st_size} bytes, the manifest says {size}")
            if status.st_size == 0:
                raise ShardError(f"{path}: empty file")
            mapping = map_file(file.fileno(), status.st_size)
            try:
                shard = _parse(path, status, mapping)
            except ShardError as error:
                raise ShardError(f"{path}: {error}") from None
            except FileNotFoundError:
                raise
            except _UNSOUND as error:
                raise ShardError(f"{path}: not a sound shard ({error})") from error
        if shard is not None:
            if sha256 is not None and not has_hash(mapping, status, sha256):
                _check_content(shard)
            return shard
    raise ShardError(f"{path}: was replaced each of the {_ATTEMPTS} times that it was opened")


_compared: set[tuple[int | str, ...]] = set()
"""Files whose hash this process, or the one that it was forked from, found to be right."""


def has_hash(data: Bytes, status: os.stat_result, sha256: str) -> bool:
    """Return whether a file has the hash that is expected; it is read and hashed once a process."""
    # The time of the last change of any kind tells, too, where a copy kept the time of its bytes.
    times = (status.st_mtime_ns, status.st_ctime_ns)
    file = (status.st_dev, status.st_ino, status.st_size, *times, sha256)
    if file not in _compared and hashlib.sha256(data.data).hexdigest() == sha256:
        _compared.add(file)
    return file in _compared


def _check_content(shard: Shard) -> None:
    """Refuse a shard whose maps and labels do not have the content hash that it states."""
    try:
        same = content_hash(decode(shard)) == shard.content_hash
    except (ValueError, IndexError, ArithmeticError):
        same = False
    if not same:
        raise ShardError(
            f"{shard.path}: damaged (its content hash does not fit); 'mapdata verify' with "
            "--repair makes it again where there is a recipe"
        )


def _parse(path: Path, status: os.stat_result, mapping: Bytes) -> Shard | None:
    """Return the shard in a mapping; None if another file took its name after it was mapped."""
    file = h5f.open(os.fsencode(path), h5f.ACC_RDONLY, _ACCESS)
    try:
        # HDF5 opens by name, so a builder may have replaced the file since it was mapped
        if not os.path.samestat(os.stat(path), status):
            return None
        header, content = _read_header(_read_attributes(file))
        return Shard(path, header, content, _checked_arrays(file, mapping, header))
    finally:
        file.close()


_UNSOUND = (OSError, RuntimeError, KeyError, TypeError, ValueError, ArithmeticError)
"""What HDF5, JSON and our own checks of a spec raise on files that are no sound shards."""

_ATTEMPTS = 10
"""How often a file is opened that is replaced at that very moment, before we give up."""


def _access() -> h5p.PropFAID:
    """Return how HDF5 opens files: without locks, and closing all that is open inside with them."""
    access = h5p.create(h5p.FILE_ACCESS)
    access.set_fclose_degree(h5f.CLOSE_STRONG)
    access.set_file_locking(False, ignore_when_disabled=False)
    return access


_ACCESS = _access()


@lru_cache(maxsize=1)
def _libc() -> Any:
    """Return the C library, with the types of the two functions that are called."""
    libc = ctypes.CDLL(None, use_errno=True)
    libc.mmap.restype = ctypes.c_void_p
    libc.mmap.argtypes = (ctypes.c_void_p, ctypes.c_size_t, *(ctypes.c_int,) * 3, ctypes.c_long)
    libc.munmap.argtypes = (ctypes.c_void_p, ctypes.c_size_t)
    return libc


class _Mapping:
    """A read-only memory mapping of a file, which lasts as long as an array that views it.

    Unlike `mmap.mmap` it keeps no file descriptor, of which a process often may have 1,024 only.
    """

    def __init__(self, descriptor: int, size: int) -> None:
        """Map ``size`` bytes; the descriptor may be closed afterwards."""
        self._unmap: Any = None  # for __del__, if mapping fails
        address = _libc().mmap(None, size, mmap.PROT_READ, mmap.MAP_SHARED, descriptor, 0)
        if address == ctypes.c_void_p(-1).value:
            error = ctypes.get_errno()
            why = f"{os.strerror(error)}: cannot map a shard beside those that are open"
            raise OSError(error, why)
        self._unmap = _libc().munmap  # kept: at exit the module may be gone before the array
        self._place = (address, size)
        # numpy makes an array of an object with this attribute; True is read-only
        data = (address, True)
        self.__array_interface__ = {"version": 3, "typestr": "|u1", "shape": (size,), "data": data}

    def __del__(self) -> None:
        """Unmap."""
        if self._unmap is not None:
            self._unmap(*self._place)


def map_file(descriptor: int, size: int) -> Bytes:
    """Return the ``size`` bytes of an open file as a read-only array.

    The descriptor may be closed afterwards.

    Raises:
        OSError: the system refuses, as Linux does beyond ``vm.max_map_count``, 65,530 by default.
    """
    if os.name == "nt":
        return np.frombuffer(mmap.mmap(descriptor, size, access=mmap.ACCESS_READ), np.uint8)
    return np.asarray(_Mapping(descriptor, size))


ATTRIBUTES = (
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
"""The root attributes that a reader needs."""


def _read_attributes(file: h5f.FileID) -> dict[str, Any]:
    """Return the root attributes that a reader needs by name."""
    return {name: _read_attribute(file, name) for name in ATTRIBUTES}


def _read_attribute(file: h5f.FileID, name: str) -> Any:
    """Return a root attribute: text of fixed length, or one or two numbers; others are not read."""
    try:
        attribute = h5a.open(file, name.encode())
    except KeyError:
        if h5a.exists(file, name.encode()):
            raise  # it is there, and damaged
        what = f"attribute {name!r} is missing"
        if name == "format":
            what = "not a mapdata shard (it has no attribute 'format')"
        raise ShardError(what) from None
    kind = attribute.get_type()
    size = kind.get_size()
    count = attribute.get_storage_size() // size
    is_text = isinstance(kind, h5t.TypeStringID) and not kind.is_variable_str()
    is_number = isinstance(kind, (h5t.TypeIntegerID, h5t.TypeFloatID))
    if not (is_text or is_number) or count not in (1, 2) or size > _LONGEST_TEXT:
        raise ShardError(f"attribute {name!r} is not a number or a text of fixed length")
    shape = () if count == 1 else (2,)
    array = np.empty(shape, f"S{size}" if is_text else kind.dtype)
    attribute.read(array, mtype=kind)
    return bytes(array.item()).decode() if is_text else array[()]


_LONGEST_TEXT = 65536
"""Most bytes of a root attribute: a hostile file must not make us allocate more."""


def _read_header(attributes: Mapping[str, Any]) -> tuple[Header, str]:
    """Return the header and the content hash that the root attributes state."""
    if attributes["format"] != "mapdata":
        raise ShardError("not a mapdata shard (its attribute 'format' is not 'mapdata')")
    version = int(attributes["format_version"])
    check_version(version)
    rows, columns = (int(side) for side in attributes["map_size"])
    spec, seed, expected_identity = _recipe(attributes["spec"], attributes["seed"])
    header = Header(
        spec=spec,
        seed=seed,
        start=int(attributes["start"]),
        stop=int(attributes["stop"]),
        map_size=(rows, columns),
        movement=Movement(**json.loads(attributes["movement"])),
        resolution=float(attributes["resolution"]),
    )
    if header.format_version != version:
        raise ShardError(
            f"format version {version}, but its spec is of version {header.format_version}"
        )
    if attributes["identity"] != expected_identity:
        raise ShardError("its identity is not that of its spec and seed")
    if spec is not None:
        expected = (spec.map_size, spec.movement, spec.resolution)
        if (header.map_size, header.movement, header.resolution) != expected:
            raise ShardError(
                "its attributes 'map_size', 'movement', 'resolution' are not those of its 'spec'"
            )
    if not 0 < header.resolution < math.inf:
        raise ShardError(f"its attribute 'resolution' is {header.resolution}")
    content = attributes["content_hash"]
    if not (isinstance(content, str) and is_hash(content)):
        raise ShardError("its attribute 'content_hash' is not 64 hexadecimal digits")
    return header, content


@lru_cache(maxsize=16)  # all shards of a dataset have one recipe
def _recipe(spec: str, seed: str) -> tuple[Generator | None, int | None, str]:
    """Return the spec, the seed and the identity of their texts; "" stands for none."""
    generator = Generator.from_json(spec) if spec else None
    number = int(seed) if seed else None
    if generator is None or number is None:
        return generator, number, ""
    return generator, number, identity(generator, number)


def is_hash(text: str) -> bool:
    """Return whether ``text`` is what a SHA-256 looks like."""
    return re.fullmatch(r"[0-9a-f]{64}", text) is not None


def _checked_arrays(file: h5f.FileID, mapping: Bytes, header: Header) -> dict[str, Array]:
    """Return the arrays of a shard, each of them plain data inside this very file."""
    arrays = {field.name: _plain(file, field, mapping) for field in FIELDS}
    rows, columns = header.map_size
    if not (header.stop >= header.start >= 0 and min(rows, columns) > 0):
        raise ShardError(f"maps {header.start} to {header.stop} of {rows} x {columns} cells")
    for name, shape in _shapes(header, arrays).items():
        if arrays[name].shape != shape:
            raise ShardError(f"dataset {name!r} has shape {arrays[name].shape}, expected {shape}")
    _check_tables(arrays, header)
    return arrays


def head(shard: Shard, maps: int) -> Shard:
    """Return a shard of the first maps of another one, still with the content hash of all."""
    arrays = dict(shard.arrays)
    for name in ("room_offsets", "pair_offsets"):
        arrays[name] = arrays[name][: maps + 1]
    segments = int(arrays["room_offsets"][maps]) - maps
    for name in ("bfs_offsets", "astar_offsets"):
        arrays[name] = arrays[name][: segments + 1]
    header = replace(shard.header, stop=shard.header.start + maps)
    # with shorter offsets, the shapes of the other arrays follow
    for name, shape in _shapes(header, arrays).items():
        arrays[name] = arrays[name][: shape[0]]
    return shard._replace(header=header, arrays=arrays)


def _shapes(header: Header, arrays: Mapping[str, Array]) -> dict[str, tuple[int, ...]]:
    """Return the shape that every array must have, given the header and the last offsets."""
    rows, columns = header.map_size
    octets = (columns + WORD - 1) // WORD * WORD // 8  # a row is a whole number of words
    maps = header.stop - header.start
    rooms = _last(arrays["room_offsets"])
    pairs = _last(arrays["pair_offsets"])
    segments = rooms - maps
    shapes: dict[str, tuple[int, ...]] = {
        "maps": (maps, rows, octets),
        "split": (maps,),
        "passage_width": (maps,),
        "room_offsets": (maps + 1,),
        "pair_offsets": (maps + 1,),
        "seeds": (rooms, 2),
        "sizes": (rooms, 2),
        "directions": (segments, 2),
        "astar_diagonal": (pairs if header.movement.connectivity == 8 else 0,),
    }
    for search in SEARCHES:
        bits = _last(arrays[f"{search}_offsets"]) * bits_of(header.movement)
        shapes |= {
            f"{search}_offsets": (segments + 1,),
            f"{search}_moves": ((bits + 7) // 8,),
            f"{search}_iterations": (segments,),
            f"{search}_straight": (pairs,),
        }
    return shapes


def _last(offsets: Array) -> int:
    """Return the last of some offsets; 0 if a hostile file has none."""
    return int(offsets[-1]) if len(offsets) else 0


def _plain(file: h5f.FileID, field: Field, mapping: Bytes) -> Array:
    """Return a dataset as a view of the mapping, unless it is a link, filtered or elsewhere."""
    name = field.name.encode()
    try:
        link = file.links.get_info(name)
    except (KeyError, RuntimeError):
        raise ShardError(f"dataset {field.name!r} is missing") from None
    # a soft or external link would make HDF5 open what it points to
    if link.type != h5l.TYPE_HARD:
        raise ShardError(f"dataset {field.name!r} is a link to somewhere else")
    dataset = h5o.open(file, name)
    if not isinstance(dataset, h5d.DatasetID):
        raise ShardError(f"{field.name!r} is not a dataset")
    offset = dataset.get_offset()
    # without an offset it has no values yet, or they lie in chunks, in the header, in other files
    if offset is None and not _is_contiguous(dataset):
        raise ShardError(f"dataset {field.name!r} is not plain contiguous data in this file")
    if not dataset.get_type().equal(_TYPES[field.dtype]):
        raise ShardError(f"dataset {field.name!r} is not of type {field.dtype}")
    shape = dataset.shape
    if shape is None or len(shape) != field.rank:
        raise ShardError(
            f"dataset {field.name!r} has {len(shape or ())} dimensions, expected {field.rank}"
        )
    itemsize = np.dtype(field.dtype).itemsize
    size = math.prod(shape) * itemsize
    if size == 0:
        return np.empty(shape, field.dtype)
    if offset is None or offset < 0 or offset + size > len(mapping) or offset % itemsize:
        raise ShardError(f"dataset {field.name!r} reaches outside the file")
    return mapping[offset : offset + size].view(field.dtype).reshape(shape)


def _is_contiguous(dataset: h5d.DatasetID) -> bool:
    """Return whether a dataset is declared as one unfiltered block in its own file."""
    properties = dataset.get_create_plist()
    if properties.get_nfilters() or properties.get_external_count():
        return False
    return bool(properties.get_layout() == h5d.CONTIGUOUS)


_TYPES = {
    "u1": h5t.STD_U8LE,
    "i1": h5t.STD_I8LE,
    "<i2": h5t.STD_I16LE,
    "<i4": h5t.STD_I32LE,
    "<i8": h5t.STD_I64LE,
}
"""The types of `FIELDS` in HDF5."""


def _check_tables(arrays: Mapping[str, Array], header: Header) -> None:
    """Check what keeps readers inside the arrays: offsets that grow, seed points inside the map."""
    for name in ("room_offsets", "pair_offsets", "bfs_offsets", "astar_offsets"):
        offsets = arrays[name]
        # neighbours are compared, since the difference of two hostile int64 may wrap round
        if len(offsets) == 0 or offsets[0] != 0 or (offsets[1:] < offsets[:-1]).any():
            raise ShardError(f"dataset {name!r} does not hold offsets that start at 0 and grow")
    rooms = np.diff(arrays["room_offsets"])
    pairs = np.diff(arrays["pair_offsets"])
    if (rooms < 1).any() or not np.array_equal(pairs, rooms * (rooms - 1) // 2):
        raise ShardError("datasets 'room_offsets' and 'pair_offsets' disagree")
    seed_points = arrays["seeds"]
    if ((seed_points < 0) | (seed_points >= header.map_size)).any():
        raise ShardError("dataset 'seeds' holds cells outside the map")
