"""The command ``mapdata``. Exit codes: 0 good, 1 the data are damaged or disagree, 2 usage or
environment.

What a verb needs is imported when it runs, so that ``mapdata --help`` answers at once.
"""

from __future__ import annotations

import argparse
import re
import sys
import time
from contextlib import nullcontext
from pathlib import Path

from mapdata._version import __version__
from mapdata.cli import convert
from mapdata.cli.common import DisagreeError, Parser, path_name, run, summary


def build_command(
    root: str,
    maps: int | None,
    seed: int | None,
    preset: str,
    recipe: str | None,
    shard_size: int,
    workers: int | None,
    scheduler: str | None,
    part: tuple[int, int],
) -> None:
    """Make maps with all labels as shards; run again to go on, ask for more maps to extend."""
    from mapdata.generators import Generator
    from mapdata.shards import Recipe, build
    from mapdata.shards.cluster import executor_of

    wanted = Recipe(Generator.preset(preset)) if recipe is None else Recipe.load(recipe)
    if maps is None:
        maps = wanted.maps
    if seed is None:
        seed = wanted.seed
    began = time.perf_counter()
    with nullcontext() if scheduler is None else executor_of(scheduler, workers) as executor:
        manifest = build(
            root,
            wanted.spec,
            maps=maps,
            seed=seed,
            shard_size=shard_size,
            workers=workers if executor is None else None,
            executor=executor,
            part=part,
            progress=True,
        )
    print(summary(root, manifest, time.perf_counter() - began))
    if (
        wanted.content_hash is not None
        and (maps, seed) == (wanted.maps, wanted.seed)
        and manifest.complete
    ):
        if manifest.content_hash != wanted.content_hash:
            raise DisagreeError(
                f"content hash {manifest.content_hash}, the recipe says {wanted.content_hash}"
            )
        print("The content hash is the recipe's: these are the same maps and labels, bit for bit.")


def info_command(root: list[str], recipe: bool, card: str | None) -> None:
    """Say what a dataset is, or write its card."""
    from mapdata.shards import Root, write_file
    from mapdata.shards import card as card_of
    from mapdata.shards.root import folder_of

    found = Root.open(root)
    if card is None:
        for place, manifest in zip(found.places, found.manifests, strict=True):
            print(manifest.recipe() if recipe else summary(place, manifest))
        return
    if not card and len(root) > 1:
        raise ValueError("--card: say the FILE for a card of several datasets")
    path = Path(card) if card else folder_of(root[0]) / "README.md"
    write_file(path, card_of(root).encode())
    print(f"wrote {path}")


def verify_command(root: list[str], repair: bool) -> None:
    """Check every file of a dataset; exit code 1 if one is damaged."""
    from mapdata.shards.corruption import inspect, repair_found
    from mapdata.shards.root import folder_of, places

    where = places(root)
    if repair:
        where = tuple(map(str, map(folder_of, where)))  # what can only be read is refused first
    total = unsound = 0
    for place in where:
        findings = inspect(place, progress=True)
        for fault in findings.faults:
            print(fault)
        found = len(findings.faults)
        left = repair_found(findings, progress=True) if repair and found else []
        for fault in left:
            print(f"not repaired: {fault}")
        total += found
        unsound += len(left) if repair else found
        if not found:
            print(f"{place}: all is well")
        elif repair and not left:
            print(f"{place}: {found} repaired")
    if unsound and repair:
        raise DisagreeError(f"{unsound} of {total} not repaired")
    if unsound:
        raise DisagreeError(f"{unsound} found; --repair makes them again from the recipe")


def show_command(
    root: list[str], index: int | None, output: str, paper_colours: bool, figure: str
) -> None:
    """Draw one map with both paths and its numbered seeds, or another figure."""
    from mapdata.plotting.figures import OF_ONE_MAP, WITH_GRID, plot_figure

    if index is not None and figure not in OF_ONE_MAP:
        raise ValueError(
            f"--index: does nothing with --figure {figure}, which shows the whole dataset"
        )
    if paper_colours and figure not in WITH_GRID:
        raise ValueError(
            f"--paper-colours: does nothing with --figure {figure}, which shows no map"
        )
    drawn = plot_figure(root, figure, index=index or 0, paper_colours=paper_colours)
    kind = Path(output).suffix[1:] or "png"  # else matplotlib adds an ending to the name
    drawn.savefig(output, format=kind, dpi=150, bbox_inches="tight")
    print(f"wrote {output}")


