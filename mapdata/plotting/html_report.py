"""The report: one page to look at a dataset, without a server and without a network.

`report.html` is the template. The maps travel in it as one block: tables of numbers, compressed, in
base64; its script lists them under ``data``. The page allows no script but its own, whatever text
the dataset holds.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
import zlib
from html import escape
from importlib.resources import files
from io import StringIO
from typing import Any

import numpy as np
import numpy.typing as npt

from mapdata.arrays import Floats, Ints
from mapdata.plotting.figures import figure_of, plot_distribution
from mapdata.plotting.plot import new_axes
from mapdata.search.labels import Labels
from mapdata.shards.dataset_card import Section, sections, title
from mapdata.shards.root import Places
from mapdata.shards.shard import bits_of, pack_moves
from mapdata.shards.statistics import DatasetStatistics, dataset_statistics

MAPS = 500
"""Maps in the browser of a report."""

_TYPES = {"b": "u1", "u": "u1", "i": "i4", "f": "f8"}
"""How the page's script names the type of a table, by the kind of numbers in it."""


def report(root: Places, maps: int = MAPS, *, progress: bool = False) -> str:
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
    if maps < 1:
        raise ValueError(f"maps: got {maps}, expected at least 1")
    of = dataset_statistics(root, repeats=True, progress=progress)
    first, *others = sections(of)
    header, block = _pack(of, _sample(len(of), maps))
    count = min(maps, len(of))
    template = files("mapdata.plotting").joinpath("report.html").read_text(encoding="utf-8")
    values = {
        "POLICY": _policy(template),
        "TITLE": escape(title(of)),
        "INTRODUCTION": f"<p>{escape(first.text)}</p>",
        "SAMPLED": f"All {count:,} maps."
        if count == len(of)
        else f"{count:,} of {len(of):,} maps, evenly spaced.",
        "CHARTS": "".join(
            _chart(name, column) for name, column in of.distributions().items() if len(column)
        ),
        "CARD": "".join(map(_html, others)),
        "HEADER": escape(json.dumps(header)),
        "DATA": base64.b64encode(block).decode(),
    }
    # one pass: text that looks like a mark stays text
    return re.sub("@@([A-Z]+)@@", lambda match: values[match[1]], template)


def _policy(template: str) -> str:
    """Return the content security policy that lets only the template's own script and style run."""
    allowed = []
    for tag in ("script", "style"):
        sources = f"{tag}-src"
        for text in re.findall(f"<{tag}>(.*?)</{tag}>", template, re.DOTALL):
            digest = hashlib.sha256(text.encode()).digest()
            sources += f" 'sha256-{base64.b64encode(digest).decode()}'"
        allowed.append(sources)
    rest = "default-src 'none'; img-src data:; base-uri 'none'; form-action 'none'"
    return "; ".join([*allowed, rest])


def _sample(count: int, maps: int) -> Ints:
    """Return the places of at most ``maps`` of ``count`` maps, evenly spaced."""
    chosen = min(count, maps)
    return np.arange(chosen) * count // max(chosen, 1)


def _pack(of: DatasetStatistics, places: Ints) -> tuple[dict[str, Any], bytes]:
    """Return what the page's script must know, and the tables of the maps at ``places``."""
    root = of.root
    columns = _columns(of, places)
    tables = {}
    block = b""
    for name, values in columns.items():
        kind = _TYPES[values.dtype.kind]
        tables[name] = (kind, len(block), values.size)
        block += np.ascontiguousarray(values, f"<{kind}").tobytes()
        block += bytes(-len(block) % 8)  # where a script's array may begin
    header = {
        "tables": tables,
        "size": root.map_size,
        "bits": bits_of(root.movement),
        "diagonal": root.movement.diagonal_cost,
        "resolution": root.manifests[0].resolution,
        "word": "rooms" if of.rooms_known else "seed points",
    }
    return header, zlib.compress(block, 9)


