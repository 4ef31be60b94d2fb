"""The noise model: the longer predictor is the shorter one with its expected errors added."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from simulated import simulated
from textbook_filter import TextbookFilter

from mavdem import Settings, learn
from mavdem.dem.engine.state_space import StateSpace, filter_gain
from mavdem.dem.fitting import predictor_of
from mavdem.dem.forecast.noise_model import FEWEST_LAGS, lags_of, with_noise_model

DT = 0.01
A = np.array([[0.0, 1.0, 0.0], [-9.0, -4.0, 20.0], [0.0, 0.0, -20.0]])
B = np.array([[0.0, 0.0], [0.0, 0.0], [3.0, -2.0]])


C = np.eye(2, 3)


TEXTBOOK = TextbookFilter.of(A, B, C, DT, filter_gain(A, C, DT, np.array([0.02, 0.05]), np.diag([1e-4, 0.5, 1e-4]), DT))
SHORT = TEXTBOOK.predictor


def driven(samples: int = 3000, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Inputs, and outputs whose errors of one step are white and normal, 0.1 and 0.2 in size."""
    rng = np.random.default_rng(seed)
    inputs = np.cumsum(rng.standard_normal((samples, 2)), axis=0) * 0.1
    return inputs, TEXTBOOK.outputs(inputs, rng.standard_normal((samples, 2)) * [0.1, 0.2])


def longer(inputs: np.ndarray, outputs: np.ndarray) -> StateSpace:
    return with_noise_model(SHORT, [(inputs, outputs)])


def test_white_errors_tell_nothing():
    inputs, outputs = driven()
    long = longer(inputs, outputs)
    sizes = np.array([0.1, 0.2])
    told = long.A[3:5, 3 : 3 + 2 * FEWEST_LAGS] * np.tile(sizes, FEWEST_LAGS) / sizes[:, None]
    assert np.abs(told).max() < 4 / np.sqrt(len(inputs))


def test_coloured_errors_are_foreseen_but_for_what_is_new_in_them():
    rng = np.random.default_rng(1)
    inputs, _ = driven(6000)
    news = rng.standard_normal((6000, 2))
    errors = lfilter([1.0], [1.0, -1.2, 0.5], news, axis=0)
    outputs = TEXTBOOK.outputs(inputs, errors)
    long = longer(inputs[:3000], outputs[:3000])
    off = outputs[3001:] - long.one_step(inputs[3000:], outputs[3000:])
    short = outputs[3001:] - SHORT.one_step(inputs[3000:], outputs[3000:])
    # What is new has variance 1; three thousand of them tell it to 2.6 %, four standard deviations 0.11.
    np.testing.assert_allclose((off[50:] ** 2).mean(axis=0), 1.0, atol=0.11)
    assert ((short[50:] ** 2).mean(axis=0) > 2.5).all()


def test_what_changes_of_the_inputs_do_at_once_is_learnt():
    inputs, outputs = driven()
    changes = np.diff(inputs, axis=0, prepend=inputs[:1])
    at_once_felt = np.array([[0.5, 0.0], [0.0, -0.7]])
    errors = np.random.default_rng(2).standard_normal((3000, 2)) * 0.01 + changes @ at_once_felt.T
    outputs = TEXTBOOK.outputs(inputs, errors)
    np.testing.assert_allclose(longer(inputs, outputs).B[3:5], at_once_felt, atol=0.02)


def test_it_is_the_shorter_predictor_with_the_expected_error_added():
    inputs, outputs = driven(200)
    outputs = lfilter([1.0], [1.0, -0.6], outputs, axis=0)
    short, long = TEXTBOOK, longer(inputs, outputs)
    past = slice(3 + 2 * FEWEST_LAGS, None)
    of_errors, of_past = long.A[3:5, 3 : 3 + 2 * FEWEST_LAGS], long.A[3:5, past]
    state, errors, ahead = np.linalg.pinv(C) @ outputs[0], [np.zeros(2)] * FEWEST_LAGS, []
    remembered = [inputs[0]] * FEWEST_LAGS
    for t in range(1, 200):
        expected = of_errors @ np.concatenate(errors[:FEWEST_LAGS]) + of_past @ np.concatenate(remembered[:FEWEST_LAGS])
        expected = expected + long.B[3:5] @ inputs[t]
        before = short._moved(state, inputs[t - 1], inputs[t])
        ahead.append(C @ before + expected)
        errors.insert(0, outputs[t] - C @ before)
        remembered.insert(0, inputs[t])
        state = before + short.gain @ errors[0]
    np.testing.assert_allclose(long.one_step(inputs, outputs), ahead, atol=1e-9)
    np.testing.assert_allclose(
        long.filtered(long.second(inputs[0], outputs[0]), inputs, outputs)[:, :3],
        SHORT.filtered(SHORT.second(inputs[0], outputs[0]), inputs, outputs),
        atol=1e-9,
    )


def test_it_is_at_rest_where_the_shorter_one_is():
    inputs, outputs = driven(500)
    long = longer(inputs, outputs)
    still = np.broadcast_to(inputs[7], (60, 2))
    rest = np.zeros(2)
    np.testing.assert_allclose(
        long.simulated(long.second(still[0], rest), still),
        SHORT.simulated(SHORT.second(still[0], rest), still),
        atol=1e-9,
    )


def test_inputs_that_never_change_and_records_that_are_too_short_tell_nothing():
    inputs, outputs = driven(400)
    inputs[:, 1] = 1.0
    long = longer(inputs, outputs)
    assert np.isfinite(long.A).all() and not long.B[3:5, 1].any()
    brief = longer(inputs[:3], outputs[:3])
    assert not brief.A[3:5, 3:].any()
    np.testing.assert_allclose(
        brief.one_step(inputs[:50], outputs[:50]), SHORT.one_step(inputs[:50], outputs[:50]), atol=1e-9
    )


def test_what_is_learnt_along_trajectories_foresees_its_own_errors():
    flight = simulated(samples=1000, wind=1.0, lag=0.05)
    learned = learn(flight[:700], Settings(order=3, d=2, window=9, parameter_precision=1.0))
    short = predictor_of(learned.theta, (3, 5, 2), learned.simulation_fit.gain, flight.dt)
    later = learned.scaling.scale_inputs(flight.inputs[700:]), learned.scaling.scale_outputs(flight.outputs[700:])
    ours, without = (((later[1][1:] - each.one_step(*later)) ** 2).mean(axis=0) for each in (learned.predictor, short))
    assert (ours < 0.5 * without).all()


@pytest.mark.parametrize("growth", [1.02, 1.2])
def test_errors_that_grew_in_training_die_away_in_forecasts(growth):
    inputs, _ = driven(120)
    errors = np.outer(growth ** np.arange(120), [1e-3, -1e-3])
    long = longer(inputs, TEXTBOOK.outputs(inputs, errors))
    assert np.abs(np.linalg.eigvals(long.A)).max() < 1


@pytest.mark.parametrize(("rate", "lags"), [(50, 3), (100, 3), (120, 3), (200, 5), (250, 6), (400, 6)])
def test_lags_last_as_long_within_limits(rate, lags):
    assert lags_of(1 / rate) == lags
