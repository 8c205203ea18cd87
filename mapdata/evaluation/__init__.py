"""Comparing planners: one table for anything that plans, and the classical rows."""

from typing import TYPE_CHECKING

from mapdata.aliases import former_names
from mapdata.describe.intervals import confidence_intervals
from mapdata.evaluation.guided import CostPlanner, GuidedSearch, prior
from mapdata.evaluation.metrics import (
    TIMES,
    evaluate,
    score_paths,
    to_text,
    with_interval,
)
from mapdata.evaluation.plan import Batched, BatchPlanner, Plan, Planner
from mapdata.evaluation.planners import (
    GoalFieldAstar,
    JumpPointSearch,
    LandmarkAstar,
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
    "SUITES",
    "SUITE_MOVEMENT",
    "TIMES",
    "BatchPlanner",
    "Batched",
    "CostPlanner",
    "GoalFieldAstar",
    "GuidedSearch",
    "JumpPointSearch",
    "LandmarkAstar",
    "Part",
    "Plan",
    "Planner",
    "classical",
    "confidence_intervals",
    "evaluate",
    "evaluate_suite",
    "prior",
    "score_paths",
    "suite_summary",
    "suite_to_text",
    "to_text",
    "with_interval",
]

if not TYPE_CHECKING:
    __getattr__ = former_names(
        __name__,
        {
            "BestFirst": "planners",
            "Limit": "planners",
            "METRICS": "metrics",
            "Search": "planners",
            "TERRAIN_METRICS": "metrics",
            "median_interval": "metrics",
        },
    )
