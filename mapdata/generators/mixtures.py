"""Mixtures: maps of several families in one dataset, so that a network learns from all of them.

Map i is map i of one of the parts under the same seed, in the same split. Stream 10 of
docs/format.md draws the part.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import accumulate
from typing import Any, ClassVar

import numpy as np

from mapdata.arrays import Ints, Words
from mapdata.checks import check_seed, check_shares_if_any, items_of
from mapdata.generators import caves, forests, mazes, rooms
from mapdata.generators.generator import SHARED_PARAMETERS, MapGenerator
from mapdata.generators.maps import Maps
from mapdata.jit import kernel
from mapdata.rng import MIXTURE, block, threshold


def _check_parts(name: str, values: Any) -> tuple[MapGenerator, ...]:
    """Return ``values`` as the parts of a mixture.

    Raises:
        ValueError: fewer than two, no generators, generators that have terrain or are mixtures
            themselves, or that differ in what all families have.
    """
    parts: tuple[MapGenerator, ...] = tuple(items_of(values))
    if len(parts) < 2:
        raise ValueError(f"{name}: got {values!r}, expected at least two generators")
    for part in parts:
        if not isinstance(part, MapGenerator):
            raise ValueError(f"{name}: got {part!r}, expected a MapGenerator, such as Cave()")
        if part.has_terrain:
            raise ValueError(
                f"{name}: got {part!r}, expected generators without terrain; Terrain(over=Mixture("
                "...)) gives costs to the maps of a mixture"
            )
        if isinstance(part, Mixture):
            raise ValueError(f"{name}: got a mixture in a mixture, expected its parts instead")
        for shared in SHARED_PARAMETERS:
            value, first = getattr(part, shared), getattr(parts[0], shared)
            if value != first:
                raise ValueError(
                    f"{name}: got the {shared} {first!r} and {value!r}, expected the same in all"
                )
    return parts


@dataclass(frozen=True)
class Mixture(MapGenerator):
    """Maps of several families, of one size: each map is drawn by one of the parts.

    Attributes:
        map_size: (rows, columns) of a map; that of the parts.
        parts: at least two generators without terrain. They decide on map size, resolution,
            movement and splits, in which they agree, so that these parameters have to be left out
            here.
        shares: the probability of each part; () for equal ones. They add up to 1.

    Raises:
        ValueError: parts or shares other than these, or a parameter that the parts decide on.
    """

    name: ClassVar[str] = "mixture"
    generator_parameters: ClassVar[tuple[str, ...]] = ("parts",)
    parts: tuple[MapGenerator, ...] = ()
    shares: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        """Check the values."""
        super().__post_init__()
        self._convert(_check_parts, "parts")
        self._convert(partial(check_shares_if_any, count=len(self.parts)), "shares")
        self._take_shared_parameters("parts", self.parts[0])

    @property
    def description(self) -> str:  # type: ignore[override]  # depends on ``parts``
        """What the maps are, as the dataset card says it."""
        descriptions = dict.fromkeys(part.description for part in self.parts)
        return "a mixture of maps of several families: " + "; ".join(descriptions)

    @property
    def max_seed_points(self) -> int:
        """The largest number of seed points of a map."""
        return max(part.max_seed_points for part in self.parts)

    def part_numbers(self, seed: int, indices: Ints) -> Ints:
        """Return which of the parts draws each map, (N,) int64 from 0.

        Args:
            seed: 64-bit seed of the maps.
            indices: (N,) int64, numbers of the maps.
        """
        shares = self.shares or (1 / len(self.parts),) * len(self.parts)
        # The last part takes all words that are left, although the sum of the shares may differ
        # from 1 slightly.
        limits = [threshold(total) for total in accumulate(shares[:-1])]
        return _draw_parts(np.uint64(check_seed(seed)), indices, np.array(limits, np.uint64))

    def draw(self, seed: int, indices: Ints) -> Maps:
        """Return the maps ``indices``, (N,) int64."""
        maps = Maps.empty(self.movement, self.map_size, indices, self.max_seed_points)
        part_numbers = self.part_numbers(seed, indices)
        for number, part in enumerate(self.parts):
            rows = np.flatnonzero(part_numbers == number)
            if len(rows) > 0:
                _put(maps, rows, part.draw(seed, indices[rows]))
        return maps


PRESETS = {
    "mixed": Mixture(
        parts=(
            rooms.PRESETS["dungeon"],
            mazes.PRESETS["maze"],
            caves.PRESETS["cave"],
            forests.PRESETS["forest"],
            forests.PRESETS["noise"],
        )
    ),
}


def _put(maps: Maps, rows: Ints, drawn: Maps) -> None:
    """Put the maps of a part, which may have fewer rooms, into the rows of a mixture."""
    for name in ("packed", "rooms", "passage_width", "split"):
        getattr(maps, name)[rows] = getattr(drawn, name)
    for name in ("seed_points", "sizes", "directions"):
        of_rooms = getattr(drawn, name)
        getattr(maps, name)[rows, : of_rooms.shape[1]] = of_rooms


@kernel
def _draw_parts(seed: np.uint64, indices: Ints, limits: Words) -> Ints:
    """Return the number of the part of each map, (N,).

    Args:
        seed: 64-bit seed.
        indices: (N,), numbers of the maps.
        limits: (P - 1,), the share of the first part, of the first two parts and so on, times
            2**32.
    """
    numbers = np.zeros(len(indices), np.int64)
    for k in range(len(indices)):
        word, _, _, _ = block(seed, np.uint64(indices[k]), 0, MIXTURE, 0)
        for limit in limits:
            numbers[k] += word >= limit
    return numbers
