"""The lines of a MovingAI .scen: its problems, and what a published length says.

A line of a .scen: bucket, map, width, height, start x, start y, goal x, goal y, optimal length; x
is the column. Files of the first version have spaces, no line `version` and no sizes. Length 0
between different cells means no path. Some copies in the wild end with an empty line and a
citation.

Source: https://movingai.com/benchmarks/formats.html.
"""

from __future__ import annotations

import math
import re
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from mapdata.formats.files import LIMITS, Limits, read_text
from mapdata.limits import Cell, Size
from mapdata.npy import FormatError
from mapdata.shards.files import StrPath

_LINE = re.compile(
    r"(?P<bucket>\d{1,9}) (?P<map>.+?)(?: (?P<width>\d{1,9}) (?P<height>\d{1,9}))?"
    r" (?P<start_x>\d{1,9}) (?P<start_y>\d{1,9}) (?P<goal_x>\d{1,9}) (?P<goal_y>\d{1,9})"
    r" (?P<length>\d+(?:\.\d*)?)",
    re.ASCII,
)
"""A line of a .scen, its fields with one space between them."""


class Problem(NamedTuple):
    """A line of a .scen, with cells as (row, col).

    Attributes:
        bucket: length // 4 in the benchmark's own files.
        map: the map's name as the file has it.
        size: (rows, columns) of the map, None in files of the first version.
        start, goal: cells.
        length: optimal length as printed; 0 between different cells means that there is no path.
        line: number of the line, from 1.
        unit: unit of the last printed digit of the length, such as 0.01.
    """

    bucket: int
    map: str
    size: Size | None
    start: Cell
    goal: Cell
    length: str
    line: int
    unit: float


def read_scen(path: StrPath, limits: Limits = LIMITS) -> list[Problem]:
    """Return the problems of a .scen file, of either version.

    Raises:
        FormatError: a line that cannot be read; the message says which.
    """
    path = Path(path)
    problems: list[Problem] = []
    lines = read_text(path, limits).split("\n")
    for number, (previous_line, line) in enumerate(pairwise(["", *lines]), start=1):
        words = line.split()
        is_version = words[:1] == ["version"] and not problems
        if not words or is_version:
            continue
        is_after_empty_line = not previous_line.strip()
        if problems and is_after_empty_line and not words[0].isdecimal():
            break  # the citation at the end of some files
        problems.append(_parse_problem(line, number, path))
    decimal_counts = {_decimal_count(problem.length) for problem in problems}
    is_fixed = len(decimal_counts) == 1 and 0 not in decimal_counts
    return [problem._replace(unit=_unit(problem.length, is_fixed)) for problem in problems]


def _parse_problem(line: str, number: int, path: Path) -> Problem:
    """Return the problem of a line, with NaN as its unit, which depends on all lines of the file.

    The first line has the number 1.

    Raises:
        FormatError: fields are missing, or are no numbers.
    """
    words = line.split()
    if number == 1 and words[0].lower() == "type":
        raise FormatError(
            f"{path}: is a map, expected a .scen file of problems, such as {path.name}.scen"
        )
    match = _LINE.fullmatch(" ".join(words))
    # With 8 fields either width or height is missing, and the other one would become a part of
    # the map's name.
    if match is None or len(words) == 8:
        raise FormatError(
            f"{path}: line {number} has {len(words)} fields, {line[:60]!r}, expected numbers of at "
            "least 0 around the map, in all 9 fields (or 7 in the old form)"
        )
    size = None
    if match["width"] is not None:
        size = (int(match["height"]), int(match["width"]))
    return Problem(
        bucket=int(match["bucket"]),
        map=match["map"],
        size=size,
        start=(int(match["start_y"]), int(match["start_x"])),
        goal=(int(match["goal_y"]), int(match["goal_x"])),
        length=match["length"],
        line=number,
        unit=math.nan,
    )


def _decimal_count(length: str) -> int:
    """Return the number of digits after the point of a printed length."""
    _, _, decimals = length.partition(".")
    return len(decimals)


def _unit(length: str, is_fixed: bool) -> float:
    """Return the unit of the last digit of a printed length.

    Args:
        length: as printed.
        is_fixed: whether all lengths of the file have the same number of decimals, as in 459.10.
            If not, they are printed with six significant digits without trailing zeros, so that
            440.72 stands for 440.720, or with all digits of a double.
    """
    decimal_count = _decimal_count(length)
    if not is_fixed:
        whole, _, _ = length.partition(".")
        decimal_count = max(decimal_count, 6 - len(whole))
    return 10.0**-decimal_count


def agrees(problem: Problem, cost: float) -> bool:
    """Return whether a .scen prints an optimal cost (-1: no path), up to its last digit.

    The benchmark's own files count a diagonal as 1.414213562, and files of six significant digits
    as 1.41421354, sqrt 2 in float32. So their lengths may be a little smaller than ours.
    """
    stated = float(problem.length)
    if cost < 0:
        return stated == 0 and problem.start != problem.goal
    if stated == 0:
        return problem.start == problem.goal
    digits = problem.length.replace(".", "")
    diagonal = 1.41421354 if len(digits) <= 6 else 1.414213562
    # The difference is greatest if all moves are diagonal.
    min_length = cost * diagonal / math.sqrt(2)
    # Half a unit for rounding, and a little more for the errors of floating-point numbers.
    tolerance = 0.5 * problem.unit * (1 + 1e-9) + 1e-12 * cost
    return min_length - tolerance <= stated <= cost + tolerance
