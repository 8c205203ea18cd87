"""Paths by A* from Python beside what a user would otherwise pick: python -m benchmarks paths.

Everything is measured in one run. Each peer solves the same problems on its own kind of grid, made
beforehand, and must find paths of the same length; one that is not installed is skipped by name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import combinations, pairwise, product
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

import mapdata
from benchmarks import naive
from benchmarks.measure import Peer, Row, each, interleaved, median_ratio, to_text
from mapdata import MapSpec, Maze, Movement, generate

Ints: TypeAlias = npt.NDArray[np.int64]
Bytes: TypeAlias = npt.NDArray[np.uint8]
Cell: TypeAlias = tuple[int, int]
Path: TypeAlias = Sequence[Any] | npt.NDArray[Any]
"""Cells, or what a peer has for them, one for each; empty without a path."""

PACKAGES = ("mapdata-torch", "numpy", "numba")

RULES = {
    "4-connected": Movement(),
    "8-connected": Movement(8, corner_cutting=True, diagonal_cost=1),
}
"""The rules that pyastar2d has, too."""


@dataclass(frozen=True)
class ProblemSet:
    """P path problems: (P, H, W) uint8 grids, (P, 2) start and goal cells, and the number of each
    one's map.
    """

    grids: Bytes
    starts: Ints
    goals: Ints
    owners: list[int]

    def __len__(self) -> int:
        """Return the number of problems."""
        return len(self.starts)

    def __iter__(self) -> Iterator[tuple[int, Cell, Cell]]:
        """Yield number, start and goal of each problem."""
        for k, (start, goal) in enumerate(
            zip(self.starts.tolist(), self.goals.tolist(), strict=True)
        ):
            yield k, (start[0], start[1]), (goal[0], goal[1])

    def first(self, count: int) -> ProblemSet:
        """Return the first ``count`` problems."""
        return ProblemSet(
            self.grids[:count], self.starts[:count], self.goals[:count], self.owners[:count]
        )


def problems_of(maps: mapdata.Maps, *, every_pair: bool) -> ProblemSet:
    """Return the problems of a batch: between consecutive seeds, or between every pair of seeds of
    a map.
    """
    owners, starts, goals = [], [], []
    for i in range(len(maps)):
        seed_points = naive.seed_points_of(maps, i)
        for start, goal in combinations(seed_points, 2) if every_pair else pairwise(seed_points):
            owners.append(i)
            starts.append(start)
            goals.append(goal)
    return ProblemSet(maps.occupancy[np.array(owners)], np.array(starts), np.array(goals), owners)


def table_1(size: int, rooms: tuple[int, int] = (2, 9)) -> MapSpec:
    """Return Table 1 for maps of ``size`` x ``size``: rooms and passages as large a share of the
    side.
    """
    scale = size // 64
    sides = 14 * scale, 33 * scale
    width = 7 * scale, 15 * scale
    return MapSpec((size, size), rooms, room_rows=sides, room_columns=sides, passage_width=width)


# --- the peers: each makes its kind of grid once, and gives a function from start and goal to a p

Solver: TypeAlias = Callable[[Cell, Cell], Path]


def pyastar2d(module: Any, grid: Bytes, diagonals: bool = False) -> Solver:
    """Weights in float32, infinite where occupied."""
    weights = np.where(grid == 1, np.inf, 1).astype(np.float32)
    return lambda start, goal: none_is_empty(
        module.astar_path(weights, start, goal, allow_diagonal=diagonals)
    )


def tcod(module: Any, grid: Bytes) -> Solver:
    """A cost of 0 where occupied. Its newer function path2d takes three times as long."""
    get_path = module.AStar((1 - grid).astype(np.int8), diagonal=0).get_path

    def solve(start: Cell, goal: Cell) -> Path:
        found: Path = get_path(*start, *goal)  # without the start
        return [start, *found] if len(found) or start == goal else []

    return solve


def scipy(module: Any, grid: Bytes) -> Solver:
    """A sparse graph, both directions of each edge; the path is walked back."""
    from scipy.sparse import csr_matrix

    a, b = edges_of(grid)
    both = np.concatenate([a, b]), np.concatenate([b, a])
    graph = csr_matrix((np.ones(2 * len(a), np.int8), both), shape=(grid.size, grid.size))
    columns = grid.shape[1]

    def solve(start: Cell, goal: Cell) -> Path:
        first, cell = start[0] * columns + start[1], goal[0] * columns + goal[1]
        parents = module.breadth_first_order(graph, first)[1]
        path = [cell]
        while cell != first:
            cell = parents[cell]
            if cell < 0:
                return []
            path.append(cell)
        return path

    return solve


def skimage(module: Any, grid: Bytes) -> Solver:
    """Costs of 1, negative where occupied: no way through.

    What route_through_array prepares for each path is prepared once.
    """
    search = module.MCP(np.where(grid == 1, -1.0, 1.0), fully_connected=False)

    def solve(start: Cell, goal: Cell) -> Path:
        search.find_costs([start], [goal])
        try:
            found: Path = search.traceback(goal)
        except ValueError:  # its word for no path
            return []
        return found

    return solve


def networkx(module: Any, grid: Bytes) -> Solver:
    """A graph of numbered cells; its shortest_path searches from both ends."""
    graph = module.Graph()
    graph.add_nodes_from(np.flatnonzero(grid == 0).tolist())
    graph.add_edges_from(zip(*(end.tolist() for end in edges_of(grid)), strict=True))
    columns = grid.shape[1]

    def solve(start: Cell, goal: Cell) -> Path:
        try:
            ends = start[0] * columns + start[1], goal[0] * columns + goal[1]
            found: Path = module.shortest_path(graph, *ends)
        except module.NetworkXNoPath:
            return []
        return found

    return solve


def pathfinding(module: Any, grid: Bytes) -> Solver:
    """Its grid, 1 free, cleaned between searches.

    Its BiAStarFinder is faster, but does not always find a shortest path.
    """
    from importlib import import_module

    grid_of_nodes = import_module("pathfinding.core.grid").Grid(matrix=(1 - grid).tolist())
    finder = module.AStarFinder()

    def solve(start: Cell, goal: Cell) -> Path:
        grid_of_nodes.cleanup()
        found: Path = finder.find_path(
            grid_of_nodes.node(start[1], start[0]),
            grid_of_nodes.node(goal[1], goal[0]),
            grid_of_nodes,
        )[0]
        return found

    return solve


def edges_of(grid: Bytes) -> tuple[Ints, Ints]:
    """Return both ends, as numbers of cells, of each pair of neighbouring free cells."""
    numbers, free = np.arange(grid.size).reshape(grid.shape), grid == 0
    right, down = free[:, :-1] & free[:, 1:], free[:-1] & free[1:]
    first = np.concatenate([numbers[:, :-1][right], numbers[:-1][down]])
    return first, np.concatenate([numbers[:, 1:][right], numbers[1:][down]])


def none_is_empty(path: Path | None) -> Path:
    """Return a path, empty where a peer says None."""
    return [] if path is None else path


PEERS: dict[Peer, Callable[[Any, Bytes], Solver]] = {
    Peer("pyastar2d", "pyastar2d", "pyastar2d", "astar_path(weights, start, goal)"): pyastar2d,
    Peer(
        "python-tcod",
        "tcod",
        "tcod.path",
        "AStar(cost, diagonal=0).get_path(*start, *goal)",
    ): tcod,
    Peer(
        "scipy",
        "scipy",
        "scipy.sparse.csgraph",
        "breadth_first_order(graph, start), then back from goal",
    ): scipy,
    Peer(
        "scikit-image",
        "scikit-image",
        "skimage.graph",
        "MCP(costs, fully_connected=False).find_costs([start], [goal])",
    ): skimage,
    Peer("networkx", "networkx", "networkx", "shortest_path(graph, start, goal)"): networkx,
    Peer(
        "pathfinding",
        "pathfinding",
        "pathfinding.finder.a_star",
        "AStarFinder().find_path(s, g, grid)",
    ): pathfinding,
}


def solve_with(peer: Peer, problems: ProblemSet) -> Callable[[], list[Path]]:
    """Return what solves ``problems`` one by one with ``peer``, whose grids are made here.

    Raises:
        SystemExit: it finds a path of another length than `mapdata` does.
    """
    prepare, module = PEERS[peer], peer.load()
    made = cache(lambda owner: prepare(module, problems.grids[problems.owners.index(owner)]))
    solvers = [made(owner) for owner in problems.owners]

    def run() -> list[Path]:
        return [solvers[k](start, goal) for k, start, goal in problems]

    ours = np.diff(
        mapdata.search_batch("astar", problems.grids, problems.starts, problems.goals).offsets
    )
    for k, path in enumerate(run()):
        if len(path) != ours[k]:
            raise SystemExit(
                f"mapdata and {peer.name} differ: {ours[k]} and {len(path)} cells on problem {k}"
            )
    return run


# --- rows ---------------------------------------------------------------------------------------


def rows_of(size: int, count: int, few: int, rounds: int) -> list[Row]:
    """Return the rows of maps of ``size`` x ``size``: ``count`` of them for single calls and
    batches beside pyastar2d, their first ``few`` problems beside every peer.
    """
    maps = generate(table_1(size), 1, range(count))
    own = problems_of(maps, every_pair=False)
    # A batch on one grid: the same number of problems, between free cells of the first map.
    free = np.argwhere(maps.occupancy[0] == 0)
    drawn = np.random.default_rng(0).integers(len(free), size=(2, len(own)))
    grids = np.broadcast_to(maps.occupancy[0], own.grids.shape)
    one = ProblemSet(grids, free[drawn[0]], free[drawn[1]], [0] * len(own))
    some = own.first(few)

    def singly(problems: ProblemSet) -> list[Path]:
        return [mapdata.astar(problems.grids[k], start, goal).path for k, start, goal in problems]

    contestants: dict[str, Callable[[], object]] = {
        "few": lambda: singly(some),
        "single": lambda: singly(own),
        "batch": lambda: mapdata.search_batch("astar", own.grids, own.starts, own.goals),
        "one grid": lambda: mapdata.search_batch("astar", one.grids[0], one.starts, one.goals),
    }
    fastest, *others = PEERS
    if not fastest.absence:
        contestants |= {
            "theirs": solve_with(fastest, own),
            "theirs on one": solve_with(fastest, one),
        }
    contestants |= {peer.name: solve_with(peer, some) for peer in others if not peer.absence}
    times = interleaved(contestants, rounds)

    def row(work: str, name: str, other: str, target: str, peer: Peer, total: int) -> Row:
        value = each(times[name], total)
        if peer.absence:
            return Row(work, value, target=target, note=f"{peer.name}: skipped")
        ratio = f"{median_ratio(times[other], times[name]):,.1f}x"
        return Row(
            work,
            value,
            each(times[other], total),
            ratio,
            target,
            f"{peer.name}: equal lengths, {total:,} paths",
        )

    sized = f"A*, per path, {size} x {size}"
    many = len(own)
    return [
        row(f"{sized}, single calls", "single", "theirs", "", fastest, many),
        row(f"{sized}, one call, a grid each", "batch", "theirs", "", fastest, many),
        row(f"{sized}, one call, one grid", "one grid", "theirs on one", "", fastest, many),
        *(row(f"{sized}, single calls", "few", peer.name, "", peer, len(some)) for peer in others),
    ]


def grids_of(side: int) -> dict[str, Bytes]:
    """Return a map of ``side`` x ``side`` of each kind: empty, rooms, maze, obstacles."""
    corridors = Maze((side, side), corridor=max(1, side // 256), reopened=0.05, seed_points=2)
    obstacles = np.random.default_rng(0).random((side, side)) < 0.3
    return {
        "empty": np.zeros((side, side), np.uint8),
        "rooms": generate(table_1(side), 1, [0]).occupancy[0],
        "maze": generate(corridors, 1, [0]).occupancy[0],
        "obstacles": obstacles.astype(np.uint8),
    }


def ends_of(grid: Bytes, count: int, *, near: bool) -> list[tuple[Cell, Cell]]:
    """Return ``count`` problems between free cells: any two, or two at most 8 rows and columns
    apart.
    """
    source = np.random.default_rng(1)
    free = np.argwhere(grid == 0)
    ends = []
    for start in free[source.integers(len(free), size=count)]:
        around = free[(abs(free - start) <= 8).all(axis=1)] if near else free
        goal = around[source.integers(len(around))]
        ends.append(((int(start[0]), int(start[1])), (int(goal[0]), int(goal[1]))))
    return ends


def kinds_of(side: int, rounds: int) -> list[Row]:
    """Return the rows of single calls beside pyastar2d, for each kind of map and each rule."""
    peer = next(iter(PEERS))
    rows = []
    for kind, grid in grids_of(side).items():
        for (rule, movement), near in product(RULES.items(), (False, True)):
            if near and kind != "rooms":
                continue
            ends = ends_of(grid, 4, near=near)
            ours = partial(each_path, partial(astar_path, grid, movement), ends)
            contestants = {"ours": ours}
            if not peer.absence:
                solve = pyastar2d(peer.load(), grid, diagonals=rule == "8-connected")
                theirs = partial(each_path, solve, ends)
                contestants["theirs"] = theirs
                if [len(path) for path in ours()] != [len(path) for path in theirs()]:
                    raise SystemExit(f"mapdata and {peer.name} differ on {kind} {side} x {side}")
            times = interleaved(contestants, rounds)
            work = f"A*, per {'short ' if near else ''}path, {kind}, {side} x {side}, {rule}"
            value = each(times["ours"], len(ends))
            if peer.absence:
                rows.append(Row(work, value, target="1x", note=f"{peer.name}: skipped"))
                continue
            other = each(times["theirs"], len(ends))
            ratio = f"{median_ratio(times['theirs'], times['ours']):,.1f}x"
            rows.append(Row(work, value, other, ratio, "1x", f"{peer.name}: equal lengths"))
    return rows


def order_rows(side: int, rounds: int) -> list[Row]:
    """Return the rows of `search_order`, with and without a heuristic of one's own, beside A*."""
    grid = grids_of(side)["rooms"]
    movement = Movement(8)
    ends = ends_of(grid, 4, near=False)
    blind = partial(mapdata.search_order, heuristic=np.zeros(grid.shape))
    rows = []
    for name, order in (
        ("search_order", mapdata.search_order),
        ("search_order with heuristic=", blind),
    ):
        contestants = {
            "order": partial(solve_all, partial(order, grid, movement=movement), ends),
            "A*": partial(solve_all, partial(mapdata.astar, grid, movement=movement), ends),
        }
        times = interleaved(contestants, rounds)
        ours, others = (each(times[key], len(ends)) for key in contestants)
        ratio = f"{median_ratio(times['A*'], times['order']):.3g}x"
        work = f"{name}, per path, rooms, {side} x {side}, 8-connected"
        rows.append(
            Row(work, ours, others, ratio, note="mapdata.astar: the path without the order")
        )
    return rows


