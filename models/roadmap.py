"""Probabilistic roadmaps in the plane over a grid: where to sample, which samples see each other,
the shortest way.

A point is (row, column), fractions allowed; it lies in the cell of its floor, so that a cell's
centre is its coordinate plus 0.5. Samplers are compared by the roadmap of their points: two
vertices are joined within `radius` of each other where the segment between them meets no occupied
cell. A path between cells is one between their centres.

    from mapdata import MapSpec
    from mapdata.problems import Problems
    from models.roadmap import between, halton

    drawn = Problems.sample(MapSpec.preset("dungeon"), seed=77, maps=1)
    grid, start, goal = drawn.grids[0], drawn.starts[0], drawn.goals[0]
    roadmap = between(grid, start, goal, halton(grid, 100, seed=1))
    length, vertices = roadmap.shortest_path()  # length inf where there is none
    print(length, roadmap.points[vertices])
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.sparse import csgraph, csr_matrix
from scipy.stats import qmc

from mapdata.arrays import Bytes, Flags, Floats, Ints
from mapdata.jit import Int, kernel

REACH = 1.5
"""Vertices are joined within REACH * sqrt(log n / n) of the map's side."""


# --- roadmaps -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Roadmap:
    """Vertices, and for each its neighbours as in a compressed sparse row matrix; every edge is
    there both ways.

    Attributes:
        points: (n, 2) float64; of a roadmap between two cells, vertex 0 is the start and vertex 1
            the goal.
        offsets: (n + 1,) int64: the neighbours of vertex v are ``neighbours[offsets[v]:offsets[v +
            1]]``.
        neighbours: (2 m,) int64.
        lengths: (2 m,) float64, in cells.
    """

    points: Floats
    offsets: Ints
    neighbours: Ints
    lengths: Floats

    @property
    def edges(self) -> Ints:
        """(m, 2) int64, each edge once."""
        sources = np.repeat(np.arange(len(self.points)), np.diff(self.offsets))
        once = sources < self.neighbours
        return np.stack([sources[once], self.neighbours[once]], axis=1)

    def shortest_path(self, source: int = 0, target: int = 1) -> tuple[float, Ints]:
        """Return the length of the shortest path, inf without one, and its vertices (k,)."""
        n = len(self.points)
        graph = csr_matrix((self.lengths, self.neighbours, self.offsets), shape=(n, n))
        costs, before = csgraph.dijkstra(graph, indices=source, return_predecessors=True)
        if not np.isfinite(costs[target]):
            return math.inf, np.empty(0, np.int64)
        vertices = [target]
        while vertices[-1] != source:
            vertices.append(int(before[vertices[-1]]))
        return float(costs[target]), np.array(vertices[::-1])

    def priced_path(self, prices: Floats, source: int = 0, target: int = 1) -> tuple[float, Ints]:
        """Return cost and vertices as `shortest_path` does, where an edge costs its length times
        the greater price.

        Args:
            prices: (n,) at least 1; inf closes a vertex.
            source: its number.
            target: likewise.
        """
        return _search(
            self.points, self.offsets, self.neighbours, self.lengths, prices, source, target
        )


def radius(vertices: int, shape: tuple[int, ...]) -> float:
    """Return how far edges reach in a roadmap of ``vertices`` on a map of (rows, columns), in
    cells.

    The side of a map that is not square is that of the square with its area; fewer than 3 vertices
    reach as 3 do.
    """
    n = max(vertices, 3)
    return REACH * math.sqrt(math.log(n) / n) * math.sqrt(shape[0] * shape[1])


