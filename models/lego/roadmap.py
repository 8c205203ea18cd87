"""Probabilistic roadmaps in the plane over a grid: samplers, edges, the shortest way.

A point is (row, column), fractions allowed; it lies in the cell of its floor, so that a cell's
centre is its coordinate plus 0.5. Samplers are compared by the roadmap of their points: two
vertices are joined within `radius` of each other where the segment between them meets no occupied
cell. A path between cells is one between their centres.

    from mapdata import MapSpec, Problems
    from models.lego.roadmap import between, halton

    drawn = Problems.sample(MapSpec.preset("dungeon"), seed=77, maps=1)
    grid, start, goal = drawn.grids[0], drawn.starts[0], drawn.goals[0]
    roadmap = between(grid, start, goal, halton(grid, 100, seed=1))
    length, vertices = roadmap.shortest_path()  # length inf where there is none
    print(length, roadmap.points[vertices])
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import distance_transform_edt, laplace, map_coordinates
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree
from scipy.stats import qmc

from mapdata.arrays import Bytes, Flags, Floats, Ints
from mapdata.checks import check_count
from mapdata.jit import kernel
from mapdata.search import STEPS

Points = Callable[[ArrayLike, int, int], Floats]
"""A sampler that sees the map alone: from a grid (H, W), n and a seed to (n, 2) free points."""

REACH = 1.5
"""Vertices are joined within REACH * sqrt(log n / n) of the map's side."""


# --- roadmaps -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Roadmap:
    """Vertices and the edges between them.

    Attributes:
        points: (n, 2) float64; of a roadmap between two cells, vertex 0 is the start and vertex 1
            the goal.
        edges: (m, 2), the vertices that each edge joins, each once.
        lengths: (m,) float64, of the edges, in cells.
    """

    points: Floats
    edges: Ints
    lengths: Floats

    def shortest_path(self) -> tuple[float, Ints]:
        """Return the length of the shortest path from vertex 0 to 1, and its vertices (k,).

        The length is inf where there is no path.
        """
        return self.priced_path(np.ones(len(self.points)))

    def priced_path(self, prices: Floats) -> tuple[float, Ints]:
        """Return what `shortest_path` does, where an edge costs its length times a price.

        Args:
            prices: (n,), positive; that of an edge is the greater one of its ends. inf closes a
                vertex.
        """
        i, j = self.edges.T  # (m,) both
        costs = self.lengths * np.maximum(prices[i], prices[j])
        graph = csr_matrix((costs, (i, j)), (len(prices), len(prices)))
        found, before = dijkstra(graph, directed=False, indices=0, return_predecessors=True)
        path = []
        vertex = 1 if found[1] < np.inf else -1
        while vertex >= 0:  # backwards from the target; a negative number is before the start
            path.append(vertex)
            vertex = before[vertex]
        return float(found[1]), np.array(path[::-1], np.int64)


def radius(vertices: int, shape: tuple[int, ...]) -> float:
    """Return how far edges reach in a roadmap of ``vertices`` on a map (rows, columns), in cells.

    The side of a map that is not square is that of the square with its area; fewer than 3 vertices
    reach as 3 do.
    """
    n = max(vertices, 3)
    return REACH * math.sqrt(math.log(n) / n) * math.sqrt(shape[0] * shape[1])


def build_roadmap(grid: ArrayLike, points: ArrayLike, reach: float) -> Roadmap:
    """Return the roadmap of ``points``.

    Args:
        grid: (H, W), 0 free and 1 occupied.
        points: (n, 2), row and column, in free cells; a cell's centre is at + 0.5.
        reach: longest edge, in cells.

    Raises:
        ValueError: a point outside the map or in an occupied cell, or a reach that is not positive.
    """
    cells = _grid(grid)
    places = _as_points(points)
    if not reach > 0:
        raise ValueError(f"reach: got {reach}, expected a positive number")
    free = free_at(cells, places)
    if not free.all():
        wrong = places[np.argmin(free)].tolist()
        raise ValueError(
            f"points: got {wrong}, expected points in free cells of a map of {cells.shape}"
        )
    pairs = cKDTree(places).query_pairs(reach, output_type="ndarray")  # (p, 2)
    first, second = places[pairs.T]  # (p, 2) both
    seen = sees(cells, first, second)  # (p,)
    lengths = np.linalg.norm(first - second, axis=1)  # (p,)
    return Roadmap(places, pairs[seen], lengths[seen])


