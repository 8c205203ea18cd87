"""Maps with costs too high to be exact, which are stored without problems.

A build refuses a generator of which many maps are so; a single one would otherwise stop it after
hours.
"""

from __future__ import annotations

import warnings
from dataclasses import replace

from mapdata.generators.maps import Maps, pack
from mapdata.search.labels import HighCostError, Labels, label
from mapdata.shards.workers import Advance


def label_exactly(maps: Maps, advance: Advance) -> Labels:
    """Return the labels of maps; those with costs that are too high get no problems.

    Args:
        maps: the maps.
        advance: called with the number of maps that were finished since its last call.
    """
    finished = 0

    def count(number: int) -> None:
        nonlocal finished
        finished += number
        advance(number)

    try:
        return label(maps, count)
    except HighCostError:
        costly = costly_rows(maps)
    for row, error in costly.items():
        warnings.warn(
            f"map {maps.index[row]}: {error.complaint}; it is stored with a single free cell, and "
            "has no problems",
            stacklevel=2,
        )
    labels = label(_without_problems(maps, list(costly)))
    advance(len(maps) - finished)
    return labels


def costly_rows(maps: Maps) -> dict[int, HighCostError]:
    """Return the rows of the maps whose costs are too high to be exact, each with its error."""
    costly = {}
    for row in range(len(maps)):
        try:
            label(maps.selected(slice(row, row + 1)))
        except HighCostError as error:
            costly[row] = error
    return costly


def _without_problems(maps: Maps, rows: list[int]) -> Maps:
    """Return maps of which ``rows`` have no free cell but their first seed point.

    Maps of obstacles alone are drawn so, too (docs/format.md).
    """
    assert maps.terrain is not None
    grids = maps.occupancy.copy()
    terrain = maps.terrain.copy()
    rooms = maps.rooms.copy()
    seed_points = maps.seed_points.copy()
    sizes = maps.sizes.copy()
    directions = maps.directions.copy()
    for row in rows:
        row_index, column = seed_points[row, 0]
        cost = terrain[row, row_index, column]
        grids[row] = 1
        terrain[row] = 0
        grids[row, row_index, column] = 0
        terrain[row, row_index, column] = cost
        rooms[row] = 1
        seed_points[row, 1:] = -1
        sizes[row, 1:] = -1
        directions[row] = -1
    return replace(
        maps,
        packed=pack(grids),
        rooms=rooms,
        seed_points=seed_points,
        sizes=sizes,
        directions=directions,
        terrain=terrain,
    )
