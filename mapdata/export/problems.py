"""`export_problems`: the problems of a dataset or a recipe, as files that training code reads."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from torch.utils.data import Dataset

from mapdata._version import __version__
from mapdata.arrays import Array, Ints
from mapdata.checks import check_choice, check_count, check_flag, did_you_mean
from mapdata.datasets.fields import FIELDS
from mapdata.datasets.problem_dataset import ProblemDataset
from mapdata.datasets.problem_statistics import measure
from mapdata.describe.problem_statistics import ProblemStatistics
from mapdata.describe.statistics import hash_grids
from mapdata.export.about import CARD, write_about
from mapdata.export.card import problem_card
from mapdata.export.notes import (
    copy_notes,
    count_notes,
    map_notes,
    neighbour_notes,
    source_notes,
    target_notes,
)
from mapdata.export.problem_formats import FORMATS, ProblemFormat, WriterTarget
from mapdata.export.sources import Options, Part, open_source, problem_set_of, without_copies
from mapdata.export.writers import Writer
from mapdata.generators.recipe import RecipeLike
from mapdata.hashing import json_hash
from mapdata.limits import PROBLEM_FORMATS, SPLITS
from mapdata.movement import Movement
from mapdata.problems.problem_set import ProblemSet
from mapdata.problems.sources import Random, Source, SourceLike, plain_text, problem_source
from mapdata.shards.files import StrPath, new_output
from mapdata.shards.locations import Locations, local_path
from mapdata.shards.workers import bar

DEFAULT_FIELDS = ("map", "start", "goal", "path", "cost")
"""The fields that are written unless the caller names others."""


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
    problem_set = problem_set_of(source)
    if movement is None:
        movement = file_format.movement if problem_set is None else problem_set.movement
    options = Options(
        fields=_format_fields(file_format, fields),
        problems=_format_problems(file_format, problems, max_length),
        search=search,
        movement=movement,
        radius=radius,
        augment=augment,
        max_length=max_length,
        sampling_seed=sampling_seed,
    )
    _check_options(file_format, options)
    if problem_set is not None:
        given = {"problems": problems, "seed": seed, "radius": radius or None}
        _check_set_options(file_format, problem_set, options, split, given)
        source = problem_set
        split = split or "test"
    splits = _format_splits(file_format, split)

    parts, origin = open_source(source, options, splits, split, count, seed, follow_links, distinct)
    if distinct:
        parts = without_copies(parts, count)
    _check_parts(file_format, parts, options)

    with new_output(local_path(target)) as folder:
        folder.mkdir()
        noted, statistics, files = _write(parts, file_format, options, folder, progress)
        about = {
            "mapdata": __version__,
            "format": format,
            "origin": origin,
            "options": options.plain(parts[0].dataset) | {"distinct": distinct},
            "problems": {part.split: part.count for part in parts},
            "maps": {split: len(np.unique(maps)) for split, maps in noted.map_indices.items()},
            "problem_statistics": {split: statistics[split].to_dict() for split in statistics},
            "files": files,
            "content_hash": json_hash(files),
        }
        write_about(folder, about)
        if file_format.has_card:
            name = local_path(target).name
            card = problem_card(name, about, options.fields, statistics, licence)
            (folder / CARD).write_text(card, encoding="utf-8", newline="\n")

    default = f", the default of {format}" if problems is None else ""
    which = plain_text(options.problems) + default
    if problem_set is not None:
        which = problem_set.description
    notes = [
        f"problems: {which}",
        *source_notes(source),
        *count_notes(parts),
        *map_notes(parts, noted.map_indices),
        *target_notes(options.fields, statistics),
    ]
    if file_format.has_maze_labels:
        notes += neighbour_notes(parts, noted.neighbours, is_drawn=problem_set is None)
    return notes + copy_notes(noted.map_hashes, noted.map_indices)


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


def _check_options(file_format: ProblemFormat, options: Options) -> None:
    """Refuse problems that have no path for what needs one.

    Raises:
        ValueError: the message names the argument.
    """
    if options.problems.unsolvable and file_format.needs_paths:
        raise ValueError(
            f"problems: {file_format.name} needs a path of each problem, expected none with "
            "unsolvable=True"
        )
    if options.max_length is not None and "path" not in options.fields:
        raise ValueError("max_length: expected 'path' among the fields")


def _check_set_options(
    file_format: ProblemFormat,
    problem_set: ProblemSet,
    options: Options,
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


def _check_parts(file_format: ProblemFormat, parts: Sequence[Part], options: Options) -> None:
    """Refuse maps and splits that a format cannot hold.

    Raises:
        ValueError: the message names the format or the argument.
    """
    dataset = parts[0].dataset
    _check_terrain(file_format, dataset, options.search)
    if file_format.has_maze_labels:
        _check_square_and_straight(file_format.name, dataset)
    if file_format.is_one_file:
        _check_all_splits(file_format, parts)
    rows, columns = dataset.map_size
    max_length = options.max_length
    if max_length is not None and max_length > rows * columns:
        raise ValueError(f"max_length: got {max_length}, but a map has only {rows * columns} cells")


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


def _check_all_splits(file_format: ProblemFormat, parts: Sequence[Part]) -> None:
    """Refuse a source without problems in a split of a format that is one file of all splits."""
    missing = [name for name in file_format.splits if name not in {part.split for part in parts}]
    if missing:
        raise ValueError(f"{file_format.name}: the source has no problems in {', '.join(missing)}")


class _Noted(NamedTuple):
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
    parts: Sequence[Part],
    file_format: ProblemFormat,
    options: Options,
    folder: Path,
    progress: bool,
) -> tuple[_Noted, dict[str, ProblemStatistics], dict[str, Any]]:
    """Write the files of all splits into an empty folder.

    Returns:
        What was noted; by split, what some of its problems are worth; and what each file holds, by
        its name, as plain values for JSON.

    Raises:
        ValueError, OSError: as the writer of the format; it has closed its files by then.
    """
    dataset = parts[0].dataset
    counts = {part.split: part.count for part in parts}
    writer = file_format.new_writer(
        WriterTarget(folder, counts, dataset.map_size, dataset.movement, options.max_length)
    )
    try:
        noted = _write_fields(parts, writer, options.fields, file_format.max_batch, progress)
        statistics = {part.split: measure(part.dataset, numbers=part.numbers) for part in parts}
        files = writer.finish(counts, dataset.map_size)
    except BaseException:
        writer.abort()
        raise
    return noted, statistics, files


def _write_fields(
    parts: Sequence[Part],
    writer: Writer,
    fields: tuple[str, ...],
    max_batch: int,
    progress: bool,
) -> _Noted:
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
    return _Noted(map_hashes, map_indices, neighbours)
