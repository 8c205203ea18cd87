"""Tables with a row per map, which holds all items of the paper's dataset."""

from __future__ import annotations

from typing import Any

import numpy as np

from mapdata.arrays import Ints
from mapdata.limits import SPLITS
from mapdata.search.api import SEARCHES
from mapdata.search.labels import Labels
from mapdata.shards.arrays import Shard, decode


def map_row(labels: Labels, k: int, resolution: float) -> dict[str, Any]:
    """Return the items of map ``k`` of a batch as plain Python values, by name.

    The names are short forms of those in sections 3 and 4 of arXiv 2110.13242; items of a search
    begin with ``bfs`` or ``astar``. A path is the whole route. The cell where two segments meet is
    in it once, and its iterations are those of all segments.

    Some items are not in the paper: ``split``, ``rooms``, ``reachable`` and ``all_connected``;
    ``segment_iterations``, a number per segment; and ``path_gaps``, for each segment without a path
    the number of cells before it. The path is interrupted there, and
    ``np.split(row_path, path_gaps)`` returns its connected parts.

    Args:
        labels: labelled maps of the batch.
        k: index of the map in the batch.
        resolution: metres per cell.
    """
    maps = labels.maps
    rooms = int(maps.rooms[k])
    passages = rooms - 1
    # The rows of a map are padded to the largest number of rooms of the batch.
    seed_rows, seed_columns = maps.seed_points[k, :rooms].T.tolist()
    size_rows, size_columns = maps.sizes[k, :rooms].T.tolist()
    first_segment, end_segment = maps.segment_offsets[k : k + 2]
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
        "reachable": labels.reachable[first_segment:end_segment].tolist(),
        "all_connected": bool(labels.all_connected[k]),
    }
    for search in SEARCHES:
        route = labels.route(search, k)
        iterations = labels.iterations(search, k)
        rows, columns = join_segments(route).T.tolist()
        row |= {
            f"{search}_row_path": rows,
            f"{search}_column_path": columns,
            f"{search}_path_gaps": path_gaps(route),
            f"{search}_iterations": int(iterations.sum()),
            f"{search}_segment_iterations": iterations.tolist(),
            f"{search}_connection_matrix": labels.matrix(search, k).tolist(),
        }
    return row


def map_rows(
    shard: Shard, split: str | None, max_maps: int, first_index: int
) -> list[dict[str, Any]]:
    """Return the rows of the first maps of a shard, with spaces in the names of the columns.

    Args:
        shard: the shard.
        split: only maps of this split; None for all splits.
        max_maps: how many maps of the shard, of any split, are looked at.
        first_index: number that is added to the map numbers of the shard.
    """
    labels = decode(shard)
    labels.maps.index[:] += first_index
    rows = []
    for k, code in enumerate(labels.maps.split[:max_maps].tolist()):
        if split is None or split == SPLITS[code]:
            row = map_row(labels, k, shard.header.resolution)
            rows.append({name.replace("_", " "): item for name, item in row.items()})
    return rows


def join_segments(route: list[Ints]) -> Ints:
    """Return the segments of a route, (k, 2) each, as one path; shared ends are not repeated."""
    cells = np.concatenate([np.empty((0, 2), np.int64), *route])
    is_kept = np.ones(len(cells), np.bool_)
    # Segments never repeat a cell, so two equal cells in a row are the end of a segment and the
    # start of the next one.
    is_kept[1:] = (cells[1:] != cells[:-1]).any(axis=1)
    return cells[is_kept]


def path_gaps(route: list[Ints]) -> list[int]:
    """Return, for each segment without a path, the number of cells before it in the joined path."""
    return [len(join_segments(route[:q])) for q, segment in enumerate(route) if len(segment) == 0]
