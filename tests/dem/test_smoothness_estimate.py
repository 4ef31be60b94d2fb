"""The smoothness of the noise, estimated by its free energy."""

import calibration
import numpy as np
import pytest

from mavdem.dem.engine.coordinates import (
    embed,
    sampled_output_precision,
    sampled_state_precision,
)
from mavdem.dem.fitting import estimate_smoothness
from mavdem.dem.record import Record

DT = 0.01


def record(ratio, seed, wind=1.0, samples=6000):
    """A roll axis in wind whose smoothness is ``ratio`` sampling steps."""
    theta = calibration.theta_of(calibration.VEHICLE)
    rng = np.random.default_rng(seed)
    outputs, inputs = calibration.flight(theta, wind, ratio * DT, samples, DT, rng)
    return Record(inputs, outputs, DT, (samples,))


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.7, 2, 10])
def test_smoothness_is_recovered_over_more_than_a_tenfold_range(ratio):
    estimates = [estimate_smoothness(record(ratio, seed)).smoothness / DT for seed in range(2)]
    np.testing.assert_allclose(estimates, ratio, rtol=0.15)


@pytest.mark.slow
def test_its_interval_holds_it_as_often_as_it_says():
    ratio, flights = 3, 20
    estimates = [estimate_smoothness(record(ratio, seed, samples=3000)) for seed in range(flights)]
    inside = [low <= ratio * DT <= high for low, high in (estimate.interval(0.9) for estimate in estimates)]
    # Three standard errors of a share of 0.9 among so many.
    assert np.mean(inside) > 0.9 - 3 * np.sqrt(0.9 * 0.1 / flights)
    scatter = np.std(np.log([estimate.smoothness for estimate in estimates]))
    # A standard deviation is known to 1/√(2N).
    assert scatter == pytest.approx(np.mean([estimate.log_sd for estimate in estimates]), rel=4 / np.sqrt(2 * flights))


def test_the_free_energy_is_highest_where_it_says_and_flatter_with_less_data():
    long, short = (estimate_smoothness(record(2, 0, samples=samples)) for samples in (6000, 1500))
    assert long.tried[np.argmax(long.free_energy)] == pytest.approx(long.smoothness)
    assert (np.diff(long.tried) > 0).all()
    # Four times the samples tell four times as much.
    assert short.log_sd / long.log_sd == pytest.approx(2, rel=0.2)


def test_noise_that_is_white_to_the_samples_is_said_to_be():
    rng = np.random.default_rng(0)
    outputs = rng.standard_normal((2000, 1))
    inputs = np.sin(0.05 * np.arange(2000))[:, None]
    estimate = estimate_smoothness(Record(inputs, outputs, DT, (2000,)))
    assert estimate.smoothness < 1.0 * DT


@pytest.mark.slow
@pytest.mark.parametrize("window", [3, 7])
@pytest.mark.parametrize("ratio", [0.5, 4.0])
def test_noise_as_it_is_read_has_the_covariance_that_is_claimed(ratio, window):
    """Of z on samples, and of w through what it drives; by simulation at a fiftieth of the step."""
    fine, number = 50, 40_000
    noise = calibration.coloured(ratio * DT, DT / fine, number * fine, np.random.default_rng(1))
    read = embed(noise[::fine, None], 2, DT, window, window // 2)
    driven = np.concatenate([[0.0], np.cumsum((noise[1:] + noise[:-1]) / 2)]) * DT / fine
    through = embed(driven[::fine, None], 2, DT, window, window // 2)[:, 1:]
    independent = number / max(1.0, 2.5 * ratio + window)
    for samples, precision in (
        (read, sampled_output_precision(2, ratio * DT, DT, window)),
        (through, sampled_state_precision(1, ratio * DT, DT, window)),
    ):
        # Whitened, the covariance is the identity, to within five standard errors of a variance.
        factor = np.linalg.cholesky(precision)
        whitened = samples @ factor
        covariance = whitened.T @ whitened / len(whitened)
        np.testing.assert_allclose(covariance, np.eye(len(precision)), atol=5 * np.sqrt(2 / independent))
