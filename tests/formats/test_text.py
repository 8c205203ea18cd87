"""Tables and mazes as plain text: what numpy writes and people type, and what is refused."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.wild import Bytes, cli
from PIL import Image

from mapdata import MapDataset, read_shard
from mapdata.formats import FormatError, Limits, files, read_any
from mapdata.formats.registry import recognise
from mapdata.formats.text import read

GRID: Bytes = np.array([[1, 1, 1, 1], [1, 0, 0, 1], [1, 0, 1, 1]], np.uint8)
MAZE = "#######\n#S    #\n# ### #\n#    G#\n#######\n"


@pytest.mark.parametrize(
    ("name", "how"),
    [
        ("a.csv", {"fmt": "%d", "delimiter": ","}),
        ("a.csv", {"fmt": "%d", "delimiter": ";", "newline": "\r\n"}),
        ("a.csv", {"delimiter": ", "}),
        ("a.txt", {"fmt": "%d"}),
        ("a.txt", {"fmt": "%3d"}),
        ("a.TXT", {"fmt": "%.1f", "delimiter": "\t"}),
        ("a.txt", {}),
        ("a.txt", {"fmt": "%d", "delimiter": ""}),
    ],
)
def test_tables_that_numpy_writes_are_read(name: str, how: dict[str, str], tmp_path: Path) -> None:
    """They have any separator, digits and line ends."""
    np.savetxt(tmp_path / name, GRID, **how)
    collection = read_any(tmp_path / name)
    assert (collection.format, collection.maps[0].grid.tolist()) == ("text", GRID.tolist())
    assert collection.notes[0] == "0, and the letters '. SG', were taken for free: 25.0% of a map"
    assert recognise(tmp_path) == "text"


def test_other_tables(tmp_path: Path) -> None:
    """A comma may end the rows, and a byte order mark begin the file, as spreadsheets do."""
    path = tmp_path / "a.csv"
    path.write_text("1,1,\n0,1,\n", encoding="utf-8-sig")
    assert read_any(path).maps[0].grid.tolist() == [[1, 1], [0, 1]]
    assert read_any(path, invert=True).maps[0].grid.tolist() == [[0, 0], [1, 0]]
    path.write_text("t")
    assert "cell (0, 0) is 't'" in read(path).left_out[0][1]


@pytest.mark.parametrize("name", ["many.txt", "many.npy"])
def test_a_bar_counts_the_maps_of_a_long_file_on_request(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the request nothing is shown; half a million maps take half a minute."""
    monkeypatch.setattr(files, "_LONG", 3)
    (tmp_path / "many.txt").write_text("01\n00\n\n00\n00\n\n00\n10\n")
    np.save(tmp_path / "many.npy", np.zeros((3, 2, 2), np.uint8))
    read_any(tmp_path / name)
    assert capsys.readouterr().err == ""
    read_any(tmp_path / name, limits=Limits(progress=True))
    assert "3/3 [00:00<00:00" in capsys.readouterr().err


def test_a_maze_has_start_and_goal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """They become the only seed points of the map, so that its route leads from S to G."""
    path = tmp_path / "maze.txt"
    path.write_text(MAZE)
    (foreign_map,) = read_any(path).maps
    assert foreign_map.seed_points.tolist() == [[1, 1], [3, 5]]
    assert foreign_map.grid.tolist() == [
        [int(letter == "#") for letter in line] for line in MAZE.splitlines()
    ]
    assert cli(capsys, "import", path, tmp_path / "out")[0] == 0
    sample = MapDataset(tmp_path / "out", None, ("start", "goal", "cost"))[0]
    assert (sample.start.tolist(), sample.goal.tolist()) == ([1, 1], [3, 5])
    assert sample.cost == 6
    assert read_shard(next((tmp_path / "out").glob("*.h5"))).maps.rooms.tolist() == [2]


