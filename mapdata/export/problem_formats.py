"""The formats of exported problems: one record for each, which says what differs between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from mapdata.export.layouts import LAYOUTS, MAZE_FIELDS, Layout
from mapdata.export.maze_text import MazeTextWriter
from mapdata.export.parquet import ParquetWriter
from mapdata.export.writers import ArrayWriter, LayoutWriter, Writer
from mapdata.limits import SPLITS, Size
from mapdata.movement import Movement


class WriterTarget(NamedTuple):
    """What a writer needs to know before the first problem.

    Attributes:
        folder: an empty folder to write below.
        counts: number of problems of each split.
        map_size: rows and columns of all maps.
        movement: of the paths.
        max_length: rows of ``path``; None if paths are not padded.
    """

    folder: Path
    counts: dict[str, int]
    map_size: Size
    movement: Movement
    max_length: int | None


@dataclass(frozen=True)
class ProblemFormat:
    """What `export_problems` asks of a format.

    Attributes:
        name: as ``mapdata export --format`` takes it.
        new_writer: returns what writes the files.
        fields: fields of a dataset that the files are made of; None if the caller chooses them.
        splits: the splits that it has a place for.
        problems: which problems are drawn unless the caller says otherwise.
        movement: default rule of moves; None for that of the source.
        has_terrain: True for maps with terrain alone, False for maps without; None for both.
        is_one_file: whether one file holds all splits.
        has_maze_labels: whether its paths follow the rule of maze-30x30-hard-1k, which is one of
            square maps and four moves, and no search.
        pads_paths: whether ``max_length`` pads paths.
        has_card: whether a card is written, which states a licence.
        max_batch: how many problems are turned into rows at once.
    """

    name: str
    new_writer: Callable[[WriterTarget], Writer]
    fields: tuple[str, ...] | None = None
    splits: tuple[str, ...] = SPLITS
    problems: str = "route"
    movement: Movement | None = None
    has_terrain: bool | None = None
    is_one_file: bool = False
    has_maze_labels: bool = False
    pads_paths: bool = False
    has_card: bool = False
    max_batch: int = 4096

    @property
    def needs_paths(self) -> bool:
        """Whether its loaders take each problem to have a path."""
        return self.fields is not None


def _format_of(layout: Layout) -> ProblemFormat:
    """Return the record of a layout of another repository."""
    return ProblemFormat(
        name=layout.name,
        new_writer=lambda target: LayoutWriter(target.folder, layout, target.movement),
        fields=layout.fields,
        splits=tuple(layout.splits),
        problems=layout.problems,
        movement=layout.movement,
        has_terrain=layout.has_terrain,
        is_one_file=bool(layout.archive),
        has_maze_labels=layout.fields == MAZE_FIELDS,
        max_batch=layout.max_batch,
    )


FORMATS: dict[str, ProblemFormat] = {
    record.name: record
    for record in (
        ProblemFormat(
            name="arrays",
            new_writer=lambda target: ArrayWriter(target.folder, target.max_length),
            pads_paths=True,
        ),
        ProblemFormat(
            name="parquet",
            new_writer=lambda target: ParquetWriter(target.folder, target.counts, target.map_size),
            has_card=True,
        ),
        ProblemFormat(
            name="maze-hard",
            new_writer=lambda target: MazeTextWriter(target.folder),
            fields=MAZE_FIELDS,
            problems="random",
            movement=Movement(4),
            has_terrain=False,
            has_maze_labels=True,
        ),
        *map(_format_of, LAYOUTS.values()),
    )
}
"""All formats of problems by name; `mapdata.limits.PROBLEM_FORMATS` has their names."""
