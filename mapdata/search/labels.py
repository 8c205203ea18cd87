"""The paper's labels of a map: routes by BFS and A*, their iterations and connection matrices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Flags, Floats, Ints, offsets_of, summary
from mapdata.checks import check_choice
from mapdata.generators.maps import Maps, unpacked
from mapdata.jit import Int, kernel
from mapdata.movement import STEPS, Movement
from mapdata.search.api import SEARCHES
from mapdata.search.arguments import as_terrain
from mapdata.search.bitboard import MAX_SIDE as MAX_BITBOARD_SIDE
from mapdata.search.bitboard import bfs_labels_by_bits
from mapdata.search.footprint import occupies_cells
from mapdata.search.ground import (
    EXACT,
    PaddedTerrain,
    as_ground,
    high_cost_complaint,
    load_map,
    sums_of_cost,
)
from mapdata.search.jump_points import find_free_neighbours, jump_costs
from mapdata.search.kernels import (
    Scratch,
    best_first_buckets,
    count_moves,
    expansions_until,
    flood,
    search_memory,
    wipe,
    write_moves,
)
from mapdata.search.lattice import (
    ASTAR,
    INFINITY,
    UNIT,
    UNSEEN,
    WALL,
    Lattice,
    load,
    move_rule,
)
from mapdata.search.solving import search_loaded
from mapdata.search.terrain import shortest_terrain_costs

_MIN_CELLS_FOR_FLOOD = 3
"""Number of goals from which on one search of the whole map takes less time than an A* to each."""

_CELLS_AT_ONCE = 2**22
"""Cells that are labelled between two reports of progress: 1024 maps of 64 x 64. Batches of 64 maps
would cost 7 % more time.
"""

_MIN_MAPS_AT_ONCE = 8
"""Smallest number of maps between two reports, however large they are: each batch of maps needs new
memory.
"""


class HighCostError(ValueError):
    """A map whose costs are too high to be exact.

    Attributes:
        map_number: of the map.
        complaint: the message, without the number of the map.
    """

    def __init__(self, map_number: int, complaint: str) -> None:
        """Keep both, and put them together as the message."""
        super().__init__(f"map {map_number}: {complaint}")
        self.map_number = map_number
        self.complaint = complaint


@dataclass(frozen=True)
class RouteLabels:
    """What BFS or A* finds on N maps with S segments and P pairs of rooms.

    Segment q of a map leads from room q to room q + 1. Pairs are i < j in the order of
    `numpy.triu_indices`, which is scipy's condensed form. `Maps.segment_offsets` and
    `Maps.pair_offsets` say where the segments and pairs of a map begin.

    Attributes:
        moves: (M,) uint8, the moves of all segments one after another, numbered as in `STEPS`.
        offsets: (S + 1,) int64, first move of each segment. A segment without a path has no moves;
            neither has one from a cell to itself.
        iterations: (S,) int64, cells expanded.
        costs: (P, 2) int64, straight and diagonal moves between the seed points of each pair, (-1,
            0) without a path. BFS counts all moves as straight. By A* on terrain, they are the
            doubled cost: the sums of both cells' costs over straight and over diagonal moves; all
            is in the first where diagonals cost 1.
    """

    moves: Bytes
    offsets: Ints
    iterations: Ints
    costs: Ints

    __repr__ = summary


@dataclass(frozen=True)
class Labels:
    """The paper's characterization (its section 4) of a batch of maps, by both searches.

    Attributes:
        maps: the maps that are labelled.
        bfs: the labels by breadth-first search.
        astar: the labels by A*.
    """

    maps: Maps
    bfs: RouteLabels
    astar: RouteLabels

    @cached_property
    def reachable(self) -> Flags:
        """(S,) bool: a path joins rooms q and q + 1, whether or not a passage was drawn."""
        return np.asarray(self.astar.costs[self.maps.segment_pairs, 0] >= 0)

    @cached_property
    def all_connected(self) -> Flags:
        """(N,) bool: paths exist between all rooms of a map."""
        paths_before_segment = offsets_of(self.reachable)
        path_counts = np.diff(paths_before_segment[self.maps.segment_offsets])
        return np.asarray(path_counts == self.maps.rooms - 1)

    def segment(self, search: str, i: int, q: int) -> Ints:
        """Return the cells of segment q of map i of the batch, (k, 2) int64.

        ``search`` is "bfs" or "astar"; a segment without a path has no cell, (0, 2).

        Raises:
            IndexError: no such map or segment.
        """
        labels = self.by_search(search)
        if not 0 <= q < self._room_count(i) - 1:
            raise IndexError(f"map {i} of the batch has no segment {q}")
        segment = self.maps.segment_offsets[i] + q
        if not self.reachable[segment]:
            return np.empty((0, 2), np.int64)
        moves = labels.moves[labels.offsets[segment] : labels.offsets[segment + 1]]
        start = self.maps.seed_points[i, q]
        return np.cumsum(np.vstack((start, STEPS[moves])), axis=0)

    def route(self, search: str, i: int) -> list[Ints]:
        """Return the path through all rooms of map i in their order, as its segments (k, 2)."""
        return [self.segment(search, i, q) for q in range(self._room_count(i) - 1)]

    def iterations(self, search: str, i: int) -> Ints:
        """Return (n - 1,) int64, the iterations of each segment of map i with n rooms."""
        first = self.maps.segment_offsets[i]
        return self.by_search(search).iterations[first : first + self._room_count(i) - 1]

    def matrix(self, search: str, i: int) -> Floats:
        """Return the connection matrix of map i with n rooms, (n, n) float64.

        It holds path costs (BFS: moves), 0 on the diagonal, -1 where there is no path.
        """
        n = self._room_count(i)
        first, end = self.maps.pair_offsets[i : i + 2]
        straight, diagonal = self.by_search(search).costs[first:end].T
        costs = straight + diagonal * self.maps.movement.diagonal_cost
        if self.maps.terrain is not None and search == "astar":
            costs = costs / 2
        upper_triangle = np.zeros((n, n))
        upper_triangle[pairs_of(n)] = np.where(straight < 0, -1.0, costs)
        return upper_triangle + upper_triangle.T

    def _room_count(self, i: int) -> int:
        """Return the number of rooms of map i of the batch."""
        if not 0 <= i < len(self.maps):
            raise IndexError(f"map {i} of a batch of {len(self.maps)}")
        return int(self.maps.rooms[i])

    def by_search(self, search: str) -> RouteLabels:
        """Return the labels by ``search``, "bfs" or "astar"."""
        check_choice("search", search, SEARCHES)
        return self.bfs if search == "bfs" else self.astar


@cache
def pairs_of(rooms: int) -> tuple[Ints, Ints]:
    """Return the rooms (i, j) of all pairs i < j, in the order of labels, as two arrays.

    They are cached, because `numpy.triu_indices` takes longer than filling a matrix.
    """
    return np.triu_indices(rooms, 1)


def labels_serve(stored: Movement, served: Movement, min_clearance: int) -> bool:
    """Return whether stored paths and connection matrices are those of the maps as served.

    Args:
        stored: movement of the labels.
        served: movement of the problems.
        min_clearance: that of the robot, as from `min_squared_clearance`.
    """
    return stored == served and not occupies_cells(min_clearance)


def connections_serve(stored: Movement, served: Movement, min_clearance: int) -> bool:
    """Return whether stored labels say which rooms of the maps as served are connected.

    Straight moves alone connect the same cells as straight moves and diagonal ones that need two
    free cells beside them, because two straight moves can replace such a diagonal one. Cutting
    corners connects more cells. A radius occupies cells, so it connects fewer. The arguments are
    those of `labels_serve`.
    """
    same_corners = stored.corner_cutting == served.corner_cutting
    return same_corners and not occupies_cells(min_clearance)


LONG_PATHS = 1.5
"""Where paths have more moves in the mean than so many times the longer side, as in mazes, BFS runs
by a queue and not by bits. A step by bits looks at all rows of a map, however few cells it reaches.
"""


class _MapBatch(NamedTuple):
    """The maps that kernels label in one call, and the memory that they use.

    Attributes:
        grids: (N, H, W) uint8.
        rooms: (N,) number of rooms of each map.
        cells: (N, R) padded cells of the seed points; cell 0, a wall, for those outside of the map.
        first_segments: (N or more,) the first segment of each map, a row of a segment table.
        first_pairs: (N or more,) the first pair of each map, a row of pair costs.
        lattice: of the maps.
        scratch: memory of the searches.
    """

    grids: Bytes
    rooms: Ints
    cells: Ints
    first_segments: Ints
    first_pairs: Ints
    lattice: Lattice
    scratch: Scratch


def label(maps: Maps, advance: Callable[[int], object] | None = None) -> Labels:
    """Return routes, iterations and connection matrices of ``maps`` by BFS and by A*.

    One breadth-first search from each seed point gives its row of the BFS matrix, its segment and
    the iterations. A* searches each segment. How the costs of the other pairs by A* are found
    depends on the movement:

    - On 4-connected maps they are those of BFS.
    - With diagonals at sqrt(2), all shortest paths of a pair have the same numbers of straight and
      of diagonal moves, so one search from a room gives its costs if there are three or more: by
      jumps (`jump_costs`).
    - Otherwise A* searches each pair.
    - On terrain, one search from a room gives its costs. BFS counts moves there, too.

    Source: arXiv 2110.13242, section 4 (Characterization).

    Args:
        maps: the maps to label, with their terrain if they have any.
        advance: called with the number of maps labelled since its last call.

    Raises:
        TypeError: ``maps`` are no `Maps`.
        ValueError: a seed point that is not a free cell of its map; terrain that does not fit the
            maps, or whose costs are too high to be exact. The message names the map.

    >>> from mapdata import MapSpec, generate
    >>> labels = label(generate(MapSpec(), seed=0, indices=[2]))
    >>> labels.matrix("astar", 0)
    array([[ 0., 39.],
           [39.,  0.]])
    """
    if not hasattr(maps, "packed"):
        raise TypeError(
            f"maps: got {type(maps).__name__}, expected the Maps that mapdata.generate returns"
        )
    terrain = maps.terrain
    if terrain is not None and len(terrain) != len(maps):
        raise ValueError(f"terrain: got {len(terrain)} maps, expected {len(maps)}")
    bfs_table = np.empty((maps.segment_offsets[-1], 2), np.int64)
    bfs_costs = np.empty((maps.pair_offsets[-1], 2), np.int64)
    astar_table = np.empty_like(bfs_table)
    # Without diagonals both searches are optimal and each move costs 1, so the costs of A* are
    # those of BFS.
    has_diagonals = maps.movement.connectivity == 8
    has_astar_costs = has_diagonals or terrain is not None
    astar_costs = np.empty_like(bfs_costs) if has_astar_costs else None
    size = maps.packed.shape[1], maps.columns
    lattice, scratch = search_memory(size, move_rule(maps.movement))
    bfs_moves = []
    astar_moves = []
    batch_size = max(_MIN_MAPS_AT_ONCE, _CELLS_AT_ONCE // (size[0] * size[1]))
    # Without any maps there is one empty batch, so that there are moves to concatenate.
    for first in range(0, max(len(maps), 1), batch_size):
        rows = slice(first, first + batch_size)
        packed = maps.packed[rows]
        seed_points = maps.seed_points[rows]
        batch = _MapBatch(
            unpacked(packed, maps.columns),
            maps.rooms[rows],
            _padded_cells(seed_points, size, lattice),
            maps.segment_offsets[first:],
            maps.pair_offsets[first:],
            lattice,
            scratch,
        )
        # A* comes first, since it checks the seed points, on which BFS relies.
        moves, bad_seed_point = _collect_astar_labels(
            batch,
            None if terrain is None else as_terrain(terrain[rows], batch.grids),
            maps.index[rows],
            astar_table,
            astar_costs,
        )
        if bad_seed_point is not None:
            m, room = bad_seed_point
            cell = tuple(seed_points[m, room].tolist())
            number = maps.index[first + m]
            raise ValueError(f"seed_points: {cell} of map {number} is not a free cell")
        astar_moves.append(moves)
        # No path has fewer moves than that of BFS, so there is room for those of BFS.
        moves = np.empty(len(moves), np.uint8)
        path_count = int((batch.rooms - 1).sum())
        has_long_paths = len(moves) > LONG_PATHS * max(size) * path_count
        if not (has_diagonals or has_long_paths) and max(size) <= MAX_BITBOARD_SIDE:
            used = bfs_labels_by_bits(
                packed,
                maps.columns,
                batch.rooms,
                seed_points,
                batch.first_segments,
                batch.first_pairs,
                bfs_table,
                bfs_costs,
                moves,
            )
        else:
            used = bfs_labels_by_queue(*batch, bfs_table, bfs_costs, moves)
        bfs_moves.append(moves[:used])
        if advance:
            advance(len(packed))
    if astar_costs is None:
        astar_costs = bfs_costs.copy()
    bfs = _route_labels(np.concatenate(bfs_moves), bfs_table, bfs_costs)
    astar = _route_labels(np.concatenate(astar_moves), astar_table, astar_costs)
    return Labels(maps, bfs, astar)


def _padded_cells(seed_points: Ints, size: tuple[int, int], lattice: Lattice) -> Ints:
    """Return the padded cells (N, R) of seed points (N, R, 2).

    A seed point outside of the map becomes cell 0, which is a wall.
    """
    rows = seed_points[:, :, 0]
    columns = seed_points[:, :, 1]
    cells: Ints = (rows + 1) * lattice.stride + columns + 1  # as `cell_at` computes them
    is_outside = (rows < 0) | (rows >= size[0]) | (columns < 0) | (columns >= size[1])
    cells[is_outside] = 0
    return cells


def _collect_astar_labels(
    batch: _MapBatch,
    terrain: Bytes | None,
    map_numbers: Ints,
    segment_table: Ints,
    pair_costs: Ints | None,
) -> tuple[Bytes, tuple[int, int] | None]:
    """Label a batch by A*, with as much memory for its moves as it turns out to need.

    ``terrain`` (N, H, W) fits the grids. The last two arguments are those of `_astar_labels`.
    Returns the moves of all segments, and None; or, if a seed point is not a free cell, its map in
    the batch and its room.

    Raises:
        HighCostError: a map whose costs are too high to be exact.
    """
    map_cells, cell_costs = as_ground(batch.grids, terrain)
    # With None, numba leaves out the search for diagonal moves.
    has_diagonals = pair_costs is not None and terrain is None
    diagonals = batch.lattice.diagonals if has_diagonals else None
    loaded = np.empty(batch.lattice.cells, np.uint8)
    neighbours = np.zeros(batch.lattice.cells, np.uint8)
    # This is enough except for mazes. Memory that is not used does not become memory of the
    # process.
    capacity = 4 * batch.lattice.stride * int(batch.rooms.sum())
    moves = np.empty(capacity, np.uint8)
    done = used = 0
    while done < len(batch.grids):
        done, used, bad_room, high_cost = _astar_labels(
            map_cells,
            *batch[1:],
            segment_table,
            pair_costs,
            diagonals,
            cell_costs,
            loaded,
            neighbours,
            moves,
            done,
            used,
        )
        if high_cost:
            raise HighCostError(int(map_numbers[done]), high_cost_complaint(high_cost))
        if bad_room >= 0:
            return moves[:used], (done, bad_room)
        if done < len(batch.grids):
            moves = np.concatenate((moves, np.empty_like(moves)))
    return moves[:used].copy(), None


def _route_labels(moves: Bytes, segment_table: Ints, pair_costs: Ints) -> RouteLabels:
    """Return labels from ``moves`` (M,) and the tables (S, 2) and (P, 2) that a kernel filled."""
    offsets = offsets_of(segment_table[:, 0])
    iterations = np.ascontiguousarray(segment_table[:, 1])
    return RouteLabels(moves, offsets, iterations, pair_costs)


@kernel
def bfs_labels_by_queue(
    grids: Bytes,
    rooms: Ints,
    cells: Ints,
    first_segments: Ints,
    first_pairs: Ints,
    lattice: Lattice,
    scratch: Scratch,
    segment_table: Ints,
    pair_costs: Ints,
    moves: Bytes,
) -> Int:
    """Label every map by BFS, which floods from each seed point until all later ones are seen.

    Args:
        grids: (N, H, W).
        rooms: (N,) number of rooms of each map.
        cells: (N, R) padded cells of the seed points, all free.
        first_segments: (N or more,) the first segment of each map.
        first_pairs: (N or more,) the first pair of each map.
        lattice: of the maps.
        scratch: memory of the searches.
        segment_table: (S, 2), to be filled with number of moves and expansions of each segment.
        pair_costs: (P, 2), to be filled with moves between the seed points of each pair and 0, or
            (-1, 0) without a path.
        moves: with room for all moves, to be filled with those of all segments.

    Returns:
        The number of moves.
    """
    came_from = scratch.came_from
    # A number that is passed to a kernel gets its final type at once. Otherwise the kernel would be
    # compiled twice.
    used = np.int64(0)
    for m in range(len(grids)):
        n = rooms[m]
        pair = first_pairs[m]
        for q in range(n - 1):
            start = cells[m, q]
            goal = cells[m, q + 1]
            load(grids[m], came_from)
            queue_length = flood(start, cells[m, q + 1 : n], lattice, scratch)
            next_room_pair = pair
            for later_room in range(q + 1, n):
                later_cell = cells[m, later_room]
                straight, diagonal = count_moves(came_from, start, later_cell, lattice)
                pair_costs[pair, 0] = straight + diagonal
                pair_costs[pair, 1] = 0
                pair += 1
            segment = first_segments[m] + q
            length = max(pair_costs[next_room_pair, 0], 0)  # without a path, no moves
            segment_table[segment, 0] = length
            segment_table[segment, 1] = expansions_until(scratch.pushed, queue_length, goal)
            write_moves(came_from, goal, length, lattice, moves, used)
            used += length
    return used


@kernel
def connected_components(cells: Ints, lattice: Lattice, scratch: Scratch) -> Ints:
    """Return which of some cells a path connects, on a grid that is loaded.

    Args:
        cells: (n,) padded cells.
        lattice: of the map.
        scratch: memory for BFS, with the map loaded; ``came_from`` is not fresh afterwards.

    Returns:
        (n,) int64, the component of each cell: the index in ``cells`` of the first cell to which it
        is connected, itself included; -1 for an occupied cell.
    """
    came_from = scratch.came_from
    components = np.full(len(cells), -1)
    for k in range(len(cells)):
        if came_from[cells[k]] != UNSEEN:
            continue  # The cell is occupied, or in the component of an earlier one.
        flood(cells[k], cells[k:], lattice, scratch)
        for j in range(k, len(cells)):
            # The states of cells that floods have reached are below UNSEEN, which is below WALL.
            if components[j] < 0 and came_from[cells[j]] < UNSEEN:
                components[j] = k
    return components


@kernel
def _astar_labels(
    maps: Bytes,
    rooms: Ints,
    cells: Ints,
    first_segments: Ints,
    first_pairs: Ints,
    lattice: Lattice,
    scratch: Scratch,
    segment_table: Ints,
    pair_costs: Ints | None,
    diagonals: Int | None,
    cell_costs: Bytes | None,
    loaded: Bytes,
    neighbours: Bytes,
    moves: Bytes,
    first_map: Int,
    used: Int,
) -> tuple[Int, Int, Int, Int]:
    """Label maps by A*, and check that seed points are free cells.

    Args:
        maps: (N, H, W) grids or terrain.
        rooms: (N,) as `bfs_labels_by_queue` takes it, like the arguments up to ``segment_table``.
        cells: (N, R) padded cells of the seed points; cell 0, a wall, if outside of the map.
        first_segments: (N or more,).
        first_pairs: (N or more,).
        lattice: of the maps.
        scratch: memory of the searches.
        segment_table: (S, 2), to be filled with number of moves and expansions of each segment.
        pair_costs: (P, 2), to be filled with straight and diagonal moves between the seed points of
            each pair, on terrain with the sums S and D; (-1, 0) without a path. None on grids
            without diagonals. numba then compiles no branch that fills it, so that a first build of
            such maps waits less.
        diagonals: those of the lattice; None without diagonals, and on terrain.
        cell_costs: as from `as_ground`.
        loaded: (cells,) memory for the states of a map that is loaded.
        neighbours: (cells,) zeros, memory for `find_free_neighbours`.
        moves: to be filled with the moves of all segments.
        first_map: the maps before this one are labelled already.
        used: the number of their moves.

    Returns:
        The map before which all are labelled, the number of their moves, and the reason why it
        stopped there: the room of that map whose seed point is not a free cell, or -1; and the
        doubled cost that is too high to be exact, or 0. With -1 and 0, all maps are labelled, or
        ``moves`` has no room for the next one.
    """
    came_from = scratch.came_from
    for m in range(first_map, len(maps)):
        _, ground = load_map(maps[m], cell_costs, lattice, loaded)
        if diagonals is not None:
            find_free_neighbours(loaded, lattice, neighbours)
        for q in range(rooms[m]):
            if loaded[cells[m, q]] == WALL:
                return m, used, q, EXACT
        used_before_map = used
        pair = first_pairs[m]
        for q in range(rooms[m] - 1):
            start = cells[m, q]
            goal = cells[m, q + 1]
            for k in range(lattice.cells):
                came_from[k] = loaded[k]
            found = search_loaded(
                start, goal, ASTAR, diagonals, cell_costs, ground, lattice, scratch
            )
            if found.high_cost:
                return m, used_before_map, -1, found.high_cost
            length = max(found.length - 1, 0)  # without a path, no moves
            segment = first_segments[m] + q
            segment_table[segment, 0] = length
            segment_table[segment, 1] = found.expansions
            if used + length > len(moves):
                return m, used_before_map, -1, EXACT
            write_moves(came_from, goal, length, lattice, moves, used)
            used += length
            if pair_costs is not None:
                pair_costs[pair, 0] = found.straight_sum
                pair_costs[pair, 1] = found.diagonal_sum
                # Where diagonals cost 1, all of a cost on terrain is the first sum.
                if cell_costs is not None and found.length:
                    pair_costs[pair, 0], pair_costs[pair, 1] = sums_of_cost(scratch.g[goal], ground)
                wipe(scratch, found.pushes)
                later_cells = cells[m, q + 2 : rooms[m]]
                later_costs = pair_costs[pair + 1 :]
                high_cost = _fill_costs(
                    cells[m, q : q + 1],
                    later_cells,
                    ground,
                    neighbours,
                    lattice,
                    scratch,
                    later_costs,
                )
                if high_cost:
                    return m, used_before_map, -1, high_cost
                pair += 1 + len(later_cells)
    return len(maps), used, -1, EXACT


@kernel
def _fill_costs(
    source: Ints,
    cells: Ints,
    ground: PaddedTerrain | None,
    neighbours: Bytes,
    lattice: Lattice,
    scratch: Scratch,
    costs: Ints,
) -> Int:
    """Write the costs of A* from a source to each of ``cells``, by the search that is fastest.

    Args:
        source: (1,) padded cell.
        cells: (n,) padded cells.
        ground: of the map.
        neighbours: (cells,) on grids those from `find_free_neighbours`.
        lattice: of the map, with diagonals unless it has terrain.
        scratch: with the map loaded in ``came_from``.
        costs: (n or more, 2), to be filled with straight and diagonal moves, on terrain with the
            sums S and D; (-1, 0) without a path.

    Returns:
        EXACT, or as `shortest_costs_on` what is too high to be exact.
    """
    if len(cells) == 0:
        return EXACT
    if ground is not None or (lattice.diagonal_cost != UNIT and len(cells) >= _MIN_CELLS_FOR_FLOOD):
        # Since sqrt(2) is irrational, only one pair of sums has the least cost. So any optimal
        # search finds that of A*.
        if ground is None:
            high_cost = jump_costs(source[0], INFINITY, neighbours, lattice, scratch)
        else:
            high_cost = shortest_terrain_costs(source, ground, lattice, scratch)
        if high_cost:
            return high_cost
        for k in range(len(cells)):
            cost = scratch.g[cells[k]]
            costs[k, 0] = -1
            costs[k, 1] = 0
            if cost != INFINITY:
                costs[k, 0], costs[k, 1] = sums_of_cost(cost, ground)
    else:
        for k in range(len(cells)):
            _, pushes, high_cost = best_first_buckets(source[0], cells[k], lattice, scratch)
            if high_cost:
                return high_cost
            costs[k, 0], costs[k, 1] = count_moves(scratch.came_from, source[0], cells[k], lattice)
            wipe(scratch, pushes)
    return EXACT