def test_letters_can_be_named(tmp_path: Path) -> None:
    """The error names the letters that are not known; posts and walls of a drawing may be named."""
    path = tmp_path / "mouse.txt"
    path.write_text("xxx\nxSx\nxGx\n")
    refused = r"cell \(0, 0\) is 'x', expected occupied '#@' or free '. SG'; --text.occupied and"
    for format_name, start in (
        (None, "known format; --format text refuses mouse.txt: "),
        ("text", ""),
    ):
        with pytest.raises(FormatError, match=start + refused):
            read_any(path, format_name)
    assert read_any(path, "text", occupied="x").maps[0].grid.sum() == 7
    path.write_text("o---o---o\n|G  |   |\no   o   o\n|      S|\no---o---o\n")
    (foreign_map,) = read_any(path, "text", occupied="o-|").maps
    assert foreign_map.grid.sum() == 2 * 9 + 3 * 2 + 2  # two rows, the outer walls, one wall
    assert foreign_map.seed_points.tolist() == [[3, 7], [1, 1]]
    inverted = read_any(path, "text", occupied=" ", free="o-|", invert=True).maps[0]
    assert np.array_equal(inverted.grid, foreign_map.grid)


@pytest.mark.parametrize("options", [{"occupied": ""}, {"free": "#"}, {"occupied": "#S"}], ids=str)
def test_letters_that_contradict_each_other_are_refused(
    options: dict[str, Any], tmp_path: Path
) -> None:
    """No letter at all, a letter that is both, and one that is a seed point."""
    path = tmp_path / "a.txt"
    path.write_text("####\n#S.#\n# G#\n####\n")
    with pytest.raises(ValueError, match="occupied, free: got"):
        read(path, **options)


def drawing(walls: Bytes, post: str, width: int) -> str:
    """Return a maze as micromouse contests draw it.

    Args:
        walls: (2 R + 1, 2 C + 1), 1 where a post or wall is.
        post: letter of a post.
        width: letters of a square.
    """
    lines = []
    for row, cells in enumerate(walls.tolist()):
        line = ""
        for column, cell in enumerate(cells):
            letters = "|" if column % 2 == 0 else " " * width
            if row % 2 == 0:
                letters = post if column % 2 == 0 else "-" * width
            line += letters if cell else " " * len(letters)
        lines.append(line.rstrip())  # as editors do
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(("post", "width"), [("o", 3), ("+", 2), ("+", 1), ("o", 4)])
def test_drawings_of_mazes_are_read(post: str, width: int, tmp_path: Path) -> None:
    """Each post, wall and square is one cell, however wide it is drawn; S and G lie in squares."""
    random = np.random.default_rng(width)
    walls = random.integers(0, 2, (9, 13)).astype(np.uint8)
    walls[::2, ::2] = 1  # posts
    walls[1::2, 1::2] = 0  # squares
    walls[0] = walls[-1] = 1
    walls[1, 0] = 1
    lines = [line.ljust(6 * (width + 1) + 1) for line in drawing(walls, post, width).splitlines()]
    middle = 1 + (width - 1) // 2
    for row, square, letter in ((7, 0, "S"), (3, 2, "G"), (3, 3, "G")):
        column = square * (width + 1) + middle
        lines[row] = lines[row][:column] + letter + lines[row][column + 1 :]
    path = tmp_path / "mouse.txt"
    path.write_text("\n".join(line.rstrip() for line in lines) + "\n")
    collection = read_any(path)
    (foreign_map,) = collection.maps
    assert np.array_equal(foreign_map.grid, walls)
    assert foreign_map.seed_points.tolist() == [[7, 1], [3, 5], [3, 7]]
    assert foreign_map.rooms_known
    assert "1 of 1 maps are drawings of mazes" in collection.notes[0]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("+--+--+\n|  |  |\n+--+--+\n|  |  |\n", "the drawing has 4 rows, expected an odd number"),
        (
            "+--+--+\n|  |  |\n+--+-+\n",
            "row 2 of the drawing does not fit: expected posts '+' at e",
        ),
        ("+--+-+\n|  | |\n+--+-+\n", "row 0 of the drawing does not fit"),
        ("+--+\n|  |\n+- +\n", "row 2 of the drawing does not fit"),
        ("+--+\n|SG|\n+--+\n", "row 1 of the drawing does not fit"),
        ("+--+--+\n|     |\n+--+--+--+\n", "row 2 of the drawing does not fit"),
    ],
)
def test_drawings_that_are_not_in_line_are_refused(text: str, reason: str, tmp_path: Path) -> None:
    """A row would be read wrongly otherwise."""
    (tmp_path / "a.txt").write_text(text)
    ((_, said),) = read(tmp_path).left_out
    assert said.startswith(reason)


