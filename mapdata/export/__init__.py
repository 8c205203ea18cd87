"""Export of training problems: the fields of a dataset as arrays, Parquet, or another layout."""

from mapdata.export.layouts import LAYOUTS, Layout, LayoutArray
from mapdata.export.problems import PROBLEM_FORMATS, export_problems

__all__ = ["LAYOUTS", "PROBLEM_FORMATS", "Layout", "LayoutArray", "export_problems"]
