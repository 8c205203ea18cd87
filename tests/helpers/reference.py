"""Slow, obviously right plain Python: what `mapdata` must equal, written from docs/format.md.

Nothing here imports `mapdata` and nothing is clever: lists, a deque, a heap, Python's unbounded
integers; numpy only holds results. A grid is a list of rows, 1 occupied and 0 free; a cell is
`(row, col)`; a cost is the exact integer pair `(straight, diagonal)` until it is asked for as a
float.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from fractions import Fraction
from itertools import pairwise
from math import floor, isqrt
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from mapdata import MapGenerator, MapSpec
    from mapdata.movement import Movement

Cell: TypeAlias = tuple[int, int]
Grid: TypeAlias = Sequence[Sequence[int]]
Pair: TypeAlias = tuple[int, int]  # (straight, diagonal) moves: a cost, exactly
Words: TypeAlias = tuple[int, int, int, int]

# --- random numbers ------------------------------------------------------------------------------

WORD = 0xFFFFFFFF
MAP, PROBLEM, SPLIT, AUGMENTATION, ORDER = range(5)


def philox4x32(counter: Sequence[int], key: Sequence[int]) -> Words:
    """Philox4x32-10 as Salmon et al., SC 2011, publish it: ten rounds, each with another key."""
    c0, c1, c2, c3 = counter
    k0, k1 = key
    for _ in range(10):
        first = 0xD2511F53 * c0
        second = 0xCD9E8D57 * c2
        c0 = (second >> 32) ^ c1 ^ k0
        c1 = second & WORD
        c2 = (first >> 32) ^ c3 ^ k1
        c3 = first & WORD
        k0 = (k0 + 0x9E3779B9) & WORD
        k1 = (k1 + 0xBB67AE85) & WORD
    return c0, c1, c2, c3


def block(seed: int, index: int, epoch: int, stream: int, number: int) -> Words:
    """Return a block of four 32-bit words."""
    counter = (index & WORD, index >> 32, epoch, stream << 24 | number)
    key = (seed & WORD, seed >> 32)
    return philox4x32(counter, key)


def bounded(word: int, low: int, high: int) -> int:
    """Map a 32-bit word to low..high, both ends included, by multiply-high."""
    return low + ((word * (high - low + 1)) >> 32)


def threshold(probability: float) -> int:
    """Return the integer that a 32-bit word must stay below for the event to happen."""
    return round(probability * 2**32)


def divided_splits(seed: int, numbers: Iterable[int], fractions: Sequence[float]) -> dict[int, int]:
    """Return the split of each imported map whose source states none.

    The maps that rounding down leaves go to the split that lacks most of its exact share.
    """
    shares = [Fraction(threshold(fraction), 2**32) for fraction in fractions]
    queue = sorted(numbers, key=lambda number: (block(seed, number, 0, SPLIT, 0)[0], number))
    exact = [len(queue) * share for share in shares]
    sizes = [floor(size) for size in exact]
    while sum(sizes) < len(queue):  # at most one map for each split is left
        lacking = [size - given for size, given in zip(exact, sizes, strict=True)]
        sizes[lacking.index(max(lacking))] += 1
    for k in range(3):
        if len(queue) >= 3 and shares[k] > 0 and sizes[k] == 0:
            sizes[sizes.index(max(sizes))] -= 1
            sizes[k] += 1
    return {queue.pop(0): k for k in range(3) for _ in range(sizes[k])}


# --- Algorithm 1 --------------------------------------------------------------------------------


class ReferenceMap(NamedTuple):
    """One map: sizes are as drawn, before clipping; split is 0 train, 1 val, 2 test."""

    occupancy: list[list[int]]
    passage_width: int
    seed_points: list[Cell]
    sizes: list[tuple[int, int]]
    directions: list[tuple[int, int]]
    split: int


def carve(grid: list[list[int]], rows: range, columns: range) -> None:
    """Free every cell of rows x columns that lies inside the map."""
    for row in rows:
        for column in columns:
            if 0 <= row < len(grid) and 0 <= column < len(grid[0]):
                grid[row][column] = 0


def across(seed: int, width: int) -> range:
    """Return the cells that a side of this width covers about its seed, before clipping."""
    return range(seed - width // 2, seed - width // 2 + width)


def between(one: int, other: int) -> range:
    """Return the cells from one coordinate to the other, both included, whatever their order."""
    return range(min(one, other), max(one, other) + 1)


def carve_passage(
    grid: list[list[int]], start: Cell, goal: Cell, width: int, horizontal_first: bool
) -> None:
    """Carve both legs of the passage between two seeds and the full square at its corner."""
    corner = (start[0], goal[1]) if horizontal_first else (goal[0], start[1])
    rows = across(corner[0], width)
    columns = across(corner[1], width)
    carve(grid, rows, between(start[1], goal[1]))  # the horizontal leg lies in the corner's row
    carve(grid, between(start[0], goal[0]), columns)  # the vertical one in its column
    carve(grid, rows, columns)


def reference_map(generator: MapSpec, seed: int, index: int) -> ReferenceMap:
    """Draw and carve one map: all rooms, then the passages between consecutive ones."""
    height, width = generator.map_size
    first = block(seed, index, 0, MAP, 0)
    rooms = bounded(first[0], *generator.rooms)
    passage = bounded(first[1], *generator.passage_width)
    grid = [[1] * width for _ in range(height)]
    seed_points = []
    sizes = []
    directions = []
    for q in range(rooms):
        words = block(seed, index, 0, MAP, 1 + 2 * q)
        row = bounded(words[0], 0, height - 1)
        column = bounded(words[1], 0, width - 1)
        tall = bounded(words[2], *generator.room_rows)
        wide = bounded(words[3], *generator.room_columns)
        seed_points.append((row, column))
        sizes.append((tall, wide))
        carve(grid, across(row, tall), across(column, wide))
    for q in range(rooms - 1):
        words = block(seed, index, 0, MAP, 2 + 2 * q)
        if words[0] < threshold(generator.skip_probability):
            directions.append((-1, -1))
            continue
        horizontal_first = bounded(words[1], 0, 1) == 1
        directions.append((1, 0) if horizontal_first else (0, 1))
        carve_passage(grid, seed_points[q], seed_points[q + 1], passage, horizontal_first)
    split = reference_split(generator, seed, index)
    return ReferenceMap(grid, passage, seed_points, sizes, directions, split)


def reference_split(generator: MapGenerator, seed: int, index: int) -> int:
    """Draw a map's split: 0 train, 1 val, 2 test."""
    word = block(seed, index, 0, SPLIT, 0)[0]
    train, validation, _ = generator.splits
    if word < threshold(train):
        return 0
    return 1 if word < threshold(train + validation) else 2


