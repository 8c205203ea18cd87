"""Opening a shard without trusting it: all is checked once, then arrays are views of the file.

A file is read through one memory mapping, and by no library: `hdf5.py` knows its bytes.
"""

from __future__ import annotations

import ctypes
import json
import math
import mmap
import os
import re
import stat
from collections.abc import Mapping
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple
from weakref import finalize

import numpy as np

from mapdata.arrays import Array, Bytes
from mapdata.checks import check_integers
from mapdata.generators.generator import stored_generator
from mapdata.generators.maps import WORD
from mapdata.hashing import sha256_of
from mapdata.movement import Movement
from mapdata.search.api import SEARCHES
from mapdata.search.labels import Labels
from mapdata.shards.arrays import Shard, bits_of, decode
from mapdata.shards.content import content_hash
from mapdata.shards.errors import REPAIRS, ShardError
from mapdata.shards.files import StrPath
from mapdata.shards.hdf5 import check_metadata
from mapdata.shards.header import Header, check_version, is_shard_name
from mapdata.shards.image import foreign, is_as_written, is_undamaged, read_image


def read_shard(path: StrPath) -> Labels:
    """Return all maps of a shard file with their labels.

    Raises:
        FileNotFoundError: no such file.
        ShardError: a file that is not a sound shard, or has the name of another one, or whose
            content does not have the hash that it states.
    """
    return sound_labels(open_shard(path))


def open_shard(path: StrPath, size: int | None = None, sha256: str | None = None) -> Shard:
    """Check a shard file and map it.

    Args:
        path: the file. If it has the name of a shard, it must hold the maps of that shard.
        size: how many bytes the manifest says it has.
        sha256: its file hash as the manifest says it, compared once a process. A file with another
            hash is read if its content is what it states: the same maps, written anew. Without
            ``sha256`` the checksums of all metadata are compared instead, but no maps and labels.

    Raises:
        FileNotFoundError: no such file.
        ShardError: a file that is not a sound shard. Nothing outside it is opened, whatever it
            links to.
        OSError: too many files are open or mapped.
    """
    mapped = map_shard(path, size)
    shard = mapped.shard
    name = shard.path.name
    if is_shard_name(name) and name != shard.header.file_name:
        raise ShardError(
            f"{shard.path}: holds other maps than its name says, those of {shard.header.file_name}"
        )
    if sha256 is None:
        try:
            check_metadata(mapped.image.data, shard.arrays)
        except ValueError as error:
            raise ShardError(f"{shard.path}: not a sound shard ({error}); {REPAIRS}") from None
    elif not has_hash(mapped.image, mapped.status, sha256):
        sound_labels(shard)
    return shard


class MappedShard(NamedTuple):
    """A shard whose header and arrays can be read, but whose bytes may be damaged.

    Attributes:
        shard: header and arrays.
        image: all bytes of the file.
        status: what the system said of the file when it was opened.
    """

    shard: Shard
    image: Bytes
    status: os.stat_result


def map_shard(path: StrPath, size: int | None = None) -> MappedShard:
    """Map a shard file under any name, and check what can be checked without reading all of it.

    Args and errors are those of `open_shard`; no hash and no checksum is compared.
    """
    path = Path(path)
    # before it is opened, since opening a pipe waits for its writer
    if not stat.S_ISREG(os.stat(path).st_mode):
        raise ShardError(f"{path}: not a file")
    with open(path, "rb", buffering=0) as file:
        status = os.fstat(file.fileno())
        if status.st_size == 0:
            raise ShardError(f"{path}: empty file; {REPAIRS}")
        image = map_file(file.fileno(), status.st_size)
    if size is not None and status.st_size != size:
        why = f"has {status.st_size} bytes, the manifest says {size}"
        raise ShardError(f"{path}: {_other_size(image.data, why)}")
    try:
        attributes, arrays = read_image(image.data)
        header, content = _read_header(attributes)
        _check_arrays(arrays, header)
    except ShardError as error:
        raise ShardError(f"{path}: {error}") from None
    except KeyError as error:
        why = f"attribute {error} is missing, or neither text of fixed length nor numbers"
        raise ShardError(f"{path}: {why}") from None
    except UNSOUND as error:
        raise ShardError(f"{path}: not a sound shard ({error})") from error
    return MappedShard(Shard(path, header, content, arrays), image, status)


def _other_size(image: memoryview, why: str) -> str:
    """Return what is said of a file that has another size than the manifest says, as ``why``."""
    if not is_undamaged(image):
        return f"{why}: damaged; {REPAIRS}"
    if not is_as_written(image):
        return foreign(image, why)
    return f"{why}: not the shard that the manifest lists; {REPAIRS}"


UNSOUND = (
    TypeError,
    ValueError,
    LookupError,
    AttributeError,
    ArithmeticError,
    RecursionError,
)
"""What `hdf5.py`, JSON and our own checks raise on files that are not what they should be."""


