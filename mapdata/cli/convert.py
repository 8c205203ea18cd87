"""The verbs ``mapdata import``, ``mapdata export`` and ``mapdata check-scen``."""

from __future__ import annotations

import argparse
import re
import sys
from typing import TYPE_CHECKING, Any

from mapdata.spec import Movement

if TYPE_CHECKING:
    from mapdata.formats.importing import Imported

_READERS = ("paper", "movingai", "ros", "planning-datasets", "images")
_WRITERS = ("paper", "movingai", "ros", "planning-datasets", "huggingface")


def import_command(
    source: str,
    root: str,
    kind: str | None,
    seed_points: int,
    seed: int,
    tile: tuple[int, int] | None,
    resolution: float | None,
    connectivity: int | None,
    corner_cutting: bool,
    diagonal_cost: float | None,
    shard_size: int | None,
    max_pixels: int | None,
    scen: bool,
    maps: str | None,
    unknown: str | None,
    threshold: float | None,
    invert: bool,
    size: tuple[int, int] | None,
    fit: str | None,
) -> None:
    """Make a dataset of maps in a foreign format, with drawn seed points and all labels."""
    from mapdata.formats import Limits, read_any
    from mapdata.formats.importing import import_maps

    movement = _movement(connectivity, corner_cutting, diagonal_cost)
    if fit is not None and size is None:
        raise ValueError("--fit: does nothing without --size")
    if max_pixels is not None and max_pixels < 1:
        raise ValueError(f"--max-pixels: got {max_pixels}, expected at least 1")
    limits = Limits() if max_pixels is None else Limits(pixels=max_pixels)
    found = read_any(
        source,
        kind,
        limits,
        scen=seed_points if scen or source.lower().endswith(".scen") else None,
        maps=maps,
        unknown=unknown,
        threshold=threshold,
        invert=invert or None,
        size=size,
        fit=fit,
    )
    made = []
    try:
        made = import_maps(
            root,
            found,
            seed_points=seed_points,
            seed=seed,
            movement=movement,
            resolution=resolution,
            tile=tile,
            shard_size=shard_size,
            progress=True,
        )
    finally:
        for name, why in found.left_out if made or len(found.left_out) > 1 else ():  # the error tells of a single one
            print(f"left out: {name}: {' '.join(why.split())}", file=sys.stderr)
    for note in dict.fromkeys(found.notes):
        print(f"note: {note}")
    for one in made:
        print(_summary(one))


def _summary(one: Imported) -> str:
    from mapdata.cli.common import summary

    text = summary(str(one.root), one.manifest)
    if one.checked:
        text += f"\nlabels compared with the source: {one.checked:,} maps"
        text += "".join(f"\n  {name}: {count:,} disagree" for name, count in sorted(one.disagreements.items()))
    return text


def _movement(connectivity: int | None, corner_cutting: bool, diagonal_cost: float | None) -> Movement | None:
    """Return the movement that the flags say, None if they say nothing."""
    if connectivity is None:
        if corner_cutting or diagonal_cost is not None:
            raise ValueError("--corner-cutting and --diagonal-cost: say --connectivity 8 too")
        return None
    movement = Movement(connectivity, corner_cutting)
    return movement if diagonal_cost is None else Movement(connectivity, corner_cutting, diagonal_cost)


def export_command(root: str, target: str, kind: str, image: str | None) -> None:
    """Write a dataset in a foreign format."""
    from mapdata.formats import export

    for note in export(root, target, kind, image=image, progress=True):
        print(f"note: {note}")
    print(f"wrote {target}")


def check_scen_command(files: list[str], maps: str | None) -> None:
    """Solve the problems of .scen files; exit code 1 unless every published optimal length is ours."""
    from mapdata.cli.common import DisagreeError
    from mapdata.formats.movingai import check_scen

    missed = total = 0
    for name in files:
        report = check_scen(name, maps)
        print(f"{name}: {report.agreed:,} of {report.total:,} optimal lengths agree")
        for line in report.disagreements[:20]:
            print(line)
        if len(report.disagreements) > 20:
            print(f"{name}: and {len(report.disagreements) - 20} more")
        missed, total = missed + len(report.disagreements), total + report.total
    if missed:
        raise DisagreeError(f"{missed} of {total} optimal lengths disagree")


def add_verbs(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the three verbs to the parser of ``mapdata``."""
    for name, command, add_arguments in (
        ("import", import_command, _add_import_arguments),
        ("export", export_command, _add_export_arguments),
        ("check-scen", check_scen_command, _add_check_arguments),
    ):
        verb = verbs.add_parser(name, help=(command.__doc__ or "").split("\n")[0], description=command.__doc__)
        add_arguments(verb)
        verb.set_defaults(command=command)


def _name(text: str) -> str:
    if not text:  # else it would be the working folder
        raise argparse.ArgumentTypeError("got an empty name")
    return text


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([1-9]\d{0,4})[xX]([1-9]\d{0,4})", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected ROWSxCOLUMNS as in 64x64")
    return int(match[1]), int(match[2])


def _add_import_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("source", metavar="SRC", type=_name, help="file or folder")
    help_text = "folder of the dataset; with maps of several sizes, one below it for each"
    add("root", metavar="ROOT", type=_name, help=help_text)
    add("--format", dest="kind", choices=_READERS, help="default: recognised by the files")
    add("--seed-points", metavar="N", type=int, default=5, help="seed points a map (default: %(default)s)")
    add("--seed", metavar="S", type=int, default=0, help="64-bit seed of the draws (default: %(default)s)")
    add("--tile", metavar="HxW", type=_size, help="cut maps into tiles")
    add("--resolution", metavar="M", type=float, help="metres per cell (default: the source's, else 0.1)")
    add("--connectivity", type=int, choices=(4, 8), help="how paths move (default: the format's rule, else 4)")
    add("--corner-cutting", action="store_true", help="diagonal moves beside occupied cells too")
    add("--diagonal-cost", metavar="C", type=float, help="1 or 1.41421356")
    add("--shard-size", metavar="K", type=int, help="maps a shard (default: 1000, less for large maps)")
    add("--max-pixels", metavar="P", type=int, help="refuse larger pictures and maps (default: 16777216)")
    add("--scen", action="store_true", help="movingai: the end points in .scen files are the seed points")
    add("--maps", metavar="DIR", help="movingai: folder of the maps that .scen files name")
    add("--unknown", choices=("occupied", "free"), help="ros: what unknown cells become")
    add("--threshold", metavar="T", type=float, help="images: brightness above which a cell is free (default: 0.5)")
    add("--invert", action="store_true", help="images: bright is occupied")
    add("--size", metavar="HxW", type=_size, help="images: bring all to one size")
    add("--fit", choices=("resize", "crop"), help="images: how (default: resize)")


def _add_export_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("root", metavar="ROOT", type=_name, help="folder of the dataset")
    parser.add_argument("target", metavar="DST", type=_name, help="new folder (planning-datasets: new .npz file)")
    parser.add_argument("--format", dest="kind", choices=_WRITERS, required=True, help="what to write")
    parser.add_argument("--image", choices=("pgm", "png", "bmp"), help="ros: kind of picture (default: pgm)")


def _add_check_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", metavar="FILE", nargs="+", help=".scen files")
    parser.add_argument("--maps", metavar="DIR", help="folder of the maps (default: beside each .scen)")
