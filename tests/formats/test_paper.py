"""The paper's release: out and in again is the same content; faults of files."""

from __future__ import annotations

import csv
import re
import tempfile
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from helpers.specs import specs
from helpers.wild import SETTINGS, cli, png
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from mapdata import MapSpec, build, read_shard, verify
from mapdata.describe.table import join_segments, path_gaps
from mapdata.formats import FormatError, Limits, export, import_maps, read_any, recognise
from mapdata.formats.paper import PARAMETERS, numbers, read
from mapdata.shards import read_manifest

csv.field_size_limit(2**27)


def rows_of(folder: Path) -> list[dict[str, str]]:
    """Return the lines of the release's CSV by the csv module."""
    with open(folder / "maps.csv", encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def write_rows(folder: Path, rows: list[dict[str, str]], name: str = "maps.csv") -> None:
    """Write lines as a CSV."""
    with open(folder / name, "w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


@pytest.fixture
def release(root: Path, tmp_path: Path) -> Path:
    """The small dataset as a release."""
    export(root, tmp_path / "release", "paper")
    return tmp_path / "release"


@settings(SETTINGS, max_examples=12)
@given(specs(), st.integers(0, 2**64 - 1), st.integers(1, 4))
def test_round_trip(spec: MapSpec, seed: int, count: int) -> None:
    """For any spec the content hash comes back, so every label does, and nothing disagrees."""
    with tempfile.TemporaryDirectory() as folder:
        before = build(Path(folder, "a"), spec, maps=count, seed=seed, shard_size=3)
        export(Path(folder, "a"), Path(folder, "b"), "paper")
        (made,) = import_maps(Path(folder, "c"), read_any(Path(folder, "b")))
        assert made.manifest.content_hash == before.content_hash
        assert made.manifest.resolution == spec.resolution
        assert made.manifest.movement == spec.movement
        assert (made.checked, made.disagreements) == (count, {})
        assert verify(Path(folder, "c")) == []


def test_what_is_written(root: Path, release: Path) -> None:
    """1-bit pictures, black where free; a line holds what the shard holds; joints stand once."""
    rows = rows_of(release)
    labels = read_shard(root / read_manifest(root).shards[0].name)
    picture = Image.open(release / "images" / "map7.png")
    assert picture.mode == "1"
    assert np.array_equal(np.asarray(picture).astype(np.uint8), labels.maps.occupancy[7])
    row = rows[7]
    n = int(labels.maps.rooms[7])
    assert (row["item"], row["label"], row["resolution"]) == ("7", "map7", "0.1")
    assert row["seed_rows"] == str(labels.maps.seed_points[7, :n, 0].tolist())
    route = labels.route("astar", 7)
    cells = list(
        zip(numbers(row["astar_row_path"]), numbers(row["astar_column_path"]), strict=True)
    )
    joints = [1 for one, other in pairwise(route) if len(one) and len(other)]
    assert len(cells) == sum(len(segment) for segment in route) - len(joints)
    if all(len(segment) for segment in route):
        # without a gap, each cell is beside the next one
        assert all(abs(r - s) + abs(c - d) == 1 for (r, c), (s, d) in pairwise(cells))


def test_routes_are_joined_without_repeating_cells() -> None:
    """A joint stands once, also of two seed points on one cell; a missing segment has none."""
    one = np.array([[0, 0], [0, 1]])
    other = np.array([[0, 1], [1, 1]])
    stay = np.array([[0, 1]])
    none = np.empty((0, 2), np.int64)
    assert join_segments([one, other]).tolist() == [[0, 0], [0, 1], [1, 1]]
    assert join_segments([one, stay, other]).tolist() == [[0, 0], [0, 1], [1, 1]]
    assert join_segments([one, none, other + 3]).tolist() == [[0, 0], [0, 1], [3, 4], [4, 4]]
    assert join_segments([none]).tolist() == []


def test_gaps_mark_segments_without_a_path(root: Path, release: Path) -> None:
    """Each segment without a path is marked, and between the marks every cell is beside the next;
    the pieces are those of the route.
    """
    one = np.array([[0, 0], [0, 1]])
    none = np.empty((0, 2), np.int64)
    assert path_gaps([one, one + 1]) == []
    assert path_gaps([none, one, none, none, one + 3, none]) == [0, 2, 2, 4]
    marked = 0
    labels = [read_shard(root / entry.name) for entry in read_manifest(root).shards]
    for row in rows_of(release):
        batch = labels[int(row["item"]) // 16]
        for search in ("bfs", "astar"):
            places = numbers(row[f"{search}_path_gaps"])
            rows = np.split(numbers(row[f"{search}_row_path"]), places)
            columns = np.split(numbers(row[f"{search}_column_path"]), places)
            for piece in zip(rows, columns, strict=True):
                assert (np.abs(np.diff(piece, axis=1)).sum(axis=0) == 1).all()
            missing = [len(part) == 0 for part in batch.route(search, int(row["item"]) % 16)]
            assert len(places) == sum(missing) == row["reachable"].count("false")
            marked += len(places)
    assert marked > 0


def test_iterations_are_those_of_the_map(release: Path) -> None:
    """One number a map as in Figure 3, and one a segment."""
    for row in rows_of(release):
        for search in ("bfs", "astar"):
            segments = numbers(row[f"{search}_segment_iterations"])
            assert [sum(segments)] == numbers(row[f"{search}_iterations"])


def test_tables_of_version_0_1_are_read(root: Path, release: Path, tmp_path: Path) -> None:
    """They have fewer labels, and iterations of segments under the names of the map's."""
    rows = rows_of(release)
    for row in rows:
        row["path_exists"] = row.pop("reachable")
        del row["rooms"], row["all_connected"]
        for search in ("bfs", "astar"):
            row[f"{search}_iterations"] = row.pop(f"{search}_segment_iterations")
            del row[f"{search}_path_gaps"]
    write_rows(release, rows)
    (made,) = import_maps(tmp_path / "back", read_any(release))
    assert made.manifest.content_hash == read_manifest(root).content_hash
    assert set(made.disagreements) == {"bfs_iterations", "astar_iterations"}


def test_disagreements_are_counted(
    release: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Wrong iterations on two maps and a wrong matrix on one: told, and our labels stand."""
    rows = rows_of(release)
    for k in (3, 4):
        rows[k]["bfs_iterations"] = "1" + rows[k]["bfs_iterations"]
    rows[9]["astar_connection_matrix"] = rows[9]["astar_connection_matrix"].replace("0", "7", 1)
    rows[5]["bfs_row_path"] = "none"
    rows[6]["bfs_path_gaps"] = "[1, 2, 3, 4, 5, 6, 7]"
    write_rows(release, rows)
    code, out, _ = cli(capsys, "import", release, tmp_path / "back")
    assert code == 0
    assert "labels compared with the source: 24 maps" in out
    assert "  bfs_iterations: 2 disagree" in out
    assert "  astar_connection_matrix: 1 disagree" in out
    assert "  bfs_path_gaps: 1 disagree" in out
    assert "  bfs_row_path: 1 disagree" in out
    assert "astar_row_path" not in out


def test_labels_are_optional(release: Path, tmp_path: Path) -> None:
    """Without any column of labels the maps are the same, and nothing is compared."""
    before = read(release)
    rows = [{name: row[name] for name in PARAMETERS} for row in rows_of(release)]
    write_rows(release, rows)
    assert recognise(release) == "paper"
    (made,) = import_maps(tmp_path / "back", read_any(release))
    (expected,) = import_maps(tmp_path / "expected", before)
    assert made.manifest.content_hash == expected.manifest.content_hash
    assert (made.checked, expected.checked) == (0, 24)


BAD_CELLS = {
    "no picture": ("label", "nothing", "its picture images/nothing.png is missing"),
    "traversal": ("label", "../../../etc/passwd", "its picture images/../../../etc/passwd.png is"),
    "words": ("seed_rows", "[one, two]", "is not a list of numbers"),
    "code": ("seed_rows", "__import__('os').system('x')", "is not a list of numbers"),
    "fractions": ("seed_rows", "[1.5, 2]", "other than a list of whole numbers"),
    "lists in a list": ("seed_rows", "[[1, 2]]", "other than a list of whole numbers"),
    "deep": ("seed_rows", "[" * 100_000, "is not a list of numbers"),
    "long number": ("seed_rows", "9" * 10_000, "is not a list of numbers"),
    "beyond int64": ("seed_rows", f"[{2**63}, 2]", "other than a list of whole numbers"),
    "outside": ("seed_rows", "[99, 2]", ""),
    "too few": ("seed_rows", "[1]", ""),
    "none": ("seed_rows", "[]", ""),
    "directions": ("direction_for_passages", "[5, 5]", "do not fit|out of range"),
    "large size": ("size_rows", "[1, 99999]", "do not fit|out of range"),
    "resolution": ("resolution", "nan", "above 0"),
    "negative resolution": ("resolution", "-1", "above 0"),
    "no number": ("resolution", "ten", "could not convert"),
    "passage": ("passage_size", "99999", "out of range"),
    "two passages": ("passage_size", "[3, 3]", "holds 2 numbers, expected one"),
    "twice": ("item", "3", "stands there twice"),
}


@pytest.mark.parametrize("name", BAD_CELLS)
def test_a_bad_line_is_left_out(name: str, release: Path, tmp_path: Path) -> None:
    """One map less, with the reason; the others are imported."""
    column, text, says = BAD_CELLS[name]
    rows = rows_of(release)
    rows[8][column] = text
    write_rows(release, rows)
    found = read(release)
    (made,) = import_maps(tmp_path / "back", found)
    assert made.manifest.maps == 23
    ((_, why),) = found.left_out
    assert re.search(says, why)
    assert "\n" not in why
    assert any("numbered anew" in note for note in found.notes)


def test_hostile_pictures_are_left_out(release: Path, tmp_path: Path) -> None:
    """A bomb, a lie and a stub among the pictures."""
    (release / "images" / "map0.png").write_bytes(png(20000, 20000))
    (release / "images" / "map1.png").write_bytes(png(20, 70, b"x"))
    (release / "images" / "map2.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    found = read(release)
    assert [name for name, _ in found.left_out] == ["map0", "map1", "map2"]
    assert (
        "expected at most 16777216" in found.left_out[0][1]
        or "exceeds limit" in found.left_out[0][1]
    )


HEADER = ",".join(PARAMETERS)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "has no columns item, label, split, "),
        ("a,b\n1,2\n", "has no columns item, label, split, "),
        (HEADER.replace("seed_rows", "Seed rows"), "has no columns seed_rows, expected those that"),
        (HEADER.replace(",", ";"), "has no columns item, label, split, "),
        (f'{HEADER}\n"1,2\n', "not a sound CSV .unexpected end of data"),
        (f"{HEADER}\n\udcff\udcfe,1\n", "not a sound CSV"),
        (f"{HEADER}\n1,2\n", "line 2 has 2 fields, expected 11"),
        (f"{HEADER}\n{'1,' * 11}\n", "line 2 has 12 fields, expected 11"),
    ],
)
def test_other_tables_are_refused(text: str, says: str, tmp_path: Path) -> None:
    """Other columns, an open quote, no UTF-8, ragged lines: refused in one line, which names the
    columns that are missing.
    """
    (tmp_path / "maps.csv").write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(FormatError, match=says) as caught:
        read(tmp_path)
    assert "\n" not in str(caught.value)


def test_limits(release: Path) -> None:
    """A CSV larger than the limit is not read; two CSVs are one too many; two movements too."""
    with pytest.raises(FormatError, match="expected at most 100"):
        read(release, Limits(unpacked=100))
    rows = rows_of(release)
    write_rows(release, rows, "other.csv")
    with pytest.raises(FormatError, match="holds 2"):
        read(release)
    (release / "other.csv").unlink()
    rows[3]["movement"] = '{"connectivity":8}'
    write_rows(release, rows)
    with pytest.raises(FormatError, match="2 movements"):
        read(release)
    write_rows(release, [{**row, "movement": '{"x":1}'} for row in rows])
    with pytest.raises(FormatError, match="its movement is"):
        read(release)


@SETTINGS
@given(st.text(max_size=30) | st.text("[],.-+0123456789e ", max_size=30))
def test_cells_never_crash(text: str) -> None:
    """Any text is a list of whole numbers or a FormatError."""
    try:
        values = numbers(text)
    except FormatError:
        return
    assert values.dtype == np.int64
    assert values.ndim == 1


def test_what_was_taken_for_free_is_told(release: Path) -> None:
    """Dark pixels, in the paper; inverted pictures have a free border, and that is told too."""
    found = read(release)
    share = 1 - np.mean([one.grid.mean() for one in found.maps])
    (note,) = found.notes
    assert note.startswith("dark pixels (in the paper white is occupied) were taken for free: ")
    assert f"{share:.1%}" in note
    for path in (release / "images").iterdir():
        Image.fromarray(~np.asarray(Image.open(path))).save(path)
    assert any("border of 24 of 24 maps is mostly free" in note for note in read(release).notes)


def test_some_free_borders_are_no_mistake(tmp_path: Path) -> None:
    """Rooms of the default maps reach the border: a fifth of the borders are mostly free."""
    build(tmp_path / "root", MapSpec(), maps=100, seed=0, progress=False)
    export(tmp_path / "root", tmp_path / "release", "paper")
    found = read(tmp_path / "release")
    borders = [one.grid[[0, -1]] for one in found.maps]
    assert any(border.mean() < 0.2 for border in borders)
    assert not any("mostly free" in note for note in found.notes)
