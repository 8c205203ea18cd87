"""What a shard says of itself: which maps it holds, of which recipe."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from mapdata._version import __version__
from mapdata.generators.generator import MapGenerator, identity
from mapdata.hashing import canonical_json
from mapdata.limits import FORMAT_VERSIONS, Size, least_version
from mapdata.movement import Movement
from mapdata.shards.errors import ShardError

Span = tuple[int, int]
"""(start, stop) of the maps of a shard."""


def check_version(found: object, where: str = "", error: type[ValueError] = ShardError) -> None:
    """Raise ``error``, which names both versions, for a format version that is not known."""
    if found not in FORMAT_VERSIONS:
        known = " and ".join(map(str, FORMAT_VERSIONS))
        raise error(f"{where}format version {found}, this mapdata {__version__} reads {known}")


ATTRIBUTES = (
    "format",
    "format_version",
    "library_version",
    "identity",
    "content_hash",
    "spec",
    "seed",
    "start",
    "stop",
    "map_size",
    "movement",
    "resolution",
)
"""All attributes of the root group of a shard; `Origin.stated` gives their values."""


@dataclass(frozen=True)
class Origin:
    """What all shards of a dataset say.

    Attributes:
        spec: the spec that the maps were drawn from, None for imported maps.
        seed: the seed they were drawn with, None for imported maps.
        map_size: (rows, columns).
        movement: how the stored paths move.
        resolution: metres per cell.
    """

    spec: MapGenerator | None
    seed: int | None
    map_size: Size
    movement: Movement
    resolution: float

    @property
    def identity(self) -> str | None:
        """The identity of the dataset; None for imported maps: they are what their hash says."""
        if self.spec is None or self.seed is None:
            return None
        return identity(self.spec, self.seed)

    @property
    def format_version(self) -> int:
        """The version of the format that the dataset is written in."""
        return least_version(self.map_size) if self.spec is None else self.spec.format_version

    def stated(self, content: str, **own: int) -> dict[str, Any]:
        """Return what a manifest states, and in other words the root attributes of a shard.

        ``content`` is the content hash, ``own`` what only one of the two has.
        """
        return {
            "format": "mapdata",
            "format_version": self.format_version,
            "library_version": __version__,
            "identity": self.identity,
            "content_hash": content,
            "spec": self.spec.to_dict() if self.spec else None,
            "seed": self.seed,
            **own,
            "map_size": self.map_size,
            "movement": asdict(self.movement),
            "resolution": self.resolution,
        }

    def origin(self) -> dict[str, Any]:
        """Return these values by name, without those that a subclass adds."""
        return {field.name: getattr(self, field.name) for field in fields(Origin)}


_SHARD_NAME = re.compile(r"maps-\d{12,}-\d{12,}\.h5")


def is_shard_name(name: str) -> bool:
    """Return whether shards have such names; a manifest's other names are never opened."""
    return _SHARD_NAME.fullmatch(name) is not None


class MapRange:
    """The maps start <= i < stop of a dataset."""

    start: int
    stop: int

    @property
    def limits(self) -> Span:
        """(start, stop)."""
        return self.start, self.stop

    @property
    def maps(self) -> int:
        """How many they are."""
        return self.stop - self.start

    @property
    def file_name(self) -> str:
        """The name of the shard that holds them."""
        return f"maps-{self.start:012d}-{self.stop:012d}.h5"


@dataclass(frozen=True, eq=False)
class Header(MapRange, Origin):
    """What the root attributes of a shard say.

    Two are equal if they say the same, be the family of maps known to one of them alone: its module
    may have been imported since, or a notebook may have made its class anew.

    Attributes:
        start, stop: the maps are start <= i < stop.
    """

    start: int
    stop: int

    def __eq__(self, other: object) -> bool:
        """Return whether the other one says the same."""
        if not isinstance(other, Header) or self._numbers != other._numbers:
            return False
        if self.spec is None or other.spec is None:
            return self.spec is other.spec
        return self.spec == other.spec or self.spec.to_json() == other.spec.to_json()

    def __hash__(self) -> int:
        return hash(self._numbers)

    @property
    def _numbers(self) -> tuple[object, ...]:
        """All but the spec."""
        return self.seed, self.map_size, self.movement, self.resolution, self.start, self.stop


def _attributes(header: Header, content: str) -> dict[str, Any]:
    """Return the root attributes of a shard: HDF5 has neither objects nor unsigned seeds."""
    values = header.stated(content, start=header.start, stop=header.stop)
    for name in ("spec", "movement", "seed"):
        if values[name] is not None:
            values[name] = canonical_json(values[name])
    return {name: "" if value is None else value for name, value in values.items()}


def limits_of(path: Path) -> Span:
    """Return (start, stop) of the maps of a shard file, as its name states them."""
    _, start, stop = path.stem.split("-")
    return int(start), int(stop)
