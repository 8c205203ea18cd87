"""The header of a shard: which maps it holds, and the recipe that they were drawn from."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from mapdata._version import __version__
from mapdata.generators.generator import MapGenerator, identity
from mapdata.hashing import canonical_json
from mapdata.limits import FORMAT_VERSIONS, TERRAIN_VERSION, Size, min_version
from mapdata.movement import Movement
from mapdata.shards.errors import ShardError

Span = tuple[int, int]
"""(start, stop): the maps start <= i < stop of a shard."""


def check_version(
    version: object, prefix: str = "", error_type: type[ValueError] = ShardError
) -> None:
    """Refuse a format version that this version of mapdata does not know.

    Args:
        version: the format version that a file states.
        prefix: beginning of the error message, which names the file.
        error_type: class of the error that is raised.
    """
    if version not in FORMAT_VERSIONS:
        known = f"{FORMAT_VERSIONS[0]} to {FORMAT_VERSIONS[-1]}"
        raise error_type(
            f"{prefix}format version {version}, this mapdata {__version__} reads {known}"
        )


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
"""All attributes of the root group of a shard; `shard_attributes` gives their values."""


@dataclass(frozen=True)
class Origin:
    """The properties that all shards of a dataset share.

    Attributes:
        generator: generator that drew the maps, None for imported maps.
        seed: seed that they were drawn with, None for imported maps.
        map_size: (rows, columns).
        movement: rule of movement of the stored paths.
        resolution: metres per cell.
        has_terrain: whether the maps have terrain, as an argument for imported maps. For drawn maps
            it is always the property of the generator.
    """

    generator: MapGenerator | None
    seed: int | None
    map_size: Size
    movement: Movement
    resolution: float
    has_terrain: bool = field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        """Take from the generator, if there is one, whether the maps have terrain."""
        if self.generator is not None:
            object.__setattr__(self, "has_terrain", self.generator.has_terrain)

    @property
    def identity(self) -> str | None:
        """The identity of the dataset; None for imported maps.

        Those are identified by their content hash, resolution and movement together.
        """
        if self.generator is None or self.seed is None:
            return None
        return identity(self.generator, self.seed)

    @property
    def format_version(self) -> int:
        """The version of the format that the dataset is written in."""
        if self.has_terrain:
            return TERRAIN_VERSION
        if self.generator is None:
            return min_version(self.map_size)
        return self.generator.format_version

    def recipe_properties(self, content_hash: str) -> dict[str, Any]:
        """Return the properties that begin a manifest and the root attributes of a shard.

        ``content_hash`` is that of the maps in the manifest or shard.
        """
        return {
            "format": "mapdata",
            "format_version": self.format_version,
            "library_version": __version__,
            "identity": self.identity,
            "content_hash": content_hash,
            "spec": self.generator.to_dict() if self.generator else None,
            "seed": self.seed,
        }

    def map_properties(self) -> dict[str, Any]:
        """Return the properties of the maps; they follow the numbers of maps in both files."""
        return {
            "map_size": self.map_size,
            "movement": asdict(self.movement),
            "resolution": self.resolution,
        }

    def origin(self) -> dict[str, Any]:
        """Return the attributes of `Origin` by name, without those that a subclass adds."""
        return {field.name: getattr(self, field.name) for field in fields(Origin)}


_SHARD_NAME = re.compile(r"maps-\d{12,}-\d{12,}\.h5")


def is_shard_name(name: str) -> bool:
    """Return whether ``name`` is that of a shard; no file of another name is opened as one."""
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
        """The number of maps."""
        return self.stop - self.start

    @property
    def file_name(self) -> str:
        """The name of the shard that holds them."""
        return f"maps-{self.start:012d}-{self.stop:012d}.h5"


@dataclass(frozen=True, eq=False)
class Header(MapRange, Origin):
    """The header of a shard, which its root attributes hold.

    Two headers are equal if their stored forms are equal. The classes of their generators may
    differ: the module of a family may be imported between two reads, and a notebook may define its
    class a second time.

    Attributes:
        start, stop: the maps are start <= i < stop.
    """

    start: int
    stop: int

    def __eq__(self, other: object) -> bool:
        """Return whether ``other`` is a header with the same stored form."""
        if not isinstance(other, Header) or self._properties != other._properties:
            return False
        if self.generator is None or other.generator is None:
            return self.generator is other.generator
        return (
            self.generator == other.generator
            or self.generator.to_json() == other.generator.to_json()
        )

    def __hash__(self) -> int:
        return hash(self._properties)

    @property
    def _properties(self) -> tuple[object, ...]:
        """All attributes but the generator."""
        return (
            self.seed,
            self.map_size,
            self.movement,
            self.resolution,
            self.has_terrain,
            self.start,
            self.stop,
        )


def shard_attributes(header: Header, content_hash: str) -> dict[str, Any]:
    """Return the root attributes of a shard.

    The attributes of a shard are texts, floats and signed integers. So objects and the seed, an
    unsigned integer, are stored as JSON texts, and None is stored as an empty text.
    """
    attributes = {
        **header.recipe_properties(content_hash),
        "start": header.start,
        "stop": header.stop,
        **header.map_properties(),
    }
    for name in ("spec", "movement", "seed"):
        if attributes[name] is not None:
            attributes[name] = canonical_json(attributes[name])
    return {name: "" if value is None else value for name, value in attributes.items()}


def limits_of(path: Path) -> Span:
    """Return (start, stop) of the maps of a shard file, which its name states."""
    _, start, stop = path.stem.split("-")
    return int(start), int(stop)
