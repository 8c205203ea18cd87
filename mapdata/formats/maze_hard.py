"""Mazes as text for sequence models, as maze-30x30-hard-1k has them: a CSV a split, in and out.

Source: https://huggingface.co/datasets/sapientinc/maze-30x30-hard-1k, which HRM
(https://arxiv.org/abs/2506.21734) and TRM (https://arxiv.org/abs/2510.04871) are trained on. After
a header each line has four columns:

| column | value |
|---|---|
| source | where the maze comes from |
| question | the cells of a square map, row by row: "#" occupied, " " free, "S" start, "G" goal |
| answer | the same with "o" on the free cells of a shortest path, 4-connected |
| rating | how hard it is: here the moves of that path |
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import LIMITS, SPLIT_NAMES, FormatError, Limits, files_of
from mapdata.formats.registry import Format
from mapdata.search.api import distance_field
from mapdata.search.labels import Labels
from mapdata.shards.root import Root
from mapdata.spec import SPLITS, Movement

HEADER = "source,question,answer,rating"

_OCCUPIED, _FREE, _START, _GOAL, _PATH = np.frombuffer(b"# SGo", np.uint8)


def is_maze_hard(path: Path) -> bool:
    """Return whether a CSV begins with this format's header."""
    with path.open("rb") as file:
        return file.readline(100).strip().lower() == HEADER.encode()


def read(source: Path, limits: Limits = LIMITS) -> Collection:
    """Read a CSV, or all below a folder; train.csv, val.csv and test.csv are those splits.

    Start and goal become the seed points of a map.

    Raises:
        FormatError: ``source`` is no such file. Lines that are no maze are left out.
    """
    found = Collection(movement=Movement())
    for path in files_of(source, (".csv",), limits, found.left_out):
        if not is_maze_hard(path):
            raise FormatError(f"{path}: expected the header {HEADER}")
        split = SPLIT_NAMES.get(path.stem.lower())
        with path.open("rb") as file:
            file.readline()
            for number, line in enumerate(file, 2):
                name = f"{path}, line {number}"
                with found.leaving_out(name):
                    found.maps.append(_maze(name, line, split, limits))
    return found


def _maze(name: str, line: bytes, split: int | None, limits: Limits) -> ForeignMap:
    """Return the map of a line.

    Raises:
        FormatError: it is none.
    """
    fields = line.rstrip(b"\r\n").rsplit(b",", 3)  # only a source may hold a comma
    if len(fields) < 4 or len(fields[1]) > limits.pixels:
        raise FormatError(f"{name}: expected {HEADER} of at most {limits.pixels} cells")
    _, question, answer, _ = (field.decode("latin-1") for field in fields)
    if set(question) - set("# SG") or question.count("S") != 1 or question.count("G") != 1:
        raise FormatError(f"{name}: expected cells '#' and ' ', one S and one G")
    cells = _cells(question)
    start_and_goal = [np.argwhere(cells == end)[0] for end in (_START, _GOAL)]
    return ForeignMap(
        name,
        (cells == _OCCUPIED).astype(np.uint8),
        split,
        seed_points=np.stack(start_and_goal),
        rooms_known=True,
        check=partial(_differing, question, answer),
    )


def _differing(question: str, answer: str, _labels: Labels, _number: int) -> list[str]:
    return [] if is_shortest_answer(question, answer) else ["answer"]


def is_shortest_answer(question: str, answer: str) -> bool:
    """Return whether an answer marks a shortest path: any of them, not only the one in the file.

    Most problems have many shortest paths, and a model that finds another one than the file's is
    right, too.

    Args:
        question: the cells of a square map, row by row, with one S and one G.
        answer: of a model; all but the cells that it marks with "o" must be as in the question.

    >>> answers = ("Soo #o  G", "S  o# ooG", "S   #   G")
    >>> [is_shortest_answer("S   #   G", answer) for answer in answers]
    [True, True, False]
    """
    if answer.replace("o", " ") != question:
        return False
    cells = _cells(answer)
    start, goal = (tuple(np.argwhere(cells == end)[0].tolist()) for end in (_START, _GOAL))
    distances = distance_field(cells == _OCCUPIED, start)
    path = np.argwhere((cells == _PATH) | (cells == _START) | (cells == _GOAL))
    moves = distances[tuple(path.T)]
    order = np.argsort(moves)
    # One cell at each distance from the start, each beside the next, and the goal is the last.
    steps = np.abs(np.diff(path[order], axis=0)).sum(axis=1)
    if not np.array_equal(moves[order], np.arange(len(path))) or (steps != 1).any():
        return False
    return bool(distances[goal] == len(path) - 1)


def _cells(text: str) -> Bytes:
    """Return the characters of a square map, (side, side).

    Raises:
        FormatError: their number is not a square.
    """
    side = math.isqrt(len(text))
    if side == 0 or side * side != len(text):
        raise FormatError(f"got {len(text)} cells, expected a square map")
    return np.frombuffer(text.encode("latin-1"), np.uint8).reshape(side, side)


def write(target: Path, root: Root, progress: bool) -> list[str]:
    """Write train.csv, val.csv and test.csv: a line for each segment of a route that has a path.

    Raises:
        ValueError: maps that are not square, or diagonal moves.
    """
    rows, columns = root.map_size
    if rows != columns or root.movement.connectivity != 4:
        raise ValueError(
            f"maze-hard: got maps of {rows} x {columns} cells and {root.movement}, expected square "
            "maps and 4-connected paths"
        )
    target.mkdir()
    with ExitStack() as opened:
        files = []
        for split in SPLITS:
            file = opened.enter_context((target / f"{split}.csv").open("w", newline="\n"))
            print(HEADER, file=file)
            files.append(file)
        for labels in root.labels(progress=progress):
            for k, code in enumerate(labels.maps.split):
                files[code].writelines(_lines(labels, k))
    return []


def _lines(labels: Labels, k: int) -> Iterator[str]:
    """Yield the lines of map ``k`` of a batch."""
    empty = np.where(labels.maps.occupancy[k], _OCCUPIED, _FREE)
    for path in labels.route("astar", k):
        if len(path) < 2:  # no path, or two seed points in one cell
            continue
        question = _marked(empty, path[[0]], _START)
        question = _marked(question, path[[-1]], _GOAL)
        answer = _marked(question, path[1:-1], _PATH)
        texts = (question.tobytes().decode(), answer.tobytes().decode())
        yield f"map{labels.maps.index[k]},{texts[0]},{texts[1]},{len(path) - 1}\n"


def _marked(cells: Bytes, path: Ints, letter: np.uint8) -> Bytes:
    marked = cells.copy()
    marked[tuple(path.T)] = letter
    return marked


FORMAT = Format("maze-hard", (".csv",), read, write, is_mine=is_maze_hard)
