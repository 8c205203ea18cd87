"""The answer in the text of a language model: where it stands, and in which form.

docs/howto/text.md ("Which texts are read") lists the forms, the labels, and what is refused. A text
that this module does not understand is no answer: it looks for no moves inside sentences, since a
sentence may say that they are wrong.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from mapdata.formats.maze_questions import INFEASIBLE, MOVES, Question

MOVES_FORM, CELLS_FORM, MAZE_FORM = "moves", "cells", "marked maze"

_LETTERS = {word: word[0].upper() for word in MOVES} | {word[0]: word[0].upper() for word in MOVES}
"""The letter of each word and of each lower-case letter."""


TWO_ANSWERS = "two answers"
"""Why several answers score 0."""


class NoAnswerError(Exception):
    """A text or a list holds no answer; the message says why."""


class Reading(NamedTuple):
    """What an answer says.

    Attributes:
        form: "moves", "cells", "marked maze" or "infeasible".
        moves: the letters U, D, L and R; "" in other forms.
        cells: (row, col) each; empty in other forms.
        mazes: the cells of the question with marks, row by row. There is one, unless spaces at
            the beginning of the first row are missing and its marks fit in several places.
        fault: why it can't be read although it has this form, "" if it can.
    """

    form: str
    moves: str = ""
    cells: tuple[tuple[int, int], ...] = ()
    mazes: tuple[str, ...] = ()
    fault: str = ""


def letter_of_move(move: str) -> str:
    """Return the letter of "up", "U", "u" and so on; "" for anything else."""
    return _LETTERS.get(move.strip().lower(), "")


# --- what surrounds an answer -------------------------------------------------------------------

_IGNORE_CASE = re.IGNORECASE | re.ASCII
"""Without `re.ASCII` a dotless i would be an i, too."""

_SAME_CHARACTERS = str.maketrans(
    "：，；。！？“”‘’\u00a0–—−⟶⇒➔➜➙➝",  # noqa: RUF001 (these characters are what is replaced)
    ":,;.!?\"\"'' ---→→→→→→",
    "\ufe0e\ufe0f\u200b\ufeff✅",
)
"""Wide and curly punctuation, other dashes and arrows, and characters that say nothing."""

_LATEX_ARROW = re.compile(r"\\(?:to|(?:long)?rightarrow)\b", _IGNORE_CASE)
_LATEX_FONT = re.compile(r"\\(?:text|texttt|textbf|mathrm|mathtt|mathbf)\{([^{}]*)\}")
_LATEX_BOX = re.compile(r"\\boxed\{(.*)\}")

_END_OF_THINKING = re.compile(r"</think(?:ing)?>", _IGNORE_CASE)
_START_OF_THINKING = re.compile(r"<think(?:ing)?>", _IGNORE_CASE)

_LAST_TOKENS = re.compile(
    r"</s>|<eos>|<\|(?:im_end|endoftext|eot_id|end_of_text|end|return)\|>|<end_of_turn>",
    _IGNORE_CASE,
)
"""The tokens with which models end a text."""

_ANSWER_TAG = re.compile(r"</?answer>", _IGNORE_CASE)

_LABEL_TEXT = (
    r"(?:(?:so|thus|therefore|hence|finally),?[ ]+)?"
    r"(?:(?:the|my|a|one)[ ]+)?"
    r"(?:(?:final|shortest|optimal|full|complete|correct)[ ]+){0,2}"
    r"(?:answer|solution|path|route|moves|directions|steps|actions|sequence|sequence[ ]of[ ]moves)"
    r"(?:[ ]from[ ]S[ ]to[ ]G)?"
)
"""What a label says. All its words are listed, so that none of them can be a "not"."""

_LABEL = re.compile(
    rf"(?:#+[ ]+)?(?P<open>[*_\"'`]{{0,3}}){_LABEL_TEXT}(?P<closed>[*_\"'`]{{0,3}})[ ]*"
    r"(?:(?:[ ](?:is|are)\b)?[ ]*(?P<colon>[:=])|[ ](?:is|are)\b)(?P<closed_late>[*_]{0,3})[ ]*",
    _IGNORE_CASE,
)
"""A label before an answer in its line: "**Answer:** ", "So the path is "."""

_LABEL_LINE = re.compile(
    rf"(?:[#>]+[ ]+)?[*_\"'`]{{0,3}}{_LABEL_TEXT}[*_\"'`]{{0,3}}"
    r"[ ]*(?:is|are)?[ ]*[:=]?[*_]{0,3}",
    _IGNORE_CASE,
)
"""A label alone in its line, which may be a heading: "### Answer"."""

_SENTENCE_BEFORE_LABEL = re.compile(rf"(?<=[.!?])[ ]+(?={_LABEL.pattern})", _IGNORE_CASE)

_BREAK = re.compile(r"(?:`{3,}\w*|~{3,}\w*|\\\[|\\\]|\$\$|</answer>|-{3,}|[\[\]{}(),\s]+)")
"""A line that belongs to no answer: a fence, brackets of a formula or of JSON, a rule."""

_MARKER = re.compile(
    r"(?P<bullet>[-*+•][ ]+)?"
    r"(?:(?P<open>\*\*)?(?:(?:step|move)[ ]*)?(?P<number>\d{1,5})[ ]*[.):](?P<closed>\*\*)?)?[ ]*",
    _IGNORE_CASE,
)
"""What stands before an item of a list: "- ", "1. ", "**Step 1:** "."""

_PAIRS = (
    ("```", "```"),
    ("**", "**"),
    ("__", "__"),
    ("$$", "$$"),
    (r"\(", r"\)"),
    (r"\[", r"\]"),
    *((mark, mark) for mark in "*_`$\"'"),
    ("(", ")"),
    ("[", "]"),
    ("{", "}"),
)
"""Marks around an answer: code, bold and slanted text, formulas, quotations, lists."""

_MAX_MARKS = 10
"""How many marks may stand around one another; a text may consist of them."""

_NEGATION = re.compile(
    r"\b(?:not|no|never|none|neither|nor|cannot|\w+n't|"
    r"(?:is|are|was|were|do|does|did|ca|wo)nt|wrong|incorrect|false|invalid|illegal|"
    r"bad|impossible|unable|blocked|fails?|failed|tried|attempt|avoid|ignore|reject|discard|"
    r"or|either|otherwise|else|unless|if|except|instead|another|other|alternatives?|alternatively|"
    r"options?|candidates?|choices?|examples?)\b",
    _IGNORE_CASE,
)
"""Words before an answer by which it may be no answer, or one of several."""

_DOUBT = re.compile(
    r"\b(?:unsure|uncertain|unclear|guess|guessing|doubt|maybe|perhaps|probably|possibly|might|may|"
    r"could|seems?|likely|hope|assuming|no idea|I (?:think|believe|suppose|assume))\b|"
    r"(?:\bnot|n't|\bnever)\b[^.!?]{0,30}\b(?:sure|certain|confident|know)\b|"
    r"\b(?:following|below|next (?:line|answer|path|one))\b[^.!?]{0,60}"
    r"(?:\b(?:not|no|wrong|incorrect|false|invalid)|n't)\b",
    _IGNORE_CASE,
)
"""Words before an answer by which it is a guess, or wrong, even if it has a label."""


# --- forms --------------------------------------------------------------------------------------

_MAZE_CHARACTERS = frozenset("# SGo")
"""The cells of a question and its marks."""

_ARROW_LETTERS = str.maketrans("↑⬆🔼↓⬇🔽←⬅◀→➡▶", "UUUDDDLLLRRR")
_ARROWS = re.compile(r"[↑⬆🔼↓⬇🔽←⬅◀→➡▶][↑⬆🔼↓⬇🔽←⬅◀→➡▶\s,]*")
_RUN = re.compile(r"[UDLR]+|[udlr]{2,}")
_RUNS = re.compile(r"[UDLR]+(?:[\s,;]+[UDLR]+)+")
_SEPARATOR = r"(?:\s*(?:,|;|→|➡|▶|->|=>|>|-)\s*|\s+)"
_MOVE = r"(?:(?:move|go)[ ]+)?(?P<q{0}>\*\*|[*_`\"']?)(?:up|down|left|right|[udlr])(?P=q{0})"
_CELL = r"(?:\(\s*\d{1,4}\s*,\s*\d{1,4}\s*\)|\[\s*\d{1,4}\s*,\s*\d{1,4}\s*\])"
_ITEMS = {
    MOVES_FORM: re.compile(_MOVE.format(""), _IGNORE_CASE),
    CELLS_FORM: re.compile(_CELL),
}
_SEQUENCES = {
    MOVES_FORM: re.compile(
        rf"{_MOVE.format('1')}(?:{_SEPARATOR}{_MOVE.format('2')})*", _IGNORE_CASE
    ),
    CELLS_FORM: re.compile(rf"{_CELL}(?:{_SEPARATOR}{_CELL})*"),
}
"""Items one by one, and what separates them."""

_REFUSED = (
    ("a table", re.compile(r"\s*\|")),
    ("text that is crossed out", re.compile(r".*~~")),
    ("a question", re.compile(r".*\?[\s*_`\"')]*$")),
    ("signs for arrows", re.compile(r"[\s<>v^,]+$")),
    ("letters in several groups", re.compile(r"(?:\W*\b[UDLR]{2,}\b){2,}\W*$")),
    ("numbers", re.compile(r"[\s\d,\[\]]+$")),
    ("an object of JSON with other keys than one label", re.compile(r"\s*\{.*:")),
    ("rows that are not those of the question", re.compile(r"[# SGo]+$")),
    (
        "several answers",
        re.compile(r".*\b(?:[UDLR]+|up|down|left|right)[\"'`*]*\s*(?:or|/|\|)", _IGNORE_CASE),
    ),
    (
        'other words than "infeasible"',
        re.compile(r".*\b(?:no (?:\w+ )?path|unsolvable|unreachable|impossible)\b", _IGNORE_CASE),
    ),
    (
        "points of the compass",
        re.compile(r".*\b(?:north|south|east|west)\b|[\s,]*[NSEW]([\s,]*[NSEW])+$", _IGNORE_CASE),
    ),
    (
        "a count beside moves",
        re.compile(
            r".*(?:\b(?:up|down|left|right|[UDLR])\b[ ]*(?:[x×*(][ ]*)*\d|"  # noqa: RUF001
            r"\d[ ]*[x×]?[ ]*(?:up|down|left|right|[UDLR])\b|\(\d+ (?:moves|steps)\))",  # noqa: RUF001
            _IGNORE_CASE,
        ),
    ),
    ("a box inside a sentence", re.compile(r".*\\boxed")),
    (
        "moves inside a sentence of other words",
        re.compile(r".*\b(?:[UDLR]{2,}|(?i:up|down|left|right))\b"),
    ),
)
"""Forms that are refused, and what tells them; docs/howto/text.md lists them."""


class _Line(NamedTuple):
    """A line of an answer.

    Attributes:
        form: one of `Reading`.
        items: letters or cells.
        separators: what stands between its items.
        marker: of a list, before its item: a number, "" for a bullet, None without one.
        ends_with_comma: whether the line does.
        is_labelled: whether a label, or a box of LaTeX, says that this is the answer.
        mazes: see `Reading`.
        fault: see `Reading`.
    """

    form: str
    items: tuple[str, ...] = ()
    separators: frozenset[str] = frozenset()
    marker: int | str | None = None
    ends_with_comma: bool = False
    is_labelled: bool = False
    mazes: tuple[str, ...] = ()
    fault: str = ""


class _Answer(NamedTuple):
    """The lines of an answer.

    Attributes:
        lines: one, or several with a part of its moves or cells each.
        separators: what stands between all items.
        is_labelled: whether a label says that this is the answer.
        words_before: the line of other words before it, "" without one.
    """

    lines: list[_Line]
    separators: set[str]
    is_labelled: bool
    words_before: str

    @property
    def reading(self) -> Reading:
        """What it says."""
        first = self.lines[0]
        fault = first.fault
        if isinstance(first.marker, int) and first.marker > 1:
            fault = f"a list that begins with the number {first.marker}"
        elif len(self.separators) > 1:
            fault = f"{first.form} that are separated in several ways may be several answers"
        items = [item for line in self.lines for item in line.items]
        if fault or not items:
            return Reading(first.form, mazes=first.mazes, fault=fault)
        if first.form == MOVES_FORM:
            return Reading(first.form, moves="".join(items))
        cells = (re.findall(r"\d+", item) for item in items)
        return Reading(first.form, cells=tuple((int(row), int(column)) for row, column in cells))


def read_text(text: str, maze: Question) -> list[Reading]:
    """Return the answers of a text that count.

    The last one ends the text. There is one, unless several have a label: then all of these count,
    since a text may give its path twice, as cells and as moves. A label decides against answers
    without one.

    Args:
        text: what a model returned.
        maze: the question, whose rows an answer may mark.

    Raises:
        NoAnswerError: the text does not end with an answer, it has several without a label, or
            the words before the answer may deny it.
    """
    answers, copies, last_words = _answers_of_lines(_lines_of_text(text), maze)
    if last_words:
        raise NoAnswerError(_refusal(last_words, is_behind_answer=bool(answers)))
    if not answers:
        if copies:
            return [Reading(MAZE_FORM, mazes=copies)]
        raise NoAnswerError("no answer: the text is empty")
    last = answers[-1]
    _check_words_before(last)
    if last.is_labelled:
        answers = [answer for answer in answers if answer.is_labelled]
    elif len(answers) > 1:
        raise NoAnswerError(TWO_ANSWERS)
    return [answer.reading for answer in answers]


# --- lines --------------------------------------------------------------------------------------


def _lines_of_text(text: str) -> list[str]:
    """Return the lines after the thinking of a model; tags have lines of their own."""
    text = text.replace("\r\n", "\n").translate(_SAME_CHARACTERS)
    text = _LATEX_FONT.sub(r"\1", _LATEX_ARROW.sub("→", text))
    *_, text = _END_OF_THINKING.split(text)
    if _START_OF_THINKING.search(text):
        raise NoAnswerError("no answer: the text ends inside <think>")
    text = _LAST_TOKENS.sub("\n", text)
    text = _ANSWER_TAG.sub(lambda tag: f"\n{tag[0].lower()}\n", text)
    return _SENTENCE_BEFORE_LABEL.sub("\n", text).split("\n")


def _answers_of_lines(
    lines: Sequence[str], maze: Question
) -> tuple[list[_Answer], tuple[str, ...], str]:
    """Return all answers, a copy of the question, and the words after the last answer.

    Returns:
        the answers; the cells of the last copy, empty without one; the last line of other words,
        "" if an answer follows it, or a copy that it only introduces.
    """
    answers: list[_Answer] = []
    copies: tuple[str, ...] = ()
    words, label = "", ""
    can_continue, is_after_blank = False, False
    k = 0
    while k < len(lines):
        stripped = lines[k].strip()
        line_count, mazes = _maze_at(lines, k, maze)
        line = _Line(MAZE_FORM, mazes=mazes) if mazes else _read_line(stripped, maze)
        if mazes and "o" not in mazes[0]:
            copies, can_continue = mazes, False
            # Words before it may introduce it, but what takes an answer back stays.
            if not (answers and (label or _DOUBT.search(words) or _NEGATION.search(words))):
                words, label = "", ""
        elif line is not None:
            separator = _separator(answers[-1], line, is_after_blank) if can_continue else ""
            if separator:
                answers[-1].lines.append(line)
                answers[-1].separators.update(line.separators, [separator])
            else:
                is_labelled = line.is_labelled or bool(label)
                answers.append(_Answer([line], set(line.separators), is_labelled, words))
            words, label, can_continue, is_after_blank = "", "", True, False
        elif not stripped:
            is_after_blank = True
        elif _is_label(stripped):
            label, can_continue = stripped, False
        elif _BREAK.fullmatch(stripped):
            can_continue = False
        else:
            words, label, can_continue = stripped, "", False
        k += line_count
    return answers, copies, label or words


def _separator(answer: _Answer, line: _Line, is_after_blank: bool) -> str:
    """Return what separates a line from the answer that it continues, "" if it doesn't.

    It does if the lines before have one item each, or if a comma ends the last of them. Items of a
    list may have blank lines between them.
    """
    before = answer.lines[-1]
    if line.is_labelled or line.form != before.form or not line.items:
        return ""
    if type(line.marker) is not type(before.marker):
        return ""
    if is_after_blank and line.marker is None:
        return ""
    if isinstance(line.marker, int) and line.marker != int(before.marker or 0) + 1:
        return ""
    if before.ends_with_comma:
        return ","
    if not answer.separators <= {"\n", "\n\n"}:
        return ""
    return "\n\n" if is_after_blank else "\n"


def _is_label(line: str) -> bool:
    """Return whether a line is a label alone; a list may begin behind it."""
    return line == "<answer>" or bool(_LABEL_LINE.fullmatch(line.rstrip("[{ ").lstrip("{ ")))


def _read_line(line: str, maze: Question) -> _Line | None:
    """Return what a line says as an answer, without marks and labels; None for other lines."""
    text = line
    ends_with_comma = line.endswith(",")
    marker: int | str | None = None
    is_labelled = False
    for _ in range(_MAX_MARKS):
        text = text.strip(" \t").rstrip(" \t.,;!")
        found = _form_of(text, maze)
        if found is not None:
            return found._replace(
                marker=marker, ends_with_comma=ends_with_comma, is_labelled=is_labelled
            )
        label = _LABEL.match(text)
        item = _MARKER.match(text)
        box = _LATEX_BOX.fullmatch(text)
        if label:
            text = text[label.end() :]
            if not label["colon"] and text.lower() == "right":
                return None  # "The path is right" does not say where it goes.
            if not (label["closed"] or label["closed_late"]):
                text = text.removesuffix(label["open"])
            is_labelled = True
        elif text.startswith("#### "):
            text = text.removeprefix("#### ")
            is_labelled = True
        elif text.startswith("> "):
            text = text.removeprefix("> ")
        elif box:
            text = box[1]
            is_labelled = True
        elif marker is None and item and (item["bullet"] or item["number"]):
            marker = int(item["number"]) if item["number"] else ""
            text = text[item.end() :]
            if item["open"] and not item["closed"]:
                text = text.removesuffix(item["open"])
        else:
            inner = _without_bracket(text) or _without_pair(text)
            if not inner:
                return None
            text = inner
    return None


def _without_bracket(text: str) -> str:
    """Return text without a bracket that is closed, or was opened, in another line; "" if none."""
    for first, last in ("[]", "{}"):
        surplus = text.count(first) - text.count(last)
        if surplus > 0 and text.startswith(first):
            return text[1:]
        if surplus < 0 and text.endswith(last):
            return text[:-1]
    return ""


def _without_pair(text: str) -> str:
    """Return text without a pair of marks around it; "" if there is none."""
    for first, last in _PAIRS:
        is_inside = len(text) > len(first) + len(last)
        if is_inside and text.startswith(first) and text.endswith(last):
            return text[len(first) : -len(last)]
    return ""


def _form_of(text: str, maze: Question) -> _Line | None:
    """Return what text without marks around it says, None if it is in no form of an answer."""
    if text.lower() == INFEASIBLE:
        return _Line(INFEASIBLE)
    marked = _maze_in_one_line(text, maze)
    if marked:
        return _Line(MAZE_FORM, mazes=(marked,))
    if _ARROWS.fullmatch(text):
        text = text.translate(_ARROW_LETTERS)
    if _RUN.fullmatch(text):
        return _Line(MOVES_FORM, tuple(text.upper()), frozenset([""] if len(text) > 1 else []))
    for form, pattern in _SEQUENCES.items():
        if pattern.fullmatch(text):
            return _sequence(form, text)
    if _RUNS.fullmatch(text):
        fault = "letters in several groups may be several answers"
        return _Line(MOVES_FORM, tuple(text), frozenset([""]), fault=fault)
    return None


def _sequence(form: str, text: str) -> _Line:
    """Return items one by one."""
    found = list(_ITEMS[form].finditer(text))
    gaps = (text[one.end() : other.start()] for one, other in pairwise(found))
    items = (one[0] for one in found)
    if form == MOVES_FORM:
        items = (letter_of_move(item.split()[-1].strip("*_`\"'")) for item in items)
    return _Line(form, tuple(items), frozenset(gap.strip() or " " for gap in gaps))


# --- marked mazes -------------------------------------------------------------------------------


def _maze_at(lines: Sequence[str], k: int, maze: Question) -> tuple[int, tuple[str, ...]]:
    """Return the maze that begins in line ``k``, in rows or in one line.

    Spaces at the ends of rows may be missing, and those before the first row, too: chat templates
    and tokenizers strip texts. S tells which row the first line is, and the walls tell where the
    line begins. Without walls its marks may fit in several places.

    Returns:
        how many lines it takes; its cells, row by row, once for each place. Without a maze these
        are 1 and ().
    """
    if not lines[k].strip() or set(lines[k]) - _MAZE_CHARACTERS:
        return 1, ()
    row_count, column_count = maze.cells.shape
    given: list[str] = []
    for line in lines[k : k + row_count]:
        if set(line) - _MAZE_CHARACTERS:
            break
        given.append(line.rstrip())
    line_of_start = next((i for i, line in enumerate(given) if "S" in line), row_count)
    first_row = max(0, maze.start[0] - line_of_start)
    del given[row_count - first_row :]
    rows = [" " * column_count] * row_count
    rows[first_row : first_row + len(given)] = [line.ljust(column_count) for line in given]
    mazes = []
    is_complete = len(lines[k]) >= column_count
    for offset in range(1 if is_complete else column_count - len(given[0]) + 1):
        rows[first_row] = (" " * offset + given[0]).ljust(column_count)
        cells = "".join(rows)
        if _is_marked(cells, maze):
            mazes.append(cells)
    if mazes:
        return len(given), tuple(mazes)
    marked = _maze_in_one_line(lines[k], maze)
    return 1, (marked,) if marked else ()


def _maze_in_one_line(text: str, maze: Question) -> str:
    """Return the cells that a line marks, "" if it is not the question with marks.

    Spaces at both ends may be missing: S tells where the line begins.
    """
    question = maze.text
    offset = question.index("S") - text.find("S")
    cells = (" " * offset + text).ljust(len(question))
    return cells if "S" in text and _is_marked(cells, maze) else ""


def _is_marked(cells: str, maze: Question) -> bool:
    """Return whether cells, row by row, are those of the question with marks or without."""
    return cells.replace("o", " ") == maze.text


# --- reasons ------------------------------------------------------------------------------------


def _check_words_before(answer: _Answer) -> None:
    """Refuse an answer if the sentence before it may deny it.

    Before a label a finished sentence may have a "not", as in "Left is not free.".

    Raises:
        NoAnswerError: it may.
    """
    sentence = re.split(r"(?<=[.!?]) ", answer.words_before)[-1]
    is_finished = sentence.rstrip("*_`\"')").endswith((".", "!", "?"))
    found = _DOUBT.search(sentence)
    if not (found or (answer.is_labelled and is_finished)):
        found = _NEGATION.search(sentence)
    if found:
        raise NoAnswerError(
            f'no answer: the words before it have "{found[0]}": {_excerpt(sentence)}'
        )


def _refusal(words: str, *, is_behind_answer: bool) -> str:
    """Return why a text that ends with these words has no answer."""
    ends = words if len(words) < 400 else f"{words[:200]} {words[-200:]}"
    name = next((name for name, pattern in _REFUSED if pattern.match(ends)), "other words")
    place = "behind an answer the text ends" if is_behind_answer else "the text ends"
    return f"no answer: {place} with {name}: {_excerpt(words)}"


def _excerpt(words: str) -> str:
    """Return the end of words in quotation marks."""
    return f'"{words}"' if len(words) <= 50 else f'"...{words[-47:]}"'
