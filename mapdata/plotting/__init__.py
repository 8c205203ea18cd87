"""Figures of maps, datasets and the outputs of models, and the report page."""

from typing import TYPE_CHECKING

from mapdata.aliases import former_names
from mapdata.plotting.comparison import plot_planners
from mapdata.plotting.figures import plot_distributions, plot_gallery
from mapdata.plotting.html_report import report
from mapdata.plotting.plot import (
    COLOURS,
    MARKERS,
    PALETTE,
    STYLE,
    plot_ends,
    plot_grid,
    plot_map,
    plot_matrix,
    plot_path,
    write_figure,
)
from mapdata.plotting.plot_models import plot_prediction, plot_roadmap, plot_sample
from mapdata.plotting.search_figures import plot_search

__all__ = [
    "COLOURS",
    "MARKERS",
    "PALETTE",
    "STYLE",
    "plot_distributions",
    "plot_ends",
    "plot_gallery",
    "plot_grid",
    "plot_map",
    "plot_matrix",
    "plot_path",
    "plot_planners",
    "plot_prediction",
    "plot_roadmap",
    "plot_sample",
    "plot_search",
    "report",
    "write_figure",
]

if not TYPE_CHECKING:
    __getattr__ = former_names(
        __name__,
        {
            "plot_figure": "figures",
        },
    )
