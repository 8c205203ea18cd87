"""The paper's release: one PNG a map and one CSV with its columns, in and out.

Source: Flores-Aquino et al., arXiv 2110.13242, section III-D: 10,000 maps as images plus one CSV. The release itself is
not at hand, so the headers below are ours; a reader takes others that say the same (case, spaces, plurals and
underscores do not matter; commas, semicolons or tabs between), and lists written as JSON, as numpy prints them, or with
any separators. Other kinds of pictures do as well.

Pictures are black where free and white where occupied, as in the paper's Figure 2; 1 bit a pixel.

| column | a cell of it |
|---|---|
| item | number of the map, from 0 |
| label | name of the picture without its ending: ``map<item>`` |
| resolution | metres per cell |
| passage_size | width of the passages, in cells |
| seed_rows, seed_columns | a number a room |
| size_rows, size_columns | a number a room |
| direction_for_passages | two a passage, its legs at either room: 1 horizontal, 0 vertical, -1 none |
| connected | one a passage: 1 if it was drawn |
| path_exists | one a segment: 1 if a path leads to the next room |
| bfs_row_path, bfs_column_path, astar_row_path, astar_column_path | the cells of the route in one line, joints once |
| bfs_iterations, astar_iterations | one a segment |
| bfs_connection_matrix, astar_connection_matrix | n lists of n costs, -1 no connection |
| split | train, val or test (ours) |
| movement | how paths move, as JSON (ours; 4-connected if missing) |
"""

from __future__ import annotations

import json
import math
import re
import warnings
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd
from PIL import Image

from mapdata.arrays import Ints
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import LIMITS, SPLIT_NAMES, FormatError, Limits, walk
from mapdata.formats.images import PICTURES, brightness, read_pixels
from mapdata.formats.stored import Stored
from mapdata.search.labels import Labels
from mapdata.spec import SPLITS, Movement, canonical_json

SEARCHES = ("bfs", "astar")

ALIASES: dict[str, tuple[str, ...]] = {
    "item": ("item", "index", "id", "number"),
    "label": ("label", "name", "image", "file", "filename"),
    "resolution": ("resolution", "mapresolution"),
    "passage_size": ("passagesize", "passagewidth", "sizepassage", "tunnelsize", "tunnelwidth"),
    "seed_rows": ("seedrow", "rowseed", "seedpointrow", "seedsrow"),
    "seed_columns": ("seedcolumn", "columnseed", "seedpointcolumn", "seedscolumn", "seedcol"),
    "size_rows": ("sizerow", "rowsize", "roomrow", "sizesrow"),
    "size_columns": ("sizecolumn", "columnsize", "roomcolumn", "sizescolumn", "sizecol"),
    "direction_for_passages": ("directionforpassage", "direction", "directionsforpassage", "directionpassage"),
    "connected": ("connected",),
    "path_exists": ("pathexist", "pathsexist", "pathexisting", "existpath"),
    "split": ("split",),
    "movement": ("movement",),
    **{
        f"{search}_{name}": tuple(
            f"{first}{core}{last}" for core in cores for tag in tags for first, last in ((tag, ""), ("", tag))
        )
        for search, tags in (("bfs", ("bfs", "bf")), ("astar", ("astar", "a")))
        for name, cores in (
            ("row_path", ("rowpath", "pathrow")),
            ("column_path", ("columnpath", "pathcolumn", "colpath")),
            ("iterations", ("iteration",)),
            ("connection_matrix", ("connectionmatrix", "matrix", "connectionmatrice")),
        )
    },
}
"""What a header may be, spelled as `_plain` spells it."""

_NEEDED = ("seed_rows", "seed_columns")


def write(target: Path, source: Stored) -> list[str]:
    """Write ``maps.csv`` and ``images/map<i>.png``.

    Returns:
        Notes for the user.
    """
    (target / "images").mkdir(parents=True)
    first = True
    for labels in source.batches():
        maps = labels.maps
        for k, grid in enumerate(maps.occupancy):
            Image.fromarray(255 * grid).convert("1").save(target / "images" / f"map{maps.index[k]}.png")
        table = pd.DataFrame([_row(labels, k, source.manifest.resolution) for k in range(len(maps))])
        with open(target / "maps.csv", "a", encoding="utf-8", newline="") as file:
            table.to_csv(file, index=False, header=first, lineterminator="\n")
        first = False
    return []


