"""Sources of maps to draw problems on: the shards of a dataset, or a recipe.

Several numbers count problems and maps, here and in the modules around this one:

- index: of a problem as the dataset serves it, such as 5 in ``dataset[5]``;
- key: what the draws of a problem depend on; its index, or a number beyond all of them for a
  substitute;
- position: of a map among those of the served split, from 0 on. Where problems are stored, it is
  the number of a problem on the map;
- map number: of a map in its own dataset or recipe, over all splits; errors name it;
- map index: the same, counted on over several roots; the field ``map_index``;
- row: which problem of one batch, in its arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from mapdata.arrays import Ints
from mapdata.datasets.batches import BatchReader
from mapdata.datasets.fields import Rooms
from mapdata.generators.generator import MapGenerator, identity
from mapdata.generators.maps import Maps
from mapdata.generators.recipe import generate
from mapdata.generators.splits import SplitMaps, maps_of_split
from mapdata.limits import Size
from mapdata.movement import Movement
from mapdata.problems.drawing import GivenMaps
from mapdata.problems.substitutes import draw_substitutes
from mapdata.search.footprint import min_squared_clearance
from mapdata.search.labels import labels_serve


class MapSource(Protocol):
    """The maps of a split, each of which has a position in it, counted from 0.

    Attributes:
        map_size: (rows, columns) of all maps.
        has_terrain: whether free cells cost different amounts.
        radius_cells: radius of the robot, in cells.
        min_clearance: clearance of the cells that are free for the robot, as from
            `min_squared_clearance`.
        map_hashes: what identifies the maps.
    """

    map_size: Size
    has_terrain: bool
    radius_cells: float
    min_clearance: int
    map_hashes: Sequence[str]

    def given_maps(self, positions: Ints, *, with_seed_points: bool) -> GivenMaps:
        """Return the maps at these positions, (B,), before inflation, to draw problems on."""

    def map_indices(self, positions: Ints) -> Ints:
        """Return the number in the whole dataset of the map at each position, (B,)."""

    def seed_points(self, positions: Ints) -> Ints:
        """Return the seed points of the maps at these positions, (B, R, 2), padded with -1."""

    def stored_rooms(self, positions: Ints, search: str) -> Rooms | None:
        """Return the rooms as they are stored; None if they have to be solved as served."""

    def substitutes(self, indices: Ints, epoch: int, numbers: Ints) -> Ints:
        """Return the positions of maps that replace those without a problem, (B,).

        docs/format.md, section 6, has the rule.

        Args:
            indices: (B,) numbers of the problems.
            epoch: pass over the data.
            numbers: (B,) which substitute of the problem it is, from 1 on.
        """

    def tried_text(self, tries: int) -> str:
        """Return on how many maps a problem was sought, in words."""


class StoredMapSource:
    """The maps of the shards of a dataset, as a `MapSource`.

    Attributes:
        reader: reads them.
        labels_serve: whether paths and rooms are served as they are stored.
    """

    def __init__(
        self, reader: BatchReader, movement: Movement, radius: float, sampling_seed: int
    ) -> None:
        """Keep the arguments.

        Args:
            reader: reads the maps.
            movement: the served one.
            radius: of the robot, in metres.
            sampling_seed: of substitutes.
        """
        self.reader = reader
        self.map_size = reader.map_size
        self.has_terrain = reader.has_terrain
        self.min_clearance = reader.min_clearance
        self.map_hashes: Sequence[str] = [manifest.content_hash for manifest in reader.manifests]
        self.radius_cells = radius / reader.root.resolution if radius else 0.0
        # Labels are stored for one movement and for a robot without extent.
        self.labels_serve = labels_serve(reader.movement, movement, reader.min_clearance)
        self._sampling_seed = sampling_seed

    def given_maps(self, positions: Ints, *, with_seed_points: bool) -> GivenMaps:
        """Return maps as `MapSource.given_maps`."""
        stored = self.reader.locate(positions)
        numbers = self.reader.map_numbers(stored)
        maps = self.reader.stored_maps(stored, self.reader.grids(stored))
        if not with_seed_points:
            return GivenMaps(numbers, maps, None, None)
        points = self.seed_points(positions)
        return GivenMaps(numbers, maps, points, np.count_nonzero(points[:, :, 0] >= 0, axis=1))

    def map_indices(self, positions: Ints) -> Ints:
        """Return numbers of maps, counted over all roots."""
        return self.reader.map_indices(self.reader.locate(positions))

    def seed_points(self, positions: Ints) -> Ints:
        """Return seed points as `MapSource.seed_points`."""
        return self.reader.rooms(self.reader.locate(positions), "astar").seed_points

    def stored_rooms(self, positions: Ints, search: str) -> Rooms | None:
        """Return the rooms as their shards hold them, if the labels are served as stored."""
        return (
            self.reader.rooms(self.reader.locate(positions), search) if self.labels_serve else None
        )

    def substitutes(self, indices: Ints, epoch: int, numbers: Ints) -> Ints:
        """Draw each map from the whole split, so that no map replaces more others than the rest."""
        seed = np.uint64(self._sampling_seed)
        return draw_substitutes(seed, indices, epoch, numbers, len(self.reader))

    def tried_text(self, tries: int) -> str:
        """Return on how many maps a problem was sought; a small split is tried several times."""
        map_count = len(self.reader)
        if tries <= map_count:
            return f"{tries:,} maps were tried"
        return f"{tries:,} tries were made on the maps of the split, {map_count:,} in number,"


class GeneratedMapSource:
    """The maps of a recipe, as a `MapSource`, made anew whenever they are used."""

    def __init__(
        self,
        generator: MapGenerator,
        seed: int,
        split: str | None,
        map_count: int,
        problem_count: int,
        radius: float,
    ) -> None:
        """Find the maps of the split; none is made yet.

        Args:
            generator: draws the maps.
            seed: of the maps.
            split: whose maps these are; None for all.
            map_count: how many of them problems are first sought on.
            problem_count: of how many problems they are, each of which has its own substitutes.
            radius: of the robot, in metres.
        """
        self.map_size = generator.map_size
        self.has_terrain = generator.has_terrain
        self.map_hashes: Sequence[str] = [identity(generator, seed)]
        self.radius_cells = radius / generator.resolution
        self.min_clearance = min_squared_clearance(radius, generator.resolution)
        self._generator = generator
        self._seed = seed
        self._map_count = map_count
        self._problem_count = problem_count
        # The numbers of the split's maps in the recipe: the first ones, and all of them, for the
        # substitutes. None if the split has all maps of the recipe.
        self._first_maps: Ints | None = None
        self._split_maps: SplitMaps | None = None
        if split is not None:
            self._first_maps = maps_of_split(generator, seed, split, map_count)
            self._split_maps = SplitMaps(generator, seed, split)

    def given_maps(self, positions: Ints, *, with_seed_points: bool) -> GivenMaps:
        """Return maps as `MapSource.given_maps`, always with their seed points."""
        del with_seed_points
        return GivenMaps.of(self._maps(positions))

    def _maps(self, positions: Ints) -> Maps:
        """Make the maps at these positions."""
        return generate(self._generator, self._seed, self.map_indices(positions))

    def map_indices(self, positions: Ints) -> Ints:
        """Return the numbers of maps in their recipe."""
        if self._first_maps is None or self._split_maps is None:
            return positions
        if (positions < len(self._first_maps)).all():
            return self._first_maps[positions]
        return self._split_maps.at(positions)

    def seed_points(self, positions: Ints) -> Ints:
        """Return seed points as `MapSource.seed_points`."""
        return self._maps(positions).seed_points

    def stored_rooms(self, positions: Ints, search: str) -> Rooms | None:
        """Return None: nothing is stored."""
        del positions, search
        return None

    def substitutes(self, indices: Ints, epoch: int, numbers: Ints) -> Ints:
        """Return maps behind the first ones, each of which replaces a map of one problem.

        With one problem per map, substitute u of problem i is map i + u * L of L problems.
        """
        del epoch  # The substitutes of a problem are the same in all epochs.
        return self._map_count + (numbers - 1) * self._problem_count + indices

    def tried_text(self, tries: int) -> str:
        """Return on how many maps a problem was sought."""
        return f"{tries:,} maps were tried"
