"""Algorithm 1 of the paper: draw rooms and passages, carve them out of an occupied grid.

Source: Flores-Aquino et al., arXiv 2110.13242, section 2 (Algorithm 1) and section 3 (Table 1). It
writes (column, row), and calls passages tunnels. The printed algorithm has errors: line 23
exchanges columns and rows, slices are empty where A lies beyond B, and the outer corner of an elbow
stays occupied. There its intent and the authors' published sample decide; docs/format.md lists each
draw.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from mapdata.arrays import Ints, Words
from mapdata.checks import check_integers, check_probability, check_range
from mapdata.generators.generator import MapGenerator
from mapdata.generators.maps import WORD, Maps
from mapdata.generators.splits import draw_splits, split_thresholds
from mapdata.jit import inlined, kernel
from mapdata.limits import MAX_ROOMS, Range
from mapdata.rng import MAP, block, bounded, threshold

_FULL = np.uint64(0xFFFFFFFFFFFFFFFF)
"""A word of 64 occupied cells."""


@dataclass(frozen=True)
class MapSpec(MapGenerator):
    """The parameters of Algorithm 1; those of Table 1 of the paper are the defaults.

    All ranges are (lowest, highest), both included. See arXiv 2110.13242, sections 2 and 3.

    Attributes:
        map_size: (rows, columns) of a map, in cells, at most ``MAX_SIDE`` each.
        rooms: number of rooms, 2 to ``MAX_ROOMS``.
        room_rows: rows of a room as drawn, in cells, before it is clipped at the border.
        room_columns: columns of a room as drawn, in cells, before it is clipped at the border.
        passage_width: width of the passages of a map, in cells; one draw a map.
        skip_probability: probability that no passage is drawn between two consecutive rooms.
        resolution: metres per cell.
        movement: the rule of moves.
        splits: fractions of maps in train, val and test; they add up to 1.

    Raises:
        ValueError: a value outside these limits, rooms or passages larger than the map.
    """

    name: ClassVar[str] = "rooms"
    description: ClassVar[str] = "maps drawn by Algorithm 1 of arXiv 2110.13242"
    citation: ClassVar[str] = "Please cite the paper whose maps these are:"

    rooms: Range = (2, 9)
    room_rows: Range = (14, 33)
    room_columns: Range = (14, 33)
    passage_width: Range = (7, 15)
    skip_probability: float = 0.1

    def __post_init__(self) -> None:
        """Check the values."""
        super().__post_init__()
        self._convert(check_integers, "rooms", "room_rows", "room_columns", "passage_width")
        self._convert(check_probability, "skip_probability")
        rows, columns = self.map_size
        too_tall = f": rooms would be larger than the map of {rows} rows"
        too_wide = f": rooms would be larger than the map of {columns} columns"
        too_thick = f": passages would be larger than the map, {rows} x {columns}"
        check_range("rooms", self.rooms, 2, MAX_ROOMS)
        check_range("room_rows", self.room_rows, 1, rows, too_tall)
        check_range("room_columns", self.room_columns, 1, columns, too_wide)
        check_range("passage_width", self.passage_width, 1, min(rows, columns), too_thick)

    @property
    def max_seed_points(self) -> int:
        """The largest number of rooms."""
        return self.rooms[1]

    def draw(self, seed: int, indices: Ints) -> Maps:
        """Return the maps ``indices``, (N,) int64: Algorithm 1."""
        maps = Maps.empty(self.movement, self.map_size, indices, self.max_seed_points)
        limits = np.array([self.rooms, self.room_rows, self.room_columns, self.passage_width])
        skip = np.uint64(threshold(self.skip_probability))
        key = np.uint64(seed)
        maps.split[:] = draw_splits(key, indices, split_thresholds(self.splits))
        # Line 2: all cells are occupied; the spare bits of the last words are 0.
        maps.packed.fill(_FULL)
        maps.packed[:, :, -1] >>= np.uint64(-maps.columns % WORD)
        _fill_maps(
            key,
            indices,
            maps.columns,
            limits,
            skip,
            maps.packed,
            maps.rooms,
            maps.passage_width,
            maps.seed_points,
            maps.sizes,
            maps.directions,
        )
        return maps


PRESETS = {
    "paper": MapSpec(),
    "narrow": MapSpec(passage_width=(1, 3)),
    "dungeon": MapSpec(
        rooms=(8, 16), room_rows=(6, 14), room_columns=(6, 14), passage_width=(1, 3)
    ),
    "dungeon128": MapSpec(
        map_size=(128, 128),
        rooms=(16, 40),
        room_rows=(8, 20),
        room_columns=(8, 20),
        passage_width=(2, 4),
    ),
}
"""The presets. "paper" is Table 1, whose problems are easy; most of "dungeon" are hard."""


@kernel
def _fill_maps(
    seed: np.uint64,
    indices: Ints,
    columns: int,
    limits: Ints,
    skip: np.uint64,
    packed: Words,
    rooms: Ints,
    passage_width: Ints,
    seed_points: Ints,
    sizes: Ints,
    directions: Ints,
) -> None:
    """Draw maps ``indices`` into the arrays of `Maps`, and carve them out of occupied ``packed``.

    ``limits`` is (4, 2): rooms, rows, columns, width. ``skip`` is the threshold of a passage that
    is not drawn. Each room and passage has a block of random words of its own, so that no draw
    depends on how many came before.
    """
    height = packed.shape[1]
    for m in range(len(indices)):
        words = packed[m]
        index = np.uint64(indices[m])
        w0, w1, _, _ = block(seed, index, 0, MAP, 0)
        n = bounded(w0, limits[0, 0], limits[0, 1])
        width = bounded(w1, limits[3, 0], limits[3, 1])  # line 4
        rooms[m] = n
        passage_width[m] = width
        for q in range(n):  # lines 5 to 11: rooms about their seed points
            w0, w1, w2, w3 = block(seed, index, 0, MAP, 1 + 2 * q)
            row = bounded(w0, 0, height - 1)
            column = bounded(w1, 0, columns - 1)
            tall = bounded(w2, limits[1, 0], limits[1, 1])
            wide = bounded(w3, limits[2, 0], limits[2, 1])
            seed_points[m, q, 0] = row
            seed_points[m, q, 1] = column
            sizes[m, q, 0] = tall
            sizes[m, q, 1] = wide
            _carve(words, columns, row - tall // 2, column - wide // 2, tall, wide)
        for q in range(n - 1):  # lines 12 to 25: passages between consecutive rooms
            w0, w1, _, _ = block(seed, index, 0, MAP, 2 + 2 * q)
            if w0 < skip:
                continue
            horizontal = bounded(w1, 0, 1)  # line 17: the leg at room q; the other is across
            directions[m, q, 0] = horizontal
            directions[m, q, 1] = 1 - horizontal
            _carve_passage(
                words, columns, seed_points[m, q], seed_points[m, q + 1], width, horizontal == 1
            )


@kernel
def _carve(words: Words, columns: int, top: int, left: int, height: int, width: int) -> None:
    """Free a rectangle of one packed map, clipped at the border. Words: (H, ceil(W / 64))."""
    first = max(left, 0)
    end = min(left + width, columns)
    for j in range(first // WORD, (end + WORD - 1) // WORD):
        # Bits low to high - 1 of word j are freed, the same ones in every row.
        low = max(first - WORD * j, 0)
        high = min(end - WORD * j, WORD)
        kept = ~((_FULL << np.uint64(low)) & (_FULL >> np.uint64(WORD - high)))
        for row in range(max(top, 0), min(top + height, words.shape[0])):
            words[row, j] &= kept


@inlined
def _carve_passage(
    words: Words, columns: int, a: Ints, b: Ints, width: int, horizontal_first: bool
) -> None:
    """Free the two legs between seed points ``a`` and ``b`` and the square at their corner.

    Lines 19 and 20, or 22 and 23. Each leg runs between the two points whatever their order.
    """
    corner_row = a[0] if horizontal_first else b[0]
    corner_column = b[1] if horizontal_first else a[1]
    top = corner_row - width // 2
    left = corner_column - width // 2
    _carve(words, columns, top, min(a[1], b[1]), width, abs(a[1] - b[1]) + 1)
    _carve(words, columns, min(a[0], b[0]), left, abs(a[0] - b[0]) + 1, width)
    _carve(words, columns, top, left, width, width)
