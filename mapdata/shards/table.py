"""A row a map: all items of the paper, for tables, the paper's CSV and the Hub."""

from __future__ import annotations

from typing import Any

import numpy as np

from mapdata.arrays import Ints
from mapdata.search.labels import Labels
from mapdata.shards.shard import Shard, decode
from mapdata.spec import SPLITS

SEARCHES = ("bfs", "astar")


def map_row(labels: Labels, k: int, resolution: float) -> dict[str, Any]:
    """Return the items of map ``k`` of a batch as plain values.

    The names are those of arXiv 2110.13242, section III-D, with underscores, and ``bfs`` and
    ``astar`` before what a search found. Paths are the route, joined without its repeated joints;
    iterations are one number a segment.
    """
    maps = labels.maps
    rooms = int(maps.rooms[k])
    passages = rooms - 1
    first = int(maps.segment_offsets[k])
    row: dict[str, Any] = {
        "item": int(maps.index[k]),
        "label": f"map{maps.index[k]}",
        "split": SPLITS[maps.split[k]],
        "resolution": resolution,
        "rooms": rooms,
        "passage_size": int(maps.passage_width[k]),
        "seed_rows": maps.seed_points[k, :rooms, 0].tolist(),
        "seed_columns": maps.seed_points[k, :rooms, 1].tolist(),
        "size_rows": maps.sizes[k, :rooms, 0].tolist(),
        "size_columns": maps.sizes[k, :rooms, 1].tolist(),
        "direction_for_passages": maps.directions[k, :passages].reshape(-1).tolist(),
        "connected": maps.connected[k, :passages].tolist(),
        "reachable": labels.reachable[first : first + passages].tolist(),
        "all_connected": bool(labels.all_connected[k]),
    }
    for search in SEARCHES:
        cells = joined(labels.route(search, k))
        row[f"{search}_row_path"] = cells[:, 0].tolist()
        row[f"{search}_column_path"] = cells[:, 1].tolist()
        row[f"{search}_iterations"] = labels.iterations(search, k).tolist()
        row[f"{search}_connection_matrix"] = labels.matrix(search, k).tolist()
    return row


def map_rows(shard: Shard, split: str | None = None) -> list[dict[str, Any]]:
    """Return the rows of the maps of a shard, those of one split or all, with spaces in their
    names.
    """
    labels = decode(shard)
    codes = labels.maps.split
    wanted = (
        range(len(codes))
        if split is None
        else np.flatnonzero(codes == SPLITS.index(split)).tolist()
    )
    rows = [map_row(labels, k, shard.header.resolution) for k in wanted]
    return [{name.replace("_", " "): value for name, value in row.items()} for row in rows]


def joined(route: list[Ints]) -> Ints:
    """Return the segments of a route, each (k, 2), as one path, the cell where two of them meet
    once.
    """
    cells = np.concatenate([np.empty((0, 2), np.int64), *route])
    kept = np.ones(len(cells), np.bool_)
    # no segment stays on a cell, so a cell that repeats the one before it is a joint
    kept[1:] = (cells[1:] != cells[:-1]).any(axis=1)
    return cells[kept]
