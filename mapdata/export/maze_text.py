"""Mazes as lines of text, as maze-30x30-hard-1k has them: a CSV for each split.

Source: https://huggingface.co/datasets/sapientinc/maze-30x30-hard-1k.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mapdata.datasets.text import maze_texts, maze_tokens
from mapdata.export.layouts import Columns, with_first_optimal_paths
from mapdata.limits import Size
from mapdata.shards.files import file_hash

HEADER = "source,question,answer,rating"


class MazeTextWriter:
    """Writes ``SPLIT.csv``, with a line for each problem.

    The columns are the source ("problem" and its number), the question (the cells of the map row by
    row: "#" occupied, " " free, "S" start, "G" goal), the answer (the same with "o" on the
    shortest path of the set's rule, `first_optimal_paths`) and the rating (moves of the path).
    """

    def __init__(self, folder: Path) -> None:
        """Write to ``folder``, which exists."""
        self._folder = folder
        self._lines: dict[str, int] = {}

    def write(self, split: str, columns: Columns) -> None:
        """Write the fields of the next B problems of a split."""
        with (self._folder / f"{split}.csv").open("a", newline="\n") as file:
            if split not in self._lines:
                self._lines[split] = 0
                print(HEADER, file=file)
            fields = with_first_optimal_paths(columns)
            moves = (fields["path"][:, :, 0] >= 0).sum(axis=1) - 1
            questions = maze_texts(maze_tokens(fields, with_path=False), line_end="")
            answers = maze_texts(maze_tokens(fields, with_path=True), line_end="")
            for question, answer, rating in zip(questions, answers, moves.tolist(), strict=True):
                number = self._lines[split]
                print(f"problem{number},{question},{answer},{rating}", file=file)
                self._lines[split] += 1

    def finish(self, counts: dict[str, int], map_size: Size) -> dict[str, Any]:
        """Return the checksum of each file, by its name."""
        names = [f"{split}.csv" for split in counts]
        return {name: {"sha256": file_hash(self._folder / name)} for name in names}

    def abort(self) -> None:
        """Nothing is open between batches."""
