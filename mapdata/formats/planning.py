"""Problems of planning-datasets and Neural A*: an .npz with arr_0 to arr_11, in and out.

Sources: https://github.com/omron-sinicx/planning-datasets (generate_spp_instances.py) and the
loader in https://github.com/omron-sinicx/neural-astar (src/neural_astar/utils/data.py).

arr_0 to arr_3 are the training split, arr_4 to arr_7 validation, arr_8 to arr_11 test. For N maps
of one size:

| array | shape | values |
|---|---|---|
| first | (N, H, W) | the map: 1 free, 0 occupied (the other way round than here) |
| second | (N, 1, H, W) | the goal: 1 in one cell |
| third | (N, 8, 1, H, W) | an optimal action in each cell, 1 in one of N E W S NE NW SE SW |
| fourth | (N, 1, H, W) | minus the moves to the goal; the minimum -H W: occupied or unreachable |

A move to any of the 8 neighbours counts 1, corners may be cut. The loader draws a start whose
distance lies between two percentiles. It fails if there is no such cell, so such maps are left out
of an export.

Two layouts of iA*, https://github.com/sair-lab/iAstar, are read as well. If the third array is
(N, 4, 1, H, W), paths have no diagonals and the actions are N E W S. A file of 15 arrays has five
for each split; the fifth, (N, H, W), is a distance field, which is left out.
"""

from __future__ import annotations

import re
import shutil
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack, nullcontext
from itertools import chain, pairwise
from pathlib import Path
from tempfile import TemporaryFile
from typing import NamedTuple

import numpy as np
from numpy.lib.format import write_array_header_1_0

from mapdata.arrays import Array, Bytes, Float32s, Ints
from mapdata.checks import check_seed
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import (
    LIMITS,
    Limits,
    check_grids,
    files_with_endings,
    joint_name,
    marked_cell,
    read_grids,
)
from mapdata.formats.registry import Format
from mapdata.limits import SPLITS, Cell
from mapdata.movement import NEURAL_ASTAR, Movement
from mapdata.npy import FormatError, Npz, StoredArray
from mapdata.problems.problem_set import ProblemSet
from mapdata.rng import PROBLEM, block, bounded
from mapdata.search.api import distance_field
from mapdata.shards.root import Root

ACTIONS = ((-1, 0), (0, 1), (0, -1), (1, 0), (-1, 1), (-1, -1), (1, 1), (1, -1))
"""The step (row, col) of each action."""

PERCENTILES = (0.55, 0.70, 0.85, 1.0)
"""The loader draws starts from three intervals of distance, which these percentiles bound."""


def is_planning(path: Path) -> bool:
    """Return whether an .npz is of this format, by the names and shapes of its arrays."""
    try:
        shapes = Npz(path).shapes
    except FormatError:
        return False
    return {f"arr_{k}" for k in range(4)} <= set(shapes) and len(shapes["arr_2"]) == 5


class _Split(NamedTuple):
    """The arrays of a split with N maps of (H, W), which are not read yet.

    Attributes:
        name: train, val or test.
        maps: (N, H, W), 1 free and 0 occupied.
        goals: (N, 1, H, W), 1 in the goal's cell and 0 elsewhere.
        distances: (N, 1, H, W), minus the moves to the goal.
    """

    name: str
    maps: StoredArray
    goals: StoredArray
    distances: StoredArray


class _PlanningFile(NamedTuple):
    """A file whose headers are read and sound.

    Attributes:
        path: the file.
        splits: the splits that it holds.
        actions: number of actions of its policies, 4 or 8.
        fields: names of the arrays of distance fields, which only iA* writes.
    """

    path: Path
    splits: list[_Split]
    actions: int
    fields: list[str]

    @property
    def movement(self) -> Movement:
        """The movement of its policies: 4-connected, or 8-connected with cut corners."""
        return Movement(4) if self.actions == 4 else NEURAL_ASTAR


