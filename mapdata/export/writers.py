"""What receives the problems of an export, batch by batch: arrays, or the layout of others."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mapdata.arrays import Array, Ints
from mapdata.datasets.field_kernels import PADDING
from mapdata.export.growing_array import GrowingArray
from mapdata.export.layouts import Columns, Layout, LayoutArray
from mapdata.limits import Size
from mapdata.movement import Movement


class Writer(Protocol):
    """What an export needs of a file format."""

    def write(self, split: str, columns: Columns) -> None:
        """Write the fields of the next B problems of a split."""

    def finish(self, counts: dict[str, int], map_size: Size) -> dict[str, Any]:
        """Complete all files; return what each holds, by its name, as plain values for JSON."""

    def abort(self) -> None:
        """Close all files after an error, and raise none; the folder is about to be removed."""


class ArrayWriter:
    """Writes ``SPLIT/FIELD.npy``, one file for each split and field.

    ``path`` has another length for each problem. With a ``max_length`` it is one array (N,
    max_length, 2) padded with -1. Without, it is two: ``path_cells.npy`` (all cells, 2), and
    ``path_offsets.npy`` (N + 1,), so that path i is ``path_cells[path_offsets[i] :
    path_offsets[i + 1]]``.
    """

    def __init__(self, folder: Path, max_length: int | None) -> None:
        """Write below ``folder``, which exists."""
        self._folder = folder
        self._max_length = max_length
        self._arrays: dict[str, GrowingArray] = {}

    def write(self, split: str, columns: Columns) -> None:
        """Write the fields of the next B problems of a split."""
        for name, rows in columns.items():
            if name == "path" and self._max_length is None:
                self._write_paths(split, rows)
            else:
                self._append(f"{split}/{name}.npy", rows)

    def finish(self, counts: dict[str, int], map_size: Size) -> dict[str, Any]:
        """Complete all files; return dtype, shape and checksum of each, by its name."""
        for array in self._arrays.values():
            array.close()
        return {name: array.describe() for name, array in self._arrays.items()}

    def abort(self) -> None:
        """Close all files after an error."""
        for array in self._arrays.values():
            array.abort()

    def _write_paths(self, split: str, path: Ints) -> None:
        """Write paths (B, T, 2) as their cells and the offsets at which each begins."""
        cells, lengths = unpadded(path)
        offsets_name = f"{split}/path_offsets.npy"
        first_cell = 0
        if offsets_name in self._arrays:
            first_cell = self._arrays[f"{split}/path_cells.npy"].rows
        else:
            self._append(offsets_name, np.zeros(1, np.int64))
        self._append(offsets_name, first_cell + np.cumsum(lengths))
        self._append(f"{split}/path_cells.npy", cells)

    def _append(self, name: str, rows: Array) -> None:
        if name not in self._arrays:
            self._arrays[name] = GrowingArray(self._folder / name, rows.dtype, rows.shape[1:])
        self._arrays[name].append(rows)


class LayoutWriter:
    """Writes the arrays of a `Layout`."""

    def __init__(self, folder: Path, layout: Layout, movement: Movement) -> None:
        """Write below ``folder``, which exists, problems of this ``movement``."""
        self._folder = folder
        self._layout = layout
        self._movement = movement
        self._arrays: dict[str, GrowingArray] = {}

    def write(self, split: str, columns: Columns) -> None:
        """Write the fields of the next B problems of a split.

        Raises:
            ValueError: problems that the layout cannot hold.
        """
        if self._layout.check is not None:
            self._layout.check(columns, self._movement)
        with self._naming_the_archive():
            for array in self._layout.arrays:
                rows = array.rows(columns, self._movement)
                name = self._file_name(split, array)
                if name not in self._arrays:
                    file = self._folder / name
                    self._arrays[name] = GrowingArray(file, np.dtype(array.dtype), rows.shape[1:])
                self._arrays[name].append(rows)

    def finish(self, counts: dict[str, int], map_size: Size) -> dict[str, Any]:
        """Complete all files; return dtype, shape and checksum of each, by its name."""
        with self._naming_the_archive():
            for array in self._arrays.values():
                array.close()
            if self._layout.archive:
                return self._pack()
        if self._layout.write_index is not None:
            for split, count in counts.items():
                folder = self._folder / self._layout.splits[split]
                self._layout.write_index(folder, count, map_size)
        return {name: array.describe() for name, array in self._arrays.items()}

    def abort(self) -> None:
        """Close all files after an error."""
        for array in self._arrays.values():
            array.abort()

    @contextmanager
    def _naming_the_archive(self) -> Iterator[None]:
        """Let errors of the files that go into an archive name the archive."""
        try:
            yield
        except OSError as error:
            if not self._layout.archive:
                raise
            archive = str(self._folder / self._layout.archive)
            raise OSError(error.errno, error.strerror, archive) from None

    def _file_name(self, split: str, array: LayoutArray) -> str:
        """Return the name of the file of an array of a split, below the folder."""
        layout = self._layout
        return layout.file_name.format(split=layout.splits[split], array=array.name)

    def _pack(self) -> dict[str, Any]:
        """Move the arrays into one archive, as numpy.savez_compressed numbers them."""
        descriptions = {}
        archive_file = self._folder / self._layout.archive
        # The fastest compression: pictures of a few numbers shrink to a hundredth even so.
        with zipfile.ZipFile(archive_file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            number = 0
            for split in self._layout.splits.values():
                for array in self._layout.arrays:
                    name = f"{split}/{array.name}.npy"
                    # A member that is opened by its name has a fixed date: equal problems give
                    # equal bytes.
                    _copy_into(archive, f"arr_{number}.npy", self._folder / name)
                    description = self._arrays[name].describe()
                    descriptions[f"{self._layout.archive}/arr_{number}"] = {
                        "name": f"{split} {array.name}",
                        **description,
                    }
                    number += 1
        for split in self._layout.splits.values():
            for array in self._layout.arrays:
                (self._folder / split / f"{array.name}.npy").unlink()
            (self._folder / split).rmdir()
        return descriptions


def unpadded(path: Ints) -> tuple[Ints, Ints]:
    """Return the cells of paths (B, T, 2) one after another, and the (B,) length of each."""
    is_cell = path[:, :, 0] != PADDING
    return path[is_cell], is_cell.sum(axis=1)


def _copy_into(archive: zipfile.ZipFile, member: str, file: Path) -> None:
    """Copy a file into an archive, a megabyte at a time."""
    with file.open("rb") as source, archive.open(member, "w", force_zip64=True) as target:
        while block := source.read(2**20):
            target.write(block)
