"""The record of several maps that Python functions pass on: grids and their terrain together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Flags, Ints
from mapdata.search.footprint import inflate_all, occupies_cells, without_occupied
from mapdata.search.ground import as_ground
from mapdata.search.terrain import min_cell_costs


class MapStack(NamedTuple):
    """B maps, all with terrain or all without.

    Attributes:
        grids: (B, H, W) uint8, 1 occupied.
        terrain: (B, H, W) uint8, the cost of each cell, 0 exactly on the occupied cells; None for
            maps whose free cells all cost the same.
    """

    grids: Bytes
    terrain: Bytes | None

    @staticmethod
    def joined(parts: Sequence[MapStack]) -> MapStack:
        """Return the maps of all parts, one part after another."""
        terrains = [part.terrain for part in parts if part.terrain is not None]
        return MapStack(
            np.concatenate([part.grids for part in parts]),
            np.concatenate(terrains) if terrains else None,
        )

    def select(self, rows: Flags | Ints | slice) -> MapStack:
        """Return the maps that ``rows`` selects."""
        return MapStack(self.grids[rows], None if self.terrain is None else self.terrain[rows])

    def overwrite(self, rows: Ints, others: MapStack, places: Ints) -> None:
        """Replace map ``rows[k]`` by map ``places[k]`` of others, in these arrays themselves."""
        self.grids[rows] = others.grids[places]
        if self.terrain is not None and others.terrain is not None:
            self.terrain[rows] = others.terrain[places]

    def with_grids(self, grids: Bytes) -> MapStack:
        """Return these maps after inflation, which made ``grids``, (B, H, W), of their grids."""
        if self.terrain is None or grids is self.grids:
            return MapStack(grids, self.terrain)
        return MapStack(grids, without_occupied(self.terrain, grids))

    def inflated(self, min_clearance: int) -> MapStack:
        """Return the maps after inflation, as `inflate_all` does it; without any, these maps."""
        if not occupies_cells(min_clearance):  # The kernel takes seconds to compile.
            return self
        grids = self.grids.copy()
        inflate_all(grids, min_clearance)
        return self.with_grids(grids)

    @property
    def ground(self) -> tuple[Bytes, Bytes | None]:
        """The maps as kernels take them, from `as_ground`."""
        return as_ground(self.grids, self.terrain)

    @property
    def costs(self) -> Bytes:
        """(B, H, W) uint8, the terrain, or the grids of maps without it."""
        return self.grids if self.terrain is None else self.terrain

    @property
    def min_cell_costs(self) -> Ints | None:
        """(B,) int64, the smallest cost of a free cell of each map; None without terrain."""
        return None if self.terrain is None else min_cell_costs(self.terrain)
