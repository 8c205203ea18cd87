"""The shards behind a dataset, opened at first touch and read by one kernel a batch.

A kernel call for each shard would cost more than the work, so the kernels get the addresses of the
arrays of all open shards.
"""

from __future__ import annotations

import ctypes
from dataclasses import replace
from typing import Any

import numba
import numpy as np
from numba import types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from mapdata.arrays import Bytes, Flags, Float32s, Int32s, Ints, offsets_of
from mapdata.datasets.fields import Paths, Rooms
from mapdata.generators.maps import WORD, unpack_map
from mapdata.jit import COMPILED, Int, kernel
from mapdata.limits import MAX_ROOMS, SPLITS
from mapdata.movement import STEPS, Movement
from mapdata.problems.sources import Random, Route, Source
from mapdata.search.footprint import inflate_all, min_squared_clearance
from mapdata.search.kernels import new_scratch
from mapdata.search.labels import connected_components, pairs_of
from mapdata.search.lattice import BFS, UNIT, MoveRule, cells_of, lattice_of, load
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
)
"""The arrays that batches are read from: the columns of the address table."""

_MAPS, _ROOMS, _PAIRS, _SEEDS, _DIAGONAL = 0, 1, 2, 3, 12


_LONG = 2**40
"""The length of each view that kernels take: who opened the shard has checked where its arrays
end.
"""


def _view(array_type: Any, *row: int) -> Any:
    """Return what generates the code of a view: the array at an address, whose rows are ``row``.

    `numba.carray` does the same, and takes several times as long to compile.
    """
    item = array_type.dtype.bitwidth // 8

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        array = context.make_array(array_type)(context, builder)
        data = builder.inttoptr(arguments[0], array.data.type)
        shape = [context.get_constant(types.intp, length) for length in (_LONG, *row)]
        strides = [context.get_constant(types.intp, item * step) for step in (*row, 1)]
        populate_array(array, data, shape, strides, item, None)  # type: ignore[no-untyped-call]
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
    return numba.carray(ctypes.c_void_p(int(address)), _LONG, dtype)  # type: ignore[attr-defined]


def _plain_cells(address: Int) -> Any:
    """Return the seed points at an address, as a view (_, 2)."""
    pointer = ctypes.c_void_p(int(address))
    return numba.carray(pointer, (_LONG, 2), np.int16)  # type: ignore[attr-defined]


_array: Any = _compiled_array if COMPILED else _plain_array
_cells: Any = _compiled_cells if COMPILED else _plain_cells


