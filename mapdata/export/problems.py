"""`export_problems`: the problems of a dataset or a recipe, as files that training code reads."""

from __future__ import annotations

import json
import os
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from torch.utils.data import Dataset

from mapdata._version import __version__
from mapdata.arrays import Array, Ints
from mapdata.checks import check_choice, check_count, check_flag, did_you_mean
from mapdata.datasets.dataset import MapDataset
from mapdata.datasets.fields import FIELDS
from mapdata.datasets.online import OnlineMapDataset
from mapdata.datasets.problem_dataset import ProblemDataset
from mapdata.datasets.problem_set_dataset import ProblemSetDataset
from mapdata.datasets.problem_statistics import map_digests, measure
from mapdata.describe.dataset_card import counted
from mapdata.describe.problem_statistics import ProblemStatistics
from mapdata.describe.statistics import count_repeats, hash_grids
from mapdata.export.about import CARD, write_about
from mapdata.export.card import problem_card
from mapdata.export.layouts import Columns
from mapdata.export.problem_formats import FORMATS, ProblemFormat, WriterTarget
from mapdata.export.writers import Writer
from mapdata.formats.registry import read_problems
from mapdata.generators.generator import PRESETS, MapGenerator
from mapdata.generators.recipe import Recipe, RecipeLike, as_recipe
from mapdata.generators.splits import maps_of_split
from mapdata.hashing import json_hash
from mapdata.limits import PROBLEM_FORMATS, SPLITS
from mapdata.movement import Movement
from mapdata.problems.problem_set import ProblemSet
from mapdata.problems.sources import Random, Source, SourceLike, plain_text, problem_source
from mapdata.shards.files import StrPath, new_output
from mapdata.shards.locations import Locations, local_path
from mapdata.shards.manifest import MANIFEST
from mapdata.shards.root import Root
from mapdata.shards.workers import bar

DEFAULT_FIELDS = ("map", "start", "goal", "path", "cost")
"""The fields that are written unless the caller names others."""

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

_FEW_MAPS = 0.9
"""There is a note if random problems are on less than this share of the maps that they could use.
"""

_FEW_SINGLE_PATHS = 0.9
"""There is a note if less than this share of problems has one shortest path."""


