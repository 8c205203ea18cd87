"""Export of training problems: the fields of a dataset as arrays, Parquet, or another layout."""

from mapdata.export.about import verify_export
from mapdata.export.layouts import LAYOUTS, Layout, LayoutArray
from mapdata.export.problems import export_problems
from mapdata.limits import PROBLEM_FORMATS

__all__ = [
    "LAYOUTS",
    "PROBLEM_FORMATS",
    "Layout",
    "LayoutArray",
    "export_problems",
    "verify_export",
]
