"""What all formats share: the error, the limits, folders, and arrays in .npy and .npz read without
trust.
"""

from __future__ import annotations

import io
import os
import re
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]


class FormatError(ValueError):
    """A foreign file that cannot be used; the message names the file and what is wrong with it, on
    one line.
    """

    def __init__(self, message: str) -> None:
        """Keep ``message`` on one line, whatever a library put into it."""
        super().__init__(re.sub(r"\s*\n\s*", " ", message.strip()))


@dataclass(frozen=True)
class Limits:
    """What an importer unpacks at most, checked before it unpacks.

    Attributes:
        pixels: pixels of one image, cells of one map.
        unpacked: bytes of one file once unpacked.
        files: files looked at in a folder.
    """

    pixels: int = 2**24
    unpacked: int = 2**30
    files: int = 2_000_000


LIMITS = Limits()


def read_bytes(path: Path, limits: Limits = LIMITS) -> bytes:
    """Return the content of a file.

    Raises:
        FormatError: missing, not a plain file, or larger than ``limits.unpacked``.
    """
    try:
        if not path.is_file():
            raise FormatError(f"{path}: {'not a plain file' if path.exists() else 'no such file'}")
        size = path.stat().st_size
        if size > limits.unpacked:
            raise FormatError(f"{path}: has {size} bytes, expected at most {limits.unpacked}")
        return path.read_bytes()
    except (OSError, ValueError) as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(f"{path}: cannot be read ({error})") from None


def read_text(path: Path, limits: Limits = LIMITS) -> str:
    """Return the text of a file in UTF-8 (else Latin-1, as old benchmark files are), line ends as a
    line feed.

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


LeftOut = list[tuple[str, str]]
"""(name, why) of files that could not be used."""


def walk(
    folder: Path, endings: tuple[str, ...], limits: Limits = LIMITS, left_out: LeftOut | None = None
) -> list[Path]:
    """Return the files below ``folder`` with one of these endings (lower case), in natural order:
    map2 before map10.

    Hidden names and links to folders are passed over; links to files outside ``folder`` are added
    to ``left_out``.

    Raises:
        FormatError: more than ``limits.files`` files.
    """
    found, seen, inside = list[Path](), 0, folder.resolve()
    for here, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        seen += len(names)
        if seen > limits.files:
            raise FormatError(f"{folder}: holds more than {limits.files} files")
        for name in names:
            path = Path(here, name)
            if not name.lower().endswith(endings) or name.startswith("."):
                continue
            if path.is_symlink() and not Path(os.path.realpath(path)).is_relative_to(inside):
                (left_out if left_out is not None else []).append(
                    (str(path), "a link to outside the folder")
                )
            else:
                found.append(path)
    return sorted(found, key=lambda path: natural(str(path.relative_to(folder))))


def natural(text: str) -> list[tuple[int, str]]:
    """Return a key that sorts numbers inside names by their value."""
    parts = re.findall(r"\d+|\D+", text)
    return [
        (int(part), "") if part.isascii() and part.isdigit() and len(part) < 19 else (-1, part)
        for part in parts
    ]


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


def split_of(path: Path, folder: Path) -> int | None:
    """Return the split that the folders between ``folder`` and ``path`` say, or None."""
    parts = path.relative_to(folder).parts[:-1]
    return next((SPLIT_NAMES[part.lower()] for part in parts if part.lower() in SPLIT_NAMES), None)


def empty_target(target: Path) -> None:
    """Check that ``target`` can be written: missing, or an empty folder.

    Raises:
        FormatError: it is something else.
    """
    if target.exists() and not (target.is_dir() and not any(target.iterdir())):
        raise FormatError(f"{target}: exists already, expected a new name or an empty folder")


# --- arrays -------------------------------------------------------------------------------------


class Npz:
    """An .npz archive: names and shapes are known at once, an array is unpacked when asked for.

    Attributes:
        path: the file.
        shapes: shape of each array, by name.
    """

    def __init__(self, path: Path, limits: Limits = LIMITS) -> None:
        """Read the directory of the archive and the header of each array; unpack nothing.

        Raises:
            FormatError: not a sound archive, too large, or pickled arrays in it.
        """
        self.path, self._limits = path, limits
        self.shapes: dict[str, tuple[int, ...]] = {}
        if not path.is_file():
            raise FormatError(f"{path}: no such file")
        with _zip_errors(path), zipfile.ZipFile(path) as archive:
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
                    what = f"{path}: array {name!r}"
                    header = _header(member, info.file_size, what)  # type: ignore[arg-type]
                    self.shapes[name] = header[0]

    def __getitem__(self, name: str) -> Array:
        """Return one array.

        Raises:
            FormatError: there is none, or it is damaged.
        """
        if name not in self.shapes:
            raise FormatError(f"{self.path}: holds no array {name!r}, but {', '.join(self.shapes)}")
        with (
            _zip_errors(self.path),
            zipfile.ZipFile(self.path) as archive,
            archive.open(f"{name}.npy") as member,
        ):
            size = archive.getinfo(f"{name}.npy").file_size
            return _array(member, size, f"{self.path}: array {name!r}")  # type: ignore[arg-type]


@contextmanager
def _zip_errors(path: Path) -> Iterator[None]:
    """Turn what zipfile raises on damaged archives into a `FormatError`."""
    try:
        yield
    except FormatError:
        raise
    except Exception as error:
        # BadZipFile, zlib.error, EOFError, NotImplementedError, struct.error and more
        raise FormatError(
            f"{path}: not a sound .npz file ({type(error).__name__}: {error})"
        ) from None


def read_npy(path: Path, limits: Limits = LIMITS) -> Array:
    """Return the array of an .npy file.

    Raises:
        FormatError: not a sound file, too large, or pickled objects.
    """
    data = read_bytes(path, limits)
    return _array(io.BytesIO(data), len(data), str(path))


def _header(file: BinaryIO, size: int, what: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Return (shape, fortran order, type) of an array whose header and data have ``size`` bytes in
    all.
    """
    try:
        version = np.lib.format.read_magic(file)
        if version == (1, 0):
            shape, fortran, dtype = np.lib.format.read_array_header_1_0(
                file, max_header_size=10_000
            )
        else:
            shape, fortran, dtype = np.lib.format.read_array_header_2_0(
                file, max_header_size=10_000
            )
    except Exception as error:
        # numpy parses the header as Python text: what it raises is not documented
        raise FormatError(f"{what}: not an array ({type(error).__name__}: {error})") from None
    if dtype.hasobject or dtype.kind not in "biuf":
        raise FormatError(
            f"{what}: holds {dtype}, expected numbers (pickled objects are never opened)"
        )
    count = 1
    for side in shape:
        count *= side
    if min(shape, default=0) < 0 or count * dtype.itemsize + file.tell() != size:
        raise FormatError(f"{what}: says shape {shape} of {dtype}, but has {size} bytes")
    return shape, fortran, dtype


