"""All movements, and specs drawn at random: hypothesis finds the one that fails."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import pytest
from hypothesis import strategies as st

from helpers.examples import slow
from mapdata import MapSpec, Maze, Movement

MOVEMENTS = [
    Movement(),
    Movement(8),
    Movement(8, diagonal_cost=1),
    Movement(8, corner_cutting=True),
    Movement(8, corner_cutting=True, diagonal_cost=1),
]
movements = pytest.mark.parametrize(
    "movement",
    [slow(one) if one.corner_cutting != (one.diagonal_cost == 1) else one for one in MOVEMENTS],
    ids=["4", "8", "8-one", "8-cutting", "8-cutting-one"],
)
"""The default run tries each value of each attribute, not all combinations of the last two."""


@dataclass(frozen=True)
class Noted(Maze):
    """Mazes with a remark, whose JSON may be long."""

    name: ClassVar[str] = "noted"
    note: str = ""


@st.composite
def limits(draw: st.DrawFn, low: int, high: int) -> tuple[int, int]:
    """Draw (lower, upper) limits inside low..high."""
    first = draw(st.integers(low, high))
    second = draw(st.integers(low, high))
    return min(first, second), max(first, second)


SIDES = st.one_of(st.just(1), st.integers(2, 33), st.sampled_from([63, 64, 65, 129]))
"""One row or column, odd sizes, and both sides of 64 and 128, where words of bits end."""


@st.composite
def specs(draw: st.DrawFn) -> MapSpec:
    """Draw a valid spec of any shape, with rooms up to the whole map."""
    height = draw(SIDES)
    width = draw(SIDES)
    train = draw(st.integers(0, 100))
    validation = draw(st.integers(0, 100 - train))
    return MapSpec(
        map_size=(height, width),
        rooms=draw(limits(2, 8)),
        room_rows=draw(limits(1, height)),
        room_columns=draw(limits(1, width)),
        passage_width=draw(limits(1, min(height, width))),
        skip_probability=draw(st.sampled_from([0.0, 0.1, 0.5, 1.0]) | st.floats(0, 1)),
        resolution=draw(st.floats(1e-3, 1e3)),
        movement=draw(st.sampled_from(MOVEMENTS)),
        splits=(train / 100, validation / 100, (100 - train - validation) / 100),
    )
