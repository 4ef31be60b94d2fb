import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter

from mavdem.dem.prediction import Predictor


def random_predictor(seed, n=3, r=2, m=2, dt=0.02):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n)) * 3 - 2 * np.eye(n)
    B, C = rng.standard_normal((n, r)), np.eye(m, n)
    return Predictor.of(A, B, C, dt, rng.uniform(1e-4, 1e-2, m), np.diag(rng.uniform(0.1, 10, n)), dt)


@given(seed=st.integers(0, 10**6))
def test_filter_and_forecast_run_the_recursion_they_stand_for(seed):
    predictor = random_predictor(seed)
    rng = np.random.default_rng(seed)
    y, u = rng.standard_normal((40, 2)), rng.standard_normal((40, 2))
    (phi, gamma0, gamma1), C, K = predictor.transition, predictor.C, predictor.gain
    states = [np.linalg.pinv(C) @ y[0]]
    ahead = []
    for t in range(1, 40):
        predicted = phi @ states[-1] + gamma0 @ u[t - 1] + gamma1 @ u[t]
        ahead.append(C @ predicted)
        states.append(predicted + K @ (y[t] - C @ predicted))
    scale = np.abs(states).max()
    np.testing.assert_allclose(predictor.filtered(y, u), states, atol=1e-8 * scale)
    np.testing.assert_allclose(predictor.one_step(y, u), ahead, atol=1e-8 * scale)

    state, forecast = states[9], []
    for t in range(10, 40):
        state = phi @ state + gamma0 @ u[t - 1] + gamma1 @ u[t]
        forecast.append(C @ state)
    scale = np.abs(forecast).max()
    np.testing.assert_allclose(predictor.forecast(states[9], u[9:]), forecast, atol=1e-8 * scale)
    errors = predictor.forecast_errors(y, u, 30, np.array([9]))
    np.testing.assert_allclose(errors[0], y[10:] - forecast, atol=1e-8 * scale)


def test_gain_follows_a_state_under_coloured_noise_nearly_as_well_as_the_best_there_is():
    """Against a Kalman filter that knows the noise's colour, its kernel being part of its state."""
    rng = np.random.default_rng(0)
    dt, rate, s, samples = 0.01, 3.0, 0.02, 200_000
    w = 2.0 * gaussian_filter1d(rng.standard_normal(samples), s / dt) * np.sqrt(2 * s / dt * np.sqrt(np.pi))
    z = 0.05 * rng.standard_normal(samples)
    phi = np.exp(-rate * dt)
    x = lfilter([0, (1 - phi) / rate], [1, -phi], w)
    y = (x + z)[:, None]
    A, B, C = -rate * np.eye(1), np.zeros((1, 1)), np.eye(1)
    predictor = Predictor.of(A, B, C, dt, np.array([0.05**2]), np.array([[4.0]]), s)
    # The noise of the measurements is white here, as a filter for z of any colour must also do.
    ours = np.var(predictor.filtered(y, np.zeros((samples, 1)))[1000:, 0] - x[1000:])
    taps = np.exp(-0.5 * (np.arange(-12, 13) * dt / s) ** 2)
    taps *= 2.0 / np.linalg.norm(taps)
    size = len(taps)
    F = np.zeros((size + 1, size + 1))
    F[0, 0], F[0, 1:] = phi, taps * (1 - phi) / rate
    F[2:, 1:-1] = np.eye(size - 1)
    G = np.zeros((size + 1, 1))
    G[1] = 1.0
    H = np.eye(1, size + 1)
    P = solve_discrete_are(F.T, H.T, G @ G.T, np.array([[0.05**2]]))
    best = (P - P @ H.T @ np.linalg.solve(H @ P @ H.T + 0.05**2, H @ P))[0, 0]
    assert best * 0.9 < ours < 2.5 * best
    # Taking the measurement as it is errs by its whole noise.
    assert ours < 0.8 * 0.05**2


def test_an_unseen_unstable_state_is_refused():
    A, C = np.diag([1.0, -1.0]), np.array([[0.0, 1.0]])
    with pytest.raises(np.linalg.LinAlgError):
        Predictor.of(A, np.zeros((2, 1)), C, 0.1, np.array([0.1]), np.eye(2), 0.1)


def test_one_sample_has_no_prediction():
    predictor = random_predictor(0)
    assert predictor.one_step(np.ones((1, 2)), np.ones((1, 2))).shape == (0, 2)
    assert predictor.forecast(np.ones(3), np.ones((1, 2))) == pytest.approx(np.empty((0, 2)))


@pytest.mark.parametrize("smoothness", [0.002, 0.5])
def test_coloured_noises_count_with_their_power_at_low_frequency(smoothness):
    """Of w 2s√π in continuous time; of samples of z the same over the step, but not less than their variance."""
    dt, process, measurement = 0.02, np.array([[2.0, 0.3], [0.3, 1.0]]), np.array([0.01, 0.04])
    A, B, C = np.array([[0.0, 1.0], [-9.0, -4.0]]), np.zeros((2, 1)), np.eye(2)
    predictor = Predictor.of(A, B, C, dt, measurement, process, smoothness)
    power = 2 * smoothness * np.sqrt(np.pi)
    Q, R = process * power * dt, np.diag(measurement) * (power / dt if power > dt else 1.0)
    P = solve_discrete_are(predictor.transition.state.T, C.T, Q, R)
    np.testing.assert_allclose(predictor.gain, P @ C.T @ np.linalg.inv(C @ P @ C.T + R), rtol=1e-9)
