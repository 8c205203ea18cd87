"""The samples of TransPath: folders train, val and test of .npy files, of which the maps are read.

Source: https://github.com/AIRI-Institute/TransPath (data/hmaps.py, eval.py).

| file | shape | values |
|---|---|---|
| maps.npy | (N, 1, H, W) | the map: 1 occupied, 0 free |
| starts.npy, goals.npy | (N, 1, H, W) | 1 in one cell |
| focal.npy, cf.npy, abs.npy | (N, 1, H, W) | path probability, correction factor, cost to go |

Sample i is the i-th entry of each file; a map stands in as many samples as it has problems. Moves
lead to the 8 neighbours, a diagonal costs sqrt 2, corners may be cut: so does the planner of the
repository, and so are the costs to go of the nine maps in its folder maps/.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import numpy as np

from mapdata.arrays import Array, Ints
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import (
    LIMITS,
    Limits,
    check_grids,
    grids_of,
    several,
    split_of,
    walk,
)
from mapdata.formats.registry import Format
from mapdata.movement import Movement
from mapdata.npy import FormatError, StoredArray, open_npy
from mapdata.shards.workers import Advance, bar

MOVEMENT = Movement(8, corner_cutting=True)
"""The rule of its labels."""

_MAPS = "maps.npy"
_SAMPLES = (_MAPS, "starts.npy", "goals.npy")
"""The files that make a folder one of samples."""


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
            same shape. In a folder that is left out, as are samples whose start or goal is not one
            free cell.
    """
    found = Collection(movement=MOVEMENT)
    paths = walk(source, (_MAPS,), limits, found) if source.is_dir() else [source]
    folders: list[tuple[Path, list[StoredArray]]] = []
    for path in paths:
        with nullcontext() if path == source else found.leaving_out(path):
            folders.append((path, _open(path, limits)))
    total = sum(len(maps) for _, (maps, *_) in folders)
    with bar(limits.progress, total, unit=" samples read") as advance:
        for path, arrays in folders:
            for sample in _samples(path, arrays, split_of(path, source), found, advance):
                found.maps.append(sample)
    found.notes.append(
        "the goal and the start of each sample are the first two seed points of its map; labels "
        "(focal, cf, abs) are left out: the fields path_probability, heuristic_ratio and "
        "cost_to_go are computed"
    )
    return found


def _open(path: Path, limits: Limits) -> list[StoredArray]:
    """Return the maps, starts and goals of a folder, unread, after a look at all of the maps.

    Raises:
        FormatError: another file, other shapes, or maps that are none.
    """
    if path.name != _MAPS or not is_transpath(path):
        raise FormatError(f"{path}: expected maps.npy with starts.npy and goals.npy beside it")
    arrays = [open_npy(path.with_name(name)) for name in _SAMPLES]
    shape = arrays[0].shape
    for array in arrays:
        if array.shape != shape or len(shape) != 4 or shape[1] != 1:
            expected = "(N, 1, H, W)" if array is arrays[0] else f"{shape} as {_MAPS}"
            raise FormatError(f"{array.label}: has shape {array.shape}, expected {expected}")
    check_grids(arrays[0], limits)
    return arrays


def _samples(
    path: Path, arrays: list[StoredArray], split: int | None, found: Collection, advance: Advance
) -> Iterator[ForeignMap]:
    """Yield the map of each sample of a folder; bad samples go to ``found.left_out``."""
    maps, starts, goals = arrays
    bad_samples = []
    entries = zip(grids_of(maps), starts.entries(), goals.entries(), strict=True)
    for number, (grid, start, goal) in enumerate(entries):
        ends = np.concatenate([_marked(goal), _marked(start)])
        if len(ends) != 2 or grid[tuple(ends.T)].any():
            bad_samples.append(number)
        else:
            # a problem from a cell to itself has one end
            seed_points = ends[:1] if (ends[0] == ends[1]).all() else ends
            yield ForeignMap(f"{path}: {number}", grid, split, seed_points=seed_points)
        advance(1)
    if bad_samples:
        name = several(f"{path}:", bad_samples)
        found.left_out.append((name, "its start or its goal is not one free cell"))


def _marked(mask: Array) -> Ints:
    """Return the cell that is 1 in a mask (1, H, W), as (1, 2); no cell if it is not just one."""
    cells = np.argwhere(mask[0])
    is_marked = len(cells) == 1 and mask[0][tuple(cells[0])] == 1
    return cells.astype(np.int64) if is_marked else np.empty((0, 2), np.int64)


FORMAT = Format("transpath", (".npy",), read, is_mine=is_transpath)
