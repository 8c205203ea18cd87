"""Recipes: which maps are meant, as a `Recipe` or anything that `as_recipe` turns into one."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mapdata._version import __version__
from mapdata.arrays import Array, Flags, Ints
from mapdata.checks import check_choice, check_count, check_seed, did_you_mean
from mapdata.generators.generator import (
    PRESETS,
    SHARED_PARAMETERS,
    MapGenerator,
    check_declared,
    check_plain,
    identity,
    is_of_mapdata,
)
from mapdata.generators.maps import Maps
from mapdata.generators.stored_families import UnknownFamily, parameter_changes, why_not_drawn
from mapdata.hashing import parsed_json
from mapdata.limits import FORMAT_VERSIONS

MAX_RECIPE_BYTES = 2**20
"""Largest file that is read as a recipe. A recipe has some 600 bytes."""

_KEYS = ("content_hash", "format_version", "identity", "maps", "seed", "spec")
"""The keys of a recipe in JSON; each of them may be left out."""

_ENDINGS_OF_MAPS = (".yaml", ".yml", ".map", ".png", ".pgm", ".jpg", ".bmp", ".npy", ".npz")
"""Endings of files that users give in place of a recipe, although they hold maps."""

_EXAMPLE = '{"spec": "dungeon", "seed": 7, "maps": 500}'
"""A recipe as JSON, for error messages."""


class RecipeError(ValueError):
    """An object that stands for no recipe: no preset, no file, and of no type that has one."""


@dataclass(frozen=True)
class Recipe:
    """Which maps: a generator, a seed and the number of maps.

    It is all that is needed to build a dataset again, bit for bit.

    Attributes:
        generator: the generator.
        seed: 64-bit seed.
        maps: number of maps.
        content_hash: hash of these maps and their labels, as hex; None if it is not known. `build`
            compares it with the hash of what it built.

    Raises:
        ValueError: no generator, one whose family is not known here or lacks a name, or a bad seed
            or number.

    >>> from mapdata import MapSpec
    >>> Recipe(MapSpec.preset("dungeon"), seed=7, maps=500).maps
    500
    """

    generator: MapGenerator
    seed: int = 0
    maps: int = 10_000
    content_hash: str | None = None

    def __post_init__(self) -> None:
        """Check the values, and turn the integers of other libraries into ints."""
        if not isinstance(self.generator, MapGenerator):
            raise ValueError(
                f"spec: got {self.generator!r}, expected a MapSpec or another MapGenerator"
            )
        for generator in (self.generator, *self.generator.inner_generators):
            if isinstance(generator, UnknownFamily):
                raise ValueError(f"spec: {why_not_drawn(generator)}")
            check_declared(type(generator))
        if self.content_hash is not None and not _is_sha256(self.content_hash):
            raise ValueError(
                f"content_hash: got {self.content_hash!r}, expected a SHA-256 in hexadecimal digits"
            )
        object.__setattr__(self, "seed", check_seed(self.seed))
        object.__setattr__(self, "maps", check_count("maps", self.maps))

    def to_dict(self) -> dict[str, Any]:
        """Return the recipe as plain values for JSON, which `as_recipe` reads.

        Raises:
            ValueError: a parameter of the generator that JSON cannot hold.
        """
        check_plain(self.generator)
        values: dict[str, Any] = {
            "format_version": self.generator.format_version,
            "spec": self.generator.to_dict(),
            "seed": self.seed,
            "maps": self.maps,
            "identity": identity(self.generator, self.seed),
        }
        if self.content_hash is not None:
            values["content_hash"] = self.content_hash
        return values


RecipeLike = str | Path | Mapping[str, Any] | MapGenerator | Recipe
"""What `as_recipe` accepts, and with it everything that asks which maps are meant."""


def as_recipe(recipe: RecipeLike, *, seed: int | None = None, maps: int | None = None) -> Recipe:
    """Return the recipe that is meant.

    Args:
        recipe: a preset's name, the path of a recipe file, JSON text, a mapping with the keys of
            such JSON, a `MapGenerator` or a `Recipe`. What it leaves out has the defaults of
            `Recipe`.
        seed: the seed instead of the recipe's.
        maps: the number of maps instead of the recipe's. A recipe of another seed or number has no
            content hash.

    Raises:
        RecipeError: none of these.
        ValueError: no such file, or a recipe with impossible values.

    >>> as_recipe("maze", maps=20).maps
    20
    """
    loaded = _load(recipe)
    overridden = Recipe(
        loaded.generator,
        seed=loaded.seed if seed is None else seed,
        maps=loaded.maps if maps is None else maps,
    )
    is_unchanged = (overridden.seed, overridden.maps) == (loaded.seed, loaded.maps)
    return loaded if is_unchanged else overridden


def _is_sha256(text: object) -> bool:
    """Return whether ``text`` is a SHA-256 in lower-case hexadecimal digits."""
    return isinstance(text, str) and re.fullmatch("[0-9a-f]{64}", text) is not None


def _load(recipe: object) -> Recipe:
    """Return the recipe that an object of any accepted type stands for."""
    if isinstance(recipe, Recipe):
        return recipe
    if isinstance(recipe, MapGenerator):
        return Recipe(recipe)
    if isinstance(recipe, Mapping):
        return _from_mapping(recipe)
    if isinstance(recipe, str):
        if recipe in PRESETS:
            return Recipe(PRESETS[recipe])
        if recipe.lstrip().startswith("{"):
            return _from_json("recipe", recipe)
    if isinstance(recipe, (str, Path)) and os.path.isfile(recipe):
        return _from_file(recipe)
    if isinstance(recipe, Path) or (isinstance(recipe, str) and _looks_like_a_path(recipe)):
        if os.path.isdir(recipe):
            raise ValueError(
                f"recipe: {recipe}: is a folder, expected a recipe as JSON; problems of a dataset "
                "are served by ProblemSet.read, MapDataset and MapDataModule"
            )
        raise ValueError(f"recipe: {recipe}: no such file, expected a recipe as JSON")
    raise RecipeError(
        f"recipe: got {recipe!r}, expected a preset ({', '.join(PRESETS)}), the path of a recipe "
        f"file, JSON text such as {_EXAMPLE}, a mapping, a MapGenerator or a Recipe"
        f"{did_you_mean(recipe, PRESETS) if isinstance(recipe, str) else ''}"
    )


def _looks_like_a_path(text: str) -> bool:
    """Return whether a text can only be meant as the path of a recipe file."""
    return "/" in text or os.sep in text or text.endswith(".json")


def _from_file(path: str | Path) -> Recipe:
    """Return the recipe of a JSON file, which is not read if it is too large."""
    byte_count = os.path.getsize(path)
    is_map = Path(path).suffix.lower() in _ENDINGS_OF_MAPS
    try:
        if byte_count > MAX_RECIPE_BYTES:
            raise ValueError(
                f"recipe: {path} has {byte_count} bytes, expected at most {MAX_RECIPE_BYTES}"
            )
        return _from_json(f"recipe: {path}", Path(path).read_bytes())
    except ValueError as error:
        if not is_map:
            raise
        raise ValueError(
            f"{error}. Of a map or picture 'mapdata import {path} ROOT' makes a dataset"
        ) from None


def _from_json(source: str, text: str | bytes) -> Recipe:
    """Return the recipe of a JSON text; ``source`` begins the error message."""
    try:
        values = parsed_json(source, text)
    except ValueError as error:
        raise ValueError(f"{error}; expected JSON such as {_EXAMPLE}") from None
    if not isinstance(values, Mapping):
        raise ValueError(f"{source}: expected an object with {', '.join(_KEYS)}")
    return _from_mapping(values)


def _from_mapping(values: Mapping[str, Any]) -> Recipe:
    """Return the recipe that plain values state, as JSON and configurations hold them."""
    for key in values:
        if key in SHARED_PARAMETERS:
            raise ValueError(
                f"recipe: got {key!r}, a parameter of the generator: write it into spec, as in "
                f'{{"spec": {{"generator": "cave", "{key}": ...}}}}'
            )
        check_choice("recipe", key, _KEYS)
    version = values.get("format_version", 1)
    if version not in FORMAT_VERSIONS:
        known_versions = f"{FORMAT_VERSIONS[0]} to {FORMAT_VERSIONS[-1]}"
        raise ValueError(
            f"recipe: format version {version}, this mapdata {__version__} reads {known_versions}"
        )
    recipe = Recipe(
        generator=MapGenerator.from_dict(values.get("spec", {})),
        seed=values.get("seed", Recipe.seed),
        maps=values.get("maps", Recipe.maps),
        content_hash=values.get("content_hash"),
    )
    if values.get("identity") not in (None, identity(recipe.generator, recipe.seed)):
        raise ValueError(
            f"recipe: its identity {values['identity']} is not that of its spec and seed"
            f"{_why_another_identity(recipe.generator, values.get('spec'))}"
        )
    return recipe


def _why_another_identity(generator: MapGenerator, spec: object) -> str:
    """Return the end of an error message: how the class of a user differs from a recipe's spec."""
    family = type(generator)
    if is_of_mapdata(family) or not isinstance(spec, Mapping):
        return ""
    changes = parameter_changes(family, spec)
    if not changes:
        return ""
    return f": its parameters are not those of the registered class {family.__name__} ({changes})"


