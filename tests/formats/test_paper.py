"""The paper's release: out and in again is the same content; faults of files."""

from __future__ import annotations

import csv
import re
import tempfile
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from helpers.examples import examples
from helpers.specs import specs
from helpers.wild import SETTINGS, cli, png
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from mapdata import MapSpec, build, read_shard, verify
from mapdata.describe.table import join_segments, path_gaps
from mapdata.formats import FormatError, Limits, export, import_maps, read_any, recognise
from mapdata.formats.paper import PARAMETERS, parse_numbers, read
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


@examples(12, SETTINGS)
@given(specs(), st.integers(0, 2**64 - 1), st.integers(1, 4))
def test_round_trip(generator: MapSpec, seed: int, count: int) -> None:
    """For any generator the content hash comes back, so all labels do, and no label disagrees."""
    with tempfile.TemporaryDirectory() as folder:
        before = build(Path(folder, "a"), generator, maps=count, seed=seed, shard_size=3)
        export(Path(folder, "a"), Path(folder, "b"), "paper")
        (dataset,) = import_maps(Path(folder, "c"), read_any(Path(folder, "b")))
        assert dataset.manifest.content_hash == before.content_hash
        assert dataset.manifest.resolution == generator.resolution
        assert dataset.manifest.movement == generator.movement
        assert (dataset.checked, dataset.disagreements) == (count, {})
        assert verify(Path(folder, "c")) == []


def test_what_is_written(root: Path, release: Path) -> None:
    """Pictures have 1 bit a pixel and black free cells, and a line holds the labels of
    the shard.
    """
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
        zip(
            parse_numbers(row["astar_row_path"]),
            parse_numbers(row["astar_column_path"]),
            strict=True,
        )
    )
    joints = [1 for one, other in pairwise(route) if len(one) and len(other)]
    assert len(cells) == sum(len(segment) for segment in route) - len(joints)
    if all(len(segment) for segment in route):
        # without a gap, each cell is beside the next one
        assert all(abs(r - s) + abs(c - d) == 1 for (r, c), (s, d) in pairwise(cells))


def test_routes_are_joined_without_repeating_cells() -> None:
    """The cell where two segments meet is written once, also if two seed points share a cell; a
    missing segment has no cells.
    """
    first = np.array([[0, 0], [0, 1]])
    second = np.array([[0, 1], [1, 1]])
    stay = np.array([[0, 1]])
    none = np.empty((0, 2), np.int64)
    assert join_segments([first, second]).tolist() == [[0, 0], [0, 1], [1, 1]]
    assert join_segments([first, stay, second]).tolist() == [[0, 0], [0, 1], [1, 1]]
    assert join_segments([first, none, second + 3]).tolist() == [[0, 0], [0, 1], [3, 4], [4, 4]]
    assert join_segments([none]).tolist() == []


