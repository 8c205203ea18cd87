"""The arrays of a shard: labels to arrays and back, moves packed into bits."""

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
    """One HDF5 dataset of a shard, with the attributes that explain it in the file."""

    name: str
    dtype: str
    rank: int
    description: str
    units: str
    encoding: str


_CELL = "cells, (row, col), origin upper left"

_OR_UNKNOWN = "a row a room; -1 unknown"

_BITS = "bits: column c is bit c % 8 of byte c // 8 of its row"

_LEGS = "1 horizontal, 0 vertical, -1 no passage"

_PAIRS = (
    "pairs i < j of a map in row-major order "
    "(the condensed form of scipy.spatial.distance.squareform)"
)

_MOVES = (
    "packed, lowest bits first: 2 bits a move under 4-connectivity, else 4; "
    "0..7 = N E S W NE SE SW NW"
)


def _search_fields(search: str, name: str) -> tuple[StoredDataset, ...]:
    """Return the datasets that hold what one search found; ``name`` is its name in words."""
    offsets = f"first move of each segment by {name}"
    moves = f"moves from room q to room q + 1 by {name}"
    iterations = f"iterations of {name}, a segment"
    straight = f"straight moves of {name}"
    return (
        StoredDataset(f"{search}_offsets", "<i8", 1, offsets, "moves", "S + 1 offsets"),
        StoredDataset(f"{search}_moves", "u1", 1, moves, "code", _MOVES),
        StoredDataset(f"{search}_iterations", "<i4", 1, iterations, "cells taken", "plain"),
        StoredDataset(f"{search}_straight", "<i4", 1, straight, "moves", f"{_PAIRS}; -1 no path"),
    )


_DIAGONAL = f"{_PAIRS}; empty under 4-connectivity"

_PAIR_OFFSETS = f"N + 1 offsets; {_PAIRS}"

DATASETS = (
    StoredDataset("maps", "u1", 3, "occupancy", "1 occupied, 0 free", _BITS),
    StoredDataset("split", "u1", 1, "split of each map", "code", "0 train, 1 val, 2 test"),
    StoredDataset(
        "passage_width", "<i2", 1, "width of the passages of each map", "cells", "-1 unknown"
    ),
    StoredDataset("room_offsets", "<i8", 1, "first room of each map", "rooms", "N + 1 offsets"),
    StoredDataset(
        "pair_offsets", "<i8", 1, "first pair of rooms of each map", "pairs", _PAIR_OFFSETS
    ),
    StoredDataset("seeds", "<i2", 2, "seed point of each room", _CELL, "a row a room"),
    StoredDataset(
        "sizes", "<i2", 2, "rows and columns of each room as drawn", "cells", _OR_UNKNOWN
    ),
    StoredDataset("directions", "i1", 2, "legs at A and B of each passage", "code", _LEGS),
    *_search_fields("bfs", "breadth-first search"),
    *_search_fields("astar", "A*"),
    StoredDataset("astar_diagonal", "<i4", 1, "diagonal moves of A*, a pair", "moves", _DIAGONAL),
)
"""All datasets of a shard, in the order of the file. Under BFS "straight" counts all moves."""


class Shard(NamedTuple):
    """A checked shard: its header and its arrays, views of one memory mapping."""

    path: Path
    header: Header
    content_hash: str
    arrays: Mapping[str, Array]

    def __repr__(self) -> str:
        return f"Shard({self.path}, {self.header}, content_hash={self.content_hash})"


def encode(labels: Labels) -> dict[str, Array]:
    """Return labelled maps as the arrays of a shard."""
    maps = labels.maps
    # tables are padded to the most rooms of the batch; a file holds the rows of rooms alone
    used = np.arange(maps.seed_points.shape[1]) < maps.rooms[:, None]
    arrays: dict[str, Array] = {
        "maps": maps.packed.astype("<u8", copy=False).view(np.uint8),
        "split": maps.split,
        "passage_width": maps.passage_width,
        "room_offsets": maps.segment_offsets + np.arange(len(maps) + 1),
        "pair_offsets": maps.pair_offsets,
        "seeds": maps.seed_points[used],
        "sizes": maps.sizes[used],
        "directions": maps.directions[used[:, 1:]],
    }
    for name in SEARCHES:
        search = labels.by_search(name)
        arrays |= {
            f"{name}_offsets": search.offsets,
            f"{name}_moves": pack_moves(search.moves, bits_of(maps.movement)),
            f"{name}_iterations": search.iterations,
            f"{name}_straight": search.costs[:, 0],
        }
    # BFS counts moves, so it needs no second number; nor does a search without diagonals
    diagonals = labels.astar.costs[:, 1]
    arrays["astar_diagonal"] = diagonals if maps.movement.connectivity == 8 else diagonals[:0]
    return arrays


def decode(shard: Shard) -> Labels:
    """Return the labelled maps of a shard."""
    arrays = shard.arrays
    header = shard.header
    rooms = np.diff(arrays["room_offsets"])
    most = rooms.max(initial=2)
    used = np.arange(most) < rooms[:, None]
    maps = Maps(
        movement=header.movement,
        columns=header.map_size[1],
        index=np.arange(header.start, header.stop),
        packed=np.array(arrays["maps"]).view("<u8"),
        rooms=rooms,
        passage_width=arrays["passage_width"].astype(np.int64),
        seed_points=_padded(arrays["seeds"], used),
        sizes=_padded(arrays["sizes"], used),
        directions=_padded(arrays["directions"], used[:, 1:]),
        split=np.array(arrays["split"]),
    )
    return Labels(maps, _search_labels(shard, "bfs"), _search_labels(shard, "astar"))


def _padded(rows: Array, used: Flags) -> Ints:
    """Return rows of two numbers where ``used``, (N, R), says; -1 elsewhere."""
    table = np.full((*used.shape, 2), -1, np.int64)
    table[used] = rows
    return table


def _search_labels(shard: Shard, search: str) -> RouteLabels:
    """Return what one search found on the maps of a shard."""
    arrays = shard.arrays
    movement = shard.header.movement
    offsets = np.array(arrays[f"{search}_offsets"])
    straight = arrays[f"{search}_straight"]
    costs = np.zeros((len(straight), 2), np.int64)
    costs[:, 0] = straight
    if search == "astar" and movement.connectivity == 8:
        costs[:, 1] = arrays["astar_diagonal"]
    return RouteLabels(
        moves=unpack_moves(arrays[f"{search}_moves"], offsets[-1], bits_of(movement)),
        offsets=offsets,
        iterations=arrays[f"{search}_iterations"].astype(np.int64),
        costs=costs,
    )


def bits_of(movement: Movement) -> int:
    """Return how many bits a stored move takes."""
    return 2 if movement.connectivity == 4 else 4


def pack_moves(moves: Bytes, bits: int) -> Bytes:
    """Pack moves, the first one in the lowest bits of a byte."""
    each = 8 // bits
    padded = np.pad(moves, (0, -len(moves) % each))
    packed = np.zeros(len(padded) // each, np.uint8)
    for k in range(each):
        packed |= padded[k::each] << bits * k
    return packed


def unpack_moves(packed: Bytes, count: int, bits: int) -> Bytes:
    """Undo `pack_moves` for ``count`` moves."""
    shifts = np.arange(0, 8, bits, dtype=np.uint8)
    moves: Bytes = (packed[:, None] >> shifts) & (2**bits - 1)
    return moves.reshape(-1)[:count]
