"""Mazes as text for sequence models, as in maze-30x30-hard-1k: a CSV for each split, in and out.

Source: https://huggingface.co/datasets/sapientinc/maze-30x30-hard-1k, which HRM
(https://arxiv.org/abs/2506.21734) and TRM (https://arxiv.org/abs/2510.04871) are trained on. After
a header each line has four columns:

| column | value |
|---|---|
| source | the origin of the maze, any text |
| question | the cells of a square map, row by row: "#" occupied, " " free, "S" start, "G" goal |
| answer | the same with "o" on the free cells of a shortest path, 4-connected |
| rating | how hard it is: here the moves of that path |
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import LIMITS, SPLIT_NAMES, Limits, check_file, files_with_endings
from mapdata.formats.registry import Format
from mapdata.movement import Movement
from mapdata.npy import FormatError
from mapdata.search.api import astar

HEADER = "source,question,answer,rating"

_QUESTION = re.compile("[# ]*(S[# ]*G|G[# ]*S)[# ]*")
"""A question has one start and one goal, and otherwise occupied and free cells."""

_OCCUPIED, _FREE, _START, _GOAL, _PATH = np.frombuffer(b"# SGo", np.uint8)
"""The ASCII codes of the cells."""


def is_maze_hard(path: Path) -> bool:
    """Return whether a CSV begins with this format's header."""
    with path.open("rb") as file:
        return file.readline(100).strip().lower() == HEADER.encode()


def read(source: Path, limits: Limits = LIMITS) -> Collection:
    """Read a CSV, or all below a folder; train.csv, val.csv and test.csv are those splits.

    Start and goal become the seed points of a map.

    Raises:
        FormatError: ``source`` is not there. Lines that are no maze are left out.
    """
    collection = Collection(movement=Movement())
    for path in files_with_endings(source, (".csv",), limits, collection):
        split = SPLIT_NAMES.get(path.stem.lower())
        with collection.leaving_out(path):
            check_file(path, limits)
            with path.open(encoding="latin-1", newline="\n") as file:
                next(file, "")  # skip the header
                for number, line in enumerate(file, 2):
                    name = f"{path}, line {number}"
                    with collection.leaving_out(name):
                        collection.maps.append(_parse_maze(name, line, split, limits))
    return collection


def _parse_maze(name: str, line: str, split: int | None, limits: Limits) -> ForeignMap:
    """Return the map of a line; its check says whether the answer is a shortest path.

    Args:
        name: of the map, and of the line in errors.
        line: text of the line.
        split: code of the split; None to draw it.
        limits: of the number of cells.

    Raises:
        FormatError: the line is no maze.
    """
    fields = line.rsplit(",", 3)  # only the first column, the source, may hold a comma
    if len(fields) < 4 or len(fields[1]) > limits.pixels:
        raise FormatError(
            f"{name}: expected {HEADER} of at most {limits.pixels} cells; --max-pixels sets this "
            "limit"
        )
    _, question, answer, _ = fields
    if not _QUESTION.fullmatch(question):
        raise FormatError(f"{name}: expected cells '#' and ' ', one S and one G")
    cells = _grid_of_cells(question)
    wrong_labels = [] if is_shortest_answer(question, answer) else ["answer"]
    return ForeignMap(
        name,
        cells == _OCCUPIED,
        split,
        seed_points=_start_and_goal(cells),
        rooms_known=True,
        check=lambda _labels, _number: wrong_labels,
    )


def is_shortest_answer(question: str, answer: str) -> bool:
    """Return whether an answer marks a shortest path.

    Many problems have several shortest paths, and a model may find another one than the file has.
    Line ends before and after the two texts are ignored, and CRLF is read as one line end. Spaces
    count, as they are free cells.

    Args:
        question: the cells of a map, row by row, with one S and one G. Rows are lines, as in
            `mapdata.datasets.maze_text`, or follow one another in a square map.
        answer: the question with some free cells marked by "o", as a model returns it.

    Raises:
        FormatError: the question is no map with one S and one G, or the answer is no text.

    >>> answers = ("Soo #o  G", "S  o# ooG", "S   #   G")
    >>> [is_shortest_answer("S   #   G", answer) for answer in answers]
    [True, True, False]
    """
    question = _without_outer_line_ends("question", question)
    answer = _without_outer_line_ends("answer", answer)
    if not _QUESTION.fullmatch(question.replace("\n", "")):
        raise FormatError("question: expected cells '#' and ' ', one S and one G")
    _grid_of_cells(question)  # raises an error if the rows are no map
    if answer.replace("o", " ") != question:
        return False
    cells = _grid_of_cells(answer)
    start, goal = _start_and_goal(cells)
    shortest_cost = astar(cells == _OCCUPIED, start, goal).cost
    # If all cells that are not marked are occupied, a path can only use marked cells. It uses all
    # of them if there are no more than it needs.
    is_unmarked = (cells == _OCCUPIED) | (cells == _FREE)
    marked_cost = astar(is_unmarked, start, goal).cost
    moves = answer.count("o") + 1
    return shortest_cost == marked_cost == moves


def _without_outer_line_ends(name: str, text: object) -> str:
    """Return a text with line ends between its rows alone, all of them LF.

    Args:
        name: of the text, for the error.
        text: rows of cells.

    Raises:
        FormatError: it is no text.
    """
    if not isinstance(text, str):
        raise FormatError(f"{name}: got {text!r}, expected a text")
    return text.replace("\r\n", "\n").strip("\n")


def _grid_of_cells(text: str) -> Bytes:
    """Return the characters of a map as ASCII codes, (H, W) uint8.

    Raises:
        FormatError: lines of several lengths; without lines, not as many characters as a square.
    """
    lines = text.split("\n")
    if len(lines) > 1:
        if len(set(map(len, lines))) != 1:
            raise FormatError("got lines of several lengths, expected one length")
        codes = np.frombuffer("".join(lines).encode("latin-1"), np.uint8)
        return codes.reshape(len(lines), -1)
    side = math.isqrt(len(text))
    if side * side != len(text):
        raise FormatError(f"got {len(text)} cells, expected a square map")
    return np.frombuffer(text.encode("latin-1"), np.uint8).reshape(side, side)


def _start_and_goal(cells: Bytes) -> Ints:
    """Return the start and the goal, (2, 2)."""
    return np.concatenate([np.argwhere(cells == _START), np.argwhere(cells == _GOAL)])


FORMAT = Format("maze-hard", (".csv",), read, recognises=is_maze_hard)