def read(source: Path, limits: Limits = LIMITS) -> Collection:
    """Read the maps, goals and splits of an .npz, or of all below a folder; check their distances.

    The goal becomes the first seed point of its map. The movement is that of the policies, which
    have 4 or 8 actions.

    Raises:
        FormatError: ``source`` is no such file. In a folder such files are left out, as are maps
            with a bad goal, and files with another number of actions than the first file.
    """
    collection = Collection()
    first_actions: int | None = None
    equal_distances = 0
    moved_goals = 0
    for path in files_with_endings(source, (".npz",), limits, collection):
        # If the user named this file, its error is raised and not only noted.
        with nullcontext() if path == source else collection.leaving_out(path):
            file = _open(path, limits)
            if first_actions not in (None, file.actions):
                raise FormatError(
                    f"{path}: has {file.actions} actions, the files before it {first_actions}: "
                    "import it by itself"
                )
            for foreign_map, distances in _read_maps(file, limits, collection):
                collection.maps.append(foreign_map)
                goal = foreign_map.seed_points[0]
                our_distances = negative_distances(foreign_map.grid, goal, file.movement)
                equal_distances += np.array_equal(our_distances, distances)
                moved_goals += distances[tuple(goal)] != 0
                del distances  # before the next ones are read
            first_actions = file.actions
            collection.movement = file.movement
            if file.fields:
                fields = ", ".join(file.fields)
                collection.notes.append(f"a distance field of each map ({fields}) is left out")
    collection.notes.append(
        f"distances of {equal_distances} of {len(collection.maps)} maps are what our search finds"
    )
    if moved_goals:
        collection.notes.append(
            f"distances of {moved_goals} maps lead to another cell than the goal of their map, "
            "which is kept"
        )
    return collection


def _open(path: Path, limits: Limits) -> _PlanningFile:
    """Return the arrays of a file, unread, after checking their names and shapes.

    Raises:
        FormatError: a file of another layout, or larger than the limits allow.
    """
    archive = Npz(path, limits.unpacked)
    shapes = archive.shapes
    count = sum(re.fullmatch("arr_[0-9]+", name) is not None for name in shapes)
    if count in (3, 6, 9) and len(shapes.get("arr_5", ())) == 5:
        raise FormatError(
            f"{path}: holds {count} arrays, three a split as gated-path-planning-networks writes "
            "them; expected four, the last of them distances"
        )
    arrays_per_split = 5 if count % 5 == 0 else 4
    names_by_split: dict[str, list[str]] = {}
    for code, split in enumerate(SPLITS):
        first = arrays_per_split * code
        names = [f"arr_{number}" for number in range(first, first + arrays_per_split)]
        if any(name in shapes for name in names):
            names_by_split[split] = names
    if not names_by_split:
        raise FormatError(f"{path}: holds arrays {', '.join(shapes)}, expected arr_0 to arr_11")
    archive.require(*chain(*names_by_split.values()))
    actions = _check_shapes(path, shapes, list(names_by_split.values()))
    # The arrays are opened at once, since the limit holds for all of them together. Policies, the
    # largest arrays, are not read and do not count.
    names_to_read = [
        name
        for maps, goals, _, distances, *_ in names_by_split.values()
        for name in (maps, goals, distances)
    ]
    arrays = dict(zip(names_to_read, archive.arrays(*names_to_read), strict=True))
    splits = [
        _Split(split, arrays[maps], arrays[goals], arrays[distances])
        for split, (maps, goals, _, distances, *_) in names_by_split.items()
    ]
    fields = [name for names in names_by_split.values() for name in names[4:]]
    return _PlanningFile(path, splits, actions, fields)


def _check_shapes(
    path: Path, shapes: dict[str, tuple[int, ...]], names_by_split: list[list[str]]
) -> int:
    """Return the number of actions of a file, after checking that all its shapes fit together.

    Args:
        path: named in errors.
        shapes: of all arrays, by name.
        names_by_split: the names of each split's arrays: maps, goals, policies, distances, and
            perhaps distance fields.

    Raises:
        FormatError: shapes that do not fit; the message names the array.
    """
    _, _, first_policies, *_ = names_by_split[0]
    first_shape = shapes[first_policies]
    has_four_actions = len(first_shape) == 5 and first_shape[1] == 4
    actions = 4 if has_four_actions else 8
    for maps, goals, policies, distances, *fields in names_by_split:
        map_shape = shapes[maps]
        if len(map_shape) != 3:
            raise FormatError(f"{path}: {maps} has shape {map_shape}, expected (N, H, W)")
        count, rows, columns = map_shape
        policy_shape = shapes[policies]
        if policy_shape != (count, actions, 1, rows, columns):
            raise FormatError(
                f"{path}: {policies} has shape {policy_shape}, expected "
                f"{(count, actions, 1, rows, columns)}: 8 actions, or "
                "4 without diagonals, as in all splits"
            )
        expected_shapes: dict[str, tuple[int, ...]] = {
            goals: (count, 1, rows, columns),
            distances: (count, 1, rows, columns),
            **dict.fromkeys(fields, map_shape),
        }
        for name, expected in expected_shapes.items():
            if shapes[name] != expected:
                raise FormatError(f"{path}: {name} has shape {shapes[name]}, expected {expected}")
    return actions


