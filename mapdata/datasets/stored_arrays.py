"""Kernels that read problems from the arrays of many shards at once.

A kernel call for each shard would cost more than the reading itself. So the kernels get a table of
the addresses of the arrays of all open shards.
"""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

import numba
import numpy as np
from numba import types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from mapdata.arrays import Bytes, Flags, Float32s, Int32s, Ints
from mapdata.generators.maps import WORD, unpack_map
from mapdata.jit import COMPILED, Int, kernel
from mapdata.movement import STEPS
from mapdata.search.footprint import inflate_all
from mapdata.search.kernels import Scratch
from mapdata.search.labels import connected_components
from mapdata.search.lattice import Lattice, cells_of, load

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
