"""The pruning of jump point search, and the costs of all cells that it gives.

Among paths of equal cost jump point search follows only those that make their diagonal moves first.
From a cell that it expands, it goes on along each move that such a path may take next, past cells
where the path can only go on, to the next jump point: the goal, or a cell where an obstacle beside
the way ends and so allows a turn. The search itself is in `mapdata.search.bit_jumps`.

Source: Harabor and Grastien, "Online graph pruning for pathfinding on grid maps", AAAI 2011, where
moves may cut corners; Harabor and Grastien, "The JPS pathfinding system", SoCS 2012, where they may
not.

Where a diagonal move costs 1 or sqrt(2), no path of least cost is lost, whichever of several jumps
of equal cost to a cell is kept. For take any cell and the last move of a path of least cost to it:

- A straight last move is never pruned. The rules prune it only where the last two moves can be
  replaced by a single move or by two cheaper ones, and then the path would not be of least cost.
- A diagonal last move is pruned only where the last two moves can be replaced by cheaper ones, or
  by moves of equal cost of which the last is straight.

So every cell is reached at its least cost, or would be if the search did not end at the goal.

For the same reason `jump_costs` finds the costs of all cells, although it follows the same few
moves.
"""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Bytes, Flags
from mapdata.jit import Int, kernel
from mapdata.search.ground import EXACT, TOO_LONG
from mapdata.search.kernels import LOWEST_MOVE, Scratch
from mapdata.search.lattice import (
    CORNER_CUTTING,
    INFINITY,
    MAX_PATH_COST,
    NO_CORNER_CUTTING,
    UNIT,
    UNIT_BITS,
    Lattice,
)

NO_MOVE = 8
"""Stands for the move that led to the cell where a search begins."""

_SETTLED = np.uint64(9)
"""Stands for the move that led to a cell that `jump_costs` has expanded."""

_ONE = np.uint64(1)
_EIGHT = np.uint64(8)
_BYTE = np.uint8(1)


def _kept_moves(diagonals: int) -> Bytes:
    """Return which moves follow a move, in paths that make their diagonal moves first.

    Args:
        diagonals: which diagonal moves are legal, as in `Lattice`.

    Returns:
        (9 * 256,) sets of moves, of which bit k is move k: for each last move, or `NO_MOVE`, and
        each set of free neighbours of the cell to which it led.
    """
    neighbours = np.arange(256)

    def is_free(move: int) -> Flags:
        flags: Flags = (neighbours >> move) % 2 == 1
        return flags

    legal = neighbours.copy()
    if diagonals == NO_CORNER_CUTTING:
        for part in range(4):
            has_corner = ~(is_free(part) & is_free((part + 1) % 4))
            legal[has_corner] &= ~(1 << (4 + part))
    kept = np.zeros((9, 256), np.int64)
    kept[NO_MOVE] = 255
    for move in range(4):
        right = (move + 1) % 4
        left = (move + 3) % 4
        behind = (move + 2) % 4
        # Diagonal move 4 + k lies between the straight moves k and k + 1.
        kept[move] = 1 << move
        for side, ahead, back in ((right, 4 + move, 4 + right), (left, 4 + left, 4 + behind)):
            # Turns that are forced where an obstacle ends: beside its last cell if corners may be
            # cut, otherwise one cell later.
            if diagonals == CORNER_CUTTING:
                kept[move][~is_free(side)] |= 1 << ahead
            else:
                kept[move][~is_free(back)] |= (1 << side) | (1 << ahead)
        diagonal = 4 + move
        kept[diagonal] = (1 << diagonal) | (1 << move) | (1 << right)
        if diagonals == CORNER_CUTTING:
            kept[diagonal][~is_free(left)] |= 1 << (4 + left)
            kept[diagonal][~is_free(behind)] |= 1 << (4 + right)
    return (kept & legal).astype(np.uint8).reshape(-1)


KEPT_MOVES = _kept_moves(NO_CORNER_CUTTING)
"""The sets of `_kept_moves` where corners are not cut."""

KEPT_MOVES_CUTTING_CORNERS = _kept_moves(CORNER_CUTTING)
"""The sets of `_kept_moves` where corners may be cut."""


@kernel
def find_free_neighbours(states: Bytes, lattice: Lattice, neighbours: Bytes) -> None:
    """Write which neighbours of each padded cell are free, as sets of moves.

    Args:
        states: (cells,) WALL and UNSEEN, from `load`.
        lattice: of the map.
        neighbours: (cells,) to be filled, but for the wall around the map.
    """
    # The lowest bit of WALL is 1, that of UNSEEN is 0. With bytes, which numba would widen, the
    # compiler handles many cells at once.
    stride = np.uint64(lattice.stride)
    for k in range(lattice.stride + 1, lattice.cells - lattice.stride - 1):
        cell = np.uint64(k)
        north = cell - stride
        south = cell + stride
        occupied = np.uint8(states[north] & _BYTE)
        occupied = np.uint8(occupied | np.uint8((states[cell + _ONE] & _BYTE) << np.uint8(1)))
        occupied = np.uint8(occupied | np.uint8((states[south] & _BYTE) << np.uint8(2)))
        occupied = np.uint8(occupied | np.uint8((states[cell - _ONE] & _BYTE) << np.uint8(3)))
        occupied = np.uint8(occupied | np.uint8((states[north + _ONE] & _BYTE) << np.uint8(4)))
        occupied = np.uint8(occupied | np.uint8((states[south + _ONE] & _BYTE) << np.uint8(5)))
        occupied = np.uint8(occupied | np.uint8((states[south - _ONE] & _BYTE) << np.uint8(6)))
        occupied = np.uint8(occupied | np.uint8((states[north - _ONE] & _BYTE) << np.uint8(7)))
        neighbours[cell] = np.uint8(~occupied)


