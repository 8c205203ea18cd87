"""The .npz files of problem sets: how they are written and read, and how damage is found.

A file of format 2 holds these arrays:

- ``about_format_2``, a text: JSON with ``movement``, ``description`` and ``content_hash``. The
  format is in its name, so that a version of mapdata that does not know the format names it.
- ``grids``, (K, H, W) uint8: each of the K different maps once, in the order of their numbers. Maps
  with terrain are stored as ``terrain`` instead, whose occupied cells are 0.
- ``starts`` and ``goals``, (N, 2) int64.
- ``map_indices``, (N,) int64: the number of the map of each problem. It is left out where problem i
  is on map i.
- ``problem_numbers``, (N,) int64: the number of each problem. It is left out if it is 0 to N - 1.

The zip archive ends with a comment, "mapdata sha256 " and the SHA-256 of all bytes before the
comment, as 64 hexadecimal digits. Programs that read .npz files ignore it. Only a file whose hash
fits is read: the checksums of a zip archive do not cover the names of its members, and a member
with a damaged name would pass for one that was left out.

A file of format 1, which mapdata 0.2 wrote, has ``about`` with ``movement`` and ``description``; a
map for each problem, (N, H, W), also where problems share one; and no comment. All of its members
are needed, and each has a checksum.

A file with other members than these is refused.
"""

from __future__ import annotations

import hashlib
import json
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mapdata.arrays import Array, Bytes, Ints
from mapdata.hashing import canonical_json
from mapdata.movement import Movement
from mapdata.npy import MAX_BYTES, Npz, StoredArray
from mapdata.shards.files import StrPath, write_output

FORMAT = 2
"""The format that is written."""

_MAX_UNPACKED = 2**26
"""Bytes that the arrays of any saved set may unpack to: 16,000 maps of 64 x 64 cells."""

_MAX_RATIO = 200
"""Factor by which the arrays of a saved set may be larger than its file, up to `MAX_BYTES`.

Sets that planners are compared on reach 10 to 160; files made to fill the memory reach 1,000.
"""

_NUMBERS = ("map_indices", "problem_numbers")
"""Names of the arrays with a number for each problem, which are left out if it is 0 to N - 1."""

_BUILD_ANEW = "build a set that you trust anew from its arrays; see docs/problems.md, Saved sets"
"""What errors advise if a file was written by another program."""

_HASH_LABEL = b"mapdata sha256 "

_END_OF_ARCHIVE = 22
"""Bytes of the record that ends a zip archive without a comment."""


class StoredSet(NamedTuple):
    """What a file holds of N problems on K different maps.

    Attributes:
        maps: (K, H, W), grids of 0 and 1, or terrain.
        has_terrain: whether the maps are terrain.
        map_indices: (N,) int64, number of the map of each problem; map k has the k-th number of
            those that occur.
        starts: (N, 2) cells.
        goals: (N, 2) cells.
        problem_numbers: (N,) int64, number of each problem.
        movement: the rule of moves.
        description: where the problems come from, in words.
        content_hash: as `ProblemSet.content_hash`; None in a file of format 1, which has none.
    """

    maps: Bytes
    has_terrain: bool
    map_indices: Ints
    starts: Ints
    goals: Ints
    problem_numbers: Ints
    movement: Movement
    description: str
    content_hash: str | None


def write_set(path: StrPath, stored: StoredSet) -> None:
    """Write the file of a set; the same problems are the same bytes.

    An existing file is replaced as a whole or not at all. What would unpack to more than `read_set`
    allows is not compressed.

    Raises:
        OSError: the disk is full or not writable.
    """
    about = {
        "movement": asdict(stored.movement),
        "description": stored.description,
        "content_hash": stored.content_hash,
    }
    arrays: dict[str, Array] = {
        "terrain" if stored.has_terrain else "grids": stored.maps,
        "starts": stored.starts,
        "goals": stored.goals,
    }
    for name in _NUMBERS:
        numbers = getattr(stored, name)
        if not np.array_equal(numbers, np.arange(len(numbers))):
            arrays[name] = numbers
    members: dict[str, Any] = {f"about_format_{FORMAT}": canonical_json(about), **arrays}
    archive = BytesIO()
    np.savez_compressed(archive, **members)
    unpacked_bytes = sum(array.nbytes for array in arrays.values())
    if unpacked_bytes > _max_unpacked(archive.getbuffer().nbytes):
        archive = BytesIO()
        np.savez(archive, **members)
    write_output(path, _with_hash(archive.getvalue()))


