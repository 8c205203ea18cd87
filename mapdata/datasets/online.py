"""`OnlineMapDataset`: maps that are generated and solved on the fly, without a disk."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from mapdata.arrays import Bytes
from mapdata.checks import check_count
from mapdata.datasets.arguments import (
    DEFAULT_FIELDS,
    FieldFunction,
    MovementLike,
    Serving,
    Transform,
    as_movement,
)
from mapdata.datasets.batch_sources import DrawnSource
from mapdata.datasets.info import DatasetInfo, field_infos
from mapdata.datasets.map_sources import GeneratedMapSource
from mapdata.datasets.problem_dataset import ProblemDataset
from mapdata.generators.generator import identity
from mapdata.generators.recipe import (
    Recipe,
    RecipeLike,
    as_recipe,
    check_reproducible,
)
from mapdata.generators.splits import draw_splits, split_thresholds
from mapdata.limits import SPLITS
from mapdata.problems.sources import SourceLike, problem_source

MAX_LENGTH = 10**12
"""Problems of a dataset, so that 64 bits hold the numbers of all maps that may replace theirs."""


class OnlineMapDataset(ProblemDataset):
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
        self._open()
        self._check_on_maps()

    def _open(self) -> None:
        serving = self.serving
        maps = GeneratedMapSource(
            self.generator, self.seed, self.split, self._map_count, self.length, serving.radius
        )
        movement = serving.movement or self.generator.movement
        # A map of two rooms has one segment and one pair, which each epoch serves.
        draws_anew = not serving.problems.is_stored or self.generator.max_seed_points > 2
        self.source = DrawnSource(maps, serving, movement, self.length, draws_anew=draws_anew)

    def __repr__(self) -> str:
        return (
            f"OnlineMapDataset({self.generator}, seed={self.seed}, split={self.split!r}, "
            f"problems={self.serving.problems}): {self.length} problems{self._epoch_note()}"
        )

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

    @property
    def _map_count(self) -> int:
        """The number of maps that samples are first sought on."""
        return -(-self.length // self.serving.problems.per_map)  # rounded up


def _split_counts(codes: Bytes) -> dict[str, int]:
    """Return how many of the splits (N,) are train, val and test."""
    counts = np.bincount(codes, minlength=len(SPLITS)).tolist()
    return dict(zip(SPLITS, counts, strict=True))
