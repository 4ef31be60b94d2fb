"""The vector autoregression against least squares, and its paths against conditioning of the whole Gaussian at once."""

from itertools import product

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import mark

from mavdem import Flight
from mavdem.dem.forecast.lag_regression import (
    RIDGE,
    ChannelScaling,
    LagStatistics,
    lag_prior_precision,
    latest_samples,
    regress,
)
from mavdem.dem.forecast.var import VectorAutoregression
from mavdem.dem.record import Record

OUTPUTS = 2
INPUTS = 3
LAGS = 3
STEPS = 12
CHANNELS = OUTPUTS + INPUTS


def model():
    rng = default_rng(0)
    root = rng.standard_normal((CHANNELS, CHANNELS))
    return VectorAutoregression(
        coefficients=0.12 * rng.standard_normal((LAGS, CHANNELS, CHANNELS)),
        offset=rng.standard_normal(CHANNELS),
        innovation_covariance=root @ root.T,
        scaling=ChannelScaling(np.zeros(CHANNELS), np.ones(CHANNELS)),
    )


def run(true, samples, seed=1):
    rng = default_rng(seed)
    root = np.linalg.cholesky(true.innovation_covariance)
    channels = np.zeros((samples, CHANNELS))
    for t in range(true.lags, samples):
        lagged = sum(A @ channels[t - 1 - lag] for lag, A in enumerate(true.coefficients))
        channels[t] = lagged + true.offset + root @ rng.standard_normal(CHANNELS)
    return channels


def fitted(segments):
    statistics = LagStatistics.from_segments(segments, LAGS)
    regression = regress(statistics.gram, statistics.row_count, lag_prior_precision(LAGS, RIDGE))
    k = regression.mean.shape[1]
    return VectorAutoregression.from_regression(regression, ChannelScaling(np.zeros(k), np.ones(k)))


def joint(true, past, steps):
    """Mean (H k,) and covariance (H k, H k) of all channels after the past, by the map of all innovations."""
    k = CHANNELS
    unrolled = np.eye(steps * CHANNELS)
    drive = np.tile(true.offset, steps)
    for t in range(steps):
        for lag, A in enumerate(true.coefficients, 1):
            rows = slice(t * k, (t + 1) * k)
            if t >= lag:
                unrolled[rows, (t - lag) * k : (t - lag + 1) * k] -= A
            else:
                drive[rows] += A @ past[len(past) + t - lag]
    back = np.linalg.inv(unrolled)
    return back @ drive, back @ np.kron(np.eye(steps), true.innovation_covariance) @ back.T


def conditional_gaussian(
    mean,
    covariance,
    known_places,
    values,
    target_places,
):
    """Returns mean and variances of some entries of a Gaussian, given the values of others."""
    gain = covariance[np.ix_(target_places, known_places)] @ np.linalg.inv(
        covariance[np.ix_(known_places, known_places)]
    )
    conditional_covariance = (
        covariance[np.ix_(target_places, target_places)]
        - gain @ covariance[np.ix_(known_places, target_places)]
    )
    return mean[target_places] + gain @ (
        values - mean[known_places]
    ), conditional_covariance.diagonal()


@mark.slow
def test_predictions_filtering_and_smoothing_are_the_joint_gaussian_s_for_each_past():
    """Forecasts with unknown and with known inputs equal the conditional Gaussian that is computed directly."""
    true = model()
    samples = np.stack([run(true, LAGS + STEPS, seed) for seed in (1, 2)])
    pasts = samples[:, :LAGS]
    inputs = samples[:, LAGS:, OUTPUTS:]
    places = np.arange(STEPS * CHANNELS).reshape(STEPS, CHANNELS)
    predicted = true.forecast_unknown_inputs(pasts, STEPS)
    inferred = {
        smooth: true.forecast_known_inputs(pasts, inputs, smooth) for smooth in (False, True)
    }
    for number, past in enumerate(pasts):
        mean, covariance = joint(true, past, STEPS)
        assert_allclose(predicted.mean[number].ravel(), mean, rtol=1e-9)
        assert_allclose(predicted.variance[number].ravel(), covariance.diagonal(), rtol=1e-9)
        for smooth, step in product((False, True), range(STEPS)):
            known_steps = slice(STEPS if smooth else step + 1)
            known_places = places[known_steps, OUTPUTS:].ravel()
            target_places = places[step, :OUTPUTS]
            expected = conditional_gaussian(
                mean, covariance, known_places, inputs[number, known_steps].ravel(), target_places
            )
            assert_allclose(inferred[smooth].mean[number, step], expected[0], rtol=1e-6)
            assert_allclose(inferred[smooth].variance[number, step], expected[1], rtol=1e-6)


def test_inputs_that_are_constant_copied_or_mixed_change_nothing_and_may_move_later():
    """Further inputs without information are added to a flight: the forecasts hardly change."""
    samples = run(model(), 400)
    plain = fitted([samples])
    with_further_inputs = np.hstack(
        [samples, np.zeros((400, 1)), samples[:, 2:3], np.diff(samples[:, 2:4])]
    )
    autoregression = fitted([with_further_inputs])
    ahead = default_rng(3).standard_normal((40, INPUTS))
    wider = np.hstack([ahead, np.ones((40, 1)), ahead[:, :1], np.diff(ahead[:, :2])])
    for smooth in (False, True):
        expected = plain.forecast_known_inputs(samples[-LAGS:], ahead, smooth)
        forecast = autoregression.forecast_known_inputs(with_further_inputs[-LAGS:], wider, smooth)
        # The prior is of other coefficients, so that the posterior is not quite the same.
        assert_allclose(forecast.mean, expected.mean, atol=0.02 * expected.mean.std())
        assert_allclose(forecast.variance, expected.variance, rtol=0.02)
        # Motors that contradict what they always did.
        assert np.isfinite(
            autoregression.forecast_known_inputs(
                with_further_inputs[-LAGS:], wider[::-1] * wider, smooth
            ).mean
        ).all()


def test_what_overflows_is_the_training_mean_with_infinite_variance():
    growing = model()._replace(coefficients=1e30 * model().coefficients)
    samples = run(model(), LAGS + 40)
    for forecast in (
        growing.forecast_unknown_inputs(samples[:LAGS], 40),
        *(
            growing.forecast_known_inputs(samples[:LAGS], samples[LAGS:, OUTPUTS:], each)
            for each in (False, True)
        ),
    ):
        assert np.isfinite(forecast.mean).all()
        assert not np.isnan(forecast.variance).any()
        assert (forecast.mean[np.isinf(forecast.variance)] == 0).any()


def test_one_step_ahead_of_each_sample_is_the_mean_of_that_step():
    """All one-step predictions at once equal forecasts over one step from each sample."""
    true = model()
    samples = run(true, LAGS + 9)
    outputs, inputs = np.split(samples, [OUTPUTS], axis=1)
    ahead = true.one_step_predictions(
        Record.from_flights(Flight(np.arange(len(samples)) / 100, inputs, outputs))
    )
    for row in range(LAGS, len(samples)):
        (expected,) = true.forecast_known_inputs(
            samples[row - LAGS : row], inputs[row : row + 1], False
        ).mean
        assert_allclose(ahead[row], expected)


def test_a_past_shorter_than_the_lags_begins_with_its_first_sample():
    samples = run(model(), 5)
    assert_array_equal(latest_samples(samples, 3), samples[2:])
    assert_array_equal(latest_samples(samples[:2], 4), samples[[0, 0, 0, 1]])
