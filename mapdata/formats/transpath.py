"""The samples of TransPath: folders train, val and test of .npy files, read as maps or problems.

Source: https://github.com/AIRI-Institute/TransPath (data/hmaps.py, eval.py).

| file | shape | values |
|---|---|---|
| maps.npy | (N, 1, H, W) | the map: 1 occupied, 0 free |
| starts.npy, goals.npy | (N, 1, H, W) | 1 in one cell |
| focal.npy, cf.npy, abs.npy | (N, 1, H, W) | path probability, correction factor, cost to go |

Sample i is the i-th entry of each file; a map with several problems occurs in several samples.
Moves lead to the 8 neighbours, a diagonal costs sqrt 2, corners may be cut: the planner of the
repository moves so, and the costs to go of the nine maps in its folder maps/ confirm it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from mapdata.arrays import Array, Bytes
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import (
    LIMITS,
    Limits,
    check_grids,
    files_below,
    joint_name,
    marked_cell,
    read_grids,
    sampling_step,
    sibling,
    split_from_folders,
)
from mapdata.formats.registry import Format
from mapdata.limits import SPLITS, Cell
from mapdata.movement import Movement
from mapdata.npy import FormatError, StoredArray, open_npy
from mapdata.problems.problem_set import ProblemSet
from mapdata.search.api import search_batch
from mapdata.shards.workers import Advance, bar

MOVEMENT = Movement(8, corner_cutting=True)
"""The movement of the labels in the files."""

_MAPS = "maps.npy"
_SAMPLES = (_MAPS, "starts.npy", "goals.npy")
"""The files that every folder of samples has."""


class _SampleFolder(NamedTuple):
    """The arrays of a folder of samples, (N, 1, H, W) each, which are not read yet.

    Attributes:
        maps_path: path of its file ``maps.npy``.
        maps: 1 occupied, 0 free.
        starts, goals: 1 in a cell, 0 elsewhere.
    """

    maps_path: Path
    maps: StoredArray
    starts: StoredArray
    goals: StoredArray


def is_transpath(path: Path) -> bool:
    """Return whether an .npy file lies in a folder with maps, starts and goals."""
    return all((path.parent / name).is_file() for name in _SAMPLES)


def read(source: Path, limits: Limits = LIMITS) -> Collection:
    """Read the maps of all folders of samples below a folder, or of one by its ``maps.npy``.

    The goal of a sample becomes the first seed point of its map, and the start the second.

    Args:
        source: folder, or file ``maps.npy``.
        limits: of what is read.

    Raises:
        FormatError: ``source`` is another file, or ``maps.npy`` without starts and goals of the
            same shape. In a folder such files are left out, as are samples whose start or goal is
            not one free cell.
    """
    collection = Collection(movement=MOVEMENT)
    paths = [source]
    if source.is_dir():
        paths = files_below(source, (_MAPS,), limits, collection)
    folders: list[_SampleFolder] = []
    for path in paths:
        # If the user named this file, its error is raised and not only noted.
        with nullcontext() if path == source else collection.leaving_out(path):
            folders.append(_open(path, source, limits))
    total = sum(len(folder.maps) for folder in folders)
    with bar(limits.progress, total, unit=" samples read") as advance:
        for folder in folders:
            split = split_from_folders(folder.maps_path, source)
            collection.maps.extend(_read_samples(folder, split, collection, advance))
    collection.notes.append(
        "the goal and the start of each sample are the first two seed points of its map; labels "
        "(focal, cf, abs) are left out: the fields path_probability, heuristic_ratio and "
        "cost_to_go are computed"
    )
    return collection


def _open(path: Path, source: Path, limits: Limits) -> _SampleFolder:
    """Return the arrays of the folder of ``path``, unread, after checking all of its maps.

    Args:
        path: of the maps.
        source: file or folder that the user named.
        limits: of what is read.

    Raises:
        FormatError: ``path`` is not maps.npy with starts and goals beside it, one of the files is
            a link out of the source, the shapes do not fit, or the maps are damaged.
    """
    if path.name != _MAPS or not is_transpath(path):
        raise FormatError(f"{path}: expected maps.npy with starts.npy and goals.npy beside it")
    arrays = []
    for name in _SAMPLES:
        is_named = path == source and name == path.name
        arrays.append(open_npy(path if is_named else sibling(path, name, source, limits)))
    shape = arrays[0].shape
    for array in arrays:
        if array.shape != shape or len(shape) != 4 or shape[1] != 1:
            expected = "(N, 1, H, W)" if array is arrays[0] else f"{shape} as {_MAPS}"
            raise FormatError(f"{array.label}: has shape {array.shape}, expected {expected}")
    check_grids(arrays[0], limits)
    return _SampleFolder(path, *arrays)


def _read_samples(
    folder: _SampleFolder, split: int | None, collection: Collection, advance: Advance
) -> Iterator[ForeignMap]:
    """Yield the map of each sample, with its goal and start as seed points.

    Args:
        folder: the samples.
        split: code of their split; None to draw it.
        collection: bad samples are added to its ``left_out``.
        advance: called after each sample.
    """
    bad_samples = []
    entries = zip(
        read_grids(folder.maps), folder.starts.entries(), folder.goals.entries(), strict=True
    )
    for number, (grid, start_mask, goal_mask) in enumerate(entries):
        goal = _marked_free_cell(goal_mask[0], grid)
        start = _marked_free_cell(start_mask[0], grid)
        if goal is None or start is None:
            bad_samples.append(number)
        else:
            # Seed points differ, so a problem from a cell to itself has one of them.
            cells = [goal] if goal == start else [goal, start]
            seed_points = np.array(cells, np.int64)
            name = f"{folder.maps_path}: {number}"
            yield ForeignMap(name, grid, split, seed_points=seed_points)
        advance(1)
    if bad_samples:
        name = joint_name(f"{folder.maps_path}:", bad_samples)
        collection.left_out.append((name, "its start or its goal is not one free cell"))


def _marked_free_cell(mask: Array, grid: Bytes) -> Cell | None:
    """Return the only cell that is not 0 in a mask, (H, W), if the mask is 1 there and it is free.

    None if the mask marks no cell, several cells or an occupied cell.
    """
    cell = marked_cell(mask)
    return None if cell is None or grid[cell] != 0 else cell


def problems(
    source: Path,
    limits: Limits = LIMITS,
    *,
    split: Literal["train", "val", "test"] = "test",
    count: int | None = None,
) -> ProblemSet:
    """Return the problems of a folder of samples, to compare planners on or to train on.

    Args:
        source: folder with a folder of the split; a folder of samples itself, or its file
            ``maps.npy``, whatever its name.
        limits: of what is read, and whether a progress bar shows it.
        split: the split to read, where there are several folders of samples.
        count: maximal number of problems, evenly spread over the folder; default all.

    Raises:
        FormatError: no folder of samples of this split, or several; files that `read` refuses; a
            sample whose start or goal is not one free cell, or without a path between two cells.
            The message has the number of the sample.
    """
    folder = _open(_maps_path(source, limits, split), source, limits)
    total, _, rows, columns = folder.maps.shape
    numbers = range(0, total, 1 if count is None else sampling_step(total, count))
    grids = np.empty((len(numbers), rows, columns), np.uint8)
    starts = np.empty((len(numbers), 2), np.int64)
    goals = np.empty((len(numbers), 2), np.int64)
    entries = zip(
        read_grids(folder.maps), folder.starts.entries(), folder.goals.entries(), strict=True
    )
    with bar(limits.progress, total, unit=" samples read") as advance:
        for number, (grid, start_mask, goal_mask) in enumerate(entries):
            advance(1)
            if number not in numbers:
                continue
            start = _marked_free_cell(start_mask[0], grid)
            goal = _marked_free_cell(goal_mask[0], grid)
            if start is None:
                raise _bad_sample(folder, number, "its start is not one free cell")
            if goal is None:
                raise _bad_sample(folder, number, "its goal is not one free cell")
            if start == goal:
                raise _bad_sample(folder, number, "its start is its goal")
            problem = numbers.index(number)
            grids[problem] = grid
            starts[problem] = start
            goals[problem] = goal
    name = folder.maps_path.parent
    description = f"{len(numbers)} problems of {name}"
    if len(numbers) < total:
        description = f"{len(numbers)} of {total} problems of {name}, one in {numbers.step}"
    try:
        return ProblemSet(grids, starts, goals, MOVEMENT, description)
    except ValueError:
        # All else was checked above, so a problem has no path. The search is repeated only here.
        costs = search_batch("astar", grids, starts, goals, MOVEMENT).cost
        number = numbers[int(np.argmin(costs))]
        raise _bad_sample(folder, number, "no path leads from its start to its goal") from None


def _bad_sample(folder: _SampleFolder, number: int, fault: str) -> FormatError:
    """Return the error for a sample that is no problem."""
    return FormatError(
        f"{folder.maps_path}: sample {number}: {fault}; remove the sample from all files"
    )


def _maps_path(source: Path, limits: Limits, split: str) -> Path:
    """Return the file ``maps.npy`` of the only folder of samples, or of that of a split.

    Raises:
        FormatError: there is no such folder below ``source``, or several.
    """
    if source.is_file():
        return source
    if (source / _MAPS).is_file():
        return source / _MAPS
    code = SPLITS.index(split)
    paths = [
        path
        for path in files_below(source, (_MAPS,), limits, Collection())
        if path.name == _MAPS and is_transpath(path)
    ]
    paths_of_split = [path for path in paths if split_from_folders(path, source) == code]
    if len(paths_of_split) == 1:
        return paths_of_split[0]
    names = ", ".join(str(path.parent.relative_to(source)) for path in paths)
    raise FormatError(
        f"{source}: holds {len(paths_of_split)} folders of samples of the split {split!r} among "
        f"{names}; expected one, or name a single folder"
    )


FORMAT = Format("transpath", (".npy",), read, problems=problems, recognises=is_transpath)
