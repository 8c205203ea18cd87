"""Opening shards from untrusted files: everything is checked once, then arrays view the file.

A file is read through one memory mapping and without an HDF5 library, by the patterns of `hdf5.py`.
Only if no manifest states its hash, h5py compares the checksums of its metadata after that.
"""

from __future__ import annotations

import ctypes
import json
import math
import mmap
import os
import stat
from collections.abc import Mapping
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple
from weakref import finalize

import numpy as np

from mapdata.arrays import Array, Bytes, Flags, Ints
from mapdata.checks import check_integers
from mapdata.generators.maps import WORD, Maps, pack
from mapdata.generators.stored_families import stored_generator
from mapdata.hashing import is_sha256_hex, sha256_hex
from mapdata.limits import TERRAIN_VERSION
from mapdata.movement import Movement
from mapdata.search.api import SEARCHES
from mapdata.search.labels import Labels
from mapdata.shards.arrays import Shard, bits_per_move, decode
from mapdata.shards.content import content_hash
from mapdata.shards.errors import NOT_AS_WRITTEN, REPAIRS, UNSOUND, ShardError
from mapdata.shards.files import StrPath
from mapdata.shards.header import Header, check_version, is_shard_name
from mapdata.shards.image import check_metadata, read_image


def read_shard(path: StrPath) -> Labels:
    """Return all maps of a shard file with their labels.

    Raises:
        FileNotFoundError: no such file.
        ShardError: the file is not a sound shard, has the name of another shard, or does not have
            the content hash that it states.
    """
    return sound_labels(open_shard(path))


