"""Sources of the problems on a map: `Route`, `Pairs` or `Random`."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, ClassVar

from mapdata.checks import (
    check_count,
    check_flag,
    check_number,
    did_you_mean,
    items_of,
    known_values,
)
from mapdata.hashing import parsed_json
from mapdata.limits import Size
from mapdata.movement import Movement

Band = tuple[float | None, float | None]
"""(lowest, highest), both included; None leaves a side open."""

Limits = tuple[float, float]
"""A band as numbers: (lowest, highest), 0 and inf where it is open."""

Bands = tuple[Limits, Limits, Limits]
"""The limits of distance, hardness and length."""

MAX_PER_MAP = 1_000_000
"""Problems on a map, so that 64 bits hold the number of any problem in any epoch."""

MAX_CELL_COST = 255
"""The highest cost of a cell of terrain."""

OPEN: Limits = (0.0, math.inf)
"""The limits of a condition that is not set."""


@dataclass(frozen=True)
class _BetweenSeedPoints:
    """What `Route` and `Pairs` share."""

    is_stored: ClassVar[bool] = True
    needs_seed_points: ClassVar[bool] = True
    goals_differ: ClassVar[bool] = False
    remedy: ClassVar[str] = "other maps"
    per_map: ClassVar[int] = 1  # as many as the map has
    unsolvable: bool = False

    def __post_init__(self) -> None:
        check_flag("unsolvable", self.unsolvable)


@dataclass(frozen=True)
class Route(_BetweenSeedPoints):
    """The segments between consecutive seed points, whose paths are stored.

    Attributes:
        unsolvable: whether segments without a path are kept.

    Raises:
        ValueError: ``unsolvable`` is not a bool.
    """

    name: ClassVar[str] = "route"
    counted: ClassVar[str] = "route"  # in the counts of a manifest


@dataclass(frozen=True)
class Pairs(_BetweenSeedPoints):
    """All pairs i < j of the seed points of a map, whose paths are searched on request.

    Attributes:
        unsolvable: whether pairs without a path are kept.

    Raises:
        ValueError: ``unsolvable`` is not a bool.
    """

    name: ClassVar[str] = "pairs"
    counted: ClassVar[str] = "rooms"  # in the counts of a manifest


@dataclass(frozen=True)
class Random:
    """Problems between two connected free cells of a map, sampled anew each epoch.

    Each condition is None or a band, (lowest, highest), both included, where None or an infinite
    bound leaves a side open. The attributes hold bands as tuples of floats.

    The goal is uniform among the free cells that have a start within all bands, and the start is
    uniform among these starts. On terrain the band of length is that of A*'s path, and goal and
    start are drawn again until the path fits. docs/format.md, section 6, defines the draws.

    Attributes:
        distance: cost of the shortest path, in cells.
        hardness: this cost divided by the heuristic, 1 or more.
        length: number of cells of a shortest path.
        to_first_seed_point: whether the goal is the map's first seed point, which is where imported
            goals are kept, instead of any free cell.
        per_map: number of problems on each map. A dataset has so many times more problems: problem
            i is on map ``i // per_map``. Each is drawn by itself, so on a small map two of them can
            be equal by chance.

    Raises:
        ValueError: a band is not two numbers in ascending order, ``to_first_seed_point`` is not a
            bool, or ``per_map`` is not an integer from 1 to 1,000,000.

    >>> Random(distance=(10, None)).distance
    (10.0, inf)
    """

    name: ClassVar[str] = "random"
    counted: ClassVar[str] = "maps"  # in the counts of a manifest
    is_stored: ClassVar[bool] = False
    remedy: ClassVar[str] = "wider conditions"
    unsolvable: ClassVar[bool] = False
    distance: Band | None = None
    hardness: Band | None = None
    length: Band | None = None
    to_first_seed_point: bool = False
    per_map: int = 1

    def __post_init__(self) -> None:
        """Check the values, and convert the bands to floats."""
        check_flag("to_first_seed_point", self.to_first_seed_point)
        object.__setattr__(self, "per_map", check_count("per_map", self.per_map))
        if self.per_map > MAX_PER_MAP:
            raise ValueError(f"per_map: got {self.per_map}, expected at most {MAX_PER_MAP:,}")
        for name in ("distance", "hardness", "length"):
            band = getattr(self, name)
            if band is not None:
                object.__setattr__(self, name, check_band(name, band))

    @property
    def needs_seed_points(self) -> bool:
        """Whether a problem depends on the seed points of its map."""
        return self.to_first_seed_point

    @property
    def goals_differ(self) -> bool:
        """Whether each attempt on a map draws another goal."""
        return not self.to_first_seed_point

    @cached_property
    def bands(self) -> Bands:
        """The limits of distance, hardness and length; 0 and inf where they are open."""
        return _limits(self.distance), _limits(self.hardness), _limits(self.length)

    @cached_property
    def conditions(self) -> tuple[float, Bands | None]:
        """The minimum distance, 1 or more, and the bands; None if there is no other condition."""
        min_distance, max_distance = self.bands[0]
        has_only_minimum = (max_distance, *self.bands[1:]) == (math.inf, OPEN, OPEN)
        return max(min_distance, 1.0), None if has_only_minimum else self.bands


Source = Route | Pairs | Random
"""What says which problems of a map are served.

A source has a ``name``, the word for its problems in the ``counted`` numbers of a manifest, and the
``remedy`` that an error names where no map has such a problem. ``is_stored`` says whether built
datasets hold the problems; others are drawn, ``per_map`` of them on each map.
"""

SourceLike = str | Source | Mapping[str, Any]
"""A source of problems: `Route`, `Pairs` or `Random`; its name, such as "random"; or plain JSON.

