"""What is asked of a map: problems drawn at random or read, and the symmetries of a map. Nothing here needs torch."""

from mapdata.problems.problem_set import HARD, Problems

__all__ = [
    "HARD",
    "Problems",
]
