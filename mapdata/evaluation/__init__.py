"""Comparing planners: one table for anything that plans, and the classical rows."""

from mapdata.describe.intervals import confidence_intervals
from mapdata.evaluation.guided import CostPlanner, GuidedSearch, prior
from mapdata.evaluation.metrics import (
    METRICS,
    TERRAIN_METRICS,
    TIMES,
    evaluate,
    median_interval,
    score_paths,
    to_text,
    with_interval,
)
from mapdata.evaluation.plan import Batched, BatchPlanner, Plan, Planner
from mapdata.evaluation.planners import (
    BestFirst,
    GoalFieldAstar,
    JumpPointSearch,
    LandmarkAstar,
    Limit,
    Search,
    classical,
)
from mapdata.evaluation.suite import (
    SUITE_MOVEMENT,
    SUITES,
    Part,
    evaluate_suite,
    suite_summary,
    suite_to_text,
)

__all__ = [
    "METRICS",
    "SUITES",
    "SUITE_MOVEMENT",
    "TERRAIN_METRICS",
    "TIMES",
    "BatchPlanner",
    "Batched",
    "BestFirst",
    "CostPlanner",
    "GoalFieldAstar",
    "GuidedSearch",
    "JumpPointSearch",
    "LandmarkAstar",
    "Limit",
    "Part",
    "Plan",
    "Planner",
    "Search",
    "classical",
    "confidence_intervals",
    "evaluate",
    "evaluate_suite",
    "median_interval",
    "prior",
    "score_paths",
    "suite_summary",
    "suite_to_text",
    "to_text",
    "with_interval",
]
