"""Recorded drives: which tables are read, the cells they pass, and the parts that are drawn."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mapdata.costmaps import read_drives
from mapdata.costmaps.drives import MIN_PART, Drive, cells_of_drive, random_parts
from mapdata.formats import RosMap

RESOLUTION = 0.1


def office(origin: tuple[float, float, float] = (-3.0, 2.0, 0.0)) -> RosMap:
    """Return a hall of 4 x 6 m with a pillar, and a wall around it."""
    cells = np.zeros((40, 60), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    cells[16:24, 14:18] = 100
    return RosMap(cells, RESOLUTION, origin)


def test_drives_are_told_apart_by_numbers_or_gaps(tmp_path: Path) -> None:
    """A column ``drive`` decides; without it a gap of more than a metre does."""
    poses = [[0, 0], [0.5, 0], [1.2, 0], [3, 0], [3, 0.9]]
    table = pd.DataFrame(poses, columns=["x", "y"])
    assert [len(drive) for drive in read_drives(table)] == [3, 2]
    table.assign(drive=["b", "b", "a", "a", "b"]).to_csv(tmp_path / "drives.csv", index=False)
    by_name = read_drives(tmp_path / "drives.csv")
    assert [drive.tolist() for drive in by_name] == [
        [[0, 0], [0.5, 0], [3, 0.9]],
        [[1.2, 0], [3, 0]],
    ]


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"x": [1.0], "z": [1.0]}, "got the columns x, z, expected one x and one y"),
        ({"x": [1.0], "X": [2.0], "y": [3.0]}, "got the columns x, x, y, expected one x"),
        ({"x": [1.0], "y": [2.0], "drive": [3], "Drive": [4]}, "perhaps one drive"),
        ({"x": [1.0, math.nan], "y": [1.0, 1.0]}, "row 1 has x nan and y 1.0, expected finite"),
        ({"x": [1.0], "y": ["here"]}, "row 0 has x 1.0 and y here, expected finite metres"),
        ({"x": [1.0, 1.0], "y": [1.0, 1.0], "drive": [None, "a"]}, "row 0 has an empty drive"),
    ],
    ids=["missing", "two x", "two drives", "nan", "text", "no drive"],
)
def test_bad_tables_are_refused(columns: dict[str, list[object]], message: str) -> None:
    """The message names the columns or the row."""
    with pytest.raises(ValueError, match=message):
        read_drives(pd.DataFrame(columns))


def test_a_table_without_rows_has_no_drives() -> None:
    """Of several maps one may have none."""
    assert read_drives(pd.DataFrame({"x": [], "y": []})) == []


@pytest.mark.parametrize(
    "content",
    [b"", b"\x89PNG\r\n\x1a\n\xff", b"x,y\n1,2\n1,2,3,4\n"],
    ids=["empty", "picture", "ragged"],
)
def test_a_file_that_is_no_table_is_named(content: bytes, tmp_path: Path) -> None:
    """The message says how a file should begin."""
    path = tmp_path / "drives.csv"
    path.write_bytes(content)
    with pytest.raises(
        ValueError, match=r"drives\.csv: is no table, expected a CSV file whose first"
    ):
        read_drives(path)


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.0])
def test_poses_are_snapped_to_the_cells_of_map_server(yaw: float) -> None:
    """Cells equal those of `RosMap.to_cells`, on maps that are turned as well."""
    ros_map = office((-3.0, 2.0, yaw))
    cells = np.stack([np.full(20, 8), np.arange(10, 30)], axis=1)
    (part,), dropped = cells_of_drive(ros_map.to_metres(cells=cells), ros_map, ros_map.grid())
    np.testing.assert_array_equal(part, cells)
    assert set(dropped.values()) == {0}


def test_what_is_dropped_is_counted() -> None:
    """A drive through a pillar falls into two parts; poses outside and short rests go."""
    ros_map = office()
    row = ros_map.to_metres(cells=np.array([[18, 2], [18, 28]]))  # through the first pillar
    outside = np.array([[50.0, 50.0]])
    parts, dropped = cells_of_drive(np.concatenate([row, outside]), ros_map, ros_map.grid())
    assert [part.tolist() for part in parts] == [
        [[18, column] for column in range(2, 14)],
        [[18, column] for column in range(18, 29)],
    ]
    assert dropped == {
        "poses outside of the map": 1,
        "cells that are not free": 4,
        "cells in parts that are too short": 0,
    }
    short = ros_map.to_metres(cells=np.array([[18, 11], [18, 16]]))
    parts, dropped = cells_of_drive(short, ros_map, ros_map.grid())
    assert (parts, dropped["cells in parts that are too short"]) == ([], 3)


def test_lines_between_poses_are_moves() -> None:
    """Joined cells are neighbours, and begin and end at those of the poses."""
    rng = np.random.default_rng(2)
    ros_map = RosMap(np.zeros((50, 70), np.int8), RESOLUTION, (0.0, 0.0, 0.0))
    cells = rng.integers(0, 50, (12, 2))
    (part,), _ = cells_of_drive(ros_map.to_metres(cells=cells), ros_map, ros_map.grid())
    assert set(np.abs(np.diff(part, axis=0)).max(axis=1).tolist()) == {1}
    visited = list(map(tuple, part.tolist()))
    assert visited[0] == tuple(cells[0])
    assert visited[-1] == tuple(cells[-1])
    assert {tuple(cell) for cell in cells.tolist()} <= set(visited)


def test_no_part_ends_where_it_begins() -> None:
    """The cheapest path between its ends would cost nothing, and the loss would not be finite."""
    to_and_fro = np.array([[5, 5], [5, 6], [6, 5], [5, 5], [5, 6], [6, 5], [5, 5]])
    parts = random_parts([Drive(0, to_and_fro)], 200, np.random.default_rng(0))
    assert all((part.cells[0] != part.cells[-1]).any() for part in parts)
    assert min(len(part.cells) for part in parts) >= MIN_PART - 1
