"""The dataset card: the content of a dataset, how to build it again, and its statistics.

The card is a list of sections, which become Markdown here and HTML in `mapdata.plotting`.
"""

from __future__ import annotations

import json
import os
import re
import shlex
from collections.abc import Sequence
from html import escape
from typing import NamedTuple

import numpy as np

from mapdata._version import __version__
from mapdata.checks import printable
from mapdata.describe.problem_statistics import ProblemStatistics
from mapdata.describe.statistics import DatasetStatistics, Repeats, dataset_statistics
from mapdata.generators.generator import PRESETS, SHARED_PARAMETERS, MapGenerator
from mapdata.generators.stored_families import UnknownFamily
from mapdata.limits import SPLITS
from mapdata.movement import Movement
from mapdata.search.lattice import HARD
from mapdata.shards.dataset_files import read_provenance
from mapdata.shards.locations import Locations
from mapdata.shards.manifest import PROVENANCE, SPLIT_COUNTS, Manifest

_SIZE_CATEGORIES = ("n<1K", "1K<n<10K", "10K<n<100K", "100K<n<1M", "1M<n<10M", "10M<n<100M")
"""Size categories of the Hugging Face Hub; their bounds are 10**3, 10**4, ... 10**7 rows."""

TERRAIN_RULE = (
    "each free cell has a cost from 1 to 255; a move costs the mean of its two cells times its "
    "length"
)

_MAX_COST_ROWS = 32
"""How many rows the table of costs of cells has, at most; more costs are put together in ranges."""

_MAX_SOURCES = 10
"""How many sources of an imported dataset the card lists, at most."""

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
    """A part of the card, in plain text. All attributes but the title may be empty.

    Attributes:
        title: heading.
        text: paragraph.
        table: rows of cells; the first row is the header.
        code: block of code.
        language: language of the code, for highlighting.
    """

    title: str
    text: str = ""
    table: Sequence[Sequence[str]] = ()
    code: str = ""
    language: str = ""


def card(
    root: Locations,
    *,
    problems: ProblemStatistics | None = None,
    follow_links: bool = False,
    progress: bool = False,
) -> str:
    """Return the card of a dataset as Markdown, with the front matter of the Hugging Face Hub.

    Args:
        root: folder or URL of the dataset, or several.
        problems: what ``MapDataset(root).problem_statistics()`` returned, which becomes a section
            of the card, as in the card of ``mapdata info ROOT --card``; None leaves it out.
        follow_links: read files that are links out of their folder.
        progress: show a progress bar.

    Raises:
        DatasetNotFoundError: there is no dataset under ``root``.
        ShardError: a shard is missing or damaged.
    """
    statistics = dataset_statistics(
        root, repeats=True, follow_links=follow_links, progress=progress
    )
    introduction, *other_sections = sections(statistics, problems)
    parts = [front_matter(title(statistics), len(statistics)), _markdown(introduction, level=1)]
    parts += [_markdown(section, level=2) for section in other_sections]
    return "\n".join(parts)


def front_matter(name: str, row_count: int, **properties: object) -> str:
    """Return the YAML block that the Hugging Face Hub reads at the top of a card.

    Args:
        name: title of the dataset.
        row_count: number of maps or problems.
        **properties: further entries of the block, such as ``license``.
    """
    bounds = 10 ** np.arange(3, 8)
    entries: dict[str, object] = {
        "pretty_name": name,
        "task_categories": ["robotics"],
        "tags": ["path-planning", "occupancy-grid", "motion-planning", "mapdata"],
        "size_categories": [_SIZE_CATEGORIES[np.digitize(row_count, bounds)]],
        "annotations_creators": ["machine-generated"],
        **properties,
    }
    # JSON is also YAML, and escapes whatever a name from a file contains.
    lines = [f"{key}: {json.dumps(entry, ensure_ascii=False)}\n" for key, entry in entries.items()]
    return "---\n" + "".join(lines) + "---\n"