def _read_maps(
    file: _PlanningFile, limits: Limits, collection: Collection
) -> Iterator[tuple[ForeignMap, Array]]:
    """Yield the maps of a file with their distances, (H, W); the goal is the seed point of a map.

    Maps with a bad goal are added to what ``collection`` leaves out. The whole file is checked
    before the first map is yielded, so that a damaged file gives no map.
    """
    for split in file.splits:
        check_grids(split.maps, limits)
        split.goals.check()
        split.distances.check()
    for split in file.splits:
        # Unlike a loop, `map` keeps no entry while the next one is read: a map may be large.
        goals = map(_goal_cell, split.goals.entries())
        stated_distances = split.distances.entries()
        bad_goals = []
        for number, (is_free, goal) in enumerate(zip(read_grids(split.maps), goals, strict=True)):
            grid = 1 - is_free
            if goal is None or grid[goal] != 0:
                bad_goals.append(number)
                next(stated_distances)
                continue
            foreign_map = ForeignMap(
                f"{file.path}: {split.name} {number}",
                grid,
                SPLITS.index(split.name),
                seed_points=np.array([goal], np.int64),
            )
            yield foreign_map, next(stated_distances)[0]
        if bad_goals:
            name = joint_name(f"{file.path}: {split.name}", bad_goals)
            collection.left_out.append((name, "its goal is not one free cell"))


def _goal_cell(mask: Array) -> Cell | None:
    """Return the cell that a mask, (1, H, W), marks; None if it is not one cell."""
    return marked_cell(mask[0])


def negative_distances(grid: Bytes, goal: object, movement: Movement = NEURAL_ASTAR) -> Float32s:
    """Return minus the number of moves to ``goal`` from each cell, (H, W) float32.

    Args:
        grid: (H, W).
        goal: (row, col), a free cell.
        movement: with or without diagonals, all moves of the same cost.

    Returns:
        -H W for cells without a path to the goal.
    """
    distance = distance_field(grid, goal, movement)
    # The goal gets 0 - 0 = 0; with -distance it would get -0.
    return np.where(distance < 0, np.float32(-grid.size), 0 - distance)


def policy(distances: Float32s) -> Bytes:
    """Return the first optimal action in each cell, (8, H, W) uint8 one-hot.

    Args:
        distances: (H, W), those of `negative_distances`.
    """
    rows, columns = distances.shape
    padded = np.pad(distances, 1, constant_values=-np.inf)
    # The map is shifted by the step of each action: each cell then holds its neighbour's distance.
    neighbours = [
        padded[1 + step_row : 1 + step_row + rows, 1 + step_column : 1 + step_column + columns]
        for step_row, step_column in ACTIONS
    ]
    best_actions = np.argmax(np.stack(neighbours), axis=0)
    actions = np.arange(len(ACTIONS))[:, None, None]
    return np.asarray(best_actions == actions, np.uint8)


def start_candidates(distances: Float32s) -> list[Ints]:
    """Return the cells (n, 2) that neural-astar's loader draws from in each of its three intervals.

    Args:
        distances: (H, W), those of `negative_distances`.

    Returns:
        An empty list if an interval has no cell, since the loader fails on such a map.
    """
    reachable = distances[distances > distances.min()]  # the minimum stands for no path
    if len(reachable) < 2:
        return []  # only the goal itself
    # Distances are negative, so cells that are far away have low percentiles.
    bounds = np.percentile(reachable, 100.0 * (1 - np.array(PERCENTILES)))
    candidates = [
        np.argwhere((low <= distances) & (distances <= high)) for high, low in pairwise(bounds)
    ]
    if any(len(cells) == 0 for cells in candidates):
        return []
    return candidates


