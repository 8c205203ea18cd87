"""Reading .npy and .npz files from unknown sources, with limits on what they unpack to.

A .npz file is a zip archive of .npy files. The directory of an archive and the header of an array
may claim anything, and a few kilobytes can unpack to many gigabytes. So headers are checked before
any array is unpacked: the size of an array is limited and must be the size that its header implies.
Pickled objects are never opened, and the entries of an array can be read one at a time.

Sources: https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html and
https://docs.python.org/3/library/zipfile.html.
"""

from __future__ import annotations

import hashlib
import io
import os
import re
import zipfile
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.lib.format import read_array_header_1_0, read_array_header_2_0, read_magic

from mapdata.arrays import Array
from mapdata.hints import hint_on_content

MAX_BYTES = 2**30
"""The default limit of what an archive unpacks to, in bytes, for the arrays that are read."""

_MAX_READ = 2**20
"""The largest piece of a file that is read in one call, in bytes; also limits zip directories."""

_MAX_HEADER = 2**14
"""The largest header of an array, in bytes; NumPy's own limit of its text is 10,000."""

_MAX_MEMBERS = 1000
"""The most arrays in an archive."""

_MAX_FORTRAN = 2**27
"""The largest array in Fortran order, in bytes: its entries cannot be read one at a time."""


class FormatError(ValueError):
    """A foreign file that cannot be used; one line names the file and what is wrong with it."""

    def __init__(self, message: str) -> None:
        """Keep ``message``, which may quote the error of a library, on one line."""
        super().__init__(re.sub(r"\s*\n\s*", " ", message.strip()))


@contextmanager
def refusing(message: str) -> Iterator[None]:
    """Turn any error of a library into a `FormatError` of ``message`` and the cause.

    All exceptions are caught, because the errors that zipfile, Pillow's decoders and numpy's parser
    of headers raise on damaged files are not documented: zlib.error, struct.error, SyntaxError,
    EOFError and more.
    """
    try:
        yield
    except FormatError:
        raise
    except Exception as error:
        raise FormatError(f"{message} ({type(error).__name__}: {error})") from None


class _Header(NamedTuple):
    """The header of an .npy file.

    Attributes:
        shape: of the array.
        is_fortran: whether the array is stored in Fortran order, the first axis varying fastest.
        dtype: of the array.
        size: of the header itself, in bytes.
    """

    shape: tuple[int, ...]
    is_fortran: bool
    dtype: np.dtype[Any]
    size: int


def _read_header(file: IO[bytes]) -> _Header:
    """Return the header at the start of ``file``, whose position is undefined afterwards.

    Raises:
        Exception: any error of NumPy if the header is damaged.
    """
    # NumPy reads as many bytes as the header claims to have before it checks their number, so it
    # gets a copy of limited length.
    start = io.BytesIO(file.read(_MAX_HEADER))
    is_first_version = read_magic(start) == (1, 0)
    parse = read_array_header_1_0 if is_first_version else read_array_header_2_0
    shape, is_fortran, dtype = parse(start)
    return _Header(shape, is_fortran, dtype, start.tell())