def between(grid: ArrayLike, start: ArrayLike, goal: ArrayLike, samples: ArrayLike) -> Roadmap:
    """Return the roadmap of the centres of two cells and of ``samples``, (n, 2).

    It reaches as n vertices do.

    Raises:
        ValueError: a cell or sample outside the map or occupied.
    """
    cells = _grid(grid)
    inner = _as_points(samples)
    ends = np.array([start, goal], np.int64) + 0.5
    return build_roadmap(cells, np.concatenate([ends, inner]), radius(len(inner), cells.shape))


def path_lengths(grids: Bytes, starts: Ints, goals: Ints, samples: Floats) -> Floats:
    """Return (B,) lengths of the shortest paths on B roadmaps of `between`, inf without one.

    Args:
        grids: (B, H, W).
        starts: (B, 2), cells.
        goals: (B, 2), cells.
        samples: (B, n, 2).

    Raises:
        ValueError: as `between`.
    """
    problems = zip(grids, starts, goals, samples, strict=True)
    return np.array([between(*problem).shortest_path()[0] for problem in problems])


def free_at(grid: ArrayLike, points: ArrayLike) -> Flags:
    """Return (n,) bool: which points (n, 2) lie in free cells of the map."""
    cells = np.floor(_as_points(points))
    # of order 0, the value of a cell itself; outside the map all is occupied
    free: Flags = map_coordinates(np.asarray(grid), cells.T, order=0, cval=1) == 0
    return free


def _as_points(points: ArrayLike) -> Floats:
    """Return points as a new array, (n, 2)."""
    return np.array(points, np.float64).reshape(-1, 2)


def _grid(grid: ArrayLike) -> Bytes:
    cells: Bytes = np.not_equal(grid, 0).astype(np.uint8)
    if cells.ndim != 2 or not cells.size:
        raise ValueError(f"grid: got shape {cells.shape}, expected (rows, columns)")
    return cells


# --- kernels ------------------------------------------------------------------------------------


