"""`Maps`: a batch of bit-packed grids with what was drawn to make them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from mapdata.arrays import Bytes, Flags, Ints, Words, offsets_of, summary
from mapdata.jit import Int, inlined
from mapdata.limits import Size
from mapdata.movement import Movement

WORD = 64
"""Columns of a map in one packed word."""


@dataclass(frozen=True)
class Maps:
    """A batch of N maps of one size, with what was drawn to make them.

    R is the largest number of rooms; rows beyond a map's own rooms hold -1.

    Attributes:
        movement: how paths move on these maps.
        columns: W, columns of a map.
        index: (N,) int64, number of each map.
        packed: (N, H, ceil(W / 64)) uint64, occupancy, one bit a cell: bit k of word j is column 64
            j + k, 1 occupied.
        rooms: (N,) int64, number of rooms n; of maps without rooms that of seed points.
        passage_width: (N,) int64, width of the passages, in cells; -1 unknown.
        seed_points: (N, R, 2) int64, seed point (row, col) of each room.
        sizes: (N, R, 2) int64, rows and columns of each room as drawn, before clipping; -1 unknown.
        directions: (N, R - 1, 2) int64, per passage the leg at A and the leg at B: 1 horizontal, 0
            vertical, -1 no passage.
        split: (N,) uint8, 0 train, 1 val, 2 test.
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

    @staticmethod
    def empty(movement: Movement, map_size: Size, index: Ints, most: int) -> Maps:
        """Return maps to be filled in, each with up to ``most`` rooms; -1 is unknown."""
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
            seed_points=unknown((count, most, 2)),
            sizes=unknown((count, most, 2)),
            directions=unknown((count, most - 1, 2)),
            split=np.zeros(count, np.uint8),
        )

    __repr__ = summary

    def __len__(self) -> int:
        """Return N, the number of maps."""
        return len(self.index)

    @cached_property
    def occupancy(self) -> Bytes:
        """The maps as (N, H, W) uint8: 1 occupied, 0 free."""
        return unpacked(self.packed, self.columns)

    @property
    def connected(self) -> Flags:
        """(N, R - 1) bool: a passage was drawn between rooms q and q + 1.

        The paper's word; see `Labels.reachable` for whether a path exists.
        """
        return self.directions[:, :, 0] >= 0

    @cached_property
    def segment_offsets(self) -> Ints:
        """(N + 1,) int64: number of the first segment of each map, n - 1 segments a map."""
        return offsets_of(self.rooms - 1)

    @cached_property
    def segment_pairs(self) -> Ints:
        """(S,) int64: number of the pair of rooms q and q + 1 that each segment joins."""
        segments = self.rooms - 1
        n = np.repeat(self.rooms, segments)
        q = np.arange(len(n)) - np.repeat(self.segment_offsets[:-1], segments)
        # Rooms 0 to q - 1 come first as i of a pair, with n - 1, n - 2, ... pairs each.
        pairs_before: Ints = q * (2 * n - q - 1) // 2
        return np.repeat(self.pair_offsets[:-1], segments) + pairs_before

    @cached_property
    def pair_offsets(self) -> Ints:
        """(N + 1,) int64: number of the first pair of rooms of each map, n (n - 1) / 2 a map."""
        return offsets_of(self.rooms * (self.rooms - 1) // 2)


@inlined
def unpack_map(octets: Bytes, first: Int, grid: Bytes) -> None:
    """Write the packed map at ``octets[first:]`` into ``grid``, (H, W).

    ``octets`` are the bytes of `Maps.packed`: bit k of a little-endian word is bit k % 8 of its
    byte k // 8.
    """
    rows, columns = grid.shape
    octets_a_row = (columns + WORD - 1) // WORD * (WORD // 8)
    for row in range(rows):
        left = np.uint64(first + row * octets_a_row)
        for k in range(columns // 8):
            octet = octets[left + np.uint64(k)]
            for bit in range(8):  # becomes vector instructions
                grid[row, np.uint64(8 * k + bit)] = (octet >> bit) & 1
        for k in range(columns & ~7, columns):  # the last byte, if it is not full
            grid[row, k] = (octets[left + np.uint64(k >> 3)] >> (k & 7)) & 1


def unpacked(packed: Words, columns: int) -> Bytes:
    """Return packed maps, (N, H, words), as (N, H, W) grids: undo `pack`."""
    return np.unpackbits(packed.view(np.uint8), axis=2, count=columns, bitorder="little")


def pack(grids: Bytes) -> Words:
    """Pack (N, H, W) grids of 0 and 1 as `Maps.packed`, (N, H, ceil(W / 64)) uint64."""
    bits = np.packbits(np.ascontiguousarray(grids), axis=2, bitorder="little")
    spare = -bits.shape[2] % 8  # packbits ends rows at whole bytes
    words = np.pad(bits, ((0, 0), (0, 0), (0, spare))).view("<u8")
    return words.astype(np.uint64, copy=False)
