"""MovingAI: files as they are on the web, lengths against scipy, and every fault of a file."""

from __future__ import annotations

import math
import re
import tempfile
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.wild import GRIDS, SETTINGS, Bytes, cli, lengths
from hypothesis import given
from hypothesis import strategies as st

from mapdata import ProblemSet, read_shard
from mapdata.evaluation import classical, evaluate
from mapdata.formats import FormatError, Limits, export, read_any, read_problems
from mapdata.formats.movingai import check_scen, read_terrain, terrain_grid
from mapdata.formats.movingai_scen import Problem, agrees, read_scen
from mapdata.movement import Movement
from mapdata.shards import read_manifest

MAP = "type octile\nheight 4\nwidth 6\nmap\n..G@WW\n.S.OWW\n.T..WW\n......\n"
LAND = [[0, 0, 0, 1, 1, 1], [0, 0, 0, 1, 1, 1], [0, 1, 0, 0, 1, 1], [0, 0, 0, 0, 0, 0]]
WATER = [[1, 1, 1, 1, 0, 0], [1, 1, 1, 1, 0, 0], [1, 1, 1, 1, 0, 0], [1, 1, 1, 1, 1, 1]]
# By hand; x before y. Around the tree (x 1, y 2) no corner is cut; nothing leads from land to
# water.
SCEN = (
    "version 1\n"
    "0\tcave.map\t6\t4\t0\t0\t0\t3\t3\n"
    "0\tcave.map\t6\t4\t1\t1\t3\t3\t3.41421\n"
    "0\tcave.map\t6\t4\t0\t1\t1\t3\t3\n"
    "1\tcave.map\t6\t4\t0\t0\t5\t3\t6.82842712\n"
    "0\tcave.map\t6\t4\t0\t0\t4\t0\t0\n"
    "0\tcave.map\t6\t4\t4\t0\t5\t2\t2.4142135623730950\n"
    "0\tcave.map\t6\t4\t1\t1\t1\t1\t0.0\n"
)


def files(folder: Path, scen: str = SCEN, text: str = MAP) -> Path:
    """Write a map and its problems; return the .scen."""
    (folder / "cave.map").write_text(text)
    (folder / "cave.map.scen").write_text(scen)
    return folder / "cave.map.scen"


@pytest.mark.parametrize(
    "text",
    [
        MAP,
        MAP.replace("\n", "\r\n"),
        MAP + "\nDrawn in 2011.\n@@@@@@@@@@@@\n",
        MAP.rstrip("\n"),
        MAP.replace("height 4\nwidth 6", "width 6\nheight 4"),
        MAP.replace("type octile\n", ""),
        MAP.replace("..G@WW\n", "..G@WW  \t\n"),
        MAP.replace("type octile", "Type\tOctile").replace("height 4", "Height\t4"),
        "\ufeff" + MAP,
    ],
)
def test_variants_of_published_maps_are_read(text: str, tmp_path: Path) -> None:
    """They have CRLF, text after the rows, no last line feed, or another order of the header."""
    (tmp_path / "a.map").write_bytes(text.encode("utf-8"))
    terrain = read_terrain(tmp_path / "a.map")
    assert terrain_grid(terrain).tolist() == LAND
    assert terrain_grid(terrain, "W").tolist() == WATER


def test_damage_after_an_empty_line_is_refused(tmp_path: Path) -> None:
    """Words right after an empty line are a citation, which ends the file; later words
    are damage.
    """
    path = files(tmp_path)
    head, problem = path.read_text().splitlines()[:2]
    path.write_text(f"{head}\n{problem}\n\nPlease cite us.\n")
    assert len(read_scen(path)) == 1
    path.write_text(f"{head}\n{problem}\n\n{problem}\nPlease cite us.\n{problem}\n")
    with pytest.raises(FormatError, match="line 5"):
        read_scen(path)


