"""The arrays of a shard: converting labels to arrays and back, and packing moves into bits."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mapdata.arrays import Array, Bytes, Flags, Ints
from mapdata.generators.maps import Maps
from mapdata.movement import Movement
from mapdata.search.api import SEARCHES
from mapdata.search.labels import Labels, RouteLabels
from mapdata.shards.header import Header


class StoredDataset(NamedTuple):
    """An HDF5 dataset of a shard, with the attributes that explain it to readers of the file."""

    name: str
    dtype: str
    rank: int
    description: str
    units: str
    encoding: str


# Parts of descriptions, which are stored in the files.

_CELL_UNITS = "cells, (row, col), origin upper left"

_ROOM_ROWS = "a row a room; -1 unknown"

_BIT_ENCODING = "bits: column c is bit c % 8 of byte c // 8 of its row"

_LEG_CODES = "1 horizontal, 0 vertical, -1 no passage"

_PAIR_ORDER = (
    "pairs i < j of a map in row-major order "
    "(the condensed form of scipy.spatial.distance.squareform)"
)

_MOVE_ENCODING = (
    "packed, lowest bits first: 2 bits a move under 4-connectivity, else 4; "
    "0..7 = N E S W NE SE SW NW"
)


def _search_datasets(search: str, name: str) -> tuple[StoredDataset, ...]:
    """Return the datasets with the labels of a search.

    ``search`` is the prefix of their names, ``name`` the search's name in the descriptions.
    """
    offsets = f"first move of each segment by {name}"
    moves = f"moves from room q to room q + 1 by {name}"
    iterations = f"iterations of {name}, a segment"
    straight = f"straight moves of {name}"
    return (
        StoredDataset(f"{search}_offsets", "<i8", 1, offsets, "moves", "S + 1 offsets"),
        StoredDataset(f"{search}_moves", "u1", 1, moves, "code", _MOVE_ENCODING),
        StoredDataset(f"{search}_iterations", "<i4", 1, iterations, "cells taken", "plain"),
        StoredDataset(
            f"{search}_straight", "<i4", 1, straight, "moves", f"{_PAIR_ORDER}; -1 no path"
        ),
    )


_DIAGONAL_ENCODING = f"{_PAIR_ORDER}; empty under 4-connectivity"

_PAIR_OFFSETS = f"N + 1 offsets; {_PAIR_ORDER}"

DATASETS = (
    StoredDataset("maps", "u1", 3, "occupancy", "1 occupied, 0 free", _BIT_ENCODING),
    StoredDataset("split", "u1", 1, "split of each map", "code", "0 train, 1 val, 2 test"),
    StoredDataset(
        "passage_width", "<i2", 1, "width of the passages of each map", "cells", "-1 unknown"
    ),
    StoredDataset("room_offsets", "<i8", 1, "first room of each map", "rooms", "N + 1 offsets"),
    StoredDataset(
        "pair_offsets", "<i8", 1, "first pair of rooms of each map", "pairs", _PAIR_OFFSETS
    ),
    StoredDataset("seeds", "<i2", 2, "seed point of each room", _CELL_UNITS, "a row a room"),
    StoredDataset("sizes", "<i2", 2, "rows and columns of each room as drawn", "cells", _ROOM_ROWS),
    StoredDataset("directions", "i1", 2, "legs at A and B of each passage", "code", _LEG_CODES),
    *_search_datasets("bfs", "breadth-first search"),
    *_search_datasets("astar", "A*"),
    StoredDataset(
        "astar_diagonal", "<i4", 1, "diagonal moves of A*, a pair", "moves", _DIAGONAL_ENCODING
    ),
)
"""All datasets of a shard of maps without terrain, in the order of the file.

