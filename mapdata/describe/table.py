"""One row per map: all items of the paper, for tables, the paper's CSV and the Hugging Face Hub."""

from __future__ import annotations

from typing import Any

import numpy as np

from mapdata.arrays import Ints
from mapdata.limits import SPLITS
from mapdata.search.api import SEARCHES
from mapdata.search.labels import Labels
from mapdata.shards.arrays import Shard, decode


def map_row(labels: Labels, k: int, resolution: float) -> dict[str, Any]:
    """Return the items of map ``k`` of a batch as plain Python values.

    The names are short for those of the lists in sections 3 and 4 of arXiv 2110.13242; ``bfs`` or
    ``astar`` stands before what a search found. A path is the whole route, the cell where two
    segments meet once, and its iterations are those of all segments.

    Not the paper's are ``split``, ``rooms``, ``reachable`` and ``all_connected``;
    ``segment_iterations``, one number per segment; and ``path_gaps``, for each segment without a
    path the number of cells before it. There the line jumps, and ``np.split(row_path, path_gaps)``
    gives the pieces that can be walked.

    Args:
        labels: of the batch.
        k: which of its maps.
        resolution: metres per cell.
    """
    maps = labels.maps
    rooms = int(maps.rooms[k])
    passages = rooms - 1
    # all arrays are padded to the most rooms of the batch
    seed_rows, seed_columns = maps.seed_points[k, :rooms].T.tolist()
    size_rows, size_columns = maps.sizes[k, :rooms].T.tolist()
    first, last = maps.segment_offsets[k : k + 2]
    row = {
        "item": int(maps.index[k]),
        "label": f"map{maps.index[k]}",
        "split": SPLITS[maps.split[k]],
        "resolution": resolution,
        "rooms": rooms,
        "passage_size": int(maps.passage_width[k]),
        "seed_rows": seed_rows,
        "seed_columns": seed_columns,
        "size_rows": size_rows,
        "size_columns": size_columns,
        "direction_for_passages": maps.directions[k, :passages].reshape(-1).tolist(),
        "connected": maps.connected[k, :passages].tolist(),
        "reachable": labels.reachable[first:last].tolist(),
        "all_connected": bool(labels.all_connected[k]),
    }
    for search in SEARCHES:
        route = labels.route(search, k)
        iterations = labels.iterations(search, k)
        rows, columns = joined(route).T.tolist()
        row |= {
            f"{search}_row_path": rows,
            f"{search}_column_path": columns,
            f"{search}_path_gaps": gaps(route),
            f"{search}_iterations": int(iterations.sum()),
            f"{search}_segment_iterations": iterations.tolist(),
            f"{search}_connection_matrix": labels.matrix(search, k).tolist(),
        }
    return row


def map_rows(shard: Shard, split: str | None, maps: int, first: int) -> list[dict[str, Any]]:
    """Return the rows of a shard's first ``maps``, with spaces in the column names.

    Of one split, or all with None. The root's first map has the number ``first``.
    """
    labels = decode(shard)
    labels.maps.index[:] += first
    rows = []
    for k, code in enumerate(labels.maps.split[:maps].tolist()):
        if split in (None, SPLITS[code]):
            row = map_row(labels, k, shard.header.resolution)
            rows.append({name.replace("_", " "): value for name, value in row.items()})
    return rows


def joined(route: list[Ints]) -> Ints:
    """Return the segments of a route, each (k, 2), as one path without repeated joints."""
    cells = np.concatenate([np.empty((0, 2), np.int64), *route])
    kept = np.ones(len(cells), np.bool_)
    # no segment stays on a cell, so a cell that repeats the one before it is a joint
    kept[1:] = (cells[1:] != cells[:-1]).any(axis=1)
    return cells[kept]


def gaps(route: list[Ints]) -> list[int]:
    """Return, for each segment without a path, how many cells of the `joined` line precede it."""
    return [len(joined(route[:q])) for q, segment in enumerate(route) if len(segment) == 0]