@pytest.mark.parametrize("separator", [" ", "\t", ",", ";"])
def test_letters_may_have_separators(separator: str, tmp_path: Path) -> None:
    """Spaces between walls are no free cells if other letters are."""
    rows = ["#####", "#S.G#", "#####"]
    (tmp_path / "a.txt").write_text("".join(separator.join(row) + "\n" for row in rows))
    (foreign_map,) = read_any(tmp_path).maps
    assert foreign_map.grid.tolist() == [[1] * 5, [1, 0, 0, 0, 1], [1] * 5]
    assert foreign_map.seed_points.tolist() == [[1, 1], [1, 3]]


def test_spaces_are_cells_where_no_other_letter_is_free(tmp_path: Path) -> None:
    """Two walls with a corridor are no wall of two cells."""
    (tmp_path / "a.txt").write_text("# #\n# #\n")
    assert read_any(tmp_path).maps[0].grid.tolist() == [[1, 0, 1]] * 2


def test_a_header_of_numpy_is_skipped(tmp_path: Path) -> None:
    """`numpy.loadtxt` skips these lines, too."""
    np.savetxt(tmp_path / "a.txt", GRID, fmt="%d", header="my map\n3 x 4")
    assert np.array_equal(read_any(tmp_path).maps[0].grid, GRID)