def report_command(root: list[str], output: str, maps: int) -> None:
    """Write one page to look at a dataset in a browser: maps with filters, distributions, the
    card.
    """
    from mapdata.plotting.html_report import report
    from mapdata.shards import write_file

    text = report(root, maps).encode()
    write_file(Path(output), text)
    print(f"wrote {output}, {len(text) / 1e3:,.0f} kB: open it in a browser")


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = Parser(
        prog="mapdata", description="Grid maps with shortest paths, to train path planners on."
    )
    parser.add_argument("--version", action="version", version=f"mapdata {__version__}")
    verbs = parser.add_subparsers(required=True, metavar="VERB")
    for name, command, add_arguments in (
        ("build", build_command, _add_build_arguments),
        ("info", info_command, _add_info_arguments),
        ("verify", verify_command, _add_verify_arguments),
        ("show", show_command, _add_show_arguments),
        ("report", report_command, _add_report_arguments),
        ("import", convert.import_command, convert.add_import_arguments),
        ("export", convert.export_command, convert.add_export_arguments),
        ("check-scen", convert.check_scen_command, convert.add_check_arguments),
    ):
        verb = verbs.add_parser(
            name, help=(command.__doc__ or "").split("\n")[0], description=command.__doc__
        )
        verb.set_defaults(command=command)
        if given[:1] == [name]:  # the flags of the others would only take time
            add_arguments(verb)
    values = vars(parser.parse_args(given))
    run(values.pop("command"), **values)


def build_main(arguments: list[str] | None = None) -> None:
    """Run ``mapdata build`` with a default root: what ``scripts/build_shards.py`` is."""
    parser = Parser(description=build_command.__doc__)
    parser.add_argument(
        "root", metavar="ROOT", nargs="?", default="data/maps", help="folder (default: %(default)s)"
    )
    _add_build_flags(parser)
    run(build_command, **vars(parser.parse_args(arguments)))


def _add_roots(parser: argparse.ArgumentParser) -> None:
    what = "folder or URL of the dataset; several are one after another"
    parser.add_argument("root", metavar="ROOT", type=path_name, nargs="+", help=what)


def _add_build_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("root", metavar="ROOT", type=path_name, help="folder of the dataset")
    _add_build_flags(parser)


def _add_build_flags(parser: argparse.ArgumentParser) -> None:
    from mapdata.generators import PRESETS

    parser.add_argument(
        "--maps", metavar="N", type=int, help="how many maps (default 10000, or the recipe's)"
    )
    parser.add_argument(
        "--seed", metavar="S", type=int, help="64-bit seed (default 0, or the recipe's)"
    )
    source = parser.add_mutually_exclusive_group()
    source.add_argument(
        "--preset",
        metavar="NAME",
        default="paper",
        help=f"{', '.join(PRESETS)} (default: %(default)s)",
    )
    source.add_argument(
        "--recipe",
        metavar="FILE",
        help="what 'mapdata info ROOT --recipe' prints, or a spec of your own",
    )
    parser.add_argument(
        "--shard-size",
        metavar="K",
        type=int,
        default=1000,
        help="maps a shard (default: %(default)s)",
    )
    parser.add_argument("--workers", metavar="W", type=int, help="threads (default: all cores)")
    parser.add_argument(
        "--scheduler",
        metavar="WHERE",
        help="build with Dask: tcp://HOST:PORT of a scheduler, or local processes",
    )
    parser.add_argument(
        "--part",
        metavar="K/N",
        type=_part,
        default=(0, 1),
        help=(
            "make only part K of N, K from 0 to N - 1: for array jobs on a shared folder "
            "(default: 0/1, all)"
        ),
    )


def _part(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text)
    if match is None or int(match[1]) >= int(match[2]):
        raise argparse.ArgumentTypeError(
            f"got {text!r}, expected K/N with K from 0 to N - 1, as in 0/4"
        )
    return int(match[1]), int(match[2])


def _add_verify_arguments(parser: argparse.ArgumentParser) -> None:
    _add_roots(parser)
    parser.add_argument(
        "--repair",
        action="store_true",
        help="make damaged and missing shards again from the recipe",
    )


def _add_info_arguments(parser: argparse.ArgumentParser) -> None:
    _add_roots(parser)
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--recipe", action="store_true", help="print the few lines of JSON that are the dataset"
    )
    what.add_argument(
        "--card",
        metavar="FILE",
        nargs="?",
        const="",
        help="write the dataset card (default: README.md in ROOT)",
    )


def _add_show_arguments(parser: argparse.ArgumentParser) -> None:
    _add_roots(parser)
    parser.add_argument("--index", metavar="I", type=int, help="number of the map (default: 0)")
    parser.add_argument(
        "-o", "--output", metavar="FILE", default="map.png", help="picture (default: %(default)s)"
    )
    parser.add_argument(
        "--paper-colours", action="store_true", help="free black and occupied white"
    )
    parser.add_argument(
        "--figure",
        choices=("map", "gallery", "path", "matrix", "distributions"),
        default="map",
        help="what to draw (default: %(default)s)",
    )


def _add_report_arguments(parser: argparse.ArgumentParser) -> None:
    _add_roots(parser)
    parser.add_argument(
        "-o", "--output", metavar="FILE", default="report.html", help="page (default: %(default)s)"
    )
    parser.add_argument(
        "--maps", metavar="N", type=int, default=500, help="maps to browse (default: %(default)s)"
    )