def build_roadmap(grid: npt.ArrayLike, points: npt.ArrayLike, reach: float) -> Roadmap:
    """Return the roadmap of ``points``.

    Args:
        grid: (H, W), 0 free and 1 occupied.
        points: (n, 2), in free cells.
        reach: longest edge.

    Raises:
        ValueError: a point outside the map or in an occupied cell, or a reach that is not positive.
    """
    cells = _grid(grid)
    places = np.array(points, np.float64).reshape(-1, 2)
    if not reach > 0:
        raise ValueError(f"reach: got {reach}, expected a positive number")
    if not (there := free_at(cells, places)).all():
        wrong = places[np.argmin(there)].tolist()
        raise ValueError(
            f"points: got {wrong}, expected points in free cells of a map of {cells.shape}"
        )
    return Roadmap(places, *_join(cells, places, float(reach)))


def between(
    grid: npt.ArrayLike, start: npt.ArrayLike, goal: npt.ArrayLike, samples: npt.ArrayLike
) -> Roadmap:
    """Return the roadmap of the centres of two cells and of ``samples``, (n, 2), which reaches as n
    vertices do.

    Raises:
        ValueError: a cell or sample outside the map or occupied.
    """
    cells = _grid(grid)
    inner = np.asarray(samples, np.float64).reshape(-1, 2)
    ends = np.array([start, goal], np.int64).reshape(2, 2) + 0.5
    return build_roadmap(cells, np.concatenate([ends, inner]), radius(len(inner), cells.shape))


def path_lengths(grids: Bytes, starts: Ints, goals: Ints, samples: Floats) -> Floats:
    """Return (B,) lengths of the shortest paths on B roadmaps as `between` makes them, inf without
    one.

    Args:
        grids: (B, H, W).
        starts: (B, 2), cells.
        goals: (B, 2), cells.
        samples: (B, n, 2).

    Raises:
        ValueError: as `between`.
    """
    found = np.empty(len(grids))
    for k, (grid, start, goal, points) in enumerate(
        zip(grids, starts, goals, samples, strict=True)
    ):
        roadmap = between(grid, start, goal, points)
        found[k] = roadmap.priced_path(np.ones(len(roadmap.points)))[0]
    return found


def free_at(grid: npt.ArrayLike, points: npt.ArrayLike) -> Flags:
    """Return (n,) bool: which points (n, 2) lie in free cells of the map."""
    occupied, cells = np.asarray(grid), np.floor(np.asarray(points, np.float64).reshape(-1, 2))
    inside: Flags = np.all((cells >= 0) & (cells < occupied.shape), axis=1)
    rows, columns = np.where(inside[:, None], cells, 0).astype(np.int64).T
    return np.asarray(inside & (occupied[rows, columns] == 0))


def sees(grid: npt.ArrayLike, first: npt.ArrayLike, second: npt.ArrayLike) -> Flags:
    """Return (n,) bool: which segments from ``first`` to ``second``, (n, 2) each, meet no occupied
    cell.

    A segment through the corner of a cell meets it, too. The ends must lie in the map.
    """
    ends = [np.array(points, np.float64).reshape(-1, 2) for points in (first, second)]
    return _all_see(_grid(grid), *ends)


def _grid(grid: npt.ArrayLike) -> Bytes:
    cells = np.array(grid, np.uint8)
    if cells.ndim != 2 or not cells.size:
        raise ValueError(f"grid: got shape {cells.shape}, expected (rows, columns)")
    return cells


# --- kernels ------------------------------------------------------------------------------------


