"""Probabilistic roadmaps in the plane over a grid: samplers, edges, the shortest path.

A point is (row, column), fractions allowed. It lies in the cell of its floor, so that the centre of
a cell is its row and column plus 0.5. Two vertices of a roadmap are joined where they are within
`connection_radius` of each other and the segment between them meets no occupied cell. A path
between cells is a path between their centres. Samplers are compared by the roadmaps of their
points.

    from mapdata import Movement, ProblemSet
    from mapdata.roadmaps import halton, roadmap_between

    problems = ProblemSet.sample("dungeon", seed=77, maps=1, movement=Movement(8))
    grid, start, goal = problems.grids[0], problems.starts[0], problems.goals[0]
    roadmap = roadmap_between(grid, start, goal, halton(grid, 100, seed=1))
    length, vertices = roadmap.shortest_path()  # the length is inf where there is no path
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

MapSampler = Callable[[ArrayLike, int, int], Floats]
"""A sampler that sees the map alone: from a grid (H, W), n and a seed to (n, 2) free points."""

RADIUS_FACTOR = 1.5
"""Vertices are joined within RADIUS_FACTOR * sqrt(log n / n) of the side of the map."""


NO_ROADMAPS_ON_TERRAIN = (
    "roadmaps: got maps with terrain, expected maps whose free cells all cost the same, since "
    "roadmaps are searched by length; take maps without terrain"
)
"""The error for samplers on terrain, whose costs neither they nor the roadmaps look at."""

# --- roadmaps -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Roadmap:
    """Vertices and the edges between them.

    Attributes:
        points: (n, 2) float64; in a roadmap between two cells, vertex 0 is the start and vertex 1
            the goal.
        edges: (m, 2), the two vertices of each edge; every edge is listed in one direction.
        lengths: (m,) float64, lengths of the edges, in cells.
    """

    points: Floats
    edges: Ints
    lengths: Floats

    def shortest_path(self) -> tuple[float, Ints]:
        """Return the length of the shortest path from vertex 0 to 1, and its vertices (k,).

        Without a path the length is inf, and there are no vertices.
        """
        return self.priced_path(np.ones(len(self.points)))

    def priced_path(self, prices: Floats) -> tuple[float, Ints]:
        """Return the cost of the cheapest path from vertex 0 to 1, and its vertices (k,).

        An edge costs its length times a price. Without a path the cost is inf, and there are no
        vertices.

        Args:
            prices: (n,), positive; the price of an edge is the greater one of its two vertices. inf
                closes a vertex.
        """
        i, j = self.edges.T  # (m,) both
        edge_costs = self.lengths * np.maximum(prices[i], prices[j])
        graph = csr_matrix((edge_costs, (i, j)), (len(prices), len(prices)))
        costs, predecessors = dijkstra(graph, directed=False, indices=0, return_predecessors=True)
        if np.isinf(costs[1]):
            return math.inf, np.empty(0, np.int64)
        path = [1]
        while path[-1] != 0:
            path.append(predecessors[path[-1]])
        return float(costs[1]), np.array(path[::-1], np.int64)


def connection_radius(vertices: int, shape: tuple[int, ...]) -> float:
    """Return the largest length of an edge in a roadmap of ``vertices`` on a map, in cells.

    It is the radius of PRM* (Karaman, Frazzoli, IJRR 2011), RADIUS_FACTOR * sqrt(log n / n) * side:

        n       number of vertices; 3 where there are fewer, from which on the radius falls
        side    side of the square with the area of the map, in cells

    Args:
        vertices: number of vertices.
        shape: (rows, columns) of the map.
    """
    n = max(vertices, 3)
    side = math.sqrt(shape[0] * shape[1])
    return RADIUS_FACTOR * math.sqrt(math.log(n) / n) * side


def build_roadmap(grid: ArrayLike, points: ArrayLike, max_length: float) -> Roadmap:
    """Return the roadmap of ``points``.

    Args:
        grid: (H, W), 0 free and 1 occupied.
        points: (n, 2), row and column, in free cells; the centre of a cell is at + 0.5.
        max_length: largest length of an edge, in cells.

    Raises:
        ValueError: a point outside the map or in an occupied cell, or a largest length that is not
            positive.
    """
    cells = _as_grid(grid)
    vertices = _as_points(points)
    if not max_length > 0:  # "not >" also refuses NaN
        raise ValueError(f"max_length: got {max_length}, expected a positive number")
    is_free = free_at(cells, vertices)
    if not is_free.all():
        wrong = vertices[np.argmin(is_free)].tolist()
        raise ValueError(
            f"points: got {wrong}, expected points in free cells of a map of {cells.shape}"
        )
    pairs = cKDTree(vertices).query_pairs(max_length, output_type="ndarray")  # (p, 2)
    starts, ends = vertices[pairs.T]  # (p, 2) both
    is_edge = segments_are_free(cells, starts, ends)  # (p,)
    lengths = np.linalg.norm(starts - ends, axis=1)  # (p,)
    return Roadmap(vertices, pairs[is_edge], lengths[is_edge])


def roadmap_between(
    grid: ArrayLike, start: ArrayLike, goal: ArrayLike, samples: ArrayLike
) -> Roadmap:
    """Return the roadmap of the centres of two cells and of ``samples``, (n, 2).

    Its connection radius is that of n vertices.

    Raises:
        ValueError: a cell or sample outside the map or occupied.
    """
    cells = _as_grid(grid)
    points = _as_points(samples)
    ends = np.array([start, goal], np.int64) + 0.5
    max_length = connection_radius(len(points), cells.shape)
    return build_roadmap(cells, np.concatenate([ends, points]), max_length)


def path_lengths(grids: Bytes, starts: Ints, goals: Ints, samples: Floats) -> Floats:
    """Return (B,) lengths of the shortest paths on B roadmaps of `roadmap_between`.

    A length is inf where there is no path.

    Args:
        grids: (B, H, W).
        starts: (B, 2), cells.
        goals: (B, 2), cells.
        samples: (B, n, 2).

    Raises:
        ValueError: a cell or sample outside its map or occupied.
    """
    lengths = []
    for grid, start, goal, points in zip(grids, starts, goals, samples, strict=True):
        length, _ = roadmap_between(grid, start, goal, points).shortest_path()
        lengths.append(length)
    return np.array(lengths)


def free_at(grid: ArrayLike, points: ArrayLike) -> Flags:
    """Return (n,) bool: which points (n, 2) lie in free cells of the map (H, W)."""
    cells = np.floor(_as_points(points))
    # Interpolation of order 0 is the value of the cell itself; all is occupied outside the map.
    is_free: Flags = map_coordinates(np.asarray(grid), cells.T, order=0, cval=1) == 0
    return is_free


def _as_points(points: ArrayLike) -> Floats:
    """Return points as a new array, (n, 2)."""
    return np.array(points, np.float64).reshape(-1, 2)


def _as_grid(grid: ArrayLike) -> Bytes:
    """Return a map as an array (H, W) of 0 free and 1 occupied."""
    cells: Bytes = np.not_equal(grid, 0).astype(np.uint8)
    if cells.ndim != 2 or cells.size == 0:
        raise ValueError(f"grid: got shape {cells.shape}, expected (rows, columns)")
    return cells


# --- kernels ------------------------------------------------------------------------------------


@kernel
def _segment_is_free(grid: Bytes, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Return whether all cells from (x0, y0) to (x1, y1) are free.

    It walks from cell to cell (Amanatides, Woo, Eurographics 1987). Distances are not summed up, so
    that the segment meets corners exactly.
    """
    i = math.floor(x0)
    j = math.floor(y0)
    last_i = math.floor(x1)
    last_j = math.floor(y1)
    height = abs(x1 - x0)
    width = abs(y1 - y0)
    step_i = 1 if x1 > x0 else -1
    step_j = 1 if y1 > y0 else -1
    # The segment leaves row i at its far border, which is row i + 1 downwards and row i upwards.
    border_i = 1 if x1 > x0 else 0
    border_j = 1 if y1 > y0 else 0
    if grid[i, j]:
        return False
    while i != last_i or j != last_j:
        # How far the borders of the next row and column are along the segment: fractions of its
        # length, times height * width, so that nothing is divided by 0.
        to_next_i = abs(i + border_i - x0) * width
        to_next_j = abs(j + border_j - y0) * height
        if j == last_j or (i != last_i and to_next_i < to_next_j):
            i += step_i
        elif i == last_i or to_next_j < to_next_i:
            j += step_j
        else:
            # The segment goes through a corner: both cells beside it must be free.
            if grid[i + step_i, j] or grid[i, j + step_j]:
                return False
            i += step_i
            j += step_j
        if grid[i, j]:
            return False
    return True