# --- moves and costs ----------------------------------------------------------------------------

STRAIGHT = ((-1, 0), (0, 1), (1, 0), (0, -1))  # N, E, S, W
DIAGONAL = ((-1, 1), (1, 1), (1, -1), (-1, -1))  # NE, SE, SW, NW


def is_free(grid: Grid, cell: Cell) -> bool:
    """Tell whether the cell lies inside the grid and is free."""
    row, column = cell
    return 0 <= row < len(grid) and 0 <= column < len(grid[0]) and grid[row][column] == 0


def neighbours(
    grid: Grid, cell: Cell, movement: Movement, terrain: Grid | None = None
) -> Iterator[tuple[Cell, Pair]]:
    """Yield the cells one move away and the move's cost: N, E, S, W, NE, SE, SW, NW.

    On terrain the cost is doubled: the sum of both cells for a straight or for a diagonal move.
    """
    row, column = cell

    def weight(neighbour: Cell) -> int:
        if terrain is None:
            return 1
        return terrain[row][column] + terrain[neighbour[0]][neighbour[1]]

    for down, right in STRAIGHT:
        neighbour = (row + down, column + right)
        if is_free(grid, neighbour):
            yield neighbour, (weight(neighbour), 0)
    if movement.connectivity == 4:
        return
    for down, right in DIAGONAL:
        neighbour = (row + down, column + right)
        beside = is_free(grid, (row + down, column)) and is_free(grid, (row, column + right))
        if is_free(grid, neighbour) and (beside or movement.corner_cutting):
            yield neighbour, (0, weight(neighbour))


