"""The paper's release: one PNG a map and one CSV with its columns, in and out.

Source: Flores-Aquino et al., arXiv 2110.13242, sections 3 and 4: 10,000 maps as images plus one
CSV. Its repository, https://github.com/gbriel21/map2D_dataSet, says no more; a script of its
authors reads ``maps_parameters.csv`` and ``map0.png``, ``map1.png``, ... beside it. The header of
that file is not published, so the reader accepts only the columns that are written here.

In the pictures, of 1 bit a pixel, free is black and occupied is white, as in the paper's Figure 2.
They lie in the folder ``images`` beside the CSV. Lists are written as JSON.

| column | a cell of it |
|---|---|
| item | number of the map, from 0 |
| label | name of the picture without its ending: ``map<item>`` |
| split | train, val or test (ours) |
| resolution | metres per cell |
| rooms | number of rooms (ours) |
| passage_size | width of the passages, in cells |
| seed_rows, seed_columns | one number per room |
| size_rows, size_columns | one number per room |
| direction_for_passages | two a passage, its legs: 1 horizontal, 0 vertical, -1 none |
| connected | one a passage: whether it was drawn |
| reachable | one a segment: whether it has a path (ours) |
| all_connected | whether paths join all rooms (ours) |
| bfs_row_path, bfs_column_path | the cells of the route in one line, joints once |
| astar_row_path, astar_column_path | the same for A* |
| bfs_path_gaps, astar_path_gaps | for each segment without a path, the cells before it (ours) |
| bfs_iterations, astar_iterations | those of the whole route |
| bfs_segment_iterations, astar_segment_iterations | one a segment (ours) |
| bfs_connection_matrix, astar_connection_matrix | n lists of n costs, -1 no connection |
| movement | how paths move, as JSON (ours) |

The columns connected to astar_connection_matrix are labels. They may be missing; an import compares
them with our own labels.
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
from mapdata.describe.table import map_columns
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import (
    LIMITS,
    SPLIT_NAMES,
    Limits,
    check_file,
    checked_inside,
    files_below,
    write_picture,
)
from mapdata.formats.images import brightness, note_free_cells, read_pixels
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

_LABELS_PER_SEARCH = (
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
    *(f"{search}_{name}" for search in SEARCHES for name in _LABELS_PER_SEARCH),
)
"""Columns that an import compares with our own labels."""


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
            columns = map_columns(labels, np.arange(len(labels.maps)), root.resolution)
            if file.tell() == 0:
                table.writerow([*columns, "movement"])
            for name, grid in zip(columns["label"], labels.maps.occupancy, strict=True):
                image = Image.fromarray(grid.view(np.bool_))  # bool gives a PNG of 1 bit a pixel
                write_picture(target / "images" / f"{name}.png", image)
            for row in zip(*columns.values(), strict=True):
                cells = [cell if isinstance(cell, str) else json.dumps(cell) for cell in row]
                table.writerow([*cells, movement])
    return []


# --- reading ------------------------------------------------------------------------------------


def is_release(path: Path) -> bool:
    """Return whether a CSV has the columns ``PARAMETERS``, or lies beside ``map0.png``."""
    try:
        header = _read_header(path)
    except OSError:
        return False
    has_our_columns = set(header.split(",")).issuperset(PARAMETERS)
    return has_our_columns or (path.parent / "map0.png").exists()


def _read_header(path: Path) -> str:
    """Return the first line of a file, cut at 100,000 characters."""
    with open(path, encoding="utf-8-sig", errors="replace") as file:
        return file.readline(100_000).strip()


def _csv_path(source: Path, limits: Limits) -> Path:
    """Return ``source`` if it is a CSV, or the only CSV in the folder ``source``.

    Raises:
        FormatError: there is no CSV, or there are several, or it is a link out of the folder.
    """
    candidates = source.iterdir() if source.is_dir() else [source]
    paths = [path for path in candidates if path.is_file() and path.suffix.lower() == ".csv"]
    if len(paths) != 1:
        raise FormatError(f"{source}: holds {len(paths)} .csv files, expected a folder with one")
    return checked_inside(paths[0], source, limits) if source.is_dir() else source


def read(source: Path, limits: Limits = LIMITS) -> Collection:
    """Read a release as `write` writes it: its folder, or the CSV in it.

    Raises:
        FormatError: no CSV, or one that cannot be read. A map whose picture or rooms are damaged is
            left out.
    """
    path = _csv_path(source, limits)
    collection = Collection()
    images = checked_inside(path.parent / "images", path.parent, limits)
    pictures = files_below(images, (".png",), limits, collection)
    picture_by_label = {picture.stem: picture for picture in pictures}
    movements = set()
    map_numbers = set()
    with bar(limits.progress, len(pictures)) as advance:
        for row in _rows(path, limits):
            movements.add(row["movement"])
            label = row["label"]
            with collection.leaving_out(label):
                if label not in picture_by_label:
                    raise FormatError(f"its picture images/{label}.png is missing")
                pixels = read_pixels(picture_by_label[label], limits)
                is_occupied = brightness(pixels) >= 128
                foreign_map = _parse_map(row, is_occupied)
                if foreign_map.number in map_numbers:
                    raise FormatError(f"item {foreign_map.number} stands there twice")
                map_numbers.add(foreign_map.number)
                collection.maps.append(foreign_map)
            advance(1)
    collection.movement = _parse_movement(path, movements)
    note_free_cells(
        collection,
        "dark pixels (in the paper white is occupied)",
        "if free and occupied are mixed up, --format images reads them otherwise",
    )
    return collection


def _rows(path: Path, limits: Limits) -> Iterator[dict[str, str]]:
    """Yield the lines of a CSV after its header, each as its cells by the names of the columns.

    Raises:
        FormatError: the file is too large or no CSV, or columns are missing.
    """
    check_file(path, limits)
    csv.field_size_limit(limits.unpacked)  # a route may exceed the default of 131,072 characters
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
            for line in lines:
                if not line:
                    continue  # an empty line
                if len(line) != len(columns):
                    raise csv.Error(
                        f"line {lines.line_num} has {len(line)} fields, expected {len(columns)}"
                    )
                yield dict(zip(columns, line, strict=True))
    except (csv.Error, UnicodeError) as error:
        raise FormatError(f"{path}: not a sound CSV ({error})") from None


def _parse_movement(path: Path, texts: set[str]) -> Movement:
    """Return the movement of a table; the default movement if the table has no lines.

    Args:
        path: named in errors.
        texts: the different texts in the column ``movement``.

    Raises:
        FormatError: several movements, or a text that is no movement.
    """
    if not texts:
        return Movement()
    if len(texts) > 1:
        raise FormatError(f"{path}: holds maps of {len(texts)} movements, expected one")
    (text,) = texts
    with refusing(f"{path}: its movement is {text[:60]!r}"):
        return Movement(**json.loads(text or "{}"))


def _parse_map(row: dict[str, str], is_occupied: Flags) -> ForeignMap:
    """Return the map of a line of the CSV.

    Args:
        row: the cells of the line, by column.
        is_occupied: (H, W), from the picture.

    Raises:
        FormatError: a cell that cannot be read, or cells that do not fit together.
    """
    seed_points = _parse_pairs(row, "seed")
    sizes = _parse_pairs(row, "size")
    directions = parse_numbers(row["direction_for_passages"])
    rooms = len(seed_points)
    if rooms == 0 or len(sizes) != rooms or len(directions) != 2 * (rooms - 1):
        raise FormatError(
            f"{rooms} seed points, {len(sizes)} sizes and {len(directions)} directions do not fit"
        )
    passage_width = _parse_number(row, "passage_size")
    lengths = (passage_width, *sizes.ravel())
    lengths_fit = min(lengths) >= -1 and max(lengths) < 2**15  # -1 is unknown; stored as int16
    directions_fit = np.isin(directions, (-1, 0, 1)).all()
    if not lengths_fit or not directions_fit:
        raise FormatError("its passage size, sizes or directions are out of range")
    stated_labels = {name: row[name] for name in LABELS if name in row}
    return ForeignMap(
        name=row["label"],
        cells=is_occupied,
        split=SPLIT_NAMES.get(row["split"]),
        resolution=check_resolution("resolution", float(row["resolution"])),
        number=_parse_number(row, "item"),
        seed_points=seed_points,
        rooms_known=True,
        sizes=sizes,
        directions=directions.reshape(-1, 2),
        passage_width=passage_width,
        check=partial(_differing_labels, stated_labels) if stated_labels else None,
    )


def _parse_number(row: dict[str, str], column: str) -> int:
    """Return the whole number in a column of a line."""
    numbers = parse_numbers(row[column])
    if len(numbers) != 1:
        raise FormatError(
            f"the cell {row[column][:40]!r} holds {len(numbers)} numbers, expected one"
        )
    return int(numbers[0])


def _parse_pairs(row: dict[str, str], name: str) -> Ints:
    """Return the columns ``<name>_rows`` and ``<name>_columns`` of a line as (n, 2), n rooms."""
    rows = parse_numbers(row[f"{name}_rows"])
    columns = parse_numbers(row[f"{name}_columns"])
    if len(rows) != len(columns):
        raise FormatError(f"{len(rows)} {name}_rows and {len(columns)} {name}_columns do not fit")
    return np.stack([rows, columns], axis=1)


def parse_numbers(text: str) -> Ints:
    """Return the whole numbers of a cell of the CSV, (n,), which holds a number or a flat list.

    Raises:
        FormatError: the cell holds anything else.
    """
    numbers = _parse_array(text)
    if numbers.size == 0:
        numbers = numbers.astype(np.int64)  # numpy takes an empty list for floats
    if numbers.ndim != 1 or numbers.dtype != np.int64:
        raise FormatError(f"the cell {text[:40]!r} holds other than a list of whole numbers")
    return numbers


def _parse_array(text: str) -> Array:
    """Return a cell of the CSV, a number or nested lists of numbers, with at least one axis.

    Raises:
        FormatError: it is not JSON, or has lists of different lengths.
    """
    with refusing(f"the cell {text[:40]!r} is not a list of numbers"):
        return np.array(json.loads(text), ndmin=1)


def _differing_labels(stated_labels: dict[str, str], labels: Labels, k: int) -> list[str]:
    """Return the names of the columns that disagree with our labels of map ``k``."""
    columns = map_columns(labels, np.array([k]), resolution=0.0, names=tuple(stated_labels))
    return [
        name for name, text in stated_labels.items() if not _holds_numbers(text, columns[name][0])
    ]


def _holds_numbers(text: str, expected: ArrayLike) -> bool:
    """Return whether a cell of the CSV holds the expected numbers."""
    try:
        stated = _parse_array(text)
    except FormatError:
        return False
    expected = np.array(expected, ndmin=1)
    if stated.dtype.kind not in "bif" or stated.shape != expected.shape:
        return False
    # The tolerance allows for programs that round the numbers that they print.
    return np.allclose(stated, expected, rtol=1e-6, atol=1e-6)


FORMAT = Format("paper", (".csv",), read, write, recognises=is_release, companion_endings=(".png",))
