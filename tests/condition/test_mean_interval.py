"""Intervals of means: they contain the truth as often as they claim, also where neighbours are correlated."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from mavdem.condition.condition import LEVEL, mean_interval

SECONDS, RATE, SERIES = 60.0, 10.0, 1000


@pytest.mark.parametrize("correlation_seconds", [0.0, 1.0])
def test_the_interval_contains_the_mean_as_often_as_it_claims(correlation_seconds):
    pole = np.exp(-1 / (RATE * correlation_seconds)) if correlation_seconds else 0.0
    noise = np.random.default_rng(3).standard_normal((int(1.5 * SECONDS * RATE), SERIES))
    series = lfilter([1.0], [1.0, -pole], noise, axis=0)[-int(SECONDS * RATE) :] + 5.0
    inside = float((np.abs(series.mean(axis=0) - 5.0) <= mean_interval(series, SECONDS)).mean())
    # Four standard errors of a share of so many series; correlation costs a few per cent.
    assert LEVEL - 0.04 - 4 * np.sqrt(0.09 / SERIES) <= inside <= LEVEL + 4 * np.sqrt(0.09 / SERIES)


def test_a_rate_ten_times_as_high_makes_the_interval_no_narrower_where_it_adds_nothing():
    slow = np.random.default_rng(4).standard_normal((600, 20))
    often = np.repeat(slow, 10, axis=0)
    np.testing.assert_allclose(mean_interval(often, 60.0), mean_interval(slow, 60.0), rtol=1e-3)


def test_a_series_too_short_has_no_interval():
    assert np.isinf(mean_interval(np.arange(8.0)[:, None], 8.0)).all()
