"""The problems of each split of an export, opened from a dataset, a recipe or a problem set."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mapdata.arrays import Ints
from mapdata.checks import check_count
from mapdata.datasets.dataset import MapDataset
from mapdata.datasets.online import OnlineMapDataset
from mapdata.datasets.problem_dataset import ProblemDataset
from mapdata.datasets.problem_set_dataset import ProblemSetDataset
from mapdata.datasets.problem_statistics import map_digests
from mapdata.export.layouts import Columns
from mapdata.formats.registry import read_problems
from mapdata.generators.generator import PRESETS, MapGenerator
from mapdata.generators.recipe import Recipe, RecipeError, RecipeLike, as_recipe
from mapdata.generators.splits import maps_of_split
from mapdata.limits import SPLITS
from mapdata.movement import Movement
from mapdata.problems.problem_set import ProblemSet
from mapdata.problems.sources import Random, Source, plain_text
from mapdata.shards.locations import Locations
from mapdata.shards.root import Root

_BATCH_CELLS = 2**22
"""Cells of the maps of a batch. The fields of a batch take some 10 to 100 bytes a cell."""

_IMAGE_BATCH_CELLS = 2**18
"""Cells of the maps of a batch with pictures, which take some 200 bytes a cell."""

_MAX_BATCH = 4096

_MIN_BATCH = 64
"""Problems that are drawn at once to find some on distinct maps, however few are missing."""

_MAX_COUNT = 10**8
"""Problems of a split; the numbers of so many maps take 1.6 GB."""

_MAX_SPARE = 20
_MAX_SPARE_MAPS = 10**6
"""How many problems more than were asked for are drawn at most, to find some on distinct maps: 20
times as many, and a million."""


@dataclass(frozen=True)
class Options:
    """The arguments of an export that datasets take, by the same names."""

    fields: tuple[str, ...]
    problems: Source
    search: str
    movement: Movement | None
    radius: float
    augment: bool
    max_length: int | None
    sampling_seed: int

    def serving(self, split: str) -> dict[str, Any]:
        """Return the arguments of the dataset of a split, which also serves ``map_index``."""
        has_path = "path" in self.fields
        return {
            **vars(self),
            "fields": tuple(dict.fromkeys((*self.fields, "map_index"))),
            "augment": self.augment and split == "train",
            "max_length": self.max_length if has_path else None,
        }

    def plain(self, dataset: ProblemDataset) -> dict[str, Any]:
        """Return the arguments as plain values for JSON, as a dataset has checked them.

        The problems are None where they are those of a problem set.
        """
        is_set = isinstance(dataset, ProblemSetDataset)
        return {
            **vars(self),
            "problems": None if is_set else plain_text(self.problems),
            "movement": asdict(dataset.movement),
            "radius": dataset.serving.radius,
            "max_length": dataset.serving.max_length,
            "sampling_seed": dataset.serving.sampling_seed,
        }


@dataclass(frozen=True)
class Part:
    """The problems of one split, in the order in which they are written.

    Attributes:
        split: "train", "val" or "test".
        dataset: serves them.
        numbers: (N,) ascending; number i is problem ``i % len(dataset)`` of epoch ``i //
            len(dataset)``.
    """

    split: str
    dataset: ProblemDataset
    numbers: Ints

    @property
    def count(self) -> int:
        """The number of problems."""
        return len(self.numbers)

    def batches(self, max_batch: int) -> Iterator[Columns]:
        """Yield the fields of all problems, at most ``max_batch`` at a time."""
        rows, columns = self.dataset.map_size
        has_image = "image" in self.dataset.serving.fields
        batch_cells = _IMAGE_BATCH_CELLS if has_image else _BATCH_CELLS
        batch_size = min(max(batch_cells // (rows * columns), 1), max_batch)
        for numbers in _within_epochs(self.numbers, len(self.dataset), batch_size):
            batch = self.dataset.__getitems__(numbers).batch
            yield {name: getattr(batch, name).numpy() for name in batch._fields}


def _within_epochs(numbers: Ints, length: int, batch_size: int) -> Iterator[Ints]:
    """Yield ascending numbers of problems, a batch of one epoch at a time.

    Args:
        numbers: (N,).
        length: number of problems of an epoch.
        batch_size: how many numbers a batch has at most.
    """
    first = 0
    while first < len(numbers):
        next_epoch = (numbers[first] // length + 1) * length
        last = min(first + batch_size, int(np.searchsorted(numbers, next_epoch)))
        yield numbers[first:last]
        first = last


def problem_set_of(source: Any) -> ProblemSet | None:
    """Return the problem set that a source is, or that its file holds; None for other sources.

    Raises:
        ValueError: as `read_problems`.
    """
    if isinstance(source, ProblemSet):
        return source
    if isinstance(source, (str, os.PathLike)):
        path = Path(source)
        if path.suffix.lower() in (".npz", ".scen") and path.is_file():
            return read_problems(path)
    return None


def open_source(
    source: Any,
    options: Options,
    splits: tuple[str, ...],
    split: str | None,
    count: int | None,
    seed: int | None,
    follow_links: bool,
    distinct: bool,
) -> tuple[list[Part], dict[str, Any]]:
    """Open the datasets of the splits; return them and what the source is, as plain values.

    With ``distinct`` and ``count``, the parts have more problems than ``count`` if the source has,
    since some are left out.

    Splits without problems are left out, unless the caller asked for this one.
    """
    if count is not None:
        count = check_count("count", count)
        if count > _MAX_COUNT:
            raise ValueError(
                f"count: got {count}, expected at most {_MAX_COUNT} problems of a split"
            )
    if isinstance(source, ProblemSet):
        (split_of_set,) = splits
        parts = [_set_part(source, options, split_of_set, count, distinct)]
        origin: dict[str, Any] = {
            "problem_set": {
                "content_hash": source.content_hash,
                "description": source.description,
            }
        }
    elif _is_dataset(source):
        if seed is not None:
            raise ValueError("seed: a built dataset has its own, expected none")
        parts = [
            _stored_part(source, options, name, count, follow_links, distinct) for name in splits
        ]
        origin = _dataset_origin(source, follow_links)
    else:
        if follow_links:
            raise ValueError("follow_links: does nothing for a recipe, whose maps are in no file")
        recipe = _source_recipe(source, seed)
        shares = dict(zip(SPLITS, recipe.generator.splits, strict=True))
        asked = [name for name in splits if shares[name] > 0 or name == split]
        spare = min(_MAX_SPARE * count, _MAX_SPARE_MAPS) if distinct and count else 0
        parts = [_online_part(recipe, options, name, count, spare) for name in asked]
        origin = {"recipe": recipe.to_dict()}
    written = [part for part in parts if part.count > 0]
    if not written:
        empty = " and ".join(part.split for part in parts)
        raise ValueError(
            f"problems: {plain_text(options.problems)}: the source has none of them: no map of "
            f"{empty} gives one"
        )
    return written, origin


def _stored_part(
    source: Locations,
    options: Options,
    split: str,
    count: int | None,
    follow_links: bool,
    distinct: bool,
) -> Part:
    """Return the problems of a split of a built dataset."""
    dataset = MapDataset(source, split, follow_links=follow_links, **options.serving(split))
    if count is None or len(dataset) == 0:
        return Part(split, dataset, np.arange(len(dataset)))
    is_drawn_anew = isinstance(options.problems, Random) or dataset.serving.augment
    if count > len(dataset) and not is_drawn_anew:
        raise ValueError(
            f"count: got {count}, but the split {split!r} has {len(dataset)} problems; problems="
            '"random" draws as many as wanted'
        )
    return Part(split, dataset, np.arange(max(count, len(dataset)) if distinct else count))


def _set_part(
    problem_set: ProblemSet, options: Options, split: str, count: int | None, distinct: bool
) -> Part:
    """Return the problems of a problem set, or the first ``count`` of them.

    Raises:
        ValueError: it has fewer.
    """
    serving = options.serving(split)
    for name in ("problems", "movement", "radius"):  # those of the set
        del serving[name]
    dataset = ProblemSetDataset(problem_set, **serving)
    if count is not None and count > len(dataset) and not dataset.serving.augment:
        raise ValueError(f"count: got {count}, but the problem set has {len(dataset)} problems")
    if count is None or (distinct and count < len(dataset)):
        count = len(dataset)
    return Part(split, dataset, np.arange(count))


def _online_part(
    recipe: Recipe, options: Options, split: str, count: int | None, spare: int
) -> Part:
    """Return the problems of a split of maps that are made on the fly, and some to spare."""
    if count is None:
        indices = maps_of_split(recipe.generator, recipe.seed, split, recipe.maps)
        count = int((indices < recipe.maps).sum()) * options.problems.per_map
        if count == 0:
            raise ValueError(f"split: none of the {recipe.maps} maps of the recipe is in {split!r}")
    length = count + spare
    dataset = OnlineMapDataset(
        recipe.generator, recipe.seed, length, split, **options.serving(split)
    )
    return Part(split, dataset, np.arange(length))


def _is_dataset(source: Locations | RecipeLike) -> bool:
    """Return whether a source is a built dataset, and not a recipe."""
    if isinstance(source, (MapGenerator, Recipe, Mapping)):
        return False
    if not isinstance(source, (str, os.PathLike)):
        return True  # a list of folders
    name = os.fspath(source)
    return name not in PRESETS and ("://" in name or Path(name).is_dir())


def _source_recipe(source: RecipeLike, seed: int | None) -> Recipe:
    """Return the recipe that a source stands for.

    Raises:
        ValueError: it is neither a dataset nor a recipe.
    """
    if isinstance(source, str) and not source.lstrip().startswith("{"):
        path = Path(source)
        if path.suffix and not path.exists():
            raise ValueError(f"{source}: no such file or folder")
    try:
        return as_recipe(source, seed=seed)
    except RecipeError as error:
        raise ValueError(f"{error}; or the folder or URL of a built dataset") from None


def _dataset_origin(source: Locations, follow_links: bool) -> dict[str, Any]:
    """Return what a dataset is, as plain values."""
    root = Root.open(source, follow_links=follow_links)
    return {
        "datasets": [
            {
                "content_hash": manifest.content_hash,
                "identity": manifest.identity,
                "recipe": None if manifest.generator is None else json.loads(manifest.recipe()),
            }
            for manifest in root.manifests
        ]
    }


def without_copies(parts: Sequence[Part], count: int | None) -> list[Part]:
    """Return the parts without the problems on copies of earlier maps.

    Args:
        parts: the splits.
        count: how many problems a split shall have; None for all that are left.

    Raises:
        ValueError: a split has fewer on maps that differ.
    """
    owners: dict[bytes, int] = {}
    distinct_parts = []
    for part in parts:
        wanted = part.count if count is None else count
        kept = np.empty(0, np.int64)
        tried = 0
        while len(kept) < wanted and tried < part.count:
            # Few more problems are drawn than are wanted, since rare ones take long to draw.
            batch_size = min(max(wanted - len(kept), _MIN_BATCH), _MAX_BATCH)
            numbers = next(_within_epochs(part.numbers[tried:], len(part.dataset), batch_size))
            found = _on_first_maps(part.dataset, numbers, owners, wanted - len(kept))
            kept = np.concatenate((kept, found))
            tried += len(numbers)
        if count is not None and len(kept) < count:
            raise ValueError(
                f"distinct: {part.split} has only {len(kept):,} problems on maps that differ, "
                f"turned and reflected ones too, among {part.count:,} problems; expected a count "
                f"of at most {len(kept):,}, or larger maps"
            )
        distinct_parts.append(replace(part, numbers=kept))
    return [part for part in distinct_parts if part.count > 0]


def _on_first_maps(
    dataset: ProblemDataset, numbers: Ints, owners: dict[bytes, int], wanted: int
) -> Ints:
    """Return the first ``wanted`` problems on maps that no earlier map equals.

    Args:
        dataset: the dataset of the problems.
        numbers: (N,) numbers of problems of one epoch.
        owners: the number of the first map with each hash; the maps of the problems that are
            returned are added, and no others, which would make later maps copies.
        wanted: how many problems are returned at most.
    """
    epoch = int(numbers[0]) // len(dataset)
    batch = dataset.batch_of(numbers % len(dataset), epoch)
    _, digests = map_digests(batch)
    map_indices = batch.compute_map_indices().tolist()
    found: list[int] = []
    for number, digest, index in zip(numbers.tolist(), digests, map_indices, strict=True):
        if len(found) == wanted:
            break
        if owners.setdefault(digest, index) == index:
            found.append(number)
    return np.array(found, np.int64)
