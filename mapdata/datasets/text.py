"""Mazes as text and as tokens, for models that read sequences."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mapdata.arrays import Array, Bytes, Flags, Ints
from mapdata.datasets.field_kernels import PADDING
from mapdata.datasets.sample import Sample
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


def maze_texts(tokens: Bytes, line_end: str = "\n") -> list[str]:
    """Return mazes as text, row by row from the top.

    Args:
        tokens: (B, H, W), as from `maze_tokens`.
        line_end: what stands between two rows.
    """
    mazes = _BYTES[tokens]
    return [line_end.join(row.tobytes().decode() for row in maze) for maze in mazes]


def maze_text(sample: Sample) -> dict[str, str]:
    r"""Return a problem as ``prompt`` and ``answer``, for language models; a ``transform``.

    Both are H lines of W characters, joined by ``"\n"``: ``#`` occupied, a space for free, ``S``
    start, ``G`` goal. The answer marks the cells of the path between them with ``o``. Batches are
    dicts of lists of texts. `mapdata.formats.is_shortest_answer` says whether an answer is right,
    which can be another shortest path than this one.

    Args:
        sample: of a dataset whose fields have ``map``, ``start``, ``goal`` and ``path``.

    Raises:
        ValueError: one of these fields is missing; or the path is no shortest 4-connected path, as
            on maps with terrain or with diagonal moves, so that the answer would not be right.

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
    if not set(_FIELDS) <= set(sample._fields):
        raise ValueError(
            f"maze_text: got samples of {', '.join(sample._fields)}; expected the fields "
            f"{', '.join(_FIELDS)}"
        )
    fields = {name: getattr(sample, name).numpy()[None] for name in _FIELDS}
    question_tokens = maze_tokens(fields, with_path=False)
    _check_shortest(question_tokens[0] == _WALL, fields["path"][0])
    (prompt,) = maze_texts(question_tokens)
    (answer,) = maze_texts(maze_tokens(fields, with_path=True))
    return {"prompt": prompt, "answer": answer}


def _check_shortest(is_occupied: Flags, path: Ints) -> None:
    """Refuse a problem whose path is no shortest 4-connected path between two cells.

    Args:
        is_occupied: (H, W).
        path: (T, 2), padded with -1.

    Raises:
        ValueError: the message says what is wrong with the path.
    """
    cells = path[path[:, 0] != PADDING]
    move_count = len(cells) - 1
    if move_count < 1:
        fault = f"a path of {len(cells)} cells"
    elif (np.abs(np.diff(cells, axis=0)).sum(axis=1) != 1).any():
        fault = "a path with diagonal moves"
    else:
        min_move_count = astar(is_occupied, cells[0], cells[-1]).cost
        if move_count == min_move_count:
            return
        fault = f"a path of {move_count} moves where {min_move_count:.0f} are enough"
    raise ValueError(
        f"maze_text: got {fault}, expected a shortest 4-connected path between two cells, as of "
        "maps without terrain and with movement=Movement(4)"
    )
