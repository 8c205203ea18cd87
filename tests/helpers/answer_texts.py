"""Answers to mazes as chat models write them, and their scores by breadth-first search alone.

Nothing here uses mapdata. An answer is drawn as a path or a set of marked cells, which the search
scores, and then written in one of many forms.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable, Iterator
from typing import NamedTuple

Cell = tuple[int, int]

STEPS = {"U": (-1, 0), "D": (1, 0), "L": (0, -1), "R": (0, 1)}
WORDS = {"U": "up", "D": "down", "L": "left", "R": "right"}
ARROWS = {"U": "⬆️", "D": "⬇️", "L": "⬅️", "R": "➡️"}


class TextMaze(NamedTuple):
    """A maze: its rows of "#" and " ", with S and G in their places."""

    rows: tuple[str, ...]
    start: Cell
    goal: Cell

    @property
    def size(self) -> tuple[int, int]:
        """(rows, columns)."""
        return len(self.rows), len(self.rows[0])

    def is_free(self, cell: Cell) -> bool:
        """Return whether a cell lies on the map and has no wall."""
        row, column = cell
        rows, columns = self.size
        return 0 <= row < rows and 0 <= column < columns and self.rows[row][column] != "#"


class Example(NamedTuple):
    """An answer to a maze, with the score that it must have."""

    maze: TextMaze
    question: str
    size: tuple[int, int] | None
    answer: str
    score: float
    kind: str


# --- scores ---------------------------------------------------------------------------------------


def neighbours(cell: Cell) -> list[Cell]:
    """Return the four cells beside a cell, also those off the map."""
    return [(cell[0] + down, cell[1] + right) for down, right in STEPS.values()]


def distances(maze: TextMaze, start: Cell) -> dict[Cell, int]:
    """Return the number of moves from a cell to each cell that it reaches, breadth first."""
    found = {start: 0}
    queue = deque([start])
    while queue:
        cell = queue.popleft()
        for other in neighbours(cell):
            if maze.is_free(other) and other not in found:
                found[other] = found[cell] + 1
                queue.append(other)
    return found


def score_of_moves(maze: TextMaze, moves: str) -> float:
    """Return 1 for a shortest path, 0.5 for a longer one and 0 for others."""
    cell = maze.start
    for move in moves:
        cell = (cell[0] + STEPS[move][0], cell[1] + STEPS[move][1])
        if not maze.is_free(cell):
            return 0
    if cell != maze.goal:
        return 0
    return 1 if len(moves) == distances(maze, maze.start)[maze.goal] else 0.5


def score_of_marks(maze: TextMaze, marks: set[Cell]) -> float:
    """Return the score of marked cells: they must be a line from S to G without branches."""
    line = marks | {maze.start, maze.goal}
    walls = {
        (row, column)
        for row in range(maze.size[0])
        for column in range(maze.size[1])
        if (row, column) not in line
    }
    alone = TextMaze(
        tuple(
            "".join("#" if (row, column) in walls else " " for column in range(maze.size[1]))
            for row in range(maze.size[0])
        ),
        maze.start,
        maze.goal,
    )
    if len(distances(alone, maze.start)) != len(line):
        return 0
    for cell in line:
        beside = sum(other in line for other in neighbours(cell))
        if beside != (1 if cell in (maze.start, maze.goal) else 2):
            return 0
    return 1 if len(line) - 1 == distances(maze, maze.start)[maze.goal] else 0.5


# --- mazes and paths ------------------------------------------------------------------------------


def draw_maze(draw: random.Random) -> TextMaze:
    """Return a maze of random walls; one in six has one row or one column."""
    rows, columns = draw.randint(2, 7), draw.randint(2, 7)
    if draw.random() < 1 / 6:
        rows, columns = draw.choice([(1, columns), (rows, 1)])
    share = draw.choice([0, 0.1, 0.25, 0.4])
    cells = [[" #"[draw.random() < share] for _ in range(columns)] for _ in range(rows)]
    places = [(row, column) for row in range(rows) for column in range(columns)]
    start, goal = draw.sample(places, 2)
    cells[start[0]][start[1]] = "S"
    cells[goal[0]][goal[1]] = "G"
    return TextMaze(tuple("".join(row) for row in cells), start, goal)


def draw_walk(draw: random.Random, maze: TextMaze, via: Cell | None = None) -> str:
    """Return a random shortest path from S to G, or a path of two shortest ones over a cell."""
    moves = ""
    cell = maze.start
    for target in [maze.goal] if via is None else [via, maze.goal]:
        left = distances(maze, target)
        while cell != target:
            steps = [
                (move, (cell[0] + down, cell[1] + right)) for move, (down, right) in STEPS.items()
            ]
            nearer = [step for step in steps if left.get(step[1], -1) == left[cell] - 1]
            move, cell = draw.choice(nearer)
            moves += move
    return moves


def draw_moves(draw: random.Random, maze: TextMaze) -> str:
    """Return moves: a shortest path, a longer one, or a wrong one."""
    reached = sorted(distances(maze, maze.start))
    kind = draw.choice(["right", "right", "longer", "wrong", "wrong"])
    if maze.goal in reached and kind == "right":
        return draw_walk(draw, maze)
    if maze.goal in reached and kind == "longer":
        return draw_walk(draw, maze, draw.choice(reached))
    moves = draw_walk(draw, maze) if maze.goal in reached else "R"
    place = draw.randrange(len(moves))
    changed = draw.choice(["", "U", "D", "L", "R", "RL", "UU"])
    return moves[:place] + changed + moves[place + 1 :] or "U"


def cells_of(maze: TextMaze, moves: str) -> list[Cell]:
    """Return the cells that moves pass, S included."""
    cells = [maze.start]
    for move in moves:
        cells.append((cells[-1][0] + STEPS[move][0], cells[-1][1] + STEPS[move][1]))
    return cells


# --- forms ----------------------------------------------------------------------------------------


def _spelled(words: Callable[[str], str], joint: str) -> Callable[[str], str]:
    return lambda moves: joint.join(words(move) for move in moves)


def _word(move: str) -> str:
    return WORDS[move]


def _listed(marker: str, words: Callable[[str], str]) -> Callable[[str], str]:
    """Return a writer of lists, whose markers may hold the number of a line."""
    return lambda moves: "\n".join(
        marker.format(number) + words(move) for number, move in enumerate(moves, 1)
    )


ONE_LINE_FORMS: list[Callable[[str], str]] = [
    str,
    lambda moves: moves.lower() if len(moves) > 1 else moves,
    _spelled(ARROWS.__getitem__, ""),
    _spelled(ARROWS.__getitem__, " "),
    *(
        _spelled(words, joint)
        for words in (str, _word, lambda move: WORDS[move].title())
        for joint in (" ", ", ", ",", " -> ", " → ", " - ", "; ", " ➡️ ")
    ),
    _spelled(lambda move: f"`{move}`", ", "),
    lambda moves: "[" + ", ".join(f'"{WORDS[move]}"' for move in moves) + "]",
    lambda moves: str([WORDS[move] for move in moves]),
    lambda moves: str(list(moves)),
]

LIST_FORMS: list[Callable[[str], str]] = [
    *(
        _listed(marker, words)
        for marker in ("- ", "* ", "{}. ", "{}) ", "Step {}: ", "**Step {}:** ", "- Step {}: ", "")
        for words in (
            str,
            _word,
            lambda move: f"**{WORDS[move].title()}**",
            lambda move: f"Move {WORDS[move]}",
        )
    ),
    lambda moves: "[\n" + ",\n".join(f'  "{WORDS[move]}"' for move in moves) + "\n]",
]


def _write_cells(draw: random.Random, cells: list[Cell]) -> str:
    if draw.random() < 0.3:
        return str([list(cell) for cell in cells])
    if draw.random() < 0.3:
        return str(cells)
    return draw.choice([" → ", " -> ", ", ", " ", "\n"]).join(map(str, cells))


def marked_rows(maze: TextMaze, marks: set[Cell]) -> list[str]:
    """Return the rows of a maze with "o" on some of its free cells."""
    return [
        "".join(
            "o" if (row, column) in marks and cell == " " else cell
            for column, cell in enumerate(line)
        )
        for row, line in enumerate(maze.rows)
    ]


def _strip(draw: random.Random, text: str) -> str:
    ends = draw.choice(["none", "both", "left", "right"])
    text = text.lstrip() if ends in ("both", "left") else text
    return text.rstrip() if ends in ("both", "right") else text


# --- what chat models write around them -----------------------------------------------------------

MARKS = ["{}", "{}", "**{}**", "`{}`", '"{}"', r"\boxed{{{}}}", r"\boxed{{\text{{{}}}}}", "{}."]
MARKS += [r"\({}\)", r"\[{}\]", r"\[\boxed{{{}}}\]", "${}$", "```{}```", "$$\\boxed{{{}}}$$"]

LABELS = ["Answer: {}", "**Answer:** {}", "**Final Answer: {}**", "The answer is {}", "#### {}"]
LABELS += ["The shortest path is: {}", "So the path from S to G is {}", "Moves: {}", "> Path: {}"]
LABELS += ["Let me see. The answer is {}", "Final answer\uff1a {}", "The moves are {}", "path = {}"]

LABEL_LINES = [
    "Answer:\n",
    "### Solution\n\n",
    "**Final answer**\n\n",
    "The path is:\n\n",
    "Moves\n",
]

BLOCKS = [
    "{}",
    "```\n{}\n```",
    "```text\n{}\n```",
    "<answer>\n{}\n</answer>",
    "<answer>{}</answer>",
]
BLOCKS += ["I follow the corridor.\n\n{}", "Here is my path:\n{}", "The walls leave one way.\n{}"]
BLOCKS += [
    "<think>\nRRD? No, that hits a wall.\nUUU\n</think>\n\n{}",
    "Left is free.\nI turn:\n\n{}",
]

ENDS = ["", "", "\n", "\n\n", "</s>", "<|im_end|>", " <eos>", "<|eot_id|>\n"]

DENIED = [
    "The path is not: {0}",
    "The path is not:\n{0}",
    "The answer is not {0}.",
    "Not {0}",
    "Answer: not {0}",
    "<answer>not {0}</answer>",
    "Wrong answer: {0}",
    "This is no path:\n{0}",
    "This is not the path.\n{0}",
    "```\nnot {0}\n```",
    "Do not answer\n```\n{0}\n```",
    "The answer isn't \\boxed{{{0}}}",
    "I don't believe it is\n\\boxed{{{0}}}",
    "~~{0}~~",
    "The path isn\u2019t\n\n{0}",
    "Never go\n<answer>{0}</answer>",
    "It fails:\n\nAnswer: {0}",
    "The following is wrong.\nAnswer: {0}",
    "The following isn't the path. The path is {0}",
    "The next line is wrong.\nAnswer: {0}",
    "The answer below is wrong.\nAnswer: {0}",
    "This isnt it:\n{0}",
    "This wont work:\n{0}",
]

TAKEN_BACK = [
    "{0}\nbut I am not sure",
    "Answer: {0}\nNo, that hits a wall.",
    "{0}\n\nThis is wrong.",
    "```\n{0}\n```\nOn second thought, no.",
    "<answer>{0}</answer> but that is wrong",
    "{0} (wrong)",
    "Answer: {0}. Wait, that hits a wall.",
    "\\boxed{{{0}}} is not right",
]

DOUBLE = [
    "<answer>{0}</answer><answer>{1}</answer>",
    "{0} or {1}",
    "Answer: {0} or {1}",
    "{0}\n{1}",
    "{0}\n\n{1}",
    "{0}\nor\n{1}",
    "{0}\nAlternatively:\n{1}",
    "{0}, {1}",
    "{0} / {1}",
    "1. {0}\n2. {1}",
    "- {0}\n- {1}",
    '["{0}", "{1}"]',
    '{{"answer": "{0}", "other": "{1}"}}',
    "```\n{0}\n```\nor\n```\n{1}\n```",
    "```\n{0}\n```\n```\n{1}\n```",
    "\\boxed{{{0}}}\n\\boxed{{{1}}}",
    "Answer: {0}\nAnswer: {1}",
    "My moves: {0}\nFinal answer: {1}",
    "The path is {0}. The path is {1}.",
    "First path: {0}\nSecond path: {1}",
    "One path is:\n{0}\nAnother path is:\n{1}",
    "Moves: {0} {1}",
]

HEDGED = [
    "Answer: {0}?",
    "Maybe {0}",
    "Maybe:\n{0}",
    "I guess\n\nAnswer: {0}",
    "My guess: {0}",
    "I am not sure. Answer: {0}",
    "I'm not 100% sure.\nAnswer: {0}",
    "I can't be certain.\n<answer>{0}</answer>",
    "I think the path is:\n{0}",
    "I have no idea.\n\\boxed{{{0}}}",
    "Assuming that the door is open:\n{0}",
    "Perhaps this one:\n```\n{0}\n```",
    "Answer: {0} (I think)",
    "It could be\n{0}",
    "Options:\n- {0}",
    "Answer (probably): {0}",
    "{0}, if that is free",
    "Answer: {0}, I hope",
]
"""Texts around a first, and in `DOUBLE` a second answer, all of which must score 0."""


def _draw_text(draw: random.Random, maze: TextMaze) -> tuple[str, float]:
    """Return an answer as a chat model may write it, and its score."""
    can_be_solved = maze.goal in distances(maze, maze.start)
    moves = draw_moves(draw, maze)
    kind = draw.choice(["one line", "one line", "list", "cells", "rows", "row", "infeasible"])
    if kind == "infeasible":
        text, score = "infeasible", float(not can_be_solved)
    elif kind in ("one line", "list"):
        forms = ONE_LINE_FORMS if kind == "one line" else LIST_FORMS
        text, score = draw.choice(forms)(moves), score_of_moves(maze, moves)
    else:
        cells = cells_of(maze, moves)
        marks = {cell for cell in cells if maze.is_free(cell)} - {maze.start, maze.goal}
        if kind == "cells" and min(min(cell) for cell in cells) >= 0:
            text, score = _write_cells(draw, cells), score_of_moves(maze, moves)
        elif kind == "row":
            text = _strip(draw, "".join(marked_rows(maze, marks)))
            score = score_of_marks(maze, marks)
        else:
            rows = marked_rows(maze, marks)
            text = "\n".join(map(str.rstrip, rows) if draw.random() < 0.3 else rows)
            text, score = _strip(draw, text), score_of_marks(maze, marks)
    if "\n" not in text:
        text = draw.choice(MARKS).format(text)
        label = draw.choice(LABELS)
        # "The answer is right" does not say where the path goes, and is no answer.
        if draw.random() < 0.3 and (moves != "R" or ":" in label):
            text = label.format(text)
    if draw.random() < 0.2 and not text.startswith("<"):
        text = draw.choice(LABEL_LINES) + text
    text = draw.choice(BLOCKS).format(text)
    return text + draw.choice(ENDS), score


def draw_examples(seed: int, count: int) -> Iterator[Example]:
    """Yield answers with their scores; one in ten is denied, taken back, double or hedged."""
    draw = random.Random(seed)
    for number in range(count):
        maze = draw_maze(draw)
        rows, columns = maze.size
        is_one_line = draw.random() < 0.3
        question = ("" if is_one_line else "\n").join(maze.rows)
        size = maze.size if rows == 1 or (is_one_line and rows != columns) else None
        if number % 10:
            answer, score = _draw_text(draw, maze)
            yield Example(maze, question, size, answer, score, "answer")
            continue
        # Two single moves, one after the other, are one path. So each answer has several moves.
        first, second = draw_moves(draw, maze), draw_moves(draw, maze)
        first += "" if len(first) > 1 else "UD"
        second += "" if len(second) > 1 else "UD"
        second += "" if first != second else "DU"
        write = draw.choice(ONE_LINE_FORMS[:3])
        frame = draw.choice([*DENIED, *TAKEN_BACK, *DOUBLE, *HEDGED])
        yield Example(maze, question, size, frame.format(write(first), write(second)), 0, frame)
