"""Recorded drives: reading them, snapping them to cells, and cutting them into parts."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from mapdata.arrays import Bytes, Floats, Ints
from mapdata.formats import RosMap

MAX_GAP = 1.0
"""A distance between poses, in metres, at which a new drive begins if drives have no numbers."""

MIN_PART = 4
"""Smallest number of cells of a part of a drive that training and comparison use."""

MAX_PART = 40
"""Largest number of cells of such a part. A driver knows the way around a room better than that
through a building.
"""


class Drive(NamedTuple):
    """A part of a recorded drive on one map.

    Attributes:
        map: number of the map.
        cells: (k, 2) cells, each a move of 8-connected movement from the one before it.
    """

    map: int
    cells: Ints


def read_drives(source: pd.DataFrame | str | Path) -> list[Floats]:
    """Return the poses of each drive, (n, 2) metres: x and y.

    Args:
        source: a table or a CSV file with columns ``x`` and ``y``, in metres, and perhaps
            ``drive``, a number or name. Without it, a gap of more than `MAX_GAP` begins a drive.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is no table, lacks a column or has it twice; a row has no finite x and
            y, or no drive.
    """
    table = source if isinstance(source, pd.DataFrame) else _table_of(Path(source))
    table = table.rename(columns=lambda name: str(name).strip().lower())
    names = list(table.columns)
    if names.count("x") != 1 or names.count("y") != 1 or names.count("drive") > 1:
        raise ValueError(
            f"drives: got the columns {', '.join(names)}, expected one x and one y, in metres, and "
            "perhaps one drive (capital letters count as small ones)"
        )
    if not len(table):
        return []
    poses = table[["x", "y"]].apply(pd.to_numeric, errors="coerce").to_numpy(np.float64)
    is_finite = np.isfinite(poses).all(axis=1)
    if not is_finite.all():
        row = int(np.argmin(is_finite))
        x, y = table["x"].iloc[row], table["y"].iloc[row]
        raise ValueError(f"drives: row {row} has x {x} and y {y}, expected finite metres")
    if "drive" not in table:
        gaps = np.hypot(*np.diff(poses, axis=0).T)
        return np.split(poses, np.flatnonzero(gaps > MAX_GAP) + 1)
    is_empty = table["drive"].isna().to_numpy()
    if is_empty.any():
        raise ValueError(
            f"drives: row {int(np.argmax(is_empty))} has an empty drive, expected a number or name "
            "in each row, or no column drive at all"
        )
    return [poses[rows] for rows in table.groupby("drive", sort=False).indices.values()]


def _table_of(path: Path) -> pd.DataFrame:
    """Return the table of a CSV file."""
    try:
        return pd.read_csv(path)
    except (pd.errors.EmptyDataError, pd.errors.ParserError, UnicodeDecodeError) as error:
        raise ValueError(
            f"{path}: is no table, expected a CSV file whose first line is x,y or x,y,drive "
            f"({str(error).strip()})"
        ) from error


def cells_of_drive(
    poses: Floats, ros_map: RosMap, grid: Bytes
) -> tuple[list[Ints], dict[str, int]]:
    """Return the parts of a drive that lie on free cells, and how much was dropped.

    Poses are snapped to cells, and cells that are no neighbours are joined by straight moves.

    Args:
        poses: (n, 2), in metres.
        ros_map: the map.
        grid: (H, W), where the middle of the robot can be.

    Returns:
        Parts, (k, 2) each, of at least `MIN_PART` cells; and numbers of poses outside of the map,
        of cells that are not free, and of cells in parts that are too short.
    """
    upper_right = ros_map.to_metres(points=np.array([0.0, grid.shape[1]]))
    # Distances from the lower left corner along the map's own axes, in cells.
    corner = ros_map.to_metres(points=np.array([float(grid.shape[0]), 0.0]))
    upper_left = ros_map.to_metres(points=np.zeros(2))
    right_axis = (upper_right - upper_left) / (grid.shape[1] * ros_map.resolution)
    up_axis = (upper_left - corner) / (grid.shape[0] * ros_map.resolution)
    columns = (poses - corner) @ right_axis / ros_map.resolution
    rows = grid.shape[0] - (poses - corner) @ up_axis / ros_map.resolution
    is_inside = (rows >= 0) & (rows < grid.shape[0]) & (columns >= 0) & (columns < grid.shape[1])
    cells = np.stack([np.floor(rows), np.floor(columns)], axis=1)[is_inside].astype(np.int64)
    joined = _joined(cells)
    is_free = grid[tuple(joined.T)] == 0
    breaks = np.flatnonzero(np.diff(is_free.astype(np.int8)) != 0) + 1
    stretches = np.split(np.arange(len(joined)), breaks)
    free_stretches = [joined[k] for k in stretches if len(k) and is_free[k[0]]]
    parts = [part for part in free_stretches if len(part) >= MIN_PART]
    dropped = {
        "poses outside of the map": int((~is_inside).sum()),
        "cells that are not free": int((~is_free).sum()),
        "cells in parts that are too short": int(is_free.sum()) - sum(map(len, parts)),
    }
    return parts, dropped


def _joined(cells: Ints) -> Ints:
    """Return cells (k, 2) with straight lines between them, and no cell twice in a row."""
    if not len(cells):
        return cells
    steps = np.abs(np.diff(cells, axis=0)).max(axis=1)  # moves from each cell to the next one
    pieces = [cells[:1]]
    for cell, following, count in zip(cells[:-1], cells[1:], steps.tolist(), strict=True):
        shares = np.arange(1, count + 1)[:, None] / max(count, 1)
        pieces.append(np.rint(cell + shares * (following - cell)).astype(np.int64))
    return np.concatenate(pieces)


def random_parts(drives: list[Drive], count: int, rng: np.random.Generator) -> list[Drive]:
    """Return random parts of drives, none of which ends where it begins.

    A drive is chosen in proportion to its cells.
    """
    lengths = np.array([len(drive.cells) for drive in drives])
    parts = []
    for k in rng.choice(len(drives), count, p=lengths / lengths.sum()).tolist():
        longest = min(MAX_PART, int(lengths[k]))
        # Short and long parts are equally likely, in the logarithm of their lengths.
        length = round(math.exp(rng.uniform(math.log(MIN_PART), math.log(longest))))
        first = int(rng.integers(lengths[k] - length + 1))
        cells = drives[k].cells[first : first + length]
        if (cells[0] == cells[-1]).all():
            cells = cells[:-1]  # the cheapest path of a closed part would cost nothing
        parts.append(Drive(drives[k].map, cells))
    return parts
