"""A row a map: all items of the paper under its names, for pandas."""

from __future__ import annotations

from typing import Any

import numpy as np

from mapdata.shards.shard import Shard, decode
from mapdata.spec import SPLITS


def map_rows(shard: Shard, split: str | None = None) -> list[dict[str, Any]]:
    """Return the items of the maps of a shard, those of one split or all.

    The names are those of arXiv 2110.13242, section III-D, with ``bfs`` and ``astar`` before what a planner found.
    Paths are the route, joined without its repeated joints; iterations are one number a segment.
    """
    labels = decode(shard)
    maps, rows = labels.maps, []
    for i in range(len(maps)):
        if split is not None and maps.split[i] != SPLITS.index(split):
            continue
        n, first = int(maps.rooms[i]), int(maps.segment_offsets[i])
        row: dict[str, Any] = {
            "item": int(maps.index[i]),
            "label": f"map{maps.index[i]}",
            "split": SPLITS[maps.split[i]],
            "resolution": shard.header.resolution,
            "rooms": n,
            "passage size": int(maps.passage_width[i]),
            "seed rows": maps.seed_points[i, :n, 0].tolist(),
            "seed columns": maps.seed_points[i, :n, 1].tolist(),
            "size rows": maps.sizes[i, :n, 0].tolist(),
            "size columns": maps.sizes[i, :n, 1].tolist(),
            "direction for passages": maps.directions[i, : n - 1].reshape(-1).tolist(),
            "connected": maps.connected[i, : n - 1].tolist(),
            "reachable": labels.reachable[first : first + n - 1].tolist(),
            "all connected": bool(labels.all_connected[i]),
        }
        for search in ("bfs", "astar"):
            cells = joined(labels.route(search, i))
            row[f"{search} row path"] = cells[:, 0].tolist()
            row[f"{search} column path"] = cells[:, 1].tolist()
            row[f"{search} iterations"] = labels.iterations(search, i).tolist()
            row[f"{search} connection matrix"] = labels.matrix(search, i).tolist()
        rows.append(row)
    return rows


def joined(route: list[Any]) -> Any:  # noqa: ANN401
    """Return the segments of a route as one path (k, 2), the cell where two of them meet once."""
    cells = np.concatenate([np.empty((0, 2), np.int64), *route])
    repeated = np.zeros(len(cells), np.bool_)
    end = 0
    for segment in route:
        if end and len(segment) and (cells[end - 1] == segment[0]).all():
            repeated[end] = True
        end += len(segment)
    return cells[~repeated]