def title(statistics: DatasetStatistics) -> str:
    """Return the title of the card: names of the folders, number of maps and their size."""
    rows, columns = statistics.root.map_size
    names = " + ".join(_folder_names(statistics))
    return f"{names}: {len(statistics):,} grid maps of {rows} x {columns} cells"


def sections(
    statistics: DatasetStatistics, problems: ProblemStatistics | None = None
) -> list[Section]:
    """Return the sections of a dataset's card.

    Args:
        statistics: of the dataset, from `dataset_statistics` with ``repeats=True``.
        problems: statistics of the problems that are served; None leaves the section out.
    """
    root = statistics.root
    names = _folder_names(statistics)
    provenance = []
    for name, location, manifest in zip(names, root.locations, root.manifests, strict=True):
        if manifest.generator is None:
            provenance.append(_import_section(location, statistics.rooms_known, root.follow_links))
        else:
            provenance.append(_rebuild_section(name, manifest, manifest.generator))
    return [
        Section(title(statistics), _introduction(statistics)),
        _facts_section(statistics),
        *provenance,
        _splits_section(statistics),
        _shares_section(statistics),
        *_terrain_sections(statistics),
        *([] if problems is None else [_problems_section(problems)]),
        _distributions_section(statistics),
        _duplicates_section(statistics),
        _usage_section(statistics),
        Section("Citation", _citation_request(statistics), code=CITATION, language="bibtex"),
    ]


def _introduction(statistics: DatasetStatistics) -> str:
    """Return the paragraph under the title."""
    points = f"{statistics.noun}s"
    sources = [
        f"{manifest.generator.description}, made"
        if manifest.generator
        else "imported maps, labelled"
        for manifest in statistics.root.manifests
    ]
    distinct_sources = "; ".join(dict.fromkeys(sources))
    content = (
        f"Occupancy grids with shortest paths by BFS and A* between consecutive {points} and the "
        f"distances between all {points}"
    )
    if statistics.root.has_terrain:
        content = (
            "Grid maps of terrain, whose free cells have costs, with paths of fewest moves by BFS "
            f"and of least cost by A* between consecutive {points} and the costs between all "
            f"{points}"
        )
    text = f"{content}: {distinct_sources} by mapdata {__version__}."
    if len(statistics) < statistics.root.maps:
        text += f" Not finished: {statistics.root.maps:,} maps were asked for."
    return text


def _facts_section(statistics: DatasetStatistics) -> Section:
    """Return a table of facts with a column for each folder; empty rows are left out."""
    names = _folder_names(statistics)
    facts_by_folder = [_manifest_facts(manifest) for manifest in statistics.root.manifests]
    rows = [("", *names) if len(names) > 1 else ("", "")]
    for fact in facts_by_folder[0]:
        cells = [facts[fact] for facts in facts_by_folder]
        if any(cells):
            rows.append((fact, *cells))
    return Section("What it is", table=rows)


def _manifest_facts(manifest: Manifest) -> dict[str, str]:
    """Return the facts about the dataset of one manifest by name; an unknown fact is empty."""
    rows, columns = manifest.map_size
    size = sum(entry.bytes for entry in manifest.shards)
    return {
        "maps": f"{manifest.done:,} in {counted(len(manifest.shards), 'shard')}",
        "map size": f"{rows} rows x {columns} columns, {manifest.resolution:g} m per cell",
        "cells": "(row, col), origin upper left",
        "polarity": "1 occupied, 0 free",
        "terrain": TERRAIN_RULE if manifest.has_terrain else "",
        "movement": movement_text(manifest.movement, manifest.has_terrain),
        "size on disk": f"{size / 1e6:,.2f} MB",
        "format": f"mapdata shards (HDF5), version {manifest.format_version}",
        "preset": _preset_name(manifest.generator),
        "seed": "" if manifest.seed is None else str(manifest.seed),
        "identity": identity_text(manifest),
        "content hash": manifest.content_hash,
    }


def _preset_name(generator: MapGenerator | None) -> str:
    """Return the name of the preset that equals a generator; an empty text if there is none."""
    for name, preset in PRESETS.items():
        if preset == generator:
            return name
    return ""


