"""Questions of mazes as text: the map that they hold, or what is wrong with them."""

from __future__ import annotations

from typing import Any

import pytest

from mapdata.formats import FormatError, check_answer


@pytest.mark.parametrize(
    ("question", "answer", "message"),
    [
        ("#########", "#########", "question: expected the maze alone, without instructions"),
        ("", "", "one S and one G"),
        ("S  SG    ", "S  SG    ", "one S and one G"),
        ("SéG ", "SéG ", "cells '#' and ' ', one S and one G"),
        ("S G", "SoG", "question: got 3 cells in one line, expected a square map"),
        ("S G", "S G ", "a map of one row needs size"),
        ("S \n G ", "S \n G ", "got lines of several lengths"),
        (None, "S  G", "question: got a value of type NoneType, expected a text"),
        ("S  G", None, "answer: got a value of type NoneType, expected a text"),
        (
            "S  G",
            3,
            "answer: got a value of type int, expected a text, or a list or array of moves",
        ),
        ("S  G", {"moves": ["right"]}, "answer: got a value of type dict"),
    ],
)
def test_a_question_that_is_no_map_raises_a_format_error(
    question: Any, answer: Any, message: str
) -> None:
    """The docstring promises this error and no other."""
    with pytest.raises(FormatError, match=message):
        check_answer(question, answer)


@pytest.mark.parametrize(
    ("question", "size", "message"),
    [
        ("S \n G", (1, 4), r"got 2 lines of 2 cells, expected size=\(1, 4\)"),
        ("S  \n  G", (3, 2), r"got 2 lines of 3 cells, expected size=\(3, 2\)"),
        ("S  G", (1, 5), r"got 4 cells in one line, expected size=\(1, 5\), that is 5 cells"),
        ("S  G", (2, 3), r"got 4 cells in one line, expected size=\(2, 3\), that is 6 cells"),
    ],
)
def test_a_size_that_contradicts_the_question_is_an_error(
    question: str, size: tuple[int, int], message: str
) -> None:
    """No other map is scored in silence."""
    with pytest.raises(FormatError, match=message):
        check_answer(question, "RRR", size)


@pytest.mark.parametrize("size", [(0, 4), (4,), (1.0, 4), "14", 4])
def test_a_size_is_two_sides(size: Any) -> None:
    """As in all of mapdata."""
    with pytest.raises(ValueError, match="size: got"):
        check_answer("S  G", "RRR", size)


def test_one_line_is_a_square_without_a_size_and_a_row_with_it() -> None:
    """Four cells may be a row, a column or a square."""
    right = {None: "DR", (1, 4): "RRR", (4, 1): "DDD", (2, 2): "RD"}
    scores = {
        size: [check_answer("S  G", moves, size).score for moves in right.values()]
        for size in right
    }
    assert scores == {
        None: [1, 0, 0, 1],
        (1, 4): [0, 1, 0, 0],
        (4, 1): [0, 0, 1, 0],
        (2, 2): [1, 0, 0, 1],
    }


def test_the_marked_maze_of_one_row_is_right_with_its_size() -> None:
    """It is what `maze_text` answers."""
    assert check_answer("S  G", "SooG", (1, 4)).score == 1
    assert check_answer("S  G\n", "SooG\n", (1, 4)).score == 1
