"""Parquet files with a row for each problem, as Hugging Face ``datasets`` and its Hub read them.

Source of the layout: https://huggingface.co/docs/hub/datasets-file-names-and-splits; of the
features: https://huggingface.co/docs/datasets/about_dataset_features.
"""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mapdata.arrays import Array
from mapdata.datasets.field_kernels import PADDING
from mapdata.export.layouts import Columns
from mapdata.limits import Size
from mapdata.shards.files import file_hash

if TYPE_CHECKING:
    import pyarrow as pa

HUB_SPLITS = {"train": "train", "val": "validation", "test": "test"}
"""The Hub's names of the splits."""

_MAX_FILE_CELLS = 2**28
"""Cells of the maps of one file: 65,536 maps of 64 x 64 cells."""


class ParquetWriter:
    """Writes ``data/SPLIT-00000-of-00001.parquet``; a file has up to 2**28 cells of maps."""

    def __init__(self, folder: Path, counts: dict[str, int], map_size: Size) -> None:
        """Write below ``folder``, which exists.

        Args:
            folder: where the files go.
            counts: number of problems of each split.
            map_size: rows and columns of all maps.

        Raises:
            ValueError: pyarrow is not installed.
        """
        try:
            import pyarrow.parquet  # noqa: F401
        except ImportError:
            raise ValueError("format parquet needs pyarrow: pip install pyarrow") from None
        self._folder = folder / "data"
        self._folder.mkdir()
        self._counts = counts
        rows, columns = map_size
        self._rows_per_file = max(_MAX_FILE_CELLS // (rows * columns), 1)
        self._written = dict.fromkeys(counts, 0)
        self._file: Any = None
        self._names: list[str] = []

    def write(self, split: str, columns: Columns) -> None:
        """Write the fields of the next B problems of a split."""
        batch_size = len(next(iter(columns.values())))
        first = 0
        while first < batch_size:
            if self._written[split] % self._rows_per_file == 0:
                self._next_file(split, columns)
            room = self._rows_per_file - self._written[split] % self._rows_per_file
            last = min(first + room, batch_size)
            rows = {name: array[first:last] for name, array in columns.items()}
            self._file.write_table(table_of(rows))
            self._written[split] += last - first
            first = last

    def finish(self, counts: dict[str, int], map_size: Size) -> dict[str, Any]:
        """Complete all files; return the checksum of each, by its name."""
        self._close_file()
        return {f"data/{name}": {"sha256": file_hash(self._folder / name)} for name in self._names}

    def abort(self) -> None:
        """Close the file that is open; no error is raised."""
        with suppress(OSError):  # What is left in memory may not fit on the disk.
            self._close_file()

    def _close_file(self) -> None:
        """Complete the file that is open, if any."""
        if self._file is not None:
            file, self._file = self._file, None
            file.close()

    def _next_file(self, split: str, columns: Columns) -> None:
        """Open the next file of a split, with the schema of these columns."""
        from pyarrow import parquet

        self._close_file()
        number = self._written[split] // self._rows_per_file
        files = -(-self._counts[split] // self._rows_per_file)
        name = f"{HUB_SPLITS[split]}-{number:05d}-of-{files:05d}.parquet"
        schema = table_of({name: array[:0] for name, array in columns.items()}).schema
        self._file = parquet.ParquetWriter(self._folder / name, schema, compression="zstd")
        self._names.append(name)


def table_of(fields: Columns) -> pa.Table:
    """Return the Arrow table of B problems, whose metadata has the features for ``datasets``."""
    import pyarrow as pa

    arrays = []
    columns = []
    features = {}
    for name, rows in fields.items():
        squeezed = rows[:, 0] if rows.ndim == 4 and rows.shape[1] == 1 else rows
        array = _ragged_paths(rows) if name == "path" else _nested(squeezed)
        feature = _feature(name, squeezed)
        arrays.append(array)
        columns.append(pa.field(name, array.type, metadata=_extension(feature)))
        features[name] = feature
    metadata = {"huggingface": json.dumps({"info": {"features": features}})}
    return pa.Table.from_arrays(arrays, schema=pa.schema(columns, metadata))


def _extension(feature: dict[str, Any]) -> dict[str, str]:
    """Return the metadata by which Arrow finds the type of an array column in ``datasets``.

    Without it, ``datasets`` takes the column for nested lists, whatever the features say. Programs
    that do not know the type read nested lists.
    """
    if not feature["_type"].startswith("Array"):
        return {}
    return {
        "ARROW:extension:name": f"datasets.features.features.{feature['_type']}ExtensionType",
        "ARROW:extension:metadata": json.dumps([feature["shape"], feature["dtype"]]),
    }


def _nested(rows: Array) -> pa.Array:
    """Return an array (B, ...) as B numbers, or B nested lists."""
    import pyarrow as pa

    array = pa.array(np.ascontiguousarray(rows).reshape(-1))
    for axis in range(rows.ndim - 1, 0, -1):
        count = int(np.prod(rows.shape[:axis]))
        offsets = np.arange(count + 1, dtype=np.int32) * rows.shape[axis]
        array = pa.ListArray.from_arrays(offsets, array)
    return array


def _ragged_paths(path: Array) -> pa.Array:
    """Return paths (B, T, 2), padded with -1, as lists of cells without the padding."""
    import pyarrow as pa

    is_cell = path[:, :, 0] != PADDING
    cells = _nested(path[is_cell].astype(np.int32))
    offsets = np.concatenate([[0], np.cumsum(is_cell.sum(axis=1))]).astype(np.int32)
    return pa.ListArray.from_arrays(offsets, cells)


def _feature(name: str, rows: Array) -> dict[str, Any]:
    """Return the feature of a column in the words of ``datasets``."""
    if name == "path":
        return {"shape": [None, 2], "dtype": "int32", "_type": "Array2D"}
    dtype = rows.dtype.name
    if rows.ndim == 1:
        return {"dtype": dtype, "_type": "Value"}
    if rows.ndim == 2:
        element = {"dtype": dtype, "_type": "Value"}
        return {"feature": element, "length": rows.shape[1], "_type": "Sequence"}
    return {"shape": list(rows.shape[1:]), "dtype": dtype, "_type": f"Array{rows.ndim - 1}D"}