def _row(labels: Labels, k: int, resolution: float) -> dict[str, object]:
    """Return the line of map k of a batch."""
    maps, n = labels.maps, int(labels.maps.rooms[k])
    first = int(maps.segment_offsets[k])
    row: dict[str, object] = {
        "item": int(maps.index[k]),
        "label": f"map{maps.index[k]}",
        "resolution": resolution,
        "passage_size": int(maps.passage_width[k]),
        "seed_rows": maps.seed_points[k, :n, 0].tolist(),
        "seed_columns": maps.seed_points[k, :n, 1].tolist(),
        "size_rows": maps.sizes[k, :n, 0].tolist(),
        "size_columns": maps.sizes[k, :n, 1].tolist(),
        "direction_for_passages": maps.directions[k, : n - 1].reshape(-1).tolist(),
        "connected": maps.connected[k, : n - 1].astype(int).tolist(),
        "path_exists": labels.reachable[first : first + n - 1].astype(int).tolist(),
    }
    for search in SEARCHES:
        line = joined(labels.route(search, k))
        matrix = labels.matrix(search, k)
        row[f"{search}_row_path"], row[f"{search}_column_path"] = line[:, 0].tolist(), line[:, 1].tolist()
        row[f"{search}_iterations"] = labels.iterations(search, k).tolist()
        row[f"{search}_connection_matrix"] = [[int(c) if c == int(c) else c for c in line] for line in matrix.tolist()]
    row["split"] = SPLITS[maps.split[k]]
    row["movement"] = canonical_json(asdict(maps.movement))
    return row


def joined(route: list[Ints]) -> Ints:
    """Return the segments of a route, each (k, 2), as one line without the repeated joints."""
    cells: list[Ints] = [np.empty((0, 2), np.int64)]
    for segment in route:
        cells.append(segment[1:] if len(cells[-1]) and len(segment) else segment)
    return np.concatenate(cells)


# --- reading --------------------------------------------------------------------------------------------------------


def is_release(source: Path) -> bool:
    """Return whether ``source`` is a folder with one CSV whose headers are the paper's, or such a CSV."""
    try:
        header = _header(_csv(source))
    except (OSError, FormatError):
        return False
    return set(_NEEDED) <= set(_columns(header.replace('"', "").split(_separator(header))).values())


def _csv(source: Path) -> Path:
    if source.is_file() and source.suffix.lower() == ".csv":
        return source
    found = [path for path in source.iterdir() if path.suffix.lower() == ".csv"] if source.is_dir() else []
    if len(found) != 1:
        raise FormatError(f"{source}: holds {len(found)} .csv files, expected a folder with one")
    return found[0]


def _header(path: Path) -> str:
    with open(path, encoding="utf-8-sig", errors="replace") as file:
        return file.readline(100_000).strip()


def _separator(header: str) -> str:
    """Return what separates the columns: commas, semicolons as where a comma is in numbers, or tabs."""
    return max(",;\t", key=header.count)


def _plain(header: str) -> str:
    """Return a header without case, separators and plurals."""
    words = re.findall(r"[a-z]+", header.lower().replace("a*", "astar"))
    return "".join(word.removesuffix("s") if len(word) > 3 and word != "bfs" else word for word in words)


def _columns(headers: list[str]) -> dict[str, str]:
    """Return our name of each header that says what one of ours says."""
    ours = {_plain(alias): name for name, aliases in ALIASES.items() for alias in (*aliases, name)}
    return {header: ours[_plain(header)] for header in headers if _plain(header) in ours}


def read(source: Path, limits: Limits = LIMITS) -> Collection:
    """Read a release: a folder with one CSV and its PNGs anywhere below, or the CSV beside them.

    Raises:
        FormatError: no CSV, or one that cannot be read. A map whose picture or rooms are damaged is left out.
    """
    path = _csv(source)
    if path.stat().st_size > limits.unpacked:
        raise FormatError(f"{path}: has {path.stat().st_size} bytes, expected at most {limits.unpacked}")
    found, movements = Collection(), dict[str, None]()
    pictures = {picture.stem.lower(): picture for picture in walk(path.parent, PICTURES, limits, found.left_out)}
    known: set[int] = set()
    try:
        chunks = pd.read_csv(
            path,
            sep=_separator(_header(path)),
            dtype=str,
            keep_default_na=False,
            index_col=False,
            chunksize=500,
            encoding="utf-8-sig",
            skipinitialspace=True,
        )
        with chunks, warnings.catch_warnings():
            warnings.simplefilter("error")  # of lines with more fields than there are headers
            for chunk in chunks:
                columns = _columns([str(name) for name in chunk.columns])
                missing = [name for name in _NEEDED if name not in columns.values()]
                missing += ["label"] if not {"label", "item"} & set(columns.values()) else []
                if missing:
                    raise FormatError(f"{path}: no column {missing[0]!r} among {', '.join(map(str, chunk.columns))}")
                for row in chunk.rename(columns=columns).to_dict("records"):
                    _read_row({str(name): str(value) for name, value in row.items()}, pictures, found, limits, known)
                    movements[str(row.get("movement", ""))] = None
    except FormatError:
        raise
    except Exception as error:  # pandas raises many kinds: ParserError, UnicodeDecodeError, EmptyDataError, ...
        raise FormatError(f"{path}: not a sound CSV ({type(error).__name__}: {error})") from None
    found.movement = _movement(path, [text for text in movements if text])
    return found


def _movement(path: Path, texts: list[str]) -> Movement:
    if len(texts) > 1:
        raise FormatError(f"{path}: holds maps of {len(texts)} movements, expected one")
    try:
        return Movement(**json.loads(texts[0])) if texts else Movement()
    except (TypeError, ValueError) as error:
        raise FormatError(f"{path}: its movement is {texts[0][:60]!r} ({error})") from None


