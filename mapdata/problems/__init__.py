"""Problems on maps: their sources, fixed sets of them, and symmetries. Without torch."""

from mapdata.problems.problem_set import ProblemSet
from mapdata.problems.sampling import sample_problems
from mapdata.problems.sources import Pairs, Random, Route, Source, SourceLike
from mapdata.search.lattice import HARD

__all__ = [
    "HARD",
    "Pairs",
    "ProblemSet",
    "Random",
    "Route",
    "Source",
    "SourceLike",
    "sample_problems",
]