def read_set(path: Path) -> StoredSet:
    """Read the file of a set, of any format so far.

    The file hash and the headers of the arrays are checked before anything is unpacked, and of the
    maps of a file of format 1 only the different ones are kept in memory.

    Raises:
        FileNotFoundError: the file does not exist.
        Exception: any error of the readers of zip, JSON and arrays, if it holds no set.
    """
    max_bytes = _max_unpacked(path.stat().st_size)
    archive = Npz(path, sys.maxsize)  # the size is checked below, with a clearer message
    about_name = _about_name(archive)
    is_first_format = about_name == "about"
    if not is_first_format and not _hash_fits(path):
        raise ValueError(
            "its file hash does not fit: it is damaged, or another program wrote it; take another "
            f"copy of the file, or {_BUILD_ANEW}"
        )
    has_terrain = "terrain" in archive.shapes
    names = ["terrain" if has_terrain else "grids", "starts", "goals"]
    if not is_first_format:
        names += [name for name in _NUMBERS if name in archive.shapes]
    archive.require(about_name, *names)
    _check_members(archive.members, [about_name, *names])
    about = json.loads(archive.text(about_name))
    stored = dict(zip(names, archive.arrays(*names), strict=True))
    _check_shapes({name: array.shape for name, array in stored.items()})
    unpacked_bytes = sum(array.nbytes for array in stored.values())
    if unpacked_bytes > max_bytes:
        raise ValueError(
            f"they unpack to {unpacked_bytes} bytes, expected at most {max_bytes}: 64 MiB, "
            f"or {_MAX_RATIO} times the file up to 1 GiB; {_BUILD_ANEW}"
        )
    maps = stored[names[0]]
    if is_first_format:
        unpacked_maps, map_indices = different_maps(maps.entries(), maps.shape[1:])
    else:
        unpacked_maps = maps.read()
        map_indices = _read_numbers(stored, "map_indices", len(stored["starts"]))
        _check_map_indices(map_indices, len(unpacked_maps))
    stored_set = StoredSet(
        unpacked_maps,
        has_terrain,
        map_indices,
        stored["starts"].read(),
        stored["goals"].read(),
        problem_numbers=_read_numbers(stored, "problem_numbers", len(stored["starts"])),
        movement=Movement(**about["movement"]),
        description=str(about["description"]),
        content_hash=None if is_first_format else str(about["content_hash"]),
    )
    _check_problem_numbers(stored_set)
    return stored_set


def different_maps(maps: Iterable[Array], shape: tuple[int, ...]) -> tuple[Array, Ints]:
    """Return the different ones of N maps, (K, H, W), and the number of each of the N maps, (N,).

    Different maps are numbered in the order in which they occur first.

    Args:
        maps: the N maps; only the different ones are kept.
        shape: (H, W).
    """
    numbers: dict[bytes, int] = {}
    different: list[Array] = []
    map_indices: list[int] = []
    for grid in maps:
        number = numbers.setdefault(hashlib.sha256(grid.tobytes()).digest(), len(different))
        if number == len(different):
            different.append(grid)
        map_indices.append(number)
    stacked = np.stack(different) if different else np.empty((0, *shape), np.uint8)
    return stacked, np.array(map_indices, np.int64)


def _hash_fits(path: Path) -> bool:
    """Return whether a file of format 2 has the hash that its end states.

    The hash covers every bit of the file.

    Raises:
        OSError: the file cannot be read.
    """
    comment_size = len(_HASH_LABEL) + 64
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        remaining = max(path.stat().st_size - comment_size, 0)
        while remaining and (block := file.read(min(remaining, 2**20))):
            digest.update(block)
            remaining -= len(block)
        comment = file.read()
    return comment == _HASH_LABEL + digest.hexdigest().encode()


def _with_hash(archive: bytes) -> bytes:
    """Return a zip archive that has no comment with one that holds its hash."""
    comment_size = len(_HASH_LABEL) + 64
    # The last two bytes state the size of the comment, which is the end of the file.
    assert archive[-_END_OF_ARCHIVE:][:4] == b"PK\x05\x06", "the archive has a comment already"
    content = archive[:-2] + comment_size.to_bytes(2, "little")
    return content + _HASH_LABEL + hashlib.sha256(content).hexdigest().encode()


