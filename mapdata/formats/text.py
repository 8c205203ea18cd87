"""Plain text as maps: tables of 0 and 1, and mazes of letters.

A file of either kind holds one map, or several with empty lines between them.

- The rows of a table are numbers with commas, semicolons, tabs or spaces between them, as
  spreadsheets and `numpy.savetxt` write them, or digits 0 and 1 alone.
- The rows of a maze are letters: "#" and "@" are occupied, "." and " " free, "S" is the start and
  "G" a goal. The same separator, such as a tab, may be between all letters.
- A drawing of a maze has posts, "+" or "o", with walls between them, "-" and "|", as micromouse
  contests publish them. Posts, walls and squares become a cell each.
"""

from __future__ import annotations

import codecs
import re
from pathlib import Path

import numpy as np

from mapdata.arrays import Array, Bytes, Ints
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import (
    LIMITS,
    Limits,
    check_pixels,
    files_with_endings,
    maps_bar,
    read_text,
    split_from_folders,
    to_occupancy,
)
from mapdata.formats.images import note_free_cells
from mapdata.formats.registry import Format
from mapdata.npy import FormatError, refusing

ENDINGS = (".txt", ".csv")

OCCUPIED = "#@"
"""The letters of occupied cells by default."""

FREE = ". "
"""The letters of free cells by default."""

_START, _GOAL = "S", "G"
"""The letters of start and goals, which are free cells."""

_COMMENT = "#"
"""What `numpy.savetxt` and `numpy.loadtxt` have before lines that are no rows of a table."""

_SEPARATORS = " \t,;"
"""What may be between the letters of a maze."""

_POSTS = re.compile(r"([+o])(-+| +)[+o]((-+| +)[+o])*")
"""The first row of a drawing of a maze: posts, with walls or openings between them."""

_SQUARES = re.compile(rf"[| {_START}{_GOAL}]+")
"""The second row of a drawing: walls, and the squares between them."""

_NO_HEADER = (
    "a table has neither header nor index; pandas leaves them out with "
    "to_csv(path, header=False, index=False)"
)
"""What to do about the first row of a table that is none of its rows."""

_DIGITS = re.compile(r"[01]+")
"""A row of a table without anything between its numbers."""

_NUMBERS = re.compile(r"[-+.0-9eE,;\t naifNAIF]+")
"""What the numbers and separators of a row consist of."""

_DIGIT = re.compile("[0-9]")

_EXCEL = re.compile("sep=.", re.IGNORECASE)
"""A first line that Excel writes and reads."""

_DECIMAL_COMMAS = re.compile(r"-?[0-9]+,[0-9]+([;\t]-?[0-9]+,[0-9]+)+")
"""A row of numbers such as 0,5;1,0."""

_SIZE = re.compile(r"\s*[0-9]{1,5}([\s,;x]+[0-9]{1,5})?\s*")
"""The size of a map, on one line or two."""

_FIELD = re.compile(r"[^,;\s]+")
"""A number of a row."""

_SNIFFED = 2**20
"""Number of bytes by which a file is recognised; two rows of 4096 numbers in full have 205 KB."""


def is_text_map(path: Path) -> bool:
    """Return whether a file begins with two rows of a map, of equal length.

    These are rows of letters that cells have by default, or of at least two numbers that are whole
    and from -1 to 255, or infinite. So tables of other numbers beside maps, such as poses, are not
    taken for maps.
    """
    with path.open("rb") as file:
        start = file.read(_SNIFFED)
    text = start.removeprefix(codecs.BOM_UTF8).decode("latin-1").replace("\r\n", "\n")
    rows = _without_comments([line for line in text.split("\n", 1000) if line])[:2]
    if len(rows) < 2:
        return False
    if _POSTS.fullmatch(rows[0].rstrip()) and _SQUARES.fullmatch(rows[1]):
        return "|" in rows[1]
    first, second = rows = _without_separators(rows)
    if _is_row_of_table(first):
        try:
            numbers = _table("", rows)
        except FormatError:
            return False
        is_whole = (numbers == np.floor(numbers)) & (numbers >= -1) & (numbers <= 255)
        return bool((is_whole | (numbers == np.inf)).all()) and numbers.shape[1] > 1
    letters = set(OCCUPIED + FREE + _START + _GOAL)
    return len(first) == len(second) > 1 and letters.issuperset(first + second)