def weigh(cost: Pair, movement: Movement) -> int:
    """Order costs exactly: cost * 2**64 as an integer.

    The root of 2 is cut after 64 binary places, an error below 2**-64 a diagonal move; two
    different pairs below 2**21 differ by more than 2**-24.
    """
    one = 1 << 64
    diagonal = one if movement.diagonal_cost == 1 else isqrt(2 * one * one)
    return cost[0] * one + cost[1] * diagonal


def as_float(cost: Pair, movement: Movement, terrain: Grid | None = None) -> float:
    """Turn a cost into a float, once. On terrain it is doubled until here."""
    sum_of_moves = cost[0] + cost[1] * movement.diagonal_cost
    return sum_of_moves if terrain is None else sum_of_moves / 2


def add(one: Pair, other: Pair) -> Pair:
    """Add two costs."""
    return one[0] + other[0], one[1] + other[1]


def heuristic(cell: Cell, goal: Cell, movement: Movement, factor: int = 1) -> Pair:
    """Return the cost to the goal on an empty map, Manhattan or octile, times a factor."""
    rows = abs(cell[0] - goal[0])
    columns = abs(cell[1] - goal[1])
    if movement.connectivity == 4:
        return factor * (rows + columns), 0
    return factor * abs(rows - columns), factor * min(rows, columns)


# --- searches -----------------------------------------------------------------------------------


class ReferenceResult(NamedTuple):
    """A path and its cost (empty and -1 when there is none), and the number of expansions."""

    path: list[Cell]
    cost: float
    iterations: int


def trace(parents: dict[Cell, Cell], goal: Cell) -> list[Cell]:
    """Follow the parents back from the goal; the start is its own parent."""
    path = [goal]
    while parents[path[-1]] != path[-1]:
        path.append(parents[path[-1]])
    return path[::-1]


def reference_bfs(
    grid: Grid,
    start: Cell,
    goal: Cell,
    movement: Movement,
    terrain: Grid | None = None,
    *,
    expanded: list[Cell] | None = None,
) -> ReferenceResult:
    """First in, first out; the cost counts moves, whatever the terrain.

    Cells are appended to ``expanded``.
    """
    del terrain
    expanded = [] if expanded is None else expanded
    frontier = deque([start])
    parents = {start: start}
    iterations = 0
    while frontier:
        cell = frontier.popleft()
        iterations += 1
        expanded.append(cell)
        if cell == goal:
            path = trace(parents, goal)
            return ReferenceResult(path, float(len(path) - 1), iterations)
        for neighbour, _ in neighbours(grid, cell, movement):
            if neighbour not in parents:
                parents[neighbour] = cell
                frontier.append(neighbour)
    return ReferenceResult([], -1.0, iterations)


