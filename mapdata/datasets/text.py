"""Mazes as text and as tokens, for models that read sequences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from mapdata.arrays import Array, Bytes, Flags, Float32s, Ints
from mapdata.checks import check_choice
from mapdata.datasets.field_kernels import PADDING
from mapdata.datasets.sample import Sample
from mapdata.formats.maze_answers import letters_of_path, words_of_letters
from mapdata.formats.maze_questions import INFEASIBLE, MOVES
from mapdata.search.api import astar

CHARACTERS = "# SGo"
"""Occupied, free, start, goal, path: the characters of maze-30x30-hard-1k.

Source: https://huggingface.co/datasets/sapientinc/maze-30x30-hard-1k. A token is the place in this
text plus 1; token 0 is padding.
"""

_WALL, _FREE, _START, _GOAL, _PATH = range(1, len(CHARACTERS) + 1)

_FIELDS = ("map", "start", "goal", "path")
"""The fields that `maze_text` reads."""

_BYTES = np.frombuffer(f"\0{CHARACTERS}".encode(), np.uint8)
"""The character of each token."""


def maze_tokens(fields: Mapping[str, Array], *, with_path: bool) -> Bytes:
    """Return B mazes as tokens (B, H, W) uint8: 1 occupied, 2 free, 3 start, 4 goal, 5 path.

    Args:
        fields: ``map`` (B, 1, H, W), ``start`` and ``goal`` (B, 2), and ``path`` (B, T, 2), padded
            with -1.
        with_path: whether the cells of the path between start and goal are marked.
    """
    tokens = np.where(fields["map"][:, 0] == 0, _FREE, _WALL).astype(np.uint8)
    if with_path:
        path = fields["path"]
        problems, numbers = np.nonzero(path[:, :, 0] != PADDING)
        path_rows, path_columns = path[problems, numbers].T
        tokens[problems, path_rows, path_columns] = _PATH
    problems = np.arange(len(tokens))
    tokens[(problems, *fields["start"].T)] = _START
    tokens[(problems, *fields["goal"].T)] = _GOAL
    return tokens


LABEL_ORDER = ("down", "left", "right", "up")
"""The order in which the labels of maze-30x30-hard-1k prefer moves (docs/howto/maze_hard.md)."""


def first_optimal_paths(
    cost_to_go: Float32s, starts: Ints, order: Sequence[str] = LABEL_ORDER
) -> Ints:
    """Return the shortest paths that take, from the start on, the first optimal move of an order.

    Args:
        cost_to_go: (B, H, W), number of 4-connected moves to the goal; -1 where no path leads.
        starts: (B, 2), cells (row, col).
        order: the four moves, the one that is preferred first.

    Returns:
        (B, T, 2) int64, padded with -1, where T is the number of cells of the longest path. A
        problem without a path has no cell.
    """
    count, rows, columns = cost_to_go.shape
    steps = np.array([MOVES[word] for word in order])
    # Beyond the border no path leads.
    costs = np.full((count, rows + 2, columns + 2), -1, np.int64)
    costs[:, 1:-1, 1:-1] = cost_to_go
    problems = np.arange(count)
    cells = starts.astype(np.int64) + 1
    costs_here = costs[problems, cells[:, 0], cells[:, 1]]
    longest = int(costs_here.max(initial=-1)) + 1
    paths = np.full((count, longest, 2), PADDING, np.int64)
    for number in range(longest):
        is_on_path = costs_here >= 0
        problems = problems[is_on_path]
        cells = cells[is_on_path]
        costs_here = costs_here[is_on_path]
        paths[problems, number] = cells - 1
        # (4, B, 2): the neighbours of each cell, and whether an optimal move leads there.
        neighbours = cells + steps[:, None]
        costs_there = costs[problems, neighbours[:, :, 0], neighbours[:, :, 1]]
        is_optimal = costs_there == costs_here - 1
        # At the goal a move to a cell without a path, of cost -1, counts as optimal. It ends the
        # path, since the next cost is -1, too.
        moves = is_optimal.argmax(axis=0)
        cells = neighbours[moves, np.arange(len(problems))]
        costs_here = costs_here - 1
    return paths


def maze_texts(tokens: Bytes, line_end: str = "\n") -> list[str]:
    """Return mazes as text, row by row from the top.

    Args:
        tokens: (B, H, W), as from `maze_tokens`.
        line_end: what stands between two rows.
    """
    mazes = _BYTES[tokens]
    return [line_end.join(row.tobytes().decode() for row in maze) for maze in mazes]


def maze_text(
    sample: Sample, answer: Literal["cells", "moves", "letters"] = "cells"
) -> dict[str, str]:
    r"""Return a problem as ``prompt`` and ``answer``, for language models; a ``transform``.

    The prompt is H lines of W characters, joined by ``"\n"``: ``#`` occupied, a space for free,
    ``S`` start, ``G`` goal. If there is no path, the answer is ``infeasible``. Batches are dicts of
    lists of texts. `mapdata.formats.score_answer` scores an answer, which can be another shortest
    path than this one.

    Args:
        sample: of a dataset whose fields have ``map``, ``start``, ``goal`` and ``path``.
        answer: "cells" for the prompt with the cells of the path between start and goal marked by
            ``o``; "moves" for the words up, down, left and right, such as ``down left``; "letters"
            for their first letters, such as ``DL``. A dataset takes another one than "cells" as
            ``transform=functools.partial(maze_text, answer="moves")``.

    Raises:
        ValueError: one of the fields is missing; ``answer`` is none of these; the path is no
            shortest 4-connected path, as on maps with terrain or with diagonal moves, so that the
            answer would not be right; or start and goal are neighbours, so that the marked maze
            would be the prompt itself.

    >>> from mapdata import Maze, OnlineMapDataset
    >>> mazes = OnlineMapDataset(
    ...     Maze((7, 7)), seed=3, length=8, problems="random", transform=maze_text
    ... )
    >>> print(mazes[2]["answer"])
    #######
    # #   #
    #S###G#
    #ooooo#
    ##### #
    #     #
    #######
    """
    if not isinstance(sample, Sample):
        raise ValueError(f"maze_text: got {type(sample).__name__}, expected a sample of a dataset")
    if not set(_FIELDS) <= set(sample._fields):
        raise ValueError(
            f"maze_text: got samples of {', '.join(sample._fields)}; expected the fields "
            f"{', '.join(_FIELDS)}"
        )
    if sample.start.ndim > 1:
        raise ValueError(
            "maze_text: got a batch, expected one sample: give it to the dataset as transform=, "
            "or take dataset[0]"
        )
    check_choice("answer", answer, ("cells", "moves", "letters"))
    fields = {name: getattr(sample, name).numpy()[None] for name in _FIELDS}
    question_tokens = maze_tokens(fields, with_path=False)
    path = fields["path"][0]
    path = path[path[:, 0] != PADDING]
    ends = (fields["start"][0], fields["goal"][0])
    _check_shortest(question_tokens[0] == _WALL, path, ends)
    (prompt,) = maze_texts(question_tokens)
    if len(path) == 0:
        return {"prompt": prompt, "answer": INFEASIBLE}
    if answer == "cells":
        if len(path) == 2:
            raise ValueError(
                "maze_text: start and goal are neighbours, so no cell between them can be marked: "
                'expected longer paths, problems={"random": {"length": [3, None]}}, or '
                'answer="moves"'
            )
        (text,) = maze_texts(maze_tokens(fields, with_path=True))
    else:
        letters = letters_of_path(path)
        text = letters if answer == "letters" else words_of_letters(letters)
    return {"prompt": prompt, "answer": text}


def _check_shortest(is_occupied: Flags, path: Ints, ends: tuple[Ints, Ints]) -> None:
    """Refuse a problem whose path is no shortest 4-connected path between two cells.

    Args:
        is_occupied: (H, W).
        path: (k, 2); k is 0 if there is no path.
        ends: start and goal, (2,) each.

    Raises:
        ValueError: the message says what is wrong with the path.
    """
    min_move_count = astar(is_occupied, *ends).cost
    move_count = len(path) - 1
    if move_count == min_move_count != 0:
        return  # both are -1 where there is no path
    if move_count < 0:
        # The text shows S and G in place of occupied cells, and so a path between them.
        fault = (
            f"no path where {min_move_count:.0f} moves are enough (the start or the goal is "
            "occupied)"
        )
    elif move_count == 0:
        fault = "a path of 1 cell"
    elif (np.abs(np.diff(path, axis=0)).sum(axis=1) != 1).any():
        fault = "a path with diagonal moves"
    else:
        fault = f"a path of {move_count} moves where {min_move_count:.0f} are enough"
    raise ValueError(
        f"maze_text: got {fault}, expected a shortest 4-connected path between two cells, as of "
        "maps without terrain and with movement=Movement(4)"
    )
