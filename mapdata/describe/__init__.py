"""Describing datasets: statistics of maps and problems, the card, and tables with a row a map."""

from mapdata.describe.dataset_card import card
from mapdata.describe.intervals import Estimate
from mapdata.describe.problem_statistics import ProblemStatistics
from mapdata.describe.statistics import DatasetStatistics, dataset_statistics

__all__ = [
    "DatasetStatistics",
    "Estimate",
    "ProblemStatistics",
    "card",
    "dataset_statistics",
]