def test_gaps_mark_segments_without_a_path(root: Path, release: Path) -> None:
    """Between the gaps consecutive cells are neighbours, and the pieces are the segments of the
    route.
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
            places = parse_numbers(row[f"{search}_path_gaps"])
            rows = np.split(parse_numbers(row[f"{search}_row_path"]), places)
            columns = np.split(parse_numbers(row[f"{search}_column_path"]), places)
            for piece in zip(rows, columns, strict=True):
                assert (np.abs(np.diff(piece, axis=1)).sum(axis=0) == 1).all()
            missing = [len(part) == 0 for part in batch.route(search, int(row["item"]) % 16)]
            assert len(places) == sum(missing) == row["reachable"].count("false")
            marked += len(places)
    assert marked > 0


def test_iterations_are_those_of_the_map(release: Path) -> None:
    """There is a number for the map as in Figure 3, and a number for each segment."""
    for row in rows_of(release):
        for search in ("bfs", "astar"):
            segments = parse_numbers(row[f"{search}_segment_iterations"])
            assert [sum(segments)] == parse_numbers(row[f"{search}_iterations"])


def test_tables_of_version_0_1_are_read(root: Path, release: Path, tmp_path: Path) -> None:
    """They have fewer labels, and name the iterations of segments as those of the map."""
    rows = rows_of(release)
    for row in rows:
        row["path_exists"] = row.pop("reachable")
        del row["rooms"], row["all_connected"]
        for search in ("bfs", "astar"):
            row[f"{search}_iterations"] = row.pop(f"{search}_segment_iterations")
            del row[f"{search}_path_gaps"]
    write_rows(release, rows)
    (dataset,) = import_maps(tmp_path / "back", read_any(release))
    assert dataset.manifest.content_hash == read_manifest(root).content_hash
    assert set(dataset.disagreements) == {"bfs_iterations", "astar_iterations"}


def test_disagreements_are_counted(
    release: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Wrong iterations on two maps and a wrong matrix on one are reported, and our labels are
    stored.
    """
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
    """Without columns of labels the maps are the same, and nothing is compared."""
    before = read(release)
    rows = [{name: row[name] for name in PARAMETERS} for row in rows_of(release)]
    write_rows(release, rows)
    assert recognise(release) == "paper"
    (dataset,) = import_maps(tmp_path / "back", read_any(release))
    (expected,) = import_maps(tmp_path / "expected", before)
    assert dataset.manifest.content_hash == expected.manifest.content_hash
    assert (dataset.checked, expected.checked) == (0, 24)


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
    """The reason is noted, and the other maps are imported."""
    column, text, message = BAD_CELLS[name]
    rows = rows_of(release)
    rows[8][column] = text
    write_rows(release, rows)
    collection = read(release)
    (dataset,) = import_maps(tmp_path / "back", collection)
    assert dataset.manifest.maps == 23
    ((_, why),) = collection.left_out
    assert re.search(message, why)
    assert "\n" not in why
    assert any("numbered anew" in note for note in collection.notes)


def test_hostile_pictures_are_left_out(release: Path, tmp_path: Path) -> None:
    """They are a decompression bomb, a picture with a wrong size and a truncated picture."""
    (release / "images" / "map0.png").write_bytes(png(20000, 20000))
    (release / "images" / "map1.png").write_bytes(png(20, 70, b"x"))
    (release / "images" / "map2.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    collection = read(release)
    assert [name for name, _ in collection.left_out] == ["map0", "map1", "map2"]
    assert (
        "expected at most 16777216" in collection.left_out[0][1]
        or "exceeds limit" in collection.left_out[0][1]
    )


HEADER = ",".join(PARAMETERS)


@pytest.mark.parametrize(
    ("text", "message"),
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
def test_other_tables_are_refused(text: str, message: str, tmp_path: Path) -> None:
    """Tables with other columns, an open quote, no UTF-8 or ragged lines are refused in one line,
    which names missing columns.
    """
    (tmp_path / "maps.csv").write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(FormatError, match=message) as caught:
        read(tmp_path)
    assert "\n" not in str(caught.value)


def test_large_and_ambiguous_sources_are_refused(release: Path) -> None:
    """They are a CSV larger than the limit, two CSVs in a folder, and two movements in a CSV."""
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
def test_any_cell_is_parsed_or_refused(text: str) -> None:
    """Any text is a list of whole numbers or raises a FormatError."""
    try:
        values = parse_numbers(text)
    except FormatError:
        return
    assert values.dtype == np.int64
    assert values.ndim == 1


def test_a_note_says_which_cells_are_free(release: Path) -> None:
    """In the paper's pictures dark pixels are free; a free border of inverted pictures is noted,
    too.
    """
    collection = read(release)
    share = 1 - np.mean([foreign_map.grid.mean() for foreign_map in collection.maps])
    (note,) = collection.notes
    assert note.startswith("dark pixels (in the paper white is occupied) were taken for free: ")
    assert f"{share:.1%}" in note
    for path in (release / "images").iterdir():
        Image.fromarray(~np.asarray(Image.open(path))).save(path)
    assert any("border of 24 of 24 maps is mostly free" in note for note in read(release).notes)


def test_some_free_borders_give_no_note(tmp_path: Path) -> None:
    """Rooms of the default maps reach the border, so a fifth of the borders are mostly free."""
    build(tmp_path / "root", MapSpec(), maps=100, seed=0, progress=False)
    export(tmp_path / "root", tmp_path / "release", "paper")
    collection = read(tmp_path / "release")
    borders = [foreign_map.grid[[0, -1]] for foreign_map in collection.maps]
    assert any(border.mean() < 0.2 for border in borders)
    assert not any("mostly free" in note for note in collection.notes)
