"""Believed: between all and nothing, as the variance asks, and what is left out is expected as an error."""

from __future__ import annotations

import numpy as np
import pytest
from simulated import simulated

from mavdem import Settings, learn
from mavdem.dem.forecast.shrinkage import DOUBLING_DEVIATION, expected_error, prior_variance, shrunk

ONE = np.ones((1, 1))


def test_a_certain_forecast_is_kept_and_an_uncertain_one_is_shrunk():
    deviation = np.array([[2.0]])
    assert shrunk(deviation, 0 * ONE, ONE) == 2.0
    assert expected_error(deviation, 0 * ONE, ONE) == 0.0
    for variance in (1e12, np.inf):
        assert shrunk(deviation, variance * ONE, ONE) == pytest.approx(0.0, abs=1e-9)
        assert expected_error(deviation, variance * ONE, ONE) == pytest.approx(1.0)
    assert shrunk(np.inf * ONE, np.inf * ONE, ONE) == 0.0


def test_near_the_trim_it_is_the_mean_of_a_gaussian_posterior():
    """Of a deviation of variance S beforehand, seen with an error of variance V."""
    rng = np.random.default_rng(0)
    S, V = 1e-4, 5e-5
    true = rng.standard_normal((200_000, 1)) * np.sqrt(S)
    seen = true + rng.standard_normal(true.shape) * np.sqrt(V)
    slope = float((true * seen).sum() / (seen**2).sum())
    ours = shrunk(seen, np.full_like(seen, V), np.full_like(seen, S))
    near = np.abs(seen) < 0.3 * DOUBLING_DEVIATION * np.sqrt(S)
    np.testing.assert_allclose((ours / seen)[near], slope, atol=0.03)


def test_larger_deviations_are_shrunk_more():
    deviation = np.linspace(0.5, 60, 50)[:, None]
    share = shrunk(deviation, 0.3 * np.ones_like(deviation), np.ones_like(deviation)) / deviation
    assert (np.diff(share, axis=0) < 0).all() and share[-1] < 0.05


def test_what_the_motors_are_asked_for_is_the_size_of_what_may_come():
    inputs = np.vstack([0.1 * np.ones((3, 2)), 4.0 * np.ones((2, 2))])
    np.testing.assert_array_equal(prior_variance(inputs, 3)[:, 0], [1, 1, 1, 16, 16])
    np.testing.assert_allclose(prior_variance(inputs, 5)[:, 0], (3 * 0.01 + 2 * 16) / 5)
    assert prior_variance(inputs[:0], 5).shape == (0, 1)
    wide, narrow = (shrunk(8 * ONE, 0.5 * ONE, size * ONE) for size in (16.0, 1.0))
    assert wide > 2 * narrow


@pytest.mark.slow
def test_bands_hold_livelier_flights_than_those_learnt_from():
    """Of a made-up vehicle in wind whose motors work three times as hard after training: it does not hover still."""
    inside, better = [], []
    for seed in range(6):
        flight = simulated(wind=0.5, lag=0.05, seed=seed)
        learned = learn(flight[:700], Settings(order=3, window=9, parameter_precision=1.0))
        lively = simulated(wind=0.5, lag=0.05, seed=seed, liveliness=3.0)
        later = learned.forecast(lively.inputs[700:])
        measured = lively.outputs[700:]
        inside.append(np.mean(np.abs(measured - later) <= learned.forecast_band(lively.inputs[700:])))
        better.append(np.mean((measured - later) ** 2) / np.mean((measured - flight.outputs[:700].mean(axis=0)) ** 2))
    assert np.mean(inside) > 0.75 and np.median(better) < 0.3
