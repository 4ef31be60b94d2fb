"""The joint model: evidence and posterior against the matrix normal, forecasts against plain loops, and live."""

from dataclasses import replace

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, fixture, mark
from simulated import in_closed_loop

from mavdem.dem.engine.linalg import ROUNDING_TOLERANCE
from mavdem.dem.forecast import joint
from mavdem.dem.forecast.joint import LAG_CANDIDATES, JointModel, VarHyperparameters
from mavdem.dem.forecast.lag_regression import CONSTANT_RIDGE, LagStatistics, lagged_rows, regress
from mavdem.dem.online.forecaster import OnlineForecaster
from mavdem.dem.online.memory import SampleMemory
from mavdem.dem.record import Record

K = 2
LONGER = VarHyperparameters(4, 0.05)
SHORTER = VarHyperparameters(3, 0.3)
X_FRAME = np.array([1.0, -1.0, -1.0, 1.0]) / 2
FLIGHT = replace(in_closed_loop(wind=10.0, samples=1000), effect_directions=X_FRAME)
CHANNELS = np.hstack([FLIGHT.outputs, FLIGHT.inputs @ X_FRAME[:, None]])
TRAIN = Record.from_flights(FLIGHT[:700])
AHEAD = (FLIGHT.inputs[700:], FLIGHT.outputs[700:])
WALK = default_rng(0).standard_normal((40, K)).cumsum(axis=0) / 5 + [1.0, -2.0]


@fixture(scope="module")
def model():
    return JointModel.learn(TRAIN)


def regressed(choice):
    """Of a walk, by rows that every choice has: X (N, q), errors (N, k) of the prior mean, P, S = 1 + X P⁻¹ Xᵀ; F̄."""
    max_lags = LAG_CANDIDATES[0]
    lags = choice.lags
    statistics = LagStatistics.from_segments([WALK], max_lags)
    design = np.hstack(
        [lagged_rows(WALK, lags)[max_lags - lags :], np.ones((len(WALK) - max_lags, 1))]
    )
    precision = CONSTANT_RIDGE * np.eye(lags * K + 1)
    precision[:-1, :-1] = np.kron(choice.prior_precision, np.eye(K))
    sample_covariance = np.eye(len(design)) + design @ np.linalg.inv(precision) @ design.T
    regression = regress(
        statistics.gram_of_fewer_lags(max_lags, lags), statistics.row_count, choice.prior_precision
    )
    return design, WALK[max_lags:] - design[:, :K], precision, sample_covariance, regression


@mark.parametrize("choice", [LONGER, SHORTER])
def test_the_terms_of_the_free_energy_are_as_named_and_sum_to_the_log_evidence(choice):
    """Given the noise covariance Σ, the samples are Gaussian with the covariance Σ ⊗ (1 + X P⁻¹ Xᵀ).

    So the evidence is also computed directly.
    """
    design, error, precision, sample_covariance, regression = regressed(choice)
    noise = error.T @ np.linalg.solve(sample_covariance, error) / len(
        design
    ) + ROUNDING_TOLERANCE * np.eye(K)
    covariance = np.kron(noise, sample_covariance)
    stacked_errors = error.T.ravel()
    evidence = -0.5 * (
        np.linalg.slogdet(2 * np.pi * covariance)[1]
        + stacked_errors @ np.linalg.solve(covariance, stacked_errors)
    )
    assert regression.free_energy == approx(evidence, abs=1e-5)
    posterior = np.linalg.inv(design.T @ design + precision)
    mean_change = posterior @ design.T @ error
    weights = np.linalg.inv(noise)
    assert_allclose(regression.mean, np.eye(*mean_change.shape) + mean_change, atol=1e-7)
    assert_allclose(
        regression.covariance_root.T @ regression.covariance_root, posterior, rtol=1e-6, atol=1e-9
    )
    residual = error - design @ mean_change
    narrower = np.linalg.slogdet(posterior @ precision)[1]
    expected = {
        "prediction errors": -0.5 * np.trace(weights @ residual.T @ residual),
        "noise entropy": -0.5 * len(design) * np.linalg.slogdet(2 * np.pi * noise)[1],
        "parameter errors": -0.5 * np.trace(weights @ mean_change.T @ precision @ mean_change),
        "parameter entropy": 0.5 * K * narrower,
    }
    assert regression.terms == approx(expected, abs=1e-5)


def test_the_prior_is_of_each_lag():
    assert_allclose(SHORTER.prior_precision, np.diag([0.3, 1.2, 2.7]), atol=1e-12)


def test_predictions_are_the_process_s(model):
    combined = AHEAD[0] @ X_FRAME[:, None]
    plain = model.process.rolling_forecast_unknown_inputs(
        model.last_samples, 60, combined, AHEAD[1]
    )
    assert_array_equal(model.rolling_forecast_unknown_inputs(60, *AHEAD).mean, plain.mean)


def turned_by(direction, samples=6000):
    """A roll axis held by motors, each with an error of its own; the ``direction`` of them turns it."""
    rng = default_rng(0)
    rotors = len(direction)
    rows = np.empty((samples, 2 + rotors))
    errors = gust = roll = rate = command = 0.0
    for t in range(samples):
        errors = 0.95 * errors + 0.3 * rng.standard_normal(rotors)
        motors = direction * command + errors
        rows[t] = [roll, rate, *motors]
        gust = 0.98 * gust + 0.1 * rng.standard_normal()
        command -= 0.2 * (3.0 * roll + 2.0 * rate + command)
        rate += 0.05 * (direction @ motors + gust - 0.2 * rate)
        roll += 0.05 * rate
    return Record(
        rows[:, 2:], rows[:, :2] + 1e-4 * rng.standard_normal((samples, 2)), 0.01, (samples,)
    )


