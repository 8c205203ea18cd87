"""Arrays with other numbers than 0 and 1: each error says what to do, and that works."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mapdata import Movement, ProblemSet, astar, clearance, inflate
from mapdata.formats import ForeignMap, FormatError, read_any
from mapdata.hints import HINTS, hint_on_values
from mapdata.search import distance_field

WALLS = np.pad(np.zeros((4, 6), np.uint8), 1, constant_values=1)
UNKNOWN = np.where(WALLS, -1, 0)
UNKNOWN[0, 0] = 100
RAMP = np.linspace(0.1, 0.4, WALLS.size).reshape(WALLS.shape)
ARRAYS: dict[str, tuple[Any, str]] = {
    "mask": (np.where(WALLS, 0, 255).astype(np.uint8), "the brightness of a picture"),
    "mask of floats": (np.where(WALLS, 0.0, 255.0), "the brightness of a picture"),
    "greys": (np.where(WALLS, 13, 240), "the brightness of a picture"),
    "occupancy": (np.where(WALLS, 100, 0).astype(np.int8), "an OccupancyGrid of ROS"),
    "occupancy as bytes": (
        np.where(np.cumsum(WALLS).reshape(WALLS.shape) < 4, 255, 100 * WALLS).astype(np.uint8),
        "an OccupancyGrid of ROS as bytes",
    ),
    "unknown cells": (UNKNOWN, "an OccupancyGrid of ROS"),
    "costs": (np.where(WALLS, np.inf, 1.5), "costs with infinity on walls"),
    "costs alone": (np.where(WALLS, 2, 1), "numbers of kinds of cells, or costs"),
    "probabilities": (np.where(WALLS, 0.9, RAMP), "probabilities, or brightness from 0 to 1"),
    "holes": (np.where(WALLS, np.nan, 0), "cells without a number"),
    "holes in heights": (np.where(WALLS, np.nan, -RAMP), "measured values, and NaN where there is"),
    "holes and infinity": (
        np.where(WALLS, np.where(np.eye(6, 8), np.inf, np.nan), 0),
        "measured values, and NaN where there is none",
    ),
    "kinds": (np.where(WALLS, 2, 0), "numbers of kinds of cells"),
    "empty tiles": (np.where(WALLS, 2, -1), "numbers of kinds of cells"),
    "heights": (np.where(WALLS, 2.5, -RAMP), "measured values"),
    "no data": (np.where(WALLS, -9999, -RAMP), "measured values, and -9999 where there is none"),
    "no data in whole metres": (
        np.where(WALLS, -32768, np.arange(-24, 24).reshape(6, 8) // 24).astype(np.int16),
        "measured values, and -32768 where there is none",
    ),
    "no data of GDAL": (
        np.where(WALLS, np.finfo(np.float32).min, RAMP).astype(np.float32),
        "measured values, and -3.4028234663852886e+38 where there is none",
    ),
    "tiles": (np.where(WALLS, 2**31 + 4, 1), "numbers of tiles, some of them flipped, of the prog"),
    "signed tiles": (np.where(WALLS, 4 - 2**31, 1).astype(np.int32), "numbers of tiles, some of"),
    "letters": (np.where(WALLS, "#", "."), "letters"),
    "rows": (["####", "#..#", "#..#", "####"], "letters"),
    "digits": (["1111", "1001", "1001", "1111"], "letters"),
    "texts": (WALLS.astype(str), "numbers as text"),
    "truth": (WALLS.astype(bool).astype(str), "truth values as text"),
    "bytes": (WALLS.astype("S"), "text as bytes"),
}


def test_each_hint_has_an_example() -> None:
    """No row of the table is behind another one that always applies first."""
    meanings = {meaning for _, meaning in ARRAYS.values()}
    assert all(any(hint.meaning.startswith(each) for each in meanings) for hint in HINTS)


@pytest.mark.parametrize("name", ARRAYS)
def test_the_line_of_numpy_makes_a_grid(name: str) -> None:
    """The error of a search names the array, and its line gives a grid that the search takes."""
    values, meaning = ARRAYS[name]
    with pytest.raises(
        ValueError, match=f"^grid: .*; it looks like {re.escape(meaning)}"
    ) as caught:
        astar(values, (1, 1), (2, 2))
    remedies = re.findall(r"(?:: |, )([^:]+?) (?:makes|is the grid)", str(caught.value))
    assert remedies
    for remedy in remedies:
        numbers = {"k": 2, "limit": 1.0, "walls": [4]}
        grid = eval(remedy, {"np": np, "values": values, **numbers})
        if name == "bytes":
            assert "numbers as text" in hint_on_values(grid)
            continue
        # the first line makes the walls of the example occupied
        assert astar(grid, (1, 1), (2, 2)).cost in (2, -1)
        if remedy == remedies[0] and name not in ("rows", "digits"):
            assert np.array_equal(grid, WALLS)


def test_arrays_of_0_and_1_need_no_hint() -> None:
    """The reason is another one then, such as the shape."""
    for array in (WALLS, WALLS.astype(bool), WALLS.astype(float), np.array([None])):
        assert hint_on_values(array) == ""


@pytest.mark.parametrize(
    ("values", "hint"),
    [
        ([0, 100, 101], "numbers of kinds of cells"),  # no cell would be bright
        ([0, 2**31], "numbers of kinds of cells"),  # there is no tile 0
        ([2**31 + 2**27, 1], "numbers of kinds of cells"),  # there are no sets of so many tiles
        ([-9999, -9000, 1], "numbers of kinds of cells"),  # a depth of the sea
        (np.linspace(3.0, 8.0, 9), "measured values: "),  # heights are no costs
        (np.arange(1, 300), "measured values: "),  # nor kinds of cells
        ([-np.inf, 0.5, 7.5], "measured values: "),  # no costs
        (["S", "."], 'letters: np.array([list(row) for row in values]) == "X"'),
    ],
)
def test_a_meaning_is_named_only_where_it_is_nearly_certain(values: Any, hint: str) -> None:
    """Others get the line that fits most arrays."""
    assert f"; it looks like {hint}" in hint_on_values(np.asarray(values))


def test_every_door_gives_the_hint(tmp_path: Path) -> None:
    """Searches, problem sets, clearance, maps in memory and files say the same."""
    mask = np.where(WALLS, 0, 255).astype(np.uint8)
    hint = re.escape(hint_on_values(mask))
    for call in (
        lambda: astar(mask, (1, 1), (2, 2)),
        lambda: distance_field(mask, (1, 1)),
        lambda: inflate(mask, 1.0),
        lambda: clearance(mask),
        lambda: ProblemSet(mask[None], np.array([[1, 1]]), np.array([[2, 2]]), Movement()),
        lambda: ForeignMap("mask", mask),
    ):
        with pytest.raises(ValueError, match=hint):
            call()
    np.save(tmp_path / "mask.npy", mask)
    np.savez(tmp_path / "mask.npz", maps=mask[None])
    np.savetxt(tmp_path / "mask.csv", mask, fmt="%d", delimiter=",")
    for name in ("mask.npy", "mask.npz"):
        with pytest.raises(FormatError, match=hint):
            read_any(tmp_path / name)
    with pytest.raises(FormatError, match="; it looks like the brightness of a picture"):
        read_any(tmp_path / "mask.csv")
