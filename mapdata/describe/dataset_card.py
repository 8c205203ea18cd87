"""The dataset card: what a dataset holds, how to build it again, what to know before using it.

The card is a list of sections, which become Markdown here and HTML in `mapdata.plotting`.
"""

from __future__ import annotations

import json
import os
import re
import shlex
from collections.abc import Mapping, Sequence
from html import escape
from typing import NamedTuple

import numpy as np

from mapdata._version import __version__
from mapdata.describe.statistics import DatasetStatistics, Repeats, dataset_statistics
from mapdata.generators.generator import PRESETS, MapGenerator, UnknownFamily
from mapdata.limits import SPLITS
from mapdata.movement import Movement
from mapdata.search.lattice import HARD
from mapdata.shards.manifest import COUNTS, PROVENANCE, Manifest
from mapdata.shards.root import Places, read_provenance

_SIZES = ("n<1K", "1K<n<10K", "10K<n<100K", "100K<n<1M", "1M<n<10M", "n>10M")
"""Size categories of the Hugging Face Hub, parted by 10**3, 10**4, ... 10**7 rows."""

_SOURCES_SHOWN = 10

CITATION = """@misc{floresaquino2021gridmap,
  title         = {{2D} Grid Map Generation for Deep-Learning-based Navigation Approaches},
  author        = {Flores-Aquino, Gabriel O. and D{\\'i}az Ortega, Jheison Duvier
                   and Almazan Arvizu, Ricardo Yahir and L{\\'o}pez Mu{\\~n}oz, Ra{\\'u}l
                   and Gutierrez-Frias, O. Octavio and Vasquez-Gomez, J. Irving},
  year          = {2021},
  eprint        = {2110.13242},
  archivePrefix = {arXiv},
  url           = {https://arxiv.org/abs/2110.13242}
}"""


class Section(NamedTuple):
    """A part of the card: a heading, a paragraph, a table and a block of code, all plain text.

    All but the heading may be empty. The first row of the table names its columns.
    """

    title: str
    text: str = ""
    table: Sequence[Sequence[str]] = ()
    code: str = ""
    language: str = ""


def card(
    root: Places,
    *,
    files: Mapping[str, str] | None = None,
    extra: Sequence[Section] = (),
    progress: bool = False,
) -> str:
    """Return the card of a dataset as Markdown, with the front matter of the Hugging Face Hub.

    Args:
        root: folder or URL of the dataset, or several.
        files: for a copy that ``datasets.load_dataset`` reads, a file pattern for each split.
        extra: sections to put behind the facts, such as what the columns of that copy mean.
        progress: show a progress bar.

    Raises:
        DatasetNotFoundError: there is no dataset under ``root``.
        ShardError: a shard is missing or damaged.
    """
    of = dataset_statistics(root, repeats=True, progress=progress)
    first, facts, *others = sections(of, copied=files is not None)
    parts = [_markdown(section, 2) for section in (facts, *extra, *others)]
    return "\n".join([_front_matter(of, files), _markdown(first, 1), *parts])


def _front_matter(of: DatasetStatistics, files: Mapping[str, str] | None) -> str:
    """Return the YAML block that the Hub reads; the licence is left to the publisher."""
    size = _SIZES[np.digitize(len(of), 10 ** np.arange(3, 8))]
    lines: dict[str, object] = {
        "pretty_name": title(of),
        "task_categories": ["robotics"],
        "tags": ["path-planning", "occupancy-grid", "motion-planning", "mapdata"],
        "size_categories": [size],
        "annotations_creators": ["machine-generated"],
    }
    if files is not None:
        data_files = [{"split": split, "path": path} for split, path in files.items()]
        lines["configs"] = [{"config_name": "default", "data_files": data_files}]
    # values are written as JSON, which is YAML too: no text from a file can end its quotes
    texts = [f"{name}: {json.dumps(value, ensure_ascii=False)}\n" for name, value in lines.items()]
    return "---\n" + "".join(texts) + "---\n"


def title(of: DatasetStatistics) -> str:
    """Return the name of the dataset: its folders, the number of maps and their size."""
    rows, columns = of.root.map_size
    return f"{' + '.join(_names(of))}: {len(of):,} grid maps of {rows} x {columns} cells"


def sections(of: DatasetStatistics, *, copied: bool = False) -> list[Section]:
    """Return the sections of a dataset's card.

    Args:
        of: what `dataset_statistics` returns with ``repeats=True``.
        copied: it is the card of a copy in another format, not of the shards.
    """
    found = [Section(title(of), _introduction(of)), _facts(of, copied)]
    for name, place, manifest in zip(_names(of), of.root.places, of.root.manifests, strict=True):
        if manifest.spec is None:
            found.append(_origin(place, of.rooms_known))
        else:
            found.append(_rebuild(name, manifest, manifest.spec))
    return [
        *found,
        _splits(of),
        _shares(of),
        _distributions(of),
        _duplicates(of),
        _use(of, copied),
        Section("Citation", _whom_to_cite(of), code=CITATION, language="bibtex"),
    ]