def read(
    source: Path,
    limits: Limits = LIMITS,
    *,
    occupied: str = OCCUPIED,
    free: str = FREE,
    invert: bool = False,
) -> Collection:
    """Read a table of 0 and 1 or a maze of letters, or all below a folder.

    The start S and the goal G of a maze become the seed points of the map.

    Args:
        source: file or folder.
        limits: of what is read.
        occupied: letters of occupied cells of a maze.
        free: letters of free cells of a maze, besides S and G.
        invert: exchange free and occupied cells.

    Raises:
        FormatError: nothing there. A bad file among others is left out, with the reason.
        ValueError: a letter in both options, or none in one of them.
    """
    free_letters = free + _START + _GOAL
    if not occupied or not free or set(occupied) & set(free_letters):
        raise ValueError(
            f"occupied, free: got {occupied!r} and {free!r}, expected different letters in each, "
            f"and neither {_START} nor {_GOAL} among the occupied ones"
        )
    collection = Collection()
    drawing_count = 0
    for path in files_with_endings(source, ENDINGS, limits, collection):
        with collection.leaving_out(path):
            blocks = _blocks(path, read_text(path, limits), limits)
            split = split_from_folders(path, source)
            drawings = {}
            if (occupied, free) == (OCCUPIED, FREE):
                drawings = {name: _drawn_cells(name, lines) for name, lines in blocks}
            # All are parsed before any is used, so that a damaged file gives no map.
            parsed = []
            with maps_bar(limits, len(blocks)) as advance:
                for name, lines in blocks:
                    rows = drawings.get(name) or lines
                    parsed.append(_parsed(name, rows, split, occupied, free, invert))
                    advance(1)
            collection.maps += parsed
            drawing_count += sum(cells is not None for cells in drawings.values())
    if drawing_count:
        collection.notes.append(
            f"{drawing_count} of {len(collection.maps)} maps are drawings of mazes: square (r, c) "
            "is cell (2 r + 1, 2 c + 1), and posts and walls are cells between the squares"
        )
    free_cells = f"0, and the letters {free_letters!r},"
    if invert:
        free_cells = f"1, and the letters {occupied!r},"
    note_free_cells(collection, free_cells, "--text.invert exchanges free and occupied")
    return collection


def _blocks(path: Path, text: str, limits: Limits) -> list[tuple[str, list[str]]]:
    """Return the name and the lines of each map in a file.

    Raises:
        FormatError: no map; more maps, or more cells in one, than the limits allow.
    """
    # A line of spaces is a row of free cells, so only an empty line ends a map.
    texts = re.split(r"\n{2,}", text.strip("\n"), maxsplit=limits.maps)
    if texts == [""]:
        raise FormatError(f"{path}: holds no map")
    if len(texts) > limits.maps:
        raise FormatError(f"{path}: holds more maps than expected, which are at most {limits.maps}")
    blocks = []
    for number, block in enumerate(texts):
        name = f"{path}[{number}]" if len(texts) > 1 else str(path)
        # The cells are counted before the text is divided, which takes many times its memory.
        first, *_ = block.split("\n", 1)
        columns = len(first)
        if _is_row_of_table(first) and not _DIGITS.fullmatch(first):
            columns = sum(1 for _ in _FIELD.finditer(first))
        check_pixels(name, block.count("\n") + 1, columns, limits)
        blocks.append((name, block.split("\n")))
    return blocks


def _is_row_of_table(line: str) -> bool:
    """Return whether a line is a row of numbers, and not of the letters of a maze."""
    return bool(_NUMBERS.fullmatch(line) and _DIGIT.search(line))


def _parsed(
    name: str, lines: list[str], split: int | None, occupied: str, free: str, invert: bool
) -> ForeignMap:
    """Return the map of some lines.

    Args:
        name: of the map.
        lines: its rows.
        split: code of its split; None to draw it.
        occupied: letters of occupied cells.
        free: letters of free cells.
        invert: exchange free and occupied cells.

    Raises:
        FormatError: the lines are neither a table of 0 and 1 nor a maze.
    """
    seed_points: Ints = np.empty((0, 2), np.int64)
    rooms_known = False
    lines = _without_comments(lines)
    surplus = _surplus(lines)
    if surplus:
        raise FormatError(f"{name}: {surplus}")
    if _is_row_of_table(lines[0]):
        numbers = _table(name, lines)
        if len(numbers) > 1 and numbers.shape[1] > 2 and _counts_columns(numbers[0]):
            raise FormatError(f"{name}: row 0 numbers the columns, as a header does: {_NO_HEADER}")
        grid = to_occupancy(numbers, name)
    elif len(lines) > 1 and _is_row_of_table(lines[1]):
        raise FormatError(
            f"{name}: row 0 is no row of numbers, but {lines[0][:40]!r}: {_NO_HEADER}"
        )
    elif lines[0].lstrip()[:1] in ("[", "("):
        raise FormatError(
            f"{name}: looks like lists of Python or JSON: np.savetxt(path, values, fmt='%d') "
            "writes a table"
        )
    else:
        lines = _without_separators(lines)
        letters = _letters(name, lines)
        start, goals = _start_and_goals(name, letters)
        seed_points = np.concatenate((start, goals))
        rooms_known = min(len(start), len(goals)) > 0
        grid = _grid_of_letters(name, letters, occupied, free)
    if invert:
        grid = 1 - grid
        grid[tuple(seed_points.T)] = 0
    return ForeignMap(name, grid, split, seed_points=seed_points, rooms_known=rooms_known)