@dataclass(frozen=True)
class StoredArray:
    """An array of numbers in a file, of which only the header has been read.

    Attributes:
        label: name of the file, and of the array in it, for error messages.
        shape: of the array.
        dtype: of the array: bool, integers or floats of at most 8 bytes.
        is_fortran: whether the array is stored in Fortran order, the first axis varying fastest.
        offset: bytes of the header before the numbers.
        path: the file.
        member: name of the array in an archive, None in an .npy file.
    """

    label: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    is_fortran: bool
    offset: int
    path: Path
    member: str | None = None

    @property
    def nbytes(self) -> int:
        """The size of the numbers, in bytes."""
        return prod(self.shape) * self.dtype.itemsize

    def __len__(self) -> int:
        """Return the length of the first axis."""
        return self.shape[0]

    def read(self) -> Array:
        """Return the whole array.

        Raises:
            FormatError: it is damaged, or cannot be read.
        """
        with refusing(f"{self.label}: damaged"), self._opened() as file:
            numbers = self._numbers(file, prod(self.shape))
            return numbers.reshape(self.shape, order="F" if self.is_fortran else "C")

    def entries(self, axes: int = 1) -> Iterator[Array]:
        """Yield ``array[0]``, ``array[1]``, ..., reading one at a time.

        A loop over them holds two at once, since its variable keeps the last one while the next one
        is read; ``map(function, array.entries())`` holds one.

        An array in Fortran order is read whole. An array without numbers has no entries, however
        long its first axis is.

        Args:
            axes: number of the first axes that the entries lie along; with 2 they are
                ``array[0, 0]``, ``array[0, 1]``, ...

        Raises:
            FormatError: as `read`; more than 128 MiB in Fortran order.
        """
        outer_shape = self.shape[:axes]
        shape = self.shape[axes:]
        if self.is_fortran and len(self.shape) > 1:
            if self.nbytes > _MAX_FORTRAN:
                raise FormatError(
                    f"{self.label}: has {self.nbytes} bytes in Fortran order, expected at most "
                    f"{_MAX_FORTRAN}: save it with numpy.ascontiguousarray"
                )
            array = self.read()
            yield from (array[index] for index in np.ndindex(outer_shape))
            return
        with refusing(f"{self.label}: damaged"), self._opened() as file:
            if self.nbytes == 0:
                return
            for _ in range(prod(outer_shape)):
                yield self._numbers(file, prod(shape)).reshape(shape)

    def sha256(self) -> str:
        """Return the SHA-256 of the numbers as they are stored, as 64 hexadecimal digits.

        Raises:
            FormatError: the array is damaged, or cannot be read.
        """
        digest = hashlib.sha256()
        with refusing(f"{self.label}: damaged"), self._opened() as file:
            while piece := file.read(_MAX_READ):
                digest.update(piece)
        return digest.hexdigest()

    def check(self) -> None:
        """Read the whole array and keep nothing, to detect damage before any entry is used.

        Raises:
            FormatError: as `entries`.
        """
        deque(self.entries(), maxlen=0)  # keeps no entry while the next one is read

    @contextmanager
    def _opened(self) -> Iterator[IO[bytes]]:
        """Yield the opened file at the position of the first number."""
        if self.member is None:
            with open(self.path, "rb") as file:
                file.seek(self.offset)
                yield file
        else:
            with _opened_archive(self.path) as archive, archive.open(self.member) as member:
                member.read(self.offset)
                yield member

    def _numbers(self, file: IO[bytes], count: int) -> Array:
        """Return the next ``count`` numbers, (count,)."""
        numbers = np.empty(count, self.dtype)
        buffer = numbers.view(np.uint8).data
        position = 0
        while position < len(buffer):
            # zipfile unpacks only as many bytes as it is asked for, so memory stays small.
            piece = file.read(min(_MAX_READ, len(buffer) - position))
            if not piece:
                raise FormatError(f"{self.label}: damaged (it ends early)")
            buffer[position : position + len(piece)] = piece
            position += len(piece)
        return numbers


class Npz:
    """An .npz archive whose arrays are unread, except for their headers.

    Attributes:
        path: the file.
        shapes: shape of each array, by name.
        members: name of each file in the archive; that of an array ends with ".npy".
    """

    def __init__(self, path: Path, max_bytes: int = MAX_BYTES) -> None:
        """Read the directory of the archive and the header of each array; unpack nothing else.

        Args:
            path: the file.
            max_bytes: the limit of what the arrays that are read unpack to, all together.

        Raises:
            FormatError: no such file, or not a sound archive of up to 1,000 arrays.
        """
        self.path = path
        self._max_bytes = max_bytes
        self._headers: dict[str, _Header] = {}
        self._sizes: dict[str, int] = {}
        if not path.is_file():
            raise FormatError(f"{path}: no such file")
        with refusing(f"{path}: not a sound .npz file"), open(path, "rb") as file:
            _check_start(path, file, b"PK", ".npz")
        with refusing(f"{path}: not a sound .npz file"), _opened_archive(path) as archive:
            self.members = archive.namelist()
            members = [member for member in archive.infolist() if member.filename[-4:] == ".npy"]
            if not 1 <= len(members) <= _MAX_MEMBERS:
                raise FormatError(
                    f"{path}: holds {len(members)} arrays, expected 1 to {_MAX_MEMBERS}"
                )
            for member in members:
                name = member.filename[:-4]
                # zipfile unpacks data of other compression methods only as a whole.
                if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                    raise FormatError(
                        f"{path}: array {name!r} is compressed by method {member.compress_type}, "
                        "expected stored or deflated, as NumPy writes them"
                    )
                with archive.open(member) as file:
                    self._headers[name] = _read_header(file)
                self._sizes[name] = member.file_size
        self.shapes = {name: header.shape for name, header in self._headers.items()}

    def require(self, *names: str) -> None:
        """Refuse an archive without arrays of these names.

        Raises:
            FormatError: one is missing; the message lists those that are there.
        """
        for name in names:
            if name not in self.shapes:
                raise FormatError(
                    f"{self.path}: holds no array {name!r}, but {', '.join(self.shapes)}"
                )

    def arrays(self, *names: str) -> list[StoredArray]:
        """Return the arrays of these names, unread.

        All arrays that are read from the archive must be named in one call, because the limit
        ``max_bytes`` applies to the arrays of a call.

        Raises:
            FormatError: an array is missing, holds no numbers, or has another size than its header
                says; the arrays together are larger than ``max_bytes``.
        """
        self.require(*names)
        arrays = [self._array(name) for name in names]
        size = sum(array.nbytes for array in arrays)
        if size > self._max_bytes:
            raise FormatError(
                f"{self.path}: {', '.join(names)} unpack to {size} bytes, expected at most "
                f"{self._max_bytes}"
            )
        return arrays

    def text(self, name: str, max_length: int = 2**16) -> str:
        """Return a text that was saved as an array of shape ().

        Raises:
            FormatError: there is none, it is longer than ``max_length``, or it is damaged.
        """
        self.require(name)
        header = self._headers[name]
        label = self._label(name)
        length = header.dtype.itemsize // 4  # NumPy stores a letter as a code of 4 bytes
        if header.dtype.kind != "U" or header.shape != () or length > max_length:
            raise FormatError(
                f"{label}: holds {header.dtype} of shape {header.shape}, expected a text of at "
                f"most {max_length} letters"
            )
        # The checksum of a member is compared only where it is read to its end. So the text has to
        # fill it, as arrays do.
        code_dtype = np.dtype(np.uint32).newbyteorder(header.dtype.byteorder)
        codes = _checked_array(
            header=_Header((length,), is_fortran=False, dtype=code_dtype, size=header.size),
            label=label,
            size=self._sizes[name],
            path=self.path,
            member=f"{name}.npy",
        )
        if length == 0:
            return ""
        with refusing(f"{label}: damaged"):
            return str(codes.read().view(header.dtype)[0])

    def _label(self, name: str) -> str:
        """Return the name of the file and of one of its arrays, for error messages."""
        return f"{self.path}: array {name!r}"

    def _array(self, name: str) -> StoredArray:
        """Return one array, unread."""
        return _checked_array(
            header=self._headers[name],
            label=self._label(name),
            size=self._sizes[name],
            path=self.path,
            member=f"{name}.npy",
        )