def export_problems(
    source: Locations | RecipeLike | ProblemSet,
    target: StrPath,
    *,
    format: str = "arrays",  # noqa: A002  (the word of pandas, Pillow and the command line)
    fields: Sequence[str] | None = None,
    split: str | None = None,
    count: int | None = None,
    problems: SourceLike | None = None,
    search: str = "astar",
    movement: Movement | None = None,
    radius: float = 0.0,
    augment: bool = False,
    max_length: int | None = None,
    seed: int | None = None,
    sampling_seed: int = 0,
    distinct: bool = False,
    licence: str | None = None,
    follow_links: bool = False,
    progress: bool = False,
) -> list[str]:
    """Write training problems to a new folder: the fields that a dataset would serve.

    The problems are written in batches, so that memory stays small however many they are. The
    folder appears when it is complete. ``export.json`` in it names the recipe or the dataset, all
    options, the number of different maps, what 300 problems of each split are worth
    (`mapdata.describe.ProblemStatistics`), and the SHA-256 of every file's content, which
    `verify_export` compares.

    Args:
        source: folder or URL of a built dataset, or several; or a preset's name, a recipe (file,
            JSON text, mapping or `Recipe`) or a generator: its maps are then made on the fly, and
            nothing else is stored. Or a `ProblemSet`, or a file of problems that
            `mapdata.formats.read_problems` reads: its own problems are written, unchanged and in
            their order, as one split.
        target: name of the folder; a new one, or an empty one.
        format: "arrays", one ``.npy`` for each split and field; "parquet", one row for each
            problem, which Hugging Face ``datasets`` opens; "maze-hard", one line of text for each;
            or the name of one of `LAYOUTS`, the files that another repository's loader reads.
        fields: as in `MapDataset`, names only; default map, start, goal, path and cost. Layouts
            have their own.
        split: "train", "val" or "test"; None for all that the format has a place for, and for
            "test" of a `ProblemSet`.
        count: problems of each split. Default: all stored ones; of a recipe, one on each of its
            maps, or `Random.per_map` of them. More random problems of a built dataset use its maps
            again, with new starts and goals; more of a recipe are on further maps.
        problems: as in `MapDataset`; default "route", and in layouts what their repository draws.
        search: as in `MapDataset`; none for "maze-hard" and "hrm", whose paths follow the rule of
            maze-30x30-hard-1k: from the start, the first optimal move of down, left, right and up.
        movement: as in `MapDataset`; layouts have the rule of their repository as default.
        radius: as in `MapDataset`, in metres.
        augment: as in `MapDataset`; the splits val and test stay as they are.
        max_length: for "arrays", rows of ``path``, which is then one padded array. Random problems
            are drawn no longer than this; a longer path of other problems is an error.
        seed: of the maps of a recipe; default its own.
        sampling_seed: as in `MapDataset`.
        distinct: leave out the problems on copies: on maps that equal an earlier map of any split
            of the export, also turned or reflected. Several problems on one map are no copies. With
            ``count``, further maps of a recipe take their places.
        licence: for the card of "parquet", an identifier of the Hugging Face Hub, such as
            "cc-by-4.0".
        follow_links: read files of a built dataset that are links out of their folder.
        progress: show a progress bar.

    Returns:
        Notes for the user.

    Raises:
        DatasetNotFoundError: there is no dataset under ``source``.
        ShardError: it is damaged.
        TypeError: ``source`` is a dataset object, such as a `MapDataset`.
        ValueError: arguments that do not fit, or that would do nothing; a target that exists.
        OSError: the disk is full or may not be written to.
    """
    check_choice("format", format, PROBLEM_FORMATS)
    file_format = FORMATS[format]
    _check_format_options(file_format, fields, licence, max_length, search)
    check_flag("augment", augment)
    check_flag("distinct", distinct)
    if isinstance(source, Dataset):
        raise TypeError(
            f"source: got an object of type {type(source).__name__}, expected what it is made of: "
            "the folder of a dataset, a preset or recipe, or a ProblemSet; the other arguments of "
            "the dataset are also arguments here"
        )
    problem_set = _problem_set(source)
    given = {"problems": problems, "seed": seed, "radius": radius or None}
    if movement is None:
        movement = file_format.movement if problem_set is None else problem_set.movement
    options = _Options(
        fields=_format_fields(file_format, fields),
        problems=_format_problems(file_format, problems, max_length),
        search=search,
        movement=movement,
        radius=radius,
        augment=augment,
        max_length=max_length,
        sampling_seed=sampling_seed,
    )
    if options.problems.unsolvable and file_format.needs_paths:
        raise ValueError(
            f"problems: {format} needs a path of each problem, expected none with unsolvable=True"
        )
    if max_length is not None and "path" not in options.fields:
        raise ValueError("max_length: expected 'path' among the fields")
    if problem_set is not None:
        _check_set_options(file_format, problem_set, options, split, given)
        source = problem_set
        split = split or "test"
    splits = _format_splits(file_format, split)
    parts, origin = _open(source, options, splits, split, count, seed, follow_links, distinct)
    if distinct:
        parts = _without_copies(parts, count)
    dataset = parts[0].dataset
    _check_terrain(file_format, dataset, search)
    if file_format.has_maze_labels:
        _check_square_and_straight(format, dataset)
    if file_format.is_one_file:
        _check_all_splits(file_format, parts)
    rows, columns = dataset.map_size
    if max_length is not None and max_length > rows * columns:
        raise ValueError(f"max_length: got {max_length}, but a map has only {rows * columns} cells")
    with new_output(local_path(target)) as folder:
        folder.mkdir()
        counts = {part.split: part.count for part in parts}
        target_of_writer = WriterTarget(
            folder, counts, dataset.map_size, dataset.movement, options.max_length
        )
        writer = file_format.new_writer(target_of_writer)
        try:
            written = _write(parts, writer, options.fields, file_format.max_batch, progress)
            statistics = {part.split: measure(part.dataset, numbers=part.numbers) for part in parts}
            files = writer.finish(counts, dataset.map_size)
        except BaseException:
            writer.abort()
            raise
        about = {
            "mapdata": __version__,
            "format": format,
            "origin": origin,
            "options": options.plain(dataset) | {"distinct": distinct},
            "problems": counts,
            "maps": {split: len(np.unique(maps)) for split, maps in written.map_indices.items()},
            "problem_statistics": {split: statistics[split].to_dict() for split in statistics},
            "files": files,
            "content_hash": json_hash(files),
        }
        write_about(folder, about)
        if file_format.has_card:
            card = problem_card(local_path(target).name, about, options.fields, statistics, licence)
            (folder / CARD).write_text(card, encoding="utf-8", newline="\n")
    default = f", the default of {format}" if problems is None else ""
    which = plain_text(options.problems) + default
    if problem_set is not None:
        which = problem_set.description
    return [
        f"problems: {which}",
        *_source_notes(source),
        *_count_notes(parts),
        *_map_notes(parts, written.map_indices),
        *_target_notes(options.fields, statistics),
        *(
            _neighbour_notes(parts, written.neighbours, is_drawn=problem_set is None)
            if file_format.has_maze_labels
            else ()
        ),
        *_copy_notes(written.map_hashes, written.map_indices),
    ]


