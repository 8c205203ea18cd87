"""Generators of stored maps, whose family this process may not know.

Stored maps have an `UnknownFamily` as their generator if their family is not registered, or if its
registered class has other parameters by now. An author of a family needs none of this.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from functools import lru_cache, partial
from typing import Any

from mapdata.arrays import Ints
from mapdata.generators.generator import (
    ROOMS,
    SHARED_PARAMETERS,
    MapGenerator,
    family_named,
    is_of_mapdata,
    movement_of,
    registrations,
    why_unknown,
    with_generators,
)
from mapdata.generators.maps import Maps
from mapdata.hashing import canonical_json, parsed_json
from mapdata.limits import MAX_ROOMS

_MAX_NAME_LENGTH = 100
"""Largest number of characters of the name of an unknown family."""

_MAX_JSON_LENGTH = 4_000
"""Largest number of characters of the parameters of an unknown family as JSON. A shard has no room
for more.
"""

_MAX_DEPTH = 32
"""Deepest nesting of lists and objects in these parameters. Python fails at some hundreds."""


@dataclass(frozen=True)
class UnknownFamily(MapGenerator):
    """The generator of stored maps that this process cannot draw.

    Their family is not registered, or its registered class has other parameters than the stored
    ones. It keeps what the dataset states, so that the maps can be read, and have the same identity
    and recipe as where the family is known. It cannot draw maps.

    Attributes:
        name: name of the family in JSON.
        map_size, resolution, movement, splits: as of every generator.
        parameters: the other parameters, as canonical JSON.
        has_terrain: whether the maps have terrain, as the version of the dataset's format says.

    Raises:
        ValueError: parameters that no family can have.
    """

    name: str = ""  # type: ignore[misc]  # a field here, a class variable in other families
    parameters: str = "{}"
    has_terrain: bool = False  # a property of other families

    def __post_init__(self) -> None:
        """Check the parameters that can be checked without the family."""
        super().__post_init__()
        if not (self.name.isprintable() and 0 < len(self.name) <= _MAX_NAME_LENGTH):
            raise ValueError(
                f"generator: got {self.name[:_MAX_NAME_LENGTH]!r}, expected a name of 1 to "
                f"{_MAX_NAME_LENGTH} printable characters"
            )
        if len(self.parameters) > _MAX_JSON_LENGTH:
            raise ValueError(
                f"spec: its own values have {len(self.parameters)} characters, expected at most "
                f"{_MAX_JSON_LENGTH}"
            )

    @property
    def description(self) -> str:  # type: ignore[override]  # depends on the name
        """What the maps are, as far as the dataset says."""
        return f"maps of the family {self.name}"

    @property
    def max_seed_points(self) -> int:
        """The largest number that any map can have."""
        return MAX_ROOMS

    def draw(self, seed: int, indices: Ints) -> Maps:
        """Refuse to draw maps, since only the family could.

        Raises:
            ValueError: always.
        """
        raise ValueError(why_not_drawn(self))

    def to_dict(self) -> dict[str, Any]:
        """Return the parameters as plain values for JSON, as the family itself would."""
        return {
            "generator": self.name,
            "map_size": self.map_size,
            **parsed_json("parameters", self.parameters),
            "resolution": self.resolution,
            "movement": asdict(self.movement),
            "splits": self.splits,
        }


def stored_generator(text: str, has_terrain: bool = False) -> MapGenerator:
    """Return the generator that the JSON of a shard or manifest states.

    It is an `UnknownFamily` if the family is not registered. It is one, too, if the family is the
    code of a user, and its class has other parameters than when the maps were drawn.

    Args:
        text: the JSON.
        has_terrain: whether the maps have terrain. Of a family that is not registered, only the
            version of the dataset's format says so.

    Raises:
        ValueError: not JSON, or parameters that no generator can have.
    """
    return _cached_generator(text, has_terrain, len(registrations))


@lru_cache(maxsize=16)  # All shards of a dataset state the same generator.
def _cached_generator(text: str, has_terrain: bool, registration_count: int) -> MapGenerator:
    """Do the work of `stored_generator`, anew after each registration.

    A generator that was read before may be of the new family, or of the class that it replaces.
    """
    del registration_count
    return _stored_generator(parsed_json("spec", text), has_terrain)


def _stored_generator(values: Any, has_terrain: bool) -> MapGenerator:
    """Return the generator of the plain values that a shard or manifest states.

    ``has_terrain`` is as in `stored_generator`.
    """
    name = values.get("generator", ROOMS) if isinstance(values, dict) else ROOMS
    family = family_named(name) if isinstance(name, str) else None
    if family is not None and isinstance(values, dict):
        if is_of_mapdata(family):
            return _generator_of(family, values)
        with suppress(Exception):  # The code of a user may raise anything.
            generator = _generator_of(family, values)
            if _has_stored_form(generator, values, has_terrain):
                return generator
    if not isinstance(name, str) or not isinstance(values, dict):
        return MapGenerator.from_dict(values)  # which refuses them
    missing = [key for key in SHARED_PARAMETERS if key not in values]
    if missing:
        raise ValueError(f"spec: lacks {', '.join(missing)}, which every family has")
    parameters = {
        key: values[key] for key in values if key not in ("generator", *SHARED_PARAMETERS)
    }
    if _depth(parameters) > _MAX_DEPTH:
        raise ValueError(f"spec: lists and objects lie more than {_MAX_DEPTH} deep in one another")
    return UnknownFamily(
        name=name,
        parameters=canonical_json(parameters),
        has_terrain=has_terrain,
        map_size=values["map_size"],
        resolution=values["resolution"],
        movement=movement_of(values["movement"]),
        splits=values["splits"],
    )


def _generator_of(family: type[MapGenerator], values: Mapping[str, Any]) -> MapGenerator:
    """Return the generator of a registered family that stored plain values state."""
    # The families of inner generators may be unknown. Terrain lies over maps that have none of
    # their own, and mixtures have none.
    stored_generator_of = partial(_stored_generator, has_terrain=False)
    return MapGenerator.from_dict(with_generators(family, values, stored_generator_of))


def _has_stored_form(generator: MapGenerator, values: Mapping[str, Any], has_terrain: bool) -> bool:
    """Return whether a dataset of ``generator`` would state these plain values."""
    return generator.has_terrain == has_terrain and generator.to_json() == canonical_json(values)


def _depth(values: object) -> int:
    """Return how deeply lists and objects are nested: 0 for a plain value, 1 for a flat list."""
    if isinstance(values, dict):
        values = list(values.values())
    if not isinstance(values, list):
        return 0
    return 1 + max(map(_depth, values), default=0)


def unknown_family(generator: MapGenerator | None) -> UnknownFamily | None:
    """Return the family that keeps this process from drawing the maps of a stored generator.

    It is the generator itself, or one of its parameters; None if all families are known.
    """
    if generator is None:
        return None
    for part in (generator, *generator.inner_generators):
        if isinstance(part, UnknownFamily):
            return part
    return None


def why_not_drawn(unknown: UnknownFamily) -> str:
    """Return one line: why this process cannot draw the stored maps, and what to do."""
    family = family_named(unknown.name)
    if family is None:
        return why_unknown(unknown.name)
    stored = unknown.to_dict()
    changes = parameter_changes(family, stored)
    if not changes:
        try:
            generator = MapGenerator.from_dict(stored)
            if _has_stored_form(generator, stored, unknown.has_terrain):
                return (
                    f"the family {unknown.name!r} was not registered when the dataset was opened; "
                    "open it again"
                )
            changes = f"with other values: {_other_values(generator.to_dict(), stored)}"
        except Exception as error:  # The code of a user may raise anything.
            changes = " ".join(f"{type(error).__name__}: {error}".split())
    return (
        f"the stored parameters of the family {unknown.name!r} are not those of the registered "
        f"class {family.__name__} ({changes}); the stored maps can be read, but making more of "
        "them needs the class as it was when they were built"
    )


def _other_values(values: Mapping[str, Any], stored: Mapping[str, Any]) -> str:
    """Return the names of the parameters whose plain values are not the stored ones."""
    names = [
        name for name in stored if canonical_json(values[name]) != canonical_json(stored[name])
    ]
    return ", ".join(names or ["has_terrain"])


def parameter_changes(family: type[MapGenerator], stored: Mapping[str, Any]) -> str:
    """Return which parameters a class has gained and lost since plain values of it were stored.

    The text is empty if ``stored`` has exactly the parameters of the class.
    """
    names = [parameter.name for parameter in fields(family)]
    new = [name for name in names if name not in stored]
    removed = [name for name in stored if name not in ("generator", *names)]
    parts = [
        f"{change}: {', '.join(changed)}"
        for change, changed in (("new", new), ("removed", removed))
        if changed
    ]
    return "; ".join(parts)
