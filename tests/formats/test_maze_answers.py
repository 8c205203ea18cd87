"""Answers to mazes as text: every form, told apart by its grammar, and scored."""

from __future__ import annotations

import itertools
from typing import Any

import networkx as nx  # type: ignore[import-untyped]
import numpy as np
import pytest
from helpers.wild import SETTINGS
from hypothesis import given
from hypothesis import strategies as st

from mapdata import Maze, astar, generate
from mapdata.formats import FormatError, check_answer, is_shortest_answer, score_answer

CHARSET = "# SGo"

QUESTION = "#######\n#S    #\n# ### #\n#    G#\n#######"
"""A ring of twelve cells around a block: two paths from S to G have six moves."""

SHORTEST = "#######\n#Soooo#\n# ###o#\n#    G#\n#######"
OTHER_SHORTEST = "#######\n#S    #\n#o### #\n#ooooG#\n#######"
BOTH = "#######\n#Soooo#\n#o###o#\n#ooooG#\n#######"
BROKEN = "#######\n#Soo o#\n# ###o#\n#    G#\n#######"
CLOSED = "#S#G#\n# # #"
"""A question without a path."""

FENCE = "```\n{}\n```"


WIDE = "S   \n    \n   G"
"""A map without walls: shortest paths have five moves."""


@pytest.mark.parametrize(
    ("question", "answer", "score"),
    [
        # Each form alone.
        (QUESTION, SHORTEST, 1),
        (QUESTION, OTHER_SHORTEST, 1),
        (QUESTION, "right right right right down down", 1),
        (QUESTION, "Down, down, RIGHT, right,right right", 1),
        (QUESTION, "down\ndown\nright\nright\nright\nright", 1),
        (QUESTION, "DDRRRR", 1),
        (QUESTION, "D D, R R R R\n", 1),
        (CLOSED, "infeasible", 1),
        (CLOSED, "  Infeasible\n", 1),
        # Longer paths.
        (QUESTION, "right left down down right right right right", 0.5),
        (QUESTION, "DDRRRRUD", 0.5),
        (WIDE, "So  \noo  \noooG", 0),
        (WIDE, "Soo \n  o \n  oG", 1),
        (WIDE, "Sooo\n   o\n   G", 1),
        ("S   \n  # \n   G", "S   \no # \noooG", 1),
        ("S   \n    \nG   ", "Soo \n  o \nGoo ", 0.5),
        # No paths.
        (QUESTION, BOTH, 0),
        (QUESTION, BROKEN, 0),
        (QUESTION, SHORTEST.replace("o", "#", 1), 0),
        (QUESTION, "DDRRR", 0),
        (QUESTION, "RD", 0),
        (QUESTION, "UUUU", 0),
        (WIDE, "LLLL", 0),
        (QUESTION, "infeasible", 0),
        (CLOSED, "DDRRUU", 0),
        (CLOSED, CLOSED, 0),
        (QUESTION, "", 0),
        (QUESTION, "up the stairs", 0),
        (QUESTION, "I cannot solve it.", 0),
        # Copies of the question are dropped.
        (QUESTION, QUESTION, 0),
        ("SG\n##", "SG\n##", 1),  # No cell lies between, so this is the marked maze.
        ("SG##", "SG##", 1),
        ("SG\n##", "SG\n##\nright", 1),
        (QUESTION, f"{QUESTION}\n{SHORTEST}", 1),
        (QUESTION, f"{FENCE.format(SHORTEST)}\nThe maze was:\n{FENCE.format(QUESTION)}", 1),
        # Text around the answer is ignored, in lines of its own.
        (QUESTION, f"The path goes down first:\n\n{OTHER_SHORTEST}\n\nDone.", 1),
        (QUESTION, "First I tried\nRRRRR\nwhich fails. So\nRRRRDD\nis the answer.", 1),
        (QUESTION, "First I tried\nRRRRDD\nwhich fails. So\nRRRRR\nis the answer.", 0),
        (QUESTION, "The answer may be RRRRDD", 0),
        # Behind a label in one line, or between marks, as chat models write it.
        (QUESTION, "Answer: RRRRDD", 1),
        (QUESTION, "**Final answer:** RRRRDD", 1),
        (QUESTION, "**RRRRDD**", 1),
        (QUESTION, "`RRRRDD`", 1),
        (QUESTION, "<answer>RRRRDD</answer>", 1),
        (QUESTION, "The path is: right, right, right, right, down, down.", 1),
        (QUESTION, "It is (see below): RRRRDD", 0),
        (QUESTION, "Answer: RRRRDD, I think", 0),
        (QUESTION, "The answer is RRRRDD.", 1),
        (QUESTION, "The wall is right", 0),
        (QUESTION, "Answer = [R, R, R, R, D, D]", 1),
        (QUESTION, r"$\boxed{RRRRDD}$", 1),
        (QUESTION, r"The answer is \boxed{RRRRDD}.", 1),
        (QUESTION, "RRRRDD<|im_end|>", 1),
        (QUESTION, "<answer>RRRRDD</answer></s>", 1),
        (CLOSED, "Answer: infeasible", 1),
        # A label separates its answer from the lines before it, and not from those after it.
        (QUESTION, "RRR\nAnswer: RRRRDD", 1),
        (QUESTION, "Answer: RRR\nRDD", 1),
        (QUESTION, "My first answer: RRRRDD\nMy second answer: RRR", 0),
        # The last fenced block counts, whatever stands outside.
        (QUESTION, f"RRRRR\n{FENCE.format(SHORTEST)}\nRRR", 1),
        (QUESTION, f"{FENCE.format('DDR')}\nBetter:\n```text\nDDRRRR\n```", 1),
        (QUESTION, f"{FENCE.format('DDRRRR')}\nor\n{FENCE.format('DDR')}", 0),
        (QUESTION, "```\nDDRRRR", 1),
        (QUESTION, f"{FENCE.format('DDRRRR')}\n```\n\n```", 1),
        (QUESTION, f"RRRRDD\n{FENCE.format('print(1)')}", 0),
        # Two answers at the place that counts.
        (QUESTION, f"{SHORTEST}\n{SHORTEST}", 0),
        (QUESTION, "RRRRDD\n\nRRRRDD", 0),
        (QUESTION, "RRRRDD\nright right right right down down", 0),
        (QUESTION, f"{SHORTEST}\nRRRRDD", 0),
        (QUESTION, FENCE.format("RRRRDD\nor\nDDRRRR"), 0),
        (CLOSED, "infeasible\nDDRRUU", 0),
        # Spaces at the ends of rows may be missing, those at their beginnings may not.
        (WIDE, "S\no\noooG", 1),
        (WIDE, "S\no\noooG".replace("\n", " \n"), 1),
        ("   G\n    \nS   ", "oooG\no\nS", 1),
        ("  G\n# #\nS  ", "ooG\n# #\nS  ", 0),
        (" G \n # \nS  ", "oG\no#\nS", 1),
        (" G \n # \nS  ", "oG\n#\nS", 0),
    ],
)
def test_answers_are_scored(question: str, answer: str, score: float) -> None:
    """Also with the line ends of other systems."""
    assert score_answer(question, answer) == score
    crlf = answer.replace("\n", "\r\n")
    assert score_answer(question.replace("\n", "\r\n"), crlf) == score
    check = check_answer(question, answer)
    assert check.score == score
    assert is_shortest_answer(question, answer) == (score == 1)


