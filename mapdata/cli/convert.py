"""The verbs ``mapdata import``, ``mapdata export`` and ``mapdata check-scen``.

The options of the formats are the keyword-only parameters of their functions, spelled
``--<format>.<option>``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

from mapdata.cli.common import DisagreeError, add_flag, summary

if TYPE_CHECKING:
    from mapdata.movement import Movement

_OF_IMPORTS = ("seed_points", "seed", "tile", "resolution", "shard_size", "drop_leaks")
"""Parameters of `import_maps` that are flags, whatever the format."""


def import_command(
    src: str,
    root: str,
    *,
    connectivity: Literal[4, 8] | None = None,
    corner_cutting: bool = False,
    diagonal_cost: float | None = None,
    max_pixels: int = 2**24,
    **options: Any,
) -> None:
    """Make a dataset of maps in a foreign format, with drawn seed points and all labels.

    Examples:
      mapdata import plans/ data/plans --seed-points 6
      mapdata import map.yaml data/site --tile 64x64 --ros.unknown occupied
      mapdata import maze.map data/maze --format movingai --connectivity 8

    Args:
        src: file or folder
        root: folder of the dataset; with maps of several sizes, one below it for each
        connectivity: how paths move (default: the format's rule, else 4)
        corner_cutting: diagonal moves beside occupied cells too
        diagonal_cost: 1 or 1.41421356
        max_pixels: refuse larger pictures and maps
        **options: those of `import_maps` and of the formats
    """
    from mapdata.checks import check_count
    from mapdata.formats import Limits, import_maps, read_any, recognise
    from mapdata.formats.registry import functions_by_format
    from mapdata.options import options_of

    movement = _movement(connectivity, corner_cutting, diagonal_cost)
    check_count("--max-pixels", max_pixels)
    name = options.pop("format") or recognise(src)
    of_import = {key: options.pop(key) for key in _OF_IMPORTS}
    of_format = _own_options(name, options)
    for key in options_of(functions_by_format("read")[name]).keys() & of_import:
        of_format[key] = of_import[key]
    found = read_any(src, name, Limits(pixels=max_pixels, progress=True), **of_format)
    made = []
    try:
        made = import_maps(root, found, movement=movement, progress=True, **of_import)
    finally:
        if made or len(found.left_out) > 1:  # the error tells of a single one
            for what, why in found.left_out:
                print(f"left out: {what}: {' '.join(why.split())}", file=sys.stderr)
    for note in dict.fromkeys(found.notes):
        print(f"note: {note}")
    for one in made:
        print(summary(str(one.root), one.manifest))
        if one.checked:
            print(f"labels compared with the source: {one.checked:,} maps")
        for column, count in sorted(one.disagreements.items()):
            print(f"  {column}: {count:,} disagree")


def _own_options(name: str, options: dict[str, Any]) -> dict[str, Any]:
    """Return the options of a format, without its name in theirs.

    Raises:
        ValueError: one is of another format.
    """
    for key in options:
        if not key.startswith(f"{name}."):
            raise ValueError(f"--{key}: does nothing for format {name}")
    return {key.removeprefix(f"{name}."): value for key, value in options.items()}


def _movement(
    connectivity: int | None, corner_cutting: bool, diagonal_cost: float | None
) -> Movement | None:
    """Return the movement that the flags say, None if they say nothing."""
    from mapdata.movement import Movement

    if connectivity is None:
        if corner_cutting or diagonal_cost is not None:
            raise ValueError("--corner-cutting and --diagonal-cost: say --connectivity 8 too")
        return None
    if diagonal_cost is None:
        return Movement(connectivity, corner_cutting)
    return Movement(connectivity, corner_cutting, diagonal_cost)


def export_command(root: list[str], dst: str, **options: Any) -> None:
    """Write a dataset in a foreign format.

    Examples:
      mapdata export data/maps release --format paper
      mapdata export data/maps maps.npz --format planning-datasets

    Args:
        root: folder or URL of the dataset, or several
        dst: new folder; for planning-datasets a new .npz file
        **options: those of the formats
    """
    from mapdata.formats import export

    name = options.pop("format")
    for note in export(root, dst, name, progress=True, **_own_options(name, options)):
        print(f"note: {note}")
    print(f"wrote {dst}")


def check_scen_command(file: list[str], *, maps: str | None = None) -> None:
    """Solve the problems of .scen files; exit code 1 unless each published optimal length is ours.

    A file whose lengths are all 0 gives none, so there is nothing to compare. A file that cannot be
    read does not end the run: it is named at the end, and the exit code is 2.

    Examples:
      mapdata check-scen arena.map.scen --maps maps/

    Args:
        file: .scen files
        maps: folder of the maps (default: beside each .scen)
    """
    from mapdata.formats import FormatError, Limits
    from mapdata.formats.movingai import check_scen

    missed = 0
    total = 0
    unread = []
    for name in file:
        try:
            report = check_scen(name, maps, Limits(progress=True))
        except (ValueError, OSError) as error:  # such as a name that is too long
            unread.append(str(error))
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
        missed += len(report.disagreements)
        total += report.total
    if missed:
        raise DisagreeError("; ".join([f"{missed} of {total} optimal lengths disagree", *unread]))
    if unread:
        raise FormatError("; ".join(unread))


# --- flags --------------------------------------------------------------------------------------


def add_import_flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``mapdata import`` that the formats and `import_maps` bring."""
    from mapdata.formats.importing import import_maps
    from mapdata.formats.registry import functions_by_format
    from mapdata.options import options_of

    formats = functions_by_format("read")
    parser.add_argument("--format", choices=formats, help="default: recognised by the files")
    options = options_of(import_maps)
    for name in _OF_IMPORTS:
        add_flag(parser, name, options[name], options[name].default)
    _add_format_options(parser, formats)


def add_export_flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``mapdata export`` that the formats bring."""
    from mapdata.formats.registry import functions_by_format

    formats = functions_by_format("write")
    parser.add_argument("--format", choices=formats, required=True, help="what to write")
    _add_format_options(parser, formats)


def _add_format_options(
    parser: argparse.ArgumentParser, formats: dict[str, Callable[..., Any]]
) -> None:
    """Add the options of what reads, or writes, each format, in a group under its name.

    Those that are not given are absent from what the parser returns.
    """
    from mapdata.options import options_of, summary_line

    for name, function in formats.items():
        options = {
            key: option for key, option in options_of(function).items() if key not in _OF_IMPORTS
        }
        if options:
            group = parser.add_argument_group(name, summary_line(function).replace("``", ""))
            for key, option in options.items():
                add_flag(group, f"{name}.{key}", option, argparse.SUPPRESS)
