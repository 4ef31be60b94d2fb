"""Forecasts of the plant in its loop, against the dense Gaussian of the samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from known_gains import ARDUPILOT, X_ROLL
from loop_samples import CONTROLLER, DT, dense_covariance, simulated
from refusals import refused

from mavdem.arrays import Array
from mavdem.baselines import ClosedLoop, closed_loop
from mavdem.dem.engine.gauss_newton import QuadraticExpansion
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable
from mavdem.experiments.methods.plant_in_loop import recorded_controller
from mavdem.facts.loops import LoopFact
from mavdem.loops.loop_construction import inputs_per_demand, logged_controller
from mavdem.plant.closed_loop.evidence import LoopData, LoopPosterior
from mavdem.plant.closed_loop.state_space import NAMES, sampled_loop, wind_torque_output

TRAINING = 25
"""Samples of the training data."""
HORIZON = 12
"""Samples that are forecast."""


@dataclass(frozen=True)
class ForecastCase:
    """A loop with known parameters, the samples after its training data, and the covariance of all samples."""

    model: ClosedLoop
    motors: Array
    outputs: Array
    samples: Array
    covariance: Array

    def conditional_mean(self, known_samples: Array, wanted: int) -> Array:
        """Returns angle and rate (2,) of sample ``wanted``, given the entries ``known`` of the flattened samples."""
        centred = (self.samples - self.model.posterior.data.center).ravel()
        outputs = [3 * wanted, 3 * wanted + 1]
        gain = np.linalg.solve(
            self.covariance[np.ix_(known_samples, known_samples)],
            self.covariance[np.ix_(known_samples, outputs)],
        ).T
        return gain @ centred[known_samples] + self.model.posterior.data.center[:2]


@pytest.fixture(scope="module")
def case() -> ForecastCase:
    """A closed-loop model with samples after its training, and the covariance of all samples by the dense formula."""
    samples = simulated(TRAINING + HORIZON, seed=4)
    training = samples[:TRAINING]
    data = LoopData.from_samples([training], DT)
    posterior = LoopPosterior(data, CONTROLLER)
    theta = posterior.prior.mean
    record = Record(training[:, 2:], training[:, :2], DT, (TRAINING,))
    maximum = QuadraticExpansion(theta, 0.0, np.zeros(len(NAMES)), np.eye(len(NAMES)))
    model = ClosedLoop(record, np.ones((1, 1)), [0, 1], posterior, maximum)
    loop = sampled_loop(theta, CONTROLLER, DT)
    count = len(samples)
    covariance = dense_covariance(loop, loop.stationary_covariance, count)
    covariance += np.diag(np.tile(loop.noise_variance, count))
    covariance += np.kron(np.ones((count, count)), data.trim_covariance)
    held_out_samples = samples[TRAINING:]
    return ForecastCase(
        model, held_out_samples[:, 2:], held_out_samples[:, :2], samples, covariance
    )


@pytest.mark.slow
def test_prediction_is_the_conditional_mean_without_motors(case: ForecastCase) -> None:
    predicted = case.model.predict_every(5, case.motors, case.outputs)
    expected = case.conditional_mean(np.arange(3 * TRAINING), TRAINING + 2)
    np.testing.assert_allclose(predicted[2], expected, rtol=1e-4)
    # The second prediction begins 5 samples later. The filter keeps the gain of the last training sample.
    expected = case.conditional_mean(np.arange(3 * (TRAINING + 5)), TRAINING + 7)
    np.testing.assert_allclose(predicted[7], expected, rtol=1e-3)


def test_forecast_is_the_conditional_mean_with_motors_up_to_the_sample(case: ForecastCase) -> None:
    forecast = case.model.forecast(case.motors)
    wanted = TRAINING + 8
    motors = 3 * np.arange(TRAINING, wanted + 1) + 2
    known_samples = np.append(np.arange(3 * TRAINING), motors)
    np.testing.assert_allclose(forecast[8], case.conditional_mean(known_samples, wanted), rtol=1e-4)


def test_smoothed_forecast_uses_all_motors(case: ForecastCase) -> None:
    forecast = case.model.forecast(case.motors, smooth=True)
    motors = 3 * np.arange(TRAINING, TRAINING + HORIZON) + 2
    known_samples = np.append(np.arange(3 * TRAINING), motors)
    expected = case.conditional_mean(known_samples, TRAINING + 4)
    np.testing.assert_allclose(forecast[4], expected, rtol=1e-4)


def test_one_step_predictions_use_the_samples_before_and_the_motors(case: ForecastCase) -> None:
    own_motors = 3 * 20 + 2
    known_samples = np.append(np.arange(3 * 20), own_motors)
    expected = case.conditional_mean(known_samples, 20)
    np.testing.assert_allclose(case.model.one_step()[20], expected, rtol=1e-4)


def test_wind_torque_is_smoothed_by_all_samples(case: ForecastCase) -> None:
    """The smoothed torque equals the regression on all samples, whose covariance is computed directly."""
    wind_torque = case.model.wind_torque()
    assert wind_torque.mean.shape == (TRAINING, 1)
    loop = sampled_loop(case.model.maximum.point, CONTROLLER, DT)
    output = wind_torque_output(case.model.maximum.point, loop.state_sd)
    # Covariance of the wind torque at sample 10 with all channels: C Φ^k P hᵀ later, C P (Φ^k)ᵀ hᵀ before.
    sample = 10
    cross_covariance = []
    for other in range(TRAINING):
        power = np.linalg.matrix_power(loop.transition, abs(other - sample))
        held_out_samples = power @ loop.stationary_covariance
        covariance = held_out_samples if other >= sample else held_out_samples.T
        cross_covariance.append(loop.output @ covariance @ output)
    weights = np.concatenate(cross_covariance)
    known_samples = 3 * TRAINING
    centred = (case.samples[:TRAINING] - case.model.posterior.data.center).ravel()
    gain = np.linalg.solve(case.covariance[:known_samples, :known_samples], weights)
    prior_variance = output @ loop.stationary_covariance @ output
    np.testing.assert_allclose(wind_torque.mean[sample], gain @ centred, rtol=1e-4)
    expected_variance = prior_variance - gain @ weights
    np.testing.assert_allclose(wind_torque.variance[sample], expected_variance, rtol=1e-4)


def test_margins_need_the_gains_of_the_autopilot(case: ForecastCase) -> None:
    with pytest.raises(NotLearnable):
        case.model.rate_loop()


def test_several_combinations_of_motors_are_refused() -> None:
    samples = simulated(60, seed=5)
    motors = np.column_stack([samples[:, 2], samples[::-1, 2]])
    with pytest.raises(ValueError, match="one combination"):
        closed_loop(Record(motors, samples[:, :2], DT, (60,)))


def recorded(parameters: dict[str, float]) -> Record:
    """Returns a record of a quadrotor X with these parameters, its motors half way between 1000 and 2000 µs."""
    samples = simulated(20, seed=6)
    return Record(
        np.full((20, 4), 1500.0),
        samples[:, :2],
        DT,
        (20,),
        effect_directions=np.array(X_ROLL),
        parameters=parameters,
        input_range=(1000.0, 2000.0),
    )


def test_gains_are_those_of_the_parameters() -> None:
    record = recorded(ARDUPILOT)
    mixer_row = np.array(X_ROLL) / 2
    controller = recorded_controller(record, mixer_row)
    assert controller.angle_gain == ARDUPILOT["ATC_ANG_RLL_P"]
    assert controller.integral_ratio == pytest.approx(0.3 / 0.14)
    assert controller.derivative_ratio == pytest.approx(0.004 / 0.14)
    logged = logged_controller(ARDUPILOT, "roll", np.array(X_ROLL))
    per_demand = mixer_row @ inputs_per_demand(logged, record)
    assert controller.p == pytest.approx(0.14 * per_demand)


def test_gains_without_a_logarithm_are_refused() -> None:
    row = np.array(X_ROLL) / 2
    without_gain = recorded({**ARDUPILOT, "ATC_RAT_RLL_P": 0.0})
    assert refused(recorded_controller, without_gain, row).code == LoopFact.NO_PROPORTIONAL_GAIN
    assert refused(recorded_controller, recorded(ARDUPILOT), -row).code == LoopFact.MIXER_REVERSED
