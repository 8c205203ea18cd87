"""What the tests of formats share: the command line, truth by scipy, files that lie."""

from __future__ import annotations

import io
import math
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from helpers.examples import examples
from mapdata.cli import main

SETTINGS = examples(40)
Bytes = npt.NDArray[np.uint8]

GRIDS = arrays.arrays(
    np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.integers(0, 1)
)


def cli(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Run ``mapdata`` in this process; return its exit code, output and errors.

    The errors are without progress bars.
    """
    code = 0
    try:
        main([str(argument) for argument in arguments])
    except SystemExit as stop:
        code = int(stop.code or 0)
    captured = capsys.readouterr()
    lines = [line.split("\r")[-1] for line in captured.err.split("\n")]
    errors = [line for line in lines if "maps/s]" not in line and "shards/s]" not in line]
    return code, captured.out, "\n".join(errors)


def lengths(
    grid: Bytes, source: tuple[int, int], *, cut: bool, diagonal: float
) -> npt.NDArray[np.float64]:
    """Return the cost of the shortest 8-connected path from ``source`` to every cell, by scipy.

    Cells without a path are inf.
    """
    rows, columns = grid.shape
    first = []
    second = []
    weights = []
    for row, column in np.argwhere(grid == 0).tolist():
        for down in (-1, 0, 1):
            for right in (-1, 0, 1):
                r = row + down
                c = column + right
                if (
                    (r, c) == (row, column)
                    or not (0 <= r < rows and 0 <= c < columns)
                    or grid[r, c]
                ):
                    continue
                oblique = down != 0 and right != 0
                if oblique and not cut and (grid[r, column] or grid[row, c]):
                    continue
                first.append(row * columns + column)
                second.append(r * columns + c)
                weights.append(diagonal if oblique else 1.0)
    graph = coo_matrix((weights, (first, second)), shape=(grid.size, grid.size)).tocsr()
    distances = dijkstra(graph, indices=source[0] * columns + source[1])
    return np.asarray(distances, float).reshape(rows, columns)


def npz(path: Path, **members: bytes) -> Path:
    """Write an archive of these members, compressed."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(f"{name}.npy", data)
    return path


def npy(shape: tuple[int, ...], data: bytes, dtype: str = "|u1") -> bytes:
    """Return an .npy that says this shape and type, whatever its data."""
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        head, {"descr": dtype, "fortran_order": False, "shape": shape}
    )
    return head.getvalue() + data


def png(rows: int, columns: int, body: bytes = b"", depth: int = 1) -> bytes:
    """Return a grey PNG that says this size; without ``body`` it is true, and all black."""
    row_bytes = 1 + math.ceil(columns * depth / 8)
    pixels = body or zlib.compress(bytes(row_bytes * rows), 9)
    header = struct.pack(">IIBBBBB", columns, rows, depth, 0, 0, 0, 0)
    out = b"\x89PNG\r\n\x1a\n"
    for kind, data in ((b"IHDR", header), (b"IDAT", pixels), (b"IEND", b"")):
        out += struct.pack(">I", len(data))
        out += kind + data
        out += struct.pack(">I", zlib.crc32(kind + data))
    return out