def generator_text(generator: MapGenerator) -> str:
    """Return the preset that equals a generator, or else its family with its parameters.

    The parameters that all families share are left out.
    """
    preset = _preset_name(generator)
    if preset:
        return f"preset {preset}"
    parameters = [
        f"{name} {json.dumps(value)}"
        for name, value in generator.to_dict().items()
        if name not in ("generator", *SHARED_PARAMETERS)
    ]
    return ", ".join([f"family {generator.name}", *parameters])


def _rebuild_section(name: str, manifest: Manifest, generator: MapGenerator) -> Section:
    """Return the commands that build a dataset again in a folder ``name``.

    ``generator`` is that of the manifest.
    """
    text = (
        "Map i is a pure function of the spec, the seed and i, so these lines make the same maps "
        "and labels, bit for bit, on any machine; the command says whether the content hash agrees."
    )
    command = f"mapdata build {shlex.quote(name)} --recipe recipe.json"
    if manifest.shard_size != 1000:
        command += f" --shard-size {manifest.shard_size}"
    # Parts of a mixture may be of one family. Each family is named once, and each module.
    families = {part.name: part for part in (generator, *generator.inner_generators)}
    modules = []
    for family, part in families.items():
        module = type(part).__module__
        if isinstance(part, UnknownFamily) or module == "__main__":
            modules.append("MODULE")
            text += f" Write the module that has the family {family} in place of MODULE."
        elif not module.startswith("mapdata."):
            modules.append(module)
            text += f" The module {module} has the family {family}."
    command += "".join(f" --import {module}" for module in dict.fromkeys(modules))
    lines = ("cat > recipe.json <<'END'", manifest.recipe(), "END", command)
    return Section("Make it again", text, code="\n".join(lines), language="sh")


def _import_section(location: str, rooms_known: bool, follow_links: bool) -> Section:
    """Return where imported maps came from, as far as the import recorded it.

    Args:
        location: folder or URL of the dataset.
        rooms_known: whether the maps came with rooms; otherwise the import drew seed points.
        follow_links: read the record through a link that leads out of the folder.
    """
    try:
        provenance = read_provenance(location, follow_links)
        names = [" ".join(str(source).split()) for source in provenance.get("sources", ())]
    except (OSError, ValueError, TypeError):
        return Section(
            "Where it comes from",
            "Imported; there is no sound record of the source beside the data.",
        )
    text = f"Imported from {counted(len(names), 'source')}, all named in {PROVENANCE}. "
    if not rooms_known:
        count = provenance.get("seeds", "?")
        seed = provenance.get("seed", "?")
        text += f"Up to {count} seed points a map were drawn with seed {seed}. "
    if provenance.get("resolution_assumed"):
        text += "The source states no resolution; it was assumed. "
    text += (
        "The maps are those of the source; paths, iterations and matrices were computed by mapdata."
    )
    rows = [("map", "source")]
    rows += [(str(k), printable(name)) for k, name in enumerate(names[:_MAX_SOURCES])]
    return Section("Where it comes from", text, table=rows)


def _splits_section(statistics: DatasetStatistics) -> Section:
    """Return the numbers of maps and problems of each split."""
    entries = [shard.entry for shard in statistics.root.shards]
    rows = [["split", "maps", "route problems", "without a path", "pairs", "pairs without a path"]]
    for split in SPLITS:
        counts = [sum(entry.counts[split][name] for entry in entries) for name in SPLIT_COUNTS]
        rows.append([split, *(f"{count:,}" for count in counts)])
    text = (
        "Each map belongs to one split and keeps it when the dataset grows. A route problem is a "
        "segment between consecutive rooms (seed points), a pair any two of a map; those from a "
        "cell to itself are not counted."
    )
    return Section("Splits", text, table=rows)