def _check_start(path: Path, file: IO[bytes], first_bytes: bytes, kind: str) -> None:
    """Refuse a file of another kind than its name says, if its first bytes tell which.

    Args:
        path: of the file.
        file: opened at its start, where it is afterwards too.
        first_bytes: those of a file of the kind.
        kind: its ending, for the message.

    Raises:
        FormatError: it is of another kind that `hint_on_content` knows.
    """
    start = file.read(64)
    file.seek(0)
    hint = "" if start.startswith(first_bytes) else hint_on_content(start)
    if hint:
        raise FormatError(f"{path}: not a sound {kind} file{hint}")


def open_npy(path: Path) -> StoredArray:
    """Return the array of an .npy file, unread.

    Raises:
        FormatError: no such file, or not a sound one; it holds no numbers.
    """
    if not path.is_file():
        raise FormatError(f"{path}: no such file")
    with refusing(f"{path}: not a sound .npy file"), open(path, "rb") as file:
        _check_start(path, file, b"\x93NUMPY", ".npy")
        header = _read_header(file)
        size = file.seek(0, io.SEEK_END)
    return _checked_array(header, label=str(path), size=size, path=path)


def _checked_array(
    header: _Header, label: str, size: int, path: Path, member: str | None = None
) -> StoredArray:
    """Return an array, unread, after checking that its header allows that.

    Args:
        header: of the array.
        label: name of the array for error messages.
        size: of the header and the numbers together, in bytes.
        path: the file.
        member: name of the array in an archive, None in an .npy file.

    Raises:
        FormatError: it holds no numbers, or does not have the size that its header implies.
    """
    dtype = header.dtype
    if dtype.hasobject:
        raise FormatError(f"{label}: holds pickled objects, expected numbers; they are not opened")
    if dtype.kind not in "biuf" or dtype.itemsize > 8:
        raise FormatError(f"{label}: holds {dtype}, expected numbers of at most 8 bytes")
    array = StoredArray(
        label=label,
        shape=header.shape,
        dtype=dtype,
        is_fortran=header.is_fortran,
        offset=header.size,
        path=path,
        member=member,
    )
    if min(array.shape, default=0) < 0 or header.size + array.nbytes != size:
        raise FormatError(
            f"{label}: has {size} bytes, expected {header.size} for its header and those of "
            f"{dtype} in shape {array.shape}"
        )
    return array


class _ShortReads(io.FileIO):
    """A file that refuses long reads.

    It limits the directory of an archive, which zipfile reads in one call however long it is.
    """

    def read(self, size: int | None = -1) -> bytes:
        """Read ``size`` bytes, or up to the end of the file.

        Raises:
            ValueError: these are more than ``_MAX_READ`` bytes.
        """
        if size is None or size < 0:
            size = max(0, os.fstat(self.fileno()).st_size - self.tell())
        if size > _MAX_READ:
            raise ValueError(f"its directory has {size} bytes, expected at most {_MAX_READ}")
        return super().read(size)


@contextmanager
def _opened_archive(path: Path) -> Iterator[zipfile.ZipFile]:
    """Yield an opened zip archive whose directory has a limited size."""
    with _ShortReads(path) as file, zipfile.ZipFile(file) as archive:
        yield archive
