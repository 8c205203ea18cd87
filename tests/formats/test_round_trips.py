"""Out and in is the same: what a format writes, it reads as the maps that were exported."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import pytest
from helpers.builds import Built
from helpers.wild import cli

from mapdata import MapGenerator, MapSpec, Maze, Movement, Terrain
from mapdata.export import PROBLEM_FORMATS
from mapdata.formats import import_maps, read_any
from mapdata.formats.registry import FORMATS, functions_by_format, recognise
from mapdata.limits import SPLITS
from mapdata.movement import NEURAL_ASTAR
from mapdata.shards import Root

MAPS = 12
HALVES: tuple[float, float, float] = (0.5, 0.25, 0.25)
WARCRAFT = Movement(8, corner_cutting=True, diagonal_cost=1.0)
ROOMS = MapSpec(
    (12, 20),
    (2, 5),
    (2, 5),
    (2, 7),
    passage_width=(1, 2),
    skip_probability=0.4,
    resolution=0.25,
    splits=HALVES,
)
"""Some rooms have no path to the next one."""
MAZES = Maze((9, 9), reopened=0.2, seed_points=2, splits=HALVES)
CORNERS = Terrain((6, 7), obstacles=0.0, corners=True, movement=WARCRAFT, splits=HALVES)

Cells: TypeAlias = list[list[int]]


@dataclass(frozen=True)
class Row:
    """How the maps of a format go out and in.

    Attributes:
        format: its name.
        source: the generator of the maps.
        seed_points: which seed points of a map come back, and in which order.
        flags: of the export.
        options: of the reading.
        movement: that the files stand for; None if they state none.
        resolution: that the files state.
        has_answers: whether an import compares paths of the files with its own.
        says: a note of the reading.
    """

    format: str
    source: MapGenerator
    seed_points: Callable[[Cells], Cells]
    flags: tuple[str, ...] = ()
    options: dict[str, Any] = field(default_factory=dict)
    movement: Movement | None = None
    resolution: float | None = None
    has_answers: bool = False
    says: str = ""


def none(_: Cells) -> Cells:
    """Return no seed points: the format has no place for them."""
    return []


def distinct(cells: Cells) -> Cells:
    """Return each seed point once."""
    return [cell for k, cell in enumerate(cells) if cell not in cells[:k]]


ROUTE = ("--problems", "route")
ROWS = {
    "movingai": Row("movingai", ROOMS, distinct, options={"scen": True}, movement=Movement(8)),
    "ros, pgm": Row("ros", ROOMS, none, resolution=0.25),
    "ros, png": Row("ros", ROOMS, none, ("--ros.image", "png"), resolution=0.25),
    "ros, bmp": Row("ros", ROOMS, none, ("--ros.image", "bmp"), resolution=0.25),
    "planning-datasets": Row(
        "planning-datasets",
        ROOMS,
        lambda cells: cells[:1],
        movement=NEURAL_ASTAR,
        says=f"distances of {MAPS} of {MAPS} maps are what our search finds",
    ),
    "maze-hard": Row("maze-hard", MAZES, list, ROUTE, movement=Movement(4), has_answers=True),
    "transpath": Row(
        "transpath",
        MAZES,
        lambda cells: cells[::-1],
        ROUTE,
        movement=Movement(8, corner_cutting=True),
    ),
    "warcraft": Row("warcraft", CORNERS, list, ROUTE, movement=WARCRAFT, has_answers=True),
}


def test_every_format_that_is_written_and_read_has_a_row() -> None:
    """A new format gets one above."""
    written = {*functions_by_format("write"), *PROBLEM_FORMATS}
    assert {row.format for row in ROWS.values()} == written & functions_by_format("read").keys()


def contents(target: Path) -> dict[str, bytes]:
    """Return the files of an export by their paths below it."""
    paths = target.rglob("*") if target.is_dir() else [target]
    return {str(path.relative_to(target)): path.read_bytes() for path in paths if path.is_file()}


@pytest.mark.parametrize("name", ROWS)
def test_out_and_in_is_the_same(
    name: str, built: Built, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Equal exports have equal bytes; each split has its maps again, in their order, with all that
    the format holds of them.
    """
    row = ROWS[name]
    root = built(row.source, maps=MAPS, seed=5, shard_size=8)
    ending = FORMATS[row.format].target_ending
    one, other = tmp_path / f"one{ending}", tmp_path / f"other{ending}"
    for target in (one, other):
        assert cli(capsys, "export", root, target, "--format", row.format, *row.flags)[0] == 0
    assert contents(one) == contents(other)
    assert recognise(one) == row.format

    expected = defaultdict(list)
    for labels in Root.open(root).labels():
        maps = labels.maps
        for k in range(len(maps)):
            seed_points = row.seed_points(maps.seed_points[k, : maps.rooms[k]].tolist())
            terrain = None if maps.terrain is None else maps.terrain[k].tolist()
            record = (maps.occupancy[k].tolist(), terrain, seed_points, row.resolution)
            expected[int(maps.split[k])].append(record)
    assert len(expected) == len(SPLITS)
    collection = read_any(one, **row.options)
    found = defaultdict(list)
    for each in collection.maps:
        assert each.split is not None
        terrain = None if each.terrain is None else each.terrain.tolist()
        record = (each.grid.tolist(), terrain, each.seed_points.tolist(), each.resolution)
        found[each.split].append(record)
    assert found == expected
    assert collection.left_out == []
    assert collection.movement == row.movement
    assert row.says in "\n".join(collection.notes)
    (back,) = import_maps(tmp_path / "back", collection)
    assert (back.checked, back.disagreements) == (MAPS if row.has_answers else 0, {})