@kernel
def jump_costs(
    goal: Int, max_cost: Int, neighbours: Bytes, lattice: Lattice, scratch: Scratch
) -> Int:
    """Write the cost of a shortest path from every cell to ``goal``, under 8-connectivity.

    A walk from an expanded cell along a move lowers the costs of the cells on its way. It ends
    before a cell whose cost it does not lower, or at one where a path may take another move. Only
    these last cells are pushed, to be expanded in their turn. On open maps they are few.

    As in `shortest_costs`, buckets one UNIT wide take the place of a heap. A bucket is a stack
    through the log, as in `best_first_buckets`. A walk may lower costs along an earlier one. But
    when a bucket is expanded, the costs in it are final, since a move costs at least UNIT.

    Unlike `shortest_costs`, it does not find the optimal moves.

    Args:
        goal: padded cell, free.
        max_cost: the cost, in cells, at which the search stops, or INFINITY. The costs of cells
            from this cost on are undefined, but not below it.
        neighbours: (cells,) from `find_free_neighbours`.
        lattice: of the map, with diagonals.
        scratch: whose ``g`` (cells,) becomes the costs in 1 / UNIT, INFINITY without a path and on
            occupied cells. There is room for all pushes: an expansion makes at most one for each of
            its moves.

    Returns:
        EXACT, or TOO_LONG, as `shortest_costs`.
    """
    moves = scratch.came_from  # the move that led to a pushed cell
    costs = scratch.g
    pushed = scratch.pushed
    links = scratch.links
    kept_moves = KEPT_MOVES
    if lattice.diagonals == CORNER_CUTTING:
        kept_moves = KEPT_MOVES_CUTTING_CORNERS
    for k in range(lattice.cells):
        costs[np.uint64(k)] = INFINITY
    # The buckets form a ring. A walk of as many moves as the longer side of the map has cells,
    # each of less than 2 UNIT, does not go around it.
    longer_side = max(lattice.stride, lattice.cells // lattice.stride)
    ring_size = 4
    while ring_size < 2 * longer_side:
        ring_size *= 2
    bucket_tops = np.zeros(ring_size, np.uint32)
    last_slot = np.int64(ring_size - 1)
    costs[goal] = 0
    moves[goal] = NO_MOVE
    # Push 0 does not exist, so a link of 0 ends a list.
    pushed[1] = goal
    links[1] = 0
    bucket_tops[0] = 1
    next_push = np.uint64(2)
    waiting = np.uint64(1)
    bucket = np.int64(0)
    goes_far = False
    while waiting and bucket < max_cost:
        if bucket >= MAX_PATH_COST:
            return TOO_LONG
        slot = np.uint64(bucket & last_slot)
        top = np.uint64(bucket_tops[slot])
        bucket_tops[slot] = 0
        while top:
            cell = np.uint64(pushed[top])
            top = np.uint64(links[top])
            waiting -= _ONE
            cost = costs[cell]
            last_move = np.uint64(moves[cell])
            # A cell whose cost became smaller was pushed again, or a walk went on through it.
            if last_move == _SETTLED or cost >> UNIT_BITS != bucket:
                continue
            moves[cell] = _SETTLED
            kept = np.uint64(kept_moves[(last_move << _EIGHT) | np.uint64(neighbours[cell])])
            while kept:
                move = np.uint64(LOWEST_MOVE[kept])
                kept &= kept - _ONE
                only_move = _ONE << move
                step = np.uint64(lattice.offsets[move])
                move_cost = UNIT if move < np.uint64(4) else lattice.diagonal_cost
                target = cell + step
                new_cost = cost + move_cost
                next_moves = only_move
                while new_cost < costs[target]:
                    costs[target] = new_cost
                    around = np.uint64(neighbours[target])
                    next_moves = np.uint64(kept_moves[(move << _EIGHT) | around])
                    if next_moves != only_move:
                        break
                    target += step
                    new_cost += move_cost
                goes_far |= new_cost >= MAX_PATH_COST * UNIT
                if next_moves != only_move and next_moves:
                    moves[target] = move
                    pushed[next_push] = target
                    slot = np.uint64((new_cost >> UNIT_BITS) & last_slot)
                    links[next_push] = bucket_tops[slot]
                    bucket_tops[slot] = next_push
                    next_push += _ONE
                    waiting += _ONE
        bucket += 1
    if goes_far and max_cost > MAX_PATH_COST:
        # A walk that is long enough reaches INFINITY, and ends there without a push.
        for k in range(lattice.cells):
            if MAX_PATH_COST * UNIT <= costs[np.uint64(k)] < INFINITY:
                return TOO_LONG
    return EXACT
