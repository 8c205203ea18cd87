"""Problems of any source, drawn on maps that are given: the same way for datasets and problem sets.

`Drawing.on` draws a problem on each of the maps that it is given. Its caller decides which maps
these are: a dataset takes another map in place of one without a problem, and a problem set leaves
the map out. A `Search` says that this takes long, and has the error after many maps in vain.

To draw problems of another source, write its class in `mapdata.problems.sources`, and add a
function to `_DRAWN_BY` here. docs/format.md, section 6, defines the draws.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from mapdata.arrays import Flags, Ints, offsets_of
from mapdata.generators.maps import Maps
from mapdata.movement import Movement
from mapdata.problems.pairs import solve_pairs
from mapdata.problems.sampling import sample_problems
from mapdata.problems.sources import Pairs, Random, Route, Source, plain_text
from mapdata.problems.substitutes import RARE_SHARE, say_rare
from mapdata.search.api import SEARCHES
from mapdata.search.lattice import move_rule
from mapdata.search.map_stack import MapStack

DRAWS = 32
"""How many goals a dataset draws on a map for a random problem, before it takes another map."""

DRAWS_OF_SETS = 1000
"""How many goals a problem set draws on a map, before it leaves the map out."""


class GivenMaps(NamedTuple):
    """B maps to draw problems on, before inflation.

    Attributes:
        numbers: (B,) int64, number of each map in its dataset or recipe, for errors.
        maps: the maps.
        seed_points: (B, R, 2) int64 cells, padded with -1; None if the source needs none.
        seed_point_counts: (B,) int64, number of seed points of each map; None as well.
    """

    numbers: Ints
    maps: MapStack
    seed_points: Ints | None
    seed_point_counts: Ints | None

    @staticmethod
    def of(maps: Maps) -> GivenMaps:
        """Return generated maps, or those of a shard."""
        stack = MapStack(maps.occupancy, maps.terrain)
        return GivenMaps(maps.index, stack, maps.seed_points, maps.rooms)

    def error_prefix(self, row: int) -> str:
        """Return how an error on map ``row`` begins."""
        return f"map {self.numbers[row]}: "

    def select(self, rows: Flags | Ints | slice) -> GivenMaps:
        """Return the maps that ``rows`` selects."""
        points, counts = self.seed_points, self.seed_point_counts
        return GivenMaps(
            self.numbers[rows],
            self.maps.select(rows),
            None if points is None else points[rows],
            None if counts is None else counts[rows],
        )


class Paths(NamedTuple):
    """The paths of B problems: path b is ``cells[offsets[b]:offsets[b + 1]]``, empty without one.

    Attributes:
        cells: (M, 2) int64, the cells of all paths, one path after another.
        offsets: (B + 1,) int64, where each path begins, and where the last one ends.
        iterations: (B,) int64, number of cells that the search expanded.
    """

    cells: Ints
    offsets: Ints
    iterations: Ints

    @staticmethod
    def joined(parts: Sequence[Paths]) -> Paths:
        """Return the paths of all parts, one part after another."""
        return Paths(
            np.concatenate([part.cells for part in parts]),
            offsets_of(np.concatenate([np.diff(part.offsets) for part in parts])),
            np.concatenate([part.iterations for part in parts]),
        )

    def select(self, rows: Ints) -> Paths:
        """Return the paths ``rows``, (M,)."""
        firsts = self.offsets[rows]
        lengths = self.offsets[rows + 1] - firsts
        offsets = offsets_of(lengths)
        shifts = firsts - offsets[:-1]  # Path m moves from firsts[m] to offsets[m].
        rows_of_cells = np.arange(offsets[-1]) + np.repeat(shifts, lengths)
        return Paths(self.cells[rows_of_cells], offsets, self.iterations[rows])


class Drawn(NamedTuple):
    """Problems that were drawn on B maps, or that were sought there in vain.

    Attributes:
        numbers: (B,) int64, number of each map in its dataset or recipe.
        stored: the maps before inflation.
        maps: the maps after it; without inflation the same object.
        ends: (B, 4) int64, row and column of start and goal, -1 where there is no problem.
        paths: their paths; None if the source needs none to draw a problem.
    """

    numbers: Ints
    stored: MapStack
    maps: MapStack
    ends: Ints
    paths: Paths | None = None

    @staticmethod
    def joined(parts: Sequence[Drawn]) -> Drawn:
        """Return the problems of all parts, one part after another."""
        if len(parts) == 1:
            return parts[0]
        stored = MapStack.joined([part.stored for part in parts])
        is_inflated = parts[0].maps is not parts[0].stored
        paths = [part.paths for part in parts if part.paths is not None]
        return Drawn(
            np.concatenate([part.numbers for part in parts]),
            stored,
            MapStack.joined([part.maps for part in parts]) if is_inflated else stored,
            np.concatenate([part.ends for part in parts]),
            Paths.joined(paths) if paths else None,
        )

    @property
    def has_problem(self) -> Flags:
        """(B,) bool: there is a problem on the map."""
        has_problem: Flags = self.ends[:, 0] >= 0
        return has_problem

    @property
    def starts(self) -> Ints:
        """(B, 2) int64 cells."""
        return np.ascontiguousarray(self.ends[:, :2])

    @property
    def goals(self) -> Ints:
        """(B, 2) int64 cells."""
        return np.ascontiguousarray(self.ends[:, 2:])

    def on_served_maps(self, rows: Ints | slice) -> Drawn:
        """Return the problems ``rows`` without their paths, with the served maps as stored ones."""
        maps = self.maps.select(rows)
        return Drawn(self.numbers[rows], maps, maps, self.ends[rows])

    def overwritten(self, rows: Ints, others: Drawn, rows_of_others: Ints) -> Drawn:
        """Return these problems with ``rows[k]`` replaced by ``rows_of_others[k]`` of others.

        The arrays of these problems are changed themselves, so that they are no longer of use;
        paths are new.
        """
        self.numbers[rows] = others.numbers[rows_of_others]
        self.ends[rows] = others.ends[rows_of_others]
        self.stored.overwrite(rows, others.stored, rows_of_others)
        if self.maps is not self.stored:
            self.maps.overwrite(rows, others.maps, rows_of_others)
        if self.paths is None or others.paths is None:
            return self
        both = Paths.joined([self.paths, others.paths])
        kept_or_new = np.arange(len(self.ends))
        kept_or_new[rows] = len(self.ends) + rows_of_others  # in ``both`` the others come last
        return self._replace(paths=both.select(kept_or_new))


@dataclass(frozen=True)
class Drawing:
    """What a problem depends on, beside its map, its key and the epoch.

    Attributes:
        source: which problems are drawn.
        seed: of the draws.
        movement: the rule of moves.
        attempts: how many goals of a random problem are tried on a map.
        search: "astar" or "bfs", whose paths are found where a source needs paths.
        min_clearance: clearance of the cells that are free for the robot, as from
            `min_squared_clearance`.
        radius: of the robot, in metres, for the error.
    """

    source: Source
    seed: int
    movement: Movement
    attempts: int
    search: str = "astar"
    min_clearance: int = 0
    radius: float = 0.0

    def on(self, given: GivenMaps, keys: Ints, epoch: int = 0) -> Drawn:
        """Draw a problem on each map.

        Args:
            given: B maps.
            keys: (B,) int64, the number of each problem, which its draws depend on.
            epoch: pass over the data.

        Raises:
            ValueError: a map has costs that are too high to be exact.
        """
        maps = given.maps.inflated(self.min_clearance)
        ends, paths = _DRAWN_BY[type(self.source)](self, given, maps, keys, epoch)
        return Drawn(given.numbers, given.maps, maps, ends, paths)


def _draw_random(
    drawing: Drawing, given: GivenMaps, maps: MapStack, keys: Ints, epoch: int
) -> tuple[Ints, Paths | None]:
    """Return start and goal of a random problem on each map, (B, 4), -1 where there is none."""
    source = drawing.source
    assert isinstance(source, Random)
    goals = None
    if source.to_first_seed_point:
        assert given.seed_points is not None  # since `needs_seed_points` of the source is true
        goals = np.ascontiguousarray(given.seed_points[:, 0])
    # Without conditions the costs of cells do not matter, as no move costs less than 1.
    has_conditions = source.conditions != Random().conditions
    searched = maps if has_conditions else MapStack(maps.grids, None)
    ends, row, high_cost = sample_problems(
        searched,
        goals,
        np.uint64(drawing.seed),
        epoch,
        keys,
        (0, drawing.attempts),
        *source.conditions,
        move_rule(drawing.movement),
    )
    searched.check_exact(row, high_cost, given.error_prefix)
    return ends, None


def _draw_pairs(
    drawing: Drawing, given: GivenMaps, maps: MapStack, keys: Ints, epoch: int
) -> tuple[Ints, Paths | None]:
    """Return two seed points of each map, (B, 4), -1 where none fit, and the paths between them.

    Those of a route are consecutive.
    """
    assert given.seed_points is not None
    assert given.seed_point_counts is not None
    weights = SEARCHES[drawing.search]
    searched = maps.seen_by(weights)
    ends, solved = solve_pairs(
        searched,
        given.seed_points,
        given.seed_point_counts,
        np.uint64(drawing.seed),
        epoch,
        keys,
        isinstance(drawing.source, Route),
        drawing.source.unsolvable,
        weights,
        move_rule(drawing.movement),
    )
    searched.check_exact(solved.done, solved.high_cost, given.error_prefix)
    return ends, Paths(solved.cells, solved.offsets, solved.expansions)


DrawFunction: TypeAlias = Callable[
    [Drawing, GivenMaps, MapStack, Ints, int], tuple[Ints, Paths | None]
]
"""Draws a problem on each of B maps.

