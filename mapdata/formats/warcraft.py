"""The Warcraft shortest path sets: pictures, weights and paths of each split in .npy files, in.

The sets are those of Vlastelica et al., "Differentiation of blackbox combinatorial solvers", 2020,
https://doi.org/10.17617/3.YJCQ5S. Sources of the layout, and of the rule of the paths:
https://github.com/martius-lab/blackbox-differentiation-combinatorial-solvers
(warcraft_shortest_path/data_utils.py, comb_modules/dijkstra.py),
https://github.com/omron-sinicx/neural-astar (src/neural_astar/utils/data.py) and
https://github.com/khalil-research/PyEPO (notebooks/06 Warcraft Shortest Path.ipynb).

A folder has three files for each split train, val and test. For N maps:

| file | shape | values |
|---|---|---|
| SPLIT_maps.npy | (N, k H, k W, 3) | uint8, pictures with k x k pixels for each cell |
| SPLIT_vertex_weights.npy | (N, H, W) | the weight of each cell; no cell is occupied |
| SPLIT_shortest_paths.npy | (N, H, W) | 1 on the cells of a shortest path, 0 elsewhere |

A path leads from the upper left to the lower right cell by moves to the 8 neighbours. Its cost is
the sum of the weights of its cells, diagonal moves included. That is our cost where a diagonal
counts 1, but for half of the weights of both ends, which all paths share; so the shortest paths are
the same. `mapdata.export` writes this layout.
"""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from mapdata.arrays import Array, Bytes, Flags
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import LIMITS, SPLIT_NAMES, Limits, files_below, sibling
from mapdata.formats.registry import Format
from mapdata.formats.weights import (
    UNIT,
    check_unit,
    check_weights,
    only_path_of_split,
    problem_set,
    read_terrain,
)
from mapdata.limits import Cell
from mapdata.movement import Movement
from mapdata.npy import FormatError, StoredArray, open_npy
from mapdata.problems.problem_set import ProblemSet
from mapdata.search.api import distance_field
from mapdata.search.labels import Labels
from mapdata.shards.workers import bar

MOVEMENT = Movement(8, corner_cutting=True, diagonal_cost=1.0)
"""The rule of the paths: 8 neighbours, and a diagonal move costs no more than a straight one."""

_PICTURES = "_maps.npy"
_WEIGHTS = "_vertex_weights.npy"
_PATHS = "_shortest_paths.npy"
_ENDINGS = (_PICTURES, _WEIGHTS, _PATHS)


class _SplitFiles(NamedTuple):
    """The arrays of a split with N maps of (H, W), which are not read yet.

    Attributes:
        split: code of the split.
        weights: (N, H, W).
        paths: (N, H, W), 1 on the cells of a path.
    """

    split: int
    weights: StoredArray
    paths: StoredArray


def is_warcraft(path: Path) -> bool:
    """Return whether an .npy file is one of the three of a split, by its name and its folder.

    Files of such a name may be others, if the folder has no weights at all.
    """
    return path.name.endswith(_ENDINGS) and any(path.parent.glob(f"*{_WEIGHTS}"))


def _weights_paths(source: Path, limits: Limits, collection: Collection) -> list[Path]:
    """Return the path of the weights of each split, whichever of its files exist.

    Args:
        source: folder, or the file of the weights of a split.
        limits: of the number of files.
        collection: files that `files_below` refuses are added to its ``left_out``.
    """
    if not source.is_dir():
        return [source]
    paths = []
    for path in files_below(source, _ENDINGS, limits, collection):
        for ending in _ENDINGS:
            if path.name.endswith(ending):
                paths.append(path.with_name(path.name.removesuffix(ending) + _WEIGHTS))
    return list(dict.fromkeys(paths))


