"""Intervals are those of scipy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import binomtest, bootstrap

from mapdata.arrays import Floats
from mapdata.describe import Estimate
from mapdata.describe.intervals import confidence_intervals, share_of


@pytest.mark.parametrize(
    ("part", "whole"), [(0, 1), (1, 1), (0, 300), (300, 300), (1, 300), (9, 20), (12345, 10**6)]
)
def test_the_interval_of_a_share_is_wilsons(part: int, whole: int) -> None:
    """And it holds the share."""
    share = share_of(part, whole)
    expected = binomtest(part, whole).proportion_ci(method="wilson")
    assert share.value == part / whole
    assert share.low == pytest.approx(expected.low, abs=1e-12)
    assert share.high == pytest.approx(expected.high, abs=1e-12)
    assert 0 <= share.low <= share.value <= share.high <= 1


def test_a_share_of_nothing_is_unknown() -> None:
    """It has no value."""
    assert all(math.isnan(number) for number in share_of(0, 0))
    assert Estimate._fields == ("value", "low", "high")


def test_the_interval_of_a_mean_is_that_of_a_bootstrap() -> None:
    """Up to the resamples, which are others."""
    outcomes = np.random.default_rng(1).exponential(size=(300, 2)) * (1, 50)
    values, lows, highs = confidence_intervals(outcomes, lambda means: means)
    np.testing.assert_allclose(values, outcomes.mean(axis=0))
    expected = bootstrap(
        (outcomes,), np.mean, n_resamples=4000, method="percentile", random_state=2
    ).confidence_interval
    widths = expected.high - expected.low
    np.testing.assert_allclose((lows - expected.low) / widths, 0, atol=0.1)
    np.testing.assert_allclose((highs - expected.high) / widths, 0, atol=0.1)


def test_metrics_that_are_undefined_have_no_interval() -> None:
    """Nothing warns, and a resample in which a metric is undefined is left out."""
    outcomes = np.array([[0.0, 1.0], [0.0, 0.0]])

    def inverse(means: Floats) -> Floats:
        inverses: Floats = np.divide(1, means, out=np.full_like(means, np.nan), where=means > 0)
        return inverses

    values, lows, highs = confidence_intervals(outcomes, inverse)
    np.testing.assert_array_equal(values, [np.nan, 2])
    np.testing.assert_array_equal(lows, [np.nan, 1])
    np.testing.assert_array_equal(highs, [np.nan, 2])
