"""What all formats share: limits, files and folders, and what stands for free and occupied."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mapdata.arrays import Array, Bytes, Ints
from mapdata.formats.collection import Collection
from mapdata.limits import SPLITS
from mapdata.npy import MAX_BYTES, FormatError, StoredArray, refusing
from mapdata.shards.root import Root
from mapdata.shards.workers import bar


@dataclass(frozen=True)
class Limits:
    """How an importer reads: its limits, which are checked before anything is unpacked.

    Attributes:
        pixels: pixels of one image, cells of one map.
        unpacked: bytes of one file; of an archive, of all arrays that are read of it, once
            unpacked. An .npy file may be larger: it is read a map at a time.
        files: files looked at in a folder.
        maps: maps in one file.
        progress: show a progress bar while many files, or a long one, are read.
    """

    pixels: int = 2**24
    unpacked: int = MAX_BYTES
    files: int = 2_000_000
    maps: int = 2**20
    progress: bool = False


LIMITS = Limits()


def check_file(path: Path, limits: Limits) -> None:
    """Refuse to read what is no plain file, or larger than ``limits.unpacked``."""
    if not path.is_file():
        what = "not a plain file" if path.exists() else "no such file"
        raise FormatError(f"{path}: {what}")
    size = path.stat().st_size
    if size > limits.unpacked:
        raise FormatError(f"{path}: has {size} bytes, expected at most {limits.unpacked}")


def read_bytes(path: Path, limits: Limits = LIMITS) -> bytes:
    """Return the content of a file.

    Raises:
        FormatError: missing, not a plain file, or larger than ``limits.unpacked``.
    """
    with refusing(f"{path}: cannot be read"):
        check_file(path, limits)
        return path.read_bytes()


def read_text(path: Path, limits: Limits = LIMITS) -> str:
    """Return the text of a file in UTF-8, or Latin-1 as in old benchmarks, with Unix line ends.

    Raises:
        FormatError: as `read_bytes`; or it is no text.
    """
    data = read_bytes(path, limits)
    if b"\0" in data[:4096]:
        raise FormatError(f"{path}: not a text file")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def walk(folder: Path, endings: tuple[str, ...], limits: Limits, found: Collection) -> list[Path]:
    """Return the files below ``folder`` with one of these endings, map2 before map10.

    Endings are in lower case. Hidden names and links to folders are passed over; links to files
    outside ``folder`` are added to what ``found`` leaves out, with the reason.

    Raises:
        FormatError: more than ``limits.files`` files.
    """
    paths = []
    seen = 0
    inside = folder.resolve()
    for here, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]  # os.walk goes by it
        seen += len(names)
        if seen > limits.files:
            raise FormatError(f"{folder}: holds more than {limits.files} files")
        for name in names:
            path = Path(here, name)
            if not name.lower().endswith(endings) or name.startswith("."):
                continue
            if path.is_symlink() and not Path(os.path.realpath(path)).is_relative_to(inside):
                found.left_out.append((str(path), "a link to outside the folder"))
            else:
                paths.append(path)
    return sorted(paths, key=lambda path: natural(str(path)))


def natural(text: str) -> list[Any]:
    """Return a key that sorts numbers inside names by their value."""
    # text and numbers in turn, the text perhaps empty; more digits than 18 are several numbers
    parts = re.split(r"([0-9]{1,18})", text)
    parts[1::2] = map(int, parts[1::2])
    return parts


SPLIT_NAMES = {
    "train": 0,
    "training": 0,
    "val": 1,
    "valid": 1,
    "validation": 1,
    "dev": 1,
    "test": 2,
    "testing": 2,
}
"""Names of folders that say a split, as codes."""


def split_of(path: Path, source: Path) -> int | None:
    """Return the split that the folders between ``source`` and ``path`` say, or None.

    A ``source`` that is a file stands for its folder.
    """
    folder = source if source.is_dir() else source.parent
    if not path.is_relative_to(folder):
        return None
    for part in path.relative_to(folder).parts[:-1]:
        if part.lower() in SPLIT_NAMES:
            return SPLIT_NAMES[part.lower()]
    return None


def map_files(target: Path, root: Root, progress: bool) -> Iterator[tuple[Path, Bytes, Ints]]:
    """Yield each map of a dataset: where to write it, its grid and its seed points, (n, 2).

    It is written as ``<split>/map<i>``, behind which an ending comes; the folder is made.
    """
    for labels in root.labels(progress=progress):
        maps = labels.maps
        for k, grid in enumerate(maps.occupancy):
            folder = target / SPLITS[maps.split[k]]
            folder.mkdir(parents=True, exist_ok=True)
            yield folder / f"map{maps.index[k]}", grid, maps.seed_points[k, : maps.rooms[k]]


def occupancy(values: Array, what: str, threshold: float | None = None) -> Bytes:
    """Return an array of 0 and 1, bool, or probabilities in [0, 1] as uint8.

    Args:
        values: any shape.
        what: named in errors.
        threshold: probabilities above it are 1; None takes only 0 and 1.

    Raises:
        FormatError: NaN, or another value.
    """
    low = values.min(initial=0)
    high = values.max(initial=0)
    if not 0 <= low <= high <= 1:  # and not "low < 0 or high > 1", which lets NaN pass
        raise FormatError(f"{what}: holds values from {low} to {high}, expected 0 to 1")
    if values.dtype.kind in "biu":
        return values.astype(np.uint8, copy=False)  # a stack may be as large as the limits allow
    occupied = values > (0.5 if threshold is None else threshold)
    if threshold is None and not np.array_equal(occupied, values):
        raise FormatError(f"{what}: holds values between 0 and 1, expected only 0 and 1")
    return occupied.view(np.uint8)


def check_grids(array: StoredArray, limits: Limits, threshold: float | None = None) -> None:
    """Look at all of an array before any of its grids is used: a damaged file gives no map.

    A grid at a time is in memory.

    Args:
        array: (H, W), (N, H, W) or (N, 1, H, W).
        limits: of the cells of a grid and of the number of grids.
        threshold: as of `occupancy`.

    Raises:
        FormatError: another shape, more than the limits allow, bad numbers, or damage.
    """
    shape = array.shape
    has_channel = len(shape) == 4 and shape[1] == 1
    if not (len(shape) in (2, 3) or has_channel) or 0 in shape:
        raise FormatError(
            f"{array.label}: has shape {shape}, expected (H, W), (N, H, W) or (N, 1, H, W)"
        )
    count = 1 if len(shape) == 2 else shape[0]
    rows, columns = shape[-2:]
    if rows * columns > limits.pixels:
        raise FormatError(
            f"{array.label}: has {rows} x {columns} pixels, expected at most {limits.pixels} in all"
        )
    if count > limits.maps:
        raise FormatError(f"{array.label}: has {count} maps, expected at most {limits.maps}")
    for _ in grids_of(array, threshold):
        pass


def grids_of(array: StoredArray, threshold: float | None = None) -> Iterator[Bytes]:
    """Yield the grids of an array, (H, W) uint8 each, of a shape that `check_grids` accepts.

    Args:
        array: read anew, a grid at a time.
        threshold: as of `occupancy`.

    Raises:
        FormatError: as `occupancy` and `StoredArray.read`.
    """
    if len(array.shape) == 2:
        yield occupancy(array.read(), array.label, threshold)
        return
    for number, entry in enumerate(array.entries()):
        grid = occupancy(entry, f"{array.label}: map {number}", threshold)
        yield grid.reshape(grid.shape[-2:])


def several(name: str, numbers: list[int]) -> str:
    """Return the name under which some maps of a file are left out for the same reason.

    >>> several("a.npz: train", [3, 5, 8])
    'a.npz: train 3 and 2 others'
    """
    others = len(numbers) - 1
    return f"{name} {numbers[0]}" + (f" and {others} other{'s' * (others > 1)}" if others else "")


def files_of(
    source: Path, endings: tuple[str, ...], limits: Limits, found: Collection
) -> Iterator[Path]:
    """Yield ``source`` if it is a file, else the files below it with one of these endings.

    What `walk` leaves out is added to ``found``.

    Raises:
        FormatError: there is neither, or as `walk`.
    """
    if not source.exists():
        raise FormatError(f"{source}: no such file or folder")
    paths = walk(source, endings, limits, found) if source.is_dir() else [source]
    with bar(limits.progress and len(paths) > 1, len(paths), unit=" files") as advance:
        for path in paths:
            yield path
            advance(1)
