"""What all formats share: errors, limits, folders, and .npy and .npz arrays read without trust."""

from __future__ import annotations

import io
import os
import re
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib.format import read_array_header_1_0, read_array_header_2_0, read_magic

from mapdata.arrays import Array, Bytes, Ints
from mapdata.formats.collection import Collection
from mapdata.shards.root import Root
from mapdata.shards.workers import bar
from mapdata.spec import SPLITS


class FormatError(ValueError):
    """A foreign file that cannot be used; one line names the file and what is wrong with it."""

    def __init__(self, message: str) -> None:
        """Keep ``message`` on one line, whatever a library put into it."""
        super().__init__(re.sub(r"\s*\n\s*", " ", message.strip()))


@dataclass(frozen=True)
class Limits:
    """How an importer reads: what it unpacks at most, checked before it unpacks.

    Attributes:
        pixels: pixels of one image, cells of one map.
        unpacked: bytes of one file once unpacked.
        files: files looked at in a folder.
        progress: show a progress bar while many files, or a long one, are read.
    """

    pixels: int = 2**24
    unpacked: int = 2**30
    files: int = 2_000_000
    progress: bool = False


LIMITS = Limits()


@contextmanager
def refusing(message: str) -> Iterator[None]:
    """Turn whatever a library raises into a `FormatError` that says ``message`` and the cause.

    What zipfile, Pillow's decoders and numpy's parser of headers raise on damaged files is not
    documented: zlib.error, struct.error, SyntaxError, EOFError and more.
    """
    try:
        yield
    except FormatError:
        raise
    except Exception as error:
        raise FormatError(f"{message} ({type(error).__name__}: {error})") from None


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


# --- arrays -------------------------------------------------------------------------------------


class Npz:
    """An .npz archive that unpacks an array when it is asked for.

    Attributes:
        path: the file.
        shapes: shape of each array, by name.
    """

    def __init__(self, path: Path, limits: Limits = LIMITS) -> None:
        """Read the directory of the archive and the header of each array; unpack nothing.

        Raises:
            FormatError: not a sound archive, too large, or pickled arrays in it.
        """
        self.path = path
        self.shapes: dict[str, tuple[int, ...]] = {}
        if not path.is_file():
            raise FormatError(f"{path}: no such file")
        with refusing(f"{path}: not a sound .npz file"), zipfile.ZipFile(path) as archive:
            infos = [info for info in archive.infolist() if info.filename.endswith(".npy")]
            if not infos or len(infos) > 1000:
                raise FormatError(f"{path}: holds {len(infos)} arrays, expected 1 to 1000")
            for info in infos:
                name = info.filename[:-4]
                if info.file_size > limits.unpacked:
                    raise FormatError(
                        f"{path}: array {name!r} unpacks to {info.file_size} bytes, expected at "
                        f"most {limits.unpacked}"
                    )
                with archive.open(info) as member:
                    self.shapes[name], _, _ = _header(member)

    def __getitem__(self, name: str) -> Array:
        """Return one array.

        Raises:
            FormatError: there is none, or it is damaged.
        """
        if name not in self.shapes:
            raise FormatError(f"{self.path}: holds no array {name!r}, but {', '.join(self.shapes)}")
        with (
            refusing(f"{self.path}: not a sound .npz file"),
            zipfile.ZipFile(self.path) as archive,
            archive.open(f"{name}.npy") as member,
        ):
            size = archive.getinfo(f"{name}.npy").file_size
            return _array(member, size, f"{self.path}: array {name!r}")


def read_npy(path: Path, limits: Limits = LIMITS) -> Array:
    """Return the array of an .npy file.

    Raises:
        FormatError: not a sound file, too large, or pickled objects.
    """
    data = read_bytes(path, limits)
    return _array(io.BytesIO(data), len(data), str(path))


def _header(file: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Return what the header of an .npy says: shape, Fortran order and type."""
    is_first_version = read_magic(file) == (1, 0)
    return read_array_header_1_0(file) if is_first_version else read_array_header_2_0(file)


def _array(file: IO[bytes], size: int, what: str) -> Array:
    """Return the numbers of an .npy of ``size`` bytes, if it has as many as its header says."""
    with refusing(f"{what}: not an array of numbers, and pickled objects are never opened"):
        shape, fortran, dtype = _header(file)
        # no more than the archive states: without a number zipfile unpacks all that is there
        values = np.frombuffer(file.read(size), dtype)
        values = values.reshape(shape, order="F" if fortran else "C")
    if values.dtype.kind not in "biuf":
        raise FormatError(f"{what}: holds {values.dtype}, expected numbers")
    return values


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
