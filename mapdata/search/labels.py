"""What the paper computes of a map: routes by BFS and A*, their iterations, connection matrices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from mapdata.arrays import Bytes, Flags, Floats, Ints, offsets_of, summary
from mapdata.checks import check_choice
from mapdata.generators.maps import Maps, unpacked
from mapdata.jit import Int, kernel
from mapdata.movement import STEPS
from mapdata.search.api import SEARCHES
from mapdata.search.bitboard import MAX_SIDE as BIT_SIDE
from mapdata.search.bitboard import bit_search
from mapdata.search.kernels import (
    Scratch,
    astar_manhattan,
    best_first,
    count_moves,
    expansions_until,
    flood,
    plain_scratch,
    shortest_costs,
    wipe,
    write_moves,
)
from mapdata.search.lattice import (
    ASTAR,
    FAR,
    UNIT,
    UNSEEN,
    WALL,
    Lattice,
    load,
    parts,
    plain_lattice,
    rule_of,
)

_MANY = 3
"""From so many remaining rooms on, one search of the whole map costs less than an A* to each."""

_CELLS_AT_ONCE = 2**22
"""Cells that are labelled between two reports of progress: 1024 maps of 64 x 64. Pieces of 64 maps
would cost 7 % more time.
"""

_LEAST_AT_ONCE = 8
"""Maps between two reports, however large they are: each piece needs new buffers."""


@dataclass(frozen=True)
class SearchLabels:
    """What one search finds on N maps with S segments and P pairs of rooms.

    Segment q of a map leads from room q to room q + 1, pairs are i < j in the order of
    `numpy.triu_indices` (scipy's condensed form); `Maps.segment_offsets` and `Maps.pair_offsets`
    say where those of a map begin.

    Attributes:
        moves: (M,) uint8, the moves of all segments one after another, numbered as `STEPS`.
        offsets: (S + 1,) int64, first move of each segment. A segment without a path has no moves,
            like one from a cell to itself.
        iterations: (S,) int64, cells expanded.
        costs: (P, 2) int64, straight and diagonal moves between the seeds of each pair (BFS: all
            moves, and 0), (-1, 0) without a path.
    """

    moves: Bytes
    offsets: Ints
    iterations: Ints
    costs: Ints

    __repr__ = summary


@dataclass(frozen=True)
class Labels:
    """The paper's characterization (its section 4) of a batch of maps, by both searches."""

    maps: Maps
    bfs: SearchLabels
    astar: SearchLabels

    @cached_property
    def reachable(self) -> Flags:
        """(S,) bool: a path joins rooms q and q + 1, whether or not a passage was drawn."""
        return np.asarray(self.astar.costs[self.maps.segment_pairs, 0] >= 0)

    @cached_property
    def all_connected(self) -> Flags:
        """(N,) bool: paths exist between all rooms of a map."""
        paths_before = offsets_of(self.reachable)
        paths = np.diff(paths_before[self.maps.segment_offsets])
        return np.asarray(paths == self.maps.rooms - 1)

    def segment(self, search: str, i: int, q: int) -> Ints:
        """Return the cells of segment q of map i of the batch, (k, 2) int64.

        ``search`` is "bfs" or "astar"; a segment without a path has no cell, (0, 2).
        """
        labels = self.of(search)
        if not 0 <= q < self._rooms(i) - 1:
            raise IndexError(f"map {i} of the batch has no segment {q}")
        s = self.maps.segment_offsets[i] + q
        if not self.reachable[s]:
            return np.empty((0, 2), np.int64)
        moves = labels.moves[labels.offsets[s] : labels.offsets[s + 1]]
        start = self.maps.seed_points[i, q]
        return np.cumsum(np.vstack((start, STEPS[moves])), axis=0)

    def route(self, search: str, i: int) -> list[Ints]:
        """Return the path through all rooms of map i in their order, as its segments (k, 2)."""
        return [self.segment(search, i, q) for q in range(self._rooms(i) - 1)]

    def iterations(self, search: str, i: int) -> Ints:
        """Return (n - 1,) int64, the iterations of each segment of map i."""
        first = self.maps.segment_offsets[i]
        return self.of(search).iterations[first : first + self._rooms(i) - 1]

    def matrix(self, search: str, i: int) -> Floats:
        """Return the connection matrix of map i, (n, n) float64.

        It holds path costs (BFS: moves), 0 on the diagonal, -1 where there is no path.
        """
        n = self._rooms(i)
        first, end = self.maps.pair_offsets[i : i + 2]
        straight, diagonal = self.of(search).costs[first:end].T
        matrix = np.zeros((n, n))
        # BFS counts all moves as straight ones
        matrix[pairs_of(n)] = straight + diagonal * self.maps.movement.diagonal_cost
        return matrix + matrix.T

    def _rooms(self, i: int) -> int:
        """Return the number of rooms of map i of the batch."""
        if not 0 <= i < len(self.maps):
            raise IndexError(f"map {i} of a batch of {len(self.maps)}")
        return int(self.maps.rooms[i])

    def of(self, search: str) -> SearchLabels:
        """Return the labels by ``search``, "bfs" or "astar"."""
        check_choice("search", search, SEARCHES)
        return self.bfs if search == "bfs" else self.astar


@cache
def pairs_of(rooms: int) -> tuple[Ints, Ints]:
    """Return rooms i < j of each pair, in the order of labels.

    Kept, since `numpy.triu_indices` takes longer than to fill a matrix.
    """
    return np.triu_indices(rooms, 1)


def label(maps: Maps, advance: Callable[[int], object] | None = None) -> Labels:
    """Return routes, iterations and connection matrices of ``maps`` by BFS and by A*.

    One breadth-first search from each seed point gives its row of the BFS matrix, its segment and
    the iterations. A* searches each segment. Its costs of the other pairs are those of BFS on
    4-connected maps; with diagonals at sqrt(2), where shortest paths of a pair have one number of
    straight and of diagonal moves, one search a room gives three or more; else A* searches each
    pair.

    Source: arXiv 2110.13242, section 4 (Characterization).

    Args:
        maps: what to label.
        advance: called with numbers of maps as they are done.

    Raises:
        ValueError: a seed point that is not a free cell of its map.

    >>> from mapdata import MapSpec, generate
    >>> labels = label(generate(MapSpec(), seed=0, indices=[2]))
    >>> labels.matrix("astar", 0)
    array([[ 0., 39.],
           [39.,  0.]])
    """
    bfs_table = np.empty((maps.segment_offsets[-1], 2), np.int64)
    bfs_costs = np.empty((maps.pair_offsets[-1], 2), np.int64)
    astar_table = np.empty_like(bfs_table)
    # Without diagonals both searches are optimal, and each move costs 1: the costs of A* are those
    # of BFS.
    astar_costs = np.empty_like(bfs_costs) if maps.movement.connectivity == 8 else None
    size = maps.packed.shape[1], maps.columns
    lattice = plain_lattice(size, rule_of(maps.movement))
    buffers = plain_scratch(lattice)
    walls = np.full(lattice.cells, WALL)
    bfs_moves = []
    astar_moves = []
    most = max(_LEAST_AT_ONCE, _CELLS_AT_ONCE // (size[0] * size[1]))
    for first in range(0, max(len(maps), 1), most):  # once for no maps, too
        part = slice(first, first + most)
        packed = maps.packed[part]
        grids = unpacked(packed, maps.columns)
        rooms = maps.rooms[part]
        seed_points = maps.seed_points[part]
        cells = _padded_cells(seed_points, size, lattice)
        where = (maps.segment_offsets[first:], maps.pair_offsets[first:])
        work = (grids, rooms, cells, *where, lattice, buffers)
        # Enough but for mazes; what is not used takes no memory.
        moves = np.empty(4 * lattice.stride * int(rooms.sum()), np.uint8)
        done = used = 0
        # A* first: it checks the seed points, on which the others rely.
        while done < len(packed):
            done, used, bad = _astar_maps(*work, astar_table, astar_costs, walls, moves, done, used)
            if bad >= 0:
                cell = tuple(seed_points[done, bad].tolist())
                number = maps.index[first + done]
                raise ValueError(f"seed_points: {cell} of map {number} is not a free cell")
            if done < len(packed):
                moves = np.concatenate((moves, np.empty_like(moves)))
        astar_moves.append(moves[:used].copy())
        moves = np.empty(used, np.uint8)  # no path has fewer moves than that of BFS
        if astar_costs is None and max(size) <= BIT_SIDE:
            used = bit_search(
                packed, maps.columns, rooms, seed_points, *where, bfs_table, bfs_costs, moves
            )
        else:
            used = _flood_maps(*work, bfs_table, bfs_costs, moves)
        bfs_moves.append(moves[:used])
        if advance:
            advance(len(packed))
    if astar_costs is None:
        astar_costs = bfs_costs.copy()
    bfs = _search_labels(np.concatenate(bfs_moves), bfs_table, bfs_costs)
    astar = _search_labels(np.concatenate(astar_moves), astar_table, astar_costs)
    return Labels(maps, bfs, astar)


def _padded_cells(seed_points: Ints, size: tuple[int, int], lattice: Lattice) -> Ints:
    """Return the padded cells of seed points, (N, R); cell 0, a wall, for those outside of maps."""
    rows, columns = seed_points[:, :, 0], seed_points[:, :, 1]
    cells: Ints = (rows + 1) * lattice.stride + columns + 1  # as `cell_at` gives them
    is_outside = (rows < 0) | (rows >= size[0]) | (columns < 0) | (columns >= size[1])
    cells[is_outside] = 0
    return cells


def _search_labels(moves: Bytes, table: Ints, costs: Ints) -> SearchLabels:
    """Return the labels of one search from what its kernel gave."""
    return SearchLabels(moves, offsets_of(table[:, 0]), np.ascontiguousarray(table[:, 1]), costs)


@kernel
def _flood_maps(
    grids: Bytes,
    rooms: Ints,
    cells: Ints,
    segments: Ints,
    pairs: Ints,
    lattice: Lattice,
    buffers: Scratch,
    table: Ints,
    costs: Ints,
    moves: Bytes,
) -> Int:
    """Label every map by BFS, which floods from each seed until all later ones are seen.

    Args:
        grids: (N, H, W).
        rooms: (N,) number of rooms.
        cells: (N, most rooms) padded cells of the seed points, all free.
        segments: (N or more,) the first segment of each map.
        pairs: (N or more,) the first pair of each map.
        lattice: of the maps.
        buffers: what searches write to.
        table: (S, 2), filled with number of moves and iterations of each segment.
        costs: (P, 2), filled with moves between the seeds of each pair and 0, or (-1, 0).
        moves: with room for all moves, filled with those of all segments.

    Returns:
        The number of moves.
    """
    came = buffers.came
    # A number that is handed on gets its final type at once: else the kernels that take it are
    # compiled twice.
    used = np.int64(0)
    for m in range(len(grids)):
        n = rooms[m]
        pair = pairs[m]
        for q in range(n - 1):
            start = cells[m, q]
            goal = cells[m, q + 1]
            load(grids[m], came)
            count = flood(start, cells[m, q + 1 : n], lattice, buffers)
            to_next = pair
            for k in range(q + 1, n):
                straight, diagonal = count_moves(came, start, cells[m, k], lattice)
                costs[pair, 0] = straight + diagonal
                costs[pair, 1] = 0
                pair += 1
            length = max(costs[to_next, 0], 0)
            table[segments[m] + q, 0] = length
            table[segments[m] + q, 1] = expansions_until(buffers.pushed, count, goal)
            write_moves(came, goal, length, lattice, moves, used)
            used += length
    return used


@kernel
def connected_components(cells: Ints, lattice: Lattice, buffers: Scratch) -> Ints:
    """Return which of some cells a path connects, on a grid that is loaded.

    Args:
        cells: (n,) padded cells.
        lattice: of the grid and the moves.
        buffers: of BFS; ``came`` is not fresh afterwards.

    Returns:
        (n,) int64, a number for each cell: cells of one connected component have the same one, the
        place of the first of them in ``cells``; an occupied cell has -1.
    """
    came = buffers.came
    components = np.full(len(cells), -1)
    for k in range(len(cells)):
        if came[cells[k]] != UNSEEN:
            continue  # occupied, or in the component of an earlier cell
        flood(cells[k], cells[k:], lattice, buffers)
        for j in range(k, len(cells)):
            # What floods reach is below UNSEEN, which is below WALL.
            if components[j] < 0 and came[cells[j]] < UNSEEN:
                components[j] = k
    return components


@kernel
def _astar_maps(
    grids: Bytes,
    rooms: Ints,
    cells: Ints,
    segments: Ints,
    pairs: Ints,
    lattice: Lattice,
    buffers: Scratch,
    table: Ints,
    costs: Ints | None,
    fresh: Bytes,
    moves: Bytes,
    first: Int,
    used: Int,
) -> tuple[Int, Int, Int]:
    """Label every map by A*, and check that seed points are free cells.

    Arguments are those of `_flood_maps`, but ``costs`` are straight and diagonal moves, or None
    without diagonals: then numba compiles no branch that needs them, which shortens what a first
    build of such maps waits for. ``fresh`` (cells,) is all wall. Maps before ``first`` are done,
    and have ``used`` moves.

    Returns:
        Up to which map all are done; the number of their moves; why it stopped there: -1 if all are
        done or ``moves`` has no room for the next map, else which seed point is no free cell.
    """
    came = buffers.came
    _, rows, columns = grids.shape
    for m in range(first, len(grids)):
        # What `load` does, but for the wall around the grid, which is there, and for its check.
        for row in range(rows):
            cell = np.uint64((row + 1) * lattice.stride + 1)
            for column in range(columns):
                fresh[cell + np.uint64(column)] = UNSEEN | grids[m, row, np.uint64(column)]
        for q in range(rooms[m]):
            if fresh[cells[m, q]] == WALL:
                return m, used, q
        used_before = used
        pair = pairs[m]
        for q in range(rooms[m] - 1):
            start = cells[m, q]
            goal = cells[m, q + 1]
            for k in range(lattice.cells):
                came[k] = fresh[k]
            if costs is None:
                expansions, _ = astar_manhattan(start, goal, lattice, buffers)
            else:
                expansions, pushes = best_first(start, goal, ASTAR, lattice, buffers)
            straight, diagonal = count_moves(came, start, goal, lattice)
            length = max(straight + diagonal, 0)
            table[segments[m] + q, 0] = length
            table[segments[m] + q, 1] = expansions
            if used + length > len(moves):
                return m, used_before, -1
            write_moves(came, goal, length, lattice, moves, used)
            used += length
            if costs is not None:
                costs[pair, 0] = straight
                costs[pair, 1] = diagonal
                wipe(buffers, pushes)
                others = cells[m, q + 2 : rooms[m]]
                _fill_costs(cells[m, q : q + 1], others, lattice, buffers, costs[pair + 1 :])
                pair += 1 + len(others)
    return len(grids), used, -1


@kernel
def _fill_costs(source: Ints, cells: Ints, lattice: Lattice, buffers: Scratch, costs: Ints) -> None:
    """Write the costs of A* from ``source`` (1,) to each of ``cells``, by the least work."""
    if lattice.step != UNIT and len(cells) >= _MANY:
        # sqrt(2) is irrational: only one pair of numbers of straight and diagonal moves has the
        # least cost, so that any optimal search finds that of A*.
        shortest_costs(source, FAR, lattice, buffers)
        for k in range(len(cells)):
            cost = buffers.g[cells[k]]
            costs[k, 0] = -1
            costs[k, 1] = 0
            if cost != FAR:
                costs[k, 0], costs[k, 1] = parts(cost)
    else:
        for k in range(len(cells)):
            _, pushes = best_first(source[0], cells[k], ASTAR, lattice, buffers)
            costs[k, 0], costs[k, 1] = count_moves(buffers.came, source[0], cells[k], lattice)
            wipe(buffers, pushes)