@kernel
def segments_are_free(grid: Bytes, starts: Floats, ends: Floats) -> Flags:
    """Return (n,) bool: which segments between points (n, 2) float64 meet no occupied cell.

    A segment through the corner of a cell meets that cell, too. Nothing is checked: both arrays
    must have the same length, and all points must lie in the map (H, W).
    """
    is_free = np.empty(len(starts), np.bool_)
    for k in range(len(starts)):
        is_free[k] = _segment_is_free(grid, starts[k, 0], starts[k, 1], ends[k, 0], ends[k, 1])
    return is_free


# --- samplers -----------------------------------------------------------------------------------


def halton(grid: ArrayLike, n: int, seed: int = 0) -> Floats:
    """Return (n, 2): the first free points of the Halton sequence, randomly shifted on the torus.

    Raises:
        ValueError: no free cell, or n below 1; all samplers raise this.
    """
    cells = _checked_grid(grid, n)
    shift = np.random.default_rng(seed).random(2)
    free_cells = (cells == 0).sum()
    count = 2 * n * cells.size // free_cells + 64  # twice what is enough on average
    while True:
        sequence = qmc.Halton(2, scramble=False).random(count)  # (count, 2) in [0, 1)
        points: Floats = (sequence + shift) % 1 * cells.shape
        points = points[free_at(cells, points)]
        if len(points) >= n:
            return points[:n]
        count *= 2


