"""Jump point search: A* under 8-connectivity that expands only the cells where paths must turn.

Among paths of equal cost it follows only those that make their diagonal moves first. From a cell
that it expands, it scans along each move that such a path may take next, past cells where the path
can only go on, to the next jump point: the goal, or a cell where an obstacle beside the scan ends
and so allows a turn. Only jump points enter the open list.

Source: Harabor and Grastien, "Online graph pruning for pathfinding on grid maps", AAAI 2011, where
moves may cut corners; Harabor and Grastien, "The JPS pathfinding system", SoCS 2012, where they may
not.

Where a diagonal move costs 1 or sqrt(2), no path of least cost is lost, whichever of several jumps
of equal cost to a cell is kept. For take any cell and the last move of a path of least cost to it:

- A straight last move is never pruned. The rules prune it only where the last two moves can be
  replaced by a single move or by two cheaper ones, and then the path would not be of least cost.
- A diagonal last move is pruned only where the last two moves can be replaced by cheaper ones, or
  by moves of equal cost of which the last is straight.

So a scan reaches every cell at its least cost, or would if the search did not end at the goal.

For the same reason `jump_costs` finds the costs of all cells, although it follows the same few
moves.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Flags, Ints, UInt32s
from mapdata.jit import Int, inlined, kernel
from mapdata.search.ground import EXACT, TOO_LONG, is_usable_end
from mapdata.search.kernels import (
    LOWEST_MOVE,
    Scratch,
    insert_in_heap,
    remove_heap_top,
    with_capacity,
)
from mapdata.search.lattice import (
    CORNER_CUTTING,
    INFINITY,
    MAX_PATH_COST,
    NO_CORNER_CUTTING,
    UNIT,
    UNIT_BITS,
    UNSEEN,
    WALL,
    Lattice,
    cell_at,
    count_path_cells,
    heuristic,
    load,
    position,
    split_cost,
)
from mapdata.search.solving import Solved

_PASSED = np.uint8(252)
"""State of a free cell that a scan has passed, and that is not known to be a jump point."""

_OPEN = np.uint8(250)
"""State of the start or a jump point in the open list."""

_EXPANDED = np.uint8(248)
"""State of the start or a jump point that has been expanded."""

_ALL_MOVES = 255
"""The set of all eight moves; bit k stands for move k."""


class Jumps(NamedTuple):
    """The jump that led to each jump point, along the cheapest path so far.

    Attributes:
        moves: (cells,) its move, from 0 to 7.
        lengths: (cells,) how many such moves it is made of.
    """

    moves: Bytes
    lengths: UInt32s


@inlined
def _obstacle_ends(states: Bytes, cell: Int, step: Int) -> Int:
    """Return whether ``cell`` is free and the cell before it, one ``step`` back, is occupied."""
    return states[np.uint64(cell - step)] == WALL and states[np.uint64(cell)] != WALL


@kernel
def _scan_straight(states: Bytes, cell: Int, move: Int, goal: Int, lattice: Lattice) -> Int:
    """Return the number of moves from ``cell`` by a straight ``move`` to the next jump point.

    It is 0 if the scan meets an obstacle first. The cells that it passes are marked.

    A turn is forced where an obstacle beside the scan ends. If corners may be cut, the turn is a
    diagonal move past the end of the obstacle, which begins beside its last cell. Otherwise it
    begins one cell later.
    """
    step = lattice.offsets[move]
    right = lattice.offsets[(move + 1) & 3]
    lead = step if lattice.diagonals == CORNER_CUTTING else 0
    length = 0
    while True:
        cell += step
        if states[np.uint64(cell)] == WALL:
            return 0
        length += 1
        if states[np.uint64(cell)] == UNSEEN:
            states[np.uint64(cell)] = _PASSED
        if cell == goal:
            return length
        ahead = cell + lead
        if _obstacle_ends(states, ahead + right, step):
            return length
        if _obstacle_ends(states, ahead - right, step):
            return length


@kernel
def _scan_diagonal(states: Bytes, cell: Int, move: Int, goal: Int, lattice: Lattice) -> Int:
    """Return the number of moves from ``cell`` by a diagonal ``move`` to the next jump point.

    It is 0 if the scan meets an obstacle or a forbidden corner first. From every cell that it
    passes, it scans along both straight parts of the move. A cell from which such a scan succeeds
    is a jump point, too.
    """
    step = lattice.offsets[move]
    # Diagonal move 4 + k lies between the straight moves k and k + 1.
    first_part = move & 3
    second_part = (move + 1) & 3
    first_step = lattice.offsets[first_part]
    second_step = lattice.offsets[second_part]
    may_cut = lattice.diagonals == CORNER_CUTTING
    length = 0
    while True:
        if not may_cut:
            # This copy of the corner rule of `is_legal` uses that the steps to both neighbours are
            # the same along the whole scan.
            if states[np.uint64(cell + first_step)] == WALL:
                return 0
            if states[np.uint64(cell + second_step)] == WALL:
                return 0
        cell += step
        if states[np.uint64(cell)] == WALL:
            return 0
        length += 1
        if states[np.uint64(cell)] == UNSEEN:
            states[np.uint64(cell)] = _PASSED
        if cell == goal:
            return length
        # A cut corner behind the cell forces a turn around it.
        if may_cut and _obstacle_ends(states, cell - first_step + second_step, second_step):
            return length
        if may_cut and _obstacle_ends(states, cell - second_step + first_step, first_step):
            return length
        if _scan_straight(states, cell, first_part, goal, lattice):
            return length
        if _scan_straight(states, cell, second_part, goal, lattice):
            return length


@inlined
def _unpruned_moves(states: Bytes, cell: Int, move: Int, lattice: Lattice) -> Int:
    """Return the set of moves that a path may take from ``cell`` when it came by ``move``.

    They are the natural ones, along ``move`` and its straight parts, and those that an obstacle
    beside the cell forces. Some may be illegal, which their scan finds out.
    """
    moves: Int = 1 << move
    right = (move + 1) & 3
    left = (move + 3) & 3
    may_cut = lattice.diagonals == CORNER_CUTTING
    if move >= 4:
        # Diagonal move 4 + k lies between the straight moves k and k + 1. Behind it, on its left,
        # is the cell that the reverse of k + 1 leads to, and on its right the reverse of k.
        first_part = move & 3
        moves |= (1 << first_part) | (1 << right)
        if may_cut and states[np.uint64(cell - lattice.offsets[right])] == WALL:
            moves |= 1 << (4 + left)
        if may_cut and states[np.uint64(cell - lattice.offsets[first_part])] == WALL:
            moves |= 1 << (4 + right)
    elif may_cut:
        if states[np.uint64(cell + lattice.offsets[right])] == WALL:
            moves |= 1 << (4 + move)
        if states[np.uint64(cell + lattice.offsets[left])] == WALL:
            moves |= 1 << (4 + left)
    else:
        behind = cell - lattice.offsets[move]
        if states[np.uint64(behind + lattice.offsets[right])] == WALL:
            moves |= (1 << right) | (1 << (4 + move))
        if states[np.uint64(behind + lattice.offsets[left])] == WALL:
            moves |= (1 << left) | (1 << (4 + left))
    return moves


@kernel
def _search(
    start: Int,
    goal: Int,
    lattice: Lattice,
    states: Bytes,
    g: Ints,
    pushed: UInt32s,
    heap: UInt32s,
    f: Ints,
    jumps: Jumps,
) -> tuple[Int, Int]:
    """Run jump point search from ``start`` to ``goal``.

    Args:
        start: padded cell, free.
        goal: padded cell, free.
        lattice: of the map, with diagonal moves.
        states: (cells,) with the map loaded. Afterwards the goal is `_EXPANDED` if it has a path,
            and the free cells that no scan passed are still UNSEEN.
        g: (cells,) for the costs of the start and of jump points.
        pushed: log of the cells that were pushed, as in `mapdata.search.kernels`.
        heap: for the open list, as `insert_in_heap` takes it.
        f: the priorities of its entries.
        jumps: memory for the jumps, from which the path can be read back.

    Returns:
        The number of expansions; and EXACT, or TOO_LONG where the search stopped at a path that is
        too long for exact costs.
    """
    goal_row, goal_column = position(goal, lattice)
    states[start] = _OPEN
    g[start] = 0
    pushed[0] = start
    heap[0] = 0
    f[0] = 0  # The start is alone in the heap, so its priority does not matter.
    heap_size = 1
    pushes = np.uint32(1)
    expansions = 0
    while heap_size:
        cell = np.int64(pushed[np.uint64(heap[0])])
        heap_size -= 1
        remove_heap_top(heap, f, heap_size)
        # The cell was pushed again with a smaller f and expanded then.
        if states[np.uint64(cell)] == _EXPANDED:
            continue
        states[np.uint64(cell)] = _EXPANDED
        expansions += 1
        if cell == goal:
            break
        cost = g[np.uint64(cell)]
        if cost >= MAX_PATH_COST * UNIT:
            return expansions, TOO_LONG
        moves = _ALL_MOVES
        if cell != start:
            moves = _unpruned_moves(states, cell, np.int64(jumps.moves[np.uint64(cell)]), lattice)
        for move in range(8):
            if (moves >> move) & 1 == 0:
                continue
            if move < 4:
                length = _scan_straight(states, cell, move, goal, lattice)
                new_cost = cost + length * UNIT
            else:
                length = _scan_diagonal(states, cell, move, goal, lattice)
                new_cost = cost + length * lattice.diagonal_cost
            if length == 0:
                continue
            target = cell + length * lattice.offsets[move]
            index = np.uint64(target)
            # The heuristic is consistent, so that no cheaper path to an expanded cell is met.
            if states[index] != _PASSED and g[index] <= new_cost:
                continue
            states[index] = _OPEN
            g[index] = new_cost
            jumps.moves[index] = move
            jumps.lengths[index] = length
            row, column = position(target, lattice)
            h = heuristic(row - goal_row, column - goal_column, lattice)
            pushed[pushes] = target
            insert_in_heap(heap, f, heap_size, pushes, new_cost + h)
            heap_size += 1
            pushes += np.uint32(1)
    return expansions, EXACT


@kernel
def _write_path(goal: Int, lattice: Lattice, jumps: Jumps, path: Ints) -> None:
    """Write all cells of the path that ends at ``goal`` to ``path`` (k, 2), k of them."""
    cell = goal
    k = len(path) - 1
    path[k, 0], path[k, 1] = position(cell, lattice)
    while k > 0:
        step = lattice.offsets[np.uint64(jumps.moves[np.uint64(cell)])]
        for _ in range(jumps.lengths[np.uint64(cell)]):
            cell -= step
            k -= 1
            path[k, 0], path[k, 1] = position(cell, lattice)


@kernel
def _count_passed(states: Bytes) -> Int:
    """Return how many free cells are no longer UNSEEN: those that scans passed, and the start."""
    count = 0
    for state in states:
        count += (state != UNSEEN) & (state != WALL)
    return count


@kernel
def jump_to_goals(
    grids: Bytes, starts: Ints, goals: Ints, lattice: Lattice, scratch: Scratch
) -> tuple[Solved, Ints]:
    """Run jump point search from ``starts[b]`` to ``goals[b]`` on ``grids[b]``, for B problems.

    Args:
        grids: (B, H, W), or (1, H, W) for a grid that all problems share.
        starts: (B, 2) cells.
        goals: (B, 2) cells.
        lattice: of the maps, with diagonals.
        scratch: memory with room for eight pushes a cell. A scan pushes at most one cell,
            and each of the eight moves of a cell is scanned at most once.

    Returns:
        The paths; and the numbers of free cells, (B,), that scans passed, the start included.
    """
    count = len(starts)
    jumps = Jumps(
        np.empty(lattice.cells, np.uint8),
        np.empty(lattice.cells, np.uint32),
    )
    moves = np.empty((count, 2), np.int64)
    expansions = np.empty(count, np.int64)
    looks = np.empty(count, np.int64)
    offsets = np.zeros(count + 1, np.int64)
    cells = np.empty((64 * count + 64, 2), np.int64)
    used = 0
    for b in range(count):
        grid = grids[b if len(grids) > 1 else 0]
        if (
            not load(grid, scratch.came_from)
            or not is_usable_end(starts[b], grid.shape, 0, lattice, scratch.came_from)
            or not is_usable_end(goals[b], grid.shape, 0, lattice, scratch.came_from)
        ):
            return Solved(cells, moves, expansions, offsets, b, EXACT), looks
        start = cell_at(starts[b, 0], starts[b, 1], lattice)
        goal = cell_at(goals[b, 0], goals[b, 1], lattice)
        expansions[b], high_cost = _search(
            start,
            goal,
            lattice,
            scratch.came_from,
            scratch.g,
            scratch.pushed,
            scratch.links,
            scratch.f,
            jumps,
        )
        if high_cost:
            return Solved(cells, moves, expansions, offsets, b, high_cost), looks
        looks[b] = _count_passed(scratch.came_from)
        straight: Int = -1
        diagonal: Int = 0
        if scratch.came_from[goal] == _EXPANDED:
            straight, diagonal = split_cost(scratch.g[goal])
        moves[b, 0] = straight
        moves[b, 1] = diagonal
        length = count_path_cells(straight, diagonal)
        cells = with_capacity(cells, used, length)
        if length:
            _write_path(goal, lattice, jumps, cells[used : used + length])
        used += length
        offsets[b + 1] = used
    return Solved(cells[:used], moves, expansions, offsets, count, EXACT), looks


_NO_MOVE = 8
"""Stands for the move that led to the cell where `jump_costs` begins."""

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
        (9 * 256,) sets of moves, of which bit k is move k: for each last move, or `_NO_MOVE`, and
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
    kept[_NO_MOVE] = 255
    for move in range(4):
        right = (move + 1) % 4
        left = (move + 3) % 4
        behind = (move + 2) % 4
        # Diagonal move 4 + k lies between the straight moves k and k + 1.
        kept[move] = 1 << move
        for side, ahead, back in ((right, 4 + move, 4 + right), (left, 4 + left, 4 + behind)):
            # The turns that `_scan_straight` calls forced.
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


_KEPT_MOVES = _kept_moves(NO_CORNER_CUTTING)
_KEPT_MOVES_CUTTING_CORNERS = _kept_moves(CORNER_CUTTING)


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
    kept_moves = _KEPT_MOVES
    if lattice.diagonals == CORNER_CUTTING:
        kept_moves = _KEPT_MOVES_CUTTING_CORNERS
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
    moves[goal] = _NO_MOVE
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
