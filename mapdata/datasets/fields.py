"""The fields that a sample can have: `FIELDS` lists a function for each of them.

To add a field, write a function here that takes a `Batch` of B problems and returns an array whose
first axis has length B, and list it in `FIELDS`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mapdata.arrays import Array, Bytes, Float32s, Floats, Ints, summary
from mapdata.datasets.field_kernels import (
    GoalFields,
    fill_goal_fields,
    fill_goal_fields_by_jumps,
    fill_room_matrices,
    mask_paths,
    pad_paths,
    path_probabilities,
)
from mapdata.datasets.maze_image import MazeImage
from mapdata.datasets.sample import padded_path_length
from mapdata.datasets.tiles import Tiles
from mapdata.datasets.waypoints import Waypoints
from mapdata.movement import Movement
from mapdata.problems.drawing import Paths
from mapdata.problems.symmetry import transform_grids
from mapdata.search.api import SEARCHES
from mapdata.search.footprint import clearances, without_occupied
from mapdata.search.kernels import search_memory
from mapdata.search.lattice import BFS, UNIT, move_rule
from mapdata.search.lattice import hardness as hardness_of
from mapdata.search.map_stack import MapStack


class Rooms(NamedTuple):
    """The rooms of a batch.

    Attributes:
        matrix: (B, R, R) float32 connection matrices.
        seed_points: (B, R, 2) int64 cells.
    """

    matrix: Float32s
    seed_points: Ints


def _no_known_paths(search: str) -> None:
    """Return None: no paths are known of any search."""
    del search


@dataclass
class Batch:
    """B problems, from which the functions of `FIELDS` compute the fields.

    Paths, rooms, costs, goal fields, terrain and stored maps are computed when they are first used,
    because only some fields need them.

    Attributes:
        movement: movement of the paths.
        search: "bfs" or "astar", the search whose paths are served.
        grids: (B, H, W) uint8 occupancy as served, after symmetries and inflation.
        starts: (B, 2) int64.
        goals: (B, 2) int64.
        problems: (B,) int64, numbers of the problems in their split.
        compute_map_indices: returns the number of each map in the dataset, as `map_index` has it.
        compute_rooms: returns connection matrices and seed points.
        compute_map_numbers: returns the number of each stored map in its dataset or problem set,
            for errors.
        compute_stored_maps: returns the maps before symmetries and inflation.
        symmetries: (B,) int64, code of the symmetry of each map (`mapdata.problems.symmetry`); 0
            without ``augment``.
        requested_fields: names of the fields that will be computed from this batch.
        max_length: fixed number of rows of ``path``; None for a multiple of 16.
        compute_paths: returns the paths of "bfs" or "astar", or None if they must be searched.
        radius_cells: radius of the robot, in cells.
        has_terrain: whether the stored maps have terrain.
        sampling_seed: seed of what is drawn while loading.
        epoch: pass over the data.
    """

    movement: Movement
    search: str
    grids: Bytes
    starts: Ints
    goals: Ints
    problems: Ints
    compute_map_indices: Callable[[], Ints]
    compute_rooms: Callable[[], Rooms]
    compute_map_numbers: Callable[[], Ints]
    compute_stored_maps: Callable[[], MapStack]
    symmetries: Ints
    requested_fields: tuple[str, ...]
    max_length: int | None = None
    compute_paths: Callable[[str], Paths | None] = _no_known_paths
    radius_cells: float = 0.0
    has_terrain: bool = False
    sampling_seed: int = 0
    epoch: int = 0

    __repr__ = summary

    @cached_property
    def paths(self) -> Paths:
        """The paths, read or searched."""
        known_paths = self.compute_paths(self.search)
        if known_paths is not None:
            return known_paths
        solved = self._searched_maps.solve(
            self.starts,
            self.goals,
            self.movement,
            SEARCHES[self.search],
            allow_occupied_ends=True,  # where the robot does not fit; such a problem has no path
            error_prefix=self._error_prefix,
        )
        return Paths(solved.cells, solved.offsets, solved.expansions)

    @property
    def with_astar(self) -> Batch:
        """The same problems with the paths of A*, whichever search is served."""
        return self if self.search == "astar" else self._solved_by_astar

    @cached_property
    def _solved_by_astar(self) -> Batch:
        return replace(self, search="astar")

    @cached_property
    def stored_maps(self) -> MapStack:
        """The maps before symmetries and inflation."""
        return self.compute_stored_maps()

    @property
    def map_numbers(self) -> Ints:
        """(B,) int64, number of each stored map in its dataset or problem set."""
        return self.compute_map_numbers()

    @property
    def stored_grids(self) -> Bytes:
        """(B, H, W) uint8, occupancy before symmetries and inflation."""
        return self.stored_maps.grids

    @property
    def stored_terrain(self) -> Bytes | None:
        """(B, H, W) uint8, terrain before symmetries and inflation; None without terrain."""
        return self.stored_maps.terrain if self.has_terrain else None

    @cached_property
    def obstacles(self) -> Bytes:
        """(B, H, W) uint8, the maps before they were inflated by the radius of the robot."""
        return self._after_symmetries(self.stored_grids) if self.radius_cells else self.grids

    @cached_property
    def terrain(self) -> Bytes | None:
        """(B, H, W) uint8, the cost of each cell as served, after symmetries and inflation.

        It is 0 exactly on the occupied cells of ``grids``. None if the maps have no terrain.
        """
        if self.stored_terrain is None:
            return None
        terrain = self._after_symmetries(self.stored_terrain)
        return without_occupied(terrain, self.grids) if self.radius_cells else terrain

    @property
    def maps(self) -> MapStack:
        """The maps as served, after symmetries and inflation."""
        return MapStack(self.grids, self.terrain)

    @property
    def _searched_maps(self) -> MapStack:
        """The maps as the search sees them. Terrain is not read for BFS, which counts moves."""
        return MapStack(self.grids, None) if self.search == "bfs" else self.maps

    def _error_prefix(self, row: int) -> str:
        """Return how an error on map ``row`` begins. Its number is not read without an error."""
        return f"map {self.map_numbers[row]}: "

    @cached_property
    def min_cell_costs(self) -> Ints | None:
        """(B,) int64, the smallest cost of a free cell of each map; None without terrain.

        The heuristic of A* is multiplied by it. It is 256 on a map without free cells.
        """
        return self.maps.min_cell_costs

    def _after_symmetries(self, grids: Bytes) -> Bytes:
        """Return stored grids or terrain, (B, H, W), after the symmetries of this batch."""
        return transform_grids(grids, self.symmetries) if self.symmetries.any() else grids

    @cached_property
    def rooms(self) -> Rooms:
        """The rooms of the maps."""
        return self.compute_rooms()

    @cached_property
    def costs(self) -> Floats:
        """(B,) cost of the paths, -1 without a path; BFS counts moves."""
        cells, offsets, _ = self.paths
        if self.search == "bfs":
            return np.diff(offsets) - 1.0  # One cell is no move, and no cell is no path.
        return self.maps.costs_of_paths(cells, offsets, self.movement)

    def check_exact(self, row: int, high_cost: int) -> None:
        """Refuse map ``row`` if a kernel met a cost on it that is too high to be exact, or 0.

        Raises:
            ValueError: such a cost.
        """
        self.maps.check_exact(row, high_cost, self._error_prefix)

    @cached_property
    def goal_fields(self) -> GoalFields:
        """The fields that come from a search around the goal; those not requested are empty."""
        arrays = []
        for name in GoalFields._fields:
            count = len(self.grids) if name in self.requested_fields else 0
            dtype = np.uint8 if name.startswith("optimal") else np.float32
            arrays.append(np.empty((count, 1, *self.grids.shape[1:]), dtype))
        goal_fields = GoalFields(*arrays)
        rule = move_rule(self.movement)
        lattice, scratch = search_memory(self.grids.shape[1:], rule)
        if self.movement.connectivity == 8 and not self.has_terrain:
            row, high_cost = fill_goal_fields_by_jumps(
                self.grids, self.starts, self.goals, lattice, scratch, goal_fields
            )
        else:
            row, high_cost = fill_goal_fields(
                *self.maps.ground, self.starts, self.goals, lattice, scratch, goal_fields
            )
        self.check_exact(row, high_cost)
        return goal_fields


def map_(batch: Batch) -> Bytes:
    """``map``: (B, 1, H, W) uint8, occupancy, 1 occupied."""
    return batch.grids[:, None]


def free(batch: Batch) -> Bytes:
    """``free``: (B, 1, H, W) uint8, 1 free: the opposite of ``map``."""
    return batch.grids[:, None] ^ np.uint8(1)


def terrain(batch: Batch) -> Bytes:
    """``terrain``: (B, 1, H, W) uint8, cost of each cell, 1 to 255, 0 occupied.

    On maps without terrain all free cells cost 1, as on terrain of ones.
    """
    return batch.maps.cell_costs[:, None]


def start(batch: Batch) -> Ints:
    """``start``: (B, 2) int64, cell."""
    return batch.starts


def goal(batch: Batch) -> Ints:
    """``goal``: (B, 2) int64, cell."""
    return batch.goals


def path(batch: Batch) -> Ints:
    """``path``: (B, T, 2) int64, cells from start to goal, padded with -1.

    T is a multiple of 16, or ``max_length``.
    """
    cells, offsets, _ = batch.paths
    max_cells = np.diff(offsets).max(initial=0)
    rows = padded_path_length(max_cells, batch.max_length)
    padded_paths = np.empty((len(batch.grids), rows, 2), np.int64)
    pad_paths(cells, offsets, padded_paths)
    return padded_paths


def length(batch: Batch) -> Ints:
    """``length``: (B,) int64, number of cells of the path, 0 without one."""
    return np.diff(batch.paths.offsets)


def cost(batch: Batch) -> Float32s:
    """``cost``: (B,) float32, cost of the path in cells (BFS: moves), -1 without one.

    On terrain a move costs the mean of its two cells times its length.
    """
    return batch.costs.astype(np.float32)


def hardness(batch: Batch) -> Float32s:
    """``hardness``: (B,) float32, optimal cost over heuristic.

    1 when start = goal, -1 without a path. On terrain the heuristic is that of a map whose cells
    all have the smallest cost of a free cell.
    """
    optimal_costs = batch.costs
    # With diagonal moves and on terrain the number of moves, which BFS minimizes, is not the cost.
    if batch.search == "bfs" and (batch.movement.connectivity == 8 or batch.has_terrain):
        optimal_costs = batch.with_astar.costs
    ratios = hardness_of(
        optimal_costs, batch.starts, batch.goals, batch.movement, batch.min_cell_costs
    )
    return ratios.astype(np.float32)


def iterations(batch: Batch) -> Ints:
    """``iterations``: (B,) int64, cells that the search expanded."""
    return batch.paths.iterations


def path_mask(batch: Batch) -> Bytes:
    """``path_mask``: (B, 1, H, W) uint8, 1 on the cells of the path.

    Neural A*'s ``opt_trajs``, but with the goal.
    """
    cells, offsets, _ = batch.paths
    return mask_paths(cells, offsets, *batch.grids.shape[1:])[:, None]


def start_mask(batch: Batch) -> Bytes:
    """``start_mask``: (B, 1, H, W) uint8, 1 on the start."""
    return _mask_cells(batch.starts, batch.grids)


def goal_mask(batch: Batch) -> Bytes:
    """``goal_mask``: (B, 1, H, W) uint8, 1 on the goal."""
    return _mask_cells(batch.goals, batch.grids)


def optimal_mask(batch: Batch) -> Bytes:
    """``optimal_mask``: (B, 1, H, W) uint8, 1 on all cells of all shortest paths.

    0 everywhere without a path.
    """
    return batch.goal_fields.optimal_mask


def cost_to_go(batch: Batch) -> Float32s:
    """``cost_to_go``: (B, 1, H, W) float32, cost of the shortest path to the goal.

    In cells; -1 where the goal cannot be reached.
    """
    return batch.goal_fields.cost_to_go


def optimal_moves(batch: Batch) -> Bytes:
    """``optimal_moves``: (B, 1, H, W) uint8, the moves that start a shortest path.

    Bit k stands for move k, `mapdata.search.STEPS[k]`. The bit set is 0 at the goal, in walls and
    where the goal cannot be reached.
    """
    return batch.goal_fields.optimal_moves


def heuristic_ratio(batch: Batch) -> Float32s:
    """``heuristic_ratio``: (B, 1, H, W) float32, heuristic over cost to go.

    1 at the goal, 0 where the goal cannot be reached.

    TransPath's correction factor "CF" (Kirilenko et al., AAAI 2023, https://arxiv.org/abs/2212.11730).
    """
    return batch.goal_fields.heuristic_ratio


def clearance(batch: Batch) -> Float32s:
    """``clearance``: (B, 1, H, W) float32, as `mapdata.clearance`, in cells."""
    return clearances(batch.grids)[:, None]


def path_probability(batch: Batch) -> Float32s:
    """``path_probability``: (B, 1, H, W) float32, how close a cell n is to a shortest path.

    L / (d(start, n) + d(n, goal) + d(n, path)), set to 0 below 0.95. The path is that of A*, and L
    its cost, whichever ``search`` is served: the path of BFS may cost more than a shortest one.

    TransPath's path probability map "PPM" (https://arxiv.org/abs/2212.11730); 0 everywhere without
    a path.
    """
    cells, offsets, _ = batch.with_astar.paths
    rule = move_rule(batch.movement)
    lattice, scratch = search_memory(batch.grids.shape[1:], rule)
    probabilities, row, high_cost = path_probabilities(
        *batch.maps.ground, batch.starts, batch.goals, cells, offsets, lattice, scratch
    )
    batch.check_exact(row, high_cost)
    return probabilities


def connection_matrix(batch: Batch) -> Float32s:
    """``connection_matrix``: (B, R, R) float32, costs between rooms.

    -1 no connection, -2 padding.
    """
    return batch.rooms.matrix


def seed_points(batch: Batch) -> Ints:
    """``seed_points``: (B, R, 2) int64, seed cells of the rooms, padded with -1."""
    return batch.rooms.seed_points


def problem(batch: Batch) -> Ints:
    """``problem``: (B,) int64, the problem's number in its split, before filters and radius.

    Each split counts from 0; a dataset of all splits counts all of their problems. Problems are
    counted that have a path under the stored movement. All problems are counted with
    ``unsolvable=True``, and where the served movement cuts corners and the stored one does not. A
    subset of a `ProblemSet` keeps the numbers of its set.
    """
    return batch.problems


def map_index(batch: Batch) -> Ints:
    """``map_index``: (B,) int64, the number of the served map in the dataset, in all splits.

    It is the number that `mapdata.read_shard` and `mapdata.generate` give the map. The maps of
    several roots are numbered one root after another. Of a `ProblemSet` equal maps have the same
    number, and a subset keeps the numbers of its set.
    """
    return batch.compute_map_indices()


def symmetry(batch: Batch) -> Ints:
    """``symmetry``: (B,) int64, code of the symmetry that ``augment`` drew for the map, else 0.

    `mapdata.apply_symmetry` applies it to your own values of the cells of the map.
    """
    return batch.symmetries


def waypoints(batch: Batch) -> Float32s:
    """``waypoints``: (B, T, 2) float32, points (row, col) of the taut line from start to goal.

    In cells: the middle of cell (r, c) is (r + 0.5, c + 0.5). T is 32, or that of a `Waypoints`. -1
    without a path.
    """
    return Waypoints()(batch)


def image(batch: Batch) -> Bytes:
    """``image``: (B, 3, k * H, k * W) uint8, a picture of the map, red, green and blue.

    Each cell is a tile of k x k pixels, drawn by its cost. k is 8, or that of a `Tiles`. The same
    map has the same picture in every dataset. The picture is turned and reflected with the map, but
    it is not inflated by a radius.
    """
    return Tiles()(batch)


def maze_image(batch: Batch) -> Bytes:
    """``maze_image``: (B, 3, k * H, k * W) uint8, the problem as a picture, red, green and blue.

    Occupied cells are black, free cells white, the start is red and the goal green; a start that is
    the goal is red. k is 1. A `MazeImage` sets k, and draws the path in blue. The map is that of
    ``map``: turned, reflected and inflated by the radius. Costs of terrain are not drawn.
    """
    return MazeImage()(batch)


FIELD_CLASSES = (Waypoints, Tiles, MazeImage)
"""The classes of fields with options; an object of them stands among the names of fields."""

Field = Callable[[Batch], Array]

FIELDS: dict[str, Field] = {
    field.__name__.rstrip("_"): field
    for field in (
        map_,
        free,
        terrain,
        start,
        goal,
        path,
        length,
        cost,
        hardness,
        iterations,
        path_mask,
        start_mask,
        goal_mask,
        optimal_mask,
        cost_to_go,
        optimal_moves,
        heuristic_ratio,
        path_probability,
        clearance,
        connection_matrix,
        seed_points,
        problem,
        map_index,
        symmetry,
        waypoints,
        image,
        maze_image,
    )
}
"""All fields by name."""


def _mask_cells(cells: Ints, grids: Bytes) -> Bytes:
    """Return (B, 1, H, W) uint8, 1 on cell b, (row, column), of mask b."""
    mask = np.zeros((len(grids), 1, *grids.shape[1:]), np.uint8)
    rows, columns = cells.T
    mask[np.arange(len(cells)), 0, rows, columns] = 1
    return mask


def room_matrices(
    search: str, map_numbers: Ints, maps: MapStack, seed_points: Ints, movement: Movement
) -> Float32s:
    """Return connection matrices (B, R, R) float32 of maps that are solved anew.

    An entry is -1 without a connection, and -2 where a seed point is padding.

    Args:
        search: "bfs" counts moves, on terrain, too; "astar" adds their costs.
        map_numbers: (B,) numbers of the maps, for the error.
        maps: B maps.
        seed_points: (B, R, 2), padded with -1.
        movement: movement of the paths.

    Raises:
        ValueError: terrain whose costs are too high to be exact.
    """
    diagonals, diagonal_cost = move_rule(movement)
    if search == "bfs":
        maps = maps.seen_by(BFS)
        diagonal_cost = UNIT
    lattice, scratch = search_memory(maps.grids.shape[1:], (diagonals, diagonal_cost))
    matrices, row, high_cost = fill_room_matrices(*maps.ground, seed_points, lattice, scratch)
    maps.check_exact(row, high_cost, lambda k: f"map {map_numbers[k]}: ")
    return matrices
