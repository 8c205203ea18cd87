"""`BatchReader`: batches of problems, read from the shards of a dataset by one kernel call each.

The kernels are in `mapdata.datasets.stored_arrays`. A shard is opened when a problem of it is first
needed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mapdata.arrays import Bytes, Int32s, Ints, offsets_of
from mapdata.datasets.fields import Rooms
from mapdata.datasets.stored_arrays import (
    ARRAYS,
    SEARCH_COLUMNS,
    StoredProblems,
    connected_problems,
    locate_paths,
    read_maps,
    read_paths,
    read_rooms,
    read_seed_points,
    read_terrain,
)
from mapdata.limits import MAX_ROOMS, SPLITS
from mapdata.movement import Movement
from mapdata.problems.drawing import Paths
from mapdata.problems.sources import Pairs, Route, Source
from mapdata.search.footprint import min_squared_clearance
from mapdata.search.kernels import search_memory
from mapdata.search.labels import connections_serve, pairs_of
from mapdata.search.lattice import UNIT
from mapdata.search.map_stack import MapStack
from mapdata.shards.arrays import Shard, bits_per_move
from mapdata.shards.errors import ShardError
from mapdata.shards.locations import Locations
from mapdata.shards.manifest import Entry, Manifest
from mapdata.shards.root import Root


class BatchReader:
    """The shards of a dataset, and the problems in them.

    Attributes:
        root, shards, manifests: the dataset.
        map_size: (rows, columns) of all its maps.
        movement: of the stored labels.
        has_terrain: whether the maps have terrain.
        max_seed_points: R, the largest number of seed points that a map can have.
        min_clearance: clearance of the cells that are served as free, as from
            `min_squared_clearance`.
        offsets: number of the first problem of each shard, and of all problems.
    """

    def __init__(
        self,
        root: Locations,
        split: str | None,
        problems: Source,
        radius: float,
        movement: Movement | None = None,
        follow_links: bool = False,
    ) -> None:
        """Read the manifests; no shard is opened yet.

        Args:
            root: folder or URL of a dataset, or several of them.
            split: "train", "val", "test" or None for all.
            problems: which problems are served.
            radius: of the robot, in metres.
            movement: the served movement; None for the stored one.
            follow_links: read files that are links out of their folder.

        Raises:
            DatasetNotFoundError, ShardError, ValueError: as `Root.open`; no shard is finished.
        """
        self.root = Root.open(root, follow_links=follow_links)
        self.root.check_begun()
        self.shards = self.root.shards
        self.manifests = self.root.manifests
        self.map_size = self.root.map_size
        self.movement = self.root.movement
        self.has_terrain = self.root.has_terrain
        self.max_seed_points = max(manifest.max_seed_points for manifest in self.manifests)
        if self.max_seed_points > MAX_ROOMS:
            raise ShardError(
                f"{self.root}: the manifest says maps of {self.max_seed_points} rooms, expected "
                f"up to {MAX_ROOMS}"
            )
        self._split = split
        # `Root.resolution` refuses roots of several resolutions, which matter only with a radius.
        self.min_clearance = min_squared_clearance(radius, self.root.resolution) if radius else 0
        served_movement = movement or self.movement
        self._cuts_corners = served_movement.corner_cutting
        self._problems = problems
        self._labels_decide = True
        if isinstance(problems, Route | Pairs) and not problems.unsolvable:
            # Problems without a path are left out. The stored labels may say which.
            self._labels_decide = connections_serve(
                self.movement, served_movement, self.min_clearance
            )
            if self._cuts_corners and not self.movement.corner_cutting:
                # Problems without a stored path may have one that cuts corners.
                self._problems = replace(problems, unsolvable=True)
        self.offsets = offsets_of([self._problem_count(entry) for _, _, entry in self.shards])
        # Row k holds the addresses of the `ARRAYS` of shard k, and zeros until it is opened.
        self._addresses = np.zeros((len(self.shards), len(ARRAYS)), np.int64)
        self._first_maps = np.array([entry.start for _, _, entry in self.shards])
        self._first_indices = np.array([first + entry.start for _, first, entry in self.shards])
        self._open: dict[int, Shard] = {}
        # Row p is (map in its shard, room, room) of problem p. The rows of a shard are filled when
        # it is opened.
        try:
            self._rows = np.empty((self.offsets[-1], 3), np.int32)
        except (MemoryError, ValueError):
            raise ShardError(
                f"{self.root}: the manifest says {self.offsets[-1]} problems, more than memory "
                "holds"
            ) from None

    def __len__(self) -> int:
        """Return the number of problems."""
        return int(self.offsets[-1])

    def locate(self, indices: Ints) -> StoredProblems:
        """Return where problems are stored, after opening their shards.

        Raises:
            ShardError, ConnectionError: as `open`.
        """
        shards = np.searchsorted(self.offsets, indices, side="right") - 1
        unopened = shards[self._addresses[shards, 0] == 0]
        for k in set(unopened.tolist()):
            self.open(k)
        maps, first_rooms, second_rooms = np.ascontiguousarray(self._rows[indices].T, np.int64)
        return StoredProblems(shards, maps, first_rooms, second_rooms)

    def open(self, k: int) -> Shard:
        """Return shard ``k``; the first call opens and checks it.

        When a dataset grows, a shard may be replaced by a larger one after the manifest was read.
        Then the larger one is opened, whose first maps are the same.

        Raises:
            ShardError: the file is missing, or is not what the manifest says.
            ConnectionError: the file is at a URL, and cannot be fetched.
        """
        # The addresses are written last, because other threads test them without a lock.
        if self._addresses[k, 0]:
            return self._open[k]
        location, _, entry = self.shards[k]
        try:
            shard = self.root.open_shard(k)
        except (FileNotFoundError, ShardError):
            current_root = Root.open(
                self.root.locations[location], follow_links=self.root.follow_links
            )
            successor = _successor(self.manifests[location], current_root.manifests[0], entry)
            if successor is None:
                raise
            shard = current_root.open_shard(successor)
        # The kernels write as many seed points into arrays of `max_seed_points` without a check.
        if np.diff(shard.arrays["room_offsets"]).max(initial=0) > self.max_seed_points:
            raise ShardError(
                f"{shard.path}: holds a map of more rooms than the manifest says "
                f"({self.max_seed_points})"
            )
        rows = problem_rows(shard, self._split, self._problems)
        rows = rows[rows[:, 0] < entry.maps]  # a larger successor holds further maps
        first, stop = self.offsets[k : k + 2].tolist()
        if len(rows) != stop - first:
            raise ShardError(
                f"{shard.path}: holds {len(rows)} problems, the manifest says {stop - first}"
            )
        self._rows[first:stop] = rows
        # If two threads open a shard at once, the first shard stays: a kernel may be reading its
        # arrays already.
        shard = self._open.setdefault(k, shard)
        self._addresses[k] = [
            shard.arrays[name].ctypes.data if name in shard.arrays else 0 for name in ARRAYS
        ]
        return shard

    def solvable_problems(self) -> Ints | None:
        """Return the numbers of the problems that have a path as they are served, ascending.

        None stands for all problems, where the stored labels have decided already. Otherwise all
        shards are opened and their maps are labelled under the served movement and radius.

        Raises:
            ShardError, ConnectionError: as `open`.
        """
        if self._labels_decide:
            return None
        connected = np.empty(len(self), np.bool_)
        # Diagonal moves connect more cells than straight ones only if they cut corners. Then the
        # rule has diagonals of kind 2; a path need not be optimal here, so each move costs 1.
        diagonals = 2 if self._cuts_corners else 0
        lattice, scratch = search_memory(self.map_size, (diagonals, UNIT))
        for k in range(len(self.shards)):
            self.open(k)
            first, stop = self.offsets[k : k + 2].tolist()
            connected[first:stop] = connected_problems(
                self._addresses,
                k,
                self._rows[first:stop],
                self.map_size,
                self.min_clearance,
                lattice,
                scratch,
            )
        return np.flatnonzero(connected)

    def _problem_count(self, entry: Entry) -> int:
        """Return the number of served problems of a shard, as its manifest says.

        Raises:
            ShardError: a number that the file cannot hold.
        """
        splits = [self._split] if self._split else SPLITS
        counts = stored_counts(entry, self._problems)
        count = sum(counts[split] for split in splits)
        # Memory is reserved for all problems before their shards are opened. Each problem takes
        # more than a byte of its file, so a false number is refused here.
        if count > entry.bytes:
            raise ShardError(
                f"{entry.name}: the manifest says {count} problems in {entry.bytes} bytes"
            )
        return count

    def grids(self, stored: StoredProblems) -> Bytes:
        """Return the maps of problems, (B, H, W), that are not inflated."""
        grids = np.empty((len(stored.shards), *self.map_size), np.uint8)
        read_maps(self._addresses, stored.shards, stored.maps, grids)
        return grids

    def stored_maps(self, stored: StoredProblems, grids: Bytes) -> MapStack:
        """Return the maps of problems, whose ``grids`` (B, H, W) are read already."""
        terrain = None
        if self.has_terrain:
            terrain = np.empty((len(stored.shards), *self.map_size), np.uint8)
            read_terrain(self._addresses, stored.shards, stored.maps, terrain)
        return MapStack(grids, terrain)

    def map_numbers(self, stored: StoredProblems) -> Ints:
        """Return the number of each map in its own dataset, also where there are several roots."""
        return self._first_maps[stored.shards] + stored.maps

    def map_indices(self, stored: StoredProblems) -> Ints:
        """Return the number of each map, (B,), counted over all roots, as in `Root.labels`."""
        return self._first_indices[stored.shards] + stored.maps

    def seed_points(self, stored: StoredProblems, rooms: Ints) -> Ints:
        """Return the seed point of room ``rooms[b]`` of each map, (B, 2)."""
        points = np.empty((len(stored.shards), 2), np.int64)
        read_seed_points(self._addresses, stored.shards, stored.maps, rooms, points)
        return points

    def split_codes(self, stored: StoredProblems) -> Ints:
        """Return the split of each problem, (B,): its number in `SPLITS`."""
        codes = np.empty(len(stored.shards), np.int64)
        for k in np.unique(stored.shards).tolist():
            in_shard = stored.shards == k
            codes[in_shard] = self.open(k).arrays["split"][stored.maps[in_shard]]
        return codes

    def paths(self, stored: StoredProblems, search: str) -> Paths:
        """Return the stored paths from the first room of each problem to the next room.

        Raises:
            ShardError: a stored path leaves the map or does not end at its goal.
        """
        shards, maps, rooms, _ = stored
        columns = SEARCH_COLUMNS[search]
        segments = np.empty((3, len(shards)), np.int64)
        locate_paths(
            self._addresses, shards, maps, rooms, columns.offsets, columns.iterations, segments
        )
        move_counts = segments[1]
        iterations = segments[2]
        max_cells = move_counts.sum() + len(shards)  # a path of k moves has k + 1 cells
        cells = np.empty((max_cells, 2), np.int64)
        offsets = np.empty(len(shards) + 1, np.int64)
        damaged = read_paths(
            self._addresses,
            shards,
            maps,
            rooms,
            columns.moves,
            bits_per_move(self.movement),
            self.map_size,
            segments,
            cells,
            offsets,
        )
        if damaged >= 0:
            location, _, entry = self.shards[shards[damaged]]
            file = f"{self.root.locations[location]}/{entry.name}"
            map_number = entry.start + maps[damaged]
            raise ShardError(f"{file}: a stored path of map {map_number} is damaged")
        return Paths(cells[: offsets[-1]], offsets, iterations)

    def rooms(self, stored: StoredProblems, search: str) -> Rooms:
        """Return the stored connection matrices (B, R, R) and the seed points (B, R, 2)."""
        matrices, seed_points = read_rooms(
            self._addresses,
            stored.shards,
            stored.maps,
            SEARCH_COLUMNS[search].straight,
            search == "astar" and self.movement.connectivity == 8,
            self.movement.diagonal_cost,
            search == "astar" and self.has_terrain,
            self.max_seed_points,
        )
        return Rooms(matrices, seed_points)


def stored_counts(entry: Entry, problems: Source) -> dict[str, int]:
    """Return the number of problems of a shard by split, under the stored movement.

    Args:
        entry: of the shard in its manifest.
        problems: which problems are counted.
    """
    names = [problems.counted]
    if problems.unsolvable:
        names.append(f"{problems.counted}_unsolvable")
    return {split: sum(int(entry.counts[split][name]) for name in names) for split in SPLITS}


def _successor(manifest: Manifest, current: Manifest, entry: Entry) -> int | None:
    """Return the number of the shard that holds the maps of ``entry`` now.

    Args:
        manifest: the manifest that was read first, with ``entry``.
        current: the manifest of now.
        entry: a shard that could not be opened.

    Returns:
        None if the shard is unchanged, or if it was replaced by other maps.
    """
    same_recipe = manifest.identity is not None and manifest.identity == current.identity
    for k, candidate in enumerate(current.shards):
        covers = candidate.start == entry.start and candidate.stop >= entry.stop
        # Without a recipe only the hash shows that maps are the same.
        same_maps = same_recipe or (
            candidate.stop == entry.stop and candidate.content_hash == entry.content_hash
        )
        if covers and same_maps and candidate != entry:
            return k
    return None


def problem_rows(shard: Shard, split: str | None, problems: Source) -> Int32s:
    """Return the problems of a shard, (P, 3) int32: map, room, room.

    The rooms of a problem that is drawn later are -1.
    """
    arrays = shard.arrays
    room_counts = np.diff(arrays["room_offsets"])
    if not problems.is_stored:
        maps = np.arange(len(room_counts))
        no_room = np.full_like(maps, -1)
        rows = np.stack((maps, no_room, no_room), axis=1).astype(np.int32)
    else:
        pair_counts = room_counts * (room_counts - 1) // 2
        maps = np.repeat(np.arange(len(room_counts)), pair_counts)
        first, second = np.concatenate([pairs_of(n) for n in room_counts.tolist()], axis=1)
        rows = np.stack((maps, first, second), axis=1).astype(np.int32)
        seed_points = arrays["seeds"]
        first_room = arrays["room_offsets"][maps]
        starts = seed_points[first_room + first]
        goals = seed_points[first_room + second]
        ends_differ = (starts != goals).any(axis=1)
        has_path = arrays["astar_straight"] >= 0
        is_served = np.where(has_path, ends_differ, problems.unsolvable)
        if isinstance(problems, Route):
            is_served &= second == first + 1
        rows = rows[is_served]
    if split is not None:
        rows = rows[arrays["split"][rows[:, 0]] == SPLITS.index(split)]
    return rows
