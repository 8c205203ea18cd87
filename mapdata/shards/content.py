"""The content hash: what maps and labels say, whatever file, shard size or HDF5 version holds them.

The hash of one map is the SHA-256 of its record (docs/format.md); the hash of many is the sum of
theirs modulo 2**256, so that shards of any size combine, in any order. It tells equal data from
unequal ones, and damage; it is no signature against an adversary.
"""

from __future__ import annotations

import hashlib
from itertools import pairwise

import numpy as np

from mapdata.arrays import Bytes, Int32s, Ints
from mapdata.jit import kernel
from mapdata.search.labels import Labels, SearchLabels

_Arrays = tuple[Bytes, Ints, Ints, Ints]
"""Moves, their offsets, iterations and costs of one search: kernels take no dataclass."""


def content_hash(labels: Labels) -> str:
    """Return the content hash of labelled maps: 64 hexadecimal digits."""
    records, offsets = _pack(labels)
    view, sha256 = memoryview(records), hashlib.sha256  # type: ignore[arg-type]
    bounds = offsets.tolist()
    total = 0
    for first, last in pairwise(bounds):
        total += int.from_bytes(sha256(view[first:last]).digest(), "big")
    return _hex(total)


def combine(hashes: list[str]) -> str:
    """Return the content hash of all maps that ``hashes`` stand for."""
    return _hex(sum(int(value, 16) for value in hashes))


def _hex(total: int) -> str:
    return f"{total % 2**256:064x}"


def _pack(labels: Labels) -> tuple[Bytes, Ints]:
    """Return the records of all maps, one after another, and (N + 1,) where each begins."""
    maps, count = labels.maps, len(labels.maps)
    n, pairs = maps.rooms, np.diff(maps.pair_offsets)
    ends = [search.offsets[maps.segment_offsets] for search in (labels.bfs, labels.astar)]
    moves = sum(np.diff(end) for end in ends)
    packed = maps.packed.view(np.uint8).reshape(
        count, maps.packed.shape[1] * maps.packed.shape[2] * 8
    )
    sizes = 4 * (7 + 10 * n - 6 + 4 * pairs) + packed.shape[1] + -(-moves // 4) * 4
    offsets = np.concatenate(([0], np.cumsum(sizes)))
    records = np.zeros(offsets[-1], np.uint8)
    table = np.stack(
        (maps.index & 0xFFFFFFFF, maps.index >> 32, maps.split, maps.passage_width, n), axis=1
    )
    if count:
        _write(
            records,
            records.view(np.int32),
            offsets,
            np.array([maps.packed.shape[1], maps.columns]),
            table,
            packed,
            maps.seed_points,
            maps.sizes,
            maps.directions,
            maps.segment_offsets,
            maps.pair_offsets,
            _arrays(labels.bfs),
            _arrays(labels.astar),
        )
    return records, offsets


def _arrays(search: SearchLabels) -> _Arrays:
    return search.moves, search.offsets, search.iterations, search.costs


@kernel
def _write(
    records: Bytes,
    words: Int32s,
    offsets: Ints,
    size: Ints,
    table: Ints,
    packed: Bytes,
    seed_points: Ints,
    room_sizes: Ints,
    directions: Ints,
    segments: Ints,
    pairs: Ints,
    bfs: _Arrays,
    astar: _Arrays,
) -> None:
    """Write the record of every map; ``words`` is ``records`` as int32."""
    bfs_moves, bfs_offsets, bfs_iterations, bfs_costs = bfs
    astar_moves, astar_offsets, astar_iterations, astar_costs = astar
    for m in range(len(table)):
        at, n = offsets[m] // 4, table[m, 4]
        words[at], words[at + 1] = size[0], size[1]
        for k in range(5):
            words[at + 2 + k] = table[m, k]
        at += 7
        at = _copy_pairs(words, at, seed_points[m], 0, n)
        at = _copy_pairs(words, at, room_sizes[m], 0, n)
        at = _copy_pairs(words, at, directions[m], 0, n - 1)
        at = _copy_segments(words, at, bfs_offsets, bfs_iterations, segments[m], segments[m + 1])
        at = _copy_pairs(words, at, bfs_costs, pairs[m], pairs[m + 1])
        at = _copy_segments(
            words, at, astar_offsets, astar_iterations, segments[m], segments[m + 1]
        )
        at = _copy_pairs(words, at, astar_costs, pairs[m], pairs[m + 1])
        at *= 4
        for k in range(packed.shape[1]):
            records[at + k] = packed[m, k]
        at += packed.shape[1]
        at = _copy_moves(
            records, at, bfs_moves, bfs_offsets[segments[m]], bfs_offsets[segments[m + 1]]
        )
        at = _copy_moves(
            records, at, astar_moves, astar_offsets[segments[m]], astar_offsets[segments[m + 1]]
        )


@kernel
def _copy_pairs(words: Int32s, at: int, rows: Ints, first: int, last: int) -> int:
    for k in range(first, last):
        words[at], words[at + 1] = rows[k, 0], rows[k, 1]
        at += 2
    return at


@kernel
def _copy_segments(
    words: Int32s, at: int, offsets: Ints, iterations: Ints, first: int, last: int
) -> int:
    for s in range(first, last):
        words[at], words[at + 1] = offsets[s + 1] - offsets[s], iterations[s]
        at += 2
    return at


@kernel
def _copy_moves(records: Bytes, at: int, moves: Bytes, first: int, last: int) -> int:
    for k in range(first, last):
        records[at] = moves[k]
        at += 1
    return at
