"""Scores for answers of models to mazes as text: marked mazes, moves, letters or "infeasible".

The scale is that of the environments of reasoning-gym (https://arxiv.org/abs/2505.24760): 1 for any
shortest path, 0.5 for a longer one, 0 for everything else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from operator import index
from typing import Any

import numpy as np

from mapdata.arrays import Array, Flags, Ints
from mapdata.checks import plain_values
from mapdata.formats.maze_answer_text import (
    CELLS_FORM,
    MAZE_FORM,
    MOVES_FORM,
    TWO_ANSWERS,
    NoAnswerError,
    Reading,
    letter_of_move,
    read_text,
)
from mapdata.formats.maze_questions import INFEASIBLE, MOVES, Question, parse_question, type_name
from mapdata.limits import Size
from mapdata.npy import FormatError
from mapdata.search.api import astar

_STEP_OF_LETTER = {letter_of_move(word): step for word, step in MOVES.items()}
"""The letters of an answer, and the change of (row, col) that each means."""

_OCCUPIED, _FREE = np.frombuffer(b"# ", np.uint8)
"""The ASCII codes of the cells that no path marks."""


@dataclass(frozen=True)
class AnswerCheck:
    """How good an answer to a maze is.

    Attributes:
        score: 1 for a shortest path, or for "infeasible" where there is no path; 0.5 for a longer
            path; 0 otherwise.
        reason: a sentence that says why.
        moves: the letters U, D, L and R of the path that the answer gives, "" if it gives none.
    """

    score: float
    reason: str
    moves: str


def score_answer(
    question: str, answer: str | Sequence[Any] | Array, size: Size | None = None
) -> float:
    """Return the score of an answer, 1, 0.5 or 0, as `check_answer` gives it.

    >>> score_answer("S  # #  G", "right down"), score_answer("S   #   G", "right right down down")
    (0.0, 1.0)
    """
    return check_answer(question, answer, size).score


def is_shortest_answer(
    question: str, answer: str | Sequence[Any] | Array, size: Size | None = None
) -> bool:
    """Return whether the score of an answer is 1, as `check_answer` gives it.

    Many problems have several shortest paths, and each is a right answer.

    >>> answers = ("Soo #o  G", "S  o# ooG", "down down right right", "RDRD", "S   #   G")
    >>> [is_shortest_answer("S   #   G", answer) for answer in answers]
    [True, True, True, False, False]
    """
    return check_answer(question, answer, size).score == 1


def check_answer(
    question: str, answer: str | Sequence[Any] | Array, size: Size | None = None
) -> AnswerCheck:
    r"""Return how good an answer to a maze is, and why.

    A text gives its answer in one of these forms:

    - a marked maze: the rows of the question with some free cells marked by "o", as lines or one
      after another. Spaces at both ends, and at the end of each row, may be missing;
    - letters: U, D, L and R, or four arrows, in one run, such as "RRD";
    - moves one by one: the words up, down, left and right, or letters, all separated in the same
      way: by spaces, commas, arrows or line ends, or as a list of JSON, Python or Markdown;
    - cells (row, col), counted from 0, from S to G, such as "(0, 0) -> (0, 1)";
    - "infeasible", which is right if no path leads from S to G.

    The answer ends the text and fills its last line or block. It may stand behind a label such as
    "Answer:" or "The path is", in ``<answer>``, in a fence, in `\boxed{}` and between marks of
    Markdown or LaTeX. The page on mazes as text (docs/howto/text.md) lists all labels and marks.
    Nothing is read inside a sentence of other words. An answer scores 0 if other words follow it,
    if the text has another answer, or if the line before it may deny it; the reason says which.
    Copies of the question are dropped; only where S and G are neighbours a copy is the right marked
    maze.

    The marked cells of a longer path must form a line without branches: each has two neighbours
    that are marked, S or G.

    Args:
        question: the cells of a map, row by row, "#" occupied and " " free, with one S and one G.
            Rows are lines, as in `mapdata.datasets.maze_text`, or follow one another in one line.
            Line ends before and after are ignored, and CRLF is read as one line end.
        answer: what a model returned; or what your own code found in it: a list or array of moves
            (words or letters, one each) or of cells (k, 2), from S to G. A list that holds anything
            else scores 0.
        size: (rows, columns) of the map. None takes the lines of the question, and reads one line
            as a square map; so a map of one row needs its size.

    Raises:
        FormatError: the question is no map with one S and one G, or not of this size, or the answer
            is neither text nor a list nor an array.
        ValueError: ``size`` is no size of a map.

    Source of the scale: reasoning-gym, https://arxiv.org/abs/2505.24760.

    >>> check_answer("S   #   G", "Down, then right:\n```\nDDRR\n```")
    AnswerCheck(score=1.0, reason='a shortest path', moves='DDRR')
    >>> check_answer("S   #   G", "down right").reason
    'move 2 leads into a wall'
    >>> check_answer("S   #   G", [(0, 0), (0, 1), (0, 2), (1, 2), (2, 2)]).moves
    'RRDD'
    """
    maze = parse_question(question, size)
    try:
        readings = read_text(answer, maze) if isinstance(answer, str) else [_read_list(answer)]
    except NoAnswerError as refusal:
        return AnswerCheck(0.0, str(refusal), "")
    min_move_count = len(astar(maze.is_occupied, maze.start, maze.goal).path) - 1
    checks = {_check_reading(reading, maze, min_move_count) for reading in readings}
    if len(checks) > 1:
        return AnswerCheck(0.0, TWO_ANSWERS, "")
    return checks.pop()


def _check_reading(reading: Reading, maze: Question, min_move_count: int) -> AnswerCheck:
    """Return how good one answer is.

    Args:
        reading: the answer.
        maze: the question.
        min_move_count: of a shortest path; -1 if there is no path.
    """
    if reading.form == INFEASIBLE:
        if min_move_count < 0:
            return AnswerCheck(1.0, "there is no path", "")
        return AnswerCheck(0.0, "there is a path", "")
    moves = ""
    try:
        moves = _moves_of(reading, maze)
        _check_moves(moves, maze)
    except NoAnswerError as fault:
        return AnswerCheck(0.0, str(fault), moves)
    if len(moves) == min_move_count:
        return AnswerCheck(1.0, "a shortest path", moves)
    return AnswerCheck(
        0.5, f"a path of {len(moves)} moves where {min_move_count} are enough", moves
    )


# --- the path of an answer ----------------------------------------------------------------------


def _read_list(answer: object) -> Reading:
    """Return what a list of moves or of cells says.

    Raises:
        FormatError: it is no list, tuple, array or tensor.
        NoAnswerError: it holds anything else. A model may have written it, so this is no error.
    """
    values = plain_values(_without_arrays(answer))
    if not isinstance(values, list):
        raise FormatError(
            f"answer: got {type_name(answer)}, expected a text, or a list or array of moves or of "
            "cells"
        )
    if not values:
        raise NoAnswerError('no answer: an empty list; where there is no path, "infeasible"')
    if all(isinstance(value, str) for value in values):
        letters = [letter_of_move(value) for value in values]
        if not all(letters):
            number = letters.index("")
            raise NoAnswerError(
                f"no answer: move {number + 1} is {values[number][:20]!r}, expected one of "
                f"{', '.join(MOVES)} or their first letters"
            )
        return Reading(MOVES_FORM, moves="".join(letters))
    return Reading(CELLS_FORM, cells=tuple(_as_cell(_without_arrays(value)) for value in values))


def _without_arrays(value: object) -> object:
    """Return an array or tensor as a list, and anything else as it is."""
    return value.tolist() if hasattr(value, "tolist") else value


def _as_cell(value: object) -> tuple[int, int]:
    """Return a cell of a list.

    Raises:
        NoAnswerError: it is no pair of two integers.
    """
    try:
        if isinstance(value, list) and not any(isinstance(side, bool) for side in value):
            row, column = map(index, value)
            return row, column
    except (TypeError, ValueError):
        pass
    raise NoAnswerError("no answer: a list of other things than moves or cells (row, col)")


def _moves_of(reading: Reading, maze: Question) -> str:
    """Return the letters of the moves of an answer.

    Raises:
        NoAnswerError: its cells or marks are no path from S.
    """
    if reading.fault:
        raise NoAnswerError(f"no answer: {reading.fault}")
    if reading.form == MAZE_FORM:
        # At most one place of the marks gives a path: below the first row, the cells that lack a
        # neighbour are where its marks must begin and end.
        for cells in reading.mazes:
            path = _marked_path(cells, maze)
            if path is not None:
                return letters_of_path(path)
        if "o" not in reading.mazes[0]:
            raise NoAnswerError("a copy of the question")
        raise NoAnswerError("the marked cells are no path from S to G")
    if reading.form == CELLS_FORM:
        if reading.cells[0] != maze.start:
            raise NoAnswerError(f"the first cell is {reading.cells[0]}, S is {maze.start}")
        letters = {step: letter for letter, step in _STEP_OF_LETTER.items()}
        steps = (
            (row - row_before, column - column_before)
            for (row_before, column_before), (row, column) in pairwise(reading.cells)
        )
        moves = "".join(letters.get(step, "?") for step in steps)
        if "?" in moves:
            number = moves.index("?") + 1
            raise NoAnswerError(
                f"cell {reading.cells[number]} is no neighbour of {reading.cells[number - 1]}"
            )
        return moves
    return reading.moves


def _check_moves(moves: str, maze: Question) -> None:
    """Refuse moves that do not lead to the goal.

    Raises:
        NoAnswerError: they leave the map, lead into a wall or end elsewhere.
    """
    rows, columns = maze.cells.shape
    row, column = maze.start
    for number, letter in enumerate(moves, 1):
        down, right = _STEP_OF_LETTER[letter]
        row += down
        column += right
        if not (0 <= row < rows and 0 <= column < columns):
            raise NoAnswerError(f"move {number} leaves the map of {rows} x {columns} cells")
        if maze.cells[row, column] == _OCCUPIED:
            raise NoAnswerError(f"move {number} leads into a wall")
    if (row, column) != maze.goal:
        raise NoAnswerError(f"the moves end at {(row, column)}, the goal is {maze.goal}")


def _marked_path(cells: str, maze: Question) -> Ints | None:
    """Return the path (k, 2) that marked cells give, None if they are no path from S to G.

    A path uses all marked cells. A shortest one is found by a search on these cells alone. In a
    longer one each cell has two neighbours, and S and G have one.

    Args:
        cells: those of the question, row by row, with marks.
        maze: the question.
    """
    marks = np.frombuffer(cells.encode("ascii"), np.uint8).reshape(maze.cells.shape)
    is_unmarked: Flags = (marks == _OCCUPIED) | (marks == _FREE)
    path = astar(is_unmarked, maze.start, maze.goal).path
    # A shortest path through the marked cells has no shortcut. So if it uses all of them, each has
    # two neighbours on it and no other one.
    return path if len(path) == cells.count("o") + 2 else None


def letters_of_path(path: Ints) -> str:
    """Return the letters of the moves of a 4-connected path (k, 2)."""
    letters = {step: letter for letter, step in _STEP_OF_LETTER.items()}
    return "".join(letters[row, column] for row, column in np.diff(path, axis=0).tolist())


def words_of_letters(letters: str) -> str:
    """Return the words that letters stand for, with a space between."""
    words = {word[0].upper(): word for word in MOVES}
    return " ".join(words[letter] for letter in letters)