def problems(source: Path, limits: Limits = LIMITS, *, seed: int = 0) -> ProblemSet:
    """Return the problems of the test split, to compare planners on.

    The goals are those of the file. The loader draws a start in one of its three intervals; here
    each map has a problem for each of the three, so that means over problems have the same
    expectation.

    Args:
        source: the .npz file.
        limits: of what is read.
        seed: of the draws of the starts.

    Raises:
        FormatError: no such file, or no problem in it.
    """
    file = _open(source, limits)
    grids = []
    starts = []
    goals = []
    for number, (foreign_map, distances) in enumerate(_read_maps(file, limits, Collection())):
        if foreign_map.split != SPLITS.index("test"):
            continue
        random_words = block(np.uint64(check_seed(seed)), np.uint64(number), 0, PROBLEM, 0)
        # A block has four words, and there are three intervals.
        for cells, word in zip(start_candidates(distances), random_words, strict=False):
            grids.append(foreign_map.grid)
            starts.append(cells[bounded(word, 0, len(cells) - 1)])
            goals.append(foreign_map.seed_points[0])
    if not grids:
        raise FormatError(f"{source}: has no map of a test split with a problem")
    description = f"{len(grids)} problems of {source}, starts by seed {seed}"
    return ProblemSet(
        np.array(grids), np.array(starts), np.array(goals), file.movement, description
    )


def write(target: Path, root: Root, progress: bool) -> list[str]:
    """Write an .npz that neural-astar's ``create_dataloader`` reads.

    The goal is the first seed point of each map. Maps and actions are uint8, distances float32 (the
    loader converts).

    Args:
        target: file.
        root: dataset.
        progress: show a progress bar.

    Returns:
        Notes for the user.

    Raises:
        FormatError: a split without maps.
    """
    arrays_per_split = 4
    counts = [0] * len(SPLITS)
    with ExitStack() as stack:
        # All arrays may not fit in memory, and their headers state the number of maps, which is
        # known at the end. So the arrays are collected in temporary files.
        parts = [
            stack.enter_context(TemporaryFile(dir=target.parent))
            for _ in range(arrays_per_split * len(SPLITS))
        ]
        for labels in root.labels(progress=progress):
            maps = labels.maps
            goals = maps.seed_points[:, 0]
            for grid, goal, code in zip(maps.occupancy, goals, maps.split, strict=True):
                distances = negative_distances(grid, goal)
                if not start_candidates(distances):
                    continue
                counts[code] += 1
                arrays = _arrays_of_map(grid, goal, distances)
                for position, array in enumerate(arrays):
                    parts[arrays_per_split * code + position].write(array.tobytes())
        if 0 in counts:
            empty_split = SPLITS[counts.index(0)]
            raise FormatError(
                f"the split {empty_split!r} has no usable map, neural-astar's loader needs one"
            )
        with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=3) as archive:
            for number, part in enumerate(parts):
                code, position = divmod(number, arrays_per_split)
                array = arrays[position]  # of the last map, for the shape and dtype of all
                header = {
                    "descr": array.dtype.str,
                    "fortran_order": False,
                    "shape": (counts[code], *array.shape),
                }
                # A member opened by its name gets the earliest date of a zip, not today's, so that
                # equal datasets give equal files.
                with archive.open(f"arr_{number}.npy", "w", force_zip64=True) as member:
                    write_array_header_1_0(member, header)
                    part.seek(0)
                    shutil.copyfileobj(part, member)
    left_out = root.maps - sum(counts)
    if left_out:
        return [f"{left_out} maps are left out: the loader finds no start on them"]
    return []


def _arrays_of_map(grid: Bytes, goal: Array, distances: Float32s) -> tuple[Array, ...]:
    """Return the four arrays of a map, as in the table of this module, without the axis N.

    Args:
        grid: (H, W).
        goal: (2,), (row, col).
        distances: (H, W), those of `negative_distances`.
    """
    goal_mask = np.zeros((1, *grid.shape), np.uint8)
    goal_mask[(0, *goal)] = 1
    return 1 - grid, goal_mask, policy(distances)[:, None], distances[None]


FORMAT = Format(
    "planning-datasets", (".npz",), read, write, problems, is_planning, target_ending=".npz"
)