_compared: set[tuple[int | str, ...]] = set()
"""Files whose hash this process, or the one that it was forked from, found to be right."""


def has_hash(data: Bytes, status: os.stat_result, sha256: str) -> bool:
    """Return whether a file has the hash that is expected; it is read and hashed once a process."""
    # The time of the last change of any kind tells, too, where a copy kept the time of its bytes.
    times = (status.st_mtime_ns, status.st_ctime_ns)
    file = (status.st_dev, status.st_ino, status.st_size, *times, sha256)
    if file not in _compared and sha256_of(data.data) == sha256:
        _compared.add(file)
    return file in _compared


def sound_labels(shard: Shard) -> Labels:
    """Return the labelled maps of a shard.

    Raises:
        ShardError: they do not have the content hash that the shard states.
    """
    with suppress(*UNSOUND):
        labels = decode(shard)
        if content_hash(labels) == shard.content_hash:
            return labels
    raise ShardError(f"{shard.path}: damaged (its content hash does not fit); {REPAIRS}")


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
        address = _libc().mmap(None, size, mmap.PROT_READ, mmap.MAP_SHARED, descriptor, 0)
        if address == ctypes.c_void_p(-1).value:
            error = ctypes.get_errno()
            why = f"{os.strerror(error)}: cannot map a shard beside those that are open"
            raise OSError(error, why)
        # not at exit, where the array may still be in use
        finalize(self, _libc().munmap, address, size).atexit = False
        # numpy makes an array of an object with this attribute; True is read-only
        data = (address, True)
        self.__array_interface__ = {"version": 3, "typestr": "|u1", "shape": (size,), "data": data}


def map_file(descriptor: int, size: int) -> Bytes:
    """Return the ``size`` bytes of an open file as a read-only array.

    The descriptor may be closed afterwards.

    Raises:
        OSError: the system refuses, as Linux does beyond ``vm.max_map_count``, 65,530 by default.
    """
    if os.name == "nt":
        return np.frombuffer(mmap.mmap(descriptor, size, access=mmap.ACCESS_READ), np.uint8)
    return np.asarray(_Mapping(descriptor, size))


def _read_header(attributes: Mapping[str, Any]) -> tuple[Header, str]:
    """Return the header and the content hash that the root attributes state."""
    if attributes.get("format") != "mapdata":
        raise ShardError("not a mapdata shard (its attribute 'format' is not 'mapdata')")
    version = int(attributes["format_version"])
    check_version(version)
    spec = stored_generator(attributes["spec"]) if attributes["spec"] else None
    header = Header(
        spec=spec,
        seed=int(attributes["seed"]) if attributes["seed"] else None,
        start=int(attributes["start"]),
        stop=int(attributes["stop"]),
        map_size=check_integers("map_size", attributes["map_size"]),
        movement=Movement(**json.loads(attributes["movement"])),
        resolution=float(attributes["resolution"]),
    )
    if header.format_version != version:
        raise ShardError(
            f"format version {version}, but its spec is of version {header.format_version}"
        )
    if attributes["identity"] != (header.identity or ""):
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


def is_hash(text: str) -> bool:
    """Return whether ``text`` is what a SHA-256 looks like."""
    return re.fullmatch(r"[0-9a-f]{64}", text) is not None


def _check_arrays(arrays: Mapping[str, Array], header: Header) -> None:
    """Check shapes, and what kernels rely on: offsets grow, seed points are on free cells."""
    rows, columns = header.map_size
    if not (header.stop >= header.start >= 0 and min(rows, columns) > 0):
        raise ShardError(f"maps {header.start} to {header.stop} of {rows} x {columns} cells")
    for name, shape in _shapes(header, arrays).items():
        if arrays[name].shape != shape:
            raise ShardError(f"dataset {name!r} has shape {arrays[name].shape}, expected {shape}")
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
    # every search begins at a seed point, and none on an occupied cell
    maps = np.repeat(np.arange(len(rooms)), rooms)
    row, column = seed_points.T
    occupied = arrays["maps"][maps, row, column // 8] & (1 << column % 8)
    for number in maps[occupied > 0][:1]:
        raise ShardError(
            f"a seed point of map {header.start + number} is on an occupied cell (datasets 'maps' "
            "and 'seeds')"
        )


def _shapes(header: Header, arrays: Mapping[str, Array]) -> dict[str, tuple[int, ...]]:
    """Return the shape that every array must have, given the header and the last offsets."""
    rows, columns = header.map_size
    octets = (columns + WORD - 1) // WORD * WORD // 8  # a row is a whole number of words
    maps = header.maps
    rooms = _last(arrays["room_offsets"])
    pairs = _last(arrays["pair_offsets"])
    segments = rooms - maps
    shapes = {
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