def _surplus(lines: list[str]) -> str:
    """Return a sentence on what other programs write into a table or before it; empty if nothing.

    Such files would otherwise be refused for a letter or for the length of a row.
    """
    first = lines[0].strip()
    if _EXCEL.fullmatch(first):
        return f"row 0 is {first!r}, which tells Excel the separator: remove this line"
    if first.lower().startswith("type "):
        return "looks like a map of MovingAI: its name should end with .map"
    if _DECIMAL_COMMAS.fullmatch(first):
        return "has decimal commas, as spreadsheets write them in some countries: expected 0 and 1"
    plain = first.replace('"', "").replace("'", "")
    if {field.strip().lower() for field in _fields(plain)} <= {"true", "false"}:
        return "is a table of True and False: values.astype(int) makes 1 and 0 of them"
    if plain != first and _is_row_of_table(plain):
        return "its numbers stand in quotes: values.astype(int) makes numbers of texts"
    for count in (1, 2):
        if _is_size(lines[:count], lines[count:]):
            return f"begins with its size, {' '.join(lines[:count])!r}: remove what is above row 0"
    return ""


def _is_size(above: list[str], below: list[str]) -> bool:
    """Return whether lines above a map give its rows and columns, in either order."""
    text = " ".join(above)
    if not below or not _SIZE.fullmatch(text):
        return False
    numbers = [int(number) for number in re.findall("[0-9]+", text)]
    if len(numbers) == 1:  # of a square map
        numbers *= 2
    is_table = _is_row_of_table(below[0]) and not _DIGITS.fullmatch(below[0])
    rows = len(below)
    columns = len(_fields(below[0]) if is_table else _without_separators(below)[0])
    return sorted(numbers) == sorted((rows, columns)) != [1, 1]


def _without_comments(lines: list[str]) -> list[str]:
    """Return the lines of a map without the comments before a table, as `numpy.savetxt` writes."""
    for number, line in enumerate(lines):
        if _is_row_of_table(line):
            return lines[number:]
        if not line.startswith(_COMMENT):
            break
    return lines


def _without_separators(lines: list[str]) -> list[str]:
    """Return the rows of a maze without what is between the letters of all rows, if anything is.

    A space may be a free cell. So spaces are separators only if no cell is a space, and if other
    letters of free cells are there.
    """
    separator = lines[0][1:2]
    if not separator or separator not in _SEPARATORS:
        return lines
    stripped = [line.rstrip(_SEPARATORS) for line in lines]
    cells = [line[::2] for line in stripped]
    between = set().union(*(line[1::2] for line in stripped))
    letters = set().union(*cells)
    is_plain = separator == " " and letters.isdisjoint(FREE.replace(" ", "") + _START + _GOAL)
    if between != {separator} or " " in letters or is_plain:
        return lines
    return cells


def _counts_columns(numbers: Array) -> bool:
    """Return whether a row of numbers, (W,), is 0, 1, 2, ... or 1, 2, 3, ..."""
    return bool((np.diff(numbers) == 1).all() and numbers[0] in (0, 1))


