"""Measure what the problems of a dataset are worth, for `mapdata.describe.ProblemStatistics`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np

from mapdata.arrays import Array, Flags, Floats, Ints
from mapdata.checks import check_count
from mapdata.datasets.field_kernels import count_shortest_paths
from mapdata.datasets.fields import Batch
from mapdata.describe.problem_statistics import ProblemStatistics
from mapdata.describe.statistics import digests_of
from mapdata.limits import Size
from mapdata.search.lattice import hardness

SAMPLE = 300
"""Number of problems that are measured by default."""

CELLS_PER_PROBLEM = 5000
"""Cells of maps that are measured for each problem that was asked for: 1.5 * 10**6 by default."""

MIN_SAMPLE = 10
"""Number of problems that are measured on maps of any size."""

_BATCH_CELLS = 2**21
"""Cells of the maps of a batch, which take some 20 bytes a cell."""

_FIELDS = ("optimal_moves", "optimal_mask")
"""The fields that are computed."""

_GOLDEN_RATIO = (5**0.5 - 1) / 2


class Problems(Protocol):
    """The part of a dataset that is measured here."""

    @property
    def map_size(self) -> Size:
        """(rows, columns) of all maps."""

    @property
    def has_terrain(self) -> bool:
        """Whether free cells cost different amounts."""

    def __len__(self) -> int:
        """Return the number of problems of an epoch."""

    def batch_of(self, indices: Ints, epoch: int) -> Batch:
        """Return problems of an epoch, before any symmetry."""

    def own_maps(self, indices: Ints) -> Ints | None:
        """Return the maps on which problems are drawn first, as ``map_index`` numbers them.

        None for problems that are not drawn, and so never on another map.
        """

    def served_text(self) -> str:
        """Return which problems are served, in words."""


@dataclass(frozen=True)
class _Measured:
    """What is measured of n problems, as `ProblemStatistics.measure` takes it."""

    hardness: Floats
    path_counts: Ints
    lengths: Ints
    optimal_cells: Ints
    expansions: Ints
    is_replaced: Flags
    digests: Array
    symmetric_digests: Array


def measure(
    dataset: Problems, sample: int = SAMPLE, numbers: Ints | None = None
) -> ProblemStatistics:
    """Return the statistics of some problems of a dataset.

    Args:
        dataset: the dataset.
        sample: as `MapDataset.problem_statistics` takes it.
        numbers: (N,) the problems: number i is problem ``i % len(dataset)`` of epoch ``i //
            len(dataset)``; by default all problems of epoch 0.

    Raises:
        ValueError: ``sample`` is less than one.
    """
    if numbers is None:
        numbers = np.arange(len(dataset))
    count = len(numbers)
    rows, columns = dataset.map_size
    numbers = numbers[spread_numbers(count, sample_size(sample, rows * columns))]
    parts = [_measured_batch(dataset, *batch) for batch in _batches(numbers, dataset)]
    # An empty part gives the arrays of a dataset without problems their types.
    none = np.empty(0, np.int64)
    no_digests = np.empty(0, "S16")
    parts.append(
        _Measured(none.astype(np.float64), none, none, none, none, none > 0, no_digests, no_digests)
    )
    measured = {
        field.name: np.concatenate([getattr(part, field.name) for part in parts])
        for field in fields(_Measured)
    }
    return ProblemStatistics.measure(
        served=dataset.served_text(),
        problems=count,
        has_terrain=dataset.has_terrain,
        is_drawn=dataset.own_maps(none) is not None,
        **measured,
    )


def sample_size(sample: int, cells: int) -> int:
    """Return how many problems are measured on maps of so many cells.

    >>> sample_size(300, 64 * 64), sample_size(300, 128 * 128), sample_size(300, 1024 * 1024)
    (300, 91, 10)
    """
    check_count("sample", sample)
    return min(sample, max(sample * CELLS_PER_PROBLEM // cells, MIN_SAMPLE))


def spread_numbers(count: int, sample: int) -> Ints:
    """Return at most ``sample`` of the numbers below ``count``, evenly spread and ascending.

    There is one number of each of ``sample`` equal parts. Its place in the part is another one for
    each part, by the golden ratio. So no period of the numbers is hit again and again: where all
    maps have three problems, every third number would always be the first problem of a map.

    >>> spread_numbers(12, 4).tolist()
    [0, 4, 6, 11]
    """
    sample = min(sample, count)
    bounds = np.arange(sample + 1) * count // max(sample, 1)
    places = np.arange(sample) * _GOLDEN_RATIO % 1
    return bounds[:-1] + (places * np.diff(bounds)).astype(np.int64)


def _batches(numbers: Ints, dataset: Problems) -> Iterator[tuple[Ints, int]]:
    """Yield the indices of the problems and their epoch, a batch at a time."""
    rows, columns = dataset.map_size
    batch_size = max(_BATCH_CELLS // (rows * columns), 1)
    epochs, indices = np.divmod(numbers, max(len(dataset), 1))
    for epoch in np.unique(epochs).tolist():
        of_epoch = indices[epochs == epoch]
        for first in range(0, len(of_epoch), batch_size):
            yield of_epoch[first : first + batch_size], epoch


def map_digests(batch: Batch) -> tuple[list[bytes], list[bytes]]:
    """Return two hashes of the stored map of each problem, as `digests_of`."""
    maps = batch.stored_grids if batch.stored_terrain is None else batch.stored_terrain
    return digests_of(maps, is_terrain=batch.has_terrain)


def _measured_batch(dataset: Problems, indices: Ints, epoch: int) -> _Measured:
    """Return what is measured of problems ``indices`` of an epoch."""
    batch = dataset.batch_of(indices, epoch)
    batch.requested_fields = _FIELDS
    optimal_moves = batch.goal_fields.optimal_moves
    optimal_mask = batch.goal_fields.optimal_mask
    # Shortest paths are those of least cost, which BFS does not find on terrain and under 8 moves.
    by_cost = batch.with_astar
    own_maps = dataset.own_maps(batch.problems)
    map_indices = batch.compute_map_indices()
    exact, symmetric = map_digests(batch)
    return _Measured(
        hardness=hardness(by_cost.costs, batch.starts, batch.goals, batch.movement),
        path_counts=count_shortest_paths(optimal_moves, optimal_mask, batch.starts),
        lengths=np.diff(by_cost.paths.offsets),
        optimal_cells=optimal_mask.sum(axis=(1, 2, 3), dtype=np.int64),
        expansions=by_cost.paths.iterations,
        is_replaced=np.zeros(len(indices), np.bool_)
        if own_maps is None
        else map_indices != own_maps,
        digests=np.array(exact),
        symmetric_digests=np.array(symmetric),
    )
