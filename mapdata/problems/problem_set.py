"""Problems that planners are compared on: drawn on maps made on the spot, or on one split of a dataset."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, count, islice
from pathlib import Path

import numpy as np
import numpy.typing as npt

from mapdata.arrays import Bytes, Flags, Floats, Ints
from mapdata.generators.generator import Generator, generate, identity
from mapdata.rng import PROBLEM, block, bounded
from mapdata.search.api import BatchResult, distance_field, search_batch
from mapdata.search.lattice import hardness
from mapdata.shards.manifest import read_manifest
from mapdata.shards.reader import read_shard
from mapdata.spec import SPLITS, Movement, check_seed

HARD = 1.05
"""Hardness (optimal cost over heuristic) from which on a problem is hard."""

MIN_DISTANCE = 10
"""Smallest Manhattan distance from start to goal of a drawn problem."""

_ATTEMPTS = 64
_MAPS_A_CHUNK = 256

Cell = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Problems:
    """N problems that planners are compared on, each with a path. The arrays are copied and cannot be written to.

    Attributes:
        grids: (N, H, W) uint8, 0 free and 1 occupied.
        starts: (N, 2) int64, cells.
        goals: (N, 2) int64, cells other than the starts.
        movement: how one moves; `draw` and `read` take 8-connected moves without corner cutting unless told otherwise.
        description: where they come from, in words.

    Raises:
        ValueError: what `search_batch` refuses; a problem without a path, or whose start is its goal.
    """

    grids: Bytes
    starts: Ints
    goals: Ints
    movement: Movement
    description: str = "problems"

    def __post_init__(self) -> None:
        """Solve the problems, so that what cannot be evaluated is refused here, and copy the arrays."""
        if np.ndim(self.grids) != 3:
            raise ValueError(f"grids: got shape {np.shape(self.grids)}, expected (N, H, W)")
        cost = self.optimal.cost
        for refused, why in ((-1, "has no path"), (0, "starts at its goal")):
            if (cost == refused).any():
                raise ValueError(f"problem {int(np.argmax(cost == refused))} {why}: leave it out")
        for name, dtype in (("grids", np.uint8), ("starts", np.int64), ("goals", np.int64)):
            array: npt.NDArray[np.generic] = np.array(getattr(self, name), dtype, order="C")
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        """Return N, the number of problems."""
        return len(self.starts)

    @cached_property
    def optimal(self) -> BatchResult:
        """What mapdata's A* finds: the optimal costs, and the iterations that all planners are measured with."""
        return search_batch("astar", self.grids, self.starts, self.goals, self.movement)

    @cached_property
    def hardness(self) -> Floats:
        """(N,) optimal cost over heuristic (the cost on an empty grid); 1 is the easiest."""
        return hardness(self.optimal.cost, self.starts, self.goals, self.movement)

    @cached_property
    def hard(self) -> Flags:
        """(N,) bool: the hardness is at least ``HARD``."""
        return np.asarray(self.hardness >= HARD)

    @staticmethod
    def draw(
        spec: Generator,
        seed: int,
        maps: int | None = None,
        *,
        until_hard: int | None = None,
        movement: Movement = Movement(8),
    ) -> Problems:
        """Draw one problem on each of the maps 0, 1, ... of (spec, seed).

        The start is a uniform free cell, the goal a uniform one among the cells connected to it at a Manhattan distance
        of at least ``MIN_DISTANCE``. A start without such a goal is drawn again, 64 times at most; then the map is left
        out. The problem on map i is a pure function of (spec, seed, i) and of which cells ``movement`` connects.

        Args:
            spec: the distribution of maps; its own movement is not used.
            seed: 64-bit seed of the maps and of the problems.
            maps: how many maps; with ``until_hard`` at most that many.
            until_hard: stop at the map that brings the number of hard problems to this.
            movement: how one moves.

        Raises:
            ValueError: neither ``maps`` nor ``until_hard``; no map with a problem; not enough hard ones (without
                ``maps``: less than one on 1,000 maps).

        >>> len(Problems.draw(MapSpec.preset("dungeon"), seed=77, maps=20))
        20
        """
        _check(maps, until_hard)
        most = maps if maps is not None or until_hard is None else 1000 * until_hard
        if most is None:
            raise ValueError("got neither maps nor until_hard, expected how many maps or hard problems to draw")
        chunks = (range(k, k + _MAPS_A_CHUNK) for k in count(0, _MAPS_A_CHUNK))
        grids = chain.from_iterable(zip(chunk, generate(spec, seed, chunk).occupancy, strict=True) for chunk in chunks)
        where = f"the maps with identity {identity(spec, seed)[:12]}"
        return _collect(grids, most, until_hard, check_seed(seed), movement, where)

    @staticmethod
    def read(
        root: str | Path,
        maps: int | None = None,
        *,
        split: str = "test",
        seed: int | None = None,
        until_hard: int | None = None,
        movement: Movement = Movement(8),
    ) -> Problems:
        """Draw one problem on each map of one split of a dataset: on map i the one that `draw` draws.

        Args:
            root: folder of the dataset.
            maps: how many maps of the split at most; all without.
            split: "train", "val" or "test".
            seed: seed of the problems; default the dataset's own, 0 for imported maps.
            until_hard: as in `draw`.
            movement: how one moves.

        Raises:
            DatasetNotFoundError: there is no dataset under ``root``.
            ShardError: it is damaged.
            ValueError: no such split; no map with a problem; not enough hard ones.
        """
        if split not in SPLITS:
            raise ValueError(f"split: got {split!r}, expected one of {', '.join(SPLITS)}")
        _check(maps, until_hard)
        manifest = read_manifest(Path(root))
        shards = (read_shard(Path(root) / entry.name).maps for entry in manifest.shards)
        grids = (
            (int(found.index[k]), found.occupancy[k])
            for found in shards
            for k in np.flatnonzero(found.split == SPLITS.index(split))
        )
        seed = (manifest.seed or 0) if seed is None else check_seed(seed)
        return _collect(grids, maps, until_hard, seed, movement, f"split {split} of {root}")


