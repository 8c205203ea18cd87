"""Answers to mazes as text: every form, told apart by its grammar, and scored."""

from __future__ import annotations

import itertools
import random
from typing import Any

import networkx as nx  # type: ignore[import-untyped]
import numpy as np
import pytest
import torch
from helpers.answer_texts import (
    cells_of,
    distances,
    draw_maze,
    draw_walk,
    marked_rows,
    score_of_marks,
)
from helpers.wild import SETTINGS
from hypothesis import given
from hypothesis import strategies as st

from mapdata import Maze, generate
from mapdata.formats import AnswerCheck, check_answer, is_shortest_answer, score_answer

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
        (QUESTION, "Down, down, RIGHT, right,right, right", 1),
        (QUESTION, "Down, down, RIGHT, right,right right", 0),
        (QUESTION, "down\ndown\nright\nright\nright\nright", 1),
        (QUESTION, "DDRRRR", 1),
        (QUESTION, "D D R R R R\n", 1),
        (QUESTION, "D D, R R R R\n", 0),
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
        (QUESTION, f"{FENCE.format(QUESTION)}\nThe path:\n{FENCE.format(SHORTEST)}", 1),
        (QUESTION, f"{FENCE.format(SHORTEST)}\n{FENCE.format(QUESTION)}", 1),
        (QUESTION, f"{FENCE.format(SHORTEST)}\nThe maze was:\n{FENCE.format(QUESTION)}", 1),
        # Text around the answer is ignored, in lines of its own.
        (QUESTION, f"The path goes down first:\n\n{OTHER_SHORTEST}\n", 1),
        (QUESTION, f"The path goes down first:\n\n{OTHER_SHORTEST}\n\nDone.", 0),
        (QUESTION, "First I tried\nRRRRR\nwhich fails. So\nRRRRDD", 0),
        (QUESTION, "First I tried\nRRRRR\nwhich fails. So\nAnswer: RRRRDD", 1),
        (QUESTION, "First I tried\nRRRRDD\nwhich fails. So\nAnswer: RRRRR", 0),
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
        # A label decides against lines before it, and not against those after it.
        (QUESTION, "RRR\nAnswer: RRRRDD", 1),
        (QUESTION, "Answer: RRR\nRDD", 0),
        (QUESTION, "Answer: RRRRDD\nRRRRDD", 0),
        (QUESTION, "Moves: R\nR\nR\nR\nD\nD", 1),
        (QUESTION, "My first answer: RRRRDD\nMy second answer: RRR", 0),
        # A fence does not decide between two answers; a label does.
        (QUESTION, f"I go down:\n{FENCE.format(SHORTEST)}", 1),
        (QUESTION, f"{FENCE.format(SHORTEST)}\nI went right.", 0),
        (QUESTION, f"RRRRR\n{FENCE.format(SHORTEST)}\nRRR", 0),
        (QUESTION, f"{FENCE.format('DDR')}\nBetter:\n```text\nDDRRRR\n```", 0),
        (QUESTION, f"{FENCE.format('DDR')}\n**Answer**\n```text\nDDRRRR\n```", 1),
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
        # Several labelled answers count if they give one path.
        (QUESTION, "Path: RRRRDD\nMoves: right, right, right, right, down, down", 1),
        (QUESTION, "Path: RRRRDD\nMoves: down, down, right, right, right, right", 0),
        # Spaces at the ends of rows may be missing, and before the first row, too.
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
        ("I resign", 'no answer: the text ends with other words: "I resign"', ""),
        ("DDRRRR\n\nDDRRRR", "two answers", ""),
        ("infeasible", "there is a path", ""),
    ],
)
def test_a_check_says_why_and_which_moves(answer: str, reason: str, moves: str) -> None:
    """So that a training can print what its model does."""
    check = check_answer(QUESTION, answer)
    assert (check.reason, check.moves) == (reason, moves)


def test_moves_that_leave_the_map() -> None:
    """They are told from walls."""
    assert check_answer(WIDE, "RRRRRR").reason == "move 4 leaves the map of 3 x 4 cells"
    assert check_answer(WIDE, "U").reason == "move 1 leaves the map of 3 x 4 cells"


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


@pytest.mark.parametrize(
    ("answer", "score"),
    [
        ("SoooG\n     \n     ", 1),
        ("So oG\n ooo \n     ", 0.5),  # a detour
        ("So oG\n o o \n ooo ", 0.5),
        ("SoooG\n ooo \n     ", 0),  # a second way beside the path
        ("SoooG\n o o \n ooo ", 0),  # a loop
        ("SoooG\n     \n    o", 0),  # a mark elsewhere
        ("SoooG\n  o  \n     ", 0),  # a branch
    ],
)
def test_marks_of_a_longer_path_form_a_line(answer: str, score: float) -> None:
    """A way with branches or loops does not say where to go."""
    question = "S   G\n     \n     "
    assert score_answer(question, answer) == score
    assert score_answer(question.replace("\n", ""), answer.replace("\n", ""), (3, 5)) == score


