"""Describing datasets: statistics of their maps, the dataset card, and tables with a row a map."""

from mapdata.describe.dataset_card import card
from mapdata.describe.statistics import DatasetStatistics, dataset_statistics

__all__ = ["DatasetStatistics", "card", "dataset_statistics"]
