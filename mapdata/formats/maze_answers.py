"""Scores for answers of models to mazes as text: marked mazes, moves, letters or "infeasible".

The scale is that of the environments of reasoning-gym (https://arxiv.org/abs/2505.24760): 1 for any
shortest path, 0.5 for a longer one, 0 for everything else.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Flags, Ints
from mapdata.npy import FormatError
from mapdata.search.api import astar

MOVES = {"up": (-1, 0), "down": (1, 0), "left": (0, -1), "right": (0, 1)}
"""The words of an answer, and the change of (row, col) that each means."""

INFEASIBLE = "infeasible"
"""The answer to a problem without a path."""

_STEP_OF_LETTER = {word[0].upper(): step for word, step in MOVES.items()}
"""The letters of an answer, and the change of (row, col) that each means."""

_QUESTION = re.compile("[# ]*(S[# ]*G|G[# ]*S)[# ]*")
"""A question has one start and one goal, and otherwise occupied and free cells."""

_LINES = (
    ("fence", re.compile(r" {0,3}(```|~~~).*")),
    ("blank line", re.compile(r"\s*")),
    ("moves", re.compile(r"\s*(up|down|left|right)([\s,]+(up|down|left|right))*[\s,]*", re.I)),
    ("letters", re.compile(r"\s*[UDLR]([\s,]*[UDLR])*[\s,]*")),
    (INFEASIBLE, re.compile(rf"\s*{INFEASIBLE}\s*", re.I)),
)
"""What a line of an answer is, apart from those of a marked maze."""

_LABEL_WORD = re.compile(r"\b(?:answer|solution|path|moves|directions)\b", re.I)
"""What a label has, behind which an answer stands in the same line."""

_ENDS_OF_LABELS = (":", ">", "=", " is ")
"""What ends a label."""

_ENDS_OF_TEXT = ("</s>", "<|im_end|>", "<|endoftext|>", "<|eot_id|>", "</answer>")
"""What may follow an answer in the same line: tags, and the last tokens of models."""

_MARKS_OF_CHAT = " \t*_`.$'\"()[]{}"
"""Marks of bold and slanted text, code, formulas and quotations around an answer."""

_OCCUPIED, _FREE, _START, _GOAL, _MARK = np.frombuffer(b"# SGo", np.uint8)
"""The ASCII codes of the cells."""


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


class _Part(NamedTuple):
    """Lines of an answer that belong together.

    Attributes:
        name: of its form, one of the constants below.
        text: its lines, joined by spaces; of a marked maze all its rows, one after another.
    """

    name: str
    text: str


_MAZE, _WORDS, _LETTERS_ONLY = "marked maze", "moves", "letters"
_COPY, _FENCE, _BLANK, _OTHER = "copy", "fence", "blank line", "other text"

_ANSWERS = (_MAZE, _WORDS, _LETTERS_ONLY, INFEASIBLE)
"""The forms of an answer."""


def score_answer(question: str, answer: str) -> float:
    """Return the score of an answer, 1, 0.5 or 0, as `check_answer` gives it.

    >>> score_answer("S  # #  G", "right down"), score_answer("S   #   G", "right right down down")
    (0.0, 1.0)
    """
    return check_answer(question, answer).score


def is_shortest_answer(question: str, answer: str) -> bool:
    """Return whether the score of an answer is 1, as `check_answer` gives it.

    Many problems have several shortest paths, and each is a right answer.

    >>> answers = ("Soo #o  G", "S  o# ooG", "down down right right", "RDRD", "S   #   G")
    >>> [is_shortest_answer("S   #   G", answer) for answer in answers]
    [True, True, True, False, False]
    """
    return check_answer(question, answer).score == 1


def check_answer(question: str, answer: str) -> AnswerCheck:
    r"""Return how good an answer to a maze is, and why.

    An answer has one of four forms:

    - a marked maze: the rows of the question with some free cells marked by "o". Spaces at the end
      of a row may be missing;
    - moves: the words up, down, left and right in lower or upper case, separated by spaces, commas
      or line ends;
    - letters: the letters U, D, L and R, with or without spaces or commas between them;
    - "infeasible", which is right if no path leads from S to G.

    Other text may stand around the answer, in lines of its own, which are ignored. Moves, letters
    and "infeasible" may also stand in one line behind a label, which is any text that has one of
    the words answer, solution, path, moves or directions and ends with a colon, "=" or "is", or
    ``<answer>``; between marks of bold text, code or quotations, or in a box of LaTeX; and before
    the last token of a model: "Answer: RRD" and `</s>`.

    First, each copy of the question is dropped; only where S and G are neighbours it is the right
    marked maze. If there are fenced blocks (lines of three backticks), the last one that is not
    empty is read, and otherwise the last consecutive lines of one of these forms. Two
    answers there score 0.

    The marked cells of a longer path must form a line without branches: each has two neighbours
    that are marked, S or G.

    Args:
        question: the cells of a map, row by row, "#" occupied and " " free, with one S and one G.
            Rows are lines, as in `mapdata.datasets.maze_text`, or follow one another in a square
            map. Line ends before and after are ignored, and CRLF is read as one line end.
        answer: what a model returned.

    Raises:
        FormatError: the question is no map with one S and one G, or the answer is no text.

    Source of the scale: reasoning-gym, https://arxiv.org/abs/2505.24760.

    >>> check_answer("S   #   G", "Down, then right:\n```\nDDRR\n```")
    AnswerCheck(score=1.0, reason='a shortest path', moves='DDRR')
    >>> check_answer("S   #   G", "down right").reason
    'move 2 leads into a wall'
    """
    parsed = parse_question(question)
    if not isinstance(answer, str):
        raise FormatError(f"answer: got {_type_name(answer)}, expected a text")
    parts = _parts_of_answer(answer.replace("\r\n", "\n").split("\n"), parsed)
    answers = _answers_that_count(parts)
    if not answers:
        if not any(part.name == _COPY for part in parts):
            return AnswerCheck(0.0, "no answer", "")
        shortest = astar(parsed.is_occupied, parsed.start, parsed.goal).path
        if len(shortest) == 2:  # No cell lies between: the marked maze is the question itself.
            return AnswerCheck(1.0, "a shortest path", letters_of_path(shortest))
        return AnswerCheck(0.0, "a copy of the question", "")
    if len(answers) > 1:
        return AnswerCheck(0.0, "two answers", "")
    (given,) = answers
    shortest_path = astar(parsed.is_occupied, parsed.start, parsed.goal).path
    if given.name == INFEASIBLE:
        if len(shortest_path):
            return AnswerCheck(0.0, "there is a path", "")
        return AnswerCheck(1.0, "there is no path", "")
    if given.name == _MAZE:
        path = _marked_path(given.text, parsed)
        if path is None:
            return AnswerCheck(0.0, "the marked cells are no path from S to G", "")
        moves = letters_of_path(path)
    else:
        words = re.findall("[a-zA-Z]+" if given.name == _WORDS else "[UDLR]", given.text)
        moves = "".join(word[0].upper() for word in words)
        fault = _fault_of_moves(moves, parsed)
        if fault:
            return AnswerCheck(0.0, fault, moves)
    shortest_count = len(shortest_path) - 1
    if len(moves) == shortest_count:
        return AnswerCheck(1.0, "a shortest path", moves)
    return AnswerCheck(
        0.5, f"a path of {len(moves)} moves where {shortest_count} are enough", moves
    )


# --- the question -------------------------------------------------------------------------------


def parse_question(question: object) -> Question:
    """Return the maze of a question.

    Raises:
        FormatError: the question is no map with one S and one G.
    """
    if not isinstance(question, str):
        raise FormatError(
            f"question: got {_type_name(question)}, expected a text: the prompt of "
            "mapdata.datasets.maze_text, or of an export; tokens of HRM and TRM are no text"
        )
    question = question.replace("\r\n", "\n").strip("\n")
    if not _QUESTION.fullmatch(question.replace("\n", "")):
        raise FormatError(
            "question: expected the maze alone, without instructions around it: cells '#' and ' ', "
            "one S and one G"
        )
    cells = _grid_of_cells(question)
    ((start_row, start_column),) = np.argwhere(cells == _START).tolist()
    ((goal_row, goal_column),) = np.argwhere(cells == _GOAL).tolist()
    return Question(cells, (start_row, start_column), (goal_row, goal_column))


def _type_name(value: object) -> str:
    """Return what a value is, for errors: its repr may be large."""
    return f"a value of type {type(value).__name__}"


def _grid_of_cells(text: str) -> Bytes:
    """Return the characters of a map as ASCII codes, (H, W) uint8.

    Args:
        text: the rows as lines; or, without line ends, one after another in a square map.

    Raises:
        FormatError: lines of several lengths; without lines, not as many characters as a square.
    """
    lines = text.split("\n")
    if len(lines) > 1:
        if len(set(map(len, lines))) != 1:
            raise FormatError("question: got lines of several lengths, expected one length")
        codes = np.frombuffer("".join(lines).encode("latin-1"), np.uint8)
        return codes.reshape(len(lines), -1)
    side = math.isqrt(len(text))
    if side * side != len(text):
        raise FormatError(
            f"question: got {len(text)} cells in one line, expected a square map, or its rows as "
            "lines"
        )
    return np.frombuffer(text.encode("latin-1"), np.uint8).reshape(side, side)


# --- the place of the answer --------------------------------------------------------------------


def _parts_of_answer(lines: Sequence[str], maze: Question) -> list[_Part]:
    """Return the parts of an answer: marked mazes, and otherwise its lines."""
    parts = []
    k = 0
    while k < len(lines):
        line_count = len(maze.cells)
        rows = _marked_rows(lines[k : k + line_count], maze)
        if not rows and _is_marked(lines[k], maze):
            line_count = 1
            rows = lines[k]
        if rows:
            parts.append(_Part(_MAZE if "o" in rows else _COPY, rows))
            k += line_count
            continue
        label, line = "", lines[k]
        name = _name_of_line(line)
        if name == _OTHER:
            label, inner_line = _without_label(line)
            if _name_of_line(inner_line) in _ANSWERS:
                name, line = _name_of_line(inner_line), inner_line
        if label and name in _ANSWERS:
            parts.append(_Part(_OTHER, label))  # it separates this answer from those before it
        if parts and parts[-1].name == name and name in (_WORDS, _LETTERS_ONLY):
            parts[-1] = _Part(name, f"{parts[-1].text} {line}")
        else:
            parts.append(_Part(name, line))
        k += 1
    return parts


def _name_of_line(line: str) -> str:
    """Return which part of an answer a line is, apart from a marked maze."""
    names = (name for name, pattern in _LINES if pattern.fullmatch(line))
    return next(names, _OTHER)


def _without_label(line: str) -> tuple[str, str]:
    """Return the label of a line, "" without one, and its answer without marks around it.

    >>> _without_label("**Answer:** RRD"), _without_label("<answer>down</answer>")
    (('**Answer:', 'RRD'), ('<answer>', 'down'))
    """
    text = line.strip()
    for end in _ENDS_OF_TEXT:
        text = text.removesuffix(end).rstrip()
    ends = [text.rfind(end) + len(end) for end in _ENDS_OF_LABELS if end in text]
    label = text[: max(ends, default=0)]
    if not _LABEL_WORD.search(label):
        label = ""
    answer = text[len(label) :].strip(_MARKS_OF_CHAT)
    return label, answer.removeprefix("\\boxed").strip(_MARKS_OF_CHAT)


def _marked_rows(lines: Sequence[str], maze: Question) -> str:
    """Return lines as the rows of a question, one after another; "" if they are no such rows.

    Args:
        lines: as many as the question has rows; spaces at their ends may be missing.
        maze: the question, whose free cells may be marked.
    """
    rows, columns = maze.cells.shape
    text = "".join(line.rstrip().ljust(columns) for line in lines)
    return text if len(lines) == rows and _is_marked(text, maze) else ""


def _is_marked(rows: str, maze: Question) -> bool:
    """Return whether rows, one after another, are those of a question with marks or without."""
    return rows.replace("o", " ") == maze.cells.tobytes().decode("ascii")


def _answers_that_count(parts: Sequence[_Part]) -> list[_Part]:
    """Return the answers of the last fenced block, or else the last ones without text between.

    Several answers mean that the text does not decide for one.
    """
    blocks: list[list[_Part]] = []
    groups: list[list[_Part]] = [[]]
    is_fenced = False
    for part in parts:
        if part.name == _FENCE:
            is_fenced = not is_fenced
            if is_fenced:
                blocks.append([])
        elif is_fenced:
            blocks[-1].append(part)
        elif part.name in _ANSWERS:
            groups[-1].append(part)
        elif part.name != _BLANK:
            groups.append([])
    blocks = [block for block in blocks if any(part.name not in (_BLANK, _COPY) for part in block)]
    if blocks:
        return [part for part in blocks[-1] if part.name in _ANSWERS]
    groups = [group for group in groups if group]
    return groups[-1] if groups else []


# --- the path of an answer ----------------------------------------------------------------------


def _marked_path(rows: str, maze: Question) -> Ints | None:
    """Return the path (k, 2) that marked cells give, None if they are no path from S to G.

    A path uses all marked cells. A shortest one is found by a search on these cells alone. In a
    longer one each cell has two neighbours, and S and G have one.

    Args:
        rows: those of the question, one after another, with marks.
        maze: the question.
    """
    marks = np.frombuffer(rows.encode("ascii"), np.uint8).reshape(maze.cells.shape)
    is_unmarked: Flags = (marks == _OCCUPIED) | (marks == _FREE)
    path = astar(is_unmarked, maze.start, maze.goal).path
    # A shortest path through the marked cells has no shortcut. So if it uses all of them, each has
    # two neighbours on it and no other one.
    return path if len(path) == rows.count("o") + 2 else None


def letters_of_path(path: Ints) -> str:
    """Return the letters of the moves of a 4-connected path (k, 2)."""
    letters = {step: letter for letter, step in _STEP_OF_LETTER.items()}
    return "".join(letters[row, column] for row, column in np.diff(path, axis=0).tolist())


def words_of_letters(letters: str) -> str:
    """Return the words that letters stand for, with a space between."""
    words = {word[0].upper(): word for word in MOVES}
    return " ".join(words[letter] for letter in letters)


def _fault_of_moves(moves: str, maze: Question) -> str:
    """Return what is wrong with moves from the start; "" if they lead to the goal."""
    rows, columns = maze.cells.shape
    row, column = maze.start
    for number, letter in enumerate(moves, 1):
        down, right = _STEP_OF_LETTER[letter]
        row += down
        column += right
        if not (0 <= row < rows and 0 <= column < columns):
            return f"move {number} leaves the map"
        if maze.is_occupied[row, column]:
            return f"move {number} leads into a wall"
    if (row, column) != maze.goal:
        return f"the moves end at {(row, column)}, the goal is {maze.goal}"
    return ""
