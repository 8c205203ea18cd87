"""Solving maps: BFS, A*, distance fields, the path check, the labels of the paper.

For kernels of your own: the lattice, its legal moves and its heuristic.
"""

from mapdata.movement import STEPS
from mapdata.search.api import (
    BatchResult,
    SearchResult,
    astar,
    bfs,
    check_path,
    distance_field,
    search_batch,
)
from mapdata.search.footprint import clearance, clearances, inflate, inflate_all, least_squared
from mapdata.search.kernels import count_moves, write_cells
from mapdata.search.labels import Labels, SearchLabels, label
from mapdata.search.lattice import (
    MAX_CELLS,
    WALL,
    Lattice,
    Rule,
    cell_at,
    hardness,
    heuristic,
    heuristics,
    in_cells,
    is_legal,
    lattice_of,
    load,
    position,
    rule_of,
)
from mapdata.search.taut import pull_taut

__all__ = [
    "MAX_CELLS",
    "STEPS",
    "WALL",
    "BatchResult",
    "Labels",
    "Lattice",
    "Rule",
    "SearchLabels",
    "SearchResult",
    "astar",
    "bfs",
    "cell_at",
    "check_path",
    "clearance",
    "clearances",
    "count_moves",
    "distance_field",
    "hardness",
    "heuristic",
    "heuristics",
    "in_cells",
    "inflate",
    "inflate_all",
    "is_legal",
    "label",
    "lattice_of",
    "least_squared",
    "load",
    "position",
    "pull_taut",
    "rule_of",
    "search_batch",
    "write_cells",
]
