"""The problems of a set: drawn on one map of a recipe or split after another."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from mapdata.arrays import Ints
from mapdata.checks import check_count
from mapdata.limits import Size
from mapdata.movement import Movement
from mapdata.problems.drawing import Drawing, Drawn, GivenMaps, Search
from mapdata.problems.sources import check_possible
from mapdata.problems.substitutes import limit_of_tries
from mapdata.search.api import search_batch
from mapdata.search.lattice import HARD, hardness
from mapdata.shards.workers import bar

_PROBLEMS_AT_ONCE = 16
"""Problems that are drawn between two steps of a progress bar, at least those of one map."""


@dataclass(frozen=True)
class MapStream:
    """The maps that a problem set is drawn on, in their order.

    Attributes:
        batches: the maps, some at a time.
        origin: where they come from, in words.
        count: how many there are.
        size: (rows, columns) of a map.
        has_terrain: whether they have terrain.
        are_alike: whether all of them are drawn by one recipe. Where the first ones have no
            problem, all may have none.
    """

    batches: Iterable[GivenMaps]
    origin: str
    count: int
    size: Size
    has_terrain: bool
    are_alike: bool


def first_maps(batches: Iterable[GivenMaps], max_maps: int) -> Iterator[GivenMaps]:
    """Yield batches that together hold the first ``max_maps`` maps of ``batches``."""
    remaining = max_maps
    for batch in batches:
        yield batch.select(slice(remaining))
        remaining -= min(len(batch.numbers), remaining)
        if remaining == 0:
            return


def draw_problems(
    stream: MapStream, drawing: Drawing, until_hard: int | None = None, *, progress: bool = False
) -> Drawn:
    """Draw the problems of each map of a stream; maps without one are left out.

    Args:
        stream: the maps.
        drawing: which problems.
        until_hard: stop at the map that brings the number of hard problems to this.
        progress: whether a progress bar shows how many maps were tried.

    Returns:
        Problems on maps as served, which stand for the stored ones, too.

    Raises:
        ValueError: problems without a path; conditions that no problem on such maps can meet; no
            map with a problem; fewer hard problems than ``until_hard``.
    """
    source = drawing.source
    if source.unsolvable:
        raise ValueError(
            f"problems: got {source!r}, expected unsolvable=False: a set holds problems that have "
            "a path"
        )
    if until_hard is not None:
        check_count("until_hard", until_hard)
    check_possible(source, stream.size, drawing.movement, has_terrain=stream.has_terrain)
    max_tries = limit_of_tries(source, stream.size, drawing.attempts * source.per_map)
    search = Search(drawing, max_tries, is_silent=progress)  # a bar says more
    parts: list[Drawn] = []
    tried = 0  # maps
    found = 0  # problems
    hard_count = 0
    with bar(progress, stream.count, unit=" maps tried") as advance:
        for maps, keys in _parts(stream.batches, source.per_map):
            maps_in_part = len(keys) // source.per_map
            drawn = drawing.on(maps, keys)
            part = drawn.on_served_maps(np.flatnonzero(drawn.has_problem))
            tried += maps_in_part
            found += len(part.ends)
            if until_hard is not None:
                part, hard_in_part = _until_hard(part, until_hard - hard_count, drawing.movement)
                hard_count += hard_in_part
            if len(part.ends):
                parts.append(part)
            advance(maps_in_part)
            search.say_if_long(
                tried - found / source.per_map,
                f"{found:,} found on {tried:,} of {stream.count:,} maps; progress=True shows a "
                "bar, and wider conditions are faster",
            )
            is_in_vain = found == 0 and tried >= max_tries
            if hard_count == until_hard or (is_in_vain and stream.are_alike):
                break
    if not parts:
        raise search.error(f"{tried:,} maps were tried, from {stream.origin}")
    if until_hard is not None and hard_count < until_hard:
        raise ValueError(
            f"until_hard: got {until_hard}, found only {hard_count} hard problems on "
            f"{stream.origin}"
        )
    return Drawn.joined(parts)


def _parts(batches: Iterable[GivenMaps], per_map: int) -> Iterator[tuple[GivenMaps, Ints]]:
    """Yield the maps, some at a time, each ``per_map`` times, and the keys of their problems."""
    maps_at_once = max(_PROBLEMS_AT_ONCE // per_map, 1)
    for batch in batches:
        for first in range(0, len(batch.numbers), maps_at_once):
            maps = batch.select(slice(first, first + maps_at_once))
            count = len(maps.numbers)
            repeated = maps.select(np.repeat(np.arange(count), per_map))
            yield repeated, repeated.numbers * per_map + np.tile(np.arange(per_map), count)


def _until_hard(drawn: Drawn, max_hard: int, movement: Movement) -> tuple[Drawn, int]:
    """Return the problems up to the hard problem number ``max_hard``, and how many are hard.

    All problems are returned if fewer of them are hard.
    """
    starts, goals = drawn.starts, drawn.goals
    grids, terrain = drawn.maps
    cost = search_batch("astar", grids, starts, goals, movement, terrain=terrain).cost
    is_hard = hardness(cost, starts, goals, movement, drawn.maps.min_cell_costs) >= HARD
    hard_rows = np.flatnonzero(is_hard)[:max_hard]
    row_count = hard_rows[-1] + 1 if len(hard_rows) == max_hard else len(is_hard)
    return drawn.on_served_maps(slice(row_count)), len(hard_rows)
