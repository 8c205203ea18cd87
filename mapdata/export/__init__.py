"""Export of training problems: the fields of a dataset as arrays, Parquet, or another layout."""

from typing import TYPE_CHECKING

from mapdata.aliases import former_names
from mapdata.export.about import verify_export
from mapdata.export.problems import export_problems
from mapdata.limits import PROBLEM_FORMATS

__all__ = [
    "PROBLEM_FORMATS",
    "export_problems",
    "verify_export",
]

if not TYPE_CHECKING:
    __getattr__ = former_names(
        __name__,
        {
            "LAYOUTS": "layouts",
            "Layout": "layouts",
            "LayoutArray": "layouts",
        },
    )