def _introduction(of: DatasetStatistics) -> str:
    what = f"{of.noun}s"
    sources = [
        f"{manifest.spec.description}, made" if manifest.spec else "imported maps, labelled"
        for manifest in of.root.manifests
    ]
    made = "; ".join(dict.fromkeys(sources))  # places often have one source: once is enough
    text = (
        f"Occupancy grids with shortest paths by BFS and A* between consecutive {what} and the "
        f"distances between all {what}: {made} by mapdata {__version__}."
    )
    if len(of) < of.root.maps:
        text += f" Not finished: {of.root.maps:,} maps were asked for."
    return text


def _facts(of: DatasetStatistics, copied: bool) -> Section:
    """Return what each dataset is, a column each; facts that no dataset has are left out."""
    names = _names(of)
    facts = [_facts_of(manifest, copied) for manifest in of.root.manifests]
    rows = [("", *names) if len(names) > 1 else ("", "")]
    for name in facts[0]:
        values = [each[name] for each in facts]
        if any(values):
            rows.append((name, *values))
    return Section("What it is", table=rows)


def _facts_of(manifest: Manifest, copied: bool) -> dict[str, str]:
    """Return what one dataset is, in words; empty where it has no such thing."""
    rows, columns = manifest.map_size
    facts = {
        "maps": f"{manifest.done:,} in {counted(len(manifest.shards), 'shard')}",
        "map size": f"{rows} rows x {columns} columns, {manifest.resolution:g} m per cell",
        "cells": "(row, col), origin upper left",
        "polarity": "1 occupied, 0 free",
        "movement": movement_text(manifest.movement),
    }
    if not copied:
        size = sum(entry.bytes for entry in manifest.shards)
        facts["size on disk"] = f"{size / 1e6:,.2f} MB"
        facts["format"] = f"mapdata shards (HDF5), version {manifest.format_version}"
    return facts | {
        "preset": next((name for name, spec in PRESETS.items() if spec == manifest.spec), ""),
        "seed": "" if manifest.seed is None else str(manifest.seed),
        "identity": manifest.identity or "none: imported maps are what their content hash says",
        "content hash": manifest.content_hash,
    }


def _rebuild(name: str, manifest: Manifest, spec: MapGenerator) -> Section:
    module = type(spec).__module__
    text = (
        "Map i is a pure function of the spec, the seed and i, so these lines make the same maps "
        "and labels, bit for bit, on any machine; the command says whether the content hash agrees."
    )
    command = f"mapdata build {shlex.quote(name)} --recipe recipe.json"
    if manifest.shard_size != 1000:
        command += f" --shard-size {manifest.shard_size}"
    if isinstance(spec, UnknownFamily) or module == "__main__":
        text += f" The command needs --import with the module of the family {spec.name}."
    elif not module.startswith("mapdata."):
        command += f" --import {module}"
        text += f" The module {module} has the family {spec.name}."
    lines = ("cat > recipe.json <<'END'", manifest.recipe(), "END", command)
    return Section("Make it again", text, code="\n".join(lines), language="sh")


def _origin(place: str, rooms_known: bool) -> Section:
    """Say where imported maps came from, as far as the import wrote it down."""
    try:
        values = read_provenance(place)
        sources = [str(source) for source in values.get("sources", ())]
    except (OSError, ValueError, TypeError):
        return Section(
            "Where it comes from",
            "Imported; there is no sound record of the source beside the data.",
        )
    text = f"Imported from {counted(len(sources), 'source')}, all named in {PROVENANCE}. "
    if not rooms_known:
        count = values.get("seeds", "?")
        seed = values.get("seed", "?")
        text += f"Up to {count} seed points a map were drawn with seed {seed}. "
    text += (
        "The maps are those of the source; paths, iterations and matrices were computed by mapdata."
    )
    rows = [("map", "source")]
    rows += [(str(k), source) for k, source in enumerate(sources[:_SOURCES_SHOWN])]
    return Section("Where it comes from", text, table=rows)


def _splits(of: DatasetStatistics) -> Section:
    entries = [entry for _, _, entry in of.root.shards]
    rows = [["split", "maps", "route problems", "without a path", "pairs", "pairs without a path"]]
    for split in SPLITS:
        counts = [sum(entry.counts[split][name] for entry in entries) for name in COUNTS]
        rows.append([split, *(f"{count:,}" for count in counts)])
    text = (
        "Each map belongs to one split and keeps it when the dataset grows. A route problem is a "
        "segment between consecutive rooms (seed points), a pair any two of a map; those from a "
        "cell to itself are not counted."
    )
    return Section("Splits", text, table=rows)


def _shares(of: DatasetStatistics) -> Section:
    found = of.lengths > 0
    is_hard = of.hardness >= HARD
    rows = [("share", "of", "")]
    if of.rooms_known:
        drawn = sum(manifest.total("drawn") for manifest in of.root.manifests)
        rows.append(("drawn passages", "pairs of consecutive rooms", _share(drawn, len(found))))
    hard = f"hard segments (hardness >= {HARD:g})"
    rows += [
        ("reachable segments", "segments", _share(found.sum(), len(found))),
        ("fully connected maps", "maps", _share(of.all_connected.sum(), len(of))),
        (hard, "reachable segments", _share(is_hard.sum(), found.sum())),
    ]
    text = (
        "Hardness is the cost of the shortest path over the heuristic: 1 where walking straight "
        "at the goal is best."
    )
    if of.rooms_known:
        text += " Rooms can reach each other without a passage, where they overlap."
    return Section("Shares", text, table=rows)