@dataclass(frozen=True)
class _Options:
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
class _Part:
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


def _format_fields(file_format: ProblemFormat, fields: Sequence[str] | None) -> tuple[str, ...]:
    """Return the fields that a format is made of."""
    if file_format.fields is not None:
        return file_format.fields
    if fields is None:
        return DEFAULT_FIELDS
    for field in fields:
        # Functions are refused, because a file records fields by name.
        if not isinstance(field, str) or field not in FIELDS:
            raise ValueError(
                f"fields: got {field!r}, expected names of fields: {', '.join(FIELDS)}"
                f"{did_you_mean(field, FIELDS)}"
            )
    return tuple(fields)


def _format_problems(
    file_format: ProblemFormat, problems: SourceLike | None, max_length: int | None
) -> Source:
    """Return which problems are written; random ones are drawn no longer than ``max_length``."""
    if problems is None:
        problems = file_format.problems
    source = problem_source(problems)
    if max_length is not None and isinstance(source, Random):
        check_count("max_length", max_length)
        min_cells, max_cells = source.length or (None, None)
        if max_cells is None or max_cells > max_length:
            source = replace(source, length=(min_cells, max_length))
    return source


def _check_format_options(
    file_format: ProblemFormat,
    fields: Sequence[str] | None,
    licence: str | None,
    max_length: int | None,
    search: str,
) -> None:
    """Refuse options that would do nothing for a format.

    Raises:
        ValueError: the message names the option.
    """
    name = file_format.name
    if fields is not None and file_format.fields is not None:
        raise ValueError(f"fields: {name} has its own fields, expected none")
    if licence is not None and not file_format.has_card:
        raise ValueError(f"licence: {name} has no card to state it, expected none")
    if licence is not None and re.fullmatch(r"[a-z0-9][a-z0-9.+-]*", str(licence)) is None:
        raise ValueError(f"licence: got {licence!r}, expected a word of the Hub, such as cc-by-4.0")
    if max_length is not None and not file_format.pads_paths:
        raise ValueError(
            f"max_length: only arrays have rows to pad; for {name} give random problems a band "
            f'of lengths, {{"random": {{"length": [null, {max_length}]}}}}'
        )
    if file_format.has_maze_labels and search != "astar":
        raise ValueError(
            f"search: got {search!r}, but {name} has the labels of maze-30x30-hard-1k, of whose "
            "rule no search is a part; expected none"
        )