def read(source: Path, limits: Limits = LIMITS, *, unit: float = UNIT) -> Collection:
    """Read the weights of all splits below a folder, or of one by its ``_vertex_weights.npy``.

    The upper left and the lower right cell become the seed points of each map. The paths are
    compared with ours; the pictures are left out.

    Args:
        source: folder, or file ``SPLIT_vertex_weights.npy``.
        limits: of what is read.
        unit: the weight that becomes a cost of 1; all weights must be whole multiples of it.

    Raises:
        FormatError: ``source`` is another file, or cannot be read. In a folder, splits that cannot
            be read are left out.
    """
    unit = check_unit(unit)
    collection = Collection(movement=MOVEMENT)
    paths = _weights_paths(source, limits, collection)
    opened: list[_SplitFiles] = []
    refused = {name for name, _ in collection.left_out}
    for path in paths:
        if str(path) in refused:
            continue  # its reason is known already
        # If the user named this file, its error is raised and not only noted.
        with nullcontext() if path == source else collection.leaving_out(path):
            opened.append(_open(path, source, limits))
    opened.sort(key=lambda files: files.split)  # train, val, test
    total = sum(len(files.weights) for files in opened)
    with bar(limits.progress, total, unit=" maps read") as advance:
        for files in opened:
            path = files.weights.path
            with nullcontext() if path == source else collection.leaving_out(path):
                # All maps are read before the first one is used, so a damaged file gives none.
                maps = _read_maps(files, unit)
                collection.maps.extend(maps)
            advance(len(files.weights))
    collection.notes.append(
        f"terrain is the weight of a cell divided by {unit:g}; the pictures are left out: the "
        "field image draws others"
    )
    return collection


def _open(path: Path, source: Path, limits: Limits) -> _SplitFiles:
    """Return the arrays of the split of a file of weights, unread.

    Args:
        path: of the weights.
        source: file or folder that the user named.
        limits: of what is read.

    Raises:
        FormatError: not such a file, a file of the split is missing or a link out of the source, or
            their shapes do not fit.
    """
    prefix = path.name.removesuffix(_WEIGHTS)
    if prefix == path.name or prefix.lower() not in SPLIT_NAMES:
        raise FormatError(
            f"{path}: expected a folder, or its train{_WEIGHTS}, val{_WEIGHTS} or test{_WEIGHTS}"
        )
    weights = open_npy(path if path == source else sibling(path, path.name, source, limits))
    check_weights(weights, limits)
    paths = open_npy(sibling(path, prefix + _PATHS, source, limits))
    if paths.shape != weights.shape:
        raise FormatError(
            f"{paths.label}: has shape {paths.shape}, expected {weights.shape} as {path.name}"
        )
    _check_pictures(open_npy(sibling(path, prefix + _PICTURES, source, limits)), weights)
    return _SplitFiles(SPLIT_NAMES[prefix.lower()], weights, paths)


def _check_pictures(pictures: StoredArray, weights: StoredArray) -> None:
    """Check that there is a picture of each map, with a square of pixels for each cell.

    Raises:
        FormatError: another shape.
    """
    count, rows, columns = weights.shape
    shape = pictures.shape
    pixels = shape[1] // rows if len(shape) == 4 else 0
    if pixels < 1 or shape != (count, pixels * rows, pixels * columns, 3):
        raise FormatError(
            f"{pictures.label}: has shape {shape}, expected ({count}, k {rows}, k {columns}, 3) "
            f"for the {rows} x {columns} cells of {weights.path.name}"
        )


def _read_maps(files: _SplitFiles, unit: float) -> list[ForeignMap]:
    """Return all maps of a split.

    Raises:
        FormatError: bad weights or paths, or a damaged file.
    """
    rows, columns = files.weights.shape[1:]
    start = (0, 0)
    goal = (rows - 1, columns - 1)
    seed_points = np.array([start, goal], np.int64)
    maps = []
    terrains = read_terrain(files.weights, unit)
    for number, (terrain, path) in enumerate(zip(terrains, files.paths.entries(), strict=True)):
        check = PathCheck({(0, 1): cells_of_path(path, f"{files.paths.label}: map {number}")})
        maps.append(
            ForeignMap(
                f"{files.weights.path}: map {number}",
                np.zeros_like(terrain),
                files.split,
                seed_points=seed_points,
                rooms_known=True,
                check=check,
                terrain=terrain,
            )
        )
    return maps


