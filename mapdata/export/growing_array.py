"""`GrowingArray`: an .npy file that is written in parts, before its number of rows is known."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from pathlib import Path
from typing import IO

import numpy as np
from numpy.lib import format as npy_format

from mapdata.arrays import Array


class GrowingArray:
    """An .npy file to which blocks of rows are appended; memory holds one block at a time.

    The header comes first in the file and states the number of rows, which is known last. numpy
    pads the header so that the number can grow in place: the header of 0 rows, written first, and
    that of all rows, written by `close`, have the same length.

    Attributes:
        file: name of the file; it is complete once `close` returned.
        rows: number of rows so far.
        dtype: type of the numbers.
        row_shape: shape of a row.
    """

    def __init__(self, file: Path, dtype: np.dtype, row_shape: tuple[int, ...]) -> None:
        """Create the file, with a header that states no rows.

        Raises:
            OSError: the file cannot be created.
        """
        self.file = file
        self.rows = 0
        # Files are little-endian on every machine, so that equal problems give equal bytes.
        self.dtype = np.dtype(dtype).newbyteorder("<")
        self.row_shape = row_shape
        self._digest = hashlib.sha256()
        file.parent.mkdir(parents=True, exist_ok=True)
        self._stream: IO[bytes] = open(file, "wb")  # noqa: SIM115  (`close` closes it)
        try:
            self._header_bytes = self._write_header()
        except BaseException:
            self.abort()
            raise

    def append(self, rows: Array) -> None:
        """Append n rows, (n, ...); their numbers are cast to the type of the file.

        Raises:
            ValueError: the rows have another shape.
            OSError: the disk is full.
        """
        if rows.shape[1:] != self.row_shape:
            raise ValueError(
                f"{self.file.name}: got rows of shape {rows.shape[1:]}, expected {self.row_shape}"
            )
        block = np.ascontiguousarray(rows, self.dtype)
        self._stream.write(block.data)
        self._digest.update(block.data)
        self.rows += len(block)

    def close(self) -> None:
        """Write the number of rows into the header and close the file.

        Raises:
            OSError: the disk is full.
        """
        self._stream.seek(0)
        header_bytes = self._write_header()
        assert header_bytes == self._header_bytes, "numpy's header did not leave room to grow"
        self._stream.close()

    def abort(self) -> None:
        """Close the file as it is, with a header that states no rows; no error is raised."""
        with suppress(OSError):  # What is left in memory may not fit on the disk.
            self._stream.close()

    def describe(self) -> dict[str, object]:
        """Return dtype, shape and the SHA-256 of the numbers, as plain values for JSON."""
        return {
            "dtype": self.dtype.name,
            "shape": [self.rows, *self.row_shape],
            "sha256": self._digest.hexdigest(),
        }

    def _write_header(self) -> int:
        """Write the header at the current position; return its length in bytes."""
        header = {
            "descr": npy_format.dtype_to_descr(self.dtype),
            "fortran_order": False,
            "shape": (self.rows, *self.row_shape),
        }
        npy_format.write_array_header_1_0(self._stream, header)
        return self._stream.tell()
