"""Files that are damaged, lie or come from elsewhere: refused by name, and nothing else with them.

tests/shards/test_hostile.py measures the memory of the largest of them.
"""

from __future__ import annotations

import io
import struct
import tracemalloc
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pytest
from helpers.foreign_files import (
    GRID,
    MAP,
    PGM,
    PLANNING,
    SOURCES,
    TILES,
    WEIGHTS,
    YAML,
    Source,
    npy_bytes,
    npz_bytes,
    picture,
)
from helpers.wild import cli, npy, png
from PIL import Image

from mapdata.formats import FormatError, Limits, read_any
from mapdata.formats.registry import functions_by_format

LIMITS = Limits(unpacked=2**20)
MOST = 3_000_000
"""Bytes that a refusal may take."""

Files: TypeAlias = Mapping[str, bytes | None]


class Fault(NamedTuple):
    """A source with one fault.

    Attributes:
        kind: of `SOURCES`, which has the files that are sound.
        files: content of the others by name; None for a file that is not there.
        says: what is said of it, as a regular expression.
    """

    kind: str
    files: Files
    says: str


FAULTS: dict[str, Fault] = {}
"""All faults, by the name of the format and of the fault."""


def fault(kind: str, name: str, says: str, files: Files) -> None:
    """Add a fault."""
    FAULTS[f"{SOURCES[kind].format}: {name}"] = Fault(kind, files, says)


# --- pictures and arrays ------------------------------------------------------------------------


def image_bytes(dtype: type[np.generic], file_format: str) -> bytes:
    """Return a picture whose pixels are of this type."""
    out = io.BytesIO()
    Image.fromarray(GRID.astype(dtype)).save(out, file_format)
    return out.getvalue()