def _distributions(of: DatasetStatistics) -> Section:
    values = {
        **of.distributions(),
        "iterations of a segment, BFS": of.iterations["bfs"],
        "iterations of a segment, A*": of.iterations["astar"],
    }
    rows = [["", "mean", "least", "5 %", "25 %", "median", "75 %", "95 %", "most"]]
    for name, column in values.items():
        if len(column):
            marks = np.quantile(column, (0, 0.05, 0.25, 0.5, 0.75, 0.95, 1)).tolist()
            shown = (column.mean(), *marks)
            rows.append([name, *(f"{value:.4g}" for value in shown)])
    text = "Segments without a path are left out, except for iterations."
    return Section("Distributions", text, rows)


def _duplicates(of: DatasetStatistics) -> Section:
    exact, symmetric = of.repeats
    same = f"the same up to {of.symmetries} symmetries"
    rows = [("maps that are there already", "exactly the same", same)]
    for name in SPLITS:
        rows.append((f"inside {name}", f"{exact.inside[name]:,}", f"{symmetric.inside[name]:,}"))
    for a, b in exact.across:
        counts = (f"{exact.across[a, b]:,}", f"{symmetric.across[a, b]:,}")
        rows.append((f"of {b}, also in {a}", *counts))
    return Section("Duplicates", _verdict(exact, symmetric), table=rows)


def _verdict(exact: Repeats, symmetric: Repeats) -> str:
    if any(exact.across.values()):
        return (
            "Some maps are in more than one split: results on val and test are not independent of "
            "train."
        )
    if any(symmetric.across.values()):
        return (
            "No map is in two splits, but some are turned or mirrored copies of maps of another "
            "split."
        )
    return "No map is in two splits, not even turned or mirrored."


def _use(of: DatasetStatistics, copied: bool) -> Section:
    names = _names(of)
    root = repr(names[0] if len(names) == 1 else names)
    if copied:
        code = f'from datasets import load_dataset\n\ntrain = load_dataset({root}, split="train")'
    else:
        code = (
            "from mapdata import MapDataModule, MapDataset\n\n"
            f'train = MapDataset({root}, split="train")\n'
            "map, start, goal, path = train[0]\n"
            f"loaders = MapDataModule({root})  # for pytorch-lightning"
        )
    return Section("Use it", code=code, language="python")


def _whom_to_cite(of: DatasetStatistics) -> str:
    imported = f"Cite the source of the maps. {MapGenerator.citation}"
    specs = [manifest.spec for manifest in of.root.manifests]
    texts = [imported if spec is None else spec.citation for spec in specs]
    return " ".join(dict.fromkeys(texts))  # each once


def movement_text(movement: Movement) -> str:
    """Return the movement rule in words."""
    if movement.connectivity == 4:
        return "4-connected: north, east, south, west, each at cost 1"
    cost = "1" if movement.diagonal_cost == 1 else "sqrt 2"
    rule = "unrestricted" if movement.corner_cutting else "only beside two free cells"
    return f"8-connected: straight steps at cost 1, diagonal steps at cost {cost}, {rule}"


def _names(of: DatasetStatistics) -> list[str]:
    """Return the names of the dataset's folders in printable characters."""
    names = []
    for place in of.root.places:
        name = os.path.basename(os.path.abspath(place))
        printable = "".join(letter if letter.isprintable() else "?" for letter in name)
        names.append(printable or "maps")
    return names


def counted(number: int, what: str) -> str:
    """Return a number of things in words, as "1 shard" or "2,000 shards"."""
    return f"{number:,} {what}" if number == 1 else f"{number:,} {what}s"


def _share(part: int, whole: int) -> str:
    return f"{part / max(whole, 1):.1%} ({part:,} of {whole:,})"


def _markdown(section: Section, level: int) -> str:
    parts = [f"{'#' * level} {_escaped(section.title)}"]
    if section.text:
        parts.append(_escaped(section.text))
    if section.table:
        head, *rows = [f"| {' | '.join(map(_escaped, row))} |" for row in section.table]
        parts.append("\n".join([head, "|" + "---|" * len(section.table[0]), *rows]))
    if section.code:
        # a fence is longer than any run of backticks inside, so that the code cannot end it
        runs = [len(run) for run in re.findall("`+", section.code)]
        fence = "`" * max(3, 1 + max(runs, default=0))
        parts.append(f"{fence}{section.language}\n{section.code}\n{fence}")
    return "\n\n".join(parts) + "\n"


def _escaped(text: str) -> str:
    """Return ``text`` so that Markdown and HTML show it as it is, on one line."""
    line = escape(" ".join(text.split()), quote=False)
    return re.sub(r"([\\`*_\[\]|#])", r"\\\1", line)