@pytest.mark.parametrize(
    ("answer", "reason", "moves"),
    [
        (SHORTEST, "a shortest path", "RRRRDD"),
        ("DDRRRRUD", "a path of 8 moves where 6 are enough", "DDRRRRUD"),
        ("RD", "move 2 leads into a wall", "RD"),
        ("DDRR", "the moves end at (3, 3), the goal is (3, 5)", "DDRR"),
        (BOTH, "the marked cells are no path from S to G", ""),
        (QUESTION, "a copy of the question", ""),
        ("I give up", "no answer", ""),
        ("DDRRRR\n\nDDRRRR", "two answers", ""),
        ("infeasible", "there is a path", ""),
    ],
)
def test_a_check_says_why_and_which_moves(answer: str, reason: str, moves: str) -> None:
    """So that a training can print what its model does."""
    check = check_answer(QUESTION, answer)
    assert (check.reason, check.moves) == (reason, moves)


def test_long_lines_are_read_in_linear_time() -> None:
    """A model may repeat itself without end: a pattern that tries all labels would take minutes."""
    for line in ("answer: ", "answer moves path ", "* _", "answer>"):
        assert check_answer(QUESTION, 100_000 * line).reason == "no answer"


def test_moves_that_leave_the_map() -> None:
    """They are told from walls."""
    assert check_answer(WIDE, "RRRRRR").reason == "move 4 leaves the map"
    assert check_answer(WIDE, "U").reason == "move 1 leaves the map"


