"""Files, folders and arrays of foreign formats: limits, reading, and conversion to grids."""

from __future__ import annotations

import itertools
import math
import os
import re
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from mapdata.arrays import Array, Bytes, Ints
from mapdata.checks import check_count
from mapdata.formats.collection import Collection
from mapdata.hints import hint_on_content, hint_on_values
from mapdata.limits import SPLITS, Cell
from mapdata.npy import MAX_BYTES, FormatError, StoredArray, refusing
from mapdata.shards.errors import LINK_REMEDY
from mapdata.shards.files import leads_out
from mapdata.shards.root import Root
from mapdata.shards.workers import Advance, bar


@dataclass(frozen=True)
class Limits:
    """The limits of an import, which are checked before anything is unpacked.

    Attributes:
        pixels: pixels of one image, cells of one map.
        unpacked: bytes of one file. In an archive the limit holds for the unpacked bytes of all
            arrays that are read. An .npy file may be larger, since it is read a map at a time.
        files: files in a folder and its subfolders.
        maps: maps in one file.
        follow_links: read files and folders that are links out of the folder of the source. Only
            for folders of your own: a stranger's may have links to any file of this machine.
        progress: show a progress bar while many files, or a long one, are read.
    """

    pixels: int = 2**24
    unpacked: int = MAX_BYTES
    files: int = 2_000_000
    maps: int = 2**20
    follow_links: bool = False
    progress: bool = False


LIMITS = Limits()
"""The limits by default."""


def check_file(path: Path, limits: Limits) -> None:
    """Check that ``path`` is a plain file of at most ``limits.unpacked`` bytes.

    Raises:
        FormatError: it is not.
    """
    if not path.exists():
        raise FormatError(f"{path}: no such file{_target_of_link(path)}")
    if not path.is_file():
        raise FormatError(f"{path}: not a plain file")
    size = path.stat().st_size
    if size > limits.unpacked:
        raise FormatError(f"{path}: has {size} bytes, expected at most {limits.unpacked}")


def _target_of_link(path: Path) -> str:
    """Return where a link leads, for the message that nothing is there; empty if it is no link."""
    if not path.is_symlink():
        return ""
    target = os.readlink(path)
    advice = "; git annex get fetches it" if "/annex/objects/" in target else ""
    return f" (a link to {target}){advice}"


_LONG = 10_000
"""Number of maps in one file from which on a bar shows how many are read."""


def maps_bar(limits: Limits, total: int) -> AbstractContextManager[Advance]:
    """Show a bar while the ``total`` maps of one file are read, if these are many.

    Yields:
        The function that advances it.
    """
    return bar(limits.progress and total >= _LONG, total, unit=" maps read")


def check_pixels(label: str, rows: int, columns: int, limits: Limits) -> None:
    """Check the size of a map or picture.

    Args:
        label: names the map in errors.
        rows: its rows.
        columns: its columns.
        limits: of the number of pixels.

    Raises:
        FormatError: it has no pixel, or more than ``limits.pixels``.
    """
    if not 1 <= rows * columns <= limits.pixels:
        raise FormatError(
            f"{label}: has {rows} x {columns} pixels, expected at most {limits.pixels} in all; "
            "--max-pixels sets this limit"
        )


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
    content = read_bytes(path, limits)
    hint = hint_on_content(content[:64], text_expected=True)
    if b"\0" in content[:4096] or hint:
        raise FormatError(f"{path}: not text in UTF-8{hint}")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n")


LINK_OUT = f"a link to outside the folder; {LINK_REMEDY}"
"""Why a file is not read."""


def checked_inside(path: Path, folder: Path, limits: Limits) -> Path:
    """Return the path of a file that the user did not name, after checking that it may be read.

    A source from a stranger could otherwise make us read any file of this machine, by a link or by
    a name with ``..`` in it.

    Args:
        path: of the file, which may be missing.
        folder: that the source is in.
        limits: say whether links out of ``folder`` are followed.

    Raises:
        FormatError: the name leads out of ``folder``, or a link does.
    """
    if not Path(os.path.abspath(path)).is_relative_to(os.path.abspath(folder)):
        raise FormatError(f"{path}: lies outside the folder {folder}")
    if not limits.follow_links and leads_out(path, folder):
        raise FormatError(f"{path}: {LINK_OUT}")
    return path


def sibling(path: Path, name: str, source: Path, limits: Limits) -> Path:
    """Return the path of another file in the folder of ``path``, as `checked_inside` does.

    Args:
        path: a file of the source.
        name: of the other file, which may be missing.
        source: file or folder that the user named.
        limits: say whether links are followed.

    Raises:
        FormatError: the file is a link that leads out of the source.
    """
    folder = source if source.is_dir() else path.parent
    return checked_inside(path.with_name(name), folder, limits)


