"""The verbs ``mapdata import`` and ``mapdata check-scen``.

The options of the formats are the keyword-only parameters of their functions, spelled
``--<format>.<option>``.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

from mapdata.cli.common import DisagreeError, add_flag, one_line, summary

if TYPE_CHECKING:
    from mapdata.movement import Movement

_IMPORT_OPTIONS = ("seed_points", "seed", "tile", "resolution", "shard_size", "drop_leaks")
"""The options of `import_maps` that are flags of all formats."""

_MAX_LEFT_OUT = 10
"""Maximal number of files, maps or tiles that an import names among those that it leaves out."""


def import_command(
    src: str,
    root: str,
    *,
    connectivity: Literal[4, 8] | None = None,
    corner_cutting: bool = False,
    diagonal_cost: float | None = None,
    max_pixels: int = 2**24,
    follow_links: bool = False,
    **options: Any,
) -> None:
    """Make a dataset from maps in a foreign format, with seed points and all labels.

    Examples:
      mapdata import plans/ data/plans --seed-points 6
      mapdata import map.yaml data/site --tile 64x64 --ros.unknown occupied
      mapdata import maze.map data/maze --format movingai --connectivity 8
      mapdata import warcraft/12x12 data/warcraft

    Args:
        src: file or folder with the maps
        root: folder of the dataset; if maps have several sizes, each size gets a folder below it
        connectivity: 4-connected or 8-connected movement (default: the rule of the format, or 4)
        corner_cutting: allow diagonal moves beside occupied cells
        diagonal_cost: cost of a diagonal move: 1 or 1.41421356
        max_pixels: largest number of pixels or cells of a map; larger maps are refused
        follow_links: read files and folders that are links out of SRC; only for folders of your own
        **options: those of `import_maps` and of the formats
    """
    from mapdata.checks import check_count
    from mapdata.formats import Limits, import_maps, read_any
    from mapdata.formats.registry import checked_function, recognise
    from mapdata.options import options_of

    movement = movement_of_flags(connectivity, corner_cutting, diagonal_cost)
    check_count("--max-pixels", max_pixels)
    limits = Limits(pixels=max_pixels, follow_links=follow_links, progress=True)
    format_name = options.pop("format") or recognise(src, limits)
    import_options = {name: options.pop(name) for name in _IMPORT_OPTIONS}
    format_options = unprefixed_options(format_name, options)
    # Options such as --resolution and --seed-points also go to a format that knows them.
    for name in options_of(checked_function("read", format_name, {})):
        if name in import_options:
            format_options[name] = import_options[name]
    collection = read_any(src, format_name, limits, **format_options)
    datasets = []
    try:
        datasets = import_maps(root, collection, movement=movement, progress=True, **import_options)
    finally:
        # If the only map was left out, the error itself says why.
        if datasets or len(collection.left_out) > 1:
            for name, reason in collection.left_out[:_MAX_LEFT_OUT]:
                print(f"left out: {name}: {' '.join(reason.split())}", file=sys.stderr)
            more = len(collection.left_out) - _MAX_LEFT_OUT
            if more > 0:
                print(f"left out: {more:,} more, {more + _MAX_LEFT_OUT:,} in all", file=sys.stderr)
    for note in dict.fromkeys(collection.notes):
        print(f"note: {note}")
    if len(datasets) == 1:
        print(summary(str(datasets[0].root), datasets[0].manifest))
    else:
        for dataset in datasets:
            print(one_line(str(dataset.root), dataset.manifest))
        print(
            f"{len(datasets):,} datasets, one for each size and resolution: 'mapdata info' tells "
            "more of each"
        )
    checked = sum(dataset.checked for dataset in datasets)
    if checked:
        print(f"labels compared with the source: {checked:,} maps")
    disagreements = Counter[str]()
    for dataset in datasets:
        disagreements.update(dataset.disagreements)
    for column, count in sorted(disagreements.items()):
        print(f"  {column}: {count:,} disagree")


def unprefixed_options(format_name: str, options: dict[str, Any]) -> dict[str, Any]:
    """Return the options of a format without the prefix ``<format>.`` of their flags.

    Raises:
        ValueError: an option of another format.
    """
    prefix = f"{format_name}."
    for name in options:
        if not name.startswith(prefix):
            raise ValueError(f"--{name}: does nothing for format {format_name}")
    return {name.removeprefix(prefix): value for name, value in options.items()}


def movement_of_flags(
    connectivity: int | None, corner_cutting: bool, diagonal_cost: float | None
) -> Movement | None:
    """Return the movement that the flags describe; None without ``--connectivity``.

    Raises:
        ValueError: flags of diagonal moves without ``--connectivity``, or that do not fit to it.
    """
    from mapdata.movement import Movement

    if connectivity is None:
        if corner_cutting or diagonal_cost is not None:
            raise ValueError("--corner-cutting and --diagonal-cost: need --connectivity 8")
        return None
    if diagonal_cost is None:
        return Movement(connectivity, corner_cutting)
    return Movement(connectivity, corner_cutting, diagonal_cost)


def check_scen_command(
    file: list[str], *, maps: str | None = None, follow_links: bool = False
) -> None:
    """Solve the problems of .scen files; exit with code 1 if a published length is not optimal.

    If all lengths of a file are 0, it states no lengths, and none are compared. A file that cannot
    be read does not stop the command: the error is printed at the end, and the exit code is 2.

    Examples:
      mapdata check-scen arena.map.scen --maps maps/

    Args:
        file: .scen files
        maps: folder of the maps (default: the folder of each .scen file)
        follow_links: read maps that are links out of their folder; only for folders of your own
    """
    from mapdata.formats import FormatError, Limits
    from mapdata.formats.movingai import check_scen

    disagreements = 0
    total = 0
    unreadable = []
    limits = Limits(follow_links=follow_links, progress=True)
    for name in file:
        try:
            report = check_scen(name, maps, limits)
        except (ValueError, OSError) as error:  # an OSError, if the name is too long
            unreadable.append(str(error))
            continue
        if report.has_lengths:
            print(f"{name}: {report.agreed:,} of {report.total:,} optimal lengths agree")
        else:
            print(
                f"{name}: optimal lengths are not given, all are 0; {len(report.solved):,} of "
                f"{report.total:,} problems have a path"
            )
        for line in report.disagreements[:20]:
            print(line)
        if len(report.disagreements) > 20:
            print(f"{name}: and {len(report.disagreements) - 20} more")
        if report.hint:
            print(report.hint)
        disagreements += len(report.disagreements)
        total += report.total
    if disagreements:
        message = f"{disagreements} of {total} optimal lengths disagree"
        raise DisagreeError("; ".join([message, *unreadable]))
    if unreadable:
        raise FormatError("; ".join(unreadable))


# --- flags --------------------------------------------------------------------------------------


def add_import_flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``mapdata import`` for the options of `import_maps` and of all formats."""
    from mapdata.formats.importing import import_maps
    from mapdata.formats.registry import FORMATS, functions_by_format
    from mapdata.options import options_of

    formats = functions_by_format("read")
    explained = [name for name, known in FORMATS.items() if known.why_unread]
    parser.add_argument(
        "--format",
        choices=[*formats, *explained],
        help="format of SRC (default: recognised by its files)",
    )
    options = options_of(import_maps)
    for name in _IMPORT_OPTIONS:
        add_flag(parser, name, options[name], options[name].default)
    add_format_options(parser, formats)


def add_format_options(
    parser: argparse.ArgumentParser, formats: dict[str, Callable[..., Any]]
) -> None:
    """Add the options of each format as flags, in a group under its name.

    The parser returns only the options that are set.

    Args:
        parser: of the verb.
        formats: the function that reads or writes each format, by the format's name.
    """
    from mapdata.options import options_of, summary_line

    for format_name, function in formats.items():
        options = {
            name: option
            for name, option in options_of(function).items()
            if name not in _IMPORT_OPTIONS
        }
        if options:
            description = summary_line(function).replace("``", "")
            group = parser.add_argument_group(format_name, description)
            for name, option in options.items():
                add_flag(group, f"{format_name}.{name}", option, argparse.SUPPRESS)
