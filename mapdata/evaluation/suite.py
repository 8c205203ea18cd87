"""Frozen suites of problems: maps of families that networks may be trained on, and of others.

A suite never changes. Its parts are drawn from a generator and a seed, and checked by their hashes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

from mapdata.evaluation.held_out import SHAPES, HeldOut
from mapdata.generators.generator import PRESETS, MapGenerator
from mapdata.movement import Movement
from mapdata.problems.problem_set import ProblemSet
from mapdata.problems.sources import Random

SUITE_MOVEMENT = Movement(8)
"""The rule of moves of all suites: 8 moves, no cut corners, diagonal moves of sqrt 2."""

_PROBLEMS = 200
"""Number of problems of a part, each on a map of its own."""

_HARD_PROBLEMS = Random(hardness=(1.05, None), distance=(10, None))
"""The straight way is blocked."""

_LONG_PROBLEMS = Random(length=(25, None))
"""On terrain, where hardness says nothing."""

Group = Literal["in", "out", "terrain"]


@dataclass(frozen=True)
class Part:
    """The problems of a suite on maps of one family and size.

    Attributes:
        name: the family and the side of its maps, such as "cave-64".
        group: "in" for families that networks may be trained on, "out" for those that no network
            may be trained or tuned on, "terrain" for maps whose free cells have costs.
        generator: draws the maps.
        problems: draws start and goal.
        seed: of maps and problems.
        content_hash: that of the problems, `ProblemSet.content_hash`.
    """

    name: str
    group: Group
    generator: MapGenerator
    problems: Random
    seed: int
    content_hash: str

    def problem_set(self) -> ProblemSet:
        """Draw the problems, which takes a second or less.

        Raises:
            ValueError: they are others than the frozen ones.
        """
        drawn = ProblemSet.sample(
            self.generator, self.seed, _PROBLEMS, movement=SUITE_MOVEMENT, problems=self.problems
        )
        if drawn.content_hash != self.content_hash:
            raise ValueError(
                f"{self.name}: got problems with the hash {drawn.content_hash}, expected "
                f"{self.content_hash}; figures on other problems cannot be compared, so take the "
                "version of mapdata that others used, and please report it"
            )
        return drawn


def _carry_over_1() -> tuple[Part, ...]:
    """Return the parts of "carry-over-1"."""
    hashes = {
        "dungeon-64": "80e34bfc2b1c66c0e4b29fe3490d724c1508f7cd9f2da23ec4608f4d298f5f80",
        "dungeon-128": "c99f7e5002845e09213776921c7a81986b8fa432eea526fad37fc89249ec418a",
        "maze-64": "97b2300be687ec04dc8147eaf505c695c5f2d23bdfce4e84d5794f8d1dc625ae",
        "maze-128": "f988d7e1edf262fcebdeb217ee5f72b3ac6dd59281599ade1927b0d79d84c24a",
        "cave-64": "3d6004e14fb5c0ede2bd3f1cabdbfc4a3d4c5c4929ae452ec3cebbb2ebea5d5a",
        "cave-128": "35f96296a3c94e43da7761f297bb347f94596eb6fe3156d33a42ad385c3430de",
        "forest-64": "3627e87e60c7c19d9b0fffa3331edb81cc26a1791b7c283fabf42e017237cd32",
        "forest-128": "20d0c20558cfcaf38017704a4c84bad9a1aa9058bd3f6b10cb862a6ae2321698",
        "noise-64": "a2b979487bf8f23af7f76a4695ffff6f5a04d1cf6937ff28c3bc29ac91f48984",
        "noise-128": "e69c6cc2e6ca4e305a1d83364bdae2658d7acf6a26476854d5463095fd2ba14a",
        "shelves-64": "104e9ae304d244c01be81530088426e46ca336f023945c36513f6872335ae732",
        "shelves-128": "acfe8cc182362ea1cc5532221827ad97e9a808cee453aee957d025ff05dee2f7",
        "bars-64": "6b238df1326188e12ecad95d09c3126d472e87f61c17cab1de53473d551bd9d2",
        "bars-128": "25104e8d9e8cb5a54cb5625fee57a398ed9fc8215e69243d9be140e6af54fa48",
        "traps-64": "1b2d21355a4fe795208cbfa963c47446d409728ea989ffd8d44f5734642f060d",
        "traps-128": "3c1504e26d01ff2f72db9cc7fa58f0644631b55d3988a14b2ee43677d5fa7aad",
        "floors-64": "ce57e45104042fda3a9aece3ae4f7343a312e30d7e055801d906b3e4ffd9f6a0",
        "floors-128": "f7d512f0f226b15b7bd701f3122907d344d0a3b23fb11007b506a6c0d68aa3f5",
        "rings-64": "7a8d77c059f6e6eceacfc7eb9af280e53e2f190bfcbac1f6159e15c0dbaf88de",
        "rings-128": "b710298478804460a48e2c93656cdc78026d0ba6ccfb37b43a93197e279766da",
        "terrain-64": "eb9d209ffef2abcb1694239f192427e344a2e8796b814464cf5a4b260104afbf",
        "terrain-128": "95940e60e20af5fcbe69dbb395a55eba1931433f0681064b0e66a9307ddce5cd",
    }
    families: list[tuple[str, Group, MapGenerator, MapGenerator]] = [
        ("dungeon", "in", PRESETS["dungeon"], PRESETS["dungeon128"])
    ]
    for preset in ("maze", "cave", "forest", "noise"):
        families.append((preset, "in", PRESETS[preset], _larger(PRESETS[preset])))
    for shape in SHAPES:
        held_out = HeldOut(shape=shape)
        families.append((shape, "out", held_out, _larger(held_out)))
    families.append(("terrain", "terrain", PRESETS["terrain"], _larger(PRESETS["terrain"])))
    parts = []
    for family, group, *generators in families:
        for generator in generators:
            name = f"{family}-{generator.map_size[0]}"
            problems = _LONG_PROBLEMS if group == "terrain" else _HARD_PROBLEMS
            seed = _seed_of("carry-over-1", name)
            parts.append(Part(name, group, generator, problems, seed, hashes[name]))
    return tuple(parts)


def _larger(generator: MapGenerator) -> MapGenerator:
    """Return the generator of maps of 128 x 128 cells."""
    return replace(generator, map_size=(128, 128))


def _seed_of(suite: str, part: str) -> int:
    """Return the seed of a part. It follows from the names, so that nobody chose it."""
    digest = hashlib.sha256(f"{suite} {part}".encode()).digest()
    return int.from_bytes(digest[:8], "big")


SUITES: Mapping[str, tuple[Part, ...]] = MappingProxyType({"carry-over-1": _carry_over_1()})
"""The parts of each suite, by its name."""
