"""The kernel of `mapdata.evaluation.GuidedSearch`, whose docstring has the formulas."""

from __future__ import annotations

import heapq
import math

import numpy as np

from mapdata.arrays import Bytes, Flags, Float32s, Floats, Int8s, Int32s, Ints
from mapdata.jit import Int, inlined, kernel


def follow_predictions(
    terrain: Bytes,
    scores: Float32s,
    costs_to_go: Float32s,
    start: Ints,
    goal: Ints,
    penalty: float,
    moves: Ints,
    diagonal_cost: float,
    corner_cutting: bool,
) -> tuple[Ints, int, Int32s]:
    """Return the path of one problem, (k, 2) cells as from `_trace`, and which cells were expanded.

    Those are their number, and an array (H, W) of the number of the expansion of each cell, -1 for
    the others.

    Args:
        terrain: (H, W), the cost of each cell, 0 on occupied cells; 1 on all free cells of a map
            without terrain.
        scores: (moves, H, W), log probabilities, up to a constant for each cell.
        costs_to_go: (H, W), in cells.
        start: (2,), a free cell.
        goal: (2,), a free cell.
        penalty: penalty of a move whose odds squared are 2, in cells; infinite for a walk.
        moves: (4, 2) or (8, 2), rows and columns that each move goes; the last four of eight are
            the diagonal ones.
        diagonal_cost: length of a diagonal move, in cells.
        corner_cutting: whether a diagonal move may pass beside occupied cells.
    """
    order = np.full(terrain.shape, -1, np.int32)
    path, expansions = _follow(
        terrain,
        scores,
        costs_to_go,
        start,
        goal,
        penalty,
        moves,
        diagonal_cost,
        corner_cutting,
        np.full(terrain.shape, np.inf),
        np.full(terrain.shape, np.inf),
        np.full(terrain.shape, -1, np.int8),
        np.zeros(len(moves), np.bool_),
        order,
    )
    return path, expansions, order


@kernel
def _follow(
    terrain: Bytes,
    scores: Float32s,
    costs_to_go: Float32s,
    start: Ints,
    goal: Ints,
    penalty: float,
    moves: Ints,
    diagonal_cost: float,
    corner_cutting: bool,
    lengths: Floats,
    costs: Floats,
    move_to: Int8s,
    legal: Flags,
    order: Int32s,
) -> tuple[Ints, Int]:
    """Do the work of `follow_predictions`, whose arguments come first; return path and expansions.

    The arrays come from Python, because they would take a second to compile.

    Args:
        terrain: (H, W).
        scores: (moves, H, W).
        costs_to_go: (H, W).
        start: (2,).
        goal: (2,).
        penalty: in cells.
        moves: (4, 2) or (8, 2).
        diagonal_cost: in cells.
        corner_cutting: whether corners may be cut.
        lengths: (H, W), infinite, memory for the length of the best path to each cell.
        costs: (H, W), infinite, memory for the cost of the best path to each cell.
        move_to: (H, W), -1, memory for the move that leads to a cell from its parent.
        legal: (moves,), memory for which moves are legal.
        order: (H, W), -1, to be filled with the number of the expansion of each cell.
    """
    rows, columns = terrain.shape
    lengths[start[0], start[1]] = 0.0
    costs[start[0], start[1]] = 0.0
    # Entries are (priority, tie-break, row, column); the smallest entry is popped first.
    frontier = [(0.0, 0.0, start[0], start[1])]
    pushes = 0
    expansions = 0
    while frontier:
        _, _, row, column = heapq.heappop(frontier)
        if order[row, column] >= 0:
            continue
        order[row, column] = expansions
        expansions += 1
        if row == goal[0] and column == goal[1]:
            break

        best_score = -np.inf
        for move in range(len(moves)):
            next_row = row + moves[move, 0]
            next_column = column + moves[move, 1]
            is_inside = 0 <= next_row < rows and 0 <= next_column < columns
            legal[move] = is_inside and terrain[next_row, next_column] != 0
            if legal[move] and move >= 4 and not corner_cutting:
                legal[move] = terrain[next_row, column] != 0 and terrain[row, next_column] != 0
            if legal[move]:
                best_score = max(best_score, scores[move, row, column])

        length = lengths[row, column]
        cost = costs[row, column]
        cell_cost = float(terrain[row, column])
        for move in range(len(moves)):
            if not legal[move]:
                continue
            next_row = row + moves[move, 0]
            next_column = column + moves[move, 1]
            mean_cost = (cell_cost + float(terrain[next_row, next_column])) / 2
            move_cost = mean_cost * (diagonal_cost if move >= 4 else 1.0)
            # A shorter path replaces the parent of an expanded cell, too, as in the classical
            # planners. Lengths only fall, and a cell's length always exceeds its parent's, so
            # parents never form a cycle.
            next_length = length + move_cost
            if next_length < lengths[next_row, next_column]:
                lengths[next_row, next_column] = next_length
                move_to[next_row, next_column] = move
            if order[next_row, next_column] >= 0:
                continue

            log_odds = best_score - scores[move, row, column]
            if penalty == np.inf:
                # Depth first: neighbours of the last expanded cell come before all other cells.
                heapq.heappush(frontier, (float(-expansions), log_odds, next_row, next_column))
                continue
            # Odds squared are at most e^20: no path is as long, and with larger numbers floats
            # would have no digits left for lengths. The bound is the first argument of min, which
            # returns it for log odds of NaN, too.
            odds_squared_minus_1 = math.expm1(min(20.0, 2 * log_odds))
            next_cost = cost + move_cost + penalty * odds_squared_minus_1
            if next_cost < costs[next_row, next_column]:
                costs[next_row, next_column] = next_cost
                to_go = costs_to_go[next_row, next_column]
                f = next_cost + to_go - 0.001 * lengths[next_row, next_column]
                pushes += 1
                heapq.heappush(frontier, (f, float(-pushes), next_row, next_column))
    return _trace(move_to, moves, start, goal), expansions


@inlined
def _trace(move_to: Int8s, moves: Ints, start: Ints, goal: Ints) -> Ints:
    """Return the path from start to goal, (k, 2) cells, or (0, 2) where the goal was not reached.

    It is the end of an array with room for all cells of the map.

    Args:
        move_to: (H, W), the move that leads to a cell from its parent, or -1 without a parent.
        moves: (moves, 2), rows and columns that each move goes.
        start: (2,), a cell without a parent.
        goal: (2,), a cell.
    """
    row = goal[0]
    column = goal[1]
    # Parents lead from the goal to the start, so the array is filled from its end.
    cells = np.empty((move_to.size, 2), np.int64)  # no path has more cells than the map
    first = len(cells)
    is_start = row == start[0] and column == start[1]
    if move_to[row, column] == -1 and not is_start:
        return cells[first:]
    first -= 1
    cells[first, 0] = row
    cells[first, 1] = column
    while row != start[0] or column != start[1]:
        move = move_to[row, column]
        row -= moves[move, 0]
        column -= moves[move, 1]
        first -= 1
        cells[first, 0] = row
        cells[first, 1] = column
    return cells[first:]
