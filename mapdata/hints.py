"""What an array or a file probably is, for errors where another one is expected.

`HINTS` is the one table of what the numbers of an array mean where 0 free and 1 occupied are
expected. Each entry states what to do, as a line of numpy in which the array is called ``values``.
`CONTENTS` is the one table of what a file is that cannot be read under its name.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mapdata.arrays import Array


class Facts(NamedTuple):
    """What `HINTS` look at in an array of numbers.

    Attributes:
        low: the lowest number, which may be -inf.
        high: the highest finite number.
        are_integers: whether all finite numbers are whole.
        kinds: how many different finite numbers there are.
        has_nan: whether there is a NaN.
        has_infinity: whether there is an infinite number.
        is_wrapped: whether 255 and 100 are the two highest numbers, so that 255 is probably a -1
            that was stored as an unsigned byte.
        has_flipped_tiles: whether some numbers have bits by which Tiled says how a tile is flipped.
        missing: the number that stands for "no data"; None if there is none.
    """

    low: float
    high: float
    are_integers: bool
    kinds: int
    has_nan: bool
    has_infinity: bool
    is_wrapped: bool
    has_flipped_tiles: bool
    missing: float | None


_MISSING = (-999.0, -9999.0, -99999.0, -32767.0, -32768.0, float(np.finfo(np.float32).min))
"""The numbers below all others that stand for "no data" in grids of heights and distances."""

_FIRST_FLAG = 2**28
"""The lowest of the four highest bits of 32, which say how a tile of Tiled is flipped or rotated.