def solve_all(solve: Callable[[Cell, Cell], object], ends: list[tuple[Cell, Cell]]) -> None:
    """Solve all problems."""
    for start, goal in ends:
        solve(start, goal)


def astar_path(grid: Bytes, movement: Movement, start: Cell, goal: Cell) -> Path:
    """Return our path."""
    return mapdata.astar(grid, start, goal, movement).path


def each_path(solve: Solver, ends: list[tuple[Cell, Cell]]) -> list[Path]:
    """Return the path of each problem."""
    return [solve(start, goal) for start, goal in ends]


def table(quick: bool, parent: str | None = None) -> str:
    """Measure, and return the table; nothing is written."""
    rounds = 3 if quick else 9
    count = 100 if quick else 400
    rows = rows_of(64, count, 100, rounds)
    for side in (64, 1024):
        rows += kinds_of(side, min(rounds, 5))
    rows += order_rows(64, min(rounds, 5))
    notes = (
        f"{rounds} repeats",
        "maps of the paper's Table 1, larger ones in proportion; paths between consecutive rooms, "
        "4-connected",
        "rows that name a kind of map (empty, rooms, maze, obstacles): 4 problems; in rows of "
        "short paths, start and goal are at most 8 rows and columns apart; diagonal moves cost 1 "
        "and cut corners, as in pyastar2d",
    )
    return to_text("Paths", rows, packages=PACKAGES, notes=notes, peers=[*PEERS])