@mark.slow
@mark.parametrize(
    "direction", [[1, -1, 1, -1], [0, 1, 0, -1], [1, -0.3, -1, 0.3], [2, 1, -1, -2, -1, 1]], ids=str
)
def test_the_motors_that_turn_the_axis_are_found(direction):
    expected = np.array(direction) / np.linalg.norm(direction)
    (mixer_row,) = joint.axis_mixer(turned_by(expected)).T
    assert np.linalg.norm(mixer_row) == approx(1)
    assert abs(mixer_row @ expected) > 0.98


def test_motors_that_answer_the_axis_turn_it_where_slow_ones_also_foretell_it():
    noise = np.outer(default_rng(0).standard_normal(700), 20 * X_FRAME)
    inputs = TRAIN.inputs + noise + np.outer(np.arange(700), [1, 1, -1, -1])
    (mixer_row,) = joint.axis_mixer(replace(TRAIN, inputs=inputs, effect_directions=None)).T
    assert_array_equal(mixer_row, X_FRAME)


def test_known_directions_are_taken_and_inputs_that_are_no_rotors_as_they_are():
    assert_array_equal(joint.known_axis_mixer(2, None), np.eye(2))
    assert joint.known_axis_mixer(4, np.zeros(4)) is None
    with_known_directions = replace(
        turned_by(X_FRAME, 300), effect_directions=np.array([3.0, 3.0, -3.0, -3.0])
    )
    assert_allclose(joint.axis_mixer(with_known_directions)[:, 0], [0.5, 0.5, -0.5, -0.5])


@mark.in_full
def test_bands_hold_nine_of_ten_at_every_horizon():
    """The 90 % bands of forecasts over 0.1 s to 1.5 s contain nine tenths of the samples of eight simulated flights."""
    inside = []
    for seed in range(8):
        flight = in_closed_loop(seed, wind=10.0, samples=2000)
        joint_model = JointModel.learn(Record.from_flights(flight[:700]))
        outputs = flight.outputs[700:]
        for steps in (10, 50, 150):
            for rolling_forecast in (
                joint_model.rolling_forecast_known_inputs,
                joint_model.rolling_forecast_unknown_inputs,
            ):
                mean, variance = rolling_forecast(steps, flight.inputs[700:], outputs)
                inside.append(
                    (abs(outputs - mean) <= joint_model.half_widths(variance, 0.9, steps)).mean()
                )
    shares = np.reshape(inside, (8, -1)).mean(axis=0)
    # Of flights that do not change: recorded ones do, for which the bands are a little wider than these need.
    assert ((shares > 0.85) & (shares < 0.97)).all()


def followed(flight, outputs, gap=None):
    """Yields for each sample the online forecaster and its predictions; after a ``gap`` the forecaster begins anew."""
    ahead = OnlineForecaster(0.01, (1, 5, 25), 2, X_FRAME[:, None])
    memory = SampleMemory(0.01, 10, 300)
    for row in range(len(flight)):
        if row == gap:
            memory.end_segment()
            ahead.end_segment()
        closed = memory.add(flight.inputs[row], outputs[row], flight.time[row])
        yield ahead, *ahead.predict(memory)
        if closed:
            ahead.add_block(memory.blocks[-1])


@mark.slow
def test_live_it_is_the_model_learnt_of_the_same_samples(monkeypatch):
    """The online forecaster, with endless memory, predicts like the model that is learned at once.

    They scale the units by the first second and by all samples, so that they agree to 0.05 of the deviation.
    """
    monkeypatch.setattr("mavdem.dem.online.forecaster.MEMORY_SECONDS", 1e9)
    flight = replace(in_closed_loop(wind=10.0, samples=2500), effect_directions=X_FRAME)
    joint_model = JointModel.learn(Record.from_flights(flight[:2450]))
    channels = np.hstack([flight.outputs, flight.inputs @ X_FRAME[:, None]])
    results = list(followed(flight, flight.outputs))
    for row, (_, expected_live, ahead_live) in enumerate(results):
        if row >= 2450:
            live = np.vstack([expected_live, ahead_live])
            past = channels[row + 1 - joint_model.hyperparameters.lags : row + 1]
            expected = joint_model.one_step_predictions(
                Record.from_flights(flight[row - 30 : row + 1])
            )[-1]
            offline = np.vstack(
                [
                    expected,
                    joint_model.process.forecast_unknown_inputs(past, 25).mean[[0, 4, 24], :2],
                ]
            )
            assert_allclose((live - offline) / flight.outputs.std(axis=0), 0, atol=0.05)
    live_model = results[-1][0]
    assert live_model._hyperparameters == joint_model.hyperparameters


@mark.slow
def test_no_lag_reaches_across_a_gap():
    """Samples after it are elsewhere, far from what the model has seen."""
    flight = in_closed_loop(wind=10.0, samples=1206)
    far = 1000.0
    outputs = flight.outputs + far * (np.arange(1206) >= 1200)[:, None]
    *_, (ahead, _, later) = followed(flight, outputs, gap=1200)
    assert abs(later - far).max() < 10
    # Of 12 s, by what is forgotten in 30.
    assert ahead._statistics.row_count == approx(3000 * (1 - np.exp(-0.4)), rel=0.02)
