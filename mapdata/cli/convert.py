"""The verbs ``mapdata import``, ``mapdata export`` and ``mapdata check-scen``.

The options of the formats are the keyword-only parameters of their functions, spelled
``--<format>.<option>``.
"""

from __future__ import annotations

import argparse
import re
import sys
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

from mapdata.cli.common import DisagreeError, path_name, summary

if TYPE_CHECKING:
    from mapdata.formats.registry import Option
    from mapdata.spec import Movement

_OF_IMPORTS = ("seed_points", "seed", "tile", "resolution", "shard_size")
"""Parameters of `import_maps` that are flags, whatever the format."""


def import_command(
    source: str,
    root: str,
    kind: str | None,
    connectivity: int | None,
    corner_cutting: bool,
    diagonal_cost: float | None,
    max_pixels: int | None,
    **options: Any,
) -> None:
    """Make a dataset of maps in a foreign format, with drawn seed points and all labels."""
    from mapdata.formats import Limits, import_maps, read_any, recognise
    from mapdata.formats.registry import functions, options_of

    movement = _movement(connectivity, corner_cutting, diagonal_cost)
    if max_pixels is not None and max_pixels < 1:
        raise ValueError(f"--max-pixels: got {max_pixels}, expected at least 1")
    limits = Limits() if max_pixels is None else Limits(pixels=max_pixels)
    name = kind or recognise(source)
    of_import = {key: options.pop(key) for key in _OF_IMPORTS}
    of_format = _own_options(name, options)
    if "seed_points" in options_of(functions("read")[name]):
        of_format["seed_points"] = of_import["seed_points"]
    found = read_any(source, name, limits, **of_format)
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
    from mapdata.spec import Movement

    if connectivity is None:
        if corner_cutting or diagonal_cost is not None:
            raise ValueError("--corner-cutting and --diagonal-cost: say --connectivity 8 too")
        return None
    movement = Movement(connectivity, corner_cutting)
    return (
        movement if diagonal_cost is None else Movement(connectivity, corner_cutting, diagonal_cost)
    )


def export_command(root: list[str], target: str, kind: str, **options: Any) -> None:
    """Write a dataset in a foreign format."""
    from mapdata.formats import export

    for note in export(root, target, kind, progress=True, **_own_options(kind, options)):
        print(f"note: {note}")
    print(f"wrote {target}")


def check_scen_command(files: list[str], maps: str | None) -> None:
    """Solve the problems of .scen files; exit code 1 unless every published optimal length is
    ours.
    """
    from mapdata.formats.movingai import check_scen

    missed = 0
    total = 0
    for name in files:
        report = check_scen(name, maps)
        print(f"{name}: {report.agreed:,} of {report.total:,} optimal lengths agree")
        for line in report.disagreements[:20]:
            print(line)
        if len(report.disagreements) > 20:
            print(f"{name}: and {len(report.disagreements) - 20} more")
        missed += len(report.disagreements)
        total += report.total
    if missed:
        raise DisagreeError(f"{missed} of {total} optimal lengths disagree")


# --- flags --------------------------------------------------------------------------------------


def add_import_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``mapdata import``."""
    from mapdata.formats.importing import import_maps
    from mapdata.formats.registry import functions, options_of

    add = parser.add_argument
    add("source", metavar="SRC", type=path_name, help="file or folder")
    text = "folder of the dataset; with maps of several sizes, one below it for each"
    add("root", metavar="ROOT", type=path_name, help=text)
    add("--format", dest="kind", choices=functions("read"), help="default: recognised by the files")
    options = options_of(import_maps)
    for name in _OF_IMPORTS:
        _add_option(parser, name, options[name], default=options[name].default)
    add(
        "--connectivity",
        type=int,
        choices=(4, 8),
        help="how paths move (default: the format's rule, else 4)",
    )
    add("--corner-cutting", action="store_true", help="diagonal moves beside occupied cells too")
    add("--diagonal-cost", metavar="C", type=float, help="1 or 1.41421356")
    add(
        "--max-pixels",
        metavar="P",
        type=int,
        help="refuse larger pictures and maps (default: 16777216)",
    )
    _add_format_options(parser, "read")


def add_export_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``mapdata export``."""
    from mapdata.formats.registry import FORMATS, functions

    files = [
        f"{name}: new {one.target_ending} file"
        for name, one in FORMATS.items()
        if one.target_ending
    ]
    parser.add_argument(
        "root",
        metavar="ROOT",
        type=path_name,
        nargs="+",
        help="folder or URL of the dataset, or several",
    )
    parser.add_argument(
        "target", metavar="DST", type=path_name, help=f"new folder ({', '.join(files)})"
    )
    parser.add_argument(
        "--format", dest="kind", choices=functions("write"), required=True, help="what to write"
    )
    _add_format_options(parser, "write")


def add_check_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``mapdata check-scen``."""
    parser.add_argument("files", metavar="FILE", nargs="+", help=".scen files")
    parser.add_argument(
        "--maps", metavar="DIR", help="folder of the maps (default: beside each .scen)"
    )


def _add_format_options(parser: argparse.ArgumentParser, what: Literal["read", "write"]) -> None:
    """Add the options of what reads, or writes, each format, in a group under its name; not given,
    they are absent.
    """
    from mapdata.formats.registry import functions, options_of

    for name, function in functions(what).items():
        options = {
            key: option for key, option in options_of(function).items() if key not in _OF_IMPORTS
        }
        if options:
            group = parser.add_argument_group(
                name, (function.__doc__ or "").partition("\n")[0].replace("``", "")
            )
            for key, option in options.items():
                _add_option(group, f"{name}.{key}", option, default=argparse.SUPPRESS)


def _add_option(
    parser: argparse._ActionsContainer, name: str, option: Option, default: object
) -> None:
    """Add the flag of a keyword-only parameter."""
    how: dict[str, Any] = {"type": option.kind, "metavar": name.rpartition(".")[2].upper()}
    if option.kind is bool:
        how = {"action": "store_true"}
    elif get_origin(option.kind) is Literal:
        how = {"choices": get_args(option.kind)}
    elif get_origin(option.kind) is tuple:
        how = {"type": _size, "metavar": "HxW"}
    text = option.help.removesuffix(".").replace("%", "%%")
    if option.default is not None and option.default is not False:
        text += f" (default: {option.default})"
    parser.add_argument(f"--{name.replace('_', '-')}", dest=name, default=default, help=text, **how)


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([1-9]\d{0,4})[xX]([1-9]\d{0,4})", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected ROWSxCOLUMNS as in 64x64")
    return int(match[1]), int(match[2])
