"""Algorithm 1 of the paper: draw rooms and tunnels, carve them out of an occupied grid.

Source: Flores-Aquino et al., arXiv 2110.13242, Algorithm 1 and Table 1. Where the printed algorithm slips (mixed
indices in lines 22-23, the open elbow), its intent and the authors' published sample decide; docs/format.md lists
each draw.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from mapdata.jit import Int, kernel
from mapdata.rng import MAP, SPLIT, block, bounded, threshold
from mapdata.spec import SPLITS, MapSpec, Movement, check_seed

WORD = 64
"""Columns of a map in one packed word."""

_FULL = np.uint64(0xFFFFFFFFFFFFFFFF)
_EIGHT = np.uint64(8)

Ints = npt.NDArray[np.int64]
Bytes = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Maps:
    """A batch of N maps of one size, with what was drawn to make them.

    R is the largest number of rooms; rows beyond a map's own rooms hold -1.

    Attributes:
        movement: how paths move on these maps.
        columns: W, columns of a map.
        index: (N,) int64, number of each map.
        packed: (N, H, ceil(W / 64)) uint64, occupancy, one bit a cell: bit k of word j is column 64 j + k, 1 occupied.
        rooms: (N,) int64, number of rooms n.
        passage_width: (N,) int64, width of the tunnels, in cells.
        seeds: (N, R, 2) int64, seed point (row, col) of each room.
        sizes: (N, R, 2) int64, rows and columns of each room as drawn, before clipping.
        directions: (N, R - 1, 2) int64, per tunnel the leg at A and the leg at B: 1 horizontal, 0 vertical, -1 no
            tunnel.
        split: (N,) uint8, 0 train, 1 val, 2 test.
    """

    movement: Movement
    columns: int
    index: Ints
    packed: npt.NDArray[np.uint64]
    rooms: Ints
    passage_width: Ints
    seeds: Ints
    sizes: Ints
    directions: Ints
    split: Bytes

    def __len__(self) -> int:
        """Return N, the number of maps."""
        return len(self.index)

    @cached_property
    def occupancy(self) -> Bytes:
        """The maps as (N, H, W) uint8: 1 occupied, 0 free."""
        grids = np.empty((*self.packed.shape[:2], self.columns), np.uint8)
        unpack_all(self.packed, grids)
        return grids

    @property
    def connected(self) -> npt.NDArray[np.bool_]:
        """(N, R - 1) bool: a tunnel was drawn between rooms q and q + 1 (the paper's word; see `Labels.reachable`)."""
        return self.directions[:, :, 0] >= 0

    @cached_property
    def segment_offsets(self) -> Ints:
        """(N + 1,) int64: number of the first segment of each map, n - 1 segments a map, all maps in order."""
        return np.concatenate(([0], np.cumsum(self.rooms - 1)))

    @cached_property
    def pair_offsets(self) -> Ints:
        """(N + 1,) int64: number of the first pair of rooms i < j of each map, n (n - 1) / 2 pairs a map."""
        return np.concatenate(([0], np.cumsum(self.rooms * (self.rooms - 1) // 2)))


@kernel
def unpack(words: npt.NDArray[np.uint64], first: Int, grid: Bytes) -> None:
    """Write the packed map at ``words[first:]`` into ``grid``, (H, W)."""
    rows, columns = grid.shape
    count = (columns + WORD - 1) // WORD
    packed, out = words.view(np.uint8), grid.reshape(-1)  # bit k of a little-endian word is bit k % 8 of byte k // 8
    for row in range(rows if columns % WORD else 1):
        cells = np.uint64(columns if columns % WORD else rows * columns)
        byte, cell = np.uint64(8 * (first + row * count)), np.uint64(row * columns)
        for k in range(cells >> np.uint64(3)):
            value = packed[byte + np.uint64(k)]
            for bit in range(8):  # becomes vector instructions
                out[cell + _EIGHT * np.uint64(k) + np.uint64(bit)] = (value >> np.uint8(bit)) & np.uint8(1)
        for k in range(cells & ~np.uint64(7), cells):
            out[cell + np.uint64(k)] = (packed[byte + (np.uint64(k) >> np.uint64(3))] >> np.uint8(k & 7)) & np.uint8(1)


@kernel
def unpack_all(packed: npt.NDArray[np.uint64], grids: Bytes) -> None:
    """Write packed maps, (N, H, words), into ``grids``, (N, H, W)."""
    words = packed.reshape(-1)
    for m in range(len(packed)):
        unpack(words, m * packed.shape[1] * packed.shape[2], grids[m])


@kernel
def _carve(words: npt.NDArray[np.uint64], columns: int, top: int, left: int, height: int, width: int) -> None:
    """Free a rectangle of one packed map, clipped at the border. Words: (H, ceil(W / 64))."""
    first, last = max(left, 0), min(left + width, columns)
    for j in range(first // WORD, (last + WORD - 1) // WORD):
        low, high = max(first - WORD * j, 0), min(last - WORD * j, WORD)
        kept = ~((_FULL << np.uint64(low)) & (_FULL >> np.uint64(WORD - high)))
        for row in range(max(top, 0), min(top + height, words.shape[0])):
            words[row, j] &= kept


@kernel
def _tunnel(words: npt.NDArray[np.uint64], columns: int, a: Ints, b: Ints, width: int, horizontal_first: bool) -> None:
    """Free the two legs between seeds ``a`` and ``b`` and the square at their corner (lines 14-24 of Algorithm 1)."""
    corner_row, corner_column = (a[0], b[1]) if horizontal_first else (b[0], a[1])
    half = width // 2
    _carve(words, columns, corner_row - half, min(a[1], b[1]), width, abs(a[1] - b[1]) + 1)
    _carve(words, columns, min(a[0], b[0]), corner_column - half, abs(a[0] - b[0]) + 1, width)
    _carve(words, columns, corner_row - half, corner_column - half, width, width)


@kernel
def _draw(
    seed: np.uint64,
    index: Ints,
    columns: int,
    limits: Ints,
    thresholds: npt.NDArray[np.uint64],
    packed: npt.NDArray[np.uint64],
    rooms: Ints,
    passage_width: Ints,
    seeds: Ints,
    sizes: Ints,
    directions: Ints,
    split: Bytes,
) -> None:
    """Draw and carve maps ``index``.

    ``limits`` is (4, 2): rooms, rows, columns, width. ``thresholds``: (3,): skip, train, train + val.
    """
    height = packed.shape[1]
    for m in range(len(index)):
        words, i = packed[m], np.uint64(index[m])
        for j in range(words.shape[1]):
            used = np.uint64(WORD - min(columns - WORD * j, WORD))
            for row in range(height):
                words[row, j] = _FULL >> used
        w0, w1, w2, w3 = block(seed, i, 0, SPLIT, 0)
        split[m] = (w0 >= thresholds[1]) + (w0 >= thresholds[2])
        w0, w1, w2, w3 = block(seed, i, 0, MAP, 0)
        n, width = bounded(w0, limits[0, 0], limits[0, 1]), bounded(w1, limits[3, 0], limits[3, 1])
        rooms[m], passage_width[m] = n, width
        for q in range(n):
            w0, w1, w2, w3 = block(seed, i, 0, MAP, 1 + 2 * q)
            row, column = bounded(w0, 0, height - 1), bounded(w1, 0, columns - 1)
            tall, wide = bounded(w2, limits[1, 0], limits[1, 1]), bounded(w3, limits[2, 0], limits[2, 1])
            seeds[m, q, 0], seeds[m, q, 1] = row, column
            sizes[m, q, 0], sizes[m, q, 1] = tall, wide
            _carve(words, columns, row - tall // 2, column - wide // 2, tall, wide)
        for q in range(n - 1):
            w0, w1, w2, w3 = block(seed, i, 0, MAP, 2 + 2 * q)
            if w0 >= thresholds[0]:
                horizontal = bounded(w1, 0, 1)
                directions[m, q, 0], directions[m, q, 1] = horizontal, 1 - horizontal
                _tunnel(words, columns, seeds[m, q], seeds[m, q + 1], width, horizontal == 1)


def generate(spec: MapSpec, seed: int, indices: Iterable[int]) -> Maps:
    """Return the maps ``indices`` of (spec, seed): Algorithm 1 of arXiv 2110.13242.

    Map i is a pure function of (format version, spec, seed, i): the batch, its order and the machine do not matter.

    Raises:
        ValueError: a seed or an index that is not a non-negative integer of 64 (63) bits.

    >>> maps = generate(MapSpec(), seed=0, indices=range(3))
    >>> maps.occupancy.shape, maps.rooms.tolist()
    ((3, 64, 64), [5, 9, 2])
    """
    index = np.asarray(
        indices if isinstance(indices, np.ndarray) or not isinstance(indices, Iterable) else list(indices)
    )
    if index.ndim != 1 or (index.size and not (index.dtype.kind in "iu" and index.min() >= 0 and index.max() < 2**63)):
        raise ValueError(f"indices: got {indices!r}, expected integers from 0 to 2**63 - 1")
    index = np.ascontiguousarray(index.reshape(-1), np.int64)
    (height, columns), most, count = spec.map_size, spec.rooms[1], len(index)
    limits = np.array([spec.rooms, spec.room_rows, spec.room_columns, spec.passage_width], np.int64)
    maps = Maps(
        movement=spec.movement,
        columns=columns,
        index=index,
        packed=np.empty((count, height, -(-columns // WORD)), np.uint64),
        rooms=np.empty(count, np.int64),
        passage_width=np.empty(count, np.int64),
        seeds=np.full((count, most, 2), -1, np.int64),
        sizes=np.full((count, most, 2), -1, np.int64),
        directions=np.full((count, most - 1, 2), -1, np.int64),
        split=np.empty(count, np.uint8),
    )
    thresholds = np.array([threshold(spec.skip_probability), *_split_thresholds(spec)], np.uint64)
    _draw(
        np.uint64(check_seed(seed)),
        index,
        columns,
        limits,
        thresholds,
        maps.packed,
        maps.rooms,
        maps.passage_width,
        maps.seeds,
        maps.sizes,
        maps.directions,
        maps.split,
    )
    return maps


def maps_of_split(spec: MapSpec, seed: int, split: str, count: int) -> Ints:
    """Return the numbers of the first ``count`` maps of (spec, seed) that belong to ``split``."""
    code = SPLITS.index(split)
    if spec.splits[code] <= 0:
        raise ValueError(f"split: the spec gives no map to {split!r} (splits {spec.splits})")
    return _maps_of_split(np.uint64(check_seed(seed)), code, *_split_thresholds(spec), count)


def _split_thresholds(spec: MapSpec) -> tuple[np.uint64, np.uint64]:
    train, val = spec.splits[:2]
    return np.uint64(threshold(train)), np.uint64(threshold(train + val))


@kernel
def _maps_of_split(seed: np.uint64, code: Int, train: np.uint64, train_and_val: np.uint64, count: Int) -> Ints:
    found, numbers, i = 0, np.empty(count, np.int64), 0
    while found < count:
        w0, _, _, _ = block(seed, np.uint64(i), 0, SPLIT, 0)
        if (w0 >= train) + np.int64(w0 >= train_and_val) == code:
            numbers[found] = i
            found += 1
        i += 1
    return numbers