def reference_astar(
    grid: Grid,
    start: Cell,
    goal: Cell,
    movement: Movement,
    terrain: Grid | None = None,
    *,
    expanded: list[Cell] | None = None,
) -> ReferenceResult:
    """Pop the least f, of equal ones the latest; a parent changes only for a smaller g.

    On terrain the heuristic is that of a map whose cells all have the smallest cost of a free cell.
    Cells are appended to ``expanded``.
    """
    expanded = [] if expanded is None else expanded
    factor = 1
    if terrain is not None:
        factor = 2 * min(value for row in terrain for value in row if value > 0)
    frontier = [(weigh(heuristic(start, goal, movement, factor), movement), 0, start)]
    costs: dict[Cell, Pair] = {start: (0, 0)}
    parents = {start: start}
    taken: set[Cell] = set()
    pushes = 0
    while frontier:
        cell = heapq.heappop(frontier)[2]
        if cell in taken:
            # A stale entry: the cell was pushed again with a smaller g, and does not count twice.
            continue
        taken.add(cell)
        expanded.append(cell)
        if cell == goal:
            path = trace(parents, goal)
            return ReferenceResult(path, as_float(costs[goal], movement, terrain), len(taken))
        for neighbour, step in neighbours(grid, cell, movement, terrain):
            cost = add(costs[cell], step)
            if neighbour not in costs or weigh(cost, movement) < weigh(costs[neighbour], movement):
                costs[neighbour] = cost
                parents[neighbour] = cell
                pushes += 1
                to_goal = heuristic(neighbour, goal, movement, factor)
                estimate = weigh(add(cost, to_goal), movement)
                heapq.heappush(frontier, (estimate, -pushes, neighbour))
    return ReferenceResult([], -1.0, len(taken))


def reference_distances(
    grid: Grid, goal: Cell, movement: Movement, terrain: Grid | None = None
) -> dict[Cell, Pair]:
    """Dijkstra: the exact cost from every cell that reaches the goal; on terrain it is doubled."""
    costs: dict[Cell, Pair] = {goal: (0, 0)}
    frontier = [(0, goal)]
    taken: set[Cell] = set()
    while frontier:
        cell = heapq.heappop(frontier)[1]
        if cell in taken:
            continue
        taken.add(cell)
        for neighbour, step in neighbours(grid, cell, movement, terrain):
            cost = add(costs[cell], step)
            if neighbour not in costs or weigh(cost, movement) < weigh(costs[neighbour], movement):
                costs[neighbour] = cost
                heapq.heappush(frontier, (weigh(cost, movement), neighbour))
    return costs


def reference_field(
    grid: Grid, goal: Cell, movement: Movement, terrain: Grid | None = None
) -> npt.NDArray[np.float32]:
    """Return the distance field: float32, -1 where the goal cannot be reached."""
    field = np.full((len(grid), len(grid[0])), -1, dtype=np.float32)
    for cell, cost in reference_distances(grid, goal, movement, terrain).items():
        field[cell] = as_float(cost, movement, terrain)
    return field


def reference_moves(
    grid: Grid, goal: Cell, movement: Movement, terrain: Grid | None = None
) -> npt.NDArray[np.uint8]:
    """Return, per cell, the bits of the moves that lower the cost to the goal by their own.

    Bit k is move k of N, E, S, W, NE, SE, SW, NW.
    """
    bits = np.zeros((len(grid), len(grid[0])), np.uint8)
    steps = STRAIGHT + DIAGONAL
    costs = reference_distances(grid, goal, movement, terrain)
    for cell, cost in costs.items():
        for neighbour, step in neighbours(grid, cell, movement, terrain):
            through = weigh(add(costs[neighbour], step), movement)
            if through == weigh(cost, movement):
                bits[cell] |= 1 << steps.index((neighbour[0] - cell[0], neighbour[1] - cell[1]))
    return bits


class ReferenceProblem(NamedTuple):
    """A problem, and what its shortest path costs."""

    start: Cell
    goal: Cell
    cost: Pair


Band: TypeAlias = tuple[float, float]


