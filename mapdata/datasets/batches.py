"""`BatchReader`: batches of problems, read from the shards of a dataset by one kernel call each.

A kernel call for each shard would cost more than the reading itself. So the kernels get a table of
the addresses of the arrays of all open shards. A shard is opened when a problem of it is first
needed.
"""

from __future__ import annotations

import ctypes
from dataclasses import replace
from typing import Any, NamedTuple

import numba
import numpy as np
from numba import types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from mapdata.arrays import Bytes, Flags, Float32s, Int32s, Ints, offsets_of
from mapdata.datasets.fields import Rooms
from mapdata.generators.maps import WORD, unpack_map
from mapdata.jit import COMPILED, Int, kernel
from mapdata.limits import MAX_ROOMS, SPLITS
from mapdata.movement import STEPS, Movement
from mapdata.problems.drawing import Paths
from mapdata.problems.sources import Route, Source
from mapdata.search.footprint import inflate_all, min_squared_clearance
from mapdata.search.kernels import Scratch, search_memory
from mapdata.search.labels import connected_components, connections_serve, pairs_of
from mapdata.search.lattice import UNIT, Lattice, cells_of, load
from mapdata.search.map_stack import MapStack
from mapdata.shards.arrays import Shard, bits_per_move
from mapdata.shards.errors import ShardError
from mapdata.shards.locations import Locations
from mapdata.shards.manifest import Entry, Manifest
from mapdata.shards.root import Root

ARRAYS = (
    "maps",
    "room_offsets",
    "pair_offsets",
    "seeds",
    "bfs_offsets",
    "bfs_moves",
    "bfs_iterations",
    "bfs_straight",
    "astar_offsets",
    "astar_moves",
    "astar_iterations",
    "astar_straight",
    "astar_diagonal",
    "terrain",
)
"""The arrays of a shard that batches are read from, in the order of the address table's columns.

A shard of maps without terrain has no array ``terrain``. Its address is 0 then.
"""

_MAPS = ARRAYS.index("maps")
_ROOM_OFFSETS = ARRAYS.index("room_offsets")
_PAIR_OFFSETS = ARRAYS.index("pair_offsets")
_SEEDS = ARRAYS.index("seeds")
_DIAGONAL = ARRAYS.index("astar_diagonal")
_TERRAIN = ARRAYS.index("terrain")


class SearchColumns(NamedTuple):
    """Columns of the address table that hold the labels of one search.

    Attributes:
        offsets: where the moves of each segment begin.
        moves: the packed moves of all segments.
        iterations: the iterations of each segment.
        straight: the straight moves of each pair of rooms; by A* on terrain their costs.
    """

    offsets: int
    moves: int
    iterations: int
    straight: int


SEARCH_COLUMNS = {
    search: SearchColumns(
        offsets=ARRAYS.index(f"{search}_offsets"),
        moves=ARRAYS.index(f"{search}_moves"),
        iterations=ARRAYS.index(f"{search}_iterations"),
        straight=ARRAYS.index(f"{search}_straight"),
    )
    for search in ("bfs", "astar")
}

_VIEW_LENGTH = 2**40
"""The length of the views of arrays in kernels.

It is no real length. The shards were checked when they were opened, so no index leaves an array.
"""


class StoredProblems(NamedTuple):
    """Where B problems are stored.

    Attributes:
        shards: (B,) int64, number of the shard.
        maps: (B,) int64, number of the map in its shard.
        first_rooms: (B,) int64, the room where the problem starts, -1 for problems that are drawn.
        second_rooms: (B,) int64, the room of its goal, -1 for problems that are drawn.
    """

    shards: Ints
    maps: Ints
    first_rooms: Ints
    second_rooms: Ints


# --- views of arrays at an address --------------------------------------------------------------


