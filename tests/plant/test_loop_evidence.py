"""The plant in its loop as one generative model, against the dense Gaussian of a short record."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from loop_samples import CONTROLLER, DT, dense_covariance, prior_mean, simulated

from mavdem.arrays import Array
from mavdem.dem.engine.free_energy import Term
from mavdem.dem.engine.gauss_newton import QuadraticExpansion
from mavdem.plant.closed_loop.evidence import LoopData, LoopPosterior
from mavdem.plant.closed_loop.free_energy import loop_free_energy
from mavdem.plant.closed_loop.state_space import (
    NAMES,
    STATES,
    GenerativeParameters,
    State,
    continuous_loop,
    sampled_loop,
    setpoint_process_covariance,
    unknown_controller,
)


class DenseRecord(NamedTuple):
    """A short record with the dense Gaussian of its samples under the loop."""

    posterior: LoopPosterior
    theta: Array
    samples: Array
    covariance: Array
    """(3 T, 3 T) covariance of the samples, with measurement noise and trims."""
    noise_variance: Array
    """(3 T,) variances of the measurement noise."""
    by_setpoint: Array
    """(3 T, 3 T) part of the covariance that the setpoint causes."""

    @property
    def weighted(self) -> Array:
        """Samples (3 T,) times the inverse of their covariance."""
        return np.linalg.solve(self.covariance, self.samples)


@pytest.fixture(scope="module")
def dense() -> DenseRecord:
    """30 samples of a closed loop, with their covariance matrix by the dense formula."""
    samples = 30
    data = LoopData.from_samples([simulated(samples, seed=1)], DT)
    posterior = LoopPosterior(data, CONTROLLER)
    theta = posterior.prior.mean + 0.1 * np.cos(np.arange(len(NAMES)))
    loop = sampled_loop(theta, CONTROLLER, DT)
    noise_variance = np.tile(loop.noise_variance, samples)
    covariance = dense_covariance(loop, loop.stationary_covariance, samples)
    covariance += np.diag(noise_variance)
    covariance += np.kron(np.ones((samples, samples)), data.trim_covariance)
    _, setpoint_start = setpoint_process_covariance(theta, CONTROLLER, DT, loop.state_sd)
    by_setpoint = dense_covariance(loop, setpoint_start, samples)
    centred = data.segments[0].ravel()
    return DenseRecord(posterior, theta, centred, covariance, noise_variance, by_setpoint)


def log_density(record: DenseRecord) -> float:
    """Returns the log density of a record's samples by their dense covariance."""
    log_determinant = np.linalg.slogdet(2 * np.pi * record.covariance)[1]
    return -0.5 * float(log_determinant + record.samples @ record.weighted)


@pytest.mark.slow
def test_likelihood_is_that_of_the_dense_gaussian(dense: DenseRecord) -> None:
    (segment,) = dense.posterior.likelihoods(dense.theta[None])
    np.testing.assert_allclose(segment.log_likelihood, log_density(dense), rtol=1e-7)


def test_terms_are_those_of_the_dense_gaussian(dense: DenseRecord) -> None:
    """The terms of the free energy, which filters compute, equal those of the dense covariance."""
    curvature = np.eye(len(NAMES)) + 0.1
    maximum = QuadraticExpansion(dense.theta, 0.0, np.zeros(len(NAMES)), curvature)
    result = loop_free_energy(dense.posterior, maximum)
    weighted = dense.weighted
    output_squares = weighted**2 @ dense.noise_variance
    input_squares = weighted @ dense.by_setpoint @ weighted
    all_squares = dense.samples @ weighted
    noise_log_determinant = np.log(dense.noise_variance).sum()
    log_determinant = np.linalg.slogdet(dense.covariance)[1]
    expected = {
        Term.PREDICTION_ERROR_OF_OUTPUTS: -0.5 * output_squares,
        Term.PREDICTION_ERROR_OF_INPUTS: -0.5 * input_squares,
        Term.PREDICTION_ERROR_OF_STATES: -0.5 * (all_squares - output_squares - input_squares),
        Term.NOISE_ENTROPY: -0.5 * np.log(2 * np.pi * dense.noise_variance).sum(),
        Term.STATE_AND_INPUT_ENTROPY: 0.5 * (noise_log_determinant - log_determinant),
    }
    for name, value in expected.items():
        assert result.terms[name] == pytest.approx(value, rel=1e-5), name
    deviations = (dense.theta - dense.posterior.prior.mean) / dense.posterior.prior.sd
    laplace = (
        log_density(dense)
        - 0.5 * deviations @ deviations
        - np.log(dense.posterior.prior.sd).sum()
        - 0.5 * np.linalg.slogdet(curvature)[1]
    )
    assert result.total == pytest.approx(laplace, rel=1e-7)
    assert result.free_energy_of_samples.sum() == pytest.approx(result.total, rel=1e-12)


