"""`OnlineMapDataset`: maps made and solved as they are asked for, without a disk."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from mapdata.arrays import Bytes, Ints
from mapdata.checks import check_count
from mapdata.datasets.arguments import DEFAULT_FIELDS, FieldFunction, Serving
from mapdata.datasets.dataset import ProblemDataset, Sampled, Transform, arguments_of
from mapdata.datasets.fields import Paths
from mapdata.generators.maps import Maps
from mapdata.generators.recipe import RecipeLike, as_recipe, generate
from mapdata.generators.splits import maps_of_split
from mapdata.movement import Movement
from mapdata.problems.sampling import solve_pairs
from mapdata.problems.sources import Random, Route, SourceLike, problem_source
from mapdata.search.api import SEARCHES
from mapdata.search.footprint import inflate_all, min_squared_clearance
from mapdata.search.lattice import move_rule


class OnlineMapDataset(ProblemDataset):
    """Maps made and solved as they are asked for: one problem a map, nothing on disk.

    They are the maps that shards would hold.

    Sample i is of the i-th map of the recipe, or of the i-th one that belongs to ``split``. Route
    and pairs problems are one segment or pair of the map, drawn anew each epoch. A map without any
    problem of the kind is replaced by one from beyond ``length``.

    Args:
        recipe: which maps: a preset's name, a recipe file, its JSON text or mapping, a
            `MapGenerator` or a `Recipe`.
        seed: 64-bit seed of the maps; the recipe's by default, 0 for a preset or generator.
        length: number of problems; the recipe's number of maps by default, 10,000 for a preset or
            generator.
        split: as in `MapDataset`, like all further arguments.

    Raises:
        ValueError: arguments that do not fit, or that would do nothing.
    """

    def __init__(
        self,
        recipe: RecipeLike,
        seed: int | None = None,
        length: int | None = None,
        split: str | None = None,
        fields: Sequence[str | FieldFunction] = DEFAULT_FIELDS,
        *,
        problems: SourceLike = "route",
        search: str = "astar",
        movement: Movement | None = None,
        augment: bool = False,
        sampling_seed: int = 0,
        max_length: int | None = None,
        dtype: torch.dtype | str | None = None,
        transform: Transform | None = None,
        radius: float = 0.0,
    ) -> None:
        """Check the arguments; no map is made yet."""
        source = problem_source(problems)
        serving = Serving(
            fields, source, search, movement, augment, sampling_seed, max_length, radius
        )
        super().__init__(split, serving, dtype, transform)
        recipe = as_recipe(recipe, seed=seed)
        self.spec = recipe.spec
        self.seed = recipe.seed
        self.length = recipe.maps if length is None else check_count("length", length)
        self.movement = movement or self.spec.movement
        self.map_size = self.spec.map_size
        self._least = min_squared_clearance(radius, self.spec.resolution)
        self._numbers = (
            None if split is None else maps_of_split(self.spec, self.seed, split, 2 * self.length)
        )

    def __len__(self) -> int:
        """Return the number of problems."""
        return self.length

    def __setstate__(self, state: dict[str, Any]) -> None:
        OnlineMapDataset.__init__(self, **arguments_of(state, "spec", "seed", "length"))
        vars(self).update(state)

    def __repr__(self) -> str:
        return (
            f"OnlineMapDataset({self.spec}, seed={self.seed}, split={self.split!r}, "
            f"problems={self.serving.problems}): {self.length} problems"
        )

    def _maps(self, places: Ints) -> Maps:
        numbers = places if self._numbers is None else self._numbers[places]
        return generate(self.spec, self.seed, numbers)

    def _grids(self, places: Ints) -> Bytes:
        return self._inflated(self._maps(places))

    def _inflated(self, maps: Maps) -> Bytes:
        grids = maps.occupancy
        if self._least > 1:  # else nothing changes, and the kernel need not be compiled
            inflate_all(grids, self._least)
        return grids

    def _seed_points(self, places: Ints) -> Ints:
        return self._maps(places).seed_points

    def _substitutes(self, indices: Ints, attempt: int) -> Ints:
        return self.length + (indices + attempt - 1) % self.length

    def _sample(self, places: Ints, indices: Ints, epoch: int, attempt: int) -> Sampled:
        problems = self.serving.problems
        if isinstance(problems, Random):
            return super()._sample(places, indices, epoch, attempt)
        maps = self._maps(places)
        grids = self._inflated(maps)
        ends, *found = solve_pairs(
            grids,
            maps.seed_points,
            maps.rooms,
            np.uint64(self.serving.sampling_seed),
            epoch,
            indices,
            isinstance(problems, Route),
            problems.unsolvable,
            SEARCHES[self.serving.search],
            move_rule(self.movement),
        )
        return grids, ends, Paths(*found)
