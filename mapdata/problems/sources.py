"""What is asked of the maps of a dataset: `Route`, `Pairs` or `Random` problems."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

from mapdata.checks import check_flag, check_number, did_you_mean, items_of, known_values
from mapdata.hashing import parsed_json

Band = tuple[float | None, float | None]
"""(lowest, highest), both included; None leaves a side open."""

Limits = tuple[float, float]

Bands = tuple[Limits, Limits, Limits]


@dataclass(frozen=True)
class _BetweenSeedPoints:
    """What `Route` and `Pairs` share."""

    unsolvable: bool = False

    def __post_init__(self) -> None:
        check_flag("unsolvable", self.unsolvable)


@dataclass(frozen=True)
class Route(_BetweenSeedPoints):
    """The stored segments between consecutive seed points, whose paths are read and not searched.

    Attributes:
        unsolvable: keep segments without a path, too.

    Raises:
        ValueError: ``unsolvable`` that is no bool.
    """

    name: ClassVar[str] = "route"
    counted: ClassVar[str] = "route"  # in the counts of a manifest


@dataclass(frozen=True)
class Pairs(_BetweenSeedPoints):
    """All pairs i < j of the seed points of a map, searched as they are asked for.

    Attributes:
        unsolvable: keep pairs without a path, too.

    Raises:
        ValueError: ``unsolvable`` that is no bool.
    """

    name: ClassVar[str] = "pairs"
    counted: ClassVar[str] = "rooms"  # in the counts of a manifest


@dataclass(frozen=True)
class Random:
    """One problem a map between two connected free cells, sampled anew each epoch.

    docs/format.md, section 6, says how. Each condition is None or a band (lowest, highest), both
    included; a bound that is None or infinite leaves its side open. Afterwards a band is a tuple of
    floats.

    Attributes:
        distance: cost of the shortest path, in cells.
        hardness: that cost over the heuristic, 1 or more.
        length: number of cells of a shortest path.
        to_first_seed_point: whether the goal is the map's first seed point, as goals that were
            imported are, instead of any free cell.

    Raises:
        ValueError: a band that is not two numbers in ascending order, or ``to_first_seed_point``
            that is no bool.

    >>> Random(distance=(10, None)).distance
    (10.0, inf)
    """

    name: ClassVar[str] = "random"
    counted: ClassVar[str] = "maps"  # in the counts of a manifest
    unsolvable: ClassVar[bool] = False
    distance: Band | None = None
    hardness: Band | None = None
    length: Band | None = None
    to_first_seed_point: bool = False

    def __post_init__(self) -> None:
        """Check the values, and bring the bands to floats."""
        check_flag("to_first_seed_point", self.to_first_seed_point)
        for name in ("distance", "hardness", "length"):
            band = getattr(self, name)
            if band is not None:
                object.__setattr__(self, name, check_band(name, band))

    @property
    def bands(self) -> Bands:
        """The limits of distance, hardness and length."""
        return _limits(self.distance), _limits(self.hardness), _limits(self.length)

    @property
    def conditions(self) -> tuple[float, Bands | None]:
        """The least distance, 1 or more, and the bands: None where there is no other condition."""
        lowest = self.bands[0][0]
        is_open = self.bands == Random((lowest, None)).bands
        return max(lowest, 1.0), None if is_open else self.bands


Source = Route | Pairs | Random

SourceLike = str | Source | Mapping[str, Any]
"""What `problem_source` makes a source of."""

SOURCES: dict[str, type[Source]] = {source.name: source for source in (Route, Pairs, Random)}


def problem_source(value: SourceLike) -> Source:
    """Return the source that ``value`` stands for.

    Args:
        value: a source; its name, "route", "pairs" or "random"; or its name with its arguments as a
            dict or another mapping, or as JSON text: ``{"random": {"distance": [10, null]}}``.

    Raises:
        ValueError: none of these, an argument that the source does not have, or a bad band.
    """
    if isinstance(value, Source):
        return value
    given: Any = value
    if isinstance(value, str):
        given = parsed_json(f"problems: {value!r}", value) if value.startswith("{") else {value: {}}
    name = " ".join(map(str, given)) if isinstance(given, Mapping) else ""
    if name not in SOURCES:
        expected = f'one of {", ".join(SOURCES)}, or one with its arguments, {{"random": {{...}}}}'
        hint = did_you_mean(name, SOURCES)
        raise ValueError(f"problems: got {value!r}, expected {expected}{hint}")
    return SOURCES[name](**known_values(f"problems: {name}", given[name], SOURCES[name]))


def plain_text(source: Source) -> str:
    """Return the text that `problem_source` reads as ``source``: its name, or JSON."""
    arguments = {name: value for name, value in asdict(source).items() if value}
    if not arguments:
        return source.name
    return json.dumps({source.name: arguments}).replace("Infinity", "null")


def _limits(band: Band | None) -> Limits:
    return check_band("", band or (None, None))


def check_band(name: str, band: object) -> Limits:
    """Return the limits of a band, 0 and inf where it is open.

    Raises:
        ValueError: it is not two numbers in ascending order.
    """
    limits = items_of(band)
    if len(limits) == 2:
        lowest = 0.0 if limits[0] is None else max(check_number(name, limits[0]), 0.0)
        highest = math.inf if limits[1] is None else check_number(name, limits[1])
        if lowest <= highest and lowest < math.inf:
            return lowest, highest
    raise ValueError(
        f"{name}: got {band!r}, expected (lowest, highest), where None leaves a side open"
    )
