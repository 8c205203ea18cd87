"""The report: one page to look at a dataset, without a server and without a network.

`report.html` is the template. The maps travel in it as one block of JSON, compressed, in base64.
The page allows no script but its own, whatever text the dataset holds: its policy names the hashes
of script and style, which a test compares.
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
from mapdata.plotting.figures import figure_of, plot_distribution
from mapdata.plotting.plot import new_axes
from mapdata.search.api import SEARCHES
from mapdata.search.labels import Labels
from mapdata.shards.locations import Locations

MAPS = 500
"""Maps in the browser of a report."""


def report(root: Locations, maps: int = MAPS, *, progress: bool = False) -> str:
    """Return the report of a dataset as one HTML page: maps, distributions and the card.

    Args:
        root: folder or URL of the dataset, or several.
        maps: how many maps the browser shows, evenly spaced over the dataset.
        progress: show a progress bar.

    Raises:
        DatasetNotFoundError: there is no dataset under ``root``.
        ShardError: a shard is missing or damaged.
        ValueError: ``maps`` is less than one.
    """
    check_count("maps", maps)
    of = dataset_statistics(root, repeats=True, progress=progress)
    first, *others = sections(of)
    count = min(maps, len(of))
    places = np.arange(count) * len(of) // max(count, 1)
    charts = [_chart(name, column) for name, column in of.distributions().items() if len(column)]
    template = files("mapdata.plotting").joinpath("report.html").read_text(encoding="utf-8")
    values = {
        "TITLE": escape(title(of)),
        "INTRODUCTION": f"<p>{escape(first.text)}</p>",
        "SAMPLED": f"{count:,} of {len(of):,} maps, evenly spaced.",
        "CHARTS": "".join(charts),
        "CARD": "".join(map(_html, others)),
        "DATA": b64encode(_pack(of, places)).decode(),
    }
    # one pass: text that looks like a mark stays text
    return re.sub("@@([A-Z]+)@@", lambda match: values[match[1]], template)


def _pack(of: DatasetStatistics, places: Ints) -> bytes:
    """Return what the page's script reads: the maps at ``places`` as compressed JSON."""
    root = of.root
    wanted = set(places)
    maps = []
    every = ((labels, i) for labels in root.labels() for i in range(len(labels.maps)))
    for place, (labels, i) in enumerate(every):
        if place in wanted:
            values = {"free": of.free[place], "hardest": of.hardest[place]}
            maps.append(_shown(labels, i) | values)
    page = {
        "size": root.map_size,
        "connectivity": root.movement.connectivity,
        "resolution": "/".join(sorted({f"{each.resolution:g}" for each in root.manifests})),
        "word": f"{of.noun}s",
        "maps": maps,
    }
    # numpy's numbers and arrays become plain ones
    text = json.dumps(page, default=lambda value: value.tolist())
    return zlib.compress(text.encode(), 9)


def _shown(labels: Labels, i: int) -> dict[str, Any]:
    """Return what the page shows of map ``i`` of a batch."""
    maps = labels.maps
    n = maps.rooms[i]
    grids = unpacked(maps.packed[i : i + 1], maps.columns)
    shown = {
        "index": maps.index[i],
        "cells": np.packbits(grids, axis=2).tobytes().hex(),  # four in a digit
        "split": maps.split[i],
        "connected": labels.all_connected[i],
        "width": maps.passage_width[i],
        "seeds": maps.seed_points[i, :n],
        "sizes": maps.sizes[i, :n],
        "directions": maps.directions[i, : n - 1],
    }
    first, last = maps.segment_offsets[i : i + 2]
    for name in SEARCHES:
        search = labels.of(name)
        bounds = pairwise(search.offsets[first : last + 1])
        shown[name] = {
            "moves": ["".join(map(str, search.moves[a:b].tolist())) for a, b in bounds],
            "iterations": labels.iterations(name, i),
            "matrix": np.triu(labels.matrix(name, i).round(2)),  # it is symmetric
        }
    return shown


def _html(section: Section) -> str:
    """Return a section of the card as HTML."""
    name = escape(section.title)
    parts = [f"<h2>{name}</h2>"]
    if section.text:
        parts.append(f"<p>{escape(section.text)}</p>")
    if section.table:
        head, *rows = section.table
        lines = [_tags('th scope="row"', row[:1]) + _tags("td", row[1:]) for row in rows]
        if any(head):
            lines.insert(0, _tags('th scope="col"', head))
        body = "".join(f"<tr>{line}</tr>" for line in lines)
        region = f'<div class="scroll" tabindex="0" role="region" aria-label="{name}">'
        parts.append(f"{region}<table>{body}</table></div>")
    if section.code:
        parts.append(f'<pre tabindex="0"><code>{escape(section.code)}</code></pre>')
    return "\n".join(parts)


def _tags(tag: str, cells: Sequence[str]) -> str:
    return "".join(f"<{tag}>{escape(cell)}</{tag[:2]}>" for cell in cells)


def _chart(name: str, values: Floats) -> str:
    """Return a histogram as HTML: a picture, with words for those who do not see it."""
    import matplotlib

    (ax,) = new_axes(size=(4.6, 3))
    plot_distribution(name, values, ax)
    image = BytesIO()
    # Text stays text, so that the picture is small; the same salt and no date make it the same
    # again.
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "mapdata"}):
        figure_of(ax).savefig(image, format="svg", transparent=True, metadata={"Date": None})
    data = b64encode(image.getvalue()).decode()
    words = (
        f"{name}: mean {values.mean():.4g}, median {np.median(values):.4g}, "
        f"from {values.min():.4g} to {values.max():.4g}, {len(values):,} "
        f"{ax.get_ylabel().split()[0]}"
    )
    return (
        f'<figure><img src="data:image/svg+xml;base64,{data}" alt="{escape(words)}">'
        f"<figcaption>{escape(words)}</figcaption></figure>"
    )
