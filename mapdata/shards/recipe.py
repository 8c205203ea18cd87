"""`Recipe`: a dataset as a few lines of JSON that can be shared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mapdata.checks import check_choice, check_count, check_seed, did_you_mean
from mapdata.generators.generator import PRESETS, MapGenerator, identity
from mapdata.hashing import parsed_json
from mapdata.shards.header import check_version

MAX_BYTES = 2**20
"""Largest file that is read as a recipe: one has some 600 bytes."""


@dataclass(frozen=True)
class Recipe:
    """All that is needed to build a dataset again, bit for bit.

    Attributes:
        spec: the distribution of maps.
        seed: 64-bit seed.
        maps: how many.
        content_hash: what the result must hash to, if known.
    """

    spec: MapGenerator
    seed: int = 0
    maps: int = 10_000
    content_hash: str | None = None

    @staticmethod
    def load(given: str | Mapping[str, Any]) -> Recipe:
        """Return the recipe of a preset's name, a JSON file, JSON text, or what such text holds.

        Args:
            given: the name, path or text; or a dict or another mapping.

        Raises:
            ValueError: none of these, or a recipe with impossible values.
        """
        values = _parsed(given) if isinstance(given, str) else given
        known = ("content_hash", "format_version", "identity", "maps", "seed", "spec")
        if not isinstance(values, Mapping):
            raise ValueError(f"recipe: expected an object with {', '.join(known)}")
        for name in values:
            check_choice("recipe", name, known)
        check_version(values.get("format_version", 1), "recipe: ", ValueError)
        recipe = Recipe(
            spec=MapGenerator.from_dict(values.get("spec", {})),
            seed=check_seed(values.get("seed", 0)),
            maps=check_count("maps", values.get("maps", Recipe.maps)),
            content_hash=values.get("content_hash"),
        )
        if values.get("identity") not in (None, identity(recipe.spec, recipe.seed)):
            raise ValueError(
                f"recipe: its identity {values['identity']} is not that of its spec and seed"
            )
        return recipe


def _parsed(text: str) -> object:
    """Return the values that ``text`` names: a preset, a JSON file or JSON text."""
    if text in PRESETS:
        return {"spec": text}
    if not text.lstrip().startswith("{"):
        if not Path(text).is_file():
            raise ValueError(
                f"recipe: {text!r} is no preset ({', '.join(PRESETS)}), no file and no JSON text"
                f"{did_you_mean(text, PRESETS)}"
            )
        size = Path(text).stat().st_size
        if size > MAX_BYTES:
            raise ValueError(f"recipe: {text} has {size} bytes, expected at most {MAX_BYTES}")
        return parsed_json(f"recipe: {text}", Path(text).read_bytes())
    return parsed_json("recipe", text)