def _format_splits(file_format: ProblemFormat, split: str | None) -> tuple[str, ...]:
    """Return the splits to write: ``split``, or all that the format has a place for.

    Raises:
        ValueError: the format has no place for ``split``, or is one file of all splits.
    """
    splits = file_format.splits
    if split is None:
        return splits
    check_choice("split", split, SPLITS)
    if split not in splits:
        raise ValueError(
            f"split: {file_format.name} has no place for {split!r}, only {', '.join(splits)}"
        )
    if file_format.is_one_file:
        raise ValueError(f"split: {file_format.name} is one file of all splits, expected none")
    return (split,)


def _open(
    source: Any,
    options: _Options,
    splits: tuple[str, ...],
    split: str | None,
    count: int | None,
    seed: int | None,
    follow_links: bool,
    distinct: bool,
) -> tuple[list[_Part], dict[str, Any]]:
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
    options: _Options,
    split: str,
    count: int | None,
    follow_links: bool,
    distinct: bool,
) -> _Part:
    """Return the problems of a split of a built dataset."""
    dataset = MapDataset(source, split, follow_links=follow_links, **options.serving(split))
    if count is None or len(dataset) == 0:
        return _Part(split, dataset, np.arange(len(dataset)))
    is_drawn_anew = isinstance(options.problems, Random) or dataset.serving.augment
    if count > len(dataset) and not is_drawn_anew:
        raise ValueError(
            f"count: got {count}, but the split {split!r} has {len(dataset)} problems; problems="
            '"random" draws as many as wanted'
        )
    return _Part(split, dataset, np.arange(max(count, len(dataset)) if distinct else count))


def _set_part(
    problem_set: ProblemSet, options: _Options, split: str, count: int | None, distinct: bool
) -> _Part:
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
    return _Part(split, dataset, np.arange(count))


def _problem_set(source: Any) -> ProblemSet | None:
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


def _check_set_options(
    file_format: ProblemFormat,
    problem_set: ProblemSet,
    options: _Options,
    split: str | None,
    given: Mapping[str, object],
) -> None:
    """Refuse what does not fit a problem set, whose maps and problems are given.

    Args:
        file_format: to write.
        problem_set: the problems.
        options: of the export.
        split: to write them as; None for "test".
        given: further arguments by name; they are None where the caller gave none.

    Raises:
        ValueError: the message names the argument.
    """
    for name, argument in given.items():
        if argument is not None:
            raise ValueError(f"{name}: a problem set has its own problems, expected none")
    if options.movement != problem_set.movement:
        raise ValueError(
            f"movement: got {options.movement}, expected that of the problem set, "
            f"{problem_set.movement}"
        )
    if options.augment and split != "train":
        raise ValueError("augment: changes training problems only, expected split='train'")
    if file_format.is_one_file:
        raise ValueError(
            f"{file_format.name}: is one file of all splits, but a problem set is one split; "
            "expected another format, or a dataset"
        )
    if len(problem_set) == 0:
        raise ValueError("source: got a problem set without problems, expected at least one")


def _online_part(
    recipe: Recipe, options: _Options, split: str, count: int | None, spare: int
) -> _Part:
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
    return _Part(split, dataset, np.arange(length))


def _without_copies(parts: Sequence[_Part], count: int | None) -> list[_Part]:
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
    except ValueError as error:
        if "expected a preset" not in str(error):
            raise
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


def _check_terrain(file_format: ProblemFormat, dataset: ProblemDataset, search: str) -> None:
    """Refuse maps with terrain for a format without costs of cells, and the other way round.

    Raises:
        ValueError: the format has no place for the costs, or needs them; or the paths are not the
            cheapest ones, which only A* finds.
    """
    if file_format.has_terrain is None:
        return
    name = file_format.name
    if dataset.has_terrain and not file_format.has_terrain:
        raise ValueError(
            f"{name}: got maps with terrain, but {name} has no costs of cells; expected maps "
            "without terrain, or one of the formats arrays, parquet and warcraft"
        )
    if file_format.has_terrain and not dataset.has_terrain:
        raise ValueError(
            f"{name}: got maps without terrain, expected costs of cells, as of the preset tiles"
        )
    if file_format.has_terrain and search != "astar":
        raise ValueError(f"search: {name} holds cheapest paths, got {search!r}, expected 'astar'")


