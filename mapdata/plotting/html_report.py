"""The report: an HTML page to browse a dataset, without a server and without a network.

`report.html` is the template. The maps are in the page as JSON, compressed and in base64. The page
runs no script but its own, whatever text the dataset holds: its content security policy names the
hashes of the script and the style, and a test compares them.
"""

from __future__ import annotations

import json
import re
import zlib
from base64 import b64encode
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from io import BytesIO
from itertools import pairwise
from typing import Any

import numpy as np

from mapdata.arrays import Floats, Ints
from mapdata.checks import check_count
from mapdata.describe.dataset_card import Section, sections, title
from mapdata.describe.statistics import DatasetStatistics, dataset_statistics
from mapdata.generators.maps import unpacked
from mapdata.plotting.figures import parent_figure, plot_distribution
from mapdata.plotting.plot import new_axes
from mapdata.search.api import SEARCHES
from mapdata.search.labels import Labels
from mapdata.shards.locations import Locations

MAPS = 500
"""Default number of maps in a report."""


def report(
    root: Locations, maps: int = MAPS, *, follow_links: bool = False, progress: bool = False
) -> str:
    """Return the report of a dataset as one HTML page: maps, distributions and the card.

    Args:
        root: folder or URL of the dataset, or several.
        maps: number of maps in the page, evenly spaced over the dataset.
        follow_links: read files that are links out of their folder.
        progress: show a progress bar.

    Raises:
        DatasetNotFoundError: there is no dataset under ``root``.
        ShardError: a shard is missing or damaged.
        ValueError: ``maps`` is less than one.
    """
    check_count("maps", maps)
    statistics = dataset_statistics(
        root, repeats=True, follow_links=follow_links, progress=progress
    )
    introduction, *card_sections = sections(statistics)
    total = len(statistics)
    count = min(maps, total)
    positions = np.arange(count) * total // max(count, 1)
    charts = [
        _chart_html(name, values)
        for name, values in statistics.distributions().items()
        if len(values)
    ]
    template = files("mapdata.plotting").joinpath("report.html").read_text(encoding="utf-8")
    texts = {
        "TITLE": escape(title(statistics)),
        "INTRODUCTION": f"<p>{escape(introduction.text)}</p>",
        "SAMPLED": f"{count:,} of {total:,} maps, evenly spaced.",
        "CHARTS": "".join(charts),
        "CARD": "".join(_section_html(section) for section in card_sections),
        "DATA": b64encode(_compressed_maps(statistics, positions)).decode(),
    }
    # All marks are replaced in one pass, so that a text of the dataset that looks like a mark is
    # not replaced.
    return re.sub("@@([A-Z]+)@@", lambda match: texts[match[1]], template)


def _compressed_maps(statistics: DatasetStatistics, positions: Ints) -> bytes:
    """Return the maps for the page's script, as compressed JSON.

    Args:
        statistics: of the dataset.
        positions: (n,) of the maps, counted over all parts of the dataset.
    """
    root = statistics.root
    selected = set(positions.tolist())
    maps = []
    position = 0
    for labels in root.labels():
        for i in range(len(labels.maps)):
            if position in selected:
                entry = _map_entry(labels, i)
                entry["free"] = statistics.free[position]
                entry["hardest"] = statistics.hardest[position]
                maps.append(entry)
            position += 1
    page = {
        "size": root.map_size,
        "connectivity": root.movement.connectivity,
        "resolution": "/".join(sorted({f"{manifest.resolution:g}" for manifest in root.manifests})),
        "word": f"{statistics.noun}s",
        "maps": maps,
    }
    # JSON knows no numpy arrays and numbers, so these are converted.
    text = json.dumps(page, default=lambda array: array.tolist())
    return zlib.compress(text.encode(), 9)


def _map_entry(labels: Labels, i: int) -> dict[str, Any]:
    """Return the JSON entry of map ``i`` of a batch; the page's script knows its keys."""
    maps = labels.maps
    rooms = maps.rooms[i]
    grids = unpacked(maps.packed[i : i + 1], maps.columns)
    entry = {
        "index": maps.index[i],
        "cells": np.packbits(grids, axis=2).tobytes().hex(),  # a hexadecimal digit is four cells
        "split": maps.split[i],
        "connected": labels.all_connected[i],
        "width": maps.passage_width[i],
        "seeds": maps.seed_points[i, :rooms],
        "sizes": maps.sizes[i, :rooms],
        "directions": maps.directions[i, : rooms - 1],
    }
    first_segment, end_segment = maps.segment_offsets[i : i + 2]
    for name in SEARCHES:
        search_labels = labels.by_search(name)
        bounds = pairwise(search_labels.offsets[first_segment : end_segment + 1])
        entry[name] = {
            "moves": [
                "".join(map(str, search_labels.moves[start:end].tolist())) for start, end in bounds
            ],
            "iterations": labels.iterations(name, i),
            # The matrix is symmetric, so its upper triangle suffices.
            "matrix": np.triu(labels.matrix(name, i).round(2)),
        }
    return entry


def _section_html(section: Section) -> str:
    """Return a section of the card as HTML."""
    name = escape(section.title)
    parts = [f"<h2>{name}</h2>"]
    if section.text:
        parts.append(f"<p>{escape(section.text)}</p>")
    if section.table:
        head, *rows = section.table
        lines = [
            _cells_html('th scope="row"', row[:1]) + _cells_html("td", row[1:]) for row in rows
        ]
        if any(head):
            lines.insert(0, _cells_html('th scope="col"', head))
        body = "".join(f"<tr>{line}</tr>" for line in lines)
        region = f'<div class="scroll" tabindex="0" role="region" aria-label="{name}">'
        parts.append(f"{region}<table>{body}</table></div>")
    if section.code:
        parts.append(f'<pre tabindex="0"><code>{escape(section.code)}</code></pre>')
    return "\n".join(parts)


def _cells_html(tag: str, cells: Sequence[str]) -> str:
    """Return cells of a table as HTML; ``tag`` is "td" or "th", perhaps with attributes."""
    end_tag = tag[:2]
    return "".join(f"<{tag}>{escape(cell)}</{end_tag}>" for cell in cells)


def _chart_html(name: str, values: Floats) -> str:
    """Return a histogram as HTML: a picture, and a text of its statistics for blind readers.

    Args:
        name: of the distribution.
        values: (n,), one for each map or segment.
    """
    import matplotlib

    (ax,) = new_axes(size=(4.6, 3))
    plot_distribution(name, values, ax)
    image = BytesIO()
    # With "none", texts are stored as text and not as outlines, so that the picture is small. A
    # fixed salt and no date make equal datasets give equal pages.
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "mapdata"}):
        parent_figure(ax).savefig(image, format="svg", transparent=True, metadata={"Date": None})
    svg = b64encode(image.getvalue()).decode()
    description = (
        f"{name}: mean {values.mean():.4g}, median {np.median(values):.4g}, "
        f"from {values.min():.4g} to {values.max():.4g}, {len(values):,} "
        f"{ax.get_ylabel().split()[0]}"
    )
    return (
        f'<figure><img src="data:image/svg+xml;base64,{svg}" alt="{escape(description)}">'
        f"<figcaption>{escape(description)}</figcaption></figure>"
    )