@pytest.fixture(scope="module")
def flight() -> LoopPosterior:
    segments = [simulated(80, seed=2), simulated(60, seed=3)]
    return LoopPosterior(LoopData.from_samples(segments, DT), CONTROLLER)


@pytest.mark.slow
def test_gradient_and_curvature_are_those_of_finite_differences(flight: LoopPosterior) -> None:
    theta = flight.prior.mean
    expansion = flight.expand(theta)
    for name in ("effect", "p", "setpoint_time", "filtered_noise"):
        index = NAMES.index(name)
        step = 1e-2 * np.eye(len(NAMES))[index]
        above, below = flight.value(theta + step), flight.value(theta - step)
        curvature = (2 * expansion.value - above - below) / 1e-4
        assert expansion.gradient[index] == pytest.approx((above - below) / 2e-2, abs=0.5), name
        # The Fisher information is the expected curvature, which that of a record scatters about.
        assert expansion.curvature[index, index] == pytest.approx(curvature, rel=0.4), name


@pytest.mark.slow
def test_free_energy_in_other_units_differs_by_their_jacobian(flight: LoopPosterior) -> None:
    scale = 250.0
    segments = [segment * [1.0, 1.0, scale] for segment in flight.data.segments]
    scaled = LoopPosterior(LoopData.from_samples(segments, DT), unknown_controller(0.05 * scale))
    shift = scaled.prior.mean - flight.prior.mean
    theta = flight.prior.mean
    value = flight.value(theta)
    samples = flight.data.sample_count
    assert scaled.value(theta + shift) == pytest.approx(value - samples * np.log(scale), rel=1e-6)


def test_unstable_loop_has_no_likelihood(flight: LoopPosterior) -> None:
    theta = flight.prior.mean.copy()
    theta[NAMES.index("effect")] += np.log(1e3)
    assert np.isnan(flight.value(theta))


def test_wind_moves_the_rate_by_the_plant_over_one_plus_the_loop_gain() -> None:
    """The response of the rate to the wind torque at 2 Hz equals plant / (1 + loop gain), with all filters by hand."""
    parameters = GenerativeParameters(*np.exp(prior_mean()))
    loop = continuous_loop(parameters, CONTROLLER)
    eddy_source = 4
    s = 2j * np.pi * 2.0
    states = np.linalg.solve(s * np.eye(STATES) - loop.A, loop.noise_gains[:, eddy_source])
    torque = parameters.eddy_size * states[State.EDDY]

    delay = parameters.delay * s
    dead_time = 1 - delay / (1 + delay / 2 + delay**2 / 12)
    cutoff_ratio = s / (2 * np.pi * parameters.gyro_cutoff)
    gyro = 1 / (1 + np.sqrt(2) * cutoff_ratio + cutoff_ratio**2)
    target = 1 / (1 + s / (2 * np.pi * parameters.target_cutoff))
    derivative = s / (1 + s / (2 * np.pi * parameters.derivative_cutoff))
    from_setpoint = parameters.p * (1 + parameters.integral_ratio / s)
    from_rate = from_setpoint + parameters.p * parameters.derivative_ratio * derivative
    plant = 1 / (s + parameters.damping)
    actuation = parameters.effect * dead_time / (parameters.lag * s + 1)
    from_angle = from_setpoint * target * parameters.angle_gain / s
    loop_gain = plant * actuation * (from_rate * gyro + from_angle)
    expected = plant / (1 + loop_gain)
    np.testing.assert_allclose(states[State.RATE] / torque, expected, rtol=1e-9)
