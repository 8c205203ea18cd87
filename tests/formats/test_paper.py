"""The paper's release: what is written, beside the labels of the shards."""

from __future__ import annotations

import csv
import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from helpers.wild import cli
from PIL import Image

from mapdata import read_shard
from mapdata.describe.table import join_segments, path_gaps
from mapdata.formats import export, read_any
from mapdata.shards import read_manifest

csv.field_size_limit(2**27)


def rows_of(folder: Path) -> list[dict[str, str]]:
    """Return the lines of the release's CSV by the csv module."""
    with open(folder / "maps.csv", encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def numbers_of(cell: str) -> list[int]:
    """Return the numbers of a cell: of one number, or of a list."""
    numbers: list[int] = np.array(json.loads(cell), np.int64, ndmin=1).tolist()
    return numbers


@pytest.fixture
def release(root: Path, tmp_path: Path) -> Path:
    """The small dataset as a release."""
    export(root, tmp_path / "release", "paper")
    return tmp_path / "release"


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
            numbers_of(row["astar_row_path"]),
            numbers_of(row["astar_column_path"]),
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
            places = numbers_of(row[f"{search}_path_gaps"])
            rows = np.split(numbers_of(row[f"{search}_row_path"]), places)
            columns = np.split(numbers_of(row[f"{search}_column_path"]), places)
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
            segments = numbers_of(row[f"{search}_segment_iterations"])
            assert [sum(segments)] == numbers_of(row[f"{search}_iterations"])


def test_the_pictures_are_read_inverted(root: Path, release: Path) -> None:
    """As the error of an import of the release says."""
    maps = read_any(release / "images", "images", invert=True).maps
    grid_by_name = {Path(each.name).stem: each.grid for each in maps}
    labels = read_shard(root / read_manifest(root).shards[0].name)
    assert len(grid_by_name) == 24
    for k in range(16):
        assert np.array_equal(grid_by_name[f"map{k}"], labels.maps.occupancy[k])


@pytest.mark.parametrize("arguments", [[], ["--format", "paper"]])
def test_an_import_says_what_to_do_instead(
    arguments: list[str], release: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also where the format is recognised by the columns of the table."""
    code, _, error = cli(capsys, "import", release, tmp_path / "back", *arguments)
    assert code == 2
    assert "paper: is written and not read: --format images --images.invert reads its pict" in error
    assert not (tmp_path / "back").exists()