def _array(file: BinaryIO, size: int, what: str) -> Array:
    shape, fortran, dtype = _header(file, size, what)
    data = file.read(size - file.tell())
    if file.read(1):  # its archive states a smaller size than it has
        raise FormatError(f"{what}: has more than the {size} bytes that its archive states")
    values = np.frombuffer(data, dtype)
    return values.reshape(shape, order="F" if fortran else "C")


def occupancy(values: Array, what: str, threshold: float | None = None) -> npt.NDArray[np.uint8]:
    """Return an array of 0 and 1, bool, or probabilities in [0, 1] as uint8.

    Args:
        values: any shape.
        what: named in errors.
        threshold: probabilities above it are 1; None takes only 0 and 1.

    Raises:
        FormatError: NaN, or another value.
    """
    if values.dtype == np.bool_:
        return values.view(np.uint8)
    low, high = (values.min(), values.max()) if values.size else (0, 0)
    if not (low >= 0 and high <= 1):  # NaN fails too
        raise FormatError(f"{what}: holds values from {low} to {high}, expected 0 to 1")
    if values.dtype.kind in "iu":
        return values.astype(np.uint8, copy=False)  # a stack may be as large as the limits allow
    occupied = values > (0.5 if threshold is None else threshold)
    if threshold is None and not np.array_equal(occupied, values):
        raise FormatError(f"{what}: holds values between 0 and 1, expected only 0 and 1")
    return occupied.view(np.uint8)


def files_of(
    source: Path, endings: tuple[str, ...], limits: Limits, left_out: LeftOut
) -> Iterator[Path]:
    """Yield ``source`` itself if it is a file, else the files below it with one of these
    endings.
    """
    if source.is_dir():
        yield from walk(source, endings, limits, left_out)
    elif source.exists():
        yield source
    else:
        raise FormatError(f"{source}: no such file or folder")