def _check(maps: int | None, until_hard: int | None) -> None:
    for name, value in (("maps", maps), ("until_hard", until_hard)):
        if value is not None and value < 1:
            raise ValueError(f"{name}: got {value}, expected at least 1")


def _collect(
    source: Iterable[tuple[int, Bytes]],
    maps: int | None,
    until_hard: int | None,
    seed: int,
    movement: Movement,
    where: str,
) -> Problems:
    """Draw a problem on each of the first ``maps`` of ``source``, (number, grid), until there are enough hard ones."""
    grids: list[Bytes] = []
    ends: list[tuple[Cell, Cell]] = []
    indices: list[int] = []
    hard = 0
    for number, grid in islice(source, maps):
        drawn = _draw_problem(grid, seed, number, movement)
        if drawn is None:
            continue
        grids.append(grid)
        ends.append(drawn)
        indices.append(number)
        if until_hard is not None:
            start, goal = np.array(drawn)[:, None]
            hard += int(Problems(grid[None], start, goal, movement).hard[0])
            if hard == until_hard:
                break
    if not grids:
        raise ValueError(f"{where}: no map with two connected cells at a Manhattan distance of {MIN_DISTANCE} or more")
    if until_hard is not None and hard < until_hard:
        raise ValueError(f"until_hard: got {until_hard}, found only {hard} hard problems on {where}")
    starts, goals = np.array(ends).swapaxes(0, 1)
    description = f"maps {indices[0]} to {indices[-1]} of {where}, problems by seed {seed}"
    return Problems(np.stack(grids), starts, goals, movement, description)


def _draw_problem(grid: Bytes, seed: int, index: int, movement: Movement) -> tuple[Cell, Cell] | None:
    """Return start and goal on map ``index``, or None; cells are counted in row-major order."""
    free = np.argwhere(grid == 0)
    rows, columns = np.ogrid[: grid.shape[0], : grid.shape[1]]
    for attempt in range(_ATTEMPTS if len(free) else 0):
        first, second, *_ = block(np.uint64(seed), np.uint64(index), 0, PROBLEM, attempt)
        row, column = free[bounded(first, 0, len(free) - 1)].tolist()
        far = np.abs(rows - row) + np.abs(columns - column) >= MIN_DISTANCE
        goals = np.argwhere(far & (distance_field(grid, (row, column), movement) >= 0))
        if len(goals):
            goal_row, goal_column = goals[bounded(second, 0, len(goals) - 1)].tolist()
            return (row, column), (goal_row, goal_column)
    return None
