"""The paper's release: one PNG a map and one CSV with its columns, in and out.

Source: Flores-Aquino et al., arXiv 2110.13242, sections 3 and 4: 10,000 maps as images plus one
CSV. Its repository, https://github.com/gbriel21/map2D_dataSet, says no more; a script of its
authors reads ``maps_parameters.csv`` and ``map0.png``, ``map1.png``, ... beside it. Nobody here has
seen the headers of that file. The reader takes ours and the words of the paper ("Passages size",
"Row path for A*"), whatever their case and what stands between the words; commas, semicolons or
tabs between columns; lists as JSON, as numpy prints them, or with any separators; and pictures of
any kind that `mapdata.formats.images` reads.

Pictures are black where free and white where occupied, as in the paper's Figure 2; 1 bit a pixel.
Lists are written as JSON.

| column | a cell of it |
|---|---|
| item | number of the map, from 0 |
| label | name of the picture without its ending: ``map<item>`` |
| split | train, val or test (ours) |
| resolution | metres per cell |
| rooms | how many (ours) |
| passage_size | width of the passages, in cells |
| seed_rows, seed_columns | one number per room |
| size_rows, size_columns | one number per room |
| direction_for_passages | two a passage, its legs: 1 horizontal, 0 vertical, -1 none |
| connected | one a passage: whether it was drawn |
| reachable | one a segment: whether it has a path (ours; path_exists in files of mapdata 0.1) |
| all_connected | whether paths join all rooms (ours) |
| bfs_row_path, bfs_column_path | the cells of the route in one line, joints once |
| astar_row_path, astar_column_path | likewise |
| bfs_path_gaps, astar_path_gaps | for each segment without a path, the cells before it (ours) |
| bfs_iterations, astar_iterations | those of the whole route (one a segment in mapdata 0.1) |
| bfs_segment_iterations, astar_segment_iterations | one a segment (ours) |
| bfs_connection_matrix, astar_connection_matrix | n lists of n costs, -1 no connection |
| movement | how paths move, as JSON (ours; 4-connected if missing) |
"""

from __future__ import annotations

import csv
import json
import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path, PureWindowsPath

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image

from mapdata.arrays import Flags, Ints
from mapdata.checks import check_resolution
from mapdata.describe.table import map_row
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import LIMITS, SPLIT_NAMES, Limits, check_file, walk
from mapdata.formats.images import PICTURES, brightness, read_pixels, tell_free
from mapdata.formats.registry import Format
from mapdata.hashing import canonical_json
from mapdata.movement import Movement
from mapdata.npy import FormatError, refusing
from mapdata.search.api import SEARCHES
from mapdata.search.labels import Labels
from mapdata.shards.root import Root
from mapdata.shards.workers import bar

NEEDED = ("seed_rows", "seed_columns")

_FOUND = (
    "row_path",
    "column_path",
    "path_gaps",
    "iterations",
    "segment_iterations",
    "connection_matrix",
)

LABELS = (
    "connected",
    "reachable",
    "all_connected",
    *(f"{search}_{name}" for search in SEARCHES for name in _FOUND),
)
"""Columns that a search of ours can check."""

_OTHER_NAMES = {
    "passages_size": "passage_size",
    "path_exists": "reachable",
    **{f"{name}_for_breadth_first_search": f"bfs_{name}" for name in _FOUND},
    **{f"{name}_for_a*": f"astar_{name}" for name in _FOUND},
}
"""Our names of columns that the paper, or an earlier mapdata, calls otherwise."""


