"""A small sound source of each kind of foreign file, which tests link, spoil and change.

Nothing here imports `mapdata`: the files are as other programs write them.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from PIL import Image

GRID = np.array([[0, 0, 1, 1], [0, 1, 1, 0], [0, 0, 0, 0]], np.uint8)
"""The map of most sources; free cells lead from its upper left to its lower right corner."""


class Source(NamedTuple):
    """A source of maps.

    Attributes:
        format: that reads it.
        files: content by path below a folder; the first file is the one that a user names.
    """

    format: str
    files: dict[str, bytes]

    def write(self, folder: Path) -> Path:
        """Write all files below ``folder`` and return the path of the first one."""
        for name, data in self.files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        return folder / next(iter(self.files))


def npy_bytes(array: npt.ArrayLike) -> bytes:
    """Return an .npy file."""
    out = io.BytesIO()
    np.save(out, np.asarray(array))
    return out.getvalue()


def npz_bytes(*numbered: npt.ArrayLike, **named: npt.ArrayLike) -> bytes:
    """Return an .npz file of these arrays."""
    out = io.BytesIO()
    np.savez_compressed(out, *numbered, **named)  # type: ignore[arg-type]
    return out.getvalue()


def picture(file_format: str) -> bytes:
    """Return a picture of the grid: white is free."""
    out = io.BytesIO()
    Image.fromarray(255 * (1 - GRID)).save(out, file_format)
    return out.getvalue()


def one_hot(row: int, column: int) -> npt.NDArray[np.float64]:
    """Return an array (2, 1, 3, 4) of zeros and a 1 in this cell of both maps."""
    array = np.zeros((2, 1, *GRID.shape))
    array[:, 0, row, column] = 1
    return array


PGM = b"P5\n# c\n4 3\n255\n" + (255 * (1 - GRID)).tobytes()
YAML = (
    b"image: a.pgm\nresolution: 0.05\norigin: [0.0, 0.0, 0.0]\nnegate: 0\n"
    b"occupied_thresh: 0.65\nfree_thresh: 0.2\n"
)
MAP = b"type octile\nheight 3\nwidth 4\nmap\n..@@\n.S@W\n...G\n"
SCEN = b"version 1\n0\ta.map\t4\t3\t0\t0\t3\t2\t4.41421356\n"
WEIGHTS = np.full((2, 3, 4), 0.8)
"""All weights are a whole multiple of 0.1, as in the Warcraft sets."""
TILES = {
    "maps": np.zeros((3, 3, 4, 3), np.uint8),
    "costs": np.full((3, 3, 4), 0.8),
    "targets": np.zeros((3, 2, 2), np.int64),
    "sources": np.ones((3, 2, 1, 2), np.int64),
    "paths": np.tile(np.eye(3, 4), (3, 2, 1, 1, 1)),
}
"""Three maps, each with two targets and one source of each."""
DISTANCES = -np.array([[0, 1, 12, 12], [1, 12, 12, 4], [2, 2, 3, 4]], np.float64)
"""The costs to the upper left corner, below 0, where diagonal moves cost 1."""
PLANNING = (
    1.0 - np.stack([GRID, GRID]),
    one_hot(0, 0),
    np.zeros((2, 8, 1, 3, 4)),
    np.stack([DISTANCES, DISTANCES])[:, None],
)
"""Free cells, goal, policy and distances of the two maps of a split."""

SOURCES = {
    "png": Source("images", {"a.png": picture("png")}),
    "bmp": Source("images", {"a.bmp": picture("bmp")}),
    "jpeg": Source("images", {"a.jpg": picture("jpeg")}),
    "webp": Source("images", {"a.webp": picture("webp")}),
    "tiff": Source("images", {"a.tif": picture("tiff")}),
    "gif": Source("images", {"a.gif": picture("gif")}),
    "pgm": Source("images", {"a.pgm": PGM}),
    "P2": Source(
        "images",
        {"a.pgm": b"P2\n4 3\n255\n" + b" ".join(b"%d" % value for value in (255 * GRID).flat)},
    ),
    "npy": Source("images", {"a.npy": npy_bytes(GRID)}),
    "npz": Source("images", {"a.npz": npz_bytes(maps=GRID)}),
    "table": Source("text", {"a.csv": b"1,1,1\n1,0,0\n\n0,1\n0,0\n"}),
    "letters": Source("text", {"a.txt": b"####\n#S.#\n# G#\n####\n"}),
    "yaml": Source("ros", {"a.yaml": YAML, "a.pgm": PGM}),
    "map": Source("movingai", {"a.map": MAP}),
    "scen": Source("movingai", {"a.scen": SCEN, "a.map": MAP}),
    "planning": Source("planning-datasets", {"p.npz": npz_bytes(*3 * PLANNING)}),
    "tiles": Source("tilebased", {"train.npz": npz_bytes(**TILES)}),
    "warcraft": Source(
        "warcraft",
        {
            "train_vertex_weights.npy": npy_bytes(WEIGHTS.astype(np.float16)),
            "train_shortest_paths.npy": npy_bytes(np.tile(np.eye(3, 4, dtype=np.uint8), (2, 1, 1))),
            "train_maps.npy": npy_bytes(np.zeros((2, 3, 4, 3), np.uint8)),
        },
    ),
    "transpath": Source(
        "transpath",
        {
            "maps.npy": npy_bytes(np.stack([GRID, GRID])[:, None]),
            "starts.npy": npy_bytes(one_hot(0, 0)),
            "goals.npy": npy_bytes(one_hot(2, 3)),
        },
    ),
    "maze-hard": Source(
        "maze-hard", {"train.csv": b"source,question,answer,rating\nx,S  G,So G,2\n"}
    ),
}
"""One source of each kind, by the name of the kind."""