def problems(
    source: Path,
    limits: Limits = LIMITS,
    *,
    split: Literal["train", "val", "test"] = "test",
    count: int | None = None,
    unit: float = UNIT,
) -> ProblemSet:
    """Return the problems of a split, each from the upper left to the lower right cell.

    Args:
        source: folder of one set, or file ``SPLIT_vertex_weights.npy``.
        limits: of what is read.
        split: the split to read, where ``source`` is a folder.
        count: maximal number of problems, evenly spread over the file; default all.
        unit: as in `read`.

    Raises:
        FormatError: files that `read` refuses; no file of the split, or several.
    """
    paths = _weights_paths(source, limits, Collection())
    splits = [SPLIT_NAMES.get(path.name.removesuffix(_WEIGHTS).lower()) for path in paths]
    path = only_path_of_split(paths, splits, source, split)
    maps = _read_maps(_open(path, source, limits), check_unit(unit))
    rows, columns = maps[0].shape
    corner_problems = [(number, (0, 0), (rows - 1, columns - 1)) for number in range(len(maps))]
    return problem_set(maps, corner_problems, MOVEMENT, path, count)


def cells_of_path(marks: Array, label: str) -> Flags:
    """Return which cells, (H, W) bool, are marked as cells of a path.

    Args:
        marks: (H, W) of 0 and 1.
        label: names the path in errors.

    Raises:
        FormatError: another number.
    """
    is_marked = marks == 1
    is_mark = marks == 0
    is_mark |= is_marked
    if not is_mark.all():
        raise FormatError(f"{label}: holds {marks.min()} to {marks.max()}, expected only 0 and 1")
    return np.asarray(is_marked)


class PathCheck:
    """Compares paths of a source with ours, as `ForeignMap.check`.

    A set of cells is a shortest path between two seed points if it contains a path between them,
    and costs no more than the shortest path. It need not be the path that we find.
    """

    def __init__(self, paths: dict[tuple[int, int], Flags]) -> None:
        """Keep the cells, (H, W) bool, of the path between two seed points i < j, as bits."""
        self._bits = {ends: np.packbits(is_marked, axis=1) for ends, is_marked in paths.items()}

    def __call__(self, labels: Labels, k: int) -> list[str]:
        """Return ["path"] if a path on map ``k`` of ``labels`` is not a shortest one, else []."""
        maps = labels.maps
        if maps.terrain is None:
            raise TypeError("labels: expected maps with terrain")
        costs = labels.matrix("astar", k)
        terrain = maps.terrain[k].astype(np.int64)
        for (first, second), bits in self._bits.items():
            is_marked = np.unpackbits(bits, axis=1, count=terrain.shape[1]).view(np.bool_)
            start = tuple(maps.seed_points[k, first].tolist())
            goal = tuple(maps.seed_points[k, second].tolist())
            if not _is_shortest(
                is_marked, terrain, start, goal, costs[first, second], maps.movement
            ):
                return ["path"]
        return []


def _is_shortest(
    is_marked: Flags,
    terrain: Array,
    start: Cell,
    goal: Cell,
    cost: float,
    movement: Movement,
) -> bool:
    """Return whether marked cells are a shortest path where a diagonal move counts 1.

    Args:
        is_marked: (H, W), the cells.
        terrain: (H, W) int64, their costs.
        start: (row, col).
        goal: (row, col).
        cost: of the shortest path.
        movement: which moves are legal.
    """
    if not (is_marked[start] and is_marked[goal]):
        return False
    # The cost of a path is the sum of its cells, but for half of both ends; of whole numbers, so
    # that the doubled costs are exact.
    doubled_cost = 2 * terrain[is_marked].sum() - terrain[start] - terrain[goal]
    if doubled_cost != 2 * cost:
        return False
    blocked: Bytes = (~is_marked).astype(np.uint8)
    return bool(distance_field(blocked, goal, movement)[start] >= 0)


FORMAT = Format("warcraft", (".npy",), read, problems=problems, recognises=is_warcraft)
