"""Intervals of 95 %: of a share, and of anything that is computed from means."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mapdata.arrays import Floats

_DEVIATIONS = 1.959963984540054
"""95 % of a normal distribution are within so many standard deviations of its mean."""


class Estimate(NamedTuple):
    """A number that is known from a sample, with its 95 % interval.

    All three are NaN if the sample is empty.

    Attributes:
        value: of the sample.
        low: lower end of the interval.
        high: upper end of the interval.
    """

    value: float
    low: float
    high: float


def share_of(part: int, whole: int) -> Estimate:
    """Return the share ``part`` of ``whole``, with its Wilson score interval.

    Unlike a bootstrap, it has a width where none or all of a sample belong to the part. Wilson,
    "Probable inference, the law of succession, and statistical inference", JASA 22 (1927), 209-212.

    >>> [round(number, 4) for number in share_of(0, 300)]
    [0.0, 0.0, 0.0126]
    """
    if whole == 0:
        return Estimate(math.nan, math.nan, math.nan)
    share = part / whole
    weight = _DEVIATIONS**2 / whole
    middle = (share + weight / 2) / (1 + weight)
    half_width = math.sqrt(share * (1 - share) * weight + weight**2 / 4) / (1 + weight)
    # Rounding would put an end a hair outside of 0 to 1, or inside the share that it encloses.
    low = min(max(middle - half_width, 0.0), share)
    high = max(min(middle + half_width, 1.0), share)
    return Estimate(share, low, high)


def confidence_intervals(
    outcomes: Floats, metrics: Callable[[Floats], Floats], bootstrap: int = 1000, seed: int = 0
) -> Floats:
    """Return metrics of mean outcomes, with 95 % percentile intervals over resampled problems.

    Args:
        outcomes: (n, ..., C), C outcomes of n problems, perhaps with axes between for planners.
        metrics: function that computes M metrics (..., M) from mean outcomes (..., C); NaN where
            a metric is undefined.
        bootstrap: number of resamples, which consist of the same problems for all planners.
        seed: of the resamples.

    Returns:
        (3, ..., M): the metrics, the lower and the upper end of their intervals; NaN when n is 0.
    """
    n = len(outcomes)
    of_all_problems = metrics(outcomes.sum(axis=0) / max(n, 1))
    if n == 0:
        return np.full((3, *of_all_problems.shape), np.nan)
    generator = np.random.default_rng(seed)
    sums = np.empty((bootstrap, *outcomes.shape[1:]))
    for k in range(bootstrap):
        # The sum over a resample weights each problem by how often it is drawn. So the outcomes
        # need not be copied for each resample.
        times_drawn = np.bincount(generator.integers(n, size=n), minlength=n)
        sums[k] = np.tensordot(times_drawn, outcomes, 1)
    with warnings.catch_warnings():
        # A metric that is undefined in all resamples has no interval: NaN, without a warning.
        warnings.filterwarnings("ignore", "All-NaN slice", RuntimeWarning)
        ends = np.nanquantile(metrics(sums / n), [0.025, 0.975], axis=0)
    return np.concatenate([of_all_problems[None], ends])