def files_below(
    folder: Path, endings: tuple[str, ...], limits: Limits, collection: Collection
) -> list[Path]:
    """Return the files below ``folder`` with one of these endings, map2 before map10.

    Hidden files and hidden folders are skipped. So are links to folders, unless they lead out of
    ``folder`` and ``limits`` say that such links are followed.

    Args:
        folder: searched with all its subfolders.
        endings: in lower case.
        limits: of the number of files; they also say whether links are followed.
        collection: links out of ``folder`` that are not followed are added to its ``left_out``.

    Raises:
        FormatError: more than ``limits.files`` files.
    """
    paths = []
    file_count = 0
    seen_folders = {os.path.realpath(folder)}  # links may lead in a circle
    for parent, subfolders, names in os.walk(folder, followlinks=True):
        # os.walk descends into the folders that are left in this list.
        subfolders[:] = [
            name
            for name in subfolders
            if not name.startswith(".")
            and _is_searched(Path(parent, name), folder, seen_folders, limits, collection)
        ]
        file_count += len(names)
        if file_count > limits.files:
            raise FormatError(f"{folder}: holds more than {limits.files} files")
        for name in names:
            path = Path(parent, name)
            if not name.lower().endswith(endings) or name.startswith("."):
                continue
            with collection.leaving_out(path):
                paths.append(checked_inside(path, folder, limits) if path.is_symlink() else path)
    return sorted(paths, key=lambda path: natural_key(str(path)))


def _is_searched(
    subfolder: Path, folder: Path, seen_folders: set[str], limits: Limits, collection: Collection
) -> bool:
    """Return whether `files_below` descends into a subfolder.

    Args:
        subfolder: may be a link.
        folder: that is searched.
        seen_folders: real paths of the folders that are searched already, if links are followed;
            this one is added to them.
        limits: say whether links are followed.
        collection: a link that is not followed is added to its ``left_out``.
    """
    if subfolder.is_symlink():
        if not leads_out(subfolder, folder):
            return False  # its files are found where they are
        with collection.leaving_out(subfolder):
            checked_inside(subfolder, folder, limits)
        if not limits.follow_links:
            return False
    elif not limits.follow_links:
        return True
    # Links may lead to a folder that holds this one, or to the same folder twice.
    target = os.path.realpath(subfolder)
    is_new = target not in seen_folders
    seen_folders.add(target)
    return is_new


def natural_key(text: str) -> list[Any]:
    """Return a key that sorts numbers inside names by their value."""
    # Text and numbers take turns; the text may be empty, so that keys are comparable. At most 18
    # digits are a number, so that a long row of digits takes no time to convert.
    parts: list[Any] = re.split(r"([0-9]{1,18})", text)
    for position in range(1, len(parts), 2):
        parts[position] = int(parts[position])
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
"""Codes of the splits by the names of folders that hold them."""


def split_from_folders(path: Path, source: Path) -> int | None:
    """Return the code of the split after which a folder between ``source`` and ``path`` is named.

    The outermost such folder counts; None if there is none. If ``source`` is a file, its folder is
    meant.
    """
    folder = source if source.is_dir() else source.parent
    if not path.is_relative_to(folder):
        return None
    for name in path.relative_to(folder).parts[:-1]:
        if name.lower() in SPLIT_NAMES:
            return SPLIT_NAMES[name.lower()]
    return None


class MapToWrite(NamedTuple):
    """A map of a dataset that is exported to files of its own.

    Attributes:
        stem: path without an ending, ``<target>/<split>/map<i>``.
        grid: (H, W) uint8, 0 free and 1 occupied.
        seed_points: (n, 2) int64.
    """

    stem: Path
    grid: Bytes
    seed_points: Ints


def maps_to_write(target: Path, root: Root, progress: bool) -> Iterator[MapToWrite]:
    """Yield all maps of a dataset; the folder of each is created."""
    for labels in root.labels(progress=progress):
        maps = labels.maps
        for k, grid in enumerate(maps.occupancy):
            folder = target / SPLITS[maps.split[k]]
            folder.mkdir(parents=True, exist_ok=True)
            seed_points = maps.seed_points[k, : maps.rooms[k]]
            yield MapToWrite(folder / f"map{maps.index[k]}", grid, seed_points)


def write_picture(path: Path, picture: Image.Image) -> None:
    """Write a picture, in the file format that the ending of ``path`` names.

    Pillow writes into memory: on a full disk its own writing raises errors without a reason.

    Raises:
        OSError: the disk is full or may not be written to.
    """
    content = BytesIO()
    picture.save(content, format=Image.registered_extensions()[path.suffix.lower()])
    path.write_bytes(content.getvalue())


def to_occupancy(
    values: Array, label: str, threshold: float | None = None, *, is_own: bool = True
) -> Bytes:
    """Return an array of 0 and 1, bool, or probabilities in [0, 1] as uint8 of 0 and 1.

    Args:
        values: any shape.
        label: names the array in errors.
        threshold: probabilities above it become 1; None accepts only 0 and 1.
        is_own: the array is the user's own, not one of a published format, so that an error says
            what it seems to be and how to make a grid of it.

    Raises:
        FormatError: NaN, or another value.
    """
    low, high = (values.min(), values.max()) if values.size else (0, 0)
    # With NaN every comparison is false, so this form of the test refuses it.
    is_in_range = 0 <= low <= high <= 1
    if is_in_range and values.dtype.kind in "biu":
        return values.astype(np.uint8, copy=False)  # no copy: an array may be very large
    occupied = values > (0.5 if threshold is None else threshold)
    complaint = ""
    if not is_in_range:
        complaint = f"holds values from {low} to {high}, expected 0 to 1"
    elif threshold is None and not np.array_equal(occupied, values):
        complaint = "holds values between 0 and 1, expected only 0 and 1"
    if complaint:
        raise FormatError(f"{label}: {complaint}{hint_on_values(values) if is_own else ''}")
    return occupied.view(np.uint8)