def _view(array_type: Any, *row_shape: int) -> Any:
    """Return the code generator of a function that turns an address into an array.

    `numba.carray` generates the same code, but makes the first batch of a dataset compile slower:
    1.7 s instead of 1.4 s.

    Args:
        array_type: numba's type of the array.
        row_shape: shape of one row of the array.
    """
    item_size = array_type.dtype.bitwidth // 8

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        array = context.make_array(array_type)(context, builder)
        pointer = builder.inttoptr(arguments[0], array.data.type)
        shape = [context.get_constant(types.intp, n) for n in (_VIEW_LENGTH, *row_shape)]
        strides = [context.get_constant(types.intp, item_size * n) for n in (*row_shape, 1)]
        populate_array(array, pointer, shape, strides, item_size, None)  # type: ignore[no-untyped-call]
        return array._getvalue()

    return generate


@intrinsic
def _compiled_array(_context: Any, address: Any, dtype: Any) -> Any:
    """Do what `_plain_array` does in compiled code."""
    array_type = types.Array(dtype.dtype, 1, "C")
    return array_type(address, dtype), _view(array_type)


@intrinsic
def _compiled_cells(_context: Any, address: Any) -> Any:
    """Do what `_plain_cells` does in compiled code."""
    array_type = types.Array(types.int16, 2, "C")
    return array_type(address), _view(array_type, 2)


def _plain_array(address: Int, dtype: Any) -> Any:
    """Return the array at an address, as a view."""
    pointer = ctypes.c_void_p(int(address))
    return numba.carray(pointer, _VIEW_LENGTH, dtype)  # type: ignore[attr-defined]


def _plain_cells(address: Int) -> Any:
    """Return the cells at an address, as a view (_, 2)."""
    pointer = ctypes.c_void_p(int(address))
    return numba.carray(pointer, (_VIEW_LENGTH, 2), np.int16)  # type: ignore[attr-defined]


_array: Any = _compiled_array if COMPILED else _plain_array
_cells: Any = _compiled_cells if COMPILED else _plain_cells


# --- kernels ------------------------------------------------------------------------------------
# ``table`` (shards, columns) int64 holds the addresses of the arrays of all shards; the shards that
# a kernel reads must be open.