@kernel
def _sees(grid: Bytes, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Walk over all cells from (x0, y0) to (x1, y1). No distance is summed up, so that corners are
    met exactly.
    """
    i, j, last_i, last_j = math.floor(x0), math.floor(y0), math.floor(x1), math.floor(y1)
    high, wide = abs(x1 - x0), abs(y1 - y0)
    down, right = (1 if x1 > x0 else -1), (1 if y1 > y0 else -1)
    below, beside = (1 if down > 0 else 0), (1 if right > 0 else 0)
    if grid[i, j]:
        return False
    while i != last_i or j != last_j:
        to_row, to_column = abs(i + below - x0) * wide, abs(j + beside - y0) * high
        if j == last_j or (i != last_i and to_row < to_column):
            i += down
        elif i == last_i or to_column < to_row:
            j += right
        else:  # through a corner
            if grid[i + down, j] or grid[i, j + right]:
                return False
            i += down
            j += right
        if grid[i, j]:
            return False
    return True


@kernel
def _all_see(grid: Bytes, first: Floats, second: Floats) -> Flags:
    seen = np.empty(len(first), np.bool_)
    for k in range(len(first)):
        seen[k] = _sees(grid, first[k, 0], first[k, 1], second[k, 0], second[k, 1])
    return seen


@kernel
def _join(grid: Bytes, points: Floats, reach: float) -> tuple[Ints, Ints, Floats]:
    """Return offsets, neighbours and lengths of a `Roadmap`; points are looked up in buckets as
    wide as the reach.
    """
    n = len(points)
    tall, broad = int(grid.shape[0] / reach) + 1, int(grid.shape[1] / reach) + 1
    bucket, first = np.empty(n, np.int64), np.zeros(tall * broad + 1, np.int64)
    for v in range(n):
        bucket[v] = int(points[v, 0] / reach) * broad + int(points[v, 1] / reach)
        first[bucket[v] + 1] += 1
    first = np.cumsum(first)
    place, members = first.copy(), np.empty(n, np.int64)
    for v in range(n):
        members[place[bucket[v]]] = v
        place[bucket[v]] += 1
    pairs, spans, count = np.empty((16 * n + 16, 2), np.int64), np.empty(16 * n + 16), 0
    offsets = np.zeros(n + 1, np.int64)
    for v in range(n):
        x, y, row, column = points[v, 0], points[v, 1], bucket[v] // broad, bucket[v] % broad
        for i in range(max(row - 1, 0), min(row + 2, tall)):
            for j in range(max(column - 1, 0), min(column + 2, broad)):
                for k in range(first[i * broad + j], first[i * broad + j + 1]):
                    u = members[k]
                    square = (points[u, 0] - x) ** 2 + (points[u, 1] - y) ** 2
                    if (
                        u <= v
                        or square > reach * reach
                        or not _sees(grid, x, y, points[u, 0], points[u, 1])
                    ):
                        continue
                    if count == len(spans):
                        pairs = np.concatenate((pairs, np.empty_like(pairs)))
                        spans = np.concatenate((spans, np.empty_like(spans)))
                    pairs[count, 0], pairs[count, 1], spans[count] = v, u, math.sqrt(square)
                    offsets[v + 1] += 1
                    offsets[u + 1] += 1
                    count += 1
    offsets = np.cumsum(offsets)
    ends, neighbours, lengths = offsets.copy(), np.empty(2 * count, np.int64), np.empty(2 * count)
    for k in range(count):
        for a in range(2):
            v = pairs[k, a]
            neighbours[ends[v]], lengths[ends[v]] = pairs[k, 1 - a], spans[k]
            ends[v] += 1
    return offsets, neighbours, lengths


@kernel
def _search(
    points: Floats,
    offsets: Ints,
    neighbours: Ints,
    lengths: Floats,
    prices: Floats,
    source: Int,
    target: Int,
) -> tuple[float, Ints]:
    """Return cost and vertices of a cheapest path, by A* with the distance to the target: prices
    are at least 1.
    """
    n, x, y = len(points), points[target, 0], points[target, 1]
    best, before, done = np.full(n, np.inf), np.full(n, -1), np.zeros(n, np.bool_)
    best[source] = 0.0
    heap = [(0.0, source)]
    while heap:
        _, v = heapq.heappop(heap)
        if v == target:
            break
        if done[v]:
            continue
        done[v] = True
        for k in range(offsets[v], offsets[v + 1]):
            u = neighbours[k]
            cost = best[v] + lengths[k] * max(prices[u], prices[v])
            if cost < best[u]:
                best[u], before[u] = cost, v
                heapq.heappush(heap, (cost + math.hypot(points[u, 0] - x, points[u, 1] - y), u))
    steps, v = 0, target if best[target] < np.inf else -1
    while v >= 0:
        steps, v = steps + 1, before[v]
    path, v = np.empty(steps, np.int64), target
    for k in range(steps - 1, -1, -1):
        path[k] = v
        v = before[v]
    return float(best[target]), path


# --- samplers -----------------------------------------------------------------------------------


def halton(grid: npt.ArrayLike, n: int, seed: int = 0) -> Floats:
    """Return (n, 2): the first points of the Halton sequence that are free, after a random shift of
    the torus.

    Raises:
        ValueError: no free cell, or n below 1; so do all samplers.
    """
    cells, shift = _free(grid, n), np.random.default_rng(seed).random(2)
    count = 2 * n * cells.size // int((cells == 0).sum()) + 64
    while True:
        points = (_halton(count) + shift) % 1 * cells.shape
        points = points[free_at(cells, points)]
        if len(points) >= n:
            return points[:n]
        count *= 2


def uniform(grid: npt.ArrayLike, n: int, seed: int = 0) -> Floats:
    """Return (n, 2) points, uniform over the free cells."""
    free, source = np.argwhere(_free(grid, n) == 0), np.random.default_rng(seed)
    points: Floats = np.asarray(free[source.integers(len(free), size=n)] + source.random((n, 2)))
    return points


def gaussian(grid: npt.ArrayLike, n: int, seed: int = 0, spread: float = 3.0) -> Floats:
    """Return (n, 2) points near obstacles: free ones of pairs of which the other is not free.

    Boor, Overmars, van der Stappen, ICRA 1999. ``spread`` is the pair's standard deviation in
    cells; the border of the map is an obstacle. What 100 rounds do not find is uniform.
    """
    cells = _free(grid, n)

    def draw(source: np.random.Generator, count: int) -> Floats:
        first = source.random((count, 2)) * cells.shape
        second = first + source.normal(0, spread, (count, 2))
        one, other = free_at(cells, first), free_at(cells, second)
        return np.asarray(np.where(one[:, None], first, second)[one != other])

    return _rounds(cells, n, seed, draw)


def bridge(grid: npt.ArrayLike, n: int, seed: int = 0, spread: float = 6.0) -> Floats:
    """Return (n, 2) points in narrow passages: free middles of pairs of which neither is free.

    Hsu, Jiang, Reif, Sun, ICRA 2003; as `gaussian` otherwise.
    """
    cells = _free(grid, n)

    def draw(source: np.random.Generator, count: int) -> Floats:
        first = source.random((count, 2)) * cells.shape
        second = first + source.normal(0, spread, (count, 2))
        middle = (first + second) / 2
        return middle[~free_at(cells, first) & ~free_at(cells, second) & free_at(cells, middle)]

    return _rounds(cells, n, seed, draw)


SAMPLERS: dict[str, Callable[[npt.ArrayLike, int, int], Floats]] = {
    "halton": halton,
    "uniform": uniform,
    "gaussian": gaussian,
    "bridge": bridge,
}
"""Samplers that learn nothing, by name."""


def _rounds(
    cells: Bytes, n: int, seed: int, draw: Callable[[np.random.Generator, int], Floats]
) -> Floats:
    source, found = np.random.default_rng(seed), np.empty((0, 2))
    for _ in range(100):
        found = np.concatenate([found, draw(source, 16 * n + 256)])
        if len(found) >= n:
            return found[:n]
    return np.concatenate([found, uniform(cells, n - len(found), seed)])


def _free(grid: npt.ArrayLike, n: int) -> Bytes:
    cells = _grid(grid)
    if n < 1:
        raise ValueError(f"n: got {n}, expected at least 1 sample")
    if cells.all():
        raise ValueError(
            f"grid: got a map of {cells.shape} without a free cell, expected one to sample in"
        )
    return cells


@lru_cache(maxsize=1)
def _longest(count: int) -> Floats:
    points: Floats = qmc.Halton(2, scramble=False).random(count)
    return points


def _halton(count: int) -> Floats:
    return _longest(1 << max(count - 1, 4095).bit_length())[:count]
