"""The content hash: what maps and labels say, whatever file, shard size or HDF5 version holds them.

The hash of one map is the SHA-256 of its record, which docs/format.md describes. The hash of many
maps is the sum of theirs modulo 2**256, so that shards of any size combine, in any order. It tells
equal data from unequal data and finds corruption; it is no signature against an adversary.
"""

from __future__ import annotations

import hashlib
from itertools import pairwise
from math import prod

import numpy as np

from mapdata.arrays import Array, Bytes, Ints, offsets_of
from mapdata.jit import kernel
from mapdata.search.labels import Labels


def content_hash(labels: Labels) -> str:
    """Return the content hash of labelled maps: 64 hexadecimal digits."""
    records, offsets = _pack(labels)
    view = memoryview(records)  # type: ignore[arg-type]  # its slices are not copied
    bounds = pairwise(offsets.tolist())
    return combine([hashlib.sha256(view[first:last]).hexdigest() for first, last in bounds])


def combine(hashes: list[str]) -> str:
    """Return the content hash of all maps that ``hashes`` stand for."""
    total = sum(int(value, 16) for value in hashes)
    return f"{total % 2**256:064x}"


def _pack(labels: Labels) -> tuple[Bytes, Ints]:
    """Return the records of all maps, one after another, and (N + 1,) where each begins."""
    maps = labels.maps
    rooms = maps.rooms
    passages = rooms - 1
    pairs = np.diff(maps.pair_offsets)
    count, rows, words_a_row = maps.packed.shape
    packed = maps.packed.view(np.uint8).reshape(count, rows * words_a_row * 8)
    columns = np.broadcast_arrays(
        rows,
        maps.columns,
        maps.index & 0xFFFFFFFF,
        maps.index >> 32,
        maps.split,
        maps.passage_width,
        rooms,
    )
    header = np.stack(columns, axis=1)
    # After the header two words each: of a room, seed point and size; of a passage, directions;
    # then for either search, length and iterations of a segment, and the cost of a pair.
    lengths = header.shape[1] + 2 * (2 * rooms + passages) + 2 * 2 * (passages + pairs)
    move_offsets = labels.bfs.offsets + labels.astar.offsets  # in the moves of both
    moves = np.diff(move_offsets[maps.segment_offsets])
    padded_moves = (moves + 3) // 4 * 4  # a record is a whole number of words
    sizes = 4 * lengths + packed.shape[1] + padded_moves
    offsets = offsets_of(sizes)
    records = np.zeros(offsets[-1], np.uint8)
    words = records.view(np.int32)
    at = offsets[:-1] // 4  # where the next word of each record goes
    words[at[:, None] + np.arange(header.shape[1])] = header
    at += header.shape[1]
    for points, points_a_map in (
        (maps.seed_points, rooms),
        (maps.sizes, rooms),
        (maps.directions, passages),
    ):
        first = np.arange(count) * prod(points.shape[1:])
        _copy_runs(points.reshape(-1), first, first + 2 * points_a_map, words, at)
    for search in (labels.bfs, labels.astar):
        segments = np.stack((np.diff(search.offsets), search.iterations), axis=1)
        for pairs, bounds in (
            (segments, 2 * maps.segment_offsets),
            (search.costs, 2 * maps.pair_offsets),
        ):
            _copy_runs(pairs.reshape(-1), bounds[:-1], bounds[1:], words, at)
    at *= 4  # from here on the next byte of each record
    first = np.arange(count) * packed.shape[1]
    _copy_runs(packed.reshape(-1), first, first + packed.shape[1], records, at)
    for search in (labels.bfs, labels.astar):
        bounds = search.offsets[maps.segment_offsets]
        _copy_runs(search.moves, bounds[:-1], bounds[1:], records, at)
    return records, offsets


@kernel
def _copy_runs(values: Array, first: Ints, end: Ints, out: Array, at: Ints) -> None:
    """Copy ``values[first[m]:end[m]]`` of each map m to ``out[at[m]:]``; ``at`` moves behind it."""
    for m in range(len(at)):
        place = at[m]
        for k in range(first[m], end[m]):
            out[place] = values[k]
            place += 1
        at[m] = place