def test_both_versions_of_scen_files_are_read(tmp_path: Path) -> None:
    """Fields may be separated by tabs or spaces, lines by CRLF, and names may hold spaces; x is the
    column.
    """
    new = Problem(3, "dao/big cave.map", (4, 6), (3, 1), (0, 5), "12.0711", 2, 1e-4)
    path = tmp_path / "a.scen"
    path.write_bytes(b"version 1.0\r\n3\tdao/big cave.map\t6\t4\t1\t3\t5\t0\t12.0711\r\n\r\n")
    assert read_scen(path) == [new]
    path.write_text("3 dao/cave.map 6 4 1 3 5 0 12.0711\n")
    assert read_scen(path) == [new._replace(map="dao/cave.map", line=1)]
    path.write_text("3 dao/cave.map 1 3 5 0 12.0711\n")
    assert read_scen(path) == [new._replace(map="dao/cave.map", line=1, size=None)]
    path.write_text(
        "\nversion 1\n3 dao/cave.map 1 3 5 0 12.0711\n\n////\n  article{sturtevant2012,\n  "
        "volume={4},\n}\n"
    )
    assert read_scen(path) == [new._replace(map="dao/cave.map", line=3, size=None)]


@pytest.mark.parametrize(
    ("printed", "message"),
    [
        # as the benchmark's own files print seven and twelve diagonals, and with the exact root
        (["9.89949493", "16.97056274", "2.00000000"], 3),
        (["9.89949494", "16.97056275", "2.00000000"], 3),
        (["9.89949492", "16.97056273", "2.00000001"], 0),
        (["9.89949493661", "16.9705627485", "2"], 3),
        (["9.89949", "16.9706", "2"], 3),
        (["9.89948", "16.9705", "2.00001"], 0),
        # two decimals: the last zero says so
        (["9.90", "16.97", "2.00"], 3),
        (["9.9", "16.97", "2"], 1),
        (["9.90", "16.97", "2.01"], 2),
        (["9.89", "16.98", "2.01"], 0),
    ],
)
def test_lengths_agree_up_to_their_last_printed_digit(
    printed: list[str], message: int, tmp_path: Path
) -> None:
    """This holds for each approximation of the square root of 2 that files use."""
    side = 13
    (tmp_path / "a.map").write_text(
        f"type octile\nheight {side}\nwidth {side}\nmap\n" + ("." * side + "\n") * side
    )
    ends = ("7\t7", "12\t12", "0\t2")
    lines = (
        f"0\ta.map\t{side}\t{side}\t0\t0\t{end}\t{text}\n"
        for end, text in zip(ends, printed, strict=True)
    )
    (tmp_path / "a.scen").write_text("version 1\n" + "".join(lines))
    assert check_scen(tmp_path / "a.scen").agreed == message


def test_equal_numbers_of_decimals_are_fixed_decimals(tmp_path: Path) -> None:
    """In a part of a published file, 16.97 does not stand for 16.9700."""
    (tmp_path / "a.map").write_text(
        "type octile\nheight 13\nwidth 13\nmap\n" + 13 * f"{13 * '.'}\n"
    )
    (tmp_path / "a.scen").write_text("version 1\n0\ta.map\t13\t13\t0\t0\t12\t12\t16.97\n")
    assert check_scen(tmp_path / "a.scen").agreed == 1


def test_long_lengths_agree_with_an_approximate_root() -> None:
    """A length has 1,500 cells and 600 diagonals, with the benchmark's nine decimals of
    the root.
    """
    for straight, diagonal in ((687, 600), (1, 1023), (1500, 1)):
        exact = straight + diagonal * math.sqrt(2)
        theirs = straight + diagonal * 1.414213562
        assert agrees(Problem(0, "", None, (0, 0), (1, 1), f"{theirs:.8f}", 1, 1e-8), exact)
        for wrong in (-2e-6, 2e-8):
            assert not agrees(
                Problem(0, "", None, (0, 0), (1, 1), f"{exact + wrong:.8f}", 1, 1e-8), exact
            )


