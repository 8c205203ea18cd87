"""`Collection`: maps that were read from a foreign format, before they become a dataset."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import InitVar, dataclass, field

import numpy as np

from mapdata.arrays import Array, Bytes, Ints
from mapdata.hints import hint_on_values
from mapdata.limits import Size
from mapdata.movement import Movement
from mapdata.search.labels import Labels


def _no_pairs() -> Ints:
    """Return an empty array of pairs, (0, 2) int64."""
    return np.empty((0, 2), np.int64)


@dataclass(frozen=True, eq=False)
class ForeignMap:
    """A grid that a format has read.

    Its cells are kept as bits, since an import holds all its maps in memory.

    Attributes:
        name: names the source of the map in reports.
        cells: (H, W) of 0 free and 1 occupied, or bool; only an argument, read it as ``grid``.
        split: 0 train, 1 val, 2 test; None to draw it.
        resolution: metres per cell; None if the source does not say.
        number: the map's number in the source; the dataset keeps the numbers if those of all maps
            are 0 to N - 1.
        seed_points: (k, 2) int64, the seed points that the source has.
        rooms_known: whether ``seed_points`` are complete; if not, an import draws more.
        sizes: (k, 2) int64, rows and columns of the rooms, -1 unknown; empty if all are unknown.
        directions: (k - 1, 2) int64, the legs of the passages, -1 none or unknown; empty if all are
            unknown.
        passage_width: in cells, -1 unknown.
        check: called with the labels and the number of this map in them; returns the names of the
            labels for which the source has other values. None if the source has no labels.
        terrain: (H, W) uint8, the cost of each cell: 1 to 255 on free cells and 0 on occupied ones;
            None if all free cells cost the same.
        shape: (H, W).
    """

    name: str
    cells: InitVar[Array]
    split: int | None = None
    resolution: float | None = None
    number: int | None = None
    seed_points: Ints = field(default_factory=_no_pairs)
    rooms_known: bool = False
    sizes: Ints = field(default_factory=_no_pairs)
    directions: Ints = field(default_factory=_no_pairs)
    passage_width: int = -1
    check: Callable[[Labels, int], list[str]] | None = None
    terrain: Bytes | None = None
    shape: Size = field(init=False)
    _bits: Bytes = field(init=False)

    def __repr__(self) -> str:
        return f"ForeignMap({self.name!r}, {self.shape[0]} x {self.shape[1]} cells)"

    def __post_init__(self, cells: Array) -> None:
        """Pack the cells.

        Raises:
            ValueError: cells that are not two-dimensional or hold another value; no such split;
                terrain that does not fit the cells.
        """
        cells = np.asarray(cells)
        if cells.ndim != 2 or not ((cells == 0) | (cells == 1)).all():
            raise ValueError(
                f"cells: {self.name}: got {np.unique(cells)[:3]} in shape {cells.shape}, "
                f"expected 0 and 1 in shape (H, W){hint_on_values(cells)}"
            )
        if self.split not in (None, 0, 1, 2):
            raise ValueError(f"split: {self.name}: got {self.split!r}, expected 0, 1, 2 or None")
        # Bits of a transposed array would unpack to a transposed array, but kernels need grids in
        # row-major order.
        grid = np.ascontiguousarray(cells, np.uint8)
        if self.terrain is not None:
            object.__setattr__(self, "terrain", _checked_terrain(self.name, self.terrain, grid))
        # A frozen dataclass can set its own attributes in this way only.
        object.__setattr__(self, "shape", grid.shape)
        object.__setattr__(self, "_bits", np.packbits(grid, axis=1))

    @property
    def grid(self) -> Bytes:
        """The cells, (H, W) uint8, 0 free and 1 occupied."""
        return np.unpackbits(self._bits, axis=1, count=self.shape[1])


def _checked_terrain(name: str, terrain: Array, grid: Bytes) -> Bytes:
    """Return terrain in row-major order, after checking that it fits the grid.

    Raises:
        ValueError: another shape or dtype; a cost on an occupied cell, or none on a free one.
    """
    terrain = np.asarray(terrain)
    if terrain.dtype != np.uint8 or terrain.shape != grid.shape:
        raise ValueError(
            f"terrain: {name}: got {terrain.dtype} in shape {terrain.shape}, expected uint8 in "
            f"shape {grid.shape}"
        )
    differs = (terrain == 0) != (grid == 1)
    if differs.any():
        row, column = np.argwhere(differs)[0].tolist()
        raise ValueError(
            f"terrain: {name}: cell {row, column} has cost {terrain[row, column]}, but is "
            f"{'occupied' if grid[row, column] else 'free'}: expected 0 on occupied cells alone"
        )
    return np.ascontiguousarray(terrain)


@dataclass
class Collection:
    """The maps that a format has read from a file or folder.

    Attributes:
        maps: the grids, in order.
        movement: the rule of the format, None if it has none.
        left_out: (name, reason) of each file or map that could not be used.
        notes: messages for the user on how the files were read.
        format: name of the format; None if the maps are not from a file.
        source: the file or folder that was read; None if ``format`` is None.
    """

    maps: list[ForeignMap] = field(default_factory=list)
    movement: Movement | None = None
    left_out: list[tuple[str, str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    format: str | None = None
    source: str | None = None

    def __repr__(self) -> str:
        return (
            f"Collection({len(self.maps)} maps, {self.movement}, {len(self.left_out)} left out, "
            f"{len(self.notes)} notes)"
        )

    @contextmanager
    def leaving_out(self, name: object) -> Iterator[None]:
        """Catch a `ValueError` or `OSError`, and add ``name`` and its message to ``left_out``."""
        try:
            yield
        except (ValueError, OSError) as error:
            self.left_out.append((str(name), str(error).removeprefix(f"{name}: ")))