``bfs_straight`` counts all moves of BFS.
"""

_HALF_UNITS = "half units: a move counts the sum of the costs of its two cells"

_STRAIGHT_ON_TERRAIN = StoredDataset(
    "astar_straight",
    "<i4",
    1,
    "sum S over the straight moves of A*; over all moves where diagonals cost 1",
    _HALF_UNITS,
    f"{_PAIR_ORDER}; -1 no path",
)

_DIAGONAL_ON_TERRAIN = StoredDataset(
    "astar_diagonal",
    "<i4",
    1,
    "sum D over the diagonal moves of A*, a pair: the cost of a path is (S + D * sqrt(2)) / 2",
    _HALF_UNITS,
    f"{_DIAGONAL_ENCODING}; 0 where diagonals cost 1",
)

_TERRAIN = StoredDataset(
    "terrain", "u1", 3, "cost of each cell", "1 to 255 free, 0 occupied", "plain"
)


def _on_terrain(datasets: tuple[StoredDataset, ...]) -> tuple[StoredDataset, ...]:
    """Return the datasets of a shard of maps with terrain, given those of one without it."""
    replaced = {"astar_straight": _STRAIGHT_ON_TERRAIN, "astar_diagonal": _DIAGONAL_ON_TERRAIN}
    maps, *labels = datasets
    return maps, _TERRAIN, *(replaced.get(stored.name, stored) for stored in labels)


TERRAIN_DATASETS = _on_terrain(DATASETS)
"""All datasets of a shard of maps with terrain, in the order of the file."""


def datasets_of(has_terrain: bool) -> tuple[StoredDataset, ...]:
    """Return all datasets of a shard whose maps have terrain or not, in the order of the file."""
    return TERRAIN_DATASETS if has_terrain else DATASETS


MAX_STORED_COST = 2**31 - 1
"""Largest cost of a pair, in half units, that a shard can hold.

