"""The content hash: what maps and labels say, whatever file, shard size or HDF5 version holds them.

The hash of one map is the SHA-256 of its record, which docs/format.md describes. The hash of many
maps is the sum of theirs modulo 2**256, so that shards of any size combine, in any order. It tells
equal data from unequal data and finds corruption; it is no signature against an adversary.
"""

from __future__ import annotations

import hashlib
from itertools import pairwise

import numpy as np

from mapdata.arrays import Bytes, Int32s, Ints, offsets_of
from mapdata.jit import kernel
from mapdata.search.labels import Labels, SearchLabels

_Arrays = tuple[Bytes, Ints, Ints, Ints]
"""Of one search the moves, their offsets, length and iterations of each segment, and costs: kernels
take no dataclass.
"""


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
    words = header.shape[1] + 2 * (2 * rooms + passages) + 2 * 2 * (passages + pairs)
    move_offsets = labels.bfs.offsets + labels.astar.offsets  # in the moves of both
    moves = np.diff(move_offsets[maps.segment_offsets])
    padded_moves = (moves + 3) // 4 * 4  # a record is a whole number of words
    sizes = 4 * words + packed.shape[1] + padded_moves
    offsets = offsets_of(sizes)
    records = np.zeros(offsets[-1], np.uint8)
    _write(
        records,
        records.view(np.int32),
        offsets,
        header,
        packed,
        maps.seed_points,
        maps.sizes,
        maps.directions,
        maps.segment_offsets,
        maps.pair_offsets,
        (_arrays(labels.bfs), _arrays(labels.astar)),
    )
    return records, offsets


def _arrays(search: SearchLabels) -> _Arrays:
    lengths = np.diff(search.offsets)
    segments = np.stack((lengths, search.iterations), axis=1)
    return search.moves, search.offsets, segments, search.costs


@kernel
def _write(
    records: Bytes,
    words: Int32s,
    offsets: Ints,
    header: Ints,
    packed: Bytes,
    seed_points: Ints,
    room_sizes: Ints,
    directions: Ints,
    segments: Ints,
    pairs: Ints,
    searches: tuple[_Arrays, _Arrays],
) -> None:
    """Write the record of every map.

    ``words`` is ``records`` as int32; ``header`` is (N, 7): rows, columns, index (low and high
    half), split, passage width and rooms.
    """
    for m in range(len(header)):
        rooms = header[m, 6]
        segment = segments[m]
        next_segment = segments[m + 1]
        pair = pairs[m]
        next_pair = pairs[m + 1]
        # what is counted in words comes first, so that all of it is aligned
        at = offsets[m] // 4
        for k in range(7):
            words[at] = header[m, k]
            at += 1
        at = _copy_pairs(words, at, seed_points[m, :rooms])
        at = _copy_pairs(words, at, room_sizes[m, :rooms])
        at = _copy_pairs(words, at, directions[m, : rooms - 1])
        for _, _, counts, costs in searches:
            at = _copy_pairs(words, at, counts[segment:next_segment])
            at = _copy_pairs(words, at, costs[pair:next_pair])
        # from here on ``at`` counts bytes
        at *= 4
        at = _copy_bytes(records, at, packed[m])
        for moves, begins, _, _ in searches:
            at = _copy_bytes(records, at, moves[begins[segment] : begins[next_segment]])


@kernel
def _copy_pairs(words: Int32s, at: int, rows: Ints) -> int:
    """Copy rows of two numbers to ``words`` from ``at`` on; return where the next word goes."""
    for k in range(len(rows)):
        words[at] = rows[k, 0]
        words[at + 1] = rows[k, 1]
        at += 2
    return at


@kernel
def _copy_bytes(records: Bytes, at: int, data: Bytes) -> int:
    """Copy bytes to ``records`` from ``at`` on; return where the next one goes."""
    for k in range(len(data)):
        records[at] = data[k]
        at += 1
    return at