It takes what a problem depends on, the maps before and after inflation, the keys, and the epoch. It
returns the cells of starts and goals (B, 4), and the paths if it needed them.
"""

_DRAWN_BY: dict[type[Any], DrawFunction] = {
    Random: _draw_random,
    Route: _draw_pairs,
    Pairs: _draw_pairs,
}
"""The function that draws the problems of each source."""


class Search:
    """A search for problems on one map after another: when to say that it is long, and its error.

    Attributes:
        max_tries: on how many maps a problem is sought before there is an error.
        is_silent: whether nothing is said of a long search, any more or at all.
    """

    def __init__(self, drawing: Drawing, max_tries: int, *, is_silent: bool = False) -> None:
        """Begin a search, before the first map."""
        self._drawing = drawing
        self.max_tries = max_tries
        self.is_silent = is_silent

    def say_if_long(self, failed: float, state: str) -> bool:
        """Write on stderr, once, that a search takes long; return whether this was said now.

        Args:
            failed: number of maps without a problem.
            state: how far the search is, in words.
        """
        if self.is_silent or failed < self.max_tries / RARE_SHARE:
            return False
        self.is_silent = True
        say_rare(f"{plain_text(self._drawing.source)}: {state}")
        return True

    def error(self, tried: str) -> ValueError:
        """Return the error of a search in vain; ``tried`` says on which maps, in words."""
        source, radius = self._drawing.source, self._drawing.radius
        remedy = source.remedy
        if radius:
            remedy += f", or a smaller radius than {radius:g} m"
        return ValueError(
            f"problems: got {plain_text(source)}: none on one map after another; {tried}; take "
            f"{remedy}"
        )
