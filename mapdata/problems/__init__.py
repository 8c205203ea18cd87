"""Problems on maps: their sources, fixed sets of them, and symmetries. Without torch."""

from typing import TYPE_CHECKING

from mapdata.aliases import former_names
from mapdata.problems.problem_set import ProblemSet
from mapdata.problems.sampling import sample_problems
from mapdata.problems.sources import Pairs, Random, Route, SourceLike
from mapdata.search.lattice import HARD

__all__ = [
    "HARD",
    "Pairs",
    "ProblemSet",
    "Random",
    "Route",
    "SourceLike",
    "sample_problems",
]

if not TYPE_CHECKING:
    __getattr__ = former_names(
        __name__,
        {
            "Source": "sources",
        },
    )
