"""The kernels of `mapdata.datasets.fields`: each fills one or more fields for a whole batch."""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Bytes, Float32s, Ints
from mapdata.jit import Int, kernel
from mapdata.search.kernels import Scratch, bucket_search, scratch, shortest_costs
from mapdata.search.lattice import (
    COSTS,
    FAR,
    Rule,
    cell_at,
    in_cells,
    lattice_of,
    load,
)

PADDING = -1
"""What fills the rows of ``path`` beyond a path's own cells."""

PROBABLE = 0.95
"""TransPath's threshold of the path probability."""


@kernel
def pad_paths(cells: Ints, offsets: Ints, capacity: Int) -> Ints:
    """Return paths as (B, capacity, 2), padded with -1."""
    out = np.empty((len(offsets) - 1, capacity, 2), np.int64)
    for b in range(len(out)):
        first = offsets[b]
        count = offsets[b + 1] - first
        for k in range(count):
            out[b, k, 0] = cells[first + k, 0]
            out[b, k, 1] = cells[first + k, 1]
        for k in range(count, capacity):
            out[b, k, 0] = out[b, k, 1] = PADDING
    return out


@kernel
def mask_paths(cells: Ints, offsets: Ints, rows: Int, columns: Int) -> Bytes:
    """Return (B, H, W) uint8, 1 on the cells of each path."""
    mask = np.zeros((len(offsets) - 1, rows, columns), np.uint8)
    for b in range(len(mask)):
        for k in range(offsets[b], offsets[b + 1]):
            mask[b, cells[k, 0], cells[k, 1]] = 1
    return mask


@kernel
def count_steps(cells: Ints, offsets: Ints) -> tuple[Ints, Ints]:
    """Return straight and diagonal steps of each path, (-1, 0) for an empty one."""
    straight = np.full(len(offsets) - 1, -1)
    diagonal = np.zeros(len(offsets) - 1, np.int64)
    for b in range(len(straight)):
        if offsets[b + 1] > offsets[b]:
            straight[b] = 0
        for k in range(offsets[b] + 1, offsets[b + 1]):
            if cells[k, 0] != cells[k - 1, 0] and cells[k, 1] != cells[k - 1, 1]:
                diagonal[b] += 1
            else:
                straight[b] += 1
    return straight, diagonal


@kernel
def path_probabilities(
    grids: Bytes, starts: Ints, goals: Ints, cells: Ints, ends: Ints, rule: Rule
) -> Float32s:
    """Return TransPath's path probability maps, (B, 1, H, W).

    L / (d(start, n) + d(n, goal) + d(n, path)) where it is at least 0.95, else 0.
    """
    count, rows, columns = grids.shape
    lattice = lattice_of((rows, columns), rule)
    buffers = scratch(COSTS, lattice)
    around_start = np.empty(lattice.cells, np.int64)
    around_goal = np.empty(lattice.cells, np.int64)
    around_path = buffers.g
    came = buffers.came
    pushed = buffers.pushed
    links = buffers.links
    out = np.zeros((count, 1, rows, columns), np.float32)
    for b in range(count):
        length = ends[b + 1] - ends[b]
        if length == 0:
            continue
        start = cell_at(starts[b, 0], starts[b, 1], lattice)
        goal = cell_at(goals[b, 0], goals[b, 1], lattice)
        for source, costs in ((start, around_start), (goal, around_goal)):
            load(grids[b], came)
            shortest_costs(source, lattice, Scratch(came, costs, pushed, links, buffers.f))
        around_path[:] = FAR
        for k in range(length):
            cell = cell_at(cells[ends[b] + k, 0], cells[ends[b] + k, 1], lattice)
            pushed[1 + k] = cell
            around_path[cell] = 0
        bucket_search(length, lattice, buffers)
        best = in_cells(around_goal[start])
        for row in range(rows):
            for column in range(columns):
                cell = cell_at(row, column, lattice)
                if around_start[cell] != FAR:
                    through = in_cells(around_start[cell]) + in_cells(around_goal[cell])
                    through += in_cells(around_path[cell])
                    ratio = best / through if through > 0 else 1.0
                    if ratio >= PROBABLE:
                        out[b, 0, row, column] = ratio
    return out


@kernel
def fill_room_matrices(grids: Bytes, seed_points: Ints, rule: Rule) -> Float32s:
    """Return (B, R, R) float32 of costs between seed points, -1 no connection, -2 padding."""
    lattice = lattice_of(grids.shape[1:], rule)
    buffers = scratch(COSTS, lattice)
    most = seed_points.shape[1]
    out = np.full((len(grids), most, most), -2, np.float32)
    for b in range(len(grids)):
        for i in range(most):
            if seed_points[b, i, 0] < 0:
                break
            load(grids[b], buffers.came)
            source = cell_at(seed_points[b, i, 0], seed_points[b, i, 1], lattice)
            shortest_costs(source, lattice, buffers)
            for j in range(most):
                if seed_points[b, j, 0] < 0:
                    break
                cost = buffers.g[cell_at(seed_points[b, j, 0], seed_points[b, j, 1], lattice)]
                out[b, i, j] = -1 if cost == FAR else in_cells(cost)
    return out
