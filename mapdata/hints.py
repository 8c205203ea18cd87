"""What an array or a file probably is, for errors where another one is expected.

`HINTS` is the one table of what the numbers of an array mean where 0 free and 1 occupied are
expected. Each entry states what to do, as a line of numpy in which the array is called ``values``.
`CONTENTS` is the one table of what a file is that cannot be read under its name.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mapdata.arrays import Array


class Facts(NamedTuple):
    """What `HINTS` look at in an array of numbers.

    Attributes:
        low: the lowest finite number.
        high: the highest finite number.
        are_integers: whether all finite numbers are whole.
        has_nan: whether there is a NaN.
        has_infinity: whether there is an infinite number.
        is_wrapped: whether 255 and 100 are the two highest numbers, so that 255 is probably a -1
            that was stored as an unsigned byte.
    """

    low: float
    high: float
    are_integers: bool
    has_nan: bool
    has_infinity: bool
    is_wrapped: bool


class Hint(NamedTuple):
    """A meaning of an array, and what to do.

    Attributes:
        meaning: what the array seems to be.
        remedy: lines of numpy that make a grid of it.
        applies: whether an array with these `Facts` has this meaning.
    """

    meaning: str
    remedy: str
    applies: Callable[[Facts], bool]


HINTS = (
    Hint(
        "cells without a number",
        "np.nan_to_num(values, nan=1) makes cells of NaN occupied",
        lambda facts: facts.has_nan,
    ),
    Hint(
        "costs with infinity on walls",
        "np.isinf(values) is the grid, and terrain= takes costs as integers from 1 to 255",
        lambda facts: facts.has_infinity,
    ),
    Hint(
        "probabilities",
        "values > 0.5 makes probable obstacles occupied",
        lambda facts: facts.low >= 0 and facts.high <= 1 and not facts.are_integers,
    ),
    Hint(
        "an OccupancyGrid of ROS as bytes without a sign: 255 unknown, 0 free, 100 occupied",
        "values != 0 makes unknown cells occupied, (values > 50) & (values <= 100) makes them free",
        lambda facts: facts.low == 0 and facts.is_wrapped,
    ),
    Hint(
        "the brightness of a picture",
        "values < 128 makes dark cells occupied, values >= 128 bright ones",
        lambda facts: facts.low >= 0 and 128 <= facts.high <= 255,
    ),
    Hint(
        "an OccupancyGrid of ROS: -1 unknown, 0 free, 100 occupied",
        "values != 0 makes unknown cells occupied, values > 50 makes them free",
        lambda facts: (
            facts.are_integers
            and -1 <= facts.low <= 0
            and facts.high <= 100
            and (facts.low == -1 or facts.high == 100)
        ),
    ),
    Hint(
        "costs without walls",
        "np.zeros(values.shape) is the grid, and terrain= takes costs as integers from 1 to 255",
        lambda facts: facts.low > 0,
    ),
    Hint(
        "numbers of kinds of cells",
        "values == k makes cells of the number k occupied",
        lambda facts: facts.are_integers,
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
        return (
            '; it looks like letters: np.array([list(row) for row in values]) == "#" makes the '
            "cells of # occupied"
        )
    if values.dtype.kind not in "iuf" or ((values == 0) | (values == 1)).all():
        return ""
    finite = values[np.isfinite(values)]
    facts = Facts(
        low=float(finite.min()) if finite.size else 0.0,
        high=float(finite.max()) if finite.size else 0.0,
        are_integers=bool((finite == np.floor(finite)).all()),
        has_nan=bool(np.isnan(values).any()),
        has_infinity=bool(np.isinf(values).any()),
        is_wrapped=bool((finite == 255).any() and finite[finite != 255].max(initial=0) == 100),
    )
    hint = next(hint for hint in HINTS if hint.applies(facts))
    return f"; it looks like {hint.meaning}: {hint.remedy}"


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