def _drawn_cells(name: str, lines: list[str]) -> list[str] | None:
    """Return the rows of a drawing of a maze with one letter for each post, wall and square.

    Args:
        name: of the map, for errors.
        lines: of the file; spaces at the end of a line may be missing.

    Returns:
        2 R + 1 rows of 2 C + 1 letters for R x C squares: "#" for posts and walls, and the letter
        in each square, which is a space if there is none; None if this is no drawing.

    Raises:
        FormatError: posts or walls that are not in line.
    """
    first_row = lines[0].rstrip()
    if not _POSTS.fullmatch(first_row) or len(lines) < 2 or not _SQUARES.fullmatch(lines[1]):
        return None
    post = first_row[0]
    pitch = first_row.index(post, 1)
    width = len(first_row)
    rows = []
    for row, line in enumerate(lines):
        padded = line.rstrip().ljust(width)
        posts = padded[::pitch]
        between = [padded[left + 1 : left + pitch] for left in range(0, width - 1, pitch)]
        is_wall_row = row % 2 == 0
        if is_wall_row:
            letters = ["#" if text == "-" * len(text) else text.strip() for text in between]
        else:
            letters = [text.strip() for text in between]
        is_in_line = (
            len(padded) == width
            and set(posts) <= ({post, " "} if is_wall_row else {"|", " "})
            and all(len(letter) <= 1 for letter in letters)
            and not (is_wall_row and set(letters) - {"#", ""})
        )
        if not is_in_line:
            raise FormatError(
                f"{name}: row {row} of the drawing does not fit: expected posts {post!r} at every "
                f"{pitch}th letter of the even rows, with walls of - and | between them, and at "
                "most one letter in a square"
            )
        cells = ["#" if corner != " " else " " for corner in posts]
        rows.append(
            "".join(
                corner + (letter or " ")
                for corner, letter in zip(cells, [*letters, ""], strict=True)
            )[:-1]
        )
    if len(rows) % 2 == 0:
        raise FormatError(f"{name}: the drawing has {len(rows)} rows, expected an odd number")
    return rows


def _fields(line: str, max_count: int = -1) -> list[str]:
    """Return the numbers of a row as texts; between two commas in a row is an empty text.

    If there are more than ``max_count``, the last text holds all others.
    """
    for separator in (",", ";"):
        if separator in line:
            return line.rstrip(" \t").removesuffix(separator).split(separator, max_count)
    return line.split(None, max_count)


def _table(name: str, lines: list[str]) -> Array:
    """Return the numbers of a table, (H, W) float64, whose rows are ``lines``.

    Raises:
        FormatError: rows of several lengths, or what is not a number.
    """
    are_digits = all(_DIGITS.fullmatch(line) for line in lines)
    columns = len(lines[0]) if are_digits else len(_fields(lines[0]))
    numbers = np.empty((len(lines), columns))
    for row, line in enumerate(lines):
        fields = list(line) if are_digits else _fields(line, columns)
        if len(fields) != columns:
            count = f"more than {columns}" if len(fields) > columns else len(fields)
            raise FormatError(
                f"{name}: row {row} has {count} numbers, expected {columns} as in row 0"
            )
        with refusing(f"{name}: row {row} is no row of numbers, without header and index"):
            numbers[row] = fields
    return numbers


def _letters(name: str, lines: list[str]) -> Array:
    """Return the letters of a maze, (H, W) of texts of one letter.

    Raises:
        FormatError: rows of several lengths.
    """
    columns = len(lines[0])
    for row, line in enumerate(lines):
        if len(line) != columns:
            raise FormatError(
                f"{name}: row {row} has {len(line)} letters, expected {columns} as in row 0 "
                "(many editors remove spaces at the end of a line)"
            )
    # numpy stores a text as letters of a fixed size, which a view makes cells.
    return np.array(lines).view("U1").reshape(len(lines), columns)


def _start_and_goals(name: str, letters: Array) -> tuple[Ints, Ints]:
    """Return the start of a maze, (1, 2) or (0, 2), and its goals, (n, 2).

    Raises:
        FormatError: several starts.
    """
    start, goals = (np.argwhere(letters == letter) for letter in (_START, _GOAL))
    if len(start) > 1:
        raise FormatError(f"{name}: has {len(start)} letters {_START}, expected at most one")
    return start, goals


def _grid_of_letters(name: str, letters: Array, occupied: str, free: str) -> Bytes:
    """Return a maze as a grid, (H, W) uint8, 0 free and 1 occupied.

    Raises:
        FormatError: a letter that is neither.
    """
    is_occupied = np.isin(letters, list(occupied))
    is_known = is_occupied | np.isin(letters, [*free, _START, _GOAL])
    if not is_known.all():
        row, column = np.argwhere(~is_known)[0].tolist()
        raise FormatError(
            f"{name}: cell {row, column} is {str(letters[row, column])!r}, expected occupied "
            f"{occupied!r} or free {free + _START + _GOAL!r}; --text.occupied and --text.free "
            "name other letters"
        )
    return is_occupied.view(np.uint8)


FORMAT = Format("text", ENDINGS, read, recognises=is_text_map)
