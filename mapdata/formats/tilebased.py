"""The sets of Neural Weighted A*, problems on pictures of tiles: train.npz, val.npz, test.npz, in.

Source: https://github.com/archettialberto/tilebased_navigation_datasets (README.md), the sets
Warcraft and Pokemon of Archetti et al., "Neural Weighted A*", 2021; the rule of the paths is that
of https://github.com/archettialberto/neural_weighted_a_star (a_star/ray_a_star.py).

A file holds N maps with T targets each, and S sources for each target:

| array | shape | values |
|---|---|---|
| maps | (N, k H, k W, 3) | pictures with k x k pixels for each cell |
| costs | (N, H, W) | the weight of each cell; no cell is occupied |
| targets | (N, T, 2) | (row, col) |
| sources | (N, T, S, 2) | (row, col) |
| paths | (N, T, S, H, W) | 1 on the cells of a shortest path, 0 elsewhere |
| exp_nodes | (N, T, S, H, W) | 1 on the cells that their A* expands |

Moves lead to the 8 neighbours. The cost of a path is the sum of the weights of its cells but the
source, diagonal moves included; so its shortest paths are ours where a diagonal counts 1.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from mapdata.arrays import Array, Bytes, Flags
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import (
    LIMITS,
    SPLIT_NAMES,
    Limits,
    files_with_endings,
    split_from_folders,
)
from mapdata.formats.registry import Format
from mapdata.formats.warcraft import MOVEMENT, PathCheck, cells_of_path
from mapdata.formats.weights import (
    UNIT,
    check_unit,
    check_weights,
    only_path_of_split,
    problem_set,
    to_terrain,
)
from mapdata.limits import Cell, Size
from mapdata.npy import FormatError, Npz, StoredArray
from mapdata.problems.problem_set import ProblemSet

_ARRAYS = ("maps", "costs", "targets", "sources", "paths")
"""The arrays by which a file is recognised."""

_MAX_PATHS = 1000
"""The largest number of paths on one map; published sets have 4."""


class _TileFile(NamedTuple):
    """The arrays of a file, which are not read yet.

    Attributes:
        path: the file.
        costs: (N, H, W).
        targets: (N, T, 2).
        sources: (N, T, S, 2).
        paths: (N, T, S, H, W).
    """

    path: Path
    costs: StoredArray
    targets: StoredArray
    sources: StoredArray
    paths: StoredArray


def is_tilebased(path: Path) -> bool:
    """Return whether an .npz is of this format, by the names of its arrays."""
    try:
        shapes = Npz(path).shapes
    except FormatError:
        return False
    return set(_ARRAYS) <= set(shapes)


def read(source: Path, limits: Limits = LIMITS, *, unit: float = UNIT) -> Collection:
    """Read the costs of an .npz, or of all below a folder; check their paths.

    The first target of a map, its sources, the second target, and so on become the seed points of
    the map. Pictures and expanded cells are left out.

    Args:
        source: file or folder.
        limits: of what is read.
        unit: the weight that becomes a cost of 1; all weights must be whole multiples of it.

    Raises:
        FormatError: ``source`` is no such file. In a folder such files are left out.
    """
    unit = check_unit(unit)
    collection = Collection(movement=MOVEMENT)
    for path in files_with_endings(source, (".npz",), limits, collection):
        # If the user named this file, its error is raised and not only noted.
        with nullcontext() if path == source else collection.leaving_out(path):
            # All maps are read before the first one is used, so a damaged file gives none.
            maps, _ = _read_maps(_open(path, limits), _split_of(path, source), unit)
            collection.maps.extend(maps)
    collection.maps.sort(key=lambda foreign_map: foreign_map.split or 0)  # train, val, test
    collection.notes.append(
        f"terrain is the weight of a cell divided by {unit:g}; pictures and expanded cells are "
        "left out: the field image draws other pictures"
    )
    return collection


def _split_of(path: Path, source: Path) -> int | None:
    """Return the code of the split after which a file, or a folder above it, is named."""
    if path.stem.lower() in SPLIT_NAMES:
        return SPLIT_NAMES[path.stem.lower()]
    return split_from_folders(path, source)


def _open(path: Path, limits: Limits) -> _TileFile:
    """Return the arrays of a file, unread, after checking their shapes.

    Raises:
        FormatError: an array is missing, shapes that do not fit, or more than the limits allow.
    """
    archive = Npz(path, limits.unpacked)
    archive.require(*_ARRAYS)
    file = _TileFile(path, *archive.arrays("costs", "targets", "sources", "paths"))
    check_weights(file.costs, limits)
    count, rows, columns = file.costs.shape
    shape = file.sources.shape
    targets, sources = shape[1:3] if len(shape) == 4 else (0, 0)
    if not 1 <= targets * sources <= _MAX_PATHS:
        raise FormatError(
            f"{file.sources.label}: has shape {shape}, expected ({count}, T, S, 2) "
            f"with 1 to {_MAX_PATHS} sources on a map"
        )
    expected_shapes: list[tuple[StoredArray, tuple[int, ...]]] = [
        (file.targets, (count, targets, 2)),
        (file.sources, (count, targets, sources, 2)),
        (file.paths, (count, targets, sources, rows, columns)),
    ]
    for array, expected in expected_shapes:
        if array.shape != expected:
            raise FormatError(f"{array.label}: has shape {array.shape}, expected {expected}")
    return file


def _check_maps(file: _TileFile, unit: float) -> None:
    """Read a whole file and keep nothing, to detect a fault before any map is used.

    An archive of a megabyte may unpack to a gigabyte. So that a bad one takes little memory, only
    one map or path is in memory at a time.

    Raises:
        FormatError: bad weights, cells or paths, or a damaged file.
    """
    for _ in _read_terrain(file, unit):
        pass
    for _ in _read_problems(file):
        pass
    _, targets, sources, _, _ = file.paths.shape

    def check_path(marks: Array, number: int) -> None:
        map_number, problem = divmod(number, targets * sources)
        target, source = divmod(problem, sources)
        cells_of_path(marks, _path_label(file, map_number, target, source))

    deque(map(check_path, file.paths.entries(axes=3), itertools.count()), maxlen=0)


def _read_terrain(file: _TileFile, unit: float) -> Iterator[Bytes]:
    """Yield the terrain of each map, (H, W) uint8.

    Raises:
        FormatError: bad weights, or a damaged file.
    """

    def terrain_of(weights: Array, number: int) -> Bytes:
        return to_terrain(weights, unit, _map_name(file, number))

    # Unlike a loop, `map` keeps no entry while the next one is read.
    return map(terrain_of, file.costs.entries(), itertools.count())


def _read_problems(file: _TileFile) -> Iterator[list[_TileProblem]]:
    """Yield the problems of each map, target by target.

    Raises:
        FormatError: a cell outside the map, or a damaged file.
    """
    shape = file.costs.shape[1:]
    entries = zip(file.targets.entries(), file.sources.entries(), strict=True)
    for number, (targets, sources) in enumerate(entries):
        yield _tile_problems(_map_name(file, number), (shape[0], shape[1]), targets, sources)


def _map_name(file: _TileFile, number: int) -> str:
    """Return the name of a map, for the user."""
    return f"{file.path}: map {number}"


def _path_label(file: _TileFile, number: int, target: int, source: int) -> str:
    """Return the name of a path, for errors."""
    return f"{_map_name(file, number)}: target {target}, source {source}: path"


def _read_maps(
    file: _TileFile, split: int | None, unit: float
) -> tuple[list[ForeignMap], list[list[_TileProblem]]]:
    """Return all maps of a file, and the problems of each map.

    Raises:
        FormatError: as `_check_maps`.
    """
    _check_maps(file, unit)
    maps = []
    problems_of_maps = []
    paths = file.paths.entries(axes=3)
    entries = zip(_read_terrain(file, unit), _read_problems(file), strict=True)
    for number, (terrain, tile_problems) in enumerate(entries):
        cells = [cell for problem in tile_problems for cell in (problem.target, problem.source)]
        # A cell that stands in several problems is one seed point.
        numbers = {cell: k for k, cell in enumerate(dict.fromkeys(cells))}
        marked_cells: dict[tuple[int, int], Flags] = {}
        for problem, path in zip(tile_problems, paths, strict=False):
            first, second = sorted((numbers[problem.target], numbers[problem.source]))
            marked_cells[first, second] = path == 1
        maps.append(
            ForeignMap(
                _map_name(file, number),
                np.zeros_like(terrain),
                split,
                seed_points=np.array(list(numbers), np.int64),
                rooms_known=len(numbers) > 1,
                check=PathCheck(marked_cells),
                terrain=terrain,
            )
        )
        problems_of_maps.append(tile_problems)
    return maps, problems_of_maps


def problems(
    source: Path,
    limits: Limits = LIMITS,
    *,
    split: Literal["train", "val", "test"] = "test",
    count: int | None = None,
    unit: float = UNIT,
) -> ProblemSet:
    """Return the problems of a split, each from a source to its target.

    Problems from a cell to itself are left out.

    Args:
        source: folder of one set, or an .npz.
        limits: of what is read.
        split: the split to read, where ``source`` is a folder.
        count: maximal number of problems, evenly spread over the file; default all.
        unit: as in `read`.

    Raises:
        FormatError: files that `read` refuses; no file of the split, or several.
    """
    paths = list(files_with_endings(source, (".npz",), limits, Collection()))
    splits = [_split_of(path, source) for path in paths]
    path = only_path_of_split(paths, splits, source, split)
    maps, problems_of_maps = _read_maps(_open(path, limits), None, check_unit(unit))
    ends = [
        (number, problem.source, problem.target)
        for number, tile_problems in enumerate(problems_of_maps)
        for problem in tile_problems
    ]
    return problem_set(maps, ends, MOVEMENT, path, count)


class _TileProblem(NamedTuple):
    """A problem of a map: two cells (row, col)."""

    target: Cell
    source: Cell


def _tile_problems(name: str, shape: Size, targets: Array, sources: Array) -> list[_TileProblem]:
    """Return the problems of a map, target by target.

    Args:
        name: of the map, for errors.
        shape: (rows, columns) of the map.
        targets: (T, 2) numbers.
        sources: (T, S, 2) numbers.

    Raises:
        FormatError: a cell outside the map.
    """
    tile_problems = []
    for target_number, target in enumerate(targets):
        target_name = f"{name}: target {target_number}"
        for source_number, source in enumerate(sources[target_number]):
            target_cell = _cell(target, shape, target_name)
            source_cell = _cell(source, shape, f"{target_name}, source {source_number}")
            tile_problems.append(_TileProblem(target_cell, source_cell))
    return tile_problems


def _cell(numbers: Array, shape: Size, label: str) -> Cell:
    """Return two numbers of any dtype as a cell (row, col).

    Raises:
        FormatError: they are not whole, or lie outside a map of this shape.
    """
    row, column = numbers.tolist()
    rows, columns = shape
    # With NaN every comparison is false, so this form of the test refuses it.
    is_inside = 0 <= row < rows and 0 <= column < columns
    if not is_inside or int(row) != row or int(column) != column:
        raise FormatError(
            f"{label} is {row, column}, expected a cell (row, col) of {rows} x {columns} cells"
        )
    return int(row), int(column)


FORMAT = Format("tilebased", (".npz",), read, problems=problems, recognises=is_tilebased)