Only paths of millions of cells with costs near 255 cost more, and only where diagonals cost 1 or do
not exist: elsewhere `label` refuses costs from 2**21 half units on.
"""


class Shard(NamedTuple):
    """A checked shard.

    Attributes:
        path: the file.
        header: which maps the shard holds.
        content_hash: of its maps and labels, as the file states it.
        arrays: the arrays of `datasets_of` its maps by name, views of a memory mapping of the file.
    """

    path: Path
    header: Header
    content_hash: str
    arrays: Mapping[str, Array]

    def __repr__(self) -> str:
        return f"Shard({self.path}, {self.header}, content_hash={self.content_hash})"


def encode(labels: Labels) -> dict[str, Array]:
    """Return labelled maps as the arrays of a shard.

    Raises:
        ValueError: a path on terrain costs more than a shard can hold; the message names the map.
    """
    maps = labels.maps
    _check_costs(labels)
    # The rows of a map are padded to the largest number of rooms; a file has no padding.
    max_rooms = maps.seed_points.shape[1]
    is_room = np.arange(max_rooms) < maps.rooms[:, None]
    is_passage = is_room[:, 1:]
    arrays: dict[str, Array] = {
        "maps": maps.packed.astype("<u8", copy=False).view(np.uint8),
        "split": maps.split,
        "passage_width": maps.passage_width,
        "room_offsets": maps.segment_offsets + np.arange(len(maps) + 1),
        "pair_offsets": maps.pair_offsets,
        "seeds": maps.seed_points[is_room],
        "sizes": maps.sizes[is_room],
        "directions": maps.directions[is_passage],
    }
    for name in SEARCHES:
        search = labels.by_search(name)
        arrays |= {
            f"{name}_offsets": search.offsets,
            f"{name}_moves": pack_moves(search.moves, bits_per_move(maps.movement)),
            f"{name}_iterations": search.iterations,
            f"{name}_straight": search.costs[:, 0],
        }
    # BFS counts moves of any direction, so only A* has a number of diagonal moves.
    diagonal_moves = labels.astar.costs[:, 1]
    if maps.movement.connectivity == 4:
        diagonal_moves = np.empty(0, diagonal_moves.dtype)
    arrays["astar_diagonal"] = diagonal_moves
    if maps.terrain is not None:
        arrays["terrain"] = maps.terrain
    return arrays


def _check_costs(labels: Labels) -> None:
    """Refuse labels with a cost that does not fit the int32 of a shard."""
    is_high = (labels.astar.costs > MAX_STORED_COST).any(axis=1)
    if is_high.any():
        pair = int(is_high.argmax())
        k = int(np.searchsorted(labels.maps.pair_offsets, pair, side="right")) - 1
        cost = labels.astar.costs[pair].max() / 2
        raise ValueError(
            f"map {labels.maps.index[k]}: terrain: a path costs {cost:,.0f}, and a shard holds "
            f"costs up to {MAX_STORED_COST // 2:,}: divide the terrain by a number"
        )


def decode(shard: Shard) -> Labels:
    """Return the labelled maps of a shard."""
    arrays = shard.arrays
    header = shard.header
    rooms = np.diff(arrays["room_offsets"])
    # The rows of a map are padded to the largest number of rooms, as in labels that are not stored.
    max_rooms = rooms.max(initial=2)
    is_room = np.arange(max_rooms) < rooms[:, None]
    is_passage = is_room[:, 1:]
    maps = Maps(
        movement=header.movement,
        columns=header.map_size[1],
        index=np.arange(header.start, header.stop),
        packed=np.array(arrays["maps"]).view("<u8"),
        rooms=rooms,
        passage_width=arrays["passage_width"].astype(np.int64),
        seed_points=_padded(arrays["seeds"], is_room),
        sizes=_padded(arrays["sizes"], is_room),
        directions=_padded(arrays["directions"], is_passage),
        split=np.array(arrays["split"]),
        terrain=np.array(arrays["terrain"]) if header.has_terrain else None,
    )
    return Labels(maps, _search_labels(shard, "bfs"), _search_labels(shard, "astar"))


def _padded(rows: Array, is_used: Flags) -> Ints:
    """Return an array (N, R, 2) with the ``rows``, (K, 2), where ``is_used``, (N, R), is True.

    The other rows are -1.
    """
    padded = np.full((*is_used.shape, 2), -1, np.int64)
    padded[is_used] = rows
    return padded


def _search_labels(shard: Shard, search: str) -> RouteLabels:
    """Return the labels of a search, "bfs" or "astar", on the maps of a shard."""
    arrays = shard.arrays
    movement = shard.header.movement
    offsets = np.array(arrays[f"{search}_offsets"])
    straight = arrays[f"{search}_straight"]
    costs = np.zeros((len(straight), 2), np.int64)
    costs[:, 0] = straight
    if search == "astar" and movement.connectivity == 8:
        costs[:, 1] = arrays["astar_diagonal"]
    return RouteLabels(
        moves=unpack_moves(arrays[f"{search}_moves"], offsets[-1], bits_per_move(movement)),
        offsets=offsets,
        iterations=arrays[f"{search}_iterations"].astype(np.int64),
        costs=costs,
    )


def bits_per_move(movement: Movement) -> int:
    """Return the number of bits of a stored move."""
    return 2 if movement.connectivity == 4 else 4


def pack_moves(moves: Bytes, bits: int) -> Bytes:
    """Pack moves of ``bits`` bits into bytes; the first move is in the lowest bits of a byte."""
    moves_per_byte = 8 // bits
    padding = -len(moves) % moves_per_byte
    padded = np.pad(moves, (0, padding))
    packed = np.zeros(len(padded) // moves_per_byte, np.uint8)
    for k in range(moves_per_byte):
        packed |= padded[k::moves_per_byte] << bits * k
    return packed


def unpack_moves(packed: Bytes, count: int, bits: int) -> Bytes:
    """Return ``count`` moves that `pack_moves` packed."""
    shifts = np.arange(0, 8, bits, dtype=np.uint8)
    moves: Bytes = (packed[:, None] >> shifts) & (2**bits - 1)
    return moves.reshape(-1)[:count]