def _about_name(archive: Npz) -> str:
    """Return the name of the text about the set, which tells the format.

    Raises:
        ValueError: the format is newer than this version of mapdata.
    """
    current_name = f"about_format_{FORMAT}"
    if current_name in archive.shapes:
        return current_name
    for name in archive.shapes:
        match = re.fullmatch(r"about_format_(\d{1,9})", name)
        if match is not None:
            raise ValueError(
                f"has format {match[1]}, expected 1 to {FORMAT}: install a newer version of mapdata"
            )
    return "about"


def _check_members(members: Sequence[str], names: Iterable[str]) -> None:
    """Refuse an archive with other members than the arrays of its format, each of them once.

    Args:
        members: names of the files in the archive.
        names: of the arrays of its format, all of which it has.

    Raises:
        ValueError: a member is unknown, or is there twice.
    """
    unknown = list(members)
    for name in names:
        unknown.remove(f"{name}.npy")
    if unknown:
        raise ValueError(
            f"holds {', '.join(map(repr, unknown))} beside the arrays of its format: it is "
            f"damaged, or another program wrote it; {_BUILD_ANEW}"
        )


def _read_numbers(stored: Mapping[str, StoredArray], name: str, count: int) -> Ints:
    """Return the numbers of maps or problems, (N,) int64; 0 to N - 1 if they are left out.

    Raises:
        ValueError: they are no int64, or one is negative.
    """
    if name not in stored:
        return np.arange(count)
    dtype = stored[name].dtype
    if dtype.kind != "i" or dtype.itemsize != 8:
        raise ValueError(f"{name} holds {dtype}, expected int64")
    numbers = stored[name].read().astype(np.int64)
    if numbers.min(initial=0) < 0:
        raise ValueError(f"{name} holds {numbers.min()}, expected no negative number")
    return numbers


def _check_map_indices(map_indices: Ints, map_count: int) -> None:
    """Refuse numbers of maps that do not fit the stored maps.

    Raises:
        ValueError: more or fewer different numbers than maps.
    """
    different_count = len(np.unique(map_indices))
    if different_count != map_count:
        raise ValueError(
            f"map_indices holds {different_count} different numbers, expected {map_count}, one for "
            "each map"
        )


def _check_problem_numbers(stored: StoredSet) -> None:
    """Refuse a number that two different problems have.

    A set may hold a problem several times, as ``problem_set[[5, 0, 5]]`` does.

    Raises:
        ValueError: the message names the two problems.
    """
    numbers = stored.problem_numbers
    first_places, which = np.unique(numbers, return_index=True, return_inverse=True)[1:]
    if len(first_places) == len(numbers):
        return
    firsts = first_places[which.reshape(-1)]
    differs = stored.map_indices != stored.map_indices[firsts]
    for cells in (stored.starts, stored.goals):
        differs |= (cells != cells[firsts]).any(axis=1)
    if differs.any():
        place = int(np.argmax(differs))
        raise ValueError(
            f"problem_numbers holds {numbers[place]} for the different problems {firsts[place]} "
            f"and {place}, expected another number for each problem"
        )


def _max_unpacked(file_bytes: int) -> int:
    """Return how many bytes the arrays of a saved set of this size may unpack to.

    Arrays that are not compressed are smaller than their file, and so are always allowed.
    """
    return max(_MAX_UNPACKED, min(_MAX_RATIO * file_bytes, MAX_BYTES), file_bytes)


def _check_shapes(shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Refuse shapes that do not fit together.

    Args:
        shapes: by the names of the arrays: grids or terrain, starts, goals, and further ones with a
            number for each problem.

    Raises:
        ValueError: the message says which shapes were expected.
    """
    maps, starts, goals, *_ = shapes.values()
    one_number = starts[:1]  # the shape of an array with a number for each problem
    # A map that problems share is stored once, so that there may be fewer maps than problems.
    maps_fit = len(maps) == 3 and ("map_indices" in shapes or maps[:1] == one_number)
    if not maps_fit or starts != (*one_number, 2) or goals != starts:
        raise ValueError(
            f"{', '.join(shapes)} have shapes {', '.join(map(str, shapes.values()))}, expected "
            "(N, H, W), (N, 2) and (N, 2)"
        )
    for name, shape in shapes.items():
        if name in _NUMBERS and shape != one_number:
            raise ValueError(f"{name} has shape {shape}, expected {one_number}, a number a problem")