def write(target: Path, root: Root, progress: bool) -> list[str]:
    """Write ``maps.csv`` and ``images/map<i>.png``.

    Returns:
        Notes for the user.
    """
    (target / "images").mkdir(parents=True)
    with open(target / "maps.csv", "w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        for labels in root.labels(progress=progress):
            movement = canonical_json(asdict(labels.maps.movement))
            for k, grid in enumerate(labels.maps.occupancy):
                row = map_row(labels, k, root.resolution) | {"movement": movement}
                image = Image.fromarray(grid.view(np.bool_))  # of bool, a PNG of 1 bit a pixel
                image.save(target / "images" / f"{row['label']}.png")
                if file.tell() == 0:
                    table.writerow(row.keys())
                table.writerow(
                    value if isinstance(value, str) else json.dumps(value) for value in row.values()
                )
    return []


# --- reading ------------------------------------------------------------------------------------


def is_release(path: Path) -> bool:
    """Return whether a CSV has columns of seed points, or lies beside ``map0.png``."""
    try:
        header = _header(path)
    except OSError:
        return False
    columns = {_column(name) for name in header.split(_separator(header))}
    return columns.issuperset(NEEDED) or (path.parent / "map0.png").exists()


def _csv(source: Path) -> Path:
    """Return the CSV that ``source`` is, or the only one in its folder."""
    inside = source.iterdir() if source.is_dir() else [source]
    found = [path for path in inside if path.is_file() and path.suffix.lower() == ".csv"]
    if len(found) != 1:
        raise FormatError(f"{source}: holds {len(found)} .csv files, expected a folder with one")
    return found[0]


def _header(path: Path) -> str:
    """Return the first line of a CSV, however long the file's lines are."""
    with open(path, encoding="utf-8-sig", errors="replace") as file:
        return file.readline(100_000).strip()


def _separator(header: str) -> str:
    """Return what separates columns: commas, tabs, or semicolons where numbers have commas."""
    return max(",;\t", key=header.count)


def _column(header: str) -> str:
    """Return our name of the column with this header."""
    plain = re.sub(r"[^a-z0-9*]+", "_", header.lower()).strip("_")
    return _OTHER_NAMES.get(plain, plain)


def read(source: Path, limits: Limits = LIMITS) -> Collection:
    """Read a release: a folder with one CSV and its pictures anywhere below, or the CSV itself.

    Raises:
        FormatError: no CSV, or one that cannot be read. A map whose picture or rooms are damaged is
            left out.
    """
    path = _csv(source)
    found = Collection()
    files = walk(path.parent, PICTURES, limits, found)
    pictures = {picture.stem.lower(): picture for picture in files}
    for picture in files:
        place = picture.relative_to(path.parent).with_suffix("")
        pictures[place.as_posix().lower()] = picture
    movements = set()
    items = set()
    with bar(limits.progress, len(files)) as advance:
        for row in _rows(path, limits):
            movements.add(row["movement"])
            # a label may be the path of a picture, separated by / or by \
            label = PureWindowsPath(row["label"])
            name = label.name or f"map{row['item']}"
            stem = Path(name).stem if name.lower().endswith(PICTURES) else name
            with found.leaving_out(stem):
                parts = (*label.parts[:-1], stem)
                ends = ["/".join(parts[k:]).lower() for k in range(len(parts))]
                known = [end for end in (*ends, row["item"].lower()) if end in pictures]
                if not known:
                    raise FormatError(f"its picture {stem}{PICTURES[0]} is missing")
                picture = pictures[known[0]]  # of the longest end
                occupied = brightness(read_pixels(picture, limits)) >= 128
                one = _map_of(row, stem, occupied)
                if one.number in items:
                    raise FormatError(f"item {one.number} stands there twice")
                if one.number is not None:
                    items.add(one.number)
                found.maps.append(one)
            advance(1)
    found.movement = _movement(path, movements - {""})
    tell_free(found, "dark pixels (in the paper white is occupied)", "--format images")
    return found


def _rows(path: Path, limits: Limits) -> Iterator[dict[str, str]]:
    """Yield the lines of a CSV by our names of its columns; what it does not state is empty.

    Raises:
        FormatError: too large, a column is missing, or it is no CSV.
    """
    check_file(path, limits)
    csv.field_size_limit(limits.unpacked)  # a route may have more than 131,072 letters
    separator = _separator(_header(path))
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            lines = csv.reader(file, delimiter=separator, skipinitialspace=True, strict=True)
            headers = next(lines, [])
            columns = [_column(header) for header in headers]
            missing = [name for name in NEEDED if name not in columns]
            if {"label", "item"}.isdisjoint(columns):
                missing.append("label")
            if missing:
                what = f"no column {missing[0]!r} among {', '.join(headers)}"
                raise FormatError(f"{path}: {what}; --format images reads the pictures alone")
            for line in filter(None, lines):  # all but empty ones
                if len(line) != len(columns):
                    what = f"{len(line)} fields, expected {len(columns)}"
                    raise csv.Error(f"line {lines.line_num} has {what}")
                cells = map(str.strip, line)
                yield defaultdict(str, zip(columns, cells, strict=True))
    except (csv.Error, UnicodeError) as error:
        raise FormatError(f"{path}: not a sound CSV ({error})") from None


def _movement(path: Path, texts: set[str]) -> Movement:
    """Return the movement that all lines state, 4-connected if none states one."""
    if len(texts) > 1:
        raise FormatError(f"{path}: holds maps of {len(texts)} movements, expected one")
    text = "".join(texts)
    with refusing(f"{path}: its movement is {text[:60]!r}"):
        return Movement(**json.loads(text or "{}"))


def _map_of(row: dict[str, str], name: str, cells: Flags) -> ForeignMap:
    """Return the map of a line of the CSV."""
    item = row["item"]
    seed_points = _pairs(row, "seed")
    sizes = _pairs(row, "size")
    directions = np.array(numbers(row["direction_for_passages"]), np.int64)
    rooms = len(seed_points)
    if rooms == 0 or len(sizes) not in (0, rooms) or len(directions) not in (0, 2 * (rooms - 1)):
        raise FormatError(
            f"{rooms} seed points, {len(sizes)} sizes and {len(directions)} directions do not fit"
        )
    width, *_ = numbers(row["passage_size"]) or [-1]
    lengths = (width, *sizes.ravel())
    are_lengths = min(lengths) >= -1 and max(lengths) < 2**15
    if not are_lengths or not np.isin(directions, (-1, 0, 1)).all():
        raise FormatError("its passage size, sizes or directions are out of range")
    metres = row["resolution"]
    resolution = check_resolution("resolution", float(metres)) if metres else None
    number = int(item) if item.isdecimal() and len(item) < 18 else None  # else too long for int64
    stated = {name: row[name] for name in LABELS if row[name]}
    return ForeignMap(
        name=name,
        cells=cells,
        split=SPLIT_NAMES.get(row["split"].lower()),
        resolution=resolution,
        number=number,
        seed_points=seed_points,
        rooms_known=True,
        sizes=sizes,
        directions=directions.reshape(-1, 2),
        passage_width=width,
        check=partial(_differing, stated) if stated else None,
    )


def _pairs(row: dict[str, str], what: str) -> Ints:
    """Return two lists of the CSV, rows and columns of each room, as (n, 2)."""
    rows = numbers(row[f"{what}_rows"])
    columns = numbers(row[f"{what}_columns"])
    if len(rows) != len(columns):
        raise FormatError(f"{len(rows)} {what}_rows and {len(columns)} {what}_columns do not fit")
    return np.array([rows, columns], np.int64).T


_NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")


def floats(text: str) -> list[float]:
    """Return the numbers of a cell of the CSV, whatever stands between them.

    Raises:
        FormatError: words in it.
    """
    if re.search(r"[A-Za-z]", _NUMBER.sub("", text)):
        raise FormatError(f"the cell {text[:40]!r} is not a list of numbers")
    return [float(number) for number in _NUMBER.findall(text)]


def numbers(text: str) -> list[int]:
    """Return the whole numbers of a cell of the CSV.

    Raises:
        FormatError: others in it.
    """
    values = floats(text)
    if not all(value.is_integer() and abs(value) < 2**53 for value in values):
        raise FormatError(f"the cell {text[:40]!r} holds other than whole numbers")
    return [int(value) for value in values]


def _differing(stated: dict[str, str], labels: Labels, k: int) -> list[str]:
    """Return the names of the columns that disagree with our labels of map k."""
    ours = map_row(labels, k, resolution=0.0)
    for search in SEARCHES:
        name = f"{search}_iterations"
        # files of mapdata 0.1 have one number a segment where the paper has one a map
        if len(_NUMBER.findall(stated.get(name, ""))) > 1:
            ours[name] = ours[f"{search}_segment_iterations"]
    return [name for name, text in stated.items() if not _same(text, ours[name])]


def _same(text: str, ours: ArrayLike) -> bool:
    """Return whether a cell of the CSV holds our numbers, whatever the shape of its lists."""
    text = re.sub(r"(?i)\bfalse\b", "0", text)
    text = re.sub(r"(?i)\btrue\b", "1", text)
    try:
        stated = floats(text)
    except FormatError:
        return False
    expected = np.ravel(ours)
    # printed numbers are rounded
    return len(stated) == len(expected) and np.allclose(stated, expected, rtol=1e-6, atol=1e-6)


FORMAT = Format("paper", (".csv",), read, write, is_mine=is_release, beside=PICTURES)