def uniform(grid: ArrayLike, n: int, seed: int = 0) -> Floats:
    """Return (n, 2) points, uniform over the free cells."""
    free_cells = np.argwhere(_checked_grid(grid, n) == 0)
    rng = np.random.default_rng(seed)
    cells = free_cells[rng.integers(len(free_cells), size=n)]
    return cells + rng.random((n, 2))


def gaussian(grid: ArrayLike, n: int, seed: int = 0) -> Floats:
    """Return (n, 2) points near obstacles: free points that lie near a random point that is not.

    Boor, Overmars, van der Stappen, ICRA 1999. The second point is drawn from a normal distribution
    of 3 cells around the first; the border of the map is an obstacle. Points that are missing after
    100 rounds are uniform.
    """
    return _points_of_pairs(grid, n, seed, spread=3.0, bridge_test=False)


def bridge(grid: ArrayLike, n: int, seed: int = 0) -> Floats:
    """Return (n, 2) points in narrow passages: free middles of two points that are not free.

    Hsu, Jiang, Reif, Sun, ICRA 2003. The second point is drawn from a normal distribution of 6
    cells around the first; the border of the map is an obstacle. Points that are missing after 100
    rounds are uniform.
    """
    return _points_of_pairs(grid, n, seed, spread=6.0, bridge_test=True)


def corners(grid: ArrayLike, n: int, seed: int = 0) -> Floats:
    """Return (n, 2) points where shortest paths turn: in free cells at convex corners of obstacles.

    These are the vertices of a visibility graph (Lozano-Perez, Wesley, CACM 1979). They come in
    farthest-point order: the next cell is the one that is farthest from all cells before it.
    """
    occupied = _checked_grid(grid, n)
    cells = np.argwhere(occupied == 0)
    at_corner = np.zeros(len(cells), bool)
    for diagonal in STEPS[4:]:
        vertical, horizontal = diagonal * np.eye(2)
        corner_is_occupied = ~free_at(occupied, cells + diagonal)
        sides_are_free = free_at(occupied, cells + vertical) & free_at(occupied, cells + horizontal)
        at_corner |= corner_is_occupied & sides_are_free
    return _farthest_first(occupied, cells[at_corner], n, seed)


