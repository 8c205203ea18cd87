"""What a family of maps is: a `MapGenerator` with a name; the registry of families; the identity.

Stored maps of a family that is not registered have an `UnknownFamily` as their generator.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from inspect import isabstract
from typing import Any, ClassVar, TypeVar

import numpy as np

from mapdata.arrays import Ints
from mapdata.checks import (
    check_choice,
    check_fractions,
    check_resolution,
    check_seed,
    check_sides,
    did_you_mean,
    known_values,
)
from mapdata.generators.maps import Maps
from mapdata.hashing import canonical_json, json_hash, parsed_json
from mapdata.limits import MAX_ROOMS, Size, min_version
from mapdata.movement import Movement

G = TypeVar("G", bound="MapGenerator")

_FIRST = "rooms"
"""The generator that version 1 of the format knows: its specs say no name."""

ENTRY_POINTS = "mapdata.generators"
"""The group of entry points in which installed packages name their families."""

_MAX_NAME = 100
"""Characters of the name of an unknown family."""

_MAX_PARAMETERS = 4_000
"""Characters of the parameters of an unknown family as JSON: a shard has no room for more."""

_MAX_DEPTH = 32
"""How deep lists and objects may lie in one another there: Python fails at some hundreds."""


@dataclass(frozen=True, kw_only=True)
class MapGenerator(ABC):
    """A distribution of maps: a frozen dataclass of plain values that can be written as JSON.

    A family of maps is a subclass in a file of its own, which `register` makes known;
    `mapdata/generators/mazes.py` is the shortest example.

    Attributes:
        name: what JSON calls the family.
        description: what its maps are, in words that go on as "... made by mapdata".
        citation: what the paper below this sentence has to do with them.
        map_size: (rows, columns) of a map, in cells, at most ``MAX_SIDE`` each.
        resolution: metres per cell.
        movement: how paths move.
        splits: fractions of maps in train, val and test; they add up to 1.
    """

    name: ClassVar[str]
    description: ClassVar[str]
    citation: ClassVar[str] = "The labels are those that this paper computes:"
    map_size: Size = field(default=(64, 64), kw_only=False)
    resolution: float = 0.1
    movement: Movement = field(default_factory=Movement)
    splits: tuple[float, float, float] = (0.8, 0.1, 0.1)

    def __post_init__(self) -> None:
        """Check what all families share, and make equal specs have equal JSON.

        Raises:
            ValueError: a value outside these limits.
        """
        self._convert(check_sides, "map_size")
        self._convert(check_resolution, "resolution")
        object.__setattr__(self, "splits", check_fractions(self.splits))
        if not isinstance(self.movement, Movement):
            raise ValueError(f"movement: got {self.movement!r}, expected a Movement")

    def _convert(self, check: Callable[[str, Any], object], *names: str) -> None:
        """Replace values of this frozen dataclass by what ``check(name, value)`` makes of them."""
        for name in names:
            object.__setattr__(self, name, check(name, getattr(self, name)))

    @property
    @abstractmethod
    def most_seed_points(self) -> int:
        """The largest number of seed points that a map can have."""

    @abstractmethod
    def draw(self, seed: int, indices: Ints) -> Maps:
        """Return the maps ``indices``, (N,) int64 from 0.

        Each is a function of (self, seed, index) alone.
        """

    @property
    def format_version(self) -> int:
        """The least version of the format that can say this distribution."""
        return min_version(self.map_size) if self.name == _FIRST else 2

    def to_dict(self) -> dict[str, Any]:
        """Return the spec as plain values for JSON."""
        values = asdict(self)
        for name in ("resolution", "movement", "splits"):
            values[name] = values.pop(name)  # behind those of the family
        return values if self.name == _FIRST else {"generator": self.name, **values}

    def to_json(self) -> str:
        """Return the spec as canonical JSON: sorted keys, no white space."""
        return canonical_json(self.to_dict())

    @classmethod
    def preset(cls: type[G], name: str) -> G:
        """Return the preset ``name`` of this family, or, as `MapGenerator.preset`, of any.

        Raises:
            ValueError: no such preset.
        """
        known = {name: spec for name, spec in PRESETS.items() if isinstance(spec, cls)}
        if name in PRESETS and name not in known:
            raise ValueError(
                f"preset: {name!r} is of another family: MapGenerator.preset({name!r})"
            )
        check_choice("preset", name, known)
        return known[name]

    @classmethod
    def from_dict(cls: type[G], values: object) -> G:
        """Return the spec with the values that `to_dict` gave; missing ones take their defaults.

        The name of a preset stands for its values.

        Raises:
            ValueError: an unknown name, or a value that a spec refuses.
        """
        if isinstance(values, str):
            return cls.preset(values)
        if not isinstance(values, Mapping):
            raise ValueError(f"spec: got {values!r}, expected an object of named values")
        name = values.get("generator", _FIRST)
        if not isinstance(name, str):
            raise ValueError(f"generator: got {name!r}, expected the name of a family")
        family = family_named(name)
        if family is None:
            raise ValueError(f"generator: {why_unknown(name)}")
        if not issubclass(family, cls):
            raise ValueError(f"generator: got {name!r}, expected {cls.__name__}")
        known = known_values("spec", values, family, "generator", synonyms={"family": "generator"})
        known.pop("generator", None)
        if "movement" in known:
            known["movement"] = _movement(known["movement"])
        return family(**known)

    @classmethod
    def from_json(cls: type[G], text: str) -> G:
        """Return the spec that JSON text states.

        Raises:
            ValueError: not JSON, or no spec.
        """
        return cls.from_dict(parsed_json("spec", text))


@dataclass(frozen=True)
class UnknownFamily(MapGenerator):
    """The generator of stored maps whose family is not registered in this process.

    It says what the dataset states, so that its maps can be read and have the same identity and the
    same recipe as where the family is known. It draws no maps.

    Attributes:
        name: what JSON calls the family.
        map_size, resolution, movement, splits: as of every generator.
        parameters: the other values, as canonical JSON.

    Raises:
        ValueError: values that no family can have.
    """

    name: str = ""  # type: ignore[misc]  # every object has its own
    parameters: str = "{}"

    def __post_init__(self) -> None:
        """Check what can be checked without the family."""
        super().__post_init__()
        if not (self.name.isprintable() and 0 < len(self.name) <= _MAX_NAME):
            raise ValueError(
                f"generator: got {self.name[:_MAX_NAME]!r}, expected a name of 1 to {_MAX_NAME} "
                "printable characters"
            )
        if len(self.parameters) > _MAX_PARAMETERS:
            raise ValueError(
                f"spec: its own values have {len(self.parameters)} characters, expected at most "
                f"{_MAX_PARAMETERS}"
            )

    @property
    def description(self) -> str:  # type: ignore[override]  # every object has its own
        """What its maps are, as far as the dataset says."""
        return f"maps of the family {self.name}"

    @property
    def most_seed_points(self) -> int:
        """As many as any map can have."""
        return MAX_ROOMS

    def draw(self, seed: int, indices: Ints) -> Maps:
        """Refuse: the family would be needed.

        Raises:
            ValueError: always.
        """
        raise ValueError(why_unknown(self.name))

    def to_dict(self) -> dict[str, Any]:
        """Return the spec as plain values for JSON, as the family itself would."""
        return {
            "generator": self.name,
            "map_size": self.map_size,
            **parsed_json("parameters", self.parameters),
            "resolution": self.resolution,
            "movement": asdict(self.movement),
            "splits": self.splits,
        }


@lru_cache(maxsize=16)  # all shards of a dataset state the same one
def stored_generator(text: str) -> MapGenerator:
    """Return the generator that the JSON of a shard or manifest states.

    That of a family which is not registered is an `UnknownFamily`.

    Raises:
        ValueError: not JSON, or what no generator can be.
    """
    values = parsed_json("spec", text)
    name = values.get("generator", _FIRST) if isinstance(values, dict) else _FIRST
    if not isinstance(name, str) or family_named(name) is not None:
        return MapGenerator.from_dict(values)
    shared = ("map_size", "resolution", "movement", "splits")
    missing = [key for key in shared if key not in values]
    if missing:
        raise ValueError(f"spec: lacks {', '.join(missing)}, which every family has")
    parameters = {key: values[key] for key in values if key not in ("generator", *shared)}
    if _depth(parameters) > _MAX_DEPTH:
        raise ValueError(f"spec: lists and objects lie more than {_MAX_DEPTH} deep in one another")
    return UnknownFamily(
        name=name,
        parameters=canonical_json(parameters),
        map_size=values["map_size"],
        resolution=values["resolution"],
        movement=_movement(values["movement"]),
        splits=values["splits"],
    )


def _movement(values: object) -> Movement:
    """Return the movement that plain values state."""
    return Movement(**known_values("movement", values, Movement))


def _depth(values: object) -> int:
    """Return how deep lists and objects lie in one another; 0 for a plain value."""
    if isinstance(values, dict):
        values = list(values.values())
    return 1 + max(map(_depth, values), default=0) if isinstance(values, list) else 0


GENERATORS: dict[str, type[MapGenerator]] = {}
"""All families, by the name that JSON calls them."""

PRESETS: dict[str, MapGenerator] = {}
"""Specs with a name, of all families."""


def register(family: type[MapGenerator], presets: Mapping[str, MapGenerator] = {}) -> None:
    """Make a family and its presets known by name, to recipes, manifests and shards.

    Raises:
        ValueError: it is no frozen dataclass, or lacks what a family needs, or a name is taken.
    """
    # a class that is not decorated has the fields of the one above it only
    is_dataclass = "__dataclass_fields__" in vars(family)
    if not is_dataclass or isabstract(family) or not hasattr(family, "name"):
        raise ValueError(
            f"{family.__name__}: expected a frozen dataclass with name, most_seed_points and draw"
        )
    # The same class once more takes the place of its own: a notebook runs its cells again.
    taken = GENERATORS.get(family.name, family)
    if (taken.__module__, taken.__qualname__) != (family.__module__, family.__qualname__):
        raise ValueError(f"{family.__name__}: {family.name!r} is the name of {taken}")
    for name, spec in presets.items():
        there = PRESETS.get(name, spec)
        if there != spec and (there.name != family.name or isinstance(there, family)):
            raise ValueError(f"{family.__name__}: the preset {name!r} is there already")
    GENERATORS[family.name] = family
    PRESETS.update(presets)
    # What was read before may be of this family, or of the class that it replaces.
    stored_generator.cache_clear()


def family_named(name: str) -> type[MapGenerator] | None:
    """Return the family of a name, None if it is not known.

    One that is not registered is looked for among the entry points of installed packages.
    """
    if name not in GENERATORS:
        register_installed(name)
    return GENERATORS.get(name)


@lru_cache(maxsize=64)
def register_installed(name: str) -> str:
    """Register the family that an entry point of an installed package names, if there is one.

    Looking for it takes some milliseconds, so it is done once a process for each name.

    Returns:
        Why there is one that could not be registered, on one line; otherwise an empty text.
    """
    from importlib.metadata import entry_points  # only unknown families need it

    failure = ""
    for entry_point in entry_points(group=ENTRY_POINTS, name=name):
        what = f"the entry point '{name} = {entry_point.value}'"
        if entry_point.dist is not None:
            what += f" of the package {entry_point.dist.name}"
        try:
            family = entry_point.load()
            if name not in GENERATORS:  # its module may have done so
                register(family)
            if name in GENERATORS:
                return ""
            failure = f"{what} is the family {family.name!r}"
        except (Exception, SystemExit) as error:  # whatever the code of others raises
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            failure = f"{what} cannot be imported ({reason})"
    return failure


def why_unknown(name: str) -> str:
    """Return one line: the family is not known here, and what to do."""
    failure = register_installed(name)
    advice = failure or "import its module (--import MODULE in a command, import MODULE in Python)"
    hint = did_you_mean(name, GENERATORS)
    return (
        f"the family {name!r} is not known here; {advice}; known are {', '.join(GENERATORS)}{hint}"
    )


def check_spec(spec: object) -> None:
    """Refuse what draws no maps.

    Raises:
        ValueError: it is no family with its parameters, such as the name of a preset, or the family
            is not known.
    """
    if not isinstance(spec, MapGenerator):
        raise ValueError(f"spec: got {spec!r}, expected a MapSpec or another MapGenerator")
    if isinstance(spec, UnknownFamily):
        raise ValueError(f"spec: {why_unknown(spec.name)}")


def generate(spec: MapGenerator, seed: int, indices: Iterable[int]) -> Maps:
    """Return the maps ``indices`` of (spec, seed).

    Map i is a pure function of (format version, spec, seed, i): the batch, its order and the
    machine do not matter.

    Raises:
        ValueError: what is no spec; a seed or an index that is not a non-negative integer of 64
            (63) bits; a family that draws no seed points, or some outside of the map.

    >>> from mapdata import MapSpec
    >>> maps = generate(MapSpec(), seed=0, indices=range(3))
    >>> maps.occupancy.shape, maps.rooms.tolist()
    ((3, 64, 64), [5, 9, 2])
    """
    check_spec(spec)
    if isinstance(indices, Iterable) and not isinstance(indices, np.ndarray):
        indices = list(indices)
    index = np.asarray(indices)
    whole = index.dtype.kind in "iu"
    good = index.size == 0 or (whole and index.min() >= 0 and int(index.max()) < 2**63)
    if index.ndim != 1 or not good:
        raise ValueError(f"indices: got {indices!r}, expected integers from 0 to 2**63 - 1")
    maps = spec.draw(check_seed(seed), np.array(index, np.int64))
    # Compiled code relies on these, and a family of one's own may not keep them.
    points = maps.seed_points
    is_outside = (points < -1) | (points >= spec.map_size)
    counts = (points[:, :, 0] >= 0).sum(axis=1)
    # Of fewer bits, products of counts would overflow.
    as_stated = maps.rooms.dtype == np.int64 and (counts == maps.rooms).all()
    if is_outside.any() or not (counts.all() and as_stated):
        raise ValueError(
            f"{spec.name}: drew seed points outside of a map, none, or not as stated (by int64)"
        )
    return maps


def identity(spec: MapGenerator, seed: int) -> str:
    """Return the identity of a dataset, as hex.

    The SHA-256 of the canonical JSON of format version, spec and seed. The number of maps is not in
    it, so that a dataset can grow.
    """
    recipe = {
        "format_version": spec.format_version,
        "spec": spec.to_dict(),
        "seed": check_seed(seed),
    }
    return json_hash(recipe)
