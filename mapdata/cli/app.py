"""The command ``mapdata`` and its verbs.

Exit codes: 0 success, 1 damaged or disagreeing data, 2 wrong usage or a failing environment.

Modules that a verb needs are imported when it runs, so that ``mapdata --help`` answers at once.
"""

from __future__ import annotations

import re
import sys
import time
from contextlib import nullcontext
from dataclasses import fields, replace
from pathlib import Path
from typing import Literal
from zipfile import is_zipfile

from mapdata._version import __version__
from mapdata.cli import convert, evaluate, export
from mapdata.cli.common import (
    Command,
    DisagreeError,
    Parser,
    add_import_flag,
    complain,
    output_path,
    parser_of,
    run,
    run_parsed,
    summary,
    unused_name,
)


def build_command(
    root: str,
    *,
    maps: int | None = None,
    seed: int | None = None,
    preset: str | None = None,
    map_size: tuple[int, int] | None = None,
    recipe: str | None = None,
    connectivity: Literal[4, 8] | None = None,
    corner_cutting: bool = False,
    diagonal_cost: float | None = None,
    shard_size: int = 1000,
    workers: int | None = None,
    scheduler: str | None = None,
    part: str = "0/1",
) -> None:
    """Build a dataset with all labels; run it again to continue, or with more --maps to extend it.

    Examples:
      mapdata build data/maps
      mapdata build data/dungeon --preset dungeon --maps 500 --seed 7
      mapdata build data/large --preset cave --map-size 128x128 --connectivity 8
      mapdata build data/halls --recipe '{"spec": {"map_size": [48, 96], "rooms": [4, 12]}}'
      mapdata build data/again --recipe recipe.json

    Args:
        root: folder of the dataset
        maps: number of maps (default: that of the recipe, or 10000)
        seed: 64-bit seed of the maps (default: that of the recipe, or 0)
        preset: {presets} (default: paper); 'mapdata list' describes them
        map_size: rows and columns of a map (default: those of the preset)
        recipe: file that 'mapdata info ROOT --recipe' wrote, JSON text of a recipe, or a preset's
            name
        connectivity: 4-connected or 8-connected movement of the stored paths (default: that of the
            preset)
        corner_cutting: allow diagonal moves beside occupied cells
        diagonal_cost: cost of a diagonal move: 1 or 1.41421356
        shard_size: number of maps per shard
        workers: number of threads (default: one per core)
        scheduler: build with Dask; address of its scheduler, tcp://HOST:PORT
        part: K/N builds only part K of N (K from 0 to N - 1), for array jobs on a shared folder
    """
    from mapdata.generators import PRESETS, MapGenerator, as_recipe
    from mapdata.shards import build
    from mapdata.shards.cluster import dask_executor

    movement = convert.movement_of_flags(connectivity, corner_cutting, diagonal_cost)
    generator_flags = {"--preset": preset, "--map-size": map_size, "--connectivity": movement}
    for flag, value in generator_flags.items():
        if value is not None and recipe is not None:
            raise ValueError(f"{flag}: not allowed with --recipe, which states the generator")
    match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", part)
    if match is None or int(match[1]) >= int(match[2]):
        raise ValueError(f"--part: got {part!r}, expected K/N with K from 0 to N - 1, as in 0/4")
    if recipe is not None:
        to_build = as_recipe(recipe, maps=maps, seed=seed)
    else:
        if preset is None and root in PRESETS:
            print(
                f"note: {root} is the folder of the dataset, and the maps are those of the preset "
                f"paper; 'mapdata build FOLDER --preset {root}' builds the preset {root}"
            )
        generator = MapGenerator.preset(preset or "paper")
        if map_size is not None:
            generator = replace(generator, map_size=map_size)
        if movement is not None:
            generator = replace(generator, movement=movement)
        to_build = as_recipe(generator, maps=maps, seed=seed)
    if scheduler is not None:  # which may take most of a minute before it fails
        print(f"connecting to {scheduler} ...", file=sys.stderr, flush=True)
    began = time.perf_counter()
    with nullcontext() if scheduler is None else dask_executor(scheduler) as executor:
        manifest = build(
            root,
            to_build,
            shard_size=shard_size,
            workers=workers,
            executor=executor,
            part=(int(match[1]), int(match[2])),
            progress=True,
        )
    print(summary(root, manifest, time.perf_counter() - began))
    part_index, part_count = int(match[1]), int(match[2])
    if part_count > 1:
        shard_count = -(-to_build.maps // shard_size)
        own_count = len(range(part_index, shard_count, part_count))
        noun = "shard" if own_count == 1 else "shards"
        print(f"part {part_index + 1} of {part_count}: {own_count} {noun} of {shard_count}")
    if to_build.content_hash is not None and manifest.complete:
        print("The content hash is the recipe's: these are the same maps and labels, bit for bit.")


def info_command(
    root: list[str],
    *,
    recipe: bool = False,
    card: Literal[True] | str | None = None,
    problems: Literal[True] | str | None = None,
    split: Literal["train", "val", "test"] | None = None,
    connectivity: Literal[4, 8] | None = None,
    corner_cutting: bool = False,
    diagonal_cost: float | None = None,
    radius: float = 0.0,
    follow_links: bool = False,
) -> None:
    """Print what a dataset holds, its recipe, what its problems are worth, or write its card.

    Examples:
      mapdata info data/maps
      mapdata info data/maps --recipe > recipe.json
      mapdata info data/maps --card
      mapdata info data/maps --card -
      mapdata info data/maps --problems
      mapdata info data/maps --problems '{"random": {"hardness": [1.05, null]}}' --connectivity 8

    Args:
        root: folder or URL of a dataset; maps of several datasets are numbered one after another
        recipe: print the recipe: a few lines of JSON from which the dataset can be built again
        card: write the dataset card to this file, or print it if this is - (default: README.md in
            ROOT)
        problems: print which shares of 300 problems need a planner and have one shortest path: of
            route, pairs or random problems, or of those of a JSON text (default: route); the card
            states them, too
        split: problems of this split only
        connectivity: 4-connected or 8-connected movement of the problems (default: the stored one)
        corner_cutting: allow diagonal moves beside occupied cells
        diagonal_cost: cost of a diagonal move: 1 or 1.41421356
        radius: radius of the robot, in metres
        follow_links: read files that are links out of their folder; only for folders of your own
    """
    from mapdata.cli.convert import movement_of_flags
    from mapdata.describe import card as card_of
    from mapdata.shards import Root, write_file, write_output
    from mapdata.shards.locations import target_folder

    if recipe and card is not None:
        raise ValueError("--recipe: not allowed with --card")
    movement = movement_of_flags(connectivity, corner_cutting, diagonal_cost)
    if problems is None and (split is not None or movement is not None or radius):
        raise ValueError("--split, --connectivity and --radius: need --problems")
    if recipe and problems is not None:
        raise ValueError("--recipe: not allowed with --problems")
    dataset = Root.open(root, follow_links=follow_links)
    if problems is not None or card is not None:
        # It imports torch, which takes longer than all that `info` does otherwise.
        from mapdata.datasets import MapDataset

        source = problems if isinstance(problems, str) else "route"
        served = MapDataset(
            root,
            split,
            problems=source,
            movement=movement,
            radius=radius,
            follow_links=follow_links,
        )
        if split is not None and not len(served):
            raise ValueError(f"--split: {split} has no such problem in {dataset}")
        statistics = served.problem_statistics()
    if problems is not None and card is None:
        print(statistics)
        print(f"\n{statistics.target_text()}")
        return
    if card is None:
        for folder, manifest in zip(dataset.locations, dataset.manifests, strict=True):
            text = manifest.recipe() if recipe else summary(folder, manifest, None, follow_links)
            print(text)
        return
    if card is True and len(root) > 1:
        raise ValueError("--card: got several datasets; name the file, as in --card FILE")
    if card == "-":
        text = card_of(root, problems=statistics, follow_links=follow_links, progress=True)
        print(text, end="")
        return
    path = target_folder(root[0]) / "README.md" if card is True else output_path(card)
    # A README.md in the dataset is replaced even if it is a link, which a stranger may have placed
    # there. A file that the user names is written through links and pipes.
    write = write_file if card is True else write_output
    text = card_of(root, problems=statistics, follow_links=follow_links, progress=True)
    write(path, text.encode())
    print(f"wrote {path}")


def verify_command(root: list[str], *, repair: bool = False, follow_links: bool = False) -> None:
    """Check all files of a dataset, a problem set or an export; exit with code 1 if one is damaged.

    Examples:
      mapdata verify data/maps
      mapdata verify data/maps --repair
      mapdata verify dungeon.npz data/hub

    Args:
        root: folder or URL of a dataset, a file that ProblemSet.save wrote, or the folder of an
            export of training problems; or several of them
        repair: build damaged and missing shards of datasets again from the recipe; a link to a
            damaged shard is replaced by a file
        follow_links: read files that are links out of their folder; only for folders of your own
    """
    from mapdata.shards.corruption import inspect, repair_faults
    from mapdata.shards.errors import LINK_REMEDY
    from mapdata.shards.locations import locations, target_folder

    sources = locations(root)
    kinds = {source: _kind_of(source) for source in sources}
    if repair:
        for source, kind in kinds.items():
            if kind != "dataset":
                raise ValueError(f"--repair: {source} is {_KINDS[kind]}, and has no recipe")
            target_folder(source)  # refuses a URL before any dataset is repaired
    datasets = [source for source in sources if kinds[source] == "dataset"]
    other_fault_count = sum(_verify_other(source, kinds[source]) for source in sources)
    fault_count = other_fault_count
    unrepaired_count = other_fault_count
    link_count = 0
    requirement = ""
    for dataset in datasets:
        findings = inspect(dataset, follow_links=follow_links, progress=True)
        faults = findings.faults
        for fault in faults:
            print(fault)
        unrepaired = list(faults)
        if repair:
            unrepaired = repair_faults(findings, progress=True)
            for fault in unrepaired:
                print(f"not repaired: {fault}")
        fault_count += len(faults)
        link_count += sum(LINK_REMEDY in fault.description for fault in faults)
        unrepaired_count += len(unrepaired)
        if not faults:
            print(f"{dataset}: no faults found")
        elif not unrepaired:
            print(f"{dataset}: {len(faults)} repaired")
        for note in findings.notes:
            print(f"note: {note}")
        if findings.unchecked:
            requirement = " and its maps can be drawn (see the note)"
    if unrepaired_count and repair:
        raise DisagreeError(f"{unrepaired_count} of {fault_count} not repaired")
    if 0 < unrepaired_count == link_count:
        raise DisagreeError("files that are links out of their folder were not read")
    if unrepaired_count > other_fault_count:
        raise DisagreeError(
            f"{_faults_found(fault_count)}; --repair builds shards again if there is a recipe"
            f"{requirement}"
        )
    if other_fault_count:
        raise DisagreeError(_faults_found(other_fault_count))


def _faults_found(count: int) -> str:
    """Return how many faults were found, in words."""
    return f"{count} fault{'' if count == 1 else 's'} found"


_KINDS = {"dataset": "a dataset", "problem set": "a problem set", "export": "an export"}
"""What `mapdata verify` checks, with the article."""


def _kind_of(source: str) -> str:
    """Return which of `_KINDS` is at a location, as far as names tell."""
    from mapdata.shards.locations import is_url
    from mapdata.shards.manifest import MANIFEST

    path = Path(source)
    if is_url(source) or not path.exists():
        return "dataset"
    if path.is_dir():
        is_export = (path / "export.json").is_file() and not (path / MANIFEST).exists()
        return "export" if is_export else "dataset"
    if path.is_file() and (path.suffix.lower() == ".npz" or is_zipfile(path)):
        return "problem set"
    return "dataset"  # another file, which is refused by its name


def _verify_other(source: str, kind: str) -> int:
    """Check a problem set or an export, print what is wrong with it, and return how many faults."""
    if kind == "dataset":
        return 0
    if kind == "problem set":
        from mapdata.problems import ProblemSet

        faults = ProblemSet.verify(source)
    else:
        from mapdata.export import verify_export

        faults = verify_export(source)
    for fault in faults:
        print(fault)
    if not faults:
        print(f"{source}: no faults found")
    return len(faults)


def show_command(
    root: list[str],
    *,
    index: int | None = None,
    output: str | None = None,
    paper_colours: bool = False,
    figure: Literal["map", "gallery", "path", "matrix", "search", "distributions"] = "map",
    follow_links: bool = False,
) -> None:
    """Draw one map with both routes and its numbered seed points, or another figure.

    Examples:
      mapdata show data/maps --index 7 -o map7.png
      mapdata show data/maps --figure gallery -o gallery.png
      mapdata show data/maps --figure search -o search.gif

    Args:
        root: folder or URL of a dataset; maps of several datasets are numbered one after another
        index: number of the map (default: 0)
        output: picture to write; an existing file is replaced (default: map.png; if it exists,
            map-2.png, and so on). A .gif of the figure "search" is an animation
        paper_colours: draw free cells black and occupied cells white, as in the paper
        figure: figure to draw
        follow_links: read files that are links out of their folder; only for folders of your own
    """
    from mapdata.plotting.figures import SINGLE_MAP_FIGURES, WITH_PAPER_COLOURS, plot_figure
    from mapdata.plotting.plot import write_figure
    from mapdata.plotting.search_figures import write_search_animation
    from mapdata.shards import Root

    if output is None:
        output = unused_name("map.png")
    path = output_path(output)
    *_, last = root
    if len(root) > 1 and last.isdigit() and not Path(last).exists():
        raise ValueError(f"{last}: no dataset; did you mean --index {last}?")
    if index is not None and figure not in SINGLE_MAP_FIGURES:
        raise ValueError(
            f"--index: does nothing with --figure {figure}, which shows the whole dataset"
        )
    if paper_colours and figure not in WITH_PAPER_COLOURS:
        choices = ", ".join(WITH_PAPER_COLOURS)
        raise ValueError(
            f"--paper-colours: does nothing with --figure {figure}, expected one of {choices}"
        )
    if figure == "search" and path.suffix.lower() == ".gif":
        labels, i = Root.open(root, follow_links=follow_links).locate(index or 0)
        write_search_animation(labels, i, path)
        print(f"wrote {output}")
        return
    picture = plot_figure(
        root,
        figure,
        index=index or 0,
        paper_colours=paper_colours,
        follow_links=follow_links,
        progress=True,
    )
    write_figure(picture, path)
    print(f"wrote {output}")


def report_command(
    root: list[str], *, output: str | None = None, maps: int = 500, follow_links: bool = False
) -> None:
    """Write an HTML page to browse a dataset: maps with filters, distributions, the card.

    Examples:
      mapdata report data/maps -o report.html

    Args:
        root: folder or URL of a dataset; maps of several datasets are numbered one after another
        output: page to write; an existing file is replaced (default: report.html; if it exists,
            report-2.html, and so on)
        maps: number of maps on the page
        follow_links: read files that are links out of their folder; only for folders of your own
    """
    from mapdata.plotting.html_report import report
    from mapdata.shards import write_output

    if output is None:
        output = unused_name("report.html")
    path = output_path(output)
    text = report(root, maps, follow_links=follow_links, progress=True).encode()
    write_output(path, text)
    print(f"wrote {output}, {len(text) / 1e3:,.0f} kB: open it in a browser")


def list_command() -> None:
    """List the presets of 'mapdata build --preset', with their sizes and parameters.

    The parameters have the names that they have in the spec of a recipe.

    Examples:
      mapdata list
    """
    import json

    from mapdata.generators import PRESETS, MapGenerator

    common_names = {parameter.name for parameter in fields(MapGenerator)}
    for name, generator in PRESETS.items():
        rows, columns = generator.map_size
        plain_values = generator.to_dict()
        changes = []
        for parameter in fields(generator):
            is_changed = getattr(generator, parameter.name) != parameter.default
            if parameter.name not in common_names and is_changed:
                changes.append(f"{parameter.name} {json.dumps(plain_values[parameter.name])}")
        description = ", ".join([generator.description, *changes])
        print(f"{name:12}{f'{rows} x {columns}':12}{description}")


VERBS: dict[str, Command] = {
    "list": list_command,
    "build": build_command,
    "info": info_command,
    "verify": verify_command,
    "show": show_command,
    "report": report_command,
    "import": convert.import_command,
    "export": export.export_command,
    "check-scen": convert.check_scen_command,
    "evaluate": evaluate.evaluate_command,
}

FORMAT_FLAGS = {"import": convert.add_import_flags, "export": export.add_export_flags}
"""Functions that add the flags of foreign formats to a verb's parser."""

OPTIONAL: dict[str, dict[str, object]] = {"evaluate": {"problems": []}}
"""Positional arguments of verbs that may be left out, with their defaults."""

WITHOUT_FAMILIES = ("import", "check-scen")
"""Verbs that use no family of maps, and so have no flag ``--import``."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code.

    Args:
        arguments: the verb and its arguments; by default those of the process.
    """
    if arguments is None:
        arguments = sys.argv[1:]
    verb, *verb_arguments = arguments or [""]
    if verb == "--version":
        print(f"mapdata {__version__}")
        return
    if verb in ("", "-h", "--help"):
        run(print_verbs)
        sys.exit(0 if verb else 2)
    if verb.startswith("-"):
        advice = "the verb comes first, as in mapdata verify data/maps"
        sys.exit(complain(f"{verb}: {advice} (mapdata --help says more)", 2))
    if verb not in VERBS:
        from mapdata.checks import did_you_mean

        hint = did_you_mean(verb, VERBS) or f"; known are {', '.join(VERBS)}"
        sys.exit(complain(f"unknown verb {verb!r}{hint} (mapdata --help says more)", 2))
    run(VERBS[verb], **vars(verb_parser(verb).parse_args(verb_arguments)))


def verb_parser(verb: str) -> Parser:
    """Return the parser of a verb's arguments."""
    parser = parser_of(VERBS[verb], f"mapdata {verb}", **OPTIONAL.get(verb, {}))
    if verb in FORMAT_FLAGS:
        FORMAT_FLAGS[verb](parser)
    if verb not in WITHOUT_FAMILIES:
        add_import_flag(parser)
    return parser


def print_verbs() -> None:
    """Print the help of ``mapdata`` itself: the verbs, a line each."""
    verbs = "\n".join(
        f"  {name:12}{(verb.__doc__ or '').splitlines()[0]}" for name, verb in VERBS.items()
    )
    print(
        "usage: mapdata VERB ...\n\n"
        "Build, check, show and convert datasets of grid maps with shortest paths.\n\n"
        f"{verbs}\n\n"
        "'mapdata VERB --help' prints the flags and examples of a verb.\n"
        "'mapdata --version' prints the version."
    )


def build_main(arguments: list[str] | None = None) -> None:
    """Run ``mapdata build`` with a default root, as ``scripts/build_shards.py`` does."""
    run_parsed(build_command, arguments, root="data/maps")
