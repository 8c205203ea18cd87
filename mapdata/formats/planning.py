"""Problems of planning-datasets and Neural A*: an .npz with arr_0 to arr_11, in and out.

Source: https://github.com/omron-sinicx/planning-datasets (generate_spp_instances.py) and the loader in
https://github.com/omron-sinicx/neural-astar (src/neural_astar/utils/data.py).

arr_0 to arr_3 are the training split, arr_4 to arr_7 validation, arr_8 to arr_11 test. For N maps of one size:

| array | shape | values |
|---|---|---|
| first | (N, H, W) | the map: 1 free, 0 occupied (the other way round than here) |
| second | (N, 1, H, W) | the goal: 1 in one cell |
| third | (N, 8, 1, H, W) | an optimal action in each cell, 1 in one of N E W S NE NW SE SW |
| fourth | (N, 1, H, W) | minus the moves to the goal; the least value, -H W, is blocked or unreachable |

A move to any of the 8 neighbours counts 1, corners may be cut. The loader draws a start between the percentiles of the
distances; where no cell lies there it fails, so such maps are left out of an export.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from mapdata.formats.files import LIMITS, FormatError, Limits, Npz, occupancy
from mapdata.formats.stored import Stored
from mapdata.imported import Collection, ForeignMap
from mapdata.search import distance_field
from mapdata.spec import SPLITS, Movement

MOVEMENT = Movement(8, corner_cutting=True, diagonal_cost=1)
"""Unrestricted diagonals, hops."""

ACTIONS = ((-1, 0), (0, 1), (0, -1), (1, 0), (-1, 1), (-1, -1), (1, 1), (1, -1))
"""Step (row, col) of each action."""

PERCENTILES = (0.55, 0.70, 0.85, 1.0)
"""Between these the loader draws a start."""

Array = npt.NDArray[Any]


def is_planning(path: Path, limits: Limits = LIMITS) -> bool:
    """Return whether ``path`` is an .npz of this kind, by its names and shapes."""
    if path.suffix.lower() != ".npz" or not path.is_file():
        return False
    try:
        shapes = Npz(path, limits).shapes
    except FormatError:
        return False
    return {f"arr_{k}" for k in range(4)} <= set(shapes) and len(shapes["arr_2"]) == 5


def read(source: Path, limits: Limits = LIMITS) -> Collection:
    """Read an .npz: maps, goals (the first seed point of each map) and splits; check its distances.

    Raises:
        FormatError: not such a file. A map with a bad goal is left out.
    """
    archive = Npz(source, limits)
    found = Collection(movement=MOVEMENT)
    wrong = checked = 0
    for code, split in enumerate(SPLITS):
        names = [f"arr_{4 * code + k}" for k in range(4)]
        if not any(name in archive.shapes for name in names):
            continue
        free = archive[names[0]]
        if free.ndim == 4 and free.shape[1] == 1:
            free = free[:, 0]
        if free.ndim != 3:
            raise FormatError(f"{source}: {names[0]} has shape {free.shape}, expected (N, H, W)")
        grids = 1 - occupancy(free, f"{source}: {names[0]}")
        one_each = (len(grids), 1, *grids.shape[1:])
        goals, distances = archive[names[1]], archive[names[3]]
        for name, array in ((names[1], goals), (names[3], distances)):
            if array.shape != one_each:
                raise FormatError(f"{source}: {name} has shape {array.shape}, expected {one_each}")
        for k, grid in enumerate(grids):
            name = f"{source}: {split} {k}"
            cells = np.argwhere(goals[k, 0] == 1)
            if len(cells) != 1 or np.count_nonzero(goals[k]) != 1 or grid[tuple(cells[0])]:
                found.left_out.append((name, "its goal is not one free cell"))
                continue
            checked += 1
            wrong += not np.array_equal(hops(grid, cells[0].tolist()), distances[k, 0])
            found.maps.append(ForeignMap(name, grid, code, seeds=cells.astype(np.int64)))
    if not found.maps and not found.left_out:
        raise FormatError(f"{source}: holds no maps")
    found.notes.append(f"distances of {checked - wrong} of {checked} maps are what our search finds")
    return found


def hops(grid: npt.NDArray[np.uint8], goal: object) -> npt.NDArray[np.float32]:
    """Return minus the moves to ``goal`` from each cell, (H, W) float32; -H W where there is no way."""
    distance = distance_field(grid, goal, MOVEMENT)
    return np.where(distance < 0, np.float32(-grid.size), 0 - distance)


def policy(values: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """Return the first best action in each cell, (8, H, W) one-hot, for `hops` (H, W)."""
    rows, columns = values.shape
    padded = np.pad(values, 1, constant_values=-np.inf)
    neighbours = [padded[1 + down : 1 + down + rows, 1 + right : 1 + right + columns] for down, right in ACTIONS]
    best = np.argmax(np.stack(neighbours), axis=0)
    return np.asarray(best == np.arange(8)[:, None, None], np.uint8)


def has_starts(values: npt.NDArray[np.float32]) -> bool:
    """Return whether neural-astar's loader can draw a start: some cell lies in each of its three intervals."""
    cells = values[values > values.min()]
    if len(cells) < 2:  # only the goal itself
        return False
    bounds = np.percentile(cells, 100.0 * (1 - np.array(PERCENTILES)))
    return all(bool(((cells >= bounds[k + 1]) & (cells <= bounds[k])).any()) for k in range(3))


