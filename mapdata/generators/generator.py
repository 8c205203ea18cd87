"""`MapGenerator`, the base class of all families of maps, and the registry of families and presets.

Stored maps whose family is not registered have a generator of `mapdata.generators.stored_families`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, field, fields
from functools import lru_cache
from inspect import isabstract
from types import MappingProxyType, UnionType
from typing import Any, ClassVar, TypeVar, Union, get_args, get_origin, get_type_hints

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
from mapdata.limits import TERRAIN_VERSION, Size, min_version
from mapdata.movement import Movement

G = TypeVar("G", bound="MapGenerator")

ROOMS = "rooms"
"""The only family of version 1 of the format. Its JSON has no key "generator"."""

SHARED_PARAMETERS = ("map_size", "resolution", "movement", "splits")
"""The parameters that every family has."""

ENTRY_POINTS = "mapdata.generators"
"""The group of entry points under which installed packages name their families."""


@dataclass(frozen=True, kw_only=True)
class MapGenerator(ABC):
    """A family of maps with its parameters: it draws map i of a seed.

    A family is a subclass: a frozen dataclass of plain values, which can be written as JSON.
    `register` makes it known by its name; `mapdata/generators/caves.py` is the shortest example.

    Attributes:
        name: name of the family in JSON.
        description: what the maps are, as the dataset card says it: "... made by mapdata".
        citation: the sentence that introduces the paper on the dataset card.
        generator_parameters: names of the parameters that are generators themselves, tuples of
            them, or None.
        map_size: (rows, columns) of a map, in cells, at most ``MAX_SIDE`` each.
        resolution: metres per cell.
        movement: the rule of moves.
        splits: fractions of maps in train, val and test; they add up to 1.
    """

    name: ClassVar[str]
    description: ClassVar[str]
    citation: ClassVar[str] = "The labels are those that this paper computes:"
    generator_parameters: ClassVar[tuple[str, ...]] = ()
    map_size: Size = field(default=(64, 64), kw_only=False)
    resolution: float = 0.1
    movement: Movement = field(default_factory=Movement)
    splits: tuple[float, float, float] = (0.8, 0.1, 0.1)

    def __post_init__(self) -> None:
        """Check the shared parameters, and convert them so that equal generators have equal JSON.

        Raises:
            ValueError: a parameter outside its limits.
        """
        self._convert(check_sides, "map_size")
        self._convert(check_resolution, "resolution")
        object.__setattr__(self, "splits", check_fractions(self.splits))
        if not isinstance(self.movement, Movement):
            raise ValueError(f"movement: got {self.movement!r}, expected a Movement")

    def _convert(self, check: Callable[[str, Any], object], *names: str) -> None:
        """Replace parameters of this frozen dataclass by what ``check(name, value)`` returns."""
        for name in names:
            object.__setattr__(self, name, check(name, getattr(self, name)))

    def _take_shared_parameters(self, name: str, inner: MapGenerator) -> None:
        """Take the parameters that every family has from the generator of the parameter ``name``.

        Raises:
            ValueError: one of them has a value of its own here.
        """
        for shared in SHARED_PARAMETERS:
            value = getattr(self, shared)
            if value not in (default_of(type(self), shared), getattr(inner, shared)):
                raise ValueError(
                    f"{shared}: got {value!r}, but `{name}` decides on it and has "
                    f"{getattr(inner, shared)!r}; leave it out"
                )
            object.__setattr__(self, shared, getattr(inner, shared))

    @property
    @abstractmethod
    def max_seed_points(self) -> int:
        """The largest number of seed points that a map can have."""

    @abstractmethod
    def draw(self, seed: int, indices: Ints) -> Maps:
        """Return the maps with the numbers ``indices``, (N,) int64 from 0.

        Each map depends on the generator, the seed and its number alone.
        """

    @property
    def has_terrain(self) -> bool:
        """Whether the maps have terrain: the cells of `Maps.terrain` have costs of their own."""
        return False

    @property
    def inner_generators(self) -> list[MapGenerator]:
        """The generators that are parameters of this one, and theirs; most generators have none."""
        generators: list[MapGenerator] = []
        for name in self.generator_parameters:
            for generator in _generators_of(getattr(self, name)):
                generators += [generator, *generator.inner_generators]
        return generators

    @property
    def format_version(self) -> int:
        """The lowest version of the format that can store maps of this generator."""
        if self.has_terrain:
            return TERRAIN_VERSION
        return min_version(self.map_size) if self.name == ROOMS else 2

    def to_dict(self) -> dict[str, Any]:
        """Return the parameters as plain values for JSON, with the name of the family."""
        values = asdict(self)
        for name in self.generator_parameters:
            parameter = getattr(self, name)
            if isinstance(parameter, MapGenerator):
                values[name] = parameter.to_dict()
            elif parameter is not None:
                values[name] = [generator.to_dict() for generator in parameter]
        # The parameters that all families share come after those of the family, except the size.
        last = ("resolution", "movement", "splits")
        names = [*(name for name in values if name not in last), *last]
        family = {} if self.name == ROOMS else {"generator": self.name}
        return family | {name: values[name] for name in names}

    def to_json(self) -> str:
        """Return the generator as canonical JSON: sorted keys, no white space."""
        return canonical_json(self.to_dict())

    @classmethod
    def preset(cls: type[G], name: str) -> G:
        """Return a preset of this family; `MapGenerator.preset` returns those of all families.

        Raises:
            ValueError: the family has no preset of this name.
        """
        presets = {
            name: generator for name, generator in PRESETS.items() if isinstance(generator, cls)
        }
        if name in PRESETS and name not in presets:
            raise ValueError(
                f"preset: {name!r} is of another family: MapGenerator.preset({name!r})"
            )
        check_choice("preset", name, presets)
        return presets[name]

    @classmethod
    def from_dict(cls: type[G], values: object) -> G:
        """Return the generator of plain values, as `to_dict` returns them, or of a preset's name.

        Missing parameters have their defaults.

        Raises:
            ValueError: an unknown family, preset or parameter, or a parameter outside its limits.
        """
        if isinstance(values, str):
            return cls.preset(values)
        if not isinstance(values, Mapping):
            raise ValueError(f"spec: got {values!r}, expected an object of named values")
        name = values.get("generator", ROOMS)
        if not isinstance(name, str):
            raise ValueError(f"generator: got {name!r}, expected the name of a family")
        family = family_named(name)
        if family is None:
            raise ValueError(f"generator: {why_unknown(name)}")
        if not issubclass(family, cls):
            raise ValueError(f"generator: got {name!r}, expected {cls.__name__}")
        parameters = known_values(
            "spec", values, family, "generator", synonyms={"family": "generator"}
        )
        parameters.pop("generator", None)
        if "movement" in parameters:
            parameters["movement"] = movement_of(parameters["movement"])
        parameters = with_generators(family, parameters, MapGenerator.from_dict)
        for key in _tuple_parameters(family):
            if key in parameters:
                parameters[key] = _as_tuples(parameters[key])
        return family(**parameters)

    @classmethod
    def from_json(cls: type[G], text: str) -> G:
        """Return the generator that a JSON text states.

        Raises:
            ValueError: not JSON, or values that `from_dict` refuses.
        """
        return cls.from_dict(parsed_json("spec", text))


def default_of(family: type[MapGenerator], name: str) -> object:
    """Return the default of a parameter of a family."""
    parameter = family.__dataclass_fields__[name]
    if parameter.default_factory is not MISSING:
        return parameter.default_factory()
    return parameter.default


def _tuple_parameters(family: type[MapGenerator]) -> list[str]:
    """Return the names of the parameters that are tuples by their annotation; JSON has lists.

    The families of mapdata are left out, since they convert and check their parameters themselves.
    """
    if is_of_mapdata(family):
        return []
    try:
        hints = get_type_hints(family)
    except Exception:  # An annotation may name what only type checkers import.
        return []
    names = []
    for parameter in fields(family):
        hint = hints[parameter.name]
        is_union = get_origin(hint) in (Union, UnionType)
        alternatives = get_args(hint) if is_union else (hint,)
        if any(tuple in (alternative, get_origin(alternative)) for alternative in alternatives):
            names.append(parameter.name)
    return names


def _as_tuples(values: object) -> Any:
    """Return ``values`` with every sequence in it turned into a tuple."""
    if isinstance(values, Sequence) and not isinstance(values, (str, bytes)):
        return tuple(_as_tuples(value) for value in values)
    return values


def with_generators(
    family: type[MapGenerator],
    values: Mapping[str, Any],
    generator_of: Callable[[Any], MapGenerator],
) -> dict[str, Any]:
    """Return plain values of a family in which generators stand for the values that state them.

    Args:
        family: the family.
        values: its parameters by name; those that are generators already stay.
        generator_of: returns the generator of plain values or of a preset's name.

    Raises:
        ValueError: a generator of the same family stands in one of them. Such values could be
            nested too deep for Python.
    """
    converted = dict(values)
    for key in family.generator_parameters:
        parameter = values.get(key)
        if family.name in _families_in(parameter):
            raise ValueError(f"{key}: got the family {family.name!r} in itself, expected another")
        if isinstance(parameter, (list, tuple)):
            converted[key] = tuple(
                part if isinstance(part, MapGenerator) else generator_of(part) for part in parameter
            )
        elif parameter is not None and not isinstance(parameter, MapGenerator):
            converted[key] = generator_of(parameter)
    return converted


def _families_in(values: object) -> set[str]:
    """Return the names of the families in nested plain values, however deep they lie."""
    families = set()
    waiting = [values]
    while waiting:
        nested = waiting.pop()
        if isinstance(nested, Mapping):
            family = nested.get("generator", ROOMS)
            if isinstance(family, str):
                families.add(family)
            waiting += nested.values()
        elif isinstance(nested, (list, tuple)):
            waiting += nested
    return families


def _generators_of(parameter: MapGenerator | Sequence[MapGenerator] | None) -> list[MapGenerator]:
    """Return the generators that one of `MapGenerator.generator_parameters` holds."""
    if parameter is None:
        return []
    return [parameter] if isinstance(parameter, MapGenerator) else list(parameter)


def movement_of(values: object) -> Movement:
    """Return the movement that plain values state."""
    return Movement(**known_values("movement", values, Movement))


GENERATORS: dict[str, type[MapGenerator]] = {}
"""All registered families, by their names in JSON."""

registrations: list[str] = []
"""The name of the family of each call of `register`, repeated calls included."""

_presets: dict[str, MapGenerator] = {}

PRESETS: Mapping[str, MapGenerator] = MappingProxyType(_presets)
"""The presets of all families: a read-only mapping from name to generator."""


def register(family: type[MapGenerator], presets: Mapping[str, MapGenerator] = {}) -> None:
    """Make a family and its presets known by name, to recipes, manifests and shards.

    Raises:
        ValueError: the class is not a frozen dataclass, or lacks what a family needs; or another
            family or preset has the name.
    """
    # A class without the decorator inherits the fields of its base class.
    is_dataclass = "__dataclass_fields__" in vars(family)
    if not is_dataclass or isabstract(family) or not hasattr(family, "name"):
        raise ValueError(
            f"{family.__name__}: expected a frozen dataclass with name, max_seed_points and draw"
        )
    check_declared(family)
    # A notebook defines the same class anew each time its cell runs; the new class replaces it.
    registered = GENERATORS.get(family.name, family)
    if (registered.__module__, registered.__qualname__) != (family.__module__, family.__qualname__):
        raise ValueError(f"{family.__name__}: {family.name!r} is the name of {registered}")
    for name, preset in presets.items():
        if name in PRESETS and not _may_replace(PRESETS[name], preset, family):
            raise ValueError(f"{family.__name__}: the preset {name!r} is there already")
    GENERATORS[family.name] = family
    _presets.update(presets)
    registrations.append(family.name)


def _may_replace(old: MapGenerator, new: MapGenerator, family: type[MapGenerator]) -> bool:
    """Return whether a preset of ``family`` may take the name of an older preset.

    It may if both are equal, or if the older one is of an earlier definition of the class.
    """
    is_of_earlier_class = old.name == family.name and not isinstance(old, family)
    return old == new or is_of_earlier_class


def family_named(name: str) -> type[MapGenerator] | None:
    """Return the family of a name, None if it is not known.

    A family that is not registered yet is searched among the entry points of installed packages.
    """
    if name not in GENERATORS:
        register_installed(name)
    return GENERATORS.get(name)


@lru_cache(maxsize=64)  # The search takes milliseconds, and its outcome does not change.
def register_installed(name: str) -> str:
    """Register the family that an entry point of an installed package names, if there is one.

    Returns:
        One line that says why an entry point could not be registered; an empty text if one was
        registered, or if there is none.
    """
    from importlib.metadata import entry_points  # slow to import, and only unknown families need it

    failure = ""
    for entry_point in entry_points(group=ENTRY_POINTS, name=name):
        source = f"the entry point '{name} = {entry_point.value}'"
        if entry_point.dist is not None:
            source += f" of the package {entry_point.dist.name}"
        try:
            family = entry_point.load()
            if name not in GENERATORS:  # Its module may have registered it.
                register(family)
            if name in GENERATORS:
                return ""
            failure = f"{source} is the family {family.name!r}"
        except (Exception, SystemExit) as error:  # The code of others may raise anything.
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            failure = f"{source} cannot be imported ({reason})"
    return failure


def why_unknown(name: str) -> str:
    """Return one line: the family is not known here, and how to make it known."""
    advice = register_installed(name)
    if not advice:
        advice = "import its module (--import MODULE in a command, import MODULE in Python)"
    hint = did_you_mean(name, GENERATORS)
    return (
        f"the family {name!r} is not known here; {advice}; known are {', '.join(GENERATORS)}{hint}"
    )


def check_declared(family: type[MapGenerator]) -> None:
    """Refuse a class that lacks a name or description, which manifest and card state.

    Raises:
        ValueError: the message says how to declare what is missing.
    """
    missing = [name for name in ("name", "description") if not hasattr(family, name)]
    if missing:
        declarations = " and ".join(f'{name}: ClassVar[str] = "..."' for name in missing)
        raise ValueError(
            f"{family.__name__}: has no {' and no '.join(missing)}; declare {declarations} in the "
            "class"
        )


def check_plain(generator: MapGenerator) -> None:
    """Refuse parameters that JSON cannot hold, which only the class of a user can have.

    Raises:
        ValueError: the message names the parameter.
    """
    for name, value in generator.to_dict().items():
        try:
            canonical_json(value)
        except (TypeError, ValueError):
            text = " ".join(repr(value).split())
            raise ValueError(
                f"{name}: got {text}, expected a value that JSON can hold: a finite number of "
                "Python, a text, a bool, None, or tuples of these"
            ) from None


def is_of_mapdata(family: type[MapGenerator]) -> bool:
    """Return whether a family is one of mapdata's own, rather than the code of a user."""
    return family.__module__.startswith("mapdata.")


def identity(generator: MapGenerator, seed: int) -> str:
    """Return the identity of the maps of a generator and a seed, 64 hexadecimal digits.

    It is the SHA-256 of the canonical JSON of format version, generator and seed. The number of
    maps is not part of it, so that a dataset can grow.
    """
    recipe = {
        "format_version": generator.format_version,
        "spec": generator.to_dict(),
        "seed": check_seed(seed),
    }
    return json_hash(recipe)
