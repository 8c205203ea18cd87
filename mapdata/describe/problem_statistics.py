"""`ProblemStatistics`: whether problems need a planner, and whether their targets are unique."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from mapdata.arrays import Array, Flags, Floats, Ints
from mapdata.describe.intervals import Estimate, confidence_intervals, share_of
from mapdata.search.lattice import HARD


@dataclass(frozen=True)
class ProblemStatistics:
    """What the problems that a dataset serves are worth, measured on a sample of them.

    Each `Estimate` is a number with its 95 % interval: the Wilson score interval of a share, and
    the percentile interval of 1,000 resamples of a mean. Problems without a path count in
    ``sample``, ``without_path`` and the maps alone.

    Attributes:
        served: which problems were measured, in words: their source, movement, split and radius.
        problems: number of problems of the dataset.
        sample: n, number of problems of the sample.
        without_path: how many of the sample have no path.
        no_detour: share of problems whose shortest path costs exactly the heuristic. They need no
            planner, for walking straight towards the goal solves them. None on terrain, where the
            heuristic is far below nearly all costs.
        hard: share of problems whose cost is at least 1.05 times the heuristic; None on terrain.
        single_path: share of problems with one shortest path.
        few_paths: share of problems with 2 to 9 shortest paths.
        many_paths: share of problems with 10 or more shortest paths.
        optimal_cells: cells on any shortest path for each cell of one shortest path, in the mean
            over the problems. It is 1 where there is one shortest path. The path that is served is
            one of all shortest paths, so that a network cannot know which cells of the others it
            is to leave out. The fields ``optimal_mask`` and ``optimal_moves`` hold all of them.
        expansions: cells that A* expands for each cell of the path, in the mean.
        replaced: share of problems that are on another map than their own, because that one has
            none that meets the conditions; None for stored problems and problem sets, which are
            never replaced.
        maps: number of different maps of the sample.
        maps_up_to_symmetry: the same, where turned and mirrored copies count as one map.
        most_on_one_map: largest number of problems of the sample on one map.
    """

    served: str
    problems: int
    sample: int
    without_path: int
    no_detour: Estimate | None
    hard: Estimate | None
    single_path: Estimate
    few_paths: Estimate
    many_paths: Estimate
    optimal_cells: Estimate
    expansions: Estimate
    replaced: Estimate | None
    maps: int
    maps_up_to_symmetry: int
    most_on_one_map: int

    @classmethod
    def measure(
        cls,
        *,
        served: str,
        problems: int,
        has_terrain: bool,
        is_drawn: bool,
        hardness: Floats,
        path_counts: Ints,
        lengths: Ints,
        optimal_cells: Ints,
        expansions: Ints,
        is_replaced: Flags,
        digests: Array,
        symmetric_digests: Array,
    ) -> ProblemStatistics:
        """Return the statistics of n problems.

        Args:
            served: as the attribute.
            problems: as the attribute.
            has_terrain: whether the maps have terrain, so that the hardness says nothing.
            is_drawn: whether the problems are drawn, so that they may be replaced.
            hardness: (n,) cost over heuristic, -1 without a path.
            path_counts: (n,) number of shortest paths, 0 without one; 10 stands for 10 or more.
            lengths: (n,) number of cells of the path.
            optimal_cells: (n,) number of cells on any shortest path.
            expansions: (n,) number of cells that A* expanded.
            is_replaced: (n,) whether the problem is on another map than its own.
            digests: (n,) hashes of the maps.
            symmetric_digests: (n,) hashes of the maps that are equal for their symmetric images.
        """
        has_path = path_counts > 0
        solved = int(has_path.sum())

        def share(is_member: Flags) -> Estimate:
            return share_of(int(is_member.sum()), solved)

        ratios = np.stack([optimal_cells, expansions], axis=1)[has_path] / lengths[has_path, None]
        cells_ratio, expansion_ratio = confidence_intervals(ratios, lambda means: means).T
        no_detour, hard = None, None
        if not has_terrain:  # On terrain, nearly all problems have a detour and are hard.
            no_detour, hard = share(hardness == 1), share(hardness >= HARD)
        _, problems_on_map = np.unique(digests, return_counts=True)
        return cls(
            served=served,
            problems=problems,
            sample=len(path_counts),
            without_path=len(path_counts) - solved,
            no_detour=no_detour,
            hard=hard,
            single_path=share(path_counts == 1),
            few_paths=share((path_counts > 1) & (path_counts < 10)),
            many_paths=share(path_counts >= 10),
            optimal_cells=Estimate(*cells_ratio.tolist()),
            expansions=Estimate(*expansion_ratio.tolist()),
            replaced=share_of(int(is_replaced.sum()), len(is_replaced)) if is_drawn else None,
            maps=len(problems_on_map),
            maps_up_to_symmetry=len(np.unique(symmetric_digests)),
            most_on_one_map=int(problems_on_map.max(initial=0)),
        )

    def __repr__(self) -> str:
        """Return a table as text, a statistic to a line."""
        rows = {"problems": self.served, **dict(self.rows())}
        width = max(map(len, rows)) + 2
        return "\n".join(f"{name + ':':{width}}{text}" for name, text in rows.items())

    def target_text(self) -> str:
        """Return what a path is worth as a target, in words: the fields that hold all answers."""
        if math.isnan(self.single_path.value):
            return "No problem of the sample has a path."
        if self.single_path.value == 1:
            return "All measured problems have one shortest path: it is the only right answer."
        return (
            f"{self.single_path.value:.1%} of the problems have one shortest path. Of the others, "
            "the path, and so path_mask, is one of several right answers; the fields optimal_mask "
            "and optimal_moves hold all of them."
        )

    def rows(self) -> Iterator[tuple[str, str]]:
        """Yield the name and the text of each statistic, beginning with the size of the sample."""
        yield "measured", self._sample_text()
        shares = {
            "no detour, cost = heuristic": self.no_detour,
            f"hard, cost >= {HARD:g} heuristic": self.hard,
            "one shortest path": self.single_path,
            "2 to 9 shortest paths": self.few_paths,
            "10 or more shortest paths": self.many_paths,
        }
        ratios = {
            "cells on any shortest path / path": self.optimal_cells,
            "expansions of A* / path": self.expansions,
        }
        for name, share in shares.items():
            if share is not None:
                yield name, share_text(share)
        for name, ratio in ratios.items():
            yield name, ratio_text(ratio)
        if self.replaced is not None:
            yield "on another map than their own", share_text(self.replaced)
        yield (
            "different maps",
            f"{self.maps:,} ({self.maps_up_to_symmetry:,} up to symmetry), most problems on one "
            f"map: {self.most_on_one_map:,}",
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the statistics as plain values for JSON: an interval as [value, low, high].

        What is not known, NaN in an `Estimate`, is None.
        """
        values: dict[str, Any] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, Estimate):
                value = [None if math.isnan(number) else round(number, 6) for number in value]
            values[field.name] = value
        return values

    def _sample_text(self) -> str:
        """Return how many problems were measured, in words."""
        which = f"all {self.problems:,}"
        if self.sample < self.problems:
            which = f"{self.sample:,} of {self.problems:,}, evenly spaced"
        if self.without_path:
            which += f"; {self.without_path:,} of them have no path and count for the maps alone"
        return f"{which} (with 95 % intervals)"


def share_text(share: Estimate) -> str:
    """Return a share with its interval in percent; "unknown" if nothing was measured."""
    if math.isnan(share.value):
        return "unknown"
    return f"{share.value:.1%} ({share.low:.1%} to {share.high:.1%})"


def ratio_text(ratio: Estimate) -> str:
    """Return a ratio with its interval; "unknown" if nothing was measured."""
    if math.isnan(ratio.value):
        return "unknown"
    return f"{ratio.value:.2f} ({ratio.low:.2f} to {ratio.high:.2f})"
