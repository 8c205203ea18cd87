"""The paper's release: one PNG a map and one CSV with its columns, in and out.

Source: Flores-Aquino et al., arXiv 2110.13242, sections 3 and 4: 10,000 maps as images plus one
CSV. Its repository, https://github.com/gbriel21/map2D_dataSet, says no more; a script of its
authors reads ``maps_parameters.csv`` and ``map0.png``, ``map1.png``, ... beside it. Nobody here has
seen the headers of that file, so the reader takes the columns that are written here, and no others.

Pictures are black where free and white where occupied, as in the paper's Figure 2; 1 bit a pixel.
They lie in the folder ``images`` beside the CSV. Lists are written as JSON.

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
| reachable | one a segment: whether it has a path (ours) |
| all_connected | whether paths join all rooms (ours) |
| bfs_row_path, bfs_column_path | the cells of the route in one line, joints once |
| astar_row_path, astar_column_path | likewise |
| bfs_path_gaps, astar_path_gaps | for each segment without a path, the cells before it (ours) |
| bfs_iterations, astar_iterations | those of the whole route |
| bfs_segment_iterations, astar_segment_iterations | one a segment (ours) |
| bfs_connection_matrix, astar_connection_matrix | n lists of n costs, -1 no connection |
| movement | how paths move, as JSON (ours) |

Columns from connected on, but for movement, are labels: they may be missing, and are compared with
ours where they stand.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image

from mapdata.arrays import Array, Flags, Ints
from mapdata.checks import check_resolution
from mapdata.describe.table import map_row
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import LIMITS, SPLIT_NAMES, Limits, check_file, walk
from mapdata.formats.images import brightness, read_pixels, tell_free
from mapdata.formats.registry import Format
from mapdata.hashing import canonical_json
from mapdata.movement import Movement
from mapdata.npy import FormatError, refusing
from mapdata.search.api import SEARCHES
from mapdata.search.labels import Labels
from mapdata.shards.root import Root
from mapdata.shards.workers import bar

PARAMETERS = (
    "item",
    "label",
    "split",
    "resolution",
    "passage_size",
    "seed_rows",
    "seed_columns",
    "size_rows",
    "size_columns",
    "direction_for_passages",
    "movement",
)
"""Columns that a table must have to be read."""

_SEARCH_LABELS = (
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
    *(f"{search}_{name}" for search in SEARCHES for name in _SEARCH_LABELS),
)
"""Columns that a search of ours can check."""


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
    """Return whether a CSV has our columns, or lies beside ``map0.png`` as that of the authors."""
    try:
        # a line of a hostile file may be as long as the file
        with open(path, encoding="utf-8-sig", errors="replace") as file:
            columns = file.readline(100_000).strip().split(",")
    except OSError:
        return False
    return set(columns).issuperset(PARAMETERS) or (path.parent / "map0.png").exists()


def _csv(source: Path) -> Path:
    """Return the CSV that ``source`` is, or the only one in its folder."""
    inside = source.iterdir() if source.is_dir() else [source]
    paths = [path for path in inside if path.is_file() and path.suffix.lower() == ".csv"]
    if len(paths) != 1:
        raise FormatError(f"{source}: holds {len(paths)} .csv files, expected a folder with one")
    return paths[0]


def read(source: Path, limits: Limits = LIMITS) -> Collection:
    """Read a release as `write` writes it: its folder, or the CSV in it.

    Raises:
        FormatError: no CSV, or one that cannot be read. A map whose picture or rooms are damaged is
            left out.
    """
    path = _csv(source)
    collection = Collection()
    files = walk(path.parent / "images", (".png",), limits, collection)
    pictures = {picture.stem: picture for picture in files}
    movements = set()
    items = set()
    with bar(limits.progress, len(files)) as advance:
        for row in _rows(path, limits):
            movements.add(row["movement"])
            label = row["label"]
            with collection.leaving_out(label):
                if label not in pictures:
                    raise FormatError(f"its picture images/{label}.png is missing")
                occupied = brightness(read_pixels(pictures[label], limits)) >= 128
                foreign_map = _map_of(row, occupied)
                if foreign_map.number in items:
                    raise FormatError(f"item {foreign_map.number} stands there twice")
                items.add(foreign_map.number)
                collection.maps.append(foreign_map)
            advance(1)
    collection.movement = _movement(path, movements)
    tell_free(collection, "dark pixels (in the paper white is occupied)", "--format images")
    return collection


def _rows(path: Path, limits: Limits) -> Iterator[dict[str, str]]:
    """Yield the lines of a CSV by the names of its columns.

    Raises:
        FormatError: too large, columns are missing, or it is no CSV.
    """
    check_file(path, limits)
    csv.field_size_limit(limits.unpacked)  # a route may have more than 131,072 letters
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            lines = csv.reader(file, strict=True)
            columns = next(lines, [])
            missing = [name for name in PARAMETERS if name not in columns]
            if missing:
                raise FormatError(
                    f"{path}: has no columns {', '.join(missing)}, expected those that mapdata "
                    "export writes; --format images reads the pictures alone"
                )
            for line in filter(None, lines):  # all but empty ones
                if len(line) != len(columns):
                    what = f"{len(line)} fields, expected {len(columns)}"
                    raise csv.Error(f"line {lines.line_num} has {what}")
                yield dict(zip(columns, line, strict=True))
    except (csv.Error, UnicodeError) as error:
        raise FormatError(f"{path}: not a sound CSV ({error})") from None


def _movement(path: Path, texts: set[str]) -> Movement:
    """Return the movement that all lines state; the default one of a table without lines."""
    if len(texts) > 1:
        raise FormatError(f"{path}: holds maps of {len(texts)} movements, expected one")
    text = "".join(texts)
    with refusing(f"{path}: its movement is {text[:60]!r}"):
        return Movement(**json.loads(text or "{}"))


def _map_of(row: dict[str, str], cells: Flags) -> ForeignMap:
    """Return the map of a line of the CSV."""
    seed_points = _pairs(row, "seed")
    sizes = _pairs(row, "size")
    directions = numbers(row["direction_for_passages"])
    rooms = len(seed_points)
    if rooms == 0 or len(sizes) != rooms or len(directions) != 2 * (rooms - 1):
        raise FormatError(
            f"{rooms} seed points, {len(sizes)} sizes and {len(directions)} directions do not fit"
        )
    width = _number(row, "passage_size")
    lengths = (width, *sizes.ravel())
    are_lengths = min(lengths) >= -1 and max(lengths) < 2**15
    if not are_lengths or not np.isin(directions, (-1, 0, 1)).all():
        raise FormatError("its passage size, sizes or directions are out of range")
    stated = {name: row[name] for name in LABELS if name in row}
    return ForeignMap(
        name=row["label"],
        cells=cells,
        split=SPLIT_NAMES.get(row["split"]),
        resolution=check_resolution("resolution", float(row["resolution"])),
        number=_number(row, "item"),
        seed_points=seed_points,
        rooms_known=True,
        sizes=sizes,
        directions=directions.reshape(-1, 2),
        passage_width=width,
        check=partial(_differing, stated) if stated else None,
    )


def _number(row: dict[str, str], name: str) -> int:
    """Return the whole number of a line in the column ``name``."""
    values = numbers(row[name])
    if len(values) != 1:
        raise FormatError(f"the cell {row[name][:40]!r} holds {len(values)} numbers, expected one")
    return int(values[0])


def _pairs(row: dict[str, str], name: str) -> Ints:
    """Return two lists of the CSV, rows and columns of each room, as (n, 2)."""
    rows = numbers(row[f"{name}_rows"])
    columns = numbers(row[f"{name}_columns"])
    if len(rows) != len(columns):
        raise FormatError(f"{len(rows)} {name}_rows and {len(columns)} {name}_columns do not fit")
    return np.stack([rows, columns], axis=1)


def numbers(text: str) -> Ints:
    """Return the whole numbers of a cell of the CSV, which holds one or a flat list of them.

    Raises:
        FormatError: anything else in it.
    """
    values = _array(text)
    if values.size == 0:
        values = values.astype(np.int64)  # numpy takes the empty list for floats
    if values.ndim != 1 or values.dtype != np.int64:
        raise FormatError(f"the cell {text[:40]!r} holds other than a list of whole numbers")
    return values


def _array(text: str) -> Array:
    """Return the number or the lists of numbers of a cell of the CSV, with at least one axis.

    Raises:
        FormatError: it is not JSON, or lists of several lengths.
    """
    with refusing(f"the cell {text[:40]!r} is not a list of numbers"):
        return np.array(json.loads(text), ndmin=1)


def _differing(stated: dict[str, str], labels: Labels, k: int) -> list[str]:
    """Return the names of the columns that disagree with our labels of map k."""
    ours = map_row(labels, k, resolution=0.0)
    return [name for name, text in stated.items() if not _same(text, ours[name])]


def _same(text: str, ours: ArrayLike) -> bool:
    """Return whether a cell of the CSV holds our numbers."""
    try:
        stated = _array(text)
    except FormatError:
        return False
    expected = np.array(ours, ndmin=1)
    return (
        stated.dtype.kind in "bif"
        and stated.shape == expected.shape
        # other programs may round the numbers that they print
        and np.allclose(stated, expected, rtol=1e-6, atol=1e-6)
    )


FORMAT = Format("paper", (".csv",), read, write, is_mine=is_release, beside=(".png",))