def open_shard(path: StrPath, size: int | None = None, sha256: str | None = None) -> Shard:
    """Check a shard file and map it into memory.

    Nothing outside of the file is opened, wherever its links lead.

    Args:
        path: the file. If it has the name of a shard, it must hold the maps of that shard.
        size: size of the file in bytes according to the manifest.
        sha256: hash of the file according to the manifest, compared once per process. A file with
            another hash is accepted if it has the content hash that it states: then it holds the
            same maps and was written again. Without ``sha256``, the checksums of all metadata are
            compared instead, but maps and labels are not checked.

    Raises:
        FileNotFoundError: no such file.
        ShardError: the file is not a sound shard.
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
            check_metadata(mapped.image.data)
        except (OSError, RuntimeError, *UNSOUND) as error:
            raise ShardError(
                f"{shard.path}: not a sound shard ({error}): {NOT_AS_WRITTEN}"
            ) from None
    elif not has_hash(mapped.image, mapped.status, sha256):
        sound_labels(shard)
    return shard


class MappedShard(NamedTuple):
    """A shard whose header and arrays can be read, but whose bytes may be damaged.

    Attributes:
        shard: header and arrays.
        image: all bytes of the file.
        status: result of `os.fstat` when the file was opened.
    """

    shard: Shard
    image: Bytes
    status: os.stat_result


def map_shard(path: StrPath, size: int | None = None) -> MappedShard:
    """Map a shard file of any name, and check its header and its offsets.

    No hash and no checksum is compared. See `open_shard` for the arguments and errors.
    """
    path = Path(path)
    # This is checked before the file is opened, because opening a pipe waits for its writer.
    if not stat.S_ISREG(os.stat(path).st_mode):
        raise ShardError(f"{path}: not a file")
    with open(path, "rb", buffering=0) as file:
        status = os.fstat(file.fileno())
        if status.st_size == 0:
            raise ShardError(f"{path}: empty file; {REPAIRS}")
        image = map_file(file.fileno(), status.st_size)
    if size is not None and status.st_size != size:
        reason = f"has {status.st_size} bytes, the manifest says {size}"
        raise ShardError(
            f"{path}: {reason}: damaged, or not the file that the manifest lists; {REPAIRS}"
        )
    try:
        attributes, arrays = read_image(image.data)
        header, stated_hash = _parse_header(attributes)
        _check_arrays(arrays, header)
    except ShardError as error:
        raise ShardError(f"{path}: {error}") from None
    except KeyError as error:
        raise ShardError(
            f"{path}: attribute {error} is missing, or neither text of fixed length nor numbers"
        ) from None
    except UNSOUND as error:
        raise ShardError(f"{path}: not a sound shard ({error}): {NOT_AS_WRITTEN}") from error
    return MappedShard(Shard(path, header, stated_hash, arrays), image, status)


class _HashedFile(NamedTuple):
    """A file whose hash was computed, in a state that any change of it would alter."""

    device: int
    inode: int
    size: int
    modification_time: int  # of the bytes, in nanoseconds; copying may preserve it
    change_time: int  # of bytes or metadata, in nanoseconds
    sha256: str


_hashed_files: set[_HashedFile] = set()
"""The files that this process, or the process that it was forked from, has hashed."""


def has_hash(content: Bytes, status: os.stat_result, sha256: str) -> bool:
    """Return whether a file has the expected hash; a file that has it is hashed once per process.

    Args:
        content: all bytes of the file.
        status: of the file, as `os.fstat` returns it.
        sha256: the expected hash.
    """
    file = _HashedFile(
        device=status.st_dev,
        inode=status.st_ino,
        size=status.st_size,
        modification_time=status.st_mtime_ns,
        change_time=status.st_ctime_ns,
        sha256=sha256,
    )
    if file in _hashed_files:
        return True
    if sha256_hex(content.data) != sha256:
        return False
    _hashed_files.add(file)
    return True


def sound_labels(shard: Shard) -> Labels:
    """Return the labelled maps of a shard after checking their content hash.

    Raises:
        ShardError: they do not have the content hash that the shard states, or the maps are not
            occupied exactly where their terrain is 0.
    """
    labels = None
    with suppress(*UNSOUND):
        labels = decode(shard)
        if content_hash(labels) != shard.content_hash:
            labels = None
    if labels is None:
        raise ShardError(f"{shard.path}: damaged (its content hash does not fit); {REPAIRS}")
    check_terrain(labels.maps, str(shard.path))
    return labels


def check_terrain(maps: Maps, path: str) -> None:
    """Refuse maps whose terrain is not 0 exactly where they are occupied.

    ``path`` is the shard that holds them, for the message.

    Raises:
        ShardError: the message names the first such map.
    """
    if maps.terrain is None:
        return
    disagrees = (pack(maps.terrain == 0) != maps.packed).any(axis=(1, 2))
    if disagrees.any():
        raise ShardError(
            f"{path}: map {maps.index[disagrees.argmax()]} is not occupied exactly where its "
            "terrain is 0 (datasets 'maps' and 'terrain')"
        )


@lru_cache(maxsize=1)
def _libc() -> Any:
    """Return the C library with the types of its functions mmap and munmap."""
    libc = ctypes.CDLL(None, use_errno=True)
    libc.mmap.restype = ctypes.c_void_p
    libc.mmap.argtypes = (ctypes.c_void_p, ctypes.c_size_t, *(ctypes.c_int,) * 3, ctypes.c_long)
    libc.munmap.argtypes = (ctypes.c_void_p, ctypes.c_size_t)
    return libc


class _Mapping:
    """A read-only memory mapping of a file that exists as long as an array views it.

    Unlike `mmap.mmap` it keeps no file descriptor, of which a process often may have only 1,024.
    """

    def __init__(self, descriptor: int, size: int) -> None:
        """Map ``size`` bytes of an open file; its descriptor may be closed afterwards."""
        address = _libc().mmap(None, size, mmap.PROT_READ, mmap.MAP_SHARED, descriptor, 0)
        if address == ctypes.c_void_p(-1).value:
            error = ctypes.get_errno()
            reason = f"{os.strerror(error)}: cannot map a shard beside those that are open"
            raise OSError(error, reason)
        # The file is not unmapped at exit, when the array may still be in use.
        finalize(self, _libc().munmap, address, size).atexit = False
        # numpy creates an array from an object with this attribute.
        is_read_only = True
        self.__array_interface__ = {
            "version": 3,
            "typestr": "|u1",
            "shape": (size,),
            "data": (address, is_read_only),
        }


def map_file(descriptor: int, size: int) -> Bytes:
    """Return the ``size`` bytes of an open file as a read-only array.

    The descriptor may be closed afterwards.

    Raises:
        OSError: the system refuses, as Linux does beyond ``vm.max_map_count``, 65,530 by default.
    """
    if os.name == "nt":
        return np.frombuffer(mmap.mmap(descriptor, size, access=mmap.ACCESS_READ), np.uint8)
    return np.asarray(_Mapping(descriptor, size))


def _parse_header(attributes: Mapping[str, Any]) -> tuple[Header, str]:
    """Return the header and the content hash that the root attributes of a shard state.

    Raises:
        ShardError: an attribute cannot be right.
        KeyError: an attribute is missing.
    """
    if attributes.get("format") != "mapdata":
        raise ShardError("not a mapdata shard (its attribute 'format' is not 'mapdata')")
    version = int(attributes["format_version"])
    check_version(version)
    has_terrain = version == TERRAIN_VERSION
    spec = attributes["spec"]
    generator = stored_generator(spec, has_terrain) if spec else None
    header = Header(
        generator=generator,
        seed=int(attributes["seed"]) if attributes["seed"] else None,
        start=int(attributes["start"]),
        stop=int(attributes["stop"]),
        map_size=check_integers("map_size", attributes["map_size"]),
        movement=Movement(**json.loads(attributes["movement"])),
        resolution=float(attributes["resolution"]),
        has_terrain=has_terrain,
    )
    if header.format_version != version:
        raise ShardError(
            f"format version {version}, but its spec is of version {header.format_version}"
        )
    if attributes["identity"] != (header.identity or ""):
        raise ShardError("its identity is not that of its spec and seed")
    if generator is not None:
        stated_properties = (header.map_size, header.movement, header.resolution)
        if stated_properties != (generator.map_size, generator.movement, generator.resolution):
            raise ShardError(
                "its attributes 'map_size', 'movement', 'resolution' are not those of its 'spec'"
            )
    if not 0 < header.resolution < math.inf:
        raise ShardError(f"its attribute 'resolution' is {header.resolution}")
    stated_hash = attributes["content_hash"]
    if not (isinstance(stated_hash, str) and is_sha256_hex(stated_hash)):
        raise ShardError("its attribute 'content_hash' is not 64 hexadecimal digits")
    return header, stated_hash


def _check_arrays(arrays: Mapping[str, Array], header: Header) -> None:
    """Check shapes, and the properties that kernels rely on.

    Offsets must not decrease, and seed points must be on free cells of the map.

    Raises:
        ShardError: the message names the dataset.
    """
    rows, columns = header.map_size
    if not (header.stop >= header.start >= 0 and min(rows, columns) > 0):
        raise ShardError(f"maps {header.start} to {header.stop} of {rows} x {columns} cells")
    for name, shape in _expected_shapes(header, arrays).items():
        if arrays[name].shape != shape:
            raise ShardError(f"dataset {name!r} has shape {arrays[name].shape}, expected {shape}")
    for name in ("room_offsets", "pair_offsets", "bfs_offsets", "astar_offsets"):
        offsets = arrays[name]
        # Offsets are compared rather than subtracted, since a difference of int64 may overflow.
        if len(offsets) == 0 or offsets[0] != 0 or (offsets[1:] < offsets[:-1]).any():
            raise ShardError(f"dataset {name!r} does not hold offsets that start at 0 and grow")
    rooms = np.diff(arrays["room_offsets"])
    pairs = np.diff(arrays["pair_offsets"])
    if (rooms < 1).any() or not np.array_equal(pairs, rooms * (rooms - 1) // 2):
        raise ShardError("datasets 'room_offsets' and 'pair_offsets' disagree")
    seed_points = arrays["seeds"]
    if ((seed_points < 0) | (seed_points >= header.map_size)).any():
        raise ShardError("dataset 'seeds' holds cells outside the map")
    # Searches begin at seed points and assume that these cells are free.
    map_indices = np.repeat(np.arange(len(rooms)), rooms)  # of the map of each seed point
    row, column = seed_points.T
    occupied_bits = arrays["maps"][map_indices, row, column // 8] & (1 << column % 8)
    _check_seed_points(occupied_bits > 0, "maps", header.start + map_indices)
    if header.has_terrain:
        _check_seed_points(
            arrays["terrain"][map_indices, row, column] == 0, "terrain", header.start + map_indices
        )


def _check_seed_points(is_occupied: Flags, dataset: str, map_numbers: Ints) -> None:
    """Refuse seed points on cells that are occupied according to a dataset.

    Args:
        is_occupied: (R,), of the cell of each seed point.
        dataset: name of the dataset.
        map_numbers: (R,), of each seed point.
    """
    if is_occupied.any():
        raise ShardError(
            f"a seed point of map {map_numbers[is_occupied][0]} is on an occupied cell (datasets "
            f"{dataset!r} and 'seeds')"
        )


def _expected_shapes(header: Header, arrays: Mapping[str, Array]) -> dict[str, tuple[int, ...]]:
    """Return the shape that each array must have, given the header and the last offsets."""
    rows, columns = header.map_size
    words_per_row = (columns + WORD - 1) // WORD
    bytes_per_row = words_per_row * WORD // 8
    maps = header.maps
    rooms = _last(arrays["room_offsets"])
    pairs = _last(arrays["pair_offsets"])
    segments = rooms - maps
    shapes = {
        "maps": (maps, rows, bytes_per_row),
        "split": (maps,),
        "passage_width": (maps,),
        "room_offsets": (maps + 1,),
        "pair_offsets": (maps + 1,),
        "seeds": (rooms, 2),
        "sizes": (rooms, 2),
        "directions": (segments, 2),
        "astar_diagonal": (pairs if header.movement.connectivity == 8 else 0,),
    }
    if header.has_terrain:
        shapes["terrain"] = (maps, rows, columns)
    for search in SEARCHES:
        bit_count = _last(arrays[f"{search}_offsets"]) * bits_per_move(header.movement)
        shapes |= {
            f"{search}_offsets": (segments + 1,),
            f"{search}_moves": ((bit_count + 7) // 8,),
            f"{search}_iterations": (segments,),
            f"{search}_straight": (pairs,),
        }
    return shapes


def _last(offsets: Array) -> int:
    """Return the last offset; 0 if there is none, as a damaged file may have it."""
    return int(offsets[-1]) if len(offsets) else 0