def reference_problem(
    grid: Grid,
    seed: int,
    index: int,
    epoch: int,
    bands: Sequence[Band],
    movement: Movement,
    draws: int = 32,
    only_goal: Cell | None = None,
    terrain: Grid | None = None,
) -> ReferenceProblem | None:
    """Draw goals, and for each one of the starts that meet all bands, until a goal has a start.

    On terrain the number of a path's cells does not follow from its cost, so A* counts them after
    the draw.
    """
    if only_goal is not None and not is_free(grid, only_goal):
        return None
    known: dict[Cell, dict[Cell, Pair]] = {}
    cells = [(row, column) for row in range(len(grid)) for column in range(len(grid[0]))]
    free = [cell for cell in cells if is_free(grid, cell)]
    for draw in range(draws if free else 0):
        words = block(seed, index, epoch, PROBLEM, draw)
        goal = only_goal or free[bounded(words[0], 0, len(free) - 1)]
        if goal not in known:
            known[goal] = reference_distances(grid, goal, movement, terrain)
        costs = known[goal]
        starts = starts_within(grid, goal, costs, bands, movement, terrain)
        if not starts:
            continue
        start = starts[bounded(words[1], 0, len(starts) - 1)]
        if terrain is not None:
            lowest, highest = bands[2]
            length = len(reference_astar(grid, start, goal, movement, terrain).path)
            if not lowest <= length <= highest:
                continue
        return ReferenceProblem(start, goal, costs[start])
    return None


def starts_within(
    grid: Grid,
    goal: Cell,
    costs: dict[Cell, Pair],
    bands: Sequence[Band],
    movement: Movement,
    terrain: Grid | None = None,
) -> list[Cell]:
    """Return the cells, in row-major order, whose path to the goal meets all bands.

    The costs are those of `reference_distances` to the goal. On terrain the band of length is left
    out.
    """
    factor = 1
    if terrain is not None:
        factor = 2 * min(value for row in terrain for value in row if value > 0)
    starts = []
    for cell in sorted(costs):
        if cell == goal or not is_free(grid, cell):
            continue
        distance = as_float(costs[cell], movement, terrain)
        lower_bound = heuristic(cell, goal, movement, factor)
        hardness = distance / as_float(lower_bound, movement, terrain)
        values = [distance, hardness]
        if terrain is None:
            values.append(sum(costs[cell]) + 1)
        # Without a number of cells, the band of length is left out.
        pairs = zip(values, bands, strict=False)
        if all(low <= value <= high for value, (low, high) in pairs):
            starts.append(cell)
    return starts


def first_bad_step(grid: Grid, path: Sequence[Cell], movement: Movement) -> int | None:
    """Return which cell of a non-empty path is the first that cannot be walked to, if any."""
    if not is_free(grid, path[0]):
        return 0
    for place in range(1, len(path)):
        near = [neighbour for neighbour, _ in neighbours(grid, path[place - 1], movement)]
        if path[place] not in near:
            return place
    return None


def path_cost(path: Sequence[Cell], movement: Movement, terrain: Grid | None = None) -> float:
    """Return the cost of a good path."""
    straight = 0
    diagonal = 0
    for a, b in pairwise(path):
        weight = 1 if terrain is None else terrain[a[0]][a[1]] + terrain[b[0]][b[1]]
        if a[0] != b[0] and a[1] != b[1]:
            diagonal += weight
        else:
            straight += weight
    return as_float((straight, diagonal), movement, terrain)


# --- labels -------------------------------------------------------------------------------------

Search: TypeAlias = Callable[..., ReferenceResult]

SEARCHES: dict[str, Search] = {"bfs": reference_bfs, "astar": reference_astar}
"""Each takes a grid, start, goal, movement and perhaps terrain."""


def reference_route(
    search: Search,
    grid: Grid,
    seed_points: Sequence[Cell],
    movement: Movement,
    terrain: Grid | None = None,
) -> list[ReferenceResult]:
    """Search the segments 1 -> 2, ..., n-1 -> n of the route through all seeds."""
    return [search(grid, start, goal, movement, terrain) for start, goal in pairwise(seed_points)]


def reference_matrix(
    search: Search,
    grid: Grid,
    seed_points: Sequence[Cell],
    movement: Movement,
    terrain: Grid | None = None,
) -> npt.NDArray[np.float64]:
    """Search every entry of the n x n connection matrix: the path cost, -1 when there is none."""
    rows = []
    for start in seed_points:
        rows.append([search(grid, start, goal, movement, terrain).cost for goal in seed_points])
    return np.array(rows)
