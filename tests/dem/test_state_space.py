import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm, solve_discrete_are
from textbook_filter import TextbookFilter

from mavdem.dem.engine.state_space import filter_gain


def random_filter(seed, n=3, r=2, m=2, dt=0.02):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n)) * 3 - 2 * np.eye(n)
    B, C = rng.standard_normal((n, r)), np.eye(m, n)
    gain = filter_gain(A, C, dt, rng.uniform(1e-4, 1e-2, m), np.diag(rng.uniform(0.1, 10, n)), dt)
    return TextbookFilter.of(A, B, C, dt, gain)


@given(seed=st.integers(0, 10**6))
def test_the_innovation_form_is_the_filter_of_textbooks(seed):
    textbook = random_filter(seed)
    predictor = textbook.predictor
    rng = np.random.default_rng(seed)
    y, u = rng.standard_normal((40, 2)), rng.standard_normal((40, 2))
    corrected, ahead = textbook.corrected(u, y)
    scale = np.abs(corrected).max()
    np.testing.assert_allclose(predictor.one_step(u, y), ahead, atol=1e-8 * scale)
    # The state of the innovation form is the predicted one, less what the sample's own inputs add.
    predicted = [textbook._moved(state, now, now * 0) for state, now in zip(corrected, u, strict=True)]
    start = predictor.second(u[0], y[0])
    states = predictor.filtered(start, u[1:], y[1:])
    np.testing.assert_allclose(states, predicted, atol=1e-8 * scale)
    np.testing.assert_allclose(predictor.at_end(u, y), states[-1], atol=0)
    np.testing.assert_allclose(predictor.following(states[5], u[6], y[6]), states[6], atol=1e-8 * scale)

    forecast = textbook.forecast(corrected[9], u[9:])
    scale = np.abs(forecast).max()
    np.testing.assert_allclose(predictor.simulated(states[9], u[10:]), forecast, atol=1e-8 * scale)
    from_there = predictor.simulated_from(np.array([10]), 30, states[[9]], u)
    np.testing.assert_allclose(from_there[0], forecast, atol=1e-8 * scale)
    every = predictor.simulated_every(7, start, u[1:], y[1:])
    np.testing.assert_allclose(every[14:21], textbook.forecast(corrected[14], u[14:])[:7], atol=1e-8 * scale)


def test_an_unseen_unstable_state_is_refused():
    A, C = np.diag([1.0, -1.0]), np.array([[0.0, 1.0]])
    with pytest.raises(np.linalg.LinAlgError):
        filter_gain(A, C, 0.1, np.array([0.1]), np.eye(2), 0.1)


def test_one_sample_has_no_prediction():
    predictor = random_filter(0).predictor
    assert predictor.one_step(np.ones((1, 2)), np.ones((1, 2))).shape == (0, 2)
    assert predictor.simulated(np.ones(3), np.ones((0, 2))) == pytest.approx(np.empty((0, 2)))


@pytest.mark.parametrize("smoothness", [0.002, 0.5])
def test_coloured_noises_count_with_their_power_at_low_frequency(smoothness):
    """Of w 2s√π in continuous time; of samples of z the same over the step, but not less than their variance."""
    dt, process, measurement = 0.02, np.array([[2.0, 0.3], [0.3, 1.0]]), np.array([0.01, 0.04])
    A, C = np.array([[0.0, 1.0], [-9.0, -4.0]]), np.eye(2)
    gain = filter_gain(A, C, dt, measurement, process, smoothness)
    power = 2 * smoothness * np.sqrt(np.pi)
    Q, R = process * power * dt, np.diag(measurement) * (power / dt if power > dt else 1.0)
    P = solve_discrete_are(expm(A * dt).T, C.T, Q, R)
    np.testing.assert_allclose(gain, P @ C.T @ np.linalg.inv(C @ P @ C.T + R), rtol=1e-9)