@SETTINGS
@given(st.integers(0, 10_000), st.data())
def test_walks_are_scored_by_their_length(seed: int, data: st.DataObject) -> None:
    """Every walk of free cells that ends at the goal is a path; networkx knows the shortest."""
    grid = generate(Maze((7, 7), reopened=0.6, seed_points=2), seed, [0])
    cells = grid.occupancy[0]
    start, goal = (tuple(point.tolist()) for point in grid.seed_points[0])
    graph = nx.grid_2d_graph(7, 7)
    graph.remove_nodes_from([tuple(cell) for cell in np.argwhere(cells).tolist()])
    letters = np.where(cells, "#", " ")
    letters[start], letters[goal] = "S", "G"
    question = "\n".join("".join(row) for row in letters)
    via = data.draw(st.sampled_from(sorted(graph)))
    walk = nx.shortest_path(graph, start, via) + nx.shortest_path(graph, via, goal)[1:]
    steps = {(-1, 0): "U", (1, 0): "D", (0, -1): "L", (0, 1): "R"}
    moves = "".join(
        steps[after[0] - before[0], after[1] - before[1]]
        for before, after in itertools.pairwise(walk)
    )
    is_shortest = len(moves) == nx.shortest_path_length(graph, start, goal)
    assert score_answer(question, moves) == (1 if is_shortest else 0.5)
    assert score_answer(question, moves[:-1]) == (0 if walk[-2] != goal else 0.5)
    assert check_answer(question, moves).moves == moves


@SETTINGS
@given(st.integers(0, 10_000), st.data())
def test_all_shortest_paths_of_networkx_are_right_answers(seed: int, data: st.DataObject) -> None:
    """A path with a cell added, removed or moved is wrong, unless it is another shortest path."""
    grid = generate(Maze((9, 9), reopened=0.6, seed_points=2), seed, [0])
    cells = grid.occupancy[0]
    start, goal = (tuple(point.tolist()) for point in grid.seed_points[0])
    graph = nx.grid_2d_graph(9, 9)
    graph.remove_nodes_from([tuple(cell) for cell in np.argwhere(cells).tolist()])
    letters = np.where(cells, "#", " ")
    letters[start], letters[goal] = "S", "G"
    question = "".join(letters.flat)

    def answer(path: list[tuple[int, int]]) -> str:
        marked = letters.copy()
        for cell in path[1:-1]:
            marked[cell] = "o"
        return "".join(marked.flat)

    paths = list(nx.all_shortest_paths(graph, start, goal))
    if len(paths[0]) == 2:
        return  # The answer would be a copy of the question.
    assert all(is_shortest_answer(question, answer(path)) for path in paths)
    right = {answer(path) for path in paths}
    other = list(data.draw(st.sampled_from(sorted(right))))
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, 80))
        other[place] = data.draw(st.sampled_from(CHARSET))
    assert is_shortest_answer(question, "".join(other)) == ("".join(other) in right)


def test_longer_paths_are_wrong() -> None:
    """Wrong answers are a detour, a loop beside the path, another length and a changed wall."""
    question = "S        " + "       G "
    question = question.ljust(25)
    start, goal = 0, 16
    found = astar(np.zeros((5, 5)), (0, 0), divmod(goal, 5))
    cells = [row * 5 + column for row, column in found.path.tolist()]
    right = "".join("o" if k in cells[1:-1] else letter for k, letter in enumerate(question))
    assert is_shortest_answer(question, right)
    assert not is_shortest_answer(question, right[:-1])
    assert not is_shortest_answer(question, right[:-1] + "#")
    assert not is_shortest_answer(question, right[:-1] + "o")
    assert right[start] == "S"


def test_line_ends_around_an_answer_are_ignored() -> None:
    """Models end their answers with a newline, and files of Windows have CRLF; spaces are cells."""
    question = "####\n#S #\n# G#\n####"
    answer = question.replace("S ", "So")
    questions = (question, question + "\n", question.replace("\n", "\r\n") + "\r\n")
    answers = (answer, answer + "\n", "\n" + answer, answer.replace("\n", "\r\n") + "\r\n")
    for each_question in questions:
        assert all(is_shortest_answer(each_question, each_answer) for each_answer in answers)
        assert not is_shortest_answer(each_question, " " + answer)
        assert not is_shortest_answer(each_question, answer.replace("\n", "\n\n"))


@pytest.mark.parametrize(
    ("question", "answer", "message"),
    [
        ("#########", "#########", "question: expected the maze alone, without instructions"),
        ("", "", "one S and one G"),
        ("S  SG    ", "S  SG    ", "one S and one G"),
        ("SéG ", "SéG ", "cells '#' and ' ', one S and one G"),
        ("S G", "SoG", "question: got 3 cells in one line, expected a square map"),
        ("S G", "S G ", "question: got 3 cells in one line, expected a square map"),
        ("S \n G ", "S \n G ", "got lines of several lengths"),
        (None, "S  G", "question: got a value of type NoneType, expected a text"),
        ("S  G", None, "answer: got a value of type NoneType, expected a text"),
    ],
)
def test_a_question_that_is_no_map_raises_a_format_error(
    question: Any, answer: Any, message: str
) -> None:
    """The docstring promises this error and no other."""
    with pytest.raises(FormatError, match=message):
        is_shortest_answer(question, answer)
