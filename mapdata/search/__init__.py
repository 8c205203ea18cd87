"""Solving maps: BFS, A*, distance fields, the path check, the labels of the paper. docs/format.md fixes their order."""

from mapdata.search.api import BatchResult, SearchResult, astar, bfs, check_path, distance_field, search_batch
from mapdata.search.labels import Labels, SearchLabels, label
from mapdata.search.lattice import MAX_CELLS, STEPS

__all__ = [
    "MAX_CELLS",
    "STEPS",
    "BatchResult",
    "Labels",
    "SearchLabels",
    "SearchResult",
    "astar",
    "bfs",
    "check_path",
    "distance_field",
    "label",
    "search_batch",
]
