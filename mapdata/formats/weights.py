"""Weights of cells, as other repositories store them in floats, as terrain: whole numbers."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mapdata.arrays import Array, Bytes
from mapdata.formats.collection import ForeignMap
from mapdata.formats.files import Limits, sampling_step
from mapdata.limits import MAX_CELL_COST, SPLITS, Cell
from mapdata.movement import Movement
from mapdata.npy import FormatError, StoredArray
from mapdata.problems.problem_set import ProblemSet

UNIT = 0.1
"""The weight that becomes a cost of 1: published sets have weights such as 0.8 and 9.2."""


_BLOCK_CELLS = 2**18
"""Number of cells whose weights are converted at once."""


def check_unit(unit: float) -> float:
    """Return a unit of weights.

    Raises:
        ValueError: not a finite number above 0.
    """
    if isinstance(unit, bool) or not isinstance(unit, (int, float)):
        raise ValueError(f"unit: got {unit!r}, expected a number")
    if not 0 < unit < math.inf:
        raise ValueError(f"unit: got {unit}, expected a finite number above 0")
    return float(unit)


def check_weights(array: StoredArray, limits: Limits) -> None:
    """Check the shape of an array of weights.

    Raises:
        FormatError: another shape than (N, H, W), or more than the limits allow.
    """
    shape = array.shape
    if len(shape) != 3 or 0 in shape:
        raise FormatError(f"{array.label}: has shape {shape}, expected (N, H, W), none of them 0")
    count, rows, columns = shape
    if rows * columns > limits.pixels:
        raise FormatError(
            f"{array.label}: has {rows} x {columns} cells, expected at most {limits.pixels} in "
            "all; --max-pixels sets this limit"
        )
    if count > limits.maps:
        raise FormatError(f"{array.label}: has {count} maps, expected at most {limits.maps}")


def read_terrain(array: StoredArray, unit: float) -> Iterator[Bytes]:
    """Yield the weights of each map as terrain, (H, W) uint8, reading one at a time.

    Args:
        array: (N, H, W), a shape that `check_weights` accepts.
        unit: the weight that becomes a cost of 1.

    Raises:
        FormatError: weights that are no whole multiples of the unit, or a damaged file.
    """

    def terrain_of(weights: Array, number: int) -> Bytes:
        return to_terrain(weights, unit, f"{array.label}: map {number}")

    # Unlike a loop, `map` keeps no entry while the next one is read.
    yield from map(terrain_of, array.entries(), itertools.count())


def problem_set(
    maps: list[ForeignMap],
    problems: list[tuple[int, Cell, Cell]],
    movement: Movement,
    source: Path,
    count: int | None,
) -> ProblemSet:
    """Return problems on maps with terrain, without those from a cell to itself.

    Args:
        maps: with terrain, all of one size.
        problems: number of the map, start and goal of each problem.
        movement: the rule of moves.
        source: the file, for the description and for errors.
        count: maximal number of problems, evenly spread; default all.

    Raises:
        FormatError: there is no problem.
    """
    problems = [problem for problem in problems if problem[1] != problem[2]]
    if not problems:
        raise FormatError(f"{source}: has no problem between two cells")
    total = len(problems)
    step = 1 if count is None else sampling_step(total, count)
    problems = problems[::step]
    description = f"{total} problems of {source}"
    if step > 1:
        description = f"{len(problems)} of {total} problems of {source}, one in {step}"
    terrain = np.stack([_terrain_of(maps[number]) for number, _, _ in problems])
    return ProblemSet(
        (terrain == 0).astype(np.uint8),
        np.array([start for _, start, _ in problems]),
        np.array([goal for _, _, goal in problems]),
        movement,
        description,
        terrain,
    )


def _terrain_of(foreign_map: ForeignMap) -> Bytes:
    """Return the terrain of a map that has some."""
    if foreign_map.terrain is None:
        raise TypeError(f"{foreign_map.name}: expected a map with terrain")
    return foreign_map.terrain


def only_path_of_split(
    paths: list[Path], splits: list[int | None], source: Path, split: str
) -> Path:
    """Return the only one of several files that holds a split.

    Args:
        paths: the files below ``source``.
        splits: the code of each file's split; None if it is not known.
        source: the folder, or the file itself, whatever its split.
        split: train, val or test.

    Raises:
        FormatError: no file holds the split, or several do.
    """
    if source.is_file():
        return source
    code = SPLITS.index(split)
    chosen = [path for path, known in zip(paths, splits, strict=True) if known == code]
    if len(chosen) == 1:
        return chosen[0]
    names = ", ".join(str(path.relative_to(source)) for path in paths)
    raise FormatError(
        f"{source}: holds {len(chosen)} files of the split {split!r} among {names}; expected one, "
        "or name a single file"
    )


def to_terrain(weights: Array, unit: float, label: str) -> Bytes:
    """Return weights as terrain, (H, W) uint8 of 1 to 255.

    A weight may be rounded as its dtype, or a narrower one, rounds: 9.2 is 9.203125 in float16, as
    in the published Warcraft sets.

    Args:
        weights: (H, W) numbers.
        unit: the weight that becomes a cost of 1.
        label: names the map in errors.

    Raises:
        FormatError: a weight that is not 1 to 255 units; the message names the first one.
    """
    rows, columns = weights.shape
    terrain = np.empty((rows, columns), np.uint8)
    # Blocks of rows bound the memory that the arrays of 8 bytes a cell take.
    block_rows = max(_BLOCK_CELLS // columns, 1)
    for top in range(0, rows, block_rows):
        block = np.s_[top : top + block_rows]
        terrain[block] = _to_costs(weights[block], unit, label, top)
    return terrain


def _to_costs(weights: Array, unit: float, label: str, top: int) -> Bytes:
    """Return the costs of some rows of a map, as `to_terrain` does.

    Args:
        weights: of these rows, (h, W).
        unit: the weight that becomes a cost of 1.
        label: names the map in errors.
        top: number of the first of the rows.

    Raises:
        FormatError: as `to_terrain`.
    """
    exact_weights = weights.astype(np.float64)
    costs = np.rint(exact_weights / unit)
    # With NaN every comparison is false, so this form of the test refuses it.
    is_cost = (costs >= 1) & (costs <= MAX_CELL_COST)
    multiples = np.where(is_cost, costs, 1) * unit
    is_multiple = is_cost & _is_rounded(exact_weights, multiples, weights.dtype)
    if not is_multiple.all():
        row, column = np.argwhere(~is_multiple)[0].tolist()
        raise FormatError(
            f"{label}: cell {top + row, column} has weight {exact_weights[row, column]:g}, "
            f"expected a whole multiple of the unit {unit:g}, from {unit:g} to "
            f"{MAX_CELL_COST * unit:g}"
        )
    return costs.astype(np.uint8)


def _is_rounded(weights: Array, multiples: Array, dtype: np.dtype[Any]) -> Array:
    """Return whether weights are multiples of the unit, up to the rounding of floats.

    Args:
        weights: (H, W) float64.
        multiples: (H, W) float64, the nearest multiples of the unit.
        dtype: of the weights in the file.
    """
    # Two roundings of the dtype are allowed, since a weight may be the product of rounded numbers.
    precision = np.finfo(dtype if dtype.kind == "f" else np.float64).eps
    is_rounded = np.abs(weights - multiples) <= float(precision) * multiples
    for narrow in (np.float16, np.float32):  # weights that were saved in a narrower dtype before
        with np.errstate(over="ignore"):  # multiples above 65,504 become infinite in float16
            is_rounded |= weights == multiples.astype(narrow)
    return np.asarray(is_rounded)
