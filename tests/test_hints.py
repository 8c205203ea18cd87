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
    "unknown cells": (np.where(WALLS, -1, 0), "an OccupancyGrid of ROS"),
    "costs": (np.where(WALLS, np.inf, 1.5), "costs with infinity on walls"),
    "costs alone": (np.where(WALLS, 9, 1), "costs without walls"),
    "probabilities": (np.where(WALLS, 0.9, RAMP), "probabilities"),
    "holes": (np.where(WALLS, np.nan, 0), "cells without a number"),
    "kinds": (np.where(WALLS, 2, 0), "numbers of kinds of cells"),
    "heights": (np.where(WALLS, 2.5, -RAMP), "measured values"),
    "letters": (np.where(WALLS, "#", "."), "letters"),
    "rows": (["####", "#..#", "#..#", "####"], "letters"),
}


def test_each_hint_has_an_example() -> None:
    """No row of the table is behind another one that always applies first."""
    meanings = {meaning for _, meaning in ARRAYS.values()}
    assert all(any(hint.meaning.startswith(each) for each in meanings) for hint in HINTS)


@pytest.mark.parametrize("name", ARRAYS)
def test_the_line_of_numpy_makes_a_grid(name: str) -> None:
    """The error of a search names the array, and its line gives a grid that the search takes."""
    values, meaning = ARRAYS[name]
    with pytest.raises(ValueError, match=f"^grid: got .*; it looks like {meaning}") as caught:
        astar(values, (1, 1), (2, 2))
    remedies = re.findall(r"(?:: |, )([^:]+?) (?:makes|is the grid)", str(caught.value))
    assert remedies
    for remedy in remedies:
        numbers = {"k": 2, "limit": 1.0}
        grid = eval(remedy, {"np": np, "values": values, **numbers})
        # the first line makes the walls of the example occupied, where it has any
        assert astar(grid, (1, 1), (2, 2)).cost in (2, -1)
        if remedy == remedies[0] and name not in ("costs alone", "rows"):
            assert np.array_equal(grid, WALLS)


def test_arrays_of_0_and_1_need_no_hint() -> None:
    """The reason is another one then, such as the shape."""
    for array in (WALLS, WALLS.astype(bool), WALLS.astype(float), np.array([None])):
        assert hint_on_values(array) == ""


def test_numbers_up_to_101_are_no_brightness() -> None:
    """No cell of such an array would be bright."""
    assert "numbers of kinds of cells" in hint_on_values(np.array([[0, 100, 101]]))


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
