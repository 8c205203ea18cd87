"""Sources of batches, one of which a dataset holds: stored problems, drawn ones, or a problem set.

A `Batch` has maps, starts and goals; its fields are computed when they are asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from torch.utils.data import get_worker_info

from mapdata.arrays import Bytes, Flags, Ints
from mapdata.datasets.arguments import Serving
from mapdata.datasets.fields import Batch, Rooms, room_matrices
from mapdata.datasets.map_sources import MapSource, StoredMapSource
from mapdata.limits import Size
from mapdata.movement import Movement
from mapdata.problems.drawing import DRAWS, Drawing, Drawn, Paths, Search
from mapdata.problems.problem_set import ProblemSet
from mapdata.problems.sources import Route
from mapdata.problems.substitutes import limit_of_tries, may_have_high_costs
from mapdata.search.map_stack import MapStack
from mapdata.shards.workers import Advance, no_bar

CELLS_AT_ONCE = 2**20
"""Cells of the maps that problems are sampled on at once: 256 maps of 64 x 64.

More of them would keep a progress bar waiting where problems are rare.
"""

_process = {"said_rare": False}
"""Whether this process has said that problems are rare."""


class BatchSource(Protocol):
    """N problems, of which a dataset serves batches.

    Attributes:
        movement: of the paths.
        map_size: (rows, columns) of all maps.
        has_terrain: whether free cells cost different amounts.
        draws_anew: whether each epoch has other problems.
        map_hashes: what identifies the maps, or the problems.
    """

    movement: Movement
    map_size: Size
    has_terrain: bool
    draws_anew: bool

    @property
    def map_hashes(self) -> Sequence[str]:
        """What identifies the maps, or the problems."""

    def __len__(self) -> int:
        """Return N."""

    def batch_of(self, indices: Ints, epoch: int, advance: Advance) -> Batch:
        """Return problems of an epoch.

        Args:
            indices: (B,) their numbers, 0 to N - 1.
            epoch: pass over the data.
            advance: called with the number of maps on which problems were sought just now.
        """

    def own_maps(self, indices: Ints) -> Ints | None:
        """Return the maps on which problems are drawn first, as ``map_index`` numbers them.

        None for problems that are not drawn, and so never on another map.
        """


class StoredSource:
    """The problems of a route or of pairs of rooms, as shards hold them."""

    draws_anew = False

    def __init__(
        self,
        maps: StoredMapSource,
        serving: Serving,
        movement: Movement,
        selected: Ints | None = None,
    ) -> None:
        """Keep the arguments.

        Args:
            maps: the maps.
            serving: how the problems are served.
            movement: the served one.
            selected: numbers of the problems that are served, ascending; None for all.
        """
        self.movement = movement
        self.map_size = maps.map_size
        self.has_terrain = maps.has_terrain
        self.map_hashes = maps.map_hashes
        self.selected = selected
        self._maps = maps
        self._serving = serving

    def __len__(self) -> int:
        """Return the number of problems."""
        return len(self._maps.reader) if self.selected is None else len(self.selected)

    @property
    def numbers(self) -> Ints:
        """(N,) the numbers of the problems among all that are stored."""
        return np.arange(len(self._maps.reader)) if self.selected is None else self.selected

    def select(self, numbers: Ints) -> StoredSource:
        """Return a view on the problems with these numbers, ascending."""
        return StoredSource(self._maps, self._serving, self.movement, numbers)

    def batch_of(self, indices: Ints, epoch: int, advance: Advance) -> Batch:
        """Return problems, which are the same in all epochs."""
        del epoch, advance
        return self.batch_of_numbers(indices if self.selected is None else self.selected[indices])

    def batch_of_numbers(self, numbers: Ints) -> Batch:
        """Return problems by their numbers among all that are stored."""
        reader = self._maps.reader
        located = reader.locate(numbers)
        stored_grids = reader.grids(located)
        # Without a radius they are the stored ones themselves.
        grids = MapStack(stored_grids, None).inflated(self._maps.min_clearance).grids
        is_read = isinstance(self._serving.problems, Route) and self._maps.labels_serve

        def compute_paths(search: str) -> Paths | None:
            return reader.paths(located, search) if is_read else None

        return _batch_on(
            self._maps,
            self._serving,
            self.movement,
            numbers,
            positions=numbers,
            grids=grids,
            starts=reader.seed_points(located, located.first_rooms),
            goals=reader.seed_points(located, located.second_rooms),
            compute_map_numbers=lambda: reader.map_numbers(located),
            compute_stored_maps=lambda: reader.stored_maps(located, stored_grids),
            compute_paths=compute_paths,
        )

    def own_maps(self, indices: Ints) -> None:
        """Return None: the problems are not drawn."""
        del indices


class DrawnSource:
    """Problems that are drawn, each on its own map or, if that has none, on a substitute.

    A problem is a function of the seed, the epoch and its number alone.
    """

    def __init__(
        self, maps: MapSource, serving: Serving, movement: Movement, count: int, *, draws_anew: bool
    ) -> None:
        """Keep the arguments.

        Args:
            maps: the maps. Problem i is first drawn on the map at position i, or i // k if there
                are k problems per map.
            serving: how the problems are served.
            movement: the served one.
            count: number of problems of an epoch.
            draws_anew: whether there are several problems to draw on a map.
        """
        self.movement = movement
        self.map_size = maps.map_size
        self.has_terrain = maps.has_terrain
        self.draws_anew = draws_anew
        self.map_hashes = maps.map_hashes
        self._maps = maps
        self._serving = serving
        self._count = count
        self._drawing = Drawing(
            serving.problems,
            serving.sampling_seed,
            movement,
            DRAWS,
            serving.search,
            maps.min_clearance,
            serving.radius,
        )
        rows, columns = maps.map_size
        self._maps_at_once = max(CELLS_AT_ONCE // (rows * columns), 1)

    def __len__(self) -> int:
        """Return the number of problems of an epoch."""
        return self._count

    def batch_of(self, indices: Ints, epoch: int, advance: Advance) -> Batch:
        """Return problems of an epoch.

        Each of them is drawn on its own map, or on a substitute if that map has none. Which one
        depends on the problem and its maps alone, never on the batch or on other problems.

        Raises:
            ValueError: a problem is on none of as many maps as `limit_of_tries` allows.
        """
        own_positions = indices // self._drawing.source.per_map
        on_own_maps = self._on_own_maps(own_positions, indices, epoch, advance)
        drawn, positions = self._with_substitutes(
            on_own_maps, own_positions, indices, epoch, advance
        )
        served_search = self._serving.search
        return _batch_on(
            self._maps,
            self._serving,
            self.movement,
            indices,
            positions=positions,
            grids=drawn.maps.grids,
            starts=drawn.starts,
            goals=drawn.goals,
            compute_map_numbers=lambda: drawn.numbers,
            compute_stored_maps=lambda: drawn.stored,
            compute_paths=lambda search: drawn.paths if search == served_search else None,
        )

    def _with_substitutes(
        self, drawn: Drawn, positions: Ints, indices: Ints, epoch: int, advance: Advance
    ) -> tuple[Drawn, Ints]:
        """Return the problems and the positions of their maps, the missing ones on substitutes.

        Each missing problem is drawn on its first substitute that has one.

        Args:
            drawn: the problems on their own maps; its arrays are changed.
            positions: (B,) positions of these maps.
            indices: (B,) numbers of the problems.
            epoch: pass over the data.
            advance: called with the number of maps on which problems were sought just now.
        """
        positions = positions.copy()
        max_tries = limit_of_tries(self._drawing.source, self.map_size, self._drawing.attempts)
        search = Search(self._drawing, max_tries, is_silent=_is_silent(advance))
        missing = MissingProblems(~drawn.has_problem, max_tries)
        while len(missing.rows):
            rows = missing.next_rows(self._maps_at_once)
            row = missing.first_in_vain(rows)
            if row is not None:
                tried = self._maps.tried_text(max_tries)
                raise search.error(f"{tried} for problem {indices[row]} of epoch {epoch}")
            # One try for each problem and substitute; those of a problem stand together, in order.
            tries_per_problem = self._substitutes_at_once(missing, rows)
            row_of_try = np.repeat(rows, tries_per_problem)
            # The own map was the first that was tried, so substitutes are numbered from 1 on.
            numbers = missing.tried[row_of_try] + np.tile(np.arange(tries_per_problem), len(rows))
            substitutes = self._maps.substitutes(indices[row_of_try], epoch, numbers)
            # A substitute has draws of its own, those of a problem beyond the end of the dataset.
            others = self._draw(substitutes, indices[row_of_try] + numbers * self._count, epoch)
            advance(len(substitutes))
            successes = np.flatnonzero(others.has_problem)
            # The first success of each problem.
            found, first = np.unique(row_of_try[successes], return_index=True)
            first_successes = successes[first]
            missing_count = len(missing.rows)
            missing.note(rows, tries_per_problem, found)
            _say_if_long(search, missing, missing_count)
            if len(found):
                positions[found] = substitutes[first_successes]
                drawn = drawn.overwritten(found, others, first_successes)
        return drawn, positions

    def _draw(self, positions: Ints, keys: Ints, epoch: int) -> Drawn:
        """Draw a problem on each of the maps at these positions."""
        with_seed_points = self._drawing.source.needs_seed_points
        given = self._maps.given_maps(positions, with_seed_points=with_seed_points)
        return self._drawing.on(given, keys, epoch)

    def _on_own_maps(self, positions: Ints, indices: Ints, epoch: int, advance: Advance) -> Drawn:
        """Draw problems on their own maps, some at a time."""
        parts = []
        for first in range(0, max(len(indices), 1), self._maps_at_once):
            part = slice(first, first + self._maps_at_once)
            parts.append(self._draw(positions[part], indices[part], epoch))
            advance(len(indices[part]))
        return Drawn.joined(parts)

    def _substitutes_at_once(self, missing: MissingProblems, rows: Ints) -> int:
        """Return how many substitutes of each of the problems ``rows`` are tried at once.

        On large maps with terrain it is one: a cost may be too high, which raises an error, and a
        map must not raise it that comes after the one that is served.
        """
        if self.has_terrain and may_have_high_costs(self.map_size):
            return 1
        return missing.substitutes_at_once(rows, self._maps_at_once)

    def own_maps(self, indices: Ints) -> Ints:
        """Return the numbers of the maps on which problems are drawn first."""
        return self._maps.map_indices(indices // self._drawing.source.per_map)


class MissingProblems:
    """The problems of a batch that were not found on their own maps, while substitutes are tried.

    Attributes:
        tried: (B,) int64, on how many maps each problem of the batch was sought.
        rows: (M,) int64, the problems that were not found yet, ascending.
    """

    def __init__(self, is_missing: Flags, max_tries: int) -> None:
        """Begin after the own maps.

        Args:
            is_missing: (B,), which problems are not on their own maps.
            max_tries: on how many maps a problem is sought.
        """
        self.tried = np.ones(len(is_missing), np.int64)
        self.rows = np.flatnonzero(is_missing)
        self._max_tries = max_tries
        self._failed_in_a_row = 0  # substitutes since the last success, of whichever problem

    def next_rows(self, max_maps: int) -> Ints:
        """Return the problems to seek next, on at most ``max_maps`` maps.

        After many failures in a row this is the first missing problem alone. So the error comes
        when one problem has been sought in vain, not when all of a batch have been.
        """
        is_batch = self._failed_in_a_row < self._max_tries // 8
        return self.rows[: max_maps if is_batch else 1]

    def substitutes_at_once(self, rows: Ints, max_maps: int) -> int:
        """Return on how many substitutes each of the problems ``rows`` is sought at once.

        They are at most an eighth of the maps on which each was sought, so that little work is done
        in vain.
        """
        tried = self.tried[rows]
        eighth = int(tried.min()) // 8
        remaining = self._max_tries - int(tried.max())
        return max(min(eighth, remaining, max_maps // len(rows)), 1)

    def first_in_vain(self, rows: Ints) -> int | None:
        """Return the first of the problems ``rows`` that was sought on enough maps, if any."""
        in_vain = rows[self.tried[rows] >= self._max_tries]
        return int(in_vain[0]) if len(in_vain) else None

    def note(self, rows: Ints, tries_per_problem: int, found: Ints) -> None:
        """Note that problems ``rows`` were sought, and that those in ``found`` were found.

        Args:
            rows: (R,) the problems.
            tries_per_problem: on how many substitutes each of them was sought.
            found: ascending.
        """
        self._failed_in_a_row = (
            0 if len(found) else self._failed_in_a_row + tries_per_problem * len(rows)
        )
        self.tried[rows] += tries_per_problem
        self.rows = np.setdiff1d(self.rows, found, assume_unique=True)


class SetSource:
    """The problems of a problem set, whose map and start and goal are its rooms."""

    draws_anew = False

    def __init__(self, problem_set: ProblemSet, serving: Serving) -> None:
        """Keep the arguments; nothing is copied."""
        self.movement = problem_set.movement
        self.map_size = problem_set.map_size
        self.has_terrain = problem_set.has_terrain
        self._problem_set = problem_set
        self._serving = serving

    @property
    def map_hashes(self) -> Sequence[str]:
        """The content hash of the problems."""
        return [self._problem_set.content_hash]

    def __len__(self) -> int:
        """Return the number of problems."""
        return len(self._problem_set)

    def batch_of(self, indices: Ints, epoch: int, advance: Advance) -> Batch:
        """Return problems, which are the same in all epochs, on copies of their maps."""
        del epoch, advance
        problem_set = self._problem_set
        search = self._serving.search
        map_numbers = problem_set.map_indices[indices]
        maps = MapStack(*problem_set.maps_of(indices))
        starts = problem_set.starts[indices]
        goals = problem_set.goals[indices]

        def compute_rooms() -> Rooms:
            seed_points = np.stack((starts, goals), axis=1)
            matrices = room_matrices(search, map_numbers, maps, seed_points, self.movement)
            return Rooms(matrices, seed_points)

        def compute_paths(search_name: str) -> Paths | None:
            if search_name != "astar":
                return None  # the set has the paths of A* alone
            optimal = problem_set.optimal
            return Paths(optimal.cells, optimal.offsets, optimal.iterations).select(indices)

        return Batch(
            movement=self.movement,
            search=search,
            grids=maps.grids,
            starts=starts,
            goals=goals,
            problems=problem_set.problem_numbers[indices],
            compute_map_indices=map_numbers.copy,  # a field, which users may write to
            compute_rooms=compute_rooms,
            compute_map_numbers=lambda: map_numbers,
            compute_stored_maps=lambda: maps,
            symmetries=np.zeros(len(indices), np.int64),
            requested_fields=self._serving.names,
            max_length=self._serving.max_length,
            compute_paths=compute_paths,
            has_terrain=self.has_terrain,
        )

    def own_maps(self, indices: Ints) -> None:
        """Return None: the problems are not drawn."""
        del indices


def _batch_on(
    maps: MapSource,
    serving: Serving,
    movement: Movement,
    indices: Ints,
    *,
    positions: Ints,
    grids: Bytes,
    starts: Ints,
    goals: Ints,
    compute_map_numbers: Callable[[], Ints],
    compute_stored_maps: Callable[[], MapStack],
    compute_paths: Callable[[str], Paths | None],
) -> Batch:
    """Return problems as a batch whose paths and rooms are computed when they are needed.

    Args:
        maps: the maps.
        serving: how the problems are served.
        movement: the served one.
        indices: (B,) numbers of the problems.
        positions: (B,) positions of their maps.
        grids: (B, H, W), the maps as served.
        starts: (B, 2) cells.
        goals: (B, 2) cells.
        compute_map_numbers: returns the numbers of the maps, for errors.
        compute_stored_maps: returns the maps before inflation.
        compute_paths: returns the paths of "bfs" or "astar", or None if they must be searched.
    """
    search = serving.search

    def compute_rooms() -> Rooms:
        stored_rooms = maps.stored_rooms(positions, search)
        if stored_rooms is not None:
            return stored_rooms
        seed_points = maps.seed_points(positions)
        numbers = positions
        served = MapStack(grids, None)
        if search == "astar" and maps.has_terrain:
            numbers = compute_map_numbers()
            served = compute_stored_maps().with_grids(grids)
        return Rooms(room_matrices(search, numbers, served, seed_points, movement), seed_points)

    return Batch(
        movement=movement,
        search=search,
        grids=grids,
        starts=starts,
        goals=goals,
        problems=indices,
        compute_map_indices=lambda: maps.map_indices(positions),
        compute_rooms=compute_rooms,
        compute_map_numbers=compute_map_numbers,
        compute_stored_maps=compute_stored_maps,
        symmetries=np.zeros(len(indices), np.int64),
        requested_fields=serving.names,
        max_length=serving.max_length,
        compute_paths=compute_paths,
        radius_cells=maps.radius_cells,
        has_terrain=maps.has_terrain,
    )


def _is_silent(advance: Advance) -> bool:
    """Return whether nothing is said of a batch that takes long."""
    worker = get_worker_info()
    return (
        _process["said_rare"]
        or advance is not no_bar
        or (worker is not None and worker.id > 0)  # one worker says it for all
    )


def _say_if_long(search: Search, missing: MissingProblems, missing_before: int) -> None:
    """Say once in each process that a batch takes long.

    Args:
        search: for the problems of the batch.
        missing: on how many maps each of them was tried.
        missing_before: number of problems that were not found on the maps before the last ones.
    """
    count = len(missing.tried)
    failed = int(missing.tried.sum()) - count
    state = (
        f"no such problem at {failed:,} tries on a map, and {missing_before:,} of {count:,} "
        "problems of a batch still to find; wider conditions are faster"
    )
    if search.say_if_long(failed, state):
        _process["said_rare"] = True
