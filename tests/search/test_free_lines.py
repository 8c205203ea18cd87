"""Free segments and lines, by an exact oracle in fractions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from helpers import taut_reference
from helpers.examples import slow

from mapdata import lines_are_free
from mapdata.search.free_lines import CELL, _is_far_from_corner, has_room, is_free_segment

Grid = npt.NDArray[np.uint8]
Line = npt.NDArray[np.float64]


def segments(count: int, source: np.random.Generator) -> Iterator[tuple[Grid, Any, bool]]:
    """Yield maps, segments (row, column, row, column) in 1/256 cell, and corner rules.

    Most of them touch corners, sides or middles of cells.
    """
    for number in range(count):
        if number % 50 == 0:
            share = source.choice([0.15, 0.3, 0.5])
            grid = (source.random(source.integers(1, 9, size=2)) < share).astype(np.uint8)
        ends = source.integers(-1, 9 * CELL, size=4)
        grain = source.choice([1, 64, 128, 256], p=[0.2, 0.1, 0.3, 0.4])
        ends -= ends % grain
        if source.random() < 0.2:
            axis = source.integers(2)
            ends[axis + 2] = ends[axis]
        yield grid, ends.tolist(), bool(source.random() < 0.5)


@pytest.mark.parametrize(
    "count",
    [300, slow(1500), pytest.param(1_000_000, marks=pytest.mark.soak)],
)
def test_free_segments_are_those_of_the_oracle(count: int) -> None:
    """Whether they cross cells, run along their sides or touch their corners."""
    free = 0
    for grid, ends, corner_cutting in segments(count, np.random.default_rng(count)):
        row0, column0, row1, column1 = ends
        start = (Fraction(row0, CELL), Fraction(column0, CELL))
        end = (Fraction(row1, CELL), Fraction(column1, CELL))
        expected = taut_reference.is_free_segment(grid, start, end, corner_cutting)
        is_free = is_free_segment(grid, row0, column0, row1, column1, corner_cutting)
        assert is_free == expected, (grid, ends)
        free += expected
    assert count / 20 < free < count / 2


@pytest.mark.parametrize("count", [150, pytest.param(20_000, marks=pytest.mark.soak)])
def test_distances_are_those_of_the_oracle(count: int) -> None:
    """A segment has room exactly up to its distance, which is compared as a fraction."""
    source = np.random.default_rng(count)
    positive = 0
    for grid, ends, _ in segments(count, source):
        row0, column0, row1, column1 = ends
        start = (Fraction(row0, CELL), Fraction(column0, CELL))
        end = (Fraction(row1, CELL), Fraction(column1, CELL))
        if not taut_reference.is_free_segment(grid, start, end, True):
            continue
        squared = taut_reference.squared_distance(grid, start, end) * CELL**2
        whole = math.floor(squared)
        assert has_room(grid, row0, column0, row1, column1, whole)
        assert not has_room(grid, row0, column0, row1, column1, whole + 1)
        positive += squared > 0
    assert positive > count / 100


def test_squared_cross_products_do_not_overflow() -> None:
    """Points that are exactly at the radius, or just inside it, beside lines of any length."""
    source = np.random.default_rng(4)
    for bits in range(4, 25):
        for _ in range(20):
            rise, run = source.integers(1, 2**bits, size=2).tolist()
            squared_length = rise * rise + run * run
            row = rise // 2 + int(source.integers(0, 2**bits))
            column = run // 2 - int(source.integers(0, 2**bits))
            if not 0 < row * rise + column * run < squared_length:
                continue
            cross = row * run - column * rise
            largest = cross * cross // squared_length
            for squared_radius in (largest, largest + 1, 2 * largest + 1):
                expected = cross * cross >= squared_radius * squared_length
                assert _is_far_from_corner(row, column, rise, run, squared_radius) == expected


@pytest.mark.parametrize("radius", [slow(0), 0.4])
def test_lines_of_models_are_free_if_all_their_segments_are(radius: float) -> None:
    """By the exact oracle, for points anywhere, also outside the map, and for single points."""
    source = np.random.default_rng(6)
    grids = (source.random((60, 6, 6)) < 0.04).astype(np.uint8)
    for count in (1, 3):
        lines = source.integers(-1, 26, size=(60, count, 2)) / 4
        expected = []
        for grid, line in zip(grids, lines, strict=True):
            points = taut_reference.in_fractions(line)
            segments_of_line = [*pairwise(points)] or [(points[0], points[0])]
            expected.append(
                all(
                    taut_reference.is_free_segment(grid, before, after, False)
                    and taut_reference.squared_distance(grid, before, after) >= radius**2
                    for before, after in segments_of_line
                )
            )
        assert lines_are_free(grids, lines, radius).tolist() == expected
        assert 0 < sum(expected) < 60
    touching = np.array([[0, 1], [1, 0]], np.uint8)
    between = [[[0.5, 0.5], [1.5, 1.5]]]
    assert lines_are_free([touching], between).tolist() == [False]
    assert lines_are_free([touching], between, corner_cutting=True).tolist() == [True]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (np.zeros((2, 3, 2)), r"lines: got shape \(2, 3, 2\) for 1 grids, expected \(1, T, 2\)"),
        (np.zeros((1, 3)), r"lines: got shape \(1, 3\)"),
        (np.zeros((1, 0, 2)), r"lines: got shape \(1, 0, 2\)"),
    ],
)
def test_lines_of_another_shape_are_refused(lines: Line, message: str) -> None:
    """The error names the shape that fits the grids."""
    with pytest.raises(ValueError, match=message):
        lines_are_free(np.zeros((1, 3, 4), np.uint8), lines)


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf, 1e300])
def test_lines_with_numbers_that_are_no_positions_collide(number: float) -> None:
    """A network that diverged gets no error in the middle of a validation."""
    lines = np.full((3, 4, 2), 1.5)
    lines[1, 2, 1] = number
    assert lines_are_free(np.zeros((3, 3, 4), np.uint8), lines).tolist() == [True, False, True]


def test_lines_are_tested_on_maps_as_datasets_serve_them() -> None:
    """A channel axis, floats, tensors, and a batch without problems."""
    maps = torch.tensor([[[[0, 1], [0, 0]]], [[[0, 0], [0, 0]]]], dtype=torch.float32)
    lines = torch.tensor([[[0.5, 0.5], [0.5, 1.5]]] * 2)
    assert lines_are_free(maps, lines).tolist() == [False, True]
    assert lines_are_free(maps[:0], lines[:0]).tolist() == []
    with pytest.raises(ValueError, match=r"grid: got shape \(1, 2, 2, 2\), expected \(B, H, W\)"):
        lines_are_free(np.zeros((1, 2, 2, 2), np.uint8), np.zeros((1, 3, 2)))
