"""Searches around a goal: what all cells cost, and which of their moves are optimal."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Float32s, Floats, Ints, UInt32s
from mapdata.jit import Int, kernel
from mapdata.search.bitboard import Board, board_of, search_board
from mapdata.search.lattice import (
    FAR,
    UNIT,
    UNIT_BITS,
    Lattice,
    Rule,
    cell_at,
    heuristic,
    in_cells,
    lattice_of,
    position,
)

_ZERO = np.uint64(0)
_ONE = np.uint64(1)


class GoalFields(NamedTuple):
    """The fields that one search around the goal gives, (B, 1, H, W) each, or empty."""

    cost_to_go: Float32s
    optimal_moves: Bytes
    heuristic_ratio: Float32s
    optimal_mask: Bytes


def goal_fields(shape: tuple[int, ...], wanted: Collection[str]) -> GoalFields:
    """Return fields to be filled for grids of ``shape`` (B, H, W); those not wanted are empty."""
    full = (shape[0], 1, *shape[1:])
    fields = (
        np.empty(
            full if name in wanted else (0, 1, 1, 1),
            np.uint8 if name.startswith("optimal") else np.float32,
        )
        for name in GoalFields._fields
    )
    return GoalFields(*fields)


class Around(NamedTuple):
    """What a search around a goal finds, and where it works, for maps of one size.

    Attributes:
        lattice: tells where the cells stand in ``costs`` and ``moves``.
        least: (H, 2 W) heuristic of a cell so many rows and (less W) columns away, in cells.
        costs: (cells,) exact costs of the shortest paths; without one FAR, and -1 in walls.
        moves: (cells + 8,) bit sets of the moves that start a shortest path to the goal.
        stacks: (2, pushes) the cells of a bucket, and those pushed meanwhile.
        board: of the search by bits.
    """

    lattice: Lattice
    least: Floats
    costs: Ints
    moves: Bytes
    stacks: UInt32s
    board: Board


@kernel
def around(shape: tuple[Int, Int], rule: Rule) -> Around:
    """Return where searches around goals work, on maps of ``shape`` (rows, columns)."""
    lattice = lattice_of(shape, rule)
    rows, columns = shape
    least = np.empty((rows, 2 * columns))
    for row in range(rows):
        for column in range(2 * columns):
            least[row, column] = in_cells(heuristic(row, column - columns, lattice))
    # Each neighbour pushes a cell at most once, and it may be pushed on once more.
    pushes = 2 * len(lattice.offsets) * lattice.cells
    return Around(
        lattice,
        least,
        np.full(lattice.cells, -1),
        np.empty(lattice.cells + 8, np.uint8),
        np.empty((2, pushes), np.uint32),
        board_of(shape),
    )


@kernel
def search_around(grid: Bytes, row: Int, column: Int, weighed: bool, found: Around) -> None:
    """Find the ``moves`` to (row, column) and, where they are to be ``weighed``, the ``costs``.

    Moves alone, on 4-connected maps, are found by bits.
    """
    lattice = found.lattice
    by_bits = lattice.diagonals == 0 and not weighed
    if by_bits and search_board(grid, row, column, found.board, lattice, found.moves):
        return
    _search_buckets(grid, row, column, found)


@kernel
def _search_buckets(grid: Bytes, row: Int, column: Int, found: Around) -> None:
    """Write ``costs`` and ``moves`` around (row, column), by any rule.

    Dijkstra's search with buckets one UNIT wide instead of a heap (Dinitz 1978). A step costs at
    least UNIT, so it leads out of its bucket, and what lies in the nearest bucket cannot become
    cheaper, whatever the order within. So once a cell of it is expanded, all nearer cells have
    their costs, and the moves that lead to them tell which are optimal.

    Its steps go without branches, which the processor would often guess wrong: a neighbour's cost
    is always stored and the neighbour always pushed, and the next push overwrites it unless it was
    cheaper this way. A wall costs -1, so that nothing is.
    """
    costs = found.costs
    optimal = found.moves
    lattice = found.lattice
    flat = grid.reshape(-1)
    rows, columns = grid.shape
    for r in range(rows):
        cell = np.uint64(cell_at(r, 0, lattice))
        first = np.uint64(r * columns)
        for c in range(columns):
            costs[cell + np.uint64(c)] = -1 if flat[first + np.uint64(c)] else FAR
            optimal[cell + np.uint64(c)] = 0
    stride = np.uint64(lattice.stride)
    cut = lattice.diagonals == 2
    here = found.stacks[0]
    ahead = found.stacks[1]
    here[0] = cell_at(row, column, lattice)
    costs[here[0]] = 0
    waiting: Int = _ONE
    bucket = 0
    while waiting:
        pushed = _ZERO
        while waiting:
            waiting -= _ONE
            cell = np.uint64(here[waiting])
            cost = costs[cell]
            distance = (cost >> UNIT_BITS) - bucket
            if distance:
                # A step of sqrt(2) may end two buckets ahead; or the cell was pushed again with a
                # smaller cost, and has been expanded.
                ahead[pushed] = cell
                pushed += _ONE if distance > 0 else _ZERO
                continue
            moves: Int = 0
            there = cost + UNIT
            for move, to in enumerate((cell - stride, cell + _ONE, cell + stride, cell - _ONE)):
                before = costs[to]
                moves |= np.int64(before + UNIT == cost) << move
                costs[to] = min(there, before)
                ahead[pushed] = to
                pushed += _ONE if there < before else _ZERO
            if lattice.diagonals:
                # The corner rule of `is_legal`, without its branches.
                north = cut | (costs[cell - stride] >= 0)
                east = cut | (costs[cell + _ONE] >= 0)
                south = cut | (costs[cell + stride] >= 0)
                west = cut | (costs[cell - _ONE] >= 0)
                there = cost + lattice.step
                for move, to, legal in (
                    (4, cell - stride + _ONE, north & east),
                    (5, cell + stride + _ONE, south & east),
                    (6, cell + stride - _ONE, south & west),
                    (7, cell - stride - _ONE, north & west),
                ):
                    before = costs[to]
                    moves |= np.int64(legal & (before + lattice.step == cost)) << move
                    cheaper = legal & (there < before)
                    costs[to] = there if cheaper else before
                    ahead[pushed] = to
                    pushed += _ONE if cheaper else _ZERO
            optimal[cell] = moves
        here, ahead = ahead, here
        waiting = pushed
        bucket += 1


@kernel
def write_fields(b: Int, start: Ints, goal: Ints, found: Around, fields: GoalFields) -> None:
    """Fill fields of problem ``b`` from the search around its goal, those that are not empty."""
    cost_to_go, optimal_moves, heuristic_ratio, optimal_mask = fields
    lattice = found.lattice
    costs = found.costs
    moves = found.moves
    goal_row = goal[0]
    goal_column = goal[1]
    columns = lattice.stride - 2
    for row in range(len(found.least)):
        first = np.uint64(cell_at(row, 0, lattice))
        least = found.least[abs(row - goal_row)]
        for column in range(columns):
            cell = first + np.uint64(column)
            if len(optimal_moves):
                optimal_moves[b, 0, row, column] = moves[cell]
            if len(cost_to_go) or len(heuristic_ratio):
                cost = costs[cell]
                value = in_cells(cost) if 0 <= cost < FAR else -1.0
                if len(cost_to_go):
                    cost_to_go[b, 0, row, column] = value
                if len(heuristic_ratio):
                    best = least[columns + column - goal_column]
                    ratio = best / value if value > 0 else 1.0 + value
                    heuristic_ratio[b, 0, row, column] = ratio
    if len(optimal_mask):
        mask = optimal_mask[b, 0]
        mask.fill(0)
        goal_cell = cell_at(goal_row, goal_column, lattice)
        start_cell = cell_at(start[0], start[1], lattice)
        if moves[start_cell] or start_cell == goal_cell:
            _follow(start_cell, found, mask)


@kernel
def _follow(start: Int, found: Around, mask: Bytes) -> None:
    """Mark all cells that optimal moves lead to from ``start``."""
    lattice = found.lattice
    stack = found.stacks[0]
    stack[0] = start
    mask[position(start, lattice)] = 1
    size = 1
    while size:
        size -= 1
        cell = np.int64(stack[size])
        for move in range(len(lattice.offsets)):
            if found.moves[cell] >> move & 1:
                to = cell + lattice.offsets[move]
                if mask[position(to, lattice)] == 0:
                    mask[position(to, lattice)] = 1
                    stack[size] = to
                    size += 1


@kernel
def count_to_goal(start: Int, found: Around) -> tuple[Int, Int]:
    """Return the straight and diagonal moves to the goal; all count as straight if they cost 1."""
    straight: Int = 0
    diagonal: Int = 0
    cell = start
    while found.moves[cell]:
        move = 0
        while not found.moves[cell] >> move & 1:
            move += 1
        if move < 4 or found.lattice.step == UNIT:
            straight += 1
        else:
            diagonal += 1
        cell += found.lattice.offsets[move]
    return straight, diagonal


@kernel
def fill_goal_fields(
    grids: Bytes, starts: Ints, goals: Ints, rule: Rule, fields: GoalFields
) -> None:
    """Fill those of the fields that are not empty, from one search a problem."""
    found = around(grids.shape[1:], rule)
    weighed = len(fields.cost_to_go) + len(fields.heuristic_ratio) > 0
    for b in range(len(grids)):
        search_around(grids[b], goals[b, 0], goals[b, 1], weighed, found)
        write_fields(b, starts[b], goals[b], found, fields)
