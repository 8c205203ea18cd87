"""Answers in texts of language models: all that the page lists, and texts of a grammar."""

from __future__ import annotations

import re

import pytest
from helpers.answer_texts import DENIED, DOUBLE, HEDGED, TAKEN_BACK, draw_examples
from helpers.pages import DOCS
from helpers.wild import SETTINGS
from hypothesis import given
from hypothesis import strategies as st

from mapdata.formats import check_answer

MAZE = "S  \n #G\n   "
"""The maze of the page: the shortest path is RRD."""

PAGE = (DOCS / "howto" / "text.md").read_text(encoding="utf-8")


def _rows(heading: str) -> list[list[str]]:
    """Return the rows of the table of the page whose heading begins with this text."""
    lines = PAGE[PAGE.index(f"| {heading}") :].split("\n\n", 1)[0].splitlines()[2:]
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]


def _texts(cell: str) -> list[str]:
    """Return the texts in a cell of a table; `<br>` stands for a line end."""
    found = re.findall(r"(`+)(.+?)\1(?!`)", cell.replace("`<br>`", "\n"), re.DOTALL)
    # A text with backticks stands between several, with a space on each side.
    return [text[1:-1] if len(ticks) > 1 else text for ticks, text in found]


ACCEPTED = [
    text
    for row in (*_rows("Form |"), *_rows("Around an answer |"))
    for text in _texts(row[1])
    if text != "infeasible"
]

REFUSED = [(_texts(row[1])[0], row[2]) for row in _rows("What is refused |")]
REFUSED += [("| 1 | right |\n| 2 | down |", "a table"), ("Antwort: RRD", "inside a sentence")]


@pytest.mark.parametrize("text", ACCEPTED)
def test_the_forms_of_the_page_are_read(text: str) -> None:
    """Each is a right answer, also behind text in lines of its own."""
    assert check_answer(MAZE, text).score == 1
    assert check_answer(MAZE, f"Down leads nowhere.\n\n{text}\n").score == 1


@pytest.mark.parametrize(("text", "reason"), REFUSED)
def test_what_the_page_refuses_scores_0_and_the_reason_names_it(text: str, reason: str) -> None:
    """A user whose model writes one of these sees which."""
    check = check_answer(MAZE, text)
    assert check.score == 0
    assert reason in check.reason


def test_the_tables_of_the_page_are_found() -> None:
    """The two tests above have as many examples as the page."""
    assert len(ACCEPTED) >= 40
    assert len(REFUSED) >= 25


@pytest.mark.parametrize(
    ("text", "score"),
    [
        # Lines that are one answer.
        ("- R\n\n- R\n\n- D", 1),
        ('["right", "right",\n "down"]', 1),
        ('{"moves": ["right",\n "right",\n "down"]}', 1),
        ("right, right,\ndown", 1),
        # Lines that are several.
        ("R\n\nR\n\nD", 0),
        ("R\n- R\n- D", 0),
        ("1. R\n3. R\n4. D", 0),
        ("1. R\n2. R\n1. D", 0),
        ("2. R\n3. R\n4. D", 0),
        ("right right\ndown", 0),
        ("right right,\ndown", 0),
        ("R\nR\nAnswer: D", 0),
        ("```\nR\nR\n```\n```\nD\n```", 0),
        # What a label decides, and where it ends.
        ("RR\nAnswer:\nRRD", 1),
        ("RR\nAnswer:\nI go right.\nRRD", 0),
        ("Left is not free.\nAnswer: RRD", 1),
        ("Left is not free.\nRRD", 0),
        ("Left is not free:\nAnswer: RRD", 0),
    ],
)
def test_which_lines_belong_together(text: str, score: float) -> None:
    """One of several answers is not chosen by its place."""
    assert check_answer(MAZE, text).score == score


