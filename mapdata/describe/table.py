"""Tables with a row per map and a column for each item of the paper's dataset."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any

import numpy as np

from mapdata.arrays import Array, Ints, offsets_of
from mapdata.checks import check_choice
from mapdata.limits import SPLITS
from mapdata.search.api import SEARCHES
from mapdata.search.labels import Labels
from mapdata.shards.arrays import Shard, decode


def map_columns(
    labels: Labels, maps: Ints, resolution: float, names: Sequence[str] | None = None
) -> dict[str, list[Any]]:
    """Return items of maps as plain Python values: for each name a list with a value for each map.

    The names are short forms of those in sections 3 and 4 of arXiv 2110.13242; items of a search
    begin with ``bfs`` or ``astar``. A path is the whole route. The cell where two segments meet is
    in it once, and its iterations are those of all segments.

    Some items are not in the paper: ``split``, ``rooms``, ``reachable`` and ``all_connected``;
    ``segment_iterations``, a number per segment; and ``path_gaps``, for each segment without a path
    the number of cells before it. The path is interrupted there, and
    ``np.split(row_path, path_gaps)`` returns its connected parts.

    Args:
        labels: labelled maps of a batch.
        maps: (K,) which maps of the batch.
        resolution: metres per cell.
        names: the items, in this order; None for all of them. Only these are computed.

    Raises:
        ValueError: there is no item of a name, or a name is given twice.
    """
    return _compute(_items(labels, maps, resolution), names)


def _compute(
    items: dict[str, Callable[[], list[Any]]], names: Sequence[str] | None
) -> dict[str, list[Any]]:
    """Return the values of the items of these names, or of all."""
    if names is None:
        names = tuple(items)
    for name in names:
        check_choice("columns", name, items)
    if len(set(names)) < len(names):
        raise ValueError(f"columns: got {list(names)}, expected each name once")
    return {name: items[name]() for name in names}


def _items(labels: Labels, maps: Ints, resolution: float) -> dict[str, Callable[[], list[Any]]]:
    """Return for each item a function that computes it for some maps of a batch."""
    batch = labels.maps
    rooms = batch.rooms[maps]
    directions = batch.directions[maps]
    items: dict[str, Callable[[], list[Any]]] = {
        "item": batch.index[maps].tolist,
        "label": lambda: [f"map{index}" for index in batch.index[maps].tolist()],
        "split": lambda: [SPLITS[code] for code in batch.split[maps].tolist()],
        "resolution": lambda: [resolution] * len(maps),
        "rooms": rooms.tolist,
        "passage_size": batch.passage_width[maps].tolist,
        "seed_rows": lambda: _first_values(batch.seed_points[maps, :, 0], rooms),
        "seed_columns": lambda: _first_values(batch.seed_points[maps, :, 1], rooms),
        "size_rows": lambda: _first_values(batch.sizes[maps, :, 0], rooms),
        "size_columns": lambda: _first_values(batch.sizes[maps, :, 1], rooms),
        "direction_for_passages": lambda: _first_values(
            directions.reshape(len(maps), 2 * directions.shape[1]), 2 * (rooms - 1)
        ),
        "connected": lambda: _first_values(batch.connected[maps], rooms - 1),
        "reachable": lambda: _runs(labels.reachable, batch.segment_offsets, maps),
        "all_connected": labels.all_connected[maps].tolist,
    }
    for search in SEARCHES:
        items |= _search_items(labels, maps, search)
    return items


def _search_items(labels: Labels, maps: Ints, search: str) -> dict[str, Callable[[], list[Any]]]:
    """Return for each item of a search a function that computes it for some maps of a batch."""
    offsets = labels.maps.segment_offsets
    iterations = labels.by_search(search).iterations
    route_of = cache(partial(labels.route, search))  # Three items come from one route.

    def path(axis: int) -> list[list[int]]:
        return [join_segments(route_of(k))[:, axis].tolist() for k in maps.tolist()]

    def sums_of_iterations() -> list[int]:
        iterations_before = offsets_of(iterations)
        sums: list[int] = np.diff(iterations_before[offsets])[maps].tolist()
        return sums

    return {
        f"{search}_row_path": lambda: path(0),
        f"{search}_column_path": lambda: path(1),
        f"{search}_path_gaps": lambda: [path_gaps(route_of(k)) for k in maps.tolist()],
        f"{search}_iterations": sums_of_iterations,
        f"{search}_segment_iterations": lambda: _runs(iterations, offsets, maps),
        f"{search}_connection_matrix": lambda: [
            labels.matrix(search, k).tolist() for k in maps.tolist()
        ],
    }


def _first_values(padded: Array, counts: Ints) -> list[list[Any]]:
    """Return the first ``counts[k]`` values of each row k, without the padding of the batch."""
    return [row[:count] for row, count in zip(padded.tolist(), counts.tolist(), strict=True)]


def _runs(values: Array, offsets: Ints, maps: Ints) -> list[list[Any]]:
    """Return for each map k the values from ``offsets[k]`` to ``offsets[k + 1]``."""
    return [values[offsets[k] : offsets[k + 1]].tolist() for k in maps.tolist()]


def table_columns(
    shard: Shard,
    split: str | None,
    max_maps: int,
    first_index: int,
    names: Sequence[str] | None = None,
) -> dict[str, list[Any]]:
    """Return items of the first maps of a shard, with spaces in the names.

    Args:
        shard: the shard.
        split: only maps of this split; None for all splits.
        max_maps: how many maps of the shard, of any split, are looked at.
        first_index: number that is added to the map numbers of the shard.
        names: the items, with spaces in their names; None for all of them.
    """
    labels = decode(shard)
    labels.maps.index[:] += first_index
    codes = labels.maps.split[:max_maps]
    is_chosen = np.ones(len(codes), np.bool_) if split is None else codes == SPLITS.index(split)
    maps = np.flatnonzero(is_chosen)
    items = _items(labels, maps, shard.header.resolution)
    return _compute({name.replace("_", " "): items[name] for name in items}, names)


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
