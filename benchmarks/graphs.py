"""Labels and paths beside compiled graph libraries and C++ planners: python -m benchmarks graphs.

A graph library needs a graph of each map. Its searches are measured alone, and with the building of
the graphs, since a new map needs a new graph. All find the same costs, which is checked first.
"""

from __future__ import annotations

import shutil
import statistics
import subprocess
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

import mapdata
from benchmarks.measure import Peer, Row, each, interleaved, median_ratio, seconds, to_text
from benchmarks.paths import Bytes, Cell, Ints, ends_of, grids_of, none_is_empty, solve_all
from mapdata import MapGenerator, Movement, generate, label
from mapdata.evaluation import JumpPointSearch

PACKAGES = ("mapdata-torch", "numpy", "numba")

SCIPY = Peer(
    "scipy",
    "scipy",
    "scipy.sparse.csgraph",
    "dijkstra(graph, indices=seeds)` or `breadth_first_order(graph, seed)",
)
IGRAPH = Peer(
    "igraph",
    "igraph",
    "igraph",
    "distances(seeds, seeds), get_shortest_paths(a, b)` or `get_shortest_paths(seed, seeds)",
)
CSTAR = Peer("cstar-pathfinding", "cstar-pathfinding", "cstar.pathfinding", "run_astar_2D")
PYASTAR = Peer("pyastar2d", "pyastar2d", "pyastar2d", "astar_path(weights, start, goal)")

WARTHOG_SEARCHES = (
    ("warthog", "astar4c", Movement(4), "A*"),
    ("warthog", "astar", Movement(8), "A*"),
    ("warthog-jps", "jps2", Movement(8), "A*"),
    ("warthog-jps", "jps2", Movement(8), "jump point search"),
)
"""Programs of Warthog on the PATH, the search that each is asked for, its rule of moves, and the
search of ours that stands beside it.
"""

PRESETS = ("paper", "dungeon", "cave")

Matrix = npt.NDArray[np.float64]


def edges_of(grid: Bytes, connectivity: int) -> tuple[Ints, Matrix]:
    """Return the pairs of neighbouring free cells, (n, 2) numbers of cells, and their costs, (n,).

    Diagonal moves need both orthogonal neighbours to be free.
    """
    free = grid == 0
    numbers = np.arange(grid.size).reshape(grid.shape)
    pairs = [
        (numbers[:, :-1], numbers[:, 1:], free[:, :-1] & free[:, 1:], 1.0),
        (numbers[:-1], numbers[1:], free[:-1] & free[1:], 1.0),
    ]
    if connectivity == 8:
        all_free = free[:-1, :-1] & free[1:, 1:] & free[:-1, 1:] & free[1:, :-1]
        pairs += [
            (numbers[:-1, :-1], numbers[1:, 1:], all_free, 2**0.5),
            (numbers[:-1, 1:], numbers[1:, :-1], all_free, 2**0.5),
        ]
    ends = [np.stack([one[ok], other[ok]], axis=1) for one, other, ok, _ in pairs]
    costs = [np.full(np.count_nonzero(ok), cost) for *_, ok, cost in pairs]
    return np.concatenate(ends), np.concatenate(costs)


# --- the graph libraries: each builds a graph, and labels a map with it -------------------------


def scipy_graph(module: Any, grid: Bytes, connectivity: int) -> Any:
    """Return a sparse matrix, with both directions of each edge."""
    from scipy.sparse import csr_matrix

    ends, costs = edges_of(grid, connectivity)
    rows, columns = np.concatenate([ends, ends[:, ::-1]]).T
    return csr_matrix((np.concatenate([costs, costs]), (rows, columns)), (grid.size, grid.size))


def scipy_labels(module: Any, graph: Any, seeds: Ints, connectivity: int) -> Matrix:
    """Return the costs between seed points, and walk the paths between consecutive ones."""
    costs, parents = module.dijkstra(
        graph, indices=seeds, unweighted=connectivity == 4, return_predecessors=True
    )
    for k in range(len(seeds) - 1):
        if np.isfinite(costs[k, seeds[k + 1]]):
            path = [seeds[k + 1]]
            while path[-1] != seeds[k]:
                path.append(parents[k, path[-1]])
    between: Matrix = costs[:, seeds]
    return between


def scipy_breadth_first(module: Any, graph: Any, seeds: Ints, connectivity: int) -> Matrix:
    """Do the same for moves of equal cost, by a search from each seed and the way back."""
    cells = seeds.tolist()
    costs = np.full((len(cells), len(cells)), np.inf)
    np.fill_diagonal(costs, 0)
    for first, start in enumerate(cells[:-1]):
        parents = module.breadth_first_order(graph, start)[1].tolist()
        for second in range(first + 1, len(cells)):
            cell = cells[second]
            moves = 0
            while cell != start and cell >= 0:
                cell = parents[cell]
                moves += 1
            if cell == start:
                costs[first, second] = costs[second, first] = moves
    return costs


