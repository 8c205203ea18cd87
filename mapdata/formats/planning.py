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
| fourth | (N, 1, H, W) | minus the moves to the goal; the least, -H W, is blocked or unreachable |

A move to any of the 8 neighbours counts 1, corners may be cut. The loader draws a start between the
percentiles of the distances; where no cell lies there it fails, so such maps are left out of an
export.

Two other layouts are read, both of iA*, https://github.com/sair-lab/iAstar. Where the third array
is (N, 4, 1, H, W), paths have no diagonals and the actions are N E W S. A file of 15 arrays has
five a split; the fifth, (N, H, W), is a distance field, which is left out.
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
from mapdata.formats.files import LIMITS, Limits, check_grids, files_of, grids_of, several
from mapdata.formats.registry import Format
from mapdata.limits import SPLITS
from mapdata.movement import NEURAL_ASTAR, Movement
from mapdata.npy import FormatError, Npz, StoredArray
from mapdata.problems.problem_set import ProblemSet
from mapdata.rng import PROBLEM, block, bounded
from mapdata.search.api import distance_field
from mapdata.shards.root import Root

ACTIONS = ((-1, 0), (0, 1), (0, -1), (1, 0), (-1, 1), (-1, -1), (1, 1), (1, -1))
"""Step (row, col) of each action."""

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
    """The arrays of a split, unread, for N maps of (H, W).

    Attributes:
        name: of the split.
        maps: (N, H, W), 1 free and 0 occupied.
        goals: (N, 1, H, W), 1 in one cell.
        distances: (N, 1, H, W).
    """

    name: str
    maps: StoredArray
    goals: StoredArray
    distances: StoredArray


class _File(NamedTuple):
    """What the headers of a file say.

    Attributes:
        path: the file.
        splits: those that it has.
        actions: 4 or 8.
        fields: names of the arrays that hold a distance field of each map, where it has some.
    """

    path: Path
    splits: list[_Split]
    actions: int
    fields: list[str]

    @property
    def movement(self) -> Movement:
        """The rule of its policies: without diagonals, or with all of them."""
        return Movement(4) if self.actions == 4 else NEURAL_ASTAR


def read(source: Path, limits: Limits = LIMITS) -> Collection:
    """Read the maps, goals and splits of an .npz, or of all below a folder; check their distances.

    The goal becomes the first seed point of its map. The movement is that of the policies, which
    have 4 or 8 actions.

    Raises:
        FormatError: ``source`` is no such file. In a folder it is left out, as are maps with a bad
            goal, and files with another number of actions than the first one.
    """
    found = Collection()
    actions = 0
    same = 0
    elsewhere = 0
    for path in files_of(source, (".npz",), limits, found):
        # a file that was asked for by name is not left out: its error is the answer
        with nullcontext() if path == source else found.leaving_out(path):
            file = _open(path, limits)
            if actions not in (0, file.actions):
                raise FormatError(
                    f"{path}: has {file.actions} actions, the files before it {actions}: import "
                    "it by itself"
                )
            for foreign_map, distances in _problems(file, limits, found):
                found.maps.append(foreign_map)
                goal = foreign_map.seed_points[0]
                same += np.array_equal(hops(foreign_map.grid, goal, file.movement), distances)
                elsewhere += distances[tuple(goal)] != 0
            actions = file.actions
            found.movement = file.movement
            if file.fields:
                fields = ", ".join(file.fields)
                found.notes.append(f"a distance field of each map ({fields}) is left out")
    found.notes.append(f"distances of {same} of {len(found.maps)} maps are what our search finds")
    if elsewhere:
        found.notes.append(
            f"distances of {elsewhere} maps lead to another cell than the goal of their map, which "
            "is kept"
        )
    return found