def generate(
    recipe: RecipeLike, seed: int | None = None, indices: Iterable[int] | None = None
) -> Maps:
    """Return maps of a recipe.

    Map i is a pure function of (format version, generator, seed, i): the batch, its order and the
    machine do not matter.

    Args:
        recipe: which maps: a preset's name, a recipe file, its JSON text or mapping, a
            `MapGenerator` or a `Recipe`.
        seed: 64-bit seed; the recipe's by default, 0 for a preset or generator.
        indices: numbers of the maps, from 0; all maps of the recipe by default.

    Raises:
        ValueError: no recipe; a seed or an index that is not a non-negative integer of 64 (63)
            bits; a family that returns no `Maps`, or draws no seed points, some outside of the map,
            or terrain that does not fit its maps.

    >>> maps = generate("paper", seed=0, indices=range(3))
    >>> maps.occupancy.shape, maps.rooms.tolist()
    ((3, 64, 64), [5, 9, 2])
    """
    recipe = as_recipe(recipe, seed=seed)
    if indices is None:
        indices = range(recipe.maps)
    numbers = _map_numbers(indices)
    maps = recipe.generator.draw(recipe.seed, numbers)
    if not isinstance(maps, Maps) or len(maps) != len(numbers):
        drawn = f"{len(maps)} maps" if isinstance(maps, Maps) else f"a {type(maps).__name__}"
        raise ValueError(
            f"{recipe.generator.name}: draw returned {drawn}, expected Maps of {len(numbers)} "
            "maps; with_seed_points(self, seed, indices, grids) of mapdata.generators makes them "
            "of grids"
        )
    _check_seed_points(recipe.generator, maps)
    _check_terrain(recipe.generator, maps)
    return maps