def write(target: Path, source: Stored) -> list[str]:
    """Write an .npz that neural-astar's ``create_dataloader`` reads; the goal is the first seed point of each map.

    The arrays go to disk a shard at a time; maps and actions are uint8, distances float32 (the loader converts).

    Returns:
        Notes for the user.

    Raises:
        FormatError: a split without maps, or a name that does not end with .npz.
    """
    if target.suffix != ".npz":
        raise FormatError(f"{target}: expected a name that ends with .npz")
    kept = [[_keep(batch, code) for batch in _grids(source)] for code in range(len(SPLITS))]
    counts = [sum(int(mask.sum()) for mask in masks) for masks in kept]
    if 0 in counts:
        raise FormatError(f"{target}: the split {SPLITS[counts.index(0)]!r} has no usable map, its loader needs one")
    rows, columns = source.manifest.map_size
    kinds: tuple[tuple[tuple[int, ...], str, Callable[..., Array]], ...] = (
        ((rows, columns), "u1", lambda grid, goal: 1 - grid),
        ((1, rows, columns), "u1", _one_hot),
        ((8, 1, rows, columns), "u1", lambda grid, goal: policy(hops(grid, goal))[:, None]),
        ((1, rows, columns), "<f4", lambda grid, goal: hops(grid, goal)[None]),
    )
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=3) as archive:
        for code, (count, masks) in enumerate(zip(counts, kept, strict=True)):
            for k, (shape, dtype, make) in enumerate(kinds):
                info = zipfile.ZipInfo(f"arr_{4 * code + k}.npy")  # its date is fixed: equal content, equal bytes
                info.compress_type = zipfile.ZIP_DEFLATED
                with archive.open(info, "w", force_zip64=True) as member:
                    head = BytesIO()
                    np.lib.format.write_array_header_1_0(
                        head, {"descr": np.dtype(dtype).str, "fortran_order": False, "shape": (count, *shape)}
                    )
                    member.write(head.getvalue())
                    for (grids, goals, _), mask in zip(_grids(source), masks, strict=True):
                        for grid, goal in zip(grids[mask], goals[mask].tolist(), strict=True):
                            member.write(np.ascontiguousarray(make(grid, goal), dtype).tobytes())
    left = source.manifest.maps - sum(counts)
    return [f"{left} maps are left out: the loader finds no start on them"] if left else []


def _grids(source: Stored) -> Iterator[tuple[npt.NDArray[np.uint8], npt.NDArray[np.int64], npt.NDArray[np.uint8]]]:
    """Yield grids, goals and splits of each shard."""
    for labels in source.batches():
        yield labels.maps.occupancy, labels.maps.seeds[:, 0], labels.maps.split


def _keep(
    batch: tuple[npt.NDArray[np.uint8], npt.NDArray[np.int64], npt.NDArray[np.uint8]], code: int
) -> npt.NDArray[np.bool_]:
    """Return which maps of a shard belong to a split and have starts."""
    grids, goals, splits = batch
    mask = splits == code
    for k in np.flatnonzero(mask).tolist():
        mask[k] = has_starts(hops(grids[k], goals[k].tolist()))
    return np.asarray(mask, np.bool_)


def _one_hot(grid: npt.NDArray[np.uint8], goal: tuple[int, int]) -> npt.NDArray[np.uint8]:
    out = np.zeros((1, *grid.shape), np.uint8)
    out[0, goal[0], goal[1]] = 1
    return out