def _open(path: Path, limits: Limits) -> _File:
    """Return the arrays of a file after a look at their names and shapes.

    Raises:
        FormatError: another file, or one that is larger than the limits allow.
    """
    archive = Npz(path, limits.unpacked)
    shapes = archive.shapes
    count = sum(re.fullmatch("arr_[0-9]+", name) is not None for name in shapes)
    if count == 0:
        raise FormatError(f"{path}: holds arrays {', '.join(shapes)}, expected arr_0 to arr_11")
    if count in (3, 6, 9) and len(shapes.get("arr_5", ())) == 5:
        raise FormatError(
            f"{path}: holds {count} arrays, three a split as gated-path-planning-networks writes "
            "them; expected four, the last of them distances"
        )
    per_split = 5 if count % 5 == 0 else 4
    names: dict[str, list[str]] = {}
    for code, split in enumerate(SPLITS):
        of_split = [f"arr_{per_split * code + k}" for k in range(per_split)]
        if not shapes.keys().isdisjoint(of_split):
            names[split] = of_split
    archive.require(*chain(*names.values()))
    actions = _check_shapes(path, shapes, names)
    # Policies are not read, and do not count for the limit: they are larger than all the rest.
    arrays = archive.arrays(*(names[split][k] for split in names for k in (0, 1, 3)))
    splits = [_Split(split, *arrays[3 * k : 3 * k + 3]) for k, split in enumerate(names)]
    return _File(
        path, splits, actions, [name for of_split in names.values() for name in of_split[4:]]
    )


def _check_shapes(
    path: Path, shapes: dict[str, tuple[int, ...]], names: dict[str, list[str]]
) -> int:
    """Return the number of actions of a file, if all its shapes fit together.

    Args:
        path: named in errors.
        shapes: of all arrays, by name.
        names: of the arrays of each split, in their order.

    Raises:
        FormatError: they do not; the message says which.
    """
    actions = 0
    for of_maps, of_goals, of_policies, of_distances, *fields in names.values():
        shape = shapes[of_maps]
        if len(shape) != 3:
            raise FormatError(f"{path}: {of_maps} has shape {shape}, expected (N, H, W)")
        count, rows, columns = shape
        policies = shapes[of_policies]
        if not actions:
            actions = policies[1] if len(policies) == 5 else 0
        if actions not in (4, 8) or policies != (count, actions, 1, rows, columns):
            raise FormatError(
                f"{path}: {of_policies} has shape {policies}, expected "
                f"{(count, actions if actions in (4, 8) else 8, 1, rows, columns)}: 8 actions, or "
                "4 without diagonals, as in all splits"
            )
        expected: dict[str, tuple[int, ...]] = dict.fromkeys(fields, shape)
        expected[of_goals] = expected[of_distances] = (count, 1, rows, columns)
        for name, wanted in expected.items():
            if shapes[name] != wanted:
                raise FormatError(f"{path}: {name} has shape {shapes[name]}, expected {wanted}")
    return actions


def _problems(file: _File, limits: Limits, found: Collection) -> Iterator[tuple[ForeignMap, Array]]:
    """Yield the maps of a file with their distances, (H, W); bad ones go to ``found.left_out``.

    All of it is looked at before the first map is yielded: a damaged file gives no map.
    """
    for split in file.splits:
        check_grids(split.maps, limits)
        split.goals.check()
        split.distances.check()
    for split in file.splits:
        arrays = (grids_of(split.maps), split.goals.entries(), split.distances.entries())
        bad_goals = []
        for k, (free, goal, distances) in enumerate(zip(*arrays, strict=True)):
            grid = 1 - free
            cells = np.argwhere(goal[0])
            if len(cells) != 1 or goal[0][tuple(cells[0])] != 1 or grid[tuple(cells[0])]:
                bad_goals.append(k)
                continue
            foreign_map = ForeignMap(
                f"{file.path}: {split.name} {k}",
                grid,
                SPLITS.index(split.name),
                seed_points=cells.astype(np.int64),
            )
            yield foreign_map, distances[0]
        if bad_goals:
            name = several(f"{file.path}: {split.name}", bad_goals)
            found.left_out.append((name, "its goal is not one free cell"))


def hops(grid: Bytes, goal: object, movement: Movement = NEURAL_ASTAR) -> Float32s:
    """Return minus the moves to ``goal`` from each cell, (H, W) float32; -H W without a path.

    Args:
        grid: (H, W).
        goal: (row, col), a free cell.
        movement: with or without diagonals, all moves of the same cost.
    """
    distance = distance_field(grid, goal, movement)
    # 0 - distance rather than -distance: the goal is 0, not -0, in the file
    return np.where(distance < 0, np.float32(-grid.size), 0 - distance)