@kernel
def read_maps(table: Ints, shards: Ints, maps: Ints, grids: Bytes) -> None:
    """Unpack map ``maps[b]`` of shard ``shards[b]`` into ``grids[b]``, (B, H, W)."""
    octets = grids.shape[1] * ((grids.shape[2] + WORD - 1) // WORD) * (WORD // 8)
    for b in range(len(shards)):
        unpack_map(_array(table[shards[b], _MAPS], np.uint8), maps[b] * octets, grids[b])


@kernel
def read_seed_points(table: Ints, shards: Ints, maps: Ints, rooms: Ints, points: Ints) -> None:
    """Write the seed point of room ``rooms[b]`` of each map to ``points``, (B, 2)."""
    for b in range(len(shards)):
        room = _array(table[shards[b], _ROOMS], np.int64)[maps[b]] + rooms[b]
        stored = _cells(table[shards[b], _SEEDS])
        points[b, 0] = stored[room, 0]
        points[b, 1] = stored[room, 1]


@kernel
def find_paths(
    table: Ints, shards: Ints, maps: Ints, rooms: Ints, search: Int, paths: Ints
) -> None:
    """Find the stored path from room ``rooms[b]`` to the next one of each map.

    ``paths`` (3, B) is filled with its first move in the shard, its number of moves, and the
    iterations of the search.
    """
    for b in range(len(shards)):
        shard = shards[b]
        # A map of n rooms has n - 1 segments, so those of map m begin m before its rooms.
        segment = _array(table[shard, _ROOMS], np.int64)[maps[b]] - maps[b] + rooms[b]
        moves = _array(table[shard, search], np.int64)
        paths[0, b] = moves[segment]
        paths[1, b] = moves[segment + 1] - moves[segment]
        paths[2, b] = _array(table[shard, search + 2], np.int32)[segment]


@kernel
def read_paths(
    table: Ints,
    shards: Ints,
    maps: Ints,
    rooms: Ints,
    search: Int,
    bits: Int,
    size: tuple[Int, Int],
    paths: Ints,
    cells: Ints,
    offsets: Ints,
) -> Int:
    """Read the paths that `find_paths` found.

    Args:
        table: addresses of the arrays of all shards.
        shards: (B,) shard of each problem, an open one.
        maps: (B,) its map in the shard.
        rooms: (B,) its first room.
        search: the column of the table where the arrays of the search begin.
        bits: of a stored move.
        size: (rows, columns) of a map.
        paths: as from `find_paths`.
        cells: (M, 2) with room for all paths, filled with them, one after another.
        offsets: (B + 1,), filled with where each path begins, and where the last one ends. A path
            that does not arrive has no cells.

    Returns:
        The number of the first damaged path, which leaves the map or ends elsewhere, or -1.
    """
    # Move k stands in byte k >> shift, and there from bit (k & within) * bits on.
    shift = np.uint64(4 // bits)
    within = np.uint64(8 // bits - 1)
    mask = np.uint64((1 << bits) - 1)
    height = np.uint64(size[0])
    width = np.uint64(size[1])
    at = 0
    for b in range(len(shards)):
        shard = shards[b]
        length = paths[1, b]
        room = _array(table[shard, _ROOMS], np.int64)[maps[b]] + rooms[b]
        stored = _cells(table[shard, _SEEDS])
        row = np.int64(stored[room, 0])
        column = np.int64(stored[room, 1])
        goal_row = stored[room + 1, 0]
        goal_column = stored[room + 1, 1]
        packed = _array(table[shard, search + 1], np.uint8)
        offsets[b] = at
        if length == 0 and (row != goal_row or column != goal_column):
            continue
        cells[at, 0] = row
        cells[at, 1] = column
        for k in range(paths[0, b], paths[0, b] + length):
            place = np.uint64(k)
            bit = np.uint8((place & within) * np.uint64(bits))
            move = np.uint64(packed[place >> shift] >> bit) & mask
            if move > 7:
                return b
            row += STEPS[move, 0]
            column += STEPS[move, 1]
            # As unsigned numbers, those below 0 are large.
            if np.uint64(row) >= height or np.uint64(column) >= width:
                return b
            at += 1
            cells[np.uint64(at), 0] = row
            cells[np.uint64(at), 1] = column
        at += 1
        if row != goal_row or column != goal_column:
            return b
    offsets[len(shards)] = at
    return -1


@kernel
def read_rooms(
    table: Ints,
    shards: Ints,
    maps: Ints,
    straight: Int,
    has_diagonals: Int,
    diagonal_cost: float,
    most: Int,
) -> tuple[Float32s, Ints]:
    """Return connection matrices (B, R, R), -2 padding, and seed points (B, R, 2), -1 padding.

    R is ``most``.
    """
    matrices = np.full((len(shards), most, most), -2, np.float32)
    seed_points = np.full((len(shards), most, 2), -1)
    for b in range(len(shards)):
        shard = shards[b]
        rooms = _array(table[shard, _ROOMS], np.int64)
        first = rooms[maps[b]]
        last = rooms[maps[b] + 1]
        pair = _array(table[shard, _PAIRS], np.int64)[maps[b]]
        stored = _cells(table[shard, _SEEDS])
        moves = _array(table[shard, straight], np.int32)
        diagonals = _array(table[shard, _DIAGONAL], np.int32)
        for i in range(last - first):
            seed_points[b, i, 0] = stored[first + i, 0]
            seed_points[b, i, 1] = stored[first + i, 1]
            matrices[b, i, i] = 0
            for j in range(i + 1, last - first):
                cost = float(moves[pair])
                if has_diagonals and cost >= 0:
                    cost += diagonals[pair] * diagonal_cost
                matrices[b, i, j] = matrices[b, j, i] = cost
                pair += 1
    return matrices, seed_points


@kernel
def connected_problems(
    table: Ints, shard: Int, problems: Int32s, size: tuple[Int, Int], least: Int, rule: MoveRule
) -> Flags:
    """Return whether a path connects the two rooms of each problem of a shard, (P,) bool.

    Each map is labelled once for all of its problems.

    Args:
        table: addresses of the arrays of all shards.
        shard: which of them, an open one.
        problems: (P, 3) int32, (map in the shard, room, room), in ascending order of maps.
        size: (rows, columns) of a map.
        least: clearance of the cells that are free for the robot, as `inflate_all` takes it.
        rule: of movement.
    """
    packed = _array(table[shard, _MAPS], np.uint8)
    octets = size[0] * ((size[1] + WORD - 1) // WORD) * (WORD // 8)
    offsets = _array(table[shard, _ROOMS], np.int64)
    stored = _cells(table[shard, _SEEDS])
    grids = np.empty((1, size[0], size[1]), np.uint8)
    lattice = lattice_of(size, rule)
    scratch = new_scratch(BFS, lattice)
    components = np.empty(0, np.int64)
    connected = np.empty(len(problems), np.bool_)
    labelled_map: Int = -1
    for p in range(len(problems)):
        number = np.int64(problems[p, 0])
        if number != labelled_map:
            labelled_map = number
            unpack_map(packed, number * octets, grids[0])
            inflate_all(grids, least)
            load(grids[0], scratch.came_from)
            cells = cells_of(stored[offsets[number] : offsets[number + 1]], lattice)
            components = connected_components(cells, lattice, scratch)
        first = components[problems[p, 1]]
        connected[p] = first >= 0 and first == components[problems[p, 2]]
    return connected


class BatchReader:
    """The shards of a dataset, and the problems in them.

    Attributes:
        root, shards, manifests: the dataset.
        map_size: of all its maps.
        movement: of the stored labels.
        most_seed_points: R, the largest number of seed points that a map can have.
        least: clearance of the cells that are served as free, as `min_squared_clearance` gives it.
    """

    def __init__(
        self,
        root: Locations,
        split: str | None,
        problems: Source,
        radius: float,
        movement: Movement | None = None,
    ) -> None:
        """Read the manifests; no shard is opened yet.

        Args:
            root: as in `MapDataset`, like the others.
            split: "train", "val", "test" or None for all.
            problems: what is asked of the maps.
            radius: of the robot, in metres.
            movement: that is served; None for the stored one.

        Raises:
            DatasetNotFoundError, ShardError, ValueError: as `Root.open`; no shard is finished.
        """
        self.root = Root.open(root)
        self.root.check_begun()
        self.shards = self.root.shards
        self.manifests = self.root.manifests
        self.map_size = self.root.map_size
        self.movement = self.root.movement
        self.most_seed_points = max(manifest.max_seed_points for manifest in self.manifests)
        if self.most_seed_points > MAX_ROOMS:  # matrices have room for all
            raise ShardError(
                f"{self.root}: the manifest says maps of {self.most_seed_points} rooms, expected "
                f"up to {MAX_ROOMS}"
            )
        self._split = split
        # only with a radius must all roots have one resolution
        self.least = min_squared_clearance(radius, self.root.resolution) if radius else 0
        self._cuts_corners = (movement or self.movement).corner_cutting
        self._problems = problems
        self._labels_decide = True
        if not isinstance(problems, Random) and not problems.unsolvable:
            # Straight moves and diagonal ones beside two free cells connect the same cells, since
            # two straight moves lead where such a diagonal one leads. Cutting corners connects
            # more, and a radius less, than the stored labels say.
            is_same_rule = self._cuts_corners == self.movement.corner_cutting
            self._labels_decide = is_same_rule and self.least <= 1
            if self._cuts_corners and not is_same_rule:
                # Of the problems without a stored path, some have a path here.
                self._problems = replace(problems, unsolvable=True)
        self.offsets = offsets_of([self._count(entry) for _, _, entry in self.shards])
        # of the arrays of each shard, for the kernels; 0 before it is opened
        self._addresses = np.zeros((len(self.shards), len(ARRAYS)), np.int64)
        self._open: dict[int, Shard] = {}
        # Room for (map in the shard, room, room) of every problem; a shard's rows are filled when
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

    def find(self, indices: Ints) -> tuple[Ints, Ints, Ints, Ints]:
        """Return (shard, map in the shard, room, room) of each problem, and open its shard."""
        shards = np.searchsorted(self.offsets, indices, side="right") - 1
        unopened = shards[self._addresses[shards, 0] == 0]
        for k in set(unopened.tolist()):
            self.open(k)
        maps, first, second = np.ascontiguousarray(self._rows[indices].T, np.int64)
        return shards, maps, first, second

    def open(self, k: int) -> Shard:
        """Return shard ``k``, opened and checked at its first touch.

        A larger file may have taken its place since: its first maps are the same.

        Raises:
            ShardError: the file is gone, or not what the manifest says.
            ConnectionError: it lies at a URL, and cannot be fetched.
        """
        if self._addresses[k, 0]:  # which come last: another thread may be about to write them
            return self._open[k]
        place, _, entry = self.shards[k]
        try:
            shard = self.root.open_shard(k)
        except (FileNotFoundError, ShardError):
            # It may have been replaced since the manifest was read, as by a larger one when the
            # dataset grew.
            now = Root.open(self.root.locations[place])
            successor = _successor(self.manifests[place], now.manifests[0], entry)
            if successor is None:
                raise
            shard = now.open_shard(successor)
        # Kernels rely on it.
        if np.diff(shard.arrays["room_offsets"]).max(initial=0) > self.most_seed_points:
            raise ShardError(
                f"{shard.path}: holds a map of more rooms than the manifest says "
                f"({self.most_seed_points})"
            )
        rows = problem_rows(shard, self._split, self._problems)
        rows = rows[rows[:, 0] < entry.maps]  # of a successor, too
        first, last = self.offsets[k : k + 2].tolist()
        if len(rows) != last - first:
            raise ShardError(
                f"{shard.path}: holds {len(rows)} problems, the manifest says {last - first}"
            )
        self._rows[first:last] = rows  # which has room for the problems of all shards
        # Of two threads, the first one's: a kernel may be using its addresses.
        shard = self._open.setdefault(k, shard)
        self._addresses[k] = [shard.arrays[name].ctypes.data for name in ARRAYS]
        return shard

    def solvable(self) -> Ints | None:
        """Return the numbers of the problems that have a path as they are served, ascending.

        None where these are all problems, or where those without a path are wanted, too. Else the
        maps are labelled under the served movement and radius, for which every shard is opened.

        Raises:
            ShardError, ConnectionError: as `open`.
        """
        if self._labels_decide:
            return None
        connected = np.empty(len(self), np.bool_)
        # Of the moves only those that cut corners connect more cells than straight ones do.
        rule = (2 if self._cuts_corners else 0, UNIT)
        for k in range(len(self.shards)):
            self.open(k)
            problems = slice(*self.offsets[k : k + 2].tolist())
            connected[problems] = connected_problems(
                self._addresses, k, self._rows[problems], self.map_size, self.least, rule
            )
        return np.flatnonzero(connected)

    def _count(self, entry: Entry) -> int:
        names = [self._problems.counted]
        if self._problems.unsolvable:
            names.append(f"{self._problems.counted}_unsolvable")
        splits = [self._split] if self._split else SPLITS
        count = sum(int(entry.counts[split][name]) for split in splits for name in names)
        if count > entry.bytes:  # room is made for all, and each takes more than a byte
            raise ShardError(
                f"{entry.name}: the manifest says {count} problems in {entry.bytes} bytes"
            )
        return count

    def grids(self, shards: Ints, maps: Ints) -> Bytes:
        """Return the maps for a robot of the radius, (B, H, W)."""
        grids = np.empty((len(shards), *self.map_size), np.uint8)
        read_maps(self._addresses, shards, maps, grids)
        if self.least > 1:  # else nothing changes, and the kernel need not be compiled
            inflate_all(grids, self.least)
        return grids

    def seed_points(self, shards: Ints, maps: Ints, rooms: Ints) -> Ints:
        """Return the seed of one room of each map, (B, 2)."""
        points = np.empty((len(shards), 2), np.int64)
        read_seed_points(self._addresses, shards, maps, rooms, points)
        return points

    def paths(self, shards: Ints, maps: Ints, rooms: Ints, search: str) -> Paths:
        """Return the stored paths from each room to the next.

        Raises:
            ShardError: a stored path leaves the map or does not end at its goal.
        """
        bits = bits_per_move(self.movement)
        column = ARRAYS.index(f"{search}_offsets")
        paths = np.empty((3, len(shards)), np.int64)
        find_paths(self._addresses, shards, maps, rooms, column, paths)
        cells = np.empty((paths[1].sum() + len(shards), 2), np.int64)  # a move less than cells
        offsets = np.empty(len(shards) + 1, np.int64)
        bad = read_paths(
            self._addresses,
            shards,
            maps,
            rooms,
            column,
            bits,
            self.map_size,
            paths,
            cells,
            offsets,
        )
        if bad >= 0:
            place, _, entry = self.shards[shards[bad]]
            path = f"{self.root.locations[place]}/{entry.name}"
            number = entry.start + maps[bad]
            raise ShardError(f"{path}: a stored path of map {number} is damaged")
        return Paths(cells[: offsets[-1]], offsets, paths[2])

    def rooms(self, shards: Ints, maps: Ints, search: str) -> Rooms:
        """Return the stored connection matrices (B, R, R) and the seed points (B, R, 2)."""
        found = read_rooms(
            self._addresses,
            shards,
            maps,
            ARRAYS.index(f"{search}_straight"),
            search == "astar" and self.movement.connectivity == 8,
            self.movement.diagonal_cost,
            self.most_seed_points,
        )
        return Rooms(*found)


def _successor(before: Manifest, now: Manifest, entry: Entry) -> int | None:
    """Return which shard holds the maps of ``entry`` now.

    None where it is the same shard, or where other maps took their place.
    """
    drawn = before.identity is not None and before.identity == now.identity
    for k, other in enumerate(now.shards):
        same = drawn or (other.stop, other.content_hash) == (entry.stop, entry.content_hash)
        if same and other.start == entry.start and other.stop >= entry.stop and other != entry:
            return k
    return None


def problem_rows(shard: Shard, split: str | None, problems: Source) -> Int32s:
    """Return (P, 3) of the problems in a shard: map, room, room (-1 where problems are drawn)."""
    arrays = shard.arrays
    rooms = np.diff(arrays["room_offsets"])
    maps = np.arange(len(rooms))
    if isinstance(problems, Random):
        first = second = np.full_like(maps, -1)
        keep = np.ones_like(maps, np.bool_)
    else:
        maps = np.repeat(maps, rooms * (rooms - 1) // 2)
        first, second = np.concatenate([pairs_of(n) for n in rooms.tolist()], axis=1)
        seed_points = arrays["seeds"]
        base = arrays["room_offsets"][maps]
        solvable = arrays["astar_straight"] >= 0
        same = (seed_points[base + first] == seed_points[base + second]).all(axis=1)
        keep = np.where(solvable, ~same, problems.unsolvable)
        if isinstance(problems, Route):
            keep &= second == first + 1
    rows = np.stack((maps, first, second), axis=1).astype(np.int32)[keep]
    if split is not None:
        rows = rows[arrays["split"][rows[:, 0]] == SPLITS.index(split)]
    return rows