GREY = png(3, 4, depth=8)
NO_BODY = zlib.compress(b"\0")
BMP = picture("bmp")
JPEG = picture("jpeg")
DAMAGED = "damaged picture"
FOREIGN = "not a PNG"
NO_NPY = "not a sound .npy file"
NO_GRIDS = r"expected \(H, W\), \(N, H, W\) or \(N, 1, H, W\)"
BITS_32 = "pixels of 32 bits, expected 8 or 16"
IMAGES: dict[str, tuple[bytes, str]] = {
    "bomb.png": (
        png(9400, 9400, NO_BODY),
        "has 9400 x 9400 pixels, expected at most 16777216 in all; --max-pixels sets this",
    ),
    "warning.png": (png(13000, 13000, NO_BODY), "has 13000 x 13000 pixels"),
    "error.png": (png(20000, 20000, NO_BODY), "exceeds limit"),
    "nothing.png": (b"", FOREIGN),
    "text.png": (b"<html>not found</html>", FOREIGN),
    "cut.png": (GREY[:43], DAMAGED),
    "pixels.png": (png(3, 4, b"x" * 9, depth=8), DAMAGED),
    "checksum.png": (GREY.replace(b"IDAT", b"IDAT\xff", 1), DAMAGED),
    "zero.png": (png(0, 4), "damaged|not a PNG|has 0 x 4"),
    "gif.png": (b"GIF89a\x01\0\x01\0\0\0\0;", FOREIGN),
    "icon.png": (b"\0\0\1\0\1\0\1\1\0\0\1\0\1\0" + bytes(50), FOREIGN),
    "float.tif": (image_bytes(np.float32, "TIFF"), BITS_32),
    "long.tif": (image_bytes(np.int32, "TIFF"), BITS_32),
    "cut.jpg": (JPEG[: len(JPEG) // 2], DAMAGED),
    "cut.bmp": (BMP[:60], DAMAGED),
    "lie.bmp": (
        BMP[:18] + struct.pack("<ii", 60000, 60000) + BMP[26:],
        "expected at most|exceeds limit",
    ),
    "lie.pgm": (b"P5 1000 1000 255\nx", DAMAGED),
    "pickle.npy": (npy((1,), b"\x80\x04N.", "|O"), "pickled objects, expected numbers"),
    "lie.npy": (npy((2**20, 2**20), b""), "has 128 bytes, expected 128 for its header and"),
    "nan.npy": (npy((1, 2), np.array([0, np.nan]).tobytes(), "<f8"), "expected 0 to 1"),
    "grey.npy": (npy((1, 2), b"\0\xff"), "holds values from 0 to 255, expected 0 to 1"),
    "flat.npy": (npy((4,), bytes(4)), NO_GRIDS),
    "empty.npy": (npy((0, 4, 4), b""), NO_GRIDS),
    "header.npy": (b"\x93NUMPY\x01\x00\x10\x00" + b"(" * 16, NO_NPY),
    "version.npy": (b"\x93NUMPY\x09\x00\x10\x00" + b" " * 16, NO_NPY),
    "long.npy": (b"\x93NUMPY\x02\x00\xff\xff\xff\x7f{", NO_NPY),
    "bomb.npz": (npz_bytes(maps=np.zeros((2**10, 2**10 + 1), np.uint8)), "unpack to"),
}
for image_name, (image, image_says) in IMAGES.items():
    fault("png", image_name, image_says, {image_name: image})


# --- the map of a robot -------------------------------------------------------------------------


def yaml(**fields: str) -> Files:
    """Return a yaml with other lines, and its picture."""
    lines = dict(line.split(": ", 1) for line in YAML.decode().splitlines())
    text = "".join(f"{key}: {value}\n" for key, value in {**lines, **fields}.items())
    return {"a.yaml": text.encode(), "a.pgm": PGM}


FIELDS: dict[str, tuple[dict[str, str], str]] = {
    "tag": ({"image": "!!python/object/apply:os.system ['echo hacked']"}, "not plain YAML"),
    "no picture": ({"image": "other.pgm"}, "image 'other.pgm' is missing$"),
    "absolute": ({"image": "/etc/passwd"}, "lies outside the folder of the yaml$"),
    "moved": ({"image": "/home/robot/maps/a.pgm"}, "; say image: a.pgm, which lies beside it$"),
    "converted": ({"image": "a.png"}, "'a.png' is missing; say image: a.pgm, which lies"),
    "moved up": ({"image": '"test/a.pgm"'}, "'test/a.pgm' is missing; say image: a.pgm"),
    "outside": ({"image": "../good/b.pgm"}, "lies outside"),
    "sneaky": ({"image": "x/../../good/b.pgm"}, "lies outside"),
    "folder": ({"image": "."}, "image '.' is missing"),
    "number": ({"image": "7"}, "expected the name of a picture"),
    "list": ({"image": "[a, b]"}, "expected the name of a picture"),
    "nul": ({"image": '"a\\0b"'}, "expected the name of a picture"),
    "nan": ({"resolution": ".nan"}, "resolution is 'nan', expected a finite number"),
    "infinite": ({"resolution": ".inf"}, "expected a finite number"),
    "zero": ({"resolution": "0.0"}, "above 0"),
    "negative": ({"resolution": "-0.05"}, "above 0"),
    "tiny": ({"resolution": "5e-324"}, "got 5e-324, expected metres per cell above 0, from 1e-09"),
    "immense": ({"resolution": "1.0e+308"}, "resolution: got 1e\\+308, expected metres per cell"),
    "bool": ({"resolution": "true"}, "expected a finite number"),
    "huge": ({"resolution": "1" + "0" * 400}, "expected a finite number"),
    "text": ({"free_thresh": "low"}, "free_thresh is 'low'"),
    "order": ({"free_thresh": "0.7"}, "expected 0 <= free <= occupied <= 1"),
    "above one": ({"occupied_thresh": "1.5"}, "expected 0 <= free <= occupied <= 1"),
    "percent": ({"occupied_thresh": "65"}, "expected 0 <= free <= occupied <= 1"),
    "origin": ({"origin": "[0, 0]"}, "expected \\[x, y, yaw\\]"),
    "origin nan": ({"origin": "[0, .nan, 0]"}, "origin is 'nan'"),
    "mode": ({"mode": "quaternary"}, "mode is 'quaternary'"),
    "mode list": ({"mode": "[1]"}, "mode is"),
    "negate": ({"negate": "2"}, "negate is 2"),
    "negate list": ({"negate": "[0]"}, "negate is"),
    "raw negate": ({"mode": "raw", "negate": "1"}, "mode raw with negate"),
    "not yaml": ({"image": "{unclosed"}, "not plain YAML"),
    "alias": ({"image": "*nothing"}, "not plain YAML \\(an alias: write out"),
    "deep lists": ({"image": "[" * 500}, "more than 16 deep, expected the flat YAML"),
    "deep keys": ({"image": "\n  " + "? " * 30_000}, "more than 16 deep, expected the flat YAML"),
    "long": ({"image": "? " * 200_000}, "bytes, expected at most 65536"),
}
for field_name, (fields, field_says) in FIELDS.items():
    fault("yaml", field_name, field_says, yaml(**fields))
for missing in ("image", "resolution", "occupied_thresh", "free_thresh"):
    kept = [line for line in YAML.splitlines(True) if not line.startswith(missing.encode())]
    files: Files = {"a.yaml": b"".join(kept), "a.pgm": PGM}
    fault("yaml", f"without {missing}", f"has no field '{missing}'", files)

LAUGHS = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{new}: &{new} [{','.join(['*' + old] * 9)}]\n"
    for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)
MERGED = "a: &a {x: 1}\n" + "".join(
    f"{new}: &{new} {{<<: [{','.join(['*' + old] * 9)}]}}\n"
    for old, new in zip("abcdefghijklmno", "bcdefghijklmnop", strict=True)
)
TEXTS = {
    "nothing": "",
    "a list": "- 1\n",
    "nested lists": "[" * 200,
    "merged keys": MERGED,
    "a billion laughs": LAUGHS,
    "a billion pictures": LAUGHS + "image: *i\n",
    "a zero": "\0",
    "two documents": "a: b\n---\nc: d\n",
    "a list as key": "? [1]\n: 2\n",
}
for text_name, text in TEXTS.items():
    fault("yaml", text_name, r"a\.yaml", {"a.yaml": text.encode()})

P2 = SOURCES["P2"].files["a.pgm"]
PGMS = {
    "empty": (b"", "not a PNG, JPEG"),
    "magic only": (b"P5", DAMAGED),
    "letters": (b"P5 a b c\n", DAMAGED),
    "short": (PGM[:-1], DAMAGED),
    "lie": (PGM.replace(b"4 3", b"4000 4000"), DAMAGED),
    "large": (b"P5 9400 9400 255\n", "has 9400 x 9400 pixels, expected at most"),
    "bomb": (b"P5 99999 99999 255\n", "exceeds limit"),
    "no pixels": (b"P5 0 5 255\n", "not a PNG, JPEG"),
    "maximum": (b"P5 1 1 70000\n\0", "maxval must be"),
    "no maximum": (b"P5 1 1 0\n\0", "maxval must be"),
    "few words": (P2[:-10], "not enough image data"),
    "words": (P2.replace(b" 255 ", b" xyz ", 1), DAMAGED),
    "short 16": (b"P5 3 2 65535\n" + bytes(11), DAMAGED),
}
for pgm_name, (pgm, pgm_says) in PGMS.items():
    fault("yaml", f"pgm, {pgm_name}", pgm_says, {"a.yaml": YAML, "a.pgm": pgm})


# --- text ---------------------------------------------------------------------------------------

HEADER = b"type octile\nheight 3\nwidth 4\nmap\n"
MAPS = {
    "corners": (b"type octile-corner\nheight 1\nwidth 1\nmap\n", "is of type octile-corner, whose"),
    "raw": (b"type raw\nheight 1\nwidth 1\nmap\n0\n", "is of type raw, whose map gives numbers"),
    "empty": (b"", "no line 'map'"),
    "nul": (b"type octile\0", "not text in UTF-8"),
    "no map": (MAP.replace(b"map\n", b""), "line 4 is '..@@', expected type"),
    "no size": (MAP.replace(b"width 4\n", b""), "height 3 and width 0"),
    "huge": (MAP.replace(b"width 4", b"width 999999999"), "expected 1 to 16777216 cells"),
    "negative": (MAP.replace(b"width 4", b"width -4"), "line 3 is 'width -4'"),
    "short row": (MAP.replace(b".S@W", b".S@"), "row 1 is 3 letters, expected 4"),
    "long row": (MAP.replace(b".S@W", b".S@WW"), "row 1 is 5 letters"),
    "truncated": (MAP[:-6], "row 2 is missing"),
    "letter": (MAP.replace(b".S", b".x"), "unknown terrain 'x'"),
    "not ascii": (MAP.replace(b".S", ".\u00e9".encode()), "unknown terrain|row 1 is"),
}
for map_name, (content, map_says) in MAPS.items():
    fault("map", map_name, map_says, {"a.map": content})

for maze_name, line, maze_says in (
    ("no square", "x,S G,S G,2", "question: got 3 cells in one line, expected a square map"),
    ("two ends", "x,S  S,S  S,2", "one S and one G"),
    ("other letters", "x,S  X,S  X,2", "expected the maze alone"),
    ("nothing", "x,,,", "one S and one G"),
    ("few columns", "x,SG", "expected source,question"),
):
    table = f"source,question,answer,rating\n{line}\n".encode()
    fault("maze-hard", maze_name, f"line 2.*{maze_says}", {"train.csv": table})

for table_text, table_says in (
    ("", "holds no map"),
    ("\n\n", "holds no map"),
    ("0,1\n1\n", "row 1 has 1 numbers, expected 2 as in row 0"),
    ("0 1\n" + 9 * "1 ", "row 1 has more than 2 numbers, expected 2 as in row 0"),
    ("0,1\n1,\n1,,\n", "row 1 has 1 numbers, expected 2"),
    (",0,1\n0,1,1\n", r"row 0 is no row of numbers, without header and index \(ValueError"),
    ("-1 0\n0 100\n", "from -1.0 to 100.0, expected 0 to 1; it looks like an OccupancyGrid"),
    ("0,1,2\n0,1,1\n", "row 0 numbers the columns, as a header does: a table has neither"),
    ("a,b\n0,1\n", "row 0 is no row of numbers, but 'a,b': a table has neither h"),
    ("[0]\n[1]\n", r"looks like lists of Python or JSON: np.savetxt\(path, values, fmt="),
    (
        "version https://git-lfs.github.com/spec/v1\n",
        "not text in UTF-8; it looks like a pointer of",
    ),
    (
        "<!DOCTYPE html>\n<html>\n",
        "not text in UTF-8; it looks like a web page: download the file",
    ),
    ("0.5 0.1\n0 1\n", "holds values between 0 and 1, expected only 0 and 1; it looks like p"),
    ("1 nan\n0 1\n", "holds values from nan to nan, expected 0 to 1; it looks like cells with"),
    ("##\n#\n", r"row 1 has 1 letters, expected 2 as in row 0 \(many editors remove spaces"),
    ("#SS\n...\n", "has 2 letters S, expected at most one"),
    ("#\0#\n", "not text in UTF-8"),
):
    fault("letters", repr(table_text[:12]), table_says, {"a.txt": table_text.encode()})


# --- archives -----------------------------------------------------------------------------------


def archive(**members: bytes) -> bytes:
    """Return an .npz of these members, which need not be arrays."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in members.items():
            file.writestr(f"{name}.npy", data)
    return out.getvalue()


SPLIT = {f"arr_{k}": npy_bytes(array) for k, array in enumerate(PLANNING)}
WHOLE = archive(**SPLIT)
BIG = bytes(2**19)
ARCHIVES = {
    "bomb": (archive(**{**SPLIT, "arr_0": npy((2**20,), 2 * BIG)}), "arr_0 has shape"),
    "large": (
        archive(
            arr_0=npy((2**11, 16, 16), BIG),
            arr_1=npy((2**11, 1, 16, 16), BIG),
            arr_2=npy((2**11, 8, 1, 16, 16), b""),
            arr_3=npy((2**11, 1, 16, 16), BIG),
        ),
        "arr_0, arr_1, arr_3 unpack to 1572864 bytes, expected at most 1048576",
    ),
    "header lies": (
        archive(**{**SPLIT, "arr_0": npy((2, 3, 4), b"")}),
        "has [0-9]+ bytes, expected",
    ),
    "negative": (archive(**{**SPLIT, "arr_0": npy((-1, 4), b"")}), "has shape"),
    "pickled": (npz_bytes(np.array([{"a": 1}], object)), "holds no array 'arr_1'"),
    "one pickled": (
        archive(**{**SPLIT, "arr_0": npy((2, 3, 4), b"\x80\x04N.", "|O")}),
        "holds pickled objects",
    ),
    "not npy": (archive(**{**SPLIT, "arr_0": b"nonsense"}), "not a sound .npz"),
    "text dtype": (
        archive(**{**SPLIT, "arr_0": npy((2, 3, 4), bytes(96), "<U1")}),
        "expected numbers",
    ),
    "cut": (WHOLE[:-30], "not a sound .npz"),
    "flipped": (WHOLE[:60] + bytes([WHOLE[60] ^ 255]) + WHOLE[61:], "not a sound .npz|damaged"),
    "text": (b"hello", "not a sound .npz"),
    "outside": (archive(**{"../arr_0": npy((1,), b"x")}), "expected arr_0 to arr_11"),
    "nan": (
        archive(**{**SPLIT, "arr_0": npy_bytes(np.full((2, 3, 4), np.nan))}),
        "expected 0 to 1",
    ),
    "grey": (
        archive(**{**SPLIT, "arr_0": npy_bytes(np.full((2, 3, 4), 0.5))}),
        "expected only 0 and 1",
    ),
    "flat": (archive(**{**SPLIT, "arr_0": npy_bytes(np.ones(24))}), r"expected \(N, H, W\)"),
    "goals": (archive(**{**SPLIT, "arr_1": npy_bytes(np.ones((1, 1, 3, 4)))}), "arr_1 has shape"),
    "missing": (archive(arr_0=SPLIT["arr_0"]), "holds no array 'arr_1'"),
}
for archive_name, (data, archive_says) in ARCHIVES.items():
    fault("planning", archive_name, archive_says, {"p.npz": data})

for array_name, index, number, tile_says in (
    ("costs", (1, 2, 3), 0.0, r"map 1: cell \(2, 3\) has weight 0, expected a whole multiple"),
    ("costs", (1, 2, 3), np.nan, r"map 1: cell \(2, 3\) has weight nan"),
    ("costs", (1, 2, 3), 0.84, r"map 1: cell \(2, 3\) has weight 0.84"),
    ("costs", (1, 2, 3), -1.0, r"map 1: cell \(2, 3\) has weight -1"),
    ("targets", (2, 1, 0), 3, r"map 2: target 1 is \(3.0, "),
    ("sources", (2, 1, 0, 1), 4, r"map 2: target 1, source 0 is \("),
    ("sources", (2, 1, 0, 1), -1, r"map 2: target 1, source 0 is \("),
    ("sources", (2, 1, 0, 1), 1.5, r"map 2: target 1, source 0 is \("),
    ("sources", (2, 1, 0, 1), np.nan, r"map 2: target 1, source 0 is \("),
    ("paths", (2, 1, 0, 1, 1), 0.5, "map 2: target 1, source 0: path: holds 0.0 to 1.0"),
    ("paths", (2, 1, 0, 1, 1), np.nan, "map 2: target 1, source 0: path: holds nan to nan"),
):
    spoiled = TILES[array_name].astype(np.float64)
    spoiled[index] = number
    tiles: dict[str, Any] = {**TILES, array_name: spoiled}
    fault("tiles", f"{array_name} {number}", tile_says, {"train.npz": npz_bytes(**tiles)})
WITHOUT_PATHS = {name: npy_bytes(array) for name, array in TILES.items() if name != "paths"}
fault("tiles", "no paths", "holds no array 'paths'", {"train.npz": archive(**WITHOUT_PATHS)})
fault(
    "tiles",
    "header lies",
    "'paths': has 128 bytes, expected 128 for its header",
    {"train.npz": archive(**WITHOUT_PATHS, paths=npy((3, 2, 1, 3, 2**40), b"", "<f8"))},
)


# --- folders of arrays --------------------------------------------------------------------------

SHORT = "has 128 bytes, expected 128 for its header and those of"
WARCRAFT: dict[str, tuple[str, bytes | None, str]] = {
    "no weights": ("vertex_weights", None, "train_vertex_weights.npy: no such file"),
    "no pictures": ("maps", None, "train_maps.npy: no such file"),
    "no paths": ("shortest_paths", None, "train_shortest_paths.npy: no such file"),
    "pictures of another size": (
        "maps",
        npy_bytes(np.zeros((2, 6, 7, 3), np.uint8)),
        r"has shape \(2, 6, 7, 3\), expected \(2, k 3, k 4, 3\)",
    ),
    "grey pictures": (
        "maps",
        npy_bytes(np.zeros((2, 6, 8), np.uint8)),
        r"has shape \(2, 6, 8\), expected \(2, k 3, k 4, 3\)",
    ),
    "fewer paths": (
        "shortest_paths",
        npy_bytes(np.zeros((1, 3, 4), np.uint8)),
        r"has shape \(1, 3, 4\), expected \(2, 3, 4\) as train_vertex_weights.npy",
    ),
    "path of 2": (
        "shortest_paths",
        npy_bytes(np.full((2, 3, 4), 2, np.uint8)),
        "train_shortest_paths.npy: map 0: holds 2 to 2, expected only 0 and 1",
    ),
    "flat weights": (
        "vertex_weights",
        npy_bytes(np.full((2, 12), 0.8)),
        r"has shape \(2, 12\), expected \(N, H, W\)",
    ),
    "no maps": (
        "vertex_weights",
        npy_bytes(np.zeros((0, 3, 4))),
        r"has shape \(0, 3, 4\), expected \(N, H, W\), none of them 0",
    ),
    "huge": ("vertex_weights", npy((2**40, 3, 4), b"", "<f8"), SHORT),
    "wide": ("vertex_weights", npy((2, 2**20, 2**20), b"", "<f8"), SHORT),
    "cut off": (
        "vertex_weights",
        npy_bytes(WEIGHTS)[:-3],
        "expected 128 for its header and those of",
    ),
    "pickled": (
        "vertex_weights",
        npy_bytes(np.array([[["a"]]], object)),
        "holds pickled objects, expected numbers",
    ),
}
for split_name, (part, weights, split_says) in WARCRAFT.items():
    fault(
        "warcraft",
        split_name,
        split_says,
        {**SOURCES["warcraft"].files, f"train_{part}.npy": weights},
    )

for part, samples, sample_says in (
    ("goals", np.zeros((1, 1, 3, 4)), r"goals\.npy: has shape \(1, 1, 3, 4\), expected \(2, 1"),
    ("maps", np.zeros((2, 3, 4)), r"maps\.npy: has shape \(2, 3, 4\), expected \(N, 1, H, W\)"),
    ("maps", np.full((2, 1, 3, 4), 0.5), r"maps\.npy: map 0: holds values between 0 and 1"),
    ("starts", np.array([{}]), r"starts\.npy: holds pickled objects"),
):
    fault(
        "transpath",
        f"{part} of shape {samples.shape}",
        sample_says,
        {**SOURCES["transpath"].files, f"{part}.npy": npy_bytes(samples)},
    )


# --- the tests ----------------------------------------------------------------------------------


def test_every_format_has_faults() -> None:
    """A new format gets some above."""
    assert {SOURCES[each.kind].format for each in FAULTS.values()} == set(
        functions_by_format("read")
    )


@contextmanager
def most_memory() -> Iterator[list[int]]:
    """Give a list that holds afterwards how many bytes of Python and numpy were in use at most."""
    most: list[int] = []
    tracemalloc.start()
    try:
        yield most
    finally:
        most.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()


def write(name: str, folder: Path) -> tuple[str, Path]:
    """Write a source with a fault; return its format and the file that a user names."""
    kind, files, _ = FAULTS[name]
    written = {path: data for path, data in files.items() if data is not None}
    Source(SOURCES[kind].format, written).write(folder)
    return SOURCES[kind].format, folder / next(iter(files))


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_named_and_stops_nothing_else(name: str, tmp_path: Path) -> None:
    """One line says what is wrong and where, in little memory; a good source in the same folder is
    read as it is alone.
    """
    kind, _, says = FAULTS[name]
    format_name, named = write(name, tmp_path / "bad")
    SOURCES[kind].write(tmp_path / "good")
    with most_memory() as most, pytest.raises(FormatError, match=says) as caught:
        read_any(named, format_name, LIMITS)
    assert most[0] < MOST
    assert "\n" not in str(caught.value)
    assert str(tmp_path / "bad") in str(caught.value)
    collection = read_any(tmp_path, format_name, LIMITS)
    good = read_any(tmp_path / "good", format_name, LIMITS)
    assert [each.name for each in collection.maps] == [each.name for each in good.maps]
    assert [reason for _, reason in good.left_out] == []


@pytest.mark.parametrize(
    "name", {SOURCES[each.kind].format: name for name, each in reversed(FAULTS.items())}.values()
)
def test_the_command_says_it_in_one_line(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The exit code is 2, and nothing is written."""
    format_name, named = write(name, tmp_path / "bad")
    out = tmp_path / "out"
    code, _, err = cli(capsys, "import", named, out, "--format", format_name)
    assert (code, err.count("mapdata: ")) == (2, 1)
    assert not out.exists()


LIMITED: list[tuple[str, Limits, str]] = [
    ("png", Limits(pixels=11), "has 3 x 4 pixels, expected at most 11 in all"),
    ("npy", Limits(pixels=11), "has 3 x 4 pixels, expected at most 11 in all"),
    ("npz", Limits(unpacked=11), "expected at most 11"),
    ("yaml", Limits(pixels=11), "has 3 x 4 pixels, expected at most 11 in all"),
    ("map", Limits(unpacked=10), "expected at most 10"),
    ("map", Limits(pixels=11), "expected 1 to 11 cells"),
    ("planning", Limits(unpacked=100), "unpack to [0-9]+ bytes, expected at most 100"),
    ("tiles", Limits(unpacked=100), "unpack to [0-9]+ bytes, expected at most 100"),
    ("warcraft", Limits(pixels=11), "has 3 x 4 cells, expected at most 11 in all"),
    ("warcraft", Limits(maps=1), "has 2 maps, expected at most 1"),
    ("transpath", Limits(pixels=11), "has 3 x 4 pixels, expected at most 11 in all"),
    ("transpath", Limits(maps=1), "has 2 maps, expected at most 1"),
    ("table", Limits(pixels=5), "has 2 x 3 pixels, expected at most 5 in all; --max-pixels sets"),
    ("letters", Limits(pixels=15), "has 4 x 4 pixels, expected at most 15 in all"),
    ("maze-hard", Limits(unpacked=10), "expected at most 10"),
]


@pytest.mark.parametrize(("kind", "limits", "says"), LIMITED)
def test_limits_hold(kind: str, limits: Limits, says: str, tmp_path: Path) -> None:
    """Of cells, maps and bytes."""
    named = SOURCES[kind].write(tmp_path)
    with pytest.raises(FormatError, match=says):
        read_any(named, SOURCES[kind].format, limits)


def test_every_format_has_a_limit() -> None:
    """A new format gets one above."""
    assert {SOURCES[kind].format for kind, _, _ in LIMITED} == functions_by_format("read").keys()
