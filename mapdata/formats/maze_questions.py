"""Mazes as text: the question of a model, and the words of its answer."""

from __future__ import annotations

import math
import re
from typing import NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Flags
from mapdata.checks import check_sides
from mapdata.limits import Size
from mapdata.npy import FormatError

MOVES = {"up": (-1, 0), "down": (1, 0), "left": (0, -1), "right": (0, 1)}
"""The words of an answer, and the change of (row, col) that each means."""

INFEASIBLE = "infeasible"
"""The answer to a problem without a path."""

_MAZE = re.compile("[# ]*(S[# ]*G|G[# ]*S)[# ]*")
"""A question has one start and one goal, and otherwise occupied and free cells."""

_OCCUPIED, _START, _GOAL = np.frombuffer(b"#SG", np.uint8)
"""The ASCII codes of the cells."""


class Question(NamedTuple):
    """A question.

    Attributes:
        cells: (H, W) uint8, ASCII codes.
        start: (row, col).
        goal: (row, col).
    """

    cells: Bytes
    start: tuple[int, int]
    goal: tuple[int, int]

    @property
    def is_occupied(self) -> Flags:
        """(H, W) bool."""
        occupied: Flags = self.cells == _OCCUPIED
        return occupied

    @property
    def text(self) -> str:
        """The cells row by row, without line ends."""
        return self.cells.tobytes().decode("ascii")


def parse_question(question: object, size: Size | None = None) -> Question:
    """Return the maze of a question.

    Args:
        question: the cells as text; rows are lines, or follow one another in one line.
        size: (rows, columns); None for those of the lines, or for a square in one line.

    Raises:
        FormatError: the question is no map with one S and one G, or has another size.
        ValueError: ``size`` is no size of a map.
    """
    if not isinstance(question, str):
        raise FormatError(
            f"question: got {type_name(question)}, expected a text: the prompt of "
            "mapdata.datasets.maze_text, or of an export; tokens of HRM and TRM are no text"
        )
    question = question.replace("\r\n", "\n").strip("\n")
    if not _MAZE.fullmatch(question.replace("\n", "")):
        raise FormatError(
            "question: expected the maze alone, without instructions around it: cells '#' and ' ', "
            "one S and one G"
        )
    cells = _grid_of_cells(question, None if size is None else check_sides("size", size))
    ((start_row, start_column),) = np.argwhere(cells == _START).tolist()
    ((goal_row, goal_column),) = np.argwhere(cells == _GOAL).tolist()
    return Question(cells, (start_row, start_column), (goal_row, goal_column))


def type_name(value: object) -> str:
    """Return what a value is, for errors: its repr may be large."""
    return f"a value of type {type(value).__name__}"


def _grid_of_cells(text: str, size: Size | None) -> Bytes:
    """Return the characters of a map as ASCII codes, (H, W) uint8.

    Raises:
        FormatError: lines of several lengths; lines or a number of cells that contradict the size;
            without lines and size, not as many characters as a square has.
    """
    lines = text.split("\n")
    codes = np.frombuffer("".join(lines).encode("ascii"), np.uint8)
    if len(lines) > 1:
        if len(set(map(len, lines))) != 1:
            raise FormatError("question: got lines of several lengths, expected one length")
        size_of_lines = (len(lines), len(lines[0]))
        if size not in (None, size_of_lines):
            raise FormatError(
                f"question: got {size_of_lines[0]} lines of {size_of_lines[1]} cells, expected "
                f"size={size}"
            )
        return codes.reshape(size_of_lines)
    if size is None:
        side = math.isqrt(len(text))
        if side * side != len(text):
            raise FormatError(
                f"question: got {len(text)} cells in one line, expected a square map, its rows as "
                "lines, or size=(rows, columns); a map of one row needs size"
            )
        size = (side, side)
    if size[0] * size[1] != len(text):
        raise FormatError(
            f"question: got {len(text)} cells in one line, expected size={size}, that is "
            f"{size[0] * size[1]} cells"
        )
    return codes.reshape(size)