In JSON the name stands with the arguments: ``{"random": {"distance": [10, null]}}``.
"""

SOURCES: dict[str, type[Source]] = {source.name: source for source in (Route, Pairs, Random)}
"""The sources by name."""


def problem_source(problems: SourceLike) -> Source:
    """Return the source of problems that is meant.

    Args:
        problems: a source; its name, "route", "pairs" or "random"; or its name with its arguments
            as a mapping, or as JSON text: ``{"random": {"distance": [10, null]}}``.

    Raises:
        ValueError: none of these, an argument that the source does not have, or a bad band.
    """
    if isinstance(problems, Source):
        return problems
    arguments_by_name: Any = problems
    if isinstance(problems, str):
        is_json = problems.startswith("{")
        arguments_by_name = (
            parsed_json(f"problems: {problems!r}", problems) if is_json else {problems: {}}
        )
    # One source is expected. The names of several are joined for the hint of the error.
    name = ""
    if isinstance(arguments_by_name, Mapping):
        name = " ".join(map(str, arguments_by_name))
    if name not in SOURCES:
        expected = f'one of {", ".join(SOURCES)}, or one with its arguments, {{"random": {{...}}}}'
        hint = did_you_mean(name, SOURCES)
        if name == "hard":
            hint = '; hard ones are Random(hardness=(1.05, None)), as text {"random": '
            hint += '{"hardness": [1.05, null]}}'
        raise ValueError(f"problems: got {problems!r}, expected {expected}{hint}")
    source = SOURCES[name]
    return source(**known_values(f"problems: {name}", arguments_by_name[name], source))


def plain_text(source: Source) -> str:
    """Return a source as text for `problem_source`: its name, or JSON of what is no default."""
    defaults = asdict(type(source)())
    arguments = {
        name: argument for name, argument in asdict(source).items() if argument != defaults[name]
    }
    if not arguments:
        return source.name
    return json.dumps({source.name: arguments}).replace("Infinity", "null")


def _limits(band: Band | None) -> Limits:
    """Return the limits of a condition, which are open if it is not set."""
    return OPEN if band is None else check_band("", band)


def check_band(name: str, band: object) -> Limits:
    """Return the limits of a band, 0 and inf where it is open.

    Args:
        name: name of the condition, for the error.
        band: (lowest, highest), where None leaves a side open.

    Raises:
        ValueError: the band is not two numbers in ascending order.
    """
    bounds = items_of(band)
    if len(bounds) == 2:
        lowest = 0.0 if bounds[0] is None else max(check_number(name, bounds[0]), 0.0)
        highest = math.inf if bounds[1] is None else check_number(name, bounds[1])
        if lowest <= highest and lowest < math.inf:
            return lowest, highest
        if bounds[0] is not None and 0 <= highest < lowest < math.inf:
            raise ValueError(
                f"{name}: got {band!r}, whose lowest number {lowest:g} is above its highest "
                f"{highest:g}; expected (lowest, highest), where None leaves a side open"
            )
    raise ValueError(
        f"{name}: got {band!r}, expected (lowest, highest), where None leaves a side open"
    )


def check_possible(
    problems: Source, map_size: Size, movement: Movement, *, has_terrain: bool
) -> None:
    """Refuse bands that no problem on any map of this size is within.

    A search for such a problem would take long before it ends in an error, too. What is refused
    follows from the bands alone, so a search may still be in vain.

    Args:
        problems: only random ones have bands.
        map_size: (rows, columns).
        movement: the rule of moves.
        has_terrain: whether free cells cost different amounts.

    Raises:
        ValueError: the message names the bands, and what is possible.
    """
    if not isinstance(problems, Random) or problems.bands == (OPEN, OPEN, OPEN):
        return
    distances, ratios, lengths = problems.bands
    rows, columns = map_size
    most_cells = rows * columns
    refused = f"problems: got {plain_text(problems)}, which no problem meets: "
    # Costs are rounded to floats, and no band that is this close to the possible is refused.
    margin = 1e-9
    if ratios[1] < 1 - margin:
        raise ValueError(f"{refused}hardness is 1 or more")
    least_length = max(math.ceil(lengths[0]), 2)
    most_length = min(lengths[1], most_cells)
    if least_length > math.floor(most_length):
        raise ValueError(
            f"{refused}length is a whole number from 2 to {most_cells}, the number of cells of a "
            f"map of {rows} x {columns} cells"
        )
    most_length = math.floor(most_length)
    most_move_cost = movement.diagonal_cost if movement.connectivity == 8 else 1.0
    if has_terrain:
        most_move_cost *= MAX_CELL_COST
    least_cost = least_length - 1
    most_cost = (most_length - 1) * most_move_cost
    # The heuristic is 1 or more, so the cost is no less than the hardness.
    least_distance = max(distances[0], ratios[0])
    is_too_far = least_distance > most_cost * (1 + margin)
    is_too_close = distances[1] < max(least_cost, ratios[0]) * (1 - margin)
    # Only a cost that counts moves is a whole number.
    has_no_number = most_move_cost == 1 and math.ceil(distances[0]) > distances[1]
    if is_too_far or is_too_close or has_no_number:
        cells = f"{_span(least_length, most_length)} cells"
        costs = _span(least_cost, most_cost)
        if most_move_cost == 1:
            costs += ", a whole number"
        no_less = "" if problems.hardness is None else ", and no less than the hardness"
        raise ValueError(f"{refused}the distance of a path of {cells} is {costs}{no_less}")


def _span(least: float, most: float) -> str:
    """Return a range of numbers in words, or the only number in it."""
    return f"{least:.6g}" if least == most else f"{least:.6g} to {most:.6g}"