def _shares_section(statistics: DatasetStatistics) -> Section:
    """Return the shares of maps and segments that are drawn, reachable, connected and hard."""
    map_count = len(statistics)
    segment_count = len(statistics.lengths)
    reachable_count = (statistics.lengths > 0).sum()
    hard_count = (statistics.hardness >= HARD).sum()
    connected_count = statistics.all_connected.sum()
    rows = [("share", "of", "")]
    if statistics.rooms_known:
        drawn_count = sum(manifest.total("drawn") for manifest in statistics.root.manifests)
        share = _share_text(drawn_count, segment_count)
        rows.append(("drawn passages", "pairs of consecutive rooms", share))
    rows += [
        ("reachable segments", "segments", _share_text(reachable_count, segment_count)),
        ("fully connected maps", "maps", _share_text(connected_count, map_count)),
    ]
    if statistics.root.has_terrain:
        # Nearly all segments on terrain are hard in this sense, so their share says nothing.
        text = (
            "Hardness is the least cost of a path over the heuristic, which walks straight at the "
            "goal over cells of the smallest cost of the map."
        )
    else:
        share = _share_text(hard_count, reachable_count)
        rows.append((f"hard segments (hardness >= {HARD:g})", "reachable segments", share))
        text = (
            "Hardness is the cost of the shortest path over the heuristic: 1 where walking "
            "straight at the goal is best."
        )
    if statistics.rooms_known:
        text += " Rooms can reach each other without a passage, where they overlap."
    return Section("Shares", text, table=rows)


