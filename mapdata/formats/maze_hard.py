"""Mazes as text for sequence models, as in maze-30x30-hard-1k: a CSV for each split, in and out.

Source: https://huggingface.co/datasets/sapientinc/maze-30x30-hard-1k, which HRM
(https://arxiv.org/abs/2506.21734) and TRM (https://arxiv.org/abs/2510.04871) are trained on. After
a header each line has four columns:

| column | value |
|---|---|
| source | the origin of the maze, any text |
| question | the cells of a square map, row by row: "#" occupied, " " free, "S" start, "G" goal |
| answer | the same with "o" on the free cells of a shortest path, 4-connected |
| rating | how hard it is: here the moves of that path |
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import LIMITS, SPLIT_NAMES, Limits, check_file, files_with_endings
from mapdata.formats.maze_answers import is_shortest_answer
from mapdata.formats.maze_questions import parse_question
from mapdata.formats.registry import Format
from mapdata.movement import Movement
from mapdata.npy import FormatError

HEADER = "source,question,answer,rating"


def is_maze_hard(path: Path) -> bool:
    """Return whether a CSV begins with this format's header."""
    with path.open("rb") as file:
        return file.readline(100).strip().lower() == HEADER.encode()


def read(source: Path, limits: Limits = LIMITS) -> Collection:
    """Read a CSV, or all below a folder; train.csv, val.csv and test.csv are those splits.

    Start and goal become the seed points of a map.

    Raises:
        FormatError: ``source`` is not there. Lines that are no maze are left out.
    """
    collection = Collection(movement=Movement())
    for path in files_with_endings(source, (".csv",), limits, collection):
        split = SPLIT_NAMES.get(path.stem.lower())
        with collection.leaving_out(path):
            check_file(path, limits)
            with path.open(encoding="latin-1", newline="\n") as file:
                next(file, "")  # skip the header
                for number, line in enumerate(file, 2):
                    name = f"{path}, line {number}"
                    with collection.leaving_out(name):
                        collection.maps.append(_parse_maze(name, line, split, limits))
    return collection


def _parse_maze(name: str, line: str, split: int | None, limits: Limits) -> ForeignMap:
    """Return the map of a line; its check says whether the answer is a shortest path.

    Args:
        name: of the map, and of the line in errors.
        line: text of the line.
        split: code of the split; None to draw it.
        limits: of the number of cells.

    Raises:
        FormatError: the line is no maze.
    """
    fields = line.rsplit(",", 3)  # only the first column, the source, may hold a comma
    if len(fields) < 4 or len(fields[1]) > limits.pixels:
        raise FormatError(
            f"{name}: expected {HEADER} of at most {limits.pixels} cells; --max-pixels sets this "
            "limit"
        )
    _, question, answer, _ = fields
    try:
        parsed = parse_question(question)
    except FormatError as error:
        raise FormatError(f"{name}: {error}") from None
    ends = np.array([parsed.start, parsed.goal])
    # Between neighbours there is no cell to mark.
    are_neighbours = np.abs(ends[0] - ends[1]).sum() == 1
    is_right = answer == question if are_neighbours else is_shortest_answer(question, answer)
    wrong_labels = [] if is_right else ["answer"]
    return ForeignMap(
        name,
        parsed.is_occupied,
        split,
        seed_points=ends,
        rooms_known=True,
        check=lambda _labels, _number: wrong_labels,
    )


FORMAT = Format("maze-hard", (".csv",), read, recognises=is_maze_hard)
