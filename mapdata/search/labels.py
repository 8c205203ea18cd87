"""What the paper computes of a map: routes by BFS and A*, their iterations, connection matrices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from mapdata.arrays import Bytes, Flags, Floats, Ints, Words, offsets_of, summary
from mapdata.generators.maps import Maps, unpack
from mapdata.generators.points import STEPS
from mapdata.jit import Int, kernel
from mapdata.search.bitboard import MAX_SIDE as BIT_SIDE
from mapdata.search.bitboard import bit_labels, bit_scratch
from mapdata.search.kernels import (
    Scratch,
    count_moves,
    expansions_until,
    find,
    flood,
    is_inside,
    scratch,
    shortest_costs,
    wipe,
    with_capacity,
    write_moves,
)
from mapdata.search.lattice import (
    ASTAR,
    BFS,
    FAR,
    UNIT,
    Lattice,
    Rule,
    Weights,
    cell_at,
    lattice_of,
    load,
    parts,
    rule_of,
)
from mapdata.spec import check_choice

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
        costs: (P, 2) int64, straight and diagonal moves between the seeds of each pair, (-1, 0)
            without a path.
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
        s = int(self.maps.segment_offsets[i]) + q
        if not self.reachable[s]:
            return np.empty((0, 2), np.int64)
        moves = labels.moves[labels.offsets[s] : labels.offsets[s + 1]]
        start = self.maps.seed_points[i, q]
        others = start + np.cumsum(STEPS[moves], axis=0)
        return np.concatenate((start[None], others))

    def route(self, search: str, i: int) -> list[Ints]:
        """Return the path through all rooms of map i in their order, as its segments (k, 2)."""
        return [self.segment(search, i, q) for q in range(self._rooms(i) - 1)]

    def iterations(self, search: str, i: int) -> Ints:
        """Return (n - 1,) int64, the iterations of each segment of map i."""
        first = int(self.maps.segment_offsets[i])
        return self.of(search).iterations[first : first + self._rooms(i) - 1]

    def matrix(self, search: str, i: int) -> Floats:
        """Return the connection matrix of map i, (n, n) float64.

        It holds path costs (BFS: moves), 0 on the diagonal, -1 where there is no path.
        """
        n = self._rooms(i)
        first, end = self.maps.pair_offsets[i : i + 2]
        straight, diagonal = self.of(search).costs[first:end].T
        step = 1.0 if search == "bfs" else self.maps.movement.diagonal_cost
        matrix = np.zeros((n, n))
        matrix[_pairs_of(n)] = straight + diagonal * step
        return matrix + matrix.T

    def _rooms(self, i: int) -> int:
        """Return the number of rooms of map i of the batch."""
        if not 0 <= i < len(self.maps):
            raise IndexError(f"map {i} of a batch of {len(self.maps)}")
        return int(self.maps.rooms[i])

    def of(self, search: str) -> SearchLabels:
        """Return the labels by ``search``, "bfs" or "astar"."""
        check_choice("search", search, ("bfs", "astar"))
        return self.bfs if search == "bfs" else self.astar


@cache
def _pairs_of(rooms: int) -> tuple[Ints, Ints]:
    """Return rooms i < j of each pair: `numpy.triu_indices` takes longer than a matrix."""
    return np.triu_indices(rooms, 1)


def label(maps: Maps, advance: Callable[[int], object] | None = None) -> Labels:
    """Return routes, iterations and connection matrices of ``maps`` by BFS and by A*.

    One breadth-first search from each seed point gives its row of the BFS matrix, its segment and
    the iterations. A* searches each segment. Its costs of the other pairs are those of BFS on
    4-connected maps; with diagonals at sqrt(2), where shortest paths of a pair have one number of
    straight and of diagonal moves, one search a room gives them; else A* searches each pair.

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
    segments = int(maps.segment_offsets[-1])
    pairs = int(maps.pair_offsets[-1])
    bfs_table = np.empty((segments, 2), np.int64)
    bfs_costs = np.empty((pairs, 2), np.int64)
    astar_table = np.empty_like(bfs_table)
    astar_costs = np.empty_like(bfs_costs)
    rule = rule_of(maps.movement)
    bfs_moves = []
    astar_moves = []
    most = max(_LEAST_AT_ONCE, _CELLS_AT_ONCE // (maps.packed.shape[1] * maps.columns))
    for first in range(0, max(len(maps), 1), most):  # once for no maps, too
        part = slice(first, first + most)
        *moves, bad = _label(
            maps.packed[part],
            maps.columns,
            maps.rooms[part],
            maps.seed_points[part],
            maps.segment_offsets[first:],
            maps.pair_offsets[first:],
            rule,
            bfs_table,
            bfs_costs,
            astar_table,
            astar_costs,
        )
        if bad >= 0:
            k, q = divmod(bad, maps.seed_points.shape[1])
            cell = tuple(maps.seed_points[first + k, q].tolist())
            raise ValueError(f"seeds: {cell} of map {maps.index[first + k]} is not a free cell")
        bfs_moves.append(moves[0])
        astar_moves.append(moves[1])
        if advance:
            advance(len(maps.rooms[part]))
    if maps.movement.connectivity == 4:
        # Both searches are optimal, and each move costs 1: what BFS found is it.
        astar_costs = bfs_costs.copy()
    bfs = _search_labels(np.concatenate(bfs_moves), bfs_table, bfs_costs)
    astar = _search_labels(np.concatenate(astar_moves), astar_table, astar_costs)
    return Labels(maps, bfs, astar)


def _search_labels(moves: Bytes, table: Ints, costs: Ints) -> SearchLabels:
    """Return the labels of one search from what `_label` gave."""
    offsets = offsets_of(table[:, 0])
    return SearchLabels(moves, offsets, np.ascontiguousarray(table[:, 1]), costs)


@kernel
def _label(
    packed: Words,
    columns: Int,
    rooms: Ints,
    seed_points: Ints,
    segments: Ints,
    pairs: Ints,
    rule: Rule,
    bfs_table: Ints,
    bfs_costs: Ints,
    astar_table: Ints,
    astar_costs: Ints,
) -> tuple[Bytes, Bytes, Int]:
    """Label every map; return the moves of BFS and of A*, and -1.

    If seed point q of map m is not a free cell, the last is m * (most rooms) + q.

    Fills the tables, (S, 2), with number of moves and iterations, and the costs, (P, 2), with
    straight and diagonal moves.
    """
    rows = packed.shape[1]
    lattice = lattice_of((rows, columns), rule)
    grid = np.empty((rows, columns), np.uint8)
    fresh = np.empty(lattice.cells, np.uint8)
    seed_cells = np.empty(seed_points.shape[1], np.int64)
    flooding = scratch(BFS, lattice)
    searching = scratch(ASTAR, lattice)
    bfs_moves = np.empty(1024, np.uint8)
    astar_moves = np.empty(1024, np.uint8)
    # Numbers that are handed on get their final type at once: else the kernels that take them are
    # compiled twice.
    bfs_used = np.int64(0)
    astar_used = np.int64(0)
    small = lattice.diagonals == 0 and max(rows, columns) <= BIT_SIDE
    levels = bit_scratch(small)
    for m in range(len(packed)):
        unpack(packed[m].reshape(-1), 0, grid)
        load(grid, fresh)
        n = rooms[m]
        for q in range(n):
            if not is_inside(grid, seed_points[m, q], 0):
                return bfs_moves, astar_moves, m * len(seed_cells) + q
            row, column = seed_points[m, q]
            seed_cells[q] = cell_at(row, column, lattice)
        at = slice(segments[m], segments[m + 1])
        of = slice(pairs[m], pairs[m + 1])
        if small:
            bfs_moves, bfs_used = bit_labels(
                packed[m],
                columns,
                seed_points[m, :n],
                levels,
                bfs_table[at],
                bfs_costs[of],
                bfs_moves,
                bfs_used,
            )
        else:
            bfs_moves, bfs_used = _search_all(
                BFS,
                fresh,
                seed_cells[:n],
                lattice,
                flooding,
                bfs_table[at],
                bfs_costs[of],
                bfs_moves,
                bfs_used,
            )
        astar_moves, astar_used = _search_all(
            ASTAR,
            fresh,
            seed_cells[:n],
            lattice,
            searching,
            astar_table[at],
            astar_costs[of],
            astar_moves,
            astar_used,
        )
    return bfs_moves[:bfs_used], astar_moves[:astar_used], -1


@kernel
def _search_all(
    search: Weights,
    fresh: Bytes,
    cells: Ints,
    lattice: Lattice,
    buffers: Scratch,
    table: Ints,
    costs: Ints,
    moves: Bytes,
    used: Int,
) -> tuple[Bytes, Int]:
    """Label one map: a search for each segment of the seed ``cells``, and the costs of all pairs.

    BFS floods from each seed until all later ones are seen. A* leaves the other pairs to
    `_fill_costs`, or out under 4-connectivity, where BFS finds the same.
    Returns the moves and their number.
    """
    came = buffers.came
    pair = 0
    for a in range(len(cells) - 1):
        for k in range(lattice.cells):
            came[k] = fresh[k]
        goal = cells[a + 1]
        if search == BFS:
            count = flood(cells[a], cells[a + 1 :], lattice, buffers)
            expansions = expansions_until(buffers.pushed, count, goal)
            straight, diagonal = count_moves(came, cells[a], goal, lattice)
        else:
            straight, diagonal, expansions, pushes = find(cells[a], goal, search, lattice, buffers)
        length = max(straight + diagonal, 0)
        table[a, 0] = length
        table[a, 1] = expansions
        moves = with_capacity(moves, used, length)
        write_moves(came, goal, lattice, moves[used : used + length])
        used += length
        if search == BFS:
            for b in range(a + 1, len(cells)):
                straight, diagonal = count_moves(came, cells[a], cells[b], lattice)
                costs[pair, 0] = straight + diagonal
                costs[pair, 1] = 0
                pair += 1
        else:
            wipe(buffers, pushes)
            costs[pair, 0] = straight
            costs[pair, 1] = diagonal
            if lattice.diagonals:
                _fill_costs(cells[a : a + 1], cells[a + 2 :], lattice, buffers, costs[pair + 1 :])
            pair += len(cells) - a - 1
    return moves, used


@kernel
def _fill_costs(source: Ints, cells: Ints, lattice: Lattice, buffers: Scratch, costs: Ints) -> None:
    """Write what A* finds costs from ``source`` (1,) to each of ``cells``, by the least work."""
    if lattice.step != UNIT and len(cells) >= _MANY:
        # sqrt(2) is irrational: only one pair of numbers of straight and diagonal moves has the
        # least cost, so that any optimal search finds that of A*.
        shortest_costs(source, lattice, buffers)
        for k in range(len(cells)):
            costs[k, 0] = -1
            costs[k, 1] = 0
            if buffers.g[cells[k]] != FAR:
                costs[k, 0], costs[k, 1] = parts(buffers.g[cells[k]])
    else:
        for k in range(len(cells)):
            straight, diagonal, _, pushes = find(source[0], cells[k], ASTAR, lattice, buffers)
            costs[k, 0] = straight
            costs[k, 1] = diagonal
            wipe(buffers, pushes)