def igraph_graph(module: Any, grid: Bytes, connectivity: int) -> Any:
    """Return a graph with the costs of its edges."""
    ends, costs = edges_of(grid, connectivity)
    graph = module.Graph(grid.size, ends.tolist())
    graph.es["cost"] = costs.tolist()
    return graph


def igraph_labels(module: Any, graph: Any, seeds: Ints, connectivity: int) -> Matrix:
    """Return the costs between seed points, and find the paths between consecutive ones."""
    weights = None if connectivity == 4 else "cost"
    # It refuses a cell that is there twice, and overlapping rooms may have one seed point.
    cells, places = np.unique(seeds, return_inverse=True)
    costs = np.array(graph.distances(cells.tolist(), cells.tolist(), weights=weights), np.float64)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns where there is no path
        for start, goal in pairwise(seeds.tolist()):
            graph.get_shortest_paths(start, goal, weights=weights)
    between: Matrix = costs[places][:, places]
    return between


def igraph_paths(module: Any, graph: Any, seeds: Ints, connectivity: int) -> Matrix:
    """Do the same for moves of equal cost by the paths between all seeds, which have the costs."""
    cells = seeds.tolist()
    costs = np.full((len(cells), len(cells)), np.inf)
    np.fill_diagonal(costs, 0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns where there is no path
        for first, start in enumerate(cells[:-1]):
            paths = graph.get_shortest_paths(start, cells[first + 1 :])
            for second, path in enumerate(paths, first + 1):
                if path:
                    costs[first, second] = costs[second, first] = len(path) - 1
    return costs


Search = Callable[[Any, Any, Ints, int], Matrix]
"""Gives the costs between seeds from the module, the graph of a map, the seeds and the moves."""


class Library(NamedTuple):
    """What a graph library has for labels.

    Attributes:
        build: gives the graph of a map from the module, the map and the number of moves.
        any_costs: searches for moves of any costs.
        equal_costs: another search, for moves of equal cost.
    """

    build: Callable[[Any, Bytes, int], Any]
    any_costs: Search
    equal_costs: Search

    def searches(self, connectivity: int) -> list[Search]:
        """Return the searches for moves of this kind, of which the faster one counts."""
        return [self.any_costs, self.equal_costs] if connectivity == 4 else [self.any_costs]


LIBRARIES = {
    SCIPY: Library(scipy_graph, scipy_labels, scipy_breadth_first),
    IGRAPH: Library(igraph_graph, igraph_labels, igraph_paths),
}


def label_rows(preset: str, connectivity: int, count: int, rounds: int) -> list[Row]:
    """Return the rows of all labels of maps beside each library, alone and with its graphs.

    Raises:
        SystemExit: a library finds other costs.
    """
    generator = replace(MapGenerator.preset(preset), movement=Movement(connectivity))
    maps = generate(generator, 0, range(count))
    grids = np.ascontiguousarray(maps.occupancy)
    columns = grids.shape[2]
    seeds = [
        np.asarray(maps.seed_points[k][: maps.rooms[k]]) @ np.array([columns, 1])
        for k in range(count)
    ]
    rows = []
    for peer in LIBRARIES:
        work = f"labels, {preset}, {connectivity} moves, per map"
        if peer.absence:
            rows.append(Row(work, note=f"{peer.name}: skipped"))
            continue
        times = library_times(peer, maps, grids, seeds, connectivity, rounds)
        both = [one + two for one, two in zip(times["search"], times["graph"], strict=True)]
        for what, theirs in (("searches alone", times["search"]), ("with its graphs", both)):
            ratio = f"{median_ratio(theirs, times['ours']):,.0f}x"
            note = f"{peer.name}, {what}: equal costs"
            rows.append(Row(work, each(times["ours"], count), each(theirs, count), ratio, "", note))
    return rows


def library_times(
    peer: Peer,
    maps: mapdata.Maps,
    grids: Bytes,
    seeds: list[Ints],
    connectivity: int,
    rounds: int,
) -> dict[str, list[float]]:
    """Return the seconds of our labels, of a library's faster search, and of building its graphs.

    Raises:
        SystemExit: the library finds other costs.
    """
    library = LIBRARIES[peer]
    module = peer.load()
    graphs = [library.build(module, grid, connectivity) for grid in grids]
    labels = label(maps)
    contestants: dict[str, Callable[[], object]] = {
        "ours": lambda: label(maps),
        "graph": lambda: [library.build(module, grid, connectivity) for grid in grids],
    }
    for number, search in enumerate(library.searches(connectivity)):
        for k, graph in enumerate(graphs):
            found = search(module, graph, seeds[k], connectivity)
            expected = labels.matrix("astar", k)
            if not np.allclose(np.where(np.isfinite(found), found, -1), expected, atol=1e-3):
                raise SystemExit(f"mapdata and {peer.name} differ on map {k}")
        contestants[f"search {number}"] = partial(
            _label_all, search, module, graphs, seeds, connectivity
        )
    times = interleaved(contestants, rounds)
    searches = [times[name] for name in contestants if name.startswith("search")]
    fastest = min(searches, key=statistics.median)
    return {"ours": times["ours"], "search": fastest, "graph": times["graph"]}


def _label_all(
    search: Search, module: Any, graphs: list[Any], seeds: list[Ints], connectivity: int
) -> None:
    """Label all maps."""
    for graph, cells in zip(graphs, seeds, strict=True):
        search(module, graph, cells, connectivity)


# --- planners in C++ ----------------------------------------------------------------------------


def planner_rows(side: int, rounds: int) -> list[Row]:
    """Return the rows of A* beside cstar-pathfinding and pyastar2d, on maps of each kind.

    Raises:
        SystemExit: a planner finds other costs.
    """
    rows = []
    for kind, grid in grids_of(side).items():
        ends = ends_of(grid, 40, near=False)
        for peer, movement, solve in planners_of(grid):
            work = f"A*, {kind}, {side} x {side}, {movement.connectivity} moves, per path"
            if peer.absence:
                rows.append(Row(work, note=f"{peer.name}: skipped"))
                continue
            for start, goal in ends:
                ours = mapdata.astar(grid, start, goal, movement).cost
                theirs = cost_of(none_is_empty(solve(start, goal)), movement)
                if not np.isclose(ours, theirs):
                    raise SystemExit(f"mapdata and {peer.name} differ on {kind}: {ours}, {theirs}")
            times = interleaved(
                {
                    "ours": partial(solve_all, partial(_ours, grid, movement), ends),
                    "theirs": partial(solve_all, solve, ends),
                },
                rounds,
            )
            ratio = f"{median_ratio(times['theirs'], times['ours']):,.1f}x"
            ours_each, theirs_each = (each(times[name], len(ends)) for name in ("ours", "theirs"))
            note = f"{peer.name}: equal costs"
            rows.append(Row(work, ours_each, theirs_each, ratio, "", note))
    return rows


def planners_of(grid: Bytes) -> list[tuple[Peer, Movement, Callable[[Cell, Cell], Any]]]:
    """Return the planners with the rule of moves that each has, and how it solves a problem."""
    planners: list[tuple[Peer, Movement, Callable[[Cell, Cell], Any]]] = []
    cutting = Movement(8, corner_cutting=True)

    def by_cstar(start: Cell, goal: Cell) -> Any:
        return CSTAR.load().run_astar_2D(grid == 0, *start, *goal)[0]

    planners.append((CSTAR, cutting, by_cstar))
    weights = np.where(grid == 1, np.inf, 1).astype(np.float32)
    for movement, diagonals in (
        (Movement(4), False),
        (Movement(8, corner_cutting=True, diagonal_cost=1), True),
    ):

        def by_pyastar(start: Cell, goal: Cell, diagonals: bool = diagonals) -> Any:
            return PYASTAR.load().astar_path(weights, start, goal, allow_diagonal=diagonals)

        planners.append((PYASTAR, movement, by_pyastar))
    return planners


def warthog_rows(side: int, rounds: int) -> list[Row]:
    """Return the rows of our searches beside those of Warthog, on maps of each kind.

    Raises:
        SystemExit: Warthog finds other costs.
    """
    rows = []
    for kind, grid in grids_of(side).items():
        for program, search, movement, our_search in WARTHOG_SEARCHES:
            work = f"{our_search}, {kind}, {side} x {side}, {movement.connectivity} moves, per path"
            if shutil.which(program) is None:
                rows.append(Row(work, note=f"Warthog, {search}: skipped"))
                continue
            ends, costs = solvable_ends_of(grid, movement)
            solve = partial(OUR_SEARCHES[our_search], grid, movement, ends)
            ours: list[float] = []
            theirs: list[float] = []
            with tempfile.TemporaryDirectory() as name:
                scen = write_scenario(Path(name), grid, ends, costs)
                for _ in range(rounds + 1):
                    found = run_warthog(program, search, scen)
                    if not np.allclose(found["pcost"], costs, rtol=1e-5):  # it prints six digits
                        raise SystemExit(f"mapdata and Warthog, {search} differ on {kind}")
                    theirs.append(float(found["nanos"].sum()) * 1e-9)
                    ours.append(seconds(solve, calls=20))
            ours, theirs = ours[1:], theirs[1:]  # the first round warms up
            ratio = f"{median_ratio(theirs, ours):.3g}x"
            note = f"Warthog, {search}: equal costs"
            rows.append(Row(work, each(ours, len(ends)), each(theirs, len(ends)), ratio, "", note))
    return rows


def solvable_ends_of(
    grid: Bytes, movement: Movement
) -> tuple[list[tuple[Cell, Cell]], list[float]]:
    """Return problems of a map that have a path, and the costs of a shortest one."""
    ends = ends_of(grid, 40, near=False)
    costs = [mapdata.astar(grid, start, goal, movement).cost for start, goal in ends]
    pairs = [(pair, cost) for pair, cost in zip(ends, costs, strict=True) if cost >= 0]
    return [pair for pair, _ in pairs], [cost for _, cost in pairs]


def write_scenario(
    folder: Path, grid: Bytes, ends: list[tuple[Cell, Cell]], costs: list[float]
) -> Path:
    """Write a map and its problems in MovingAI's formats, and return the file of problems."""
    rows, columns = grid.shape
    lines = ["".join(".@"[cell] for cell in row) for row in grid]
    head = ["type octile", f"height {rows}", f"width {columns}", "map"]
    (folder / "map.map").write_text("\n".join([*head, *lines]) + "\n")
    problems = [
        f"0\tmap.map\t{columns}\t{rows}\t{start[1]}\t{start[0]}\t{goal[1]}\t{goal[0]}\t{cost:.8f}"
        for (start, goal), cost in zip(ends, costs, strict=True)
    ]
    scen = folder / "map.scen"
    scen.write_text("\n".join(["version 1", *problems]) + "\n")
    return scen


def run_warthog(program: str, search: str, scen: Path) -> dict[str, Matrix]:
    """Return the columns ``nanos`` and ``pcost`` that Warthog prints, one value a problem."""
    command = [
        program,
        "--alg",
        search,
        "--scen",
        str(scen),
        "--map",
        str(scen.with_suffix(".map")),
    ]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    head, *lines = [line.split("\t") for line in printed.splitlines()]
    return {
        name: np.array([float(line[head.index(name)]) for line in lines])
        for name in ("nanos", "pcost")
    }


def cost_of(path: Any, movement: Movement) -> float:
    """Return the cost of a path, -1 without one."""
    cells = np.asarray(path, np.int64).reshape(-1, 2)
    if not len(cells):
        return -1.0
    is_diagonal = np.abs(np.diff(cells, axis=0)).sum(axis=1) == 2
    return float(np.where(is_diagonal, movement.diagonal_cost, 1.0).sum())


def _ours(grid: Bytes, movement: Movement, start: Cell, goal: Cell) -> Any:
    """Return our path."""
    return mapdata.astar(grid, start, goal, movement).path


def _by_astar(grid: Bytes, movement: Movement, ends: list[tuple[Cell, Cell]]) -> None:
    """Solve all problems by A*, one call each."""
    solve_all(partial(_ours, grid, movement), ends)


def _by_jump_points(grid: Bytes, movement: Movement, ends: list[tuple[Cell, Cell]]) -> None:
    """Solve all problems by jump point search, in one call, which reads their map once."""
    starts, goals = np.array(ends, np.int64).transpose(1, 0, 2)
    JumpPointSearch("jump point search", movement).plan_batch(grid, starts, goals)


OUR_SEARCHES = {"A*": _by_astar, "jump point search": _by_jump_points}
"""How our searches solve the problems of a map."""


def table(quick: bool, folder: str | None = None) -> str:
    """Return the table in markdown; ``quick`` takes fewer maps, and ``folder`` is not used."""
    count, rounds = (5, 3) if quick else (20, 5)
    rows: list[Row] = []
    for preset in PRESETS:
        for connectivity in (4, 8):
            rows += label_rows(preset, connectivity, count, rounds)
    rows += planner_rows(64, rounds)
    rows += warthog_rows(64, rounds)
    return to_text(
        "Beside graph libraries and planners in C++",
        rows,
        packages=PACKAGES,
        notes=(
            f"{rounds} repeats, {count} maps",
            "labels: costs between all rooms, and paths between consecutive ones; ours also has "
            "the iterations of BFS and A*",
            "Warthog: the times that it prints, of its searches without reading files and paths; "
            "ours include the path and a call from Python: one for each problem of A*, one for the "
            "40 problems of a map of jump point search. `jps2` is Warthog's jump point search",
            "Warthog is built from https://github.com/ShortestPathLab/warthog-core and warthog-jps "
            "with `-DCMAKE_BUILD_TYPE=Release -DWARTHOG_INTRIN_ALL=ON`; it is skipped where its "
            "programs are not on the PATH",
            "cstar has 8 moves that cut corners and cost sqrt 2; pyastar2d's diagonal moves cost 1",
        ),
        peers=[*LIBRARIES, CSTAR, PYASTAR],
    )