def check_grids(array: StoredArray, limits: Limits, threshold: float | None = None) -> None:
    """Check a whole array before any of its grids is used, so that a damaged file gives no map.

    Only one grid at a time is in memory.

    Args:
        array: (H, W), (N, H, W) or (N, 1, H, W).
        limits: of the cells of a grid and of the number of grids.
        threshold: that of `to_occupancy`.

    Raises:
        FormatError: another shape, more than the limits allow, bad numbers, or damage.
    """
    shape = array.shape
    has_channel = len(shape) == 4 and shape[1] == 1
    if not (len(shape) in (2, 3) or has_channel) or 0 in shape:
        hint = ""
        if shape[-1:] in ((3,), (4,)):
            hint = "; it looks like pictures of colours: values[..., :3].mean(axis=-1) < 128"
        elif len(shape) == 1:
            hint = "; values.reshape(rows, columns) makes a grid of it"
        raise FormatError(
            f"{array.label}: has shape {shape}, expected (H, W), (N, H, W) or (N, 1, H, W){hint}"
        )
    count = 1 if len(shape) == 2 else shape[0]
    rows, columns = shape[-2:]
    check_pixels(array.label, rows, columns, limits)
    if count > limits.maps:
        raise FormatError(f"{array.label}: has {count} maps, expected at most {limits.maps}")
    for _ in read_grids(array, threshold):
        pass  # reading a grid checks it


def read_grids(array: StoredArray, threshold: float | None = None) -> Iterator[Bytes]:
    """Yield the grids of an array, (H, W) uint8, reading one at a time.

    Args:
        array: of a shape that `check_grids` accepts.
        threshold: that of `to_occupancy`.

    Raises:
        FormatError: bad numbers, or a damaged file.
    """
    is_own = threshold is not None  # a published format has 0 and 1 alone
    if len(array.shape) == 2:
        yield to_occupancy(array.read(), array.label, threshold, is_own=is_own)
        return

    def grid_of(entry: Array, number: int) -> Bytes:
        label = f"{array.label}: map {number}"
        grid = to_occupancy(entry, label, threshold, is_own=is_own)
        return grid.reshape(grid.shape[-2:])

    # Unlike a loop, `map` keeps no entry while the next one is read.
    yield from map(grid_of, array.entries(), itertools.count())


def marked_cell(mask: Array) -> Cell | None:
    """Return the only cell (row, col) that is not 0 in a mask, (H, W), if the mask is 1 there.

    None if the mask marks no cell, several cells, or one by another number.
    """
    # A mask of a stranger may mark all cells, so they are counted before they are listed.
    if np.count_nonzero(mask) != 1:
        return None
    row, column = divmod(int(np.argmax(mask != 0)), mask.shape[1])
    return (row, column) if mask[row, column] == 1 else None


def percent(share: float) -> str:
    """Return a share of a whole as text, which says 0 or 100 % only of exactly that.

    >>> percent(0.0), percent(1e-6), percent(0.75), percent(1 - 1e-6)
    ('0.0%', 'less than 0.1%', '75.0%', 'more than 99.9%')
    """
    text = f"{share:.1%}"
    if text == "0.0%" and share > 0:
        return "less than 0.1%"
    if text == "100.0%" and share < 1:
        return "more than 99.9%"
    return text


def sampling_step(total: int, count: int) -> int:
    """Return the smallest k such that every k-th of ``total`` problems are at most ``count``.

    Raises:
        ValueError: ``count`` is not at least 1.
    """
    return math.ceil(total / check_count("count", count))


def joint_name(name: str, numbers: list[int]) -> str:
    """Return a name for several maps of a file that are left out for the same reason.

    >>> joint_name("a.npz: train", [3, 5, 8])
    'a.npz: train 3 and 2 others'
    """
    first, *later = numbers
    if not later:
        return f"{name} {first}"
    noun = "other" if len(later) == 1 else "others"
    return f"{name} {first} and {len(later)} {noun}"


def files_with_endings(
    source: Path, endings: tuple[str, ...], limits: Limits, collection: Collection
) -> Iterator[Path]:
    """Yield ``source`` if it is a file, else the files below it with one of these endings.

    Files that `files_below` refuses are added to what ``collection`` leaves out.

    Raises:
        FormatError: no such file or folder, or more than ``limits.files`` files.
    """
    if not source.exists():
        raise FormatError(f"{source}: no such file or folder{_target_of_link(source)}")
    paths = [source]
    if source.is_dir():
        paths = files_below(source, endings, limits, collection)
    with bar(limits.progress and len(paths) > 1, len(paths), unit=" files") as advance:
        for path in paths:
            yield path
            advance(1)
