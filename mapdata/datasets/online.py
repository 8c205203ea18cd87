"""`OnlineMapDataset`: maps that are generated and solved on the fly, without a disk."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from mapdata.arrays import Bytes, Ints
from mapdata.checks import check_count
from mapdata.datasets.arguments import (
    DEFAULT_FIELDS,
    FieldFunction,
    MovementLike,
    Serving,
    Transform,
    as_movement,
)
from mapdata.datasets.dataset import SampledProblemDataset, SampledProblems
from mapdata.datasets.fields import Paths, StoredMaps
from mapdata.datasets.info import DatasetInfo, field_infos
from mapdata.generators.generator import identity
from mapdata.generators.maps import Maps
from mapdata.generators.recipe import (
    Recipe,
    RecipeLike,
    as_recipe,
    check_reproducible,
    generate,
)
from mapdata.generators.splits import SplitMaps, draw_splits, maps_of_split, split_thresholds
from mapdata.limits import SPLITS
from mapdata.problems.sampling import solve_pairs
from mapdata.problems.sources import Random, Route, SourceLike, problem_source
from mapdata.search.api import SEARCHES, check_cost
from mapdata.search.footprint import min_squared_clearance
from mapdata.search.lattice import move_rule
from mapdata.search.map_stack import MapStack

MAX_LENGTH = 10**12
"""Problems of a dataset, so that 64 bits hold the numbers of all maps that may replace theirs."""


class OnlineMapDataset(SampledProblemDataset):
    """Maps that are generated and solved on the fly: one problem a map, without a disk.

    The maps are those that shards of the same spec and seed hold.

    Sample i is of the i-th map of the recipe, or of the i-th one that belongs to ``split``. Route
    and pairs problems are one segment or pair of the map, drawn anew each epoch. With
    ``Random(per_map=k)`` sample i is of map ``i // k``. A map without any such problem is replaced
    by one of the maps that follow those of the samples, and by another one for each sample.

    Args:
        recipe: which maps: a preset's name, a recipe file, its JSON text or mapping, a
            `MapGenerator` or a `Recipe`.
        seed: 64-bit seed of the maps; the recipe's by default, 0 for a preset or generator.
        length: number of problems; the recipe's number of maps by default, 10,000 for a preset or
            generator, times the number of problems per map.
        split: as in `MapDataset`, like all further arguments.

    Raises:
        ValueError: arguments that do not fit, or that would do nothing; the family of a user does
            not draw the same map twice.
    """

    _opened = ("_first_maps", "_split_maps")

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
        movement: MovementLike | None = None,
        augment: bool = False,
        sampling_seed: int = 0,
        max_length: int | None = None,
        dtype: torch.dtype | str | None = None,
        transform: Transform | None = None,
        radius: float = 0.0,
    ) -> None:
        """Check the arguments; no map is made yet, except to check a family of the user's own."""
        serving = Serving(
            fields=fields,
            problems=problem_source(problems),
            search=search,
            movement=as_movement(movement),
            augment=augment,
            sampling_seed=sampling_seed,
            max_length=max_length,
            dtype=dtype,
            transform=transform,
            radius=radius,
        )
        recipe = as_recipe(recipe, seed=seed)
        check_reproducible(recipe)
        self.generator = recipe.generator
        super().__init__(split, serving)
        self.seed = recipe.seed
        default_length = recipe.maps * serving.problems.per_map
        self.length = default_length if length is None else check_count("length", length)
        if self.length > MAX_LENGTH:
            raise ValueError(
                f"length: got {self.length:,} problems, expected at most {MAX_LENGTH:,}"
            )
        self.movement = serving.movement or self.generator.movement
        self.map_size = self.generator.map_size
        self.has_terrain = self.generator.has_terrain
        self._min_clearance = min_squared_clearance(radius, self.generator.resolution)
        self._check_on_maps()
        self._open()

    def _open(self) -> None:
        # The numbers of the split's maps in the recipe: those of the samples, and all of them, for
        # the substitutes. None if the split has all maps of the recipe.
        self._first_maps = None
        self._split_maps = None
        if self.split is not None:
            count = self._map_count
            self._first_maps = maps_of_split(self.generator, self.seed, self.split, count)
            self._split_maps = SplitMaps(self.generator, self.seed, self.split)

    def __len__(self) -> int:
        """Return the number of problems."""
        return self.length

    def __repr__(self) -> str:
        return (
            f"OnlineMapDataset({self.generator}, seed={self.seed}, split={self.split!r}, "
            f"problems={self.serving.problems}): {self.length} problems{self._epoch_note()}"
        )

    @property
    def _drawn_anew(self) -> str:
        """What is drawn anew each epoch: "problems", "symmetries", "light" or "" for nothing."""
        # A map of two rooms has one segment and one pair, which each epoch serves.
        return "problems" if self.generator.max_seed_points > 2 else super()._drawn_anew

    @property
    def info(self) -> DatasetInfo:
        """Where the maps come from, their counts, and what a sample holds.

        The maps are those that samples are first sought on, although a map without a problem is
        replaced by another map. The shapes of the fields are those of the first sample, which is
        made for it.
        """
        if self.split is not None:
            map_counts = {self.split: self._map_count}
            problem_counts = {self.split: self.length}
        else:
            thresholds = split_thresholds(self.generator.splits)
            codes = draw_splits(np.uint64(self.seed), np.arange(self._map_count), thresholds)
            codes_of_problems = np.repeat(codes, self.serving.problems.per_map)[: self.length]
            map_counts = _split_counts(codes)
            problem_counts = _split_counts(codes_of_problems)
        return DatasetInfo(
            roots=(),
            recipes=(Recipe(self.generator, self.seed, self._map_count),),
            identities=(identity(self.generator, self.seed),),
            content_hashes=(None,),
            map_counts=map_counts,
            problem_counts=problem_counts,
            map_size=self.map_size,
            resolution=self.generator.resolution,
            movement=self.movement,
            has_terrain=self.has_terrain,
            fields=field_infos(self._load(np.array([0]), 0)),
        )

    def _map_hashes(self) -> Sequence[str]:
        return [identity(self.generator, self.seed)]

    @property
    def _map_count(self) -> int:
        """The number of maps that samples are first sought on."""
        return -(-self.length // self.serving.problems.per_map)  # rounded up

    def _maps(self, map_numbers: Ints) -> Maps:
        """Return maps by their numbers in the split."""
        return generate(self.generator, self.seed, self._map_indices(map_numbers))

    def _map_indices(self, map_numbers: Ints) -> Ints:
        if self._first_maps is None or self._split_maps is None:
            return map_numbers
        is_own = map_numbers < len(self._first_maps)
        if is_own.all():
            return self._first_maps[map_numbers]
        return self._split_maps.at(map_numbers)

    def _own_maps(self, problems: Ints) -> Ints:
        return self._map_indices(problems // self.serving.problems.per_map)

    def _stored_maps(self, map_numbers: Ints) -> StoredMaps:
        return _as_stored_maps(self._maps(map_numbers))

    def _radius_in_cells(self) -> float:
        return self.serving.radius / self.generator.resolution

    def _seed_points(self, map_numbers: Ints) -> Ints:
        return self._maps(map_numbers).seed_points

    def _substitutes(self, indices: Ints, epoch: int, numbers: Ints) -> Ints:
        """Return maps behind those of the samples, each of which replaces a map of one sample.

        With one problem per map, substitute u of sample i is map i + u * length.
        """
        del epoch  # The substitutes of a sample are the same in all epochs.
        return self._map_count + (numbers - 1) * self.length + indices

    def _sample(self, map_numbers: Ints, keys: Ints, epoch: int) -> SampledProblems:
        problems = self.serving.problems
        if isinstance(problems, Random):
            return super()._sample(map_numbers, keys, epoch)
        maps = self._maps(map_numbers)
        stored_maps = _as_stored_maps(maps)
        served = stored_maps.maps.inflated(self._min_clearance)
        rule = move_rule(self.movement)
        arguments = (
            maps.seed_points,
            maps.rooms,
            np.uint64(self.serving.sampling_seed),
            epoch,
            keys,
            isinstance(problems, Route),
            problems.unsolvable,
        )
        # BFS counts moves, on terrain, too.
        searched = served if self.serving.search == "astar" else MapStack(served.grids, None)
        search = SEARCHES[self.serving.search]
        ends, solved = solve_pairs(searched, *arguments, search, rule)
        check_cost(stored_maps.numbers, solved.done, solved.high_cost)
        paths = Paths(solved.cells, solved.offsets, solved.expansions)
        return SampledProblems(stored_maps, served.grids, ends, paths)


def _as_stored_maps(maps: Maps) -> StoredMaps:
    """Return generated maps as those of a batch, before inflation."""
    return StoredMaps(maps.index, MapStack(maps.occupancy, maps.terrain))


def _split_counts(codes: Bytes) -> dict[str, int]:
    """Return how many of the splits (N,) are train, val and test."""
    counts = np.bincount(codes, minlength=len(SPLITS)).tolist()
    return dict(zip(SPLITS, counts, strict=True))