@pytest.mark.parametrize("end", ["rstrip", "lstrip", "strip"])
@pytest.mark.parametrize("line_end", ["", "\n"])
def test_a_stripped_marked_maze_has_the_score_of_the_whole_one(line_end: str, end: str) -> None:
    """Chat templates, tokenizers and readers of CSV strip texts."""
    draw = random.Random(5)
    scores: list[float] = []
    right_scores: list[float] = []
    while len(scores) < 100:
        maze = draw_maze(draw)
        if maze.goal not in distances(maze, maze.start):
            continue
        marks = set(cells_of(maze, draw_walk(draw, maze))) - {maze.start, maze.goal}
        answer = line_end.join(marked_rows(maze, marks))
        question = answer.replace("o", " ")
        size = maze.size if not line_end or maze.size[0] == 1 else None
        scores.append(score_answer(question, getattr(answer, end)(), size))
        right_scores.append(score_of_marks(maze, marks))
    assert scores == right_scores == [1] * 100


def test_line_ends_around_an_answer_are_ignored() -> None:
    """Models end their answers with a newline, and files of Windows have CRLF; spaces are cells."""
    question = "####\n#S #\n# G#\n####"
    answer = question.replace("S ", "So")
    questions = (question, question + "\n", question.replace("\n", "\r\n") + "\r\n")
    answers = (answer, answer + "\n", "\n" + answer, answer.replace("\n", "\r\n") + "\r\n")
    for each_question in questions:
        assert all(is_shortest_answer(each_question, each_answer) for each_answer in answers)
        assert not is_shortest_answer(each_question, " " + answer)
        assert not is_shortest_answer(each_question, answer + "#")
        assert not is_shortest_answer(each_question, answer.replace("\n", "\n\n"))


@pytest.mark.parametrize(
    "answer",
    [
        ["down", "down", "right", "right", "right", "right"],
        ("D", "d", "Right", "RIGHT", "r", " right "),
        np.array(["D", "D", "R", "R", "R", "R"]),
        [(1, 1), (2, 1), (3, 1), (3, 2), (3, 3), (3, 4), (3, 5)],
        [[1, 1], [2, 1], [3, 1], [3, 2], [3, 3], [3, 4], [3, 5]],
        np.array([(1, 1), (2, 1), (3, 1), (3, 2), (3, 3), (3, 4), (3, 5)], np.uint8),
        torch.tensor([(1, 1), (2, 1), (3, 1), (3, 2), (3, 3), (3, 4), (3, 5)]),
        list(np.array([(1, 1), (2, 1), (3, 1), (3, 2), (3, 3), (3, 4), (3, 5)])),
    ],
)
def test_a_list_of_moves_or_cells_is_an_answer(answer: Any) -> None:
    """So that users extract the answers of their models themselves."""
    assert check_answer(QUESTION, answer) == AnswerCheck(1.0, "a shortest path", "DDRRRR")
    assert is_shortest_answer(QUESTION, answer)
    assert score_answer(QUESTION, answer[:-1]) == 0


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        ([], 'no answer: an empty list; where there is no path, "infeasible"'),
        (np.zeros((0, 2)), 'no answer: an empty list; where there is no path, "infeasible"'),
        (["down", "rigth"], "no answer: move 2 is 'rigth', expected one of up, down, left, right"),
        (["DDRRRR"], "no answer: move 1 is 'DDRRRR', expected one of up"),
        (["infeasible"], "no answer: move 1 is 'infeasible'"),
        ([1, 1, 3], "no answer: a list of other things than moves or cells (row, col)"),
        ([(1, 1), (2.0, 1)], "no answer: a list of other things than"),
        ([(True, 1)], "no answer: a list of other things than"),
        ([(1, 1), (2, 1, 0)], "no answer: a list of other things than"),
        (["down", (2, 1)], "no answer: a list of other things than"),
        ([None], "no answer: a list of other things than"),
        (np.full((3, 2), np.nan), "no answer: a list of other things than"),
        ([(0, 1), (1, 1)], "the first cell is (0, 1), S is (1, 1)"),
        ([(1, 1), (3, 1)], "cell (3, 1) is no neighbour of (1, 1)"),
        ([(1, 1), (1, 1)], "cell (1, 1) is no neighbour of (1, 1)"),
        ([(1, 1), (2, 2)], "cell (2, 2) is no neighbour of (1, 1)"),
        ([(1, 1), (0, 1)], "move 1 leads into a wall"),
        ([(1, 1), (1, 0), (1, -1)], "move 1 leads into a wall"),
        ([(1, 1), (10**30, 1)], f"cell ({10**30}, 1) is no neighbour of (1, 1)"),
        ([(1, 1), (2, 1), (3, 1)], "the moves end at (3, 1), the goal is (3, 5)"),
    ],
)
def test_a_list_of_anything_else_scores_0_and_says_why(answer: Any, reason: str) -> None:
    """A model may have written it, and a training goes on."""
    check = check_answer(QUESTION, answer)
    assert check.score == 0
    assert check.reason.startswith(reason)


def test_a_list_of_cells_may_be_a_longer_path() -> None:
    """It may pass a cell twice, as moves may."""
    cells = [(1, 1), (1, 2), (1, 1), (2, 1), (3, 1), (3, 2), (3, 3), (3, 4), (3, 5)]
    assert check_answer(QUESTION, cells).reason == "a path of 8 moves where 6 are enough"