def check_reproducible(recipe: Recipe) -> None:
    """Refuse a family of a user whose maps depend on more than parameters, seed and number.

    Map 1 is drawn twice, once after map 0 and once alone. Families of mapdata are not drawn.

    Raises:
        ValueError: the two differ, or as `generate`.
    """
    if is_pinned(recipe.generator):
        return
    two = generate(recipe, indices=[0, 1])
    alone = generate(recipe, indices=[1])
    if not is_same_map(two, 1, alone, 0):
        raise ValueError(
            f"{recipe.generator.name}: map 1 differs when it is drawn again, so its recipe would "
            "not make the same maps twice; draw must take all random numbers from block(seed, "
            "index, 0, MAP, number) of mapdata.rng, so that they depend on the seed and the number "
            "of the map alone"
        )


def is_pinned(generator: MapGenerator) -> bool:
    """Return whether tests of mapdata pin the maps of a generator: it is of no user's family."""
    generators = (generator, *generator.inner_generators)
    return all(is_of_mapdata(type(each)) for each in generators)


def is_same_map(maps: Maps, k: int, others: Maps, other_k: int) -> bool:
    """Return whether row ``k`` of ``maps`` and row ``other_k`` of ``others`` are drawn alike."""
    drawn = _arrays_of_map(maps, k)
    drawn_elsewhere = _arrays_of_map(others, other_k)
    return len(drawn) == len(drawn_elsewhere) and all(map(np.array_equal, drawn, drawn_elsewhere))


