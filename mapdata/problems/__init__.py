"""What is asked of a map: problems sampled at random or read, and the symmetries of a map. Nothing
here needs torch.
"""

from mapdata.problems.problem_set import HARD, Problems
from mapdata.problems.sources import Pairs, Random, Route, Source

__all__ = [
    "HARD",
    "Pairs",
    "Problems",
    "Random",
    "Route",
    "Source",
]