def _check_square_and_straight(name: str, dataset: ProblemDataset) -> None:
    """Refuse what mazes as text cannot hold.

    Raises:
        ValueError: maps that are not square, or diagonal moves.
    """
    rows, columns = dataset.map_size
    if rows != columns or dataset.movement.connectivity != 4:
        raise ValueError(
            f"{name}: got maps of {rows} x {columns} cells and {dataset.movement}, expected "
            "square maps and 4-connected paths"
        )


def _check_all_splits(file_format: ProblemFormat, parts: Sequence[_Part]) -> None:
    """Refuse a source without problems in a split of a format that is one file of all splits."""
    missing = [name for name in file_format.splits if name not in {part.split for part in parts}]
    if missing:
        raise ValueError(f"{file_format.name}: the source has no problems in {', '.join(missing)}")


class _Written(NamedTuple):
    """What is noted of the problems while they are written.

    Attributes:
        map_hashes: by split, the hashes of the maps, one for each problem. Empty if the files have
            no maps, or no costs of maps with terrain.
        map_indices: by split, the numbers of the maps, one for each problem.
        neighbours: by split, the number of problems from a cell to one beside, above or below it.
            Empty if the files have no starts or goals.
    """

    map_hashes: dict[str, Array]
    map_indices: dict[str, Ints]
    neighbours: dict[str, int]


def _write(
    parts: Sequence[_Part],
    writer: Writer,
    fields: tuple[str, ...],
    max_batch: int,
    progress: bool,
) -> _Written:
    """Write the fields of all problems of all splits, at most ``max_batch`` at a time."""
    map_field = "terrain" if parts[0].dataset.has_terrain else "map"
    has_maps = map_field in parts[0].dataset.serving.fields
    hashes_of_batches: dict[str, list[Array]] = defaultdict(list)
    indices_of_batches: dict[str, list[Ints]] = defaultdict(list)
    neighbours: dict[str, int] = defaultdict(int)
    total = sum(part.count for part in parts)
    with bar(progress, total, unit=" problems") as advance:
        tried = 0

        def report_tried(maps: int) -> None:
            nonlocal tried
            tried += maps
            advance(0, f"{tried:,} maps tried")

        for part in parts:
            part.dataset.report_tried = report_tried
            for served in part.batches(max_batch):
                indices_of_batches[part.split].append(served["map_index"])
                columns = {name: served[name] for name in fields}
                writer.write(part.split, columns)
                if has_maps:
                    hashes = hash_grids(columns[map_field][:, 0], is_terrain=map_field == "terrain")
                    hashes_of_batches[part.split].append(np.array(hashes))
                if "start" in columns and "goal" in columns:
                    moves = np.abs(columns["start"] - columns["goal"]).sum(axis=1)
                    neighbours[part.split] += int((moves == 1).sum())
                advance(len(next(iter(columns.values()))))
    map_hashes = {split: np.concatenate(hashes) for split, hashes in hashes_of_batches.items()}
    map_indices = {split: np.concatenate(numbers) for split, numbers in indices_of_batches.items()}
    return _Written(map_hashes, map_indices, neighbours)


def _source_notes(source: Any) -> list[str]:
    """Return a note on a source that names both a preset and a dataset in the working folder."""
    if not isinstance(source, str) or source not in PRESETS:
        return []
    if not (Path(source) / MANIFEST).exists():
        return []
    return [
        f"source: {source} is the preset; ./{source} is the dataset in the folder of this name, "
        "which was not read"
    ]