def test_check_scen_agrees_with_lengths_by_hand(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """All lengths on land and water, without a cut corner and without a path agree, and the exit
    code is 0.
    """
    path = files(tmp_path)
    code, out, err = cli(capsys, "check-scen", path)
    assert (code, err) == (0, "")
    assert "7 of 7 optimal lengths agree" in out
    elsewhere = tmp_path / "scens"
    elsewhere.mkdir()
    (elsewhere / "x.scen").write_text(SCEN.replace("cave.map", "maps/dao/cave.map"))
    assert cli(capsys, "check-scen", elsewhere / "x.scen", "--maps", tmp_path)[0] == 0
    assert cli(capsys, "check-scen", elsewhere / "x.scen", path)[0] == 2


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("3.41421\n", "3.41422\n", r"line 3: \(1, 1\) to \(3, 3\) \(row, col\): says 3.41422"),
        ("6.82842712", "6.82842714", "says 6.82842714"),
        ("4\t0\t0\n0", "4\t0\t4\n0", "says 4, found no path"),
        ("0\t0\t0\t3\t3\n", "0\t0\t0\t3\t0\n", "says 0, found 3.0"),
    ],
)
def test_check_scen_names_the_line_of_a_wrong_length(
    old: str, new: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One of seven lengths is wrong, and the exit code is 1."""
    assert SCEN.count(old) == 1
    code, out, err = cli(capsys, "check-scen", files(tmp_path, SCEN.replace(old, new)))
    assert code == 1
    assert err == "mapdata: 1 of 7 optimal lengths disagree\n"
    assert "6 of 7 optimal lengths agree" in out
    assert re.search(message, out)


@SETTINGS
@given(GRIDS, st.data())
def test_lengths_of_scipy_agree(grid: Bytes, data: st.DataObject) -> None:
    """All pairs of a random map agree in the three precisions of published files; a slightly larger
    length does not.
    """
    free = np.argwhere(grid == 0).tolist()
    if not free:
        return
    start = data.draw(st.sampled_from(free))
    distances = lengths(grid, (start[0], start[1]), cut=False, diagonal=math.sqrt(2))
    folder = Path(tempfile.mkdtemp())
    rows = "\n".join("".join(".@"[cell] for cell in row) for row in grid.tolist())
    (folder / "a.map").write_text(
        f"type octile\nheight {grid.shape[0]}\nwidth {grid.shape[1]}\nmap\n{rows}\n"
    )
    lines = []
    for row, column in free:
        length = distances[row, column] if np.isfinite(distances[row, column]) else 0.0
        for text in (f"{length:.6g}", f"{length:.8f}", f"{length:.16f}"):
            lines.append(
                f"0\ta.map\t{grid.shape[1]}\t{grid.shape[0]}\t{start[1]}\t{start[0]}\t{column}\t{row}\t{text}"
            )
    (folder / "a.scen").write_text("version 1\n" + "\n".join(lines))
    report = check_scen(folder / "a.scen")
    assert report.agreed == report.total == 3 * len(free)
    row, column = data.draw(st.sampled_from(free))
    if 0 < distances[row, column] < math.inf:
        problem = Problem(
            0, "", None, (0, 0), (1, 1), f"{distances[row, column] + 2e-8:.8f}", 1, 1e-8
        )
        assert not agrees(problem, float(distances[row, column]))


ISLANDS = "type octile\nheight 4\nwidth 7\nmap\nTTT....\n.TT.W..\nTT@.WW.\n..T.W.T\n"


def test_problems_with_a_path_are_read(tmp_path: Path) -> None:
    """Each is on the grid of its own terrain, and their published lengths are those of our A*."""
    path = files(tmp_path)
    problem_set = read_problems(path)
    assert problem_set.grids.tolist() == [LAND, LAND, LAND, LAND, WATER]
    assert problem_set.starts.tolist() == [[0, 0], [1, 1], [1, 0], [0, 0], [0, 4]]
    assert problem_set.goals.tolist() == [[3, 0], [3, 3], [3, 1], [3, 5], [2, 5]]
    np.testing.assert_allclose(
        problem_set.optimal.cost, [3, 3.41421, 3, 6.82842712, 2.41421], rtol=1e-5
    )
    assert problem_set.movement == Movement(8)
    table = evaluate(classical(), problem_set, bootstrap=1)
    assert table[table["planner"] == "A*"]["opt"].tolist() == [1, 1]
    assert read_problems(path, count=4).starts.tolist() == [[0, 0], [1, 0]]  # every second line
    others = "2 without a path or a move left out, whose lengths are ours"
    assert problem_set.description == f"5 of 7 problems of {path}, {others}"
    thinned = read_problems(path, count=4).description
    assert thinned == f"2 of 7 problems of {path}, one in 2, {others}"
    elsewhere = tmp_path / "scens"
    elsewhere.mkdir()
    path.rename(elsewhere / "x.scen")
    moved = read_problems(elsewhere / "x.scen", maps=tmp_path)
    assert moved.content_hash == problem_set.content_hash


ZEROS = re.sub(r"\t[0-9.]+\n", "\t0\n", SCEN)


def test_lengths_that_are_all_0_count_as_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In scenarios of several agents there is nothing to compare, but the problems are read."""
    path = files(tmp_path, ZEROS)
    code, out, err = cli(capsys, "check-scen", path)
    assert (code, err) == (0, "")
    assert out == (
        f"{path}: optimal lengths are not given, all are 0; 5 of 7 problems have a path\n"
    )
    problems = read_problems(path)
    assert problems.starts.tolist() == read_problems(files(tmp_path)).starts.tolist()
    files(tmp_path, ZEROS)
    assert read_problems(path, count=1).description == (
        f"1 of 7 problems of {path}, one in 7, which gives no lengths"
    )


def test_a_length_of_0_means_no_path(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With other lengths in the file it is wrong if there is a path; without them it is compared if
    there is no path.
    """
    lines = ZEROS.splitlines(keepends=True)
    path = files(tmp_path, lines[0] + lines[5])  # from land to water
    code, out, _ = cli(capsys, "check-scen", path)
    assert (code, out) == (0, f"{path}: 1 of 1 optimal lengths agree\n")
    with pytest.raises(FormatError, match="none of its 1 problems has a path"):
        read_problems(path)
    path = files(tmp_path, "".join(SCEN.splitlines(keepends=True)[:-1]) + lines[1])
    code, out, _ = cli(capsys, "check-scen", path)
    assert code == 1
    assert "6 of 7 optimal lengths agree" in out


def test_all_problems_of_one_map_share_its_grid(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Many problems on a large map take the memory of one grid, and a bar shows the progress."""
    (tmp_path / "a.map").write_text(
        "type octile\nheight 200\nwidth 200\nmap\n" + 200 * f"{200 * '.'}\n"
    )
    line = "0\ta.map\t200\t200\t{0}\t0\t{0}\t4\t4.00000000\n"
    scen = "version 1\n" + "".join(line.format(k % 200) for k in range(600))
    (tmp_path / "a.scen").write_text(scen)
    read_problems(tmp_path / "a.scen", count=1)
    tracemalloc.start()
    problems = read_problems(tmp_path / "a.scen", Limits(progress=True))
    content_hash = problems.content_hash
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert problems.grids.shape == (600, 200, 200)
    assert peak < 6e6  # of 24 MB
    assert "600/600" in capsys.readouterr().err
    with pytest.raises(ValueError, match="read-only"):
        problems.grids[0, 0, 0] = 1
    copied = ProblemSet(
        problems.grids.copy(), problems.starts, problems.goals, Movement(8), problems.description
    )
    assert copied.content_hash == content_hash
    assert np.array_equal(copied.optimal.cells, problems.optimal.cells)


def test_a_map_in_place_of_a_scen_is_named_as_such(tmp_path: Path) -> None:
    """Its first line is not taken for a problem."""
    files(tmp_path)
    with pytest.raises(FormatError, match=r"cave.map: is a map, expected a .scen file"):
        check_scen(tmp_path / "cave.map")
    with pytest.raises(FormatError, match=r"holds maps of format movingai|is a map"):
        read_problems(tmp_path / "cave.map")


def test_files_of_maps_hold_no_problems(tmp_path: Path) -> None:
    """The error names the files that do."""
    np.save(tmp_path / "maps.npy", np.zeros((2, 3, 3), np.uint8))
    with pytest.raises(FormatError, match=r"format images, without problems; expected a .scen"):
        read_problems(tmp_path / "maps.npy")


@pytest.mark.parametrize(
    ("scen", "options", "message"),
    [
        (SCEN.replace("3.41421\n", "3.41422\n"), {}, "line 3: .*: says 3.41422, found 3.41421356"),
        (SCEN.replace("0\t0\t4\t0\t0\n", "0\t0\t4\t0\t4\n"), {}, "says 4, found no path"),
        ("version 1\n", {}, "holds no problems"),
        (SCEN, {"count": 0}, "count: got 0"),
        (SCEN, {"seed": 1}, "seed: does nothing for format movingai"),
        (SCEN.replace("cave", "none"), {}, "is missing"),
    ],
)
def test_problems_that_are_refused(
    scen: str, options: dict[str, Any], message: str, tmp_path: Path
) -> None:
    """Refused are a length that is not ours, an end on an occupied cell, a file without problems,
    and options of other formats.
    """
    with pytest.raises(ValueError, match=message):
        read_problems(files(tmp_path, scen), **options)


def test_trees_are_a_terrain_of_their_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A problem between trees is solved among trees; none leads from trees to land or water."""
    lines = (
        "0\tcave.map\t7\t4\t0\t0\t1\t2\t3",  # no corner of land is cut
        "0\tcave.map\t7\t4\t0\t2\t2\t0\t3.41421",
        "0\tcave.map\t7\t4\t0\t0\t2\t3\t0",  # other trees
        "0\tcave.map\t7\t4\t0\t0\t3\t0\t0",  # land
        "0\tcave.map\t7\t4\t4\t1\t2\t0\t0",  # from water to trees
        "0\tcave.map\t7\t4\t4\t1\t5\t2\t2",
        "0\tcave.map\t7\t4\t3\t3\t6\t2\t7.41421",
    )
    path = files(tmp_path, "version 1\n" + "\n".join(lines) + "\n", ISLANDS)
    report = check_scen(path)
    assert (report.disagreements, report.agreed) == ([], 7)
    code, out, _ = cli(capsys, "import", tmp_path, tmp_path / "out")
    assert code == 0
    assert "note: 4 cells of water (W) are occupied: nothing leads there from land" in out
    assert "note: 9 cells of trees (T) are occupied: nothing leads there from land" in out


def test_six_digits_of_a_float32_root_agree(tmp_path: Path) -> None:
    """99 + 96 sqrt 2 is 234.76450..., but 234.764 where sqrt 2 was 1.41421354; both are accepted
    at six digits, nothing else is.
    """
    (tmp_path / "a.map").write_text(
        "type octile\nheight 97\nwidth 196\nmap\n" + 97 * ("." * 196 + "\n")
    )
    assert f"{99 + 96 * math.sqrt(2):.6g}" == "234.765"
    assert f"{99 + 96 * float(np.float32(math.sqrt(2))):.6g}" == "234.764"
    for length, agreed in (
        ("234.764", 1),
        ("234.765", 1),
        ("234.763", 0),
        ("234.766", 0),
        ("234.76449900", 0),
        ("234.76450199", 1),
    ):
        (tmp_path / "a.scen").write_text(f"version 1\n0\ta.map\t196\t97\t0\t0\t195\t96\t{length}\n")
        assert check_scen(tmp_path / "a.scen").agreed == agreed, length


def test_a_file_that_cannot_be_read_does_not_end_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The other files are checked, and it is named at the end; the exit code is 1 if lengths
    disagree, else 2.
    """
    good = files(tmp_path)
    bad = tmp_path / "bad.scen"
    bad.write_text("nonsense\n")
    code, out, err = cli(capsys, "check-scen", bad, good, tmp_path / "none.scen")
    assert code == 2
    assert "7 of 7 optimal lengths agree" in out
    assert f"mapdata: {bad}: line 1 has 1 fields" in err
    assert f"{tmp_path / 'none.scen'}: no such file" in err
    wrong = tmp_path / "wrong.scen"
    wrong.write_text(SCEN.replace("3.41421\n", "3.41422\n"))
    code, out, err = cli(capsys, "check-scen", bad, wrong)
    assert code == 1
    assert "1 of 7 optimal lengths disagree; " in err
    assert str(bad) in err


def test_a_long_check_shows_its_progress(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The bar counts problems and not files, since one file may take minutes."""
    path = files(tmp_path, "version 1\n" + 600 * "0\tcave.map\t6\t4\t0\t0\t0\t3\t3\n")
    code, out, err = cli(capsys, "check-scen", path)
    assert (code, "600/600" in err) == (0, True)
    assert "600 of 600 optimal lengths agree" in out


HOSTILE_SCENS = {
    "nothing": ("", "holds no problems"),
    "no problem": ("version 1\n", "holds no problems"),
    "words": ("0\tcave.map\t6\t4\n", "line 1 has 4 fields"),
    "eight": ("0 cave.map 6 4 0 0 1 1\n", "line 1 has 8 fields"),
    "text": ("0\tcave.map\t6\t4\ta\t0\t0\t0\t0\n", "expected numbers"),
    "nan": ("0\tcave.map\t6\t4\t0\t0\t0\t0\tnan\n", "at least 0"),
    "infinite": ("0\tcave.map\t6\t4\t0\t0\t0\t0\tInfinity\n", "at least 0"),
    "negative": ("0\tcave.map\t6\t4\t-1\t0\t0\t0\t0\n", "at least 0"),
    "other size": ("0\tcave.map\t4\t6\t0\t0\t0\t0\t0\n", r"says \(6, 4\)"),
    "no map": ("0\tother.map\t6\t4\t0\t0\t0\t0\t0\n", "its map 'other.map' is missing"),
    "leaves the folder": ("0\t../../cave.map.scen/..\t6\t4\t0\t0\t0\t0\t0\n", "a name inside"),
    "absolute": ("0\t/etc/passwd\t6\t4\t0\t0\t0\t0\t0\n", "'/etc/passwd' is missing"),
}


@pytest.mark.parametrize("name", HOSTILE_SCENS)
def test_hostile_scens_are_refused_in_one_line(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The exit code is 2."""
    text, message = HOSTILE_SCENS[name]
    path = files(tmp_path, text)
    with pytest.raises(FormatError, match=message):
        check_scen(path)
    code, _, err = cli(capsys, "check-scen", path)
    assert code == 2
    assert err.count("\n") == 1


def test_a_wrong_line_does_not_end_a_file_unread(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A goal outside the map, one on a wall and a wrong length are three lines of the check."""
    wrong = (
        "0\tcave.map\t6\t4\t0\t0\t6\t0\t0\n"
        "0\tcave.map\t6\t4\t0\t0\t3\t0\t3\n"
        "0\tcave.map\t6\t4\t0\t0\t0\t2\t5\n"
    )
    path = files(tmp_path, SCEN + wrong)
    report = check_scen(path)
    assert (report.total, report.agreed, report.wrong_lengths) == (10, 7, 1)
    assert report.disagreements == [
        f"{path}: line 9: (row, col) (0, 6) is outside the map of (4, 6)",
        f"{path}: line 10: (0, 0) to (0, 3) (row, col): says 3, found no path (goal on an occupied "
        "cell)",
        f"{path}: line 11: (0, 0) to (2, 0) (row, col): says 5, found 2.00000000",
    ]
    assert report.hint == ""
    code, out, _ = cli(capsys, "check-scen", path)
    assert code == 1
    assert [line in out for line in report.disagreements] == [True] * 3
    with pytest.raises(FormatError, match=r'line 9: .*; and 2 more; lengths="ours" takes our'):
        read_problems(path)
    problems = read_problems(path, lengths="ours")
    expected = read_problems(files(tmp_path, SCEN + "0\tcave.map\t6\t4\t0\t0\t0\t2\t2\n"))
    assert problems.content_hash == expected.content_hash
    assert problems.description.endswith(
        "4 without a path or a move left out, 1 of them with our length in place of another"
    )
    # An import takes the other lines, too, and names the line that it leaves out.
    collection = read_any(files(tmp_path, SCEN + wrong), scen=True)
    assert collection.left_out == [(f"{path}: line 9", "its start or goal is outside the map")]
    assert len(collection.maps[0].seed_points) > 2


def test_exchanged_coordinates_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Starts lie in walls or outside the map, and the check says why."""
    (tmp_path / "a.map").write_text("type octile\nheight 2\nwidth 4\nmap\n....\n@@@.\n")
    scen = tmp_path / "a.map.scen"
    scen.write_text("version 1\n0\ta.map\t4\t2\t0\t1\t0\t2\t1\n0\ta.map\t4\t2\t0\t0\t0\t1\t1\n")
    code, out, _ = cli(capsys, "check-scen", scen)
    assert code == 1
    assert "x and y are probably exchanged" in out
    assert "(goal on an occupied cell)" in out
    with pytest.raises(FormatError, match="x and y are probably exchanged"):
        read_problems(scen)


def test_an_import_has_land_as_free_cells(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The movement is the benchmark's rule; a bad file is left out and named."""
    files(tmp_path)
    (tmp_path / "bad.map").write_text("nonsense")
    code, out, err = cli(capsys, "import", tmp_path, tmp_path / "out", "--seed-points", 4)
    assert code == 0
    assert "left out" in err
    assert "bad.map: line 1 is 'nonsense'" in err
    assert "note: 6 cells of water (W) are occupied" in out
    manifest = read_manifest(tmp_path / "out")
    assert (manifest.maps, manifest.map_size, manifest.movement.connectivity) == (1, (4, 6), 8)
    labels = read_shard(tmp_path / "out" / manifest.shards[0].name)
    assert labels.maps.occupancy[0].tolist() == LAND
    assert labels.maps.rooms.tolist() == [4]
    assert labels.all_connected.all()


def test_a_scen_imports_its_map_with_end_points_as_seed_points(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first end points on land are taken, up to the number that is asked for."""
    assert cli(capsys, "import", files(tmp_path), tmp_path / "out", "--seed-points", 3)[0] == 0
    labels = read_shard(tmp_path / "out" / read_manifest(tmp_path / "out").shards[0].name)
    assert labels.maps.seed_points[0].tolist() == [[0, 0], [3, 0], [1, 1]]
    beside = next(tmp_path.glob("*.map"))
    code, _, err = cli(capsys, "import", beside, tmp_path / "no", "--movingai.scen")
    assert (code, "a map has no end points, expected a .scen file" in err) == (2, True)


def test_an_import_of_problems_says_how_many_end_points_it_took(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The note names the function that reads the problems themselves."""
    scen = files(tmp_path)
    code, out, _ = cli(capsys, "import", scen, tmp_path / "few", "--seed-points", 2)
    assert code == 0
    assert "2 of the 7 free start and goal cells of the problems are seed points" in out
    assert "mapdata.formats.read_problems(file)" in out


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("0\ta.map\t8\t6\t0\t0\t2\t1\t3", "says (6, 8), the map has (3, 4)"),
        ("0\ta.map\t4\t3\t0\t0\t2\t5\t6", "its start or goal is outside the map"),
    ],
)
def test_an_import_refuses_scaled_scenarios(
    line: str, why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The check refuses them, too, since their end points are other cells."""
    (tmp_path / "a.map").write_text("type octile\nheight 3\nwidth 4\nmap\n....\n....\n....\n")
    scen = tmp_path / "a.map.scen"
    scen.write_text(f"version 1\n{line}\n")
    code, _, err = cli(capsys, "import", scen, tmp_path / "out")
    assert (code, why in err, "a.map.scen: line" in err) == (2, True, True), err
    # a sound one for the same map is imported
    sound = "0\ta.map\t4\t3\t0\t0\t2\t1\t2.41421356"
    (tmp_path / "b.scen").write_text(f"version 1\n{sound}\n")
    assert cli(capsys, "import", tmp_path, tmp_path / "out", "--movingai.scen")[0] == 0
    labels = read_shard(tmp_path / "out" / read_manifest(tmp_path / "out").shards[0].name)
    assert labels.maps.seed_points[0].tolist() == [[0, 0], [1, 2]]


def test_a_map_name_that_is_too_long_is_a_fault_of_its_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The other files are still read."""
    path = files(tmp_path)
    long = tmp_path / "long.scen"
    long.write_text(f"version 1\n0\t{'x' * 300}\t4\t4\t0\t0\t1\t1\t1\n")
    code, out, err = cli(capsys, "check-scen", long, path)
    assert code == 2
    assert f"{path}: " in out
    assert "too long" in err


def test_exported_lengths_agree(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With our own search, for pairs with a path and without."""
    export(root, tmp_path / "out", "movingai")
    scens = sorted((tmp_path / "out").rglob("*.scen"))
    assert len(scens) == 24
    assert cli(capsys, "check-scen", *scens)[0] == 0


def test_larger_maps_become_tiles(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A map beyond the maximal side is left out with advice; its tiles are maps."""
    text = "type octile\nheight 6\nwidth 4100\nmap\n" + ("." * 4100 + "\n") * 6
    (tmp_path / "wide.map").write_text(text)
    code, _, err = cli(capsys, "import", tmp_path, tmp_path / "no")
    assert code == 2
    assert "--tile cuts it" in err
    assert cli(capsys, "import", tmp_path, tmp_path / "out", "--tile", "3x2000")[0] == 0
    assert read_manifest(tmp_path / "out").maps == 4


# --- costs of letters -----------------------------------------------------------------------------


def test_letters_with_costs_become_terrain(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Other land costs 1; other letters stay occupied. Water with a cost can be entered from
    land.
    """
    files(tmp_path)
    costs = '{"S": 3, "W": 5}'
    source = tmp_path / "cave.map"
    code, out, _ = cli(capsys, "import", source, tmp_path / "data", "--movingai.costs", costs)
    assert code == 0
    assert (
        "costs of the letters: . 1 (13 cells), G 1 (1 cells), S 3 (1 cells), W 5 (6 cells)" in out
    )
    assert "1 cells of trees (T) are occupied: they have no cost" in out
    assert "of water" not in out
    manifest = read_manifest(tmp_path / "data")
    assert manifest.movement == Movement(8)
    maps = read_shard(tmp_path / "data" / manifest.shards[0].name).maps
    assert maps.terrain is not None
    assert maps.terrain[0].tolist() == [
        [1, 1, 1, 0, 5, 5],
        [1, 3, 1, 0, 5, 5],
        [1, 0, 1, 1, 5, 5],
        [1, 1, 1, 1, 1, 1],
    ]


def test_end_points_on_water_are_seed_points_where_water_has_a_cost(tmp_path: Path) -> None:
    """Without costs they are not, since the water is occupied."""
    scen = files(tmp_path)
    points = read_any(scen).maps[0].seed_points.tolist()
    points_with_water = read_any(scen, costs={"W": 2}).maps[0].seed_points.tolist()
    assert [0, 4] not in points
    assert [0, 4] in points_with_water


@pytest.mark.parametrize(
    ("costs", "message"),
    [
        ({}, "costs: got {}, expected letters and their costs as in"),
        ({"@": 3}, "costs: got the letter '@', expected one of .GSWT"),
        ({"SW": 3}, "costs: got the letter 'SW', expected one of .GSWT"),
        ({"": 3}, "costs: got the letter '', expected one of .GSWT"),
        ({"S": 0}, "costs: got 0 for 'S', expected a whole number from 1 to 255"),
        ({"S": 256}, "costs: got 256 for 'S'"),
        ({"S": 1.5}, "costs: got 1.5 for 'S'"),
        ({"S": True}, "costs: got True for 'S'"),
        ({"S": "3"}, "costs: got '3' for 'S'"),
        ([("S", 3)], "costs: got [('S', 3)], expected letters"),
    ],
)
def test_costs_that_are_none_are_refused(costs: Any, message: str, tmp_path: Path) -> None:
    """The message names the letter."""
    files(tmp_path)
    with pytest.raises(ValueError, match=re.escape(message)):
        read_any(tmp_path / "cave.map", costs=costs)


def test_costs_on_the_command_line_are_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Anything else is refused, with an example."""
    files(tmp_path)
    for text in ("S=3", "[3]", "{"):
        code, _, err = cli(
            capsys, "import", tmp_path / "cave.map", tmp_path / "data", "--movingai.costs", text
        )
        assert code == 2
        assert "expected JSON such as" in err
        assert len(err.strip().splitlines()) == 1