def test_a_file_may_hold_several_maps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Empty lines are between them, and a line of spaces is a row of free cells."""
    (tmp_path / "train").mkdir()
    path = tmp_path / "train" / "mazes.txt"
    path.write_text(".#\n  \n\n\n##\n..\n\n")
    first, second = read_any(tmp_path).maps
    assert (first.grid.tolist(), second.grid.tolist()) == ([[0, 1], [0, 0]], [[1, 1], [0, 0]])
    assert (second.name, second.split) == (f"{path}[1]", 0)
    assert cli(capsys, "import", tmp_path, tmp_path / "out")[0] == 0
    shard = next((tmp_path / "out").glob("*.h5"))
    assert read_shard(shard).maps.occupancy.tolist() == [first.grid.tolist(), second.grid.tolist()]
    assert (
        "holds more maps than expected, which are at most 1"
        in read(path, Limits(maps=1)).left_out[0][1]
    )


@pytest.mark.parametrize("text", ["0 " * 9 + "\n", "#" * 9 + "\n", "1" * 9 + "\n", ".\n" * 9])
def test_texts_beyond_the_limit_are_left_out(text: str, tmp_path: Path) -> None:
    """One row or many, of numbers or letters."""
    (tmp_path / "a.txt").write_text(text)
    collection = read(tmp_path, Limits(pixels=8))
    assert collection.maps == []
    ((_, said),) = collection.left_out
    assert re.search("has (1 x 9|9 x 1) pixels, expected at most 8 in all", said)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            "True,False\nFalse,True\n",
            "is a table of True and False: values.astype(int) makes 1 and",
        ),
        ("true\nfalse\n", "is a table of True and False: values.astype(int) makes 1 and 0 of"),
        ('"True" "False"\n', "is a table of True and False: values.astype(int) makes 1 and 0 of"),
        ('"0","1"\n"1","0"\n', "its numbers stand in quotes: values.astype(int) makes numbers of"),
        ("'0';'1'\n'1';'0'\n", "its numbers stand in quotes: values.astype(int) makes numbers of"),
        ("0,0;1,0\n0,0;0,5\n", "has decimal commas, as spreadsheets write them in some countries"),
        ("sep=;\n0;1\n", "row 0 is 'sep=;', which tells Excel the separator: remove this line"),
        ("2 3\n0 1 0\n0 0 0\n", "begins with its size, '2 3': remove what is above row 0"),
        ("3 2\n0 1 0\n0 0 0\n", "begins with its size, '3 2': remove what is above row 0"),
        ("2\n3\n010\n000\n", "begins with its size, '2 3': remove what is above row 0"),
        ("2x3\n#.#\n...\n", "begins with its size, '2x3': remove what is above row 0"),
        ("2\n# #\n. .\n", "begins with its size, '2': remove what is above row 0"),
        ("type octile\nheight 2\n", "looks like a map of MovingAI: its name should end with .map"),
    ],
)
def test_what_other_programs_write_is_named(text: str, reason: str, tmp_path: Path) -> None:
    """One sentence says what the file is and what to do, with and without --format."""
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(FormatError, match=f"a.csv: {re.escape(reason)}"):
        read_any(path, "text")
    with pytest.raises(FormatError, match=f"--format text refuses a.csv: {re.escape(reason)}"):
        read_any(path)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be"])
def test_text_in_utf_16_is_named(encoding: str, tmp_path: Path) -> None:
    """PowerShell redirects output to such files."""
    path = tmp_path / "a.csv"
    path.write_text("\ufeff0,1\n1,0\n", encoding=encoding)
    with pytest.raises(
        FormatError, match=r"not text in UTF-8; it looks like text in UTF-16.*: save"
    ):
        read_any(path)


@pytest.mark.parametrize(
    "text", ["1\n0\n", "1\n1\n", "1 1\n1 1\n", "10\n01\n", "11\n" * 11, "1 0\n0 1\n"]
)
def test_a_table_without_its_size_is_read(text: str, tmp_path: Path) -> None:
    """Its first rows could be taken for a size, but do not fit."""
    path = tmp_path / "a.csv"
    path.write_text(text)
    assert read_any(path, "text").maps[0].shape[0] == text.count("\n")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("README.txt", "Floor plans of two houses.\nDark is occupied.\n"),
        ("notes.txt", "plan A\nplan B\n"),
        ("poses.txt", "0.5 1.25 3.0\n0.75 1.5 3.1\n"),
        ("labels.csv", "0\n1\n1\n"),
        ("table.csv", "name,rows\na,4\n"),
        ("ids.csv", "1000,1\n1001,0\n"),
        ("one.txt", "##\n"),
        ("binary.csv", "\x80\x81\n\x80\x81\n"),
    ],
)
def test_other_texts_beside_pictures_are_not_maps(name: str, text: str, tmp_path: Path) -> None:
    """A folder of pictures stays one."""
    Image.fromarray(255 * (1 - GRID)).save(tmp_path / "plan.png")
    (tmp_path / name).write_text(text, encoding="latin-1")
    assert recognise(tmp_path) == "images"
    advice = (
        rf"; (--format text refuses {name}: \w.*|{name} has the ending of text: --format text )"
    )
    with pytest.raises(FormatError, match=advice):
        read_any(tmp_path / name)


def test_an_ending_that_no_format_reads_is_named(tmp_path: Path) -> None:
    """The error lists endings instead of formats, none of which has this one."""
    for source in (tmp_path / "map.mat", tmp_path):
        (tmp_path / "map.mat").write_text("x")
        with pytest.raises(FormatError, match=r"known format; expected files that end with .bmp,"):
            read_any(source)


def test_a_wide_table_is_recognised(tmp_path: Path) -> None:
    """Two rows of 4096 numbers have 200 KB as numpy writes them."""
    np.savetxt(tmp_path / "a.txt", np.zeros((2, 4096)))
    assert recognise(tmp_path / "a.txt") == "text"