@pytest.mark.parametrize("frame", [*DENIED, *TAKEN_BACK, *DOUBLE, *HEDGED])
@pytest.mark.parametrize(("first", "second"), [("RRD", "DDRRU"), ("DDR", "RRD"), ("RRD", "DDR")])
def test_answers_that_are_denied_taken_back_double_or_hedged_score_0(
    frame: str, first: str, second: str
) -> None:
    """A reward for them would teach a model to guess."""
    assert check_answer(MAZE, frame.format(first, second)).score == 0


@pytest.mark.parametrize(
    "words",
    ["but I am not sure about the maze:", "This is wrong.", "Maybe.", "No, I answer:", "Answer:"],
)
def test_a_copy_of_the_question_hides_no_words_that_take_an_answer_back(words: str) -> None:
    """Words that only introduce the copy are ignored with it."""
    assert check_answer(MAZE, f"Answer: RRD\nThe maze was:\n{MAZE}").score == 1
    assert check_answer(MAZE, f"Answer: RRD\n{words}\n{MAZE}").score == 0


@pytest.mark.parametrize(
    "count", [400, pytest.param(20_000, marks=pytest.mark.slow)], ids=["few", "many"]
)
def test_scores_are_those_of_a_breadth_first_search(count: int) -> None:
    """Right, longer and wrong answers as chat models write them; one in ten is denied or double."""
    scores = [0, 0, 0]
    for example in draw_examples(seed=63, count=count):
        check = check_answer(example.question, example.answer, example.size)
        assert check.score == example.score, f"{example}: {check}"
        scores[round(2 * example.score)] += 1
    assert min(scores) >= count / 30


@pytest.mark.parametrize(
    "answer",
    [
        "r\u0131ght",  # a dotless i
        "R\u0131D",
        "\uff32RD",  # a wide R
        "R\u200d\u0336RD",  # struck through by a combining character
        "RR\u0414",  # a Cyrillic D
    ],
)
def test_letters_of_other_alphabets_are_no_moves(answer: str) -> None:
    """None of them is left out in silence."""
    assert check_answer("S  \n ##\nG  ", answer).reason.startswith("no answer")


PIECES = ["RRD", "R", "right", "down", "(0, 0)", "(0, 1)", "Answer:", "<answer>", "</answer>", "#"]
PIECES += [
    "S  ",
    " #G",
    "Soo",
    "   ",
    "```",
    "\n",
    "\n",
    " ",
    " ",
    ", ",
    "- ",
    "1. ",
    "2. ",
    "**",
    "{",
]
PIECES += ["}", "[", "]", '"', "\\boxed{", "$", "\\[", "\\]", "not", "or", ".", "?", "→", "<think>"]
PIECES += [
    "</think>",
    "</s>",
    "infeasible",
    "The path is",
    ":",
    "is",
    "o",
    "7",
    "|",
    "x",
    "~~",
    "'",
]


@SETTINGS
@given(st.lists(st.sampled_from(PIECES), max_size=12).map("".join))
def test_every_text_has_a_score(text: str) -> None:
    """No text of a model ends a training, and its score is one of three."""
    check = check_answer(MAZE, text)
    assert check.score in (0, 0.5, 1)
    assert check.reason


LONG = [
    "answer moves path ",
    "* _",
    "answer>",
    "right ",
    "RR ",
    "(0, 0)\n",
    "[",
    "]",
    "{",
    "#",
    "**",
]
LONG += [
    "RRD\n",
    "R\n",
    "R,\n",
    "- R\n\n",
    "1. R\n",
    "S\n",
    "So \n",
    "o\n",
    " ",
    "\n",
    ". ",
    "the ",
]
LONG += [". the answer is ", "<answer>", "</think>", "</s>", "\\boxed{", "R->", "not ", "R, R or "]


@pytest.mark.parametrize(
    "piece", ["answer: ", *(pytest.param(piece, marks=pytest.mark.slow) for piece in LONG)]
)
def test_long_texts_are_read_in_linear_time(piece: str) -> None:
    """A model may repeat itself without end: a pattern that tries all places would take hours."""
    assert check_answer(MAZE, 20_000 * piece).score == 0