def _terrain_sections(statistics: DatasetStatistics) -> list[Section]:
    """Return the section with the share of free cells of each cost; none without terrain."""
    if statistics.cell_counts is None:
        return []
    free_counts = statistics.cell_counts[1:]
    free_count = int(free_counts.sum())
    costs = np.flatnonzero(free_counts) + 1
    width = 1
    if len(costs) > _MAX_COST_ROWS:
        width = -(-256 // _MAX_COST_ROWS)
    rows = [("cost of a cell", "free cells")]
    for low in range(1, 256, width):
        high = min(low + width - 1, 255)
        cell_count = int(statistics.cell_counts[low : high + 1].sum())
        if cell_count:
            name = str(low) if width == 1 else f"{low} to {high}"
            rows.append((name, _share_text(cell_count, free_count)))
    text = f"Shares of the free cells of all maps. {TERRAIN_RULE.capitalize()}."
    return [Section("Terrain", text, table=rows)]


def _problems_section(problems: ProblemStatistics) -> Section:
    """Return what the problems are worth that are served."""
    rows = [("", ""), ("problems", problems.served), *problems.rows()]
    return Section("Problems that are served", problems.target_text(), table=rows)


def _distributions_section(statistics: DatasetStatistics) -> Section:
    """Return mean, extremes and quantiles of the properties of maps and segments."""
    samples = {
        **statistics.distributions(),
        "iterations of a segment, BFS": statistics.iterations["bfs"],
        "iterations of a segment, A*": statistics.iterations["astar"],
    }
    rows = [["", "mean", "least", "5 %", "25 %", "median", "75 %", "95 %", "most"]]
    for name, sample in samples.items():
        if len(sample):
            quantiles = np.quantile(sample, (0, 0.05, 0.25, 0.5, 0.75, 0.95, 1)).tolist()
            numbers = (sample.mean(), *quantiles)
            rows.append([name, *(f"{number:.4g}" for number in numbers)])
    text = "Segments without a path are left out, except for iterations."
    return Section("Distributions", text, rows)


def _duplicates_section(statistics: DatasetStatistics) -> Section:
    """Return the numbers of maps that equal another map, exactly and up to symmetries."""
    exact, symmetric = statistics.repeats
    symmetric_title = f"the same up to {statistics.symmetries} symmetries"
    rows = [("maps that are there already", "exactly the same", symmetric_title)]
    for split in SPLITS:
        rows.append((f"inside {split}", f"{exact.inside[split]:,}", f"{symmetric.inside[split]:,}"))
    for pair in exact.across:
        first_split, second_split = pair
        rows.append(
            (
                f"of {second_split}, also in {first_split}",
                f"{exact.across[pair]:,}",
                f"{symmetric.across[pair]:,}",
            )
        )
    return Section("Duplicates", _leak_text(exact, symmetric), table=rows)


def _leak_text(exact: Repeats, symmetric: Repeats) -> str:
    """Return whether maps are in several splits, in words."""
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


def _usage_section(statistics: DatasetStatistics) -> Section:
    """Return the code that loads the dataset."""
    names = _folder_names(statistics)
    root = repr(names[0] if len(names) == 1 else names)
    fields = ""
    grid = "map"
    if statistics.root.has_terrain:
        fields = ', fields=("terrain", "start", "goal", "path")'
        grid = "terrain"
    code = (
        "from mapdata import MapDataModule, MapDataset\n\n"
        f'train = MapDataset({root}, split="train"{fields})\n'
        f"{grid}, start, goal, path = train[0]\n"
        f"loaders = MapDataModule({root})  # for pytorch-lightning"
    )
    return Section("Use it", code=code, language="python")


def _citation_request(statistics: DatasetStatistics) -> str:
    """Return which work users of the maps are asked to cite; equal requests are written once."""
    import_request = f"Cite the source of the maps. {MapGenerator.citation}"
    generators = [manifest.generator for manifest in statistics.root.manifests]
    requests = [
        import_request if generator is None else generator.citation for generator in generators
    ]
    return " ".join(dict.fromkeys(requests))


def identity_text(manifest: Manifest) -> str:
    """Return the identity of a dataset, or what identifies imported maps in its place.

    The content hash alone does not identify them, because it covers neither resolution nor
    movement.
    """
    return manifest.identity or "none (imported): content hash, resolution and movement identify it"


def movement_text(movement: Movement, has_terrain: bool = False) -> str:
    """Return the rule of movement in words; on terrain it states lengths instead of costs."""
    unit = "of length" if has_terrain else "at cost"
    if movement.connectivity == 4:
        return f"4-connected: north, east, south, west, each {unit} 1"
    cost = "1" if movement.diagonal_cost == 1 else "sqrt 2"
    rule = "unrestricted" if movement.corner_cutting else "only beside two free cells"
    return f"8-connected: straight steps {unit} 1, diagonal steps {unit} {cost}, {rule}"


def _folder_names(statistics: DatasetStatistics) -> list[str]:
    """Return the names of the dataset's folders in printable characters."""
    names = []
    for location in statistics.root.locations:
        name = os.path.basename(os.path.abspath(location))
        names.append(printable(name) or "maps")
    return names


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, such as "1 shard" or "2,000 shards"."""
    return f"{number:,} {noun}" if number == 1 else f"{number:,} {noun}s"


def _share_text(part: int, whole: int) -> str:
    """Return the share that ``part`` is of ``whole``, in percent and as numbers."""
    return f"{part / max(whole, 1):.1%} ({part:,} of {whole:,})"


def _markdown(section: Section, level: int) -> str:
    """Return a section as Markdown with a heading of this level."""
    parts = [f"{'#' * level} {escaped(section.title)}"]
    if section.text:
        parts.append(escaped(section.text))
    if section.table:
        lines = [f"| {' | '.join(map(escaped, row))} |" for row in section.table]
        column_count = len(section.table[0])
        lines.insert(1, "|" + "---|" * column_count)
        parts.append("\n".join(lines))
    if section.code:
        # The fence is longer than any run of backticks in the code, which would end the block.
        max_run = max((len(run) for run in re.findall("`+", section.code)), default=0)
        fence = "`" * max(3, max_run + 1)
        parts.append(f"{fence}{section.language}\n{section.code}\n{fence}")
    return "\n\n".join(parts) + "\n"


def escaped(text: str) -> str:
    """Return ``text`` on one line, with the special characters of Markdown and HTML escaped."""
    line = escape(" ".join(text.split()), quote=False)
    return re.sub(r"([\\`*_\[\]|#])", r"\\\1", line)
