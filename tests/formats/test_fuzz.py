"""Bytes at random: every importer answers with maps or with one FormatError, whatever the file."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.examples import examples
from helpers.wild import SETTINGS
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from mapdata.formats import FormatError, Limits, read_any
from mapdata.formats.movingai import check_scen

GRID = np.array([[0, 0, 1, 1], [0, 1, 1, 0], [0, 0, 0, 0]], np.uint8)
LIMITS = Limits(pixels=2**12, unpacked=2**16)


def saved(file_format: str) -> bytes:
    """Return a picture or an array file of the grid."""
    out = io.BytesIO()
    if file_format == "npy":
        np.save(out, GRID)
    elif file_format == "npz":
        np.savez_compressed(out, maps=GRID)
    else:
        Image.fromarray(255 * (1 - GRID)).save(out, file_format)
    return out.getvalue()


@cache
def seed_points() -> dict[str, dict[str, bytes]]:
    """Return the files of a small good source of each kind; the first one is changed."""
    pgm = b"P5\n# c\n4 3\n255\n" + (255 * (1 - GRID)).tobytes()
    yaml = (
        b"image: a.pgm\nresolution: 0.05\norigin: [0.0, 0.0, 0.0]\nnegate: 0\n"
        b"occupied_thresh: 0.65\nfree_thresh: 0.2\n"
    )
    text = b"type octile\nheight 3\nwidth 4\nmap\n..@@\n.S@W\n...G\n"
    scen = b"version 1\n0\ta.map\t4\t3\t0\t0\t3\t2\t4.41421356\n"
    planning = io.BytesIO()
    goal = np.zeros((1, 1, 3, 4))
    actions = np.zeros((1, 8, 1, 3, 4))
    goal[0, 0, 0, 0] = 1
    np.savez_compressed(planning, 1.0 - GRID[None], goal, actions, goal)
    tiles = io.BytesIO()
    tile_arrays = {
        "maps": np.zeros((1, 3, 4, 3), np.uint8),
        "costs": np.full((1, 3, 4), 0.8),
        "targets": np.zeros((1, 1, 2), np.int64),
        "sources": np.ones((1, 1, 1, 2), np.int64),
        "paths": np.eye(3, 4)[None, None, None],
    }
    np.savez_compressed(tiles, **tile_arrays)  # type: ignore[arg-type]
    weights, paths, pictures = io.BytesIO(), io.BytesIO(), io.BytesIO()
    np.save(weights, np.full((1, 3, 4), 0.8, np.float16))
    np.save(paths, np.eye(3, 4, dtype=np.uint8)[None])
    np.save(pictures, np.zeros((1, 3, 4, 3), np.uint8))
    return {
        "warcraft": {
            "train_vertex_weights.npy": weights.getvalue(),
            "train_shortest_paths.npy": paths.getvalue(),
            "train_maps.npy": pictures.getvalue(),
        },
        "warcraft paths": {
            "train_shortest_paths.npy": paths.getvalue(),
            "train_vertex_weights.npy": weights.getvalue(),
            "train_maps.npy": pictures.getvalue(),
        },
        "tilebased": {"train.npz": tiles.getvalue()},
        "png": {"a.png": saved("png")},
        "bmp": {"a.bmp": saved("bmp")},
        "jpeg": {"a.jpg": saved("jpeg")},
        "webp": {"a.webp": saved("webp")},
        "tiff": {"a.tif": saved("tiff")},
        "gif": {"a.gif": saved("gif")},
        "maze-hard": {"train.csv": b"source,question,answer,rating\nx,S  G,So G,2\n"},
        "text table": {"a.csv": b"1,1,1\n1,0,0\n\n0,1\n0,0\n"},
        "text maze": {"a.txt": b"####\n#S.#\n# G#\n####\n"},
        "pgm": {"a.pgm": pgm},
        "P2": {"a.pgm": b"P2\n4 3\n255\n" + b" ".join(b"%d" % v for v in (255 * GRID).ravel())},
        "npy": {"a.npy": saved("npy")},
        "npz": {"a.npz": saved("npz")},
        "planning": {"p.npz": planning.getvalue()},
        "yaml": {"a.yaml": yaml, "a.pgm": pgm},
        "map": {"a.map": text},
        "scen": {"a.scen": scen, "a.map": text},
    }


FORMATS = {
    "yaml": "ros",
    "map": "movingai",
    "scen": "movingai",
    "maze-hard": "maze-hard",
    "text table": "text",
    "text maze": "text",
    "warcraft": "warcraft",
    "warcraft paths": "warcraft",
    "tilebased": "tilebased",
    "planning": "planning-datasets",
}
CHANGES = st.lists(
    st.tuples(
        st.integers(0, 2**16),
        st.sampled_from(["flip", "set", "cut", "insert", "delete"]),
        st.binary(max_size=6),
    ),
    max_size=4,
)


def changed(data: bytes, changes: list[tuple[int, str, bytes]]) -> bytes:
    """Return ``data`` after these changes."""
    out = bytearray(data)
    for place, change, more in changes:
        at = place % max(len(out), 1)
        if change == "flip" and out:
            out[at] ^= 1 << (place % 8)
        elif change == "set":
            out[at : at + len(more)] = more
        elif change == "insert":
            out[at:at] = more
        elif change == "cut":
            del out[at:]
        else:
            del out[at : at + len(more)]
    return bytes(out)


def attempt(read: Callable[[], object]) -> None:
    """Call an importer: a FormatError must be one line, and nothing else may come."""
    problem = ""
    try:
        read()
    except FormatError as error:
        problem = str(error)
    assert "\n" not in problem


@pytest.mark.parametrize("file_format", sorted(seed_points()))
@examples(120, SETTINGS)
@given(CHANGES)
def test_a_changed_file_is_read_or_refused(
    file_format: str, changes: list[tuple[int, str, bytes]]
) -> None:
    """A few bytes of a valid file are changed."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for k, (file, data) in enumerate(seed_points()[file_format].items()):
            (folder / file).parent.mkdir(exist_ok=True)
            (folder / file).write_bytes(data if k else changed(data, changes))
        first = folder / next(iter(seed_points()[file_format]))
        source = first if file_format in ("planning", "scen", "tilebased", "warcraft") else folder
        attempt(lambda: read_any(source, FORMATS.get(file_format, "images"), LIMITS))
        if file_format == "scen":
            attempt(lambda: check_scen(first, limits=LIMITS))


@SETTINGS
@given(st.binary(max_size=60))
def test_a_file_of_any_bytes_is_read_or_refused(data: bytes) -> None:
    """The file has any bytes and any ending, and its format is recognised or named."""
    with tempfile.TemporaryDirectory() as name:
        for ending in (
            "png",
            "jpg",
            "bmp",
            "pgm",
            "npy",
            "npz",
            "yaml",
            "map",
            "scen",
            "csv",
            "txt",
        ):
            path = Path(name) / f"a.{ending}"
            path.write_bytes(data)
            attempt(lambda path=path: read_any(path, limits=LIMITS))  # type: ignore[misc]