@kernel
def _sees(grid: Bytes, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Walk over all cells from (x0, y0) to (x1, y1); tell whether they are free.

    No distance is summed up, so that corners are met exactly.
    """
    i = math.floor(x0)
    j = math.floor(y0)
    last_i = math.floor(x1)
    last_j = math.floor(y1)
    high = abs(x1 - x0)
    wide = abs(y1 - y0)
    down = 1 if x1 > x0 else -1
    right = 1 if y1 > y0 else -1
    below = max(down, 0)  # the border that the segment meets next is at row i + below
    beside = max(right, 0)
    if grid[i, j]:
        return False
    while i != last_i or j != last_j:
        # how far the next row and the next column are along the segment, times high * wide
        to_row = abs(i + below - x0) * wide
        to_column = abs(j + beside - y0) * high
        if j == last_j or (i != last_i and to_row < to_column):
            i += down
        elif i == last_i or to_column < to_row:
            j += right
        else:  # through a corner: both cells beside it must be free
            if grid[i + down, j] or grid[i, j + right]:
                return False
            i += down
            j += right
        if grid[i, j]:
            return False
    return True


@kernel
def sees(grid: Bytes, first: Floats, second: Floats) -> Flags:
    """Return (n,) bool: which segments between points (n, 2) float64 meet no occupied cell.

    A segment through the corner of a cell meets it, too. Nothing is checked: the arrays must be as
    long as each other, and all points lie in the map (H, W).
    """
    seen = np.empty(len(first), np.bool_)
    for k in range(len(first)):
        seen[k] = _sees(grid, first[k, 0], first[k, 1], second[k, 0], second[k, 1])
    return seen


# --- samplers -----------------------------------------------------------------------------------


def halton(grid: ArrayLike, n: int, seed: int = 0) -> Floats:
    """Return (n, 2): the first free points of the Halton sequence, randomly shifted on the torus.

    Raises:
        ValueError: no free cell, or n below 1; so do all samplers.
    """
    cells = _free(grid, n)
    shift = np.random.default_rng(seed).random(2)
    count = 2 * n * cells.size // (cells == 0).sum() + 64  # twice what should do
    while True:
        points: Floats = (qmc.Halton(2, scramble=False).random(count) + shift) % 1 * cells.shape
        points = points[free_at(cells, points)]
        if len(points) >= n:
            return points[:n]
        count *= 2


def uniform(grid: ArrayLike, n: int, seed: int = 0) -> Floats:
    """Return (n, 2) points, uniform over the free cells."""
    free = np.argwhere(_free(grid, n) == 0)
    source = np.random.default_rng(seed)
    corners = free[source.integers(len(free), size=n)]
    return corners + source.random((n, 2))


def gaussian(grid: ArrayLike, n: int, seed: int = 0) -> Floats:
    """Return (n, 2) points near obstacles: free ones beside which a random point is not free.

    Boor, Overmars, van der Stappen, ICRA 1999. The other point is as far as a normal distribution
    says, of 3 cells; the border of the map is an obstacle. What 100 rounds do not find is uniform.
    """
    return _rounds(grid, n, seed, 3.0)


def bridge(grid: ArrayLike, n: int, seed: int = 0) -> Floats:
    """Return (n, 2) points in narrow passages: free middles of pairs of which neither is free.

    Hsu, Jiang, Reif, Sun, ICRA 2003; as `gaussian` otherwise, with 6 cells.
    """
    return _rounds(grid, n, seed, 6.0, between_walls=True)


def corners(grid: ArrayLike, n: int, seed: int = 0) -> Floats:
    """Return (n, 2) points where shortest paths turn: in free cells at obstacles' convex corners.

    The vertices of a visibility graph (Lozano-Perez, Wesley, CACM 1979), in farthest-point order:
    each next cell is the one farthest from those before it.
    """
    cells = _free(grid, n)
    places = np.argwhere(cells == 0)
    at_corner = np.zeros(len(places), bool)
    for diagonal in STEPS[4:]:
        sides = [free_at(cells, places + diagonal * axis) for axis in np.eye(2)]
        at_corner |= sides[0] & sides[1] & ~free_at(cells, places + diagonal)
    return _farthest_first(cells, places[at_corner], n, seed)


def medial_axis(grid: ArrayLike, n: int, seed: int = 0) -> Floats:
    """Return (n, 2) points on the ridges of the distance to obstacles, in farthest-point order.

    The places to which MAPRM moves its samples (Wilmarth, Amato, Stiller, ICRA 1999). Points are
    (row, col) in cells. Where the ridges have fewer than n cells, Halton's points follow.

    Args:
        grid: (H, W), 0 free and 1 occupied.
        n: how many points.
        seed: of the first point, and of those inside their cells.

    Raises:
        ValueError: a map that is not two-dimensional or has no free cell, or n below 1.
    """
    cells = _free(grid, n)
    clearance = distance_transform_edt(np.pad(cells == 0, 1))  # the border is an obstacle
    # where it rises or falls evenly its Laplacian is near 0, on a ridge -1 or less
    on_ridge = laplace(clearance)[1:-1, 1:-1] < -0.5
    return _farthest_first(cells, np.argwhere(on_ridge), n, seed)


SAMPLERS: dict[str, Points] = {
    "halton": halton,
    "uniform": uniform,
    "gaussian": gaussian,
    "bridge": bridge,
    "corners": corners,
    "medial_axis": medial_axis,
}
"""Samplers that learn nothing, by name."""


def _farthest_first(grid: Bytes, cells: Ints, n: int, seed: int) -> Floats:
    """Return (n, 2) points in some of the cells (k, 2), the first at random, the next far from it.

    Where there are fewer cells, Halton's points follow, of another shift than the seed's.
    """
    source = np.random.default_rng(seed)
    taken = []
    distance = 1e9 + source.random(len(cells))  # from each cell to the nearest one taken
    for _ in cells[:n]:
        taken.append(distance.argmax())
        distance = np.minimum(distance, np.linalg.norm(cells - cells[taken[-1]], axis=1))
    points = cells[taken] + source.random((len(taken), 2))
    return np.concatenate([points, halton(grid, n, seed + 1)])[:n]


def _rounds(
    grid: ArrayLike, n: int, seed: int, spread: float, between_walls: bool = False
) -> Floats:
    """Return (n, 2) points of many random pairs: free first ones, whose second is not free.

    With ``between_walls`` free middles, of pairs of which neither is free.
    """
    cells = _free(grid, n)
    source = np.random.default_rng(seed)
    found = np.empty((0, 2))
    for _ in range(100):
        first = source.random((16 * n + 256, 2)) * cells.shape
        second = first + source.normal(0, spread, first.shape)
        points = (first + second) / 2 if between_walls else first
        chosen = free_at(cells, points) & ~free_at(cells, second)
        if between_walls:
            chosen &= ~free_at(cells, first)
        found = np.concatenate([found, points[chosen]])
        if len(found) >= n:
            return found[:n]
    return np.concatenate([found, uniform(cells, n - len(found), seed)])


def _free(grid: ArrayLike, n: int) -> Bytes:
    cells = _grid(grid)
    check_count("n", n)
    if cells.all():
        raise ValueError(
            f"grid: got a map of {cells.shape} without a free cell, expected one to sample in"
        )
    return cells