def _columns(of: DatasetStatistics, places: Ints) -> dict[str, npt.NDArray[Any]]:
    """Return the tables of a page."""
    parts = []
    first = 0
    for k, (_, _, entry) in enumerate(of.root.shards):
        last = first + entry.stop - entry.start
        chosen = places[(places >= first) & (places < last)] - first
        if len(chosen):
            parts.append(_tables(of.root.shard_labels(k), chosen))
        first = last
    columns = {
        name: np.concatenate([part[name] for part in parts]) for name in (parts[0] if parts else ())
    }
    for name in {"bfs_moves", "astar_moves"} & columns.keys():
        columns[name] = pack_moves(columns[name], bits_of(of.root.movement))
    columns["hardest"] = of.hardest[places]
    columns["free"] = of.free[places]
    return columns


def _tables(labels: Labels, chosen: Ints) -> dict[str, npt.NDArray[Any]]:
    """Return what the page shows of maps ``chosen`` of a shard."""
    maps = labels.maps
    n = maps.rooms[chosen]
    used = np.arange(maps.seed_points.shape[1]) < n[:, None]
    segments, pairs = _ranges(maps.segment_offsets, chosen), _ranges(maps.pair_offsets, chosen)
    octets = maps.packed[chosen].astype("<u8", copy=False).view(np.uint8)
    tables: dict[str, npt.NDArray[Any]] = {
        "maps": octets[:, :, : -(-maps.columns // 8)].reshape(-1),
        "index": maps.index[chosen].astype(np.float64),  # they may be larger than 32 bits
        "split": maps.split[chosen],
        "connected": labels.all_connected[chosen],
        "rooms": n,
        "width": maps.passage_width[chosen],
        "seeds": maps.seed_points[chosen][used].reshape(-1),
        "sizes": maps.sizes[chosen][used].reshape(-1),
        "directions": maps.directions[chosen][used[:, 1:]].reshape(-1),
        "reachable": labels.reachable[segments],
        "astar_diagonal": labels.astar.costs[pairs, 1],  # BFS counts all moves as straight
    }
    for name in ("bfs", "astar"):
        search = labels.of(name)
        tables[f"{name}_steps"] = np.diff(search.offsets)[segments]
        tables[f"{name}_moves"] = search.moves[_ranges(search.offsets, segments)]
        tables[f"{name}_iterations"] = search.iterations[segments]
        tables[f"{name}_straight"] = search.costs[pairs, 0]
    return tables


def _ranges(offsets: Ints, chosen: Ints) -> Ints:
    """Return the numbers offsets[k] to offsets[k + 1] - 1 of all ``chosen`` k, in order."""
    found = [np.arange(offsets[k], offsets[k + 1]) for k in chosen.tolist()]
    return np.concatenate([np.empty(0, np.int64), *found])


def _html(section: Section) -> str:
    """Return a section of the card as HTML."""
    parts = [f"<h2>{escape(section.title)}</h2>"]
    if section.text:
        parts.append(f"<p>{escape(section.text)}</p>")
    if section.table:
        head, *rows = section.table
        lines = (
            ["".join(f'<th scope="col">{escape(cell)}</th>' for cell in head)] if any(head) else []
        )
        for name, *cells in rows:
            lines.append(
                f'<th scope="row">{escape(name)}</th>'
                + "".join(f"<td>{escape(cell)}</td>" for cell in cells)
            )
        body = "".join(f"<tr>{line}</tr>" for line in lines)
        region = (
            f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(section.title)}">'
        )
        parts.append(f"{region}<table>{body}</table></div>")
    if section.code:
        parts.append(f'<pre tabindex="0"><code>{escape(section.code)}</code></pre>')
    return "\n".join(parts)


def _chart(name: str, values: Floats) -> str:
    """Return a histogram as a picture, with words for those who do not see it."""
    import matplotlib

    (ax,) = new_axes(1, 1, (4.6, 3))
    plot_distribution(name, values, ax)
    image = StringIO()
    # Text stays text, so that the picture is small; the same salt and no date make it the same
    # again.
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "mapdata"}):
        figure_of(ax).savefig(image, format="svg", transparent=True, metadata={"Date": None})
    data = base64.b64encode(image.getvalue().encode()).decode()
    words = (
        f"{name}: mean {values.mean():.4g}, median {np.median(values):.4g}, "
        f"from {values.min():.4g} to {values.max():.4g}, {len(values):,} "
        f"{ax.get_ylabel().split()[0]}"
    )
    return (
        f'<figure><img src="data:image/svg+xml;base64,{data}" alt="{escape(words)}">'
        f"<figcaption>{escape(words)}</figcaption></figure>"
    )