def medial_axis(grid: ArrayLike, n: int, seed: int = 0) -> Floats:
    """Return (n, 2) points on the ridges of the distance to obstacles, in farthest-point order.

    MAPRM moves its samples onto these ridges (Wilmarth, Amato, Stiller, ICRA 1999). Points are
    (row, col) in cells. Where the ridges have fewer than n cells, Halton's points follow.

    Args:
        grid: (H, W), 0 free and 1 occupied.
        n: number of points.
        seed: seed of the first point, and of where points lie inside their cells.

    Raises:
        ValueError: a map that is not two-dimensional or has no free cell, or n below 1.
    """
    cells = _checked_grid(grid, n)
    clearance = distance_transform_edt(np.pad(cells == 0, 1))  # the border is an obstacle
    # Where the distance rises or falls evenly its Laplacian is near 0, on a ridge -1 or less.
    on_ridge = laplace(clearance)[1:-1, 1:-1] < -0.5
    return _farthest_first(cells, np.argwhere(on_ridge), n, seed)


SAMPLERS: dict[str, MapSampler] = {
    "halton": halton,
    "uniform": uniform,
    "gaussian": gaussian,
    "bridge": bridge,
    "corners": corners,
    "medial_axis": medial_axis,
}
"""Samplers that learn nothing, by name."""


def _farthest_first(grid: Bytes, cells: Ints, n: int, seed: int) -> Floats:
    """Return (n, 2) points in some of the cells (k, 2), each as far as possible from those before.

    The first cell is random. Where there are fewer than n cells, Halton's points follow.
    """
    rng = np.random.default_rng(seed)
    selected = []
    # From each cell to the nearest selected one; at first all are equally far, and the noise below
    # one cell selects a random one.
    distances = 1e9 + rng.random(len(cells))
    for _ in range(min(n, len(cells))):
        selected.append(distances.argmax())
        from_last = np.linalg.norm(cells - cells[selected[-1]], axis=1)
        distances = np.minimum(distances, from_last)
    points = cells[selected] + rng.random((len(selected), 2))
    return np.concatenate([points, halton(grid, n, seed + 1)])[:n]


def _points_of_pairs(
    grid: ArrayLike, n: int, seed: int, spread: float, bridge_test: bool
) -> Floats:
    """Return (n, 2) free points, made of random pairs of points.

    Args:
        grid: (H, W), 0 free and 1 occupied.
        n: number of points.
        seed: seed of the pairs.
        spread: standard deviation of the second point around the first, in cells.
        bridge_test: False takes the first point where the second is not free, True takes the middle
            where neither point is free.
    """
    cells = _checked_grid(grid, n)
    rng = np.random.default_rng(seed)
    accepted = np.empty((0, 2))
    for _ in range(100):
        first = rng.random((16 * n + 256, 2)) * cells.shape
        second = first + rng.normal(0, spread, first.shape)
        if bridge_test:
            points = (first + second) / 2
            near_obstacles = ~free_at(cells, first) & ~free_at(cells, second)
        else:
            points = first
            near_obstacles = ~free_at(cells, second)
        is_accepted = free_at(cells, points) & near_obstacles
        accepted = np.concatenate([accepted, points[is_accepted]])
        if len(accepted) >= n:
            return accepted[:n]
    return np.concatenate([accepted, uniform(cells, n - len(accepted), seed)])


def _checked_grid(grid: ArrayLike, n: int) -> Bytes:
    """Return a map (H, W) of 0 and 1 in which n points can be sampled."""
    cells = _as_grid(grid)
    check_count("n", n)
    if cells.all():
        raise ValueError(
            f"grid: got a map of {cells.shape} without a free cell, expected one to sample in"
        )
    return cells
