"""Sources of batches, one of which a dataset holds: stored problems, drawn ones, or a problem set.

A `Batch` has maps, starts and goals; its fields are computed when they are asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from torch.utils.data import get_worker_info

from mapdata.arrays import Bytes, Ints
from mapdata.datasets.arguments import Serving
from mapdata.datasets.fields import Batch, Rooms, room_matrices
from mapdata.datasets.map_sources import MapSource, StoredMapSource
from mapdata.limits import Size
from mapdata.movement import Movement
from mapdata.problems.drawing import DRAWS, Drawing, Drawn, Paths, Search
from mapdata.problems.problem_set import ProblemSet, selected_paths
from mapdata.problems.sources import Route
from mapdata.problems.substitutes import may_have_high_costs, most_maps
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
        return self.stored(indices if self.selected is None else self.selected[indices])

    def stored(self, numbers: Ints) -> Batch:
        """Return problems by their numbers among all that are stored."""
        reader = self._maps.reader
        stored = reader.locate(numbers)
        stored_grids = reader.grids(stored)
        # Without a radius they are the stored ones themselves.
        grids = MapStack(stored_grids, None).inflated(self._maps.min_clearance).grids
        batch = _batch_on(
            self._maps,
            self._serving,
            self.movement,
            numbers,
            places=numbers,
            grids=grids,
            starts=reader.seed_points(stored, stored.first_rooms),
            goals=reader.seed_points(stored, stored.second_rooms),
            compute_map_numbers=lambda: reader.map_numbers(stored),
            compute_stored_maps=lambda: reader.stored_maps(stored, stored_grids),
        )
        if isinstance(self._serving.problems, Route) and self._maps.labels_serve:
            # The batch asks for the paths of the search that its fields need.
            batch.compute_paths = lambda search: reader.paths(stored, search)
        return batch

    def own_maps(self, indices: Ints) -> None:
        """Return None: the problems are not drawn."""
        del indices


class DrawnSource:
    """Problems that are drawn anew in each epoch, each on its own map or on a substitute."""

    def __init__(
        self, maps: MapSource, serving: Serving, movement: Movement, count: int, *, draws_anew: bool
    ) -> None:
        """Keep the arguments.

        Args:
            maps: the maps. Problem i is first drawn on the map at the place i, or i // k if there
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
            ValueError: a problem is on none of as many maps as `most_maps` allows.
        """
        places = indices // self._drawing.source.per_map
        drawn = self._on_own_maps(places, indices, epoch, advance)
        most = most_maps(self._drawing.source, self.map_size, self._drawing.attempts)
        search = Search(self._drawing, most, len(indices), is_silent=_is_silent(advance))
        search.take(search.missing, 1, np.flatnonzero(drawn.has_problem))
        while len(search.missing):
            rows = search.next_rows(self._maps_at_once)
            row = search.first_in_vain(rows)
            if row is not None:
                tried = self._maps.tried_text(most)
                raise search.error(f"{tried} for problem {indices[row]} of epoch {epoch}")
            ahead = self._maps_ahead(search, rows)
            tried_rows = np.repeat(rows, ahead)
            numbers = search.tried[tried_rows] + np.tile(np.arange(ahead), len(rows))
            substitutes = self._maps.substitutes(indices[tried_rows], epoch, numbers)
            # A substitute has draws of its own, those of a problem beyond the end of the dataset.
            others = self._draw(substitutes, indices[tried_rows] + numbers * self._count, epoch)
            advance(len(substitutes))
            successes = np.flatnonzero(others.has_problem)
            found, first_successes = np.unique(tried_rows[successes], return_index=True)
            missing_count = len(search.missing)
            search.take(rows, ahead, found)
            _say_if_long(search, missing_count)
            if len(found):
                found_at = successes[first_successes]
                places[found] = substitutes[found_at]
                drawn = drawn.replaced(found, others, found_at)
        batch = _batch_on(
            self._maps,
            self._serving,
            self.movement,
            indices,
            places=places,
            grids=drawn.maps.grids,
            starts=drawn.starts,
            goals=drawn.goals,
            compute_map_numbers=lambda: drawn.numbers,
            compute_stored_maps=lambda: drawn.stored,
        )
        if drawn.paths is not None:
            batch.paths = drawn.paths
        return batch

    def _draw(self, places: Ints, keys: Ints, epoch: int) -> Drawn:
        """Draw a problem on each of the maps at these places."""
        with_seed_points = self._drawing.source.needs_seed_points
        given = self._maps.given_maps(places, with_seed_points=with_seed_points)
        return self._drawing.on(given, keys, epoch)

    def _on_own_maps(self, places: Ints, indices: Ints, epoch: int, advance: Advance) -> Drawn:
        """Draw problems on their own maps, some at a time."""
        parts = []
        for first in range(0, max(len(indices), 1), self._maps_at_once):
            part = slice(first, first + self._maps_at_once)
            parts.append(self._draw(places[part], indices[part], epoch))
            advance(len(indices[part]))
        return Drawn.joined(parts)

    def _maps_ahead(self, search: Search, rows: Ints) -> int:
        """Return how many substitutes of each of the problems ``rows`` are tried at once.

        On large maps with terrain it is one: a cost may be too high, which raises an error, and a
        map must not raise it that comes after the one that is served.
        """
        if self.has_terrain and may_have_high_costs(self.map_size):
            return 1
        return search.maps_ahead(rows, self._maps_at_once)

    def own_maps(self, indices: Ints) -> Ints:
        """Return the numbers of the maps on which problems are drawn first."""
        return self._maps.map_indices(indices // self._drawing.source.per_map)


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
        numbers = problem_set.map_indices[indices]
        maps = MapStack(*problem_set.maps_of(indices))
        starts = problem_set.starts[indices]
        goals = problem_set.goals[indices]

        def compute_rooms() -> Rooms:
            seed_points = np.stack((starts, goals), axis=1)
            matrices = room_matrices(search, numbers, maps, seed_points, self.movement)
            return Rooms(matrices, seed_points)

        def compute_paths(search: str) -> Paths | None:
            if search != "astar":
                return None
            optimal = selected_paths(problem_set.optimal, indices)
            return Paths(optimal.cells, optimal.offsets, optimal.iterations)

        return Batch(
            movement=self.movement,
            search=search,
            grids=maps.grids,
            starts=starts,
            goals=goals,
            problems=problem_set.problem_numbers[indices],
            compute_map_indices=numbers.copy,
            compute_rooms=compute_rooms,
            compute_map_numbers=lambda: numbers,
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
    places: Ints,
    grids: Bytes,
    starts: Ints,
    goals: Ints,
    compute_map_numbers: Callable[[], Ints],
    compute_stored_maps: Callable[[], MapStack],
) -> Batch:
    """Return problems as a batch whose paths and rooms are computed when they are needed.

    Args:
        maps: the maps.
        serving: how the problems are served.
        movement: the served one.
        indices: (B,) numbers of the problems.
        places: (B,) places of their maps.
        grids: (B, H, W), the maps as served.
        starts: (B, 2) cells.
        goals: (B, 2) cells.
        compute_map_numbers: returns the numbers of the maps, for errors.
        compute_stored_maps: returns the maps before inflation.
    """
    search = serving.search

    def compute_rooms() -> Rooms:
        stored_rooms = maps.stored_rooms(places, search)
        if stored_rooms is not None:
            return stored_rooms
        seed_points = maps.seed_points(places)
        numbers = places
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
        compute_map_indices=lambda: maps.map_indices(places),
        compute_rooms=compute_rooms,
        compute_map_numbers=compute_map_numbers,
        compute_stored_maps=compute_stored_maps,
        symmetries=np.zeros(len(indices), np.int64),
        requested_fields=serving.names,
        max_length=serving.max_length,
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


def _say_if_long(search: Search, missing_count: int) -> None:
    """Say once in each process that a batch takes long.

    Args:
        search: for the problems of the batch.
        missing_count: number of problems that were not found on the maps before the last ones.
    """
    count = len(search.tried)
    failed = int(search.tried.sum()) - count
    state = (
        f"no such problem at {failed:,} tries on a map, and {missing_count:,} of {count:,} "
        "problems of a batch still to find; wider conditions are faster"
    )
    if search.say_if_long(failed, state):
        _process["said_rare"] = True
