"""The verb ``mapdata export``: maps with their stored routes, or training problems."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from mapdata.problems import Random


def export_command(
    source: list[str],
    target: str,
    *,
    fields: str | None = None,
    split: Literal["train", "val", "test"] | None = None,
    count: int | None = None,
    problems: str | None = None,
    distance: str | None = None,
    hardness: str | None = None,
    length: str | None = None,
    search: Literal["astar", "bfs"] = "astar",
    connectivity: Literal[4, 8] | None = None,
    corner_cutting: bool = False,
    diagonal_cost: float | None = None,
    radius: float = 0.0,
    augment: bool = False,
    max_length: int | None = None,
    seed: int | None = None,
    sampling_seed: int = 0,
    distinct: bool = False,
    licence: str | None = None,
    follow_links: bool = False,
    **options: Any,
) -> None:
    """Write training problems, or maps with their stored routes, for other programs.

    The formats of problems are arrays (one .npy for each split and field), parquet (one row for
    each problem, for Hugging Face datasets), maze-hard (text), and transpath, gppn, vin, hrm (also
    for TRM) and warcraft (also for PyEPO), whose files the loaders of these projects read. The
    formats of maps are paper, movingai, ros and planning-datasets. Only arrays, parquet and
    warcraft accept maps with terrain.

    Examples:
      mapdata export noise30 data/hrm --format hrm --length 110: --count 1000
      mapdata export dungeon data/set --format arrays --problems random --count 10000
      mapdata export tiles data/tiles --format warcraft --count 1000
      mapdata export data/maps data/hub --format parquet --licence cc-by-4.0
      mapdata export data/maps release --format paper

    Args:
        source: folder or URL of a dataset, or several; for problems also a preset, a recipe or a
            file of problems (.npz that ProblemSet.save wrote, .scen)
        target: new folder; for planning-datasets a new .npz file
        fields: names of fields, separated by commas (default: map,start,goal,path,cost)
        split: export only this split
        count: number of problems of each split (default: all; for a preset, one on each of its
            10,000 maps)
        problems: route, pairs or random, or JSON (default: the choice of the repository whose
            layout is written, otherwise route; random with --distance, --hardness or --length)
        distance: optimal cost of random problems, in cells, as MIN:MAX; either may be left out
        hardness: optimal cost / heuristic of random problems, as MIN:MAX
        length: number of cells of the path of random problems, as MIN:MAX
        search: search whose shortest paths are written
        connectivity: 4-connected or 8-connected movement (default: the rule of the repository whose
            layout is written, otherwise the stored one)
        corner_cutting: allow diagonal moves beside occupied cells
        diagonal_cost: cost of a diagonal move: 1 or 1.41421356
        radius: radius of the robot, in metres
        augment: rotate and mirror the training samples at random
        max_length: number of cells to which paths are padded; for arrays only
        seed: seed of the maps of a preset or recipe
        sampling_seed: seed of random problems and of --augment
        distinct: leave out the problems on copies of earlier maps of any split, also turned and
            reflected ones
        licence: licence for the card of parquet, as the Hugging Face Hub spells it
        follow_links: read files of the dataset that are links out of their folder
        **options: those of the formats of maps
    """
    from mapdata.cli.convert import movement_of_flags, unprefixed_options
    from mapdata.export import export_problems
    from mapdata.formats import export
    from mapdata.limits import PROBLEM_FORMATS

    name = options.pop("format")
    movement = movement_of_flags(connectivity, corner_cutting, diagonal_cost)
    bands = {"distance": distance, "hardness": hardness, "length": length}
    arguments: dict[str, Any] = {
        "fields": None if fields is None else tuple(fields.split(",")),
        "split": split,
        "count": count,
        "problems": problems_of_flags(problems, bands),
        "search": search,
        "movement": movement,
        "radius": radius,
        "augment": augment,
        "max_length": max_length,
        "seed": seed,
        "sampling_seed": sampling_seed,
        "distinct": distinct,
        "licence": licence,
    }
    if name in PROBLEM_FORMATS:
        unprefixed_options(name, options)  # refuses those of formats of maps
        origin = source[0] if len(source) == 1 else source
        notes = export_problems(
            origin, target, format=name, follow_links=follow_links, progress=True, **arguments
        )
    else:
        _refuse_problem_flags(name, arguments)
        format_options = unprefixed_options(name, options)
        notes = export(
            source, target, name, follow_links=follow_links, progress=True, **format_options
        )
    for note in notes:
        print(f"note: {note}")
    print(f"wrote {Path(target)}")


def problems_of_flags(problems: str | None, bands: dict[str, str | None]) -> Random | str | None:
    """Return the problems that the flags ask for; None if they say nothing.

    Raises:
        ValueError: a band that is not MIN:MAX, or beside problems that are not random or have a
            band of this name.
    """
    from mapdata.problems import Random
    from mapdata.problems.sources import problem_source

    limits: dict[str, Any] = {
        name: band_of(f"--{name}", text) for name, text in bands.items() if text is not None
    }
    if not limits:
        return problems
    source = problem_source("random" if problems is None else problems)
    flags = ", ".join(f"--{name}" for name in limits)
    if not isinstance(source, Random):
        raise ValueError(f"{flags}: only for random problems, got --problems {problems}")
    for name in limits:
        if getattr(source, name) is not None:
            raise ValueError(f"--{name}: --problems has a band of this name, too; give one of them")
    return replace(source, **limits)


def band_of(flag: str, text: str) -> tuple[float | None, float | None]:
    """Return (min, max) of a text MIN:MAX; a side that is left out is None.

    Raises:
        ValueError: the text is something else.
    """
    from mapdata.problems.sources import check_band

    sides = text.split(":")
    try:
        if len(sides) == 2:
            smallest, largest = (float(side) if side else None for side in sides)
            check_band(flag, (smallest, largest))
            return smallest, largest
    except ValueError:
        pass
    raise ValueError(
        f"{flag}: got {text!r}, expected MIN:MAX with MIN at most MAX, such as 110:, 5:20 or :30"
    )


def _refuse_problem_flags(name: str, arguments: dict[str, Any]) -> None:
    """Refuse what a format of maps has no use for.

    Raises:
        ValueError: the message names the first flag.
    """
    defaults = {
        "search": "astar",
        "radius": 0.0,
        "augment": False,
        "sampling_seed": 0,
        "distinct": False,
    }
    for argument, setting in arguments.items():
        if setting != defaults.get(argument):
            flag = "connectivity" if argument == "movement" else argument.replace("_", "-")
            raise ValueError(
                f"--{flag}: does nothing for format {name}, which holds maps with their stored "
                "routes"
            )


def add_export_flags(parser: argparse.ArgumentParser) -> None:
    """Add ``--format``, and the flags that the formats of maps bring."""
    from mapdata.cli.convert import add_format_options
    from mapdata.formats.registry import functions_by_format
    from mapdata.limits import PROBLEM_FORMATS

    formats = functions_by_format("write")
    names = [*PROBLEM_FORMATS, *(name for name in formats if name not in PROBLEM_FORMATS)]
    parser.add_argument("--format", choices=names, required=True, help="format to write")
    add_format_options(parser, formats)