def _count_notes(parts: Sequence[_Part]) -> list[str]:
    """Return notes on the number of problems of each split."""
    notes = [f"{part.split}: {part.count:,} problems" for part in parts]
    for part in parts:
        if part.count > len(part.dataset):
            notes.append(
                f"{part.split}: maps are used again, with other starts and goals, since an epoch "
                f"has {counted(len(part.dataset), 'problem')}"
            )
    return notes


def _map_notes(parts: Sequence[_Part], map_indices: Mapping[str, Ints]) -> list[str]:
    """Return notes on random problems that are on fewer maps than they could be.

    Args:
        parts: the splits.
        map_indices: numbers of the maps, one for each problem, by split.
    """
    notes = []
    for part in parts:
        _, problems_on_map = np.unique(map_indices[part.split], return_counts=True)
        map_count = len(problems_on_map)
        # Random problems of an epoch are evenly on all maps, as long as each map has some.
        source = part.dataset.serving.problems
        possible_maps = -(-min(part.count, len(part.dataset)) // source.per_map)  # rounded up
        is_random = isinstance(source, Random)
        if is_random and map_count < _FEW_MAPS * possible_maps:
            notes.append(
                f"{part.split}: these {part.count:,} problems are on {map_count:,} different maps "
                f"of {possible_maps:,}, up to {problems_on_map.max():,} on one map, because few "
                "maps have such a problem; wider conditions or more maps give more"
            )
    return notes


def _target_notes(
    fields: tuple[str, ...], statistics: Mapping[str, ProblemStatistics]
) -> list[str]:
    """Return a note if paths are written that are often one of several shortest paths.

    It is of the first split; the splits hardly differ.
    """
    split, first = next(iter(statistics.items()))
    has_path = not {"path", "path_mask"}.isdisjoint(fields)
    if has_path and first.single_path.value < _FEW_SINGLE_PATHS:
        return [f"{split}: {first.target_text()}"]
    return []


def _neighbour_notes(
    parts: Sequence[_Part], neighbours: Mapping[str, int], *, is_drawn: bool
) -> list[str]:
    """Return notes on mazes whose solution equals the question: no cell is between S and G.

    Args:
        parts: the splits.
        neighbours: number of such problems, by split.
        is_drawn: whether the problems are drawn, so that conditions may leave some out.
    """
    remedy = "; --length 3: leaves them out" if is_drawn else ""
    return [
        f"{part.split}: in {neighbours[part.split]:,} of {part.count:,} problems S and G are "
        f"neighbours, so the solved maze equals the question{remedy}"
        for part in parts
        if neighbours[part.split]
    ]


def _copy_notes(map_hashes: Mapping[str, Array], map_indices: Mapping[str, Ints]) -> list[str]:
    """Return notes on problems whose maps are copies: in a split, and of maps in train.

    Args:
        map_hashes: hashes of the maps, one for each problem, by split; or empty.
        map_indices: numbers of the maps, one for each problem, by split.
    """
    notes = []
    for split, hashes in map_hashes.items():
        numbers, first_problems = np.unique(map_indices[split], return_index=True)
        different = len(np.unique(hashes[first_problems]))
        if different < len(numbers):
            notes.append(
                f"{split}: of its {len(numbers):,} maps {different:,} differ, and the others are "
                "copies of them; --distinct leaves out the problems on copies"
            )
    if "train" not in map_hashes or len(map_hashes) == 1:
        return notes
    split_codes = [
        np.full(len(hashes), SPLITS.index(split), np.uint8) for split, hashes in map_hashes.items()
    ]
    repeats = count_repeats(np.concatenate(list(map_hashes.values())), np.concatenate(split_codes))
    notes += [
        f"{later}: {count:,} of {len(map_hashes[later]):,} problems are on maps that are also in "
        "train, so a model saw these maps in training; --distinct leaves them out"
        for (earlier, later), count in repeats.across.items()
        if earlier == "train" and count > 0
    ]
    return notes
