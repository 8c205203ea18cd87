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
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Ints, UInt32s
from mapdata.jit import Int, inlined, kernel
from mapdata.search.kernels import (
    TOO_LONG,
    insert_in_heap,
    is_usable_end,
    remove_heap_top,
    scratch_view,
    with_capacity,
)
from mapdata.search.lattice import (
    CORNER_CUTTING,
    MAX_PATH_COST,
    UNIT,
    UNSEEN,
    WALL,
    Lattice,
    MoveRule,
    cell_at,
    count_path_cells,
    heuristic,
    lattice_of,
    load,
    position,
    split_cost,
)

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
) -> Int:
    """Run jump point search from ``start`` to ``goal``, and return the number of expansions.

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

    Raises:
        ValueError: a path is too long for exact costs.
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
            raise ValueError(TOO_LONG)
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
    return expansions


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
    grids: Bytes, starts: Ints, goals: Ints, rule: MoveRule, memory: Bytes
) -> tuple[Ints, Ints, Ints, Ints, Ints, Int]:
    """Run jump point search from ``starts[b]`` to ``goals[b]`` on ``grids[b]``, for B problems.

    Args:
        grids: (B, H, W), or (1, H, W) for a grid that all problems share.
        starts: (B, 2) cells.
        goals: (B, 2) cells.
        rule: which moves are legal; diagonal ones among them.
        memory: for a `Scratch` with room for eight pushes a cell. A scan pushes at most one cell,
            and each of the eight moves of a cell is scanned at most once.

    Returns:
        The cells (M, 2) of all paths, one after another; (B, 2) straight and diagonal moves, (-1,
        0) without a path, where moves of equal cost all count as straight; (B,) expansions; (B,)
        numbers of free cells that scans passed, the start included; (B + 1,) offsets of the paths
        in the cells; and the number of problems solved, less than B if the next one is refused: an
        end is outside or occupied, or the grid holds other numbers than 0 and 1.
    """
    count = len(starts)
    lattice = lattice_of(grids.shape[1:], rule)
    scratch = scratch_view(memory, lattice)
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
            or not is_usable_end(grid, starts[b], 0)
            or not is_usable_end(grid, goals[b], 0)
        ):
            return cells, moves, expansions, looks, offsets, b
        start = cell_at(starts[b, 0], starts[b, 1], lattice)
        goal = cell_at(goals[b, 0], goals[b, 1], lattice)
        expansions[b] = _search(
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
    return cells[:used], moves, expansions, looks, offsets, count
