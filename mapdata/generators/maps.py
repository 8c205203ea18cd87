"""`Maps`: a batch of bit-packed grids, with the rooms and passages that were drawn."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from mapdata.arrays import Bytes, Flags, Ints, Words, offsets_of, summary
from mapdata.jit import Int, inlined
from mapdata.limits import Size
from mapdata.movement import Movement

WORD = 64
"""Number of columns that one packed word holds."""


@dataclass(frozen=True)
class Maps:
    """A batch of N maps of one size, with the rooms and passages that were drawn.

    R is the largest number of rooms. Entries of rooms that a map does not have are -1.

    Attributes:
        movement: the rule of moves on these maps.
        columns: W, columns of a map.
        index: (N,) int64, number of each map.
        packed: (N, H, ceil(W / 64)) uint64, occupancy as one bit a cell: bit k of word j is column
            64 j + k, 1 occupied.
        rooms: (N,) int64, number of rooms; of maps without rooms the number of seed points.
        passage_width: (N,) int64, width of the passages, in cells; -1 unknown.
        seed_points: (N, R, 2) int64, seed point (row, col) of each room.
        sizes: (N, R, 2) int64, rows and columns of each room as drawn, before clipping; -1 unknown.
        directions: (N, R - 1, 2) int64, direction of each passage at its first and at its second
            room: 1 horizontal, 0 vertical, -1 no passage.
        split: (N,) uint8, 0 train, 1 val, 2 test.
        terrain: (N, H, W) uint8, the cost of each cell: 1 to 255 on free cells, 0 on occupied ones;
            None for maps whose free cells all cost the same.
    """

    movement: Movement
    columns: int
    index: Ints
    packed: Words
    rooms: Ints
    passage_width: Ints
    seed_points: Ints
    sizes: Ints
    directions: Ints
    split: Bytes
    terrain: Bytes | None = None

    @staticmethod
    def empty(movement: Movement, map_size: Size, index: Ints, max_rooms: int) -> Maps:
        """Return maps that a generator fills in, each with up to ``max_rooms`` rooms."""
        rows, columns = map_size
        count = len(index)
        unknown = partial(np.full, fill_value=-1, dtype=np.int64)
        return Maps(
            movement=movement,
            columns=columns,
            index=index,
            packed=np.empty((count, rows, -(-columns // WORD)), np.uint64),
            rooms=np.zeros(count, np.int64),
            passage_width=unknown(count),
            seed_points=unknown((count, max_rooms, 2)),
            sizes=unknown((count, max_rooms, 2)),
            directions=unknown((count, max_rooms - 1, 2)),
            split=np.zeros(count, np.uint8),
        )

    __repr__ = summary

    def __len__(self) -> int:
        """Return N, the number of maps."""
        return len(self.index)

    def selected(self, positions: slice) -> Maps:
        """Return some maps of the batch, as views of its arrays."""
        arrays: dict[str, Any] = {
            field.name: value[positions]
            for field in fields(self)
            if isinstance(value := getattr(self, field.name), np.ndarray)
        }
        return replace(self, **arrays)

    @cached_property
    def occupancy(self) -> Bytes:
        """The maps as (N, H, W) uint8: 1 occupied, 0 free."""
        return unpacked(self.packed, self.columns)

    @property
    def connected(self) -> Flags:
        """(N, R - 1) bool: a passage was drawn between rooms q and q + 1.

        The word is the paper's. `Labels.reachable` says whether a path exists.
        """
        return self.directions[:, :, 0] >= 0

    @cached_property
    def segment_offsets(self) -> Ints:
        """(N + 1,) int64: number of the first segment of each map.

        A map of n rooms has n - 1 segments, which join consecutive rooms.
        """
        return offsets_of(self.rooms - 1)

    @cached_property
    def segment_pairs(self) -> Ints:
        """(S,) int64: number of the pair of rooms q and q + 1 that each segment joins."""
        segment_counts = self.rooms - 1
        n = np.repeat(self.rooms, segment_counts)
        q = np.arange(len(n)) - np.repeat(self.segment_offsets[:-1], segment_counts)
        # The pairs of a map are (0, 1), (0, 2), ..., (1, 2), ...: room i is the first room of
        # n - 1 - i pairs. Before (q, q + 1) are those of the rooms 0 to q - 1:
        #   (n - 1) + (n - 2) + ... + (n - q) = q (2 n - q - 1) / 2
        pairs_before: Ints = q * (2 * n - q - 1) // 2
        return np.repeat(self.pair_offsets[:-1], segment_counts) + pairs_before

    @cached_property
    def pair_offsets(self) -> Ints:
        """(N + 1,) int64: number of the first pair of rooms of each map.

        A map of n rooms has n (n - 1) / 2 pairs.
        """
        return offsets_of(self.rooms * (self.rooms - 1) // 2)


@inlined
def unpack_map(octets: Bytes, first: Int, grid: Bytes) -> None:
    """Write one packed map into ``grid``.

    Args:
        octets: the bytes of `Maps.packed`, little-endian: bit k of a word is bit k % 8 of its byte
            k // 8.
        first: number of the first byte of the map.
        grid: (H, W), is filled with 0 free and 1 occupied.
    """
    rows, columns = grid.shape
    octets_per_row = (columns + WORD - 1) // WORD * (WORD // 8)
    full_octets = columns // 8
    for row in range(rows):
        row_start = np.uint64(first + row * octets_per_row)
        for k in range(full_octets):
            octet = octets[row_start + np.uint64(k)]
            for bit in range(8):  # The compiler turns this loop into vector instructions.
                grid[row, np.uint64(8 * k + bit)] = (octet >> bit) & 1
        for column in range(8 * full_octets, columns):
            octet = octets[row_start + np.uint64(column >> 3)]
            grid[row, column] = (octet >> (column & 7)) & 1


def unpacked(packed: Words, columns: int) -> Bytes:
    """Return packed maps, (N, H, words), as (N, H, W) grids: the inverse of `pack`."""
    return np.unpackbits(packed.view(np.uint8), axis=2, count=columns, bitorder="little")


def pack(grids: Bytes) -> Words:
    """Pack (N, H, W) grids of 0 and 1 as `Maps.packed`, (N, H, ceil(W / 64)) uint64."""
    octets = np.packbits(np.ascontiguousarray(grids), axis=2, bitorder="little")
    missing_octets = -octets.shape[2] % 8  # to a whole word at the end of each row
    words = np.pad(octets, ((0, 0), (0, 0), (0, missing_octets))).view("<u8")
    return words.astype(np.uint64, copy=False)