Source: https://doc.mapeditor.org/en/stable/reference/global-tile-ids/.
"""

_MAX_KINDS = 64
"""Most numbers of kinds of cells; more different numbers are measured values."""


_NUMBER = re.compile(r"[-+]?[0-9]*\.?[0-9]+")
"""A number as text."""


class Hint(NamedTuple):
    """A meaning of an array, and what to do.

    Attributes:
        meaning: what the array seems to be.
        remedy: lines of numpy that make a grid of it; ``{missing}`` stands for that fact.
        applies: whether an array with these `Facts` has this meaning, as far as one can be sure.
    """

    meaning: str
    remedy: str
    applies: Callable[[Facts], bool]


HINTS = (
    Hint(
        "numbers of tiles, some of them flipped, of the program Tiled",
        "np.isin(values.astype(np.int64) % 2**28, walls) makes tiles of the numbers in walls "
        "occupied",
        lambda facts: facts.has_flipped_tiles,
    ),
    Hint(
        "measured values, and {missing} where there is none",
        "(values == {missing}) | (values > limit) makes these cells and those above a limit "
        "occupied",
        lambda facts: facts.missing is not None,
    ),
    Hint(
        "cells without a number",
        "np.nan_to_num(values, nan=1) makes cells of NaN occupied",
        lambda facts: (
            facts.has_nan
            and not facts.has_infinity
            and 0 <= facts.low <= facts.high <= 1
            and facts.are_integers
        ),
    ),
    Hint(
        "measured values, and NaN where there is none",
        "np.isnan(values) | (values > limit) makes these cells and those above a limit occupied",
        lambda facts: facts.has_nan,
    ),
    Hint(
        "costs with infinity on walls",
        "np.isinf(values) is the grid, and terrain= takes costs as integers from 1 to 255",
        lambda facts: facts.has_infinity and facts.low >= 0,
    ),
    Hint(
        "probabilities, or brightness from 0 to 1",
        "values > 0.5 makes probable obstacles occupied, values < 0.5 dark cells",
        lambda facts: 0 <= facts.low <= facts.high <= 1 and not facts.are_integers,
    ),
    Hint(
        "an OccupancyGrid of ROS as bytes without a sign: 255 unknown, 0 free, 100 occupied",
        "values != 0 makes unknown cells occupied, (values > 50) & (values <= 100) makes them free",
        lambda facts: facts.low == 0 and facts.is_wrapped,
    ),
    Hint(
        "the brightness of a picture",
        "values < 128 makes dark cells occupied, values >= 128 bright ones",
        lambda facts: facts.are_integers and facts.low >= 0 and 200 <= facts.high <= 255,
    ),
    Hint(
        "an OccupancyGrid of ROS: -1 unknown, 0 free, 100 occupied",
        "values != 0 makes unknown cells occupied, values > 50 makes them free",
        lambda facts: facts.are_integers and facts.low in (-1, 0) and facts.high == 100,
    ),
    Hint(
        "numbers of kinds of cells, or costs",
        "values == k makes cells of the number k occupied; terrain= takes costs as integers from "
        "1 to 255",
        lambda facts: facts.are_integers and facts.kinds <= _MAX_KINDS,
    ),
    Hint(
        "measured values",
        "values > limit makes cells above a limit occupied",
        lambda facts: True,
    ),
)
"""The meanings; the first one that applies is the hint."""


def hint_on_values(values: Array) -> str:
    """Return the end of an error message: what an array seems to hold, and how to make a grid.

    It is empty for an array of 0 and 1 alone, and for one that holds neither numbers nor letters.

    >>> hint_on_values(np.array([[-1, 0], [100, 0]]))[:46]
    '; it looks like an OccupancyGrid of ROS: -1 un'
    """
    if values.dtype.kind in "US":
        return f"; it looks like {_meaning_of_texts(values)}"
    if values.dtype.kind not in "iuf" or ((values == 0) | (values == 1)).all():
        return ""
    facts = _facts_of(values)
    hint = next(hint for hint in HINTS if hint.applies(facts))
    text = f"; it looks like {hint.meaning}: {hint.remedy}"
    return text if facts.missing is None else text.format(missing=f"{facts.missing:.17g}")


def _facts_of(values: Array) -> Facts:
    """Return what `HINTS` look at in an array of numbers."""
    numbers = np.unique(values[np.isfinite(values)])
    if not numbers.size:
        numbers = np.zeros(1)
    low, high = float(numbers[0]), float(numbers[-1])
    are_integers = bool((numbers == np.floor(numbers)).all())
    has_flipped_tiles = False
    if are_integers and low >= -(2**31) and high < 2**32:
        whole = numbers.astype(np.int64)
        tiles = whole % _FIRST_FLAG
        is_flipped = (whole >= _FIRST_FLAG) | (whole < -_FIRST_FLAG)
        # No set has as many tiles as the other bits could count, and tile 0 is none.
        has_flipped_tiles = bool(
            is_flipped.any() and (tiles[is_flipped] > 0).all() and (tiles < 2**16).all()
        )
    # Other numbers that were measured would lie near to it.
    is_alone = len(numbers) > 1 and numbers[1] > low / 2
    return Facts(
        low=-math.inf if np.isneginf(values).any() else low,
        high=high,
        are_integers=are_integers,
        kinds=len(numbers),
        has_nan=bool(np.isnan(values).any()),
        has_infinity=bool(np.isinf(values).any()),
        is_wrapped=high == 255 and len(numbers) > 1 and bool(numbers[-2] == 100),
        has_flipped_tiles=has_flipped_tiles,
        missing=low if low in _MISSING and is_alone else None,
    )


def _meaning_of_texts(values: Array) -> str:
    """Return what an array of texts seems to hold, and how to make a grid of it."""
    if values.dtype.kind == "S":
        return "text as bytes: values.astype(str) makes letters of them"
    texts = {str(text).strip().lower() for text in np.unique(values)}
    if texts <= {"true", "false"}:
        return 'truth values as text: np.char.lower(values) == "true" makes the true ones occupied'
    if values.ndim > 1 and all(_NUMBER.fullmatch(text) for text in texts):
        return "numbers as text: values.astype(float) makes numbers of them"
    letter = next((letter for letter in "#@1" if any(letter in text for text in texts)), "X")
    return (
        f'letters: np.array([list(row) for row in values]) == "{letter}" makes the cells of '
        f"{letter} occupied"
    )


CONTENTS = (
    (
        b"version https://git-lfs.github.com/spec/",
        "a pointer of Git LFS to the file: git lfs pull fetches it",
    ),
    (b"/annex/objects/", "a pointer of git-annex to the file: git annex get fetches it"),
    (b"../.git/annex/objects/", "a pointer of git-annex to the file: git annex get fetches it"),
    (b"<!DOCTYPE html", "a web page: download the file itself, which GitHub calls raw"),
    (b"<html", "a web page: download the file itself, which GitHub calls raw"),
    (b"\x89PNG\r\n", "a PNG picture: its name should end with .png"),
    (b"\xff\xd8\xff", "a JPEG picture: its name should end with .jpg"),
    (b"\x93NUMPY", "an array of numpy: its name should end with .npy"),
    (b"PK\x03\x04", "a zip archive, as .npz files are: its name should end with .npz or .zip"),
    (b"\x1f\x8b", "packed by gzip: gunzip unpacks it"),
    (b"\xff\xfe", "text in UTF-16, as PowerShell writes it: save it as UTF-8"),
    (b"\xfe\xff", "text in UTF-16: save it as UTF-8"),
)
"""What files are, by their first bytes, and what to do."""

_PRINTED = frozenset(range(32, 127)) | frozenset(b"\t\r\n")
"""The bytes of plain text."""


def hint_on_content(start: bytes, *, text_expected: bool = False) -> str:
    """Return the end of an error message: what a file seems to be, and what to do.

    Args:
        start: the first bytes of the file, 64 of them or more.
        text_expected: plain text is no reason for a hint.

    >>> hint_on_content(b"0.0 1.0 0.0")
    '; it looks like plain text: its name should end with .txt or .csv'
    """
    for first_bytes, meaning in CONTENTS:
        if start[: len(first_bytes)].lower() == first_bytes.lower():
            return f"; it looks like {meaning}"
    if start and _PRINTED.issuperset(start) and not text_expected:
        return "; it looks like plain text: its name should end with .txt or .csv"
    return ""