@kernel
def read_maps(table: Ints, shards: Ints, maps: Ints, grids: Bytes) -> None:
    """Unpack map ``maps[b]`` of shard ``shards[b]`` into ``grids[b]``, (B, H, W)."""
    words_per_row = (grids.shape[2] + WORD - 1) // WORD
    bytes_per_map = grids.shape[1] * words_per_row * (WORD // 8)
    for b in range(len(shards)):
        packed_maps = _array(table[shards[b], _MAPS], np.uint8)
        unpack_map(packed_maps, maps[b] * bytes_per_map, grids[b])


@kernel
def read_terrain(table: Ints, shards: Ints, maps: Ints, terrain: Bytes) -> None:
    """Copy the costs of map ``maps[b]`` of shard ``shards[b]`` into ``terrain[b]``, (B, H, W)."""
    cells_per_map = terrain.shape[1] * terrain.shape[2]
    for b in range(len(shards)):
        costs = _array(table[shards[b], _TERRAIN], np.uint8)
        first_cell = maps[b] * cells_per_map
        cells = terrain[b].reshape(-1)
        for k in range(cells_per_map):
            # Unsigned indices spare numba the test for negative ones.
            cells[np.uint64(k)] = costs[np.uint64(first_cell + k)]


@kernel
def read_seed_points(table: Ints, shards: Ints, maps: Ints, rooms: Ints, points: Ints) -> None:
    """Write the seed point of room ``rooms[b]`` of each map to ``points``, (B, 2)."""
    for b in range(len(shards)):
        room = _array(table[shards[b], _ROOM_OFFSETS], np.int64)[maps[b]] + rooms[b]
        seeds = _cells(table[shards[b], _SEEDS])
        points[b, 0] = seeds[room, 0]
        points[b, 1] = seeds[room, 1]


@kernel
def locate_paths(
    table: Ints,
    shards: Ints,
    maps: Ints,
    rooms: Ints,
    offsets_column: Int,
    iterations_column: Int,
    segments: Ints,
) -> None:
    """Locate the stored path from room ``rooms[b]`` to the next room of each map.

    Args:
        table: addresses of the arrays of all shards.
        shards: (B,) shard of each problem.
        maps: (B,) its map in the shard.
        rooms: (B,) its first room.
        offsets_column: the column of the offsets of the search's segments.
        iterations_column: the column of the search's iterations.
        segments: (3, B), filled with the number of the path's first move in its shard, the number
            of its moves, and the iterations of the search.
    """
    for b in range(len(shards)):
        shard = shards[b]
        # A map of n rooms has n - 1 segments. So m maps have m segments fewer than rooms, and the
        # segments of map m begin m places before its rooms.
        segment = _array(table[shard, _ROOM_OFFSETS], np.int64)[maps[b]] - maps[b] + rooms[b]
        offsets = _array(table[shard, offsets_column], np.int64)
        segments[0, b] = offsets[segment]
        segments[1, b] = offsets[segment + 1] - offsets[segment]
        segments[2, b] = _array(table[shard, iterations_column], np.int32)[segment]


@kernel
def read_paths(
    table: Ints,
    shards: Ints,
    maps: Ints,
    rooms: Ints,
    moves_column: Int,
    bits: Int,
    size: tuple[Int, Int],
    segments: Ints,
    cells: Ints,
    offsets: Ints,
) -> Int:
    """Read the paths that `locate_paths` located.

    Args:
        table: addresses of the arrays of all shards.
        shards: (B,) shard of each problem.
        maps: (B,) its map in the shard.
        rooms: (B,) its first room.
        moves_column: the column of the search's packed moves.
        bits: number of bits of a stored move, 2 or 4.
        size: (rows, columns) of a map.
        segments: (3, B), as from `locate_paths`.
        cells: (M, 2) with room for all paths, filled with them, one after another.
        offsets: (B + 1,), filled with where each path begins, and where the last one ends. Where
            there is no path, there are no cells.

    Returns:
        The number of the first damaged path, which leaves the map or ends elsewhere, or -1.
    """
    # A byte holds 8 / bits moves, the first of them in its lowest bits. So move k is in byte
    # k >> byte_shift, from bit (k & slot_mask) * bits on.
    byte_shift = np.uint64(4 // bits)
    slot_mask = np.uint64(8 // bits - 1)
    move_mask = np.uint64((1 << bits) - 1)
    height = np.uint64(size[0])
    width = np.uint64(size[1])
    cell_count = 0
    for b in range(len(shards)):
        shard = shards[b]
        first_move = segments[0, b]
        move_count = segments[1, b]
        room = _array(table[shard, _ROOM_OFFSETS], np.int64)[maps[b]] + rooms[b]
        seeds = _cells(table[shard, _SEEDS])
        row = np.int64(seeds[room, 0])
        column = np.int64(seeds[room, 1])
        goal_row = seeds[room + 1, 0]
        goal_column = seeds[room + 1, 1]
        packed_moves = _array(table[shard, moves_column], np.uint8)
        offsets[b] = cell_count
        if move_count == 0 and (row != goal_row or column != goal_column):
            continue  # there is no path
        cells[cell_count, 0] = row
        cells[cell_count, 1] = column
        for k in range(first_move, first_move + move_count):
            # Unsigned indices spare numba the test for negative ones.
            index = np.uint64(k)
            bit = np.uint8((index & slot_mask) * np.uint64(bits))
            move = np.uint64(packed_moves[index >> byte_shift] >> bit) & move_mask
            if move > 7:
                return b
            row += STEPS[move, 0]
            column += STEPS[move, 1]
            # A negative coordinate is a large number when it is taken as unsigned.
            if np.uint64(row) >= height or np.uint64(column) >= width:
                return b
            cell_count += 1
            cells[np.uint64(cell_count), 0] = row
            cells[np.uint64(cell_count), 1] = column
        cell_count += 1
        if row != goal_row or column != goal_column:
            return b
    offsets[len(shards)] = cell_count
    return -1


@kernel
def read_rooms(
    table: Ints,
    shards: Ints,
    maps: Ints,
    straight_column: Int,
    has_diagonals: Int,
    diagonal_cost: float,
    is_doubled: Int,
    max_rooms: Int,
) -> tuple[Float32s, Ints]:
    """Read the connection matrices and seed points of maps.

    Args:
        table: addresses of the arrays of all shards.
        shards: (B,) shard of each map.
        maps: (B,) the map in its shard.
        straight_column: the column of the search's straight moves.
        has_diagonals: whether diagonal moves are stored beside the straight ones.
        diagonal_cost: cost of a diagonal move.
        is_doubled: whether the stored costs are doubled, as those of A* on terrain are.
        max_rooms: R, rooms in a matrix.

    Returns:
        Matrices (B, R, R), -1 no connection, -2 padding; seed points (B, R, 2), -1 padding.
    """
    matrices = np.full((len(shards), max_rooms, max_rooms), -2, np.float32)
    seed_points = np.full((len(shards), max_rooms, 2), -1)
    for b in range(len(shards)):
        shard = shards[b]
        room_offsets = _array(table[shard, _ROOM_OFFSETS], np.int64)
        first_room = room_offsets[maps[b]]
        room_count = room_offsets[maps[b] + 1] - first_room
        pair = _array(table[shard, _PAIR_OFFSETS], np.int64)[maps[b]]
        seeds = _cells(table[shard, _SEEDS])
        straight_moves = _array(table[shard, straight_column], np.int32)
        diagonal_moves = _array(table[shard, _DIAGONAL], np.int32)
        for i in range(room_count):
            seed_points[b, i, 0] = seeds[first_room + i, 0]
            seed_points[b, i, 1] = seeds[first_room + i, 1]
            matrices[b, i, i] = 0
            for j in range(i + 1, room_count):
                cost = float(straight_moves[pair])  # -1 without a connection
                if has_diagonals and cost >= 0:
                    cost += diagonal_moves[pair] * diagonal_cost
                if is_doubled and cost >= 0:
                    cost /= 2
                matrices[b, i, j] = cost
                matrices[b, j, i] = cost
                pair += 1
    return matrices, seed_points


@kernel
def connected_problems(
    table: Ints,
    shard: Int,
    problems: Int32s,
    size: tuple[Int, Int],
    min_clearance: Int,
    lattice: Lattice,
    scratch: Scratch,
) -> Flags:
    """Return whether a path connects the two rooms of each problem of a shard, (P,) bool.

    Each map is labelled once for all of its problems.

    Args:
        table: addresses of the arrays of all shards.
        shard: number of the shard, an open one.
        problems: (P, 3) int32, (map in the shard, room, room), in ascending order of maps.
        size: (rows, columns) of a map.
        min_clearance: clearance of the cells that are free for the robot, as `inflate_all` takes
            it.
        lattice: of the maps.
        scratch: memory of the searches.
    """
    packed_maps = _array(table[shard, _MAPS], np.uint8)
    words_per_row = (size[1] + WORD - 1) // WORD
    bytes_per_map = size[0] * words_per_row * (WORD // 8)
    room_offsets = _array(table[shard, _ROOM_OFFSETS], np.int64)
    seeds = _cells(table[shard, _SEEDS])
    grids = np.empty((1, size[0], size[1]), np.uint8)
    components = np.empty(0, np.int64)  # of the rooms of the labelled map
    connected = np.empty(len(problems), np.bool_)
    labelled_map: Int = -1
    for p in range(len(problems)):
        map_index = np.int64(problems[p, 0])
        if map_index != labelled_map:
            labelled_map = map_index
            unpack_map(packed_maps, map_index * bytes_per_map, grids[0])
            inflate_all(grids, min_clearance)
            load(grids[0], scratch.came_from)
            rooms = seeds[room_offsets[map_index] : room_offsets[map_index + 1]]
            components = connected_components(cells_of(rooms, lattice), lattice, scratch)
        component = components[problems[p, 1]]
        connected[p] = component >= 0 and component == components[problems[p, 2]]
    return connected


# --- the reader ---------------------------------------------------------------------------------


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
        if problems.is_stored and not problems.unsolvable:
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