def _read_row(
    row: dict[str, str], pictures: dict[str, Path], found: Collection, limits: Limits, known: set[int]
) -> None:
    """Add one line of the CSV to ``found``, as a map or as left out."""
    item = row.get("item", "").strip()
    name = row.get("label", "").strip().replace("\\", "/").rsplit("/", 1)[-1] or f"map{item}"
    stem = name[: -len(Path(name).suffix)] if name.lower().endswith(PICTURES) else name
    try:
        picture = pictures.get(stem.lower()) or pictures.get(item.lower())
        if picture is None:
            raise FormatError(f"its picture {stem}{PICTURES[0]} is missing")
        grid = np.asarray(brightness(read_pixels(picture, limits)) >= 128, np.uint8)
        seed_points = _pairs(row, "seed_rows", "seed_columns")
        sizes = _pairs(row, "size_rows", "size_columns")
        directions = np.array(numbers(row.get("direction_for_passages", "")), np.int64)
        n = len(seed_points)
        if n == 0 or sizes.shape not in ((0, 2), (n, 2)) or len(directions) not in (0, 2 * (n - 1)):
            raise FormatError(f"{n} seed points, {len(sizes)} sizes and {len(directions)} directions do not fit")
        if (len(sizes) and (sizes.min() < -1 or sizes.max() > 2**15 - 1)) or not set(directions.tolist()) <= {-1, 0, 1}:
            raise FormatError("its sizes or directions are out of range")
        number = int(item) if item.isdigit() and len(item) < 18 else None
        if number is not None and number in known:
            raise FormatError(f"item {number} stands there twice")
        resolution = float(row["resolution"]) if row.get("resolution") else None
        if resolution is not None and not (resolution > 0 and math.isfinite(resolution)):
            raise FormatError(f"resolution {resolution}, expected metres per cell above 0")
        stated = {name: text for name, text in row.items() if text.strip() and _is_label(name)}
        width = numbers(row.get("passage_size", ""))[:1]
        if width and not -1 <= width[0] < 2**15:
            raise FormatError(f"passage size {width[0]} is out of range")
        one = ForeignMap(
            name=stem,
            cells=grid,
            split=SPLIT_NAMES.get(row.get("split", "").strip().lower()),
            resolution=resolution,
            number=number,
            seed_points=seed_points,
            rooms_known=True,
            sizes=sizes if len(sizes) else None,
            directions=directions.reshape(-1, 2) if len(directions) else None,
            passage_width=width[0] if width else -1,
            check=_Check(stated) if stated else None,
        )
    except (ValueError, OverflowError) as error:
        found.left_out.append((stem, str(error)))
        return
    if number is not None:
        known.add(number)
    found.maps.append(one)


def _pairs(row: dict[str, str], first: str, second: str) -> Ints:
    """Return two cells of the CSV with a number a room as (n, 2)."""
    one, other = numbers(row.get(first, "")), numbers(row.get(second, ""))
    if len(one) != len(other):
        raise FormatError(f"{len(one)} {first} and {len(other)} {second} do not fit")
    return np.array([one, other], np.int64).T


_NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")


def floats(text: str) -> list[float]:
    """Return the numbers of a cell of the CSV, whatever stands between them.

    Raises:
        FormatError: words in it.
    """
    rest = re.sub(r"(array|int64|dtype|np|float64|true|false)", "", _NUMBER.sub("", text).lower())
    if re.search(r"[a-z]", rest):
        raise FormatError(f"the cell {text[:40]!r} is not a list of numbers")
    return [float(number) for number in _NUMBER.findall(text)]


def numbers(text: str) -> list[int]:
    """Return the whole numbers of a cell of the CSV.

    Raises:
        FormatError: others in it.
    """
    values = floats(text)
    if not all(value == int(value) and abs(value) < 2**53 for value in values if math.isfinite(value)):
        raise FormatError(f"the cell {text[:40]!r} holds other than whole numbers")
    return [int(value) for value in values]


class _Check:
    """Compares the labels that a line states with ours."""

    def __init__(self, stated: dict[str, str]) -> None:
        self._stated = stated

    def __call__(self, labels: Labels, k: int) -> list[str]:
        """Return the names of the columns that say otherwise."""
        ours = _row(labels, k, 0)
        return [name for name, text in self._stated.items() if not _same(text, ours[name])]


def _is_label(name: str) -> bool:
    return name in ("connected", "path_exists") or name.startswith(SEARCHES)


def _same(text: str, ours: object) -> bool:
    words = re.sub(r"(?i)\btrue\b", "1", re.sub(r"(?i)\bfalse\b", "0", text))
    try:
        stated = floats(words)
    except FormatError:
        return False
    expected = np.ravel(np.array(ours, float)).tolist()
    return len(stated) == len(expected) and bool(np.allclose(stated, expected, rtol=1e-6, atol=1e-6))
