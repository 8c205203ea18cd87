"""The content hash of maps and labels, whatever file, shard size or HDF5 version stores them.

The hash of one map is the SHA-256 of its record, which docs/format.md describes. The hash of
several maps is the sum of their hashes modulo 2**256, so that shards of any size can be combined in
any order. It tells whether two datasets are equal and detects corruption; it is no signature
against an adversary.
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
    records, offsets = _pack_records(labels)
    view = memoryview(records)  # type: ignore[arg-type]  # slices of a memoryview are not copied
    hashes = [
        hashlib.sha256(view[start:stop]).hexdigest() for start, stop in pairwise(offsets.tolist())
    ]
    return combine(hashes)


def combine(hashes: list[str]) -> str:
    """Return the content hash of the maps of several content hashes."""
    total = sum(int(digits, 16) for digits in hashes)
    return f"{total % 2**256:064x}"


def _pack_records(labels: Labels) -> tuple[Bytes, Ints]:
    """Return the records of N maps, concatenated, and the offset (N + 1,) of each record.

    A record consists of words (int32) and bytes: a header; seed point and size of each room;
    directions of each passage; for either search, length and iterations of each segment and the
    cost of each pair of rooms; the cells of the map; the terrain, if it has any; the moves of all
    segments by either search; and zeros up to a whole number of words.
    """
    maps = labels.maps
    rooms = maps.rooms
    passages = rooms - 1
    pairs = np.diff(maps.pair_offsets)
    count, rows, words_per_row = maps.packed.shape
    grids = [maps.packed.view(np.uint8).reshape(count, rows * words_per_row * 8)]
    if maps.terrain is not None:
        grids.append(maps.terrain.reshape(count, rows * maps.columns))
    header_columns = np.broadcast_arrays(
        rows,
        maps.columns,
        maps.index & 0xFFFFFFFF,
        maps.index >> 32,
        maps.split,
        maps.passage_width,
        rooms,
    )
    header = np.stack(header_columns, axis=1)

    header_words = header.shape[1]
    room_words = 2 * 2 * rooms + 2 * passages  # two words for each seed point, size and direction
    search_words = 2 * (passages + pairs)  # two words for each segment and each pair
    word_counts = header_words + room_words + 2 * search_words
    # Moves of both searches together, since the offsets of both add up.
    move_counts = np.diff((labels.bfs.offsets + labels.astar.offsets)[maps.segment_offsets])
    byte_counts = sum(cells.shape[1] for cells in grids) + move_counts
    padded_byte_counts = (byte_counts + 3) // 4 * 4
    offsets = offsets_of(4 * word_counts + padded_byte_counts)

    records = np.zeros(offsets[-1], np.uint8)
    words = records.view(np.int32)
    position = offsets[:-1] // 4  # index in ``words`` of the next word of each record
    words[position[:, None] + np.arange(header_words)] = header
    position += header_words
    for points, point_counts in (
        (maps.seed_points, rooms),
        (maps.sizes, rooms),
        (maps.directions, passages),
    ):
        # The rows of a map are padded to the same length, and only the first of them are copied.
        start = np.arange(count) * prod(points.shape[1:])
        _copy_runs(points.reshape(-1), start, start + 2 * point_counts, words, position)
    for search in (labels.bfs, labels.astar):
        segments = np.stack((np.diff(search.offsets), search.iterations), axis=1)
        for number_pairs, bounds in (
            (segments, 2 * maps.segment_offsets),
            (search.costs, 2 * maps.pair_offsets),
        ):
            _copy_runs(number_pairs.reshape(-1), bounds[:-1], bounds[1:], words, position)
    position *= 4  # from here on, index in ``records`` of the next byte of each record
    for cells in grids:
        start = np.arange(count) * cells.shape[1]
        _copy_runs(cells.reshape(-1), start, start + cells.shape[1], records, position)
    for search in (labels.bfs, labels.astar):
        bounds = search.offsets[maps.segment_offsets]
        _copy_runs(search.moves, bounds[:-1], bounds[1:], records, position)
    return records, offsets


@kernel
def _copy_runs(source: Array, start: Ints, stop: Ints, target: Array, position: Ints) -> None:
    """Copy ``source[start[m]:stop[m]]`` of each map m to ``target[position[m]:]``.

    Afterwards ``position[m]`` is the index behind the copied numbers.
    """
    for m in range(len(position)):
        index = position[m]
        for k in range(start[m], stop[m]):
            target[index] = source[k]
            index += 1
        position[m] = index
