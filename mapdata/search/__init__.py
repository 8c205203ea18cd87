"""Shortest paths on maps: BFS, A*, distance fields, the path check, and the labels of the paper."""

from typing import TYPE_CHECKING

from mapdata.aliases import former_names
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
from mapdata.search.arguments import terrain_from_costs
from mapdata.search.footprint import clearance, inflate, inflate_terrain
from mapdata.search.free_lines import lines_are_free
from mapdata.search.labels import Labels, RouteLabels, label
from mapdata.search.lattice import hardness, move_rule
from mapdata.search.map_stack import MapStack
from mapdata.search.metres import to_metres
from mapdata.search.order import SearchOrder, search_order
from mapdata.search.taut import path_waypoints, pull_taut

__all__ = [
    "STEPS",
    "BatchResult",
    "Labels",
    "MapStack",
    "RouteLabels",
    "SearchOrder",
    "SearchResult",
    "astar",
    "bfs",
    "check_path",
    "clearance",
    "distance_field",
    "hardness",
    "inflate",
    "inflate_terrain",
    "label",
    "lines_are_free",
    "move_rule",
    "path_waypoints",
    "pull_taut",
    "search_batch",
    "search_order",
    "terrain_from_costs",
    "to_metres",
]

if not TYPE_CHECKING:
    __getattr__ = former_names(
        __name__,
        {
            "as_terrain": "arguments",
        },
    )
