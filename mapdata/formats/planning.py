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
"""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack, nullcontext
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np
from numpy.lib.format import write_array_header_1_0

from mapdata.arrays import Array, Bytes, Float32s, Ints
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import LIMITS, FormatError, Limits, Npz, files_of, occupancy
from mapdata.formats.registry import Format
from mapdata.problems.problem_set import Problems
from mapdata.rng import PROBLEM, block, bounded
from mapdata.search.api import distance_field
from mapdata.shards.root import Root
from mapdata.spec import NEURAL_ASTAR, SPLITS, check_seed

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


def read(source: Path, limits: Limits = LIMITS) -> Collection:
    """Read the maps, goals and splits of an .npz, or of all below a folder; check their distances.

    The goal becomes the first seed point of its map.

    Raises:
        FormatError: ``source`` is no such file. In a folder it is left out, as are maps with a bad
            goal.
    """
    found = Collection(movement=NEURAL_ASTAR)
    same = 0
    for path in files_of(source, (".npz",), limits, found):
        # a file that was asked for by name is not left out: its error is the answer
        with nullcontext() if path == source else found.leaving_out(path):
            for one, distances in _problems(path, limits, found):
                found.maps.append(one)
                same += np.array_equal(hops(one.grid, one.seed_points[0]), distances)
    found.notes.append(f"distances of {same} of {len(found.maps)} maps are what our search finds")
    return found


def _problems(path: Path, limits: Limits, found: Collection) -> Iterator[tuple[ForeignMap, Array]]:
    """Yield the maps of a file with their distances, (H, W); bad ones go to ``found.left_out``."""
    archive = Npz(path, limits)
    all_names = [f"arr_{number}" for number in range(4 * len(SPLITS))]
    present = archive.shapes.keys()
    if present.isdisjoint(all_names):
        raise FormatError(
            f"{path}: holds arrays {', '.join(archive.shapes)}, expected arr_0 to arr_11"
        )
    for code, split in enumerate(SPLITS):
        names = all_names[4 * code : 4 * code + 4]
        if present.isdisjoint(names):
            continue
        of_maps, of_goals, _, of_distances = names  # the actions follow from the distances
        free = archive[of_maps]
        if free.ndim != 3:
            raise FormatError(f"{path}: {of_maps} has shape {free.shape}, expected (N, H, W)")
        grids = 1 - occupancy(free, f"{path}: {of_maps}")
        goals = archive[of_goals]
        distances = archive[of_distances]
        expected = (len(grids), 1, *grids.shape[1:])
        for name, array in ((of_goals, goals), (of_distances, distances)):
            if array.shape != expected:
                raise FormatError(f"{path}: {name} has shape {array.shape}, expected {expected}")
        for k, grid in enumerate(grids):
            name = f"{path}: {split} {k}"
            cells = np.argwhere(goals[k, 0] == 1)
            if len(cells) != 1 or np.count_nonzero(goals[k]) != 1 or grid[tuple(cells[0])]:
                found.left_out.append((name, "its goal is not one free cell"))
                continue
            yield ForeignMap(name, grid, code, seed_points=cells.astype(np.int64)), distances[k, 0]


def hops(grid: Bytes, goal: object) -> Float32s:
    """Return minus the moves to ``goal`` from each cell, (H, W) float32; -H W without a path."""
    distance = distance_field(grid, goal, NEURAL_ASTAR)
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


def problems(source: Path, limits: Limits = LIMITS, *, seed: int = 0) -> Problems:
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
    found = []
    for k, (one, values) in enumerate(_problems(source, limits, Collection())):
        if one.split == SPLITS.index("test"):
            words = block(np.uint64(check_seed(seed)), np.uint64(k), 0, PROBLEM, 0)
            for cells, word in zip(starts_of(values), words, strict=False):  # three of four words
                start = cells[bounded(word, 0, len(cells) - 1)]
                found.append((one.grid, start, one.seed_points[0]))
    if not found:
        raise FormatError(f"{source}: has no map of a test split with a problem")
    grids, starts, goals = map(np.array, zip(*found, strict=True))
    text = f"{len(found)} problems of {source}, starts by seed {seed}"
    return Problems(grids, starts, goals, NEURAL_ASTAR, text)


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