def _arrays_of_map(maps: Maps, k: int) -> list[Array]:
    """Return all that was drawn for row ``k``, without padding."""
    rooms = int(maps.rooms[k])
    arrays: list[Array] = [
        maps.packed[k],
        maps.rooms[k],
        maps.passage_width[k],
        maps.seed_points[k, :rooms],
        maps.sizes[k, :rooms],
        maps.directions[k, : rooms - 1],
        maps.split[k],
    ]
    return arrays if maps.terrain is None else [*arrays, maps.terrain[k]]


def _map_numbers(indices: Iterable[int]) -> Ints:
    """Return the numbers of maps as a new array, (N,) int64."""
    if isinstance(indices, Iterable) and not isinstance(indices, np.ndarray):
        indices = list(indices)  # numpy does not read the numbers of other iterables
    numbers = np.asarray(indices)
    is_integer = numbers.dtype.kind in "iu"  # an empty list becomes an array of floats
    in_range = numbers.size == 0 or (
        is_integer and numbers.min() >= 0 and int(numbers.max()) < 2**63
    )
    if numbers.ndim != 1 or not in_range:
        raise ValueError(f"indices: got {indices!r}, expected integers from 0 to 2**63 - 1")
    return np.array(numbers, np.int64)


def _check_seed_points(generator: MapGenerator, maps: Maps) -> None:
    """Refuse maps whose seed points compiled code could not rely on.

    The families of mapdata keep these rules; a family that a user wrote may break them.
    """
    if maps.rooms.dtype != np.int64:  # Products of counts of fewer bits would overflow.
        raise ValueError(
            f"{generator.name}: drew Maps.rooms of type {maps.rooms.dtype}, expected int64"
        )
    points = maps.seed_points
    rows, columns = generator.map_size
    outside = (points < -1) | (points >= generator.map_size)  # (N, R, 2): its row, its column
    is_outside: Flags = outside[:, :, 0] | outside[:, :, 1]
    point_counts = (points[:, :, 0] >= 0).sum(axis=1)
    is_unsound: Flags = is_outside.any(axis=1) | (point_counts != maps.rooms) | (point_counts == 0)
    if not is_unsound.any():
        return
    row = int(is_unsound.argmax())
    if is_outside[row].any():
        point = int(is_outside[row].argmax())
        cell = tuple(points[row, point].tolist())
        fault = f"with the seed point {cell}, expected cells of a map of {rows} x {columns}"
    elif point_counts[row] != maps.rooms[row]:
        fault = f"with {point_counts[row]} seed points, but Maps.rooms says {maps.rooms[row]}"
    elif maps.occupancy[row].all():
        fault = "with all cells occupied, expected at least one free cell for a seed point"
    else:
        fault = "without a seed point, expected at least one"
    raise ValueError(f"{generator.name}: drew map {maps.index[row]} {fault}")


def _check_terrain(generator: MapGenerator, maps: Maps) -> None:
    """Refuse terrain that does not fit the maps, which only a family of a user can draw."""
    terrain = maps.terrain
    if (terrain is not None) != generator.has_terrain:
        raise ValueError(
            f"{generator.name}: drew {'no ' if terrain is None else ''}terrain, but has_terrain is "
            f"{generator.has_terrain}"
        )
    if terrain is None:
        return
    is_array = isinstance(terrain, np.ndarray) and terrain.dtype == np.uint8
    if not is_array or not np.array_equal(terrain == 0, maps.occupancy):
        raise ValueError(
            f"{generator.name}: drew terrain that does not fit its maps, expected (N, H, W) uint8 "
            "with 0 on occupied cells and on no other"
        )