def policy(values: Float32s) -> Bytes:
    """Return the first best action in each cell, (8, H, W) one-hot, for `hops` (H, W)."""
    rows, columns = values.shape
    padded = np.pad(values, 1, constant_values=-np.inf)
    # the map moved by one step: in each cell stands the value of its neighbour
    neighbours = [padded[1 + r : 1 + r + rows, 1 + c : 1 + c + columns] for r, c in ACTIONS]
    best = np.argmax(np.stack(neighbours), axis=0)
    return np.asarray(best == np.arange(8)[:, None, None], np.uint8)


def starts_of(values: Float32s) -> list[Ints]:
    """Return the cells (n, 2) that neural-astar's loader draws from in each of its three intervals.

    There are none where one of them has no cell, on which the loader fails.
    """
    cells = values[values > values.min()]  # the least value stands for no path
    if len(cells) < 2:
        return []  # only the goal itself
    # values are negative distances, so far cells have low percentiles
    bounds = np.percentile(cells, 100.0 * (1 - np.array(PERCENTILES)))
    starts = [np.argwhere((low <= values) & (values <= high)) for high, low in pairwise(bounds)]
    return starts if all(map(len, starts)) else []


def problems(source: Path, limits: Limits = LIMITS, *, seed: int = 0) -> ProblemSet:
    """Return the problems of the test split, to compare planners on.

    The goals are the file's. The loader draws a start in one of its three intervals; here a map has
    a problem for each of the three, which comes to the same in the mean.

    Args:
        source: the .npz file.
        limits: of what is read.
        seed: of the starts.

    Raises:
        FormatError: no such file, or no problem in it.
    """
    file = _open(source, limits)
    found = []
    for k, (one, values) in enumerate(_problems(file, limits, Collection())):
        if one.split == SPLITS.index("test"):
            words = block(np.uint64(check_seed(seed)), np.uint64(k), 0, PROBLEM, 0)
            for cells, word in zip(starts_of(values), words, strict=False):  # three of four words
                start = cells[bounded(word, 0, len(cells) - 1)]
                found.append((one.grid, start, one.seed_points[0]))
    if not found:
        raise FormatError(f"{source}: has no map of a test split with a problem")
    grids, starts, goals = map(np.array, zip(*found, strict=True))
    text = f"{len(found)} problems of {source}, starts by seed {seed}"
    return ProblemSet(grids, starts, goals, file.movement, text)


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
    counts = [0] * len(SPLITS)
    with ExitStack() as stack:
        # The arrays wait in files, since no memory may hold them, and their headers are not known
        # before all maps are counted.
        parts = [
            stack.enter_context(TemporaryFile(dir=target.parent)) for _ in range(4 * len(SPLITS))
        ]
        for labels in root.labels(progress=progress):
            maps = labels.maps
            goals = maps.seed_points[:, 0]
            for grid, goal, code in zip(maps.occupancy, goals, maps.split, strict=True):
                arrays = _arrays(grid, goal)
                if starts_of(arrays[3]):
                    counts[code] += 1
                    for k, array in enumerate(arrays):
                        parts[4 * code + k].write(array.tobytes())
        if 0 in counts:
            missing = SPLITS[counts.index(0)]
            raise FormatError(
                f"the split {missing!r} has no usable map, neural-astar's loader needs one"
            )
        with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=3) as archive:
            for number, part in enumerate(parts):
                code, k = divmod(number, 4)
                shape = (counts[code], *arrays[k].shape)
                header = {"descr": arrays[k].dtype.str, "fortran_order": False, "shape": shape}
                # its date is always that of the first zip: equal content gives equal bytes
                with archive.open(f"arr_{number}.npy", "w", force_zip64=True) as member:
                    write_array_header_1_0(member, header)
                    part.seek(0)
                    shutil.copyfileobj(part, member)
    left = root.maps - sum(counts)
    return [f"{left} maps are left out: the loader finds no start on them"] if left else []


def _arrays(grid: Bytes, goal: Array) -> tuple[Array, ...]:
    """Return the four arrays of a map, as the table above has them, without their axis N."""
    values = hops(grid, goal)
    goals = np.zeros((1, *grid.shape), np.uint8)
    goals[(0, *goal)] = 1
    return 1 - grid, goals, policy(values)[:, None], values[None]


FORMAT = Format(
    "planning-datasets", (".npz",), read, write, problems, is_planning, target_ending=".npz"
)
